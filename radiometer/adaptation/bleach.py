"""How much of the visual pigment a light bleaches, from what reaches the retina."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from radiometer.data.bleaching_constants import CONE_HALF_BLEACH, CONE_REGENERATION, ROD_EXPOSURE, ROD_REGENERATION

Receptor = Literal["rods", "cones"]


@dataclass(frozen=True, slots=True)
class PigmentKinetics:
    """Kinetics of bleaching and regeneration of a receptor's pigment."""

    td_s: float  # retinal exposure Q_e in troland·s that leaves 1/e of the pigment
    regeneration_s: float  # time constant of regeneration in s


# Rods count scotopic trolands, cones photopic ones.
KINETICS: Final[dict[Receptor, PigmentKinetics]] = {
    "rods": PigmentKinetics(ROD_EXPOSURE.value, ROD_REGENERATION.value),
    "cones": PigmentKinetics(CONE_HALF_BLEACH.value * CONE_REGENERATION.value, CONE_REGENERATION.value),
}


def _extremes(receptor: Receptor) -> tuple[PigmentKinetics, ...]:
    """Return the kinetics at all ends of the published spread."""
    if receptor == "rods":
        return tuple(
            PigmentKinetics(td_s, time_s)
            for td_s in (ROD_EXPOSURE.low, ROD_EXPOSURE.high)
            for time_s in (ROD_REGENERATION.low, ROD_REGENERATION.high)
        )
    return tuple(
        PigmentKinetics(half_td * time_s, time_s)
        for half_td in (CONE_HALF_BLEACH.low, CONE_HALF_BLEACH.high)
        for time_s in (CONE_REGENERATION.low, CONE_REGENERATION.high)
    )


def pupil_diameter_mm(luminance_cd_m2: float, field_deg2: float = 100.0, age_years: float = 28.58) -> float:
    """Return the diameter of the natural pupil in mm under a field's luminance.

    Args:
        luminance_cd_m2: Luminance of the adapting field in cd·m⁻², 0 or more.
        field_deg2: Area of the field in square degrees.
        age_years: Age, 20 to 83.

    Source: Watson and Yellott 2012, Journal of Vision 12(10):12, equation (21), on Stanley and Davies 1995.
    """
    flux = float((luminance_cd_m2 * field_deg2 / 846.0) ** 0.41)
    young = 7.75 - 5.75 * flux / (flux + 2.0)
    return young + (age_years - 28.58) * (0.02132 - 0.009562 * young)


def retinal_illuminance_td(luminance_cd_m2: float, pupil_mm: float) -> float:
    """Return the retinal illuminance in trolands: luminance times the pupil's area in mm²."""
    return luminance_cd_m2 * math.pi / 4.0 * pupil_mm**2


def bleached_fraction(
    retinal_td: float, duration_s: float, receptor: Receptor = "rods", *, before: float = 0.0
) -> float:
    """Return the fraction of pigment that is bleached at the end of a steady light.

    dB/dt = (1 − B)·I/Q_e − B/τ, solved for constant I.

    Args:
        retinal_td: Retinal illuminance I in trolands, 0 or more: scotopic for rods, photopic for cones.
        duration_s: Duration in s, 0 or more.
        before: Fraction bleached when it begins.

    Source: Rushton and Henry 1968, Vision Research 8, 617; first-order kinetics.
    """
    return _fraction(KINETICS[receptor], retinal_td, duration_s, before)


def bleached_range(retinal_td: float, duration_s: float, receptor: Receptor = "rods") -> tuple[float, float]:
    """Return the least and the most that a steady light bleaches by any of the published constants.

    Args:
        retinal_td: Retinal illuminance in trolands, 0 or more.
        duration_s: Duration in s, 0 or more.
    """
    fractions = [_fraction(kinetics, retinal_td, duration_s, 0.0) for kinetics in _extremes(receptor)]
    return min(fractions), max(fractions)


def _fraction(kinetics: PigmentKinetics, retinal_td: float, duration_s: float, before: float) -> float:
    rate = retinal_td / kinetics.td_s + 1.0 / kinetics.regeneration_s
    steady = retinal_td / kinetics.td_s / rate
    return steady + (before - steady) * math.exp(-rate * duration_s)

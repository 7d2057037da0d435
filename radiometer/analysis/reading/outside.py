"""Differences between the world and the model of a reading: a contribution each, by its distance from calibration.

A cause that calibration and reading share to the same degree drops out: every contribution below is a sensitivity
times the *difference* between the two. `StatedUncertainties` holds the figures and their sources.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.calibration.shared import Handling, settle
from radiometer.analysis.signal.situation import f_number_u_rel, magnification_u_rel, transmittance_u_rel
from radiometer.analysis.uncertainty.budget import Term
from radiometer.data import Calibration, Flag, FrameSettings, LensDescription, StatedUncertainties
from radiometer.data.calibration_sections import ScaleConditions

# Sensors in a room; used where calibration or reading do not state their temperature.
UNKNOWN_TEMPERATURE_K = 3.0
# Fall-off at the corner of a picture whose focal length or pixel size is unknown: cos⁴ at 27°, an ordinary lens.
UNKNOWN_FALLOFF = 0.36
_DAYS_PER_YEAR = 365.25
_HANDLING = {"reseated": "reseated_u_rel", "refocused": "refocused_u_rel", "iris_reset": "iris_reset_u_rel"}


@dataclass(frozen=True, slots=True)
class Surround:
    """The light of the whole picture.

    Attributes:
        rate: Its mean in the unit of the estimate.
        clipped: Part of the picture that clips even in the frame that shows it best; the mean is too low then.
    """

    rate: float
    clipped: float


@dataclass(frozen=True, slots=True)
class Falloff:
    """What is known of the sensitivity over the picture: "flat_field", "cos4" (declared), "assumed" or "unknown"."""

    known: str
    u_of_flat: float = 0.0


def conditions_of(
    shares: np.ndarray,
    settings: Sequence[FrameSettings],
    level: float,
    sensitivity: float,
    field: float,
    surround: float,
    polarised: bool | None,
) -> ScaleConditions:
    """Return the conditions of a reading in the form that a scale keeps.

    Args:
        shares: Part of every frame in the value, shape (frames,); they sum to 1.
        settings: Of the frames.
        level: Signal as a part of full scale.
        sensitivity: At the patch, relative to the axis.
        field: Distance of the patch from the axis over that of a corner.
        surround: Mean of the picture over the patch.
        polarised: Whether the source is polarised.
    """
    weight = np.abs(shares) / max(float(np.abs(shares).sum()), 1e-300)
    known = [one.temperature_c for one in settings if one.temperature_c is not None]
    return ScaleConditions(
        inverse_exposure_per_s=float(weight @ [1.0 / one.exposure_s for one in settings]),
        gain_db=float(weight @ [one.gain_db for one in settings]),
        temperature_c=float(np.mean(known)) if len(known) == len(settings) else None,
        level=max(level, 0.0),
        sensitivity=sensitivity,
        field=field,
        surround=max(surround, 0.0),
        polarised=polarised,
    )


def outside_terms(
    value: float,
    here: ScaleConditions,
    calibration: Calibration,
    lens: LensDescription,
    falloff: Falloff,
    *,
    linear: bool,
    now: dt.datetime,
) -> list[Term]:
    """Return the contributions of what differs between a reading and its calibration, stray light excepted.

    Args:
        value: The radiance.
        here: Conditions of the reading.
        calibration: The calibration, with the conditions of its scale.
        lens: The lens in use.
        falloff: What is known of the sensitivity over the picture.
        linear: Whether the sensor is taken as linear.
        now: Time of the reading, with time zone.
    """
    stated, there, size = calibration.uncertainties, calibration.scale.conditions, abs(value)
    terms = [
        _exposure_offset(size, here, there, stated),
        _gain(size, here, there, stated),
        _temperature(size, here, there, stated),
        _drift(size, calibration, now),
        *_handling(size, lens, stated),
        _falloff(size, here, there, falloff, stated),
        _polarisation(size, here, there, stated),
    ]
    if linear:
        bend = stated.bend_u_rel * abs(here.level - there.level)
        note = f"{100 * here.level:.3g} % of full scale, {100 * there.level:.3g} % at calibration"
        terms.append(Term("linearity", size * bend, correlated=True, note=note, flag=Flag.LINEARITY))
    return terms


def frame_u_rel(
    calibration: Calibration,
    lens: LensDescription,
    numbers: set[float | None],
    settings: Sequence[FrameSettings],
    now: dt.datetime | None = None,
) -> float:
    """Return the relative standard uncertainty that all pixels share through lens, gain, temperature and age.

    Args:
        calibration: The calibration.
        lens: The lens in use.
        numbers: f-numbers of the frames.
        settings: Of the frames.
        now: Time that the calibration's age is counted to, with time zone; None for the present.
    """
    even = np.full(len(settings), 1.0 / max(len(settings), 1))
    here = conditions_of(even, settings, 0.5, 1.0, 0.0, 1.0, None)
    stated, there = calibration.uncertainties, calibration.scale.conditions
    terms = [
        _gain(1.0, here, there, stated),
        _temperature(1.0, here, there, stated),
        _drift(1.0, calibration, now or dt.datetime.now(dt.UTC)),
        *_handling(1.0, lens, stated),
    ]
    parts = [
        f_number_u_rel(calibration, stated, numbers)[0],
        transmittance_u_rel(calibration, lens)[0],
        magnification_u_rel(calibration, lens)[0],
    ]
    return math.hypot(*(term.u for term in terms), *parts)


def stray_light(value: float, surround: float, calibration: Calibration) -> Term:
    """Return the contribution of light that the lens spreads from the surround, and from the patch itself.

    Args:
        value: The radiance of the patch.
        surround: Mean radiance of the picture.
        calibration: The calibration, whose source had a surround too.

    Source: ISO 9358:1994, veiling glare index, here as a part of the mean of the picture.
    """
    there, g = calibration.scale.conditions.surround, calibration.uncertainties.glare_u
    ratio = surround / value if value > 0.0 else math.inf
    note = f"the picture's mean is {ratio:.3g} times the patch, {there:.3g} times at calibration"
    u = g * abs(surround - there * value)
    return Term("stray light", u, correlated=True, note=note, flag=Flag.STRAY_LIGHT)


def _exposure_offset(size: float, here: ScaleConditions, there: ScaleConditions, stated: StatedUncertainties) -> Term:
    difference = abs(here.inverse_exposure_per_s - there.inverse_exposure_per_s)
    note = f"± {1e6 * stated.exposure_u_s:.2g} µs (k = 1), shared with the calibration's exposures"
    u = size * stated.exposure_u_s * difference
    return Term("exposure offset", u, correlated=True, note=note, flag=Flag.SHORT_EXPOSURE)


def _gain(size: float, here: ScaleConditions, there: ScaleConditions, stated: StatedUncertainties) -> Term:
    near = abs(here.gain_db - there.gain_db) <= 1e-6  # of rounding alone
    differs = settle("gain", there.gain_db, here.gain_db, equal=near) is not Handling.KEPT
    note = f"{here.gain_db:g} dB, {there.gain_db:g} dB at calibration"
    u = size * stated.gain_step_u_rel * differs
    return Term("gain step", u, correlated=True, note=note if differs else "gain as at calibration", flag=Flag.GAIN)


def _temperature(size: float, here: ScaleConditions, there: ScaleConditions, stated: StatedUncertainties) -> Term:
    if here.temperature_c is None or there.temperature_c is None:
        kelvin, note = UNKNOWN_TEMPERATURE_K, "temperature not known here or at calibration"
    else:
        kelvin = abs(here.temperature_c - there.temperature_c)
        note = f"{kelvin:.3g} K from the calibration's temperature"
    u = size * stated.temperature_u_rel_per_k * kelvin
    return Term("temperature", u, correlated=True, note=note, flag=Flag.TEMPERATURE)


def _drift(size: float, calibration: Calibration, now: dt.datetime) -> Term:
    age = max((now - dt.datetime.fromisoformat(calibration.created)).total_seconds() / 86400.0, 0.0)
    u = size * calibration.uncertainties.drift_u_rel_per_year * age / _DAYS_PER_YEAR
    return Term("drift", u, correlated=True, note=f"{age:.3g} days since calibration", flag=Flag.DRIFT)


def _handling(size: float, lens: LensDescription, stated: StatedUncertainties) -> list[Term]:
    done = dict.fromkeys(lens.since_calibration)
    return [
        Term(
            f"lens {name.replace('_', ' ')}",
            size * getattr(stated, _HANDLING[name]),
            correlated=True,
            note="as stated",
            flag=Flag.LENS_CHANGED,
        )
        for name in done
    ]


def _falloff(
    size: float, here: ScaleConditions, there: ScaleConditions, falloff: Falloff, stated: StatedUncertainties
) -> Term:
    lost = abs(here.sensitivity - there.sensitivity) / here.sensitivity
    if falloff.known == "flat_field":
        return Term("flat field", size * falloff.u_of_flat, correlated=True, note="of the correction")
    if falloff.known == "cos4":
        return Term("fall-off", size * stated.cos4_u_rel * lost, correlated=True, note="cos⁴ as declared for the lens")
    if falloff.known == "assumed":
        note = "no flat field: natural fall-off cos⁴ assumed"
    else:
        lost = UNKNOWN_FALLOFF * abs(here.field**2 - there.field**2)
        note = "no flat field, and focal length or pixel size unknown: fall-off not corrected"
    return Term("fall-off", size * stated.falloff_u_rel * lost, correlated=True, note=note, flag=Flag.FALLOFF_ASSUMED)


def _polarisation(size: float, here: ScaleConditions, there: ScaleConditions, stated: StatedUncertainties) -> Term:
    differs = bool(here.polarised) != bool(there.polarised)
    note = "polarised here or at calibration, not both" if differs else "as at calibration"
    u = size * stated.polarisation_u_rel * differs
    return Term("polarisation", u, correlated=True, note=note, flag=Flag.POLARISATION)

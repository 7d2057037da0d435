"""α-opic quantities of light whose spectrum is known: how strongly it excites each kind of photoreceptor.

Source: CIE S 026:2018, and CIE TN 015:2023 for the terms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from radiometer.analysis.photometry.photometry import (
    KM_LM_PER_W,
    Spectrum,
    holds_visible_light,
    luminous_efficiency,
    spectrum,
    table,
)
from radiometer.data import Quantity
from radiometer.errors import InputError
from radiometer.numbers import unit_text

RECEPTORS: Final = ("s_cone_opic", "m_cone_opic", "l_cone_opic", "rhodopic", "melanopic")
DAYLIGHT: Final = "cie_d65"  # CIE S 026 refers equivalent daylight quantities to it

# Unit of the quantity, whether it is photometric, and the units of the α-opic and of the equivalent daylight quantity.
_FORMS: Final[Mapping[str, tuple[bool, str, str]]] = {
    "W sr-1 m-2": (False, "W sr-1 m-2", "cd m-2"),
    "cd m-2": (True, "W sr-1 m-2", "cd m-2"),
    "W m-2": (False, "W m-2", "lx"),
    "lx": (True, "W m-2", "lx"),
}
UNITS: Final = tuple(_FORMS)


@dataclass(frozen=True, slots=True)
class SpectrumDoubt:
    """How well a spectrum is known."""

    u_rel: float = 0.0  # relative standard uncertainty of each of its entries, independent of the others
    wavelength_u_nm: float = 0.0  # standard uncertainty of its wavelength scale in nm, the same for all entries


@dataclass(frozen=True, slots=True)
class AlphaOpic:
    """One α-opic quantity."""

    receptor: str  # one of `RECEPTORS`
    quantity: Quantity  # α-opic radiance or irradiance in W·sr⁻¹·m⁻² or W·m⁻²
    # Luminance in cd·m⁻², or illuminance in lx, of daylight D65 that has the same quantity
    equivalent_daylight: Quantity
    efficacy_mw_lm: Quantity  # α-opic efficacy of luminous radiation in mW/lm
    daylight_ratio: Quantity  # α-opic daylight efficacy ratio, that efficacy over the one of D65


def alpha_opic_quantities(
    quantity: Quantity, light: Spectrum, doubt: SpectrumDoubt | None = None
) -> tuple[AlphaOpic, ...]:
    """Return the five α-opic quantities of a radiance, luminance, irradiance or illuminance.

    A photometric quantity X_v gives X_α = X_v·∫S·s_α dλ / (K_m·∫S·V dλ), a radiometric one X_e·∫S·s_α dλ / ∫S dλ.
    The uncertainty holds the quantity's own, and the ratio's from independent entries and from the wavelength scale.

    Args:
        quantity: Value and standard uncertainty in one of `UNITS`.
        light: Its spectrum.
        doubt: How well the spectrum is known; exactly by default.

    Raises:
        InputError: If the unit is none of those, or the spectrum holds no visible light.
    """
    if quantity.unit not in _FORMS:
        raise InputError(f"unit {quantity.unit!r}: an α-opic quantity is made of one in {', '.join(UNITS)}")
    photometric, unit, daylight_unit = _FORMS[quantity.unit]
    if not holds_visible_light(light):
        raise InputError(f"spectrum {light.name!r} holds no visible light: its α-opic efficacies are not defined")
    if not (math.isfinite(quantity.value) and quantity.value >= 0.0):
        raise InputError(
            f"{quantity.value:g} {unit_text(quantity.unit)}: an α-opic quantity is made of a value of 0 or more"
        )
    sure = doubt if doubt is not None else SpectrumDoubt()
    found = list[AlphaOpic]()
    for receptor in RECEPTORS:
        elr, u_elr = _ratio_with_u(light, _Ratio(receptor, photometric=True), sure)
        factor, u_factor = elr, u_elr
        if not photometric:
            factor, u_factor = _ratio_with_u(light, _Ratio(receptor, photometric=False), sure)
        value, d65 = quantity.value * factor, _daylight_efficacy(receptor)
        u = math.hypot(quantity.u * factor, quantity.value * u_factor)
        found.append(
            AlphaOpic(
                receptor,
                Quantity(value, u, unit),
                Quantity(value / d65, u / d65, daylight_unit),
                Quantity(1e3 * elr, 1e3 * u_elr, "mW lm-1"),
                Quantity(elr / d65, u_elr / d65, "1"),
            )
        )
    return tuple(found)


@dataclass(frozen=True, slots=True)
class _Ratio:
    """The part of the luminous flux in W/lm, or of the power, that excites a receptor."""

    receptor: str
    photometric: bool

    def parts(self, light: Spectrum) -> tuple[float, float]:
        """Return numerator and denominator."""
        wavelength_nm, columns = table("alpha_opic.csv")
        excites = light.integral(wavelength_nm, columns[self.receptor])
        if self.photometric:
            return excites, KM_LM_PER_W * light.integral(*luminous_efficiency())
        return excites, light.integral()

    def of(self, light: Spectrum) -> float:
        above, below = self.parts(light)
        return above / below


@cache
def _daylight_efficacy(receptor: str) -> float:
    """Return the α-opic efficacy of luminous radiation of D65 in W/lm."""
    return _Ratio(receptor, photometric=True).of(spectrum(DAYLIGHT))


def _ratio_with_u(light: Spectrum, ratio: _Ratio, doubt: SpectrumDoubt) -> tuple[float, float]:
    """Return a ratio and its standard uncertainty."""
    value = ratio.of(light)
    moved = [
        Spectrum(light.name, light.wavelength_nm + way * doubt.wavelength_u_nm, light.power) for way in (-1.0, 1.0)
    ]
    u_wavelength = abs(ratio.of(moved[1]) - ratio.of(moved[0])) / 2.0 if doubt.wavelength_u_nm else 0.0
    return value, math.hypot(u_wavelength, _u_entries(light, ratio, value) * doubt.u_rel if doubt.u_rel else 0.0)


def _u_entries(light: Spectrum, ratio: _Ratio, value: float) -> float:
    """Return the standard deviation of a ratio per relative error of the entries, which are independent.

    The integrals are linear in the entries: N = Σ Nᵢ, D = Σ Dᵢ with the triangles between neighbouring wavelengths. So
    the derivative of N/D by the relative error of entry i is (Nᵢ − r·Dᵢ)/D.
    """
    if light.wavelength_nm.size == 1:
        return 0.0  # a line has no shape
    below = ratio.parts(light)[1]
    derivatives = []
    for at in range(light.wavelength_nm.size):
        near = slice(max(0, at - 1), at + 2)
        alone = np.where(np.arange(light.wavelength_nm.size)[near] == at, light.power[near], 0.0)
        n_i, d_i = ratio.parts(Spectrum(light.name, light.wavelength_nm[near], alone))
        derivatives.append((n_i - value * d_i) / below)
    return float(np.linalg.norm(derivatives))

"""α-opic quantities of light whose spectrum is known: how strongly it excites each kind of photoreceptor.

Source: CIE S 026:2018, and CIE TN 015:2023 for the terms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.analysis.photometry.photometry import (
    KM_LM_PER_W,
    Spectrum,
    luminous_efficacy,
    luminous_efficiency,
    mean_weight,
    spectrum,
    table,
)
from radiometer.data import Quantity
from radiometer.errors import InputError
from radiometer.numbers import unit_text

RECEPTORS: Final = ("s_cone_opic", "m_cone_opic", "l_cone_opic", "rhodopic", "melanopic")
_TABULATED_NM: Final = (390.0, 780.0)  # CIE S 026: cones from 390 nm, rods and melanopsin from 380 nm
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
class AlphaOpic:
    """One α-opic quantity."""

    receptor: str  # one of `RECEPTORS`
    quantity: Quantity  # α-opic radiance or irradiance in W·sr⁻¹·m⁻² or W·m⁻²
    # Luminance in cd·m⁻², or illuminance in lx, of daylight D65 that has the same quantity
    equivalent_daylight: Quantity
    efficacy_mw_lm: Quantity  # α-opic efficacy of luminous radiation in mW/lm
    daylight_ratio: Quantity  # α-opic daylight efficacy ratio, that efficacy over the one of D65


def alpha_opic_quantities(
    quantity: Quantity, light: Spectrum, u_rel: float = 0.0, wavelength_u_nm: float = 0.0
) -> tuple[AlphaOpic, ...]:
    """Return the five α-opic quantities of a radiance, luminance, irradiance or illuminance.

    A photometric quantity X_v gives X_α = X_v·∫S·s_α dλ / (K_m·∫S·V dλ), a radiometric one X_e·∫S·s_α dλ / ∫S dλ.
    The uncertainty holds the quantity's own, and the ratio's from independent relative errors `u_rel` of the spectrum's
    entries and from its wavelength scale. The unit is one of `UNITS`. Raises InputError if the spectrum holds or states
    too little light where the functions are tabulated.
    """
    photometric, unit, daylight_unit = _FORMS[quantity.unit]
    luminous_efficacy(light)  # without one the α-opic efficacies are not defined
    low, high = _TABULATED_NM
    if not np.any(light.power[(light.wavelength_nm >= low) & (light.wavelength_nm <= high)] > 0.0):
        raise InputError(f"spectrum {light.name!r} holds no light from {low:g} to {high:g} nm, where the functions of "
                         "the cones are tabulated")  # fmt: skip
    value = quantity.value
    if not (math.isfinite(value) and value >= 0.0):
        raise InputError(f"{value:g} {unit_text(quantity.unit)}: an α-opic quantity is made of a value of 0 or more")

    def of(receptor: str) -> AlphaOpic:
        efficacy = _ratio(light, receptor, u_rel, wavelength_u_nm, photometric=True)
        of_d65 = 1.0 / _ratio(spectrum(DAYLIGHT), receptor, photometric=True).value
        factor = efficacy if photometric else _ratio(light, receptor, u_rel, wavelength_u_nm, photometric=False)
        found = Quantity(value * factor.value, math.hypot(quantity.u * factor.value, value * factor.u), unit)
        daylight, ratio = found.scaled(of_d65, daylight_unit), efficacy.scaled(of_d65, "1")
        return AlphaOpic(receptor, found, daylight, efficacy.scaled(1e3, "mW lm-1"), ratio)

    return tuple(map(of, RECEPTORS))


def _ratio(
    light: Spectrum, receptor: str, u_rel: float = 0.0, wavelength_u_nm: float = 0.0, *, photometric: bool
) -> Quantity:
    """Return the part of the luminous flux in W/lm, or of the power, that excites a receptor.

    The integrals are linear in the entries: N = Σ Nᵢ, D = Σ Dᵢ with the triangles between neighbouring wavelengths. So
    the derivative of N/D by the relative error of entry i is (Nᵢ − r·Dᵢ)/D.
    """
    wavelength_nm, columns = table("alpha_opic.csv")
    stated = slice(*(np.flatnonzero(columns[receptor])[[0, -1]] + [0, 1]))
    weighting = wavelength_nm[stated], columns[receptor][stated]

    def parts(of: Spectrum) -> tuple[float, float]:
        below = KM_LM_PER_W * of.integral(*luminous_efficiency()) if photometric else of.integral()
        return of.integral(*weighting), below

    def moved(by_nm: float) -> float:
        above, below = parts(Spectrum(light.name, light.wavelength_nm + by_nm, light.power))
        return above / below

    value, below = moved(0.0), parts(light)[1]
    unknown = mean_weight(light, weighting, luminous_efficiency() if photometric else None)
    u_unknown = unknown.u / (KM_LM_PER_W if photometric else 1.0)
    u_wavelength = abs(moved(wavelength_u_nm) - moved(-wavelength_u_nm)) / 2.0
    derivatives = []
    places = range(light.wavelength_nm.size) if u_rel and light.wavelength_nm.size > 1 else ()  # a line: no shape
    for at in places:
        near = slice(max(0, at - 1), at + 2)
        alone = np.where(np.arange(light.wavelength_nm.size)[near] == at, light.power[near], 0.0)
        n_i, d_i = parts(Spectrum(light.name, light.wavelength_nm[near], alone))
        derivatives.append((n_i - value * d_i) / below)
    return Quantity(value, math.hypot(u_wavelength, u_unknown, float(np.linalg.norm(derivatives)) * u_rel), "1")

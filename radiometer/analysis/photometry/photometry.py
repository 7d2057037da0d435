"""Relative spectra of sources by name; radiance and luminance, photopic and scotopic; light of unstated kind.

A spectrum is what a conversion between luminance and radiance assumes, through V(λ) and V′(λ). Displays without a
measured spectrum have peaks, widths and shares of the primaries that are usual for the kind. They are those of Lee, Liu
and Wu (2008), Introduction to Flat Panel Displays, not verified line by line. The kind `crt` is the typical CRT of
Brainard (1997). Luminous efficacies of single displays scatter about these by some 10 %, the blue's by 25 %.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radiometer.data import Quantity
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.text_table import TextTable, finite, read_table
from radiometer.errors import InputError
from radiometer.typing import Array
from radiometer.units import BOLTZMANN_J_K, PLANCK_J_S, SPEED_OF_LIGHT_M_S

BAND_NM: Final = (380.0, 780.0)  # visible light: CIE 018:2019
TABLES: Final = Path(__file__).with_name("tables")
_LEDS: Final = ("led_b1", "led_b2", "led_b4", "led_b5", "led_bh1", "led_rgb1", "led_v1", "led_v2")
FLUORESCENT: Final = ("cie_fl2", "cie_fl4", "cie_fl7", "cie_fl8", "cie_fl10", "cie_fl11", "cie_fl12")
_CIE: Final = (*_LEDS, "cie_a", *FLUORESCENT, "crt_red", "crt_green", "crt_blue")
_TABULATED: Final = {
    **dict.fromkeys(("cie_d65", "white_led", "display_red", "display_green", "display_blue"), "spectra.csv"),
    **dict.fromkeys(_CIE, "spectra_cie.csv"),
}
SPECTRUM_NAMES: Final = (
    "equal_energy",
    "planck:T",
    *_TABULATED,
    "line:NM",
    "band:NM,FWHM",
    "display:TYPE:PRIMARY",
    "FILE.csv",
)
# Type and primary: peak in nm, full width at half maximum in nm, share of the power.
LINES: Final[dict[str, dict[str, tuple[tuple[float, float, float], ...]]]] = {
    "led_lcd": {
        "red": ((625.0, 75.0, 0.95), (450.0, 20.0, 0.05)),
        "green": ((540.0, 65.0, 0.96), (450.0, 20.0, 0.04)),
        "blue": ((450.0, 21.0, 0.90), (510.0, 40.0, 0.10)),
    },
    "ccfl_lcd": {
        "red": ((611.0, 6.0, 0.70), (625.0, 40.0, 0.28), (545.0, 8.0, 0.02)),
        "green": ((545.0, 9.0, 0.70), (540.0, 50.0, 0.22), (490.0, 14.0, 0.08)),
        "blue": ((450.0, 45.0, 0.80), (490.0, 14.0, 0.20)),
    },
    "oled": {
        "red": ((620.0, 38.0, 1.0),),
        "green": ((525.0, 38.0, 1.0),),
        "blue": ((460.0, 24.0, 1.0),),
    },
}
CRT: Final = "crt"
DISPLAY_TYPES: Final = (*LINES, CRT)
KM_LM_PER_W: Final = 683.0  # maximum photopic luminous efficacy, at 540 THz (SI, candela)
KM_SCOTOPIC_LM_PER_W: Final = 1700.05  # CIE S 010, K'm at 507 nm
# Of a luminous efficacy, from what the table of a light does not state: beyond it, nothing is converted.
MOST_UNKNOWN_REL: Final = 0.05
COARSEST_NM: Final = 20.0  # of a light that is not a line: the widest step of tables of CIE 015:2018
Observer = Literal["photopic", "photopic_gaussian", "scotopic"]

_COLUMNS: Final = {"photopic": "photopic_cie1924", "scotopic": "scotopic_cie1951"}
# The kinds of light that people measure, each as likely as any other, and the lights of a kind alike.
# Source: CIE 015:2018 for lamps and daylight; for screens the usual primaries of `display_types`.
KINDS: Final[dict[str, tuple[str, ...]]] = {
    "white LEDs": ("led_b1", "led_b2", "white_led", "led_b4", "led_b5", "led_bh1", "led_rgb1", "led_v1", "led_v2"),
    "incandescent lamps": ("cie_a",),
    "daylight": ("cie_d65",),
    "fluorescent lamps": ("cie_fl2", "cie_fl11"),
    "single colours of screens": tuple(
        f"display:{kind}:{primary}" for kind in ("oled", "led_lcd") for primary in ("red", "green", "blue")
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Relative spectral power of a source over a stated band."""

    name: str  # name it is asked for by
    wavelength_nm: NDArray[np.float64]  # ascending wavelengths in nm; a single one for a monochromatic line
    power: NDArray[np.float64]  # relative power per nm at each, 0 or more
    # Whether it was sampled from a light: beyond its entries and between them it is unknown
    is_sampled: bool = False

    @property
    def band_nm(self) -> tuple[float, float]:
        """Return the lowest and highest wavelength in nm."""
        return float(self.wavelength_nm[0]), float(self.wavelength_nm[-1])

    def integral(
        self, weighting_nm: NDArray[np.float64] | None = None, weighting: NDArray[np.float64] | None = None
    ) -> float:
        """Return ∫ S(λ)·w(λ) dλ over the band, exactly, with straight lines between the entries of either table.

        Between neighbouring wavelengths of both, h apart, the product of two straight lines is a parabola:
        ∫ = h/6·[S₀·(2w₀ + w₁) + S₁·(w₀ + 2w₁)].

        Args:
            weighting_nm: Ascending wavelengths of the weighting in nm; None weighs all alike.
            weighting: Its values; 0 outside its wavelengths.
        """
        if weighting_nm is None or weighting is None:
            weighting_nm, weighting = np.array(self.band_nm), np.ones(2)
        if self.wavelength_nm.size == 1:
            here = np.interp(self.wavelength_nm[0], weighting_nm, weighting, left=0.0, right=0.0)
            return float(self.power[0] * here)
        low, high = max(self.wavelength_nm[0], weighting_nm[0]), min(self.wavelength_nm[-1], weighting_nm[-1])
        grid = np.union1d(self.wavelength_nm, weighting_nm)
        grid = grid[(grid >= low) & (grid <= high)]
        power, weight = np.interp(grid, self.wavelength_nm, self.power), np.interp(grid, weighting_nm, weighting)
        crossed = power[:-1] * (2.0 * weight[:-1] + weight[1:]) + power[1:] * (weight[:-1] + 2.0 * weight[1:])
        return float(np.sum(np.diff(grid) * crossed) / 6.0)

    def unknown(self, weighting_nm: NDArray[np.float64], weighting: NDArray[np.float64]) -> float:
        """Return what ∫ S(λ)·w(λ) dλ may lack at most where one table ends before the other."""
        if self.wavelength_nm.size == 1:
            nearest = np.clip(self.wavelength_nm[0], weighting_nm[0], weighting_nm[-1])
            height = float(np.interp(nearest, weighting_nm, weighting))
            return 0.0 if nearest == self.wavelength_nm[0] else float(self.power[0]) * height
        lacking = _beyond(weighting_nm, weighting, self.wavelength_nm, self.power)
        return lacking + (_beyond(self.wavelength_nm, self.power, weighting_nm, weighting) if self.is_sampled else 0.0)

    def in_gaps(self, weighting: Weighting | None, wider_nm: float) -> float:
        """Return by how much ∫ S(λ)·w(λ) dλ depends on where light is in the gaps between entries so far apart."""
        total, (weighting_nm, height) = 0.0, weighting or (np.empty(0), np.empty(0))
        lit = self.power[1:] + self.power[:-1] > 0.0
        for n in np.flatnonzero((np.diff(self.wavelength_nm) > wider_nm) & lit) if weighting else ():
            ends = self.wavelength_nm[n : n + 2]
            inside = weighting_nm[(weighting_nm > ends[0]) & (weighting_nm < ends[1])]
            heights = np.interp(np.concatenate([ends, inside]), weighting_nm, height, left=0.0, right=0.0)
            total += Spectrum(self.name, ends, self.power[n : n + 2]).integral() * float(np.ptp(heights))
        return total


def _beyond(table_nm: Array, values: Array, other_nm: Array, other: Array) -> float:
    """Return the integral of another table beyond the ends of one, times its values there."""
    grid = np.union1d(other_nm, table_nm[[0, -1]])
    height = np.interp(grid, other_nm, other, left=0.0, right=0.0)
    below, above = grid <= table_nm[0], grid >= table_nm[-1]
    return float(
        values[0] * np.trapezoid(height[below], grid[below]) + values[-1] * np.trapezoid(height[above], grid[above])
    )


Weighting = tuple[NDArray[np.float64], NDArray[np.float64]]


def mean_weight(light: Spectrum, above: Weighting, below: Weighting | None = None) -> Quantity:
    """Return ∫ S·a dλ / ∫ S·b dλ with the standard uncertainty that comes from what tables do not state.

    Beyond its ends a weighting, or a light that was sampled, may be as high as at the end, or 0. Between its samples a
    light may be off by as much as every other of them is, and in a gap wider than 20 nm it may all be in one place.
    These are bounds, taken as rectangles.

    Args:
        above: Wavelengths and values of a.
        below: Those of b; None is 1 over the band of the light.
    """
    whole, own = light.integral(*(below or (None, None))), light.integral(*above)
    value = own / whole if whole > 0.0 else 0.0
    if not whole > 0.0:
        return Quantity(value, 0.0, "1")
    off = [light.unknown(*above) / whole, value * (light.unknown(*below) / whole if below else 0.0)]
    if light.is_sampled:
        every = np.arange(light.wavelength_nm.size)
        thinned = list[float]()
        for offset in (0, 1):
            kept = (every % 2 == offset) | (every == 0) | (every == every[-1])
            thin = Spectrum(light.name, light.wavelength_nm[kept], light.power[kept])
            part = thin.integral(*(below or (None, None)))
            thinned.append(thin.integral(*above) / part - value if part > 0.0 else value)
        doubt = math.hypot(*thinned) / math.sqrt(2.0)
        if doubt > 1e-3 * value:  # a line in one entry is somewhere between its neighbours
            doubt = min(doubt, math.hypot(light.in_gaps(above, 0.0), value * light.in_gaps(below, 0.0)) / whole)
        off.append(doubt)
        off += [light.in_gaps(above, COARSEST_NM) / whole, value * light.in_gaps(below, COARSEST_NM) / whole]
    return Quantity(value, math.hypot(*off) / math.sqrt(3.0), "1")


def spectrum(name: str) -> Spectrum:
    """Return a spectrum by name.

    Args:
        name: "equal_energy", "planck:T" (T in K), "cie_d65", "white_led", "display_red", "display_green",
            "display_blue" (a display of 1998). Also "led_b1" … "led_v2", "cie_fl2" … "cie_fl12" and "cie_a" (CIE
            015:2018), "crt_red", "crt_green", "crt_blue". Also "line:NM" (a monochromatic line), "band:NM,FWHM" (a
            Gaussian), "display:TYPE:PRIMARY" (of a display type), or the path of a CSV with the columns
            wavelength in nm and relative power. All but line, band and CSV extend over 380–780 nm.

    Raises:
        InputError: If there is no such spectrum, or the file cannot be used; the message lists the names.
    """
    kind, _, argument = name.partition(":")
    if kind == "equal_energy":
        return Spectrum(name, np.array(BAND_NM), np.ones(2))
    if kind == "planck":
        return _planck(name, _number(name, argument, 500.0, 50_000.0, "K"))
    if kind == "line":
        return Spectrum(name, np.array([_number(name, argument, 200.0, 2000.0, "nm")]), np.ones(1))
    if kind == "band":
        return _band(name, argument)
    if kind == "display":
        return Spectrum(name, *primary_spectrum(*[*argument.split(":"), ""][:2]))
    if kind in _TABULATED:
        wavelengths, columns = table(_TABULATED[kind])
        return Spectrum(name, wavelengths, columns[kind])
    if name.lower().endswith(".csv"):
        return spectrum_from_csv(Path(name))
    raise InputError(f"there is no spectrum {name!r}; choose from {', '.join(SPECTRUM_NAMES)}")


@cache
def table(file: str) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Return (wavelengths in nm, columns by name) of a table that comes with the package."""
    lines = [line for line in (TABLES / file).read_text("utf-8").splitlines() if not line.startswith("#")]
    rows = list(csv.reader(lines))
    numbers = np.array(rows[1:], dtype=np.float64)
    return numbers[:, 0], {name: numbers[:, i] for i, name in enumerate(rows[0]) if i}


def _number(name: str, text: str, low: float, high: float, unit: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise InputError(f"spectrum {name!r}: needs a number from {low:g} to {high:g} {unit} after the colon")
    return value


def _band(name: str, argument: str) -> Spectrum:
    """Return a Gaussian band, such as one colour of an organic or quantum-dot display."""
    peak, _, width = argument.partition(",")
    peak_nm, fwhm_nm = _number(name, peak, 200.0, 2000.0, "nm"), _number(name, width, 0.1, 300.0, "nm after the comma")
    wavelength = np.linspace(peak_nm - 2.0 * fwhm_nm, peak_nm + 2.0 * fwhm_nm, 161)
    return Spectrum(name, wavelength, np.exp(-4.0 * math.log(2.0) * ((wavelength - peak_nm) / fwhm_nm) ** 2))


def _planck(name: str, temperature_k: float) -> Spectrum:
    wavelength = np.arange(BAND_NM[0], BAND_NM[1] + 1.0)
    metres = wavelength * 1e-9
    exponent = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (metres * BOLTZMANN_J_K * temperature_k)
    power = metres**-5 / np.expm1(exponent)
    return Spectrum(name, wavelength, power / power.max())


_WAVELENGTH_NAMES: Final = (
    "wavelength", "wavelengths", "lambda", "wl", "wave", "wellenlange", "wellenlänge", "longueur_d_onde", "λ",
)  # fmt: skip


def spectral_columns(
    path: Path, names: Mapping[str, Sequence[str]]
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Return (wavelengths in nm, rising; values by name) of a table of text.

    Columns are found by their names; a single quantity may have any name where it is the only one next to the
    wavelength. Without a heading the wavelength comes first, then the quantities in the order of the names.

    Args:
        path: The table; any separator, decimal points or commas.
        names: Names of columns by quantity.

    Raises:
        InputError: If the file cannot be read, a column is missing or ambiguous, or its numbers are no spectrum.
    """
    form = f"wavelength_nm,{','.join(names)}"
    table = read_table(path, form)
    places = _places(table, names, form)
    doubts = list[str]()
    columns = {
        name: np.array(finite(table.values(at, quantity, doubts, defined=unit), table, at))
        for name, (at, quantity, unit) in places.items()
    }
    wavelength = columns.pop("wavelength")
    if wavelength.size < 2:
        raise InputError(f"{path}: expected at least two lines of {form}")
    if np.all(np.diff(wavelength) < 0):  # as spectrometers write that disperse from right to left
        wavelength, columns = wavelength[::-1], {name: values[::-1] for name, values in columns.items()}
    if np.any(np.diff(wavelength) <= 0):
        raise InputError(f"{path}: wavelengths must rise from line to line, or fall from line to line")
    if wavelength[0] < 100.0 or wavelength[-1] > 5000.0:
        raise InputError(f"{path}: wavelengths run from {wavelength[0]:g} to {wavelength[-1]:g}; they must be in nm")
    return wavelength, columns


def _places(table: TextTable, names: Mapping[str, Sequence[str]], form: str) -> dict[str, tuple[int, str, str]]:
    """Return column, fact and defined unit by quantity."""
    if not table.header:
        if table.width != 1 + len(names):
            raise InputError(f"{table.path}: {table.width} columns without a heading; expected the columns {form}")
        return {
            name: (n, *kind)
            for n, (name, kind) in enumerate(
                {"wavelength": ("wavelength", "nm"), **dict.fromkeys(names, ("number", "1"))}.items()
            )
        }
    first = table.find_fact("wavelength", _WAVELENGTH_NAMES)
    if first is None:
        raise InputError(
            f"{table.path}: expected two numbers per line or more, and no column is known as the wavelength; it has "
            f"{', '.join(table.header)}: call it wavelength_nm"
        )
    found = {"wavelength": (first, "wavelength", "nm")}
    others = [n for n in range(table.width) if n != first and not table.is_index(n)]
    for name, aliases in names.items():
        at = table.find(aliases)
        if at is None and len(names) == 1 and len(others) == 1:
            at = others[0]
        if at is None:
            raise InputError(
                f"{table.path}: no column is known as {name}; it has {', '.join(table.header)}: keep the columns {form}"
            )
        if _PER_PHOTON.search(table.header[at].lower()) is not None:
            raise InputError(
                f"{table.path}: {table.header[at]!r} is an efficiency per photon; multiply it by the wavelength: a "
                "responsivity is per watt"
            )
        if (other := _OTHER_DENSITY.search(table.header[at].lower())) is not None:
            raise InputError(
                f"{table.path}: {table.header[at]!r} is in {other[0]}; a spectrum needs power per wavelength"
            )
        found[name] = (at, "number", "1")
    return found


_PER_PHOTON: Final = re.compile(r"quantum|(?<![a-z])[ei]?qe(?![a-z])")  # quantum efficiency, as data sheets have it
# Not proportional to power per nm: counts of a detector or of photons, logarithms, densities per wavenumber or Hz.
_OTHER_DENSITY: Final = re.compile(
    r"\bcounts?\b|photons?|quanta|ppfd?\b|absorbance|optical.density"
    r"|[µμu]mol|\bmol\b|einstein|(?:per |/ ?)(?:cm-1|cm\^-1|cm⁻¹|[tg]?hz|ev)\b|\blog(?:10)?\b|\bdb\w*"
)


@bounded_reader(error=InputError)
def spectrum_from_csv(path: Path) -> Spectrum:
    """Return the spectrum, or the spectral response, in a table of wavelength in nm and relative value.

    Args:
        path: File; a heading, comments after #, any separator and decimal commas are allowed.

    Raises:
        InputError: If the file cannot be read, or its numbers are no spectrum.
    """
    names = ("relative_power", "power", "relative", "value", "intensity", "radiance", "spd", "response", "responsivity")
    wavelength, columns = spectral_columns(path, {"relative_power": names})
    power = columns["relative_power"]
    if np.any(power < 0) or not power.any():
        raise InputError(f"{path}: powers must be 0 or more, not all 0")
    return Spectrum(str(path), wavelength, power, is_sampled=True)


def primary_spectrum(kind: str, primary: str) -> tuple[np.ndarray, np.ndarray]:
    """Return wavelengths in nm and relative power of a primary of a display type.

    Args:
        kind: One of DISPLAY_TYPES but crt.
        primary: "red", "green" or "blue".

    Raises:
        InputError: If type or primary is unknown.
    """
    if kind not in LINES or primary not in LINES[kind]:
        raise InputError(f"there is no display type {kind!r}; choose from {', '.join(DISPLAY_TYPES)}")
    wavelength_nm = np.arange(380.0, 781.0, 1.0)
    power = np.zeros_like(wavelength_nm)
    for peak_nm, fwhm_nm, share in LINES[kind][primary]:
        line = 0.5 ** (4.0 * ((wavelength_nm - peak_nm) / fwhm_nm) ** 2)
        power += share * line / line.sum()
    return wavelength_nm, power


def luminous_efficiency(observer: Observer = "photopic") -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (wavelength in nm, relative luminous efficiency) of an observer.

    Args:
        observer: "photopic" for the tabulated CIE 1924 V(λ), "scotopic" for CIE 1951 V′(λ), "photopic_gaussian"
            for the thesis's V(λ) = 1.018·exp(−285.4·(λ/µm − 0.559)²).

    Source: CIE 018:2019; thesis equation (2.9).
    """
    wavelength, columns = table("luminous_efficiency.csv")
    if observer == "photopic_gaussian":
        return wavelength, 1.018 * np.exp(-285.4 * (wavelength * 1e-3 - 0.559) ** 2)
    return wavelength, columns[_COLUMNS[observer]]


def matching_functions() -> tuple[Array, Array]:
    """Return wavelengths in nm, and the colour matching functions x̄, ȳ, z̄ over them, shape (3, wavelengths)."""
    wavelength_nm, columns = table("colour_matching.csv")
    return wavelength_nm, np.stack([columns[name] for name in ("x_bar", "y_bar", "z_bar")])


def luminous_efficacy_lm_per_w(spectrum: Spectrum, observer: Observer = "photopic") -> float:
    """Return the luminous efficacy of radiation in lm/W: K·∫S·V dλ / ∫S dλ over the spectrum's band.

    Args:
        observer: Whose efficiency; K is 683 lm/W photopic, 1700.05 lm/W scotopic.

    Raises:
        InputError: If the spectrum is outside the visible range, or its table states too little of it.
    """
    return luminous_efficacy(spectrum, observer).value


def luminous_efficacy(spectrum: Spectrum, observer: Observer = "photopic") -> Quantity:
    """Return what `luminous_efficacy_lm_per_w` does, with the uncertainty from what its table does not state.

    Raises:
        InputError: As there.
    """
    constant, (low, high) = KM_SCOTOPIC_LM_PER_W if observer == "scotopic" else KM_LM_PER_W, spectrum.band_nm
    efficacy = mean_weight(spectrum, luminous_efficiency(observer)).scaled(constant, "lm W-1")
    if efficacy.value <= 0.0:
        raise InputError(f"spectrum {spectrum.name!r} ({low:g} to {high:g} nm) holds no visible light")
    if observer != "scotopic" and efficacy.u > MOST_UNKNOWN_REL * efficacy.value:
        raise InputError(
            f"spectrum {spectrum.name!r} ({low:g} to {high:g} nm, {spectrum.wavelength_nm.size} entries) leaves its "
            f"luminance unknown to {100 * efficacy.u_rel:.2g} %: state it in finer steps, or further, with 0 where "
            "there is no light"
        )
    return efficacy


def holds_visible_light(spectrum: Spectrum) -> bool:
    """Return whether a spectrum has a luminance that its table states: near-infrared has a radiance only."""
    found = mean_weight(spectrum, luminous_efficiency())
    return found.value > 0.0 and found.u <= MOST_UNKNOWN_REL * found.value


def luminance_cd_m2(radiance_w_sr_m2: float, spectrum: Spectrum, observer: Observer = "photopic") -> float:
    """Return the luminance in cd·m⁻² of a radiance in W·sr⁻¹·m⁻² with a given spectrum."""
    return radiance_w_sr_m2 * luminous_efficacy_lm_per_w(spectrum, observer)


def radiance_w_sr_m2(luminance_cd_m2: float, spectrum: Spectrum, observer: Observer = "photopic") -> float:
    """Return the radiance in W·sr⁻¹·m⁻² of a luminance in cd·m⁻² with a given spectrum.

    Source: L_e = L_v·∫S dλ / (K·∫S·V dλ).
    """
    return luminance_cd_m2 / luminous_efficacy_lm_per_w(spectrum, observer)


def radiance_thesis_w_sr_m2_um(luminance_cd_m2: float) -> float:
    """Return the thesis's conversion of luminance, which is a *spectral* radiance in W·sr⁻¹·m⁻²·µm⁻¹.

    It divides by ∫V dλ in µm, so its result is the radiance per µm of an equal-energy spectrum, not a radiance.

    Source: thesis equation (2.10), L_e = L_v/(683·0.1068).
    """
    return luminance_cd_m2 / (KM_LM_PER_W * 0.1068)


def spectral_mismatch_factor(
    source: Spectrum,
    calibration_source: Spectrum,
    response_nm: NDArray[np.float64],
    response: NDArray[np.float64],
    observer: Observer | None = None,
) -> float:
    """Return what a reading must be multiplied by where the source is not the one of the calibration.

    Args:
        source: Spectrum of the source that is read.
        calibration_source: Spectrum that the scale holds for.
        response_nm: Ascending wavelengths of the camera's spectral response in nm.
        response: Its relative response (per watt).
        observer: Observer for luminance; None for radiance over each spectrum's band.

    Raises:
        InputError: If the camera does not respond to one of the spectra.

    Source: CIE 179:2007, F = [∫S_s·v / ∫S_s·r]·[∫S_c·r / ∫S_c·v] with v = 1 for radiance.
    """
    weighting = luminous_efficiency(observer) if observer else (None, None)
    signal, signal_calibration = (one.integral(response_nm, response) for one in (source, calibration_source))
    if signal <= 0.0 or signal_calibration <= 0.0:
        raise InputError("the camera's spectral response is zero over one of the spectra; extend its table")
    ratio = source.integral(*weighting) / signal
    return ratio * signal_calibration / calibration_source.integral(*weighting)

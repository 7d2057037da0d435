"""Relative spectra of sources by name: what a conversion between luminance and radiance assumes."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.photometry.display_types import primary_spectrum
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.text_table import TextTable, finite, read_table
from radiometer.errors import InputError
from radiometer.units import BOLTZMANN_J_K, PLANCK_J_S, SPEED_OF_LIGHT_M_S

BAND_NM: Final = (380.0, 780.0)
TABLES: Final = Path(__file__).with_name("tables")
_LEDS: Final = ("led_b1", "led_b2", "led_b4", "led_b5", "led_bh1", "led_rgb1", "led_v1", "led_v2")
_CIE: Final = (*_LEDS, "cie_a", "cie_fl2", "cie_fl11", "crt_red", "crt_green", "crt_blue")
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


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Relative spectral power of a source over a stated band.

    Attributes:
        name: Name it is asked for by.
        wavelength_nm: Ascending wavelengths in nm; a single one for a monochromatic line.
        power: Relative power per nm at each, 0 or more.
    """

    name: str
    wavelength_nm: NDArray[np.float64]
    power: NDArray[np.float64]

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


def spectrum(name: str) -> Spectrum:
    """Return a spectrum by name.

    Args:
        name: "equal_energy", "planck:T" (T in K), "cie_d65", "white_led", "display_red", "display_green",
            "display_blue" (a display of 1998). Also "led_b1" … "led_v2" (CIE 015:2018), "cie_a", "cie_fl2", "cie_fl11",
            "crt_red", "crt_green", "crt_blue". Also "line:NM" (a monochromatic line), "band:NM,FWHM" (a Gaussian),
            "display:TYPE:PRIMARY" (of a display type), or the path of a CSV with the columns
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
        if (other := _OTHER_DENSITY.search(table.header[at].lower())) is not None:
            raise InputError(
                f"{table.path}: {table.header[at]!r} is in {other[0]}; a spectrum needs power per wavelength"
            )
        found[name] = (at, "number", "1")
    return found


# Not proportional to power per nm: counts of photons, and densities per wavenumber or frequency.
_OTHER_DENSITY: Final = re.compile(
    r"photons?|quanta|[µμu]mol|\bmol\b|einstein|(?:per |/ ?)(?:cm-1|cm\^-1|cm⁻¹|[tg]?hz|ev)\b|\blog(?:10)?\b|\bdb\w*"
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
    return Spectrum(str(path), wavelength, power)

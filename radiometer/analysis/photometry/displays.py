"""Displays of the known types: the light of their primaries and of their white, over one grid of wavelengths."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Final

import numpy as np

from radiometer.analysis.photometry.photometry import (
    BAND_NM,
    CRT,
    DISPLAY_TYPES,
    KM_LM_PER_W,
    LINES,
    Spectrum,
    matching_functions,
    spectrum,
)
from radiometer.data.mosaic import COLOURS
from radiometer.typing import Array

GRID_NM: Final = np.arange(BAND_NM[0], BAND_NM[1] + 1.0)
# Displays of one type differ: emitters of other makers peak some nm off, and a colour is 30 nm wide by quantum dots or
# a cavity, 75 nm by a phosphor. Lines of ions keep their place; CCFLs show mercury's as well, strongest at 435.8 nm.
_MOVED_NM: Final = (-7.0, 7.0)
_WIDTHS: Final = (0.6, 1.6)
_LINE_NM: Final = 15.0  # full width up to which a part is a line
_WITH_MERCURY: Final = "ccfl_lcd"
_MERCURY: Final = (435.8, 5.0, 0.3)  # in its blue: peak and full width in nm, power over that of the rest
_LEAKS: Final = (0.0, 2.0)  # of a primary's minor parts: other filters pass none or twice of a neighbour's light
_PHOSPHORS_NM: Final = (-2.0, 2.0)  # cathode-ray tubes share their phosphors but for batches and spectrometers


def on_grid(light: Spectrum) -> Array:
    """Return the power of a light at `GRID_NM`; a monochromatic line has it at the nearest wavelength."""
    if light.wavelength_nm.size > 1:
        return np.asarray(np.interp(GRID_NM, light.wavelength_nm, light.power, left=0.0, right=0.0))
    return np.asarray(np.round(light.wavelength_nm[0]) == GRID_NM, dtype=np.float64)


def tristimulus_of(powers: Array) -> Array:
    """Return X, Y, Z of powers over `GRID_NM`, shape (lights, 3)."""
    wavelength_nm, functions = matching_functions()
    weights = np.stack([np.interp(GRID_NM, wavelength_nm, one) for one in functions])
    return np.asarray(KM_LM_PER_W * powers @ weights.T)


def display_primaries(kind: str) -> list[Array]:
    """Return the primaries of displays of a type, shape (3, wavelengths) each: the usual one, then others."""
    if kind == CRT:
        usual = np.stack([on_grid(spectrum(f"{CRT}_{one}")) for one in COLOURS])
        return [usual, *(np.stack([np.interp(GRID_NM - off, GRID_NM, row) for row in usual]) for off in _PHOSPHORS_NM)]
    usual = np.stack([_primary(LINES[kind][one]) for one in COLOURS])
    found = [usual]
    for n, name in enumerate(COLOURS):
        main, *minor = LINES[kind][name]
        changed = [_primary((main, *minor), moved_nm=off) for off in _MOVED_NM]
        for leak in _LEAKS if minor else ():
            changed.append(_primary((main, *((peak, width, leak * share) for peak, width, share in minor))))
        if kind == _WITH_MERCURY and name == "blue":
            changed.append(_primary((*LINES[kind][name], _MERCURY)))
        found += [np.stack([one if at == n else usual[at] for at in range(3)]) for one in changed]
    return found + [np.stack([_primary(LINES[kind][one], wider=factor) for one in COLOURS]) for factor in _WIDTHS]


@cache
def display_whites() -> dict[str, Array]:
    """Return whites of the colour of daylight D65 by type of display, shape (displays, wavelengths) each."""
    white = tristimulus_of(on_grid(spectrum("cie_d65"))[None])[0]
    return {
        kind: np.stack([np.linalg.solve(tristimulus_of(one).T, white) @ one for one in display_primaries(kind)])
        for kind in DISPLAY_TYPES
    }


def _primary(parts: Sequence[tuple[float, float, float]], moved_nm: float = 0.0, wider: float = 1.0) -> Array:
    """Return the power of a primary; its parts that are no lines are moved and wider."""
    found = np.zeros(GRID_NM.size)
    for peak, width, share in parts:
        off, factor = (0.0, 1.0) if width <= _LINE_NM else (moved_nm, wider)
        bell = 0.5 ** (4.0 * ((GRID_NM - peak - off) / (factor * width)) ** 2)
        found += share * bell / bell.sum()
    return found

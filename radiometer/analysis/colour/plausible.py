"""Lights that people measure and cameras that they use, for the error of a matrix outside its training set."""

from __future__ import annotations

import itertools
import math
from functools import cache
from typing import Final

import numpy as np

from radiometer.analysis.photometry.displays import GRID_NM, display_primaries, on_grid, tristimulus_of
from radiometer.analysis.photometry.photometry import DISPLAY_TYPES, FLUORESCENT, KINDS, spectrum
from radiometer.typing import Array

SURFACES: Final = "surfaces"
# Lights that surfaces are seen under: lamps of each kind, and daylight.
_LIGHTS: Final = (
    "cie_d65", "cie_a", "led_b1", "led_b5", "led_rgb1", "led_v1", "cie_fl2", "cie_fl7", "cie_fl11", "cie_fl12",
)  # fmt: skip
_EDGES_NM: Final = (480.0, 520.0, 560.0, 600.0, 640.0)  # where pigments begin or cease to reflect
_EDGE_WIDTHS_NM: Final = (8.0, 25.0)  # of the logistic: from sharp (cadmium red) to soft (skin, foliage)
_BUMPS_NM: Final = (450.0, 500.0, 550.0, 600.0)
_BUMP_NM: Final = 45.0  # standard deviation of a blue, green or purple pigment's band
_DARK, _BRIGHT = 0.05, 0.75  # reflectances of coloured surfaces
_DRIVES: Final = (0.0, 0.3, 1.0)  # of a display's primaries in mixtures
# Colour cameras: peaks of the quantum efficiency in nm, full widths at half maximum, and what leaks through a filter
# elsewhere. Source: data sheets of Sony Pregius colour sensors; Jiang et al. 2013, IEEE WACV, 168 (28 cameras).
_PEAKS_NM: Final = (605.0, 535.0, 460.0)
_WIDTHS_NM: Final = (85.0, 95.0, 80.0)
_LEAK: Final = 0.04
_SHIFTS_NM: Final = (-10.0, 0.0, 10.0)
_WIDER: Final = (0.75, 0.85, 1.0)
_CUT_NM, _CUT_WIDTH_NM = 670.0, 8.0  # infrared filter


@cache
def plausible_lights() -> dict[str, Array]:
    """Return powers over `GRID_NM` by kind of light, shape (lights, wavelengths) each.

    The kinds are lamps, daylight, single LEDs, types of display (primaries and mixtures), and surfaces under lamps.
    """
    lamps = {name.lower().replace(" ", "_"): names for name, names in KINDS.items() if "screen" not in name}
    found = {kind: np.stack([on_grid(spectrum(name)) for name in names]) for kind, names in lamps.items()}
    planck = {"incandescent_lamps": range(2000, 3501, 250), "daylight": range(5000, 10001, 1000)}
    for kind, temperatures in planck.items():
        found[kind] = np.vstack([found[kind], *(on_grid(spectrum(f"planck:{one}")) for one in temperatures)])
    found["fluorescent_lamps"] = np.stack([on_grid(spectrum(name)) for name in FLUORESCENT])
    found["white_leds"] = np.vstack([found["white_leds"], _mixed_white()])
    found["coloured_leds"] = np.stack(
        [on_grid(spectrum(f"band:{peak},{width}")) for peak in range(430, 661, 10) for width in (18, 32)]
    )
    for kind in DISPLAY_TYPES:
        usual, *others = display_primaries(kind)
        found[kind] = np.vstack([_mixtures(usual, _DRIVES), *(_mixtures(one, (0.0, 1.0)) for one in others)])
    lights = np.stack([on_grid(spectrum(name)) for name in _LIGHTS])
    found[SURFACES] = (lights[:, None, :] * _reflectances()).reshape(-1, GRID_NM.size)
    return found


def _mixed_white() -> Array:
    """Return lamps of a blue, a green and a red LED that have the colour of a Planckian radiator."""
    found = []
    for peaks in itertools.product((450, 465), (525, 545), (610, 630)):
        leds = np.stack([on_grid(spectrum(f"band:{peak},25")) for peak in peaks])
        for temperature in (3000, 5000):
            white = tristimulus_of(on_grid(spectrum(f"planck:{temperature}"))[None])[0]
            found.append(np.linalg.solve(tristimulus_of(leds).T, white) @ leds)
    return np.stack(found)


def _mixtures(primaries: Array, steps: tuple[float, ...]) -> Array:
    """Return the primaries of a display in all mixtures of some drives but black; alike in power at full drive."""
    alike = primaries / primaries.sum(axis=1, keepdims=True)
    drives = [drive for drive in itertools.product(steps, repeat=len(primaries)) if any(drive)]
    return np.asarray(np.array(drives) @ alike)


def _reflectances() -> Array:
    """Return smooth reflectances: pigments that begin or cease to reflect, bands, gaps, and grey."""
    edges = [
        1.0 / (1.0 + np.exp(way * (GRID_NM - edge) / width))
        for edge in _EDGES_NM
        for width in _EDGE_WIDTHS_NM
        for way in (-1.0, 1.0)
    ]
    bumps = [np.exp(-0.5 * ((GRID_NM - centre) / _BUMP_NM) ** 2) for centre in _BUMPS_NM]
    shapes = np.stack([*edges, *bumps, *(1.0 - one for one in bumps), np.full(GRID_NM.size, 0.5)])
    return _DARK + (_BRIGHT - _DARK) * shapes


@cache
def plausible_cameras() -> Array:
    """Return responsivities per watt of colour cameras over `GRID_NM`, shape (cameras, 3, wavelengths)."""
    cut = 1.0 / (1.0 + np.exp((GRID_NM - _CUT_NM) / _CUT_WIDTH_NM))
    found = []
    for shift, wider in itertools.product(_SHIFTS_NM, _WIDER):
        bells = [
            np.exp(-4.0 * math.log(2.0) * ((GRID_NM - peak - shift) / (wider * width)) ** 2)
            for peak, width in zip(_PEAKS_NM, _WIDTHS_NM, strict=True)
        ]
        found.append(GRID_NM * cut * (_LEAK + (1.0 - _LEAK) * np.stack(bells)))
    return np.stack(found)

"""Responses that a camera may have where its own is not known, and how far they leave a reading in doubt."""

from __future__ import annotations

import itertools
import math
from functools import cache
from typing import Final

import numpy as np

from radiometer.analysis.photometry.photometry import KINDS, Observer, spectral_mismatch_factor, spectrum
from radiometer.data import SpectralResponse
from radiometer.data.mosaic import COLOURS, LUMA
from radiometer.typing import Array

_SILICON_NM: Final = (500.0, 550.0, 600.0)  # assumed: silicon behind a lens and an infrared filter peaks between these
_HALF_WIDTH_NM: Final = 150.0  # assumed distance from the peak to half of it
# Colour cameras: peaks of the quantum efficiency in nm, full widths at half maximum, and what leaks through a filter
# elsewhere. Source: data sheets of Sony Pregius colour sensors; Jiang et al. 2013, IEEE WACV, 168 (28 cameras).
_PEAKS_NM: Final = (605.0, 535.0, 460.0)
_WIDTHS_NM: Final = (85.0, 95.0, 80.0)
_LEAK: Final = 0.04
_SHIFTS_NM: Final = (-10.0, 0.0, 10.0)
_WIDER: Final = (0.75, 0.85, 1.0)
_CUT_NM, _CUT_WIDTH_NM = 670.0, 8.0  # infrared filter
_WHITES: Final = ("cie_d65", "cie_a")  # lights that photographs are balanced for
_Table = tuple[tuple[float, ...], tuple[float, ...]]  # wavelengths in nm, and the response per watt at each


def colour_cameras(wavelength_nm: Array) -> Array:
    """Return responsivities per watt that colour cameras may have, shape (cameras, 3, wavelengths)."""
    cut = 1.0 / (1.0 + np.exp((wavelength_nm - _CUT_NM) / _CUT_WIDTH_NM))
    found = []
    for shift, wider in itertools.product(_SHIFTS_NM, _WIDER):
        bells = [
            np.exp(-4.0 * math.log(2.0) * ((wavelength_nm - peak - shift) / (wider * width)) ** 2)
            for peak, width in zip(_PEAKS_NM, _WIDTHS_NM, strict=True)
        ]
        found.append(wavelength_nm * cut * (_LEAK + (1.0 - _LEAK) * np.stack(bells)))
    return np.stack(found)


def _of_colour(wavelength_nm: Array, colour: str) -> Array:
    """Return the responsivities that one colour of photographs and mosaics may have, shape (cameras, wavelengths).

    A luminance is the luma of the sensor's own numbers, or of numbers that are balanced for daylight or a lamp.
    """
    cameras = colour_cameras(wavelength_nm)
    if colour in COLOURS:
        return np.asarray(cameras[:, COLOURS.index(colour)])
    whites = [[[spectrum(name).integral(wavelength_nm, one) for one in own] for own in cameras] for name in _WHITES]
    balanced = [cameras / np.array(white)[..., np.newaxis] for white in whites]
    return np.vstack([np.tensordot(LUMA, one, (0, 1)) for one in (cameras, *balanced)])


def _plausible(colours: tuple[str, ...]) -> tuple[Array, Array]:
    """Return wavelengths in nm, and responses per watt of pixels that may be of some colours, a row each.

    Without colours they are those of silicon behind a lens. It counts photons with a quantum efficiency that is flat,
    or falls by a half to 400 and to 700 nm from a peak. The peak is at 500, 550 or 600 nm, as EMVA 1288 data sheets of
    monochrome sensors show.
    """
    wavelength = np.arange(200.0, 1101.0, 5.0)
    if colours:
        return wavelength, np.vstack([_of_colour(wavelength, one) for one in colours])
    bells = [np.exp(-math.log(2.0) * ((wavelength - peak) / _HALF_WIDTH_NM) ** 2) for peak in _SILICON_NM]
    return wavelength, wavelength * np.stack([np.ones_like(wavelength), *bells])


def unknown_mismatch_u_rel(source: str, of_scale: str, colours: tuple[str, ...] = ()) -> float:
    """Return the relative standard uncertainty of light of another spectrum, read with an unknown response.

    It is the root of the mean square of F − 1 over plausible responses, where F would correct the reading.

    Args:
        source: Name of the spectrum that is read.
        of_scale: Name of the spectrum of the calibration.
        colours: Colours that the pixels may be of, or "luminance"; none of a sensor without filters.
    """
    return _spread(of_scale, ((source,),), None, None, colours)


def unstated_light_u_rel(
    assumed: str, response: SpectralResponse | None, observer: Observer | None = None, colours: tuple[str, ...] = ()
) -> float:
    """Return the relative standard uncertainty of a reading whose light is treated as `assumed` and may be any kind.

    It is the root of the mean square of F − 1, where F is the factor that would correct the reading. The mean is over
    the kinds of light, and over plausible responses where the camera's is not known.

    Args:
        assumed: Name of the spectrum that the reading is made for.
        response: The camera's spectral response; None where unknown.
        observer: For a luminance, the observer; None for a radiance.
        colours: Colours that the pixels may be of, or "luminance"; none of a sensor without filters.
    """
    kinds = tuple(KINDS.values())
    known = None if response is None else (response.wavelength_nm, response.relative)
    # A table that ends before this light says nothing of it.
    if response is None or known is None or spectrum(assumed).integral(*map(np.array, known)) <= 0.0:
        return _spread(assumed, kinds, None, observer, colours)
    return math.hypot(_spread(assumed, kinds, known, observer), response.u_rel)


@cache
def _spread(
    assumed: str,
    kinds: tuple[tuple[str, ...], ...],
    known: _Table | None,
    observer: Observer | None,
    colours: tuple[str, ...] = (),
) -> float:
    wavelength, responses = _plausible(colours) if known is None else (np.array(known[0]), np.array([known[1]]))
    reference = spectrum(assumed)
    of_kinds = [
        np.mean(
            [
                (spectral_mismatch_factor(spectrum(name), reference, wavelength, response, observer) - 1.0) ** 2
                for name in names
                for response in responses
            ]
        )
        for names in kinds
    ]
    return float(np.sqrt(np.mean(of_kinds)))

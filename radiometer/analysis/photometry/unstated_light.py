"""The error of a reading whose kind of light is not stated."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np

from radiometer.analysis.photometry.photometry import Observer, spectral_mismatch_factor
from radiometer.analysis.photometry.spectra import spectrum
from radiometer.data import SpectralResponse
from radiometer.typing import Array

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
_PEAKS_NM: Final = (500.0, 550.0, 600.0)
_HALF_WIDTH_NM: Final = 150.0


def plausible_responses() -> tuple[Array, tuple[Array, ...]]:
    """Return wavelengths in nm, and responses per watt that a silicon sensor behind a lens may have.

    They count photons with a quantum efficiency that is flat, or falls by a half to 400 and to 700 nm from a peak.
    The peak is at 500, 550 or 600 nm, as EMVA 1288 data sheets of monochrome sensors show.
    """
    wavelength = np.arange(200.0, 1101.0, 5.0)
    bells = (np.exp(-math.log(2.0) * ((wavelength - peak) / _HALF_WIDTH_NM) ** 2) for peak in _PEAKS_NM)
    return wavelength, (wavelength, *(wavelength * bell for bell in bells))


def unstated_light_u_rel(assumed: str, response: SpectralResponse | None, observer: Observer | None = None) -> float:
    """Return the relative standard uncertainty of a reading whose light is treated as `assumed` and may be any kind.

    It is the root of the mean square of F − 1, where F is the factor that would correct the reading. The mean is over
    the kinds of light, and over plausible responses where the camera's is not known.

    Args:
        assumed: Name of the spectrum that the reading is made for.
        response: The camera's spectral response; None where unknown.
        observer: For a luminance, the observer; None for a radiance.
    """
    if response is None:
        return _spread(assumed, None, observer)
    known = (response.wavelength_nm, response.relative)
    if spectrum(assumed).integral(np.array(known[0]), np.array(known[1])) <= 0.0:
        return _spread(assumed, None, observer)  # the table ends before this light: it says nothing of it
    return math.hypot(_spread(assumed, known, observer), response.u_rel)


@cache
def _spread(
    assumed: str, known: tuple[tuple[float, ...], tuple[float, ...]] | None, observer: Observer | None
) -> float:
    wavelength, responses = plausible_responses()
    if known is not None:
        wavelength, responses = np.array(known[0]), (np.array(known[1]),)
    reference = spectrum(assumed)
    of_kinds = [
        np.mean(
            [
                (spectral_mismatch_factor(spectrum(name), reference, wavelength, response, observer) - 1.0) ** 2
                for name in names
                for response in responses
            ]
        )
        for names in KINDS.values()
    ]
    return float(np.sqrt(np.mean(of_kinds)))

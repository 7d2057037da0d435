"""Spectra of displays' primaries by type, as sums of lines, for displays without a measured spectrum.

Peaks, widths and shares are those usual for the kind (Lee, Liu and Wu 2008, Introduction to Flat Panel Displays; not
verified line by line); `crt` is the typical CRT of Brainard 1997. Luminous efficacies of single displays scatter about
these by some 10 %, the blue's by 25 %.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from radiometer.errors import InputError

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

"""ICC profile of a screen: a matrix of its chromaticities and a tone curve for each primary, written by Little CMS."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.errors import CalibrationError, required_library
from radiometer.numbers import with_u
from radiometer.screen.calibration import LUMINANCE, ChannelCurve, ScreenCalibration
from radiometer.typing import Array

_PRIMARIES: Final = ("red", "green", "blue")
_ENTRIES: Final = 4096  # Little CMS takes 65,530 at most; 12 bits are more than screens show


def to_icc(calibration: ScreenCalibration) -> bytes:
    """Return the profile, of version 4: white, primaries and tone curves above black.

    Raises:
        CalibrationError: If a chromaticity is unknown or impossible, or a tone curve was not measured from end to end.
        MissingLibrary: If imagecodecs is not installed.

    Source: ICC.1:2022, three-component matrix-based profiles; cmsCreateRGBProfile of Little CMS.
    """
    check_profile(calibration.name, calibration.chromaticities)
    known = calibration.chromaticities
    curves = np.array([_tone_curve(curve) for curve in _curves(calibration)])
    content = _library().cms_profile(
        "rgb",
        whitepoint=known["grey"],
        primaries=[value for name in _PRIMARIES for value in known[name]],
        transferfunction=np.rint(curves * 65535).astype(np.uint16),
    )
    return bytes(content)


def check_profile(screen: str, chromaticities: Mapping[str, tuple[float, float]]) -> None:
    """Check that a screen's chromaticities make a profile. Raises CalibrationError, MissingLibrary."""
    unknown = [name for name in ("grey", *_PRIMARIES) if name not in chromaticities]
    if unknown:
        raise CalibrationError(
            f"screen {screen}: an ICC profile states chromaticities, and {', '.join(unknown)} has none. Measure them "
            "with a colorimeter and calibrate the screen with --chromaticities"
        )
    if np.any(_shares(chromaticities) <= 0.0):
        raise CalibrationError(
            f"screen {screen}: no light of red, green and blue together has the chromaticity of grey. Correct the "
            "chromaticities"
        )
    _library()


def profile_notes(calibration: ScreenCalibration) -> list[str]:
    """Return what the profile assumes and how well its tone curves are known, a line each."""
    u = max(_u_of_white(curve) for curve in _curves(calibration))
    assumed = [name for name in _PRIMARIES if name not in calibration.channels]
    return [
        f"ICC profile: it holds light above black, and no uncertainty. Its tone curves are within {200 * u:.2g} % of "
        "white (k = 2)",
        *([f"ICC profile: {', '.join(assumed)} was not measured and has the tone curve of grey"] if assumed else []),
        *_contradictions(calibration),
    ]


def _contradictions(calibration: ScreenCalibration) -> list[str]:
    """Return where the luminances that were measured contradict the chromaticities, a line each."""
    grey, lines = calibration.channel("grey"), []
    white = grey.at(grey.levels[-1], LUMINANCE)
    for name, share in zip(_PRIMARIES, _shares(calibration.chromaticities), strict=True):
        if name not in calibration.channels:
            continue
        curve = calibration.channel(name)
        shown = curve.at(curve.levels[-1], LUMINANCE)
        measured = shown.value / white.value
        expanded = 2 * measured * math.hypot(shown.u / shown.value, white.u / white.value)
        if abs(measured - share) > expanded:
            lines.append(
                f"ICC profile: the chromaticities give {name} {100 * share:.3g} % of the luminance of white, and "
                f"{with_u(100 * measured, 100 * expanded, '%', k=2)} was measured. Check chromaticities and spectra"
            )
    return lines


def _library() -> Any:
    return required_library("imagecodecs", "ICC profiles need imagecodecs: pip install 'radiometer[icc]'")


def _shares(chromaticities: Mapping[str, tuple[float, float]]) -> Array:
    """Return the shares of red, green and blue in the luminance of white, shape (3,); 0 if they make no white."""
    white, *primaries = (_xyz(chromaticities[name]) for name in ("grey", *_PRIMARIES))
    try:
        return np.asarray(np.linalg.solve(np.transpose(primaries), white), dtype=np.float64)
    except np.linalg.LinAlgError:  # two of the primaries are one, or all three are on one line
        return np.zeros(3)


def _xyz(xy: tuple[float, float]) -> tuple[float, float, float]:
    return xy[0] / xy[1], 1.0, (1.0 - xy[0] - xy[1]) / xy[1]


def _curves(calibration: ScreenCalibration) -> list[ChannelCurve]:
    """Return the curves of red, green and blue; grey replaces a primary that was not measured."""
    grey = calibration.channel("grey")
    return [calibration.channels.get(name, grey) for name in _PRIMARIES]


def _tone_curve(curve: ChannelCurve) -> NDArray[np.float64]:
    """Return the light above black as a share of white's, at evenly spaced levels. Raises CalibrationError."""
    black, white = curve.table.values[0], curve.table.values[-1]
    if (curve.levels[0], curve.levels[-1]) != (0, curve.top_level) or not white > black:
        raise CalibrationError(
            f"channel {curve.name}: rises from level {curve.levels[0]} to {curve.levels[-1]}; an ICC profile needs "
            f"levels 0 to {curve.top_level}. Calibrate the screen with both"
        )
    levels = np.linspace(0.0, 1.0, min(curve.top_level + 1, _ENTRIES))
    return np.asarray((curve.table.at(levels) - black) / (white - black), dtype=np.float64)


def _u_of_white(curve: ChannelCurve) -> float:
    """Return the largest standard uncertainty of the tone curve as a share of white; what all levels share cancels."""
    white = float(curve.table.values[-1])
    top = curve.u_shape_at(curve.levels[-1]) / white
    levels = np.linspace(curve.levels[0], curve.levels[-1], 256)
    return max(math.hypot(curve.u_shape_at(n) / white, top * float(curve.radiance_at(n).value) / white) for n in levels)

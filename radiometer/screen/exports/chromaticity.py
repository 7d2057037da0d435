"""Tristimulus values behind a luminance, of a stated or assumed chromaticity: a grey camera does not see colour."""

from __future__ import annotations

from typing import Final

from radiometer.screen.calibration import ScreenCalibration

# IEC 61966-2-1 (sRGB): primaries of ITU-R BT.709 and the white point D65.
ASSUMED_XY: Final[dict[str, tuple[float, float]]] = {
    "grey": (0.3127, 0.3290),
    "red": (0.640, 0.330),
    "green": (0.300, 0.600),
    "blue": (0.150, 0.060),
}
ASSUMPTION: Final = "X and Z assume the chromaticities of sRGB (IEC 61966-2-1); only Y was measured"


def assumption_of(calibration: ScreenCalibration) -> str | None:
    """Return what the tristimulus values of a calibration assume; None where all chromaticities are known."""
    return None if set(calibration.channels) <= set(calibration.chromaticities) else ASSUMPTION


def xyz_of(calibration: ScreenCalibration, channel: str, luminance_cd_m2: float) -> tuple[float, float, float]:
    """Return X, Y and Z in cd·m⁻² of a luminance in a channel's known, else assumed, chromaticity."""
    x, y = _xy_of(calibration, channel)
    return luminance_cd_m2 * x / y, luminance_cd_m2, luminance_cd_m2 * (1 - x - y) / y


def argyll_line(calibration: ScreenCalibration, channel: str, luminance_cd_m2: float) -> str:
    """Return the line that ArgyllCMS's spotread prints for a reading, with -x: XYZ and Yxy.

    Source: the printf of spotread.c, ` Result is XYZ: %f %f %f, Yxy: %f %f %f`.
    """
    big = xyz_of(calibration, channel, luminance_cd_m2)
    x, y = _xy_of(calibration, channel)
    return f" Result is XYZ: {big[0]:f} {big[1]:f} {big[2]:f}, Yxy: {luminance_cd_m2:f} {x:f} {y:f}"


def _xy_of(calibration: ScreenCalibration, channel: str) -> tuple[float, float]:
    return calibration.chromaticities.get(channel, ASSUMED_XY[channel])

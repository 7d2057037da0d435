"""Plain tables: what was measured, and level by target."""

from __future__ import annotations

from typing import Final

import numpy as np

from radiometer.screen.calibration import LUMINANCE, SCOTOPIC, ScreenCalibration

_HEADER: Final = (
    "channel,level,drive,radiance_W_per_sr_m2,u_radiance_W_per_sr_m2,luminance_cd_m2,u_luminance_cd_m2,"
    "scotopic_luminance_cd_m2,below_detection"
)
_INVERSE_HEADER: Final = "channel,target_luminance_cd_m2,level,luminance_cd_m2,u_luminance_cd_m2"
_INVERSE_STEPS: Final = 256  # one per level of 8 bits


def to_csv(calibration: ScreenCalibration) -> str:
    """Return one row per measured level of every channel."""
    lines = [_HEADER]
    for name, curve in calibration.channels.items():
        for level in curve.levels:
            radiance, luminance = curve.radiance_at(level), curve.at(level, LUMINANCE)
            scotopic = curve.at(level, SCOTOPIC).value
            lines.append(
                f"{name},{level},{level / curve.top_level:.6f},{radiance.value:.6g},{radiance.u:.3g},"
                f"{luminance.value:.6g},{luminance.u:.3g},{scotopic:.6g},{int(curve.radiance_is_lost(level))}"
            )
    return "\n".join(lines) + "\n"


def to_inverse_csv(calibration: ScreenCalibration) -> str:
    """Return the level to show for 256 luminances from black to white of every channel, spaced in the square root."""
    lines = [_INVERSE_HEADER]
    for name, curve in calibration.channels.items():
        low, high = (curve.at(curve.levels[i], LUMINANCE).value for i in (0, -1))
        for root in np.linspace(np.sqrt(low), np.sqrt(high), _INVERSE_STEPS):
            target = float(np.clip(root**2, low, high))
            level = curve.level_for(target, LUMINANCE)
            shown = curve.at(level, LUMINANCE)
            lines.append(f"{name},{target:.6g},{level},{shown.value:.6g},{shown.u:.3g}")
    return "\n".join(lines) + "\n"

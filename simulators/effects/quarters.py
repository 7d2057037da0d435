"""What differs between the quarters of a sensor that four amplifiers read, or between its halves."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from simulators.effects.context import ExposureContext

# Starting points: halves side by side, halves on top of each other, and one quarter of four.
ARRANGEMENTS: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.5, 0.5, 0.5))


def trials(sizes: tuple[float, ...], names: tuple[str, str, str]) -> tuple[dict[str, float], ...]:
    """Return starts of each size in each arrangement, for parameters of these names."""
    return tuple(
        {name: size * part for name, part in zip(names, parts, strict=True)} for size in sizes for parts in ARRANGEMENTS
    )


def by_quarter(context: ExposureContext, across: float, along: float, corner: float) -> Any:
    """Return a·s_x + b·s_y + c·s_x·s_y, s −1 in the left and upper half of the sensor and 1 in the other.

    Args:
        across: a, half the difference between right and left.
        along: b, half the difference between below and above.
        corner: c, which one diagonal has more than the other.
    """
    geometry = context.geometry
    right = np.where(geometry.x_px < 0.5 * (geometry.sensor_width - 1), -1.0, 1.0)
    below = np.where(geometry.y_px < 0.5 * (geometry.sensor_height - 1), -1.0, 1.0)
    return across * right + along * below + corner * right * below


def has_several_amplifiers(context: ExposureContext) -> bool:
    """Return whether the camera is described with taps: one amplifier has no quarters that could differ."""
    return len(context.camera.taps or ()) > 1

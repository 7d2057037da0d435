"""What differs between the taps of a sensor: its quarters that four amplifiers read, its halves, or any others."""

from __future__ import annotations

from typing import Any, ClassVar, Final, Self

import numpy as np

from simulators.effects.catalogue import CatalogueEffect
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


class OfTaps(CatalogueEffect):
    """An effect whose size is even within each tap: of quarters and halves by three parameters, of others by a table.

    Attributes:
        table: Name of the parameter that holds a size for every tap that the camera describes, in its order.
        table_start: Size of each tap from which a table starts.
        first_fitted: First tap whose size is fitted: the second where only differences count.
    """

    table: ClassVar[str]
    table_start: ClassVar[float] = 0.0
    first_fitted: ClassVar[int] = 1

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether the camera is described with taps: one amplifier has none that could differ."""
        return len(context.camera.taps or ()) > 1

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the table where some taps share a quarter of the sensor."""
        taps, geometry = context.camera.taps or (), context.geometry
        quarters = {
            (2 * tap.x + tap.width < geometry.sensor_width, 2 * tap.y + tap.height < geometry.sensor_height)
            for tap in taps
        }
        return (cls(**{cls.table: (cls.table_start,) * len(taps)}),) if len(taps) > len(quarters) else ()

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the table where there is one, from `first_fitted` on."""
        sizes = getattr(self, self.table)
        return (
            tuple(f"{self.table}[{index}]" for index in range(self.first_fitted, len(sizes))) if sizes else self.fitted
        )

    def sizes(self, context: ExposureContext) -> Any:
        """Return the size at every place, less the mean of the taps."""
        sizes = getattr(self, self.table)
        if not sizes:
            return by_quarter(context, *(getattr(self, name) for name in self.fitted))
        x, y = context.geometry.x_px, context.geometry.y_px
        found = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
        for tap, size in zip(context.camera.taps or (), sizes, strict=True):
            across = (x > tap.x - 0.5) & (x < tap.x + tap.width - 0.5)  # pixels have whole numbers in their middle
            found = np.where(across & (y > tap.y - 0.5) & (y < tap.y + tap.height - 0.5), size - np.mean(sizes), found)
        return found

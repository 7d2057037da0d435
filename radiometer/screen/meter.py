"""Meter of the screen: anything that gives a radiance with its two kinds of uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class ScreenReading:
    """One reading of a patch on the screen."""

    radiance: float  # radiance in W·sr⁻¹·m⁻²
    u_independent: float  # standard uncertainty in W·sr⁻¹·m⁻² of what differs from reading to reading (noise, dark)
    u_common_rel: float  # relative standard uncertainty of what all readings share (scale, lens)
    time_s: float  # when it was taken, in s on the meter's steady clock
    flags: tuple[str, ...] = ()  # what must be known of it, as in a Reading


class Meter(Protocol):
    """Reads the patch that it looks at."""

    def read(self) -> ScreenReading:
        """Return one reading. Raises DeviceError, MeasurementError."""

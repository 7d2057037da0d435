"""The camera as a photometer that PsychoPy's calibration knows how to ask: `getLum()`."""

from __future__ import annotations

from typing import Final

from radiometer.screen.meter import Meter


class RadiometerPhotometer:
    """A photometer for PsychoPy's `monitors.getLumSeries(photometer=…)`.

    Args:
        meter: Reads the middle of the screen.
        lm_per_w: Luminous efficacy of the screen's light.

    Source: psychopy.hardware photometer classes: `getLum()` returns cd·m⁻² and leaves it in `lastLum`; a series
    asks for `OK` and `type`.
    """

    longName: Final = "radiometer camera"  # noqa: N815 (PsychoPy's name)
    driverFor: Final = ("radiometer",)  # noqa: N815 (PsychoPy's name)

    def __init__(self, meter: Meter, lm_per_w: float) -> None:
        self._meter, self._lm_per_w = meter, lm_per_w
        self.type, self.OK = "radiometer", True
        self.lastLum: float | None = None

    def getLum(self) -> float:  # noqa: N802 (PsychoPy's name)
        """Measure and return the luminance in cd·m⁻². Raises DeviceError, MeasurementError."""
        self.lastLum = self._meter.read().radiance * self._lm_per_w
        return self.lastLum

    def getInfo(self) -> str:  # noqa: N802 (PsychoPy's name)
        """Return what answers."""
        return self.longName

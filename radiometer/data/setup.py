"""The measuring setup and the measured light: one object from the frames to a map or a reading."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, field, replace
from typing import Final

from radiometer.data.calibration import Calibration
from radiometer.data.capture_header import CameraDescription, LensDescription, SourceDescription

# Of the light's spectrum: that of the calibration, as somebody states.
AS_CALIBRATED: Final = "as calibrated"


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Camera, lens and calibration in use, and what is known of the light."""

    camera: CameraDescription  # the camera in use
    lens: LensDescription = field(default_factory=LensDescription)  # the lens in use
    # The camera's calibration, with the light's spectrum where that is stated; None gives relative values
    calibration: Calibration | None = None
    source: SourceDescription | None = None  # what is known of the light
    # Name of the light's spectrum, or path of a CSV; `AS_CALIBRATED`; None where only the source may state it. Where it
    # does not either, all kinds of light count in the uncertainty
    spectrum: str | None = AS_CALIBRATED
    # When the frames were taken, with time zone: the calibration's age counts to it; None where that is not known, and
    # the age counts to the present
    taken: dt.datetime | None = None

    def __post_init__(self) -> None:
        if self.spectrum is None and self.source is not None:
            object.__setattr__(self, "spectrum", self.source.spectrum)
        if self.calibration is not None and self.spectrum not in (None, AS_CALIBRATED):
            object.__setattr__(self, "calibration", replace(self.calibration, spectrum=self.spectrum))

    @property
    def polarised(self) -> bool | None:
        """Return whether the light is polarised: a screen's is where nothing else is stated; None where unknown."""
        if self.source is None:
            return None
        return True if self.source.polarised is None and self.source.kind == "screen" else self.source.polarised

    @property
    def spectrum_stated(self) -> bool:
        """Return whether somebody states the light's spectrum."""
        return self.spectrum is not None

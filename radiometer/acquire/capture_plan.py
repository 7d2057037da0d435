"""Capture plans: files that say which frames to take, such as the next capture that a reconciliation asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

from pydantic import Field

from radiometer.data import Frame
from radiometer.data.storage import read_yaml
from radiometer.data.validation import FileSection, validate
from radiometer.devices import Camera
from radiometer.errors import UsageError

FORMAT = "radiometer-plan/1"


class PlannedFrames(FileSection):
    """Frames at one setting; what is missing stays as the bench has it."""

    exposure_s: float = Field(gt=0)
    gain_db: float = 0.0
    f_number: float | None = Field(None, gt=0)
    source_level: float = Field(1.0, ge=0)
    pattern: str = "default"
    shutter: Literal["open", "closed"] = "open"
    repeat: int = Field(1, ge=1, le=1000)


class CapturePlan(FileSection):
    """The whole of a plan file."""

    format: Literal["radiometer-plan/1"]
    reasons: tuple[str, ...] = ()
    frames: tuple[PlannedFrames, ...] = Field(min_length=1)

    @property
    def total(self) -> int:
        """Return the number of frames."""
        return sum(planned.repeat for planned in self.frames)


# Brings source, pattern, f-number and shutter to what is planned; the camera itself cannot.
Stage = Callable[[PlannedFrames], None]


def read_capture_plan(path: Path) -> CapturePlan:
    """Return the plan in a YAML file.

    Raises:
        UsageError: If the file holds something not allowed; the message names key and value.
        InputError: If it cannot be read.
    """
    return validate(CapturePlan, read_yaml(path), str(path), UsageError)


def take_capture_plan(camera: Camera, plan: CapturePlan, stage: Stage) -> Iterator[Frame]:
    """Yield the frames of a plan as they are taken, each with what was staged for it.

    Args:
        plan: What to take, in this order.
        stage: Called before each setting.

    Raises:
        DeviceError: If the camera or the stage fails.
    """
    for planned in plan.frames:
        stage(planned)
        camera.configure(replace(camera.settings, exposure_s=planned.exposure_s, gain_db=planned.gain_db))
        for frame in camera.capture(planned.repeat):
            staged = replace(
                frame.settings,
                f_number=planned.f_number or frame.settings.f_number,
                source_level=planned.source_level,
                pattern=planned.pattern,
                shutter=planned.shutter,
            )
            yield replace(frame, settings=staged)

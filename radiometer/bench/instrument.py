"""The instrument: a camera, its calibration and a patch, asked for readings."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from radiometer.acquire.bracketing import DEFAULT_TIME_LIMIT_S, BracketRequest, Progress, plan_for_scene, take_plan
from radiometer.analysis.patch.reading import read_patch
from radiometer.data import Bracket, Calibration, Frame, LensDescription, Patch, Reading
from radiometer.devices import Camera
from radiometer.errors import UsageError


@dataclass(frozen=True, slots=True)
class Instrument:
    """Reads the radiance of patches with an open camera.

    Attributes:
        camera: An open camera.
        patch: Where to read where nothing else is said.
        calibration: Absolute calibration of this camera; None gives relative readings flagged so.
        time_limit_s: Bound on the sum of the exposure times of one reading in s.
        f_number: f-number that the lens is set to where the camera's description does not hold.
        clock: Steady clock in s.
    """

    camera: Camera
    patch: Patch
    calibration: Calibration | None = None
    time_limit_s: float = DEFAULT_TIME_LIMIT_S
    f_number: float | None = None
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        if self.calibration is not None:
            self.calibration.require_camera(self.camera.description)
        refuse_outside(self.patch, self.camera)

    def at(self, patch: Patch) -> Instrument:
        """Return the same instrument looking at another patch. Raises UsageError where it leaves the frame."""
        return replace(self, patch=patch)

    def measure(
        self, *, target_u_rel: float | None = None, sequence: int = 0, progress: Progress | None = None
    ) -> Reading:
        """Meter the patch, take the bracket it needs and return its radiance.

        Args:
            target_u_rel: Wanted relative standard uncertainty from noise; None for a single pass.
            sequence: Running number to give the reading.
            progress: Called after every frame.

        Raises:
            DeviceError: If the camera fails.
            CalibrationError: If the calibration does not fit.
        """
        return self.read(self.take_bracket(target_u_rel=target_u_rel, progress=progress), sequence=sequence)

    def take_bracket(self, *, target_u_rel: float | None = None, progress: Progress | None = None) -> Bracket:
        """Meter the patch and return the frames that cover it. Raises DeviceError if the camera fails."""
        request = BracketRequest(region=self.patch, target_u_rel=target_u_rel, time_limit_s=self.time_limit_s)
        plan = plan_for_scene(self.camera, request)
        frames: list[Frame] = list(take_plan(self.camera, plan, request, progress=progress, clock=self.clock))
        return Bracket.from_frames(frames, origin=self.camera.identity.device_id)

    def read(self, bracket: Bracket, *, sequence: int = 0) -> Reading:
        """Return the radiance of the patch in frames already taken. Raises CalibrationError if it does not fit."""
        return read_patch(bracket, self.patch, self.calibration, self.camera.description, self.lens, sequence=sequence)

    @property
    def lens(self) -> LensDescription:
        """Return the lens in front of the camera, with the f-number stated by hand where there is one."""
        lens = self.camera.lens
        return lens if self.f_number is None else lens.model_copy(update={"f_number": self.f_number})


def refuse_outside(patch: Patch, camera: Camera) -> None:
    """Raise UsageError for a patch that leaves the camera's frame."""
    limits = camera.capabilities
    roi = camera.settings.roi
    width, height = (roi.width, roi.height) if roi else (limits.width, limits.height)
    binning = camera.settings.binning
    if not patch.fits((height // binning, width // binning)):
        raise UsageError(
            f"patch {patch.x},{patch.y},{patch.width},{patch.height} leaves the frame of "
            f"{width // binning} × {height // binning} pixels"
        )


def central_patch(camera: Camera) -> Patch:
    """Return a patch in the middle of the frame, a tenth of it in each direction."""
    limits = camera.capabilities
    width, height = max(1, limits.width // 10), max(1, limits.height // 10)
    return Patch((limits.width - width) // 2, (limits.height - height) // 2, width, height)

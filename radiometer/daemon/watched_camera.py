"""A camera under watch: when the call in progress begins to be late, and whether its frames can be believed."""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from radiometer.data import CameraDescription, Flag, Frame, LensDescription
from radiometer.devices import AcquisitionCounts, Camera, CameraCapabilities, CameraIdentity, CameraSettings
from radiometer.devices.opening import Opened
from radiometer.errors import DeviceError

GRACE_S: Final = 1.4  # beyond twice the exposure: what a healthy camera needs to read out, send, or answer
# A camera rounds exposure times to its lines, 10 to 30 µs each, and to its clock: what differs more was not asked for.
_ROUNDED_S: Final = 50e-6
_ROUNDED_REL: Final = 0.02  # coarse line times at short exposures
_EVERY_NTH_ROW: Final = 8  # noise in an eighth of the pixels never repeats either, and is looked at eight times faster
_PICTURED: Final = 0.5  # below this share of pixels that are neither lowest nor highest, noise may not show


class WatchedCamera(Opened):
    """Passes every call on, notes by when it should have returned, and what is odd about its frames.

    Args:
        clock: Steady time in s.
    """

    def __init__(self, camera: Camera, clock: Callable[[], float] = time.monotonic) -> None:
        self._camera, self._clock = camera, clock
        self.late_at: float | None = None
        self._asked_s: float | None = None
        self._last: tuple[int, tuple[int, ...]] | None = None
        self._doubts: set[Flag] = set()

    def take_doubts(self) -> tuple[Flag, ...]:
        """Return why the frames since the last call may not be believed, and forget it."""
        doubts, self._doubts = tuple(sorted(self._doubts)), set()
        return doubts

    @property
    def identity(self) -> CameraIdentity:
        """Return who the camera is."""
        return self._camera.identity

    @property
    def capabilities(self) -> CameraCapabilities:
        """Return its limits."""
        return self._camera.capabilities

    @property
    def settings(self) -> CameraSettings:
        """Return the settings in force."""
        return self._camera.settings

    @property
    def description(self) -> CameraDescription:
        """Return what its datasheet says."""
        return self._camera.description

    @property
    def lens(self) -> LensDescription:
        """Return the lens in front of it."""
        return self._camera.lens

    @property
    def counts(self) -> AcquisitionCounts:
        """Return what went wrong and was put right."""
        return self._camera.counts

    def open(self) -> None:
        """Open the device."""
        self._camera.open()

    def close(self) -> None:
        """Release the device."""
        self._camera.close()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set everything and return it as read back."""
        with self._expected_within(GRACE_S):
            applied = self._camera.configure(settings)
        self._asked_s = settings.exposure_s
        return applied

    def capture(self, count: int = 1) -> list[Frame]:
        """Return complete frames. Raises DeviceError, also where a frame states no possible exposure time."""
        with self._expected_within(GRACE_S + 2 * count * self._camera.settings.exposure_s):
            frames = self._camera.capture(count)
        for frame in frames:
            self._look_at(frame)
        return frames

    def stream(self) -> Generator[Frame, None, None]:
        """Yield frames as they come. Raises DeviceError as `capture` does."""
        for frame in self._camera.stream():
            self._look_at(frame)
            yield frame

    def set_shutter(self, *, closed: bool) -> None:
        """Close or open the shutter."""
        self._camera.set_shutter(closed=closed)

    def _look_at(self, frame: Frame) -> None:
        stated_s = frame.settings.exposure_s
        if not (math.isfinite(stated_s) and stated_s > 0):
            raise DeviceError(
                f"the camera states an exposure time of {stated_s:g} s for a frame; reset it, or update its driver"
            )
        if self._asked_s is not None:
            rounded_s = max(_ROUNDED_S, _ROUNDED_REL * self._asked_s, 2 * self._camera.capabilities.exposure_step_s)
            if abs(stated_s - self._asked_s) > rounded_s:
                self._doubts.add(Flag.EXPOSURE_UNCONFIRMED)
        rows = np.asarray(frame.dn[::_EVERY_NTH_ROW], dtype=np.uint16)
        this = (zlib.crc32(rows.tobytes()), rows.shape)
        if this == self._last and float(np.mean((rows > rows.min()) & (rows < frame.full_scale_dn))) > _PICTURED:
            self._doubts.add(Flag.REPEATED_FRAME)
        self._last = this

    @contextmanager
    def _expected_within(self, seconds: float) -> Iterator[None]:
        self.late_at = self._clock() + seconds
        try:
            yield
        finally:
            self.late_at = None

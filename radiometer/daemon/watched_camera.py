"""A camera that tells, from another thread, when the call in progress begins to be late."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Final, Self

from radiometer.data import CameraDescription, Frame, LensDescription
from radiometer.devices import AcquisitionCounts, Camera, CameraCapabilities, CameraIdentity, CameraSettings

GRACE_S: Final = 1.4  # beyond twice the exposure: what a healthy camera needs to read out, send, or answer


class WatchedCamera:
    """Passes every call on, and notes by when it should have returned.

    Args:
        camera: The camera.
        clock: Steady time in s.
    """

    def __init__(self, camera: Camera, clock: Callable[[], float] = time.monotonic) -> None:
        self._camera, self._clock = camera, clock
        self.late_at: float | None = None

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
            return self._camera.configure(settings)

    def capture(self, count: int = 1) -> list[Frame]:
        """Return complete frames."""
        with self._expected_within(GRACE_S + 2 * count * self._camera.settings.exposure_s):
            return self._camera.capture(count)

    def stream(self) -> Generator[Frame, None, None]:
        """Yield frames as they come."""
        return self._camera.stream()

    def set_shutter(self, *, closed: bool) -> None:
        """Close or open the shutter."""
        self._camera.set_shutter(closed=closed)

    def __enter__(self) -> Self:
        """Open the camera."""
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the camera."""
        self.close()

    @contextmanager
    def _expected_within(self, seconds: float) -> Iterator[None]:
        self.late_at = self._clock() + seconds
        try:
            yield
        finally:
            self.late_at = None

"""The frames that a characterisation needs, taken from a camera that looks at steady light."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from radiometer.data import Frame, Patch
from radiometer.devices import Camera
from radiometer.errors import MeasurementError

_TRIES = 12  # a tenth or up to 100 times each: 12 cross the range of any camera
_FIRST_GUESS_S = 0.01  # the middle of usual ranges, 10 µs to 10 s, by ratio
_TOO_BRIGHT_FACTOR = 0.1  # a clipped frame does not state by how much: a decade less


@dataclass(frozen=True, slots=True)
class LadderRequest:
    """What to take."""

    region: Patch  # where the light is
    steps: int = 30  # exposures from near darkness to just above saturation
    stack: int = 8  # frames in a row at half of saturation, for the differences between pixels
    # Further exposures with the shutter closed, for the dark current
    dark_exposures_s: tuple[float, ...] = (1.0, 2.0, 4.0)

    def frames(self) -> int:
        """Return the number of frames, metering left out."""
        return 4 * self.steps + 2 * self.stack + 2 * len(self.dark_exposures_s)


def take_ladder(
    camera: Camera, request: LadderRequest, close_shutter: Callable[[bool], None] | None = None
) -> Iterator[Frame]:
    """Yield pairs of bright frames over exposure, a stack, then the dark frames of the same exposures.

    Args:
        camera: An open camera; its gain, black level and pixel format stay as they are set.
        close_shutter: Called with True before the dark frames and with False after them; the camera's own shutter
            where None.

    Raises:
        MeasurementError: If the light does not saturate a pixel within the camera's limits of exposure, or is too
            bright for its shortest.
        DeviceError: If the camera fails.
    """
    saturating_s = saturating_exposure_s(camera, request.region)
    shortest, longest = camera.capabilities.exposure_s
    plan = [(t, 2) for t in _ladder(saturating_s, shortest, longest, request.steps)]
    plan.append((0.5 * saturating_s, request.stack))
    yield from _take(camera, plan)
    shutter = close_shutter or (lambda closed: camera.set_shutter(closed=closed))
    shutter(True)
    try:
        yield from _take(camera, plan + [(t, 2) for t in request.dark_exposures_s if shortest <= t <= longest])
    finally:
        shutter(False)


def _ladder(saturating_s: float, shortest_s: float, longest_s: float, steps: int) -> list[float]:
    """Return two thirds of the steps evenly up to 88 % of saturation and a third closer together through it."""
    fine = steps // 3
    coarse = np.linspace(0.02 * saturating_s, 0.88 * saturating_s, steps - fine)
    exposures = [*coarse, *np.linspace(0.9 * saturating_s, 1.08 * saturating_s, fine)]
    return sorted({min(max(float(t), shortest_s), longest_s) for t in exposures})


def saturating_exposure_s(camera: Camera, region: Patch) -> float:
    """Return the exposure in s at which the mean of a region reaches full scale.

    Raises:
        MeasurementError: If that is outside the camera's limits of exposure.
        DeviceError: If the camera fails.
    """
    shortest, longest = camera.capabilities.exposure_s
    exposure = min(max(_FIRST_GUESS_S, shortest), longest)
    for _ in range(_TRIES):
        signal, full = _signal(camera, region, exposure)
        if 0.3 * full <= signal <= 0.8 * full:
            found = exposure * full / signal
            if found > longest:
                break
            return found
        factor = _TOO_BRIGHT_FACTOR if signal > 0.8 * full else min(0.5 * full / max(signal, 1.0), 100.0)
        next_exposure = min(max(exposure * factor, shortest), longest)
        if next_exposure == exposure:
            break
        exposure = next_exposure
    raise MeasurementError(
        f"the light is too {'bright' if exposure <= shortest else 'dim'}: the region does not come to saturation "
        f"between {shortest:g} s and {longest:g} s; change the light, the aperture or the region (--patch)"
    )


def _signal(camera: Camera, region: Patch, exposure_s: float) -> tuple[float, float]:
    camera.configure(replace(camera.settings, exposure_s=exposure_s))
    frame = camera.capture()[0]
    if not region.fits(frame.shape):
        raise MeasurementError(
            f"the region {region.x},{region.y},{region.width},{region.height} is not on the frame of "
            f"{frame.shape[1]} × {frame.shape[0]} pixels"
        )
    black = frame.settings.black_level_dn or 0.0
    return float(frame.dn[region.slices].mean()) - black, frame.saturated_dn - black


def _take(camera: Camera, plan: list[tuple[float, int]]) -> Iterator[Frame]:
    for exposure_s, count in plan:
        camera.configure(replace(camera.settings, exposure_s=exposure_s))
        yield from camera.capture(count)

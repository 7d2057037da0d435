"""Taking a bracket: by itself from the scene, or along a fixed ladder."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from radiometer.acquire.exposure_plan import ExposurePlan, ExposureWindow, plan_exposures, repeats_for
from radiometer.acquire.metering import meter
from radiometer.data import Frame, Patch
from radiometer.devices import Camera
from radiometer.errors import DeviceError, UsageError
from radiometer.plausible import PLAUSIBLE

# Progress: how many frames are done, how many there will be, and the frame just taken.
Progress = Callable[[int, int, Frame], None]
DEFAULT_TIME_LIMIT_S = 60.0  # engineering choice: a minute of light frames is what a person waits for


@dataclass(frozen=True, slots=True)
class BracketRequest:
    """What a bracket is to achieve."""

    region: Patch | None = None  # pixels that matter; None for the whole frame
    # Wanted relative standard uncertainty of the region's mean from noise; None for one pass
    target_u_rel: float | None = None
    time_limit_s: float = DEFAULT_TIME_LIMIT_S  # bound on the sum of the exposure times of the light frames in s
    dark_frames: int = 0  # Dark frames per distinct exposure time


def plan_for_scene(camera: Camera, request: BracketRequest) -> ExposurePlan:
    """Meter the scene and return the exposures that cover it.

    Raises:
        UsageError: If the region leaves the frame, the time limit is not above 0, or dark frames are below 0.
        DeviceError: If the camera fails.
    """
    PLAUSIBLE["frames"].check("dark frames", request.dark_frames, UsageError)
    if not request.time_limit_s > 0:
        raise UsageError(f"a time limit of {request.time_limit_s:g} s leaves no time for a frame; ask for more than 0")
    limits = camera.capabilities.exposure_s
    # No single exposure may take more than a third of the time: two of the longest and the rest must fit.
    permitted = (limits[0], max(limits[0], min(limits[1], request.time_limit_s / 3.0)))
    # What does not rise above the noise in a third of the longest exposure is not well exposed in it either.
    rates = meter(camera, request.region, longest_s=max(limits[0], permitted[1] / 3.0)).rates_dn_per_s
    settings = camera.settings
    window = ExposureWindow.of(camera.description, settings.gain_db, settings.black_level_dn)
    plan = plan_exposures(rates, window, settings.gain_db, permitted, time_limit_s=request.time_limit_s)
    if request.target_u_rel is None:
        return plan
    return _repeated(
        plan, repeats_for(plan, rates, camera.description, settings.gain_db, request.target_u_rel), request
    )


def take_plan(
    camera: Camera,
    plan: ExposurePlan,
    request: BracketRequest,
    *,
    progress: Progress | None = None,
    close_shutter: Callable[[bool], None] | None = None,
    deadline_s: float | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Frame]:
    """Yield the frames of a plan as they are taken, dark frames last.

    Args:
        progress: Called after every frame.
        close_shutter: Called with True before the dark frames and False after them; the camera's own shutter where
            None.
        deadline_s: Stop before a light frame that would end later than this many seconds after the first began; half
            as long again as the request's time limit, and 10 s, where None.
        clock: Steady clock in s.

    Raises:
        DeviceError: If the camera fails, or dark frames are requested and there is no way to close the shutter.
    """
    distinct = sorted(set(plan.exposures_s))
    total = len(plan.exposures_s) + request.dark_frames * len(distinct)
    deadline = 1.5 * request.time_limit_s + 10.0 if deadline_s is None else deadline_s
    begun, done = clock(), 0
    for exposure_s in distinct:
        camera.configure(replace(camera.settings, exposure_s=exposure_s))
        for _ in range(plan.exposures_s.count(exposure_s)):
            if done and clock() - begun + exposure_s > deadline:
                return
            frame = camera.capture(1)[0]
            done += 1
            if progress:
                progress(done, total, frame)
            yield frame
    if request.dark_frames:
        yield from take_dark_frames(
            camera, distinct, request.dark_frames, close_shutter or own_shutter(camera), progress
        )


def take_dark_frames(
    camera: Camera,
    exposures_s: list[float],
    count: int,
    close_shutter: Callable[[bool], None],
    progress: Progress | None = None,
) -> Iterator[Frame]:
    """Yield dark frames as they are taken; the shutter is open again afterwards, whatever happens.

    Args:
        exposures_s: Exposure times in s.
        count: Frames at each.
        close_shutter: Called with True before and False after.
        progress: Called after every frame.

    Raises:
        DeviceError: If the camera fails.
    """
    close_shutter(True)
    try:
        for position, exposure_s in enumerate(exposures_s):
            camera.configure(replace(camera.settings, exposure_s=exposure_s))
            for number, frame in enumerate(camera.capture(count)):
                dark = replace(frame, settings=replace(frame.settings, shutter="closed"))
                if progress:
                    progress(position * count + number + 1, count * len(exposures_s), dark)
                yield dark
    finally:
        close_shutter(False)


def own_shutter(camera: Camera) -> Callable[[bool], None]:
    """Return what closes the camera's own shutter. Raises DeviceError where it has none."""
    if not camera.capabilities.has_shutter:
        raise DeviceError(f"{camera.identity.model} has no shutter; cover the lens by hand when asked, at a terminal")
    return lambda closed: camera.set_shutter(closed=closed)


def _repeated(plan: ExposurePlan, repeats: int, request: BracketRequest) -> ExposurePlan:
    affordable = max(1, math.floor(request.time_limit_s / plan.total_s)) if plan.total_s else repeats
    times = tuple(sorted(plan.exposures_s * min(repeats, affordable)))
    return replace(plan, exposures_s=times, cut_short=plan.cut_short or repeats > affordable)

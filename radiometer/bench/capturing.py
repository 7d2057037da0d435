"""Captures planned exposures into a new folder: the frames with camera, lens, light and known patches."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from radiometer.acquire.bracketing import BracketRequest, take_plan
from radiometer.acquire.capture_plan import CapturePlan, PlannedFrames, Stage, take_capture_plan
from radiometer.acquire.exposure_plan import ExposurePlan
from radiometer.bench.assembly import known_patches, stated_source
from radiometer.bench.config import BenchConfig
from radiometer.data import CaptureSet, CaptureSetWriter, Frame
from radiometer.data.provenance import utc_now
from radiometer.devices import Camera
from radiometer.errors import DeviceError

Ask = Callable[[str], None]
Taken = Callable[[int, int], None]


def _stage_of(camera: Camera, ask: Ask) -> Stage:
    """Return what sets source level, pattern, f-number and shutter before each setting of a plan, by hand or not."""
    from simulators.cameras.simulated_camera import SimulatedCamera

    if not isinstance(camera, SimulatedCamera):
        return _ByHand(camera, ask)

    def stage(planned: PlannedFrames) -> None:
        camera.set_source(planned.source_level, planned.pattern)
        camera.set_shutter(closed=planned.shutter == "closed")
        if planned.f_number:
            camera.set_f_number(planned.f_number)

    return stage


class _ByHand:
    def __init__(self, camera: Camera, ask: Callable[[str], None]) -> None:
        self._ask = ask
        self._now = PlannedFrames(exposure_s=1.0, f_number=camera.lens.f_number)

    def __call__(self, planned: PlannedFrames) -> None:
        """Ask for what differs from how the bench stands."""
        wishes = (
            (planned.f_number, self._now.f_number, f"set the lens to f/{planned.f_number or 0:.3g}"),
            (planned.source_level, self._now.source_level, f"set the source to {100 * planned.source_level:g} %"),
            (planned.pattern, self._now.pattern, f"show the pattern {planned.pattern!r}"),
            (
                planned.shutter,
                self._now.shutter,
                "cover the lens" if planned.shutter == "closed" else "uncover the lens",
            ),
        )
        todo = [words for requested, now, words in wishes if requested is not None and requested != now]
        if todo:
            self._ask(", ".join(todo))
        self._now = planned.model_copy(update={"f_number": planned.f_number or self._now.f_number})


def shutter_by_hand(camera: Camera, ask: Ask | None) -> Callable[[bool], None]:
    """Return what has the lens covered (True) and uncovered (False) by whoever is asked.

    Raises:
        DeviceError: If `ask` is missing.
    """
    if ask is None:
        raise DeviceError(
            f"{camera.identity.model} has no shutter for dark frames. Run at a terminal, where you are asked to cover "
            "the lens, or leave the dark frames out"
        )
    return lambda closed: ask(f"{'Cover' if closed else 'Uncover'} the lens")


def capture_exposures(
    out: Path,
    camera: Camera,
    plan: ExposurePlan,
    request: BracketRequest,
    config: BenchConfig,
    ask: Ask | None = None,
    taken: Taken | None = None,
) -> CaptureSet:
    """Capture the planned exposures into a new folder and return what was written.

    Args:
        plan: Exposures in s.
        config: The bench: its light and its patches are written to the header.
        ask: Has the lens covered where the camera has no shutter.
        taken: Called after every frame with how many are taken, and of how many.

    Raises:
        DeviceError: If the camera fails, or needs a hand and `ask` is missing.
        OutputError: If the folder exists or cannot be written.
    """
    by_hand = request.dark_frames and not camera.capabilities.has_shutter
    shutter = shutter_by_hand(camera, ask) if by_hand else None
    total = len(plan.exposures_s) + request.dark_frames * len(set(plan.exposures_s))
    return _written(out, camera, config, take_plan(camera, plan, request, close_shutter=shutter), total, taken)


def capture_settings(
    out: Path, camera: Camera, plan: CapturePlan, config: BenchConfig, ask: Ask | None, taken: Taken | None
) -> CaptureSet:
    """Do as `capture_exposures` for settings, with what `ask` arranges for each. Raises DeviceError, OutputError."""

    def asked(wish: str) -> None:
        if ask is None:
            raise DeviceError(f"the plan needs a hand: {wish}. Run at a terminal")
        ask(f"Please {wish}")

    patterns = tuple(dict.fromkeys(planned.pattern for planned in plan.frames))
    frames = take_capture_plan(camera, plan, _stage_of(camera, asked))
    return _written(out, camera, config, frames, plan.total, taken, patterns)


def _written(
    out: Path,
    camera: Camera,
    config: BenchConfig,
    frames: Iterable[Frame],
    total: int,
    taken: Taken | None,
    patterns: tuple[str, ...] = ("default",),
) -> CaptureSet:
    header = camera.description, camera.lens, stated_source(config), known_patches(config), patterns
    with CaptureSetWriter(out, *header, extra={"created": utc_now()}) as writer:
        for number, frame in enumerate(frames, 1):
            writer.add(frame)
            if taken:
                taken(number, total)
    return CaptureSet.read(out)

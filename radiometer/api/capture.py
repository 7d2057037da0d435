"""Capturing sets of exposures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from radiometer.acquire.bracketing import BracketRequest, plan_for_scene
from radiometer.acquire.capture_plan import read_capture_plan
from radiometer.acquire.exposure_plan import ExposurePlan, exposure_ladder
from radiometer.acquire.reach import assess_reach
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Ask, Progress, Result
from radiometer.bench.assembly import open_bench_camera
from radiometer.bench.capturing import capture_exposures, capture_settings
from radiometer.data import CaptureSet, Patch
from radiometer.devices import Camera
from radiometer.errors import UsageError
from radiometer.plausible import AnyCount, Count, Exposure, NotNegative, Positive, RelativeUncertainty
from radiometer.progress import counted


@dataclass(frozen=True, repr=False)
class BracketReport(Result):
    """What a bracket holds, and how well it covers the scene.

    Attributes:
        capture: Folder of the capture set.
        frames: Number of frames.
        exposures_s: Exposure times of the lit frames in s.
        dark_frames: Number of dark frames.
        coverage: Pixels that are well exposed twice, saturated, below noise; empty where a plan chose the exposures.
        not_reached: What the scene needs and the frames do not give, a sentence each.
        cut_short: Whether the time limit left exposures out.
        of: Whose pixels the coverage counts: "pixels", or "patch's pixels".
    """

    capture: Path
    frames: int
    exposures_s: tuple[float, ...]
    dark_frames: int
    coverage: dict[str, int]
    not_reached: tuple[str, ...] = ()
    cut_short: bool = False
    of: str = "pixels"

    def to_mapping(self) -> dict[str, Any]:
        return self.plain("capture", "frames", "exposures_s", "dark_frames", "cut_short", **self.coverage)

    def __str__(self) -> str:
        low, high = min(self.exposures_s), max(self.exposures_s)
        return f"{self.capture}: {len(self.exposures_s)} exposures from {low:.4g} s to {high:.4g} s"


def bracket(
    out: PathLike,
    *,
    camera: str | None = None,
    bench: PathLike | None = None,
    patch: PatchLike | None = None,
    stops: Positive | None = None,
    shortest_s: Exposure | None = None,
    longest_s: Exposure | None = None,
    repeat: Count = 1,
    u_rel: RelativeUncertainty | None = None,
    darks: AnyCount = 0,
    plan: PathLike | None = None,
    time_limit_s: NotNegative = 60.0,
    ask: Ask | None = None,
    progress: Progress | None = None,
) -> BracketReport:
    """Capture a set of exposures of an unmoving scene into a new folder.

    Meters the scene and takes the fewest and shortest exposures that expose every pixel well at least twice, or a fixed
    ladder. The folder holds `capture.yaml`, finished or not at all.

    Examples:
        >>> import radiometer as rm
        >>> rm.bracket("out/even", bench="bench.yaml", shortest_s=0.001, longest_s=0.004)
        <BracketReport out/even: 3 exposures from 0.001 s to 0.004 s>
        >>> rm.read("out/even").bracket.shape
        (64, 96)

    Args:
        out: Folder to create.
        camera: "sim", an id, serial number or address, or v4l2:, picamera:, gphoto2:; the bench's own by default.
        bench: Bench file; the simulated bench by default.
        patch: Choose the exposures for this region only.
        stops: Fixed ladder: distance of the exposures in stops; 1 by default.
        shortest_s: Fixed ladder: shortest exposure in s.
        longest_s: Fixed ladder: longest exposure in s.
        repeat: Take every exposure this often.
        u_rel: Repeat until noise is below this relative standard uncertainty.
        darks: Dark frames per exposure time.
        plan: Take the frames of this plan file instead.
        time_limit_s: Bound on the sum of the exposure times in s.
        ask: Has something done by hand, such as the lens covered.
        progress: Called after every frame.

    Raises:
        UsageError: If arguments exclude each other.
        DeviceError: If the camera fails or needs a hand.
        OutputError: If the folder exists or cannot be written.
    """
    ladder = _ladder(stops, shortest_s, longest_s)
    if plan is not None and (ladder or patch or u_rel is not None or darks or repeat > 1):
        raise UsageError("--plan states all settings; leave out --stops, --from, --to, --patch, --u-rel, --darks")
    region = as_patch(patch)
    request = BracketRequest(region, u_rel, time_limit_s, darks)
    taken = counted(progress, "capturing")
    with open_bench_camera(Path(bench) if bench else None, camera) as (config, device):
        if plan is not None:
            return _planned(capture_settings(Path(out), device, read_capture_plan(Path(plan)), config, ask, taken))
        exposures = _exposures(device, request, ladder, repeat)
        written = capture_exposures(Path(out), device, exposures, request, config, ask, taken)
        return _covered(written, exposures, region)


def _ladder(
    stops: float | None, shortest_s: float | None, longest_s: float | None
) -> tuple[float, float, float] | None:
    if stops is None and shortest_s is None and longest_s is None:
        return None
    if shortest_s is None or longest_s is None:
        raise UsageError("a fixed ladder needs --from and --to (and --stops, 1 by default)")
    return shortest_s, longest_s, 1.0 if stops is None else stops


def _exposures(
    device: Camera, request: BracketRequest, ladder: tuple[float, float, float] | None, repeat: int
) -> ExposurePlan:
    if ladder:
        return exposure_ladder(*ladder, device.capabilities.exposure_s, repeat)
    plan = plan_for_scene(device, request)
    return replace(plan, exposures_s=tuple(sorted(plan.exposures_s * repeat)))


def _planned(written: CaptureSet) -> BracketReport:
    lit = tuple(entry.exposure_s for entry in written.header.frames if entry.shutter == "open")
    return BracketReport(written.path, len(written), lit, len(written) - len(lit), {})


def _covered(written: CaptureSet, plan: ExposurePlan, region: Patch | None) -> BracketReport:
    report, reach = _planned(written), assess_reach(written.frames(), written.header.camera, region)
    late = len(plan.exposures_s) - len(report.exposures_s)
    missing = [*reach.sentences(), *(["the time limit left out the longest exposures"] if plan.cut_short else [])]
    missing += [f"the deadline came before {late} of {len(plan.exposures_s)} exposures"] if late > 0 else []
    coverage = {
        "pixels": int(reach.cover.size),
        "well_exposed_twice": int((reach.cover >= 2).sum()),
        "saturated": int(reach.saturated.sum()),
        "below_noise": int(reach.below_noise.sum()),
    }
    cut_short, of = plan.cut_short or late > 0, "patch's pixels" if region else "pixels"
    return replace(report, coverage=coverage, not_reached=tuple(missing), cut_short=cut_short, of=of)

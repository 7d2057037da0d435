"""Takes the captures of a quality index: which steps are missing, and the exposures that each step needs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

from radiometer.acquire.bracketing import BracketRequest, plan_for_scene
from radiometer.acquire.exposure_plan import ExposurePlan, exposure_ladder
from radiometer.analysis.quality.procedures import PROCEDURES, Procedure, ProcedureStep, gain_of_step, procedure
from radiometer.bench.assembly import open_bench_camera
from radiometer.bench.capturing import Ask, Taken, capture_exposures
from radiometer.data import CaptureSet, Patch, PatchDescription
from radiometer.devices import Camera
from radiometer.errors import UsageError

# The source of smear is exposed so many times beyond full scale: what it leaves behind then stands out of the noise.
_OVER: Final = 64.0
# Linearity over the signal's upper 1.6 decades in half stops; below them, noise dominates each step.
_LADDER_SPAN, _LADDER_STOPS = 40.0, 0.5
_FEWEST_FRAMES: Final = 5  # fewer short ones cannot show whether the light is steady
_TIME_LIMIT_S: Final = 60.0  # as of a bracket


def procedure_named(name: str) -> Procedure:
    """Return a procedure that has captures. Raises UsageError for another name."""
    found = procedure(name)
    if found is None or not found.steps:
        known = ", ".join(one.name for one in PROCEDURES if one.steps)
        raise UsageError(f"{name!r} is no procedure with captures; there are {known}")
    return found


def chosen_steps(of: Procedure, names: Sequence[str] | None) -> list[ProcedureStep]:
    """Return the steps of these names, or all. Raises UsageError for a name that the procedure does not take."""
    if not names:
        return list(of.steps)
    known = {one.name: one for one in of.steps}
    unknown = [name for name in names if name not in known and not (of.form and re.fullmatch(of.form, name, re.ASCII))]
    if unknown:
        more = f", and {of.more}" if of.more else ""
        raise UsageError(f"{unknown[0]!r} is no step of {of.name}; there are {', '.join(known)}{more}")
    return [known.get(name) or ProcedureStep(name, f"as for the others, at {name}") for name in names]


def take_step(
    out: Path,
    of: Procedure,
    step: ProcedureStep,
    *,
    bench: Path | None,
    name: str | None,
    patch: Patch | None,
    repeat: int,
    darks: int,
    ask: Ask | None = None,
    taken: Taken | None = None,
) -> CaptureSet:
    """Capture one step of a procedure into a new folder.

    A step whose name states a gain, such as "12dB", is taken at that gain.

    Args:
        bench: Bench file; the simulated bench where None.
        name: Camera by name; the bench's own where None.
        patch: Where the index is read; the bench's where None.
        repeat: Frames of every exposure.
        darks: Dark frames per exposure time, where there is a shutter.
        ask: Has something done by hand.
        taken: Called after every frame.

    Raises:
        SettingOutOfRange: If the camera has no such gain.
        DeviceError: If the camera fails.
    """
    with open_bench_camera(bench, name) as (config, camera):
        chosen = patch or (config.patch.patch if config.patch else None)
        if chosen is not None:
            config = config.model_copy(update={"patches": (PatchDescription(name="patch", **asdict(chosen)),)})
        gain_db = gain_of_step(step.name)
        if gain_db is not None:
            camera.configure(replace(camera.settings, gain_db=gain_db))
        region = config.patches[0].patch if config.patches and of.exposures != "scene" else None
        count = darks if camera.capabilities.has_shutter else 0
        request = BracketRequest(region, None, _TIME_LIMIT_S, count)
        exposures = _exposures(plan_for_scene(camera, request), of, camera, repeat)
        return capture_exposures(out, camera, exposures, request, config, ask, taken)


def _exposures(planned: ExposurePlan, of: Procedure, camera: Camera, repeat: int) -> ExposurePlan:
    """Return the exposures of a procedure from those that the patch needs."""
    low, high = camera.capabilities.exposure_s
    longest = max(planned.exposures_s)
    if of.exposures == "ladder":
        return exposure_ladder(max(longest / _LADDER_SPAN, low), longest, _LADDER_STOPS, (low, high), repeat)
    if of.exposures == "overexposed":
        return exposure_ladder(max(longest, low), min(_OVER * longest, high), 2.0, (low, high), repeat)
    times = planned.exposures_s * repeat
    while len(times) < _FEWEST_FRAMES:
        times += planned.exposures_s
    return replace(planned, exposures_s=tuple(sorted(times)))

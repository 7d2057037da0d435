"""The instrument's quality indices: what they ask for, their captures, and the datasheet."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from radiometer.acquire.bracketing import BracketRequest, plan_for_scene
from radiometer.acquire.exposure_plan import ExposurePlan, exposure_ladder
from radiometer.analysis.quality.datasheet import datasheet_html, shown
from radiometer.analysis.quality.procedures import PROCEDURES, Procedure, ProcedureStep, gain_of_step
from radiometer.analysis.quality.procedures import procedure as procedure_of
from radiometer.analysis.quality.session import SOURCE_U_REL, Datasheet, Evaluation, evaluate
from radiometer.api.calibration import read_spectral_response
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Ask, Progress, Result
from radiometer.bench.assembly import open_bench_camera
from radiometer.bench.capturing import capture_exposures
from radiometer.data import Calibration, PatchDescription
from radiometer.data.json_text import json_text
from radiometer.data.storage import write_text_atomic
from radiometer.devices import Camera
from radiometer.errors import DeviceError, UsageError
from radiometer.plausible import AnyCount, Count, RelativeUncertainty
from radiometer.progress import counted, unseen

# The source of smear is exposed so many times beyond full scale: what it leaves behind then stands out of the noise.
_OVER: Final = 64.0
# Linearity over the signal's upper 1.6 decades in half stops; below them, noise dominates each step.
_LADDER_SPAN, _LADDER_STOPS = 40.0, 0.5
_FEWEST_FRAMES: Final = 5  # fewer short ones cannot show whether the light is steady
_TIME_LIMIT_S: Final = 60.0  # as of a bracket


@dataclass(frozen=True, repr=False)
class QualityPlan(Result):
    """The quality indices and what each asks for.

    Attributes:
        procedures: One per index.
    """

    procedures: tuple[Procedure, ...]

    def to_json(self) -> str:
        """Return the documented JSON form: a list of the procedures."""
        return json_text([asdict(one) for one in self.procedures])

    def to_mapping(self) -> dict[str, Any]:
        """Return the procedures by name."""
        return {one.name: asdict(one) for one in self.procedures}

    def __str__(self) -> str:
        return ", ".join(one.name for one in self.procedures)


@dataclass(frozen=True, repr=False)
class QualityReport(Result):
    """The instrument's datasheet.

    Attributes:
        datasheet: Every index, measured or not.
    """

    datasheet: Datasheet

    def to_mapping(self) -> dict[str, Any]:
        return self.datasheet.to_mapping()

    def write(self, path: PathLike) -> None:
        """Write the datasheet as HTML. Raises OutputError."""
        write_text_atomic(Path(path), datasheet_html(self.datasheet))

    @property
    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return symbol, title, value and expanded uncertainty of every index that was measured."""
        measured = ((one.procedure, one.figure) for one in self.datasheet.indices)
        return [(of.symbol, of.title, *shown(figure)) for of, figure in measured if figure is not None]

    def __str__(self) -> str:
        return ", ".join(f"{symbol} = {value} ± {u}" for symbol, _, value, u in self.rows) or "nothing measured"


def quality_plan() -> QualityPlan:
    """List the quality indices, what each asks for, and how it is defined.

    Examples:
        >>> import radiometer as rm
        >>> "range" in str(rm.quality_plan())
        True
    """
    return QualityPlan(PROCEDURES)


def quality_take(
    session: PathLike,
    procedure: str,
    steps: Sequence[str] | None = None,
    *,
    camera: str | None = None,
    bench: PathLike | None = None,
    patch: PatchLike | None = None,
    repeat: Count = 4,
    darks: AnyCount = 2,
    ask: Ask | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Take the captures of one quality index that are missing, asking for what each step needs; return their folders.

    Without a terminal name one step at a time and arrange the bench yourself. A step named by a gain, such as 12dB, is
    taken at that gain.

    Examples:
        >>> import radiometer as rm
        >>> rm.quality_take("out/session", "range", ["12dB"], bench="bench.yaml")
        [PosixPath('out/session/range/12dB')]
        >>> {frame.settings.gain_db for frame in rm.read("out/session/range/12dB").bracket.light}
        {12.0}

    Args:
        session: Folder of the session; made where it is missing.
        procedure: Index to capture for, of those that `quality_plan` lists.
        steps: Steps to take; all by default.
        camera: "sim", an id, serial number or address, or v4l2:, picamera:, gphoto2:; the bench's own by default.
        bench: Bench file; the simulated bench by default.
        patch: Region to read; the bench's by default.
        repeat: Frames of every exposure.
        darks: Dark frames per exposure time, where there is a shutter.
        ask: Has the bench arranged before each step; without it one step at a time can be taken.
        progress: Called after every frame.

    Raises:
        UsageError: If there is no such procedure or step.
        DeviceError: If the camera fails, or several steps are missing and `ask` is missing.
    """
    chosen = _procedure_named(procedure)
    folder = Path(session) / chosen.name
    missing = [one for one in _chosen_steps(chosen, steps) if not (folder / one.name).exists()]
    if len(missing) > 1 and ask is None:
        names = ", ".join(one.name for one in missing)
        raise DeviceError(f"the steps {names} need a hand in between; run at a terminal, or name one step at a time")
    for step in missing:
        if ask is not None:
            ask(f"{chosen.title}, step {step.name}: {step.ask}")
        with open_bench_camera(Path(bench) if bench else None, camera) as (config, device):
            where = as_patch(patch) or (config.patch.patch if config.patch else None)
            if where is not None:
                config = config.model_copy(update={"patches": (PatchDescription(name="patch", **asdict(where)),)})
            if (gain_db := gain_of_step(step.name)) is not None:
                device.configure(replace(device.settings, gain_db=gain_db))
            region = config.patches[0].patch if config.patches and chosen.exposures != "scene" else None
            request = BracketRequest(region, None, _TIME_LIMIT_S, darks if device.capabilities.has_shutter else 0)
            exposures = _exposures(plan_for_scene(device, request), chosen, device, repeat)
            taken = counted(progress, step.name)
            capture_exposures(folder / step.name, device, exposures, request, config, ask, taken)
    return [folder / one.name for one in missing]


def _procedure_named(name: str) -> Procedure:
    """Return a procedure that has captures. Raises UsageError for another name."""
    found = procedure_of(name)
    if found is None or not found.steps:
        known = ", ".join(one.name for one in PROCEDURES if one.steps)
        raise UsageError(f"{name!r} is no procedure with captures; there are {known}")
    return found


def _chosen_steps(of: Procedure, names: Sequence[str] | None) -> list[ProcedureStep]:
    """Return the steps of these names, or all. Raises UsageError for a name that the procedure does not take."""
    if not names:
        return list(of.steps)
    known = {one.name: one for one in of.steps}
    unknown = [name for name in names if name not in known and not (of.form and re.fullmatch(of.form, name, re.ASCII))]
    if unknown:
        more = f", and {of.more}" if of.more else ""
        raise UsageError(f"{unknown[0]!r} is no step of {of.name}; there are {', '.join(known)}{more}")
    return [known.get(name) or ProcedureStep(name, f"as for the others, at {name}") for name in names]


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


def quality_report(
    session: PathLike,
    *,
    calibration: PathLike | None = None,
    patch: PatchLike | None = None,
    source_u_rel: RelativeUncertainty = SOURCE_U_REL,
    spectral_response: PathLike | None = None,
    progress: Progress | None = None,
) -> QualityReport:
    """Find every quality index that the captures of a session allow.

    Examples:
        >>> import radiometer as rm
        >>> taken = rm.quality_take("out/lines", "linearity", bench="bench.yaml")
        >>> rm.quality_report("out/lines").rows[0][1]
        'linearity'

    Args:
        session: Folder of the session.
        calibration: Calibration file: its corrections are part of the instrument.
        patch: Region to read; each capture's own by default.
        source_u_rel: Relative standard uncertainty of the source's steadiness between steps.
        spectral_response: CSV of wavelength in nm and relative responsivity per watt, for the V(λ) mismatch.
        progress: Called before every index.

    Raises:
        InputError: If the session holds no captures.
    """
    response = read_spectral_response(Path(spectral_response)) if spectral_response else None
    known = Calibration.read(Path(calibration)) if calibration else None
    how = Evaluation(known, as_patch(patch), source_u_rel, response)
    return QualityReport(evaluate(Path(session), how, lambda title: (progress or unseen)(title, 0, None)))

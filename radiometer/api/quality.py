"""The instrument's quality indices: what they ask for, their captures, and the datasheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from radiometer.analysis.photometry.photometry import spectrum_from_csv
from radiometer.analysis.quality.datasheet import shown, write_datasheet
from radiometer.analysis.quality.procedures import PROCEDURES, Procedure
from radiometer.analysis.quality.session import SOURCE_U_REL, Datasheet, Evaluation, evaluate
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Ask, Progress, Result
from radiometer.bench.quality_session import chosen_steps, procedure_named, take_step
from radiometer.data import Calibration, SpectralResponse
from radiometer.data.json_text import json_text
from radiometer.errors import DeviceError
from radiometer.plausible import AnyCount, Count, RelativeUncertainty
from radiometer.progress import counted, unseen


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
        """Return the names."""
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
        write_datasheet(Path(path), self.datasheet)

    @property
    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return symbol, title, value and expanded uncertainty of every index that was measured."""
        measured = ((one.procedure, one.figure) for one in self.datasheet.indices)
        return [(of.symbol, of.title, *shown(figure)) for of, figure in measured if figure is not None]

    def __str__(self) -> str:
        """Return symbols and values of what was measured."""
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
    chosen = procedure_named(procedure)
    folder = Path(session) / chosen.name
    missing = [one for one in chosen_steps(chosen, steps) if not (folder / one.name).exists()]
    if len(missing) > 1 and ask is None:
        names = ", ".join(one.name for one in missing)
        raise DeviceError(f"the steps {names} need a hand in between; run at a terminal, or name one step at a time")
    for step in missing:
        if ask is not None:
            ask(f"{chosen.title}, step {step.name}: {step.ask}")
        take_step(
            folder / step.name, chosen, step, bench=Path(bench) if bench else None, name=camera, patch=as_patch(patch),
            repeat=repeat, darks=darks, ask=ask, taken=counted(progress, step.name),
        )  # fmt: skip
    return [folder / one.name for one in missing]


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
    response = _response(Path(spectral_response)) if spectral_response else None
    known = Calibration.read(Path(calibration)) if calibration else None
    how = Evaluation(known, as_patch(patch), source_u_rel, response)
    return QualityReport(evaluate(Path(session), how, lambda title: (progress or unseen)(title, 0, None)))


def _response(path: Path) -> SpectralResponse:
    found = spectrum_from_csv(path)
    return SpectralResponse(wavelength_nm=tuple(found.wavelength_nm), relative=tuple(found.power))

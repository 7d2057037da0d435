"""What the model of a camera lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiometer.api.files import PathLike, Stack, stack_of
from radiometer.api.result import Notice, Progress, Result, unheard
from radiometer.bench.sources import is_photographs, open_source
from radiometer.data import Frame
from radiometer.data.drawing import new_axes, picture
from radiometer.errors import UsageError
from radiometer.numbers import with_u
from radiometer.photographs.response import ENOUGH_PIXELS
from radiometer.reconciliation.engine import plan_of, whole_catalogue
from radiometer.reconciliation.result import FittedParameter, FoundEffect, ReconcileResult
from radiometer.reconciliation.separability import Separability as SeparabilityPlan
from radiometer.reconciliation.sources import Done, DoneCapture, reconcile_source
from radiometer.reporting.page import table
from simulators.chain.camera_model import CameraModel
from simulators.effects.registry import register_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from radiometer.reconciliation.propose import Proposal

__all__ = [
    "FoundEffect",
    "Proposal",
    "ReconcileResult",
    "Reconciliation",
    "Separability",
    "reconcile",
    "reconcile_plan",
]


@dataclass(frozen=True, eq=False, repr=False)
class Separability(Result):
    """Which effects captures could separate.

    Examples:
        >>> import radiometer as rm
        >>> rm.reconcile_plan("out/chart")
        <Separability not separated from others: ...>

    Attributes:
        plan: Pairs that they cannot, what they cannot show at all, and the captures that would.
    """

    plan: SeparabilityPlan

    def to_mapping(self) -> dict[str, Any]:
        return self.plan.to_mapping()

    def __str__(self) -> str:
        together = ", ".join(one.name for one in self.plan.together) or "none"
        return f"not separated from others: {together}; not shown: {', '.join(self.plan.blind) or 'none'}"


@dataclass(frozen=True, eq=False, repr=False)
class Reconciliation(Result):
    """Where simulation and measurement disagree, and which effect is missing.

    Examples:
        >>> import radiometer as rm
        >>> found = rm.reconcile("meter.csv")
        >>> found.verdict, [effect.name for effect in found.effects]
        ('effects_found', ['nominal_settings'])
        >>> before, after = found.gap
        >>> after <= before
        True
        >>> found.write_report("report.html")
        'report.html'

    Attributes:
        done: The result, and what can be written of it.
    """

    done: Done

    @property
    def verdict(self) -> str:
        """Return "agrees", "effects_found", "unnamed_effect" or "incomplete"."""
        return str(self.done.result.verdict)

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """Return what was found, in the order of finding."""
        return self.done.result.effects

    @property
    def gap(self) -> tuple[float, float]:
        """Return the held-out gap before and after."""
        return self.done.result.gap_before, self.done.result.gap_after

    @property
    def result(self) -> ReconcileResult:
        """Return the result with all its figures."""
        return self.done.result

    def write_model(self, path: PathLike, *, provisional: bool = False) -> str:
        """Write the camera model with what was found, and return its name. Raises OutputError if it cannot be written.

        Args:
            path: Where to.
            provisional: Switch provisional effects on in it.
        """
        return self.done.write_model(Path(path), provisional=provisional)

    def write_plan(self, path: PathLike) -> bool:
        """Write the next capture as a plan for `bracket`, and return whether there is one.

        Raises:
            OutputError: If it cannot be written.
        """
        return self.done.write_plan(Path(path))

    def propose(self, folder: PathLike) -> Proposal | None:
        """Write the law for what has no name into a folder, and return it; None where there is none beyond chance.

        Raises:
            OutputError: If a file cannot be written.
            UsageError: If it is not of a capture set: only its pictures can give a law.
        """
        if not isinstance(self.done, DoneCapture):
            raise UsageError(
                f"--propose {folder}: laws are proposed for capture sets only, not for photographs or tables"
            )
        return self.done.propose(Path(folder))

    def write_report(self, path: PathLike) -> str:
        """Write the self-contained HTML report and return its name. Raises OutputError if it cannot be written."""
        return self.done.write_report(Path(path))

    def to_mapping(self) -> dict[str, Any]:
        return self.done.result.to_mapping()

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the gap of held-out settings as it closes, name by name.

        Args:
            axes: Where to draw; a new figure by default.
        """
        where = axes if axes is not None else new_axes()
        names = ["as it was", *(f"+ {effect.name}" for effect in self.effects)]
        gaps = [self.gap[0], *(effect.gap_after for effect in self.effects)]
        where.barh(names, gaps, color=["tab:red", *["tab:blue"] * len(self.effects)])
        where.axvline(1.0, color="black", linewidth=0.8, linestyle=":")
        where.invert_yaxis()
        where.set_xlabel("gap of held-out settings (dotted: noise alone)")
        return where

    def __repr__(self) -> str:
        names = ", ".join(effect.name for effect in self.effects) or "nothing missing"
        before, after = self.gap
        return f"<Reconciliation {self.verdict}: {names}; gap {before:.3g} → {after:.3g}>"

    def _repr_html_(self) -> str:
        rows = [(one.name, _parameters(one), one.where, ", ".join(one.alternatives)) for one in self.effects]
        head = ("effect", "parameters", "where", "alternatives")
        return picture(self.plot, repr(self)) + table(head, rows, words=(1, 2, 3))


def reconcile(
    source: Stack | PathLike,
    *,
    model: PathLike | None = None,
    without: Sequence[str] = (),
    effects: Sequence[PathLike] = (),
    align: str = "auto",
    progress: Progress | None = None,
    notice: Notice = unheard,
) -> Reconciliation:
    """Find where simulation and measurement disagree, name the missing effect, and show the gap shrink.

    Examples:
        >>> import radiometer as rm
        >>> rm.reconcile("meter.csv")
        <Reconciliation effects_found: nominal_settings; gap ... → ...>

    Args:
        source: Capture set, folder of photographs or a stack of them, FITS or raw TIFF files, EMVA 1288 descriptor, or
            light-meter table.
        model: Model file to start from; the ideal camera by default.
        without: Entries of the catalogue to leave out.
        effects: Python files with further effects to look for.
        align: Photographs from the hand: "auto" (where they moved), "on", or "off".
        progress: Called as the work goes on.
        notice: Gets what a user should know, a line each.

    Raises:
        CaptureError: If the source holds nothing that can be reconciled.
        UsageError: If there is no such effect.
    """
    _register(effects, notice)
    _refuse_unknown(without)
    path = Path(source.origin) if isinstance(source, Stack) else Path(source)
    if isinstance(source, Stack) and not source.photographs:
        raise UsageError(f"{source.origin} is a capture set: give its path, so that every frame and patch counts")
    frames = _photographs(source, path, align, notice)
    doing = ["reading frames"]

    def counted(done: int, total: int) -> None:
        if progress is not None:
            progress(doing[0], done, total)

    def say(line: str) -> None:
        doing[0] = line
        counted(0, 0)

    done = reconcile_source(
        path,
        model_path=Path(model) if model else None,
        without=tuple(without),
        photographs=frames,
        progress=counted,
        say=say,
        doubt=lambda line: notice(f"{path.name}: {line}"),
    )
    return Reconciliation(done)


def reconcile_plan(
    capture: PathLike,
    *,
    model: PathLike | None = None,
    without: Sequence[str] = (),
    effects: Sequence[PathLike] = (),
    progress: Progress | None = None,
    notice: Notice = unheard,
) -> Separability:
    """Return which effects the captures of a set could separate, and which capture would separate the others.

    Examples:
        >>> import radiometer as rm
        >>> sorted(rm.reconcile_plan("out/chart").to_mapping())[:2]
        ['blind', 'inseparable']

    Args:
        capture: Capture set.
        progress: Called as frames are read.

    Raises:
        RadiometerError: As `reconcile`, which has the other arguments.
    """
    _register(effects, notice)
    _refuse_unknown(without)
    entries = {name: kind for name, kind in whole_catalogue().items() if name not in without}

    def counted(done: int, total: int) -> None:
        if progress is not None:
            progress("asking what they can separate" if done == total else "reading frames", done, total)

    return Separability(
        plan_of(Path(capture), CameraModel.read(Path(model)) if model else None, catalogue=entries, progress=counted)
    )


def _photographs(source: Stack | PathLike, path: Path, align: str, notice: Notice) -> Sequence[Sequence[Frame]]:
    """Return photographs by colour, green first, in one place; none where the source is something else."""
    if isinstance(source, Stack):
        stack = source
    elif is_photographs(path):
        stack = stack_of(open_source(path, "each", most_pixels=ENOUGH_PIXELS), str(path))
    else:
        return ()
    placed = stack.as_photographs().thinned().placed(align)
    if placed.absent:
        notice(f"{path.name}: {placed.alignment}")
    order = sorted(placed.common, key=lambda name: name != "green")
    return [placed.common[name].every_frame for name in order]


def _register(effects: Sequence[PathLike], notice: Notice) -> None:
    for file in effects:
        notice(f"{file}: looks for {', '.join(register_file(Path(file)))} too")


def _refuse_unknown(names: Sequence[str]) -> None:
    known = whole_catalogue() if names else {}
    for name in names:
        if name not in known:
            raise UsageError(f"--without {name}: there is no such effect; known are {', '.join(sorted(known))}")


def _parameters(effect: FoundEffect) -> str:
    return ", ".join(f"{name} = {_parameter(found)}" for name, found in effect.parameters.items())


def _parameter(found: FittedParameter) -> str:
    return with_u(found.value, 0.0 if found.u is None else 2.0 * found.u, found.unit, k=2)

"""`radiometer reconcile`: where simulation and measurement disagree, and which effect is missing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

import radiometer as rm
from radiometer.cli.console import console, note, progress, show_table
from radiometer.cli.outputs import writes
from radiometer.numbers import rounded, unit_text, with_u

if TYPE_CHECKING:
    from radiometer.api.results import FoundEffect, Proposal, ReconcileResult

Written = TypeVar("Written")


@writes("output", "report", "plan", folder="propose")
def command(
    capture: Annotated[
        Path,
        typer.Argument(
            help="Capture set, photograph folder, FITS or raw TIFF files, EMVA 1288 descriptor (.txt) or light-meter "
            "table (.csv)."
        ),
    ],
    model: Annotated[Path | None, typer.Option(help="Model to start from; the ideal camera by default.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Where the new model is written.")] = None,
    report: Annotated[Path | None, typer.Option(help="Where the HTML report is written.")] = None,
    plan: Annotated[Path | None, typer.Option(help="Write the next capture as a plan for `bracket`.")] = None,
    without: Annotated[list[str] | None, typer.Option(help="Leave an effect out of the catalogue.")] = None,
    effects: Annotated[
        list[Path] | None, typer.Option(help="Python file with further effects; it is run, so name only one you trust.")
    ] = None,
    propose: Annotated[
        Path | None,
        typer.Option(
            help="Folder for a law of the residual that no effect explains: effect file, its test, a plan that "
            "could refute it."
        ),
    ] = None,
    provisional: Annotated[bool, typer.Option("--provisional", help="Switch provisional effects on in -o.")] = False,
    plan_only: Annotated[
        bool, typer.Option("--plan-only", help="Only show which effects these captures could separate.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """Find where simulation and measurement disagree, name the missing effect, add it, show the gap shrink.

    Simulates the capture from the current model and compares means, noise and patterns along every setting. Tries each
    physical effect of the catalogue and keeps those that predict held-out settings better. `-o` writes the model with
    the effects found; the simulator loads it.
    """
    if plan_only:
        _show_plan(capture, model, tuple(without or ()), effects or [], json=json)
        return
    with progress(shown=not json) as shown:
        found = rm.reconcile(
            capture, model=model, without=without or (), effects=effects or (), progress=shown, notice=note
        )
    files = _Files()
    result = found.result.written(
        files.write(lambda: found.write_model(output, provisional=provisional)) if output else None,
        files.write(lambda: found.write_report(report)) if report else None,
    )
    planned = files.write(lambda: found.write_plan(plan)) if plan else None
    proposed = files.write(lambda: found.propose(propose)) if propose else None
    if proposed is not None:
        result = replace(result, extra={**result.extra, "proposal": proposed.to_mapping()})
    if json:
        print(result.to_json())
        files.raise_first()
        return
    show_result(result)
    if propose and (proposed or not files.failed):
        _show_proposal(proposed, propose)
    for path in (result.model, result.report, plan if planned else None):
        if path:
            note(f"wrote {path}")
    if planned is False:
        note(f"no {plan} written: no further capture of this kind would add information")
    files.raise_first()


class _Files:
    """Writes the files of an answer; an error of writing is reported after the answer, which is not lost."""

    def __init__(self) -> None:
        self.failed: list[Exception] = []

    def write(self, file: Callable[[], Written]) -> Written | None:
        """Return what writing a file gives; None where it fails."""
        try:
            return file()
        except Exception as error:  # noqa: BLE001 (reported by `raise_first`, once the answer is printed)
            self.failed.append(error)
            return None

    def raise_first(self) -> None:
        """Raise the error of the first file that could not be written.

        Raises:
            Exception: What writing it raised.
        """
        if self.failed:
            raise self.failed[0]


def _show_proposal(found: Proposal | None, folder: Path) -> None:
    out = console()
    if found is None:
        out.print("\nno law is proposed: no unnamed residual exceeds chance")
        return
    alike = f" (or {', '.join(found.stages_alike)}: these data cannot separate them)" if found.stages_alike else ""
    out.print(f"\nproposed: [bold]{found.name}[/bold], stage {found.stage}{alike}: {found.sentence()}")
    out.print(f"   {found.to_mapping()['formula']}", highlight=False)
    for name, entry in found.parameters.items():
        out.print(f"   {name} = {with_u(entry.value, 2 * (entry.u or 0.0), entry.unit, k=2)}", highlight=False)
    out.print(f"   gap {found.before.gap:.3f} → {found.after.gap:.3f} with it alone ({found.nats:.0f} nats)")
    for rival in found.rivals:
        out.print(f"   rival: {rival.name}, {rival.behind_nats:g} nats behind")
    out.print(f"   look for it in another session: radiometer reconcile SET --effects {folder / f'{found.name}.py'}")


def _show_plan(capture: Path, model: Path | None, without: tuple[str, ...], effects: list[Path], *, json: bool) -> None:
    """Print which effects the captures of a set can separate."""
    with progress(shown=not json) as shown:
        plan = rm.reconcile_plan(capture, model=model, without=without, effects=effects, progress=shown, notice=note)
    if json:
        print(plan.to_json())
        return
    found = plan.plan
    out = console()
    for entry in found.together:
        out.print(f"these captures cannot separate {entry.name} from {', '.join(entry.others)}")
        if entry.capture:
            out.print(f"   {entry.capture['description']}")
    if not found.together:
        out.print("these captures separate all effects that they can detect")
    if found.blind:
        out.print(f"cannot detect: {', '.join(found.blind)}")


def show_result(result: ReconcileResult) -> None:
    """Print a result for people."""
    out = console()
    out.print(f"[bold]{result.sentence}[/bold]")
    if result.frames:
        tests = (
            f"; {result.tests[0]} tests, {result.tests[1]} of them significant in the end" if result.tests[0] else ""
        )
        out.print(f"{result.captures} captures, {result.frames} frames{tests} ({result.seconds:.1f} s)")
    out.print(f"gap {result.gap_before:.3f} → {result.gap_after:.3f} ({result.gap_unit})")
    if result.global_p:
        before, after = result.global_p
        out.print(f"chance of as large a disagreement among all tests: {before:.2g} → {after:.2g}")
    for number, effect in enumerate(result.effects, 1):
        _show_effect(number, effect)
    if result.next_capture:
        out.print(f"\nnext capture: {result.next_capture['description']}")
    for remark in (
        *result.extra.get("remarks", []),
        *(sentence for one in result.repeats for sentence in one.sentences()),
    ):
        out.print(remark)
    _show_covariates(result)
    _show_limits(result)
    for text in result.assumptions:
        out.print(f"assumed: {text}")


def _show_effect(number: int, effect: FoundEffect) -> None:
    out = console()
    weak = ", weak: repeat the captures" if effect.gain_nats < 10 else ""
    tentative = " (provisional)" if effect.provisional else ""
    out.print(
        f"\n{number}. [bold]{effect.name}[/bold]{tentative} along {effect.where}, seen in {effect.block}: "
        f"gap {effect.gap_before:.3f} → {effect.gap_after:.3f} ({effect.evidence}{weak})"
    )
    for name, entry in effect.parameters.items():
        if entry.u is None and entry.value == 0:  # it was not needed: the effect acts without it
            continue
        out.print(f"   {name} = {with_u(entry.value, 2 * (entry.u or 0.0), entry.unit, k=2)}", highlight=False)
    if effect.curve is not None:
        low, high = min(effect.curve.factor), max(effect.curve.factor)
        where = " and ".join(effect.curve.along)
        out.print(f"   with another functional form: {low:.3g} to {high:.3g} times the catalogue's along {where}")
    elif effect.other_law is not None:
        left = ", ".join(f"{name} {entry.value:.2g}" for name, entry in effect.other_law.items())
        out.print(f"   with another functional form than the catalogue's{f'; residual {left}' if left else ''}")
    if effect.elsewhere:
        out.print(f"   structure remains along {', '.join(dict.fromkeys(w for w, _ in effect.elsewhere))}, too")
    if effect.closest:
        out.print(f"   closest effect: {effect.closest[0]}, which explains {100 * effect.closest[1]:.0f} % of it")
    if effect.alternatives:
        together = f" ({effect.evidence_of_any})" if effect.evidence_of_any else ""
        out.print(f"   these data cannot separate it from: {', '.join(effect.alternatives)}{together}")
        if any(entry.u is not None for entry in effect.parameters.values()):
            out.print("   each ± is conditional on this effect being the right one")
    if effect.next_capture:
        out.print(f"   next capture: {effect.next_capture.get('description', '')}")


def _show_covariates(result: ReconcileResult) -> None:
    ordered = sorted(result.covariates.items(), key=lambda item: -item[1].before)
    rows = [(name, f"{gap.before:.1f}", f"{gap.after:.1f}") for name, gap in ordered]
    if rows:
        console().print()
        title = "largest trend along each covariate (χ² per degree of freedom)"
        show_table(title, ("covariate", "before", "after"), rows, bare=True)


def _show_limits(result: ReconcileResult) -> None:
    if not result.limits:
        return
    rows = []
    for name, limit in result.limits.items():
        if limit.amplitude is not None:
            unit = unit_text(limit.unit)
            at = "" if limit.temperature_c is None else f" at {limit.temperature_c:g} °C"
            rows.append((name, rounded(limit.amplitude, limit.amplitude)[0], f"{unit} ({limit.parameter}{at})"))
    console().print()
    if rows:
        title = "what these data would have detected at 5 sigma"
        show_table(title, ("effect", "from", "parameter"), rows, words=(0, 2), bare=True)
    blind = [name for name, limit in result.limits.items() if limit.amplitude is None]
    if blind:
        console().print(f"cannot detect: {', '.join(blind)}")

"""`radiometer adapt run`, `protocols` and `bleach`: the test itself."""

from __future__ import annotations

import json as json_module
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.console import console, note
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from radiometer.adaptation.journal import Event
    from radiometer.adaptation.outcome import Outcome
    from radiometer.adaptation.protocol import AdaptationProtocol
    from radiometer.adaptation.stage import Stage


def register(app: typer.Typer) -> None:
    """Add the commands to `radiometer adapt`."""
    app.command("run")(run)
    app.command("protocols")(protocols)
    app.command("bleach")(bleach)


def run(
    protocol: Annotated[str, typer.Argument(help="Protocol file, or the name of a shipped one (`adapt protocols`).")],
    subject: Annotated[str, typer.Option(help="Pseudonym of the subject.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Journal; SUBJECT-PROTOCOL.jsonl by default.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Thresholds for `adapt fit`; beside the journal by default.")] = None,
    box: Annotated[str | None, typer.Option(help="Light box: sim, a serial number or a port.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Light calibration; the box's own by default.")] = None,
    white: Annotated[str, typer.Option(help="Spectrum of the bleaching light.")] = "white_led",
    fixation: Annotated[float, typer.Option(min=0.0, help="Radiance of the red mark in W·sr⁻¹·m⁻²; 0 for none.")] = 0.0,
    simulate: Annotated[
        str | None, typer.Option(help="A simulated subject in simulated time: steady, never, always, leaves.")
    ] = None,
    slow: Annotated[float, typer.Option(min=0.0, help="Real seconds per simulated trial, to watch it.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of catches and of the simulated subject.")] = 0,
    json: Annotated[bool, typer.Option("--json", help="Each event and the outcome as JSON lines.")] = False,
) -> None:
    """Run a dark-adaptation test; where the journal exists, take it up where it ends.

    Every event is on the disk before the next one happens. Exit code 1 where the run cannot be fitted.
    """
    from radiometer.adaptation.journal import Journal
    from radiometer.adaptation.protocol import read_protocol
    from radiometer.adaptation.run import run_test
    from radiometer.data.storage import write_text_atomic

    chosen = read_protocol(protocol)
    file = out or Path(f"{subject}-{chosen.name}.jsonl")
    with _stage(chosen, box, calibration, simulate, white, fixation, seed, slow) as stage, Journal(file) as journal:
        if journal.events and not json:
            note(f"{file} holds {len(journal.events)} events: taking it up")
        outcome = run_test(chosen, stage, journal, subject=subject, seed=seed, watch=_json_line if json else _tell)
    table = csv or file.with_suffix(".csv")
    write_text_atomic(table, outcome.to_csv())
    _conclude(outcome, table, json=json)
    if not outcome.can_be_fitted:
        raise typer.Exit(1)


def _stage(
    protocol: AdaptationProtocol,
    box: str | None,
    calibration: Path | None,
    simulate: str | None,
    white: str,
    fixation: float,
    seed: int,
    slow: float,
) -> AbstractContextManager[Stage]:
    from radiometer.bench.adaptation import open_box_stage, simulated_stage

    if simulate is not None and box is not None:
        raise UsageError("--simulate and --box exclude each other")
    if simulate is not None:
        return nullcontext(simulated_stage(protocol, simulate, seed=seed, slow_down_s=slow))
    return open_box_stage(protocol, box, calibration, white=white, fixation_w_sr_m2=fixation)


def _json_line(event: Event) -> None:
    print(json_module.dumps(event, ensure_ascii=False), flush=True)


def _tell(event: Event) -> None:
    out = console()
    if event["kind"] == "bleach":
        out.print("bleach: look at the bright field")
    elif event["kind"] == "dark":
        out.print("dark: look at the red mark and press whenever the spot is seen")
    elif event["kind"] == "trial" and event["catch"]:
        out.print("  catch: pressed" if event["false_press"] else "  catch: rightly not pressed")
    elif event["kind"] == "trial":
        found = event["threshold"]
        said = "not seen" if found is None else f"{found:6.2f} log scotopic cd/m²  {_bar(found)}"
        out.print(f"{event['minutes']:6.2f} min  {'pressed too early' if event['false_press'] else said}")


def _bar(threshold: float) -> str:
    """Return a bar from −5.5 up to the threshold: the curve as it grows."""
    return "▪" * max(0, round(5 * (threshold + 5.5)))


def _conclude(outcome: Outcome, table: Path, *, json: bool) -> None:
    if json:
        result = {
            "verdict": str(outcome.verdict),
            "explanation": outcome.explanation,
            "thresholds": len(outcome.times_min),
            "catches": outcome.catches,
            "false_presses": outcome.false_presses,
            "csv": str(table),
        }
        print(json_module.dumps(result, ensure_ascii=False))
        return
    console().print(f"{outcome.verdict}: {outcome.explanation}")
    console().print(f"{len(outcome.times_min)} thresholds, {outcome.false_presses} false presses; wrote {table}")


def protocols(json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False) -> None:
    """List the shipped protocols."""
    from radiometer.adaptation.protocol import SHIPPED, read_protocol

    known = [read_protocol(name) for name in SHIPPED]
    if json:
        print(json_module.dumps([p.model_dump() for p in known]))
        return
    for p in known:
        console().print(f"{p.name:<12} {p.description}")


def bleach(
    luminance: Annotated[float, typer.Argument(min=0.0, help="Luminance of the bleaching field in cd/m².")],
    duration: Annotated[float, typer.Argument(min=0.0, help="Its duration in s.")],
    pupil: Annotated[
        float | None, typer.Option(min=1.0, max=9.0, help="Pupil in mm; the natural one if left out.")
    ] = None,
    field: Annotated[float, typer.Option(min=0.01, help="Area of the field in square degrees.")] = 100.0,
    age: Annotated[float, typer.Option(min=20.0, max=83.0, help="Age in years, for the natural pupil.")] = 28.58,
    scotopic_ratio: Annotated[
        float, typer.Option(min=0.0, help="Scotopic over photopic luminance of the light, for the rods.")
    ] = 2.0,
    json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
) -> None:
    """Say how much of the visual pigment a field bleaches: trolands, rods, cones."""
    from radiometer.adaptation.bleach import bleached_fraction, pupil_diameter_mm, retinal_illuminance_td

    diameter = pupil if pupil is not None else pupil_diameter_mm(luminance, field, age)
    trolands = retinal_illuminance_td(luminance, diameter)
    result: dict[str, Any] = {
        "pupil_mm": diameter,
        "retinal_td": trolands,
        "retinal_td_s": trolands * duration,
        "rods_bleached": bleached_fraction(trolands * scotopic_ratio, duration, "rods"),
        "cones_bleached": bleached_fraction(trolands, duration, "cones"),
    }
    if json:
        print(json_module.dumps(result))
        return
    out = console()
    natural = "" if pupil is not None else " (natural, Watson and Yellott 2012)"
    out.print(f"pupil      {diameter:.2f} mm{natural}")
    out.print(f"retina     {trolands:.4g} td, {trolands * duration:.4g} td·s")
    out.print(f"rods       {100 * result['rods_bleached']:.1f} % bleached (scotopic/photopic {scotopic_ratio:g})")
    out.print(f"cones      {100 * result['cones_bleached']:.1f} % bleached")

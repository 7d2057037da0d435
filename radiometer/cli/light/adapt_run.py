"""`radiometer adapt run`, `protocols` and `bleach`: the test itself."""

from __future__ import annotations

import json as json_module
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.console import console, note
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from radiometer.adaptation.checks import Check
    from radiometer.adaptation.outcome import Outcome
    from radiometer.adaptation.protocol import AdaptationProtocol
    from radiometer.adaptation.stage import Stage
    from radiometer.bench.box_adaptation import BoxRequest


def register(app: typer.Typer) -> None:
    """Add the commands to `radiometer adapt`."""
    app.command("run")(run)
    app.command("protocols")(protocols)
    app.command("bleach")(bleach)


@writes("csv")
def run(
    protocol: Annotated[str, typer.Argument(help="Protocol file, or the name of a shipped one (`adapt protocols`).")],
    subject: Annotated[str, typer.Option(help="Pseudonym of the subject.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Journal; SUBJECT-PROTOCOL.jsonl by default.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Thresholds; beside the journal where they can be fitted.")] = None,
    box: Annotated[str | None, typer.Option(help="Light box: sim, a serial number or a port.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Light calibration; the box's own by default.")] = None,
    accept_stale: Annotated[
        bool, typer.Option("--accept-stale", help="Go on with a calibration older than the protocol allows.")
    ] = False,
    camera: Annotated[
        str | None, typer.Option(help="Camera that checks the dark room: sim, or its id, serial number or address.")
    ] = None,
    bench: Annotated[Path | None, typer.Option(help="Bench file of that camera.")] = None,
    white: Annotated[str, typer.Option(help="Spectrum of the bleaching light.")] = "white_led",
    fixation: Annotated[
        float | None, typer.Option(min=0.0, help="Radiance of the red mark in W·sr⁻¹·m⁻²; the protocol's luminance.")
    ] = None,
    simulate: Annotated[
        str | None,
        typer.Option(
            help="Simulated subject: steady, never, always, leaves, wanders; before --box sim healthy or amd."
        ),
    ] = None,
    room: Annotated[float, typer.Option(min=0.0, help="Luminance of the simulated box's room in cd/m².")] = 0.0,
    slow: Annotated[float, typer.Option(min=0.0, help="Real seconds per simulated trial, to watch it.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of catches and of the simulated subject.")] = 0,
    eye: Annotated[
        str, typer.Option(help="Eye that looks, right or left: the blind spot is on its temporal side.")
    ] = "right",
    preset: Annotated[Path | None, typer.Option(help="Light-box preset: bounds and places of its channels.")] = None,
    screen: Annotated[
        Path | None, typer.Option(help="Calibration of the screen that shows the spot, by `screen calibrate`.")
    ] = None,
    display: Annotated[
        str, typer.Option(help="That screen: browser, or a simulated one: lcd, pwm_lcd, oled.")
    ] = "browser",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the subject's page; 0 for any free one.")] = 0,
    page: Annotated[bool, typer.Option("--page", help="Serve the live curve as a page, dim and red.")] = False,
    page_port: Annotated[int, typer.Option(min=0, max=65535, help="Port of that page; 0 for any free one.")] = 0,
    audio: Annotated[bool, typer.Option("--audio", help="Sound prompts: on the page, else by the bell.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Each event and the outcome as JSON lines.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace tables that exist; a journal is never replaced.")
    ] = False,
) -> None:
    """Run a dark-adaptation test; where the journal exists, take it up where it ends.

    Calibration age, safety and, with --camera or --bench, the dark room are checked before the bleach. Keys: p pauses
    and goes on, q ends the test; a press of the button that is held for 2 s pauses too. Every event is in the journal
    before the next one happens. Exit code 1 where the run cannot be fitted.
    """
    from radiometer.adaptation.controls import Controls
    from radiometer.adaptation.journal import RunJournal
    from radiometer.adaptation.protocol import read_protocol
    from radiometer.adaptation.run import run_test
    from radiometer.adaptation.run_facts import facts_of
    from radiometer.api.outputs import check_outputs
    from radiometer.bench.box_adaptation import SIMULATED, BoxRequest
    from radiometer.cli.keys import listening
    from radiometer.cli.light.adapt_watch import Watching, watchers
    from radiometer.data.guards import safe_name
    from radiometer.data.storage import write_text_atomic

    safe_name(subject, "--subject")
    if eye not in ("right", "left"):
        raise UsageError(f"--eye {eye}: right or left")
    chosen = read_protocol(protocol)
    file = out or Path(f"{subject}-{chosen.name}.jsonl")
    resumed = file.exists()
    check_outputs(None if resumed else file, csv or file.with_suffix(".csv"), force=force or resumed)
    wanted, controls = Watching(page or page_port > 0, page_port, audio, json, slow), Controls(linger_s=slow)
    seen = camera is not None or bench is not None
    whose = f"{subject} {eye}"
    box_request = BoxRequest(
        box, calibration, white, fixation, accept_stale, seen, camera, bench, room, simulate, seed, preset, whose
    )
    with (
        _stage(chosen, box_request, _Screen(screen, display, port, eye)) as (stage, checks),
        RunJournal(file, relive=box == SIMULATED) as journal,
    ):
        if file.stat().st_size and not json:
            note(f"{file} holds a run: taking it up")
        with (
            watchers(wanted, stage, journal, controls) as watch,
            listening({"p": controls.toggle, "q": controls.stop}),
        ):
            outcome = run_test(
                stage.protocol,
                stage,
                journal,
                subject=subject,
                seed=seed,
                watch=watch,
                controls=controls,
                checks=checks,
                eye=eye if chosen.fixation_check else None,
            )
    table = csv or (file.with_suffix(".csv") if outcome.can_be_fitted else None)
    if table is not None:
        shared = [event["u_scale_log10"] for event in journal.of_kind("stage") if event.get("u_scale_log10")]
        write_text_atomic(table, outcome.to_csv(facts_of(chosen, shared[-1] if shared else None, outcome.reliability)))
    _conclude(outcome, table, json=json)
    if outcome.can_be_fitted and not json:
        note(f"fit with: radiometer adapt fit {table}{_criterion_option(chosen)}")
    if not outcome.can_be_fitted:
        raise typer.Exit(1)


def _criterion_option(protocol: AdaptationProtocol) -> str:
    """Return the option for a protocol that ends at a criterion which is no published rod intercept."""
    met = protocol.end.criterion_log10
    return "" if met is None or protocol.intercept is not None else f" --criterion {met:g}"


@dataclass(frozen=True, slots=True)
class _Screen:
    """Which screen gives the light."""

    calibration: Path | None
    display: str
    port: int
    eye: str


@contextmanager
def _stage(
    protocol: AdaptationProtocol, request: BoxRequest, screen: _Screen
) -> Iterator[tuple[Stage, Sequence[Check]]]:
    from radiometer.bench.adaptation import simulated_stage
    from radiometer.bench.box_adaptation import open_box_stage

    on_screen, simulated = protocol.spot.device == "screen", request.subject is not None
    if screen.calibration is not None and not on_screen:
        raise UsageError(f"protocol {protocol.name} shows its spot by the light box; --screen is for screen-only")
    if on_screen and request.box is None and (screen.calibration is not None or not simulated):
        with _on_screen(protocol, request, screen) as opened:
            yield opened
    elif request.subject is not None and request.box is None:
        yield simulated_stage(protocol, request.subject, seed=request.seed), ()
    else:
        with open_box_stage(protocol, request) as opened:
            yield opened


@contextmanager
def _on_screen(
    protocol: AdaptationProtocol, request: BoxRequest, screen: _Screen
) -> Iterator[tuple[Stage, Sequence[Check]]]:
    from radiometer.bench.adaptation_room import room_by_camera
    from radiometer.bench.adaptation_screen import open_screen_stage

    def announce(url: str) -> None:
        note(f"open this address on the subject's screen, then press Start there:\n  {url}")

    with open_screen_stage(
        protocol,
        screen.calibration,
        display=screen.display,
        subject=request.subject,
        port=screen.port,
        announce=announce,
        seed=request.seed,
        eye=screen.eye,
        accept_stale=request.accept_stale,
        room=partial(room_by_camera, protocol, request.camera, request.bench, request.white)
        if request.measure_room
        else None,
    ) as (stage, checks):
        for warning in stage.screen.warnings():
            note(f"warning: {warning}")
        asked, shown = protocol.spot, stage.protocol.spot
        if (shown.lowest_log10, shown.highest_log10) != (asked.lowest_log10, asked.highest_log10):
            note(
                f"the {asked.channel} spot goes from {shown.lowest_log10:.2f} to {shown.highest_log10:.2f} log10 "
                f"scotopic cd/m² on this screen; {protocol.name} asks for {asked.lowest_log10:g} to "
                f"{asked.highest_log10:g}"
            )
        yield stage, checks


def _conclude(outcome: Outcome, table: Path | None, *, json: bool) -> None:
    from radiometer.adaptation.reliability import NAMES

    if json:
        result = {
            "verdict": str(outcome.verdict),
            "explanation": outcome.explanation,
            "thresholds": len(outcome.times_min),
            "catches": outcome.catches,
            "false_presses": outcome.false_presses,
            "reliability": outcome.reliability.to_mapping(),
            "csv": None if table is None else str(table),
        }
        print(json_module.dumps(result, ensure_ascii=False))
        return
    console().print(f"{outcome.verdict}: {outcome.explanation}")
    wrote = "they stay in the journal (--csv writes them)" if table is None else f"wrote {table}"
    console().print(f"{len(outcome.times_min)} thresholds, {outcome.false_presses} false presses; {wrote}")
    for name, rate in outcome.reliability.rates.items():
        console().print(f"{NAMES[name]}: {rate}")
    if "fixation_losses" not in outcome.reliability.rates:
        console().print("fixation was not checked")


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
    from radiometer.adaptation.bleach import (
        bleached_fraction,
        bleached_range,
        pupil_diameter_mm,
        retinal_illuminance_td,
    )

    diameter = pupil if pupil is not None else pupil_diameter_mm(luminance, field, age)
    trolands = retinal_illuminance_td(luminance, diameter)
    result: dict[str, Any] = {
        "pupil_mm": diameter,
        "retinal_td": trolands,
        "retinal_td_s": trolands * duration,
        "rods_bleached": bleached_fraction(trolands * scotopic_ratio, duration, "rods"),
        "cones_bleached": bleached_fraction(trolands, duration, "cones"),
        "rods_bleached_range": bleached_range(trolands * scotopic_ratio, duration, "rods"),
        "cones_bleached_range": bleached_range(trolands, duration, "cones"),
    }
    if json:
        print(json_module.dumps(result))
        return
    out = console()
    natural = "" if pupil is not None else " (natural, Watson and Yellott 2012)"
    out.print(f"pupil      {diameter:.2f} mm{natural}")
    out.print(f"retina     {trolands:.4g} td, {trolands * duration:.4g} td·s")
    rods, cones = (
        f"{100 * result[f'{name}_bleached']:.1f} % bleached "
        f"(published constants: {100 * low:.0f} to {100 * high:.0f} %)"
        for name in ("rods", "cones")
        for low, high in [result[f"{name}_bleached_range"]]
    )
    out.print(f"rods       {rods}; scotopic/photopic {scotopic_ratio:g}")
    out.print(f"cones      {cones}")

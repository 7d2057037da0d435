"""`radiometer adapt`: the dark-adaptation test."""

from __future__ import annotations

import os
import select
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

import radiometer as rm
from radiometer.cli.console import console, note, progress
from radiometer.cli.options import BenchOption, BoxPresetOption, JsonOption, SeedOption, WhiteOption, command_group
from radiometer.cli.outputs import writes
from radiometer.plausible import (
    Age,
    AnyCount,
    Duration,
    FieldArea,
    Luminance,
    NotNegative,
    Port,
    Pupil,
    PupilAge,
    ScotopicRatio,
    Uncertainty,
)

if TYPE_CHECKING:
    from radiometer.api.adapt import Session, Watcher

_DIM_RED: Final = "rgb(135,0,0)"  # light that spares the rods of whoever looks at the terminal

MapOption = Annotated[
    list[str] | None,
    typer.Option("--map", help="Columns and units that a table does not state: time=t:s, threshold=thr:log10."),
]

app = command_group("Dark adaptation: run the test, and analyse the measured thresholds.")


@app.command()
@writes("csv")
def run(
    protocol: Annotated[str, typer.Argument(help="Protocol file, or the name of a shipped one (`adapt protocols`).")],
    subject: Annotated[str, typer.Option(help="Pseudonym of the subject.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Journal; SUBJECT-PROTOCOL-EYE-DATETIME.jsonl.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Thresholds; next to the journal where they can be fitted.")] = None,
    box: Annotated[str | None, typer.Option(help="Light box: sim, a serial number or a port.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Light calibration; the box's own by default.")] = None,
    accept_stale: Annotated[
        bool, typer.Option("--accept-stale", help="Go on with a calibration older than the protocol allows.")
    ] = False,
    camera: Annotated[
        str | None, typer.Option(help="Camera that checks the dark room: sim, or its id, serial number or address.")
    ] = None,
    bench: BenchOption = None,
    white: WhiteOption = "white_led",
    fixation: Annotated[
        NotNegative | None, typer.Option(help="Radiance of the red mark in W·sr⁻¹·m⁻²; the protocol's luminance.")
    ] = None,
    simulate: Annotated[
        str | None,
        typer.Option(help="Simulated subject: steady, never, always, leaves, wanders; healthy or amd for rapid."),
    ] = None,
    room: Annotated[NotNegative, typer.Option(help="Luminance of the simulated box's room in cd·m⁻².")] = 0.0,
    slow: Annotated[Duration, typer.Option(help="Real seconds per simulated trial, to watch it.")] = 0.0,
    seed: SeedOption = 0,
    eye: Annotated[
        str, typer.Option(help="Eye that looks, right or left: the blind spot is on its temporal side.")
    ] = "right",
    age: Annotated[Age | None, typer.Option(help="Age of the subject in years.")] = None,
    pupil: Annotated[Pupil | None, typer.Option(help="Measured diameter of the pupil in mm.")] = None,
    visit: Annotated[
        str | None, typer.Option(help="Date and time of the visit (ISO 8601, UTC without a zone).")
    ] = None,
    practice: Annotated[
        bool, typer.Option("--practice", help="Three minutes without a bleach, to learn the task.")
    ] = False,
    preset: BoxPresetOption = None,
    screen: Annotated[
        Path | None, typer.Option(help="Calibration of the screen that shows the spot, by `screen calibrate`.")
    ] = None,
    display: Annotated[
        str | None, typer.Option(help="That screen: browser, or a simulated one: lcd, pwm_lcd, oled.")
    ] = None,
    port: Annotated[Port, typer.Option(help="Port of the subject's page; 0 for any free one.")] = 0,
    page: Annotated[bool, typer.Option("--page", help="Serve the live curve as a page, dim and red.")] = False,
    page_port: Annotated[Port, typer.Option(help="Port of that page; 0 for any free one.")] = 0,
    audio: Annotated[bool, typer.Option("--audio", help="Sound prompts: on the page, else by the bell.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Each event and the outcome as JSON lines.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace tables that exist; a journal is never replaced.")
    ] = False,
) -> None:
    """Run a dark-adaptation test; an unfinished run of the same visit is taken up where it ends.

    Each visit has its own journal, with date and time in its name. A finished run is never taken up.

    Calibration age, safety and, with --camera or --bench, the dark room are checked before the bleach. Keys: p pauses
    and goes on, q ends the test; a press of the button that is held for 2 s pauses too. Every event is in the journal
    before the next one happens. Exit code 1 where the run cannot be fitted.
    """

    @contextmanager
    def view(session: Session) -> Iterator[Watcher]:
        shown = _json_lines(session) if json else _live_curve(session)
        with shown as notify, listening({"p": session.controls.toggle, "q": session.controls.stop}):
            yield notify

    done = rm.adapt_run(
        protocol, subject, out, csv=csv, box=box, calibration=calibration, accept_stale=accept_stale, camera=camera,
        bench=bench, white=white, fixation=fixation, simulate=simulate, room=room, slow_s=slow, seed=seed, eye=eye,
        age=age, pupil=pupil, visit=visit, practice=practice, preset=preset, screen=screen,
        display=display, port=port, page=page, page_port=page_port, audio=audio, force=force, view=view, notice=note,
        announce=_announce,
        bell=lambda: print("\a", end="", file=sys.stderr, flush=True),
    )  # fmt: skip
    if json:
        print(done.to_json())
    else:
        for line in done.lines():
            console().print(line)
        if done.outcome.can_be_fitted:
            note(f"fit with: radiometer adapt fit {done.table}{done.fit_options}")
    if not (done.outcome.can_be_fitted or done.practised):
        raise typer.Exit(1)


def _announce(url: str) -> None:
    note("open this address on the subject's screen, then press Start there:", f"  {url}")


@contextmanager
def _json_lines(session: Session) -> Iterator[Watcher]:
    yield lambda event: print(session.event_json(event), flush=True)


@contextmanager
def _live_curve(session: Session) -> Iterator[Watcher]:
    """Show the test while the block runs: a growing curve, dim and red; plain lines where there is no terminal."""
    if not sys.stdout.isatty():

        def notify(event: dict[str, Any]) -> None:
            line = session.event_line(event)
            if line is not None:
                console().print(line)

        yield notify
        return
    from rich.live import Live
    from rich.text import Text

    shown, out = session.live_text(), console()

    def render() -> Text:
        return Text("\n".join(shown.lines(max(40, out.width) - 12)), style=_DIM_RED, no_wrap=True)

    with Live(console=out, get_renderable=render, refresh_per_second=2) as live:
        yield shown.take
        live.refresh()


@app.command()
def protocols(json: JsonOption = False) -> None:
    """List the shipped protocols."""
    found = rm.adapt_protocols()
    if json:
        print(found.to_json())
        return
    for one in found.protocols:
        console().print(f"{one.name:<12} {one.description}")


@app.command()
def bleach(
    luminance: Annotated[Luminance, typer.Argument(help="Luminance of the bleaching field in cd·m⁻².")],
    duration: Annotated[Duration, typer.Argument(help="Its duration in s.")],
    pupil: Annotated[Pupil | None, typer.Option(help="Pupil in mm; the natural one if left out.")] = None,
    field: Annotated[FieldArea, typer.Option(help="Area of the field in square degrees.")] = 100.0,
    age: Annotated[PupilAge, typer.Option(help="Age in years, for the natural pupil.")] = 28.58,
    scotopic_ratio: Annotated[
        ScotopicRatio, typer.Option(help="Scotopic over photopic luminance of the light, for the rods.")
    ] = 2.0,
    json: JsonOption = False,
) -> None:
    """Say how much of the visual pigment a field bleaches: trolands, rods, cones."""
    found = rm.adapt_bleach(luminance, duration, pupil=pupil, field=field, age=age, scotopic_ratio=scotopic_ratio)
    if json:
        print(found.to_json())
        return
    out = console()
    natural = "" if pupil is not None else " (natural, Watson and Yellott 2012)"
    out.print(f"pupil      {found.pupil_mm:.2f} mm{natural}")
    out.print(f"retina     {found.retinal_td:.4g} td, {found.retinal_td_s:.4g} td·s")
    rods, cones = (
        f"{100 * share:.1f} % bleached (published constants: {100 * low:.0f} to {100 * high:.0f} %)"
        for share, (low, high) in (
            (found.rods_bleached, found.rods_bleached_range), (found.cones_bleached, found.cones_bleached_range)
        )
    )  # fmt: skip
    out.print(f"rods       {rods}; scotopic/photopic {scotopic_ratio:g}")
    out.print(f"cones      {cones}")


@app.command()
@writes("report", "csv")
def fit(
    data: Annotated[
        Path,
        typer.Argument(
            help="Table of times and thresholds, perhaps with their sigma: many forms and units are understood."
        ),
    ],
    criterion: Annotated[
        float | None,
        typer.Option(help="log₁₀ threshold whose time is reported, in place of the protocol's rod intercept."),
    ] = None,
    stimulus_u_log10: Annotated[
        Uncertainty | None, typer.Option(help="Standard uncertainty of the stimulus calibration, log₁₀ units.")
    ] = None,
    bootstrap: Annotated[AnyCount, typer.Option(help="Bootstrap redraws; 0 for none.")] = 200,
    seed: SeedOption = 1,
    mapped: MapOption = None,
    report: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV of thresholds, fit and residuals to write.")] = None,
    json: JsonOption = False,
) -> None:
    """Fit cone and rod branches to thresholds: plateau, rod–cone break, S2, rod intercept, final threshold.

    One branch, cones and S2 (5 parameters) or cones, S2 and S3 (7) are tried; the AICc decides among those that
    make sense.
    """
    with progress(shown=not json) as shown:
        found = rm.adapt_fit(
            data, criterion, stimulus_u_log10=stimulus_u_log10, bootstrap=bootstrap, seed=seed, mapped=mapped or (),
            progress=shown,
        )  # fmt: skip
    if report is not None:
        found.write_report(report)
    if csv is not None:
        found.write_csv(csv)
    if json:
        print(found.to_json())
        return
    for verdict in found.verdicts():
        console().print(f"[bold]{verdict}[/bold]")
    for line in found.lines():
        console().print(line)
    chosen = found.fit.chosen
    note(f"levels in log₁₀ of: {found.series.level_name}")
    note(f"model {chosen.model.name}; scatter of a threshold {chosen.sigma:.3f} log₁₀ units")
    for line in found.series.taken:
        note(f"taken: {line}")


@app.command()
def instructions(
    protocol: Annotated[str, typer.Argument(help="Protocol file, or the name of a shipped one.")],
    json: JsonOption = False,
) -> None:
    """Print what to read aloud to the subject before the test."""
    found = rm.adapt_instructions(protocol)
    print(found.to_json() if json else "\n\n".join(found.lines()))


@app.command()
@writes("report")
def visits(
    files: Annotated[list[Path], typer.Argument(help="Tables or journals of the visits, in their order.")],
    report: Annotated[Path | None, typer.Option(help="HTML page to write, with all curves in one picture.")] = None,
    mapped: MapOption = None,
    json: JsonOption = False,
) -> None:
    """Fit several visits and lay their curves over each other."""
    found = rm.adapt_visits(files, report=report, mapped=mapped or ())
    if json:
        print(found.to_json())
        return
    for line in found.lines():
        console().print(line)


@app.command()
def retest(
    visits: Annotated[
        list[Path],
        typer.Argument(help="Tables as `adapt fit` reads them: first and second visit of each subject, in turn."),
    ],
    mapped: MapOption = None,
    json: JsonOption = False,
) -> None:
    """Say how well repeated visits agree: differences of break, S2, rod intercept and plateau.

    From three subjects on with limits of agreement (Bland and Altman), mean ± 1.96 standard deviations, and their 95 %
    intervals.
    """
    found = rm.adapt_retest(visits, mapped=mapped or ())
    if json:
        print(found.to_json())
        return
    if not found.comparisons:
        raise rm.MeasurementError("no pair of visits has a break, an S2 slope or a rod intercept in both")
    for heading, lines in found.lines():
        console().print(f"[bold]{heading}[/bold]")
        for line in lines:
            console().print(f"  {line}")


LOOK_S: Final = 0.2  # how long the end waits for the thread at most


@contextmanager
def listening(actions: Mapping[str, Callable[[], None]]) -> Iterator[None]:
    """Call an action for each of its keys, from a thread, while the block runs; nothing without a terminal.

    Args:
        actions: What each key does; it must be safe to call from another thread.
    """
    if not sys.stdin.isatty():
        yield
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    over = threading.Event()
    reader = threading.Thread(target=_read_keys, args=(terminal, actions, over), name="keys", daemon=True)
    tty.setcbreak(terminal)
    reader.start()
    try:
        yield
    finally:
        over.set()
        reader.join()
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _read_keys(terminal: int, actions: Mapping[str, Callable[[], None]], over: threading.Event) -> None:
    while not over.is_set():
        if not select.select([terminal], [], [], LOOK_S)[0]:
            continue
        key = os.read(terminal, 1).decode(errors="replace")
        if not key:
            return
        if key in actions:
            actions[key]()

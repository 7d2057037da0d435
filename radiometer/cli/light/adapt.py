"""`radiometer adapt`: the dark-adaptation test."""

from __future__ import annotations

import functools
import os
import select
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import typer

import radiometer as rm
from radiometer.cli.console import console, note, show_lines
from radiometer.cli.function import command_of
from radiometer.cli.options import command_group

if TYPE_CHECKING:
    from radiometer.api.adapt import Session, Watcher

_DIM_RED: Final = "rgb(135,0,0)"  # light that spares the rods of whoever looks at the terminal

app = command_group("Dark adaptation: run the test, and analyse the measured thresholds.")


def _while_it_runs(json: bool, **_: Any) -> dict[str, Any]:
    """Return what watches a run, announces its page and sounds."""

    @contextmanager
    def view(session: Session) -> Iterator[Watcher]:
        shown = _json_lines(session) if json else _live_curve(session)
        with shown as notify, listening({"p": session.controls.toggle, "q": session.controls.stop}):
            yield notify

    def announce(url: str) -> None:
        note("open this address on the subject's screen, then press Start there:", f"  {url}")

    bell = functools.partial(print, "\a", end="", file=sys.stderr, flush=True)
    return {"watch": None, "view": view, "announce": announce, "bell": bell}


def _show_run(done: rm.AdaptationRun) -> None:
    show_lines(done)
    if done.outcome.can_be_fitted:
        note(f"fit with: radiometer adapt fit {done.table}{done.fit_options}")


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


def _show_protocols(found: rm.Protocols) -> None:
    for one in found.protocols:
        console().print(f"{one.name:<12} {one.description}")


def _show_bleach(found: rm.Bleach) -> None:
    out = console()
    natural = " (natural, Watson and Yellott 2012)" if found.natural_pupil else ""
    out.print(f"pupil      {found.pupil_mm:.2f} mm{natural}")
    out.print(f"retina     {found.retinal_td:.4g} td, {found.retinal_td_s:.4g} td·s")
    rods, cones = (
        f"{100 * share:.1f} % bleached (published constants: {100 * low:.0f} to {100 * high:.0f} %)"
        for share, (low, high) in (
            (found.rods_bleached, found.rods_bleached_range), (found.cones_bleached, found.cones_bleached_range)
        )
    )  # fmt: skip
    out.print(f"rods       {rods}; scotopic/photopic {found.scotopic_ratio:g}")
    out.print(f"cones      {cones}")


def _show_fit(found: rm.AdaptationCurve) -> None:
    for verdict in found.verdicts():
        console().print(f"[bold]{verdict}[/bold]")
    show_lines(found)
    chosen = found.fit.chosen
    note(f"levels in log₁₀ of: {found.series.level_name}")
    note(f"model {chosen.model.name}; scatter of a threshold {chosen.sigma:.3f} log₁₀ units")
    for line in found.series.taken:
        note(f"taken: {line}")


def _show_instructions(found: rm.Instructions) -> None:
    print("\n\n".join(found.lines()))


def _show_retest(found: rm.Retest) -> None:
    if not found.comparisons:
        raise rm.MeasurementError("no pair of visits has a break, an S2 slope or a rod intercept in both")
    for heading, lines in found.lines():
        console().print(f"[bold]{heading}[/bold]")
        for line in lines:
            console().print(f"  {line}")


for name, made in {
    "run": command_of(
        "adapt_run", _show_run, files=("csv",), serves=_while_it_runs, subject=typer.Option(),
        code=lambda done: int(not (done.outcome.can_be_fitted or done.practised)),
    ),
    "protocols": command_of("adapt_protocols", _show_protocols),
    "bleach": command_of("adapt_bleach", _show_bleach),
    "fit": command_of("adapt_fit", _show_fit, results=("report", "csv"), criterion=typer.Option()),
    "instructions": command_of("adapt_instructions", _show_instructions),
    "visits": command_of("adapt_visits", show_lines, files=("report",), visits=typer.Argument(metavar="FILES")),
    "retest": command_of("adapt_retest", _show_retest),
}.items():  # fmt: skip
    app.command(name)(made)


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

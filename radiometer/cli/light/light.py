"""`radiometer light`: the LED/button box by hand."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from radiometer.cli.arguments import parse_seconds
from radiometer.cli.console import console, note
from radiometer.cli.light.light_account import account
from radiometer.cli.light.light_calibrate import calibrate
from radiometer.cli.light.light_report import status_report, tell_event, tell_state, tell_status
from radiometer.errors import DeviceError, DeviceNotFound, UsageError

if TYPE_CHECKING:
    from radiometer.bench.boxes import OpenedBox
    from radiometer.devices.light_box import Level

_LOOK_S = 0.25  # how often the light is looked at
_BUDGET_USED_UP = 0.02  # of the full budget: it refills from the moment the light went out

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="The light box: LED channels, timed by the box, and a button. Channels: bleach, spot, spot_red, fixation.",
)

Box = Annotated[str | None, typer.Option("--box", help="sim, a serial number or a port; the only one by default.")]
Channel = Annotated[str, typer.Argument(help="bleach, spot, spot_red or fixation.")]
RadianceOption = Annotated[float | None, typer.Option(help="Radiance in W·sr⁻¹·m⁻²; needs a calibrated channel.")]
LevelOption = Annotated[int | None, typer.Option(min=0, max=65535, help="Raw level instead of a radiance.")]
LowOption = Annotated[bool, typer.Option("--low", help="Raw level on the low current range.")]
CalibrationOption = Annotated[Path | None, typer.Option(help="Light calibration; the box's own by default.")]
PresetOption = Annotated[Path | None, typer.Option(help="Light-box preset with safety bounds.")]
Json = Annotated[bool, typer.Option("--json", help="JSON on standard output.")]


@app.command("set")
def set_level(
    channel: Channel,
    radiance: RadianceOption = None,
    level: LevelOption = None,
    low: LowOption = False,
    hold: Annotated[str | None, typer.Option("--for", help="Stay lit for this time; until Ctrl-C by default.")] = None,
    box: Box = None,
    calibration: CalibrationOption = None,
    preset: PresetOption = None,
    json: Json = False,
) -> None:
    """Light a channel steadily, for as long as this command runs: the box goes dark without its host."""
    from radiometer.bench.boxes import open_light_box

    wanted = _level(radiance, level, low)
    lit_s = parse_seconds(hold, "--for") if hold else None
    with open_light_box(box, calibration=calibration, preset=preset) as opened:
        state = opened.box.set_level(channel, wanted)
        tell_state(opened, state, radiance, json=json)
        _stay(opened, lit_s, channel if state.drive.level else None)


@app.command()
def pulse(
    channel: Channel,
    duration: Annotated[str, typer.Option(help="Length, such as 0.2, 200ms; at most 600 s.")],
    radiance: RadianceOption = None,
    level: LevelOption = None,
    low: LowOption = False,
    box: Box = None,
    calibration: CalibrationOption = None,
    preset: PresetOption = None,
    json: Json = False,
) -> None:
    """Give one pulse, timed by the box."""
    from radiometer.bench.boxes import open_light_box

    wanted, lit_s = _level(radiance, level, low), parse_seconds(duration, "--duration")
    with open_light_box(box, calibration=calibration, preset=preset) as opened:
        state = opened.box.pulse(channel, wanted, lit_s)
        tell_state(opened, state, radiance, json=json)
        _stay(opened, lit_s)


@app.command()
def blink(
    channel: Channel,
    on: Annotated[str, typer.Option(help="Bright time, such as 0.1 or 100ms.")] = "200ms",
    off_time: Annotated[str, typer.Option("--off", help="Dark time.")] = "800ms",
    count: Annotated[int, typer.Option(min=0, max=65535, help="Number of blinks; 0: until Ctrl-C.")] = 0,
    radiance: RadianceOption = None,
    level: LevelOption = None,
    low: LowOption = False,
    hold: Annotated[str | None, typer.Option("--for", help="Stop after this time.")] = None,
    box: Box = None,
    calibration: CalibrationOption = None,
    preset: PresetOption = None,
    json: Json = False,
) -> None:
    """Blink a channel, timed by the box."""
    from radiometer.bench.boxes import open_light_box

    wanted = _level(radiance, level, low)
    on_s, off_s = parse_seconds(on, "--on"), parse_seconds(off_time, "--off")
    lit_s = parse_seconds(hold, "--for") if hold else (on_s + off_s) * count if count else None
    with open_light_box(box, calibration=calibration, preset=preset) as opened:
        state = opened.box.blink(channel, wanted, on_s, off_s, count)
        tell_state(opened, state, radiance, json=json)
        _stay(opened, lit_s, channel if count == 0 else None)


@app.command()
def off(
    channel: Annotated[str | None, typer.Argument(help="One channel; all by default.")] = None,
    box: Box = None,
    json: Json = False,
) -> None:
    """Darken every box that can be reached, or one of them, or one channel; also while another program holds it.

    A program that holds a box, such as the daemon, darkens all of it. The button of the box does so too, held for 3 s.
    """
    from radiometer.bench.boxes import darken, nothing_answers

    dark, failures = darken(box, channel)
    for one in dark:
        how = {"dark": one.dark} if one.darkened_by is None else {"darkened_by": one.darkened_by}
        by = f", by process {one.darkened_by}, which holds it" if one.darkened_by is not None else ""
        text = f"light box {one.serial}: dark{by}"
        print(json_module.dumps({"box": one.serial, **how})) if json else console().print(text)
    if failures:
        raise DeviceError("; ".join(map(str, failures)))
    if not dark:
        raise DeviceNotFound(nothing_answers(box))


@app.command()
def status(box: Box = None, json: Json = False) -> None:
    """Show identity, supply, temperature, clock, channels and limits."""
    from radiometer.bench.boxes import open_light_box

    with open_light_box(box) as opened:
        report = status_report(opened)
    if json:
        print(json_module.dumps(report))
        return
    tell_status(report)


@app.command("watch-buttons")
def watch_buttons(
    hold: Annotated[str | None, typer.Option("--for", help="Stop after this time; at Ctrl-C by default.")] = None,
    count: Annotated[int | None, typer.Option(min=1, help="Stop after so many presses.")] = None,
    box: Box = None,
    json: Json = False,
) -> None:
    """Print presses and releases as they come, with the uncertainty of their times."""
    from radiometer.bench.boxes import open_light_box

    limit_s = parse_seconds(hold, "--for") if hold else 1e9
    presses = 0
    with open_light_box(box) as opened:
        start_s = opened.box.link.line.now()
        try:
            for event in opened.box.buttons(limit_s):
                presses += event.pressed
                entry = {"pressed": event.pressed, "time_s": event.time_s - start_s, "u_s": event.u_time_s}
                tell_event(entry, json=json)
                if count is not None and presses >= count:
                    return
        except KeyboardInterrupt:
            return


app.command()(calibrate)
app.command()(account)


def _level(radiance: float | None, level: int | None, low: bool) -> Level:
    from radiometer.devices import CurrentRange, DriveLevel, Radiance

    if (radiance is None) == (level is None):
        raise UsageError("give either --radiance or --level")
    if radiance is not None:
        if low:
            raise UsageError("--low goes with --level; a radiance chooses its range by itself")
        return Radiance(radiance)
    assert level is not None
    return DriveLevel(level, CurrentRange.LOW if low else CurrentRange.HIGH)


def _stay(opened: OpenedBox, lit_s: float | None, channel: str | None = None) -> None:
    """Keep the box lit for a time, or until Ctrl-C, and watch it; the simulated box in this process needs no watching.

    Args:
        opened: The box.
        lit_s: How long in s; None until Ctrl-C.
        channel: The channel that must stay lit for that time; None where it ends by itself.

    Raises:
        DeviceError: If the box was lost, or ended the light before its time.
    """
    from radiometer.devices import ChannelMode

    if lit_s is None and opened.twin is not None:
        return
    if lit_s is None:
        note("stop with Ctrl-C")
    now_s = opened.box.link.line.now
    start_s = now_s()
    end_s = start_s + (lit_s if lit_s is not None else 1e9)
    try:
        while (left_s := end_s - now_s()) > 0:
            opened.wait(min(left_s, _LOOK_S))
            if channel is None:
                opened.box.status()  # raises where the box was lost
            elif opened.box.read_channel(channel).mode is ChannelMode.OFF and now_s() < end_s - _LOOK_S:
                raise _ended_early(opened, channel, now_s() - start_s, lit_s)
    except KeyboardInterrupt:
        return


def _ended_early(opened: OpenedBox, channel: str, after_s: float, lit_s: float | None) -> DeviceError:
    left = opened.box.read_channel(channel).energy_left
    reason = (
        "its energy budget is used up; take a lower level or a shorter time"
        if left < _BUDGET_USED_UP
        else "another program asked for darkness, or the button of the box was held"
    )
    wanted = "" if lit_s is None else f" of {lit_s:g} s"
    return DeviceError(
        f"the light box ended the light of {channel} by itself after {after_s:.1f} s{wanted}"
        f" (known to {_LOOK_S:g} s): {reason}"
    )

"""`radiometer light`: the LED/button box by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch, parse_seconds
from radiometer.cli.console import console, note, progress
from radiometer.cli.function import command_of
from radiometer.cli.options import (
    BenchOption,
    BoxOption,
    BoxPresetOption,
    CameraOption,
    JsonOption,
    command_group,
    relative_option,
)
from radiometer.cli.outputs import writes
from radiometer.numbers import with_u
from radiometer.plausible import BlinkCount, BoxLevel, Count, PointsPerDecade, Seed

_JUMP_SHOWN = 0.005  # a start further off than half a per cent matters next to a calibration's 1 %

app = command_group(
    "The light box: LED channels, timed by the box, and a button. Channels: bleach, field, spot, spot_green, "
    "spot_red, fixation."
)
Channel = Annotated[str, typer.Argument(help="bleach, field, spot, spot_green, spot_red or fixation.")]
RadianceOption = Annotated[float | None, typer.Option(help="Radiance in W·sr⁻¹·m⁻²; needs a calibrated channel.")]
LevelOption = Annotated[BoxLevel | None, typer.Option(help="Raw level instead of a radiance.")]
LowOption = Annotated[bool, typer.Option("--low", help="Raw level on the low current range.")]
LightOption = Annotated[Path | None, typer.Option("--calibration", help="Light calibration; the box's own by default.")]
SubjectOption = Annotated[str | None, typer.Option(help="Who looks: counts in this eye's account, too; with --eye.")]
EyeOption = Annotated[str | None, typer.Option(help="Eye that looks, right or left; every eye by default.")]
NoEyeOption = Annotated[bool, typer.Option("--no-eye", help="State that no eye looks: counts for the box alone.")]
HoldOption = Annotated[str | None, typer.Option("--for", help="Stop after this time; at Ctrl-C by default.")]


@app.command("set")
def set_level(
    channel: Channel,
    radiance: RadianceOption = None,
    level: LevelOption = None,
    low: LowOption = False,
    hold: HoldOption = None,
    box: BoxOption = None,
    subject: SubjectOption = None,
    eye: EyeOption = None,
    no_eye: NoEyeOption = False,
    calibration: LightOption = None,
    preset: BoxPresetOption = None,
    json: JsonOption = False,
) -> None:
    """Light a channel steadily, for as long as this command runs: the box goes dark without its host."""
    rm.light_set(
        channel, radiance, level=level, low=low, hold_s=parse_seconds(hold, "--for"), box=box, subject=subject, eye=eye,
        no_eye=no_eye, calibration=calibration, preset=preset, lit=lambda found: _show_lit(found, json=json),
        notice=note,
    )  # fmt: skip


@app.command()
def pulse(
    channel: Channel,
    duration: Annotated[str, typer.Option(help="Length, such as 0.2, 200ms; at most 600 s.")],
    radiance: RadianceOption = None,
    level: LevelOption = None,
    low: LowOption = False,
    box: BoxOption = None,
    subject: SubjectOption = None,
    eye: EyeOption = None,
    no_eye: NoEyeOption = False,
    calibration: LightOption = None,
    preset: BoxPresetOption = None,
    json: JsonOption = False,
) -> None:
    """Give one pulse, timed by the box."""
    rm.light_pulse(
        channel, parse_seconds(duration, "--duration"), radiance, level=level, low=low, box=box, subject=subject,
        eye=eye, no_eye=no_eye, calibration=calibration, preset=preset,
        lit=lambda found: _show_lit(found, json=json), notice=note,
    )  # fmt: skip


@app.command()
def blink(
    channel: Channel,
    on: Annotated[str, typer.Option(help="Bright time, such as 0.1 or 100ms.")] = "200ms",
    off_time: Annotated[str, typer.Option("--off", help="Dark time.")] = "800ms",
    count: Annotated[BlinkCount, typer.Option(help="Number of blinks; 0: until Ctrl-C.")] = 0,
    radiance: RadianceOption = None,
    level: LevelOption = None,
    low: LowOption = False,
    hold: HoldOption = None,
    box: BoxOption = None,
    subject: SubjectOption = None,
    eye: EyeOption = None,
    no_eye: NoEyeOption = False,
    calibration: LightOption = None,
    preset: BoxPresetOption = None,
    json: JsonOption = False,
) -> None:
    """Blink a channel, timed by the box."""
    rm.light_blink(
        channel, parse_seconds(on, "--on"), parse_seconds(off_time, "--off"), count, radiance, level=level, low=low,
        hold_s=parse_seconds(hold, "--for"), box=box, subject=subject, eye=eye, no_eye=no_eye,
        calibration=calibration, preset=preset, lit=lambda found: _show_lit(found, json=json), notice=note,
    )  # fmt: skip


@app.command()
def off(
    channel: Annotated[str | None, typer.Argument(help="One channel; all by default.")] = None,
    box: BoxOption = None,
    json: JsonOption = False,
) -> None:
    """Darken every box that can be reached, or one of them, or one channel; also while another program holds it.

    A program that holds a box, such as the daemon, darkens all of it. The button of the box does so too, held for 3 s.
    """
    rm.light_off(channel, box=box, darkened=lambda one: print(one.to_json()) if json else console().print(str(one)))


@app.command()
def status(box: BoxOption = None, json: JsonOption = False) -> None:
    """Show identity, supply, temperature, clock, channels and limits."""
    found = rm.light_status(box=box)
    if json:
        print(found.to_json())
        return
    _show_status(found.report)


@app.command("watch-buttons")
def watch_buttons(
    hold: HoldOption = None,
    count: Annotated[Count | None, typer.Option(help="Stop after so many presses.")] = None,
    box: BoxOption = None,
    json: JsonOption = False,
) -> None:
    """Print presses and releases as they come, with the uncertainty of their times."""
    try:
        for event in rm.light_watch_buttons(parse_seconds(hold, "--for"), count, box=box):
            print(event.to_json() if json else str(event), flush=True)
    except KeyboardInterrupt:
        return


@app.command()
@writes("out")
def calibrate(
    channel: Annotated[list[str] | None, typer.Option(help="Channel to calibrate; may be repeated; all.")] = None,
    box: BoxOption = None,
    camera: CameraOption = None,
    bench: BenchOption = None,
    patch: Annotated[str | None, typer.Option(help="Lit area in the frame, X,Y,W,H in pixels.")] = None,
    camera_calibration: Annotated[Path | None, typer.Option(help="Camera calibration; the bench's by default.")] = None,
    points_per_decade: Annotated[PointsPerDecade, typer.Option(help="Density of the levels.")] = 4.0,
    responsivity: Annotated[
        Path | None, typer.Option(help="CSV wavelength_nm,responsivity (per W) of the camera; flat QE without.")
    ] = None,
    spectral_u_rel: Annotated[
        float | None, relative_option("--spectral-u-rel", "Relative u (k = 1) of the spectral correction")
    ] = None,
    seed: Annotated[Seed | None, typer.Option(help="Makes the random order of the levels.")] = None,
    preset: BoxPresetOption = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="File to write; the box's own by default.")] = None,
    json: JsonOption = False,
    force: Annotated[bool, typer.Option("--force", help="Replace output files that exist.")] = False,
) -> None:
    """Measure each channel's radiance over its levels with the camera, on both current ranges.

    Levels come in random order, each after it has settled. The dark reading is subtracted; a reference level measured
    in between determines the drift. With the file written, `radiometer light set spot --radiance 0.01` works.
    """
    with progress(shown=not json) as shown:
        found = rm.light_calibrate(
            channel, box=box, camera=camera, bench=bench, patch=parse_patch(patch),
            camera_calibration=camera_calibration, points_per_decade=points_per_decade, responsivity=responsivity,
            spectral_u_rel=spectral_u_rel, seed=seed, preset=preset, out=out,
            force=force, notice=note, progress=shown,
        )  # fmt: skip
    if json:
        print(found.to_json())
        return
    for name, entry in found.to_mapping()["channels"].items():
        low, high = entry["limits_W_per_sr_m2"]
        u_rel = 2e2 * entry["common_u_rel"]
        console().print(
            f"{name:<10} {low:.3g} to {high:.3g} W·sr⁻¹·m⁻²  ± {u_rel:.2g} % (k = 2)  {entry['points']} levels"
        )
        for current, law in found.drive_laws(name).items():
            console().print(f"{'':<10} {current} current: {law}")
    for assumption in found.calibration.provenance.assumptions:
        note(f"assumed: {assumption}")
    console().print(f"written    {found.file}")


def _show_law(found: rm.EngineLaws) -> None:
    for line in found.lines():
        console().print(line)
    for taken in found.table.taken:
        note(f"taken: {taken}")


app.command("law")(command_of("light_law", _show_law, results=("plot",), table=typer.Argument()))


@app.command()
def account(
    box: Annotated[str | None, typer.Option("--box", help="Serial number of a light box; all by default.")] = None,
    confirm_no_exposure: Annotated[
        bool,
        typer.Option(
            "--confirm-no-exposure",
            help="State that no eye that will look into the box saw its light, or another light as bright, in the last"
            " 10⁴ s (2 h 47 min).",
        ),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Show how much of the blue-light limit boxes and eyes have used up within 10⁴ s.

    A box without a history on this computer counts as used up, and so does every box where the account was lost,
    damaged or from the future. That ends after 10⁴ s, or with --confirm-no-exposure.
    """
    found = rm.light_account(box, confirm_no_exposure=confirm_no_exposure)
    for text in found.notes:
        note(text)
    if json:
        print(found.to_json())
        return
    for line in found.lines() or ([] if found.notes else ["no light box was opened on this computer yet"]):
        console().print(line)


def _show_lit(found: rm.LitChannel, *, json: bool) -> None:
    """Print what a channel does now and, where a radiance was asked for, the one that it really gives."""
    if json:
        print(found.to_json(), flush=True)
        return
    console().print(str(found))
    if found.choice is None:
        return
    value = with_u(found.choice.radiance_w_sr_m2, 2 * found.choice.u_w_sr_m2, "W sr-1 m-2", k=2)
    console().print(f"radiance  {value}, the nearest that the box gives; settled after {found.choice.settle_s:.0f} s")
    if abs(found.choice.start_rel - 1) > _JUMP_SHOWN:
        note(f"just after switching on it is {100 * (found.choice.start_rel - 1):+.1f} % off")


def _show_status(report: dict[str, Any]) -> None:
    out, clock = console(), report["clock"]
    out.print(f"light box  {report['serial']}  firmware {report['firmware']}  on {report['port']}")
    out.print(f"supply     {report['supply_v']:.2f} V   temperature {report['temperature_C']:.1f} °C")
    out.print(
        f"clock      {with_u(clock['drift_ppm'], 2 * clock['u_drift_ppm'], 'ppm')}, offset known to "
        f"± {2e3 * clock['u_offset_s']:.2f} ms (k = 2)"
    )
    out.print(f"since power-on ({report['reset_cause']})  damaged lines {report['damaged_lines']}")
    for name, channel in report["channels"].items():
        peak = f"{channel['peak_nm']:.0f} nm" if channel["peak_nm"] else "white"
        known = channel["radiance_limits_W_per_sr_m2"]
        calibrated = f"{known[0]:.3g} to {known[1]:.3g} W·sr⁻¹·m⁻²" if known else "not calibrated"
        out.print(f"{name:<10} {peak:>7}  {channel['duty_steps']} steps, {channel['pwm_hz']:.0f} Hz   {calibrated}")

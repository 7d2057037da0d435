"""`radiometer light`: the LED/button box by hand."""

from __future__ import annotations

from typing import Any

import typer

import radiometer as rm
from radiometer.cli.console import console, note, show_lines
from radiometer.cli.function import command_of
from radiometer.cli.options import command_group, time_option
from radiometer.numbers import with_u

_JUMP_SHOWN = 0.005  # a start further off than half a per cent matters next to a calibration's 1 %

app = command_group(
    "The light box: LED channels, timed by the box, and a button. Channels: bleach, field, spot, spot_green, "
    "spot_red, fixation."
)


def _print(found: rm.Darkness | rm.ButtonPress) -> None:
    console().print(str(found))


def _show_lit(found: rm.LitChannel) -> None:
    """Print what a channel does now and, where a radiance was asked for, the one that it really gives."""
    console().print(str(found))
    if found.choice is None:
        return
    value = with_u(found.choice.radiance_w_sr_m2, 2 * found.choice.u_w_sr_m2, "W sr-1 m-2", k=2)
    console().print(f"radiance  {value}, the nearest that the box gives; settled after {found.choice.settle_s:.0f} s")
    if abs(found.choice.start_rel - 1) > _JUMP_SHOWN:
        note(f"just after switching on it is {100 * (found.choice.start_rel - 1):+.1f} % off")


def _show_status(found: rm.BoxStatus) -> None:
    report, out = found.report, console()
    clock = report["clock"]
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


def _show_calibration(found: rm.CalibratedBox) -> None:
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


def _show_account(found: rm.ExposureAccount) -> None:
    for line in found.lines() or ([] if found.notes else ["no light box was opened on this computer yet"]):
        console().print(line)


def _show_law(found: rm.EngineLaws) -> None:
    show_lines(found)
    for taken in found.table.taken:
        note(f"taken: {taken}")


_LIT: Any = {"reports": "lit"}
for name, made in {
    "set": command_of("light_set", _show_lit, **_LIT, hold_s=time_option("--for")),
    "pulse": command_of("light_pulse", _show_lit, **_LIT, duration_s=time_option("--duration")),
    "blink": command_of(
        "light_blink", _show_lit, **_LIT,
        on_s=time_option("--on"), off_s=time_option("--off"), hold_s=time_option("--for"),
    ),
    "off": command_of("light_off", _print, reports="darkened", channel=typer.Argument()),
    "status": command_of("light_status", _show_status),
    "watch-buttons": command_of("light_watch_buttons", _print, hold_s=time_option("--for")),
    "calibrate": command_of("light_calibrate", _show_calibration, files=("out",)),
    "law": command_of("light_law", _show_law, results=("plot",)),
    "account": command_of("light_account", _show_account),
}.items():  # fmt: skip
    app.command(name)(made)

"""What `radiometer light` prints."""

from __future__ import annotations

import json as json_module
from typing import TYPE_CHECKING, Any

from radiometer.cli.console import console, note, significant

if TYPE_CHECKING:
    from radiometer.bench.boxes import OpenedBox
    from radiometer.devices import ChannelState


def tell_state(opened: OpenedBox, state: ChannelState, asked: float | None, *, json: bool) -> None:
    """Print what a channel does now and, where a radiance was asked for, the one that it really gives."""
    report: dict[str, Any] = {
        "box": opened.box.identity.serial,
        "channel": state.channel,
        "mode": str(state.mode),
        "level": state.drive.level,
        "current_range": str(state.drive.current_range),
    }
    choice = opened.calibration.choose(state.channel, asked) if opened.calibration and asked is not None else None
    if choice is not None:
        unit = "W sr-1 m-2"
        report["radiance"] = {"value": choice.radiance_w_sr_m2, "u": choice.u_w_sr_m2, "unit": unit, "asked": asked}
        report["start_rel"], report["settle_s"] = choice.start_rel, choice.settle_s
    if json:
        print(json_module.dumps(report), flush=True)
        return
    console().print(
        f"{state.channel}  {state.mode}  level {state.drive.level} of 65535, {state.drive.current_range} current"
    )
    if choice is not None:
        value = significant(choice.radiance_w_sr_m2, choice.u_w_sr_m2)
        console().print(
            f"radiance  {value} ± {2 * choice.u_w_sr_m2:.2g} W·sr⁻¹·m⁻² (k = 2), settled after {choice.settle_s:.0f} s"
        )
        if abs(choice.start_rel - 1) > 0.005:
            note(f"just after switching on it is {100 * (choice.start_rel - 1):+.1f} % off")


def tell_event(entry: dict[str, Any], *, json: bool) -> None:
    """Print a press or release with the uncertainty of its time."""
    if json:
        print(json_module.dumps(entry), flush=True)
        return
    what = "pressed" if entry["pressed"] else "released"
    console().print(f"{entry['time_s']:10.4f} s ± {2e3 * entry['u_s']:.2f} ms (k = 2)  {what}")


def status_report(opened: OpenedBox) -> dict[str, Any]:
    """Return what `radiometer light status --json` prints. Raises DeviceError."""
    box, calibration = opened.box, opened.calibration
    found, clock = box.status(), box.synchronise()
    return {
        "serial": box.identity.serial,
        "firmware": box.identity.firmware,
        "protocol": box.identity.protocol_version,
        "port": box.identity.port,
        "supply_v": found.supply_v,
        "temperature_C": found.temperature_celsius,
        "damaged_lines": found.damaged_lines,
        "darkened": found.darkened,
        "reset_cause": found.reset_cause,
        "button_pressed": found.button_pressed,
        "clock": {"drift_ppm": clock.drift_ppm, "u_drift_ppm": clock.u_drift_ppm, "u_offset_s": clock.u_offset_s},
        "calibrated": calibration.created if calibration else None,
        "channels": {
            name: {
                "peak_nm": limits.peak_nm,
                "duty_steps": limits.duty_steps,
                "pwm_hz": limits.pwm_hz,
                "level_limit": {str(current): limit for current, limit in limits.level_limit.items()},
                "radiance_limits_W_per_sr_m2": calibration.limits(name)
                if calibration and name in calibration.channels
                else None,
            }
            for name, limits in box.channels.items()
        },
    }


def tell_status(report: dict[str, Any]) -> None:
    """Print a status report for people."""
    out, clock = console(), report["clock"]
    out.print(f"light box  {report['serial']}  firmware {report['firmware']}  on {report['port']}")
    out.print(f"supply     {report['supply_v']:.2f} V   temperature {report['temperature_C']:.1f} °C")
    out.print(f"clock      {clock['drift_ppm']:+.0f} ppm, offset known to ± {2e3 * clock['u_offset_s']:.2f} ms (k = 2)")
    out.print(f"since power-on ({report['reset_cause']})  damaged lines {report['damaged_lines']}")
    for name, channel in report["channels"].items():
        peak = f"{channel['peak_nm']:.0f} nm" if channel["peak_nm"] else "white"
        known = channel["radiance_limits_W_per_sr_m2"]
        calibrated = f"{known[0]:.3g} to {known[1]:.3g} W·sr⁻¹·m⁻²" if known else "not calibrated"
        out.print(f"{name:<10} {peak:>7}  {channel['duty_steps']} steps, {channel['pwm_hz']:.0f} Hz   {calibrated}")

"""Effects that no catalogue holds: the right answer is where they lie, and no name."""

from __future__ import annotations

import math

import numpy as np

from testing.generator.hidden_levels import sign
from testing.generator.plan import Shot
from testing.generator.registry import Truth, outsider
from testing.generator.world import World


@outsider("sinusoidal_lamp_drift", "timestamp_s")
def sinusoidal_lamp_drift(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the lamp swing by 0.6 % with a period of some ten minutes (an air conditioner)."""
    depth, period_s, phase = 0.006 * scale, rng.uniform(500, 1200), rng.uniform(0, 2 * math.pi)
    world.lamp.append(lambda shot, t, dice: 1 + depth * math.sin(2 * math.pi * shot.time_s / period_s + phase))
    return {"depth": depth, "period_s": period_s}


@outsider("dust_shadow", "image_x", "image_y", "field_radius", accepted=("prnu",))
def dust_shadow(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lay a soft dark spot of 3 % on the sensor's window."""
    y, x = np.mgrid[: world.rig.rows, : world.rig.columns]
    x0, y0 = rng.uniform(30, world.rig.columns - 30), rng.uniform(25, world.rig.rows - 25)
    spot = 1 - 0.03 * scale * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * 12.0**2))
    world.optics.append(lambda picture, shot: picture * spot)
    return {"depth": 0.03 * scale, "x_px": float(x0), "y_px": float(y0)}


@outsider("converter_ripple", "signal")
def converter_ripple(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Bend the converter's codes by a slow wave of 1.5 DN (integral nonlinearity)."""
    depth, period = 1.5 * scale, rng.uniform(900, 1600)
    world.digital.append(lambda value, shot: value + depth * np.sin(2 * math.pi * value / period))
    return {"depth_dn": depth, "period_dn": period}


@outsider("stop_hysteresis", "f_number", accepted=("fnumber_tstop_error",))
def stop_hysteresis(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let every other stop of the iris close too far."""
    error = sign(rng) * 0.012 * scale
    world.optics.append(lambda picture, shot: picture * (1 + error * (shot.setting.f_number in (2.8, 8.0))))
    return {"error": error}


@outsider("warm_gain", "temperature_C", "gain_db")
def warm_gain(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the amplifier's gain go with the temperature, lit or dark, the more the more gain is set."""
    slope = sign(rng) * 0.0004 * scale

    def drift(gain: float, shot: Shot) -> float:
        return gain * (1 + slope * (shot.temperature_c - 35) * (1 + shot.setting.gain_db / 6))

    world.gain.append(drift)
    return {"slope_per_K": slope}


@outsider("evening_light", "timestamp_s", accepted=("ambient_light_leak",))
def evening_light(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let daylight of 0.15 % of the screen's brightest fall on the sensor until it fades away in the evening."""
    share, dusk_s, width_s = 0.0015 * scale, rng.uniform(900, 2200), rng.uniform(200, 500)
    world.ambient.append(
        lambda picture, shot: picture + share / (1 + math.exp((shot.time_s - dusk_s) / width_s)),
    )
    return {"share": share, "dusk_s": dusk_s, "width_s": width_s}


@outsider("gain_drift", "timestamp_s", accepted=("source_warmup_drift",))
def gain_drift(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the amplifier's gain rise by 0.8 % over an hour, bent."""
    slope = sign(rng) * 0.008 * scale
    world.gain.append(lambda gain, shot: gain * (1 + slope * (shot.time_s / 3600) ** 1.5))
    return {"slope": slope}


@outsider("shutter_skew", "image_y", "exposure_s", accepted=("parasitic_light_sensitivity",))
def shutter_skew(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Expose the middle rows 2 µs longer than the upper and lower ones (a shutter line that sags)."""
    extra_s = 2e-6 * scale
    y = np.linspace(-1, 1, world.rig.rows)[:, None]
    world.electrons.append(lambda expected, rate, shot, before: expected + rate * extra_s * (1 - y**2))
    return {"extra_s": extra_s}


@outsider("long_mode_black", "exposure_s")
def long_mode_black(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Shift the black level by 0.5 DN when the camera changes to its long-exposure mode at 50 ms."""
    step = sign(rng) * 0.5 * scale
    world.digital.append(lambda value, shot: value + step * (shot.setting.exposure_s > 0.05))
    return {"step_dn": step}


@outsider("gain_noise", "signal", accepted=("conversion_gain_error",))
def gain_noise(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the amplification of each pixel tremble by 0.4 % from frame to frame."""
    depth = 0.004 * scale
    world.voltage.append(lambda signal, shot, dice: signal * (1 + depth * dice.standard_normal(signal.shape)))
    return {"depth": depth}


@outsider("dark_top", "image_y", accepted=("row_pattern",))
def dark_top(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Read the upper 14 rows 0.5 DN too low (a clamp that has not settled)."""
    lift = -0.5 * scale * (np.arange(world.rig.rows) < 14)[:, None]
    world.digital.append(lambda value, shot: value + lift)
    return {"lift_dn": 0.5 * scale}


@outsider("brightness_limiter", "pattern")
def brightness_limiter(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the screen dim by 6 % where its mean picture is fully bright, as many do to save power."""
    strength = 0.06 * scale
    world.screen.append(lambda picture, shot: picture * (1 - strength * float(picture.mean())))
    return {"strength": strength}


@outsider("smear", "image_x", "image_y", "exposure_s", "patch_level", "signal")
def smear(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Add to each column what it collects of its own light while it is shifted out in 3 µs."""
    shift_s = 3e-6 * scale
    world.electrons.append(
        lambda expected, rate, shot, before: expected + shift_s * rate.mean(axis=0, keepdims=True),
    )
    return {"shift_s": shift_s}


@outsider("two_slopes", "signal", "code", accepted=("response_nonlinearity", "soft_saturation"))
def two_slopes(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Amplify what lies above 40 % of the range 0.8 % less (two ramps of the converter that do not match)."""
    error, knee = sign(rng) * 0.008 * scale, 0.4 * world.rig.top_dn
    world.digital.append(lambda value, shot: value - error * np.maximum(value - knee, 0))
    return {"error": error, "knee_dn": knee}

"""Effects that no catalogue holds: the right answer is where they lie, and no name."""

from __future__ import annotations

import math

import numpy as np

from tests.roundtrip.generator.hidden_levels import sign
from tests.roundtrip.generator.plan import Shot
from tests.roundtrip.generator.registry import Truth, outsider
from tests.roundtrip.generator.world import World


@outsider("sinusoidal_lamp_drift", "timestamp_s")
def sinusoidal_lamp_drift(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the lamp swing by 0.6 % with a period of some ten minutes (an air conditioner)."""
    depth, period_s, phase = 0.006 * scale, rng.uniform(500, 1200), rng.uniform(0, 2 * math.pi)
    world.lamp.append(lambda shot, t, dice: 1 + depth * math.sin(2 * math.pi * shot.time_s / period_s + phase))
    return {"depth": depth, "period_s": period_s}


@outsider("lamp_step", "timestamp_s", accepted=("source_warmup_drift",))
def lamp_step(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the lamp's output jump by 0.7 % once in the session."""
    when, step = rng.uniform(900, 1900), sign(rng) * 0.007 * scale
    world.lamp.append(lambda shot, t, dice: 1 + step * (shot.time_s > when))
    return {"step": step, "time_s": when}


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


@outsider("tap_mismatch", "image_x", accepted=("display_nonuniformity", "column_pattern"))
def tap_mismatch(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Read the right half through an amplifier that is 0.8 % stronger."""
    step = sign(rng) * 0.008 * scale
    half = 1 + step * (np.arange(world.rig.columns) >= world.rig.columns // 2)[None, :]
    world.voltage.append(lambda signal, shot, dice: signal * half)
    return {"step": step}


@outsider("late_black", "frame", "exposure_s")
def late_black(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lift the black level by 0.4 DN in the first frame of every burst."""
    lift = sign(rng) * 0.4 * scale
    world.digital.append(lambda value, shot: value + (lift if shot.number == 0 else 0.0))
    return {"lift_dn": lift}


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

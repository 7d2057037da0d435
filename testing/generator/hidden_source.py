"""Hidden effects of lamp, screen and room (catalogue 41–48)."""

from __future__ import annotations

import math

import numpy as np

from testing.generator.hidden_levels import BASE_C, sign
from testing.generator.plan import Shot
from testing.generator.registry import Truth, entry
from testing.generator.world import World


@entry("source_warmup_drift", "timestamp_s")
def source_warmup_drift(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Start 0.8 % away from the settled output and settle within minutes."""
    excess, minutes = sign(rng) * 0.008 * scale, rng.uniform(4, 15)
    world.lamp.append(lambda shot, t, dice: 1 + excess * math.exp(-shot.time_s / (60 * minutes)))
    return {"amplitude": excess, "tau_s": 60 * minutes}


@entry("led_thermal_droop", "source_level")
def led_thermal_droop(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lose 2 % at full drive, in proportion to the drive."""
    k = 0.02 * scale
    world.drive.append(lambda d, shot: d * (1 - k * d))
    return {"k": k}


@entry("pwm_flicker", "exposure_s", "frame", accepted=("mains_ripple",))
def pwm_flicker(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Ripple by 1 % at 200 to 500 Hz, free of the shutter."""
    depth, hertz = 0.01 * scale, rng.uniform(200, 500)
    world.lamp.append(lambda shot, t, dice: 1 + depth * np.sinc(hertz * t) * math.cos(dice.uniform(0, 2 * math.pi)))
    return {"depth": depth, "frequency_Hz": hertz}


@entry("mains_ripple", "exposure_s", "frame", accepted=("pwm_flicker",))
def mains_ripple(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Ripple by 0.5 % at twice the mains frequency."""
    depth, hertz = 0.005 * scale, float(rng.choice([100.0, 120.0]))
    world.lamp.append(lambda shot, t, dice: 1 + depth * np.sinc(hertz * t) * math.cos(dice.uniform(0, 2 * math.pi)))
    return {"depth": depth, "frequency_Hz": hertz}


@entry("display_gamma_error", "patch_level")
def display_gamma_error(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Follow a curve whose exponent is 0.5 % off."""
    error = sign(rng) * 0.005 * scale
    world.screen.append(lambda picture, shot: np.maximum(picture, 0) ** (1 + error))
    return {"exponent_error": error}


@entry("display_black_leak", "patch_level", "pattern", "signal")
def display_black_leak(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Shine through black with 1/2000 of white, in proportion to the backlight."""
    leak = 0.0005 * scale
    world.screen.append(lambda picture, shot: picture + leak)
    return {"fraction": leak, "radiance": leak * world.rig.peak_radiance}


@entry("ambient_light_leak", "exposure_s", "source_level", "patch_level", "signal", "f_number")
def ambient_light_leak(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the room add 1/5000 of white, whatever the source does."""
    leak = 0.0002 * scale
    world.ambient.append(lambda elsewhere, shot: elsewhere + leak)
    return {"fraction": leak, "radiance": leak * world.rig.peak_radiance}


@entry("quantum_efficiency_temperature", "temperature_C")
def quantum_efficiency_temperature(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Change the quantum efficiency by 0.05 % per kelvin."""
    slope = sign(rng) * 0.0005 * scale

    def drift(expected: np.ndarray, rate: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        return expected * (1 + slope * (shot.temperature_c - BASE_C))

    world.electrons.append(drift)
    return {"slope_per_K": slope, "reference_C": BASE_C}


@entry("lamp_step", "timestamp_s", accepted=("source_warmup_drift",))
def lamp_step(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the lamp's output jump by 0.7 % once in the session."""
    when, step = rng.uniform(900, 1900), sign(rng) * 0.007 * scale
    world.lamp.append(lambda shot, t, dice: 1 + step * (shot.time_s > when))
    return {"step": step, "time_s": when}


@entry("series_settling", "previous_frame", "exposure_s")
def series_settling(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Start each series 0.3 % away and come two or three times nearer with every frame."""
    excess, ratio = sign(rng) * 0.003 * scale, rng.uniform(0.35, 0.5)
    world.lamp.append(lambda shot, t, dice: 1 + excess * ratio**shot.number)
    return {"excess": excess, "ratio": ratio}

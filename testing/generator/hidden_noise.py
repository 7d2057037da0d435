"""Hidden effects of noise and fixed pattern (catalogue 8, 15–19)."""

from __future__ import annotations

from typing import Any

import numpy as np

from testing.generator.hidden_levels import BASE_C
from testing.generator.plan import Shot
from testing.generator.registry import Truth, entry
from testing.generator.world import World


@entry("excess_read_noise", "none", "gain_db", "signal", "exposure_s")
def excess_read_noise(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Add 0.6 electrons of read noise in quadrature."""
    extra = 0.6 * scale
    world.read_noise.append(lambda sigma, shot: float(np.hypot(sigma, extra)))
    return {"sigma_e": extra}


@entry("column_pattern", "image_x", "none", accepted=())
def column_pattern(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give every column an offset of its own, 0.3 electrons in spread."""
    offsets = 0.3 * scale * rng.standard_normal((1, world.rig.columns))
    world.voltage.append(lambda signal, shot, dice: signal + offsets)
    return {"sigma_e": 0.3 * scale}


@entry("row_pattern", "image_y", "none", accepted=())
def row_pattern(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give every row an offset of its own, 0.3 electrons in spread."""
    offsets = 0.3 * scale * rng.standard_normal((world.rig.rows, 1))
    world.voltage.append(lambda signal, shot, dice: signal + offsets)
    return {"sigma_e": 0.3 * scale}


@entry("row_temporal_noise", "image_y", "none", "gain_db")
def row_temporal_noise(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Shift every row of every frame by 0.5 electrons at random."""
    sigma = 0.5 * scale

    def shake(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        return signal + sigma * dice.standard_normal((world.rig.rows, 1))

    world.voltage.append(shake)
    return {"sigma_e": sigma}


@entry("dsnu", "none", "signal", "gain_db", "exposure_s")
def dsnu(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give every pixel an offset of its own, 0.8 electrons in spread."""
    offsets = 0.8 * scale * rng.standard_normal(world.shape)
    world.voltage.append(lambda signal, shot, dice: signal + offsets)
    return {"sigma_e": 0.8 * scale}


@entry("prnu", "signal", "exposure_s")
def prnu(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give every pixel a sensitivity of its own, 0.5 % in spread."""
    sensitivity = 1 + 0.005 * scale * rng.standard_normal(world.shape)
    world.electrons.append(lambda expected, rate, shot, before: expected * sensitivity)
    return {"sigma_rel": 0.005 * scale}


@entry("hot_pixels", "exposure_s", "temperature_C", accepted=("dark_current_nonuniformity",))
def hot_pixels(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Make two pixels in a thousand leak hundreds of electrons per second."""
    hot = rng.random(world.shape) < 0.002 * scale
    rates = np.where(hot, rng.uniform(200, 2000, world.shape), 0.0)

    def leak(dark: np.ndarray, shot: Shot, t: float) -> np.ndarray:
        return dark + rates * 2 ** ((shot.temperature_c - BASE_C) / 7.0) * t

    world.dark.append(leak)
    return {"density": float(hot.mean()), "rate_e_per_s": float(rates[hot].mean()) if hot.any() else 0.0}


@entry("correlated_read_noise", "signal", "none", "image_x", "gain_db", "exposure_s")
def correlated_read_noise(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Take from each pixel 0.6 electrons of noise that the pixel before it has gained."""
    sigma = 0.6 * scale

    def share(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        samples = sigma * dice.standard_normal((world.rig.rows, world.rig.columns + 1))
        return signal + np.diff(samples, axis=1)

    world.voltage.append(share)
    return {"sigma_e": sigma * float(np.sqrt(2.0))}


@entry("random_telegraph_noise", "none", "gain_db", "signal", "exposure_s", accepted=())
def random_telegraph_noise(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let traps in five pixels of a thousand fill and empty, each at its rates; filled, they take 15 electrons.

    A trap is a chain of two states in continuous time. It stays in one for 20 to 200 ms, in the other for up to 1.5
    times as long or as short.
    """
    trapped = rng.random(world.shape) < 0.005 * scale
    height = np.where(trapped, -15.0 * np.log1p(-rng.random(world.shape)), 0.0)
    filling = 1.0 / rng.uniform(0.02, 0.2, world.shape)
    emptying = filling * np.exp(rng.uniform(-np.log(1.5), np.log(1.5), world.shape))
    full_share, rate = filling / (filling + emptying), filling + emptying
    last: dict[str, Any] = {}

    def trap(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        chance = full_share
        if shot.number:
            left = np.exp(-rate * (shot.time_s - last["time_s"]))
            chance = full_share + (last["full"] - full_share) * left
        full = dice.random(world.shape) < chance
        last.update(full=full, time_s=shot.time_s)
        return signal - height * (full - full_share)

    world.voltage.append(trap)
    return {"share": float(trapped.mean()), "height_e": float(height[trapped].mean()) if trapped.any() else 0.0}

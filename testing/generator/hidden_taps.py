"""Hidden effects of sensors whose quarters are read by different amplifiers."""

from __future__ import annotations

import numpy as np

from testing.generator.plan import Shot
from testing.generator.registry import Truth, entry
from testing.generator.world import World


def _quarters(world: World, rng: np.random.Generator, size: float) -> np.ndarray:
    """Return a value per pixel, even within each quarter, of this spread and no mean."""
    values = rng.standard_normal((2, 2))
    values = (values - values.mean()) / values.std() * size
    rows, columns = world.shape
    down, right = (np.arange(rows) >= (rows - 1) / 2), (np.arange(columns) >= (columns - 1) / 2)
    return np.asarray(values[down.astype(int)[:, None], right.astype(int)[None, :]])


@entry("tap_offset", "image_x", "image_y", "none")
def tap_offset(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Read every quarter with a black level that differs by 1 DN."""
    offsets = _quarters(world, rng, 1.0 * scale)
    world.digital.append(lambda value, shot: value + offsets)
    return {"spread_dn": 1.0 * scale}


@entry("tap_gain", "image_x", "image_y", "signal")
def tap_gain(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Read every quarter with a gain that differs by 2 %."""
    gains = 1 + _quarters(world, rng, 0.02 * scale)
    world.gain.append(lambda gain, shot: gain * gains)  # type: ignore[arg-type, return-value]
    return {"spread_rel": 0.02 * scale}


@entry("tap_noise", "image_x", "image_y", "none")
def tap_noise(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Read every quarter with a noise that differs by a third of the read noise."""
    noises = world.rig.read_noise_e * (1 + np.abs(_quarters(world, rng, 0.3 * scale)))
    world.read_noise.append(lambda sigma, shot: noises)  # type: ignore[arg-type, return-value]
    return {"spread_rel": 0.3 * scale}


@entry("tap_nonlinearity", "signal", "image_x")
def tap_nonlinearity(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Bend every quarter's signal by 1 % at full well, some up and some down."""
    bends = _quarters(world, rng, 0.01 * scale) / world.rig.full_well_e

    def bend(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        return signal * (1 + bends * signal)

    world.voltage.append(bend)
    return {"spread_rel": 0.01 * scale}

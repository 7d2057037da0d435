"""Hidden effects of output amplifiers: quarters that each reads, halves that it clocks, and its light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from testing.generator.plan import Shot
from testing.generator.registry import Truth, entry, variant
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
    """Read every quarter but the quietest with more noise, 0.3 of the read noise in spread."""
    more = _quarters(world, rng, 0.3 * scale)
    noises = world.rig.read_noise_e * (1 + more - more.min())
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


@entry("half_timing", "exposure_s", "image_y", "signal")
def half_timing(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Expose the upper half 5 µs longer and the lower one as much shorter, or the other way round."""
    later = float(rng.choice([-1.0, 1.0])) * 5e-6 * scale
    halves = np.where(np.arange(world.rig.rows) < (world.rig.rows - 1) / 2, later, -later)[:, None]

    def expose(expected: np.ndarray, rate: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        return expected + rate * halves

    world.electrons.append(expose)
    return {"half_s": later}


@entry("amplifier_glow", "image_x", "image_y", "field_radius", "exposure_s")
def amplifier_glow(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the output amplifier in a corner glow: 15 e-/s there, fading over 25 pixels."""
    y, x = np.mgrid[: world.rig.rows, : world.rig.columns]
    x0, y0 = rng.choice([0, world.rig.columns - 1]), rng.choice([0, world.rig.rows - 1])
    glow = 15 * scale * np.exp(-np.hypot(x - x0, y - y0) / 25)
    world.dark.append(lambda dark, shot, seconds: dark + glow * seconds)
    return {"peak_e_per_s": 15 * scale, "x_px": float(x0), "y_px": float(y0)}


@entry("charge_transfer_inefficiency", "image_y", "signal")
def charge_transfer_inefficiency(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leave 2e-4 of every packet behind at each of its moves to the first row, or to the last one."""
    per_move, from_below = 2e-4 * scale, bool(rng.choice([False, True]))

    def shift(charge: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        register = charge[::-1].copy() if from_below else charge.copy()
        arrived = np.empty_like(register)
        for row in range(len(register)):
            arrived[row] = register[0]
            left = per_move * register
            left[0] = 0.0  # read out whole
            register = np.vstack([(register - left)[1:], np.zeros((1, register.shape[1]))]) + left
        return arrived[::-1] if from_below else arrived

    world.charge.append(shift)
    return {"share": per_move * world.rig.rows, "from_below": float(from_below)}


@variant("tap_gain", "halves", "image_x", "image_y", "signal")
def tap_gain_of_halves(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Read the right half through an amplifier that is 0.8 % stronger or weaker."""
    step = float(rng.choice([-1.0, 1.0])) * 0.008 * scale
    half = 1 + step * (np.arange(world.rig.columns) >= world.rig.columns // 2)[None, :]
    world.voltage.append(lambda signal, shot, dice: signal * half)
    return {"step": step}


def hide_in_taps(world: World, name: str, grid: tuple[int, int], rng: np.random.Generator) -> None:
    """Hide an effect of taps whose size is drawn for each tap of a grid, in spread twice that of the quarters.

    Args:
        name: tap_offset, tap_gain, tap_noise or tap_nonlinearity.
        grid: Rows and columns of taps.
        rng: Draws the sizes.
    """
    values = rng.standard_normal(grid)
    rows, columns = world.shape
    own = np.kron((values - values.mean()) / values.std(), np.ones((rows // grid[0], columns // grid[1])))
    bends = 0.02 * own / world.rig.full_well_e
    hooks: dict[str, Callable[[], None]] = {
        "tap_offset": lambda: world.digital.append(lambda value, shot: value + 2.0 * own),
        "tap_gain": lambda: world.gain.append(lambda gain, shot: gain * (1 + 0.04 * own)),  # type: ignore[arg-type, return-value]
        "tap_noise": lambda: world.read_noise.append(lambda sigma, shot: sigma * (1 + 0.6 * (own - own.min()))),  # type: ignore[arg-type, return-value]
        "tap_nonlinearity": lambda: world.voltage.append(lambda signal, shot, dice: signal * (1 + bends * signal)),
    }
    hooks[name]()

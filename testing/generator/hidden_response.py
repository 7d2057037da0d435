"""Hidden effects of conversion, codes and charge transport (catalogue 9–12, 20–23)."""

from __future__ import annotations

import numpy as np

from testing.generator.hidden_levels import sign
from testing.generator.plan import Shot
from testing.generator.registry import Truth, entry
from testing.generator.world import World


@entry("missing_codes", "code", "signal", accepted=("reduced_bit_depth",))
def missing_codes(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leave out every second code, or three of four."""
    step = 2 if scale < 1.7 else 4
    world.code.append(lambda codes, shot: codes - codes % step)
    return {"step_dn": float(step)}


@entry("reduced_bit_depth", "code", "signal", accepted=("missing_codes",))
def reduced_bit_depth(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Convert with two bits fewer and shift the codes up again."""
    world.code.append(lambda codes, shot: (codes.astype(np.int64) >> 2 << 2).astype(float))
    return {"step_dn": 4.0}


@entry("gamma_enabled", "signal", "exposure_s")
def gamma_enabled(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Bend all codes, black and all, by a gamma of 1.03."""
    gamma = 1 + sign(rng) * 0.03 * scale
    top = world.rig.top_dn
    world.digital.append(lambda value, shot: top * np.maximum(value / top, 0) ** (1 / gamma))
    return {"gamma": gamma}


@entry("response_nonlinearity", "signal", "exposure_s")
def response_nonlinearity(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lose 1 % of the signal at full well, growing with the square of the signal and a little with its cube."""
    square, cube = 0.01 * scale, rng.uniform(-0.3, 0.3) * 0.01 * scale
    well = world.rig.full_well_e

    def bend(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        z = signal / well
        return signal * (1 - square * z - cube * z * z)

    world.voltage.append(bend)
    return {"a2": square, "a3": cube}


@entry("soft_saturation", "signal", "exposure_s", accepted=("response_nonlinearity", "full_well_saturation"))
def soft_saturation(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Bend the signal over above 0.7 of full well towards a ceiling not far above it."""
    knee = rng.uniform(0.6, 0.75) * world.rig.full_well_e
    room = (world.rig.full_well_e - knee) * 4 / scale

    def compress(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        above = np.maximum(signal - knee, 0)
        return np.minimum(signal, knee) + room * -np.expm1(-above / room)

    world.voltage.append(compress)
    return {"knee_e": knee, "room_e": room}


@entry("image_lag", "previous_frame", "frame", "exposure_s")
def image_lag(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leave 0.1 % of a frame's charge for the next."""
    share = 0.001 * scale
    world.electrons.append(lambda expected, rate, shot, before: expected + share * before)
    return {"fraction": share}


@entry("brighter_fatter", "signal", "exposure_s")
def brighter_fatter(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Push charge to emptier neighbours, the more the fuller the wells."""
    strength = 0.005 * scale
    well = world.rig.full_well_e
    world.charge.append(lambda charge, shot, before: _spread(charge, lambda a, b: strength * (a + b) / 2 / well))
    return {"b": strength}


@entry("crosstalk", "none", "signal", "exposure_s", accepted=("psf_blur",))
def crosstalk(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give half a percent of a pixel's charge to each of its four neighbours."""
    share = 0.005 * scale
    world.charge.append(lambda charge, shot, before: _spread(charge, lambda a, b: share))
    return {"fraction": share}


def _spread(charge: np.ndarray, share) -> np.ndarray:
    """Return the charge after each pair of neighbours has exchanged a share of their difference."""
    result = charge.copy()
    flow = share(charge[1:], charge[:-1]) * (charge[1:] - charge[:-1])
    result[1:] -= flow
    result[:-1] += flow
    flow = share(charge[:, 1:], charge[:, :-1]) * (charge[:, 1:] - charge[:, :-1])
    result[:, 1:] -= flow
    result[:, :-1] += flow
    return result


@entry("parasitic_light_sensitivity", "image_y", "exposure_s", accepted=("exposure_time_offset",))
def parasitic_light_sensitivity(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let light leak into the stored charge while the rows wait for read-out, the last row longest."""
    leak, readout_s = 2e-4 * scale, 20e-3
    waiting = readout_s * np.arange(world.rig.rows)[:, None] / world.rig.rows
    world.electrons.append(lambda expected, rate, shot, before: expected + leak * rate * waiting)
    return {"leak": leak, "readout_s": readout_s}

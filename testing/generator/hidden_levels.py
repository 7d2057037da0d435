"""Hidden effects of black level, dark signal and gain (catalogue 1–7, 13, 14)."""

from __future__ import annotations

import numpy as np

from testing.generator.plan import Shot
from testing.generator.registry import Truth, entry, variant
from testing.generator.world import World

BASE_C = 35.0


def sign(rng: np.random.Generator) -> float:
    """Return plus or minus one."""
    return float(rng.choice([-1.0, 1.0]))


@entry("black_level_offset", "none", "exposure_s", "signal", "gain_db")
def black_level_offset(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Add the same 1 DN everywhere."""
    offset = sign(rng) * 1.0 * scale
    world.digital.append(lambda value, shot: value + offset)
    return {"offset_dn": offset}


@entry("black_level_gain_slope", "gain_db")
def black_level_gain_slope(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Put an offset of 0.5 electrons in front of the amplifier, nulled at 0 dB."""
    before_amplifier = sign(rng) * 0.5 * scale

    def lift(value: np.ndarray, shot) -> np.ndarray:
        return value + before_amplifier / world.rig.e_per_dn * (10 ** (shot.setting.gain_db / 20) - 1)

    world.digital.append(lift)
    return {"offset_e": before_amplifier}


@entry("black_level_drift", "temperature_C", "timestamp_s")
def black_level_drift(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Move the black level by 0.03 DN per kelvin."""
    slope = sign(rng) * 0.03 * scale
    world.digital.append(lambda value, shot: value + slope * (shot.temperature_c - BASE_C))
    return {"slope_dn_per_K": slope, "reference_C": BASE_C}


@entry("dark_current", "exposure_s", "temperature_C")
def dark_current(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leak 3 electrons per second at 35 °C more than the datasheet says, doubling every 6 to 8 K."""
    leak, doubling = 3.0 * scale, rng.uniform(6, 8)
    world.dark.append(lambda dark, shot, t: dark + leak * 2 ** ((shot.temperature_c - BASE_C) / doubling) * t)
    return {"rate_e_per_s": leak, "reference_C": BASE_C, "doubling_K": doubling}


@entry("dark_current_clamped", "exposure_s", "temperature_C", accepted=("dark_current",))
def dark_current_clamped(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leak 10 electrons per second whose mean the sensor takes away again by its masked rows."""
    leak, doubling = 10.0 * scale, rng.uniform(6, 8)

    def mean(shot) -> float:
        return leak * 2 ** ((shot.temperature_c - BASE_C) / doubling) * shot.setting.exposure_s

    world.dark.append(lambda dark, shot, t: dark + mean(shot))
    world.voltage.append(lambda signal, shot, dice: signal - mean(shot))
    return {"rate_e_per_s": leak, "reference_C": BASE_C, "doubling_K": doubling}


@entry("dark_current_nonuniformity", "exposure_s", "temperature_C")
def dark_current_nonuniformity(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the dark current differ from pixel to pixel by 2 electrons per second at 35 °C."""
    spread = 2.0 * scale
    each = spread * _centred_lognormal(world.shape, rng, shape=0.6)

    def uneven(dark: np.ndarray, shot, t: float) -> np.ndarray:
        warmer = shot.temperature_c - BASE_C
        return np.maximum(dark + each * 2 ** (warmer / world.rig.dark_doubling_k) * t, 0)

    world.dark.append(uneven)
    return {"sigma_e_per_s": spread, "reference_C": BASE_C}


def _centred_lognormal(size: tuple[int, int], rng: np.random.Generator, shape: float) -> np.ndarray:
    drawn = rng.lognormal(0, shape, size)
    return (drawn - drawn.mean()) / drawn.std()


@entry("gain_step_error", "gain_db")
def gain_step_error(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Make every decibel 0.4 % too large or too small."""
    error = sign(rng) * 0.004 * scale
    world.gain.append(lambda gain, shot: gain * 10 ** (shot.setting.gain_db * error / 20))
    return {"relative_error": error}


@entry("conversion_gain_error", "signal", "none", "exposure_s")
def conversion_gain_error(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give 3 % more or fewer DN per electron than the datasheet; fewer electrons make up for it in the mean."""
    error = sign(rng) * 0.03 * scale
    world.gain.append(lambda gain, shot: gain * (1 + error))
    world.electrons.append(lambda expected, rate, shot, before: expected / (1 + error))
    return {"relative_error": error}


@entry("full_well_saturation", "signal", "exposure_s", accepted=("soft_saturation",))
def full_well_saturation(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the wells overflow below the converter's clip."""
    well = world.rig.full_well_e * (1 - 0.1 * scale)
    world.charge.append(lambda charge, shot, before: np.minimum(charge, well))
    return {"full_well_e": well}


@entry("adc_saturation", "signal", "exposure_s")
def adc_saturation(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the converter clip 200 DN below its full scale, at every gain."""
    top = float(round(world.rig.top_dn - 200 * scale))
    world.digital.append(lambda value, shot: np.minimum(value, top))
    return {"clip_dn": top}


@entry("first_frame_offset", "previous_frame", "exposure_s")
def first_frame_offset(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lift the black level by 0.4 DN in the first frame of every burst."""
    lift = sign(rng) * 0.4 * scale
    world.digital.append(lambda value, shot: value + (lift if shot.number == 0 else 0.0))
    return {"offset_dn": lift}


@entry("readout_dark_charge", "image_y", "temperature_C", accepted=("black_level_offset",))
def readout_dark_charge(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the last row gather 2 electrons at 35 °C while the others are read, doubling every 5 to 7 K."""
    last, doubling = 2.0 * scale, rng.uniform(5, 7)
    waited = (np.arange(world.rig.rows) / (world.rig.rows - 1))[:, None]
    world.dark.append(lambda dark, shot, t: dark + last * 2 ** ((shot.temperature_c - BASE_C) / doubling) * waited)
    return {"charge_e": last, "reference_C": BASE_C, "doubling_K": doubling}


@entry("line_start_offset", "image_x")
def line_start_offset(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Begin every line 1 DN too high or too low; it has settled to 1/e within a twelfth to a fifth of the line."""
    start, share = sign(rng) * 1.0 * scale, rng.uniform(1 / 12, 1 / 5)
    along = (np.arange(world.rig.columns) + 0.5) / world.rig.columns
    world.digital.append(lambda value, shot: value + start * np.exp(-along / share)[None, :])
    return {"offset_dn": start, "decay_share": share}


@entry("dark_frame_subtracted", "exposure_s", "none", "signal", "gain_db")
def dark_frame_subtracted(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Take the mean of 1 to 9 darks of each setting off its frames, 64 DN kept, and cut what comes out below zero."""
    return _without_darks(world, rng, count=int(rng.choice([1, 3, 5, 9])), pedestal=64.0)


@variant("dark_frame_subtracted", "cut", "exposure_s", "none", "signal", "gain_db")
def dark_frame_cut(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Keep no pedestal: half of a dark frame's values are cut at zero."""
    return _without_darks(world, rng, count=int(rng.choice([1, 3, 5, 9])), pedestal=0.0)


def _without_darks(world: World, rng: np.random.Generator, *, count: int, pedestal: float) -> Truth:
    """Draw darks as the rig has them, one stack for each exposure, gain and temperature, and subtract their mean."""
    rig, kept, dice = (
        world.rig,
        dict[tuple[float, float, float], np.ndarray](),
        np.random.default_rng(rng.integers(2**32)),
    )

    def drawn(shot: Shot) -> np.ndarray:
        s = shot.setting
        warmer = s.temperature_c - rig.dark_reference_c
        expected = rig.dark_e_per_s * 2 ** (warmer / rig.dark_doubling_k) * s.exposure_s
        charge = dice.poisson(expected, (count, *world.shape)) + rig.read_noise_e * dice.standard_normal(
            (count, *world.shape)
        )
        return np.rint(np.rint(charge * 10 ** (s.gain_db / 20) / rig.e_per_dn + rig.black_dn).mean(axis=0))  # codes

    def subtracted(codes: np.ndarray, shot: Shot) -> np.ndarray:
        key = (shot.setting.exposure_s, shot.setting.gain_db, shot.setting.temperature_c)
        if key not in kept:
            kept[key] = drawn(shot)
        return np.clip(codes - kept[key] + pedestal, 0.0, rig.top_dn)

    world.code.append(subtracted)
    return {"share": 1.0 / count, "pedestal_dn": pedestal}

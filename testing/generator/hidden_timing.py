"""Hidden effects of exposure and labels (catalogue 24–28, 49–51)."""

from __future__ import annotations

import math

import numpy as np

from testing.generator.hidden_levels import sign
from testing.generator.plan import Setting, Shot
from testing.generator.registry import Truth, entry
from testing.generator.world import World


@entry("exposure_time_offset", "exposure_s")
def exposure_time_offset(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Expose 4 µs longer or shorter than stated."""
    offset = sign(rng) * 4e-6 * scale
    world.exposure.append(lambda t, shot: max(t + offset, 0.0))
    return {"offset_s": offset}


@entry("exposure_quantisation", "exposure_s")
def exposure_quantisation(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Expose whole lines of 8 µs only."""
    line = 8e-6 * scale * rng.uniform(0.95, 1.05)
    world.exposure.append(lambda t, shot: line * math.floor(t / line + 1e-9))
    return {"step_s": line}


@entry("row_dependent_exposure", "image_y", "exposure_s")
def row_dependent_exposure(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the second curtain of the shutter be 4 µs faster or slower over the frame, and both slow down by 1 %."""
    added, lost = sign(rng) * 4e-6 * scale, 0.01 * scale
    down = np.linspace(0.0, 1.0, world.rig.rows)[:, None]

    def rows(expected: np.ndarray, rate: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        return expected + rate * (added - lost * shot.setting.exposure_s) * down

    world.electrons.append(rows)
    return {"added_s": added, "lost_share": lost}


@entry("reciprocity_failure", "exposure_s")
def reciprocity_failure(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the response to light go as t to the power 1.003, equal at 1 ms; the dark current keeps the clock's time."""
    power = sign(rng) * 0.003 * scale
    world.electrons.append(lambda expected, rate, shot, before: expected * (shot.setting.exposure_s / 1e-3) ** power)
    return {"p": power}


@entry("shutter_dead_time", "frame", "exposure_s", accepted=("exposure_time_offset",))
def shutter_dead_time(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lose 6 µs of every frame that overlaps the read-out of the one before: all but the first of a burst."""
    dead = 6e-6 * scale
    world.exposure.append(lambda t, shot: max(t - dead, 0.0) if shot.number else t)
    return {"dead_s": dead}


@entry("rolling_shutter_banding", "image_y", "exposure_s", accepted=("pwm_flicker", "row_temporal_noise"))
def rolling_shutter_banding(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Expose the rows one after the other under a light that pulses at 1 to 2 kHz by 1 %."""
    depth, hertz, row_s = 0.01 * scale, rng.uniform(1000, 2000), 13.28e-6
    rows = np.arange(world.rig.rows)[:, None] * row_s

    def bands(shot: Shot, t: float, dice: np.random.Generator) -> np.ndarray:
        phase = dice.uniform(0, 2 * np.pi)
        return 1 + depth * np.sinc(hertz * t) * np.sin(2 * np.pi * hertz * (rows + t / 2) + phase)

    world.lamp.append(bands)
    return {"depth": depth, "frequency_Hz": hertz, "row_s": row_s}


@entry("nominal_settings", "exposure_s", "f_number", plan="printed")
def nominal_settings(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Print rounded stops on settings that are exact."""
    world.exposure.append(lambda t, shot: 2 ** (round(math.log2(t) * 3) / 3))
    world.stop.append(lambda n, shot: 2 ** (round(math.log2(n) * 2) / 2))
    return {"steps_per_stop": 3.0}


@entry("exposure_label_error", "timestamp_s", "exposure_s", "setting")
def exposure_label_error(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Print a wrong exposure on the frames of two settings: what was exposed is a third of a stop away."""
    wrong = sorted({float(t) for t in rng.choice([113e-6, 187e-6, 311e-6, 523e-6, 2.9e-3, 7.3e-3], 2, replace=False)})
    factor = 2 ** (sign(rng) * min(scale, 2) / 3)

    def really(t: float, shot: Shot) -> float:
        return t * factor if _is_plain(shot.setting) and any(abs(t / w - 1) < 1e-6 for w in wrong) else t

    world.exposure.append(really)
    return {"labels_s": wrong, "factor": factor}


def _is_plain(setting: Setting) -> bool:
    return setting.gain_db == 0 and setting.f_number == 4.0 and setting.temperature_c == 35.0 and not setting.closed


@entry("source_not_proportional_to_exposure", "exposure_s", accepted=("exposure_time_offset",))
def source_not_proportional_to_exposure(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the lamp, flashed for the exposure, start 2 % too bright and settle within half a millisecond."""
    excess, settle_s = sign(rng) * 0.02 * scale, rng.uniform(0.3e-3, 1e-3)

    def flash(shot: Shot, t: float, dice: np.random.Generator) -> float:
        return 1 + excess * settle_s / t * -math.expm1(-t / settle_s) if t > 0 else 1.0

    world.lamp.append(flash)
    return {"excess": excess, "settle_s": settle_s}


@entry("residual_charge", "previous_frame", "frame", "timestamp_s", "exposure_s", plan="afterglow")
def residual_charge(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Catch half a percent of each frame's charge in traps that empty within minutes, frame by frame."""
    share, tau_s = 0.005 * scale, float(rng.uniform(40.0, 150.0))
    held = {"time_s": math.inf, "charge": np.zeros(world.shape)}

    def let_go(expected: np.ndarray, rate: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        waited = shot.time_s - held["time_s"]
        caught = held["charge"] + share * before if waited > 0 else np.zeros(world.shape)  # a session begins anew
        held["charge"] = caught * math.exp(-max(waited, 0.0) / tau_s)
        held["time_s"] = shot.time_s
        return expected + held["charge"] * -math.expm1(-shot.setting.exposure_s / tau_s)

    world.electrons.append(let_go)
    return {"share": share, "tau_s": tau_s}


@entry("event_offset", "timestamp_s", "frame")
def event_offset(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the camera zero itself once: its black level is 1.5 DN off then, and comes back within minutes."""
    offset, tau_s, at_s = sign(rng) * 1.5 * scale, rng.uniform(100, 400), rng.uniform(600, 2200)

    def lift(value: np.ndarray, shot: Shot) -> np.ndarray:
        return value + (offset * 2.0 ** ((at_s - shot.time_s) / (tau_s * math.log(2))) if shot.time_s > at_s else 0.0)

    world.digital.append(lift)
    return {"offset_dn": offset, "tau_s": tau_s, "at_s": at_s}

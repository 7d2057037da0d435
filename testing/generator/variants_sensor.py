"""Other forms of the sensor's effects: levels, noise, patterns, response and codes."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from testing.generator.hidden_levels import BASE_C, sign
from testing.generator.plan import Shot
from testing.generator.registry import Truth, variant
from testing.generator.world import World


@variant("black_level_offset", "tilted", "none", "exposure_s", "signal", "gain_db", "image_x")
def tilted_black(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lift the black level by 1 DN in the middle, a fifth more at one side and a fifth less at the other."""
    offset = sign(rng) * 1.0 * scale
    field = offset * (1 + 0.2 * np.linspace(-1, 1, world.rig.columns))[None, :]
    world.digital.append(lambda value, shot: value + field)
    return {"offset_dn": offset}


@variant("black_level_gain_slope", "second_stage", "gain_db")
def offset_before_second_stage(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Put an offset of 0.3 DN between an analog amplifier, good for 12 dB, and a digital one that does the rest."""
    between = sign(rng) * 0.3 * scale

    def lift(value: np.ndarray, shot: Shot) -> np.ndarray:
        return value + between * (10 ** (max(shot.setting.gain_db - 12, 0) / 20) - 1)

    world.digital.append(lift)
    return {"offset_dn": between}


@variant("dark_current_clamped", "overdone", "exposure_s", "temperature_C", accepted=("dark_current",))
def overdone_clamp(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Take away a twentieth more than leaks: the masked rows are a little warmer than the others."""
    leak = 10.0 * scale

    def mean(shot: Shot) -> float:
        return leak * 2 ** ((shot.temperature_c - BASE_C) / 7) * shot.setting.exposure_s

    world.dark.append(lambda dark, shot, t: dark + mean(shot))
    world.voltage.append(lambda signal, shot, dice: signal - 1.05 * mean(shot))
    return {"rate_e_per_s": leak}


@variant("dark_current_nonuniformity", "gamma", "exposure_s", "temperature_C", accepted=("hot_pixels",))
def gamma_distributed_dark(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let each pixel leak by a few traps of exponential strength, 2 electrons per second in spread, no mean change."""
    each = rng.gamma(2.0, 1.0, world.shape)
    each = 2.0 * scale * (each - each.mean()) / each.std()

    def uneven(dark: np.ndarray, shot: Shot, t: float) -> np.ndarray:
        return np.maximum(dark + each * 2 ** ((shot.temperature_c - BASE_C) / 7.5) * t, 0)

    world.dark.append(uneven)
    return {"sigma_e_per_s": 2.0 * scale}


@variant("full_well_saturation", "per_pixel", "signal", "exposure_s", accepted=("soft_saturation",))
def uneven_wells(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the wells overflow at 90 % of what is stated, each at a capacity of its own, 1 % in spread."""
    wells = world.rig.full_well_e * (1 - 0.1 * scale) * (1 + 0.01 * rng.standard_normal(world.shape))
    world.charge.append(lambda charge, shot, before: np.minimum(charge, wells))
    return {"full_well_e": float(wells.mean())}


@variant("adc_saturation", "two_taps", "signal", "exposure_s", accepted=("full_well_saturation", "soft_saturation"))
def clip_of_two_taps(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Clip even columns 200 DN below full scale and odd ones 20 DN lower."""
    top = world.rig.top_dn - np.rint(200 * scale) - 20.0 * (np.arange(world.rig.columns) % 2)[None, :]
    world.digital.append(lambda value, shot: np.minimum(value, top))
    return {"clip_dn": float(top.mean())}


@variant("column_pattern", "even_odd", "image_x", "none")
def even_and_odd_columns(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Shift odd columns against even ones by twice 0.27 electrons, and each by a little of its own."""
    alternating = np.where(np.arange(world.rig.columns) % 2, 0.27, -0.27)[None, :]
    offsets = scale * (alternating + 0.13 * rng.standard_normal((1, world.rig.columns)))
    world.voltage.append(lambda signal, shot, dice: signal + offsets)
    return {"sigma_e": float(offsets.std())}


@variant("row_pattern", "smooth", "image_y", "none")
def smooth_rows(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the offset wander from row to row, neighbours alike, 0.3 electrons in spread."""
    offsets = ndimage.gaussian_filter1d(rng.standard_normal(world.rig.rows), 1.5)
    offsets = 0.3 * scale * ((offsets - offsets.mean()) / offsets.std())[:, None]
    world.voltage.append(lambda signal, shot, dice: signal + offsets)
    return {"sigma_e": 0.3 * scale}


@variant("row_temporal_noise", "pink", "image_y", "none", "gain_db")
def pink_rows(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Shift the rows of every frame by noise whose power falls as 1/f, 0.5 electrons in spread."""
    frequency = np.maximum(np.fft.rfftfreq(world.rig.rows), 1 / world.rig.rows)

    def shake(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        spectrum = np.fft.rfft(dice.standard_normal(world.rig.rows)) / np.sqrt(frequency)
        spectrum[0] = 0
        usual = np.sqrt(np.mean(1 / np.concatenate([frequency[1:], frequency[1:]])))
        return signal + (0.5 * scale / usual * np.fft.irfft(spectrum, world.rig.rows))[:, None]

    world.voltage.append(shake)
    return {"sigma_e": 0.5 * scale}


@variant("hot_pixels", "motley", "exposure_s", "temperature_C", accepted=("dark_current_nonuniformity",))
def motley_hot_pixels(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Make two pixels in a thousand leak at rates over two decades, each doubling within 5 to 10 kelvin."""
    hot = rng.random(world.shape) < 0.002 * scale
    rates = np.where(hot, 10 ** rng.uniform(1.7, 3.5, world.shape), 0.0)
    doubling = rng.uniform(5, 10, world.shape)
    world.dark.append(lambda dark, shot, t: dark + rates * 2 ** ((shot.temperature_c - BASE_C) / doubling) * t)
    return {"density": float(hot.mean())}


@variant("missing_codes", "one_of_four", "code", "signal", accepted=("reduced_bit_depth",))
def one_code_of_four(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leave out every fourth code: it comes out as the one below."""
    world.code.append(lambda codes, shot: codes - (codes % 4 == 3))
    return {"step_dn": 1.0}


# To the nearest code is cutting with half a step more of black.
@variant("reduced_bit_depth", "rounded", "code", "signal", accepted=("missing_codes", "black_level_offset"))
def rounded_bits(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Convert with two bits fewer, to the nearest, and shift the codes up again."""
    world.code.append(lambda codes, shot: np.minimum(np.floor(codes / 4 + 0.5) * 4, world.rig.top_dn - 3))
    return {"step_dn": 4.0}


@variant("gamma_enabled", "toe", "signal", "exposure_s")
def gamma_with_toe(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Bend all codes by a gamma of 1.03 above a tenth of full scale; below it a straight line leads to zero."""
    gamma, top, toe = 1 + sign(rng) * 0.03 * scale, world.rig.top_dn, 0.1

    def bend(value: np.ndarray, shot: Shot) -> np.ndarray:
        share = value / top
        return top * np.where(share > toe, np.maximum(share, toe) ** (1 / gamma), share * toe ** (1 / gamma - 1))

    world.digital.append(bend)
    return {"gamma": gamma}


@variant("brighter_fatter", "boundaries", "signal", "exposure_s")
def moving_boundaries(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Shift each border between pixels away from the fuller side, pushed by the charges next to it and one further."""
    strength, well = 0.004 * scale, world.rig.full_well_e

    def along(charge: np.ndarray) -> np.ndarray:
        """Return the charge that crosses the border behind each pixel of the last axis."""
        padded = np.pad(charge, ((0, 0), (1, 1)), mode="edge")
        left, right = charge[:, :-1], charge[:, 1:]
        push = left - right + 0.3 * (padded[:, :-3] - padded[:, 3:])
        return strength * push / well * (left + right) / 2

    def move(charge: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        moved = charge.copy()
        for flow, result in ((along(charge), moved), (along(charge.T), moved.T)):
            result[:, :-1] -= flow
            result[:, 1:] += flow
        return moved

    world.charge.append(move)
    return {"b": strength}


@variant("brighter_fatter", "thick", "signal", "exposure_s", "image_y", "image_x")
def far_pushes(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let charge run down a potential that dies away exponentially over a pixel, more easily along the columns."""
    strength, well = 0.006 * scale, world.rig.full_well_e
    at = np.arange(-5, 6)
    potential = np.exp(-np.hypot(at[:, None], at) / 1.1)

    def move(charge: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        moved, height = charge.copy(), ndimage.convolve(charge, potential, mode="nearest")
        for high, fill, result, near in ((height, charge, moved, 0.0), (height.T, charge.T, moved.T, 0.8)):
            push = high[:, :-1] - high[:, 1:] + near * (fill[:, :-1] - fill[:, 1:])
            flow = strength * push * (fill[:, :-1] + fill[:, 1:]) / 2 / well
            result[:, :-1] -= flow
            result[:, 1:] += flow
        return moved

    world.charge.append(move)
    return {"b": strength}


@variant("crosstalk", "uneven", "none", "signal", "exposure_s", accepted=("psf_blur",))
def uneven_crosstalk(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give 0.7 % to each neighbour in the row and 0.3 % to each in the column."""
    across, down = 0.007 * scale, 0.003 * scale
    kernel = np.array([[0, down, 0], [across, 1 - 2 * across - 2 * down, across], [0, down, 0]])
    world.charge.append(lambda charge, shot, before: ndimage.convolve(charge, kernel, mode="nearest"))
    return {"fraction": 0.005 * scale}


@variant("image_lag", "two_frames", "previous_frame", "frame", "exposure_s")
def lag_of_two_frames(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leave 0.1 % of a frame's charge for the next and 0.03 % for the one after."""
    older = [np.zeros(world.shape)]

    def remain(expected: np.ndarray, rate: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        left = expected + scale * (0.001 * before + 0.0003 * (older[0] if before.any() else 0.0))
        older[0] = before
        return left

    world.electrons.append(remain)
    return {"fraction": 0.001 * scale}


@variant("parasitic_light_sensitivity", "bent", "image_y", "exposure_s", accepted=("exposure_time_offset",))
def bent_parasitic_light(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let light leak into the stored charge, the storage nodes of the last rows being the leakiest."""
    leak, readout_s = 2e-4 * scale, 20e-3
    row = np.arange(world.rig.rows)[:, None] / world.rig.rows
    waiting = readout_s * row * (0.5 + row)
    world.electrons.append(lambda expected, rate, shot, before: expected + leak * rate * waiting)
    return {"leak": leak, "readout_s": readout_s}


@variant("quantum_efficiency_temperature", "curved", "temperature_C")
def curved_efficiency(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Change the quantum efficiency by 0.05 % per kelvin at 35 °C, and half as fast again 10 K away."""
    slope, bend = sign(rng) * 0.0005 * scale, sign(rng) * 1.2e-5 * scale

    def drift(expected: np.ndarray, rate: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        warmer = shot.temperature_c - BASE_C
        return expected * (1 + slope * warmer + bend * warmer**2)

    world.electrons.append(drift)
    return {"slope_per_K": slope, "bend": bend}


@variant("response_nonlinearity", "half_power", "signal", "exposure_s")
def half_power_response(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lose 1 % at full well as the signal's square root does: quickly at first."""
    depth, well = 0.01 * scale, world.rig.full_well_e

    def bend(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        return signal * (1 - depth * np.sqrt(np.maximum(signal, 0) / well))

    world.voltage.append(bend)
    return {"depth": depth}


@variant("prnu", "patchy", "signal", "exposure_s")
def patchy_prnu(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give pixels sensitivities that neighbours share in part, 0.5 % in spread."""
    drawn = rng.standard_normal(world.shape)
    drawn = drawn + 0.5 * (np.roll(drawn, 1, axis=0) + np.roll(drawn, 1, axis=1))
    sensitivity = 1 + 0.005 * scale * drawn / drawn.std()
    world.electrons.append(lambda expected, rate, shot, before: expected * sensitivity)
    return {"sigma_rel": 0.005 * scale}


@variant("adc_saturation", "clamped_bits", "signal", "exposure_s")
def clamped_bits(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Write fewer bits by cutting off what is above them, not by scaling: nothing beyond 255 DN over black."""
    top = world.rig.black_dn + 255.0
    world.code.append(lambda codes, shot: np.minimum(codes, top))
    return {"clip_dn": top}


@variant("black_level_offset", "taken_off", "none", "exposure_s", "signal", accepted=("adc_saturation",))
def black_taken_off(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Take off the black level behind the converter, unsaid, and cut what comes out below zero."""
    black = world.rig.black_dn
    world.code.append(lambda codes, shot: np.maximum(codes - black, 0.0))
    return {"offset_dn": -black}


@variant("pwm_flicker", "refresh", "exposure_s", "frame", accepted=("mains_ripple",))
def refreshing_panel(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Light of a panel that is drawn anew 69.2 times a second and fades between: whole periods show nothing of it."""
    depth, hertz = 0.025 * scale, 69.2

    def beat(shot: Shot, t: float, dice: np.random.Generator) -> float:
        phase = dice.uniform(0, 2 * np.pi)
        return float(1 + depth * sum(np.sinc(k * hertz * t) * np.sin(k * phase) / k for k in (1, 2, 3)))

    world.lamp.append(beat)
    return {"depth": depth, "frequency_Hz": hertz}

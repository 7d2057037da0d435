"""Other forms of the effects of lens, source, screen, shutter and labels."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage, signal

from testing.generator.hidden_levels import sign
from testing.generator.hidden_optics import WIDEST
from testing.generator.plan import Shot
from testing.generator.registry import Truth, variant
from testing.generator.world import World

FINE = (np.arange(400) + 0.5) / 400  # instants within an exposure, in shares of it


@variant("natural_vignetting", "off_centre", "field_radius", "image_x", "image_y", accepted=("angle_dependence",))
def falloff_about_another_centre(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Darken by the cosine's fourth power, 3 % in the corners, about an axis a tenth of the picture off its middle."""
    x, y = world.rig.field_mm()
    turn, half = rng.uniform(0, 2 * math.pi), float(np.hypot(x, y).max())
    square = ((x - 0.1 * half * math.cos(turn)) ** 2 + (y - 0.1 * half * math.sin(turn)) ** 2) / half**2
    fall = 1 / (1 + 0.015 * scale * square) ** 2
    world.optics.append(lambda picture, shot: picture * fall)
    return {"corner": 0.03 * scale, "direction_rad": turn}


@variant("veiling_glare", "uneven", "patch_level", "pattern", "signal", "image_x", "image_y", accepted=("ghost",))
def uneven_veil(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Spread 0.6 % of all light over the picture, the middle getting a quarter more and the corners a quarter less."""
    share = 0.006 * scale
    field = 1 + 0.25 * (1 - 2 * world.rig.normalised_radius() ** 2)
    world.optics.append(lambda picture, shot: (1 - share) * picture + share * picture.mean() * field)
    return {"fraction": share}


@variant(
    "stray_light_kernel", "power_law", "patch_level", "image_x", "image_y", "pattern", "signal", "edge",
    accepted=("veiling_glare",),
)  # fmt: skip
def power_law_wing(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Throw 1 % of the light into a wing that falls off as the third power of the distance, as rough glass does."""
    share, core = 0.01 * scale, rng.uniform(6, 10)
    y, x = np.mgrid[-60:61, -60:61]
    kernel = (1 + (x**2 + y**2) / core**2) ** -1.5
    kernel /= kernel.sum()

    def wing(picture: np.ndarray, shot: Shot) -> np.ndarray:
        spread = signal.fftconvolve(np.pad(picture, 60, mode="edge"), kernel, mode="valid")
        return (1 - share) * picture + share * spread

    world.optics.append(wing)
    return {"fraction": share, "core_px": core}


@variant("ghost", "blurred", "patch_level", "image_x", "image_y", "signal", "pattern", accepted=("veiling_glare",))
def blurred_ghost(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lay 0.4 % of the picture over it, turned about its centre and out of focus."""
    share = 0.004 * scale
    world.optics.append(
        lambda picture, shot: picture + share * ndimage.gaussian_filter(picture, 5.0, mode="nearest")[::-1, ::-1]
    )
    return {"fraction": share}


@variant("defocus", "disc", "f_number", "edge")
def disc_of_confusion(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Blur every point to an even disc, 1.2 pixels in radius at f/2.8, in proportion to the aperture."""
    widest, fine = 1.2 * scale, 15
    place = (np.arange(9 * fine) + 0.5) / fine - 4.5
    square = place[:, None] ** 2 + place[None, :] ** 2

    def blur(picture: np.ndarray, shot: Shot) -> np.ndarray:
        inside = square <= (widest * WIDEST / shot.setting.f_number) ** 2
        kernel = inside.reshape(9, fine, 9, fine).sum(axis=(1, 3)).astype(float)
        return ndimage.convolve(picture, kernel / kernel.sum(), mode="nearest")

    world.optics.append(blur)
    return {"radius_px_at_f2.8": widest}


@variant(
    "angle_dependence", "beyond_knee", "field_radius", "f_number",
    accepted=("natural_vignetting", "mechanical_vignetting"),
)  # fmt: skip
def shading_beyond_knee(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let microlenses lose rays only beyond a third of the field: 3 % in the corners, more with a narrow cone."""
    depth = 0.03 * scale
    beyond = np.maximum(world.rig.normalised_radius() - 1 / 3, 0) * 1.5
    world.optics.append(lambda picture, shot: picture * (1 - depth * beyond**2 * (shot.setting.f_number / 4) ** 0.7))
    return {"depth": depth}


@variant("spectral_mismatch", "with_level", "pattern", plan="colours")
def mismatch_with_level(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Miss each primary's sensitivity by 2 %, and by a little more in bright patches, whose light is bluer."""
    off = {c: 0.02 * scale * float(rng.choice([-1, 1])) for c in ("red", "blue")}
    world.optics.append(
        lambda picture, shot: picture * (1 + off.get(shot.setting.pattern, 0.0) * (0.9 + 0.2 * picture))
    )
    return {f"error_{c}": e for c, e in off.items()}


@variant("source_warmup_drift", "hyperbola", "timestamp_s")
def hyperbolic_warmup(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Settle by a hyperbola instead of exponentials: quickly at first and ever more slowly."""
    excess, half_s = sign(rng) * 0.01 * scale, 60 * rng.uniform(3, 8)
    world.lamp.append(lambda shot, t, dice: 1 + excess / (1 + shot.time_s / half_s))
    return {"amplitude": excess, "half_s": half_s}


@variant("mains_ripple", "rectified", "exposure_s", "frame", accepted=("pwm_flicker",))
def rectified_mains(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Ripple as a rectified sine does, with all its harmonics, 0.5 % in the fundamental."""
    depth, hertz = 0.005 * scale, float(rng.choice([50.0, 60.0]))

    def ripple(shot: Shot, t: float, dice: np.random.Generator) -> float:
        wave = np.abs(np.sin(math.pi * (hertz * t * FINE + dice.uniform(0, 1))))
        return 1 + depth * 1.5 * (float(wave.mean()) * math.pi / 2 - 1)

    world.lamp.append(ripple)
    return {"depth": depth, "frequency_Hz": 2 * hertz}


@variant("rolling_shutter_banding", "square", "image_y", "exposure_s", accepted=("pwm_flicker", "row_temporal_noise"))
def square_bands(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Expose the rows one after the other under a lamp that is switched between two brightnesses."""
    depth, hertz, row_s = 0.008 * scale, rng.uniform(1000, 2000), 13.28e-6
    rows = np.arange(world.rig.rows)[:, None] * row_s

    def bands(shot: Shot, t: float, dice: np.random.Generator) -> np.ndarray:
        phase = (hertz * (rows + t * FINE[None, :]) + dice.uniform(0, 1)) % 1
        return 1 + depth * np.where(phase < 0.5, 1.0, -1.0).mean(axis=1, keepdims=True)

    world.lamp.append(bands)
    return {"depth": depth, "frequency_Hz": hertz, "row_s": row_s}


@variant(
    "display_black_leak", "cloudy", "patch_level", "pattern", "signal", "screen_x", "screen_y", "image_x", "image_y"
)
def cloudy_black(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Shine through black with 1/2000 of white, and half as much again at the left and right edge."""
    x, _ = world.rig.field_mm()
    leak = 0.0005 * scale * (1 + 0.5 * (x / x.max()) ** 2)
    world.screen.append(lambda picture, shot: picture + leak)
    return {"fraction": float(leak.mean())}


@variant("display_gamma_error", "dark_half", "patch_level")
def dark_half_gamma(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Miss the exponent by 0.8 % below a tenth of white, and not above."""
    error = sign(rng) * 0.008 * scale
    world.screen.append(lambda picture, shot: picture * np.minimum(np.maximum(picture, 1e-6) / 0.1, 1) ** error)
    return {"exponent_error": error}


@variant("led_thermal_droop", "beyond_half", "source_level")
def droop_beyond_half(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lose nothing up to a third of full drive and 2 % at full drive: the heat sink copes until then."""
    loss = 0.02 * scale
    world.drive.append(lambda d, shot: d * (1 - loss * max(d - 1 / 3, 0) * 1.5))
    return {"loss": loss}


@variant("reciprocity_failure", "short_only", "exposure_s")
def failure_of_short_exposures(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Follow a power of the exposure below a millisecond only, as Schwarzschild's law has a threshold."""
    power = sign(rng) * 0.004 * scale

    def fail(expected: np.ndarray, rate: np.ndarray, shot: Shot, before: np.ndarray) -> np.ndarray:
        return expected * min(shot.setting.exposure_s / 1e-3, 1.0) ** power

    world.electrons.append(fail)
    return {"p": power}


@variant("shutter_dead_time", "growing", "frame", "exposure_s", accepted=("exposure_time_offset",))
def growing_dead_time(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lose 5 µs of the second frame of a burst and a tenth more of each that follows."""
    dead = 5e-6 * scale
    world.exposure.append(lambda t, shot: max(t - dead * (1 + 0.1 * (shot.number - 1)), 0.0) if shot.number else t)
    return {"dead_s": dead}


@variant("exposure_time_offset", "with_jumps", "exposure_s")
def offset_of_two_clocks(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Expose 4 µs longer or shorter; above half a millisecond, where a coarser clock counts, a fifth more than that."""
    offset = sign(rng) * 4e-6 * scale
    world.exposure.append(lambda t, shot: max(t + offset * (1.2 if t > 0.5e-3 else 1.0), 0.0))
    return {"offset_s": offset}


@variant("nominal_settings", "times_only", "exposure_s", "f_number", plan="printed")
def nominal_times(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Print rounded exposures on exact thirds of a stop; the f-numbers are those of the iris."""
    world.exposure.append(lambda t, shot: 2 ** (round(math.log2(t) * 3) / 3))
    return {"steps_per_stop": 3.0}


@variant("exposure_label_error", "two_errors", "timestamp_s", "exposure_s", "setting")
def labels_wrong_both_ways(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Print a too long exposure on one setting and a too short one on another, by a third of a stop."""
    long, short = (float(t) for t in rng.choice([113e-6, 187e-6, 311e-6, 523e-6, 2.9e-3, 7.3e-3], 2, replace=False))
    step = 2 ** (min(scale, 2) / 3)

    def really(t: float, shot: Shot) -> float:
        factor = step if abs(t / long - 1) < 1e-6 else 1 / step if abs(t / short - 1) < 1e-6 else 1.0
        return t * factor

    world.exposure.append(really)
    return {"labels_s": [long, short], "factor": step}


@variant("source_not_proportional_to_exposure", "sagging", "exposure_s", accepted=("exposure_time_offset",))
def sagging_flash(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the lamp, flashed for the exposure, sag by 1.5 % along a straight line within 0.6 ms and stay there."""
    sag, settle_s = 0.015 * scale, 0.6e-3

    def flash(shot: Shot, t: float, dice: np.random.Generator) -> float:
        return 1 - sag * float(np.minimum(t * FINE / settle_s, 1.0).mean())

    world.lamp.append(flash)
    return {"sag": sag, "settle_s": settle_s}

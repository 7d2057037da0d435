"""Other forms of catalogue effects: the same cause with another equation than the plain one."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from testing.generator.hidden_levels import BASE_C, sign
from testing.generator.plan import Shot
from testing.generator.registry import Truth, variant
from testing.generator.world import World


@variant("source_warmup_drift", "two_terms", "timestamp_s")
def warmup_of_two_terms(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Settle quickly in part and slowly in part."""
    fast, slow = 0.008 * scale, 0.005 * scale * sign(rng)
    world.lamp.append(
        lambda shot, t, dice: 1 + fast * math.exp(-shot.time_s / 150) + slow * math.exp(-shot.time_s / 1500)
    )
    return {"fast": fast, "slow": slow}


@variant("gain_step_error", "table", "gain_db")
def gain_table(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give every gain step an error of its own."""
    table = {float(g): 0.01 * scale * float(rng.standard_normal()) for g in range(3, 25, 3)}
    world.gain.append(lambda gain, shot: gain * (1 + table.get(round(shot.setting.gain_db, 3), 0.0)))
    return {"errors": list(table.values())}


@variant("fnumber_tstop_error", "table", "f_number")
def stop_table(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Give every f-number an error of its own."""
    table = {n: 0.015 * scale * float(rng.standard_normal()) for n in (2.8, 5.6, 8.0, 11.0)}
    world.optics.append(lambda picture, shot: picture * (1 + table.get(shot.setting.f_number, 0.0)))
    return {"errors": list(table.values())}


@variant("pwm_flicker", "square", "exposure_s", "frame", accepted=("mains_ripple",))
def square_pwm(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Switch between two brightnesses 2 % apart, half the time each."""
    depth, hertz = 0.01 * scale, rng.uniform(200, 500)

    def switch(shot: Shot, t: float, dice: np.random.Generator) -> float:
        start = dice.uniform(0, 1)
        grid = (start + hertz * t * (np.arange(400) + 0.5) / 400) % 1.0
        return 1 + depth * float(np.mean(np.where(grid < 0.5, 1.0, -1.0)))

    world.lamp.append(switch)
    return {"depth": depth, "frequency_Hz": hertz}


@variant(
    "dark_current", "lognormal", "exposure_s", "temperature_C", accepted=("dark_current_nonuniformity", "hot_pixels")
)
def lognormal_dark(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leak a skewed distribution of dark currents, 4 electrons per second in the mean."""
    mean = 4.0 * scale
    each = rng.lognormal(0, 0.5, world.shape)
    each *= mean / each.mean()
    world.dark.append(lambda dark, shot, t: dark + each * 2 ** ((shot.temperature_c - BASE_C) / 7) * t)
    return {"mean_e_per_s": mean}


@variant("dark_current", "arrhenius", "exposure_s", "temperature_C")
def arrhenius_dark(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leak by an activation energy of 0.63 eV instead of a doubling temperature."""
    leak, energy_ev = 3.0 * scale, 0.63
    boltzmann_ev_k = 8.617e-5

    def leakage(dark: np.ndarray, shot: Shot, t: float) -> np.ndarray:
        inverse = 1 / (shot.temperature_c + 273.15) - 1 / (BASE_C + 273.15)
        return dark + leak * math.exp(-energy_ev / boltzmann_ev_k * inverse) * t

    world.dark.append(leakage)
    return {"rate_e_per_s": leak, "energy_eV": energy_ev}


@variant("natural_vignetting", "polynomial", "field_radius", "image_x", "image_y", accepted=("angle_dependence",))
def polynomial_falloff(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Fall off by a polynomial of the radius."""
    a, b = 0.02 * scale, 0.02 * scale * rng.uniform(0.3, 1)
    rho = world.rig.normalised_radius()
    fall = 1 - a * rho**2 - b * rho**6
    world.optics.append(lambda picture, shot: picture * fall)
    return {"a": a, "b": b}


@variant("mechanical_vignetting", "circles", "f_number", "field_radius", accepted=("angle_dependence",))
def overlapping_circles(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Clip the pupil by the barrel's edge: two circles that cover each other less towards the corners."""
    shift = 0.55 + 0.1 * scale
    rho = world.rig.normalised_radius()

    def clip(picture: np.ndarray, shot: Shot) -> np.ndarray:
        barrel = 1.25 * shot.setting.f_number / 2.8
        return picture * _overlap(shift * rho, barrel)

    world.optics.append(clip)
    return {"shift": shift}


def _overlap(d: np.ndarray, big: float) -> np.ndarray:
    """Return the share of a unit circle inside a circle of radius `big` at distance `d`."""
    d = np.maximum(d, 1e-9)
    one = np.arccos(np.clip((d**2 + 1 - big**2) / (2 * d), -1, 1))
    two = big**2 * np.arccos(np.clip((d**2 + big**2 - 1) / (2 * d * big), -1, 1))
    kite = 0.5 * np.sqrt(np.maximum((-d + 1 + big) * (d + 1 - big) * (d - 1 + big) * (d + 1 + big), 0))
    return np.where(d + 1 <= big, 1.0, (one + two - kite) / np.pi)


@variant("response_nonlinearity", "cubic", "signal", "exposure_s")
def cubic_response(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lose 1 % at full well by a cubic law alone."""
    cube = sign(rng) * 0.012 * scale
    well = world.rig.full_well_e
    world.voltage.append(lambda signal, shot, dice: signal * (1 - cube * (signal / well) ** 2))
    return {"a3": cube}


@variant(
    "soft_saturation", "rational", "signal", "exposure_s", accepted=("response_nonlinearity", "full_well_saturation")
)
def rational_saturation(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Compress hyperbolically above a knee."""
    knee, room = 0.7 * world.rig.full_well_e, 1.5 * world.rig.full_well_e / scale

    def compress(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        above = np.maximum(signal - knee, 0)
        return np.minimum(signal, knee) + above / (1 + above / room)

    world.voltage.append(compress)
    return {"knee_e": knee}


@variant(
    "veiling_glare", "wide", "patch_level", "pattern", "signal", "image_x", "image_y", accepted=("stray_light_kernel",)
)
def wide_glare(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Spread the light over a wide but not endless disc."""
    share = 0.008 * scale
    world.optics.append(
        lambda picture, shot: (1 - share) * picture + share * ndimage.gaussian_filter(picture, 35, mode="nearest")
    )
    return {"fraction": share}


@variant("exposure_quantisation", "round", "exposure_s")
def rounded_lines(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Round to the nearest whole line instead of down."""
    line = 8e-6 * scale
    world.exposure.append(lambda t, shot: line * max(round(t / line), 1))
    return {"step_s": line}


@variant("led_thermal_droop", "power", "source_level")
def power_droop(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Follow the drive by a power a little below one."""
    power = 0.012 * scale
    world.drive.append(lambda d, shot: d ** (1 - power))
    return {"power": power}


@variant("psf_blur", "box", "edge", "none", "image_x", "image_y", accepted=("crosstalk",))
def box_blur(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Smear evenly over neighbours, as motion or a scattering cover glass does."""
    share = 0.03 * scale
    kernel = np.array([[share / 2, share, share / 2], [share, 0, share], [share / 2, share, share / 2]])
    kernel[1, 1] = 1 - kernel.sum()
    world.optics.append(lambda picture, shot: ndimage.convolve(picture, kernel, mode="nearest"))
    return {"share": share}


@variant("image_lag", "two_traps", "previous_frame", "frame", "exposure_s")
def lag_of_traps(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Leave a share that saturates: traps that hold no more than a few electrons."""
    share, room = 0.0015 * scale, 20.0 * scale
    world.electrons.append(lambda expected, rate, shot, before: expected + room * -np.expm1(-share * before / room))
    return {"fraction": share, "room_e": room}


@variant("black_level_drift", "curved", "temperature_C", "timestamp_s")
def curved_drift(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Move the black level with the square of the temperature too."""
    slope, bend = 0.04 * scale, 0.0015 * scale * sign(rng)

    def drift(value: np.ndarray, shot: Shot) -> np.ndarray:
        warmer = shot.temperature_c - BASE_C
        return value + slope * warmer + bend * warmer**2

    world.digital.append(drift)
    return {"slope_dn_per_K": slope, "bend": bend}


@variant("conversion_gain_error", "noise_in_dn", "signal", "none", "exposure_s", accepted=("excess_read_noise",))
def gain_with_noise_in_dn(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Miss the conversion gain where the read noise was measured rightly in DN."""
    error = sign(rng) * 0.03 * scale
    world.gain.append(lambda gain, shot: gain * (1 + error))
    world.electrons.append(lambda expected, rate, shot, before: expected / (1 + error))
    world.read_noise.append(lambda sigma, shot: sigma / (1 + error))
    return {"relative_error": error}


@variant("random_telegraph_noise", "many", "none", "gain_db", "signal", "exposure_s", accepted=("excess_read_noise",))
def many_telegraph_pixels(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let a tenth of the pixels jump between two levels 4 electrons apart."""
    jumpy = rng.random(world.shape) < 0.1
    height = 4.0 * scale

    def jump(signal: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        return signal + jumpy * height * (dice.integers(0, 2, world.shape) - 0.5)

    world.voltage.append(jump)
    return {"height_e": height, "share": 0.1}


@variant("prnu", "uniform", "signal", "exposure_s")
def uniform_prnu(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Draw the sensitivities evenly between two limits."""
    half = 0.005 * scale * math.sqrt(3)
    sensitivity = 1 + rng.uniform(-half, half, world.shape)
    world.electrons.append(lambda expected, rate, shot, before: expected * sensitivity)
    return {"sigma_rel": 0.005 * scale}


@variant("dsnu", "skewed", "none", "signal", "gain_db", "exposure_s")
def skewed_dsnu(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Draw the offsets from a one-sided exponential."""
    offsets = 0.8 * scale * (rng.standard_exponential(world.shape) - 1)
    world.voltage.append(lambda signal, shot, dice: signal + offsets)
    return {"sigma_e": 0.8 * scale}


@variant("display_nonuniformity", "bumps", "screen_x", "screen_y", "image_x", "image_y")
def bumpy_screen(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the backlight's lamps show as a slow wave."""
    x, y = world.rig.field_mm()
    u, v = x / x.max(), y / y.max()
    a, b = rng.uniform(0, 2 * math.pi, 2)
    field = 1 + 0.015 * scale * (np.cos(2.2 * u + a) + 0.6 * np.cos(1.7 * v + b))
    world.screen.append(lambda picture, shot: picture * field)
    return {"depth": 0.015 * scale}


@variant("exposure_time_offset", "per_gain", "exposure_s", "gain_db")
def offset_with_gain(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Expose longer by an offset that differs a little above 12 dB, where the sensor changes its read-out."""
    offset = sign(rng) * 5e-6 * scale
    world.exposure.append(lambda t, shot: max(t + offset * (0.9 if shot.setting.gain_db > 12 else 1.0), 0.0))
    return {"offset_s": offset}


@variant("display_gamma_error", "curved", "patch_level")
def curved_display(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Follow a curve that is off in the middle and right at both ends."""
    depth = sign(rng) * 0.03 * scale

    def bend(picture: np.ndarray, shot: Shot) -> np.ndarray:
        tone = 1 + np.log10(np.maximum(picture, 1e-4)) / 2
        return picture * (1 + depth * 4 * tone * (1 - tone) * (picture >= 0.0099))

    world.screen.append(bend)
    return {"depth": depth}


@variant("ambient_light_leak", "sided", "exposure_s", "source_level", "patch_level", "image_x", "signal", "f_number")
def sided_leak(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the window brighten one side more than the other."""
    leak = 0.0003 * scale
    field = 1 + 0.3 * np.linspace(-1, 1, world.rig.columns)[None, :]
    world.ambient.append(lambda elsewhere, shot: elsewhere + leak * field)
    return {"fraction": leak}

"""What the second generator hides: entries by their usual equations, by other laws, and what no catalogue holds.

Sizes are those that the literature and manuals give, one to two times the least that is usual.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from testing.outside.session import Hidden
from testing.outside.two import Camera, Shot

HIDDEN: dict[str, Hidden] = {}
_Install = Callable[[Camera, np.random.Generator, float], Mapping[str, Any]]
_UNIFORM = ("veiling_glare", "ambient_light_leak", "display_black_leak")
_LIT = ("bracket", "surrounds", "levels")


def hides(
    kind: str,
    *plans: str,
    right: tuple[str, ...] = (),
    stage: str = "",
    along: tuple[str, ...] = (),
    together: Mapping[str, tuple[str, ...]] | None = None,
) -> Callable[[_Install], _Install]:
    """Enter a function under its own name."""

    def enter(install: _Install) -> _Install:
        name = install.__name__
        HIDDEN[name] = Hidden(name, kind, install, plans, right, stage, along, together or {})
        return install

    return enter


def _sign(dice: np.random.Generator) -> float:
    return float(dice.choice([-1.0, 1.0]))


# ---------------------------------------------------------------------------------------------- usual equations


@hides("single", *_LIT, right=("veiling_glare",), together={"bracket": _UNIFORM, "levels": _UNIFORM})
def veil(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    share = dice.uniform(0.006, 0.015) * size
    camera.optics.append(lambda light, shot: light + share * (light.mean() - light))
    return {"share": share}


@hides(
    "single",
    "bracket",
    "levels",
    "darks",
    right=("black_level_offset",),
    together={"darks": ("black_level_gain_slope",)},
)
def black(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    shift = _sign(dice) * dice.uniform(0.6, 3.0) * size
    camera.digits.append(lambda codes, shot: codes + shift)
    return {"shift_dn": shift}


@hides("single", "darks", right=("dark_current", "dark_current_clamped"))
def warm_dark(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    rate, doubling = dice.uniform(3, 12) * size, dice.uniform(5.5, 8.0)
    camera.charge.append(lambda e, shot: e + rate * 2 ** ((shot.celsius - 25) / doubling) * shot.seconds)
    return {"rate_e_per_s": rate, "doubling_K": doubling}


@hides(
    "single",
    "bracket",
    "surrounds",
    "levels",
    right=("exposure_time_offset",),
    together=dict.fromkeys(
        _LIT, ("parasitic_light_sensitivity", "shutter_dead_time", "source_not_proportional_to_exposure")
    ),
)
def late_shutter(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    extra = dice.uniform(4e-6, 1.5e-5) * size
    camera.shutter.append(lambda t, shot: t + extra)
    return {"offset_s": extra}


@hides("single", *_LIT, "flats", right=("prnu",))
def uneven_pixels(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    share = dice.uniform(0.006, 0.012) * size
    pattern = 1 + share * dice.standard_normal((camera.height, camera.width))
    camera.optics.append(lambda light, shot: light * pattern)
    return {"sigma_rel": share}


@hides("single", "bracket", "levels", "darks", right=("dsnu",))
def uneven_black(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    sigma = dice.uniform(1.0, 3.0) * size
    pattern = sigma * dice.standard_normal((camera.height, camera.width))
    camera.caught.append(lambda e, shot, rng: e + pattern)
    return {"sigma_e": sigma}


@hides("single", "bracket", "levels", "darks", "flats", right=("excess_read_noise",))
def noisy_reader(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    sigma = camera.noise_e * dice.uniform(0.6, 1.0) * math.sqrt(size)
    camera.caught.append(lambda e, shot, rng: e + sigma * rng.standard_normal(e.shape))
    return {"sigma_e": sigma}


@hides("single", "bracket", "levels", right=("row_temporal_noise",))
def rows_tremble(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    sigma = dice.uniform(1.0, 2.5) * size
    camera.caught.append(lambda e, shot, rng: e + sigma * rng.standard_normal((camera.height, 1)))
    return {"sigma_e": sigma}


@hides(
    "single",
    "bracket",
    "surrounds",
    "levels",
    right=("natural_vignetting",),
    together=dict.fromkeys(_LIT, ("angle_dependence", "mechanical_vignetting")),
)
def oblique_light(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    y, x = camera.yx()
    r_mm = np.hypot(x - (camera.width - 1) / 2, y - (camera.height - 1) / 2) * camera.pitch_um * 1e-3
    fall = np.cos(np.arctan(r_mm / camera.focal_mm)) ** 4
    corner = 1 - fall.min()
    steep = 0.04 * size / corner  # a camera of so few pixels sees little of the field: a fall-off as of a larger one
    fall = 1 - steep * (1 - fall)
    camera.optics.append(lambda light, shot: light * fall)
    return {"corner": 1 - float(fall.min())}


@hides("single", "levels", right=("led_thermal_droop",), together={"levels": ("display_gamma_error",)})
def droop(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    share = dice.uniform(0.02, 0.06) * size
    camera.lamp.append(lambda shot: 1 - share * shot.level)
    return {"droop": share}


@hides("single", "levels", right=("gain_step_error",))
def wrong_gain(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    error = _sign(dice) * dice.uniform(0.01, 0.025) * size
    camera.volts.append(lambda volts, shot, rng: volts * 10 ** (shot.gain_db * error / 20))
    return {"error": error}


@hides(
    "single",
    "bracket",
    "surrounds",
    "levels",
    right=("response_nonlinearity",),
    together={
        "bracket": ("gamma_enabled", "soft_saturation"),
        "surrounds": ("gamma_enabled", "soft_saturation"),
        "levels": ("gamma_enabled", "soft_saturation"),
    },
)
def bent_response(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    a2 = dice.uniform(0.012, 0.04) * size
    camera.caught.append(lambda e, shot, rng: e * (1 - a2 * e / camera.well_e))
    return {"a2": a2}


# ---------------------------------------------------------------------------------------------- other laws


@hides("law", *_LIT, right=("veiling_glare",), together={"bracket": _UNIFORM, "levels": _UNIFORM})
def veil_of_the_middle(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """A veil of the scene's own light in which the middle of the field counts most."""
    y, x = camera.yx()
    weight = np.exp(-((x / camera.width - 0.5) ** 2 + (y / camera.height - 0.5) ** 2) / 0.3)
    weight = weight / weight.sum()
    share = dice.uniform(0.006, 0.015) * size
    camera.optics.append(lambda light, shot: light * (1 - share) + share * float((weight * light).sum()))
    return {"share": share}


@hides("law", "bracket", "surrounds", right=("stray_light_kernel",), together=dict.fromkeys(_LIT, ("veiling_glare",)))
def halo(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """Stray light with wings 1/(1 + (r/r0)²)^1.5 instead of a bell."""
    y, x = (
        np.fft.fftfreq(2 * camera.height, 1 / (2 * camera.height)),
        np.fft.fftfreq(2 * camera.width, 1 / (2 * camera.width)),
    )
    r0, share = dice.uniform(5, 12), dice.uniform(0.02, 0.05) * size
    wings = (1 + (y[:, None] ** 2 + x[None, :] ** 2) / r0**2) ** -1.5
    wings /= wings.sum()
    turned = np.fft.rfft2(wings)

    def spread(light: np.ndarray, shot: Shot) -> np.ndarray:
        wide = np.pad(light, ((0, light.shape[0]), (0, light.shape[1])), constant_values=0.0)
        stray = np.fft.irfft2(np.fft.rfft2(wide) * turned, wide.shape)[: light.shape[0], : light.shape[1]]
        return (1 - share) * light + share * stray

    camera.optics.append(spread)
    return {"share": share, "r0_px": r0}


@hides(
    "law",
    "bracket",
    "flats",
    "surrounds",
    right=("mechanical_vignetting",),
    together=dict.fromkeys((*_LIT, "flats"), ("natural_vignetting", "angle_dependence", "display_nonuniformity")),
)
def barrel(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """The pupil is cut by the barrel: the area that two shifted circles share."""
    y, x = camera.yx()
    rho = np.hypot(x - (camera.width - 1) / 2, y - (camera.height - 1) / 2) / np.hypot(
        camera.width / 2, camera.height / 2
    )
    apart = np.clip(dice.uniform(0.06, 0.14) * size * rho, 0, 1)
    area = (2 / math.pi) * (np.arccos(apart) - apart * np.sqrt(1 - apart**2))
    camera.optics.append(lambda light, shot: light * area)
    return {"corner": 1 - float(area.min())}


@hides("law", "bracket", "flats", "levels", right=("prnu",))
def coarse_pixels(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """PRNU of 3 %, lognormal."""
    sigma = 0.03 * size
    pattern = np.exp(sigma * dice.standard_normal((camera.height, camera.width)) - sigma**2 / 2)
    camera.optics.append(lambda light, shot: light * pattern)
    return {"sigma_rel": sigma}


@hides(
    "law",
    "bracket",
    "levels",
    "flats",
    right=("pwm_flicker",),
    together=dict.fromkeys((*_LIT, "flats"), ("mains_ripple",)),
)
def chopped(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """Light that is chopped at 180 to 260 Hz with any duty, each frame at its own phase."""
    rate, duty, depth = dice.uniform(180, 260), dice.uniform(0.3, 0.8), min(dice.uniform(0.3, 1.0) * size, 1.0)
    dice_phase = np.random.default_rng(int(dice.integers(2**31)))

    def lit_up_to(cycles: float) -> float:
        whole = math.floor(cycles)
        return whole * duty + min(cycles - whole, duty)

    def act(shot: Shot) -> float:
        start = dice_phase.uniform()
        lit = (lit_up_to(start + rate * shot.seconds) - lit_up_to(start)) / (rate * shot.seconds * duty)
        return 1 - depth + depth * lit

    camera.lamp.append(act)
    return {"rate_hz": rate, "duty": duty, "depth": depth}


@hides(
    "law",
    "bracket",
    "surrounds",
    "levels",
    right=("gamma_enabled",),
    together=dict.fromkeys(_LIT, ("response_nonlinearity",)),
)
def early_gamma(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """A gamma of 0.7 to 0.9 on the amplified signal, before the black level is added."""
    gamma = 1 - dice.uniform(0.1, 0.3) * size
    span = 2**camera.bits - 1 - camera.black_dn
    camera.volts.append(lambda v, shot, rng: np.sign(v) * span * (np.abs(v) / span) ** gamma)
    return {"gamma": gamma}


@hides(
    "law",
    "bracket",
    "levels",
    "flats",
    right=("source_warmup_drift",),
    together={"bracket": ("lamp_step",), "levels": ("lamp_step",)},
)
def slow_lamp(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """A lamp that settles as 1/(1 + t/τ)."""
    depth, tau = _sign(dice) * dice.uniform(0.01, 0.03) * size, dice.uniform(30, 90)
    camera.lamp.append(lambda shot: 1 + depth / (1 + shot.time_s / tau))
    return {"depth": depth, "tau_s": tau}


@hides("law", "darks", right=("dark_current", "dark_current_clamped"))
def arrhenius_dark(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """Dark current by an activation energy and no doubling."""
    rate, energy = dice.uniform(3, 12) * size, dice.uniform(0.6, 0.9)
    camera.charge.append(
        lambda e, shot: (
            e + rate * shot.seconds * math.exp(energy / 8.617e-5 * (1 / 298.15 - 1 / (shot.celsius + 273.15)))
        )
    )
    return {"rate_e_per_s": rate, "energy_eV": energy}


@hides("law", "levels", right=("led_thermal_droop",), together={"levels": ("display_gamma_error",)})
def droop_by_square(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """A source that yields with the square of its drive."""
    share = dice.uniform(0.02, 0.06) * size
    camera.lamp.append(lambda shot: 1 / (1 + share * shot.level**2))
    return {"droop": share}


@hides(
    "law",
    "bracket",
    "levels",
    right=("response_nonlinearity",),
    together=dict.fromkeys(_LIT, ("gamma_enabled", "soft_saturation")),
)
def tangent_response(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """A response that bends as the tanh of its charge."""
    bend = dice.uniform(0.25, 0.4) * math.sqrt(size)
    top = camera.well_e / bend
    camera.caught.append(lambda e, shot, rng: top * np.tanh(e / top))
    return {"bend": bend}


# ---------------------------------------------------------------------------------------------- outsiders


@hides("law", "bracket", "darks", right=("amplifier_glow",), stage="charge", along=("exposure_s", "image_xy"))
def corner_glow(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """Charge in proportion to exposure, a Gaussian from a corner: the glow of an amplifier."""
    y, x = camera.yx()
    x0, y0 = dice.choice([0, camera.width - 1]), dice.choice([0, camera.height - 1])
    width = dice.uniform(0.18, 0.35) * camera.width
    bell = np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * width**2))
    glow = size * dice.uniform(20, 40) * bell  # electrons in the longest frame of a plan
    camera.charge.append(lambda e, shot: e + glow * shot.seconds / camera.longest_s)
    return {"x_px": float(x0), "y_px": float(y0), "width_px": float(width)}


@hides("outsider", "bracket", "levels", stage="readout", along=("image_y",))
def row_gain_step(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """The gain steps at a row: the lower part is read through another amplifier."""
    row, step = dice.uniform(0.3, 0.7) * camera.height, _sign(dice) * dice.uniform(0.03, 0.06) * size
    y, _ = camera.yx()
    part = 1 + step * (y >= row)
    camera.volts.append(lambda volts, shot, rng: volts * part)
    return {"row_px": float(row), "step": step}


@hides("outsider", "bracket", "darks", stage="digital", along=("image_y", "exposure_s"))
def moving_ripple(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """A ripple over the rows that moves with the exposure: a supply that swings and is sampled later."""
    depth, period, per_stop = 1.5 * size * dice.uniform(1, 2), dice.uniform(30, 60), dice.uniform(0.6, 1.2)
    y, _ = camera.yx()
    camera.digits.append(
        lambda codes, shot: codes + depth * np.sin(2 * np.pi * y / period + per_stop * math.log(shot.seconds))
    )
    return {"depth_dn": depth, "period_px": float(period)}


@hides("outsider", "bracket", "levels", "darks", stage="digital", along=("idle_s",))
def idle_black(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """The black level depends on the time since the last frame."""
    depth, tau = _sign(dice) * dice.uniform(2.0, 4.0) * size, dice.uniform(2.0, 6.0)
    camera.digits.append(lambda codes, shot: codes + depth * math.exp(-shot.idle_s / tau))
    return {"depth_dn": depth, "tau_s": tau}


@hides("outsider", "bracket", "levels", "flats", stage="source", along=("frame",))
def every_fifth_dim(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """Every fifth frame is 4 to 8 % dim."""
    depth, which = dice.uniform(0.04, 0.08) * size, int(dice.integers(5))
    camera.lamp.append(lambda shot: 1 - depth * (shot.number % 5 == which))
    return {"depth": depth}


@hides("law", "bracket", "levels", "flats", right=("series_settling",))
def drift_in_repeats(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """The light grows from frame to frame within a setting and starts anew with the next."""
    rise = _sign(dice) * dice.uniform(0.006, 0.015) * size
    camera.lamp.append(lambda shot: 1 + rise * shot.turn)
    return {"rise": rise}


@hides("law", "bracket", "levels", "darks", right=("black_level_offset",), stage="digital", along=("image_y",))
def row_ramp(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """The black level ramps over the rows."""
    rise = _sign(dice) * dice.uniform(1.5, 3.0) * size
    y, _ = camera.yx()
    camera.digits.append(lambda codes, shot: codes + rise * y / camera.height)
    return {"rise_dn": rise}


@hides("outsider", "bracket", "darks", stage="digital", along=("exposure_s",))
def long_mode(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """The black level steps when the exposure passes a limit of the sequencer."""
    step = _sign(dice) * dice.uniform(1.5, 3.0) * size
    limit_s = 0.1 * camera.longest_s
    camera.digits.append(lambda codes, shot: codes + step * (shot.seconds > limit_s))
    return {"step_dn": step}


@hides("outsider", "levels", stage="source", along=("source_level",))
def driver_range(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """The lamp's driver changes its range at half scale and steps there."""
    step = _sign(dice) * dice.uniform(0.02, 0.04) * size
    camera.lamp.append(lambda shot: 1 + step * (shot.level > 0.5))
    return {"step": step}


@hides("outsider", "bracket", "flats", "levels", stage="optics", along=("image_x",))
def fringes(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """Fringes of a thin window: the light swings along the columns."""
    depth, period, phase = dice.uniform(0.012, 0.025) * size, dice.uniform(50, 90), dice.uniform(0, 6.28)
    _, x = camera.yx()
    camera.optics.append(lambda light, shot: light * (1 + depth * np.sin(2 * np.pi * x / period + phase)))
    return {"depth": depth, "period_px": float(period)}


@hides("outsider", "bracket", "levels", "flats", stage="optics", along=("image_xy",))
def dust(camera: Camera, dice: np.random.Generator, size: float) -> Mapping[str, Any]:
    """A soft dark spot: dust on the window."""
    y, x = camera.yx()
    x0, y0 = dice.uniform(0.25, 0.75) * camera.width, dice.uniform(0.25, 0.75) * camera.height
    width, depth = dice.uniform(0.1, 0.18) * camera.width, dice.uniform(0.03, 0.06) * size
    spot = 1 - depth * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * width**2))
    camera.optics.append(lambda light, shot: light * spot)
    return {"depth": depth, "x_px": float(x0), "y_px": float(y0), "width_px": float(width)}

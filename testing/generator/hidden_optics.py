"""Hidden effects of lens and field (catalogue 29–40)."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from testing.generator.hidden_levels import sign
from testing.generator.plan import Shot
from testing.generator.registry import Truth, entry
from testing.generator.world import World

WIDEST = 2.8


@entry("natural_vignetting", "field_radius", "image_x", "image_y", accepted=("angle_dependence",))
def natural_vignetting(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Darken the field by the fourth power of the cosine, 3 % in the corners, and a little by the radius's fourth."""
    corner, fourth = 0.03 * scale, rng.uniform(0, 0.005) * scale
    rho = world.rig.normalised_radius()
    tangent = ((1 - corner) ** -0.5 - 1) ** 0.5
    fall = np.cos(np.arctan(rho * tangent)) ** 4 * (1 - fourth * rho**4)
    world.optics.append(lambda picture, shot: picture * fall)
    x, y = world.rig.field_mm()
    return {"focal_mm": float(np.hypot(x, y).max() / tangent), "k4": fourth}


@entry("mechanical_vignetting", "f_number", "field_radius", accepted=("angle_dependence",))
def mechanical_vignetting(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Cut the corners by 2 % at f/2.8, less as the iris closes."""
    depth = 0.02 * scale
    shade = depth * world.rig.normalised_radius() ** 4
    world.optics.append(lambda picture, shot: picture * (1 - shade * (WIDEST / shot.setting.f_number) ** 2))
    return {"depth": depth}


@entry("display_nonuniformity", "screen_x", "screen_y", "image_x", "image_y")
def display_nonuniformity(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the screen's own radiance vary by some 1.5 % across it."""
    x, y = world.rig.field_mm()
    u, v = x / x.max(), y / y.max()
    c = 0.015 * scale * rng.uniform(0.4, 1.0, 5) * rng.choice([-1, 1], 5)
    field = 1 + c[0] * u + c[1] * v + c[2] * u * u + c[3] * u * v + c[4] * v * v
    world.screen.append(lambda picture, shot: picture * field)
    return {"coefficients": [float(k) for k in c]}


@entry("veiling_glare", "patch_level", "pattern", "signal")
def veiling_glare(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Spread 0.6 % of all light evenly over the picture."""
    share = 0.006 * scale
    world.optics.append(lambda picture, shot: (1 - share) * picture + share * picture.mean())
    return {"fraction": share}


@entry("stray_light_kernel", "patch_level", "image_x", "image_y", "pattern", "signal", accepted=("veiling_glare",))
def stray_light_kernel(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Throw 1 % of the light into a wing some ten pixels wide."""
    share, width = 0.01 * scale, rng.uniform(8, 14)

    def wing(picture: np.ndarray, shot: Shot) -> np.ndarray:
        return (1 - share) * picture + share * ndimage.gaussian_filter(picture, width, mode="nearest")

    world.optics.append(wing)
    return {"fraction": share, "width_px": width}


@entry("ghost", "patch_level", "image_x", "image_y", "signal", "pattern", accepted=("veiling_glare",))
def ghost(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Lay 0.3 % of the picture, turned about its centre, over it."""
    share = 0.003 * scale
    world.optics.append(lambda picture, shot: picture + share * picture[::-1, ::-1])
    return {"fraction": share}


@entry("psf_blur", "edge", "none", "image_x", "image_y")
def psf_blur(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Blur by 0.4 pixels at every f-number."""
    sigma = 0.4 * scale
    world.optics.append(lambda picture, shot: ndimage.gaussian_filter(picture, sigma, mode="nearest", truncate=6))
    return {"sigma_px": sigma}


@entry("defocus", "f_number", "edge")
def defocus(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Blur by 0.6 pixels at f/2.8, in proportion to the aperture."""
    widest = 0.6 * scale

    def blur(picture: np.ndarray, shot: Shot) -> np.ndarray:
        return ndimage.gaussian_filter(picture, widest * WIDEST / shot.setting.f_number, mode="nearest", truncate=6)

    world.optics.append(blur)
    return {"sigma_px_at_f2.8": widest}


@entry("fnumber_tstop_error", "f_number")
def fnumber_tstop_error(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Pass 1 % more or less light per stop than the engraved f-number says."""
    per_stop = sign(rng) * 0.01 * scale
    world.optics.append(lambda picture, shot: picture * (1 + per_stop * 2 * math.log2(shot.setting.f_number / 4)))
    return {"relative_error_per_stop": per_stop}


@entry("angle_dependence", "field_radius", "f_number", accepted=("natural_vignetting", "mechanical_vignetting"))
def angle_dependence(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Let the microlenses lose steep rays: 2 % in the corners, more with a narrow cone."""
    depth = 0.02 * scale
    square = world.rig.normalised_radius() ** 2
    world.optics.append(lambda picture, shot: picture * (1 - depth * square * (shot.setting.f_number / 4) ** 0.5))
    return {"depth": depth}


@entry("polarisation", "camera_angle", visible=False)
def polarisation(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """Weaken polarised light by 2 %: the same for every frame while the camera is not turned."""
    depth, angle = 0.02 * scale, rng.uniform(0, math.pi)
    world.optics.append(lambda picture, shot: picture * (1 + depth * math.cos(2 * angle)))
    return {"depth": depth, "angle_rad": angle}


@entry("spectral_mismatch", "pattern", plan="colours")
def spectral_mismatch(world: World, rng: np.random.Generator, scale: float) -> Truth:
    """See each primary of the screen with a sensitivity 2 % away from the assumed one."""
    factor = {c: 1 + 0.02 * scale * float(rng.choice([-1, 1])) for c in ("red", "blue")}
    world.optics.append(lambda picture, shot: picture * factor.get(shot.setting.pattern, 1.0))
    return {f"factor_{c}": f for c, f in factor.items()}

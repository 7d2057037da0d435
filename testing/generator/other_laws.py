"""Causes that the catalogue names, by equations that it does not hold: what the laboratory meets."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import signal as filters

from testing.generator.plan import Setting, Shot
from testing.generator.rig import Rig
from testing.generator.scene import Chart
from testing.generator.session import Session, session_in, settings_of
from testing.generator.world import World

Put = Callable[[World, np.random.Generator], None]


def barrel_beyond_a_circle(world: World, rng: np.random.Generator) -> None:
    """Cut the field beyond a circle that widens as the lens is stopped down: a smooth step, not two circles."""
    edge, width, depth = rng.uniform(0.45, 0.6), rng.uniform(0.1, 0.2), rng.uniform(0.15, 0.4)
    rho = world.rig.normalised_radius()

    def cut(picture: np.ndarray, shot: Shot) -> np.ndarray:
        circle = edge * (shot.setting.f_number / 2.8) ** 0.7
        return picture * (1 - depth / (1 + np.exp((circle - rho) / width)))

    world.optics.append(cut)


def halo_of_a_power(world: World, rng: np.random.Generator) -> None:
    """Scatter 2 to 5 % about each point by a power of the distance, as dust and polish do."""
    share, core, power = rng.uniform(0.02, 0.05), rng.uniform(3.0, 6.0), rng.uniform(1.2, 1.8)
    rows, columns = world.shape
    y, x = np.mgrid[-rows : rows + 1, -columns : columns + 1]
    kernel = (1 + (x**2 + y**2) / core**2) ** -power
    kernel *= share / kernel.sum()

    def scatter(picture: np.ndarray, shot: Shot) -> np.ndarray:
        padded = np.pad(picture, ((rows, rows), (columns, columns)), mode="edge")
        return (1 - share) * picture + filters.fftconvolve(padded, kernel, mode="valid")

    world.optics.append(scatter)


def pixels_of_three_per_cent(world: World, rng: np.random.Generator) -> None:
    """Let pixels differ by 3 % in their response."""
    each = 1 + 0.03 * rng.standard_normal(world.shape)
    world.electrons.append(lambda expected, rate, shot, before: expected * each)


def chopped_light(world: World, rng: np.random.Generator) -> None:
    """Switch the light wholly off and on at 180 to 260 Hz, any duty, the phase new in every frame."""
    hertz, duty = rng.uniform(180, 260), rng.uniform(0.3, 0.9)

    def on(shot: Shot, t: float, dice: np.random.Generator) -> float:
        start = dice.uniform(0, 1)
        turns = hertz * t

        def lit(phase: float) -> float:
            return math.floor(phase) * duty + min(phase % 1.0, duty)

        return (lit(start + turns) - lit(start)) / turns / duty

    world.lamp.append(on)


def gamma_before_the_black_level(world: World, rng: np.random.Generator) -> None:
    """Bend what the pixel gives by a power of 0.7 to 0.9 before the black level is added."""
    power, black = rng.uniform(0.7, 0.9), world.rig.black_dn
    top = world.rig.top_dn - black

    def bend(value: np.ndarray, shot: Shot) -> np.ndarray:
        share = (value - black) / top
        return black + top * np.sign(share) * np.abs(share) ** power

    world.digital.append(bend)


def every_fifth_frame(world: World, rng: np.random.Generator) -> None:
    """Dim every fifth frame by 4 to 8 %."""
    loss, count = rng.uniform(0.04, 0.08), [0]

    def dim(shot: Shot, t: float, dice: np.random.Generator) -> float:
        count[0] += 1
        return 1 - loss * (count[0] % 5 == 2)

    world.lamp.append(dim)


def drift_within_a_setting(world: World, rng: np.random.Generator) -> None:
    """Let the light of each setting's frames settle: each frame a third of the former one's excess of 1 to 2 %."""
    excess = rng.uniform(0.01, 0.02)
    world.lamp.append(lambda shot, t, dice: 1 + excess * 3.0**-shot.number)


def line_within_a_setting(world: World, rng: np.random.Generator) -> None:
    """Let the light of each setting's frames fall in a line, by 0.5 to 1 % from each to the next."""
    fall = rng.uniform(0.005, 0.01)
    world.lamp.append(lambda shot, t, dice: 1 - fall * shot.number)


def own_light_veil(world: World, rng: np.random.Generator) -> None:
    """Veil the picture by 0.5 to 1.5 % of its own light, more in the middle than in the corners."""
    share = rng.uniform(0.005, 0.015)
    field = 1 - 0.1 * world.rig.normalised_radius() ** 2
    world.optics.append(lambda picture, shot: picture * (1 - share) + share * picture.mean() * field)


OTHER_LAWS: dict[str, tuple[Put, str]] = {
    "barrel": (barrel_beyond_a_circle, "mechanical_vignetting"),
    "halo": (halo_of_a_power, "stray_light_kernel"),
    "prnu": (pixels_of_three_per_cent, "prnu"),
    "chopped": (chopped_light, "pwm_flicker"),
    "gamma": (gamma_before_the_black_level, "gamma_enabled"),
    "fifth": (every_fifth_frame, "unnamed"),
    "settling": (drift_within_a_setting, "series_settling"),
    "falling": (line_within_a_setting, "series_settling"),
    "veil": (own_light_veil, "veiling_glare"),
}


def small(rng: np.random.Generator) -> list[Setting]:
    """Return some thirty captures: exposures, levels, gains, stops, two surrounds and darks, each lit one twice."""
    lit = [Setting(float(t)) for t in np.geomspace(41e-6, 1.2e-3, 6)]
    lit += [Setting(0.9e-3, level=0.3), Setting(0.3e-3, 9.0), Setting(0.3e-3, pattern="bright_surround")]
    lit += [Setting(0.9e-3 * (n / 4) ** 2, f_number=n) for n in (2.8, 5.6, 8.0)]
    dark = [Setting(t, closed=True) for t in (41e-6, 1e-2, 1.0)]
    chosen = lit * 2 + dark
    return [chosen[i] for i in rng.permutation(len(chosen))]


def session_of(name: str, seed: int, plan: str | Callable[[np.random.Generator], list[Setting]] = small) -> Session:
    """Return a session in which one of these causes is hidden, with a plan and noise of its own."""
    rig = Rig(rows=80, columns=120) if name == "prnu" else Rig()
    rng = np.random.default_rng([seed, 901])
    world = World(rig, Chart.scrambled(rig, rng))
    OTHER_LAWS[name][0](world, rng)
    own = [seed + 7_000_003, 2]
    settings = [replace(setting, frames=4) for setting in settings_of(plan, own)]
    return session_in(world, (), {}, settings, own, True)

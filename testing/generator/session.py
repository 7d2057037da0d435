"""A session: a world with hidden effects, a plan, and the frames that come of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiometer.data import CaptureHeader, CaptureSet, CaptureSetWriter, Frame, FrameEntry, FrameSettings
from radiometer.data.storage import write_yaml_atomic
from testing.generator import (  # noqa: F401  (they enter themselves into the registry)
    hidden_levels,
    hidden_noise,
    hidden_optics,
    hidden_response,
    hidden_source,
    hidden_taps,
    hidden_timing,
    outsiders,
    variants,
    variants_scene,
    variants_sensor,
)
from testing.generator import plan as plans
from testing.generator.plan import FRAME_PERIOD_S, SETTLING_S, Setting, Shot
from testing.generator.printed import printed
from testing.generator.registry import Hidden, Truth, everything
from testing.generator.rig import Rig
from testing.generator.scene import Chart
from testing.generator.world import World, develop

TRUTH_FORMAT = "radiometer-hidden-truth/1"


@dataclass(frozen=True)
class Session:
    """One capture session of a world; `frames()` develops them anew, the same each time.

    Attributes:
        header: What `capture.yaml` would say.
        truth: What is hidden: name to parameters. A finder must not look.
        covariates: Where each hidden effect may rightly be seen.
    """

    header: CaptureHeader
    truth: dict[str, Truth]
    hidden: tuple[Hidden, ...]
    _develop: Callable[[], Iterator[np.ndarray]]

    def frames(self) -> Iterator[Frame]:
        """Yield the frames in the header's order."""
        depth = self.header.camera.bit_depth
        for number, (entry, dn) in enumerate(zip(self.header.frames, self._develop(), strict=True)):
            yield Frame(dn, depth, entry.settings, frame_id=number)

    def write(self, folder: Path) -> CaptureSet:
        """Write the capture set, and the truth in a sealed file next to it (`<folder>.truth.yaml`)."""
        h = self.header
        with CaptureSetWriter(folder, h.camera, h.lens, h.source, h.patches, h.patterns) as writer:
            for frame in self.frames():
                writer.add(frame)
            finished = writer.finish()
        write_yaml_atomic(folder.with_name(folder.name + ".truth.yaml"), self.sealed())
        return finished

    def sealed(self) -> dict[str, Any]:
        """Return what stands in the sealed file."""
        return {
            "format": TRUTH_FORMAT,
            "hidden": [
                {"name": h.name, "entry": h.entry, "covariates": list(h.covariates), "parameters": self.truth[h.name]}
                for h in self.hidden
            ],
        }


def make_session(
    *names: str,
    camera_seed: int = 0,
    session_seed: int | None = None,
    scale: float | None = None,
    factor: float = 1.0,
    rig: Rig | None = None,
    plan: str | Callable[[np.random.Generator], list[Setting]] | None = None,
    known_patches: bool = True,
    frames: int = 4,
) -> Session:
    """Return a session in which the named effects are hidden.

    Args:
        names: Entries, `entry:form` variants or outsiders; none for a null set.
        camera_seed: Seed of what belongs to the rig: sizes of the effects, fixed patterns, the chart's order.
        session_seed: Seed of what is new every time: order, jitter, patch errors, noise; None: from the camera's.
        scale: Size of the effects in units of the smallest realistic; None: drawn evenly from 1 to 2.
        factor: Further factor on the size.
        rig: Numbers of the rig.
        plan: Name (rich, colours, printed, bracket, bracket_no_darks, darks, afterglow, short), a function, or None:
            what the effects need.
        known_patches: State the patches' radiances; otherwise they are null.
        frames: Frames per capture.
    """
    hidden = tuple(everything()[n] for n in names)
    rig = rig or Rig()
    camera_rng = np.random.default_rng([camera_seed, 1])
    world = World(rig, Chart.scrambled(rig, camera_rng))
    truth = {}
    for h in hidden:
        truth[h.name] = h.hide(world, camera_rng, factor * (camera_rng.uniform(1, 2) if scale is None else scale))
    seed = [camera_seed + 1_000_003, 2] if session_seed is None else [session_seed, 2]
    settings = settings_of(plan or next((h.plan for h in hidden if h.plan != "rich"), "rich"), seed)
    settings = [replace(s, frames=frames) for s in settings]
    return session_in(world, hidden, truth, settings, seed, known_patches)


def session_of_taps(name: str, grid: tuple[int, int], seed: int) -> Session:
    """Return a rich session of a camera whose taps are a grid of rows and columns, each with a size of an effect.

    Args:
        name: Effect of `hide_in_taps`; nothing is hidden where it is empty.
        grid: Rows and columns of taps.
        seed: Of rig and session.
    """
    world = World(Rig(), Chart.scrambled(Rig(), np.random.default_rng([seed, 1])))
    if name:
        hidden_taps.hide_in_taps(world, name, grid, np.random.default_rng([seed, 8]))
    return session_in(world, (), {}, settings_of("rich", [seed, 2]), [seed, 2], known_patches=True)


def settings_of(plan: str | Callable[[np.random.Generator], list[Setting]], seed: list[int]) -> list[Setting]:
    """Return the settings of a plan, by its name or by its maker."""
    rng = np.random.default_rng([*seed, 3])
    if callable(plan):
        return plan(rng)
    named: dict[str, Callable[[], list[Setting]]] = {
        "rich": lambda: plans.rich(rng),
        "colours": lambda: plans.rich(rng, colours=True),
        "printed": lambda: printed(plans.rich(rng)),
        "bracket": lambda: plans.bracket(rng),
        "bracket_no_darks": lambda: plans.bracket(rng, with_darks=False),
        "darks": lambda: plans.dark_only(rng),
        "afterglow": lambda: plans.afterglow(rng),
        "short": lambda: plans.short(rng),
    }
    return named[plan]()


def session_in(
    world: World,
    hidden: tuple[Hidden, ...],
    truth: dict[str, Truth],
    settings: list[Setting],
    seed: list[int],
    known_patches: bool,
) -> Session:
    """Return the session of a world that is made already."""
    rng = np.random.default_rng([*seed, 4])
    rig = world.rig
    patterns = tuple(dict.fromkeys(s.pattern for s in settings))
    patches = world.chart.stated(patterns, rng, known=known_patches)
    shots = _shots(rig, settings, rng)
    responsivity = 1 + 0.03 * float(np.clip(rng.standard_normal(), -2, 2))
    header = CaptureHeader(
        camera=rig.camera(),
        lens=rig.lens(),
        source=rig.source(),
        patterns=patterns,
        patches=patches,
        frames=tuple(FrameEntry.of(f"frames/{n:04d}.png", _label(rig, s)) for n, s in enumerate(shots)),
    )
    return Session(
        header,
        truth,
        hidden,
        lambda: develop(world, iter(shots), responsivity, np.random.default_rng([*seed, 5])),
    )


def _shots(rig: Rig, settings: list[Setting], rng: np.random.Generator) -> list[Shot]:
    """Return every frame of every capture with its time, temperature and the lamp's state."""
    shots, clock = [], 0.0
    for capture, setting in enumerate(settings):
        clock += SETTLING_S * rng.uniform(0.8, 1.2)
        kelvin = setting.temperature_c + rng.normal(0, 0.15)
        jitter = float(rig.jitter * rng.standard_normal())
        for number in range(setting.frames):
            time_s = round(clock + number * (FRAME_PERIOD_S + setting.exposure_s), 6)
            shots.append(Shot(setting, capture, number, time_s, round(kelvin, 2), jitter))
        clock += setting.frames * (FRAME_PERIOD_S + setting.exposure_s)
    return shots


def _label(rig: Rig, shot: Shot) -> FrameSettings:
    s = shot.setting
    return FrameSettings(
        exposure_s=s.exposure_s,
        gain_db=s.gain_db,
        f_number=s.f_number,
        black_level_dn=rig.black_dn,
        temperature_c=shot.temperature_c,
        timestamp_s=shot.time_s,
        source_level=s.level,
        pattern=s.pattern,
        shutter="closed" if s.closed else "open",
    )

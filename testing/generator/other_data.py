"""Other kinds of data than capture sets: EMVA 1288 folders, photograph stacks, light-meter tables."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from radiometer.data.storage import write_text_atomic, write_yaml_atomic
from testing.generator import session as sessions
from testing.generator.plan import Setting, Shot
from testing.generator.printed import DENOMINATORS
from testing.generator.registry import Truth, everything
from testing.generator.rig import Rig
from testing.generator.scene import Chart
from testing.generator.world import World, develop

# Table of the thesis: luminance in cd/m2 of two screens, and what a light meter advised at ISO 136 (sold as 200).


@dataclass(frozen=True)
class Flat(Chart):
    """A uniformly lit field, as an integrating sphere gives it."""

    def image(self, pattern: str) -> np.ndarray:
        """Return the code 1 everywhere."""
        return np.ones((self.rig.rows, self.rig.columns))


def write_emva_set(folder: Path, *names: str, camera_seed: int = 0, steps: int = 25, scale: float = 1.0) -> Path:
    """Write an EMVA 1288 folder (pairs of bright and dark frames with their photons) and return its descriptor.

    Args:
        folder: To be created; the truth is next to it.
        names: What is hidden.
        camera_seed: Seed of everything.
        steps: Bright and dark exposures.
        scale: Size of the hidden effects.
    """
    rig = Rig()
    rng = np.random.default_rng([camera_seed, 6])
    world = World(rig, Flat(rig, np.ones(24)))
    truth = {n: everything()[n].hide(world, rng, scale) for n in names}
    times = np.linspace(40e-6, 1.5e-3, steps)
    photons = rig.electrons_per_radiance_second * rig.peak_radiance / 16 / rig.quantum_efficiency * times
    shots = [s for lit in (True, False) for s in _pairs(times, lit=lit)]
    (folder / "images").mkdir(parents=True)
    lines = ["v 3.0", f"n {rig.bit_depth} {rig.columns} {rig.rows}"]
    for shot, dn in zip(shots, develop(world, iter(shots), 1.0, rng), strict=True):
        step, kind = shot.capture % steps, "d" if shot.setting.closed else "b"
        if shot.number == 0:
            nanoseconds = times[step] * 1e9
            lines.append(f"b {nanoseconds:.1f} {photons[step]:.1f}" if kind == "b" else f"d {nanoseconds:.1f}")
        name = f"{kind}_{step:03d}_{shot.number + 1:03d}.png"
        cv2.imwrite(str(folder / "images" / name), dn)
        lines.append(f"i images\\{name}")
    write_text_atomic(folder / "EMVA1288_Data.txt", "\n".join(lines) + "\n")
    _seal(folder, truth)
    return folder / "EMVA1288_Data.txt"


def _pairs(times: np.ndarray, *, lit: bool) -> Iterator[Shot]:
    for number, t in enumerate(times):
        setting = Setting(float(t), temperature_c=25.0, closed=not lit)
        for frame in range(2):
            yield Shot(setting, number + (0 if lit else len(times)), frame, 2.0 * number + frame, 25.0, 0.0)


def write_photographs(
    folder: Path, *, seed: int = 0, rounded: bool = True, wrong_label: int | None = None, count: int = 9
) -> dict[str, list[float]]:
    """Write a stack of 8-bit photographs with printed exposures and return the truth.

    Args:
        folder: To be created; the truth is next to it.
        seed: Seed of scene and noise.
        rounded: Expose exact stops under rounded labels; otherwise exactly what is printed.
        wrong_label: Number of the photograph whose label is that of another, if any.
        count: Photographs, one stop apart.
    """
    rng = np.random.default_rng([seed, 7])
    labels = [d for d in DENOMINATORS if min(abs(math.log2(d) - k) for k in range(13)) < 0.1][:count][::-1]
    real = [2.0 ** -round(math.log2(d)) if rounded else 1 / d for d in labels]
    printed = list(labels)
    if wrong_label is not None:
        printed[wrong_label] = labels[(wrong_label + 1) % count]
    scene = _scene(rng) / real[count // 2]
    folder.mkdir(parents=True)
    for number, t in enumerate(real):
        cv2.imwrite(str(folder / f"photo_{number:02d}.png"), _film(scene * t, rng))
    lines = [f"photo_{n:02d}.png 1/{d}" for n, d in enumerate(printed)]
    write_text_atomic(folder / "exposures.txt", "\n".join(lines) + "\n")
    truth = {"real_s": real, "printed_s": [1 / d for d in printed]}
    _seal(folder, {"photographs": {k: list(v) for k, v in truth.items()}})
    return truth


def _scene(rng: np.random.Generator) -> np.ndarray:
    """Return a smooth scene over 1:1000 around 0.2 of full exposure."""
    coarse = rng.uniform(-1.8, 1.2, (6, 9))
    return 0.2 * 10 ** cv2.resize(coarse, (144, 96), interpolation=cv2.INTER_CUBIC)


def _film(exposure: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return an 8-bit picture by a camera's tone curve: a shoulder over a power law."""
    electrons = rng.poisson(np.minimum(exposure, 4.0) * 20_000) + rng.normal(0, 5, exposure.shape)
    linear = np.clip(electrons / 20_000, 0, None)
    tone = (linear / (1 + 0.35 * linear) * 1.35) ** (1 / 2.2)
    return np.clip(np.rint(255 * tone), 0, 255).astype(np.uint8)


def _seal(folder: Path, truth: dict[str, Truth]) -> None:
    write_yaml_atomic(folder.with_name(folder.name + ".truth.yaml"), {"format": sessions.TRUTH_FORMAT, "hidden": truth})

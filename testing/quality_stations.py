"""Sessions of captures with the simulated camera, each with one error planted that an index must find."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from radiometer.data import CaptureSetWriter, LensDescription, PatchDescription
from radiometer.devices import CameraPreset, CameraSettings
from simulators.cameras.simulated_camera import SimulatedCamera, default_limits
from simulators.chain.camera_model import CameraModel
from simulators.effects.registry import make_effect
from simulators.scenes import ImageScene, Scene, UniformScene

WIDTH, HEIGHT = 200, 160
PATCH = PatchDescription(name="patch", x=80, y=60, width=40, height=40)
LENS = LensDescription(focal_length_mm=16, f_number=4, transmittance=0.95)
FULL_WELL_E = 24_500.0
_EXPOSURES_S = (0.004, 0.004, 0.004)
Effects = Mapping[str, Mapping[str, object]]


def uniform(radiance: float = 1.0) -> Scene:
    """Return an even source; 1 W·sr⁻¹·m⁻² fills half of the range in some 8 ms."""
    return UniformScene(radiance_W_per_sr_m2=radiance)


def picture(folder: Path, radiance: NDArray[np.float64]) -> Scene:
    """Return a scene of stated radiances per pixel."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "scene.npy"
    np.save(file, radiance.astype(np.float32))
    return ImageScene(file=file)


def capture(
    folder: Path,
    scene: Scene,
    effects: Effects | None = None,
    *,
    seed: int = 0,
    lens: LensDescription = LENS,
    stated_lens: LensDescription | None = None,
    exposures_s: tuple[float, ...] = _EXPOSURES_S,
    temperature_c: float = 40.0,
    gain_db: float = 0.0,
    patch: PatchDescription = PATCH,
    darks: bool = True,
) -> None:
    """Write a capture set of the scene, with dark frames of every exposure."""
    model = CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, lens)
    for name, parameters in (effects or {}).items():
        model = model.with_effect(make_effect(name, dict(parameters)))
    limits = replace(default_limits(), width=WIDTH, height=HEIGHT)
    with (
        SimulatedCamera(model, scene, seed=seed, limits=limits, temperature_c=temperature_c) as camera,
        CaptureSetWriter(folder, camera.description, stated_lens or camera.lens, scene.source, (patch,)) as writer,
    ):
        for exposure_s in exposures_s:
            camera.configure(CameraSettings(exposure_s, gain_db, 64.0))
            for frame in camera.capture():
                writer.add(frame)
        if darks:
            camera.set_shutter(closed=True)
            for exposure_s in sorted(set(exposures_s)):
                camera.configure(CameraSettings(exposure_s, gain_db, 64.0))
                for frame in camera.capture():
                    writer.add(frame)


def polarised(session: Path, seed: int, strength: float = 0.02, axis_deg: float = 30.0) -> None:
    """Take a camera that sees polarised light differently at four angles."""
    for angle in (0, 45, 90, 135):
        effect = {"polarisation": {"strength": strength, "axis_rad": math.radians(axis_deg - angle)}}
        capture(session / "polarisation" / str(angle), uniform(), effect, seed=seed + angle)


def bent(session: Path, seed: int, a2: float = 0.03) -> None:
    """Take a ladder of exposures with a camera that loses 3 % at full well."""
    exposures = tuple(float(t) for t in np.repeat(np.geomspace(0.002, 0.06, 8), 3))
    effects = {"response_nonlinearity": {"a2": a2, "a3": 0.0}}
    capture(session / "linearity" / "ladder", uniform(0.1), effects, seed=seed, exposures_s=exposures)


def warmed(session: Path, seed: int, per_kelvin: float = 0.001) -> None:
    """Take a camera at 30 and at 45 °C."""
    effect = {"quantum_efficiency_temperature": {"coefficient_per_K": per_kelvin}}
    for step, temperature_c in (("cool", 30.0), ("warm", 45.0)):
        capture(session / "temperature" / step, uniform(), effect, seed=seed, temperature_c=temperature_c)
        seed += 1


def ranged(session: Path, seed: int, error: float = 0.015) -> None:
    """Take a camera whose 12 dB are 1.5 % off."""
    effect = {"gain_step_error": {"gains_db": (0.0, 12.0), "errors_rel": (0.0, error)}}
    for step, gain_db in (("0dB", 0.0), ("12dB", 12.0)):
        capture(session / "range" / step, uniform(0.4), effect, seed=seed, gain_db=gain_db, exposures_s=(0.002,) * 4)
        seed += 1


def refocused(session: Path, seed: int, magnification: float = 0.02) -> None:
    """Take a lens that was focused nearer without a word."""
    capture(session / "focus" / "far", uniform(), seed=seed)
    near = LENS.model_copy(update={"magnification": magnification})
    capture(session / "focus" / "near", uniform(), seed=seed + 1, lens=near, stated_lens=LENS)


def veiled(session: Path, seed: int, share: float = 0.012) -> None:
    """Take white, then a black patch that fills the patch and a little more, through a lens with glare."""
    effect = {"veiling_glare": {"share": share}}
    field = np.ones((HEIGHT, WIDTH))
    capture(session / "glare" / "white", uniform(), effect, seed=seed)
    field[55:105, 75:125] = 0.0
    scene = picture(session / "scenes" / "black", field)
    long = (0.004, 0.03, 0.06, 0.06, 0.06)
    capture(session / "glare" / "black", scene, effect, seed=seed + 1, exposures_s=long)


def sized(session: Path, seed: int, share: float = 0.02) -> None:
    """Take round sources of three sizes through a lens with glare."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    away = np.hypot(rows - 79.5, columns - 99.5)
    for diameter in (60, 100, 150):
        scene = picture(session / "scenes" / str(diameter), (away < diameter / 2).astype(float))
        effect = {"veiling_glare": {"share": share}}
        capture(session / "size" / str(diameter), scene, effect, seed=seed + diameter)


def uneven(session: Path, seed: int, step: float = 0.04) -> None:
    """Take an even source with a camera whose last tenth of columns is 4 % less sensitive."""
    field = np.ones((HEIGHT, WIDTH))
    field[:, 180:] -= step
    scene = picture(session / "scenes" / "even", field)
    capture(session / "uniformity" / "even", scene, seed=seed)


def edged(session: Path, seed: int, sigma_px: float = 1.5) -> None:
    """Take a slanted edge through a lens that blurs as a Gaussian."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    slant = math.radians(5.0)
    away = (columns - 99.7) * math.cos(slant) + (rows - 79.5) * math.sin(slant)
    scene = picture(session / "scenes" / "edge", 0.02 + 0.98 * ndtr(away / sigma_px))
    capture(session / "edge" / "edge", scene, seed=seed)


def smeared(session: Path, seed: int, share: float = 2e-4) -> None:
    """Take a small bright source whose columns carry some of its light."""
    field = np.zeros((HEIGHT, WIDTH))
    field[70:90, 90:110] = 1.0
    field[:, 90:110] += share * 20.0 / (0.1 * HEIGHT)
    scene = picture(session / "scenes" / "smear", field)
    exposures = (0.004, 0.004, 0.06, 0.25, 1.0, 1.0, 1.0)
    capture(session / "smear" / "source", scene, seed=seed, exposures_s=exposures)


def rippled(session: Path, seed: int) -> None:
    """Take a steady source and one rippled by 30 % whose exposures are whole periods of it."""
    capture(session / "modulation" / "steady", uniform(), seed=seed, exposures_s=(0.005,) * 6)
    effect = {"mains_ripple": {"modulation": 0.3, "frequency_hz": 100.0}}
    capture(session / "modulation" / "100Hz", uniform(), effect, seed=seed + 1, exposures_s=(0.005,) * 12)


def tones(sigma_px: float) -> float:
    """Return the 10 to 90 % distance of a Gaussian edge."""
    return 2.0 * 1.2815515655446004 * sigma_px


# Procedure, what makes its session, the index that is true of it, and how well it must be known (u over the index).
PLANTED: tuple[tuple[str, Callable[[Path, int], None], float, float], ...] = (
    ("polarisation", polarised, 0.02, 0.02),
    ("temperature", warmed, 0.01, 0.05),
    ("range", ranged, 0.015, 0.05),
    ("focus", refocused, 1.0 - 1.0 / 1.02**2, 0.02),
    ("uniformity", uneven, 0.04, 0.05),
    ("edge", edged, tones(1.5), 0.02),
    ("smear", smeared, 2e-4, 0.01),
)

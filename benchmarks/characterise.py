"""Characterisation: coverage of its intervals on the simulated camera, a real CCD with the `emva1288` package, times.

    python -m benchmarks characterise

The part with the real CCD needs ../shared/data and is left out where that is absent.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks._sections import write_section
from radiometer.analysis.characterise import Subject, characterise, read_subject
from radiometer.analysis.characterise.group_statistics import GroupStatistics, statistics_of_group
from radiometer.analysis.characterise.photon_transfer import photon_transfer
from radiometer.analysis.characterise.steps import make_steps
from radiometer.data import CameraDescription, FrameSettings, LensDescription, Quantity
from radiometer.devices import CameraPreset
from simulators.chain.camera_model import CameraModel, VirtualSensor
from simulators.effects.context import FrameGeometry
from simulators.scenes import UniformScene

CCD = Path(__file__).resolve().parents[2] / "shared" / "data" / "emva" / "ref001_ccd_12bit"
DRAWS, PIXELS = 300, 640 * 480
WELL_DN, GAIN_DN_PER_E, DARK_DN2 = 4000.0, 0.25, 4.0
BENDS = np.linspace(0.0, 0.06, 25)
SEEDS = range(1000, 1050)  # none of those that the tests use
WIDTH, HEIGHT, RADIANCE = 100, 80, 0.00115
PHOTONS_PER_S = math.pi * RADIANCE / 64 * (4.5e-6) ** 2 / (6.62607015e-34 * 299_792_458.0 / 550e-9)
CAMERA = CameraDescription(
    bit_depth=12,
    pixel_pitch_um=4.5,
    conversion_gain_e_per_dn=5.95,
    read_noise_e=5.4,
    full_well_e=24_500,
    dark_current_e_per_s=20.0,
    dark_current_reference_C=25,
    dark_current_doubling_K=7.0,
    black_level_dn=64,
    quantum_efficiency=0.62,
)
MODEL = CameraModel.ideal(CAMERA, LensDescription(f_number=4.0))

# Of the package 1.0.2 on the same images, from the provenance note of the data.
PACKAGE = {
    "K": 0.28035,
    "eta": 45.22,
    "R": 0.126778,
    "sigma_d": 10.913,
    "mu_e_sat": 13_999.0,
    "mu_p_sat": 30_957.0,
    "SNR_max": 118.3,
    "DR_dB": 61.74,
    "LE_min": -0.605,
    "LE_max": 0.455,
    "mu_I_mean": 29.2,
    "mu_I_var": 81.0,
    "PRNU_1288": 0.430,
    "DSNU_1288": 0.240,
}


@dataclass(frozen=True)
class Simulated(Subject):
    ready: tuple[GroupStatistics, ...] = ()

    def statistics(self) -> list[GroupStatistics]:
        return list(self.ready)


def simulated(seed: int) -> Simulated:
    sensor = VirtualSensor(MODEL, UniformScene(radiance_W_per_sr_m2=RADIANCE), WIDTH, HEIGHT, seed=seed)
    times = np.linspace(0.5, 15.0, 30)
    plan = [(t, "open", 2, 25.0) for t in times]
    plan += [(t, "closed", 2, temperature) for t in times for temperature in (25.0, 39.0)]
    plan += [(7.5001, "open", 8, 25.0), (7.5001, "closed", 8, 25.0)]
    found: list[GroupStatistics] = []
    for t, shutter, count, temperature in plan:
        settings = FrameSettings(float(t), 0.0, 4.0, 64.0, temperature, shutter=shutter)
        frames = [sensor.expose(settings) for _ in range(count)]
        photons = PHOTONS_PER_S * t if shutter == "open" else 0.0
        found += statistics_of_group(frames, settings, (None,), 4095, photons)
    return Simulated("simulated", CAMERA, LensDescription(), (), (None,), (None,), ready=tuple(found))


def truth() -> dict[str, float]:
    """Return the true figures; saturation is where the predicted variance is largest."""
    K, dark = 1 / 5.95, (5.4 / 5.95) ** 2 + 1 / 12
    scene, geometry, times = np.full((1, 1), RADIANCE), FrameGeometry.of_image(1, 1), np.linspace(9.0, 15.0, 2000)
    variances = [
        MODEL.moments(scene, MODEL.context(FrameSettings(float(t), 0.0, 4.0, 64.0, 25.0), geometry)).variance[0, 0]
        for t in times
    ]
    saturation = 0.62 * PHOTONS_PER_S * times[int(np.argmax(variances))]
    threshold = math.sqrt(dark) / K + 0.5
    return {
        "K": K, "eta": 62.0, "R": 0.62 * K, "sigma_d": 5.4, "sigma_y_dark": math.sqrt(dark), "mu_y_dark": 64.0,
        "mu_I_mean": 20.0, "mu_I_var": 20.0, "T_d": 7.0, "mu_e_min": threshold, "mu_p_min": threshold / 0.62,
        "mu_e_sat": saturation, "mu_p_sat": saturation / 0.62, "mu_e_plateau": 4031 * 5.95,
        "SNR_max": math.sqrt(saturation), "DR": saturation / threshold,
        "LE_min": 0.0, "LE_max": 0.0, "DSNU_1288": 0.0, "PRNU_1288": 0.0,
    }  # fmt: skip


def coverage() -> str:
    true = truth()
    runs = [characterise(simulated(seed)).figures for seed in SEEDS]
    rows = []
    for name, value in true.items():
        z = np.array([(run[name].value - value) / run[name].u for run in runs])
        u = float(np.mean([run[name].u for run in runs]))
        unit = runs[0][name].unit.replace("1", "")
        held = 100 * np.mean(np.abs(z) <= 2)
        rows.append(f"| {name} | {value:.5g} {unit} | {2 * u:.2g} | {held:.0f} % | {z.mean():+.2f} | {z.std():.2f} |")
    return (
        f"The simulated camera, {len(SEEDS)} seeds that no test uses; z is the error over its standard uncertainty. "
        "Saturation and linearity cover more: their uncertainty holds the spacing of the steps and the extreme of "
        "noise.\n\n"
        "| figure | truth | U (k = 2) | held by k = 2 | mean z | sd z |\n|---|---|---|---|---|---|\n" + "\n".join(rows)
    )


def ccd() -> str:
    if not CCD.is_dir():
        return "The real CCD was not on this machine."
    begun = time.perf_counter()
    figures = characterise(read_subject(CCD)).figures
    took = time.perf_counter() - begun
    rows = [
        f"| {name} | {figures[name].value:.5g} ± {2 * figures[name].u:.2g} {unit_of(figures[name])} | {theirs:g} "
        f"| {100 * (figures[name].value / theirs - 1):+.2f} % |"
        for name, theirs in PACKAGE.items()
    ]
    return (
        "The real CCD `ref001` (12 bit), next to the package `emva1288` 1.0.2 on the same images.\n\n"
        "| figure | here (k = 2) | package | difference |\n|---|---|---|---|\n" + "\n".join(rows) + "\n\n"
        f"108 images of 640 × 480 pixels in {took:.2f} s. The package weighs all points alike, this program "
        "by their noise. Dark current and DSNU are poorly determined by these short frames."
    )


def bend_found(count: int, bend: float, rng: np.random.Generator) -> float:
    """Return how often a bend of the photon transfer is reported.

    Args:
        count: Exposures, evenly spaced up to 70 % of saturation.
        bend: Share by which the local gain falls from the origin to the highest of them.
    """
    signals = np.linspace(0.7 / count, 0.7, count) * WELL_DN
    open_, closed = FrameSettings(1.0), FrameSettings(1.0, shutter="closed")
    found = 0
    for _ in range(DRAWS):
        variances = DARK_DN2 + GAIN_DN_PER_E * (1.0 - bend * signals / (0.7 * WELL_DN)) * signals
        seen = variances * rng.chisquare(PIXELS - 1, count) / (PIXELS - 1)
        dark = GroupStatistics(closed, 2, PIXELS, 100.0, DARK_DN2 * rng.chisquare(PIXELS - 1) / (PIXELS - 1), 0.0, 0.0)
        bright = [
            GroupStatistics(open_, 2, PIXELS, 100.0 + s, v, 0.0, 0.0, s) for s, v in zip(signals, seen, strict=True)
        ]
        found += photon_transfer(make_steps(bright, [dark]), WELL_DN).bend_u > 0
    return found / DRAWS


def bend_power() -> str:
    """Return the table of bends that the test finds in half and in 95 % of the cases."""
    rows = []
    for count in (5, 9, 20, 50):
        rng = np.random.default_rng(count)
        shares = [bend_found(count, bend, rng) for bend in BENDS]
        half, sure = (float(np.interp(share, np.maximum.accumulate(shares), BENDS)) for share in (0.5, 0.95))
        rows.append(f"| {count} | {100 * shares[0]:.1f} % | {100 * half:.2g} % | {100 * sure:.2g} % |")
    return (
        f"The test for a bent photon transfer, {DRAWS} draws for each of {len(BENDS)} bends: pairs of 640 × 480 pixels "
        "at exposures evenly spaced up to 70 % of saturation. The local gain falls in proportion to the signal; the "
        "bend is its fall over that range. The bend that is found falls with the root of the number of pixels.\n\n"
        "| exposures | false alarms | found in half of the cases | found in 95 % |\n|---|---|---|---|\n"
        + "\n".join(rows)
    )


def unit_of(quantity: Quantity) -> str:
    return "" if quantity.unit == "1" else quantity.unit


def frame_time() -> str:
    preset = CameraPreset.shipped("BFS-U3-19S4M")
    model = CameraModel.ideal(preset.camera, LensDescription(focal_length_mm=16, f_number=4.0, vignetting="cos4"))
    geometry = FrameGeometry.of_image(1616, 1240)
    context = model.context(FrameSettings(0.01, f_number=4.0), geometry)
    scene = np.linspace(0.0, 1.0, 1616 * 1240, dtype=np.float32).reshape(geometry.shape)
    times = []
    for frame in range(9):
        begun = time.process_time()
        model.sample(scene, context, (frame,))
        times.append(time.process_time() - begun)
    typical_ms = 1e3 * float(np.median(times))
    return f"One simulated frame of 1616 × 1240 pixels, exact Poisson noise: {typical_ms:.0f} ms of one core."


def main() -> None:
    body = "\n\n".join((ccd(), bend_power(), coverage(), frame_time()))
    print(body)
    write_section("characterise", "Characterisation", "python -m benchmarks characterise", body)


if __name__ == "__main__":
    main()

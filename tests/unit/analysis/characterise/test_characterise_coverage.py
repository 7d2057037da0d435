"""Characterising the simulated camera over many seeds: the stated uncertainties are true."""

from dataclasses import dataclass

import numpy as np
import pytest

from radiometer.analysis.characterise import Subject, characterise
from radiometer.analysis.characterise.group_statistics import GroupStatistics, statistics_of_group
from radiometer.data import CameraDescription, FrameSettings, LensDescription
from simulators.chain.camera_model import CameraModel
from simulators.chain.virtual_sensor import VirtualSensor
from simulators.effects.context import FrameGeometry
from simulators.scenes import UniformScene

SEEDS = 50
RADIANCE = 0.00115
PHOTONS_PER_S = np.pi * RADIANCE / (4 * 4.0**2) * (4.5e-6) ** 2 / (6.62607015e-34 * 299_792_458.0 / 550e-9)
WIDTH, HEIGHT = 100, 80
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


@dataclass(frozen=True)
class InMemory(Subject):
    """A subject whose frames never touch the disk."""

    ready: tuple[GroupStatistics, ...] = ()

    def statistics(self) -> list[GroupStatistics]:
        return list(self.ready)


def _simulated(model: CameraModel, seed: int) -> InMemory:
    scene = UniformScene(radiance_W_per_sr_m2=RADIANCE)
    sensor = VirtualSensor(model, scene, WIDTH, HEIGHT, seed=seed, device_seed=seed)
    times = np.linspace(0.5, 15.0, 30)
    plan = [(t, "open", 2, 25.0) for t in times]
    plan += [(t, "closed", 2, temperature) for t in times for temperature in (25.0, 39.0)]
    plan += [(7.5001, "open", 8, 25.0), (7.5001, "closed", 8, 25.0)]
    found: list[GroupStatistics] = []
    for t, shutter, count, temperature in plan:
        settings = FrameSettings(float(t), 0.0, 4.0, 64.0, temperature, shutter=shutter)  # type: ignore[arg-type]
        frames = [sensor.expose(settings) for _ in range(count)]
        photons = PHOTONS_PER_S * t if shutter == "open" else 0.0
        found += statistics_of_group(frames, settings, (None,), 4095, photons)
    return InMemory("simulated", CAMERA, LensDescription(), (), (None,), (None,), ready=tuple(found))


def _truth(model: CameraModel) -> dict[str, float]:
    """Return what the figures ought to be; the saturation point is that of the largest predicted variance."""
    K, dark_variance = 1 / 5.95, (5.4 / 5.95) ** 2 + 1 / 12
    scene, geometry = np.full((1, 1), RADIANCE), FrameGeometry.of_image(1, 1)
    times = np.linspace(9.0, 15.0, 2000)
    contexts = [model.context(FrameSettings(float(t), 0.0, 4.0, 64.0, 25.0), geometry) for t in times]
    top = int(np.argmax([model.moments(scene, context).variance[0, 0] for context in contexts]))
    saturation_e = 0.62 * PHOTONS_PER_S * times[top]
    threshold_e = np.sqrt(dark_variance) / K + 0.5
    return {
        "K": K,
        "mu_y_dark": 64.0,
        "R": 0.62 * K,
        "eta": 62.0,
        "sigma_y_dark": np.sqrt(dark_variance),
        "sigma_d": 5.4,
        "mu_e_min": threshold_e,
        "mu_p_min": threshold_e / 0.62,
        "mu_e_sat": saturation_e,
        "mu_p_sat": saturation_e / 0.62,
        "mu_e_plateau": 4031 * 5.95,
        "SNR_max": np.sqrt(saturation_e),
        "SNR_max_dB": 10 * np.log10(saturation_e),
        "DR": saturation_e / threshold_e,
        "DR_dB": 20 * np.log10(saturation_e / threshold_e),
        "mu_I_mean": 20.0,
        "mu_I_var": 20.0,
        "T_d": 7.0,
        "mu_I_typical": 20.0,
        **dict.fromkeys(("DSNU_1288", "DSNU_row", "DSNU_column", "DSNU_pixel"), 0.0),
        **dict.fromkeys(("PRNU_1288", "PRNU_row", "PRNU_column", "PRNU_pixel"), 0.0),
        "LE_min": 0.0,
        "LE_max": 0.0,
    }


@pytest.mark.long
def test_intervals_of_every_figure_hold_the_truth() -> None:
    """In 50 runs the k = 2 interval of each of 29 figures holds the truth in at least 89 % (95 − 6 %)."""
    model = CameraModel.ideal(CAMERA, LensDescription(f_number=4.0))
    truth, runs = _truth(model), [characterise(_simulated(model, seed)).figures for seed in range(SEEDS)]
    assert all(set(figures) == set(truth) for figures in runs)
    held = {n: np.mean([abs(run[n].value - true) <= 2 * run[n].u for run in runs]) for n, true in truth.items()}
    assert {name: share for name, share in held.items() if share < 0.89} == {}


def test_uncertainty_of_the_gain_is_worth_having() -> None:
    """60 frames of 8000 pixels give K to better than 0.5 %: the intervals are not merely wide."""
    figures = characterise(_simulated(CameraModel.ideal(CAMERA, LensDescription(f_number=4.0)), 1)).figures
    assert figures["K"].u_rel < 0.005
    assert figures["eta"].u_rel < 0.005
    assert figures["sigma_d"].u_rel < 0.02

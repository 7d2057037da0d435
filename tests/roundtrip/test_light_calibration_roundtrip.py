"""A light box calibrated by the camera gives the radiance that it is asked for."""

import math

import numpy as np
import pytest

from radiometer.bench.boxes import open_light_box
from radiometer.bench.light_bench import SurveyRequest, open_light_camera, survey_box
from radiometer.data.light_calibration import LightCalibration
from radiometer.devices import Radiance
from radiometer.errors import SettingOutOfRange

SETTLED_S = 400.0


@pytest.fixture(scope="module")
def calibration() -> LightCalibration:
    """Calibrate the simulated box's test spots with the simulated camera, whose quantum efficiency is flat."""
    with open_light_box("sim") as opened, open_light_camera(opened, None, None, None, None) as camera:
        return survey_box(opened, camera, SurveyRequest(("spot", "spot_red"), seed=1, spectral_u_rel=0.01))


@pytest.mark.parametrize("channel", ["spot", "spot_red"])
def test_set_radiance_is_true_within_the_stated_uncertainty_over_five_decades(calibration, channel):
    """Sixteen radiances, one in each part of the whole range: the twin emits the stated radiance within k = 2."""
    low, high = calibration.limits(channel)
    assert math.log10(high / low) > 5.0
    rng = np.random.default_rng(2)
    errors = []
    with open_light_box("sim") as opened:
        opened.box.calibration = calibration
        parts = (np.arange(16) + rng.uniform(size=16)) / 16
        for expected in low * (high / low) ** parts:
            choice = calibration.choose(channel, float(expected))
            opened.box.set_level(channel, Radiance(float(expected)))
            opened.wait(SETTLED_S)
            true = opened.twin.emission(channel, opened.twin.time_s).radiance_w_sr_m2
            errors.append((choice.radiance_w_sr_m2 - true) / choice.u_w_sr_m2)
            assert choice.radiance_w_sr_m2 / expected == pytest.approx(1.0, abs=0.04)  # half a step of 16
    assert np.max(np.abs(errors)) <= 2.0
    assert np.mean(np.abs(errors) <= 1.0) > 0.6


def test_ranges_meet_and_the_file_holds_everything(calibration, tmp_path):
    """Within their own uncertainties; read again it chooses the same levels and extrapolates none."""
    for channel in ("spot", "spot_red"):
        ranges = calibration.channels[channel].ranges
        radiance, u_low, _ = ranges["low"].at(8000)
        step_high = ranges["high"].nearest_step(radiance)
        other, u_high, _ = ranges["high"].at(step_high)
        assert abs(radiance / other - 1) < 2 * math.hypot(u_low, u_high) + 0.5 / step_high
    top = max(calibration.channels["spot"].points, key=lambda point: point.radiance_W_per_sr_m2)
    assert top.start_rel == pytest.approx(1 / (1 - 0.002 * 30 * 60000 / 65536), abs=0.01)
    calibration.write(tmp_path / "box.yaml")
    again = LightCalibration.read(tmp_path / "box.yaml")
    for radiance in (2e-5, 1e-3, 0.3):
        assert again.choose("spot", radiance) == calibration.choose("spot", radiance)
    for radiance in (1e-6, 5.0, -1.0, math.nan):
        with pytest.raises(SettingOutOfRange, match="allowed is"):
            calibration.choose("spot", radiance)

"""Simulated displays: the truth is what is asked for, and a calibration of each finds it."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.bench.screen import SIMULATED_DISPLAYS, lights, open_screen_bench
from radiometer.devices import Display, DisplayPatch
from radiometer.errors import DeviceError, SettingOutOfRange
from radiometer.screen import ScreenCalibration
from radiometer.screen.calibration_run import Options, calibrate_screen
from radiometer.screen.plan import parse_levels
from simulators.clock import SimulatedClock
from simulators.displays import DISPLAYS, SimulatedDisplay

# A display that flickers is read again and again, which takes five seconds.
FLICKERS = "pwm_lcd"


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.slow] * (name == FLICKERS)) for name in SIMULATED_DISPLAYS],
)
def calibrated(request: pytest.FixtureRequest) -> tuple[str, ScreenCalibration]:
    """Return a simulated display's name and its calibration by the simulated camera."""
    name = request.param
    options = Options(name, parse_levels("33"), seed=4)
    with open_screen_bench(name, seed=9) as bench:
        return name, calibrate_screen(bench, options, lights(primaries="crt"))


def _grey(name: str, level: float) -> float:
    drive = level / 255
    return SimulatedDisplay(DISPLAYS[name]).radiance((drive, drive, drive))


@pytest.mark.slow
def test_inverse_meets_fifty_targets_within_its_stated_uncertainty(calibrated: tuple[str, ScreenCalibration]) -> None:
    """At 50 random luminances the level found shows what is claimed: |z| ≤ 2 in 95 % within binomial chance (≥ 43)."""
    name, calibration = calibrated
    curve = calibration.channel()
    rng = np.random.default_rng(11)
    low, high = (float(curve.table.values[i]) for i in (0, -1))
    targets = (np.sqrt(low) + (np.sqrt(high) - np.sqrt(low)) * rng.random(50)) ** 2
    z = []
    for target in targets:
        level = curve.level_for(float(target))
        claimed = curve.radiance_at(level)
        z.append((_grey(name, level) - claimed.value) / claimed.u)
    assert np.sum(np.abs(z) <= 2) >= 43
    assert np.abs(z).max() < 4


@pytest.mark.slow
def test_shape_is_right_without_the_scale(calibrated: tuple[str, ScreenCalibration]) -> None:
    """Ratios to white, where the common scale falls out, are right within what the levels' own u allows (|z| < 4.5)."""
    name, calibration = calibrated
    curve = calibration.channel()
    truth = np.array([_grey(name, n) for n in range(256)])
    claimed = np.array([curve.radiance_at(n).value for n in range(256)])
    u = np.array([curve.u_shape_at(n) for n in range(256)])
    scale = np.sum(truth * claimed / u**2) / np.sum(truth**2 / u**2)
    z = (claimed - scale * truth) / u
    assert np.abs(z).max() < 4.5
    assert np.mean(np.abs(z) <= 2) > 0.85


@pytest.mark.slow
def test_black_is_seen_or_becomes_a_limit(calibrated: tuple[str, ScreenCalibration]) -> None:
    """An OLED's true black is given as a limit of detection; the LCD's 0.1 cd/m² is measured."""
    name, calibration = calibrated
    curve = calibration.channel()
    if name == "oled":
        assert curve.radiance_is_lost(0)
        assert 0 < curve.detection_limit * 320 < 0.01
    elif name == "lcd":
        assert not curve.radiance_is_lost(0)
        assert curve.radiance_at(0).value == pytest.approx(0.1 / 340, rel=0.05)


@pytest.mark.slow
def test_flicker_is_found_where_it_is(calibrated: tuple[str, ScreenCalibration]) -> None:
    """The dimmed backlight is found to flicker, the steady ones are not; readings are averaged accordingly."""
    name, calibration = calibrated
    assert calibration.checks["flicker"]["found"] is (name == FLICKERS)
    assert (calibration.checks["repeats"] > 1) is (name == FLICKERS)


@pytest.mark.slow
def test_plain_gamma_errs_where_black_shines(calibrated: tuple[str, ScreenCalibration]) -> None:
    """How badly a plain gamma would have erred is stated: over 10 % on the LCDs, under 1 % on the OLED."""
    name, calibration = calibrated
    error = calibration.channel().fits()["gamma"].rms_rel
    assert error < 0.01 if name == "oled" else error > 0.1


@pytest.mark.slow
def test_primaries_add_up_to_white() -> None:
    """With all channels measured the sum of the primaries is white within 0.5 %."""
    options = Options("lcd", parse_levels("quick"), ("grey", "red", "green", "blue"))
    with open_screen_bench("lcd", seed=3) as bench:
        calibration = calibrate_screen(bench, options, lights(primaries="crt"))
    assert set(calibration.channels) == {"grey", "red", "green", "blue"}
    assert calibration.checks["additivity_rel"] == pytest.approx(0, abs=0.005)


def test_simulated_display_is_a_display() -> None:
    """It fulfils the protocol, refuses what is out of range, and is off until opened."""
    display = SimulatedDisplay(DISPLAYS["lcd"])
    assert isinstance(display, Display)
    with pytest.raises(DeviceError, match="is off"):
        display.show(DisplayPatch((1, 1, 1)))
    with display, pytest.raises(SettingOutOfRange, match=r"drive 1\.2"):
        display.show(DisplayPatch((1.2, 0, 0)))


@pytest.mark.parametrize("name", DISPLAYS)
def test_each_primary_adds_its_share_of_the_light_above_black(name: str) -> None:
    """At half drive and seen from the side, light is black plus each primary's share of white's range."""
    display = SimulatedDisplay(DISPLAYS[name])
    display.turn(30.0)
    model, level = display.model, round(0.5 * (2**display.model.bits - 1)) / (2**display.model.bits - 1)
    cosine = np.cos(np.radians(30.0))
    black = model.black_radiance * (1.0 + model.angle_leak * (1.0 - cosine**2))
    of_white = (model.white_radiance - model.black_radiance) * cosine**model.angle_exponent * model.transfer(level)
    for primary, share in enumerate(model.primary_shares):
        only = tuple(0.5 * (primary == k) for k in range(3))
        assert display.radiance(only) == pytest.approx(black + share * of_white, rel=1e-9)
    assert display.radiance((0.5, 0.5, 0.5)) == pytest.approx(black + of_white, rel=1e-9)


def test_pwm_averages_out_over_whole_periods_only() -> None:
    """Over four periods the output is its mean; over a quarter of one it is all or nothing."""
    display = SimulatedDisplay(DISPLAYS["pwm_lcd"], SimulatedClock(1e6))
    display.open()
    warm = display.backlight(1e9, 4 / 240)
    assert warm == pytest.approx(1, rel=1e-4)
    inside = {round(display.backlight(2e6 + k / 2400, 0.02 / 240), 2) for k in range(10)}
    assert {0.0, 2.5} <= inside


def test_backlight_warms_up_with_its_time_constant() -> None:
    """After one time constant 1/e of the excess is left."""
    display = SimulatedDisplay(DISPLAYS["lcd"])
    display.open()
    assert display.backlight(600.0, 1e-3) == pytest.approx(1 + 0.03 / np.e, rel=1e-5)

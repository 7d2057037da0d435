"""Calibration of a screen: plan, models, table of levels, drift and checks."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.data import Quantity
from radiometer.devices import DisplayPatch
from radiometer.errors import CalibrationError, MeasurementError, SettingOutOfRange, UsageError
from radiometer.screen import ChannelCurve, ScreenCalibration
from radiometer.screen.calibration import LUMINANCE, RADIANCE, SCOTOPIC, LevelTable, rising
from radiometer.screen.calibration_run import Options, calibrate_screen
from radiometer.screen.checks import Uniformity, additivity, judge_flicker, wait_until_steady
from radiometer.screen.meter import ScreenReading
from radiometer.screen.plan import ScreenStep, make_plan, parse_levels
from radiometer.screen.run import Drift, Light, Measured, curves_of, measure_steps
from radiometer.screen.transfer_models import MODELS, fit_transfer
from radiometer.screen.verification import VerifiedLevel


def _reading(value: float, time_s: float = 0.0, u: float = 1e-4) -> ScreenReading:
    return ScreenReading(value, u, 0.01, time_s)


class _Warming:
    """White that settles with 100 s."""

    def __init__(self, excess: float) -> None:
        self.excess, self.now = excess, 0.0

    def read(self) -> ScreenReading:
        return _reading(1 + self.excess * float(np.exp(-self.now / 100)), self.now)

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def test_linear_drift_is_taken_out_to_rounding() -> None:
    """A level measured while the lamp fades linearly comes out as at its mean output."""
    whites = [Measured(ScreenStep("grey", 255, "white"), (_reading(1 - 0.001 * t, t),)) for t in (0.0, 10.0, 20.0)]
    levels = [
        Measured(ScreenStep("grey", n), (_reading(n / 255 * (1 - 0.001 * t), t),))
        for n, t in ((0, 2), (128, 7), (255, 15))
    ]
    curves, drift = curves_of([*whites, *levels], {"grey": Light(320, 700, "x")})
    assert curves["grey"].radiance == pytest.approx((0.0, 128 / 255 * 0.99, 0.99), rel=1e-12)
    assert drift.range_rel == pytest.approx(0.02 / 0.99)


def test_scatter_of_references_is_the_drifts_uncertainty() -> None:
    """White that scatters by 0.5 % gives levels between references √0.5 times that, within 4 sigmas of its estimate."""
    rng = np.random.default_rng(3)
    whites = [_reading(1 + 0.005 * rng.standard_normal(), 10.0 * t, u=0.0) for t in range(400)]
    expected, sigma = 0.005 * np.sqrt(0.5), 0.005 * np.sqrt(0.5) / np.sqrt(2 * 400 / 2)
    assert Drift.of(whites).u_rel == pytest.approx(expected, abs=4 * sigma)


def test_warm_up_waits_until_steady() -> None:
    """A lamp 5 % too bright is watched until its change over five readings is below 0.2 %."""
    lamp = _Warming(0.05)
    seen = wait_until_steady(lamp, lamp.sleep, limit_s=1000)
    assert seen.steady
    assert seen.drift_rel <= 0.002
    assert 0.05 * np.exp(-(lamp.now - 240) / 100) <= 0.0022


def test_warm_up_gives_up_in_time_and_says_so() -> None:
    """A lamp that never settles within the limit is reported as drifting."""
    lamp = _Warming(2.0)
    seen = wait_until_steady(lamp, lamp.sleep, limit_s=120)
    assert not seen.steady
    assert seen.waited_s == pytest.approx(120)


@pytest.mark.parametrize(("scatter", "found"), [(0.001, False), (0.01, True)])
def test_flicker_is_scatter_beyond_noise(scatter: float, found: bool) -> None:
    """Noise of 0.1 % is no flicker; ten times that is."""
    rng = np.random.default_rng(5)
    assert judge_flicker((1 + scatter * rng.standard_normal(16)).tolist(), 0.001, 1e-3).found is found


def test_false_alarms_of_the_flicker_check_are_rare() -> None:
    """Of 2000 steady lights with 0.1 % noise fewer than 0.5 % are called flickering."""
    rng = np.random.default_rng(6)
    alarms = sum(judge_flicker((1 + 0.001 * rng.standard_normal(16)).tolist(), 0.001, 1e-3).found for _ in range(2000))
    assert alarms < 10


def test_uniformity_is_relative_to_the_middle() -> None:
    """Corners at 90 % show as such."""
    seen = Uniformity.of([[0.9, 1.8, 0.9], [1.9, 2.0, 1.9], [1.8, 2.1, 1.8]])
    assert (seen.lowest, seen.highest) == (0.45, 1.05)


def test_additivity_takes_the_black_out() -> None:
    """Three primaries each with the black in it add up to white when two blacks are taken away."""
    assert additivity({"grey": 1.0, "red": 0.31, "green": 0.41, "blue": 0.3}, 0.01) == pytest.approx(0.0)
    assert additivity({"grey": 1.0}, 0.0) is None


def test_black_that_is_not_seen_becomes_a_limit() -> None:
    """Black readings around zero give a detection limit of three standard uncertainties of their mean."""
    whites = [Measured(ScreenStep("grey", 255, "white"), (_reading(1.0, t),)) for t in (0.0, 10.0)]
    blacks = [Measured(ScreenStep("grey", 0, "black"), (_reading(v, 1.0, u=1e-3),)) for v in (1e-4, -1e-4)]
    levels = [Measured(ScreenStep("grey", n), (_reading(n / 255, 2.0, u=1e-3),)) for n in (0, 128, 255)]
    curve = curves_of([*whites, *blacks, *levels], {"grey": Light(320, 700, "x")})[0]["grey"]
    assert curve.detection_limit == pytest.approx(3 * 1e-3 / np.sqrt(3))
    assert curve.radiance_is_lost(0)
    assert not curve.radiance_is_lost(128)


def test_without_references_there_is_no_curve() -> None:
    """The drift must be known."""
    with pytest.raises(MeasurementError, match="white references"):
        curves_of([Measured(ScreenStep("grey", 0), (_reading(0.0),))], {})


def test_camera_that_looks_elsewhere_is_found_out_at_once() -> None:
    """White and black that read alike end the measurement after these two, with the way out."""
    shown: list[DisplayPatch] = []

    class Elsewhere:
        def show(self, patch: DisplayPatch) -> None:
            shown.append(patch)

        def read(self) -> ScreenReading:
            return _reading(0.3)

    looked, plan = Elsewhere(), make_plan((0, 128, 255), ("grey",), np.random.default_rng(1))
    with pytest.raises(MeasurementError, match="does not see the patches"):
        measure_steps(looked, looked, plan)  # type: ignore[arg-type]
    assert len(shown) == 2


def test_impossible_screen_is_refused_before_it_warms_up() -> None:
    """White that is no brighter than black ends the calibration without any wait."""
    waits: list[float] = []

    class Elsewhere:
        display = property(lambda self: self)
        sleep = property(lambda self: waits.append)

        def show(self, patch: DisplayPatch) -> None:
            """Show nothing that is seen."""

        def read(self) -> ScreenReading:
            return _reading(0.3)

    with pytest.raises(MeasurementError, match="does not see the patches"):
        calibrate_screen(Elsewhere(), Options("x", (0, 128, 255)), {})  # type: ignore[arg-type]
    assert waits == []


def test_value_at_a_measured_level_has_its_own_and_the_common_uncertainty(grey: ChannelCurve) -> None:
    """At white u is 0.1 % of the level and 1 % of the scale in quadrature."""
    white = grey.radiance_at(255)
    assert white.value == pytest.approx(0.7001)
    assert white.u_rel == pytest.approx(math.hypot(0.001, 0.01), rel=1e-6)


def test_interpolating_adds_uncertainty_between_levels_only(grey: ChannelCurve) -> None:
    """On a display that is linear the power-law table misses something in the lowest gap, and u there says so."""
    linear = dataclasses.replace(
        grey, radiance=tuple(0.7 * n / 255 for n in grey.levels), u_independent=(1e-6,) * len(grey.levels)
    )
    middle = linear.u_shape_at((linear.levels[0] + linear.levels[1]) / 2)
    assert middle > 100 * linear.u_shape_at(linear.levels[1]) == pytest.approx(1e-4)


@pytest.mark.parametrize("level", range(0, 256, 5))
def test_truth_between_levels_lies_within_twice_the_shape_uncertainty(grey: ChannelCurve, level: int) -> None:
    """The known curve is met at levels that were not measured, within k = 2 of what is claimed without the scale."""
    truth = 1e-4 + 0.7 * (level / 255) ** 2.2
    assert abs(grey.radiance_at(level).value - truth) <= 2 * grey.u_shape_at(level) + 1e-12


def test_units_differ_by_the_efficacies(grey: ChannelCurve) -> None:
    """Luminance and scotopic luminance are radiance times 320 and 700 lm/W."""
    radiance, luminance, scotopic = (grey.at(128, unit) for unit in (RADIANCE, LUMINANCE, SCOTOPIC))
    assert luminance.value == pytest.approx(320 * radiance.value)
    assert scotopic.value == pytest.approx(700 * radiance.value)
    assert luminance.u_rel == pytest.approx(radiance.u_rel)


def test_level_for_a_target_is_the_nearest(grey: ChannelCurve) -> None:
    """No neighbouring level comes nearer to 100 cd/m²."""
    level = grey.level_for(100.0, LUMINANCE)
    errors = [abs(grey.at(n, LUMINANCE).value - 100.0) for n in (level - 1, level, level + 1)]
    assert errors[1] == min(errors)


@pytest.mark.parametrize("target", [0.01, 500.0])
def test_targets_out_of_reach_are_refused_with_the_limits(grey: ChannelCurve, target: float) -> None:
    """The message gives what the screen can show."""
    with pytest.raises(SettingOutOfRange, match=r"allowed is 0\.032 to 224\.032 cd·m⁻²"):
        grey.level_for(target, LUMINANCE)


def test_unknown_unit_and_channel_are_named(screen: ScreenCalibration) -> None:
    """Both errors list what is known."""
    with pytest.raises(CalibrationError, match="channel 'red' was not measured; known: grey"):
        screen.channel("red")
    with pytest.raises(CalibrationError, match="unit 'lux'"):
        screen.channel().at(3, "lux")


def test_below_detection_the_uncertainty_covers_the_limit(grey: ChannelCurve) -> None:
    """A level under the detection limit is known to half that limit, not to its tiny stated u."""
    dim = dataclasses.replace(grey, detection_limit=1e-3)
    assert dim.radiance_is_lost(0)
    assert dim.radiance_at(0).u == pytest.approx(5e-4, rel=1e-3)


def test_file_reads_back(screen: ScreenCalibration, tmp_path: Path) -> None:
    """What was written is what is read."""
    screen.write(tmp_path / "s.yaml")
    back = ScreenCalibration.read(tmp_path / "s.yaml")
    assert back.channels == screen.channels
    assert (back.name, back.instrument, back.created) == ("desk", "22500001", screen.created)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("radiometer-screen/1", "other/1"), "format is 'other/1'"),
        (lambda t: t.replace("  grey:", "  gray:"), "holds no channel 'grey'"),
        (lambda t: t.replace("u_common_rel", "u_rel"), "key 'u_common_rel' is missing"),
    ],
)
def test_wrong_files_are_refused_with_the_reason(screen: ScreenCalibration, tmp_path: Path, change, message) -> None:
    """The error names file and key."""
    file = tmp_path / "s.yaml"
    screen.write(file)
    file.write_text(change(file.read_text()))
    with pytest.raises(CalibrationError, match=message):
        ScreenCalibration.read(file)


def test_two_levels_make_no_curve() -> None:
    """Fewer than three levels are refused."""
    with pytest.raises(CalibrationError, match="three levels or more"):
        ChannelCurve("grey", (0, 255), (0.0, 1.0), (0.1, 0.1), 0.0, 300, 700, "x")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("all", tuple(range(256))),
        ("quick", (0, 32, 64, 96, 128, 192, 255)),
        ("3", (0, 128, 255)),
        ("17,5", (0, 5, 17, 255)),
    ],
)
def test_levels_are_read(text: str, expected: tuple[int, ...]) -> None:
    """Every form of --levels gives ascending levels with black and white."""
    assert parse_levels(text) == expected


@pytest.mark.parametrize("text", ["2", "some", "-1,5", "5,300", "300", "0,0,0", "0,255"])
def test_senseless_levels_are_refused(text: str) -> None:
    """The message repeats the word and says what is allowed."""
    with pytest.raises(UsageError, match="--levels"):
        parse_levels(text)


def test_plan_holds_every_level_once_between_references() -> None:
    """Each level of each channel stands once; white and black begin, end and recur every ten."""
    plan = make_plan(tuple(range(0, 256, 15)), ("grey", "red"), np.random.default_rng(1))
    levels = [s for s in plan if s.purpose == "level"]
    assert len(set(levels)) == len(levels) == 36
    whites = [i for i, s in enumerate(plan) if s.purpose == "white"]
    assert whites[0] == 0
    assert whites[-1] == len(plan) - 2
    assert max(np.diff(whites)) <= 10 + 2


def test_order_is_random_but_follows_from_the_seed() -> None:
    """Two seeds differ, the same seed repeats, and levels do not simply rise."""
    one, again, other = (make_plan(parse_levels("33"), ("grey",), np.random.default_rng(s)) for s in (1, 1, 2))
    assert one == again != other
    levels = [s.level for s in one if s.purpose == "level"]
    assert levels != sorted(levels)


def test_unknown_channel_is_refused() -> None:
    """A typing error is named."""
    with pytest.raises(UsageError, match="channel 'gray' is unknown"):
        make_plan((0, 1, 2), ("gray",), np.random.default_rng(1))


def test_step_shows_its_primary_alone() -> None:
    """Level 51 of blue is a fifth of blue's drive and nothing else."""
    assert ScreenStep("blue", 51).patch().rgb == (0.0, 0.0, 0.2)


LEVELS = np.linspace(0, 1, 33)


@pytest.mark.parametrize(
    ("name", "truth"),
    [("gamma", (0.7, 2.3)), ("gamma_offset", (3e-4, 0.7, 2.1)), ("pelli_zhang1991", (2e-4, 0.05, 0.8, 2.4))],
)
def test_parameters_of_its_own_curve_come_back(name: str, truth: tuple[float, ...]) -> None:
    """Without noise the fit returns the parameters that made the curve."""
    values = MODELS[name].curve(np.array(truth), LEVELS)
    found = fit_transfer(name, LEVELS, values, np.full(33, 1e-7))
    assert tuple(found.parameters.values()) == pytest.approx(truth, rel=1e-4)
    assert found.max_rel < 1e-4


def test_too_few_levels_are_refused() -> None:
    """Four parameters need four levels; the message says so."""
    with pytest.raises(ValueError, match="at least 4 levels, not 3"):
        fit_transfer("pelli_zhang1991", [0, 0.5, 1], [0, 0.2, 1], [0.01, 0.01, 0.01])


def test_prediction_is_the_fitted_curve() -> None:
    """`predict` evaluates the model at any level."""
    found = fit_transfer("gamma", LEVELS, 2.0 * LEVELS**2.0, np.full(33, 1e-6))
    assert found.predict([0.5]) == pytest.approx([0.5], rel=1e-5)


def test_gamma_is_as_uncertain_as_noise_or_misfit_makes_it():
    """Of 200 noisy curves of γ = 2.2 the errors are as large as u says; a curve of no power law is less sure."""
    rng, light, pulls = np.random.default_rng(7), 100.0 * LEVELS**2.2, []
    u = 0.01 * light + 0.01
    for _ in range(200):
        found = fit_transfer("gamma", LEVELS, np.abs(light + rng.normal(0.0, u)), u)
        pulls.append((found.parameters["gamma"] - 2.2) / found.u_gamma)
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.15)  # 3 σ of 200 draws
    bent = fit_transfer("gamma", LEVELS, 100.0 * (0.8 * LEVELS**2.2 + 0.2 * LEVELS), 1e-6 * (1.0 + light))
    assert bent.u_gamma > 0.01


def test_table_goes_through_its_points() -> None:
    """Values at measured levels are the measured ones."""
    levels, values = np.array([0.0, 0.3, 0.6, 1.0]), np.array([0.1, 10.0, 60.0, 250.0])
    assert LevelTable(levels, values).at(levels) == pytest.approx(values, rel=1e-12)


def test_power_law_is_met_between_points() -> None:
    """A power law of 2.2 is a straight line to the table, so nothing is missed between 9 of its points."""
    levels = np.linspace(0, 1, 9)
    fine = np.linspace(0, 1, 101)
    assert LevelTable(levels, levels**2.2).at(fine) == pytest.approx(fine**2.2, rel=1e-9, abs=1e-12)


@given(st.lists(st.floats(0, 1000), min_size=3, max_size=20))
def test_values_never_fall_and_the_inverse_leads_back(numbers: list[float]) -> None:
    """Whatever is measured, more drive never gives less, and level_of reaches its target."""
    values = rising(numbers, np.ones(len(numbers)))
    table = LevelTable(np.linspace(0, 1, len(numbers)), values)
    fine = table.at(np.linspace(0, 1, 200))
    assert np.all(np.diff(fine) >= -1e-9 * max(values.max(), 1e-300))
    target = float(values[0] + 0.37 * (values[-1] - values[0]))
    assert float(table.at(table.level_of(target))) >= target * (1 - 1e-9)


def test_rising_weighs_by_uncertainty() -> None:
    """Of two values in the wrong order the better known one stays nearly where it is."""
    fitted = rising([1.0, 3.0, 2.0, 4.0], [0.1, 1.0, 0.01, 0.1])
    assert fitted[1] == fitted[2] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize(("shared_u_rel", "agrees"), [(0.0, True), (0.005, False)])
def test_what_both_readings_share_hides_no_dimming(shared_u_rel: float, agrees: bool) -> None:
    """A screen dimmed by 1.4 %, twice read by one camera to 0.2 % each: its scale, known to 0.5 %, drops out."""
    u = math.hypot(0.002, 0.005)
    level = VerifiedLevel("grey", 255, Quantity(1.0, u, "x"), Quantity(0.986, u * 0.986, "x"), shared_u_rel)
    assert level.agrees == agrees

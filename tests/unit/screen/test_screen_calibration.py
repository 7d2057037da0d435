"""Calibration of a screen: plan, transfer models, table of levels."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.errors import CalibrationError, SettingOutOfRange, UsageError
from radiometer.screen import ChannelCurve, ScreenCalibration
from radiometer.screen.calibration import LUMINANCE, RADIANCE, SCOTOPIC
from radiometer.screen.interpolation import LevelTable, rising
from radiometer.screen.plan import ScreenStep, make_plan, parse_levels
from radiometer.screen.transfer_models import MODELS, fit_transfer


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


@pytest.mark.parametrize("text", ["2", "some", "-1,5", "5,300", "300"])
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

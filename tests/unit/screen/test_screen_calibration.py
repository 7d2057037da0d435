"""The calibration: values with uncertainty at any level, levels for targets, files that read back."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest

from radiometer.errors import CalibrationError, SettingOutOfRange
from radiometer.screen import ChannelCurve, ScreenCalibration
from radiometer.screen.calibration import LUMINANCE, RADIANCE, SCOTOPIC


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

"""Interpolation between measured levels of a light box."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.data.light_calibration import ChannelCalibration, LightCalibration, LightPoint
from radiometer.errors import CalibrationError, SettingOutOfRange

STEPS = 8192


def point(step: int, radiance: float, current_range: str = "high", u_rel: float = 1e-4) -> LightPoint:
    """Return a measured level."""
    return LightPoint(
        current_range=current_range,
        level=min(step * 8, 65535),
        duty_step=step,
        radiance_W_per_sr_m2=radiance,
        u_rel=u_rel,
    )


def calibration(*points: LightPoint, common_u_rel: float = 0.0) -> LightCalibration:
    """Return a calibration of one channel."""
    channel = ChannelCalibration(duty_steps=STEPS, common_u_rel=common_u_rel, points=points)
    return LightCalibration("LB000001", {"spot": channel})


def test_proportional_channel_is_reproduced_at_every_step():
    """Where radiance goes as duty, any step between two points comes out exactly."""
    found = calibration(point(16, 16.0), point(256, 256.0), point(4096, 4096.0))
    for step in (16, 17, 100, 1000, 4095, 4096):
        choice = found.choose("spot", float(step))
        assert choice.radiance_w_sr_m2 == pytest.approx(step, rel=1e-9)
        assert (choice.level * STEPS + 32768) // 65536 == step


def test_smooth_departure_stays_within_the_stated_interpolation_error():
    """With a droop of 10 % every step lies within k = √3 (the half width) of its own stated error."""

    def radiance(step: float) -> float:
        return step * (1 - 0.1 * step / STEPS)

    steps = np.unique(np.round(np.geomspace(16, STEPS, 12)).astype(int))
    held = calibration(*(point(int(s), radiance(s), u_rel=0.0) for s in steps)).channels["spot"].ranges["high"]
    between = np.setdiff1d(np.unique(np.round(np.geomspace(16, STEPS, 200)).astype(int)), steps)
    ratios = [(held.at(int(s))[0] / radiance(s) - 1) / (math.sqrt(3) * held.at(int(s))[1]) for s in between]
    assert np.max(np.abs(ratios)) < 1.3  # the third derivative is not in the bound
    assert np.max(np.abs(ratios)) > 0.2  # and the bound is not idle


def test_common_uncertainty_is_in_every_level():
    """What all points share is not averaged away."""
    found = calibration(point(16, 16.0), point(4096, 4096.0), common_u_rel=0.01)
    choice = found.choose("spot", 300.0)
    assert choice.u_w_sr_m2 / choice.radiance_w_sr_m2 == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize(
    ("top", "channel", "message"), [(15.0, "spot", "must rise"), (32.0, "bleach", "light calibrate --channel bleach")]
)
def test_falling_radiance_and_an_uncalibrated_channel_are_refused(top, channel, message):
    """More duty with less light is a measurement that went wrong; a channel that was not measured says how to."""
    with pytest.raises(CalibrationError, match=message):
        calibration(point(16, 16.0), point(32, top)).choose(channel, 15.5)


def test_both_ranges_serve_and_the_nearer_step_wins():
    """Where the ranges overlap the finer one is taken."""
    found = calibration(
        point(16, 16.0), point(4096, 4096.0), point(16, 16 / 256, "low"), point(8192, 8192 / 256, "low")
    )
    choice = found.choose("spot", 20.4)
    assert choice.current_range == "low"
    assert choice.radiance_w_sr_m2 == pytest.approx(20.4, rel=2e-4)


def test_safety_bound_is_above_the_radiance():
    """The radiance for the safety check has its expanded uncertainty added; unmeasured levels have none."""
    found = calibration(point(16, 16.0), point(4096, 4096.0), common_u_rel=0.01)
    assert found.highest_radiance("spot", 8 * 100, True) == pytest.approx(102.0, rel=1e-3)
    assert found.highest_radiance("spot", 8 * 5000, True) is None
    assert found.highest_radiance("spot", 8 * 100, False) is None


@pytest.mark.parametrize("dip", range(1, 4))
def test_one_level_that_gives_no_more_light_than_the_one_below_is_refused(dip):
    """Wherever it lies: what falls or stays between two levels was not measured well."""
    for share in (1.0, 0.9):
        radiances = [16.0, 64.0, 256.0, 1024.0]
        radiances[dip] = share * radiances[dip - 1]
        points = [point(step, radiance) for step, radiance in zip((16, 64, 256, 1024), radiances, strict=True)]
        with pytest.raises(CalibrationError, match="must rise"):
            calibration(*points).choose("spot", 20.0)


def test_between_two_levels_their_doubts_and_the_bend_count():
    """f = ln(radiance/duty) = c·x²: midway its bend c·w²/4 stands as a rectangle next to the halves of both u."""
    c, w = 0.02, math.log(4.0)
    steps = [16, 64, 256, 1024, 4096]
    x = [math.log(step / STEPS) for step in steps]
    u_rel = [0.001, 0.001, 0.003, 0.004, 0.001]
    points = [
        point(step, step / STEPS * math.exp(c * one**2), u_rel=u) for step, one, u in zip(steps, x, u_rel, strict=True)
    ]
    for near in (300, 370, 512, 700):
        choice = calibration(*points).choose("spot", near / STEPS * math.exp(c * math.log(near / STEPS) ** 2))
        step = choice.level * STEPS / 65536
        assert step == pytest.approx(near, rel=0.02)
        share = math.log(step / 256) / w
        own = math.hypot((1 - share) * 0.003, share * 0.004)
        bend = c * w**2 * share * (1 - share) / math.sqrt(3)
        expected = math.hypot(own, bend)
        assert choice.u_w_sr_m2 / choice.radiance_w_sr_m2 == pytest.approx(expected, rel=1e-6)


def test_a_level_that_was_measured_twice_is_refused_by_its_step():
    """One pair among others is enough: which of the two holds no one knows."""
    points = [point(16, 16.0), point(64, 64.0), point(64, 65.0), point(256, 256.0)]
    with pytest.raises(CalibrationError, match="holds duty step 64 twice"):
        calibration(*points).choose("spot", 20.0)


@pytest.mark.parametrize("current", [(1 / 256, 1.0), (1.0, 1.0), (1.0, 1 / 256)], ids=["right", "alike", "swapped"])
@pytest.mark.parametrize("steps", [(16, 4096), (4097, 8192)], ids=["one duty", "apart"])
def test_a_file_whose_low_current_is_not_the_darker_one_is_refused(current, steps, tmp_path):
    """Where it is read, whether or not both ranges were measured at the same duty; the file and channel are named."""
    low, high = current
    points = [point(step, step * low, "low") for step in steps] + [point(step, step * high) for step in (16, 4096)]
    calibration(*points).write(tmp_path / "box.yaml")
    if low < high:
        assert LightCalibration.read(tmp_path / "box.yaml").limits("spot")[1] == 4096.0
    else:
        with pytest.raises(CalibrationError, match=r"box\.yaml: channel spot: .* current_range is swapped"):
            LightCalibration.read(tmp_path / "box.yaml")


def test_both_ends_of_what_was_measured_are_held_and_nothing_beyond():
    """16 and 4096 to a part in a thousand million; a hundredth beyond is refused with both limits."""
    found = calibration(point(16, 16.0), point(4096, 4096.0))
    assert [found.choose("spot", end).level for end in (16.0, 4096.0)] == [128, 32768]
    for beyond in (15.9, 4097.0, math.nan, math.inf):
        with pytest.raises(SettingOutOfRange, match=r"16 .* 4096"):
            found.choose("spot", beyond)
    assert found.limits("spot") == (16.0, 4096.0)


@pytest.mark.parametrize(("start_rel", "bound"), [(1.1, 110.0), (0.9, 100.0)])
def test_what_is_brighter_at_its_start_stays_below_that(start_rel, bound):
    """A start above the settled radiance counts, one below it does not make light safer."""
    points = [point(step, float(step), u_rel=0.0).model_copy(update={"start_rel": start_rel}) for step in (16, 4096)]
    assert calibration(*points).highest_radiance("spot", 800, True) == pytest.approx(bound)


@pytest.mark.parametrize(
    ("days", "stale"),
    [(-1.01, True), (-1.0, False), (0.0, False), (30.0, False), (30.001, True), (400.0, True)],
)
def test_a_calibration_is_stale_after_its_validity_and_not_before(days, stale):
    """Thirty days from when it was made, in whatever time zone one asks; one from the future is not valid either."""
    made = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
    found = replace(calibration(point(16, 16.0), point(4096, 4096.0)), created=made.isoformat(), validity_days=30.0)
    assert found.is_stale((made + dt.timedelta(days=days)).astimezone(dt.timezone(dt.timedelta(hours=9)))) is stale

"""Measuring a light box's levels: darkness off, drift out, and each doubt in the point's or the channel's u."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from radiometer.acquire.light_levels import LevelSurvey, Measured, SpectralCorrection, assemble, plan_levels
from radiometer.data import Contribution, Patch, Quantity, Reading
from radiometer.devices.light_box import ChannelCapabilities, ChannelMode, ChannelState, CurrentRange, DriveLevel
from radiometer.errors import MeasurementError

CHANNEL = ChannelCapabilities("spot", 460.0, 4096, 1000.0, {CurrentRange.LOW: 65535, CurrentRange.HIGH: 30000})
LEVEL = DriveLevel(20_000)


def reading(value, noise=0.0, shared=0.0, black=0.0, exposure_s=0.1):
    """Return a reading with a noise, a scale's and a dark level's relative contribution."""
    lines = (
        Contribution("noise", noise),
        Contribution("scale", shared, correlated=True),
        Contribution("dark and black level", black),
    )
    return Reading(Quantity(value, 0.0, ""), Patch(0, 0, 1, 1), "1", exposures_s=(exposure_s,), budget=lines)


def point(level, radiance, order, own=0.001, shared=0.01, settle_s=20.0):
    return Measured(DriveLevel(level), radiance, own, shared, 1.0, settle_s, order)


def test_the_lamp_s_drift_is_taken_out_by_the_reference():
    """Light that falls by 10 % over the run: a point midway loses the mean, one at the end is raised by its share."""
    references = [point(7500, r, o) for r, o in ((1.05, -0.5), (1.0, 1.5), (0.95, 3.5))]
    points = [point(15_000, 2.0, 1.5), point(30_000, 3.8, 3.5, shared=0.03, settle_s=60.0)]
    found = assemble(CHANNEL, points, references, SpectralCorrection(1.2, 0.04))
    assert [p.radiance_W_per_sr_m2 for p in found.points] == pytest.approx([2.0 * 1.2, 4.0 * 1.2])
    assert found.common_u_rel == pytest.approx(math.hypot(0.03, 0.04))
    assert found.settle_s == 60.0
    assert found.drift_u_rel == pytest.approx(0.0)
    uneven = [point(7500, r, o) for r, o in ((1.02, -0.5), (0.98, 1.5), (1.0, 3.5))]
    steps = np.diff([1.02, 0.98, 1.0])
    wandering = assemble(CHANNEL, points, uneven, SpectralCorrection())
    assert wandering.drift_u_rel == pytest.approx(np.std(steps) / math.sqrt(2))


@pytest.mark.parametrize(("level", "step"), [(39, 2), (40, 3), (32_774, 2048), (32_775, 2049), (65_535, 4096)])
def test_a_point_lies_on_the_duty_step_that_the_box_gives(level, step):
    """65535 is all of 4096 steps, so that 16 levels are a step; the half, 40 or 32775 of them, is rounded up."""
    found = assemble(CHANNEL, [point(level, 2.0, 0.0)] * 2, [point(7500, 1.0, 0.0)], SpectralCorrection())
    assert [one.duty_step for one in found.points] == [step, step]


def test_a_channel_of_one_level_is_refused():
    """Nothing can be interpolated from it."""
    lost = Measured(LEVEL, 0.1, math.inf, 0.0, 1.0, 0.0, 1.0)
    with pytest.raises(MeasurementError, match="1 of 2 levels stand out of the noise"):
        assemble(CHANNEL, [point(15_000, 2.0, 0.0), lost], [point(7500, 1.0, 0.0)], SpectralCorrection())


def test_levels_are_spread_evenly_in_the_logarithm_up_to_the_limit():
    """Each step once, the limit among them, neighbours within a quarter of a decade, in both currents."""
    levels = plan_levels(CHANNEL, 4.0)
    for current, top in ((CurrentRange.LOW, 65_535), (CurrentRange.HIGH, 30_000)):
        own = sorted(one.level for one in levels if one.current_range is current)
        assert own[-1] == pytest.approx(top, abs=8)
        assert max(own) <= top
        assert max(b / a for a, b in itertools.pairwise(own)) < 10 ** (1 / 4) * 1.05
        assert len(set(own)) == len(own)


class LinearBox:
    """A box of one channel: 0.001 W·sr⁻¹·m⁻² per level in the high range, a hundredth of it in the low one."""

    def __init__(self, mode=ChannelMode.STEADY):
        self.channels, self.drive, self.mode = {"spot": CHANNEL}, DriveLevel(9000), mode
        self.waited = 0.0

    def safe(self):
        self.drive = None

    def set_level(self, channel, level):
        self.drive = level

    def read_channel(self, channel):
        return ChannelState(channel, self.mode, self.drive or DriveLevel(0), 4096, 1.0)

    def wait(self, seconds):
        self.waited += seconds

    def measure(self):
        """Return what stands in a room that is lit by 2 W·sr⁻¹·m⁻² besides."""
        own = 0.0 if self.drive is None else self.drive.level * 1e-3
        part = 0.01 if self.drive is not None and self.drive.current_range is CurrentRange.LOW else 1.0
        return reading(2.0 + own * part, noise=1e-6)


def survey_of(box):
    return LevelSurvey(box, box.measure, box.wait, np.random.default_rng(1), points_per_decade=1.0)


def test_a_survey_begins_and_ends_in_the_dark():
    """A box that was lit is darkened for the dark reading; every level has its light; afterwards none is left."""
    box = LinearBox()
    found = survey_of(box).survey("spot", SpectralCorrection(2.0))
    assert box.drive is None
    for point in found.points:
        part = 0.01 if point.current_range == "low" else 1.0
        assert point.radiance_W_per_sr_m2 == pytest.approx(2.0 * point.level * 1e-3 * part, rel=1e-6)
    assert {point.current_range for point in found.points} == {"low", "high"}
    assert found.drift_u_rel == pytest.approx(0.0, abs=1e-9)
    assert box.waited >= 20.0 * len(found.points)


def test_a_channel_that_the_box_ended_is_no_level():
    """Its energy budget is used up: what was read is no light of that level, and the way out is told."""
    with pytest.raises(MeasurementError, match="ten minutes"):
        survey_of(LinearBox(ChannelMode.OFF)).survey("spot", SpectralCorrection())


@pytest.mark.parametrize(("duty_steps", "lowest_high"), [(4096, 256), (65_536, 163)])
def test_levels_begin_where_steps_lie_close_enough(duty_steps, lowest_high):
    """At 16 steps, with the high current at a 400th of all steps where that is more; four a decade and the end."""
    channel = ChannelCapabilities("spot", 460.0, duty_steps, 1000.0, dict.fromkeys(CurrentRange, 65_535))
    levels = plan_levels(channel, 4.0)
    low, high = ([one.level for one in levels if one.current_range is current] for current in CurrentRange)
    low, high = sorted((low, high), key=min)
    assert min(low) == 16 * 65_536 // duty_steps
    assert min(high) == lowest_high
    for own in (low, high):
        assert len(own) == math.ceil(4.0 * math.log10(65_536 / min(own))) + 1

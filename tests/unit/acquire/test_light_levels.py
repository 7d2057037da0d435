"""Measuring a light box's levels: darkness off, drift out, and each doubt in the point's or the channel's u."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from radiometer.acquire.light_levels import LevelSurvey, Measured, SpectralCorrection, assemble, plan_levels
from radiometer.data import Contribution, Patch, Quantity, Reading
from radiometer.devices.light_box import ChannelCapabilities, ChannelMode, ChannelState, CurrentRange, DriveLevel
from radiometer.errors import MeasurementError, UnsafeStimulus

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


def measured(first, last, dark, change=0.0):
    survey = LevelSurvey(None, None, None, np.random.default_rng(1))
    survey._dark = dark
    return survey._measured(LEVEL, (first, last), change, 40.0, 3.0)


def test_the_room_s_light_is_taken_off_and_the_start_is_of_what_is_left():
    """12 and 10 W·sr⁻¹·m⁻² beside 2 in the dark: 8 settled, 10/8 at the start."""
    found = measured(reading(12.0), reading(10.0), reading(2.0))
    assert (found.radiance, found.start_rel) == pytest.approx((8.0, 1.25))
    assert (found.settle_s, found.order) == (40.0, 3.0)


def test_noise_of_light_and_dark_and_what_has_not_settled_add_in_squares():
    """1 % of 10 and 5 % of 2 over 8; a change of 0.3 % stands for 2/√3 times as much; the scale is shared."""
    found = measured(reading(10.0), reading(10.0, noise=0.01, shared=0.02), reading(2.0, noise=0.05))
    assert found.own_u_rel == pytest.approx(math.hypot(0.1, 0.1) / 8.0)
    assert found.shared_u_rel == pytest.approx(0.02)
    drifting = measured(reading(10.0), reading(10.0), reading(2.0), change=0.003)
    assert drifting.own_u_rel == pytest.approx(0.003 * 2 / math.sqrt(3))


@pytest.mark.parametrize(("exposure_s", "expected"), [(0.1, 0.0), (0.2, math.hypot(0.1, 0.02) / 8.0)])
def test_the_black_level_s_error_drops_out_of_equal_exposures(exposure_s, expected):
    """With the same longest exposure both readings have it alike; with another it counts in both."""
    found = measured(reading(10.0), reading(10.0, black=0.01), reading(2.0, black=0.01, exposure_s=exposure_s))
    assert found.own_u_rel == pytest.approx(expected)


def test_what_does_not_stand_out_of_the_noise_is_no_point():
    """Three standard uncertainties above the dark are not enough; four are."""
    lost = measured(reading(2.3), reading(2.3), reading(2.0, noise=0.05))
    kept = measured(reading(2.4), reading(2.4), reading(2.0, noise=0.05))
    assert math.isinf(lost.own_u_rel)
    assert kept.own_u_rel == pytest.approx(0.25)


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


class SlowBox(LinearBox):
    """A box whose light grows by a part of itself every 20 s, without end, and whose energy budget may shrink."""

    def __init__(self, growth, *, longest_s=math.inf, energy_per_step=0.0, energy=1.0):
        super().__init__()
        self.growth, self.longest_s = growth, longest_s
        self.energy_per_step, self.energy, self.lit_s = energy_per_step, energy, 0.0
        self.darkened = 0

    def set_level(self, channel, level):
        self.pulse(channel, level, math.inf)

    def pulse(self, channel, level, seconds):
        if seconds > self.longest_s:
            raise UnsafeStimulus("too long")
        self.drive, self.lit_s = level, 0.0

    def off(self, channel):
        self.drive, self.darkened = None, self.darkened + 1

    def read_channel(self, channel):
        return ChannelState(channel, self.mode, self.drive or DriveLevel(0), 4096, self.energy)

    def wait(self, seconds):
        self.lit_s += seconds
        self.energy += self.energy_per_step if self.drive is not None else 0.1
        super().wait(seconds)

    def measure(self):
        steps = self.lit_s / 20.0
        return reading(0.0 if self.drive is None else (1.0 + self.growth) ** steps)


def point_of(box, drive=LEVEL):
    survey = LevelSurvey(box, box.measure, box.wait, np.random.default_rng(1))
    survey._dark = reading(0.0)
    return survey._point("spot", drive, 0.0)


@pytest.mark.parametrize(("longest_s", "lit_s"), [(math.inf, 600.0), (599.0, 280.0), (200.0, 180.0), (100.0, 90.0)])
def test_light_that_does_not_settle_is_read_40_s_before_it_has_to_end(longest_s, lit_s):
    """It is lit for the longest time that the eye allows; its last step of 1 % stands for 2/√3 % to come."""
    found = point_of(SlowBox(0.01, longest_s=longest_s))
    assert lit_s - 40.0 <= found.settle_s < lit_s - 20.0
    assert found.own_u_rel == pytest.approx(0.01 * 2 / math.sqrt(3))
    assert found.radiance == pytest.approx(1.01 ** (found.settle_s / 20.0))
    assert found.start_rel == pytest.approx(1.0 / found.radiance)


def test_light_that_is_forbidden_at_any_length_is_no_point():
    """What the eye allows for no time at all stays dark, and the box's refusal comes through."""
    with pytest.raises(UnsafeStimulus):
        point_of(SlowBox(0.01, longest_s=89.0))


@pytest.mark.parametrize(("growth", "settle_s"), [(0.0004, 20.0), (0.0006, 560.0)])
def test_light_has_settled_when_two_readings_agree_to_a_twentieth_of_a_percent(growth, settle_s):
    """Then half a per mille is what is doubted of it, however much better they agree."""
    found = point_of(SlowBox(growth))
    assert found.settle_s == settle_s
    assert found.own_u_rel == pytest.approx(max(growth, 0.0005) * 2 / math.sqrt(3))


def test_the_wait_ends_before_the_energy_budget_does():
    """It loses a tenth in 20 s: after nine steps less than 15 % are left, and the box would darken the channel."""
    found = point_of(SlowBox(0.01, energy_per_step=-0.1))
    assert found.settle_s == 180.0


@pytest.mark.parametrize(
    ("drive", "steps"),
    [
        (DriveLevel(30_000), 10),  # the whole limit: 98 % must be there
        (DriveLevel(15_000), 5),  # half of it
        (DriveLevel(3_000), 3),  # never less than twice what is kept, 30 %
        (DriveLevel(65_535, CurrentRange.LOW), 3),
    ],
)
def test_a_channel_recovers_in_the_dark_until_its_budget_suffices(drive, steps):
    """From 0.03 up by a tenth in 20 s of darkness: a brighter level waits longer."""
    box = SlowBox(0.0, energy=0.03)
    LevelSurvey(box, box.measure, box.wait, np.random.default_rng(1))._let_recover("spot", drive)
    assert box.waited == 20.0 * steps
    assert box.darkened == steps


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


class TiredBox(LinearBox):
    """A box whose energy budget is a fifth full, fills by a tenth in 20 s of darkness, and lights at any."""

    energy, lit_with = 0.2, None

    def set_level(self, channel, level):
        self.lit_with = self.energy
        super().set_level(channel, level)

    def off(self, channel):
        self.drive = None

    def read_channel(self, channel):
        return ChannelState(channel, self.mode, self.drive or DriveLevel(0), 4096, self.energy)

    def wait(self, seconds):
        super().wait(seconds)
        self.energy += 0.005 * seconds if self.drive is None else 0.0


@pytest.mark.parametrize(("level", "needed"), [(15_000, 0.5), (30_000, 0.98)])
def test_a_level_is_lit_when_the_budget_is_as_full_as_it_needs(level, needed):
    """Half of the highest level needs half of the budget: the channel stays dark until it has that, and no longer."""
    box = TiredBox()
    survey = survey_of(box)
    survey._dark = reading(2.0)
    survey._point("spot", DriveLevel(level), 0.0)
    assert needed <= box.lit_with + 1e-9 < needed + 0.1


def test_the_reference_is_read_before_every_sixth_level_and_at_the_end(monkeypatch):
    """Half way between the levels beside it, so that a lamp's drift is laid on the moment of each; progress counts."""
    told = []
    box = LinearBox()
    survey = LevelSurvey(box, box.measure, box.wait, np.random.default_rng(1), progress=lambda *what: told.append(what))
    monkeypatch.setattr(LevelSurvey, "_point", lambda self, channel, drive, order: point(drive.level, 1.0, order))
    levels = [DriveLevel(1000 + number) for number in range(8)]
    measured, references = survey._run("spot", levels, DriveLevel(7500))
    assert [(one.drive, one.order) for one in measured] == [(level, float(n)) for n, level in enumerate(levels)]
    assert {one.drive.level for one in references} == {7500}
    assert [one.order for one in references] == [-0.5, 5.5, 8.0]
    assert told == [("spot", number, 8) for number in range(1, 9)]
    assert box.drive is None

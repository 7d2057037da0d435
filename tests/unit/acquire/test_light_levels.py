"""Series of light levels and of exposures that the light stays steady for."""

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import radiometer as rm
from radiometer.acquire.exposure_plan import STEADY_FRAMES, STEADY_SHORT_FRAMES, ExposurePlan, steadied
from radiometer.acquire.light_levels import LevelSurvey, Measured, SpectralCorrection, assemble, plan_levels
from radiometer.cli.main import run
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
    """From one level nothing can be interpolated; what the box darkened is no light of its level."""
    lost = Measured(LEVEL, 0.1, math.inf, 0.0, 1.0, 0.0, 1.0)
    with pytest.raises(MeasurementError, match="1 of 2 levels stand out of the noise"):
        assemble(CHANNEL, [point(15_000, 2.0, 0.0), lost], [point(7500, 1.0, 0.0)], SpectralCorrection())
    with pytest.raises(MeasurementError, match="ten minutes"):
        survey_of(LinearBox(ChannelMode.OFF)).survey("spot", SpectralCorrection())


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


class SlowBox(LinearBox):
    """A box whose light grows by a factor in 20 s, and darkness fills a tenth of the budget; it keeps what it did."""

    def __init__(self, growth=0.0, energy_per_step=0.0, energy=1.0, longest_s=math.inf):
        super().__init__()
        self.growth, self.energy_per_step, self.energy, self.longest_s = growth, energy_per_step, energy, longest_s
        self.lit_s, self.lit = 0.0, []

    def set_level(self, channel, level):
        if self.longest_s < math.inf:
            raise UnsafeStimulus("too long")
        self.pulse(channel, level, 0.0)

    def pulse(self, channel, level, duration_s):
        if duration_s > self.longest_s:
            raise UnsafeStimulus("too long")
        super().set_level(channel, level)
        self.lit_s = 0.0
        self.lit.append((level, self.energy))

    def off(self, channel):
        self.drive = None

    def read_channel(self, channel):
        return ChannelState(channel, self.mode, self.drive or DriveLevel(0), 4096, self.energy)

    def wait(self, seconds):
        super().wait(seconds)
        self.lit_s += seconds
        self.energy = min(self.energy + (self.energy_per_step if self.drive is not None else 0.1), 1.0)

    def measure(self):
        found = super().measure()
        grown = (1.0 + self.growth) ** (self.lit_s / 20.0)
        light = found.radiance.value - 2.0
        return replace(found, radiance=replace(found.radiance, value=2.0 + light * grown))


def points_of(box):
    """Return what a survey of a box finds."""
    return survey_of(box).survey("spot", SpectralCorrection())


def test_the_reference_is_read_before_every_sixth_level_and_at_the_end():
    """A quarter of the highest level stands among the levels, so that a lamp's drift is known; progress counts."""
    reported, box = [], SlowBox()
    survey = survey_of(box)
    survey.progress = lambda *what: reported.append(what)
    survey.survey("spot", SpectralCorrection())
    levels = len(plan_levels(CHANNEL, 1.0))
    assert reported == [("spot", number, levels) for number in range(1, levels + 1)]
    reference = [place for place, (drive, _) in enumerate(box.lit) if drive == DriveLevel(7500)]
    assert reference == [*range(0, len(box.lit) - 1, 7), len(box.lit) - 1]


@pytest.mark.parametrize(("growth", "settle_s"), [(0.0002, 20.0), (0.0008, 560.0)])
def test_light_has_settled_when_two_readings_agree_to_a_twentieth_of_a_percent(growth, settle_s):
    """Else it is read 40 s before the longest time of 600 s ends; its last step shows 2/√3 of the change to come."""
    found = points_of(SlowBox(growth))
    assert found.settle_s == settle_s
    unsettled = max(growth, 0.0005) * 2.0 / math.sqrt(3.0)
    # A bright point's doubt is that alone: the room's light next to it and noise of a millionth are less.
    assert max(found.points, key=lambda one: one.radiance_W_per_sr_m2).u_rel == pytest.approx(unsettled, rel=0.3)


@pytest.mark.parametrize(("longest_s", "settle_s"), [(599.0, 240.0), (200.0, 140.0), (100.0, 60.0)])
def test_light_that_may_not_be_seen_for_long_is_read_before_it_ends(longest_s, settle_s):
    """280, 180 or 90 s: the longest of these that the eye allows, less 40 s; where it allows none it is refused."""
    with pytest.raises(UnsafeStimulus):
        points_of(SlowBox(longest_s=89.0))
    assert points_of(SlowBox(0.01, longest_s=longest_s)).settle_s == pytest.approx(settle_s, abs=20.0)


def test_the_wait_ends_before_the_energy_budget_does():
    """It loses a tenth in 20 s; a level is lit at its share of the highest's budget, 30 % at least."""
    assert points_of(SlowBox(0.01, energy_per_step=-0.1)).settle_s == 180.0
    box = SlowBox(energy_per_step=-0.15, energy=0.03)
    points_of(box)
    for drive, energy in box.lit:
        share = drive.level / 30_000 if drive.current_range is CurrentRange.HIGH else 0.0
        assert energy + 1e-9 >= max(min(share, 0.98), 0.3)


def test_what_does_not_stand_out_of_the_noise_is_no_point():
    """Of light of 1 mW in a room that is known to 1 % of 2 W, levels below some 60 mW are lost."""

    class Noisy(LinearBox):
        def measure(self):
            return replace(super().measure(), budget=(Contribution("noise", 0.01),))

    found = points_of(Noisy())
    assert min(one.radiance_W_per_sr_m2 for one in found.points) > 3.0 * 0.02
    assert len(found.points) < len(plan_levels(CHANNEL, 1.0))


BENCH = """\
format: radiometer-bench/1
camera: {{kind: simulated, preset: BFS-U3-19S4M, serial: "22500001", seed: {seed}, width: 96, height: 64,
         black_level_dn: 64, flicker: {{frequency_Hz: {hz}, modulation: {depth}}}}}
lens: {{focal_length_mm: 16, f_number: 4}}
scene: {{kind: uniform, radiance_W_per_sr_m2: 0.4}}
patch: {{x: 32, y: 30, width: 32, height: 2}}
"""


def _bench(folder: Path, seed: int, hz: float, depth: float) -> Path:
    file = folder / f"bench{seed}.yaml"
    file.write_text(BENCH.format(seed=seed, hz=hz, depth=depth))
    return file


@pytest.mark.slow
def test_sine_of_known_modulation_is_covered(tmp_path: Path) -> None:
    """Frequency and SVM of a sine are within k·u (95 %) for three of four seeds or more."""
    inside = {"frequency": 0, "svm": 0}
    for seed in range(8101, 8105):
        depth, hz = 0.1 + 0.05 * (seed % 7), 90.0 + 3.7 * (seed % 11)
        found = rm.flicker(bench=_bench(tmp_path, seed, hz, depth), duration=0.25).measures
        svm = depth * (1.0 + math.exp(-0.00518 * (hz - 306.6)))  # CIE TN 006:2016: one component
        assert found.frequency is not None
        assert found.svm is not None
        inside["frequency"] += abs(found.frequency.value - hz) <= found.coverage_factor * found.frequency.u
        inside["svm"] += abs(found.svm.value - svm) <= found.coverage_factor * found.svm.u
    assert min(inside.values()) >= 3, inside


def test_long_exposure_is_reported_as_averaging(tmp_path: Path) -> None:
    """An exposure of 2 ms leaves sinc(0.2) = 93.5 % of 100 Hz; the result warns of it."""
    found = rm.flicker(bench=_bench(tmp_path, 8120, 100.0, 0.3), duration=0.3, exposure=2e-3).measures
    assert any("93.5 %" in warning for warning in found.warnings)


def test_command_prints_rate_and_measure_flags_the_light(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`flicker --bench` is JSON with the frame rate's limit; `measure` of the same light has the flag `flicker`."""
    bench = _bench(tmp_path, 8130, 137.0, 0.5)  # no exposure made for mains light averages it
    assert run(["flicker", "--bench", str(bench), "--duration", "0.1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["frequency"]["value"] == pytest.approx(137.0, abs=0.5)
    assert any("wrong frequency" in line for line in found["assumptions"])
    run(["measure", "--bench", str(bench), "--uncalibrated", "--json"])
    assert "flicker" in json.loads(capsys.readouterr().out)["flags"]


def times(*exposures_s, flicker_hz=None, limit_s=60.0):
    return steadied(ExposurePlan(exposures_s), flicker_hz, limit_s).exposures_s


def test_short_exposures_are_taken_often_enough():
    """At 1 ms nine frames; a screen at 60 Hz has two of its frames in 0.04 s; of 30 s no third fits into a minute."""
    found = times(1e-3, 1.4e-3)
    assert len(found) == STEADY_SHORT_FRAMES >= 5
    assert set(found) == {1e-3, 1.4e-3}
    assert times(30.0, limit_s=60.0) == pytest.approx((30.0, 30.0))
    assert times(0.04, flicker_hz=60.0) == pytest.approx((2 / 60,) * STEADY_FRAMES)


@pytest.mark.parametrize(("planned", "taken"), [(0.0123, 0.01), (0.049, 0.04), (0.0734, 0.05), (1.234, 1.2)])
def test_long_exposures_are_whole_periods_of_mains_light(planned, taken):
    """Multiples of 1/20 s average 100 and 120 Hz, below that multiples of 1/100 s average 100 Hz."""
    found = times(planned)
    assert found == pytest.approx((taken,) * STEADY_FRAMES)

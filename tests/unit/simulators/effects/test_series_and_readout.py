"""Jumping lamps, first frames of a series, and charge that gathers during readout, against values by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings, LensDescription
from radiometer.reconciliation.tile_model import TileContext
from simulators.chain.camera_model import CameraModel
from simulators.effects.angle_dependence import AngleDependence
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.conversion_gain_error import ConversionGainError
from simulators.effects.correlated_read_noise import CorrelatedReadNoise
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.dark_current_clamped import DarkCurrentClamped
from simulators.effects.dark_current_nonuniformity import DarkCurrentNonuniformity
from simulators.effects.event_offset import EventOffset
from simulators.effects.first_frame_offset import FirstFrameOffset
from simulators.effects.gain_step_error import GainStepError
from simulators.effects.gamma_enabled import GammaEnabled
from simulators.effects.hot_pixels import HotPixels
from simulators.effects.lamp_step import LampStep
from simulators.effects.line_start_offset import LineStartOffset
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.readout_dark_charge import ReadoutDarkCharge
from simulators.effects.rolling_shutter_banding import RollingShutterBanding
from simulators.effects.series_settling import SeriesSettling
from simulators.effects.source_not_proportional_to_exposure import SourceNotProportionalToExposure
from simulators.effects.stray_light_kernel import StrayLightKernel
from simulators.effects.tile_moments import Moments, TileMoments


def _context(**settings: Any) -> ExposureContext:
    own = FrameSettings(**({"exposure_s": 0.01} | settings))
    return ExposureContext(own, FrameGeometry.of_image(8, 5), CameraDescription(bit_depth=12))


def _series(times_s: np.ndarray) -> ExposureContext:
    return _context(timestamp_s=times_s)


def _tiles(**more: Any) -> TileContext:
    """Return the circumstances of a capture of several frames."""
    plain = _context()
    return TileContext(**({"settings": plain.settings, "geometry": plain.geometry, "camera": plain.camera} | more))


def test_a_lamp_jumps_at_its_moment():
    """Frames until the moment have their light, those after it 2 % more."""
    factor = LampStep(step_rel=0.02, time_s=100.0).factor(_series(np.array([0.0, 100.0, 100.1])))
    assert np.asarray(factor).tolist() == [1.0, 1.0, 1.02]


def test_a_jump_is_looked_for_between_any_two_of_many_captures():
    """Of ten captures a jump may lie after the fourth to the sixth, halfway to the next; of seven nowhere."""
    times = [start.time_s for start in LampStep.starts(_series(10.0 * np.arange(10)))]
    assert times == [35.0, 45.0, 55.0]
    assert LampStep.usable(_series(np.arange(8.0)))
    assert not LampStep.usable(_series(np.arange(7.0)))


def test_an_event_lifts_black_and_is_forgotten():
    """None before it, 6 DN at it, 6/e a time constant later."""
    lift = EventOffset(offset_dn=6.0, tau_s=20.0, event_s=100.0).offset(_series(np.array([0.0, 99.9, 100.0, 120.0])))
    assert np.asarray(lift) == pytest.approx([0.0, 0.0, 6.0, 6.0 / math.e])


def test_an_event_within_a_series_is_in_the_frames_behind_it():
    """The first of four frames lies before it, the others on average half a time constant behind."""
    first, later = _series(np.array(90.0)), _series(np.array(110.0))
    series = _tiles(frames=4.0, first_frame=first, later_frames=later, settings=later.settings)
    effect = EventOffset(offset_dn=6.0, tau_s=20.0, event_s=100.0)
    assert float(effect.offset(series)) == pytest.approx(0.75 * 6.0 * math.exp(-0.5))
    after = effect.moments(TileMoments.exactly(np.full((1, 1, 4), 100.0)), series)
    assert isinstance(after, TileMoments)
    assert float(np.ravel(after.first_excess)[0]) == pytest.approx(-6.0 * math.exp(-0.5))


def test_an_event_is_looked_for_in_front_of_captures():
    """Of eight captures 10 s apart it may lie in front of the fourth and fifth, short and long, up and down."""
    starts = EventOffset.starts(_series(10.0 * np.arange(8)))
    tried = {(s.event_s, s.tau_s, s.offset_dn) for s in starts}
    assert tried == {(at, tau, size) for at in (30.0, 40.0) for tau in (30.0, 200.0) for size in (1.0, -1.0)}
    assert len(starts) == len(tried)
    assert EventOffset.usable(_series(np.arange(6.0)))
    assert not EventOffset.usable(_series(np.arange(5.0)))


def test_the_first_frame_alone_is_off():
    """Of four frames the mean is off by a quarter of what the first is; a second frame is not off at all."""
    effect, signal = FirstFrameOffset(offset_dn=4.0), np.full((5, 8), 100.0)
    assert float(effect.mean(signal, _context())[0, 0]) == 104.0
    assert float(effect.mean(signal, replace(_context(), frame_index=1))[0, 0]) == 100.0
    series = _tiles(frames=np.full((1, 1, 1), 4.0))
    after = effect.moments(TileMoments.exactly(np.full((1, 1, 4), 100.0)), series)
    assert isinstance(after, TileMoments)
    assert float(after.mean[0, 0, 0]) == 101.0
    assert float(np.ravel(after.first_excess)[0]) == 4.0


def test_charge_gathers_until_a_row_is_read():
    """Of five rows the first has none and the last all; 7 K more double it; exposure does not count."""
    effect = ReadoutDarkCharge(charge_e=8.0, reference_C=20.0, doubling_K=7.0)
    for exposure_s in (1e-6, 10.0):
        column = np.ravel(effect.offset(_context(exposure_s=exposure_s, temperature_c=27.0)))
        assert column == pytest.approx([0.0, 4.0, 8.0, 12.0, 16.0])


def test_rows_may_be_read_from_below():
    """Where the last row is read first, the first one gathers most."""
    effect = ReadoutDarkCharge(charge_e=8.0, from_below=1.0)
    assert np.ravel(effect.offset(_context())) == pytest.approx([8.0, 6.0, 4.0, 2.0, 0.0])


def test_all_rows_wait_before_the_first_is_read():
    """A wait of half the readout adds half its charge to every row; only the loosened form fits it."""
    effect = ReadoutDarkCharge(charge_e=8.0, wait_share=0.5)
    assert np.ravel(effect.offset(_context())) == pytest.approx([4.0, 6.0, 8.0, 10.0, 12.0])
    assert effect.free() == ("charge_e", "doubling_K", "wait_share")
    (loose,) = ReadoutDarkCharge(charge_e=8.0).loosened(_context())
    assert loose.wait_share > 0.0
    assert ReadoutDarkCharge(charge_e=8.0).free() == ("charge_e", "doubling_K")
    assert loose.loosened(_context()) == ()


@pytest.mark.parametrize(
    ("warm_c", "stated_c"),
    [((-10.2, -4.8), -5.0), ((41.0, 45.3), 41.0), ((34.9, 45.0), 25.0), ((np.nan, 10.2), 10.2), ((np.nan,), 25.0)],
)
def test_a_rate_is_stated_at_a_temperature_of_the_session(warm_c, stated_c):
    """25 °C where a dark frame is within 10 K of it, else the nearest whole °C that they have, or the only one."""
    session = _context(temperature_c=np.array(warm_c))
    for kind in (DarkCurrent, DarkCurrentClamped, DarkCurrentNonuniformity, HotPixels, ReadoutDarkCharge):
        starts = kind.starts(session)
        assert {start.reference_C for start in starts} == {stated_c}
        ratio = getattr(starts[0], kind.heated) / kind.trials[0][kind.heated]
        assert ratio == pytest.approx(2.0 ** ((stated_c - 25.0) / starts[0].doubling_K), rel=0.15)  # the same leak


def test_a_rate_is_stated_at_a_temperature_of_darks():
    """Light at 25 and 45 °C next to darks at 40.2 °C alone: their very temperature, where no doubling matters."""
    session = _context(temperature_c=np.array([25.0, 40.2, 45.0]), shutter=np.array(["open", "closed", "open"]))
    assert {start.reference_C for start in DarkCurrent.starts(session)} == {40.2}
    assert "doubling_K" not in DarkCurrentNonuniformity.starts(session)[0].free()


def test_leaks_bring_their_own_doubling_where_temperatures_differ():
    """Readings within 2 K tell no law: the doubling is the usual one and stays."""
    for warm_c, free in (((20.0, 45.0), True), ((24.9, 25.1), False), ((np.nan,), False)):
        session = _context(temperature_c=np.array(warm_c))
        for start in DarkCurrentNonuniformity.starts(session):
            assert ("doubling_K" in start.free()) is free


def test_leaks_below_nothing_and_those_left_out_move_the_mean():
    """Of 4 million leaks the mean is of those that hold no less than nothing and do not stand out by 6 sigma."""
    effect = DarkCurrentNonuniformity(sigma_e_per_s=30.0, shape=0.6)
    leak = np.exp(0.6 * np.random.default_rng(3).standard_normal(4_000_000))
    leak = 30.0 * (leak - leak.mean()) / leak.std()
    dark = _context(exposure_s=1.0, shutter="closed")
    for signal in (0.0, 10.0, 1000.0):
        predicted = float(effect.mean(np.full(1, signal), dark)[0])
        assert predicted == pytest.approx(float(np.maximum(signal + leak, 0.0).mean()), abs=0.06)
    settings = FrameSettings(np.array([1.0, 0.1])[:, None, None], shutter=np.full((2, 1, 1), "closed"))
    series = _tiles(settings=settings, camera=dark.camera, frames=4.0, tile_pixels=1.0)
    predicted = np.ravel(effect.mean(np.full((2, 1, 1), 1000.0), series)) - 1000.0
    spread = math.sqrt(math.exp(0.36) * (math.exp(0.36) - 1.0))
    noise2 = (1000.0 + 3.0**2) / 4.0
    middle = float(np.median(leak))
    limit = 6.0 * math.sqrt(noise2 + (30.0 * 0.6 / spread) ** 2)
    kept = leak[leak - middle < limit]
    assert predicted == pytest.approx(
        [kept.mean(), 0.1 * kept.mean()], abs=0.08
    )  # left out where it shows most, everywhere
    left = np.ravel(effect.spatial_variance(np.full((2, 1, 1), 1000.0), series))
    assert left == pytest.approx([kept.var(), 0.01 * kept.var()], rel=0.01)


def test_leaks_that_differ_act_on_all_that_leaks():
    """A dark current that is added behind them in time still stands in front of them in the chain."""
    figures = {"pixel_pitch_um": 4.5, "conversion_gain_e_per_dn": 2.0, "read_noise_e": 3.0, "quantum_efficiency": 0.5}
    camera = CameraDescription(bit_depth=12, full_well_e=8000.0, **figures)
    model = CameraModel.ideal(camera, LensDescription())
    for order in ((DarkCurrent(4.0), DarkCurrentNonuniformity(2.0)), (DarkCurrentNonuniformity(2.0), DarkCurrent(4.0))):
        chain = model.with_effect(order[0]).with_effect(order[1]).effects
        names = [effect.name for effect in chain]
        assert names.count("dark_current") == 2
        assert names[names.index("shot_noise") - 2 : names.index("shot_noise")] == [
            "dark_current",
            "dark_current_nonuniformity",
        ]


def test_a_line_begins_high_and_settles():
    """Of 8 columns the first, a sixteenth into its line, is up by 10·exp(−1/4) DN; exposure and rows do not count."""
    effect = LineStartOffset(offset_dn=10.0, decay_share=0.25)
    for exposure_s in (1e-6, 10.0):
        line = np.ravel(effect.offset(_context(exposure_s=exposure_s, temperature_c=27.0)))
        assert line == pytest.approx([10.0 * math.exp(-(k + 0.5) / 8.0 / 0.25) for k in range(8)])
    low = LineStartOffset(offset_dn=-10.0, decay_share=0.25, from_right=1.0)
    assert np.ravel(low.offset(_context())) == pytest.approx(-line[::-1])


def test_a_slow_part_of_a_settling_adds_to_the_quick_one():
    """A quick −8 DN and a slow 2 DN: −8·exp(−x/0.1) + 2·exp(−x/0.5), above nothing from ln(4)/8 of the line on."""
    effect = LineStartOffset(-8.0, 0.1, slow_dn=2.0, slow_share=0.5)
    place = (np.arange(8) + 0.5) / 8.0
    line = np.ravel(effect.offset(_context()))
    assert line == pytest.approx(-8.0 * np.exp(-place / 0.1) + 2.0 * np.exp(-place / 0.5))
    assert (line > 0.0).tolist() == (place > math.log(4.0) / 8.0).tolist()


def test_a_slow_part_is_tried_next_to_a_quick_one_only():
    """The plain form has two parameters and two looser ones, which have four and none."""
    plain = LineStartOffset(-8.0, 0.1)
    looser = plain.loosened(_context())
    assert plain.free() == ("offset_dn", "decay_share")
    assert [np.sign(form.slow_dn) for form in looser] == [1.0, -1.0]
    for form in looser:
        assert form.free() == ("offset_dn", "decay_share", "slow_dn", "slow_share")
        assert form.slow_share > form.decay_share
        assert form.loosened(_context()) == ()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_successive_pixels_share_read_noise(sign):
    """Frames of 2 e- have the variance 4 e-², neighbours in a line the covariance ±2 e-², others none: as reported."""
    effect = CorrelatedReadNoise(sigma_e=2.0, sign=sign)
    drawn = effect.sample(np.zeros((1000, 1000)), _context(), np.random.default_rng(4))
    before = TileMoments.exactly(np.zeros((1, 1, 1)))
    predicted = effect.moments(before, _context())
    assert isinstance(predicted, TileMoments)
    along, further = (np.mean(drawn[:, :-k] * drawn[:, k:]) for k in (1, 2))
    down = np.mean(drawn[:-1] * drawn[1:])
    assert float(np.ravel(predicted.variance)[0]) == 4.0 == pytest.approx(drawn.var(), abs=0.03)
    assert float(np.ravel(predicted.neighbour_x)[0]) == 2.0 * sign == pytest.approx(along, abs=0.02)
    assert (further, down) == pytest.approx((0.0, 0.0), abs=0.02)


@pytest.mark.parametrize("decay_share", [0.02, 0.3])
@pytest.mark.parametrize("from_right", [0.0, 1.0])
@pytest.mark.parametrize("slow_dn", [0.0, -4.0])
def test_tiles_have_mean_slope_and_columns_of_their_pixels(decay_share, from_right, slow_dn):
    """Two tiles of 512 columns: mean, rise and what a parabola leaves are those of the line's 1024 pixels to 1 %."""
    effect = LineStartOffset(10.0, decay_share, from_right, slow_dn)
    line = np.ravel(effect.offset(replace(_context(), geometry=FrameGeometry.of_image(1024, 1)))).reshape(2, 512)
    u = (2.0 * np.arange(512) + 1.0) / 512 - 1.0
    middle, side = np.array([255.5, 767.5]), np.array([-1.0, 1.0, -1.0, 1.0]) / math.sqrt(3.0)
    geometry = FrameGeometry((middle[:, None] + 256.0 * side)[None], np.zeros((1, 2, 4)), 1024, 512)
    ones = np.ones((1, 1, 1))
    tiles = _tiles(geometry=geometry, tile_height=512 * ones, tile_pixels=512.0**2 * ones)
    points = np.asarray(effect.offset(tiles))[0]
    assert points.mean(axis=1) == pytest.approx(line.mean(axis=1), rel=1e-3, abs=1e-6)
    assert points @ side / (side @ side) * (u @ u) == pytest.approx(line @ u, rel=0.02, abs=0.05)
    flat = TileMoments.exactly(np.full((1, 2, 4), 100.0))
    surface = np.polynomial.polynomial.polyfit(u, line.T, 2)
    left = line - np.polynomial.polynomial.polyval(u, surface)
    predicted = effect.tile(flat, flat, tiles).fixed_column_variance
    assert float(np.ravel(predicted)[0]) == pytest.approx(float(np.mean(left**2)), rel=0.03, abs=1e-6)


@pytest.mark.parametrize("frames", [1, 2, 3, 5])
def test_a_source_settles_within_each_series(frames):
    """Mean, first frame and scatter of a series are those of its frames, worked out one by one."""
    effect = SeriesSettling(excess_rel=0.02, ratio=0.5)
    one = [float(effect.mean(np.full((1, 1), 100.0), replace(_context(), frame_index=k))[0, 0]) for k in range(frames)]
    assert one == pytest.approx([100.0 * (1 + 0.02 * 0.5**k) for k in range(frames)])
    series = _tiles(frames=np.full((1, 1, 1), float(frames)))
    after = effect.moments(TileMoments.exactly(np.full((1, 1, 4), 100.0)), series)
    assert isinstance(after, TileMoments)
    counted = one[1:] if frames > 2 else one  # of three and more the first has a statistic of its own
    assert float(after.mean[0, 0, 0]) == pytest.approx(np.mean(one))
    first = one[0] - float(np.mean(one[1:])) if frames > 1 else 0.0
    assert float(np.ravel(after.first_excess)[0]) == pytest.approx(first, abs=1e-12)
    scatter = float(np.var(counted, ddof=1)) if len(counted) > 1 else 0.0
    assert float(np.ravel(after.common_variance)[0]) == pytest.approx(scatter, abs=1e-12)


def test_a_gamma_above_black_bends_noise_too():
    """Means and variances of normal noise about a curve that begins at the black level, against a million draws."""
    effect = GammaEnabled(1.25, above_black=1.0)
    context = _context(black_level_dn=100.0)
    noise = 3.0 * np.random.default_rng(7).standard_normal(1_000_000)
    for dn in (100.0, 110.0, 2000.0):
        drawn = effect.mean(dn + noise, context)
        predicted = effect.moments(Moments(np.array([dn]), np.array([9.0]), np.zeros(1), np.zeros(1)), context)
        assert float(predicted.mean[0]) == pytest.approx(np.mean(drawn), abs=0.06)
        assert float(predicted.variance[0]) == pytest.approx(np.var(drawn), rel=0.06)
    assert effect.mean(np.array([4095.0, 100.0, 99.0]), context) == pytest.approx([4095.0, 100.0, 94.748], abs=1e-3)
    nothing = GammaEnabled(1.0, above_black=1.0)
    assert nothing.mean(np.array([90.0, 100.0, 3000.0]), context) == pytest.approx([90.0, 100.0, 3000.0])


@pytest.mark.parametrize("dn", [40.0, 64.0, 83.0, 120.0, 180.0, 3000.0])
@pytest.mark.parametrize("toe", [0.0, 0.03])
def test_moments_of_a_gamma_are_integrals_over_the_noise(dn, toe):
    """Close to the corners of the curve, on both sides of black, and far off: mean and variance of 4 DN of noise."""
    effect = GammaEnabled(1.4, toe=toe, above_black=1.0)
    context = _context(black_level_dn=64.0)
    z = np.linspace(-8.0, 8.0, 200_001)
    chance = np.exp(-0.5 * z**2) / np.exp(-0.5 * z**2).sum()
    bent = effect.mean(dn + 4.0 * z, context)
    mean = float(chance @ bent)
    predicted = effect.moments(
        Moments(np.array([[dn]]), np.array([[16.0]]), np.zeros((1, 1)), np.zeros((1, 1))), context
    )
    assert predicted.mean.shape == (1, 1)
    assert float(predicted.mean[0, 0]) == pytest.approx(mean, abs=0.02)
    assert float(predicted.variance[0, 0]) == pytest.approx(float(chance @ (bent - mean) ** 2), rel=0.02)


def test_wings_of_one_width_are_the_kernel():
    """A sum of Gaussians in which one has all is that Gaussian; what it scatters is taken from the light itself."""
    picture = np.zeros((20, 40))
    picture[8:12, 10:20] = 1000.0
    context = replace(_context(), geometry=FrameGeometry.of_image(40, 20))
    wings = StrayLightKernel(share=0.0, wings=(0.0, 0.0, 0.03, 0.0, 0.0))
    assert wings.mean(picture, context) == pytest.approx(StrayLightKernel(0.03, 0.08).mean(picture, context))
    assert wings.slope(picture, context) == pytest.approx(0.97)
    assert wings.free() == (*(f"wings[{k}]" for k in range(5)), "edge_share")


@pytest.mark.parametrize("k", range(5))
def test_free_wings_begin_at_the_width_that_was_found(k):
    """Of 0.02, 0.04 … 0.32 the width nearest in octaves gets six tenths of the share, each of the others a tenth."""
    for away in (1.0, 1.3, 1.0 / 1.3):
        kernel = StrayLightKernel(0.05, max(0.02 * 2.0**k * away, 0.02))
        _, near, _ = kernel.loosened(_context())
        assert near.wings == pytest.approx([0.03 if n == k else 0.005 for n in range(5)])
        assert near.share == 0.0


@pytest.mark.parametrize("beyond", [1.0, 0.5, 0.0])
def test_light_beyond_the_border_is_scattered_in(beyond):
    """Of an even picture a bell brings what lies inside, the normal integral, and its share of what lies beyond."""
    picture, width_px = np.full((64, 64), 1000.0), 0.08 * 64
    context = replace(_context(), geometry=FrameGeometry.of_image(64, 64))
    kernel = StrayLightKernel(share=0.0, wings=(0.0, 0.0, 0.2, 0.0, 0.0), beyond=beyond)
    scattered = (kernel.mean(picture, context) - 800.0) / 200.0
    inside = 0.5 * (1.0 + math.erf(0.5 / width_px / math.sqrt(2.0)))  # of the first pixel's bell
    assert scattered[32, 32] == pytest.approx(1.0, abs=1e-6)
    assert scattered[32, 0] == pytest.approx(inside + beyond * (1.0 - inside), abs=2e-3)
    assert scattered[0, 0] == pytest.approx(inside**2 + beyond * (1.0 - inside**2), abs=2e-3)


def test_what_lies_beyond_the_border_is_asked_before_and_after_wings():
    """The bell itself may end at the border, or take wings, in either order."""
    bell = StrayLightKernel(0.03, 0.08)
    ended, *winged = bell.loosened(_context())
    assert (ended.beyond, ended.wings, ended.share) == (0.5, (), 0.03)
    assert ended.free() == ("share", "radius", "edge_share", "beyond")
    assert [form.beyond for form in winged] == [1.0, 1.0]
    assert [form.beyond for form in ended.loosened(_context())] == [0.5, 0.5]
    (further,) = winged[0].loosened(_context())
    assert further.beyond == 0.5
    assert further.free() == (*(f"wings[{k}]" for k in range(5)), "edge_share", "beyond")
    assert further.loosened(_context()) == ()


def test_what_was_fitted_is_fitted_on_where_the_axis_is_free():
    """About an axis of its own the plain law has three parameters, with the k₄ that was found four; none is held."""
    plain, bent = NaturalVignetting(0.05, 0.03).loosened(_context())
    assert (plain.strength, plain.k4, plain.free()) == (0.05, 0.0, ("strength", "axis_x", "axis_y"))
    assert (bent.strength, bent.k4, bent.free()) == (0.05, 0.03, ("strength", "k4", "axis_x", "axis_y"))
    (further,) = plain.loosened(_context())
    assert "k4" in further.free()
    assert further.loosened(_context()) == ()


def test_a_table_does_not_stand_on_a_law_that_was_fitted():
    """What a looser form does not fit it does not hold either: the table over the gains begins at the exact gain."""
    (table,) = GainStepError(error_rel=0.02).loosened(_context(gain_db=np.array([0.0, 6.0, 12.0])))
    assert table.error_rel == 0.0
    assert table.free() == ("errors_rel[1]", "errors_rel[2]")


def test_a_gain_error_says_what_was_stated_and_what_the_noise_shows():
    """2.06 e-/DN, with 6.64 ± 0.17 % more DN for each electron, are 1.932 ± 0.0031; unknown figures tell nothing."""
    camera = CameraDescription(bit_depth=16, conversion_gain_e_per_dn=2.06)
    found = ConversionGainError(error_rel=0.0664)
    text = found.remark(camera, {"error_rel": 0.0017})
    assert text == "gain: stated 2.06 e⁻/DN, the noise says 1.932 ± 0.0031"
    assert found.remark(camera, {"error_rel": None}) == ""
    assert found.remark(CameraDescription(bit_depth=16), {"error_rel": 0.0017}) == ""


@pytest.mark.parametrize("stretch", [0.6, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("exposure_s", [0.0002, 0.001, 0.02])
def test_light_of_a_sagging_lamp_is_its_mean_over_the_exposure(stretch, exposure_s):
    """A lamp that sags as 1 − a·(1 − exp(−(t/τ)^β)) gives its mean over the exposure, here summed in small steps."""
    effect = SourceNotProportionalToExposure(0.05, 0.001, stretch)
    times = (np.arange(200_000) + 0.5) / 200_000 * exposure_s
    light = 1.0 - 0.05 * -np.expm1(-((times / 0.001) ** stretch))
    assert effect.factor(_context(exposure_s=exposure_s)) == pytest.approx(float(light.mean()), abs=1e-7)


def test_a_sag_is_freed_to_either_side_of_an_exponential():
    """A straight sag and a slow one, with the size and time that were fitted and one parameter more to pay for."""
    plain = SourceNotProportionalToExposure(0.03, 0.002)
    forms = plain.loosened(_context())
    assert plain.free() == ("droop_rel", "tau_s")
    assert {form.free() for form in forms} == {("droop_rel", "tau_s", "stretch")}
    assert {(form.droop_rel, form.tau_s) for form in forms} == {(0.03, 0.002)}
    assert min(form.stretch for form in forms) < 1.0 < max(form.stretch for form in forms)
    assert forms[0].loosened(_context()) == ()


def test_bands_of_a_flickering_lamp_have_the_variance_that_is_predicted():
    """A row's light over random phases: (m·L·sinc(f·t))²/2 of 100 Hz in 2 ms, as frames and tiles have it."""
    effect = RollingShutterBanding(modulation=0.1, frequency_hz=100.0, row_time_s=2e-5)
    context, rng = _context(exposure_s=2e-3), np.random.default_rng(6)
    rows = np.array([effect.sample(np.full((5, 8), 1000.0), context, rng)[2, 0] for _ in range(4000)])
    predicted = effect.tile(
        TileMoments.exactly(np.full((1, 1, 1), 1000.0)), TileMoments.exactly(np.full((1, 1, 1), 1000.0)), context
    )
    by_hand = (0.1 * 1000.0 * math.sin(0.2 * math.pi) / (0.2 * math.pi)) ** 2 / 2.0
    assert float(np.ravel(predicted.band_variance)[0]) == pytest.approx(by_hand)
    assert rows.var() == pytest.approx(by_hand, rel=0.05)
    assert rows.mean() == pytest.approx(1000.0, abs=5.0 * math.sqrt(by_hand / rows.size))


@pytest.mark.parametrize(
    ("powers", "fitted"),
    [
        ((2.0, 1.0), ("strength",)), ((2.5, 1.0), ("strength", "radius_power", "stop_power")),
        ((2.0, -0.5), ("strength", "radius_power", "stop_power")), ((2.0, 0.0), ("strength", "cone")),
    ],
)  # fmt: skip
def test_powers_of_an_angle_are_fitted_where_they_are_not_the_plain_ones(powers, fitted):
    """One unknown for a loss as radius squared over the stop; all three else; slant and cone where no stop counts."""
    assert AngleDependence(0.03, *powers).free() == fitted

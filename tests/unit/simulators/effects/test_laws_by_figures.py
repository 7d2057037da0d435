"""Laws of the effects in figures worked out by hand, and the ranges of their parameters."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.data import CameraDescription, FrameSettings, LensDescription, TapDescription
from radiometer.reconciliation.tile_model import CapturesPast, FrameTimes, TileContext
from simulators.chain.camera_model import CameraModel, FadingPast
from simulators.chain.unsteady_pixels import unsteady_from
from simulators.effects.base import Moments
from simulators.effects.catalogue import well_e
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.registry import EFFECTS
from simulators.effects.rounding import excess_kurtosis, rounded, rounded_normal
from simulators.effects.tile_moments import TileMoments
from testing import effect_kinds as fx
from testing.effect_context import effect_context
from testing.relatively import relatively

CAMERA = CameraDescription(bit_depth=12, full_well_e=10_000.0, read_noise_e=3.0)

SIX_DB = 20.0 * math.log10(2.0)


def at(
    exposure_s: float = 1e-3, *, code: float | None = None, frame_index: int = 0, binning: int = 1, **settings: Any
) -> ExposureContext:
    return ExposureContext(
        FrameSettings(exposure_s, **settings),
        FrameGeometry.of_image(4, 3, binning=binning),
        CAMERA,
        LensDescription(),
        code=None if code is None else np.full((3, 4), code),
        peak_radiance=3.0,
        frame_index=frame_index,
    )


@pytest.mark.parametrize(
    ("effect", "context", "expected"),
    [
        (fx.SpectralMismatch(0.01, 0.02, 0.03), at(pattern="green"), 1.02),
        (fx.SpectralMismatch(0.01, 0.02, 0.03), at(pattern="blue"), 1.03),
        (fx.SpectralMismatch(0.01, 0.02, 0.03), at(pattern="white"), 1.0),
        (fx.SourceWarmupDrift(0.1, 100.0, 0.05, 1e3), at(timestamp_s=100.0), 1 + 0.1 / math.e + 0.05 * math.exp(-0.1)),
        (fx.DisplayGammaError(0.2), at(code=0.5), 0.5**0.2),
        (fx.DisplayGammaError(0.2, 0.1), at(code=0.5), 0.5**0.2 * math.exp(0.1 * math.log(2.0) ** 2)),
        (fx.ExposureTimeOffset(5e-6, 2e-6, 6.0), at(gain_db=0.0), 1.005),
        (fx.ExposureTimeOffset(5e-6, 2e-6, 6.0), at(gain_db=12.0), 1.007),
        (fx.ExposureTimeOffset(-5e-6), at(1e-6), 0.0),
        (fx.ExposureQuantisation(1e-4, 0.0), at(1.26e-3), 1.2 / 1.26),
        (fx.ExposureQuantisation(1e-4, 0.5), at(1.26e-3), 1.3 / 1.26),
        (fx.ExposureQuantisation(1e-4, 0.5), at(1.24e-3), 1.2 / 1.24),
        (fx.ReciprocityFailure(0.01), at(1e-2), 10.0**0.01),
        (fx.ReciprocityFailure(0.01, 2e-3), at(1e-2), 2.0**0.01),
        (fx.ReciprocityFailure(0.01, 2e-3), at(5e-4), 0.5**0.01),
        (fx.SourceNotProportionalToExposure(0.1, 0.01), at(1e-2), 1.0 - 0.1 / math.e),
        (fx.LedThermalDroop(0.1, 0.05, 0.02), at(source_level=0.5), 1.0 - 0.05 - 0.0125 - 0.0025),
        (fx.LedThermalDroop(levels=(0.01, 1.0), errors_rel=(0.0, 0.1)), at(source_level=0.1), 1.05),
        (fx.QuantumEfficiencyTemperature(0.001, 1e-5), at(temperature_c=45.0), 1.024),
        (fx.FnumberTstopError(0.02), at(f_number=8.0), 1.02**2),
        (fx.FnumberTstopError(0.0, 0.01), at(f_number=8.0), 1.04),
        (fx.FnumberTstopError(f_numbers=(2.0, 8.0), errors_rel=(0.0, 0.1)), at(f_number=4.0), 1.05),
        (fx.GainStepError(gains_db=(0.0, 12.0), errors_rel=(0.0, 0.02)), at(gain_db=6.0), 1.01),
    ],
)  # fmt: skip
def test_a_factor_at_one_setting(effect: Any, context: ExposureContext, expected: float) -> None:
    """The law as its docstring states it, in figures."""
    assert np.mean(np.asarray(effect.factor(context))) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("turn_rad", "expected"), [(0.3, 1.1), (0.3 + math.pi / 2, 0.9), (0.3 + math.pi / 4, 1.0)])
def test_polarised_light_comes_and_goes_twice_a_turn(turn_rad: float, expected: float) -> None:
    """Largest along the axis, smallest across it."""
    context = at()
    turned = replace(context, geometry=replace(context.geometry, screen_rotation_rad=turn_rad))
    assert np.mean(np.asarray(fx.Polarisation(0.1, 0.3).factor(turned))) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("effect", "context", "expected"),
    [
        (fx.DarkCurrent(10.0, 25.0, 7.0), at(0.5, temperature_c=39.0), 20.0),
        (fx.DarkCurrent(10.0, 25.0, 7.0), at(0.5, temperature_c=18.0), 2.5),
        (fx.AmbientLightLeak(2.0, 0.5), at(f_number=8.0), 1.25),
        (fx.AmbientLightLeak(2.0), at(f_number=8.0), 2.0),
        (fx.AmbientLightLeak(2.0, 1.0), at(f_number=2.0), 8.0),
        (fx.DisplayBlackLeak(0.01), at(source_level=0.5), 0.015),
        (fx.BlackLevelDrift(0.1, 25.0), at(temperature_c=35.0), 1.0),
        (fx.BlackLevelDrift(0.1, 25.0, 0.01), at(temperature_c=35.0), 2.0),
        (fx.BlackLevelGainSlope(0.5, 0.0), at(gain_db=2 * SIX_DB), 1.5),
        (fx.BlackLevelGainSlope(0.5, SIX_DB, 0.1), at(gain_db=2 * SIX_DB), 0.55),
        (fx.BlackLevelGainSlope(0.5, SIX_DB, 0.1), at(gain_db=0.0), 0.0),
    ],
)  # fmt: skip
def test_an_offset_at_one_setting(effect: Any, context: ExposureContext, expected: float) -> None:
    """What is added, in the effect's own unit."""
    assert np.mean(np.asarray(effect.offset(context))) == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("effect", "signal", "context", "expected"),
    [
        (fx.ResponseNonlinearity(0.01, 0.02), 5000.0, at(), 4950.0),
        (fx.ConversionGain(2.0), 100.0, at(gain_db=SIX_DB), 100.0),
        (fx.FullWellSaturation(8000.0), 9000.0, at(), 8000.0),
        (fx.FullWellSaturation(8000.0), 7000.0, at(), 7000.0),
        (fx.FullWellSaturation(8000.0), 99_000.0, at(binning=3), 72_000.0),
        (fx.Lens(transmittance=0.9), 1.0, at(f_number=4.0), math.pi * 0.9 / 64.0),
        (fx.Lens(magnification=0.5, pupil_magnification=2.0), 1.0, at(f_number=4.0), math.pi / 100.0),
    ],
)  # fmt: skip
def test_a_signal_behind_an_effect(effect: Any, signal: float, context: ExposureContext, expected: float) -> None:
    """An even signal comes out even."""
    found = np.asarray(effect.mean(np.full((3, 4), signal), context))
    assert np.mean(found) == pytest.approx(expected, rel=1e-6)


def test_wells_of_binned_pixels_differ_by_the_root_of_their_number() -> None:
    """Four wells of 8000 ± 80 hold 32000 ± 160, drawn and predicted."""
    effect, context = (
        fx.FullWellSaturation(8000.0, 0.01),
        replace(at(), geometry=FrameGeometry.of_image(300, 200, binning=2)),
    )
    drawn = effect.sample(np.full((200, 300), 5e4), context, np.random.default_rng(1))
    assert (drawn.mean(), drawn.std()) == pytest.approx((32_000.0, 160.0), rel=0.02)
    nothing = np.zeros(1)
    spread = np.sqrt(effect.moments(Moments(np.array([5e4]), nothing, nothing, nothing), context).spatial_variance)
    assert spread[0] == pytest.approx(160.0, rel=0.02)


def test_stops_and_fields_have_the_light_of_exact_optics() -> None:
    """f/5.6 is f/5.657; where tan α is 1 a quarter is left."""
    geometry = FrameGeometry.of_image(800, 600)
    context = replace(at(f_number=4.0), geometry=geometry)
    far_mm = float(np.max(geometry.radius_um())) / 1000.0
    for share, left in ((1.0, 1.0 / 4.0), (0.5, 5.0 / 8.0)):
        lit = np.asarray(fx.Lens(focal_length_mm=far_mm, cos4=share).mean(np.ones((600, 800)), context))
        assert np.min(lit) == pytest.approx(math.pi / 64.0 * left, rel=1e-6)
        assert np.max(lit) == pytest.approx(math.pi / 64.0, rel=1e-4)
    context = context_of(FrameSettings(1 / 60, f_number=5.6))
    time, stop = 60 / 64, (5.6 / 2**2.5) ** 2
    for times, stops, factor in ((1.0, 1.0, time * stop), (1.0, 0.0, time), (0.0, 1.0, stop)):
        assert fx.NominalSettings(times, stops).factor(context) == pytest.approx(factor)


@pytest.mark.parametrize("kind", [fx.PwmFlicker, fx.MainsRipple])
@pytest.mark.parametrize(
    ("exposure_s", "left"), [(1e-9, 1.0), (2.5e-3, 8 / math.pi**2), (1e-2, 0.0), (1.5e-2, 4 / (9 * math.pi**2))]
)
def test_a_wave_of_light_averages_out_over_whole_periods(kind: Any, exposure_s: float, left: float) -> None:
    """10 % at 100 Hz on 1000: its variance is 100²/2, less by the square of what an exposure leaves of a sine."""
    effect = kind(0.1, 100.0)
    found = np.asarray(effect.common_variance(np.full((3, 4), 1000.0), at(exposure_s)))
    assert np.mean(found) == pytest.approx(5000.0 * left, rel=1e-6, abs=1e-6)


def test_hot_pixels_that_stand_out_are_counted() -> None:
    """1 % of 1000 leak 10 e⁻/s on average, fourfold at 39 °C: in 2 s 80 e⁻.

    Four frames of 3 e⁻ leave 1.5 e⁻, and six of these are passed by exp(−9/80) of an exponential distribution.
    """
    effect = fx.HotPixels(share=0.01, rate_e_per_s=10.0, reference_C=25.0, doubling_K=7.0)
    context = at(2.0, temperature_c=39.0)
    assert np.mean(np.asarray(effect.electrons(context))) == pytest.approx(80.0)

    class Tiles(ExposureContext):
        frames, tile_pixels = 4.0, np.full((1, 1, 1), 1000.0)

    tiles: Any = Tiles(context.settings, context.geometry, CAMERA, LensDescription())
    nothing = TileMoments.exactly(np.zeros((1, 1, 1)))
    predicted = effect.tile(nothing, nothing, tiles).outliers
    assert float(np.sum(predicted)) == pytest.approx(10.0 * math.exp(-9.0 / 80.0))


class _FourDarks(ExposureContext):
    frames, tile_pixels = np.full((1, 1, 1), 4.0), np.full((1, 1, 1), 240_000.0)


def _restless(frames: Any, counting: Any) -> tuple[Any, Any]:
    """Return which pixels of some frames scatter far more than those that count, and which without their highest, too.

    Those that scatter far more do not count.
    """
    scatter = frames.var(axis=0, ddof=1)
    far = scatter > unsteady_from(len(frames)) * scatter[counting].mean()
    noise = scatter[counting & ~far].mean()
    others = np.sort(frames, axis=0)[:-1].var(axis=0, ddof=1)
    far = scatter > unsteady_from(len(frames)) * noise
    return far, far & (others > unsteady_from(len(frames) - 1) * noise)


def test_jumping_pixels_are_counted_and_scatter_as_drawn_ones() -> None:
    """5 % of the pixels jump by 20 e⁻ on average, with 3 e⁻ of noise, in four frames.

    The numbers of those whose time mean stands out by six sigmas, or that scatter far more without their highest value,
    are predicted. So are the pattern without the former, and the noise without both.
    """
    effect = fx.RandomTelegraphNoise(share=0.05, height_e=20.0)
    context = at(shutter="closed")
    rng = np.random.default_rng(5)
    even = np.zeros((400, 600))
    frames = np.array([effect.sample(even, context, rng) + 3.0 * rng.standard_normal(even.shape) for _ in range(4)])
    tiles: Any = _FourDarks(context.settings, context.geometry, CAMERA, LensDescription())
    before = replace(TileMoments.exactly(np.zeros((1, 1, 1))), variance=np.full((1, 1, 1), 9.0))
    predicted = effect.tile(before, before, tiles)
    assert effect.variance(even, context) == pytest.approx(0.05 * 2.0 * 20.0**2 / 4.0)  # half a jump either way
    out = np.abs(frames.mean(axis=0)) > 6.0 * 1.5
    restless, unsteady = _restless(frames, ~out)
    scatter = frames.var(axis=0, ddof=1)[~out & ~restless]
    noise, jumps = scatter.mean(), scatter.mean() - 9.0
    for name, seen in (("outliers", out), ("unsteady", unsteady)):
        assert seen.sum() > 1000
        assert float(np.sum(getattr(predicted, name))) == pytest.approx(float(seen.sum()), rel=0.05), name
    assert float(np.sum(predicted.variance)) == pytest.approx(noise, rel=0.02)
    chance = (2.0 * 9.0**2 + 4.0 * 9.0 * jumps) / 3.0 - jumps**2  # of a variance of four values that jump
    assert float(np.sum(predicted.uneven_noise)) == pytest.approx(np.sqrt(scatter.var() - chance), rel=0.1)
    of_mean = float(np.sum(predicted.spatial_variance + predicted.variance / 4.0))
    assert of_mean == pytest.approx(float(np.var(frames.mean(axis=0)[~out])), rel=0.03)


@pytest.mark.parametrize(
    "effect", [fx.HotPixels(share=0.05, rate_e_per_s=100.0), fx.DarkCurrentNonuniformity(sigma_e_per_s=30.0, shape=1.0)]
)
def test_leaking_pixels_are_unsteady_by_their_shot_noise(effect: Any) -> None:
    """Charge that leaks into a pixel scatters by its root: where it is much more than the others', the pixel counts."""
    context = at(1.0, shutter="closed")
    rng = np.random.default_rng(6)
    leaked = effect.sample(np.full((400, 600), 40.0), context, rng)
    frames = rng.poisson(leaked, (4, 400, 600)) + 3.0 * rng.standard_normal((4, 400, 600))
    mean = frames.mean(axis=0) - np.median(frames.mean(axis=0))
    counting = np.abs(mean) < 6.0 * 1.4826 * np.median(np.abs(mean))
    tiles: Any = _FourDarks(context.settings, context.geometry, CAMERA, LensDescription())
    before = TileMoments.exactly(np.full((1, 1, 1), 40.0))
    assert float(np.sum(effect.moments(before, tiles).unsteady)) == pytest.approx(
        float(_restless(frames, counting)[1].sum()), rel=0.25
    )


def test_taps_that_are_no_quarters_have_a_size_each() -> None:
    """Four taps of one column each, of sizes 0, 1, 2 and 5 %: gains of −2, −1, 0 and 3 % about their mean."""
    taps = tuple(TapDescription(name=str(x), x=x, y=0, width=1, height=3) for x in range(4))
    context = replace(at(), camera=CAMERA.model_copy(update={"taps": taps}))
    (cover,) = fx.TapGain.covers(context)
    assert cover.free() == ("taps_rel[1]", "taps_rel[2]", "taps_rel[3]")
    known = replace(cover, taps_rel=(0.0, 0.01, 0.02, 0.05))
    np.testing.assert_allclose(known.mean(np.full((3, 4), 100.0), context), [[98.0, 99.0, 100.0, 103.0]] * 3)
    for table, added in (((4.0, 1.0, 1.0, 9.0),) * 2, ((0.0, -3.0, -3.0, 5.0), (3.0, 0.0, 0.0, 8.0))):  # none below 0
        noisy = replace(fx.TapNoise(), taps_e2=table)
        np.testing.assert_allclose(noisy.variance(np.full((3, 4), 100.0), context), [added] * 3)
    halves = (taps[0].model_copy(update={"width": 2}), taps[2].model_copy(update={"width": 2}))
    assert fx.TapGain.covers(replace(context, camera=CAMERA.model_copy(update={"taps": halves}))) == ()


def test_leaks_that_differ_are_drawn_as_stated_and_act_on_all_that_leaks() -> None:
    """60 e⁻ of scatter in the same pixels; a dark current added later is in front."""
    effect = fx.DarkCurrentNonuniformity(sigma_e_per_s=30.0, reference_C=25.0, shape=0.4)
    context = replace(at(2.0, temperature_c=25.0), geometry=FrameGeometry.of_image(400, 300))
    drawn = np.asarray(effect.sample(np.full((300, 400), 1e4), context, np.random.default_rng(1))) - 1e4
    assert drawn.std() == pytest.approx(60.0, rel=0.02)
    assert drawn.mean() == pytest.approx(0.0, abs=4 * 60.0 / math.sqrt(drawn.size))
    again = np.asarray(effect.sample(np.full((300, 400), 1e4), context, np.random.default_rng(2))) - 1e4
    np.testing.assert_array_equal(again, drawn)
    figures = {"pixel_pitch_um": 4.5, "conversion_gain_e_per_dn": 2.0, "read_noise_e": 3.0, "quantum_efficiency": 0.5}
    camera = CameraDescription(bit_depth=12, full_well_e=8000.0, **figures)
    model = CameraModel.ideal(camera, LensDescription())
    pair = (fx.DarkCurrent(4.0), fx.DarkCurrentNonuniformity(2.0))
    for order in (pair, pair[::-1]):
        chain = model.with_effect(order[0]).with_effect(order[1]).effects
        names = [effect.name for effect in chain]
        assert names.count("dark_current") == 2
        assert names[names.index("shot_noise") - 2 : names.index("shot_noise")] == [
            "dark_current",
            "dark_current_nonuniformity",
        ]


def context_of(settings):
    """Return the circumstances of frames of these settings, before a lens that states nothing."""
    return ExposureContext(settings, FrameGeometry.of_image(4, 3), CameraDescription(bit_depth=12))


@pytest.mark.parametrize(
    ("times_s", "usable"),
    [
        ((1 / 60, 1 / 125, 1 / 50), True), ((1 / 64, 1 / 128, 1 / 256), False),
        ((1.0005 / 64, 1.0003 / 128, 0.9998 / 256), False), ((1.0005 / 64, 1.02 / 128, 0.9998 / 256), True),
        ((1 / 60, 1 / 60, 1 / 125), False), ((1 / 60, 1 / 125, 1 / 50, 1.08 / 64), False),
    ],
)  # fmt: skip
def test_printed_stops_are_near_stops_and_not_all_on_them(times_s, usable):
    """Within 7 % of one, to more than a thousandth off, in more than two ways: else nothing was rounded."""
    assert fx.NominalSettings.usable(context_of(FrameSettings(np.array(times_s)))) is usable


FILLS = np.array([0.0, 0.3, 1.0, 1.2, 1.67, 3.0])


@pytest.mark.parametrize(("a2", "a3"), [(0.018, -0.0025), (-0.02, 0.0), (0.0, 0.004)])
def test_the_curve_goes_on_beyond_the_declared_full_well(a2: float, a3: float) -> None:
    """S·(1 − a₂·z − a₃·z²) at every fill: a full well that is declared too small makes no kink."""
    context, effect = effect_context(), fx.ResponseNonlinearity(a2=a2, a3=a3)
    signal = FILLS * well_e(context)
    np.testing.assert_allclose(effect.mean(signal, context), signal * (1 - a2 * FILLS - a3 * FILLS**2), rtol=1e-12)
    np.testing.assert_allclose(effect.slope(signal, context), 1 - 2 * a2 * FILLS - 3 * a3 * FILLS**2, rtol=1e-12)


@pytest.mark.parametrize(("a2", "a3"), [(0.3, 0.0), (0.5, 0.5), (-0.2, 0.2), (-0.5, -0.5), (0.0, 0.0)])
def test_more_light_never_gives_less(a2: float, a3: float) -> None:
    """Where the polynomial would fall, the response stays; far beyond it goes straight on; no light stays none."""
    context, effect = effect_context(), fx.ResponseNonlinearity(a2=a2, a3=a3)
    signal = np.linspace(-0.1, 40.0, 4001) * well_e(context)
    bent = effect.mean(signal, context)
    assert np.all(np.diff(bent) >= -1e-9 * well_e(context))
    np.testing.assert_allclose(bent[signal < 0], signal[signal < 0], rtol=1e-9)
    assert effect.mean(np.zeros(1), context).item() == 0.0


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=lambda kind: kind.name)
def test_no_range_is_a_number_of_codes_of_one_bit_depth(kind: type) -> None:
    """Every parameter in digital numbers has a range that is a share of the camera's full scale."""
    for known in kind.parameters():
        assert known.of_full_scale == known.unit.startswith("DN")


def test_ranges_go_with_the_converter_and_a_step_beyond() -> None:
    """65535 of 16 bits, 255 of 8; a search may try a little more; times are the same for all."""
    (offset,) = (one for one in fx.BlackLevelOffset.parameters() if one.name == "offset_dn")
    assert offset.bounds(65535.0) == pytest.approx((-65535.0, 65535.0))
    assert offset.bounds(255.0) == pytest.approx((-255.0, 255.0))
    (exposure,) = (one for one in fx.ExposureTimeOffset.parameters() if one.name == "offset_s")
    assert exposure.bounds(65535.0) == (exposure.low, exposure.high)
    assert fx.AdcSaturation(65535.0).with_parameters(clip_dn=70646.4).clip_dn == 70646.4
    wells = [one.full_well_e / 1e4 for one in fx.FullWellSaturation.starts(at())]  # of the declared full well
    assert (wells[0], wells[-1]) == pytest.approx((1.0, 1 / 3), abs=0.04)
    assert all(0.7 < after / before < 1.0 for before, after in itertools.pairwise(wells))


@pytest.mark.parametrize(
    "effect", [fx.DarkCurrent(10.0, 25.0, 7.0), fx.ReadoutDarkCharge(charge_e=8.0, reference_C=25.0, doubling_K=7.0)]
)
def test_charge_of_a_sensor_that_warms_up_is_less_in_the_first_frame(effect):
    """7 K more behind it double what leaks: the first of four frames holds half of what the others do."""
    geometry = FrameGeometry.of_image(8, 5)
    first, later, mean = (_capture(settings=FrameSettings(1.0, temperature_c=c)) for c in (25.0, 32.0, 30.25))
    series = replace(mean, frames=4.0, first_frame=first, later_frames=later)
    after = effect.moments(TileMoments.exactly(np.full(geometry.shape, 100.0)), series)
    expected = np.asarray(effect.offset(first)) - np.asarray(effect.offset(later))
    assert float(np.mean(after.first_excess)) == pytest.approx(float(np.mean(expected)), rel=1e-6)
    assert np.mean(expected) == pytest.approx(-np.mean(np.asarray(effect.offset(first))))


# Rounding and missing codes.


_CONTEXT = ExposureContext(FrameSettings(1e-3), FrameGeometry.of_image(8, 6), CameraDescription(bit_depth=12))

PIXELS, FRAMES = 20_000, 100

# Mean, noise and fixed pattern in DN: on a code, between two, at the border, hardly any noise, mostly pattern, fine.
CASES = [(60.0, 0.23, 0.0), (60.3, 0.23, 0.0), (60.45, 0.06, 0.0), (60.4, 0.3, 0.2), (7.5, 0.1, 0.3), (9.2, 0.7, 0.4)]


def _moments(mean: float, noise: float, pattern: float) -> Moments:
    return Moments(*(np.array([value]) for value in (mean, noise**2, pattern**2, 1e-6)))


@pytest.mark.parametrize(("mean", "noise", "pattern"), CASES)
def test_moments_are_those_of_rounded_samples(mean: float, noise: float, pattern: float) -> None:
    """Mean, temporal and spatial variance of two million rounded samples lie within 4.5 of their standard errors."""
    rng = np.random.default_rng(5)
    pixels = mean + pattern * rng.standard_normal(PIXELS)
    codes = np.rint(pixels[:, None] + noise * rng.standard_normal((PIXELS, FRAMES)))
    after = rounded(_moments(mean, noise, pattern))
    of_pixel, within = codes.mean(axis=1), codes.var(axis=1, ddof=1)
    between = of_pixel.var(ddof=1) - within.mean() / FRAMES
    u_between = np.std((of_pixel - of_pixel.mean()) ** 2) / np.sqrt(PIXELS)
    assert abs(of_pixel.mean() - after.mean[0]) < 4.5 * of_pixel.std() / np.sqrt(PIXELS)
    assert abs(within.mean() - after.variance[0]) < 4.5 * within.std() / np.sqrt(PIXELS) + 1e-4 * within.mean()
    assert abs(between - after.spatial_variance[0]) < 4.5 * u_between + 1e-6
    assert noise < 0.7 or after.mean[0] == mean


@pytest.mark.parametrize(("phase", "noise"), [(0.0, 0.31), (0.5, 0.31), (0.2, 0.4), (0.0, 0.7)])
def test_excess_kurtosis_is_that_of_rounded_samples(phase: float, noise: float) -> None:
    """Noise of 0.31 DN at the middle of a code has 6, at its border −2; from 0.6 DN on nothing is asked."""
    codes = np.rint(17.0 + phase + noise * np.random.default_rng(3).standard_normal(1_000_000))
    apart = codes - codes.mean()
    predicted = 0.0 if noise > 0.6 else float(np.mean(apart**4) / np.mean(apart**2) ** 2 - 3.0)
    found = excess_kurtosis(_moments(17.0 + phase, noise, 0.0))
    assert np.asarray(found).ravel()[0] == pytest.approx(predicted, abs=0.1)


def _tiles(mean: float, noise: float, shared: float) -> TileMoments:
    """Return the moments of a tile whose neighbours in a row have a share of their noise in common."""
    before = TileMoments.exactly(np.full((1, 1, 1), mean))
    return replace(before, variance=np.full((1, 1, 1), noise**2), neighbour_x=np.full((1, 1, 1), shared * noise**2))


@cache
def _drawn() -> list[NDArray[np.float64]]:
    """Return two million triples of standard normal numbers."""
    return list(np.random.default_rng(11).standard_normal((3, 2_000_000)))


@pytest.mark.parametrize(
    ("mean", "noise", "step"),
    [
        (60.0, 0.23, 1),
        (60.3, 0.31, 1),
        (60.5, 0.06, 1),
        (31.2, 0.4, 4),
        (31.9, 2.1, 4),
        (64.0, 0.7, 128),
        (70.2, 4.1, 16),
    ],
)
def test_neighbours_share_what_the_codes_leave_of_it(mean: float, noise: float, step: int) -> None:
    """The covariance of neighbours behind rounding, and behind a coarse step, is that of two million rounded pairs."""
    share = 0.1
    common, *own = _drawn()
    pair = [mean + noise * (np.sqrt(share) * common + np.sqrt(1.0 - share) * one) for one in own]
    codes = [step * np.floor(np.rint(values) / step) for values in pair]
    products = (codes[0] - codes[0].mean()) * (codes[1] - codes[1].mean())
    after = rounded(_tiles(mean, noise, share))
    if step > 1:
        after = fx.MissingCodes(step_codes=float(step)).moments(after, _CONTEXT)
    found = float(np.ravel(after.neighbour_x)[0])
    second_order = share * max(float(products.mean()), 1e-6)  # what a pair's square has in common counts by the share²
    assert abs(found - products.mean()) < 4.5 * products.std() / np.sqrt(products.size) + second_order
    assert abs(found) <= float(np.ravel(after.variance)[0])


@pytest.mark.parametrize(("mean", "columns", "rows"), [(60.0, 0.2, 0.0), (60.5, 0.15, 0.0), (60.0, 0.0, 0.2)])
def test_what_lines_share_spreads_pixels_over_the_codes(mean: float, columns: float, rows: float) -> None:
    """Columns 0.2 DN apart, or rows that tremble so, change a pixel's noise as a pattern of its own does.

    2500 columns, or rows at 2500 times, tell it to 4.5 standard errors of their spread.
    """
    noise, lines, pixels = 0.33, 2500, 400
    rng = np.random.default_rng(8)
    at = mean + (columns + rows) * rng.standard_normal((lines, 1))
    codes = np.rint(at + noise * rng.standard_normal((lines, pixels)))
    within = codes.var(axis=1, ddof=1)
    one = TileMoments.exactly(np.full((1, 1, 1), mean))
    own, shaken, fixed = (np.full((1, 1, 1), s**2) for s in (noise, rows, columns))
    after = rounded(replace(one, variance=own, row_variance=shaken, fixed_column_variance=fixed))
    u_within = within.std() / np.sqrt(lines)
    assert float(after.variance[0, 0, 0]) == pytest.approx(within.mean(), abs=4.5 * u_within)
    assert abs(float(rounded(replace(one, variance=own)).variance[0, 0, 0]) - within.mean()) > 10.0 * u_within
    of_line = codes.mean(axis=1)
    u_mean = of_line.std() / np.sqrt(lines)
    assert float(after.mean[0, 0, 0]) == pytest.approx(of_line.mean(), abs=4.5 * u_mean)


def test_signals_are_rounded_as_each_by_itself() -> None:
    """Coarse ones next to fine ones; hardly any noise is swallowed by a code, less than none is none."""
    together = rounded(
        Moments(*(np.array(column) for column in zip(*((m, n**2, p**2, 1e-6) for m, n, p in CASES), strict=True)))
    )
    for number, case in enumerate(CASES):
        alone = rounded(_moments(*case))
        for field in ("mean", "variance", "spatial_variance", "common_variance"):
            values = np.broadcast_to(getattr(together, field), (len(CASES),))
            assert values[number] == relatively(float(np.ravel(getattr(alone, field))[0]), rel=1e-9), (field, case)
    assert rounded(_moments(60.0, 0.06, 0.0)).common_variance[0] < 1e-12
    assert rounded(_moments(60.5, 0.06, 0.0)).common_variance[0] > 1e-6
    mean = np.array([60.3, 7.8, 60.3, 7.8])
    average, variance, _ = rounded_normal(mean, np.array([-4.0, -1e-9, 0.0, 0.0]))
    np.testing.assert_allclose(average, [60.0, 8.0, 60.0, 8.0])
    np.testing.assert_allclose(variance, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("period", "kept"), [(2, 1), (4, 1), (8, 1), (16, 1), (3, 2), (4, 2), (4, 3), (8, 7), (16, 15)]
)
def test_a_search_tries_the_codes_that_converters_leave_out(period: int, kept: int) -> None:
    """Bits that are stuck, one code of a period that never comes: some trial leaves exactly those codes."""
    codes, anywhere = np.arange(64.0), cast(Any, None)
    expected = set(codes[codes % period < kept])
    found = [set(np.ravel(fx.MissingCodes(**trial).mean(codes, anywhere))) for trial in fx.MissingCodes.trials]
    assert expected in found


# Exposure that depends on the row, and the geometry of a frame.


ROWS = 96


def _at(exposure_s: float) -> ExposureContext:
    context = effect_context()
    geometry = FrameGeometry.of_image(40, ROWS)
    return replace(context, settings=replace(context.settings, exposure_s=exposure_s), geometry=geometry)


@pytest.mark.parametrize("exposure_s", [158e-6, 472.5e-6, 1.8e-3])
def test_rows_are_exposed_as_the_maker_s_model_says(exposure_s: float) -> None:
    """For L ∝ V/(t + a₂·y − a₃·t·y) the digital value of an even field goes as (t + a₂·y − a₃·t·y)/t in row y."""
    a2, a3 = 9.2e-8 * 10, 1.58e-5 * 10  # a RedEdge's, per row of a tenth of its rows
    y = np.arange(ROWS)
    reported = (exposure_s + a2 * y - a3 * exposure_s * y) / exposure_s
    effect = fx.RowDependentExposure(added_s=a2 * (ROWS - 1), lost_share=a3 * (ROWS - 1))
    factor = np.asarray(effect.factor(_at(exposure_s)))
    np.testing.assert_allclose(np.ravel(factor), reported, rtol=1e-12)


def test_rows_lose_no_more_than_their_exposure_and_gain_as_a_leak_does() -> None:
    """No row below nothing; time alone is the leak's equation, which takes none."""
    factor = np.asarray(fx.RowDependentExposure(added_s=-2e-4).factor(_at(1e-4)))
    assert factor.min() == 0.0
    assert factor.max() == 1.0
    context = _at(3e-4)
    row = np.asarray(fx.RowDependentExposure(added_s=1e-5).factor(context))
    leak = np.asarray(fx.ParasiticLightSensitivity(leak_s=1e-5).factor(context))
    np.testing.assert_allclose(row, leak, rtol=1e-7)
    leak = next(entry for entry in fx.ParasiticLightSensitivity.parameters() if entry.name == "leak_s")
    added = next(entry for entry in fx.RowDependentExposure.parameters() if entry.name == "added_s")
    assert leak.low == 0.0
    assert added.low < 0.0 < added.high


FRAME = FrameGeometry.of_image(8, 6, pixel_spacing_um=5.0)


def test_coordinates_run_from_the_corner_and_from_the_middle() -> None:
    """In pixels, µm, half diagonals, and −1 to 1 over the longer side."""
    assert FRAME.x_px.tolist() == [list(range(8))]
    assert FRAME.y_px.tolist() == [[float(y)] for y in range(6)]
    assert FRAME.shape == (6, 8)
    assert FRAME.is_image
    binned = FrameGeometry.of_image(3, 2, x=10, y=20, binning=2)
    assert binned.x_px.tolist() == [[10.5, 12.5, 14.5]]
    assert binned.y_px.ravel().tolist() == [20.5, 22.5]
    assert (binned.sensor_width, binned.sensor_height) == (16, 24)
    assert FRAME.row_fraction().ravel() == pytest.approx(np.arange(6) / 5.0)
    assert FrameGeometry.of_image(4, 1).row_fraction().tolist() == [[0.0]]
    assert FRAME.centre_px == (3.5, 2.5)
    assert FRAME.radius_um()[0, 0] == pytest.approx(5.0 * math.hypot(3.5, 2.5))
    assert FRAME.field_radius()[0, 0] == pytest.approx(math.hypot(3.5, 2.5) / 5.0)  # half of √(8² + 6²) is 5 px
    x, y = FRAME.field_xy()
    assert (float(x[0, 0]), float(y[0, 0])) == pytest.approx((-3.5 / 5.0, -2.5 / 5.0))
    assert np.hypot(x, y) == pytest.approx(FRAME.field_radius())
    neighbour = replace(FRAME, principal_point_px=(0.0, 0.0))
    assert neighbour.centre_px == (0.0, 0.0)
    assert neighbour.radius_um()[5, 7] == pytest.approx(5.0 * math.hypot(7.0, 5.0))
    for x, y in (FRAME.sensor_xy(), FRAME.screen_xy()):
        assert np.broadcast_to(x, FRAME.shape)[0] == pytest.approx((np.arange(8) - 3.5) / 4.0)
        assert np.broadcast_to(y, FRAME.shape)[:, 0] == pytest.approx((np.arange(6) - 2.5) / 4.0)
    u, v = replace(FRAME, screen_rotation_rad=math.pi / 2).screen_xy()
    assert np.broadcast_to(u, FRAME.shape)[:, 0] == pytest.approx((np.arange(6) - 2.5) / 4.0)
    assert np.broadcast_to(v, FRAME.shape)[0] == pytest.approx(-(np.arange(8) - 3.5) / 4.0)
    u, v = replace(FRAME, screen_shift_px=(1.0, -2.0)).screen_xy()
    assert (float(u[0, 0]), float(v[0, 0])) == pytest.approx((-4.5 / 4.0, -0.5 / 4.0))


# Jumping lamps, first frames of a series, and charge that gathers during readout, against values by hand.


def _context(**settings: Any) -> ExposureContext:
    own = FrameSettings(**({"exposure_s": 0.01} | settings))
    return ExposureContext(own, FrameGeometry.of_image(8, 5), CameraDescription(bit_depth=12))


def _series(times_s: np.ndarray) -> ExposureContext:
    return _context(timestamp_s=times_s)


def _capture(**more: Any) -> TileContext:
    """Return the circumstances of a capture of several frames."""
    plain = _context()
    return TileContext(**({"settings": plain.settings, "geometry": plain.geometry, "camera": plain.camera} | more))


def test_a_lamp_jumps_at_its_moment_between_captures():
    """2 % more after it; it is looked for after the fourth to the sixth of ten captures."""
    factor = fx.LampStep(step_rel=0.02, time_s=100.0).factor(_series(np.array([0.0, 100.0, 100.1])))
    assert np.asarray(factor).tolist() == [1.0, 1.0, 1.02]
    times = [start.time_s for start in fx.LampStep.starts(_series(10.0 * np.arange(10)))]
    assert times == [35.0, 45.0, 55.0]
    assert fx.LampStep.usable(_series(np.arange(8.0)))
    assert not fx.LampStep.usable(_series(np.arange(7.0)))


def test_events_are_forgotten_and_looked_for_in_front_of_captures():
    """6/e a time constant later; of eight captures in front of the fourth and fifth."""
    lift = fx.EventOffset(offset_dn=6.0, tau_s=20.0, event_s=100.0).offset(_series(np.array([0.0, 99.9, 100.0, 120.0])))
    assert np.asarray(lift) == pytest.approx([0.0, 0.0, 6.0, 6.0 / math.e])
    times_s = np.array([80.0, 90.0, 100.0, 110.0])[None, None, None]
    first, later = _capture(frame_times_s=times_s[..., :1]), _capture(frame_times_s=times_s[..., 1:])
    series = _capture(frames=4.0, first_frame=first, later_frames=later, frame_times_s=times_s)
    effect = fx.EventOffset(offset_dn=6.0, tau_s=20.0, event_s=100.0)
    both = 6.0 * (1.0 + math.exp(-0.5))
    assert float(np.ravel(effect.offset(series))[0]) == pytest.approx(both / 4)
    after = effect.moments(TileMoments.exactly(np.full((1, 1, 4), 100.0)), series)
    assert float(np.ravel(after.first_excess)[0]) == pytest.approx(-both / 3)
    starts = fx.EventOffset.starts(_series(10.0 * np.arange(8)))
    tried = {(s.event_s, s.tau_s, s.offset_dn) for s in starts}
    assert tried == {(at, tau, size) for at in (30.0, 40.0) for tau in (30.0, 200.0) for size in (1.0, -1.0)}
    assert len(starts) == len(tried)
    assert fx.EventOffset.usable(_series(np.arange(6.0)))
    assert not fx.EventOffset.usable(_series(np.arange(5.0)))
    assert not fx.EventOffset.starts(_series(np.zeros(1)))


def test_the_first_frame_alone_is_off():
    """Of four frames the mean is off by a quarter of what the first is; a second frame is not off at all."""
    effect, signal = fx.FirstFrameOffset(offset_dn=4.0), np.full((5, 8), 100.0)
    assert float(effect.mean(signal, _context())[0, 0]) == 104.0
    assert float(effect.mean(signal, replace(_context(), frame_index=1))[0, 0]) == 100.0
    series = _capture(frames=np.full((1, 1, 1), 4.0))
    after = effect.moments(TileMoments.exactly(np.full((1, 1, 4), 100.0)), series)
    assert float(after.mean[0, 0, 0]) == 101.0
    assert float(np.ravel(after.first_excess)[0]) == 4.0


@pytest.mark.parametrize(
    ("more", "column"),
    [({}, [0, 2, 4, 6, 8]), ({"from_below": 1.0}, [8, 6, 4, 2, 0]), ({"wait_share": 0.5}, [4, 6, 8, 10, 12])],
)
def test_charge_gathers_until_a_row_is_read(more, column):
    """Of five rows the first has none and the last all, or the other way; a wait adds to every row; 7 K double it."""
    effect = fx.ReadoutDarkCharge(charge_e=8.0, reference_C=20.0, doubling_K=7.0, **more)
    for exposure_s, celsius, factor in ((1e-6, 20.0, 1.0), (10.0, 27.0, 2.0)):  # the exposure does not count
        found = np.ravel(effect.offset(_context(exposure_s=exposure_s, temperature_c=celsius)))
        assert found == pytest.approx(factor * np.array(column))


@pytest.mark.parametrize(
    ("warm_c", "stated_c"),
    [((-10.2, -4.8), -5.0), ((41.0, 45.3), 41.0), ((34.9, 45.0), 25.0), ((np.nan, 10.2), 10.2), ((np.nan,), 25.0)],
)
def test_a_rate_is_stated_at_a_temperature_of_the_session(warm_c, stated_c):
    """25 °C where a dark frame is within 10 K of it, else the nearest whole °C that they have, or the only one."""
    session = _context(temperature_c=np.array(warm_c))
    leaks = (fx.DarkCurrent, fx.DarkCurrentClamped, fx.DarkCurrentNonuniformity, fx.HotPixels, fx.ReadoutDarkCharge)
    for kind in leaks:
        starts = kind.starts(session)
        assert {start.reference_C for start in starts} == {stated_c}
        ratio = getattr(starts[0], kind.heated) / kind.trials[0][kind.heated]
        assert ratio == pytest.approx(2.0 ** ((stated_c - 25.0) / starts[0].doubling_K), rel=0.15)  # the same leak


def test_leaks_are_stated_where_darks_are():
    """At 40.2 °C of the darks alone; readings within 2 K tell no doubling."""
    session = _context(temperature_c=np.array([25.0, 40.2, 45.0]), shutter=np.array(["open", "closed", "open"]))
    assert {start.reference_C for start in fx.DarkCurrent.starts(session)} == {40.2}
    assert "doubling_K" not in fx.DarkCurrentNonuniformity.starts(session)[0].free()
    for warm_c, free in (((20.0, 45.0), True), ((24.9, 25.1), False), ((np.nan,), False)):
        session = _context(temperature_c=np.array(warm_c))
        for start in fx.DarkCurrentNonuniformity.starts(session):
            assert ("doubling_K" in start.free()) is free


def test_leaks_below_nothing_and_those_left_out_move_the_mean():
    """Of 4 million leaks the mean is of those that hold no less than nothing and do not stand out by 6 sigma."""
    effect = fx.DarkCurrentNonuniformity(sigma_e_per_s=30.0, shape=0.6)
    leak = np.exp(0.6 * np.random.default_rng(3).standard_normal(4_000_000))
    leak = 30.0 * (leak - leak.mean()) / leak.std()
    dark = _context(exposure_s=1.0, shutter="closed")
    for signal in (0.0, 10.0, 1000.0):
        predicted = float(effect.mean(np.full(1, signal), dark)[0])
        assert predicted == pytest.approx(float(np.maximum(signal + leak, 0.0).mean()), abs=0.06)
    settings = FrameSettings(np.array([1.0, 0.1])[:, None, None], shutter=np.full((2, 1, 1), "closed"))
    series = _capture(settings=settings, camera=dark.camera, frames=4.0, tile_pixels=1.0)
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


def test_a_line_settles_by_a_quick_and_a_slow_part():
    """10·exp(−x/0.25) from either end; −8·exp(−x/0.1) + 2·exp(−x/0.5)."""
    effect = fx.LineStartOffset(offset_dn=10.0, decay_share=0.25)
    for exposure_s in (1e-6, 10.0):
        line = np.ravel(effect.offset(_context(exposure_s=exposure_s, temperature_c=27.0)))
        assert line == pytest.approx([10.0 * math.exp(-(k + 0.5) / 8.0 / 0.25) for k in range(8)])
    low = fx.LineStartOffset(offset_dn=-10.0, decay_share=0.25, from_right=1.0)
    assert np.ravel(low.offset(_context())) == pytest.approx(-line[::-1])
    effect = fx.LineStartOffset(-8.0, 0.1, slow_dn=2.0, slow_share=0.5)
    place = (np.arange(8) + 0.5) / 8.0
    line = np.ravel(effect.offset(_context()))
    assert line == pytest.approx(-8.0 * np.exp(-place / 0.1) + 2.0 * np.exp(-place / 0.5))
    assert (line > 0.0).tolist() == (place > math.log(4.0) / 8.0).tolist()


def test_looser_forms_have_one_part_more():
    """A slow part next to a quick one, a wait before the first row; then there are none."""
    plain = fx.LineStartOffset(-8.0, 0.1)
    looser = plain.loosened(_context())
    assert plain.free() == ("offset_dn", "decay_share")
    assert [np.sign(form.slow_dn) for form in looser] == [1.0, -1.0]
    for form in looser:
        assert form.free() == ("offset_dn", "decay_share", "slow_dn", "slow_share")
        assert form.slow_share > form.decay_share
        assert form.loosened(_context()) == ()
    plain = fx.ReadoutDarkCharge(charge_e=8.0)
    (loose,) = plain.loosened(_context())
    assert plain.free() == ("charge_e", "doubling_K")
    assert loose.free() == ("charge_e", "doubling_K", "wait_share")
    assert loose.wait_share > 0.0
    assert loose.loosened(_context()) == ()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_successive_pixels_share_read_noise(sign):
    """Frames of 2 e- have the variance 4 e-², neighbours in a line the covariance ±2 e-², others none: as reported."""
    effect = fx.CorrelatedReadNoise(sigma_e=2.0, sign=sign)
    drawn = effect.sample(np.zeros((1000, 1000)), _context(), np.random.default_rng(4))
    before = TileMoments.exactly(np.zeros((1, 1, 1)))
    predicted = effect.moments(before, _context())
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
    effect = fx.LineStartOffset(10.0, decay_share, from_right, slow_dn)
    line = np.ravel(effect.offset(replace(_context(), geometry=FrameGeometry.of_image(1024, 1)))).reshape(2, 512)
    u = (2.0 * np.arange(512) + 1.0) / 512 - 1.0
    middle, side = np.array([255.5, 767.5]), np.array([-1.0, 1.0, -1.0, 1.0]) / math.sqrt(3.0)
    geometry = FrameGeometry((middle[:, None] + 256.0 * side)[None], np.zeros((1, 2, 4)), 1024, 512)
    ones = np.ones((1, 1, 1))
    tiles = _capture(geometry=geometry, tile_height=512 * ones, tile_pixels=512.0**2 * ones)
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
    effect = fx.SeriesSettling(excess_rel=0.02, ratio=0.5)
    one = [float(effect.mean(np.full((1, 1), 100.0), replace(_context(), frame_index=k))[0, 0]) for k in range(frames)]
    assert one == pytest.approx([100.0 * (1 + 0.02 * 0.5**k) for k in range(frames)])
    series = _capture(frames=np.full((1, 1, 1), float(frames)))
    after = effect.moments(TileMoments.exactly(np.full((1, 1, 4), 100.0)), series)
    assert float(after.mean[0, 0, 0]) == pytest.approx(np.mean(one))
    first = one[0] - float(np.mean(one[1:])) if frames > 1 else 0.0
    assert float(np.ravel(after.first_excess)[0]) == pytest.approx(first, abs=1e-12)
    scatter = float(np.var(one[1:], ddof=1)) if frames > 2 else 0.0
    assert float(np.ravel(after.ordered_variance)[0]) == pytest.approx(scatter, abs=1e-12)


def test_a_gamma_begins_at_the_black_level():
    """Full scale and black stay, less than black bends as much the other way; a power of 1 changes nothing."""
    effect, context = fx.GammaEnabled(1.25, above_black=1.0), _context(black_level_dn=100.0)
    assert effect.mean(np.array([4095.0, 100.0, 99.0]), context) == pytest.approx([4095.0, 100.0, 94.748], abs=1e-3)
    nothing = fx.GammaEnabled(1.0, above_black=1.0)
    assert nothing.mean(np.array([90.0, 100.0, 3000.0]), context) == pytest.approx([90.0, 100.0, 3000.0])


@pytest.mark.parametrize("dn", [40.0, 64.0, 83.0, 120.0, 180.0, 3000.0])
@pytest.mark.parametrize("toe", [0.0, 0.03])
def test_moments_of_a_gamma_are_integrals_over_the_noise(dn, toe):
    """Close to the corners of the curve, on both sides of black, and far off: mean and variance of 4 DN of noise."""
    effect = fx.GammaEnabled(1.4, toe=toe, above_black=1.0)
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


def test_wings_of_one_width_are_the_kernel_in_either_order():
    """A sum in which one has all; the border is asked before and after."""
    picture = np.zeros((20, 40))
    picture[8:12, 10:20] = 1000.0
    context = replace(_context(), geometry=FrameGeometry.of_image(40, 20))
    wings = fx.StrayLightKernel(share=0.0, wings=(0.0, 0.0, 0.03, 0.0, 0.0))
    assert wings.mean(picture, context) == pytest.approx(fx.StrayLightKernel(0.03, 0.08).mean(picture, context))
    assert wings.slope(picture, context) == pytest.approx(0.97)
    assert wings.free() == (*(f"wings[{k}]" for k in range(5)), "edge_share")
    bell = fx.StrayLightKernel(0.03, 0.08)
    ended, *winged = bell.loosened(_context())
    assert (ended.beyond, ended.wings, ended.share) == (0.5, (), 0.03)
    assert ended.free() == ("share", "radius", "edge_share", "beyond")
    assert [form.beyond for form in winged] == [1.0, 1.0]
    assert [form.beyond for form in ended.loosened(_context())] == [0.5, 0.5]
    (further,) = winged[0].loosened(_context())
    assert further.beyond == 0.5
    assert further.free() == (*(f"wings[{k}]" for k in range(5)), "edge_share", "beyond")
    assert further.loosened(_context()) == ()


@pytest.mark.parametrize("k", range(5))
def test_free_wings_begin_at_the_width_that_was_found(k):
    """Of 0.02, 0.04 … 0.32 the width nearest in octaves gets six tenths of the share, each of the others a tenth."""
    for away in (1.0, 1.3, 1.0 / 1.3):
        kernel = fx.StrayLightKernel(0.05, max(0.02 * 2.0**k * away, 0.02))
        _, near, _ = kernel.loosened(_context())
        assert near.wings == pytest.approx([0.03 if n == k else 0.005 for n in range(5)])
        assert near.share == 0.0


@pytest.mark.parametrize("beyond", [1.0, 0.5, 0.0])
def test_light_beyond_the_border_is_scattered_in(beyond):
    """Of an even picture a bell brings what lies inside, the normal integral, and its share of what lies beyond."""
    picture, width_px = np.full((64, 64), 1000.0), 0.08 * 64
    context = replace(_context(), geometry=FrameGeometry.of_image(64, 64))
    kernel = fx.StrayLightKernel(share=0.0, wings=(0.0, 0.0, 0.2, 0.0, 0.0), beyond=beyond)
    scattered = (kernel.mean(picture, context) - 800.0) / 200.0
    inside = 0.5 * (1.0 + math.erf(0.5 / width_px / math.sqrt(2.0)))  # of the first pixel's bell
    assert scattered[32, 32] == pytest.approx(1.0, abs=1e-6)
    assert scattered[32, 0] == pytest.approx(inside + beyond * (1.0 - inside), abs=2e-3)
    assert scattered[0, 0] == pytest.approx(inside**2 + beyond * (1.0 - inside**2), abs=2e-3)


def test_what_was_fitted_is_kept_or_dropped_by_looser_forms():
    """k₄ stays about a free axis; a table of gains begins at the exact gain."""
    plain, bent = fx.NaturalVignetting(0.05, 0.03).loosened(_context())
    assert (plain.strength, plain.k4, plain.free()) == (0.05, 0.0, ("strength", "axis_x", "axis_y"))
    assert (bent.strength, bent.k4, bent.free()) == (0.05, 0.03, ("strength", "k4", "axis_x", "axis_y"))
    (further,) = plain.loosened(_context())
    assert "k4" in further.free()
    assert further.loosened(_context()) == ()
    (table,) = fx.GainStepError(error_rel=0.02).loosened(_context(gain_db=np.array([0.0, 6.0, 12.0])))
    assert table.error_rel == 0.0
    assert table.free() == ("errors_rel[1]", "errors_rel[2]")


def test_a_gain_error_says_what_was_stated_and_what_the_noise_shows():
    """2.06 e-/DN, with 6.64 ± 0.17 % more DN for each electron, are 1.932 ± 0.0031; unknown figures tell nothing."""
    camera = CameraDescription(bit_depth=16, conversion_gain_e_per_dn=2.06)
    found = fx.ConversionGainError(error_rel=0.0664)
    text = found.remark(camera, {"error_rel": 0.0017})
    assert text == "gain: stated 2.06 e⁻/DN, the noise says 1.932 ± 0.0031"
    assert found.remark(camera, {"error_rel": None}) == ""
    assert found.remark(CameraDescription(bit_depth=16), {"error_rel": 0.0017}) == ""


@pytest.mark.parametrize("stretch", [0.6, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("exposure_s", [0.0002, 0.001, 0.02])
def test_light_of_a_sagging_lamp_is_its_mean_over_the_exposure(stretch, exposure_s):
    """A lamp that sags as 1 − a·(1 − exp(−(t/τ)^β)) gives its mean over the exposure, here summed in small steps."""
    effect = fx.SourceNotProportionalToExposure(0.05, 0.001, stretch)
    times = (np.arange(200_000) + 0.5) / 200_000 * exposure_s
    light = 1.0 - 0.05 * -np.expm1(-((times / 0.001) ** stretch))
    assert effect.factor(_context(exposure_s=exposure_s)) == pytest.approx(float(light.mean()), abs=1e-7)


def test_a_sag_is_freed_to_either_side_of_an_exponential():
    """A straight sag and a slow one, with the size and time that were fitted and one parameter more to pay for."""
    plain = fx.SourceNotProportionalToExposure(0.03, 0.002)
    forms = plain.loosened(_context())
    assert plain.free() == ("droop_rel", "tau_s")
    assert {form.free() for form in forms} == {("droop_rel", "tau_s", "stretch")}
    assert {(form.droop_rel, form.tau_s) for form in forms} == {(0.03, 0.002)}
    assert min(form.stretch for form in forms) < 1.0 < max(form.stretch for form in forms)
    assert forms[0].loosened(_context()) == ()


def test_bands_of_a_flickering_lamp_have_the_variance_that_is_predicted():
    """A row's light over random phases: (m·L·sinc(f·t))²/2 of 100 Hz in 2 ms, as frames and tiles have it."""
    effect = fx.RollingShutterBanding(modulation=0.1, frequency_hz=100.0, row_time_s=2e-5)
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
    assert fx.AngleDependence(0.03, *powers).free() == fitted


# Charge that traps let go: by figures worked out by hand, of single frames, of captures and of the camera.


TRAPS = fx.ResidualCharge(share=0.01, tau_s=20.0)
TIMES = FrameTimes(np.array([0.0, 5.0, 30.0, 40.0]), np.array([0, 0, 1, 2]), np.array([0, 1, 0, 0]), 3)
HELD = np.array([[1000.0, 0.0], [10.0, 400.0], [7.0, 7.0]])


def test_charge_of_traps_comes_free_by_the_age_of_each_frame():
    """1 % of 5000 e- 10 s old over 4 s with τ = 20 s; it scatters as electrons do."""
    past = CapturesPast(TIMES, HELD)
    older = 1000.0 * (math.exp(-30.0 / 20.0) + math.exp(-25.0 / 20.0))
    last = 1000.0 * (math.exp(-2.0) + math.exp(-1.75)) + 10.0 * math.exp(-0.5)
    own = 1000.0 * math.exp(-0.25) / 2  # the second frame behind the first, on average over both
    assert past.faded(20.0)[:, 0, 0] == pytest.approx([own, older, last])
    assert past.faded(20.0)[:, 1, 0] == pytest.approx([0.0, 0.0, 400.0 * math.exp(-0.5)])
    context = replace(
        at(4.0), past=CapturesPast(FrameTimes(np.array([0.0, 10.0]), np.arange(2), np.zeros(2), 2), HELD[:2] * 5)
    )
    let_go = 0.01 * (1.0 - math.exp(-0.2)) * 5000.0 * math.exp(-0.5)
    signal = np.full((2, 2, 1), 300.0)
    assert TRAPS.mean(signal, context)[1, 0, 0] == pytest.approx(300.0 + let_go)
    assert np.asarray(TRAPS.variance(signal, context))[1, 0, 0] == pytest.approx(let_go)
    drawn = TRAPS.sample(np.full((2, 2, 40_000), 300.0), context, np.random.default_rng(1))[1, 0]
    assert drawn.mean() == pytest.approx(300.0 + let_go, abs=5 * math.sqrt(let_go / 40_000))
    assert drawn.var() == pytest.approx(let_go, rel=0.05)
    assert TRAPS.mean(signal, at(4.0)) == pytest.approx(signal)  # nothing is known of frames before


@pytest.mark.parametrize(("part", "own"), [("first", 0.0), ("later", 1000.0 * math.exp(-0.25)), ("all", 389.4003915)])
def test_the_first_of_a_series_sees_none_of_its_own(part, own):
    """Others see those before them; a lone frame is first and later."""
    found = CapturesPast(TIMES, HELD, part).faded(20.0)[:, 0, 0]
    assert found[0] == pytest.approx(own)
    assert found[1] == pytest.approx(CapturesPast(TIMES, HELD).faded(20.0)[1, 0, 0])


def test_the_camera_remembers_every_frame_once():
    """Three frames at 0, 10 and 25 s; traps of 1, 7.5 and 50 s where half a second lies between."""
    past = FadingPast()
    seen = []
    for now_s, charge in ((0.0, 100.0), (10.0, 50.0), (25.0, 1.0)):
        view = past.at(now_s, (1, 2))
        seen.append(float(view.faded(20.0)[0, 1]))
        past.add(np.full((1, 2), charge), now_s)
    first, second = 100.0 * math.exp(-0.5), 100.0 * math.exp(-1.25) + 50.0 * math.exp(-0.75)
    assert seen == pytest.approx([0.0, first, second])
    assert past.at(None, (1, 2)) is None
    past.add(np.full((1, 2), 9.0), None)
    assert past.at(25.0, (1, 2)).faded(20.0)[0, 0] == pytest.approx(second * 1.0 + 1.0)
    assert not past.at(25.0, (2, 2)).faded(20.0).any()
    for since, tried in ((np.array([np.inf, 0.5, 0.5, 9.0]), [1.0, 7.5, 50.0]), (None, [30.0, 225.0, 1500.0])):
        starts = fx.ResidualCharge.starts(replace(at(1.0), since_frame_s=since))
        assert [start.tau_s for start in starts] == tried
    assert not fx.ResidualCharge.usable(at(1.0))


def after_charge(held_e: Any, full_well_e: float = 10_000.0, **more: Any) -> TileContext:
    """Return the circumstances of frames before which the pixels held so many electrons."""
    camera = CameraDescription(bit_depth=12, full_well_e=full_well_e)
    settings, geometry = FrameSettings(0.01), FrameGeometry.of_image(np.shape(held_e)[-1], np.shape(held_e)[-2])
    return TileContext(settings, geometry, camera, previous_e=np.asarray(held_e), **({"frames": None} | more))


def _left(lag: fx.ImageLag, previous: float) -> float:
    return float(lag.mean(np.zeros((1, 1)), after_charge([[previous]]))[0, 0])


@pytest.mark.parametrize(("power", "expected"), [(1.0, 80.0), (0.5, 40.0), (2.0, 320.0)])
def test_lag_by_a_power_goes_through_its_share_at_a_thousand_electrons(power: float, expected: float) -> None:
    """2 % of 1000 e- is 20 e- for every power; of 4000 e- it is 80 e- by a line, 40 by a root, 320 by a square."""
    lag = fx.ImageLag(share=0.02, power=power)
    assert _left(lag, 1000.0) == pytest.approx(20.0)
    assert _left(lag, 4000.0) == pytest.approx(expected)
    assert _left(lag, 40000.0) == pytest.approx(20.0 * 10.0**power)  # no pixel holds more than its full well


def test_lag_of_darkness_is_nothing_and_its_power_is_fitted_where_not_one() -> None:
    """A negative share adds no noise; other powers come among the forms."""
    assert fx.ImageLag(share=0.02).free() == ("share",)
    assert fx.ImageLag(share=0.02, power=0.6).free() == ("share", "power")
    context = after_charge([[0.0]])
    assert any(form.power != 1.0 for form in fx.ImageLag.covers(context))
    assert any(form.power != 1.0 for form in fx.ImageLag(share=0.02).loosened(context))
    (noisy,) = fx.ImageLag(share=0.02, power=0.6).loosened(context)
    assert noisy.free() == ("share", "power", "noise")
    assert fx.ImageLag(share=0.02, power=0.6, noise=0.5).loosened(context) == ()
    context = after_charge([[0.0, 500.0]])
    signal = np.full((1, 2), 100.0)
    assert fx.ImageLag(share=0.02).variance(signal, context).tolist() == [[0.0, 10.0]]
    assert fx.ImageLag(share=-0.02).variance(signal, context).tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("frames", [1, 2, 4, 6])
@pytest.mark.parametrize(("share", "older"), [(0.1, 0.0), (0.06, 0.05), (-0.08, 0.0)])
def test_noise_that_comes_back_makes_frames_alike(frames: int, share: float, older: float) -> None:
    """Scatter about the mean of a series, and of that mean from pixel to pixel, as drawn frame by frame."""
    rng, pixels = np.random.default_rng(frames), 400_000
    held = 5000.0 + np.sqrt(5000.0) * rng.standard_normal((frames + 2, pixels))
    seen = held[2:] + share * held[1:-1] + older * held[:-2]
    context = after_charge([[[5000.0]]], full_well_e=20_000.0, frames=float(frames))
    before = replace(TileMoments.exactly(np.array([[[5000.0]]])), variance=np.array([[[5000.0]]]))
    lag = fx.ImageLag(share=share, older_share=older, noise=0.0)
    predicted = lag.moments(before, context)
    counted = seen[1:] if frames > 2 else seen
    if frames > 1:
        scatter = float(np.mean(np.var(counted, axis=0, ddof=1)))
        own = 3.0 * scatter * np.sqrt(2.0 / (pixels * (len(counted) - 1))) + (share**2 + older**2) * 5000.0
        assert float(predicted.variance.item()) == pytest.approx(scatter, abs=1.2 * own)
    mean = float(np.var(np.mean(seen, axis=0)))
    own = 3.0 * mean * np.sqrt(2.0 / pixels) + 2.5 * (abs(share) + abs(older)) ** 2 * 5000.0 / frames
    expected = float(predicted.variance.item()) / frames + float(predicted.spatial_variance.item())
    assert expected == pytest.approx(mean, abs=own)
    if frames > 1:
        assert abs(mean - 5000.0 / frames) > own  # what a model without memory says

"""Laws of the effects in figures, and the ranges of their parameters."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings, LensDescription, TapDescription
from simulators.chain.unsteady_pixels import unsteady_from
from simulators.effects.adc_saturation import AdcSaturation
from simulators.effects.ambient_light_leak import AmbientLightLeak
from simulators.effects.base import Parameter
from simulators.effects.black_level_drift import BlackLevelDrift
from simulators.effects.black_level_gain_slope import BlackLevelGainSlope
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.catalogue import well_e
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.conversion_gain import ConversionGain
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.dark_current_nonuniformity import DarkCurrentNonuniformity
from simulators.effects.display_black_leak import DisplayBlackLeak
from simulators.effects.display_gamma_error import DisplayGammaError
from simulators.effects.exposure_quantisation import ExposureQuantisation
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.first_frame_offset import FirstFrameOffset
from simulators.effects.fnumber_tstop_error import FnumberTstopError
from simulators.effects.full_well_saturation import FullWellSaturation
from simulators.effects.gain_step_error import GainStepError
from simulators.effects.hot_pixels import HotPixels
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.lens import Lens
from simulators.effects.mains_ripple import MainsRipple
from simulators.effects.nominal_settings import NominalSettings
from simulators.effects.polarisation import Polarisation
from simulators.effects.pwm_flicker import PwmFlicker
from simulators.effects.quantum_efficiency_temperature import QuantumEfficiencyTemperature
from simulators.effects.random_telegraph_noise import RandomTelegraphNoise
from simulators.effects.reciprocity_failure import ReciprocityFailure
from simulators.effects.registry import EFFECTS
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from simulators.effects.source_not_proportional_to_exposure import SourceNotProportionalToExposure
from simulators.effects.source_warmup_drift import SourceWarmupDrift
from simulators.effects.spectral_mismatch import SpectralMismatch
from simulators.effects.tap_gain import TapGain
from simulators.effects.tap_noise import TapNoise
from simulators.effects.tile_moments import TileMoments
from testing.effect_context import effect_context

CAMERA = CameraDescription(bit_depth=12, full_well_e=10_000.0, read_noise_e=3.0)

SIX_DB = 20.0 * math.log10(2.0)


def at(
    exposure_s: float = 1e-3, *, code: float | None = None, frame_index: int = 0, **settings: Any
) -> ExposureContext:
    return ExposureContext(
        FrameSettings(exposure_s, **settings),
        FrameGeometry.of_image(4, 3),
        CAMERA,
        LensDescription(),
        code=None if code is None else np.full((3, 4), code),
        peak_radiance=3.0,
        frame_index=frame_index,
    )


@pytest.mark.parametrize(
    ("effect", "context", "expected"),
    [
        (SpectralMismatch(0.01, 0.02, 0.03), at(pattern="green"), 1.02),
        (SpectralMismatch(0.01, 0.02, 0.03), at(pattern="blue"), 1.03),
        (SpectralMismatch(0.01, 0.02, 0.03), at(pattern="white"), 1.0),
        (SourceWarmupDrift(0.1, 100.0, 0.05, 1000.0), at(timestamp_s=100.0), 1 + 0.1 / math.e + 0.05 * math.exp(-0.1)),
        (DisplayGammaError(0.2), at(code=0.5), 0.5**0.2),
        (DisplayGammaError(0.2, 0.1), at(code=0.5), 0.5**0.2 * math.exp(0.1 * math.log(2.0) ** 2)),
        (ExposureTimeOffset(5e-6, 2e-6, 6.0), at(gain_db=0.0), 1.005),
        (ExposureTimeOffset(5e-6, 2e-6, 6.0), at(gain_db=12.0), 1.007),
        (ExposureTimeOffset(-5e-6), at(1e-6), 0.0),
        (ExposureQuantisation(1e-4, 0.0), at(1.26e-3), 1.2 / 1.26),
        (ExposureQuantisation(1e-4, 0.5), at(1.26e-3), 1.3 / 1.26),
        (ExposureQuantisation(1e-4, 0.5), at(1.24e-3), 1.2 / 1.24),
        (ReciprocityFailure(0.01), at(1e-2), 10.0**0.01),
        (ReciprocityFailure(0.01, 2e-3), at(1e-2), 2.0**0.01),
        (ReciprocityFailure(0.01, 2e-3), at(5e-4), 0.5**0.01),
        (SourceNotProportionalToExposure(0.1, 0.01), at(1e-2), 1.0 - 0.1 / math.e),
        (LedThermalDroop(0.1, 0.05, 0.02), at(source_level=0.5), 1.0 - 0.05 - 0.0125 - 0.0025),
        (LedThermalDroop(levels=(0.01, 1.0), errors_rel=(0.0, 0.1)), at(source_level=0.1), 1.05),
        (QuantumEfficiencyTemperature(0.001, 1e-5), at(temperature_c=45.0), 1.024),
        (FnumberTstopError(0.02), at(f_number=8.0), 1.02**2),
        (FnumberTstopError(0.0, 0.01), at(f_number=8.0), 1.04),
        (FnumberTstopError(f_numbers=(2.0, 8.0), errors_rel=(0.0, 0.1)), at(f_number=4.0), 1.05),
        (GainStepError(gains_db=(0.0, 12.0), errors_rel=(0.0, 0.02)), at(gain_db=6.0), 1.01),
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
    assert np.mean(np.asarray(Polarisation(0.1, 0.3).factor(turned))) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("effect", "context", "expected"),
    [
        (DarkCurrent(10.0, 25.0, 7.0), at(0.5, temperature_c=39.0), 20.0),
        (DarkCurrent(10.0, 25.0, 7.0), at(0.5, temperature_c=18.0), 2.5),
        (AmbientLightLeak(2.0, 0.5), at(f_number=8.0), 1.25),
        (AmbientLightLeak(2.0), at(f_number=8.0), 2.0),
        (AmbientLightLeak(2.0, 1.0), at(f_number=2.0), 8.0),
        (DisplayBlackLeak(0.01), at(source_level=0.5), 0.015),
        (BlackLevelDrift(0.1, 25.0), at(temperature_c=35.0), 1.0),
        (BlackLevelDrift(0.1, 25.0, 0.01), at(temperature_c=35.0), 2.0),
        (BlackLevelGainSlope(0.5, 0.0), at(gain_db=2 * SIX_DB), 1.5),
        (BlackLevelGainSlope(0.5, SIX_DB, 0.1), at(gain_db=2 * SIX_DB), 0.55),
        (BlackLevelGainSlope(0.5, SIX_DB, 0.1), at(gain_db=0.0), 0.0),
    ],
)  # fmt: skip
def test_an_offset_at_one_setting(effect: Any, context: ExposureContext, expected: float) -> None:
    """What is added, in the effect's own unit."""
    assert np.mean(np.asarray(effect.offset(context))) == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("effect", "signal", "context", "expected"),
    [
        (ResponseNonlinearity(0.01, 0.02), 5000.0, at(), 4950.0),
        (ConversionGain(2.0), 100.0, at(gain_db=SIX_DB), 100.0),
        (FullWellSaturation(8000.0), 9000.0, at(), 8000.0),
        (FullWellSaturation(8000.0), 7000.0, at(), 7000.0),
        (FirstFrameOffset(0.5), 100.0, at(frame_index=0), 100.5),
        (FirstFrameOffset(0.5), 100.0, at(frame_index=3), 100.0),
        (Lens(transmittance=0.9), 1.0, at(f_number=4.0), math.pi * 0.9 / 64.0),
        (Lens(magnification=0.5, pupil_magnification=2.0), 1.0, at(f_number=4.0), math.pi / 100.0),
    ],
)  # fmt: skip
def test_a_signal_behind_an_effect(effect: Any, signal: float, context: ExposureContext, expected: float) -> None:
    """An even signal comes out even."""
    found = np.asarray(effect.mean(np.full((3, 4), signal), context))
    assert np.mean(found) == pytest.approx(expected, rel=1e-6)


def test_a_field_falls_off_by_the_fourth_power_of_the_cosine() -> None:
    """Where tan α is 1 a quarter is left; with half the law, five eighths."""
    geometry = FrameGeometry.of_image(800, 600)
    context = replace(at(f_number=4.0), geometry=geometry)
    far_mm = float(np.max(geometry.radius_um())) / 1000.0
    for share, left in ((1.0, 1.0 / 4.0), (0.5, 5.0 / 8.0)):
        lit = np.asarray(Lens(focal_length_mm=far_mm, cos4=share).mean(np.ones((600, 800)), context))
        assert np.min(lit) == pytest.approx(math.pi / 64.0 * left, rel=1e-6)
        assert np.max(lit) == pytest.approx(math.pi / 64.0, rel=1e-4)


@pytest.mark.parametrize("kind", [PwmFlicker, MainsRipple])
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
    effect = HotPixels(share=0.01, rate_e_per_s=10.0, reference_C=25.0, doubling_K=7.0)
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


def _unsteady(frames: Any, counting: Any) -> Any:
    """Return which pixels of some frames scatter far more than those that count, themselves left out of these."""
    scatter = frames.var(axis=0, ddof=1)
    far = scatter > unsteady_from(len(frames)) * scatter[counting].mean()
    return scatter > unsteady_from(len(frames)) * scatter[counting & ~far].mean()


def test_jumping_pixels_are_counted_and_scatter_as_drawn_ones() -> None:
    """5 % of the pixels jump by 20 e⁻ on average, with 3 e⁻ of noise, in four frames.

    The numbers of those whose time mean stands out by six sigmas, or that scatter far more, are predicted. So are the
    pattern without the former, and the noise without both.
    """
    effect = RandomTelegraphNoise(share=0.05, height_e=20.0)
    context = at(shutter="closed")
    rng = np.random.default_rng(5)
    even = np.zeros((400, 600))
    frames = np.array([effect.sample(even, context, rng) + 3.0 * rng.standard_normal(even.shape) for _ in range(4)])
    tiles: Any = _FourDarks(context.settings, context.geometry, CAMERA, LensDescription())
    before = replace(TileMoments.exactly(np.zeros((1, 1, 1))), variance=np.full((1, 1, 1), 9.0))
    predicted = effect.tile(before, before, tiles)
    out = np.abs(frames.mean(axis=0)) > 6.0 * 1.5
    restless = _unsteady(frames, ~out)
    scatter = frames.var(axis=0, ddof=1)[~out & ~restless]
    noise, jumps = scatter.mean(), scatter.mean() - 9.0
    for name, seen in (("outliers", out), ("unsteady", restless)):
        assert seen.sum() > 1000
        assert float(np.sum(getattr(predicted, name))) == pytest.approx(float(seen.sum()), rel=0.05), name
    assert float(np.sum(predicted.variance)) == pytest.approx(noise, rel=0.02)
    chance = (2.0 * 9.0**2 + 4.0 * 9.0 * jumps) / 3.0 - jumps**2  # of a variance of four values that jump
    assert float(np.sum(predicted.uneven_noise)) == pytest.approx(np.sqrt(scatter.var() - chance), rel=0.1)
    of_mean = float(np.sum(predicted.spatial_variance + predicted.variance / 4.0))
    assert of_mean == pytest.approx(float(np.var(frames.mean(axis=0)[~out])), rel=0.03)


@pytest.mark.parametrize(
    "effect",
    [
        HotPixels(share=0.05, rate_e_per_s=100.0),
        DarkCurrentNonuniformity(sigma_e_per_s=30.0, shape=1.0),
    ],
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
        float(_unsteady(frames, counting).sum()), rel=0.25
    )


def test_taps_that_are_no_quarters_have_a_size_each() -> None:
    """Four taps of one column each, of sizes 0, 1, 2 and 5 %: gains of −2, −1, 0 and 3 % about their mean."""
    taps = tuple(TapDescription(name=str(x), x=x, y=0, width=1, height=3) for x in range(4))
    context = replace(at(), camera=CAMERA.model_copy(update={"taps": taps}))
    (cover,) = TapGain.covers(context)
    assert cover.free() == ("taps_rel[1]", "taps_rel[2]", "taps_rel[3]")
    known = replace(cover, taps_rel=(0.0, 0.01, 0.02, 0.05))
    np.testing.assert_allclose(known.mean(np.full((3, 4), 100.0), context), [[98.0, 99.0, 100.0, 103.0]] * 3)
    for table, added in (((4.0, 1.0, 1.0, 9.0),) * 2, ((0.0, -3.0, -3.0, 5.0), (3.0, 0.0, 0.0, 8.0))):  # none below 0
        noisy = replace(TapNoise(), taps_e2=table)
        np.testing.assert_allclose(noisy.variance(np.full((3, 4), 100.0), context), [added] * 3)
    halves = (taps[0].model_copy(update={"width": 2}), taps[2].model_copy(update={"width": 2}))
    assert TapGain.covers(replace(context, camera=CAMERA.model_copy(update={"taps": halves}))) == ()


def test_leaks_that_differ_are_drawn_with_the_spread_that_is_stated() -> None:
    """30 e⁻/s for 2 s at the stated temperature: 60 e⁻ of scatter and no mean, in the same pixels each time."""
    effect = DarkCurrentNonuniformity(sigma_e_per_s=30.0, reference_C=25.0, shape=0.4)
    context = replace(at(2.0, temperature_c=25.0), geometry=FrameGeometry.of_image(400, 300))
    drawn = np.asarray(effect.sample(np.full((300, 400), 1e4), context, np.random.default_rng(1))) - 1e4
    assert drawn.std() == pytest.approx(60.0, rel=0.02)
    assert drawn.mean() == pytest.approx(0.0, abs=4 * 60.0 / math.sqrt(drawn.size))
    again = np.asarray(effect.sample(np.full((300, 400), 1e4), context, np.random.default_rng(2))) - 1e4
    np.testing.assert_array_equal(again, drawn)


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
    assert NominalSettings.usable(context_of(FrameSettings(np.array(times_s)))) is usable


def test_a_printed_stop_gives_the_light_of_the_exact_one():
    """1/60 s at f/5.6 is 1/64 s at f/5.657; time and stop each by their own switch."""
    context = context_of(FrameSettings(1 / 60, f_number=5.6))
    time, stop = 60 / 64, (5.6 / 2**2.5) ** 2
    for times, stops, factor in ((1.0, 1.0, time * stop), (1.0, 0.0, time), (0.0, 1.0, stop)):
        assert NominalSettings(times, stops).factor(context) == pytest.approx(factor)


FILLS = np.array([0.0, 0.3, 1.0, 1.2, 1.67, 3.0])


@pytest.mark.parametrize(("a2", "a3"), [(0.018, -0.0025), (-0.02, 0.0), (0.0, 0.004)])
def test_the_curve_goes_on_beyond_the_declared_full_well(a2: float, a3: float) -> None:
    """S·(1 − a₂·z − a₃·z²) at every fill: a full well that is declared too small makes no kink."""
    context, effect = effect_context(), ResponseNonlinearity(a2=a2, a3=a3)
    signal = FILLS * well_e(context)
    np.testing.assert_allclose(effect.mean(signal, context), signal * (1 - a2 * FILLS - a3 * FILLS**2), rtol=1e-12)
    np.testing.assert_allclose(effect.slope(signal, context), 1 - 2 * a2 * FILLS - 3 * a3 * FILLS**2, rtol=1e-12)


@pytest.mark.parametrize(("a2", "a3"), [(0.3, 0.0), (0.5, 0.5), (-0.2, 0.2), (-0.5, -0.5), (0.0, 0.0)])
def test_more_light_never_gives_less(a2: float, a3: float) -> None:
    """Where the polynomial would fall, the response stays; far beyond it goes straight on; no light stays none."""
    context, effect = effect_context(), ResponseNonlinearity(a2=a2, a3=a3)
    signal = np.linspace(-0.1, 40.0, 4001) * well_e(context)
    bent = effect.mean(signal, context)
    assert np.all(np.diff(bent) >= -1e-9 * well_e(context))
    np.testing.assert_allclose(bent[signal < 0], signal[signal < 0], rtol=1e-9)
    assert effect.mean(np.zeros(1), context).item() == 0.0


@pytest.mark.parametrize(("a2", "a3"), [(0.02, 0.01), (0.3, 0.1), (-0.1, 0.05)])
def test_the_slope_is_that_of_the_curve(a2: float, a3: float) -> None:
    """Differences of the curve over a thousandth of a full well, next to its ends too, to 2e-3."""
    context, effect = effect_context(), ResponseNonlinearity(a2=a2, a3=a3)
    step = 1e-3 * well_e(context)
    signal = np.linspace(0.01, 6.0, 600) * well_e(context)
    rise = (effect.mean(signal + step, context) - effect.mean(signal - step, context)) / (2 * step)
    np.testing.assert_allclose(effect.slope(signal, context), rise, atol=2e-3)


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=lambda kind: kind.name)
def test_no_range_is_a_number_of_codes_of_one_bit_depth(kind: type) -> None:
    """Every parameter in digital numbers has a range that is a share of the camera's full scale."""
    for known in kind.parameters():
        assert known.of_full_scale == known.unit.startswith("DN")


def test_a_deeper_converter_has_a_wider_range() -> None:
    """A black level of 16 bits may be off by up to 65535, one of 8 bits by up to 255."""
    offset = _known(BlackLevelOffset, "offset_dn")
    assert offset.bounds(65535.0) == pytest.approx((-65535.0, 65535.0))
    assert offset.bounds(255.0) == pytest.approx((-255.0, 255.0))


def test_ranges_in_other_units_stay() -> None:
    """What is no digital number has one range for all cameras."""
    exposure = _known(EFFECTS["exposure_time_offset"], "offset_s")
    assert exposure.bounds(65535.0) == (exposure.low, exposure.high)


def test_an_effect_may_be_tried_beyond_the_camera_s_own_codes() -> None:
    """A search steps a little beyond the highest code of 16 bits without being refused."""
    assert AdcSaturation(65535.0).with_parameters(clip_dn=70646.4).clip_dn == 70646.4


def _known(kind: type, name: str) -> Parameter:
    return next(entry for entry in kind.parameters() if entry.name == name)

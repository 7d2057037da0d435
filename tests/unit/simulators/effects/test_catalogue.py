"""Every entry of the catalogue as an effect of the forward model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from simulators.chain.camera_model import CameraModel
from simulators.effects.base import Moments, Stage
from simulators.effects.black_level_gain_slope import BlackLevelGainSlope
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext
from simulators.effects.exposure_label_error import ExposureLabelError
from simulators.effects.full_well_saturation import FullWellSaturation
from simulators.effects.image_lag import ImageLag
from simulators.effects.mechanical_vignetting import MechanicalVignetting, common_area
from simulators.effects.missing_codes import MissingCodes
from simulators.effects.pixel_mixing import (
    disc_edge_share,
    exchange_between_neighbours,
    exchange_moments,
    spread_over_disc,
)
from simulators.effects.quantisation import Quantisation
from simulators.effects.registry import EFFECTS
from simulators.effects.soft_saturation import SoftSaturation
from simulators.effects.tile_moments import TileMoments
from testing.effect_context import CATALOGUE, HEIGHT, WIDTH, effect_context, starts_of

FRAMES = 240
NAMES = """
black_level_offset black_level_gain_slope black_level_drift dark_current dark_current_clamped
dark_current_nonuniformity gain_step_error conversion_gain_error excess_read_noise missing_codes gamma_enabled
response_nonlinearity soft_saturation full_well_saturation adc_saturation column_pattern row_pattern
row_temporal_noise dsnu prnu hot_pixels image_lag brighter_fatter crosstalk parasitic_light_sensitivity
rolling_shutter_banding exposure_time_offset exposure_quantisation reciprocity_failure shutter_dead_time
natural_vignetting mechanical_vignetting display_nonuniformity veiling_glare stray_light_kernel ghost psf_blur
defocus fnumber_tstop_error angle_dependence polarisation spectral_mismatch source_warmup_drift
led_thermal_droop pwm_flicker mains_ripple display_gamma_error display_black_leak ambient_light_leak
quantum_efficiency_temperature nominal_settings exposure_label_error source_not_proportional_to_exposure
lamp_step first_frame_offset readout_dark_charge series_settling line_start_offset
correlated_read_noise row_dependent_exposure dark_frame_subtracted charge_transfer_inefficiency
random_telegraph_noise
""".split()  # noqa: SIM905

# Those whose flexible forms need no further settings than those of one frame.
FLEXIBLE = """
ambient_light_leak black_level_drift black_level_offset crosstalk dark_current_clamped defocus display_gamma_error
adc_saturation full_well_saturation display_nonuniformity ghost mechanical_vignetting natural_vignetting
angle_dependence
parasitic_light_sensitivity quantum_efficiency_temperature veiling_glare image_lag source_warmup_drift soft_saturation
black_level_gain_slope
""".split()  # noqa: SIM905


def _radiance(context: ExposureContext) -> float:
    model = CameraModel.ideal(context.camera, context.lens)
    flat = np.ones((HEIGHT, WIDTH))
    electrons = model.mean(flat, context, until=Stage.WELL).mean()
    return 3000.0 / float(electrons)


def test_the_catalogue_is_whole():
    """Every canonical name of the catalogue is an effect that a model file can hold."""
    assert set(NAMES) <= set(EFFECTS)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_entry_simulates_what_its_moments_say(name):
    """Frames through the whole chain have the expected mean: within 5 sigma of the mean over pixels and frames."""
    _check_mean(starts_of(CATALOGUE[name], effect_context())[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", FLEXIBLE)
def test_flexible_form_simulates_what_its_moments_say(name):
    """The same holds for the forms that an entry takes where its plain one leaves structure."""
    form = starts_of(CATALOGUE[name], effect_context())[0].loosened(effect_context())[0]
    assert len(form.free()) >= len(CATALOGUE[name].fitted)
    _check_mean(form)


def _check_mean(effect: CatalogueEffect) -> None:
    name, context = effect.name, effect_context()
    model = CameraModel.ideal(context.camera, context.lens).with_effect(effect)
    scene = np.full((HEIGHT, WIDTH), _radiance(context))
    expected = model.moments(scene, context)
    total = np.zeros((HEIGHT, WIDTH))
    for frame in range(FRAMES):
        total += model.sample(scene, context, (frame,)).dn
    common = float(np.max(np.broadcast_to(expected.common_variance, total.shape)))
    spread = expected.variance / FRAMES + expected.spatial_variance
    sigma = np.sqrt(np.mean(spread) / total.size + common / FRAMES)
    lines = np.sqrt(np.mean(expected.spatial_variance) / min(HEIGHT, WIDTH) + np.mean(expected.variance) / FRAMES / 24)
    allowed = (
        5 * sigma + (5 * lines if "row" in name or "column" in name else 0.0) + 2e-4 * float(total.mean() / FRAMES)
    )
    assert float(total.mean()) / FRAMES == pytest.approx(float(np.mean(expected.mean)), abs=allowed)


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_entry_says_what_reconcile_needs(name):
    """Each names a covariate, a statistic, the capture that settles it, and only parameters that exist."""
    kind = CATALOGUE[name]
    assert kind.where
    assert kind.settles
    starts = starts_of(kind, effect_context())
    for effect in (*starts, *kind.covers(effect_context()), *starts[0].loosened(effect_context())):
        known = {entry.name for entry in effect.parameters()}
        assert {entry.split("[")[0] for entry in effect.free()} <= known


@pytest.mark.parametrize("name", ["exposure_time_offset", "veiling_glare", "gamma_enabled", "dsnu", "crosstalk"])
def test_switched_off_effect_changes_nothing(name):
    """A model whose added effect is switched off gives the frames of the model without it."""
    context = effect_context()
    plain = CameraModel.ideal(context.camera, context.lens)
    effect = starts_of(CATALOGUE[name], context)[0]
    scene = np.full((HEIGHT, WIDTH), _radiance(context)) * np.linspace(0.2, 1.0, WIDTH)
    switched = plain.with_effect(effect).without_effect(name)
    np.testing.assert_array_equal(switched.sample(scene, context, (1,)).dn, plain.sample(scene, context, (1,)).dn)
    assert not np.array_equal(
        plain.with_effect(effect).sample(scene, context, (1,)).dn, plain.sample(scene, context, (1,)).dn
    )


def test_area_common_to_two_circles_is_what_points_thrown_at_them_say():
    """The pupil that a barrel leaves free agrees with a million points of a grid to 1e-3 of the pupil."""
    axis = (np.arange(1000) + 0.5) / 500 - 1
    x, y = np.meshgrid(axis, axis)
    for pupil, barrel, apart in ((1.0, 1.2, 0.5), (1.0, 0.8, 0.1), (1.0, 0.8, 0.6), (0.7, 0.7, 0.0), (0.5, 0.4, 1.0)):
        inside = (np.hypot(x, y) <= pupil) & (np.hypot(x - apart, y) <= barrel)
        expected = 4.0 * np.count_nonzero(inside) / axis.size**2
        assert float(common_area(pupil, barrel, apart)) == pytest.approx(expected, abs=1e-3 * pupil**2)


def test_disc_carries_across_an_edge_what_its_image_shows():
    """The share of a step in the last line before it, of a picture spread over a disc, is the predicted one to 4e-3."""
    step = np.repeat(np.where(np.arange(WIDTH) < WIDTH // 2, 0.0, 1.0)[None, :], HEIGHT, axis=0)
    for radius in (0.4, 0.8, 1.5, 3.0):
        before = float(spread_over_disc(step, radius, effect_context())[HEIGHT // 2, WIDTH // 2 - 1])
        assert before == pytest.approx(float(disc_edge_share(radius)), abs=4e-3)


def test_uneven_exchange_changes_noise_as_its_moments_say():
    """White noise mixed by 2 % along rows and 1 % along columns has the variance and covariances of the moments."""
    noise = 100.0 * np.random.default_rng(1).standard_normal((600, 600))
    mixed = exchange_between_neighbours(noise, 0.02, -0.01)
    one = np.ones((1, 1, 1))
    predicted = exchange_moments(replace(TileMoments.exactly(one), variance=1e4 * one), 0.02 * one, 1.0, -0.01)
    assert mixed.var() == pytest.approx(float(np.ravel(predicted.variance)[0]), rel=5 * (2 / noise.size) ** 0.5)
    across, down = (mixed[:, 1:] * mixed[:, :-1]).mean(), (mixed[1:] * mixed[:-1]).mean()
    assert across == pytest.approx(float(np.ravel(predicted.neighbour_x)[0]), abs=5 * 1e4 / 600)
    assert down == pytest.approx(float(np.ravel(predicted.neighbour_y)[0]), abs=5 * 1e4 / 600)


def test_barrel_spares_a_circle_that_grows_with_the_f_number():
    """Behind a barrel of radius b the light is whole where s·ρ + 2/N ≤ b, and falls towards the corner."""
    effect = MechanicalVignetting(strength=0.0, barrel=0.5, shift=0.3)
    context = effect_context()
    rho = context.geometry.field_radius()
    factor = np.asarray(effect.factor(context))
    whole = 0.3 * rho + 2.0 / 5.6 <= 0.5
    np.testing.assert_allclose(factor[whole], 1.0, atol=1e-9)
    assert np.all(factor[~whole] < 1.0)
    open_wide = replace(context, settings=replace(context.settings, f_number=4.0))
    assert np.all(np.asarray(effect.factor(open_wide))[~whole] < factor[~whole])


@pytest.mark.parametrize("mean_e", [9300.0, 9450.0, 9700.0])
def test_uneven_wells_leave_the_moments_of_pixels_that_differ(mean_e):
    """Pixels with wells of their own, drawn one by one: mean, noise and fixed pattern are those that are predicted."""
    rng, pixels, frames = np.random.default_rng(3), 20_000, 12
    wells = 9450.0 * (1.0 + 0.01 * rng.standard_normal(pixels))
    seen = np.minimum(mean_e + np.sqrt(mean_e) * rng.standard_normal((frames, pixels)), wells)
    nothing = np.zeros(1)
    before = Moments(np.array([mean_e]), np.array([mean_e]), nothing, nothing)
    expected = FullWellSaturation(9450.0, 0.01).moments(before, effect_context())
    of_pixels, noise = seen.mean(axis=0), seen.var(axis=0, ddof=1)
    assert float(of_pixels.mean()) == pytest.approx(float(expected.mean[0]), abs=5 * of_pixels.std() / pixels**0.5)
    assert float(noise.mean()) == pytest.approx(float(expected.variance[0]), abs=5 * noise.std() / pixels**0.5)
    scatter = np.square(of_pixels - of_pixels.mean()) - noise / frames
    fixed = float(np.asarray(expected.spatial_variance)[0])
    assert float(scatter.mean()) == pytest.approx(fixed, abs=5 * scatter.std() / pixels**0.5)


@pytest.mark.parametrize(("step", "kept", "added"), [(4, 1, 0), (4, 1, 2), (5, 1, 2), (4, 3, 0), (16, 15, 0)])
@pytest.mark.parametrize("mean_dn", [240.3, 241.9])
def test_missing_codes_leave_the_moments_of_the_codes_that_occur(step, kept, added, mean_dn):
    """Rounded normal values, drawn one by one and freed of the missing codes, have the mean and noise predicted."""
    rng, count, sigma = np.random.default_rng(4), 400_000, 1.1
    effect = MissingCodes(float(step), float(kept), float(added))
    codes = effect.mean(np.rint(mean_dn + sigma * rng.standard_normal(count)), effect_context())
    assert set(np.unique(codes % step)) <= set(range(kept))
    nothing = np.zeros(1)
    before = Moments(np.array([mean_dn]), np.array([sigma**2]), nothing, nothing)
    expected = effect.moments(Quantisation().moments(before, effect_context()), effect_context())
    assert float(codes.mean()) == pytest.approx(float(expected.mean[0]), abs=5 * codes.std() / count**0.5)
    square = np.square(codes - codes.mean())
    assert float(square.mean()) == pytest.approx(float(expected.variance[0]), abs=5 * square.std() / count**0.5)


def test_dead_time_spares_the_first_frame():
    """Frame 0 of a run has its whole exposure, the next one is shorter by the dead time."""
    effect = EFFECTS["shutter_dead_time"](dead_time_s=1e-4)  # type: ignore[call-arg]
    signal = np.ones((HEIGHT, WIDTH))
    first, second = (effect.mean(signal, replace(effect_context(), frame_index=i)).mean() for i in (0, 1))
    assert first == 1.0
    assert second == pytest.approx(1 - 1e-4 * 60)


def test_dead_time_beyond_the_exposure_leaves_nothing():
    """No frame loses more than its light: 20 ms of 1/60 s are all of it, for one frame and for the mean of a run."""
    effect = EFFECTS["shutter_dead_time"](dead_time_s=0.01)  # type: ignore[call-arg]
    short = replace(effect_context(), settings=replace(effect_context().settings, exposure_s=1e-3), frame_index=1)
    assert effect.mean(np.ones((HEIGHT, WIDTH)), short).max() == 0.0


def test_lag_of_traps_fills_up_and_no_pixel_leaves_more_than_its_well():
    """Traps of 20 electrons release 20·(1 − exp(−l·S/20)); a frame beyond full well leaves what the well held."""
    well = effect_context().camera.full_well_e
    assert well is not None
    held = np.array([[500.0, 5000.0, 2.0 * well]])
    context = replace(effect_context(), previous_e=held)
    nothing = np.zeros((1, 3))
    plain = ImageLag(share=0.002).mean(nothing, context)
    np.testing.assert_allclose(plain, [[1.0, 10.0, 0.002 * well]])
    filling = ImageLag(share=0.002, fullness_per_e=1 / 20).mean(nothing, context)
    np.testing.assert_allclose(filling, 20.0 * (1.0 - np.exp(-plain / 20.0)))


def _at(exposure_s: float, timestamp_s: float) -> ExposureContext:
    base = effect_context()
    return replace(base, settings=replace(base.settings, exposure_s=exposure_s, timestamp_s=timestamp_s))


def test_label_is_wrong_for_the_captures_that_are_meant():
    """A label may lie for one capture and tell the truth for another of the same exposure; wrong labels add up."""
    single = ExposureLabelError(0.01, 1.25, from_s=50.0, to_s=70.0)
    assert float(single.factor(_at(0.01, 60.0))) == 1.25
    assert float(single.factor(_at(0.01, 80.0))) == 1.0
    both = single.joined(ExposureLabelError(0.02, 0.8))
    assert isinstance(both, ExposureLabelError)
    assert [float(both.factor(_at(t, s))) for t, s in ((0.01, 60.0), (0.01, 80.0), (0.02, 80.0))] == [1.25, 1.0, 0.8]
    assert both.free() == ("ratio", "further_ratios[0]")


@pytest.mark.parametrize("form", [{"hardness": 1.0}, {"hardness": 2.0}, {"charging": 1.0}])
def test_soft_saturation_is_never_a_clip(form):
    """Wherever the ceiling is put, light one percent of the full well above the knee still counts for a part."""
    effect = SoftSaturation(knee=0.8, ceiling=0.5, **form)
    above = np.array([0.80, 0.81]) * 10_500.0
    kept = np.diff(np.asarray(effect.mean(above, effect_context())))[0] / np.diff(above)[0]
    assert 0.5 < kept < 0.95
    rise = np.asarray(effect.slope(above, effect_context()))
    assert rise[0] == pytest.approx(1.0)
    assert 0.2 < rise[1] < kept


def test_looser_knee_follows_a_law_that_no_plain_one_follows():
    """Of a knee of hardness 1.4 one of a free hardness leaves nothing, one of 2 leaves 0.2 % of the well."""
    light = np.linspace(0.5, 1.3, 81) * 10_500.0
    true = np.asarray(SoftSaturation(0.67, 1.05, 1.4).mean(light, effect_context()))

    def misfit(form: SoftSaturation) -> float:
        def left(values: Any) -> Any:
            moved = form.with_parameters(**dict(zip(form.free(), values.tolist(), strict=True)))
            return (np.asarray(moved.mean(light, effect_context())) - true) / 10_500.0

        found = least_squares(left, [getattr(form, name) for name in form.free()], bounds=(0.5, 1.9), x_scale=0.1)
        return float(np.max(np.abs(found.fun)))

    plain = SoftSaturation(0.7, 1.0)
    free, charging = plain.loosened(effect_context())
    assert misfit(free) < 1e-4
    assert misfit(plain) > 2e-3
    assert charging.charging
    assert charging.free() == plain.free() == ("knee", "ceiling")
    assert [form.free() for form in charging.loosened(effect_context())] == [("knee", "ceiling", "hardness")]


def test_amplified_offset_may_bend_with_the_gain():
    """An offset of 0.5 DN with a bend of −0.02 adds 0.5·(9 − 0.02·81) DN at a gain of ten, and nothing at 0 dB."""
    base = effect_context()
    gains: Any = np.array([0.0, 20.0])
    context = replace(base, settings=replace(base.settings, gain_db=gains))
    *_, bent = BlackLevelGainSlope(0.5).loosened(context)
    assert bent.free() == ("slope_dn", "bend")
    np.testing.assert_allclose(bent.with_parameters(bend=-0.02).offset(context), [0.0, 0.5 * (9 - 0.02 * 81)])


# These mix pixels or codes, or leave what the light brings to the responsivity: each has a test of its own.
APART = {"brighter_fatter", "charge_transfer_inefficiency", "crosstalk", "conversion_gain_error", "missing_codes"}
NEEDS_A_PICTURE = {"ghost", "stray_light_kernel"}


def _grown(effect: CatalogueEffect, field: str) -> Any:
    """Return by how much of 7 units more of a kind of noise more of it is left behind an effect."""
    amounts = {name: np.full((1, 1, 1), 50.0 + 4.0 * n) for n, name in enumerate(TileMoments.squared)}
    before = replace(TileMoments.exactly(np.full((1, 1, 1), 900.0)), first_excess=np.full((1, 1, 1), 3.0), **amounts)
    more = replace(before, **{field: getattr(before, field) + 7.0})
    left, rest = (np.asarray(getattr(effect.moments(moments, effect_context()), field)) for moments in (more, before))
    return np.mean(left - rest) / 7.0


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_no_form_is_loosened_to_itself(name):
    """From every size that is tried, and once more from what comes of it: each looser form is another one."""
    context = effect_context()
    for start in starts_of(CATALOGUE[name], context):
        for form in (start, *start.loosened(context)):
            assert form not in form.loosened(context)


@pytest.mark.parametrize("name", sorted(CATALOGUE.keys() - APART - NEEDS_A_PICTURE))
def test_noise_from_before_passes_by_the_slope(name):
    """Variances and covariances by its square, differences of means by itself, shares and counts as they are."""
    effect = starts_of(CATALOGUE[name], effect_context())[0]
    slope = np.asarray(effect.slope(np.full((1, 1, 1), 900.0), effect_context()))
    for field in TileMoments.squared:
        assert _grown(effect, field) == pytest.approx(np.mean(slope**2), rel=1e-9), field
    assert _grown(effect, "first_excess") == pytest.approx(np.mean(slope), rel=1e-9)
    for field in ("edge_share", "outliers", "unsteady"):
        assert _grown(effect, field) == pytest.approx(1.0, rel=1e-9), field


@pytest.mark.parametrize("name", sorted(CATALOGUE.keys() - NEEDS_A_PICTURE - {"missing_codes", "veiling_glare"}))
def test_the_slope_is_that_of_the_mean(name):
    """The derivative of what an effect makes of an even signal, by differences, over all pixels.

    Glare goes by the mean of the frame, and what is reported of it is one pixel's part.
    """
    effect, context = starts_of(CATALOGUE[name], effect_context())[0], effect_context()
    for signal in (40.0, 900.0, 3000.0):
        even = np.full((HEIGHT, WIDTH), signal)
        high, low = (np.asarray(effect.mean(even + way, context)) for way in (0.5, -0.5))
        reported = np.broadcast_to(np.asarray(effect.slope(even, context)), high.shape)
        assert np.mean(high - low) == pytest.approx(np.mean(reported), rel=2e-3, abs=1e-4), signal

"""Every entry of the catalogue as an effect of the forward model; free laws; effects drawn by hand."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.signal import fftconvolve

from radiometer.data import CameraDescription, FrameSettings
from simulators.chain.camera_model import CameraModel
from simulators.effects.base import Moments, Stage
from simulators.effects.brighter_fatter import BrighterFatter, push_of
from simulators.effects.catalogue import well_e
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.free_law import axis_values, freed
from simulators.effects.mechanical_vignetting import MechanicalVignetting, common_area
from simulators.effects.pixel_mixing import (
    disc_edge_share,
    exchange_between_neighbours,
    exchange_moments,
    spread_over_disc,
)
from simulators.effects.registry import EFFECTS, EffectEntry, make_effect
from simulators.effects.tile_moments import TileMoments
from testing import effect_kinds as fx
from testing.effect_context import CATALOGUE, HEIGHT, WIDTH, effect_context, starts_of

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


def _radiance(context):
    model = CameraModel.ideal(context.camera, context.lens)
    flat = np.ones((HEIGHT, WIDTH))
    electrons = model.mean(flat, context, until=Stage.WELL).mean()
    return 3000.0 / float(electrons)


def test_the_catalogue_is_whole():
    """Every canonical name of the catalogue is an effect that a model file can hold."""
    assert set(NAMES) <= set(EFFECTS)


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_entries_say_what_reconcile_needs(name):
    """A covariate, a statistic, what settles it, parameters that exist; no form is loosened to itself."""
    kind = CATALOGUE[name]
    assert kind.where
    assert kind.settles
    starts = starts_of(kind, effect_context())
    for effect in (*starts, *kind.covers(effect_context()), *starts[0].loosened(effect_context())):
        known = {entry.name for entry in effect.parameters()}
        assert {entry.split("[")[0] for entry in effect.free()} <= known
    context = effect_context()
    for start in starts_of(CATALOGUE[name], context):
        for form in (start, *start.loosened(context)):
            assert form not in form.loosened(context)


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


def test_pictures_of_circles_show_the_predicted_areas():
    """Two pupils by a million points to 1e-3; the edge of a disc to 4e-3."""
    axis = (np.arange(1000) + 0.5) / 500 - 1
    x, y = np.meshgrid(axis, axis)
    for pupil, barrel, apart in ((1.0, 1.2, 0.5), (1.0, 0.8, 0.1), (1.0, 0.8, 0.6), (0.7, 0.7, 0.0), (0.5, 0.4, 1.0)):
        inside = (np.hypot(x, y) <= pupil) & (np.hypot(x - apart, y) <= barrel)
        expected = 4.0 * np.count_nonzero(inside) / axis.size**2
        assert float(common_area(pupil, barrel, apart)) == pytest.approx(expected, abs=1e-3 * pupil**2)
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


@pytest.mark.parametrize(("step", "kept", "added"), [(4, 1, 0), (4, 1, 2), (5, 1, 2), (4, 3, 0), (16, 15, 0)])
@pytest.mark.parametrize("mean_dn", [240.3, 241.9])
def test_missing_codes_leave_the_moments_of_the_codes_that_occur(step, kept, added, mean_dn):
    """Rounded normal values, drawn one by one and freed of the missing codes, have the mean and noise predicted."""
    rng, count, sigma = np.random.default_rng(4), 400_000, 1.1
    effect = fx.MissingCodes(float(step), float(kept), float(added))
    codes = effect.mean(np.rint(mean_dn + sigma * rng.standard_normal(count)), effect_context())
    assert set(np.unique(codes % step)) <= set(range(kept))
    nothing = np.zeros(1)
    before = Moments(np.array([mean_dn]), np.array([sigma**2]), nothing, nothing)
    expected = effect.moments(fx.Quantisation().moments(before, effect_context()), effect_context())
    assert float(codes.mean()) == pytest.approx(float(expected.mean[0]), abs=5 * codes.std() / count**0.5)
    square = np.square(codes - codes.mean())
    assert float(square.mean()) == pytest.approx(float(expected.variance[0]), abs=5 * square.std() / count**0.5)


def test_dead_time_spares_the_first_frame_and_takes_no_more_than_the_light():
    """The next is shorter by it; 20 ms of 1/60 s are all."""
    effect = EFFECTS["shutter_dead_time"](dead_time_s=1e-4)  # type: ignore[call-arg]
    signal = np.ones((HEIGHT, WIDTH))
    first, second = (effect.mean(signal, replace(effect_context(), frame_index=i)).mean() for i in (0, 1))
    assert first == 1.0
    assert second == pytest.approx(1 - 1e-4 * 60)
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
    plain = fx.ImageLag(share=0.002).mean(nothing, context)
    np.testing.assert_allclose(plain, [[1.0, 10.0, 0.002 * well]])
    filling = fx.ImageLag(share=0.002, fullness_per_e=1 / 20).mean(nothing, context)
    np.testing.assert_allclose(filling, 20.0 * (1.0 - np.exp(-plain / 20.0)))


def _at(exposure_s, timestamp_s):
    base = effect_context()
    return replace(base, settings=replace(base.settings, exposure_s=exposure_s, timestamp_s=timestamp_s))


def test_label_is_wrong_for_the_captures_that_are_meant():
    """A label may lie for one capture and tell the truth for another of the same exposure; wrong labels add up."""
    single = fx.ExposureLabelError(0.01, 1.25, from_s=50.0, to_s=70.0)
    assert float(single.factor(_at(0.01, 60.0))) == 1.25
    assert float(single.factor(_at(0.01, 80.0))) == 1.0
    both = single.joined(fx.ExposureLabelError(0.02, 0.8))
    assert [float(both.factor(_at(t, s))) for t, s in ((0.01, 60.0), (0.01, 80.0), (0.02, 80.0))] == [1.25, 1.0, 0.8]
    assert both.free() == ("ratio", "further_ratios[0]")


@pytest.mark.parametrize("form", [{"hardness": 1.0}, {"hardness": 2.0}, {"charging": 1.0}])
def test_soft_saturation_is_never_a_clip(form):
    """Wherever the ceiling is put, light one percent of the full well above the knee still counts for a part."""
    effect = fx.SoftSaturation(knee=0.8, ceiling=0.5, **form)
    above = np.array([0.80, 0.81]) * 10_500.0
    kept = np.diff(np.asarray(effect.mean(above, effect_context())))[0] / np.diff(above)[0]
    assert 0.5 < kept < 0.95
    rise = np.asarray(effect.slope(above, effect_context()))
    assert rise[0] == pytest.approx(1.0)
    assert 0.2 < rise[1] < kept


def test_looser_knee_follows_a_law_that_no_plain_one_follows():
    """Of a knee of hardness 1.4 one of a free hardness leaves nothing, one of 2 leaves 0.2 % of the well."""
    light = np.linspace(0.5, 1.3, 81) * 10_500.0
    true = np.asarray(fx.SoftSaturation(0.67, 1.05, 1.4).mean(light, effect_context()))

    def misfit(form):
        def left(values):
            moved = form.with_parameters(**dict(zip(form.free(), values.tolist(), strict=True)))
            return (np.asarray(moved.mean(light, effect_context())) - true) / 10_500.0

        found = least_squares(left, [getattr(form, name) for name in form.free()], bounds=(0.5, 1.9), x_scale=0.1)
        return float(np.max(np.abs(found.fun)))

    plain = fx.SoftSaturation(0.7, 1.0)
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
    *_, bent = fx.BlackLevelGainSlope(0.5).loosened(context)
    assert bent.free() == ("slope_dn", "bend")
    np.testing.assert_allclose(bent.with_parameters(bend=-0.02).offset(context), [0.0, 0.5 * (9 - 0.02 * 81)])


# These mix pixels or codes, or leave what the light brings to the responsivity: each has a test of its own.
APART = {"brighter_fatter", "charge_transfer_inefficiency", "crosstalk", "conversion_gain_error", "missing_codes"}
NEEDS_A_PICTURE = {"ghost", "stray_light_kernel"}


def _grown(effect, field):
    """Return by how much of 7 units more of a kind of noise more of it is left behind an effect."""
    amounts = {name: np.full((1, 1, 1), 50.0 + 4.0 * n) for n, name in enumerate(TileMoments.squared)}
    before = replace(TileMoments.exactly(np.full((1, 1, 1), 900.0)), first_excess=np.full((1, 1, 1), 3.0), **amounts)
    more = replace(before, **{field: getattr(before, field) + 7.0})
    left, rest = (np.asarray(getattr(effect.moments(moments, effect_context()), field)) for moments in (more, before))
    return np.mean(left - rest) / 7.0


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


# Free laws, and samples of one effect.


def _context(**settings):
    own = FrameSettings(**({"exposure_s": 0.01, "gain_db": 0.0, "black_level_dn": 100.0} | settings))
    camera = CameraDescription(bit_depth=12, full_well_e=10_000.0)
    return ExposureContext(own, FrameGeometry.of_image(8, 6), camera)


def _free(plain, law, **knots):
    kind = freed(type(plain), tuple(knots))
    return kind(**plain.values(), law=law, **{f"at_{axis}": at for axis, at in knots.items()})


def test_a_law_of_ones_is_the_effects_own_and_model_files_hold_it():
    """Mean, variances and name; what is written is read again."""
    plain = fx.ResponseNonlinearity(0.02)
    free = _free(plain, (1.0, 1.0, 1.0), signal=(10.0, 1000.0, 10_000.0))
    before = TileMoments.exactly(np.array([[[50.0, 900.0, 4000.0, 9000.0]]]))
    before = replace(before, variance=before.mean + 4.0, first_excess=0.01 * before.mean)
    own, other = plain.moments(before, _context()), free.moments(before, _context())
    for name in ("mean", "variance", "first_excess"):
        assert getattr(other, name) == pytest.approx(getattr(own, name), rel=1e-5)
    assert free.name == "response_nonlinearity"
    free = _free(fx.ExposureTimeOffset(1e-4), (0.5, 2.0), exposure_s=(1e-3, 1e-2))
    again = EffectEntry.from_mapping(EffectEntry(free).to_mapping(), "here").effect
    assert again == free
    assert make_effect("exposure_time_offset", {"offset_s": 1e-4}) == fx.ExposureTimeOffset(1e-4)


def test_a_law_goes_through_its_knots_along_one_and_two_covariates():
    """Between them between, in octaves; beyond them as at the last."""
    free = _free(fx.ExposureTimeOffset(1e-4), (0.5, 2.0), exposure_s=(1e-3, 1e-2))
    lost = {}
    for exposure_s in (1e-4, 1e-3, 10**-2.5, 1e-2, 1.0):
        signal = np.full((2, 2), 1000.0)
        lost[exposure_s] = (free.mean(signal, _context(exposure_s=exposure_s))[0, 0] / 1000.0 - 1.0) * exposure_s
    assert list(lost.values()) == pytest.approx([0.5e-4, 0.5e-4, 1.25e-4, 2e-4, 2e-4], rel=1e-9)
    plain = MechanicalVignetting(0.2, 2.0)
    free = _free(plain, (1.0, 3.0, 1.0, 3.0), field_radius=(0.0, 1.0), f_number=(2.0, 8.0))
    signal = np.full((6, 8), 100.0)
    for stop, factor in ((2.0, 1.0), (4.0, 2.0), (8.0, 3.0)):
        context = _context(f_number=stop)
        change = plain.mean(signal, context) - signal
        assert free.mean(signal, context) - signal == pytest.approx(factor * change)


def test_a_law_scatters_by_its_own_slope():
    """By the curve's part too; a factor of 4 on an added noise is four times its variance."""
    free = _free(fx.ResponseNonlinearity(0.1), (0.0, 1.0, 3.0), signal=(10.0, 1000.0, 10_000.0))
    signal = np.array([300.0, 2000.0, 7000.0])
    before = Moments(signal, np.ones(3), np.zeros(3), np.zeros(3))
    rise = (free.mean(signal + 0.5, _context()) - free.mean(signal - 0.5, _context())) / 1.0
    assert free.moments(before, _context()).variance == pytest.approx(rise**2, rel=1e-3)
    plain = fx.ExcessReadNoise(3.0)
    free = _free(plain, (4.0, 4.0), gain_db=(0.0, 12.0))
    signal = np.full((200, 200), 500.0)
    drawn = free.sample(signal, _context(), np.random.default_rng(6))
    assert np.var(drawn) == pytest.approx(36.0, rel=0.02)
    assert np.max(free.moments(Moments.exactly(signal), _context()).variance) == pytest.approx(36.0)


@pytest.mark.parametrize(
    ("plain", "highest"),
    [
        (fx.StrayLightKernel(0.25), 2.0),  # at most half of the light is scattered
        (fx.StrayLightKernel(0.5), 1.0),  # as much as the entry allows already
        (fx.ExposureTimeOffset(-1e-4), 100.0),  # the end of its range lies farther off than any law goes
        (fx.GammaEnabled(2.0), 4.0),  # from 1, which does nothing, to 5
    ],
)
def test_no_law_goes_beyond_the_entrys_own_bounds(plain, highest):
    """The factor ends where the plain effect's first parameter would."""
    free = _free(plain, (1.0, 1.0), signal=(10.0, 1000.0))
    assert free.reach("law", 4095.0) == (0.0, pytest.approx(highest))
    assert free.reach(plain.free()[0], 4095.0) == plain.reach(plain.free()[0], 4095.0)


@pytest.mark.parametrize(("unit", "well_e", "added"), [
    ("e-", 10_000.0, 10.0), ("e-", 50_000.0, 50.0), ("e-", None, 10.0), ("DN", None, 4.095), ("W m-2", None, 0.0),
])  # fmt: skip
def test_a_signal_counts_from_black_on_with_a_thousandth_of_its_range(unit, well_e, added):
    """Of the full well, 10 000 e⁻ where not stated, or of full scale; black is taken off digital numbers only."""
    context = replace(_context(), camera=CameraDescription(bit_depth=12, full_well_e=well_e))
    kinds = {"e-": fx.ImageLag, "DN": fx.BlackLevelOffset, "W m-2": fx.NaturalVignetting}
    effect = kinds[unit]()
    assert effect.unit_in == unit
    black = 100.0 if unit == "DN" else 0.0
    found = axis_values(effect, "signal", np.array([0.0, black, black + 500.0]), context)
    assert found == pytest.approx(np.array([0.0, 0.0, 500.0]) + added)


LAW_FRAMES, SIGMAS = 16, 5.0

SIGNALS = (40.0, 900.0, 9000.0, 10_200.0)

# Few lines or phases, or few pixels, make all of it: their draws have tests of their own, over many frames.
NO_FREE_LAW = {
    "column_pattern", "row_pattern", "row_temporal_noise", "rolling_shutter_banding", "mains_ripple", "hot_pixels",
    "random_telegraph_noise",
}  # fmt: skip

SPREAD_OVER_CODES = {"missing_codes"}  # what lies between two codes is noise in its moments: an even signal has none


def forms(kind, context):
    """Return the first start of an entry and its last, what it loosens to, and what it covers."""
    starts = starts_of(kind, context)
    return [starts[0], starts[-1], *starts[0].loosened(context)[:3], *kind.covers(context)[:2]]


@pytest.mark.parametrize("name", sorted(CATALOGUE.keys() - NO_FREE_LAW))
def test_samples_have_the_moments_that_are_predicted(name):
    """Mean, noise from frame to frame and fixed pattern of 16 frames of an even signal, within 5 standard errors."""
    context, pixels = effect_context(), HEIGHT * WIDTH
    for effect in forms(CATALOGUE[name], context):
        for signal in SIGNALS:
            even = np.full((HEIGHT, WIDTH), signal)
            predicted = effect.moments(Moments(even, *(np.zeros_like(even) for _ in range(3))), context)
            frames = np.array(
                [effect.sample(even.copy(), context, np.random.default_rng([k, 7])) for k in range(LAW_FRAMES)], float
            )
            noise, pattern, common = (
                float(np.mean(one))
                for one in (predicted.variance, predicted.spatial_variance, predicted.common_variance)
            )
            u_mean = np.sqrt(noise / (LAW_FRAMES * pixels) + pattern / pixels + common / LAW_FRAMES)
            least = 1e-5 * float(np.mean(predicted.mean)) + 1e-9
            assert abs(frames.mean() - np.mean(predicted.mean)) < SIGMAS * u_mean + least, (effect, signal)
            if name in SPREAD_OVER_CODES:
                continue
            alike = frames.mean(axis=(1, 2)).var(ddof=1)
            own = (frames - frames.mean(axis=(1, 2), keepdims=True)).var(axis=0, ddof=1).mean()
            u_own = noise * np.sqrt(2.0 / (pixels * (LAW_FRAMES - 1)))
            assert abs(own - noise) < SIGMAS * u_own + 1e-6 * signal + 1e-3 * common, (effect, signal)
            shared = common + noise / pixels
            assert abs(alike - shared) < SIGMAS * shared * np.sqrt(2.0 / (LAW_FRAMES - 1)) + 1e-6 * signal, (
                effect,
                signal,
            )
            still = (frames.mean(axis=0) - np.broadcast_to(predicted.mean, even.shape)).var(ddof=1) - own / LAW_FRAMES
            u_still = np.sqrt(2.0 / pixels) * (pattern + noise / LAW_FRAMES)
            assert abs(still - pattern) < SIGMAS * u_still + 1e-6 * signal + 1e-3 * common, (effect, signal)


# Charge that moves the borders of pixels: by hand, by draws, and next to what two CCDs were measured to do.


FAR = BrighterFatter(share=0.01, reach_px=8.0, height_x_px=0.6, height_y_px=0.4)


def border(x, y, height):
    """Return the integral of x/(x² + y² + h²)² over a border of one pixel, by quadrature."""
    return float(quad(lambda along: x / (x * x + along * along + height * height) ** 2, y - 0.5, y + 0.5)[0])


def test_borders_move_by_the_field_over_them():
    """Four times the share together; a step loses what its last line does."""
    push = push_of(3, 0.6, 0.4)
    nearest = 0.5 * (border(0.5, 0.0, 0.6) + border(0.5, 0.0, 0.4))
    for i, j in ((0, 0), (1, 0), (0, 1), (2, 2), (-1, 0), (-3, 1)):
        across = border(i + 0.5, j, 0.6) / nearest
        assert push.across[j + 2, i + 3] == pytest.approx(across, rel=1e-9)
        assert push.down[i + 3, j + 2] == pytest.approx(border(i + 0.5, j, 0.4) / nearest, rel=1e-9)
    assert push.kernel[3, 3] == pytest.approx(-4.0)
    neighbour = (border(0.5, 0, 0.6) - border(1.5, 0, 0.6) - 2 * border(0.5, 1, 0.4)) / nearest
    assert push.kernel[3, 4] == pytest.approx(neighbour, rel=1e-9)
    assert push.own[0] == pytest.approx(2.0 * -4.0, rel=1e-5)  # to first order in the share
    assert push.right[0] == pytest.approx(2.0 * neighbour, rel=1e-4)
    assert push.below[0] == pytest.approx(2.0 * push.kernel[4, 3], rel=1e-4)
    well = well_e(effect_context())
    low, step = 0.5 * well, 1e-3 * well
    halves = np.where(np.arange(60) < 30, low + step, low)[None, :] * np.ones((60, 1))
    even = replace(FAR, share=1e-4, edge_fill=1.0, height_y_px=FAR.height_x_px)
    moved = even.sample(halves, effect_context(), np.random.default_rng(0)) - halves
    lost = -moved[30, 29] / step
    predicted = even.moments(TileMoments.exactly(np.full((1, 1, 1), low)), effect_context()).edge_share.item()
    assert lost == pytest.approx(predicted, rel=5e-3)
    assert lost > 1.2 * 1e-4 * 0.5  # more than the nearest border alone


def test_noise_of_flats_has_the_moments_that_are_predicted():
    """Variance and covariances of neighbours of 40 flats, within 5 standard errors; beyond, what the kernel says."""
    context, size, level, frames, strong = effect_context(), 200, 6000.0, 40, replace(FAR, share=0.1)
    rng = np.random.default_rng(11)
    lags = {(0, 0): 0.0, (0, 1): 0.0, (1, 0): 0.0, (1, 1): 0.0, (0, 2): 0.0}
    for _ in range(frames):
        flat = strong.sample(level + math.sqrt(level) * rng.standard_normal((size, size)), context, rng) - level
        flat = flat[12:-12, 12:-12]
        for i, j in lags:
            lags[i, j] += float(np.mean(flat[i:, j:] * flat[: flat.shape[0] - i, : flat.shape[1] - j])) / frames
    u = level / math.sqrt(frames * (size - 24) ** 2)
    one = np.full((1, 1, 1), level)
    predicted = strong.moments(replace(TileMoments.exactly(one), variance=one), context)
    assert lags[0, 0] == pytest.approx(predicted.variance.item(), abs=5 * math.sqrt(2) * u)
    assert lags[0, 1] == pytest.approx(predicted.neighbour_x.item(), abs=5 * u)
    assert lags[1, 0] == pytest.approx(predicted.neighbour_y.item(), abs=5 * u)
    assert (
        predicted.neighbour_y.item() > predicted.neighbour_x.item() + 10 * u
    )  # what is nearer the charge is pushed more
    expected = level * _of_gathered_noise(strong, level)
    middle = expected.shape[0] // 2
    assert predicted.variance.item() == pytest.approx(expected[middle, middle], rel=1e-5)
    for (i, j), seen in lags.items():
        assert seen == pytest.approx(expected[middle + i, middle + j], abs=5 * math.sqrt(2) * u), (i, j)
    assert lags[1, 1] > 10 * u  # beyond the nearest


def _of_gathered_noise(effect, level, terms=16):
    """Return covariances over shot noise by lag: Σ (2aμ)ⁿ/(n+1)! of Astier et al. (2019), powers by convolution."""
    a = effect.slopes_per_e(well_e(effect_context())) * level
    total = np.zeros((97, 97))
    total[48, 48] = 1.0
    power = total.copy()
    for n in range(1, terms):
        power = fftconvolve(power, 2.0 * a, mode="same")
        total += power / math.factorial(n + 1)
    return total


def test_farther_pixels_share_what_is_pushed_again():
    """Sums over rows and columns; no charge is lost; the plain form leaves little beyond."""
    level, strong = 6000.0, replace(FAR, share=0.08)
    one = np.full((1, 1, 1), level)
    predicted = strong.moments(replace(TileMoments.exactly(one), variance=one), effect_context())
    expected = level * _of_gathered_noise(strong, level)
    middle = expected.shape[0] // 2
    beyond_x, beyond_y = float(np.ravel(predicted.beyond_x)[0]), float(np.ravel(predicted.beyond_y)[0])
    assert beyond_x == pytest.approx(expected[middle, middle + 2 :].sum(), rel=1e-4)
    assert beyond_y == pytest.approx(expected[middle + 2 :, middle].sum(), rel=1e-4)
    below = expected[middle + 1 :].sum() - expected[middle + 1, middle]
    beyond_rows = float(np.ravel(predicted.beyond_rows)[0])
    assert beyond_rows == pytest.approx(below, rel=1e-3)
    sides = predicted.neighbour_x.item() + predicted.neighbour_y.item() + beyond_x + beyond_rows
    assert predicted.variance.item() + 2.0 * sides == pytest.approx(level, rel=1e-6)
    level = 6000.0
    one = np.full((1, 1, 1), level)
    predicted = BrighterFatter(share=0.002).moments(replace(TileMoments.exactly(one), variance=one), effect_context())
    assert abs(float(np.ravel(predicted.beyond_x)[0])) < 0.01 * predicted.neighbour_x.item()
    assert abs(float(np.ravel(predicted.beyond_rows)[0])) < 0.02 * predicted.neighbour_x.item()


def test_searches_start_from_plain_forms():
    """A push loosens to heights once; darks from nothing, half and all of the black level."""
    plain = BrighterFatter(0.005)
    (far,) = plain.loosened(effect_context())
    assert plain.free() == ("share", "edge_fill")
    assert far.free() == ("share", "edge_fill", "height_x_px", "height_y_px")
    assert far.share == 0.005
    assert far.loosened(effect_context()) == ()
    starts = {(start.pedestal_dn, start.share) for start in fx.DarkFrameSubtracted.starts(_setting())}
    assert starts == {(kept, share) for kept in (0.0, 32.0, 64.0) for share in (1.0, 0.1)}


@pytest.mark.parametrize("sensor", ["e2v", "itl"])
def test_two_ccds_are_followed_from_variance_and_neighbours(sensor, shared_data):
    """Of what LSST's sensors show, variance and nearest neighbours tell share and heights; those predict lag 2.

    Measured slopes of covariance over mean, to lag 8 (C. Lage, Poisson_CCD). The sum over all lags is nothing, the
    ratio of the neighbours is the measured one, and both second neighbours together come within 20 % of what was
    measured, or its own standard error where that is more (27 % for the ITL sensor).
    """
    table = np.zeros((9, 9))
    spread = np.zeros((9, 9))
    path = shared_data / "sensors" / "lsst_brighter_fatter" / f"{sensor}_covariances_21oct19.txt"
    for line in path.read_text(encoding="utf-8").splitlines()[1:]:
        if len(cells := line.split()) == 4:
            table[int(cells[0]), int(cells[1])], spread[int(cells[0]), int(cells[1])] = map(float, cells[2:])
    context, mean = effect_context(), np.array([2000.0, 4000.0]).reshape(-1, 1, 1)

    def slopes(p):
        effect = BrighterFatter(p[0] / 100, reach_px=8.0, height_x_px=p[1], height_y_px=p[2])
        after = effect.moments(replace(TileMoments.exactly(mean), variance=mean), context)
        excess = [(after.variance - mean) / mean**2, after.neighbour_x / mean**2, after.neighbour_y / mean**2]
        slope_at_0 = [2 * one.ravel()[0] - one.ravel()[1] for one in excess]  # terms of x² taken off
        return np.array(slope_at_0) / np.array([table[0, 0], table[0, 1], table[1, 0]]) - 1.0

    fit = least_squares(slopes, [0.3, 0.5, 0.5], diff_step=1e-4, bounds=([0, 0.05, 0.05], [9, 3, 3]))
    np.testing.assert_allclose(fit.fun, 0.0, atol=1e-3)
    share, height_x, height_y = fit.x
    found = BrighterFatter(share / 100, reach_px=8.0, height_x_px=height_x, height_y_px=height_y)
    kernel = found.slopes_per_e(well_e(context))
    assert kernel[8, 8] == pytest.approx(table[0, 0], rel=2e-3)
    assert kernel[8, 9] / kernel[9, 8] == pytest.approx(table[0, 1] / table[1, 0], rel=0.05)
    assert abs(kernel.sum()) < 0.01 * abs(kernel[8, 8])
    measured, u = table[0, 2] + table[2, 0], math.hypot(spread[0, 2], spread[2, 0])
    assert kernel[8, 10] + kernel[10, 8] == pytest.approx(measured, abs=max(0.2 * measured, u))


# Frames less a dark frame, held against frames from which darks were drawn and subtracted by hand.


ROWS, COLUMNS, DARK_FRAMES = 150, 200, 16
READ_E, E_PER_DN, BLACK_DN = 2.4, 2.6, 64.0


def _setting(exposure_s=0.1, gain_db=0.0, dark_e=20.0):
    """Return a camera whose pixels gather so many dark electrons in 0.1 s."""
    base = effect_context()
    camera = base.camera.model_copy(update={"dark_current_e_per_s": dark_e / 0.1})
    settings = FrameSettings(exposure_s, gain_db, 5.6, BLACK_DN, 25.0, 60.0, 0.8)
    return replace(base, camera=camera, settings=settings, geometry=FrameGeometry.of_image(COLUMNS, ROWS), code=None)


def _by_hand(light_e, dark_e, gain, count, pedestal, top=4095.0):
    """Return mean and temporal variance of each pixel of frames less the whole codes of a mean of darks."""
    dice, shape = np.random.default_rng(7), (ROWS, COLUMNS)

    def frame(electrons):
        held = dice.poisson(electrons, shape) + READ_E * dice.standard_normal(shape)
        return np.clip(np.rint(held * gain / E_PER_DN + BLACK_DN), 0.0, top)

    dark = np.rint(np.mean([frame(dark_e) for _ in range(count)], axis=0))
    left = np.array([np.maximum(frame(light_e + dark_e) - dark + pedestal, 0.0) for _ in range(DARK_FRAMES)])
    return left.mean(axis=0), left.var(axis=0, ddof=1)


def _reported(light_e, context, effect):
    """Return the moments of the same: charge, its noise and that of reading, rounded, and the effect."""
    gain = 10.0 ** ((context.settings.gain_db or 0.0) / 20.0) / E_PER_DN
    dark_e = (context.camera.dark_current_e_per_s or 0.0) * context.settings.exposure_s
    one = np.ones((1, 1, 1))
    held = (light_e + dark_e) * gain + BLACK_DN
    variance = gain**2 * (light_e + dark_e + READ_E**2) + 1.0 / 12.0
    return effect.moments(replace(TileMoments.exactly(held * one), variance=variance * one), context)


@pytest.mark.parametrize("count", [1, 9])
@pytest.mark.parametrize(("pedestal", "dark_e"), [(0.0, 0.4), (32.0, 20.0)])
@pytest.mark.parametrize(("light_e", "gain_db"), [(0.0, 0.0), (4.0, 0.0), (500.0, 0.0), (4.0, 12.0)])
def test_moments_are_those_of_frames_less_a_drawn_dark(count, pedestal, dark_e, light_e, gain_db):
    """Mean, noise and pattern within five sigmas of the draws and two percent of their size.

    What is cut holds to a tenth and 0.05 DN: counts of few electrons and codes of one sigma are not normal. Tiles
    within four sigmas of zero are not compared.
    """
    context, effect = _setting(gain_db=gain_db, dark_e=dark_e), fx.DarkFrameSubtracted(1.0 / count, pedestal)
    seen, noise = _by_hand(light_e, dark_e, 10.0 ** (gain_db / 20.0), count, pedestal)
    reported = _reported(light_e, context, effect)
    mean, variance, fixed = (
        float(np.ravel(v)[0]) for v in (reported.mean, reported.variance, reported.spatial_variance)
    )
    pattern = np.square(seen - seen.mean()) - noise / DARK_FRAMES
    root = np.sqrt(seen.size)
    cut = pedestal == 0.0 and light_e < 100.0
    assert mean == pytest.approx(seen.mean(), abs=5 * seen.std() / root + 0.05 * cut)
    assert variance == pytest.approx(noise.mean(), abs=5 * noise.std() / root + 0.02 * cut, rel=0.1 if cut else 0.02)
    assert fixed == pytest.approx(pattern.mean(), abs=5 * pattern.std() / root + 0.02 * cut, rel=0.1 if cut else 0.02)
    assert float(np.ravel(reported.renewed_variance)[0]) == pytest.approx(fixed)
    assert not np.any(reported.limit_variance)


def test_a_dark_is_shared_by_frames_of_one_setting():
    """Its noise shows where the converter is full; another exposure has another."""
    context, effect = _setting(), fx.DarkFrameSubtracted(1.0, 10.0)
    seen, noise = _by_hand(15_000.0, 20.0, 1.0, 1, 10.0)
    reported = _reported(15_000.0, context, effect)
    assert noise.max() == 0.0
    assert float(np.ravel(reported.variance)[0]) == pytest.approx(0.0, abs=1e-6)
    assert float(np.ravel(reported.mean)[0]) == pytest.approx(seen.mean(), abs=5 * seen.std() / np.sqrt(seen.size))
    assert float(np.ravel(reported.spatial_variance)[0]) == pytest.approx(seen.var(), rel=0.05)
    effect = fx.DarkFrameSubtracted(1.0, 32.0)
    dice = np.random.default_rng(1)
    signal = np.full((ROWS, COLUMNS), 200.0)
    first, again = (effect.sample(signal, _setting(), dice) for _ in range(2))
    other = effect.sample(signal, _setting(0.11), dice)
    np.testing.assert_array_equal(first, again)
    assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 5.0 / np.sqrt(signal.size)


@pytest.mark.parametrize("lacking", ["conversion_gain_e_per_dn", "read_noise_e", "black_level_dn"])
def test_what_a_dark_holds_must_be_stated(lacking):
    """Without gain, read noise or black level no one says what a dark frame holds."""
    context = _setting()
    assert fx.DarkFrameSubtracted.usable(context)
    if lacking == "black_level_dn":
        settings: Any = replace(context.settings, black_level_dn=None)
        assert not fx.DarkFrameSubtracted.usable(replace(context, settings=settings))
    else:
        camera = CameraDescription(**context.camera.model_dump() | {lacking: None})
        assert not fx.DarkFrameSubtracted.usable(replace(context, camera=camera))

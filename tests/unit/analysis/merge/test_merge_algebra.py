"""Merged radiance by hand calculation, and what must hold of any merge: order, scale, clipped frames, u."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.analysis.merge.bracket import StreamingMerge, merge
from radiometer.analysis.merge.finish import merge_tables, mixture
from radiometer.analysis.merge.frames import frame_terms
from radiometer.analysis.merge.sums import MergeSample, MergeSums, merge_passes
from radiometer.analysis.signal.situation import situation_of
from radiometer.data import (
    BlackLevel,
    Bracket,
    CameraDescription,
    FlatField,
    FoundEffects,
    Frame,
    FrameSettings,
    LensDescription,
    PixelMask,
    ResponseCurve,
    Scale,
    ScaleConditions,
    SensorNoise,
    SourceDescription,
)
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError
from testing.relative_scale import relative_calibration

BLACK, GAIN_E, READ_E = 100.0, 2.5, 5.0

CAMERA = CameraDescription(bit_depth=12)

LENS = LensDescription()

NOISE = SensorNoise(conversion_gain_e_per_dn=GAIN_E, read_noise_e=READ_E, full_well_e=20_000.0)

CALIBRATION = relative_calibration(CAMERA, NOISE, black_level=BlackLevel(dn=BLACK, u_dn=0.0))


def frame(dn, exposure_s=1.0, gain_db=0.0, shape=(4, 4), **more):
    """Return an even frame, or one of the numbers given."""
    numbers = np.asarray(dn) if np.ndim(dn) else np.full(shape, dn)
    return Frame(numbers.astype(np.uint16), 12, FrameSettings(exposure_s, gain_db, **more))


def terms_with(darks):
    situation = situation_of(Setup(CAMERA, LENS, CALIBRATION))
    return frame_terms(FrameSettings(1.0), situation, darks, through_lens=False)


@pytest.mark.parametrize("other", [{"gain_db": 6.0}, {"exposure_s": 0.5}, {"exposure_s": 0.98}])
def test_dark_frames_of_another_gain_or_shorter_ones_are_not_taken_off_pixel_by_pixel(other):
    """Those of the same gain and exposure (to 1 %) are; of these the level at most."""
    same = terms_with([frame(130, shutter="closed"), frame(140, exposure_s=1.005, shutter="closed")])
    assert same.dark.tolist() == pytest.approx([35.0] * 16)
    assert terms_with([frame(500, shutter="closed", **other)]).dark.size == 1


def test_pixels_of_longer_dark_frames_differ_by_the_ratio_of_times():
    """80 DN more than the others in 4 s and 160 in 8 s are 20 in 1 s, and 320 in 16 s; its shot noise counts too."""

    def darks(times_s):
        hot = np.zeros((4, 4))
        hot[1, 2] = 20.0
        return [frame(np.rint(110 + hot * time_s), exposure_s=time_s, shutter="closed") for time_s in times_s]

    for times_s in ((4.0, 8.0), (0.25, 0.5)):
        terms = terms_with(darks(times_s))
        assert np.ptp(terms.dark) == pytest.approx(20.0)
        assert float(np.mean(terms.dark)) == pytest.approx(terms.level)
        assert terms.dark_variance == 0.0  # the others do not differ
        noise = terms_with([frame(110, shutter="closed")]).dark_variance
        squares = sum(time_s**2 for time_s in times_s)
        shot = 20.0 / GAIN_E * sum(time_s**3 for time_s in times_s) / squares**2
        assert shot < float(terms.variance_hot.max()) <= shot + noise / squares
        assert np.count_nonzero(terms.variance_hot) == 1


def test_pixels_that_fill_up_in_every_dark_frame_are_filled_from_their_neighbours():
    """A pixel at full scale after 8 s has an unknown dark signal after 1 s: marked, and counted in a note."""
    full = np.full((6, 6), 110)
    full[2, 3] = 4095
    seen = np.full((6, 6), 1110)
    seen[2, 3] = 3000
    found = merge([frame(full, exposure_s=8.0, shutter="closed"), frame(seen)], Setup(CAMERA, LENS, CALIBRATION))
    assert found.mask[2, 3] & PixelMask.DEFECTIVE
    assert np.ptp(found.radiance) == pytest.approx(0.0, abs=1e-3 * float(found.radiance.max()))
    assert any("1 pixels fill up" in line for line in found.provenance.assumptions)


def test_what_differs_by_a_seventh_is_marked_and_by_a_hundredth_is_not():
    """One of four frames brighter by 15 %, 13 standard deviations, is a contradiction; by 1 % it is none."""
    shown = [
        merge([*([frame(3100)] * 3), frame(100 + round(3000 * more))], Setup(CAMERA, LENS, CALIBRATION)).mask[0, 0]
        for more in (1.15, 1.01)
    ]
    assert shown == [PixelMask.INCONSISTENT, 0]


def test_the_black_level_s_error_counts_as_it_shifts_the_value():
    """u of 2 DN that two frames share is the shift that a black level 2 DN higher brings, whatever the weights."""
    frames = [frame(400, 1.0), frame(1300, 4.0), frame(2500, 8.0)]

    def of(dn, u):
        level = BlackLevel(dn=dn, u_dn=u, dark_u_rel=0.0)
        return merge(frames, Setup(CAMERA, LENS, replace(CALIBRATION, black_level=level)))

    known, doubted, shifted = of(BLACK, 0.0), of(BLACK, 2.0), of(BLACK + 2.0, 0.0)
    added = float(doubted.u_radiance[0, 0]) ** 2 - float(known.u_radiance[0, 0]) ** 2
    shift = float(known.radiance[0, 0] - shifted.radiance[0, 0])
    assert np.sqrt(added) == pytest.approx(shift, rel=0.03)


def test_noise_reaches_to_two_of_its_standard_deviations():
    """Signals of 4 and 5 DN are 1.7 and 2.04 u: the first is marked BELOW_NOISE, the second not."""
    found = merge([frame([[104, 105, 106]])], Setup(CAMERA, LENS, CALIBRATION))
    ratios = found.radiance[0] / found.u_radiance[0]
    assert ratios == pytest.approx([s / np.sqrt(READ_E**2 / 6.25 + 1 / 12 + s / 2.5) for s in (4, 5, 6)], rel=1e-3)
    assert [bool(m & PixelMask.BELOW_NOISE) for m in found.mask[0]] == [bool(r < 2.0) for r in ratios]
    assert found.mask[0, 0]
    assert not found.mask[0, 2]


def test_u_is_in_the_unit_of_the_map_where_sensitivity_differs():
    """Under a flat field u over value is the same in the middle and in the corner of an even frame."""
    flat = FlatField(principal_point_px=(0.0, 0.0), radius_px=30.0, coefficients=(-0.3, 0.0, 0.0), shape=(24, 24))
    found = merge([frame(1100, shape=(24, 24))], Setup(CAMERA, LENS, replace(CALIBRATION, flat_field=flat)))
    relative = found.u_radiance / found.radiance
    assert found.radiance[23, 23] / found.radiance[0, 0] > 1.2
    assert relative.max() == pytest.approx(relative.min(), rel=1e-5)


def test_found_errors_of_the_camera_are_corrected_in_maps_too():
    """0.1 s more than stated at 1 s, and 20 DN more black: 1000 DN over black are 980 in 1.1 s."""
    found = FoundEffects(exposure_offset_s=0.1, black_offset_dn=20.0)
    plain = merge([frame(1100)], Setup(CAMERA, LENS, CALIBRATION)).radiance[0, 0]
    corrected = merge([frame(1100)], Setup(CAMERA, LENS, replace(CALIBRATION, found=found))).radiance[0, 0]
    assert corrected / plain == pytest.approx(0.98 / 1.1, rel=1e-5)


def test_the_doubts_of_gain_and_stop_and_polarised_light_are_common_to_the_map():
    """1 % of another gain than the calibration's, 4 % (2 · 2 %) of another f-number, 0.3 % of a screen's light."""
    base = replace(CALIBRATION, scale=CALIBRATION.scale.model_copy(update={"f_number": 4.0}))
    plain, amplified, stopped, screen = (
        merge([frame(1100, 1.0, gain_db, f_number=number)], Setup(CAMERA, LENS, base, source=light)).u_rel_common
        for gain_db, number, light in (
            *((gain_db, number, None) for gain_db, number in ((0.0, 4.0), (6.0, 4.0), (0.0, 8.0))),
            (0.0, 4.0, SourceDescription(kind="screen")),
        )
    )
    assert np.sqrt(screen**2 - plain**2) == pytest.approx(0.003, rel=1e-3)
    assert np.sqrt(amplified**2 - plain**2) == pytest.approx(0.01, rel=1e-3)
    assert np.sqrt(stopped**2 - plain**2) == pytest.approx(0.04, rel=0.02)


@pytest.mark.parametrize(("short_dn", "rate"), [(20, 20.0), (23, 20.245)])
def test_two_frames_are_weighed_as_least_squares_would(short_dn, rate):
    """Of 1 and 8 s, x and 160 DN over black: Σt·x/v over Σt²/v, and u² = 1/Σt²/v with v = (σ² + e)/K² + 1/12."""
    found = merge([frame(100 + short_dn, 1.0), frame(260, 8.0)], Setup(CAMERA, LENS, CALIBRATION))
    t, x = np.array([1.0, 8.0]), np.array([short_dn, 160.0])
    v = (READ_E**2 + rate * t * GAIN_E) / GAIN_E**2 + 1 / 12
    information = float((t**2 / v).sum())
    assert found.radiance[0, 0] == pytest.approx(float((t * x / v).sum()) / information, rel=1e-3)
    assert found.u_radiance[0, 0] == pytest.approx(information**-0.5, rel=2e-3)


@pytest.mark.parametrize(
    ("variances", "expected"),
    [
        ((4.0, 0.0, 1.0), (0.2, 0.8)),  # independent: weights 1 to 4, 1/(1/4 + 1)
        ((4.0, 0.5, 1.0), (0.125, 0.9375)),  # (1/8)²·4 + (7/8)²·1 + 2·(1/8)·(7/8)·0.5
        ((1.0, 1.0, 1.0), (1.0, 1.0)),  # the same estimate twice
    ],
)
def test_the_best_mixture_of_two_estimates(variances, expected):
    """Of two with variances and covariance as given: the share of the first, the least variance."""
    assert mixture(*variances) == pytest.approx(expected)


FULL = 255


def behind_a_curve(u=1e-6, valid=(2, 254), read_e=0.01):
    """Return camera and calibration of 8 bits, M = 255·(x/255)^(1/2.2), with hardly any noise but rounding."""
    dn = np.arange(FULL + 1.0)
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(np.log(FULL * (dn / FULL) ** 2.2), np.full(FULL + 1, u), absolute=True, valid_dn=valid)
    camera = CameraDescription(bit_depth=8, black_level_dn=0.0)
    noise = SensorNoise(conversion_gain_e_per_dn=1e7, read_noise_e=read_e, full_well_e=1e12)
    return camera, relative_calibration(camera, noise, response=curve)


@pytest.mark.parametrize("gain_db", [0.0, 12.0])
def test_rounding_behind_a_curve_is_the_scatter_that_u_states(gain_db):
    """Over 10 000 pixels between two and three thousandths of each other the errors are as large as u says."""
    camera, calibration = behind_a_curve()
    gain = 10.0 ** (gain_db / 20.0)
    truth = np.linspace(20.0, 60.0, 10_000).reshape(100, 100) / gain
    numbers = np.rint(FULL * (truth * gain / FULL) ** (1 / 2.2)).astype(np.uint8)
    found = merge([Frame(numbers, 8, FrameSettings(1.0, gain_db))], Setup(camera, LENS, calibration))
    unit = np.median(found.radiance / truth)
    pull = (found.radiance / unit - truth) / (found.u_radiance / unit)
    assert np.sqrt(np.mean(pull**2)) == pytest.approx(1.0, abs=0.05)


def test_white_and_black_behind_a_curve_are_distinguished():
    """255 in every frame is SATURATED, with the least that it can be; 0 is BELOW_NOISE."""
    camera, calibration = behind_a_curve()
    numbers = np.array([[255, 0, 128]], np.uint8)
    frames = [Frame(numbers, 8, FrameSettings(t)) for t in (1.0, 1.0)]
    for source in (frames, Bracket.from_frames(frames)):
        assert merge(source, Setup(camera, LENS, calibration)).mask[0].tolist() == [
            PixelMask.SATURATED, PixelMask.BELOW_NOISE, 0,
        ]  # fmt: skip


def test_what_no_frame_shows_is_as_doubtful_as_large():
    """Clipped everywhere it is at least the end of the curve, black everywhere at most its first number, u as large."""
    camera, calibration = behind_a_curve()
    found = merge(
        [Frame(np.array([[255, 0, 250, 5]], np.uint8), 8, FrameSettings(1.0))] * 2, Setup(camera, LENS, calibration)
    )
    white, black, high, low = found.radiance[0]
    assert white > high > low > black > 0.0
    assert found.u_radiance[0, :2] == pytest.approx([white, black], rel=1e-6)
    assert white == pytest.approx(FULL * (254.5 / FULL) ** 2.2, rel=0.01)


def test_a_frame_that_clips_near_its_end_raises_the_value():
    """Next to a frame just below clipping at 1 s, one that clips at 1.05 s says "at least so much", never less."""
    lone = merge([frame(3900)], Setup(CAMERA, LENS, CALIBRATION)).radiance[0, 0]
    heard = merge([frame(3900), frame(4095, 1.05)], Setup(CAMERA, LENS, CALIBRATION)).radiance[0, 0]
    assert lone < heard < lone * 1.02


@pytest.mark.parametrize(("u", "contradicts"), [(0.01, True), (0.1, False)])
def test_frames_may_differ_by_what_the_curve_is_uncertain_by(u, contradicts):
    """100 and 110 of one exposure are 23 % apart: a contradiction where the curve is known to 1 %, none at 10 %."""
    camera, calibration = behind_a_curve(u)
    frames = [Frame(np.full((2, 2), number, np.uint8), 8, FrameSettings(1.0)) for number in (100, 110)]
    mask = merge(frames, Setup(camera, LENS, calibration)).mask[0, 0]
    assert bool(mask & PixelMask.INCONSISTENT) is contradicts


def test_a_map_is_handed_out_once():
    """A second result and one of no frame are refused; frames of another size or depth are, and change nothing."""
    running = StreamingMerge(Setup(CAMERA, LENS, CALIBRATION))
    with pytest.raises(MeasurementError, match="shutter open"):
        running.result()
    running.add(frame(3100))
    with pytest.raises(MeasurementError, match="4 × 3"):
        running.add(frame(3100, shape=(3, 4)))
    with pytest.raises(MeasurementError, match="8 bits per pixel"):
        running.add(Frame(np.zeros((4, 4), np.uint8), 8, FrameSettings(1.0)))
    assert running.result().radiance[0, 0] == pytest.approx(3000.0, rel=1e-3)
    with pytest.raises(MeasurementError, match="returned already"):
        running.result()


SUMS_LENS, GAMMA, ELECTRONS, SUMS_READ_E, AFTER_DN2 = LensDescription(), 2.2, 8000.0, 6.0, 0.4

TIMES = 2.0 ** np.arange(7)


def _calibration(bits, *, curve=None, dark_e_per_s=0.0):
    full = float((1 << bits) - 1)
    noise = SensorNoise(
        conversion_gain_e_per_dn=ELECTRONS / full,
        read_noise_e=SUMS_READ_E,
        full_well_e=ELECTRONS,
        dark_current_e_per_s=dark_e_per_s,
        post_curve_dn2=AFTER_DN2,
    )
    return relative_calibration(CameraDescription(bit_depth=bits), noise, response=curve)


def _behind_a_curve(**more):
    """Return a calibration of 8 bits, M = 255·x^(1/2.2) with x from 0 to 1 and data from 1 to 254."""
    with np.errstate(divide="ignore"):
        g = GAMMA * np.log(np.arange(256) / 255.0)
    curve = ResponseCurve(g, np.full(256, 1e-6), absolute=True, valid_dn=(1, 254))
    return _calibration(8, curve=curve, **more)


def _samples(calibration, numbers, bits, first=0):
    """Return numbers of shape (frames, pixels) as samples, the first of them frame number `first`."""
    situation = situation_of(Setup(calibration.camera, SUMS_LENS, calibration))
    samples = []
    for k, (dn, seconds) in enumerate(zip(numbers, TIMES, strict=False)):
        settings = FrameSettings(float(seconds))
        terms = frame_terms(settings, situation, (), through_lens=False)
        table = None if calibration.response is None else situation.model.table(settings).astype(np.float32)
        samples.append(MergeSample.of(dn.astype(np.uint8 if bits == 8 else np.uint16), terms, table, first + k))
    return samples


@pytest.mark.parametrize(("bits", "curved"), [(12, False), (8, False), (8, True)])
@pytest.mark.parametrize(("count", "first"), [(4, 0), (5, 0), (7, 0), (7, 13)])
def test_several_frames_at_a_time_are_the_same_sums(bits, curved, count, first):
    """From black to white: sums, bits and clipping in fours and pairs are those of one by one, of 16 frames or more."""
    calibration = _behind_a_curve(dark_e_per_s=20.0) if curved else _calibration(bits, dark_e_per_s=20.0)
    rng = np.random.default_rng(1)
    numbers = rng.integers(0, 1 << bits, (count, 600))
    numbers[:, :40] = rng.choice([0, 1, (1 << bits) - 2, (1 << bits) - 1], (count, 40))
    samples = _samples(calibration, numbers, bits, first)
    together, singly = (MergeSums.zeros(600) for _ in range(2))
    terms = [samples[0].terms] * first + [one.terms for one in samples]
    for sums in (together, singly):
        sums.make_room(terms)
    together.add(merge_passes(samples, terms), 0)
    for one in samples:
        singly.add(merge_passes([one], terms), 0)
    for name in ("first", "second", "squares", "mask"):
        assert np.array_equal(getattr(together, name), getattr(singly, name)), name
    assert np.array_equal(together.patterns(), singly.patterns())
    white = (numbers >= samples[0].limits[1]).any(axis=0)
    assert np.array_equal(together.mask, np.where(white, PixelMask.SATURATED, 0))


@pytest.mark.parametrize("curved", [True, False])
def test_noise_at_clipping_is_all_that_arises_there(curved):
    """Variance of x at clipping less the shot noise there: behind a curve the noise of its codes as well."""
    calibration = _behind_a_curve() if curved else _calibration(12)
    samples = _samples(calibration, np.zeros((2, 4), int), 8 if curved else 12)
    model = situation_of(Setup(calibration.camera, SUMS_LENS, calibration)).model
    terms = [one.terms for one in samples]
    frames = merge_tables(terms, model).frames
    clips_at = frames[:, 2]
    there = [float(model.variance(x, FrameSettings(1.0))) for x in clips_at]
    assert frames[:, 5] == pytest.approx(there - clips_at / model.electrons_per_unit, rel=1e-6)
    assert np.all(frames[:, 5] > frames[:, 1]) == curved


def test_a_block_leaves_nothing_to_the_next():
    """Rows from dark to bright in blocks of eight: the map of the rows upside down is upside down, nothing clashes."""
    rng = np.random.default_rng(2)
    light = np.geomspace(2.0, 4000.0, 160)[:, None] * np.ones(4000)
    numbers = [
        np.clip(rng.normal(light * t, 2.0 + 0.5 * np.sqrt(light * t)), 0, 4095).astype(np.uint16) for t in (1, 4)
    ]
    calibration = _calibration(12)

    def merged(step):
        frames = [Frame(dn[::step], 12, FrameSettings(t)) for dn, t in zip(numbers, (1.0, 4.0), strict=True)]
        return merge(Bracket.from_frames(frames), Setup(calibration.camera, SUMS_LENS, calibration))

    upright, upside_down = merged(1), merged(-1)
    for name in ("radiance", "u_radiance", "mask"):
        assert np.array_equal(getattr(upside_down, name)[::-1], getattr(upright, name)), name
    assert np.mean(upright.mask & PixelMask.INCONSISTENT > 0) < 1e-3


def _expected_u(rate):
    """Return u of the best mean of the frames that show a rate, by the noise of each at its expected number."""
    x = rate * TIMES[:, None]
    dn = 255.0 * np.minimum(x, 1.0) ** (1.0 / GAMMA)
    slope = GAMMA / 255.0 * (dn / 255.0) ** (GAMMA - 1.0)
    # Electrons are counted to the last number with data, and from there on the straight line through it.
    per_unit = ELECTRONS / 255.0 * 254.0 / (254.0 / 255.0) ** GAMMA
    variance = x / per_unit + (SUMS_READ_E / per_unit) ** 2 + slope**2 * (AFTER_DN2 + 1.0 / 12.0)
    used = (np.rint(dn) >= 1.0) & (np.rint(dn) < 255.0)
    return np.where(used, TIMES[:, None] ** 2 / variance, 0.0).sum(axis=0) ** -0.5


def test_u_behind_a_curve_is_that_of_the_best_weights_at_every_level():
    """Over three decades, pixel by pixel: to 2.5 %, which two sums cost at most and rounding of the numbers leaves."""
    calibration = _behind_a_curve()
    rate = np.geomspace(2e-4, 0.9, 3000)
    numbers = np.rint(255.0 * np.minimum(rate * TIMES[:, None], 1.0) ** (1.0 / GAMMA))
    frames = [
        Frame(dn.astype(np.uint8)[None, :], 8, FrameSettings(float(t))) for dn, t in zip(numbers, TIMES, strict=True)
    ]
    found = merge(Bracket.from_frames(frames), Setup(calibration.camera, SUMS_LENS, calibration))
    clear = (np.abs(np.log(rate[:, None] * TIMES)) > 0.3).all(axis=1)  # no frame near its end says "at least so much"
    ratio = found.u_radiance[0] / _expected_u(rate)
    assert ratio[clear] == pytest.approx(1.0, abs=0.025)
    assert np.median(ratio[clear]) == pytest.approx(1.0, abs=0.006)


@pytest.mark.parametrize("curved", [False, True])
def test_neighbours_of_other_frames_change_nothing(curved):
    """In any order of the pixels, alike ones side by side or mixed, each has its own value, u and flags."""
    calibration = _behind_a_curve() if curved else _calibration(12)
    bits = calibration.camera.bit_depth
    full = (1 << bits) - 1
    rng = np.random.default_rng(3)
    light = np.geomspace(1e-4, 2.0, 2500)
    numbers = full * (light * TIMES[:, None] / 8.0) ** (1.0 / GAMMA if curved else 1.0)
    numbers = np.clip(np.rint(numbers + rng.normal(0.0, 1.5, numbers.shape)), 0, full).astype(int)
    order = rng.permutation(light.size)

    def merged(these):
        dtype = np.uint8 if curved else np.uint16
        frames = [
            Frame(dn.astype(dtype)[None, :], bits, FrameSettings(float(t))) for dn, t in zip(these, TIMES, strict=True)
        ]
        return merge(Bracket.from_frames(frames), Setup(calibration.camera, SUMS_LENS, calibration))

    sorted_, mixed = merged(numbers), merged(numbers[:, order])
    for name in ("radiance", "u_radiance", "mask"):
        assert np.allclose(getattr(mixed, name)[0], getattr(sorted_, name)[0, order], rtol=2e-6, atol=0.0), name


def test_of_two_frames_that_clip_nearby_both_are_heard():
    """Next to one just below clipping two that clip at 1.02 and 1.04 s raise the value more than either."""
    calibration = _calibration(12)

    def value(*clipped):
        frames = [Frame(np.full((2, 2), 3850, np.uint16), 12, FrameSettings(1.0))]
        frames += [Frame(np.full((2, 2), 4095, np.uint16), 12, FrameSettings(t)) for t in clipped]
        return merge(frames, Setup(calibration.camera, SUMS_LENS, calibration)).radiance[0, 0]

    lone, one, other, both = value(), value(1.02), value(1.04), value(1.02, 1.04)
    assert both > max(one, other) > min(one, other) > lone
    assert value(1.02, 16.0) == pytest.approx(one, rel=1e-6)  # what had to clip says nothing


def test_more_sets_of_frames_than_are_kept_change_nothing():
    """Some 900 sets of ten frames behind a curve, in order and at random: the same value and u of every pixel."""
    calibration, rng = _behind_a_curve(), np.random.default_rng(5)
    times = np.linspace(1.0, 8.0, 10)
    missing = rng.integers(1, 1 << 10, 4000)
    missing.sort()
    numbers = np.rint(255.0 * (times[:, None] * rng.uniform(0.02, 0.1, 4000)) ** (1.0 / GAMMA))
    numbers[missing >> np.arange(10)[:, None] & 1 == 1] = 0
    order = rng.permutation(missing.size)

    def merged(these):
        frames = [Frame(dn.astype(np.uint8)[None, :], 8, FrameSettings(t)) for dn, t in zip(these, times, strict=True)]
        return merge(Bracket.from_frames(frames), Setup(calibration.camera, SUMS_LENS, calibration))

    sorted_, mixed = merged(numbers), merged(numbers[:, order])
    for name in ("radiance", "u_radiance", "mask"):
        assert np.allclose(getattr(mixed, name)[0], getattr(sorted_, name)[0, order], rtol=2e-6, atol=0.0), name


def test_what_lies_outside_the_curves_data_is_marked_on_both_sides():
    """Data from 20 to 200 DN: marked are 10 DN, and light that a shorter frame puts above 200 DN of the longer."""
    plain = _behind_a_curve()
    calibration = replace(plain, response=replace(plain.response, valid_dn=(20, 200)))
    longer = np.repeat(np.array([10, 25, 190, 198], np.uint8), 50)
    # Half the light through the same curve; of the last a tenth too much.
    shorter = np.rint(longer * (0.5 * np.repeat([1.0, 1.0, 1.0, 1.1], 50)) ** (1.0 / GAMMA)).astype(np.uint8)
    frames = [Frame(dn[None, :], 8, FrameSettings(t)) for dn, t in ((shorter, 0.5), (longer, 1.0))]
    found = merge(Bracket.from_frames(frames), Setup(calibration.camera, SUMS_LENS, calibration))
    outside = (found.mask & PixelMask.EXTRAPOLATED > 0).reshape(4, 50)
    assert outside.all(axis=1).tolist() == [True, False, False, True]
    assert not outside[1:3].any()


# What must hold of any merge, whatever the scene: order, scale, clipped frames, and u by the number of frames.


FULL_SCALE = 4095
seeds = st.integers(min_value=0, max_value=2**31)


def frames(seed, times, shape=(12, 16), brightest_e=2000.0):
    """Return frames of a scene whose noise is that of the calibration; above 20 000 e⁻/s all of half a second clip."""
    rng = np.random.default_rng(seed)
    rate_e = np.exp(rng.uniform(np.log(50.0), np.log(brightest_e), shape))
    found = []
    for time in times:
        electrons = rng.poisson(rate_e * time) + NOISE.read_noise_e * rng.standard_normal(shape)
        dn = np.clip(np.round(electrons / 2.5 + BLACK), 0, FULL_SCALE).astype(np.uint16)
        found.append(Frame(dn, 12, FrameSettings(float(time))))
    return found


def merged(several):
    return merge(iter(several), Setup(CAMERA, LENS, CALIBRATION))


def test_frames_whose_dark_signal_fills_them_are_refused():
    """Light and dark frames alike are at full scale: no limit of the light follows."""
    full = np.full((12, 16), FULL_SCALE, np.uint16)
    both = [Frame(full, 12, FrameSettings(10.0, shutter=one)) for one in ("closed", "open")]
    with pytest.raises(MeasurementError, match="dark signal"):
        merged(both)


@settings(max_examples=15, deadline=None)
@given(seeds, st.permutations(range(4)), st.sampled_from([2000.0, 60_000.0]))
def test_the_order_of_frames_changes_nothing(seed, order, brightest_e):
    """Values, uncertainties and mask are those of the frames, in whatever order these come, clipped or not."""
    several = frames(seed, (0.5, 1.0, 2.0, 4.0), brightest_e=brightest_e)
    one, other = merged(several), merged([several[k] for k in order])
    assert np.allclose(other.radiance, one.radiance, rtol=1e-4, atol=0.0)
    assert np.allclose(other.u_radiance, one.u_radiance, rtol=1e-4, atol=0.0)
    assert np.array_equal(other.mask, one.mask)


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_a_frame_that_clips_everywhere_adds_nothing(seed):
    """A white frame of a time that had to clip leaves value and uncertainty as they were."""
    several = frames(seed, (1.0, 2.0))
    white = Frame(np.full((12, 16), FULL_SCALE, np.uint16), 12, FrameSettings(4000.0))
    one, other = merged(several), merged([*several, white])
    assert np.allclose(other.radiance, one.radiance, rtol=1e-4, atol=0.0)
    assert np.allclose(other.u_radiance, one.u_radiance, rtol=1e-4, atol=0.0)


@settings(max_examples=15, deadline=None)
@given(seeds, st.floats(min_value=0.01, max_value=100.0), st.sampled_from([2000.0, 60_000.0]))
def test_values_scale_with_the_inverse_of_all_times(seed, factor, brightest_e):
    """The same numbers from times longer by a factor are that much less light, u included; clipped ones, too."""
    several = frames(seed, (0.5, 1.0, 2.0), brightest_e=brightest_e)
    longer = [replace(f, settings=replace(f.settings, exposure_s=f.settings.exposure_s * factor)) for f in several]
    one, other = merged(several), merged(longer)
    assert np.allclose(other.radiance * factor, one.radiance, rtol=1e-4, atol=0.0)
    assert np.allclose(other.u_radiance * factor, one.u_radiance, rtol=1e-4, atol=0.0)


@settings(max_examples=10, deadline=None)
@given(seeds, st.integers(min_value=2, max_value=9))
def test_u_falls_by_the_root_of_the_frames(seed, count):
    """n equal frames know a pixel √n times better than one; copies of one do not."""
    frame = frames(seed, (1.0,))[0]

    def marked(number: int) -> Frame:
        """Return the frame with another number in its first pixel: another exposure."""
        dn = frame.dn.copy()
        dn[0, 0] = 500 + number
        return replace(frame, dn=dn)

    one, several = merged([frame]), merged([marked(n) for n in range(count)])
    assert np.allclose(several.u_radiance[1:] * np.sqrt(count), one.u_radiance[1:], rtol=0.01, atol=0.0)
    assert np.allclose(several.radiance[1:], one.radiance[1:], rtol=1e-4, atol=0.0)
    copies = merged([frame] * count)
    assert np.array_equal(copies.u_radiance, one.u_radiance)
    assert any("no exposure counts twice" in line for line in copies.provenance.assumptions) == (count > 1)


@pytest.mark.parametrize("gain_db", [0.0, 12.0])
def test_the_variance_of_a_frame_is_read_noise_dark_noise_and_rounding(gain_db):
    """c of x in DN at 0 dB: (σ_d² + dark)/K'² + 1/(12·G²); each term is there once, with its sign."""
    noise = replace(NOISE, dark_current_e_per_s=30.0)
    situation = situation_of(Setup(CAMERA, LENS, replace(CALIBRATION, noise=noise)))
    terms = frame_terms(FrameSettings(2.0, gain_db=gain_db), situation, (), through_lens=False)
    gain = 10.0 ** (gain_db / 20.0)
    assert terms.gain == pytest.approx(gain)
    assert terms.variance == pytest.approx((25.0 + 60.0) / 2.5**2 + 1.0 / 12.0 / gain**2)
    assert terms.exposure == 2.0
    assert terms.dark.tolist() == pytest.approx([24.0])  # 60 electrons, which light no longer has room for
    if not gain_db:
        assert terms.clips_at == pytest.approx(FULL_SCALE - 0.5 - BLACK - 24.0)


def test_a_frame_clips_at_full_scale_and_starts_above_black():
    """The last number used is full scale less one; the first is 0 where black stands clear of the noise, else 1."""
    situation = situation_of(Setup(CAMERA, LENS, CALIBRATION))
    terms = frame_terms(FrameSettings(1.0), situation, (), through_lens=False)
    assert terms.high_dn == FULL_SCALE
    assert terms.clips_at == pytest.approx(FULL_SCALE - 0.5 - BLACK)
    assert terms.sigma_clip == pytest.approx(np.sqrt(25.0 / 6.25 + terms.clips_at / 2.5 + 1.0 / 12.0))
    assert terms.low_dn == 0
    low = situation_of(Setup(CAMERA, LENS, replace(CALIBRATION, black_level=BlackLevel(dn=7.9))))
    assert frame_terms(FrameSettings(1.0), low, (), through_lens=False).low_dn == 1
    just = situation_of(Setup(CAMERA, LENS, replace(CALIBRATION, black_level=BlackLevel(dn=8.1))))
    assert frame_terms(FrameSettings(1.0), just, (), through_lens=False).low_dn == 0


def behind_a_curve_from_17(valid_dn):
    """Return an 8-bit camera of gamma 2.2 with data from 17 on, and its calibration; 255 stands for 3000 e⁻."""
    camera = CameraDescription(bit_depth=8)
    g = 2.2 * np.log(np.maximum(np.arange(256), 1) / 255.0)
    curve = ResponseCurve(g, np.full(256, 1e-4), valid_dn=valid_dn)
    noise = replace(NOISE, conversion_gain_e_per_dn=3000.0 / 255.0, full_well_e=1e6)
    return camera, replace(
        CALIBRATION, camera=camera, response=curve, noise=noise, black_level=BlackLevel(dn=0.0, u_dn=0.0)
    )


@pytest.mark.parametrize("electrons", [60.0, 100.0, 200.0])
@pytest.mark.parametrize("curved", [True, False])
def test_dark_pixels_are_unbiased_where_black_cuts_the_noise_off(curved, electrons):
    """A ladder of eight stops whose short frames are cut off at black: the mean is the truth within its noise.

    With the numbers above black alone it would be 1 to 3 % too high.
    """
    rng, shape = np.random.default_rng(int(electrons)), (200, 200)
    camera, calibration = behind_a_curve_from_17((17, 250))
    if not curved:
        camera, calibration = CAMERA, replace(CALIBRATION, black_level=BlackLevel(dn=0.0, u_dn=0.0))
    several = []
    for time in 2.0 ** -np.arange(8):
        light = rng.poisson(electrons * time, shape) + NOISE.read_noise_e * rng.standard_normal(shape)
        if curved:
            dn = np.rint(255.0 * (np.maximum(light, 0.0) / 3000.0) ** (1 / 2.2)).astype(np.uint8)
        else:
            dn = np.maximum(np.rint(light / 2.5), 0.0).astype(np.uint16)
        several.append(Frame(dn, 8 if curved else 12, FrameSettings(float(time))))
    found = merge(Bracket.from_frames(several), Setup(camera, LENS, calibration))
    scale = 3000.0 if curved else 2.5
    signal = found.radiance.astype(np.float64) * scale
    error = signal.mean() / electrons - 1.0
    assert abs(error) < 4.0 * signal.std() / electrons / 200.0 + 0.002
    streamed = merge(iter(several), Setup(camera, LENS, calibration))
    assert np.allclose(streamed.radiance, found.radiance, rtol=1e-5)


def test_the_curve_s_uncertainty_is_shared_by_pixels_of_one_level():
    """5 % of the curve is what pixels share of u; noise alone remains next to it. A linear camera shares none."""
    camera, calibration = behind_a_curve_from_17((17, 250))
    curve = replace(calibration.response, u_log_exposure=np.full(256, 0.05))
    frame = Frame(np.full((4, 4), 128, np.uint8), 8, FrameSettings(1.0))
    found = merge([frame], Setup(camera, LENS, replace(calibration, response=curve)))
    noise, shared = found.parts_of_u(np.s_[:, :])
    x = (128 / 255) ** 2.2
    assert shared[0, 0] / found.radiance[0, 0] == pytest.approx(0.05, rel=0.01)
    rounding = 2.2 * x / 128 / np.sqrt(12.0)
    assert noise[0, 0] == pytest.approx(np.hypot(np.sqrt(3000.0 * x + 25.0) / 3000.0, rounding), rel=0.02)
    assert merged(frames(1, (1.0, 2.0))).u_shared is None


def test_below_the_curve_s_data_the_longest_frame_stands_alone():
    """10 and 8 of a curve with data from 17 on: the straight line to black at 10, flagged, whatever 8 says."""
    camera, calibration = behind_a_curve_from_17((17, 250))
    frames = [Frame(np.full((2, 2), dn, np.uint8), 8, FrameSettings(t)) for dn, t in ((8, 1.0), (10, 2.0))]
    setup = Setup(camera, LENS, calibration)
    for source in (frames, frames[::-1], Bracket.from_frames(frames)):
        found = merge(source, setup)
        assert found.radiance[0, 0] == pytest.approx((17 / 255) ** 2.2 * 10 / 17 / 2.0, rel=1e-4)
        assert found.mask[0, 0] & PixelMask.EXTRAPOLATED


def test_bounds_of_pixels_that_no_frame_shows():
    """Clipped everywhere: at least where the shortest frame clips; black: at most one number of the longest."""
    situation = situation_of(Setup(CAMERA, LENS, CALIBRATION))
    terms = [frame_terms(FrameSettings(t), situation, (), through_lens=False) for t in (1.0, 4.0)]
    tables = merge_tables(terms, situation.model)
    assert tables.bounds[0] == pytest.approx(terms[0].clips_at)
    assert tables.bounds[1] == pytest.approx(1.0 / 4.0)
    assert tables.frames[:, 0].tolist() == [1.0, 4.0]
    assert tables.kappa == pytest.approx(1.0 / 2.5)


@pytest.mark.parametrize("off_rel", [0.0009, 0.0011])
def test_a_map_reports_what_is_off_by_a_thousandth_or_more(off_rel):
    """Short exposures, a bend at full scale, and light of another spectrum: below a thousandth none needs a word."""
    seconds, there = 1e-3, ScaleConditions(inverse_exposure_per_s=100.0)
    stated = CALIBRATION.uncertainties.model_copy(
        update={"exposure_u_s": off_rel / (1.0 / seconds - 100.0), "spectral_u_rel": off_rel}
    )
    known = replace(
        CALIBRATION,
        scale=Scale(value=1.0, u_rel=0.01, method="known_radiance", f_number=4.0, conditions=there),
        uncertainties=stated,
        found=FoundEffects(well_a2=1.5 * off_rel, well_a3=-0.5 * off_rel, well_e=FULL_SCALE * 2.5 / 2.0),
    )
    reported = merge(
        iter(frames(1, (seconds, 2.0 * seconds))), Setup(CAMERA, LensDescription(f_number=4.0), known)
    ).provenance.assumptions
    words = ("the exposure of 0.001 s", "the response bends", "light of another spectrum")
    assert [any(one.startswith(word) for one in reported) for word in words] == [off_rel > 0.001] * 3


@pytest.mark.parametrize(("lens", "named"), [({}, True), ({"focal_length_mm": 16.0}, False)])
def test_a_map_names_a_fall_off_that_nothing_states(lens, named):
    """Without a focal length the loss at the corners is unknown: neither corrected nor in u, so it is named."""
    camera = CAMERA.model_copy(update={"pixel_pitch_um": 4.5})
    found = merge(frames(1, (1e-3, 2e-3)), Setup(camera, LensDescription(f_number=4.0, **lens)))
    assert any("fall-off is not corrected" in one for one in found.not_in_u) is named


@pytest.mark.parametrize(("black_dn", "named"), [(None, True), (0.0, False)])
def test_a_relative_map_names_a_black_level_that_nothing_states(black_dn, named):
    """A pedestal may be all of the darkest pixels, 40 DN here, and changes every contrast; a stated one is known."""
    dark = [Frame(np.where(one.dn > 0, np.uint16(40), one.dn), 12, one.settings) for one in frames(1, (1e-3, 2e-3))]
    found = merge(dark, Setup(CAMERA.model_copy(update={"black_level_dn": black_dn}), LensDescription(f_number=4.0)))
    assert any("the numbers may be about 40 DN" in one for one in found.not_in_u) is named

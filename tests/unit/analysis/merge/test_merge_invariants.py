"""What must hold of any merge, whatever the scene: order, scale, clipped frames, and u by the number of frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.merge.finish import merge_tables
from radiometer.analysis.merge.frames import frame_terms
from radiometer.analysis.signal.situation import situation_of
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    FoundEffects,
    Frame,
    FrameSettings,
    LensDescription,
    PixelMask,
    ResponseCurve,
    Scale,
    ScaleConditions,
    SensorNoise,
)
from radiometer.data.setup import Setup

FULL_SCALE, BLACK = 4095, 100.0
CAMERA = CameraDescription(bit_depth=12)
LENS = LensDescription()
NOISE = SensorNoise(conversion_gain_e_per_dn=2.5, read_noise_e=5.0, full_well_e=20_000.0)
CALIBRATION = Calibration(
    camera=CAMERA,
    lens=LENS,
    scale=Scale(value=1.0, u_rel=0.0, method="relative"),
    response=None,
    noise=NOISE,
    black_level=BlackLevel(dn=BLACK, u_dn=0.0),
)
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


def _behind_a_curve(valid_dn):
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
    camera, calibration = _behind_a_curve((17, 250))
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
    camera, calibration = _behind_a_curve((17, 250))
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
    camera, calibration = _behind_a_curve((17, 250))
    frames = [Frame(np.full((2, 2), dn, np.uint8), 8, FrameSettings(t)) for dn, t in ((8, 1.0), (10, 2.0))]
    setup = Setup(camera, LENS, calibration)
    for source in (frames, frames[::-1], Bracket.from_frames(frames)):
        found = merge(source, setup)
        assert found.radiance[0, 0] == pytest.approx((17 / 255) ** 2.2 * 10 / 17 / 2.0, rel=1e-4)
        assert found.mask[0, 0] & PixelMask.EXTRAPOLATED


def test_dark_signal_takes_room_below_clipping():
    """60 electrons of dark signal are 24 DN that light no longer has."""
    noise = replace(NOISE, dark_current_e_per_s=30.0)
    situation = situation_of(Setup(CAMERA, LENS, replace(CALIBRATION, noise=noise)))
    terms = frame_terms(FrameSettings(2.0), situation, (), through_lens=False)
    assert terms.clips_at == pytest.approx(FULL_SCALE - 0.5 - BLACK - 24.0)
    assert terms.dark.tolist() == pytest.approx([24.0])


def test_a_wide_ladder_of_dim_frames_is_weighed_as_it_should_be():
    """30 electrons a second for 1 to 30 s next to 5 of reading: scatter and u are those of the best weights."""
    rng = np.random.default_rng(9)
    times, several = (1.0, 3.0, 30.0), []
    for time in times:
        electrons = rng.poisson(30.0 * time, (150, 150)) + 5.0 * rng.standard_normal((150, 150))
        several.append(Frame(np.round(electrons / 2.5 + BLACK).astype(np.uint16), 12, FrameSettings(time)))
    found = merge(iter(several), Setup(CAMERA, LENS, CALIBRATION))
    c = 25.0 / 6.25 + 1.0 / 12.0
    information = sum(t**2 / (12.0 * t / 2.5 + c) for t in times)
    unit = float(np.mean(found.radiance)) / 12.0
    assert found.radiance.std() / unit == pytest.approx(information**-0.5, rel=0.03)
    assert np.median(found.u_radiance) / unit == pytest.approx(information**-0.5, rel=0.02)


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
    ).not_in_u
    words = ("the exposure of 1e+03 µs", "the response bends", "light of another spectrum")
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

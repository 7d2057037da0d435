"""The merge: at the limit of what can be known, however frames arrive and whatever moved in the scene."""

import datetime as dt
import math
import tracemalloc
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import norm

from radiometer import compiled as merge_compile
from radiometer.analysis.merge import finish as merge_finish
from radiometer.analysis.merge.bracket import StreamingMerge, merge
from radiometer.analysis.merge.displaced import relative_shift, with_shift
from radiometer.analysis.merge.finish import AtLevels
from radiometer.analysis.reading.reading import read_patch
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    FlatField,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    PixelMask,
    ResponseCurve,
    SensorNoise,
    StatedUncertainties,
)
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError
from testing.relative_scale import relative_calibration

EXACT = {
    "uncertainties": StatedUncertainties(exposure_u_rel=0, exposure_u_s=0, linearity_u_rel=0, prnu_u_rel=0),
    "black_level": BlackLevel(dn=64.0, u_dn=0.0, dark_u_rel=0.0),
}
LADDER_S = tuple(20e-6 * 2.0**k for k in range(14))


@pytest.fixture(scope="module")
def four_decades():
    """Return a function that merges a ramp over four decades: truth by column, the map, and the noise limit."""

    @cache
    def make(rig, rows=150, columns=1200):
        top = 0.8 * rig.radiance_of_full_scale(LADDER_S[0])
        truth = np.geomspace(top, top * 1e-4, columns)
        frames = rig.frames(np.tile(truth, (rows, 1)), np.random.default_rng(11), LADDER_S)
        found = merge(Bracket.from_frames(frames), Setup(rig.description, rig.lens, rig.calibration(**EXACT)))
        return truth, found, cramer_rao_variance(rig, truth)

    return make


def cramer_rao_variance(rig, truth):
    """Return the Cramér–Rao bound of the radiance from the frames that do not clip in the mean."""
    electrons = rig.electrons_per_s(truth)[:, None] * np.array(LADDER_S)
    variance = electrons + rig.read_e**2 + rig.gain_e_per_dn**2 / 12.0
    used = electrons < min(0.97 * rig.full_well_e, (4094.5 - rig.black_dn) * rig.gain_e_per_dn)
    return 1.0 / np.sum(np.where(used, (electrons / truth[:, None]) ** 2 / variance, 0.0), axis=1)


def test_the_merge_of_four_decades_is_as_good_as_its_u_says(rig, four_decades):
    """Variance at the Cramér–Rao bound, no bias, no inconsistent pixel, 95 ± 2 % within k = 2."""
    _, found, bound = four_decades(rig)
    ratio = found.radiance.astype(float).var(axis=0, ddof=1) / bound
    for part in np.split(ratio, 10):
        assert 0.95 < part.mean() < 1.05
    truth, found, bound = four_decades(rig)
    off = (found.radiance.astype(float).mean(axis=0) - truth) / np.sqrt(bound / 150)
    assert np.abs(off).max() < 5.0
    assert abs(off.mean()) < 5.0 / np.sqrt(off.size)
    _, found, _ = four_decades(rig)
    assert not found.mask.any()
    assert np.all(np.isfinite(found.radiance))
    truth, found, _ = four_decades(rig)
    inside = np.abs(found.radiance - truth) < 2.0 * found.u_radiance
    for part in np.split(inside, 10, axis=1):
        assert 0.93 < part.mean() < 0.97


@pytest.mark.parametrize("step", [1.2, 2.0, 4.0, 16.0])
def test_two_sums_are_as_good_as_all_weights(step):
    """The mixture of Σx and Σtx has a variance within 1.5 % of the optimum for any ladder and noise ratio."""
    exposures = step ** np.arange(10.0)
    kappa = 1.0
    for readout in np.geomspace(1e-4, 1e4, 33) * exposures[-1]:
        frames = np.array([[t, readout, 1e30, 1.0, 0.0, readout, -np.inf, readout, t**0.35] for t in exposures])
        record = np.zeros(merge_finish.RECORD_SIZE)
        merge_finish.fill_record(record, np.uint64(2**10 - 1), frames, kappa, np.ones(10), 1.0)
        apart = record[merge_finish.R0] + record[merge_finish.R1]
        inverse, gap = 1.0 / apart, apart - record[merge_finish.P0] - record[merge_finish.P1]
        variance = record[merge_finish.A0] + record[merge_finish.A1] - gap**2 * inverse
        best = 1.0 / np.sum(exposures**2 / (readout + kappa * exposures))
        assert 1.0 - 1e-9 < variance / best < 1.015


def test_the_hazard_of_the_normal_distribution_is_right():
    """To 1e-6 where it is tabulated (h²/8 of its curvature), to 3e-4 of the value in its asymptotic series."""
    inside = np.linspace(-3.5, 7.999, 5000)
    beyond = np.linspace(8.001, 30.0, 100)
    found = np.array([merge_finish.hazard(z) for z in inside])
    truth = np.exp(norm.logpdf(inside) - norm.logsf(inside))
    assert np.max(np.abs(found - truth)) < 1e-6
    tail = np.array([merge_finish.hazard(z) for z in beyond])
    assert np.max(np.abs(tail / np.exp(norm.logpdf(beyond) - norm.logsf(beyond)) - 1.0)) < 3e-4


def scene(rig, exposure_s=1e-3, size=24, level=0.5):
    return np.full((size, size), level * rig.radiance_of_full_scale(exposure_s))


def merged(rig, frames, **changes):
    return merge(frames, Setup(rig.description, rig.lens, rig.calibration(**changes)))


@pytest.mark.parametrize(
    ("dim", "side", "last_s"), [(1.0, 24, 1.5e-3), (1.0, 24, 4e-3), (0.01, 96, 1.5e-3)], ids=["even", "clips", "small"]
)
def test_light_that_wanders_from_frame_to_frame_is_in_the_uncertainty_of_every_pixel(rig, dim, side, last_s):
    """Two per cent between frames: the means of 20 maps are off as their u says; steady light adds nothing.

    A frame that clips everywhere shows nothing of it; a small bright place on a dark surround shows all of it.
    """
    whole, z = scene(rig, size=side), []
    bright = np.s_[side // 2 - 8 : side // 2 + 8, side // 2 - 8 : side // 2 + 8]
    truth = dim * whole
    truth[bright] = whole[bright]
    exposures = (5e-4, 1e-3, 1e-3, last_s)
    for seed in range(20):
        rng, frames = np.random.default_rng(seed), []
        for exposure_s in exposures:
            frames += rig.frames(truth * (1.0 + 0.02 * rng.normal()), rng, (exposure_s,))
        found = merged(rig, Bracket.from_frames(frames))
        z.append(
            float(
                (found.radiance[bright].mean() - whole[0, 0])
                / np.hypot(found.u_shared[bright].mean(), found.u_rel_common * whole[0, 0])
            )
        )
    assert np.mean(np.abs(z) < 2.0) > 0.75  # three or four frames know their scatter poorly
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 2.0
    steady = merged(rig, Bracket.from_frames(rig.frames(truth, np.random.default_rng(1), exposures)), **EXACT)
    assert steady.u_shared is None or steady.u_shared.max() < 1e-3 * whole[0, 0]


def test_a_stream_gives_what_the_bracket_gives(rig):
    """Block by block the same numbers; forty repeats average down by √40."""
    frames = rig.frames(scene(rig, size=300), np.random.default_rng(1), (2.5e-4, 5e-4, 1e-3, 2e-3))
    at_once, streamed = merged(rig, Bracket.from_frames(frames)), merged(rig, iter(frames))
    np.testing.assert_array_equal(at_once.radiance, streamed.radiance)
    np.testing.assert_array_equal(at_once.u_radiance, streamed.u_radiance)
    np.testing.assert_array_equal(at_once.mask, streamed.mask)
    frames = rig.frames(scene(rig), np.random.default_rng(1), (1e-3,) * 40)
    one, many = merged(rig, frames[:1], **EXACT), merged(rig, frames, **EXACT)
    assert np.mean(one.u_radiance) / np.mean(many.u_radiance) == pytest.approx(np.sqrt(40), rel=0.02)
    streamed = merged(rig, iter(frames), **EXACT)
    np.testing.assert_array_equal(streamed.radiance, many.radiance)


def test_streaming_holds_less_than_three_planes_beyond_the_result(rig):
    """Peak memory while twelve frames, six planes of float32 together, are made, merged and released."""
    size = 600
    plane = size * size * 4
    description, lens, calibration = rig.description, rig.lens, rig.calibration()
    merging = StreamingMerge(Setup(description, lens, calibration))
    dn = np.full((size, size), 500, np.uint16)
    merging.add(Frame(dn, 12, FrameSettings(1e-3, f_number=4.0, black_level_dn=64.0)))  # compiles
    tracemalloc.start()
    merging = StreamingMerge(Setup(description, lens, calibration))
    for exposure_s in (1e-3, 2e-3, 4e-3, 8e-3) * 3:
        merging.add(Frame(dn.copy(), 12, FrameSettings(exposure_s, f_number=4.0, black_level_dn=64.0)))
    found = merging.result()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    result = found.radiance.nbytes + found.u_radiance.nbytes + found.mask.nbytes
    assert peak - result < 3.0 * plane


def test_darkness_and_defects_are_marked(rig):
    """No light averages to zero, never NaN; two dead pixels take the mean of their neighbours."""
    found = merged(rig, rig.frames(scene(rig, size=100, level=0.0), np.random.default_rng(1), (1e-3, 1e-2)), **EXACT)
    assert np.mean(found.mask == PixelMask.BELOW_NOISE) > 0.95
    assert abs(found.radiance.mean()) < 4.0 * found.radiance.std() / 100
    assert np.all(found.u_radiance > 0)
    frames = rig.frames(scene(rig), np.random.default_rng(1), (1e-3,))
    dead = frames[0].dn.copy()
    dead[4, 4:6] = 0
    found = merged(rig, [Frame(dead, 12, frames[0].settings)], defects=((4, 4), (5, 4)))
    truth = scene(rig)[0, 0]
    assert np.all(found.mask[4, 4:6] & PixelMask.DEFECTIVE)
    assert np.all(np.abs(found.radiance[4, 4:6] - truth) < 4.0 * found.u_radiance[4, 4:6])
    assert (found.mask > 0).sum() == 2


def test_frames_that_disagree_are_marked(rig):
    """One that clips where the others say it must not; of two frames neither is believed."""
    rng = np.random.default_rng(1)
    flash = scene(rig, level=0.3)
    flash[3, 3] *= 100.0
    frames = [rig.frame(scene(rig, level=0.3), t, rng) for t in (2.5e-4, 5e-4)] + [rig.frame(flash, 1e-3, rng)]
    marked = merged(rig, frames).mask & PixelMask.INCONSISTENT > 0
    assert marked[3, 3]
    assert marked.sum() == 1
    rng = np.random.default_rng(6)
    even = np.full(SHAPE, 40_000.0)
    other = even.copy()
    other[10:20, 10:20] *= 0.5
    bracket = Bracket.from_frames([_frame(rng, even, 0.01), _frame(rng, other, 0.02)])
    found = merge(bracket, Setup(CAMERA, LENS, _calibration()), without_ghosts=True)
    inside = found.mask[11:19, 11:19]
    assert np.all(inside & PixelMask.INCONSISTENT)
    assert np.all(inside & PixelMask.MOVED)
    value = np.median(found.radiance[11:19, 11:19]) * E_PER_DN
    assert min(abs(value / 40_000.0 - 1.0), abs(value / 20_000.0 - 1.0)) < 0.03


@pytest.mark.parametrize("curved", [False, True])
def test_a_hot_pixel_clips_by_its_own_dark_signal(rig, curved):
    """Hot pixels clip in the long frame, at less light than others: unbiased within 4 standard deviations of a mean."""
    rng, truth = np.random.default_rng(4), scene(rig, size=60, level=0.85)

    def frame(exposure_s, **settings):
        one = rig.frame(truth, exposure_s, rng, **settings)
        dn = one.dn.astype(int)
        dn[:, ::3] += round(8e5 * exposure_s)
        return Frame(np.minimum(dn, 4095).astype(np.uint16), 12, one.settings)

    exposures = (2.5e-4, 5e-4, 1e-3)
    dark = [frame(t, shutter="closed") for t in exposures for _ in range(8)]
    light = [frame(t) for t in exposures]
    straight = ResponseCurve(np.log(np.maximum(np.arange(4096.0), 1.0)), np.full(4096, 1e-6), absolute=True)
    known = replace(rig.calibration(**EXACT), response=straight if curved else None)
    found = merge(Bracket.from_frames([*dark, *light]), Setup(rig.description, rig.lens, known))
    off = (found.radiance / truth - 1.0)[:, ::3]
    assert not found.mask.any()
    assert abs(off.mean()) < 4.0 * np.mean(found.u_radiance / truth) / np.sqrt(off.size)


def test_gains_may_be_mixed(rig):
    """Frames at 0 and 12 dB of the same scene agree, clip each at its own light, and are combined."""
    rng = np.random.default_rng(6)
    truth = scene(rig, level=0.4)
    frames = [rig.frame(truth, 1e-3, rng, gain_db) for gain_db in (0.0, 6.0, 12.0)]
    found = merged(rig, frames, **EXACT)
    pull = (found.radiance - truth) / found.u_radiance
    assert not found.mask.any()
    assert abs(pull.mean()) < 4.0 / 24


def gamma_frames(rng, bits, truth, exposures_s, noise_dn=0.4):
    """Return photographs through M = full·x^(1/2.2), with a little noise."""
    full = 2**bits - 1
    frames = []
    for t in exposures_s:
        numbers = full * (truth * t) ** (1 / 2.2) + rng.normal(0, noise_dn, truth.shape)
        stored = np.clip(np.rint(numbers), 0, full).astype(np.uint8 if bits == 8 else np.uint16)
        frames.append(Frame(stored, bits, FrameSettings(t)))
    return frames


@pytest.mark.parametrize("bits", [8, 10, 16])
def test_photographs_are_merged_through_their_curve(rig, bits):
    """A gamma camera over three decades: ratios of radiance come out to 1 % after the noise."""
    full = 2**bits - 1
    dn = np.arange(full + 1.0)
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(2.2 * np.log(dn / (full + 1) * 2), np.full(full + 1, 1e-3), valid_dn=(3, full - 1))
    camera = CameraDescription(bit_depth=bits, black_level_dn=0.0, full_well_e=50_000, read_noise_e=3.0)
    scale = rig.calibration().scale.model_copy(update={"f_number": None, "method": "relative"})
    calibration = Calibration(camera, LensDescription(), scale, curve, SensorNoise.of(camera))
    truth = np.tile(np.geomspace(0.2, 200.0, 64), (64, 1))
    frames = gamma_frames(np.random.default_rng(2), bits, truth, tuple(2.0**k / 256 for k in range(10)))
    found = merge(frames, Setup(camera, LensDescription(), calibration))
    relative = found.radiance.mean(axis=0) / truth[0]
    np.testing.assert_allclose(relative / np.median(relative), 1.0, atol=0.01)


def test_the_common_uncertainty_is_stated_apart(rig):
    """Scale, clock, linearity and 3 K of unknown temperature in squares; four years at 1 % per year."""
    found = merged(rig, rig.frames(scene(rig), np.random.default_rng(1), (1e-3,)), u_rel=0.01)
    assert found.u_rel_common == pytest.approx((0.01**2 + 1e-3**2 + 1e-4**2 + 3e-3**2) ** 0.5)
    frames, old = rig.frames(scene(rig), np.random.default_rng(1), (1e-3,)), dt.datetime.now(dt.UTC)
    fresh = replace(rig.calibration(), created=old.isoformat())
    aged = replace(fresh, created=(old - dt.timedelta(days=4 * 365.25)).isoformat())
    young, aged_map = (merge(frames, Setup(rig.description, rig.lens, one)) for one in (fresh, aged))
    assert math.sqrt(aged_map.u_rel_common**2 - young.u_rel_common**2) == pytest.approx(0.04, rel=1e-3)


def test_a_map_says_what_is_not_in_its_u(rig):
    """Stray light by its figure, the pattern of pixels where nothing states it."""
    frames = rig.frames(scene(rig), np.random.default_rng(1), (1e-3,))
    base = rig.calibration()
    words = {}
    for u in (0.0, 0.02):
        stated = base.uncertainties.model_copy(update={"glare_u": u})
        found = merge(frames, Setup(rig.description, rig.lens, replace(base, uncertainties=stated)))
        words[u] = [one for one in found.provenance.assumptions if "stray" in one]
    assert words[0.0] == []
    assert float(words[0.02][0].split("add ")[1].split()[0]) == pytest.approx(0.02 * found.radiance.mean(), rel=0.05)
    rng, truth = np.random.default_rng(1), scene(rig, size=40)
    frames = rig.frames(truth * (1.0 + rng.normal(0.0, 0.01, truth.shape)), rng, (2.5e-4, 5e-4, 1e-3) * 8)
    found = merged(rig, frames)
    assert 0.9 < np.std((found.radiance - truth) / found.parts_of_u(np.s_[:, :])[0]) < 1.1
    unknown = merge(frames, Setup(rig.description, rig.lens))
    assert np.median(unknown.u_radiance / unknown.radiance) < 0.005
    assert [any("pixels differ" in one for one in each.not_in_u) for each in (found, unknown)] == [False, True]


def test_an_offset_of_all_exposures_is_in_the_uncertainty_as_in_that_of_a_reading(rig):
    """3 µs, scaled at 1 ms: 5.7 % where 50 µs alone show light, 0.27 % (2/1.05 ms) with 1 ms as well, 0 at 1 ms."""
    conditions = rig.calibration().scale.conditions.model_copy(update={"inverse_exposure_per_s": 1000.0})
    known = rig.calibration(**EXACT | {"uncertainties": StatedUncertainties(exposure_u_s=3e-6, linearity_u_rel=0.0)})
    known = replace(known, scale=known.scale.model_copy(update={"conditions": conditions}))
    exact = replace(known, uncertainties=known.uncertainties.model_copy(update={"exposure_u_s": 0.0}))
    added = []
    for full_s, shortest in ((50e-6, 50e-6), (1e-3, 50e-6), (1e-3, 1e-3)):
        light = np.full((8, 8), 0.5 * rig.radiance_of_full_scale(full_s))
        frames = rig.frames(light, np.random.default_rng(2), (shortest, 1e-3))
        found, plain = (merge(frames, Setup(rig.description, rig.lens, one)) for one in (known, exact))
        shared, without = (one.radiance[0, 0] ** -1 * one.parts_of_u(np.s_[0, 0])[1] for one in (found, plain))
        named = any(f"{shortest:.3g} s may be off" in one for one in found.provenance.assumptions)
        assert named == (shortest < 1e-3)
        added.append(math.sqrt(shared**2 - without**2))
        reading = read_patch(frames, Patch(0, 0, 8, 8), Setup(rig.description, rig.lens, known))
        of_reading = next(one.u_rel for one in reading.budget if one.name == "exposure offset")
        assert added[-1] == pytest.approx(of_reading, rel=0.05, abs=1e-5)
    assert added == pytest.approx([3e-6 * 19_000, 3e-6 * 905, 0.0], rel=0.05, abs=1e-5)


@pytest.mark.parametrize("real_db", [12.0, 11.5, 12.3])
def test_frames_at_two_gains_show_a_wrong_step_between_them(rig, real_db):
    """12 dB stated: in map and reading a doubt with the step that the frames show."""
    rng, light = np.random.default_rng(5), np.full((16, 16), 0.2 * rig.radiance_of_full_scale(1e-3))
    frames = rig.frames(light, rng, (1e-3,) * 3)
    for one in rig.frames(light, rng, (1e-3,) * 3):
        dn = np.rint((one.dn - rig.black_dn) * 10.0 ** (real_db / 20.0) + rig.black_dn).astype(np.uint16)
        frames.append(replace(one, dn=dn, settings=replace(one.settings, gain_db=12.0)))
    setup = Setup(rig.description, rig.lens, rig.calibration(**EXACT))
    for found in (merge(frames, setup), read_patch(frames, Patch(0, 0, 16, 16), setup)):
        doubts = [text for text in found.provenance.assumptions if "and not by 12" in text]
        shown = [float(text.split("rises by ")[1].split()[0]) for text in doubts]
        assert shown == ([] if real_db == 12.0 else [pytest.approx(real_db, abs=0.05)])


@pytest.mark.parametrize("gain_e_per_dn", [0.25, 1.0, 4.0])
def test_noise_that_nothing_states_is_taken_from_the_frames(rig, gain_e_per_dn):
    """One frame of each exposure: no decade's pull is wider than 1.15; flicker is no noise; one frame shows none."""
    rig = rig.but(gain_e_per_dn=gain_e_per_dn, full_well_e=1e6)
    camera = CameraDescription(bit_depth=12, model="generated", serial="1", black_level_dn=64.0, dark_current_e_per_s=0)
    top = rig.radiance_of_full_scale(1e-3)
    truth = np.tile(np.geomspace(1e-3 * top, 0.9 * top, 120), (60, 1))
    frames = rig.frames(truth, np.random.default_rng(3), (1e-3, 4e-3, 1.6e-2, 6.4e-2))
    found = merge(iter(frames), Setup(camera, rig.lens))
    off = (found.radiance / (truth / top * (4095 - 64) / 1e-3) - 1.0) * found.radiance / found.u_radiance
    assert not found.mask.any()
    assert max(part.std() for part in np.split(off, 3, axis=1)) < 1.15
    dimmer = rig.frames(0.7 * truth, np.random.default_rng(4), (4e-3,))
    flickering = merge(iter([frames[0], *dimmer, *frames[2:]]), Setup(camera, rig.lens))
    assert np.median(flickering.u_radiance / found.u_radiance) < 1.1
    one = merge(frames[:1], Setup(camera, rig.lens)).provenance.assumptions
    typical = [any("rests on typical noise" in text for text in each) for each in (found.provenance.assumptions, one)]
    assert typical == [False, True]


def test_masked_pixels_take_the_place_of_the_stated_black_level(rig):
    """Frames 20 DN above the stated black level, whose masked pixels say so: the map is right, its dark u smaller."""
    level, rng = 20.0, np.random.default_rng(1)
    frames = [
        replace(one, dn=(one.dn + int(level)).astype(np.uint16))
        for one in rig.frames(0.1 * scene(rig), rng, (1e-3,) * 4)
    ]
    black = frames[0].settings.black_level_dn
    reported = [replace(one, extra={"masked_rows_dn": black + level}) for one in frames]
    blind, right = (merge(each, Setup(rig.description, rig.lens, rig.calibration())) for each in (frames, reported))
    truth = 0.1 * scene(rig)
    assert np.median(right.radiance / truth) == pytest.approx(1.0, abs=3e-3)
    assert np.median(blind.radiance / truth) > 1.02
    assert np.median(right.u_radiance) < np.median(blind.u_radiance)


def test_a_map_says_what_light_of_another_spectrum_may_be_off_by(rig):
    """White LED assumed, camera unknown: 20 %; the figure that somebody states in its place; relative maps: nothing."""
    base, frames = rig.calibration(spectrum="white_led"), rig.frames(scene(rig), np.random.default_rng(1), (1e-3,))
    stated = base.uncertainties.model_copy(update={"spectral_u_rel": 0.05})
    relative = replace(base, scale=base.scale.model_copy(update={"method": "relative"}))
    reported = []
    for known in (base, replace(base, uncertainties=stated), relative):
        words = merge(frames, Setup(rig.description, rig.lens, known)).not_in_u
        reported.append(
            [one.split(": ")[1].split(" (k = 1)")[0] for one in words if "another spectrum than white_led" in one]
        )
    assert reported == [["20 %"], ["5 %"], []]


def misfits(rig):
    rng = np.random.default_rng(1)
    light = rig.frame(scene(rig), 1e-3, rng)
    dark = rig.frame(scene(rig), 1e-3, rng, shutter="closed")
    return {
        "no frame": ([], "shutter open"),
        "dark only": ([dark], "shutter open"),
        "dark late": ([light, dark], "dark frames first"),
        "sizes": ([light, rig.frame(scene(rig, size=12), 1e-3, rng)], "12 × 12"),
        "levels": ([light, rig.frame(scene(rig), 1e-3, rng, source_level=0.5)], "source level"),
        "bits": ([Frame(light.dn, 14, light.settings)], "14 bits"),
        "many": ([rig.frame(scene(rig), 1e-3, rng) for _ in range(65)], "64"),
    }


@pytest.mark.parametrize("case", ["no frame", "dark only", "dark late", "sizes", "levels", "bits", "many"])
def test_frames_that_do_not_belong_together_are_refused(rig, case):
    """The message says what does not fit."""
    frames, message = misfits(rig)[case]
    with pytest.raises(MeasurementError, match=message):
        merge(frames, Setup(rig.description, rig.lens))


def test_without_a_place_for_compiled_code_it_is_compiled_anew(monkeypatch):
    """A read-only installation must not keep anyone from merging."""
    compile_function = merge_compile.numba.njit

    def no_cache(*args, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return compile_function(*args, **options)

    monkeypatch.setattr(merge_compile.numba, "njit", no_cache)
    assert merge_compile.compiled(lambda x: x + 1)(2) == 3


@pytest.mark.parametrize("dark_e", [0.0, 5000.0])
def test_a_pixel_s_uncertainty_is_that_of_its_electrons(rig, dark_e):
    """One frame: the root of light, dark, reading (squared) and rounding, over the light; no term may be missing."""
    camera = CameraDescription(**{**rig.description.model_dump(), "dark_current_e_per_s": dark_e / 1e-3})
    calibration = replace(rig.calibration(**EXACT), camera=camera, noise=SensorNoise.of(camera))
    light_dn = 20.0
    number = round(64.0 + light_dn + dark_e / rig.gain_e_per_dn)
    frame = Frame(np.full((4, 4), number, np.uint16), 12, FrameSettings(1e-3, 0.0, 4.0, 64.0, 25.0))
    found = merge([frame], Setup(camera, rig.lens, calibration))
    light_e = (number - 64.0) * rig.gain_e_per_dn - dark_e
    variance = light_e + dark_e + rig.read_e**2 + rig.gain_e_per_dn**2 / 12.0
    expected = np.sqrt(variance) / light_e
    assert found.u_radiance[0, 0] / found.radiance[0, 0] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(("declared", "share"), [("none", 0.6), ("cos4", 0.05)])
def test_a_falloff_without_a_flat_field_is_taken_out_and_doubted(rig, declared, share):
    """In the corner cos⁴α = 0.64 is divided out; 60 % of what was lost joins u, 5 % where the lens is declared so."""
    camera = rig.description.model_copy(update={"pixel_pitch_um": 8.0 / np.hypot(5.5, 5.5) * 1e3})
    frame = Frame(np.full((12, 12), 2064, np.uint16), 12, FrameSettings(1e-3, 0.0, 4.0, 64.0, 25.0))
    plain = merge([frame], Setup(rig.description, rig.lens, rig.calibration()))
    lens, calibration = rig.lens.model_copy(update={"vignetting": declared}), rig.calibration()
    found = merge([frame], Setup(camera, lens, replace(calibration, lens=lens)))
    assert found.radiance[0, 0] / plain.radiance[0, 0] == pytest.approx(1.25**2, rel=1e-5)
    noise, u = (float(one.u_radiance[0, 0] / one.radiance[0, 0]) for one in (plain, found))
    assert np.sqrt(u**2 - noise**2) == pytest.approx(share * (1.0 - 0.64) / 0.64, rel=0.01)


@pytest.mark.parametrize(("count", "lights"), [(1, 1), (4, 1), (1, 9)])
def test_the_noise_of_dark_frames_is_in_every_pixel(rig, count, lights):
    """Taken off pixel by pixel, the mean of n dark frames adds (σ_r² + K²/12)/n to a pixel's variance, in any light."""
    light_dn, taken = 20, FrameSettings(1e-3, 0.0, 4.0, 64.0, 25.0)
    each = [np.full((4, 4), 64 + light_dn, np.uint16) for _ in range(lights)]
    for number, one in enumerate(each):
        one[3, 3] += number  # no copies
    light = [Frame(one, 12, taken) for one in each]
    dn = np.full((4, 4), 64, np.uint16)
    dn[1:, ::2] -= 2  # the noise that rounding needs
    each = [dn.copy() for _ in range(count)]
    for number, one in enumerate(each):
        one[3, 3] += number  # no copies
    darks = [Frame(one, 12, replace(taken, shutter="closed")) for one in each]
    found = merge(Bracket.from_frames([*light, *darks]), Setup(rig.description, rig.lens, rig.calibration(**EXACT)))
    light_e, readout = light_dn * rig.gain_e_per_dn, rig.read_e**2 + rig.gain_e_per_dn**2 / 12.0
    expected = math.sqrt((light_e + readout) / lights + readout / count) / light_e
    assert found.u_radiance[0, 0] / found.radiance[0, 0] == pytest.approx(expected, rel=2e-3)


# What moved through a scene: taken from the frames that agree, marked, and the reading right.


E_PER_DN, READ_E, BLACK, SHAPE = 2.6, 2.4, 64.0, (60, 80)
CAMERA = CameraDescription(
    bit_depth=12,
    conversion_gain_e_per_dn=E_PER_DN,
    read_noise_e=READ_E,
    full_well_e=10_500.0,
    dark_current_e_per_s=0.0,
    black_level_dn=BLACK,
)
LENS = LensDescription(f_number=4.0)
TIMES = 0.01 * 2.0 ** np.arange(6)


def _calibration(flat=None):
    black = BlackLevel(dn=BLACK, u_dn=0.0, dark_u_rel=0.0)
    return relative_calibration(CAMERA, SensorNoise.of(CAMERA), lens=LENS, black_level=black, flat_field=flat)


def _frame(rng, electrons_per_s, seconds):
    electrons = np.minimum(rng.poisson(electrons_per_s * seconds), 10_500) + rng.normal(0.0, READ_E, SHAPE)
    dn = np.clip(np.rint(electrons / E_PER_DN + BLACK), 0, 4095).astype(np.uint16)
    return Frame(dn, 12, FrameSettings(float(seconds), f_number=4.0, black_level_dn=BLACK))


def _scene(rng):
    return np.kron(np.exp(rng.normal(size=(6, 8))), np.ones((10, 10))) * 30_000.0


def _z(found, scene):
    """Return (value − truth)/u; the map is in DN per s."""
    return (found.radiance.astype(float) - scene / E_PER_DN) / found.u_radiance.astype(float)


@pytest.fixture(scope="module")
def passer_by():
    """Return scene, bracket and where something stood: another place in every frame, darker or brighter."""
    rng = np.random.default_rng(5)
    scene = _scene(rng)
    frames, stood = [], np.zeros(SHAPE, bool)
    for k, seconds in enumerate(TIMES):
        light = scene.copy()
        if 1 <= k <= 4:
            place = slice(20, 40), slice(15 * k - 10, 15 * k + 5)
            light[place] *= (0.2, 3.0)[k % 2]
            stood[place] = True
        frames.append(_frame(rng, light, seconds))
    return scene, Bracket.from_frames(frames), stood


def test_what_moved_is_left_out(passer_by):
    """The map holds the scene behind it with a true uncertainty; the plain merge only says that frames disagree."""
    scene, bracket, stood = passer_by
    found = merge(bracket, Setup(CAMERA, LENS, _calibration()), without_ghosts=True)
    assert np.mean(found.mask[stood] & PixelMask.MOVED > 0) > 0.9
    assert np.mean(found.mask[~stood] & PixelMask.MOVED > 0) < 0.002
    z = _z(found, scene)
    assert np.sqrt(np.mean(z[found.mask & PixelMask.MOVED > 0] ** 2)) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(np.mean(z[stood] ** 2)) < 1.3
    inside = found.radiance[20:40, 10:60].astype(float).sum()
    assert inside == pytest.approx(scene[20:40, 10:60].sum() / E_PER_DN, rel=2e-3)
    found = merge(bracket, Setup(CAMERA, LENS, _calibration()))
    assert not np.any(found.mask & PixelMask.MOVED)
    assert np.mean(found.mask[stood] & PixelMask.INCONSISTENT > 0) > 0.9
    assert np.sqrt(np.mean(_z(found, scene)[stood] ** 2)) > 10.0


def test_a_frame_that_clips_contradicts_what_is_dark():
    """A lamp that is on in the one frame that clips there does not make the two dark ones brighter."""
    rng = np.random.default_rng(7)
    scene = np.full(SHAPE, 50_000.0)
    lit = scene.copy()
    lit[10:20, 10:20] *= 100.0
    frames = [_frame(rng, scene, 0.01), _frame(rng, scene, 0.02), _frame(rng, lit, 0.04), _frame(rng, scene, 0.08)]
    found = merge(Bracket.from_frames(frames), Setup(CAMERA, LENS, _calibration()), without_ghosts=True)
    assert np.all(found.mask[11:19, 11:19] == PixelMask.MOVED)
    assert np.sqrt(np.mean(_z(found, scene)[11:19, 11:19] ** 2)) == pytest.approx(1.0, abs=0.25)


def test_what_a_frame_does_not_show_is_not_missed():
    """Where a frame shows nothing the others are merged, and no one says that something moved."""
    rng = np.random.default_rng(3)
    scene = _scene(rng)
    frames = [_frame(rng, scene, seconds) for seconds in TIMES]
    absent = [np.zeros(SHAPE, bool) for _ in TIMES]
    absent[2][:, :7] = absent[4][:12] = True
    absent[0][:, 70:] = True
    for k in (0, 2, 4):
        dn = frames[k].dn.copy()
        dn[absent[k]] = 4095
        frames[k] = Frame(dn, 12, frames[k].settings)
    flat = FlatField(
        shape=SHAPE, principal_point_px=(40.0, 30.0), radius_px=50.0, coefficients=(-0.3, 0.0, 0.0), u_rel=0.0
    )
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    falloff = 1.0 - 0.3 * ((x - 40.0) ** 2 + (y - 30.0) ** 2) / 50.0**2
    for known, truth in ((None, scene), (flat, scene / falloff)):
        found = merge(
            Bracket.from_frames(frames), Setup(CAMERA, LENS, _calibration(known)), absent=absent, without_ghosts=True
        )
        assert np.mean(found.mask == 0) > 0.995
        edge = _z(found, truth)[absent[0] | absent[2] | absent[4]]
        assert np.sqrt(np.mean(edge**2)) == pytest.approx(1.0, abs=0.1)


# Frames that lie apart by parts of a pixel make a map uncertain at gradients, not on even ground.


LINEAR_CAMERA, LINEAR_LENS = CameraDescription(bit_depth=12), LensDescription()
NOISE = SensorNoise(conversion_gain_e_per_dn=4.0, read_noise_e=4.0, full_well_e=20_000.0)
WAVES_SHAPE, PERIOD = (96, 128), 16.0


SETUP = Setup(LINEAR_CAMERA, LINEAR_LENS, relative_calibration(LINEAR_CAMERA, NOISE, black_level=BlackLevel(dn=0.0)))


def _bracket(rng, shifts):
    """Return frames of even ground (left) next to waves across the columns (right), each displaced along the row."""
    frames = []
    for time, shift in zip(2.0 ** np.arange(len(shifts)), shifts, strict=True):
        place = np.arange(WAVES_SHAPE[1]) + shift
        waves = np.where(place > WAVES_SHAPE[1] / 2, 0.8 * np.sin(2.0 * np.pi * place / PERIOD), 0.0)
        electrons = rng.poisson(np.broadcast_to(3000.0 * time / 8.0 * np.exp(waves), WAVES_SHAPE))
        dn = (electrons + NOISE.read_noise_e * rng.standard_normal(WAVES_SHAPE)) / NOISE.conversion_gain_e_per_dn
        frames.append(Frame(np.clip(np.round(dn), 0, 4095).astype(np.uint16), 12, FrameSettings(float(time))))
    return Bracket.from_frames(frames)


def _truth():
    place = np.arange(WAVES_SHAPE[1])
    return np.where(place > WAVES_SHAPE[1] / 2, 0.8 * np.sin(2.0 * np.pi * place / PERIOD), 0.0)


def test_u_holds_what_displaced_frames_are_off_at_gradients():
    """There it grows, on even ground it does not, and noise makes no shift."""
    bracket = _bracket(np.random.default_rng(1), np.zeros(4))
    plain = merge(bracket, SETUP)
    doubtful = merge(bracket, SETUP, displacement_px=0.5)
    assert np.array_equal(plain.radiance, doubtful.radiance)
    ratio = doubtful.u_radiance / plain.u_radiance
    assert np.median(ratio[:, 4:60]) == pytest.approx(1.0, abs=0.02)
    steep = 72 + 8 * np.arange(7)  # where sin crosses 0: |∇ln L| = 0.8·sin(2π/16)
    joined = np.sqrt(doubtful.u_radiance**2 - plain.u_radiance**2)[:, steep] / plain.radiance[:, steep]
    whole = 0.5 * 0.8 * np.sin(2.0 * np.pi / PERIOD)
    assert 0.5 * whole < np.median(joined) < whole
    rng, squares = np.random.default_rng(2), []
    for _ in range(24):
        found = merge(_bracket(rng, 0.3 * rng.standard_normal(4)), SETUP, displacement_px=0.3)
        gap = found.radiance / np.exp(_truth()) / np.median(found.radiance[:, 4:60]) - 1.0
        z = gap / (found.u_radiance / found.radiance)
        squares.append(np.mean(np.clip(z[:, 72:124], -5.0, 5.0) ** 2))
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, rel=0.2)
    rng = np.random.default_rng(5)
    value = (1.0 + 0.01 * rng.standard_normal((80, 80))).astype(np.float32)
    shift = relative_shift(value, np.full_like(value, 0.01), 0.5)
    assert np.sqrt(np.mean(shift**2)) < 0.005
    slope = np.exp(0.1 * np.arange(40.0, dtype=np.float32))[None, :].repeat(8, axis=0)
    assert relative_shift(slope, np.zeros_like(slope), 0.5)[4, 1:-1] == pytest.approx(0.05, rel=1e-4)


def test_displacement_explains_what_it_can_and_leaves_ghosts():
    """Displaced frames do not contradict; what is left is as sure as its neighbours, or moved."""
    bracket = _bracket(np.random.default_rng(3), [0.3, -0.3, 0.3, -0.3])
    plain = merge(bracket, SETUP, without_ghosts=True)
    known = merge(bracket, SETUP, without_ghosts=True, displacement_px=0.3)
    doubt = PixelMask.MOVED | PixelMask.INCONSISTENT
    assert np.mean(plain.mask[:, 72:124] & doubt > 0) > 0.2
    assert np.mean(known.mask & doubt > 0) < 0.005
    plain = merge(bracket, SETUP)
    known = merge(bracket, SETUP, displacement_px=0.3)
    excused = (plain.mask & ~known.mask & PixelMask.INCONSISTENT) > 0
    halves = [k for k in range(72, 124) if 20 <= excused[:, k].sum() <= WAVES_SHAPE[0] - 15]
    ratios = [np.median(known.u_radiance[excused[:, k], k]) / np.median(known.u_radiance[~excused[:, k], k])
              for k in halves]  # fmt: skip
    assert len(ratios) > 10
    assert min(ratios) > 0.98
    assert max(ratios) < 1.1
    frames = list(_bracket(np.random.default_rng(4), np.zeros(4)).light)
    lit = frames[1].dn.copy()
    lit[40:50, 20:30] = 3000
    frames[1] = Frame(lit, 12, frames[1].settings)
    bracket = Bracket.from_frames(frames)
    found = merge(bracket, SETUP, without_ghosts=True, displacement_px=0.3)
    assert np.all(found.mask[42:48, 22:28] & PixelMask.MOVED)
    level = np.median(found.radiance[:, 4:16])
    assert found.radiance[42:48, 22:28] == pytest.approx(level, rel=0.15)


@pytest.mark.parametrize("pixels", [7, 2])
@pytest.mark.parametrize("of_each", [False, True])
def test_each_level_has_the_weights_of_its_own(of_each, pixels):
    """From the lowest rate on in sixteenths of an e-fold, and the first and last beyond: δ·|∇ln L|·L·√Σp² joins u."""
    factors = np.array([0.9, 0.8, 0.7, 0.6])
    steps = np.array([-3.0, 0.0, 0.4, 0.6, 2.0, 3.0, 9.0])
    expected = np.array([0.9, 0.9, 0.9, 0.8, 0.7, 0.6, 0.6])[:pixels]
    unit = np.linspace(1.0, 2.0, pixels) if of_each else np.array([2.0])
    value = (unit * np.exp(np.log(5.0) + steps[:pixels] / 16.0)).astype(np.float32)
    u, shift = 0.01 * value, np.full(pixels, 0.1, np.float32)
    with_shift(value, u, shift, unit.astype(np.float32), AtLevels(float(np.log(5.0)), factors[None], factors, factors))
    assert u / value == pytest.approx(np.hypot(0.01, 0.1 * expected), rel=1e-4)

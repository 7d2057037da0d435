"""Sources of error that several figures share: basis and variance become weights."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.ndimage import convolve

from radiometer.data import CameraDescription, CaptureHeader, FrameEntry, FrameSettings, PatchDescription
from radiometer.reconciliation.descent import UnfitError, included
from radiometer.reconciliation.design import CaptureStatistics, Design
from radiometer.reconciliation.lines import RowBins, TileBands
from radiometer.reconciliation.localise import Covariate
from radiometer.reconciliation.reduce import reduce_frames
from radiometer.reconciliation.repeatability import capture_scale
from radiometer.reconciliation.screening import StartPool, of_seen_codes
from radiometer.reconciliation.shared_errors import (
    Part,
    Repeatability,
    SharedError,
    mixing_of_bands,
    mixing_of_lines,
    phases_of_wave,
    renewed_patterns,
    shared_errors,
    whiteners,
)
from radiometer.reconciliation.statistics import STATISTICS, Given, Prediction, Scale, Scatter, family_of, named
from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.brighter_fatter import push_of
from simulators.effects.catalogue import Scaling
from simulators.effects.missing_codes import MissingCodes
from simulators.effects.pwm_flicker import PwmFlicker
from testing.reduced import start_of


@pytest.fixture
def design():
    """Return a set of five frames with two patches side by side and one below them."""
    patches = tuple(
        PatchDescription(name=name, x=x, y=y, width=32, height=40)
        for name, x, y in (("a", 0, 0), ("b", 40, 0), ("c", 0, 50))
    )
    frames = tuple(FrameEntry.of(f"{n}.tif", FrameSettings(0.01)) for n in range(5))
    header = CaptureHeader(camera=CameraDescription(bit_depth=12), frames=frames, patches=patches)
    return Design.of(header, (100, 80))


def test_shared_errors_give_the_covariance_beyond_own_uncertainty():
    """B·Φ·Bᵀ of two z; the whitener times it is the identity."""
    basis = np.array([[1.0, 0.0], [1.0, 2.0]])
    part = Part(np.array([[2.0, 3.0]]), np.broadcast_to(basis, (1, 2, 2)))
    found = SharedError("test", {"mean": part}, np.array([[4.0, 9.0]])).covariance("mean")[0]
    assert found.tolist() == [[4.0 * 4.0, 6.0 * 4.0], [6.0 * 4.0, 9.0 * (4.0 + 4.0 * 9.0)]]
    error = SharedError("test", {"bands": Part(np.ones((1, 3)), np.ones((3, 1)))}, np.array([0.5]), within=True)
    assert error.covariance("bands")[0].tolist() == [[0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0]]
    errors = [
        SharedError("one", {"mean": Part(np.array([[1.0, 2.0, 0.0]]), np.ones((3, 1)))}, np.array([0.3])),
        SharedError("two", {"mean": Part(np.array([[1.0, -1.0, 0.0]]), np.ones((3, 1)))}, np.array([2.0])),
    ]
    usable, sigma = np.array([[True, True, False]]), np.array([[0.5, 0.2, 7.0]])
    (whitener,) = whiteners(errors, {"mean": sigma}, {"mean": usable})["mean"]
    covariance = errors[0].covariance("mean")[0] + errors[1].covariance("mean")[0] + np.diag([0.25, 0.04, 1.0])
    assert whitener @ covariance @ whitener.T == pytest.approx(np.eye(3), abs=1e-12)


@pytest.mark.parametrize("flicker2", [0.0, 0.09])
def test_noise_of_all_tiles_follows_the_light_of_the_same_few_frames(design, flicker2):
    """Light that differs by 0.3 from frame to frame moves ln(variance) of all tiles together: 0.09/n of it."""
    captures, n = len(design.captures), design.frame_count
    every, none = np.ones((captures, 3)), np.zeros(captures)
    usable = dict.fromkeys(("mean", "first", "slope_y", "variance", "spatial"), every > 0)
    response = every * [0.9, 0.5, 0.0]
    repeats = Repeatability(1e-3, np.full(captures, flicker2), none, none, 0.0)
    found = shared_errors(design, None, usable, every, repeats, {"variance": response})
    noise = [error for error in found if "variance" in error.parts]
    assert len(noise) == (1 if flicker2 else 0)
    for error in noise:
        assert error.covariance("variance")[0][0] == pytest.approx(flicker2 / n[0] * 0.9 * response[0])


def test_tiles_share_rows_and_waves_with_their_few_phases(design):
    """1/40 side by side, the cosine of a distance, 2ρ²/(n−1) − (½+ρ²)/n of squares."""
    shared = design.rows_of_tiles @ design.rows_of_tiles.T
    assert shared[0, 1] * design.tile_height[0] == pytest.approx(1.0, abs=0.1)  # a margin may take rows off
    assert shared[0, 2] == 0.0
    assert shared[0, 1] == pytest.approx(shared[0, 0])
    distance = float(np.diff(TileBands.of(design, 0.1).middle[[0, 2]])[0])
    for periods, correlation in ((0.5, -1.0), (0.25, 0.0), (1.0, 1.0)):
        left = TileBands.of(design, periods / distance)
        quadratures = left.quadratures(np.ones(3))
        assert quadratures[0] @ quadratures[2] == pytest.approx(correlation, abs=1e-9)
    bins = RowBins.of(design)
    basis = np.zeros((1, 3, bins.number))
    basis[0, 1, 3], basis[0, 2, 8] = 1.0, 1.0
    frequency = 0.031
    error = phases_of_wave(design, basis, np.ones((1, 2), np.bool_), np.ones((1, 2)), frequency)
    square = np.cos(2.0 * np.pi * frequency * (bins.middle[8] - bins.middle[3])) ** 2
    n = 4.0  # of five frames the first may differ for a reason of its own
    expected = (2.0 * square / (n - 1.0) - (0.5 + square) / n) / (2.0 / (n - 1.0) - 1.5 / n)
    assert error.covariance("bands")[0, 0, 1] == pytest.approx(0.85 * expected, rel=1e-12)


@pytest.mark.parametrize("name", STATISTICS)
def test_a_row_of_the_table_is_measured(name, design):
    """Every statistic is one of those that are measured, along axes that are covariates, and captures come first."""
    row = STATISTICS[name]
    assert name in CaptureStatistics.__dataclass_fields__
    assert row.along
    assert row.forms
    assert row.shape(design)[0] == len(design.captures)
    assert (len(row.shape(design)) == 1) == (row.given is Given.CAPTURE)


def test_what_follows_the_light_is_predicted_by_its_sensitivity(design):
    """d(mean)/d(log light) of the tiles that count, and no other."""
    for name, row in STATISTICS.items():
        if row.determines_light or row.follows_light:
            assert row.given is Given.TILE
            assert name in Prediction.__dataclass_fields__
    captures = len(design.captures)
    sensitivity = np.tile([120.0, 35.0, 7.0], (captures, 1))
    counts = np.tile([True, True, False], (captures, 1))
    usable = dict.fromkeys(("mean", "first", "slope_y", "variance", "spatial"), counts)
    none = np.zeros(captures)
    repeats = Repeatability(0.01, np.full(captures, 0.0004), none, none, 0.0)
    found = {error.name: error for error in shared_errors(design, None, usable, sensitivity, repeats, {})}
    moved = np.array([120.0, 35.0, 0.0])
    np.testing.assert_allclose(found["light of a capture"].covariance("mean")[0], 1e-4 * np.outer(moved, moved))
    # Five frames: the mean has a fifth of their variance, the first less the mean of the four others five quarters.
    np.testing.assert_allclose(found["light of its frames"].covariance("mean")[0], 8e-5 * np.outer(moved, moved))
    first = found["light of its first frame"].covariance("first")[0]
    np.testing.assert_allclose(first, 4e-4 * 1.25 * np.outer(moved, moved))


# What noise reports and what counts, by laws and at exact bounds.


def test_rows_of_the_table_have_kinds_and_captures_their_light():
    """The weighted mean of tiles over their sensitivity."""
    assert {family_of(name) for name in ("slope_x", "slope_y")} == {"slope"}
    assert family_of("mean") == "mean"
    assert {"mean", "variance", "first"} <= set(named(given=Given.TILE)) < set(named())
    assert named(scale=Scale.COMB) == named(given=Given.PERIOD) == ("comb",)
    rng = np.random.default_rng(3)
    sensitivity, deviation = rng.uniform(50.0, 500.0, (3, 8)), rng.uniform(0.5, 2.0, (3, 8))
    usable = np.ones((3, 8), bool)
    usable[1, ::2], usable[2] = False, False
    shift = np.array([0.01, -0.02, 0.03])
    scale, variance = capture_scale(shift[:, None] * sensitivity, sensitivity, deviation, usable)
    assert scale[:2] == pytest.approx(shift[:2])
    assert (scale[2], variance[2]) == (0.0, math.inf)
    assert 1.0 / variance[0] == pytest.approx(np.sum((sensitivity[0] / deviation[0]) ** 2))
    assert 1.0 / variance[1] == pytest.approx(np.sum((sensitivity[1, 1::2] / deviation[1, 1::2]) ** 2))


@pytest.mark.parametrize(("levels", "terms"), [(1, 0), (2, 1), (8, 7), (9, 4)])
def test_few_levels_are_taken_one_by_one_and_many_by_a_smooth_curve(levels, terms):
    """Up to eight each but the first has a column of its own; beyond, four polynomials of mean nought; gains to 16."""
    value = np.repeat(np.arange(float(levels)), 3).reshape(levels, 3)
    found = Covariate("exposure_s", value, per_capture=True).basis()
    assert found.shape == (levels, 3, terms)
    if 1 < levels <= 8:
        assert found.sum(axis=-1).tolist() == (value > 0).astype(float).tolist()
    of_gain = Covariate("gain_db", value, per_capture=True).basis()
    assert of_gain.shape[-1] == levels - 1


# What charge that neighbours exchange does to the means of lines, and where searches begin.


@pytest.mark.slow
def test_search_for_a_flicker_begins_near_it(make_capture):
    """A sine of 9 % at 480 Hz, up to three periods in an exposure, is met within a hundredth of its frequency."""
    rng = np.random.default_rng(11)

    def flickering(image, setting):
        wave = 0.09 * np.sinc(480.0 * setting["t"]) * np.cos(2 * np.pi * rng.random())
        return image * (1.0 + wave)

    state = start_of(make_capture(5, picture=flickering))
    (first, *_) = StartPool().likeliest(state, PwmFlicker)
    assert first.frequency_hz == pytest.approx(480.0, rel=0.02)
    if first.duty == 0:
        assert first.modulation == pytest.approx(0.09, rel=0.4)


@pytest.mark.slow
@pytest.mark.parametrize(("step", "possible"), [(2, {2.0}), (4, {2.0**power for power in range(1, 9)})])
def test_codes_that_occur_rule_out_a_coarser_step(make_capture, declared, step, possible):
    """Of all steps only those remain that leave no code empty which occurs, as far as periods up to 5 tell."""
    captured = make_capture(7)
    coarse = [replace(frame, dn=frame.dn - frame.dn % step) for frame in captured.frames]
    seen, _ = reduce_frames(Design.of(captured.header, coarse[0].shape), coarse.__getitem__)
    left = of_seen_codes(seen, MissingCodes.starts(declared.model.context))
    assert {effect.step_codes for effect in left if effect.kept_codes == 1.0} == possible


@pytest.mark.slow
def test_charge_that_neighbours_exchange_stays_in_the_means_of_lines(declared):
    """Means of lines of mixed noise scatter as predicted, over what the mixed pixels' own variance would give."""
    height, width = declared.design.tiles[0].height, declared.design.tiles[0].width
    x, y = 0.02, 0.01
    kernel = np.array([[0, y, 0], [x, 1 - 2 * x - 2 * y, x], [0, y, 0]])
    noise = convolve(np.random.default_rng(2).standard_normal((height * 200, width * 200)), kernel, mode="wrap")
    variance = float(noise.var())
    own = kernel[1, 1]
    ones = np.ones_like(declared.prediction.variance)
    mixed = replace(declared.prediction, mixed_x=2 * x * own / variance * ones, mixed_y=2 * y * own / variance * ones)
    rows = noise.reshape(-1, width).mean(axis=1).var() * width / variance - 1.0
    predicted = mixing_of_lines(mixed, declared.design, "row_temporal")
    assert rows == pytest.approx(float(predicted[0]), abs=4 * np.sqrt(2 * width / noise.size))
    # Slow bands keep more of it than fast ones; order k of n rows is k/(2n) periods per row.
    bands = mixing_of_bands(mixed, declared.design)[0]
    of_rows = noise.reshape(noise.shape[0], -1, width).mean(axis=2)
    power = (np.abs(np.fft.rfft(of_rows, axis=0)) ** 2).mean(axis=1) * width / noise.shape[0] / variance
    for order in (1, bands.size):
        middle = order / declared.design.shape[0] * (power.size - 1)
        near = slice(max(int(middle) - 40, 1), int(middle) + 40)
        uncertainty = 1.0 / np.sqrt(len(power[near]) * of_rows.shape[1])
        assert float(power[near].mean()) - 1.0 == pytest.approx(float(bands[order - 1]), abs=4 * uncertainty)


@pytest.mark.slow
def test_charge_that_is_pushed_far_stays_in_the_means_of_lines(declared):
    """Flats with covariances of many lags: rows, columns, bands of rows and tiles scatter as told, to 4 sigma."""
    height, width = declared.design.tiles[0].height, declared.design.tiles[0].width
    push = push_of(8, 0.56, 0.45)
    kernel, middle = push.kernel, push.kernel.shape[0] // 2
    shape = (height * 200, width * 200)
    wide = np.zeros(shape)
    wide[: kernel.shape[0], : kernel.shape[1]] = kernel
    power = 1.0 + 0.2 / 8.0 * 2.0 * np.fft.rfft2(np.roll(wide, (-middle, -middle), (0, 1))).real
    white = np.fft.rfft2(np.random.default_rng(2).standard_normal(shape))
    noise = np.fft.irfft2(white * np.sqrt(power), s=shape)
    whole = np.fft.irfft2(power, s=shape)  # covariance by lag
    variance, x, y = (float(whole[at]) for at in ((0, 0), (0, 1), (1, 0)))
    sums = {"beyond_x": whole[0, 2:20].sum(), "beyond_y": whole[2:20, 0].sum(), "beyond_rows": whole[1:20].sum() - y}
    ones = np.ones_like(declared.prediction.variance)
    figures = {name: value / variance * ones for name, value in ({"mixed_x": x, "mixed_y": y} | sums).items()}
    mixed = replace(declared.prediction, **figures)
    rows = noise.reshape(-1, width).mean(axis=1).var() * width / variance - 1.0
    columns = noise.reshape(-1, height, shape[1]).mean(axis=1).var() * height / variance - 1.0
    stated_rows = float(mixing_of_lines(mixed, declared.design, "row_temporal")[0])
    share = declared.prediction.variance[0] / declared.design.frame_count[0] / declared.prediction.spatial[0]
    stated_columns = float(mixing_of_lines(mixed, declared.design, "columns")[0] / share.mean())
    assert rows == pytest.approx(stated_rows, abs=4 * np.sqrt(2 * width / noise.size))
    assert columns == pytest.approx(stated_columns, abs=4 * np.sqrt(2 * height / noise.size))
    bands = mixing_of_bands(mixed, declared.design)[0]
    of_rows = noise.reshape(noise.shape[0], -1, width).mean(axis=2)
    seen = (np.abs(np.fft.rfft(of_rows, axis=0)) ** 2).mean(axis=1) * width / noise.shape[0] / variance
    at = round(0.5 / declared.design.shape[0] * (seen.size - 1))  # the slowest band
    near = slice(max(at - 40, 1), at + 40)
    assert float(seen[near].mean()) - 1.0 == pytest.approx(
        float(bands[0]), abs=4 / np.sqrt(len(seen[near]) * of_rows.shape[1])
    )
    assert stated_rows > 2.0 * x / variance * 1.02  # the nearest alone tell less


@pytest.mark.slow
def test_captures_of_one_setting_tell_their_pattern_once(declared):
    """By √m of the pattern over the root of their pixels; what cannot be is refused by name."""
    assert renewed_patterns(declared.design, declared.seen, declared.prediction) == {}
    pattern = replace(declared.prediction, renewed_variance=4.0 * np.ones_like(declared.prediction.mean))
    found = renewed_patterns(declared.design, declared.seen, pattern)
    number = np.array([np.sum(declared.design.setting_id == one) for one in declared.design.setting_id])
    np.testing.assert_allclose(found["mean"], 2.0 * np.sqrt(number[:, None] / declared.seen.pixels))
    assert np.all(found["spatial"][number == 1] == 0.0)
    assert np.all(found["spatial"][number > 1] > 0.0)
    assert set(found) == {"mean", "slope_x", "slope_y", "spatial"}
    with pytest.raises(UnfitError, match="impossible"):
        included(declared, _Impossible(0.5))


@dataclass(frozen=True)
class _Impossible(Scaling):
    """Scales light by what is no number."""

    name = "impossible"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    trials = ({"size": 0.5},)
    fitted = ("size",)
    size: float = parameter(0.0, "1", -1.0, 1.0, source="a test")

    def factor(self, context):
        """Return the root of a negative number."""
        with np.errstate(invalid="ignore"):
            return np.sqrt(-abs(self.size) * np.ones_like(context.settings.exposure_s))


@pytest.mark.parametrize("electrons", [0.2, 50.0])
def test_noise_of_photons_has_the_excess_kurtosis_of_their_number(declared, electrons):
    """One over it, up to 1: a pixel that counts 50 e- at half a DN each has 0.02 beyond that of rounding."""
    ones, found = np.ones_like(declared.prediction.variance), declared.prediction
    photons = replace(
        found, signal=electrons * ones, gain=np.full_like(found.gain, 0.5), variance=0.25 * electrons * ones
    )
    scatter = Scatter(declared.design, declared.comparison.seen, photons, ones > 0.0)
    assert scatter.kurtosis - photons.kurtosis == pytest.approx(min(1.0 / electrons, 1.0) * ones, rel=1e-6)

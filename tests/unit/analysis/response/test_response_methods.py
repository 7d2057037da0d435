"""Methods that recover a response: by their definitions, against one another and against certified values."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.analysis.response.auto import solve_colours_auto
from radiometer.analysis.response.basis import ValueBasis, hat_weight
from radiometer.analysis.response.curves import black_of_curve, finished_curve, rising, u_with_extrapolation
from radiometer.analysis.response.debevec1997 import curve_debevec1997, recover_response_debevec1997
from radiometer.analysis.response.dynamic_range import RangePoint, dynamic_range, with_dynamic_range
from radiometer.analysis.response.estimate import inner_range, median_uncertainty, spread_rms
from radiometer.analysis.response.fit import eliminate_groups, fit_response, information, solve_penalised
from radiometer.analysis.response.limits import ValueLimits
from radiometer.analysis.response.linear_spline import recover_response_linear_spline
from radiometer.analysis.response.methods import METHODS
from radiometer.analysis.response.mitsunaga1999 import recover_response_mitsunaga1999
from radiometer.analysis.response.noise import LogNoise, dn_at, fit_log_noise, mean_exposure_dn
from radiometer.analysis.response.planes import (
    JointFit,
    LeftOut,
    Plane,
    determines_labels,
    fit_planes,
    settle_planes,
    without_shares,
)
from radiometer.analysis.response.samples import ResponseSamples, gather_samples
from radiometer.analysis.response.settle import Choices, error_of_quadrants, fit_with, given_labels, settle
from radiometer.analysis.response.wrong_labels import find_wrong_labels
from radiometer.cli.main import run
from radiometer.data import Bracket, Calibration, Frame, FrameSettings, ResponseCurve
from radiometer.data.provenance import Provenance
from radiometer.errors import InputError, MeasurementError
from testing.golden.nist_linear import LONGLEY, NORRIS
from testing.relatively import relatively


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("response", ["linear", "gamma"])
def test_method_gives_the_response_back(make_stack, inner_error, method, response):
    """ln H over 5–95 % scatters by less than 0.5 %, and every step between two frames has its uncertainty."""
    bracket = make_stack(response, bit_depth=8)
    found = METHODS[method]([bracket])
    assert found.exposure_ratios.shape == found.u_exposure_ratios.shape == (len(bracket.light) - 1,)
    assert np.all(found.u_exposure_ratios >= 0.0)
    curve = found.curve
    assert np.std(inner_error(curve, response)) < 0.005
    assert curve.log_exposure[128] == 0.0
    assert curve.provenance.method == method


@pytest.mark.parametrize("method", METHODS)
def test_residuals_are_those_of_the_frames_and_one_exposure_is_none(method, make_stack):
    """0.75 % in ln H, √2 times that of two frames; white frames are refused."""
    rng = np.random.default_rng(11)
    light = 200.0 * np.geomspace(0.08, 1.0, 96)[None, :]
    frames = []
    for time_s in (0.25, 0.5, 1.0):
        dn = 4.0 + light * time_s * np.exp(0.03 * rng.standard_normal((64, 96)))
        frames.append(Frame(np.rint(dn).astype(np.uint8), 8, FrameSettings(time_s, black_level_dn=4.0)))
    found = METHODS[method]([Bracket.from_frames(frames)])
    assert 0.004 < found.residual_rms_log < 0.02  # rounding of dim numbers adds some
    frame = make_stack("linear").light[4]
    with pytest.raises(InputError, match="one exposure only"):
        METHODS[method]([Bracket.from_frames([frame, frame])])
    white = np.full((32, 32), 255, np.uint8)
    frames = [Frame(white, 8, FrameSettings(t)) for t in (0.1, 0.2, 0.4)]
    with pytest.raises(MeasurementError):
        METHODS[method]([Bracket.from_frames(frames)])


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "bit_depth"), [("gamma", 8), ("kinked", 12)])
def test_mitsunaga_recovers_ratios_from_one(make_stack, kind, bit_depth):
    """Stated times wrong by up to 15 %: within 0.5 % and 4 of the stated sigmas, where no polynomial fits too."""
    true = np.array([2.0, 1.8, 2.1, 2.0, 2.3, 2.0, 1.9, 2.0])
    factors = {i + 1: float(f) for i, f in enumerate(np.cumprod(true / 2.0))}
    bracket = make_stack(kind, bit_depth=bit_depth, time_errors=tuple(factors.items()))
    estimate = recover_response_mitsunaga1999(bracket, known_ratios={3: 2.0})
    assert estimate.exposure_ratios == pytest.approx(true, rel=0.005)
    unknown = np.arange(8) != 3
    assert "known ratio of pair 3" in estimate.gauge
    error = (estimate.exposure_ratios - true)[unknown]
    assert np.all(np.abs(error) < 4.0 * estimate.u_exposure_ratios[unknown])


def test_a_polynomial_spans_the_exposures_of_a_long_toe(make_stack, true_log_exposure, monkeypatch):
    """A flat one makes all frames agree: it is refused, and u holds the error."""
    estimate = recover_response_mitsunaga1999(make_stack("toe", bit_depth=8))
    inner = slice(13, 243)
    error = estimate.curve.log_exposure[inner] - true_log_exposure("toe", 8)[inner]
    error -= error.mean()
    assert np.ptp(estimate.curve.log_exposure[inner]) > 1.5
    assert np.std(error) < 0.02
    assert np.std(error) < 2.0 * np.median(estimate.curve.u_log_exposure[inner])
    assert estimate.stability.rms_log < 0.01
    from radiometer.analysis.response.mitsunaga1999 import Polynomial

    monkeypatch.setattr(Polynomial, "log_curve", lambda self: np.zeros(256))
    with pytest.raises(MeasurementError, match="mitsunaga1999 finds no response"):
        recover_response_mitsunaga1999(make_stack("gamma", bit_depth=8))


@pytest.mark.parametrize("method", ["auto", "debevec1997"])
def test_a_camera_that_is_full_below_the_middle_number_gives_its_response(make_stack, method):
    """No frame shows M_mid of a sensor that stops at 1500 of 4095 DN; its numbers are proportional to light to 3 %."""
    frames = [Frame(np.minimum(f.dn, 1500), 12, f.settings) for f in make_stack("linear", shape=(96, 128)).light]
    curve = METHODS[method]([Bracket.from_frames(frames)]).curve
    assert curve.valid_dn[1] > 1200
    dn = np.arange(100, 1200)
    assert np.ptp(curve.log_exposure[dn] - np.log(dn)) < 0.06
    assert np.median(curve.u_log_exposure[dn]) < 0.1


def test_linear_spline_finds_black_and_owns_up_to_kinks(make_stack, inner_error):
    """50 DN to 2 DN; a note and a u that holds the error, none on a line."""
    frames = [
        Frame(np.minimum(f.dn.astype(np.uint32) + 50, 4095).astype(np.uint16), 12, f.settings)
        for f in make_stack("linear").light
    ]
    estimate = recover_response_linear_spline(Bracket.from_frames(frames))
    assert estimate.details["black_dn"] == pytest.approx(50, abs=2)
    assert estimate.details["largest_deviation_from_linear"] < 0.02
    assert METHODS["linear_spline"]([make_stack("linear", bit_depth=8)]).notes == ()
    estimate = METHODS["linear_spline"]([make_stack("kinked", bit_depth=8)])
    assert "not nearly linear" in estimate.notes[0]
    error = inner_error(estimate.curve, "kinked")
    u = estimate.curve.u_log_exposure[13 : 13 + error.size]
    away = np.arange(13, 13 + error.size) != 128
    # The finer curve that stands for the truth is itself off by a part of that error: twice it at most.
    assert 0.2 < np.mean((error[away] / u[away]) ** 2) < 2.0


@pytest.mark.parametrize(
    ("response", "bits"),
    [("gamma", 12), ("linear", 12), ("sigmoid", 12), ("gamma", 8), ("gamma", 10),
     pytest.param("gamma", 16, marks=pytest.mark.slow)],
)  # fmt: skip
def test_a_stack_gives_its_response_back(make_stack, inner_error, response, bits):
    """The rms error of ln H over 5–95 % stays under 0.003, shot noise of 10 500 e⁻ and rounding of 8 bits included."""
    shape = {"shape": (384, 512)} if bits == 12 else {}
    estimate = recover_response_debevec1997(make_stack(response, bit_depth=bits, **shape))
    assert estimate.curve.log_exposure.size == 2**bits
    assert np.sqrt(np.mean(inner_error(estimate.curve, response) ** 2)) < 0.003


def test_stated_uncertainty_covers_the_error(make_stack, inner_error):
    """Over five seeds the errors have, in units of u, a mean square between a quarter and twice the ideal of 1."""
    squares = []
    for seed in range(5):
        curve = recover_response_debevec1997(make_stack("gamma", seed=seed)).curve
        low = int(np.ceil(0.05 * 4095))
        error = inner_error(curve, "gamma")
        squares.append(np.mean((error / (curve.u_log_exposure[low : low + error.size] + 1e-9)) ** 2))
    assert 0.25 < np.mean(squares) < 2.0


def test_values_beyond_the_data_are_uncertain_and_depths_not_mixed(make_stack):
    """Out of valid_dn, u as large as the step; one curve belongs to one format."""
    bright = make_stack("gamma", frames=9)
    dim = Bracket.from_frames([Frame(np.minimum(f.dn, 3000), 12, f.settings) for f in bright.light])
    curve = recover_response_debevec1997(dim).curve
    assert curve.valid_dn[1] <= 3000
    assert curve.u_log_exposure[4000] >= curve.log_exposure[4000] - curve.log_exposure[3000] - 1e-9
    with pytest.raises(InputError, match="bit depth"):
        recover_response_debevec1997([make_stack("gamma", bit_depth=8), make_stack("gamma", bit_depth=12)])


# The dynamic-range procedure: absolute values from regions brought to one reference value.


REFERENCE_DN, REFERENCE_S = 127.0, 1 / 125


def exposure_of(dn):
    """Return H over that of white of the simulated camera, M = 255·H^(1/2.2)."""
    return float((dn / 255.0) ** 2.2)


def point(dn):
    """Return the region at `dn` with the time that puts it on the reference value."""
    return RangePoint(dn, REFERENCE_S * exposure_of(REFERENCE_DN) / exposure_of(dn))


@pytest.fixture(scope="module")
def stretched(make_stack):
    """Return a Mitsunaga–Nayar curve from frames two-fold apart whose times were stated as 2.3-fold apart."""
    frames = [
        replace(frame, settings=replace(frame.settings, exposure_s=1e-3 * 2.3**index))
        for index, frame in enumerate(make_stack("gamma", bit_depth=8).light)
    ]
    return recover_response_mitsunaga1999(Bracket.from_frames(frames)).curve


@pytest.mark.slow
def test_errors_lie_within_the_stated_uncertainty(stretched):
    """Over readings rounded to whole numbers the mean squared error of γ in units of u lies between 0.3 and 1.7."""
    rng = np.random.default_rng(4)
    # Only what the reading brings is drawn anew, so the curve is the true one, twice too steep.
    dn = np.arange(256.0)
    truth = ResponseCurve(4.4 * np.log(np.maximum(dn, 0.5) / 128), np.full(256, 1e-6), valid_dn=(1, 254))
    squares = []
    for _ in range(200):
        real = [rng.uniform(3.5, 9.5), rng.uniform(230.0, 250.0)]
        read = [replace(point(value), dn=float(np.round(value))) for value in real]
        # The time is set so that the region lands somewhere near the reference value, and where is read as well.
        landed = rng.uniform(120.0, 134.0, 2)
        read = [
            replace(one, exposure_s=REFERENCE_S * exposure_of(at) / exposure_of(value), landed_dn=float(np.round(at)))
            for one, at, value in zip(read, landed, real, strict=True)
        ]
        found = dynamic_range(truth, read, REFERENCE_S, REFERENCE_DN)
        squares.append(((found.exponent - 0.5) / found.u_exponent) ** 2)
    assert 0.3 < np.mean(squares) < 1.7


def test_the_range_runs_to_the_measured_exposures_wherever_a_region_landed(stretched):
    """At M = 1 ln H is the measured one; 140 instead of 127 is the same exponent."""
    found = dynamic_range(stretched, [point(1), point(254)], REFERENCE_S, REFERENCE_DN)
    curve = with_dynamic_range(stretched, found)
    at_one = curve.log_exposure[1] - curve.log_exposure[127]
    assert at_one == pytest.approx(math.log(exposure_of(1) / exposure_of(127)), abs=0.02)
    assert np.all(np.diff(curve.log_exposure) >= 0)
    assert curve.u_log_exposure[1] < 0.5 * stretched.u_log_exposure[1]
    assert curve.valid_dn == stretched.valid_dn
    assert any("dynamic range of 2 regions" in text for text in curve.provenance.assumptions)
    exact = dynamic_range(stretched, [point(250)], REFERENCE_S, REFERENCE_DN)
    time = REFERENCE_S * exposure_of(140) / exposure_of(250)
    neighbour = dynamic_range(stretched, [RangePoint(250, time, 140.0)], REFERENCE_S, REFERENCE_DN)
    assert neighbour.exponent == pytest.approx(exact.exponent, abs=2 * exact.u_exponent)
    assert neighbour.log_steps[0] == pytest.approx(exact.log_steps[0], abs=2 * exact.u_log_steps[0] + 0.01)
    assert exact.reduced_chi2 is None


@pytest.mark.parametrize(
    ("points", "error", "message"),
    [([], InputError, "at least one region"), ([RangePoint(254, 1 / 30)], MeasurementError, "shorter time")],
)
def test_what_contradicts_the_procedure_is_refused(stretched, points, error, message):
    """The message says what does not fit and the way out."""
    with pytest.raises(error, match=message):
        dynamic_range(stretched, points, REFERENCE_S, REFERENCE_DN)


def test_calibrate_takes_regions_and_gives_absolute_exposures(stretched, tmp_path, capsys):
    """With K, the reference photograph and two regions, H at M = 30 … 254 is right in J/m² to within 2 u."""
    stretched.write(tmp_path / "curve.yaml")
    words = [f"{one.dn:g},{one.exposure_s!r}" for one in (point(1), point(254))]
    command = ["calibrate", "--response", str(tmp_path / "curve.yaml"), "--luminance-meter-k", "16.5"]
    command += ["--f-number", "16", "--exposure", repr(REFERENCE_S), "--iso", "136", "--reference-dn", "127"]
    command += ["--as-printed", "--json", "-o", str(tmp_path / "cal.yaml")]
    for word in words:
        command += ["--dynamic-range", word]
    assert run(command) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["dynamic_range"]["exponent"] == pytest.approx(math.log(2.0) / math.log(2.3), rel=0.01)
    calibration = Calibration.read(tmp_path / "cal.yaml")
    reference = report["metered"]["radiance"]["value"] * math.pi / 4 / 16**2 * REFERENCE_S
    for dn in (30, 60, 200, 254):
        found = math.log(calibration.scale.value) + calibration.response.log_exposure[dn]
        expected = math.log(reference * exposure_of(dn) / exposure_of(127))
        assert abs(found - expected) < 2 * math.hypot(calibration.response.u_log_exposure[dn], 0.005)


# Frames that are off in their own way, and colours of one set of photographs that share their exposures.


SIGMA = 0.01
TIMES = tuple(0.25 * 1.7**k for k in range(6))


def rows_of(groups=40, frames=6):
    """Return rows of a linear camera without noise, frames half a doubling apart."""
    log_time = 0.7 * np.arange(frames)
    dn = np.exp(np.linspace(0.5, 5.0, groups)[:, None] + log_time[None, :] - 1.0)
    clear = (dn > 6) & (dn < 245)
    clear &= (clear.sum(axis=1) >= 2)[:, None]
    group, frame = np.nonzero(clear)
    group, count = np.unique(group, return_inverse=True)[1], group.size
    return ResponseSamples(
        dn=dn[clear],
        log_time=log_time[frame],
        group=group.astype(np.intp),
        frame=frame,
        pixels=np.full(count, 100.0),
        variance=np.full(count, 1.0 / 12.0),
        bit_depth=8,
        limits=ValueLimits(0, 255),
        frame_log_time=log_time,
        pixel_count=100 * groups,
    )


def fit(samples, **how):
    variance = np.full(samples.dn.size, SIGMA**2)
    return fit_response(samples, samples.dn, variance, time_spread=0.0, smoothing=1e3, **how)  # type: ignore[arg-type]


def test_variances_are_quadratic_forms_and_bear_rounding():
    """Of the basis values; an eigenvalue a little below zero changes no uncertainty."""
    basis = ValueBasis(10, ValueLimits(20, 1000))
    root = np.random.default_rng(3).normal(size=(basis.size, basis.size))
    every = basis.all_values().toarray()
    expected = np.einsum("ni,ij,nj->n", every, root @ root.T, every)
    assert basis.variances(root @ root.T) == pytest.approx(expected, rel=1e-12)
    samples = rows_of()
    off = fit(replace(samples, log_time=samples.log_time + SIGMA * (samples.frame == 2)))
    values, vectors = np.linalg.eigh(off.inverse)
    rounded = off.inverse - 1.001 * values[0] * np.outer(vectors[:, 0], vectors[:, 0])
    assert np.linalg.eigvalsh(rounded)[0] < 0.0
    expected, found = (one.frame_covariance(samples.frame) for one in (off, replace(off, inverse=rounded)))
    assert np.diag(found) == relatively(np.diag(expected), rel=0.02)


def test_uncertainty_of_frames_is_the_scatter_that_their_errors_make():
    """Independent frames each off by 1 %: the mean variance stated is that of the curve, unlike that of the groups.

    Both are squares of the errors, so that their means are the sums over one frame off at a time.
    """
    samples = rows_of()
    every = ValueBasis(8, samples.limits).all_values().toarray()
    at = every[[20, 60, 200]] - every[128]
    right = at @ fit(samples).coefficients
    true, by_frames, by_groups = np.zeros(3), np.zeros(3), np.zeros(3)
    for frame in range(samples.frame_log_time.size):
        one = fit(replace(samples, log_time=samples.log_time + SIGMA * (samples.frame == frame)))
        true += (at @ one.coefficients - right) ** 2
        by_frames += np.diag(at @ one.frame_covariance(samples.frame) @ at.T)
        by_groups += np.diag(at @ one.covariance() @ at.T)
    assert by_frames / true == pytest.approx(np.ones(3), abs=0.12)
    assert np.max(np.abs(np.log(by_groups / true))) > 1.0


def test_labels_are_weighed_by_what_is_known_of_them():
    """What is known exactly stays, as well as the data know it half way; of nothing nothing is determined."""
    samples = rows_of()
    log_time = samples.frame_log_time - 0.2 * (np.arange(6) == 3)
    wrong = replace(samples, frame_log_time=log_time, log_time=log_time[samples.frame])
    alone = fit(wrong, free=(3,))
    assert alone.time_modes[0] == pytest.approx(0.2, abs=1e-3)
    assert alone.log_time_errors == pytest.approx([0.0, 0.0, 0.0, 0.2, 0.0, 0.0], abs=1e-3)
    assert fit(wrong, free=(3,), known=((0.1, 1e-6),)).time_modes[0] == pytest.approx(0.1, abs=1e-4)
    u = float(np.sqrt(alone.inverse[-1, -1]))
    assert fit(wrong, free=(3,), known=((0.1, u),)).time_modes[0] == pytest.approx(0.15, abs=2e-3)
    with pytest.raises(MeasurementError, match="do not determine a response"):
        fit(samples.kept(samples.frame != 5), free=(5,), known=((0.0, float("inf")),))


@pytest.mark.parametrize(
    ("covariance", "inverse"),
    [
        ([[2e-4, 1e-4], [1e-4, 2e-4]], [[2e4 / 3, -1e4 / 3], [-1e4 / 3, 2e4 / 3]]),
        ([[4.0, 1.0 + 1e-13], [1.0 - 1e-13, 0.5]], [[0.5, -1.0], [-1.0, 4.0]]),
        ([[0.0, 0.0], [0.0, 4.0]], [[1e12, 0.0], [0.0, 0.25]]),
        ([[-1e-16, 0.0], [0.0, 4.0]], [[1e12, 0.0], [0.0, 0.25]]),
        ([[1e30, 0.0], [0.0, 4.0]], [[0.0, 0.0], [0.0, 0.25]]),
        ([[9.0, 9.0], [9.0, 9.0]], [[0.5e12, -0.5e12], [-0.5e12, 0.5e12]]),
    ],
    ids=["both known", "nearly symmetric", "one exactly", "below zero by rounding", "one not at all", "the difference"],
)
def test_information_is_the_inverse_also_where_a_label_is_known_exactly_or_not_at_all(covariance, inverse):
    """What is known exactly counts as known to a millionth, what is not known counts nothing."""
    assert information(np.array(covariance)) == pytest.approx(np.array(inverse), rel=1e-9, abs=1e-15)


def last_label_off(*, lowest=0, more=0):
    """Return a linear plane whose last exposure was 0.2 in ln longer than its label.

    Args:
        lowest: The first frame of which all groups are seen, 4 at most.
        more: How many groups of the frame before are also seen, of those that frame 4 shows.
    """
    samples = rows_of()
    log_time = samples.frame_log_time - 0.2 * (np.arange(6) == 5)
    before = (samples.frame == lowest - 1) & np.isin(samples.group, samples.group[samples.frame == 4])
    seen = (samples.frame >= lowest) | (before & (np.cumsum(before) <= more))
    dim = replace(samples, frame_log_time=log_time, log_time=log_time[samples.frame]).kept(seen)
    return Plane(dim, np.log(np.maximum(np.arange(256.0), 0.5)))


@pytest.mark.parametrize(
    ("lowest", "more", "freed", "informative"),
    [
        (0, 0, (5,), True),
        (0, 0, (0, 5), True),
        (3, 0, (5,), True),
        (4, 4, (5,), True),
        (4, 3, (5,), False),
        (4, 0, (5,), False),
        (3, 0, (4, 5), False),
        (3, 0, (0,), False),
    ],
)
def test_two_trusted_frames_hold_the_exponent(lowest, more, freed, informative):
    """Four groups of pixels that two trusted frames show, and four of the freed one: fewer may be strays."""
    plane = last_label_off(lowest=lowest, more=more)
    assert determines_labels(fit_with(plane.samples, plane.start, Choices(smoothing=1e3, free=freed))) is informative


def test_other_planes_tell_a_label_that_one_cannot_tell():
    """By itself it takes a flat curve, sure of it; what none can tell is what they say."""
    bright, dark = last_label_off(), last_label_off(lowest=4)
    deluded = fit_with(dark.samples, dark.start, Choices(free=(5,)))
    assert deluded.fit.time_modes[0] == pytest.approx(-0.5, abs=0.001)
    assert np.sqrt(deluded.label_covariance[0, 0]) < 0.05
    assert np.ptp(deluded.log_exposure[20:200]) < 0.01
    joint, alone = (fit_planes(planes, Choices(free=(5,))) for planes in ([bright, dark], [bright]))
    assert joint.log_ratios == pytest.approx(alone.log_ratios)
    assert joint.u_log_ratios == pytest.approx(alone.u_log_ratios)
    assert joint.log_ratios[0] == pytest.approx(0.2, abs=3.0 * joint.u_log_ratios[0])
    assert joint.fits[1].fit.time_modes == pytest.approx(joint.log_ratios)
    bright, blind = last_label_off(), last_label_off()
    blind = replace(blind, samples=blind.samples.kept(blind.samples.frame != 5))
    joint, alone = (fit_planes(planes, Choices(free=(5,))) for planes in ([bright, blind], [bright]))
    assert joint.log_ratios == pytest.approx(alone.log_ratios)
    assert joint.u_log_ratios == pytest.approx(alone.u_log_ratios)
    (alone,) = fit_planes([last_label_off(lowest=4)], Choices(free=(5,))).log_ratios
    assert fit_planes([last_label_off(lowest=4)] * 2, Choices(free=(5,))).log_ratios == pytest.approx([alone])


def scene():
    tones = np.random.default_rng(11).permutation(np.linspace(-5.0, 1.5, 140)).reshape(10, 14)
    return np.asarray(np.kron(tones, np.ones((12, 12))))


def colour(gamma, tint, wrong, seed, times=TIMES, contrast=1.0):
    """Return photographs of the scene through a tone curve, the label of one frame too long by a third of a stop."""
    rng, frames = np.random.default_rng(seed), []
    for number, seconds in enumerate(times):
        share = 1.0 - np.exp(-np.exp(contrast * scene() + tint) * seconds)
        values = 255.0 * share**gamma + 0.7 * rng.standard_normal(share.shape)
        label = seconds * (2.0 ** (1 / 3) if number == wrong else 1.0)
        frames.append(Frame(np.clip(np.round(values), 0, 255).astype(np.uint8), 8, FrameSettings(label)))
    return Bracket.from_frames(frames)


def planes_of(wrong, colours=2):
    samples = [gather_samples(colour(0.45 + 0.1 * k, -0.7 * k, wrong, k)) for k in range(colours)]
    return [Plane(one, curve_debevec1997(one).log_exposure) for one in samples]


@pytest.fixture(scope="module")
def lying():
    return planes_of(3)


@pytest.mark.slow
def test_colours_tell_one_label_or_none(lying):
    """One frame, its ratio the mean of both by u; right labels and a dark colour say nothing."""
    (label,) = find_wrong_labels(lying)
    assert label.frame == 3
    assert label.ratio == pytest.approx(2.0 ** (-1 / 3), abs=3.0 * label.u_ratio + 0.002)
    joint = settle_planes(lying, (3,))
    alone = [settle_planes([plane], (3,)) for plane in lying]
    u = np.array([one.u_log_ratios[0] for one in alone])
    weighted = np.average([one.log_ratios[0] for one in alone], weights=u**-2.0)
    assert joint.log_ratios[0] == pytest.approx(weighted, abs=1e-9)
    least = float(np.sum(u**-2.0) ** -0.5)
    off = np.array([one.log_ratios[0] for one in alone]) - weighted
    assert joint.u_log_ratios[0] == pytest.approx(least * max(1.0, float(np.sqrt(np.sum((off / u) ** 2)))), rel=1e-6)
    assert [one.fit.time_modes[0] for one in joint.fits] == pytest.approx([weighted] * 2, abs=1e-9)
    assert find_wrong_labels(planes_of(None)) == ()
    blind = replace(lying[0], samples=replace(lying[0].samples, without_share=(), shares=()))
    assert find_wrong_labels([blind]) == ()
    assert [one.frame for one in find_wrong_labels([blind, lying[1]])] == [3]


def test_a_curve_at_given_labels_is_the_fit_with_these_labels_held(lying):
    """Moving a freed label within the fit gives the curve of a fit that holds it there."""
    samples = lying[0].samples
    first = fit_with(samples, lying[0].start, Choices(smoothing=1e3, free=(3,), inflation=10.0))
    free = fit_with(samples, first.log_exposure, first.choices)
    held = fit_with(samples, first.log_exposure, replace(first.choices, known=((-0.1, 1e-7),)))
    moved = given_labels(free, np.array([-0.1]))
    assert moved.relative == pytest.approx(held.relative, abs=1e-4)
    assert moved.fit.time_modes[0] == pytest.approx(-0.1)


@pytest.mark.slow
def test_shares_are_judged_as_quadrants_and_give_one_label(lying):
    """Of two planes alike errors and rows are twice those of one; estimates hold the label."""
    plane = lying[0]
    fitted = settle(plane.samples, plane.start)
    left_out = LeftOut.of([plane], without_shares([plane], JointFit.of([fitted])))
    as_quadrants = replace(plane.samples, without_quadrant=plane.samples.without_share, quadrants=plane.samples.shares)
    expected = error_of_quadrants(as_quadrants, fitted)
    assert left_out.error_dn.sum(axis=1) / left_out.rows.sum(axis=1) == pytest.approx(expected)
    of_frame = error_of_quadrants(as_quadrants, fitted, 3)
    assert left_out.error_dn[:, 3] / left_out.rows[:, 3] == pytest.approx(of_frame)
    assert left_out.mean_dn(3) == pytest.approx(np.average(of_frame, weights=left_out.rows[:, 3]))
    both = LeftOut.of([plane, plane], without_shares([plane, plane], JointFit.of([fitted, fitted])))
    assert both.rows == pytest.approx(2.0 * left_out.rows)
    assert both.error_dn == pytest.approx(2.0 * left_out.error_dn)
    estimates = solve_colours_auto([plane.samples for plane in lying])
    (together,) = find_wrong_labels(lying)
    for estimate in estimates:
        (label,) = estimate.details["wrong_labels"]
        # The first curves differ, so the ratios agree within their uncertainty only.
        assert (label["frame"], label["ratio"]) == (together.frame, pytest.approx(together.ratio, abs=together.u_ratio))
        found = np.exp(estimate.details["log_time_errors"][3])
        assert found == pytest.approx(together.ratio, abs=together.u_ratio)


def test_errors_are_counted_by_rows_and_without_each_share_that_shows_the_frame():
    """Two frames in three shares, of which one does not show the second."""
    left_out = LeftOut(np.array([[4.0, 6.0], [2.0, 0.0], [3.0, 1.0]]), np.array([[2.0, 3.0], [1.0, 0.0], [3.0, 1.0]]))
    assert left_out.mean_dn() == pytest.approx(16.0 / 10.0)
    assert left_out.mean_dn(0) == pytest.approx(9.0 / 6.0)
    assert left_out.mean_dn(1, 0) == pytest.approx(16.0 / 10.0)
    assert left_out.means_without_one_dn(0) == pytest.approx([5.0 / 4.0, 7.0 / 5.0, 6.0 / 3.0])
    assert left_out.means_without_one_dn(1) == pytest.approx([1.0, 2.0])


@pytest.mark.parametrize("gamma", [0.55, 0.7])
def test_two_frames_six_stops_apart_tell_the_curve_between_them(gamma):
    """Hardly a value in both: a curve through every mean would have no error; the smoothest that predicts is right."""
    (estimate,) = solve_colours_auto([gather_samples(colour(gamma, -0.5, None, 1, (0.03, 1.92), 0.8))])
    dn = np.arange(20, 200)
    gap = estimate.curve.log_exposure[dn] - np.log(-np.log1p(-((dn / 255.0) ** (1.0 / gamma))))
    assert np.std(gap) < 0.03


# Fits behind the curves against direct solutions, definitions and certified values from outside.


seeds = st.integers(0, 10**6)

noises = st.tuples(st.floats(1e-6, 1e-2), st.floats(1e-8, 1e-4), st.floats(0.0, 2.0), st.floats(0.0, 0.5))

quick = settings(max_examples=30, deadline=None)

LIMITS = ValueLimits(0, 255)


@pytest.mark.parametrize("problem", [NORRIS, LONGLEY], ids=["norris", "longley"])
def test_certified_regressions_come_out(problem):
    """One group is an intercept: slopes and residual variance are NIST's, to the digits that doubles allow."""
    x = np.array(problem.x)
    # A column of noughts for the gauge to pin; it is not of the problem.
    design = np.column_stack([x, np.zeros(len(x))])
    target, one = np.array(problem.y), np.ones(len(x))
    normal = eliminate_groups(sp.csr_array(design), target, one, np.zeros(len(x), np.intp))
    pinned = np.zeros(design.shape[1])
    pinned[-1] = 1.0
    found = solve_penalised(normal, np.eye(pinned.size), pinned, 0.0)
    assert found.coefficients[:-1] == pytest.approx(problem.slopes, rel=problem.digits)
    freedom = len(x) - len(problem.slopes) - 1
    residual = normal.residuals(found.coefficients)
    assert math.sqrt(residual @ residual / freedom) == pytest.approx(problem.residual_sd, rel=problem.digits)
    assert normal.freedom == len(x) - 1
    variance = np.diag(found.inverse)[:-1] * (residual @ residual) / freedom
    assert np.sqrt(variance) == pytest.approx(problem.slope_sds, rel=1e-4)


def problem_of(seed, groups=6, rows=5, size=4):
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(groups), rows)
    design = rng.normal(size=(group.size, size))
    weight = rng.uniform(0.1, 5.0, group.size)
    return design, rng.normal(size=group.size), weight, group, rng


@quick
@given(seeds)
def test_eliminating_a_group_is_solving_for_it(seed):
    """Curve, residuals and the sum of squares are those of the whole system with a column for each group."""
    design, target, weight, group, rng = problem_of(seed)
    normal = eliminate_groups(sp.csr_array(design), target, weight, group)
    whole = np.hstack([design, -np.eye(group.max() + 1)[group]])
    root = np.sqrt(weight)[:, None]
    direct = np.linalg.lstsq(root * whole, root[:, 0] * target, rcond=None)[0]
    assert np.linalg.solve(normal.matrix, normal.right) == pytest.approx(direct[:4], rel=1e-8, abs=1e-8)
    assert normal.residuals(direct[:4]) == pytest.approx(target - whole @ direct, rel=1e-7, abs=1e-8)
    alone = np.linalg.lstsq(root * whole[:, 4:], root[:, 0] * target, rcond=None)[0]
    left = target - whole[:, 4:] @ alone
    assert normal.square == pytest.approx(weight @ left**2)
    assert normal.freedom == target.size - 6
    # The robust covariance of q: outer products of each group's score, by a loop.
    solution = rng.normal(size=4)
    scores = [
        sum(normal.centred[i] * weight[i] * normal.residuals(solution)[i] for i in np.flatnonzero(group == g))
        for g in range(6)
    ]
    assert normal.covariance(solution, np.eye(solution.size)) == pytest.approx(
        sum(np.outer(s, s) for s in scores) * 6 / 5
    )


@quick
@given(seeds, st.floats(1e-3, 10.0))
def test_a_penalty_is_rows_more(seed, smoothing):
    """λP adds as many rows of the penalty's root; the gauge b·c = 0 holds; variance and parameters by their traces."""
    design, target, weight, group, rng = problem_of(seed)
    bent = np.diff(np.eye(4), 1, axis=0)  # leaves a constant free, which the gauge pins: make N blind to it as well
    design = design - design.mean(axis=1, keepdims=True)
    gauge = rng.uniform(0.5, 1.5, 4)
    normal = eliminate_groups(sp.csr_array(design), target, weight, group)
    found = solve_penalised(normal, bent.T @ bent, gauge, smoothing)
    scale = smoothing * np.trace(normal.matrix) / np.trace(bent.T @ bent)
    rows = np.vstack([np.sqrt(weight)[:, None] * normal.centred, math.sqrt(scale) * bent, 1e4 * gauge[None, :]])
    expected = np.concatenate([np.sqrt(weight) * normal.target, np.zeros(4)])
    assert found.coefficients == pytest.approx(np.linalg.lstsq(rows, expected, rcond=None)[0], rel=1e-5, abs=1e-6)
    assert gauge @ found.coefficients == pytest.approx(0.0, abs=1e-9)
    assert found.effective_parameters == pytest.approx(np.trace(found.inverse @ normal.matrix))
    assert 0.0 < found.effective_parameters < 3.0
    residual = normal.residuals(found.coefficients)
    assert found.residual_variance == pytest.approx(
        weight @ residual**2 / (normal.freedom - found.effective_parameters)
    )
    assert found.smoothing == smoothing


def test_the_chosen_smoothing_follows_the_noise():
    """Restricted likelihood smooths a rough line and lets a clean bend stand; what is undetermined is refused."""
    rng = np.random.default_rng(3)
    place = np.repeat(np.arange(30), 4)
    group = np.sort(rng.integers(0, 12, place.size))
    bent = np.diff(np.eye(30), 2, axis=0)
    gauge = np.eye(30)[15]

    def solved(sigma):
        truth = 0.02 * (np.arange(30) - 15.0) ** 2
        target = truth[place] + rng.normal(size=12)[group] + sigma * rng.normal(size=place.size)
        normal = eliminate_groups(sp.csr_array(np.eye(30)[place]), target, np.ones(place.size), group)
        return solve_penalised(normal, bent.T @ bent, gauge, order=2), truth

    (clean, truth), (rough, _) = solved(1e-3), solved(1.0)
    assert clean.smoothing < rough.smoothing
    assert clean.effective_parameters > rough.effective_parameters
    assert np.abs(clean.coefficients - truth).max() < 0.02
    assert math.sqrt(clean.residual_variance) == pytest.approx(1e-3, rel=0.5)
    assert math.sqrt(rough.residual_variance) == pytest.approx(1.0, rel=0.3)
    empty = eliminate_groups(sp.csr_array(np.zeros((4, 30))), np.zeros(4), np.ones(4), np.zeros(4, np.intp))
    with pytest.raises(MeasurementError):
        solve_penalised(empty, np.zeros((30, 30)), gauge, 0.0)


def test_a_curve_that_meets_every_mean_is_no_reason_for_no_smoothness():
    """As many differences as coefficients, rounding in them: λ stays where the curve is known to 1e-4, not at 0."""
    rng = np.random.default_rng(3)
    place = np.column_stack([np.arange(29), np.arange(1, 30)]).ravel()
    target = np.log1p(place) + 1e-5 * rng.standard_normal(place.size)
    normal = eliminate_groups(sp.csr_array(np.eye(30)[place]), target, np.ones(58), np.repeat(np.arange(29), 2))
    bent = np.diff(np.eye(30), 2, axis=0)
    assert solve_penalised(normal, bent.T @ bent, np.eye(30)[15], order=2).smoothing > 1e-8


@pytest.mark.parametrize("leverage", [0.0, 0.5, 0.8])
def test_noise_is_that_before_the_fit_took_up_its_part(leverage):
    """Residuals of a fit that took up a part h of the noise are √(1 − h) of it; what comes out is the noise itself."""
    rng = np.random.default_rng(11)
    g, pixels = rng.uniform(-4.0, 0.0, 6000), np.full(6000, 10.0)
    slope = np.full(6000, 1e-4)
    truth = 1e-2 * np.exp(-g) / pixels
    residual = np.sqrt((1.0 - leverage) * truth) * rng.standard_normal(6000)
    found = fit_log_noise(residual, np.full(6000, leverage), g, slope, pixels).variance(g, slope, pixels)
    assert np.median(found / truth) == pytest.approx(1.0, abs=0.06)


@quick
@given(st.integers(0, 100), st.integers(150, 255), st.floats(0.0, 255.0))
def test_the_hat_is_one_in_the_middle_and_nought_at_the_ends(low, high, dn):
    """Straight on both sides, symmetric, 0 outside."""
    limits = ValueLimits(low, high)
    middle, half = (low + high) / 2, (high - low) / 2
    found = float(hat_weight(np.array([dn]), limits)[0])
    assert found == pytest.approx(max(0.0, 1.0 - abs(dn - middle) / half), abs=1e-12)


@quick
@given(seeds, st.sampled_from([8, 10, 12]))
def test_the_basis_is_a_partition_of_one_that_bends_with_the_logarithm(seed, bits):
    """Splines add up to 1 at any number; third differences of a parabola over u are not penalised."""
    top = (1 << bits) - 1
    basis = ValueBasis(bits, ValueLimits(0, top))
    dn = np.random.default_rng(seed).uniform(0, top, 20)
    assert basis.design(dn).toarray().sum(axis=1) == pytest.approx(1.0)
    k = np.arange(basis.size)
    for smooth in (np.ones(k.size), 1.0 * k, k**2 / 100.0):
        assert smooth @ basis.roughness() @ smooth == pytest.approx(0.0, abs=1e-6)
    wave = (-1.0) ** k
    assert wave @ basis.roughness() @ wave == pytest.approx(64.0 * (k.size - 3))
    # A linear coefficient is the stretched coordinate itself: ln[(M + a)/(top − M + a)], odd about the middle.
    line = basis.design(np.array([0.25 * top, 0.5 * top, 0.75 * top])).toarray() @ k
    assert line[2] - line[1] == pytest.approx(line[1] - line[0])
    softening = max(1.0, top / 1024)
    whole = 2 * math.log((top + softening) / softening)
    stretched = math.log((0.75 * top + softening) / (0.25 * top + softening))
    assert (line[2] - line[1]) * whole / 112 == pytest.approx(stretched, rel=1e-6)


@quick
@given(noises, st.floats(-5.0, 0.5), st.integers(1, 1000))
def test_the_noise_of_a_group_mean_by_its_parts(noise, g, pixels):
    """a/H + b/H² + (c + 1/12)·g'² over n pixels, and what does not average: d and what rounding leaves."""
    shot, read, digital, common = noise
    slope = 0.01
    found = LogNoise(shot, read, digital, common).variance(np.array([g]), np.array([slope]), np.array([pixels]))[0]
    exposure = math.exp(g)
    before = shot / exposure + read / exposure**2 + digital * slope**2
    wave = min(math.exp(-4 * math.pi**2 * before / slope**2) / (2 * math.pi**2), 1 / 12)
    assert found == pytest.approx((before + slope**2 / 12) / pixels + slope**2 * (common + wave), rel=1e-9)


def test_noise_behind_a_straight_line_moves_no_mean():
    """g = ln M: the mean of M is the M of the mean; g = 2.2·ln M: it lies higher by σ²(γ − 1)/(2M)."""
    dn, variance = np.array([120.0]), np.array([25.0 + 1 / 12])
    grid = np.maximum(np.arange(256.0), 0.5)
    assert mean_exposure_dn(dn, variance, np.log(grid), LIMITS) == pytest.approx(dn, abs=0.003)
    shifted = mean_exposure_dn(dn, variance, 2.2 * np.log(grid), LIMITS)
    assert shifted - dn == pytest.approx(25.0 * 1.2 / (2 * 120.0), rel=0.02)
    assert mean_exposure_dn(dn, np.array([1 / 24]), 2.2 * np.log(grid), LIMITS) == pytest.approx(dn)


@quick
@given(seeds, st.integers(5, 60), st.integers(190, 250))
def test_a_finished_curve_never_falls_and_owns_up_to_its_ends(seed, low, high):
    """Gauge 0 in the middle, monotonic, u infinite outside the data and never below what was levelled."""
    rng = np.random.default_rng(seed)
    noise = 0.02 * rng.normal(size=256)
    noise[low : low + 9], noise[high - 30 : high + 1] = 0.0, 0.0  # an end that has to be levelled is left out
    g = np.log(np.arange(256) + 1.0) + noise
    u = np.full(256, 0.01)
    curve = finished_curve(g, u, (low, high), method="m", channel="mono")
    assert np.all(np.diff(curve.log_exposure) >= 0)
    assert curve.log_exposure[128] == 0.0
    assert curve.valid_dn == (low, high)
    inside = slice(low, high + 1)
    assert np.all(np.isinf(curve.u_log_exposure[:low]))
    assert np.all(np.isinf(curve.u_log_exposure[high + 1 :]))
    level = rising(g, u, (low, high))
    assert curve.u_log_exposure[inside] == pytest.approx(np.hypot(0.01, (level - g)[inside]))
    assert level[inside].mean() == pytest.approx(g[inside].mean())  # levelling with equal weights keeps the mean
    over_ln_dn = np.diff(level) / np.diff(np.log(np.maximum(np.arange(256.0), 0.5)))  # outside: powers of M
    assert over_ln_dn[:low] == pytest.approx(over_ln_dn[0], abs=1e-9)
    assert over_ln_dn[high:] == pytest.approx(over_ln_dn[-1], abs=1e-9)
    assert over_ln_dn[-1] <= (level[high] - level[high - 4]) / np.log(high / (high - 4)) + 1e-8  # the last of the data
    whole = u_with_extrapolation(curve)
    for dn, edge in ((0, low), (255, high)):
        step = curve.log_exposure[dn] - curve.log_exposure[edge]
        assert whole[dn] == pytest.approx(math.hypot(step, curve.u_log_exposure[edge]))
    assert np.array_equal(whole[inside], curve.u_log_exposure[inside])


def test_curves_fall_to_their_black_and_keep_it():
    """H ∝ (M − 13)^0.5 outside the data; black is what the curve was made with, 0 where none is stated."""
    signal = np.maximum(np.arange(256.0) - 13.0, 0.5)
    g = 0.5 * np.log(signal)
    damaged = np.where((np.arange(256) < 20) | (np.arange(256) > 240), 7.0, g)
    assert rising(damaged, np.full(256, 0.01), (20, 240), 13) == pytest.approx(g, abs=1e-9)
    g = 0.5 * np.log(np.maximum(np.arange(256.0) - 13.0, 0.5))
    assert dn_at(g, np.array([-50.0, g[13], g[100], 50.0])) == pytest.approx([13.0, 13.0, 100.0, 255.0])
    assert dn_at(np.arange(256.0), np.array([-5.0, 3.25])) == pytest.approx([0.0, 3.25])
    g, u = np.log(np.arange(256) + 1.0), np.full(256, 0.01)
    for fog in (14.0, 0.5, 0.0):
        assert black_of_curve(finished_curve(g, u, (20, 250), method="m", channel="mono", black_dn=fog)) == fog
    for text in ("14", None, [14.0]):
        assert black_of_curve(ResponseCurve(g, u, provenance=Provenance("m", parameters={"black_dn": text}))) == 0.0
    assert black_of_curve(ResponseCurve(g, u)) == 0.0


def test_ends_and_middle_are_supported_by_data():
    """Where the fit is level while it grows less certain nothing shows its light; a gauge beyond the data counts."""
    g = np.linspace(0.0, 2.55, 256)
    curve = finished_curve(g, np.full(256, 0.01), (10, 100), method="m", channel="mono")
    step = 0.04 * math.log(128 / 100) / math.log(100 / 96)  # the power of the last four numbers goes on
    assert curve.u_log_exposure[50] == pytest.approx(math.hypot(0.01, step), rel=1e-6)
    stray = np.full(256, 0.01)
    stray[240:] = 0.2
    assert finished_curve(g, stray, (10, 250), method="m", channel="mono").valid_dn == (10, 239)
    dn = np.arange(256.0)
    g = np.log(np.clip(dn, 20.0, 240.0))
    u = 0.001 + 0.0005 * np.maximum(dn - 235.0, 20.0 - dn).clip(0.0)
    curve = finished_curve(g, u, (5, 250), method="m", channel="mono")
    assert curve.valid_dn == (20, 240)
    assert np.all(np.isinf(curve.u_log_exposure[241:]))
    rising_there = finished_curve(np.log(dn + 1.0), u, (5, 250), method="m", channel="mono")
    assert rising_there.valid_dn == (5, 250)


def test_figures_of_the_diagnostics():
    """5 to 95 % of the range; the median u there; the parts' distance from their mean, scaled to one part."""
    assert inner_range((0, 100)) == slice(5, 96)
    assert inner_range((10, 210)) == slice(20, 201)
    u = np.full(256, 9.0)
    u[20:201] = np.linspace(0.1, 0.3, 181)
    curve = ResponseCurve(np.linspace(0, 1, 256), u, valid_dn=(10, 210))
    assert median_uncertainty(curve) == pytest.approx(0.2)
    shape = np.array([1.0, -1.0])
    assert spread_rms([shape, -shape, shape, -shape]) == pytest.approx(3.0)
    assert spread_rms([shape + 5, shape - 5]) == pytest.approx(0.0)


@pytest.fixture(scope="module")
def straight_fit(samples):
    """Return a fit of a straight line at one smoothing, its times taken as exact."""
    return fit_response(samples, samples.dn, np.full(samples.dn.size, 1e-4), time_spread=0.0, smoothing=1e-3)


def test_a_fit_follows_from_the_noise_s_proportions_alone(samples, straight_fit):
    """Four times the variance: the same curve, four times its covariance, a quarter of χ², the same share of rows."""
    rough = fit_response(samples, samples.dn, np.full(samples.dn.size, 4e-4), time_spread=0.0, smoothing=1e-3)
    assert rough.coefficients == pytest.approx(straight_fit.coefficients, rel=1e-6, abs=1e-9)
    assert rough.inverse == pytest.approx(4.0 * straight_fit.inverse, rel=1e-6, abs=1e-12)
    assert rough.reduced_chi2 == pytest.approx(straight_fit.reduced_chi2 / 4.0, rel=1e-6)
    assert rough.leverage() == pytest.approx(straight_fit.leverage(), rel=1e-6)
    assert rough.covariance() == pytest.approx(straight_fit.covariance(), rel=1e-4, abs=1e-12), (
        "the scatter decides, not its model"
    )


def test_rows_take_up_as_much_as_there_are_unknowns(straight_fit):
    """Leverages add up to groups and effective parameters; data and smoothness make the covariance."""
    parameters = float(np.trace(straight_fit.inverse @ straight_fit.normal.matrix))
    groups = int(straight_fit.normal.group.max()) + 1
    assert straight_fit.leverage().sum() == pytest.approx(groups + parameters, rel=1e-3)
    assert straight_fit.leverage().sum() < groups + parameters
    assert straight_fit.leverage().max() <= 0.95
    chi2 = straight_fit.normal.weight @ straight_fit.normal.residuals(straight_fit.solution) ** 2
    assert straight_fit.reduced_chi2 * (straight_fit.normal.target.size - groups - parameters) == pytest.approx(chi2)
    by_data = straight_fit.inverse @ straight_fit.normal.matrix @ straight_fit.inverse
    assert by_data + straight_fit.smoothness_covariance() == pytest.approx(straight_fit.inverse, rel=1e-9, abs=1e-15)
    for part in (by_data, straight_fit.smoothness_covariance(), straight_fit.covariance()):
        assert np.linalg.eigvalsh(0.5 * (part + part.T)).min() > -1e-9 * np.trace(straight_fit.inverse)

"""Methods that recover a response, by their definitions and against one another."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.response.debevec1997 import recover_response_debevec1997
from radiometer.analysis.response.linear_spline import recover_response_linear_spline
from radiometer.analysis.response.methods import DEFAULT_METHOD, METHODS, compare_methods, method_names
from radiometer.analysis.response.mitsunaga1999 import recover_response_mitsunaga1999
from radiometer.data import Bracket, Frame, FrameSettings
from radiometer.errors import InputError, MeasurementError, UsageError


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
def test_the_residual_is_that_of_the_frames(method):
    """Pixels scatter by 3 % and 16 are averaged: residuals in ln H are 0.75 %, of two frames √2 times that."""
    rng = np.random.default_rng(11)
    light = 200.0 * np.geomspace(0.08, 1.0, 96)[None, :]
    frames = []
    for time_s in (0.25, 0.5, 1.0):
        dn = 4.0 + light * time_s * np.exp(0.03 * rng.standard_normal((64, 96)))
        frames.append(Frame(np.rint(dn).astype(np.uint8), 8, FrameSettings(time_s, black_level_dn=4.0)))
    found = METHODS[method]([Bracket.from_frames(frames)])
    assert 0.004 < found.residual_rms_log < 0.02  # rounding of dim numbers adds some


@pytest.mark.parametrize("method", METHODS)
def test_method_refuses_one_exposure(make_stack, method):
    """No method makes a curve of one exposure."""
    frame = make_stack("linear").light[4]
    with pytest.raises(InputError, match="one exposure only"):
        METHODS[method]([Bracket.from_frames([frame, frame])])


@pytest.mark.parametrize("method", METHODS)
def test_method_refuses_saturated_frames(method):
    """No method makes a curve of white frames."""
    white = np.full((32, 32), 255, np.uint8)
    frames = [Frame(white, 8, FrameSettings(t)) for t in (0.1, 0.2, 0.4)]
    with pytest.raises(MeasurementError):
        METHODS[method]([Bracket.from_frames(frames)])


@pytest.mark.slow
@pytest.mark.parametrize("bit_depth", [8, 12])
def test_mitsunaga_recovers_ratios_from_one(make_stack, bit_depth):
    """With one of eight ratios known the others come out within 0.5 %, times unknown."""
    true = np.array([2.0, 2.0, 2.1, 2.0, 1.9, 2.0, 2.0, 2.0])
    factors = {i + 1: float(f) for i, f in enumerate(np.cumprod(true / 2.0))}
    bracket = make_stack("gamma", bit_depth=bit_depth, time_errors=factors)
    estimate = recover_response_mitsunaga1999(bracket, known_ratios={0: 2.0})
    assert estimate.exposure_ratios == pytest.approx(true, rel=0.005)
    assert "known ratio of pair 0" in estimate.gauge


@pytest.mark.slow
@pytest.mark.parametrize("bit_depth", [8, 12])
def test_mitsunaga_recovers_ratios_where_no_polynomial_of_the_values_fits(make_stack, bit_depth):
    """Kinks and near-plateaus, stated times wrong by up to 15 %: within 0.5 %, and within 4 of the stated sigmas."""
    true = np.array([2.0, 1.8, 2.1, 2.0, 2.3, 2.0, 1.9, 2.0])
    factors = {i + 1: float(f) for i, f in enumerate(np.cumprod(true / 2.0))}
    bracket = make_stack("kinked", bit_depth=bit_depth, time_errors=factors)
    estimate = recover_response_mitsunaga1999(bracket, known_ratios={3: 2.0})
    assert estimate.exposure_ratios == pytest.approx(true, rel=0.005)
    unknown = np.arange(8) != 3
    error = (estimate.exposure_ratios - true)[unknown]
    assert np.all(np.abs(error) < 4.0 * estimate.u_exposure_ratios[unknown])


def test_mitsunaga_follows_a_film_with_a_long_toe(make_stack, true_log_exposure):
    """A polynomial may make all frames agree by being flat: this one spans the exposures, and its u holds the error."""
    estimate = recover_response_mitsunaga1999(make_stack("toe", bit_depth=8))
    inner = slice(13, 243)
    error = estimate.curve.log_exposure[inner] - true_log_exposure("toe", 8)[inner]
    error -= error.mean()
    assert np.ptp(estimate.curve.log_exposure[inner]) > 1.5
    assert np.std(error) < 0.02
    assert np.std(error) < 2.0 * np.median(estimate.curve.u_log_exposure[inner])
    assert estimate.stability is not None
    assert estimate.stability.rms_log < 0.01


@pytest.mark.slow
def test_mitsunaga_says_how_the_exponent_is_fixed(make_stack):
    """Without a known ratio the product of the stated times fixes γ, and the result says so."""
    estimate = recover_response_mitsunaga1999(make_stack("gamma", bit_depth=8))
    assert "product of the stated exposure times" in estimate.gauge
    assert np.prod(estimate.exposure_ratios) == pytest.approx(2.0**8, rel=1e-6)


def test_mitsunaga_refuses_a_ratio_of_no_pair(make_stack):
    """A known ratio must belong to a pair of frames and be above 1."""
    with pytest.raises(UsageError, match="pair 40"):
        recover_response_mitsunaga1999(make_stack("gamma"), known_ratios={40: 2.0})


def test_linear_spline_finds_the_black_level(make_stack):
    """An unstated black level of 50 DN is found to 2 DN on a linear stack, and the deviation stays under 2 %."""
    frames = [
        Frame(np.minimum(f.dn.astype(np.uint32) + 50, 4095).astype(np.uint16), 12, f.settings)
        for f in make_stack("linear").light
    ]
    estimate = recover_response_linear_spline(Bracket.from_frames(frames))
    assert estimate.details["black_dn"] == pytest.approx(50, abs=2)
    assert estimate.details["largest_deviation_from_linear"] < 0.02


def test_linear_spline_owns_up_to_a_response_that_is_not_linear(make_stack, inner_error):
    """On kinks it cannot follow, a note says so and the uncertainty holds the error; on a line there is no note."""
    assert METHODS["linear_spline"]([make_stack("linear", bit_depth=8)]).notes == ()
    estimate = METHODS["linear_spline"]([make_stack("kinked", bit_depth=8)])
    assert "not nearly linear" in estimate.notes[0]
    error = inner_error(estimate.curve, "kinked")
    u = estimate.curve.u_log_exposure[13 : 13 + error.size]
    away = np.arange(13, 13 + error.size) != 128
    # The finer curve that stands for the truth is itself off by a part of that error: twice it at most.
    assert 0.2 < np.mean((error[away] / u[away]) ** 2) < 2.0


@pytest.mark.slow
def test_methods_that_agree_differ_by_few_sigma(make_stack):
    """Debevec–Malik and the best estimate agree on a gamma stack to within 1 % and 6 sigma."""
    bracket = [make_stack("gamma", bit_depth=8)]
    (found,) = compare_methods([METHODS["auto"](bracket), METHODS["debevec1997"](bracket)])
    assert (found.first, found.second) == ("auto", "debevec1997")
    assert found.rms_log < 0.01
    assert found.largest_sigma < 6


def test_choice_all_names_every_method():
    """`all` stands for every registered method, the default among them; an unknown name is a misuse."""
    assert method_names("all") == list(METHODS)
    assert DEFAULT_METHOD in METHODS
    with pytest.raises(UsageError, match="choose one of"):
        method_names("guess")


def test_a_polynomial_that_explains_nothing_is_refused(make_stack, monkeypatch):
    """A curve that is flat makes all frames agree, with u near 0: that is an error, not a response."""
    from radiometer.analysis.response.mitsunaga1999 import Polynomial

    monkeypatch.setattr(Polynomial, "log_curve", lambda self: np.zeros(256))
    with pytest.raises(MeasurementError, match="mitsunaga1999 finds no response"):
        recover_response_mitsunaga1999(make_stack("gamma", bit_depth=8))


@pytest.mark.slow
def test_a_polynomial_off_the_first_estimate_owns_up_to_it(make_stack, monkeypatch):
    """Bent by a fifth against Debevec and Malik's curve, its u holds most of that fifth."""
    from radiometer.analysis.response.mitsunaga1999 import Polynomial

    plain = Polynomial.log_curve

    def bent(self):
        g = plain(self)
        return g + 0.2 * np.sin(np.pi * np.arange(g.size) / 128.0)

    monkeypatch.setattr(Polynomial, "log_curve", bent)
    curve = recover_response_mitsunaga1999(make_stack("gamma", bit_depth=8)).curve
    assert curve.u_log_exposure[64] > 0.15
    assert curve.u_log_exposure[192] > 0.15


@pytest.mark.parametrize("response", ["gamma", "linear", "sigmoid"])
def test_twelve_bit_stack_gives_its_response_back(make_stack, inner_error, response):
    """The rms error of ln H over 5–95 % of the range stays under 0.003, shot noise of a 10 500 e⁻ well included."""
    estimate = recover_response_debevec1997(make_stack(response, shape=(384, 512)))
    assert np.sqrt(np.mean(inner_error(estimate.curve, response) ** 2)) < 0.003


@pytest.mark.parametrize("bit_depth", [8, 10, pytest.param(16, marks=pytest.mark.slow)])
def test_other_bit_depths_give_the_response_back(make_stack, inner_error, bit_depth):
    """8, 10 and 16 bits are served too; at 8 bits the rounding of 1/√12 DN near black adds to the error."""
    estimate = recover_response_debevec1997(make_stack("gamma", bit_depth=bit_depth))
    assert estimate.curve.log_exposure.size == 2**bit_depth
    assert np.sqrt(np.mean(inner_error(estimate.curve, "gamma") ** 2)) < 0.003


def test_curve_is_zero_in_the_middle_and_never_falls(make_stack):
    """The gauge is g(M_mid) = 0 and the curve is monotonic over all digital numbers, extrapolated ones included."""
    curve = recover_response_debevec1997(make_stack("sigmoid", bit_depth=8)).curve
    assert curve.log_exposure[128] == 0.0
    assert curve.u_log_exposure[128] < 1e-6
    assert np.all(np.diff(curve.log_exposure) >= 0)


def test_stated_uncertainty_covers_the_error(make_stack, inner_error):
    """Over five seeds the errors have, in units of u, a mean square between a quarter and twice the ideal of 1."""
    squares = []
    for seed in range(5):
        curve = recover_response_debevec1997(make_stack("gamma", seed=seed)).curve
        low = int(np.ceil(0.05 * 4095))
        error = inner_error(curve, "gamma")
        squares.append(np.mean((error / (curve.u_log_exposure[low : low + error.size] + 1e-9)) ** 2))
    assert 0.25 < np.mean(squares) < 2.0


def test_values_beyond_the_data_are_flagged_and_uncertain(make_stack):
    """A bracket that never comes near white leaves the top extrapolated: out of valid_dn, u as large as the step."""
    bright = make_stack("gamma", frames=9)
    dim = Bracket.from_frames([Frame(np.minimum(f.dn, 3000), 12, f.settings) for f in bright.light])
    curve = recover_response_debevec1997(dim).curve
    assert curve.valid_dn is not None
    assert curve.valid_dn[1] <= 3000
    assert curve.u_log_exposure[4000] >= curve.log_exposure[4000] - curve.log_exposure[3000] - 1e-9


def test_disjoint_pixels_give_curves_that_agree(make_stack):
    """The reported stability of disjoint thirds is under 1 % of exposure."""
    stability = recover_response_debevec1997(make_stack("gamma")).stability
    assert stability is not None
    assert stability.rms_log < 0.01


@pytest.mark.slow
def test_several_brackets_are_fitted_jointly(make_stack, inner_error):
    """Two brackets of different scenes give one curve, nearer the truth than the worse of the two alone."""
    pair = [make_stack("gamma", seed=seed) for seed in (3, 4)]
    alone = [np.std(inner_error(recover_response_debevec1997(b).curve, "gamma")) for b in pair]
    together = recover_response_debevec1997(pair)
    assert together.pixel_count == 2 * 192 * 256
    assert np.std(inner_error(together.curve, "gamma")) < max(alone)


def test_brackets_of_different_bit_depths_are_refused(make_stack):
    """One curve belongs to one pixel format."""
    with pytest.raises(InputError, match="bit depth"):
        recover_response_debevec1997([make_stack("gamma", bit_depth=8), make_stack("gamma", bit_depth=12)])

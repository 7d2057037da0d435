"""Debevec–Malik on stacks whose response is known."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.response.debevec1997 import recover_response_debevec1997
from radiometer.data import Bracket, Frame
from radiometer.errors import InputError


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

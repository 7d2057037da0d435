"""Laws of fits: what scales, what adds up, whose word counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.response.fit import fit_response, information
from radiometer.analysis.response.samples import gather_samples
from radiometer.data import Bracket, Frame, FrameSettings

TIMES = (0.5, 1.0, 2.0, 4.0)


@pytest.fixture(scope="module")
def samples():
    """Return samples of a straight line over four exposures."""
    radiance = np.exp(np.random.default_rng(1).uniform(-4.0, 0.0, (64, 64)))
    frames = [Frame(np.clip(np.round(radiance * t * 250), 0, 255).astype(np.uint8), 8, FrameSettings(t)) for t in TIMES]
    return gather_samples(Bracket.from_frames(frames))


@pytest.fixture(scope="module")
def fit(samples):
    """Return a fit of a straight line at one smoothing, its times taken as exact."""
    return fit_response(samples, samples.dn, np.full(samples.dn.size, 1e-4), time_spread=0.0, smoothing=1e-3)


def test_a_fit_follows_from_the_noise_s_proportions_alone(samples, fit):
    """Four times the variance: the same curve, four times its covariance, a quarter of χ², the same share of rows."""
    rough = fit_response(samples, samples.dn, np.full(samples.dn.size, 4e-4), time_spread=0.0, smoothing=1e-3)
    assert rough.coefficients == pytest.approx(fit.coefficients, rel=1e-6, abs=1e-9)
    assert rough.inverse == pytest.approx(4.0 * fit.inverse, rel=1e-6, abs=1e-12)
    assert rough.reduced_chi2 == pytest.approx(fit.reduced_chi2 / 4.0, rel=1e-6)
    assert rough.leverage() == pytest.approx(fit.leverage(), rel=1e-6)
    assert rough.covariance() == pytest.approx(fit.covariance(), rel=1e-4, abs=1e-12), (
        "the scatter decides, not its model"
    )


def test_rows_take_up_as_much_as_there_are_unknowns(fit):
    """The leverages add up to groups and effective parameters, none above the bound; χ² is over what is left."""
    parameters = float(np.trace(fit.inverse @ fit.normal.matrix))
    groups = int(fit.normal.group.max()) + 1
    assert fit.leverage().sum() == pytest.approx(groups + parameters, rel=1e-3)
    assert fit.leverage().sum() < groups + parameters
    assert fit.leverage().max() <= 0.95
    chi2 = fit.normal.weight @ fit.normal.residuals(fit.solution) ** 2
    assert fit.reduced_chi2 * (fit.normal.target.size - groups - parameters) == pytest.approx(chi2)


def test_data_and_smoothness_share_the_covariance_between_them(fit):
    """What the data make and what the smoothness decides is all of it, and each is a covariance."""
    by_data = fit.inverse @ fit.normal.matrix @ fit.inverse
    assert by_data + fit.smoothness_covariance() == pytest.approx(fit.inverse, rel=1e-9, abs=1e-15)
    for part in (by_data, fit.smoothness_covariance(), fit.covariance()):
        assert np.linalg.eigvalsh(0.5 * (part + part.T)).min() > -1e-9 * np.trace(fit.inverse)


def test_a_label_known_to_nothing_is_found_and_one_known_exactly_is_kept(samples):
    """A frame whose time is stated 1.2-fold too short: freed it says so, held by other data it is as they say."""
    off = samples.log_time - np.log(1.2) * (samples.frame == 2)
    times = samples.frame_log_time - np.log(1.2) * (np.arange(len(TIMES)) == 2)
    lying = replace(samples, frame_log_time=times, log_time=off)
    variance = np.full(samples.dn.size, 1e-4)

    def result_of(**more):
        found = fit_response(lying, samples.dn, variance, time_spread=0.0, smoothing=1e-3, free=[2], **more)
        return found.log_time_errors

    assert result_of() == pytest.approx([0.0, 0.0, np.log(1.2), 0.0], abs=0.01)
    assert result_of(known=[(0.5, 1e-6)]) == pytest.approx([0.0, 0.0, 0.5, 0.0], abs=1e-4)


@pytest.mark.parametrize("u", [0.0, 1e-9, 1e-3, 0.5])
def test_what_is_known_exactly_counts_as_known_to_a_millionth(u):
    """Information is the inverse of a variance, at most that of rounding."""
    assert information(np.diag([u**2, 0.25])) == pytest.approx(np.diag([max(u, 1e-6) ** -2.0, 4.0]), rel=1e-6)

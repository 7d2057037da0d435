"""Frames that are off in their own way, and colours of one set of photographs that share their exposures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.analysis.response.auto import solve_colours_auto
from radiometer.analysis.response.basis import ValueBasis
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.fit import ResponseFit, fit_response, information
from radiometer.analysis.response.limits import ValueLimits
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
from radiometer.data import Bracket, Frame, FrameSettings
from radiometer.errors import MeasurementError

Array = NDArray[np.float64]
SIGMA = 0.01
TIMES = tuple(0.25 * 1.7**k for k in range(6))


def rows_of(groups: int = 40, frames: int = 6) -> ResponseSamples:
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
        frame_bracket=np.zeros(frames, dtype=np.intp),
        pixel_count=100 * groups,
    )


def fit(samples: ResponseSamples, **how: object) -> ResponseFit:
    variance = np.full(samples.dn.size, SIGMA**2)
    return fit_response(samples, samples.dn, variance, time_spread=0.0, smoothing=1e3, **how)  # type: ignore[arg-type]


def test_the_variance_of_every_value_is_its_quadratic_form():
    """At each digital number that of the basis values there, four of which are not zero."""
    basis = ValueBasis(10, ValueLimits(20, 1000))
    root = np.random.default_rng(3).normal(size=(basis.size, basis.size))
    every = basis.all_values().toarray()
    expected = np.einsum("ni,ij,nj->n", every, root @ root.T, every)
    assert basis.variances(root @ root.T) == pytest.approx(expected, rel=1e-12)


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


def test_uncertainty_of_frames_stands_rounding_of_the_inverse():
    """A smallest eigenvalue that rounding leaves a little below zero changes no uncertainty."""
    samples = rows_of()
    off = fit(replace(samples, log_time=samples.log_time + SIGMA * (samples.frame == 2)))
    values, vectors = np.linalg.eigh(off.inverse)
    rounded = off.inverse - 1.001 * values[0] * np.outer(vectors[:, 0], vectors[:, 0])
    assert np.linalg.eigvalsh(rounded)[0] < 0.0
    expected, found = (one.frame_covariance(samples.frame) for one in (off, replace(off, inverse=rounded)))
    assert np.diag(found) == pytest.approx(np.diag(expected), rel=1e-3)


def test_a_label_known_from_elsewhere_is_weighed_by_its_uncertainty():
    """What is known exactly stays; what is known as well as the data know it comes out half way."""
    samples = rows_of()
    log_time = samples.frame_log_time - 0.2 * (np.arange(6) == 3)
    wrong = replace(samples, frame_log_time=log_time, log_time=log_time[samples.frame])
    alone = fit(wrong, free=(3,))
    assert alone.time_modes[0] == pytest.approx(0.2, abs=1e-3)
    assert fit(wrong, free=(3,), known=((0.1, 1e-6),)).time_modes[0] == pytest.approx(0.1, abs=1e-4)
    u = float(np.sqrt(alone.inverse[-1, -1]))
    assert fit(wrong, free=(3,), known=((0.1, u),)).time_modes[0] == pytest.approx(0.15, abs=2e-3)


def test_a_label_that_nothing_determines_is_refused_in_words():
    """A freed frame without a row, of which other data say nothing either, leaves equations without a solution."""
    samples = rows_of()
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


def last_label_off(*, lowest: int = 0, more: int = 0) -> Plane:
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


def test_a_plane_that_cannot_tell_a_label_is_given_it():
    """By itself it takes a flat curve and makes the exposures equal, sure of it; others give it label and slope."""
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


def test_planes_none_of_which_can_tell_a_label_are_left_to_the_judge():
    """Where no plane can tell the exposure, the joint one is what they say; left-out pixels judge it."""
    (alone,) = fit_planes([last_label_off(lowest=4)], Choices(free=(5,))).log_ratios
    assert fit_planes([last_label_off(lowest=4)] * 2, Choices(free=(5,))).log_ratios == pytest.approx([alone])


def test_a_plane_without_a_row_of_the_freed_frame_says_nothing():
    """The label is what the plane says that shows the frame."""
    bright, blind = last_label_off(), last_label_off()
    blind = replace(blind, samples=blind.samples.kept(blind.samples.frame != 5))
    joint, alone = (fit_planes(planes, Choices(free=(5,))) for planes in ([bright, blind], [bright]))
    assert joint.log_ratios == pytest.approx(alone.log_ratios)
    assert joint.u_log_ratios == pytest.approx(alone.u_log_ratios)


def scene() -> Array:
    tones = np.random.default_rng(11).permutation(np.linspace(-5.0, 1.5, 140)).reshape(10, 14)
    return np.asarray(np.kron(tones, np.ones((12, 12))))


def colour(
    gamma: float, tint: float, wrong: int | None, seed: int, times: tuple[float, ...] = TIMES, contrast: float = 1.0
) -> Bracket:
    """Return photographs of the scene through a tone curve, the label of one frame too long by a third of a stop."""
    rng, frames = np.random.default_rng(seed), []
    for number, seconds in enumerate(times):
        share = 1.0 - np.exp(-np.exp(contrast * scene() + tint) * seconds)
        values = 255.0 * share**gamma + 0.7 * rng.standard_normal(share.shape)
        label = seconds * (2.0 ** (1 / 3) if number == wrong else 1.0)
        frames.append(Frame(np.clip(np.round(values), 0, 255).astype(np.uint8), 8, FrameSettings(label)))
    return Bracket.from_frames(frames)


def planes_of(wrong: int | None, colours: int = 2) -> list[Plane]:
    samples = [gather_samples(colour(0.45 + 0.1 * k, -0.7 * k, wrong, k)) for k in range(colours)]
    return [Plane(one, curve_debevec1997(one).log_exposure) for one in samples]


@pytest.fixture(scope="module")
def lying() -> list[Plane]:
    return planes_of(3)


@pytest.mark.slow
def test_colours_together_tell_one_label(lying):
    """Two tone curves, one wrong label: one frame, its ratio the mean of both by u, widened where they disagree."""
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


@pytest.mark.slow
def test_colours_with_right_labels_name_none_and_a_dark_one_says_nothing(lying):
    """Right labels are left alone; a colour without shares neither helps nor hinders."""
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
def test_shares_are_judged_as_quadrants_are(lying):
    """What is left out is cut in another way; of two planes alike the errors and the rows are twice those of one."""
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


def test_errors_are_counted_by_rows_and_without_each_share_that_shows_the_frame():
    """Two frames in three shares, of which one does not show the second."""
    left_out = LeftOut(np.array([[4.0, 6.0], [2.0, 0.0], [3.0, 1.0]]), np.array([[2.0, 3.0], [1.0, 0.0], [3.0, 1.0]]))
    assert left_out.mean_dn() == pytest.approx(16.0 / 10.0)
    assert left_out.mean_dn(0) == pytest.approx(9.0 / 6.0)
    assert left_out.mean_dn(1, 0) == pytest.approx(16.0 / 10.0)
    assert left_out.means_without_one_dn(0) == pytest.approx([5.0 / 4.0, 7.0 / 5.0, 6.0 / 3.0])
    assert left_out.means_without_one_dn(1) == pytest.approx([1.0, 2.0])


@pytest.mark.slow
def test_estimates_of_colours_take_the_label_found_together(lying):
    """Each colour's curve comes with the same wrong label, and with the exposure that all of them tell."""
    estimates = solve_colours_auto([plane.samples for plane in lying])
    (together,) = find_wrong_labels(lying)
    for estimate in estimates:
        (label,) = estimate.details["wrong_labels"]
        assert (label["frame"], label["ratio"]) == (together.frame, pytest.approx(together.ratio))
        found = np.exp(estimate.details["log_time_errors"][3])
        assert found == pytest.approx(together.ratio, abs=together.u_ratio)


@pytest.mark.parametrize("gamma", [0.55, 0.7])
def test_two_frames_six_stops_apart_tell_the_curve_between_them(gamma):
    """Hardly a value in both: a curve through every mean would have no error; the smoothest that predicts is right."""
    (estimate,) = solve_colours_auto([gather_samples(colour(gamma, -0.5, None, 1, (0.03, 1.92), 0.8))])
    dn = np.arange(20, 200)
    gap = estimate.curve.log_exposure[dn] - np.log(-np.log1p(-((dn / 255.0) ** (1.0 / gamma))))
    assert np.std(gap) < 0.03

"""Sources of error that several figures share: basis and variance become weights."""

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, FrameEntry, FrameSettings, PatchDescription
from radiometer.reconciliation.measure.design import CaptureStatistics, Design
from radiometer.reconciliation.measure.lines import RowBins, TileBands
from radiometer.reconciliation.shared_errors import (
    Part,
    Repeatability,
    SharedError,
    phases_of_wave,
    shared_errors,
    whiteners,
)
from radiometer.reconciliation.statistics import STATISTICS, Given, Prediction, family_of


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


def test_basis_and_variance_give_the_covariance():
    """Two z of variance 4 and 9 with known bases give B·Φ·Bᵀ, amplitudes on both sides."""
    basis = np.array([[1.0, 0.0], [1.0, 2.0]])
    part = Part(np.array([[2.0, 3.0]]), np.broadcast_to(basis, (1, 2, 2)))
    found = SharedError("test", {"mean": part}, np.array([[4.0, 9.0]])).covariance("mean")[0]
    assert found.tolist() == [[4.0 * 4.0, 6.0 * 4.0], [6.0 * 4.0, 9.0 * (4.0 + 4.0 * 9.0)]]


def test_what_the_uncertainty_holds_already_correlates_only():
    """An error within a statistic's own uncertainty adds nothing to its variance."""
    error = SharedError("test", {"bands": Part(np.ones((1, 3)), np.ones((3, 1)))}, np.array([0.5]), within=True)
    assert error.covariance("bands")[0].tolist() == [[0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0]]


def test_whitened_errors_have_unit_variance():
    """The whitener times the covariance of entries that share two errors is the identity; what is left out stays 1."""
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


def test_tiles_side_by_side_share_their_rows(design):
    """Row noise gives two tiles on the same 40 rows the covariance 1/40, one below them none."""
    shared = design.rows_of_tiles @ design.rows_of_tiles.T
    assert shared[0, 1] * design.tile_height[0] == pytest.approx(1.0, abs=0.1)  # a margin may take rows off
    assert shared[0, 2] == 0.0
    assert shared[0, 1] == pytest.approx(shared[0, 0])


def test_a_wave_correlates_tiles_by_the_cosine_of_their_distance(design):
    """Two tiles half a period apart move against each other, at a quarter they do not move together."""
    distance = float(np.diff(TileBands.of(design, 0.1).middle[[0, 2]])[0])
    for periods, correlation in ((0.5, -1.0), (0.25, 0.0), (1.0, 1.0)):
        left = TileBands.of(design, periods / distance)
        quadratures = left.quadratures(np.ones(3))
        assert quadratures[0] @ quadratures[2] == pytest.approx(correlation, abs=1e-9)


def test_scores_of_one_wave_follow_its_few_phases(design):
    """The squares of two coefficients of correlation ρ have the covariance 2ρ²/(n−1) − (½+ρ²)/n in units of ρ = 1."""
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


def test_directions_of_one_statistic_are_one_family():
    """Slopes along x and y are one family, variances are their own."""
    assert family_of("slope_x") == family_of("slope_y") == "slope"
    assert family_of("variance") == "variance"


def test_what_follows_the_light_is_predicted(design):
    """What reports or follows the light of a tile is given per tile and stands in the prediction."""
    for name, row in STATISTICS.items():
        if row.determines_light or row.follows_light:
            assert row.given is Given.TILE
            assert name in Prediction.__dataclass_fields__


def test_light_moves_what_counts_by_its_sensitivity(design):
    """A capture's light moves the means of the tiles that count by d(mean)/d(log light) each, and no other."""
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

"""What noise reports and what counts, by laws and at exact bounds: black levels, scatter of light, scores of names."""

import math

import numpy as np
import pytest

from radiometer.reconciliation.repeatability import capture_scale
from radiometer.reconciliation.search.localise import Covariate
from radiometer.reconciliation.statistics import Given, Scale, family_of, named


def test_the_light_of_a_capture_is_the_weighted_mean_of_its_tiles():
    """Each deviation over its sensitivity, by the information of its own noise; the same without it is infinite."""
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


def test_rows_of_the_table_are_found_by_their_kind():
    """Both slopes are of one family; kinds of rows part the table."""
    assert {family_of(name) for name in ("slope_x", "slope_y")} == {"slope"}
    assert family_of("mean") == "mean"
    assert {"mean", "variance", "first"} <= set(named(given=Given.TILE)) < set(named())
    assert named(scale=Scale.COMB) == named(given=Given.PERIOD) == ("comb",)


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

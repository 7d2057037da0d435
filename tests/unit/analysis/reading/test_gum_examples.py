"""The Guide's own examples through our functions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.analysis.characterise.line_fit import fit_line, is_bent
from radiometer.analysis.reading.budget import (
    Term,
    combined_u,
    coverage_factor,
    difference,
    effective_degrees_of_freedom,
    mean,
    ratio,
    shares,
)
from radiometer.data import Contribution, Patch, Quantity, Reading
from testing.golden import gum

positive = st.floats(0.1, 10.0)
parts = st.floats(0.001, 0.1)


def test_the_end_gauge():
    """H.1: u = 32 nm of 16 degrees of freedom, k = 2.92 for 99 %, U = 93 nm."""
    terms = [Term(str(n), u, degrees_of_freedom=freedom) for n, (u, freedom) in enumerate(gum.END_GAUGE)]
    assert combined_u(terms) == pytest.approx(gum.END_GAUGE_U_NM, abs=0.5)
    freedom = effective_degrees_of_freedom(terms)
    assert math.floor(freedom) == gum.END_GAUGE_FREEDOM
    factor = coverage_factor(math.floor(freedom), 0.99)
    assert round(factor, 2) == gum.END_GAUGE_K99
    assert factor * combined_u(terms) == pytest.approx(gum.END_GAUGE_U99_NM, abs=1.0)


def test_the_end_gauge_s_smaller_contributions():
    """H.1: the comparator's 9.7 nm with 25.6 degrees of freedom; expansion 2.9 nm and temperature 16.6 nm."""
    parts = [Term(str(n), u, degrees_of_freedom=freedom) for n, (u, freedom) in enumerate(gum.COMPARATOR)]
    (_, (comparator, freedom), (expansion, _), (temperature, _)) = gum.END_GAUGE
    assert round(combined_u(parts), 1) == comparator
    rounded_first = (comparator / combined_u(parts)) ** 4  # as the Guide does
    assert round(effective_degrees_of_freedom(parts) * rounded_first, 1) == freedom
    assert pytest.approx(expansion, abs=0.05) == gum.GAUGE_NM * gum.U_EXPANSION_PER_K * gum.DEVIATION_K
    assert pytest.approx(temperature, abs=0.05) == gum.GAUGE_NM * gum.EXPANSION_PER_K * gum.U_DIFFERENCE_K


def test_the_impedance_of_correlated_voltage_and_current():
    """H.2: V/I of means that five simultaneous observations correlate by −0.36 is 254.260 Ω with u = 0.236 Ω."""
    values = np.array([gum.VOLTAGE, gum.CURRENT_MA])
    covariance = np.cov(values) / values.shape[1]
    (v, i), (u_v, u_i) = values.mean(axis=1), np.sqrt(np.diag(covariance))
    assert (round(u_v, 4), round(u_i, 4)) == (gum.VOLTAGE_U, gum.CURRENT_U_MA)
    assert round(covariance[0, 1] / (u_v * u_i), 2) == gum.CORRELATION
    shared = math.sqrt(-covariance[0, 1] / (v * i))  # what raises the one and lowers the other
    readings = [
        Reading(Quantity(x, u, "1"), Patch(0, 0, 1, 1), "1", budget=(Contribution("both", part, correlated=True),))
        for x, u, part in ((v, u_v, shared), (i / 1e3, u_i / 1e3, -shared))
    ]
    found = ratio(*readings)
    assert round(found.value, 2) == round(gum.IMPEDANCE, 2)
    assert found.u == pytest.approx(gum.IMPEDANCE_U, abs=0.0005)
    each = values[0] / values[1] * 1e3  # H.2.4: the mean of the five ratios has the same
    assert found.u == pytest.approx(each.std(ddof=1) / math.sqrt(5), rel=2e-3)


@pytest.mark.parametrize("row", gum.STUDENT, ids=[f"{row[0]} degrees" for row in gum.STUDENT])
def test_student_s_factors(row):
    """Table G.2 to its digits, for three probabilities."""
    freedom, *factors = row
    found = [coverage_factor(freedom, probability) for probability in (0.6827, 0.9545, 0.9973)]
    assert found == pytest.approx(factors, rel=1e-3, abs=0.0051)


def test_the_thermometer():
    """H.3: line, uncertainties and scatter; readings of unit weight with the scatter in the Birge ratio."""
    t, b = np.array(gum.THERMOMETER).T
    line = fit_line(t, b, np.full(t.size, 1e-6))
    assert (round(line.intercept, 4), round(line.u_intercept, 4)) == gum.THERMOMETER_INTERCEPT
    assert (round(line.slope, 5), round(line.u_slope, 5)) == gum.THERMOMETER_SLOPE
    assert round(line.birge_ratio * 1e-6, 4) == gum.THERMOMETER_SCATTER
    assert line.degrees_of_freedom == 9
    honest = fit_line(t, b, np.full(t.size, 1.0))  # scatter below what is stated narrows nothing
    assert honest.u_slope == pytest.approx(1.0 / math.sqrt(float(((t - t.mean()) ** 2).sum())))


def test_a_line_through_the_origin_and_one_of_unequal_weights():
    """Σwxy/Σwx²; and the weighted mean and slope by hand."""
    x, y, u = np.array([1.0, 2.0, 4.0]), np.array([1.1, 1.9, 4.2]), np.array([0.1, 0.2, 0.4])
    tied = fit_line(x, y, u, through_origin=True)
    w = u**-2
    assert tied.slope == pytest.approx((w * x * y).sum() / (w * x * x).sum())
    assert (tied.intercept, tied.u_intercept, tied.degrees_of_freedom) == (0.0, 0.0, 2)
    assert tied.u_slope == pytest.approx((w * x * x).sum() ** -0.5 * max(1.0, tied.birge_ratio))
    line = fit_line(x, y, u)
    middle_x, middle_y = (w * x).sum() / w.sum(), (w * y).sum() / w.sum()
    slope = (w * (x - middle_x) * (y - middle_y)).sum() / (w * (x - middle_x) ** 2).sum()
    assert line.slope == pytest.approx(slope)
    assert line.intercept == pytest.approx(middle_y - slope * middle_x)
    with pytest.raises(ValueError, match="1 points"):
        fit_line([1.0], [1.0], [1.0])


def test_a_bend_is_seen_above_the_noise_only():
    """y = x + 0.01·x² over 0 to 10 bends by many u of 0.001 and by none of 1; three points show no bend."""
    x = np.linspace(0.0, 10.0, 21)
    for tied in (False, True):
        assert is_bent(x, x + 0.01 * x**2, np.full(21, 1e-3), through_origin=tied)
        assert not is_bent(x, x + 0.01 * x**2, np.full(21, 1.0), through_origin=tied)
    assert not is_bent(x[:3], x[:3] ** 2, np.full(3, 1e-3))


def reading(value, own, shared):
    u = abs(value) * math.hypot(own, shared)
    lines = (Contribution("noise", own), Contribution("scale", shared, correlated=True))
    return Reading(Quantity(value, u, "1"), Patch(0, 0, 1, 1), "1", budget=lines)


@given(positive, positive, parts, parts, parts)
def test_what_two_readings_share(a, b, own_a, own_b, shared):
    """F.1.2.3 by hand: it drops out of a ratio, counts with the difference in a difference, and whole in a mean."""
    one, two = reading(a, own_a, shared), reading(b, own_b, shared)
    assert ratio(one, two).value == pytest.approx(a / b)
    assert ratio(one, two).u == pytest.approx(a / b * math.hypot(own_a, own_b), rel=1e-6)
    expected = math.sqrt((a * own_a) ** 2 + (b * own_b) ** 2 + (shared * (a - b)) ** 2)
    assert difference(one, two).u == pytest.approx(expected, rel=1e-6)
    together = mean([one, two])
    expected = math.sqrt((a * own_a) ** 2 + (b * own_b) ** 2 + (shared * (a + b)) ** 2) / 2
    assert (together.value, together.u) == (pytest.approx((a + b) / 2), pytest.approx(expected, rel=1e-6))


@given(st.lists(parts, min_size=1, max_size=6), st.floats(1.0, 100.0))
def test_contributions_add_in_squares_and_lines_are_relative(parts, value):
    """u² = Σu², shares sum to one in falling order, a line is u over the value."""
    terms = [Term(str(n), u * value) for n, u in enumerate(parts)]
    assert combined_u(terms) == pytest.approx(value * math.sqrt(sum(u**2 for u in parts)))
    lines = [term.contribution(value) for term in terms]
    assert [line.u_rel for line in lines] == pytest.approx(parts)
    found = shares(lines)
    assert sum(share for _, share in found) == pytest.approx(1.0)
    assert [line.u_rel for line, _ in found] == pytest.approx(sorted(parts, reverse=True))
    assert [share for _, share in shares([Contribution("nothing", 0.0)] * 2)] == [0.0, 0.0]
    assert effective_degrees_of_freedom(terms) == math.inf
    assert coverage_factor(math.inf) == pytest.approx(2.0, abs=1e-3)

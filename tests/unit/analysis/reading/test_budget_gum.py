"""Uncertainty budgets by the Guide: its examples, a peer, and the law of propagation."""

import datetime as dt
import math
from dataclasses import replace

import GTC
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.analysis.characterise.line_fit import fit_line, is_bent
from radiometer.analysis.reading import budget
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
from radiometer.analysis.reading.monte_carlo import Distribution, propagate_distributions
from radiometer.analysis.reading.reading import patch_situation, read_patch
from radiometer.data import (
    BlackLevel,
    Contribution,
    FlatField,
    Patch,
    Quantity,
    Reading,
    ScaleConditions,
    StatedUncertainties,
)
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError
from testing.golden import gum

# What a test of single contributions leaves out: everything outside the model.
EXACT = StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0))

FLAT = FlatField(
    principal_point_px=(8.0, 8.0), radius_px=12.0, coefficients=(-0.1, 0.0, 0.0), shape=(16, 16), u_rel=0.01
)

# (light as a part of full scale, exposures in s, what differs in the calibration)
TEN = [
    (0.5, (1e-3,), {}),
    (0.5, (1e-3, 5e-4, 2.5e-4), {"u_rel": 0.02}),
    (0.001, (1e-3, 4e-3), {}),
    (0.00002, (1e-3, 1e-2), {}),
    (0.8, (1e-3,), {"u_rel": 0.067}),
    (0.3, (1e-3, 2e-3), {"flat_field": FLAT}),
    (0.3, (1e-3,), {"uncertainties": StatedUncertainties(exposure_u_rel=0.03)}),
    (0.01, (1e-3,), {"black_level": BlackLevel(dn=64.0, u_dn=2.0)}),
    (0.6, (1e-3,), {"uncertainties": StatedUncertainties(spectral_u_rel=0.05, linearity_u_rel=0.02)}),
    (0.4, (1e-3, 1e-3, 1e-3), {"u_rel": 0.004, "other_f_number": 8.0}),
]


def reading_inputs(rig, level, exposures_s, changes, seed=1):
    options = dict(changes)
    other = options.pop("other_f_number", None)
    calibration = rig.calibration(u_rel=options.pop("u_rel", 0.0), **options)
    if other:
        scale = calibration.scale.model_copy(update={"f_number": other})
        calibration = type(calibration)(calibration.camera, calibration.lens, scale, None, calibration.noise)
    scene = np.full((16, 16), level * rig.radiance_of_full_scale(1e-3))
    frames = rig.frames(scene, np.random.default_rng(seed), exposures_s)
    return frames, Patch(2, 2, 12, 12), Setup(rig.description, rig.lens, calibration)


@pytest.mark.parametrize("case", range(10))
def test_linear_and_monte_carlo_budgets_agree(rig, case):
    """Within 5 % on ten different readings (40 000 draws: the sampling error is 0.4 %)."""
    inputs = reading_inputs(rig, *TEN[case])
    linear = read_patch(*inputs).radiance
    drawn = propagate_distributions(patch_situation(*inputs), np.random.default_rng(case), 40_000)
    assert drawn.u == pytest.approx(linear.u, rel=0.05)
    assert abs(drawn.mean - linear.value) < 0.1 * linear.u
    assert drawn.high - drawn.low == pytest.approx(4.0 * linear.u, rel=0.08)


def test_a_ratio_of_readings_shares_curve_and_scale(rig):
    """The curve at the same level only; of one calibration the noise of both is left; none to nothing."""

    def curved(value):
        lines = (Contribution("response curve", 0.01, correlated=True),)
        return Reading(Quantity(value, 0.01 * value, "W sr-1 m-2"), Patch(0, 0, 1, 1), "1", budget=lines)

    assert budget.ratio(curved(1.0), curved(1.0)).u_rel == pytest.approx(0.0, abs=1e-9)
    assert budget.ratio(curved(1.0), curved(10.0)).u_rel == pytest.approx(0.01 * math.sqrt(2))
    with pytest.raises(MeasurementError):
        budget.ratio(reading(1.0, 0.1, 0.1), reading(0.0, 0.1, 0.1))
    with pytest.raises(MeasurementError):
        budget.mean([])
    (one, first), (two, second) = (read_with_gtc(rig, *of, 0.05) for of in ((0.02, 1), (0.01, 9)))
    scale = GTC.ureal(rig.true_scale, 0.05 * rig.true_scale)
    assert budget.ratio(one, two).u == pytest.approx((first(scale) / second(scale)).u, rel=0.01)


def test_monte_carlo_next_to_the_budget_says_where_they_differ(rig):
    """A scale of 0.5 % validates the linear budget; an f-number to 20 % is squared, and its interval lies lopsided."""
    plain = reading_inputs(rig, 0.5, (1e-3,) * 5, {"u_rel": 0.005, "uncertainties": EXACT})
    bent = EXACT.model_copy(update={"f_number_u_rel": 0.2})
    squared = reading_inputs(rig, 0.5, (1e-3,) * 5, {"uncertainties": bent})
    setup = squared[2]
    scale = setup.calibration.scale.model_copy(update={"f_number": 8.0})
    squared = (*squared[:2], replace(setup, calibration=replace(setup.calibration, scale=scale)))
    printed = [
        propagate_distributions(patch_situation(*inputs), np.random.default_rng(1)).to_mapping(read_patch(*inputs))
        for inputs in (plain, squared)
    ]
    assert printed[0]["validates"]
    assert not printed[1]["validates"]
    assert printed[1]["low_differs_by"] > printed[1]["tolerance"]


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e3])
@pytest.mark.parametrize(
    ("low", "high", "validates"),
    [
        (8.0, 12.0, True),
        (8.04, 11.96, True),
        (7.96, 12.04, True),
        (8.2, 12.0, False),
        (7.8, 12.0, False),
        (8.0, 11.8, False),
        (8.0, 12.2, False),
    ],
)
def test_both_ends_of_the_interval_must_agree(low, high, validates, unit):
    """10 ± 2 with u = 1.0: its second digit is 0.1, half of it the tolerance at either end, in whatever unit."""
    linear = Reading(Quantity(10.0 * unit, unit, "1"), Patch(0, 0, 1, 1), "1", coverage_factor=2.0)
    mapping = Distribution(10.0 * unit, unit, low * unit, high * unit).to_mapping(linear)
    assert (mapping["validates"], mapping["tolerance"]) == (validates, pytest.approx(0.05 * unit))
    differs = (mapping["low_differs_by"] / unit, mapping["high_differs_by"] / unit)
    assert differs == (pytest.approx(low - 8.0), pytest.approx(high - 12.0))


@pytest.mark.parametrize(
    ("value", "u", "u_rel"), [(-2.0, 0.5, 0.25), (0.0, 0.5, 1.0), (0.0, 0.0, 0.0), (4.0, 0.0, 0.0)]
)
def test_a_line_of_the_budget_is_relative_to_the_value_s_size(value, u, u_rel):
    """To its own u where the value is nothing, so that it stays a number; all else is reported as it stands."""
    term = Term("lamp", u, "A", 7.0, correlated=True, note="of 8 readings")
    assert term.contribution(value) == Contribution("lamp", u_rel, "A", 7.0, True, "of 8 readings")


@pytest.mark.parametrize("u", [0.0, 0.01, 0.0123, 0.0999, 3.0, math.inf])
def test_ends_agree_to_half_of_the_second_digit_of_u(u: float) -> None:
    """Of 0.0123 that is 0.0005, but never less than a twentieth of u, by which ends of draws scatter; of 0 nothing."""
    reading = Reading(Quantity(5.0, u, "1"), Patch(0, 0, 1, 1), "1", coverage_factor=2.0)
    told = Distribution(5.1, u, 5.0 - 2.0 * 0.01, 5.0 + 2.2 * 0.01).to_mapping(reading)
    half_digit = 0.5 * 10.0 ** math.floor(math.log10(u) - 1.0) if 0.0 < u < math.inf else 0.0
    assert told["tolerance"] == pytest.approx(max(half_digit, 0.05 * u))
    if u == 0.01:
        assert (told["low_differs_by"], told["high_differs_by"]) == pytest.approx((0.0, 0.002))


positive = st.floats(0.1, 10.0)

parts = st.floats(0.001, 0.1)


def test_the_gauge_and_the_thermometer_of_the_guide():
    """H.1: u = 32 nm of 16 degrees of freedom, U = 93 nm; H.3: line, uncertainties and scatter."""
    terms = [Term(str(n), u, degrees_of_freedom=freedom) for n, (u, freedom) in enumerate(gum.END_GAUGE)]
    assert combined_u(terms) == pytest.approx(gum.END_GAUGE_U_NM, abs=0.5)
    freedom = effective_degrees_of_freedom(terms)
    assert math.floor(freedom) == gum.END_GAUGE_FREEDOM
    factor = coverage_factor(math.floor(freedom), 0.99)
    assert round(factor, 2) == gum.END_GAUGE_K99
    assert factor * combined_u(terms) == pytest.approx(gum.END_GAUGE_U99_NM, abs=1.0)
    t, b = np.array(gum.THERMOMETER).T
    line = fit_line(t, b, np.full(t.size, 1e-6))
    assert (round(line.intercept, 4), round(line.u_intercept, 4)) == gum.THERMOMETER_INTERCEPT
    assert (round(line.slope, 5), round(line.u_slope, 5)) == gum.THERMOMETER_SLOPE
    assert round(line.birge_ratio * 1e-6, 4) == gum.THERMOMETER_SCATTER
    assert line.degrees_of_freedom == 9
    honest = fit_line(t, b, np.full(t.size, 1.0))  # scatter below what is stated narrows nothing
    assert honest.u_slope == pytest.approx(1.0 / math.sqrt(float(((t - t.mean()) ** 2).sum())))


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


def test_lines_and_bends_are_those_by_hand():
    """Through the origin, with unequal weights; 0.01·x² bends by many u of 0.001 and none of 1."""
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


PATCH = Patch(1, 1, 10, 10)

NOON = dt.datetime(2026, 1, 1, 12, tzinfo=dt.UTC)


def read_with_gtc(rig, level, seed, u_rel, freedom=math.inf):
    """Return the reading of five frames by a scale known to u_rel, and what GTC makes of the photons and a scale.

    L = s·x/(t·π/4N²); the noise of the mean x of 100 pixels is that of their electrons, of reading and of rounding.
    """
    base = rig.calibration(
        u_rel=u_rel,
        uncertainties=EXACT,
        black_level=BlackLevel(dn=64.0, u_dn=0.0, dark_u_rel=0.0),
        created=NOON.isoformat(),
    )
    update = {"conditions": ScaleConditions(temperature_c=25.0), "degrees_of_freedom": freedom}
    calibration = replace(base, scale=base.scale.model_copy(update=update))
    scene = np.full((12, 12), level * rig.radiance_of_full_scale(1e-3))
    frames = rig.frames(scene, np.random.default_rng(seed), (1e-3,) * 5)
    mean = float(np.mean([frame.dn[PATCH.slices].mean() for frame in frames])) - rig.black_dn
    variance = mean * rig.gain_e_per_dn + rig.read_e**2 + rig.gain_e_per_dn**2 / 12.0
    signal = GTC.ureal(mean, math.sqrt(variance / 500.0) / rig.gain_e_per_dn) / 1e-3
    found = read_patch(frames, PATCH, Setup(rig.description, rig.lens, calibration), now=NOON)
    return found, lambda scale: scale * signal / (math.pi / 64.0)


def test_scale_of_few_degrees_of_freedom(rig):
    """A scale from five repeats, 2 %, and the noise of dim light: u, degrees of freedom and k are those of GTC."""
    # Frames and pixels that by chance scatter by no more than their noise.
    found, by_gtc = read_with_gtc(rig, 0.0005, 1, 0.02, 4.0)
    expected = by_gtc(GTC.ureal(rig.true_scale, 0.02 * rig.true_scale, 4.0))
    assert found.radiance.value == pytest.approx(expected.x, rel=1e-3)
    assert found.radiance.u == pytest.approx(expected.u, rel=0.01)
    assert found.degrees_of_freedom == pytest.approx(expected.df, rel=0.01)
    assert found.coverage_factor == pytest.approx(GTC.reporting.k_factor(found.degrees_of_freedom, 95.45), rel=0.01)

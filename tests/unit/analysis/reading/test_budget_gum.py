"""The budget: linear against Monte Carlo, degrees of freedom, and what two readings share."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.reading import budget
from radiometer.analysis.reading.budget import Term
from radiometer.analysis.reading.monte_carlo import Distribution, propagate_distributions
from radiometer.analysis.reading.reading import patch_situation, read_patch
from radiometer.data import BlackLevel, Contribution, FlatField, Patch, Quantity, Reading, Scale, StatedUncertainties
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError

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


def test_monte_carlo_notices_a_missing_contribution(rig):
    """A budget whose scale uncertainty is taken away no longer agrees: the check can fail."""
    inputs = reading_inputs(rig, 0.5, (1e-3,), {"u_rel": 0.02, "uncertainties": EXACT})
    linear = read_patch(*inputs)
    without = math.sqrt(sum(one.u_rel**2 for one in linear.budget if one.name != "scale")) * linear.radiance.value
    drawn = propagate_distributions(patch_situation(*inputs), np.random.default_rng(1))
    assert drawn.u > 5.0 * without


def simple(value, own, shared):
    lines = (Contribution("repeatability", own, "A"), Contribution("scale", shared, correlated=True))
    return Reading(Quantity(value, value * math.hypot(own, shared), "W sr-1 m-2"), Patch(0, 0, 1, 1), "1", budget=lines)


def test_the_curve_is_shared_only_at_the_same_level():
    """A ratio of 1 to 10 keeps the response curve's uncertainty of both; a ratio of equals loses it."""

    def curved(value):
        lines = (Contribution("response curve", 0.01, correlated=True),)
        return Reading(Quantity(value, 0.01 * value, "W sr-1 m-2"), Patch(0, 0, 1, 1), "1", budget=lines)

    assert budget.ratio(curved(1.0), curved(1.0)).u_rel == pytest.approx(0.0, abs=1e-9)
    assert budget.ratio(curved(1.0), curved(10.0)).u_rel == pytest.approx(0.01 * math.sqrt(2))


def test_ratios_to_nothing_are_refused():
    """Neither a ratio to zero nor the mean of none has a value."""
    with pytest.raises(MeasurementError):
        budget.ratio(simple(1.0, 0.1, 0.1), simple(0.0, 0.1, 0.1))
    with pytest.raises(MeasurementError):
        budget.mean([])


def test_the_scale_s_degrees_of_freedom_reach_the_budget(rig):
    """A scale from five repeats says so in its line."""
    frames, patch, setup = reading_inputs(rig, 0.5, (1e-3,), {"u_rel": 0.01})
    calibration = setup.calibration
    scale = Scale(**{**calibration.scale.model_dump(), "degrees_of_freedom": 4.0})
    few = type(calibration)(calibration.camera, calibration.lens, scale, None, calibration.noise)
    line = next(one for one in read_patch(frames, patch, replace(setup, calibration=few)).budget if one.name == "scale")
    assert line.degrees_of_freedom == 4.0


def test_welch_satterthwaite_weighs_by_the_fourth_power():
    """1 with 4 degrees of freedom and 2 with 16: (1 + 4)²/(1/4 + 16/16) = 20."""
    terms = [Term("a", 1.0, "A", 4.0), Term("b", 2.0, "A", 16.0)]
    assert budget.effective_degrees_of_freedom(terms) == pytest.approx(20.0)


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

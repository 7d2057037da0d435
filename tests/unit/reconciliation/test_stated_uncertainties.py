"""What a stated uncertainty is made of: its unit, its size where the model misfits, priors, biases of logarithms."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.fit import covariance
from radiometer.reconciliation.fit.comparison import _LOGARITHMS, Comparison
from radiometer.reconciliation.fit.terms import inverse, prior_residual
from radiometer.reconciliation.model.parameters import EffectParameters
from radiometer.reconciliation.verdict import rest_of
from simulators.effects.conversion_gain_error import ConversionGainError
from simulators.effects.psf_blur import PsfBlur


def test_u_stands_in_the_parameter_s_own_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A standard deviation of 2 and of 3 of what the fit takes for a unit of each; one that is held has none."""
    effects = (PsfBlur(0.3), ConversionGainError(0.01))
    own = EffectParameters.of(effects, 4095.0)
    (held,) = [i for i, name in enumerate(own.names) if own.owner[i] == 1]
    free = [i for i in range(own.size) if i != held]
    sizes = np.arange(2.0, 2.0 + len(free))
    monkeypatch.setattr(covariance, "effect_covariance", lambda _: np.diag(sizes**2))
    state: Any = SimpleNamespace(parameters=own, frozen=frozenset({held}), effects=effects)
    found = covariance.fitted_parameters(state)
    for size, index in zip(sizes, free, strict=True):
        one = found[effects[own.owner[index]].name][own.names[index]]
        assert one.u == pytest.approx(size * own.scale[index])
    assert any(own.scale[index] != 1.0 for index in free)
    assert found["conversion_gain_error"][own.names[held]].u is None


def test_a_misfit_only_ever_widens(monkeypatch: pytest.MonkeyPatch) -> None:
    """Variances 4 and 9 that the misfit puts at 1 and 36: the first stays, the second is 36, their correlation too."""
    right = np.array([[4.0, 3.0], [3.0, 9.0]])
    monkeypatch.setattr(covariance, "_of_a_model_that_is_right", lambda _: right)
    monkeypatch.setattr(covariance, "_by_misfit", lambda _: np.array([1.0, 36.0]))
    for misfit, expected in ((True, [[4.0, 6.0], [6.0, 36.0]]), (False, right)):
        monkeypatch.setattr(covariance, "is_misfit", lambda _, misfit=misfit: misfit)
        state: Any = SimpleNamespace()
        assert covariance.effect_covariance(state) == pytest.approx(np.array(expected))


def test_what_agrees_too_well_makes_no_parameter_surer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pulls of 2 on a statistic 9 times too rough and of 3 on one 9 times too smooth, and 1 of a prior: 4·9 + 9 + 1."""
    monkeypatch.setattr(covariance, "_pulls", lambda *_: np.array([[2.0], [3.0], [1.0]]))
    monkeypatch.setattr(covariance, "_groupings", lambda _: ())
    comparison = SimpleNamespace(
        size=2, cuts={"mean": slice(0, 1), "variance": slice(1, 2)}, degrees=lambda _: 1, capture_of_rows=lambda: None
    )
    fit = SimpleNamespace(projected=np.array([3.0, 1.0 / 3.0, 5.0]))
    state: Any = SimpleNamespace(layout=SimpleNamespace(size=0), weights=np.zeros(0), comparison=comparison, fit=fit)
    assert covariance._by_misfit(state) == pytest.approx([4.0 * 9.0 + 9.0 + 1.0])


def test_a_prior_is_an_observation_that_the_parameter_is_nothing() -> None:
    """Residual 0 − 6 over 2, and its derivative with the sign turned 1/2; without a stated size neither."""
    prior = np.array([2.0, np.inf])
    assert prior_residual(prior, np.array([6.0, 5.0])).tolist() == [-3.0, 0.0]
    assert inverse(prior).tolist() == [0.5, 0.0]


@pytest.mark.parametrize("freedom", [5.0, 20.0])
def test_logarithms_of_variances_are_right_on_average(freedom: float) -> None:
    """ln χ²/ν lies below 0 by some 1/ν; what is compared has a mean of 0 within four of its standard deviations."""
    rng = np.random.default_rng(4)
    values = rng.chisquare(freedom, 40_000) / freedom
    mask = np.ones(values.size, bool)
    seen = SimpleNamespace(
        **dict.fromkeys(_LOGARITHMS, values), **{f"{name}_dof": np.full(values.size, freedom) for name in _LOGARITHMS}
    )
    comparison = SimpleNamespace(usable=dict.fromkeys(_LOGARITHMS, mask), seen=seen)
    for found in Comparison._log_seen.func(comparison).values():  # type: ignore[attr-defined]
        sigma = float(found.std()) / np.sqrt(found.size)
        assert abs(float(found.mean())) < 4.0 * sigma
        assert abs(float(np.log(values).mean())) > 15.0 * sigma


def test_a_rest_tells_the_gap_before_its_first_and_after_its_last_term(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two terms that took up 1.9 to 1.4 and 1.4 to 1.1: from 1.9 to 1.1, whatever the state says now."""
    from radiometer.reconciliation import verdict
    from radiometer.reconciliation.search.outcome import Step

    monkeypatch.setattr(verdict, "with_other_functional_form", lambda _: ())
    monkeypatch.setattr(verdict, "insignificant_names", lambda _: [])
    monkeypatch.setattr(verdict, "size_of_rest", lambda *_: {})
    steps = [
        Step("unnamed", "frame", 50.0, 1.9, 1.4, (), block="mean"),
        Step("unnamed", "exposure_s", 30.0, 1.4, 1.1, (), block="mean"),
    ]
    outcome: Any = SimpleNamespace(state=SimpleNamespace(gap=7.0), steps=steps, left=())
    rest = rest_of(outcome)
    assert rest is not None
    assert (rest.gap_before, rest.gap_after, rest.gain_nats, rest.where) == (1.9, 1.1, 80.0, "frame")

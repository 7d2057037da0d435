"""Probabilities of names follow from what fitted models predict of held-out settings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.reconciliation.fit.state import ModelFit
from radiometer.reconciliation.result import FoundEffect
from radiometer.reconciliation.verdict import UNNAMED, posterior, pseudo_bma
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.crosstalk import Crosstalk

CATALOGUE = ("black_level_offset", "crosstalk")
SETTINGS = 200
OFFSET, CROSSTALK = BlackLevelOffset(offset_dn=1.0), Crosstalk(share=0.01)


def _fit(
    *effects: CatalogueEffect, nats: float = 0.0, curves: int = 0, u: dict[tuple[str, str], float] | None = None
) -> ModelFit:
    """Return a model that is so many nats better than others, spread evenly over all settings."""
    density = np.full(SETTINGS, nats / SETTINGS)
    return ModelFit(effects, curves, density, len(effects) + curves, 1.0, u or {})


def test_two_names_that_predict_alike_share_the_probability() -> None:
    """Neither is more than possible, and one of the two is almost certain."""
    found = posterior([_fit(), _fit(OFFSET, nats=100.0), _fit(CROSSTALK, nats=100.0)], CATALOGUE)
    assert found.probability("black_level_offset") == pytest.approx(0.5, abs=1e-3)
    assert found.probability("crosstalk") == pytest.approx(0.5, abs=1e-3)
    assert sum(model.weight for model in found.models) == pytest.approx(1.0)


def test_one_setting_gives_no_certainty_and_many_do() -> None:
    """Where one setting holds all Δ nats, the other model keeps ∫ e^−x/(1 + e^Δx) dx, near ln 2/Δ; else nothing."""
    nats = 40.0
    alone, spread = np.zeros((2, SETTINGS)), np.zeros((2, SETTINGS))
    alone[1, 0], spread[1] = nats, nats / SETTINGS
    assert pseudo_bma(alone, np.zeros(2))[0] == pytest.approx(math.log(2.0) / nats, rel=0.5)
    assert pseudo_bma(spread, np.zeros(2))[0] < 1e-6


def test_what_no_entry_explains_has_no_name() -> None:
    """A curve, or an effect that is no entry of the catalogue, counts as unnamed."""
    found = posterior([_fit(), _fit(nats=300.0, curves=3), _fit(CROSSTALK, nats=200.0)], CATALOGUE)
    assert found.models[0].names == (UNNAMED,)
    assert posterior([_fit(CROSSTALK)], ("black_level_offset",)).models[0].names == (UNNAMED,)


def test_a_name_must_pay_for_its_parameter_and_the_entries_that_might_have_fitted() -> None:
    """Three nats for a parameter and ln 2 for two entries: at 3 + ln 2 nats it is as likely as nothing."""
    found = posterior([_fit(), _fit(OFFSET, nats=3.0 + math.log(2.0))], CATALOGUE)
    assert found.probability("black_level_offset") == pytest.approx(0.5, abs=0.01)


def test_uncertainties_contain_the_choice_among_models() -> None:
    """Two models of equal weight with 1 ± 0.3 and 2 ± 0.4: 1.5 ± √((0.09 + 0.16)/2 + 0.25)."""
    key = ("black_level_offset", "offset_dn")
    one = _fit(OFFSET, nats=100.0, u={key: 0.3})
    both = (BlackLevelOffset(offset_dn=2.0), CROSSTALK)
    other = ModelFit(both, 0, np.full(SETTINGS, (103.0 + math.log(2.0)) / SETTINGS), 2, 1.0, {key: 0.4})
    found = posterior([_fit(), one, other], CATALOGUE).averaged("black_level_offset")["offset_dn"]
    assert (found.value, found.u) == (pytest.approx(1.5, abs=0.01), pytest.approx(math.sqrt(0.125 + 0.25), rel=0.01))


@pytest.mark.parametrize(
    ("probability", "words"),
    [
        (1.0, "probability above 0.999, almost certain"),
        (0.95, "probability 0.950, almost certain"),
        (0.7, "probability 0.700, likely"),
        (0.331, "probability 0.331, possible"),
        (None, "12 nats"),
    ],
)
def test_people_read_a_probability_with_a_word(probability: float | None, words: str) -> None:
    """Almost certain from 0.95, likely from two thirds; photographs and logs, which compare no models, give nats.

    Beside a name that these data cannot separate from it none is certain.
    """
    found = FoundEffect("crosstalk", {}, "signal", 1.2, 1.0, gain_nats=12.0, probability=probability)
    assert found.evidence == words
    assert replace(found, alternatives=("ghost",)).evidence == words.replace("almost certain", "likely")


@given(st.lists(st.floats(-50.0, 50.0), min_size=2, max_size=6))
def test_weights_are_probabilities_in_the_order_of_what_models_predict(nats: list[float]) -> None:
    """They sum to 1; of models that differ evenly over the settings the better one never weighs less."""
    weights = pseudo_bma(np.array(nats)[:, None] * np.full(SETTINGS, 1.0 / SETTINGS), np.zeros(len(nats)))
    assert float(weights.sum()) == pytest.approx(1.0)
    assert np.all(np.diff(weights[np.argsort(nats, kind="stable")]) >= -1e-12)

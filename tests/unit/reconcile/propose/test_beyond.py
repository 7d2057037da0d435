"""Names are held to laws of no entry: on both sides of what they must bring, and on a session that hides a glow."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks._outside import two
from benchmarks._outside.two_hidden import HIDDEN
from radiometer.reconcile.propose import beyond
from radiometer.reconcile.propose.beyond import brings_most, held_to_laws, own_covariates, predicts_better
from radiometer.reconcile.result import Verdict
from radiometer.reconcile.search.outcome import Search, Step
from simulators.effects.conversion_gain_error import ConversionGainError
from simulators.effects.crosstalk import Crosstalk
from simulators.effects.free_law import freed
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.psf_blur import PsfBlur

BLUR, TALK, GAIN = PsfBlur(0.3), Crosstalk(0.01), ConversionGainError(0.01)


@dataclass(frozen=True)
class FakeState:
    """A stand-in for a fitted state: its score is its evidence, for it has no parameters."""

    evidence: float
    effects: tuple[Any, ...] = ()
    gap: float = 1.0
    terms: tuple[Any, ...] = ()
    parameters: Any = field(default_factory=lambda: SimpleNamespace(size=0))
    settings: int = 10
    held_out: Any = field(default_factory=lambda: SimpleNamespace(count=np.full(11, 1000.0)))


def outcome(nats: float, *effects: Any, gap: float = 1.0) -> Search:
    """Return a search that came to these effects, and to so many nats beyond its start."""
    steps = tuple(Step(effect.name, effect.where, nats / len(effects), 9.0, gap) for effect in effects)
    return Search(FakeState(nats, effects, gap), FakeState(0.0, gap=9.0), steps, (), (), ())  # type: ignore[arg-type]


def law(nats: float, *along: str) -> Any:
    told = SimpleNamespace(covariates=along)
    return SimpleNamespace(name="a_law", law=told, nats=nats, after=FakeState(nats, gap=1.0))


@pytest.mark.parametrize(("found", "better"), [(991.0, True), (993.0, False), (1100.0, False)])
def test_a_law_needs_the_odds_of_a_name(found, better):
    """Eight nats, odds of 3000: that is what any name has to bring."""
    assert predicts_better(outcome(found, BLUR), law(1000.0, "image_y")) is better


@pytest.mark.parametrize(
    ("found", "gap", "effects", "along", "stands"),
    [
        (790.0, 1.0, (GAIN,), "image_y", False),  # most is four fifths
        (810.0, 1.0, (GAIN,), "image_y", True),
        (810.0, 2.0, (GAIN,), "image_y", False),  # it leaves structure that the law does not
        (810.0, 2.0, (GAIN,), GAIN.where, True),  # but the law is its own by another equation
        (790.0, 2.0, (GAIN,), GAIN.where, False),
        (810.0, 2.0, (BLUR, GAIN), GAIN.where, False),  # of two names none has the law for its own
        (810.0, 1.0, (BLUR, GAIN), "image_y", True),
    ],
)
def test_names_stand_by_what_they_bring_and_leave(found, gap, effects, along, stands):
    """Names that bring most of what a law does stand where they leave nothing, or where the law is their own."""
    assert brings_most(outcome(found, *effects, gap=gap), law(1000.0, along)) is stands


def test_the_law_is_told_and_the_names_are_not(monkeypatch):
    """All names give way to one entry at the law's place; the nearest of them and its share are told."""
    monkeypatch.setattr(beyond, "propose_law", lambda start, along=(): law(1000.0, "image_y", "exposure_s"))
    told = held_to_laws(outcome(600.0, TALK, GAIN, gap=3.0))
    (step,) = told.steps
    assert told.state is told.start
    assert (step.name, step.where, step.closest) == ("unnamed", "image_y", ("crosstalk", 0.3))
    assert "a_law" in told.remarks[0]
    assert "crosstalk and conversion_gain_error" in told.remarks[0]


def test_a_single_name_that_leaves_nothing_is_asked_about_its_own_covariate(monkeypatch):
    """Only laws along it are looked at; where one predicts better the name stays with a remark, if it brings most."""
    asked = []
    monkeypatch.setattr(beyond, "doubts_of", lambda outcome: [])
    monkeypatch.setattr(beyond, "propose_law", lambda start, along=(): asked.append(along) or law(1000.0, *along))
    before = outcome(810.0, BLUR)
    told = held_to_laws(before)
    assert asked == [own_covariates(BLUR.where)]
    assert told.state.effects == (BLUR,)
    assert told.steps == before.steps
    assert len(told.remarks) == 1
    assert held_to_laws(outcome(995.0, BLUR)).remarks == ()
    assert [step.name for step in held_to_laws(outcome(790.0, BLUR)).steps] == ["unnamed"]


@pytest.mark.parametrize(("nats", "doubted"), [(804.0, False), (806.0, True), (812.0, True)])
def test_a_name_that_was_bent_is_doubted_where_a_law_predicts_as_well(monkeypatch, nats, doubted):
    """Within five nats, the odds of a rival, of an effect by a law of its own; one by its equation needs eight more."""
    monkeypatch.setattr(beyond, "doubts_of", lambda outcome: [])
    monkeypatch.setattr(beyond, "propose_law", lambda start, along=(): law(nats, "source_level"))
    droop = LedThermalDroop(0.05)
    bent = freed(LedThermalDroop, ("source_level",))(0.05, law=(1.0, 2.0), at_source_level=(0.1, 1.0))
    told = held_to_laws(outcome(810.0, bent))
    assert told.steps[0].name == "led_thermal_droop"
    assert bool(told.remarks) is doubted
    assert held_to_laws(outcome(810.0, droop)).remarks == ()


@pytest.mark.parametrize(
    ("where", "along"),
    [
        ("source_level", ("source_level",)),
        ("signal", ("signal", "value")),
        *((where, ("image_x", "image_y")) for where in ("image_x", "image_y", "screen_x", "field_radius")),
    ],
)
def test_the_covariates_of_laws_for_what_an_entry_goes_with(where, along):
    """The charge and what the amplifier makes of it are one; a radius or a place of the screen is of the picture."""
    assert own_covariates(where) == along


def test_without_a_name_no_law_is_asked(monkeypatch):
    """What has no name needs none taken away."""
    monkeypatch.setattr(beyond, "propose_law", lambda *asked: pytest.fail("asked"))
    empty = Search(FakeState(0.0), FakeState(0.0), (), (), (), ())  # type: ignore[arg-type]
    assert held_to_laws(empty) is empty


@pytest.mark.slow
def test_the_glow_of_an_amplifier_is_no_dark_current(tmp_path):
    """A Gaussian from a corner in proportion to the exposure: dark current explains a tenth of it and is not named."""
    from radiometer.reconcile.engine import reconcile_capture

    session = two.make(11, HIDDEN["corner_glow"], "darks")
    result = reconcile_capture(session.write(tmp_path / "set")).result
    assert result.verdict is Verdict.UNNAMED
    assert [effect.name for effect in result.effects] == ["unnamed"]
    assert result.effects[0].where in {"image_x", "image_y"}
    assert any("charge_rate_spot" in line for line in result.assumptions)

"""Names are held to laws of no entry: on both sides of what they must bring, and on a session that hides a glow."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
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
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.display_nonuniformity import DisplayNonuniformity
from simulators.effects.free_law import freed
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.mechanical_vignetting import MechanicalVignetting
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.psf_blur import PsfBlur
from simulators.effects.response_nonlinearity import ResponseNonlinearity

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
    model: Any = field(default_factory=lambda: SimpleNamespace(context=None))
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
    assert asked == [own_covariates(BLUR)]
    assert told.state.effects == (BLUR,)
    assert told.steps == before.steps
    assert len(told.remarks) == 1
    assert held_to_laws(outcome(995.0, BLUR)).remarks == ()
    assert [step.name for step in held_to_laws(outcome(790.0, BLUR)).steps] == ["unnamed"]


@pytest.mark.parametrize(
    ("nats", "plain", "told"),
    [
        (804.0, 300.0, "named"),  # a law that lies behind by more than a rival may
        (806.0, 700.0, "doubted"),
        (806.0, 600.0, "unnamed"),  # its own equation brings three quarters of what the law does
        (812.0, 700.0, "doubted"),
        (900.0, 700.0, "unnamed"),  # the more a law brings, the more the equation must
    ],
)
def test_a_name_that_was_bent_is_held_by_its_own_equation_to_a_law_that_predicts_as_well(
    monkeypatch, nats, plain, told
):
    """Within five nats, the odds of a rival; a table follows any law, and what it brings says nothing of a name."""
    fitted = []
    monkeypatch.setattr(beyond, "doubts_of", lambda outcome: [])
    monkeypatch.setattr(beyond, "propose_law", lambda start, along=(): law(nats, "source_level"))
    monkeypatch.setattr(
        beyond, "included", lambda state, effect, far: fitted.append(effect) or FakeState(plain, (effect,))
    )
    table = LedThermalDroop(0.05, levels=(0.1, 1.0), errors_rel=(0.01, 0.0))
    free = freed(LedThermalDroop, ("source_level",))(0.05, law=(1.0, 2.0), at_source_level=(0.1, 1.0))
    for bent in (table, free):
        found = held_to_laws(outcome(810.0, bent))
        assert found.steps[0].name == ("unnamed" if told == "unnamed" else "led_thermal_droop")
        assert bool(found.remarks) is (told != "named")
    assert {(e.droop_rel, e.levels, type(e)) for e in fitted} <= {(0.05, (), LedThermalDroop)}
    assert held_to_laws(outcome(nats + 1.0, LedThermalDroop(0.05))).remarks == ()


def test_curves_without_a_cause_are_not_counted_to_a_name(monkeypatch):
    """What smooth terms take up beside a name is not what the name brings."""
    monkeypatch.setattr(beyond, "included", lambda state, effect, far: FakeState(500.0, (effect,)))
    curve = SimpleNamespace(is_smooth=True, size=0)
    found = outcome(990.0, GAIN)
    found = replace(found, state=replace(found.state, terms=(curve,)))
    assert not brings_most(found, law(1000.0, GAIN.where))
    assert brings_most(outcome(990.0, GAIN), law(1000.0, GAIN.where))


@pytest.mark.parametrize(
    ("effect", "along"),
    [
        (LedThermalDroop(), {"source_level"}),
        (ResponseNonlinearity(), {"signal", "value"}),
        (DarkCurrent(), {"temperature_C"}),  # what is not in proportion to the exposure is no current
        *((kind(), {"image_x", "image_y"}) for kind in (DisplayNonuniformity, NaturalVignetting)),
        (MechanicalVignetting(), {"image_x", "image_y", "f_number"}),
    ],
)
def test_the_covariates_of_laws_for_what_an_entry_goes_with(effect, along):
    """The charge and what the amplifier makes of it are one; a radius or a place of the screen is of the picture."""
    assert set(own_covariates(effect)) == along


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

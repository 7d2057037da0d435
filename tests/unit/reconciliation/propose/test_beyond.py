"""Names are held to laws of no entry: on both sides of what they must bring, and on a session that hides a glow."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.fit.covariance import fitted_parameters
from radiometer.reconciliation.fit.descent import first_state, refit
from radiometer.reconciliation.fit.state import with_effects
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import frame_reader, reduce_frames
from radiometer.reconciliation.propose import beyond
from radiometer.reconciliation.propose.beyond import (
    brings_most,
    held_to_laws,
    in_a_looser_form,
    own_covariates,
    predicts_better,
)
from radiometer.reconciliation.result import Verdict
from radiometer.reconciliation.search import free_laws
from radiometer.reconciliation.search.free_forms import worth
from radiometer.reconciliation.search.free_laws import in_place_of_all
from radiometer.reconciliation.search.outcome import Search, Step
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.conversion_gain_error import ConversionGainError
from simulators.effects.crosstalk import Crosstalk
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.display_nonuniformity import DisplayNonuniformity
from simulators.effects.dsnu import Dsnu
from simulators.effects.free_law import freed
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.mechanical_vignetting import MechanicalVignetting
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.psf_blur import PsfBlur
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from testing.outside import two
from testing.outside.two_hidden import HIDDEN

BLUR, TALK, GAIN = PsfBlur(0.3), Crosstalk(0.01), ConversionGainError(0.01)

TABLE = LedThermalDroop(0.05, levels=(0.1, 1.0), errors_rel=(0.01, 0.0))
FREE = freed(LedThermalDroop, ("source_level",))(0.05, law=(1.0, 2.0), at_source_level=(0.1, 1.0))


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
    prediction: Any = None
    comparison: Any = field(
        default_factory=lambda: SimpleNamespace(residual=lambda prediction: np.zeros(1), counts=lambda: np.ones(1))
    )
    held_out: Any = field(default_factory=lambda: SimpleNamespace(count=np.full(11, 1000.0)))


def outcome(nats: float, *effects: Any, gap: float = 1.0) -> Search:
    """Return a search that came to these effects, and to so many nats beyond its start."""
    steps = tuple(Step(effect.name, effect.where, nats / len(effects), 9.0, gap) for effect in effects)
    return Search(FakeState(nats, effects, gap), FakeState(0.0, gap=9.0), steps, (), (), ())  # type: ignore[arg-type]


def law(nats: float, *along: str) -> Any:
    told = SimpleNamespace(covariates=along, where=along[0] if along else "signal")
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


@pytest.mark.parametrize("itself", [True, False])
def test_a_name_that_acts_as_other_causes_would_does_not_stand_against_a_better_law(monkeypatch, itself):
    """What anything else would do as well is no evidence of its name, whatever it brings along its own covariate."""
    monkeypatch.setattr(ConversionGainError, "unlike_itself", lambda self, context: not itself)
    assert brings_most(outcome(990.0, GAIN), law(1000.0, GAIN.where)) is itself


def test_the_law_is_told_and_the_names_are_not(monkeypatch):
    """All names give way to one entry at the law's place; the nearest of them and its share are told."""
    monkeypatch.setattr(beyond, "propose_law", lambda start, along=(), most=0.0: law(1000.0, "image_y", "exposure_s"))
    told = held_to_laws(outcome(600.0, TALK, GAIN, gap=3.0), {})
    (step,) = told.steps
    assert told.state is told.start
    assert (step.name, step.where, step.closest) == ("unnamed", "image_y", ("crosstalk", 0.3))
    assert "a_law" in told.remarks[0]
    assert "crosstalk and conversion_gain_error" in told.remarks[0]


def test_a_single_name_that_leaves_nothing_is_asked_about_its_own_covariate(monkeypatch):
    """Only laws along it are looked at; where one predicts better the name stays with a remark, if it brings most."""
    asked = []
    monkeypatch.setattr(beyond, "doubts_of", lambda outcome: [])

    def proposed(start, along=(), most=0.0):
        asked.append(along)
        return law(1000.0, *along)

    monkeypatch.setattr(beyond, "propose_law", proposed)
    before = outcome(810.0, BLUR)
    told = held_to_laws(before, {})
    assert asked == [own_covariates(BLUR)]
    assert told.state.effects == (BLUR,)
    assert told.steps == before.steps
    assert len(told.remarks) == 1
    assert held_to_laws(outcome(995.0, BLUR), {}).remarks == ()
    assert [step.name for step in held_to_laws(outcome(790.0, BLUR), {}).steps] == ["unnamed"]


@pytest.mark.parametrize(("nats", "doubted"), [(804.0, False), (806.0, True), (812.0, True)])
def test_a_name_that_was_bent_is_doubted_where_a_law_predicts_as_well(monkeypatch, nats, doubted):
    """Within five nats, the odds of a rival, of an effect by a law of its own; one by its equation needs eight more."""
    monkeypatch.setattr(beyond, "doubts_of", lambda outcome: [])
    monkeypatch.setattr(beyond, "propose_law", lambda start, along=(), most=0.0: law(nats, "source_level"))
    for bent in (TABLE, FREE):
        told = held_to_laws(outcome(810.0, bent), {})
        assert told.steps[0].name == "led_thermal_droop"
        assert bool(told.remarks) is doubted
    assert held_to_laws(outcome(810.0, LedThermalDroop(0.05)), {}).remarks == ()


@pytest.mark.parametrize(("plain", "stands"), [(730.0, True), (710.0, False)])
@pytest.mark.parametrize("bent", [TABLE, FREE])
def test_a_name_that_was_bent_brings_what_its_own_equation_brings(monkeypatch, bent, plain, stands):
    """A table follows any law: that it brings most of what a better law does says nothing of the name."""
    fitted = []

    def included(state, effect, far):
        fitted.append(effect)
        return FakeState(plain, (effect,))

    monkeypatch.setattr(beyond, "doubts_of", lambda outcome: [])
    monkeypatch.setattr(beyond, "propose_law", lambda start, along=(), most=0.0: law(900.0, "source_level"))
    monkeypatch.setattr(beyond, "included", included)
    told = held_to_laws(outcome(880.0, bent), {})
    assert [step.name for step in told.steps] == ["led_thermal_droop" if stands else "unnamed"]
    assert [(effect.droop_rel, effect.levels) for effect in fitted] == [(0.05, ())]


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
    assert held_to_laws(empty, {}) is empty


def ramp(make_capture):
    """Return the starting camera fitted to darks whose black level rises by 2 DN over the rows, −1 to 1 DN."""
    rows = np.arange(64.0)[:, None]
    plan = [{"t": t, "g": g, "shutter": "closed"} for t in (1e-4, 1e-2) for g in (0.0, 12.0)] * 2
    captured = make_capture(6, extra_dn=lambda setting: 2.0 * (rows / 63.0 - 0.5), plan=plan)
    design = Design.of(captured.header, captured.frames[0].shape)
    return first_state(design, *reduce_frames(design, frame_reader(captured.frames)))


def test_a_ramp_that_is_nothing_in_the_middle_is_an_offset_s_looser_form(make_capture):
    """A black level that rises over the rows, −1 to 1 DN, has no plain part: its tilt is met by itself."""
    start = ramp(make_capture)
    entries = {"dark_current": DarkCurrent, "black_level_offset": BlackLevelOffset}
    found = in_a_looser_form(start, worth(start), entries)
    told = fitted_parameters(found)["black_level_offset"]
    per_half_side = 2.0 * 48.0 / 63.0  # the longer side has 96 pixels
    for name, value in (("offset_dn", 0.0), ("tilt_x_dn", 0.0), ("tilt_y_dn", per_half_side)):
        assert told[name].u is not None
        assert abs(told[name].value - value) < 3.5 * told[name].u
    assert in_a_looser_form(start, worth(found) + 1.0, entries) is None
    assert in_a_looser_form(start, worth(start), {"dark_current": DarkCurrent}) is None
    left = float(start.comparison.residual(found.prediction) @ start.comparison.residual(found.prediction))
    assert in_a_looser_form(start, worth(start), entries, most=left - 50.0) is None
    assert in_a_looser_form(start, worth(start), entries, most=left + 50.0) is not None


def test_of_models_that_predict_as_well_the_one_of_a_single_cause_is_told(make_capture):
    """A ramp stands in place of two names that do not explain it, of the ramp beside an idle name, and of no single
    name."""
    start, entries = ramp(make_capture), {"black_level_offset": BlackLevelOffset}
    tilted = in_a_looser_form(start, worth(start), entries)
    one, idle = refit(with_effects(start, [DarkCurrent(2.0)])), Dsnu(0.01)
    for several in ([DarkCurrent(2.0), idle], [idle, *tilted.effects]):
        found = in_place_of_all(start, refit(with_effects(start, several)), entries)
        assert [effect.name for effect in found.effects] == ["black_level_offset"]
        assert found.evidence == pytest.approx(tilted.evidence)
    assert in_place_of_all(start, one, entries) is None
    assert in_place_of_all(start, start, entries) is None


@pytest.mark.parametrize(("odds", "taken"), [(0.0, True), (-1e9, False)])
def test_a_single_cause_needs_the_odds_of_its_name(make_capture, monkeypatch, odds, taken):
    """An entry that is not expected beforehand pays for it against several names."""
    start, entries = ramp(make_capture), {"black_level_offset": BlackLevelOffset}
    monkeypatch.setattr(BlackLevelOffset, "log_prior_odds", odds)
    several = refit(with_effects(start, [DarkCurrent(2.0), Dsnu(0.01)]))
    assert (in_place_of_all(start, several, entries) is not None) is taken


def test_an_entry_that_does_what_the_law_does_stands_in_place_of_the_names(monkeypatch):
    """One name, provisional, with what it brings and what it leaves; the names that brought too little are gone."""
    form = FakeState(996.0, (BLUR,))
    monkeypatch.setattr(beyond, "propose_law", lambda start, along=(), most=0.0: law(1000.0, "image_y"))
    monkeypatch.setattr(
        beyond, "in_a_looser_form", lambda start, least, catalogue, most: form if least < 996.0 else None
    )
    monkeypatch.setattr(beyond, "localise", lambda state: ())
    told = held_to_laws(outcome(600.0, TALK, GAIN, gap=3.0), {})
    assert [(step.name, step.gain_nats) for step in told.steps] == [("psf_blur", 996.0)]
    assert told.state is form
    assert len(told.remarks) == 1


@pytest.mark.slow
def test_the_glow_of_an_amplifier_is_no_dark_current(tmp_path):
    """A Gaussian from a corner in proportion to the exposure: dark current explains a tenth of it and is not named."""
    from radiometer.reconciliation.engine import reconcile_capture

    session = two.make(11, HIDDEN["corner_glow"], "darks")
    result = reconcile_capture(session.write(tmp_path / "set")).result
    assert result.verdict is Verdict.UNNAMED
    assert [effect.name for effect in result.effects] == ["unnamed"]
    assert result.effects[0].where in {"image_x", "image_y"}
    assert any("charge_rate_spot" in line for line in result.assumptions)


@dataclass(frozen=True)
class Loose:
    """A form of an entry that can be made looser as often as it has further scores."""

    scores: tuple[float, ...]
    name: str = "loose"
    log_prior_odds: float = 0.0

    def free(self) -> tuple[str, ...]:
        return ()

    def loosened(self, context: Any) -> tuple[Any, ...]:
        return (Loose(self.scores[1:]),) if len(self.scores) > 1 else ()


@pytest.mark.parametrize(
    ("scores", "best"), [((0.0, 30.0), 30.0), ((0.0, 30.0, 20.0), 30.0), ((0.0, 30.0, 40.0), 40.0), ((0.0, 4.0), None)]
)
def test_a_form_that_is_looser_still_counts_where_it_does_better(monkeypatch, scores, best):
    """Of forms that are ever looser the one that predicts best is told, were it not the last; more than 5 are asked."""
    monkeypatch.setattr(free_laws, "promise", lambda start, form: 1.0)
    monkeypatch.setattr(free_laws, "_alone", lambda start, form, most: FakeState(form.scores[0], (form,)))
    entry = SimpleNamespace(usable=lambda context: True, starts=lambda context: (Loose(scores),))
    found = in_a_looser_form(FakeState(0.0), 5.0, {"loose": entry})  # type: ignore[arg-type,dict-item]
    assert (None if found is None else found.evidence) == best

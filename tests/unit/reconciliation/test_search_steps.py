"""What a search writes down of its steps: names that come, take another's place, become looser or go."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.fit.candidate_fit import Candidate
from radiometer.reconciliation.search import localise, moves, screening, search
from radiometer.reconciliation.search.outcome import Search, Step
from radiometer.reconciliation.search.rivals import _is_rival
from radiometer.reconciliation.thresholds import FLEXIBLE_NATS, NAMED_NATS, OWN_LAW_NATS, PARAMETER_NATS, RIVAL_NATS
from simulators.effects.exposure_time_offset import ExposureTimeOffset


def state(evidence: float, gap: float, **more: Any) -> Any:
    return SimpleNamespace(evidence=evidence, gap=gap, effects=(), **more)


def effect(name: str, where: str = "exposure", **more: Any) -> Any:
    return SimpleNamespace(name=name, where=where, **more)


def run(*steps: Step) -> tuple[Any, list[str]]:
    said: list[str] = []
    return search._Run({}, said.append, list(steps)), said


VEIL = Step("veil", "level", 30.0, 9.0, 5.0)
CLOCK = Step("clock", "exposure", 20.0, 5.0, 3.0)
CURVE = Step("unnamed", "temperature", 7.0, 3.0, 2.0)


def test_one_law_in_place_of_all_is_one_step_from_the_start(monkeypatch):
    """Its nats are those from the ideal camera on, its gap goes from that camera's to its own."""
    made = SimpleNamespace(evidence=170.0, gap=1.25, effects=(effect("bend", "signal"),))
    monkeypatch.setattr(search, "in_place_of_all", lambda *_: made)
    book, said = run(VEIL, CLOCK)
    assert search._as_one(state(100.0, 9.0), state(150.0, 3.0), (), book) is made
    assert book.steps == [Step("bend", "signal", 70.0, 9.0, 1.25)]
    assert said == ["bend in a looser form in place of all: gap 3.000 → 1.250"]
    monkeypatch.setattr(search, "in_place_of_all", lambda *_: None)
    assert search._as_one(state(100.0, 9.0), made, (), book) is None
    assert book.steps[0].name == "bend"


def test_a_looser_form_adds_to_its_own_step():
    """The step keeps its place and what it began with."""
    book, said = run(VEIL, CLOCK)
    looser = SimpleNamespace(name="clock", nats=6.5, state=state(0.0, 1.5))
    assert search._taken(state(0.0, 3.0), looser, book) is looser.state
    assert book.steps == [VEIL, Step("clock", "exposure", 26.5, 5.0, 1.5)]
    assert said == ["clock in a more flexible form: 6.5 nats, gap 3.000 → 1.500"]


def test_one_entry_in_place_of_two_stands_where_the_first_stood():
    """Its nats are theirs and what it predicts better; its gap goes from before the first to its own."""
    book, said = run(VEIL, CURVE, CLOCK)
    changed = state(205.0, 2.5)
    assert search._in_place(state(200.0, 3.0), (changed, effect("glare", "field")), ("clock", "veil"), book) is changed
    assert book.steps == [Step("glare", "field", 55.0, 9.0, 2.5), CURVE]
    assert said == ["glare in place of clock and veil: gap 3.000 → 2.500"]


@pytest.mark.parametrize(
    ("name", "left"),
    [("veil", [CLOCK, CURVE]), ("variance | temperature", [VEIL, CLOCK]), ("variance | exposure", [VEIL, CLOCK, CURVE]),
     ("unnamed", [VEIL, CLOCK])],
)  # fmt: skip
def test_what_was_dropped_is_forgotten_and_not_tried_again(name, left):
    """An effect by its name, a curve by the covariate it lies along."""
    book, _ = run(VEIL, CLOCK, CURVE)
    search._forget(book, name)
    assert book.steps == left
    assert book.refused == {name}


def test_a_name_that_leaves_structure_is_exchanged_and_refused(monkeypatch):
    """The first that another predicts better than; a single name has nobody to make room for."""
    changed, other = state(120.0, 1.1), effect("glare")
    monkeypatch.setattr(search, "departing", lambda tests, effects: ("veil", "clock"))
    monkeypatch.setattr(search, "better", lambda now, name, *_: (changed, other) if name == "clock" else None)
    book, _ = run(VEIL, CLOCK)
    now = SimpleNamespace(evidence=100.0, gap=3.0, effects=(effect("veil"), effect("clock")))
    assert search._exchanged(now, (), book) is changed
    assert book.refused == {"clock"}
    assert book.steps == [VEIL, Step("glare", "exposure", 40.0, 5.0, 1.1)]
    book, _ = run(VEIL)
    assert search._exchanged(SimpleNamespace(effects=(effect("veil"),)), (), book) is None
    assert book.steps == [VEIL]


@pytest.mark.parametrize(
    ("nats", "further", "refitted", "likelier"),
    [(100.0, 1, None, True), (20.0, 1, None, False), (52.0 + FLEXIBLE_NATS, 0, None, True),
     (48.0 + FLEXIBLE_NATS, 0, 47.0, True), (48.0 + FLEXIBLE_NATS, 0, 49.0, False),
     (49.0 + FLEXIBLE_NATS + PARAMETER_NATS, 1, 48.0, True)],
)  # fmt: skip
def test_a_form_is_likelier_by_what_it_brings_less_its_parameters(monkeypatch, nats, further, refitted, likelier):
    """Against a further effect of 50 nats; where the two are near that effect's full fit decides."""
    monkeypatch.setattr(search, "score", lambda judged: judged[1])

    def included(*_: Any, far: bool) -> Any:
        assert refitted is not None
        assert not far
        return state(200.0 + refitted, 1.0)

    fits = SimpleNamespace(included=included, state=state(200.0, 3.0))
    looser = SimpleNamespace(promise=50.0, best=SimpleNamespace(nats=nats, further=further))
    chosen: Any = (SimpleNamespace(effect=effect("clock")), 50.0)
    assert search._is_likelier(fits, looser, chosen) is likelier  # type: ignore[arg-type]
    assert not search._is_likelier(fits, SimpleNamespace(promise=50.0, best=None), chosen)  # type: ignore[arg-type]


def test_a_form_that_promises_a_twentieth_of_a_name_is_not_fitted_for_it(monkeypatch):
    """A little more than that, and it is."""
    monkeypatch.setattr(search, "score", lambda judged: judged[1])
    asked: list[float] = []

    class Forms:
        def __init__(self, promise: float) -> None:
            self.promise = promise

        @property
        def best(self) -> None:
            asked.append(self.promise)

    chosen: Any = (SimpleNamespace(effect=effect("clock")), 1000.0)
    for promise in (49.0, 51.0):
        assert not search._is_likelier(None, Forms(promise), chosen)  # type: ignore[arg-type]
    assert asked == [51.0]


@pytest.mark.parametrize(
    ("name", "nats", "parameters", "columns", "rival"),
    [("veil", 50.0 - RIVAL_NATS + 0.1, 2, 2, True), ("veil", 50.0 - RIVAL_NATS - 0.1, 2, 2, False),
     ("clock", 60.0, 2, 2, False), ("veil", 50.0, 3, 2, False), ("veil", 50.0, 2, 1, True),
     ("veil", 50.0 - RIVAL_NATS + PARAMETER_NATS + 0.1, 3, 3, True),
     ("veil", 50.0 - RIVAL_NATS + PARAMETER_NATS - 0.1, 3, 3, False),
     ("veil", 50.0 - RIVAL_NATS + 0.1, 1, 1, True)],
)  # fmt: skip
def test_a_rival_predicts_about_as_well_for_its_parameters(name, nats, parameters, columns, rival):
    """Beside a chosen one of two parameters and 50 nats; fewer are no advantage, more on a bound no rival."""
    other: Any = SimpleNamespace(name=name, parameters=parameters, columns=np.zeros((9, columns)))
    chosen: Any = (SimpleNamespace(name="clock", parameters=2), 50.0)
    assert _is_rival(other, nats, chosen) is rival


def ways(monkeypatch: pytest.MonkeyPatch, ends: dict[str, float], leads: dict[str, float]) -> list[str]:
    """Let a search end at scores by the name it may not give first; return the list of what it bars, in order."""
    barred: list[str] = []

    def to_its_end(start, now, tests, book, barred_now=""):
        barred.append(barred_now)
        if not barred_now:
            book.turns += [search._Turn(now, (), name, lead, (VEIL,), frozenset()) for name, lead in leads.items()]
        else:
            assert book.steps == [VEIL]
            assert book.turns == []
        return Search(state(ends[barred_now], 2.0), start, (), (), (), ())

    monkeypatch.setattr(search, "_to_its_end", lambda *a, barred="": to_its_end(*a, barred))
    monkeypatch.setattr(search, "localise", lambda start: ("first tests",))
    monkeypatch.setattr(search, "rated", lambda end: end.evidence)
    return barred


LEADS = {"clock": 0.04, "veil": 0.001, "bend": 0.03}


def test_a_search_that_leaves_doubts_is_taken_up_where_another_entry_was_nearest(monkeypatch):
    """The two nearest turns are gone, the nearest first; the best of all ends is told, with the first tests."""
    barred = ways(monkeypatch, {"": 100.0, "veil": 120.0, "bend": 140.0, "clock": 900.0}, LEADS)
    found = search.search(state(0.0, 9.0), {}, is_doubted=lambda found: True)
    assert barred == ["", "veil", "bend"]
    assert found.state.evidence == 140.0
    assert found.first_tests == ("first tests",)


def test_another_way_is_taken_only_for_more_than_chance(monkeypatch):
    """An end that is better by less than a name by chance may be leaves the first as it is."""
    ways(monkeypatch, {"": 100.0, "veil": 100.0 + NAMED_NATS - 0.1, "bend": 100.0 + NAMED_NATS + 0.1}, LEADS)
    assert search.search(state(0.0, 9.0), {}, is_doubted=lambda found: True).state.evidence == 100.1 + NAMED_NATS
    ways(monkeypatch, {"": 100.0, "veil": 100.0 + NAMED_NATS - 0.1, "bend": 0.0}, LEADS)
    assert search.search(state(0.0, 9.0), {}, is_doubted=lambda found: True).state.evidence == 100.0


def test_no_other_way_is_gone_where_nothing_is_doubted(monkeypatch):
    """Neither from the start nor once an end leaves nothing."""
    barred = ways(monkeypatch, {"": 100.0, "veil": 120.0}, LEADS)
    assert search.search(state(0.0, 9.0), {}).state.evidence == 100.0
    assert barred == [""]
    barred = ways(monkeypatch, {"": 100.0, "veil": 120.0}, LEADS)
    assert (
        search.search(state(0.0, 9.0), {}, is_doubted=lambda found: found.state.evidence < 110.0).state.evidence
        == 120.0
    )
    assert barred == ["", "veil"]


def test_a_lead_is_over_the_next_of_the_same_statistic(monkeypatch):
    """In shares of the name's own score; who shows in another statistic is found later, whatever comes first."""
    monkeypatch.setattr(search, "score", lambda judged: judged[1])

    def entry(name: str, block: str, nats: float) -> Any:
        return SimpleNamespace(name=name, effect=SimpleNamespace(block=block)), nats

    chosen, *others = entry("well", "mean", 200.0), entry("veil", "mean", 150.0), entry("noise", "variance", 199.0)
    assert search._lead(chosen, [chosen, *others]) == pytest.approx(0.25)
    assert search._lead(chosen, [chosen, others[1]]) == np.inf
    assert search._lead(entry("well", "mean", -1.0), others) == np.inf


def test_the_looser_form_that_pays_best_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each further parameter costs its nats: 40 by one are better than 40 and half of that price by two."""
    forms: dict[str, Any] = {
        "dear": SimpleNamespace(name="dear", state="dear", nats=40.0 + 0.5 * PARAMETER_NATS, further=2),
        "fair": SimpleNamespace(name="fair", state="fair", nats=40.0, further=1),
        "poor": SimpleNamespace(name="poor", state="poor", nats=39.0, further=1),
    }
    for order in (["dear", "fair", "poor"], ["poor", "fair", "dear"]):
        monkeypatch.setattr(moves, "_promising", lambda state, only, order=order: [(50.0, 0, name) for name in order])
        monkeypatch.setattr(moves, "_fitted", lambda state, index, form: forms[form])
        looser = moves.LooserForms.of(SimpleNamespace())  # type: ignore[arg-type]
        assert looser.best is forms["fair"]
    monkeypatch.setattr(moves, "_fitted", lambda state, index, form: None)
    assert moves.LooserForms.of(SimpleNamespace()).best is None  # type: ignore[arg-type]


def test_forms_that_promise_less_than_a_name_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names in question need less; what the likeliest promises is told without a fit."""
    promised = [(NAMED_NATS - 0.1, 0, "faint"), (OWN_LAW_NATS + 0.1, 1, "fainter")]
    monkeypatch.setattr(moves, "_promising", lambda state, only: [*promised, *([(30.0, 2, "plain")] if only else [])])
    of_all = moves.LooserForms.of(SimpleNamespace())  # type: ignore[arg-type]
    assert of_all.promising == []
    assert of_all.promise == 0.0
    of_one = moves.LooserForms.of(SimpleNamespace(), ["clock"])  # type: ignore[arg-type]
    assert [form for _, _, form in of_one.promising] == ["plain", "faint"]
    assert of_one.promise == 30.0


def test_a_candidate_begins_where_it_came_to_before_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rigid and the flexible form of an entry each have their own."""
    asked: list[Any] = []

    def fitted(_: Any, candidate: Candidate) -> Any:
        asked.append(candidate.others)
        return SimpleNamespace(forms=(f"fitted {len(asked)}",))

    monkeypatch.setattr(search, "fit_candidate", fitted)
    book, _ = run()
    rigid = Candidate(effect("clock"), 9.0, 1, others=("scaled",))  # type: ignore[arg-type]
    for candidate in (rigid, rigid, replace(rigid, flexible=True)):
        search._fitted(SimpleNamespace(), candidate, book)  # type: ignore[arg-type]
    assert asked == [("scaled",), ("scaled", "fitted 1"), ("scaled",)]


def test_entries_far_behind_are_not_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once enough explain twice what the rest did; the rest come behind as they were, new entries first."""
    gains = {f"e{n:02d}": 1000.0 / (1 + n) for n in range(30)}
    kinds = {name: SimpleNamespace(name=name) for name in gains}
    asked: list[str] = []

    def looked_at(_: Any, some: Any, __: Any) -> list[Candidate]:
        asked.extend(kind.name for kind in some)
        return [Candidate(effect(kind.name), now[kind.name], 1) for kind in some]  # type: ignore[arg-type]

    monkeypatch.setattr(screening, "usable_catalogue", lambda state, catalogue: catalogue)
    monkeypatch.setattr(screening, "_screened", looked_at)

    def names(before: screening.Before, catalogue: Any) -> list[str]:
        asked.clear()
        found = screening.screen(None, catalogue, None, before)  # type: ignore[arg-type]
        return [candidate.effect.name for candidate in found]

    now = {name: 0.9 * gain for name, gain in gains.items()} | {"new": 1e-3}
    first = [Candidate(effect(name), gain, 1) for name, gain in gains.items()]  # type: ignore[arg-type]
    assert names(screening.Before(), kinds) == asked == list(gains)
    assert names(screening.Before(first, 5), kinds) == list(gains)
    assert asked == list(gains)[:12]  # the fifth explains 180 now, the thirteenth explained 76.9
    assert names(screening.Before(first, 6), kinds) == list(gains)
    assert asked == list(gains)[:24]  # the sixth explains 150, not twice 76.9
    assert names(screening.Before(first, 5), kinds | {"new": SimpleNamespace(name="new")})[-1] == "e29"
    assert asked == ["new", *list(gains)[:11]]
    assert names(screening.Before(first, 0), kinds) == list(gains)
    assert len(asked) == 30


def test_a_trend_is_taken_up_whatever_its_columns_length_and_without_those_of_none() -> None:
    """Columns of 5, 0 and 2 become two of length 1 in their statistic's rows, with nothing in the others."""
    taken: list[Any] = []
    state: Any = SimpleNamespace(
        comparison=SimpleNamespace(size=6, cuts={"variance": slice(2, 5)}), pad=lambda columns: columns
    )
    fit: Any = SimpleNamespace(followed=lambda columns: columns, extended=taken.append)
    columns = np.array([[3.0, 0.0, 0.0], [4.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
    localise._beside(state, fit, localise.Basis("variance", "exposure", "line", columns))
    expected = np.zeros((6, 2))
    expected[2:5] = [[0.6, 0.0], [0.8, 1.0], [0.0, 0.0]]
    np.testing.assert_allclose(taken[0], expected)


@pytest.mark.parametrize(("needed", "taken"), [(0.5, 0.5), (300.0, 300.0), (400.0, 300.0), (-2.0, 0.0)])
def test_a_start_is_made_up_to_three_hundred_times_larger(
    monkeypatch: pytest.MonkeyPatch, needed: float, taken: float
) -> None:
    """Along one change of length 2 the data ask for so many of it; what is promised is χ² less, 4·(2·a·n − a²)."""
    changed = np.array([[2.0], [0.0]])
    fit: Any = SimpleNamespace(
        followed_with_half=lambda changes: (changes, np.zeros_like(changes)), projected=np.array([2.0 * needed, 7.0])
    )
    state: Any = SimpleNamespace(comparison=SimpleNamespace(size=2), fit=fit)
    monkeypatch.setattr(screening, "changes_of", lambda *_: changed)
    (found,) = screening._rigid_batch(state, [ExposureTimeOffset(1e-6)])
    assert found.gain == pytest.approx(4.0 * (2.0 * taken * needed - taken**2))
    sizes = sorted(one.values()["offset_s"] for one in found.others)
    assert sizes == pytest.approx(sorted({1e-6 * taken, 1e-6 * taken**0.5} if taken else set()))

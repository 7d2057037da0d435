"""Refits that go on by derivatives of an earlier point: where they end, what they cost, and what needs none at all."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.fit import descent as fitting
from radiometer.reconciliation.fit.descent import first_state, refit
from radiometer.reconciliation.fit.nuisances import NuisanceLayout
from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import frame_reader, reduce_frames
from radiometer.reconciliation.search import moves
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.response_nonlinearity import ResponseNonlinearity

LADDER = [{"t": float(t), "d": d} for d in (0.9, 0.3) for t in np.geomspace(1e-4, 5e-3, 8)]


@pytest.fixture(scope="module")
def bent(make_capture: Callable[..., Any]) -> FitState:
    """A camera whose exposures last 5 µs longer than stated."""
    captured = make_capture(5, plan=[setting | {"t": setting["t"] + 5e-6} for setting in LADDER])
    stated = [f.model_copy(update={"exposure_s": f.exposure_s - 5e-6}) for f in captured.header.frames]
    header = captured.header.model_copy(update={"frames": tuple(stated)})
    design = Design.of(header, captured.frames[0].shape)
    return first_state(design, *reduce_frames(design, frame_reader(captured.frames)))


def test_old_derivatives_lead_to_the_same_least_squares(bent: FitState, monkeypatch: pytest.MonkeyPatch) -> None:
    """With and without steps by old derivatives a fit ends at one place; with them it takes fewer derivatives."""
    taken: list[int] = []
    real = NuisanceLayout.derivatives

    def counted(self: NuisanceLayout, *arguments: Any) -> Any:
        taken.append(1)
        return real(self, *arguments)

    monkeypatch.setattr(NuisanceLayout, "derivatives", counted)
    start = with_effects(bent, [ExposureTimeOffset(1e-6), ResponseNonlinearity(0.01)])
    gliding = refit(start)
    few = len(taken)
    monkeypatch.setattr(fitting, "_glided", lambda state, moved, gained: (moved, gained))
    plain = refit(with_effects(bent, [ExposureTimeOffset(1e-6), ResponseNonlinearity(0.01)]))
    assert few < len(taken) - few
    assert gliding.cost == pytest.approx(plain.cost, abs=2e-3)
    u = np.sqrt(np.diag(plain.fit.covariance))[-3:]
    moved = np.abs(gliding.parameters.values - plain.parameters.values) / plain.parameters.scale
    assert (moved < 0.03 * u).all()
    offset = gliding.effects[0].values()["offset_s"]
    assert offset == pytest.approx(5e-6, abs=4.0 * u[0] * plain.parameters.scale[0])


def test_a_name_that_nothing_stands_in_for_is_not_fitted_away(bent: FitState, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name without which nothing comes near stays without a fit; one that others may replace is asked by one."""
    offset, faint = ExposureTimeOffset(5e-6), ResponseNonlinearity(1e-5)
    asked: list[FitState] = []

    def counted(state: FitState, iterations: int = 25) -> FitState:
        asked.append(state)
        return refit(state, iterations)

    monkeypatch.setattr(moves, "refit", counted)
    alone = refit(with_effects(bent, [offset, faint]))
    ((name, promised, _),) = moves._without_one(alone)
    worse = promised - alone.cost  # χ², which is twice the nats
    assert name == offset.name
    assert worse == pytest.approx(with_effects(bent, [faint]).promised - alone.cost, rel=0.05)  # derivatives from there
    for bound, fits in ((0.49 * worse, 0), (0.51 * worse, 1)):
        monkeypatch.setattr(moves, "HUGE_NATS", bound)
        asked.clear()
        assert moves.pruned(alone, lambda line: None) == (alone, [])
        assert len(asked) == fits
    left, gone = moves.pruned(with_effects(alone, [faint, offset, ResponseNonlinearity(2e-6)]), lambda line: None)
    assert gone == [faint.name]
    assert [effect.name for effect in left.effects] == [offset.name, faint.name]


@pytest.mark.parametrize(
    ("promised", "misfit", "tried"), [(2e-3, 4.0, False), (5e-3, 4.0, True), (5e-4, 1.0, False), (2e-3, 1.0, True)]
)
def test_a_step_that_promises_next_to_nothing_is_not_tried(
    monkeypatch: pytest.MonkeyPatch, promised: float, misfit: float, tried: bool
) -> None:
    """Less than a thousandth of χ² times its misfit; else ever shorter steps, of which those beyond the range fail."""
    state: Any = SimpleNamespace(
        cost=10.0, promised=10.0 - promised, misfit=misfit, fit=SimpleNamespace(step=np.array([2.0]))
    )
    monkeypatch.setattr(fitting, "_moved", lambda _state, step: float(step[0]))
    monkeypatch.setattr(fitting, "_is_within_range", lambda trial: trial < 2.0)
    lengths: Any = list(fitting._trials(state))
    if not tried:
        assert lengths == []
        return
    assert 0.0 < lengths[0] < 2.0, "the whole step leads beyond the range"
    assert all(0.0 < shorter < longer for longer, shorter in itertools.pairwise(lengths))
    assert len(lengths) == fitting._SHORTENINGS - 1


@pytest.mark.parametrize(
    ("gains", "promised", "ends"),
    [
        ([0.5, 0.5, 0.5], 10.0, True),
        ([0.5, 0.5], 10.0, False),
        ([0.5, 0.5, 2.0, 0.5, 0.5], 10.0, False),
        ([0.5, 0.5, 2.0, 0.5, 0.5, 0.5], 10.0, True),
        ([0.5, 0.5, 0.5], 4.0, False),  # more than a tenth of what was promised
        ([1.5, 1.5, 1.5], 90.0, False),  # little of what was promised, and yet something
    ],
)
def test_a_fit_that_creeps_is_ended(gains: list[float], promised: float, ends: bool) -> None:
    """Three steps on end that gain less than a tenth of what was promised and less than 1 of χ²."""
    pace, cost, told = fitting._Pace(), 100.0, []
    for gain in [0.0, *gains]:
        cost -= gain
        told.append(pace.creeps(SimpleNamespace(cost=cost, promised=cost - promised, misfit=1.0)))  # type: ignore[arg-type]
    assert told[-1] is ends
    assert not any(told[:-1])


def test_what_comes_nowhere_near_is_not_fitted_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """One step tells where its own derivatives still leave 400 of χ² more; else the fit goes on to its loss."""
    fits: list[int] = []

    class Smaller:
        def __init__(self, promised: float) -> None:
            self.promised = promised

        def with_frozen(self, held: frozenset[int]) -> Smaller:
            assert not held
            return self

    def refitted(state: Any, iterations: int) -> Any:
        fits.append(iterations)
        return state

    monkeypatch.setattr(moves, "refit", refitted)
    monkeypatch.setattr(moves, "_log_density", lambda state: 7.0 if isinstance(state, Smaller) else 30.0)
    whole: Any = SimpleNamespace(cost=1000.0)
    assert moves._lost(whole, Smaller(1401.0)) == np.inf  # type: ignore[arg-type]
    assert fits == [1]
    assert moves._lost(whole, Smaller(1399.0)) == 23.0  # type: ignore[arg-type]
    assert fits == [1, 1, 5]

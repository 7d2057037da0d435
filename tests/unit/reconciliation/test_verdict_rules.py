"""The verdict word by word, each rule on both sides of its threshold; and how far statistics scatter, by formula."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation import verdict
from radiometer.reconciliation.fit.candidate_fit import FittedCandidate
from radiometer.reconciliation.fit.covariance import is_misfit
from radiometer.reconciliation.result import FittedParameter, Verdict
from radiometer.reconciliation.search.outcome import Step
from radiometer.reconciliation.search.score import by_itself
from radiometer.reconciliation.statistics import Scatter
from radiometer.reconciliation.verdict import faint, faint_beside_others, insignificant_names, verdict_of
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.conversion_gain_error import ConversionGainError
from simulators.effects.crosstalk import Crosstalk
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.dsnu import Dsnu
from simulators.effects.event_offset import EventOffset
from simulators.effects.gamma_enabled import GammaEnabled
from simulators.effects.psf_blur import PsfBlur

BLUR, GAIN = PsfBlur(0.3), ConversionGainError(0.01)


def state(effects: Any = (), gap: float = 1.0, settings: int = 10, each: float = 1000.0) -> Any:
    """Return a stand-in for a fitted state: so many held-out settings of so many entries, and their gap."""
    return SimpleNamespace(
        effects=tuple(effects),
        gap=gap,
        settings=settings,
        held_out=SimpleNamespace(count=np.append(np.full(settings, each), 1e9)),
    )


def outcome(effects: Any = (), steps: Any = (), left: Any = (), **more: Any) -> Any:
    return SimpleNamespace(state=state(effects, **more), steps=tuple(steps), left=tuple(left))


def step(name: str, nats: float, *rivals: Any) -> Step:
    return Step(name, "signal", nats, 1.01, 1.0, rivals)


@pytest.mark.parametrize(
    ("effects", "left", "steps", "gap", "doubts", "again", "word"),
    [
        ((), (), (), 1.0, [], None, Verdict.AGREES),
        ((), (), (), 1.0, ["a doubt about no name"], None, Verdict.AGREES),
        ((), (1,), (), 1.0, [], None, Verdict.UNNAMED),
        ((), (), ("unnamed",), 1.0, [], None, Verdict.UNNAMED),
        ((), (), (), 1.2, [], None, Verdict.UNNAMED),
        ((), (), (), 1.0, [], 7, Verdict.UNNAMED),
        ((BLUR,), (), ("psf_blur",), 1.0, [], None, Verdict.EFFECTS_FOUND),
        ((BLUR,), (), ("psf_blur",), 1.0, ["it may be another"], None, Verdict.INCOMPLETE),
        ((BLUR,), (1,), ("psf_blur",), 1.0, [], None, Verdict.INCOMPLETE),
        ((BLUR,), (), ("psf_blur", "unnamed"), 1.0, [], None, Verdict.INCOMPLETE),
        ((BLUR,), (), ("psf_blur",), 1.2, [], None, Verdict.INCOMPLETE),
        ((BLUR,), (), ("psf_blur",), 1.0, [], 7, Verdict.INCOMPLETE),
    ],
)
def test_the_verdict(effects, left, steps, gap, doubts, again, word):
    """Names or none; structure, scatter or a period left or not; doubts of names."""
    found = outcome(effects, [step(name, 100.0) for name in steps], left, gap=gap)
    assert verdict_of(found, doubts, again) is word


@pytest.mark.parametrize(
    ("gap", "settings", "each", "scattered"),
    [(1.049, 10, 1000.0, False), (1.08, 10, 1000.0, True), (1.06, 10, 1000.0, False), (1.051, 100, 1000.0, True),
     (1.3, 10, 40.0, False), (1.4, 10, 40.0, True)],
)  # fmt: skip
def test_scatter_is_five_sigma_and_a_twentieth(gap, settings, each, scattered):
    """χ² of n entries scatters by √(2/n); held-out entries beyond the settings do not count."""
    expected = gap > max(1.05, 1.0 + 5.0 * math.sqrt(2.0 / (settings * each)))
    assert is_misfit(state(gap=gap, settings=settings, each=each)) is scattered is expected


def test_insignificant_names_beside_what_stays():
    """Below 40 nats, or below the strongest, only where structure stays; those without a place in the model never."""
    steps = [step("psf_blur", 500.0), step("conversion_gain_error", 39.0), step("crosstalk", 5.0)]
    effects = (BLUR, GAIN)
    assert insignificant_names(outcome(effects, steps)) == []
    assert insignificant_names(outcome(effects, steps, left=(1,))) == ["conversion_gain_error"]
    assert insignificant_names(outcome(effects, [steps[0], replace(steps[1], gain_nats=41.0)], left=(1,))) == []
    assert insignificant_names(outcome(effects, [replace(s, gain_nats=20.0) for s in steps], left=(1,))) == []
    (said,) = faint(outcome(effects, steps, left=(1,)))
    assert said.startswith("conversion_gain_error is counted as part of the residual: it brings 39 nats")
    assert faint_beside_others(steps, effects) == ["conversion_gain_error"]
    assert faint_beside_others([step("psf_blur", 39.0)], (BLUR,)) == []
    assert faint_beside_others([step("psf_blur", 39.0, Crosstalk(0.01))], (BLUR,)) == ["psf_blur"]
    assert faint_beside_others([step("psf_blur", 41.0, Crosstalk(0.01))], (BLUR,)) == []


@pytest.mark.parametrize(("nats", "told"), [(249.0, []), (251.0, ["psf_blur"])])
def test_a_name_beside_an_unknown_cause_that_brings_four_fifths(nats, told):
    """A quarter of what has no name is what a name must bring beside it; where none does, nothing is named."""
    found = outcome((BLUR,), [step("unnamed", 1000.0), step("psf_blur", nats)], left=(1,))
    assert insignificant_names(found) == sorted({"psf_blur"} - set(told))
    assert verdict_of(found, []) is (Verdict.INCOMPLETE if told else Verdict.UNNAMED)


@pytest.mark.parametrize(
    ("u", "left", "told"), [(0.5, (1,), []), (0.4, (1,), ["event_offset"]), (0.5, (), ["event_offset"])]
)
def test_a_size_within_three_uncertainties_of_nothing_is_no_name_where_structure_stays(u, left, told, monkeypatch):
    """An event of 1.4 ± 0.5 DN is a part of what is left, of 1.4 ± 0.4 DN a name; where nothing is left it is one."""
    known = {"event_offset": {"offset_dn": FittedParameter(1.4, u, "DN")}, "psf_blur": {}}
    monkeypatch.setattr(verdict, "fitted_parameters", lambda _: known)
    found = outcome((BLUR, EventOffset(1.4)), [step("psf_blur", 900.0), step("event_offset", 800.0)], left)
    kept = [name for name in ("event_offset",) if name not in insignificant_names(found)]
    assert kept == told
    assert faint(found) == ([] if told else ["event_offset is counted as part of the residual"])


@pytest.mark.parametrize(
    ("value", "u", "lacking"),
    [(2.9, 1.0, True), (3.1, 1.0, False), (-3.1, 1.0, False), (-2.9, 1.0, True), (0.1, None, False)],
)
def test_an_essential_parameter_is_three_uncertainties_from_nothing(value, u, lacking):
    """On either side of nothing, be it 0 or 1; one that was not fitted says nothing. Without any the first counts."""
    fitted = {"entry": {"strength": FittedParameter(value, u, "1"), "other": FittedParameter(0.0, 1.0, "1")}}
    for essential, parameters in ((("strength",), ("other",)), ((), ("strength", "other"))):
        effect: Any = SimpleNamespace(name="entry", essential=essential, fitted=parameters, neutral=lambda name: 0.0)
        assert (verdict.without_essential([], (effect,), fitted) == ["entry"]) is lacking
    at_one: Any = SimpleNamespace(name="entry", essential=(), fitted=("strength",), neutral=lambda name: 1.0)
    moved = {"entry": {"strength": FittedParameter(value + 1.0, u, "1")}}
    assert (verdict.without_essential([], (at_one,), moved) == ["entry"]) is lacking


@pytest.mark.parametrize(
    ("gamma", "told"),
    [(1.0051, False), (1.0049, True), (0.9949, False), (0.9951, True), (1.0004, True), (2.2, False), (0.45, False)],
)
def test_a_gamma_nearer_to_one_than_any_setting(gamma, told):
    """Cameras tell gamma in hundredths: what bends by less than half of one is something else, and the name a guess."""
    said = verdict.below_least((BLUR, GammaEnabled(gamma), GAIN))
    assert said == ([f"gamma_enabled with gamma = {gamma:.6g}"] if told else [])


def test_the_share_that_a_basis_explains():
    """1 for the basis itself, about 0 for noise: each term costs one value."""
    x = np.linspace(-1.0, 1.0, 400)
    noise = np.random.default_rng(1).standard_normal(400)
    assert verdict._explained(2.0 + 3.0 * x, x[:, None]) == pytest.approx(1.0)
    assert verdict._explained(noise, np.vander(x, 21)[:, :20]) == pytest.approx(0.0, abs=0.08)
    mixed = verdict._explained(x * math.sqrt(3.0) + noise, x[:, None])
    assert mixed == pytest.approx(0.5, abs=0.07)


def scatter(**changes: Any) -> Scatter:
    """Return the scatter of two captures of one tile: 8 and 2 frames of 100 pixels, variances 25 and 36 DN²."""
    base = {
        "gain": np.array([0.5, 0.5]), "signal": np.full((2, 1), 40.0), "variance": np.full((2, 1), 30.0),
        "neighbour_x": np.zeros((2, 1)), "neighbour_y": np.zeros((2, 1)), "row_variance": np.zeros(2),
        "rounding": np.zeros((2, 1)), "kurtosis": np.zeros((2, 1)),
        "beyond_x": np.zeros((2, 1)), "beyond_rows": np.zeros((2, 1)),
    }  # fmt: skip
    seen = {
        "variance": np.array([[25.0], [36.0]]), "pixels": np.full((2, 1), 100.0),
        "variance_dof": np.array([[700.0], [100.0]]),
    }  # fmt: skip
    tile = SimpleNamespace(width=10, height=20)
    design = SimpleNamespace(frame_count=np.array([8, 2]), uniform=True, tiles=[tile])
    return Scatter(design, SimpleNamespace(**seen), SimpleNamespace(**base | changes), np.array([[True], [False]]))  # type: ignore[arg-type]


def test_how_far_a_mean_scatters():
    """√(σ²/(pixels·frames)) of the noise as seen, or as predicted where it is not known; neighbours that share move it
    more; a tenth of what rounding may do is added."""
    plain = np.sqrt(np.array([[25.0 / 800], [30.0 / 200]]))
    assert scatter().mean == pytest.approx(plain)
    shared = scatter(neighbour_x=np.full((2, 1), 0.1), neighbour_y=np.full((2, 1), 0.05), row_variance=np.full(2, 3.0))
    # Rows that move together are taken apart: of 0.1, 3/30 is theirs.
    assert shared.mean == pytest.approx(plain * math.sqrt(1.0 + 2.0 * 0.05))
    farther = scatter(beyond_x=np.full((2, 1), 0.03), beyond_rows=np.full((2, 1), 0.04))  # each of two sides
    assert farther.mean == pytest.approx(plain * math.sqrt(1.0 + 2.0 * 0.07))
    assert scatter(neighbour_x=np.full((2, 1), -0.9)).mean == pytest.approx(plain * math.sqrt(0.5))
    assert scatter(rounding=np.full((2, 1), 0.5)).mean == pytest.approx(np.hypot(plain, 0.05))
    assert scatter().first == pytest.approx(np.sqrt(np.array([[25.0 / 100 * 8 / 7], [30.0 / 100 * 2.0]])))


def test_how_far_a_variance_scatters():
    """ln of a variance of ν degrees of freedom: trigamma(ν/2); photons add K⁴·N/(σ⁴·pixels·frames), codes theirs."""
    from scipy.special import polygamma

    own = polygamma(1, np.array([[350.0], [50.0]]))
    photons = 0.5**4 * 40.0 / 30.0**2
    expected = np.sqrt(own + photons / np.array([[800.0], [200.0]]))
    assert scatter().variance == pytest.approx(expected, rel=1e-3)
    bright = np.sqrt(own + 100.0 * photons / np.array([[800.0], [200.0]]))  # 12 % of the variance is theirs
    assert scatter(signal=np.full((2, 1), 4000.0)).variance == pytest.approx(bright, rel=1e-6)
    white = np.sqrt(own + 1.0 / np.array([[800.0], [200.0]]))  # no more than one electron's in a variance of one
    assert scatter(signal=np.full((2, 1), 1e6)).variance == pytest.approx(white, rel=1e-6)
    few_codes = np.sqrt(own + (photons + 6.0) / np.array([[800.0], [200.0]]))
    assert scatter(kurtosis=np.full((2, 1), 6.0)).variance == pytest.approx(few_codes, rel=1e-3)
    pairs = np.array([[700.0], [100.0]]) * 100.0 / 99.0
    assert scatter().neighbours("width") == pytest.approx(np.sqrt(1.0 / (0.9 * pairs)))
    assert scatter().neighbours("height") == pytest.approx(np.sqrt(1.0 / (0.95 * pairs)))


def _judged(effect: CatalogueEffect, nats: float) -> tuple[FittedCandidate, float]:
    nothing = np.zeros(0)
    return FittedCandidate(effect, 2.0 * nats, 2.0 * nats, 2, False, nothing, nothing), nats


@pytest.mark.parametrize(("scatter", "named"), [(1.0, "gamma_enabled"), (10.0, "gamma_enabled"), (300.0, "dsnu")])
def test_far_off_a_tie_goes_to_what_brings_most_by_itself(scatter: float, named: str) -> None:
    """800 nats of 820 000 are odds of e^800 at a gap of 1, and less than those of a rival at a gap of 300."""
    full = [_judged(GammaEnabled(1.9), 820_891.0), _judged(Dsnu(15.0), 820_091.0), _judged(DarkCurrent(1.0), 600_000.0)]
    alone = [_judged(GammaEnabled(1.1), 76_721.0), _judged(Dsnu(14.0), 802_327.0), _judged(DarkCurrent(1.0), 900_000.0)]
    assert by_itself(full, alone, scatter)[0].name == named


def test_the_rest_has_the_size_that_the_names_alone_leave(monkeypatch):
    """Names that count to the rest are out of the model that says how large it is, and the unnamed terms with them."""
    asked = []
    monkeypatch.setattr(verdict, "with_effects", lambda start, effects: (start, effects))
    monkeypatch.setattr(verdict, "refit", lambda state, iterations: asked.append(state) or "anew")
    found = outcome((BLUR, GAIN))
    found.start = "start"
    assert verdict._named_alone(found, []) is found.state
    assert verdict._named_alone(found, ["conversion_gain_error"]) == "anew"
    assert asked == [("start", (BLUR,))]


@pytest.mark.parametrize(
    ("left", "doubts", "doubted"), [(False, ["a bound"], True), (False, [], False), (True, ["a bound"], False)]
)
def test_only_names_that_leave_nothing_are_doubted(monkeypatch, left, doubts, doubted):
    """Where structure stays it is no choice between two entries that is missing."""
    monkeypatch.setattr(verdict, "leaves_structure", lambda outcome: left)
    monkeypatch.setattr(verdict, "doubts_of", lambda outcome: doubts)
    assert verdict.is_doubted(outcome()) is doubted

"""What noise tells and what counts, by laws and at exact bounds: black levels, scatter of light, scores of names."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.fit.covariance import scatter_of
from radiometer.reconciliation.fit.covariates import Covariate
from radiometer.reconciliation.fit.full_fit import contenders_of
from radiometer.reconciliation.fit.held_out import _reduced
from radiometer.reconciliation.noise.dark_errors import _drift
from radiometer.reconciliation.noise.darkness import _wander, black_by_noise
from radiometer.reconciliation.noise.repeatability import _slow_change, capture_scale, estimate_tau
from radiometer.reconciliation.noise.repeats import _series, _standing_out, _together
from radiometer.reconciliation.result import Series
from radiometer.reconciliation.search.score import is_shown, log_chance, penalised_chi2, score
from radiometer.reconciliation.statistics import Counted, Given, Scale, family_of, named
from radiometer.reconciliation.thresholds import (
    FEW_TRIES,
    FLEXIBLE_NATS,
    LATER_NATS,
    NAMED_NATS,
    PARAMETER_NATS,
    SHOWN_CHI2,
    STATED_NATS,
    STATED_SHARE,
)


def lit(mean: Any, variance: Any, **more: Any) -> float | None:
    """Return the black level that noise tells of one lit setting that states none."""
    captures = len(mean)
    design: Any = SimpleNamespace(
        exposure_s=np.ones(captures),
        gain_db=np.zeros(captures),
        source_level=np.ones(captures),
        closed=np.zeros(captures, bool),
        black_level_dn=np.full(captures, np.nan),
    )
    shape = np.shape(mean)
    figures = {"variance_dof": np.full(shape, 200.0), "high": np.zeros(shape), "low": np.zeros(shape)} | more
    seen: Any = SimpleNamespace(mean=np.array(mean, float), variance=np.array(variance, float), **figures)
    return black_by_noise(design, seen)


MEANS = np.array([[150.0, 200.0, 300.0, 400.0, 600.0, 800.0]])


@pytest.mark.parametrize("black_dn", [0.0, 64.0, 120.0])
@pytest.mark.parametrize("gain", [0.3, 2.0])
def test_noise_that_rises_with_light_ends_at_black(black_dn: float, gain: float) -> None:
    """σ² = K·(y − y₀): whatever the gain; and no higher than the darkest tile, no lower than 0."""
    assert lit(MEANS, gain * (MEANS - black_dn)) == pytest.approx(black_dn, abs=1e-6)
    assert lit(MEANS, gain * (MEANS + 50.0)) == 0.0
    assert lit(MEANS, gain * (MEANS - 149.0) + 1e-3 * (MEANS > 150.0)) <= 150.0


def test_noise_that_chance_may_have_raised_tells_no_black() -> None:
    """A slope within five of its uncertainties, three tiles, or tiles of one mean: 0."""
    flat, variance = np.full(MEANS.shape, 40.0), 0.5 * (MEANS - 100.0)
    assert lit(MEANS, flat + 0.02 * (MEANS - 400.0)) == 0.0
    _, covariance = np.polyfit(MEANS[0], variance[0], 1, w=1.0 / variance[0], cov="unscaled")
    five = 2.0 * covariance[0, 0] * (5.0 / 0.5) ** 2  # degrees of freedom that make the slope five of its own u
    for factor, black_dn in ((0.98, 0.0), (1.02, 100.0)):
        told = lit(MEANS, variance, variance_dof=np.full(MEANS.shape, factor * five))
        assert told == pytest.approx(black_dn, abs=1e-6)
    assert lit(MEANS[:, :3], MEANS[:, :3] - 64.0) == 0.0
    assert lit(MEANS[:, :4], MEANS[:, :4] - 64.0) == pytest.approx(64.0)
    assert lit(np.full((1, 6), 300.0), flat) == 0.0


@pytest.mark.parametrize(
    ("name", "value"), [("high", 1e-4), ("low", 1e-4), ("variance_dof", 0.0), ("variance", np.nan)]
)
def test_clipped_tiles_and_single_frames_tell_no_noise(name: str, value: float) -> None:
    """A tile of which a part clips at either end, or without freedom, is left out however noisy it is."""
    usual = {"high": 0.0, "low": 0.0, "variance_dof": 200.0, "variance": 5.0}
    variance = MEANS - 64.0
    variance[0, -1] = 5.0
    assert lit(MEANS, variance) != pytest.approx(64.0, abs=1.0)
    if name == "variance":
        variance[0, -1] = value
        assert lit(MEANS, variance) == pytest.approx(64.0, abs=1e-6)
        return
    figures = np.full(MEANS.shape, usual[name])
    figures[0, -1] = value
    assert lit(MEANS, variance, **{name: figures}) == pytest.approx(64.0, abs=1e-6)


def wandering(shown: Any, unit: Any, dof: Any, *, rows: Any = None, noise2: float = 16.0, closed: bool = True) -> float:
    captures = len(shown)
    seen: Any = SimpleNamespace(
        black=np.array(shown, float),
        black_unit=np.array(unit, float),
        black_dof=np.array(dof, float),
        row_temporal=np.ones(captures) if rows is None else np.array(rows, float),
        variance=np.full((captures, 3), noise2),
    )
    return _wander("black", SimpleNamespace(closed=np.full(captures, closed)), seen)  # type: ignore[arg-type]


def test_a_wander_is_what_frames_show_beyond_chance_weighed_by_their_freedom() -> None:
    """0.49 and 0.09 DN² of 10 and 30 degrees of freedom, 0.01 of each by chance: √((10·0.48 + 30·0.08)/40)."""
    assert wandering([0.49, 0.09], [0.01, 0.01], [10, 30]) == pytest.approx(math.sqrt(0.18))
    assert wandering([0.49, 0.09], [0.01, 0.01], [10, 30], closed=False) == 0.0
    assert wandering([0.49, np.nan], [0.01, 0.01], [10, 30]) == pytest.approx(math.sqrt(0.48))
    assert wandering([0.012, 0.011], [0.01, 0.01], [10, 30]) == 0.0  # chance may have it
    assert wandering([0.49], [0.01], [0]) == 0.0
    noisy_rows = wandering([0.49, 0.09], [0.01, 0.01], [10, 30], rows=[4.0, 0.5])
    assert noisy_rows == pytest.approx(math.sqrt((10 * 0.45 + 30 * 0.08) / 40.0))
    assert wandering([900.0], [0.01], [10]) == pytest.approx(0.3 * 4.0)


def test_the_light_of_a_capture_is_the_weighted_mean_of_its_tiles() -> None:
    """Each deviation over its sensitivity, by the information of its own noise; the same without it is infinite."""
    rng = np.random.default_rng(3)
    sensitivity, deviation = rng.uniform(50.0, 500.0, (3, 8)), rng.uniform(0.5, 2.0, (3, 8))
    usable = np.ones((3, 8), bool)
    usable[1, ::2], usable[2] = False, False
    shift = np.array([0.01, -0.02, 0.03])
    scale, variance = capture_scale(shift[:, None] * sensitivity, sensitivity, deviation, usable)
    assert scale[:2] == pytest.approx(shift[:2])
    assert (scale[2], variance[2]) == (0.0, math.inf)
    assert 1.0 / variance[0] == pytest.approx(np.sum((sensitivity[0] / deviation[0]) ** 2))
    assert 1.0 / variance[1] == pytest.approx(np.sum((sensitivity[1, 1::2] / deviation[1, 1::2]) ** 2))


@pytest.mark.parametrize(("declared", "low", "high"), [(2e-3, 1e-3, 4e-3), (None, 3e-4, 3e-3), (0.0, 3e-4, 3e-3)])
def test_without_repeats_or_light_the_middle_of_what_is_usual_is_taken(
    declared: float | None, low: float, high: float
) -> None:
    """Half to twice of what is stated; of 0.1 % a third to thrice where nothing is, or no light is seen at all."""
    count = 12
    source = SimpleNamespace(reproducibility_u_rel=declared)
    design: Any = SimpleNamespace(
        setting_id=np.arange(count),
        timestamp_s=np.arange(count),
        jump_times_s=(),
        header=SimpleNamespace(source=source),
    )
    nothing = estimate_tau(design, np.zeros(count), np.full(count, math.inf))
    assert nothing == pytest.approx(math.sqrt(low * high))
    still, wild = (estimate_tau(design, s * np.ones(count), np.full(count, 1e-12)) for s in (0.0, 1.0))
    assert (still, wild) == (pytest.approx(low, rel=0.01), pytest.approx(high, rel=0.01))


@pytest.mark.parametrize(("terms", "columns"), [(2, 0), (3, 3), (7, 7), (100, 19)])
def test_slow_change_is_a_warm_up_and_ever_shorter_waves(terms: int, columns: int) -> None:
    """A line, its square, an exponential of four e-folds, then half waves, sixteen at most; at either end by itself."""
    time = np.array([30.0, 10.0, 20.0, 50.0])
    found = _slow_change(time, terms)
    assert found.shape == (4, columns)
    if columns:
        assert found[:, 0] == pytest.approx([0.5, 0.0, 0.25, 1.0])
        assert found[[1, 3], 1] == pytest.approx([0.0, 1.0])
        assert found[[1, 3], 2] == pytest.approx([1.0, math.exp(-4.0)])
    for k in range(3, columns):
        assert found[[1, 3], k] == pytest.approx([1.0, (-1.0) ** (k - 2)])


def candidate(**more: Any) -> Any:
    effect = SimpleNamespace(log_prior_odds=more.pop("odds", 0.0))
    usual = {"gain": 100.0, "evidence": 50.0, "tries": 1, "stated": 0.0, "flexible": False, "parameters": 1}
    return SimpleNamespace(effect=effect, **(usual | more))


@pytest.mark.parametrize(
    ("more", "later", "needed"),
    [
        ({}, False, NAMED_NATS), ({}, True, NAMED_NATS + LATER_NATS),
        ({"flexible": True}, False, NAMED_NATS + FLEXIBLE_NATS),
        ({"odds": -3.0}, False, NAMED_NATS + 3.0), ({"odds": 1.5}, False, NAMED_NATS - 1.5),
        ({"tries": FEW_TRIES}, False, NAMED_NATS), ({"tries": 20.0}, False, NAMED_NATS + math.log(20.0 / FEW_TRIES)),
        ({"stated": 100.0 * STATED_SHARE}, False, NAMED_NATS),
        ({"stated": 100.1 * STATED_SHARE}, False, NAMED_NATS + STATED_NATS),
    ],
)  # fmt: skip
def test_what_a_name_must_bring(more: dict[str, Any], later: bool, needed: float) -> None:
    """Exactly so many nats are enough: more beside others, of many starts, of unlikely or stated things, or forms."""
    assert is_shown(candidate(**more), needed + 1e-9, -5.0, later=later)
    assert not is_shown(candidate(**more), needed - 1e-6, -5.0, later=later)
    assert not is_shown(candidate(**more), needed + 1e-9, log_chance(100.0, 1), later=later)
    assert is_shown(candidate(**more, evidence=SHOWN_CHI2), needed + 1e-9, -5.0, later=later)
    assert not is_shown(candidate(**more, evidence=SHOWN_CHI2 - 1e-6), needed + 1e-9, -5.0, later=later)


def test_each_parameter_pays() -> None:
    """Three nats each, twice that in χ²; unlikely names and flexible forms pay besides; no chance is minus infinity."""
    one = candidate(odds=-4.0, parameters=2)
    assert penalised_chi2(one) == pytest.approx(100.0 - 2.0 * (2 * PARAMETER_NATS + 4.0))
    assert score((one, 50.0)) == pytest.approx(50.0 - 2 * PARAMETER_NATS - 4.0)
    assert score((candidate(flexible=True), 50.0)) == pytest.approx(50.0 - PARAMETER_NATS - FLEXIBLE_NATS)
    assert log_chance(0.0, 3) == pytest.approx(0.0, abs=1e-6)
    assert log_chance(1e6, 1) == -math.inf
    assert log_chance(2.0 * 7.0, 2) == pytest.approx(-7.0)  # of two degrees of freedom χ² is exponential


def frames_of(*apart: float, u: float = 0.01) -> Series:
    return Series(tuple(range(len(apart))), 1.0, None, apart, (u,) * len(apart))


def test_each_frame_is_told_against_the_mean_of_the_others() -> None:
    """Means of 1, 2 and 6 in all tiles: 1 less 4, 2 less 3.5, 6 less 1.5; the scatter of tiles is its uncertainty."""
    rng = np.random.default_rng(2)
    tiles = np.array([[1.0], [2.0], [6.0]]) + 0.1 * rng.standard_normal((3, 400)) + rng.normal(0.0, 50.0, 400)
    design: Any = SimpleNamespace(
        captures=(SimpleNamespace(frames=(7, 8, 9)),), exposure_s=np.array([0.5]), temperature_c=np.array([np.nan])
    )
    found = _series(design, 0, tiles)
    assert (found.frames, found.exposure_s, found.temperature_c) == ((7, 8, 9), 0.5, None)
    assert found.apart == pytest.approx([-3.0, -1.5, 4.5], abs=0.03)
    # A frame less the mean of two others scatters by √1.5; a median is worth 1/1.2533² of a mean.
    assert found.u == pytest.approx([0.1 * math.sqrt(1.5) * 1.2533 / 20.0] * 3, rel=0.25)
    design.temperature_c = np.array([30.0])
    assert _series(design, 0, tiles).temperature_c == 30.0


def test_scatter_of_equal_frames_is_that_of_their_means() -> None:
    """Series drawn at 0.5 beside tiles' chance: together they tell it with its u; without any it is next to nothing."""
    rng = np.random.default_rng(4)

    def series(sigma: float) -> list[Series]:
        means = [sigma * rng.standard_normal(5) + 0.02 * rng.standard_normal(5) for _ in range(60)]
        return [frames_of(*((m - m.mean()) * 5 / 4), u=0.02 * math.sqrt(5 / 4)) for m in means]

    found = _together("dark", "DN", series(0.5), 0.1)
    assert found.scatter.u is not None
    assert found.scatter.value == pytest.approx(0.5, abs=4 * found.scatter.u)
    assert found.scatter.u == pytest.approx(0.5 / math.sqrt(2 * 240), rel=0.1)
    assert _together("dark", "DN", series(0.0), 0.1).scatter.value < 0.01


@pytest.mark.parametrize(("apart", "out"), [(3.0, ()), (12.0, (2,))])
def test_a_frame_stands_out_of_the_scatter_of_all_others(apart: float, out: tuple[int, ...]) -> None:
    """Of twenty frames that scatter by one: three sigma are chance, twelve are not; of three frames nobody knows."""
    values = [0.9, -0.8, apart, -1.1, 1.0, 0.7, -0.9, 1.2, -0.6, -1.0]
    one = frames_of(*values)
    total, freedom = 9.0 + 0.8 * apart**2, 19
    assert _standing_out(one, total + 9.0, freedom) == out
    assert _standing_out(frames_of(5.0, -2.5, -2.5), 1e-9, 2) == ()


@pytest.mark.parametrize(("level", "inside"), [(4084.9, True), (4085.0, False), (8.1, True), (8.0, False)])
def test_a_tile_is_inside_where_five_sigma_fit_below_the_top_and_four_above_nought(level: float, inside: bool) -> None:
    """Noise of 2 DN and full scale of 4095: neither bound itself; and less than a thousandth clips at either end."""
    camera = SimpleNamespace(saturated_dn=4095.0)
    design: Any = SimpleNamespace(header=SimpleNamespace(camera=camera), uniform=True)
    whole = np.full((1, 1), level)
    base: Any = SimpleNamespace(variance=np.full((1, 1), 4.0), fixed=np.zeros((1, 1)), mean=np.full((1, 1), 2000.0))

    def told(**more: Any) -> bool:
        figures = {"mean": whole, "variance": np.full((1, 1), 4.0), "high": np.zeros((1, 1)), "low": np.zeros((1, 1))}
        one = Counted(design, SimpleNamespace(**(figures | more)), base)  # type: ignore[arg-type]
        vars(one)["step"] = 1
        return bool(one.inside[0, 0])

    assert told() is inside
    for end in ("high", "low"):
        assert told(**{end: np.full((1, 1), 0.0009)}) is inside
        assert not told(**{end: np.full((1, 1), 0.001)})
    assert told(variance=np.full((1, 1), np.nan)) is inside  # then as predicted


def test_rows_of_the_table_are_found_by_their_kind() -> None:
    """Both slopes are of one family; kinds of rows part the table."""
    assert {family_of(name) for name in ("slope_x", "slope_y")} == {"slope"}
    assert family_of("mean") == "mean"
    assert {"mean", "variance", "first"} <= set(named(given=Given.TILE)) < set(named())
    assert named(scale=Scale.COMB) == named(given=Given.PERIOD) == ("comb",)


@pytest.mark.parametrize(("levels", "terms"), [(1, 0), (2, 1), (8, 7), (9, 4)])
def test_few_levels_are_taken_one_by_one_and_many_by_a_smooth_curve(levels: int, terms: int) -> None:
    """Up to eight each but the first has a column of its own; beyond, four polynomials of mean nought; gains to 16."""
    value = np.repeat(np.arange(float(levels)), 3).reshape(levels, 3)
    found = Covariate("exposure_s", value, per_capture=True).basis()
    assert found.shape == (levels, 3, terms)
    if 1 < levels <= 8:
        assert found.sum(axis=-1).tolist() == (value > 0).astype(float).tolist()
    of_gain = Covariate("gain_db", value, per_capture=True).basis()
    assert of_gain.shape[-1] == levels - 1


def test_half_waves_of_a_black_level_fall_with_their_number() -> None:
    """Twelve of them, 1/k of the first in size; repeats average those of a mean out, not those of a first frame."""
    design: Any = SimpleNamespace(
        shape=(40, 10),
        rows_of_tiles=np.eye(4, 40),
        tilts_of_rows=np.eye(4, 40),
        frame_count=np.array([1.0, 4.0]),
    )
    usable: Any = {name: np.ones((2, 4), bool) for name in ("mean", "first", "slope_y")}
    found = {next(iter(one.parts)): one for one in _drift(design, usable, 0.6, np.array([2.0, 4.0 / 3.0]))}
    for name, of_frames in (("mean", (1.0, 0.25)), ("first", (2.0, 4.0 / 3.0)), ("slope_y", (1.0, 0.25))):
        variance = found[name].variance
        assert variance.shape == (2, 12)
        assert variance[:, 0] == pytest.approx([0.36 * share for share in of_frames])
        assert variance[0] / variance[0, 0] == pytest.approx(1.0 / np.arange(1.0, 13.0) ** 2)
    assert found["mean"].parts["mean"].basis[0, :2] == pytest.approx([math.cos(math.pi / 80), math.cos(math.pi / 40)])


def test_an_effect_s_share_of_a_group_is_taken_in_exactly() -> None:
    """rᵀ(I − H)⁻¹r and ln|I − H| for H = W·Wᵀ, from the products with the effects alone."""
    rng = np.random.default_rng(5)
    effects, residual = 0.3 * rng.standard_normal((7, 3)), rng.standard_normal(7)
    both = np.column_stack([effects, residual])
    chi2, log_determinant = _reduced(both.T @ both)
    whole = np.eye(7) - effects @ effects.T
    assert chi2 == pytest.approx(residual @ np.linalg.solve(whole, residual))
    assert log_determinant == pytest.approx(np.linalg.slogdet(whole)[1])


@pytest.mark.parametrize(("gap", "worth"), [(1.04, 1.0), (1.5, 1.5)])
def test_nats_are_worth_less_by_the_scatter_that_is_left(gap: float, worth: float) -> None:
    """The gap where structure is left, 1 where it may be chance."""
    held_out = SimpleNamespace(count=np.full(10, 1e4))
    state: Any = SimpleNamespace(gap=gap, settings=10, held_out=held_out)
    assert scatter_of(state) == worth


@pytest.mark.parametrize(
    ("best", "gap", "judged"), [(1999.0, 1.0, []), (2000.0, 1.0, ["a", "b"]), (2000.0, 100.0, ["a", "b", "c"])]
)
def test_near_candidates_of_a_huge_gain_are_fitted_in_full(best: float, gap: float, judged: list[str]) -> None:
    """Within a twentieth of the best, all where everything is far off; with one alone nothing is to be judged."""
    entries: Any = [(SimpleNamespace(effect=n), best * share) for n, share in (("a", 1.0), ("b", 0.951), ("c", 0.949))]
    asked = []

    def included(effect: str, *, far: bool) -> Any:
        asked.append((effect, far))
        return SimpleNamespace(evidence=ord(effect) + 7.0)

    fits: Any = SimpleNamespace(state=SimpleNamespace(gap=gap, evidence=7.0), included=included)
    found = contenders_of(fits, entries)
    assert asked == [(name, True) for name in judged]
    assert [nats for _, nats in found] == ([float(ord(n)) for n in judged] or [nats for _, nats in entries])
    assert contenders_of(fits, entries, fewest=len(judged) + 1) == entries

"""Which tiles count near a full well, how large a rest is said to be, and what a fit's misfit is, by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation import statistics, verdict
from radiometer.reconciliation.fit.linear import LinearFit, RowBlock
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.statistics import Counted, partly_at_the_top
from radiometer.reconciliation.verdict import size_of_rest


def counted(signal_e: Any, full_well_e: float | None) -> Any:
    camera = SimpleNamespace(full_well_e=full_well_e)
    design: Any = SimpleNamespace(header=SimpleNamespace(camera=camera))
    base: Any = SimpleNamespace(signal=np.array(signal_e, dtype=float))
    return Counted(design, SimpleNamespace(), base)  # type: ignore[arg-type]


def test_the_knee_reaches_five_sigma_of_shot_noise_to_both_sides_of_the_well() -> None:
    """9513 e⁻ lie 487 off, and 5·√9513 is 487.7; 10511 e⁻ lie 511 off, and 5·√10511 is 512.6."""
    near = [9511.0, 9513.0, 10_000.0, 10_511.0, 10_514.0]
    assert counted([near], 10_000.0).knee.tolist() == [[False, True, True, True, False]]


def test_without_a_declared_well_nothing_is_near_it() -> None:
    """No figure, no knee; and a tile without light has none either, whatever its sign."""
    assert not counted([[0.0, 1e4, 1e9]], None).knee.any()
    assert not counted([[-3.0, 0.0, 1.0]], 10.0).knee.any()


def test_a_variance_of_nothing_tells_no_noise() -> None:
    """Frames that do not differ at all, or of which only one is there, scatter as no normal variance does."""
    design: Any = SimpleNamespace(frame_count=np.array([2, 2, 1]))
    seen: Any = SimpleNamespace(variance=np.array([[0.0, 1e-9], [np.nan, 4.0], [4.0, 4.0]]))
    base: Any = SimpleNamespace(rounding=np.zeros((3, 2)))
    one = Counted(design, seen, base)
    vars(one)["free"] = np.array([[True, True], [True, False], [True, True]])
    assert one.noisy.tolist() == [[False, True], [False, False], [False, False]]


def fitted(**more: Any) -> Any:
    """Return a state of two captures of two tiles whose means an unnamed term took up by 3, 4 | 6, 8 sigmas."""
    taken = np.array([3.0, 4.0, 6.0, 8.0, 0.0])
    comparison = SimpleNamespace(
        usable={"mean": np.ones((2, 2), bool), "variance": np.array([[True, False], [False, False]])},
        deviation={"mean": np.array([[0.5, 0.5], [1.0, 1.0]]), "variance": np.full((2, 2), 0.1)},
        cuts={"mean": slice(0, 4), "variance": slice(0, 4)},
        whiteners={},
        size=5,
    )
    term = SimpleNamespace(is_smooth=True, size=1, build=lambda *_: taken[:, None])
    state = {
        "comparison": comparison,
        "terms": (term,),
        "weights": np.array([1.0]),
        "prediction": SimpleNamespace(gain=np.array([0.5, 2.0])),
        "sensitivity": np.array([[0.9, 100.0], [200.0, 1.1]]),
    }
    return SimpleNamespace(**state | more)


@pytest.fixture(autouse=True)
def without_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a state without its terms the linear fit of the nuisance that it has: one of the entry that is no mean."""

    def bare(state: Any, _: Any) -> Any:
        nuisance = getattr(state, "nuisance", np.eye(5)[4:].T)
        none = RowBlock.of(np.zeros((5, 0)))
        return SimpleNamespace(fit=LinearFit(np.zeros(5), RowBlock.of(nuisance), np.zeros((5, 0)), none))

    monkeypatch.setattr(verdict, "with_terms", bare)


def test_what_a_nuisance_would_take_up_is_no_part_of_a_rest() -> None:
    """A term of 3, 4, 6, 8 sigmas beside a nuisance that moves all four means by as much: −2.25, −1.25, 0.75, 2.75."""
    found = size_of_rest(fitted(nuisance=np.array([[1.0, 1.0, 1.0, 1.0, 0.0]]).T), "mean")
    assert found["rms_dn"].value == pytest.approx(np.sqrt((1.125**2 + 0.625**2 + 0.75**2 + 2.75**2) / 4))


def test_a_rest_of_means_is_told_in_dn_in_electrons_and_of_the_light() -> None:
    """1.5, 2, 6, 8 DN; at 0.5 and 2 DN/e⁻ 3, 4, 3, 4 e⁻; of light of 100, 200 and 1.1 DN, not of 0.9."""
    found = size_of_rest(fitted(), "mean")
    assert {name: (one.value, one.unit) for name, one in found.items()} == {
        "rms_dn": (pytest.approx(np.sqrt((2.25 + 4 + 36 + 64) / 4)), "DN"),
        "rms_e": (pytest.approx(np.sqrt((9 + 16 + 9 + 16) / 4)), "e-"),
        "rms_rel": (pytest.approx(np.sqrt((0.02**2 + 0.03**2 + (8 / 1.1) ** 2) / 3)), "1"),
    }


def test_entries_that_do_not_count_are_no_part_of_a_rest() -> None:
    """With the fourth mean left out the electrons are those of three; of variances one entry stays: 3 · 0.1."""
    state = fitted()
    state.comparison.usable["mean"][1, 1] = False
    found = size_of_rest(state, "mean")
    assert found["rms_e"].value == pytest.approx(np.sqrt((9 + 16 + 9) / 3))
    assert found["rms_rel"].value == pytest.approx(np.sqrt((0.02**2 + 0.03**2) / 2))
    (noise,) = size_of_rest(state, "variance").values()
    assert (noise.value, noise.unit) == (pytest.approx(0.3), "1")


def test_without_a_term_a_rest_is_what_exceeds_its_uncertainties() -> None:
    """χ² of 9 + 16 + 36 + 64 where 4 are expected: all residuals by √(1 − 4/125); nothing where 125 are."""
    state = fitted(terms=(), data_residual=np.array([3.0, 4.0, 6.0, 8.0, 0.0]))
    whole = size_of_rest(fitted(), "mean")["rms_dn"].value
    for expected, share in ((4, 1.0 - 4.0 / 125.0), (200, None)):
        state.comparison.degrees = lambda _, expected=expected: expected
        found = size_of_rest(state, "mean")
        assert [one.value for name, one in found.items() if name == "rms_dn"] == (
            [] if share is None else [pytest.approx(whole * np.sqrt(share))]
        )


def test_a_rest_in_the_dark_is_no_share_of_the_light() -> None:
    """Up to 1 DN of light no share is told; of statistics without a size nothing is."""
    for sensitivity_dn in (0.5, 1.0):
        state = fitted(sensitivity=np.full((2, 2), sensitivity_dn))
        assert sorted(size_of_rest(state, "mean")) == ["rms_dn", "rms_e"]
    assert size_of_rest(state, "edges") == {}


@pytest.mark.parametrize(
    ("cost", "counts", "reduced"), [(300.0, [60, 40], 3.0), (50.0, [60, 40], 1.0), (7.0, [0, 0], 7.0)]
)
def test_misfit_is_chi_square_per_entry_that_counts_and_at_least_one(cost, counts, reduced) -> None:
    """Data that agree better than stated do not make u smaller; without any entry χ² itself stands."""
    stand_in = SimpleNamespace(cost=cost, comparison=SimpleNamespace(counts=lambda: np.array(counts)))
    assert FitState.misfit.func(stand_in) == pytest.approx(reduced)  # type: ignore[attr-defined]


def scene(structure_dn2: float, frames: int, peak: float = 1000.0, **more: Any) -> bool:
    """Return whether a tile of noise 4 DN² and that variance of its time mean counts as partly at a top of 1000 DN."""
    design: Any = SimpleNamespace(
        uniform=False,
        frame_count=np.array([frames]),
        gain_db=np.array([more.get("gain_db", 0.0)]),
        source_level=np.array([more.get("level", 1.0)]),
    )
    zeros = np.zeros((1, 2))
    seen: Any = SimpleNamespace(
        mean=zeros,
        spatial=np.array([[structure_dn2, 0.0]]),
        slope_x=zeros,
        slope_y=zeros,
        pixels=np.full((1, 2), 100.0),
        high=np.full((1, 2), more.get("high", 0.0)),
        peak=np.array([[peak, 1000.0]]),
    )
    base: Any = SimpleNamespace(variance=np.full((1, 2), 4.0), mean=np.full((1, 2), 900.0))
    design.tiles = ()
    found = partly_at_the_top(design, seen, base)
    assert not found[0, 1]  # even, it is saturated whole or not at all
    return bool(found[0, 0])


@pytest.fixture
def without_tilt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the tiles' tilt for nothing."""
    monkeypatch.setattr(statistics, "slope_lengths", lambda _: (np.ones(2), np.ones(2)))


@pytest.mark.parametrize(("frames", "structure_dn2"), [(1, 8.0), (2, 6.0), (4, 5.0), (100, 4.04)])
@pytest.mark.usefixtures("without_tilt")
def test_a_tile_is_uneven_beyond_the_noise_of_a_frame_and_of_the_mean_of_all(frames: int, structure_dn2: float) -> None:
    """4 DN² and 4/n more: the mean of one frame has all of its noise, that of a hundred hardly any."""
    assert not scene(0.999 * structure_dn2, frames)
    assert scene(1.001 * structure_dn2, frames)


@pytest.mark.usefixtures("without_tilt")
def test_an_uneven_tile_is_at_the_top_within_five_sigma_of_the_noise_there() -> None:
    """990 of 1000 DN at noise of 2 DN: from there on part of it may be saturated; full scale and darkness tell it."""
    assert (scene(99.0, 2, 990.1), scene(99.0, 2, 989.9)) == (True, False)
    assert not scene(99.0, 2, high=0.0011)
    assert scene(99.0, 2, high=0.0009)
    assert not scene(99.0, 2, level=0.0)

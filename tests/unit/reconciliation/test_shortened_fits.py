"""Fits that are cut short where nothing is lost: where they end, and what they save."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from radiometer.data import TapDescription
from radiometer.reconciliation.fit.descent import (
    UnfitError,
    coarse_fit,
    converged_fit,
    first_state,
    included,
    refit,
    refit_with,
)
from radiometer.reconciliation.fit.nuisances import NuisanceLayout
from radiometer.reconciliation.fit.state import FitState, reweighted, with_effects
from radiometer.reconciliation.measure.design import Design, slope_lengths, tile_groups
from radiometer.reconciliation.measure.reduce import reduce_frames
from radiometer.reconciliation.tile_model import predict_several
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.dark_frame_subtracted import DarkFrameSubtracted
from simulators.effects.exposure_quantisation import ExposureQuantisation
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.prnu import Prnu
from simulators.effects.reciprocity_failure import ReciprocityFailure
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from simulators.effects.tile_moments import TileMoments
from testing.reduced import start_of

LADDER = [{"t": float(t), "d": d} for d in (0.9, 0.3) for t in np.geomspace(1e-4, 5e-3, 6)]


@pytest.fixture(scope="module")
def captured(make_capture: Callable[..., Any]) -> Any:
    """A bracket of a chart at two levels."""
    return make_capture(5, plan=LADDER)


@pytest.fixture(scope="module")
def plain(captured: Any) -> FitState:
    """The camera without any effect, fitted."""
    return start_of(captured)


@contextmanager
def derivatives_counted() -> Iterator[list[int]]:
    """Give a list that grows by one with every set of derivatives that is taken."""
    taken: list[int] = []
    real = NuisanceLayout.derivatives

    def counted(self: NuisanceLayout, *arguments: Any) -> Any:
        taken.append(1)
        return real(self, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NuisanceLayout, "derivatives", counted)
        yield taken


def uncertainty_of(state: FitState) -> Any:
    """Return the standard uncertainty of each effect parameter."""
    return np.sqrt(np.diag(state.fit.covariance))[-state.parameters.size :] * state.parameters.scale


def off_by(one: FitState, other: FitState) -> Any:
    """Return by how many of its uncertainties each effect parameter differs between two fits."""
    return np.abs(one.parameters.values - other.parameters.values) / uncertainty_of(other)


def test_a_fit_that_is_not_confirmed_ends_at_the_least_squares(plain: FitState) -> None:
    """Going on from where it ends moves nothing by a thirtieth of its uncertainty."""
    start = with_effects(plain, [ExposureTimeOffset(4e-6), ResponseNonlinearity(0.02)])
    near = coarse_fit(start)
    whole = refit(refit(near))
    assert start.cost - whole.cost > 100.0, "the start must lie far off"
    assert near.cost - whole.cost == pytest.approx(0.0, abs=0.01)
    assert (off_by(near, whole) < 0.03).all()


def test_settled_parameters_are_those_of_their_own_weights(plain: FitState) -> None:
    """Another round of new weights moves them by far less than they are known to."""
    found = converged_fit(coarse_fit(with_effects(plain, [ExposureTimeOffset(2e-6), Prnu(0.02)])))
    again = refit(reweighted(found))
    assert (off_by(found, again) < 0.1).all()


def test_what_is_next_to_is_followed_without_new_derivatives(plain: FitState) -> None:
    """All else follows an effect that is held, as in a fit of its own; the effect does not move."""
    state = refit(with_effects(plain, [ExposureTimeOffset(1e-6)]))
    held = ResponseNonlinearity(0.02)
    assert state.fit.effects.shape[1] == 1  # the derivatives that are used
    with derivatives_counted() as taken:
        found = refit_with(state, held)
    assert not taken
    assert found.effects[1] == held
    start = dataclasses.replace(with_effects(state, [*state.effects, held]), frozen=frozenset({1, 2}))
    fitted = refit(start)
    assert start.cost - fitted.cost > 10.0, "there must be something to follow"
    assert found.cost == pytest.approx(fitted.cost, abs=1e-3 * (start.cost - fitted.cost))
    assert found.effects[0].values()["offset_s"] == pytest.approx(fitted.effects[0].values()["offset_s"], abs=1e-8)


def test_columns_of_an_unknown_scene_are_what_each_rise_alone_changes(make_capture: Callable[..., Any]) -> None:
    """Both rises of all tiles are moved at once; each column is what its own figure does by itself."""
    captured = make_capture(6, plan=LADDER[:3], picture=lambda image, setting: image * np.linspace(0.7, 1.0, 96))
    header = captured.header.model_copy(update={"patches": ()})
    design = Design.of(header, captured.frames[0].shape)
    state = first_state(design, *reduce_frames(design, captured.frames.__getitem__))
    layout, tiles = state.layout, len(design.tiles)
    assert layout.free_scene
    jacobian = np.zeros((state.comparison.size, layout.size))
    block, at = state.nuisance_jacobian, state.values
    data = block.rows < state.comparison.size
    jacobian[block.rows[data]] = block.values[data][:, : layout.size]
    first = layout.size - 3 * tiles
    reported = dict.fromkeys(("slope_x", "slope_y", "spatial"), 0)
    for tile in range(0, tiles, 5):
        for number, name in enumerate(reported):
            column, step = first + number * tiles + tile, 1e-6
            moved = at.copy()
            moved[column] += step
            there = state.model.predict(layout.unpack(design, moved))
            change = -(state.comparison.residual(there) - state.plain_residual) / step
            cut = state.comparison.cuts[name]
            largest = np.abs(change[cut]).max()
            reported[name] += largest > 1.0
            assert jacobian[cut, column] == pytest.approx(change[cut], rel=5e-3, abs=1e-3 * largest + 1e-6)
    assert min(reported.values()) >= 3


@pytest.mark.parametrize("known", [True, False])
def test_a_patch_that_two_amplifiers_read_has_one_radiance(make_capture: Callable[..., Any], known: bool) -> None:
    """It is two tiles with separate statistics; its error moves the means of both as the derivatives state."""
    captured = make_capture(5, plan=LADDER[:3], known=known)
    (height, width), patch = captured.frames[0].shape, captured.header.patches[3]
    at = patch.x + patch.width // 2
    taps = (TapDescription(name="1", x=0, y=0, width=at, height=height),
            TapDescription(name="2", x=at, y=0, width=width - at, height=height))  # fmt: skip
    camera = captured.header.camera.model_copy(update={"taps": taps})
    design = Design.of(captured.header.model_copy(update={"camera": camera}), captured.frames[0].shape)
    parts = [n for n, tile in enumerate(design.tiles) if tile.name == patch.name]
    left, right = (design.tiles[n] for n in parts)
    assert left.x + left.width == at == right.x
    state = first_state(design, *reduce_frames(design, captured.frames.__getitem__))
    column, step, moved = len(state.layout.scalars) + 3, 1e-6, state.values.copy()
    moved[column] += step
    there = state.layout.unpack(design, moved)
    assert np.flatnonzero(there.log_radiance[0] != state.nuisance.log_radiance[0]).tolist() == parts
    assert np.ptp((state.model.radiance * np.exp(there.log_radiance))[0, parts]) == 0.0
    change = -(state.comparison.residual(state.model.predict(there)) - state.plain_residual) / step
    cut, block = state.comparison.cuts["mean"], state.nuisance_jacobian
    own = np.zeros(change.size)
    data = block.rows < change.size
    own[block.rows[data]] = block.values[data][:, column]
    assert own[cut] == pytest.approx(change[cut], rel=5e-3, abs=1e-3 * np.abs(change[cut]).max())


def test_length_of_a_tilt_is_that_of_its_tiles(plain: FitState) -> None:
    """The closed form is the length of the tilt over the very pixels."""
    across, down = slope_lengths(plain.design)
    for group in tile_groups(plain.design):
        assert across[group.index] == pytest.approx(group.slope_norm[0])
        assert down[group.index] == pytest.approx(group.slope_norm[1])


def test_moments_are_changed_as_by_their_constructor() -> None:
    """A copy with other values is what the constructor gives; the original stays."""
    before = TileMoments.exactly(np.ones((1, 2, 4)))
    after, built = before.changed(comb_step=4.0), dataclasses.replace(before, comb_step=4.0)
    assert vars(after).keys() == vars(built).keys()
    assert all(value is getattr(built, name) or value == 4.0 for name, value in vars(after).items())
    assert (before.comb_step, after.comb_step) == (1.0, 4.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        before.changed(comb_step=4.0).comb_step = 2.0  # type: ignore[misc]


def test_chain_goes_on_from_the_first_step_that_differs(plain: FitState) -> None:
    """What comes behind that step is the same as of a chain that runs anew, and steps in front of it are not run."""
    curved = with_effects(plain, (ExposureTimeOffset(4e-6), ResponseNonlinearity(0.01), Prnu(0.01)))
    here, model = curved.trace, curved.model
    stronger = (curved.effects[0], ResponseNonlinearity(0.02), curved.effects[2])
    nuisance = here.nuisance.with_off(log_responsivity=here.nuisance.off.log_responsivity + 0.01)
    for other, moved in ((model.with_effects(stronger), here.nuisance), (model, nuisance)):
        again, anew = other.trace(moved, here), other.trace(moved)
        kept = sum(a is b for a, b in zip(again.passed, here.passed, strict=True))
        assert 3 < kept < len(here.passed)
        assert all(
            np.array_equal(getattr(again.prediction, f), getattr(anew.prediction, f)) for f in ("mean", "spatial")
        )
        assert not np.array_equal(again.prediction.mean, here.prediction.mean)
    assert model.trace(here.nuisance, here) is here


def test_predictions_are_compared_with_one_another_as_with_the_data(plain: FitState) -> None:
    """Residuals of several predictions at once are those of each; what they expect alike differs by nothing at all."""
    effects = (ExposureTimeOffset(4e-6), Prnu(0.01))
    alone = np.stack([plain.comparison.residual(plain.predicted_with((effect,))) for effect in effects], axis=1)
    models = [(plain.model.with_effects((effect,)), plain.nuisance) for effect in effects]
    ((numbers, several),) = predict_several(models, plain.trace)
    assert plain.comparison.residual(several) == pytest.approx(alone[:, numbers], abs=1e-12)
    changes = -plain.moved_by([(effect,) for effect in effects])
    assert changes == pytest.approx(alone - plain.plain_residual[:, None], abs=1e-9)
    mean, spatial = (plain.comparison.cuts[name] for name in ("mean", "spatial"))
    assert changes[mean, 0].any()
    assert not changes[mean, 1].any()
    assert changes[spatial, 1].any()


def test_a_threshold_is_fitted_though_by_default_there_is_none(make_capture: Callable[..., Any]) -> None:
    """A power of −0.02 up to a millisecond is found from another power and threshold, within four u of both."""
    captured = make_capture(5, plan=LADDER * 2, exposure=lambda t: t * (min(t, 1e-3) / 1e-3) ** -0.02)
    found = converged_fit(refit(with_effects(start_of(captured), [ReciprocityFailure(-0.01, 6e-4)])))
    assert (abs(found.parameters.values - (-0.02, 1e-3)) < 4.0 * uncertainty_of(found)).all()


def test_what_jumps_is_fitted_anew_next_to_a_further_effect(make_capture: Callable[..., Any]) -> None:
    """Exposures are whole lines of 12 µs: next to an offset each has its true number of lines, which some had not."""
    captured = make_capture(5, plan=LADDER * 2, exposure=lambda t: 12e-6 * round(t / 12e-6), extra_dn=lambda s: 3.0)
    wrong = refit(with_effects(start_of(captured), [ExposureQuantisation(12.012e-6, 0.5)]))
    found = included(wrong, BlackLevelOffset(2.0))
    lines, before = (
        np.rint([setting["t"] / state.effects[0].values()["quantum_s"] for setting in LADDER])
        for state in (found, wrong)
    )
    true = np.rint([setting["t"] / 12e-6 for setting in LADDER])
    assert (lines == true).all()
    assert (before != true).any()


def test_a_black_level_that_is_taken_off_is_no_dark_frame(make_capture: Callable[..., Any]) -> None:
    """Darks without noise are none: the fit ends at a share of zero, and the entry is refused as a model, too."""
    start = start_of(make_capture(5, plan=LADDER, extra_dn=lambda s: -64.0))
    with pytest.raises(UnfitError, match="dark_frame_subtracted"):
        included(start, DarkFrameSubtracted(0.1, 0.0))
    assert [fit.effects for fit in start.models] == [()]

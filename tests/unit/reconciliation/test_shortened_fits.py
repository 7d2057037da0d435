"""Fits that are cut short where nothing is lost: where they end, and what they save."""

import dataclasses
from contextlib import contextmanager
from dataclasses import fields

import numpy as np
import pytest

from radiometer.data import TapDescription
from radiometer.reconciliation.descent import (
    UnfitError,
    coarse_fit,
    converged_fit,
    first_state,
    included,
    refit,
    refit_with,
)
from radiometer.reconciliation.design import Design, slope_lengths, tile_groups
from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.nuisances import NuisanceLayout
from radiometer.reconciliation.reduce import reduce_frames
from radiometer.reconciliation.state import reweighted, with_effects
from radiometer.reconciliation.tile_model import predict_several
from simulators.effects.tile_moments import TileMoments
from testing import effect_kinds as fx
from testing.reduced import start_of

LADDER = [{"t": float(t), "d": d} for d in (0.9, 0.3) for t in np.geomspace(1e-4, 5e-3, 6)]


@pytest.fixture(scope="module")
def captured(make_capture):
    """A bracket of a chart at two levels."""
    return make_capture(5, plan=LADDER)


@pytest.fixture(scope="module")
def plain(captured):
    """The camera without any effect, fitted."""
    return start_of(captured)


@contextmanager
def derivatives_counted():
    """Give a list that grows by one with every set of derivatives that is taken."""
    taken = []
    real = NuisanceLayout.derivatives

    def counted(self, *arguments):
        taken.append(1)
        return real(self, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NuisanceLayout, "derivatives", counted)
        yield taken


def uncertainty_of(state):
    """Return the standard uncertainty of each effect parameter."""
    return np.sqrt(np.diag(state.fit.covariance))[-state.parameters.size :] * state.parameters.scale


def off_by(one, other):
    """Return by how many of its uncertainties each effect parameter differs between two fits."""
    return np.abs(one.parameters.values - other.parameters.values) / uncertainty_of(other)


def test_fits_end_at_the_least_squares_of_their_own_weights(plain):
    """Going on moves nothing by a thirtieth of its uncertainty."""
    start = with_effects(plain, [fx.ExposureTimeOffset(4e-6), fx.ResponseNonlinearity(0.02)])
    near = coarse_fit(start)
    whole = refit(refit(near))
    assert start.cost - whole.cost > 100.0, "the start must lie far off"
    assert near.cost - whole.cost == pytest.approx(0.0, abs=0.01)
    assert (off_by(near, whole) < 0.03).all()
    found = converged_fit(coarse_fit(with_effects(plain, [fx.ExposureTimeOffset(2e-6), fx.Prnu(0.02)])))
    again = refit(reweighted(found))
    assert (off_by(found, again) < 0.1).all()


def test_what_is_next_to_is_followed_and_predictions_compared(plain):
    """As in a fit of its own; what models expect alike differs by nothing."""
    state = refit(with_effects(plain, [fx.ExposureTimeOffset(1e-6)]))
    held = fx.ResponseNonlinearity(0.02)
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
    effects = (fx.ExposureTimeOffset(4e-6), fx.Prnu(0.01))
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


def test_columns_of_an_unknown_scene_are_what_each_rise_alone_changes(make_capture):
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
def test_a_patch_that_two_amplifiers_read_has_one_radiance(make_capture, known):
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


def test_tilts_and_copies_of_moments_are_exact(plain):
    """The length over the very pixels; a copy is what the constructor gives."""
    across, down = slope_lengths(plain.design)
    for group in tile_groups(plain.design):
        assert across[group.index] == pytest.approx(group.slope_norm[0])
        assert down[group.index] == pytest.approx(group.slope_norm[1])
    before = TileMoments.exactly(np.ones((1, 2, 4)))
    after, built = before.changed(comb_step=4.0), dataclasses.replace(before, comb_step=4.0)
    assert vars(after).keys() == vars(built).keys()
    assert all(value is getattr(built, name) or value == 4.0 for name, value in vars(after).items())
    assert (before.comb_step, after.comb_step) == (1.0, 4.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        before.changed(comb_step=4.0).comb_step = 2.0


def test_chain_goes_on_from_the_first_step_that_differs(plain):
    """What comes behind that step is the same as of a chain that runs anew, and steps in front of it are not run."""
    curved = with_effects(plain, (fx.ExposureTimeOffset(4e-6), fx.ResponseNonlinearity(0.01), fx.Prnu(0.01)))
    here, model = curved.trace, curved.model
    stronger = (curved.effects[0], fx.ResponseNonlinearity(0.02), curved.effects[2])
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


def test_thresholds_lines_and_taken_off_black_are_fitted_to_their_end(make_capture):
    """Next to an offset each exposure has its true number of lines."""
    captured = make_capture(5, plan=LADDER * 2, exposure=lambda t: t * (min(t, 1e-3) / 1e-3) ** -0.02)
    found = converged_fit(refit(with_effects(start_of(captured), [fx.ReciprocityFailure(-0.01, 6e-4)])))
    assert (abs(found.parameters.values - (-0.02, 1e-3)) < 4.0 * uncertainty_of(found)).all()
    start = start_of(make_capture(5, plan=LADDER, extra_dn=lambda s: -64.0))
    with pytest.raises(UnfitError, match="dark_frame_subtracted"):
        included(start, fx.DarkFrameSubtracted(0.1, 0.0))
    assert [fit.effects for fit in start.models] == [()]
    captured = make_capture(5, plan=LADDER * 2, exposure=lambda t: 12e-6 * round(t / 12e-6), extra_dn=lambda s: 3.0)
    wrong = refit(with_effects(start_of(captured), [fx.ExposureQuantisation(12.012e-6, 0.5)]))
    found = included(wrong, fx.BlackLevelOffset(2.0))
    lines, before = (
        np.rint([setting["t"] / state.effects[0].values()["quantum_s"] for setting in LADDER])
        for state in (found, wrong)
    )
    true = np.rint([setting["t"] / 12e-6 for setting in LADDER])
    assert (lines == true).all()
    assert (before != true).any()


def test_fit_holds_a_parameter_though_a_term_before_it_falls_to_nothing(make_capture):
    """A ceiling's spread goes to zero, where the ceiling is sharp and has one parameter less; the veil stays held."""
    plan = [*({"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 6) for _ in range(2)), {"t": 1e-2, "shutter": "closed"}]
    captured = make_capture(seed=32, plan=plan)
    start = start_of(captured)
    added = with_effects(start, [fx.FullWellSaturation(9_000.0, 0.05), fx.VeilingGlare(0.01)])
    assert added.parameters.names == ("full_well_e", "spread_rel", "share")
    fitted = refit(dataclasses.replace(added, frozen=frozenset({2})))
    assert fitted.parameters.names == ("full_well_e", "share")
    assert fitted.effects[1] == fx.VeilingGlare(0.01)


# Models that walk the rest of a chain together expect what each of them does alone.


PLAN = [{"t": float(t), "d": d} for d in (0.9, 0.3) for t in np.geomspace(1e-4, 5e-3, 4)]
NOT_COMPARED = {"unrounded"}


@pytest.fixture(scope="module")
def named(make_capture):
    """A camera with an effect at either end of the chain."""
    captured = make_capture(5, plan=PLAN)
    plain = start_of(captured)
    return with_effects(plain, (fx.ExposureTimeOffset(4e-6), fx.ResponseNonlinearity(0.01), fx.BrighterFatter(0.005)))


def differing(expected, row, alone):
    """Return the statistics that one of several models expects otherwise than alone."""
    found = []
    for name in {entry.name for entry in fields(alone)} - NOT_COMPARED:
        by_itself, together = np.asarray(getattr(alone, name)), np.asarray(getattr(expected, name))
        own = together[row] if together.ndim > by_itself.ndim else together
        if not np.allclose(own, by_itself, rtol=1e-11, atol=1e-13):
            found.append(name)
    return found


@pytest.mark.parametrize("name", sorted(whole_catalogue()))
def test_every_entry_expects_the_same_next_to_others(named, name):
    """The starts of an entry behind one another, next to effects that the chain holds, and the entry itself changed."""
    kind, context = whole_catalogue()[name], named.model.context
    starts = (*kind.starts(context)[:3], *kind.covers(context)[:1])
    if not starts or not kind.usable(context):
        pytest.skip("these settings do not show it")
    there = with_effects(named, (*named.effects, starts[0]))  # as a step that the others go through together
    earlier = [(fx.ExposureTimeOffset(size), *there.effects[1:]) for size in (3e-6, 5e-6)]
    for state, sets in ((named, [(*named.effects, start) for start in starts]), (there, earlier)):
        models = [(state.model.with_effects(effects), state.trace.nuisance) for effects in sets]
        seen = []
        for numbers, expected in predict_several(models, state.trace):
            seen += numbers
            for row, number in enumerate(numbers):
                assert differing(expected, row, state.predicted_with(sets[number])) == []
        assert sorted(seen) == list(range(len(sets)))


def test_models_of_other_light_other_links_and_other_effects_go_together(named):
    """Each joins where its own steps end: at the scene, behind the converter, behind an effect; one is as the known."""
    known = named.trace.nuisance
    brighter = named.layout.unpack(named.design, named.values + 0.01)
    darker = known.with_off(log_gain=known.off.log_gain + 0.02)
    effects = named.effects
    models = [
        (named.model.with_effects((*effects, fx.Prnu(0.02))), known),
        (named.model, brighter),
        (named.model.with_effects((*effects, fx.MissingCodes(2.0))), known),
        (named.model, darker),
        (named.model, known),
        (named.model.with_effects((fx.DarkCurrent(40.0), *effects[:1])), known),
        (named.model.with_effects((*effects, fx.ImageLag(0.01))), brighter),
    ]
    groups = [*predict_several(models, named.trace)]
    assert len(groups) == 2  # one alone has a step of codes of its own
    assert sorted(number for numbers, _ in groups for number in numbers) == list(range(len(models)))
    for numbers, expected in groups:
        for row, number in enumerate(numbers):
            model, nuisance = models[number]
            assert differing(expected, row, model.predict(nuisance)) == []

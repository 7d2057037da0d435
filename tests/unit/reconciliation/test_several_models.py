"""Models that walk the rest of a chain together expect what each of them does alone."""

from dataclasses import fields

import numpy as np
import pytest

from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.fit.state import with_effects
from radiometer.reconciliation.tile_model import predict_several
from simulators.effects.brighter_fatter import BrighterFatter
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.image_lag import ImageLag
from simulators.effects.missing_codes import MissingCodes
from simulators.effects.prnu import Prnu
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from testing.reduced import start_of

PLAN = [{"t": float(t), "d": d} for d in (0.9, 0.3) for t in np.geomspace(1e-4, 5e-3, 4)]
NOT_COMPARED = {"unrounded"}


@pytest.fixture(scope="module")
def named(make_capture):
    """A camera with an effect at either end of the chain."""
    captured = make_capture(5, plan=PLAN)
    plain = start_of(captured)
    return with_effects(plain, (ExposureTimeOffset(4e-6), ResponseNonlinearity(0.01), BrighterFatter(0.005)))


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
    earlier = [(ExposureTimeOffset(size), *there.effects[1:]) for size in (3e-6, 5e-6)]
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
        (named.model.with_effects((*effects, Prnu(0.02))), known),
        (named.model, brighter),
        (named.model.with_effects((*effects, MissingCodes(2.0))), known),
        (named.model, darker),
        (named.model, known),
        (named.model.with_effects((DarkCurrent(40.0), *effects[:1])), known),
        (named.model.with_effects((*effects, ImageLag(0.01))), brighter),
    ]
    groups = [*predict_several(models, named.trace)]
    assert len(groups) == 2  # one alone has a step of codes of its own
    assert sorted(number for numbers, _ in groups for number in numbers) == list(range(len(models)))
    for numbers, expected in groups:
        for row, number in enumerate(numbers):
            model, nuisance = models[number]
            assert differing(expected, row, model.predict(nuisance)) == []

"""Other causes in place of those that were named."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.fit.covariance import fitted_parameters
from radiometer.reconciliation.fit.descent import converged_fit, refit
from radiometer.reconciliation.fit.full_fit import FullFits, UnfitError
from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.search.moves import better, simpler
from radiometer.reconciliation.search.screening import StartPool
from simulators.effects.angle_dependence import AngleDependence
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.fnumber_tstop_error import FnumberTstopError
from simulators.effects.gamma_enabled import GammaEnabled
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.veiling_glare import VeilingGlare
from testing.reduced import start_of

pytestmark = pytest.mark.long  # each runs a whole search


def _fitted(captured: Any, *effects: CatalogueEffect) -> FitState:
    start = start_of(captured)
    return converged_fit(refit(with_effects(start, effects)))


def _fall_off(picture: np.ndarray) -> np.ndarray:
    """Return what is left of light at the slope 0.3 of the corners' chief rays: cos⁴ of their angle."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in picture.shape)
    return 1.0 / (1.0 + 0.09 * (x**2 + y[:, None] ** 2) / (x[0] ** 2 + y[0] ** 2)) ** 2


def test_losses_by_slant_and_cone_are_one_effect(make_capture: Callable[..., Any]) -> None:
    """Pixels that lose slanting rays, and the rim of every cone by 0.15/N², are no lens with wrong stops."""
    captured = make_capture(picture=lambda image, s: image * _fall_off(image) * (1.0 - 0.15 / s["N"] ** 2))
    state = _fitted(captured, NaturalVignetting(0.05), FnumberTstopError(0.001))
    found = simpler(state, whole_catalogue())
    assert found is not None
    joined, effect = found
    assert effect.name == "angle_dependence"
    cone = fitted_parameters(joined)["angle_dependence"]["cone"]
    assert cone.u is not None
    assert cone.value == pytest.approx(0.15, abs=3.0 * cone.u)
    assert cone.value > 3.0 * cone.u


def test_fall_off_that_no_stop_changes_is_the_lens(make_capture: Callable[..., Any]) -> None:
    """Next to stops that are off by 2 % each, a fall-off at all of them alike needs no power of the f-number."""
    captured = make_capture(picture=lambda image, s: image * _fall_off(image) * 1.02 ** (2.0 * np.log2(s["N"] / 4.0)))
    stops = FnumberTstopError(0.02)
    plain = _fitted(captured, NaturalVignetting(0.05), stops)
    assert simpler(plain, whole_catalogue()) is None
    found = simpler(_fitted(captured, AngleDependence(0.1, 2.0, 0.01), stops), whole_catalogue())
    assert found is not None
    assert [effect.name for effect in found[0].effects] == ["fnumber_tstop_error", "natural_vignetting"]


def test_what_was_named_too_early_gives_way(make_capture: Callable[..., Any]) -> None:
    """Next to the veil that was found later, an offset of 0.9 DN predicts better than the exponent it was taken for."""
    captured = make_capture(picture=lambda image, s: 0.98 * image + 0.02 * image.mean(), extra_dn=lambda s: 0.9)
    names = ("black_level_offset", "black_level_drift", "gamma_enabled", "response_nonlinearity", "veiling_glare")
    entries = {name: whole_catalogue()[name] for name in names}
    found = better(_fitted(captured, GammaEnabled(1.002), VeilingGlare(0.02)), "gamma_enabled", entries, StartPool())
    assert found is not None
    state, effect = found
    assert effect.name == "black_level_offset"
    offset = fitted_parameters(state)["black_level_offset"]["offset_dn"]
    assert offset.u is not None
    assert offset.value == pytest.approx(0.9, abs=3.0 * offset.u)
    assert better(state, "black_level_offset", entries, StartPool()) is None


def test_what_cannot_be_fitted_takes_no_place(
    make_capture: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rival that the fit refuses leaves the name where it is, and ends no search."""

    def refused(*_: object, **__: object) -> FitState:
        raise UnfitError("black_level_offset")

    state = _fitted(make_capture(extra_dn=lambda s: 0.9), GammaEnabled(1.002), VeilingGlare(0.001))
    monkeypatch.setattr(FullFits, "included", refused)
    entries = {"black_level_offset": whole_catalogue()["black_level_offset"]}
    assert better(state, "gamma_enabled", entries, StartPool()) is None

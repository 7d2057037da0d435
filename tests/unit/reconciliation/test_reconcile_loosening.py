"""When a named effect takes a more flexible form, or gives way to another."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.fit.descent import converged_fit, fitted_parameters, refit
from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.search.localise import departing, localise
from radiometer.reconciliation.search.search import loosened, swapped
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.dark_current_nonuniformity import DarkCurrentNonuniformity
from simulators.effects.gamma_enabled import GammaEnabled
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.veiling_glare import VeilingGlare
from testing.reduced import start_of


def _with(effect: CatalogueEffect, captured: Any, *more: CatalogueEffect) -> FitState:
    state = start_of(captured)
    return converged_fit(refit(with_effects(state, [effect, *more])))


def _weaker(loss: float, onset: float) -> Callable[[Any, Any], Any]:
    """Return what hides a lamp that loses light beyond some drive only."""
    return lambda image, setting: image * (1.0 - loss * max(setting["d"] - onset, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize(("onset", "corrected"), [(1.0 / 3.0, True), (0.0, False)])
def test_droop_beyond_some_drive_takes_one_term_more(
    make_capture: Callable[..., Any], onset: float, corrected: bool
) -> None:
    """Light lost beyond a third of full drive leaves structure along the drive that a cubic law takes up; else none."""
    state = _with(LedThermalDroop(0.02, 0.01), make_capture(3, picture=_weaker(0.12, onset)))
    strange = departing(localise(state), state.effects)
    assert strange == (["led_thermal_droop"] if corrected else [])
    form = loosened(state, ["led_thermal_droop"])
    assert (form is not None) is corrected
    if form is not None:
        assert departing(localise(form), form.effects) == []


@pytest.mark.slow
def test_leaks_that_double_slowly_bring_their_own_doubling(make_capture: Callable[..., Any]) -> None:
    """A pattern of leaks that doubles every 10 K instead of 7 is found to do so within three of its uncertainties."""
    each = np.random.default_rng(5).gamma(4.0, 0.25, (64, 96)) - 1.0  # none leaks less than nothing
    darks = [{"t": t, "T": c, "shutter": "closed"} for t in (1.0, 3.0, 10.0) for c in (25.0, 35.0, 45.0)]
    plan = [*darks, *darks, *({"t": t} for t in (1e-3, 3e-3, 5e-3) for _ in range(2))]
    captured = make_capture(4, extra_e=lambda s: each * 2.0 ** ((s["T"] - 25.0) / 10.0) * s["t"], plan=plan)
    found = fitted_parameters(_with(DarkCurrentNonuniformity(0.6, doubling_K=7.2), captured))[
        "dark_current_nonuniformity"
    ]
    for name, truth in (("doubling_K", 10.0), ("sigma_e_per_s", 0.5)):
        u = found[name].u
        assert u is not None
        assert abs(found[name].value - truth) < 3.0 * u < 0.1 * truth


@pytest.mark.slow
def test_the_mean_of_uneven_leaks_is_the_dark_current_s(make_capture: Callable[..., Any]) -> None:
    """Log-normal leaks of 4 e-/s in the mean, doubling in 5 K: the rate takes the mean, the pattern none of it."""
    drawn = np.random.default_rng(6).lognormal(0.0, 0.5, (64, 96))
    leak = 4.0 * drawn / drawn.mean()
    darks = [{"t": t, "T": c, "shutter": "closed"} for t in (1.0, 3.0, 10.0) for c in (20.0, 25.0, 30.0)]
    plan = [*darks, *darks, *({"t": t} for t in (1e-3, 3e-3, 5e-3) for _ in range(2))]
    captured = make_capture(4, extra_e=lambda s: leak * 2.0 ** ((s["T"] - 25.0) / 5.0) * s["t"], plan=plan)
    parameters = fitted_parameters(_with(DarkCurrentNonuniformity(2.0, doubling_K=7.2), captured, DarkCurrent(3.0)))
    for name, key, truth in (
        ("dark_current", "rate_e_per_s", 4.0),
        ("dark_current", "doubling_K", 5.0),
        ("dark_current_nonuniformity", "sigma_e_per_s", float(leak.std())),
        ("dark_current_nonuniformity", "doubling_K", 5.0),
    ):
        found = parameters[name][key]
        assert found.u is not None
        assert abs(found.value - truth) < 4.0 * found.u < 0.15 * truth


@pytest.mark.slow
@pytest.mark.parametrize("uneven", [True, False])
def test_leaks_that_are_more_at_the_bottom_rise_over_the_sensor(make_capture: Callable[..., Any], uneven: bool) -> None:
    """Leaks that grow e-fold within a third of the rows: the pattern rises and bends as they do; else it is even."""
    drawn = np.random.default_rng(7).lognormal(0.0, 0.5, (64, 96))
    down = np.linspace(-1.0, 1.0, 64)[:, None]
    more = 0.8 * np.exp((down - 1.0) / 0.67) * uneven
    leak = 4.0 * drawn / drawn.mean() + more
    darks = [{"t": t, "T": c, "shutter": "closed"} for t in (1.0, 3.0, 10.0) for c in (20.0, 25.0, 30.0)]
    plan = [*darks, *darks, *({"t": t} for t in (1e-3, 3e-3, 5e-3) for _ in range(2))]
    captured = make_capture(4, extra_e=lambda s: leak * 2.0 ** ((s["T"] - 25.0) / 6.0) * s["t"], plan=plan)
    state = _with(DarkCurrentNonuniformity(2.0, doubling_K=7.2), captured, DarkCurrent(3.0))
    form = loosened(state)
    assert (form is not None) is uneven
    if form is not None:
        found = fitted_parameters(form)["dark_current_nonuniformity"]
        sigma = found["sigma_e_per_s"].value
        rise, bend = np.polynomial.legendre.legfit(down[:, 0], np.broadcast_to(more, (64, 1))[:, 0], 2)[1:]
        side = 64 / 96  # y runs from −1 to 1 over the longer side
        rises = (("rise_y", rise / sigma / side), ("bend_y", 1.5 * bend / sigma / side**2))
        for name, truth in (*rises, ("rise_x", 0.0), ("bend_x", 0.0)):
            assert found[name].u is not None
            assert abs(found[name].value - truth) < 4.0 * float(found[name].u or 0.0) < 0.5


@pytest.mark.slow
def test_what_was_named_too_early_gives_way(make_capture: Callable[..., Any]) -> None:
    """Next to the veil that was found later, an offset of 0.9 DN is likelier than the exponent named for it."""
    captured = make_capture(picture=lambda image, s: 0.98 * image + 0.02 * image.mean(), extra_dn=lambda s: 0.9)
    early = _with(GammaEnabled(1.002), captured, VeilingGlare(0.02))
    state, taken = swapped(early, {"gamma_enabled": (BlackLevelOffset(0.5),)})
    assert [*taken] == ["gamma_enabled"]
    assert {effect.name for effect in state.effects} == {"veiling_glare", "black_level_offset"}
    offset = fitted_parameters(state)["black_level_offset"]["offset_dn"]
    assert offset.u is not None
    assert offset.value == pytest.approx(0.9, abs=3.0 * offset.u)
    assert swapped(state, {"black_level_offset": (GammaEnabled(1.002),)}) == (state, {})

"""A response that bends, within the declared full well and beyond it."""

from __future__ import annotations

import numpy as np
import pytest

from simulators.effects.catalogue import well_e
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from testing.effect_context import effect_context

FILLS = np.array([0.0, 0.3, 1.0, 1.2, 1.67, 3.0])


@pytest.mark.parametrize(("a2", "a3"), [(0.018, -0.0025), (-0.02, 0.0), (0.0, 0.004)])
def test_the_curve_goes_on_beyond_the_declared_full_well(a2: float, a3: float) -> None:
    """S·(1 − a₂·z − a₃·z²) at every fill: a full well that is declared too small makes no kink."""
    context, effect = effect_context(), ResponseNonlinearity(a2=a2, a3=a3)
    signal = FILLS * well_e(context)
    np.testing.assert_allclose(effect.mean(signal, context), signal * (1 - a2 * FILLS - a3 * FILLS**2), rtol=1e-12)
    np.testing.assert_allclose(effect.slope(signal, context), 1 - 2 * a2 * FILLS - 3 * a3 * FILLS**2, rtol=1e-12)


@pytest.mark.parametrize(("a2", "a3"), [(0.3, 0.0), (0.5, 0.5), (-0.2, 0.2), (-0.5, -0.5), (0.0, 0.0)])
def test_more_light_never_gives_less(a2: float, a3: float) -> None:
    """Where the polynomial would fall, the response stays; far beyond it goes straight on; no light stays none."""
    context, effect = effect_context(), ResponseNonlinearity(a2=a2, a3=a3)
    signal = np.linspace(-0.1, 40.0, 4001) * well_e(context)
    bent = effect.mean(signal, context)
    assert np.all(np.diff(bent) >= -1e-9 * well_e(context))
    np.testing.assert_allclose(bent[signal < 0], signal[signal < 0], rtol=1e-9)
    assert effect.mean(np.zeros(1), context).item() == 0.0


@pytest.mark.parametrize(("a2", "a3"), [(0.02, 0.01), (0.3, 0.1), (-0.1, 0.05)])
def test_the_slope_is_that_of_the_curve(a2: float, a3: float) -> None:
    """Differences of the curve over a thousandth of a full well, next to its ends too, to 2e-3."""
    context, effect = effect_context(), ResponseNonlinearity(a2=a2, a3=a3)
    step = 1e-3 * well_e(context)
    signal = np.linspace(0.01, 6.0, 600) * well_e(context)
    rise = (effect.mean(signal + step, context) - effect.mean(signal - step, context)) / (2 * step)
    np.testing.assert_allclose(effect.slope(signal, context), rise, atol=2e-3)

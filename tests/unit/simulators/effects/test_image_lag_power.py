"""Image lag by a power of what was held: traps of many depths."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from simulators.effects.image_lag import ImageLag


def _left(lag: ImageLag, previous: float) -> float:
    context = SimpleNamespace(
        previous_e=np.array([[previous]]), camera=SimpleNamespace(full_well_e=10000.0), frames=None
    )
    return float(lag.mean(np.zeros((1, 1)), context)[0, 0])


@pytest.mark.parametrize(("power", "expected"), [(1.0, 80.0), (0.5, 40.0), (2.0, 320.0)])
def test_lag_by_a_power_goes_through_its_share_at_a_thousand_electrons(power: float, expected: float) -> None:
    """2 % of 1000 e- is 20 e- for every power; of 4000 e- it is 80 e- by a line, 40 by a root, 320 by a square."""
    lag = ImageLag(share=0.02, power=power)
    assert _left(lag, 1000.0) == pytest.approx(20.0)
    assert _left(lag, 4000.0) == pytest.approx(expected)
    assert _left(lag, 40000.0) == pytest.approx(20.0 * 10.0**power)  # no pixel holds more than its full well


def test_the_power_is_fitted_where_it_is_not_one() -> None:
    """The plain share alone is fitted of a line; a form of another power comes among its forms."""
    assert ImageLag(share=0.02).free() == ("share",)
    assert ImageLag(share=0.02, power=0.6).free() == ("share", "power")
    context = SimpleNamespace()
    assert any(form.power != 1.0 for form in ImageLag.covers(context))
    assert any(form.power != 1.0 for form in ImageLag(share=0.02).loosened(context))
    assert ImageLag(share=0.02, power=0.6).loosened(context) == ()

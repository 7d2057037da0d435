"""Fits of a display's curve: known parameters come back, and a plain gamma errs where there is black light."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.screen.transfer_models import MODELS, fit_transfer

LEVELS = np.linspace(0, 1, 33)


@pytest.mark.parametrize(
    ("name", "truth"),
    [
        ("gamma", (0.7, 2.3)),
        ("gamma_offset", (3e-4, 0.7, 2.1)),
        ("pelli_zhang1991", (2e-4, 0.05, 0.8, 2.4)),
    ],
)
def test_parameters_of_its_own_curve_come_back(name: str, truth: tuple[float, ...]) -> None:
    """Without noise the fit returns the parameters that made the curve."""
    values = MODELS[name].curve(np.array(truth), LEVELS)
    found = fit_transfer(name, LEVELS, values, np.full(33, 1e-7))
    assert tuple(found.parameters.values()) == pytest.approx(truth, rel=1e-4)
    assert found.max_rel < 1e-4


def test_too_few_levels_are_refused() -> None:
    """Four parameters need four levels; the message says so."""
    with pytest.raises(ValueError, match="at least 4 levels, not 3"):
        fit_transfer("pelli_zhang1991", [0, 0.5, 1], [0, 0.2, 1], [0.01, 0.01, 0.01])


def test_prediction_is_the_fitted_curve() -> None:
    """`predict` evaluates the model at any level."""
    found = fit_transfer("gamma", LEVELS, 2.0 * LEVELS**2.0, np.full(33, 1e-6))
    assert found.predict([0.5]) == pytest.approx([0.5], rel=1e-5)

"""How well the light repeats, from repeats of settings whose pixels are noisy in very different degrees."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from radiometer.reconcile.noise.repeatability import estimate_tau

SETTINGS, REPEATS, TAU = 16, 2, 1e-3


def _design(declared: float | None = None) -> SimpleNamespace:
    setting = np.repeat(np.arange(SETTINGS), REPEATS)
    source = SimpleNamespace(reproducibility_u_rel=declared)
    time = np.random.default_rng(1).permutation(setting.size) * 2.5
    return SimpleNamespace(setting_id=setting, timestamp_s=time, header=SimpleNamespace(source=source))


def _noise(most: float = 1.5e-2) -> np.ndarray:
    """Return the pixel noise of long to short exposures."""
    return np.repeat(np.geomspace(2e-4, most, SETTINGS), REPEATS)


def test_noisy_captures_do_not_hide_how_well_the_light_repeats() -> None:
    """Pairs of 16 exposures, the shortest 250 times as noisy as the longest: 100 of 100 sessions within a factor 3."""
    rng, noise = np.random.default_rng(5), _noise(5e-2)
    scales = (np.hypot(noise, TAU) * rng.standard_normal(noise.size) for _ in range(100))
    found = np.array([estimate_tau(_design(), scale, noise**2) for scale in scales]) / TAU
    assert np.all((found > 1 / 3) & (found < 3))
    assert 0.8 < np.median(found) < 1.2


def test_light_that_repeats_perfectly_leaves_next_to_nothing() -> None:
    """Where pixel noise explains all scatter, τ stays below a third of the best capture's noise."""
    rng, noise = np.random.default_rng(6), _noise()
    found = [estimate_tau(_design(), noise * rng.standard_normal(noise.size), noise**2) for _ in range(20)]
    assert np.median(found) < noise.min() / 3.0


def test_repeats_bound_what_effects_may_be_taken_for() -> None:
    """A deviation of whole settings by 2 % is none of the light's repeatability, which pairs tell to be 0.1 %."""
    rng, noise = np.random.default_rng(7), _noise(2e-3)
    of_settings = np.repeat(0.02 * rng.standard_normal(SETTINGS), REPEATS)
    scale = of_settings + np.hypot(noise, TAU) * rng.standard_normal(noise.size)
    assert estimate_tau(_design(), scale, noise**2) < 3e-3


def test_few_repeats_leave_it_to_what_is_stated() -> None:
    """With fewer than five degrees of freedom the stated reproducibility holds within a factor of two."""
    design = _design(declared=2e-3)
    design.setting_id = np.arange(design.setting_id.size)
    scale = 0.05 * np.random.default_rng(8).standard_normal(design.setting_id.size)
    assert estimate_tau(design, scale, _noise() ** 2) == pytest.approx(4e-3, rel=0.01)

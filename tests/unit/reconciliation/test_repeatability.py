"""How well the light repeats, from repeats of settings whose pixels are noisy in very different degrees."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from radiometer.reconciliation.noise.repeatability import _Repeats, estimate_tau

SETTINGS, REPEATS, TAU = 16, 2, 1e-3


def _design(declared: float | None = None) -> SimpleNamespace:
    setting = np.repeat(np.arange(SETTINGS), REPEATS)
    source = SimpleNamespace(reproducibility_u_rel=declared)
    time = np.random.default_rng(1).permutation(setting.size) * 2.5
    return SimpleNamespace(setting_id=setting, timestamp_s=time, jump_times_s=(), header=SimpleNamespace(source=source))


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


def test_only_lit_settings_that_were_repeated_tell_how_light_repeats() -> None:
    """Of four settings one was taken once and one has one lit capture: the others count, each about its own mean."""
    setting = np.array([0, 0, 1, 2, 2, 2, 3, 3])
    lit = np.array([True, True, True, True, False, True, True, False])
    design = SimpleNamespace(setting_id=setting, timestamp_s=np.arange(8.0), jump_times_s=())
    scale, variance = np.arange(8.0), np.arange(8.0) ** 2
    found = _Repeats._taken(design, scale, variance, lit, waves=False)
    assert found.taken.tolist() == [0, 1, 3, 5]
    assert found.scale.tolist() == [0.0, 1.0, 3.0, 5.0]
    assert found.variance.tolist() == [0.0, 1.0, 9.0, 25.0]
    assert found.basis.tolist() == [[1, 0], [1, 0], [0, 1], [0, 1]]
    assert found.freedom == 2
    none = _Repeats._taken(design, scale, variance, np.array([True, False] * 4), waves=False)
    assert none.freedom == 0

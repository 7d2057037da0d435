"""Of a camera that is as its model says, every statistic of reconcile scatters by what is stated of it."""

import math

import numpy as np
import pytest
from scipy.stats import kstest

from radiometer.data import Frame, FrameSettings
from radiometer.reconciliation.descent import converged_fit
from radiometer.reconciliation.design import COMB_PERIODS
from radiometer.reconciliation.localise import global_p_value, localise
from radiometer.reconciliation.state import with_effects
from radiometer.reconciliation.statistics import STATISTICS, honest_comb
from simulators.effects.registry import make_effect
from testing.reduced import start_of, taken

# The knife-edge's u holds an allowance for how sharp a border is, and an even chart of a sound sensor has no outliers.
STATED_LARGER = {"edge", "outliers"}
ROWS, COLUMNS, E_PER_DN = 64, 96, 2.6  # of the synthetic camera of conftest.py


def chi2_of(captured, *effects):
    """Return χ² and number of entries of each statistic, where these effects are part of the model."""
    state = start_of(captured)
    state = converged_fit(with_effects(state, list(effects)) if effects else state)
    rest = state.data_residual
    return {
        name: (float(rest[cut] @ rest[cut]), state.comparison.degrees(name))
        for name, cut in state.comparison.cuts.items()
    }


@pytest.fixture(scope="module")
def sound(make_capture):
    """Return χ² and entries summed over two sessions without any effect."""
    found = [chi2_of(make_capture(seed, 4)) for seed in (101, 102)]
    return {name: (sum(one[name][0] for one in found), sum(one[name][1] for one in found)) for name in STATISTICS}


@pytest.mark.parametrize("name", STATISTICS)
def test_a_statistic_scatters_by_its_stated_uncertainty(sound, name):
    """χ²/n is 1 within five of its own sigma, √(2/n), and the 5 % that the fitted levels of 24 patches take up."""
    squares, count = sound[name]
    assert count > 0
    allowed = 5.0 * math.sqrt(2.0 / count)
    assert squares / count < 1.0 + allowed
    if name not in STATED_LARGER:
        assert squares / count > 1.0 - allowed - 0.05


def gain(setting):
    """Return DN per electron at a setting's gain."""
    return float(10.0 ** (setting["g"] / 20.0) / E_PER_DN)


RNG = np.random.default_rng(20261126)
FIXED = {shape: RNG.standard_normal(shape) for shape in ((ROWS, 1), (1, COLUMNS), (ROWS, COLUMNS))}
HIDDEN = {
    "row_temporal_noise": (
        {"sigma_e": 4.0}, {"extra_dn": lambda s: 4.0 * gain(s) * RNG.standard_normal((ROWS, 1))}
    ),
    "excess_read_noise": (
        {"excess_e": 5.0}, {"extra_dn": lambda s: 5.0 * gain(s) * RNG.standard_normal((ROWS, COLUMNS))}
    ),
    "exposure_time_offset": ({"offset_s": 8e-6}, {"exposure": lambda t: t + 8e-6}),
    "row_pattern": ({"sigma_e": 4.0}, {"extra_dn": lambda s: 4.0 * gain(s) * FIXED[ROWS, 1]}),
    "column_pattern": ({"sigma_e": 4.0}, {"extra_dn": lambda s: 4.0 * gain(s) * FIXED[1, COLUMNS]}),
    "prnu": ({"sigma_rel": 0.01}, {"picture": lambda image, s: image * (1.0 + 0.01 * FIXED[ROWS, COLUMNS])}),
}  # fmt: skip


ALIKE = {"row_pattern", "excess_read_noise"}  # act as the column pattern and the rows' noise do


@pytest.mark.parametrize("name", [pytest.param(one, marks=pytest.mark.slow) if one in ALIKE else one for one in HIDDEN])
def test_statistics_scatter_as_stated_where_the_model_holds_the_effect(make_capture, name):
    """With the camera's true effect in the model nothing is left: χ²/n of all statistics is 1 within 6 sigma.

    Chance shifts of the tiles that a fixed pattern makes alike in all captures are fitted; profiles of its lines
    are nearly used up by them.
    """
    values, hooks = HIDDEN[name]
    found = chi2_of(make_capture(201, 4, **hooks), make_effect(name, values))
    own = {"row_pattern": "rows", "column_pattern": "columns"}.get(name)
    for block in STATISTICS:
        squares, count = found[block]
        allowed = 6.0 * math.sqrt(2.0 / max(count, 1)) + 0.1
        assert squares / max(count, 1) < 1.0 + allowed, block
        if count and block not in {*STATED_LARGER, own}:
            assert squares / count > 1.0 - allowed, block


# ---- scenes with dark parts ------------------------------------------------------------------------------------------

SCENE_READ_E, SCENE_E_PER_DN = 5.4, 5.95


def scene_with_dark_parts(seed, dark=8, step=1):
    """Return frames of a scene with dark columns of that width before tiles of 16, at three exposures."""
    rng = np.random.default_rng((seed, 20261127))
    lit = np.where(np.arange(96) % (2 * dark) < dark, 0.0, 1.0) * np.linspace(0.2, 1.0, 48)[:, None]
    frames = []
    for exposure_s in np.repeat([1e-3, 2e-3, 4e-3], 4):
        electrons = rng.poisson(1.2e6 * exposure_s * lit) + SCENE_READ_E * rng.standard_normal(lit.shape)
        dn = step * np.rint((64.0 + electrons / SCENE_E_PER_DN) / step)
        frames.append(Frame(dn.astype(np.uint16), 12, FrameSettings(exposure_s)))
    return taken(
        frames,
        conversion_gain_e_per_dn=SCENE_E_PER_DN,
        read_noise_e=SCENE_READ_E,
        black_level_dn=64.0,
        full_well_e=24_500.0,
    )


@pytest.mark.parametrize("dark", [pytest.param(8, marks=pytest.mark.long), 12])
def test_dark_parts_of_a_scene_are_no_disagreement(dark):
    """Tiles dark on a half, or on three quarters: p is as even from 0 to 1 as that of six sessions can be.

    Noise of one code leaves a comb in honest histograms, the same in all captures. The plane through a tile that is
    lit on a quarter is below zero on one side; the tile's noise is that of its light all the same.
    """
    chances = []
    for seed in range(6):
        state = start_of(scene_with_dark_parts(seed, dark))
        tests = localise(state)
        assert all(test.p_value > 0.05 for test in tests if test.block == "comb")
        chances.append(global_p_value(state, tests))
    assert kstest(chances, "uniform").pvalue > 0.01


def test_coarse_codes_show_and_dark_pixels_do_not():
    """Every second code missing is the largest disagreement; a comb at black is that of normal numbers."""
    tests = localise(start_of(scene_with_dark_parts(1, step=2)))
    assert tests[0].block == "comb"
    assert tests[0].log_p < -100.0
    state = start_of(scene_with_dark_parts(0))
    codes = np.rint(SCENE_READ_E / SCENE_E_PER_DN * np.random.default_rng(9).standard_normal(400_000))
    largest = [np.mean(np.cos(2.0 * np.pi * codes / period)) for period in COMB_PERIODS]
    stated = honest_comb(state.design, state.seen, state.prediction)
    np.testing.assert_allclose(np.sqrt(2.0) * stated, np.tile(largest, (len(stated), 1)), rtol=0.05, atol=0.005)

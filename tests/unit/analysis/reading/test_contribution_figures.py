"""Contributions to a reading's uncertainty and the fluctuation of the source, each worked out by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.analysis.reading.contributions import _pattern, scale_u_rel
from radiometer.analysis.reading.estimate import _fluctuation, _variances
from radiometer.analysis.signal.dark import DarkLevel


def patch_of(pixel_rates: Any, prnu_u_rel: float, u_pixel: float = 0.0, rate: float = 10.0) -> Any:
    return SimpleNamespace(
        estimate=SimpleNamespace(pixel_rates=np.asarray(pixel_rates), u_pixel=u_pixel, rate=rate),
        good=np.ones(np.shape(pixel_rates), bool),
        stated=SimpleNamespace(prnu_u_rel=prnu_u_rel),
        scale=2.0,
    )


CHECKS = 10.0 + 0.3 * np.array([[1, -1, 1], [-1, 1, -1], [1, -1, 1]])


@pytest.mark.parametrize(
    ("prnu_u_rel", "each"), [(0.0, 0.3 * math.sqrt(2.0)), (0.03, 0.3 * math.sqrt(2.0)), (0.1, 1.0)]
)
def test_a_small_patch_has_the_larger_of_what_it_shows_and_what_is_stated(prnu_u_rel: float, each: float) -> None:
    """Nine pixels of 10 ± 0.3 in a chequer: neighbours differ by 0.6, over √2; or 3 % or 10 % of 10 as stated."""
    term = _pattern(patch_of(CHECKS, prnu_u_rel), 9)
    assert term.u == pytest.approx(2.0 * each / 3.0)


def test_what_the_noise_explains_is_no_pattern() -> None:
    """Of a scatter of 0.424 the noise model explains 0.4: √(0.18 − 0.16) is left."""
    term = _pattern(patch_of(CHECKS, 0.0, u_pixel=0.4), 9)
    assert term.u == pytest.approx(2.0 * math.sqrt(0.18 - 0.16) / 3.0)


@pytest.mark.parametrize(
    ("shares_level", "budget", "left"),
    [
        (False, {}, 0.13),
        (False, {"exposure time": 0.05, "response curve": 0.04}, 0.12),
        (True, {"exposure time": 0.03, "response curve": 0.04}, 0.12),
        (True, {"exposure time": 0.2}, 0.0),
    ],
)
def test_what_a_reading_shares_with_its_calibration_counts_once(shares_level: bool, budget: Any, left: float) -> None:
    """13 % without 5 % of the clock are 12 %; at the calibration's level the curve's 4 % drop out as well."""
    scale = SimpleNamespace(u_rel=0.13, budget=budget)
    situation: Any = SimpleNamespace(calibration=SimpleNamespace(scale=scale), shares_level=shares_level)
    assert scale_u_rel(situation) == pytest.approx(left)


def test_all_that_is_doubtful_of_the_dark_level_explains_differences_of_frames() -> None:
    """0.3 of its own and 0.4 shared: variance 0.25 in the signal's unit squared; the curve's 2 % of 50 are 1."""
    model: Any = SimpleNamespace(
        variance=lambda signal, _: signal + 4.0,
        u_rel=np.full(3, 0.02),
        at_dn=lambda values, _: values[0],
        dn_of=lambda signal, _: signal,
        black_of=lambda _: 0.0,
        black_dn=0.0,
    )
    frame: Any = SimpleNamespace(settings=None)
    expected, single, curve, dark = _variances(5.0, [frame], [DarkLevel(1.0, 0.3, 0.4, "")], np.array([10.0]), model)
    assert [float(one[0]) for one in (expected, single, curve, dark)] == pytest.approx([50.0, 54.0, 1.0, 0.25])


@pytest.mark.parametrize("count", [2, 3, 6])
def test_fluctuation_is_the_sample_s_standard_deviation(count: int) -> None:
    """Without noise: s with n − 1, not n, to half a step of the search (12 % each)."""
    rng = np.random.default_rng(count)
    rates = 1.0 + 0.05 * rng.standard_normal(count)
    exposures = np.full(count, 7.0)
    found, evidence = _fluctuation(rates * 7.0, exposures, np.full(count, 1e-12), 1.0)
    assert found == pytest.approx(float(rates.std(ddof=1)), rel=0.065)
    assert evidence > 25.0

"""One rolling-shutter frame without a flat: fall-off and light of few periods are told apart, as far as u says."""

import numpy as np
import pytest

from radiometer.analysis.flicker import Flicker, measure_flicker, waveform_of_rows
from radiometer.typing import Array

ROWS_PER_PERIOD, DEPTH = 250, 0.3
TRUE = {"modulation_depth": DEPTH, "flicker_index": DEPTH / np.pi, "svm": 1.17061}


def measured(rows: Array, noise: np.random.Generator) -> Flicker:
    """Return the measures of a frame whose rows have these digital numbers above black on average."""
    light = 64.0 + rows[:, None] * np.ones((1, 16))
    pixels = np.round(noise.normal(light, np.sqrt(light / 2.0)))
    return measure_flicker(waveform_of_rows(pixels, 40e-6, 1e-7, "frame", 64.0))


def falls_off(kind: str, at: Array) -> Array:
    """Return the fall-off over the rows, cos⁴ of the angle."""
    tangent = {"none": 0.0 * at, "usual": 0.3 * at, "deep": 0.6 * at, "beside the middle": 0.4 * (at - 0.3)}[kind]
    return np.asarray((1.0 + tangent**2) ** -2)


@pytest.mark.parametrize("periods", [2, 2.4, 8])
def test_the_truth_is_within_u_of_a_frame_without_a_flat(periods: float) -> None:
    """Over fall-offs and phases: nearly all of the figures are within U, and none is off by twice that.

    With half of that U a third of these 24 figures would be outside.
    """
    index, noise, off = np.arange(round(periods * ROWS_PER_PERIOD)), np.random.default_rng(48_009), list[float]()
    for n, kind in enumerate(("none", "usual", "deep", "beside the middle")):
        for phase in ((0.0, 0.5), (0.25, 0.8))[n % 2]:
            light = 1.0 + DEPTH * np.sin(2.0 * np.pi * (index / ROWS_PER_PERIOD + phase))
            found = measured(3000.0 * light * falls_off(kind, np.linspace(-1.0, 1.0, index.size)), noise)
            for name, true in TRUE.items():
                one = getattr(found, name)
                off.append(abs(one.value - true) / (found.coverage_factor * one.u))
    assert np.mean(np.array(off) <= 1.0) >= 0.93
    assert max(off) < 2.0


def test_light_of_less_than_two_periods_may_be_a_fall_off() -> None:
    """No figure then excludes that the rows show the light itself."""
    at = np.linspace(-1.0, 1.0, 600)
    found = measured(3000.0 * (1.0 - 0.3 * at**2), np.random.default_rng(48_010))
    one = found.modulation_depth
    assert abs(one.value - 0.3 / 1.7) < found.coverage_factor * one.u
    assert found.svm.u > 0.0

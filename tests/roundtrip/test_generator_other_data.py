"""The generator's other kinds of data have the forms that the world uses and the physics that they claim."""

import itertools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from testing.generator.other_data import write_emva_set, write_photographs


def _emva_steps(descriptor: Path) -> list[tuple[str, float, list[np.ndarray]]]:
    steps: list[tuple[str, float, list[np.ndarray]]] = []
    for line in descriptor.read_text().splitlines():
        kind, *rest = line.split()
        if kind in "bd":
            steps.append((kind, float(rest[-1]), []))
        elif kind == "i":
            steps[-1][2].append(cv2.imread(str(descriptor.parent / rest[0].replace("\\", "/")), cv2.IMREAD_UNCHANGED))
    return steps


def test_emva_set_gives_the_declared_gain_by_the_standards_own_method(tmp_path: Path) -> None:
    """The photon-transfer slope of the pairs (EMVA 1288 equations 18-20) is 1/2.6 DN per electron within 4 sigmas."""
    steps = _emva_steps(write_emva_set(tmp_path / "emva", camera_seed=1))
    bright = [(a.mean() + b.mean(), ((a.astype(float) - b) ** 2).mean() / 2) for k, _, (a, b) in steps if k == "b"]
    means, variances = np.array(bright).T
    use = (means / 2 > 500) & (means / 2 < 3500)
    slopes = variances[use] / (means[use] / 2 - 240 + 2.4**2 / 2.6)
    sigma = (1 / 2.6) * math.sqrt(2 / (96 * 144) / use.sum())
    assert slopes.mean() == pytest.approx(1 / 2.6, abs=4 * sigma)


def test_photographs_of_exact_stops_are_one_stop_apart_where_labels_are_not(tmp_path: Path) -> None:
    """Real exposures are exact powers of two; printed ones are not."""
    truth = write_photographs(tmp_path / "stack", seed=2)
    ratios = [b / a for a, b in itertools.pairwise(truth["real_s"])]
    assert ratios == pytest.approx([0.5] * 8) or ratios == pytest.approx([2.0] * 8)
    assert any(
        abs(b / a / r - 1) > 0.02 for (a, b), r in zip(itertools.pairwise(truth["printed_s"]), ratios, strict=True)
    )

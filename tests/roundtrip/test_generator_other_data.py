"""The generator's other kinds of data have the forms that the world uses and the physics that they claim."""

import csv
import io
import itertools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from testing.generator.other_data import LIGHT_METER_CSV, write_emva_set, write_photographs


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


def test_emva_photons_times_quantum_efficiency_are_the_electrons(tmp_path: Path) -> None:
    """The stated photons give the declared 62 % within the noise of the frames' mean."""
    steps = _emva_steps(write_emva_set(tmp_path / "emva", camera_seed=1))
    photons, mean = next((p, np.mean(frames)) for k, p, frames in steps if k == "b" and p > 5000)
    electrons = (mean - 240) * 2.6
    assert electrons / photons == pytest.approx(0.62, abs=4 * math.sqrt(electrons / (2 * 96 * 144)) / photons)


def test_light_meter_table_holds_the_six_constants_of_the_thesis() -> None:
    """K = L t S / N² of the rows is that of the thesis's table."""
    found = []
    for row in csv.DictReader(io.StringIO(LIGHT_METER_CSV)):
        above, below = row["time"].split("/")
        t = float(above) / float(below)
        found.append(float(row["luminance"]) * t * float(row["iso"]) / float(row["f_number"]) ** 2)
    assert [round(k, 4) for k in found] == [16.6016, 18.0697, 18.3824, 14.3029, 15.1786, 16.4706]


def test_photographs_of_exact_stops_are_one_stop_apart_where_labels_are_not(tmp_path: Path) -> None:
    """Real exposures are exact powers of two; printed ones are not."""
    truth = write_photographs(tmp_path / "stack", seed=2)
    ratios = [b / a for a, b in itertools.pairwise(truth["real_s"])]
    assert ratios == pytest.approx([0.5] * 8) or ratios == pytest.approx([2.0] * 8)
    assert any(
        abs(b / a / r - 1) > 0.02 for (a, b), r in zip(itertools.pairwise(truth["printed_s"]), ratios, strict=True)
    )


def test_wrong_label_is_that_of_the_next_photograph(tmp_path: Path) -> None:
    """One line of exposures.txt repeats its neighbour's time."""
    write_photographs(tmp_path / "stack", seed=2, wrong_label=4)
    lines = (tmp_path / "stack" / "exposures.txt").read_text().split("\n")
    assert lines[4].split()[1] == lines[5].split()[1]

"""Real measured greys: what models and the table miss of them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from radiometer.screen.interpolation import LevelTable
from radiometer.screen.transfer_models import fit_transfer


def _dell(shared_data: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return drive and luminance of a Dell U2412M's greys (SpyderX), repeats averaged."""
    file = next((shared_data / "displays").glob("*gray_luminance.csv"))
    rows = list(csv.DictReader(file.read_text().splitlines()))
    drive, value = (np.array([float(r[k]) for r in rows]) for k in ("drive_percent", "Y_cd_m2"))
    levels = np.unique(drive)
    return levels / 100, np.array([value[drive == n].mean() for n in levels])


def _oled(shared_data: Path) -> tuple[np.ndarray, np.ndarray]:
    table = np.genfromtxt(shared_data / "displays" / "isetbio" / "OLED-Sony_gamma.csv", delimiter=",", names=True)
    return table["level"] / table["level"][-1], 157.1 * table["gray"]


def _left_out(levels: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the relative error at each inner level of a table without it."""
    errors = []
    for i in range(1, len(levels) - 1):
        keep = np.arange(len(levels)) != i
        errors.append(float(LevelTable(levels[keep], values[keep]).at(levels[i])) / values[i] - 1)
    return np.array(errors)


def test_table_meets_left_out_levels_of_a_real_monitor(shared_data: Path) -> None:
    """Of the greys above 2 % of white 85 % are met within 0.5 % when left out, their rms is below 0.35 %.

    What is missed alternates in sign from level to level: the monitor's own steps, which no smooth curve follows
    (worst 0.9 %). Below 2 % of white the colorimeter repeats no better than some hundredths of a cd/m². In units of
    white every level is met within 0.5 %.
    """
    levels, values = _dell(shared_data)
    errors, inner = _left_out(levels, values), values[1:-1]
    bright = np.abs(errors[inner > 0.02 * values[-1]])
    assert np.mean(bright < 0.005) >= 0.85
    assert np.sqrt(np.mean(bright**2)) < 0.0035
    assert bright.max() < 0.009
    assert np.abs(errors * inner).max() < 0.005 * values[-1]


def test_table_meets_left_out_levels_of_an_oled(shared_data: Path) -> None:
    """With every eighth of 1024 levels in the table, the middles of the gaps are met within 0.3 % rms above 1 %."""
    levels, values = _oled(shared_data)
    table = LevelTable(levels[::8], values[::8])
    middle = slice(4, 1020, 8)
    bright = values[middle] > 0.01 * values[-1]
    error = (table.at(levels[middle]) / np.maximum(values[middle], 1e-12) - 1)[bright]
    assert np.sqrt(np.mean(error**2)) < 0.003
    assert np.mean(np.abs(error) < 0.005) > 0.9


def test_models_errors_on_a_real_monitor_are_ranked(shared_data: Path) -> None:
    """A plain gamma errs by more than 50 % near black; Pelli–Zhang's worst error is at least five times less."""
    levels, values = _dell(shared_data)
    u = np.hypot(0.02, 0.001 * values)
    plain, best = (fit_transfer(n, levels, values, u) for n in ("gamma", "pelli_zhang1991"))
    assert plain.max_rel > 0.5
    assert best.max_rel < plain.max_rel / 5
    assert best.max_of_peak == pytest.approx(0.0, abs=0.02)

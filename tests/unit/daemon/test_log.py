"""The log of a journal that holds readings of several places: each has its own mean, and its own line in a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import radiometer as rm
from radiometer.cli.main import run
from radiometer.daemon.journal import Journal
from radiometer.data import Patch, Quantity, Reading


@pytest.fixture
def journal(tmp_path: Path, make_reading: Callable[..., Reading]) -> Path:
    """Return a journal of a wall at 0.30 and, read once in between, a lamp at 0.90."""
    places = [(0.300, Patch(1, 2, 3, 4)), (0.90, Patch(50, 60, 7, 8)), (0.303, Patch(1, 2, 3, 4))]
    with Journal(tmp_path / "j.sqlite") as written:
        for value, patch in places:
            written.append([make_reading(radiance=Quantity(value, 0.003, "W sr-1 m-2"), patch=patch)])
    return tmp_path / "j.sqlite"


def test_readings_of_another_place_do_not_count_in_a_mean(journal, capsys):
    """The wall's standard deviation is 0.0021 (0.7 %), not the 69 % of all three; the lamp has its own line."""
    assert run(["log", str(journal)]) == 0
    wall, lamp = capsys.readouterr().out.splitlines()[-2:]
    assert wall.startswith("patch 1,2 3 × 4: 2 readings")
    assert wall.endswith("mean 0.3015, standard deviation 0.0021 (0.7 %)")
    assert lamp.startswith("patch 50,60 7 × 8: 1 readings")


def test_each_place_is_a_line_of_its_own_in_the_picture(journal, tmp_path):
    """Two lines with a name each; a name without a picture's ending is refused."""
    lines = rm.log(journal).plot().get_lines()
    assert [line.get_label() for line in lines] == ["patch 1,2 3 × 4", "patch 50,60 7 × 8"]
    rm.log(journal).write_plot(tmp_path / "log.png")
    assert (tmp_path / "log.png").stat().st_size > 1000
    with pytest.raises(rm.UsageError, match=r"one of \.png"):
        rm.log(journal).write_plot(tmp_path / "log.txt")

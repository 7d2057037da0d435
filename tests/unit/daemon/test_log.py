"""The log of a journal that holds readings of several places: each has its own mean, and its own line in a picture."""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
import structlog

import radiometer as rm
from radiometer.cli.main import run
from radiometer.daemon.journal import Journal
from radiometer.daemon.serving import LogThrottle
from radiometer.data import Patch, Quantity, Reading


@pytest.fixture
def journal(tmp_path: Path, make_reading: Callable[..., Reading]) -> Path:
    """Return a journal of a wall at 0.30 and, read once in between, a lamp at 0.90."""
    places = [(0.300, Patch(1, 2, 3, 4)), (0.90, Patch(50, 60, 7, 8)), (0.303, Patch(1, 2, 3, 4))]
    with Journal(tmp_path / "j.sqlite") as written:
        for value, patch in places:
            written.append([make_reading(radiance=Quantity(value, 0.003, "W sr-1 m-2"), patch=patch)])
    return tmp_path / "j.sqlite"


def test_readings_of_another_place_do_not_count_in_a_mean(journal, capsys, monkeypatch):
    """The wall's standard deviation is 0.0021 (0.7 %), not the 69 % of all three; the lamp has its own line."""
    monkeypatch.setenv("COLUMNS", "160")
    assert run(["log", str(journal)]) == 0
    *table, wall, lamp = capsys.readouterr().out.splitlines()
    assert [("1,2 3" in line, "50,60" in line) for line in table[1:]] == [(True, False), (False, True), (True, False)]
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


@pytest.mark.parametrize("library", [False, True])
def test_a_flood_is_ten_lines_a_minute_and_a_count(library: bool) -> None:
    """61 000 equal lines in a minute become 20 and a count; each different line is written."""
    now = [0.0]
    throttle = LogThrottle(clock=lambda: now[0])
    lines: list[str] = []

    def say(text: str) -> None:
        if library:
            record = logging.LogRecord("asyncio", logging.WARNING, "", 0, text, None, None)
            lines.extend([record.getMessage()] if throttle.filter(record) else [])
        else:
            try:
                lines.append(str(throttle(None, "warning", {"event": text})))
            except structlog.DropEvent:
                return

    for second in range(61):
        now[0] = float(second)
        for _ in range(1000):
            say("client refused")
        say(f"alarm {second}")
    assert sum("client refused" in line for line in lines) == 20
    assert sum("59990" in line for line in lines) == 1
    assert sum("alarm" in line for line in lines) == 61


def test_an_installed_throttle_bounds_what_is_written(capsys: pytest.CaptureFixture[str]) -> None:
    """Of a hundred equal events ten lines reach standard error; what differs does too."""
    before = structlog.get_config()["processors"]
    try:
        LogThrottle().install()
        for _ in range(100):
            structlog.get_logger().warning("refused")
        structlog.get_logger().warning("another")
        assert len(capsys.readouterr().err.splitlines()) == 11
    finally:
        structlog.configure(processors=before)


@pytest.mark.parametrize("damage", ["{", "[" * 100_000, '{"time": "2026"}', b"\x00"])
def test_a_damaged_row_is_left_out_and_counted(journal, capsys, damage):
    """The other readings are shown."""
    with sqlite3.connect(journal) as connection:
        connection.execute("UPDATE readings SET json = ? WHERE sequence = 2", (damage,))
    assert run(["log", str(journal)]) == 0
    printed = capsys.readouterr()
    assert "1 rows of the journal are damaged" in printed.err
    assert "patch 1,2 3 × 4: 2 readings" in printed.out

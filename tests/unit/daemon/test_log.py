"""The log of a journal that holds readings of several places: each has its own mean, and its own line in a picture."""

from __future__ import annotations

import datetime as dt
import logging
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import structlog

import radiometer as rm
from radiometer.cli.main import run
from radiometer.daemon.journal import Journal
from radiometer.daemon.patches import NamedPatch, PatchLimits
from radiometer.daemon.serving import LogThrottle
from radiometer.data import Flag, Patch, Quantity, Reading


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
    assert [("1,2 3" in line, "50,60" in line) for line in table[2:]] == [(True, False), (False, True), (True, False)]
    assert wall.startswith("patch 1,2 3 × 4: 2 readings")
    assert wall.endswith("mean 0.3015, standard deviation 0.0021 W·sr⁻¹·m⁻² (0.7 %)")
    assert lamp.startswith("patch 50,60 7 × 8: 1 readings")


def test_each_place_is_a_line_of_its_own_in_the_picture(journal, tmp_path):
    """Two lines with a name each; a name without a picture's ending is refused."""
    lines = rm.log(journal).plot().get_lines()
    assert [line.get_label() for line in lines] == ["patch 1,2 3 × 4", "patch 50,60 7 × 8"]
    rm.log(journal).write_plot(tmp_path / "log.png")
    assert (tmp_path / "log.png").stat().st_size > 1000
    with pytest.raises(rm.UsageError, match=r"one of \.png"):
        rm.log(journal).write_plot(tmp_path / "log.txt")


def hours(make_reading: Callable[..., Reading], *minutes: float, **how: object) -> list[Reading]:
    """Return readings of 0.3 W·sr⁻¹·m⁻² at minutes of one day."""
    start = dt.datetime(2026, 11, 20, 8, tzinfo=dt.UTC)
    times = [(start + dt.timedelta(minutes=m)).isoformat(timespec="milliseconds") for m in minutes]
    return [make_reading(radiance=Quantity(0.3, 0.004, "W sr-1 m-2"), time=at, **how) for at in times]


def test_a_line_and_its_band_end_where_the_readings_pause(tmp_path, make_reading):
    """A reading a minute, an hour without, one alone, an hour, and more: two pieces and a dot, nothing between."""
    with Journal(tmp_path / "j.sqlite") as written:
        written.append(hours(make_reading, 0, 1, 2, 3, 4, 63, 123, 124, 129, 130))
    axes = rm.log(tmp_path / "j.sqlite").plot()
    line, dot = axes.get_lines()
    assert [int(np.isnan(v)) for v in line.get_ydata()] == [0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0]
    assert (list(dot.get_ydata()), dot.get_linestyle()) == ([0.3], "None")
    (band,) = axes.collections
    assert len(band.get_paths()) >= 2


@pytest.mark.parametrize(
    ("limits", "drawn", "legend"),
    [
        (PatchLimits(0.29, 0.31), [0.29, 0.31], "lamp (limits 0.29 to 0.31)"),
        (PatchLimits(high=0.305), [0.305], "lamp (limits none to 0.305)"),
        (PatchLimits(low=0.0), [], "lamp (limits 0 to none)"),
        (PatchLimits(low=9.0), [9.0], "lamp (limits 9 to none)"),
        (PatchLimits(high=0.01), [0.01], "lamp (limits none to 0.01)"),
        (PatchLimits(high=0.305, unit="relative"), [], "lamp"),
        (PatchLimits(), [], "lamp"),
    ],
)
def test_limits_are_in_the_picture_where_they_are_near_and_named_always(tmp_path, make_reading, limits, drawn, legend):
    """Those of a patch with a name and of its unit; one far from its readings only where the newest is beyond it."""
    with Journal(tmp_path / "j.sqlite") as written:
        written.append(hours(make_reading, 0, 1, 2, name="lamp"))
        written.keep_patch("lamp", NamedPatch("lamp", Patch(1, 2, 3, 4), limits).to_json())
    axes = rm.log(tmp_path / "j.sqlite").plot()
    line, *dashed = axes.get_lines()
    bottom, top = axes.get_ylim()
    assert line.get_label() == legend
    assert [bound for one in dashed if bottom < (bound := one.get_ydata()[0]) < top] == drawn


def test_limits_far_from_their_readings_are_drawn_where_another_patch_is_there(tmp_path, make_reading):
    """A patch that reads nothing widens the picture to 0: the low limit of the bright one lies in it."""
    with Journal(tmp_path / "j.sqlite") as written:
        written.append(hours(make_reading, 0, 1, 2, name="lamp"))
        dark = hours(make_reading, 3, 4, name="dark")
        written.append([replace(one, radiance=Quantity(0.0, 0.004, "W sr-1 m-2")) for one in dark])
        written.keep_patch("lamp", NamedPatch("lamp", Patch(1, 2, 3, 4), PatchLimits(low=0.1)).to_json())
    axes = rm.log(tmp_path / "j.sqlite").plot()
    bottom, top = axes.get_ylim()
    assert bottom < 0.1 < top
    assert [0.1, 0.1] in [list(line.get_ydata()) for line in axes.get_lines()]


def test_limits_of_the_patch_for_all_are_of_where_it_is_now(tmp_path, make_reading):
    """It was moved, and a client measured for itself since; neither has limits."""
    with Journal(tmp_path / "j.sqlite") as written:
        written.append(hours(make_reading, 0, 1, patch=Patch(1, 2, 3, 4)))
        written.append(hours(make_reading, 2, 3, patch=Patch(50, 60, 7, 8)))
        written.append(hours(make_reading, 4, 5, patch=Patch(9, 9, 9, 9), session="web"))
        written.keep_patch("main", NamedPatch("main", Patch(0, 0, 0, 0), PatchLimits(high=0.31)).to_json())
        written.keep_patch("damaged", "{")
    labels = [line.get_label() for line in rm.log(tmp_path / "j.sqlite").plot().get_lines()]
    assert [label for label in labels if "limits" in label] == ["patch 50,60 7 × 8 (limits none to 0.31)"]


@pytest.mark.parametrize("mixed", [False, True])
def test_dates_units_and_numbers_stay_whole_in_80_columns(tmp_path, make_reading, capsys, monkeypatch, mixed):
    """Places and flags are folded; unit and k are in the heading, or columns where readings differ in them."""
    monkeypatch.setenv("COLUMNS", "80")
    lux = Quantity(103.2, 0.9, "cd m-2")
    many = {"luminance": lux, "flags": (Flag.FLICKER, Flag.SATURATED)}
    with Journal(tmp_path / "j.sqlite") as written:
        written.append(hours(make_reading, 0, 1, name="lamp", **many))
        written.append(hours(make_reading, 2, patch=Patch(800, 600, 120, 120), **many))
        if mixed:
            written.append([make_reading(radiance=Quantity(2.0, 0.1, "relative"), coverage_factor=2.87)])
    assert run(["log", str(tmp_path / "j.sqlite")]) == 0
    printed = capsys.readouterr().out
    assert printed.count("2026-11-20 08:0") == 3
    for whole in (
        "W·sr⁻¹·m⁻²",
        "0.3000",
        "103.2 ± 1.8",
        "relative" if mixed else "k = 2",
        "2.87" if mixed else "0.0080",
    ):
        assert whole in printed
    if not mixed:
        assert max(map(len, printed.splitlines()[:-2])) <= 80


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

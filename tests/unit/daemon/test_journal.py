"""The journal keeps every reading, numbered without holes, and says why it cannot."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from radiometer.daemon.journal import SCHEMA_VERSION, Journal, JournalError, default_journal_path
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter, to_csv
from radiometer.daemon.timestamps import iso_time, parse_moment
from radiometer.data import Flag, Patch, Quantity, Reading
from radiometer.errors import InputError, OutputError, UsageError

Make = Callable[..., Reading]


def test_a_reading_comes_back_as_it_was_committed(tmp_path: Path, make_reading: Make) -> None:
    """The stored line is the documented JSON of the numbered reading."""
    with Journal(tmp_path / "j.sqlite") as journal:
        (numbered,) = journal.append([make_reading(flags=(Flag.SATURATED,))])
    assert JournalReader(tmp_path / "j.sqlite").lines(ReadingFilter()) == [numbered.to_json()]


def test_an_undefined_radiance_is_kept_too(tmp_path: Path, make_reading: Make) -> None:
    """A value that is not finite is stored as null, not refused."""
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append([make_reading(radiance=Quantity(float("nan"), float("inf"), "relative"))])
    (line,) = JournalReader(tmp_path / "j.sqlite").lines(ReadingFilter())
    assert json.loads(line)["radiance"] == {"value": None, "u": None, "unit": "relative"}


def test_every_cell_of_a_row_is_what_its_heading_says(tmp_path: Path, make_reading: Make) -> None:
    """Names of columns are those of the reading's own fields; units is next to both values."""
    full = make_reading(
        luminance=Quantity(683.0, 7.0, "cd m-2"), patch=Patch(5, 6, 7, 8), name="lamp", session="web",
        exposures_s=(0.25,), coverage_factor=2.5,
    )  # fmt: skip
    with Journal(tmp_path / "j.sqlite") as journal:
        kept, _ = journal.append([full, make_reading()])
    row, bare = csv.DictReader(io.StringIO(to_csv(JournalReader(tmp_path / "j.sqlite").lines(ReadingFilter()))))
    result = json.loads(kept.to_json())
    assert row == {
        "sequence": "1",
        "time": kept.time,
        "instrument": result["instrument"],
        "radiance": str(full.radiance.value),
        "u_radiance": str(full.radiance.u),
        "radiance_unit": full.radiance.unit,
        "luminance": "683.0",
        "u_luminance": "7.0",
        "luminance_unit": "cd m-2",
        "U_rel": str(result["U_rel"]),
        "coverage_factor": "2.5",
        "flags": " ".join(result["flags"]),
        "x": "5",
        "y": "6",
        "width": "7",
        "height": "8",
        "exposures_s": "0.25",
        "name": "lamp",
        "session": "web",
    }
    assert (bare["luminance"], bare["u_luminance"], bare["luminance_unit"]) == ("", "", "")


def test_a_full_journal_refuses_and_loses_nothing(tmp_path: Path, make_reading: Make) -> None:
    """At the size limit appending raises, what was committed stays, and the numbers go on once there is room."""
    path = tmp_path / "j.sqlite"
    committed: list[Reading] = []

    def fill(journal: Journal) -> None:
        while True:
            committed.extend(journal.append([make_reading()] * 20))

    with Journal(path, max_bytes=200_000) as limited, pytest.raises(JournalError, match="free space"):
        fill(limited)
    with Journal(path) as journal:
        (numbered,) = journal.append([make_reading()])
    count = len(committed)
    assert count > 0
    assert numbered.sequence == count + 1
    assert JournalReader(path).bounds() == (1, count + 1, count + 1)


@pytest.mark.slow
def test_a_locked_journal_is_named_as_such(tmp_path: Path, make_reading: Make) -> None:
    """A file locked by another program raises JournalError, and works again once it is free."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(JournalError, match="locked"):
            journal.append([make_reading()])
        other.execute("ROLLBACK")
        other.close()
        assert [reading.sequence for reading in journal.append([make_reading()])] == [1]


def test_a_second_daemon_is_refused(tmp_path: Path) -> None:
    """Two writers of one journal are not allowed."""
    with Journal(tmp_path / "j.sqlite"), pytest.raises(OutputError, match="another daemon"):
        Journal(tmp_path / "j.sqlite").open()


@pytest.mark.parametrize("content", [b"not a database at all, but long enough to look like one" * 40, b"\0" * 4096])
def test_a_file_that_is_no_journal_is_refused(tmp_path: Path, content: bytes) -> None:
    """Foreign content is neither overwritten nor reported as a passing trouble."""
    path = tmp_path / "j.sqlite"
    path.write_bytes(content)
    with pytest.raises(OutputError, match="--journal") as caught:
        Journal(path).open()
    assert not isinstance(caught.value, JournalError)
    assert path.read_bytes() == content


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    """A wrong path is a mistake to be reported at once, not a trouble that passes."""
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="--journal") as caught:
        Journal(tmp_path / "file" / "j.sqlite").open()
    assert not isinstance(caught.value, JournalError)


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_regular_file_is_refused(tmp_path: Path, make: Callable[[Path], None]) -> None:
    """A pipe or folder holds no reading: the daemon says so at its start, and leaves no lock file."""
    make(tmp_path / "j.sqlite")
    with pytest.raises(OutputError, match="no regular file"):
        Journal(tmp_path / "j.sqlite").open()
    assert [entry.name for entry in tmp_path.iterdir()] == ["j.sqlite"]


def test_another_sqlite_file_is_refused(tmp_path: Path) -> None:
    """A database of another program is left alone."""
    path = tmp_path / "j.sqlite"
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE things (id INTEGER)")
    other.close()
    with pytest.raises(OutputError, match="not a radiometer journal"):
        Journal(path).open()
    with pytest.raises(InputError, match="not a radiometer journal"):
        JournalReader(path).lines(ReadingFilter())


@pytest.mark.parametrize("gone", [2, 3])
def test_a_hole_is_found_on_opening(tmp_path: Path, make_reading: Make, gone: int) -> None:
    """A journal that was tampered with is refused, also where the newest readings are missing."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        journal.append([make_reading()] * 3)
    with sqlite3.connect(path) as other:
        other.execute("DELETE FROM readings WHERE sequence = ?", (gone,))
    other.close()
    with pytest.raises(OutputError, match="damaged"):
        Journal(path).open()


@pytest.mark.slow
def test_a_long_query_ends_at_its_deadline(tmp_path: Path, make_reading: Make) -> None:
    """A reader gives up rather than hold a thread for ever."""
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append([make_reading()] * 20_000)
    with pytest.raises(InputError, match="interrupted"):
        JournalReader(tmp_path / "j.sqlite", deadline_s=-1.0).lines(ReadingFilter(flag="none"))


def test_moments_are_iso_times_or_ages() -> None:
    """Both forms give µs since 1970; anything else is refused with the allowed forms."""
    assert iso_time(parse_moment("2026-11-20T12:00:00.25+01:00")) == "2026-11-20T11:00:00.250000Z"
    assert parse_moment("1.5h", now=10_000_000_000) == 10_000_000_000 - 5_400_000_000
    with pytest.raises(UsageError, match="ISO 8601"):
        parse_moment("yesterday")


def test_a_journal_of_a_newer_form_is_left_alone(tmp_path: Path, make_reading: Make) -> None:
    """It is refused with its form; one of this form is opened."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        journal.append([make_reading()])
    for form, opens in ((SCHEMA_VERSION, True), (SCHEMA_VERSION + 1, False)):
        with sqlite3.connect(path) as connection:
            connection.execute(f"PRAGMA user_version = {form}")
        connection.close()
        if opens:
            with Journal(path) as journal:
                assert journal.append([make_reading()])[0].sequence == 2
        else:
            with pytest.raises(OutputError, match=rf"newer radiometer \(form {form}\)"):
                Journal(path).open()


@pytest.mark.parametrize(
    ("given", "place"),
    [
        ({"STATE_DIRECTORY": "/var/lib/one:/var/lib/two", "XDG_STATE_HOME": "/x"}, "/var/lib/one/journal.sqlite"),
        ({"XDG_STATE_HOME": "/x"}, "/x/radiometer/journal.sqlite"),
        ({"HOME": "/home/me"}, "/home/me/.local/state/radiometer/journal.sqlite"),
    ],
)
def test_the_journal_lies_where_state_is_kept(
    monkeypatch: pytest.MonkeyPatch, given: dict[str, str], place: str
) -> None:
    """The first folder that systemd names, else that of the XDG specification, else its default."""
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert default_journal_path() == Path(place)


def test_a_journal_that_is_not_there_is_not_made_by_reading(tmp_path: Path) -> None:
    """The message says what writes one."""
    with pytest.raises(InputError, match="radiometer serve"):
        JournalReader(tmp_path / "j.sqlite").lines(ReadingFilter())
    assert list(tmp_path.iterdir()) == []


def _sequences(path: Path) -> list[int]:
    return [json.loads(line)["sequence"] for line in JournalReader(path).lines(ReadingFilter())]


@pytest.mark.parametrize("endings", [("",), ("-wal",), ("", "-wal", "-shm"), ("", "-wal", "-shm", ".lock")])
def test_a_deleted_journal_is_written_anew_with_all_that_it_held(
    tmp_path: Path, make_reading: Callable[..., Reading], endings: tuple[str, ...]
) -> None:
    """The next commit fails and says so; the one after it goes on with the next number, and nothing is missing."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        for _ in range(3):
            journal.append([make_reading()] * 5)
        for ending in endings:
            path.with_name(path.name + ending).unlink()
        with pytest.raises(JournalError, match="deleted"):
            journal.append([make_reading()])
        assert journal.append([make_reading()])[0].sequence == 16
        assert _sequences(path) == list(range(1, 17))
    with Journal(path) as journal:
        assert journal.append([make_reading()])[0].sequence == 17


def test_a_log_that_was_cut_is_reported_unless_a_checkpoint_cut_it(
    tmp_path: Path, make_reading: Callable[..., Reading]
) -> None:
    """Readings that are in the log alone would be missing after a crash."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        journal.append([make_reading()] * 5)
        with sqlite3.connect(path) as other:
            other.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        assert journal.append([make_reading()])[0].sequence == 6
        os.truncate(path.with_name("j.sqlite-wal"), 100)
        with pytest.raises(JournalError, match="cut"):
            journal.append([make_reading()])


def test_readings_that_were_lost_after_a_crash_are_reported(
    tmp_path: Path, make_reading: Callable[..., Reading]
) -> None:
    """Their numbers are not given to others before a person has decided so; a journal begun anew has lost none."""
    path, crashed = tmp_path / "j.sqlite", tmp_path / "crashed.sqlite"
    with Journal(path) as journal:
        journal.append([make_reading()] * 5)
    with Journal(path) as journal:
        journal.append([make_reading()] * 3)
        for ending in ("", ".lock"):  # as after a kill, without the log
            shutil.copy(f"{path}{ending}", f"{crashed}{ending}")
    with pytest.raises(OutputError, match=r"lost its readings 6 to 8.*crashed.sqlite.lock"):
        Journal(crashed).open()
    crashed.unlink()
    with Journal(crashed) as journal:
        assert journal.append([make_reading()])[0].sequence == 1


def test_a_moved_journal_takes_no_reading_until_it_is_back(
    tmp_path: Path, make_reading: Callable[..., Reading]
) -> None:
    """Neither does one in whose place another file was put, moved there or copied over it."""
    path, elsewhere, other = tmp_path / "j.sqlite", tmp_path / "moved.sqlite", tmp_path / "other.sqlite"
    with Journal(other) as early:
        early.append([make_reading()] * 2)
    with Journal(path) as journal:
        journal.append([make_reading()] * 5)
        path.rename(elsewhere)
        with pytest.raises(JournalError, match="moved"):
            journal.append([make_reading()])
        shutil.copy(other, path)
        with pytest.raises(JournalError, match="replaced"):
            journal.append([make_reading()])
        elsewhere.rename(path)
        assert journal.append([make_reading()])[0].sequence == 6
        path.unlink()
        shutil.copy(other, path)
        with pytest.raises(JournalError, match="another file took its place"):
            journal.append([make_reading()])
        path.unlink()
        with pytest.raises(JournalError, match="anew"):
            journal.append([make_reading()])
        assert journal.append([make_reading()])[0].sequence == 7
    assert _sequences(path) == list(range(1, 8))


@pytest.mark.parametrize("link", ["symlink_to", "hardlink_to"])
def test_two_daemons_on_one_journal_are_refused_whatever_its_name(
    tmp_path: Path, make_reading: Callable[..., Reading], link: str
) -> None:
    """A link to it, symbolic or hard, is the same journal; the first goes on."""
    (tmp_path / "elsewhere").mkdir()
    alias = tmp_path / "elsewhere" / "alias.sqlite"
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append([make_reading()])
        getattr(alias, link)(tmp_path / "j.sqlite")
        with pytest.raises(OutputError, match="another daemon"):
            Journal(alias).open()
        assert journal.append([make_reading()])[0].sequence == 2
    with Journal(alias) as journal:
        assert journal.append([make_reading()])[0].sequence == 3

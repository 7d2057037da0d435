"""Another program writes over the files of a journal while the daemon writes it."""

from __future__ import annotations

import asyncio
import json
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.journal import Journal, JournalError
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.data import Reading
from radiometer.errors import OutputError

Make = Callable[..., Reading]
Harm = Callable[[Path, Path], None]


def in_another_program(statement: str, *arguments: object) -> None:
    """Run Python elsewhere: a file closed here would take SQLite's locks on it away."""
    command = [sys.executable, "-c", f"import os, shutil, sqlite3, sys; {statement}", *map(str, arguments)]
    subprocess.run(command, check=True)


def numbers(path: Path) -> list[int]:
    """Return the sequence numbers that a journal holds, in order."""
    return [json.loads(line)["sequence"] for line in JournalReader(path).lines(ReadingFilter())]


HARMS: dict[str, str] = {
    "emptied": "open(sys.argv[1], 'w').close()",
    "halved": "os.truncate(sys.argv[1], os.stat(sys.argv[1]).st_size // 2)",
    "older copy": "shutil.copyfile(sys.argv[2], sys.argv[1])",
    "noise": "n = os.stat(sys.argv[1]).st_size; open(sys.argv[1], 'r+b').write(os.urandom(n))",
    "log emptied": "open(sys.argv[1] + '-wal', 'w').close()",
    "log cut": "os.truncate(sys.argv[1] + '-wal', 100)",
    "log noise": "n = os.stat(sys.argv[1] + '-wal').st_size; open(sys.argv[1] + '-wal', 'r+b').write(os.urandom(n))",
}


@pytest.mark.parametrize("harm", ["emptied", "log emptied", "log cut", "log noise"])
def test_an_overwritten_journal_is_written_anew_where_all_of_it_can_be_read(harm, tmp_path, make_reading):
    """The next commit fails and says so; the one after it goes on with the next number, and nothing is missing."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        for _ in range(3):
            journal.append([make_reading()] * 5)
        in_another_program(HARMS[harm], path)
        with pytest.raises(JournalError, match=r"j\.sqlite.*anew with all"):
            journal.append([make_reading()])
        assert journal.append([make_reading()])[0].sequence == 16
        assert numbers(path) == list(range(1, 17))
    with Journal(path) as journal:
        assert journal.append([make_reading()])[0].sequence == 17


@pytest.mark.parametrize("harm", ["halved", "older copy", "noise"])
def test_an_overwritten_journal_is_made_whole_from_its_log(harm, tmp_path, make_reading):
    """Where the log holds every page, it is written into the file before the next reading is told to anyone."""
    path, older, alone = tmp_path / "j.sqlite", tmp_path / "older.sqlite", tmp_path / "alone.sqlite"
    with Journal(older) as early:
        early.append([make_reading()] * 2)
    with Journal(path) as journal:
        journal.append([make_reading()] * 15)
        in_another_program(HARMS[harm], path, older)
        assert journal.append([make_reading()])[0].sequence == 16
        in_another_program("shutil.copyfile(sys.argv[1], sys.argv[2])", path, alone)
        assert (numbers(path), numbers(alone)) == (list(range(1, 17)), list(range(1, 16)))


@pytest.mark.parametrize("harm", [harm for harm in HARMS if not harm.startswith("log")])
async def test_readings_wait_where_an_overwritten_journal_cannot_be_read(harm, tmp_path, make_reading):
    """An alarm says so at once, no client sees a reading, and the next start takes in what waited."""
    path, older, newest = tmp_path / "j.sqlite", tmp_path / "older.sqlite", tmp_path / "newest.sqlite"
    with Journal(path) as journal:
        journal.append([make_reading()] * 1500)
    shutil.copyfile(path, older)
    with Journal(path) as journal:
        journal.append([make_reading()] * 1500)
    shutil.copyfile(path, newest)
    told, alarms = list[int](), Alarms(lambda *_: None)
    writer = JournalWriter(
        Journal(path), alarms, lambda reading, *_: told.append(reading.sequence), retry_s=0.01, closing_s=0.1
    )
    await writer.open()
    running = asyncio.create_task(writer.run())
    await writer.submit(make_reading())
    assert told == [3001]
    in_another_program("sqlite3.connect(sys.argv[1]).execute('PRAGMA wal_checkpoint(TRUNCATE)').fetchall()", path)
    in_another_program("sqlite3.connect(sys.argv[1]).backup(sqlite3.connect(sys.argv[2]))", path, newest)
    in_another_program(HARMS[harm], path, older)
    lost = writer.submit(make_reading())
    while not writer.trouble:
        await asyncio.sleep(0.01)
    assert "another program" in writer.trouble
    assert "stop the daemon" in writer.trouble
    running.cancel()
    with pytest.raises(OutputError, match="1 readings are not in the journal"):
        await writer.close()
    assert (told, lost.cancelled()) == ([3001], True)
    for ending in ("-wal", "-shm"):
        path.with_name(path.name + ending).unlink(missing_ok=True)
    shutil.copyfile(newest, path)
    with Journal(path) as journal:
        assert len(journal.take_in_waiting()) == 1
    assert numbers(path) == list(range(1, 3003))


OTHERS: dict[str, str] = {
    "reader": "sqlite3.connect(f'file:{sys.argv[1]}?mode=ro', uri=True).execute('SELECT * FROM readings').fetchall()",
    "backup": "sqlite3.connect(sys.argv[1]).backup(sqlite3.connect(sys.argv[2]))",
    "checkpoint": "sqlite3.connect(sys.argv[1]).execute('PRAGMA wal_checkpoint(PASSIVE)').fetchall()",
    "full checkpoint": "sqlite3.connect(sys.argv[1]).execute('PRAGMA wal_checkpoint(TRUNCATE)').fetchall()",
    "vacuum": "sqlite3.connect(sys.argv[1]).execute('VACUUM')",
    "touch": "os.utime(sys.argv[1]); os.utime(sys.argv[1] + '-wal')",
}


@pytest.mark.parametrize("other", OTHERS)
def test_what_leaves_a_sound_journal_behind_is_no_trouble(other, tmp_path, make_reading):
    """Readers, backups and checkpoints of other programs, between any two commits; a checkpoint of ours as well."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        for number in range(1, 8):
            assert journal.append([make_reading()] * 100)[-1].sequence == number * 100
            in_another_program(OTHERS[other], path, tmp_path / f"{number}.sqlite")
        assert numbers(path) == list(range(1, 701))
    with sqlite3.connect(path) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()


def test_the_log_of_a_long_day_stays_small(tmp_path, make_reading):
    """Checkpoints keep SQLite's log to some MB, however much is written."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        for _ in range(2000):
            journal.append([make_reading()])
        assert path.with_name("j.sqlite-wal").stat().st_size < 16e6


def test_a_reading_that_another_program_deleted_is_missed(tmp_path, make_reading):
    """A hole is damage as at the start: nothing more is written, until a copy is put back."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        journal.append([make_reading()] * 5)
        in_another_program(
            "c = sqlite3.connect(sys.argv[1]); c.execute('DELETE FROM readings WHERE sequence = 3'); c.commit()", path
        )
        for _ in range(2):
            with pytest.raises(JournalError, match="not all of its readings can be read"):
                journal.append([make_reading()])


@pytest.mark.parametrize("harm", ["log emptied", "emptied"])
def test_what_happens_during_a_commit_is_noticed_by_the_next(harm, tmp_path, make_reading, monkeypatch):
    """The files are remembered as the daemon left them, not as another program did meanwhile."""
    path, real = tmp_path / "j.sqlite", sqlite3.connect
    harms = list[str]()

    class Disturbed(sqlite3.Connection):
        """A connection in whose commit another program comes in between."""

        def execute(self, statement: str, *more: object) -> sqlite3.Cursor:
            """Execute a statement; do the harm before a commit."""
            if statement == "COMMIT" and harms:
                in_another_program(HARMS[harms.pop()], path)
            return super().execute(statement, *more)

    monkeypatch.setattr(sqlite3, "connect", lambda *place, **how: real(*place, **{**how, "factory": Disturbed}))
    with Journal(path) as journal:
        journal.append([make_reading()] * 15)
        harms.append(harm)
        assert journal.append([make_reading()])[0].sequence == 16
        with pytest.raises(JournalError, match="anew"):
            journal.append([make_reading()])
        assert journal.append([make_reading()])[0].sequence == 17
    assert numbers(path) == list(range(1, 18))

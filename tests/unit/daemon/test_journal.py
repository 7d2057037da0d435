"""The journal keeps every reading, numbered without holes, whatever writes over its files, and says why it cannot."""

import asyncio
import csv
import io
import itertools
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import asynccontextmanager, closing, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis.stateful import run_state_machine_as_test

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.journal import SCHEMA_VERSION, Journal, JournalError, JournalSizeError, default_journal_path
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter, to_csv
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.timestamps import Jump, iso_time, now_us, parse_moment
from radiometer.data import Contribution, Flag, Patch, Quantity
from radiometer.errors import InputError, OutputError, UsageError
from testing.journal_machine import JournalMachine
from testing.watched_sqlite import refusing

WATT = "W sr-1 m-2"
START_US, HOUR_US = 1_790_000_000_000_000, 3_600_000_000


def numbers(path):
    """Return the sequence numbers that a journal holds, in order."""
    return [json.loads(line)["sequence"] for line in JournalReader(path).lines(ReadingFilter())]


def writer_of(path, alarms=None, on_commit=lambda *_: None, **options):
    """Return what writes a journal, given by its path or itself, on behalf of a daemon."""
    journal = Journal(path) if isinstance(path, Path) else path
    return JournalWriter(journal, alarms or Alarms(lambda *_: None), on_commit, **options)


def written(path, readings):
    """Write readings into a journal and return its reader."""
    with Journal(path) as journal:
        journal.append(readings)
    return JournalReader(path)


def changed(path, script):
    """Let another program execute statements on a journal."""
    with closing(sqlite3.connect(path)) as other:
        other.executescript(script)


@asynccontextmanager
async def running(*given, **options):
    """Open a writer and let it commit; its task ends before the writer is closed."""
    writer = writer_of(*given, **options)
    await writer.open()
    task = asyncio.create_task(writer.run())
    yield writer
    task.cancel()
    await writer.close()


def test_a_reading_comes_back_as_it_was_committed(tmp_path, make_reading):
    """The stored line is the documented JSON of the numbered reading; what is not finite is null, not refused."""
    undefined = make_reading(radiance=Quantity(float("nan"), float("inf"), "relative"))
    with Journal(tmp_path / "j.sqlite") as journal:
        numbered = journal.append([make_reading(flags=(Flag.SATURATED,)), undefined])
    lines = JournalReader(tmp_path / "j.sqlite").lines(ReadingFilter())
    assert lines == [reading.to_json() for reading in numbered]
    assert json.loads(lines[1])["radiance"] == {"value": None, "u": None, "unit": "relative"}


def test_where_the_readings_of_another_camera_begin_is_an_event(tmp_path, make_reading):
    """After a restart and within a batch; those of one camera are none."""
    for cameras in (("A", "A"), ("A",), ("B", "A")):
        reader = written(tmp_path / "j.sqlite", [make_reading(instrument=camera) for camera in cameras])
    events = reader.events()
    assert [event["message"] for event in events if event["kind"] == "camera"] == [
        "from reading 4 on, readings are of the camera B, not of A",
        "from reading 5 on, readings are of the camera A, not of B",
    ]


def test_every_cell_of_a_row_is_what_its_heading_says(tmp_path, make_reading):
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


@pytest.mark.parametrize("content", [b"not a database at all, but long enough to look like one" * 40, b"\0" * 4096])
def test_a_file_that_is_no_journal_is_refused(tmp_path, content):
    """Foreign content, and a place below a file: neither overwritten nor reported as a passing trouble."""
    path = tmp_path / "j.sqlite"
    path.write_bytes(content)
    for place in (path, path / "j.sqlite"):
        with pytest.raises(OutputError, match="--journal") as caught:
            Journal(place).open()
        assert not isinstance(caught.value, JournalError)
    assert path.read_bytes() == content


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_regular_file_is_refused(tmp_path, make):
    """A pipe or folder holds no reading: the daemon says so at its start, and leaves no lock file."""
    make(tmp_path / "j.sqlite")
    with pytest.raises(OutputError, match="no regular file"):
        Journal(tmp_path / "j.sqlite").open()
    assert [entry.name for entry in tmp_path.iterdir()] == ["j.sqlite"]


def test_another_sqlite_file_is_refused(tmp_path):
    """A database of another program is left alone."""
    path = tmp_path / "j.sqlite"
    changed(path, "CREATE TABLE things (id INTEGER)")
    with pytest.raises(OutputError, match="not a radiometer journal"):
        Journal(path).open()
    with pytest.raises(InputError, match="not a radiometer journal"):
        JournalReader(path).lines(ReadingFilter())


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x AS sequence, '{}' AS json FROM n"
FOREIGN = {
    "a view": f"ALTER TABLE readings RENAME TO kept; CREATE VIEW readings AS {ENDLESS}",
    "a trigger": "CREATE TRIGGER lose AFTER INSERT ON readings BEGIN DELETE FROM readings; END",
    "a virtual table": "CREATE VIRTUAL TABLE more USING rtree(id, low, high)",
}


@pytest.mark.parametrize("change", FOREIGN.values(), ids=FOREIGN)
def test_a_journal_that_another_program_has_changed_is_refused(change, tmp_path, make_reading):
    """A query of such a file need not end, and a trigger loses readings: reader and writer name the file."""
    path = tmp_path / "j.sqlite"
    written(path, [make_reading()])
    changed(path, change)
    for use in (lambda: JournalReader(path).lines(ReadingFilter()), lambda: Journal(path).open()):
        with pytest.raises((InputError, OutputError), match=r"j\.sqlite: holds the .* which no journal has"):
            use()


def test_a_long_query_ends_at_its_deadline(tmp_path, make_reading):
    """A reader gives up rather than hold a thread for ever."""
    written(tmp_path / "j.sqlite", [make_reading()] * 2_000)
    with pytest.raises(InputError, match="takes more than 0 s"):
        JournalReader(tmp_path / "j.sqlite", deadline_s=-1.0).lines(ReadingFilter(flag="none"))


def test_a_journal_of_a_newer_form_is_left_alone(tmp_path, make_reading):
    """It is refused with its form; one of this form is opened."""
    path = tmp_path / "j.sqlite"
    written(path, [make_reading()])
    changed(path, f"PRAGMA user_version = {SCHEMA_VERSION}")
    assert len(written(path, [make_reading()]).lines(ReadingFilter())) == 2
    changed(path, f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    with pytest.raises(OutputError, match=rf"newer radiometer \(form {SCHEMA_VERSION + 1}\)"):
        Journal(path).open()


OLDER_FORMS = {
    1: "DROP TABLE trend; DROP TABLE patches; DROP INDEX readings_by_stream; ALTER TABLE readings DROP COLUMN stream",
    2: "DROP TABLE trend; CREATE TABLE trend (stream TEXT NOT NULL, minute INTEGER NOT NULL, unit TEXT NOT NULL,"
    " count INTEGER NOT NULL, total REAL NOT NULL, total_u REAL NOT NULL, low REAL NOT NULL, high REAL NOT NULL,"
    " flagged INTEGER NOT NULL, PRIMARY KEY (stream, minute, unit)) WITHOUT ROWID",
}


@pytest.mark.parametrize("form", OLDER_FORMS)
def test_a_journal_of_an_older_form_is_taken_over(tmp_path, make_reading, form):
    """It can be read before; then its trend is made anew by place, and new readings are added, a client's own apart."""
    path = tmp_path / "j.sqlite"
    places = [make_reading(patch=Patch(x, 0, 9, 9), radiance=Quantity(1.0 + x, 0.1, WATT)) for x in (0, 1)]
    span = (now_us() - 5 * HOUR_US, now_us() + HOUR_US)
    expected = written(path, [places[0]] * 3 + [places[1]] * 3).trend("", *span)
    changed(path, f"{OLDER_FORMS[form]}; PRAGMA user_version = {form}")
    reader = JournalReader(path)
    assert (reader.trend("", *span), len(reader.lines(ReadingFilter(stream="")))) == ([], 6)
    assert reader.lines(ReadingFilter(stream="own")) == []
    with Journal(path):
        assert reader.trend("", *span) == expected
    assert [(point.value, point.count) for point in expected] == [(1.0, 3), (2.0, 3)]
    written(path, [make_reading(session="scpi-1"), places[1]])
    assert [point.count for point in reader.trend("", *span)] == [3, 4]
    assert len(reader.lines(ReadingFilter(stream="own"))) == 1


@pytest.mark.parametrize(
    ("given", "place"),
    [
        ({"STATE_DIRECTORY": "/var/lib/one:/var/lib/two", "XDG_STATE_HOME": "/x"}, "/var/lib/one/journal.sqlite"),
        ({"XDG_STATE_HOME": "/x"}, "/x/radiometer/journal.sqlite"),
        ({"HOME": "/home/me"}, "/home/me/.local/state/radiometer/journal.sqlite"),
    ],
)
def test_the_journal_lies_where_state_is_kept(monkeypatch, given, place):
    """The first folder that systemd names, else that of the XDG specification, else its default."""
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert default_journal_path() == Path(place)


def test_a_journal_that_is_not_there_is_not_made_by_reading(tmp_path):
    """The message says what writes one."""
    with pytest.raises(InputError, match="radiometer serve"):
        JournalReader(tmp_path / "j.sqlite").lines(ReadingFilter())
    assert list(tmp_path.iterdir()) == []


def test_readings_that_were_lost_after_a_crash_are_reported(tmp_path, make_reading):
    """Their numbers are not given to others before a person has decided so; a journal begun anew has lost none."""
    path, crashed = tmp_path / "j.sqlite", tmp_path / "crashed.sqlite"
    written(path, [make_reading()] * 5)
    with Journal(path) as journal:
        journal.append([make_reading()] * 3)
        for ending in ("", ".lock"):  # as after a kill, without the log
            shutil.copy(f"{path}{ending}", f"{crashed}{ending}")
    with pytest.raises(OutputError, match=r"lost its readings 6 to 8.*crashed.sqlite.lock"):
        Journal(crashed).open()
    crashed.unlink()
    with Journal(crashed) as journal:
        assert journal.append([make_reading()])[0].sequence == 1


def test_a_moved_journal_takes_no_reading_until_it_is_back(tmp_path, make_reading):
    """Neither does one in whose place another file was put, moved there or copied over it."""
    path, elsewhere, other = tmp_path / "j.sqlite", tmp_path / "moved.sqlite", tmp_path / "other.sqlite"
    written(other, [make_reading()] * 2)
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
    assert numbers(path) == list(range(1, 8))


@pytest.mark.parametrize("link", ["symlink_to", "hardlink_to", None])
def test_two_daemons_on_one_journal_are_refused_whatever_its_name(tmp_path, make_reading, link):
    """A link to it, symbolic or hard, is the same journal; the first goes on."""
    (tmp_path / "elsewhere").mkdir()
    alias = tmp_path / "elsewhere" / "alias.sqlite" if link else tmp_path / "j.sqlite"
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append([make_reading()])
        if link:
            getattr(alias, link)(tmp_path / "j.sqlite")
        with pytest.raises(OutputError, match="another daemon"):
            Journal(alias).open()
        assert journal.append([make_reading()])[0].sequence == 2
    written(alias, [make_reading()])
    assert numbers(alias) == [1, 2, 3]


@pytest.mark.usefixtures("connections")
def test_a_journal_is_a_list_that_stays(make_reading):
    """Numbers, filters, trend, deletion, patches and failures agree with a plain list, in any order."""
    JournalMachine.make_reading = staticmethod(make_reading)
    run_state_machine_as_test(JournalMachine, settings=settings(max_examples=25, stateful_step_count=15))


def test_a_trend_point_stands_in_the_middle_of_its_time(tmp_path, make_reading):
    """Fine: within the bucket of span/points; coarse: whole minutes, each counted once; the bounds belong as stated."""
    at = [0, 60_000_000, 119_999_999, 120_000_000]
    base = START_US - START_US % HOUR_US
    reader = written(tmp_path / "j.sqlite", [make_reading(time=iso_time(base + us)) for us in at])
    fine = reader.trend("", base, base + 120_000_000, points=2)
    assert [(point.time_us - base, point.count) for point in fine] == [(30_000_000, 1), (90_000_000, 2)]
    coarse = reader.trend("", base, base + 3 * HOUR_US, points=180)
    expected = [(30_000_000, 1), (90_000_000, 2), (150_000_000, 1)]
    assert [(point.time_us - base, point.count) for point in coarse] == expected
    coarser = reader.trend("", base, base + 3 * HOUR_US, points=60)
    assert [(point.time_us - base) % 180_000_000 for point in coarser] == [90_000_000] * len(coarser)
    assert sum(point.count for point in coarser) == 4


def test_an_undefined_radiance_is_not_drawn(tmp_path, make_reading):
    """Neither of two hours nor of a day; the reading itself is kept."""
    radiances = [Quantity(float("nan"), float("nan"), "1"), Quantity(2.0, float("inf"), "1"), Quantity(1.0, 0.01, WATT)]
    given = [make_reading(time=iso_time(START_US), radiance=one) for one in radiances]
    reader = written(tmp_path / "j.sqlite", given)
    for span in (HOUR_US, 100 * HOUR_US):
        points = reader.trend("", START_US - HOUR_US // 2, START_US + span)
        assert sorted((point.count, point.low, point.u) for point in points) == [(1, 1.0, 0.01), (1, 2.0, 0.0)]
    assert reader.bounds() == (1, 3, 3)


async def test_what_cannot_be_deleted_is_an_alarm(tmp_path, make_reading, monkeypatch):
    """A journal that grows because nothing can be deleted must be reported."""
    journal, alarms = Journal(tmp_path / "j.sqlite"), Alarms(lambda *_: None)

    def refused(before_us):
        raise JournalError("read-only file system")

    monkeypatch.setattr(journal, "drop_older", refused)
    async with running(journal, alarms, keep_days=1.0):
        while not alarms.active:
            await asyncio.sleep(0)
        assert ["read-only" in alarm.message for alarm in alarms.active] == [True]


@pytest.mark.parametrize(
    ("text", "age_s"), [("90s", 90), ("15min", 900), ("15m", 900), ("1.5h", 5400), ("7d", 604_800), ("2w", 1_209_600)]
)
def test_moments_are_ages_or_iso_times(text, age_s):
    """Each unit in s; times in µs since 1970; anything else is refused with the allowed forms."""
    assert parse_moment(text, now=START_US) == START_US - age_s * 1_000_000
    assert iso_time(parse_moment("2026-11-20T12:00:00.25+01:00")) == "2026-11-20T11:00:00.250000Z"
    with pytest.raises(UsageError, match="ISO 8601"):
        parse_moment("yesterday")


MINUTE_US, DAY_US = 60_000_000, 86_400_000_000
BASE_US = 1_790_000_000_000_000 // DAY_US * DAY_US
# Second of the day, radiance, its u, flags: three in the first minute, one in the second, one in the fourth.
FIVE = (
    (0, 1.0, 0.1, ()),
    (10, 2.0, 0.2, (Flag.NONUNIFORM,)),
    (59, 6.0, 0.6, ()),
    (60, 5.0, 0.9, ()),
    (180, 7.0, 0.7, ()),
)


def readings(make_reading, **more):
    return [
        make_reading(time=iso_time(BASE_US + s * 1_000_000), radiance=Quantity(v, u, "1"), flags=flags, **more)
        for s, v, u, flags in FIVE
    ]


def day(reader, stream, minutes):
    """Return value, u, lowest, highest, count and count of flagged of every so many minutes of a day."""
    points = reader.trend(stream, BASE_US, BASE_US + DAY_US, 1440 // minutes)
    return [(p.value, p.u, p.low, p.high, p.count, p.flagged) for p in points]


def test_a_minute_holds_the_mean_of_its_readings(tmp_path, make_reading):
    """(1 + 2 + 6)/3 with the mean u, the extremes, and how many are flagged; minutes weigh by their readings."""
    reader = written(tmp_path / "j.sqlite", readings(make_reading))
    first, second, fourth = (3.0, 0.3, 1.0, 6.0, 3, 1), (5.0, 0.9, 5.0, 5.0, 1, 0), (7.0, 0.7, 7.0, 7.0, 1, 0)
    assert day(reader, "", 1) == [pytest.approx(row) for row in (first, second, fourth)]
    assert day(reader, "", 2) == [pytest.approx((3.5, 0.45, 1.0, 6.0, 4, 1)), pytest.approx(fourth)]


def test_deletion_deletes_all_that_is_old(tmp_path, make_reading):
    """Readings and alarms go in one call, of the trend whole minutes before the bound's; a person's remark stays."""
    reader = written(tmp_path / "j.sqlite", readings(make_reading))
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.note("alarm", "lost")
        journal.note("remark", "lamp exchanged")
        assert journal.drop_older(BASE_US + 60_000_000) == 3
        assert [row[4] for row in day(reader, "", 1)] == [1, 1]
        assert len(reader.events()) == 2
        journal.drop_older(2**61)
        assert ([event["kind"] for event in reader.events()], reader.bounds()) == (["remark"], (5, 5, 1))


def test_a_trend_of_up_to_125_minutes_is_of_readings_and_a_longer_one_of_minutes(tmp_path, make_reading):
    """Over 7500 s the five readings are a point each, of a microsecond more their minutes; the last one belongs."""
    reader = written(tmp_path / "j.sqlite", readings(make_reading))
    longest = 7_500_000_000
    assert [point.count for point in reader.trend("", BASE_US, BASE_US + longest)] == [1] * 5
    assert [point.count for point in reader.trend("", BASE_US, BASE_US + longest + 1)] == [3, 1, 1]
    for end_us, count in ((3 * MINUTE_US, 4), (3 * MINUTE_US + 1, 5)):
        assert sum(point.count for point in reader.trend("", BASE_US - DAY_US, BASE_US + end_us)) == count
    (point,) = reader.trend("", BASE_US - 5, BASE_US + 5, 1500)
    assert (point.value, point.count, abs(point.time_us - BASE_US) <= 1) == (1.0, 1, True)


def test_of_many_events_the_newest_thousand_are_reported(tmp_path):
    """Oldest first, of 1001 all but the first; fewer where fewer are asked for, and of a time its own."""
    reader = written(tmp_path / "j.sqlite", [])
    rows = ", ".join(f"({BASE_US + number}, 'remark', '{number}')" for number in range(1001))
    changed(tmp_path / "j.sqlite", f"INSERT INTO events (time_us, kind, message) VALUES {rows}")

    def numbers_of(**more):
        return [int(event["message"]) for event in reader.events(**more)]

    assert numbers_of() == list(range(1, 1001))
    assert numbers_of(limit=2) == [999, 1000]
    assert numbers_of(since_us=BASE_US + 5, until_us=BASE_US + 8) == [5, 6, 7]


def test_a_budget_is_of_its_own_reading(tmp_path, make_reading):
    """Each number gives its own lines; one that was deleted, or never was, none."""
    own = [make_reading(time=iso_time(BASE_US), budget=(Contribution("scale", u),)) for u in (0.01, 0.02, 0.03)]
    reader = written(tmp_path / "j.sqlite", own)
    assert [reader.budget(n) for n in (1, 2, 3)] == [{"scale": 0.01}, {"scale": 0.02}, {"scale": 0.03}]
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.drop_older(BASE_US + 1)
    for gone in (0, 1, 2, 4):
        with pytest.raises(InputError, match=f"no reading {gone}"):
            reader.budget(gone)


def kept_of(path, before_us):
    """Return which numbers a deletion leaves in a journal."""
    with Journal(path) as journal:
        journal.drop_older(before_us)
    return numbers(path)


async def test_a_jump_is_counted_once(tmp_path, make_reading):
    """Two jumps of the clock by 10 s and −4 s make ages 6 s less, however often is committed; each is an event."""
    path = tmp_path / "j.sqlite"
    async with running(path) as writer:
        for second in range(3):
            await writer.submit(make_reading(time=iso_time(BASE_US + second * 1_000_000)))
        writer.note_jump(Jump(BASE_US, BASE_US + 10_000_000))
        writer.note_jump(Jump(BASE_US, BASE_US - 4_000_000))
        for _ in range(3):
            await writer.submit(make_reading(time=iso_time(BASE_US + 9_000_000)))
    assert [event["kind"] for event in JournalReader(path).events()] == ["clock", "clock"]
    assert kept_of(path, BASE_US + 7_000_000) == [2, 3, 4, 5, 6]
    assert kept_of(path, BASE_US + 7_000_001) == [3, 4, 5, 6]


async def test_a_jump_that_could_not_be_written_is_written_later(tmp_path, make_reading, monkeypatch):
    """Its event got through before the disk was full and it alone is left: the readings before it are as young."""
    journal, pauses = Journal(tmp_path / "j.sqlite"), []

    async def pause(seconds):
        pauses.append(seconds)
        monkeypatch.undo()

    def full(by_us):
        raise JournalError("disk full")

    async with running(journal, sleep=pause) as writer:
        for _ in range(2):
            await writer.submit(make_reading(time=iso_time(BASE_US)))
        monkeypatch.setattr(journal, "note_jump", full)
        writer.note_jump(Jump(BASE_US, BASE_US + 10_000_000))
    assert len(pauses) == 1
    assert kept_of(tmp_path / "j.sqlite", BASE_US + 10_000_000) == [1, 2]
    assert kept_of(tmp_path / "j.sqlite", BASE_US + 10_000_001) == [2]


async def test_readings_that_still_wait_at_the_end_are_saved(tmp_path, make_reading, monkeypatch):
    """The disk stays full: the daemon fails, and names the file that holds them."""
    journal = Journal(tmp_path / "j.sqlite")

    def full(readings):
        raise JournalError("disk full")

    writer = writer_of(journal, retry_s=0.01, closing_s=0.05)
    await writer.open()
    monkeypatch.setattr(journal, "append", full)
    for value in (5.0, 3.0):
        writer.submit(make_reading(radiance=Quantity(value, 0.1, "1")))
    with pytest.raises(OutputError, match="2 readings are not in the journal"):
        await writer.close()
    (saved,) = tmp_path.glob("j.sqlite-waiting-*.jsonl")
    values = [json.loads(line)["radiance"]["value"] for line in saved.read_text(encoding="utf-8").splitlines()]
    assert values == [5.0, 3.0]


async def test_what_is_being_committed_at_the_end_is_committed_once(tmp_path, make_reading, monkeypatch):
    """The task that commits is cancelled while the disk is slow with an event, and with a reading."""
    for slow in ("note", "append"):
        journal, begun = Journal(tmp_path / f"{slow}.sqlite"), threading.Event()
        call = getattr(journal, slow)

        def late(*what, call=call, begun=begun):
            begun.set()
            time.sleep(0.05)
            return call(*what)

        monkeypatch.setattr(journal, slow, late)
        async with running(journal) as writer:
            writer.note("remark", "lamp changed")
            future = writer.submit(make_reading())
            await asyncio.to_thread(begun.wait)
        assert (await future).sequence == 1
        reader = JournalReader(journal.path)
        assert (len(reader.events()), len(reader.lines(ReadingFilter()))) == (1, 1)


def waited(tmp_path, make_reading):
    """Return a journal of one reading next to which two wait, and these two."""
    left = [
        make_reading(radiance=Quantity(5.0, 0.1, "1"), budget=(Contribution("scale", 0.02),), flags=(Flag.SATURATED,)),
        make_reading(radiance=Quantity(float("nan"), 0.1, "1"), name="lamp"),
    ]
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append([make_reading()])
        journal.save_waiting(left)
    return tmp_path / "j.sqlite", left


async def start_and_stop(path, reading):
    """Write a reading as a daemon does that begins and ends."""
    writer = writer_of(path)
    await writer.open()
    writer.submit(reading)
    await writer.close()


async def test_readings_that_waited_are_taken_in_at_the_next_start(tmp_path, make_reading):
    """Before any new one, as if committed in time, and once: a kill before the deletion leaves the file, or a copy."""
    path, left = waited(tmp_path, make_reading)
    (file,) = tmp_path.glob("*waiting*")
    content = file.read_bytes()
    await start_and_stop(path, make_reading())
    lines = JournalReader(path).lines(ReadingFilter())
    assert lines[1:3] == [replace(one, sequence=number).to_json() for number, one in enumerate(left, start=2)]
    assert numbers(path) == [1, 2, 3, 4]
    assert JournalReader(path).budget(2) == {"scale": 0.02}
    assert len(JournalReader(path).lines(ReadingFilter(stream="patch lamp"))) == 1
    for name in (file, file.with_name("j.sqlite-waiting-7.jsonl")):
        name.write_bytes(content)
        await start_and_stop(path, make_reading())
        assert not list(tmp_path.glob("*waiting*"))
    assert numbers(path) == [1, 2, 3, 4, 5, 6]
    (event,) = JournalReader(path).events()
    assert event["message"].startswith("2 readings that waited in")


DAMAGES = (
    lambda line: b"\xff" + line, lambda line: line[:-9], lambda _: b"[]", lambda _: b"null", lambda _: b"{}",
    lambda line: line.replace(b'"flags"', b'"f"'), lambda line: line.replace(b'"value": 5.0', b'"value": "x"'),
    lambda line: line.replace(b'"time": "2', b'"time": "x'), lambda line: line.replace(b'e": 0.02', b'e": [0.02]'),
)  # fmt: skip


async def test_damaged_lines_of_readings_that_waited_stay_and_stop_nothing(tmp_path, make_reading, eventually):
    """The others are taken in, once; an event and an alarm name the file until it is moved away."""
    path, _ = waited(tmp_path, make_reading)
    (file,) = tmp_path.glob("*waiting*")
    first, *others = file.read_bytes().splitlines(keepends=True)
    damaged = b"\n".join(harm(first.rstrip()) for harm in DAMAGES)
    file.write_bytes(b"".join([*others, damaged]))
    for start in (1, 2):
        alarms = Alarms(lambda *_: None)
        async with running(path, alarms) as writer:
            await writer.submit(make_reading())
            await eventually(lambda alarms=alarms: alarms.active)
            assert len(JournalReader(path).lines(ReadingFilter())) == 2 + start
            assert file.read_bytes() == damaged
            assert f"of {file.name} {2 - start} readings were taken in; 9 damaged lines" in alarms.message_of("journal")
            assert JournalReader(path).events()[-1]["message"] == alarms.message_of("journal")
            if start == 2:
                file.rename(tmp_path / "looked at")
                await eventually(lambda alarms=alarms: not alarms.active)


def test_a_start_states_that_the_run_before_had_no_stop(tmp_path):
    """After a kill, with the time of what was written last, not after a stop; whatever was deleted since."""
    for kinds in (["start", "alarm"], ["start", "alarm", "stop"], ["start", "stop"]):
        with Journal(tmp_path / "j.sqlite") as journal:
            for kind in kinds:
                journal.note(kind, "")
            journal.drop_older(BASE_US)
    events = JournalReader(tmp_path / "j.sqlite").events()
    assert [event["kind"] for event in events] == ["start", "alarm", "stop", "start", "alarm", "stop", "start", "stop"]
    assert [bool(event["message"]) for event in events] == [number == 2 for number in range(8)]
    assert "ended without a stop" in events[2]["message"]
    assert events[2]["message"].endswith(events[1]["time"][:19].replace("T", " "))


async def test_there_is_room_for_so_many_readings_and_no_more(tmp_path, make_reading):
    """Three that wait fill room for three; once they are committed there is room again, in the order they came."""
    given = []

    def on_commit(reading, origin, seconds):
        given.append((reading.sequence, reading.radiance.value))

    writer = writer_of(tmp_path / "j.sqlite", on_commit=on_commit, capacity=3)
    await writer.open()
    futures = []
    for value in (5.0, 3.0, 4.0):
        await writer.wait_for_room()
        futures.append(writer.submit(make_reading(radiance=Quantity(value, 0.1, "1"))))
    waiting = asyncio.create_task(writer.wait_for_room())
    await asyncio.sleep(0)
    assert (waiting.done(), writer.depth) == (False, 3)
    task = asyncio.create_task(writer.run())
    await waiting
    await asyncio.gather(*futures)
    task.cancel()
    assert writer.depth == 0
    assert [reading.sequence for reading in await asyncio.gather(*futures)] == [1, 2, 3]
    assert given == [(1, 5.0), (2, 3.0), (3, 4.0)]
    await writer.close()


def filled(path, make_reading):
    """Return a journal that a hundred readings of 90 days ago and those of this moment have filled to its size."""
    old, new = (make_reading(time=iso_time(now_us() - days * DAY_US)) for days in (90, 0))
    with Journal(path, max_bytes=200_000) as journal, suppress(JournalSizeError):
        journal.append([old] * 100)
        while True:
            journal.append([new] * 20)
    return Journal(path, max_bytes=200_000)


async def test_measuring_pauses_at_the_size_limit(tmp_path, make_reading):
    """At the first readings that have no place, not when memory is full of them; the alarm names the option."""
    writer = writer_of(filled(tmp_path / "j.sqlite", make_reading), closing_s=0.05)
    await writer.open()
    task = asyncio.create_task(writer.run())
    async with asyncio.timeout(20.0):
        while writer.has_room:
            writer.submit(make_reading(time=iso_time(now_us())))
            await asyncio.sleep(0.01)
    assert "--journal-max-mb: raise that" in writer.trouble
    assert "measuring is paused" in writer.trouble
    task.cancel()
    with pytest.raises(OutputError, match="readings are not in the journal"):
        await writer.close()


async def test_a_journal_that_is_full_at_the_start_makes_room_by_deleting(tmp_path, make_reading):
    """What is too old goes though nothing could be written before: then measuring goes on."""
    full = filled(tmp_path / "j.sqlite", make_reading)
    async with running(full, keep_days=30.0, retry_s=0.01) as writer, asyncio.timeout(20.0):
        futures = [writer.submit(make_reading(time=iso_time(now_us()))) for _ in range(30)]
        await asyncio.gather(*futures)
        await writer.wait_for_room()
    first, last, _ = JournalReader(tmp_path / "j.sqlite").bounds()
    assert (first, last) == (101, futures[-1].result().sequence)


async def test_a_journal_that_is_locked_is_an_alarm_and_no_end(tmp_path, monkeypatch):
    """It goes by the journal's name and says why; what is wrong with the file itself ends the daemon."""
    journal, alarms = Journal(tmp_path / "j.sqlite"), Alarms(lambda *_: None)
    writer = writer_of(journal, alarms, closing_s=0.05)

    def locked():
        raise JournalError("the journal is locked")

    monkeypatch.setattr(journal, "open", locked)
    await writer.open()
    assert [(alarm.name, alarm.message) for alarm in alarms.active] == [("journal", "the journal is locked")]

    def damaged():
        raise OutputError("the journal is damaged")

    monkeypatch.setattr(journal, "open", damaged)
    with pytest.raises(OutputError, match="damaged"):
        await writer.open()
    await writer.close()


def test_a_journal_is_recognised_by_its_first_bytes(tmp_path, make_reading, connections):
    """RAMJ and the form in its header; SQLite waits for the disk at every commit, and readers never wait."""
    written(tmp_path / "j.sqlite", readings(make_reading))
    header = (tmp_path / "j.sqlite").read_bytes()[:100]
    assert (header[:15], header[68:72]) == (b"SQLite format 3", b"RAMJ")
    assert int.from_bytes(header[60:64], "big") == SCHEMA_VERSION
    with Journal(tmp_path / "j.sqlite"):
        connection = connections[-1]
        assert connection.execute("PRAGMA synchronous").fetchone() == (2,)
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


@pytest.mark.parametrize(
    ("code", "kind", "message"),
    [
        (sqlite3.SQLITE_FULL, JournalError, "free space"), (sqlite3.SQLITE_BUSY, JournalError, "close that program"),
        (sqlite3.SQLITE_IOERR, JournalError, "trying again"), (sqlite3.SQLITE_CORRUPT, OutputError, "damaged"),
        (sqlite3.SQLITE_BUSY | 2 << 8, JournalError, "close that program"),
    ],
)  # fmt: skip
def test_what_sqlite_refuses_is_reported_with_its_way_out(tmp_path, make_reading, connections, code, kind, message):
    """By the first byte of SQLite's code; nothing of the batch stays, and the next goes in whole."""
    with Journal(tmp_path / "j.sqlite") as journal:
        for words in ("trend", "COMMIT"):
            with refusing(words, code), pytest.raises(OutputError, match=message) as refusal:
                journal.append([make_reading(), make_reading()])
            assert type(refusal.value) is kind
        assert [reading.sequence for reading in journal.append([make_reading()])] == [1]


@pytest.mark.parametrize("max_bytes", [300_000, 2_000_000])
def test_a_journal_with_a_size_keeps_to_it_with_its_log(tmp_path, make_reading, max_bytes):
    """The file and SQLite's log together, whether readings come one by one or many at once."""
    path = tmp_path / "j.sqlite"
    budget = tuple(Contribution(f"part {k}", 0.01) for k in range(20))
    with Journal(path, max_bytes=max_bytes) as journal, suppress(JournalError):
        for count in itertools.cycle((1, 1, 1, 5)):
            journal.append([make_reading(budget=budget)] * count)
            sizes = [file.stat().st_size for file in tmp_path.iterdir()]
            assert sum(sizes) < max_bytes + 32_768  # of shared memory
    assert path.stat().st_size > 0.5 * max_bytes


# Another program writes over the files of a journal while the daemon writes it.


def in_another_program(statement, *arguments):
    """Run Python elsewhere: a file closed here would take SQLite's locks on it away."""
    command = [sys.executable, "-c", f"import os, shutil, sqlite3, sys; {statement}", *map(str, arguments)]
    subprocess.run(command, check=True)


HARMS = {
    "emptied": "open(sys.argv[1], 'w').close()",
    "halved": "os.truncate(sys.argv[1], os.stat(sys.argv[1]).st_size // 2)",
    "older copy": "shutil.copyfile(sys.argv[2], sys.argv[1])",
    "noise": "n = os.stat(sys.argv[1]).st_size; open(sys.argv[1], 'r+b').write(os.urandom(n))",
    "log emptied": "open(sys.argv[1] + '-wal', 'w').close()",
    "log cut": "os.truncate(sys.argv[1] + '-wal', 100)",
    "log noise": "n = os.stat(sys.argv[1] + '-wal').st_size; open(sys.argv[1] + '-wal', 'r+b').write(os.urandom(n))",
}


DELETED = "[os.unlink(sys.argv[1] + ending) for ending in {}]"


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        *((HARMS[name], r"j\.sqlite.*anew with all") for name in ("emptied", "log emptied", "log cut", "log noise")),
        *((DELETED.format(all_of), "deleted") for all_of in ([""], ["-wal"], ["", "-wal", "-shm"])),
        (DELETED.format(["", "-wal", "-shm", ".lock"]), "deleted"),
    ],
)
def test_a_journal_that_is_lost_is_written_anew_where_all_of_it_can_be_read(harm, message, tmp_path, make_reading):
    """The next commit fails and says so; the one after it goes on with the next number, and nothing is missing."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        for _ in range(3):
            journal.append([make_reading()] * 5)
        in_another_program(harm, path)
        with pytest.raises(JournalError, match=message):
            journal.append([make_reading()])
        assert journal.append([make_reading()])[0].sequence == 16
        assert numbers(path) == list(range(1, 17))
    with Journal(path) as journal:
        assert journal.append([make_reading()])[0].sequence == 17


@pytest.mark.parametrize("harm", ["halved", "older copy", "noise"])
def test_an_overwritten_journal_is_made_whole_from_its_log(harm, tmp_path, make_reading):
    """Where the log holds every page, it is written into the file before the next reading is told to anyone."""
    path, older, alone = tmp_path / "j.sqlite", tmp_path / "older.sqlite", tmp_path / "alone.sqlite"
    written(older, [make_reading()] * 2)
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
    for copy in (older, newest):
        written(path, [make_reading()] * 1500)
        shutil.copyfile(path, copy)
    told, alarms = list[int](), Alarms(lambda *_: None)
    writer = writer_of(path, alarms, lambda reading, *_: told.append(reading.sequence), retry_s=0.01, closing_s=0.1)
    await writer.open()
    task = asyncio.create_task(writer.run())
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
    task.cancel()
    with pytest.raises(OutputError, match="1 readings are not in the journal"):
        await writer.close()
    assert (told, lost.cancelled()) == ([3001], True)
    for ending in ("-wal", "-shm"):
        path.with_name(path.name + ending).unlink(missing_ok=True)
    shutil.copyfile(newest, path)
    with Journal(path) as journal:
        assert len(journal.take_in_waiting()) == 1
    assert numbers(path) == list(range(1, 3003))


OTHERS = {
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
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_the_log_of_a_long_day_stays_small(tmp_path, make_reading):
    """Checkpoints keep SQLite's log to some MB, however much is written."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        for _ in range(2000):
            journal.append([make_reading()])
        assert path.with_name("j.sqlite-wal").stat().st_size < 16e6


@pytest.mark.parametrize("gone", [3, 5])
def test_a_reading_that_another_program_deleted_is_missed(gone, tmp_path, make_reading):
    """A hole, or the newest gone, is damage: nothing more is written, nor the journal opened, until a copy is back."""
    path = tmp_path / "j.sqlite"
    delete = f"c = sqlite3.connect(sys.argv[1]); c.execute('DELETE FROM readings WHERE sequence = {gone}'); c.commit()"
    with Journal(path) as journal:
        journal.append([make_reading()] * 5)
        in_another_program(delete, path)
        for _ in range(2):
            with pytest.raises(JournalError, match="not all of its readings can be read"):
                journal.append([make_reading()])
    with pytest.raises(OutputError, match="damaged"):
        Journal(path).open()


@pytest.mark.parametrize("harm", ["log emptied", "emptied"])
def test_what_happens_during_a_commit_is_noticed_by_the_next(harm, tmp_path, make_reading, monkeypatch):
    """The files are remembered as the daemon left them, not as another program did meanwhile."""
    path, real = tmp_path / "j.sqlite", sqlite3.connect
    harms = list[str]()

    class Disturbed(sqlite3.Connection):
        """A connection in whose commit another program comes in between."""

        def execute(self, statement, *more):
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

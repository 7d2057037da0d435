"""What the journal makes of readings: minutes, old files, budgets and jumps, by figures added up by hand."""

from __future__ import annotations

import asyncio
import json
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.clock_watch import Jump
from radiometer.daemon.journal import Journal, JournalError
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter, TrendPoint
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.timestamps import iso_time
from radiometer.data import Contribution, Flag, Quantity, Reading
from radiometer.errors import InputError, OutputError
from testing.watched_sqlite import Watched, refusing

Make = Callable[..., Reading]
MINUTE_US, DAY_US = 60_000_000, 86_400_000_000
BASE_US = 1_790_000_000_000_000 // DAY_US * DAY_US
# Second of the day, radiance, its u, flags: three in the first minute, one in the second, one in the fourth.
FIVE = (
    (0, 1.0, 0.1, ()),
    (10, 2.0, 0.2, (Flag.SATURATED,)),
    (59, 6.0, 0.6, ()),
    (60, 5.0, 0.9, ()),
    (180, 7.0, 0.7, ()),
)


def readings(make_reading: Make, **more: str) -> list[Reading]:
    return [
        make_reading(time=iso_time(BASE_US + s * 1_000_000), radiance=Quantity(v, u, "1"), flags=flags, **more)
        for s, v, u, flags in FIVE
    ]


def written(path: Path, given: list[Reading]) -> JournalReader:
    with Journal(path) as journal:
        journal.append(given)
    return JournalReader(path)


def day(reader: JournalReader, stream: str, minutes: int) -> list[tuple[float, ...]]:
    """Return value, u, lowest, highest, count and count of flagged of every so many minutes of a day."""
    points: list[TrendPoint] = reader.trend(stream, BASE_US, BASE_US + DAY_US, 1440 // minutes)
    return [(p.value, p.u, p.low, p.high, p.count, p.flagged) for p in points]


def test_a_minute_holds_the_mean_of_its_readings(tmp_path: Path, make_reading: Make) -> None:
    """(1 + 2 + 6)/3 with the mean u, the extremes, and how many are flagged; minutes weigh by their readings."""
    reader = written(tmp_path / "j.sqlite", readings(make_reading))
    first, second, fourth = (3.0, 0.3, 1.0, 6.0, 3, 1), (5.0, 0.9, 5.0, 5.0, 1, 0), (7.0, 0.7, 7.0, 7.0, 1, 0)
    assert day(reader, "", 1) == [pytest.approx(row) for row in (first, second, fourth)]
    assert day(reader, "", 2) == [pytest.approx((3.5, 0.45, 1.0, 6.0, 4, 1)), pytest.approx(fourth)]
    fine = reader.trend("", BASE_US, BASE_US + 2 * MINUTE_US, 2)
    shown = [(p.value, p.u, p.low, p.high, p.count, p.flagged) for p in fine]
    assert shown == [pytest.approx(first), pytest.approx(second)]


def test_the_bounds_of_a_trend_are_from_the_first_to_before_the_last(tmp_path: Path, make_reading: Make) -> None:
    """A reading at the end of a span belongs to the next; the minute in which a long span ends is in it."""
    reader = written(tmp_path / "j.sqlite", readings(make_reading))
    assert sum(p.count for p in reader.trend("", BASE_US, BASE_US + MINUTE_US)) == 3
    assert sum(p.count for p in reader.trend("", BASE_US - DAY_US, BASE_US + 3 * MINUTE_US)) == 4
    assert sum(p.count for p in reader.trend("", BASE_US - DAY_US, BASE_US + 3 * MINUTE_US + 1)) == 5
    row_filter = ReadingFilter(since_us=BASE_US + 10_000_000, until_us=BASE_US + 60_000_000)
    assert len(reader.lines(row_filter)) == 2


def test_a_trend_of_up_to_125_minutes_is_of_readings_and_a_longer_one_of_minutes(
    tmp_path: Path, make_reading: Make
) -> None:
    """The five readings stand each by itself over 7500 s; of a microsecond more, the three minutes they are in."""
    reader = written(tmp_path / "j.sqlite", readings(make_reading))
    longest = 7_500_000_000
    assert [point.count for point in reader.trend("", BASE_US, BASE_US + longest)] == [1] * 5
    assert [point.count for point in reader.trend("", BASE_US, BASE_US + longest + 1)] == [3, 1, 1]


def test_of_many_events_the_newest_thousand_are_reported(tmp_path: Path) -> None:
    """Oldest first, of 1001 all but the first; fewer where fewer are asked for, and of a time its own."""
    with Journal(tmp_path / "j.sqlite"), sqlite3.connect(tmp_path / "j.sqlite") as connection:
        events = [(BASE_US + number, "remark", str(number)) for number in range(1001)]
        connection.executemany("INSERT INTO events (time_us, kind, message) VALUES (?, ?, ?)", events)
    connection.close()
    reader = JournalReader(tmp_path / "j.sqlite")

    def numbers_of(**more: int) -> list[int]:
        return [int(event["message"]) for event in reader.events(**more)]

    assert numbers_of() == list(range(1, 1001))
    assert numbers_of(limit=2) == [999, 1000]
    assert numbers_of(since_us=BASE_US + 5, until_us=BASE_US + 8) == [5, 6, 7]


def test_a_trend_finer_than_its_span_is_one_of_microseconds(tmp_path: Path, make_reading: Make) -> None:
    """Ten microseconds in 1500 points: each reading stands by itself."""
    reader = written(tmp_path / "j.sqlite", readings(make_reading))
    (point,) = reader.trend("", BASE_US - 5, BASE_US + 5, 1500)
    assert (point.value, point.count) == (1.0, 1)
    assert abs(point.time_us - BASE_US) <= 1


def test_what_clients_measure_for_themselves_is_in_no_trend(tmp_path: Path, make_reading: Make) -> None:
    """Readings of a session are kept, listed as `own`, and drawn nowhere; those of a named patch under its name."""
    reader = written(tmp_path / "j.sqlite", readings(make_reading, session="http-1"))
    assert [day(reader, stream, 1) for stream in ("", "own")] == [[], []]
    assert len(reader.lines(ReadingFilter(stream="own"))) == 5
    named = written(tmp_path / "k.sqlite", readings(make_reading, name="lamp"))
    assert [len(day(named, stream, 1)) for stream in ("", "patch lamp")] == [0, 3]


def test_a_budget_is_of_its_own_reading(tmp_path: Path, make_reading: Make) -> None:
    """Each number gives its own lines; one that was deleted, or never was, none."""
    own = [make_reading(time=iso_time(BASE_US), budget=(Contribution("scale", u),)) for u in (0.01, 0.02, 0.03)]
    reader = written(tmp_path / "j.sqlite", own)
    assert [reader.budget(n) for n in (1, 2, 3)] == [{"scale": 0.01}, {"scale": 0.02}, {"scale": 0.03}]
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.drop_older(BASE_US + 1)
    for gone in (0, 1, 2, 4):
        with pytest.raises(InputError, match=f"no reading {gone}"):
            reader.budget(gone)


def test_what_was_handed_out_survives_a_power_cut(tmp_path: Path, connections: list[Watched]) -> None:
    """SQLite waits for the disk at every commit (synchronous = FULL) and writes ahead, so that readers never wait."""
    with Journal(tmp_path / "j.sqlite"):
        (connection,) = connections
        assert connection.execute("PRAGMA synchronous").fetchone() == (2,)
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_limit_of_bytes_is_one(tmp_path: Path, connections: list[Watched]) -> None:
    """A journal of at most 200 kB stays below them."""
    with Journal(tmp_path / "j.sqlite", max_bytes=200_000):
        (connection,) = connections
        (size,), (count,) = (
            connection.execute(f"PRAGMA {name}").fetchone() for name in ("page_size", "max_page_count")
        )
        assert size * count <= 200_000 < size * (count + 1)


async def test_a_jump_is_counted_once(tmp_path: Path, make_reading: Make) -> None:
    """Two jumps of the clock by 10 s and −4 s are a doubt of 6 s however often is committed; each is an event."""
    writer = JournalWriter(Journal(tmp_path / "j.sqlite"), Alarms(lambda *_: None), lambda *_: None)
    await writer.open()
    writer.note_jump(Jump(BASE_US, BASE_US + 10_000_000))
    writer.note_jump(Jump(BASE_US, BASE_US - 4_000_000))
    running = asyncio.create_task(writer.run())
    for _ in range(3):
        await writer.submit(make_reading())
    running.cancel()
    await writer.close()
    again = Journal(tmp_path / "j.sqlite")
    again.open()
    assert again.clock_doubt_us == 6_000_000
    again.close()
    kinds = [event["kind"] for event in JournalReader(tmp_path / "j.sqlite").events()]
    assert kinds == ["clock", "clock"]


async def test_a_jump_that_could_not_be_written_is_written_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its event got through before the disk was full and it alone is left: the doubt of the clock is kept."""
    journal, pauses = Journal(tmp_path / "j.sqlite"), []

    async def pause(seconds: float) -> None:
        pauses.append(seconds)
        monkeypatch.undo()

    def full(by_us: int) -> None:
        raise JournalError("disk full")

    writer = JournalWriter(journal, Alarms(lambda *_: None), lambda *_: None, sleep=pause)
    await writer.open()
    monkeypatch.setattr(journal, "note_jump", full)
    writer.note_jump(Jump(BASE_US, BASE_US + 10_000_000))
    await writer.close()
    assert len(pauses) == 1
    with Journal(tmp_path / "j.sqlite") as again:
        assert again.clock_doubt_us == 10_000_000


async def test_readings_that_still_wait_at_the_end_are_saved(
    tmp_path: Path, make_reading: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk stays full: the daemon fails, and names the file that holds them."""
    journal = Journal(tmp_path / "j.sqlite")

    def full(readings: object) -> None:
        raise JournalError("disk full")

    writer = JournalWriter(journal, Alarms(lambda *_: None), lambda *_: None, retry_s=0.01, closing_s=0.05)
    await writer.open()
    monkeypatch.setattr(journal, "append", full)
    for value in (5.0, 3.0):
        writer.submit(make_reading(radiance=Quantity(value, 0.1, "1")))
    with pytest.raises(OutputError, match="2 readings are not in the journal"):
        await writer.close()
    (saved,) = tmp_path.glob("j.sqlite-waiting-*.jsonl")
    values = [json.loads(line)["radiance"]["value"] for line in saved.read_text(encoding="utf-8").splitlines()]
    assert values == [5.0, 3.0]


async def test_there_is_room_for_so_many_readings_and_no_more(tmp_path: Path, make_reading: Make) -> None:
    """Three that wait fill room for three; once they are committed there is room again, in the order they came."""
    given: list[tuple[int, float]] = []

    def on_commit(reading: Reading, origin: object, seconds: float) -> None:
        given.append((reading.sequence, reading.radiance.value))

    writer = JournalWriter(Journal(tmp_path / "j.sqlite"), Alarms(lambda *_: None), on_commit, capacity=3)
    await writer.open()
    futures = []
    for value in (5.0, 3.0, 4.0):
        await writer.wait_for_room()
        futures.append(writer.submit(make_reading(radiance=Quantity(value, 0.1, "1"))))
    waiting = asyncio.create_task(writer.wait_for_room())
    await asyncio.sleep(0)
    assert (waiting.done(), writer.depth) == (False, 3)
    running = asyncio.create_task(writer.run())
    await waiting
    await asyncio.gather(*futures)
    running.cancel()
    assert writer.depth == 0
    assert [reading.sequence for reading in await asyncio.gather(*futures)] == [1, 2, 3]
    assert given == [(1, 5.0), (2, 3.0), (3, 4.0)]
    await writer.close()


def test_deletion_takes_whole_old_minutes_of_the_trend(tmp_path: Path, make_reading: Make) -> None:
    """What lies before the minute of the bound goes, that minute and the later ones stay."""
    reader = written(tmp_path / "j.sqlite", readings(make_reading))
    with Journal(tmp_path / "j.sqlite") as journal:
        assert journal.drop_older(BASE_US + 60_000_000) == 3
    assert [row[4] for row in day(reader, "", 1)] == [1, 1]


async def test_a_journal_that_is_locked_is_an_alarm_and_no_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It goes by the journal's name and says why; what is wrong with the file itself ends the daemon."""
    journal, alarms = Journal(tmp_path / "j.sqlite"), Alarms(lambda *_: None)
    writer = JournalWriter(journal, alarms, lambda *_: None)

    def locked() -> None:
        raise JournalError("the journal is locked")

    monkeypatch.setattr(journal, "open", locked)
    await writer.open()
    assert [(alarm.name, alarm.message) for alarm in alarms.active] == [("journal", "the journal is locked")]

    def damaged() -> None:
        raise OutputError("the journal is damaged")

    monkeypatch.setattr(journal, "open", damaged)
    with pytest.raises(OutputError, match="damaged"):
        await writer.open()
    await writer.close()


def test_a_journal_that_is_closed_lets_go_of_its_file(
    tmp_path: Path, make_reading: Make, connections: list[Watched]
) -> None:
    """The connection is closed, another daemon may open it; closing twice does nothing."""
    journal = Journal(tmp_path / "j.sqlite")
    journal.open()
    journal.append([make_reading()])
    (connection,) = connections
    journal.close()
    journal.close()
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        connection.execute("SELECT 1")
    with Journal(tmp_path / "j.sqlite") as other:
        assert [reading.sequence for reading in other.append([make_reading()])] == [2]


def test_a_journal_is_recognised_by_its_first_bytes(tmp_path: Path, make_reading: Make) -> None:
    """SQLite's header holds RAMJ at byte 68 and the form at byte 60: journals of before and `file` go by these."""
    written(tmp_path / "j.sqlite", readings(make_reading))
    header = (tmp_path / "j.sqlite").read_bytes()[:100]
    assert (header[:15], header[68:72]) == (b"SQLite format 3", b"RAMJ")
    assert int.from_bytes(header[60:64], "big") == 2


async def test_a_patch_is_kept_although_nothing_else_is_to_be_written(tmp_path: Path) -> None:
    """What is queued of patches alone is committed at the end; the last stated of each counts; a forgotten one goes."""
    writer = JournalWriter(Journal(tmp_path / "j.sqlite"), Alarms(lambda *_: None), lambda *_: None)
    await writer.open()
    writer.keep_patch("lamp", "first")
    writer.keep_patch("gone", "there")
    running = asyncio.create_task(writer.run())
    while await writer.patches() != {"lamp": "first", "gone": "there"}:
        await asyncio.sleep(0)
    running.cancel()
    writer.keep_patch("lamp", "second")
    writer.keep_patch("gone", None)
    await writer.close()
    with Journal(tmp_path / "j.sqlite") as again:
        assert again.patches() == {"lamp": "second"}


@pytest.mark.parametrize(
    ("code", "kind", "message"),
    [
        (sqlite3.SQLITE_FULL, JournalError, "free space"), (sqlite3.SQLITE_BUSY, JournalError, "close that program"),
        (sqlite3.SQLITE_IOERR, JournalError, "trying again"), (sqlite3.SQLITE_CORRUPT, OutputError, "damaged"),
        (sqlite3.SQLITE_BUSY | 2 << 8, JournalError, "close that program"),
    ],
)  # fmt: skip
def test_what_sqlite_refuses_is_reported_with_its_way_out(
    tmp_path: Path, make_reading: Make, connections: list[Watched], code: int, kind: type, message: str
) -> None:
    """By the first byte of SQLite's code; nothing of the batch stays, and the next goes in whole."""
    with Journal(tmp_path / "j.sqlite") as journal:
        for words in ("trend", "COMMIT"):
            with refusing(words, code), pytest.raises(OutputError, match=message) as refusal:
                journal.append([make_reading(), make_reading()])
            assert type(refusal.value) is kind
        assert [reading.sequence for reading in journal.append([make_reading()])] == [1]


def test_a_journal_opens_itself_where_it_is_written_to(tmp_path: Path, make_reading: Make) -> None:
    """No one has to have opened it, at first and after it was closed; the numbers go on."""
    journal = Journal(tmp_path / "j.sqlite")
    for number in (1, 2):
        assert [reading.sequence for reading in journal.append([make_reading()])] == [number]
        journal.note("remark", str(number))
        journal.close()
    reader = JournalReader(tmp_path / "j.sqlite")
    assert [event["message"] for event in reader.events()] == ["1", "2"]

"""A clock that is set is noticed, and deletes nothing."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiometer.daemon import journal_writer
from radiometer.daemon.alarms import Alarms
from radiometer.daemon.clock_watch import ClockWatch, Jump, RetentionClock
from radiometer.daemon.journal import Journal
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.station import Station
from radiometer.daemon.timestamps import iso_time, microseconds
from radiometer.data import Reading

Eventually = Callable[..., Awaitable[None]]
DAY_US, HOUR_US = 86_400_000_000, 3_600_000_000
START_US = microseconds("2026-06-01T00:00:00Z")


class Clocks:
    """A wall clock that can be set and a steady one that cannot."""

    def __init__(self, wall_us: int = START_US) -> None:
        self.wall, self.steady = wall_us, 0

    def go(self, us: int) -> None:
        self.wall += us
        self.steady += us

    @property
    def both(self) -> tuple[Callable[[], int], Callable[[], int]]:
        return lambda: self.wall, lambda: self.steady


@pytest.mark.parametrize(("by_us", "message"), [(-HOUR_US, "back by 60 min"), (10 * DAY_US, "forward by 10 d")])
def test_a_jump_is_reported_once(by_us: int, message: str) -> None:
    """Set back by an hour or forward by ten days: one jump, with both times; then all is quiet."""
    clocks, reported = Clocks(), list[Jump]()
    watch = ClockWatch(reported.append, *clocks.both)
    clocks.go(HOUR_US)
    watch.look()
    clocks.wall += by_us
    clocks.go(1_000_000)
    watch.look()
    clocks.go(1_000_000)
    watch.look()
    (jump,) = reported
    assert jump.by_us == by_us
    assert message in str(jump)


@pytest.mark.parametrize(
    ("by_us", "message"),
    [(-45_600_000, "back by 46 s"), (119_400_000, "forward by 119 s"), (119_600_000, "forward by 2 min"),
     (7_199_000_000, "forward by 120 min"), (-9_000_000_000, "back by 2.5 h"), (172_800_000_000, "forward by 2 d")],
)  # fmt: skip
def test_a_jump_is_reported_in_the_largest_unit_it_holds_twice(by_us: int, message: str) -> None:
    """In whole seconds; minutes, hours and days from two of them on."""
    assert f"{message}, from 2026-06-01T00:00:00Z" in str(Jump(START_US, START_US + by_us))


def test_what_a_time_service_does_is_no_jump() -> None:
    """Half a second per hour, for a day, is followed without a word."""
    clocks, reported = Clocks(), list[Jump]()
    watch = ClockWatch(reported.append, *clocks.both)
    for _ in range(24):
        clocks.go(HOUR_US)
        clocks.wall += 500_000
        watch.look()
    assert reported == []


@pytest.mark.parametrize(
    ("by_us", "reported"), [(4_900_000, False), (5_000_000, True), (-4_900_000, False), (-5_000_000, True)]
)
def test_five_seconds_are_a_jump_and_less_is_not(by_us: int, reported: bool) -> None:
    """Time services move a clock in smaller steps; what was followed is not added up to a jump."""
    clocks, jumps = Clocks(), list[Jump]()
    watch = ClockWatch(jumps.append, *clocks.both)
    for _ in range(2):
        clocks.wall += by_us
        watch.look()
    assert [jump.by_us for jump in jumps] == ([by_us, by_us] if reported else [])


async def test_the_clock_is_looked_at_every_second() -> None:
    """A jump is reported at the next look, after a second at most; a day without one shows nothing."""
    clocks, reported, pauses = Clocks(), list[Jump](), list[float]()
    watch = ClockWatch(reported.append, *clocks.both)

    async def sleep(seconds: float) -> None:
        pauses.append(seconds)
        clocks.go(round(seconds * 1e6))
        if len(pauses) == 3:
            assert reported == []
            clocks.wall += HOUR_US
        if len(pauses) == 5:
            raise asyncio.CancelledError

    with pytest.raises(asyncio.CancelledError):
        await watch.run(sleep)
    assert (set(pauses), [jump.by_us for jump in reported]) == ({1.0}, [HOUR_US])


@pytest.mark.parametrize(
    ("off_us", "by_us"), [(0, 0), (DAY_US, 0), (DAY_US + 1, DAY_US + 1), (-1, -1), (-400 * DAY_US, -400 * DAY_US)]
)
def test_a_day_without_a_daemon_is_believed_and_no_more(
    off_us: int, by_us: int, tmp_path: Path, make_reading: Callable[..., Reading]
) -> None:
    """Off for longer, or with a newest reading in the future, the pause does not count in ages."""
    newest_us = START_US - off_us
    for before_us, left in ((newest_us + by_us, 2), (newest_us + by_us + 1, 1)):
        path = tmp_path / f"{left}.sqlite"
        with Journal(path) as journal:
            journal.append([make_reading(time=iso_time(newest_us))] * 2)
            for _ in range(3):  # starts without a reading count once
                journal.note_opening(START_US)
            journal.drop_older(before_us)
        assert len(list(JournalReader(path).lines(ReadingFilter()))) == left


@pytest.mark.parametrize("seed", range(20))
def test_whatever_the_clock_did_what_is_young_stays_and_what_is_old_goes(
    seed: int, tmp_path: Path, make_reading: Callable[..., Reading]
) -> None:
    """The clock set forward and back, with the daemon on and off, deletions at every start; the true time decides.

    Every reading that is truly younger than 30 days stays. At the end, what ran for longer
    than that after a reading has let it go: nothing is kept for ever.
    """
    random, path = np.random.default_rng(seed), tmp_path / "j.sqlite"
    true_us, off_us, stamps = START_US, 0, list[int]()
    keep_us = 30 * DAY_US

    def drop(journal: Journal) -> None:
        journal.drop_older(true_us + off_us - keep_us)
        left = [json.loads(line)["sequence"] for line in JournalReader(path).lines(ReadingFilter())]
        assert set(left) >= {n + 1 for n, made_us in enumerate(stamps) if true_us - made_us <= keep_us}

    for _ in range(30):
        if random.random() < 0.5:
            off_us = int(random.choice([0, 400, -400, 20, -20, 3])) * DAY_US
        with Journal(path) as journal:
            journal.note_opening(true_us + off_us)
            drop(journal)
            for _ in range(int(random.integers(0, 4))):
                if random.random() < 0.2:
                    set_us = int(random.choice([0, 400, -400, 20, -20])) * DAY_US
                    journal.note_jump(set_us - off_us)
                    off_us = set_us
                true_us += int(random.integers(1, DAY_US))
                stamps.append(true_us)
                journal.append([make_reading(time=iso_time(true_us + off_us))])
                drop(journal)
        true_us += int(random.integers(1, 5 * DAY_US))
    with Journal(path) as journal:
        journal.note_opening(true_us + off_us)
        for _ in range(62):
            true_us += DAY_US // 2
            journal.append([make_reading(time=iso_time(true_us + off_us))])
        drop(journal)
    assert len(list(JournalReader(path).lines(ReadingFilter()))) == 61


def test_events_and_trend_stay_as_long_as_the_readings_of_their_time(
    tmp_path: Path, make_reading: Callable[..., Reading], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stamped while the clock was 30 days behind: right again, an event and a reading go together."""
    path = tmp_path / "j.sqlite"
    behind_us = START_US - 30 * DAY_US
    monkeypatch.setattr(time, "time_ns", lambda: 1000 * (behind_us + HOUR_US))
    with Journal(path) as journal:
        journal.append([make_reading(time=iso_time(START_US))])
        journal.note_jump(-30 * DAY_US)
        journal.note("clock", "set back")
        journal.append([make_reading(time=iso_time(behind_us + HOUR_US))])
        journal.note_jump(30 * DAY_US)
        journal.append([make_reading(time=iso_time(START_US + 2 * HOUR_US))] * 2)
        reader = JournalReader(path)
        for before_us, left in ((START_US + HOUR_US, 1), (START_US + HOUR_US + 1, 0)):
            assert journal.drop_older(before_us) == 1
            assert len(reader.events()) == left
            assert len(reader.trend("", behind_us, behind_us + DAY_US)) == left


async def test_a_jump_is_in_journal_and_state(
    station: Station, eventually: Eventually, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An event of kind clock, and the jump in the state that the page shows."""
    assert station.status()["clock_jump"] is None
    right = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: right() - 1000 * HOUR_US)
    station.clock.look()
    assert station.status()["clock_jump"]["by_s"] == pytest.approx(-3600, abs=1)
    reader = JournalReader(station.journal_path)
    await eventually(lambda: [event["kind"] for event in reader.events()] == ["clock"])
    assert "set back by 60 min" in reader.events()[0]["message"]


async def test_a_jump_before_the_first_look_is_counted_once(
    instrument: Any, tmp_path: Path, make_reading: Callable[..., Reading], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Set forward by 400 d as the daemon starts: an event, and what was measured before is a day old a day later."""
    journal, right = Journal(tmp_path / "j.sqlite"), time.time_ns
    with journal:
        journal.append([make_reading(time=iso_time(right() // 1000))] * 2)
    station = Station(instrument, journal)
    monkeypatch.setattr(time, "time_ns", lambda: right() + 400 * 1000 * DAY_US)
    await station.start()
    await station.acquisition.measure()
    station.clock.look()
    await station.stop("test")
    events = [event["kind"] for event in JournalReader(journal.path).events()]
    with journal:
        assert (events.count("clock"), journal.drop_older(time.time_ns() // 1000 + DAY_US)) == (1, 2)


def test_the_age_is_counted_by_a_clock_that_cannot_be_set() -> None:
    """A forward jump moves it once the journal has noted it, and not before; a clock set back holds it back."""
    clocks = Clocks()
    retention = RetentionClock(*clocks.both)
    clocks.go(HOUR_US)
    assert retention.now_us() == START_US + HOUR_US
    clocks.wall += 10 * DAY_US
    assert retention.now_us() == START_US + HOUR_US
    retention.follow(10 * DAY_US)
    assert retention.now_us() == START_US + HOUR_US + 10 * DAY_US
    clocks.wall = START_US - DAY_US
    assert retention.now_us() == START_US - DAY_US


async def kept_after_start(path: Path, keep_days: float, young: Reading) -> list[int]:
    """Run a writer with a retention over a journal, and return the numbers that are left but for its own two."""
    writer = JournalWriter(Journal(path), Alarms(lambda *_: None), lambda *_: None, keep_days=keep_days)
    await writer.open()
    running = asyncio.create_task(writer.run())
    for _ in range(2):  # what is old goes between the first commit and the second
        await writer.submit(young)
    running.cancel()
    await writer.close()
    return [json.loads(line)["sequence"] for line in JournalReader(path).lines(ReadingFilter())][:-2]


async def test_keep_days_deletes_what_is_older_and_nothing_else(
    tmp_path: Path, make_reading: Callable[..., Reading], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seven days: a reading of eight days goes, one of six stays; with the clock ten days ahead all stay."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        journal.append([make_reading(time=iso_time(START_US - days * DAY_US)) for days in (9, 8, 6, 1, 0)])
    monkeypatch.setattr(RetentionClock.__init__, "__defaults__", (lambda: START_US + 10 * DAY_US, lambda: 0))
    young = make_reading(time=iso_time(START_US + 10 * DAY_US))
    assert await kept_after_start(path, 7.0, young) == [3, 4, 5]
    assert await kept_after_start(path, 0.5, young) == [5, 6, 7]


@pytest.mark.parametrize(("keep_days", "expected_s"), [(30.0, [0.0, 3600.0, 7300.0]), (None, [])])
async def test_old_readings_go_at_the_start_and_every_hour(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    make_reading: Callable[..., Reading],
    keep_days: float | None,
    expected_s: list[float],
) -> None:
    """Whatever wakes the writer between deletes nothing; where all are kept, nothing ever does."""

    class Steady:
        s = 0.0
        perf_counter = staticmethod(time.perf_counter)

        @classmethod
        def monotonic(cls) -> float:
            return cls.s + 500.0

    monkeypatch.setattr(journal_writer, "time", Steady)
    journal = Journal(tmp_path / "j.sqlite")
    writer = JournalWriter(journal, Alarms(lambda *_: None), lambda *_: None, keep_days=keep_days)
    dropped: list[float] = []

    monkeypatch.setattr(journal, "drop_older", lambda before_us: dropped.append(Steady.s) or 0)
    await writer.open()
    running = asyncio.create_task(writer.run())
    for Steady.s in (0.0, 10.0, 3599.0, 3600.0, 5000.0, 7300.0, 7310.0):
        for _ in range(2):  # what is old goes between the first commit and the second
            await writer.submit(make_reading())
    running.cancel()
    await writer.close()
    assert dropped == expected_s


async def test_a_jump_before_a_restart_is_remembered(
    tmp_path: Path, make_reading: Callable[..., Reading], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock jumped, readings were stamped with it, the daemon was started anew: still nothing young goes."""
    path, wall = tmp_path / "j.sqlite", START_US + 10 * DAY_US
    with Journal(path) as journal:
        journal.append([make_reading(time=iso_time(START_US - days * DAY_US)) for days in (9, 6, 1)])
        journal.note_jump(10 * DAY_US)
        journal.append([make_reading(time=iso_time(wall))])
    monkeypatch.setattr(RetentionClock.__init__, "__defaults__", (lambda: wall, lambda: 0))
    assert await kept_after_start(path, 7.0, make_reading(time=iso_time(wall))) == [2, 3, 4]


async def test_a_journal_error_is_told_not_swallowed(
    tmp_path: Path, make_reading: Callable[..., Reading], eventually: Eventually
) -> None:
    """While appending fails nothing is handed out and the alarm is up; afterwards each reading comes exactly once."""
    import asyncio
    import contextlib

    from radiometer.daemon.journal import JournalError

    given: list[int] = []
    alarms = Alarms(lambda *_: None)
    journal: Any = Journal(tmp_path / "j.sqlite")
    writer = JournalWriter(journal, alarms, lambda reading, *_: given.append(reading.sequence), retry_s=0.01)
    await writer.open()
    whole = journal.append

    def broken(readings: Any) -> Any:
        raise JournalError("disk full")

    journal.append = broken
    running = asyncio.create_task(writer.run())
    waiting = [writer.submit(make_reading()) for _ in range(3)]
    await eventually(lambda: alarms.active)
    assert ([alarm.name for alarm in alarms.active], given, writer.depth) == (["journal"], [], 3)
    assert "disk full" in alarms.active[0].message
    assert not any(future.done() for future in waiting)
    journal.append = whole
    assert [reading.sequence for reading in await asyncio.gather(*waiting)] == [1, 2, 3]
    await eventually(lambda: not alarms.active)
    assert given == [1, 2, 3]
    running.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await running
    await writer.close()


async def test_a_clock_that_stays_wrong_over_several_starts_deletes_nothing(
    tmp_path: Path, make_reading: Callable[..., Reading], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock jumps by 400 days between two runs and stays: readings of a minute ago stay, too."""
    path, ahead = tmp_path / "j.sqlite", START_US + 400 * DAY_US
    with Journal(path) as journal:
        journal.append([make_reading(time=iso_time(START_US - days * DAY_US)) for days in (31, 0)])
    monkeypatch.setattr(RetentionClock.__init__, "__defaults__", (lambda: ahead, lambda: 0))
    for first in ([2], [2, 3, 4], [2, 3, 4, 5, 6]):
        assert await kept_after_start(path, 30.0, make_reading(time=iso_time(ahead))) == first


def test_a_clock_that_was_wrong_first_and_is_again_deletes_nothing_young(
    tmp_path: Path, make_reading: Callable[..., Reading]
) -> None:
    """Ahead by 400 days when the journal was made, right for 31 days, then ahead again while no daemon runs."""
    now_us = START_US + 31 * DAY_US
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append([make_reading(time=iso_time(START_US + 400 * DAY_US))] * 2)
        journal.note_jump(-400 * DAY_US)
        journal.append([make_reading(time=iso_time(now_us))] * 3)
        journal.note_opening(now_us + 400 * DAY_US)
        assert journal.drop_older(now_us + 400 * DAY_US - 30 * DAY_US) == 2


def test_pauses_do_not_add_up(tmp_path: Path, make_reading: Callable[..., Reading]) -> None:
    """Off for two days each week: after a year nothing is kept that was measured over 30 days of running before."""
    true_us = START_US
    with Journal(tmp_path / "j.sqlite") as journal:
        for day in range(364):
            true_us += 3 * DAY_US if day % 5 == 0 else DAY_US
            journal.note_opening(true_us)
            journal.append([make_reading(time=iso_time(true_us))])
            journal.drop_older(true_us - 30 * DAY_US)
    left = [json.loads(line)["sequence"] for line in JournalReader(tmp_path / "j.sqlite").lines(ReadingFilter())]
    assert len(left) == 1 + 30 + 30 // 4  # the pause itself is not counted: four days of every five

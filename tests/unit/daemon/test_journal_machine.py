"""The journal against a plain list: whatever is appended, deleted, asked for and reopened, in any order."""

from __future__ import annotations

import asyncio
import json
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.journal import Journal, JournalError
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.timestamps import iso_time
from radiometer.data import Flag, Quantity
from testing.watched_sqlite import refusing

START_US = 1_790_000_000_000_000
HOUR_US = 3_600_000_000
values = st.floats(0.1, 100.0).map(lambda value: round(value, 3))
flags = st.sampled_from([(), (), (Flag.SATURATED,), (Flag.BELOW_NOISE, Flag.UNCALIBRATED)])
streams = st.sampled_from(["", "", "lamp", "own"])
hours = st.sampled_from([0, 0, 1, 1, 2, 5, 30, 60])  # few, so that minutes are shared


class JournalMachine(RuleBasedStateMachine):
    """Does to a journal and to a list the same."""

    make_reading = None

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.path = self.folder / "j.sqlite"
        self.journal = Journal(self.path)
        self.journal.open()
        self.kept, self.last, self.patches, self.notes, self.dropped_us = [], 0, {}, 0, None

    def teardown(self):
        self.journal.close()
        shutil.rmtree(self.folder)

    @rule(entries=st.lists(st.tuples(hours, values, flags, streams), max_size=4))
    def append(self, entries):
        """Readings are numbered on, and come back with their numbers."""
        readings = [
            type(self).make_reading(
                time=iso_time(START_US + hour * HOUR_US),
                radiance=Quantity(value, 0.01 * value, "W·sr⁻¹·m⁻²"),
                flags=which,
                name="lamp" if stream == "lamp" else "",
                session="visitor" if stream == "own" else "",
            )
            for hour, value, which, stream in entries
        ]
        numbers = [reading.sequence for reading in self.journal.append(readings)]
        assert numbers == list(range(self.last + 1, self.last + 1 + len(entries)))
        self.last += len(entries)
        for number, (hour, value, which, stream) in zip(numbers, entries, strict=True):
            self.kept.append(
                (number, START_US + hour * HOUR_US, value, which, f"patch {stream}" if stream == "lamp" else stream)
            )

    @rule(hour=hours)
    def drop(self, hour):
        """What was made before the first young reading goes, the newest never."""
        before_us = START_US + hour * HOUR_US
        young = [entry[0] for entry in self.kept if entry[1] >= before_us]
        first = min(young) if young else self.last
        gone = [entry for entry in self.kept if entry[0] < first]
        assert self.journal.drop_older(before_us) == len(gone)
        self.kept = self.kept[len(gone) :]
        self.dropped_us = max(before_us, self.dropped_us or 0)

    @rule()
    def reopen(self):
        """Nothing is lost by closing, and the times are learnt at the first opening alone."""
        self.journal.close()
        self.journal = Journal(self.path)
        self.journal.open()
        assert self.journal.newest_at_opening_us == (self.kept[-1][1] if self.kept else None)

    @rule()
    def fail(self):
        """A transaction that cannot be committed leaves nothing behind."""
        reading = type(self).make_reading()
        with refusing("INTO trend"), pytest.raises(JournalError):  # after the readings have gone in
            self.journal.append([reading, reading])

    @rule(name=st.sampled_from("ab"), line=st.sampled_from([None, "{}", '{"x": 1}']))
    def keep_patch(self, name, line):
        """The newest line of a name counts; None forgets it."""
        self.journal.keep_patch(name, line)
        self.patches.pop(name, None)
        if line is not None:
            self.patches[name] = line
        assert self.journal.patches() == dict(sorted(self.patches.items()))

    @rule(
        since=st.none() | hours,
        until=st.none() | hours,
        after=st.none() | st.integers(0, 20),
        limit=st.none() | st.integers(0, 5),
        flag=st.sampled_from([None, None, "saturated", "uncalibrated"]),
        clean=st.booleans(),
        newest=st.booleans(),
        stream=st.sampled_from([None, None, "", "patch lamp", "own"]),
    )
    def ask(self, since, until, after, limit, flag, clean, newest, stream):
        """A filter gives exactly what a list comprehension gives."""
        since_us, until_us = (None if hour is None else START_US + hour * HOUR_US for hour in (since, until))
        row_filter = ReadingFilter(since_us, until_us, after, flag, clean, limit, newest, stream)
        found = [json.loads(line)["sequence"] for line in JournalReader(self.path).lines(row_filter)]
        expected = [
            number
            for number, at_us, _, which, where in self.kept
            if (since_us is None or at_us >= since_us)
            and (until_us is None or at_us < until_us)
            and (after is None or number > after)
            and (flag is None or flag in map(str, which))
            and not (clean and which)
            and (stream is None or where == stream)
        ]
        expected = expected[::-1] if newest else expected
        assert found == expected[:limit]

    @rule(stream=st.sampled_from(["", "patch lamp"]), fine=st.booleans())
    def trend(self, stream, fine):
        """Counts, extremes and means of a stream are those of its readings, from readings or from minutes."""
        span = (START_US, START_US + HOUR_US) if fine else (START_US, START_US + 100 * HOUR_US)
        if not fine and self.dropped_us is not None:
            return  # minutes are deleted by their time, readings by their place
        points = JournalReader(self.path).trend(stream, *span)
        own = [entry for entry in self.kept if entry[4] == stream and span[0] <= entry[1] < span[1]]
        assert sum(point.count for point in points) == len(own)
        assert sum(point.flagged for point in points) == sum(bool(entry[3]) for entry in own)
        assert sum(point.value * point.count for point in points) == pytest.approx(sum(entry[2] for entry in own))
        assert sum(point.u * point.count for point in points) == pytest.approx(sum(0.01 * entry[2] for entry in own))
        assert JournalReader(self.path).trend("own", START_US, START_US + 100 * HOUR_US) == []
        for point in points:
            inside = [entry for entry in own if abs(entry[1] - point.time_us) <= HOUR_US / 2]
            assert (point.low, point.high) == (min(e[2] for e in inside), max(e[2] for e in inside))

    @invariant()
    def numbers_have_no_hole(self):
        """Lowest, highest and count are the list's."""
        expected = (self.kept[0][0], self.kept[-1][0], len(self.kept)) if self.kept else (0, 0, 0)
        assert JournalReader(self.path).bounds() == expected


@pytest.mark.usefixtures("connections")
def test_a_journal_is_a_list_that_stays(make_reading):
    """Numbers, filters, trend, deletion, patches and failures agree with a plain list, in any order."""
    JournalMachine.make_reading = staticmethod(make_reading)
    run_state_machine_as_test(
        JournalMachine,
        settings=settings(
            max_examples=25, stateful_step_count=15, deadline=None, suppress_health_check=list(HealthCheck)
        ),
    )


def test_a_trend_point_stands_in_the_middle_of_its_time(tmp_path, make_reading):
    """Fine: within the bucket of span/points; coarse: whole minutes, each counted once; the bounds belong as stated."""
    at = [0, 60_000_000, 119_999_999, 120_000_000]
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append([make_reading(time=iso_time(START_US - START_US % HOUR_US + us)) for us in at])
    base = START_US - START_US % HOUR_US
    reader = JournalReader(tmp_path / "j.sqlite")
    fine = reader.trend("", base, base + 120_000_000, points=2)
    assert [(point.time_us - base, point.count) for point in fine] == [(30_000_000, 1), (90_000_000, 2)]
    coarse = reader.trend("", base, base + 3 * HOUR_US, points=180)
    assert [(point.time_us - base, point.count) for point in coarse] == [
        (30_000_000, 1),
        (90_000_000, 2),
        (150_000_000, 1),
    ]
    coarser = reader.trend("", base, base + 3 * HOUR_US, points=60)
    assert [(point.time_us - base) % 180_000_000 for point in coarser] == [90_000_000] * len(coarser)
    assert sum(point.count for point in coarser) == 4


def test_an_undefined_radiance_is_not_drawn(tmp_path, make_reading):
    """Neither of two hours nor of a day; the reading itself is kept."""
    with Journal(tmp_path / "j.sqlite") as journal:
        undefined = make_reading(time=iso_time(START_US), radiance=Quantity(float("nan"), float("nan"), "relative"))
        unknown_u = make_reading(time=iso_time(START_US), radiance=Quantity(2.0, float("inf"), "relative"))
        journal.append([undefined, unknown_u, make_reading(time=iso_time(START_US))])
    reader = JournalReader(tmp_path / "j.sqlite")
    for span in (HOUR_US, 100 * HOUR_US):
        points = reader.trend("", START_US - HOUR_US // 2, START_US + span)
        assert sorted((point.count, point.low, point.u) for point in points) == [(1, 1.0, 0.01), (1, 2.0, 0.0)]
    assert reader.bounds() == (1, 3, 3)


async def test_what_cannot_be_deleted_is_an_alarm(tmp_path, make_reading, monkeypatch):
    """A journal that grows because nothing can be deleted must be reported."""
    alarms = Alarms(lambda *_: None)
    journal = Journal(tmp_path / "j.sqlite")
    writer = JournalWriter(journal, alarms, lambda *_: None, keep_days=1.0)
    await writer.open()

    def refused(before_us):
        raise JournalError("read-only file system")

    monkeypatch.setattr(journal, "drop_older", refused)
    running = asyncio.create_task(writer.run())
    while not alarms.active:
        await asyncio.sleep(0)
    running.cancel()
    assert ["read-only" in alarm.message for alarm in alarms.active] == [True]
    await writer.close()


def test_deletion_deletes_all_that_is_old(tmp_path, make_reading):
    """Readings and events go in one call, and of the trend whole old minutes."""
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append([make_reading(time=iso_time(START_US + hour * HOUR_US)) for hour in range(10)])
        journal.note("device", "lost")
        assert journal.drop_older(START_US + 9 * HOUR_US) == 9
        reader = JournalReader(tmp_path / "j.sqlite")
        assert sum(point.count for point in reader.trend("", START_US, START_US + 20 * HOUR_US)) == 1
        assert len(reader.events()) == 1
        journal.drop_older(2**61)
        assert (reader.events(), reader.bounds()) == ([], (10, 10, 1))


@pytest.mark.parametrize(
    ("text", "age_s"), [("90s", 90), ("15min", 900), ("15m", 900), ("2h", 7200), ("7d", 604_800), ("2w", 1_209_600)]
)
def test_ages_are_what_their_units_say(text, age_s):
    """Each unit in s."""
    from radiometer.daemon.timestamps import parse_moment

    assert parse_moment(text, now=START_US) == START_US - age_s * 1_000_000

"""A machine of hypothesis that does to a journal and to a plain list the same, in any order."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from radiometer.daemon.journal import Journal, JournalError
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.timestamps import iso_time
from radiometer.data import Flag, Quantity
from testing.watched_sqlite import refusing

START_US = 1_790_000_000_000_000
HOUR_US = 3_600_000_000
values = st.floats(0.1, 100.0).map(lambda value: round(value, 3))
flags = st.sampled_from([(), (), (Flag.SATURATED,), (Flag.BELOW_NOISE, Flag.UNCALIBRATED)])
streams = st.sampled_from(["", "", "lamp", "own"])
hours = st.sampled_from([0, 0, 1, 1, 2, 5, 30, 60])  # few, so that minutes are shared


def bound_of(flags_of_reading: tuple[Flag, ...]) -> str:
    """Return what a value with these flags is: at least or at most the true one, or its measurement."""
    bounds = {Flag.SATURATED: "at least", Flag.BELOW_NOISE: "at most"}
    return next((bound for flag, bound in bounds.items() if flag in flags_of_reading), "")


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
        given = [reading.sequence for reading in self.journal.append(readings)]
        assert given == list(range(self.last + 1, self.last + 1 + len(entries)))
        self.last += len(entries)
        for number, (hour, value, which, stream) in zip(given, entries, strict=True):
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
        """Nothing is lost by closing."""
        self.journal.close()
        self.journal = Journal(self.path)
        self.journal.open()

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
            near = (entry for entry in own if abs(entry[1] - point.time_us) <= HOUR_US / 2)
            inside = [entry for entry in near if bound_of(entry[3]) == point.bound]
            assert (point.low, point.high) == (min(e[2] for e in inside), max(e[2] for e in inside))

    @invariant()
    def numbers_have_no_hole(self):
        """Lowest, highest and count are the list's."""
        expected = (self.kept[0][0], self.kept[-1][0], len(self.kept)) if self.kept else (0, 0, 0)
        assert JournalReader(self.path).bounds() == expected

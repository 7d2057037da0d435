"""A period that is not kept, and readings that stay away, are alarms; hours pass in no time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.lateness import Lateness


class _Bench:
    """Lets time pass in steps, with a measurement begun and a reading come every so often."""

    def __init__(self, every_s: float | None) -> None:
        self.now = 1000.0
        self.changes: list[tuple[str, str]] = []
        self.alarms = Alarms(lambda kind, name, message: self.changes.append((kind, name)))
        self.lateness = Lateness(self.alarms, clock=lambda: self.now)
        self.lateness.follow(every_s)

    @property
    def up(self) -> set[str]:
        return {alarm.name for alarm in self.alarms.active}

    def measure(self, pace_s: float, count: int, *, reads: bool = True) -> None:
        for _ in range(count):
            self.lateness.begun("shared")
            if reads:
                self.lateness.came("main")
            for _ in range(4):
                self.now += pace_s / 4
                self.lateness.look()

    def wait(self, seconds: float, *, able: bool = True, paused: bool = False) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.5
            self.lateness.look(able=able, paused=paused)


@given(every_s=st.floats(0.05, 3600.0), slower=st.floats(1.0, 1.05))
def test_a_period_that_is_kept_is_no_alarm(every_s: float, slower: float) -> None:
    """Neither is a machine that is a little late at every turn."""
    bench = _Bench(every_s)
    bench.measure(slower * every_s, max(20, round(25 / every_s)))
    assert bench.changes == []


@given(every_s=st.floats(0.05, 3600.0), slower=st.floats(1.8, 4.5))
def test_a_period_that_is_not_kept_is_one_alarm_until_it_is(every_s: float, slower: float) -> None:
    """It does not flap at a steady pace; its end needs the pace that was asked for."""
    bench = _Bench(every_s)
    bench.measure(slower * every_s, max(20, round(25 / every_s)))
    assert bench.changes == [("alarm", "period")]
    bench.measure(every_s, max(20, round(25 / every_s)))
    assert bench.changes == [("alarm", "period"), ("cleared", "period")]


@pytest.mark.parametrize(("every_s", "after_s"), [(0.0, 10.0), (1.0, 10.0), (60.0, 300.0)])
def test_only_a_reading_ends_the_alarm_that_none_comes(every_s: float, after_s: float) -> None:
    """Five periods and ten seconds after the last one; measurements that begin and come to nothing end nothing."""
    bench = _Bench(every_s)
    bench.measure(max(every_s, 0.1), 3)
    bench.wait(after_s - max(every_s, 0.1) - 0.6, able=False)
    assert bench.up == set()
    bench.wait(2.0, able=False)
    assert bench.up == {"reading"}
    bench.measure(max(every_s, 0.1), 20, reads=False)
    assert "reading" in bench.up
    bench.lateness.came("main")
    assert "reading" not in bench.up


def test_a_patch_with_a_name_is_missed_by_its_name() -> None:
    """Readings of the shared patch do not hide it; where it is deleted or nothing is measured, nothing is missed."""
    bench = _Bench(1.0)
    for name in ("lamp", "wall"):
        bench.lateness.expect(name)
    bench.measure(1.0, 12)
    assert bench.up == {"reading lamp", "reading wall"}
    bench.lateness.forget("lamp")
    assert bench.up == {"reading wall"}
    bench.lateness.follow(None)
    bench.wait(100.0)
    assert bench.up == set()


def test_a_lost_camera_is_its_own_alarm_and_no_period_is_missed_meanwhile() -> None:
    """Hours without a camera: readings are missed, the period is not; after its return it has its window again."""
    bench = _Bench(1.0)
    bench.wait(3600.0, able=False)
    assert bench.up == {"reading"}
    bench.measure(1.0, 30)
    assert bench.up == set()


def test_a_pause_for_the_journal_is_no_lack_of_readings() -> None:
    """Hours in which measuring is paused: its alarm is the journal's; after the pause readings are due as before."""
    bench = _Bench(1.0)
    bench.measure(1.0, 3)
    bench.wait(3600.0, paused=True)
    assert bench.changes == []
    bench.wait(9.5)
    assert bench.up == set()
    bench.wait(2.0)
    assert "reading" in bench.up

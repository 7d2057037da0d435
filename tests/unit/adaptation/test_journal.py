"""The journal: on disk at once, a torn end is cut, damage elsewhere is refused."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from radiometer.adaptation.journal import RunJournal, read_events
from radiometer.errors import InputError, OutputError


def test_events_read_back_in_order(tmp_path: Path) -> None:
    """What was written is what is read, numbered."""
    with RunJournal(tmp_path / "j") as journal:
        journal.write("start", 0.0, subject="A")
        journal.write("trial", 1.5, threshold=-1.0)
    events = read_events(tmp_path / "j")
    assert [e["kind"] for e in events] == ["start", "trial"]
    assert events[1] == {"sequence": 1, "kind": "trial", "time_s": 1.5, "threshold": -1.0}


def test_half_written_line_is_cut_and_the_next_event_follows(tmp_path: Path) -> None:
    """A crash in the middle of a write costs that event only."""
    file = tmp_path / "j"
    with RunJournal(file) as journal:
        journal.write("start", 0.0)
        journal.write("trial", 1.0)
    file.write_bytes(file.read_bytes()[:-7])
    with RunJournal(file) as journal:
        assert len(journal.events) == 1
        journal.write("trial", 2.0)
    assert [e["time_s"] for e in read_events(file)] == [0.0, 2.0]


def test_two_programs_never_write_one_test(tmp_path: Path) -> None:
    """Neither while one runs it, nor after it went on since the other read it."""
    file = tmp_path / "j"
    with RunJournal(file) as running:
        running.write("start", 0.0)
        late = RunJournal(file)
        with pytest.raises(OutputError, match="another program runs this test"):
            late.__enter__()
        running.write("trial", 1.0)
    with pytest.raises(OutputError, match="meanwhile"):
        late.__enter__()
    assert len(read_events(file)) == 2


@pytest.mark.parametrize("damage", [b"{not json}\n", b'{"sequence": 5, "kind": "trial", "time_s": 1}\n'])
def test_damage_in_the_middle_is_refused_with_its_line(tmp_path: Path, damage: bytes) -> None:
    """A journal with a hole is not taken up."""
    file = tmp_path / "j"
    file.write_bytes(b'{"sequence": 0, "kind": "start", "time_s": 0}\n' + damage + b"{}\n")
    with pytest.raises(InputError, match="line 2"):
        read_events(file)


def test_an_event_is_on_the_disk_unless_it_need_not_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a word each event waits for the disk; one that need not last only leaves the program."""
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with RunJournal(tmp_path / "j") as journal:
        journal.write("start", 0.0)
        after_start = len(synced)
        journal.write("blink", 1.0, lasting=False)
        assert len(synced) == after_start
        assert [e["kind"] for e in read_events(tmp_path / "j")] == ["start", "blink"]
        journal.write("trial", 2.0)
        assert len(synced) == after_start + 1
    assert after_start >= 1

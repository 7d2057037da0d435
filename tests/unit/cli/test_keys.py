"""Single keys: heard from a terminal, left alone without one, and the terminal as it was afterwards."""

from __future__ import annotations

import io
import os
import pty
import sys
import termios
import threading
from collections.abc import Iterator

import pytest

from radiometer.cli.keys import listening
from testing.patience import within


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Return the other end of a terminal that is standard input."""
    outer, inner = pty.openpty()
    with os.fdopen(inner, "r") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield outer
    os.close(outer)


def test_keys_call_their_actions_without_enter(keyboard: int) -> None:
    """Other keys do nothing; echo and line mode are back after the block."""
    heard, paused, stopped = [], threading.Event(), threading.Event()
    before = termios.tcgetattr(sys.stdin.fileno())
    actions = {"p": lambda: (heard.append("p"), paused.set()), "q": lambda: (heard.append("q"), stopped.set())}
    with listening(actions):  # type: ignore[arg-type]
        os.write(keyboard, b"xp")
        assert paused.wait(within(60.0))
        os.write(keyboard, b"q")
        assert stopped.wait(within(60.0))
    assert heard == ["p", "q"]
    assert termios.tcgetattr(sys.stdin.fileno()) == before


def test_nothing_is_read_where_input_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pipe belongs to whoever wrote into it."""
    monkeypatch.setattr(sys, "stdin", io.StringIO("ppp"))
    with listening({"p": pytest.fail}):  # type: ignore[dict-item]
        pass
    assert sys.stdin.read() == "ppp"

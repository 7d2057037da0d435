"""Single keys while a command runs, where standard input is a terminal."""

from __future__ import annotations

import os
import select
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Final

LOOK_S: Final = 0.2  # how long the end waits for the thread at most


@contextmanager
def listening(actions: Mapping[str, Callable[[], None]]) -> Iterator[None]:
    """Call an action for each of its keys, from a thread, while the block runs; nothing without a terminal.

    Args:
        actions: What each key does; it must be safe to call from another thread.
    """
    if not sys.stdin.isatty():
        yield
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    over = threading.Event()
    reader = threading.Thread(target=_read_keys, args=(terminal, actions, over), name="keys", daemon=True)
    tty.setcbreak(terminal)
    reader.start()
    try:
        yield
    finally:
        over.set()
        reader.join()
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _read_keys(terminal: int, actions: Mapping[str, Callable[[], None]], over: threading.Event) -> None:
    while not over.is_set():
        if not select.select([terminal], [], [], LOOK_S)[0]:
            continue
        key = os.read(terminal, 1).decode(errors="replace")
        if not key:
            return
        if key in actions:
            actions[key]()

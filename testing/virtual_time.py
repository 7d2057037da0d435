"""An event loop whose clock jumps to the next timer: hours of patience are tested at once, to the millisecond."""

from __future__ import annotations

import asyncio
import functools
import selectors
from collections.abc import Callable, Coroutine
from typing import Any


class _Jumping(selectors.DefaultSelector):
    """A selector that never waits: what would be waited is added to its clock."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 1000.0

    def select(self, timeout: float | None = None) -> list[Any]:
        ready = super().select(0)
        if ready or timeout == 0:
            return ready
        if timeout is None:
            raise RuntimeError("the test waits for what no timer brings")
        self.now += max(timeout, 0.0)
        return []


class VirtualLoop(asyncio.SelectorEventLoop):
    """A loop without real time; nothing may run in threads next to it."""

    def __init__(self) -> None:
        self._jumping = _Jumping()
        super().__init__(self._jumping)

    def time(self) -> float:
        """Return the virtual time in s."""
        return self._jumping.now


def in_virtual_time(story: Callable[..., Coroutine[Any, Any, Any]]) -> Callable[..., Any]:
    """Return a test that runs a coroutine function in virtual time."""

    @functools.wraps(story)
    def test(*arguments: Any, **named: Any) -> Any:
        return run(story(*arguments, **named))

    return test


def run(work: Coroutine[Any, Any, Any]) -> Any:
    """Run a coroutine to its end in virtual time."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(work)

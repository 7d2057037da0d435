"""An event loop whose clock jumps to the next timer whenever nothing is left to do: a day passes in minutes."""

from __future__ import annotations

import asyncio
import contextlib
import selectors
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from typing import Any

_REAL_WAIT_S = 0.002


class _JumpingSelector(selectors.DefaultSelector):
    """Waits in real time while a thread works for the loop; else lets simulated time pass at once."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s, self.working = 1000.0, 0

    def select(self, timeout: float | None = None) -> Any:
        """Return what is ready; where nothing is, jump to the next timer."""
        if self.working or timeout is None:
            return super().select(_REAL_WAIT_S)
        ready = super().select(0)
        if not ready and timeout > 0:
            self.now_s += timeout
        return ready


class SimulatedTimeLoop(asyncio.SelectorEventLoop):
    """An event loop in simulated time; what runs in executors takes none of it."""

    def __init__(self) -> None:
        self._jumping = _JumpingSelector()
        super().__init__(self._jumping)

    def time(self) -> float:
        """Return simulated seconds."""
        return self._jumping.now_s

    def run_in_executor(self, executor: Executor | None, func: Callable[..., Any], *args: Any) -> asyncio.Future[Any]:
        """Run a call in a thread; simulated time stands still until it is over."""
        self._jumping.working += 1
        future = super().run_in_executor(executor, func, *args)
        future.add_done_callback(self._done)
        return future

    def _done(self, future: asyncio.Future[Any]) -> None:
        self._jumping.working -= 1


@contextlib.contextmanager
def simulated_time() -> Iterator[SimulatedTimeLoop]:
    """Give a loop in simulated time, which `time.monotonic` shows too while the block runs."""
    loop, real = SimulatedTimeLoop(), time.monotonic
    time.monotonic = loop.time
    try:
        yield loop
    finally:
        time.monotonic = real
        loop.close()

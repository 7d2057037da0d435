"""Runs a library's calls in a separate thread, so that one which waits for a camera that is gone can be left behind.

A register access to a GigE Vision camera that was unplugged ends after 2.5 s. Before that it may wait for the
library's heartbeat, which asks as patiently: 10 s in all. Nothing in the library shortens or breaks that off.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import Any, Final, TypeVar

from radiometer.errors import DeviceLost

_Result = TypeVar("_Result")
PATIENCE_S: Final = 0.5  # an access takes ms; then it is asked whether the camera is there at all


@dataclass(slots=True)
class _Job:
    call: Callable[[], Any] | None
    done: threading.Event = field(default_factory=threading.Event)
    result: Any = None
    error: BaseException | None = None


class CallThread:
    """One call at a time in a thread that ends with `close()`, or with the call it was left with.

    Args:
        is_gone: Asks the camera whether it is there, past the library; called while a call takes long.
        patience_s: How long a call may take before that is asked, and between two questions, in s.
        deadline_s: How long a call may take at all in s; None for as long as the camera is there.
    """

    def __init__(
        self, name: str, is_gone: Callable[[], bool], patience_s: float = PATIENCE_S, deadline_s: float | None = None
    ) -> None:
        self._name, self._is_gone, self._patience_s = name, is_gone, patience_s
        self._questions = math.inf if deadline_s is None else math.ceil(deadline_s / patience_s)
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._ended = False
        threading.Thread(target=_work, args=(self._jobs,), name="camera calls", daemon=True).start()

    def run(self, method: Callable[..., _Result], *arguments: Any) -> _Result:
        """Return `method(*arguments)`, or raise what it raises.

        Raises:
            DeviceLost: If the camera was found gone while the call waited, its deadline passed, or the thread has
                ended. A call left behind ends by itself, unheeded.
        """
        if self._ended:
            raise self._lost()
        job = _Job(lambda: method(*arguments))
        self._jobs.put(job)
        asked = 0
        while not job.done.wait(self._patience_s):
            asked += 1
            if (asked >= self._questions or self._is_gone()) and not job.done.is_set():
                self.close()
                raise self._lost()
        error, job.error = job.error, None
        if error is None:
            result: _Result = job.result
            return result
        try:
            raise error
        finally:
            del error  # an exception that its own frame holds keeps the camera alive as garbage

    def close(self) -> None:
        """End the thread once the call in progress is over; no further call is made."""
        self._ended = True
        self._jobs.put(None)

    def _lost(self) -> DeviceLost:
        return DeviceLost(f"{self._name} stopped answering; check its cable and power, then open it again")


def _work(jobs: SimpleQueue[_Job | None]) -> None:
    while (job := jobs.get()) is not None:
        try:
            if job.call is not None:
                job.result = job.call()
        except BaseException as error:  # noqa: BLE001  (it is raised where the call was asked for)
            job.error = error
        job.call = None
        job.done.set()
        del job

"""Runs a library's calls in a separate thread, so that one which waits for a camera that is gone can be left behind.

A register access to a GigE Vision camera that was unplugged ends after 2.5 s. Before that it may wait for the
library's heartbeat, which asks as patiently: 10 s in all. Nothing in the library shortens or breaks that off.

When the library's objects end, they say goodbye to the camera: the stream closes its channel, the device gives up
control. Each goodbye to a camera that no longer answers waits 2.5 s, in whichever thread drops the object last.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
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


_OWN_REFERENCES: Final = 2  # that of the list, and that of the question itself
_LOOK_S: Final = 0.05  # short against the 2.5 s that each goodbye may wait
_PATIENCE_S: Final = 60.0  # an exception may hold an object for a while; a minute later it is dropped whoever holds it
# A second between two heartbeats, 5 s in which one is repeated, five times 0.5 s for the last of them (Aravis 0.8).
HEARTBEAT_S: Final = 10.0


def drop_in_background(*objects: Any) -> None:
    """Take over objects of the library, and drop them in a separate thread once no other code holds them.

    Args:
        *objects: Objects to let go, in the order in which they are to end. The caller drops its own references, which
            an exception on its way up may hold a while longer.
    """
    threading.Thread(target=_drop, args=(list(objects),), name="camera release", daemon=True).start()


def give_up_in_background(camera: Any, library_error: type[Exception]) -> None:
    """Take a camera of the library over that was lost; give up control and drop it once its heartbeat is over.

    A camera that is back by now is free for others as soon as control is given up.

    Args:
        camera: An `Aravis.Camera`.
        library_error: The exception class of the library, `GLib.Error`.
    """
    threading.Thread(target=_give_up, args=([camera], library_error), name="camera release", daemon=True).start()


def _give_up(kept: list[Any], library_error: type[Exception]) -> None:
    if kept[0].is_gv_device():
        with suppress(library_error):  # it is gone: that it does not answer is no news
            kept[0].get_device().leave_control()
        time.sleep(HEARTBEAT_S)
    _drop(kept)


def _drop(kept: list[Any]) -> None:
    give_up = time.monotonic() + _PATIENCE_S
    while kept:
        if sys.getrefcount(kept[0]) > _OWN_REFERENCES and time.monotonic() < give_up:
            time.sleep(_LOOK_S)
        else:
            del kept[0]

"""What the system gives the daemon: memory goes back to it, and an alarm is up where no descriptor is free."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import os
import resource
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, Final

from radiometer.daemon.alarms import Alarms

_PERIOD_S: Final = 60.0  # a minute: pieces do not add up, and collecting seldom pauses a measurement
_M_ARENA_MAX: Final = -8  # malloc.h of glibc
_MOST_ARENAS: Final = 2  # one for the event loop, one for the threads of the devices


def limit_arenas() -> None:
    """Have threads share two arenas: glibc gives each its own, up to eight per core, and each keeps its pieces."""
    _library_call("mallopt", _M_ARENA_MAX, _MOST_ARENAS)


def give_back() -> None:
    """Collect garbage that refers to itself, and return what is free to the system."""
    gc.collect()
    _library_call("malloc_trim", 0)


def keep_loaded() -> None:
    """Leave what is loaded by now out of all further collections.

    Modules stay until the daemon ends. A collection that looks through them holds the interpreter for 0.1 s, in which
    no client gets a reply.
    """
    gc.collect()
    gc.freeze()


async def level_memory(sleep: Callable[[float], Awaitable[None]] = asyncio.sleep) -> None:
    """Give memory back every minute, for ever."""
    keep_loaded()
    try:
        await sleep(_PERIOD_S)
        await asyncio.to_thread(keep_loaded)  # with what the first measurements and requests have loaded
        while True:
            await asyncio.to_thread(give_back)
            await sleep(_PERIOD_S)
    finally:
        gc.unfreeze()


def _library_call(name: str, *arguments: int) -> None:
    """Call a function of the C library where it has it; musl and others have neither of these."""
    call = getattr(ctypes.CDLL(None), name, None)
    if call is not None:
        call(*arguments)


ALARM: Final = "descriptors"
_QUEUE: Final = 100  # connections that the system keeps until they are accepted; asyncio's own figure
_ENOUGH: Final = 4096  # several times what the limits of all interfaces together allow
_FREE: Final = 0.1  # share that must be free again before the alarm ends: else it would flap
_OPEN: Final = Path("/proc/self/fd")


def raise_limit() -> None:
    """Allow the daemon more descriptors, as far as the system permits: often 1024 are the default, not the limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _ENOUGH if hard == resource.RLIM_INFINITY else min(hard, _ENOUGH)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, most), hard))


async def listen(protocol: Callable[[], asyncio.BaseProtocol], address: str, port: int) -> asyncio.Server:
    """Listen on a TCP port, and accept one connection per turn of the event loop.

    With a backlog of n, asyncio tries n times per turn to accept, and after each failure n times more a second later
    (`_accept_connection` in asyncio/selector_events.py): without descriptors, 17,000 log lines a second.

    Raises:
        OSError: If the port is taken.
    """
    server = await asyncio.get_running_loop().create_server(protocol, address, port, backlog=1)
    for one in server.sockets:
        with socket.socket(fileno=os.dup(one.fileno())) as same:
            same.listen(_QUEUE)
    return server


class Descriptors:
    """Puts the alarm up where a connection cannot be accepted, and down once descriptors are free again.

    Args:
        alarms: Where it is reported.
    """

    def __init__(self, alarms: Alarms) -> None:
        self._alarms = alarms

    def take_error(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Handle what the event loop could not: the rest is logged as ever."""
        if "out of system resource" not in str(context.get("message")):
            loop.default_exception_handler(context)
            return
        self._alarms.put_up(
            ALARM,
            f"no file descriptor is free ({resource.getrlimit(resource.RLIMIT_NOFILE)[0]} are allowed), so new clients"
            " wait; end clients that are not needed, or raise LimitNOFILE of the service",
        )

    def look(self) -> None:
        """Take the alarm down where a tenth of the descriptors is free."""
        if not self._alarms.message_of(ALARM):
            return
        try:
            used = sum(1 for _ in _OPEN.iterdir())
        except OSError:
            return  # looking needs one itself
        if used < (1 - _FREE) * resource.getrlimit(resource.RLIMIT_NOFILE)[0]:
            self._alarms.clear(ALARM, "file descriptors are free again")

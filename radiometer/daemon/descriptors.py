"""Keeps the daemon calm where the system gives no more file descriptors: one alarm instead of a flood of log lines."""

from __future__ import annotations

import asyncio
import os
import resource
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from radiometer.daemon.alarms import Alarms

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

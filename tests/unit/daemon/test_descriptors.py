"""Where the system gives no more file descriptors, the daemon says so once, and serves again when some are free."""

from __future__ import annotations

import asyncio
import os
import resource
import socket
from contextlib import ExitStack

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.descriptors import Descriptors, listen


async def test_no_descriptors_are_one_alarm_and_a_few_tries_a_second() -> None:
    """Fifty clients knock while none can be taken: nothing floods, and all are served afterwards."""
    changes: list[str] = []
    descriptors = Descriptors(Alarms(lambda kind, name, message: changes.append(f"{kind} {name}")))
    loop, tries, served = asyncio.get_running_loop(), 0, 0

    def take(failed: asyncio.AbstractEventLoop, context: dict[str, object]) -> None:
        nonlocal tries
        tries += 1
        descriptors.take_error(failed, context)

    class Client(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            nonlocal served
            served += 1

    loop.set_exception_handler(take)
    server = await listen(Client, "127.0.0.1", 0)
    address = server.sockets[0].getsockname()
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with ExitStack() as clients:
        try:
            waiting = [clients.enter_context(socket.socket()) for _ in range(50)]
            for one in waiting:
                one.setblocking(False)
                one.connect_ex(address)
            lowest_free = os.dup(0)
            os.close(lowest_free)
            resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free, limits[1]))
            await asyncio.sleep(2.5)
            assert 1 <= tries <= 10
            descriptors.look()
            assert changes == ["alarm descriptors"]
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        async with asyncio.timeout(20):
            while served < 50:
                await asyncio.sleep(0.05)
        descriptors.look()
        assert changes == ["alarm descriptors", "cleared descriptors"]
    server.close()

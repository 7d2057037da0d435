"""Keeps the daemon's memory level: what is free goes back to the system, before months of pieces add up."""

from __future__ import annotations

import asyncio
import ctypes
import gc
from collections.abc import Awaitable, Callable
from typing import Final

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


async def run(sleep: Callable[[float], Awaitable[None]] = asyncio.sleep) -> None:
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

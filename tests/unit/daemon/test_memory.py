"""What is free goes back to the system, every minute."""

from __future__ import annotations

import ctypes
import gc
from types import SimpleNamespace

import pytest

from radiometer.daemon import memory


async def test_memory_is_given_back_every_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    """Garbage is collected first, then the C library returns what is free; the pause is a minute."""
    done: list[str] = []
    library = SimpleNamespace(malloc_trim=lambda pad: done.append(f"trim {pad}"))
    monkeypatch.setattr(ctypes, "CDLL", lambda name: library)
    monkeypatch.setattr(gc, "collect", lambda: done.append("collect"))
    pauses: list[float] = []

    async def sleep(seconds: float) -> None:
        if len(pauses) == 2:
            raise InterruptedError
        pauses.append(seconds)

    with pytest.raises(InterruptedError):
        await memory.run(sleep)
    assert pauses == [60.0, 60.0]
    assert done == ["collect", "trim 0"] * 2


def test_threads_share_two_arenas_where_the_library_can(monkeypatch: pytest.MonkeyPatch) -> None:
    """M_ARENA_MAX is −8 in glibc; a library without the call is left alone."""
    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(ctypes, "CDLL", lambda name: SimpleNamespace(mallopt=lambda *words: asked.append(words)))
    memory.limit_arenas()
    assert asked == [(-8, 2)]
    monkeypatch.setattr(ctypes, "CDLL", lambda name: SimpleNamespace())
    memory.limit_arenas()
    memory.give_back()

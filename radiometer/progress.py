"""How the library states the progress of long work: one kind of function, passed in by whoever wants to show it."""

from __future__ import annotations

from collections.abc import Callable

# Gets what is done, how much of it is done, and how much there is (None where that is unknown).
Progress = Callable[[str, int, int | None], None]


def unseen(what: str, done: int, total: int | None) -> None:
    """Show nothing."""


def counted(progress: Progress | None, what: str) -> Callable[[int, int], None]:
    """Return what takes the counts of one step of the work and passes them on under its name."""
    return lambda done, total: (progress or unseen)(what, done, total)

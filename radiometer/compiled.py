"""The one decorator that compiles the merge's inner loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba

ResultT = TypeVar("ResultT")


def compiled(function: Callable[..., ResultT]) -> Callable[..., ResultT]:
    """Compile a loop that holds no lock, and keep the code on disk beside its module or in the user's cache.

    Where neither place can be written (a read-only installation without a home), it is compiled anew in each process.
    """
    options = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
    try:
        done: Callable[..., ResultT] = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # numba found no place for its cache
        done = numba.njit(**options)(function)
    return done

"""The decorators that compile the merge's inner loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core.compiler import Compiler

ResultT = TypeVar("ResultT")


def compiled(function: Callable[..., ResultT]) -> Callable[..., ResultT]:
    """Compile a loop that holds no lock, and keep the code on disk next to its module or in the user's cache.

    Where neither place can be written (a read-only installation without a home), it is compiled anew in each process.
    """
    return _compiled(function)


def compiled_apart(function: Callable[..., ResultT]) -> Callable[..., ResultT]:
    """Compile a loop as `compiled` does whose arrays share no memory, which the caller answers for.

    Values whose places depend on the pixel are then looked up many at a time. For arrays that might overlap, LLVM tests
    for overlap first. It knows no bounds of such places, and so falls back to pixel by pixel.
    """
    return _compiled(function, pipeline_class=_ApartCompiler)


def compiled_within(function: Callable[..., ResultT]) -> Callable[..., ResultT]:
    """Compile a function as `compiled` does, always as a part of the loops that call it: a call ends many at a time."""
    return _compiled(function, forceinline=True)


class _ApartCompiler(Compiler):  # type: ignore[misc]
    """numba's compiler with the promise that no argument array overlaps another."""

    def define_pipelines(self) -> Any:
        """Return numba's own steps."""
        self.state.flags.noalias = True
        return super().define_pipelines()


def _compiled(function: Callable[..., ResultT], **more: Any) -> Callable[..., ResultT]:
    options = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}, **more}
    try:
        done: Callable[..., ResultT] = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # numba found no place for its cache
        done = numba.njit(**options)(function)
    return done

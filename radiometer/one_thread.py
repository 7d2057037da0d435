"""Small matrices on one thread: where cores are shared, BLAS threads wait for each other far longer than they work."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")


def on_one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function so that BLAS uses one thread while it runs.

    The systems of response recovery have some 60 unknowns, those of `reconcile` some 100. With both cores busy, a
    response takes 0.2 s on one thread and 2 s on two. A session of 131 captures takes 11 s and 39 s of processor time.
    Most of that time is spent spinning.

    Args:
        function: What solves small systems.
    """

    @wraps(function)
    def held(*args: P.args, **kwargs: P.kwargs) -> R:
        with _controller().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return held


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()

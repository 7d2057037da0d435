"""Figures are held as one BLAS thread gives them: several add in another order, which a search may answer otherwise."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(autouse=True, scope="module")
def _one_blas_thread() -> Iterator[None]:
    """Hold BLAS to one thread, as `make test` does for the whole suite."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield

"""Comparisons of figures of any size: the absolute tolerance of 1e-12 that pytest adds hides watts and joules."""

from __future__ import annotations

from typing import Any

import pytest


def relatively(expected: Any, rel: float = 1e-6) -> Any:
    """Return what equals numbers within a relative tolerance, and within that alone."""
    return pytest.approx(expected, rel=rel, abs=0.0)

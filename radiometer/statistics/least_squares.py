"""Weighted linear least squares: solution, residual and chi-square."""

from __future__ import annotations

import numpy as np

from radiometer.typing import Array


def solve(design: Array, values: Array, weight: Array | None = None, *, rank: float | None = None) -> Array:
    """Return the least-squares coefficients of values over the columns of a design, shape (k,) or (k, m).

    Columns that depend on each other share their part (the solution of least norm).

    Args:
        design: Shape (n, k).
        values: Shape (n,) or (n, m).
        weight: Inverse variances up to a factor, shape (n,); None where all count alike.
        rank: Singular values below this share of the largest count as zero; None for rounding.
    """
    if weight is not None:
        root = np.sqrt(weight)
        design, values = design * root[:, np.newaxis], (values.T * root).T
    return np.asarray(np.linalg.lstsq(design, values, rcond=rank)[0], dtype=np.float64)


def residual(design: Array, values: Array, *, rank: float | None = None) -> Array:
    """Return what the columns of a design do not explain of values, same shape; all rows count alike.

    Args:
        design: Shape (n, k).
        values: Shape (n,) or (n, m).
        rank: As for `solve`.
    """
    return np.asarray(values - design @ solve(design, values, rank=rank))


def chi_square(design: Array, values: Array) -> float:
    """Return the sum of squared residuals of a fit; with rows in units of their standard deviations, its χ²."""
    rest = residual(design, values)
    return float(rest @ rest)

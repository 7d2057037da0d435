"""Describes an error that several figures share: a basis and its variance, and the weights that contain it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.typing import Array, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Change of one statistic by a shared error: amplitude · basis · z.

    Attributes:
        amplitude: (captures, entries) in the statistic's own scale; 0 where an entry does not count.
        basis: (entries, n) or (captures, entries, n).
    """

    amplitude: Array
    basis: Array

    @property
    def columns(self) -> Array:
        """Return what a unit of each z does, (captures, entries, n)."""
        return np.asarray(self.amplitude[:, :, None] * self.basis)


@dataclass(frozen=True, slots=True, eq=False)
class SharedError:
    """One source of error whose z are drawn anew in each capture.

    Attributes:
        name: What it is.
        parts: What it does, by statistic.
        variance: (captures,) variance of each z, or (captures, n).
        within: Whether the statistic's own standard uncertainty holds it already, so that it correlates entries only.
    """

    name: str
    parts: Mapping[str, Part]
    variance: Array
    within: bool = False

    def covariance(self, name: str) -> Array:
        """Return the covariance of a statistic's entries in each capture, (captures, entries, entries)."""
        part = self.parts[name]
        left = part.basis if self.variance.ndim == 1 else part.basis * self.variance[:, None, :]
        shape = left @ part.basis.swapaxes(-1, -2)
        each = self.variance[:, None, None] if self.variance.ndim == 1 else 1.0
        found = each * shape * (part.amplitude[:, :, None] * part.amplitude[:, None, :])
        if self.within:
            index = np.arange(found.shape[1])
            found[:, index, index] = 0.0
        return np.asarray(found)


def whiteners(
    errors: Sequence[SharedError], deviation: Mapping[str, Array], usable: Mapping[str, Mask]
) -> dict[str, Array]:
    """Return the inverse Cholesky factors of the captures' covariances, of every statistic that shares an error.

    Args:
        errors: The sources.
        deviation: Standard uncertainty of each entry by itself, by statistic.
        usable: Which entries count.
    """
    found = {}
    for name in dict.fromkeys(name for error in errors for name in error.parts):
        covariance = np.sum([error.covariance(name) for error in errors if name in error.parts], axis=0)
        index = np.arange(usable[name].shape[1])
        covariance[:, index, index] += np.where(usable[name], deviation[name] ** 2, 1.0)
        found[name] = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))
    return found

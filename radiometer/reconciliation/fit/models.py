"""Keeps every model that a search fits, so that their posterior probabilities can be compared in the end.

A model is a set of effects and curves with what it predicts of each held-out group: settings first, then the stated
values of nuisance parameters. Fitted states are large; of each only this is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect


@dataclass(frozen=True, slots=True, eq=False)
class ModelFit:
    """One fitted model."""

    effects: tuple[CatalogueEffect, ...]  # its effects at their fitted parameters
    curves: int  # number of columns of its curves without a name
    # (groups,) held-out log density of settings and stated values, determinants of the weights included
    log_density: Array
    parameters: int  # number of fitted parameters, columns of curves included
    gap: float = np.nan  # reduced χ² of held-out settings; NaN where the nuisances followed linearly
    # standard uncertainty of each fitted parameter by effect and name; empty where the gap is NaN
    u: dict[tuple[str, str], float] = field(default_factory=dict)

    @property
    def is_full(self) -> bool:
        """Return whether nuisances, weights and all effects were fitted together."""
        return bool(np.isfinite(self.gap))


@dataclass(slots=True, eq=False)
class ModelList:
    """The models fitted to one capture set, in the order of their fits."""

    fits: list[ModelFit] = field(default_factory=list)

    def add(self, fit: ModelFit) -> None:
        """Append a model."""
        self.fits.append(fit)

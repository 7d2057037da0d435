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
    """One fitted model.

    Attributes:
        effects: Its effects at their fitted parameters.
        curves: Number of columns of its curves without a name.
        log_density: (groups,) held-out log density of settings and stated values, determinants of the weights included.
        parameters: Number of fitted parameters, columns of curves included.
        gap: Reduced χ² of held-out settings; NaN where the nuisances followed linearly.
        u: Standard uncertainty of each fitted parameter by effect and name; empty where the gap is NaN.
    """

    effects: tuple[CatalogueEffect, ...]
    curves: int
    log_density: Array
    parameters: int
    gap: float = np.nan
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

"""An exposure whose label is not the real one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class ExposureLabelError(Scaling):
    """Takes another exposure time for frames that bear one label (or several): H' = H·t_real/t_label.

    Source: stacks of photographs whose printed times disagree with their neighbours.
    """

    name = "exposure_label_error"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    trials = ({"label_s": 1.0, "ratio": 1.1},)
    fitted = ("ratio",)
    repeats = True
    settles = "neighbouring exposures, or the EXIF record"
    label_s: float = parameter(1.0, "s", 1e-09, 100000.0, source="the printed exposure time")
    ratio: float = parameter(1.0, "1", 0.001, 1000.0, source="real over printed")

    further_s: tuple[float, ...] = parameter((), "s", 1e-09, 100000.0, source="further printed times that are wrong")
    further_ratios: tuple[float, ...] = parameter((), "1", 0.001, 1000.0, source="real over printed of these")

    def factor(self, context: ExposureContext) -> Any:
        """Return real over stated exposure time."""
        stated = np.asarray(context.settings.exposure_s)
        found: Any = 1.0
        for label, ratio in ((self.label_s, self.ratio), *zip(self.further_s, self.further_ratios, strict=True)):
            found = found * np.where(np.abs(np.log(stated / label)) < 1e-6, ratio, 1.0)
        return found

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: one ratio per label."""
        return ("ratio", *(f"further_ratios[{i}]" for i in range(len(self.further_ratios))))

    def joined(self, other: CatalogueEffect) -> CatalogueEffect:
        """Return the effect with the label of another one too."""
        assert isinstance(other, ExposureLabelError)
        return self.with_parameters(
            further_s=(*self.further_s, other.label_s, *other.further_s),
            further_ratios=(*self.further_ratios, other.ratio, *other.further_ratios),
        )

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return one start per exposure in use, a little long and a little short."""
        times = np.unique(np.asarray(context.settings.exposure_s))
        return tuple(cls(float(t), ratio) for t in times for ratio in (1.02, 0.98)) if times.size > 3 else ()

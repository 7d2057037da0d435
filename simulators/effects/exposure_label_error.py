"""An exposure whose label is not the real one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, Scaling, elapsed_s
from simulators.effects.context import ExposureContext

_ALWAYS_S: Final = 1e12  # beyond any time stamp
_FEW_EXPOSURES: Final = 3  # with up to three labels, one wrong one looks like a bent response


@dataclass(frozen=True)
class ExposureLabelError(Scaling):
    """Takes another exposure time for frames that bear one label (or several): H' = H·t_real/t_label.

    All frames of the label are meant, or only those taken between two times, where single captures were mislabelled.

    Source: stacks of photographs whose printed times disagree with their neighbours.
    """

    name = "exposure_label_error"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    log_prior_odds = -6.0
    prior_reason = "labels are seldom wrong, and one ratio per label explains whatever one setting shows"
    neutral_at_one = ("ratio",)
    trials = ({"label_s": 1.0, "ratio": 1.1},)
    fitted = ("ratio",)
    repeats = True
    settles = "neighbouring exposures, or the EXIF record"
    label_s: float = parameter(1.0, "s", 1e-09, 100000.0, source="the printed exposure time")
    ratio: float = parameter(1.0, "1", 0.001, 1000.0, source="real over printed")
    from_s: float = parameter(-_ALWAYS_S, "s", -_ALWAYS_S, _ALWAYS_S, source="time from which the label is wrong")
    to_s: float = parameter(_ALWAYS_S, "s", -_ALWAYS_S, _ALWAYS_S, source="time to which it is")
    further_s: tuple[float, ...] = parameter((), "s", 1e-09, 100000.0, source="further printed times that are wrong")
    further_ratios: tuple[float, ...] = parameter((), "1", 0.001, 1000.0, source="real over printed of these")
    further_from_s: tuple[float, ...] = parameter((), "s", -_ALWAYS_S, _ALWAYS_S, source="from when; empty for always")
    further_to_s: tuple[float, ...] = parameter((), "s", -_ALWAYS_S, _ALWAYS_S, source="to when; empty for always")

    def factor(self, context: ExposureContext) -> Any:
        stated, now = np.asarray(context.settings.exposure_s), np.asarray(elapsed_s(context))
        found: Any = 1.0
        for label, ratio, start, end in self._labels():
            meant = (np.abs(np.log(stated / label)) < 1e-6) & (start <= now) & (now <= end)
            found = found * np.where(meant, ratio, 1.0)
        return found

    def _labels(self) -> tuple[tuple[float, float, float, float], ...]:
        """Return label, ratio, and the times between which it holds, of all wrong labels."""
        always = (_ALWAYS_S,) * len(self.further_s)
        starts, ends = self.further_from_s or tuple(-t for t in always), self.further_to_s or always
        further = zip(self.further_s, self.further_ratios, starts, ends, strict=True)
        return ((self.label_s, self.ratio, self.from_s, self.to_s), *further)

    def free(self) -> tuple[str, ...]:
        return ("ratio", *(f"further_ratios[{i}]" for i in range(len(self.further_ratios))))

    def joined(self, other: CatalogueEffect) -> CatalogueEffect:
        """Return the effect with the label of another one too."""
        assert isinstance(other, ExposureLabelError)
        labels, ratios, starts, ends = zip(*self._labels()[1:], *other._labels(), strict=True)
        return self.with_parameters(further_s=labels, further_ratios=ratios, further_from_s=starts, further_to_s=ends)

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return one start per exposure in use, a little long and a little short, and per capture of several."""
        exposures, stamps = (np.ravel(np.asarray(v)) for v in (context.settings.exposure_s, elapsed_s(context)))
        times = np.unique(exposures)
        if times.size <= _FEW_EXPOSURES:
            return ()
        labels = [(float(t), -_ALWAYS_S, _ALWAYS_S) for t in times]
        if stamps.size == exposures.size and np.unique(stamps).size == stamps.size:
            order = np.sort(stamps)
            edges = np.concatenate([[-_ALWAYS_S], (order[1:] + order[:-1]) / 2.0, [_ALWAYS_S]])
            for stamp, exposure in zip(stamps.tolist(), exposures.tolist(), strict=True):
                if np.sum(exposures == exposure) > 1:
                    at = int(np.searchsorted(order, stamp))
                    labels.append((exposure, float(edges[at]), float(edges[at + 1])))
        return tuple(cls(t, ratio, start, end) for t, start, end in labels for ratio in (1.02, 0.98))

"""Wrong exposure labels in real stacks: planted ones that are found, and clean stacks that are accused."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks._photograph_sets import RealStack
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.samples import gather_samples
from radiometer.analysis.response.wrong_labels import WrongLabel, find_wrong_labels
from radiometer.data import Bracket
from radiometer.errors import RadiometerError

# A third of a stop and more, either way.
_PLANTED_STOPS = (1 / 3, -1 / 3, 1 / 2, -1 / 2, 2 / 3)
# Frames that hold fewer rows than this part of the median say too little to plant a lie in.
_LEAST_ROWS = 0.25
# Labels of this camera are wrong by themselves: its stacks are neither clean nor fit for planting.
_REALLY_WRONG = "CanonPowerShotG9"


@dataclass
class Labels:
    """Counts over the stacks seen so far."""

    clean: int = 0
    accused: list[str] = field(default_factory=list)
    planted: int = 0
    missed: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    really: list[str] = field(default_factory=list)

    def look_at(self, stack: RealStack) -> None:
        """Count a stack as it is and with one label made wrong; three frames cannot tell which label is."""
        if len(stack.bracket) < 4:
            return
        name = f"{stack.camera} {stack.name}"
        found = _found(stack.bracket)
        if stack.camera == _REALLY_WRONG:
            told = ", ".join(f"frame {one.frame} has {one.ratio:.3f} ± {one.u_ratio:.3f}" for one in found) or "none"
            self.really.append(f"{stack.name}: {told}")
            return
        self.clean += 1
        self.accused += [name] if found else []
        rng = np.random.default_rng(self.clean)
        rows = np.bincount(gather_samples(stack.bracket).frame, minlength=len(stack.bracket))
        which = int(rng.choice(np.flatnonzero(rows >= _LEAST_ROWS * np.median(rows))))
        factor = float(2.0 ** rng.choice(_PLANTED_STOPS))
        frames = list(stack.bracket)
        settings = replace(frames[which].settings, exposure_s=factor * frames[which].settings.exposure_s)
        frames[which] = replace(frames[which], settings=settings)
        bracket = Bracket.from_frames(frames, origin=stack.bracket.origin)
        place = [frame.dn is frames[which].dn for frame in bracket].index(True)
        found = _found(bracket)
        right = [one for one in found if one.frame == place]
        agrees = right and abs(right[0].ratio * factor - 1.0) <= max(3.0 * right[0].u_ratio * factor, 0.05)
        self.planted += 1
        self.missed += [] if agrees else [f"{name} (frame {place}, {np.log2(factor):+.2f} stops)"]
        self.others += [name] if len(found) > len(right) else []

    def told(self) -> str:
        """Return the counts in a sentence each."""
        found = self.planted - len(self.missed)
        return (
            f"**Wrong labels** (no stack of fewer than four frames). Clean stacks: {self.clean}, of which with a label "
            f"named wrongly: {len(self.accused)}{_names(self.accused)}. One label of each made wrong by a third of a "
            f"stop to two thirds: {found} of {self.planted} found (missed{_names(self.missed) or ': none'}); another "
            f"named beside or instead: {len(self.others)}{_names(self.others)}. The G9's last frame really has 0.833 "
            f"(i1) and 0.823 (i2, where the third is some 7 % short too): {'; '.join(self.really)}."
        )


def _found(bracket: Bracket) -> tuple[WrongLabel, ...]:
    try:
        samples = gather_samples(bracket)
        return find_wrong_labels(samples, curve_debevec1997(samples).log_exposure)
    except RadiometerError:
        return ()


def _names(several: list[str]) -> str:
    return f": {', '.join(several)}" if several else ""

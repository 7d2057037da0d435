"""Wrong exposure labels in real stacks: planted ones that are found, and clean stacks that are accused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks._photograph_sets import HIGHEST_DN, LOWEST_DN, RealStack
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import gather_samples
from radiometer.analysis.response.shutter_offset import ShutterOffset, find_exposures
from radiometer.analysis.response.wrong_labels import WrongLabel
from radiometer.data import Bracket, Frame
from radiometer.errors import RadiometerError

# A third of a stop and more, either way; so many lies in every scene, each by itself.
_PLANTED_STOPS = (1 / 3, -1 / 3, 1 / 2, -1 / 2, 2 / 3)
_LIES = 3
# Frames that hold fewer rows than this part of the median say too little to plant a lie in.
_LEAST_ROWS = 0.25
# Two or three frames and an unknown curve have no label that could be found wrong: a wrong one needs four frames
# that show something, this part of the pixels of one colour between 5 and 95 % of the scale.
_LEAST_SHOWN, _FEWEST_SHOWING = 0.01, 4
# Labels of this camera are wrong by themselves: its stacks are neither clean nor fit for planting.
_REALLY_WRONG = "CanonPowerShotG9"


@dataclass
class Labels:
    """Counts over the scenes seen so far.

    Attributes:
        draw: Which labels are made wrong: another number, others.
        ties: Scenes of which the right label was named among several, any of which it may be.
    """

    draw: int = 0
    clean: int = 0
    accused: list[str] = field(default_factory=list)
    scenes: int = 0
    scenes_accused: list[str] = field(default_factory=list)
    dark: list[str] = field(default_factory=list)
    planted: int = 0
    missed: list[str] = field(default_factory=list)
    ties: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    really: list[str] = field(default_factory=list)
    offsets: list[str] = field(default_factory=list)

    def look_at(self, colours: Sequence[RealStack]) -> None:
        """Count a scene as it is, each plane and all together, and with labels made wrong; four frames or more."""
        brackets = [bracket for colour in colours for bracket in _planes(colour)]
        if len(brackets[0].light) < 4:
            return
        name = f"{colours[0].camera} {colours[0].scene}".strip()
        known = [(bracket, plane) for bracket in brackets for plane in _sampled(bracket)]
        exposures = find_exposures([plane for _, plane in known])
        together = exposures.wrong
        self.offsets += [f"{name} {exposures.offset.in_words()}"] if exposures.offset else []
        if colours[0].camera == _REALLY_WRONG:
            labels_text = "; ".join(_in_words(one) for one in together) or "none"
            self.really.append(f"{name}: {labels_text}")
            return
        for number, (_, plane) in enumerate(known):
            self.clean += 1
            self.accused += [f"{name} plane {number}"] if find_exposures([plane]).wrong else []
        self.scenes += 1
        self.scenes_accused += [name] if together else []
        if _showing(brackets) < _FEWEST_SHOWING:
            self.dark += [name]
            return
        rng = np.random.default_rng(1000 * self.draw + self.scenes)
        frames = len(brackets[0].light)
        rows = np.sum([np.bincount(plane.samples.frame, minlength=frames) for _, plane in known], axis=0)
        for _ in range(_LIES):
            which = int(rng.choice(np.flatnonzero(rows >= _LEAST_ROWS * np.median(rows))))
            stops = float(rng.choice(_PLANTED_STOPS))
            self._plant([bracket for bracket, _ in known], which, stops, name, exposures.offset)

    def _plant(
        self, brackets: Sequence[Bracket], which: int, stops: float, name: str, clean: ShutterOffset | None
    ) -> None:
        # What the scene as it is says of its shutter is true of its exposures whatever a label says.
        seconds = brackets[0].light[which].settings.exposure_s
        true = 2.0**-stops * (1.0 + (clean.seconds / seconds if clean else 0.0))
        relabelled = [_relabelled(bracket, which, 2.0**stops) for bracket in brackets]
        stated_s = 2.0**stops * brackets[0].light[which].settings.exposure_s
        place = [frame.settings.exposure_s for frame in relabelled[0].light].index(stated_s)
        planes = [plane for bracket in relabelled for plane in _sampled(bracket)]
        exposures = find_exposures(planes)
        found = [exposures.of_printed(label, planes[0].samples.exposures_s) for label in exposures.wrong]
        right = [one for one in found if one.frame == place]
        tied = [one for one in found if not right and place in [frame for frame, _ in one.rivals]]
        off = abs(right[0].ratio / true - 1.0) if right else float("inf")
        self.planted += 1
        label_text = f"{name} frame {place}, {stops:+.2f} stops"
        if tied:
            self.ties.append(label_text)
        elif not right or off > max(3.0 * right[0].u_ratio / true, 0.05):
            self.missed.append(label_text)
        self.others += [name] if len(found) > len(right) + len(tied) else []

    def in_words(self) -> str:
        """Return the counts in a sentence each."""
        found = self.planted - len(self.missed) - len(self.ties)
        return (
            f"**Wrong labels** (no stack of fewer than four frames; the colours of a scene, or the four channels of "
            f"a mosaic, are judged together). Colour channels with right labels, judged one by one: {self.clean}, of "
            f"which with a label named wrongly: {len(self.accused)}{_names(self.accused)}; scenes with right labels: "
            f"{self.scenes}, {len(self.scenes_accused)}{_names(self.scenes_accused)}. {_LIES} times in every scene "
            f"of which four frames or more show anything (not: {', '.join(self.dark) or 'none'}) one label made wrong "
            f"by a third of a stop to two thirds: {found} of {self.planted} found "
            f"(missed{_names(self.missed) or ': none'}), {len(self.ties)} reported as one of several"
            f"{_names(self.ties)}; another named: {len(self.others)}"
            f"{_names(self.others)}. Scenes whose exposures are off their labels by one time, the shutter's offset "
            f"(the sizes of planted labels are compared with it, too): {'; '.join(self.offsets) or 'none'}. The "
            f"G9's last frame really has 0.833 (i1) and 0.823 (i2, where the third is some 7 % short too): "
            f"{'. '.join(self.really)}."
        )


def _in_words(label: WrongLabel) -> str:
    rivals = "".join(f", or frame {frame} {ratio:.3f}" for frame, ratio in label.rivals)
    return f"frame {label.frame} has {label.ratio:.3f} ± {label.u_ratio:.3f}{rivals}"


def _showing(brackets: Sequence[Bracket]) -> int:
    """Return how many frames show something in one of the colours."""
    shown = np.zeros(len(brackets[0].light), bool)
    for bracket in brackets:
        shown |= [np.mean((f.dn >= LOWEST_DN) & (f.dn <= HIGHEST_DN)) >= _LEAST_SHOWN for f in bracket.light]
    return int(shown.sum())


def _planes(stack: RealStack) -> list[Bracket]:
    """Return the stack, or the four planes of a mosaic."""
    if not stack.mosaic:
        return [stack.bracket]
    return [
        Bracket.from_frames(
            [
                Frame(np.ascontiguousarray(f.dn[row::2, column::2]), f.bit_depth, f.settings, extra=f.extra)
                for f in stack.bracket.light
            ],
            origin=stack.bracket.origin,
        )
        for row in (0, 1)
        for column in (0, 1)
    ]


def _sampled(bracket: Bracket) -> list[Plane]:
    try:
        samples = gather_samples(bracket)
        return [Plane(samples, curve_debevec1997(samples).log_exposure)]
    except RadiometerError:  # a plane that its filter leaves dark
        return []


def _relabelled(bracket: Bracket, which: int, factor: float) -> Bracket:
    frames = list(bracket.light)
    settings = replace(frames[which].settings, exposure_s=factor * frames[which].settings.exposure_s)
    frames[which] = replace(frames[which], settings=settings)
    return Bracket.from_frames(frames, origin=bracket.origin)


def _names(several: Sequence[str]) -> str:
    return f": {', '.join(several)}" if several else ""

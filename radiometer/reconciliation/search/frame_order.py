"""Finds disturbances that recur every so many frames, from the order of the frames alone.

Frames of one setting should show the same light, but for the noise of pixels and for what a source scatters from frame
to frame at random. The light of each frame, relative to the mean of its setting, is sorted by its running number
modulo every period. A camera or lamp that darkens each fifth frame shows there; a variance alone would look like
flicker.

Source: analysis of variance in one way, within settings; F test with Bonferroni's correction over the periods.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from radiometer.data import Frame
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import FrameReader
from radiometer.reconciliation.measure.scenes import FineStructure
from radiometer.reconciliation.measure.seen import CaptureStatistics
from radiometer.reconciliation.measure.sums import light_of_frames
from radiometer.reconciliation.thresholds import PERIOD_SIGNIFICANCE
from radiometer.statistics.least_squares import residual
from radiometer.typing import Array

_PERIODS: Final = range(2, 13)  # frames
_KNOWN_TO: Final = 0.01  # of a frame's light: darker frames tell nothing
_FEWEST: Final = 12  # frames
_RANK: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Periodic:
    """Light that comes back in the order of the frames."""

    period: int  # frames from one to the next
    depth: float  # largest against smallest mean light of the frames of one phase, relative
    rms: float  # standard deviation of the light over the phases, relative
    p_value: float  # chance of that much among all periods without it
    levels: tuple[float, ...] = ()  # light of the frames of each phase over that of the usual one


class FrameLight:
    """Hands frames on and keeps what each shows: the light of its tiles above black in DN, and of a scene its details.

    Attributes:
        structures: Fine structure of each frame with light, by its position; empty where the scene is known.
    """

    def __init__(self, design: Design, read: FrameReader) -> None:
        self._design, self._read = design, read
        black = np.nan_to_num(design.black_level_dn)
        self._black = {frame: black[n] for n, capture in enumerate(design.captures) for frame in capture.frames}
        self._light: dict[int, Array] = {}
        self.structures: dict[int, FineStructure] = {}

    def __call__(self, index: int) -> Frame:
        """Return a frame by its position in the header."""
        frame = self._read(index)
        if frame.shape == self._design.shape:
            means = [float(frame.dn[tile.slices].mean()) for tile in self._design.tiles]
            black_dn = self._black.get(index, 0.0)
            self._light[index] = np.array(means) - black_dn
            if not (self._design.uniform or self._design.header.frames[index].settings.is_dark):
                self.structures[index] = FineStructure.of(frame.dn, black_dn, frame.saturated_dn)
        return frame

    def of_tiles(self, frames: tuple[int, ...]) -> Array:
        """Return the mean of each tile above black in frames, (frames, tiles), in DN."""
        return np.stack([self._light[index] for index in frames])

    def of_capture(self, frames: tuple[int, ...], clear: NDArray[np.bool_]) -> Array:
        """Return the light of frames in those tiles that none of them clips, over its mean, less 1."""
        light = np.array([float(self._light[index][clear].sum()) for index in frames])
        return light / light.mean() - 1.0 if light.mean() > 0 else np.zeros(light.size)


def periodic(design: Design, light: FrameLight, unit: Array, clear: NDArray[np.bool_]) -> Periodic | None:
    """Return the period in which the light of frames comes back; None where chance explains what there is.

    Any dependence on a frame's place within its setting is removed first. A first frame that differs, or a drift
    within the repeats, has a separate statistic.

    Args:
        light: The light of each frame.
        unit: (captures,) relative variance of a frame's light by the noise of its pixels alone.
        clear: (captures, tiles) where no frame clips.
    """
    lit = ~design.closed & (design.source_level > 0) & (unit < _KNOWN_TO**2) & clear.any(axis=1)
    chosen = [n for n in np.flatnonzero(lit).tolist() if len(design.captures[n].frames) > 1]
    if sum(len(design.captures[n].frames) for n in chosen) < _FEWEST:
        return None
    apart = [light.of_capture(design.captures[n].frames, clear[n]) for n in chosen]
    more = max(float(np.median([np.var(a, ddof=1) - unit[n] for a, n in zip(apart, chosen, strict=True)])), 0.0)
    weight = [1.0 / (unit[n] + more) for n in chosen]
    found = [_rated([design.captures[n].frames for n in chosen], apart, weight, period) for period in _PERIODS]
    best = min((entry for entry in found if entry is not None), key=lambda entry: entry.p_value, default=None)
    if best is None or best.p_value * len(_PERIODS) > PERIOD_SIGNIFICANCE:
        return None
    return replace(best, p_value=min(best.p_value * len(_PERIODS), 1.0))


def steadied(design: Design, light: FrameLight, seen: CaptureStatistics, again: Periodic) -> CaptureStatistics:
    """Return the statistics as they would be if all frames of a capture had its mean light.

    A known dependence on the order of the frames would look like flicker and like a first frame that differs. Means
    stay as they are: the noise of the frames is that of the light that they had.
    """
    found = {name: getattr(seen, name).copy() for name in ("first", "common", "common_unit")}
    level = np.array(again.levels)
    for number, capture in enumerate(design.captures):
        if design.closed[number] or not design.source_level[number] > 0:
            continue
        black_dn = float(design.black_level_dn[number])
        own = level[np.array(capture.frames) % again.period][:, None]
        even = light.of_tiles(capture.frames) * own.mean() / own + (black_dn if np.isfinite(black_dn) else 0.0)
        there = {name: getattr(seen, name)[number] for name in ("mean", "variance", "pixels", "low", "high")}
        for name, value in light_of_frames(even, there, black_dn).items():
            found[name][number] = value
    return replace(seen, **found)


def _rated(frames: list[tuple[int, ...]], apart: list[Array], weight: list[float], period: int) -> Periodic | None:
    """Return the one-way analysis of variance by phase, settings' means and places within a setting taken out."""
    longest = max(len(numbers) for numbers in frames)
    phases, places, values = [], [], []
    for numbers, light, known in zip(frames, apart, weight, strict=True):
        phase = np.equal.outer(np.array(numbers) % period, np.arange(period)).astype(np.float64)
        place = np.eye(longest)[: len(numbers)]
        phases.append((phase - phase.mean(axis=0)) * np.sqrt(known))
        places.append((place - place.mean(axis=0)) * np.sqrt(known))
        values.append((light - light.mean()) * np.sqrt(known))
    of_place, of_phase = np.concatenate(places), np.concatenate(phases)
    columns, seen = residual(of_place, of_phase, rank=_RANK), residual(of_place, np.concatenate(values), rank=_RANK)
    left, size, right = np.linalg.svd(columns, full_matrices=False)
    kept = size > _RANK * np.linalg.norm(of_phase)  # a period that is that of the series leaves nothing
    rank, freedom = int(kept.sum()), seen.size - len(frames) - (longest - 1) - int(kept.sum())
    if not rank or freedom < 1:
        return None
    along = left[:, kept].T @ seen
    level = right[kept].T @ (along / size[kept])
    rest = max(float(seen @ seen - along @ along), 1e-300)
    f_ratio = float(along @ along) / rank / (rest / freedom)
    usual = tuple((1.0 + level - float(np.median(level))).tolist())
    return Periodic(period, float(np.ptp(level)), float(np.std(level)), float(fdtrc(rank, freedom, f_ratio)), usual)

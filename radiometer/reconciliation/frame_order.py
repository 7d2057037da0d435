"""Finds what frames show by their order and by their fine structure: light that recurs, and scenes that change.

Frames of one setting should show the same light, but for the noise of pixels and for what a source scatters from frame
to frame at random. The light of each frame, relative to the mean of its setting, is sorted by its running number
modulo every period. A camera or lamp that darkens each fifth frame shows there; a variance alone would look like
flicker.

Lens, sensor and source change a picture smoothly, along its rows or along its columns. The residual of its logarithm
is the scene's own fine structure, which exposure, gain and response leave in place. A changing scene is no effect of
the camera.

Source: analysis of variance in one way, within settings; F test with Bonferroni's correction over the periods.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from radiometer.data import Frame
from radiometer.reconciliation.design import CaptureStatistics, Design
from radiometer.reconciliation.reduce import FrameReader, light_of_frames
from radiometer.reconciliation.thresholds import FRAME_SIGNIFICANCE
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

    Any dependence on a frame's place within its capture is removed first, apart for captures that go on with the
    setting before. A first frame that differs, or a drift within the repeats, has a separate statistic.

    Args:
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
    frames, goes_on = [design.captures[n].frames for n in chosen], [design.goes_on(n) for n in chosen]
    found = [_rated(frames, goes_on, apart, weight, period) for period in _PERIODS]
    best = min((entry for entry in found if entry is not None), key=lambda entry: entry.p_value, default=None)
    if best is None or best.p_value * len(_PERIODS) > FRAME_SIGNIFICANCE:
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


def _rated(
    frames: list[tuple[int, ...]], goes_on: list[bool], apart: list[Array], weight: list[float], period: int
) -> Periodic | None:
    """Return the one-way analysis of variance by phase, captures' means and places within a capture taken out."""
    longest = max(len(numbers) for numbers in frames)
    phases, places, values = [], [], []
    for numbers, later, light, known in zip(frames, goes_on, apart, weight, strict=True):
        phase = np.equal.outer(np.array(numbers) % period, np.arange(period)).astype(np.float64)
        place = np.eye(2 * longest)[later * longest :][: len(numbers)]
        phases.append((phase - phase.mean(axis=0)) * np.sqrt(known))
        places.append((place - place.mean(axis=0)) * np.sqrt(known))
        values.append((light - light.mean()) * np.sqrt(known))
    of_place, of_phase = np.concatenate(places), np.concatenate(phases)
    columns, seen = residual(of_place, of_phase, rank=_RANK), residual(of_place, np.concatenate(values), rank=_RANK)
    left, size, right = np.linalg.svd(columns, full_matrices=False)
    kept = size > _RANK * np.linalg.norm(of_phase)  # a period that is that of the series leaves nothing
    rank = int(kept.sum())
    freedom = seen.size - len(frames) - int(np.linalg.matrix_rank(of_place)) - rank
    if not rank or freedom < 1:
        return None
    along = left[:, kept].T @ seen
    level = right[kept].T @ (along / size[kept])
    rest = max(float(seen @ seen - along @ along), 1e-300)
    f_ratio = float(along @ along) / rank / (rest / freedom)
    usual = tuple((1.0 + level - float(np.median(level))).tolist())
    return Periodic(period, float(np.ptp(level)), float(np.std(level)), float(fdtrc(rank, freedom, f_ratio)), usual)


# ---- scenes ---------------------------------------------------------------------------------------------------------
_MOST_BLOCKS: Final = 32  # along either side of a frame
_SMALLEST_BLOCK_PX: Final = 4
_SAMPLES: Final = 12  # pixels along a block's side that are looked at, every n-th of large frames
_FEWEST_BLOCKS: Final = 100  # that both frames show, beyond the smooth terms
_FAINTEST: Final = 10.0  # times the noise of a block's mean
_LEAST_CONTRAST: Final = 0.05  # standard deviation of the logarithm: even fields have a hundredth and less
_COMPARED: Final = 3  # latest frames of each scene: exposures far apart share few blocks that show either
_SAME: Final = 0.5  # least correlation of one scene's fine structure; that of different ones scatters about 0


@dataclass(frozen=True, slots=True)
class FineStructure:
    """Fine structure of a frame in blocks of pixels."""

    log_light: Array  # (rows, columns) logarithm of a block's mean above black; NaN where it is clipped or too dark
    noise2: Array  # (rows, columns) bound on its variance by the noise of the pixels

    @classmethod
    def of(cls, dn: NDArray[np.generic], black_dn: float, full_scale_dn: int) -> FineStructure:
        """Return what a frame shows.

        Args:
            black_dn: Black level; 0 where none is stated.
            full_scale_dn: Highest code: a block that holds it is clipped.
        """
        step = max(1, max(dn.shape) // (_MOST_BLOCKS * _SAMPLES))
        dn = dn[::step, ::step]
        side = max(_SMALLEST_BLOCK_PX, -(-max(dn.shape) // _MOST_BLOCKS))
        rows, columns = dn.shape[0] // side, dn.shape[1] // side
        blocks = dn[: rows * side, : columns * side].reshape(rows, side, columns, side)
        values = blocks.astype(np.float32)
        mean = np.asarray(values.mean(axis=(1, 3), dtype=np.float64))
        apart = values - mean.astype(np.float32)[:, None, :, None]
        scatter2 = np.asarray(np.square(apart).mean(axis=(1, 3), dtype=np.float64))
        light, noise = mean - black_dn, np.sqrt(scatter2) / side
        clear = (light > np.maximum(_FAINTEST * noise, 0.0)) & (blocks.max(axis=(1, 3)) < full_scale_dn)
        light = np.where(clear, light, np.nan)
        return cls(np.log(light), np.square(noise / light))

    def correlation(self, other: FineStructure) -> float | None:
        """Return the correlation of two frames' fine structure; None where either has too little structure."""
        known = np.isfinite(self.log_light) & np.isfinite(other.log_light)
        terms = _smooth_terms(known)
        if known.sum() - terms.shape[1] < _FEWEST_BLOCKS:
            return None
        both = np.column_stack([self.log_light[known], other.log_light[known]])
        rest = residual(terms, both)
        contrast2 = np.mean(np.square(rest), axis=0)
        noise2 = np.array([float(np.mean(noise2[known])) for noise2 in (self.noise2, other.noise2)])
        if (contrast2 < np.maximum(_LEAST_CONTRAST**2, _FAINTEST * noise2)).any():
            return None
        products = rest.T @ rest
        return float(products[0, 1] / np.sqrt(products[0, 0] * products[1, 1]))


def scenes_of(structures: Mapping[int, FineStructure]) -> dict[int, int]:
    """Return the number of the scene, from 0 on, that each frame of one pattern shows.

    A frame with too little structure counts as the scene of the frame before.

    Args:
        structures: Of each frame, by its position in the header.
    """
    found: dict[int, int] = {}
    latest: list[deque[FineStructure]] = []  # of each scene
    scene = 0
    for frame, own in sorted(structures.items()):
        likeness = [[r for other in members if (r := own.correlation(other)) is not None] for members in latest]
        recognised = {number: max(several) for number, several in enumerate(likeness) if several}
        if recognised:
            best = max(recognised, key=lambda number: recognised[number])
            scene = best if recognised[best] >= _SAME else len(latest)
        if scene == len(latest):
            latest.append(deque(maxlen=_COMPARED))
        latest[scene].append(own)
        found[frame] = scene
    return found


def _smooth_terms(known: NDArray[np.bool_]) -> Array:
    row, column = np.nonzero(known)
    y, x = (2.0 * at / max(size - 1, 1) - 1.0 for at, size in zip((row, column), known.shape, strict=True))
    surface = np.column_stack([x * y, x * x * y, x * y * y, x * x * y * y])
    return np.hstack([np.eye(known.shape[0])[row], np.eye(known.shape[1])[column], surface])

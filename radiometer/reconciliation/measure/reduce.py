"""Reduces frames to the statistics that are compared: one pass, three frames in memory at most."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import Frame
from radiometer.errors import CaptureError
from radiometer.reconciliation.measure.design import Design, patch_sides, tile_groups
from radiometer.reconciliation.measure.edges import edge_shares
from radiometer.reconciliation.measure.row_bands import RowBins
from radiometer.reconciliation.measure.seen import CaptureStatistics
from radiometer.reconciliation.measure.sums import CaptureSums, coarse_cells
from radiometer.typing import Array
from radiometer.units import gain_factor

_COARSE_CELLS: Final = 192  # longer side of the coarse picture; stray light is smooth on that scale


@dataclass(slots=True, eq=False)
class PatternImages:
    """Coarse mean pictures, in DN above black per unit of t·G·level/N²."""

    cell_px: int  # edge of a coarse cell in pixels
    total: Array  # sum of unclipped signals, shape (patterns, rows, columns)
    weight: Array  # sum of t·G·level/N² over the same samples
    scale: Array  # (captures,) t·G·level/N² of each capture
    pattern: Array  # (captures,) pattern of each capture
    black_dn: Array  # (captures,) black level of each capture

    @classmethod
    def empty(cls, design: Design) -> PatternImages:
        """Return pictures without any frame yet."""
        cell = max(1, -(-max(design.shape) // _COARSE_CELLS))
        shape = (len(design.patterns), design.shape[0] // cell, design.shape[1] // cell)
        gain = np.array([gain_factor(g) for g in design.gain_db])
        scale = design.exposure_s * gain * design.source_level / design.f_number**2
        black = np.nan_to_num(design.black_level_dn)
        return cls(cell, np.zeros(shape), np.zeros(shape), scale, design.pattern_index.astype(np.float64), black)

    def add(self, frame: Frame, capture: int) -> None:
        """Add a frame of a capture; frames without light are left out, clipped cells too."""
        scale = float(self.scale[capture])
        if scale <= 0:
            return
        coarse, clipped = _coarse(frame, self.cell_px, self.total.shape[1:])
        usable = ~clipped
        pattern = int(self.pattern[capture])
        self.total[pattern] += np.where(usable, coarse - self.black_dn[capture], 0.0)
        self.weight[pattern] += np.where(usable, scale, 0.0)

    def picture(self, pattern: int) -> Array:
        """Return the picture of a pattern, shape (rows, columns); cells never seen unclipped take the largest seen."""
        seen = self.weight[pattern] > 0
        values = np.divide(self.total[pattern], self.weight[pattern], where=seen, out=np.zeros(seen.shape))
        return np.asarray(np.where(seen, values, values.max(initial=0.0)))


def _coarse(frame: Frame, cell: int, shape: tuple[int, ...]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the mean of each coarse cell in DN, and whether one of its pixels is clipped."""
    mean, largest = coarse_cells(frame.dn, cell, *shape)
    return mean, largest >= frame.saturated_dn


_AHEAD: Final = 2  # frames that are read before they are needed

FrameReader = Callable[[int], Frame]
Progress = Callable[[int, int], None]


def reduce_frames(
    design: Design, read: FrameReader, progress: Progress | None = None
) -> tuple[CaptureStatistics, PatternImages]:
    """Return the statistics of all captures and the mean image of each pattern.

    Dark captures come first, so that their outlying pixels (defects) are left out everywhere.

    Args:
        read: Gives the frame at a position of the header.
        progress: Called with frames done and frames in all.

    Raises:
        CaptureError: If a frame's size differs from the design's.
    """
    groups, sides, bins = tile_groups(design), patch_sides(design), RowBins.of(design)
    images = PatternImages.empty(design)
    defects: NDArray[np.bool_] = np.zeros(design.shape, dtype=np.bool_)
    collected: dict[int, dict[str, NDArray[np.float64] | float]] = {}
    done = 0
    darkest = np.nan  # stands for a black level that is not stated
    order = _darks_first(design)
    frames = _read_ahead(design, [index for number in order for index in design.captures[number].frames], read)
    for number in order:
        count = len(design.captures[number].frames)
        sums = CaptureSums.start(groups, sides, len(design.tiles), defects)
        apart = not design.uniform and count > 2
        first = CaptureSums.start(groups, sides, len(design.tiles), defects)
        for position, frame in enumerate(itertools.islice(frames, count)):
            sums.add(frame)
            images.add(frame, number)
            if apart and position == 0:
                first.add(frame)
            done += 1
            if progress is not None:
                progress(done, len(design.header.frames))
        structured = not design.uniform and design.source_level[number] > 0
        stated = float(design.black_level_dn[number])
        black_dn = stated if np.isfinite(stated) or design.closed[number] else darkest
        collected[number], outlying = sums.finish(black_dn, bins, structured=structured)
        if apart:
            later, _ = sums.without(first).finish(black_dn, bins, structured=structured)
            collected[number] |= _later_noise(later, count, structured=structured)
        if design.closed[number]:
            defects = defects | outlying
            darkest = float(np.fmin(darkest, np.median(np.asarray(collected[number]["mean"]))))
    names = [entry.name for entry in fields(CaptureStatistics)]
    rows = [collected[number] for number in range(len(design.captures))]
    lines, uneven = (np.array([row[name] for row in rows]) for name in ("side_lines", "side_unevenness"))
    gathered = {name: np.array([row[name] for row in rows]) for name in names if name not in ("edge", "edge_u")}
    gathered["edge"], gathered["edge_u"] = edge_shares(
        sides,
        lines,
        uneven,
        gathered["mean"],
        gathered["spatial"],
        gathered["high"],
        design.pattern_index,
        design.f_number,
    )
    return CaptureStatistics(**gathered), images


_NOISE: Final = (
    "variance",
    "variance_dof",
    "neighbour_x",
    "neighbour_y",
    "row_temporal",
    "row_temporal_weight",
    "row_temporal_dof",
    "row_temporal_light",
)


def _later_noise(
    later: Mapping[str, NDArray[np.float64] | float], frames: int, *, structured: bool
) -> dict[str, NDArray[np.float64] | float]:
    """Return the noise of a scene's frames after the first, by name: a picture left behind in that is no noise.

    The spatial variance of darks is brought to what the mean of all frames would have; mostly noise, it scatters more.

    Args:
        later: Statistics of the frames after the first.
        frames: Number of all frames.
        structured: Whether the scene is seen.
    """
    noise: dict[str, NDArray[np.float64] | float] = {name: later[name] for name in _NOISE}
    if not structured:
        white = np.asarray(later["variance"]) * (1.0 / (frames - 1) - 1.0 / frames)
        noise["spatial"] = np.asarray(later["spatial"]) - white
        noise["spatial_dof"] = np.asarray(later["spatial_dof"]) * ((frames - 1) / frames) ** 2
    return noise


def frame_reader(frames: Sequence[Frame]) -> FrameReader:
    """Return a reader of frames that are in memory already."""
    return frames.__getitem__


def _darks_first(design: Design) -> list[int]:
    """Return the captures' numbers, darks first and the longest of them foremost: it shows the most defects."""
    return sorted(
        range(len(design.captures)), key=lambda n: (not design.closed[n], -design.exposure_s[n] * design.closed[n], n)
    )


def _read_ahead(design: Design, indices: Sequence[int], read: FrameReader) -> Iterator[Frame]:
    """Yield frames in the order given; a second thread reads the next ones meanwhile."""
    with ThreadPoolExecutor(max_workers=1) as reader:
        waiting = deque(reader.submit(read, index) for index in indices[:_AHEAD])
        for position, index in enumerate(indices):
            frame = waiting.popleft().result()
            waiting.extend(reader.submit(read, later) for later in indices[position + _AHEAD : position + _AHEAD + 1])
            if frame.shape != design.shape:
                raise CaptureError(
                    f"frame {index} is {frame.shape[1]} × {frame.shape[0]} pixels, the first one {design.shape[1]} × "
                    f"{design.shape[0]}; all frames of a capture set need one size"
                )
            yield frame

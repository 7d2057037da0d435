"""Reduces frames to the statistics that are compared: one pass, three frames in memory at most."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import Frame
from radiometer.errors import CaptureError
from radiometer.reconciliation.measure.design import Design, patch_sides, tile_groups
from radiometer.reconciliation.measure.edges import edge_shares
from radiometer.reconciliation.measure.pattern_images import PatternImages
from radiometer.reconciliation.measure.row_bands import RowBins
from radiometer.reconciliation.measure.seen import CaptureStatistics
from radiometer.reconciliation.measure.sums import CaptureSums

_AHEAD: Final = 2  # frames that are read before they are wanted

FrameReader = Callable[[int], Frame]
Progress = Callable[[int], None]


def reduce_frames(
    design: Design, read: FrameReader, progress: Progress | None = None
) -> tuple[CaptureStatistics, PatternImages]:
    """Return the statistics of all captures and the mean image of each pattern.

    Dark captures come first, so that their outlying pixels (defects) are left out everywhere.

    Args:
        design: Captures and tiles.
        read: Gives the frame at a position of the header.
        progress: Called with the number of frames done.

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
                progress(done)
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

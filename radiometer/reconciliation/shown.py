"""Reads the frames of a capture set: what they show, and a second time where that changes how they are to be read."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np

from radiometer.data import CaptureHeader
from radiometer.errors import CaptureError
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import FrameReader, PatternImages, Progress, reduce_frames
from radiometer.reconciliation.measure.scenes import scenes_of
from radiometer.reconciliation.measure.seen import CaptureStatistics
from radiometer.reconciliation.noise.darkness import black_by_noise
from radiometer.reconciliation.search.frame_order import FrameLight
from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array

_STANDS_OUT: Final = 8.0  # times what neighbouring frames differ by otherwise
_STAYS: Final = 4.0  # the same of the frames behind the jump: a lone frame that differs is no jump
_BESIDE: Final = 3  # frames on either side that tell whether it stays
_MOST_JUMPS: Final = 8  # of one series, the largest first


def jumps(design: Design, tiles_of: Callable[[tuple[int, ...]], Array]) -> tuple[int, ...]:
    """Return the positions in the header of the frames that are the first behind a jump.

    Args:
        design: Captures; those that follow each other in one setting are a series.
        tiles_of: Gives the mean of each tile in frames at positions of the header, (frames, tiles) in DN.
    """
    return tuple(sorted(frame for frames in _series(design) for frame in _of_series(frames, tiles_of(frames))))


def _series(design: Design) -> Iterator[tuple[int, ...]]:
    """Yield the frames of captures of one setting that follow each other, where there are several."""
    numbers = range(len(design.captures))
    for _, same in itertools.groupby(numbers, key=lambda number: design.setting_id[number]):
        captures = [design.captures[number].frames for number in same]
        frames = tuple(itertools.chain.from_iterable(captures))
        if len(captures) > 1 and frames == tuple(range(frames[0], frames[0] + len(frames))):
            yield frames


def _of_series(frames: tuple[int, ...], means: Array) -> list[int]:
    level = np.median(means - means.mean(axis=0), axis=1)
    steps = np.diff(level)
    usual = robust_sigma(steps)
    found = []
    for at in np.argsort(-np.abs(steps), kind="stable")[:_MOST_JUMPS].tolist():
        behind, before = level[at + 1 : at + 1 + _BESIDE], level[max(at + 1 - _BESIDE, 0) : at + 1]
        stays = abs(float(np.median(behind) - np.median(before)))
        if abs(float(steps[at])) > _STANDS_OUT * usual and stays > _STAYS * usual:
            found.append(frames[at + 1])
    return found


Shown = tuple[Design, FrameLight, tuple[CaptureStatistics, PatternImages]]


def evidence_for(
    header: CaptureHeader, shape: tuple[int, int], read: FrameReader, progress: Progress | None = None
) -> Shown:
    """Return the design of a capture set, the light of its frames, and what they show.

    A series of equal frames may jump, one setting alone may not determine an undeclared black level, or the scene may
    change. The design then follows what was seen, and the frames are read again. Each scene is a separate pattern
    then.

    Args:
        shape: Height and width of the frames.
        read: Gives the frame at a position of the header.
        progress: Called with the number of frames done.

    Raises:
        CaptureError: If a scene is shown by one frame alone, which cannot be compared with any other.
    """
    design, light, shown = _read_by(Design.of(header, shape), read, progress)
    at, black_dn = jumps(design, light.of_tiles), black_by_noise(design, shown[0])
    apart = _by_scene(header, light)
    if not at and black_dn is None and apart is None:
        return design, light, shown
    header = apart or header
    if black_dn is not None:
        camera = header.camera.model_copy(update={"black_level_dn": black_dn})
        header = header.model_copy(update={"camera": camera})
    return _read_by(Design.of(header, shape, at), read, progress)


def _by_scene(header: CaptureHeader, light: FrameLight) -> CaptureHeader | None:
    """Return the header with a pattern for each scene; None where every pattern shows one."""
    names: dict[int, str] = {}
    for pattern in dict.fromkeys(header.frames[index].pattern for index in light.structures):
        own = {index: seen for index, seen in light.structures.items() if header.frames[index].pattern == pattern}
        scenes = scenes_of(own)
        if max(scenes.values()):
            _refuse_lone_frames(header, scenes)
        names |= {index: f"{pattern}, scene {scene + 1}" for index, scene in scenes.items() if scene}
    if not names:
        return None
    frames = [
        frame.model_copy(update={"pattern": names.get(index, frame.pattern)})
        for index, frame in enumerate(header.frames)
    ]
    patterns = tuple(dict.fromkeys((*header.patterns, *names.values())))
    return header.model_copy(update={"frames": tuple(frames), "patterns": patterns})


def _refuse_lone_frames(header: CaptureHeader, scenes: Mapping[int, int]) -> None:
    times = Counter(scenes.values())
    lone = [header.frames[index].file for index, scene in scenes.items() if times[scene] == 1]
    if lone:
        raise CaptureError(
            f"the frames show {len(times)} scenes, and no other frame shows that of {', nor that of '.join(lone)}: "
            "it cannot be compared with any; give two frames or more of each scene, or those of one scene only"
        )


def _read_by(design: Design, read: FrameReader, progress: Progress | None) -> Shown:
    light = FrameLight(design, read)
    return design, light, reduce_frames(design, light, progress)

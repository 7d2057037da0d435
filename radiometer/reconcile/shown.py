"""Reads the frames of a capture set: what they show, and a second time where that changes how they are to be read."""

from __future__ import annotations

from radiometer.data import CaptureHeader
from radiometer.reconcile.measure.design import Design
from radiometer.reconcile.measure.pattern_images import PatternImages
from radiometer.reconcile.measure.reduce import FrameReader, Progress, reduce_frames
from radiometer.reconcile.measure.seen import CaptureStatistics
from radiometer.reconcile.measure.series import jumps
from radiometer.reconcile.noise.darkness import black_by_noise
from radiometer.reconcile.search.frame_order import FrameLight

Shown = tuple[Design, FrameLight, tuple[CaptureStatistics, PatternImages]]


def shown_by(
    header: CaptureHeader, shape: tuple[int, int], read: FrameReader, progress: Progress | None = None
) -> Shown:
    """Return the design of a capture set, the light of its frames, and what they show.

    Where a series of equal frames jumps, or one setting alone cannot tell a black level that nobody states, the design
    follows what was seen, and the frames are read again.

    Args:
        header: What `capture.yaml` says.
        shape: Height and width of the frames.
        read: Gives the frame at a position of the header.
        progress: Called with the number of frames done.
    """
    design, light, shown = _read_by(Design.of(header, shape), read, progress)
    at, black_dn = jumps(design, light.of_tiles), black_by_noise(design, shown[0])
    if not at and black_dn is None:
        return design, light, shown
    if black_dn is not None:
        camera = header.camera.model_copy(update={"black_level_dn": black_dn})
        header = header.model_copy(update={"camera": camera})
    return _read_by(Design.of(header, shape, at), read, progress)


def _read_by(design: Design, read: FrameReader, progress: Progress | None) -> Shown:
    light = FrameLight(design, read)
    return design, light, reduce_frames(design, light, progress)

"""Frames in memory as `reconcile` begins with them: reduced to statistics, and the declared camera fitted to these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from radiometer.data import CameraDescription, CaptureHeader, Frame, FrameEntry
from radiometer.reconciliation.descent import first_state
from radiometer.reconciliation.design import CaptureStatistics, Design
from radiometer.reconciliation.reduce import reduce_frames
from radiometer.reconciliation.state import FitState


class Captured(Protocol):
    """Frames with what is declared of them."""

    @property
    def header(self) -> CaptureHeader:
        """What is declared of camera and frames."""

    @property
    def frames(self) -> Sequence[Frame]:
        """The frames in the order of the header."""


@dataclass(frozen=True)
class Taken:
    """Frames of a camera of which little else is declared."""

    header: CaptureHeader
    frames: Sequence[Frame]


def taken(frames: Sequence[Frame], **camera: Any) -> Taken:
    """Return frames of 12 bits with their settings and these figures of the camera declared."""
    entries = tuple(FrameEntry.of(f"{number}.png", frame.settings) for number, frame in enumerate(frames))
    return Taken(CaptureHeader(camera=CameraDescription(bit_depth=12, **camera), frames=entries), frames)


def statistics_of(captured: Captured) -> CaptureStatistics:
    """Return the statistics that frames are reduced to."""
    design = Design.of(captured.header, captured.frames[0].shape)
    return reduce_frames(design, captured.frames.__getitem__)[0]


def start_of(captured: Captured) -> FitState:
    """Return the fit that a search starts from: the camera as declared, without any effect."""
    design = Design.of(captured.header, captured.frames[0].shape)
    return first_state(design, *reduce_frames(design, captured.frames.__getitem__))

"""The figures of each output amplifier (tap) of a sensor, and borders between taps that its frames show."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from radiometer.analysis.characterise.characterise import characterise
from radiometer.analysis.characterise.group_statistics import GroupStatistics
from radiometer.analysis.characterise.result import Characterisation
from radiometer.analysis.characterise.subject import FrameGroup, Subject, subject_of_capture
from radiometer.analysis.signal.borders import borders_of_grid
from radiometer.data import CameraDescription, CaptureSet, Patch, Quantity, TapDescription
from radiometer.errors import MeasurementError, UsageError
from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array

FIND: Final = "find"
_FRAMES_LOOKED_AT: Final = 8  # a mean of them has a third of one frame's noise
_UNLIT: Final = 0.1  # of the frame's light, below which columns are overscan
_BRIGHT_SHARE: Final = 0.5  # of the brightest signal: light, and no clipping
_EVEN: Final = 2.0  # times the temporal noise: fixed patterns of the same size are even, a scene is not
_BRIGHTER: Final = 10.0  # times the noise by which an aggressor's pixels differ, for cross-talk to be determined


@dataclass(frozen=True, slots=True)
class Crosstalk:
    """What one tap reads of another's signal at the same time."""

    of: str  # name of the tap whose signal it is
    into: str  # name of the tap that reads it
    share: Quantity  # share of the signal, with its standard uncertainty


@dataclass(frozen=True, slots=True)
class TapFigures:
    """One tap: where it is, and the figures of its pixels."""

    tap: TapDescription  # its name and rectangles
    characterisation: Characterisation | None  # EMVA 1288 figures of its pixels; None where these determine none
    overscan: Quantity | None = None  # mean of its overscan in DN; None where it has none
    why_not: str = ""  # why it has no figures; empty where it has


def taps_as_stated(how: str | None, subject: Subject, shape: tuple[int, int]) -> tuple[TapDescription, ...]:
    """Return the taps that a camera description or a user states.

    Args:
        how: "2x2" for columns × rows of equal taps, "find" for borders that the frames show, None for what the camera
            description states.
        shape: (height, width) of the frames.

    Raises:
        UsageError: If the text is neither, or the frame cannot be parted so.
        MeasurementError: If borders are to be found and the frames show none.
    """
    if how is None:
        return subject.camera.taps or ()
    if how == FIND:
        found = find_taps(subject)
        if len(found) < 2:
            raise MeasurementError(
                "the frames show no border between taps: their gains, black levels and noise agree within the noise; "
                "state them by --taps COLUMNSxROWS"
            )
        return found
    parted = re.fullmatch(r"(\d{1,2})x(\d{1,2})", how)
    if parted is None:
        raise UsageError(f"--taps {how}: give COLUMNSxROWS of equal taps, such as 2x2, or find")
    columns, rows = int(parted[1]), int(parted[2])
    height, width = shape
    if not columns or not rows or width % columns or height % rows:
        raise UsageError(f"--taps {how}: a frame of {width} × {height} pixels has no such equal parts")
    return _grid(list(range(0, width + 1, width // columns)), list(range(0, height + 1, height // rows)))


def _grid(x_edges: Sequence[int], y_edges: Sequence[int]) -> tuple[TapDescription, ...]:
    cells = [(x, y, r - x, b - y) for y, b in pairwise(y_edges) for x, r in pairwise(x_edges)]
    return tuple(TapDescription(name=str(n), x=x, y=y, width=w, height=h) for n, (x, y, w, h) in enumerate(cells, 1))


def characterise_taps(subject: Subject, taps: Sequence[TapDescription]) -> tuple[TapFigures, ...]:
    """Return the figures of each tap's pixels.

    Args:
        subject: The frames; its photon fluxes are not used.

    Raises:
        MeasurementError: If a rectangle is not on the frames.
        CaptureError: If a frame is unreadable.
    """
    overscans = [Patch(*rectangle) for tap in taps for rectangle in tap.overscan]
    regions = (*(tap.patch for tap in taps), *overscans)
    wide = replace(subject, regions=regions, fluxes=(None,) * len(regions))
    statistics = wide.statistics()
    found, at = [], len(taps)
    for number, tap in enumerate(taps):
        own = replace(subject, regions=(tap.patch,), fluxes=(None,), notes=())
        mine = [replace(one, region=0) for one in statistics if one.region == number]
        blacks = [one for one in statistics if at <= one.region < at + len(tap.overscan)]
        at += len(tap.overscan)
        try:
            figures = characterise(own, mine)
            found.append(TapFigures(_with_gain(tap, figures), figures, _mean(blacks)))
        except MeasurementError as error:
            found.append(TapFigures(tap, None, _mean(blacks), str(error)))
    return tuple(found)


def _with_gain(tap: TapDescription, found: Characterisation) -> TapDescription:
    """Return a tap with its gain, which merge and readings use."""
    gain = found.figures.get("K")
    if gain is None:
        return tap
    return tap.model_copy(update={"conversion_gain_e_per_dn": 1.0 / gain.value, "conversion_gain_u_rel": gain.u_rel})


def camera_with_taps(capture: CaptureSet, how: str | None) -> CameraDescription:
    """Return the camera of a capture set with the taps that a user states.

    Args:
        how: As for `taps_as_stated`.

    Raises:
        UsageError: If the frames have a mosaic of colours, or cannot be parted so.
        MeasurementError: If borders are to be found and the frames show none.
    """
    camera = capture.header.camera
    if how is None:
        return camera
    if camera.mosaic is not None:
        raise UsageError("--taps: frames of a mosaic of colours are read without taps; leave the option out")
    taps = taps_as_stated(how, subject_of_capture(capture), capture.read_frame(0).shape)
    return camera.model_copy(update={"taps": taps})


def _mean(groups: Sequence[GroupStatistics]) -> Quantity | None:
    """Return the mean of all frames' overscan; its spread between settings is part of u."""
    if not groups:
        return None
    means = np.array([one.mean_dn for one in groups])
    spread = float(np.std(means, ddof=1)) / math.sqrt(len(means)) if len(means) > 1 else 0.0
    noise = math.sqrt(sum(one.u_mean_dn**2 for one in groups)) / len(groups)
    return Quantity(float(means.mean()), max(spread, noise), "DN")


def differing(taps: Sequence[TapFigures], symbol: str) -> str:
    """Return how far a figure differs between taps, as a sentence; empty where it agrees within k = 2."""
    figures = [one.characterisation.figures[symbol] for one in taps
               if one.characterisation is not None and symbol in one.characterisation.figures]  # fmt: skip
    if len(figures) < 2:
        return ""
    low, high = min(figures, key=lambda q: q.value), max(figures, key=lambda q: q.value)
    if high.value - low.value <= 2.0 * math.hypot(low.u, high.u):
        return ""
    return (
        f"{symbol} differs between taps, from {low.value:.4g} to {high.value:.4g} {low.unit}: "
        "one figure of the whole frame describes no tap"
    )


def find_taps(subject: Subject) -> tuple[TapDescription, ...]:
    """Return the taps whose borders the frames show: steps of light, dark signal or dark noise along whole lines.

    Columns and rows that light does not reach are the overscan of the tap next to them. A border is looked for along
    eight strips; a line is drawn through the pixels on each side, so that shading makes no step.

    Raises:
        MeasurementError: If there are no frames with light.
        CaptureError: If a frame is unreadable.
    """
    pictures, variance = _pictures(subject)
    height, width = pictures[0].shape
    columns, rows = borders_of_grid(pictures, variance)
    cells = _grid([0, *columns, width], [0, *rows, height])
    level = float(np.median(pictures[0]))
    lit = [float(np.median(pictures[0][cell.patch.slices])) > _UNLIT * level for cell in cells]
    taps = list[TapDescription]()
    for cell, is_lit in zip(cells, lit, strict=True):
        if is_lit:
            unlit = (other for other, has_light in zip(cells, lit, strict=True) if not has_light)
            overscan = tuple((o.x, o.y, o.width, o.height) for o in unlit if _is_adjacent(cell, o))
            taps.append(cell.model_copy(update={"name": str(len(taps) + 1), "overscan": overscan}))
    return tuple(taps)


def _is_adjacent(one: TapDescription, other: TapDescription) -> bool:
    across = one.y == other.y and (other.x == one.x + one.width or other.x + other.width == one.x)
    along = one.x == other.x and (other.y == one.y + one.height or other.y + other.height == one.y)
    return across or along


def _pictures(subject: Subject) -> tuple[list[Array], Array | None]:
    """Return light less dark and dark, each a mean, of each pixel; and its dark variance where there are two frames."""
    top = subject.camera.saturated_dn
    bright = [group for group in subject.groups if not group.settings.is_dark]
    dark = [group for group in subject.groups if group.settings.is_dark]
    means = [(group, mean) for group in bright if float(np.median(mean := _moments(group, top)[0])) < top]
    if not means:
        raise MeasurementError("borders between taps need frames of even light that are not clipped")
    black = _moments(min(dark, key=lambda g: g.settings.exposure_s), top) if dark else (np.zeros(()), None)
    signals = [mean - black[0] for _, mean in means]
    highest = max(float(np.median(signal)) for signal in signals)
    light = min(signals, key=lambda signal: abs(float(np.median(signal)) - _BRIGHT_SHARE * highest))
    pictures = [light]
    if dark:
        pictures.append(black[0])
    return pictures, black[1]


def _moments(group: FrameGroup, top: int) -> tuple[Array, Array | None]:
    frames = [dn.astype(np.float64) for dn, _ in zip(group.read(top), range(_FRAMES_LOOKED_AT), strict=False)]
    stack = np.stack(frames)
    return stack.mean(axis=0), stack.var(axis=0, ddof=1) if len(frames) > 1 else None


def crosstalk(subject: Subject, taps: Sequence[TapDescription]) -> tuple[Crosstalk, ...]:
    """Return the share of each tap's signal that another reads, where a frame determines it.

    A tap whose pixels are even but for their noise shares no structure of the scene with another. What it repeats of
    the other's structure, pixel by pixel in the order of the read-out, is cross-talk. Where the first pixel is not
    stated, each tap begins at the corner of the frame that is nearest to it.

    Raises:
        CaptureError: If a frame is unreadable.
    """
    best: dict[tuple[str, str], Quantity] = {}
    top = subject.camera.saturated_dn
    for group in subject.groups if len({(tap.width, tap.height) for tap in taps}) == 1 else ():
        if group.settings.is_dark or len(group.files) < 2:
            continue
        mean, variance = _moments(group, top)
        if variance is None:
            continue
        shape = mean.shape
        noise_dn = math.sqrt(float(np.median(variance)) / min(len(group.files), _FRAMES_LOOKED_AT))
        read = {tap.name: _in_order(mean, tap, shape) for tap in taps}
        even = {name for name, picture in read.items() if robust_sigma(picture) < _EVEN * noise_dn}
        for of, into in ((a, b) for a in read for b in even if a != b):
            source = read[of] - float(np.median(read[of]))
            if float(np.max(np.abs(source))) < _BRIGHTER * noise_dn or float(read[of].max()) >= top:
                continue
            received = read[into] - float(np.median(read[into]))
            scale = float(np.sum(source**2))
            share = Quantity(float(np.sum(source * received)) / scale, robust_sigma(received) / math.sqrt(scale), "1")
            if (of, into) not in best or share.u < best[of, into].u:
                best[of, into] = share
    return tuple(Crosstalk(of, into, share) for (of, into), share in best.items())


def _in_order(picture: Array, tap: TapDescription, shape: tuple[int, ...]) -> Array:
    """Return a tap's pixels with the one that is read first at (0, 0)."""
    corner = tap.first_pixel
    is_right = "right" in corner if corner else tap.x + tap.width / 2 > shape[1] / 2
    is_lower = "lower" in corner if corner else tap.y + tap.height / 2 > shape[0] / 2
    return picture[tap.patch.slices][:: -1 if is_lower else 1, :: -1 if is_right else 1]

"""Check exposure labels against brightness: a frame whose time contradicts its picture is named."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiometer.data.frame import Bracket
from radiometer.errors import CaptureError

# Less than this part of full scale is drift, fog or noise, not a wrong label.
_TOLERATED_DROP = 0.004
_COMPARED_PIXELS = 60_000
_LEAST_COMMON_PIXELS = 50
# Pixels between these parts of full scale show any change of the exposure; this part of the picture must be such.
_MIDDLE, _LEAST_MIDDLE_PART = (0.1, 0.9), 0.02
# Labels that differ by less are within what shutters scatter.
_LEAST_LABEL_RATIO = 1.25


def reject_inconsistent_exposures(bracket: Bracket) -> None:
    """Refuse a bracket in which a longer exposure gave a darker picture, or the same.

    Args:
        bracket: Frames sorted by their stated exposure.

    Raises:
        CaptureError: If brightness does not rise with the stated exposure; names the frames whose label is wrong.
    """
    if np.ptp(bracket.effective_exposures_s) == 0.0:
        return  # one exposure says nothing of its label
    _refuse_alike(bracket, _alike(bracket)[1])
    rise = _pairwise_rise(bracket)
    consistent = _longest_rise(rise)
    inconsistent = [index for index in range(len(bracket.light)) if index not in consistent]
    if not inconsistent:
        return
    where = bracket.origin or "bracket"
    _refuse_falling(where, len(consistent), len(bracket.light))
    named = "; ".join(_contradiction(bracket, index, rise, consistent) for index in inconsistent[:3])
    raise CaptureError(
        f"{where}: brightness does not rise with the stated exposure: {named}; "
        "correct that exposure time or leave the frame out"
    )


def refuse_falling_brightness(bracket: Bracket) -> None:
    """Refuse a bracket, sorted by stated exposure, whose pictures get darker throughout as it grows.

    Raises:
        CaptureError: If hardly any frame is brighter than one of a shorter stated exposure.
    """
    _refuse_falling(bracket.origin or "bracket", len(_longest_rise(_pairwise_rise(bracket))), len(bracket.light))


def _refuse_falling(where: str, rising: int, count: int) -> None:
    if rising <= max(1, count // 3) < count:
        raise CaptureError(
            f"{where}: the pictures get darker as the stated exposure grows; the times are wrong throughout "
            "(a list of 1/t instead of t looks like this)"
        )


def refuse_equal_throughout(bracket: Bracket) -> None:
    """Refuse a bracket of equal pictures under different labels: none of them shows which label is wrong.

    Raises:
        CaptureError: If no frame is brighter than the one before it; names them.
    """
    apart, alike = _alike(bracket)
    if apart == len(alike):
        _refuse_alike(bracket, alike)


def _alike(bracket: Bracket) -> tuple[int, list[str]]:
    """Return how many neighbouring frames have different labels, and which of them are alike in their middle tones."""
    times = bracket.effective_exposures_s
    pixels = _compared_pixels(bracket) / bracket.light[0].full_scale_dn
    apart = np.flatnonzero(times[1:] >= _LEAST_LABEL_RATIO * times[:-1]).tolist()
    alike = []
    for i in apart:
        middle = (pixels[i] > _MIDDLE[0]) & (pixels[i] < _MIDDLE[1])
        enough = middle.sum() >= max(_LEAST_MIDDLE_PART * middle.size, _LEAST_COMMON_PIXELS)
        if enough and abs(float(np.mean(pixels[i + 1][middle] - pixels[i][middle]))) < _TOLERATED_DROP:
            alike.append(
                f"{frame_name(bracket, i)} ({times[i]:.4g} s) and {frame_name(bracket, i + 1)} ({times[i + 1]:.4g} s)"
            )
    return len(apart), alike


def _refuse_alike(bracket: Bracket, alike: list[str]) -> None:
    if alike:
        raise CaptureError(
            f"{bracket.origin or 'bracket'}: equally bright though their stated exposures differ: "
            f"{'; '.join(alike[:3])}; correct the exposure times or leave one of each out"
        )


def frame_name(bracket: Bracket, index: int) -> str:
    """Return what a user knows a frame by: its file, or its place in the bracket."""
    frame = bracket.light[index]
    if "file" in frame.extra:
        return str(frame.extra["file"])
    return f"frame {index if frame.frame_id is None else frame.frame_id}"


def exposure_label(bracket: Bracket, index: int) -> str:
    """Return a frame's exposure as it is stated: "0.2 s", and ISO speed or gain where these differ in the bracket."""
    stated = bracket.light[index].settings
    if len({frame.settings.gain_db for frame in bracket.light}) == 1:
        return f"{stated.exposure_s:.4g} s"
    speed = f"ISO {stated.iso:g}" if stated.iso else f"{stated.gain_db:.3g} dB"
    return f"{stated.exposure_s:.4g} s at {speed}"


def exposure_labels(bracket: Bracket) -> list[str]:
    """Return what a user knows every exposure by: as it is stated, and its file where it has one."""
    files = [f" ({frame.extra['file']})" if "file" in frame.extra else "" for frame in bracket.light]
    return [exposure_label(bracket, index) + file for index, file in enumerate(files)]


def _pairwise_rise(bracket: Bracket) -> NDArray[np.float64]:
    """Return the mean rise in DN from frame i to frame j over the pixels that clip in neither, shape (n, n).

    Where two frames have hardly such a pixel in common, the rise of the whole picture is used.
    """
    pixels = _compared_pixels(bracket)
    inside = (pixels > 0) & (pixels < min(frame.saturated_dn for frame in bracket.light))
    full_scale = bracket.light[0].full_scale_dn
    count = len(bracket.light)
    rise = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1, count):
            both = inside[i] & inside[j]
            chosen = both if int(both.sum()) >= _LEAST_COMMON_PIXELS else np.ones_like(both)
            rise[i, j] = float(np.mean(pixels[j][chosen] - pixels[i][chosen]))
    return np.asarray(rise / full_scale)


def _compared_pixels(bracket: Bracket) -> NDArray[np.float32]:
    """Return some pixels of every frame, evenly over the picture, shape (frames, pixels)."""
    step = max(1, int(np.sqrt(np.prod(bracket.shape) / _COMPARED_PIXELS)))
    return np.array([frame.dn[::step, ::step].ravel().astype(np.float32) for frame in bracket.light])


def _longest_rise(rise: NDArray[np.float64]) -> frozenset[int]:
    """Return the longest chain of frames along which brightness does not fall by more than the tolerance."""
    count = len(rise)
    length, before = [1] * count, [-1] * count
    for j in range(count):
        for i in range(j):
            if rise[i, j] >= -_TOLERATED_DROP and length[i] + 1 > length[j]:
                length[j], before[j] = length[i] + 1, i
    at = int(np.argmax(length))
    chain = []
    while at >= 0:
        chain.append(at)
        at = before[at]
    return frozenset(chain)


def _contradiction(bracket: Bracket, index: int, rise: NDArray[np.float64], consistent: frozenset[int]) -> str:
    darker = any(rise[i, index] < -_TOLERATED_DROP for i in consistent if i < index)
    shorter_or_longer = "a shorter" if darker else "a longer"
    return (
        f"{frame_name(bracket, index)} says {bracket.light[index].settings.effective_exposure_s:.4g} s "
        f"but looks like {shorter_or_longer} exposure"
    )

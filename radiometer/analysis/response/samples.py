"""Sufficient statistics for response recovery: the means of pixels that are equally bright in every frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.labels import exposure_labels
from radiometer.analysis.response.limits import ValueLimits, find_limits
from radiometer.data.frame import Bracket
from radiometer.errors import InputError, MeasurementError
from radiometer.statistics.scale import jackknife_u
from radiometer.typing import Array

# A group is left out of a frame where more than this part of its pixels clips there: the mean of the others would be
# biased towards the unclipped side.
_CLIPPED_PART = 0.002
# So near to black the rounding to whole numbers is a large part of the exposure and is not averaged away.
_LEAST_ABOVE_BLACK_DN = 4.0
_JACKKNIFE_PARTS = 10
_GROUPS = 384
_QUADRANTS = 4
# A share is every fourth cell of a grid so fine: all four see most of what even the shortest exposure shows.
_SHARES, _CELLS_ACROSS = 4, 8
# Pixels are compared with those at this distance: the next of the same colour on a mosaic.
_NEIGHBOUR_PX = 2
# Equally bright pixels at edges that vary more than those on even ground by this factor (a ratio of variances, median
# over groups and frames) do not see one thing in all frames. Noise alone makes it 1.0 to 1.1.
_EDGES_DIFFER = 1.5
_FEWEST_PIXELS_FOR_VARIANCE = 20
_OF_ROWS = ("dn", "log_time", "frame", "pixels", "variance")
# A pixel that falls by more than this part of full scale under a longer exposure did not look at one thing.
_TOLERATED_FALL = 0.1
# Nor did one in the middle tones (parts of white) that stays within this part of full scale in all frames while the
# exposure grows by this factor. Even a logarithmic camera of twenty stops gives it a tenth. Date stamps, stuck
# pixels.
_MIDDLE_TONES, _LEAST_RISE, _LEAST_GROWTH = (0.25, 0.9), 0.02, 4.0


@dataclass(frozen=True, slots=True, eq=False)
class ResponseSamples:
    """Group means in long form: one row per group and frame in which the group does not clip."""

    dn: NDArray[np.float64]  # mean digital number, shape (rows,)
    log_time: NDArray[np.float64]  # ln of the effective exposure in s of the row's frame, shape (rows,)
    group: NDArray[np.intp]  # index of the group, ascending, shape (rows,)
    frame: NDArray[np.intp]  # index of the frame over all brackets, shape (rows,)
    pixels: NDArray[np.float64]  # pixels behind the row's mean, shape (rows,)
    variance: NDArray[np.float64]  # variance in DN² of the pixels within the group in that frame, shape (rows,)
    bit_depth: int  # bits per digital number
    limits: ValueLimits  # digital numbers between which a value is neither black nor saturated
    frame_log_time: NDArray[np.float64]  # ln of the effective exposure of every frame, shape (frames,)
    pixel_count: int  # pixels of all brackets
    channel: str = "mono"  # colour channel
    # Variance of equally bright pixels at edges over that on even ground where those at edges were left out for it; 0
    # where all pixels count
    edge_scatter: float = 0.0
    # The same rows four times, each without the pixels of one quadrant of the picture; empty for samples that were
    # themselves cut from others
    without_quadrant: tuple[ResponseSamples, ...] = ()
    quadrants: tuple[ResponseSamples, ...] = ()  # the rows of each quadrant's own pixels, likewise
    # The same rows four times, each without every fourth cell of a grid over the picture, likewise
    without_share: tuple[ResponseSamples, ...] = ()
    shares: tuple[ResponseSamples, ...] = ()  # the rows of these cells alone, likewise
    # What every frame's exposure is called: stated time, speed and file; empty for cut samples
    frame_labels: tuple[str, ...] = ()
    # Ln of every frame's gain factor, which its effective exposure holds, shape (frames,) or (1,)
    frame_log_gain: NDArray[np.float64] = field(default_factory=lambda: np.zeros(1))

    @property
    def exposures_s(self) -> NDArray[np.float64]:
        """Return the exposure time of every frame in s, without its gain, shape (frames,)."""
        return np.asarray(np.exp(self.frame_log_time - self.frame_log_gain))

    @property
    def group_count(self) -> int:
        """Return the number of groups that have rows."""
        return int(self.group[-1]) + 1 if self.group.size else 0

    def third(self, index: int) -> ResponseSamples:
        """Return the rows of every third group: pixels disjoint from those of the other two thirds."""
        part = _select(self, self.group % 3 == index)
        return replace(part, pixel_count=self.pixel_count // 3)

    def changed(self, change: Callable[[ResponseSamples], ResponseSamples]) -> ResponseSamples:
        """Return what a change makes of the samples, with the same change to what was cut from them."""

        def each(parts: tuple[ResponseSamples, ...]) -> tuple[ResponseSamples, ...]:
            return tuple(change(part) for part in parts)

        return replace(
            change(self),
            without_quadrant=each(self.without_quadrant),
            quadrants=each(self.quadrants),
            without_share=each(self.without_share),
            shares=each(self.shares),
        )

    def timed(self, frame_log_time: NDArray[np.float64]) -> ResponseSamples:
        """Return the samples with other exposures, and so what was cut from them.

        Args:
            frame_log_time: ln of the effective exposure in s of every frame, shape (frames,).
        """
        return self.changed(lambda one: replace(one, frame_log_time=frame_log_time, log_time=frame_log_time[one.frame]))

    def kept(self, keep: NDArray[np.bool_]) -> ResponseSamples:
        """Return the rows to keep, without groups of which only one row is left.

        Raises:
            MeasurementError: If hardly a group is left.
        """
        rows = np.bincount(self.group[keep], minlength=self.group_count)
        left = _select(self, keep & (rows[self.group] >= 2))
        if left.group_count < 4:
            raise MeasurementError(_nothing_usable(self))
        return left


def gather_samples(brackets: Bracket | Sequence[Bracket]) -> ResponseSamples:
    """Return group means of all pixels of one or several brackets taken with one response.

    Every frame's value rises with the light, whatever the response; so does the sum over the frames. Pixels are
    therefore gathered by that sum into narrow groups, without knowing the response. Each group's mean per frame
    replaces its pixels. So all pixels count, noise is averaged before any logarithm is taken, and the groups spread
    evenly over the values and the picture.

    A pixel at an edge sees another thing in another frame as soon as camera or scene moved by part of a pixel, and a
    mean over an edge of which part is white. Where equally bright pixels vary more at edges than on even ground, those
    of the steeper half of each group are left out.

    Args:
        brackets: One bracket or several of one bit depth and channel, each with two different exposures or more.

    Raises:
        InputError: If bit depths differ or a bracket has one exposure only.
        MeasurementError: If no group is unclipped at two exposures.
    """
    several = [brackets] if isinstance(brackets, Bracket) else list(brackets)
    if not several:
        raise InputError("no bracket given; a response needs at least one bracket of two exposures")
    _check(several)
    limits = find_limits(several)
    parts: list[list[ResponseSamples]] = [[] for _ in range(2 * (_QUADRANTS + _SHARES) + 1)]
    frames = 0
    for bracket in several:
        for them, part in zip(parts, _gather_one(bracket, limits, frames), strict=True):
            first = max((other.group_count for other in them), default=0)
            them.append(replace(part, group=part.group + first))
        frames += len(bracket.light)
    whole, *others = (_joined(them) for them in parts)
    whole = replace(whole, frame_labels=tuple(label for bracket in several for label in exposure_labels(bracket)))
    if whole.group_count < 4:
        raise MeasurementError(_nothing_usable(whole))
    if any(part.group_count < 4 for part in others):  # one quadrant holds nearly all that there is to see
        return whole
    cut = iter(others)
    without_quadrant, quadrants = (tuple(islice(cut, _QUADRANTS)) for _ in range(2))
    without_share, shares = (tuple(islice(cut, _SHARES)) for _ in range(2))
    return replace(
        whole, without_quadrant=without_quadrant, quadrants=quadrants, without_share=without_share, shares=shares
    )


def u_by_groups(samples: ResponseSamples, solve: Callable[[ResponseSamples], Array]) -> Array:
    """Return the standard uncertainty of what a solver without covariance returns, by leaving out groups of pixels.

    Args:
        samples: All rows; every tenth group is left out in turn.
        solve: Returns any array of values that depend on the rows.
    """
    parts = min(_JACKKNIFE_PARTS, samples.group_count)
    left = [solve(samples.kept(samples.group % parts != part)) for part in range(parts)]
    return jackknife_u(left, few_parts=True)


def _check(brackets: Sequence[Bracket]) -> None:
    depths = {bracket.bit_depth for bracket in brackets}
    if len(depths) > 1:
        raise InputError(
            f"the brackets differ in bit depth ({', '.join(map(str, sorted(depths)))}); one response curve belongs to "
            "one pixel format: recover each by itself"
        )
    for bracket in brackets:
        times = bracket.effective_exposures_s
        if times[-1] < times[0] * 1.05:
            raise InputError(
                f"{bracket.origin or 'bracket'}: holds one exposure only ({times[0]:g} s, {len(times)} "
                f"frame{'s' if len(times) > 1 else ''}); a response needs at least two different ones"
            )


def _gather_one(bracket: Bracket, limits: ValueLimits, first_frame: int) -> tuple[ResponseSamples, ...]:
    """Return the samples of all pixels, those without each quadrant's, each quadrant's own, and likewise of shares."""
    label, group_total = _label_groups(bracket, limits)
    place = (_at_edges(bracket, label) * _SHARES + _shares(bracket.shape)) * _QUADRANTS + _quadrants(bracket.shape)
    sums = _sums_by_part(bracket, label, place, group_total, limits)
    even, edges = sums[:, 0], sums[:, 1]
    scatter = _edge_scatter(even.sum(axis=(1, 2)), edges.sum(axis=(1, 2)))
    parts = even if scatter > _EDGES_DIFFER else even + edges
    whole = parts.sum(axis=(1, 2))
    cuts = [whole]
    for own in (parts.sum(axis=1), parts.sum(axis=2)):
        cuts += [*(whole[:, None] - own).swapaxes(0, 1), *own.swapaxes(0, 1)]
    rows = [_rows(bracket, cut, limits, first_frame) for cut in cuts]
    if scatter > _EDGES_DIFFER:
        rows[0] = replace(rows[0], edge_scatter=scatter, pixel_count=int(whole[0, 0].sum()))
    return tuple(rows)


def _edge_scatter(even: NDArray[np.float64], edges: NDArray[np.float64]) -> float:
    """Return the variance of a group's pixels at edges over that of its others, median over groups and frames.

    Args:
        even: Pixels, Σ dn, Σ dn² and clipped pixels of those on even ground, shape (4, frames, groups).
        edges: The same of those at edges.
    """
    variances, known = [], np.ones(even.shape[1:], dtype=np.bool_)
    for part in (even, edges):
        count = np.maximum(part[0], 1.0)
        variances.append(part[2] / count - (part[1] / count) ** 2)
        known &= (part[0] >= _FEWEST_PIXELS_FOR_VARIANCE) & (part[3] == 0)
        known &= part[1] / count > _LEAST_ABOVE_BLACK_DN
    if not np.any(known):
        return 1.0
    rounding = 1.0 / 12.0
    return float(np.median(np.maximum(variances[1][known], rounding) / np.maximum(variances[0][known], rounding)))


def _at_edges(bracket: Bracket, label: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return 1 for the half of each group's pixels whose surroundings are the least even, flattened; else 0."""
    total = np.zeros(bracket.shape, dtype=np.int64)
    for frame in bracket.light:
        total += frame.dn
    steep = np.zeros(bracket.shape, dtype=np.int64)
    for axis in (0, 1):
        ahead, behind = [slice(None)] * 2, [slice(None)] * 2
        ahead[axis], behind[axis] = slice(_NEIGHBOUR_PX, None), slice(None, -_NEIGHBOUR_PX)
        step = np.abs(total[tuple(ahead)] - total[tuple(behind)])
        for side in (tuple(ahead), tuple(behind)):
            steep[side] = np.maximum(steep[side], step)
    # One key sorts by group, then by steepness.
    order = np.argsort(label * (int(steep.max()) + 1) + steep.ravel(), kind="stable")
    size = np.bincount(label)
    rank = np.arange(label.size) - (np.cumsum(size) - size)[label[order]]
    edges = np.empty(label.size, dtype=np.intp)
    edges[order] = rank >= (size[label[order]] + 1) // 2
    return edges


def _rows(bracket: Bracket, sums: NDArray[np.float64], limits: ValueLimits, first_frame: int) -> ResponseSamples:
    """Return the rows that sums (pixels, Σ dn, Σ dn², clipped pixels; each by frame and group) make."""
    size = sums[0, 0]
    count = np.maximum(size, 1.0)
    mean = (sums[1] / count).T
    variance = np.maximum(sums[2] / count - (sums[1] / count) ** 2, 0.0).T
    log_time = np.log(bracket.effective_exposures_s)
    usable = (size > 0)[:, None] & (mean > limits.black_dn + _LEAST_ABOVE_BLACK_DN)
    usable &= (sums[3] <= _CLIPPED_PART * size).T
    # A group seen at one exposure only says nothing about the response.
    earliest = np.where(usable, log_time, np.inf).min(axis=1)
    latest = np.where(usable, log_time, -np.inf).max(axis=1)
    usable &= (latest - earliest > 0.04)[:, None]
    _, group = np.unique(np.nonzero(usable)[0], return_inverse=True)
    row, frame_index = np.nonzero(usable)
    return ResponseSamples(
        dn=mean[row, frame_index],
        log_time=log_time[frame_index],
        group=np.asarray(group, dtype=np.intp),
        frame=frame_index + first_frame,
        pixels=size[row],
        variance=variance[row, frame_index],
        bit_depth=bracket.bit_depth,
        limits=limits,
        frame_log_time=log_time,
        pixel_count=int(np.prod(bracket.shape)),
        channel=str(bracket.light[0].extra.get("channel", "mono")),
        frame_log_gain=log_time - np.log([frame.settings.exposure_s for frame in bracket.light]),
    )


def _quadrants(shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the quadrant of every pixel, flattened: top left, top right, bottom left, bottom right."""
    height, width = shape
    low, right = np.arange(height) >= (height + 1) // 2, np.arange(width) >= (width + 1) // 2
    return np.asarray((2 * low[:, None] + right[None, :]).ravel(), dtype=np.intp)


def _shares(shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the share of every pixel, flattened: that of its cell, alike in every second cell of a row or column."""
    down, across = (np.arange(size) * _CELLS_ACROSS // size % 2 for size in shape)
    return np.asarray((2 * down[:, None] + across[None, :]).ravel(), dtype=np.intp)


def _sums_by_part(
    bracket: Bracket,
    label: NDArray[np.intp],
    part: NDArray[np.intp],
    groups: int,
    limits: ValueLimits,
) -> NDArray[np.float64]:
    """Return pixels, Σ dn, Σ dn² and clipped pixels, shape (4, 2, shares, quadrants, frames, groups)."""
    count = 2 * _SHARES * _QUADRANTS
    place = part * (groups + 1) + label  # the last group is that of contradictory pixels
    cells = count * (groups + 1)
    found = np.empty((4, count, len(bracket.light), groups))
    pixels = np.bincount(place, minlength=cells)
    for index, frame in enumerate(bracket.light):
        dn = frame.dn.ravel()
        # Sums in float64 hold 2^53: 2^31 pixels of 16 bits, squared.
        as_float = dn.astype(np.float64)
        clipped = (dn <= limits.black_dn) | (dn >= limits.saturated_dn)
        for row, total in enumerate(
            (
                pixels,
                np.bincount(place, as_float, cells),
                np.bincount(place, as_float * as_float, cells),
                np.bincount(place[clipped], minlength=cells),
            )
        ):
            found[row, :, index] = total.reshape(count, groups + 1)[:, :groups]
    return found.reshape(4, 2, _SHARES, _QUADRANTS, len(bracket.light), groups)


def _label_groups(bracket: Bracket, limits: ValueLimits) -> tuple[NDArray[np.intp], int]:
    """Return the group of every pixel (flattened) and the number of groups; contradictory pixels get that number."""
    total = np.zeros(bracket.shape, dtype=np.uint32)
    for frame in bracket.light:
        total += frame.dn
    key = total.ravel()
    contradictory = (_contradictory(bracket) | _unmoved(bracket, limits)).ravel()
    histogram = np.bincount(key[~contradictory], minlength=1)
    # Cut at equal numbers of pixels and, besides, at equal steps of the sum: rare bright pixels stay apart.
    group_count = min(_GROUPS, max(64, key.size // 12))
    by_count = (np.cumsum(histogram) - 1) * group_count // max(int(histogram.sum()), 1)
    by_value = np.arange(histogram.size, dtype=np.int64) * group_count // histogram.size
    starts = np.diff(by_count, prepend=-1).astype(bool) | np.diff(by_value, prepend=-1).astype(bool)
    lookup = (np.cumsum(starts) - 1).astype(np.intp)
    groups = int(lookup[-1]) + 1
    label = lookup[np.minimum(key, histogram.size - 1)]
    label[contradictory] = groups
    return label, groups


def _contradictory(bracket: Bracket) -> NDArray[np.bool_]:
    """Return the pixels that get darker as the exposure grows: movement, borders of registered frames, defects."""
    tolerated = int(_TOLERATED_FALL * bracket.light[0].full_scale_dn)
    highest = np.zeros(bracket.shape, dtype=bracket.light[0].dn.dtype)
    bad = np.zeros(bracket.shape, dtype=np.bool_)
    for frame in bracket.light:
        np.maximum(highest, frame.dn, out=highest)
        bad |= (highest - frame.dn) > tolerated
    return bad


def _unmoved(bracket: Bracket, limits: ValueLimits) -> NDArray[np.bool_]:
    """Return the pixels that stay as they are in the middle tones while the exposure grows: they see no light."""
    times = bracket.effective_exposures_s
    if times[-1] < _LEAST_GROWTH * times[0]:
        return np.zeros(bracket.shape, dtype=np.bool_)
    low, high = (part * limits.saturated_dn for part in _MIDDLE_TONES)
    lowest, highest = bracket.light[0].dn, bracket.light[0].dn
    for frame in bracket.light[1:]:
        lowest, highest = np.minimum(lowest, frame.dn), np.maximum(highest, frame.dn)
    still = highest - lowest < _LEAST_RISE * bracket.light[0].full_scale_dn
    return np.asarray(still & (lowest > low) & (highest < high))


def _joined(parts: Sequence[ResponseSamples]) -> ResponseSamples:
    names = (*_OF_ROWS, "group", "frame_log_time", "frame_log_gain")
    joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    count, edge_scatter = sum(part.pixel_count for part in parts), max(part.edge_scatter for part in parts)
    return replace(parts[0], **joined, pixel_count=count, edge_scatter=edge_scatter)


def _nothing_usable(samples: ResponseSamples) -> str:
    return (
        "hardly a pixel is unclipped at two exposures: the frames are saturated or black almost everywhere. "
        f"Usable are values above {samples.limits.black_dn} and below {samples.limits.saturated_dn}. "
        "Take exposures about one stop apart that show the scene between black and white"
    )


def _select(samples: ResponseSamples, keep: NDArray[np.bool_]) -> ResponseSamples:
    group = np.unique(samples.group[keep], return_inverse=True)[1].astype(np.intp)
    kept: dict[str, Any] = {name: getattr(samples, name)[keep] for name in _OF_ROWS}
    uncut: dict[str, Any] = dict.fromkeys(("without_quadrant", "quadrants", "without_share", "shares"), ())
    return replace(samples, **kept, group=group, frame_labels=(), **uncut)

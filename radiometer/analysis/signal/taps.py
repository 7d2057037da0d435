"""Read-out by several amplifiers (taps): which pixels gather light, and the black level and gain of each tap.

Merge, readings and calibrations use it where the camera's description holds `taps`. Overscan is read with the light, so
that it gives the black level of each tap and row of the frame. Where taps have none, dark frames give how their black
levels differ. The gains are those of a characterisation. Noise is that of the camera's one gain: where taps differ by
5 %, its standard deviation is off by 2.5 %.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.signal.borders import borders
from radiometer.analysis.signal.model import is_cut_off
from radiometer.data import Bracket, Frame, Patch, TapDescription
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError
from radiometer.typing import Array, Image, Mask

# Amplifiers of one sensor whose gains were not measured: ±10 % as a rectangle, assumed.
UNKNOWN_GAIN_U_REL: Final = 0.1 / math.sqrt(3.0)
_ROWS_LOOKED_AT: Final = 256  # of a picture in which borders are looked for: a step is one of whole lines
_MISMATCH: Final = 0.2  # amplifiers of one sensor differ by less; edges of a scene mostly by more
_ALIKE: Final = 0.25  # of the step, by which it may vary along the border
_PARTS: Final = 16  # amplifiers stand side by side in so many equal parts, or half or a quarter of them
_BORDER_PX: Final = 4  # columns on each side whose means make the step


@dataclass(frozen=True, slots=True, eq=False)
class ReadOut:
    """The taps of the frames in use."""

    taps: tuple[TapDescription, ...]  # in pixels of the frames
    number: NDArray[np.uint8]  # of each pixel's tap from 1, 0 where no light reaches; shape (height, width)
    gain: Array | None  # of each tap over their mean, with a 1 before for number 0; None where it is not determined
    gain_u_rel: Array  # its relative standard uncertainty
    # Black level of each tap above their mean in DN, with a 0 before, by gain in dB: where dark frames give it
    by_darks_dn: Mapping[float, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, setup: Setup, shape: tuple[int, int]) -> ReadOut | None:
        """Return the taps that camera or calibration describe; None where they describe none.

        Args:
            setup: With a calibration its gains of taps count: the scale was made with them.
            shape: (height, width) of the frames.

        Raises:
            MeasurementError: If a tap is not on the frames.
        """
        of_scale = (setup.calibration.camera.taps or ()) if setup.calibration else ()
        taps = setup.camera.taps or of_scale
        if not taps:
            return None
        number = np.zeros(shape, np.uint8)
        for place, tap in enumerate(taps, 1):
            if not all(where.fits(shape) for where in (tap.patch, *(Patch(*one) for one in tap.overscan))):
                raise MeasurementError(
                    f"tap {tap.name} is not inside frames of {shape[1]} × {shape[0]} pixels; describe the taps of "
                    "these frames (camera.taps, --taps)"
                )
            number[tap.patch.slices] = place
        known = {tap.name: tap for tap in (of_scale if setup.calibration else taps)}
        figures = [known.get(tap.name, tap) for tap in taps]
        # A characterisation has K in DN/e⁻; a description its reciprocal.
        gains = [1.0 / one.conversion_gain_e_per_dn for one in figures if one.conversion_gain_e_per_dn]
        determined = len(gains) == len(taps) == len(known)
        gain = np.array([1.0, *(np.array(gains) / np.mean(gains))]) if determined else None
        u_rel = [one.conversion_gain_u_rel or 0.0 if determined else UNKNOWN_GAIN_U_REL for one in figures]
        return cls(taps, number, gain, np.array([0.0, *u_rel]))

    @property
    def lit(self) -> Mask:
        """Return the pixels that gather light, shape (height, width)."""
        return self.number > 0

    @property
    def has_overscan(self) -> bool:
        """Return whether every tap has pixels that it reads without light."""
        return all(tap.overscan for tap in self.taps)

    def with_darks(self, darks: Iterable[Frame]) -> ReadOut:
        """Return it with the differences between the black levels of taps in dark frames, the shortest of each gain.

        Frames whose noise is cut off at 0 are left out: their means are above the black levels.
        """
        shortest: dict[float, list[Frame]] = {}
        for frame in sorted(itertools.filterfalse(is_cut_off, darks), key=lambda one: one.settings.exposure_s):
            known = shortest.setdefault(frame.settings.gain_db, [])
            if not known or known[0].settings.exposure_s == frame.settings.exposure_s:
                known.append(frame)
        blacks = {
            gain_db: np.array([np.mean([one.dn[tap.patch.slices].mean() for one in some]) for tap in self.taps])
            for gain_db, some in shortest.items()
        }
        return replace(self, by_darks_dn={g: np.array([0.0, *(dn - dn.mean())]) for g, dn in blacks.items()})

    def levelled(self, frame: Frame) -> Frame:
        """Return a frame with the black level of each of its pixels, as far as overscan or dark frames give it."""
        if frame.shape != self.number.shape:  # frames of several sizes are refused where they meet
            return frame
        if self.has_overscan:
            blacks = [_overscan_rows(frame, tap) for tap in self.taps]
            level_dn = float(np.mean([rows.mean() for rows, _ in blacks]))
            offset = np.zeros(frame.shape, np.float32)
            for tap, (rows, _) in zip(self.taps, blacks, strict=True):
                offset[tap.patch.slices] = (rows - level_dn)[:, np.newaxis]
            u_dn = math.sqrt(float(np.mean([u**2 for _, u in blacks])))
            settings = replace(frame.settings, black_level_dn=level_dn)
            return replace(frame, settings=settings, black_offset_dn=offset, black_u_dn=u_dn)
        by_darks = self.by_darks_dn.get(frame.settings.gain_db)
        if by_darks is None:
            return frame
        return replace(frame, black_offset_dn=by_darks.astype(np.float32)[self.number])

    def tap_of(self, patch: Patch) -> str | None:
        """Return the name of the tap that reads a patch; None where several do.

        Raises:
            MeasurementError: If it reaches into pixels that no light reaches.
        """
        numbers = np.unique(self.number[patch.slices])
        if numbers[0] == 0:
            places = "; ".join(f"{t.x},{t.y},{t.width},{t.height}" for t in self.taps)
            raise MeasurementError(
                f"the patch {patch} reaches into pixels that no light reaches (overscan); "
                f"choose it inside one tap: {places}"
            )
        return self.taps[numbers[0] - 1].name if numbers.size == 1 else None

    def u_rel(self, scaled_in: str | None) -> Array:
        """Return the relative standard uncertainty of each tap's gain against the tap that the scale was made in.

        Args:
            scaled_in: Name of that tap; None where it is not known.
        """
        there = next((n for n, tap in enumerate(self.taps, 1) if tap.name == scaled_in), 0)
        u = np.asarray(np.hypot(self.gain_u_rel, self.gain_u_rel[there]))
        u[[0, there]] = 0.0
        return u

    def gain_of(self, patch: Patch) -> Array:
        """Return the gain at the pixels of a patch over the mean of the taps, 1 where it is not determined."""
        numbers = self.number[patch.slices]
        return np.ones(numbers.shape) if self.gain is None else np.asarray(self.gain[numbers])

    def notes(self, *, has_darks: bool) -> tuple[str, ...]:
        """Return what was used of the taps, and what was not, a sentence each.

        Args:
            has_darks: Whether dark frames gave the black level of taps without overscan.
        """
        several = len(self.taps) > 1
        if self.has_overscan:
            black = "black level per tap and row from overscan"
        elif has_darks:
            black = "black level per tap from dark frames"
        else:
            black = "black level per tap not determined: the taps have no overscan, and no dark frames of this gain"
        if self.gain is not None:
            of_gain = "gain per tap from their characterisation"
        else:
            of_gain = "gain of taps not determined: steps between taps stay; characterise the camera with its taps"
        unlit = 1.0 - float(np.mean(self.lit))
        masked = (f"{100 * unlit:.2g} % of the pixels gather no light: masked as unlit",) if unlit else ()
        return (black, *((of_gain,) if several else ()), *masked)


def levelled_frames(
    frames: Bracket | Iterable[Frame], setup: Setup
) -> tuple[Bracket | Iterable[Frame], ReadOut | None]:
    """Return frames with the black levels of their taps, and the taps; the same frames where none are described.

    Raises:
        MeasurementError: If a tap is not on the frames.
    """
    listed = iter(frames.every_frame if isinstance(frames, Bracket) else frames)
    first = tuple(itertools.islice(listed, 1))
    taps = ReadOut.of(setup, first[0].shape) if first else None
    every = itertools.chain(first, listed)
    return (every if taps is None else map(taps.levelled, every)), taps


def _overscan_rows(frame: Frame, tap: TapDescription) -> tuple[Array, float]:
    """Return the black level of each row of a tap in DN from its overscan, and its standard uncertainty.

    Means of rows differ by noise as well. They count by the part of their variance that noise does not explain, the
    mean of all rows by the rest.

    Source: Efron and Morris 1973, JASA 68, 117 (means shrunk towards their mean).
    """
    places = [Patch(*one) for one in tap.overscan]
    across = [one for one in places if one.y <= tap.y and one.y + one.height >= tap.y + tap.height]
    rows = slice(tap.y, tap.y + tap.height)
    if sum(one.width for one in across) < 2:
        pixels = np.concatenate([frame.dn[one.slices].ravel() for one in places]).astype(np.float64)
        return np.full(tap.height, pixels.mean()), float(pixels.std()) / math.sqrt(pixels.size)
    pixels = np.concatenate([frame.dn[rows, one.slices[1]] for one in across], axis=1).astype(np.float64)
    means, noise = pixels.mean(axis=1), float(pixels.var(axis=1, ddof=1).mean()) / pixels.shape[1]
    between = float(means.var(ddof=1)) if means.size > 1 else 0.0
    share = max(0.0, 1.0 - noise / between) if between > 0.0 else 0.0
    level = float(means.mean())
    return level + share * (means - level), math.sqrt(noise * (share + (1.0 - share) / means.size))


def doubt_of_taps(values: Image, darks: Sequence[Frame]) -> tuple[str, ...]:
    """Return a sentence where frames without described taps step along whole lines as those of several taps do.

    Args:
        values: Radiance of every pixel, shape (height, width). Its step must be of one ratio along the border: edges of
            a scene hardly are.
        darks: Dark frames, of which a scene shows nothing.
    """
    pictures = [(values, True), *((frame.dn, False) for frame in darks[:1])]
    for picture, is_scene in pictures:
        for name, turned in (("column", picture), ("row", picture.T)):
            thinned = turned[:: max(1, turned.shape[0] // _ROWS_LOOKED_AT)]
            # Bad columns of one amplifier make steps as well, at any place.
            found = [one for one in borders([thinned]) if one * _PARTS % turned.shape[1] == 0]
            found = [one for one in found if not is_scene or _is_mismatch(thinned, one)]
            if found:
                where = f"{'' if is_scene else 'dark '}frames step along {name} {found[0]}"
                return (
                    f"the {where} as between taps, whose black level or gain differs: u does not hold it; describe the "
                    "taps (--taps)",
                )
    return ()


def _is_mismatch(picture: NDArray[Any], column: int) -> bool:
    """Return whether a step is small, and of one ratio along half of the border at least."""
    strips = np.stack([part.mean(axis=0, dtype=np.float64) for part in np.array_split(picture, 8)])
    left = strips[:, column - _BORDER_PX : column].mean(axis=1)
    right = strips[:, column : column + _BORDER_PX].mean(axis=1)
    if np.any(left <= 0.0):
        return False
    steps = right / left - 1.0
    return any(
        0.0 < abs(half.mean()) < _MISMATCH and half.std() < _ALIKE * abs(half.mean()) for half in (steps[:4], steps[4:])
    )

"""A bracket merged into radiance per pixel: the maximum-likelihood value, its standard uncertainty, and a mask."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge.displaced import excess_scatter, find_strays, relative_shift, with_shift
from radiometer.analysis.merge.finish import CENSORED_SIGMA, AtLevels, MergeTables, finish, finish_moved, merge_tables
from radiometer.analysis.merge.frames import FrameTerms, frame_terms, with_excess, with_own_ends, with_taps
from radiometer.analysis.merge.sums import MANY, Images, MergeSample, MergeSums, ScratchSums, merge_passes
from radiometer.analysis.photometry.photometry import KINDS
from radiometer.analysis.reading.budget import UNKNOWN_FALLOFF, common_u_rel, frame_u_rel, unstated_u_rel
from radiometer.analysis.reading.estimate import FLICKER_FLOOR_REL, doubted_gains, fluctuation
from radiometer.analysis.signal.lens import (
    doubtful_loss,
    falloff_known,
    flat_doubt,
    is_as_scaled,
    known_f_number,
    lens_factor_sr,
    relative_sensitivity,
)
from radiometer.analysis.signal.model import (
    corrected_settings,
    darkest_signal,
    refuse_brighter_darks,
    refuse_other_format,
    some_lit_pixels,
    temperature_factor,
    with_found_code_step,
)
from radiometer.analysis.signal.situation import flat_field_for, situation_of
from radiometer.analysis.signal.taps import ReadOut, doubt_of_taps
from radiometer.data import Bracket, FoundEffects, Frame, PixelMask, Provenance, RadianceMap
from radiometer.data.frame import Copies, DigitalNumbers
from radiometer.data.reading import RADIANCE_UNIT, RELATIVE_UNIT
from radiometer.data.setup import Setup
from radiometer.data.white_level import white_level_notes
from radiometer.errors import MeasurementError
from radiometer.numbers import unit_text
from radiometer.reporting.origin import moment, span_of
from radiometer.statistics.model_choice import FIVE_SIGMA, is_supported
from radiometer.typing import Array

BLOCK_PIXELS: Final = 1 << 15  # a block's sums stay in a core's second-level cache
_PARTS_PER_CORE: Final = (
    4  # few, because each costs the interpreter's lock; several, because cores are not equally fast
)
MOST_FRAMES = 64  # the bits of the largest integer that marks the frames of a pixel
_ROUNDED_DN = 1.0  # the standard uncertainty of a black level counts as one of ±1 DN where nothing states it
_NOISE: Final = frozenset({"conversion_gain_e_per_dn", "read_noise_e"})
_PIXELS_OF_NOISE: Final = 4096  # evenly over the picture: noise is then known to some per cent
_PIXELS_OF_LIGHT: Final = 1024  # evenly over the picture: the median is then known to a 25th of a pixel's noise
_PIXELS_OF_CODES: Final = 512  # of each frame, evenly: more than the codes that show how far apart they are
_BRIGHT_BLOCKS: Final = 256  # of 8 × 8 pixels, of which four count: a lamp may be small on a dark surround
_LEAST_LIT: Final = 16  # pixels that say anything of a whole frame
_NEARLY_AS_CLEAR: Final = 4.0  # in the variance of their noise: a quarter as bright
_ROUNDS: Final = 8  # in which amplitudes of frames and light of pixels settle
_SETTLED: Final = 1e-4  # an amplitude that moves by less
_CLEAR_OF_NOISE: Final = 0.3  # noise over signal, up to which the median of rounded numbers follows the light
_REPORTED_EXCESS: Final = 1.2  # of a variance
_REPORTED_REL = 0.001  # an offset of exposures that does less to the brightest pixels is not reported


def _pixels_of_light(dn: NDArray[Any]) -> NDArray[np.intp]:
    """Return places of some pixels of a picture: evenly over it, and in its brightest blocks of 8 × 8.

    How bright a block is, other pixels of it show, so that noise does not choose.
    """
    even = np.arange(0, dn.size, max(1, dn.size // _PIXELS_OF_LIGHT))
    height, width = (size // 8 for size in dn.shape)
    shown = [dn[y : 8 * height : 8, x : 8 * width : 8].astype(np.uint32) for y in (1, 5) for x in (1, 5)]
    brightest = np.argsort(np.sum(shown, axis=0), axis=None)[-_BRIGHT_BLOCKS:]
    corners = 8 * (brightest // max(width, 1)) * dn.shape[1] + 8 * (brightest % max(width, 1))
    return np.unique(np.concatenate([even, *(corners + y * dn.shape[1] + x for y in (3, 7) for x in (3, 7))]))


def _amplitudes(x: Array, exposures: Array) -> tuple[Array, Array]:
    """Return the light of each frame relative to all, and what x would be by that of all, shape (frames, pixels).

    Args:
        x: Signal of the same pixels in every frame, shape (frames, pixels); NaN where it does not count.
        exposures: Of the frames.
    """
    amplitude = np.ones(exposures.size)
    whole = np.nansum(x, axis=0)
    for _ in range(_ROUNDS):
        expected = np.where(np.isfinite(x), exposures[:, None], np.nan)
        with np.errstate(invalid="ignore", divide="ignore"):
            expected *= whole / np.nansum(expected * amplitude[:, None], axis=0)
            before, amplitude = amplitude, np.nanmedian(x / expected, axis=1)
        if np.abs(amplitude - before).max() < _SETTLED:
            break
    return amplitude, expected


def on_all_cores(shape: tuple[int, int], work: Callable[[int, int], None]) -> None:
    """Call work(start, stop) for parts of whole rows that make up the picture, on all cores.

    Args:
        shape: Height and width in pixels.
        work: Takes the first pixel of a part and the one after its last; must hold no lock to gain by it.
    """
    height, width = shape
    cores = os.cpu_count() or 1
    rows = -(-height // (cores * _PARTS_PER_CORE)) * width
    parts = [(start, min(start + rows, height * width)) for start in range(0, height * width, rows)]
    with ThreadPoolExecutor(max_workers=cores) as pool:
        list(pool.map(lambda part: work(*part), parts))


def block_size(width: int) -> int:
    """Return the largest number of pixels that a block has: whole rows, as many as the cache holds, one at least."""
    return max(1, BLOCK_PIXELS // width) * width


def blocks(start: int, stop: int, width: int) -> Iterator[tuple[int, int]]:
    """Yield the bounds of blocks of whole rows."""
    step = block_size(width)
    for begin in range(start, stop, step):
        yield begin, min(begin + step, stop)


def finish_sums(
    sums: MergeSums, terms: Sequence[FrameTerms], kept: tuple[Any, ...], tables: MergeTables, factor: Any, begin: int
) -> None:
    """Turn sums into radiance, standard uncertainty and mask, in place.

    Args:
        sums: Of a run of pixels; they make room for the result.
        kept: As of `MergeTables.kept`.
        tables: Of these frames.
        factor: Radiance per rate, of every pixel or of all (size 1), float32.
        begin: First of the pixels in the picture that dark signals are of.
    """
    summed = sums.first, sums.second, sums.squares, sums.patterns(), sums.mask
    pixels, *own_ends = with_own_ends(terms, summed[3], begin, tables.kappa)
    own = np.empty(pixels.size), np.empty(pixels.size), np.empty(pixels.size, np.uint8)
    if pixels.size:
        finish_moved(summed, kept, *tables.arguments, pixels, tuple(own_ends), own)
    finish(summed, kept, *tables.arguments, (factor, sums.first, sums.second))
    if pixels.size:
        scale = factor[pixels] if factor.size > 1 else factor
        sums.first[pixels], sums.second[pixels], sums.mask[pixels] = own[0] * scale, np.sqrt(own[1]) * scale, own[2]


def repair_defects(
    radiance: NDArray[np.floating],
    u_radiance: NDArray[np.floating],
    mask: NDArray[np.uint8],
    defects: Sequence[tuple[int, int]],
) -> None:
    """Fill defective pixels in place with the mean of their sound neighbours, and mark them DEFECTIVE.

    The uncertainty is that of the mean together with the scatter of the neighbours: what stood there is not known.
    A pixel without sound neighbours keeps its value with an uncertainty as large.

    Args:
        radiance: Radiance, shape (height, width), still owned by the merge.
        defects: Positions (x, y); those outside the picture are left out.
    """
    height, width = radiance.shape
    inside = [(x, y) for x, y in defects if 0 <= x < width and 0 <= y < height]
    for x, y in inside:
        mask[y, x] |= PixelMask.DEFECTIVE
    for x, y in inside:
        window = slice(max(y - 1, 0), y + 2), slice(max(x - 1, 0), x + 2)
        sound = mask[window] & (PixelMask.DEFECTIVE | PixelMask.SATURATED) == 0
        values = radiance[window][sound].astype(np.float64)
        if values.size < 2:
            u_radiance[y, x] = abs(radiance[y, x])
            continue
        noise = float(np.mean(u_radiance[window][sound].astype(np.float64) ** 2)) / values.size
        radiance[y, x] = values.mean()
        u_radiance[y, x] = np.sqrt(noise + values.var(ddof=1))


def merge(
    frames: Bracket | Iterable[Frame],
    setup: Setup,
    *,
    absent: Sequence[NDArray[np.bool_]] = (),
    without_ghosts: bool = False,
    displacement_px: float = 0.0,
) -> RadianceMap:
    """Return radiance in W·sr⁻¹·m⁻² (relative without a calibration) and its standard uncertainty for every pixel.

    Frames of a Bracket are all in memory and go through the sums at once, block by block; of any other iterable two
    frames (five of 8 bits) are held at most. Dark frames come before light ones.

    Args:
        frames: Frames of one unmoving scene, 1 to 64 light ones, in any order of exposure.
        setup: Camera, lens and calibration in use; without a calibration values are relative.
        absent: Of a Bracket: where each light frame shows nothing, shape (height, width) each.
        without_ghosts: Of a Bracket: leave out of every pixel the frames that contradict the others there.
        displacement_px: Of a Bracket: standard deviation of a frame's displacement along any direction in pixels.

    Raises:
        CalibrationError: If the calibration is of another camera or lens.
        MeasurementError: If there is no light frame, there are more than 64, or frames do not belong together.
    """
    merging = StreamingMerge(setup)
    if isinstance(frames, Bracket):
        return merging.merge_bracket(frames, absent, without_ghosts=without_ghosts, displacement_px=displacement_px)
    for frame in frames:
        merging.add(frame)
    return merging.result()


class StreamingMerge:
    """Merges frames as they arrive; holds sums per pixel and the frames of a small batch.

    A batch goes through the sums in one pass over the memory, which is what takes the time. It is as large as leaves
    the whole under three planes of 32 bits beyond the result, up to 32 frames (four planes for more).

    Args:
        setup: Camera, lens and calibration in use; without a calibration values are relative.

    Raises:
        CalibrationError: If the calibration is of another camera or lens.
    """

    def __init__(self, setup: Setup) -> None:
        self._situation = situation_of(setup)
        self._model = self._situation.model  # with the noise that the frames show where it is not stated
        self._shown: list[
            tuple[Array, Array]
        ] = []  # of frames with assumed noise: x of some pixels, rounding's variance
        self._calibration, self._camera = setup.calibration, setup.camera
        self._through_lens = setup.calibration is None or setup.calibration.scale.f_number is not None
        self._of_noise: tuple[str, ...] = ()
        self._places: NDArray[np.intp] | None = None  # of pixels that show the light of whole frames
        self._lit: list[Array] = []  # x of these pixels of every frame, NaN where it clips
        self._wander_rel = 0.0  # by what frames differ as a whole
        self._terms: list[FrameTerms] = []
        self._dark: list[Frame] = []
        self._codes: list[DigitalNumbers] = []  # digital numbers of some pixels of all frames so far
        self._shape: tuple[int, int] | None = None
        self._taps: ReadOut | None = None
        self._sums: MergeSums | None = None
        self._pending: list[MergeSample] = []
        self._finished = False
        self._displacement: dict[str, float] = {}  # of the frames, for the provenance
        self._copies = Copies()
        self._darkest = math.inf  # signal x of the darkest pixels of all frames; 0 where masked pixels show the black

    def add(self, frame: Frame) -> None:
        """Take a frame in; its pixels are read now or with one of the next frames, and must stay as they are.

        Raises:
            MeasurementError: If it does not belong to the frames before it.
        """
        frame = self._corrected(frame)
        self._refuse_misfit(frame)
        if self._copies.again(frame):
            return
        if frame.settings.is_dark:
            if self._terms:
                raise MeasurementError("a dark frame came after light ones; give dark frames first")
            self._dark.append(frame)
            return
        self._pending.append(self._sample(frame))
        if len(self._pending) >= self._batch_size(frame) or len(self._terms) % MANY == 0:
            self._take_in()

    def result(self) -> RadianceMap:
        """Return the radiance map of the frames taken in; nothing can be added afterwards.

        Raises:
            MeasurementError: If there was no light frame.
        """
        return self._map(self._merged(self._last_batch()))

    def _last_batch(self) -> list[MergeSample]:
        """Return the frames not yet summed; noise that nothing states is widened to what all frames show."""
        batch, self._pending = self._pending, []
        if not self._shown:
            return batch
        from radiometer.analysis.response.pixel_noise import excess_noise

        x, rounding = (np.array(each) for each in zip(*self._shown, strict=True))
        exposure, dark = (np.array([getattr(one, name) for one in self._terms]) for name in ("exposure", "variance"))
        shot = 1.0 / self._model.electrons_per_unit
        try:
            excess = excess_noise(x, exposure, shot, dark, rounding)
        except MeasurementError as error:
            self._of_noise = (f"{error}; u rests on typical noise",)
            return batch
        if excess.max() > _REPORTED_EXCESS:
            light, dark_too = np.sqrt(excess)
            self._of_noise = (
                f"the frames scatter more than is typical: u holds {light:.2g} times the shot noise and {dark_too:.2g} "
                "times the noise without light",
            )
        self._model = replace(self._model, electrons_per_unit=float(self._model.electrons_per_unit / excess[0]))
        self._terms = [with_excess(one, excess, shot) for one in self._terms]
        return [replace(one, terms=self._terms[one.index]) for one in batch]

    def _show(self, sample: MergeSample) -> None:
        """Keep what some pixels show of the noise where neither camera nor calibration states it."""
        model, (height, width), lit = self._model, self._known_shape(), None if self._taps is None else self._taps.lit
        if not _NOISE.intersection(model.noise.assumed):
            return
        step = max(1, math.isqrt(height * width // _PIXELS_OF_NOISE))
        first = (np.arange(0, height - 1, step)[:, None] * width + np.arange(0, width - 1, step)).ravel()
        pixels = np.array([first, first + width + 1])  # diagonal: noise of rows or columns is not that of both
        pixels = pixels if lit is None else pixels[:, lit.ravel()[pixels].all(axis=0)]
        dn, settings = sample.dn[pixels], sample.terms.settings
        low, top = sample.limits
        x = np.where((dn >= low) & (dn < top), sample.signal_at(pixels), np.nan)
        slope = model.at_dn(model.slope, dn - model.black_of(settings) + model.black_dn) / sample.terms.gain
        self._shown.append((x, np.zeros(x.shape) if model.linear else slope**2 * model.noise.code_variance_dn2))

    def _merged(self, batch: list[MergeSample]) -> Images:
        """Return radiance, uncertainty and mask, flat, from the sums so far and a last batch."""
        (height, width), tables = self._known_shape(), merge_tables(self._terms, self._model)
        passes, sums = merge_passes(batch, self._terms), self._sums
        if sums is not None or self._finished:
            sums = self._known_sums()
            images = sums.first, sums.second, sums.mask
        else:
            size = height * width
            images = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.uint8)
        self._sums, self._finished = None, True

        idle: list[tuple[Any, ...]] = []  # what is kept of sets of frames, from one part of the picture to another

        def work(start: int, stop: int) -> None:
            try:
                kept = idle.pop()
            except IndexError:  # asked first, another thread might take the last between question and answer
                kept = tables.kept()
            room = sums or ScratchSums.of(images, block_size(width), self._terms)
            for begin, end in blocks(start, stop, width):
                part = room.part(begin, end)
                part.add(passes, begin)
                part.take_lowest(self._terms)
                finish_sums(part, self._terms, kept, tables, self._factor(begin, end - begin), begin)
            idle.append(kept)

        on_all_cores((height, width), work)
        return images

    def merge_bracket(
        self,
        bracket: Bracket,
        absent: Sequence[NDArray[np.bool_]] = (),
        *,
        without_ghosts: bool = False,
        displacement_px: float = 0.0,
    ) -> RadianceMap:
        """Return the radiance map of a bracket in memory, every pixel's sums made and used up at once.

        Raises:
            MeasurementError: As `merge`, which has the arguments.
        """
        for dark in bracket.dark:
            self.add(dark)
        kept = [n for n, one in enumerate(bracket.light) if not self._copies.again(one)]
        absent = [absent[n] for n in kept] if absent else absent
        for n in kept:
            frame = self._corrected(bracket.light[n])
            self._refuse_misfit(frame)
            self._pending.append(self._sample(frame))
        batch = self._last_batch()
        images = self._merged(batch)
        self._leave_out_absent(batch, images, absent)
        shift = self._shift(images, displacement_px) if displacement_px else None
        excused = self._excuse(batch, images, absent, shift)
        if without_ghosts:
            self._leave_out_strays(batch, images, absent, shift)
        if displacement_px:
            shift = self._shift(images, displacement_px)
            levels = merge_tables(self._terms, self._model).at_levels()
            with_shift(images[0], images[1], shift, self._factor(0, shift.size), levels)
            pixels, excess = excused
            images[1][pixels] *= np.sqrt(np.maximum(excess, 1.0)).astype(np.float32)
        self._displacement = {"displacement_px": displacement_px} if displacement_px else {}
        return self._map(images)

    def _shift(self, images: Images, displacement_px: float) -> NDArray[np.float32]:
        """Return the relative change that a displacement by one standard deviation makes, flat."""
        shape = self._known_shape()
        return relative_shift(images[0].reshape(shape), images[1].reshape(shape), displacement_px).ravel()

    def _excuse(
        self,
        batch: list[MergeSample],
        images: Images,
        absent: Sequence[NDArray[np.bool_]],
        shift: NDArray[np.float32] | None,
    ) -> tuple[NDArray[np.intp], Array]:
        """Take the flag off pixels where displacement explains how the frames disagree.

        Returns:
            These pixels, and their squared scatter over what noise and displacement together make; none without shift.
        """
        if shift is None:
            return np.empty(0, np.intp), np.empty(0)
        tables = merge_tables(self._terms, self._model)
        doubtful = np.flatnonzero(images[2] & PixelMask.INCONSISTENT)
        excess = np.empty(doubtful.size)
        for start in range(0, doubtful.size, BLOCK_PIXELS):
            pixels = doubtful[start : start + BLOCK_PIXELS]
            rate = images[0][pixels] / self._factor_at(pixels).astype(np.float64)
            excess[start : start + pixels.size] = excess_scatter(
                batch, tables, pixels, rate, shift[pixels].astype(np.float64), absent
            )
        explained = np.isfinite(excess)
        images[2][doubtful[explained]] &= ~np.uint8(PixelMask.INCONSISTENT)
        return doubtful[explained], excess[explained]

    def _leave_out_absent(self, batch: list[MergeSample], images: Images, absent: Sequence[NDArray[np.bool_]]) -> None:
        """Merge pixels anew, in place, without the frames that show nothing there."""
        mask = images[2]
        if absent:
            bits = np.zeros(mask.size, np.uint64)
            for k, one in enumerate(absent):
                bits |= one.ravel().astype(np.uint64) << np.uint64(k)
            pixels = np.flatnonzero(bits)
            self._merge_parts(batch, pixels, bits[pixels], images)

    def _leave_out_strays(
        self,
        batch: list[MergeSample],
        images: Images,
        absent: Sequence[NDArray[np.bool_]],
        shift: NDArray[np.float32] | None,
    ) -> None:
        """Merge pixels anew, in place, without the frames that contradict the others there."""
        mask, shape = images[2], self._known_shape()
        tables = merge_tables(self._terms, self._model)
        doubtful = (mask & PixelMask.INCONSISTENT > 0).reshape(shape)
        strays = find_strays(batch, tables, doubtful, absent, shift)
        self._merge_parts(batch, strays.pixels, strays.left_out, images)
        mask[strays.pixels] |= np.uint8(PixelMask.MOVED)
        mask[strays.pixels[strays.alone]] |= np.uint8(PixelMask.INCONSISTENT)

    def _merge_parts(
        self, batch: list[MergeSample], pixels: NDArray[np.intp], left_out: NDArray[np.uint64], images: Images
    ) -> None:
        """Merge some pixels anew without the frames whose bits are set for each."""
        order = np.argsort(left_out, kind="stable")
        pixels, left_out = pixels[order], left_out[order]
        starts = np.flatnonzero(np.diff(left_out, prepend=np.uint64(0), append=np.uint64(0)) != 0)
        for start, stop in itertools.pairwise(starts):
            bits, these = int(left_out[start]), pixels[start:stop]
            kept = [one for one in batch if not bits >> one.index & 1]
            if kept:
                self._merge_anew(kept, these, images)
            else:  # no frame shows anything here
                images[1][these] = images[0][these]
                images[2][these] = np.uint8(PixelMask.SATURATED | PixelMask.DEFECTIVE)

    def _merge_anew(self, kept: list[MergeSample], pixels: NDArray[np.intp], images: Images) -> None:
        """Merge some pixels of some frames, and put the result in its place."""
        samples = [one.only(pixels, index) for index, one in enumerate(kept)]
        sums = MergeSums.zeros(pixels.size)
        terms = [one.terms for one in samples]
        sums.make_room(terms)
        sums.add(merge_passes(samples, terms), 0)
        sums.take_lowest(terms)
        tables = merge_tables(terms, self._model)
        place = self._factor_at(pixels)
        place = place * np.float32(self._terms[0].exposure / terms[0].exposure)
        finish_sums(sums, terms, tables.kept(), tables, place, 0)
        images[0][pixels], images[1][pixels], images[2][pixels] = sums.first, sums.second, sums.mask

    def _corrected(self, frame: Frame) -> Frame:
        """Return the frame with the settings that it was really taken with, as far as they were found."""
        calibration = self._calibration
        if calibration is None or calibration.found == FoundEffects():
            return frame
        settings = corrected_settings(frame.settings, calibration.found, self._situation.black.dn)
        return replace(frame, settings=settings)

    def _batch_size(self, frame: Frame) -> int:
        """Return how many frames leave sums and batch under three planes of 32 bits beyond the result, at least 1."""
        planes = (len(self._terms) - 1) // MANY + 1
        room = 3 * 4 - 4 - 2 * planes  # bytes per pixel, less Σx² and the bits of the frames used
        return max(1, (room - 1) // frame.dn.itemsize)

    def _take_in(self) -> None:
        """Add the frames of the batch to the sums and release them."""
        sums, passes = self._known_sums(), merge_passes(self._pending, self._terms)
        self._pending = []
        on_all_cores(self._known_shape(), lambda start, stop: sums.part(start, stop).add(passes, start))

    def _sample(self, frame: Frame) -> MergeSample:
        if len(self._terms) == MOST_FRAMES:
            raise MeasurementError(f"more than {MOST_FRAMES} frames; merge fewer, or average repeats first")
        known_f_number(self._calibration, frame.settings, self._situation.lens)
        if self._taps is not None:
            if not self._terms:
                self._taps = self._taps.with_darks(self._dark)
                self._dark = [self._taps.levelled(dark) for dark in self._dark]
            frame = self._taps.levelled(frame)
        few = some_lit_pixels(frame, None if self._taps is None else self._taps.lit)
        self._find_code_step(few)
        darkest = darkest_signal(few, self._situation.model)
        self._darkest = min(self._darkest, darkest if frame.masked_dn is None else 0.0)
        terms = frame_terms(
            frame.settings,
            self._situation,
            self._dark,
            through_lens=self._through_lens,
            masked_dn=frame.masked_dn,
            darkest=darkest,
        )
        terms = with_taps(terms, frame, self._situation.model)
        if self._terms and frame.settings.source_level != self._terms[0].settings.source_level:
            raise MeasurementError("the frames were taken at different source levels; merge those of one level")
        self._refuse_foreign_darks(frame, terms)
        self._terms.append(terms)
        model = self._situation.model
        table = None if model.linear and terms.dark.size == 1 else model.table(frame.settings).astype(np.float32)
        sample = MergeSample.of(np.ascontiguousarray(frame.dn).ravel(), terms, table, len(self._terms) - 1)
        self._show(sample)
        some = self._places = _pixels_of_light(frame.dn) if self._places is None else self._places
        low, top = sample.limits
        self._lit.append(np.where((sample.dn[some] >= low) & (sample.dn[some] < top), sample.signal_at(some), np.nan))
        return sample

    def _find_code_step(self, few: Frame) -> None:
        """Find the distance between codes from the pixels so far: a short exposure alone may hold one or two codes."""
        seen = [few, *(some_lit_pixels(one) for one in self._dark if not self._terms)]
        self._codes += [one.dn.ravel()[:: max(1, one.dn.size // _PIXELS_OF_CODES)].copy() for one in seen]
        model = with_found_code_step(self._situation.model, self._codes)
        self._situation = replace(self._situation, model=model)

    def _refuse_foreign_darks(self, frame: Frame, terms: FrameTerms) -> None:
        """Refuse dark frames that are brighter than a light frame."""
        if self._dark:
            model = self._situation.model
            middle = float(model.table(frame.settings)[int(np.median(frame.dn))])
            u_dark = math.hypot(terms.u_dark, terms.u_unstated)
            refuse_brighter_darks(frame.settings, middle, float(np.median(terms.dark)), u_dark, model)

    def _refuse_misfit(self, frame: Frame) -> None:
        if self._shape is None:
            self._situation = situation_of(self._situation.setup, frame)
            self._shape, self._taps = frame.shape, ReadOut.of(self._situation.setup, frame.shape)
        refuse_other_format(frame, self._shape, self._situation.model)

    def _known_shape(self) -> tuple[int, int]:
        if self._shape is None or not self._terms:
            raise MeasurementError("there is no frame with the shutter open; capture at least one")
        return self._shape

    def _known_sums(self) -> MergeSums:
        """Return the sums, made when they are needed first, with room for all frames so far."""
        if self._finished:
            raise MeasurementError("the result was returned already; start a new merge")
        height, width = self._known_shape()
        self._sums = self._sums or MergeSums.zeros(height * width)
        self._sums.make_room(self._terms)
        return self._sums

    def _factor(self, start: int, size: int) -> NDArray[np.float32]:
        """Return radiance per rate of a run of pixels; one number where it is the same everywhere."""
        return np.full(1, self._on_axis(), np.float32) if self._even() else self._factor_at(start + np.arange(size))

    def _factor_at(self, pixels: NDArray[np.intp]) -> NDArray[np.float32]:
        if self._even():
            return np.full(1, self._on_axis(), np.float32)
        shape = self._known_shape()
        rows, columns = np.divmod(pixels, shape[1])
        flat = flat_field_for(self._calibration, shape)
        place = relative_sensitivity(self._camera, self._situation.lens, flat, shape, columns, rows)
        if self._taps is not None and self._taps.gain is not None:
            place = place * self._taps.gain[self._taps.number[rows, columns]]
        return np.asarray(self._on_axis() / place, dtype=np.float32)

    def _even(self) -> bool:
        """Return whether the sensitivity is taken as the same everywhere."""
        if self._taps is not None and self._taps.gain is not None:
            return False
        if self._calibration is None:
            return True
        flat = flat_field_for(self._calibration, self._known_shape())
        return flat is None and falloff_known(self._camera, self._situation.lens) == "unknown"

    def _on_axis(self) -> float:
        """Return radiance per rate on the optical axis."""
        scale = self._situation.scale / self._terms[0].exposure
        if self._calibration is None:  # DN per s at the f-number of the first frame
            return scale * lens_factor_sr(self._situation.lens, self._terms[0].settings.f_number)
        there_c = self._calibration.scale.conditions.temperature_c
        return scale * temperature_factor(self._calibration.found, self._temperature_c(), there_c)

    def _temperature_c(self) -> float | None:
        """Return the mean temperature of the frames in °C; None where one does not state its own."""
        known = [terms.settings.temperature_c for terms in self._terms]
        stated = [one for one in known if one is not None]
        return sum(stated) / len(stated) if len(stated) == len(known) else None

    def _share(self, radiance: NDArray[np.float32], u_radiance: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Add to the uncertainty of every pixel what pixels of one level and place share; return what they share.

        Returns:
            None where they share nothing. What they share holds the frames' common dark level as well, which the
            uncertainty held already.
        """
        shared = np.zeros_like(radiance)
        levels = self._levels()
        doubts = (self._doubt_falloff, self._doubt_dark_current, self._doubt_taps)
        added = [doubt(radiance, shared) for doubt in doubts]
        if not any(added) and not levels.u_rel.any() and not levels.dark_u.any():
            return None
        flat = radiance.ravel(), u_radiance.ravel(), shared.ravel()

        def work(start: int, stop: int) -> None:
            values, u, own = (one[start:stop] for one in flat)
            levels.add(values, u, own, self._factor(start, stop - start))

        on_all_cores(self._known_shape(), work)
        return shared

    def _levels(self) -> AtLevels:
        """Return what curve, dark level, an offset of all exposures, and light that wanders bring to a pixel's level.

        A value is the mean of its frames: an offset δ changes it by δ times their mean 1/t, of which the calibration's
        own exposures share a part.
        """
        levels, calibration = merge_tables(self._terms, self._model).at_levels(), self._calibration
        u_rel = np.hypot(levels.u_rel, self._wander_rel * levels.root_sum_square)
        # One dark frame scatters as the lights do, and all lights of its exposure share it.
        single = [(one.settings.exposure_s, one.settings.gain_db) for one in self._terms if one.has_single_dark]
        for key in set(single):
            own = [(one.settings.exposure_s, one.settings.gain_db) == key for one in self._terms]
            u_rel = np.hypot(u_rel, self._wander_rel * levels.weights[own].sum(axis=0))
        if calibration is not None and self._brightest_off() >= _REPORTED_REL:
            inverse_per_s = 1.0 / np.array([one.settings.exposure_s for one in self._terms])
            apart_per_s = inverse_per_s @ levels.weights - calibration.scale.conditions.inverse_exposure_per_s
            u_rel = np.hypot(u_rel, calibration.uncertainties.exposure_u_s * apart_per_s)
        return replace(levels, u_rel=u_rel)

    def _doubt_falloff(self, radiance: NDArray[np.float32], shared: NDArray[np.float32]) -> bool:
        """Add to what pixels share that of a fall-off that is corrected and not measured; return whether there is."""
        calibration, lens = self._calibration, self._situation.lens
        if calibration is None:
            return False
        flat = calibration.flat_field
        known = "flat_field" if flat else falloff_known(self._camera, lens)
        stated, numbers = calibration.uncertainties, self._numbers()
        part = {
            "flat_field": flat_doubt(calibration, lens, numbers) if flat else 0.0,
            "cos4": stated.cos4_u_rel,
            "assumed": stated.falloff_u_rel,
        }.get(known, 0.0)
        if part == 0.0:
            return False
        rows, columns = np.ogrid[: radiance.shape[0], : radiance.shape[1]]
        place = relative_sensitivity(self._camera, lens, flat, (radiance.shape[0], radiance.shape[1]), columns, rows)
        same = known == "cos4" or is_as_scaled(calibration, lens, numbers)
        scaled = 1.0 / calibration.scale.conditions.sensitivity - 1.0
        lost = np.abs(1.0 - place) if flat else doubtful_loss(1.0 / place - 1.0, scaled, same=same)
        doubt = part * lost * radiance
        np.hypot(shared, doubt.astype(np.float32), out=shared)
        return True

    def _doubt_dark_current(self, radiance: NDArray[np.float32], shared: NDArray[np.float32]) -> bool:
        """Add to what pixels share that of a dark current that nothing states; return whether there is such a one.

        It is not noise: a pixel that it may explain is still above the noise. The tightest bound of all frames without
        dark frames of their exposure counts.
        """
        u_rate = min((one.u_unstated / one.exposure for one in self._terms if one.u_unstated > 0.0), default=0.0)
        if u_rate > 0.0:
            on_axis = self._on_axis() * self._terms[0].exposure
            np.hypot(shared, np.float32(u_rate * on_axis), out=shared)
        return u_rate > 0.0

    def _doubt_taps(self, radiance: NDArray[np.float32], shared: NDArray[np.float32]) -> bool:
        """Add to what pixels share that of the gains of their taps; return whether there are any."""
        if (taps := self._taps) is None or taps.gain is None:
            return False
        scaled_in = self._calibration.scale.conditions.tap if self._calibration else None
        u_rel = taps.u_rel(scaled_in).astype(np.float32)[taps.number]
        np.hypot(shared, u_rel * radiance, out=shared)
        return True

    def _wander(self) -> tuple[str, ...]:
        """Find by what frames differ as a whole beyond their noise, and return what to say of it.

        Of the pixels that a frame shows well the middle one counts: what moves through the picture is no change of the
        light.
        """
        calibration, model = self._calibration, self._model
        if calibration is None or not calibration.absolute or len(self._terms) < 2:
            return ()
        x, used, noise_rel = self._clear_pixels()
        shown = used.sum(axis=1) >= _LEAST_LIT
        terms = [one for one, here in zip(self._terms, shown, strict=True) if here]
        if len(terms) < 2:
            return ()
        signal = np.where(used, x, np.nan)[shown]
        amplitude, expected = _amplitudes(signal, np.array([one.exposure for one in terms]))
        middle = np.nanmedian(expected, axis=1)
        own = (math.pi / 2.0) * np.nanmean(np.where(used, noise_rel, np.nan)[shown], axis=1) / used[shown].sum(axis=1)
        curve = [model.curve_u_rel(value, one.settings) for value, one in zip(middle, terms, strict=True)]
        dark = np.array([math.hypot(one.u_dark, one.u_unstated) for one in terms]) / middle
        known = own + np.square(curve) + np.square(dark)
        self._wander_rel, evidence = fluctuation(amplitude, np.ones_like(amplitude), known, 1.0)
        doubts = doubted_gains(amplitude, known, [one.settings.gain_db for one in terms])
        if self._wander_rel < FLICKER_FLOOR_REL or not is_supported(evidence, FIVE_SIGMA):
            return doubts
        return (
            *doubts,
            f"the frames differ as a whole by {100 * self._wander_rel:.2g} % (standard deviation), which u holds",
        )

    def _clear_pixels(self) -> tuple[Array, NDArray[np.bool_], Array]:
        """Return x of some pixels, where a frame shows them clear of noise and of clipping, and their relative noise.

        Shape (frames, pixels). A pixel counts by what all frames show of it: a choice by its own noise would be biased.
        """
        exposures, x = np.array([[one.exposure] for one in self._terms]), np.array(self._lit)
        ends = np.array([[one.clips_at - CENSORED_SIGMA * one.sigma_clip] for one in self._terms])
        seen = np.isfinite(x)
        with np.errstate(invalid="ignore", divide="ignore"):
            expected = exposures * np.where(seen, x, 0.0).sum(axis=0) / np.where(seen, exposures, 0.0).sum(axis=0)
            noise = [self._model.variance(one, k.settings) for one, k in zip(expected, self._terms, strict=True)]
            noise_rel = np.array(noise) / expected**2
            used = seen & (noise_rel < _CLEAR_OF_NOISE**2) & (expected > 0.0) & (expected < ends)
        if x.shape[1] > _LEAST_LIT:  # in dim pixels the dark level hides the light of the bright ones
            clearest = np.partition(np.where(used, noise_rel, np.inf), _LEAST_LIT, axis=1)[:, _LEAST_LIT, None]
            used &= noise_rel <= _NEARLY_AS_CLEAR * clearest
        return x, used & (used.sum(axis=0) >= 2), noise_rel

    def _doubt_pattern(
        self, radiance: NDArray[np.float32], u_radiance: NDArray[np.float32]
    ) -> tuple[float, tuple[str, ...]]:
        """Add to the uncertainty of every pixel, in place, what pixels differ by.

        It is one error of all frames of a pixel, and another one of the next pixel. Only a calibration states it.

        Returns:
            What was added, relative to the values; and what to say if it is unknown.
        """
        u_rel = self._situation.stated.prnu_u_rel
        if self._calibration is None or not self._calibration.absolute:
            usual = f"pixels differ in responsivity: {100 * u_rel:.2g} % (k = 1) are usual"
            return 0.0, (f"{usual}, which u does not hold",) if u_rel else ()
        values, own = radiance.ravel(), u_radiance.ravel()

        def work(start: int, stop: int) -> None:
            for begin, end in blocks(start, stop, radiance.shape[1]):
                np.hypot(own[begin:end], np.float32(u_rel) * values[begin:end], out=own[begin:end])

        if u_rel:
            on_all_cores(self._known_shape(), work)
        return u_rel, ()

    def _of_taps(
        self, radiance: NDArray[np.float32], mask: NDArray[np.uint8]
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Mark what gathers no light, and return what to say of the taps.

        Returns:
            What was used of them; and what the uncertainty does not hold.
        """
        taps = self._taps
        if taps is None:
            return (), doubt_of_taps(radiance, self._dark)
        unlit = ~taps.lit
        radiance[unlit] = 0.0
        mask[unlit] = PixelMask.UNLIT | PixelMask.BELOW_NOISE
        gains_db = {terms.settings.gain_db for terms in self._terms}
        return taps.notes(has_darks=gains_db <= set(taps.by_darks_dn)), ()

    def _stray_light(self, radiance: NDArray[np.float32]) -> tuple[str, ...]:
        """Return what to say of the light that the lens spreads over the picture, which no pixel's u holds."""
        calibration = self._calibration
        share = math.hypot(calibration.uncertainties.glare_u, calibration.found.glare) if calibration else 0.0
        if calibration is None or share == 0.0:
            return ()
        lit = radiance if self._taps is None else radiance[self._taps.lit]
        light = share * float(np.mean(lit))  # pairwise: right to parts in a million
        unit = unit_text(RADIANCE_UNIT) if calibration.absolute else "of these relative values"
        return (f"no stray light: the lens may add {light:.2g} {unit} (k = 1) to every pixel, which u does not hold",)

    def _exposure_offset(self) -> tuple[str, ...]:
        """Return what the clock's offset may do to the brightest pixels, those of the shortest exposure."""
        off = self._brightest_off()
        if off < _REPORTED_REL:
            return ()
        shortest = min(terms.settings.exposure_s for terms in self._terms)
        text = f"the exposure of {shortest:.3g} s may be off: {100 * off:.2g} % (k = 1) of the brightest pixels"
        return (f"{text}, which u holds",)

    def _brightest_off(self) -> float:
        """Return the relative uncertainty that an offset of all exposures brings to the shortest alone."""
        if self._calibration is None:
            return 0.0
        shortest = min(terms.settings.exposure_s for terms in self._terms)
        there = self._calibration.scale.conditions.inverse_exposure_per_s
        return self._calibration.uncertainties.exposure_u_s * abs(1.0 / shortest - there)

    def _bend(self) -> tuple[str, ...]:
        """Return how far the response bends as it was found, which a map keeps."""
        found = self._calibration.found if self._calibration else FoundEffects()
        full = self._situation.model.full_scale_dn * self._situation.model.electrons_per_unit / found.well_e
        share = abs(found.well_a2 * full + found.well_a3 * full**2)
        if share < _REPORTED_REL:
            return ()
        return (
            f"the response bends by {100 * share:.2g} % at full scale, as found: the map keeps it, u does not hold it",
        )

    def _black(self) -> tuple[str, ...]:
        """Return how bright pixels without light may be where nothing states it: as bright as the darkest of all."""
        calibration, camera = self._calibration, self._camera
        unstated = camera.black_level_dn is None and not self._dark and not (calibration and calibration.absolute)
        unstated &= all(terms.settings.black_level_dn is None for terms in self._terms)
        if not unstated or not self._situation.model.linear or self._darkest < _ROUNDED_DN:
            return ()
        return (
            "no black level is stated and no dark frame was taken: without light the numbers may be about "
            f"{self._darkest:.2g} DN, as in the darkest pixels, which u does not hold",
        )

    def _fall_off(self) -> tuple[str, ...]:
        """Return what the lens may lose towards the corners, where nothing says how much."""
        flat = None if self._calibration is None else self._calibration.flat_field
        if flat is not None or falloff_known(self._camera, self._situation.lens) != "unknown":
            return ()
        return (
            "the lens's fall-off is not corrected (focal length or pixel size unknown, no flat field): at the corner "
            f"an ordinary lens loses {100 * UNKNOWN_FALLOFF:.2g} %, a wide one more, which u does not hold",
        )

    def _light(self) -> tuple[str, ...]:
        """Return how far pixels may be off whose light is of another spectrum, which a map knows of none."""
        calibration = self._calibration
        if calibration is None or not calibration.absolute:
            return ()
        off = unstated_u_rel(calibration, calibration.uncertainties)
        note = f"light of another spectrum than {calibration.spectrum} may be off: {100 * off:.2g} % (k = 1)"
        return (f"{note} over {', '.join(KINDS)}, which u does not hold",) if off >= _REPORTED_REL else ()

    def _without_dark_signal(self) -> tuple[list[tuple[int, int]], tuple[str, ...]]:
        """Return pixels (x, y) whose dark signal no dark frame shows, because they fill up, and what to say of them."""
        places = np.unique(np.concatenate([one.unknown for one in self._terms]))
        if not places.size:
            return [], ()
        note = (
            f"{places.size} pixels fill up in the dark frames: their dark signal is unknown, and neighbours fill them"
        )
        width = self._known_shape()[1]
        return [(int(place % width), int(place // width)) for place in places], (note,)

    def _numbers(self) -> set[float | None]:
        """Return the f-numbers of the frames."""
        return {terms.settings.f_number or self._situation.lens.f_number for terms in self._terms}

    def _map(self, flat: Images) -> RadianceMap:
        shape, calibration = self._known_shape(), self._calibration
        images = flat[0].reshape(shape), flat[1].reshape(shape), flat[2].reshape(shape)
        unknown, of_unknown = self._without_dark_signal()
        repair_defects(*images, (*(calibration.defects if calibration else ()), *unknown))
        white = white_level_notes(terms.settings.white_level for terms in self._terms)
        used, doubtful = self._of_taps(images[0], images[2])
        u_rel_pattern, of_pattern = self._doubt_pattern(*images[:2])
        of_wander = self._wander()
        shared = self._share(*images[:2])
        of_time = self._exposure_offset()
        of_light = self._stray_light(images[0])
        not_in_u = (*of_light, *self._black(), *self._bend(), *self._light(), *self._fall_off(), *doubtful)
        not_in_u += of_pattern
        situation, settings = self._situation, [terms.settings for terms in self._terms]
        of_frames = frame_u_rel(situation.setup, situation.lens, self._numbers(), settings)
        return RadianceMap(
            *images,
            unit=RADIANCE_UNIT if calibration is not None and calibration.absolute else RELATIVE_UNIT,
            u_rel_common=math.hypot(common_u_rel(situation), of_frames),
            exposures_s=tuple(sorted({terms.settings.exposure_s for terms in self._terms})),
            provenance=Provenance(
                "maximum-likelihood merge",
                assumptions=(
                    *self._situation.assumptions,
                    *white,
                    *self._of_noise,
                    *self._copies.notes,
                    *used,
                    *of_unknown,
                    *of_wander,
                    *of_time,
                    *not_in_u,
                ),
                parameters={
                    "frames": len(self._terms),
                    "dark_frames": len(self._dark),
                    "saturated_dn": sorted({terms.high_dn for terms in self._terms}),
                    "origin": self._origin(),
                    **self._displacement,
                },
            ),
            not_in_u=not_in_u,
            u_shared=shared,
            u_rel_pattern=u_rel_pattern,
        )

    def _origin(self) -> dict[str, str]:
        """Return in words when and with what the frames were taken; "" where that is not stated."""
        setup, calibration = self._situation.setup, self._calibration
        settings = [terms.settings for terms in self._terms]
        return {
            "taken": span_of(one.timestamp_s for one in settings)
            or ("" if setup.taken is None else moment(setup.taken.isoformat())),
            "camera": setup.camera.name,
            "lens": setup.lens.in_words(one.f_number for one in settings),
            "calibration": ""
            if calibration is None
            else f"{calibration.scale.reference or 'as stated'}, {moment(calibration.created)}",
        }

"""A bracket merged into radiance per pixel: the maximum-likelihood value, its standard uncertainty, and a mask."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis import merge_kernels
from radiometer.analysis.merge_defects import repair_defects
from radiometer.analysis.merge_finish import FIRST_POWER, finish_linear
from radiometer.analysis.merge_finish_curved import finish_curved
from radiometer.analysis.merge_frames import FrameTerms, frame_terms
from radiometer.analysis.merge_lens import lens_factor_sr, relative_sensitivity
from radiometer.analysis.merge_situation import Situation, common_u_rel, flat_field_for, situation_of
from radiometer.analysis.merge_tables import MergeTables, merge_tables
from radiometer.data import Bracket, Calibration, CameraDescription, Frame, LensDescription, Provenance, RadianceMap
from radiometer.data.reading import RADIANCE_UNIT, RELATIVE_UNIT
from radiometer.errors import MeasurementError

MOST_FRAMES = 64
_BLOCK_PIXELS = 1 << 15  # sums of a block stay in a core's second-level cache


def merge(
    frames: Iterable[Frame],
    camera: CameraDescription,
    lens: LensDescription,
    calibration: Calibration | None = None,
) -> RadianceMap:
    """Return radiance in W·sr⁻¹·m⁻² (relative without a calibration) and its standard uncertainty for every pixel.

    A Bracket is merged block by block; any other iterable is taken one frame at a time, each released before the
    next is asked for, with dark frames before light ones.

    Args:
        frames: Frames of one unmoving scene, 1 to 64 light ones, in any order of exposure.
        camera: The camera in use.
        lens: The lens in use.
        calibration: The camera's calibration; None gives relative values.

    Raises:
        CalibrationError: If the calibration is of another camera or lens.
        MeasurementError: If there is no light frame, there are more than 64, or frames do not belong together.
    """
    merging = StreamingMerge(camera, lens, calibration)
    if isinstance(frames, Bracket):
        return merging.merge_bracket(frames)
    for frame in frames:
        merging.add(frame)
    return merging.result()


class StreamingMerge:
    """Merges frames as they arrive; holds four numbers and a few bits per pixel, and no frame.

    Args:
        camera: The camera in use.
        lens: The lens in use.
        calibration: The camera's calibration; None gives relative values.

    Raises:
        CalibrationError: If the calibration is of another camera or lens.
    """

    def __init__(self, camera: CameraDescription, lens: LensDescription, calibration: Calibration | None) -> None:
        self._situation = situation_of(calibration, camera, lens)
        self._calibration, self._camera = calibration, camera
        self._through_lens = calibration is None or calibration.scale.f_number is not None
        self._terms: list[FrameTerms] = []
        self._dark: list[Frame] = []
        self._shape: tuple[int, int] | None = None
        self._sums: list[NDArray[np.float32]] = []
        self._bits: NDArray[Any] = np.zeros(0, np.uint32)
        self._mask: NDArray[np.uint8] = np.zeros(0, np.uint8)

    def add(self, frame: Frame) -> None:
        """Take a frame in; it may be released afterwards.

        Raises:
            MeasurementError: If it does not belong to the frames before it.
        """
        self._refuse_misfit(frame)
        if frame.settings.is_dark:
            if self._terms:
                raise MeasurementError("a dark frame came after light ones; give dark frames first")
            self._dark.append(frame)
            return
        terms = self._new_terms(frame)
        if not self._sums:
            size = frame.dn.size
            self._sums = [np.zeros(size, np.float32) for _ in range(3)]
            self._bits, self._mask = np.zeros(size, np.uint32), np.zeros(size, np.uint8)
        if len(self._terms) > 32 and self._bits.dtype == np.uint32:
            self._bits = self._bits.astype(np.uint64)
        dn, table = np.ascontiguousarray(frame.dn).ravel(), _table(self._situation, terms)
        index, linear = len(self._terms) - 1, self._situation.model.linear
        _for_blocks(
            dn.size,
            frame.shape[1],
            lambda start, stop: _accumulate(
                dn[start:stop],
                table,
                terms,
                self._terms[0].exposure,
                index,
                start,
                self._view(start, stop),
                linear=linear,
            ),
        )

    def result(self) -> RadianceMap:
        """Return the radiance map of the frames taken in; nothing can be added afterwards.

        Raises:
            MeasurementError: If there was no light frame.
        """
        tables = self._tables()
        first, second, squares = self._sums
        shape = self._known_shape()
        _for_blocks(
            first.size,
            shape[1],
            lambda start, stop: self._finish(
                tables, start, self._view(start, stop), first[start:stop], second[start:stop]
            ),
        )
        self._sums = []
        del squares
        return self._map(first, second, self._mask)

    def merge_bracket(self, bracket: Bracket) -> RadianceMap:
        """Return the radiance map of a bracket in memory, block by block."""
        for dark in bracket.dark_frames:
            self.add(dark)
        flat, tables_of = [], []
        for frame in bracket:
            self._refuse_misfit(frame)
            terms = self._new_terms(frame)
            flat.append(np.ascontiguousarray(frame.dn).ravel())
            tables_of.append(_table(self._situation, terms))
        tables, size = self._tables(), flat[0].size
        radiance, u_radiance = np.empty(size, np.float32), np.empty(size, np.float32)
        mask = np.zeros(size, np.uint8)
        linear = self._situation.model.linear
        kind = np.uint32 if len(flat) <= 32 else np.uint64

        def block(start: int, stop: int) -> None:
            sums = np.zeros((3, stop - start), np.float32)
            view = (sums[0], sums[1], sums[2], np.zeros(stop - start, kind), mask[start:stop])
            for index, (dn, terms, table) in enumerate(zip(flat, self._terms, tables_of, strict=True)):
                _accumulate(dn[start:stop], table, terms, self._terms[0].exposure, index, start, view, linear=linear)
            self._finish(tables, start, view, radiance[start:stop], u_radiance[start:stop])

        _for_blocks(size, bracket.shape[1], block)
        return self._map(radiance, u_radiance, mask)

    def _new_terms(self, frame: Frame) -> FrameTerms:
        if len(self._terms) == MOST_FRAMES:
            raise MeasurementError(f"more than {MOST_FRAMES} frames; merge fewer, or average repeats first")
        terms = frame_terms(frame.settings, self._situation, self._dark, through_lens=self._through_lens)
        if self._terms and frame.settings.source_level != self._terms[0].settings.source_level:
            raise MeasurementError("the frames were taken at different source levels; merge those of one level")
        self._terms.append(terms)
        return terms

    def _refuse_misfit(self, frame: Frame) -> None:
        self._shape = self._shape or frame.shape
        if frame.shape != self._shape:
            raise MeasurementError(
                f"frames differ in size ({frame.shape[1]} × {frame.shape[0]} beside "
                f"{self._shape[1]} × {self._shape[0]} pixels)"
            )
        if frame.full_scale_dn != self._situation.model.full_scale_dn:
            raise MeasurementError(
                f"a frame has {frame.bit_depth} bits per pixel, the camera's description says full scale "
                f"{self._situation.model.full_scale_dn}; use the description of this pixel format"
            )

    def _known_shape(self) -> tuple[int, int]:
        if self._shape is None or not self._terms:
            raise MeasurementError("there is no frame with the shutter open; capture at least one")
        return self._shape

    def _view(self, start: int, stop: int) -> tuple[NDArray[Any], ...]:
        a, b, c = self._sums
        return a[start:stop], b[start:stop], c[start:stop], self._bits[start:stop], self._mask[start:stop]

    def _tables(self) -> MergeTables:
        self._known_shape()
        return merge_tables(self._terms, self._situation.model)

    def _finish(
        self,
        tables: MergeTables,
        start: int,
        view: tuple[NDArray[Any], ...],
        radiance: NDArray[np.float32],
        u_radiance: NDArray[np.float32],
    ) -> None:
        factor = self._factor(start, radiance.size)
        if tables.curved is None:
            finish_linear(*view, *tables.common, factor, radiance, u_radiance)
        else:
            finish_curved(*view, *tables.common, tables.gains, *tables.curved, factor, radiance, u_radiance)

    def _factor(self, start: int, size: int) -> NDArray[np.float32]:
        """Return radiance per rate of a block of whole rows; one number where it is the same everywhere."""
        shape, calibration = self._known_shape(), self._calibration
        scale = self._situation.scale / self._terms[0].exposure
        if calibration is None:  # DN per s at the f-number of the first frame
            scale *= lens_factor_sr(self._situation.lens, self._terms[0].settings.f_number)
        flat = flat_field_for(calibration, shape)
        if calibration is None or (flat is None and self._situation.lens.vignetting == "none"):
            return np.full(1, scale, np.float32)
        rows = np.arange(start // shape[1], (start + size) // shape[1])[:, None]
        columns = np.arange(shape[1])[None, :]
        place = relative_sensitivity(self._camera, self._situation.lens, flat, shape, columns, rows)
        return np.asarray((scale / place).ravel(), dtype=np.float32)

    def _map(
        self, radiance: NDArray[np.float32], u_radiance: NDArray[np.float32], mask: NDArray[np.uint8]
    ) -> RadianceMap:
        shape, calibration = self._known_shape(), self._calibration
        images = radiance.reshape(shape), u_radiance.reshape(shape), mask.reshape(shape)
        repair_defects(*images, calibration.defects if calibration else ())
        numbers = {terms.settings.f_number or self._situation.lens.f_number for terms in self._terms}
        return RadianceMap(
            *images,
            unit=RADIANCE_UNIT if calibration is not None and calibration.absolute else RELATIVE_UNIT,
            u_rel_common=common_u_rel(self._situation, calibration, numbers),
            exposures_s=tuple(sorted({terms.settings.exposure_s for terms in self._terms})),
            provenance=Provenance(
                "maximum-likelihood merge",
                assumptions=self._situation.assumptions,
                parameters={"frames": len(self._terms), "dark_frames": len(self._dark)},
            ),
        )


def _table(situation: Situation, terms: FrameTerms) -> NDArray[np.float32]:
    return situation.model.table(terms.settings).astype(np.float32)


def _accumulate(
    dn: NDArray[Any],
    table: NDArray[np.float32],
    terms: FrameTerms,
    reference: float,
    index: int,
    start: int,
    view: tuple[NDArray[Any], ...],
    *,
    linear: bool,
) -> None:
    number, bits = dn.dtype.type, view[3].dtype.type
    low, high = number(terms.low_dn), number(min(terms.high_dn, np.iinfo(dn.dtype).max))
    relative, bit = terms.exposure / reference, bits(1 << index)
    exposure, weight = np.float32(relative), np.float32(relative**FIRST_POWER)
    dark = terms.dark if terms.dark.size == 1 else terms.dark[start : start + dn.size]
    if linear and dark.size == 1:
        offset, inverse = np.float32(terms.black_dn + terms.gain * float(dark[0])), np.float32(1.0 / terms.gain)
        merge_kernels.add_linear(dn, offset, inverse, low, high, exposure, weight, bit, *view)
    else:
        merge_kernels.add_table(dn, table, dark, low, high, exposure, weight, bit, *view)


def _for_blocks(size: int, width: int, work: Any) -> None:
    """Call work(start, stop) for blocks of whole rows, on all cores."""
    rows = max(1, _BLOCK_PIXELS // width)
    bounds = list(_blocks(size, rows * width))
    with ThreadPoolExecutor(max_workers=max(1, os.cpu_count() or 1)) as pool:
        list(pool.map(lambda pair: work(*pair), bounds))


def _blocks(size: int, step: int) -> Iterator[tuple[int, int]]:
    for start in range(0, size, step):
        yield start, min(start + step, size)

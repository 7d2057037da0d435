"""A bracket merged into radiance per pixel: the maximum-likelihood value, its standard uncertainty, and a mask."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge_defects import repair_defects
from radiometer.analysis.merge_finish import finish_linear
from radiometer.analysis.merge_finish_curved import finish_curved
from radiometer.analysis.merge_frames import FrameTerms, frame_terms
from radiometer.analysis.merge_lens import lens_factor_sr, relative_sensitivity
from radiometer.analysis.merge_situation import common_u_rel, flat_field_for, situation_of
from radiometer.analysis.merge_sums import FRAMES_PER_PLANE, MergeSample, MergeSums
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

    A Bracket is merged block by block; any other iterable is taken one frame at a time, two frames (five of 8 bits)
    being held at most, with dark frames before light ones.

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
    """Merges frames as they arrive; holds sums per pixel and the frames of a small batch.

    A batch goes through the sums in one pass over the memory, which is what takes the time. It is as large as leaves
    the whole under three planes of 32 bits beyond the result, up to 32 frames (four planes for more).

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
        self._sums: MergeSums | None = None
        self._pending: list[MergeSample] = []

    def add(self, frame: Frame) -> None:
        """Take a frame in; its pixels are read now or with one of the next frames, and must stay as they are.

        Raises:
            MeasurementError: If it does not belong to the frames before it.
        """
        self._refuse_misfit(frame)
        if frame.settings.is_dark:
            if self._terms:
                raise MeasurementError("a dark frame came after light ones; give dark frames first")
            self._dark.append(frame)
            return
        self._pending.append(self._sample(frame))
        if len(self._pending) >= self._batch_size(frame) or len(self._terms) % FRAMES_PER_PLANE == 0:
            self._take_in()

    def result(self) -> RadianceMap:
        """Return the radiance map of the frames taken in; nothing can be added afterwards.

        Raises:
            MeasurementError: If there was no light frame.
        """
        tables, shape = self._tables(), self._known_shape()
        if self._pending:
            self._take_in()
        sums, self._sums = self._known_sums(), None
        _for_blocks(
            sums.first.size,
            shape[1],
            lambda start, stop: self._finish(
                tables, start, sums.part(start, stop), sums.first[start:stop], sums.second[start:stop]
            ),
        )
        return self._map(sums.first, sums.second, sums.mask)

    def merge_bracket(self, bracket: Bracket) -> RadianceMap:
        """Return the radiance map of a bracket in memory, block by block."""
        for dark in bracket.dark_frames:
            self.add(dark)
        samples = []
        for frame in bracket:
            self._refuse_misfit(frame)
            samples.append(self._sample(frame))
        tables, size = self._tables(), samples[0].dn.size
        radiance, u_radiance = np.empty(size, np.float32), np.empty(size, np.float32)
        mask = np.zeros(size, np.uint8)

        def block(start: int, stop: int) -> None:
            sums = MergeSums.zeros(stop - start, len(samples))
            sums.add(samples, start, self._terms[0].exposure)
            self._finish(tables, start, sums, radiance[start:stop], u_radiance[start:stop])
            mask[start:stop] = sums.mask

        _for_blocks(size, bracket.shape[1], block)
        return self._map(radiance, u_radiance, mask)

    def _batch_size(self, frame: Frame) -> int:
        """Return how many frames leave sums and batch under three planes of 32 bits beyond the result, at least 1."""
        planes = (len(self._terms) - 1) // FRAMES_PER_PLANE + 1
        room = 3 * 4 - 4 - 2 * planes  # bytes per pixel, less Σx² and the bits of the frames used
        return max(1, (room - 1) // frame.dn.itemsize)

    def _take_in(self) -> None:
        """Add the frames of the batch to the sums and release them."""
        sums = self._sums = self._sums or MergeSums.zeros(self._pending[0].dn.size, 0)
        sums.make_room(len(self._terms))
        batch, self._pending = self._pending, []
        reference = self._terms[0].exposure
        _for_blocks(
            sums.first.size,
            self._known_shape()[1],
            lambda start, stop: sums.part(start, stop).add(batch, start, reference),
        )

    def _sample(self, frame: Frame) -> MergeSample:
        if len(self._terms) == MOST_FRAMES:
            raise MeasurementError(f"more than {MOST_FRAMES} frames; merge fewer, or average repeats first")
        terms = frame_terms(frame.settings, self._situation, self._dark, through_lens=self._through_lens)
        if self._terms and frame.settings.source_level != self._terms[0].settings.source_level:
            raise MeasurementError("the frames were taken at different source levels; merge those of one level")
        self._terms.append(terms)
        model = self._situation.model
        table = None if model.linear and terms.dark.size == 1 else model.table(frame.settings).astype(np.float32)
        return MergeSample(np.ascontiguousarray(frame.dn).ravel(), terms, table, len(self._terms) - 1)

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

    def _known_sums(self) -> MergeSums:
        if self._sums is None:
            raise MeasurementError("the result was handed out already; start a new merge")
        return self._sums

    def _tables(self) -> MergeTables:
        self._known_shape()
        return merge_tables(self._terms, self._situation.model)

    def _finish(
        self,
        tables: MergeTables,
        start: int,
        sums: MergeSums,
        radiance: NDArray[np.float32],
        u_radiance: NDArray[np.float32],
    ) -> None:
        factor = self._factor(start, radiance.size)
        view = (sums.first, sums.second, sums.squares, sums.patterns(), sums.mask)
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


def _for_blocks(size: int, width: int, work: Any) -> None:
    """Call work(start, stop) for blocks of whole rows, on all cores."""
    rows = max(1, _BLOCK_PIXELS // width)
    bounds = list(_blocks(size, rows * width))
    with ThreadPoolExecutor(max_workers=max(1, os.cpu_count() or 1)) as pool:
        list(pool.map(lambda pair: work(*pair), bounds))


def _blocks(size: int, step: int) -> Iterator[tuple[int, int]]:
    for start in range(0, size, step):
        yield start, min(start + step, size)

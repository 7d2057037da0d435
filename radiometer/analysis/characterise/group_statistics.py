"""Means and variances of the frames at one setting; spatial variance split into rows, columns and pixels."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.signal.rounding import rounding_u_of_mean
from radiometer.data import FrameSettings, Patch
from radiometer.data.frame import DigitalNumbers
from radiometer.errors import MeasurementError
from radiometer.statistics.scale import typical_pixels

SAME_TEMPERATURE_K: Final = 1.5  # dark current doubles in 5 to 8 K: it then changes by a fifth at most
_BLOCK_PX: Final = 32  # longer than most tracks of a cosmic ray
_FEWEST_BLOCKS: Final = 30  # fewer do not show their scatter to an eighth


@dataclass(frozen=True, slots=True)
class SpatialSplit:
    """Variances of what rows, columns and single pixels add to a mean picture, in DN², with standard uncertainties.

    A variance that chance makes negative stays so: it is an estimate without bias.
    """

    row_dn2: float
    column_dn2: float
    pixel_dn2: float
    u_row_dn2: float
    u_column_dn2: float
    u_pixel_dn2: float
    u_dn2: float = 0.0  # of their sum


@dataclass(frozen=True, slots=True)
class NoiseLeft:
    """Temporal variances that are left in a frame average, in DN²: of row means, of column means, of the residual.

    A converter whose rows share noise leaves more in row means than its pixels' noise alone would. Its pixels are then
    not as many independent values, and a variance is known no better than by its rows.
    """

    row_means_dn2: float
    column_means_dn2: float
    rest_dn2: float
    u_row_means_dn2: float = 0.0  # standard uncertainties
    u_column_means_dn2: float = 0.0
    u_rest_dn2: float = 0.0
    u_dn2: float = 0.0  # of their sum

    @classmethod
    def of(
        cls, pixel_dn2: float, row_means_dn2: float, column_means_dn2: float, frames: int, shape: tuple[int, ...]
    ) -> NoiseLeft:
        """Return it for L frames, from the temporal variances of a pixel, a row's mean and a column's mean."""
        rows, columns = shape[0], shape[1]
        rest = (pixel_dn2 - row_means_dn2 - column_means_dn2) / (1 - 1 / rows - 1 / columns + 1 / (rows * columns))
        left = row_means_dn2 / frames, column_means_dn2 / frames, max(rest, 0.0) / frames
        return cls(*left, *_u_of_parts(*left, shape, max(frames - 1, 1)))


def _u_of_parts(
    of_rows: float, of_columns: float, rest: float, shape: tuple[int, ...], repeats: int = 1
) -> tuple[float, float, float, float]:
    """Return standard uncertainties of variances of row means, column means, the residual of (M, N) pixels, and all."""
    rows, columns = shape[0] - 1, shape[1] - 1
    freedom = (rows * repeats, columns * repeats, rows * columns * repeats)
    parts = zip((of_rows, of_columns, rest), freedom, strict=True)
    u_rows, u_columns, u_rest = (variance * math.sqrt(2.0 / each) for variance, each in parts)
    # Of the residual, normalised by its degrees of freedom, a variance over all pixels holds this share.
    share = rows * columns / (shape[0] * shape[1])
    return u_rows, u_columns, u_rest, math.hypot(u_rows, u_columns, share * u_rest)


def split_spatial_variance(average: NDArray[np.float64], noise: NoiseLeft) -> SpatialSplit:
    """Return the variances of rows, columns and pixels of a frame average of shape (M, N), in DN².

    With y = μ + row_m + column_n + pixel_mn the variance of the column averages is s_col² + s_pix²/M, that of the row
    averages s_row² + s_pix²/N. The residual after both are subtracted has (M − 1)(N − 1) degrees of freedom. From
    each the temporal noise of the same kind is subtracted.

    Args:
        average: Mean picture of at least 2 × 2 pixels.

    Source: EMVA Standard 1288, release 4.0, section 8.2, solved with the degrees of freedom of an analysis of variance
    (the standard's factors differ from it by 1/(MN)).
    """
    rows, columns = average.shape
    centred = average - average.mean()
    row_means, column_means = centred.mean(axis=1), centred.mean(axis=0)
    rest = centred - row_means[:, None] - column_means[None, :]
    freedom = (rows - 1) * (columns - 1)
    measured = float(np.sum(rest * rest)) / freedom
    pixel = measured - noise.rest_dn2
    of_rows, of_columns = float(np.var(row_means, ddof=1)), float(np.var(column_means, ddof=1))
    u_rows, u_columns, u_pixel, u_whole = _u_of_parts(of_rows, of_columns, measured, average.shape)
    return SpatialSplit(
        row_dn2=of_rows - pixel / columns - noise.row_means_dn2,
        column_dn2=of_columns - pixel / rows - noise.column_means_dn2,
        pixel_dn2=pixel,
        u_row_dn2=math.hypot(u_rows, noise.u_row_means_dn2),
        u_column_dn2=math.hypot(u_columns, noise.u_column_means_dn2),
        u_pixel_dn2=math.hypot(u_pixel, noise.u_rest_dn2),
        u_dn2=math.hypot(u_whole, noise.u_dn2),
    )


@dataclass(frozen=True, slots=True)
class GroupStatistics:
    """What L frames of one setting say about one region of N pixels.

    Of one frame alone the temporal variance is 0 and means nothing, and the spatial variance holds the noise.

    Source: EMVA Standard 1288, release 4.0, sections 6.5 and 8.1.
    """

    settings: FrameSettings  # the setting
    frames: int  # L, at least 1
    pixels: int  # N
    mean_dn: float  # μ_y, mean over pixels and frames in DN
    variance_dn2: float  # σ_y², temporal variance of a pixel in DN²; changes common to a frame are taken out
    # s_y², variance of the frame average over the region in DN², temporal noise taken out; negative where chance has it
    # so
    spatial_variance_dn2: float
    clipped_share: float  # share of pixels at full scale
    photons: float | None = None  # mean photons per pixel; None where unknown
    region: int = 0  # number of the region
    # Spatial variance by rows, columns and pixels; None where the pictures are not known
    split: SpatialSplit | None = None
    typical_dn: float | None = None  # mean without hot pixels in DN; None where the pictures are not known
    # Spatial variance as above without hot pixels; None where the pictures are not known
    typical_variance_dn2: float | None = None
    frame_variance_dn2: float = 0.0  # variance of the frames' means in DN²; 0 where there is one frame
    floor_share: float = 0.0  # share of pixels at 0
    # Standard error of the temporal variance in DN² by what rows and columns share, and of dark frames by its scatter
    # between blocks of pixels: a track of a cosmic ray, or pixels that blink, scatter by more than normal noise.
    u_of_shared_dn2: float = 0.0

    @property
    def has_noise(self) -> bool:
        """Return whether there are frames enough for a temporal variance."""
        return self.frames > 1

    @property
    def u_mean_dn(self) -> float:
        """Return the standard uncertainty of the mean due to temporal noise in DN."""
        noise = self.variance_dn2 if self.has_noise else self.spatial_variance_dn2
        return math.sqrt(max(noise, 1 / 12) / (self.frames * self.pixels))

    @property
    def ordinary_variance_dn2(self) -> float:
        """Return the variance between pixels in DN² without hot ones, which do not show where the others are."""
        return self.spatial_variance_dn2 if self.typical_variance_dn2 is None else self.typical_variance_dn2

    def u_of_rounding_dn(self, step_dn: int) -> float:
        """Return what rounding to codes of a distance in DN leaves uncertain in the mean, a standard uncertainty in DN.

        Hot pixels spread over other codes than the rest, and do not show where between two codes these are.
        """
        return rounding_u_of_mean(max(self.variance_dn2 + self.ordinary_variance_dn2, 0.0), step_dn)

    @property
    def degrees_of_freedom(self) -> float:
        """Return the degrees of freedom of the temporal variance."""
        return float(max((self.frames - 1) * (self.pixels - 1), 1))

    @property
    def u_variance_dn2(self) -> float:
        """Return the standard uncertainty of the temporal variance in DN²: of independent pixels, or of others."""
        return max(self.variance_dn2 * math.sqrt(2.0 / self.degrees_of_freedom), self.u_of_shared_dn2)

    @property
    def u_spatial_variance_dn2(self) -> float:
        """Return the standard uncertainty of the spatial variance in DN²: of independent pixels, or of others."""
        measured = max(self.spatial_variance_dn2, 0.0) + self.variance_dn2 / self.frames
        u_measured = measured * math.sqrt(2.0 / max(self.pixels - 1, 1))
        return max(math.hypot(u_measured, self.u_variance_dn2 / self.frames), self.split.u_dn2 if self.split else 0.0)


def mean_temperature_c(groups: Iterable[GroupStatistics]) -> float | None:
    """Return the mean sensor temperature of groups in °C; None where none states it."""
    known = [one.settings.temperature_c for one in groups if one.settings.temperature_c is not None]
    return float(np.mean(known)) if known else None


def dark_points(dark: Iterable[GroupStatistics]) -> tuple[tuple[float, float, float, float | None], ...]:
    """Return (exposure in s, mean in DN, variance in DN², temperature in °C) of dark groups."""
    return tuple((d.settings.exposure_s, d.mean_dn, d.variance_dn2, d.settings.temperature_c) for d in dark)


def statistics_of_group(
    frames: Iterable[DigitalNumbers],
    settings: FrameSettings,
    regions: tuple[Patch | None, ...],
    saturated_dn: int,
    photons: float | None = None,
) -> list[GroupStatistics]:
    """Return the statistics of every region of the frames of one setting; frames are held one at a time.

    Args:
        frames: Frames of one size; one alone has no temporal variance.
        regions: Where to look; None for the whole frame.
        saturated_dn: Digital number from which pixels are saturated.

    Raises:
        MeasurementError: If there is no frame or a region is outside them.
    """
    sums: list[_Sums] = []
    for dn in frames:
        if not sums:
            sums = [_Sums(_cut(dn, region).shape) for region in regions]
        for region, entry in zip(regions, sums, strict=True):
            entry.add(_cut(dn, region), saturated_dn)
    if not sums:
        raise MeasurementError(f"there is no frame at exposure {settings.exposure_s:g} s")
    return [entry.statistics(settings, photons, number) for number, entry in enumerate(sums)]


class _Sums:
    """Running sums over the frames of one region."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.count = 0
        self._sum = np.zeros(shape)
        self._squares = np.zeros(shape)
        self._means: list[float] = []
        self._row_means: list[NDArray[np.float64]] = []
        self._column_means: list[NDArray[np.float64]] = []
        self._clipped = 0
        self._at_zero = 0

    def add(self, dn: DigitalNumbers, saturated_dn: int) -> None:
        values = dn.astype(np.float64)
        self.count += 1
        self._sum += values
        self._squares += values * values
        self._means.append(float(values.mean()))
        self._row_means.append(values.mean(axis=1))
        self._column_means.append(values.mean(axis=0))
        self._clipped += int(np.count_nonzero(dn >= saturated_dn))
        self._at_zero += values.size - int(np.count_nonzero(dn))

    def statistics(self, settings: FrameSettings, photons: float | None, region: int) -> GroupStatistics:
        count, pixels = self.count, self._sum.size
        average: NDArray[np.float64] = self._sum / count
        temporal = common = u_of_blocks = 0.0
        if count > 1:
            own = (self._squares - self._sum * average) / (count - 1)
            within, u_of_blocks = float(np.mean(own)), _error_by_blocks(own) if settings.is_dark else 0.0
            common = float(np.var(self._means, ddof=1))
            temporal = max((within - common) * pixels / max(pixels - 1, 1), 0.0)
        spatial = float(np.var(average, ddof=1)) - temporal / count if pixels > 1 else 0.0
        left = self._noise_left(temporal) if min(average.shape) > 1 else None
        typical = average[typical_pixels(average)]
        return GroupStatistics(
            settings=settings,
            frames=count,
            pixels=pixels,
            mean_dn=float(np.mean(self._means)),
            variance_dn2=temporal,
            spatial_variance_dn2=spatial,
            clipped_share=self._clipped / (count * pixels),
            photons=photons,
            region=region,
            split=split_spatial_variance(average, left) if left else None,
            typical_dn=float(np.mean(typical)),
            typical_variance_dn2=float(np.var(typical)) - temporal / count,
            frame_variance_dn2=common,
            floor_share=self._at_zero / (count * pixels),
            u_of_shared_dn2=max(u_of_blocks, count * left.u_dn2 if left else 0.0),
        )

    def _noise_left(self, temporal: float) -> NoiseLeft:
        shape = self._sum.shape
        if self.count < 2:
            return NoiseLeft(0.0, 0.0, 0.0)
        rows, columns = (
            float(np.mean(np.var(np.stack(means) - np.array(self._means)[:, None], axis=0, ddof=1)))
            for means in (self._row_means, self._column_means)
        )
        return NoiseLeft.of(temporal, rows, columns, self.count, shape)


def _error_by_blocks(variances: NDArray[np.float64]) -> float:
    """Return the standard error of the mean of a map of variances by the scatter of its blocks; 0 of too few."""
    rows, columns = (size // _BLOCK_PX for size in variances.shape)
    if rows * columns < _FEWEST_BLOCKS:
        return 0.0
    whole = variances[: rows * _BLOCK_PX, : columns * _BLOCK_PX]
    blocks = whole.reshape(rows, _BLOCK_PX, columns, _BLOCK_PX).mean(axis=(1, 3))
    return float(np.std(blocks, ddof=1)) / math.sqrt(rows * columns)


def _cut(dn: DigitalNumbers, region: Patch | None) -> DigitalNumbers:
    if region is None:
        return dn
    if not region.fits((dn.shape[0], dn.shape[1])):
        raise MeasurementError(
            f"the region {region.x},{region.y},{region.width},{region.height} is not on the frame of "
            f"{dn.shape[1]} × {dn.shape[0]} pixels"
        )
    return dn[region.slices]

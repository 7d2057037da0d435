"""Mean, temporal variance and spatial variance of the frames of one setting."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.data import FrameSettings, Patch
from radiometer.data.frame import DigitalNumbers
from radiometer.errors import MeasurementError


@dataclass(frozen=True, slots=True)
class GroupStatistics:
    """What L frames of one setting say about one region of N pixels.

    Attributes:
        settings: The setting.
        frames: L, at least 2.
        pixels: N.
        mean_dn: μ_y, mean over pixels and frames in DN.
        variance_dn2: σ_y², temporal variance of a pixel in DN²; changes common to a frame are taken out.
        spatial_variance_dn2: s_y², variance of the frame average over the region in DN², temporal noise taken out;
            negative where chance has it so.
        clipped_share: Share of pixels at full scale.
        photons: Mean photons per pixel; None where unknown.
        region: Number of the region.

    Source: EMVA Standard 1288, release 4.0, sections 6.5 and 8.1.
    """

    settings: FrameSettings
    frames: int
    pixels: int
    mean_dn: float
    variance_dn2: float
    spatial_variance_dn2: float
    clipped_share: float
    photons: float | None = None
    region: int = 0

    @property
    def u_mean_dn(self) -> float:
        """Return the standard uncertainty of the mean due to temporal noise in DN."""
        return math.sqrt(max(self.variance_dn2, 1 / 12) / (self.frames * self.pixels))

    @property
    def degrees_of_freedom(self) -> float:
        """Return the degrees of freedom of the temporal variance."""
        return float((self.frames - 1) * (self.pixels - 1))

    @property
    def u_variance_dn2(self) -> float:
        """Return the standard uncertainty of the temporal variance in DN²."""
        return self.variance_dn2 * math.sqrt(2.0 / self.degrees_of_freedom)

    @property
    def u_spatial_variance_dn2(self) -> float:
        """Return the standard uncertainty of the spatial variance in DN²."""
        measured = max(self.spatial_variance_dn2, 0.0) + self.variance_dn2 / self.frames
        u_measured = measured * math.sqrt(2.0 / max(self.pixels - 1, 1))
        return math.hypot(u_measured, self.u_variance_dn2 / self.frames)


def statistics_of_group(
    frames: Iterable[DigitalNumbers],
    settings: FrameSettings,
    regions: tuple[Patch | None, ...],
    full_scale_dn: int,
    photons: float | None = None,
) -> list[GroupStatistics]:
    """Return the statistics of every region of the frames of one setting; frames are held one at a time.

    Args:
        frames: At least two frames of one size.
        settings: Their setting.
        regions: Where to look; None for the whole frame.
        full_scale_dn: Highest digital number.
        photons: Mean photons per pixel where known.

    Raises:
        MeasurementError: If there are fewer than two frames or a region lies outside them.
    """
    sums: list[_Sums] = []
    for dn in frames:
        if not sums:
            sums = [_Sums(_cut(dn, region).shape) for region in regions]
        for region, entry in zip(regions, sums, strict=True):
            entry.add(_cut(dn, region), full_scale_dn)
    if not sums or sums[0].count < 2:
        raise MeasurementError(
            f"only one frame at exposure {settings.exposure_s:g} s ({settings.shutter} shutter): temporal noise needs "
            "two frames at every setting; capture with --repeat 2"
        )
    return [entry.statistics(settings, photons, number) for number, entry in enumerate(sums)]


class _Sums:
    """Running sums over the frames of one region."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.count = 0
        self._sum = np.zeros(shape)
        self._squares = np.zeros(shape)
        self._means: list[float] = []
        self._clipped = 0

    def add(self, dn: DigitalNumbers, full_scale_dn: int) -> None:
        values = dn.astype(np.float64)
        self.count += 1
        self._sum += values
        self._squares += values * values
        self._means.append(float(values.mean()))
        self._clipped += int(np.count_nonzero(dn >= full_scale_dn))

    def statistics(self, settings: FrameSettings, photons: float | None, region: int) -> GroupStatistics:
        count, pixels = self.count, self._sum.size
        average: NDArray[np.float64] = self._sum / count
        within = float(np.mean(self._squares - self._sum * average)) / (count - 1)
        common = float(np.var(self._means, ddof=1))
        temporal = max((within - common) * pixels / max(pixels - 1, 1), 0.0)
        spatial = float(np.var(average, ddof=1)) - temporal / count if pixels > 1 else 0.0
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
        )


def _cut(dn: DigitalNumbers, region: Patch | None) -> DigitalNumbers:
    if region is None:
        return dn
    if not region.fits((dn.shape[0], dn.shape[1])):
        raise MeasurementError(
            f"the region {region.x},{region.y},{region.width},{region.height} does not lie on the frame of "
            f"{dn.shape[1]} × {dn.shape[0]} pixels"
        )
    return dn[region.slices]

"""Mura: band-passed non-uniformity of a white screen, and its largest spot wherever it is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter

from radiometer.analysis.regions.figures import LOST, spread_beyond_noise
from radiometer.data import Quantity, RadianceMap
from radiometer.errors import MeasurementError
from radiometer.typing import Array

# Standard deviations of the two Gaussians over the height: finer structure is noise and pixels, coarser one shading.
FINE_SHARE: Final = 0.02
COARSE_SHARE: Final = 0.15
_DEGREE: Final = 4  # of the polynomial of x and y that takes off the shading, which a border would show as a spot
_FEWEST_GOOD: Final = 0.9  # share of pixels with a value


@dataclass(frozen=True, slots=True, eq=False)
class Mura:
    """Band-passed relative non-uniformity and its largest spot."""

    relative: Array  # band-passed radiance over the shading, shape (height, width)
    spot: Quantity  # contrast of the largest spot after the filter; below 0 where it is dark
    x: Quantity  # its place from the left edge over the width
    y: Quantity  # its place from the upper edge over the height
    rms: Quantity  # standard deviation over the screen, noise taken off
    detection_limit: float  # what noise alone hardly reaches anywhere: 5 % of flat screens exceed it


def mura_of(found: RadianceMap) -> Mura:
    """Return the mura of a white screen that fills a map.

    B = (G_fine ∗ L − G_coarse ∗ L)/S with normalised Gaussians G and the shading S, a polynomial of degree four. The
    polynomial is divided out first. The filters weigh by the pixels that have a value, so they reach the edges. Raises
    MeasurementError if more than a tenth of its pixels have no value.
    """
    good = (found.mask & LOST) == 0
    if float(good.mean()) < _FEWEST_GOOD:
        raise MeasurementError("more than a tenth of the screen has no value: check its area and the exposures")
    light = np.where(good, found.radiance, 0.0).astype(np.float64)
    shading = _shading(light, good)
    flat = np.where(good, light / shading, 0.0)
    own = np.where(good, found.parts_of_u(np.s_[:, :])[0] / shading, 0.0)
    height, width = flat.shape
    fine, coarse = FINE_SHARE * height, COARSE_SHARE * height
    weight = _blurred(good.astype(np.float64), fine)
    band = _blurred(flat, fine) / weight - _blurred(flat, coarse) / _blurred(good.astype(np.float64), coarse)
    # The square of a Gaussian is a Gaussian of σ/√2 over 4πσ²; the coarse one adds below a fiftieth of the variance.
    noise = np.sqrt(_blurred(own**2, fine / math.sqrt(2.0)) / (4.0 * math.pi * fine**2)) / weight
    cells = max(2.0, flat.size / (4.0 * math.pi * fine**2))
    # The largest contrast that noise cannot have made: at edges and corners the filter holds fewer pixels.
    sure = np.abs(band) - math.sqrt(2.0 * math.log(cells)) * noise
    y, x = (int(i) for i in np.unravel_index(int(np.argmax(sure)), band.shape))
    spot, u = float(band[y, x]), float(noise[y, x])
    # The largest of many spots of nearly one size is large by chance as well.
    tied = max(1.0, cells * float(np.mean(np.abs(band) > abs(spot) - 2.0 * math.sqrt(2.0) * u)))
    u_spot = u * math.hypot(1.0, math.sqrt(2.0 * math.log(tied)) / math.sqrt(3.0))
    # A maximum of width σ is found to about σ·noise/height; a pixel is a rectangle.
    u_place = math.hypot(math.sqrt(2.0) * fine * u / max(abs(spot), u), 1.0 / math.sqrt(12.0))
    return Mura(
        band,
        Quantity(spot, u_spot, "1"),
        Quantity((x + 0.5) / width, u_place / width, "1"),
        Quantity((y + 0.5) / height, u_place / height, "1"),
        spread_beyond_noise(float(band.var()), float(np.mean(noise**2)), cells),
        u * math.sqrt(2.0 * math.log(20.0 * cells)),
    )


def _blurred(values: Array, sigma: float) -> Array:
    return np.asarray(gaussian_filter(values, sigma, mode="constant"), dtype=np.float64)


def _shading(light: Array, good: Array) -> Array:
    """Return the polynomial of x and y that is nearest to the light, shape (height, width)."""
    height, width = light.shape
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    basis = np.stack([x**i * y**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)], axis=-1)
    found = np.linalg.lstsq(basis[good], light[good], rcond=None)[0]
    return np.asarray(basis @ found, dtype=np.float64)

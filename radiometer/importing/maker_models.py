"""Models that makers of multispectral cameras state of their lens and of how rows are exposed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.importing.xmp import numbers


@dataclass(frozen=True, slots=True)
class FallOff:
    """A maker's model of vignetting: relative illumination k = 1 + Σ k_i·r^i, r in pixels from the centre.

    Source: MicaSense, RedEdge camera radiometric calibration model: I_corrected = I/k, k = 1 + k_0·r + k_1·r² + …
    """

    centre_px: tuple[float, float]  # (x, y) of the centre in pixels
    coefficients: tuple[float, ...]  # k_1 … k_n in px^-i

    def relative_illumination(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the illumination relative to the centre at places in pixels."""
        radius = np.hypot(x_px - self.centre_px[0], y_px - self.centre_px[1])
        return np.asarray(np.polynomial.polynomial.polyval(radius, (1.0, *self.coefficients)), dtype=np.float64)

    def corners(self, shape: tuple[int, int]) -> tuple[float, ...]:
        """Return the relative illumination of the four corners of a frame of (height, width) pixels."""
        height, width = shape
        x = np.array([0.0, width - 1.0, 0.0, width - 1.0])
        y = np.array([0.0, 0.0, height - 1.0, height - 1.0])
        return tuple(float(v) for v in self.relative_illumination(x, y))


@dataclass(frozen=True, slots=True)
class RowExposure:
    """A maker's model of a row's extra exposure: signal ∝ exposure_s + a2·y − a3·exposure_s·y.

    Source: MicaSense, RedEdge camera radiometric calibration model:
    L = V·a1/g·(p − p_BL)/(t_e + a2·y − a3·t_e·y).
    """

    a2_s: float  # added exposure per row in s
    a3: float  # relative loss per row

    def gain_at(self, row: float, exposure_s: float) -> float:
        """Return the signal of a row relative to row 0."""
        return 1.0 + self.a2_s * row / exposure_s - self.a3 * row


def fall_off_of(properties: Mapping[str, tuple[str, ...]]) -> FallOff | None:
    """Return the radial vignetting model of an XMP packet; None where there is none."""
    centre, coefficients = numbers(properties, "VignettingCenter"), numbers(properties, "VignettingPolynomial")
    if len(centre) != 2 or not coefficients:
        return None
    return FallOff((centre[0], centre[1]), coefficients)


def row_exposure_of(properties: Mapping[str, tuple[str, ...]]) -> RowExposure | None:
    """Return the row model of an XMP packet; None where there is none."""
    stated = numbers(properties, "RadiometricCalibration")
    return RowExposure(stated[1], stated[2]) if len(stated) == 3 else None


def corners_of_plane(properties: Mapping[str, tuple[str, ...]]) -> tuple[float, ...]:
    """Return the relative illumination of the corners by a polynomial in x and y (Parrot Sequoia); () without one.

    The terms' powers are in pairs in `VignettingPolynomial2DName`; x and y run from 0 to 1 over the frame. Values
    are relative to the frame's middle.

    Source: Parrot, Sequoia application note "How to correct vignetting in images".
    """
    powers = numbers(properties, "VignettingPolynomial2DName")
    coefficients = np.array(numbers(properties, "VignettingPolynomial2D"))
    if not coefficients.size or len(powers) != 2 * coefficients.size:
        return ()
    pairs = np.array(powers).reshape(-1, 2)
    places = np.array([(0.5, 0.5), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    terms = places[:, None, 0] ** pairs[None, :, 0] * places[:, None, 1] ** pairs[None, :, 1]
    values = terms @ coefficients
    return tuple(float(v) for v in values[1:] / values[0]) if values[0] > 0 else ()

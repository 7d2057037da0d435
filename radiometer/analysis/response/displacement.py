"""Sub-pixel displacements of the frames of a stack, estimated from their differences at gradients.

A frame that is displaced by d shows ln L + d·∇ln L: what its displacement adds to the differences between frames grows
with the gradient, noise does not. The variance of ln H of a pixel in one frame is that of its noise plus δ²·|∇ln L|²,
with δ the standard deviation of a displacement along any direction. Both are fitted together. So the displacement
that registration leaves, at the grain of paper or from a camera that was touched, does not count as noise on even
ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.noise import LogNoise
from radiometer.analysis.response.pixel_noise import SinglePixels, finite, fit_terms, log_noise
from radiometer.data.frame import Bracket, Frame
from radiometer.data.response_curve import ResponseCurve
from radiometer.typing import Array

# δ² within so many of its standard uncertainties is none: all is noise then.
_SIGMA: Final = 2.0
# The picture in so many parts each way: within one of them residuals may be alike (a displaced edge is many pixels).
_PARTS_EACH_WAY: Final = 8


@dataclass(frozen=True, slots=True)
class Displacement:
    """How far the frames of a stack are from their common place, and the noise."""

    px: float  # standard deviation δ of a frame's displacement along any direction in pixels; 0 where none shows
    # Its standard uncertainty, of the pixels and of a standard deviation from so few frames; where none shows, the
    # smallest that would have, half of the time
    u_px: float
    noise: LogNoise  # noise of one pixel without it


def find_displacement(bracket: Bracket, curve: ResponseCurve) -> Displacement:
    """Return by how many pixels the frames are displaced, and the noise of a pixel.

    Raises:
        MeasurementError: If hardly a pixel is unclipped in two frames.

    Source: first-order expansion of a displaced picture, as in B. D. Lucas, T. Kanade 1981, Proc. IJCAI, 674–679;
        here its variance is fitted together with that of the noise (variance components).
    """
    pixels = SinglePixels.of(bracket, curve)
    squared_gradient = _squared_gradient(bracket, curve, pixels)[pixels.samples.group]
    noise_terms = pixels.noise_terms()
    fit = fit_terms(pixels, np.column_stack([noise_terms, squared_gradient]))
    square = float(fit.amplitudes[3])
    u_square = float(np.sqrt(fit.covariance(_parts(bracket.shape, pixels))[3, 3]))
    if square <= _SIGMA * u_square:
        return Displacement(
            0.0, float(np.sqrt(_SIGMA * u_square)), log_noise(fit_terms(pixels, noise_terms).amplitudes)
        )
    # A variance from n displacements along two directions has 2·(n − 1) degrees of freedom.
    frames = pixels.samples.dn.size / pixels.samples.group_count
    u_square = float(np.hypot(u_square, square / np.sqrt(max(frames - 1.0, 1.0))))
    px = float(np.sqrt(square))
    return Displacement(px, 0.5 * u_square / px, log_noise(fit.amplitudes))


def _squared_gradient(bracket: Bracket, curve: ResponseCurve, pixels: SinglePixels) -> Array:
    """Return |∇ln L|² in 1/px² at every pixel, without the part that noise makes of a square.

    Central differences, which leave the pixel itself out, of odd and of even frames: their noise is not the same.
    """
    total = np.zeros(pixels.row.size)
    for step in ((1, 0), (0, 1)):
        odd, even = (_slope_along(bracket.light[parity::2], curve, pixels, step) for parity in (0, 1))
        total += odd * even
    return np.asarray(np.maximum(total, 0.0))


def _slope_along(frames: tuple[Frame, ...], curve: ResponseCurve, pixels: SinglePixels, step: tuple[int, int]) -> Array:
    """Return the mean central difference of ln H along a direction, over the frames that show both sides; else 0."""
    g, (low, high) = finite(curve.log_exposure), curve.valid_dn or (1, curve.log_exposure.size - 2)
    total, count = np.zeros(pixels.row.size), np.zeros(pixels.row.size)
    for frame in frames:
        before = frame.dn[pixels.row - step[0], pixels.column - step[1]]
        after = frame.dn[pixels.row + step[0], pixels.column + step[1]]
        shown = (before >= low) & (before <= high) & (after >= low) & (after <= high)
        total += np.where(shown, 0.5 * (g[after] - g[before]), 0.0)
        count += shown
    return np.asarray(total / np.maximum(count, 1.0))


def _parts(shape: tuple[int, int], pixels: SinglePixels) -> NDArray[np.intp]:
    """Return which part of the picture every row is in."""
    down = pixels.row * _PARTS_EACH_WAY // shape[0]
    across = pixels.column * _PARTS_EACH_WAY // shape[1]
    return np.asarray((down * _PARTS_EACH_WAY + across)[pixels.samples.group])

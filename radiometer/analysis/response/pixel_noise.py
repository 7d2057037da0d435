"""The noise of single pixels behind a response curve, from how well a stack's own frames predict each other."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from radiometer.analysis.response.basis import hat_weight
from radiometer.analysis.response.limits import ValueLimits
from radiometer.analysis.response.noise import LogNoise
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.analysis.response.weights import group_residual, slope_at, value_at
from radiometer.data.bracket import Bracket
from radiometer.data.response_curve import ResponseCurve
from radiometer.data.sensor_noise import SensorNoise
from radiometer.errors import MeasurementError

Array = NDArray[np.float64]

_PIXELS: Final = 6000
_FEWEST_ROWS: Final = 50
_ROUNDS: Final = 6
# Rounding alone, in DN²: no stack is quieter.
_ROUNDING_DN2: Final = 1.0 / 12.0
# Electrons of a sensor whose shot noise a stack does not show: many enough to weigh nothing.
_MOST_ELECTRONS: Final = 1e7


def pixel_noise(bracket: Bracket, curve: ResponseCurve) -> LogNoise:
    """Return the noise of one pixel: shot, read, and what arises behind the curve, as the frames themselves show it.

    Some thousand pixels evenly over the picture stand for all: each one's exposure is taken as the mean over its
    frames, weighted by the noise so far, and the amplitudes follow from what is left.

    Args:
        bracket: Frames of one unmoving scene.
        curve: Their response.

    Raises:
        MeasurementError: If hardly a pixel is unclipped in two frames.
    """
    samples = _single_pixels(bracket, curve)
    g = _finite(curve.log_exposure)
    log_h, slope = value_at(g, samples.dn), slope_at(g, samples.dn, samples)
    hat = hat_weight(samples.dn, samples.limits) ** 2 + 1e-6
    terms = np.column_stack([np.exp(-log_h), np.exp(-2.0 * log_h), slope**2])
    amplitudes = np.array([0.0, 0.0, 1.0])
    for _ in range(_ROUNDS):
        weight = hat / (terms @ amplitudes + _ROUNDING_DN2 * slope**2)
        residual, share = group_residual(samples, log_h, weight)
        amplitudes = _amplitudes(residual, _of_residuals(samples, terms, share), amplitudes)
    return LogNoise(float(amplitudes[0]), float(amplitudes[1]), float(amplitudes[2]), 0.0)


def _of_residuals(samples: ResponseSamples, terms: Array, share: Array) -> Array:
    """Return what unit amplitudes make of the variance of each residual about the mean of its pixel.

    With shares p the residual e_i − Σ p_j e_j has the variance (1 − 2 p_i) σ_i² + Σ p_j² σ_j².
    """
    starts = np.flatnonzero(np.diff(samples.group, prepend=-1))
    of_mean = np.add.reduceat(share[:, None] ** 2 * terms, starts, axis=0)
    return np.asarray((1.0 - 2.0 * share)[:, None] * terms + of_mean[samples.group])


def _amplitudes(residual: Array, terms: Array, start: Array) -> Array:
    """Return the amplitudes, at or above 0, that make the squared residuals; rounding is known.

    Source: Var(r²) = 2σ⁴ for Gaussian residuals, so that 1/σ⁴ weights a regression of r² on its expectation.
    """
    square, rounding = residual**2, _ROUNDING_DN2 * terms[:, 2]
    found = start
    for _ in range(_ROUNDS):
        expected = np.maximum(terms @ found + rounding, 1e-300)
        # A wild residual (movement, a defect) counts as five standard deviations, not more.
        wanted = (np.minimum(square, 25.0 * expected) - rounding) / expected
        weighted = terms / expected[:, None]
        scale = np.maximum(np.linalg.norm(weighted, axis=0), 1e-300)
        found = nnls(weighted / scale, wanted)[0] / scale
    return np.asarray(found)


def sensor_noise(noise: LogNoise, curve: ResponseCurve, black_dn: float = 0.0) -> SensorNoise:
    """Return the same noise as electrons of a sensor, with what arises behind the curve in DN².

    x = exp g has the variance a·x + b + d·(dx/dM)², so that 1/a is the number of electrons at x = 1.

    Args:
        noise: Of one pixel.
        curve: The response that it holds for.
        black_dn: Black level in DN.
    """
    _, high = curve.valid_dn or (1, curve.log_exposure.size - 2)
    top = float(np.exp(curve.log_exposure[high]))
    electrons_per_unit = min(1.0 / max(noise.shot, 1e-300), _MOST_ELECTRONS / top)
    return SensorNoise(
        # Electrons per DN as a straight line from black to the last number with data would have it.
        conversion_gain_e_per_dn=electrons_per_unit * top / (high - black_dn),
        read_noise_e=float(np.sqrt(noise.read)) * electrons_per_unit,
        full_well_e=electrons_per_unit * top,
        post_curve_dn2=noise.digital,
    )


def _single_pixels(bracket: Bracket, curve: ResponseCurve) -> ResponseSamples:
    """Return one group per pixel, on a lattice whose step shares no factor with the blocks of JPEG."""
    step = max(1, int(np.sqrt(np.prod(bracket.shape) / _PIXELS)))
    step += (step + 1) % 2
    dn = np.array([frame.dn[step // 2 :: step, step // 2 :: step].ravel() for frame in bracket], dtype=np.float64).T
    low, high = curve.valid_dn or (1, curve.log_exposure.size - 2)
    inside = (dn >= low) & (dn <= high)
    inside &= (inside.sum(axis=1) >= 2)[:, None]
    pixel, frame = np.nonzero(inside)
    if pixel.size < _FEWEST_ROWS:
        raise MeasurementError("hardly a pixel is unclipped in two frames: the noise of the stack cannot be told")
    log_time = np.log(bracket.effective_exposures_s)
    return ResponseSamples(
        dn=dn[pixel, frame],
        log_time=log_time[frame],
        group=np.unique(pixel, return_inverse=True)[1].astype(np.intp),
        frame=frame,
        pixels=np.ones(pixel.size),
        variance=np.full(pixel.size, _ROUNDING_DN2),
        bit_depth=bracket.bit_depth,
        limits=ValueLimits(max(low - 1, 0), min(high + 1, curve.log_exposure.size - 1)),
        frame_log_time=log_time,
        frame_bracket=np.zeros(len(bracket), dtype=np.intp),
        pixel_count=dn.shape[0],
        channel=curve.channel,
    )


def _finite(g: Array) -> Array:
    """Return the curve with its ends held where it says nothing."""
    known = np.flatnonzero(np.isfinite(g))
    return np.interp(np.arange(g.size), known, g[known])

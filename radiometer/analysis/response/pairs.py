"""Pairs of frames that follow one another, for methods that recover the ratio of their exposures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.noise_shift import mean_exposure_dn
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.analysis.response.weights import noise_of, row_variance, value_at
from radiometer.errors import UsageError
from radiometer.typing import Array

# Closer to black, in parts of full scale, the last stops' small H would pull at the ratios.
LEAST_PART = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Groups seen in two frames that follow one another, one row each.

    Attributes:
        shorter: Digital number of the mean exposure in the shorter frame, shape (rows,).
        longer: In the longer frame.
        pair: Index of the pair among `frames`.
        sigma: Standard deviation of the difference of ln H.
        group: Group of pixels.
        nominal_log_ratio: ln of longer over shorter stated exposure of every pair, shape (pairs,).
        frames: Index of every pair's shorter frame.
    """

    shorter: Array
    longer: Array
    pair: NDArray[np.intp]
    sigma: Array
    group: NDArray[np.intp]
    nominal_log_ratio: Array
    frames: NDArray[np.intp]

    @classmethod
    def of(cls, samples: ResponseSamples, start: Array, frames: NDArray[np.intp] | None = None) -> Pairs:
        """Return the pairs of a set of samples.

        Args:
            samples: The rows.
            start: A first estimate of g at every digital number.
            frames: Shorter frames of the requested pairs; None for all that occur.
        """
        limits = samples.limits
        shifted = mean_exposure_dn(samples.dn, samples.variance, start, limits)
        dn = np.clip(shifted, limits.black_dn, limits.saturated_dn)
        variance = row_variance(samples, dn, start, noise_of(samples, dn, start))
        follows = (np.diff(samples.group) == 0) & (np.diff(samples.frame) == 1)
        first = np.flatnonzero(follows)
        before = samples.frame[first]
        present = np.unique(before) if frames is None else frames
        clear = dn[first] > limits.black_dn + LEAST_PART * ((1 << samples.bit_depth) - 1)
        first = first[np.isin(before, present) & clear]
        return cls(
            shorter=dn[first],
            longer=dn[first + 1],
            pair=np.searchsorted(present, samples.frame[first]),
            sigma=np.sqrt(variance[first] + variance[first + 1]),
            group=samples.group[first],
            nominal_log_ratio=samples.frame_log_time[present + 1] - samples.frame_log_time[present],
            frames=present,
        )

    def part(self, keep: NDArray[np.bool_]) -> Pairs:
        """Return the rows to keep."""
        return replace(
            self,
            shorter=self.shorter[keep],
            longer=self.longer[keep],
            pair=self.pair[keep],
            sigma=self.sigma[keep],
            group=self.group[keep],
        )

    def log_ratios(self, log_exposure: Array) -> Array:
        """Return ln of the exposure ratio of every pair as a curve g has it; the stated one where it has no rows."""
        step = value_at(log_exposure, self.longer) - value_at(log_exposure, self.shorter)
        weight = np.bincount(self.pair, self.sigma**-2.0, self.frames.size)
        found = np.bincount(self.pair, step * self.sigma**-2.0, self.frames.size) / np.maximum(weight, 1e-300)
        return np.where(weight > 0, found, self.nominal_log_ratio)


@dataclass(frozen=True, slots=True, eq=False)
class Gauge:
    """What fixes the exponent γ of curve and ratios.

    Attributes:
        held: ln ratio of the pairs that are known, by their position.
        total: Sum of all ln ratios that is held; None where ratios are known.
        text: The same in words.
    """

    held: dict[int, float]
    total: float | None
    text: str

    @classmethod
    def of(cls, pairs: Pairs, known: Mapping[int, float] | None) -> Gauge:
        """Return the gauge for known ratios, or that of the stated times without any.

        Args:
            pairs: The pairs.
            known: Longer over shorter exposure by the index of the shorter frame.

        Raises:
            UsageError: If a known ratio names no pair or is not above 1.
        """
        if not known:
            return cls({}, float(pairs.nominal_log_ratio.sum()), "the product of the stated exposure times")
        position = {int(frame): at for at, frame in enumerate(pairs.frames)}
        for index, ratio in known.items():
            if index not in position or not ratio > 1.0:
                raise UsageError(
                    f"known exposure ratio {ratio:g} of pair {index}: expected a ratio above 1 of one of the pairs "
                    f"{', '.join(map(str, position))}"
                )
        held = {position[index]: float(np.log(ratio)) for index, ratio in known.items()}
        return cls(held, None, "the known ratio of pair " + ", ".join(map(str, known)))

    def exponent(self, log_ratios: Array) -> float:
        """Return the factor that brings ln ratios to what is known of them."""
        if self.total is not None:
            return self.total / float(log_ratios.sum())
        places = list(self.held)
        return float(np.sum(list(self.held.values())) / max(float(log_ratios[places].sum()), 1e-3))


def with_log_ratios(samples: ResponseSamples, pairs: Pairs, log_ratios: Array) -> ResponseSamples:
    """Return the samples with exposure times that have these ratios; the first of every bracket stays.

    Args:
        samples: The rows.
        pairs: Their pairs.
        log_ratios: ln ratio of every pair.
    """
    step = np.diff(samples.frame_log_time)
    step[pairs.frames] = log_ratios
    times = samples.frame_log_time[0] + np.concatenate([[0.0], np.cumsum(step)])
    return replace(samples, frame_log_time=times, log_time=times[samples.frame])

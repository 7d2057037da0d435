"""Check photographs that are declared linear: by what power of the exposure their numbers grow."""

from __future__ import annotations

import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.limits import find_limits
from radiometer.data.bracket import Bracket
from radiometer.errors import MeasurementError

# Numbers that are asked, as shares of the span from black to white: clear of rounding, of stray light and of clipping.
_LOWEST_SHARE: Final = 0.1
_HIGHEST_SHARE: Final = 0.95
_FEWEST_PIXELS: Final = 50  # that two frames show: their median ratio is then known to some per cent at the noisiest
_LEAST_RATIO: Final = 1.2  # of two exposures; nearer ones say little of growth
_PIXELS: Final = 50_000


def growth_power(bracket: Bracket, black_dn: float = 0.0) -> float | None:
    """Return p of M − black ∝ (exposure)^p: 1 of a linear camera; None where no two frames show the same pixels.

    The median over pairs of neighbouring frames of Δln(M − black) / Δln(exposure), each that of its pixels' median, so
    that one wrong time in four or more says nothing. Behind a gamma of 1/2.2 it is 0.45.

    Args:
        bracket: Frames of one unmoving scene.
        black_dn: Black level in DN.
    """
    try:
        span = find_limits([bracket]).saturated_dn - black_dn
    except MeasurementError:  # nothing but black and white
        return None
    step = max(1, int(np.sqrt(bracket.shape[0] * bracket.shape[1] / _PIXELS)))
    signals = [(frame.dn[::step, ::step].ravel().astype(np.float64) - black_dn) / span for frame in bracket.light]
    log_times = np.log(bracket.effective_exposures_s)
    powers = [
        power
        for a, b in itertools.pairwise(range(len(bracket.light)))
        if (power := _power(signals[a], signals[b], float(log_times[b] - log_times[a]))) is not None
    ]
    return float(np.median(powers)) if powers else None


def _power(short: NDArray[np.float64], long: NDArray[np.float64], log_ratio: float) -> float | None:
    """Return the power of two frames; None where too few pixels show in both, or their exposures hardly differ."""
    lowest, highest = np.minimum(short, long), np.maximum(short, long)
    shown = (lowest > _LOWEST_SHARE) & (highest < _HIGHEST_SHARE)
    if log_ratio < np.log(_LEAST_RATIO) or np.count_nonzero(shown) < _FEWEST_PIXELS:
        return None
    return float(np.median(np.log(long[shown] / short[shown]))) / log_ratio

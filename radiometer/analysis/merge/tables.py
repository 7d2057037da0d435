"""Records and tables of the merge's last step: how sums become a rate, and its variance.

For independent samples x_i = E·t_i + noise with variance v_i = c_i + κ·E·t_i the maximum-likelihood weights are
t_i/v_i. They depend on E, which a stream does not know yet, and weights that follow the noisy sample itself are
biased. Two sums with fixed weights, Σt^0.35·x and Σt·x, give two unbiased estimates of E. The mixture of least
variance follows from E at the end. Its variance is within 1.5 % of the optimum over all ladders of 4 to 16 frames and
all ratios of read to shot noise. With the powers 0 and 1 it would be 8 %. The error of that mixture is uncorrelated
with the difference of the two estimates, so choosing it by the estimated E brings no bias to first order
(Gauss–Markov).

It depends on the frames used and on the level alone. So each set of frames has a table over √E, with straight lines
between the levels where rounding is tabulated for the frame that shows most. The table is filled in where a pixel
asks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge.frames import FrameTerms
from radiometer.analysis.signal.model import SignalModel
from radiometer.compiled import compiled
from radiometer.typing import Array

# Columns of a record: what `finish` needs of one set of frames.
(
    INV1,
    INV2,
    S2,
    P0,
    P1,
    R0,
    R1,
    A0,
    A1,
    V0,
    V1,
    CC,
    C1,
    D1,
    D2,
    NEAR,
    COUNT,
    LONGEST,
    PLENTY,
    PLENTY0,
    PLENTY1,
    ROOT,
    NEAREST,
    NEXT,
) = range(24)
RECORD_SIZE = 24  # the places above
FIRST_POWER = 0.35  # of the exposure: within 1.5 % of the best variance (see above)
# A frame expected to clip by more than this says nothing new: its censored score is below 0.001 sigma.
CENSORED_SIGMA = 3.5
# The scatter of a pixel's frames, and what a curve's uncertainty excuses of it. Beyond five standard deviations a
# normal error comes once in 3.5 million. So hardly a pixel of a picture is called inconsistent by chance.
AGREEMENT_SIGMA = 5.0
# A frame that clipped, though the others put it this far below clipping. This is checked in every frame of every
# pixel, up to a hundred times as often as the scatter. So its chance must be as much smaller (one in a thousand
# million).
CONTRADICTION_SIGMA = 6.0
# Columns of a level: what a pixel there needs.
(SHARE, VARIANCE, TOTAL, SQUARES) = range(4)
LEVEL_SIZE = 4
# Lower levels are worked out singly: so near to zero straight lines over √E are off by more than 0.1 %.
FIRST_LEVEL = 16
_ROOT_TABLE_SIZE = 2048
# Sets of frames, a power of 2: a bracket of 16 has some hundred; memory is taken by those that occur.
_KEPT_SETS = 256
# Frames that agree to this are consistent whatever the noise; more slack where the noise is only a typical one.
_AGREEMENT_REL = 0.01
_AGREEMENT_ASSUMED_REL = 0.1


@compiled
def scatter_limit(freedom: float) -> float:  # pragma: no cover (compiled)
    """Return by how much Σ(x − E·t)² may exceed its expectation, at `AGREEMENT_SIGMA`.

    Source: Wilson and Hilferty 1931.
    """
    return float((1.0 - 2.0 / (9.0 * freedom) + AGREEMENT_SIGMA * math.sqrt(2.0 / (9.0 * freedom))) ** 3)


@compiled
def fill_record(
    record: Any, pattern: Any, frames: Any, kappa: float, gains: Any, top: float
) -> None:  # pragma: no cover (compiled)
    """Fill in what follows from which frames are used: sums, and the variances as lines in E.

    Let w = t^0.35, E_a = Σwx/Σwt and E_b = Σtx/Σt². Then var E_a = a0 + a1·E, and the variance of E_a − E_b is r0 +
    r1·E. With var E_b − cov = p0 + p1·E, var E_a − cov = r − p. The best share of E_a is p/r. PLENTY is how often the
    expected scatter is still consistent whatever the level: by Cauchy and Schwarz the degrees of freedom are at most
    the frames. PLENTY0 + PLENTY1·E is that scatter. Below the rate NEAR the frame NEAREST may not have had to clip,
    below NEXT others as well. ROOT times √E is 1 where the frame that shows most is at the end of the response curve.

    Args:
        record: float64, shape (RECORD_SIZE,), overwritten.
        pattern: Bits of the frames used.
        frames: float64, shape (n, 6): t, c, x at clipping, its sigma there, common uncertainty of the dark level, and
            what c is at clipping.
        kappa: Shot noise variance per unit of x.
        gains: Gain factor of every frame.
        top: x of the curve's end; of no meaning for a linear sensor.
    """
    record[:] = 0.0
    longest, s1, s2 = -1.0, 0.0, 0.0
    var_a0, var_a1, var_b0, var_b1, both0, both1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(frames.shape[0]):
        t, c = frames[i, 0], frames[i, 1]
        if (pattern >> np.uint64(i)) & np.uint64(1):
            w, k = t**FIRST_POWER, kappa * t
            s1, s2 = s1 + w * t, s2 + t * t
            var_a0, var_b0, both0 = var_a0 + w * w * c, var_b0 + t * t * c, both0 + w * t * c
            var_a1, var_b1, both1 = var_a1 + w * w * k, var_b1 + t * t * k, both1 + w * t * k
            record[V0] += c
            record[V1] += k
            record[C1] += t * c
            record[CC] += c * c
            record[D1] += w * frames[i, 4]
            record[D2] += t * frames[i, 4]
            record[COUNT] += 1.0
            record[ROOT] = max(record[ROOT], math.sqrt(t * gains[i] / top))
            if t > longest:
                longest = t
                record[LONGEST] = i
        else:
            near = (frames[i, 2] + CENSORED_SIGMA * frames[i, 3]) / t
            if near > record[NEAR]:
                record[NEXT], record[NEAR], record[NEAREST] = record[NEAR], near, i
            else:
                record[NEXT] = max(record[NEXT], near)
    record[INV1], record[INV2], record[S2] = 1.0 / s1, 1.0 / s2, s2
    record[D1], record[D2] = record[D1] / s1, record[D2] / s2
    var_a0, var_a1 = var_a0 / s1**2, var_a1 / s1**2
    var_b0, var_b1 = var_b0 / s2**2, var_b1 / s2**2
    both0, both1 = both0 / (s1 * s2), both1 / (s1 * s2)
    record[A0], record[A1] = var_a0, var_a1
    record[R0], record[R1] = var_a0 + var_b0 - 2.0 * both0, var_a1 + var_b1 - 2.0 * both1
    record[P0], record[P1] = var_b0 - both0, var_b1 - both1
    record[PLENTY] = scatter_limit(record[COUNT]) if record[COUNT] > 1.0 else math.inf
    record[PLENTY0], record[PLENTY1] = record[PLENTY] * record[V0], record[PLENTY] * record[V1]
    if record[R0] <= 1e-9 * var_a0 and record[R1] <= 1e-9 * var_a1:  # one exposure only: both estimates are the same
        record[P0], record[P1], record[R0], record[R1] = 1.0, 0.0, 1.0, 0.0


@compiled
def from_root_table(signal: float, entries: Any, top: float) -> float:  # pragma: no cover (compiled)
    """Return a table's value at x.

    Args:
        signal: x times gain.
        entries: Values at x = top·(k/(size − 1))², float64.
        top: x of the last entry.
    """
    place = math.sqrt(min(max(signal, 0.0) / top, 1.0)) * (entries.size - 1)
    low = min(int(place), entries.size - 2)
    return float(entries[low] + (place - low) * (entries[low + 1] - entries[low]))


@compiled
def moments(
    rate: float, pattern: Any, frames: Any, gains: Any, kappa: float, quantisation: Any, top: float
) -> tuple[float, float, float, float, float]:  # pragma: no cover (compiled)
    """Return (Σv, Σv², Σw²·v, Σw·t·v, Σt²·v), w = t^0.35, over the frames of a pattern at a rate."""
    total, squares, var_a, both, var_b = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(frames.shape[0]):
        if not (pattern >> np.uint64(i)) & np.uint64(1):
            continue
        t, gain = frames[i, 0], gains[i]
        v = frames[i, 1] + kappa * rate * t + from_root_table(rate * t * gain, quantisation, top) / gain**2
        w = t**FIRST_POWER
        total, squares = total + v, squares + v * v
        var_a, both, var_b = var_a + w * w * v, both + w * t * v, var_b + t * t * v
    return total, squares, var_a, both, var_b


@compiled
def mixture(var_a: float, both: float, var_b: float) -> tuple[float, float]:  # pragma: no cover (compiled)
    """Return (share of the first, variance) of the mixture of two estimates with the least variance."""
    between = var_a + var_b - 2.0 * both
    if between <= 1e-9 * var_a:
        return 1.0, var_a
    share = (var_b - both) / between
    return share, var_a - (var_a - both) ** 2 / between


@compiled
def fill_levels(
    k: int,
    pattern: Any,
    record: Any,
    levels: Any,
    frames: Any,
    gains: Any,
    kappa: float,
    quantisation: Any,
    top: float,
) -> None:  # pragma: no cover (compiled)
    """Fill in level k of a set of frames and the next, where they are not yet.

    At level k √(rate·t·gain/top) = k/(size − 1) of the frame that shows most.

    Args:
        k: Number of the level.
        pattern: Bits of the frames used.
        record: As of `fill_record`.
        levels: Shape (size, 4): what `at_rate` returns; written at k and k + 1 where nothing is yet.
        frames: As in `fill_record`.
        gains: Gain factor of every frame.
        kappa: Shot noise variance per unit of x.
        quantisation: As in `from_root_table`, of as many entries as there are levels.
        top: Likewise.
    """
    for j in (k, k + 1):
        if levels[j, VARIANCE] > 0.0:
            continue
        rate = (j / ((levels.shape[0] - 1) * record[ROOT])) ** 2
        share, variance, total, squares = at_rate(rate, pattern, record, frames, gains, kappa, quantisation, top)
        levels[j, SHARE], levels[j, VARIANCE], levels[j, TOTAL], levels[j, SQUARES] = share, variance, total, squares


@compiled
def at_rate(
    rate: float, pattern: Any, record: Any, frames: Any, gains: Any, kappa: float, quantisation: Any, top: float
) -> tuple[float, float, float, float]:  # pragma: no cover (compiled)
    """Return (share of the first estimate, variance of the mixture, Σv, Σv²) at a rate; arguments as `fill_levels`."""
    total, squares, var_a, both, var_b = moments(max(rate, 0.0), pattern, frames, gains, kappa, quantisation, top)
    inv1, inv2 = record[INV1], record[INV2]
    share, variance = mixture(var_a * inv1**2, both * inv1 * inv2, var_b * inv2**2)
    return share, variance, total, squares


@dataclass(frozen=True, slots=True, eq=False)
class MergeTables:
    """What the merge's last step is given besides the pixels."""

    frames: Array  # as in `records.fill_record`
    kappa: float  # shot noise variance per unit of x
    # Rate that is the lower bound where all frames clip, the upper bound where all are black, and the relative
    # difference between frames that is never called inconsistent
    bounds: Array
    gains: Array  # gain factor of every frame
    quantisation: Array | None  # variance (dx/dM)²/12 over √x; None for a linear sensor
    curve: Array | None  # relative standard uncertainty of x over √x; None for a linear sensor
    top: float  # x of the last entry of both
    valid: Array  # lowest and highest x times gain that the response curve has data for

    @property
    def arguments(self) -> tuple[tuple[Any, ...], Array | None]:
        """Return `tables` and `quantisation` of `finish`."""
        tables = self.frames, self.kappa, self.bounds, self.gains, self.curve, self.top, self.valid
        return tables, self.quantisation

    def kept(self) -> tuple[NDArray[np.uint64], Array, Array]:
        """Return what `finish` keeps from block to block, empty: sets of frames, their records and their levels."""
        levels = 0 if self.quantisation is None else _ROOT_TABLE_SIZE
        return (
            np.zeros(_KEPT_SETS, np.uint64),
            np.zeros((_KEPT_SETS, RECORD_SIZE)),
            np.zeros((_KEPT_SETS, levels, LEVEL_SIZE)),
        )

    def variance(self, expected: Array) -> tuple[Array, Array]:
        """Return the variance of every frame's signal x, and the relative uncertainty of the curve there.

        Args:
            expected: Expected x, shape (frames, pixels).
        """
        frames, gains = self.frames, self.gains[:, None]
        variance = frames[:, 1:2] + self.kappa * expected
        if self.quantisation is None or self.curve is None:
            return variance, np.zeros_like(expected)
        place = np.sqrt(np.clip(expected * gains / self.top, 0.0, 1.0)) * (_ROOT_TABLE_SIZE - 1)
        low = np.minimum(place.astype(np.intp), _ROOT_TABLE_SIZE - 2)
        part = place - low
        quantisation, curve = (
            entries[low] + part * (entries[low + 1] - entries[low]) for entries in (self.quantisation, self.curve)
        )
        return variance + quantisation / gains**2, curve


def merge_tables(terms: Sequence[FrameTerms], model: SignalModel) -> MergeTables:
    """Return the tables for a set of light frames.

    Args:
        terms: The frames in the order of their bits; exposures are counted in units of the first.
        model: Signal model of the camera.
    """
    reference = terms[0].exposure
    kappa = 1.0 / model.electrons_per_unit
    frames = np.array(
        [
            [o.exposure / reference, o.variance, o.clips_at, o.sigma_clip, o.u_dark, _at_clipping(o, kappa, model)]
            for o in terms
        ]
    )
    agreement = _AGREEMENT_ASSUMED_REL if model.noise.assumed else _AGREEMENT_REL
    lower_bound = float((frames[:, 2] / frames[:, 0]).max())
    darkest = float((model.table(terms[0].settings)[1] - model.table(terms[0].settings)[0]) / frames[:, 0].max())
    return MergeTables(
        frames,
        kappa,
        np.array([lower_bound, darkest, agreement]),
        np.array([one.gain for one in terms]),
        *_root_tables(model),
    )


def _at_clipping(one: FrameTerms, kappa: float, model: SignalModel) -> float:
    """Return the variance of x at clipping but for its shot noise: behind a curve what arises there as well."""
    return one.variance if model.linear else max(one.sigma_clip**2 - kappa * one.clips_at, one.variance)


def _root_tables(model: SignalModel) -> tuple[Array | None, Array | None, float, Array]:
    """Return over √x the variance that arises behind the curve and the curve's uncertainty, the last x, and valid x.

    The last are the x that the curve has data for.

    A linear sensor needs no tables.
    """
    if model.linear:
        return None, None, 1.0, np.zeros(2)
    top = float(model.signal[-1])
    signal = top * np.linspace(0.0, 1.0, _ROOT_TABLE_SIZE) ** 2
    dn = np.interp(signal, model.signal, np.arange(model.signal.size))
    quantisation = model.at_dn(model.slope, dn) ** 2 * model.noise.code_variance_dn2
    return quantisation, model.at_dn(model.u_rel, dn), top, model.signal[list(model.valid_dn)]

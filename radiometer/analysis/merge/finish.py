"""Compiled last step of the merge: sums into radiance, standard uncertainty and mask, by records and tables.

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

Near clipping it enters with its censored likelihood, or the choice of frames by their own noisy values would bias the
result (Tobin 1958, Econometrica 26, 24). Where frames are cut off at black, those that are not are too bright on
average, by what the truncated normal distribution states, which is subtracted.

What the compiled functions share:
    pattern: Bits of the frames used: a set of frames.
    frames: float64, shape (n, 9). First the relative exposure t, the variance c of x without light, x at clipping, its
        sigma there and the common uncertainty of the dark level. Then c at clipping, x where black cuts the frame off,
        c there, and t^0.35.
    kappa: Shot noise variance per unit of x.
    gains: Gain factor of every frame.
    quantisation: Variance (dx/dM)²/12 over √x, for `from_root_table`; None for a linear sensor, where it is part of
        `frames`. The loops are compiled for each, which needs a separate argument.
    top: x of its last entry; of no meaning for a linear sensor.
    record: What follows from a set of frames, as `fill_record` makes it, float64, shape (RECORD_SIZE,); `records` is
        of shape (sets, RECORD_SIZE), their number a power of 2, and `slot` the place of one.
    levels: What `at_rate` returns at the levels of a set, shape (levels, 4), 0 where it was not asked; of no size for a
        linear sensor.
    rate, variance: Estimate from the frames that did not clip, and its variance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge.frames import FrameTerms, longest_of, with_shared_darks
from radiometer.analysis.signal.model import SignalModel
from radiometer.compiled import compiled, compiled_apart, compiled_within
from radiometer.data.radiance_map import PixelMask
from radiometer.errors import MeasurementError
from radiometer.typing import Array

NOISE_FLOOR_SIGMA = 2.0
ONLY_NEAR_CLIPPING = np.uint8(2)  # frames that clip may say something; nothing else is doubtful
SATURATED = np.uint8(PixelMask.SATURATED)
BELOW_NOISE = np.uint8(PixelMask.BELOW_NOISE)
EXTRAPOLATED = np.uint8(PixelMask.EXTRAPOLATED)
INCONSISTENT = np.uint8(PixelMask.INCONSISTENT)
_RUN = 1024  # pixels whose square roots are taken together: only a loop without branches is vectorised
_PROBES = 8
_HASH = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio (Knuth, vol. 3, 6.4)
# Columns of a record: what `finish` needs of one set of frames.
INV1, INV2, S2, P0, P1, R0, R1, A0, A1, V0, V1, CC, C1, D1, D2 = range(15)
NEAR, COUNT, LONGEST, PLENTY, PLENTY0, PLENTY1, ROOT, NEAREST, NEXT, DIM = range(15, 25)
RECORD_SIZE = 25  # the places above
FIRST_POWER = 0.35  # of the exposure: within 1.5 % of the best variance (see above)
# A frame expected to clip by more than this says nothing new: its censored score is below 0.001 sigma.
CENSORED_SIGMA = 3.5
# The hazard is read off straight lines, right to 1e-6, which is quicker than exp and erfc for every such pixel.
_TABLE_END, _TABLE_STEPS = 8.0, 4096
_PER_SIGMA = _TABLE_STEPS / (_TABLE_END + CENSORED_SIGMA)
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
# Levels per e-fold at which the weights of the frames are worked out for all pixels: they change little between.
PER_FOLD = 16.0
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
    below NEXT others as well. Below the rate DIM frames that are used may have been cut off at black. ROOT times √E is
    1 where the frame that shows most is at the end of the response curve.
    """
    record[:] = 0.0
    record[DIM] = -math.inf
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
            cut_sigma = math.sqrt(frames[i, 7] + kappa * max(frames[i, 6], 0.0))
            record[DIM] = max(record[DIM], (frames[i, 6] + CENSORED_SIGMA * cut_sigma) / t)
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
    """Return a table's value at x times gain; its entries are float64 at x = top·(k/(size − 1))²."""
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

    At level k √(rate·t·gain/top) = k/(size − 1) of the frame that shows most; the table has as many entries as levels.
    """
    for j in (k, k + 1):
        if levels[j, VARIANCE] > 0.0:
            continue
        rate = (j / ((levels.shape[0] - 1) * record[ROOT])) ** 2
        share, variance, total, squares = at_rate(rate, pattern, record, frames, gains, kappa, quantisation, top)
        levels[j, SHARE], levels[j, VARIANCE], levels[j, TOTAL], levels[j, SQUARES] = share, variance, total, squares


@compiled
def between_levels(levels: Any, place: float) -> tuple[float, float, float, float]:  # pragma: no cover (compiled)
    """Return what `at_rate` returns on the straight line between the levels next to a place, which are filled in."""
    k = int(place)
    low, high, above = levels[k], levels[k + 1], place - k
    return (
        low[SHARE] + above * (high[SHARE] - low[SHARE]),
        low[VARIANCE] + above * (high[VARIANCE] - low[VARIANCE]),
        low[TOTAL] + above * (high[TOTAL] - low[TOTAL]),
        low[SQUARES] + above * (high[SQUARES] - low[SQUARES]),
    )


@compiled
def at_rate(
    rate: float, pattern: Any, record: Any, frames: Any, gains: Any, kappa: float, quantisation: Any, top: float
) -> tuple[float, float, float, float]:  # pragma: no cover (compiled)
    """Return (share of the first estimate, variance of the mixture, Σv, Σv²) at a rate."""
    total, squares, var_a, both, var_b = moments(max(rate, 0.0), pattern, frames, gains, kappa, quantisation, top)
    inv1, inv2 = record[INV1], record[INV2]
    share, variance = mixture(var_a * inv1**2, both * inv1 * inv2, var_b * inv2**2)
    return share, variance, total, squares


@dataclass(frozen=True, slots=True, eq=False)
class AtLevels:
    """What becomes of the frames in a pixel, by its level: at steps of 1/`PER_FOLD` in ln of the rate."""

    lowest: float  # ln of the lowest rate
    weights: Array  # of each frame, sum 1, shape (frames, levels)
    u_rel: Array  # relative standard uncertainty of the value, which pixels of one level share: of the curve
    dark_u: Array  # standard uncertainty of the rate that the frames' common dark level brings

    @property
    def root_sum_square(self) -> Array:
        """Return √Σp² of the weights p, shape (levels,): what independent errors of the frames leave in their mean."""
        return np.asarray(np.sqrt((self.weights**2).sum(axis=0)))

    def add(
        self,
        radiance: NDArray[np.float32],
        u_radiance: NDArray[np.float32],
        shared: NDArray[np.float32],
        per_rate: NDArray[np.float32],
    ) -> None:
        """Add to the uncertainties of pixels, in place, what those of one level share.

        Args:
            radiance: Radiance, flat.
            u_radiance: Its uncertainty, with the dark level in it; what pixels share is added.
            shared: What they share by their place; what they share by their level and their dark level is added.
            per_rate: Radiance per rate, of every pixel or of all (size 1).
        """
        _add_by_level(
            radiance,
            per_rate,
            self.lowest,
            self.u_rel.astype(np.float32),
            self.dark_u.astype(np.float32),
            u_radiance,
            shared,
        )


@compiled
def _add_by_level(
    radiance: Any, per_rate: Any, lowest: float, u_rel: Any, u_rate: Any, own: Any, shared: Any
) -> None:  # pragma: no cover (compiled)
    step = 1 if per_rate.size > 1 else 0
    floor, last, fold = np.float32(math.exp(lowest)), u_rel.size - 1, np.float32(PER_FOLD)
    first = np.float32(0.5 - lowest * PER_FOLD)
    for i in range(radiance.size):
        factor = per_rate[i * step]
        place = int(math.log(max(radiance[i] / factor, floor)) * fold + first)
        place = min(place, last)
        of_level, of_dark = u_rel[place] * radiance[i], u_rate[place] * factor
        more = shared[i] * shared[i] + of_level * of_level
        own[i] = math.sqrt(own[i] * own[i] + more)
        shared[i] = min(math.sqrt(more + of_dark * of_dark), own[i])


@dataclass(frozen=True, slots=True, eq=False)
class MergeTables:
    """What the merge's last step is given besides the pixels."""

    frames: Array  # as in `fill_record`
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

    def at_levels(self) -> AtLevels:
        """Return what the merge does to a pixel, by its level, with the maximum-likelihood weights."""
        exposure, clips_at, cut_at = (self.frames[:, k][:, None] for k in (0, 2, 6))
        lowest, highest = np.log(self.bounds[1]), np.log(self.bounds[0])
        log_rate = np.arange(lowest, max(highest, lowest) + 1.0 / PER_FOLD, 1.0 / PER_FOLD)
        expected = exposure * np.exp(log_rate)
        variance, curve = self.variance(expected)
        counts = (expected < clips_at) & (expected > cut_at)
        counts[np.argmax(exposure)] |= ~counts.any(axis=0)  # one remains, or the table ends
        weights = np.where(counts, exposure**2 / variance, 0.0)
        weights /= weights.sum(axis=0)
        dark = (weights * self.frames[:, 4:5] / exposure).sum(axis=0)
        return AtLevels(float(lowest), weights, (weights * curve).sum(axis=0), dark)

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

    Raises:
        MeasurementError: If the dark signal of every frame fills it.
    """
    if all(one.clips_at <= 0.0 for one in terms):
        raise MeasurementError(
            "the dark signal of every frame is full scale, so that no light can be seen; expose shorter"
        )
    reference = terms[0].exposure
    kappa = 1.0 / model.electrons_per_unit
    frames = np.array(
        [
            [
                *(o.exposure / reference, o.variance, o.clips_at, o.sigma_clip, o.u_dark),
                *(_at_end(o, o.clips_at, o.sigma_clip, model), o.cut_at, _at_end(o, o.cut_at, o.sigma_cut, model)),
                (o.exposure / reference) ** FIRST_POWER,
            ]
            for o in with_shared_darks(terms)
        ]
    )
    if terms[longest_of(terms)].low_dn > 1:
        frames[longest_of(terms), 6] = -math.inf  # it counts whatever it shows
    agreement = _AGREEMENT_ASSUMED_REL if model.noise.assumed else _AGREEMENT_REL
    darkest = float((model.table(terms[0].settings)[1] - model.table(terms[0].settings)[0]) / frames[:, 0].max())
    lower_bound = max(float((frames[:, 2] / frames[:, 0]).max()), darkest)  # dark signal alone may fill a pixel
    return MergeTables(
        frames,
        kappa,
        np.array([lower_bound, darkest, agreement]),
        np.array([one.gain for one in terms]),
        *_root_tables(model),
    )


def _at_end(one: FrameTerms, signal: float, sigma: float, model: SignalModel) -> float:
    """Return the variance of x at an end but for its shot noise: behind a curve what arises there as well."""
    shot = max(signal, 0.0) / model.electrons_per_unit
    return one.variance if model.linear else max(sigma**2 - shot, one.variance)


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
    quantisation = model.at_dn(model.slope, dn) ** 2 * model.code_variance_dn2
    return quantisation, model.at_dn(model.u_rel, dn), top, model.signal[list(model.valid_dn)]


def _hazard(z: float) -> float:
    """Return φ(z)/(1 − Φ(z)), the hazard of the normal distribution."""
    return math.sqrt(2.0 / math.pi) * math.exp(-0.5 * z * z) / math.erfc(z / math.sqrt(2.0))


_HAZARD = np.array([_hazard(step / _PER_SIGMA - CENSORED_SIGMA) for step in range(_TABLE_STEPS + 1)])


@compiled_within
def hazard(z: float) -> float:  # pragma: no cover (compiled)
    """Return φ(z)/(1 − Φ(z)) to 1e-6 for z at or above −CENSORED_SIGMA; below, some number."""
    place = (z + CENSORED_SIGMA) * _PER_SIGMA
    low = np.uint64(min(max(place, 0.0), _TABLE_STEPS - 1.0))
    rise = _HAZARD[low] + (place - low) * (_HAZARD[low + np.uint64(1)] - _HAZARD[low])
    # Beyond the table its asymptotic series, right to 3e-4 and better.
    return float(rise if place < _TABLE_STEPS else z + 1.0 / z - 2.0 / z**3)


@compiled_within
def censored_score(
    estimate: float, rate: float, variance: float, t: float, c: float, clips_at: float, kappa: float
) -> tuple[float, float, bool]:  # pragma: no cover (compiled)
    """Return what a frame that clipped adds to the score and to the information, and whether it contradicts the others.

    Args:
        estimate: Rate at which it is asked.
        t: Relative exposure of the frame.
        c: Variance of its x at clipping but for shot noise.
        clips_at: Its x at clipping.
    """
    expected = max(estimate, 0.0) * t
    noise, below = c + kappa * expected, clips_at - expected
    had_to_clip = (below < 0.0) & (below * below >= CENSORED_SIGMA**2 * noise)
    gap = clips_at - rate * t
    # Far below clipping: it was cut off at the black end, or the scene has changed.
    far = (gap > 0.0) & (gap * gap > CONTRADICTION_SIGMA**2 * (noise + t * t * variance))
    per_sigma = 1.0 / math.sqrt(noise)
    z = below * per_sigma
    silent = had_to_clip | far
    rise = hazard(z)
    score = 0.0 if silent else t * rise * per_sigma
    information = 0.0 if silent else t * t * rise * (rise - z) * (per_sigma * per_sigma)
    return score, information, far & (not had_to_clip) & (expected > 0.1 * clips_at)


@compiled
def with_censored(
    rate: float, variance: float, pattern: Any, frames: Any, begin: int, end: int, kappa: float
) -> tuple[float, float, bool]:  # pragma: no cover (compiled)
    """Return (rate, variance, contradiction) after frames from `begin` to `end` that clipped are included."""
    from_others = 1.0 / variance
    estimate, information, contradiction = rate, from_others, False
    for _ in range(2):
        score, total = (rate - estimate) * from_others, from_others
        for i in range(begin, end):
            if (pattern >> np.uint64(i)) & np.uint64(1):
                continue
            t, c, clips_at = frames[i, 0], frames[i, 5], frames[i, 2]
            rise, sharper, contradicts = censored_score(estimate, rate, variance, t, c, clips_at, kappa)
            score, total, contradiction = score + rise, total + sharper, contradiction | contradicts
        estimate += score / total
        information = total
    return estimate, 1.0 / information, contradiction


@compiled
def near_clipping(
    rate: float, variance: float, pattern: Any, slot: int, records: Any, frames: Any, kappa: float
) -> tuple[float, float, bool]:  # pragma: no cover (compiled)
    """Return (rate, variance, contradiction) after those frames were included that need not have clipped at a rate."""
    begin, end = 0, frames.shape[0]
    if rate >= records[slot, NEXT]:  # the others had to clip: only one frame has something to say
        begin = int(records[slot, NEAREST])
        end = begin + 1
    return with_censored(rate, variance, pattern, frames, begin, end, kappa)


@compiled
def above_black(
    rate: float, variance: float, share: float, pattern: Any, record: Any, frames: Any, kappa: float
) -> tuple[float, float]:  # pragma: no cover (compiled)
    """Return (rate, variance) without the excess of frames that count only where they are not cut off at black.

    Let a normal variable of mean m and deviation σ be known to be above b, and h be the hazard at z = (b − m)/σ. Its
    mean is m + σ·h, its variance σ²·(1 − h·(h − z)) (Johnson, Kotz and Balakrishnan 1994, 10.1).

    Args:
        share: Share of the first of the two estimates that the rate mixes.
    """
    estimate, lost, whole = rate, 0.0, 0.0
    of_a, of_b = share * record[INV1], (1.0 - share) * record[INV2]
    for _ in range(2):
        excess, lost, whole = 0.0, 0.0, 0.0
        for i in range(frames.shape[0]):
            if not (pattern >> np.uint64(i)) & np.uint64(1):
                continue
            t = frames[i, 0]
            weight = of_a * frames[i, 8] + of_b * t
            noise = frames[i, 7] + kappa * max(estimate, 0.0) * t
            whole += weight * weight * noise
            above = estimate * t - frames[i, 6]
            if above * above < CENSORED_SIGMA**2 * noise or above < 0.0:
                sigma = math.sqrt(noise)
                rise = hazard(-above / sigma)
                excess += weight * sigma * rise
                lost += weight * weight * noise * rise * (rise + above / sigma)
        estimate = rate - excess
    return estimate, variance * (1.0 - lost / whole) if whole > 0.0 else variance


@compiled
def marks(rate: float, variance: float) -> Any:  # pragma: no cover (compiled)
    """Return the mask of a pixel that is below the noise, or of one that is not."""
    below = (rate < 0.0) | (rate * rate < NOISE_FLOOR_SIGMA**2 * variance)
    return BELOW_NOISE if below else np.uint8(0)


@compiled_apart
def straight(
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    slots: Any,
    records: Any,
    dark: bool,
    rates: Any,
    variances: Any,
    mask: Any,
    doubtful: Any,
) -> None:  # pragma: no cover (compiled)
    """Write rate, variance and mask of a run of pixels, and of which of them `finish` has more to say.

    Args:
        first: Σt^0.35·x, float32.
        second: Σt·x, float32.
        squares: Σx², float32.
        bits: Frames used in each pixel.
        slots: Place of their record, unsigned.
        dark: Whether the frames have a common uncertainty of the dark level.
        rates: Written.
        variances: Written.
        mask: PixelMask bits, written where there is no more to say.
        doubtful: Whether there is (`ONLY_NEAR_CLIPPING` where that is all), written.
    """
    # Frames that clip are included before what is common to all.
    near = np.uint8(ONLY_NEAR_CLIPPING | 1) if dark else ONLY_NEAR_CLIPPING
    for i in range(bits.size):
        k = slots[i]
        sum_b = np.float64(second[i])
        rate_b = sum_b * records[k, INV2]
        apart = np.float64(first[i]) * records[k, INV1] - rate_b
        seen = max(rate_b, 0.0)
        share = (records[k, P0] + records[k, P1] * seen) / (records[k, R0] + records[k, R1] * seen)
        seen = max(rate_b + share * apart, 0.0)
        of_b, of_both = records[k, P0] + records[k, P1] * seen, records[k, R0] + records[k, R1] * seen
        inverse, gap = 1.0 / of_both, of_both - of_b
        share = of_b * inverse
        rate = rate_b + share * apart
        variance = records[k, A0] + records[k, A1] * seen - gap * gap * inverse
        if dark:
            common = records[k, D2] + share * (records[k, D1] - records[k, D2])
            variance += common * common
        scatter = np.float64(squares[i]) - rate * (2.0 * sum_b - rate * records[k, S2])
        plenty = records[k, PLENTY0] + records[k, PLENTY1] * seen
        rates[i], variances[i] = rate, variance
        more = np.uint8((scatter > plenty) | (bits[i] == 0) | (rate < records[k, DIM]))
        doubtful[i] = more | near if rate < records[k, NEAR] else more
    for i in range(bits.size):
        mask[i] = mask[i] if doubtful[i] else marks(rates[i], variances[i])


@compiled
def straight_curved(
    sums: Any, slots: Any, kept: Any, tables: Any, quantisation: Any, rates: Any, variances: Any, doubtful: Any
) -> None:  # pragma: no cover (compiled)
    """Do as `straight` does behind a response curve, in half of the time of `_single`; the others are `finish`'s."""
    first, second, squares, bits, mask = sums
    _, records, levels = kept
    frames, kappa, _, gains, _, top, valid = tables
    steps, last = levels.shape[1] - 1, np.uint64(0)
    for i in range(bits.size):
        pattern, slot = np.uint64(bits[i]), slots[i]
        doubtful[i] = 1
        if pattern == 0:
            continue
        if pattern != last:
            last, longest = pattern, int(records[slot, LONGEST])
            of_longest, per_root = frames[longest, 0] * gains[longest], records[slot, ROOT] * steps
            inv1, inv2, s2, near = records[slot, INV1], records[slot, INV2], records[slot, S2], records[slot, NEAR]
            plenty, d1, d2, dim = records[slot, PLENTY], records[slot, D1], records[slot, D2], records[slot, DIM]
        sum_b = np.float64(second[i])
        rate_b = sum_b * inv2
        apart = np.float64(first[i]) * inv1 - rate_b
        place = math.sqrt(max(rate_b, 0.0)) * per_root
        if not FIRST_LEVEL <= place < steps:
            continue
        k = int(place)
        if levels[slot, k, VARIANCE] == 0.0 or levels[slot, k + 1, VARIANCE] == 0.0:
            fill_levels(k, pattern, records[slot], levels[slot], frames, gains, kappa, quantisation, top)
        share = levels[slot, k, SHARE] + (place - k) * (levels[slot, k + 1, SHARE] - levels[slot, k, SHARE])
        place = math.sqrt(max(rate_b + share * apart, 0.0)) * per_root
        if not FIRST_LEVEL <= place < steps:
            continue
        k = int(place)
        above = place - k
        if levels[slot, k, VARIANCE] == 0.0 or levels[slot, k + 1, VARIANCE] == 0.0:
            fill_levels(k, pattern, records[slot], levels[slot], frames, gains, kappa, quantisation, top)
        share = levels[slot, k, SHARE] + above * (levels[slot, k + 1, SHARE] - levels[slot, k, SHARE])
        variance = levels[slot, k, VARIANCE] + above * (levels[slot, k + 1, VARIANCE] - levels[slot, k, VARIANCE])
        total = levels[slot, k, TOTAL] + above * (levels[slot, k + 1, TOTAL] - levels[slot, k, TOTAL])
        rate = rate_b + share * apart
        scatter = np.float64(squares[i]) - rate * (2.0 * sum_b - rate * s2)
        if scatter > plenty * total:
            continue
        if rate < dim:
            rate, variance = above_black(rate, variance, share, pattern, records[slot], frames, kappa)
        level = max(rate, 0.0) * of_longest
        found = EXTRAPOLATED if (level < valid[0]) | (level > valid[1]) else np.uint8(0)
        if rate < near:
            rate, variance, contradiction = near_clipping(rate, variance, pattern, slot, records, frames, kappa)
            found |= INCONSISTENT if contradiction else np.uint8(0)
        variance += (d2 + share * (d1 - d2)) ** 2
        rates[i], variances[i], mask[i] = rate, variance, marks(rate, variance) | found
        doubtful[i] = 0


@compiled
def finish(sums: Any, kept: Any, tables: Any, quantisation: Any, image: Any) -> None:  # pragma: no cover (compiled)
    """Turn the sums of a block into radiance, standard uncertainty and mask.

    A first loop, for a linear sensor one without branches, works out every pixel; pixels about which there is more to
    say (frames that disagree, frames near clipping) are few and gone through again. A branch that no processor can
    foresee costs as much as a pixel's arithmetic.

    Args:
        sums: What was summed of each pixel: Σt^0.35·x and Σt·x, float32, which may be `radiance` and `u_radiance`
            themselves; Σx², float32; the frames used, as bits. Last, whether a frame was clipped at white, which is
            overwritten by PixelMask bits.
        kept: What is kept from block to block: sets of frames, their `records` and their `levels`.
        tables: The other `MergeTables.arguments`; their curve is None for a linear sensor.
        image: Radiance per rate, of every pixel or of all (size 1), float32; radiance and its standard uncertainty,
            written.
    """
    first, second, squares, bits, mask = sums
    known, records, levels = kept
    frames, kappa, _, gains, _, top, _ = tables
    factor, radiance, u_radiance = image
    rates, variances = np.empty(_RUN), np.empty(_RUN)
    slots, doubtful = np.empty(_RUN, np.uint16), np.empty(_RUN, np.uint8)
    start, dark = 0, bool(np.any(frames[:, 4] > 0.0))
    while start < bits.size:
        end = min(start + _RUN, bits.size)
        count = _find_sets(bits[start:end], slots, known, records, levels, frames, kappa, gains, top)
        end = start + count
        run = first[start:end], second[start:end], squares[start:end]
        these, seen = bits[start:end], mask[start:end]
        if quantisation is None:
            straight(*run, these, slots, records, dark, rates, variances, seen, doubtful)
        else:
            part = *run, these, seen
            straight_curved(part, slots, kept, tables, quantisation, rates, variances, doubtful)
        for i in range(count):
            if doubtful[i] == ONLY_NEAR_CLIPPING:
                rate, variance, contradiction = near_clipping(
                    rates[i], variances[i], np.uint64(these[i]), slots[i], records, frames, kappa
                )
                seen[i] = marks(rate, variance) | (INCONSISTENT if contradiction else np.uint8(0))
                rates[i], variances[i] = rate, variance
            elif doubtful[i]:
                rates[i], variances[i], seen[i] = _single(sums, kept, tables, quantisation, start + i, slots[i])
        scaled(rates[:count], variances[:count], factor, start, radiance, u_radiance)
        start = end


@compiled
def _find_sets(
    bits: Any, slots: Any, known: Any, records: Any, levels: Any, frames: Any, kappa: float, gains: Any, top: float
) -> int:  # pragma: no cover (compiled)
    """Write where the record of each pixel's set of frames is; return for how many pixels there was room.

    Records are filled in where they were not; one that is in the way of the first pixel is given up for it, one that
    earlier pixels of the run may need is not.
    """
    if _at_home(bits, known, slots):
        return int(bits.size)
    last, shift = np.uint64(known.size - 1), np.uint64(32)
    for i in range(bits.size):
        pattern = np.uint64(bits[i])
        place = int(((pattern * _HASH) >> shift) & last)
        if known[place] != pattern and pattern != 0:
            place = _place_of(pattern, known)
            if known[place] != pattern:
                if i > 0 and known[place] != 0:
                    return i
                known[place] = pattern
                fill_record(records[place], pattern, frames, kappa, gains, top)
                levels[place] = 0.0
        slots[i] = place
    return int(bits.size)


@compiled_apart
def _at_home(bits: Any, known: Any, slots: Any) -> bool:  # pragma: no cover (compiled)
    """Write the first place where each pixel's set of frames may be kept; return whether all are kept there."""
    last, shift, elsewhere = np.uint64(known.size - 1), np.uint64(32), np.uint64(0)
    for i in range(bits.size):
        pattern = np.uint64(bits[i])
        place = ((pattern * _HASH) >> shift) & last
        slots[i] = place
        elsewhere |= (known[place] ^ pattern) if pattern != 0 else np.uint64(0)
    return bool(elsewhere == 0)


@compiled
def _single(
    sums: Any, kept: Any, tables: Any, quantisation: Any, pixel: int, slot: int
) -> tuple[float, float, Any]:  # pragma: no cover (compiled)
    """Return rate, variance and mask of a pixel from its sums; arguments as `finish`, and where its record is."""
    _, records, levels = kept
    frames, kappa, bounds, gains, curve, top, valid = tables
    pattern, seen_of_clipping, scattered = np.uint64(sums[3][pixel]), sums[4][pixel], np.float64(sums[2][pixel])
    if pattern == 0:  # no frame shows this pixel unclipped
        white = seen_of_clipping & SATURATED
        bound = bounds[0] if white else bounds[1]
        return bound, bound**2, SATURATED if white else BELOW_NOISE
    inv1, inv2, s2, near = records[slot, INV1], records[slot, INV2], records[slot, S2], records[slot, NEAR]
    p0, p1, r0, r1 = records[slot, P0], records[slot, P1], records[slot, R0], records[slot, R1]
    a0, a1, v0, v1 = records[slot, A0], records[slot, A1], records[slot, V0], records[slot, V1]
    d1, d2 = records[slot, D1], records[slot, D2]
    rate_a, sum_b = np.float64(sums[0][pixel]) * inv1, np.float64(sums[1][pixel])
    rate_b = sum_b * inv2
    found, extra, level_u = np.uint8(0), 0.0, 0.0
    if quantisation is not None:
        longest = int(records[slot, LONGEST])
        of_longest, per_root = frames[longest, 0] * gains[longest], records[slot, ROOT] * (levels.shape[1] - 1)
        rate, share, variance, total = rate_b, 0.0, 0.0, 0.0
        for _ in range(2):
            place = math.sqrt(max(rate, 0.0)) * per_root
            if FIRST_LEVEL <= place < levels.shape[1] - 1:
                fill_levels(int(place), pattern, records[slot], levels[slot], frames, gains, kappa, quantisation, top)
                share, variance, total, extra = between_levels(levels[slot], place)
            else:
                share, variance, total, extra = at_rate(
                    rate, pattern, records[slot], frames, gains, kappa, quantisation, top
                )
            rate = rate_b + share * (rate_a - rate_b)
        # Frames may differ by what the curve is uncertain by, at the level of the longest.
        level = max(rate, 0.0) * of_longest
        level_u = from_root_table(level, curve, top)
        if level < valid[0] or level > valid[1]:
            found |= EXTRAPOLATED
    else:
        seen = max(rate_b, 0.0)
        rate = rate_b + (p0 + p1 * seen) / (r0 + r1 * seen) * (rate_a - rate_b)
        seen = max(rate, 0.0)
        of_b, of_both = p0 + p1 * seen, r0 + r1 * seen
        share, gap = of_b / of_both, of_both - of_b
        rate = rate_b + share * (rate_a - rate_b)
        variance, total = a0 + a1 * seen - gap * gap / of_both, v0 + v1 * seen
    scatter = scattered - rate * (2.0 * sum_b - rate * s2)
    if scatter > records[slot, PLENTY] * total:
        if quantisation is None:
            extra = records[slot, CC] + kappa * seen * (2.0 * records[slot, C1] + kappa * seen * s2)
        # Satterthwaite 1946 for the degrees of freedom.
        tolerance = (bounds[2] ** 2 + (AGREEMENT_SIGMA * level_u) ** 2) * rate**2 * s2
        if scatter > total * scatter_limit(total**2 / extra) + tolerance:
            found |= INCONSISTENT
    if rate < records[slot, DIM]:
        rate, variance = above_black(rate, variance, share, pattern, records[slot], frames, kappa)
    if rate < near:
        rate, variance, contradiction = near_clipping(rate, variance, pattern, slot, records, frames, kappa)
        if contradiction:
            found |= INCONSISTENT
    dark = d2 + share * (d1 - d2)
    variance += dark * dark
    return rate, variance, found | marks(rate, variance)


@compiled
def finish_moved(
    sums: Any, kept: Any, tables: Any, quantisation: Any, pixels: Any, own_ends: Any, found: Any
) -> None:  # pragma: no cover (compiled)
    """Do as `_single` does for pixels whose frames end elsewhere or have more noise; arguments as `finish`.

    Args:
        pixels: Their places.
        own_ends: x by which the ends of each frame are lower there, and how much more variance of x it has, each of
            shape (pixels, frames).
        found: Rates, variances and masks of these pixels, written.
    """
    bits, (known, records, levels) = sums[3], kept
    frames, kappa, bounds, gains, curve, top, valid = tables
    own, limits, record, slots = frames.copy(), bounds.copy(), np.zeros((1, RECORD_SIZE)), np.empty(1, np.uint16)
    lower, noisier = own_ends
    singly = np.zeros((1, 2, LEVEL_SIZE))  # too few levels to stand between: `_single` works out each pixel
    for j in range(pixels.size):
        i = pixels[j]
        own[:, 2], own[:, 6] = frames[:, 2] - lower[j], frames[:, 6] - lower[j]
        for k in (1, 5, 7):
            own[:, k] = frames[:, k] + noisier[j]
        own[:, 3] = np.sqrt(frames[:, 3] ** 2 + noisier[j])
        limits[0] = max(np.max(own[:, 2] / own[:, 0]), bounds[1])
        slots[0] = 0
        _find_sets(bits[i : i + 1], slots, known, records, levels, frames, kappa, gains, top)
        if bits[i]:
            fill_record(record[0], np.uint64(bits[i]), own, kappa, gains, top)
        slot = slots[0]
        found[0][j], found[1][j], found[2][j] = _single(
            sums,
            (known, record, levels[slot : slot + 1] if noisier[j].max() == 0.0 else singly),
            (own, kappa, limits, gains, curve, top, valid),
            quantisation,
            i,
            0,
        )


@compiled
def _place_of(pattern: Any, known: Any) -> int:  # pragma: no cover (compiled)
    """Return where a set of frames is kept, or is to be kept in place of what is there."""
    last = int(known.size) - 1
    place = int((pattern * _HASH) >> np.uint64(32)) & last
    for _ in range(_PROBES):
        if known[place] == pattern or known[place] == 0:
            return place
        place = (place + 1) & last
    return place


@compiled
def scaled(
    rates: Any, variances: Any, factor: Any, start: int, radiance: Any, u_radiance: Any
) -> None:  # pragma: no cover (compiled)
    """Write rates and the roots of their variances, times the factor, from the pixel `start` on."""
    end = start + rates.size
    value, u = radiance[start:end], u_radiance[start:end]
    if factor.size > 1:
        place = factor[start:end]
        for j in range(rates.size):
            value[j] = rates[j] * place[j]
        for j in range(rates.size):
            u[j] = math.sqrt(variances[j]) * place[j]
        return
    scale = factor[0]
    for j in range(rates.size):
        value[j] = rates[j] * scale
    for j in range(rates.size):
        u[j] = math.sqrt(variances[j]) * scale

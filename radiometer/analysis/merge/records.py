"""Records of the merge's last step on a set of frames: how their sums become a rate, and its variance.

For independent samples x_i = E·t_i + noise with variance v_i = c_i + κ·E·t_i the maximum-likelihood weights are
t_i/v_i. They depend on E, which a stream does not know yet, and weights that follow the noisy sample itself are
biased. Two sums with fixed weights, Σt^0.35·x and Σt·x, give two unbiased estimates of E. The mixture of least
variance follows from E at the end. Its variance is within 1.5 % of the optimum over all ladders of 4 to 16 frames and
all ratios of read to shot noise. With the powers 0 and 1 it would be 8 %. The error of that mixture is uncorrelated
with the difference of the two estimates, so choosing it by the estimated E brings no bias to first order
(Gauss–Markov).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.compiled import compiled

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
RECORD_SIZE = 24
FIRST_POWER = 0.35
# A frame expected to clip by more than this says nothing new: its censored score is below 0.001 sigma.
CENSORED_SIGMA = 3.5
# The scatter of a pixel's frames, and what a curve's uncertainty excuses of it. Beyond five standard deviations a
# normal error comes once in 3.5 million. So hardly a pixel of a picture is called inconsistent by chance.
AGREEMENT_SIGMA = 5.0
# A frame that clipped, though the others put it this far below clipping. This is checked in every frame of every
# pixel, up to a hundred times as often as the scatter. So its chance must be as much smaller (one in a thousand
# million).
CONTRADICTION_SIGMA = 6.0


@compiled
def scatter_limit(freedom: float) -> float:  # pragma: no cover (compiled)
    """Return by how much Σ(x − E·t)² may exceed its expectation, at `AGREEMENT_SIGMA`.

    Args:
        freedom: Degrees of freedom.

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

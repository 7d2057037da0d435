"""Response recovery after Robertson, Borman and Stevenson 1999: radiance and response in turns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radiometer.analysis.response.curves import finished_curve, supported_range
from radiometer.analysis.response.debevec1997 import curve_debevec1997, without_noise_shift
from radiometer.analysis.response.estimate import ResponseEstimate, compare_thirds
from radiometer.analysis.response.samples import ResponseSamples, gather_samples, u_by_groups
from radiometer.data.frame import Bracket
from radiometer.data.response_curve import ResponseCurve
from radiometer.one_thread import on_one_blas_thread
from radiometer.typing import Array

METHOD = "robertson1999"
# Nodes of I(M): one per digital number at 8 bits, then straight lines in between.
_NODES = 256
_ITERATIONS = 30
# The iteration has no smoothing: what it still moves by less than this is noise that it begins to follow.
_STILL = 1e-3
# The Gaussian weight at black and saturation, taken off so that it is 0 there (as OpenCV and pfstools do).
_LEAST_WEIGHT = float(np.exp(-4.0)) * (1.0 - 1e-3)


@on_one_blas_thread
def recover_response_robertson1999(brackets: Bracket | Sequence[Bracket]) -> ResponseEstimate:
    """Recover I(M), the exposure behind every digital number, from all pixels by Robertson's iteration.

    In turns, with I(M_mid) = 1: x_p = Σ_i w t_i I(M_pi) / Σ_i w t_i² and I(m) = mean of t_i x_p over all samples of
    value m. The Gaussian weight is w(m) = exp(−4 (m − m_mid)²/m_mid²) less its value at the ends. Changed from the
    paper: a pixel is the mean of equally bright ones and counts once for each of them. Above 8 bits, I has 256 nodes
    with straight lines between. The first guess is Debevec and Malik's curve instead of a straight line. Exposures a
    stop apart cannot see a wave of one stop's period, which stays as in the first guess. A first guess of a straight
    line or a power law would fold its whole distance from the camera's curve into such a wave. There is no smoothing
    beyond that of the first guess; the iteration ends when it begins to follow the noise. The uncertainty is a
    grouped jackknife's, every part iterated as often as the whole, together with the first guess's.

    Args:
        brackets: One bracket or several taken with the same response.

    Raises:
        InputError: If the brackets do not fit together or hold one exposure only.
        MeasurementError: If everything is clipped or the exposures do not overlap.

    Source: M. Robertson, S. Borman, R. Stevenson, ICIP 1999, section 3, and J. Electron. Imaging 12 (2003) 219.
    """
    samples = gather_samples(brackets)
    first = curve_debevec1997(samples)
    samples = without_noise_shift(samples, first)
    guess = np.exp(np.interp(_nodes(samples), np.arange(first.log_exposure.size), first.log_exposure))
    exposure, residual, rounds = _iterate(samples, guess)

    def values(part: ResponseSamples) -> Array:
        return _log_curve(samples, _iterate(part, guess, rounds)[0])

    u = u_by_groups(samples, values)
    thirds = [_curve(part, values(part), u * 3**0.5) for part in (samples.third(k) for k in range(3))]
    curve = _curve(samples, _log_curve(samples, exposure), np.hypot(u, first.u_log_exposure))
    return ResponseEstimate.of(
        samples,
        curve,
        METHOD,
        residual_rms_log=residual,
        smoothing=0.0,
        stability=compare_thirds(thirds, curve),
    )


def _nodes(samples: ResponseSamples) -> Array:
    return np.linspace(0.0, (1 << samples.bit_depth) - 1.0, min(_NODES, 1 << samples.bit_depth))


def _weight(samples: ResponseSamples) -> Array:
    middle = 0.5 * (samples.limits.black_dn + samples.limits.saturated_dn)
    half = 0.5 * (samples.limits.saturated_dn - samples.limits.black_dn)
    return np.asarray((np.exp(-4.0 * ((samples.dn - middle) / half) ** 2) - _LEAST_WEIGHT) * samples.pixels)


def _iterate(samples: ResponseSamples, exposure: Array, rounds: int | None = None) -> tuple[Array, float, int]:
    """Return I at the nodes, the weighted rms residual in ln H, and the rounds: as many as given, or to rest."""
    nodes = _nodes(samples)
    position = samples.dn / nodes[1]
    floor = np.minimum(position.astype(np.intp), nodes.size - 2)
    part = position - floor
    time = np.exp(samples.log_time - samples.log_time.mean())
    weight = _weight(samples)
    starts = np.flatnonzero(np.diff(samples.group, prepend=-1))
    squared_time = np.add.reduceat(weight * time**2, starts)
    below, above = samples.pixels * (1.0 - part), samples.pixels * part
    count = np.bincount(floor, below, nodes.size) + np.bincount(floor + 1, above, nodes.size)
    seen = count > 0
    current = np.array(exposure)
    predicted = np.empty_like(time)
    done = 0
    for _ in range(rounds or _ITERATIONS):
        done += 1
        found = (1.0 - part) * current[floor] + part * current[floor + 1]
        radiance = np.add.reduceat(weight * time * found, starts) / squared_time
        predicted = time * radiance[samples.group]
        # A sample between two nodes moves both by its ratio, in proportion to its nearness.
        ratio = predicted / np.maximum(found, 1e-12)
        moved = np.bincount(floor, below * ratio, nodes.size) + np.bincount(floor + 1, above * ratio, nodes.size)
        step = np.where(seen, moved / np.maximum(count, 1e-12), 1.0)
        updated = current * step
        updated = updated / np.interp(0.5 * (nodes[-1] + 1.0), nodes, updated)
        still = float(np.max(np.abs(np.log(updated[seen] / current[seen])))) < _STILL
        current = updated
        if still and rounds is None:
            break
    found = (1.0 - part) * current[floor] + part * current[floor + 1]
    residual = np.log(np.maximum(found, 1e-12) / np.maximum(predicted, 1e-12))
    residual = residual - np.average(residual, weights=weight)
    return current, float(np.sqrt(np.average(residual**2, weights=weight))), done


def _log_curve(samples: ResponseSamples, exposure: Array) -> Array:
    dn = np.arange(1 << samples.bit_depth, dtype=np.float64)
    g = np.interp(dn, _nodes(samples), np.log(np.maximum(exposure, 1e-12)))
    return np.asarray(g - g[dn.size // 2])


def _curve(samples: ResponseSamples, g: Array, u: Array) -> ResponseCurve:
    return finished_curve(
        g,
        u,
        supported_range(samples),
        method=METHOD,
        channel=samples.channel,
        black_dn=samples.limits.no_light_dn,
        assumptions=("noise equal for all digital numbers of one exposure time",),
    )

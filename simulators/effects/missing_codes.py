"""An output that leaves out codes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from simulators.effects.base import DIGITAL_NUMBER, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.rounding import rounded_normal
from simulators.effects.tile_moments import TileMoments

_SAMPLES: Final = 4096  # of one step, for its Fourier series
_HARMONICS: Final = 8
_NARROW: Final = 0.2  # of a step, below which noise resolves more harmonics
_PER_CODE: Final = 2  # harmonics per code where single codes are left out
_STEPS: Final = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 32.0, 64.0, 128.0, 256.0)


@cache
def _series(step: int, kept: int) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the Fourier coefficients of what is cut off within a step, and of its square, the constant first."""
    x = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * step
    cut = x - np.minimum(np.floor(x), kept - 1.0) if kept > 1 else x
    count = _HARMONICS if kept == 1 else max(_HARMONICS, _PER_CODE * step)
    shift = np.exp(-1j * np.pi * np.arange(count + 1) / _SAMPLES)  # samples lie in the middle of their cells
    first, second = (np.fft.fft(values)[: count + 1] / _SAMPLES * shift for values in (cut, cut**2))
    return first, second


def _expected(u: Signal, variance: Signal, step: int, kept: int) -> tuple[Signal, Signal, Signal]:
    """Return the mean of what is cut off from a normal variable, of its square, and the derivative of the former."""
    cut, square, slope = _by_series(u, variance, step, kept)
    narrow = np.broadcast_to(variance < (_NARROW * step) ** 2, u.shape)
    if kept == 1 and narrow.any():  # more harmonics than the series has; few borders between codes instead
        at, spread2 = u[narrow], np.broadcast_to(variance, u.shape)[narrow]
        code, left2, rise = rounded_normal(at / step - 0.5, spread2 / step**2)
        cut[narrow], slope[narrow] = at - step * code, 1.0 - rise
        square[narrow] = step**2 * left2 + cut[narrow] ** 2 + spread2 * (1.0 - 2.0 * rise)
    return cut, square, slope


def _by_series(u: Signal, variance: Signal, step: int, kept: int) -> tuple[Signal, Signal, Signal]:
    first, second = _series(step, kept)
    cut, square, slope = (np.full_like(u, value) for value in (first[0].real, second[0].real, 0.0))
    turn, turned = np.exp(2j * np.pi / step * u), np.ones_like(u, dtype=np.complex128)
    for h in range(1, first.size):
        rate = 2.0 * np.pi * h / step
        turned = turned * turn
        wave = 2.0 * np.exp(-0.5 * rate**2 * variance) * turned
        cut += (first[h] * wave).real
        square += (second[h] * wave).real
        slope += (1j * rate * first[h] * wave).real
    return cut, square, slope


@dataclass(frozen=True)
class MissingCodes(CatalogueEffect):
    """Keeps only the first k of every q codes: y' = q·⌊z/q⌋ + min(z mod q, k − 1), z = y + a; for k = 1 each q-th.

    A coarser converter cuts (a = 0) or rounds to the nearest of its codes (a = ⌊q/2⌋), which lifts the mean by as much.
    Moments are those of a quantised normal variable, exact also where the noise is below the step.

    Source: reduced bit depth behind a wider output; missing codes of a converter.
    """

    name = "missing_codes"
    stage = Stage.DIGITAL
    unit_in = unit_out = DIGITAL_NUMBER
    where = "signal"
    block = "comb"
    is_stepwise = True
    trials = (
        *({"step_codes": step} for step in _STEPS),
        *({"step_codes": step, "added_codes": step // 2.0} for step in _STEPS),
        {"step_codes": 3.0, "kept_codes": 2.0},
        {"step_codes": 4.0, "kept_codes": 2.0},
        {"step_codes": 4.0, "kept_codes": 3.0},
        {"step_codes": 8.0, "kept_codes": 7.0},
        {"step_codes": 16.0, "kept_codes": 15.0},
    )
    fitted = ()
    settles = "any capture with noise above three steps"
    step_codes: float = parameter(1.0, "1", 1.0, 1e9, source="period of the codes that occur")
    kept_codes: float = parameter(1.0, "1", 1.0, 1e9, source="codes of each period that occur")
    added_codes: float = parameter(0.0, "1", 0.0, 1e9, source="half a step where it is rounded to the nearest")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        lifted = signal + self.added_codes
        whole = self.step_codes * np.floor((lifted + 1e-6) / self.step_codes)
        return cast(Signal, whole + np.clip(np.floor(lifted - whole + 1e-6), 0.0, self.kept_codes - 1.0))

    def keeps_only_every(self, period: int) -> bool:
        return self.kept_codes == 1.0 and self.step_codes % period == 0.0

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        # What is cut off follows from the value in front of the rounding; cutting is lower by half a code.
        before = before.unrounded or before
        narrow2 = np.maximum(before.variance, 1e-6)
        u = before.mean + 0.5 + self.added_codes
        spread2 = narrow2 + before.spatial_variance
        cut, square, slope = _expected(u, spread2, round(self.step_codes), round(self.kept_codes))
        variance = np.maximum(narrow2 + square - cut**2 - 2.0 * narrow2 * slope, 0.0)
        # What pixels share goes by the mean slope, which no variable has beyond what its own variance becomes.
        most = np.sqrt(variance / narrow2)
        shared = before.passed(u - cut, np.clip(1.0 - slope, -most, most))
        after = shared.changed(variance=variance, spatial_variance=before.spatial_variance, unrounded=before)
        if not isinstance(after, TileMoments):
            return after
        return after.changed(comb_step=self.step_codes, comb_kept=self.kept_codes)

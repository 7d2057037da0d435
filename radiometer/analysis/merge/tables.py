"""The tables that the merge's last step looks things up in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge.frames import FrameTerms
from radiometer.analysis.merge.moments import LEVEL_SIZE
from radiometer.analysis.merge.records import RECORD_SIZE
from radiometer.analysis.signal.model import SignalModel
from radiometer.typing import Array

_ROOT_TABLE_SIZE = 2048
# Sets of frames, a power of 2: a bracket of 16 has some hundred; memory is taken by those that occur.
_KEPT_SETS = 256
# Frames that agree to this are consistent whatever the noise; more slack where the noise is only a typical one.
_AGREEMENT_REL = 0.01
_AGREEMENT_ASSUMED_REL = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class MergeTables:
    """What the merge's last step is given besides the pixels.

    Attributes:
        frames: As in `records.fill_record`.
        kappa: Shot noise variance per unit of x.
        bounds: Rate that is the lower bound where all frames clip, the upper bound where all are black, and the
            relative difference between frames that is never called inconsistent.
        gains: Gain factor of every frame.
        quantisation: Variance (dx/dM)²/12 over √x; None for a linear sensor.
        curve: Relative standard uncertainty of x over √x; None for a linear sensor.
        top: x of the last entry of both.
        valid: Lowest and highest x times gain that the response curve has data for.
    """

    frames: Array
    kappa: float
    bounds: Array
    gains: Array
    quantisation: Array | None
    curve: Array | None
    top: float
    valid: Array

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
        entries = np.arange(_ROOT_TABLE_SIZE)
        return variance + np.interp(place, entries, self.quantisation) / gains**2, np.interp(place, entries, self.curve)


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

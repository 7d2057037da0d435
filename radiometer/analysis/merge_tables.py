"""The tables that the merge's last step looks things up in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge_finish import RECORD_SIZE, fill_record
from radiometer.analysis.merge_frames import FrameTerms
from radiometer.analysis.merge_response import SignalModel

_ROOT_TABLE_SIZE = 2048
# Frames that agree to this are consistent whatever the noise; more slack where the noise is only a typical one.
_AGREEMENT_REL = 0.01
_AGREEMENT_ASSUMED_REL = 0.1
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MergeTables:
    """What the merge's last step is given besides the pixels; its attributes are named as in `finish_curved`."""

    frames: Array
    patterns: NDArray[np.uint64]
    records: Array
    kappa: float
    bounds: Array
    gains: Array
    curved: tuple[Array, Array, float, Array] | None

    @property
    def common(self) -> tuple[Any, ...]:
        """Return the arguments that `finish_linear` and `finish_curved` share, in their order."""
        return self.frames, self.patterns, self.records, self.kappa, self.bounds


def merge_tables(terms: Sequence[FrameTerms], model: SignalModel) -> MergeTables:
    """Return the tables for a set of light frames.

    Args:
        terms: The frames in the order of their bits; exposures are counted in units of the first.
        model: Signal model of the camera.
    """
    reference = terms[0].exposure
    frames = np.array([[o.exposure / reference, o.variance, o.clips_at, o.sigma_clip, o.u_dark] for o in terms])
    kappa = 1.0 / model.electrons_per_unit
    patterns, records = _common_patterns(frames, kappa)
    agreement = _AGREEMENT_ASSUMED_REL if model.noise.assumed else _AGREEMENT_REL
    lower_bound = float((frames[:, 2] / frames[:, 0]).max())
    darkest = float((model.table(terms[0].settings)[1] - model.table(terms[0].settings)[0]) / frames[:, 0].max())
    return MergeTables(
        frames,
        patterns,
        records,
        kappa,
        np.array([lower_bound, darkest, agreement]),
        np.array([one.gain for one in terms]),
        None if model.linear else _root_tables(model),
    )


def _common_patterns(frames: Array, kappa: float) -> tuple[NDArray[np.uint64], Array]:
    """Return the sets of frames that occur where only the most sensitive ones clip, by their number of frames."""
    order = np.argsort(frames[:, 0] / frames[:, 2])
    patterns, records = np.zeros(len(order) + 1, np.uint64), np.zeros((len(order) + 1, RECORD_SIZE))
    pattern = 0
    for count, index in enumerate(order, start=1):
        pattern |= 1 << int(index)
        patterns[count] = pattern
        fill_record(records[count], np.uint64(pattern), frames, kappa)
    return patterns, records


def _root_tables(model: SignalModel) -> tuple[Array, Array, float, Array]:
    """Return quantisation variance and curve uncertainty over √x, the last x, and the x that the curve has data for."""
    top = float(model.signal[-1])
    signal = top * np.linspace(0.0, 1.0, _ROOT_TABLE_SIZE) ** 2
    dn = np.interp(signal, model.signal, np.arange(model.signal.size))
    quantisation = model.at_dn(model.slope, dn) ** 2 / 12.0
    return quantisation, model.at_dn(model.u_rel, dn), top, model.signal[list(model.valid_dn)]

"""The shutter, and exposure times that are not the stated ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np

from radiometer.units import exact_exposure_s, exact_f_number
from simulators.effects.base import EXPOSURE, IRRADIANCE, Effect, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, Scaling, elapsed_s
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class Shutter(Effect):
    """Collects light for the exposure time: H = E·t; none while it is closed."""

    name = "shutter"
    stage = Stage.SHUTTER
    unit_in = IRRADIANCE
    unit_out = EXPOSURE

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * self.slope(signal, context)

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return context.settings.exposure_s * (1.0 - context.settings.is_dark)


_MOST_GAINS: Final = 16  # more are a sweep: a start at each would only cost time


@dataclass(frozen=True)
class ExposureTimeOffset(Scaling):
    """Adds a constant to the exposure time: H' = H·(t + Δt)/t, with Δt + δ above a gain g₀; δ is 0 for one constant.

    Sensors change their read-out above some gain, and its timing with it.

    Source: ARTCAM-264IMX manual: exposure = lines × 13.28 µs + 13.73 µs; AVT, ExpOffset; typical 1 to 15 µs.
    """

    name = "exposure_time_offset"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    trials = (
        {"offset_s": 2e-06},
        {"offset_s": 1e-05},
        {"offset_s": -2e-06},
        {"offset_s": -1e-05},
        {"offset_s": 0.0001},
    )
    fitted = ("offset_s",)
    settles = "exposures down to ten times the offset at one source level"
    offset_s: float = parameter(0.0, "s", -0.1, 0.1, source="engineering prior; refined on a real rig")
    further_s: float = parameter(0.0, "s", -0.1, 0.1, source="change of the offset above a gain")
    above_db: float = parameter(0.0, "dB", -20.0, 100.0, source="that gain; between two of those in use")

    def factor(self, context: ExposureContext) -> Any:
        time = context.settings.exposure_s
        further: Any = 0.0
        if self.further_s:
            further = np.where(np.asarray(context.settings.gain_db) > self.above_db, self.further_s, 0.0)
        return np.maximum(time + self.offset_s + further, 0.0) / time

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the offsets that change between two of the gains in use."""
        gains = np.unique(np.asarray(context.settings.gain_db))
        if self.further_s or not 2 <= gains.size <= _MOST_GAINS:
            return ()
        between = (gains[1:] + gains[:-1]) / 2.0
        return tuple(self.with_parameters(further_s=self.offset_s / 10.0, above_db=g) for g in between.tolist())

    def free(self) -> tuple[str, ...]:
        return ("offset_s", "further_s") if self.further_s else ("offset_s",)


_LINE_TIMES_S: Final = np.geomspace(2e-6, 6e-5, 2400)  # so dense that sawteeth of a millisecond's lines are hit


@dataclass(frozen=True)
class ExposureQuantisation(Scaling):
    """Rounds the exposure time to whole lines: t' = q·⌊t/q + r⌋.

    r is 0 where the camera rounds down, 0.5 to the nearest, 1 up.

    Source: ARTCAM-264IMX manual: line time 13.28 µs; typical 5 to 30 µs.
    """

    name = "exposure_quantisation"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    is_stepwise = True
    log_prior_odds = -20.0
    prior_reason = "a grid of steps fits anything; a real one moves all short exposures and brings thousands of nats"
    trials = tuple({"quantum_s": float(q), "rounding": r} for r in (0.0, 0.5, 1.0) for q in _LINE_TIMES_S)
    fitted = ()
    settles = "four exposures within one line time of each other"
    quantum_s: float = parameter(1e-09, "s", 1e-09, 0.01, source="engineering prior; refined on a real rig")
    rounding: float = parameter(0.0, "1", 0.0, 1.0, source="0 down, 0.5 nearest, 1 up")

    profiled = "quantum_s"

    def factor(self, context: ExposureContext) -> Any:
        time = np.asarray(context.settings.exposure_s)
        lines = np.maximum(np.floor(time / self.quantum_s + self.rounding + 1e-9), 1.0)
        return self.quantum_s * lines / time


_ALWAYS_S: Final = 1e12  # beyond any time stamp
_FEW_EXPOSURES: Final = 3  # with up to three labels, one wrong one looks like a bent response


@dataclass(frozen=True)
class ExposureLabelError(Scaling):
    """Takes another exposure time for frames that bear one label (or several): H' = H·t_real/t_label.

    All frames of the label are meant, or only those taken between two times, where single captures were mislabelled.

    Source: stacks of photographs whose printed times disagree with their neighbours.
    """

    name = "exposure_label_error"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    log_prior_odds = -6.0
    prior_reason = "labels are seldom wrong, and one ratio per label explains whatever one setting shows"
    neutral_at_one = ("ratio",)
    trials = ({"label_s": 1.0, "ratio": 1.1},)
    fitted = ("ratio",)
    repeats = True
    settles = "neighbouring exposures, or the EXIF record"
    label_s: float = parameter(1.0, "s", 1e-09, 100000.0, source="the printed exposure time")
    ratio: float = parameter(1.0, "1", 0.001, 1000.0, source="real over printed")

    from_s: float = parameter(-_ALWAYS_S, "s", -_ALWAYS_S, _ALWAYS_S, source="time from which the label is wrong")
    to_s: float = parameter(_ALWAYS_S, "s", -_ALWAYS_S, _ALWAYS_S, source="time to which it is")
    further_s: tuple[float, ...] = parameter((), "s", 1e-09, 100000.0, source="further printed times that are wrong")
    further_ratios: tuple[float, ...] = parameter((), "1", 0.001, 1000.0, source="real over printed of these")
    further_from_s: tuple[float, ...] = parameter((), "s", -_ALWAYS_S, _ALWAYS_S, source="from when; empty for always")
    further_to_s: tuple[float, ...] = parameter((), "s", -_ALWAYS_S, _ALWAYS_S, source="to when; empty for always")

    def factor(self, context: ExposureContext) -> Any:
        stated, now = np.asarray(context.settings.exposure_s), np.asarray(elapsed_s(context))
        found: Any = 1.0
        for label, ratio, start, end in self._labels():
            meant = (np.abs(np.log(stated / label)) < 1e-6) & (start <= now) & (now <= end)
            found = found * np.where(meant, ratio, 1.0)
        return found

    def _labels(self) -> tuple[tuple[float, float, float, float], ...]:
        """Return label, ratio, and the times between which it holds, of all wrong labels."""
        always = (_ALWAYS_S,) * len(self.further_s)
        starts, ends = self.further_from_s or tuple(-t for t in always), self.further_to_s or always
        further = zip(self.further_s, self.further_ratios, starts, ends, strict=True)
        return ((self.label_s, self.ratio, self.from_s, self.to_s), *further)

    def free(self) -> tuple[str, ...]:
        return ("ratio", *(f"further_ratios[{i}]" for i in range(len(self.further_ratios))))

    def joined(self, other: CatalogueEffect) -> CatalogueEffect:
        """Return the effect with the label of another one too."""
        assert isinstance(other, ExposureLabelError)
        labels, ratios, starts, ends = zip(*self._labels()[1:], *other._labels(), strict=True)
        return self.with_parameters(further_s=labels, further_ratios=ratios, further_from_s=starts, further_to_s=ends)

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return one start per exposure in use, a little long and a little short, and per capture of several."""
        exposures, stamps = (np.ravel(np.asarray(v)) for v in (context.settings.exposure_s, elapsed_s(context)))
        times = np.unique(exposures)
        if times.size <= _FEW_EXPOSURES:
            return ()
        labels = [(float(t), -_ALWAYS_S, _ALWAYS_S) for t in times]
        if stamps.size == exposures.size and np.unique(stamps).size == stamps.size:
            order = np.sort(stamps)
            edges = np.concatenate([[-_ALWAYS_S], (order[1:] + order[:-1]) / 2.0, [_ALWAYS_S]])
            for stamp, exposure in zip(stamps.tolist(), exposures.tolist(), strict=True):
                if np.sum(exposures == exposure) > 1:
                    at = int(np.searchsorted(order, stamp))
                    labels.append((exposure, float(edges[at]), float(edges[at + 1])))
        return tuple(cls(t, ratio, start, end) for t, start, end in labels for ratio in (1.02, 0.98))


_NEAR: Final = 0.07  # 1/60 s is really 1/64 s: 6.7 %


def _each(exact: Callable[[float], float], printed: Any) -> Any:
    """Return exact over printed value of every entry."""
    values = np.asarray(printed, dtype=np.float64)
    return np.array([exact(float(value)) / float(value) for value in values.ravel()]).reshape(values.shape)


@dataclass(frozen=True)
class NominalSettings(Scaling):
    """Exposes for the exact stop behind a printed one: 1/60 s is 1/64 s, f/5.6 is f/5.657.

    `times` and `stops` say whether it holds for both (1 and 1), or for one of them alone.

    Source: ISO 2720 and camera practice: times and f-numbers run in thirds or halves of a stop.
    """

    name = "nominal_settings"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    is_stepwise = True
    trials = ({"times": 1.0, "stops": 1.0}, {"times": 1.0, "stops": 0.0}, {"times": 0.0, "stops": 1.0})
    fitted = ()
    settles = "nothing further: the exact stops are known"
    times: float = parameter(1.0, "1", 0.0, 1.0, source="a shutter timed by a quartz keeps exact stops")
    stops: float = parameter(1.0, "1", 0.0, 1.0, source="engraved stops of a fixed diaphragm may be true")

    def factor(self, context: ExposureContext) -> Any:
        """Return exact over printed exposure, f-number included."""
        time = _each(exact_exposure_s, context.settings.exposure_s)
        stop = np.ones(1) if context.f_number is None else _each(exact_f_number, context.f_number)
        return time**self.times / stop ** (2.0 * self.stops)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the exposures look like printed stops: all within 7 % of one, not all on it (1/60 is 1/64)."""
        ratio = np.asarray(_each(exact_exposure_s, context.settings.exposure_s))
        return bool(
            np.all(np.abs(ratio - 1.0) < _NEAR) and np.any(np.abs(ratio - 1.0) > 1e-3) and np.unique(ratio).size > 2
        )


@dataclass(frozen=True)
class ShutterDeadTime(CatalogueEffect):
    """Shortens every frame of a run but the first: H' = H·(t − Δt)/t in overlapped readout.

    With a growth g the k-th frame after the first loses Δt·(1 + g·(k − 1)); 0 where all lose alike.

    Source: C-BLUE user manual: dead times of 46 to 107 µs depending on the trigger.
    """

    name = "shutter_dead_time"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "first"
    log_prior_odds = -2.0
    prior_reason = "a constant added to the exposure is the usual error of timing"
    trials = ({"dead_time_s": 2e-06}, {"dead_time_s": 1e-05}, {"dead_time_s": 0.0001}, {"dead_time_s": -1e-05})
    fitted = ("dead_time_s",)
    further = ({"growth": 0.05},)
    settles = "single triggered frames and runs of frames at the shortest exposure"
    dead_time_s: float = parameter(0.0, "s", -0.01, 0.01, source="engineering prior; refined on a real rig")

    growth: float = parameter(0.0, "1", -1.0, 1.0, source="buffers fill up along a run")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the exposure; the first frame of a run has its full time."""
        return cast(Signal, (signal * self.slope(signal, context)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        frames: Any = getattr(context, "frames", None)
        if frames is None:
            after = context.frame_index
            return self._kept(1.0 + self.growth * (after - 1.0), context) if after > 0 else 1.0
        return 1.0 - (frames - 1.0) / frames * (1.0 - self._kept(self._usual(frames), context))

    def _kept(self, dead_times: Any, context: ExposureContext) -> Any:
        """Return the share of its exposure that a frame keeps which loses so many dead times; never below nothing."""
        return np.maximum(1.0 - dead_times * self.dead_time_s / context.settings.exposure_s, 0.0)

    def ordered_variance(self, signal: Signal, context: ExposureContext) -> Any:
        later: Any = getattr(context, "frames", 1.0) - 1.0
        step = self.growth * self.dead_time_s / context.settings.exposure_s
        return np.square(signal * step) * (later > 1.0) * later * (later + 1.0) / 12.0 if self.growth else 0.0

    def _usual(self, frames: Any) -> Any:
        """Return the mean dead time of the frames after the first over that of the second."""
        return 1.0 + self.growth * np.maximum(frames - 2.0, 0.0) / 2.0

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        usual = self._usual(np.asarray(getattr(context, "frames", 1.0)))
        gained = before.mean * (1.0 - self._kept(usual, context))
        return after.changed(first_excess=after.first_excess + gained)


@dataclass(frozen=True)
class RowDependentExposure(Scaling):
    """Exposes each row for a separate time: H' = H·(t + τ·r − a·t·r)/t, r the share of rows read before.

    Rows are cleared and read one after the other: unequal paces add the same time at every exposure, τ at the last row,
    of either sign; the part that scales with the exposure is a. A time added alone is what light does that leaks into
    rows which wait (`parasitic_light_sensitivity`), and a share lost alone what any shading of the sensor does:
    neither identifies this effect.

    Source: radiometric model of MicaSense RedEdge and Parrot Sequoia, L ∝ 1/(t + a₂·y − a₃·t·y), with the maker's a₂
    and a₃ in each frame. Over 960 rows 60 to 110 µs, and −1 to 6 %.
    """

    name = "row_dependent_exposure"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "image_y"
    block = "mean"
    also = ("slope",)
    trials = ({"added_s": -1e-05}, {"added_s": 1e-05}, {"added_s": -1e-04}, {"added_s": 1e-04})
    fitted = ("added_s", "lost_share")
    settles = "the gradient along image_y of an even field at several exposures, with the camera turned once"
    added_s: float = parameter(0.0, "s", -0.1, 0.1, source="at the last row: 60 to 110 µs in RedEdge's sensors")
    lost_share: float = parameter(0.0, "1", -0.5, 0.5, source="at the last row: −0.01 to 0.06 in the same")

    def factor(self, context: ExposureContext) -> Any:
        down = context.geometry.row_fraction()
        return np.maximum(1.0 + (self.added_s / context.settings.exposure_s - self.lost_share) * down, 0.0)


@dataclass(frozen=True)
class ParasiticLightSensitivity(Scaling):
    """Adds light during readout: H' = H·(1 + p·r^n/t), r the share of rows read before, p = leak × readout time.

    n is 1 where all rows leak alike. A leak takes nothing away: rows that are exposed for less time the later they are
    read are those of `row_dependent_exposure`.

    Source: Balluff note on parasitic light sensitivity: non-linear at short exposures, with a row gradient.
    """

    name = "parasitic_light_sensitivity"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "image_y"
    block = "mean"
    trials = ({"leak_s": 2e-06}, {"leak_s": 1e-05}, {"leak_s": 0.0001})
    fitted = ("leak_s",)
    further = ({"row_power": 1.05},)
    settles = "the gradient along image_y at the shortest exposure"
    leak_s: float = parameter(0.0, "s", 0.0, 0.01, source="1/PLS × readout time: 1/10000 × 10 ms = 1 µs")

    row_power: float = parameter(1.0, "1", 0.2, 5.0, source="shading of the storage nodes; 1 for none")

    def factor(self, context: ExposureContext) -> Any:
        """Return the factor of exposure, larger for rows that are read later."""
        waited = np.maximum(context.geometry.row_fraction(), 1e-6) ** self.row_power
        return 1.0 + self.leak_s * waited / context.settings.exposure_s

"""What earlier frames leave behind: lag, residual charge, and first frames unlike the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, RADIANCE, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect, Offset, Scaling, elapsed_s
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_REFERENCE_E: Final = 1000.0  # at which a power law releases the plain share
_LEAST_E: Final = 1.0  # a power below 1 is endless at nothing


@dataclass(frozen=True)
class ImageLag(UnitSlope, CatalogueEffect):
    """Adds a share of what the pixel held in the frame before: S' = S + l·S_prev, or less where traps fill up.

    Traps that hold at most 1/c electrons release (1 − exp(−c·l·S_prev))/c; c = 0 is the plain share. Slow traps
    release a further share m of the frame before that one, which a single frame takes to be like the one before. Traps
    of many depths release by a power p: l·S_prev·(S_prev/1000 e-)^(p − 1).

    Each electron that stays by chance makes the remaining charge as noisy as light of as many electrons; what a
    barrier holds back, or a settling output stage, is a fixed share and adds none. The noise is a share of the
    former, 1 as a rule.

    Source: incomplete charge transfer; typical 0.01 to 0.5 %. Traps: first-order filling; of many depths a
    power between a half and 1 (engineering prior). Noise: thinning of a Poisson process.
    """

    name = "image_lag"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "full_well_saturation"
    where = "previous_frame"
    block = "mean"
    trials = ({"share": 0.002}, {"share": 0.01})
    fitted = ("share",)
    looks_back = True
    settles = "a bright capture followed at once by dark frames"
    share: float = parameter(0.0, "1", -0.2, 0.2, source="engineering prior; refined on a real rig")
    older_share: float = parameter(0.0, "1", -0.1, 0.1, source="traps empty over several frames")
    fullness_per_e: float = parameter(0.0, "e-1", 0.0, 10.0, source="1 over the electrons that the traps hold")
    power: float = parameter(1.0, "1", 0.2, 2.0, source="traps of many depths: below 1")
    noise: float = parameter(1.0, "1", 0.0, 1.0, source="1 where each electron stays by chance, 0 for a fixed share")

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the form whose traps fill up, and the one of a power."""
        return (cls(share=0.002, fullness_per_e=0.05), cls(share=0.002, power=0.6))

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return forms by another law (traps that fill up, slow ones, a power), and the one with less noise."""
        forms = [self.with_parameters(noise=0.5)] if self.noise == 1.0 else []
        if self.fullness_per_e == 0.0 and not self.older_share and self.power == 1.0:
            forms.append(self.with_parameters(fullness_per_e=0.05))
            forms.append(self.with_parameters(older_share=0.1 * self.share))
            forms.append(self.with_parameters(power=0.7))
        return tuple(forms)

    def free(self) -> tuple[str, ...]:
        """Return the share, its law's further parameters (fullness, the older frame's, the power), and a lesser
        noise."""
        further = {"power": self.power != 1.0, "older_share": bool(self.older_share)}
        law = next((name for name, used in further.items() if used), "fullness_per_e" if self.fullness_per_e else "")
        return ("share", *((law,) if law else ()), *(("noise",) if self.noise != 1.0 else ()))

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, (signal + self._left(signal, context)).astype(signal.dtype))

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return one outcome: what stays behind is drawn as light is, its scatter shrunk to the share that it has."""
        left = np.broadcast_to(np.maximum(self._left(signal, context), 0.0), signal.shape)
        scatter = np.sqrt(self.noise) * (rng.poisson(left) - left)
        return cast(Signal, (self.mean(signal, context) + scatter).astype(signal.dtype))

    def variance(self, signal: Signal, context: ExposureContext) -> Signal:
        return np.asarray(self.noise * np.maximum(self._left(signal, context), 0.0))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with the first frame's difference from the others, and with what noise hands on.

        What a pixel held by chance comes back by as much in the frame after: frames of a series are alike by ρ₁ = dr/dS
        of what is released, and by m one further. The scatter about their mean falls by 2·Σ(1 − k/n)·ρ_k/(n − 1) of
        the variance, and the mean's variance, which pixels show, rises by 2·Σ(1 − k/n)·ρ_k of what it is for noise.
        """
        previous, own = self._held(context.previous_e, context), self._held(before.mean, context)
        frames: Any = getattr(context, "frames", 1.0)
        counted = np.where(frames > 2, frames - 1.0, frames)  # the first of three or more is not among them
        alike = (self._rise(before.mean, context), self.older_share)
        calmer = _alike(alike, counted) / np.maximum(counted - 1.0, 1.0)
        return after.changed(
            variance=after.variance - calmer * before.variance,
            spatial_variance=after.spatial_variance + (_alike(alike, frames) + calmer) * before.variance / frames,
            first_excess=before.first_excess
            + self._released(previous, context)
            - self._released(own, context)
            + self._slow_first(previous, own, context),
        )

    def _slow_first(self, previous: Any, own: Any, context: ExposureContext) -> Any:
        """Return what slow traps give the first of n frames beyond the mean of the others, the second having it too."""
        frames: Any = getattr(context, "frames", 1.0)
        return self.older_share * (previous - own) * np.maximum(frames - 2.0, 0.0) / np.maximum(frames - 1.0, 1.0)

    def _left(self, signal: Signal, context: ExposureContext) -> Any:
        """Return the remainder of the frame before; n − 1 of a capture's n frames follow one of their kind."""
        frames: Any = getattr(context, "frames", None)
        if frames is None:
            previous = np.zeros(1, dtype=signal.dtype) if context.previous_e is None else context.previous_e
            return self._released(previous, context) + self.older_share * previous
        previous, signal = self._held(context.previous_e, context), self._held(signal, context)
        older = np.minimum(frames, 2.0)
        slow = self.older_share * (older * previous + (frames - older) * signal) / frames
        return (self._released(previous, context) + (frames - 1.0) * self._released(signal, context)) / frames + slow

    def _held(self, light: Any, context: ExposureContext) -> Any:
        """Return what frames of some light hold at their end: what those before them left behind, too."""
        if light is None:
            return np.zeros(1)
        return light + self._released(light, context) + self.older_share * light

    def _rise(self, held: Any, context: ExposureContext) -> Any:
        """Return d(released)/d(held)."""
        well = context.camera.full_well_e
        step = 1e-3 * np.maximum(held, _LEAST_E)
        rise = (self._released(held, context) - self._released(held - step, context)) / step
        return rise if well is None else np.where(held < well, rise, 0.0)

    def _released(self, held: Any, context: ExposureContext) -> Any:
        """Return the electrons that a frame leaves to the next; no pixel holds more than its full well."""
        well = context.camera.full_well_e
        held = held if well is None else np.minimum(held, well)
        lag = self.share * held
        if self.power != 1.0:
            return lag * (np.maximum(held, _LEAST_E) / _REFERENCE_E) ** (self.power - 1.0)
        if self.fullness_per_e <= 0:
            return lag
        filled = -np.expm1(-self.fullness_per_e * np.maximum(lag, 0.0)) / self.fullness_per_e
        return np.where(lag > 0, filled, lag)


def _alike(correlations: tuple[Any, ...], frames: Any) -> Any:
    """Return 2·Σ(1 − k/n)·ρ_k over the distances k of n frames."""
    return sum(2.0 * np.maximum(1.0 - k / frames, 0.0) * rho for k, rho in enumerate(correlations, start=1))


_RESTS_OF_TRAPS: Final = (2.0, 15.0, 100.0)  # intervals between frames within which traps let go, to start from


@dataclass(frozen=True)
class ResidualCharge(UnitSlope, CatalogueEffect):
    """Adds what is let go in an exposure t: S' = S + (1 − exp(−t/τ))·q·Σ S_j·exp(−Δt_j/τ) over all frames before.

    Each frame leaves a share q of its charge in traps, which empty within τ whatever the camera does; what comes free
    between two exposures is swept away. Dark frames behind a bright one have a rate that falls with the time.

    Source: residual bulk image of CCDs and persistence of infrared arrays; some 0.1 to 5 % of the charge, seconds to
    hours (Rest et al. 2002, Rev. Sci. Instrum. 73, 2028; Smith et al. 2008, Proc. SPIE 7021). First-order release.
    """

    name = "residual_charge"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "full_well_saturation"
    where = "previous_frame"
    block = "mean"
    trials = ({"share": 0.01, "tau_s": 30.0},)
    fitted = ("share", "tau_s")
    looks_back = True
    log_prior_odds = -3.0
    prior_reason = "cooled CCDs and infrared arrays have such traps, other sensors hardly"
    settles = "a bright capture followed by a row of long dark frames"
    share: float = parameter(0.0, "1", 0.0, 0.5, source="residual images of cooled CCDs: 0.1 to 5 %")
    tau_s: float = parameter(30.0, "s", 1e-3, 1e6, source="seconds to hours, by the sensor's temperature")

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return traps that let go within some of the intervals between frames, and within many."""
        since: Any = np.asarray(np.nan if context.since_frame_s is None else context.since_frame_s, dtype=np.float64)
        known = since[np.isfinite(since) & (since > 0)]
        usual_s = float(np.median(known)) if known.size else cls.tau_s / _RESTS_OF_TRAPS[0]
        return tuple(cls(0.01, float(np.clip(rests * usual_s, 1e-2, 1e5))) for rests in _RESTS_OF_TRAPS)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return context.past is not None

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, (signal + self._let_go(context)).astype(signal.dtype))

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        let_go = np.broadcast_to(self._let_go(context), signal.shape)
        return cast(Signal, (signal + rng.poisson(let_go)).astype(signal.dtype))

    def variance(self, signal: Signal, context: ExposureContext) -> Signal | float:
        return cast(Signal | float, self._let_go(context))

    @property
    def drifts(self) -> bool:
        return True

    def _let_go(self, context: ExposureContext) -> Any:
        if context.past is None:
            return 0.0
        exposure_s: Any = context.settings.exposure_s
        return self.share * -np.expm1(-exposure_s / self.tau_s) * context.past.faded(self.tau_s)


@dataclass(frozen=True)
class FirstFrameOffset(UnitSlope, CatalogueEffect):
    """Adds a constant to the first frame after a change of settings: y' = y + b in frame 0, y' = y in the others.

    Source: reset and reference levels that have not settled; the first bias frame of a CCD's series is off by 4 DN
    (SBIG STL-1001E).
    """

    name = "first_frame_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "previous_frame"
    block = "first"
    trials = ({"offset_dn": 0.5}, {"offset_dn": -0.5})
    fitted = ("offset_dn",)
    settles = "ten dark frames of one setting in a row"
    offset_dn: float = parameter(0.0, "DN", -0.25, 0.25, source="tenths of a DN to some DN", of_full_scale=True)

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return DN with the offset: of one frame if it is the first, of a series' mean its share."""
        frames: Any = getattr(context, "frames", None)
        share = float(context.frame_index == 0) if frames is None else 1.0 / np.asarray(frames)
        return cast(Signal, (signal + self.offset_dn * share).astype(signal.dtype))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        return after.changed(first_excess=before.first_excess + self.offset_dn)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return bool(np.max(np.asarray(getattr(context, "frames", 2.0))) > 1)


_TRIED_DN = 1.0  # a fit is linear in it: any size begins
_FEWEST = 3  # captures on either side of an event: fewer may be single frames that went wrong
_RESTS_BETWEEN_EVENTS = (3.0, 20.0)  # mean intervals between captures within which it relaxes
_SLOWEST_S = 600.0  # what takes longer is warmth: another temperature of the camera, not a zeroing


@dataclass(frozen=True)
class EventOffset(Offset):
    """Adds an offset that dies away after an event: y' = y + b·exp(−(t − t₀)/τ) from t₀ on, y' = y before.

    The event is known to be before the first frame that shows it, not better: t₀ is that frame's time, and is not
    fitted. What has not come back by the last capture is a step, which whatever changes once (a setting, a temperature)
    gives as well.

    Source: cameras that calibrate themselves behind a shutter, or zero themselves: tens of DN, relaxing within seconds
    to minutes (thermal cameras at each flat-field correction).
    """

    name = "event_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "timestamp_s"
    block = "mean"
    also = ("first",)
    log_prior_odds = -3.0
    prior_reason = "few cameras interrupt a session, and an event may be anywhere in it"
    trials = ({"offset_dn": _TRIED_DN, "tau_s": 30.0}, {"offset_dn": -_TRIED_DN, "tau_s": 30.0})
    fitted = ("offset_dn", "tau_s")
    essential = ("offset_dn",)  # where times follow the exposures, anything that bends along them is some event
    settles = "dark frames of the shortest exposure, one after the other through the event"
    offset_dn: float = parameter(0.0, "DN", -0.25, 0.25, source="tenths of a DN to tens of DN", of_full_scale=True)
    tau_s: float = parameter(30.0, "s", 0.01, _SLOWEST_S, source="seconds to minutes")
    event_s: float = parameter(0.0, "s", -1e9, 1e9, source="from the first capture on")

    def offset(self, context: ExposureContext) -> Any:
        since = _times_of_frames(context) - self.event_s
        lifted = np.where(since < 0, 0.0, self.offset_dn * np.exp(-np.maximum(since, 0.0) / self.tau_s))
        return np.nanmean(lifted, axis=-1)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return np.unique(elapsed_s(context)).size >= 2 * _FEWEST

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return events in front of every frame with captures before and after it, short and long, up and down."""
        begun = np.unique(elapsed_s(context if context.first_frame is None else context.first_frame))
        usual_s = float(np.ptp(begun)) / max(begun.size - 1, 1)
        between = begun[_FEWEST : begun.size - _FEWEST]
        times = np.unique(_times_of_frames(context)) if between.size else between
        return tuple(
            cls(size, float(np.clip(rests * usual_s, 0.1, _SLOWEST_S)), float(time))
            for time in times[(times >= between[:1]) & (times <= between[-1:])]
            for rests in _RESTS_BETWEEN_EVENTS
            for size in (_TRIED_DN, -_TRIED_DN)
        )


def _times_of_frames(context: ExposureContext) -> Any:
    """Return the time in s of each frame along a last axis, NaN where a series has fewer than others."""
    return np.asarray(elapsed_s(context))[..., None] if context.frame_times_s is None else context.frame_times_s


@dataclass(frozen=True)
class SeriesSettling(Scaling):
    """Scales the light of the k-th frame after a change of settings: L' = L·(1 + a·r^k), k = 0, 1, 2 …

    With r near 1 the light goes in a line from frame to frame.

    Source: lamps and LEDs that are switched on for each setting warm up within its frames; auto-levels that run on.
    """

    name = "series_settling"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "previous_frame"
    block = "first"
    also = ("common",)
    log_prior_odds = -2.0
    prior_reason = "most sources are on all the time, and settle once in a session"
    trials = tuple({"excess_rel": a, "ratio": r} for r in (0.3, 0.7, 0.95) for a in (0.01, -0.01))
    fitted = ("excess_rel", "ratio")
    settles = "ten frames of one setting in a row, with light and in the dark"
    excess_rel: float = parameter(0.0, "1", -0.9, 9.0, source="tenths of a percent to some percent")
    ratio: float = parameter(0.3, "1", 0.0, 0.98, source="from frame to frame; 0 for the first frame alone")

    def factor(self, context: ExposureContext) -> Any:
        """Return the light of one frame over that of a settled source; of a series, the mean of its frames."""
        frames: Any = getattr(context, "frames", None)
        share = self.ratio**context.frame_index if frames is None else self._powers(frames, 1.0, 0.0) / frames
        return 1.0 + self.excess_rel * share

    def ordered_variance(self, signal: Signal, context: ExposureContext) -> Any:
        frames: Any = getattr(context, "frames", 1.0)
        counted = np.maximum(frames - 1.0, 1.0)
        mean = self._powers(frames, 1.0, 1.0) / counted
        square = self._powers(frames, 2.0, 1.0) / counted
        unbiased = counted / np.maximum(counted - 1.0, 1.0)
        return np.square(signal * self.excess_rel) * np.maximum(square - np.square(mean), 0.0) * unbiased

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        frames: Any = getattr(context, "frames", 1.0)
        later = self._powers(frames, 1.0, 1.0) / np.maximum(frames - 1.0, 1.0)
        moved: Any = before.mean * self.excess_rel * np.where(frames > 1, 1.0 - later, 0.0)
        return after.changed(first_excess=after.first_excess + moved)

    def _powers(self, frames: Any, power: float, first: Any) -> Any:
        """Return the sum of r^(p·k) over the frames k from `first` on."""
        step = self.ratio**power
        return (step**first - step**frames) / (1.0 - step)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return bool(np.max(np.asarray(getattr(context, "frames", 2.0))) > 1)

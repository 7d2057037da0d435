"""The source of light, and what it does over time and level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from scipy.special import gamma, gammainc

from simulators.effects.base import EXPOSURE, RADIANCE, Effect, Stage, parameter
from simulators.effects.catalogue import Scaling, elapsed_s
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class SourceLevel(Effect):
    """Scales the scene by the source's relative drive: L = d·L₁."""

    name = "source_level"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * context.settings.source_level

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return context.settings.source_level


@dataclass(frozen=True)
class SourceWarmupDrift(Scaling):
    """Scales light in time: L' = L·(1 + A·e^(−t/τ) + B·e^(−t/τ_B)).

    Source: LED and LCD backlights; typical 0.5 to 3 % over 2 to 20 min.
    """

    name = "source_warmup_drift"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "timestamp_s"
    block = "mean"
    trials = (
        {"amplitude_rel": 0.01, "tau_s": 100.0},
        {"amplitude_rel": 0.01, "tau_s": 300.0},
        {"amplitude_rel": 0.01, "tau_s": 900.0},
        {"amplitude_rel": -0.01, "tau_s": 100.0},
        {"amplitude_rel": -0.01, "tau_s": 300.0},
        {"amplitude_rel": -0.01, "tau_s": 900.0},
    )
    fitted = ("amplitude_rel", "tau_s")
    settles = "one setting repeated over an hour in between the others"
    amplitude_rel: float = parameter(0.0, "1", -0.9, 5.0, source="engineering prior; refined on a real rig")
    tau_s: float = parameter(300.0, "s", 1.0, 100000.0, source="2 to 20 min")
    second_rel: float = parameter(0.0, "1", -0.9, 5.0, source="amplitude of a second, slower term")
    second_tau_s: float = parameter(1500.0, "s", 1.0, 1000000.0, source="its time constant")

    def factor(self, context: ExposureContext) -> Any:
        time = elapsed_s(context)
        slow = self.second_rel * np.exp(-time / self.second_tau_s) if self.second_rel else 0.0
        return 1.0 + self.amplitude_rel * np.exp(-time / self.tau_s) + slow

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return bool(np.ptp(elapsed_s(context)) > 0)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return two terms, a fast and a slow one."""
        span = float(np.ptp(elapsed_s(context)))
        return (cls(0.005, max(span / 20.0, 2.0), 0.005, max(span / 3.0, 5.0)),)

    def free(self) -> tuple[str, ...]:
        first = ("amplitude_rel", "tau_s")
        return (*first, "second_rel", "second_tau_s") if self.second_rel else first


_MOST_LEVELS: Final = 16  # a free entry for each of more would fit anything


@dataclass(frozen=True)
class LedThermalDroop(Scaling):
    """Weakens light by drive: L' = L·(1 − k·d − k₂·d² − k₃·d³)·(1 + table(d)); a smooth droop has no table.

    The table (linear in log d between its levels) serves any other law.

    Source: LED datasheets, relative flux over current; typical 1 to 10 %.
    """

    name = "led_thermal_droop"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "source_level"
    block = "mean"
    trials = ({"droop_rel": 0.02, "curvature_rel": 0.0}, {"droop_rel": -0.02, "curvature_rel": 0.0})
    fitted = ("droop_rel",)
    settles = "several source levels at one exposure"
    droop_rel: float = parameter(0.0, "1", -0.9, 0.9, source="engineering prior; refined on a real rig")
    curvature_rel: float = parameter(0.0, "1", -0.9, 0.9, source="engineering prior; refined on a real rig")

    bend_rel: float = parameter(0.0, "1", -0.9, 0.9, source="heat that is led off well until some drive")
    levels: tuple[float, ...] = parameter((), "1", 1e-9, 1e3, source="drives at which the table holds an error")
    errors_rel: tuple[float, ...] = parameter((), "1", -0.9, 3.0, source="relative error at these drives")

    def factor(self, context: ExposureContext) -> Any:
        level = np.asarray(context.settings.source_level)
        law = np.maximum(1.0 - self.droop_rel * level - self.curvature_rel * level**2 - self.bend_rel * level**3, 0.01)
        if not self.levels:
            return law
        known = np.log(np.maximum(level, 1e-9))
        return law * (1.0 + np.interp(known, np.log(self.levels), self.errors_rel))

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        level = np.asarray(context.settings.source_level)
        return bool(np.unique(level[level > 0]).size > 1)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the law with curvature."""
        return (cls(0.01, 0.01),)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the law of one term more, and the table over the levels in use, which covers every law."""
        level = np.asarray(context.settings.source_level)
        used = np.unique(level[level > 0])
        if self.levels or not 3 <= used.size <= _MOST_LEVELS:
            return ()
        table = type(self)(levels=tuple(used.tolist()), errors_rel=(0.0,) * used.size)
        if not self.curvature_rel:
            return (self.with_parameters(curvature_rel=0.01), table)
        return (table,) if self.bend_rel else (self.with_parameters(bend_rel=0.001), table)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: further terms only where there are any, the table but for its highest level."""
        if self.levels:
            return tuple(f"errors_rel[{index}]" for index in range(len(self.levels) - 1))
        further = ("bend_rel",) if self.bend_rel else ()
        return ("droop_rel", "curvature_rel", *further) if self.curvature_rel else ("droop_rel",)


_TRIED_REL = 0.01  # a fit is linear in it: any size begins
_FEWEST = 4  # captures on either side of a jump: fewer may be single frames that went wrong


@dataclass(frozen=True)
class LampStep(Scaling):
    """Scales light from one moment on: L' = L·(1 + A·[t > t_0]).

    The moment is known to be between two captures, not better; it is not fitted.

    Source: arcs that move on their electrodes, supplies that switch range, flats of one evening that differ by 0.4 %.
    """

    name = "lamp_step"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "timestamp_s"
    block = "mean"
    log_prior_odds = -2.0
    prior_reason = "a drift is likelier than a jump, and a jump may be anywhere in a session"
    trials = ({"step_rel": _TRIED_REL, "time_s": 0.0},)
    fitted = ("step_rel",)
    settles = "one setting repeated through the session, in between the others"
    step_rel: float = parameter(0.0, "1", -0.9, 9.0, source="0.1 to 2 % of arcs and supplies; a lamp changed: any")
    time_s: float = parameter(0.0, "s", -1e9, 1e9, source="from the first capture on")

    def factor(self, context: ExposureContext) -> Any:
        return 1.0 + self.step_rel * (np.asarray(elapsed_s(context)) > self.time_s)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return np.unique(elapsed_s(context)).size >= 2 * _FEWEST

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return a jump in front of every capture that has several before and after it: in front of its first frame."""
        times = np.ravel(elapsed_s(context))
        begun = times if context.first_frame is None else np.ravel(elapsed_s(context.first_frame))
        times, first = np.unique(times, return_index=True)
        between = 0.5 * (times[:-1] + begun[first[1:]])[_FEWEST - 1 : times.size - _FEWEST]
        return tuple(cls(_TRIED_REL, float(time)) for time in between)


_STRAIGHT, _SLOW = 2.0, 0.6  # stretches from which a fit begins


@dataclass(frozen=True)
class SourceNotProportionalToExposure(Scaling):
    """Weakens light that lasts longer: H' = H·(1 − a·(1 − (τ/t)·(1 − e^(−t/τ)))); a below 0 is a slow turn-on.

    The light sags as a·(1 − e^(−(t/τ)^β)): at once and ever more slowly for β below 1, along a straight line that
    ends for β above it. Its mean over the exposure is then a·(1 − Γ(1 + 1/β)·P(1/β, (t/τ)^β)·τ/t), P the regularised
    incomplete gamma function; for β = 1 that is the equation above.

    Source: a LED flashed for the exposure; Printalyzer issue 14 saw a log-like decay.
    """

    name = "source_not_proportional_to_exposure"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    log_prior_odds = -3.0
    prior_reason = "only sources that are lit for the exposure do this"
    trials = (
        {"droop_rel": 0.02, "tau_s": 0.0003},
        {"droop_rel": -0.02, "tau_s": 0.0003},
        {"droop_rel": 0.02, "tau_s": 0.001},
        {"droop_rel": 0.02, "tau_s": 0.01},
        {"droop_rel": 0.02, "tau_s": 0.1},
        {"droop_rel": -0.02, "tau_s": 0.001},
        {"droop_rel": -0.02, "tau_s": 0.01},
        {"droop_rel": -0.02, "tau_s": 0.1},
    )
    fitted = ("droop_rel", "tau_s")
    further = ({"stretch": _STRAIGHT}, {"stretch": _SLOW})
    settles = "one exposure at several source levels, or a photodiode on the source"
    droop_rel: float = parameter(0.0, "1", -5.0, 0.95, source="engineering prior; refined on a real rig")
    tau_s: float = parameter(0.01, "s", 1e-06, 100.0, source="time constant of the droop")
    stretch: float = parameter(1.0, "1", 0.2, 5.0, source="1 is an exponential; heat that spreads gives a half")

    def factor(self, context: ExposureContext) -> Any:
        """Return mean light over the exposure against light at its start."""
        x = np.asarray(context.settings.exposure_s) / self.tau_s
        if self.stretch == 1.0:
            return 1.0 - self.droop_rel * (1.0 + np.expm1(-x) / x)
        order = 1.0 / self.stretch
        return 1.0 - self.droop_rel * (1.0 - gamma(1.0 + order) * gammainc(order, x**self.stretch) / x)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return sags along a line that ends, of either sign, and slow ones."""
        return tuple(
            cls(droop, tau_s, stretch)
            for droop in (0.02, -0.02)
            for tau_s in (0.0003, 0.001, 0.01)
            for stretch in (_STRAIGHT, _SLOW)
        )


CHANNELS: Final = ("red", "green", "blue")


@dataclass(frozen=True)
class SpectralMismatch(Scaling):
    """Scales the light of each channel shown alone: L' = L·(1 + e_c) for the patterns named red, green and blue.

    Light of all channels together is what the responsivity was stated for and stays.

    Source: a responsivity stated for one spectrum and used for another.
    """

    name = "spectral_mismatch"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "pattern"
    block = "mean"
    trials = (
        {"red_rel": 0.02, "green_rel": 0.0, "blue_rel": -0.02},
        {"red_rel": 0.02, "green_rel": 0.0, "blue_rel": 0.02},
        {"red_rel": -0.02, "green_rel": 0.0, "blue_rel": 0.02},
        {"red_rel": -0.02, "green_rel": 0.0, "blue_rel": -0.02},
    )
    fitted = ("red_rel", "green_rel", "blue_rel")
    settles = "each channel of the source alone"
    red_rel: float = parameter(0.0, "1", -0.9, 5.0, source="engineering prior; refined on a real rig")
    green_rel: float = parameter(0.0, "1", -0.9, 5.0, source="engineering prior; refined on a real rig")
    blue_rel: float = parameter(0.0, "1", -0.9, 5.0, source="engineering prior; refined on a real rig")

    def factor(self, context: ExposureContext) -> Any:
        shown = np.asarray(context.settings.pattern)
        errors = (self.red_rel, self.green_rel, self.blue_rel)
        return 1.0 + sum(np.where(shown == c, e, 0.0) for c, e in zip(CHANNELS, errors, strict=True))

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether each channel is shown alone, and something else as well."""
        shown = set(np.unique(np.asarray(context.settings.pattern)).tolist())
        return shown.issuperset(CHANNELS) and len(shown) > len(CHANNELS)

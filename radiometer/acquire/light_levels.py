"""Measures the radiance of a light box's channels over their levels with a camera; taken up where it was interrupted.

Events of its journal after `start`: `plan` (the order of a channel's levels), and `level` after every level.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Final

import numpy as np

from radiometer.data import Reading
from radiometer.data.event_journal import Event, EventJournal
from radiometer.data.light_calibration import ChannelCalibration, LightPoint
from radiometer.devices.light_box import (
    FULL_LEVEL,
    ChannelCapabilities,
    ChannelMode,
    CurrentRange,
    DriveLevel,
    LightBox,
    round_to_steps,
)
from radiometer.errors import MeasurementError, UnsafeStimulus

REFERENCE_EVERY: Final = 6  # points between two measurements of the reference level
LOWEST_STEP: Final = 16  # below, neighbouring steps differ by more than 6 %
SETTLED_REL: Final = 0.0005  # per step: small against the 1 % of a calibration
DARK_TERM: Final = "dark and black level"
# What is left to come when two readings 20 s apart agree: twice their difference, for time constants up to a minute.
UNSETTLED_PART: Final = 2 / math.sqrt(3)
LIT_S: Final = (600.0, 280.0, 180.0, 90.0)  # how long a level is lit: the longest of these that is allowed
SETTLING_STEP_S: Final = 20.0  # LEDs on their heat sinks settle within minutes
ENERGY_KEPT: Final = 0.15  # of a channel's energy budget, so that the box does not darken it while it is measured

Measure = Callable[[], Reading]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class SpectralCorrection:
    """What a reading is multiplied by, for the camera was calibrated at another wavelength."""

    factor: float = 1.0  # responsivity (per W) at the calibration's light over that at the channel's
    u_rel: float = 0.0  # its relative standard uncertainty


@dataclass(frozen=True, slots=True)
class Measured:
    """One level: settled reading less the dark one, its own and its shared relative u, start over settled, and when."""

    drive: DriveLevel
    radiance: float
    own_u_rel: float
    shared_u_rel: float
    start_rel: float
    settle_s: float
    order: float


@dataclass(slots=True)
class LevelSurvey:
    """Measures one channel: levels in random order, the reference level in between, each after it has settled."""

    box: LightBox  # an open light box; all channels dark
    measure: Measure  # takes one reading of the lit area
    wait: Callable[[float], None]  # lets a time in s pass while the box is kept lit
    rng: np.random.Generator  # makes the order
    points_per_decade: float = 4.0  # density of the levels
    progress: Progress | None = None  # called with channel, points done and points in all
    # Open journal that keeps every level; levels in it are not measured again
    journal: EventJournal = field(default_factory=lambda: EventJournal(None))
    wall_s: Callable[[], float] = time.time  # Unix time in s
    _dark: Reading | None = field(default=None)

    def survey(self, channel: str, correction: SpectralCorrection) -> ChannelCalibration:
        """Return the channel's calibration.

        Raises:
            MeasurementError: If fewer than two levels stand out of the noise.
            DeviceError: If box or camera fails.
        """
        capabilities = self.box.channels[channel]
        order = self._order(channel)
        references, measured = self._kept(channel)
        if not references or references[-1].order < len(order):
            self.box.safe()
            self._dark = self.measure()
            self._run(channel, order, begins=len(measured))
            references, measured = self._kept(channel)
        return assemble(capabilities, measured, references, correction)

    def _order(self, channel: str) -> list[DriveLevel]:
        """Return the levels in random order, that of the journal where it has one."""
        capabilities = self.box.channels[channel]
        levels = plan_levels(capabilities, self.points_per_decade)
        order = [levels[index] for index in self.rng.permutation(len(levels))]
        for event in self.journal.of_kind("plan"):
            if event["channel"] == channel:
                return [_drive_of(one) for one in event["order"]]
        self.journal.write("plan", self.wall_s(), channel=channel, order=[_as_drive(one) for one in order])
        return order

    def _kept(self, channel: str) -> tuple[list[Measured], list[Measured]]:
        """Return the references and the levels of a channel that the journal holds."""
        known = [event for event in self.journal.of_kind("level") if event["channel"] == channel]
        return tuple(  # type: ignore[return-value]
            [_measured_of(one) for one in known if one["reference"] is reference] for reference in (True, False)
        )

    def _run(self, channel: str, order: Sequence[DriveLevel], begins: int) -> None:
        """Measure the levels of a channel from one on, with the reference level before, between and after them."""
        reference = DriveLevel(self.box.channels[channel].level_limit[CurrentRange.HIGH] // 4)
        for number, drive in enumerate(order[begins:], begins):
            if number % REFERENCE_EVERY == 0 or number == begins:
                # After an interruption the reference before the level may have been measured already: 0.25 follows it.
                before = 0.25 if number == begins > 0 else 0.5
                self._keep(channel, self._point(channel, reference, number - before), reference=True)
            self._keep(channel, self._point(channel, drive, float(number)))
            if self.progress is not None:
                self.progress(channel, number + 1, len(order))
        self._keep(channel, self._point(channel, reference, float(len(order))), reference=True)
        self.box.safe()

    def _keep(self, channel: str, one: Measured, *, reference: bool = False) -> None:
        found = asdict(one) | {"drive": _as_drive(one.drive)}
        self.journal.write("level", self.wall_s(), channel=channel, reference=reference, **found)

    def _point(self, channel: str, drive: DriveLevel, order: float) -> Measured:
        self._let_recover(channel, drive)
        lit_s = self._light(channel, drive)
        first = reading = self.measure()
        waited_s, change = 0.0, math.inf
        # At any level, for the LED may still be warm from the one before; as long as the energy budget lasts.
        while waited_s < lit_s - 2 * SETTLING_STEP_S and self.box.read_channel(channel).energy_left > ENERGY_KEPT:
            self.wait(SETTLING_STEP_S)
            waited_s += SETTLING_STEP_S
            before, reading = reading, self.measure()
            change = abs(reading.radiance.value / before.radiance.value - 1)
            if change < SETTLED_REL + _own_u_rel(reading, DARK_TERM):
                change = SETTLED_REL
                break
        if self.box.read_channel(channel).mode not in (ChannelMode.STEADY, ChannelMode.PULSE):
            raise MeasurementError(
                f"channel {channel} went dark at level {drive.level}: its energy budget is used up; "
                "leave it dark for ten minutes, then calibrate again"
            )
        return self._measured(drive, (first, reading), change, waited_s, order)

    def _light(self, channel: str, drive: DriveLevel) -> float:
        """Light a channel for as long as the eye allows, up to the longest settling, and return that time.

        Where light without an end would exceed the limits of the eye, a stated end keeps it within them. Such light is
        bright, so that readings take no time in addition to the settling.
        """
        try:
            self.box.set_level(channel, drive)
            return LIT_S[0]
        except UnsafeStimulus:
            pass
        for lit_s in LIT_S[:-1]:
            try:
                self.box.pulse(channel, drive, lit_s)
                return lit_s
            except UnsafeStimulus:
                continue
        self.box.pulse(channel, drive, LIT_S[-1])
        return LIT_S[-1]

    def _let_recover(self, channel: str, drive: DriveLevel) -> None:
        """Wait in the dark until the channel's energy budget is as full as the level needs it."""
        limit = self.box.channels[channel].level_limit[CurrentRange.HIGH]
        needed = min(0.98, drive.level / limit) if drive.current_range is CurrentRange.HIGH else ENERGY_KEPT
        while self.box.read_channel(channel).energy_left < max(needed, 2 * ENERGY_KEPT):
            self.box.off(channel)
            self.wait(SETTLING_STEP_S)

    def _measured(
        self, drive: DriveLevel, readings: tuple[Reading, Reading], change: float, waited_s: float, order: float
    ) -> Measured:
        (first, last), dark = readings, self._dark
        assert dark is not None
        net = last.radiance.value - dark.radiance.value
        # With the same longest exposure an error of the dark level is the same in both readings and drops out.
        left_out = DARK_TERM if max(last.exposures_s) == max(dark.exposures_s) else None
        own_u = math.hypot(*(_own_u_rel(one, left_out) * one.radiance.value for one in (last, dark)))
        if net <= 3 * own_u:
            return Measured(drive, net, math.inf, 0.0, 1.0, waited_s, order)
        start_rel = (first.radiance.value - dark.radiance.value) / net
        own_u_rel = math.hypot(own_u / net, UNSETTLED_PART * change)
        return Measured(drive, net, own_u_rel, _shared_u_rel(last), start_rel, waited_s, order)


def plan_levels(channel: ChannelCapabilities, points_per_decade: float) -> list[DriveLevel]:
    """Return levels spread evenly in the logarithm of the duty over both current ranges, each duty step once."""
    chosen = []
    for current_range in CurrentRange:
        limit = channel.level_limit[current_range]
        top = round_to_steps(limit, channel.duty_steps)
        bottom = LOWEST_STEP if current_range is CurrentRange.LOW else max(LOWEST_STEP, channel.duty_steps // 400)
        count = max(3, math.ceil(points_per_decade * math.log10(top / bottom)) + 1)
        for step in np.unique(np.round(np.geomspace(bottom, top, count))).astype(int):
            level = min(round(int(step) * (FULL_LEVEL + 1) / channel.duty_steps), limit)
            chosen.append(DriveLevel(level, current_range))
    return chosen


def assemble(
    channel: ChannelCapabilities,
    measured: Sequence[Measured],
    references: Sequence[Measured],
    correction: SpectralCorrection,
) -> ChannelCalibration:
    """Return the calibration from measured levels: drift of the reference taken out, uncertainties put together.

    Args:
        measured: Levels in the order in which they were measured.

    Raises:
        MeasurementError: If fewer than two levels of each range stand out of the noise.
    """
    orders = np.array([one.order for one in references])
    relative = np.array([one.radiance for one in references])
    relative = relative / relative.mean()
    drift_u_rel = float(np.std(np.diff(relative)) / math.sqrt(2)) if relative.size > 2 else 0.0
    good = [one for one in measured if math.isfinite(one.own_u_rel)]
    if len(good) < 2:
        raise MeasurementError(
            f"channel {channel.name}: {len(good)} of {len(measured)} levels stand out of the noise; "
            "point the camera at the lit area, or open the lens"
        )
    points = tuple(_point(channel, one, float(np.interp(one.order, orders, relative)), correction) for one in good)
    shared = max(one.shared_u_rel for one in good)
    return ChannelCalibration(
        duty_steps=channel.duty_steps,
        common_u_rel=math.hypot(shared, correction.u_rel),
        drift_u_rel=drift_u_rel,
        settle_s=max(one.settle_s for one in good),
        points=points,
    )


def _as_drive(drive: DriveLevel) -> dict[str, int | str]:
    return {"level": drive.level, "current_range": str(drive.current_range)}


def _drive_of(entry: Event) -> DriveLevel:
    return DriveLevel(int(entry["level"]), CurrentRange(entry["current_range"]))


def _measured_of(event: Event) -> Measured:
    """Return a level as the journal holds it; the uncertainty of one that is not above the noise is null there."""
    numbers = {name: event[name] for name in ("radiance", "shared_u_rel", "start_rel", "settle_s", "order")}
    own_u_rel = math.inf if event["own_u_rel"] is None else event["own_u_rel"]
    return Measured(_drive_of(event["drive"]), own_u_rel=own_u_rel, **numbers)


def _point(channel: ChannelCapabilities, one: Measured, drift: float, correction: SpectralCorrection) -> LightPoint:
    return LightPoint(
        current_range="high" if one.drive.current_range is CurrentRange.HIGH else "low",
        level=one.drive.level,
        duty_step=round_to_steps(one.drive.level, channel.duty_steps),
        radiance_W_per_sr_m2=one.radiance * correction.factor / drift,
        u_rel=one.own_u_rel,
        start_rel=one.start_rel,
    )


def _own_u_rel(reading: Reading, left_out: str | None = None) -> float:
    own = [entry for entry in reading.budget if not entry.correlated and entry.name != left_out]
    return math.sqrt(sum(entry.u_rel**2 for entry in own))


def _shared_u_rel(reading: Reading) -> float:
    return math.sqrt(sum(entry.u_rel**2 for entry in reading.budget if entry.correlated))

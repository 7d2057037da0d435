"""The serial LED/button box: what is asked for is checked, sent, read back and accounted for."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Final, Protocol

import structlog

from drivers.light_box.link import ATTEMPTS, DARK_SOON, MOST_RATE, PROTOCOL_VERSIONS, BoxLink, BoxRefusal, Event
from radiometer.devices.exposure_ledger import ExposureLedger, Stimulus
from radiometer.devices.light_box import (
    FULL_LEVEL,
    ButtonEvent,
    ChannelCapabilities,
    ChannelMode,
    ChannelState,
    ClockEstimate,
    CurrentRange,
    DriveLevel,
    FlashState,
    Level,
    LightBoxIdentity,
    LightBoxStatus,
)
from radiometer.devices.opening import Opened
from radiometer.devices.retinal_safety import FlashLight, HazardFractions, hazard_fractions
from radiometer.errors import (
    CalibrationError,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    LightEnded,
    RadiometerError,
    SettingOutOfRange,
    UnsafeStimulus,
    UsageError,
)

_LOG = structlog.get_logger(__name__)
TEND_INTERVAL_S: Final = 0.25  # a quarter of the box's dead-man time
START_UP_S: Final = 4.0  # opening the port resets an Arduino, whose boot loader waits 1 to 2 s
LISTEN_S: Final = 0.02  # a press is read within this time; its time is the box's
BOOT_S: Final = 2.2  # the boot loader's wait, after which the program of an Arduino runs
FLASH: Final = "flash"  # its name in the account of the exposure
WRONG_VERSION: Final = 9  # refusal code of the protocol: a version that the firmware does not know
_COMPARED_S: Final = 1.0  # delays of 10 ms, more than those of USB adapters, then leave MOST_RATE
_UNKNOWN_RATE: Final = 0.1  # no resonator is off by so much, and no connection so slow: something is broken
AUDIT_INTERVAL_S: Final = 5.0  # a twentieth of a per mille of the window
# The box's dead man waits 1 s by its own clock; the rest is what USB adapters and operating systems hold back.
DARK_AFTER_S: Final = 1.5
BOX_KIND: Final = "radiometer-light-box"
RANGE_LETTERS: Final = {CurrentRange.LOW: "L", CurrentRange.HIGH: "H"}
_RANGES: Final = {letter: current for current, letter in RANGE_LETTERS.items()}
_MODES: Final = {
    "O": ChannelMode.OFF,
    "S": ChannelMode.STEADY,
    "R": ChannelMode.RAMP,
    "P": ChannelMode.PULSE,
    "B": ChannelMode.BLINK,
}
_CAUSES: Final = {"P": "power", "E": "external", "B": "brown-out", "W": "watchdog"}


def read_identity(port: str, fields: tuple[str, ...]) -> tuple[LightBoxIdentity, int]:
    """Return who answered HI and how many channels it has.

    Raises:
        DeviceNotFound: If it is not a light box that this program can talk to.
    """
    known = {str(version): version for version in PROTOCOL_VERSIONS}
    if len(fields) != 5 or fields[0] != BOX_KIND or fields[1] not in known or not fields[4].isdigit():
        spoken = " or ".join(sorted(known))
        raise DeviceNotFound(f"what answers on {port} is not a light box of protocol {spoken}: {fields!r}")
    return LightBoxIdentity(fields[3], fields[2], known[fields[1]], port), int(fields[4])


def read_capabilities(port: str, fields: tuple[str, ...]) -> tuple[ChannelCapabilities, int]:
    """Return a channel as CH describes it, and the energy units that its full bucket holds."""
    if len(fields) != 8 or not all(field.isdigit() for field in fields[1:]):
        raise _senseless(port, "CH", fields)
    peak_nm, steps, pwm_hz, low, high, bucket = (int(field) for field in fields[1:7])
    limits = {CurrentRange.LOW: low, CurrentRange.HIGH: high}
    return ChannelCapabilities(fields[0], float(peak_nm) or None, steps, float(pwm_hz), limits), bucket


def read_state(port: str, channel: str, bucket: int, fields: tuple[str, ...]) -> ChannelState:
    """Return a channel's state as RB reports it."""
    good = len(fields) == 5 and fields[0] in _MODES and fields[1] in _RANGES
    if not good or not all(field.isdigit() for field in fields[2:]):
        raise _senseless(port, "RB", fields)
    drive = DriveLevel(int(fields[2]), _RANGES[fields[1]])
    return ChannelState(channel, _MODES[fields[0]], drive, int(fields[3]), int(fields[4]) / max(bucket, 1))


def read_status(port: str, fields: tuple[str, ...]) -> LightBoxStatus:
    """Return the box's status as ST reports it."""
    numbers = [*fields[0:1], *(field.removeprefix("-") for field in fields[1:2]), *fields[2:5], *fields[6:8]]
    if len(fields) != 8 or not all(number.isdigit() for number in numbers) or fields[5] not in _CAUSES:
        raise _senseless(port, "ST", fields)
    return LightBoxStatus(
        supply_v=int(fields[0]) / 1000.0,
        temperature_celsius=int(fields[1]) / 10.0,
        damaged_lines=int(fields[2]),
        lost_bytes=int(fields[3]),
        darkened=int(fields[4]),
        reset_cause=_CAUSES[fields[5]],
        button_pressed=fields[6] == "1",
    )


def read_flash(port: str, fields: tuple[str, ...]) -> FlashState:
    """Return how many flashes are left in a row and when the next may be fired, as FL and FS report it."""
    if len(fields) != 2 or not all(field.isdigit() for field in fields):
        raise _senseless(port, "FS", fields)
    return FlashState(int(fields[0]), int(fields[1]) / 1000.0)


def _senseless(port: str, verb: str, fields: tuple[str, ...]) -> DeviceError:
    return DeviceError(
        f"light box on {port} answered {verb} with {' '.join(fields)!r}; flash the firmware of this program"
    )


class RadianceTable(Protocol):
    """Level and radiance of calibrated channels, as `radiometer.data` stores them."""

    def drive_for(self, channel: str, radiance_w_sr_m2: float) -> tuple[int, bool]:
        """Return the level nearest to a radiance and whether it is on the high range; raises SettingOutOfRange."""

    def highest_radiance(self, channel: str, level: int, high: bool) -> float | None:
        """Return a radiance in W·sr⁻¹·m⁻² that the level stays below (k = 2); None where it is not calibrated."""


@dataclass(slots=True)
class SerialLightBox(Opened):
    """A light box behind a line."""

    link: BoxLink  # exchanges with the box
    ledger: ExposureLedger  # account of the retinal exposure; refuses what is too much
    calibration: RadianceTable | None = None  # level ↔ radiance; None where levels can only be raw
    keep_alive: bool = True  # tend the box from a separate thread; without it the caller calls `tend` often enough
    # Wait for what answers to boot, ask it once, and let it be if it is silent: the port may be another's
    mild: bool = False
    flash: FlashLight | None = None  # the photographic flash at its trigger; None where there is none
    switched_off: int = 0  # how often another program has asked for darkness since the box was opened
    _identity: LightBoxIdentity | None = None
    _channels: dict[str, ChannelCapabilities] = field(default_factory=dict)
    _buckets: dict[str, int] = field(default_factory=dict)
    _tended_s: float = -math.inf
    _audited_s: float = -math.inf
    _lock: threading.RLock = field(default_factory=threading.RLock)
    _closing: threading.Event = field(default_factory=threading.Event)
    _keeper: threading.Thread | None = None

    @property
    def identity(self) -> LightBoxIdentity:
        if self._identity is None:
            raise DeviceError(f"light box on {self.link.line.name} is not open; call open() first")
        return self._identity

    @property
    def channels(self) -> Mapping[str, ChannelCapabilities]:
        self.identity  # noqa: B018 (raises)
        return dict(self._channels)

    def open(self) -> None:
        if self._identity is not None:
            return
        self.link.line.open()
        try:
            self._greet()
            self.tend()
        except RadiometerError:
            self.link.line.close()
            self._identity = None
            raise
        if self.keep_alive:
            self._closing.clear()
            self._keeper = threading.Thread(target=self._keep, name="light box", daemon=True)
            self._keeper.start()

    def close(self) -> None:
        self._closing.set()
        if self._keeper is not None:
            self._keeper.join()
            self._keeper = None
        if self._identity is not None:
            self.safe()
            self._identity = None
        self.link.line.close()

    def set_level(self, channel: str, level: Level) -> ChannelState:
        return self._shine("SL", channel, level, (), math.inf, math.inf)

    def ramp(self, channel: str, level: Level, duration_s: float) -> ChannelState:
        ms = self._milliseconds("duration", duration_s, 600.0)
        return self._shine("RA", channel, level, (ms,), math.inf, math.inf, ms / 1000.0)

    def pulse(self, channel: str, level: Level, duration_s: float) -> ChannelState:
        ms = self._milliseconds("duration", duration_s, 600.0)
        return self._shine("PU", channel, level, (ms,), ms / 1000.0, ms / 1000.0)

    def blink(self, channel: str, level: Level, on_s: float, off_s: float, count: int = 0) -> ChannelState:
        """Blink a channel `count` times (0: until the next command), timed by the box.

        Raises:
            SettingOutOfRange: If count, times or level are outside the box's limits.
        """
        if not 0 <= count <= 65535:
            raise SettingOutOfRange(self._name, "number of blinks", count, 0, 65535, "")
        on_ms, off_ms = self._milliseconds("bright time", on_s, 60.0), self._milliseconds("dark time", off_s, 60.0)
        bright_s, lasting_s = (ms * count / 1000.0 if count else math.inf for ms in (on_ms, on_ms + off_ms))
        return self._shine("BL", channel, level, (on_ms, off_ms, count), bright_s, lasting_s)

    def foresee(self, channel: str, level: Level, bright_s: float) -> HazardFractions:
        """Return which fractions of the exposure limits a stimulus would use up, without lighting anything.

        Args:
            bright_s: Bright time in s, in sum.

        Raises:
            SettingOutOfRange: If the level is beyond the channel's limits.
            CalibrationError: If a radiance is requested of a channel that is not calibrated.
            UnsafeStimulus: If it is too much for the eye, or for the channel's energy budget.
        """
        self._index(channel)
        drive = self._drive(channel, level)
        radiance = self._highest_radiance(channel, drive)
        self.ledger.refuse_unsafe(channel, radiance, bright_s)
        high = drive.current_range is CurrentRange.HIGH
        units_per_ms = (drive.level >> 8) + 1 if high else 1  # docs/reference/light-box-protocol.md, safety in the box
        longest_s = self._buckets[channel] / units_per_ms / 1000.0
        if bright_s > longest_s:
            raise UnsafeStimulus(
                f"{self._name}: {channel} for {bright_s:g} s at level {drive.level} is more than its energy budget, "
                f"which ends such light after {longest_s:.0f} s; take a lower level or a shorter time"
            )
        return hazard_fractions(self.ledger.optics[channel], radiance, bright_s)

    @property
    def flash_exposure_j_sr_m2(self) -> float:
        return self._flash_light().exposure_j_sr_m2

    def fire_flash(self) -> FlashState:
        light = self._flash_light()
        self._require_flash()
        radiance = light.exposure_bound_j_sr_m2 / light.duration_s
        with self._giving(Stimulus(FLASH, radiance, light.duration_s, light.duration_s), "FL") as answer:
            return read_flash(self._name, answer)

    def flash_state(self) -> FlashState:
        with self._exchanging():
            self._require_flash()
            return read_flash(self._name, self.link.request("FS"))

    def foresee_flashes(self, count: int) -> HazardFractions:
        """Return which fractions of the exposure limits a number of flashes would use up, without firing any.

        Raises UnsafeStimulus, CalibrationError, UsageError as `fire_flash` would.
        """
        light = self._flash_light()
        self._require_flash()
        radiance = light.exposure_bound_j_sr_m2 / light.duration_s
        self.ledger.refuse_unsafe(FLASH, radiance, light.duration_s)
        one = hazard_fractions(self.ledger.optics[FLASH], radiance, light.duration_s)
        return HazardFractions(count * one.blue_light, one.thermal)

    def _flash_light(self) -> FlashLight:
        if self.flash is None:
            raise CalibrationError(
                f"{self._name}: its preset has no `flash`; state its measured exposure, bound and duration there"
            )
        return self.flash

    def _require_flash(self) -> None:
        if self.identity.protocol_version < 2:
            raise UsageError(f"{self._name} speaks protocol version 1, which has no flash; flash its firmware")

    def highest_level(self, channel: str) -> int:
        """Return the highest raw level of the high range that would be accepted now as steady light.

        It is the box's own limit, or less where the account of the eye's exposure allows no more.
        """
        with self._lock:
            self._index(channel)
            if channel not in self.ledger.optics:
                return 0  # of light that the account knows nothing of, none is given
            accepted, refused = 0, self._channels[channel].level_limit[CurrentRange.HIGH] + 1
            while refused - accepted > 1:
                level = (accepted + refused) // 2
                try:
                    radiance = self._highest_radiance(channel, DriveLevel(level, CurrentRange.HIGH))
                    self.ledger.refuse_unsafe(channel, radiance, math.inf)
                    accepted = level
                except UnsafeStimulus:
                    refused = level
            return accepted

    def off(self, channel: str) -> None:
        with self._exchanging():
            self.link.request(f"OF {self._index(channel)}")
            self._require_dark(channel)
            self.ledger.darken(channel)

    def darken(self) -> None:
        """Darken every channel and see that each is dark.

        Raises:
            DeviceError: If one is not, or the box does not answer: it gets no further word, and its dead-man timer ends
                the light.
        """
        with self._lock:
            dark_after_s = DARK_AFTER_S
            try:
                self.link.request("OF *", attempts=ATTEMPTS // 2)
                self._require_dark(*self._channels)
                dark_after_s = 0.0
            except DeviceError:
                self.link.ask_for_darkness()
                raise
            finally:
                self.ledger.darken(within_s=dark_after_s)

    def switch_off(self) -> None:
        """Darken every channel for another program; raises as `darken`. Who gives a series of lights has to end it."""
        self.switched_off += 1
        self.darken()

    def safe(self) -> None:
        with suppress(DeviceError):
            self.darken()

    def _require_dark(self, *channels: str) -> None:
        for channel in channels:
            if self.read_channel(channel).drive.level:
                self.link.give_up(
                    f"{self._name}: {channel} stays lit though it was darkened; the box gets no further word and goes"
                    " dark by its dead-man timer within 1 s. Unplug it if it does not, and flash its firmware"
                )

    def read_channel(self, channel: str) -> ChannelState:
        with self._exchanging():
            fields = self.link.request(f"RB {self._index(channel)}")
            return read_state(self._name, channel, self._buckets[channel], fields)

    def status(self) -> LightBoxStatus:
        with self._exchanging():
            return read_status(self._name, self.link.request("ST"))

    def synchronise(self) -> ClockEstimate:
        with self._exchanging():
            self._compare_clocks()
            return self.link.clock.estimate()

    def buttons(self, timeout_s: float) -> Iterator[ButtonEvent]:
        deadline_s = self.link.line.now() + timeout_s
        while (left_s := deadline_s - self.link.line.now()) > 0:
            with self._exchanging():
                self.link.listen(min(left_s, LISTEN_S))
                self.tend_if_due()
                found = self.link.take_events()
                if found:
                    self.tend()  # a comparison close to the press: no extrapolation
                events = [self._stamped(event) for event in found]
            yield from events

    def tend(self) -> None:
        """Let the box know that the host is there, compare the clocks, fetch lost events. Raises DeviceLost."""
        with self._exchanging():
            self._compare_clocks()
            if self.link.take_turned_off():
                self.ledger.darken()
            if self.link.line.now() - self._audited_s >= AUDIT_INTERVAL_S:
                self._audited_s = self.link.line.now()
                if not self.ledger.is_kept():
                    self.safe()
                    self.link.give_up(
                        f"{self._name}: the account of its exposure was lost while it was lit."
                        " Every channel was darkened; reopen it"
                    )

    def _compare_clocks(self) -> None:
        self.link.compare_clocks()
        self._tended_s = self.link.line.now()

    def tend_if_due(self) -> None:
        """Tend the box if a quarter of its dead-man time has passed since it was tended last."""
        if self.link.line.now() - self._tended_s >= TEND_INTERVAL_S:
            self.tend()

    @property
    def _name(self) -> str:
        return f"light box on {self.link.line.name}"

    def _greet(self) -> None:
        if self.mild:
            self.link.listen(BOOT_S)
        deadline_s = self.link.line.now() + (0.0 if self.mild else START_UP_S)
        while True:
            self.link.reset()
            try:
                fields = self._hello()
                break
            except (DeviceTimeout, DeviceLost) as silent:
                if isinstance(silent, DeviceLost) or self.link.line.now() > deadline_s:
                    raise DeviceNotFound(f"nothing on {self.link.line.name} answers as a light box") from silent
            except BoxRefusal as refusal:
                raise DeviceNotFound(str(refusal)) from refusal
        self._identity, count = read_identity(self.link.line.name, fields)
        self._channels, self._buckets = {}, {}
        for index in range(count):
            channel, bucket = read_capabilities(self._name, self.link.request(f"CH {index}"))
            self._channels[channel.name], self._buckets[channel.name] = channel, bucket
            if self.ledger.take_colour(channel.name, channel.peak_nm):
                _LOG.warning("the preset is of another box: the light counts as the box says", channel=channel.name)
        # A session starts dark, however the one before has ended.
        self.ledger.open(self._identity.serial, self.link.line.name)

    def _hello(self) -> tuple[str, ...]:
        """Return the answer to HI in the newest version that the box speaks."""
        for version in PROTOCOL_VERSIONS[:-1]:
            try:
                return self.link.request(f"HI {version}", attempts=1 if self.mild else 2)
            except BoxRefusal as refusal:
                if refusal.code != WRONG_VERSION:
                    raise
        return self.link.request(f"HI {PROTOCOL_VERSIONS[-1]}", attempts=1 if self.mild else 2)

    def _keep(self) -> None:
        while not self._closing.wait(TEND_INTERVAL_S / 5):
            try:
                with self._exchanging():
                    self.tend_if_due()
            except DeviceError:
                return  # the link keeps the reason and gives it to the next caller

    @contextmanager
    def _exchanging(self) -> Iterator[None]:
        """Have the box for the block; where it is lost meanwhile, all light counts until the dead man has ended it."""
        with self._lock:
            try:
                yield
            except DeviceError:
                if self.link.fault is not None:
                    self.link.ask_for_darkness()
                    self.ledger.darken(within_s=DARK_AFTER_S)
                raise

    def _shine(
        self,
        verb: str,
        channel: str,
        level: Level,
        times: tuple[int, ...],
        bright_s: float,
        lasting_s: float,
        ramp_s: float = 0.0,
    ) -> ChannelState:
        index, drive = self._index(channel), self._drive(channel, level)
        words = " ".join(str(word) for word in (verb, index, RANGE_LETTERS[drive.current_range], drive.level, *times))
        if drive.level == 0 and not ramp_s:  # darkness needs no account
            with self._exchanging():
                self.link.request(words)
                self._require_dark(channel)
                self.ledger.darken(channel)
                return self.read_channel(channel)
        radiance = self._highest_radiance(channel, drive)
        with self._giving(Stimulus(channel, radiance, bright_s, lasting_s, ramp_s), words) as answer:
            state = self.read_channel(channel)
            self._refuse_other_than(drive, answer, state, verb)
            return state

    @contextmanager
    def _giving(self, stimulus: Stimulus, words: str) -> Iterator[tuple[str, ...]]:
        """Enter a stimulus into the account, then have the box for the block with its answer; raises as `request`.

        The box is tended while the account is stored, for the disk may take long.
        """
        if math.isfinite(stimulus.bright_s) or stimulus.ramp_s:
            self._know_clock()
        name = self.ledger.reserve(stimulus)
        with self._exchanging():
            if not self.ledger.holds(name):
                raise LightEnded(f"{self._name}: {stimulus.channel} was darkened before its light began; ask again")
            try:
                answer = self.link.request(words)
            except DeviceError:
                if self.link.fault is None:  # refused, nothing was changed; else it may be on: see `_exchanging`
                    self.ledger.withdraw(name)
                raise
            self.ledger.begun(name)
            yield answer
        self.ledger.settle()

    def _know_clock(self) -> None:
        """Compare the clocks until it is known how much longer the box's times may be, and count them so."""
        with self._exchanging():
            until_s = self.link.line.now() + _COMPARED_S
            while (off := self.link.clock.most_rate()) > MOST_RATE and self.link.line.now() < until_s:
                self.link.listen(_COMPARED_S / 50)
                self._compare_clocks()
            if off > _UNKNOWN_RATE:
                self.link.give_up(
                    f"{self._name}: its clock may be off by {100 * min(off, 1.0):.2g} %, so its light may last longer "
                    f"than asked; use a port with less delay, or flash its firmware; {DARK_SOON}"
                )
            self.ledger.clock_factor = 1.0 + max(off, MOST_RATE)

    def _refuse_other_than(self, drive: DriveLevel, answer: tuple[str, ...], state: ChannelState, verb: str) -> None:
        """Darken the box where it states other light than was asked for; a pulse or blink may be dark already."""
        known = self._channels[state.channel]
        steps = round(known.duty(drive.level) * known.duty_steps)
        stated = (RANGE_LETTERS[drive.current_range], str(drive.level), str(steps))
        is_over = verb != "SL" and state.drive.level == 0
        is_as_asked = verb == "RA" or is_over or not drive.level or state.drive == drive
        if answer != stated or not is_as_asked:
            self.safe()
            brightest = self._highest_radiance(state.channel, DriveLevel(FULL_LEVEL, CurrentRange.HIGH))
            self.ledger.note(Stimulus(state.channel, brightest, DARK_AFTER_S, DARK_AFTER_S))
            raise DeviceError(
                f"{self._name}: asked for {drive}, answered {' '.join(answer)!r}, read back {state.drive};"
                " every channel was darkened"
            )

    def _drive(self, channel: str, level: Level) -> DriveLevel:
        if channel not in self.ledger.optics:
            raise UsageError(
                f"{self._name}: its preset says nothing of channel {channel}, so what its light does to the eye is not "
                "known; describe it there (configs/light_boxes/reference.yaml shows how)"
            )
        if not isinstance(level, DriveLevel):
            if self.calibration is None:
                raise CalibrationError(
                    f"{self._name} has no calibration, so {channel} takes raw levels only; "
                    "run `radiometer light calibrate` first"
                )
            raw, high = self.calibration.drive_for(channel, level.radiance_w_sr_m2)
            level = DriveLevel(raw, CurrentRange.HIGH if high else CurrentRange.LOW)
        limit = self._channels[channel].level_limit[level.current_range]
        if not 0 <= level.level <= limit:
            raise SettingOutOfRange(
                self._name, f"{level.current_range}-current level of {channel}", level.level, 0, limit, ""
            )
        return level

    def _highest_radiance(self, channel: str, drive: DriveLevel) -> float:
        high = drive.current_range is CurrentRange.HIGH
        known = self.calibration.highest_radiance(channel, drive.level, high) if self.calibration else None
        if known is not None:
            return known
        optics = self.ledger.optics[channel]
        duty = max(drive.level / FULL_LEVEL, self._channels[channel].duty(drive.level))  # rounded up at a dim level
        return optics.radiance_bound_w_sr_m2 * (1.0 if high else optics.low_range_ratio_bound) * duty

    def _index(self, channel: str) -> int:
        self.identity  # noqa: B018 (raises unless open)
        names = list(self._channels)
        if channel not in names:
            raise UsageError(f"{self._name} has no channel {channel!r}; it has {', '.join(names)}")
        return names.index(channel)

    def _milliseconds(self, name: str, time_s: float, longest_s: float) -> int:
        if not (math.isfinite(time_s) and 0.001 <= time_s <= longest_s):
            raise SettingOutOfRange(self._name, name, time_s, 0.001, longest_s, "s")
        return round(time_s * 1000)

    def _stamped(self, event: Event) -> ButtonEvent:
        time_s, u_time_s = self.link.clock.host_time_s(event.box_time_s)
        return ButtonEvent(event.argument == "D", time_s, u_time_s, event.box_time_s, event.number)

"""Interface of every light box, real or simulated: LED channels, a button, and darkness when in doubt."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Protocol, Self, runtime_checkable

FULL_LEVEL: Final = 65535  # 16 bits, as the box's protocol has it


class CurrentRange(StrEnum):
    """Which current drives an LED: the low range reaches the dim end, about 1/256 of the high one."""

    LOW = "low"
    HIGH = "high"


class ChannelMode(StrEnum):
    """What a channel is doing."""

    OFF = "off"
    STEADY = "steady"
    RAMP = "ramp"
    PULSE = "pulse"
    BLINK = "blink"


@dataclass(frozen=True, slots=True)
class DriveLevel:
    """A raw level."""

    level: int  # 0 (dark) to 65535 (always on)
    current_range: CurrentRange = CurrentRange.HIGH  # low or high current


@dataclass(frozen=True, slots=True)
class Radiance:
    """A level given as radiance in W·sr⁻¹·m⁻²; needs a calibrated channel."""

    radiance_w_sr_m2: float


Level = DriveLevel | Radiance


@dataclass(frozen=True, slots=True)
class LightBoxIdentity:
    """Who a light box is: serial number, firmware, protocol version and the port it answered on."""

    serial: str
    firmware: str
    protocol_version: int
    port: str


@dataclass(frozen=True, slots=True)
class ChannelCapabilities:
    """Limits of one channel, as the box states them."""

    name: str  # "bleach", "spot", "spot_red", "fixation", and from protocol 2 on "spot_green" and "field"
    peak_nm: float | None  # peak wavelength in nm; None for white
    duty_steps: int  # number of duty steps that a level is rounded to
    pwm_hz: float  # lowest frequency in its light, in Hz
    level_limit: Mapping[CurrentRange, int]  # highest level that the box accepts in each current range

    def duty(self, level: int) -> float:
        """Return the duty (0 to 1) that a level is rounded to."""
        return round_to_steps(level, self.duty_steps) / self.duty_steps


@dataclass(frozen=True, slots=True)
class ChannelState:
    """What a channel is doing, as read back from the box."""

    channel: str  # name of the channel
    mode: ChannelMode  # off, steady, ramp, pulse or blink
    drive: DriveLevel  # the level driven at this moment
    duty_steps: int  # the duty step that the level was rounded to
    energy_left: float  # fraction of the channel's energy budget that is left, 0 to 1


@dataclass(frozen=True, slots=True)
class LightBoxStatus:
    """How the box is."""

    supply_v: float  # LED supply in V
    temperature_celsius: float  # temperature next to the LEDs in °C
    damaged_lines: int  # lines with a wrong checksum that the box has seen since it was switched on
    lost_bytes: int  # bytes that the box lost since it was switched on
    darkened: int  # how often the box itself has gone dark (host silent, energy budget used up)
    reset_cause: str  # "power", "external", "brown-out" or "watchdog"
    button_pressed: bool  # whether the button is held


@dataclass(frozen=True, slots=True)
class FlashState:
    """What the box allows of its photographic flash."""

    left: int  # flashes that may still be fired in a row
    wait_s: float  # time in s until the next one may be fired


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """How the box's clock runs against the host's."""

    offset_s: float  # host time minus box time in s, at the latest sample
    drift_ppm: float  # rate of the box's clock above the host's in parts per million
    u_drift_ppm: float  # its standard uncertainty
    u_offset_s: float  # standard uncertainty of the offset in s
    samples: int  # number of exchanges behind it


@dataclass(frozen=True, slots=True)
class ButtonEvent:
    """A press or release of the button."""

    pressed: bool  # True for a press, False for a release
    time_s: float  # when, on the host's clock, in s
    u_time_s: float  # standard uncertainty of that time in s
    box_time_s: float  # when, on the box's clock, in s
    number: int  # the box's running number of the event, 0 to 255


@runtime_checkable
class LightBox(Protocol):
    """LED channels with levels, pulses and blinks timed by the box, and a time-stamped button.

    Every exchange has a deadline. The box goes dark by itself when the host is silent for 1 s. What is above a
    limit of the box or of the eye is refused; nothing is clipped silently.
    """

    @property
    def identity(self) -> LightBoxIdentity:
        """Return who the box is. Raises DeviceError unless open."""

    @property
    def channels(self) -> Mapping[str, ChannelCapabilities]:
        """Return the channels by name. Raises DeviceError unless open."""

    def open(self) -> None:
        """Open the box; every channel is dark then. Raises DeviceNotFound or DeviceInUse."""

    def close(self) -> None:
        """Darken and release the box; closing twice does nothing."""

    def set_level(self, channel: str, level: Level) -> ChannelState:
        """Light a channel steadily and return its state as read back.

        Raises SettingOutOfRange, UnsafeStimulus, CalibrationError, DeviceTimeout or DeviceLost.
        """

    def ramp(self, channel: str, level: Level, duration_s: float) -> ChannelState:
        """Move a channel's level linearly to another within `duration_s`; raises as `set_level`."""

    def pulse(self, channel: str, level: Level, duration_s: float) -> ChannelState:
        """Light a channel for `duration_s`, timed by the box; raises as `set_level`."""

    def blink(self, channel: str, level: Level, on_s: float, off_s: float, count: int = 0) -> ChannelState:
        """Blink a channel `count` times (0: until the next command), timed by the box; raises as `set_level`."""

    def off(self, channel: str) -> None:
        """Darken one channel. Raises DeviceTimeout or DeviceLost; the box is dark within 1 s then."""

    def safe(self) -> None:
        """Darken every channel; never raises, for the box darkens itself where it cannot be reached."""

    def read_channel(self, channel: str) -> ChannelState:
        """Return what a channel is doing. Raises DeviceTimeout, DeviceLost."""

    def status(self) -> LightBoxStatus:
        """Return supply, temperature and error counts. Raises DeviceTimeout, DeviceLost."""

    def synchronise(self) -> ClockEstimate:
        """Compare the clocks once more and return the estimate. Raises DeviceTimeout, DeviceLost."""

    def buttons(self, timeout_s: float) -> Iterator[ButtonEvent]:
        """Yield presses and releases as they come for `timeout_s`. Raises DeviceLost."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


@runtime_checkable
class FlashBox(Protocol):
    """A light box that fires a photographic flash behind a diffuser."""

    @property
    def flash_exposure_j_sr_m2(self) -> float:
        """Return the radiant exposure of one flash in J·sr⁻¹·m⁻². Raises CalibrationError where it is not known."""

    def fire_flash(self) -> FlashState:
        """Fire the flash once.

        Raises UnsafeStimulus, CalibrationError, UsageError, DeviceTimeout or DeviceLost.
        """

    def flash_state(self) -> FlashState:
        """Return what the box allows of its flash. Raises UsageError, DeviceTimeout, DeviceLost."""


def round_to_steps(level: int, steps: int) -> int:
    """Return the duty step that a level is rounded to, of which 65535 is all (docs/reference/light-box-protocol.md)."""
    return ((level + (level >> 15)) * steps + 32768) >> 16

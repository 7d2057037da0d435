"""Meaning of the fields of the box's answers."""

from __future__ import annotations

from typing import Final

from drivers.light_box.frames import PROTOCOL_VERSIONS
from radiometer.devices.light_box import (
    ChannelCapabilities,
    ChannelMode,
    ChannelState,
    CurrentRange,
    DriveLevel,
    FlashState,
    LightBoxIdentity,
    LightBoxStatus,
)
from radiometer.errors import DeviceError, DeviceNotFound

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

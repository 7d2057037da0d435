"""Errors that a user or a program can act on.

    RadiometerError
        UsageError
            ConfigurationError
        InputError
            CaptureError
                DamagedFileError
            UnsettledError
            CalibrationError
        MeasurementError
        OutputError
            OutputRefused
        DeviceError
            DeviceNotFound, DeviceInUse, DeviceLost, DeviceTimeout
            SettingOutOfRange, UnsafeStimulus, MissingLibrary

The exit code is 1 by default, and 2 for UsageError and OutputRefused. Every message states what is wrong, where, and
what to do.
"""

from __future__ import annotations

import importlib
from typing import Any

from radiometer.numbers import unit_text


class RadiometerError(Exception):
    """Root of all errors that are reported to a user as one line."""

    exit_code = 1


class UsageError(RadiometerError):
    """The call itself is wrong."""

    exit_code = 2


class ConfigurationError(UsageError):
    """A configuration file holds a key or value that is not allowed."""


class InputError(RadiometerError):
    """The data handed in cannot be used."""


class CaptureError(InputError):
    """A capture set or photograph folder is unfinished or inconsistent."""


class DamagedFileError(CaptureError):
    """A file of pictures is damaged or cut short; others in the folder may be whole."""


class UnsettledError(InputError):
    """A file states a number whose unit or meaning is not known: the user must settle it."""

    @classmethod
    def of_unit(
        cls, where: str, place: str, written: object, unit: str, fact: str, offered: tuple[str, ...]
    ) -> UnsettledError:
        """Return the error of a number without a known unit, with the option that settles it.

        Args:
            where: The file; "" where the message is prefixed by the caller.
            place: Keyword, tag or column.
            written: What stands there.
            unit: The unit as written; "" where there is none.
            fact: What is stated, such as "exposure".
            offered: Units that --map takes; none where the command has no such option.
        """
        has = f"in {unit}, which is not one known unit" if unit else "without a unit"
        option = f", or read it with --map {fact}={place}:UNIT (UNIT: {', '.join(offered)})" if offered else ""
        return cls(
            f"{where}{': ' if where else ''}{place} states {str(written).strip()[:40]} {has}. State the unit in the "
            f"file{option}"
        )


class CalibrationError(InputError):
    """A calibration does not fit the camera or the question asked of it."""


class MeasurementError(RadiometerError):
    """The measurement cannot be done with this scene or these frames."""


class OutputError(RadiometerError):
    """A result cannot be written."""


class OutputRefused(OutputError):
    """The place of a result is refused before the work begins: it exists, or takes no file."""

    exit_code = 2


class DeviceError(RadiometerError):
    """A camera, light box or display cannot do what was asked."""


class DeviceNotFound(DeviceError):
    """No device answers to that name."""


class DeviceInUse(DeviceError):
    """Another program holds the device."""


class DeviceLost(DeviceError):
    """The device stopped answering; reopening it may work."""


class DeviceTimeout(DeviceError):
    """The device did not answer within the deadline."""


class SettingOutOfRange(DeviceError, ValueError):
    """A requested value is outside the device's limits; nothing was changed."""

    def __reduce__(self) -> tuple[type[SettingOutOfRange], tuple[object, ...]]:
        """Return how it is made anew in another process."""
        return type(self), (self.device, self.name, self.value, self.low, self.high, self.unit)

    def __init__(self, device: str, name: str, value: float, low: float, high: float, unit: str) -> None:
        self.device, self.name, self.value, self.low, self.high, self.unit = (
            device,
            name,
            value,
            low,
            high,
            unit,
        )
        printed = unit_text(unit)
        of_unit = f" {printed}" if printed else ""
        asked = _apart(value, low, high)
        super().__init__(f"{device}: {name} {asked}{of_unit} is out of range; allowed is {low:g} to {high:g}{of_unit}")


def _apart(value: float, *limits: float) -> str:
    """Return a value with as many digits as distinguish it from each limit."""
    forms = (f"{value:.{digits}g}" for digits in (6, 9, 12, 17))
    return next((text for text in forms if all(float(text) != float(f"{limit:g}") for limit in limits)), f"{value!r}")


class UnsafeStimulus(DeviceError):
    """A light level is above what the eye or the box may take."""


class LightEnded(DeviceError):
    """Light that was asked for was not given: darkness was asked for before it began."""


class MissingLibrary(DeviceError):
    """A system library is not installed; the message names the packages."""


def required_library(module: str, remedy: str) -> Any:
    """Return a module of a library that not everybody needs.

    Args:
        module: Its full name.
        remedy: What needs it, and how it is installed.

    Raises:
        MissingLibrary: If it is not installed; with the remedy.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingLibrary(remedy) from error

"""The camera as a photometer of PsychoPy's, by its conventions; usable without PsychoPy too.

The distribution declares it as a plugin of PsychoPy's (entry points `psychopy.hardware.photometer` and
`psychopy.experiment.monitor`), so that Monitor Center lists the camera among its photometers.
"""

from __future__ import annotations

import os
import time
import warnings
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from radiometer.adapters.readings import DaemonSource, MeterSource, ReadingSource
from radiometer.data import Flag, Patch, Reading
from radiometer.errors import MeasurementError

ADDRESS_VARIABLE: Final = "RADIOMETER_PHOTOMETER"
DEFAULT_ADDRESS: Final = "http://127.0.0.1:8080"
DEVICE_NAME: Final = "radiometer camera"
_SECONDS: Final = time.monotonic

try:
    from psychopy.hardware.photometer import BasePhotometerDevice, PhotometerResponse
except ImportError:

    @dataclass
    class PhotometerResponse:  # type: ignore[no-redef]
        """A response in the form of PsychoPy's, for use without it."""

        t: float
        value: float
        device: Any = None

    class BasePhotometerDevice:  # type: ignore[no-redef]
        """What of PsychoPy's photometers is needed without it: the list of responses."""

        def __init__(self) -> None:
            self.responses: list[PhotometerResponse] = []

        def receiveMessage(self, message: PhotometerResponse) -> bool:  # noqa: N802 (PsychoPy's name)
            """Keep a response."""
            self.responses.append(message)
            return True


class RadiometerPhotometer(BasePhotometerDevice):  # type: ignore[misc]
    """A photometer for Monitor Center, `psychopy.hardware.monitor.calibrateGamma` and `monitors.getLumSeries`.

    Args:
        address: A daemon's address (http://…), or what `radiometer.open` takes: a bench file, "sim", or a camera's
            serial number; where None, what the environment's RADIOMETER_PHOTOMETER says, else the daemon of this
            machine.
        patch: (x, y, width, height) in pixels where the camera sees the middle of the screen.
        spectrum: Spectrum that the screen's light is taken to have, such as "white_led"; the calibration's where None.
            A daemon keeps its own.

    Raises:
        DeviceError: If the camera cannot be opened.

    Source: PsychoPy 2026.2.5: `BasePhotometerDevice` (`dispatchMessages`, `parseMessage`, `responses`), the device
    manager (`getAvailableDevices`, `isSameDevice`), and what `getLumSeries` and Monitor Center ask of older photometers
    (`type`, `OK`, `lastLum`, `portString`).
    """

    responseClass = PhotometerResponse  # noqa: N815 (PsychoPy's name)
    longName: Final = DEVICE_NAME  # noqa: N815 (PsychoPy's name)
    driverFor: Final = ("radiometer",)  # noqa: N815 (PsychoPy's name)
    type: Final = "radiometer"

    def __init__(
        self,
        address: str | None = None,
        patch: tuple[int, int, int, int] | None = None,
        spectrum: str | None = None,
        *,
        source: ReadingSource | None = None,
    ) -> None:
        super().__init__()
        self._held = ExitStack()
        self.portString = address or _default_address()
        self._source = source or _opened(self.portString, Patch(*patch) if patch else None, spectrum, self._held)
        self.OK = True
        self.lastLum: float | None = None
        self.lastReading: Reading | None = None

    def getLum(self) -> float:  # noqa: N802 (PsychoPy's name)
        """Measure and return the luminance in cd·m⁻²; it stays in `lastLum`, with its uncertainty in `lastReading`.

        Raises:
            DeviceError: If camera or daemon fail.
            MeasurementError: If the spectrum of the light is not known, so that there is no luminance, or the patch is
                saturated.
        """
        self.dispatchMessages()
        return float(self.responses[-1].value)

    def getResponse(self) -> PhotometerResponse:  # noqa: N802 (PsychoPy's name)
        """Measure and return the response: `value` in cd·m⁻², `t` in s on the device's clock. Raises as `getLum`."""
        self.dispatchMessages()
        return self.responses[-1]

    def dispatchMessages(self) -> None:  # noqa: N802 (PsychoPy's name)
        """Measure once and hand the response to who listens. Raises as `getLum`."""
        self.receiveMessage(self.parseMessage(self._source.measure()))

    def parseMessage(self, message: Reading) -> PhotometerResponse:  # noqa: N802 (PsychoPy's name)
        """Return a reading as a response; one below the noise warns, for its value may be any up to its uncertainty.

        Raises:
            MeasurementError: If it has no luminance, or is a lower bound alone.
        """
        if Flag.SATURATED in message.flags:
            raise MeasurementError(
                f"{message} is a lower bound: the patch is saturated; shorten the exposure, or let the camera choose"
                " it (SENS:EXP:AUTO ON)"
            )
        if message.luminance is None:
            raise MeasurementError(
                "the spectrum of the light is not known, so that there is no luminance: give spectrum='white_led', or "
                "calibrate with --spectrum"
            )
        if Flag.BELOW_NOISE in message.flags:
            warnings.warn(f"{message} is below the noise", stacklevel=3)
        self.lastReading, self.lastLum = message, message.luminance.value
        return PhotometerResponse(t=_SECONDS(), value=message.luminance.value, device=self)

    def getInfo(self) -> str:  # noqa: N802 (PsychoPy's name)
        """Return what answers."""
        return f"{DEVICE_NAME} ({self._source.origin})"

    def isSameDevice(self, other: Any) -> bool:  # noqa: N802 (PsychoPy's name)
        """Tell whether another device, or a profile of one, is read at the same address."""
        address = other.get("address") if isinstance(other, dict) else getattr(other, "portString", None)
        return address == self.portString

    @staticmethod
    def getAvailableDevices() -> list[dict[str, Any]]:  # noqa: N802 (PsychoPy's name)
        """Return the profile by which PsychoPy's device manager makes this device."""
        return [{"deviceName": DEVICE_NAME, "address": _default_address()}]

    def close(self) -> None:
        """Close the camera; again does nothing."""
        self._held.close()

    def __enter__(self) -> RadiometerPhotometer:
        """Return the photometer itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the camera."""
        self.close()


def _default_address() -> str:
    return os.environ.get(ADDRESS_VARIABLE, DEFAULT_ADDRESS)


def _opened(address: str, patch: Patch | None, spectrum: str | None, held: ExitStack) -> ReadingSource:
    if address.startswith(("http://", "https://")):
        return DaemonSource(address, patch, os.environ.get("RADIOMETER_TOKEN") or None)
    from radiometer.api.meter import Meter
    from radiometer.bench.assembly import open_instrument

    bench = Path(address) if address.endswith((".yaml", ".yml")) else None
    instrument = held.enter_context(open_instrument(bench, None if bench else address, patch, spectrum=spectrum))
    return MeterSource(Meter(instrument, ExitStack()))

"""Where an adapter's readings come from: a meter of this process, or a running daemon."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, Protocol

from radiometer.api.meter import Meter
from radiometer.data import Patch, Quantity, Reading
from radiometer.data.json_text import json_text, parsed_json
from radiometer.data.reading import Flag
from radiometer.errors import DeviceError, DeviceLost

TIMEOUT_S: Final = 120.0  # as the daemon's own deadline of a measurement


class ReadingSource(Protocol):
    """Measures once when asked."""

    @property
    def origin(self) -> str:
        """Return what measures, such as "radiometer:22500001"."""

    def measure(self) -> Reading:
        """Return one reading. Raises DeviceError, MeasurementError."""


@dataclass(frozen=True, slots=True)
class MeterSource:
    """Readings of an open meter."""

    meter: Meter  # the meter
    patch: Patch | None = None  # where to read; the meter's own patch where None

    @property
    def origin(self) -> str:
        """Return "radiometer:" and the camera's serial number."""
        return f"radiometer:{self.meter.instrument.camera.identity.serial}"

    def measure(self) -> Reading:
        return self.meter.measure(self.patch)


@dataclass(frozen=True, slots=True)
class DaemonSource:
    """Readings of a daemon, measured when asked (`POST /measure`)."""

    url: str  # address of its HTTP interface, such as http://127.0.0.1:8080
    patch: Patch | None = None  # where to read; the daemon's own patch where None
    token: str | None = None  # its token, where it asks for one
    timeout_s: float = TIMEOUT_S  # longest wait for a reading in s

    @property
    def origin(self) -> str:
        """Return the daemon's address."""
        return self.url.rstrip("/")

    def measure(self) -> Reading:
        """Return one reading.

        Raises:
            DeviceLost: If the daemon does not answer.
            DeviceError: If it refuses; the message is the daemon's own.
        """
        where = self.patch
        asked = {"patch": asdict(where)} if where else {}
        headers = {"Content-Type": "application/json"} | (
            {"Authorization": f"Bearer {self.token}"} if self.token else {}
        )
        request = urllib.request.Request(f"{self.origin}/measure", json_text(asked).encode(), headers)
        try:
            with urllib.request.urlopen(request, timeout=self.timeout_s) as reply:
                return reading_of(parsed_json(reply.read()))
        except urllib.error.HTTPError as error:
            raise DeviceError(f"{self.origin} refuses: {_reason(error)}") from error
        except ValueError as error:
            raise DeviceError(f"what {self.origin} answers is no reading: {error}") from error
        except OSError as error:
            raise DeviceLost(
                f"{self.origin} does not answer: {error}; start `radiometer serve`, or correct the address"
            ) from error


def reading_of(mapping: Mapping[str, Any]) -> Reading:
    """Return a reading from its documented JSON form. Raises DeviceError if it is none."""
    try:
        luminance = mapping.get("luminance")
        return Reading(
            radiance=_quantity(mapping["radiance"]),
            patch=Patch(**mapping["patch"]),
            instrument=str(mapping["instrument"]),
            luminance=_quantity(luminance) if luminance else None,
            flags=tuple(Flag(flag) for flag in mapping["flags"]),
            exposures_s=tuple(mapping["exposures_s"]),
            sequence=int(mapping["sequence"]),
            coverage_factor=float(mapping["coverage_factor"]),
            time=str(mapping["time"]),
            band_nm=tuple(mapping["band_nm"]) if mapping.get("band_nm") else None,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise DeviceError(f"what came is no reading: {error}; is it a radiometer daemon of this version?") from error


def _quantity(mapping: Mapping[str, Any]) -> Quantity:
    u = mapping["u"]  # JSON knows no infinity: null means it
    return Quantity(float(mapping["value"]), float("inf") if u is None else float(u), str(mapping["unit"]))


def _reason(error: urllib.error.HTTPError) -> str:
    text = error.read().decode("utf-8", "replace").strip()
    try:
        answer = parsed_json(text)
    except ValueError:
        return text or str(error)
    return str(answer.get("error", text)) if isinstance(answer, dict) else text

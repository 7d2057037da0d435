"""The light box's driver on a simulated line, in simulated time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from zlib import crc32

from drivers.light_box.box import SerialLightBox
from drivers.light_box.link import BoxLink
from radiometer.devices.exposure_account import MemoryStore
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.retinal_safety import ChannelOptics


def sealed(body: bytes) -> bytes:
    """Return a line whose checksum is right, whatever it says."""
    return body + f"*{crc32(body):08X}".encode()


def driver_on(line: Any, optics: Mapping[str, ChannelOptics], *calibration: Any, **options: Any) -> SerialLightBox:
    """Return an unopened driver whose requests are numbered from 0, with an account that knows the simulated box."""
    ledger = ExposureLedger(dict(optics), MemoryStore(line.now, ("TWIN0001",)))
    return SerialLightBox(BoxLink(line, _sequence=0), ledger, *calibration, keep_alive=False, **options)


def pass_time(line: Any, box: SerialLightBox, seconds: float) -> None:
    """Let time pass with the box tended."""
    end_s = line.now() + seconds
    while (left_s := end_s - line.now()) > 1e-9:
        line.wait(min(left_s, 0.2))
        box.tend_if_due()

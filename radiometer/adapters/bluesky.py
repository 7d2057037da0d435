"""A Bluesky detector that reads radiance, and a light box's level as what a plan scans.

with open_light_bench() as (detector, level):        # the simulated light box and the camera before it
    run_engine(bp.scan([detector], level, 500, 4000, 8))
"""

from __future__ import annotations

import asyncio
import dataclasses
import math
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Final

from radiometer.adapters.readings import ReadingSource
from radiometer.data.reading import LUMINANCE_UNIT, RADIANCE_UNIT, Reading
from radiometer.devices.light_box import LightBox
from radiometer.errors import MissingLibrary, UsageError

try:
    from bluesky.protocols import Movable
    from ophyd_async.core import AsyncStatus, StandardReadable, StandardReadableFormat, soft_signal_r_and_setter
except ImportError as _error:
    raise MissingLibrary("Bluesky's adapters need ophyd-async: pip install 'radiometer[bluesky]'") from _error

if TYPE_CHECKING:
    from event_model import DataKey

_RELATIVE: Final = "relative"


class RadiometerDetector(StandardReadable):
    """A readable device: each trigger measures once, and documents hold radiance ± u with their units.

    Documents hold `radiance` and `u_radiance` (standard uncertainty, k = 1), `luminance` and `u_luminance` (NaN where
    no spectrum is known), the expanded relative uncertainty `U_rel` and the `flags` (a,b).

    Args:
        source: What measures: a meter of this process or a daemon.
        unit: Unit of the radiance: "W sr-1 m-2", or "relative" for a camera without calibration.
    """

    def __init__(self, source: ReadingSource, name: str = "", *, unit: str = RADIANCE_UNIT) -> None:
        if unit not in (RADIANCE_UNIT, _RELATIVE):
            raise UsageError(f"unit {unit!r}: a camera gives {RADIANCE_UNIT!r}, or {_RELATIVE!r} without calibration")
        self._source, self._unit = source, unit
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.radiance, self._set_radiance = soft_signal_r_and_setter(float, units=unit)
        with self.add_children_as_readables():
            self.u_radiance, self._set_u_radiance = soft_signal_r_and_setter(float, units=unit)
            self.luminance, self._set_luminance = soft_signal_r_and_setter(float, units=LUMINANCE_UNIT)
            self.u_luminance, self._set_u_luminance = soft_signal_r_and_setter(float, units=LUMINANCE_UNIT)
            self.expanded_u_rel, self._set_expanded = soft_signal_r_and_setter(float, units="1")
            self.flags, self._set_flags = soft_signal_r_and_setter(str)
        super().__init__(name=name)

    @AsyncStatus.wrap
    async def trigger(self) -> None:
        """Measure once.

        Raises:
            DeviceError: If camera or daemon fail.
            UsageError: If the reading is in another unit than this device describes.
        """
        reading = await asyncio.to_thread(self._source.measure)
        self._keep(reading)

    def _keep(self, reading: Reading) -> None:
        radiance, luminance = reading.radiance, reading.luminance
        if radiance.unit != self._unit:
            raise UsageError(f"readings are in {radiance.unit!r}: make the detector with unit={radiance.unit!r}")
        self._set_radiance(radiance.value)
        self._set_u_radiance(radiance.u)
        self._set_luminance(luminance.value if luminance else math.nan)
        self._set_u_luminance(luminance.u if luminance else math.nan)
        self._set_expanded(reading.expanded_u_rel)
        self._set_flags(",".join(reading.flags))

    async def describe(self) -> dict[str, DataKey]:
        """Return dtype, shape, units and source by name; the source names camera or daemon."""
        keys = await super().describe()
        ours = len(self.name) + 1
        for name, key in keys.items():
            key["source"] = f"{self._source.origin}/{name[ours:]}"
        return keys


class LightBoxLevel(StandardReadable, Movable[float]):
    """The level of one channel of a light box, as something that a plan moves.

    Args:
        box: The open box.
        gate: Held while the box is spoken to; share it with who else does.
    """

    def __init__(self, box: LightBox, channel: str, name: str = "", *, gate: threading.RLock | None = None) -> None:
        if channel not in box.channels:
            raise UsageError(f"there is no channel {channel!r}; the box has {', '.join(box.channels)}")
        self._box, self._channel, self._gate = box, channel, gate or threading.RLock()
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.level, self._set_level = soft_signal_r_and_setter(int, units="1")
        super().__init__(name=name)

    def set_name(self, name: str, *, child_name_separator: str | None = None) -> None:
        """Name the device; its level is read under the same name, as a plan's scanned axis is."""
        super().set_name(name, child_name_separator=child_name_separator)
        self.level.set_name(name)

    @AsyncStatus.wrap
    async def set(self, value: float) -> None:
        """Set the level, rounded to a whole one. Raises SettingOutOfRange, UnsafeStimulus, DeviceError."""
        self._set_level(await asyncio.to_thread(self._drive, round(value)))

    def _drive(self, level: int) -> int:
        from radiometer.devices.light_box import DriveLevel

        with self._gate:
            return self._box.set_level(self._channel, DriveLevel(level)).drive.level


@dataclasses.dataclass(frozen=True, slots=True)
class _Gated:
    """Readings taken while no other thread speaks to the box that the camera looks at."""

    source: ReadingSource
    gate: threading.RLock

    @property
    def origin(self) -> str:
        return self.source.origin

    def measure(self) -> Reading:
        with self.gate:
            return self.source.measure()


@contextmanager
def open_light_bench(
    box: str = "sim", channel: str = "spot", *, detector_name: str = "radiometer", level_name: str = "level"
) -> Iterator[tuple[RadiometerDetector, LightBoxLevel]]:
    """Open a light box and the camera that looks at it, as devices of a plan, for the block.

    Args:
        box: "sim", a serial number or a port.

    Raises:
        DeviceError: If box or camera cannot be opened.
    """
    from radiometer.adapters.readings import MeterSource
    from radiometer.api.meter import Meter
    from radiometer.bench.boxes import open_light_box
    from radiometer.bench.light_bench import open_light_camera

    gate = threading.RLock()
    with open_light_box(box) as opened, open_light_camera(opened, None, None, None, None) as instrument:
        source = _Gated(MeterSource(Meter(instrument, ExitStack())), gate)
        yield RadiometerDetector(source, detector_name), LightBoxLevel(opened.box, channel, level_name, gate=gate)

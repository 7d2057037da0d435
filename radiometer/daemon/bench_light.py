"""A light box of the bench as the daemon's light source: opens, reopens, sets levels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path

from radiometer.bench.boxes import open_light_box
from radiometer.daemon.instrument import DeviceReport
from radiometer.devices.light_box import FULL_LEVEL, ChannelState, CurrentRange, DriveLevel, LightBox
from radiometer.errors import DeviceError


class BenchLight:
    """The light box that `open_box` gives.

    Levels go from 0 to 1 of the high-current range; what a channel's own limit or the retinal-exposure account does
    not allow is refused by the box's driver.

    Args:
        open_box: Returns a block in which the box is open; called again after each loss.
    """

    def __init__(self, open_box: Callable[[], AbstractContextManager[LightBox]], name: str = "light box") -> None:
        self._open_box, self._name = open_box, name
        self._box: LightBox | None = None
        self._held = ExitStack()
        self._channels: tuple[str, ...] = ()
        self._limits: dict[str, float] = {}

    @property
    def name(self) -> str:
        """Return the name for messages."""
        return self._name

    @property
    def channels(self) -> tuple[str, ...]:
        """Return the names of the channels; empty before the box was first open."""
        return self._channels

    @property
    def level_limits(self) -> dict[str, float]:
        """Return the highest level of each channel that the box would have accepted when it was last asked."""
        return dict(self._limits)

    @property
    def late_at(self) -> float | None:
        """Return None: every exchange with the box has a short deadline."""
        return None

    def open(self) -> None:
        """Open the box, all channels dark. Raises DeviceError."""
        self.close()
        with ExitStack() as opening:
            box = opening.enter_context(self._open_box())
            self._channels = tuple(box.channels)
            self._held = opening.pop_all()
        self._box = box

    def close(self) -> None:
        """Switch every channel off and release the box."""
        self._box = None
        self._held.close()

    def check(self) -> DeviceReport:
        """Ask the box for temperature, counts and what each channel really does. Raises DeviceError."""
        box = self._opened()
        status, levels = box.status(), {name: _level(box.read_channel(name)) for name in self._channels}
        self._limits = {name: _highest(box, name) for name in self._channels}
        counts = {"damaged_lines": status.damaged_lines, "lost_bytes": status.lost_bytes, "darkened": status.darkened}
        return DeviceReport(status.temperature_celsius, counts, levels)

    def set_level(self, channel: str, level: float) -> float:
        """Set a channel's level, 0 to 1, and return it as read back. Raises DeviceError."""
        box = self._opened()
        if level == 0.0:
            box.off(channel)
            return 0.0
        state = box.set_level(channel, DriveLevel(max(1, round(level * FULL_LEVEL)), CurrentRange.HIGH))
        return _level(state)

    def _opened(self) -> LightBox:
        if self._box is None:
            raise DeviceError(f"the {self._name} is not open")
        return self._box


def _highest(box: LightBox, channel: str) -> float:
    """Return the highest steady level that a box accepts now; its own limit where it keeps no account."""
    highest = getattr(box, "highest_level", None)
    level = highest(channel) if highest else box.channels[channel].level_limit[CurrentRange.HIGH]
    return int(level) / FULL_LEVEL


def _level(state: ChannelState) -> float:
    """Return the level on the high range that a channel is driven at; one on the low range counts as what it is."""
    return state.drive.level / FULL_LEVEL


def bench_light(name: str, calibration: Path | None = None, preset: Path | None = None) -> BenchLight:
    """Return the light box of a name as the daemon's light source, not yet open.

    Args:
        name: "sim", a serial number or a port.
        calibration: Calibration file; the one kept for its serial number where None.
        preset: Light-box preset; the reference box's where None.
    """

    @contextmanager
    def open_box() -> Iterator[LightBox]:
        with open_light_box(name, calibration=calibration, preset=preset) as opened:
            yield opened.box

    return BenchLight(open_box)

"""The light box as clients see it: levels as the box itself states them, and an alarm where they are not as set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.instrument import DeviceReport, LightSource
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.keeper import DeviceKeeper, DeviceState, KeeperTimes
from radiometer.errors import DeviceError, DeviceLost, LightEnded, SettingOutOfRange

_TOLERANCE: Final = 1e-6  # levels are 16-bit numbers, read back as such


@dataclass(slots=True)
class Asker:
    """Who asks for light, and what others had asked for when that request came.

    It may have waited for long before it is served. Its own darkness ends nothing that it asks for after it.
    """

    others: Counter[str]  # how often others had asked for darkness, by channel
    own: Counter[str] = field(default_factory=Counter)  # how often it has asked for darkness itself


class Light:
    """Owns the light box, where there is one.

    Args:
        box: The box; None for none.
        alarms: Where loss, and light that is not as set, are reported.
        times: Pauses and deadlines of looking after it.
        changed: Called after every change.
    """

    def __init__(
        self,
        box: LightSource | None,
        alarms: Alarms,
        writer: JournalWriter,
        times: KeeperTimes | None,
        changed: Callable[[], None],
    ) -> None:
        self.box, self._alarms, self._writer, self._changed = box, alarms, writer, changed
        self.levels: dict[str, float] = {}
        self._ended: Counter[str] = Counter()  # how often darkness was asked for, by channel
        self.keeper = (
            DeviceKeeper("light box", box, alarms, times=times, after_open=self._opened, after_check=self._reported)
            if box
            else None
        )

    @property
    def is_confirmed(self) -> bool:
        """Return whether the levels are those that the box itself states: a lost one may do anything."""
        return self.keeper is not None and self.keeper.state is DeviceState.READY

    def darkened_by_others(self, asker: Asker | None = None) -> Counter[str]:
        """Return how often darkness was asked for, by channel, by all but an asker."""
        channels = self.box.channels if self.box else ()
        own = asker.own if asker else Counter[str]()
        return Counter({channel: self._darkened(channel) - own[channel] for channel in channels})

    def _darkened(self, channel: str) -> int:
        """Return how often darkness was asked for, of this program and, by other programs, of the box itself."""
        return self._ended[channel] + int(getattr(self.box, "switched_off", 0))

    async def set_level(self, channel: str, level: float, asker: Asker | None = None) -> float:
        """Set a channel's level, 0 to 1, and return it as read back.

        Darkness ends what waits: light that was asked for before, and has not begun, is not given.

        Args:
            asker: Who asks, where the request waited before it came here; None where it did not.

        Raises:
            SettingOutOfRange: If the level is outside 0 to 1.
            LightEnded: If darkness was asked for before the light began.
            DeviceLost: If there is no box or it is lost.
        """
        box, keeper = self._present()
        if not 0.0 <= level <= 1.0:
            raise SettingOutOfRange(box.name, f"level of {channel}", level, 0.0, 1.0, "")
        if level == 0.0:
            self._darkness_of(asker, channel)
        asked = asker.others[channel] + asker.own[channel] if asker else self._darkened(channel)

        def set_level() -> float:
            if level and self._darkened(channel) != asked:
                raise LightEnded(f"{box.name}: {channel} was darkened before its light began; ask again")
            return box.set_level(channel, level)

        self._took(channel, await keeper.use(set_level))
        return self.levels[channel]

    def _darkness_of(self, asker: Asker | None, *channels: str) -> None:
        """Note that darkness is asked for: all light that waits is ended."""
        self._ended.update(channels)
        if asker is not None:
            asker.own.update(channels)

    def _took(self, channel: str, level: float) -> None:
        """Note the level that a channel took."""
        if bool(self.levels.get(channel, 0.0)) != bool(level):
            self._writer.note("light", f"{channel} lit at {level:.4g}" if level else f"{channel} switched off")
        self.levels[channel] = level
        self._alarms.clear(light_alarm(channel), f"{channel} was set anew")
        self._changed()

    def limit(self, channel: str) -> float:
        """Return the highest level, 0 to 1, that the box allowed a channel when it was last asked."""
        limits: dict[str, float] = getattr(self.box, "level_limits", {}) or {}
        return limits.get(channel, 1.0)

    async def off(self, asker: Asker | None = None) -> None:
        """Darken every channel, whatever is known of it; each is tried although another failed.

        Nothing that waits comes before it: light that was asked for and has not begun is not given.

        Args:
            asker: Who asks; None where nothing that it asks for after it can wait already.

        Raises:
            DeviceLost: If there is no box, or it is lost: it is dark by itself 1 s after it was.
            DeviceError: If a channel could not be darkened.
        """
        box, keeper = self._present()
        if not box.channels:
            raise DeviceLost(f"the light box was never reached, so nothing was darkened: {keeper.loss_message()}")
        self._darkness_of(asker, *box.channels)
        dark, failures = list[str](), list[DeviceError]()

        def darken() -> None:
            for channel in box.channels:
                try:
                    box.set_level(channel, 0.0)
                    dark.append(channel)
                except DeviceError as error:
                    failures.append(error)
            if failures:
                raise failures[-1]

        try:
            await keeper.use(darken)
        finally:
            for channel in dark:
                self._took(channel, 0.0)

    def to_mapping(self) -> dict[str, Any]:
        """Return levels (null where the box does not confirm them), their limits, and whether they are confirmed."""
        confirmed = self.is_confirmed
        return {
            "light": {channel: level if confirmed else None for channel, level in self.levels.items()},
            "light_limits": dict(getattr(self.box, "level_limits", {}) or {}),
            "light_confirmed": confirmed,
        }

    def _present(self) -> tuple[LightSource, DeviceKeeper]:
        if self.box is None or self.keeper is None:
            raise DeviceLost("no light box is configured; name one in the bench file")
        return self.box, self.keeper

    def _opened(self) -> None:
        """A box that comes back is dark: the levels set before are gone, which is an alarm, and not believed."""
        for channel, level in self.levels.items():
            if level:
                message = f"{channel} was set to {level:.4g} and went dark when the light box was lost or restarted"
                self._alarms.put_up(light_alarm(channel), message)
        self.levels = dict.fromkeys(self.box.channels, 0.0) if self.box else {}

    def _reported(self, report: DeviceReport) -> None:
        """Take over what the box says that it does; light that is not as it was set is an alarm."""
        for channel, level in (report.levels or {}).items():
            believed = self.levels.get(channel, 0.0)
            if abs(level - believed) <= _TOLERANCE:
                continue
            self.levels[channel] = level
            message = (
                f"{channel} was set to {believed:.4g} and went dark by itself: its energy budget is used up, its button"
                " was held, or another program asked for darkness"
                if level == 0.0
                else f"{channel} is at {level:.4g} where {believed:.4g} was set"
            )
            self._alarms.put_up(light_alarm(channel), message)
            self._changed()


def light_alarm(channel: str) -> str:
    """Return the name of the alarm that a channel is not as it was set."""
    return f"light {channel}"

"""The patches that are measured: where each is, its latest reading, its limits, and the alarms of these."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any, Final

from radiometer.daemon.acquisition import ALARM as MEASUREMENT_ALARM
from radiometer.daemon.acquisition import Acquisition
from radiometer.daemon.alarms import Alarms, Lateness
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.metrics import Metrics
from radiometer.daemon.patches import MAIN, MOST_PATCHES, NamedPatch, PatchLimits, PatchWatch, check_name
from radiometer.data import Patch, Reading
from radiometer.errors import UsageError

_SLOW: Final = 5.0  # times the period at which limits were set: they are hardly watched then
_SLOW_S: Final = 10.0  # a shorter period than this watches them well enough


class PatchBook:
    """Owns the patch that is measured for all and those with names.

    Args:
        alarms: Where a broken limit is reported.
        changed: Called after every change.
    """

    def __init__(
        self,
        acquisition: Acquisition,
        lateness: Lateness,
        writer: JournalWriter,
        alarms: Alarms,
        metrics: Metrics,
        changed: Callable[[], None],
    ) -> None:
        self._acquisition, self._lateness, self._writer = acquisition, lateness, writer
        self._alarms, self._metrics, self._changed = alarms, metrics, changed
        self.watches: dict[str, PatchWatch] = {MAIN: PatchWatch()}

    def define(self, name: str, patch: Patch) -> None:
        """Measure a patch with a name from now on, in addition to the one for all; one of that name is moved.

        Raises:
            UsageError: If the name cannot be one, the patch is not inside the picture, or there are too many.
        """
        check_name(name)
        acquisition = self._acquisition
        acquisition.check_settings(replace(acquisition.settings, patch=patch))
        if name not in acquisition.named and len(acquisition.named) >= MOST_PATCHES:
            raise UsageError(f"there are {MOST_PATCHES} patches with names already; delete one first")
        before = self.watches.get(name, PatchWatch())
        self._metrics.drop_patch(name)
        self.watches[name] = PatchWatch(before.limits, before.every_s)
        acquisition.named[name] = patch
        acquisition.hasten(name)
        self._lateness.expect(name)
        self._keep(name)
        self._alarms.clear(limit_alarm(name), "the patch was moved")
        self._writer.note("patch", f"{name} is {patch}")
        self._changed()

    def delete(self, name: str) -> None:
        """Measure a patch no longer; its readings stay in the journal. Raises UsageError if there is none."""
        self._watch(name)
        if name == MAIN:
            raise UsageError(f"{MAIN!r} is the patch that is measured for all; it can be moved, not deleted")
        del self.watches[name], self._acquisition.named[name]
        self._metrics.drop_patch(name)
        self._lateness.forget(name)
        self._writer.keep_patch(name, None)
        for alarm in (limit_alarm(name), f"{MEASUREMENT_ALARM} {name}"):
            self._alarms.clear(alarm, "the patch was deleted")
        self._writer.note("patch", f"{name} was deleted")
        self._changed()

    def set_limits(self, name: str, limits: PatchLimits) -> None:
        """Alarm where a patch leaves its limits. Raises UsageError if there is no such patch."""
        watch = self._watch(name)
        if limits.any and not limits.unit and watch.latest:
            limits = replace(limits, unit=watch.latest.radiance.unit)
        watch.limit(limits)
        if watch.every_s is None or not limits.any:
            watch.every_s = self._acquisition.every_s if limits.any else None
        self._acquisition.hasten(name)
        self._metrics.limit_alarm.labels(name).set(0)
        self._keep(name)
        self._alarms.clear(limit_alarm(name), "the limits were set anew")
        self._writer.note("patch", limits.note(name))
        self._changed()

    @property
    def unwatched(self) -> list[str]:
        """Return the names of the patches with limits that no continuous measurement, or too rare a one, watches.

        Limits are to be watched at the period at which they were set, or the first one after it, whatever daemon
        measures since then.
        """
        every_s = self._acquisition.every_s
        for name, watch in self.watches.items():
            if watch.limits.any and watch.every_s is None and every_s is not None:
                watch.every_s = every_s
                self._keep(name)
        limited = {name: watch for name, watch in self.watches.items() if watch.limits.any}
        if every_s is None:
            return list(limited)
        return [n for n, watch in limited.items() if every_s > max(_SLOW * (watch.every_s or 0.0), _SLOW_S)]

    def latest_of(self, name: str) -> Reading | None:
        """Return the latest reading of a patch, "main" for the one for all. Raises UsageError if there is no such."""
        return self._watch(name).latest

    def take(self, name: str, reading: Reading) -> None:
        """Take a committed reading of a patch: it is its latest, and may break its limits."""
        self._lateness.came(name)
        watch = self.watches[name]
        if watch.limits.any and not watch.limits.unit:
            watch.limits = replace(watch.limits, unit=reading.radiance.unit)
            self._keep(name)
            self._writer.note("patch", watch.limits.note(name))
        if not watch.take(reading):
            return
        self._metrics.limit_alarm.labels(name).set(bool(watch.breached))
        if watch.breached:
            self._alarms.put_up(limit_alarm(name), watch.message(name), worse=True)
        else:
            self._alarms.clear(limit_alarm(name), f"patch {name} is within its limits again")

    def forget_main(self) -> None:
        """Forget the readings of the patch for all: it is another place, or another wavelength, now."""
        before = self.watches[MAIN]
        self.watches[MAIN] = PatchWatch(before.limits, before.every_s)
        self._alarms.clear(limit_alarm(MAIN), "the patch was moved")

    def restore(self, kept: Mapping[str, str]) -> None:
        """Take over what the journal has kept of patches, as lines of JSON by name."""
        for name, line in kept.items():
            named = NamedPatch.from_json(name, line)
            self.watches[name] = PatchWatch(named.limits, named.every_s)
            if name != MAIN:
                self._acquisition.named[name] = named.patch
                self._lateness.expect(name)

    def to_mapping(self) -> dict[str, Any]:
        """Return place, limits and broken limit by name."""
        return {name: self._mapping_of(name) for name in self.watches}

    def _mapping_of(self, name: str) -> dict[str, Any]:
        watch, patch = self.watches[name], self._acquisition.named.get(name, self._acquisition.settings.patch)
        return {
            "patch": asdict(patch) if patch else None,
            "limits": watch.limits.to_mapping(),
            "breached": watch.breached,
        }

    def _watch(self, name: str) -> PatchWatch:
        if name not in self.watches:
            raise UsageError(f"there is no patch {name[:40]!r}; there are: {', '.join(self.watches)}")
        return self.watches[name]

    def _keep(self, name: str) -> None:
        watch = self.watches[name]
        patch = self._acquisition.named.get(name, Patch(0, 0, 0, 0))  # of the one for all only its limits are kept
        self._writer.keep_patch(name, NamedPatch(name, patch, watch.limits, watch.every_s).to_json())


def limit_alarm(name: str) -> str:
    """Return the name of the alarm that a patch is beyond a limit."""
    return f"limit {name}"

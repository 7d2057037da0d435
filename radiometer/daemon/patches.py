"""Patches with names that are measured in addition to the one for all, and limits that alarm without flapping."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from radiometer.data import Flag, Patch, Reading
from radiometer.data.json_text import json_text, parsed_json
from radiometer.errors import InputError, UsageError
from radiometer.numbers import unit_text

MAIN: Final = "main"  # means the patch that is measured for all where a name is asked for
MOST_PATCHES: Final = 12  # engineering choice: each takes a measurement in every period
_LONGEST_NAME: Final = 32  # fits a column of the page and a level of a topic
UNSEEN: Final = "unseen"  # in place of the limit that is broken: a bound does not show whether it is
_CONFIRMATIONS: Final = 2  # so many readings in a row must say the same: one outlier is no alarm, and no all-clear
DEFAULT_HYSTERESIS_REL: Final = 0.01  # a few times the noise of a reading
_NOTE: Final = re.compile(r"limits of (.+): (\S+) to (\S+)(?: in (.+))?")  # as `PatchLimits.note` writes it


@dataclass(frozen=True, slots=True)
class PatchLimits:
    """Between which radiances a patch should stay."""

    low: float | None = None  # lowest radiance that is well; None for no bound
    high: float | None = None  # highest; None for no bound
    # By which part of a limit the radiance must be back inside before the alarm goes
    hysteresis_rel: float = DEFAULT_HYSTERESIS_REL
    unit: str = ""  # unit of both, that of the first reading compared with them; "" before there was one

    def __post_init__(self) -> None:
        for value in (self.low, self.high):
            if value is not None and not math.isfinite(value):
                raise UsageError("a limit must be a finite radiance")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise UsageError(f"the low limit {self.low:g} must be below the high one {self.high:g}")
        if not 0.0 <= self.hysteresis_rel <= 0.5:
            raise UsageError(f"the hysteresis must be 0 to 0.5 of the limit, not {self.hysteresis_rel:g}")

    @property
    def any(self) -> bool:
        """Return whether there is a limit at all."""
        return (self.low, self.high) != (None, None)

    @property
    def bounds(self) -> str:
        """Return both limits in words."""
        return " to ".join("none" if value is None else f"{value:g}" for value in (self.low, self.high))

    def note(self, name: str) -> str:
        """Return the line among the events of a journal which says that a patch has these limits from now on."""
        return f"limits of {name}: {self.bounds}{f' in {unit_text(self.unit)}' if self.unit and self.any else ''}"

    @classmethod
    def from_note(cls, message: str) -> tuple[str, PatchLimits] | None:
        """Return the patch's name and the limits that an event states, None where it states none."""
        if not (found := _NOTE.fullmatch(message)):
            return None
        name, low, high, unit = found.groups()
        try:
            lowest, highest = (None if text == "none" else float(text) for text in (low, high))
            return name, cls(lowest, highest, unit=unit or "")
        except (ValueError, UsageError):  # of no daemon's writing
            return None

    def to_mapping(self) -> dict[str, float | str | None]:
        """Return {low, high, hysteresis_rel, unit}."""
        return {"low": self.low, "high": self.high, "hysteresis_rel": self.hysteresis_rel, "unit": self.unit}

    def breach(self, reading: Reading, *, standing: bool) -> str:
        """Return which limit a reading breaks, "" where it is well, UNSEEN where the reading cannot show it.

        A saturated value is a lower bound and one below the noise an upper bound: neither breaks the limit that it may
        well be within, nor shows that it is within. A value in another unit than the limits shows nothing.

        Args:
            standing: Whether an alarm is up: then the limits are drawn in by the hysteresis.
        """
        if self.is_of_other_unit(reading):
            return UNSEEN
        value, drawn_in = reading.radiance.value, self.hysteresis_rel if standing else 0.0
        is_known = math.isfinite(value)
        least = value if is_known and Flag.BELOW_NOISE not in reading.flags else -math.inf
        most = value if is_known and Flag.SATURATED not in reading.flags else math.inf
        high = math.inf if self.high is None else self.high - abs(self.high) * drawn_in
        low = -math.inf if self.low is None else self.low + abs(self.low) * drawn_in
        if least > high:
            return "high"
        if most < low:
            return "low"
        return "" if low <= least and most <= high else UNSEEN

    def is_of_other_unit(self, reading: Reading) -> bool:
        """Return whether a reading has another unit than the limits, so that nothing can be compared."""
        return self.any and self.unit not in ("", reading.radiance.unit)


@dataclass(slots=True)
class PatchWatch:
    """Follows one patch: its latest reading, and whether it keeps within its limits."""

    limits: PatchLimits = field(default_factory=PatchLimits)  # the limits
    every_s: float | None = None  # period in s at which they are to be watched; None where it is not known yet
    latest: Reading | None = None  # its latest reading; None where there is none
    breached: str = ""  # which limit it is beyond, as alarmed; "" where it is well, UNSEEN where that is not known
    _saying: str = ""
    _count: int = 0

    def take(self, reading: Reading) -> bool:
        """Take a reading and return whether the alarm has to be put up or taken down."""
        self.latest = reading
        found = self.limits.breach(reading, standing=self.breached in ("high", "low"))
        if found == UNSEEN:
            found = self.breached or UNSEEN  # what was seen stays
        self._count = self._count + 1 if found == self._saying else 1
        self._saying = found
        if found == self.breached or self._count < _CONFIRMATIONS:
            return False
        self.breached = found
        return True

    def limit(self, limits: PatchLimits) -> None:
        """Take other limits; what was alarmed by the old ones is forgotten."""
        self.limits, self.breached, self._saying, self._count = limits, "", "", 0

    def message(self, name: str) -> str:
        """Return what is wrong in words."""
        assert self.latest is not None
        if self.limits.is_of_other_unit(self.latest):
            return (
                f"patch {name} reads {self.latest}, but its limits are in {unit_text(self.limits.unit)}: they are not"
                " compared; measure in that unit, or set the limits anew"
            )
        if self.breached == UNSEEN:
            return f"patch {name} reads {self.latest}: whether it keeps its limits cannot be seen; change the exposure"
        limit = self.limits.high if self.breached == "high" else self.limits.low
        side = "above its high" if self.breached == "high" else "below its low"
        return f"patch {name} reads {self.latest}, {side} limit {limit:g}"


@dataclass(frozen=True, slots=True)
class NamedPatch:
    """A patch with a name."""

    name: str  # its name
    patch: Patch  # where it is
    limits: PatchLimits = field(default_factory=PatchLimits)  # between which radiances it should stay
    every_s: float | None = None  # period in s at which the limits are to be watched; None where it is not known

    def to_json(self) -> str:
        """Return it as one line of JSON."""
        return json_text({"patch": asdict(self.patch), "limits": self.limits.to_mapping(), "every_s": self.every_s})

    @classmethod
    def from_json(cls, name: str, line: str) -> NamedPatch:
        """Return the patch that a line of JSON describes. Raises InputError if it describes none."""
        try:
            content: Mapping[str, Any] = parsed_json(line)
            every_s = content.get("every_s")  # daemons before kept none
            period_s = None if every_s is None else float(every_s)
            return cls(name, Patch(**content["patch"]), PatchLimits(**content["limits"]), period_s)
        except (ValueError, KeyError, TypeError, UsageError) as error:
            raise InputError(
                f"what the journal keeps of patch {name[:40]!r} is damaged ({type(error).__name__}); move the journal "
                "away, and define the patch again"
            ) from error


def check_name(name: str) -> str:
    """Return a name that a patch may have. Raises UsageError."""
    good = 0 < len(name) <= _LONGEST_NAME and name.isascii() and all(c.isalnum() or c in " ._-+" for c in name)
    if not good or name != name.strip() or name.lower() == MAIN:
        raise UsageError(
            f"a patch's name has 1 to {_LONGEST_NAME} letters, digits, blanks or . _ - + and is not {MAIN!r};"
            f" {name[:40]!r} is none"
        )
    return name

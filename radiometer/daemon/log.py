"""Readings, alarms and budgets of a journal, whether the daemon runs or not."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from radiometer.api.files import PathLike
from radiometer.api.result import Result
from radiometer.daemon.journal import BOUNDS, default_journal_path
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter, to_csv
from radiometer.daemon.patches import MAIN, PatchLimits
from radiometer.daemon.timestamps import parse_moment
from radiometer.data.drawing import divided, new_axes, own_axes, write_figure
from radiometer.data.json_text import parsed_json
from radiometer.errors import UsageError
from radiometer.moments import moment_of
from radiometer.numbers import unit_text
from radiometer.plausible import Limit
from radiometer.reporting.pictures import RULE, label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A line ends where no reading came for as long as the daemon waits before its alarm `reading`.
_GAP_PERIODS: Final = 5.0
_GAP_S: Final = 10.0
_Span = tuple[datetime, datetime, PatchLimits]  # from when to when limits were in force
_MARKERS: Final = {"": "x", "saturated": "^", "below_noise": "v"}  # of readings with such a flag, "" for any other
_LIMIT_ROOM: Final = 10.0  # a limit widens the picture within so many ranges of the readings, as on the page


@dataclass(frozen=True)
class Place:
    """Readings of one place: a patch that has a name, that a client measured, or that is measured for all."""

    name: str  # the place in words
    readings: tuple[Mapping[str, Any], ...]  # its readings, oldest first

    def summary(self) -> str:
        """Return number, time span, mean and standard deviation in one line; bounds are left out of both."""
        known = [one for one in self.readings if one["radiance"]["value"] is not None]
        values = [one["radiance"]["value"] for one in known if not _bound(one)]
        span = f"{self.readings[0]['time'][:19]} to {self.readings[-1]['time'][:19]}"
        head = f"{self.name}: {len(self.readings)} reading{'s' * (len(self.readings) > 1)}, {span}"
        if left_out := Counter(flag for one in known if (flag := _bound(one))):
            named = ", ".join(f"{count} {flag} ({BOUNDS[flag]} their value)" for flag, count in left_out.items())
            head += f"; left out of the mean: {named}"
        if len(values) < 2:
            return head
        mean, spread = statistics.fmean(values), statistics.stdev(values)
        unit = unit_text(self.readings[0]["radiance"]["unit"])
        relative = f" ({100 * spread / abs(mean):.2g} %)" if mean else ""
        return f"{head}: mean {mean:.6g}, standard deviation {spread:.2g} {unit}{relative}"


@dataclass(frozen=True, repr=False)
class LoggedReadings(Result):
    """Readings of a journal, oldest first.

    Examples:
        >>> import radiometer as rm
        >>> logged = rm.log("journal.sqlite")
        >>> logged
        <LoggedReadings 3 readings of 2 places>
        >>> [place.name for place in logged.places]
        ['patch 40,24 16 × 16', 'patch 0,0 8 × 8']
    """

    stored: tuple[str, ...]  # the readings as the journal holds them: a line of JSON each
    damaged: int = 0  # rows of the journal that are no reading, and were left out
    # When which limits were set, oldest first, by the name of the patch
    limits: Mapping[str, Sequence[tuple[datetime, PatchLimits]]] = field(default_factory=dict)

    @cached_property
    def readings(self) -> list[dict[str, Any]]:
        """Return the readings as plain values."""
        return [parsed_json(line) for line in self.stored]

    @cached_property
    def places(self) -> list[Place]:
        """Return the readings of each place; readings of different places share neither mean nor line."""
        found: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
        for one in self.readings:
            patch = one["patch"]
            where = (one.get("name", ""), one.get("session", ""), one["instrument"], *patch.values())
            found.setdefault((*where, one["radiance"]["unit"]), []).append(one)
        return [Place(_place_name(key, found), tuple(readings)) for key, readings in found.items()]

    def to_mapping(self) -> dict[str, Any]:
        """Return the readings as plain values."""
        return {"readings": self.readings}

    def to_json(self) -> str:
        """Return the documented JSON form: one object per line."""
        return "\n".join(self.stored)

    def to_csv(self) -> str:
        """Return the readings as CSV."""
        return to_csv(self.stored)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the readings with a band of their expanded uncertainty, a line for each place, flagged ones marked.

        Each unit has a separate panel, one below the other. A line ends where the readings pause. The limits that
        were in force are dashed. They widen the picture where they are near, or where the newest reading is beyond.

        Args:
            axes: Where to draw, divided where there are several units; a new figure by default.

        Returns:
            Axes of the first panel.

        Raises:
            UsageError: If there is no reading with a value, or axes that are no subplot would have to be divided.
        """
        from matplotlib.dates import ConciseDateFormatter

        panels: dict[str, list[tuple[Place, list[Mapping[str, Any]]]]] = {}
        for place in self.places:
            known = [one for one in place.readings if None not in (one["radiance"]["value"], one["radiance"]["u"])]
            if known:
                panels.setdefault(unit_text(known[0]["radiance"]["unit"]), []).append((place, known))
        if not panels:
            raise UsageError("there is no reading to draw; widen --since and --until")
        colours = {name: f"C{n}" for n, name in enumerate(dict.fromkeys(place.name for place in self.places))}
        first, *others = divided(axes if axes is not None else new_axes(), len(panels))
        for where, (unit, drawn) in zip((first, *others), panels.items(), strict=True):
            for place, known in drawn:
                _draw(where, place.name, known, self._limits_of(place), colours[place.name])
            flags = {_bound(one) for _, known in drawn for one in known if one["flags"]}
            for flag in sorted(flags):
                shown = f"{flag}: {BOUNDS[flag]} this" if flag else "flagged"
                where.plot([], [], _MARKERS[flag], markersize=4, color=RULE, label=shown)
            where.set_ylabel(f"radiance ({unit})\nband: U (95.45 %)")
            where.xaxis.set_major_formatter(ConciseDateFormatter(where.xaxis.get_major_locator()))  # type: ignore[no-untyped-call]
            where.grid(alpha=0.25)
            where.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
        (first, *others)[-1].set_xlabel("time (UTC)")
        return first

    def _limits_of(self, place: Place) -> list[_Span]:
        """Return which limits were in force from when to when, as far as readings of a place were compared with them.

        Those of the patch for all are of the place where it was at that time.
        """
        first, newest = place.readings[0], place.readings[-1]
        history = () if newest.get("session") else self.limits.get(newest.get("name") or MAIN, ())
        unit, since, until = unit_text(first["radiance"]["unit"]), moment_of(first["time"]), moment_of(newest["time"])
        ends = [*(moment for moment, _ in history[1:]), until]
        spans = [(max(at, since), min(end, until), limits) for (at, limits), end in zip(history, ends, strict=False)]
        return [(at, end, limits) for at, end, limits in spans if at <= end and limits.any and limits.unit == unit]

    def write_plot(self, path: PathLike) -> None:
        """Draw the readings into a PNG, PDF or SVG file. Raises UsageError for another ending."""
        axes = self.plot(own_axes())
        write_figure(Path(path), axes, inches=(9.0, 1.4 + 2.8 * len(axes.figure.axes)))

    def __str__(self) -> str:
        """Return how many readings of how many places."""
        return f"{len(self.stored)} readings of {len(self.places)} places"


def _bound(reading: Mapping[str, Any]) -> str:
    """Return the flag that makes a logged value a bound; "" where it is a value."""
    return next((flag for flag in BOUNDS if flag in reading["flags"]), "")


def _place_name(key: tuple[Any, ...], all_places: Mapping[tuple[Any, ...], Sequence[Any]]) -> str:
    name, session, instrument, x, y, width, height, _ = key
    title = name or f"patch {x},{y} {width} × {height}"
    title += f" of session {session}" if session else ""
    return title + (f" of {instrument}" if len({other[2] for other in all_places}) > 1 else "")


def _draw(axes: Axes, name: str, readings: Sequence[Mapping[str, Any]], limits: Sequence[_Span], colour: str) -> None:
    from matplotlib.dates import date2num
    from matplotlib.lines import Line2D

    moments, values, spread = zip(*_with_gaps(readings), strict=True)
    in_force = [shown for _, end, shown in limits if end == moment_of(readings[-1]["time"])]
    title = f"{name} (limits {in_force[-1].bounds})" if in_force else name
    axes.plot(moments, values, "-" if len(values) > 1 else "o", linewidth=1.2, color=colour, label=label(title))
    around = zip([math.nan, *values], [*values[1:], math.nan], strict=False)
    alone: Any = [(t, v) for t, v, near in zip(moments, values, around, strict=True) if all(map(math.isnan, near))]
    if alone and len(values) > 1:
        axes.plot(*zip(*alone, strict=True), "o", markersize=3, color=colour)
    low, high = ([v + sign * s for v, s in zip(values, spread, strict=True)] for sign in (-1, 1))
    axes.fill_between(moments, low, high, alpha=0.22, color=colour, linewidth=0)
    least, most = (
        chosen((v for v in edge if not math.isnan(v)), default=math.nan) for chosen, edge in ((min, low), (max, high))
    )
    room = _LIMIT_ROOM * (most - least)
    for at, end, shown in limits:
        times: Any = [at, end]
        for bound, sign in ((shown.low, 1), (shown.high, -1)):
            if bound is None:
                continue
            dashed: Any = {"color": colour, "linestyle": "--", "linewidth": 1.0}
            is_beyond = shown in in_force and sign * (bound - values[-1]) > 0
            if is_beyond or least - room < bound < most + room:
                axes.plot(times, [bound, bound], **dashed)
            else:  # such an artist widens nothing
                axes.add_artist(Line2D(date2num(times), [bound, bound], **dashed))  # type: ignore[no-untyped-call]
    for flag, marker in _MARKERS.items():
        flagged = [one for one in readings if one["flags"] and _bound(one) == flag]
        when: Any = [moment_of(one["time"]) for one in flagged]
        if flagged:
            axes.plot(when, [one["radiance"]["value"] for one in flagged], marker, markersize=4, color=colour)


def _with_gaps(readings: Sequence[Mapping[str, Any]]) -> list[tuple[Any, float, float]]:
    """Return time, radiance and expanded uncertainty of readings, NaN between two that are far apart and for bounds."""
    times = [moment_of(one["time"]) for one in readings]
    pauses_s = [(later - earlier).total_seconds() for earlier, later in pairwise(times)]
    longest_s = max(_GAP_PERIODS * statistics.median(pauses_s), _GAP_S) if pauses_s else math.inf
    found: list[tuple[Any, float, float]] = []
    for time, one, pause_s in zip(times, readings, [0.0, *pauses_s], strict=True):
        if pause_s > longest_s:
            found.append((time, math.nan, math.nan))
        value, spread = one["radiance"]["value"], one["radiance"]["u"] * one["coverage_factor"]
        found.append((time, math.nan, math.nan) if _bound(one) else (time, value, spread))
    return found


def log(
    journal: PathLike | None = None,
    *,
    since: str | None = None,
    until: str | None = None,
    after: int | None = None,
    flag: str | None = None,
    clean: bool = False,
    limit: Limit | None = None,
) -> LoggedReadings:
    """Return the readings of the daemon's journal that match.

    Examples:
        >>> import radiometer as rm
        >>> rm.log("journal.sqlite", limit=1)
        <LoggedReadings 1 readings of 1 places>

    Args:
        journal: Journal file; the daemon's default one by default.
        since: Not before: ISO 8601, or an age such as "15min", "2h", "7d".
        until: Before this time.
        after: Only readings with a number above this.
        flag: Only readings with this flag.
        clean: Only readings without any flag.
        limit: At most this many, the newest.

    Raises:
        InputError: If there is no journal, or it cannot be read.
        UsageError: If a time cannot be understood.
    """
    since_us, until_us = (parse_moment(moment) if moment else None for moment in (since, until))
    row_filter = ReadingFilter(since_us, until_us, after, flag, clean, limit, newest_first=limit is not None)
    reader = _reader(journal)
    lines = reader.lines(row_filter)
    whole = [line for line in lines if _is_reading(line)]
    if row_filter.newest_first:
        whole.reverse()
    limits: dict[str, list[tuple[datetime, PatchLimits]]] = {}
    for event in reader.events(kind="patch", limit=-1):
        if noted := PatchLimits.from_note(event["message"]):
            limits.setdefault(noted[0], []).append((moment_of(event["time"]), noted[1]))
    return LoggedReadings(tuple(whole), len(lines) - len(whole), limits)


def _is_reading(line: object) -> bool:
    """Return whether a row holds the JSON of a reading."""
    try:
        content = parsed_json(line) if isinstance(line, str) else {}
        return (
            isinstance(content["radiance"], dict)
            and {"value", "unit"} <= content["radiance"].keys()
            and (isinstance(content["patch"], dict) and isinstance(content["time"], str))
        )
    except (ValueError, KeyError, TypeError):
        return False


def log_events(
    journal: PathLike | None = None, *, since: str | None = None, limit: Limit = 200
) -> list[dict[str, str]]:
    """Return alarms and recoveries of a journal, oldest first: time, kind and message of each.

    Examples:
        >>> import radiometer as rm
        >>> rm.log_events("journal.sqlite")
        []

    Args:
        journal: Journal file; the daemon's default one by default.
        since: Not before: ISO 8601, or an age such as "7d".
        limit: At most this many, the newest.

    Raises:
        InputError: If there is no journal, or it cannot be read.
    """
    return _reader(journal).events(parse_moment(since) if since else None, limit)


def log_budget(sequence: int, journal: PathLike | None = None) -> dict[str, float]:
    """Return the relative standard uncertainties of one logged reading by contribution, the largest first.

    Examples:
        >>> import radiometer as rm
        >>> budget = rm.log_budget(1, "journal.sqlite")
        >>> list(budget)[-1], round(budget["combined (k = 1)"], 4)
        ('combined (k = 1)', 0.005)

    Args:
        sequence: Number of the reading.
        journal: Journal file; the daemon's default one by default.

    Raises:
        InputError: If there is no such journal or reading.
    """
    parts = dict(sorted(_reader(journal).budget(sequence).items(), key=lambda entry: -entry[1]))
    return {**parts, "combined (k = 1)": math.sqrt(sum(u * u for u in parts.values()))}


def _reader(journal: PathLike | None) -> JournalReader:
    return JournalReader(Path(journal) if journal else default_journal_path())

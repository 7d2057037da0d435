"""Visits of a subject: a journal each, named by subject, protocol, eye and moment; an unfinished one is taken up."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from radiometer.adaptation.request import RunRequest
from radiometer.data.event_journal import Event, read_events
from radiometer.errors import InputError, UsageError

_STAMP: Final = "%Y-%m-%dT%H%M%SZ"


@dataclass(frozen=True, slots=True)
class Visit:
    """The journal of a visit."""

    journal: Path  # file of its journal
    request: RunRequest  # what is run, with the visit's date; where the run goes on, as its journal states the visit
    resumed: bool = False  # whether the journal holds a part of the run
    remarks: tuple[str, ...] = ()  # what the user must know of other journals of the subject, a line each


def iso_utc(moment: dt.datetime) -> str:
    """Return a moment as ISO 8601 in UTC, to the second."""
    return moment.astimezone(dt.UTC).isoformat(timespec="seconds").replace("+00:00", "Z")


def moment_of(text: str) -> dt.datetime:
    """Return the moment that a text states; without a zone it is local time. Raises UsageError."""
    try:
        return dt.datetime.fromisoformat(text).astimezone(dt.UTC)
    except (ValueError, OverflowError) as error:
        raise UsageError(f"--visit {text}: not a date and time; write it as 2026-03-02T14:30") from error


def visit_at(journal: Path, request: RunRequest, now: dt.datetime) -> Visit:
    """Return the visit that a named journal belongs to.

    Raises:
        UsageError: If it holds a finished run, or one whose time is over.
        InputError: If it is no journal.
    """
    events = list(read_events(journal)) if journal.is_file() and journal.stat().st_size else []
    if not events:  # a crash may have torn its first line: nothing was measured, and it begins anew
        return replace(_new(journal, request, now), resumed=journal.is_file())
    over = _over(events, request, now)
    if over is not None:
        raise UsageError(
            f"{journal} holds {over} of {_begun(events[0])}: `adapt fit {journal}` analyses it; "
            "name another journal for another visit"
        )
    return _taken_up(journal, request, events[0])


def visit_in(folder: Path, request: RunRequest, now: dt.datetime) -> Visit:
    """Return the unfinished visit of the same subject, eye and protocol in a folder; else a new one at this moment.

    Args:
        folder: Where journals are.
        request: What is to be run.
        now: Date and time.
    """
    stem = f"{request.subject}-{request.protocol.name}-{request.eye}-"
    remarks: list[str] = []
    for journal in sorted(folder.glob("*.jsonl"), reverse=True):
        if not journal.name.startswith(stem):
            continue
        try:
            events = list(read_events(journal))
        except InputError as error:
            remarks.append(f"{error}; it is left as it is")
            continue
        if not events or not _same_run(events[0], request):
            continue
        over = _over(events, request, now)
        if over is None:
            return _taken_up(journal, request, events[0])
        if not _ended(events):
            remarks.append(f"{journal} holds {over} of {_begun(events[0])}: a new visit begins")
    return _new(folder / f"{stem}{now.astimezone(dt.UTC).strftime(_STAMP)}.jsonl", request, now, tuple(remarks))


def _new(journal: Path, request: RunRequest, now: dt.datetime, remarks: tuple[str, ...] = ()) -> Visit:
    return Visit(journal, replace(request, visit=iso_utc(now)), remarks=remarks)


def _taken_up(journal: Path, request: RunRequest, start: Event) -> Visit:
    """Return a visit that goes on: date, age and pupil are those that its journal states."""
    same = replace(request, visit=start.get("visit"), age_years=start.get("age_years"), pupil_mm=start.get("pupil_mm"))
    return Visit(journal, same, resumed=True)


def _same_run(start: Event, request: RunRequest) -> bool:
    """Return whether a journal's first event is of the request's subject, protocol, eye, seed and devices."""
    mine = {
        "subject": request.subject, "protocol": request.protocol.name, "eye": request.eye, "seed": request.seed,
        "simulated": request.simulated,
    }  # fmt: skip
    return all(start.get(name) == value for name, value in mine.items())


def _over(events: list[Event], request: RunRequest, now: dt.datetime) -> str | None:
    """Return what a journal holds that is not to be taken up again, in words; None where its run goes on."""
    if _ended(events):
        return "a finished run"
    unix_s, protocol = events[0].get("unix_s"), request.protocol
    if unix_s is None:  # simulated time stood still meanwhile
        return None
    longest_s = protocol.bleach.duration_s + 60.0 * (protocol.end.duration_min + protocol.watch.longest_pause_min)
    return "an unfinished run whose time is over" if now.timestamp() - float(unix_s) > longest_s else None


def _ended(events: list[Event]) -> bool:
    return any(event["kind"] == "end" for event in events)


def _begun(start: Event) -> str:
    """Return when a journal's run began; journals from before visits were dated state the Unix time at most."""
    unix_s = start.get("unix_s")
    known = start.get("visit") or (unix_s and iso_utc(dt.datetime.fromtimestamp(float(unix_s), dt.UTC)))
    return str(known or "an unknown date")

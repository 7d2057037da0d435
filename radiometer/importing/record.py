"""Record of an import: what it took from where, what is missing and what it doubts; kept in the capture set itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from radiometer.data import CaptureHeader, CaptureSet
from radiometer.importing.found import FoundFrame

_NAMED_FILES = 3  # names that a line shows


@dataclass(frozen=True, slots=True)
class ImportRecord:
    """The record of an import."""

    taken: tuple[str, ...] = ()  # where each fact came from, such as "exposure_s from EXPTIME (32 frames)"
    missing: tuple[str, ...] = ()  # what no file states and analyses would use
    doubts: tuple[str, ...] = ()  # what contradicts itself, with the files
    left_out: tuple[str, ...] = ()  # files that could not be used, each with its reason
    not_used: tuple[str, ...] = ()  # units, directories, pages and columns of the files that nothing was read from
    mapped: tuple[str, ...] = ()  # where the user stated that facts stand, in the words of `--map`

    def to_mapping(self) -> dict[str, list[str]]:
        """Return the mapping that stands under `imported` in the capture set."""
        return {
            "taken": list(self.taken),
            "missing": list(self.missing),
            "doubts": list(self.doubts),
            "left_out": list(self.left_out),
            "not_used": list(self.not_used),
            "mapped": list(self.mapped),
        }

    def lines(self) -> list[str]:
        """Return all but what was taken as lines for a user."""
        return [
            *(f"left out: {line}" for line in self.left_out),
            *(f"doubt: {line}" for line in self.doubts),
            *(f"missing: {line}" for line in self.missing),
            *(f"not used: {line}" for line in self.not_used),
        ]


def imported_of(capture: CaptureSet) -> ImportRecord:
    """Return the record of the import that a capture set comes from; an empty one where it comes from none."""
    return record_in(capture.header)


def record_in(header: CaptureHeader) -> ImportRecord:
    """Return the record of an import that a header holds; an empty one where it holds none."""
    found: Any = (header.model_extra or {}).get("imported")
    if not isinstance(found, Mapping):
        return ImportRecord()
    lists = {key: tuple(str(line) for line in found.get(key, ())) for key in ImportRecord().to_mapping()}
    return ImportRecord(**lists)


def taken_from(frames: Sequence[FoundFrame]) -> tuple[str, ...]:
    """Return where each fact of the frames came from, one line per fact and place."""
    counts: dict[tuple[str, str], int] = {}
    for frame in frames:
        for fact, place in frame.taken.items():
            counts[fact, place] = counts.get((fact, place), 0) + 1
    return tuple(f"{fact} from {place} ({count} frames)" for (fact, place), count in sorted(counts.items()))


def doubts_about(frames: Iterable[FoundFrame]) -> tuple[str, ...]:
    """Return the frames' doubts, those of one wording together, with the files that they are about."""
    return by_wording((frame.label, frame.doubts) for frame in frames)


def not_used_of(frames: Iterable[FoundFrame]) -> tuple[str, ...]:
    """Return what of the frames' files is not used, with the files."""
    return by_wording((frame.file.name, frame.not_used) for frame in frames)


def by_wording(lines: Iterable[tuple[str, Sequence[str]]]) -> tuple[str, ...]:
    """Return lines about files, those of one wording together with the names of all that they are about."""
    files: dict[str, list[str]] = {}
    for label, several in lines:
        for line in several:
            files.setdefault(line, []).append(label)
    return tuple(f"{named(labels)}: {line}" for line, labels in files.items())


def named(labels: Sequence[str]) -> str:
    """Return a list of files in words, the first three by name."""
    unique = list(dict.fromkeys(labels))
    shown = ", ".join(unique[:_NAMED_FILES])
    more = len(unique) - _NAMED_FILES
    return f"{shown} and {more} more" if more > 0 else shown

"""Where a result comes from."""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

import radiometer
from radiometer.errors import InputError
from radiometer.moments import moment_of

FUTURE_DAYS: Final = 1.0  # time zones that were mistaken, and clocks that drift, make less


def utc_now() -> str:
    """Return the present time as ISO 8601 in UTC with microseconds."""
    return dt.datetime.now(dt.UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def is_out_of_date(created: str, validity_days: float, now: dt.datetime) -> bool:
    """Return whether what was made then is older at `now` than it is valid for, or from the future.

    A file from the future was made, or is read, by a clock that is wrong: nothing shows how old it is.

    Args:
        created: ISO 8601 time with its zone.
        validity_days: How long it is valid in days.
        now: The present, with its zone.
    """
    age_days = (now - moment_of(created)).total_seconds() / 86400.0
    return not -FUTURE_DAYS <= age_days <= validity_days


@cache
def source_hash(*packages: str) -> str:
    """Return a hash over the source of packages: equal means that they do the same.

    Args:
        packages: Folders below `radiometer`, such as "analysis/response".

    Raises:
        ValueError: If a folder holds no source: its hash would stay the same whatever changes.
    """
    root = Path(radiometer.__file__).resolve().parent
    digest = hashlib.sha256()
    for package in packages:
        sources = sorted((root / package).rglob("*.py"))
        if not sources:
            raise ValueError(f"there is no source in {root / package}")
        for source in sources:
            digest.update(source.relative_to(root).as_posix().encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class Provenance:
    """What made a result, from what, and under which assumptions."""

    method: str  # name of the method, with author and year where the field names it so
    inputs: tuple[str, ...] = ()  # names or content hashes of what went in
    assumptions: tuple[str, ...] = ()  # what was assumed rather than measured; shown to the user
    parameters: Mapping[str, Any] = field(default_factory=dict)  # settings of the method
    created: str = field(default_factory=utc_now)  # ISO 8601 time in UTC
    software: str = f"radiometer {radiometer.__version__}"  # program and version

    def to_mapping(self) -> dict[str, Any]:
        """Return the plain mapping that is written to files."""
        return {
            "method": self.method,
            "inputs": list(self.inputs),
            "assumptions": list(self.assumptions),
            "parameters": dict(self.parameters),
            "created": self.created,
            "software": self.software,
        }

    @classmethod
    def from_mapping(cls, mapping: object, where: str) -> Provenance:
        """Return the provenance that a file's mapping describes; unknown keys are ignored, empty ones hold nothing.

        Raises:
            InputError: If it is no mapping, or a list or mapping in it is something else.
        """
        stated = _mapping(mapping, f"{where}: provenance")
        return cls(
            method=str(stated.get("method") or "unknown"),
            inputs=_texts(stated.get("inputs"), f"{where}: provenance.inputs"),
            assumptions=_texts(stated.get("assumptions"), f"{where}: provenance.assumptions"),
            parameters=_mapping(stated.get("parameters"), f"{where}: provenance.parameters"),
            created=str(stated.get("created") or ""),
            software=str(stated.get("software") or ""),
        )


def _mapping(value: object, where: str) -> dict[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise InputError(f"{where} is {str(value)[:40]!r}, not a mapping")
    return dict(value)


def _texts(value: object, where: str) -> tuple[str, ...]:
    if value is None:
        return ()
    if not isinstance(value, list | tuple):
        raise InputError(f"{where} is {str(value)[:40]!r}, not a list")
    return tuple(str(entry) for entry in value)

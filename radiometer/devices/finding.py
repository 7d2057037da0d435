"""Finding of a check of a device, and the way out."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum


class Health(StrEnum):
    """How bad a finding is."""

    OK = "ok"
    NOTE = "note"
    WARNING = "warning"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of a health report."""

    check: str  # what was looked at
    health: Health  # how bad it is; only a fault keeps one from measuring
    message: str  # what was found, with figures and units
    cure: str = ""  # what to do about it; empty where nothing is to be done

    def to_mapping(self) -> dict[str, str]:
        """Return the mapping of the JSON form."""
        return {key: str(value) for key, value in asdict(self).items()}

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
    """One line of a health report.

    Attributes:
        check: What was looked at.
        health: How bad it is; only a fault keeps one from measuring.
        message: What was found, with figures and units.
        cure: What to do about it; empty where nothing is to be done.
    """

    check: str
    health: Health
    message: str
    cure: str = ""

    def to_mapping(self) -> dict[str, str]:
        """Return the mapping of the JSON form."""
        return {key: str(value) for key, value in asdict(self).items()}

"""Settings of the processing of every capture set of an archive, and the fingerprint of its code."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from pathlib import Path

from radiometer.data.json_text import json_text
from radiometer.data.provenance import source_hash


@dataclass(frozen=True, slots=True)
class JobSettings:
    """One job with everything that its result depends on in addition to the capture set."""

    job: str  # name in the registry of `jobs.py`
    calibration: str | None = None  # calibration file; None for relative values
    # Region X,Y,W,H; None for the patches that each capture set names, else the whole frame
    patch: tuple[int, int, int, int] | None = None
    maps: str | None = None  # folder that radiance maps are written to; None for none

    def fingerprint(self) -> str:
        """Return a hash of the settings, the calibration's content and the code: equal means the same result."""
        digest = hashlib.sha256(json_text(asdict(self), sort_keys=True, ascii_only=True).encode())
        if self.calibration:
            digest.update(Path(self.calibration).read_bytes())
        digest.update(code_hash().encode())
        return digest.hexdigest()[:16]


def code_hash() -> str:
    """Return a hash over the source of the packages that results depend on."""
    return source_hash("data", "analysis", "importing", "photographs", "reconciliation", "statistics", "archive")

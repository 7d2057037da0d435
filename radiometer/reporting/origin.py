"""The head that every report has: when, with what and by which protocol its data were made, and by which program."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import radiometer
from radiometer.data.capture_set import CaptureHeader

UNKNOWN: Final = "not stated"
_UNIX_FROM_S: Final = 1e9  # smaller time stamps count from the camera's start, and are no date


@dataclass(frozen=True, slots=True)
class Origin:
    """What the data of a report come from.

    A text is None where the kind of report has no such thing. It is "" where the data could state it and do not; the
    report then shows that it is not stated.

    Attributes:
        date: When the data were taken, UTC.
        camera: Maker, model and serial number.
        lens: Focal length and f-number.
        calibration: File or reference of the calibration with its date.
        box: Light box or screen that made the light.
        protocol: What was done.
        further: Other facts as names and values, in the order to show them; empty values are left out.
    """

    date: str | None = None
    camera: str | None = None
    lens: str | None = None
    calibration: str | None = None
    box: str | None = None
    protocol: str | None = None
    further: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of_captures(
        cls, headers: Sequence[CaptureHeader], *, calibration: str | None = None,
        further: tuple[tuple[str, str], ...] = (),
    ) -> Origin:  # fmt: skip
        """Return what the headers of capture sets of one camera state of date, camera, lens and conditions.

        Args:
            headers: One or more.
            calibration: As for the class.
            further: Facts to show before those of the captures.
        """
        frames = [one for header in headers for one in header.frames]
        degrees = [one.temperature_C for one in frames if one.temperature_C is not None]
        ends = [f"{one:.1f}" for one in (min(degrees), max(degrees))] if degrees else []
        created = sorted(moment(header.created) for header in headers if header.created)
        first = headers[0]
        return cls(
            span_of(one.timestamp_s for one in frames) or " to ".join(dict.fromkeys(created[:1] + created[-1:])),
            first.camera.name,
            first.lens.in_words(one.f_number for one in frames),
            calibration,
            further=(
                *further,
                ("sensor temperature", f"{' to '.join(dict.fromkeys(ends))} °C" if degrees else ""),
                ("frames", str(len(frames)) if frames else ""),
            ),
        )

    @classmethod
    def of_map(cls, known: Mapping[str, Any], further: tuple[tuple[str, str], ...]) -> Origin:
        """Return what the provenance of a merged map states of its frames, with further facts."""
        taken, camera, lens, calibration = (
            str(known.get(name, "")) for name in ("taken", "camera", "lens", "calibration")
        )
        return cls(taken, camera, lens, calibration, further=further)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Return all facts as names and values; the program's version is last."""
        known = {
            "taken (UTC)": self.date, "camera": self.camera, "lens": self.lens, "calibration": self.calibration,
            "light": self.box, "protocol": self.protocol,
        }  # fmt: skip
        rows = [(name, value or UNKNOWN) for name, value in known.items() if value is not None]
        rows += [(name, value) for name, value in self.further if value]
        return [*rows, ("program", f"radiometer {radiometer.__version__}")]


def span_of(times_s: Iterable[float | None]) -> str:
    """Return the first and the last of moments in Unix time, UTC; "" where none is a date."""
    known = [one for one in times_s if one is not None and one > _UNIX_FROM_S]
    if not known:
        return ""
    first, last = (moment(dt.datetime.fromtimestamp(one, dt.UTC).isoformat()) for one in (min(known), max(known)))
    return first if first == last else f"{first} to {last}"


def moment(iso_time: str) -> str:
    """Return an ISO 8601 time as a report shows it: to the second, with a space before the hour."""
    return iso_time[:19].replace("T", " ")

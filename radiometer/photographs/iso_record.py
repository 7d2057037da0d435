"""Stated and measured ISO speeds of photographs, for reports and provenance."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from radiometer.analysis.response.estimate import ResponseEstimate
    from radiometer.data import Bracket, Frame, Provenance, RadianceMap, Reading, Scale
    from radiometer.data.iso_speeds import IsoSpeeds


def iso_record(frames: Iterable[Frame]) -> list[dict[str, float]]:
    """Return every ISO speed in use as {"stated": …} and, where it was measured, "measured": …; empty without any."""
    found: dict[float, dict[str, float]] = {}
    for frame in frames:
        if "iso_stated" in frame.extra:
            entry = found.setdefault(float(frame.extra["iso_stated"]), {"stated": float(frame.extra["iso_stated"])})
            if "iso_measured" in frame.extra:
                entry["measured"] = float(frame.extra["iso_measured"])
    return [found[stated] for stated in sorted(found)]


def iso_text(record: Sequence[dict[str, float]]) -> str:
    """Return the record in words, such as "ISO 200 is really 136"; empty where nothing was measured."""
    measured = [entry for entry in record if "measured" in entry]
    return ", ".join(f"ISO {entry['stated']:g} is really {entry['measured']:g}" for entry in measured)


def reference_iso(frames: Iterable[Frame], speeds: IsoSpeeds) -> tuple[float | None, float | None]:
    """Return the ISO speed, real and as stated, at which the gain of photographs is 0 dB; None where there is none."""
    if speeds.reference is not None:
        return speeds.reference, speeds.reference_stated
    stated = {float(frame.extra["iso_stated"]) for frame in frames if "iso_stated" in frame.extra}
    lowest = min(stated, key=speeds.real, default=None)
    return (None, None) if lowest is None else (speeds.real(lowest), lowest)


def at_iso(scale: Scale, iso: float | None, stated: float | None) -> Scale:
    """Return the scale with the ISO speed that it holds for, real and as stated."""
    text = f"{scale.reference} (ISO stated as {stated:g})" if stated not in (None, iso) else scale.reference
    return scale.model_copy(update={"iso": iso, "iso_stated": stated, "reference": text})


def with_iso_speeds(estimate: ResponseEstimate, *several: Sequence[Bracket]) -> ResponseEstimate:
    """Return the estimate with the ISO speeds of its photographs in its curve's provenance and in its details."""
    record = iso_record(frame for brackets in several for bracket in brackets for frame in bracket.light)
    curve = replace(estimate.curve, provenance=_with_record(estimate.curve.provenance, record))
    return replace(estimate, curve=curve, details={**estimate.details, "iso": record} if record else estimate.details)


def with_iso_in_map(found: RadianceMap, frames: Iterable[Frame]) -> RadianceMap:
    """Return the radiance map with the ISO speeds of its photographs in its provenance."""
    return replace(found, provenance=_with_record(found.provenance, iso_record(frames)))


def with_iso_in_reading(reading: Reading, frames: Iterable[Frame]) -> Reading:
    """Return the reading with the ISO speeds of its photographs in its provenance."""
    old = reading.provenance
    return reading if old is None else replace(reading, provenance=_with_record(old, iso_record(frames)))


def _with_record(old: Provenance, record: list[dict[str, float]]) -> Provenance:
    if not record:
        return old
    text = iso_text(record)
    parameters: dict[str, Any] = {**old.parameters, "iso": record}
    return replace(old, parameters=parameters, assumptions=(*old.assumptions, *([text] if text else [])))

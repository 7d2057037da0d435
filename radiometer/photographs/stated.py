"""Exposure settings of photographs as stated: exposures, f-numbers, ISO speeds stated and measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from radiometer.data import (
    Bracket,
    Calibration,
    CameraDescription,
    Frame,
    LensDescription,
    Provenance,
    RadianceMap,
    Reading,
    Scale,
)
from radiometer.data.iso_speeds import IsoSpeeds
from radiometer.errors import UsageError
from radiometer.units import exact_f_number

if TYPE_CHECKING:
    from radiometer.analysis.response.estimate import ResponseEstimate

# Printed f-numbers are this near to the exact stop behind them.
_SAME_STOP_REL: Final = 0.03
# Key in a frame's `extra`: gain in dB that an exposure list states with the ISO speed.
LIST_GAIN: Final = "list_gain_db"
# Before the keys in a frame's `extra` of what a photograph states of its camera; and which of them do not touch the
# numbers of camera raw files.
OF_CAMERA: Final = "camera_"
OF_DEVELOPMENT: Final = ("mode", "white_balance")
OF_FOCUS: Final = "focus_m"  # the distance that the lens is focused at; autofocus may change it within a bracket
_LEAST_BY_FOCUS: Final = 0.005  # of the light on the sensor: less is not reported


def stated_camera(bracket: Bracket) -> tuple[CameraDescription, LensDescription]:
    """Return camera and lens as photographs state them."""
    extra = bracket.light[0].extra
    stated: dict[str, Any] = {k.removeprefix(OF_CAMERA): v for k, v in extra.items() if k.startswith(OF_CAMERA)}
    lens = LensDescription(focal_length_mm=stated.pop("focal_length_mm", None))
    stated.pop(OF_FOCUS, None)
    return CameraDescription(bit_depth=bracket.bit_depth, **stated), lens


def focus_doubt(bracket: Bracket) -> str | None:
    """Return what to say of photographs that state several focus distances; None where that moves no light.

    A lens that is focused nearer is farther from the sensor, which gets (d/(d − f))² times less light.
    """
    focal_m = float(bracket.light[0].extra.get(f"{OF_CAMERA}focal_length_mm", 0.0)) / 1e3
    stated = {float(one.extra[key]) for one in bracket.light if (key := OF_CAMERA + OF_FOCUS) in one.extra}
    near, far = min(stated, default=0.0), max(stated, default=0.0)
    if near == far:
        return None
    less = (near * (far - focal_m) / (far * (near - focal_m))) ** 2 - 1.0 if near > focal_m else math.inf
    if focal_m and less < _LEAST_BY_FOCUS:
        return None
    how_much = f" by {100 * less:.2g} %" if focal_m and math.isfinite(less) else ""
    return (
        f"the photographs state focus distances from {near:g} to {far:g} m: the light on the sensor may differ"
        f"{how_much}, which no uncertainty holds; focus by hand"
    )


def with_f_number(bracket: Bracket, f_number: float | None) -> Bracket:
    """Return the bracket with an f-number stated by hand for the frames that do not state theirs.

    Args:
        f_number: As printed on the lens; None changes nothing.

    Raises:
        UsageError: If it is not above 0, or frames state another one.
    """
    if f_number is None:
        return bracket
    if not (math.isfinite(f_number) and f_number > 0):
        raise UsageError(f"--f-number {f_number:g}: must be above 0")
    other = {n for f in bracket.light if (n := f.settings.f_number) and abs(n / f_number - 1.0) > _SAME_STOP_REL}
    if other:
        raise UsageError(f"--f-number {f_number:g}: the frames state f/{min(other):.4g} themselves; leave it out")
    exact = exact_f_number(f_number)
    number = exact if abs(exact / f_number - 1.0) < _SAME_STOP_REL else f_number
    frames = (
        frame if frame.settings.f_number else replace(frame, settings=replace(frame.settings, f_number=number))
        for frame in bracket.every_frame
    )
    return Bracket.from_frames(frames, origin=bracket.origin)


def iso_speeds(measured: Mapping[float, float] | None, calibration: Calibration | None) -> IsoSpeeds:
    """Return the ISO speeds that were measured, and the one at which a calibration's scale holds.

    Args:
        measured: Real speed by stated one.
        calibration: None for relative values: then the lowest speed in use is 0 dB.
    """
    if calibration is None:
        return IsoSpeeds(measured or {})
    return IsoSpeeds(measured or {}, calibration.scale.iso, calibration.scale.iso_stated)


def with_iso(bracket: Bracket, iso: float | None) -> Bracket:
    """Return photographs with an ISO speed stated by hand for those that do not state theirs.

    Args:
        bracket: The photographs.
        iso: As the camera's dial has it; None changes nothing.

    Raises:
        UsageError: If it is not above 0, or photographs state another one.
    """
    if iso is None:
        return bracket
    if not (math.isfinite(iso) and iso > 0):
        raise UsageError(f"--iso {iso:g}: must be above 0")
    if other := {one.settings.iso for one in bracket.light if one.settings.iso and one.settings.iso != iso}:
        raise UsageError(f"--iso {iso:g}: the photographs state ISO {min(other):g} themselves; leave it out")
    frames = (replace(one, settings=replace(one.settings, iso=iso)) for one in bracket.every_frame)
    return Bracket.from_frames(frames, origin=bracket.origin)


def with_gains(bracket: Bracket, speeds: IsoSpeeds) -> Bracket:
    """Return photographs with the gains of their ISO speeds.

    Args:
        bracket: The photographs; those without a speed stay as they are.
        speeds: What is known of the speeds; with a calibration's, its own speed is 0 dB.

    Raises:
        UsageError: If a speed was measured that no photograph states.
    """
    stated = [frame.settings.iso for frame in bracket.every_frame if frame.settings.iso]
    speeds.refuse_unstated(bracket.origin, set(stated))
    if not stated:
        return bracket
    return Bracket.from_frames(
        (with_gain(frame, speeds, stated) for frame in bracket.every_frame), origin=bracket.origin
    )


def with_gain(frame: Frame, speeds: IsoSpeeds, in_use: list[float]) -> Frame:
    """Return a photograph with the gain of its ISO speed; itself where it states none.

    Args:
        frame: The photograph.
        speeds: What is known of the speeds.
        in_use: Speeds that all photographs of the set state.
    """
    iso = frame.settings.iso
    if not iso:
        return frame
    gain_db = speeds.gain_db(iso, in_use) + float(frame.extra.get(LIST_GAIN, 0.0))
    extra = {key: value for key, value in frame.extra.items() if key != "iso_measured"} | {"iso_stated": iso}
    if iso in speeds.measured:
        extra["iso_measured"] = speeds.measured[iso]
    return replace(frame, settings=replace(frame.settings, gain_db=gain_db), extra=extra)


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

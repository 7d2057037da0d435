"""Photographs with what a user or a calibration states of them: f-number, ISO speed, real ISO speeds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from radiometer.data import Bracket, Calibration, Frame
from radiometer.data.iso_speeds import IsoSpeeds
from radiometer.errors import UsageError
from radiometer.units import exact_f_number

# Printed f-numbers are this near to the exact stop behind them.
_SAME_STOP_REL: Final = 0.03
# Key in a frame's `extra`: gain in dB that an exposure list states with the ISO speed.
LIST_GAIN: Final = "list_gain_db"


def with_f_number(bracket: Bracket, f_number: float | None) -> Bracket:
    """Return the bracket with an f-number stated by hand for the frames that do not state theirs.

    Args:
        bracket: The frames.
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

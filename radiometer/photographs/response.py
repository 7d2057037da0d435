"""The response behind a folder of photographs: as given, as kept next to an earlier map, or recovered now."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiometer.errors import InputError, MeasurementError, OutputRefused

if TYPE_CHECKING:
    from radiometer.analysis.response.displacement import Displacement
    from radiometer.analysis.response.shutter_offset import ShutterOffset
    from radiometer.data import Bracket, Calibration, RadianceMap, ResponseCurve

# Enough for a response; larger photographs are read on a lattice for it.
ENOUGH_PIXELS = 1_000_000
_KEY = "photographs_sha256"
_VERSION_KEY = "recovery_version"
# What a recovered response depends on in addition to the photographs.
_RECOVERY = "analysis/response"
_BEYOND_THE_CONVERTER = 1.1
# A power of growth with exposure that differs from 1 by more is no linear camera's: seven sets of JPEG and film have
# 0.41 to 0.69, the linear Flea3 0.96 to 1.00.
_NOT_LINEAR = 0.1
_BITS_OF_PICTURES = 8  # files of more bits often hold numbers that no curve has changed
_JPEG_SUFFIXES = frozenset({".jpg", ".jpeg"})
_UNDISPLACED = "frames are assumed to be aligned: too few pixels are usable in two of them to measure a displacement"


def recovered_curves(
    brackets: Sequence[Bracket], map_path: Path | None, say: Callable[[str], None]
) -> tuple[dict[str, ResponseCurve], list[Path]]:
    """Return the response of every bracket by channel, kept next to a map, and the files it is kept in.

    A file is taken up again where this version of the recovery made it, from the same photographs: the same values,
    exposure times and colours. A response that an earlier version made is recovered anew, with a note.

    Args:
        brackets: One per channel.
        map_path: The map; a curve's file is named after it and its channel. None keeps no files.
        say: Takes what a user should know.

    Raises:
        MeasurementError: If the photographs hold no response.
        OutputError: If a file cannot be written.
    """
    from radiometer.data import ResponseCurve

    thin = {str(bracket.light[0].extra.get("channel", "mono")): bracket.thinned(ENOUGH_PIXELS) for bracket in brackets}
    key = _fingerprint(thin)
    if map_path is None:
        return _recovered(thin, key, say), []
    files = {channel: map_path.with_name(f"{map_path.stem}-response-{channel}.yaml") for channel in thin}
    kept = {channel: _kept(file, key) for channel, file in files.items()}
    curves = {channel: curve for channel, curve in kept.items() if curve is not None and _is_of_this_version(curve)}
    if len(curves) < len(files):
        if any(curve is not None and not _is_of_this_version(curve) for curve in kept.values()):
            kept_in = ", ".join(file.name for file in files.values())
            say(f"{kept_in}: from another version of the recovery of responses; recovered anew")
        for channel, curve in _recovered(thin, key, say).items():
            curve.write(files[channel])
            curves[channel] = ResponseCurve.read(files[channel])
    return curves, list(files.values())


def in_their_own_depth(brackets: Sequence[Bracket]) -> list[Bracket]:
    """Return linear photographs with the bits that their numbers have, such as 12 in files of 16; others as they are.

    Alignment and the noise of pixels are judged by shares of full scale.

    Args:
        brackets: Of the same photographs, one per channel.
    """
    from radiometer.analysis.response.limits import white_level_dn

    ends = [white_level_dn(bracket) for bracket in brackets]
    depth = min(ends).bit_length()
    highest = max(int(frame.dn.max()) for bracket in brackets for frame in bracket.light)
    if min(ends) != (1 << depth) - 1 or highest > min(ends) or not 8 < depth < brackets[0].bit_depth:
        return list(brackets)
    return [
        type(one).from_frames([replace(f, bit_depth=depth) for f in one.every_frame], origin=one.origin)
        for one in brackets
    ]


def linear_doubt(bracket: Bracket) -> str | None:
    """Return the evidence against photographs that are declared linear; None where there is none.

    Args:
        bracket: The photographs.
    """
    from radiometer.analysis.response.limits import growth_power

    power = growth_power(bracket, bracket.light[0].settings.black_level_dn or 0.0)
    if power is not None and abs(power - 1.0) > _NOT_LINEAR:
        return (
            f"--linear was given, but twice the exposure makes numbers {2.0**power:.2f} times as large. Causes "
            "are a response "
            "curve, an unstated black level or wrong times; without --linear a curve is recovered"
        )
    if power is None and all(
        Path(str(f.extra.get("file", ""))).suffix.lower() in _JPEG_SUFFIXES for f in bracket.light
    ):
        return "--linear was given, but cameras write JPEG through a curve, and no two of these show the same pixels"
    return None


def _if_linear(bracket: Bracket) -> str:
    """Return the way out for photographs whose numbers may be proportional to light; "" where nothing says so.

    Args:
        bracket: Photographs that show no response.
    """
    from radiometer.analysis.response.limits import growth_power

    way = "add --linear, or read them by radiometer import"
    power = growth_power(bracket, bracket.light[0].settings.black_level_dn or 0.0)
    if power is not None and abs(power - 1.0) <= _NOT_LINEAR:
        return f". Twice the exposure makes numbers {2.0**power:.2f} times as large, as linear files do: {way}"
    if bracket.light[0].bit_depth > _BITS_OF_PICTURES:
        return f". Where these {bracket.light[0].bit_depth}-bit files hold the sensor's own numbers: {way}"
    return ""


def _recovered(brackets: Mapping[str, Bracket], key: str, say: Callable[[str], None]) -> dict[str, ResponseCurve]:
    """Return the response of every colour, their labels judged by all of them, with the photographs' fingerprint."""
    from radiometer.analysis.response.auto import recover_colours_auto
    from radiometer.analysis.response.estimate import telling
    from radiometer.analysis.response.labels import reject_inconsistent_exposures
    from radiometer.data.provenance import source_hash
    from radiometer.photographs.stated import stated_camera

    for bracket in brackets.values():
        reject_inconsistent_exposures(bracket)
    curves, of_colours = {}, dict[str, list[str]]()
    try:
        found = recover_colours_auto(list(brackets.values()))
        for (channel, bracket), estimate in zip(brackets.items(), found, strict=True):
            telling(estimate, f"{bracket.origin}, {channel}" if len(brackets) > 1 else bracket.origin)
    except MeasurementError as error:
        raise MeasurementError(f"{error}{_if_linear(next(iter(brackets.values())))}") from error
    for channel, estimate in zip(brackets, found, strict=True):
        for text in estimate.notes:
            of_colours.setdefault(text, []).append(channel)
    for text, channels in of_colours.items():
        say(f"{', '.join(channels)}: {text}")
    for channel, estimate in zip(brackets, found, strict=True):
        parameters = {**estimate.curve.provenance.parameters, _KEY: key, _VERSION_KEY: source_hash(_RECOVERY)}
        provenance = replace(estimate.curve.provenance, parameters=parameters)
        curves[channel] = replace(estimate.curve, provenance=provenance, camera=stated_camera(brackets[channel])[0])
    return curves


def with_found_times(bracket: Bracket, curve: ResponseCurve) -> Bracket:
    """Return the bracket with the exposure times that its response was recovered with, where these were not the labels.

    Args:
        bracket: Frames in the order of their stated exposure.
        curve: Recovered from the same photographs.
    """
    errors = curve.provenance.parameters.get("log_time_errors")
    if not errors or len(errors) != len(bracket.light) or not any(errors):
        return bracket
    frames = [
        replace(f, settings=replace(f.settings, exposure_s=f.settings.exposure_s * math.exp(float(error))))
        for f, error in zip(bracket.light, errors, strict=True)
    ]
    return bracket.with_light(frames)


def shutter_offset_of(curve: ResponseCurve | None) -> ShutterOffset | None:
    """Return the shutter's offset that a response was recovered with; None where its file states none."""
    from radiometer.analysis.response.shutter_offset import ShutterOffset

    parameters = curve.provenance.parameters if curve is not None else {}
    try:
        seconds, u_seconds = (float(parameters[name]) for name in ("shutter_offset_s", "u_shutter_offset_s"))
    except (KeyError, TypeError, ValueError):
        return None
    return ShutterOffset(seconds, u_seconds, 1.0) if math.isfinite(seconds) and math.isfinite(u_seconds) else None


def offset_in_words(curve: ResponseCurve) -> str | None:
    """Return what a map states of the shutter's offset that its photographs show; None where they show none."""
    offset = shutter_offset_of(curve)
    return f"all exposures {offset.in_words()} than their labels, the shutter's offset" if offset else None


def with_offset_of_response(
    bracket: Bracket, curve: ResponseCurve | None, listed: str | None
) -> tuple[Bracket, str | None, bool]:
    """Return photographs with the exposures that the shutter's offset of a given response makes of their labels.

    The offset belongs to the camera's shutter, as the curve does to the camera. It is not applied where a list gives
    the exposures, which may include it, or where it is not small compared with them.

    Args:
        bracket: Photographs as labelled.
        curve: As given; None where they are linear.
        listed: Name of the list that gives their exposures; None where EXIF does.

    Returns:
        The photographs, what to say (None where the response states no offset), and whether it was taken.
    """
    from radiometer.analysis.response.shutter_offset import is_possible

    offset = shutter_offset_of(curve)
    if offset is None:
        return bracket, None, False
    shortest_s = min(frame.settings.exposure_s for frame in bracket.light)
    not_taken = f"the shutter's offset of the response (exposures {offset.in_words()} than their labels) is not used"
    if listed is not None:
        return bracket, f"{not_taken}: {listed} gives the exposures", False
    if not is_possible(offset.seconds, shortest_s):
        return bracket, f"{not_taken}: it is too large for an exposure of {shortest_s:.3g} s", False
    timed = [
        replace(f, settings=replace(f.settings, exposure_s=f.settings.exposure_s + offset.seconds))
        for f in bracket.light
    ]
    text = (
        f"all exposures {offset.in_words()} than their labels, the shutter's offset that the response was "
        "recovered with"
    )
    return bracket.with_light(timed), text, True


def relative_calibration(
    bracket: Bracket, curve: ResponseCurve | None, camera: Any, lens: Any
) -> tuple[Calibration, Displacement | None]:
    """Return a calibration without a scale and how far the frames are displaced, both as the frames show it.

    The calibration is the curve (linear without one) and the noise; where displacement shows, without what that adds.

    Args:
        curve: Their response; None where they are linear.
        camera: Description of the camera.
        lens: Description of the lens.
    """
    from radiometer.analysis.response.pixel_noise import sensor_noise
    from radiometer.data import BlackLevel, Calibration, Scale, SensorNoise

    black_dn = _black_dn(bracket, curve)
    displacement = displacement_of(bracket, curve)
    if displacement is None:
        noise = SensorNoise.of(camera)  # too little overlap: typical figures, reported as assumed
    else:
        line = curve or _straight_line(bracket, black_dn)
        noise = sensor_noise(displacement.noise, line, black_dn)
        if curve is None:
            noise = replace(noise, full_well_e=_BEYOND_THE_CONVERTER * noise.full_well_e)
    known = Calibration(
        camera=camera,
        lens=lens,
        scale=Scale(value=1.0, u_rel=0.0, method="relative"),
        response=curve,
        noise=noise,
        black_level=BlackLevel(dn=black_dn),
    )
    return known, displacement


def _black_dn(bracket: Bracket, curve: ResponseCurve | None) -> float:
    """Return the black level as the photographs state it, else as their response has it: a film's fog is black."""
    from radiometer.analysis.response.curves import black_of_curve

    stated = bracket.light[0].settings.black_level_dn
    return stated or (black_of_curve(curve) if curve is not None else 0.0)


def displacement_of(bracket: Bracket, curve: ResponseCurve | None) -> Displacement | None:
    """Return how far the frames are displaced by parts of a pixel; None where they overlap too little.

    Args:
        curve: Their response; None where they are linear. One of another bit depth shows nothing.
    """
    from radiometer.analysis.response.displacement import find_displacement
    from radiometer.errors import MeasurementError

    if curve is not None and curve.bit_depth != bracket.bit_depth:
        return None
    black_dn = bracket.light[0].settings.black_level_dn or 0.0
    try:
        return find_displacement(bracket, curve or _straight_line(bracket, black_dn))
    except MeasurementError:
        return None


def with_displacement_stated(found: RadianceMap, displacement: Displacement | None) -> RadianceMap:
    """Return a map whose provenance says how far its frames are displaced, or that they were taken as not displaced.

    Args:
        found: The map.
        displacement: As the frames show it, with u; None where they cannot show it.
    """
    origin = found.provenance
    if displacement is None:
        origin = replace(origin, assumptions=(*origin.assumptions, _UNDISPLACED))
    else:
        facts = {"displacement_px": displacement.px, "displacement_u_px": displacement.u_px}
        origin = replace(origin, parameters={**origin.parameters, **facts})
    return replace(found, provenance=origin)


def _straight_line(bracket: Bracket, black_dn: float) -> ResponseCurve:
    """Return the response of a linear sensor."""
    import numpy as np

    from radiometer.analysis.response.limits import white_level_dn
    from radiometer.data import ResponseCurve

    size = 1 << bracket.bit_depth
    signal = np.arange(size) - black_dn
    g = np.where(signal > 0, np.log(np.maximum(signal, 1e-9) / (size // 2 - black_dn)), -np.inf)
    lowest = int(np.ceil(black_dn)) + max(3, size // 256)
    return ResponseCurve(
        g, np.where(signal > 0, 0.0, np.inf), valid_dn=(lowest, max(white_level_dn(bracket) - 1, lowest + 1))
    )


def _fingerprint(brackets: Mapping[str, Bracket]) -> str:
    """Return a hash of photographs: their values and exposure times in all colours, which are judged together."""
    digest = hashlib.sha256()
    for channel, bracket in brackets.items():
        digest.update(f"{channel} {len(bracket.light)} ".encode())
        for frame in bracket.light:
            digest.update(f"{frame.settings.effective_exposure_s!r} {frame.shape} {frame.bit_depth}".encode())
            digest.update(frame.dn.tobytes())
    return digest.hexdigest()


def _kept(file: Path, key: str) -> ResponseCurve | None:
    from radiometer.data import ResponseCurve

    if not file.is_file():
        return None
    try:
        curve = ResponseCurve.read(file)
        made_for = curve.provenance.parameters[_KEY]
    except (InputError, KeyError) as error:
        reason = "exists already and is no response that was recovered for a map; name another map, or move it away"
        raise OutputRefused(f"{file} {reason}") from error
    return curve if made_for == key else None


def _is_of_this_version(curve: ResponseCurve) -> bool:
    from radiometer.data.provenance import source_hash

    return curve.provenance.parameters.get(_VERSION_KEY) == source_hash(_RECOVERY)

"""Photographs of one scene on their way from a folder to brackets: the one path of all that reads photographs.

`Photographs` is frozen: every step returns another one. `prepared` does what merge, measure, calibrate and flux share;
a response is recovered, and exposures are reconciled, from what `placed` returns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.calibration.shared import require_photograph
from radiometer.analysis.exports.curves import FILE_METHOD
from radiometer.analysis.response.labels import reject_inconsistent_exposures
from radiometer.data import (
    Bracket,
    Calibration,
    FlatField,
    RadianceMap,
    ResponseCurve,
)
from radiometer.data.setup import Setup
from radiometer.errors import UsageError
from radiometer.photographs.lens_profile import lensfun_flat_field, read_lens_record
from radiometer.photographs.response import (
    ENOUGH_PIXELS,
    displacement_of,
    in_their_own_depth,
    linear_doubt,
    offset_in_words,
    recovered_curves,
    relative_calibration,
    shutter_offset_of,
    with_displacement_stated,
    with_found_times,
    with_offset_of_response,
)
from radiometer.photographs.stated import (
    focus_doubt,
    iso_speeds,
    stated_camera,
    with_f_number,
    with_gains,
    with_iso,
    with_iso_in_map,
)
from radiometer.progress import Progress, counted, unseen

if TYPE_CHECKING:
    from radiometer.data import Bracket

# The offset of a shutter that photographs did not show. The travel of one curtain against the other is adjusted to
# 0.1 ms (`analysis.response.shutter_offset` names the source), taken as a rectangle: 6 % (k = 1) at 1/1000 s.
UNSTATED_SHUTTER_U_S: Final = 1e-4 / math.sqrt(3.0)
ALIGN_CHOICES: Final = ("auto", "on", "off")


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Photographs in one place."""

    brackets: list[Bracket]  # by channel, as given or moved
    common: list[Bracket]  # the part of them that all frames show
    absent: list[Any]  # where each frame shows nothing, shape (height, width) each; empty where nothing was moved
    sentence: str | None  # how they lay, for people; None where it was not asked for


def in_one_place(brackets: Sequence[Bracket], align: str, progress: Progress = unseen) -> Placed:
    """Return photographs in the place of that which shows most of the scene.

    Args:
        brackets: One per channel, of the same photographs; the movement is sought in green or the only one.
        align: "auto" moves them where they need it, "on" always, "off" never looks.
        progress: Called after every photograph.

    Raises:
        UsageError: If it is none of these.
    """
    from radiometer.analysis.merge.alignment import aligned, find_alignment
    from radiometer.analysis.response.labels import frame_name

    if align not in ALIGN_CHOICES:
        raise UsageError(f"--align {align}: choose one of {', '.join(ALIGN_CHOICES)}")
    if align == "off" or len(brackets[0].light) < 2:
        return Placed(list(brackets), list(brackets), [], None)
    seen = next((one for one in brackets if one.light[0].extra.get("channel") == "green"), brackets[0])
    alignment = find_alignment(seen, counted(progress, "aligning"))
    sentence = alignment.sentence([frame_name(seen, k) for k in range(len(seen.light))], moved=align == "on")
    if not (alignment.needed or align == "on"):
        return Placed(list(brackets), list(brackets), [], sentence)
    moved = [aligned(one, alignment) for one in brackets]
    # A frame that shows nothing in one channel is not trusted in the others: their edges are the same.
    absent = [reduce(np.logical_or, masks) for masks in zip(*(masks for _, masks in moved), strict=True)]
    whole = [one for one, _ in moved]
    return Placed(whole, [alignment.trimmed(one) for one in whole], absent, sentence)


@dataclass(frozen=True, slots=True, eq=False)
class Photographs:
    """Photographs of one unmoving scene, one bracket per channel."""

    brackets: Mapping[str, Bracket]  # by channel ("red", "luminance", "mono", …)
    folder: Path  # where they came from
    listed: str | None = None  # name of the list that gives their exposures; None where EXIF does
    # The part that all frames show, by channel; that of `brackets` where nothing was moved
    common: Mapping[str, Bracket] = field(default_factory=dict)
    # Where each frame shows nothing after moving, shape (height, width) each; empty where none was moved
    absent: tuple[NDArray[np.bool_], ...] = ()
    alignment: str | None = None  # how they lay, in a sentence; None where that was not asked
    # Response by channel; empty where the numbers are taken as proportional to light
    curves: Mapping[str, ResponseCurve] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # what a user should know, a sentence each
    assumed: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # what was assumed, by channel
    files: tuple[Path, ...] = ()  # files that a recovered response is kept in

    @property
    def are_raw(self) -> bool:
        """Return whether all are camera raw files, whose numbers are proportional to light."""
        return all("raw" in frame.extra for one in self.brackets.values() for frame in one.light)

    @property
    def only(self) -> Bracket:
        """Return the bracket of the only channel.

        Raises:
            UsageError: If there are several.
        """
        if len(self.brackets) != 1:
            raise UsageError(f"{self.folder}: choose one channel of {', '.join(self.brackets)}")
        return next(iter(self.brackets.values()))

    def each(self, change: Callable[[Bracket], Bracket]) -> Photographs:
        """Return the photographs with every bracket changed."""
        return replace(self, brackets={name: change(one) for name, one in self.brackets.items()})

    def noted(self, *texts: str | None) -> Photographs:
        """Return the photographs with further notes; None is no note."""
        return replace(self, notes=(*self.notes, *(text for text in texts if text)))

    def assuming(self, text: str) -> Photographs:
        """Return the photographs with a further assumption about all channels, which is noted as well."""
        assumed = {name: (*self.assumed.get(name, ()), text) for name in self.brackets}
        return replace(self, assumed=assumed).noted(text)

    def thinned(self) -> Photographs:
        """Return a lattice of pixels that is enough for a response."""
        return self.each(lambda one: one.thinned(ENOUGH_PIXELS))

    def placed(self, align: str = "auto", progress: Progress = unseen) -> Photographs:
        """Return the photographs in the place of that which shows most of the scene.

        Args:
            align: "auto" moves them where they need it, "on" always, "off" never looks.
            progress: Called after every photograph.

        Raises:
            UsageError: If it is none of these.
        """
        found = in_one_place(list(self.brackets.values()), align, progress)
        names = list(self.brackets)
        return replace(
            self,
            brackets=dict(zip(names, found.brackets, strict=True)),
            common=dict(zip(names, found.common, strict=True)),
            absent=tuple(found.absent),
            alignment=found.sentence,
        )

    def without_absent(self) -> Bracket:
        """Return the only bracket with what a frame does not show at full scale, as if it clipped there."""
        bracket = self.only
        if not self.absent:
            return bracket
        light = []
        for frame, absent in zip(bracket.light, self.absent, strict=True):
            dn = frame.dn.copy()
            dn[absent] = frame.full_scale_dn
            light.append(replace(frame, dn=dn))
        return replace(bracket, light=tuple(light))


def reject_inconsistent_photographs(photographs: Photographs) -> None:
    """Refuse photographs whose brightness contradicts their exposures.

    Raises:
        MeasurementError: If they do; with the names.
    """
    for bracket in photographs.brackets.values():
        reject_inconsistent_exposures(bracket)


def prepared(
    photographs: Photographs,
    *,
    calibration: Calibration | None = None,
    curves: Mapping[str, ResponseCurve] | None = None,
    linear: bool = False,
    measured_iso: Mapping[float, float] | None = None,
    iso: float | None = None,
    f_number: float | None = None,
    align: str = "auto",
    map_path: Path | None = None,
    progress: Progress = unseen,
) -> Photographs:
    """Return photographs in one place with gains, response and exposure times, ready to be merged or read.

    Their response is the calibration's, the given one, or recovered from them. They are treated as proportional to
    light where they are camera raw files, and where the caller says so.

    Args:
        photographs: As read.
        calibration: The camera's calibration: its response, its ISO speed, and its shutter's offset.
        curves: Response by channel; a single one serves all channels.
        linear: Their numbers are proportional to light above black.
        measured_iso: Real ISO speed by stated one.
        iso: ISO speed of photographs that state none.
        f_number: f-number of photographs that state none.
        align: "auto", "on" or "off".
        map_path: Keep a recovered response next to this file; None keeps none.
        progress: Called as they are aligned, and when their response is recovered.

    Raises:
        CalibrationError: If photographs and calibration do not go together.
        MeasurementError: If a response is needed and the photographs hold none.
        UsageError: If arguments exclude each other, or contradict the photographs.
    """
    taken = photographs.each(lambda one: with_iso(one, iso))
    speeds = iso_speeds(measured_iso, calibration)
    taken = taken.each(lambda one: with_f_number(with_gains(one, speeds), f_number))
    of_speed: str | None = None
    if calibration is not None:
        for bracket in taken.brackets.values():
            of_speed = require_photograph(calibration, bracket.light[0])
    elif linear:
        taken = _in_their_own_depth(taken)
    taken = taken.placed(align, progress).noted(*{focus_doubt(one) for one in taken.brackets.values()})
    if calibration is not None:
        held = calibration.found.exposure_offset_s != 0.0  # a model's offset takes the place of the response's
        timed = with_offset(taken, {} if held else dict.fromkeys(taken.brackets, calibration.response))
        return timed if of_speed is None else timed.assuming(of_speed)
    if curves:
        given = {name: curve_of_channel(curves, name) for name in taken.brackets}
        return with_offset(replace(taken, curves={k: v for k, v in given.items() if v is not None}), given)
    if linear or taken.are_raw:
        return _linear(taken)
    progress("recovering the response", 0, None)
    return _recovered(taken, map_path)


def _in_their_own_depth(photographs: Photographs) -> Photographs:
    brackets = in_their_own_depth(list(photographs.brackets.values()))
    return replace(photographs, brackets=dict(zip(photographs.brackets, brackets, strict=True)))


def _linear(photographs: Photographs) -> Photographs:
    """Return photographs that count as linear, with what speaks against it."""
    doubts = {} if photographs.are_raw else {name: linear_doubt(one) for name, one in photographs.common.items()}
    found = {name: (text,) for name, text in doubts.items() if text}
    return replace(photographs, assumed=found).noted(*(f"{name}: {text}" for name, (text,) in found.items()))


def _recovered(photographs: Photographs, map_path: Path | None) -> Photographs:
    """Return photographs with the response that they hold, and with the exposures that it was recovered with."""
    notes: list[str] = []
    curves, files = recovered_curves(list(photographs.common.values()), map_path, notes.append)
    brackets = {name: with_found_times(one, curves[name]) for name, one in photographs.brackets.items()}
    offsets = {name: offset_in_words(curve) for name, curve in curves.items()}
    assumed = {name: (text or times_as_stated(photographs),) for name, text in offsets.items()}
    return replace(photographs, brackets=brackets, curves=curves, assumed=assumed, files=tuple(files)).noted(*notes)


def with_offset(photographs: Photographs, curves: Mapping[str, ResponseCurve | None]) -> Photographs:
    """Return photographs with the shutter's offset of what was given, which is noted and, where taken, assumed."""
    brackets, assumed, notes = {}, {}, dict[str, list[str]]()
    for name, bracket in photographs.brackets.items():
        brackets[name], text, is_taken = with_offset_of_response(bracket, curves.get(name), photographs.listed)
        assumed[name] = (text if text and is_taken else times_as_stated(photographs),)
        if text:
            notes.setdefault(text, []).append(name)
    found = replace(photographs, brackets=brackets, assumed=assumed)
    return found.noted(*(f"{', '.join(names)}: {text}" for text, names in notes.items()))


def times_as_stated(photographs: Photographs) -> str:
    """Return what is assumed of exposure times that nothing corrects."""
    return f"exposure times as stated by {photographs.listed or 'EXIF'}"


def has_unstated_shutter_offset(photographs: Photographs, curve: ResponseCurve | None) -> bool:
    """Return whether exposures are those of a shutter whose offset is unknown: EXIF's labels, as they are printed.

    Args:
        curve: Their response, with the offset that it was recovered with; None where they are linear.
    """
    return photographs.listed is None and shutter_offset_of(curve) is None


def with_shutter_doubt(relative: Calibration, photographs: Photographs) -> Calibration:
    """Return a calibration without a scale whose exposures may be off by a shutter's offset where it is unknown.

    Args:
        relative: The calibration, with the response of the photographs.
    """
    if not has_unstated_shutter_offset(photographs, relative.response):
        return relative
    doubt = relative.uncertainties.model_copy(update={"exposure_u_s": UNSTATED_SHUTTER_U_S})
    return replace(relative, uncertainties=doubt)


def curve_of_channel(curves: Mapping[str, ResponseCurve], channel: str) -> ResponseCurve | None:
    """Return the curve of a channel, or the only one; None where there is none at all.

    Raises:
        UsageError: If there are several, and none of that channel.
    """
    if channel not in curves and len(curves) > 1:
        raise UsageError(f"there is no response curve of the channel {channel!r}; give one per channel, or one for all")
    return curves.get(channel) or next(iter(curves.values()), None)


def by_channel(curves: Sequence[tuple[str, ResponseCurve]]) -> dict[str, ResponseCurve]:
    """Return curves by channel. Raises UsageError if two are of one channel."""
    found: dict[str, ResponseCurve] = {}
    for channel, curve in curves:
        if channel in found:
            raise UsageError("two response curves are of the same channel; YAML curves say which channel they are of")
        found[channel] = curve
    return found


def falloff_of(
    photographs: Photographs, vignetting: str | None, lens: str | None = None, calibration: Calibration | None = None
) -> tuple[FlatField | None, str | None]:
    """Return the fall-off that is to be taken out of photographs, and in a sentence from what it was taken.

    Args:
        vignetting: "lensfun", or the file of a calibration with a flat field; None takes nothing out.
        lens: Name of the lens for lensfun in place of EXIF's.
        calibration: The calibration in use; its own flat field excludes another one.

    Raises:
        CaptureError: If EXIF does not say what lensfun needs.
        InputError: If lensfun does not know camera or lens.
        MissingLibrary: If lensfunpy is not installed.
        UsageError: If the file has no flat field, or one of another size.
    """
    if lens and vignetting != "lensfun":
        raise UsageError("--lens names the lens for --vignetting lensfun")
    if vignetting is None:
        return None, None
    if calibration is not None and calibration.flat_field is not None:
        raise UsageError("--vignetting: the calibration holds a flat field already; leave one of them out")
    bracket = next(iter(photographs.brackets.values()))
    if vignetting == "lensfun":
        record = read_lens_record(photographs.folder / str(bracket.light[0].extra["file"]), lens)
        return lensfun_flat_field(record, bracket.shape)
    flat = Calibration.read(Path(vignetting)).flat_field
    if flat is None:
        raise UsageError(f"--vignetting {vignetting}: that calibration has no flat field (calibrate --flat)")
    if flat.shape != bracket.shape:
        raise UsageError(
            f"--vignetting {vignetting}: made from frames of {flat.shape[1]} × {flat.shape[0]} pixels, the "
            f"photographs have {bracket.shape[1]} × {bracket.shape[0]}"
        )
    return flat, f"fall-off by the flat field of {Path(vignetting).name}"


def merge_photographs(
    photographs: Photographs,
    calibration: Calibration | None = None,
    flat: FlatField | None = None,
    *,
    keep_ghosts: bool = False,
    progress: Progress = unseen,
) -> dict[str, RadianceMap]:
    """Return the radiance maps of prepared photographs by channel.

    Args:
        photographs: As of `prepared`.
        calibration: The calibration that they were prepared with; None for relative values.
        flat: Fall-off to take out.
        keep_ghosts: Average what moved instead of taking it from the frames that agree.
        progress: Called before every channel.

    Raises:
        CalibrationError: If the calibration does not fit.
        MeasurementError: If frames do not belong together.
    """
    from radiometer.analysis.merge.bracket import merge  # the daemon starts without it

    maps = {}
    for done, (name, bracket) in enumerate(photographs.brackets.items()):
        progress("merging", done, len(photographs.brackets))
        curve, (camera, lens) = photographs.curves.get(name), stated_camera(bracket)
        if calibration is not None:
            known, displacement = calibration, displacement_of(bracket, calibration.response)
        else:
            known, displacement = relative_calibration(bracket, curve, camera, lens)
            known = with_shutter_doubt(known, photographs)
        found = merge(
            bracket,
            Setup(camera, lens, replace(known, flat_field=flat) if flat else known),
            absent=photographs.absent,
            without_ghosts=not keep_ghosts,
            displacement_px=displacement.px if displacement else 0.0,
        )
        found = with_iso_in_map(with_displacement_stated(found, displacement), bracket.light)
        further = (*_assumed_of(curve, name), *photographs.assumed.get(name, ()))
        origin = found.provenance
        maps[name] = replace(found, provenance=replace(origin, assumptions=(*origin.assumptions, *further)))
    return maps


def _assumed_of(curve: ResponseCurve | None, channel: str) -> tuple[str, ...]:
    """Return what a map assumes of its response: an uncertainty that no file states, another's colour."""
    if curve is None:
        return ()
    origin = curve.provenance
    of_file = origin.assumptions if origin.method == FILE_METHOD else ()
    if channel in (curve.channel, "mono"):
        return of_file
    return (*of_file, f"the response curve given ({curve.channel}) holds for {channel}")

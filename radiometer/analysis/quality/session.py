"""A session of captures, a folder per procedure and step, turned into the instrument's datasheet."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from radiometer.analysis.colour.calibration import ColourCamera, reference
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.quality import indices, spatial
from radiometer.analysis.quality.indices import Figure, v_lambda_mismatch
from radiometer.analysis.quality.procedures import PROCEDURES, Procedure, gain_of_step
from radiometer.analysis.quality.signals import StepSignal, step_signal
from radiometer.analysis.reading.budget import carried, coverage_factor, frame_conditions
from radiometer.data import Calibration, CaptureSet, Frame, Patch
from radiometer.data.calibration import SpectralResponse, StatedUncertainties
from radiometer.data.capture_header import CameraDescription
from radiometer.data.capture_set import HEADER_NAME
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError, InputError, MeasurementError, RadiometerError
from radiometer.reporting.origin import Origin, moment

FORMAT: Final = "radiometer-quality/1"
SOURCE_U_REL: Final = 0.001  # assumed where nothing is stated: a warm, regulated lamp
_SAME_GAIN_DB: Final = 0.06  # cameras set gains in steps of up to 0.1 dB
_MIDDLE_SHARE: Final = 10  # the patch is a tenth of the picture where none is stated


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What a session is read with."""

    # The instrument's calibration: its corrections belong to the instrument; None reads raw ratios
    calibration: Calibration | None = None
    patch: Patch | None = None  # where to read; None takes each capture's own patch, else the middle
    source_u_rel: float = SOURCE_U_REL  # relative standard uncertainty that the source's steadiness gives to each step
    response: SpectralResponse | None = None  # spectral response; None takes the calibration's


@dataclass(frozen=True, slots=True)
class Index:
    """One line of the datasheet: a procedure with what was found, or why nothing was."""

    procedure: Procedure  # what was to be measured
    figure: Figure | None = None  # what was found; None where not measured
    reason: str = ""  # why not, or the error; empty where measured
    steps: tuple[str, ...] = ()  # names of the captures used

    def to_mapping(self) -> dict[str, Any]:
        """Return the plain mapping for programs."""
        one = self.procedure
        stated = {name: getattr(one, name) for name in ("symbol", "title", "definition", "source")}
        content: dict[str, Any] = {"index": one.name, **stated, "measured": self.figure is not None}
        if self.figure is None:
            return {**content, "reason": self.reason}
        found, k = self.figure, coverage_factor(self.figure.degrees_of_freedom)
        return {
            **content,
            "value": found.value,
            "u": found.u,
            "coverage_factor": k,
            "expanded": k * found.u,
            "unit": found.unit,
            "steps": list(self.steps),
            "details": [{"of": one.label, "value": one.value, "u": one.u} for one in found.details],
            "remarks": list(found.remarks),
        }


@dataclass(frozen=True, slots=True)
class Datasheet:
    """The instrument's quality indices."""

    camera: CameraDescription | None  # the camera that was measured
    lens: str  # its lens in a few words
    indices: tuple[Index, ...]  # one per procedure, in their order
    assumptions: tuple[str, ...]  # what was assumed
    created: str  # time, UTC
    origin: Origin  # what the captures were taken with, for the head of the page

    def to_mapping(self) -> dict[str, Any]:
        """Return the plain mapping for programs."""
        return {
            "format": FORMAT,
            "created": self.created,
            "camera": self.camera.model_dump(mode="json", exclude_none=True) if self.camera else None,
            "lens": self.lens,
            "indices": [one.to_mapping() for one in self.indices],
            "assumptions": list(self.assumptions),
        }


def evaluate(session: Path, how: Evaluation, progress: Callable[[str], None] | None = None) -> Datasheet:
    """Return the datasheet of a session: every index that its captures allow, the others as not measured.

    An index whose captures cannot be used says why; the others stand.

    Args:
        session: Folder with a folder per procedure and in it one per step, each a capture set.

    Raises:
        InputError: If the folder is missing or holds no capture of any procedure, and no spectral response is known.
    """
    if not session.is_dir():
        raise InputError(f"{session} is not a folder; take the captures with: radiometer quality take {session}")
    captures = {one.name: _captures(session / one.name) for one in PROCEDURES}
    if not any(captures.values()) and _response(how) is None:
        raise InputError(
            f"{session} holds no capture of any procedure; `radiometer quality plan` lists them, and "
            f"radiometer quality take {session} PROCEDURE takes them"
        )
    found = []
    for one in PROCEDURES:
        if progress:
            progress(one.title)
        found.append(_index(one, captures[one.name], how))
    headers = [each.header for sets in captures.values() for each in sets.values()]
    header = headers[0] if headers else None
    known = how.calibration
    calibration = "none: raw readings" if known is None else f"{moment(known.created)}, {known.scale.reference}"
    if headers:
        origin = Origin.of_captures(headers, calibration=calibration)
    else:
        origin = Origin("", known.camera.name if known else "", "", calibration)
    return Datasheet(
        header.camera if header else how.calibration.camera if how.calibration else None,
        header.lens.in_words() if header else "",
        tuple(found),
        _assumptions(how),
        dt.datetime.now(dt.UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        origin,
    )


def _captures(folder: Path) -> dict[str, CaptureSet]:
    """Return the finished captures of a procedure by step; unfinished ones raise when they are read."""
    if not folder.is_dir():
        return {}
    inside = sorted(one for one in folder.iterdir() if one.is_dir() and (one / HEADER_NAME).is_file())
    return {one.name: CaptureSet.read(one) for one in inside}


def _assumptions(how: Evaluation) -> tuple[str, ...]:
    steady = f"each source steady to {100 * how.source_u_rel:g} % (k = 1) from step to step of a procedure"
    read = "raw readings: no calibration was given" if how.calibration is None else "readings as calibrated"
    return (
        steady,
        read,
        "definitions as found in open literature; the text of the standards was not at hand",
    )


def _index(one: Procedure, captures: Mapping[str, CaptureSet], how: Evaluation) -> Index:
    if one.name == "spectral":
        response = _response(how)
        if response is None:
            return Index(one, reason="the camera's spectral response is not known; state it (--spectral-response)")
        return Index(one, v_lambda_mismatch(response))
    missing = [step.name for step in one.steps if step.name not in captures]
    needed = len(one.steps) if one.name in ("glare", "focus") else 1
    if len(captures) < needed:
        names = ", ".join(missing)
        return Index(one, reason=f"not captured: {names}" if captures else "not captured")
    try:
        return Index(one, _FIGURES[one.name](captures, how), steps=tuple(captures))
    except RadiometerError as error:
        return Index(one, reason=str(error), steps=tuple(captures))


def _response(how: Evaluation) -> SpectralResponse | None:
    return how.response or (how.calibration.spectral_response if how.calibration else None)


def patch_of(capture: CaptureSet, stated: Patch | None) -> Patch:
    """Return where a capture is read: as stated, else its own patch, else the middle of the picture."""
    if stated is not None:
        return stated
    if capture.header.patches:
        return capture.header.patches[0].patch
    height, width = capture.read_frame(0).shape
    across, down = max(width // _MIDDLE_SHARE, 1), max(height // _MIDDLE_SHARE, 1)
    return Patch((width - across) // 2, (height - down) // 2, across, down)


def _signals(captures: Mapping[str, CaptureSet], how: Evaluation, varied: str = "") -> dict[str, StepSignal]:
    """Return the reading of each step, with what its settings differ by from those of the first.

    Args:
        varied: What the index is about, and so no doubt: "temperature", "gain" or "focus".
    """
    first = next(iter(captures.values()))
    return {
        name: replace(
            step_signal(name, one, patch_of(one, how.patch), how.calibration),
            apart_u_rel=_apart_u_rel(name, one, first, varied),
        )
        for name, one in captures.items()
    }


def _apart_u_rel(name: str, one: CaptureSet, first: CaptureSet, varied: str) -> float:
    """Return the relative u of a step by settings other than the first's. Raises MeasurementError where none is known.

    What a calibration and a reading must share holds for two steps of an index.
    """
    there, here = ([s.header.frames[i].settings for i in s.lit_indices(s.header.patterns[0])[1]] for s in (first, one))
    if here[0].source_level != there[0].source_level:
        raise MeasurementError(
            f"step {name!r} was taken at a source level of {here[0].source_level:g}, {first.path.name!r} at "
            f"{there[0].source_level:g}; remove {one.path} and take it again"
        )
    lens = one.header.lens
    if varied == "focus":
        focus = ("magnification", "pupil_magnification", "since_calibration")
        lens = lens.model_copy(update={key: getattr(first.header.lens, key) for key in focus})
    if varied == "gain":
        here = [replace(settings, gain_db=there[0].gain_db) for settings in here]
    if varied == "temperature":
        here = [replace(settings, temperature_c=frame_conditions(there).temperature_c) for settings in here]
    stop = there[0].f_number or first.header.lens.f_number
    at_stop = first.header.lens.model_copy(update={"f_number": stop})
    taken = ColourCamera((), first.header.camera, at_stop, frame_conditions(there), there[0].iso)
    as_first = reference(taken, dt.datetime.now(dt.UTC).isoformat(), absolute=False)
    try:
        return carried(Setup(one.header.camera, lens, as_first), here)[1]
    except CalibrationError as error:
        raise MeasurementError(f"step {name!r} and {first.path.name!r} are no readings to compare: {error}") from error


def _in_order(captures: Mapping[str, CaptureSet], how: Evaluation, first: str, varied: str = "") -> Figure:
    signals = _signals(captures, how, varied)
    if first not in signals:
        raise MeasurementError(f"step {first!r} is missing: the others are compared with it")
    return indices.worst_deviation(list(signals.values()), signals[first], how.source_u_rel)


def _range_change(captures: Mapping[str, CaptureSet], how: Evaluation) -> Figure:
    for name, capture in captures.items():
        stated = gain_of_step(name)
        taken_at = sorted({frame.gain_db for frame in capture.header.frames})
        if stated is not None and any(abs(gain_db - stated) > _SAME_GAIN_DB for gain_db in taken_at):
            gains = ", ".join(f"{gain_db:g} dB" for gain_db in taken_at)
            raise MeasurementError(f"step {name!r} was captured at {gains}; remove {capture.path} and take it again")
    return _in_order(captures, how, "0dB" if "0dB" in captures else next(iter(captures)), "gain")


def _linearity(captures: Mapping[str, CaptureSet], how: Evaluation) -> Figure:
    capture = next(iter(captures.values()))
    patch, frames = patch_of(capture, how.patch), list(capture.frames())
    dark = [one for one in frames if one.settings.is_dark]
    groups: dict[float, list[Frame]] = {}
    for frame in frames:
        if not frame.settings.is_dark:
            groups.setdefault(frame.settings.exposure_s, []).append(frame)
    signals = {}
    for exposure_s, alike in groups.items():
        try:
            signals[exposure_s] = step_signal(
                f"{exposure_s:g} s", capture, patch, how.calibration, [*_of_exposure(dark, exposure_s), *alike]
            )
        except MeasurementError:
            continue  # clips: above the range
    if not signals:
        raise MeasurementError(f"{capture.path}: the patch clips in every frame; capture shorter exposures")
    stated = how.calibration.uncertainties if how.calibration else StatedUncertainties()
    return indices.linearity(signals, stated.exposure_u_rel, how.source_u_rel)


def _of_exposure(dark: list[Frame], exposure_s: float) -> list[Frame]:
    return [one for one in dark if math.isclose(one.settings.exposure_s, exposure_s, rel_tol=0.01)] or dark


def _by_number(captures: Mapping[str, CaptureSet], how: Evaluation, what: str) -> dict[float, StepSignal]:
    found = {}
    for name, signal in _signals(captures, how).items():
        try:
            found[float(name.rstrip("°"))] = signal
        except ValueError as error:
            raise MeasurementError(f"step {name!r}: its name must be the {what} as a number") from error
    return found


def _map_figure(
    captures: Mapping[str, CaptureSet], how: Evaluation, of: Callable[..., Figure], *, placed: bool
) -> Figure:
    capture = next(iter(captures.values()))
    header = capture.header
    radiance = merge(capture.bracket(), Setup(header.camera, header.lens, how.calibration))
    return of(radiance, patch_of(capture, how.patch)) if placed else of(radiance)


def _glare(captures: Mapping[str, CaptureSet], how: Evaluation) -> Figure:
    signals = _signals(captures, how)
    return indices.glare_index(signals["white"], signals["black"], how.source_u_rel)


_FIGURES: Final[dict[str, Callable[[Mapping[str, CaptureSet], Evaluation], Figure]]] = {
    "linearity": _linearity,
    "temperature": lambda sets, how: indices.temperature(
        list(_signals(sets, how, "temperature").values()), how.source_u_rel
    ),
    "modulation": lambda sets, how: _in_order(sets, how, "steady"),
    "polarisation": lambda sets, how: indices.polarisation(_by_number(sets, how, "angle in degrees"), how.source_u_rel),
    "range": lambda sets, how: _range_change(sets, how),
    "focus": lambda sets, how: _in_order(sets, how, "far", "focus"),
    "uniformity": lambda sets, how: _map_figure(sets, how, spatial.uniformity, placed=False),
    "edge": lambda sets, how: _map_figure(sets, how, spatial.edge_width, placed=True),
    "smear": lambda sets, how: _map_figure(sets, how, spatial.smear, placed=True),
    "size": lambda sets, how: indices.size_of_source(_by_number(sets, how, "diameter"), how.source_u_rel),
    "glare": _glare,
}

"""Quantities that a calibration and a reading must share, and the action where they do not: one table for all.

A quantity is equal on both sides, different, or not stated by one of them. For each pair of states, `TABLE` gives the
action: the reading is left as it is, corrected, made more uncertain, or refused. Every stage asks `settle`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Protocol

from radiometer.data import Calibration, CameraDescription, Frame, LensDescription, ResponseCurve
from radiometer.data.capture_header import AUTOMATIC, same_serial
from radiometer.errors import CalibrationError, RadiometerError, UsageError

# A zoom's rings, the tags of EXIF, drivers and data sheets round lengths and gains to this.
_SAME_REL: Final = 0.01
_AUTOMATIC_BALANCE: Final = (
    "the camera weighed the colours of all photographs alike, though its white balance is automatic: at the camera, "
    "set it by hand"
)
_UNBINNED: Final = "1"  # so usual that a calibration which states none of it raises no doubt
# Colours that frames are read in; numbers of a grey frame are of no colour.
_COLOURS: Final = frozenset({"red", "green", "blue", "luminance"})


class State(StrEnum):
    """How a quantity of a reading compares with that of its calibration."""

    EQUAL = "equal"
    DIFFERENT = "different"
    READING_SILENT = "not stated by the reading"
    CALIBRATION_SILENT = "not stated by the calibration"
    BOTH_SILENT = "not stated by either"


class Handling(StrEnum):
    """What is done about it.

    An assumption is named in the result. A corrected reading carries the uncertainty of the correction in its budget.
    """

    KEPT = "kept"
    ASSUMED = "assumed"
    CORRECTED = "corrected"
    WIDENED = "widened"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Rule:
    """What is done in one state."""

    handling: Handling  # what is done
    reason: str  # why; of a refusal the message, with {there} and {here} for the two values
    term: str = ""  # line of the budget that carries the doubt; empty where there is none
    # What a refusal raises: a misuse where another option is the way out
    error: type[RadiometerError] = CalibrationError


_KEPT = Rule(Handling.KEPT, "both are the same")
_AS_CALIBRATED = Rule(Handling.KEPT, "the reading is taken with what was calibrated")
_NOT_COMPARED = Rule(Handling.KEPT, "nothing to compare")
_UNLESS_DIFFERENT: Final[Mapping[State, Rule]] = {
    State.EQUAL: _KEPT,
    State.READING_SILENT: _AS_CALIBRATED,
    State.CALIBRATION_SILENT: _AS_CALIBRATED,
    State.BOTH_SILENT: _NOT_COMPARED,
}


def _refused(reason: str, error: type[RadiometerError] = CalibrationError) -> Rule:
    return Rule(Handling.REFUSED, reason, error=error)


def _of_device(name: str) -> dict[State, Rule]:
    """Return the rules of a mark of the camera, which is the same camera or another."""
    different = _refused(
        f"the {{what}} is of another camera: its {name} is {{there}}, the camera's is {{here}}; use this camera's own, "
        "or make one"
    )
    return {**_UNLESS_DIFFERENT, State.DIFFERENT: different}


def _of_settings(name: str, unit: str = "") -> dict[State, Rule]:
    """Return the rules of a setting of the camera that changes its scale by a factor that nothing states."""
    other = "another setting may change the numbers by any factor"
    return {
        State.EQUAL: _KEPT,
        State.DIFFERENT: _refused(
            f"the {{what}} holds for {name} {{there}}{unit}, the frames were taken with {{here}}{unit}: {other}; "
            "make one with the setting in use, or correct the one that is stated wrongly"
        ),
        State.READING_SILENT: Rule(
            Handling.ASSUMED, f"{name} {{there}}{unit}, as at calibration: the frames do not state it, and {other}"
        ),
        State.CALIBRATION_SILENT: Rule(
            Handling.ASSUMED,
            f"{name} {{here}}{unit} at calibration too: the calibration does not state it, and {other}",
        ),
        State.BOTH_SILENT: _NOT_COMPARED,
    }


_F_NUMBER_UNKNOWN: Final = _refused(
    "the f-number is not stated: without it the radiance could be wrong by any factor; give --f-number N, "
    "or state lens.f_number in the capture set or bench file"
)

TABLE: Final[Mapping[str, Mapping[State, Rule]]] = {
    "model": _of_device("model"),
    "serial": _of_device("serial"),
    # Both sides always state it.
    "bit depth": {state: _of_device("bit depth")[state] for state in (State.EQUAL, State.DIFFERENT)},
    # Binned pixels have another, and another scale.
    "pixel pitch": _of_device("pixel pitch in µm"),
    # Without it the four colours are read as one.
    "mosaic": _of_device("mosaic")
    | {
        State.READING_SILENT: _refused(
            "the calibration is of one colour of a mosaic {there}, the frames state no mosaic and would be read as one "
            "colour; add `mosaic: {there}` to the camera of the capture set"
        ),
        State.CALIBRATION_SILENT: _refused(
            "the frames are of a mosaic {here}, the calibration states none, so it is of all colours as one; calibrate "
            "with frames that state `mosaic: {here}`"
        ),
    },
    # Read-out mode, gain in the camera's own unit and the like.
    "mode": _of_settings("mode"),
    "filter": _of_settings("filter"),
    "band": _of_settings("band"),
    "binning": _of_settings("binning"),
    "white_balance": _of_settings("white balance"),
    # A gain in dB or an ISO speed is left out of it. Noise alone rests on it where one side states it.
    "conversion gain": _of_settings("conversion gain", " e⁻/DN")
    | dict.fromkeys((State.READING_SILENT, State.CALIBRATION_SILENT), _AS_CALIBRATED),
    "focal length": {
        **_UNLESS_DIFFERENT,
        State.DIFFERENT: _refused(
            "the calibration was made with a lens of {there} mm, the one in use has {here} mm; "
            "calibrate with the lens in use"
        ),
    },
    # Of a flat field alone: the rest of the optics is corrected for them.
    "focus of a flat field": {
        State.EQUAL: _KEPT,
        State.DIFFERENT: _refused(
            "its lens has a magnification of {here}, at calibration {there}: the fall-off changes with the focus; "
            "take the flat field at the focus of the calibration, or correct lens.magnification"
        ),
    },
    "place of a flat field": {
        **_UNLESS_DIFFERENT,
        State.DIFFERENT: _refused(
            "the flat field holds for frames whose optical axis is at {there} px, these have it at {here} px: another "
            "part of the sensor; read the same part, calibrate with it, or correct lens.principal_point_px"
        ),
    },
    "f-number": {
        State.EQUAL: _KEPT,
        State.DIFFERENT: Rule(Handling.CORRECTED, "the light of a lens goes as 1/N²", "f-number"),
        State.READING_SILENT: _F_NUMBER_UNKNOWN,
        State.CALIBRATION_SILENT: _refused(
            "the calibration does not say at which f-number its scale holds, the frames were taken at f/{here}; "
            "calibrate again with --f-number, or add scale.f_number to the calibration file"
        ),
        State.BOTH_SILENT: _F_NUMBER_UNKNOWN,
    },
    "ISO speed": {
        State.EQUAL: _KEPT,
        State.DIFFERENT: Rule(Handling.CORRECTED, "numbers go as the ISO speed", "gain step"),
        State.READING_SILENT: Rule(
            Handling.ASSUMED,
            "the photographs state no ISO speed: treated as taken at ISO {there}, as the calibration; --iso S states "
            "another",
        ),
        State.CALIBRATION_SILENT: _refused(
            "the calibration does not say at which ISO speed its scale holds, the photographs were taken at ISO "
            "{here}; calibrate again with --iso, or add scale.iso to the calibration file"
        ),
        State.BOTH_SILENT: _NOT_COMPARED,
    },
    # A frame always has a gain: 0 dB where its file states none, as the format of capture sets says.
    "gain": {
        State.EQUAL: _KEPT,
        State.DIFFERENT: Rule(Handling.CORRECTED, "numbers go as the gain", "gain step"),
    },
    "channel": {
        State.EQUAL: _KEPT,
        State.DIFFERENT: _refused(
            "the calibration is of {there}, the frames would be read in {here}: give --channel {there}, or a "
            "calibration of {here}",
            UsageError,
        ),
        State.READING_SILENT: _NOT_COMPARED,
        State.CALIBRATION_SILENT: Rule(
            Handling.ASSUMED,
            "colour channel {here} at calibration too: the calibration does not state it, and another may change the "
            "numbers by any factor",
        ),
        State.BOTH_SILENT: _NOT_COMPARED,
    },
    "spectrum": {
        State.EQUAL: _KEPT,
        State.DIFFERENT: Rule(
            Handling.CORRECTED,
            "by the spectral mismatch factor where the camera's spectral response is known; else the spread over "
            "plausible responses counts",
            "spectral assumption",
        ),
        State.READING_SILENT: Rule(Handling.WIDENED, "the spread over kinds of light counts", "spectral assumption"),
    },
    "temperature": dict.fromkeys(State, Rule(Handling.WIDENED, "by a room's", "temperature"))
    | {State.EQUAL: _KEPT, State.DIFFERENT: Rule(Handling.WIDENED, "by the distance", "temperature")},
    # Equal: inside the numbers that the curve has data for. Different: outside. A reading there is flagged.
    "response support": {
        State.EQUAL: _KEPT,
        State.DIFFERENT: _refused(
            "the response curve is supported from {there} DN, the pixel value of the reference is {here} DN; take a "
            "reference photograph in that range, or recover the curve from exposures that reach it",
            UsageError,
        ),
    },
}


def state_of(there: object | None, here: object | None, *, equal: bool | None = None) -> State:
    """Return how a quantity of a calibration compares with that of a reading.

    Args:
        there: Of the calibration; None where it does not state it.
        here: Of the reading; None where it does not state it.
        equal: Whether both count as equal where they are stated; None compares them.
    """
    if there is None or here is None:
        if there is None and here is None:
            return State.BOTH_SILENT
        return State.CALIBRATION_SILENT if there is None else State.READING_SILENT
    return State.EQUAL if (there == here if equal is None else equal) else State.DIFFERENT


def settle(
    quantity: str,
    there: object | None,
    here: object | None,
    *,
    equal: bool | None = None,
    what: str = "calibration",
) -> Handling:
    """Return what is done about a quantity of a calibration and a reading.

    Args:
        quantity: Name in `TABLE`.
        there: Of the calibration; None where it does not state it.
        here: Of the reading; None where it does not state it.
        equal: Whether both count as equal where they are stated; None compares them.
        what: What is compared with the reading, in the words of a message.

    Raises:
        CalibrationError: If they do not go together; with the two values and the way out.
        UsageError: If another option is the way out.
    """
    rule = TABLE[quantity][state_of(there, here, equal=equal)]
    if rule.handling is Handling.REFUSED:
        raise rule.error(rule.reason.format(there=_shown(there), here=_shown(here), what=what))
    return rule.handling


class OfCamera(Protocol):
    """A calibration that belongs to one camera with one lens."""

    @property
    def camera(self) -> CameraDescription:
        """Return the camera."""

    @property
    def lens(self) -> LensDescription:
        """Return the lens."""


def require_camera(calibration: OfCamera, camera: CameraDescription) -> tuple[str, ...]:
    """Refuse a camera that a calibration does not belong to, or one with another setting.

    Returns what is assumed of its settings.

    Raises:
        CalibrationError: If model, serial number, bit depth, pixel pitch, mosaic or a setting such as binning differ.
    """
    mine = calibration.camera
    require_same_camera(mine, camera, "calibration")
    settle("bit depth", mine.bit_depth, camera.bit_depth)
    pitches = mine.pixel_pitch_um, camera.pixel_pitch_um
    settle("pixel pitch", *pitches, equal=_is_near(*pitches))
    settle("mosaic", mine.mosaic, camera.mosaic)
    gains = mine.conversion_gain_e_per_dn, camera.conversion_gain_e_per_dn
    settle("conversion gain", *gains, equal=_is_near(*gains))
    if mine.binning is None and camera.binning == _UNBINNED:
        mine = mine.model_copy(update={"binning": _UNBINNED})
    settings = (_assumed(name, getattr(mine, name), getattr(camera, name)) for name in CameraDescription.SETTINGS)
    weighed = _AUTOMATIC_BALANCE if camera.white_balance == AUTOMATIC else None
    return tuple(filter(None, (*settings, weighed)))


def require_same_camera(mine: CameraDescription, camera: CameraDescription, what: str) -> None:
    """Refuse another camera than the one that something belongs to, or another mode of it.

    Args:
        mine: The camera that it belongs to.
        camera: The camera in use.
        what: What belongs to it, in the words of the message.

    Raises:
        CalibrationError: If model, serial number or mode differ.
    """
    settle("model", mine.model, camera.model, what=what)
    alike = None not in (mine.serial, camera.serial) and same_serial(str(mine.serial), str(camera.serial))
    settle("serial", mine.serial, camera.serial, equal=alike, what=what)
    settle("mode", mine.mode, camera.mode, what=what)


def require_response(curve: ResponseCurve | None, camera: CameraDescription) -> tuple[str, ...]:
    """Refuse the response curve of another camera, or of another mode of it.

    Returns what is assumed where the curve does not say of which camera it is.

    Raises:
        CalibrationError: If model, serial number or mode differ.
    """
    if curve is None:
        return ()
    if (mine := curve.camera) is None:
        return ("the response curve does not state its camera: it counts as that of this one",)
    require_same_camera(mine, camera, "response curve")
    return ()


def require_lens(calibration: OfCamera, lens: LensDescription) -> None:
    """Refuse a lens of another focal length than the calibration was made with.

    Raises:
        CalibrationError: If the focal lengths differ by more than 1 %.
    """
    mine, theirs = calibration.lens.focal_length_mm, lens.focal_length_mm
    settle("focal length", mine, theirs, equal=_is_near(mine, theirs))


def require_place(calibration: OfCamera, lens: LensDescription) -> None:
    """Refuse frames of another part of the sensor than a flat field.

    Raises:
        CalibrationError: If both state where the optical axis meets the frames, and not to the same half pixel.
    """
    mine, theirs = calibration.lens.principal_point_px, lens.principal_point_px
    near = None not in (mine, theirs) and all(abs(a - b) <= 0.5 for a, b in zip(mine or (), theirs or (), strict=True))
    settle("place of a flat field", mine, theirs, equal=near)


def is_focused_alike(calibration: OfCamera, lens: LensDescription) -> bool:
    """Return whether a lens's image distance is that at calibration, within 1 %."""
    return _is_near(calibration.lens.extension, lens.extension)


def require_flat_field(base: OfCamera, camera: CameraDescription, lens: LensDescription) -> None:
    """Refuse a flat field of another camera, lens, focus or part of the sensor than the calibration that it is for.

    Raises:
        CalibrationError: If they differ.
    """
    require_camera(base, camera)
    require_lens(base, lens)
    require_place(base, lens)
    mine, theirs = base.lens.magnification, lens.magnification
    settle("focus of a flat field", mine, theirs, equal=is_focused_alike(base, lens))


def _is_near(there: float | None, here: float | None) -> bool:
    return there is not None and here is not None and abs(there / here - 1.0) <= _SAME_REL


def _assumed(quantity: str, there: object | None, here: object | None) -> str | None:
    """Return what is assumed of a quantity; None where nothing is. Raises what `settle` does."""
    if settle(quantity, there, here) is not Handling.ASSUMED:
        return None
    return TABLE[quantity][state_of(there, here)].reason.format(there=_shown(there), here=_shown(here))


def require_photograph(calibration: Calibration, frame: Frame) -> str | None:
    """Refuse a photograph in another colour than the calibration's, or of an ISO speed that cannot be compared.

    Returns what is assumed of its ISO speed, None where nothing is.

    Args:
        calibration: The calibration; of a relative one the colour alone counts.

    Raises:
        CalibrationError: If the calibration does not state its ISO speed, and the photograph does.
        UsageError: If colours differ.
    """
    require_channel(calibration, frame)
    if not calibration.absolute:
        return None
    # Equal speeds or not: the gain that the frame carries holds their ratio.
    there, here = calibration.scale.iso, frame.settings.iso
    return _assumed("ISO speed", there, here)


def require_channel(calibration: Calibration, frame: Frame) -> tuple[str, ...]:
    """Refuse a frame in another colour than a calibration's, or than the response that is to get a scale.

    Returns what is assumed of the calibration's colour.

    Raises:
        UsageError: If colours differ.
    """
    assumed = _assumed("channel", channel_of(calibration), _colour(frame.extra.get("channel")))
    return (assumed,) if assumed else ()


def channel_of(calibration: Calibration | None) -> str | None:
    """Return the colour that a calibration holds for; None of none, of a grey camera, or where it is not stated."""
    if calibration is None:
        return None
    of_scale = _colour(calibration.scale.conditions.channel)
    return of_scale or (_colour(calibration.response.channel) if calibration.response is not None else None)


def _colour(name: object) -> str | None:
    return name if isinstance(name, str) and name in _COLOURS else None


def _shown(value: object | None) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)

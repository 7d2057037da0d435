"""A screen's calibration in the file forms of other programs, and as a page."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.json_text import json_text
from radiometer.data.storage import write_bytes_atomic, write_text_atomic
from radiometer.errors import CalibrationError, UsageError, required_library
from radiometer.moments import moment_of
from radiometer.numbers import below, unit_text, with_u
from radiometer.reporting.origin import Origin, moment
from radiometer.reporting.page import folded, listed, page, section, table
from radiometer.reporting.pictures import dress, legend, picture
from radiometer.screen.calibration import AXES, LUMINANCE, RADIANCE, SCOTOPIC, ChannelCurve, ScreenCalibration
from radiometer.screen.run import checks_in_words
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# IEC 61966-2-1 (sRGB): primaries of ITU-R BT.709 and the white point D65.
ASSUMED_XY: Final[dict[str, tuple[float, float]]] = {
    "grey": (0.3127, 0.3290),
    "red": (0.640, 0.330),
    "green": (0.300, 0.600),
    "blue": (0.150, 0.060),
}
ASSUMPTION: Final = "X and Z assume the chromaticities of sRGB (IEC 61966-2-1); only Y was measured"


def assumption_of(calibration: ScreenCalibration) -> str | None:
    """Return what the tristimulus values of a calibration assume; None where all chromaticities are known."""
    return None if set(calibration.channels) <= set(calibration.chromaticities) else ASSUMPTION


def xyz_of(calibration: ScreenCalibration, channel: str, luminance_cd_m2: float) -> tuple[float, float, float]:
    """Return X, Y and Z in cd·m⁻² of a luminance in a channel's known, else assumed, chromaticity."""
    x, y = _xy_of(calibration, channel)
    return luminance_cd_m2 * x / y, luminance_cd_m2, luminance_cd_m2 * (1 - x - y) / y


def argyll_line(calibration: ScreenCalibration, channel: str, luminance_cd_m2: float) -> str:
    """Return the line that ArgyllCMS's spotread prints for a reading, with -x: XYZ and Yxy.

    Source: the printf of spotread.c, ` Result is XYZ: %f %f %f, Yxy: %f %f %f`.
    """
    big = xyz_of(calibration, channel, luminance_cd_m2)
    x, y = _xy_of(calibration, channel)
    return f" Result is XYZ: {big[0]:f} {big[1]:f} {big[2]:f}, Yxy: {luminance_cd_m2:f} {x:f} {y:f}"


def _xy_of(calibration: ScreenCalibration, channel: str) -> tuple[float, float]:
    return calibration.chromaticities.get(channel, ASSUMED_XY[channel])


def to_ti3(calibration: ScreenCalibration) -> str:
    """Return the calibration as a .ti3 text.

    Source: ArgyllCMS, "File formats: .ti3"; checked against files that dispread wrote.
    """
    grey = calibration.channel("grey")
    white = grey.at(grey.levels[-1], LUMINANCE).value
    rows = [row for name in calibration.channels for row in _rows(calibration, name, white)]
    created = moment_of(calibration.created).strftime("%a %b %d %H:%M:%S %Y")
    assumed = assumption_of(calibration)
    head = [
        "CTI3   ",
        "",
        'DESCRIPTOR "Argyll Calibration Target chart information 3"',
        'ORIGINATOR "radiometer screen calibrate"',
        f'CREATED "{created}"',
        'DEVICE_CLASS "DISPLAY"',
        'COLOR_REP "RGB_XYZ"',
        'TARGET_INSTRUMENT "radiometer"',
        'INSTRUMENT_TYPE_SPECTRAL "NO"',
        'LUMINANCE_XYZ_CDM2 "{:.6f} {:.6f} {:.6f}"'.format(*xyz_of(calibration, "grey", white)),
        'NORMALIZED_TO_Y_100 "YES"',
        *([f"# {assumed}"] if assumed else []),
        "",
        "NUMBER_OF_FIELDS 7",
        "BEGIN_DATA_FORMAT",
        "SAMPLE_ID RGB_R RGB_G RGB_B XYZ_X XYZ_Y XYZ_Z ",
        "END_DATA_FORMAT",
        "",
        f"NUMBER_OF_SETS {len(rows)}",
        "BEGIN_DATA",
    ]
    return "\n".join([*head, *(f"{n} {row}" for n, row in enumerate(rows, 1)), "END_DATA"]) + "\n"


def _rows(calibration: ScreenCalibration, name: str, white: float) -> list[str]:
    curve, mask = calibration.channel(name), AXES[name]
    rows = []
    for level in curve.levels:
        percent = 100 * level / curve.top_level
        xyz = xyz_of(calibration, name, 100 * curve.at(level, LUMINANCE).value / white)
        rows.append(" ".join(f"{v:.5f}" for v in (*(percent * on for on in mask), *xyz)))
    return rows


_HEADER: Final = (
    "channel,level,drive,radiance_W_per_sr_m2,u_radiance_W_per_sr_m2,luminance_cd_m2,u_luminance_cd_m2,"
    "scotopic_luminance_cd_m2,below_detection"
)
_INVERSE_HEADER: Final = "channel,target_luminance_cd_m2,level,luminance_cd_m2,u_luminance_cd_m2"
_INVERSE_STEPS: Final = 256  # one per level of 8 bits


def to_csv(calibration: ScreenCalibration) -> str:
    """Return one row per measured level of every channel."""
    lines = [_HEADER]
    for name, curve in calibration.channels.items():
        for level in curve.levels:
            radiance, luminance = curve.radiance_at(level), curve.at(level, LUMINANCE)
            scotopic = curve.at(level, SCOTOPIC).value
            lines.append(
                f"{name},{level},{level / curve.top_level:.6f},{radiance.value:.6g},{radiance.u:.3g},"
                f"{luminance.value:.6g},{luminance.u:.3g},{scotopic:.6g},{int(curve.radiance_is_lost(level))}"
            )
    return "\n".join(lines) + "\n"


def to_inverse_csv(calibration: ScreenCalibration) -> str:
    """Return the level to show for 256 luminances from black to white of every channel, spaced in the square root."""
    lines = [_INVERSE_HEADER]
    for name, curve in calibration.channels.items():
        low, high = (curve.at(curve.levels[i], LUMINANCE).value for i in (0, -1))
        for root in np.linspace(np.sqrt(low), np.sqrt(high), _INVERSE_STEPS):
            target = float(np.clip(root**2, low, high))
            level = curve.level_for(target, LUMINANCE)
            shown = curve.at(level, LUMINANCE)
            lines.append(f"{name},{target:.6g},{level},{shown.value:.6g},{shown.u:.3g}")
    return "\n".join(lines) + "\n"


ENTRIES: Final = 256  # one per level of 8 bits, as graphics cards have
TARGET_GAMMA: Final = 2.2  # usual screens and ArgyllCMS's default


def correction(curve: ChannelCurve, gamma: float = TARGET_GAMMA, entries: int = ENTRIES) -> NDArray[np.float64]:
    """Return the drive 0..1 to be sent for each of `entries` evenly spaced inputs.

    With it the channel's light above its black is the input to the power γ.
    """
    table = curve.table
    low, high = float(table.values[0]), float(table.values[-1])
    target = low + (high - low) * np.linspace(0, 1, entries) ** gamma
    drive = np.array([table.level_of(float(w)) for w in target])
    drive[0], drive[-1] = curve.levels[0] / curve.top_level, curve.levels[-1] / curve.top_level
    return np.maximum.accumulate(drive)


def to_vcgt(calibration: ScreenCalibration) -> bytes:
    """Return the data of a `vcgt` tag: a table of 3 × 256 numbers of 16 bits, big-endian.

    Source: Apple's video card gamma tag: signature, 4 reserved bytes, type 0 (table), channels, entries, bytes.
    """
    head = struct.pack(">4sIIHHH", b"vcgt", 0, 0, 3, ENTRIES, 2)
    numbers: NDArray[Any] = np.rint(np.array([correction(one) for one in _curves(calibration)]) * 65535).astype(">u2")
    return head + numbers.tobytes()


def to_cal(calibration: ScreenCalibration) -> str:
    """Return ArgyllCMS's .cal text, which `dispwin` loads."""
    red, green, blue = (correction(one) for one in _curves(calibration))
    head = [
        "CAL    ",
        "",
        'DESCRIPTOR "Argyll Device Calibration State"',
        'ORIGINATOR "radiometer screen calibrate"',
        'DEVICE_CLASS "DISPLAY"',
        'COLOR_REP "RGB"',
        "",
        "NUMBER_OF_FIELDS 4",
        "BEGIN_DATA_FORMAT",
        "RGB_I RGB_R RGB_G RGB_B ",
        "END_DATA_FORMAT",
        "",
        f"NUMBER_OF_SETS {ENTRIES}",
        "BEGIN_DATA",
    ]
    inputs = np.linspace(0, 1, ENTRIES)
    rows = [f"{i:.7f} {r:.7f} {g:.7f} {b:.7f}" for i, r, g, b in zip(inputs, red, green, blue, strict=True)]
    return "\n".join([*head, *rows, "END_DATA"]) + "\n"


_PELLI_ZHANG = 4  # PsychoPy's number for a + (b + k·x)^γ
_EASY = 1  # PsychoPy's number for a + (b·x)^γ


def to_psychopy_json(calibration: ScreenCalibration) -> str:
    """Return the JSON that `psychopy.monitors.Monitor` loads.

    Rows of the gamma grid are grey, red, green and blue (grey replaces what was not measured), its columns
    least and greatest luminance, γ, a, b, k.

    Source: psychopy/monitors/calibTools.py (`gammaFun`, `_saveJSON`); arrays in the form of json_tricks.
    """
    curves = [calibration.channels.get(n, calibration.channel("grey")) for n in ("grey", "red", "green", "blue")]
    grid = np.array([_grid_row(curve) for curve in curves])
    when = moment_of(calibration.created)
    levels = sorted(set(curves[0].levels).intersection(*(c.levels for c in curves)))
    luminances = np.array([[c.at(n, LUMINANCE).value for n in levels] for c in curves])
    entry: dict[str, Any] = {
        "calibDate": when.timestamp(),
        "notes": f"radiometer {calibration.instrument}; {'; '.join(calibration.provenance.assumptions)}",
        "linearizeMethod": _PELLI_ZHANG if len(curves[0].levels) >= 4 else _EASY,
        "gamma": float(grid[0, 2]),
        "gammaGrid": _array(grid),
        "levelsPre": _array(np.array(levels, dtype=np.float64)),
        "lumsPre": _array(luminances),
        **dict.fromkeys(("levelsPost", "lumsPost", "dkl_rgb", "lms_rgb", "spectraNM", "spectraRGB")),
        **dict.fromkeys(("sizePix", "width", "distance")),
        "usebits": False,
    }
    return json_text({when.strftime("%Y_%m_%d %H:%M"): entry}, indent=2) + "\n"


def _grid_row(curve: ChannelCurve) -> list[float]:
    low, high = (curve.at(curve.levels[i], LUMINANCE).value for i in (0, -1))
    fits = curve.fits()
    if "pelli_zhang1991" not in fits:
        return [low, high, fits["gamma_offset"].parameters["gamma"], np.nan, np.nan, np.nan]
    found = fits["pelli_zhang1991"].parameters
    gamma, scale = found["gamma"], curve.efficacy(LUMINANCE)
    root = scale ** (1 / gamma)  # the fit is of the radiance; the grid is of the luminance
    return [low, high, gamma, found["alpha"] * scale, found["beta"] * root, found["kappa"] * root]


def _array(values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, Any]:
    """Return an array as json_tricks writes it."""
    return {"__ndarray__": values.tolist(), "dtype": "float64", "shape": list(values.shape), "Corder": True}


_PRIMARIES: Final = ("red", "green", "blue")
_ENTRIES: Final = 4096  # Little CMS takes 65,530 at most; 12 bits are more than screens show


def to_icc(calibration: ScreenCalibration) -> bytes:
    """Return the profile, of version 4: white, primaries and tone curves above black.

    Raises:
        CalibrationError: If a chromaticity is unknown or impossible, or a tone curve was not measured from end to end.
        MissingLibrary: If imagecodecs is not installed.

    Source: ICC.1:2022, three-component matrix-based profiles; cmsCreateRGBProfile of Little CMS.
    """
    check_profile(calibration.name, calibration.chromaticities)
    known = calibration.chromaticities
    curves = np.array([_tone_curve(curve) for curve in _curves(calibration)])
    content = _library().cms_profile(
        "rgb",
        whitepoint=known["grey"],
        primaries=[value for name in _PRIMARIES for value in known[name]],
        transferfunction=np.rint(curves * 65535).astype(np.uint16),
    )
    return bytes(content)


def check_profile(screen: str, chromaticities: Mapping[str, tuple[float, float]]) -> None:
    """Check that a screen's chromaticities make a profile. Raises CalibrationError, MissingLibrary."""
    unknown = [name for name in ("grey", *_PRIMARIES) if name not in chromaticities]
    if unknown:
        raise CalibrationError(
            f"screen {screen}: an ICC profile states chromaticities, and {', '.join(unknown)} has none. Measure them "
            "with a colorimeter and calibrate the screen with --chromaticities"
        )
    if np.any(_shares(chromaticities) <= 0.0):
        raise CalibrationError(
            f"screen {screen}: no light of red, green and blue together has the chromaticity of grey. Correct the "
            "chromaticities"
        )
    _library()


def profile_notes(calibration: ScreenCalibration) -> list[str]:
    """Return what the profile assumes and how well its tone curves are known, a line each."""
    u = max(_u_of_white(curve) for curve in _curves(calibration))
    assumed = [name for name in _PRIMARIES if name not in calibration.channels]
    return [
        f"ICC profile: it holds light above black, and no uncertainty. Its tone curves are within {200 * u:.2g} % of "
        "white (k = 2)",
        *([f"ICC profile: {', '.join(assumed)} was not measured and has the tone curve of grey"] if assumed else []),
        *_contradictions(calibration),
    ]


def _contradictions(calibration: ScreenCalibration) -> list[str]:
    """Return where the luminances that were measured contradict the chromaticities, a line each."""
    grey, lines = calibration.channel("grey"), []
    white = grey.at(grey.levels[-1], LUMINANCE)
    for name, share in zip(_PRIMARIES, _shares(calibration.chromaticities), strict=True):
        if name not in calibration.channels:
            continue
        curve = calibration.channel(name)
        shown = curve.at(curve.levels[-1], LUMINANCE)
        measured = shown.value / white.value
        expanded = 2 * measured * math.hypot(shown.u / shown.value, white.u / white.value)
        if abs(measured - share) > expanded:
            lines.append(
                f"ICC profile: the chromaticities give {name} {100 * share:.3g} % of the luminance of white, and "
                f"{with_u(100 * measured, 100 * expanded, '%', k=2)} was measured. Check chromaticities and spectra"
            )
    return lines


def _library() -> Any:
    return required_library("imagecodecs", "ICC profiles need imagecodecs: pip install 'radiometer[icc]'")


def _shares(chromaticities: Mapping[str, tuple[float, float]]) -> Array:
    """Return the shares of red, green and blue in the luminance of white, shape (3,); 0 if they make no white."""
    white, *primaries = (_xyz(chromaticities[name]) for name in ("grey", *_PRIMARIES))
    try:
        return np.asarray(np.linalg.solve(np.transpose(primaries), white), dtype=np.float64)
    except np.linalg.LinAlgError:  # two of the primaries are one, or all three are on one line
        return np.zeros(3)


def _xyz(xy: tuple[float, float]) -> tuple[float, float, float]:
    return xy[0] / xy[1], 1.0, (1.0 - xy[0] - xy[1]) / xy[1]


def _curves(calibration: ScreenCalibration) -> list[ChannelCurve]:
    """Return the curves of red, green and blue; grey replaces a primary that was not measured."""
    grey = calibration.channel("grey")
    return [calibration.channels.get(name, grey) for name in _PRIMARIES]


def _tone_curve(curve: ChannelCurve) -> NDArray[np.float64]:
    """Return the light above black as a share of white's, at evenly spaced levels. Raises CalibrationError."""
    black, white = curve.table.values[0], curve.table.values[-1]
    if (curve.levels[0], curve.levels[-1]) != (0, curve.top_level) or not white > black:
        raise CalibrationError(
            f"channel {curve.name}: rises from level {curve.levels[0]} to {curve.levels[-1]}; an ICC profile needs "
            f"levels 0 to {curve.top_level}. Calibrate the screen with both"
        )
    levels = np.linspace(0.0, 1.0, min(curve.top_level + 1, _ENTRIES))
    return np.asarray((curve.table.at(levels) - black) / (white - black), dtype=np.float64)


def _u_of_white(curve: ChannelCurve) -> float:
    """Return the largest standard uncertainty of the tone curve as a share of white; what all levels share cancels."""
    white = float(curve.table.values[-1])
    top = curve.u_shape_at(curve.levels[-1]) / white
    levels = np.linspace(curve.levels[0], curve.levels[-1], 256)
    return max(math.hypot(curve.u_shape_at(n) / white, top * float(curve.radiance_at(n).value) / white) for n in levels)


_COVERAGE: Final = 2.0
_DEEPEST: Final = 1e-6  # of white: where a plot's logarithmic axis ends for a black that is not known from 0
_COLOURS: Final = {"grey": "#333333", "red": "#c0392b", "green": "#27843f", "blue": "#2a5db0"}


def draw_curves(axes: Axes, calibration: ScreenCalibration) -> None:
    """Draw the luminance of every channel over the level, with its k = 2 band."""
    for name, curve in calibration.channels.items():
        shown = [curve.at(n, LUMINANCE) for n in curve.levels]
        values, u = np.array([one.value for one in shown]), np.array([one.u for one in shown])
        low = np.maximum(values - _COVERAGE * u, _DEEPEST * values.max())
        (line,) = axes.semilogy(curve.levels, np.maximum(values, low), "o-", ms=3, label=name, color=_COLOURS[name])
        axes.fill_between(curve.levels, low, values + _COVERAGE * u, color=line.get_color(), alpha=0.2, linewidth=0)
    dress(axes, "level (8 bits)", f"luminance in {unit_text(LUMINANCE)}, band k = 2")
    legend(axes, "lower right")


def to_page(calibration: ScreenCalibration) -> str:
    """Return the calibration as one self-contained page."""

    def draw(figure: Figure, narrow: bool) -> None:
        draw_curves(figure.subplots(), calibration)

    grey = calibration.channel("grey")
    white, black = (_number(grey, grey.levels[end], LUMINANCE, LUMINANCE) for end in (-1, 0))
    with_what = calibration.measured_with
    known = (("pixel distance", f"{calibration.pixel_mm:g} mm" if calibration.pixel_mm else ""),)
    xy = [(name, f"{x:.4f}", f"{y:.4f}") for name, (x, y) in calibration.chromaticities.items()]
    return page(
        f"Calibration of the screen {calibration.name}",
        f"White has {white}, black {black} (k = {_COVERAGE:g}).",
        [
            picture(draw, "Luminance over level; bands are k = 2.", (10.0, 5.0), (4.0, 4.2)),
            section("Checks", table((), list(checks_in_words(calibration.checks).items()), words=(1,))),
            section("Chromaticities (CIE 1931)", table(("channel", "x", "y"), xy)),
            *(folded(f"Levels of {name}", _levels(curve)) for name, curve in calibration.channels.items()),
            section("What was assumed", listed([f"{one}." for one in calibration.provenance.assumptions])),
        ],
        kind="Screen calibration",
        origin=Origin(
            moment(calibration.created),
            with_what.get("camera", ""),
            with_what.get("lens", ""),
            with_what.get("calibration", ""),
            protocol=calibration.provenance.method,
            further=known,
        ),
    )


def _levels(curve: ChannelCurve) -> str:
    rows = [(str(n), _number(curve, n, LUMINANCE), _number(curve, n, RADIANCE)) for n in curve.levels]
    head = ("level", f"luminance in {unit_text(LUMINANCE)} (k = 2)", f"radiance in {unit_text(RADIANCE)} (k = 2)")
    return table(head, rows)


def _number(curve: ChannelCurve, level: int, of: str, unit: str = "") -> str:
    """Return the quantity of a unit at a level ± U (k = 2), or its limit of detection, printed with the unit given."""
    if curve.radiance_is_lost(level):
        return below(curve.detection_limit * curve.efficacy(of), unit)
    found = curve.at(level, of)
    return with_u(found.value, _COVERAGE * found.u, unit)


# Kind on the command line: function, and ending of the file's name.
EXPORTS: Final[dict[str, tuple[Callable[[ScreenCalibration], str | bytes], str]]] = {
    "psychopy": (to_psychopy_json, ".json"),
    "ti3": (to_ti3, ".ti3"),
    "csv": (to_csv, ".csv"),
    "inverse": (to_inverse_csv, ".inverse.csv"),
    "vcgt": (to_vcgt, ".vcgt"),
    "cal": (to_cal, ".cal"),
    "icc": (to_icc, ".icc"),
    "page": (to_page, ".html"),
}
# What a form assumes and cannot hold itself, a line each.
NOTES: Final[dict[str, Callable[[ScreenCalibration], list[str]]]] = {"icc": profile_notes}


def write_export(calibration: ScreenCalibration, kind: str, path: Path) -> None:
    """Write one of `EXPORTS`. Raises UsageError if there is no such kind; OutputError if the file cannot be written."""
    if kind not in EXPORTS:
        raise UsageError(f"export {kind!r} is unknown; choose from {', '.join(EXPORTS)}")
    content = EXPORTS[kind][0](calibration)
    if isinstance(content, bytes):
        write_bytes_atomic(path, content)
    else:
        write_text_atomic(path, content)


__all__ = ["EXPORTS", "NOTES", "write_export"]

"""Files of a screen calibration that other programs read."""

from __future__ import annotations

import struct
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.json_text import json_text
from radiometer.moments import moment_of
from radiometer.screen.calibration import LUMINANCE, SCOTOPIC, ChannelCurve, ScreenCalibration

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


_RGB = {"grey": (1, 1, 1), "red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1)}


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
    curve, mask = calibration.channel(name), _RGB[name]
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


def _channels(calibration: ScreenCalibration) -> list[NDArray[np.float64]]:
    """Return the tables of red, green and blue; grey replaces a primary that was not measured."""
    grey = calibration.channel("grey")
    return [correction(calibration.channels.get(n, grey)) for n in ("red", "green", "blue")]


def to_vcgt(calibration: ScreenCalibration) -> bytes:
    """Return the data of a `vcgt` tag: a table of 3 × 256 numbers of 16 bits, big-endian.

    Source: Apple's video card gamma tag: signature, 4 reserved bytes, type 0 (table), channels, entries, bytes.
    """
    head = struct.pack(">4sIIHHH", b"vcgt", 0, 0, 3, ENTRIES, 2)
    numbers: NDArray[Any] = np.rint(np.array(_channels(calibration)) * 65535).astype(">u2")
    return head + numbers.tobytes()


def to_cal(calibration: ScreenCalibration) -> str:
    """Return ArgyllCMS's .cal text, which `dispwin` loads."""
    red, green, blue = _channels(calibration)
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
        "levelsPost": None,
        "lumsPost": None,
        "dkl_rgb": None,
        "lms_rgb": None,
        "spectraNM": None,
        "spectraRGB": None,
        "sizePix": None,
        "width": None,
        "distance": None,
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

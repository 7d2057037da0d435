"""ArgyllCMS measurement file (.ti3, a CGATS form): drive in percent against XYZ with white at Y = 100."""

from __future__ import annotations

from radiometer.moments import moment_of
from radiometer.screen.calibration import LUMINANCE, ScreenCalibration
from radiometer.screen.exports.chromaticity import assumption_of, xyz_of

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

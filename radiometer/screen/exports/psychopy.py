"""PsychoPy's monitor file: put it into the folder `monitors` of PsychoPy's user folder."""

from __future__ import annotations

from typing import Any

import numpy as np

from radiometer.data.json_text import json_text
from radiometer.moments import moment_of
from radiometer.screen.calibration import LUMINANCE, ChannelCurve, ScreenCalibration

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

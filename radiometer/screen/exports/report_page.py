"""The page of a screen's calibration: curves, what was measured, and what it was measured with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.numbers import below, unit_text, with_u
from radiometer.reporting.origin import Origin, moment
from radiometer.reporting.page import folded, listed, page, section, table
from radiometer.reporting.pictures import dress, legend, picture
from radiometer.screen.calibration import LUMINANCE, RADIANCE, ChannelCurve, ScreenCalibration
from radiometer.screen.checks import checks_in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    white, black = (_shown(grey, grey.levels[end], LUMINANCE) for end in (-1, 0))
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


def _shown(curve: ChannelCurve, level: int, unit: str) -> str:
    """Return the value at a level with U (k = 2) and its unit, or its limit of detection."""
    return _number(curve, level, unit, unit)


def _number(curve: ChannelCurve, level: int, of: str, unit: str = "") -> str:
    """Return the quantity of a unit at a level, printed with the unit given."""
    if curve.radiance_is_lost(level):
        return below(curve.detection_limit * curve.efficacy(of), unit)
    found = curve.at(level, of)
    return with_u(found.value, _COVERAGE * found.u, unit)

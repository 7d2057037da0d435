"""The taps of a sensor as rows of a table, as JSON and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from radiometer.analysis.characterise.taps import TapFigures
from radiometer.data import Quantity
from radiometer.numbers import with_u
from radiometer.reporting.page import section, table
from radiometer.reporting.pictures import dress, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEADINGS: Final = (
    "tap",
    "x, y, width, height",
    "K",
    "black",
    "read noise",
    "saturation",
    "linearity error",
    "overscan",
)
_DRAWN: Final = {"K": "K in DN/e⁻", "mu_y_dark": "black in DN", "sigma_d": "read noise in e⁻"}
_SYMBOLS: Final = ("K", "mu_y_dark", "sigma_d", "mu_e_sat", "LE_max")


def tap_rows(taps: Sequence[TapFigures]) -> list[tuple[str, ...]]:
    """Return a row of `HEADINGS` per tap; every ± is an expanded uncertainty, k = 2."""
    return [
        (
            one.tap.name,
            f"{one.tap.x}, {one.tap.y}, {one.tap.width}, {one.tap.height}",
            *(_printed(_figure(one, symbol)) for symbol in _SYMBOLS),
            _printed(one.overscan),
        )
        for one in taps
    ]


def tap_mappings(taps: Sequence[TapFigures]) -> list[dict[str, Any]]:
    """Return the figures of each tap as plain values."""
    return [
        {
            "name": one.tap.name,
            "figures": {} if one.characterisation is None else one.characterisation.to_mapping()["emva1288"]["figures"],
            **({"overscan": {"value": one.overscan.value, "u": one.overscan.u, "unit": "DN"}} if one.overscan else {}),
            **({"why_not": one.why_not} if one.why_not else {}),
        }
        for one in taps
    ]


def tap_section(taps: Sequence[TapFigures]) -> str:
    """Return the part of the report on taps; empty where there are none."""
    if not taps:
        return ""
    drawn = picture(
        lambda figure, narrow: _draw(figure, taps, narrow=narrow),
        "Gain, black level and read noise of every tap; bars are k = 2.",
        (10.0, 3.2),
        (4.0, 7.5),
    )
    return section("Taps", drawn, table(HEADINGS, tap_rows(taps), words=(0, 1)))


def _draw(figure: Figure, taps: Sequence[TapFigures], *, narrow: bool) -> None:
    panels = figure.subplots(*((3, 1) if narrow else (1, 3)))
    for axes, (symbol, name) in zip(panels, _DRAWN.items(), strict=True):
        known = [(number, q) for number, one in enumerate(taps) if (q := _figure(one, symbol)) is not None]
        figures = [q for _, q in known]
        axes.errorbar([n for n, _ in known], [q.value for q in figures], [2 * q.u for q in figures], fmt="o", capsize=3)
        axes.set_xticks(range(len(taps)), [one.tap.name for one in taps])
        dress(axes, "tap", name)
        axes.ticklabel_format(axis="y", useOffset=False)


def _figure(one: TapFigures, symbol: str) -> Quantity | None:
    return None if one.characterisation is None else one.characterisation.figures.get(symbol)


def _printed(quantity: Quantity | None) -> str:
    return "" if quantity is None else with_u(quantity.value, 2 * quantity.u, quantity.unit)

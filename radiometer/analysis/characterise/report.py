"""A one-page datasheet of a characterisation in HTML that needs no other file."""

from __future__ import annotations

import html
import math

from radiometer.analysis.characterise.report_plots import plots
from radiometer.analysis.characterise.result import Characterisation
from radiometer.analysis.characterise.symbols import SYMBOLS
from radiometer.data import Quantity

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222}
h1{font-size:1.5rem;margin-bottom:.2rem} .sub{color:#555;margin-top:0} p.made{color:#555;margin-top:1.5rem}
table{border-collapse:collapse;margin:1rem 0} td,th{padding:.2rem .8rem;border-bottom:1px solid #ddd;text-align:left}
td.n{text-align:right;font-variant-numeric:tabular-nums} .plots{display:grid;grid-template-columns:repeat(auto-fit,
minmax(24rem,1fr));gap:1rem} figure{margin:0} figcaption{color:#555;font-size:.9rem} svg{max-width:100%;height:auto}
.note{background:#fff6dd;border-left:4px solid #e0b000;padding:.4rem .8rem;margin:.4rem 0}
"""


def datasheet(result: Characterisation) -> str:
    """Return the datasheet as one HTML page: figures with k = 2 uncertainty, notes, plots, provenance."""
    camera = result.believed
    name = " ".join(part for part in (camera.vendor, camera.model) if part) or "Camera"
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'>",
        f"<title>{html.escape(name)}: EMVA 1288 figures</title><style>{_STYLE}</style>",
        f"<h1>{html.escape(name)}</h1>",
        f"<p class='sub'>serial {html.escape(camera.serial or 'unknown')}, {camera.bit_depth} bit, gain "
        f"{result.gain_db:g} dB; EMVA 1288 release 4.0 (linear); saturation is set by the {result.limited_by}</p>",
        *(f"<p class='note'>{html.escape(note)}</p>" for note in result.notes),
        _table(result),
        _gains(result),
        "<div class='plots'>",
        *(f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>" for caption, svg in plots(result)),
        "</div>",
        f"<p class='made'>Made {html.escape(result.provenance.created)} by {html.escape(result.provenance.software)} "
        f"from {html.escape(', '.join(result.provenance.inputs))}.</p></html>",
    ]
    return "\n".join(parts)


def rounded(quantity: Quantity) -> tuple[str, str]:
    """Return value and expanded uncertainty (k = 2), both to two digits of the uncertainty."""
    expanded = 2 * quantity.u
    if not (math.isfinite(expanded) and expanded > 0 and math.isfinite(quantity.value)):
        return f"{quantity.value:.5g}", "–"
    decimals = max(0, 1 - math.floor(math.log10(expanded)))
    return f"{quantity.value:.{decimals}f}", f"{expanded:.{decimals}f}"


def _table(result: Characterisation) -> str:
    rows = []
    for key, symbol in SYMBOLS.items():
        if key in result.figures:
            value, expanded = rounded(result.figures[key])
            unit = "" if result.figures[key].unit == "1" else result.figures[key].unit
            rows.append(
                f"<tr><td>{_subscripted(symbol.sign)}</td><td>{symbol.meaning}</td><td class='n'>{value}</td>"
                f"<td class='n'>± {expanded}</td><td>{html.escape(unit)}</td></tr>"
            )
    head = "<tr><th>symbol</th><th>figure</th><th>value</th><th>U (k = 2)</th><th>unit</th></tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def _subscripted(sign: str) -> str:
    stem, _, below = sign.partition("_")
    return f"{stem}<sub>{below}</sub>" if below else stem


def _gains(result: Characterisation) -> str:
    if len(result.gains) < 2:
        return ""
    rows = []
    for gain_db, K in result.gains.items():
        value, expanded = rounded(K)
        rows.append(
            f"<tr><td class='n'>{gain_db:g} dB</td><td class='n'>{value}</td><td class='n'>± {expanded}</td></tr>"
        )
    head = "<tr><th>gain</th><th>K in DN/e⁻</th><th>U (k = 2)</th></tr>"
    return f"<h2>Overall system gain by gain</h2><table>{head}{''.join(rows)}</table>"

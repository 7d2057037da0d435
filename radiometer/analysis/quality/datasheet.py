"""The datasheet as one HTML page that needs nothing else."""

from __future__ import annotations

import base64
import html
import io
from pathlib import Path
from typing import Final

from radiometer.analysis.quality.indices import Figure
from radiometer.analysis.quality.session import Datasheet, Index
from radiometer.analysis.uncertainty.budget import coverage_factor
from radiometer.data.storage import write_text_atomic

_STYLE: Final = """
:root{color-scheme:light}
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a;background:#fff}
h1{font-size:1.2rem;font-weight:500;color:#555;margin:0}h2{margin:2rem 0 .3rem;font-size:1.2rem}
.said{font-size:1.5rem;font-weight:650;line-height:1.3;margin:.2rem 0 .6rem}
img{max-width:100%;height:auto;display:block}.small{color:#595959;font-size:.9rem}
.index{border-top:1px solid #ddd;padding:.7rem 0;break-inside:avoid}
.value{font-size:1.25rem;font-weight:600;font-variant-numeric:tabular-nums}.symbol{color:#1f618d;margin-right:.6rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}
td,th{padding:.1rem .8rem .1rem 0;text-align:right}td:first-child,th:first-child{text-align:left}
.wide{overflow-x:auto}summary{cursor:pointer;padding:.4rem 0}
"""


def write_datasheet(path: Path, sheet: Datasheet) -> None:
    """Write the datasheet.

    Args:
        path: File to write.
        sheet: What was found.

    Raises:
        OutputError: If the file cannot be written.
    """
    write_text_atomic(path, datasheet_html(sheet))


def datasheet_html(sheet: Datasheet) -> str:
    """Return the datasheet as HTML: the outcome, a picture, each index with its definition, what is missing last."""
    camera = sheet.camera
    who = " ".join(word for word in (camera.vendor, camera.model, camera.serial) if word) if camera else "camera"
    measured = [one for one in sheet.indices if one.figure is not None]
    missing = [one for one in sheet.indices if one.figure is None]
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width,initial-scale=1'>"
        f"<title>Datasheet {html.escape(who)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{html.escape(', '.join(word for word in (who, sheet.lens, sheet.created[:10]) if word))}</h1>",
        f"<p class='said'>{html.escape(_sentence(measured, len(sheet.indices)))}</p>",
        _picture(measured),
        *[_measured(one) for one in measured],
        _missing(missing),
        "<h2>What was assumed</h2>",
        "".join(f"<p class='small'>{html.escape(one)}.</p>" for one in sheet.assumptions),
    ]
    return "\n".join(part for part in parts if part) + "\n</body></html>\n"


def shown(figure: Figure) -> tuple[str, str]:
    """Return (value, expanded uncertainty) with their unit, as many digits as u allows."""
    scale, unit = (1.0, "px") if figure.unit == "px" else (100.0, "%")
    expanded = scale * coverage_factor(figure.degrees_of_freedom) * figure.u
    decimals = _decimals(expanded)
    return f"{scale * figure.value:.{decimals}f} {unit}", f"{expanded:.2g} {unit}"


def _decimals(expanded: float) -> int:
    import math

    return min(max(1 - math.floor(math.log10(expanded)), 0), 6) if expanded > 0.0 else 3


def _sentence(measured: list[Index], total: int) -> str:
    """Return the outcome in one sentence: how many, and which counts most."""
    shares = [(one, one.figure.value) for one in measured if one.figure and one.figure.unit == "1"]
    if not shares:
        return f"{len(measured)} of {total} indices measured."
    worst, _ = max((pair for pair in shares), key=lambda pair: pair[1])
    assert worst.figure is not None
    value, expanded = shown(worst.figure)
    title, symbol = worst.procedure.title, worst.procedure.symbol
    named = title if symbol == title else f"{title} ({symbol})"
    return f"{len(measured)} of {total} indices measured; the largest is {named}: {value} ± {expanded}."


def _measured(one: Index) -> str:
    assert one.figure is not None
    value, expanded = shown(one.figure)
    rows = "".join(
        f"<tr><td>{html.escape(each.label)}</td><td>{_detail(each.value)}</td><td>± {_detail(each.expanded)}</td></tr>"
        for each in one.figure.details
    )
    details = f"<details><summary>details</summary><div class='wide'><table>{rows}</table></div></details>"
    remarks = "; ".join(one.figure.remarks)
    steps = f"Captures: {', '.join(one.steps)}. " if one.steps else ""
    return (
        f"<section class='index'><div class='value'><span class='symbol'>{html.escape(one.procedure.symbol)}</span>"
        f"{value} <span class='small'>± {expanded}</span></div><div>{html.escape(one.procedure.title)}</div>"
        f"<div class='small'>{html.escape(one.procedure.definition)} ({html.escape(one.procedure.source)}). "
        f"{html.escape(steps)}{html.escape(remarks)}</div>{details if rows else ''}</section>"
    )


def _detail(value: float) -> str:
    return f"{value:.3g}" if abs(value) >= 1.0 else f"{100 * value:.3g} %"


def _missing(missing: list[Index]) -> str:
    if not missing:
        return ""
    rows = "".join(
        f"<li><b>{html.escape(one.procedure.symbol)}</b> {html.escape(one.procedure.title)}: {html.escape(one.reason)}"
        f"{_asked(one)}</li>"
        for one in missing
    )
    return f"<h2>Not measured</h2><ul>{rows}</ul>"


def _asked(one: Index) -> str:
    if not one.procedure.steps:
        return ""
    steps = "; ".join(f"{step.name}: {step.ask}" for step in one.procedure.steps)
    return f"<div class='small'>{html.escape(steps)}</div>"


def _picture(measured: list[Index]) -> str:
    """Return bars of the relative indices with their uncertainty, on a logarithmic scale."""
    shares = [(one.procedure, one.figure) for one in measured if one.figure and one.figure.unit == "1"]
    if not shares:
        return ""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(8, 0.45 * len(shares) + 1.0), layout="constrained")
    axes = canvas.add_subplot()
    for place, (procedure, figure) in enumerate(reversed(shares)):
        expanded = 100 * coverage_factor(figure.degrees_of_freedom) * figure.u
        low, high = max(100 * figure.value - expanded, 1e-3), max(100 * figure.value + expanded, 1.1e-3)
        axes.plot([low, high], [place, place], lw=6, color="#9dc3dd", solid_capstyle="butt")
        axes.plot(max(100 * figure.value, 1e-3), place, "o", ms=6, color="#1f4e79")
        axes.text(high * 1.15, place, f"{procedure.symbol}: {shown(figure)[0]}", va="center", fontsize=9)
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    axes.set_xlim(low, high * 8)
    axes.set_ylim(-0.7, len(shares) - 0.3)
    axes.set_yticks([])
    axes.set_xlabel("deviation of the reading in % (bar: 95.45 %; left of the axis 0.001 %)")
    axes.spines[["top", "right", "left"]].set_visible(False)
    buffer = io.BytesIO()
    canvas.savefig(buffer, format="png", dpi=110)
    said = "; ".join(f"{p.symbol} {shown(f)[0]} ± {shown(f)[1]}" for p, f in shares)
    encoded = base64.b64encode(buffer.getvalue()).decode()
    return f"<figure><img alt='{html.escape(said)}' src='data:image/png;base64,{encoded}'></figure>"

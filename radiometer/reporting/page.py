"""The skeleton of every HTML report: the outcome in a sentence, one picture, what it means, what to do, tables last.

What is handed over is plain text and is escaped here; only what these functions return is HTML. A page holds no script
and loads nothing, and says so to the browser, which then refuses both.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from typing import Final

from radiometer.reporting.origin import Origin

_POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
# Every colour of text has a contrast of 4.5 or more on what is behind it (WCAG 2.1, 1.4.3).
_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d( \d\d:\d\d)?")  # no line ends within it
_MANY_COLUMNS: Final = 4  # a table of so many has no room on a phone: its rows become blocks of names and values
_MOST_UNBROKEN: Final = (
    6  # columns of figures that fit a line of text whole; of more, a line may end before ± or a unit
)
STYLE: Final = "\n".join(
    (
        ":root{color-scheme:light}*{box-sizing:border-box}",
        'body{font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans",sans-serif;',
        "max-width:62rem;margin:1.6rem auto;padding:0 1rem;color:#1a1a1a;background:#fff;overflow-wrap:break-word}",
        "h1{font-size:1.05rem;font-weight:500;color:#555;margin:0}h2{margin:2.2rem 0 .4rem;font-size:1.25rem;",
        "line-height:1.3}",
        "p,ul{margin:.5rem 0}ul{padding-left:1.2rem}li{margin:.3rem 0}",
        ".outcome{font-size:clamp(1.3rem,1rem + 1.6vw,1.8rem);font-weight:650;line-height:1.28;margin:.25rem 0 .6rem;",
        "text-wrap:balance}.keep{white-space:nowrap}",
        ".outcome+p{color:#404040}",
        ".origin{display:flex;flex-wrap:wrap;gap:.1rem 1.1rem;margin:.2rem 0 .8rem;color:#404040;font-size:.85rem}",
        ".origin div{display:flex;gap:.35rem;min-width:0}.origin dt{color:#555}.origin dt,.origin dd{margin:0}",
        ".origin dd{font-weight:600;overflow-wrap:anywhere}",
        "figure{margin:1rem 0}img{max-width:100%;height:auto;display:block;margin:0 auto}",
        "figcaption,.small{color:#555;font-size:.9rem}",
        ".what{font-size:1.08rem}",
        ".do{border-left:4px solid #1f618d;background:#eef4f8;padding:.55rem .9rem;margin:.8rem 0}",
        ".flag{border-left:4px solid #9a6700;background:#fff6dd;padding:.45rem .9rem;margin:.5rem 0}",
        ".tag{font-size:.8rem;font-weight:600;white-space:nowrap;border-radius:.6rem;padding:.1rem .6rem;",
        "background:#fbe9d0;",
        "color:#6b3d00;margin-left:.5rem}",
        ".wide{overflow-x:auto}table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums}",
        "td,th{padding:.25rem .9rem .25rem 0;text-align:right;border-bottom:1px solid #ddd;vertical-align:baseline}",
        "td:first-child,th:first-child,td.words,th.words{text-align:left}th{font-weight:600;color:#444}",
        ".many td,.many th{padding-right:.5rem}.packed td:not(:first-child,.words){white-space:normal}",
        "td.words{overflow-wrap:anywhere}td.words:not(:first-child){min-width:7.5rem}td:not(:first-child,.words){white-space:nowrap}td:last-child,th:last-child{padding-right:.2rem}",
        "details{margin:.7rem 0;border-top:1px solid #ddd;padding-top:.5rem}",
        "summary{cursor:pointer;font-weight:600;min-height:2.75rem;display:list-item;padding:.5rem 0}",
        "summary:focus-visible{outline:2px solid #1f618d;outline-offset:2px}",
        ".side{display:grid;gap:0 1.2rem;grid-template-columns:repeat(auto-fit,minmax(min(100%,26rem),1fr))}",
        "@media (max-width:640px){table{font-size:.84rem}td,th{padding-right:.4rem}",
        ".many,.many tbody,.many tr{display:block}.many thead{display:none}",
        ".many tr{padding:.35rem 0;border-bottom:1px solid #ddd}",
        ".many td{display:flex;justify-content:space-between;gap:1rem;border:0;padding:.1rem .2rem .1rem 0;",
        "text-align:right;min-width:0}td:not(:first-child,.words){white-space:normal}",
        ".many td:first-child{font-weight:600;overflow-wrap:anywhere;text-align:left}.many td:empty{display:none}",
        ".many td::before{content:attr(data-head);color:#555;text-align:left;font-weight:400;flex:0 1 auto;",
        "overflow-wrap:anywhere;min-width:4.5rem}",
        ".many td[data-head='']::before{content:none}}",
        "@media print{@page{margin:14mm}body{font-size:11pt;margin:0;max-width:none;padding:0}h2{break-after:avoid}",
        "figure,.do,.flag,tr{break-inside:avoid}.do,.flag{background:none}.wide{overflow:visible}",
        "summary{min-height:0}",
        "details::details-content{content-visibility:visible;height:auto}}",
    )
)


def page(subject: str, outcome: str, parts: Iterable[str], *, kind: str, origin: Origin) -> str:
    """Return a whole page.

    Args:
        subject: What the report is about, such as the camera's name.
        outcome: What was found, in a sentence.
        parts: HTML from the functions of this module, in order; empty ones are left out.
        kind: Kind of report, for the title of the window.
        origin: What its data come from.
    """
    head = (
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        "<meta name='viewport' content='width=device-width,initial-scale=1'>"
        f"<title>{escaped(kind)}: {escaped(subject)}</title><style>{STYLE}</style></head><body><main>"
    )
    found = _DATE.sub(r"<span class='keep'>\g<0></span>", prose(outcome))
    opening = f"<h1>{escaped(subject)}</h1><p class='outcome'>{found}</p>"
    facts = "".join(f"<div><dt>{escaped(name)}</dt><dd>{escaped(value)}</dd></div>" for name, value in origin.rows)
    body = (f"<dl class='origin'>{facts}</dl>", *(part for part in parts if part))
    return "\n".join((head, opening, *body, "</main></body></html>\n"))


def escaped(text: str) -> str:
    """Return text as HTML that shows just this text; what no page may hold is shown as a replacement character."""
    return html.escape("".join(c if c.isprintable() or c in "\n\t\u00a0" else "\ufffd" for c in text))


def prose(text: str) -> str:
    """Return running text as HTML: signs as printed, and a number stays with its ±, its % and a short unit."""
    text = re.sub(r"(?<![\w.,-])-(?=\d)", "\u2212", text)
    text = re.sub(r"\be-(?!\w)", "e⁻", text)
    kept = escaped(text).replace(" %", "\u00a0%").replace("± ", "±\u00a0").replace(" ±", "\u00a0±")
    kept = re.sub(r"(&[lg]t;) (?=\d)", "\\1\u00a0", kept)
    kept = re.sub(r"(±\u00a0[\d.]+) (?=(?:K|s|ms|nm|DN|°C)\b)", "\\1\u00a0", kept)
    return kept.replace("k = ", "k\u00a0=\u00a0")


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph; kind is "do" (what to do), "flag" (what to mind), "what", "small" or nothing."""
    marked = f" class='{kind}'" if kind else ""
    return f"<p{marked}>{prose(text)}</p>" if text else ""


def heading(text: str, tags: Sequence[str] = ()) -> str:
    """Return the heading of a section, with marks behind it."""
    marks = "".join(f"<span class='tag'>{escaped(tag)}</span>" for tag in tags)
    return f"<h2>{escaped(text)}{marks}</h2>"


def listed(texts: Sequence[str]) -> str:
    """Return a list; nothing where there is nothing to list."""
    return f"<ul>{''.join(f'<li>{prose(text)}</li>' for text in texts)}</ul>" if texts else ""


def section(title: str, *content: str) -> str:
    """Return a heading and what belongs to it; nothing where nothing does."""
    filled = [part for part in content if part]
    return "\n".join((heading(title), *filled)) if filled else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, words: Sequence[int] = ()) -> str:
    """Return a table, on a phone with a block for each row where it has many columns; nothing where it has no rows.

    Args:
        head: What stands over the columns; empty for none.
        rows: Texts; the first column is of words, the others of numbers.
        words: Further columns of words.
    """
    many, packed = len(head) >= _MANY_COLUMNS, len(head) > _MOST_UNBROKEN

    def line(cells: Sequence[str], name: str) -> str:
        kinds = [" class='words'" if number in words else "" for number in range(len(cells))]
        heads = [f' data-head="{escaped(one)}"' if many and name == "td" else "" for one in head or cells]
        shown = [prose(cell).replace("\u00a0±", " ±") if packed else prose(cell) for cell in cells]
        parts = zip(kinds, heads, shown, strict=True)
        return "".join(f"<{name}{kind}{of_head}>{cell}</{name}>" for kind, of_head, cell in parts)

    body = "".join(f"<tr>{line(row, 'td')}</tr>" for row in rows)
    top = f"<thead><tr>{line(head, 'th')}</tr></thead>" if head else ""
    kind = f" class='many{' packed' if packed else ''}'" if many else ""
    return f"<div class='wide'><table{kind}>{top}<tbody>{body}</tbody></table></div>" if body else ""


def side_by_side(*figures: str) -> str:
    """Return figures side by side where there is room."""
    return f"<div class='side'>{''.join(figures)}</div>" if any(figures) else ""


def folded(title: str, *content: str) -> str:
    """Return what is shown on demand (and in print); nothing where there is no content."""
    filled = "\n".join(part for part in content if part)
    return f"<details><summary>{escaped(title)}</summary>{filled}</details>" if filled else ""

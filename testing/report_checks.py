"""What holds of every HTML report, seen in Chromium at the width of a phone and of a desk."""

from __future__ import annotations

import json
from pathlib import Path

from testing.chromium import headless

# A name that must neither become markup, nor a formula, nor end a line.
HOSTILE = "<script>alert(1)</script>\" onload='x' $\\frac$ \x1b[31m 灯 --> &amp;"

WIDTHS = (390, 1280, 1440)


def low_contrasts(passed_by: str = "#none", large: float = 4.5) -> str:
    """Return JavaScript that lists the shown texts whose contrast with what lies behind is too low (WCAG 2.1, 1.4.3).

    Args:
        passed_by: Selector of what is switched off, or is no text.
        large: Least ratio of letters of 24 pixels, or bold ones of 18.66.
    """
    return f"""
(() => {{
  const parse = (c) => {{ const m = c.match(/[\\d.]+/g).map(Number); return m.length === 3 ? [...m, 1] : m; }};
  const lin = (v) => (v / 255 <= 0.03928 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4);
  const lum = ([r, g, b]) => 0.2126 * lin(r) + 0.7152 * lin(g) + 0.0722 * lin(b);
  const over = (top, under) => top.slice(0, 3).map((v, i) => v * top[3] + under[i] * (1 - top[3]));
  const behind = (e) => {{
    const layers = [];
    for (let n = e; n; n = n.parentElement) layers.unshift(parse(getComputedStyle(n).backgroundColor));
    return layers.reduce((under, top) => over(top, under), [255, 255, 255]);
  }};
  const low = [];
  for (const e of document.querySelectorAll("body *")) {{
    const text = [...e.childNodes].filter((n) => n.nodeType === 3).map((n) => n.data.trim()).join("");
    const style = getComputedStyle(e);
    if (!text || !e.getBoundingClientRect().width || e.closest("{passed_by}")) continue;
    const ground = behind(e), a = lum(over(parse(style.color), ground)), b = lum(ground);
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), size = parseFloat(style.fontSize);
    const least = size >= 24 || (size >= 18.66 && +style.fontWeight >= 700) ? {large} : 4.5;
    if (ratio < least) low.push([text.slice(0, 40), ratio]);
  }}
  return JSON.stringify(low);
}})()"""


_CUT_TABLES = """
JSON.stringify([...document.querySelectorAll(".wide")].filter((e) => e.scrollWidth > e.clientWidth + 1)
  .map((e) => e.textContent.slice(0, 60)))"""
# What ± covers stands in the same sentence.
_BARE_OUTCOME = """
(() => { const t = document.querySelector(".outcome").textContent;
  return t.includes("±") && !/k\\s=|95\\s%/.test(t); })()"""
_BROKEN_PICTURES = "[...document.images].filter((i) => !i.complete || !i.naturalWidth).length"


async def assert_reports_hold(pages: dict[str, str], folder: Path) -> None:
    """Show each page at both widths and refuse what no report may do.

    Args:
        pages: HTML by a name for messages.
        folder: Where the pages and the browser's profile may lie.
    """
    async with headless(folder / "profile") as browser:
        for number, (name, content) in enumerate(pages.items()):
            path = folder / f"report-{number}.html"
            path.write_text(content, encoding="utf-8")
            for width in WIDTHS:
                phone = width < 700
                await browser.command(
                    "Emulation.setDeviceMetricsOverride", width=width, height=844, deviceScaleFactor=1, mobile=phone
                )
                await browser.command("Page.navigate", url=path.as_uri())
                await browser.wait_for(f"document.readyState === 'complete' && location.href === '{path.as_uri()}'")
                await browser.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
                await browser.wait_for(f"{_BROKEN_PICTURES} === 0")
                assert await browser.evaluate("document.documentElement.scrollWidth <= innerWidth"), (name, width)
                assert json.loads(await browser.evaluate(low_contrasts())) == [], (name, width)
                assert not await browser.evaluate(_BARE_OUTCOME), name
                assert await browser.evaluate(_CUT_TABLES) == "[]", (name, width)
                chosen = await browser.evaluate("document.images[0].currentSrc === document.images[0].src")
                assert chosen is not phone, name  # the narrow form on a phone, the wide one elsewhere
                first = await browser.evaluate("document.images[0].getBoundingClientRect().top")
                assert 0 < first < 844, (name, width)  # the picture begins on the first screen
        assert browser.errors == []
        assert [url for url in browser.requested if not url.startswith(("file:", "data:", "about:"))] == []

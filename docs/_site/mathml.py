"""Turn formulas into MathML while the site is built, so that a browser shows them without any script."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

_INLINE = re.compile(r'<span class="arithmatex">\\\((.+?)\\\)</span>', re.DOTALL)
_BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.+?)\\\]\s*</div>', re.DOTALL)


def on_page_content(page_html: str, **_: Any) -> str:
    """Return a page with its formulas as MathML."""
    page_html = _BLOCK.sub(lambda found: convert(html.unescape(found[1].strip()), display="block"), page_html)
    return _INLINE.sub(lambda found: convert(html.unescape(found[1].strip())), page_html)

"""Link the first use of each term of the glossary on a page, with its meaning as a tooltip.

A page that links to a section of the glossary uses the terms of that section in their defined sense. Each of them is
then linked where it first occurs in running text. A link that a page has already is pointed at its term.
"""

from __future__ import annotations

import html
import re
from functools import cache
from pathlib import Path
from typing import Any

from mkdocs.utils import get_relative_url

_GLOSSARY = Path(__file__).resolve().parents[1] / "glossary.md"
_ROW = re.compile(r"^\| (?!term \||-)(.+?) \| (.+?) \|$")
_TAG = re.compile(r"(<[^>]+>)")
_LINK = re.compile(r'<a href="[^"]*glossary\.html#([\w-]+)"[^>]*>([^<]+)</a>')
# Text in these is no running text, or is a link already.
_SKIPPED = {"a", "code", "pre", "math", "script", "style", "button", "h1", "h2", "h3", "h4", "th"}


@cache
def _terms() -> dict[str, tuple[str, str]]:
    """Return section and meaning of each term, the longest terms first."""
    found: dict[str, tuple[str, str]] = {}
    section = ""
    for line in _GLOSSARY.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            section = line[3:].lower().replace(" ", "-")
        elif row := _ROW.match(line):
            found[re.sub(r" \*?\(?[\w]+\)?\*?$", "", row[1]) if re.search(r"[*(]", row[1]) else row[1]] = (
                section,
                row[2],
            )
    return dict(sorted(found.items(), key=lambda entry: -len(entry[0])))


def on_page_content(page_html: str, page: Any, **_: Any) -> str:
    """Return a page with its terms linked; the glossary itself with a target at each term."""
    if page.file.src_uri == "glossary.md":
        for term in _terms():
            page_html = re.sub(
                rf"<tr>(\s*<td>{re.escape(term)}\b)", rf'<tr id="{_anchor(term)}">\1', page_html, count=1
            )
        return page_html
    sections = {section for section, _ in _LINK.findall(page_html)}
    to = get_relative_url("glossary.html", page.url)
    left = [term for term, (section, _) in _terms().items() if section in sections]

    def point(found: re.Match[str]) -> str:
        term = next((one for one in left if _pattern(one).fullmatch(found[2])), None)
        if term is None:
            return found[0]
        left.remove(term)
        return _linked(found[2], term, to)

    pieces, open_tags = _TAG.split(_LINK.sub(point, page_html)), list[str]()
    for at, piece in enumerate(pieces):
        if piece.startswith("<"):
            _follow(piece, open_tags)
        elif not open_tags and piece.strip():
            pieces[at] = _with_links(piece, left, to)
    return "".join(pieces)


def _follow(tag: str, open_tags: list[str]) -> None:
    name = re.match(r"</?(\w+)", tag)
    if name is None or name[1] not in _SKIPPED:
        return
    if not tag.startswith("</"):
        open_tags.append(name[1])
    elif open_tags:
        open_tags.pop()


def _with_links(text: str, left: list[str], to: str) -> str:
    """Return a text with the first use of each term that has none yet linked; linked terms leave the list."""
    parts = [text]
    for term in tuple(left):
        for at, part in enumerate(parts):
            found = None if part.startswith("<a ") else _pattern(term).search(part)
            if found:
                parts[at : at + 1] = [part[: found.start()], _linked(found[0], term, to), part[found.end() :]]
                left.remove(term)
                break
    return "".join(parts)


def _pattern(term: str) -> re.Pattern[str]:
    initial = f"[{term[0].lower()}{term[0].upper()}]"  # not in capitals, as names of keywords are
    return re.compile(rf"(?<![\w-]){initial}{re.escape(term[1:])}(?:s|es)?(?![\w-])")


def _linked(text: str, term: str, to: str) -> str:
    meaning = html.escape(re.sub(r"[*`]|\[([^]]*)\]\([^)]*\)", r"\1", _terms()[term][1]), quote=True)
    return f'<a class="term" href="{to}#{_anchor(term)}" title="{meaning}">{text}</a>'


def _anchor(term: str) -> str:
    return "term-" + re.sub(r"\W+", "-", term.lower())

"""The page's colours by computation: every theme's palette, as the style sheet has it, keeps WCAG AA."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

_CSS = (Path(__file__).parents[3] / "radiometer/daemon/http/page/page.css").read_text(encoding="utf-8")
_THEMES = {"light": r":root \{", "dark": r':root\[data-theme="dark"\] \{', "red": r':root\[data-theme="red"\] \{'}
# 4.5 for text (WCAG 2.1, 1.4.3); 3 for what marks a control or is a graph (1.4.11).
_NEEDED = {"ink": 4.5, "quiet": 4.5, "accent": 4.5, "good": 4.5, "bad": 4.5, "edge": 3.0}


def _palette(theme: str) -> dict[str, tuple[int, int, int]]:
    block = re.split(_THEMES[theme], _CSS)[1].partition("}")[0]
    found = {}
    for name, digits in re.findall(r"--([\w-]+): #([0-9a-f]{3,6})\b", block):
        wide = digits if len(digits) == 6 else "".join(2 * digit for digit in digits)
        found[name] = tuple(int(wide[i : i + 2], 16) for i in (0, 2, 4))
    return found


def _luminance(colour: tuple[int, int, int]) -> float:
    linear = [c / 255 / 12.92 if c / 255 <= 0.04045 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(one: tuple[int, int, int], other: tuple[int, int, int]) -> float:
    bright, dark = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


def test_the_contrast_is_that_of_the_guideline():
    """Black on white is 21, and #767676 the palest grey that is legible on white: 4.54."""
    assert _contrast((0, 0, 0), (255, 255, 255)) == pytest.approx(21.0)
    assert _contrast((0x76, 0x76, 0x76), (255, 255, 255)) == pytest.approx(4.54, abs=0.005)


@pytest.mark.parametrize("theme", _THEMES)
def test_every_colour_of_a_theme_can_be_distinguished_from_what_it_lies_on(theme: str):
    """Text and lines of plots on cards and on the page; the rims of fields and sliders on cards."""
    palette = _palette(theme)
    for name, needed in _NEEDED.items():
        assert _contrast(palette[name], palette["card"]) >= needed, (theme, name)
    for name in ("ink", "quiet"):
        assert _contrast(palette[name], palette["ground"]) >= 4.5, (theme, name)
    assert _contrast(palette["on-accent"], palette["accent"]) >= 4.5
    assert _contrast(palette["bad"], palette["alarm"]) >= 4.5


def test_the_red_theme_lights_nothing_but_red():
    """Rods stay adapted: neither green nor blue in any of its colours."""
    assert all(colour[1:] == (0, 0) for colour in _palette("red").values())

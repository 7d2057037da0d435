"""A small chart of dots in a terminal: every character holds 2 × 4 of them (Unicode's Braille patterns)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

_BLANK: Final = 0x2800  # Unicode: Braille pattern without dots
# Bits of the dots in a character: rows from above, left and right column.
_DOTS: Final = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))

Point = tuple[float, float]


@dataclass(slots=True)
class TerminalChart:
    """An empty chart of a size in characters, over a range of both axes."""

    columns: int  # width in characters, without the labels
    rows: int  # height in characters, without the labels
    x_range: tuple[float, float]  # lowest and highest value of the horizontal axis
    y_range: tuple[float, float]  # lowest and highest value of the vertical axis
    _cells: dict[tuple[int, int], int] = field(default_factory=dict)

    def dots(self, points: Iterable[Point]) -> None:
        """Set a dot at every point within the ranges."""
        for x, y in points:
            across = self._place(x, self.x_range, 2 * self.columns)
            up = self._place(y, self.y_range, 4 * self.rows)
            if across is not None and up is not None:
                self._set(across, 4 * self.rows - 1 - up)

    def blobs(self, points: Iterable[Point]) -> None:
        """Set two by two dots at every point, so that they stand out from a line."""
        step_x = (self.x_range[1] - self.x_range[0]) / (2 * self.columns)
        step_y = (self.y_range[1] - self.y_range[0]) / (4 * self.rows)
        self.dots((x + i * step_x, y + j * step_y) for x, y in points for i in (-0.5, 0.5) for j in (-0.5, 0.5))

    def lines(self, y_labels: Sequence[float], x_labels: Sequence[float], x_unit: str) -> list[str]:
        """Return the lines of text, labels at their places."""
        labels = {self._row(y): f"{y:4.0f} ┤" for y in y_labels}
        drawn = [
            labels.get(row, "     │")
            + "".join(chr(_BLANK + self._cells.get((row, column), 0)) for column in range(self.columns))
            for row in range(self.rows)
        ]
        return [*drawn, "     └" + "─" * self.columns, self._below(x_labels, x_unit)]

    def _below(self, x_labels: Sequence[float], x_unit: str) -> str:
        text = [" "] * (self.columns + 12)
        for x in x_labels:
            place = self._place(x, self.x_range, 2 * self.columns)
            if place is not None:
                word = f"{x:g}"
                begin = 6 + place // 2 - len(word) // 2
                text[begin : begin + len(word)] = word
        return "".join(text).rstrip() + f" {x_unit}"

    def _row(self, y: float) -> int:
        place = self._place(y, self.y_range, 4 * self.rows)
        return -1 if place is None else (4 * self.rows - 1 - place) // 4

    def _set(self, across: int, down: int) -> None:
        cell = (down // 4, across // 2)
        self._cells[cell] = self._cells.get(cell, 0) | _DOTS[down % 4][across % 2]

    @staticmethod
    def _place(value: float, limits: tuple[float, float], count: int) -> int | None:
        """Return which of `count` dots a value falls on; None outside the limits."""
        share = (value - limits[0]) / (limits[1] - limits[0])
        return min(math.floor(share * count), count - 1) if 0.0 <= share <= 1.0 else None

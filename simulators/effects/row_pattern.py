"""Rows that differ from each other, always alike."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.catalogue import FixedOffsets


@dataclass(frozen=True)
class RowPattern(FixedOffsets):
    """Adds a fixed offset to each row, normal with standard deviation s.

    Source: row drivers of CMOS sensors; typical 0.1 to 1 e-.
    """

    name = "row_pattern"
    where = "image_y"
    block = "rows"
    lines = "row"

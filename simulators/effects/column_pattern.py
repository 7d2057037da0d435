"""Columns that differ from each other."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.catalogue import FixedOffsets


@dataclass(frozen=True)
class ColumnPattern(FixedOffsets):
    """Adds a fixed offset to each column, normal with standard deviation s.

    Source: column amplifiers of CMOS sensors; typical 0.1 to 1 e-.
    """

    name = "column_pattern"
    where = "image_x"
    block = "columns"
    lines = "column"

"""How easily light bleaches the visual pigments, and how fast they come back: one table for all that need it.

The calculator, the checks of a protocol and the simulated eye take their numbers from here; each computes with
separate formulas. docs/reference/adaptation-test.md prints the same table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class BleachingConstant:
    """A published constant with what the literature scatters by."""

    name: str  # its key in the table
    value: float  # the value that is used
    low: float  # lowest value in use
    high: float  # highest value in use
    unit: str  # unit of all three
    source: str  # where value, low and high come from
    verified: bool  # whether the figure was read in a copy of the source or of a table that quotes it


ROD_EXPOSURE: Final = BleachingConstant(
    "rod exposure",
    1.0e7,
    1.0e7,
    1.6e7,
    "scotopic td s",
    "4.4 log scotopic td half bleached (Rushton 1972, as given by CVRL) times 400 s; 1.6e7: reflectometry as used by "
    "Pugh 1975",
    verified=True,
)
ROD_REGENERATION: Final = BleachingConstant(
    "rod regeneration", 400.0, 360.0, 450.0, "s", "Rushton and Powell 1972; spread of later work", verified=False
)
CONE_HALF_BLEACH: Final = BleachingConstant(
    "cone half bleach",
    2.0e4,
    7.8e3,
    2.9e4,
    "photopic td",
    "4.3 log td, L and M cones together (Rushton and Henry 1968, as given by CVRL); 2.9e4 by their other method "
    "(Psychtoolbox), 7.8e3 for single cone types (Rushton 1963, 1965; questionable, says CVRL)",
    verified=True,
)
CONE_REGENERATION: Final = BleachingConstant(
    "cone regeneration", 120.0, 105.0, 130.0, "s", "Rushton and Henry 1968; Hollins and Alpern 1973", verified=False
)
CONSTANTS: Final = (ROD_EXPOSURE, ROD_REGENERATION, CONE_HALF_BLEACH, CONE_REGENERATION)

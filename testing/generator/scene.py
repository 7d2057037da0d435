"""The chart on the screen: 24 scrambled patches over 1:100 and the surround between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radiometer.data import PatchDescription
from testing.generator.rig import Rig

GRID_ROWS, GRID_COLUMNS = 4, 6
GAP_PX = 1  # surround on every side of a displayed patch
MARGIN_PX = 4  # from the cell's edge to the region that is analysed
SURROUND = {"chart": 0.2, "inverted": 0.2, "bright_surround": 1.0, "dark_surround": 0.0}
COLOURS = {"red": 0.45, "green": 1.0, "blue": 0.3}  # peak radiance of each primary relative to the whole


@dataclass(frozen=True)
class Chart:
    """Codes (radiance relative to the peak) of the patches in reading order."""

    rig: Rig
    codes: np.ndarray

    @classmethod
    def scrambled(cls, rig: Rig, rng: np.random.Generator) -> Chart:
        """Return 24 codes spaced evenly in the logarithm over 1:100, in random places."""
        return cls(rig, rng.permutation(np.logspace(-2, 0, GRID_ROWS * GRID_COLUMNS)))

    def codes_of(self, pattern: str) -> np.ndarray:
        """Return the codes of the patches under a pattern."""
        if pattern == "inverted":
            return 0.01 / self.codes
        if pattern in COLOURS:
            return self.codes * COLOURS[pattern]
        return self.codes

    def image(self, pattern: str) -> np.ndarray:
        """Return the code of every pixel under a pattern."""
        surround = 0.2 * COLOURS[pattern] if pattern in COLOURS else SURROUND[pattern]
        picture = np.full((self.rig.rows, self.rig.columns), surround)
        height, width = self.rig.rows // GRID_ROWS, self.rig.columns // GRID_COLUMNS
        for number, code in enumerate(self.codes_of(pattern)):
            y, x = height * (number // GRID_COLUMNS), width * (number % GRID_COLUMNS)
            picture[y + GAP_PX : y + height - GAP_PX, x + GAP_PX : x + width - GAP_PX] = code
        return picture

    def stated(
        self, patterns: tuple[str, ...], rng: np.random.Generator, *, known: bool
    ) -> tuple[PatchDescription, ...]:
        """Return the patches with their radiance as somebody calibrated it: each displayed value has its own error."""
        errors = {p: rng.normal(0, self.rig.patch_error, self.codes.size) for p in patterns}
        for alike in ("bright_surround", "dark_surround"):
            if alike in errors and "chart" in errors:
                errors[alike] = errors["chart"]  # the same displayed value, measured once
        height, width = self.rig.rows // GRID_ROWS, self.rig.columns // GRID_COLUMNS
        patches = []
        for n in range(self.codes.size):
            values = {p: float(self.rig.peak_radiance * self.codes_of(p)[n] * (1 + errors[p][n])) for p in patterns}
            patches.append(
                PatchDescription(
                    name=f"p{n:02d}",
                    x=width * (n % GRID_COLUMNS) + MARGIN_PX,
                    y=height * (n // GRID_COLUMNS) + MARGIN_PX,
                    width=width - 2 * MARGIN_PX,
                    height=height - 2 * MARGIN_PX,
                    radiance_W_per_sr_m2=values if known else None,
                    u_rel=self.rig.claimed_patch_error if known else None,
                )
            )
        return tuple(patches)

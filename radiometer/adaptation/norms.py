"""Published values of healthy eyes, and what they hold for: a report shows them next to what was measured.

Each figure was read in the abstract of its source. None is a limit of this instrument: bleach, spot and place differ.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Norm:
    """What a study found in healthy eyes."""

    estimate: str  # name of the estimate that it is of
    found: str  # what was found, with ages
    conditions: str  # bleach, spot, place and number of eyes
    source: str  # author, year and where

    def to_mapping(self) -> dict[str, str]:
        """Return the documented JSON form."""
        return {name: getattr(self, name) for name in self.__slots__}


NORMS: Final = (
    Norm(
        "rod_intercept_min",
        "5.8 min in the median above 55 years, half of the eyes from 3.8 to 7.5 min",
        "flash that bleaches 76 % of the rods, 5° from the fovea; healthy controls",
        "Binns et al. 2018, Invest. Ophthalmol. Vis. Sci. 59, AMD114",
    ),
    Norm(
        "rod_intercept_min",
        "up to 6.5 min in 19 of 21 healthy adults, above it in 115 of 127 with macular degeneration",
        "AdaptDx, rapid test",
        "Jackson et al. 2014, Invest. Ophthalmol. Vis. Sci. 55, 1427",
    ),
    Norm(
        "rod_intercept_min",
        "12.3 min and more counts as abnormal from 60 years on",
        "flash, 5° below the fovea; adults in normal macular health",
        "Owsley et al. 2014, Invest. Ophthalmol. Vis. Sci. 55, 4776",
    ),
    Norm(
        "tau_min",
        "16.4 s longer for each decade of age",
        "96 % of the cones bleached, white spot of 4° at the fovea; 41 healthy adults of 20 to 83 years",
        "Gaffney, Binns and Margrain 2012, Optom. Vis. Sci. 89, 1219",
    ),
    Norm(
        "plateau",
        "no change with age at the fovea",
        "96 % of the cones bleached, white spot of 4° at the fovea; 41 healthy adults of 20 to 83 years",
        "Gaffney, Binns and Margrain 2012, Optom. Vis. Sci. 89, 1219",
    ),
    Norm(
        "plateau",
        "0.04 log₁₀ units higher for each decade of age",
        "27 places up to 18° from the fovea; 94 healthy adults from the twenties to the eighties",
        "Jackson and Owsley 2000, Vision Res. 40, 2467",
    ),
    Norm(
        "final_threshold",
        "0.08 log₁₀ units higher for each decade of age",
        "27 places up to 18° from the fovea; 94 healthy adults from the twenties to the eighties",
        "Jackson and Owsley 2000, Vision Res. 40, 2467",
    ),
)
WITHOUT: Final = ("break_min", "s2_slope_per_min")  # no study with value, spread and age of healthy eyes was found


def norms_of(estimates: Iterable[str]) -> list[Norm]:
    """Return the published values of estimates."""
    known = set(estimates)
    return [one for one in NORMS if one.estimate in known]

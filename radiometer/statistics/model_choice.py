"""Is a further term supported by the data? One question with one answer, and the criteria with their reasons."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Criterion:
    """What a further term must gain."""

    gain: float  # least fall of the deviance (−2 ln of the likelihood, or χ²)
    reason: str  # why so much


# Chance alone brings each with the probability in brackets, for one further parameter.
AKAIKE: Final = Criterion(2.0, "a term that predicts better is used, though nothing is claimed of it (16 %)")
CLEARLY_BETTER: Final = Criterion(4.0, "evidence ratio e² = 7: Burnham and Anderson 2002, section 2.6 (4.6 %)")
THREE_SIGMA: Final = Criterion(9.0, "a doubt that widens an uncertainty; a false one costs little (0.3 %)")
STATED_IS_WRONG: Final = Criterion(20.0, "a stated value is replaced by a fitted one, or a feature is claimed (8e-6)")
FIVE_SIGMA: Final = Criterion(25.0, "a finding that the user is warned of (6e-7)")


def is_supported(gain: float, criterion: Criterion) -> bool:
    """Return whether the fall of the deviance that a further term brings supports it.

    Args:
        gain: Deviance without the term less deviance with it; its further parameters at their best values.
        criterion: How much it must be.
    """
    return gain >= criterion.gain


def schwarz(parameters: int, count: int, trials: float = 1.0) -> Criterion:
    """Return the criterion of a term that is the best of many trials: their number is the odds against each.

    A margin of 6 (odds of 20 to 1) comes on top: equal odds are no finding.

    Args:
        trials: How many such terms (periods) were tried.

    Source: Schwarz 1978, Annals of Statistics 6, 461.
    """
    return Criterion(parameters * math.log(count) + 2.0 * math.log(trials) + 6.0, "the best of many trials")


def aicc(sum_of_squares: float, count: int, parameters: int) -> float:
    """Return Akaike's information criterion of a least-squares fit, corrected for few values; infinite without freedom.

    Args:
        sum_of_squares: Of the (weighted) residuals.

    Source: Hurvich and Tsai 1989, Biometrika 76, 297.
    """
    correction = 2 * parameters * (parameters + 1) / (count - parameters - 1) if count > parameters + 1 else math.inf
    return count * math.log(max(sum_of_squares, 1e-300) / count) + 2 * parameters + correction

"""Simulated subjects by name: the habits and the eye of each, the same before a box, a screen or without a device."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from radiometer.errors import UsageError
from simulators.observers.eye_kinetics import Eye, drawn_amd_eye, drawn_clinical_eye
from simulators.observers.observer import Habits

LEAVES_AFTER_MIN: Final = 10.0  # within every protocol, after the first thresholds


@dataclass(frozen=True, slots=True)
class Behaviour:
    """How a simulated subject behaves."""

    habits: Habits = field(default_factory=Habits)  # how it answers
    leaves_after_min: float = math.inf  # time in the dark in min after which it does not press any more
    taps: bool = False  # whether it presses all the time, whatever is shown
    draws_eye: Callable[[np.random.Generator], Eye] | None = None  # draws its eye; None for the textbook's

    def eye(self, rng: np.random.Generator) -> Eye:
        """Return the eye of one such subject."""
        return Eye() if self.draws_eye is None else self.draws_eye(rng)


BEHAVIOURS: Final = {
    "steady": Behaviour(),
    "never": Behaviour(Habits(lapses=1.0, false_alarms=0.0)),
    "always": Behaviour(Habits(lapses=0.0, false_alarms=1.0), taps=True),
    "leaves": Behaviour(leaves_after_min=LEAVES_AFTER_MIN),
    "wanders": Behaviour(Habits(fixation_losses=0.4)),
    "healthy": Behaviour(draws_eye=drawn_clinical_eye),
    "amd": Behaviour(draws_eye=drawn_amd_eye),
}


def behaviour_of(name: str) -> Behaviour:
    """Return a behaviour by its name. Raises UsageError if there is none of that name."""
    if name not in BEHAVIOURS:
        raise UsageError(f"simulated subject {name!r} is unknown: choose {', '.join(BEHAVIOURS)}")
    return BEHAVIOURS[name]

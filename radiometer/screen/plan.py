"""Which patches are shown, in which order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from radiometer.devices import DisplayPatch
from radiometer.errors import UsageError

TOP: Final = 255  # highest level: the drivers and pages here set 8 bits
CHANNELS: Final = ("grey", "red", "green", "blue")
_PRIMARIES: Final[dict[str, tuple[float, float, float]]] = {
    "grey": (1.0, 1.0, 1.0),
    "red": (1.0, 0.0, 0.0),
    "green": (0.0, 1.0, 0.0),
    "blue": (0.0, 0.0, 1.0),
}
QUICK_LEVELS: Final = (0, 32, 64, 96, 128, 192, 255)  # dense where a screen's curve bends, dark
REFERENCE_EVERY: Final = 10  # a drift over ten readings is a straight line

Purpose = Literal["level", "white", "black"]


@dataclass(frozen=True, slots=True)
class ScreenStep:
    """One patch to be shown and read."""

    channel: str  # one of `CHANNELS`
    level: int  # level 0 to `TOP`
    purpose: Purpose = "level"  # "level" for the curve, "white" and "black" for drift references

    def patch(self, size: float = 1.0) -> DisplayPatch:
        """Return what the display is asked to show, `size` of the screen's width and height."""
        drive = self.level / TOP
        red, green, blue = _PRIMARIES[self.channel]
        return DisplayPatch((red * drive, green * drive, blue * drive), width_fraction=size, height_fraction=size)


def parse_levels(text: str) -> tuple[int, ...]:
    """Return ascending levels behind "all", "quick", a count such as "33", or a list such as "0,16,255".

    Black and white are always among them. Raises UsageError if the text is none of these.
    """
    if text == "all":
        return tuple(range(TOP + 1))
    if text == "quick":
        return QUICK_LEVELS
    try:
        numbers = [int(part) for part in text.split(",")]
    except ValueError as error:
        raise UsageError(
            f"--levels {text!r}: expected all, quick, a count such as 33, or a list such as 0,16,255"
        ) from error
    if len(numbers) == 1 and 3 <= numbers[0] <= TOP + 1:
        return tuple(sorted({round(n) for n in np.linspace(0, TOP, numbers[0])}))
    if len(numbers) == 1 or min(numbers) < 0 or max(numbers) > TOP:
        raise UsageError(f"--levels {text!r}: a count is 3 to {TOP + 1}; levels are 0 to {TOP}")
    found = tuple(sorted({0, TOP, *numbers}))
    if len(found) < 3:
        raise UsageError(f"--levels {text!r}: black and white alone show no curve; name a level between 0 and {TOP}")
    return found


def make_plan(levels: tuple[int, ...], channels: tuple[str, ...], rng: np.random.Generator) -> list[ScreenStep]:
    """Return all levels of all channels in random order, white and black references before, after and between.

    Raises:
        UsageError: If a channel is unknown.
    """
    unknown = sorted(set(channels) - set(CHANNELS))
    if unknown:
        raise UsageError(f"channel {unknown[0]!r} is unknown; choose from {', '.join(CHANNELS)}")
    steps = [ScreenStep(channel, level) for channel in channels for level in levels]
    references = [ScreenStep("grey", TOP, "white"), ScreenStep("grey", 0, "black")]
    plan: list[ScreenStep] = []
    for number, position in enumerate(rng.permutation(len(steps))):
        if number % REFERENCE_EVERY == 0:
            plan += references
        plan.append(steps[position])
    return plan + references

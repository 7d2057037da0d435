"""Small helpers that several scenes share."""

from __future__ import annotations

from radiometer.data import Patch
from radiometer.errors import ConfigurationError


def refuse_outside(name: str, patch: Patch, width: int, height: int) -> None:
    """Raise ConfigurationError where a patch is not wholly on the sensor."""
    if not patch.fits((height, width)):
        raise ConfigurationError(
            f"scene: patch {name!r} ({patch.width} × {patch.height} px at {patch.x}, {patch.y}) is not on the "
            f"sensor of {width} × {height} px"
        )


def refuse_unknown_pattern(pattern: str, patterns: tuple[str, ...]) -> None:
    """Raise ConfigurationError where a scene has no pattern of that name."""
    if pattern not in patterns:
        raise ConfigurationError(f"scene: there is no pattern {pattern!r}; it shows {', '.join(patterns)}")


def per_pattern(values: dict[str, float]) -> float | dict[str, float]:
    """Return one number where all patterns agree, else the mapping (the forms of `capture.yaml`)."""
    numbers = set(values.values())
    return numbers.pop() if len(numbers) == 1 else values

"""Small helpers that several scenes share."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from radiometer.data import Patch, PatchDescription, SourceDescription
from radiometer.data.validation import ConfigSection
from radiometer.errors import ConfigurationError


class LitScene(ConfigSection):
    """What scenes of one light share: its wavelength, its kind, and the one pattern that they show."""

    source_kind: ClassVar[Literal["sphere", "screen", "led", "scene"]] = "scene"
    wavelength_nm: float = Field(550.0, gt=0)

    @property
    def source(self) -> SourceDescription:
        """Return kind and wavelength of the light."""
        return SourceDescription(kind=self.source_kind, wavelength_nm=self.wavelength_nm)

    @property
    def patterns(self) -> tuple[str, ...]:
        """Return the one pattern."""
        return ("default",)


def described(name: str, patch: Patch, radiance: float | dict[str, float]) -> PatchDescription:
    """Return a patch with its true radiance in W·sr⁻¹·m⁻²."""
    x, y, width, height = patch.x, patch.y, patch.width, patch.height
    return PatchDescription(name=name, x=x, y=y, width=width, height=height, radiance_W_per_sr_m2=radiance, u_rel=0.0)


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

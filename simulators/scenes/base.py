"""Scenes: the radiance at every pixel, the true radiance of the patches, and what several scenes share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from radiometer.data import Patch, PatchDescription, SourceDescription
from radiometer.data.validation import ConfigSection
from radiometer.errors import ConfigurationError


@dataclass(frozen=True, slots=True, eq=False)
class SceneImage:
    """A scene as the sensor's pixels look at it, at source level 1."""

    radiance: NDArray[np.float32]  # radiance in W·sr⁻¹·m⁻², shape (height, width), float32
    # Display drive 0 to 1 of each pixel; None where the scene is no display
    code: NDArray[np.floating[Any]] | None = None
    peak_radiance: float = 1.0  # radiance at drive 1 in W·sr⁻¹·m⁻² (the highest radiance where there is no display)


class Scene(Protocol):
    """Something to point a camera at. Positions are pixels of the whole sensor."""

    @property
    def source(self) -> SourceDescription:
        """Return kind and wavelength of the light."""

    @property
    def patterns(self) -> tuple[str, ...]:
        """Return the names of the patterns that it can show; the first is shown by default."""

    def render(self, width: int, height: int, pattern: str) -> SceneImage:
        """Return what a sensor of `width` × `height` pixels sees. Raises ConfigurationError for an unknown pattern."""

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        """Return the patches with their true radiance at source level 1 (u_rel 0)."""


Weight = Callable[[NDArray[np.float64]], NDArray[np.float64]]  # responsivity over the wavelength in nm


class LitScene(ConfigSection):
    """What scenes of one light share: its wavelength, its kind, and the one pattern that they show."""

    source_kind: ClassVar[Literal["sphere", "screen", "led", "scene"]] = "scene"
    wavelength_nm: float = Field(550.0, gt=0)

    @property
    def source(self) -> SourceDescription:
        return SourceDescription(kind=self.source_kind, wavelength_nm=self.wavelength_nm)

    @property
    def patterns(self) -> tuple[str, ...]:
        return ("default",)

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        raise NotImplementedError

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        raise NotImplementedError

    def seen_through(self, weight: Weight, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return what the sensor sees behind a filter; the light is of one wavelength.

        Args:
            weight: Responsivity behind the filter, relative to that of the bare sensor at 550 nm.
            width: Of the sensor in pixels.
            height: Of the sensor.
            pattern: The displayed pattern.
        """
        image = self.render(width, height, pattern)
        factor = float(weight(np.array([self.wavelength_nm]))[0])
        return replace(image, radiance=image.radiance * np.float32(factor), peak_radiance=image.peak_radiance * factor)


def described(name: str, patch: Patch, radiance: float | dict[str, float]) -> PatchDescription:
    """Return a patch with its true radiance in W·sr⁻¹·m⁻²."""
    x, y, width, height = patch.x, patch.y, patch.width, patch.height
    return PatchDescription(name=name, x=x, y=y, width=width, height=height, radiance_W_per_sr_m2=radiance, u_rel=0.0)


def grid(count: int, columns: int | None, margin: float, width: int, height: int) -> tuple[Patch, ...]:
    """Return patches row by row, each in the middle of a cell of the sensor.

    Args:
        count: Number of patches.
        columns: Patches in a row; None for cells that are about square.
        margin: Share of each cell's side that stays free.
        width: Of the sensor in pixels.
        height: Of the sensor.

    Raises:
        ConfigurationError: If they do not fit on the sensor.
    """
    across = columns or max(1, round(math.sqrt(count * width / height)))
    rows = math.ceil(count / across)
    cell_width, cell_height = width // across, height // rows
    patch_width, patch_height = round(cell_width * (1 - margin)), round(cell_height * (1 - margin))
    if min(patch_width, patch_height) < 1:
        raise ConfigurationError(
            f"scene: {count} patches in {across} columns do not fit on a sensor of {width} × {height} px"
        )
    left, top = (cell_width - patch_width) // 2, (cell_height - patch_height) // 2
    return tuple(
        Patch(i % across * cell_width + left, i // across * cell_height + top, patch_width, patch_height)
        for i in range(count)
    )


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


@dataclass(frozen=True, slots=True)
class PulsedLight:
    """A periodic light of mean 1: 1 + m·sin(2πft), or a square wave of the same mean that is on for its duty."""

    frequency_hz: float
    modulation: float = 1.0  # m, 0 to 1; of a square wave the share of the light that is switched
    duty: float = 0.0  # share of the period that a square wave is on; 0 for a sine

    def mean(self, start_s: float, duration_s: float) -> float:
        """Return the mean light over a window of time, relative to the long mean."""
        first, last = start_s * self.frequency_hz, (start_s + duration_s) * self.frequency_hz
        if self.duty == 0.0:
            turn = 2.0 * math.pi
            return 1.0 + self.modulation * (math.cos(turn * first) - math.cos(turn * last)) / (turn * (last - first))
        lit = (self._lit(last) - self._lit(first)) / (last - first) / self.duty
        return 1.0 + self.modulation * (lit - 1.0)

    def _lit(self, phase: float) -> float:
        """Return the time in periods that a square wave was on since phase 0."""
        whole = math.floor(phase)
        return whole * self.duty + min(phase - whole, self.duty)

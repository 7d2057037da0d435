"""What a scene is: radiance at every pixel, and the true radiance of its patches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radiometer.data import PatchDescription, SourceDescription


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

"""An integrating sphere: the same radiance everywhere."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from radiometer.data import PatchDescription, SourceDescription
from radiometer.data.validation import ConfigSection
from simulators.scenes.base import SceneImage
from simulators.scenes.layout import refuse_unknown_pattern


class UniformScene(ConfigSection):
    """Uniform radiance over the whole field; the scene for characterising a camera."""

    kind: Literal["uniform"] = "uniform"
    radiance_W_per_sr_m2: float = Field(1.0, ge=0)  # noqa: N815 (the file's key)
    wavelength_nm: float = Field(550.0, gt=0)

    @property
    def source(self) -> SourceDescription:
        """Return an integrating sphere."""
        return SourceDescription(kind="sphere", wavelength_nm=self.wavelength_nm)

    @property
    def patterns(self) -> tuple[str, ...]:
        """Return the one pattern."""
        return ("default",)

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the same radiance at every pixel."""
        refuse_unknown_pattern(pattern, self.patterns)
        level = self.radiance_W_per_sr_m2
        return SceneImage(np.full((height, width), level, np.float32), peak_radiance=level)

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        """Return the whole field as one patch."""
        return (
            PatchDescription(
                name="field",
                x=0,
                y=0,
                width=width,
                height=height,
                radiance_W_per_sr_m2=self.radiance_W_per_sr_m2,
                u_rel=0.0,
            ),
        )

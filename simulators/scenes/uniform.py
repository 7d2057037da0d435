"""An integrating sphere: the same radiance everywhere."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from radiometer.data import Patch, PatchDescription
from simulators.scenes.base import SceneImage
from simulators.scenes.layout import LitScene, described, refuse_unknown_pattern


class UniformScene(LitScene):
    """Uniform radiance over the whole field; the scene for characterising a camera."""

    kind: Literal["uniform"] = "uniform"
    radiance_W_per_sr_m2: float = Field(1.0, ge=0)  # noqa: N815 (the file's key)
    source_kind = "sphere"

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        refuse_unknown_pattern(pattern, self.patterns)
        level = self.radiance_W_per_sr_m2
        return SceneImage(np.full((height, width), level, np.float32), peak_radiance=level)

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        return (described("field", Patch(0, 0, width, height), self.radiance_W_per_sr_m2),)

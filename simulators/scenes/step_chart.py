"""A chart of patches whose radiances are stated, such as twenty steps over five decades."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from radiometer.data import Patch, PatchDescription
from radiometer.data.validation import ConfigSection
from simulators.scenes.base import SceneImage
from simulators.scenes.layout import LitScene, described, grid, per_pattern, refuse_unknown_pattern


class Steps(ConfigSection):
    """Equal steps of log radiance: how many, from where to where in W·sr⁻¹·m⁻²."""

    count: int = Field(gt=0, le=4096)
    lowest: float = Field(gt=0)
    highest: float = Field(gt=0)


class StepChartScene(LitScene):
    """Patches in a grid on a surround, from the darkest to the lightest row by row, or scrambled.

    Give `radiances_W_per_sr_m2` or `steps`. The share `margin` of each cell's side stays surround; `scramble_seed`
    shuffles the patches. The switch `inverted: true` adds a pattern in reverse order, so that every patch is seen at
    two radiances.
    """

    kind: Literal["step_chart"] = "step_chart"
    radiances_W_per_sr_m2: tuple[float, ...] | None = None  # noqa: N815 (the file's key)
    steps: Steps | None = None
    background_W_per_sr_m2: float = Field(0.0, ge=0)  # noqa: N815
    columns: int | None = Field(None, gt=0)
    margin: float = Field(0.3, ge=0, lt=1)
    scramble_seed: int | None = None
    inverted: bool = False

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.radiances_W_per_sr_m2 is None) == (self.steps is None):
            raise ValueError("give either radiances_W_per_sr_m2 or steps")
        if self.radiances_W_per_sr_m2 is not None and (
            not self.radiances_W_per_sr_m2 or min(self.radiances_W_per_sr_m2) < 0
        ):
            raise ValueError("radiances_W_per_sr_m2 needs at least one value, each 0 or more")
        return self

    @property
    def patterns(self) -> tuple[str, ...]:
        """Return "default", with "inverted" where asked for."""
        return ("default", "inverted") if self.inverted else ("default",)

    def radiances(self, pattern: str = "default") -> NDArray[np.float64]:
        """Return the radiance of each patch in W·sr⁻¹·m⁻² in the order of `patches`."""
        if self.steps is not None:
            values = np.geomspace(self.steps.lowest, self.steps.highest, self.steps.count)
        else:
            values = np.array(self.radiances_W_per_sr_m2)
        if self.scramble_seed is not None:
            values = np.random.default_rng(self.scramble_seed).permutation(values)
        return values[::-1] if pattern == "inverted" else values

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the chart. Raises ConfigurationError where the sensor is too small for it."""
        refuse_unknown_pattern(pattern, self.patterns)
        radiance = np.full((height, width), self.background_W_per_sr_m2, np.float32)
        values = self.radiances(pattern)
        for patch, value in zip(self._layout(width, height), values, strict=True):
            radiance[patch.slices] = value
        return SceneImage(radiance, peak_radiance=float(values.max()))

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        """Return the patches p00, p01, … with the radiance of each pattern."""
        by_pattern = {pattern: self.radiances(pattern) for pattern in self.patterns}
        return tuple(
            described(f"p{index:02d}", patch, per_pattern({name: float(t[index]) for name, t in by_pattern.items()}))
            for index, patch in enumerate(self._layout(width, height))
        )

    def _layout(self, width: int, height: int) -> tuple[Patch, ...]:
        return grid(len(self.radiances()), self.columns, self.margin, width, height)

"""A chart of lights whose spectra are stated: surfaces, LEDs or the colours of a display."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from radiometer.data import PatchDescription
from radiometer.data.validation import ConfigSection
from simulators.scenes.base import SceneImage
from simulators.scenes.layout import LitScene, Weight, described, grid, refuse_unknown_pattern

_GRID_NM = np.arange(350.0, 851.0)  # a camera sees nothing beyond


class ColourLight(ConfigSection):
    """One light: its name, and bands of (peak in nm, full width at half maximum in nm, radiance in W·sr⁻¹·m⁻²)."""

    name: str
    bands: tuple[tuple[float, float, float], ...] = Field(min_length=1)

    def spectral_radiance(self, wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the spectral radiance in W·sr⁻¹·m⁻²·nm⁻¹: a sum of Gaussians."""
        found = np.zeros(wavelength_nm.shape)
        for peak_nm, width_nm, radiance in self.bands:
            sigma_nm = width_nm / math.sqrt(8.0 * math.log(2.0))
            bell = np.exp(-0.5 * ((wavelength_nm - peak_nm) / sigma_nm) ** 2)
            found += radiance * bell / (sigma_nm * math.sqrt(2.0 * math.pi))
        return found


class ColourChartScene(LitScene):
    """Lights in a grid on a dark surround, row by row. `margin` of each cell's side stays dark."""

    kind: Literal["colour_chart"] = "colour_chart"
    lights: tuple[ColourLight, ...] = Field(min_length=1)
    columns: int | None = Field(None, gt=0)
    margin: float = Field(0.3, ge=0, lt=1)

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the radiance of the lights. Raises ConfigurationError where the sensor is too small for them."""
        return self.seen_through(np.ones_like, width, height, pattern)

    def seen_through(self, weight: Weight, width: int, height: int, pattern: str = "default") -> SceneImage:
        refuse_unknown_pattern(pattern, self.patterns)
        radiance = np.zeros((height, width), np.float32)
        values = [float(np.sum(one.spectral_radiance(_GRID_NM) * weight(_GRID_NM))) for one in self.lights]
        for patch, value in zip(grid(len(values), self.columns, self.margin, width, height), values, strict=True):
            radiance[patch.slices] = value
        return SceneImage(radiance, peak_radiance=max(values))

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        places = grid(len(self.lights), self.columns, self.margin, width, height)
        return tuple(
            described(one.name, patch, sum(radiance for *_, radiance in one.bands))
            for one, patch in zip(self.lights, places, strict=True)
        )

"""The colour filters of a camera with a mosaic: what its pixels see of a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import PatchDescription, SourceDescription
from radiometer.data.mosaic import COLOURS
from simulators.scenes.base import SceneImage
from simulators.scenes.layout import LitScene

# Peak and full width at half maximum of each colour's quantum efficiency in nm, what leaks elsewhere, and the infrared
# filter's edge. Assumed: between the data sheets of colour sensors (Sony IMX249, IMX273), and of no one camera.
_BELLS_NM: Final = {"red": (600.0, 78.0), "green": (532.0, 88.0), "blue": (465.0, 70.0)}
_LEAK: Final = 0.03
_CUT_NM, _CUT_WIDTH_NM = 665.0, 6.0
_REFERENCE_NM: Final = 550.0  # at which the camera's own quantum efficiency holds


@dataclass(frozen=True, slots=True)
class ColourFilters:
    """Filters over the pixels.

    Attributes:
        mosaic: Colours of 2 × 2 pixels row by row.
    """

    mosaic: str = "RGGB"

    def responsivity(self, colour: str, wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signal per watt under a filter over that of the bare sensor at 550 nm."""
        peak_nm, width_nm = _BELLS_NM[colour]
        bell = np.exp(-4.0 * math.log(2.0) * ((wavelength_nm - peak_nm) / width_nm) ** 2)
        cut = 1.0 / (1.0 + np.exp((wavelength_nm - _CUT_NM) / _CUT_WIDTH_NM))
        return np.asarray(wavelength_nm / _REFERENCE_NM * cut * (_LEAK + (1.0 - _LEAK) * bell))


@dataclass(frozen=True, slots=True)
class FilteredScene:
    """A scene behind the filters of a mosaic: the radiance at 550 nm that gives each pixel's signal."""

    scene: LitScene
    filters: ColourFilters

    @property
    def source(self) -> SourceDescription:
        return self.scene.source.model_copy(update={"wavelength_nm": _REFERENCE_NM})

    @property
    def patterns(self) -> tuple[str, ...]:
        return self.scene.patterns

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        return self.scene.patches(width, height)

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        planes = {
            colour: self.scene.seen_through(partial(self.filters.responsivity, colour), width, height, pattern)
            for colour in COLOURS
        }
        seen = np.empty((height, width), np.float32)
        for place, letter in enumerate(self.filters.mosaic):
            colour = next(one for one in COLOURS if one[0].upper() == letter)
            row, column = divmod(place, 2)
            seen[row::2, column::2] = planes[colour].radiance[row::2, column::2]
        return SceneImage(seen, peak_radiance=float(seen.max()))

"""A light-emitting diode seen from the front, in focus or not."""

from __future__ import annotations

import math
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from radiometer.data import Patch, PatchDescription
from simulators.scenes.base import SceneImage
from simulators.scenes.layout import LitScene, described, refuse_unknown_pattern

_OVERSAMPLING = 5  # per pixel and axis: an edge is placed to a fifth of a pixel


class LedScene(LitScene):
    """A round emitting area of known flux, with a glow around it where it is out of focus.

    The diode emits as L(θ) = L₀·cosᵐ⁻¹θ (intensity ∝ cosᵐθ) with cosᵐ(half angle) = 1/2, so its flux Φ and its axial
    radiance are tied by Φ = 2π·A·L₀/(m + 1), A the emitting area. The image of the area is a disc of `diameter_px`;
    defocus spreads it by a disc of `blur_px` and keeps its total.

    A lens near a narrow beam sees less than the axial radiance towards the rim of its pupil. With
    `pupil_half_angle_deg`, the angle that the pupil's radius subtends at the diode, the picture holds the radiance
    that, taken as the same over the pupil, carries the true flux: Φ·(1 − cosᵐ⁺¹θ_p) / (π·A·tan²θ_p).

    Source: generalised Lambertian emitter (Moreno and Sun 2008, equation 1).
    """

    kind: Literal["led"] = "led"
    flux_mW: float = Field(5.0, gt=0)  # noqa: N815 (the file's key)
    emitter_diameter_mm: float = Field(5.0, gt=0)
    half_angle_deg: float = Field(60.0, gt=0, lt=90)
    pupil_half_angle_deg: float | None = Field(None, gt=0, lt=80)
    diameter_px: float = Field(60.0, gt=0)
    blur_px: float = Field(0.0, ge=0)
    center_px: tuple[float, float] | None = None
    background_W_per_sr_m2: float = Field(0.0, ge=0)  # noqa: N815
    source_kind = "led"
    wavelength_nm: float = Field(590.0, gt=0)

    @property
    def intensity_exponent(self) -> float:
        """Return m of I ∝ cosᵐθ; 1 for a Lambertian emitter (half angle 60°)."""
        return math.log(0.5) / math.log(math.cos(math.radians(self.half_angle_deg)))

    @property
    def emitting_area_m2(self) -> float:
        """Return the emitting area in m²."""
        return math.pi * (0.5e-3 * self.emitter_diameter_mm) ** 2

    @property
    def axial_radiance(self) -> float:
        """Return L₀ in W·sr⁻¹·m⁻² at source level 1."""
        flux_w = 1e-3 * self.flux_mW
        return flux_w * (self.intensity_exponent + 1) / (2 * math.pi * self.emitting_area_m2)

    @property
    def seen_radiance(self) -> float:
        """Return the radiance in W·sr⁻¹·m⁻² that the lens sees, averaged over its pupil; axial where that is small."""
        if self.pupil_half_angle_deg is None:
            return self.axial_radiance
        theta = math.radians(self.pupil_half_angle_deg)
        entering_w = 1e-3 * self.flux_mW * (1.0 - math.cos(theta) ** (self.intensity_exponent + 1))
        return float(entering_w / (math.pi * self.emitting_area_m2 * math.tan(theta) ** 2))

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the disc (its edge pixels by the share that it covers), spread by the defocus."""
        refuse_unknown_pattern(pattern, self.patterns)
        share = _disc(width, height, self._center(width, height), self.diameter_px)
        if self.blur_px > 0:
            share = cv2.filter2D(share, -1, _disc_kernel(self.blur_px), borderType=cv2.BORDER_CONSTANT)
        radiance = share * np.float32(self.seen_radiance) + np.float32(self.background_W_per_sr_m2)
        return SceneImage(radiance.astype(np.float32), peak_radiance=self.seen_radiance)

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        """Return the square inside the part of the disc that defocus leaves flat; none where nothing is flat."""
        side = int((self.diameter_px - self.blur_px) / math.sqrt(2)) - 2
        x, y = (round(c - (side - 1) / 2) for c in self._center(width, height))
        if side < 1 or min(x, y) < 0 or x + side > width or y + side > height:
            return ()
        radiance = self.seen_radiance + self.background_W_per_sr_m2
        return (described("led", Patch(x, y, side, side), radiance),)

    def _center(self, width: int, height: int) -> tuple[float, float]:
        return self.center_px or ((width - 1) / 2, (height - 1) / 2)


def _disc(width: int, height: int, center: tuple[float, float], diameter: float) -> NDArray[np.float32]:
    """Return the share of each pixel that a disc covers, from 5 × 5 points per pixel in its bounding box."""
    share = np.zeros((height, width), np.float32)
    x0, y0 = (max(math.floor(c - diameter / 2 - 1), 0) for c in center)
    x1 = min(math.ceil(center[0] + diameter / 2 + 2), width)
    y1 = min(math.ceil(center[1] + diameter / 2 + 2), height)
    if x1 <= x0 or y1 <= y0:
        return share
    n = _OVERSAMPLING
    xs = x0 - 0.5 + (np.arange((x1 - x0) * n) + 0.5) / n - center[0]
    ys = y0 - 0.5 + (np.arange((y1 - y0) * n) + 0.5) / n - center[1]
    inside = np.square(xs)[np.newaxis, :] + np.square(ys)[:, np.newaxis] <= (diameter / 2) ** 2
    share[y0:y1, x0:x1] = inside.reshape(y1 - y0, n, x1 - x0, n).mean(axis=(1, 3))
    return share


def _disc_kernel(diameter: float) -> NDArray[np.float32]:
    side = 2 * math.ceil(diameter / 2) + 1
    kernel = _disc(side, side, ((side - 1) / 2, (side - 1) / 2), diameter)
    normalised: NDArray[np.float32] = kernel / kernel.sum()
    return normalised

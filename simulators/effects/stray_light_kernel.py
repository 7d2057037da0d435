"""Light that the lens scatters around each point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self, cast

import numpy as np

from simulators.effects.base import IRRADIANCE, PRIOR, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.surroundings import surroundings_of
from simulators.effects.tile_moments import TileMoments

_WIDTHS: Final = (0.02, 0.04, 0.08, 0.16, 0.32)  # as fractions of the longer side
_MOST: Final = 0.5  # of the light that any lens scatters
_BEYOND: Final = 0.5  # of the light at the border
_LITTLE: Final = 0.005  # of the light, at each width


@dataclass(frozen=True)
class StrayLightKernel(CatalogueEffect):
    """Spreads a share of the light over a wide Gaussian: E' = (1 − v)·E + v·(E ∗ G_σ).

    With wings of any other form it is a sum of Gaussians of five widths, E' = E + Σ vₖ·(E ∗ Gₖ − E). The scene beyond
    the border is unknown. The picture is continued there as at the border, or at a share of it, down to darkness.
    That share is free whatever the wings, for light missing at the border looks like a fall-off.

    Source: the far tail of a point-spread function; σ a tenth of the picture and more.
    """

    name = "stray_light_kernel"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "image_x"
    block = "mean"
    trials = tuple({"share": 0.01, "radius": radius} for radius in (0.05, 0.08, 0.12, 0.2, 0.3))
    fitted = ("share", "radius", "edge_share")
    settles = "one bright patch with several sizes of surround"
    essential = ("radius",)  # a kernel of any width is any glare
    share: float = parameter(0.0, "1", -0.05, _MOST, source=PRIOR)
    radius: float = parameter(0.1, "1", 0.02, 1.0, source="sigma as a fraction of the longer side")
    edge_share: float = parameter(
        0.05, "1", 0.0, 0.4, source="part of the kernel in the last line before an edge, over the patch's own mean"
    )
    wings: tuple[float, ...] = parameter((), "1", 0.0, 0.5, source="shares of the widths 0.02, 0.04 … 0.32")
    beyond: float = parameter(1.0, "1", 0.0, 2.0, source="light beyond the border over that at the border")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        around, spread = surroundings_of(context), signal * (1.0 - self._lost)
        for share, radius in self._kernels():
            spread = spread + share * around.spread(signal, radius, self.beyond)
        return cast(Signal, spread.astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return 1.0 - self._lost

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return wings of any form, which start as the Gaussian nearest to this one, and as a little of each width.

        Before them the form whose picture goes on otherwise beyond the border.
        """
        others = (self.with_parameters(beyond=_BEYOND),) if self.beyond == 1.0 else ()
        if self.wings:
            return others
        nearest = int(np.argmin(np.abs(np.log(np.array(_WIDTHS) / self.radius))))
        near = tuple((0.6 if k == nearest else 0.1) * max(self.share, 0.0) for k in range(len(_WIDTHS)))
        even = (_LITTLE,) * len(_WIDTHS)  # a heavy tail is taken for a Gaussian far narrower than it
        return (*others, *(self.with_parameters(share=0.0, wings=wings) for wings in (near, even)))

    def free(self) -> tuple[str, ...]:
        further = ("beyond",) if self.beyond != 1.0 else ()
        if not self.wings:
            return (*self.fitted, *further)
        return (*(f"wings[{k}]" for k in range(len(self.wings))), "edge_share", *further)

    def _kernels(self) -> tuple[tuple[float, float], ...]:
        """Return share and width of each kernel."""
        return tuple(zip(self.wings, _WIDTHS, strict=True)) if self.wings else ((self.share, self.radius),)

    @property
    def _lost(self) -> float:
        return sum(share for share, _ in self._kernels())

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with what the kernel carries across an edge, which depends on where the patch ends."""
        return after.changed(edge_share=before.edge_share + np.full((1, 1, 1), self._lost * self.edge_share))

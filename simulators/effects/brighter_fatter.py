"""Full pixels that push charge to their neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple, Self, cast

import cv2
import numpy as np

from simulators.effects.base import ELECTRONS, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, well_e
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_FAR_PX: Final = 8.0  # farther than a push is seen: covariances of flats end in their noise at lags of 5
_STARTING_PX: Final = 0.5  # the mean of the two CCDs below
_KERNELS: Final = 64  # that are kept: those of the last steps of a fit
_FULLEST: Final = 1.2  # of the full well, beyond which a pixel pushes no more
_LARGEST: Final = 0.1 * _FULLEST  # share that moves at most
_ORDER: Final = 6  # of what noise does in powers of the share: within 1e-6 of it for the largest
_SMALL: Final = 1e-8  # exponent below which e^y − 1 is y
_AGAIN: Final = (1.0, 5.0 / 6.0, 0.5)  # of √((e⁴ˣ − 1)/4x) in powers of x, what a push once does


@dataclass(frozen=True)
class BrighterFatter(KeepsMean, CatalogueEffect):
    """Moves the borders of pixels away from charge: what crosses one is b·z·S·F, z = S/S_FW the fill next to it.

    Charge in the middle of a pixel pushes a border at (x, y) from it by x/(r² + h²)², with a height h for borders
    between columns (x) and one for borders between rows (y); F is the mean of that over the border, as a share of the
    nearest ones. No charge is lost. In an even field the variance falls by 8·b·z, and the covariances have what it
    loses. With a reach of one pixel, and heights alike, four neighbours share it: 2·b·z each.

    Source: Antilogus et al. (2014), JINST 9 C03048; Guyonnet et al. (2015), A&A 575 A41, whose borders move likewise.
    The field falls by r⁻³ here: between the r⁻⁴ of a charge above its image in the gates and the r⁻² that is left of
    it once summed over a drift through thick silicon.
    """

    name = "brighter_fatter"
    stage = Stage.WELL
    unit_in = unit_out = ELECTRONS
    where = "signal"
    block = "neighbour"
    also = ("variance",)
    trials = ({"share": 0.005}, {"share": 0.02})
    fitted = ("share", "edge_fill")
    settles = "neighbour correlation over a photon-transfer series"
    share: float = parameter(0.0, "1", 0.0, 0.1, source="at full well; below 1 % for small CMOS pixels")
    edge_fill: float = parameter(0.2, "1", 0.0, 1.0, source="fill on both sides of an edge over the brightest patch's")
    reach_px: float = parameter(1.0, "px", 1.0, 16.0, source="1 for the nearest borders alone; CCDs show lags of 4")
    height_x_px: float = parameter(_STARTING_PX, "px", 0.05, 3.0, source="two CCDs of 10 µm: 0.54 and 0.57")
    height_y_px: float = parameter(_STARTING_PX, "px", 0.05, 3.0, source="the same two: 0.44 and 0.47")

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the electrons after the exchange: what leaves one pixel is in the next."""
        push = self._push()
        fill = self._moved_share(signal, context)
        fill_x, fill_y = 0.5 * (fill[:, 1:] + fill[:, :-1]), 0.5 * (fill[1:] + fill[:-1])
        result, moved = np.array(signal), signal
        for part in _AGAIN:
            moved = _pushed(moved, push, fill_x, fill_y)
            result += part * moved
        return result

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments of a tile whose pixels exchange charge.

        The temporal noise of a flat as it gathers; a fixed pattern loses alike, to first order in the share.
        """
        push = self._push()
        share = self._moved_share(before.mean, context)
        kept = 1.0 + share * _powers(push.own, share)
        edge = self.edge_fill * push.last_line * np.max(share, axis=(-2, -1), keepdims=True)
        return after.changed(
            variance=after.variance * kept,
            spatial_variance=after.spatial_variance * kept,
            neighbour_x=after.neighbour_x + share * _powers(push.right, share) * after.variance,
            neighbour_y=after.neighbour_y + share * _powers(push.below, share) * after.variance,
            beyond_x=after.beyond_x + share * _powers(push.beyond_x, share) * after.variance,
            beyond_y=after.beyond_y + share * _powers(push.beyond_y, share) * after.variance,
            beyond_rows=after.beyond_rows + share * _powers(push.beyond_rows, share) * after.variance,
            edge_share=before.edge_share + edge,
        )

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        return () if self.reach_px > 1.0 else (self.with_parameters(reach_px=_FAR_PX),)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: heights only where a push reaches beyond the nearest borders."""
        return (*self.fitted, "height_x_px", "height_y_px") if self.reach_px > 1.0 else self.fitted

    def slopes_per_e(self, full_well_e: float) -> Signal:
        """Return d(covariance/mean)/d(mean) of even fields in 1/e⁻ by lag, (rows, columns), lag 0 in the middle.

        To first order in the share: what tables of measured covariances list.

        Args:
            full_well_e: The full well that the share is stated at, in electrons.
        """
        return np.asarray(2.0 * self.share / full_well_e * self._push().kernel)

    def _moved_share(self, signal: Signal, context: ExposureContext) -> Signal:
        return np.asarray(self.share * np.clip(signal / well_e(context), 0.0, _FULLEST), dtype=signal.dtype)

    def _push(self) -> Push:
        return push_of(round(self.reach_px), self.height_x_px, self.height_y_px)


class Push(NamedTuple):
    """What the charge of a pixel moves, for a share of 1."""

    across: Signal  # through borders between columns, rightwards, (rows, borders), the pixel in the middle
    down: Signal  # through borders between rows, downwards, (borders, columns)
    own: Signal  # what the noise of a flat gains in variance, over the share, by powers of the share over the largest
    right: Signal  # what it has as covariance with the right neighbour, likewise
    below: Signal  # the same of the pixel below
    beyond_x: Signal  # the same of all that are farther right in the row, summed
    beyond_y: Signal  # the same of all that are farther down in the column
    beyond_rows: Signal  # the same of all in the rows below, but for the pixel below
    last_line: float  # what the last line of pixels inside a straight border of a patch loses of the step there

    @property
    def kernel(self) -> Signal:
        """Return what each pixel receives, κ, (rows, columns)."""
        side = self.across.shape[1] + 1
        received = np.zeros((side, side))
        received[1:-1, :-1] -= self.across
        received[1:-1, 1:] += self.across
        received[:-1, 1:-1] -= self.down
        received[1:, 1:-1] += self.down
        return received


@lru_cache(maxsize=_KERNELS)
def push_of(reach: int, height_x_px: float, height_y_px: float) -> Push:
    """Return what a pixel's charge moves through the borders around it; the four nearest get 4 together.

    Args:
        reach: Columns and rows of borders on each side that are moved.
        height_x_px: Height over the charge at which borders between columns are decided, in pixels.
        height_y_px: The same of borders between rows.
    """
    across, down = _field(reach, height_x_px), _field(reach, height_y_px).T
    nearest = 0.5 * (across[reach - 1, reach] + down[reach, reach - 1])
    none = np.zeros(0)
    bare = Push(across / nearest, down / nearest, none, none, none, none, none, none, 0.0)
    noise = _of_gathered_noise(bare.kernel)
    edge = float(0.5 * (np.sum(bare.across[:, reach]) + np.sum(bare.down[reach])))
    return bare._replace(**noise, last_line=edge)


def _of_gathered_noise(kernel: Signal) -> dict[str, Signal]:
    """Return (variance − 1), and covariances, over the share, as polynomials of it, by their names in `Push`.

    The mean over all waves of ((e^y − 1)/y − 1)/b, y = 4·b·κ, at as many shares as the polynomial has terms. Waves that
    run across a line alone hold the sum over all its pixels, and the one that does not vary that over all pixels.
    """
    side = 4 * kernel.shape[0]
    wide = np.zeros((side, side))
    reach = kernel.shape[0] // 2
    wide[: kernel.shape[0], : kernel.shape[1]] = kernel
    waves = np.fft.fft2(np.roll(wide, (-reach, -reach), (0, 1))).real
    turned = np.cos(2.0 * np.pi * np.arange(side) / side)
    shares = _LARGEST * (0.5 - 0.5 * np.cos(np.pi * (np.arange(_ORDER + 1) + 0.5) / (_ORDER + 1)))
    y = 4.0 * shares[:, None, None] * waves
    y = np.where(np.abs(y) < _SMALL, _SMALL, y)
    gained = (np.expm1(y) / y - 1.0) / shares[:, None, None]
    own, right, below = (np.mean(gained * by, axis=(1, 2)) for by in (1.0, turned, turned[:, None]))
    row, column, everything = gained[:, :, 0].mean(axis=1), gained[:, 0].mean(axis=1), gained[:, 0, 0]
    sums = {
        "own": own,
        "right": right,
        "below": below,
        "beyond_x": 0.5 * (row - own) - right,
        "beyond_y": 0.5 * (column - own) - below,
        "beyond_rows": 0.5 * (everything - row) - below,
    }
    powers = np.vander(shares / _LARGEST, increasing=True)
    return dict(zip(sums, np.linalg.solve(powers, np.stack([*sums.values()], axis=1)).T, strict=True))


def _powers(factors: Signal, share: Signal) -> Signal:
    """Return a polynomial of the share over the largest."""
    return cast(Signal, np.polynomial.polynomial.polyval(share / _LARGEST, factors))


def _field(reach: int, height_px: float) -> Signal:
    """Return the mean of x/(r² + h²)² over each border between columns, (rows, borders)."""
    x = np.arange(-reach, reach) + 0.5
    y = np.arange(1 - reach, reach)[:, None]
    s2 = np.square(x) + height_px**2

    def up_to(end: Signal) -> Signal:
        """Return ∫ dy/(s² + y²)² from 0."""
        return np.asarray(end / (2.0 * s2 * (s2 + np.square(end))) + np.arctan(end / np.sqrt(s2)) / (2.0 * s2**1.5))

    return np.asarray(x * (up_to(y + 0.5) - up_to(y - 0.5)))


def _pushed(charge: Signal, push: Push, fill_x: Signal, fill_y: Signal) -> Signal:
    """Return what each pixel gains where all push once, by the fill at each border; the sum is nothing."""
    crossing_x = fill_x * _through_borders(charge, push.across)[:, :-1]
    crossing_y = fill_y * _through_borders(charge.T, push.down.T).T[:-1]
    gained = np.zeros_like(charge)
    gained[:, :-1] -= crossing_x
    gained[:, 1:] += crossing_x
    gained[:-1] -= crossing_y
    gained[1:] += crossing_y
    return gained


def _through_borders(charge: Signal, across: Signal) -> Signal:
    """Return what all pixels push through the border behind each pixel of a row, for a share of 1."""
    middle = across.shape[0] // 2
    turned = np.ascontiguousarray(across[::-1, ::-1])
    pushed = cv2.filter2D(
        np.ascontiguousarray(charge), -1, turned, anchor=(middle, middle), borderType=cv2.BORDER_REPLICATE
    )
    return cast(Signal, pushed)

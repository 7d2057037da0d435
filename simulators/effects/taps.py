"""What differs between the taps of a sensor: its quarters that four amplifiers read, its halves, or any others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self, cast

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, EXPOSURE, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, Offset, Scaling
from simulators.effects.context import ExposureContext, Signal

# Starting points: halves side by side, halves on top of each other, and one quarter of four.
ARRANGEMENTS: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.5, 0.5, 0.5))


def trials(sizes: tuple[float, ...], names: tuple[str, str, str]) -> tuple[dict[str, float], ...]:
    """Return starts of each size in each arrangement, for parameters of these names."""
    return tuple(
        {name: size * part for name, part in zip(names, parts, strict=True)} for size in sizes for parts in ARRANGEMENTS
    )


def by_quarter(context: ExposureContext, across: float, along: float, corner: float) -> Any:
    """Return a·s_x + b·s_y + c·s_x·s_y, s −1 in the left and upper half of the sensor and 1 in the other.

    Args:
        across: a, half the difference between right and left.
        along: b, half the difference between below and above.
        corner: c, which one diagonal has more than the other.
    """
    geometry = context.geometry
    right = np.where(geometry.x_px < 0.5 * (geometry.sensor_width - 1), -1.0, 1.0)
    below = np.where(geometry.y_px < 0.5 * (geometry.sensor_height - 1), -1.0, 1.0)
    return across * right + along * below + corner * right * below


class OfTaps(CatalogueEffect):
    """An effect whose size is even within each tap: of quarters and halves by three parameters, of others by a table.

    Attributes:
        table: Name of the parameter that holds a size for every tap that the camera describes, in its order.
        table_start: Size of each tap from which a table starts.
        first_fitted: First tap whose size is fitted: the second where only differences count.
    """

    table: ClassVar[str]
    table_start: ClassVar[float] = 0.0
    first_fitted: ClassVar[int] = 1

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether the camera is described with taps: one amplifier has none that could differ."""
        return len(context.camera.taps or ()) > 1

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the table where some taps share a quarter of the sensor."""
        taps, geometry = context.camera.taps or (), context.geometry
        quarters = {
            (2 * tap.x + tap.width < geometry.sensor_width, 2 * tap.y + tap.height < geometry.sensor_height)
            for tap in taps
        }
        return (cls(**{cls.table: (cls.table_start,) * len(taps)}),) if len(taps) > len(quarters) else ()

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the table where there is one, from `first_fitted` on."""
        sizes = getattr(self, self.table)
        return (
            tuple(f"{self.table}[{index}]" for index in range(self.first_fitted, len(sizes))) if sizes else self.fitted
        )

    def sizes(self, context: ExposureContext) -> Any:
        """Return the size at every place, less the mean of the taps."""
        sizes = getattr(self, self.table)
        if not sizes:
            return by_quarter(context, *(getattr(self, name) for name in self.fitted))
        x, y = context.geometry.x_px, context.geometry.y_px
        found = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
        for tap, size in zip(context.camera.taps or (), sizes, strict=True):
            across = (x > tap.x - 0.5) & (x < tap.x + tap.width - 0.5)  # pixels have whole numbers in their middle
            found = np.where(across & (y > tap.y - 0.5) & (y < tap.y + tap.height - 0.5), size - np.mean(sizes), found)
        return found


@dataclass(frozen=True)
class TapGain(OfTaps, Scaling):
    """Scales electrons behind the noise by a factor that is even within each quarter: 1 + a·s_x + b·s_y + c·s_x·s_y.

    Noise is scaled as well, by which it differs from light that is uneven.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 2; typical 1 to 10 % between amplifiers.
    """

    name = "tap_gain"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "image_x"
    block = "slope"
    also = ("mean", "variance")
    is_steep = True
    signal_power = 1
    trials = trials((0.02, -0.02), ("across_rel", "along_rel", "corner_rel"))
    fitted = ("across_rel", "along_rel", "corner_rel")
    table = "taps_rel"
    settles = "an even field, once as it is and once with the camera turned"
    across_rel: float = parameter(0.0, "1", -0.4, 0.4, source="1 to 10 % between amplifiers")
    along_rel: float = parameter(0.0, "1", -0.4, 0.4, source="1 to 10 % between amplifiers")
    corner_rel: float = parameter(0.0, "1", -0.1, 0.1, source="1 to 10 % between amplifiers")
    taps_rel: tuple[float, ...] = parameter((), "1", -0.4, 0.4, source="of every tap")

    def factor(self, context: ExposureContext) -> Any:
        return 1.0 + self.sizes(context)


@dataclass(frozen=True)
class TapNoise(KeepsMean, OfTaps):
    """Adds normal noise that is even within each quarter: σ² = D − min D, D = a·s_x + b·s_y + c·s_x·s_y.

    The quietest quarter has the noise that is stated; more noise in all of them is `excess_read_noise`. A table holds
    what each tap adds to the stated noise: which tap is the quietest is not assumed while they are fitted.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 2: each output amplifier has its own noise.
    """

    name = "tap_noise"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "image_x"
    block = "variance"
    trials = trials((4.0, -4.0), ("across_e2", "along_e2", "corner_e2"))
    fitted = ("across_e2", "along_e2", "corner_e2")
    table = "taps_e2"
    table_start = 4.0
    first_fitted = 0
    settles = "many frames of no exposure"
    across_e2: float = parameter(0.0, "e-2", -1e5, 1e5, source="engineering prior; refined on a real rig")
    along_e2: float = parameter(0.0, "e-2", -1e5, 1e5, source="engineering prior; refined on a real rig")
    corner_e2: float = parameter(0.0, "e-2", -1e5, 1e5, source="engineering prior; refined on a real rig")
    taps_e2: tuple[float, ...] = parameter((), "e-2", -100000.0, 100000.0, source="of every tap")

    def reach(self, parameter: str, full_scale_dn: float) -> tuple[float, float]:
        """Return the bounds of a fit; those of a table begin at no noise."""
        low, high = super().reach(parameter, full_scale_dn)
        return (0.0, high) if parameter == self.table else (low, high)

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        sigma = np.sqrt(self.variance(signal, context))
        return cast(Signal, (signal + sigma * rng.standard_normal(signal.shape)).astype(signal.dtype))

    def variance(self, signal: Signal, context: ExposureContext) -> Any:
        if self.taps_e2:
            return self.sizes(context) + np.mean(self.taps_e2) - min(0.0, *self.taps_e2)
        a, b, c = self.across_e2, self.along_e2, self.corner_e2
        return self.sizes(context) - min(a + b + c, a - b - c, b - a - c, c - a - b)


@dataclass(frozen=True)
class TapNonlinearity(OfTaps):
    """Bends the signal by an amount that is even within each quarter: n' = n·(1 + q·n/n_full), q from the quarter.

    q = a·s_x + b·s_y + c·s_x·s_y, and n_full is the full well.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 2; typical 0.1 to 3 % at full well.
    """

    name = "tap_nonlinearity"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "signal"
    block = "mean"
    also = ("slope",)
    is_steep = True
    log_prior_odds = -1.0
    prior_reason = "amplifiers of one sensor mostly bend alike"
    trials = trials((0.01, -0.01), ("across_rel", "along_rel", "corner_rel"))
    fitted = ("across_rel", "along_rel", "corner_rel")
    table = "taps_rel"
    settles = "even fields of many levels up to full well"
    across_rel: float = parameter(0.0, "1", -0.3, 0.3, source="0.1 to 3 % at full well")
    along_rel: float = parameter(0.0, "1", -0.3, 0.3, source="0.1 to 3 % at full well")
    corner_rel: float = parameter(0.0, "1", -0.3, 0.3, source="0.1 to 3 % at full well")
    taps_rel: tuple[float, ...] = parameter((), "1", -0.3, 0.3, source="of every tap")

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether there are several amplifiers, and the full well is known, in shares of which the bend is."""
        return super().usable(context) and context.camera.full_well_e is not None

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, (signal * (1.0 + self._bend(context) * signal)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        return 1.0 + 2.0 * self._bend(context) * signal

    def _bend(self, context: ExposureContext) -> Any:
        return self.sizes(context) / (context.camera.full_well_e or 1.0)


@dataclass(frozen=True)
class TapOffset(OfTaps, Offset):
    """Adds an offset that is even within each quarter: y' = y + a·s_x + b·s_y + c·s_x·s_y.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 2: each output amplifier has its own video chain.
    """

    name = "tap_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "image_x"
    block = "mean"
    also = ("slope",)
    is_steep = True
    signal_power = 0
    trials = trials((2.0, -2.0), ("across_dn", "along_dn", "corner_dn"))
    fitted = ("across_dn", "along_dn", "corner_dn")
    table = "taps_dn"
    settles = "an average of many frames of no exposure"
    across_dn: float = parameter(0.0, "DN", -0.1, 0.1, source="some DN to hundreds", of_full_scale=True)
    along_dn: float = parameter(0.0, "DN", -0.1, 0.1, source="some DN to hundreds", of_full_scale=True)
    corner_dn: float = parameter(0.0, "DN", -0.1, 0.1, source="some DN to hundreds", of_full_scale=True)
    taps_dn: tuple[float, ...] = parameter((), "DN", -0.1, 0.1, source="of every tap", of_full_scale=True)

    def offset(self, context: ExposureContext) -> Any:
        return self.sizes(context)


@dataclass(frozen=True)
class HalfTiming(Scaling):
    """Exposes the halves of a sensor for t − τ and t + τ, one above the other or side by side: H' = H·(t ± τ)/t.

    Source: sensors that are read from both ends start and stop each half by signals of its driver; typical 1 to 100 µs.
    """

    name = "half_timing"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "slope"
    also = ("mean",)
    is_steep = True
    signal_power = 1
    log_prior_odds = -1.0
    prior_reason = "most sensors have one driver of the shutter"
    trials = tuple({"half_s": size, "sideways": side} for side in (0.0, 1.0) for size in (1e-05, -1e-05))
    fitted = ("half_s",)
    settles = "an even field at exposures down to ten times the difference"
    half_s: float = parameter(0.0, "s", -0.01, 0.01, source="half the difference between below and above: 1 to 100 µs")
    sideways: float = parameter(0.0, "1", 0.0, 1.0, source="1 where the halves are side by side: right against left")

    def factor(self, context: ExposureContext) -> Any:
        added = by_quarter(context, self.sideways * self.half_s, (1.0 - self.sideways) * self.half_s, 0.0)
        return np.maximum(1.0 + added / context.settings.exposure_s, 0.0)

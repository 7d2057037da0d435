"""The black level, and what is wrong with it."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np

from radiometer.units import gain_factor
from simulators.effects.base import DIGITAL_NUMBER, Moments, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect, Offset, declared_dark_e, gain_of, warmer_k
from simulators.effects.codes import rounded
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.saturation import censored_above, censored_below, is_reached, limited, unevenly_limited
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class BlackLevel(UnitSlope):
    """Adds the black level of the frame's settings, in native DN; its own value where the settings give none."""

    name = "black_level"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    black_level_dn: float = parameter(
        0.0, "DN", 0.0, 1.0, source="datasheet; used where the frame gives none", of_full_scale=True
    )

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        level = context.settings.black_level_dn
        return signal + (self.black_level_dn if level is None else level)


@dataclass(frozen=True)
class BlackLevelOffset(Offset):
    """Adds a constant to every value: y' = y + b + g·x + h·y; g and h are 0 for the same everywhere.

    x and y run from −1 to 1 over the sensor's longer side.

    Source: EMVA Standard 1288, release 4.0, mu_y.dark; typical 0.5 to 20 DN.
    """

    name = "black_level_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "signal"
    block = "mean"
    trials = ({"offset_dn": 1.0}, {"offset_dn": -1.0}, {"offset_dn": 10.0})
    fitted = ("offset_dn",)
    further = ({"tilt_x_dn": 0.02, "tilt_y_dn": 0.02},)
    settles = "dark frames at the shortest exposure at three gains"
    offset_dn: float = parameter(
        0.0, "DN", -1.0, 1.0, source="engineering prior; refined on a real rig", of_full_scale=True
    )

    tilt_x_dn: float = parameter(0.0, "DN", -0.025, 0.025, source="amplifiers settle along a line", of_full_scale=True)
    tilt_y_dn: float = parameter(0.0, "DN", -0.025, 0.025, source="references sag along a frame", of_full_scale=True)

    def offset(self, context: ExposureContext) -> Any:
        if not (self.tilt_x_dn or self.tilt_y_dn):
            return self.offset_dn
        x, y = context.geometry.sensor_xy()
        return self.offset_dn + self.tilt_x_dn * x + self.tilt_y_dn * y


_MOST_GAINS: Final = 16  # more are a sweep: a start at each would only cost time
_BEND: Final = 0.01  # from which a fit begins


@dataclass(frozen=True)
class BlackLevelGainSlope(Offset):
    """Adds an offset that the gain amplifies: y' = y + b·(G − 1 + c·(G − 1)²), G = 10^(g/20), g from where it begins.

    It begins at 0 dB where one amplifier does it all; an offset behind the first of two meets the second's gain alone.
    c is 0 where the offset is the same at every gain.

    Source: an amplifier offset referred to its input; at 0 dB it is part of the black level.
    """

    name = "black_level_gain_slope"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "gain_db"
    block = "mean"
    trials = ({"slope_dn": 0.5}, {"slope_dn": -0.5}, {"slope_dn": 5.0})
    fitted = ("slope_dn",)
    varies = "gain_db"
    settles = "dark frames at the shortest exposure over all gains"
    slope_dn: float = parameter(
        0.0, "DN", -0.25, 0.25, source="engineering prior; refined on a real rig", of_full_scale=True
    )

    from_db: float = parameter(0.0, "dB", 0.0, 100.0, source="cameras mix analog and digital gain")

    bend: float = parameter(0.0, "1", -1.0, 1.0, source="an amplifier's offset moves with its feedback")

    def offset(self, context: ExposureContext) -> Any:
        more = np.maximum(gain_of(context) / 10.0 ** (self.from_db / 20.0), 1.0) - 1.0
        return self.slope_dn * (more + self.bend * np.square(more))

    def free(self) -> tuple[str, ...]:
        return ("slope_dn", "bend") if self.bend else ("slope_dn",)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return amplifiers that begin at each of the gains in use but the highest two."""
        gains = np.unique(np.asarray(context.settings.gain_db))
        return tuple(cls(0.5, g) for g in gains[1:-2].tolist() if g > 0) if gains.size <= _MOST_GAINS else ()

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the same in place of one amplifier, and one amplifier with a bend."""
        if self.from_db or self.bend:
            return ()
        later = (form.with_parameters(slope_dn=self.slope_dn) for form in self.covers(context))
        return (*later, self.with_parameters(bend=_BEND))


@dataclass(frozen=True)
class BlackLevelDrift(Offset):
    """Adds an offset that depends on the temperature: y' = y + c·(T − T₀) + q·(T − T₀)²; q is 0 for a plain drift.

    Source: typical 0.01 to 0.3 DN/K where no optical black is subtracted.
    """

    name = "black_level_drift"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "temperature_C"
    block = "mean"
    trials = (
        {"drift_dn_per_K": 0.1, "reference_C": 25.0},
        {"drift_dn_per_K": -0.1, "reference_C": 25.0},
        {"drift_dn_per_K": 0.1, "reference_C": 35.0},
        {"drift_dn_per_K": -0.1, "reference_C": 35.0},
    )
    fitted = ("drift_dn_per_K", "reference_C")
    varies = "temperature_C"
    further = ({"bend_dn_per_K2": 0.001},)
    settles = "dark frames at the shortest exposure at three temperatures"
    drift_dn_per_K: float = parameter(  # noqa: N815
        0.0, "DN/K", -0.0125, 0.0125, source="engineering prior; refined on a real rig", of_full_scale=True
    )
    reference_C: float = parameter(25.0, "°C", -60.0, 120.0, source="temperature at which the stated black level holds")  # noqa: N815

    bend_dn_per_K2: float = parameter(  # noqa: N815
        0.0, "DN/K²", -0.00125, 0.00125, source="leakage in the black clamp grows with heat", of_full_scale=True
    )

    def offset(self, context: ExposureContext) -> Any:
        warmer = warmer_k(context, self.reference_C)
        return self.drift_dn_per_K * warmer + self.bend_dn_per_K2 * warmer**2


_STRIPS: Final = 64  # of a tile, for the law may fall within few pixels
_PLACES: Final = (2.0 * np.arange(_STRIPS) + 1.0) / _STRIPS - 1.0  # their middles, −1 to 1
_SURFACE, _ = np.linalg.qr(np.vander(_PLACES, 3, increasing=True))  # what a quadratic surface may be along a tile
_GAUSS: Final = 1.0 / math.sqrt(3.0)  # points of a Gauss-Legendre rule of two
_SLOW_PART: Final = 0.1  # of the quick part, from which a fit of the slow one begins
_LONGER: Final = 8.0  # times the quick decay, from which a fit of the slow one begins


@dataclass(frozen=True)
class LineStartOffset(Offset):
    """Adds an offset that dies away along each line: y' = y + a·exp(−x/d), x the share of the line that was read.

    It is there in a frame of no exposure, alike in all lines, at every exposure and temperature. A chain that settles
    quickly and is clamped slowly has a second part, b·exp(−x/s), which the quick one may overshoot.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 6: the video chain settles after the pause between
    two lines; an SBIG STL-1001E begins its lines 14 DN high and comes down within 0.13 of them. A Basler CCD (EMVA 1288
    reference set 1) begins 1.5 DN low, is 0.2 DN high after a tenth of the line, and comes back within a third of it.
    """

    name = "line_start_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "image_x"
    block = "mean"
    also = ("slope",)
    log_prior_odds = -1.0
    prior_reason = "most converters begin behind the settling; of an uneven scene light can look the same"
    trials = tuple(
        {"offset_dn": size, "decay_share": share, "from_right": side}
        for share in (0.03, 0.15)
        for side in (0.0, 1.0)
        for size in (1.0, -1.0)
    )
    fitted = ("offset_dn", "decay_share")
    settles = "an average of many frames of no exposure, with masked or overscanned columns at both ends of the lines"
    offset_dn: float = parameter(0.0, "DN", -0.05, 0.05, source="tenths of a DN to tens of DN", of_full_scale=True)
    decay_share: float = parameter(
        0.15, "1", 0.01, 0.5, source="share of a line; a shorter one is only a few columns, a longer one a tilt"
    )
    from_right: float = parameter(0.0, "1", 0.0, 1.0, source="1 where a line is read from its last column on")
    slow_dn: float = parameter(0.0, "DN", -0.05, 0.05, source="a clamp's: tenths of a DN", of_full_scale=True)
    slow_share: float = parameter(0.3, "1", 0.1, 1.0, source="share of a line; a longer one is a tilt")

    def free(self) -> tuple[str, ...]:
        return (*self.fitted, "slow_dn", "slow_share") if self.slow_dn else self.fitted

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return settlings with a slow part of either sign and the quick one."""
        if self.slow_dn:
            return ()
        size, longer = _SLOW_PART * abs(self.offset_dn), min(max(_LONGER * self.decay_share, 0.2), 1.0)
        return tuple(self.with_parameters(slow_dn=sign * size, slow_share=longer) for sign in (1.0, -1.0))

    def offset(self, context: ExposureContext) -> Any:
        """Return the offset in DN: of a pixel, or at the points of tiles with their true mean and slope."""
        along = self._read_share(context)
        at = self._in_strips(context)
        if at is None:
            return self._law(along)
        mean, rise = at.mean(axis=-1, keepdims=True), (at @ _PLACES / float(_PLACES @ _PLACES))[..., None]
        side = np.sign(along - along.mean(axis=-1, keepdims=True))
        return mean + _GAUSS * rise * side

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with what a quadratic surface leaves of the fall in each tile, alike in all rows."""
        at = self._in_strips(context)
        if at is None:
            return after
        left = at - (at @ _SURFACE) @ _SURFACE.T
        columns = np.mean(np.square(left), axis=-1, keepdims=True).mean(axis=-2, keepdims=True)
        return after.changed(fixed_column_variance=before.fixed_column_variance + columns)

    def _law(self, along: Any, half_strip: Any = None) -> Any:
        """Return the offset in DN; of strips ±r wide their mean, for that of exp is sinh(r)/r times its middle."""
        quick = _settling(along, self.offset_dn, self.decay_share, half_strip)
        return quick + _settling(along, self.slow_dn, self.slow_share, half_strip) if self.slow_dn else quick

    def _read_share(self, context: ExposureContext) -> Any:
        """Return which share of its line was read before each pixel or point."""
        geometry = context.geometry
        share = (geometry.x_px + 0.5) / geometry.sensor_width
        return 1.0 - share if self.from_right else share

    def _in_strips(self, context: ExposureContext) -> Any:
        """Return the mean offset of each of the tiles' strips in DN; None for the pixels of a frame."""
        height: Any = getattr(context, "tile_height", None)
        if height is None:
            return None
        half = 0.5 * getattr(context, "tile_pixels", 1.0) / height / context.geometry.sensor_width
        middle = self._read_share(context).mean(axis=-1, keepdims=True)
        return self._law(middle + half * _PLACES, half / _STRIPS)


def _settling(along: Any, size: float, share: float, half_strip: Any) -> Any:
    wider = 1.0 if half_strip is None else np.sinh(half_strip / share) * share / half_strip
    return size * np.exp(-along / share) * wider


_FAR_SIGMAS = 9.0  # above zero, beyond which nothing is cut


@dataclass(frozen=True)
class DarkFrameSubtracted(CatalogueEffect):
    """Subtracts the mean of n dark frames and keeps a pedestal p: y' = max(y − d̄ + p, 0), d̄ in whole codes.

    The darks have the frame's exposure, gain and temperature. What they hold on average goes: black level and dark
    charge as the camera's description has them, and all patterns of the dark. The darks' noise replaces it, and is
    the same in all frames of that setting. It has whole codes of variance s·K²·(σ_r² + μ_d) + (s − s²)/12 before they
    are rounded, s = 1/n, with read noise σ_r and dark electrons μ_d. Each setting has a separate pattern. The highest
    code comes down by what is subtracted, and negative values are cut, pixel by pixel.

    What leaks beyond the description is gone from the mean as well: it shows in the noise alone
    (`dark_current_clamped`). The median of many darks has s = π/(2n); a mean of two is rounded from halves, which
    adds 1/24 DN² more than is stated here.

    Source: Howell (2006), Handbook of CCD Astronomy, 2nd ed., section 4.3 (a calibration frame brings its own noise);
    Janesick (2001), Scientific Charge-Coupled Devices, on removing fixed pattern noise by subtracting frames.
    """

    name = "dark_frame_subtracted"
    stage = Stage.DIGITAL
    unit_in = unit_out = DIGITAL_NUMBER
    where = "exposure_s"
    block = "mean"
    also = ("spatial",)
    is_stepwise = True
    essential = ("share",)  # without noise of its own it is a black level taken off
    trials = ({"share": 1.0, "pedestal_dn": 0.0}, {"share": 0.1, "pedestal_dn": 0.0})
    fitted = ("share", "pedestal_dn")
    settles = "dark frames at the shortest and the longest exposure: black level and pattern of both"
    share: float = parameter(1.0, "1", 0.0, 2.0, source="one over the number of darks: 1 (in the camera) to 0.01")
    pedestal_dn: float = parameter(
        0.0, "DN", 0.0, 1.0, source="0, or a round number that keeps noise positive", of_full_scale=True
    )

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return frames of which nothing is kept, and those that keep a small or all of the black level."""
        black = float(np.max(np.nan_to_num(np.asarray(_black_dn(context), dtype=np.float64))))
        pedestals = sorted({0.0, black, 0.5 * black})
        return tuple(cls(share, kept) for kept in pedestals for share in (1.0, 0.1))

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the description says what a dark frame holds: black level, read noise and gain."""
        camera = context.camera
        stated = camera.conversion_gain_e_per_dn is not None and camera.read_noise_e is not None
        return stated and bool(np.any(np.nan_to_num(np.asarray(_black_dn(context), dtype=np.float64)) > 0.0))

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the part above zero, not rounded."""
        return cast(Signal, np.maximum(self._lifted(signal, context), 0.0).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        """Return 1, and 0 where all is cut or the converter is full."""
        inside = (self._lifted(signal, context) > 0) & (signal < context.full_scale_dn)
        return cast(Signal, inside.astype(signal.dtype))

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the frame less the dark of its setting, which is the same for all frames of it."""
        settings = context.settings
        setting = f"{self.name} {settings.exposure_s} {settings.gain_db} {settings.temperature_c}"
        dice = np.random.default_rng((context.device_seed, zlib.crc32(setting.encode())))
        level, variance = self._mean_of_darks(context)
        dark = np.rint(level + np.sqrt(variance) * dice.standard_normal(signal.shape))
        read = np.minimum(signal, context.full_scale_dn)
        return cast(Signal, np.maximum(read - dark + np.rint(self.pedestal_dn), 0.0).astype(signal.dtype))

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        """Return the moments after subtraction: a pattern more, the highest code lower, no value negative."""
        top = float(context.full_scale_dn)
        if is_reached(before, top):
            before = limited(before, lambda tail: censored_above(tail, top))
        level, pattern2 = self._taken(context)
        shifted = _shifted(before, self.pedestal_dn - level)
        spread = np.sqrt(np.maximum(before.variance, 0.0) + pattern2)
        if float(np.min(shifted.mean - _FAR_SIGMAS * spread)) <= 0.0:
            return _cut(shifted, np.sqrt(pattern2))
        after = shifted.changed(spatial_variance=shifted.spatial_variance + pattern2)
        if not isinstance(after, TileMoments):
            return after
        return after.changed(renewed_variance=after.renewed_variance + pattern2)

    def _lifted(self, signal: Signal, context: ExposureContext) -> Any:
        return np.minimum(signal, context.full_scale_dn) - self._taken(context)[0] + self.pedestal_dn

    def _taken(self, context: ExposureContext) -> tuple[Any, Any]:
        """Return mean and variance from pixel to pixel of the whole codes that are taken off, in DN and DN²."""
        level, variance = np.broadcast_arrays(*map(np.atleast_1d, self._mean_of_darks(context)))
        nothing = np.zeros((1,) * level.ndim)
        codes = rounded(Moments(level, variance, nothing, nothing))
        if np.ndim(context.settings.exposure_s):
            return codes.mean, codes.variance
        return codes.mean[0], codes.variance[0]

    def _mean_of_darks(self, context: ExposureContext) -> tuple[Any, Any]:
        """Return level and variance of the mean of n darks in output DN and DN², before it is rounded itself."""
        gain = gain_factor(context.settings.gain_db) / (context.camera.conversion_gain_e_per_dn or 1.0)
        scale, electrons, read = context.output_scale, declared_dark_e(context), context.camera.read_noise_e or 0.0
        one = np.square(gain * scale) * (read**2 + electrons)
        rounding = max(self.share - self.share**2, 0.0) / 12.0  # of each dark; a single one is in whole codes already
        return (_black_dn(context) + gain * electrons) * scale, self.share * one + rounding


def _shifted(before: Moments, by: Any) -> Moments:
    after = before.changed(mean=before.mean + by)
    return after if before.unrounded is None else after.changed(unrounded=_shifted(before.unrounded, by))


def _cut(shifted: Moments, pattern: Any) -> Moments:
    """Return the moments of values with a pattern, cut at zero pixel by pixel."""

    def shifted_by(moments: Moments, sigmas: float) -> Moments:
        moved = moments.changed(mean=moments.mean + sigmas * pattern)
        return limited(moved, lambda tail: censored_below(tail, 0.0))

    if not isinstance(shifted, TileMoments):
        return unevenly_limited(shifted, shifted_by)
    after = cast(TileMoments, unevenly_limited(shifted.changed(limit_variance=0.0), shifted_by))
    left = after.limit_variance  # all of it: what the cut leaves of the pattern
    return after.changed(limit_variance=shifted.limit_variance, renewed_variance=after.renewed_variance + left)


def _black_dn(context: ExposureContext) -> Any:
    level = context.settings.black_level_dn
    return (context.camera.black_level_dn or 0.0) if level is None else level

"""The table of statistics: what each is given for, on what scale it is compared, how far it scatters, when it counts.

A statistic is one row. What is measured and what is predicted carry its name (`CaptureStatistics`,
`Prediction`); everything that goes over statistics goes over this table.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Final

import numpy as np

from radiometer.reconciliation.design import COMB_PERIODS, CaptureStatistics, Design, slope_lengths
from radiometer.reconciliation.lines import RowBins
from radiometer.statistics.chances import log_variance
from radiometer.typing import Array, Mask
from simulators.effects.context import Signal
from simulators.effects.rounding import excess_kurtosis, rounding_amplitude
from simulators.effects.tile_moments import Moments


@dataclass(frozen=True, eq=False)
class Prediction:
    """Expected statistics, named and shaped as in CaptureStatistics; those of several models along a first axis."""

    mean: Array
    slope_x: Array
    slope_y: Array
    variance: Array
    spatial: Array
    neighbour_x: Array
    neighbour_y: Array
    first: Array
    common_variance: Array
    ordered_variance: Array  # (captures, tiles) variance by their order of the frames behind the first, in DN²
    row_variance: Array
    fixed_column_variance: Array
    fixed_row_variance: Array
    edge: Array
    outliers: Array
    unsteady: Array
    comb_step: float
    comb_kept: float
    signal: Array  # (captures, tiles) light signal in electrons, for regressors
    gain: Array  # (captures,) DN per electron
    fixed: Array  # (captures, tiles) fixed-pattern part of `spatial` in DN²
    unrounded: Moments  # moments in DN before they are rounded to whole codes
    band_variance: Array  # (captures, tiles) variance of light that goes as a wave along the rows, in DN²
    band_frequency: float  # periods of that wave per row
    mixed_x: Array  # (captures, tiles) correlation of neighbours in a row that exchange charge, without what rows share
    mixed_y: Array  # the same in a column
    limit_variance: Array  # (captures, tiles) part of `fixed` in DN² that limits which differ from pixel to pixel leave
    renewed_variance: Array  # (captures, tiles) part of it for which each setting has a separate pattern
    beyond_x: Array  # (captures, tiles) sum of the correlations in a row from the second neighbour on, to one side
    beyond_y: Array  # the same in a column
    beyond_rows: Array  # the same with all pixels of the rows below, but for the vertical neighbour
    uneven_noise: Array  # (captures, tiles) standard deviation from pixel to pixel of their temporal variance in DN²

    @cached_property
    def waves(self) -> bool:
        """Return whether any light goes as a wave along the rows."""
        return bool(self.band_variance.any())

    @cached_property
    def mixes(self) -> bool:
        """Return whether any neighbours in a row exchange charge."""
        return bool(self.mixed_x.any())

    @property
    def rounding(self) -> Array:
        """Return how far rounding to whole codes may move the mean, in DN, (captures, tiles)."""
        return of_tiles(rounding_amplitude(self.unrounded), self.mean.shape)

    @property
    def kurtosis(self) -> Array:
        """Return the excess kurtosis that rounding to whole codes gives a pixel's values, (captures, tiles)."""
        return of_tiles(excess_kurtosis(self.unrounded), self.mean.shape)


def of_tiles(values: Signal, shape: tuple[int, ...]) -> Array:
    """Return the mean over the points of each tile, of this shape."""
    values = np.asarray(values, dtype=np.float64)
    if values.shape[-1] == 1:
        found = np.empty(shape)
        found[...] = values[..., 0]
        return found
    return np.asarray(0.25 * (values[..., 0] + values[..., 1] + values[..., 2] + values[..., 3]))


MULTIPLICATIVE: Final = "multiplicative"
ADDITIVE: Final = "additive"
ADDITIVE_GAIN: Final = "additive × gain"

_CLIP_SIGMAS: Final = 5.0
_ZERO_SIGMAS: Final = 4.0  # what is cut off below 0 moves a mean by 7e-6 of the noise
_FEW: Final = 1e-3  # share of clipped samples that does not count as clipping
_COARSE_DN: Final = 0.05  # by which rounding may move a mean where a variance still scatters as a normal one (σ = 0.3)
_FEWEST_CODES: Final = 500  # samples that a histogram needs
_CLEAR_COMB: Final = 0.7  # amplitude from which a spacing of codes is beyond doubt
_CLEAR_LIGHT: Final = 3.0  # sigmas of one pixel by which the brightest patch must stand out to have borders
_SHOT_NOISE: Final = 4.0  # times the read noise's variance
_READ_NOISE_LEFT: Final = 0.5  # of its variance, below which the converter hides it
_FINE_NOISE: Final = 0.5  # standard deviation over code spacing that statistics need to be nearly normal
_MOST_ALIKE: Final = 4  # captures of a setting that count: which tiles are just wide enough is alike in all of them
_LARGEST_COMB_COUNT: Final = 1e5  # beyond it the honest shape of a histogram itself would show
_MANY_OUTLIERS: Final = 1000.0
_TAIL_FORM: Final = 0.1
_ROUNDING_SHARE: Final = 0.1  # of what rounding may move a mean: counts of few electrons are not quite normal
_COMB_SQUARES: Final = np.array([1.0 if period == 2 else 0.5 for period in COMB_PERIODS])  # mean of cos²(2πn/period)


class Given(Enum):
    """Further axis of a statistic: it has one figure for each, per capture."""

    TILE = "tile"
    CAPTURE = "capture"
    PERIOD = "period of a regular histogram"
    ORDER = "spatial frequency of the rows' light"


class Scale(Enum):
    """Scale on which measured and predicted figures are subtracted."""

    PLAIN = "as they are"
    LOGARITHM = "logarithms of variances, freed of the bias of few degrees of freedom"
    LINES = "the same of a profile of lines over what pixels alone give it"
    ROOT = "square roots of counts"
    SCORE = "normal scores of variances of few frames"
    COMB = "Fourier terms of the histogram"


@dataclass(frozen=True, slots=True)
class Statistic:
    """One row of the table."""

    name: str  # name in `CaptureStatistics`, and in results
    given: Given  # what it has figures for
    scale: Scale  # how measured and predicted are compared
    sigma: Callable[[Scatter], Array]  # gives its standard uncertainty on that scale
    usable: Callable[[Counted], Mask]  # gives which of its entries count
    along: tuple[str, ...]  # covariates that it may depend on: a trend must be possible physically
    forms: tuple[str, ...] = (MULTIPLICATIVE,)  # forms that such a trend may have
    family: str = ""  # name of the statistics that it is one direction of
    # Whether it says how much light there is. Noise does so too, but a hundred times worse: a wrong noise figure would
    # pull at the responsivity and show as a disagreement of all means.
    determines_light: bool = False
    follows_light: bool = False  # whether it follows the light of its tile without determining it
    holds_form: bool = False  # whether the form of an accepted effect limits how well it is predicted

    def shape(self, design: Design) -> tuple[int, ...]:
        """Return the shape of its entries, captures first."""
        captures = len(design.captures)
        if self.given is Given.TILE:
            return captures, len(design.tiles)
        if self.given is Given.CAPTURE:
            return (captures,)
        return captures, len(COMB_PERIODS) if self.given is Given.PERIOD else RowBins.of(design).orders


@dataclass(frozen=True, eq=False)
class Counted:
    """Entries that are free of clipping, have freedom left and are not formed by the spacing of the codes."""

    design: Design  # captures and tiles
    seen: CaptureStatistics  # what was measured
    base: Prediction  # prediction that shows where light is cut off

    @cached_property
    def step(self) -> int:
        """Return the spacing of the codes."""
        return seen_step(self.seen)

    @cached_property
    def fine(self) -> Mask:
        """Return where the noise is not hidden below the spacing of the codes."""
        variance = self.base.variance
        return variance > (_FINE_NOISE * self.step) ** 2 if self.step > 1 else np.ones(variance.shape, np.bool_)

    @cached_property
    def inside(self) -> Mask:
        """Return which tiles are clipped neither as measured nor as predicted.

        What is predicted to clip but was not seen to clip counts: it is what a lower full well looks like.
        """
        design, seen, base = self.design, self.seen, self.base
        noise = np.where(np.isfinite(seen.variance), seen.variance, base.variance)
        root = np.sqrt(noise + np.maximum(np.nan_to_num(base.fixed), 0.0))
        found = (seen.mean - _ZERO_SIGMAS * root > 0) & (
            seen.mean + _CLIP_SIGMAS * root < design.header.camera.saturated_dn
        )
        found &= (seen.high < _FEW) & (seen.low < _FEW) & ~partly_at_the_top(design, seen, base)
        found &= base.mean - _ZERO_SIGMAS * np.sqrt(base.variance + base.fixed) > 0
        return np.asarray(found & self.fine)

    @cached_property
    def knee(self) -> Mask:
        """Return where the declared full well just begins to bite: there the variance depends on the light level."""
        well = self.design.header.camera.full_well_e
        if well is None:
            return np.zeros(self.base.signal.shape, dtype=np.bool_)
        sigma = np.sqrt(np.maximum(self.base.signal, 1.0))
        return np.asarray(np.abs(self.base.signal - well) < _CLIP_SIGMAS * sigma)

    @cached_property
    def many(self) -> Mask:
        """Return which captures have several frames, (captures, 1)."""
        return (self.design.frame_count > 1)[:, None]

    @cached_property
    def free(self) -> Mask:
        """Return which tiles are inside, off the knee of the full well, and not cut off by the converter."""
        return self.inside & ~self.knee & ~_cut_off(self.design, self.seen, self.base)

    @cached_property
    def noisy(self) -> Mask:
        """Return which tiles have a temporal variance that scatters as a normal one."""
        seen = np.nan_to_num(self.seen.variance) > 0
        return self.free & self.many & seen & (self.base.rounding < _COARSE_DN)

    @cached_property
    def calm(self) -> Mask:
        """Return which captures' lines of pixels do not feel the spacing of the codes, which they do sooner."""
        return np.asarray((self.base.variance > self.step**2 if self.step > 1 else self.fine).all(axis=1))

    @cached_property
    def whole(self) -> Mask:
        """Return which captures of several frames have lines to compare."""
        return self.many[:, 0] & self.calm

    @cached_property
    def patched(self) -> Mask:
        """Return which captures show even light, or none: without light a scene shows nothing but the sensor."""
        even = ~(self.design.source_level > 0) | self.design.uniform
        return self.inside.any(axis=1) & self.calm & even

    @property
    def quiet(self) -> Mask:
        """Return which captures show the noise of the sensor alone: what a scene left behind is in one frame only."""
        return np.asarray(self.patched & ~(self.design.source_level > 0) & self.noisy.all(axis=1))

    def lines(self, name: str) -> Mask:
        """Return where a profile of lines has freedom left and is above zero."""
        dof, ratio = getattr(self.seen, f"{name}_dof"), getattr(self.seen, name)
        return np.asarray((dof > 4) & (np.nan_to_num(ratio) > 0))

    @property
    def banded(self) -> Mask:
        """Return which captures show waves: the bright rows of a scene's tile are noisier than its mean noise."""
        there = self.design.uniform & self.whole & ~self.knee.any(axis=1)
        return np.isfinite(self.seen.bands) & there[:, None]

    @property
    def combed(self) -> Mask:
        """Return which histograms are full enough, and of which periods; none that holds the highest code of all."""
        highest = np.nan_to_num(self.seen.peak).max(axis=1)  # where light is cut off, few codes occur at the top
        dividing = np.array([self.step == 1 or self.step % period == 0 for period in COMB_PERIODS])
        full = (self.seen.comb_count > _FEWEST_CODES) & (highest < highest.max() - 1.0)
        before = np.tril(np.equal.outer(self.design.setting_id, self.design.setting_id), -1).sum(axis=1)
        return np.asarray((full & (before < _MOST_ALIKE))[:, None] & dividing)

    @property
    def bordered(self) -> Mask:
        """Return in which captures patches have borders of light: in the others the steps are those of a pattern."""
        light = np.max(self.base.signal * self.base.gain[:, None], axis=1)
        clear = light > _CLEAR_LIGHT * np.sqrt(np.median(self.base.variance, axis=1))
        return np.asarray(np.isfinite(self.seen.edge_u) & self.inside.any(axis=1) & clear)


@dataclass(frozen=True, eq=False)
class Scatter:
    """Scatter of the statistics of a correct model, each by itself.

    The weights never come from the prediction under test.
    """

    design: Design  # captures and tiles
    seen: CaptureStatistics  # what was measured; its own scatter from frame to frame gives the weights
    base: Prediction  # prediction, for what a measurement of few frames cannot determine
    known: Mask  # (captures, tiles) whether the measured temporal variance counts

    @cached_property
    def frames(self) -> Array:
        """Return the number of frames, (captures, 1)."""
        return self.design.frame_count[:, None]

    @cached_property
    def noise(self) -> Array:
        """Return the temporal variance of a pixel in DN²."""
        return np.where(self.known, self.seen.variance, self.base.variance)

    @cached_property
    def pixels(self) -> Array:
        """Return the number of pixels that count."""
        return np.maximum(self.seen.pixels, 1.0)

    @cached_property
    def shared(self) -> Array:
        """Return the variance of a tile's sum over that of as many independent pixels.

        Neighbours that move together average out less: a mean scatters more than its pixels' variance predicts.
        """
        base = self.base
        white_x = base.neighbour_x - base.row_variance[:, None] / np.maximum(base.variance, 1e-30)
        return np.maximum(1.0 + 2.0 * (white_x + base.neighbour_y + base.beyond_x + base.beyond_rows), 0.5)

    @cached_property
    def kurtosis(self) -> Array:
        """Return the excess kurtosis that photons and few codes give a pixel's noise."""
        base = self.base
        photons = base.gain[:, None] ** 4 * np.maximum(base.signal, 0.0)
        return np.asarray(np.clip(photons / np.maximum(base.variance, 1e-12) ** 2, 0, 1) + base.kurtosis)

    @cached_property
    def unevenness(self) -> Array | float:
        """Return ⟨v²⟩/⟨v⟩² of the pixels' variances v in each tile of a scene: brighter pixels are noisier.

        The fewer pixels carry the noise, the less sure is its mean.
        """
        if self.design.uniform:
            return 1.0
        structure = _structure_dn2(self.design, self.seen)
        more = 1.0 + self.base.gain[:, None] ** 2 * structure / np.maximum(self.noise, 1e-12) ** 2
        return np.asarray(np.where(self.design.source_level[:, None] > 0, more, 1.0))

    @property
    def mean(self) -> Array:
        """Return that of means in DN."""
        return np.hypot(
            np.sqrt(self.noise * self.shared / (self.pixels * self.frames)), _ROUNDING_SHARE * self.base.rounding
        )

    def slope(self, axis: int) -> Array:
        """Return that of slopes in DN: a tile's time mean scatters from pixel to pixel by its spatial variance."""
        return np.asarray(np.sqrt(self.noise * self.shared / self.frames) / slope_lengths(self.design)[axis])

    @property
    def first(self) -> Array:
        """Return that of the first frame less the mean of the others, in DN."""
        share = 1.0 + 1.0 / np.maximum(self.frames - 1.0, 1.0)
        return np.asarray(np.sqrt(self.noise * self.shared / self.pixels * share))

    @property
    def variance(self) -> Array:
        """Return that of ln of the temporal variance."""
        own = log_variance(self.seen.variance_dof) * self.unevenness
        return np.asarray(np.sqrt(own + self.kurtosis / (self.pixels * self.frames)))

    def neighbours(self, side: str) -> Array:
        """Return that of the correlation of neighbours along a side: a tile has fewer pairs than pixels."""
        length = np.array([getattr(tile, side) for tile in self.design.tiles])
        pairs = np.maximum(self.seen.variance_dof, 1.0) * self.pixels / np.maximum(self.pixels - 1.0, 1.0)
        return np.asarray(np.sqrt(self.unevenness / ((1.0 - 1.0 / length) * pairs)))

    def logarithm(self, name: str) -> Array:
        """Return that of ln of a variance, from its degrees of freedom."""
        return np.sqrt(log_variance(getattr(self.seen, f"{name}_dof")))

    @property
    def comb(self) -> Array:
        """Return that of the histogram's Fourier terms, with what those of an honest scene differ between captures."""
        count = np.minimum(np.maximum(self.seen.comb_count, 1.0), _LARGEST_COMB_COUNT)
        honest = honest_comb(self.design, self.seen, self.base)
        return np.asarray(np.sqrt(_COMB_SQUARES / count[:, None] + honest**2))

    def standing_out(self, name: str) -> Array:
        """Return that of twice the root of their number: 1 of a few, as counts have it.

        Of thousands the form of the tail counts, which no law of two parameters holds better than to a tenth.
        """
        many = np.maximum(np.sqrt(getattr(self.seen, name)) - np.sqrt(_MANY_OUTLIERS), 0.0)
        return np.asarray(np.hypot(1.0, 2.0 * _TAIL_FORM * many))

    def one(self, name: str) -> Array:
        """Return 1 for what is in units of its scatter already."""
        return np.ones(getattr(self.seen, name).shape)


_CAPTURE_AXES: Final = (
    "exposure_s",
    "gain_db",
    "f_number",
    "temperature_C",
    "source_level",
    "timestamp_s",
    "time_waves",
    "pattern",
    "previous_frame",
)
_TILE_AXES: Final = ("signal", "patch_level", "field_radius", "image_x", "image_y", "half_x", "half_y")
_NOISE_AXES: Final = ("constant", "signal", "gain_db", "exposure_s", "temperature_C", "image_y", "half_x", "half_y")
_SLOPE_AXES: Final = ("constant", "image_x", "image_y", "field_radius", "f_number", "exposure_s")
_LINE_AXES: Final = ("constant", "gain_db", "exposure_s")
_NEIGHBOUR_AXES: Final = ("constant", "signal", "gain_db")
_NOISE_FORMS: Final = (MULTIPLICATIVE, ADDITIVE_GAIN)

_ROWS: Final = (
    Statistic(
        "mean", Given.TILE, Scale.PLAIN, lambda s: s.mean, lambda c: c.inside,
        (*_CAPTURE_AXES, *_TILE_AXES, "constant"), (MULTIPLICATIVE, ADDITIVE, ADDITIVE_GAIN),
        determines_light=True, holds_form=True,
    ),
    Statistic(
        "slope_x", Given.TILE, Scale.PLAIN, lambda s: s.slope(0), lambda c: c.inside, _SLOPE_AXES,
        family="slope", determines_light=True, holds_form=True,
    ),
    Statistic(
        "slope_y", Given.TILE, Scale.PLAIN, lambda s: s.slope(1), lambda c: c.inside, _SLOPE_AXES,
        family="slope", determines_light=True, holds_form=True,
    ),
    Statistic(
        "variance", Given.TILE, Scale.LOGARITHM, lambda s: s.variance, lambda c: c.noisy, _NOISE_AXES, _NOISE_FORMS,
        follows_light=True, holds_form=True,
    ),
    Statistic(
        "spatial", Given.TILE, Scale.LOGARITHM, lambda s: s.logarithm("spatial"),
        lambda c: c.free & (c.seen.spatial_dof > 4) & (c.seen.spatial > 0) & (c.base.rounding < _COARSE_DN),
        _NOISE_AXES, _NOISE_FORMS, follows_light=True, holds_form=True,
    ),
    Statistic(
        "neighbour_x", Given.TILE, Scale.PLAIN, lambda s: s.neighbours("width"),
        lambda c: c.noisy & np.isfinite(c.seen.neighbour_x), _NEIGHBOUR_AXES, family="neighbour", holds_form=True,
    ),
    Statistic(
        "neighbour_y", Given.TILE, Scale.PLAIN, lambda s: s.neighbours("height"),
        lambda c: c.noisy & np.isfinite(c.seen.neighbour_y), _NEIGHBOUR_AXES, family="neighbour", holds_form=True,
    ),
    Statistic(
        "first", Given.TILE, Scale.PLAIN, lambda s: s.first, lambda c: c.inside & c.many,
        ("constant", "previous_frame"), (MULTIPLICATIVE, ADDITIVE), holds_form=True,
    ),
    Statistic(
        "common", Given.CAPTURE, Scale.SCORE, lambda s: s.one("common"),
        lambda c: c.whole & np.isfinite(c.seen.common) & (c.base.signal.max(axis=1) > 0),
        ("constant", "exposure_s", "source_level"),
    ),
    Statistic(
        "row_temporal", Given.CAPTURE, Scale.LINES, lambda s: s.logarithm("row_temporal"),
        lambda c: c.whole & c.lines("row_temporal"), _LINE_AXES,
    ),
    Statistic(
        "columns", Given.CAPTURE, Scale.LINES, lambda s: s.logarithm("columns"),
        lambda c: c.patched & c.lines("columns"), _LINE_AXES,
    ),
    Statistic(
        "rows", Given.CAPTURE, Scale.LINES, lambda s: s.logarithm("rows"),
        lambda c: c.patched & c.lines("rows"), _LINE_AXES,
    ),
    Statistic(
        "edge", Given.CAPTURE, Scale.PLAIN, lambda s: np.where(np.isfinite(s.seen.edge_u), s.seen.edge_u, 1.0),
        lambda c: c.bordered, ("constant", "f_number"), holds_form=True,
    ),
    Statistic(
        "outliers", Given.CAPTURE, Scale.ROOT, lambda s: s.standing_out("outliers"), lambda c: c.patched,
        ("constant", "exposure_s", "temperature_C"),
    ),
    Statistic(
        "unsteady", Given.CAPTURE, Scale.ROOT, lambda s: s.standing_out("unsteady"), lambda c: c.quiet,
        ("constant", "exposure_s", "gain_db"),
    ),
    Statistic("comb", Given.PERIOD, Scale.COMB, lambda s: s.comb, lambda c: c.combed, ("constant",)),
    Statistic(
        "bands", Given.ORDER, Scale.SCORE, lambda s: s.one("bands"), lambda c: c.banded,
        ("constant", "exposure_s", "image_y"),
    ),
)  # fmt: skip
STATISTICS: Final[dict[str, Statistic]] = {row.name: row for row in _ROWS}


def family_of(name: str) -> str:
    """Return the name of a statistic without its direction."""
    return STATISTICS[name].family or name


def named(*, given: Given | None = None, scale: Scale | None = None) -> tuple[str, ...]:
    """Return the names of the statistics of a kind, in the order of the table."""
    return tuple(r.name for r in _ROWS if given in (None, r.given) and scale in (None, r.scale))


def usable_entries(design: Design, seen: CaptureStatistics, base: Prediction) -> dict[str, Mask]:
    """Return which entries of each statistic count."""
    counted = Counted(design, seen, base)
    return {row.name: row.usable(counted) for row in _ROWS}


def partly_at_the_top(design: Design, seen: CaptureStatistics, base: Prediction) -> Mask:
    """Return which tiles of a scene are uneven and reach the brightest that was seen at their gain, within the noise.

    If that is where the camera saturates, an unknown part of such a tile does.
    Where samples reach full scale the top is known, and what is clipped there has been counted. Patches are even.
    """
    if design.uniform:
        return np.zeros(seen.mean.shape, dtype=np.bool_)
    uneven = _structure_dn2(design, seen) > base.variance * (1.0 + 1.0 / design.frame_count[:, None])
    found = np.zeros(uneven.shape, dtype=np.bool_)
    for gain_db in np.unique(design.gain_db):
        lit = ((design.gain_db == gain_db) & (design.source_level > 0))[:, None] & (seen.pixels > 0)
        if not lit.any() or float(seen.high[lit].max()) > _FEW:
            continue
        top = float(seen.peak[lit].max())
        noise = float(np.max(base.variance, where=lit & (base.mean <= top), initial=0.0))
        found |= lit & uneven & (seen.peak > top - _CLIP_SIGMAS * np.sqrt(noise))
    return found


def seen_step(seen: CaptureStatistics) -> int:
    """Return the spacing of codes as far as the histograms show it, 1 where all codes occur.

    Where it is wide, noise below half of it leaves nothing normal of a tile, and periods that do not divide it show
    the shape of an honest histogram at an alias.
    """
    many = seen.comb_count > _FEWEST_CODES
    if not many.any():
        return 1
    shown = np.median(seen.comb[many], axis=0) > _CLEAR_COMB
    return math.lcm(*(period for period, clear in zip(COMB_PERIODS, shown, strict=True) if clear))


def _cut_off(design: Design, seen: CaptureStatistics, base: Prediction) -> Mask:
    """Return where light should bring noise and not even read noise is seen: most samples show the highest code."""
    read_e = design.header.camera.read_noise_e
    dark = design.closed | ~(design.source_level > 0)
    seen_e2 = np.nan_to_num(seen.variance[dark] / base.gain[dark, None] ** 2, nan=np.inf)
    least_e2 = float(np.min(seen_e2, initial=np.inf)) if read_e is None else read_e**2
    if not np.isfinite(least_e2):
        return np.zeros(base.signal.shape, dtype=np.bool_)
    hidden = np.nan_to_num(seen.variance) < _READ_NOISE_LEFT * least_e2 * base.gain[:, None] ** 2
    return np.asarray(hidden & (base.signal > _SHOT_NOISE * least_e2))


def honest_comb(design: Design, seen: CaptureStatistics, base: Prediction) -> Array:
    """Return the standard deviation of a Fourier term of honest histograms, (captures, periods).

    In a scene the light scatters the codes where noise need not. Codes of pixels of one phase φ, with Gaussian noise
    of variance v, have the term Σ exp(−2π²·v·f²)·cos φ. The sum is over the frequencies f = 1/period and
    1 − 1/period, which are the same to whole codes. Of any phase that is 1/√2 of its largest. Pixels without light
    have the least noise; where no read noise is declared, the darkest tile as it was seen counts too, clipped or not.
    Patches are even: their noise alone is wide enough.
    """
    periods = np.array(COMB_PERIODS)
    if design.uniform:
        return np.zeros((len(design.captures), periods.size))
    least_dn2 = _noise_without_light(design, base)
    if design.header.camera.read_noise_e is None:
        least_dn2 = np.fmin(
            least_dn2, np.nanmin(seen.variance / base.gain[:, None] ** 2, initial=np.inf) * base.gain**2
        )
    largest = sum(np.exp(-2.0 * np.pi**2 * least_dn2[:, None] * f**2) for f in (1.0 / periods, 1.0 - 1.0 / periods))
    return np.asarray(np.sqrt(0.5) * np.minimum(largest, 1.0))


def _noise_without_light(design: Design, base: Prediction) -> Array:
    """Return the variance of a pixel without light in DN², (captures,): from the darkest capture at each gain."""
    light = base.signal.mean(axis=1)
    dark = np.min(base.variance - base.gain[:, None] ** 2 * np.maximum(base.signal, 0.0), axis=1)
    gains, own = np.unique(design.gain_db, return_inverse=True)
    darkest = [int(np.argmin(np.where(own == gain, light, np.inf))) for gain in range(gains.size)]
    return np.asarray(np.maximum(dark[darkest], 0.0)[own])


def _structure_dn2(design: Design, seen: CaptureStatistics) -> Array:
    """Return the variance of the time mean from pixel to pixel with the tile's tilt, in DN², (captures, tiles)."""
    tilts = [
        (slope * length) ** 2 for slope, length in zip((seen.slope_x, seen.slope_y), slope_lengths(design), strict=True)
    ]
    return np.asarray(np.nan_to_num(seen.spatial + sum(tilts) / np.maximum(seen.pixels, 1.0)))

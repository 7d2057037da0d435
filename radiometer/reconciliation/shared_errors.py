"""Errors that several figures share: y = f(θ) + B·z + ε with z ~ N(0, Φ), each source stating its basis and variance.

An error that is drawn anew in each capture enters the weights of the statistic that it moves (its z integrated out).
One that is the same in all captures, a fixed pattern, is fitted with the parameters, its variance as prior, so that
it neither passes for another effect nor lets one hide. Where one z moves several statistics, the weights hold it in
each of them alone; what that leaves out is added to the parameters' covariance (`left_out`).

Source: noise as bases and weights, as pulsar timing has it (Luo et al. 2021, ApJ 911 45; van Haasteren & Vallisneri
2014, PRD 90 104012).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.design import SURFACE_LINES, CaptureStatistics, Design, slope_lengths
from radiometer.reconciliation.lines import SHARPEST, RowBins, TileBands
from radiometer.reconciliation.repeatability import Darkness, drift_of_black, wander_of_black
from radiometer.reconciliation.statistics import STATISTICS, Prediction, Scale
from radiometer.reconciliation.tile_model import TileModel, Trace
from radiometer.statistics.chances import frames_counted, score_slope
from radiometer.typing import Array, Mask
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Change of one statistic by a shared error: amplitude · basis · z."""

    amplitude: Array  # (captures, entries) in the statistic's own scale; 0 where an entry does not count
    basis: Array  # (entries, n) or (captures, entries, n)

    @property
    def columns(self) -> Array:
        """Return what a unit of each z does, (captures, entries, n)."""
        return np.asarray(self.amplitude[:, :, None] * self.basis)


@dataclass(frozen=True, slots=True, eq=False)
class SharedError:
    """One source of error whose z are drawn anew in each capture."""

    name: str  # what it is
    parts: Mapping[str, Part]  # what it does, by statistic
    variance: Array  # (captures,) variance of each z, or (captures, n)
    # Whether the statistic's own standard uncertainty holds it already, so that it correlates entries only
    within: bool = False

    def covariance(self, name: str) -> Array:
        """Return the covariance of a statistic's entries in each capture, (captures, entries, entries)."""
        part = self.parts[name]
        left = part.basis if self.variance.ndim == 1 else part.basis * self.variance[:, None, :]
        shape = left @ part.basis.swapaxes(-1, -2)
        each = self.variance[:, None, None] if self.variance.ndim == 1 else 1.0
        found = each * shape * (part.amplitude[:, :, None] * part.amplitude[:, None, :])
        if self.within:
            index = np.arange(found.shape[1])
            found[:, index, index] = 0.0
        return np.asarray(found)


def whiteners(
    errors: Sequence[SharedError], deviation: Mapping[str, Array], usable: Mapping[str, Mask]
) -> dict[str, Array]:
    """Return the inverse Cholesky factors of the captures' covariances, of every statistic that shares an error.

    Args:
        deviation: Standard uncertainty of each entry by itself, by statistic.
    """
    found = {}
    for name in dict.fromkeys(name for error in errors for name in error.parts):
        covariance = np.sum([error.covariance(name) for error in errors if name in error.parts], axis=0)
        index = np.arange(usable[name].shape[1])
        covariance[:, index, index] += np.where(usable[name], deviation[name] ** 2, 1.0)
        found[name] = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))
    return found


_LEAST_EXCESS: Final = -0.9  # of a variance ratio, so that it stays positive
_FAIR_SHARE: Final = 0.05  # of the brightest tile's light
_LEAST_ROWS: Final = 1.0
_LEAST_RATIO: Final = 1e-6
_TOGETHER: Final = 0.85  # of the correlation of one wave's scores that is trusted: a cube root is no square


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Scatter of the light from one capture to the next, and from one frame to the next."""

    tau: float  # relative standard deviation from capture to capture
    flicker2: Array  # (captures,) relative variance from frame to frame that an accepted effect predicts
    row_variance: Array  # (captures,) row noise that an accepted effect predicts, in DN²
    bands2: Array  # (captures,) relative variance of light that goes as a wave along the rows
    band_frequency: float  # periods of that wave per row


def shared_errors(
    design: Design,
    base: Prediction,
    usable: Mapping[str, Mask],
    sensitivity: Array,
    repeatability: Repeatability,
    noise_response: Mapping[str, Array],
) -> tuple[SharedError, ...]:
    """Return the sources that the weights of means, slopes and variances hold.

    Args:
        base: Prediction of what is accepted.
        sensitivity: (captures, tiles) d(mean)/d(log light) in DN.
        repeatability: Capture-to-capture and frame-to-frame scatter, the source's own wander included.
        noise_response: (captures, tiles) how far the statistics of a tile's noise follow its log light, by statistic.
    """
    n = design.frame_count
    first = 1.0 + 1.0 / np.maximum(n - 1.0, 1.0)  # of what a frame's tiles share, in the first less the others' mean
    light = {name: np.where(usable[name], sensitivity, 0.0) for name in ("mean", "first", "slope_y")}
    one, shaken2 = np.ones((len(design.tiles), 1)), repeatability.flicker2 / n
    found = [
        SharedError("light of a capture", {"mean": Part(light["mean"], one)}, np.full(n.size, repeatability.tau**2)),
        SharedError("light of its frames", {"mean": Part(light["mean"], one)}, shaken2),
        SharedError("light of its first frame", {"first": Part(light["first"], one)}, repeatability.flicker2 * first),
    ]
    if repeatability.flicker2.any():  # brighter frames have more photon noise, in all tiles alike
        found += [
            SharedError(f"noise of its frames: {name}", {name: Part(np.where(usable[name], by, 0.0), one)}, shaken2)
            for name, by in noise_response.items()
        ]
    if repeatability.row_variance.any():
        found += _row_noise(design, base, usable, repeatability.row_variance)
    if repeatability.bands2.any():
        found += _wave(design, light, repeatability)
    return tuple(found)


def _row_noise(design: Design, base: Prediction, usable: Mapping[str, Mask], variance: Array) -> list[SharedError]:
    n = design.frame_count
    first = 1.0 + 1.0 / np.maximum(n - 1.0, 1.0)
    count = {name: mask.astype(np.float64) for name, mask in usable.items()}
    rows = design.rows_of_tiles
    found = [
        SharedError("row noise", {"mean": Part(count["mean"], rows)}, variance / n),
        SharedError("row noise of the first frame", {"first": Part(count["first"], rows)}, variance * first),
        SharedError("row noise as a tilt", {"slope_y": Part(count["slope_y"], design.tilts_of_rows)}, variance / n),
    ]
    for name, moved in _moved_by_rows(design, base).items():
        spread, taken = _spread_of_rows(design)[name], SURFACE_LINES if name == "spatial" else 1
        part = Part(np.where(usable[name], moved, 0.0), _free_rows(design, taken)[:, None] * rows)
        found.append(SharedError(f"chance variance of rows: {name}", {name: part}, spread))
    return found


def _moved_by_rows(design: Design, base: Prediction) -> dict[str, Array]:
    """Return by how much the logarithms of variances change per relative change of the rows' variance.

    A row's noise differs from frame to frame by one number. Over n frames its variance is known to √(2/(n − 1)) only,
    and that deviation is the same in all tiles side by side and in all statistics. What is left of it in the mean of
    all frames does the same to the spatial variance.
    """
    lines = base.row_variance[:, None]
    share = lines * (1.0 - 1.0 / design.tile_height) / base.variance
    left = lines / design.frame_count[:, None] * design.rough_rows / base.spatial
    return {"variance": share, "neighbour_x": share * (1.0 - share), "neighbour_y": share, "spatial": left}


def _spread_of_rows(design: Design) -> dict[str, Array]:
    """Return the relative variance of what one row shows of its variance, by statistic, (captures,)."""
    frames = np.maximum(design.frame_count, 2.0)
    square = 2.0 / (frames - 1.0)
    products = 1.0 / (frames - 1.0)  # of two rows, not squares of one
    return {"variance": square, "neighbour_x": square, "neighbour_y": products, "spatial": np.full(frames.shape, 2.0)}


def _free_rows(design: Design, taken: int) -> Array:
    """Return √(rows over those that are free where some degrees of freedom were taken), (tiles,)."""
    height = design.tile_height
    return np.asarray(np.sqrt(height / np.maximum(height - taken, _LEAST_ROWS)))


def _wave(design: Design, light: Mapping[str, Array], repeatability: Repeatability) -> list[SharedError]:
    n, left = design.frame_count, TileBands.of(design, repeatability.band_frequency)
    first = 1.0 + 1.0 / np.maximum(n - 1.0, 1.0)
    bands2, mean, rise = repeatability.bands2, left.quadratures(left.mean), left.quadratures(left.rise)
    return [
        SharedError("wave", {"mean": Part(light["mean"], mean)}, bands2 / n),
        SharedError("wave in the first frame", {"first": Part(light["first"], mean)}, bands2 * first),
        SharedError("wave as a tilt", {"slope_y": Part(light["slope_y"], rise)}, bands2 / n),
    ]


def phases_of_wave(design: Design, basis: Array, usable: Mask, share: Array, frequency: float) -> SharedError:
    """Return what the few phases of a wave do to the scores of the bands, which follow one phase of each frame.

    With ρ the correlation of two coefficients of a frame, over n frames their squares have the covariance
    2ρ²/(n − 1) − (½ + ρ²)/n in units of their means.

    Args:
        basis: (captures, 1 + orders, bins) functions of the rows.
        usable: (captures, orders) which scores count.
        share: (captures, orders) share of the wave in each ratio.
        frequency: Periods per row.
    """
    wave = np.exp(2j * np.pi * frequency * RowBins.of(design).middle)
    phase = np.angle(basis[:, 1:] @ wave)  # ρ² = ½ + ½·cos 2(φ − φ')
    n = np.maximum(frames_counted(design.frame_count), 2.0)
    half = 0.5 * (2.0 / (n - 1.0) - 1.0 / n)
    variance = np.stack([half - 0.5 / n, half, half], axis=1) / (2.0 / (n - 1.0) - 1.5 / n)[:, None]
    functions = np.stack([np.ones_like(phase), np.cos(2.0 * phase), np.sin(2.0 * phase)], axis=-1)
    part = Part(np.where(usable, share, 0.0), functions)
    return SharedError("phases of a wave", {"bands": part}, _TOGETHER * variance, within=True)


def unsteady_phases(design: Design, seen: CaptureStatistics, base: Prediction) -> dict[str, Array]:
    """Return by how much few phases of a wave along the rows scatter each entry by itself, by statistic."""
    excess = band_excess(design, seen, base)
    if not excess:
        return {}
    left = TileBands.of(design, base.band_frequency)
    unsteady = left.unsteadiness(design.frame_count)
    within = base.band_variance * left.within / base.variance * unsteady
    lines = {name: np.maximum(more, 0.0) / (1.0 + more) for name, more in excess.items()}
    return {
        "variance": within,
        "neighbour_x": within,
        "neighbour_y": within,
        "spatial": base.band_variance * left.rough / design.frame_count[:, None] / base.spatial,
        "row_temporal": lines["row_temporal"] * unsteady.max(axis=1),
        "rows": lines["rows"],
    }


def chances_of_rows(
    design: Design, seen: CaptureStatistics, base: Prediction, band_freedom: Array
) -> tuple[SharedError, ...]:
    """Return what the rows' chance variance does to all statistics at once, bin of rows by bin of rows.

    First what differs from frame to frame, then what remains in the mean of the frames; the two are independent.

    Args:
        base: The prediction, row noise included.
        band_freedom: (captures, orders) degrees of freedom of the bands.
    """
    if not base.row_variance.any():
        return ()
    bins, of_tiles = RowBins.of(design), _rows_in_bins(design)
    of_all = _line_weights(design, base)[:, None, :]
    moved, spread = _moved_by_rows(design, base), _spread_of_rows(design)
    found = []
    for tiled, lined, taken in (
        (("variance", "neighbour_x"), "row_temporal", 1),
        (("spatial",), "rows", SURFACE_LINES),
    ):
        still = lined == "rows"
        more = base.row_variance / (design.frame_count if still else 1.0) * getattr(seen, f"{lined}_weight")
        # A row's noise times that of its pixels is shared too.
        variance = spread[tiled[0]] * (1.0 + 2.0 / np.maximum(more, _LEAST_RATIO)) / bins.step
        free = _free_rows(design, taken)
        parts = {name: Part(moved[name], free[:, None] * of_tiles) for name in tiled}
        whole = 1.0 + more + (base.fixed_row_variance * seen.rows_weight if still else 0.0)
        parts[lined] = Part((more / whole)[:, None] * float(np.median(free)), of_all)
        if not still:
            bands = base.row_variance[:, None] * seen.bands_of_rows
            parts["bands"] = Part(bands / (1.0 + bands) * score_slope(band_freedom), of_all)
        found.append(SharedError(f"chance variance of rows: {lined}", parts, variance))
    return tuple(found)


# ---- what noise that lines of pixels share adds to the statistics themselves --------------------------------------
# Profiles of rows and columns are ratios over the noise of pixels, which holds the lines' too; bands are spatial
# frequencies of the rows' light.


def line_excess(design: Design, seen: CaptureStatistics, prediction: Prediction, name: str) -> Array:
    """Return what noise and patterns of lines add to the ratio of a profile of lines, (captures,).

    The ratio is taken over the noise of the pixels, which holds the lines too. Row noise averages down over the frames
    of a capture but stays in their mean.

    Args:
        name: row_temporal, rows or columns.
    """
    rows, columns = prediction.row_variance, prediction.fixed_column_variance
    lines = (rows,) if name == "row_temporal" else (rows, columns, prediction.fixed_row_variance)
    if not any(variance.any() for variance in lines):
        return np.zeros(rows.shape)
    if name == "row_temporal":
        own, noise = rows, prediction.variance
        held = rows[..., None] * (1.0 - 1.0 / design.tile_height)
    else:
        fixed_rows = prediction.fixed_row_variance + rows / design.frame_count
        own, noise = (columns if name == "columns" else fixed_rows), prediction.spatial
        held = columns[..., None] * design.rough_columns + fixed_rows[..., None] * design.rough_rows
    share = np.mean(held / noise**2, axis=-1) / np.mean(1.0 / noise, axis=-1)
    return np.asarray(np.maximum(own * getattr(seen, f"{name}_weight") - share, _LEAST_EXCESS))


def mixing_of_lines(prediction: Prediction, design: Design, name: str) -> Array:
    """Return by what pixels that exchange charge raise the ratio of a profile of lines, (captures,).

    Along a line of w pixels that correlate by ρ, summed over those to one side, the variance of the mean is
    1 + 2ρ·(1 − 1/w) times that of white noise. A fixed profile holds the noise that the mean of the frames leaves.

    Args:
        name: row_temporal, rows or columns.
    """
    length = design.tile_height if name == "columns" else design.tile_width
    x, y = prediction.mixed_x + prediction.beyond_x, prediction.mixed_y + prediction.beyond_y
    together = y if name == "columns" else x
    noise, share = prediction.variance, np.ones_like(prediction.variance)
    if name != "row_temporal":
        noise, share = prediction.spatial, prediction.variance / design.frame_count[:, None] / prediction.spatial
    more = 2.0 * together * share * (1.0 - 1.0 / length)
    mixed = np.sum(more / noise, axis=-1) / np.sum(1.0 / noise, axis=-1)
    return np.asarray(np.maximum(mixed, _LEAST_EXCESS))


def mixing_of_bands(prediction: Prediction, design: Design) -> Array:
    """Return by what such pixels raise the ratios of the bands, (captures, orders).

    Bands of coarse rows gain more than those of fine ones, by 1 + 2ρ·cos(2πν) for ν periods per row; what is beyond
    the nearest rows counts as in them.
    """
    bins = RowBins.of(design)
    weight = np.square(np.maximum(prediction.signal, 0.0)) / prediction.variance
    weight = weight / np.maximum(np.sum(weight, axis=-1, keepdims=True), 1e-300)
    x, y, beyond_x, beyond_rows = (
        np.sum(weight * mixed, axis=-1)[..., None]
        for mixed in (prediction.mixed_x, prediction.mixed_y, prediction.beyond_x, prediction.beyond_rows)
    )
    turn = np.pi * np.arange(1, bins.orders + 1) / bins.number  # of one order from bin to bin
    inside, next_bin = 1.0 - 1.0 / bins.step, 1.0 / bins.step
    rows = inside + next_bin * np.cos(turn)
    mixed = (1.0 + 2.0 * x) * (1.0 + 2.0 * y * rows) - 1.0 + 2.0 * (beyond_x + beyond_rows * rows)
    return np.asarray(np.maximum(mixed, _LEAST_EXCESS))


def relative_bands(prediction: Prediction) -> Array:
    """Return the relative variance of the light that goes as a wave along the rows, (captures,)."""
    if not prediction.waves:
        return np.zeros(prediction.gain.shape)
    return of_fair_tiles(prediction, prediction.band_variance)


def relative_flicker(prediction: Prediction) -> Array:
    """Return the relative variance that all light of a frame shares by chance, (captures,).

    Of the tiles with a fair share of the light the one that shows most counts: a full well shows none.
    """
    return of_fair_tiles(prediction, prediction.common_variance)


def of_fair_tiles(prediction: Prediction, variance: Array) -> Array:
    """Return a variance in DN² relative to the light of the tile with a fair share that shows most, (captures,)."""
    if not variance.any():
        return np.zeros(variance.shape[:-1])
    light = np.maximum(prediction.signal * prediction.gain[..., None], 1e-12)
    fair = light >= _FAIR_SHARE * light.max(axis=-1, keepdims=True)
    return np.asarray(np.max(np.where(fair, variance / light**2, 0.0), axis=-1))


def band_excess(design: Design, seen: CaptureStatistics, prediction: Prediction) -> dict[str, Array]:
    """Return what a wave along the rows adds to the ratios of the rows' profiles, by statistic, (captures,)."""
    if not prediction.waves:
        return {}
    bands2 = relative_bands(prediction)
    left = TileBands.of(design, prediction.band_frequency)
    temporal = bands2 * seen.row_temporal_light
    # The weights of the time mean's rows are those of the temporal profile but for the noise of a pixel.
    safe = np.where(seen.row_temporal_weight > 0, seen.row_temporal_weight, np.inf)
    steady = temporal * seen.rows_weight / safe / design.frame_count
    found = {}
    for name, excess, kept, noise in (
        ("row_temporal", temporal, left.within, prediction.variance),
        ("rows", steady, left.rough, prediction.spatial * design.frame_count[:, None]),
    ):
        # The noise of pixels that the ratio is taken over holds the wave too.
        held = np.mean(prediction.band_variance * kept / noise**2, axis=-1) / np.mean(1.0 / noise, axis=-1)
        found[name] = np.maximum(excess * float(kept.mean()) - held, _LEAST_EXCESS)
    return found


def _line_weights(design: Design, base: Prediction) -> Array:
    """Return the share of each bin of rows in the profiles, (captures, bins): tiles of little noise count more."""
    held = design.tile_width[:, None] * design.tile_height[:, None] * _rows_in_bins(design)
    found = (1.0 / base.variance) @ held
    return np.asarray(found / found.sum(axis=1, keepdims=True))


def _rows_in_bins(design: Design) -> Array:
    bins = RowBins.of(design)
    found = np.zeros((len(design.tiles), bins.number))
    np.add.at(found.T, np.arange(design.shape[0]) // bins.step, design.rows_of_tiles.T)
    return found


def with_heavy_rows(design: Design, seen: CaptureStatistics, base: Prediction) -> CaptureStatistics:
    """Return the statistics with the degrees of freedom of the rows' profiles that row noise leaves.

    Where it outweighs the pixels' noise, a profile follows its few heaviest rows.
    """
    weights = _line_weights(design, base)
    lines = np.maximum(np.sum(weights > 0, axis=1), 1)
    changed = {}
    for name, variance in (("row_temporal", base.row_variance), ("rows", base.row_variance / design.frame_count)):
        more = (variance * getattr(seen, f"{name}_weight"))[:, None] * lines[:, None] * weights
        each = np.where(weights > 0, 1.0 + more, 0.0)
        share = np.sum(each, axis=1) ** 2 / (lines * np.sum(each**2, axis=1))
        changed[f"{name}_dof"] = getattr(seen, f"{name}_dof") * share
    return replace(seen, **changed)


def common_of_rows(design: Design, seen: CaptureStatistics, light: Array) -> Array:
    """Return w·O·w / (w·s) for the weights w = s·n/σ² of the tiles' light s and the overlap O of their rows.

    Args:
        light: (captures, tiles) d(mean)/d(log light) in DN, 0 where a tile does not count.
    """
    light = np.where(np.nan_to_num(seen.variance) > 0, light, 0.0)
    weight = np.where(light > 0, light * seen.pixels / np.where(light > 0, seen.variance, 1.0), 0.0)
    information = np.sum(weight * light, axis=1)
    shaken = np.sum(np.square(weight @ design.rows_of_tiles), axis=1)
    return np.asarray(np.divide(shaken, information, out=np.zeros_like(shaken), where=information > 0))


_SENSITIVITY_STEP: Final = 1e-3
_WARMER_K: Final = 0.1
_STEEPEST_DOUBLING_K: Final = 4.0  # of a dark current in silicon
_SWELLING: Final = ("variance", "spatial")  # what leaks and their shot noise add to
_FORM_FLOOR: Final = 0.005  # share of an accepted effect's own correction that its form is not trusted with


def light_response(model: TileModel, here: Trace) -> tuple[Array, Array]:
    """Return d(mean)/d(log light) in DN and |d(ln variance)/d(log light)| by a finite difference."""
    base, moved = here.prediction, _brighter(model, here)
    mean = (moved.mean - base.mean) / _SENSITIVITY_STEP
    variance = np.abs(np.log(moved.variance / base.variance)) / _SENSITIVITY_STEP
    return np.asarray(mean), np.asarray(variance)


def _brighter(model: TileModel, here: Trace) -> Prediction:
    """Return what a model predicts of a little more light; it is worked out once for each run of its chain."""
    known, off = vars(here), here.nuisance.off
    if "brighter" not in known:
        more = here.nuisance.with_off(log_responsivity=off.log_responsivity + _SENSITIVITY_STEP)
        known["brighter"] = model.predict(more, here)
    found: Prediction = known["brighter"]
    return found


def darkness_of(model: TileModel, here: Trace, seen: CaptureStatistics) -> Darkness | None:
    """Return how far darkness differs from frame to frame; None where nothing shows that it does."""
    design, base = model.design, here.prediction
    black_dn, drift_dn, reading_k = wander_of_black(design, seen), drift_of_black(design, seen), design.reading_u_k
    if not (black_dn or drift_dn or reading_k):
        return None
    warmer = model.warmed(_WARMER_K).predict(here.nuisance) if reading_k else base
    # A law that is not found yet may rise steeply: no more than what was seen to gather can.
    most = np.log(2.0) / _STEEPEST_DOUBLING_K * np.maximum(seen.mean - np.nanmin(seen.mean), 0.0)
    swelling = {n: np.log(getattr(warmer, n) / getattr(base, n)) / _WARMER_K for n in _SWELLING} if reading_k else {}
    warmth = np.clip((warmer.mean - base.mean) / _WARMER_K, -most, most)
    return Darkness(black_dn, reading_k, warmth, swelling, drift_dn)


def form_floors(model: TileModel, here: Trace) -> dict[str, Array]:
    """Return by statistic the uncertainty of the accepted effects' form: a share of each one's own correction.

    What a correction does to all light alike belongs to the responsivity, which is fitted, and not to the form. A leak
    that makes white a third brighter is known no worse than an exponent that leaves white as it is.
    """
    floors: dict[str, Array] = {}
    base, everything = here.prediction, (*model.given, *model.effects)
    held = [name for name, row in STATISTICS.items() if row.holds_form]
    brighter = _brighter(model, here) if everything else base
    for index in range(len(everything)):
        without = tuple(effect for i, effect in enumerate(everything) if i != index)
        other = replace(model, given=(), effects=without).predict(here.nuisance, here)
        own, light = base.mean - other.mean, brighter.mean - base.mean
        alike = float(np.sum(own * light / base.variance)) / max(float(np.sum(light**2 / base.variance)), 1e-300)
        for name in held:
            change = _difference(name, base, other) - alike * _difference(name, brighter, base)
            floors[name] = np.hypot(floors.get(name, 0.0), _FORM_FLOOR * np.abs(change))
    return floors


def _difference(name: str, one: Prediction, other: Prediction) -> Array:
    """Return by how much a statistic differs, in logarithms where it is compared in these."""
    there, bare = getattr(one, name), getattr(other, name)
    return np.asarray(np.log(there / bare) if STATISTICS[name].scale is Scale.LOGARITHM else there - bare)


_HALF_WAVES: Final = 12  # of a black level that moves within a frame: three to each of four tiles


def errors_of_darkness(design: Design, usable: Mapping[str, Mask], darkness: Darkness) -> tuple[SharedError, ...]:
    """Return what a wandering black level and a coarse thermometer do to a capture's means, first frame and variances.

    Repeated frames do not average it out: they follow one another, and the black level has its way from one series to
    the next.
    """
    first = 1.0 + 1.0 / np.maximum(design.frame_count - 1.0, 1.0)
    every, one = np.ones(len(design.captures)), np.ones((len(design.tiles), 1))
    found = []
    for name, amplitude, u in (
        ("black level of a capture", np.ones_like(darkness.warmth), darkness.black_dn),
        ("temperature of a capture", darkness.warmth, darkness.temperature_k),
    ):
        if u > 0:
            found += [
                SharedError(name, {"mean": Part(np.where(usable["mean"], amplitude, 0.0), one)}, u**2 * every),
                SharedError(name, {"first": Part(np.where(usable["first"], amplitude, 0.0), one)}, u**2 * first),
            ]
    if darkness.drift_dn > 0:
        found += _drift(design, usable, darkness.drift_dn, first)
    for statistic, swelling in darkness.swelling.items() if darkness.temperature_k > 0 else ():
        part = Part(np.where(usable[statistic], swelling, 0.0), one)
        found.append(SharedError("temperature of a capture", {statistic: part}, darkness.temperature_k**2 * every))
    return tuple(found)


def _drift(design: Design, usable: Mapping[str, Mask], drift_dn: float, first: Array) -> list[SharedError]:
    """Return a black level that moves while the rows are read, as a random walk does: k half waves have 1/k of one.

    Its steps in one frame are independent of those in another, so that repeats average them out.

    Source: the expansion of Brownian motion in cosines, K. Karhunen (1947), whose variances go as 1/k².
    """
    waves = np.arange(1, _HALF_WAVES + 1)
    shapes = np.cos(np.pi * (np.arange(design.shape[0])[:, None] + 0.5) / design.shape[0] * waves)
    variance = np.square(drift_dn / waves)
    parts = {"mean": design.rows_of_tiles @ shapes, "slope_y": design.tilts_of_rows @ shapes}
    of_mean = 1.0 / design.frame_count
    bases = (("mean", parts["mean"], of_mean), ("first", parts["mean"], first), ("slope_y", parts["slope_y"], of_mean))
    return [
        SharedError(
            "black level within a frame", {n: Part(usable[n].astype(np.float64), basis)}, each[:, None] * variance
        )
        for n, basis, each in bases
    ]


# ---- fixed patterns -------------------------------------------------------------------------------------------------
_EDGES: Final = 5.0  # √(number of edges that average out), few to be safe
_LEAST_STEP: Final = 0.1  # of the brightest light, where all patches are alike
_SMALLEST_SHARE: Final = 1e-6
ANSCOMBE: Final = 0.375  # added to a count before its root
_SMALL_SHARE: Final = 0.01  # of the variance of twice the root of a count, which is 1
_FIXED: Final = ("spatial", "columns", "rows")


@dataclass(frozen=True, slots=True, eq=False)
class FixedError:
    """One source of error whose z are the same in all captures: y = f(θ) + B·z, fitted with its variance as prior."""

    name: str  # what it is
    # Gives what a unit of each z does, by statistic, for a prediction
    parts: Callable[[Prediction], Mapping[str, Part]]
    sigma: Array  # (n,) standard deviation of each z


Unit = Callable[[Prediction], Array]


def fixed_errors(
    effects: Sequence[CatalogueEffect],
    prediction: Prediction,
    seen: CaptureStatistics,
    design: Design,
    context: ExposureContext,
) -> tuple[FixedError, ...]:
    """Return what the fixed patterns of the accepted effects do."""
    patterns = [effect for effect in effects if effect.block in _FIXED]
    limited = bool(prediction.limit_variance.any())
    if not patterns and not limited:
        return ()
    pixels = np.maximum(seen.pixels.max(axis=0), 2.0)
    own = [(effect, effect.pattern_e(context)) for effect in patterns]
    plain = [effect for effect, electrons in own if electrons is None]
    additive = any(not effect.proportional for effect in plain)
    terms: list[FixedError] = []
    others = prediction.renewed_variance
    for effect, electrons in own:
        if electrons is not None:
            unit = _times_gain(np.broadcast_to(electrons, (*prediction.mean.shape, 1))[:, :, 0])
            others = others + unit(prediction) ** 2
            terms += _offset_terms(effect.name, unit, np.ones(len(design.tiles)), (0.0, 0.0), pixels, design)
    if limited:
        others = others + prediction.limit_variance
        terms += _offset_terms(
            "uneven limit", lambda p: np.sqrt(p.limit_variance), np.ones(len(design.tiles)), (0.0, 0.0), pixels, design
        )
    fixed = prediction.fixed - others
    if any(effect.proportional for effect in plain):
        # Purest in bright captures, but for full wells, which hide it.
        light = _unit_of_light(prediction)
        bright, relative = light > 0.2 * light.max(axis=0), fixed / np.maximum(light**2, 1e-30)
        columns = zip(relative.T, bright.T, strict=True)
        white = np.array([np.median(column[mask]) if mask.any() else 0.0 for column, mask in columns])  # darks alone
        terms += _offset_terms("proportional pattern", _unit_of_light, white, (0.0, 0.0), pixels, design)
    if additive:
        of_lines = (prediction.fixed_row_variance, prediction.fixed_column_variance)
        lines = tuple(float(np.median(variance / prediction.gain**2)) for variance in of_lines)
        relative = fixed / np.maximum(_times_gain(1.0)(prediction) ** 2, 1e-30) - sum(lines)
        white = relative[np.argmin(prediction.signal, axis=0), np.arange(pixels.size)]  # purest in the darkest
        terms += _offset_terms("additive pattern", _times_gain(1.0), white, lines, pixels, design)
    terms.append(_spread_of_pixels(seen, max((effect.excess_kurtosis() for effect in patterns), default=0.0)))
    for name in ("columns", "rows"):
        terms.append(_spread_of_lines(name, seen))
        if additive and float(np.max(_lines(name, prediction))) > 0:
            terms.append(_spread_of_lines_in_tiles(name, seen, design))
    return tuple(terms)


def renewed_patterns(design: Design, seen: CaptureStatistics, prediction: Prediction) -> dict[str, Array]:
    """Return how far a pattern that each setting has for itself scatters means, slopes and its spread, by statistic.

    The m captures of one setting have the same pattern: each counts as if it were √m times as uncertain, so that
    together they weigh as much as one of them.
    """
    pattern2 = prediction.renewed_variance
    if not pattern2.any():
        return {}
    alike = np.bincount(design.setting_id)[design.setting_id][:, None]
    sigma = np.sqrt(alike * pattern2)
    share = pattern2 / np.maximum(prediction.spatial, 1e-30)
    lengths = slope_lengths(design)
    return {
        "mean": sigma / np.sqrt(np.maximum(seen.pixels, 1.0)),
        "slope_x": sigma / lengths[0],
        "slope_y": sigma / lengths[1],
        "spatial": share * np.sqrt(2.0 * (alike - 1.0) / np.maximum(seen.spatial_dof, 1.0)),
    }


def errors_of_few_pixels(
    design: Design, seen: CaptureStatistics, prediction: Prediction, usable: Mapping[str, Mask]
) -> tuple[FixedError, ...]:
    """Return what few pixels that are the same in all captures leave to chance: their numbers, and a tile's noise.

    Two captures share the pixels of that in which fewer count: numbers n and m have the covariance min(n, m).
    """
    found = []
    if prediction.uneven_noise.any():
        of_tile, one = prediction.uneven_noise / np.sqrt(np.maximum(seen.pixels, 1.0)), np.eye(len(design.tiles))
        left = {"variance": of_tile, "spatial": of_tile / design.frame_count[:, None]}
        noise = {n: Part(np.where(usable[n], by / getattr(prediction, n), 0.0), one) for n, by in left.items()}
        found.append(FixedError("noise of few pixels", _whatever(noise), np.ones(len(one))))
    for name in ("outliers", "unsteady"):
        count = np.where(usable[name], getattr(prediction, name), 0.0)
        scale = np.sqrt(count + ANSCOMBE)  # of what twice the root moves by
        shared = np.minimum.outer(count, count) / np.outer(scale, scale)
        np.fill_diagonal(shared, 0.0)  # by itself each scatters as counts do, which is in its weight already
        values, vectors = np.linalg.eigh(shared)
        kept = values > _SMALL_SHARE
        if not kept.any():
            continue
        part = {name: _of_captures(vectors[:, kept] * np.sqrt(values[kept]))}
        found.append(FixedError(f"number: {name}", _whatever(part), np.ones(kept.sum())))
    return tuple(found)


def _whatever(part: Mapping[str, Part]) -> Callable[[Prediction], Mapping[str, Part]]:
    return lambda prediction: part


def error_of_borders(usable: NDArray[np.bool_]) -> tuple[FixedError, ...]:
    """Return what all borders share, whatever the blur: none is quite straight, and the source's least so.

    Args:
        usable: (captures,) whether a capture's borders carry information.
    """
    part = {"edge": _of_captures(np.ones((usable.size, 1)))}
    return (FixedError("borders", _whatever(part), np.array([SHARPEST])),) if usable.any() else ()


def error_of_histograms(honest: Array, usable: Mask) -> tuple[FixedError, ...]:
    """Return what honest histograms of a scene have in common: what is dark in one capture is so in all.

    Args:
        honest: (captures, periods) standard deviation of their Fourier terms.
        usable: Same shape, which of them count.
    """
    if not np.any(honest[usable]):
        return ()
    periods = honest.shape[1]
    part = {"comb": Part(honest, np.eye(periods))}
    return (FixedError("histogram of the scene", _whatever(part), np.ones(periods)),)


def _of_captures(columns: Array) -> Part:
    """Return a part of a statistic that captures have one figure of, from its columns, (captures, n)."""
    return Part(np.ones((columns.shape[0], 1)), columns[:, None, :])


def _offset_terms(
    name: str, unit: Unit, white: Array, lines: Sequence[float], pixels: Array, design: Design
) -> list[FixedError]:
    """Return what a pattern does to means, slopes and edges."""
    (rows_e2, columns_e2), white = lines, np.maximum(white, 1e-14)
    rows, columns = _shared_lines(design)
    height, width, lengths = design.tile_height, design.tile_width, slope_lengths(design)
    # The pixels of a row (column) move together, and with them every tile that it crosses.
    mean = np.diag(white / pixels) + rows_e2 * rows / _outer(height) + columns_e2 * columns / _outer(width)
    tilt_x = np.diag(white / lengths[0] ** 2) + columns_e2 * columns * _outer(np.sqrt(height) / lengths[0])
    tilt_y = np.diag(white / lengths[1] ** 2) + rows_e2 * rows * _outer(np.sqrt(width) / lengths[1])
    ones = np.ones(len(design.tiles))
    line = float(np.median(np.sqrt(white / np.sqrt(pixels) + rows_e2 + columns_e2)))
    shifts = (("mean", "mean", mean), ("tilt x", "slope_x", tilt_x), ("tilt y", "slope_y", tilt_y))

    def moving(statistic: str, root: Array) -> Callable[[Prediction], Mapping[str, Part]]:
        return lambda prediction: {statistic: Part(unit(prediction), root)}

    found = [FixedError(f"{name}: {what}", moving(of, _root(shift)), ones) for what, of, shift in shifts]
    return [*found, FixedError(f"{name}: edges", _blurring(unit), np.array([line]))]


def _root(covariance: Array) -> Array:
    """Return a matrix whose product with its transpose is the covariance."""
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariance)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)


def _shared_lines(design: Design) -> tuple[Array, Array]:
    x, y = (np.array([getattr(tile, name) for tile in design.tiles]) for name in ("x", "y"))
    width, height = design.tile_width, design.tile_height
    rows = np.minimum((y + height)[:, None], y + height) - np.maximum(y[:, None], y)
    columns = np.minimum((x + width)[:, None], x + width) - np.maximum(x[:, None], x)
    return np.maximum(rows, 0) / _outer(height), np.maximum(columns, 0) / _outer(width)


def _outer(length: Array) -> Array:
    return np.asarray(np.sqrt(length[:, None] * length[None, :]))


def _unit_of_light(prediction: Prediction) -> Array:
    return prediction.signal * prediction.gain[:, None]


def _times_gain(electrons: Array | float) -> Unit:
    return lambda prediction: np.broadcast_to(electrons * prediction.gain[:, None], prediction.mean.shape)


def _blurring(unit: Unit) -> Callable[[Prediction], Mapping[str, Part]]:

    def parts(prediction: Prediction) -> Mapping[str, Part]:
        light = np.max(_unit_of_light(prediction), axis=1)
        step = np.maximum(np.maximum(np.std(prediction.mean, axis=1), _LEAST_STEP * light), 1e-9)
        size = np.sqrt(np.mean(np.square(unit(prediction)), axis=1))
        return {"edge": _of_captures((size / step / _EDGES)[:, None])}

    return parts


def _spread_of_pixels(seen: CaptureStatistics, excess_kurtosis: float) -> FixedError:
    """Return the chance spread of each tile's own pixels, alone and times that of lines.

    A variance of n values scatters by √((2 + κ)/n), κ their excess kurtosis.
    """
    freedom = np.maximum(np.nanmedian(seen.spatial_dof, axis=0), 2.0)

    def parts(prediction: Prediction) -> Mapping[str, Part]:
        lines = prediction.fixed_row_variance + prediction.fixed_column_variance
        white = np.maximum(prediction.fixed - lines[:, None], 0.0)
        share = np.sqrt(white * (white + 2.0 * lines[:, None])) / np.maximum(prediction.spatial, 1e-30)
        return {"spatial": Part(share, np.eye(share.shape[1]))}

    return FixedError("pattern spread", parts, np.sqrt((2.0 + excess_kurtosis) / freedom))


def _lines(name: str, prediction: Prediction) -> Array:
    return prediction.fixed_column_variance if name == "columns" else prediction.fixed_row_variance


def _spread_of_lines_in_tiles(name: str, seen: CaptureStatistics, design: Design) -> FixedError:
    """Return the chance spread of the few lines of a pattern that cross each tile, alike in every capture."""
    rows, columns = _shared_lines(design)
    free = np.maximum((design.tile_height if name == "rows" else design.tile_width) - SURFACE_LINES, 1.0)
    values, vectors = np.linalg.eigh(2.0 * (rows if name == "rows" else columns) / _outer(free))
    kept = values > _SMALLEST_SHARE * values.max()
    root = vectors[:, kept] * np.sqrt(values[kept])
    weight = getattr(seen, f"{name}_weight")

    def parts(prediction: Prediction) -> Mapping[str, Part]:
        lines = _lines(name, prediction)
        share = lines[:, None] / np.maximum(prediction.spatial, 1e-30)
        of_all = (lines * weight / (1.0 + lines * weight))[:, None] * root.mean(axis=0)
        return {"spatial": Part(share, root), name: _of_captures(of_all)}

    return FixedError(f"spread of {name} in tiles", parts, np.ones(root.shape[1]))


def _spread_of_lines(name: str, seen: CaptureStatistics) -> FixedError:

    def parts(prediction: Prediction) -> Mapping[str, Part]:
        share = (prediction.fixed / np.maximum(prediction.spatial, 1e-30)).mean(axis=1)
        return {name: _of_captures(share[:, None])}

    dof = getattr(seen, f"{name}_dof")
    free = max(float(np.median(dof[dof > 0])) if (dof > 0).any() else 2.0, 2.0)
    return FixedError(f"pattern {name} spread", parts, np.array([np.sqrt(2.0 / free)]))

"""Judges how frames and captures of one setting repeat: by their order, by their scene, by their light and darkness.

The repeatability of the light between captures follows from repeats of one setting. A frame's offset is seen in every
tile, so what one frame shows is held out over the tiles of that frame. The scatter of all frames of all series shows
whether one of them is an outlier. Darkness differs from frame to frame too: a black level that wanders, a thermometer
of coarse steps.

Frames of one setting should show the same light, but for the noise of pixels and for what a source scatters from frame
to frame at random. The light of each frame, relative to the mean of its setting, is sorted by its running number
modulo every period. A camera or lamp that darkens each fifth frame shows there; a variance alone would look like
flicker.

Lens, sensor and source change a picture smoothly, along its rows or along its columns. The residual of its logarithm
is the scene's own fine structure, which exposure, gain and response leave in place. A changing scene is no effect of
the camera.

Source: analysis of variance in one way, within settings; F test with Bonferroni's correction over the periods.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar
from scipy.special import fdtrc, stdtr

from radiometer.data import Frame
from radiometer.reconciliation.design import CaptureStatistics, Design
from radiometer.reconciliation.reduce import FrameReader, light_of_frames
from radiometer.reconciliation.result import FittedParameter, Repeats, Series
from radiometer.reconciliation.thresholds import FRAME_SIGNIFICANCE
from radiometer.statistics.chances import chi2_beyond, chi2_quantile
from radiometer.statistics.least_squares import residual, solve
from radiometer.statistics.model_choice import CLEARLY_BETTER, is_supported
from radiometer.statistics.scale import MAD_TO_SIGMA, MEDIAN_U, robust_sigma
from radiometer.typing import Array, Mask

_ASSUMED_TAU: Final = 1e-3  # where neither repeats nor capture.yaml tell
_ASSUMED_RANGE: Final = (0.3, 3.0)
_DECLARED_RANGE: Final = (0.5, 2.0)
_ENOUGH_REPEATS: Final = 5
_CONFIDENCE: Final = 0.99
_SMALLEST_TAU: Final = 1e-6
_LARGEST_TAU: Final = 10.0
_TREND_SHARE: Final = 0.4  # of the repeats' freedom that a slow change in time may take
_MOST_WAVES: Final = 16
_DECLARED_WANDER: Final = 1.3  # times the stated reproducibility, which is itself known to a few parts in ten
_PLAUSIBLE_WANDER: Final = 0.003  # of a source of which nothing is stated: what scatters more is something to name
_EXPOSURE_GROUPS: Final = 6
_STANDS_OUT: Final = 8.0  # sigmas
_UNSTEADY: Final = 0.01


def capture_scale(difference: Array, sensitivity: Array, deviation: Array, usable: Mask) -> tuple[Array, Array]:
    """Return the common relative deviation of each capture and its variance from pixel noise alone.

    Args:
        difference: (captures, tiles) measured minus predicted mean in DN.
        sensitivity: (captures, tiles) d(mean)/d(log light) in DN.
        deviation: (captures, tiles) standard uncertainty of a mean from pixel noise in DN.

    Returns:
        (captures,) deviation and variance; the variance is infinite where no light is seen.
    """
    weight = np.where(usable, sensitivity / deviation**2, 0.0)
    information = np.sum(weight * np.where(usable, sensitivity, 0.0), axis=1)
    lit = information > 0
    scale = np.sum(weight * np.where(usable, difference, 0.0), axis=1) / np.where(lit, information, 1.0)
    return scale, np.where(lit, 1.0 / np.where(lit, information, 1.0), np.inf)


def estimate_tau(design: Design, scale: Array, variance: Array) -> float:
    """Return the capture-to-capture repeatability τ as a relative standard deviation.

    Repeats of one setting bound it (99 % interval of their scatter, slow change in time taken out); within the
    bounds the likelihood of all captures decides. Left free it would swallow effects, and from few repeats alone it
    would be loose by a factor of two.

    Args:
        scale: (captures,) common relative deviation from the model.
        variance: (captures,) its variance from pixel noise alone.
    """
    lit = np.isfinite(variance)
    low, high = _bounds(design, scale, variance, lit)
    if not lit.any():
        return float(np.sqrt(low * high))

    def deviance(log_tau: float) -> float:
        total = variance[lit] + np.exp(2.0 * log_tau)
        return float(np.sum(np.log(total) + scale[lit] ** 2 / total))

    found = minimize_scalar(deviance, bounds=(np.log(low), np.log(high)), method="bounded", options={"xatol": 1e-6})
    return float(np.exp(found.x))


def steady_wander2(tried: Array, deviances: Array, exposure_s: Array, declared: float | None) -> float:
    """Return the relative variance by which the source wanders from frame to frame, alike at all exposures.

    It is the likeliest one. It is at most the source's stated reproducibility, or 0.3 % where none is stated. It is
    none where it differs between exposures, since flicker averages out in long ones. One of several shows none: a
    source that wanders does so in the others too.

    Args:
        tried: (values,) relative variances, 0 first.
        deviances: (values, captures) −2·ln of each capture's likelihood.
        declared: Stated relative standard uncertainty of the source's reproducibility; None where not stated.
    """
    allowed = tried <= (_PLAUSIBLE_WANDER if declared is None else _DECLARED_WANDER * declared) ** 2
    totals = np.where(allowed, deviances.sum(axis=1), np.inf)
    if not exposure_s.size:
        return 0.0
    gains = deviances[0] - deviances[np.argmin(totals)]
    if not is_supported(float(gains.sum() - (gains.max() if gains.size > 1 else 0.0)), CLEARLY_BETTER):
        return 0.0
    order = np.argsort(exposure_s, kind="stable")
    groups = np.array_split(order, min(_EXPOSURE_GROUPS, len(np.unique(exposure_s))))
    apart = sum(float(deviances[:, group].sum(axis=1).min()) for group in groups)
    if declared is not None and len(groups) > 1 and chi2_beyond(totals.min() - apart, len(groups) - 1) < _UNSTEADY:
        return 0.0
    return float(tried[np.argmin(totals)])


def _bounds(design: Design, scale: Array, variance: Array, lit: Mask) -> tuple[float, float]:
    """Return the bounds of τ, as far off as chance may have made the scatter of repeats.

    The scatter of repeats, each weighted by what τ and its own pixels leave it, is χ² at the right τ; captures whose
    pixels are noisy then weigh little, as they should.

    Source: Viechtbauer (2007), Statist. Med. 26 37: the Q-profile interval.
    """
    repeats = _Repeats.of(design, scale, variance, lit)
    declared = design.header.source.reproducibility_u_rel
    if repeats.freedom < _ENOUGH_REPEATS:
        middle, (down, up) = (declared, _DECLARED_RANGE) if declared else (_ASSUMED_TAU, _ASSUMED_RANGE)
        return max(middle * down, _SMALLEST_TAU), max(middle * up, 2 * _SMALLEST_TAU)
    low, high = (repeats.tau_at(chi2_quantile(0.5 + s * _CONFIDENCE / 2.0, repeats.freedom)) for s in (1.0, -1.0))
    return low, max(high, 2 * low, 2e-5)


@dataclass(frozen=True, slots=True, eq=False)
class _Repeats:
    taken: NDArray[np.intp]  # (n,) which captures they are
    scale: Array  # (n,) their common relative deviation from the model
    variance: Array  # (n,) its variance from pixel noise alone
    basis: Array  # (n, terms) what repeats cannot show: the mean of each setting, slow change in time

    @classmethod
    def of(cls, design: Design, scale: Array, variance: Array, lit: Mask) -> _Repeats:
        """Return the repeats that measure the light; slow change in time is not part of their scatter.

        Settings of which one capture stands out from all others are left out: it has another cause (a wrong label),
        which poor repeatability would hide.
        """
        all_of_them = cls._taken(design, scale, variance, lit, waves=False)
        if not all_of_them.taken.size:
            return all_of_them
        apart = np.abs(all_of_them.apart(0.0))
        usual = robust_sigma(apart, 0.0) * np.sqrt(apart.size / max(all_of_them.freedom, 1))
        limit = _STANDS_OUT * np.sqrt(usual**2 + all_of_them.variance)
        odd = np.unique(design.setting_id[all_of_them.taken][apart > limit])
        return cls._taken(design, scale, variance, lit & ~np.isin(design.setting_id, odd), waves=True)

    @classmethod
    def _taken(cls, design: Design, scale: Array, variance: Array, lit: Mask, *, waves: bool) -> _Repeats:
        ids = design.setting_id
        taken = np.flatnonzero(lit & np.isin(ids, [i for i in np.unique(ids[lit]) if np.sum(ids[lit] == i) > 1]))
        basis = (ids[taken][:, None] == np.unique(ids[taken])).astype(np.float64)
        if waves:
            freedom = taken.size - basis.shape[1]
            time = design.timestamp_s[taken]
            slow = _slow_change(time, int(_TREND_SHARE * freedom))
            jumps = [_relaxing(time, since_s) for since_s in design.jump_times_s if np.any(time > since_s)]
            basis = np.hstack([basis, slow, *jumps])
        return cls(taken, scale[taken], variance[taken], basis)

    @property
    def freedom(self) -> int:
        return self.taken.size - int(np.linalg.matrix_rank(self.basis)) if self.taken.size else 0

    def apart(self, tau: float) -> Array:
        return np.asarray(self.scale - self.basis @ solve(self.basis, self.scale, 1.0 / (self.variance + tau**2)))

    def tau_at(self, chi2: float) -> float:
        """Return the τ at which their weighted scatter is so large; next to nothing where it never is."""

        def excess(log_tau: float) -> float:
            tau = float(np.exp(log_tau))
            return float(np.sum(np.square(self.apart(tau)) / (self.variance + tau**2))) - chi2

        ends = (np.log(_SMALLEST_TAU), np.log(_LARGEST_TAU))
        if excess(ends[0]) <= 0.0:
            return _SMALLEST_TAU
        return float(np.exp(brentq(excess, *ends, xtol=1e-3))) if excess(ends[1]) < 0.0 else _LARGEST_TAU


def _slow_change(time: Array, terms: int) -> Array:
    """Return up to so many functions of time that change slowly: a warm-up first, then ever shorter waves."""
    if terms < 3:
        return np.zeros((time.size, 0))
    u = (time - time.min()) / (float(np.ptp(time)) or 1.0)
    waves = np.arange(1, min(terms - 3, _MOST_WAVES) + 1)
    return np.column_stack([u, u**2, np.exp(-4.0 * u), np.cos(np.pi * u[:, None] * waves)])


def _relaxing(time: Array, since_s: float) -> Array:
    """Return what jumps at a time and stays, or dies away by four e-folds to the end."""
    after = np.clip((time - since_s) / (float(time.max()) - since_s), 0.0, 1.0)
    return np.column_stack([there := (time >= since_s).astype(np.float64), there * np.exp(-4.0 * after)])


_OF_MEDIAN: Final = MEDIAN_U * MAD_TO_SIGMA  # standard error of a median of normal values, from their median deviation
_FEWEST_TILES: Final = 4  # whose median deviation determines their scatter within a factor of two
_FEWEST: Final = 2  # degrees of freedom that determine a scatter
_ROUNDS: Final = 4  # by which the weights of series settle
_LIT_DN: Final = 1.0  # per unit of ln light, below which nothing is reported of light

Tiles = Callable[[tuple[int, ...]], Array]


def repeats_of(
    design: Design,
    tiles_of: Tiles,
    usable: NDArray[np.bool_],
    sensitivity: Array,
    first: Array,
    wander: Sequence[float],
) -> tuple[Repeats, ...]:
    """Return what frames of one setting differ by: dark ones in DN, lit ones relative to their light.

    Args:
        tiles_of: Gives the mean of each tile in frames at positions of the header, (frames, tiles) in DN.
        usable: (captures, tiles) which means count.
        sensitivity: (captures, tiles) d(mean)/d(log light) in DN.
        first: (captures, tiles) what the model has a first frame above the others by, in DN: it is taken off.
        wander: What the weights of the model hold of it, of dark frames in DN and of lit ones relative.
    """
    dark = design.closed | ~(design.source_level > 0)
    found = []
    for kind, unit, chosen, aside in zip(("dark", "lit"), ("DN", "1"), (dark, ~dark), wander, strict=True):
        seen = dict[int, tuple[Array, Array]]()
        for number in np.flatnonzero(chosen).tolist():
            frames = design.captures[number].frames
            scale = np.ones(len(design.tiles)) if kind == "dark" else sensitivity[number]
            counts = usable[number] & (scale >= _LIT_DN)
            if len(frames) > 1 and np.count_nonzero(counts) >= _FEWEST_TILES:
                means = np.array(tiles_of(frames)[:, counts])
                means[0] -= first[number, counts]
                seen[number] = _apart(means / scale[counts])
        if sum(apart.size - 1 for apart, _ in seen.values()) >= _FEWEST:
            found.append(_together(design, kind, unit, seen, aside))
    return tuple(found)


def _apart(means: Array) -> tuple[Array, Array]:
    """Return each frame less the mean of the others, and its u, from (frames, tiles) in the unit to be reported."""
    n = means.shape[0]
    apart = (means - means.mean(axis=0)) * n / (n - 1.0)
    middle = np.median(apart, axis=1)
    return middle, _OF_MEDIAN * np.median(np.abs(apart - middle[:, None]), axis=1) / np.sqrt(apart.shape[1])


def _together(design: Design, kind: str, unit: str, seen: Mapping[int, tuple[Array, Array]], aside: float) -> Repeats:
    """Return series of one kind with what they scatter by beyond their tiles' chance, and the frames that stick out."""
    own = np.array([apart.size - 1.0 for apart, _ in seen.values()])
    kept = own / (own + 1.0)  # of a frame less the mean of the others, where it is taken less that of all
    square = np.array([float(apart @ apart) for apart, _ in seen.values()]) * kept**2
    chance = np.array([float(np.mean(np.square(u))) for _, u in seen.values()]) * kept
    scatter2 = 0.0
    for _ in range(_ROUNDS):
        weight = own / np.maximum(chance + scatter2, 1e-30) ** 2
        scatter2 = max(float(weight @ (square / own - chance)) / float(weight.sum()), 0.0)
    spread = np.sqrt(2.0 * float(weight**2 @ ((chance + scatter2) ** 2 / own))) / float(weight.sum())
    u = spread / (2.0 * max(np.sqrt(scatter2), np.sqrt(spread / 2.0), 1e-30))
    sigma = np.maximum(np.sqrt(scatter2 + chance), 1e-30)
    total, series = float(np.sum(square / sigma**2)), list[Series]()
    for (number, (apart, u_apart)), by in zip(seen.items(), sigma, strict=True):
        warm = float(design.temperature_c[number])
        series.append(
            Series(
                tuple(design.captures[number].frames),
                float(design.exposure_s[number]),
                warm if np.isfinite(warm) else None,
                tuple(apart.tolist()),
                tuple(u_apart.tolist()),
                _standing_out(apart / by, total, int(own.sum())),
            )
        )
    return Repeats(kind, FittedParameter(float(np.sqrt(scatter2)), float(u), unit), aside, tuple(series))


def _standing_out(apart: Array, total: float, freedom: int) -> tuple[int, ...]:
    """Return the positions of frames that are farther off than the scatter of all others allows.

    A frame less the mean of the n − 1 others, over their scatter times √(n/(n − 1)), follows Student's t.

    Source: R. D. Cook, S. Weisberg (1982), Residuals and Influence in Regression, 2.2.1, externally studentised
    residuals; Bonferroni over the frames.
    """
    n = apart.size
    left = np.maximum(total - apart**2 * (n - 1.0) / n, 1e-30) / max(freedom - 1, 1)
    chance = 2.0 * stdtr(freedom - 1, -np.abs(apart) / np.sqrt(left * n / (n - 1.0))) * (freedom + 1)
    return tuple(np.flatnonzero(chance < FRAME_SIGNIFICANCE).tolist()) if freedom > _FEWEST else ()


# ---- darkness -------------------------------------------------------------------------------------------------------
_FEWEST_OF_A_LINE: Final = 4  # tiles
_CLEAR_SLOPE: Final = 5.0  # standard uncertainties
_FEWEST_REPEATED: Final = 1.0  # degrees of freedom of repeated dark frames that show a wander
_CHANCE: Final = 1e-4
_MOST_SHARE: Final = 0.3  # of a pixel's own noise: a black level that differs by more is something to name


@dataclass(frozen=True, slots=True)
class Darkness:
    """Uncertainty of a frame's darkness in addition to the noise of its pixels."""

    black_dn: float  # standard deviation by which the black level wanders from frame to frame, in DN
    temperature_k: float  # standard uncertainty of a temperature reading, in K
    warmth: Array  # (captures, tiles) change of the means in DN per kelvin
    # The same of ln of variances, by statistic: leaks that differ do so the more the warmer it is
    swelling: Mapping[str, Array] = field(default_factory=dict)
    # Standard deviation of half a wave down the rows by which it moves while a frame is read, in DN
    drift_dn: float = 0.0


def black_by_noise(design: Design, seen: CaptureStatistics) -> float | None:
    """Return the black level in DN at which the noise of light would end; None where other data determine it.

    Frames of one setting, none of them dark, do not separate an offset from light. It must be stated, or follow from
    exposures, levels or darks. The noise follows a line: σ² = K·(y − y₀) + what has no light. With nothing for the
    latter y₀ is as high as can be. Where noise does not rise with the light beyond chance, it is undetermined and set
    to 0.
    """
    alike = np.unique(np.column_stack([design.exposure_s, design.gain_db, design.source_level]), axis=0).shape[0] == 1
    dark = design.closed | ~(design.source_level > 0)
    if not alike or dark.any() or not np.isnan(design.black_level_dn).all():
        return None
    counts = np.isfinite(seen.variance) & (seen.variance_dof > 0) & (seen.high == 0) & (seen.low == 0)
    mean, variance, dof = (values[counts] for values in (seen.mean, seen.variance, seen.variance_dof))
    if mean.size < _FEWEST_OF_A_LINE or np.ptp(mean) <= 0:
        return 0.0
    root = np.sqrt(dof / 2.0) / variance
    basis = np.column_stack([mean - mean.mean(), np.ones(mean.size)]) * root[:, None]
    (slope, height), *_ = np.linalg.lstsq(basis, variance * root, rcond=None)
    u_slope = float(np.sqrt(np.linalg.inv(basis.T @ basis)[0, 0]))
    if slope < _CLEAR_SLOPE * u_slope:
        return 0.0
    return float(np.clip(mean.mean() - height / slope, 0.0, mean.min()))


def wander_of_black(design: Design, seen: CaptureStatistics) -> float:
    """Return by how many DN the black level wanders from one dark frame to the next; 0 where it need not.

    Frames of one setting show it: what all tiles of a frame share beyond what pixels and rows give by chance. It is
    pooled over the dark captures, and at most 0.3 of a pixel's own noise.
    """
    return _wander("black", design, seen)


def drift_of_black(design: Design, seen: CaptureStatistics) -> float:
    """Return the standard deviation in DN of half a wave down the rows by which dark frames differ; 0 where none need.

    Rows are read one after the other: what wanders from frame to frame moves within one, too.
    """
    return _wander("drift", design, seen)


def _wander(name: str, design: Design, seen: CaptureStatistics) -> float:
    shown, unit, dof = (getattr(seen, name + of) for of in ("", "_unit", "_dof"))
    informative = design.closed & (dof > 0) & np.isfinite(shown)
    freedom = float(dof[informative].sum())
    if freedom < _FEWEST_REPEATED:
        return 0.0
    rows = np.where(np.isfinite(seen.row_temporal), np.maximum(seen.row_temporal, 1.0), 1.0)
    chance = unit[informative] * rows[informative]
    weight = dof[informative]
    if chi2_beyond(float(np.sum(weight * shown[informative] / chance)), int(freedom)) > _CHANCE:
        return 0.0
    wander2 = float(np.sum(weight * (shown[informative] - chance)) / freedom)
    noise2 = float(np.nanmedian(seen.variance[informative]))
    return float(np.sqrt(np.clip(wander2, 0.0, _MOST_SHARE**2 * noise2)))


# ---- the order of frames -------------------------------------------------------------------------------------------
_PERIODS: Final = range(2, 13)  # frames
_KNOWN_TO: Final = 0.01  # of a frame's light: darker frames show nothing
_FEWEST_FRAMES: Final = 12  # frames
_RANK: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Periodic:
    """Light that comes back in the order of the frames."""

    period: int  # frames from one to the next
    depth: float  # largest against smallest mean light of the frames of one phase, relative
    rms: float  # standard deviation of the light over the phases, relative
    p_value: float  # chance of that much among all periods without it
    levels: tuple[float, ...] = ()  # light of the frames of each phase over that of the usual one


class FrameLight:
    """Hands frames on and keeps what each shows: the light of its tiles above black in DN, and of a scene its details.

    Attributes:
        structures: Fine structure of each frame with light, by its position; empty where the scene is known.
    """

    def __init__(self, design: Design, read: FrameReader) -> None:
        self._design, self._read = design, read
        black = np.nan_to_num(design.black_level_dn)
        self._black = {frame: black[n] for n, capture in enumerate(design.captures) for frame in capture.frames}
        self._light: dict[int, Array] = {}
        self.structures: dict[int, FineStructure] = {}

    def __call__(self, index: int) -> Frame:
        """Return a frame by its position in the header."""
        frame = self._read(index)
        if frame.shape == self._design.shape:
            means = [float(frame.dn[tile.slices].mean()) for tile in self._design.tiles]
            black_dn = self._black.get(index, 0.0)
            self._light[index] = np.array(means) - black_dn
            if not (self._design.uniform or self._design.header.frames[index].settings.is_dark):
                self.structures[index] = FineStructure.of(frame.dn, black_dn, frame.saturated_dn)
        return frame

    def of_tiles(self, frames: tuple[int, ...]) -> Array:
        """Return the mean of each tile above black in frames, (frames, tiles), in DN."""
        return np.stack([self._light[index] for index in frames])

    def of_capture(self, frames: tuple[int, ...], clear: NDArray[np.bool_]) -> Array:
        """Return the light of frames in those tiles that none of them clips, over its mean, less 1."""
        light = np.array([float(self._light[index][clear].sum()) for index in frames])
        return light / light.mean() - 1.0 if light.mean() > 0 else np.zeros(light.size)


def periodic(design: Design, light: FrameLight, unit: Array, clear: NDArray[np.bool_]) -> Periodic | None:
    """Return the period in which the light of frames comes back; None where chance explains what there is.

    Any dependence on a frame's place within its capture is removed first, apart for captures that go on with the
    setting before. A first frame that differs, or a drift within the repeats, has a separate statistic.

    Args:
        unit: (captures,) relative variance of a frame's light by the noise of its pixels alone.
        clear: (captures, tiles) where no frame clips.
    """
    lit = ~design.closed & (design.source_level > 0) & (unit < _KNOWN_TO**2) & clear.any(axis=1)
    chosen = [n for n in np.flatnonzero(lit).tolist() if len(design.captures[n].frames) > 1]
    if sum(len(design.captures[n].frames) for n in chosen) < _FEWEST_FRAMES:
        return None
    apart = [light.of_capture(design.captures[n].frames, clear[n]) for n in chosen]
    more = max(float(np.median([np.var(a, ddof=1) - unit[n] for a, n in zip(apart, chosen, strict=True)])), 0.0)
    weight = [1.0 / (unit[n] + more) for n in chosen]
    frames, goes_on = [design.captures[n].frames for n in chosen], [design.goes_on(n) for n in chosen]
    found = [_rated(frames, goes_on, apart, weight, period) for period in _PERIODS]
    best = min((entry for entry in found if entry is not None), key=lambda entry: entry.p_value, default=None)
    if best is None or best.p_value * len(_PERIODS) > FRAME_SIGNIFICANCE:
        return None
    return replace(best, p_value=min(best.p_value * len(_PERIODS), 1.0))


def steadied(design: Design, light: FrameLight, seen: CaptureStatistics, again: Periodic) -> CaptureStatistics:
    """Return the statistics as they would be if all frames of a capture had its mean light.

    A known dependence on the order of the frames would look like flicker and like a first frame that differs. Means
    stay as they are: the noise of the frames is that of the light that they had.
    """
    found = {name: getattr(seen, name).copy() for name in ("first", "common", "common_unit")}
    level = np.array(again.levels)
    for number, capture in enumerate(design.captures):
        if design.closed[number] or not design.source_level[number] > 0:
            continue
        black_dn = float(design.black_level_dn[number])
        own = level[np.array(capture.frames) % again.period][:, None]
        even = light.of_tiles(capture.frames) * own.mean() / own + (black_dn if np.isfinite(black_dn) else 0.0)
        there = {name: getattr(seen, name)[number] for name in ("mean", "variance", "pixels", "low", "high")}
        for name, value in light_of_frames(even, there, black_dn).items():
            found[name][number] = value
    return replace(seen, **found)


def _rated(
    frames: list[tuple[int, ...]], goes_on: list[bool], apart: list[Array], weight: list[float], period: int
) -> Periodic | None:
    """Return the one-way analysis of variance by phase, captures' means and places within a capture taken out."""
    longest = max(len(numbers) for numbers in frames)
    phases, places, values = [], [], []
    for numbers, later, light, known in zip(frames, goes_on, apart, weight, strict=True):
        phase = np.equal.outer(np.array(numbers) % period, np.arange(period)).astype(np.float64)
        place = np.eye(2 * longest)[later * longest :][: len(numbers)]
        phases.append((phase - phase.mean(axis=0)) * np.sqrt(known))
        places.append((place - place.mean(axis=0)) * np.sqrt(known))
        values.append((light - light.mean()) * np.sqrt(known))
    of_place, of_phase = np.concatenate(places), np.concatenate(phases)
    columns, seen = residual(of_place, of_phase, rank=_RANK), residual(of_place, np.concatenate(values), rank=_RANK)
    left, size, right = np.linalg.svd(columns, full_matrices=False)
    kept = size > _RANK * np.linalg.norm(of_phase)  # a period that is that of the series leaves nothing
    rank = int(kept.sum())
    freedom = seen.size - len(frames) - int(np.linalg.matrix_rank(of_place)) - rank
    if not rank or freedom < 1:
        return None
    along = left[:, kept].T @ seen
    level = right[kept].T @ (along / size[kept])
    rest = max(float(seen @ seen - along @ along), 1e-300)
    f_ratio = float(along @ along) / rank / (rest / freedom)
    usual = tuple((1.0 + level - float(np.median(level))).tolist())
    return Periodic(period, float(np.ptp(level)), float(np.std(level)), float(fdtrc(rank, freedom, f_ratio)), usual)


# ---- scenes ---------------------------------------------------------------------------------------------------------
_MOST_BLOCKS: Final = 32  # along either side of a frame
_SMALLEST_BLOCK_PX: Final = 4
_SAMPLES: Final = 12  # pixels along a block's side that are looked at, every n-th of large frames
_FEWEST_BLOCKS: Final = 100  # that both frames show, beyond the smooth terms
_FAINTEST: Final = 10.0  # times the noise of a block's mean
_LEAST_CONTRAST: Final = 0.05  # standard deviation of the logarithm: even fields have a hundredth and less
_COMPARED: Final = 3  # latest frames of each scene: exposures far apart share few blocks that show either
_SAME: Final = 0.5  # least correlation of one scene's fine structure; that of different ones scatters about 0


@dataclass(frozen=True, slots=True)
class FineStructure:
    """Fine structure of a frame in blocks of pixels."""

    log_light: Array  # (rows, columns) logarithm of a block's mean above black; NaN where it is clipped or too dark
    noise2: Array  # (rows, columns) bound on its variance by the noise of the pixels

    @classmethod
    def of(cls, dn: NDArray[np.generic], black_dn: float, full_scale_dn: int) -> FineStructure:
        """Return what a frame shows.

        Args:
            black_dn: Black level; 0 where none is stated.
            full_scale_dn: Highest code: a block that holds it is clipped.
        """
        step = max(1, max(dn.shape) // (_MOST_BLOCKS * _SAMPLES))
        dn = dn[::step, ::step]
        side = max(_SMALLEST_BLOCK_PX, -(-max(dn.shape) // _MOST_BLOCKS))
        rows, columns = dn.shape[0] // side, dn.shape[1] // side
        blocks = dn[: rows * side, : columns * side].reshape(rows, side, columns, side)
        values = blocks.astype(np.float32)
        mean = np.asarray(values.mean(axis=(1, 3), dtype=np.float64))
        apart = values - mean.astype(np.float32)[:, None, :, None]
        scatter2 = np.asarray(np.square(apart).mean(axis=(1, 3), dtype=np.float64))
        light, noise = mean - black_dn, np.sqrt(scatter2) / side
        clear = (light > np.maximum(_FAINTEST * noise, 0.0)) & (blocks.max(axis=(1, 3)) < full_scale_dn)
        light = np.where(clear, light, np.nan)
        return cls(np.log(light), np.square(noise / light))

    def correlation(self, other: FineStructure) -> float | None:
        """Return the correlation of two frames' fine structure; None where either has too little structure."""
        known = np.isfinite(self.log_light) & np.isfinite(other.log_light)
        row, column = np.nonzero(known)
        y, x = (2.0 * at / max(size - 1, 1) - 1.0 for at, size in zip((row, column), known.shape, strict=True))
        surface = np.column_stack([x * y, x * x * y, x * y * y, x * x * y * y])
        terms = np.hstack([np.eye(known.shape[0])[row], np.eye(known.shape[1])[column], surface])  # smooth ones
        if known.sum() - terms.shape[1] < _FEWEST_BLOCKS:
            return None
        both = np.column_stack([self.log_light[known], other.log_light[known]])
        rest = residual(terms, both)
        contrast2 = np.mean(np.square(rest), axis=0)
        noise2 = np.array([float(np.mean(noise2[known])) for noise2 in (self.noise2, other.noise2)])
        if (contrast2 < np.maximum(_LEAST_CONTRAST**2, _FAINTEST * noise2)).any():
            return None
        products = rest.T @ rest
        return float(products[0, 1] / np.sqrt(products[0, 0] * products[1, 1]))


def scenes_of(structures: Mapping[int, FineStructure]) -> dict[int, int]:
    """Return the number of the scene, from 0 on, that each frame of one pattern shows.

    A frame with too little structure counts as the scene of the frame before.

    Args:
        structures: Of each frame, by its position in the header.
    """
    found: dict[int, int] = {}
    latest: list[deque[FineStructure]] = []  # of each scene
    scene = 0
    for frame, own in sorted(structures.items()):
        likeness = [[r for other in members if (r := own.correlation(other)) is not None] for members in latest]
        recognised = {number: max(several) for number, several in enumerate(likeness) if several}
        if recognised:
            best = max(recognised, key=lambda number: recognised[number])
            scene = best if recognised[best] >= _SAME else len(latest)
        if scene == len(latest):
            latest.append(deque(maxlen=_COMPARED))
        latest[scene].append(own)
        found[frame] = scene
    return found

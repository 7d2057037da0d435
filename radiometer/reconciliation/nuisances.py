"""The parameters that are always fitted and never named: responsivity, patch radiances, undeclared figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.comparison import Comparison
from radiometer.reconciliation.design import Design, Tile
from radiometer.reconciliation.linear import RowBlock
from radiometer.reconciliation.statistics import STATISTICS, Prediction
from radiometer.reconciliation.tile_model import Nuisance
from radiometer.typing import Array

_FREE_LOG: Final = 5.0  # prior standard deviation of the logarithm of what is unknown: e^±5
_DEFAULT_U_REL: Final = 0.02  # of a radiance that is stated without an uncertainty
_SAME_U_REL: Final = 5e-3  # by how much the same patch differs between patterns
_STEP: Final = 1e-4
_SLOPE_STEP: Final = 1e-4
_TEXTURE_STEP: Final = 1e-6
_BRIGHT_SHARE: Final = 0.05  # of the brightest tile: enough to tell the responsivity roughly
_FREE_RESPONSIVITY: Final = 50.0  # where no radiance is known its unit is arbitrary too
_SCALAR_STEP: Final = {"black_dn": 1e-2, "dark_e_per_s": 1e-2}
_FREE_BLACK: Final = 2.5  # of the full scale: anywhere in the converter's range
_SCALAR_PRIOR: Final = {"log_responsivity": _FREE_RESPONSIVITY, "dark_e_per_s": 1e3}
_STATED: Final = 1.0  # prior standard deviation below which a radiance counts as stated
_HELD: Final = 1e-3  # of the uncertainty of stated radiances, for a fit to which they are exact
_DIMMEST: Final = 600.0  # logarithm of a factor that a step of a fit may ask for: it stays a number above zero
_LINEAR_FROM: Final = -0.5  # relative error of a radiance from which on its factor is linear
_DETERMINED_K: Final = 2.0  # span of temperatures of darks from which they show how dark current grows
_FREE_SLOPE: Final = 3.0
_FREE_TEXTURE: Final = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Change by a step of a nuisance, per unit of the step: of the means in DN, and of the whitened residual."""

    mean: Array
    residual: Array


@dataclass(frozen=True, slots=True, eq=False)
class NuisanceLayout:
    """The fitted nuisances with their order and priors."""

    scalars: tuple[str, ...]  # names of scalar nuisances
    patterns: tuple[int, ...]  # patterns that were seen in light
    patch: NDArray[np.intp]  # (tiles,) number of the patch that each tile is a part of: all have its radiance
    shared: NDArray[np.intp]  # (patterns, patches) number of the error that each radiance has in common with others
    free_scene: bool  # whether slope and texture of every tile are fitted too
    prior: Array  # prior standard deviation of each parameter

    @classmethod
    def of(cls, design: Design) -> NuisanceLayout:
        """Return what must be fitted for a design."""
        camera = design.header.camera
        scalars = ["log_responsivity"]
        if camera.conversion_gain_e_per_dn is None:
            scalars.append("log_gain")
        if camera.read_noise_e is None:
            scalars.append("log_read")
        if np.isnan(design.black_level_dn).any():
            scalars.append("black_dn")
        if dark_current_is_free(design) and np.ptp(np.log(design.exposure_s)) > 0:
            scalars.append("dark_e_per_s")
        lit = ~design.closed & (design.source_level > 0)
        patterns = tuple(sorted(set(design.pattern_index[lit].tolist())))
        free_scene = not design.uniform
        wide = _SCALAR_PRIOR | {"black_dn": _FREE_BLACK * camera.full_scale_dn}
        prior = [wide.get(name, _FREE_LOG) for name in scalars]
        _, first = np.unique(design.patch_of_tile, return_index=True)
        patches = [design.tiles[at] for at in first.tolist()]  # what is known of a patch is known of all its tiles
        own = [_radiance_prior(design, p, tile) for p in patterns for tile in patches]
        # A calibration error may be one and the same for several radiances, or not: each has a part of its own and
        # one that it shares.
        shared = _shared_errors(patches, patterns)
        prior += [*own, *_shared_priors(design, patches, shared, own)]
        if free_scene:
            count = len(patterns) * len(design.tiles)
            prior += [_FREE_SLOPE] * (2 * count) + [_FREE_TEXTURE] * count
        return cls(tuple(scalars), patterns, design.patch_of_tile, shared, free_scene, np.array(prior))

    @property
    def size(self) -> int:
        """Return the number of parameters."""
        return self.prior.size

    @property
    def _radiances(self) -> slice:
        return slice(len(self.scalars), len(self.scalars) + self.shared.size)

    @property
    def _common(self) -> slice:
        count = int(self.shared.max(initial=-1)) + 1
        return slice(self._radiances.stop, self._radiances.stop + count)

    @property
    def stated(self) -> NDArray[np.bool_]:
        """Return which parameters are errors of stated radiances, (parameters,)."""
        errors = np.zeros(self.size, np.bool_)
        errors[self._radiances.start : self._common.stop] = True
        return errors & (self.prior < _STATED)

    def held(self) -> NuisanceLayout:
        """Return the layout in which stated radiances are hardly free."""
        return replace(self, prior=np.where(self.stated, _HELD * self.prior, self.prior))

    def unpack(self, design: Design, values: Array) -> Nuisance:
        """Return the nuisances of a parameter vector."""
        start = Nuisance.start(design)
        radiance, slope, texture = start.log_radiance, start.slope, start.off.texture
        index = list(self.patterns)
        if index:
            radiance[index] = self._light(values)[0][:, self.patch]
        if self.free_scene and index:
            rises = slice(self._common.stop, self._common.stop + 2 * len(index) * self.patch.size)
            slope[index] = values[rises].reshape(len(index), 2, self.patch.size)
            texture[index] = values[rises.stop :].reshape(len(index), self.patch.size)
        known = dict(zip(self.scalars, values[: len(self.scalars)].tolist(), strict=True))
        # The means fix responsivity times gain: what K gains the responsivity loses.
        known["log_responsivity"] -= known.get("log_gain", 0.0)
        return replace(start, log_radiance=radiance, slope=slope).with_off(texture=texture, **known)

    def derivatives(
        self, comparison: Comparison, changes: Sequence[Change], values: Array
    ) -> tuple[RowBlock, RowBlock]:
        """Return −d(residual)/d(parameter): of the statistics that measure the light, and of the variances as far as
        they follow it.

        The latter do not say how much light there is (see `_only_means`), but the light says how large they are.

        Returns:
            (entries, parameters) of the former, and of the latter.
        """
        light, *others = changes
        scalars, scene = others[: len(self.scalars)], others[len(self.scalars) :]
        alone = np.stack([-change.residual for change in scalars], axis=1)
        _only_means(alone, comparison, self.scalars.index("log_responsivity"))
        shows = [(light, _TILE_ROWS), *zip(scene, (("slope_x", "slope_y"), ("spatial",)), strict=False)]
        rows = np.flatnonzero(alone.any(axis=1) | _moved_rows(comparison, shows))
        tiles = _TileColumns(comparison, rows, self.size, self.patterns)
        tiles.matrix[:, : len(scalars)] = alone[rows]
        tiles.write(light, self._radiances.start, _TILE_ROWS, self.patch)
        self._share(tiles.matrix, values)
        start = self._common.stop
        for number, pattern in enumerate(self.patterns if scene else ()):
            for axis, name in enumerate(("slope_x", "slope_y")):
                first = start + (2 * number + axis) * self.patch.size
                tiles.write(scene[0], first, (name,), only=pattern)
            first = start + (2 * len(self.patterns) + number) * self.patch.size
            tiles.write(scene[1], first, ("spatial",), only=pattern)
        return RowBlock(rows, tiles.matrix), self._followers(comparison, light, values)

    def _share(self, matrix: Array, values: Array) -> None:
        """Turn columns of the light of each patch into those of the patch's error, and write those of shared errors."""
        if self.patterns:
            own, common = matrix[:, self._radiances], matrix[:, self._common]
            own *= self._light(values)[1].ravel()
            common[:] = 0.0
            for number, errors in enumerate(self.shared):  # one pattern has each error once
                common[:, errors] += own[:, number * errors.size : (number + 1) * errors.size]

    def _followers(self, comparison: Comparison, light: Change, values: Array) -> RowBlock:
        rows = np.flatnonzero(_moved_rows(comparison, [(light, _FOLLOWING)]))
        tiles = _TileColumns(comparison, rows, self.size, self.patterns)
        tiles.write(light, self._radiances.start, _FOLLOWING, self.patch)
        if self.patterns and "log_gain" not in self.scalars:
            tiles.matrix[:, 0] = tiles.matrix[:, self._radiances].sum(axis=1)
        self._share(tiles.matrix, values)
        return RowBlock(rows, tiles.matrix)

    def moves(self, at: Nuisance) -> Iterator[tuple[Nuisance, float]]:
        """Yield the nuisances a step away, and the step: of all light, each scalar, and all rises and textures."""
        yield replace(at, log_radiance=at.log_radiance + _STEP), _STEP
        for name in self.scalars:
            step = _SCALAR_STEP.get(name, _STEP)
            shifted = {name: getattr(at.off, name) + step}
            if name == "log_gain":
                shifted["log_responsivity"] = at.off.log_responsivity - step
            yield at.with_off(**shifted), step
        if self.free_scene:
            yield replace(at, slope=at.slope + _SLOPE_STEP), _SLOPE_STEP
            yield at.with_off(texture=at.off.texture + _TEXTURE_STEP), _TEXTURE_STEP

    def is_linear(self, values: Array) -> bool:
        """Return whether means are linear in the errors of all stated radiances: none is off its linear factor."""
        relative, stated = self._relative(values)
        return bool(np.all(relative[stated] >= _LINEAR_FROM))

    def _relative(self, values: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return by how much each patch is off, and whether its radiance is stated, (patterns, patches)."""
        shape = self.shared.shape
        relative = values[self._radiances].reshape(shape) + values[self._common][self.shared]
        own = self.prior[self._radiances].reshape(shape) < _STATED
        return relative, own & (self.prior[self._common] < _STATED)[self.shared]

    def _light(self, values: Array) -> tuple[Array, Array]:
        """Return ln of the factor on each patch's radiance, and its derivative, (patterns, patches).

        A patch is off by its own part and by that which it shares. Where its radiance is stated the factor is 1 + x.
        Means are then linear in x, down to half of what is stated. What an effect had been mistaken for is given back
        at once when the effect enters. Where it is free it is exp x, so that brighter patches and a lower responsivity
        are the same thing.
        """
        relative, stated = self._relative(values)
        factor, slope = _light_factor(np.where(stated, relative, 0.0))
        return np.where(stated, np.log(factor), relative), np.where(stated, slope / factor, 1.0)


class _TileColumns:
    """Columns of the tiles (and patterns), zero but in some rows."""

    def __init__(
        self, comparison: Comparison, rows: NDArray[np.intp], parameters: int, patterns: tuple[int, ...]
    ) -> None:
        self.matrix = np.zeros((rows.size, parameters))
        self._comparison, self._patterns = comparison, patterns
        self._place = np.full(comparison.size, -1, dtype=np.intp)
        self._place[rows] = np.arange(rows.size)

    def write(
        self,
        change: Change,
        first: int,
        blocks: tuple[str, ...],
        column_of: NDArray[np.intp] | None = None,
        only: int | None = None,
    ) -> None:
        """Write the change of each tile into the column of that tile (and pattern)."""
        comparison = self._comparison
        pattern_of, tiles = comparison.design.pattern_index, np.arange(len(comparison.design.tiles))
        place = tiles if column_of is None else column_of
        begins = np.flatnonzero(np.diff(place, prepend=-1))
        captures = np.flatnonzero(np.isin(pattern_of, self._patterns if only is None else (only,)))
        number = np.searchsorted(self._patterns, pattern_of[captures]) if only is None else np.zeros_like(captures)
        own = first + number[:, None] * begins.size + place
        for block in blocks:
            cut = comparison.cuts[block]
            rows = self._place[cut.start + captures[:, None] * tiles.size + tiles]
            if block == "mean":
                means = np.where(comparison.usable["mean"], change.mean, 0.0)
                values = comparison.whiteners["mean"][captures] * means[captures][:, None, :]
                values = np.add.reduceat(values, begins, axis=2)
                there = rows[:, 0] >= 0
                self.matrix[rows[there][:, :, None], own[there][:, None, begins]] += values[there]
                continue
            there = rows >= 0
            self.matrix[rows[there], own[there]] -= change.residual[cut].reshape(-1, tiles.size)[captures][there]


def _moved_rows(comparison: Comparison, shows: Iterable[tuple[Change, tuple[str, ...]]]) -> NDArray[np.bool_]:
    """Return which entries changes move, each in its own statistics; means of one capture are whitened together."""
    moved = np.zeros(comparison.size, np.bool_)
    for change, blocks in shows:
        for block in blocks:
            cut = comparison.cuts[block]
            moved[cut] |= change.residual[cut] != 0
            if block == "mean":
                moved[cut] |= np.repeat((change.mean != 0).any(axis=1), change.mean.shape[1])
    return moved


_TILE_ROWS: Final = tuple(name for name, row in STATISTICS.items() if row.determines_light)
_FOLLOWING: Final = tuple(name for name, row in STATISTICS.items() if row.follows_light)


def _light_factor(relative: Array) -> tuple[Array, Array]:
    """Return the factor on a radiance that is off by so much, and its derivative."""
    below = np.minimum(relative - _LINEAR_FROM, 0.0) / (1.0 + _LINEAR_FROM)
    slope = np.exp(np.maximum(below, -_DIMMEST))
    return np.asarray((1.0 + np.maximum(relative, _LINEAR_FROM)) * slope), np.asarray(slope)


def _only_means(matrix: Array, comparison: Comparison, column: int) -> None:
    """Let the means alone say how much light there is.

    They determine it a hundred times better than the noise does; a wrong noise figure (crosstalk, a wrong conversion
    gain) would otherwise pull at the responsivity and show as a disagreement of all means.
    """
    for block, cut in comparison.cuts.items():
        if block not in _TILE_ROWS:
            matrix[cut, column] = 0.0


def _radiance_prior(design: Design, pattern: int, tile: Tile) -> float:
    known = tile.radiance[pattern]
    if known is None or known <= 0:
        return _SAME_U_REL if pattern in design.same_patches else _FREE_LOG
    return max(tile.u_rel, 1e-6) if tile.u_rel is not None else _DEFAULT_U_REL


def dark_current_is_free(design: Design) -> bool:
    """Return whether the dark current is a nuisance: a camera whose noise is stated has the one stated, or none.

    Where darks at several temperatures determine its whole law it is an effect to be named, not a nuisance.
    """
    camera, dark_c = design.header.camera, design.temperature_c[design.closed]
    if dark_c.size and np.isfinite(dark_c).all() and np.ptp(dark_c) > _DETERMINED_K:
        return False
    noise_stated = camera.conversion_gain_e_per_dn is not None and camera.read_noise_e is not None
    return camera.dark_current_e_per_s is None and not noise_stated


def _shared_errors(patches: Sequence[Tile], patterns: tuple[int, ...]) -> NDArray[np.intp]:
    """Return which error of calibration each radiance has in common with others, (patterns, patches).

    A number that is stated at several places, where the chart was turned or shifted, was measured once: its error is
    common to all of them. What a place shows otherwise under several patterns has an error of the place.
    """
    keys = np.array([[f"patch {k}" for k in range(len(patches))] for _ in patterns], dtype=object)
    places: dict[float, list[tuple[int, int]]] = {}
    for number, pattern in enumerate(patterns):
        for k, tile in enumerate(patches):
            if tile.radiance[pattern]:
                places.setdefault(float(tile.radiance[pattern] or 0.0), []).append((number, k))
    for stated, entries in places.items():
        alone = len({number for number, _ in entries}) == len(entries)
        if alone and len({k for _, k in entries}) > 1:
            for entry in entries:
                keys[entry] = f"value {stated!r}"
    if not patterns:
        return np.zeros((0, len(patches)), dtype=np.intp)
    return np.unique(keys.astype(str), return_inverse=True)[1].reshape(keys.shape).astype(np.intp)


def _shared_priors(design: Design, patches: Sequence[Tile], shared: NDArray[np.intp], own: list[float]) -> list[float]:
    _, first = np.unique(shared, return_index=True)
    found = []
    for at in first.tolist():
        unknown = design.same_patches and patches[at % len(patches)].radiance[0] is None
        found.append(_FREE_LOG if unknown else own[at])
    return found


def rough_log_responsivity(design: Design, seen_mean: Array, base: Prediction, usable: NDArray[np.bool_]) -> float:
    """Return a robust first guess of the logarithm of the responsivity over the declared one."""
    black = np.where(np.isnan(design.black_level_dn), np.nanmin(seen_mean), design.black_level_dn)[:, None]
    seen, expected = seen_mean - black, base.signal * base.gain[:, None]
    bright = usable & (expected > 0) & (seen > _BRIGHT_SHARE * float(np.max(seen, where=usable, initial=0.0)))
    if not bright.any():
        return 0.0
    return float(np.median(np.log(seen[bright] / expected[bright])))

"""The captures that could be taken next: settings to choose from, and what a model expects of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import FrameEntry, FrameSettings
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.measure.design import BRIGHT_SURROUND, DARK_SURROUND, Design
from radiometer.reconciliation.measure.pattern_images import PatternImages
from radiometer.reconciliation.model.tile_model import TileModel
from radiometer.reconciliation.prediction import Prediction
from radiometer.typing import Array
from simulators.effects.context import ExposureContext

FRAMES: Final = 4  # of one proposed capture
_PATCH_U_REL: Final = 3e-3  # how well a patch's radiance is known after a fit
_CLIPPED: Final = 0.95  # share of full scale
_QUANTILES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the exposures in use
_GAINS_DB: Final = (0.0, 12.0)
_LEVELS: Final = (1.0, 0.25)
_ALIKE: Final = 0.1  # a cell that differs less from a patch belongs to it …
_REACH: Final = 2.0  # … within twice its half-width


@dataclass(frozen=True, eq=False)
class CapturePool:
    """Captures to choose from.

    Attributes:
        design: One capture for each.
        images: Mean picture of each pattern, those of other surrounds made up.
        state: The fitted model that says what to expect.
    """

    design: Design
    images: PatternImages
    state: FitState

    @classmethod
    def of(cls, state: FitState) -> CapturePool:
        """Return the captures that the rig of a fitted set could take."""
        old = state.design
        header, patterns, images = old.header, old.patterns, state.model.images
        if old.uniform and header.source.kind == "screen":
            unseen = tuple(name for name in (BRIGHT_SURROUND, DARK_SURROUND) if name not in patterns)
            patterns, images = (*patterns, *unseen), _with_surrounds(old, images, unseen)
        frames = tuple(FrameEntry.of("", settings) for settings in dict.fromkeys(_settings(old, patterns)))
        patches = tuple(_extended(patch, old.patterns[0], patterns) for patch in header.patches)
        pool = header.model_copy(update={"frames": frames, "patterns": patterns, "patches": patches})
        return cls(Design.of(pool, old.shape), images, state)

    @cached_property
    def context(self) -> ExposureContext:
        """Return the captures as effects see them, together with the set's own."""
        return TileModel.of(self.design, self.images).context

    @cached_property
    def is_new(self) -> NDArray[np.bool_]:
        """Return for each capture whether its settings differ from all that were taken."""
        taken = {_settings_of(capture.settings) for capture in self.state.design.captures}
        return np.array([_settings_of(capture.settings) not in taken for capture in self.design.captures])

    def frame(self, index: int) -> FrameEntry:
        """Return the setting of a capture."""
        return self.design.header.frames[self.design.captures[index].frames[0]]

    def predicted(self, state: FitState) -> Prediction:
        """Return what a fitted model expects of every capture."""
        model = replace(TileModel.of(self.design, self.images), effects=state.effects, given=state.model.given)
        old = state.nuisance
        more = len(self.design.patterns) - old.log_radiance.shape[0]
        rows = np.concatenate([np.arange(old.log_radiance.shape[0]), np.zeros(more, dtype=np.intp)])
        shown = replace(old, log_radiance=old.log_radiance[rows], slope=old.slope[rows])
        return model.predict(shown.with_off(texture=old.off.texture[rows]))

    def separation(self, first: Prediction, second: Prediction) -> Array:
        """Return for each capture the χ² by which two predictions would differ in its unclipped tiles, (captures,)."""
        design = self.design
        pixels = np.array([tile.width * tile.height for tile in design.tiles])
        light = np.maximum(first.mean - np.nan_to_num(design.black_level_dn)[:, None], 0.0)
        noise2 = first.variance / (pixels * FRAMES) + (_PATCH_U_REL**2 + self.state.tau**2) * light**2
        top = _CLIPPED * design.header.camera.saturated_dn
        clear = (first.mean < top) & (second.mean < top)
        # What a new pattern scatters into the patches is known only if none of it clips.
        unseen = design.pattern_index >= len(self.state.design.patterns)
        clear &= ~(unseen & (first.mean >= top).any(axis=1))[:, None]
        means = np.sum(np.where(clear, (first.mean - second.mean) ** 2 / noise2, 0.0), axis=1)
        log_ratio2 = np.log(first.variance / second.variance) ** 2
        spreads = np.sum(np.where(clear, log_ratio2 * pixels * (FRAMES - 1) / 4.0, 0.0), axis=1)
        return np.asarray(means + spreads + (first.edge - second.edge) ** 2 / self._edge_u**2)

    @cached_property
    def _edge_u(self) -> float:
        """Return how well the blend at the patches' borders was measured in one capture; infinite if it was not."""
        seen = self.state.seen.edge_u
        return float(np.median(seen[np.isfinite(seen)])) if np.isfinite(seen).any() else np.inf


def _settings_of(settings: FrameSettings) -> FrameSettings:
    return replace(settings, timestamp_s=None, temperature_c=None)


def _settings(design: Design, patterns: tuple[str, ...]) -> list[FrameSettings]:
    """Return settings to choose from: those in use, crossed with what was not tried."""
    lit = np.where(design.closed, -1.0, design.source_level)
    base = replace(design.captures[int(np.argmax(lit))].settings, gain_db=0.0, timestamp_s=None, temperature_c=None)
    with_light = design.exposure_s[lit > 0] if (lit > 0).any() else design.exposure_s
    found = []
    for t in np.unique(np.quantile(design.exposure_s, _QUANTILES)):
        for gain in _GAINS_DB:
            now = replace(base, exposure_s=float(t), gain_db=gain)
            found += [replace(now, shutter="closed"), replace(now, source_level=0.0)]
    for t in np.unique(np.quantile(with_light, _QUANTILES)):
        now = replace(base, exposure_s=float(t))
        found += [replace(now, gain_db=gain, source_level=level) for gain in _GAINS_DB for level in _LEVELS]
        if base.f_number:
            stops = np.unique(design.f_number)
            found += [replace(now, f_number=float(stop)) for stop in (*stops, 2.0 * stops[-1])]
        found += [replace(now, pattern=pattern) for pattern in patterns]
    return found


def _extended(patch: Any, first: str, patterns: tuple[str, ...]) -> Any:
    known = patch.radiance_W_per_sr_m2
    if not isinstance(known, Mapping) or first not in known:
        return patch
    extra = {name: known[first] for name in patterns if name not in known}
    return patch.model_copy(update={"radiance_W_per_sr_m2": dict(known) | extra})


def _with_surrounds(design: Design, images: PatternImages, names: tuple[str, ...]) -> PatternImages:
    """Return the pictures with those of the first pattern's patches in other surrounds, by the surrounds' names."""
    pictures = [images.picture(p) for p in range(images.total.shape[0])]
    patches = _is_patch(design, pictures[0], images.cell_px)
    level = {BRIGHT_SURROUND: pictures[0].max(), DARK_SURROUND: 0.0}
    total = np.stack([*pictures, *(np.where(patches, pictures[0], level[name]) for name in names)])
    return replace(images, total=total, weight=np.ones_like(total))


def _is_patch(design: Design, picture: Array, cell: int) -> NDArray[np.bool_]:
    """Return for each cell of a picture whether it shows its nearest patch, which may exceed the analysed area."""
    tiles = design.tiles
    x = (np.arange(picture.shape[1])[None, :, None] + 0.5) * cell
    y = (np.arange(picture.shape[0])[:, None, None] + 0.5) * cell
    middle = np.array([(tile.x + tile.width / 2, tile.y + tile.height / 2) for tile in tiles])
    half = np.array([(tile.width / 2 + tile.margin, tile.height / 2 + tile.margin) for tile in tiles])
    away = np.maximum(np.abs(x - middle[:, 0]) / half[:, 0], np.abs(y - middle[:, 1]) / half[:, 1])
    inside = [picture[away[..., n] <= 1.0] for n in range(len(tiles))]
    levels: Array = np.array([np.median(values) if values.size else np.nan for values in inside])
    level, closest = levels[np.argmin(away, axis=-1)], np.min(away, axis=-1)
    alike = np.abs(picture - level) < _ALIKE * level
    return np.asarray((closest <= 1.0) | (alike & (closest < _REACH)))

"""The captures that could be taken next: settings to choose from, and what a model expects of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from radiometer.data import FrameEntry, FrameSettings
from radiometer.reconcile.design import BRIGHT_SURROUND, DARK_SURROUND, Array, Design
from radiometer.reconcile.pattern_images import PatternImages
from radiometer.reconcile.state import FitState
from radiometer.reconcile.tile_model import Prediction, TileModel

FRAMES: Final = 4  # of one proposed capture
_PATCH_U_REL: Final = 3e-3  # how well a patch's radiance is known after a fit
_CLIPPED: Final = 0.95  # share of full scale
_QUANTILES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the exposures in use
_GAINS_DB: Final = (0.0, 12.0)
_LEVELS: Final = (1.0, 0.25)


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
        if _shows_patterns(old):
            patterns, images = (*patterns, BRIGHT_SURROUND, DARK_SURROUND), _with_surrounds(old, images)
        frames = tuple(FrameEntry.of("", settings) for settings in dict.fromkeys(_settings(old, patterns)))
        patches = tuple(_extended(patch, old.patterns[0], patterns) for patch in header.patches)
        pool = header.model_copy(update={"frames": frames, "patterns": patterns, "patches": patches})
        return cls(Design.of(pool, old.shape), images, state)

    def frame(self, index: int) -> FrameEntry:
        """Return the setting of a capture."""
        return self.design.header.frames[self.design.captures[index].frames[0]]

    def predicted(self, state: FitState) -> Prediction:
        """Return what a fitted model expects of every capture."""
        model = replace(TileModel.of(self.design, self.images), effects=state.effects, given=state.model.given)
        old = state.nuisance
        more = len(self.design.patterns) - old.log_radiance.shape[0]
        rows = np.concatenate([np.arange(old.log_radiance.shape[0]), np.zeros(more, dtype=np.intp)])
        return model.predict(replace(old, log_radiance=old.log_radiance[rows], slope=old.slope[rows]))

    def separation(self, first: Prediction, second: Prediction) -> Array:
        """Return for each capture the χ² by which two predictions would differ, (captures,)."""
        design = self.design
        pixels = np.array([tile.width * tile.height for tile in design.tiles])
        light = np.maximum(first.mean - np.nan_to_num(design.black_level_dn)[:, None], 0.0)
        noise2 = first.variance / (pixels * FRAMES) + (_PATCH_U_REL**2 + self.state.tau**2) * light**2
        clipped = (first.mean > _CLIPPED * design.header.camera.full_scale_dn).any(axis=1)
        means = np.sum((first.mean - second.mean) ** 2 / noise2, axis=1)
        spreads = np.sum(np.log(first.variance / second.variance) ** 2 * pixels * (FRAMES - 1) / 4.0, axis=1)
        return np.where(clipped, 0.0, means + spreads)


def _shows_patterns(design: Design) -> bool:
    """Tell whether other surrounds can be shown, and were not shown yet."""
    fresh = not {BRIGHT_SURROUND, DARK_SURROUND} & set(design.patterns)
    return fresh and design.uniform and design.header.source.kind == "screen"


def _settings(design: Design, patterns: tuple[str, ...]) -> list[FrameSettings]:
    """Return settings to choose from: those in use, crossed with what was not tried."""
    lit = np.where(design.closed, -1.0, design.source_level)
    base = replace(design.captures[int(np.argmax(lit))].settings, gain_db=0.0, timestamp_s=None, temperature_c=None)
    found = []
    for t in np.unique(np.quantile(design.exposure_s, _QUANTILES)):
        now = replace(base, exposure_s=float(t))
        for gain in _GAINS_DB:
            louder = replace(now, gain_db=gain)
            found += [replace(louder, shutter="closed"), replace(louder, source_level=0.0)]
            found += [replace(louder, source_level=level) for level in _LEVELS]
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


def _with_surrounds(design: Design, images: PatternImages) -> PatternImages:
    """Return the pictures with two more: the first pattern's patches in a bright and in a dark surround."""
    picture = images.picture(0)
    inside = np.zeros(picture.shape, dtype=np.bool_)
    cell = images.cell_px
    for number, tile in enumerate(design.tiles):
        if number % 2 == 0:  # every other patch turns into surround where patches fill the picture
            rows = slice(tile.y // cell, -(-(tile.y + tile.height) // cell))
            inside[rows, tile.x // cell : -(-(tile.x + tile.width) // cell)] = True
    pictures = [images.picture(p) for p in range(images.total.shape[0])]
    pictures += [np.where(inside, picture, picture.max()), np.where(inside, picture, 0.0)]
    total = np.stack(pictures)
    return replace(images, total=total, weight=np.ones_like(total))

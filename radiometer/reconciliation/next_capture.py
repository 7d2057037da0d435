"""Proposes the capture that separates rival explanations, or that shows what these data cannot detect.

Each rival is fitted to the data as they are; of a pool of settings the one is chosen under which most of them would
then predict something else.

Source: Box & Hill (1967), discrimination among mechanistic models, in the form of Buzzi-Ferraris & Forzatti (1983).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import FrameEntry, FrameSettings
from radiometer.data.storage import write_yaml_atomic
from radiometer.reconciliation.descent import refit, refit_with
from radiometer.reconciliation.design import BRIGHT_SURROUND, DARK_SURROUND, Design
from radiometer.reconciliation.reduce import PatternImages
from radiometer.reconciliation.result import Limit, ReconcileResult
from radiometer.reconciliation.screening import best_start
from radiometer.reconciliation.state import FitState, with_effects, with_terms
from radiometer.reconciliation.statistics import Prediction
from radiometer.reconciliation.tile_model import TileModel
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

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
    """Captures to choose from."""

    design: Design  # one capture for each
    images: PatternImages  # mean picture of each pattern, those of other surrounds made up
    state: FitState  # the fitted model that says what to expect

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
        design = Design.of(pool, old.shape)
        return cls(design if old.uniform else replace(design, tiles=old.tiles), images, state)

    @cached_property
    def model(self) -> TileModel:
        """Return the ideal camera of the captures."""
        return TileModel.of(self.design, self.images)

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
        model = replace(self.model, effects=state.effects, given=state.model.given)
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
        seen = self.state.seen.edge_u
        return float(np.median(seen[np.isfinite(seen)])) if np.isfinite(seen).any() else np.inf


def _settings_of(settings: FrameSettings) -> FrameSettings:
    return replace(settings, timestamp_s=None, temperature_c=None)


def _settings(design: Design, patterns: tuple[str, ...]) -> list[FrameSettings]:
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


FORMAT: Final = "radiometer-plan/1"
_DISTINGUISHED_CHI2: Final = 30.0  # a pair that differs by more is distinguished; more has no further value
_HELPS_CHI2: Final = 4.0  # by so much a capture still helps where none does more
_REFITS: Final = 4
_WELL_BELOW: Final = 0.5
_STARTS: Final = 4  # of an entry, of which the likeliest is fitted
_EXPLAINS: Final = 0.3  # of what the best entry explains: below it an entry is no cause of a disagreement
_MOST_NAMED: Final = 6  # in a sentence


def propose(state: FitState, effect: CatalogueEffect, others: Sequence[CatalogueEffect]) -> dict[str, Any] | None:
    """Return the capture under which an effect and others that fit about as well would differ most.

    Args:
        state: The model without any of them.

    Returns:
        Settings, what they separate and the χ² expected of it; None where there are no others, or none that any
        capture of the pool could separate.
    """
    if not others:
        return None
    first, *models = (refit_with(state, entry, iterations=_REFITS) for entry in (effect, *others))
    named = dict(zip([other.name for other in others], models, strict=True))
    best = _best(first, named) or _best(first, named, _HELPS_CHI2)
    if best is None:
        return None
    frame, names, chi2 = best
    found = _advice(frame, f"separates {effect.name} from {', '.join(names)}")
    return found | {"separates": [effect.name, *names], "expected_chi2": round(chi2, 1)}


def propose_for_unnamed(
    state: FitState, catalogue: Mapping[str, type[CatalogueEffect]], places: Sequence[tuple[str, str]]
) -> dict[str, Any] | None:
    """Return the capture that would separate the possible causes of a disagreement without a name.

    Each entry that acts along the covariate is fitted in place of the empirical term. A setting by itself cannot be
    predicted by the others, so that a new setting is asked for: there the entries, and no effect at all, must differ.

    Args:
        places: Covariate and statistic of what has no name, the first first.

    Returns:
        Settings and what they separate; None where no entry acts there or no capture of the pool helps.
    """
    plain = with_terms(state, ())
    nothing = refit(plain, iterations=_REFITS)
    present = {effect.name for effect in (*state.effects, *state.model.given)}
    for where, block in dict.fromkeys(places):
        models = {}
        for name, kind in catalogue.items():
            acts = (kind.where, kind.block) == (where, block) and kind.usable(state.model.context)
            if acts and name not in present:
                best = best_start(nothing, kind.starts(state.model.context)[:_STARTS])
                if best is not None:
                    models[name] = refit(with_effects(plain, [*state.effects, best.effect]), iterations=_REFITS)
        farthest = _farthest(nothing, models)
        if farthest is not None:
            frame, names = farthest
            return _advice(frame, f"shows which of {', '.join(names)} it is, if any") | {"separates": names}
    return None


def _farthest(nothing: FitState, models: Mapping[str, FitState]) -> tuple[FrameEntry, list[str]] | None:
    """Return the new setting in which models that explain something differ most, from none and from each other."""
    gained = {name: nothing.cost - model.cost for name, model in models.items()}
    largest = max(gained.values(), default=0.0)
    names = [name for name, gain in gained.items() if gain > max(_EXPLAINS * largest, _HELPS_CHI2)]
    if not names:
        return None
    pool = CapturePool.of(nothing)
    expected = [pool.predicted(model) for model in (nothing, *(models[name] for name in names))]
    pairs = [pool.separation(a, b) for a, b in combinations(expected, 2)]
    worth = np.minimum(np.nan_to_num(np.stack(pairs)), _DISTINGUISHED_CHI2).sum(axis=0) * pool.is_new
    index = int(np.argmax(worth))
    return (pool.frame(index), names) if worth[index] > _HELPS_CHI2 else None


def propose_for_blind(
    state: FitState, catalogue: Mapping[str, type[CatalogueEffect]], limits: Mapping[str, Limit]
) -> dict[str, Any] | None:
    """Return the capture that would show most of the effects that these data cannot see at their usual size.

    Each of them is put in at its typical size, and the nuisances are fitted with it. What stays invisible now must
    show in the new capture.

    Args:
        limits: What these data would have shown.

    Returns:
        Settings and what they would open; None where nothing is blind or no capture of the pool helps.
    """
    able = CapturePool.of(state).model.context
    models = {}
    for name, limit in limits.items():
        starts = catalogue[name].starts(state.model.context) if name in catalogue else ()
        if starts and catalogue[name].usable(able) and not _would_show(limit, starts[0]):
            models[name] = refit_with(state, starts[0], iterations=_REFITS)
    best = _best(state, models)
    if best is None:
        return None
    frame, names, _ = best
    shown = ", ".join(names[:_MOST_NAMED]) + (" and others" if len(names) > _MOST_NAMED else "")
    return _advice(frame, f"would show {shown}") | {"opens": names}


def _would_show(limit: Limit, typical: CatalogueEffect) -> bool:
    value = typical.values().get(limit.parameter)
    if limit.amplitude is None or limit.parameter not in typical.free() or value is None:
        return limit.amplitude is not None
    return limit.amplitude < _WELL_BELOW * abs(float(value) - typical.neutral(limit.parameter))


def _best(
    state: FitState, models: Mapping[str, FitState], enough: float = _DISTINGUISHED_CHI2
) -> tuple[FrameEntry, list[str], float] | None:
    """Return the capture that separates most models from the state, which of them, and the least χ² among those."""
    if not models:
        return None
    pool = CapturePool.of(state)
    expected = pool.predicted(state)
    apart = np.nan_to_num(np.stack([pool.separation(expected, pool.predicted(one)) for one in models.values()]))
    worth = np.minimum(apart, _DISTINGUISHED_CHI2).sum(axis=0)
    index = int(np.lexsort((apart.min(axis=0), worth))[-1])
    separated: Array = apart[:, index]
    names = [name for name, chi2 in zip(models, separated, strict=True) if chi2 >= enough]
    if not names:
        return None
    return pool.frame(index), names, float(min(chi2 for chi2 in separated if chi2 >= enough))


def _advice(frame: FrameEntry, purpose: str) -> dict[str, Any]:
    settings = frame.model_dump(mode="json", exclude_none=True, exclude={"file", "black_level_dn"})
    return {"description": f"{_in_words(frame)}: {purpose}", "frames": [settings | {"repeat": FRAMES}]}


def _in_words(frame: FrameEntry) -> str:
    exposure_gain = f"{frame.exposure_s:.3g} s at {frame.gain_db:g} dB"
    if frame.shutter == "closed":
        return f"dark frames (cap on) of {exposure_gain}"
    if frame.source_level == 0:
        return f"frames with the source off of {exposure_gain}"
    stop = f", f/{frame.f_number:.3g}" if frame.f_number else ""
    return f"{exposure_gain}{stop}, source level {frame.source_level:g}, pattern {frame.pattern}"


def write_plan(path: Path, result: ReconcileResult, design: Design) -> bool:
    """Write the captures of this set and the next one as a plan, so that its frames can be reconciled by themselves.

    Returns:
        Whether there was anything to plan; without a proposal no file is written.

    Raises:
        OutputError: If the file cannot be written.
    """
    proposed = [effect.next_capture for effect in result.effects if effect.next_capture]
    proposed += [result.next_capture] if result.next_capture else []
    if not proposed:
        return False
    new = [dict(frame) for capture in proposed for frame in capture["frames"]]
    reasons = [str(capture["description"]) for capture in proposed]
    write_yaml_atomic(path, {"format": FORMAT, "reasons": reasons, "frames": [*_taken(design), *new]})
    return True


def _taken(design: Design) -> list[dict[str, Any]]:
    planned = ("exposure_s", "gain_db", "f_number", "source_level", "pattern", "shutter")
    found = []
    for capture in design.captures:
        settings = {name: getattr(capture.settings, name) for name in planned}
        found.append({k: v for k, v in settings.items() if v is not None} | {"repeat": len(capture.frames)})
    return found

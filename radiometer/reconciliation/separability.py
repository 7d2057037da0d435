"""Finds the entries that a plan cannot separate, the size at which each would show, and the capture that would show it.

Separability uses the settings of the captures, not their measured statistics. An entry changes the expected statistics
in some direction; others change them in the directions of their starts and of their parameters there. What follows the
first for the most part, nuisances and all other effects moving too, is fitted to its noiseless statistics. What is left
of them is what these captures would show of the difference, in units of χ². Where that is less than rivals may differ
by, the two names stand together, whichever of them the data were fitted with.

A size is looked for where an entry stands out by so much: few grow in proportion. A limit of what pixels hold, a step
of codes or a rounded print does not grow from nothing at all; of these the mildest form counts that stands out.

The capture that separates rivals is chosen from a pool of settings. Each rival is fitted to the data as they are; under
the best setting most of them would then predict something else.

Source: local identifiability by the Fisher information, T. J. Rothenberg, Econometrica 39 (1971) 577, over starts that
span the range of an entry; discrimination among mechanistic models, Box & Hill (1967), in the form of Buzzi-Ferraris &
Forzatti (1983).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import FrameEntry, FrameSettings
from radiometer.data.storage import write_yaml_atomic
from radiometer.reconciliation.comparison import Comparison
from radiometer.reconciliation.descent import Candidate, fit_candidate, refit, refit_with
from radiometer.reconciliation.design import BRIGHT_SURROUND, DARK_SURROUND, Design
from radiometer.reconciliation.reduce import PatternImages
from radiometer.reconciliation.result import Limit, ReconcileResult
from radiometer.reconciliation.screening import AT_ONCE, best_start, changes_with, directions_of_each
from radiometer.reconciliation.state import FitState, ModelFit, with_effects, with_terms
from radiometer.reconciliation.statistics import Prediction, partly_at_the_top
from radiometer.reconciliation.thresholds import PARAMETER_NATS, RIVAL_NATS
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
_PATCH_REACH: Final = 2.0  # … within twice its half-width


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
    return np.asarray((closest <= 1.0) | (alike & (closest < _PATCH_REACH)))


FORMAT: Final = "radiometer-plan/1"
_DISTINGUISHED_CHI2: Final = 30.0  # a pair that differs by more is distinguished; more has no further value
_HELPS_CHI2: Final = 4.0  # by so much a capture still helps where none does more
_REFITS: Final = 4
_WELL_BELOW: Final = 0.5
_TRIED: Final = 4  # of an entry, of which the likeliest is fitted
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
                best = best_start(nothing, kind.starts(state.model.context)[:_TRIED])
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


# ---- the next capture ----------------------------------------------------------------------------------------------
SHOWN: Final = 5.0**2  # χ² of what stands out: five sigma
_BLIND: Final = 1e-6  # share of a change that must survive the nuisances
_LOOKS: Final = 12
_STRIDE: Final = 30.0  # largest factor from one look to the next
_CLOSE: Final = 0.1  # of ln χ²
_NOTHING: Final = 1e-6  # a χ² that counts as none


@dataclass(frozen=True, slots=True)
class Asked:
    """The detection that is asked for."""

    chi2: float  # χ² by which an effect is to stand out, all nuisances and other effects following
    largest_factor: float  # times the size of its start, beyond which it would be absurd


def mildest(state: FitState, starts: Sequence[CatalogueEffect], asked: Asked) -> dict[str, Grown]:
    """Return the mildest form of each entry that stands out by so much, by name; none where no start has one.

    All starts take one look after the other side by side: what many change is projected at once.
    """
    found: dict[str, Grown] = {}
    looks = grown(state, starts, asked)
    searches = [_Search(abs(near.size), near) for near in looks if near.information > 0 and near.size]
    for _ in range(_LOOKS):
        for near in (search.near for search in searches if search.near.is_limit):
            found[near.effect.name] = near.milder(found.get(near.effect.name))
        going = [search.narrowed() for search in searches if search.near.grows and not search.near.is_limit]
        further = [(search, search.next_look()) for search in going if not search.is_beyond(found)]
        searched = [(search, effect) for search, effect in further if effect is not None]
        looks = grown(state, [effect for _, effect in searched], asked)
        searches = [replace(search, near=near) for (search, _), near in zip(searched, looks, strict=True)]
    return found


def grown(state: FitState, effects: Sequence[CatalogueEffect], asked: Asked) -> list[Grown]:
    """Return effects as they are, with the χ² by which each alone stands out."""
    found = []
    for first in range(0, len(effects), AT_ONCE):
        batch = effects[first : first + AT_ONCE]
        for effect, information in zip(batch, _information(state, batch), strict=True):
            found.append(Grown(effect, *_main_parameter(type(effect), effect), information, asked))
    return found


@dataclass(frozen=True, eq=False)
class Grown:
    """An effect at one size, and the χ² by which it would stand out there."""

    effect: CatalogueEffect  # the effect
    parameter: str  # the parameter that is its size
    unit: str  # its unit
    information: float  # χ² that it would bring, all nuisances and other effects following
    asked: Asked  # the χ² that it is to bring

    @property
    def size(self) -> float:
        """Return the distance of the parameter from the value without effect."""
        return _amplitude(self.effect, self.parameter)

    @property
    def grows(self) -> bool:
        """Return whether it grows from nothing; if not, what counts is whether this very form would show."""
        return self.effect.grows and self.parameter in self.effect.values()

    @property
    def is_limit(self) -> bool:
        """Return whether it stands out by what is asked, or, where it does not grow, by as much at least."""
        if not self.grows:
            return self.information >= self.asked.chi2
        return bool(abs(np.log(max(self.information, _NOTHING) / self.asked.chi2)) < _CLOSE)

    def milder(self, other: Grown | None) -> Grown:
        """Return this or another limit, whichever is the milder effect."""
        if other is None:
            return self
        choose = max if self.effect.saturates else min
        return choose(other, self, key=lambda one: abs(one.size))

    def times(self, factor: float) -> CatalogueEffect | None:
        """Return the effect with its size times a factor; None beyond the parameter's bounds."""
        known = next(entry for entry in self.effect.parameters() if entry.name == self.parameter)
        values, neutral = self.effect.values()[self.parameter], self.effect.neutral(self.parameter)
        table = isinstance(values, tuple)
        old = np.atleast_1d(np.asarray(values, dtype=np.float64))
        new = neutral + factor * (old - neutral)
        if not np.all((known.low <= new) & (new <= known.high)) or np.array_equal(old, new):
            return None
        grown = tuple(new.tolist()) if table else float(new[0])
        return self.effect.with_parameters(**{self.parameter: grown})


@dataclass(frozen=True, eq=False)
class _Search:
    first: float  # size of the start
    near: Grown  # the last look
    below: Grown | None = None  # the last look that did not show
    above: Grown | None = None  # the last one that did

    def narrowed(self) -> _Search:
        shows = self.near.information > self.near.asked.chi2
        return replace(self, above=self.near) if shows else replace(self, below=self.near)

    def is_beyond(self, found: Mapping[str, Grown]) -> bool:
        """Return whether a milder form of the entry is known to show already than this one, which does not."""
        least = found.get(self.near.effect.name)
        return least is not None and self.below is not None and abs(self.below.size) >= abs(least.size)

    def next_look(self) -> CatalogueEffect | None:
        size, asked = _next_size(self.below, self.above), self.near.asked
        if not self.near.size or abs(size) > asked.largest_factor * self.first:  # it shows without any size, or never
            return None
        return self.near.times(size / self.near.size)


def _next_size(below: Grown | None, above: Grown | None) -> float:
    if below is None or above is None:
        known = below or above
        assert known is not None
        power = 0.25 if known.effect.acts_by_square else 0.5
        factor = (known.asked.chi2 / max(known.information, _NOTHING)) ** power
        return known.size * float(np.clip(factor * (0.9 if below is None else 1.1), 1.0 / _STRIDE, _STRIDE))
    low, high = (np.log(max(look.information, _NOTHING) / look.asked.chi2) for look in (below, above))
    share = float(np.clip(-low / (high - low), 0.1, 0.9))
    return float(below.size * (above.size / below.size) ** share)


def _information(state: FitState, effects: Sequence[CatalogueEffect]) -> list[float]:
    several = [(*state.effects, effect) for effect in effects]
    changes, part = state.fit.followed_with_half(np.nan_to_num(changes_with(state, several)))
    whole = np.einsum("ij,ij->j", changes, changes)
    left = whole - np.einsum("ij,ij->j", part, part)
    return [float(value) for value in np.where(left > np.maximum(_BLIND * whole, 0.0), left, 0.0)]


def _main_parameter(kind: type[CatalogueEffect], start: CatalogueEffect | None) -> tuple[str, str]:
    """Return the parameter that is an entry's size, and its unit."""
    names = start.free() if start is not None else kind.fitted
    known = {entry.name: entry.unit for entry in kind.parameters()}
    name = names[0].split("[")[0] if names else kind.profiled or next(iter(known), "share")
    return name, known.get(name, "1")


def _amplitude(effect: CatalogueEffect, name: str) -> float:
    if name not in effect.values():
        return 1.0
    values = np.atleast_1d(np.asarray(effect.values()[name], dtype=np.float64)) - effect.neutral(name)
    return float(values[np.argmax(np.abs(values))])


_LARGEST_TIMES: Final = 50.0  # times the typical size, beyond which the effect would be absurd
_ASKED_OF_LIMITS: Final = Asked(SHOWN, _LARGEST_TIMES)
_ABSOLUTE_LIGHT: Final = "W m-2"  # has no scale where no radiance is known: the responsivity takes any


def limits(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> dict[str, Limit]:
    """Return the amplitude of every entry that these data would have shown at five sigma, by name."""
    found = {name: Limit(None, *_main_parameter(kind, None)) for name, kind in sorted(catalogue.items())}
    asked = {name: kind for name, kind in catalogue.items() if _can_show(state, kind, found[name].unit)}
    present = {effect.name for effect in state.effects if effect.name in asked}
    starts = [_spread(kind.starts(state.model.context)) for name, kind in asked.items() if name not in present]
    found |= _mildest(state, [start for several in starts for start in several])
    for name in sorted(present):  # what is named already: how small could it have been?
        others = with_effects(state, [effect for effect in state.effects if effect.name != name])
        named = _mildest(others, [effect for effect in state.effects if effect.name == name])
        # Further terms that stay while the size shrinks may show at any size: then the plain form decides.
        found |= named or _mildest(others, _spread(asked[name].starts(state.model.context)))
    return found


def _can_show(state: FitState, kind: type[CatalogueEffect], unit: str) -> bool:
    if kind.saturates == "sharply" and partly_at_the_top(state.design, state.seen, state.prediction).any():
        return False  # exactly the tiles that would show it are left out, wherever it is
    return kind.usable(state.model.context) and (unit != _ABSOLUTE_LIGHT or state.design.has_known_radiance)


def _mildest(state: FitState, starts: Sequence[CatalogueEffect]) -> dict[str, Limit]:
    return {
        name: Limit(
            abs(near.size) if near.grows else near.size, near.parameter, near.unit,
            near.effect.values()["reference_C"] if near.effect.heated else None,
        )
        for name, near in mildest(state, starts, _ASKED_OF_LIMITS).items()
    }  # fmt: skip


_STARTS: Final = 6  # of an entry, spread over all that it has
_LARGEST_FACTOR: Final = 1000.0  # times the size of its start, beyond which an entry would be absurd
# The size at which a plan is asked about an entry: twenty sigma, whatever is usual; five where it comes no farther.
_ASKED: Final = (Asked(20.0**2, _LARGEST_FACTOR), Asked(SHOWN, _LARGEST_FACTOR))
_REACH: Final = 2.0  # scales by which a parameter may leave its start: beyond, its derivative there is another effect
_WORTH_A_FIT: Final = 0.5  # share of another's χ² that an entry must follow at its start to be fitted in its place
_FITTED: Final = 3  # forms of an entry that a fit begins from
_SAME: Final = 0.1  # χ² by which fits that came to the same differ at most
_DIRECTION: Final = 1e-6  # share of a column that the others of its entry must leave


@dataclass(frozen=True, slots=True, eq=False)
class _Form:
    """One start of an entry, and where its columns stand: what it changes, and what its parameters do there.

    The first column of an effect that grows from nothing may be taken at any size. A limit or a step is there as it
    is or not at all, and its first parameter moves it as the others do.
    """

    effect: CatalogueEffect
    columns: slice


@dataclass(frozen=True, eq=False)
class Directions:
    """Changes that entries make in the statistics of a plan, freed of its nuisances."""

    state: FitState  # the model that they are added to
    forms: Mapping[str, tuple[_Form, ...]]  # starts of each entry by name
    products: Array  # inner products of all columns, freed of what nuisances and other effects explain

    @classmethod
    def of(cls, state: FitState, entries: Mapping[str, Sequence[CatalogueEffect]]) -> Directions:
        """Return the directions of the starts of entries."""
        columns, forms, at = list[Array](), dict[str, tuple[_Form, ...]](), 0
        every = _columns(state, [start for starts in entries.values() for start in starts])
        for name, starts in entries.items():
            found = []
            for start, own in zip(starts, every, strict=False):
                if own[:, 0].any():  # what no camera does is no likeness
                    columns.append(own)
                    found.append(_Form(start, slice(at, at + own.shape[1])))
                    at += own.shape[1]
            forms[name] = tuple(found)
        if not columns:
            return cls(state, forms, np.zeros((0, 0)))
        moved, part = state.fit.followed_with_half(np.hstack(columns))
        products = np.asarray(moved.T @ moved - part.T @ part)
        return cls(state, forms, products)

    def shown(self, form: _Form) -> float:
        """Return the χ² by which a start shows."""
        return float(max(self.products[form.columns.start, form.columns.start], 0.0))

    def left(self, target: _Form, other: _Form) -> tuple[float, float]:
        """Return the χ² of a start that another entry, about one of its starts, does not follow, and the share of
        it."""
        whole = self.shown(target)
        left, taken = self._least(target, other)
        if taken[0] <= 0 or np.max(np.abs(taken[1:]), initial=0.0) > _REACH * taken[0]:  # another form than it can take
            alone = replace(other, columns=slice(other.columns.start, other.columns.start + 1))
            left, taken = self._least(target, alone)
        return (left, float(taken[0])) if taken[0] > 0 else (whole, 0.0)

    def _least(self, target: _Form, other: _Form) -> tuple[float, Array]:
        """Return the χ² of a start that columns of another do not follow at best, and how much of each they take."""
        own, first, at = other.columns, other.columns.start, target.columns.start
        right, whole = self.products[own, at], self.shown(target)
        if other.effect.grows:
            return _followed(self.products[own, own], right, whole)
        beyond = max(whole - 2.0 * float(self.products[first, at]) + float(self.products[first, first]), 0.0)
        moved = (right - self.products[own, first])[1:]
        left, taken = _followed(self.products[own, own][1:, 1:], moved, beyond)
        return left, np.concatenate([[1.0], taken])

    def near(self, target: _Form, name: str) -> tuple[CatalogueEffect, ...]:
        """Return the forms of an entry that follow another's start for the most part, at their size, the best first."""
        rated = [(*self.left(target, form), form) for form in self.forms[name]]
        follow = [entry for entry in rated if entry[0] < (1.0 - _WORTH_A_FIT) * self.shown(target)]
        sized = (_times(form.effect, amount) for _, amount, form in sorted(follow, key=lambda entry: entry[0]))
        return tuple(dict.fromkeys(sized))


def _followed(gram: Array, right: Array, whole: float) -> tuple[float, Array]:
    """Return what columns leave of a χ² at best, and how much of each they take."""
    lengths = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(lengths, lengths))
    kept = values > _DIRECTION
    along = (vectors[:, kept].T @ (right / lengths)) / np.sqrt(values[kept])
    taken = (vectors[:, kept] @ (along / np.sqrt(values[kept]))) / lengths
    return max(whole - float(along @ along), 0.0), np.asarray(taken)


def _paid(target: CatalogueEffect, other: CatalogueEffect) -> float:
    """Return the χ² that an entry must pay for having more parameters, and for being rarer: as in the posterior."""
    further = PARAMETER_NATS * max(len(other.free()) - len(target.free()), 0)
    return 2.0 * (further + target.log_prior_odds - other.log_prior_odds)


def _times(effect: CatalogueEffect, amount: float) -> CatalogueEffect:
    """Return an effect with its first parameter times an amount, within its bounds; a limit or a step as it is."""
    names = effect.free()
    if not effect.grows or not names or "[" in names[0]:
        return effect
    power = 0.5 if effect.acts_by_square else 1.0
    return effect.resized(amount**power, about=effect.neutral(names[0]))


def _columns(state: FitState, starts: Sequence[CatalogueEffect]) -> Iterator[Array]:
    place = len(state.effects)
    for first in range(0, len(starts), AT_ONCE):
        batch = starts[first : first + AT_ONCE]
        entries = [((*state.effects, start), place, 1 if start.grows else 0) for start in batch]
        yield from directions_of_each(state, entries)


def inseparable(
    state: FitState, chosen: CatalogueEffect, catalogue: Mapping[str, type[CatalogueEffect]]
) -> tuple[CatalogueEffect, ...]:
    """Return entries, at a start of theirs, that these captures cannot separate from a named effect of its fitted size.

    Args:
        catalogue: All entries; also those whose covariate does not vary, for that very reason.
    """
    rest = with_effects(state, [effect for effect in state.effects if effect is not chosen])
    present = {effect.name for effect in (*state.effects, *state.model.given)}
    shows = {chosen.block, *chosen.also}
    kinds = {n: kind for n, kind in catalogue.items() if n not in present and shows & {kind.block, *kind.also}}
    starts = {name: _spread(kind.starts(state.model.context)) for name, kind in kinds.items()}
    directions = Directions.of(rest, starts | {chosen.name: (chosen,)})
    if not directions.forms[chosen.name]:
        return ()
    (target,) = directions.forms[chosen.name]
    alike = ConfusablePair(directions, target)
    found = [pair for name in kinds if (pair := alike.fitted(name)) is not None]
    for other, left in found:  # its model, with the other in the place of the chosen
        effects = tuple(other if effect is chosen else effect for effect in state.effects)
        density = state.log_density - left / 2.0 / state.log_density.size
        size = state.parameters_of(effects).size + state.curves
        state.models.append(ModelFit(effects, state.curves, density, size))
    return tuple(effect for effect, _ in found)


@dataclass(frozen=True, eq=False)
class Noiseless(Comparison):
    """A comparison whose measured statistics are those that a model expects."""

    offset: Array = field(default_factory=lambda: np.zeros(0))  # residual of the real data under that model

    def residual(self, prediction: Prediction) -> Array:
        """Return expected minus predicted, whitened, (entries,) or (entries, models)."""
        found = super().residual(prediction)
        return found - self.offset.reshape(-1, *(1,) * (found.ndim - 1))


def noiseless(state: FitState, effect: CatalogueEffect) -> FitState:
    """Return a state with the data replaced by what its model with a further effect expects."""
    known = {entry.name: getattr(state.comparison, entry.name) for entry in fields(state.comparison)}
    offset = state.comparison.residual(state.predicted_with((*state.effects, effect)))
    return replace(state, comparison=Noiseless(**known | {"offset": offset}), models=[])


def left_by_fit(exact: FitState, truth: CatalogueEffect, start: Candidate) -> tuple[float, CatalogueEffect]:
    """Return the χ² that an entry leaves of noiseless data when it is fitted to them, and the entry as fitted.

    Args:
        exact: The state with the noiseless data of another entry.
        truth: That other entry; parameters beyond its number are paid for.
        start: Where the fit begins.
    """
    fitted = fit_candidate(exact, start).effect
    return _left(exact, fitted, _refitted_cost(exact, truth)) + _paid(truth, fitted), fitted


def _left(exact: FitState, fitted: CatalogueEffect, least: float) -> float:
    return max(_refitted_cost(exact, fitted) - least, 0.0)


def _refitted_cost(exact: FitState, effect: CatalogueEffect) -> float:
    return refit(with_effects(exact, (*exact.effects, effect))).cost


@dataclass(eq=False)
class ConfusablePair:
    """Fits entries to the noiseless data of another entry's start.

    Derivatives show where one entry may imitate the other. They do not reach far enough to prove it: a change
    that is a small difference of large ones, or bends, is no such sum. Only what follows for the most part is fitted.
    """

    directions: Directions  # of the starts of all entries
    target: _Form  # the other's start

    @cached_property
    def _exact(self) -> FitState:
        return noiseless(self.directions.state, self.target.effect)

    @cached_property
    def _least(self) -> float:
        """Return the χ² that the other itself leaves: of priors, for the data are its own."""
        return _refitted_cost(self._exact, self.target.effect)

    def fitted(self, name: str) -> tuple[CatalogueEffect, float] | None:
        """Return an entry that fits the noiseless data, and the χ² that it leaves; None where they are separable."""
        gains = list[float]()
        for near in self.directions.near(self.target, name)[:_FITTED]:  # a limit that hardly acts shows no way on
            start = Candidate(near, self.directions.shown(self.target), max(len(near.free()), 1))
            found = fit_candidate(self._exact, start)
            if any(abs(found.gain - known) < _SAME for known in gains):
                continue  # it came to where another form had come to
            gains.append(found.gain)
            left, paid = _left(self._exact, found.effect, self._least), _paid(self.target.effect, found.effect)
            if left + paid < 2.0 * RIVAL_NATS:
                return found.effect, left
        return None


def _spread(starts: Sequence[CatalogueEffect]) -> tuple[CatalogueEffect, ...]:
    return tuple(starts[:: max(1, -(-len(starts) // _STARTS))])


@dataclass(frozen=True, slots=True)
class Together:
    """Names that a plan cannot separate."""

    name: str  # an entry
    others: tuple[str, ...]  # entries that could show the same
    capture: Mapping[str, Any] | None  # the capture that would separate them; None where none of the rig's would

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping of the JSON form."""
        return {"name": self.name, "others": list(self.others), "next_capture": self.capture and dict(self.capture)}


@dataclass(frozen=True, slots=True)
class Separability:
    """The entries that a plan can and cannot separate."""

    together: tuple[Together, ...]  # names that stand together, each set once
    blind: tuple[str, ...]  # entries that do not show at any sensible size, nuisances following

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping of the JSON form."""
        return {"inseparable": [entry.to_mapping() for entry in self.together], "blind": list(self.blind)}


def separability(
    state: FitState, catalogue: Mapping[str, type[CatalogueEffect]], *, every: bool = False
) -> Separability:
    """Return which entries these captures can separate, each at a size of twenty sigma.

    Args:
        state: The starting camera, nuisances fitted; the data's disagreements have no part in it.
        every: List a set once for each of its names, without captures, instead of once in all.
    """
    seen = asked_sizes(state, catalogue)
    blind = tuple(sorted(set(catalogue) - set(seen)))
    return Separability(tuple(_together(state, seen, every=every)), blind)


def asked_sizes(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> dict[str, CatalogueEffect]:
    """Return the entries that show, by name, at the size at which a plan is asked about them.

    That is the first of their starts, the likeliest first, that stands out by twenty sigma where it has that size; of
    what does so nowhere the first that stands out by five.
    """
    starts = {name: _spread(kind.starts(state.model.context)) for name, kind in catalogue.items()}
    found: dict[str, CatalogueEffect] = {}
    for asked, turn in itertools.product(_ASKED, range(max(map(len, starts.values()), default=0))):
        left = [several[turn] for name, several in starts.items() if name not in found and turn < len(several)]
        found |= {name: near.effect for name, near in mildest(state, left, asked).items()}
    return {name: found[name] for name in catalogue if name in found}


def _together(state: FitState, seen: Mapping[str, CatalogueEffect], *, every: bool) -> Iterator[Together]:
    reported, context = set[frozenset[str]](), state.model.context
    directions = Directions.of(state, {n: (own, *_spread(type(own).starts(context))) for n, own in seen.items()})
    for name in seen:
        alike = ConfusablePair(directions, directions.forms[name][0])
        others = [pair[0] for other in seen if other != name and (pair := alike.fitted(other)) is not None]
        names = frozenset({name, *(effect.name for effect in others)})
        if others and (every or names not in reported):
            reported.add(names)
            capture = None if every else propose(state, alike.target.effect, others)
            yield Together(name, tuple(effect.name for effect in others), capture)

"""Reconciles a capture set with the forward model: from frames to a verdict.

Frames are read a second time where what they show changes how they are to be read.
"""

from __future__ import annotations

import itertools
import math
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import structlog

from radiometer.data import CaptureHeader
from radiometer.data.pile_up import white_levels_of
from radiometer.data.white_level import EDGE_SIGMAS, WhiteLevel, white_level_notes
from radiometer.errors import CaptureError
from radiometer.importing import open_capture
from radiometer.numbers import lower_limit
from radiometer.one_thread import on_one_blas_thread
from radiometer.reconciliation.descent import first_state, fitted_parameters, is_misfit, scatter_of
from radiometer.reconciliation.design import CaptureStatistics, Design
from radiometer.reconciliation.localise import Disagreement, axis_of, global_p_value, places
from radiometer.reconciliation.nuisances import dark_current_is_free
from radiometer.reconciliation.propose.search import held_to_laws
from radiometer.reconciliation.reduce import FrameReader, PatternImages, Progress, reduce_frames, with_even_tiles
from radiometer.reconciliation.repeatability import (
    FrameLight,
    Periodic,
    black_by_noise,
    drift_of_black,
    periodic,
    repeats_of,
    scenes_of,
    steadied,
    wander_of_black,
)
from radiometer.reconciliation.result import (
    CovariateGap,
    FittedParameter,
    FoundEffect,
    LawCurve,
    Limit,
    Place,
    ReconcileResult,
    Repeats,
    Series,
    Verdict,
)
from radiometer.reconciliation.search import Reconciled, Search, search
from radiometer.reconciliation.separability import (
    Separability,
    inseparable,
    limits,
    propose,
    propose_for_blind,
    propose_for_unnamed,
    separability,
)
from radiometer.reconciliation.state import FitState, with_effects
from radiometer.reconciliation.verdict import (
    UNNAMED,
    Posterior,
    doubts_of,
    insignificant_names,
    posterior,
    rest_of,
    size_of_rest,
    sizes_by_own_law,
    verdict_of,
    with_other_functional_form,
)
from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array
from simulators.chain.camera_model import CameraModel
from simulators.chain.ideal_chain import next_to_ideal
from simulators.effects.base import Stage
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.free_law import FreeLaw
from simulators.effects.registry import all_effects
from simulators.effects.tile_moments import TileMoments

_STANDS_OUT: Final = 8.0  # times what neighbouring frames differ by otherwise
_STAYS: Final = 4.0  # the same of the frames behind the jump: a lone frame that differs is no jump
_NEXT_TO: Final = 3  # frames on either side that show whether it stays
_MOST_JUMPS: Final = 8  # of one series, the largest first


def jumps(design: Design, tiles_of: Callable[[tuple[int, ...]], Array]) -> tuple[int, ...]:
    """Return the positions in the header of the frames that are the first behind a jump.

    Args:
        design: Captures; those that follow each other in one setting are a series.
        tiles_of: Gives the mean of each tile in frames at positions of the header, (frames, tiles) in DN.
    """
    return tuple(sorted(frame for frames in _series(design) for frame in _of_series(frames, tiles_of(frames))))


def _series(design: Design) -> Iterator[tuple[int, ...]]:
    numbers = range(len(design.captures))
    for _, same in itertools.groupby(numbers, key=lambda number: design.setting_id[number]):
        captures = [design.captures[number].frames for number in same]
        frames = tuple(itertools.chain.from_iterable(captures))
        if len(captures) > 1 and frames == tuple(range(frames[0], frames[0] + len(frames))):
            yield frames


def _of_series(frames: tuple[int, ...], means: Array) -> list[int]:
    level = np.median(means - means.mean(axis=0), axis=1)
    steps = np.diff(level)
    usual = robust_sigma(steps)
    found = []
    for at in np.argsort(-np.abs(steps), kind="stable")[:_MOST_JUMPS].tolist():
        behind, before = level[at + 1 : at + 1 + _NEXT_TO], level[max(at + 1 - _NEXT_TO, 0) : at + 1]
        stays = abs(float(np.median(behind) - np.median(before)))
        if abs(float(steps[at])) > _STANDS_OUT * usual and stays > _STAYS * usual:
            found.append(frames[at + 1])
    return found


Shown = tuple[Design, FrameLight, tuple[CaptureStatistics, PatternImages]]


def evidence_for(
    header: CaptureHeader, shape: tuple[int, int], read: FrameReader, progress: Progress | None = None
) -> Shown:
    """Return the design of a capture set, the light of its frames, and what they show.

    A series of equal frames may jump, one setting alone may not determine an undeclared black level, or the scene may
    change. The design then follows what was seen, and the frames are read again. Each scene is a separate pattern
    then.

    Raises:
        CaptureError: If a scene is shown by one frame alone, which cannot be compared with any other.
    """
    design, light, shown = _read_by(with_even_tiles(Design.of(header, shape), read), read, progress)
    at, black_dn = jumps(design, light.of_tiles), black_by_noise(design, shown[0])
    apart = _by_scene(header, light)
    if not at and black_dn is None and apart is None:
        return design, light, shown
    header = apart or header
    if black_dn is not None:
        camera = header.camera.model_copy(update={"black_level_dn": black_dn})
        header = header.model_copy(update={"camera": camera})
    return _read_by(with_even_tiles(Design.of(header, shape, at), read), read, progress)


def _by_scene(header: CaptureHeader, light: FrameLight) -> CaptureHeader | None:
    names: dict[int, str] = {}
    for pattern in dict.fromkeys(header.frames[index].pattern for index in light.structures):
        own = {index: seen for index, seen in light.structures.items() if header.frames[index].pattern == pattern}
        scenes = scenes_of(own)
        times = Counter(scenes.values())
        lone = [header.frames[index].file for index, scene in scenes.items() if times[scene] == 1]
        if lone and len(times) > 1:
            raise CaptureError(
                f"the frames show {len(times)} scenes, and no other frame shows that of {', nor that of '.join(lone)}: "
                "it cannot be compared with any; give two frames or more of each scene, or those of one scene only"
            )
        names |= {index: f"{pattern}, scene {scene + 1}" for index, scene in scenes.items() if scene}
    if not names:
        return None
    frames = [
        frame.model_copy(update={"pattern": names.get(index, frame.pattern)})
        for index, frame in enumerate(header.frames)
    ]
    patterns = tuple(dict.fromkeys((*header.patterns, *names.values())))
    return header.model_copy(update={"frames": tuple(frames), "patterns": patterns})


def _read_by(design: Design, read: FrameReader, progress: Progress | None) -> Shown:
    light = FrameLight(design, read)
    return design, light, reduce_frames(design, light, progress)


# ---- the full well --------------------------------------------------------------------------------------------------
# Saturated pixels gather at one digital number. The model predicts the number for the declared full well. Where pixels
# gather lower, or go higher, another full well is shown. Where the converter ends first, nothing is tested.

# Datasheets state the saturation capacity of EMVA 1288, at the peak of the variance: up to a tenth below the pile.
_AS_DECLARED: Final = 0.1
_GAINS_LOOKED_AT: Final = 2  # the lowest: a full well needs most light there, and two separate it from a converter
_SIGMAS: Final = 4.0


@dataclass(frozen=True, slots=True)
class ShownWell:
    """The full well that the brightest pixels show."""

    declared_e: float  # as the camera's description states it, in electrons
    # Electrons at which pixels gather; where they gather nowhere below the converter's end, the most that many pixels
    # hold
    shown_e: float
    u_e: float  # standard uncertainty of that
    is_least: bool  # whether pixels gather nowhere, so that the full well is at least `shown_e`
    may_be_converter: bool  # whether one gain alone shows the pile: a converter may end there

    @property
    def least_e(self) -> float:
        """Return the electrons that pixels hold at least, with a probability of 95 %."""
        return lower_limit(self.shown_e, self.u_e)

    @property
    def contradicts(self) -> bool:
        """Return whether the declared full well is wrong."""
        off = self.shown_e - self.declared_e
        size = off if self.is_least else abs(off)
        return size > max(_AS_DECLARED * self.declared_e, _SIGMAS * self.u_e)

    @property
    def remark(self) -> str:
        """Return what a user must know of the full well; nothing where pixels gather where it is declared."""
        if self.contradicts:
            shown = f"at least {self.least_e:.4g} (95 %)" if self.is_least else f"{self.shown_e:.4g} ± {self.u_e:.2g}"
            return f"full well: stated {self.declared_e:.4g} e-, the brightest pixels show {shown} e-"
        if self.is_least and self.shown_e < (1.0 - _AS_DECLARED) * self.declared_e:
            return (
                f"the full well is not tested: pixels show at most {self.shown_e:.4g} e- of the {self.declared_e:.4g} "
                "e- that are declared"
            )
        return ""

    def as_effect(self, gap: float) -> FoundEffect:
        """Return the finding that the full well is another one, at a gap that it leaves as it is."""
        sigmas = (self.shown_e - self.declared_e) / self.u_e
        size = (
            FittedParameter(self.least_e, None, "e-")
            if self.is_least
            else FittedParameter(self.shown_e, self.u_e, "e-")
        )
        well = limit_at(Stage.WELL)
        rivals = (limit_at(Stage.DIGITAL).name,) if self.may_be_converter else ()
        (name,) = well.fitted
        return FoundEffect(well.name, {name: size}, well.where, gap, gap, rivals, None, 0.5 * sigmas**2, well.block)


def limit_at(stage: Stage) -> type[CatalogueEffect]:
    """Return the entry of the catalogue that limits the signal sharply at a stage."""
    kinds = (kind for kind in all_effects().values() if issubclass(kind, CatalogueEffect))
    return next(kind for kind in kinds if kind.saturates == "sharply" and kind.stage is stage)


def levels_of_brightest(header: CaptureHeader, read: FrameReader) -> dict[float, WhiteLevel]:
    """Return where the frames of the lowest gains show that pixels saturate, by gain in dB."""
    settings = [entry.settings for entry in header.frames]
    gains = sorted({one.gain_db for one in settings if not one.is_dark})[:_GAINS_LOOKED_AT]
    places = [place for place, one in enumerate(settings) if one.gain_db in gains and not one.is_dark]
    chosen, parts = [settings[place] for place in places], header.camera.tap_parts
    return white_levels_of(chosen, lambda number: read(places[number]), parts)


def shown_well(state: FitState, levels: Mapping[float, WhiteLevel]) -> ShownWell | None:
    """Return the full well that the brightest pixels show; None where none is declared or the fit has found another.

    Args:
        levels: Where pixels saturate, by gain in dB.
    """
    camera = state.design.header.camera
    limits = [effect for effect in (*state.model.given, *state.effects) if effect.saturates]
    if camera.full_well_e is None or camera.conversion_gain_e_per_dn is None or limits or not levels:
        return None
    full_dn = camera.saturated_dn
    piles, reached = list[tuple[float, float, float]](), list[float]()
    for gain_db, level in levels.items():
        black_dn, end_dn = _range_dn(state, gain_db, camera.full_well_e)
        e_per_dn = camera.full_well_e / (end_dn - black_dn)
        if level.reached_dn is not None:
            reached.append((level.reached_dn - black_dn) * e_per_dn)
        if level.measured_dn is not None and level.measured_dn + EDGE_SIGMAS * level.spread_dn + 1.0 < full_dn:
            u_dn = math.hypot(level.spread_dn / math.sqrt(max(level.piled_pixels, 1)), 1.0 / math.sqrt(12.0))
            piles.append(((level.measured_dn - black_dn) * e_per_dn, u_dn * e_per_dn, level.measured_dn))
    if not reached:
        return None
    most_e, relative_u = max(reached), _relative_u_of_gain(state)
    whole = [pile for pile in piles if pile[0] > (1.0 - _AS_DECLARED) * most_e]
    if whole and not _is_converter(piles):
        shown_e, u_e, _ = max(whole)
        return ShownWell(camera.full_well_e, shown_e, math.hypot(u_e, relative_u * shown_e), False, len(piles) == 1)
    u_e = math.hypot(math.sqrt(max(most_e, 1.0)), relative_u * most_e)
    return ShownWell(camera.full_well_e, most_e, u_e, True, False)


def _is_converter(piles: Sequence[tuple[float, float, float]]) -> bool:
    """Return whether pixels gather at one digital number whatever the gain: a converter's end, no full well."""
    at_dn = [dn for _, _, dn in piles]
    at_e = [electrons for electrons, _, _ in piles]
    return len(piles) > 1 and max(at_dn) / min(at_dn) < max(at_e) / min(at_e)


def _range_dn(state: FitState, gain_db: float, well_e: float) -> tuple[float, float]:
    lit = (state.design.gain_db == gain_db) & ~state.design.closed
    trace, model = state.trace, state.model
    shape = (len(state.design.captures), len(state.design.tiles), 1)
    found = []
    for electrons in (0.0, well_e):
        moments = TileMoments.exactly(np.full(shape, electrons))
        for step in trace.chain:
            if step.stage > Stage.WELL:
                moments = model.through(step, moments)
        level = np.broadcast_to(moments.mean, np.broadcast_shapes(shape, np.shape(moments.mean)))[lit]
        found.append(float(np.median(level)))
    return found[0], found[1]


def _relative_u_of_gain(state: FitState) -> float:
    """Return the relative standard uncertainty of the conversion gain where it was fitted; declared, it has none."""
    effect = next((effect for effect in state.effects if effect.responsivity_taken() != 1.0), None)
    if effect is None:
        return 0.0
    known = fitted_parameters(state)[effect.name][effect.fitted[0]].u
    return (known or 0.0) / effect.responsivity_taken()


# ---- the verdict ----------------------------------------------------------------------------------------------------
_log = structlog.get_logger(__name__)

_T = TypeVar("_T")
_PLACES: Final = 6
_CALL: Final = 0.01
_CLEAR: Final = 1e-3  # share of samples that may clip in a tile whose light is compared from frame to frame

Say = Callable[[str], None]


def whole_catalogue() -> dict[str, type[CatalogueEffect]]:
    """Return all entries that reconcile tries, by name; those of installed packages and files that were read too.

    Raises:
        ConfigurationError: If an installed package's effect cannot be loaded.
    """
    return {name: kind for name, kind in all_effects().items() if issubclass(kind, CatalogueEffect)}


def _adopted(header: CaptureHeader, model: CameraModel | None) -> tuple[CaptureHeader, tuple[CatalogueEffect, ...]]:
    """Return the header with a model's camera and lens, and the effects that it adds to the ideal chain."""
    if model is None:
        return header, ()
    camera, further = next_to_ideal(model.effects, model.camera, model.lens)
    changed = header.model_copy(update={"camera": camera, "lens": model.lens})
    return changed, tuple(effect for effect in further if isinstance(effect, CatalogueEffect))


def reconcile_capture(
    path: Path, model: CameraModel | None = None, *, catalogue: Mapping[str, type[CatalogueEffect]] | None = None
) -> Reconciled:
    """Return where a capture set on disk and its simulation disagree, and which effects are missing.

    One frame is in memory at a time.

    Args:
        path: A capture set's folder, or files that `radiometer.importing` reads as one (FITS, raw TIFF, EMVA 1288).

    Raises:
        CaptureError: If the capture set is unfinished or inconsistent.
    """
    captured = open_capture(path)
    shape = captured.read_frame(0).shape
    return examine(captured.header, captured.read_frame, shape, model, catalogue=catalogue)


@on_one_blas_thread
def plan_of(
    path: Path,
    model: CameraModel | None = None,
    *,
    catalogue: Mapping[str, type[CatalogueEffect]] | None = None,
    progress: Progress | None = None,
) -> Separability:
    """Return which entries the captures of a set can separate, whatever they showed.

    The nuisances alone (responsivity, radiances) are fitted to the frames.

    Args:
        path: A capture set's folder, or files that `radiometer.importing` reads as one (FITS, raw TIFF, EMVA 1288).

    Raises:
        CaptureError: If the capture set is unfinished or inconsistent.
    """
    captured = open_capture(path)
    header, given = _adopted(captured.header, model)
    shape = captured.read_frame(0).shape
    design, _, read = evidence_for(header, shape, captured.read_frame, progress)
    start = first_state(design, *read, given)
    return separability(start, whole_catalogue() if catalogue is None else catalogue)


@on_one_blas_thread
def examine(
    header: CaptureHeader,
    read: FrameReader,
    shape: tuple[int, int],
    model: CameraModel | None = None,
    *,
    catalogue: Mapping[str, type[CatalogueEffect]] | None = None,
    progress: Progress | None = None,
    with_limits: bool = True,
    say: Say = lambda line: None,
) -> Reconciled:
    """Return the result for frames that a reader gives by their position in the header.

    Raises:
        CaptureError: If no part of any frame is free of clipping, or frames differ in size.
    """
    begun = time.monotonic()
    header, given = _adopted(header, model)
    total = len(header.frames)
    design, light, (seen, images) = evidence_for(header, shape, read, progress)
    entries = whole_catalogue() if catalogue is None else catalogue
    clear = (seen.high < _CLEAR) & (seen.low < _CLEAR)
    known = any(kind.where == "frame" for kind in entries.values())  # an effect from outside, which may be just that
    again = None if known else periodic(design, light, seen.common_unit, clear)
    taken = None if again is None else partial(first_state, design, seen, images, given)
    if again is not None:  # a source known to differ by so much from frame to frame: no flicker is searched for then
        seen = steadied(design, light, seen, again)
        known_u = max(header.source.reproducibility_u_rel or 0.0, again.rms)
        source = header.source.model_copy(update={"reproducibility_u_rel": known_u})
        design = replace(design, header=header.model_copy(update={"source": source}))
    start = first_state(design, seen, images, given)
    if not start.comparison.usable["mean"].any():
        raise CaptureError(
            "no part of any frame is free of clipping: capture with shorter exposures and a black level above zero"
        )
    notes: list[str] = []
    taken_dn = design.header.camera.black_level_dn
    if taken_dn != header.camera.black_level_dn:
        why = "where the noise of the light extrapolates to zero" if taken_dn else "as the noise does not determine it"
        notes.append(
            f"the black level is not declared and one setting does not determine it: {taken_dn:.4g} DN is "
            f"assumed, {why}"
        )
    scenes = set(design.patterns).difference(frame.pattern for frame in header.frames)
    if scenes:
        notes.append(f"the scene changes: {1 + len(scenes)} scenes are shown, each with a separate pattern")
    found = search(start, entries, say)
    outcome = _optional_step("laws outside the catalogue", lambda: held_to_laws(found, entries, say), notes) or found
    levels = levels_of_brightest(header, read)
    well = shown_well(outcome.state, levels)
    if well is None and not any(effect.saturates for effect in (*given, *outcome.state.effects)):
        notes += white_level_notes(level for level in levels.values() if level.disagrees)
    result = _result(outcome, entries, again, total, begun, notes, well, with_limits=with_limits)
    return Reconciled(replace(result, repeats=_repeats(outcome.state, light, header)), outcome, taken)


def _repeats(state: FitState, light: FrameLight, header: CaptureHeader) -> tuple[Repeats, ...]:
    wander = (wander_of_black(state.design, state.seen), float(np.sqrt(state.comparison.wander2)))
    usable, first = state.comparison.usable["mean"], state.prediction.first
    found = repeats_of(state.design, light.of_tiles, usable, state.sensitivity, first, wander)

    def as_stated(one: Series) -> Series:  # the design has a stand-in for exposures of 0 s
        return replace(one, exposure_s=header.frames[one.frames[0]].exposure_s)

    return tuple(replace(part, series=tuple(map(as_stated, part.series))) for part in found)


def _result(
    outcome: Search,
    entries: Mapping[str, type[CatalogueEffect]],
    again: Periodic | None,
    frames: int,
    begun: float,
    failed: list[str],
    well: ShownWell | None,
    *,
    with_limits: bool,
) -> ReconcileResult:
    state, other_well = outcome.state, well is not None and well.contradicts
    found = _found(outcome, entries, again, failed)
    weighed, alternatives = (
        posterior(state.models, entries, scatter_of(state)),
        {effect.name: effect.alternatives for effect in found},
    )
    left_out = (f"{name} is counted as part of the residual" for name in insignificant_names(outcome))
    doubts = [*outcome.remarks, *doubts_of(outcome, weighed, alternatives), *left_out]
    verdict = verdict_of(outcome, doubts, again, other_well=other_well)
    effects = tuple(_believed(effect, weighed, verdict) for effect in found)
    if well is not None and other_well:
        effects = (*effects, well.as_effect(state.gap))
    shown: Mapping[str, Limit] = {}
    if with_limits:
        shown = _optional_step("the limits", lambda: limits(state, entries), failed) or {}
    settled = any(effect.next_capture for effect in effects) or verdict is Verdict.EFFECTS_FOUND
    unnamed = [(effect.where, effect.block) for effect in effects if effect.name == UNNAMED]

    def following() -> dict[str, Any] | None:
        return propose_for_unnamed(state, entries, unnamed) or propose_for_blind(state, entries, shown)

    further = None if settled else _optional_step("the next capture", following, failed)
    fitted = {effect.name: {key: entry.u for key, entry in effect.parameters.items()} for effect in effects}
    own = [one.remark(state.design.header.camera, fitted[one.name]) for one in state.effects if one.name in fitted]
    remarks = [remark for remark in (*own, well.remark if well is not None and other_well else "") if remark]
    last, before = _largest(outcome.tests), global_p_value(outcome.start, outcome.first_tests)
    return ReconcileResult(
        verdict=verdict,
        effects=effects,
        next_capture=further,
        gap_before=outcome.start.gap,
        gap_after=state.gap,
        limits=shown,
        covariates={
            name: CovariateGap(gap, last.get(name, 1.0)) for name, gap in _largest(outcome.first_tests).items()
        },
        tests=(len(outcome.tests), len(outcome.left)),
        repeatability=state.tau,
        assumptions=(*_assumptions(outcome, doubts, well), *failed),
        localisation=tuple(
            Place(test.family, axis_of(test.where, test.block), test.form, test.chi2, test.p_value)
            for test in places(outcome.start, _PLACES)
        ),
        global_p=(before, before if state is outcome.start else global_p_value(state, outcome.tests)),
        calls=(sum(test.p_value < _CALL for test in outcome.first_tests), len(outcome.first_tests)),
        added=(*state.model.given, *state.effects),
        captures=len(state.design.captures),
        frames=frames,
        seconds=time.monotonic() - begun,
        models=weighed.listed(),
        extra={"remarks": remarks} if remarks else {},
    )


def _believed(effect: FoundEffect, weighed: Posterior, verdict: Verdict) -> FoundEffect:
    """Return a found effect with its probability, and its parameters averaged over the models that hold it."""
    provisional = verdict is Verdict.INCOMPLETE and effect.name != UNNAMED
    if not any(effect.name in model.names for model in weighed.models):
        return replace(effect, provisional=provisional)
    return replace(
        effect,
        provisional=provisional,
        probability=weighed.probability(effect.name),
        probability_of_any=weighed.probability(effect.name, *effect.alternatives),
        averaged=weighed.averaged(effect.name),
    )


def _optional_step(what: str, work: Callable[[], _T], failed: list[str]) -> _T | None:
    """Return the result of an optional step; None where it fails, since advice must not cost the answer."""
    try:
        return work()
    except Exception as error:  # noqa: BLE001 (whatever it is: minutes of fitting are not thrown away for a hint)
        at = traceback.extract_tb(error.__traceback__)[-1]
        _log.error("advice failed", what=what, error=repr(error), at=f"{Path(at.filename).name}:{at.lineno}")
        _log.debug("advice failed", trace=traceback.format_exc())
        failed.append(f"{what} could not be computed ({type(error).__name__}: {error}); all other results are valid")
        return None


def _found(
    outcome: Search, entries: Mapping[str, type[CatalogueEffect]], again: Periodic | None, failed: list[str]
) -> tuple[FoundEffect, ...]:
    state, weak = outcome.state, insignificant_names(outcome)
    parameters = fitted_parameters(state)
    present = {effect.name: effect for effect in state.effects}
    unnamed, found = rest_of(outcome, again), list[FoundEffect]()
    others = with_other_functional_form(outcome)
    for step in outcome.steps:
        if step.name == "unnamed" and unnamed is not None and unnamed not in found:
            found.append(unnamed)
        elif step.name in present and step.name not in weak:
            own = present[step.name]
            what = f"which effects act like {step.name}"
            alike = _optional_step(what, partial(inseparable, state, own, entries), failed) or ()
            rivals = tuple({rival.name: rival for rival in (*alike, *step.rivals)}.values())
            what = f"the capture that separates {step.name} from its rivals"
            rest = with_effects(state, [effect for effect in state.effects if effect is not own])
            advice = _optional_step(what, partial(propose, rest, own, rivals), failed)
            fitted, curved = dict(parameters[step.name]), tuple[str, ...]()
            if isinstance(own, FreeLaw):
                what, curved = f"how well the size of {step.name} is known", own.law_names()
                sizes = _optional_step(what, partial(sizes_by_own_law, state, own), failed) or {}
                fitted |= {name: entry for name, entry in sizes.items() if fitted[name].u is None}
            found.append(
                FoundEffect(
                    step.name,
                    {name: entry for name, entry in fitted.items() if name not in curved},
                    step.where,
                    step.gap_before,
                    step.gap_after,
                    tuple(rival.name for rival in rivals),
                    advice,
                    step.gain_nats,
                    own.block,
                    other_law=size_of_rest(state, own.block) if own in others else None,
                    curve=LawCurve.of(own, parameters[step.name]),
                )
            )
    return (*found, unnamed) if unnamed is not None and unnamed not in found else tuple(found)


def _largest(tests: Sequence[Disagreement]) -> dict[str, float]:
    found: dict[str, float] = {}
    for test in tests:
        name = axis_of(test.where, test.block)
        found[name] = max(found.get(name, 0.0), test.chi2 / test.rank)
    return found


def _assumptions(outcome: Search, doubts: Sequence[str], well: ShownWell | None) -> tuple[str, ...]:
    state, contradicts = outcome.state, well is not None and well.contradicts
    camera, design, wander2 = state.design.header.camera, state.design, state.comparison.wander2
    free, reading_k = dark_current_is_free(design), design.reading_u_k
    wander_dn, drift_dn = wander_of_black(design, state.seen), drift_of_black(design, state.seen)
    shown = well.remark if well is not None and not contradicts else ""
    aside = "fitted as a nuisance, not named"
    notes = (
        (camera.conversion_gain_e_per_dn is None,
         "the conversion gain is not declared: it was fitted from the noise"),
        (camera.read_noise_e is None, "the read noise is not declared: it was fitted"),
        (camera.full_well_e is None, "the full well is not declared: clipping alone limits the data"),
        (camera.dark_current_e_per_s is None,
         f"the dark current is not declared: {'it was fitted' if free else 'none is assumed'}"),
        (shown, shown),
        (state.model.passes_well and not contradicts,
         "pixels hold more than the declared full well, with the noise of that charge: the declared value is not used "
         "as a limit"),
        (is_misfit(state),
         f"structure remains (gap {state.gap:.3g}): it widens the uncertainties of all parameters"),
        (wander2, f"the source wanders by {np.sqrt(wander2):.2g} from frame to frame: {aside}"),
        (wander_dn, f"the black level wanders by {wander_dn:.2g} DN from frame to frame: {aside}"),
        (drift_dn, f"the black level moves by {drift_dn:.2g} DN while a frame is read: {aside}"),
        (reading_k, f"temperatures are recorded in steps: each is known within {reading_k:.2g} K"),
        (np.isnan(design.black_level_dn).any(), "the black level is not declared: it was fitted"),
        (not design.uniform, "no patches are given: the scene is unknown but constant, cut into a grid of tiles"),
        (not design.uniform,
         "uneven tiles that reach the highest measured level are left out: only even tiles show saturation"),
        (not design.has_timestamps, "times are missing: captures are treated as taken in the order listed"),
    )  # fmt: skip
    return (*doubts, *(text for holds, text in notes if holds))

"""Reconciles a capture set with the forward model: from frames to a verdict.

Frames are read a second time where what they show changes how they are to be read.
"""

from __future__ import annotations

import itertools
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import structlog

from radiometer.data import CaptureHeader
from radiometer.data.white_level import white_level_notes
from radiometer.errors import CaptureError
from radiometer.importing import open_capture
from radiometer.one_thread import on_one_blas_thread
from radiometer.reconciliation.fit.descent import first_state, fitted_parameters, is_misfit, scatter_of
from radiometer.reconciliation.fit.nuisances import dark_current_is_free
from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.full_well import ShownWell, levels_of_brightest, shown_well
from radiometer.reconciliation.measure.design import CaptureStatistics, Design
from radiometer.reconciliation.measure.frame_order import FrameLight, Periodic, periodic, scenes_of, steadied
from radiometer.reconciliation.measure.reduce import (
    FrameReader,
    PatternImages,
    Progress,
    reduce_frames,
    with_even_tiles,
)
from radiometer.reconciliation.next_capture import propose, propose_for_blind, propose_for_unnamed
from radiometer.reconciliation.propose.search import held_to_laws
from radiometer.reconciliation.repeatability import black_by_noise, drift_of_black, repeats_of, wander_of_black
from radiometer.reconciliation.result import (
    CovariateGap,
    FoundEffect,
    LawCurve,
    Limit,
    Place,
    ReconcileResult,
    Repeats,
    Series,
    Verdict,
)
from radiometer.reconciliation.search.localise import Disagreement, axis_of, global_p_value, places
from radiometer.reconciliation.search.search import Reconciled, Search, search
from radiometer.reconciliation.separability import Separability, inseparable, limits, separability
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
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.free_law import FreeLaw
from simulators.effects.registry import all_effects

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
        if max(scenes.values()):
            _refuse_lone_frames(header, scenes)
        names |= {index: f"{pattern}, scene {scene + 1}" for index, scene in scenes.items() if scene}
    if not names:
        return None
    frames = [
        frame.model_copy(update={"pattern": names.get(index, frame.pattern)})
        for index, frame in enumerate(header.frames)
    ]
    patterns = tuple(dict.fromkeys((*header.patterns, *names.values())))
    return header.model_copy(update={"frames": tuple(frames), "patterns": patterns})


def _refuse_lone_frames(header: CaptureHeader, scenes: Mapping[int, int]) -> None:
    times = Counter(scenes.values())
    lone = [header.frames[index].file for index, scene in scenes.items() if times[scene] == 1]
    if lone:
        raise CaptureError(
            f"the frames show {len(times)} scenes, and no other frame shows that of {', nor that of '.join(lone)}: "
            "it cannot be compared with any; give two frames or more of each scene, or those of one scene only"
        )


def _read_by(design: Design, read: FrameReader, progress: Progress | None) -> Shown:
    light = FrameLight(design, read)
    return design, light, reduce_frames(design, light, progress)


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
        localisation=tuple(_place(test) for test in places(outcome.start, _PLACES)),
        global_p=(before, before if state is outcome.start else global_p_value(state, outcome.tests)),
        calls=(sum(test.p_value < _CALL for test in outcome.first_tests), len(outcome.first_tests)),
        added=(*state.model.given, *state.effects),
        captures=len(state.design.captures),
        frames=frames,
        seconds=time.monotonic() - begun,
        models=weighed.listed(),
        extra=_remarks(state, effects, well),
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


def _remarks(state: FitState, effects: Sequence[FoundEffect], well: ShownWell | None) -> dict[str, Any]:
    named = {effect.name: {key: entry.u for key, entry in effect.parameters.items()} for effect in effects}
    camera = state.design.header.camera
    all_remarks = [effect.remark(camera, named[effect.name]) for effect in state.effects if effect.name in named]
    remarks = [remark for remark in all_remarks if remark]
    if well is not None and well.contradicts:
        remarks.append(well.remark)
    return {"remarks": remarks} if remarks else {}


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


def _place(test: Disagreement) -> Place:
    return Place(test.family, axis_of(test.where, test.block), test.form, test.chi2, test.p_value)


def _largest(tests: Sequence[Disagreement]) -> dict[str, float]:
    found: dict[str, float] = {}
    for test in tests:
        name = axis_of(test.where, test.block)
        found[name] = max(found.get(name, 0.0), test.chi2 / test.rank)
    return found


def _assumptions(outcome: Search, doubts: Sequence[str], well: ShownWell | None) -> tuple[str, ...]:
    state = outcome.state
    camera = state.design.header.camera
    notes = list(doubts)
    for key, text in (
        ("conversion_gain_e_per_dn", "the conversion gain is not declared: it was fitted from the noise"),
        ("read_noise_e", "the read noise is not declared: it was fitted"),
        ("full_well_e", "the full well is not declared: clipping alone limits the data"),
    ):
        if getattr(camera, key) is None:
            notes.append(text)
    if camera.dark_current_e_per_s is None:
        free = dark_current_is_free(state.design)
        notes.append(f"the dark current is not declared: {'it was fitted' if free else 'none is assumed'}")
    if well is not None and not well.contradicts and well.remark:
        notes.append(well.remark)
    if state.model.passes_well and not (well is not None and well.contradicts):
        notes.append(
            "pixels hold more than the declared full well, with the noise of that charge: the declared "
            "value is not used as a limit"
        )
    if is_misfit(state):
        notes.append(f"structure remains (gap {state.gap:.3g}): it widens the uncertainties of all parameters")
    if state.comparison.wander2:
        notes.append(
            f"the source wanders by {np.sqrt(state.comparison.wander2):.2g} from frame to frame: fitted as a "
            "nuisance, not named"
        )
    wander_dn = wander_of_black(state.design, state.seen)
    if wander_dn:
        notes.append(
            f"the black level wanders by {wander_dn:.2g} DN from frame to frame: fitted as a nuisance, not named"
        )
    drift_dn = drift_of_black(state.design, state.seen)
    if drift_dn:
        notes.append(
            f"the black level moves by {drift_dn:.2g} DN while a frame is read: fitted as a nuisance, not named"
        )
    reading_k = state.design.reading_u_k
    if reading_k:
        notes.append(f"temperatures are recorded in steps: each is known within {reading_k:.2g} K")
    if np.isnan(state.design.black_level_dn).any():
        notes.append("the black level is not declared: it was fitted")
    if not state.design.uniform:
        notes.append("no patches are given: the scene is unknown but constant, cut into a grid of tiles")
        notes.append("uneven tiles that reach the highest measured level are left out: only even tiles show saturation")
    if not state.design.has_timestamps:
        notes.append("times are missing: captures are treated as taken in the order listed")
    return tuple(notes)

"""Proposes the capture that separates rival explanations, or that shows what these data cannot detect.

Each rival is fitted to the data as they are; of a pool of settings the one is chosen under which most of them would
then predict something else.

Source: Box & Hill (1967), discrimination among mechanistic models, in the form of Buzzi-Ferraris & Forzatti (1983).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.data import FrameEntry
from radiometer.data.storage import write_yaml_atomic
from radiometer.reconciliation.advice.capture_pool import FRAMES, CapturePool
from radiometer.reconciliation.fit.descent import beside, refit
from radiometer.reconciliation.fit.state import FitState, with_effects, with_terms
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.result import Limit, ReconcileResult
from radiometer.reconciliation.search.screening import best_start
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

FORMAT: Final = "radiometer-plan/1"
_TOLD_CHI2: Final = 30.0  # a pair that differs by more is told apart; still more is worth no more
_HELPS_CHI2: Final = 4.0  # by so much a capture still helps where none does more
_REFITS: Final = 4
_WELL_BELOW: Final = 0.5
_STARTS: Final = 4  # of an entry, of which the likeliest is fitted
_EXPLAINS: Final = 0.3  # of what the best entry explains: below it an entry is no cause of a disagreement
_MOST_NAMED: Final = 6  # in a sentence


def propose(state: FitState, chosen: CatalogueEffect, rivals: Sequence[CatalogueEffect]) -> dict[str, Any] | None:
    """Return the capture under which an effect and its rivals would differ most.

    Args:
        state: The fitted model that holds the chosen effect.
        chosen: That effect.
        rivals: Other effects at parameters that fit about as well.

    Returns:
        Settings, what they separate and the χ² expected of it; None where there is no rival, or none that any capture
        of the pool could separate.
    """
    if not rivals:
        return None
    others = [effect for effect in state.effects if effect.name != chosen.name]
    models = {r.name: refit(with_effects(state, [*others, r]), iterations=_REFITS) for r in rivals}
    told = _best(state, models) or _best(state, models, _HELPS_CHI2)
    if told is None:
        return None
    frame, names, chi2 = told
    apart = [chosen.name, *names]
    return _advice(frame, f"separates {chosen.name} from {', '.join(names)}") | {
        "separates": apart,
        "expected_chi2": round(chi2, 1),
    }


def separating_capture(
    state: FitState, effect: CatalogueEffect, others: Sequence[CatalogueEffect]
) -> dict[str, Any] | None:
    """Return the capture under which an effect and others that show the same so far would differ most.

    Args:
        state: The model without any of them.
        effect: The effect at some size.
        others: The others at the sizes that look the same.
    """
    first, *models = (_held(state, entry) for entry in (effect, *others))
    pool = CapturePool.of(state)
    expected = pool.predicted(first)
    apart = np.nan_to_num(np.stack([pool.separation(expected, pool.predicted(model)) for model in models]))
    index = int(np.argmax(np.minimum(apart, _TOLD_CHI2).sum(axis=0)))
    names = [other.name for other, chi2 in zip(others, apart[:, index], strict=True) if chi2 >= _HELPS_CHI2]
    if not names:
        return None
    return _advice(pool.frame(index), f"separates {effect.name} from {', '.join(names)}") | {"separates": names}


def _held(state: FitState, effect: CatalogueEffect) -> FitState:
    """Return the model with an effect as it is, all else following."""
    return beside(state, effect, iterations=_REFITS)


def propose_for_unnamed(
    state: FitState, catalogue: Mapping[str, type[CatalogueEffect]], places: Sequence[tuple[str, str]]
) -> dict[str, Any] | None:
    """Return the capture that would separate the possible causes of a disagreement without a name.

    Each entry that acts along the covariate is fitted in place of the empirical term. A setting by itself cannot be
    predicted by the others, so that a new setting is asked for: there the entries, and no effect at all, must differ.

    Args:
        state: The fitted model.
        catalogue: Entries, by name.
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
        told = _farthest(nothing, models)
        if told is not None:
            frame, names = told
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
    worth = np.minimum(np.nan_to_num(np.stack(pairs)), _TOLD_CHI2).sum(axis=0) * pool.is_new
    index = int(np.argmax(worth))
    return (pool.frame(index), names) if worth[index] > _HELPS_CHI2 else None


def propose_for_blind(
    state: FitState, catalogue: Mapping[str, type[CatalogueEffect]], limits: Mapping[str, Limit]
) -> dict[str, Any] | None:
    """Return the capture that would show most of the effects that these data cannot see at their usual size.

    Each of them is put in at its typical size, and the nuisances are fitted with it. What stays invisible now must
    show in the new capture.

    Args:
        state: The fitted model.
        catalogue: Entries, by name.
        limits: What these data would have shown.

    Returns:
        Settings and what they would open; None where nothing is blind or no capture of the pool helps.
    """
    able = CapturePool.of(state).context
    models = {}
    for name, limit in limits.items():
        starts = catalogue[name].starts(state.model.context) if name in catalogue else ()
        if starts and catalogue[name].usable(able) and not _would_show(limit, starts[0]):
            models[name] = _held(state, starts[0])
    told = _best(state, models)
    if told is None:
        return None
    frame, names, _ = told
    shown = ", ".join(names[:_MOST_NAMED]) + (" and others" if len(names) > _MOST_NAMED else "")
    return _advice(frame, f"would show {shown}") | {"opens": names}


def _would_show(limit: Limit, typical: CatalogueEffect) -> bool:
    """Return whether the limit is well below an effect's typical size."""
    value = typical.values().get(limit.parameter)
    if limit.amplitude is None or limit.parameter not in typical.free() or value is None:
        return limit.amplitude is not None
    return limit.amplitude < _WELL_BELOW * abs(float(value) - typical.neutral(limit.parameter))


def _best(
    state: FitState, models: Mapping[str, FitState], enough: float = _TOLD_CHI2
) -> tuple[FrameEntry, list[str], float] | None:
    """Return the capture that separates most models from the state, which of them, and the least χ² among those."""
    if not models:
        return None
    pool = CapturePool.of(state)
    expected = pool.predicted(state)
    apart = np.stack([pool.separation(expected, pool.predicted(model)) for model in models.values()])
    apart = np.nan_to_num(apart)
    weight = np.array([_weight_unseen(name, model) for name, model in models.items()])
    worth = weight @ np.minimum(apart, _TOLD_CHI2)
    index = int(np.lexsort((apart.min(axis=0), worth))[-1])
    told: Array = apart[:, index]
    names = [name for name, chi2 in zip(models, told, strict=True) if chi2 >= enough]
    if not names:
        return None
    return pool.frame(index), names, float(min(chi2 for chi2 in told if chi2 >= enough))


def _weight_unseen(name: str, model: FitState) -> float:
    return next((effect.weight_unseen for effect in model.effects if effect.name == name), 1.0)


def _advice(frame: FrameEntry, purpose: str) -> dict[str, Any]:
    settings = frame.model_dump(mode="json", exclude_none=True, exclude={"file", "black_level_dn"})
    return {"description": f"{_said(frame)}: {purpose}", "frames": [settings | {"repeat": FRAMES}]}


def _said(frame: FrameEntry) -> str:
    exposure_gain = f"{frame.exposure_s:.3g} s at {frame.gain_db:g} dB"
    if frame.shutter == "closed":
        return f"dark frames (cap on) of {exposure_gain}"
    if frame.source_level == 0:
        return f"frames with the source off of {exposure_gain}"
    stop = f", f/{frame.f_number:.3g}" if frame.f_number else ""
    return f"{exposure_gain}{stop}, source level {frame.source_level:g}, pattern {frame.pattern}"


def write_plan(path: Path, result: ReconcileResult, design: Design) -> bool:
    """Write the captures of this set and the next one as a plan, so that its frames can be reconciled by themselves.

    Args:
        path: File to write.
        result: What was found.
        design: The captures as they were.

    Returns:
        Whether there was anything to plan; without a proposal no file is written.

    Raises:
        OutputError: If the file cannot be written.
    """
    wanted = [effect.next_capture for effect in result.effects if effect.next_capture]
    wanted += [result.next_capture] if result.next_capture else []
    if not wanted:
        return False
    new = [dict(frame) for capture in wanted for frame in capture["frames"]]
    reasons = [str(capture["description"]) for capture in wanted]
    write_yaml_atomic(path, {"format": FORMAT, "reasons": reasons, "frames": [*_taken(design), *new]})
    return True


def _taken(design: Design) -> list[dict[str, Any]]:
    planned = ("exposure_s", "gain_db", "f_number", "source_level", "pattern", "shutter")
    found = []
    for capture in design.captures:
        settings = {name: getattr(capture.settings, name) for name in planned}
        found.append({k: v for k, v in settings.items() if v is not None} | {"repeat": len(capture.frames)})
    return found

"""Reconciles a stack of photographs through an unknown tone curve with its printed exposures.

The response is unknown, so that only what breaks the agreement of all photographs with one curve can be told: stops
that were rounded when printed, and single labels that are not the real exposure. For pixel p in photograph i

    g(M_pi) = ln E_p + ln t_i + δ_i,

g a smooth curve on knots; ln E_p drops out by taking each pixel's mean away.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import Frame
from radiometer.data.storage import write_text_atomic, write_yaml_atomic
from radiometer.errors import CaptureError
from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.report.result import FittedParameter, FoundEffect, Limit, ReconcileResult, Verdict
from radiometer.units import exact_exposure_s

_GAP_UNIT: Final = "mean square of ln exposure on held-out pixels over that with every other exposure free"
_CELL_PX: Final = 4
_MOST_CELLS: Final = 1200
_KNOTS: Final = 18
_ABOVE_FLOOR: Final = 0.03  # share of full scale
_SAME_FLOOR_DN: Final = 1.0
_USED: Final = (0.04, 0.96)  # share of full scale between which a value tells the exposure
_FALL: Final = 0.02  # share of full scale by which a value falls beyond doubt
_FEWEST_RISING: Final = 3
_RISING_SHARE: Final = 0.05  # of the cells that fall
_NEEDED_NATS: Final = 15.0  # samples of one tone curve that is not quite smooth err together
_SMALLEST_LABEL_ERROR: Final = 0.08  # ln; an eighth of a stop: below it rounding and drift explain it
_LABEL: Final = "exposure_label_error"
_WHITE: Final = 1.6  # gap above which something stays unexplained


@dataclass(frozen=True, slots=True, eq=False)
class _Stack:
    """Samples of all photographs: value, cell and photograph of each, and the exposure labels."""

    value: Array
    cell: NDArray[np.intp]
    photograph: NDArray[np.intp]
    printed_s: Array

    @property
    def count(self) -> int:
        """Return the number of photographs."""
        return self.printed_s.size


@dataclass(frozen=True, slots=True)
class PhotographsReconciled:
    """The result for a stack of photographs, with the exposures found."""

    result: ReconcileResult
    exposures_s: dict[str, float]

    def write_model(self, path: Path, *, provisional: bool = False) -> str:
        """Write the exposures that agree with each other, in the form that photograph folders take."""
        lines = [f"{name} {seconds!r}" for name, seconds in self.exposures_s.items()]
        if path.suffix.lower() in (".yaml", ".yml"):
            write_yaml_atomic(path, {"format": "radiometer-exposures/1", "exposures_s": self.exposures_s})
        else:
            write_text_atomic(path, "\n".join(lines) + "\n")
        return str(path)

    def write_report(self, path: Path) -> str:
        """Write the exposures as HTML."""
        rows = "".join(f"<tr><td>{name}</td><td>{seconds:.6g}</td></tr>" for name, seconds in self.exposures_s.items())
        said = "".join(f"<p>{text}</p>" for text in self.result.extra.get("remarks", []))
        write_text_atomic(
            path,
            "<!doctype html><html lang='en'><meta charset='utf-8'><title>photographs</title>"
            f"<h1>{self.result.verdict}</h1>{said}<table><tr><th>file</th><th>exposure in s</th></tr>{rows}</table>"
            "</html>\n",
        )
        return str(path)

    def write_plan(self, path: Path) -> bool:
        """Write nothing: photographs are taken by hand; the result names the exposure to take again."""
        return False


def reconcile_photographs(frames: Sequence[Frame]) -> PhotographsReconciled:
    """Return whether printed exposures agree with the photographs, and which do not.

    Args:
        frames: Photographs of one scene, at least three with different exposures.

    Raises:
        CaptureError: If there are too few, or they hardly overlap.
    """
    begun = time.monotonic()
    light = sorted((f for f in frames if not f.settings.is_dark), key=lambda f: f.settings.exposure_s)
    names = [str(f.extra.get("file", number)) for number, f in enumerate(light)]
    if len({f.settings.exposure_s for f in light}) < 3:
        raise CaptureError("a stack of photographs needs at least three different exposures to be reconciled")
    stack = _samples(light)
    exact = np.array([exact_exposure_s(t) for t in stack.printed_s])
    result, log_t = _judge(stack, np.log(stack.printed_s), np.log(exact), names)
    real = {name: float(np.exp(value)) for name, value in zip(names, log_t, strict=True)}
    return PhotographsReconciled(replace(result, seconds=time.monotonic() - begun), real)


def _samples(frames: Sequence[Frame]) -> _Stack:
    """Return the calmest small cells of the picture as samples."""
    cells = np.stack([_cells(frame) for frame in frames])
    rough = np.stack([_roughness(frame) for frame in frames])
    low, high = (share * frames[0].full_scale_dn for share in _USED)
    used = (cells > max(low, _floor(cells) + _ABOVE_FLOOR * frames[0].full_scale_dn)) & (cells < high)
    used &= ~_against_the_order(cells, used, _FALL * frames[0].full_scale_dn)
    seen = used.sum(axis=0)
    unrest = np.where(used, rough / np.maximum(cells, 1.0), 0.0).sum(axis=0) / np.maximum(seen, 1)
    order = np.argsort(np.where(seen >= 2, unrest, np.inf))[: min(_MOST_CELLS, int(np.sum(seen >= 2)))]
    if order.size < 30:
        raise CaptureError("the photographs hardly overlap: no part of the scene is well exposed in two of them")
    photograph, cell = np.nonzero(used[:, order])
    value = cells[:, order][photograph, cell] / frames[0].full_scale_dn
    return _Stack(value, cell, photograph, np.array([f.settings.exposure_s for f in frames]))


def _against_the_order(cells: Array, used: NDArray[np.bool_], margin_dn: float) -> NDArray[np.bool_]:
    """Tell which cells are brighter in a photograph than in a longer one while others are darker in it.

    A wrong label moves all cells of a photograph the same way. What goes both ways is not the scene: light that fell on
    the film, a reflection, somebody who walked through.
    """
    against = np.zeros_like(used)
    for shorter in range(len(cells)):
        for longer in range(shorter + 1, len(cells)):
            falls = used[shorter] & (cells[shorter] > cells[longer] + margin_dn)
            rises = (used[shorter] | used[longer]) & (cells[longer] > cells[shorter] + margin_dn)
            if rises.sum() >= max(_FEWEST_RISING, _RISING_SHARE * float(falls.sum())):
                against[shorter] |= falls
    return against


def _floor(cells: Array) -> float:
    """Return the value below which nothing falls, in DN: where the darkest parts of the two shortest exposures agree.

    A scanned film or a broadcast range has its black well above 0; values there tell nothing of the exposure.
    """
    darkest = np.percentile(cells[:2], 1.0, axis=1)
    return float(darkest.min()) if abs(float(darkest[0] - darkest[1])) < _SAME_FLOOR_DN else 0.0


def _blocks(frame: Frame) -> Array:
    rows, columns = frame.shape[0] // _CELL_PX, frame.shape[1] // _CELL_PX
    cut = frame.dn[: rows * _CELL_PX, : columns * _CELL_PX].astype(np.float64)
    return cut.reshape(rows, _CELL_PX, columns, _CELL_PX).transpose(0, 2, 1, 3).reshape(rows * columns, -1)


def _cells(frame: Frame) -> Array:
    return np.asarray(_blocks(frame).mean(axis=1))


def _roughness(frame: Frame) -> Array:
    return np.asarray(_blocks(frame).std(axis=1))


def _judge(stack: _Stack, printed: Array, exact: Array, names: Sequence[str]) -> tuple[ReconcileResult, Array]:
    log_t, wrong = printed.copy(), list[int]()
    effects: list[FoundEffect] = []
    first = _error(stack, log_t, [])
    best_possible = min(first, _error(stack, log_t, list(range(1, stack.count - 1, 2))))
    now = first
    for _ in range(4):
        suspects = [i for i in range(stack.count) if i not in wrong] if len(wrong) < _most_wrong(stack) else []
        options = [(_error(stack, log_t, [*wrong, i]), i) for i in suspects]
        if not any(effect.name == "nominal_settings" for effect in effects) and np.ptp(exact - printed) > 1e-3:
            options.append((_error(stack, exact, wrong), -1))
        if not options:
            break
        error, index = min(options)
        if _nats(stack, now, error) < _NEEDED_NATS:
            break
        if index < 0:
            log_t = exact.copy()
            effects.append(_rounding(now / best_possible, error / best_possible, _nats(stack, now, error)))
        else:
            offset = _offsets(stack, log_t, [*wrong, index])[-1]
            if abs(offset) < _SMALLEST_LABEL_ERROR:
                break
            wrong.append(index)
            effects.append(_label(stack, index, offset, (now, error, best_possible), names[index]))
        now = error
    offsets = _offsets(stack, log_t, wrong)
    log_t[wrong] += offsets
    labels = iter(wrong)
    effects = [_with_ratio(e, stack, log_t[next(labels)]) if e.name == _LABEL else e for e in effects]
    return _result(stack, effects, (first, now, best_possible), len(names)), log_t


def _most_wrong(stack: _Stack) -> int:
    """Return how many labels may be wrong: most must be right, or a flat curve with exposures of its own fits best."""
    return max((stack.count - 1) // 3, 1)


def _result(
    stack: _Stack, effects: Sequence[FoundEffect], errors: tuple[float, float, float], frames: int
) -> ReconcileResult:
    first, now, best = errors
    explained = now / best < _WHITE
    verdict = Verdict.EFFECTS_FOUND if effects else Verdict.AGREES
    found = list(effects)
    if not explained:
        verdict = Verdict.INCOMPLETE if effects else Verdict.UNNAMED
        found.append(FoundEffect("unnamed", {}, "exposure_s", now / best, now / best, block="exposure ratios"))
    per_photograph = np.bincount(stack.photograph, minlength=stack.count).min()
    limit = 5.0 * math.sqrt(now / max(float(per_photograph), 1.0))
    return ReconcileResult(
        verdict=verdict,
        effects=tuple(found),
        gap_before=first / best,
        gap_after=now / best,
        limits={
            "exposure_label_error": Limit(max(limit, _SMALLEST_LABEL_ERROR), "ratio", "1"),
            "gamma_enabled": Limit(None, "gamma", "1"),
            "response_nonlinearity": Limit(None, "a2", "1"),
        },
        captures=frames,
        frames=frames,
        assumptions=(
            "the tone curve is unknown but one and the same for all photographs",
            "a power of the tone curve and one of the exposures cannot be told apart: the printed ratios fix it",
        ),
        gap_unit=_GAP_UNIT,
        extra={"remarks": []},
    )


def _rounding(before: float, after: float, nats: float) -> FoundEffect:
    share = {"share": FittedParameter(1.0, None, "1")}
    return FoundEffect("nominal_settings", share, "exposure_s", before, after, gain_nats=nats, block="exposure ratios")


def _label(stack: _Stack, index: int, offset: float, errors: tuple[float, float, float], name: str) -> FoundEffect:
    before, after, best = errors
    count = max(float(np.sum(stack.photograph == index)), 1.0)
    ratio = math.exp(offset)
    parameters: dict[str, Any] = {
        "label_s": FittedParameter(float(stack.printed_s[index]), None, "s"),
        "ratio": FittedParameter(ratio, ratio * math.sqrt(after / count) * 3.0, "1"),
    }
    advice = {"description": f"take the exposure of {name} again, or read its EXIF record"}
    nats = _nats(stack, before, after)
    return FoundEffect(
        _LABEL,
        parameters,
        "exposure_s",
        before / best,
        after / best,
        (),
        advice,
        nats,
        "exposure ratios",
    )


def _with_ratio(effect: FoundEffect, stack: _Stack, log_t: float) -> FoundEffect:
    """Return a wrong label with its ratio as it came out in the end: other effects found later move it."""
    label, old = effect.parameters["label_s"], effect.parameters["ratio"]
    ratio = replace(old, value=math.exp(log_t) / label.value)
    return replace(effect, parameters={"label_s": label, "ratio": ratio})


def _nats(stack: _Stack, before: float, after: float) -> float:
    """Return the gain in log likelihood; neighbouring samples of one cell count once."""
    independent = stack.value.size / stack.count
    return 0.5 * independent * math.log(max(before, 1e-30) / max(after, 1e-30))


def _design(stack: _Stack, free: Sequence[int]) -> Array:
    """Return the columns of the curve's knots and of the free exposures, each cell's mean taken away."""
    knots = np.linspace(_USED[0], _USED[1], _KNOTS)
    place = np.clip((stack.value - knots[0]) / (knots[1] - knots[0]), 0.0, _KNOTS - 1.000001)
    left = place.astype(np.intp)
    columns = np.zeros((stack.value.size, _KNOTS + len(free)))
    rows = np.arange(stack.value.size)
    columns[rows, left] = 1.0 - (place - left)
    columns[rows, left + 1] += place - left
    for number, photograph in enumerate(free):
        columns[stack.photograph == photograph, _KNOTS + number] = -1.0
    return _centred(stack, columns)


def _centred(stack: _Stack, columns: Array) -> Array:
    count = np.bincount(stack.cell).astype(np.float64)
    centred = np.empty_like(columns)
    for index in range(columns.shape[1]):
        means = np.bincount(stack.cell, columns[:, index]) / np.maximum(count, 1.0)
        centred[:, index] = columns[:, index] - means[stack.cell]
    return centred


def _solve(stack: _Stack, log_t: Array, free: Sequence[int], train: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Return (solution, columns, right side); a little smoothness holds knots that hardly any sample touches."""
    columns = _design(stack, free)
    right = _centred(stack, log_t[stack.photograph][:, None])[:, 0]
    bend = np.zeros((_KNOTS - 2, columns.shape[1]))
    for k in range(_KNOTS - 2):
        bend[k, k : k + 3] = (1.0, -2.0, 1.0)
    anchor = np.zeros((1, columns.shape[1]))
    anchor[0, _KNOTS // 2] = 1.0
    system = np.vstack([columns[train], 0.3 * bend, anchor])
    wanted = np.concatenate([right[train], np.zeros(bend.shape[0] + 1)])
    return np.linalg.lstsq(system, wanted, rcond=None)[0], columns, right


def _error(stack: _Stack, log_t: Array, free: Sequence[int]) -> float:
    """Return the mean square of ln exposure on held-out cells, in two folds."""
    total, number = 0.0, 0
    for fold in (0, 1):
        train = stack.cell % 2 != fold
        solution, columns, right = _solve(stack, log_t, free, train)
        residual = columns[~train] @ solution - right[~train]
        total, number = total + float(np.sum(residual**2)), number + residual.size
    return total / max(number, 1)


def _offsets(stack: _Stack, log_t: Array, free: Sequence[int]) -> Array:
    """Return ln of real over printed exposure of the free photographs."""
    solution, _, _ = _solve(stack, log_t, free, np.ones(stack.value.size, dtype=np.bool_))
    return np.asarray(solution[_KNOTS:])

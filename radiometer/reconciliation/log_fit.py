"""Names the term that is missing when a log of a camera is compared with a reference meter.

value = s·(1 + a·s/s̄) + b,  s = R·(L + L₀)·(t + δ)·10^(G/20)·c(colour, T, gain) + D·t·10^(G/20)·2^((T − 25 °C)/θ)

R is the responsivity; each term is off at zero. Terms bear the names of the catalogue of effects.

Terms that follow the signal (b, a) or the reference (L₀) need care, for both are known with errors. Automatic exposure
keeps the value constant: clouds, which the reference does not see, change the predicted signal and not the measured
one. At the longest exposure it is the other way round. Such a term is therefore fitted twice: with the signal as
predicted and with the signal as measured. The truth is between the two.

Readings of one night are correlated: clouds and extinction move them together, and neighbours more so. Their
covariance is estimated with every term of the catalogue and free curves fitted, so that no effect counts as scatter.
The residual is whitened by it. The search uses reconcile's linear fit, its leave-one-group-out with nights as groups,
and its thresholds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from radiometer.errors import MeasurementError
from radiometer.importing.log_table import LogTable
from radiometer.reconciliation.linear import Groups, HeldOut, LinearFit, RowBlock, leave_one_group_out
from radiometer.reconciliation.result import FittedParameter, FoundEffect, Limit, ReconcileResult, Verdict
from radiometer.reconciliation.thresholds import (
    ESSENTIAL_SIGMAS,
    NAMED_NATS,
    PARAMETER_NATS,
    RIVAL_NATS,
    SIGNIFICANCE,
    SMOOTH_SHARE,
)
from radiometer.statistics.chances import chi2_beyond
from radiometer.typing import Array

SIGNAL: Final = "signal"
MEASURED_TOO: Final = (SIGNAL, "reference")
"""Columns that the reference predicts, with its errors. What acts along them is fitted along the measured ones too."""

_STEP: Final = 1e-5  # of a parameter's scale, for differences
_DARK_AT_C: Final = 25.0
DOUBLING_K: Final = 6.5
"""Warming in K that doubles a dark current, where its fit begins: 5 K to 9 K are usual for silicon."""

_LEAST_DOUBLING_K, _MOST_DOUBLING_K = 3.0, 20.0
_LARGEST_LOG: Final = 200.0  # limit of ln(signal) while a step is tried, far beyond any camera
_NEAR_DB: Final = 0.05  # gains that differ less are one
_MOST_GAINS: Final = 12
_LEAST_CORRELATION: Final = 0.5  # of a column as predicted and as measured: there scatter and variation are equal
_DEGREE: Final = 3  # of a trend without a name: a bend that changes its sign once


Adds = Callable[[LogTable, Array], Array | float]


@dataclass(frozen=True, slots=True)
class LogTerm:
    """One term that may be missing."""

    name: str  # name of the effect
    where: str  # column along which it acts
    parameters: tuple[str, ...]  # names of its parameters
    units: tuple[str, ...]  # their units
    # Size of each that makes a difference of about 1 % somewhere; also the step of differences
    scales: tuple[float, ...]
    part: str  # part of the predicted value that it adds to: one of `_PARTS`
    adds: Adds  # gives what its parameters add to that part
    flexible: bool = False  # whether it is the flexible form of another one of the same name
    start: tuple[float, ...] = ()  # where their fit begins; zeros by default

    @property
    def begins(self) -> Array:
        """Return where the fit of its parameters begins."""
        return np.array(self.start or (0.0,) * self.size)

    @property
    def size(self) -> int:
        """Return the number of its parameters."""
        return len(self.parameters)


# Leak in the reference's unit; exposure in s; ln of a factor on the light; dark signal in DN before the gain; offset in
# DN; curvature per DN.
_PARTS: Final = ("leak", "exposure_s", "log_factor", "dark", "offset_dn", "curvature")


def amplitude(log: LogTable) -> float:
    """Return the typical value in DN, the scale of a nonlinearity."""
    return float(np.median(log.value))


def _predicted_log(log: LogTable, terms: Sequence[LogTerm], parameters: Array, *, measured: bool = False) -> Array:
    """Return ln of the predicted values."""
    parts: dict[str, Any] = dict.fromkeys(_PARTS, 0.0) | {"exposure_s": log.exposure_s}
    at = 1
    for term in terms:
        parts[term.part] = parts[term.part] + term.adds(log, parameters[at : at + term.size])
        at += term.size
    leak, exposure_s, log_factor, dark, offset_dn, curvature = parts.values()
    gain = 10.0 ** (log.gain_db / 20.0)
    per_radiance = np.exp(np.clip(parameters[0] + log_factor, -_LARGEST_LOG, _LARGEST_LOG)) * exposure_s * gain
    if measured:
        straight = log.value - offset_dn
        straight = straight / _positive(1.0 + curvature * straight)
        rest = _positive(straight - per_radiance * leak)
        signal = per_radiance * log.reference + dark * gain
        return np.asarray(np.log(_positive(signal)) + np.log(log.value) - np.log(rest))
    signal = per_radiance * (log.reference + leak) + dark * gain
    bent = _positive(signal) * (1.0 + curvature * signal) + offset_dn
    return np.asarray(np.log(_positive(bent)))


def _positive(values: Array) -> Array:
    """Return the values, NaN for those that are not positive: parameters that give them describe no camera."""
    return np.where(values > 0.0, values, np.nan)


def _jacobian(log: LogTable, terms: Sequence[LogTerm], parameters: Array, *, measured: bool = False) -> Array:
    scales = np.concatenate([[1.0], *([term.scales] for term in terms)], axis=None)
    columns = []
    for index, scale in enumerate(scales):
        step = np.zeros(scales.size)
        step[index] = _STEP * scale
        ahead, behind = (
            _predicted_log(log, terms, parameters + sign * step, measured=measured) for sign in (1.0, -1.0)
        )
        columns.append((ahead - behind) / (2.0 * _STEP * scale))
    return np.column_stack(columns)


def catalogue(log: LogTable) -> tuple[LogTerm, ...]:
    """Return the terms that these columns can show; one whose column is missing or does not vary is left out."""
    value, units, shown = amplitude(log), log.units or {}, {*MEASURED_TOO, *axes(log)}
    unit, per_colour = units.get("reference", "1"), units.get("colour", "1")
    dark = 0.01 * value / float(np.median(log.exposure_s)) / float(np.median(10.0 ** (log.gain_db / 20.0)))
    mean_c, mean_colour = (0.0 if v is None else float(np.mean(v)) for v in (log.temperature_c, log.colour))
    wide = float(np.std(log.colour)) if "colour" in shown and log.colour is not None else 1.0
    most, *others = _gain_levels(log)

    def of_dark(log: LogTable, own: Array) -> Array:
        doubling = min(max(float(own[1]), _LEAST_DOUBLING_K), _MOST_DOUBLING_K)
        return np.asarray(own[0] * log.exposure_s * 2.0 ** ((np.asarray(log.temperature_c) - _DARK_AT_C) / doubling))

    def of_table(log: LogTable, own: Array) -> Array:
        return np.asarray((np.abs(log.gain_db[:, None] - np.array(others)) <= _NEAR_DB).astype(np.float64) @ own)

    found = [
        _term("black_level_offset", SIGNAL, "offset_dn", "DN", 0.01 * value, "offset_dn", lambda log, own: own[0]),
        _term("ambient_light_leak", "reference", "constant", unit, 0.01 * float(np.median(log.reference)), "leak",
              lambda log, own: own[0]),
        _term("response_nonlinearity", SIGNAL, "a2", "1", 0.01, "curvature", lambda log, own: own[0] / value),
        _term("exposure_time_offset", "exposure", "offset_s", "s", 0.01 * float(np.min(log.exposure_s)), "exposure_s",
              lambda log, own: own[0]),
        _term("gain_step_error", "gain", "per_dB", "dB-1", 0.001, "log_factor",
              lambda log, own: own[0] * (log.gain_db - most)),
        LogTerm("gain_step_error", "gain", tuple(f"at_{level:.1f}dB" for level in others), ("1",) * len(others),
                (0.01,) * len(others), "log_factor", of_table, flexible=True),
        _term("quantum_efficiency_temperature", "temperature", "per_K", "K-1", 0.001, "log_factor",
              lambda log, own: own[0] * (np.asarray(log.temperature_c) - mean_c)),
        LogTerm("dark_current", "temperature", ("dark_at_25C_dn_per_s", "doubling_K"), ("DN s-1", "K"), (dark, 0.02),
                "dark", of_dark, start=(dark, DOUBLING_K)),
        _term("spectral_mismatch", "colour", "per_colour", "1" if per_colour == "1" else f"{per_colour}-1", 0.01 / wide,
              "log_factor", lambda log, own: own[0] * (np.asarray(log.colour) - mean_colour)),
    ]  # fmt: skip
    return tuple(
        term for term in found if term.where in shown and not (term.flexible and not 1 < term.size < _MOST_GAINS)
    )


def _term(name: str, where: str, parameter: str, unit: str, scale: float, part: str, adds: Adds) -> LogTerm:
    return LogTerm(name, where, (parameter,), (unit,), (scale,), part, adds)


def _varies(values: Array) -> bool:
    return float(np.ptp(values)) > 1e-6


def _gain_levels(log: LogTable) -> list[float]:
    rounded = np.round(log.gain_db / _NEAR_DB) * _NEAR_DB
    levels, counts = np.unique(rounded, return_counts=True)
    most = float(levels[np.argmax(counts)])
    return [most, *(float(level) for level in levels if level != most)]


def axes(log: LogTable, *, measured: bool = False) -> Mapping[str, Array]:
    """Return each column on a scale from −1 to 1, for trends without a name.

    Args:
        measured: Take signal and reference from the values as measured, not from the reference.
    """
    per_reference = np.log(log.exposure_s) + log.gain_db * math.log(10.0) / 20.0
    reference = np.log(log.value) - per_reference if measured else np.log(log.reference)
    raw: dict[str, Array | None] = {
        SIGNAL: reference + per_reference,
        "reference": reference,
        "exposure": np.log(log.exposure_s),
        "gain": log.gain_db,
        "temperature": log.temperature_c,
        "colour": log.colour,
        "time": log.time_s,
    }
    found = {}
    for name, values in raw.items():
        if values is not None and _varies(values):
            low, high = float(values.min()), float(values.max())
            found[name] = np.asarray(2.0 * (values - low) / (high - low) - 1.0)
    return found


def _is_lost_in_scatter(log: LogTable, name: str) -> bool:
    """Return whether a column varies by less than its readings scatter: nothing can be shown along it."""
    if name not in MEASURED_TOO:
        return False
    predicted, measured = (axes(log, measured=way).get(name) for way in (False, True))
    if predicted is None or measured is None:
        return True
    return float(np.corrcoef(predicted, measured)[0, 1]) < _LEAST_CORRELATION


def _trend(log: LogTable, name: str, *, measured: bool = False) -> Array:
    return np.asarray(legvander(axes(log, measured=measured)[name], _DEGREE)[:, 1:])


_ITERATIONS: Final = 12
_FARTHEST: Final = 100.0  # scales of a parameter (1 % of the light each) by which one iteration may move it

Whiteners = tuple[tuple[NDArray[np.intp], Array], ...]


@dataclass(frozen=True, slots=True)
class Scatter:
    """Scatter of readings about a correct model, in ln(value)."""

    reading: float  # standard deviation of a reading within its night
    clouds: float  # share of that variance that hangs together along the night
    neighbours: float  # correlation of that share from a reading to the next
    night: float  # standard deviation of nights

    def factors(self, log: LogTable) -> Whiteners:
        """Return (rows, lower Cholesky factor of their covariance) of each night."""
        found: list[tuple[NDArray[np.intp], Array]] = []
        for night in range(log.nights):
            rows = np.flatnonzero(log.night == night)
            if log.time_s is not None:
                rows = rows[np.argsort(log.time_s[rows], kind="stable")]
            apart = np.abs(np.arange(rows.size)[:, None] - np.arange(rows.size)[None, :])
            alike = self.clouds * self.neighbours**apart + (1.0 - self.clouds) * np.eye(rows.size)
            covariance = self.reading**2 * alike + self.night**2
            if log.u_reference_rel is not None:
                covariance = covariance + np.diag(log.u_reference_rel[rows] ** 2)
            found.append((rows, np.linalg.cholesky(covariance + 1e-12 * self.reading**2 * np.eye(rows.size))))
        return tuple(found)

    def whiteners(self, log: LogTable) -> Whiteners:
        """Return (rows, inverse of their factor) of each night."""
        return tuple((rows, np.asarray(np.linalg.inv(factor))) for rows, factor in self.factors(log))


@dataclass(frozen=True, eq=False)
class LogState:
    """A fitted model of a log."""

    log: LogTable  # the readings
    scatter: Scatter  # how they scatter
    terms: tuple[LogTerm, ...]  # the named terms
    parameters: Array  # ln R, then theirs
    whiteners: Whiteners  # what whitens each night
    trends: tuple[tuple[str, Array], ...] = ()  # columns of trends without a name, with the axis of each
    measured: bool = False  # whether terms and trends along the signal or the reference take these as measured

    def whitened(self, columns: Array) -> Array:
        """Return columns, or a residual, with each night's covariance taken out; rows come night by night."""
        return np.concatenate([inverse @ columns[rows] for rows, inverse in self.whiteners])

    @cached_property
    def groups(self) -> NDArray[np.intp]:
        """Return the night of each whitened row."""
        return np.concatenate([np.full(rows.size, n, np.intp) for n, (rows, _) in enumerate(self.whiteners)])

    @cached_property
    def fit(self) -> LinearFit:
        """Return the linear fit about the parameters; the responsivity is the nuisance."""
        columns = _jacobian(self.log, self.terms, self.parameters, measured=self.measured)
        every = self.whitened(np.column_stack([columns, *(c for _, c in self.trends)]))
        shown = _predicted_log(self.log, self.terms, self.parameters, measured=self.measured)
        rest = self.whitened(np.log(self.log.value) - shown)
        nuisance, none = RowBlock.of(every[:, :1]), RowBlock(np.zeros(0, np.intp), np.zeros((0, 1)))
        return LinearFit.of(rest, nuisance, every[:, 1:], none)

    @cached_property
    def chi2(self) -> float:
        """Return the χ² of all readings, trends at their best."""
        return float(self.fit.projected @ self.fit.projected)

    @cached_property
    def held_out(self) -> HeldOut:
        """Return how well each night is predicted by the others."""
        every = np.ones(self.log.size, np.bool_)
        return leave_one_group_out(self.fit, Groups(self.fit.nuisances, self.groups, every))

    @property
    def evidence(self) -> float:
        """Return the held-out log density, in nats."""
        return float(self.held_out.log_density.sum())

    @property
    def gap(self) -> float:
        """Return the reduced χ² of held-out nights."""
        return float(self.held_out.chi2.sum() / self.held_out.count.sum())

    @property
    def free(self) -> int:
        """Return the number of parameters without the responsivity."""
        return int(self.parameters.size) - 1 + sum(int(c.shape[1]) for _, c in self.trends)

    @cached_property
    def cost(self) -> float:
        """Return the χ² at these parameters, responsivity and trends at their best; infinite beyond any camera."""
        if not np.all(np.isfinite(_predicted_log(self.log, self.terms, self.parameters, measured=self.measured))):
            return math.inf
        bare = replace(self.fit, effects=self.fit.effects[:, self.parameters.size - 1 :])
        return float(bare.projected @ bare.projected)

    def fitted(self) -> LogState:
        """Return the state with its parameters at the least χ², by damped Gauss–Newton steps."""
        state = self
        for _ in range(_ITERATIONS):
            moved = state._halved(state.fit.step[: state.parameters.size])
            gained = state.cost - moved.cost
            state = moved if gained > 0 else state
            if gained < 1e-3:
                break
        return state

    def _halved(self, step: Array) -> LogState:
        far = _FARTHEST * np.array([math.inf, *(scale for term in self.terms for scale in term.scales)])
        moved, step = self, np.clip(step, -far, far)
        for halving in range(8):
            moved = replace(self, parameters=self.parameters + step / 2**halving)
            if moved.cost <= self.cost:
                break
        return moved

    def with_term(self, term: LogTerm) -> LogState:
        """Return the fitted state with a further term."""
        parameters = np.concatenate([self.parameters, term.begins])
        return replace(self, terms=(*self.terms, term), parameters=parameters).fitted()

    @cached_property
    def other_way(self) -> LogState:
        """Return the model with signal and reference taken the other way; itself where nothing acts along them."""
        if not {*(term.where for term in self.terms), *(name for name, _ in self.trends)} & set(MEASURED_TOO):
            return self
        trends = tuple(
            (name, _trend(self.log, name, measured=not self.measured) if name in MEASURED_TOO else columns)
            for name, columns in self.trends
        )
        # It begins where nothing is missing: the parameters that one way finds may be impossible in the other.
        begins = np.concatenate([self.parameters[:1], *(term.begins for term in self.terms)])
        return replace(self, measured=not self.measured, trends=trends, parameters=begins).fitted()

    @cached_property
    def night_error(self) -> float:
        """Return the root mean square relative error of nights that are predicted from the others."""
        squares, log = 0.0, self.log
        for night in range(log.nights):
            others, own = np.flatnonzero(log.night != night), np.flatnonzero(log.night == night)
            numbers = np.asarray(np.unique(log.night[others], return_inverse=True)[1], dtype=np.intp)
            part = replace(log.take(others), night=numbers)
            trends = tuple((name, columns[others]) for name, columns in self.trends)
            fitted = replace(self, log=part, whiteners=self.scatter.whiteners(part), trends=trends).fitted()
            ahead = log.take(own)
            shown = _predicted_log(ahead, self.terms, fitted.parameters, measured=self.measured)
            if self.trends:
                weights = fitted.fit.step[fitted.parameters.size :]
                shown = shown + np.column_stack([columns[own] for _, columns in self.trends]) @ weights
            squares += float(np.sum(np.square(np.expm1(np.log(ahead.value) - shown))))
        return math.sqrt(squares / log.size)

    def uncertainty(self) -> Array:
        """Return the standard uncertainties of the terms' parameters, (parameters,)."""
        return np.asarray(np.sqrt(np.diag(self.fit.covariance))[1 : self.parameters.size])


GAP_UNIT: Final = "reduced chi-square on held-out nights"
# Share of a reading's variance that hangs together with its neighbours', and its correlation from one to the next.
_CLOUDS: Final = ((0.0, 0.0), *product((0.3, 0.6, 0.9), (0.6, 0.8, 0.9, 0.96)))
_NIGHTS: Final = (0.0, 0.3, 1.0, 3.0, 10.0)  # scatter of nights over that of readings
_SIGMAS: Final = 5.0
_WHOLE: Final = 100.0  # scales of a parameter (1 % of the light each): a limit beyond the light itself shows nothing


@dataclass(frozen=True, eq=False)
class LogFit:
    """The outcome for a log."""

    result: ReconcileResult  # in the words of reconcile
    state: LogState  # the fitted model
    start: LogState  # the model without any term
    error_before: float  # root mean square relative error of nights predicted from the others, without any term
    error_after: float  # the same with what was found
    control: str = ""  # verdict of the same search over values that lack nothing


def fit_log(log: LogTable, *, control: bool = True) -> LogFit:
    """Return which term a log lacks, if any.

    Args:
        control: Search values that lack nothing too: made from the fitted model with scatter of the same kind.

    Raises:
        MeasurementError: If the readings do not determine a responsivity.
    """
    begun = time.monotonic()
    start = _start(log)
    state, steps = _search(start)
    silent = ""
    if control:
        reported = _search(_start(_lacking_nothing(state)))[1]
        silent = str(_verdict(reported))
    result = _result(start, state, steps, silent)
    result = replace(result, seconds=time.monotonic() - begun)
    return LogFit(result, state, start, start.night_error, state.night_error, silent)


def _start(log: LogTable) -> LogState:
    level = float(np.mean(np.log(log.value) - _predicted_log(log, (), np.zeros(1))))
    unit = Scatter(1.0, 0.0, 0.0, 0.0)
    state = LogState(log, unit, (), np.array([level]), unit.whiteners(log))
    if not math.isfinite(level):
        raise MeasurementError("the readings do not determine a responsivity: values and references cannot be compared")
    scatter = _scatter(state)
    return replace(state, scatter=scatter, whiteners=scatter.whiteners(log)).fitted()


def _scatter(state: LogState) -> Scatter:
    """Return the scatter about all terms and free curves at once, by restricted maximum likelihood on a grid."""
    log = state.log
    terms = catalogue(log)
    # Signal, reference and exposure depend on one another. If one of the first two is scatter alone, curves along both
    # would explain that scatter; the exposure then varies as the other one does.
    left_out = MEASURED_TOO if any(_is_lost_in_scatter(log, name) for name in MEASURED_TOO) else ()
    terms = tuple(term for term in terms if term.where not in left_out)
    parameters = np.concatenate([state.parameters, *(term.begins for term in terms)])
    columns = _jacobian(log, terms, parameters)
    curves = [_trend(log, name) for name in axes(log) if name not in left_out]
    every = np.column_stack([columns, *curves])
    every = every[:, every.any(axis=0)]
    left, singular, _ = np.linalg.svd(every / np.linalg.norm(every, axis=0), full_matrices=False)
    design = left[:, singular > 1e-6 * singular[0]]  # orthonormal; what a few readings alone determine stays in
    rest = np.log(log.value) - _predicted_log(log, (), state.parameters)
    fits = [_restricted(log, design, rest, n, q) for n, q in product(_CLOUDS, _NIGHTS)]
    best = max(fits, key=lambda found: found[0])
    # A few nights do not tell their scatter well: every value counts by its likelihood, not the likeliest alone.
    chances = np.exp([likelihood - best[0] for likelihood, _ in fits])
    nights = float(chances @ [found.night**2 for _, found in fits] / chances.sum())
    return replace(best[1], night=math.sqrt(max(nights, best[1].night ** 2)))


def _restricted(
    log: LogTable, design: Array, rest: Array, clouds: tuple[float, float], nights: float
) -> tuple[float, Scatter]:
    plain = replace(log, u_reference_rel=None)
    parts = Scatter(1.0, *clouds, nights).whiteners(plain)
    basis = np.concatenate([inverse @ design[rows] for rows, inverse in parts])
    residual = np.concatenate([inverse @ rest[rows] for rows, inverse in parts])
    q, r = np.linalg.qr(basis)
    left = residual - q @ (q.T @ residual)
    freedom = residual.size - basis.shape[1]
    if freedom < 3:
        raise MeasurementError(
            f"{residual.size} readings are too few for the {basis.shape[1]} curves that may be there"
        )
    variance = max(float(left @ left) / freedom, 1e-12)
    log_determinant = -2.0 * sum(float(np.sum(np.log(np.diag(inverse)))) for _, inverse in parts)
    log_determinant += 2.0 * float(np.sum(np.log(np.maximum(np.abs(np.diag(r)), 1e-300))))
    root = math.sqrt(variance)
    return -0.5 * (freedom * math.log(variance) + log_determinant), Scatter(root, *clouds, nights * root)


# ---- the search -----------------------------------------------------------------------------------------------------
def _search(start: LogState) -> tuple[LogState, tuple[FoundEffect, ...]]:
    state, steps = start, list[FoundEffect]()
    every = [term for term in catalogue(start.log) if not _is_lost_in_scatter(start.log, term.where)]
    for _ in (*every, *axes(start.log)):
        following = _one_step(state, every)
        if following is None:
            break
        state, step = following
        steps.append(step)
        state, steps = _pruned(state, steps)
    return state, tuple(steps)


def _one_step(state: LogState, every: Sequence[LogTerm]) -> tuple[LogState, FoundEffect] | None:
    there = {term.name for term in state.terms} | {name for name, _ in state.trends}
    tried: list[tuple[LogTerm | None, str, LogState]] = [
        (term, term.where, state.with_term(term)) for term in every if term.name not in there
    ]
    for name in axes(state.log):
        if name not in there and not _is_lost_in_scatter(state.log, name):
            curved = replace(state, trends=(*state.trends, (name, _trend(state.log, name)))).fitted()
            tried.append((None, name, curved))
    limit = SIGNIFICANCE / max(len(tried), 1)
    shown = [(_score(state, one, term), term, where, one) for term, where, one in tried if _is_shown(state, one, limit)]
    best, plain = (
        max((entry for entry in shown if (entry[1] is None) is is_plain), key=lambda entry: entry[0], default=None)
        for is_plain in (False, True)
    )
    if best is not None and (own := best[1]) is not None and (plain is None or best[0] >= SMOOTH_SHARE * plain[0]):
        score, _, where, one = best
        near = (term.name for s, term, _, _ in shown if term is not None and s > score - RIVAL_NATS)
        return one, _found(state, one, own.name, where, tuple(dict.fromkeys(n for n in near if n != own.name)))
    return None if plain is None else (plain[3], _found(state, plain[3], "unnamed", plain[2]))


def _found(old: LogState, new: LogState, name: str, where: str, rivals: tuple[str, ...] = ()) -> FoundEffect:
    nats = new.evidence - old.evidence
    return FoundEffect(name, {}, where, old.gap, new.gap, rivals, gain_nats=nats, block="mean")


def _ways(old: LogState, new: LogState) -> list[tuple[LogState, LogState]]:
    if new.other_way is new:
        return [(old, new)]
    return [(old, new), (old.other_way, new.other_way)]


def _score(old: LogState, new: LogState, term: LogTerm | None = None) -> float:
    """Return the held-out nats that a model gains, less what its parameters and its flexibility cost."""
    flexible = RIVAL_NATS if term is not None and term.flexible else 0.0
    gained = min(after.evidence - before.evidence for before, after in _ways(old, new))
    return gained - PARAMETER_NATS * (new.free - old.free) - flexible


def _is_shown(old: LogState, new: LogState, limit: float) -> bool:
    ways = _ways(old, new)
    chance = max(chi2_beyond(before.chi2 - after.chi2, new.free - old.free) for before, after in ways)
    if chance >= limit or _score(old, new) + PARAMETER_NATS < NAMED_NATS:
        return False
    known = len(new.terms) == len(old.terms) or _is_determined(new)
    return known and new.night_error <= old.night_error


def _is_determined(state: LogState) -> bool:
    """Return whether the newest term has finite uncertainties and its first parameter (of a table: any) is not zero."""
    term = state.terms[-1]
    found = [(one.value, math.inf if one.u is None else one.u) for one in fitted_parameters(state, term.name).values()]
    essential = found if term.flexible else found[:1]
    return all(math.isfinite(u) for _, u in found) and any(abs(value) > ESSENTIAL_SIGMAS * u for value, u in essential)


def _pruned(state: LogState, steps: list[FoundEffect]) -> tuple[LogState, list[FoundEffect]]:
    at = 1
    for term in state.terms[:-1]:
        others = tuple(t for t in state.terms if t is not term)
        rest = replace(state, terms=others, parameters=np.delete(state.parameters, np.s_[at : at + term.size])).fitted()
        at += term.size
        if _score(rest, state, term) < 0.0:
            return rest, [step for step in steps if step.name != term.name]
    return state, steps


def _lacking_nothing(state: LogState) -> LogTable:
    log, rng = state.log, np.random.default_rng(1)
    values = _predicted_log(log, (), state.parameters[:1])
    for rows, factor in state.scatter.factors(log):
        values[rows] += factor @ rng.standard_normal(rows.size)
    return replace(log, value=np.exp(values))


# ---- in the words of reconcile --------------------------------------------------------------------------------------
def _verdict(steps: Sequence[FoundEffect]) -> Verdict:
    named, unnamed = (any((s.name == "unnamed") is kind for s in steps) for kind in (False, True))
    if named:
        return Verdict.INCOMPLETE if unnamed else Verdict.EFFECTS_FOUND
    return Verdict.UNNAMED if unnamed else Verdict.AGREES


_REMEDIES: Final = {  # what to record so that the terms show that a log cannot show
    SIGNAL: "record some readings at a half and a quarter of the exposure",
    "reference": "record some readings under a half and a quarter of the light",
}


def _result(start: LogState, state: LogState, steps: Sequence[FoundEffect], control: str) -> ReconcileResult:
    log, verdict, scatter = state.log, _verdict(steps), astuple(state.scatter)
    extra: dict[str, Any] = {
        "nights": log.nights,
        "night_error_rel": {"before": start.night_error, "after": state.night_error},
        "scatter": dict(zip(("reading_rel", "clouds_share", "neighbours", "night_rel"), scatter, strict=True)),
        "taken": list(log.taken),
        "negative_control": control or None,
    }
    advice = [
        f"none of {', '.join(term.name for term in catalogue(log) if term.where == name)}: the {name} varies by less "
        f"than its scatter; {remedy}"
        for name, remedy in _REMEDIES.items()
        if _is_lost_in_scatter(log, name)
    ]
    if any(term.where == "gain" for term in state.terms):
        extra["gain_reference_dB"] = _gain_levels(log)[0]
    return ReconcileResult(
        verdict=verdict,
        effects=tuple(
            replace(one, parameters=fitted_parameters(state, one.name), provisional=verdict is Verdict.INCOMPLETE)
            for one in steps
        ),
        gap_before=start.gap,
        gap_after=state.gap,
        limits=_limits(state),
        captures=log.size,
        assumptions=(*log.assumptions, *advice),
        gap_unit=GAP_UNIT,
        repeatability=state.scatter.reading,
        extra=extra,
    )


def fitted_parameters(state: LogState, name: str) -> dict[str, FittedParameter]:
    """Return the parameters of a named term with their standard uncertainties; none for a trend without a name.

    Where the signal may be taken in two ways the value is midway between both. Half their distance, treated as a
    rectangular distribution (GUM 4.3.7), is part of its uncertainty.
    """
    found, at = {}, 0
    ways = (state, state.other_way)
    own = [way.uncertainty() for way in ways]
    for term in state.terms:
        for key, unit in zip(term.parameters, term.units, strict=True):
            if term.name == name:
                one, other = (float(way.parameters[1 + at]) for way in ways)
                u = math.hypot(max(float(u[at]) for u in own), 0.5 * (one - other) / math.sqrt(3.0))
                found[key] = FittedParameter(0.5 * (one + other), u, unit)
            at += 1
    return found


def _limits(state: LogState) -> dict[str, Limit]:
    there = {term.name for term in state.terms}
    found: dict[str, Limit] = {}
    for term in catalogue(state.log):
        if term.flexible or term.name in there:
            continue
        if _is_lost_in_scatter(state.log, term.where):
            found[term.name] = Limit(None, term.parameters[0], term.units[0])
            continue
        more = state.with_term(term)
        ways = {id(way): way for way in (more, more.other_way)}.values()
        u = max(float(way.uncertainty()[-term.size]) for way in ways)
        apart = abs(more.parameters[-term.size] - more.other_way.parameters[-term.size]) / 2.0
        least = _SIGMAS * u + float(apart)
        shown = math.isfinite(least) and least < _WHOLE * term.scales[0]
        found[term.name] = Limit(least if shown else None, term.parameters[0], term.units[0])
    return found

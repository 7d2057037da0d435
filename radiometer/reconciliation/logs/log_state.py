"""A fitted model of a log: how its readings scatter, its terms, and how well nights predict one another."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.importing.log_table import LogTable
from radiometer.reconciliation.fit.held_out import Groups, HeldOut, leave_one_group_out
from radiometer.reconciliation.fit.linear import LinearFit, RowBlock
from radiometer.reconciliation.logs.log_model import MEASURED_TOO, LogTerm, jacobian, predicted_log, trend
from radiometer.typing import Array

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

    def on(self, log: LogTable, trends: tuple[tuple[str, Array], ...]) -> LogState:
        """Return the model fitted to other readings."""
        return replace(self, log=log, whiteners=self.scatter.whiteners(log), trends=trends).fitted()

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
        columns = jacobian(self.log, self.terms, self.parameters, measured=self.measured)
        every = self.whitened(np.column_stack([columns, *(c for _, c in self.trends)]))
        shown = predicted_log(self.log, self.terms, self.parameters, measured=self.measured)
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
        if not np.all(np.isfinite(predicted_log(self.log, self.terms, self.parameters, measured=self.measured))):
            return math.inf
        bare = replace(self.fit, effects=self.fit.effects[:, self.parameters.size - 1 :])
        return float(bare.projected @ bare.projected)

    def fitted(self) -> LogState:
        """Return the state with its parameters at the least χ², by damped Gauss–Newton steps."""
        state = self
        for _ in range(_ITERATIONS):
            moved = state._halved(state._bounded(state.fit.step[: state.parameters.size]))
            gained = state.cost - moved.cost
            state = moved if gained > 0 else state
            if gained < 1e-3:
                break
        return state

    def _bounded(self, step: Array) -> Array:
        """Return a step that moves no term's parameter by more than so many of its scales."""
        scales = np.array([math.inf, *(scale for term in self.terms for scale in term.scales)])
        return np.asarray(np.clip(step, -_FARTHEST * scales, _FARTHEST * scales))

    def _halved(self, step: Array) -> LogState:
        """Return the state after a step, halved until it does not worsen the fit."""
        moved = self
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
            (name, trend(self.log, name, measured=not self.measured) if name in MEASURED_TOO else columns)
            for name, columns in self.trends
        )
        # It begins where nothing is missing: the parameters that one way finds may be impossible in the other.
        begins = np.concatenate([self.parameters[:1], *(term.begins for term in self.terms)])
        return replace(self, measured=not self.measured, trends=trends, parameters=begins).fitted()

    def with_trend(self, name: str, columns: Array) -> LogState:
        """Return the fitted state with a further trend."""
        return replace(self, trends=(*self.trends, (name, columns))).fitted()

    def uncertainty(self) -> Array:
        """Return the standard uncertainties of the terms' parameters, (parameters,)."""
        return np.asarray(np.sqrt(np.diag(self.fit.covariance))[1 : self.parameters.size])

"""Holds the findings of reconcile, in the form of the documented JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from radiometer.data.json_text import finite_or_null, json_text
from radiometer.numbers import unit_text
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.free_law import FreeLaw

_CLEAR_SIGMAS: Final = 5.0  # of the tiles' scatter, from which a first frame is reported to differ
_WEAK_NATS: Final = 10.0
_MOST_STATED: Final = 6  # frames in a sentence
SURE: Final = 0.95  # probability from which a name is almost certain: one in twenty such names may be wrong
_LIKELY: Final = 2.0 / 3.0  # as the word is used in assessments: Mastrandrea et al. (2010), guidance note of the IPCC
_SHOWN: Final = 1e-3  # probabilities are printed with three decimals
GAP_UNIT: Final = "reduced chi-square on held-out frames"


class Verdict(StrEnum):
    """The outcome in one word."""

    AGREES = "agrees"
    EFFECTS_FOUND = "effects_found"
    UNNAMED = "unnamed_effect"
    INCOMPLETE = "incomplete"


@dataclass(frozen=True, slots=True)
class Limit:
    """The smallest amplitude that would have stood out."""

    amplitude: float | None  # in the parameter's unit; None where the data cannot see the effect
    parameter: str  # name of the parameter
    unit: str  # its unit
    # Temperature of the sensor in °C at which it is stated; None where it holds at all
    temperature_c: float | None = None

    def parameter_mapping(self) -> dict[str, Any]:
        """Return what the amplitude is of, as JSON has it."""
        content = {"parameter": self.parameter, "unit": self.unit}
        return content if self.temperature_c is None else content | {"temperature_C": self.temperature_c}


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """A parameter of a found effect: value, standard uncertainty (None where it was not fitted) and unit."""

    value: float
    u: float | None
    unit: str

    def to_mapping(self) -> dict[str, Any]:
        """Return {value, u, unit}."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class LawCurve:
    """By how much an effect does more or less than by its own equation, where the data follow another."""

    # Knots along each covariate, in its unit; of two the second runs faster in `factor`
    along: Mapping[str, tuple[float, ...]]
    factor: tuple[float, ...]  # factor on the effect's own change at the knots, 1 for its own equation
    u: tuple[float | None, ...]  # its standard uncertainty; None where it was not fitted

    @classmethod
    def of(cls, effect: CatalogueEffect, parameters: Mapping[str, FittedParameter]) -> LawCurve | None:
        """Return the curve of an effect from its fitted parameters; None where it follows its own equation."""
        if not isinstance(effect, FreeLaw):
            return None
        fitted = [parameters[name] for name in effect.law_names()]
        along = {axis: effect.knots(axis) for axis in effect.axes}
        return cls(along, tuple(entry.value for entry in fitted), tuple(entry.u for entry in fitted))

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping of the JSON form."""
        along = {axis: list(knots) for axis, knots in self.along.items()}
        return {"along": along, "factor": list(self.factor), "u": list(self.u)}


def _believed(probability: float, *, alone: bool = True) -> str:
    """Return a probability with three decimals, and in a word; next to names that explain as much none is certain."""
    limited = "below 0.001" if probability < _SHOWN else "above 0.999" if probability > 1.0 - _SHOWN else ""
    word = "almost certain" if alone and probability >= SURE else "likely" if probability >= _LIKELY else "possible"
    return f"probability {limited or f'{probability:.3f}'}, {word}"


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """One effect (or unnamed disagreement) that was found."""

    name: str  # catalogue name, or `unnamed`
    parameters: Mapping[str, FittedParameter]  # its parameters by name
    where: str  # covariate along which it was found
    gap_before: float  # held-out gap before it was added
    gap_after: float  # the same after
    alternatives: tuple[str, ...] = ()  # catalogue names that these data cannot separate from it
    next_capture: Mapping[str, Any] | None = None  # the capture that would separate them; None where nothing rivals it
    gain_nats: float = 0.0  # improvement of the held-out log density
    block: str = ""  # statistic that shows it
    provisional: bool = False  # whether structure stays, so that the name may still change
    closest: tuple[str, float] | None = None  # for an unnamed one, the closest entry and the share that it explains
    # For an unnamed one, where else structure stays: covariate and statistic
    elsewhere: tuple[tuple[str, str], ...] = ()
    # For a named one that the data follow by another equation than the catalogue's: how large the rest is
    other_law: Mapping[str, FittedParameter] | None = None
    curve: LawCurve | None = None  # that other law as a factor on the catalogue's, where it was fitted
    # Posterior probability that the effect is present; None where no models were compared
    probability: float | None = None
    probability_of_any: float | None = None  # posterior probability that it or one of its alternatives is present
    # Its parameters averaged over the models that hold it, the choice among them in each u
    averaged: Mapping[str, FittedParameter] = field(default_factory=dict)

    @property
    def is_weak(self) -> bool:
        """Return whether it improves the prediction by so little that the captures had better be repeated."""
        return self.gain_nats < _WEAK_NATS

    @property
    def evidence(self) -> str:
        """Return in words how certain it is: its probability, or the nats where no models were compared."""
        alone = not self.alternatives
        return f"{self.gain_nats:.0f} nats" if self.probability is None else _believed(self.probability, alone=alone)

    @property
    def evidence_of_any(self) -> str:
        """Return the same of it and its alternatives together; nothing where no models were compared."""
        return "" if self.probability_of_any is None else f"one of them: {_believed(self.probability_of_any)}"

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping of the documented JSON form."""
        closest = {"name": self.closest[0], "share": self.closest[1]} if self.closest else None
        elsewhere = [{"where": where, "statistic": block} for where, block in self.elsewhere]
        return {
            "name": self.name,
            "parameters": {name: entry.to_mapping() for name, entry in self.parameters.items()},
            "where": self.where,
            "gap_before": self.gap_before,
            "gap_after": self.gap_after,
            "alternatives": list(self.alternatives),
            "next_capture": dict(self.next_capture) if self.next_capture else None,
            "statistic": self.block,
            "gain_nats": self.gain_nats,
            "strength": "weak" if self.is_weak else "clear",
            "provisional": self.provisional,
            "probability": self.probability,
            "probability_of_any": self.probability_of_any,
            "averaged": {name: entry.to_mapping() for name, entry in self.averaged.items()},
        } | ({"closest": closest, "elsewhere": elsewhere} if self.name == "unnamed" else self._law())

    def _law(self) -> dict[str, Any]:
        if self.other_law is None and self.curve is None:
            return {"law": "the catalogue's"}
        left = {name: entry.to_mapping() for name, entry in (self.other_law or {}).items()}
        curve = self.curve.to_mapping() if self.curve else None
        return {"law": "other than the catalogue's", "left_by_the_law": left, "curve": curve}


@dataclass(frozen=True, slots=True)
class CovariateGap:
    """Disagreement along one covariate: the largest trend's χ² per degree of freedom.

    A single trend has 1 by chance, the largest of many tests more.
    """

    before: float
    after: float


@dataclass(frozen=True, slots=True)
class Place:
    """A place where the starting model disagrees, found without the catalogue: one test, the places before it taken
    out.
    """

    block: str  # statistic
    covariate: str  # axis
    form: str  # in proportion to the light, as a constant in DN, or as a constant in electrons
    score: float  # χ² of the trend
    p_value: float  # chance of that much without a disagreement

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping of the JSON form."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Series:
    """Frames of one capture against each other."""

    frames: tuple[int, ...]  # their positions in the header, in order
    exposure_s: float  # exposure in s
    temperature_c: float | None  # temperature of the sensor in °C; None where unknown
    apart: tuple[float, ...]  # each frame less the mean of the others: its median over the tiles
    u: tuple[float, ...]  # its standard uncertainty from the scatter of the tiles
    # Positions in the series of frames that are farther off than all other repeats scatter
    standing_out: tuple[int, ...] = ()

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping of the JSON form."""
        content = {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items()}
        content["temperature_C"] = content.pop("temperature_c")
        return content | {"standing_out": [self.frames[position] for position in self.standing_out]}


@dataclass(frozen=True, slots=True)
class Repeats:
    """Differences between frames of one setting, and the part of them that is treated as an unnamed wander."""

    kind: str  # `dark` (black level and dark current, in DN) or `lit` (light, relative)
    scatter: FittedParameter  # standard deviation of frames of a series beyond what their tiles give by chance, with u
    aside: float  # standard deviation of the wander that the fit allows for; 0 where none is needed
    series: tuple[Series, ...]  # the series

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping of the JSON form."""
        return {
            "scatter": self.scatter.to_mapping(),
            "fitted_aside": self.aside,
            "series": [one.to_mapping() for one in self.series],
            "said": list(self.sentences()),
        }

    def sentences(self) -> tuple[str, ...]:
        """Return in words where differences between equal frames come from."""
        frames = sum(len(one.frames) for one in self.series)
        what = "black level or dark charge" if self.kind == "dark" else "light"
        aside = f"; {self._shown(self.aside)} are treated as a wander and fitted as a nuisance" if self.aside else ""
        first = (
            f"{frames} {self.kind} frames in {len(self.series)} series of one setting: their {what} differs by "
            f"{self._shown(self.scatter.value, self.scatter.u)} (standard deviation) from frame to frame{aside}"
        )
        begins = [one for one in self.series if len(one.frames) > 2 and abs(one.apart[0]) > _CLEAR_SIGMAS * one.u[0]]
        begins = sorted(begins, key=lambda one: -abs(one.apart[0]))[:_MOST_STATED]
        text = [first] if self.scatter.u is not None and self.scatter.value > 2.0 * self.scatter.u else []
        warm = ["" if one.temperature_c is None else f", {one.temperature_c:.1f} °C" for one in begins]
        listed = [
            f"{self._shown(one.apart[0], one.u[0])} ({one.exposure_s:.3g} s{at})"
            for one, at in zip(begins, warm, strict=True)
        ]
        text += [f"first frame of a series less the others: {', '.join(listed)}"] if begins else []
        out = [(one, at) for one in self.series for at in one.standing_out]
        if out:
            outliers = (
                f"frame {one.frames[at]} ({self._shown(one.apart[at], one.u[at])})" for one, at in out[:_MOST_STATED]
            )
            text.append(f"outside the scatter of the others: {', '.join(outliers)}")
        return tuple(text)

    def _shown(self, value: float, u: float | None = None) -> str:
        size, unit = (100.0, " %") if self.scatter.unit == "1" else (1.0, f" {unit_text(self.scatter.unit)}")
        return f"{size * value:.2g}{unit}" if u is None else f"({size * value:.2f} ± {size * u:.2g}){unit}"


class ByHand:
    """What is reconciled and is measured by hand: the result says what to take again."""

    __slots__ = ()

    def write_plan(self, path: Path) -> bool:
        """Write nothing: there are no captures to plan."""
        return False


_SENTENCES: Final = {
    Verdict.AGREES: "Nothing is missing: simulation and measurement agree.",
    Verdict.EFFECTS_FOUND: "The missing effect was found; with it simulation and measurement agree.",
    Verdict.UNNAMED: "Simulation and measurement disagree, and no known effect explains it.",
    Verdict.INCOMPLETE: "The answer is not complete, so every name is provisional.",
}


@dataclass(frozen=True, slots=True)
class ReconcileResult:
    """The outcome of one capture set."""

    verdict: Verdict  # in one word
    effects: tuple[FoundEffect, ...]  # what was found, in the order of finding
    gap_before: float  # held-out gap of the starting model
    gap_after: float  # held-out gap of the final model
    # Per catalogue entry the amplitude that would have shown at 5 sigma
    limits: Mapping[str, Limit] = field(default_factory=dict)
    covariates: Mapping[str, CovariateGap] = field(default_factory=dict)  # gap along each covariate
    tests: tuple[int, int] = (0, 0)  # number of tests, and how many are significant in the end
    repeatability: float | None = None  # capture-to-capture repeatability, relative
    assumptions: tuple[str, ...] = ()  # what was assumed
    captures: int = 0  # number of captures
    frames: int = 0  # number of frames
    model: str | None = None  # name of the model file written; None where none was asked for
    report: str | None = None  # name of the report written
    seconds: float = 0.0  # time that it took
    gap_unit: str = GAP_UNIT  # unit of the gaps
    # Where the starting model disagrees: each covariate once, each in addition to the places before it
    localisation: tuple[Place, ...] = ()
    calls: tuple[int, int] = (0, 0)  # tests of the starting model with p < 0.01, and tests in all
    # Chance that any of all tests is as significant without a disagreement, at the start and in the end
    global_p: tuple[float, float] | None = None
    added: tuple[CatalogueEffect, ...] = ()  # the effects that the final model adds to the ideal chain
    # Where no rivals need to be separated: the capture that would show what these data cannot
    next_capture: Mapping[str, Any] | None = None
    repeats: tuple[Repeats, ...] = ()  # what frames of one setting differ by
    # Sets of names with their posterior probabilities, the most probable first
    models: tuple[tuple[tuple[str, ...], float], ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)  # further entries of the JSON object

    @property
    def sentence(self) -> str:
        """Return the verdict in a sentence, as terminal and report begin."""
        if self.verdict is Verdict.EFFECTS_FOUND and any(effect.alternatives for effect in self.effects):
            return (
                "An effect is missing that has more than one name; with any of them simulation and measurement agree."
            )
        if self.verdict is Verdict.EFFECTS_FOUND and sum(one.name != "unnamed" for one in self.effects) > 1:
            return "The missing effects were found; with them simulation and measurement agree."
        return _SENTENCES[self.verdict]

    def written(self, model: str | None, report: str | None) -> ReconcileResult:
        """Return the result with the names of the files that were written."""
        return replace(self, model=model, report=report)

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping of the documented JSON form; what is not finite becomes null."""
        mapping = {
            "verdict": str(self.verdict),
            "effects": [effect.to_mapping() for effect in self.effects],
            "gap": {
                "before": self.gap_before,
                "after": self.gap_after,
                "unit": self.gap_unit,
                "by_covariate": {name: asdict(gap) for name, gap in self.covariates.items()},
            },
            "limits": {name: limit.amplitude for name, limit in self.limits.items()},
            "limit_parameters": {name: limit.parameter_mapping() for name, limit in self.limits.items()},
            "tests": {"number": self.tests[0], "significant": self.tests[1]},
            "localisation": [place.to_mapping() for place in self.localisation],
            "null_tests": list(self.calls),
            "global_p": {"before": self.global_p[0], "after": self.global_p[1]} if self.global_p else None,
            "repeatability_rel": self.repeatability,
            "repeats": {one.kind: one.to_mapping() for one in self.repeats},
            "captures": self.captures,
            "frames": self.frames,
            "models": [{"names": list(names), "weight": weight} for names, weight in self.models],
            "next_capture": dict(self.next_capture) if self.next_capture else None,
            "assumptions": list(self.assumptions),
            "model": self.model,
            "report": self.report,
            "seconds": round(self.seconds, 3),
        } | dict(self.extra)
        return {key: finite_or_null(value) for key, value in mapping.items()}

    def to_json(self) -> str:
        """Return the result as one line of JSON."""
        return json_text(self.to_mapping())

"""A proposed law as data: a link of the chain, terms of the grammar, and the facts of an effect that follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from radiometer.reconciliation.propose.grammar import (
    COVARIATES,
    FORMS,
    OF_THE_PICTURE,
    PER_FRAME,
    PLACES,
    WHERE,
    Term,
)
from simulators.chain.law_stages import LINKS

_AMPLITUDES: Final = {
    "1": "amplitude",
    "s": "amplitude_s",
    "e-": "amplitude_e",
    "e- s-1": "amplitude_e_per_s",
    "DN": "amplitude_dn",
    "W m-2": "amplitude_w_m2",
}
_NEEDS: Final = {
    "f_number": "settings.f_number",
    "temperature_C": "settings.temperature_c",
    "since_frame_s": "since_frame_s",
}
_NEAR_NOTHING: Final = 0.05
_WIDEST: Final = 1e3  # times a fitted value: the range of an amplitude
_NEAR: Final = 0.06  # of the picture's longer side, by which the place of a step moves from where it was tried
_OUTSIDE: Final = 3.0  # ranges of a covariate by which a place or a time may be outside it


@dataclass(frozen=True, slots=True)
class Law:
    """A link of the chain and one or two terms that are multiplied."""

    link: str  # key of the link
    terms: tuple[Term, ...] = ()  # the terms; none for a constant

    @property
    def amplitude(self) -> str:
        """Return the amplitude's name."""
        return _AMPLITUDES[LINKS[self.link].unit]

    @property
    def covariates(self) -> tuple[str, ...]:
        """Return the covariates that its terms depend on, each once."""
        own = [name for term in self.terms for name in term.covariates]
        return tuple(dict.fromkeys(own))

    @property
    def shown(self) -> str:
        """Return the moment of a pixel that it changes."""
        return "variance" if LINKS[self.link].is_noise else "mean"

    @property
    def where(self) -> str:
        """Return the covariate that it is listed under."""
        first = next(iter((*self.covariates, *LINKS[self.link].goes_with)), "signal")
        return WHERE.get(first, first)

    @property
    def name(self) -> str:
        """Return the effect's name, from stage, forms and covariates."""
        parts = [f"{term.form}_of_{COVARIATES[term.covariate].tag}" for term in self.terms] or ["constant"]
        return "_".join([self.link, *parts]).replace("spot_of_x", "spot")

    @property
    def class_name(self) -> str:
        """Return the name of the effect's class."""
        return "".join(part.capitalize() for part in self.name.split("_"))

    @property
    def fitted(self) -> tuple[str, ...]:
        """Return the parameters that a fit moves, the amplitude first."""
        fixed = {term.parameter(role) for term in self.terms for role in FORMS[term.form].fixed}
        return (self.amplitude, *(name for name in self.parameters if name not in fixed))

    @property
    def is_per_frame(self) -> bool:
        """Return whether the first frame of a series differs from the others."""
        return any(name in PER_FRAME for name in self.covariates)

    @property
    def is_of_the_series(self) -> bool:
        """Return whether the formula is of all frames of a series: then it is not averaged over them again."""
        return "frame" in self.covariates

    @property
    def needs(self) -> tuple[str, ...]:
        """Return the facts of the context, as paths, that the data must state."""
        known = dict.fromkeys((*self.covariates, *LINKS[self.link].goes_with))
        return tuple(_NEEDS[name] for name in known if name in _NEEDS)

    @property
    def parameters(self) -> dict[str, float]:
        """Return the parameters of the terms by name."""
        return {term.parameter(role): value for term in self.terms for role, value in term.values.items()}

    @property
    def size(self) -> int:
        """Return the number of parameters, the amplitude among them."""
        return 1 + len(self.parameters)

    @property
    def is_steep(self) -> bool:
        """Return whether it changes within a tile as no quadratic surface does."""
        return any(FORMS[term.form].is_steep and set(term.covariates) & set(PLACES) for term in self.terms)

    @property
    def signal_power(self) -> int | None:
        """Return the power of the signal that its change scales with; None where the formula holds the signal."""
        if set(self.covariates) & {"signal", "value", *OF_THE_PICTURE}:
            return None
        return 0 if LINKS[self.link].adds else 1

    @property
    def is_sudden(self) -> bool:
        """Return whether it jumps along the signal."""
        return any(term.form == "step" and term.covariate in ("signal", "value") for term in self.terms)

    def formula(self) -> str:
        """Return the amplitude times the terms as the file has it."""
        return " * ".join([f"self.{self.amplitude}", *(_in_brackets(term) for term in self.terms)])

    def with_parameters(self, values: Mapping[str, float]) -> Law:
        """Return the law at other parameters, by their names in the effect."""
        moved = [
            Term(t.form, t.covariate, t.constants, {role: float(values[t.parameter(role)]) for role in t.values})
            for t in self.terms
        ]
        return Law(self.link, tuple(moved))


def _in_brackets(term: Term) -> str:
    code = term.code()
    return f"({code})" if code.startswith("1.0 /") else code


class Declared(NamedTuple):
    """A parameter as an effect declares it: name, unit, default and range."""

    name: str
    unit: str
    default: float
    low: float
    high: float


def declared(law: Law, amplitude: float) -> tuple[Declared, ...]:
    """Return the parameters that the effect of a law declares, the amplitude first, with ranges about their values."""
    wide = round_to(_WIDEST * max(abs(amplitude), 1e-12))
    own = Declared(law.amplitude, LINKS[law.link].unit, 0.0, -wide, wide)
    return (own, *(_declared(term, role) for term in law.terms for role in term.values))


def _declared(term: Term, role: str) -> Declared:
    value = round_to(term.values[role])
    near = role == "at" and term.covariate in PLACES  # elsewhere others were tried; far off it steps nowhere at all
    low, high = (round_to(value - _NEAR), round_to(value + _NEAR)) if near else _bounds(role, value)
    return Declared(term.parameter(role), term.unit(role), value, low, high)


def _bounds(role: str, value: float) -> tuple[float, float]:
    if role in ("tau", "period", "width", "knee"):
        return round_to(value / 100.0), round_to(value * 100.0)
    if role == "power":
        return -6.0, 6.0
    if role == "steepness":
        return 0.1, 60.0
    if role in ("phase", "advance"):
        return -30.0, 30.0
    wide = _OUTSIDE * max(abs(value), 1.0)
    return round_to(value - wide), round_to(value + wide)


def trials(law: Law, amplitude: float) -> tuple[dict[str, float], dict[str, float]]:
    """Return the parameters from which a search starts: at an amplitude and at its negative."""
    return _trial(law, amplitude, 0.0), _trial(law, -amplitude, _NEAR_NOTHING)


def _trial(law: Law, amplitude: float, nearest: float) -> dict[str, float]:
    """Return one start; a spot's place is not nearer to 0 than a figure: fits step by trials."""
    places = {name for name in law.parameters if name in ("at_x", "at_y")}
    own = {n: nearest if n in places and abs(v) < nearest else v for n, v in law.parameters.items()}
    return {law.amplitude: round_to(amplitude)} | {name: round_to(value) for name, value in own.items()}


def round_to(value: float, digits: int = 6) -> float:
    """Return a value in so many digits; below 1e-12 it is 0."""
    return float(f"{value:.{digits}g}") if abs(value) > 1e-12 else 0.0

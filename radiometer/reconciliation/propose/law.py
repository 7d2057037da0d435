"""A proposed law as data: a link of the chain, terms of the grammar, and the facts of an effect that follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, make_dataclass
from functools import lru_cache
from operator import attrgetter
from typing import Any, ClassVar, Final, cast

import numpy as np

from radiometer.data import CameraDescription, FrameSettings
from radiometer.reconciliation.propose.grammar import (
    COVARIATES,
    FORMS,
    OF_THE_PICTURE,
    PER_FRAME,
    PLACES,
    WHERE,
    Term,
    formula,
)
from simulators.chain.stages import LINKS, Link
from simulators.effects import base
from simulators.effects.base import Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, over_frames
from simulators.effects.context import ExposureContext, FrameGeometry

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
    def is_of_the_series(self) -> bool:
        """Return whether the formula is of all frames of a series: then it is not averaged over them again."""
        return "frame" in self.covariates

    @property
    def parameters(self) -> dict[str, float]:
        """Return the parameters of the terms by name."""
        return {term.parameter(role): value for term in self.terms for role, value in term.values.items()}

    @property
    def size(self) -> int:
        """Return the number of parameters, the amplitude among them."""
        return 1 + len(self.parameters)

    def formula(self) -> str:
        """Return the amplitude times the terms, for people."""
        return " * ".join([self.amplitude, *(term.text() for term in self.terms)])

    def with_parameters(self, values: Mapping[str, float]) -> Law:
        """Return the law at other parameters, by their names in the effect."""
        moved = [
            Term(t.form, t.covariate, t.constants, {role: float(values[t.parameter(role)]) for role in t.values})
            for t in self.terms
        ]
        return Law(self.link, tuple(moved))


def _fields(law: Law, amplitude: float) -> list[tuple[str, type[float], Any]]:
    wide = round_to(_WIDEST * max(abs(amplitude), 1e-12))
    found = [(law.amplitude, LINKS[law.link].unit, 0.0, -wide, wide)]
    for term, role in [(one, role) for one in law.terms for role in one.values]:
        value = round_to(term.values[role])
        near = role == "at" and term.covariate in PLACES  # elsewhere others were tried; far off it steps nowhere at all
        low, high = (round_to(value - _NEAR), round_to(value + _NEAR)) if near else _bounds(role, value)
        found.append((term.parameter(role), term.unit(role), value, low, high))
    return [(n, float, parameter(value, unit, *ends, source="fitted")) for n, unit, value, *ends in found]


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


def _trial(law: Law, amplitude: float, nearest: float = 0.0) -> dict[str, float]:
    """Return one start; a spot's place is not nearer to 0 than a figure: fits step by trials."""
    places = {name for name in law.parameters if name in ("at_x", "at_y")}
    own = {n: nearest if n in places and abs(v) < nearest else v for n, v in law.parameters.items()}
    return {law.amplitude: round_to(amplitude)} | {name: round_to(value) for name, value in own.items()}


def round_to(value: float, digits: int = 6) -> float:
    """Return a value in so many digits; below 1e-12 it is 0."""
    return float(f"{value:.{digits}g}") if abs(value) > 1e-12 else 0.0


_CLASSES: Final = 512  # laws whose classes are kept: more than one search fits


class LawEffect(CatalogueEffect):
    """What all laws share: the amplitude times the terms."""

    of_law: ClassVar[Law]  # the law; its parameters' values are the effect's own
    link: ClassVar[Link]  # the link of the chain at which it acts
    settles = "another session that goes beyond the ranges of the first"

    def law(self, signal: Any, context: ExposureContext) -> Any:
        """Return the amplitude times the formula, in the link's unit."""
        values = {COVARIATES[name].tag: COVARIATES[name].value(signal, context) for name in self.of_law.covariates}
        found = getattr(self, self.of_law.amplitude)
        for term in self.of_law.terms:
            found = found * term.value(values, {role: getattr(self, term.parameter(role)) for role in term.values})
        return found

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether the data state what the law depends on."""
        needed = {*cls.of_law.covariates, *cls.link.goes_with} & _NEEDS.keys()
        return all(attrgetter(_NEEDS[name])(context) is not None for name in needed)

    def _at_its_link(self, code: str, law: Any, signal: Any, context: ExposureContext) -> Any:
        return formula(code.format(law="law"))({"law": law, "signal": signal, "context": context})


class SignalLaw(LawEffect):
    """A law of the light, the charge or the signal."""

    def mean(self, signal: Any, context: ExposureContext) -> Any:
        """Return the signal with the law."""
        return self._at_its_link(self.link.code, self.law(signal, context), signal, context).astype(signal.dtype)


class FrameLaw(SignalLaw):
    """A law by which the frames of a series differ."""

    def mean(self, signal: Any, context: ExposureContext) -> Any:
        """Return the signal with the mean of the law over the frames."""
        if self.of_law.is_of_the_series:
            return super().mean(signal, context)
        law = over_frames(lambda frame: self.law(signal, frame), context)
        return self._at_its_link(self.link.code, law, signal, context).astype(signal.dtype)

    def ordered_variance(self, signal: Any, context: ExposureContext) -> Any:
        """Return how the frames of a series behind its first differ, as a variance.

        What depends on the time goes on among the others, evenly where they follow each other evenly. What depends on
        the rest before a frame is the same for all of them. Of laws by the frame's number some have it and others not.
        """
        if context.first_frame is None or context.later_frames is None:
            return 0.0
        frames = np.asarray(getattr(context, "frames", 1.0))
        if self.of_law.is_of_the_series:
            counted, law = np.maximum(frames - 1.0, 0.0), self.law(signal, context.later_frames)
            amplitude = getattr(self, self.of_law.amplitude)
            spread = law * (amplitude - law) * counted / np.maximum(counted - 1.0, 1.0)
            return spread if self.link.adds else spread * np.square(signal)
        goes_on = "timestamp_s" in self.of_law.covariates
        share = np.where(frames > 2.0, np.maximum(frames - 1.0, 0.0) / (3.0 * frames), 0.0) if goes_on else 0.0
        apart = self.law(signal, context.first_frame) - self.law(signal, context.later_frames)
        return share * np.square(self._at_its_link(self.link.change, apart, signal, context))

    @property
    def drifts(self) -> bool:
        """Return that the first frame of a series differs."""
        return True


class NoiseLaw(LawEffect):
    """A law that is the standard deviation of a noise."""

    def mean(self, signal: Any, context: ExposureContext) -> Any:
        """Return the signal as it is."""
        return signal

    def slope(self, signal: Any, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def variance(self, signal: Any, context: ExposureContext) -> Any:
        """Return the variance that it adds, in DN²."""
        return np.square(self._at_its_link(self.link.code, self.law(signal, context), signal, context))

    def sample(self, signal: Any, context: ExposureContext, rng: np.random.Generator) -> Any:
        """Return the signal with the noise on it."""
        noise = np.sqrt(self.variance(signal, context)) * rng.standard_normal(signal.shape)
        return (signal + noise).astype(signal.dtype)


def effect_class(law: Law, amplitude: float) -> type[LawEffect]:
    """Return the class of a law; laws that differ in values alone may have separate ones."""
    terms = tuple((t.form, t.covariate, tuple(t.constants.items()), tuple(t.values.items())) for t in law.terms)
    return _class_of(law.link, terms, amplitude)


@lru_cache(maxsize=_CLASSES)
def _class_of(key: str, terms: tuple[tuple[str, str, Any, Any], ...], amplitude: float) -> type[LawEffect]:
    law = Law(key, tuple(Term(form, where, dict(constants), dict(values)) for form, where, constants, values in terms))
    link = LINKS[key]
    along = set(law.covariates)
    kind = NoiseLaw if link.is_noise else FrameLaw if along & set(PER_FRAME) else SignalLaw
    is_steep = any(FORMS[term.form].is_steep and set(term.covariates) & set(PLACES) for term in law.terms)
    scales = is_steep and not along & {"signal", "value", *OF_THE_PICTURE}  # by a power of the signal alone
    unit = getattr(base, link.unit_signal)
    facts = {
        "of_law": law,
        "link": link,
        "name": law.name,
        "stage": Stage[link.member],
        "unit_in": unit,
        "unit_out": unit,
        "before": link.before or None,
        "where": law.where,
        "block": "variance" if link.is_noise else "mean",
        "also": () if link.is_noise else ("slope", "first"),
        "acts_by_square": link.is_noise,
        "is_steep": is_steep,  # it changes within a tile as no quadratic surface does
        "signal_power": int(not link.adds) if scales else None,
        "is_sudden": any(term.form == "step" and term.covariate in ("signal", "value") for term in law.terms),
        "trials": (_trial(law, amplitude), _trial(law, -amplitude, _NEAR_NOTHING)),
        "fitted": law.fitted,
    }
    fields = _fields(law, amplitude)
    return cast(type[LawEffect], make_dataclass(law.class_name, fields, bases=(kind,), frozen=True, namespace=facts))


def effect_of(law: Law, amplitude: float) -> LawEffect:
    """Return the effect of a law at its parameters."""
    return effect_class(law, amplitude)(
        **{law.amplitude: amplitude} | {name: round_to(value) for name, value in law.parameters.items()}
    )


def acted(law: Law, amplitude: float, signal: float, context: ExposureContext) -> float:
    """Return what a written test expects at a pixel: the signal behind the law, or the variance that a noise adds."""
    found = getattr(effect_of(law, amplitude), law.shown)(np.array([signal]), context)
    return float(np.ravel(found)[0])


def context_at(column: float, row: float, shape: tuple[int, int], settings: Mapping[str, Any]) -> ExposureContext:
    """Return the circumstances of one pixel of a sensor of this height and width, a second after the frame before."""
    geometry = FrameGeometry(np.array([column]), np.array([row]), shape[1], shape[0])
    camera = CameraDescription(bit_depth=16)
    return ExposureContext(FrameSettings(**settings), geometry, camera, since_frame_s=1.0)

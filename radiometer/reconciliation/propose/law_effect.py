"""A law as an effect of the forward model: it evaluates the law's formula, and no code is written for it."""

from __future__ import annotations

from dataclasses import make_dataclass
from functools import lru_cache
from operator import attrgetter
from typing import Any, ClassVar, Final, cast

import numpy as np

from radiometer.reconciliation.propose.grammar import COVARIATES, Term, formula
from radiometer.reconciliation.propose.law import Law, declared, round_to, trials
from simulators.chain.law_stages import LINKS, Link
from simulators.effects import base, surroundings
from simulators.effects.base import Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, elapsed_s, over_frames
from simulators.effects.context import ExposureContext

_CLASSES: Final = 512  # laws whose classes are kept: more than one search fits
_LOOKED_UP: Final = {
    "elapsed_s": elapsed_s,
    "picture_mean": surroundings.picture_mean,
    "column_light": surroundings.column_light,
}


class LawEffect(CatalogueEffect):
    """What all laws share: the amplitude times the terms.

    Class attributes:
        of_law: The law; its parameters' values are the effect's own.
        link: The link of the chain at which it acts.
    """

    of_law: ClassVar[Law]
    link: ClassVar[Link]
    settles = "another session that goes beyond the ranges of the first"

    def law(self, signal: Any, context: ExposureContext) -> Any:
        """Return the amplitude times the formula, in the link's unit."""
        known = {"signal": signal, "context": context, **_LOOKED_UP}
        known["side"] = max(context.geometry.sensor_width, context.geometry.sensor_height)
        values = {COVARIATES[name].tag: formula(COVARIATES[name].code)(known) for name in self.of_law.covariates}
        found = getattr(self, self.of_law.amplitude)
        for term in self.of_law.terms:
            found = found * term.value(values, {role: getattr(self, term.parameter(role)) for role in term.values})
        return found

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether the data state what the law depends on."""
        return all(attrgetter(path)(context) is not None for path in cls.of_law.needs)

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

    def common_variance(self, signal: Any, context: ExposureContext) -> Any:
        """Return how the frames of a series differ, as a variance; of three and more all but the first.

        What depends on the time goes on among the others, evenly where they follow each other evenly. What depends on
        the rest before a frame is the same for all of them. Of laws by the frame's number some have it and others not.
        """
        if context.first_frame is None or context.later_frames is None:
            return 0.0
        frames = np.asarray(getattr(context, "frames", 1.0))
        if self.of_law.is_of_the_series:
            few, many = self.law(signal, context), self.law(signal, context.later_frames)
            counted, law = frames - (frames > 2.0), np.where(frames > 2.0, many, few)
            amplitude = getattr(self, self.of_law.amplitude)
            spread = law * (amplitude - law) * counted / np.maximum(counted - 1.0, 1.0)
            return spread if self.link.adds else spread * np.square(signal)
        goes_on = "timestamp_s" in self.of_law.covariates
        others = np.maximum(frames - 1.0, 0.0) / (3.0 * frames) if goes_on else 0.0
        share = np.where(frames == 2.0, 0.5, others)
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
    kind = NoiseLaw if link.is_noise else FrameLaw if law.is_per_frame else SignalLaw
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
        "is_steep": law.is_steep,
        "signal_power": law.signal_power if law.is_steep else None,
        "is_sudden": law.is_sudden,
        "trials": trials(law, amplitude),
        "fitted": law.fitted,
    }
    fields = [
        (one.name, float, parameter(one.default, one.unit, one.low, one.high, source="fitted"))
        for one in declared(law, amplitude)
    ]
    made = make_dataclass(law.class_name, fields, bases=(kind,), frozen=True, namespace=facts)
    return cast(type[LawEffect], made)


def effect_of(law: Law, amplitude: float) -> LawEffect:
    """Return the effect of a law at its parameters."""
    return effect_class(law, amplitude)(
        **{law.amplitude: amplitude} | {name: round_to(value) for name, value in law.parameters.items()}
    )


def acted(law: Law, amplitude: float, signal: float, context: ExposureContext) -> float:
    """Return what a written test expects at a pixel: the signal behind the law, or the variance that a noise adds."""
    found = getattr(effect_of(law, amplitude), law.shown)(np.array([signal]), context)
    return float(np.ravel(found)[0])

"""The small grammar of laws: covariates with their units, and the forms that physicists write of them.

A form is a line of NumPy that goes into the effect file as it stands, with the parameters that it needs in addition
to the amplitude. Each constant carries a unit: that of the covariate for places, times and periods, none for
exponents and phases; the amplitude's unit is that of the stage.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from typing import Any, Final

import numpy as np

from radiometer.typing import Array
from simulators.effects.catalogue import elapsed_s
from simulators.effects.context import ExposureContext
from simulators.effects.surroundings import column_light, picture_mean

Formula = Callable[[Mapping[str, Any]], Any]

_OPERATORS: Final[dict[type[ast.AST], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.BitOr: operator.or_,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
}
_OF_NUMPY: Final = ("asarray", "exp", "isclose", "log", "maximum", "mod", "sin", "square", "sum", "tanh")
_NUMPY: Final = {name: getattr(np, name) for name in _OF_NUMPY} | {"pi": np.pi, "inf": np.inf}


@cache
def formula(text: str) -> Formula:
    """Return the function of named values that a formula states.

    Args:
        text: An expression of names, numbers, attributes, the operators above and the functions of NumPy above.

    Raises:
        ValueError: If it holds anything else.
    """
    return _of(ast.parse(text, mode="eval").body)


def _of(node: ast.AST) -> Formula:
    match node:
        case ast.Constant(value=value):
            return lambda known: value
        case ast.Name(id=name):
            return lambda known: known[name]
        case ast.Attribute(value=ast.Name(id="np"), attr=name) if name in _NUMPY:
            figure = _NUMPY[name]
            return lambda known: figure
        case ast.Attribute(value=holder, attr=name) if not name.startswith("_"):
            held = _of(holder)
            return lambda known: getattr(held(known), name)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            value_of = _of(inner)
            return lambda known: -value_of(known)
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _OPERATORS:
            return _joined(_OPERATORS[type(sign)], left, right)
        case ast.Compare(left=left, ops=[sign], comparators=[right]) if type(sign) in _OPERATORS:
            return _joined(_OPERATORS[type(sign)], left, right)
        case ast.Call(func=function, args=arguments, keywords=keywords):
            return _called(function, arguments, keywords)
    raise ValueError(f"a formula cannot hold {ast.unparse(node)!r}")


def _joined(join: Callable[[Any, Any], Any], left: ast.AST, right: ast.AST) -> Formula:
    one, other = _of(left), _of(right)
    return lambda known: join(one(known), other(known))


def _called(function: ast.AST, arguments: list[ast.expr], keywords: list[ast.keyword]) -> Formula:
    what, given = _of(function), [_of(argument) for argument in arguments]
    named = {entry.arg: _of(entry.value) for entry in keywords if entry.arg}
    return lambda known: what(known)(*(one(known) for one in given), **{k: one(known) for k, one in named.items()})


_STEPS: Final = 24  # places of a step that are tried
_BORDERS: Final = 48  # of a border in the picture
_FINER: Final = 12  # further places about a good one
_PERIODS: Final = 14
_FEW: Final = range(3, 10)  # values of a setting of which some may be picked
_FRAMES: Final = range(2, 13)  # from one frame to the next of its kind


@dataclass(frozen=True, slots=True)
class Covariate:
    """A variable on which a disagreement may depend."""

    name: str  # its name in results
    tag: str  # what its parameters are called by
    unit: str  # its unit; "1" for a pure number
    value: Callable[[Any, ExposureContext], Any]  # gives it for a signal and a context
    words: str  # what people call it
    forms: tuple[str, ...]  # names of the forms that are tried along it

    @property
    def suffix(self) -> str:
        """Return the suffix of a parameter in its unit."""
        return {"1": "", "°C": "_c", "e-": "_e", "e- s-1": "_e_per_s", "DN": "_dn", "dB": "_db"}.get(
            self.unit, f"_{self.unit}"
        )


_OF_PLACES: Final = ("ramp", "line", "bow", "arch", "border", "edge", "decay", "rise", "sine")


def _of_settings(name: str) -> Callable[[Any, ExposureContext], Any]:
    return lambda signal, context: np.asarray(getattr(context.settings, name))


def _rested(signal: Any, context: ExposureContext) -> Any:
    return np.asarray(np.inf if context.since_frame_s is None else context.since_frame_s)


def _placed(name: str) -> Callable[[Any, ExposureContext], Any]:
    return lambda signal, context: (
        getattr(context.geometry, name) / max(context.geometry.sensor_width, context.geometry.sensor_height)
    )


COVARIATES: Final = {
    entry.name: entry
    for entry in (
        Covariate("exposure_s", "exposure", "s", _of_settings("exposure_s"), "the exposure",
                  ("power", "step", "decay", "fall")),
        Covariate("timestamp_s", "time", "s", lambda signal, context: np.asarray(elapsed_s(context)), "the time",
                  ("ramp", "line", "decay", "fall", "sine")),
        Covariate("temperature_C", "warm", "°C", _of_settings("temperature_c"), "the temperature",
                  ("ramp", "line", "bow", "step")),
        Covariate("source_level", "level", "1", _of_settings("source_level"), "the source's level",
                  ("ramp", "step", "power", "bend")),
        Covariate("gain_db", "gain", "dB", _of_settings("gain_db"), "the gain", ("ramp", "step", "one", "two")),
        Covariate("f_number", "stop", "1", _of_settings("f_number"), "the f-number", ("power", "step", "one", "two")),
        Covariate("since_frame_s", "rest", "s", _rested, "the time since the last frame", ("decay", "fall")),
        Covariate("frame", "frame", "1", lambda signal, context: np.asarray(context.frame_numbers),
                  "the frame's running number", ("every",)),
        Covariate("image_x", "x", "1", _placed("x_px"), "the column", (*_OF_PLACES, "spot")),
        Covariate("image_y", "y", "1", _placed("y_px"), "the row", (*_OF_PLACES, "moving_wave")),
        Covariate("picture_mean", "picture", "1", picture_mean, "the mean of the picture", ("ramp", "power")),
        Covariate("column_light", "column", "e- s-1", column_light, "the mean light of the column", ("proportion",)),
        Covariate("signal", "signal", "e-", lambda signal, context: signal, "the charge",
                  ("power", "step", "bend", "sine")),
        Covariate("value", "value", "DN", lambda signal, context: signal, "the amplified signal",
                  ("step", "bend", "sine")),
    )
}  # fmt: skip
PLACES: Final = ("image_x", "image_y")
OF_THE_PICTURE: Final = ("picture_mean", "column_light")
WHERE: Final = {  # what results call a covariate that they do not know by its own name
    "since_frame_s": "timestamp_s",
    "value": "signal",
    "picture_mean": "patch_level",
    "column_light": "image_x",
}
PER_FRAME: Final = (
    "since_frame_s",
    "frame",
    "timestamp_s",
)  # differ between the first frame of a series and the others


_Known = Mapping[str, Array]
_Made = Iterable[tuple[dict[str, float], dict[str, float]]]


def _at(values: Array, share: float) -> float:
    return float(values[0] + share * np.ptp(values))


def _along(role: str, *shares: float) -> Callable[[Array, _Known], _Made]:
    return lambda values, known: [({}, {role: _at(values, share)}) for share in shares]


def _round(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _arch(values: Array, known: _Known) -> _Made:
    for middle in (0.3, 0.5, 0.7):
        for width in (0.5, 0.8):
            yield {}, {"middle": _at(values, middle), "width": float(width * np.ptp(values))}


def _step(values: Array, known: _Known) -> _Made:
    between = 0.5 * (values[1:] + values[:-1])
    apart = np.diff(values) > 0.02 * np.ptp(values) if values.size > _STEPS else np.ones(values.size - 1, dtype=bool)
    positive = values[values > 0]  # dark frames hold no light at all
    logarithmic = positive.size > 1 and positive[-1] > 30 * positive[0]
    between = np.sqrt(positive[1:] * positive[:-1]) if logarithmic else between[apart] if apart.any() else between
    spread = np.searchsorted(between, np.linspace(between[0], between[-1], _STEPS))  # a few of many may be far apart
    for index in np.union1d(np.linspace(0, between.size - 1, _STEPS).astype(int), spread):
        yield {}, {"at": float(between[index])}


def _fall(values: Array, known: _Known) -> _Made:
    positive = values[values > 0]
    for share in (0.25, 0.5, 0.75):
        for steepness in (2.0, 8.0):  # fading away, and gone at once
            yield {}, {"knee": float(np.quantile(positive, share)), "steepness": steepness}


def _every(values: Array, known: _Known) -> _Made:
    for period in _FRAMES:
        for at in range(period):
            yield {}, {"period": float(period), "at": float(at)}


def _sine(values: Array, known: _Known) -> _Made:
    for half_waves in (
        np.arange(2, 2 + 2 * _PERIODS) if values.size > 2 * _PERIODS else np.arange(2, max(values.size, 2))
    ):
        yield {}, {"period": float(2.0 * np.ptp(values) / half_waves), "phase": 0.0}


def _spot(values: Array, known: _Known) -> _Made:
    x, y = known["image_x"], known["image_y"]
    for width in (0.08, 0.15, 0.28):
        for at_x in x.max() * np.linspace(0.03, 1.0, 6):
            for at_y in y.max() * np.linspace(0.03, 1.0, 5):
                yield {}, {"at_x": float(at_x), "at_y": float(at_y), "width": width}


def _moving_wave(values: Array, known: _Known) -> _Made:
    if "exposure_s" not in known:
        return
    reference = float(f"{np.sqrt(known['exposure_s'].min() * known['exposure_s'].max()):.3g}")
    for half_waves in (3, 4, 5, 6, 7, 8, 10, 12):
        for advance in (-1.5, -1.1, -0.7, 0.7, 1.1, 1.5):
            period = float(2.0 * np.ptp(values) / half_waves)
            yield {"reference": reference}, {"period": period, "advance": advance, "phase": 0.0}


def _edge(values: Array, known: _Known) -> _Made:
    for share in np.linspace(0.06, 0.94, 23):
        yield {}, {"at": _at(values, float(share)), "width": float(0.04 * np.ptp(values))}


def _picked(count: int, *roles: str) -> Callable[[Array, _Known], _Made]:
    return lambda values, known: [
        ({}, dict(zip(roles, map(float, some), strict=True)))
        for some in (combinations(values, count) if values.size in _FEW else ())
    ]


def _decay(values: Array, known: _Known) -> _Made:
    low = max(values[0], np.ptp(values) / 50)
    return [({}, {"tau": float(tau)}) for tau in np.geomspace(low, np.ptp(values), 6)]


def _rise(values: Array, known: _Known) -> _Made:
    taus = np.ptp(values) * np.array([0.08, 0.2, 0.5])
    return [({"end": _round(values[-1], 4)}, {"tau": float(tau)}) for tau in taus]


@dataclass(frozen=True, slots=True)
class Form:
    """A function of one covariate (or of the place, or of row and exposure)."""

    name: str  # its name
    code: str  # a line of NumPy with the covariate as `{u}` and parameters as `{their role}`
    # Parameters without the amplitude: role and whether they have the covariate's unit
    roles: tuple[tuple[str, bool], ...]
    words: str  # its words, with `{covariate}`
    tried: Callable[
        [Array, _Known], _Made
    ]  # gives constants and parameters that are tried, from the covariate's values
    fixed: tuple[str, ...] = ()  # roles that the fit leaves where they are, for the prediction jumps in them
    is_steep: bool = False  # whether it changes along a place as no quadratic surface does

    @property
    def formula(self) -> Formula:
        """Return the function of the covariate `u` (or `x`, `y`, `exposure`), constants and parameters by role."""
        return formula(re.sub(r"\{(\w+)\}", r"\1", self.code))


FORMS: Final = {
    entry.name: entry
    for entry in (
        Form("proportion", "{u}", (), "in proportion to {covariate}", lambda values, known: [({}, {})]),
        Form("ramp", "({u} - {reference})", (), "as a straight line along {covariate}",
             lambda values, known: [({"reference": _round(float(np.median(values)), 3)}, {})]),
        Form("line", "({u} - {zero})", (("zero", True),),
             "as a straight line along {covariate} from where it is nothing",
             _along("zero", -0.5, 0.0, 0.4, 0.6, 1.0, 1.5)),
        Form("bow", "np.square({u} - {middle})", (("middle", True),),
             "with the square of the distance of {covariate} from a middle", _along("middle", 0.3, 0.5, 0.7)),
        Form("arch", "(1.0 - np.square(({u} - {middle}) / {width}))", (("middle", True), ("width", True)),
             "as an arch over {covariate}", _arch),
        Form("one", "np.isclose({u}, {at}, 1e-3)", (("at", True),), "at one value of {covariate}", _picked(1, "at"),
             ("at",)),
        Form("two", "(np.isclose({u}, {at}, 1e-3) | np.isclose({u}, {other}, 1e-3))", (("at", True), ("other", True)),
             "at two values of {covariate}", _picked(2, "at", "other"), ("at", "other")),
        Form("step", "({u} > {at})", (("at", True),), "as a step along {covariate}", _step, ("at",)),
        Form("border", "({u} > {at})", (("at", True),), "as a sharp step along {covariate}",
             _along("at", *np.linspace(0.01, 0.99, _BORDERS).tolist()), ("at",), is_steep=True),
        Form("edge", "0.5 * (1.0 + np.tanh(({u} - {at}) / {width}))", (("at", True), ("width", True)),
             "as a step along {covariate}", _edge, is_steep=True),
        Form("power", "np.maximum({u} / {reference}, 1e-12) ** {power}", (("power", False),),
             "as a power of {covariate}",
              lambda values, known: [({"reference": _round(values[-1], 4)}, {"power": p}) for p in (0.5, 2.0, -0.5)]),
        Form("decay", "np.exp(-{u} / {tau})", (("tau", True),), "fading exponentially with {covariate}", _decay,
             is_steep=True),
        Form("rise", "np.exp(-({end} - {u}) / {tau})", (("tau", True),), "growing exponentially along {covariate}",
             _rise, is_steep=True),
        Form("fall", "1.0 / (1.0 + np.maximum({u} / {knee}, 1e-12) ** {steepness})",
             (("knee", True), ("steepness", False)), "falling off beyond a knee of {covariate}", _fall),
        Form("every", "np.sum(np.mod({u}, {period}) == {at}, axis=-1) / np.sum({u} >= 0, axis=-1)",
             (("period", True), ("at", True)), "in one frame of so many", _every, ("period", "at")),
        Form("bend", "np.maximum({u} - {knee}, 0.0)", (("knee", True),), "in proportion to {covariate} beyond a knee",
             _along("knee", 0.25, 0.5, 0.75)),
        Form("sine", "np.sin(2.0 * np.pi * {u} / {period} + {phase})", (("period", True), ("phase", False)),
             "as a wave along {covariate}", _sine, is_steep=True),
        Form("spot", "np.exp(-0.5 * (np.square(x - {at_x}) + np.square(y - {at_y})) / {width}**2)",
             (("at_x", True), ("at_y", True), ("width", True)), "falling off as a Gaussian from a spot of the picture",
             _spot, is_steep=True),
        Form("moving_wave",
             "np.sin(2.0 * np.pi * {u} / {period} + {advance} * np.log(exposure / {reference}) + {phase})",
             (("period", True), ("advance", False), ("phase", False)),
             "as a wave along {covariate} that moves with the exposure", _moving_wave, is_steep=True),
    )
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Term:
    """A form of a covariate at certain parameters."""

    form: str  # name of the form
    covariate: str  # name of its covariate; a spot stands under `image_x`
    constants: Mapping[str, float]  # numbers in the formula itself: reference, end
    values: Mapping[str, float]  # parameters by role

    @property
    def covariates(self) -> tuple[str, ...]:
        """Return all covariates that it needs."""
        further = {"spot": ("image_y",), "moving_wave": ("exposure_s",)}.get(self.form, ())
        return (self.covariate, *further)

    def parameter(self, role: str) -> str:
        """Return the parameter's name in the effect: role, covariate and unit."""
        own = COVARIATES[self.covariate]
        has_unit = dict(FORMS[self.form].roles)[role]
        name = role if role.endswith(("_x", "_y")) else f"{role}_{own.tag}"
        return name + (own.suffix if has_unit and not name.endswith(own.suffix or "\0") else "")

    def unit(self, role: str) -> str:
        """Return the parameter's unit."""
        return COVARIATES[self.covariate].unit if dict(FORMS[self.form].roles)[role] else "1"

    def text(self) -> str:
        """Return the formula for people, in the names of its parameters."""
        own = COVARIATES[self.covariate]
        filled = {role: self.parameter(role) for role, _ in FORMS[self.form].roles}
        constants = {name: f"{value:.6g}" for name, value in self.constants.items()}
        found = FORMS[self.form].code.format(u=own.tag, **filled, **constants).replace("np.", "")
        return f"({found})" if found.startswith("1.0 /") else found

    def evaluated(self, known: Mapping[str, Array]) -> Array:
        """Return the term's values for values of its covariates by name, which broadcast."""
        return np.asarray(
            self.value({COVARIATES[name].tag: known[name] for name in self.covariates}, self.values), dtype=np.float64
        )

    def value(self, known: Mapping[str, Any], values: Mapping[str, float]) -> Any:
        """Return the form's value.

        Args:
            known: Values of its covariates by tag.
        """
        form = FORMS[self.form]
        constants = {name: float(f"{value:.6g}") for name, value in self.constants.items()}  # as written
        with np.errstate(over="ignore"):  # a term that grows beyond all numbers explains nothing
            return form.formula({"u": known[COVARIATES[self.covariate].tag], **known, **constants, **values})


def terms_of(name: str, known: Mapping[str, Array]) -> Iterator[Term]:
    """Yield the terms of one covariate that are tried, at parameters spread over its range."""
    values = known[name]
    values = np.unique(values[np.isfinite(values)])
    for form in FORMS.values():
        if form.name in COVARIATES[name].forms:
            yield from (Term(form.name, name, constants, chosen) for constants, chosen in form.tried(values, known))


def finer(term: Term, values: Array, tried: Collection[float]) -> Iterator[Term]:
    """Yield a step or a border at places between it and the next ones that were tried."""
    at = term.values["at"]
    low = max((place for place in tried if place < at), default=at)
    high = min((place for place in tried if place > at), default=at)
    inner = np.unique(values[(values > low) & (values < high)])
    anywhere = term.form == "border" or term.covariate in ("signal", "value")  # noise lies between two levels
    between = np.linspace(low, high, _FINER + 2)[1:-1] if anywhere else 0.5 * (inner[1:] + inner[:-1])
    between = np.setdiff1d(between, list(tried))
    for place in between[np.unique(np.linspace(0, between.size - 1, _FINER).astype(int))] if between.size else ():
        yield replace(term, values={"at": float(place)})

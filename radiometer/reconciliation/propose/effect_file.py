"""Writes a law as an effect of docs/add-an-effect.md: the very class that was fitted, and a test of it."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any, Final

import numpy as np

from radiometer.reconciliation.propose.grammar import (
    COVARIATES,
    FORMS,
    OF_THE_PICTURE,
    PER_FRAME,
    PLACES,
    SIDE,
    WHERE,
    Term,
)
from simulators.chain.law_stages import LINKS, Link
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext

_AMPLITUDES: Final = {
    "1": "amplitude",
    "s": "amplitude_s",
    "e-": "amplitude_e",
    "e- s-1": "amplitude_e_per_s",
    "DN": "amplitude_dn",
    "W m-2": "amplitude_w_m2",
}
_STATISTICS: Final = {
    False: ('    block = "mean"', '    also = ("slope", "first")'),
    True: ('    block = "variance"', "    acts_by_square = True"),
}
SETTINGS: Final = ("exposure_s", "gain_db", "f_number", "temperature_c", "timestamp_s", "source_level")
_WIDTH: Final = 118
_NEAR_NOTHING: Final = 0.05
_WIDEST: Final = 1e3  # times a fitted value: the range of an amplitude
_NEAR: Final = 0.06  # of the picture's longer side, by which the place of a step moves from where it was tried
_BESIDE: Final = 3.0  # ranges of a covariate by which a place or a time may lie outside it


@dataclass(frozen=True, slots=True)
class Law:
    """A link of the chain and one or two terms that are multiplied.

    Attributes:
        link: Key of the link.
        terms: The terms; none for a constant.
    """

    link: str
    terms: tuple[Term, ...] = ()

    @property
    def amplitude(self) -> str:
        """Return the amplitude's name."""
        return _AMPLITUDES[LINKS[self.link].unit]

    @property
    def covariates(self) -> tuple[str, ...]:
        """Return what it goes with, each once; the exposure too where the link goes with it."""
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
    def parameters(self) -> dict[str, float]:
        """Return the parameters of the terms by name."""
        return {term.parameter(role): value for term in self.terms for role, value in term.values.items()}

    @property
    def size(self) -> int:
        """Return the number of parameters, the amplitude among them."""
        return 1 + len(self.parameters)

    @property
    def is_steep(self) -> bool:
        """Tell whether it changes within a tile as no quadratic surface does."""
        return any(FORMS[term.form].is_steep and set(term.covariates) & set(PLACES) for term in self.terms)

    @property
    def signal_power(self) -> int | None:
        """Return the power of the signal with which what it does goes; None where the formula asks for the signal."""
        if set(self.covariates) & {"signal", "value", *OF_THE_PICTURE}:
            return None
        return 0 if LINKS[self.link].adds else 1

    @property
    def is_sudden(self) -> bool:
        """Tell whether it jumps along the signal."""
        return any(term.form == "step" and term.covariate in ("signal", "value") for term in self.terms)

    def formula(self) -> str:
        """Return the amplitude times the terms as it stands in the file."""
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


def effect_source(
    law: Law,
    amplitude: float,
    *,
    sentence: str = "",
    source: str = "a law proposed by radiometer reconcile",
) -> str:
    """Return the text of an effect file.

    Args:
        law: The law at its parameters.
        amplitude: Its amplitude; trials start there and at its negative.
        sentence: What it does, for its docstring.
        source: Where its values come from.
    """
    link = LINKS[law.link]
    fixed = {term.parameter(role) for term in law.terms for role in FORMS[term.form].fixed}
    fitted = [law.amplitude, *(name for name in law.parameters if name not in fixed)]
    per_frame = any(name in PER_FRAME for name in law.covariates)
    counted = "frame" in law.covariates  # the law itself is of all frames of a series then
    helpers = ["CatalogueEffect"]
    helpers += ["elapsed_s"] if "timestamp_s" in law.covariates else []
    helpers += ["over_frames"] if per_frame and not counted and not link.is_noise else []
    lines = [
        *_docstring(sentence or "A law that was proposed.", ""),
        "",
        "from __future__ import annotations",
        "",
        "from dataclasses import dataclass",
        "from typing import Any",
        "",
        *(["import numpy as np", ""] if _uses_numpy(law, per_frame=per_frame) else []),
        f"from simulators.effects.base import {link.unit_signal}, Stage, parameter",
        f"from simulators.effects.catalogue import {', '.join(helpers)}",
        "from simulators.effects.context import ExposureContext",
        *_surroundings(law),
        "",
        "",
        "@dataclass(frozen=True)",
        f"class {class_name(law)}(CatalogueEffect):",
        *_docstring(_said_law(law), "    ", f"Source: {source}."),
        "",
        f'    name = "{law.name}"',
        f"    stage = Stage.{link.member}",
        f"    unit_in = {link.unit_signal}",
        f"    unit_out = {link.unit_signal}",
        *([f'    before = "{link.before}"'] if link.before else []),
        f'    where = "{law.where}"',
        *_STATISTICS[link.is_noise],
        *(["    is_steep = True"] if law.is_steep else []),
        *([f"    signal_power = {law.signal_power}"] if law.is_steep and law.signal_power is not None else []),
        *(["    is_sudden = True"] if law.is_sudden else []),
        "    trials = (",
        *_trial(law, amplitude),
        *_trial(law, -amplitude, _NEAR_NOTHING),
        "    )",
        *_names("fitted", fitted),
        '    settles = "another session that goes beyond the ranges of the first"',
        f'    {law.amplitude}: float = parameter(0.0, "{link.unit}", {_range(amplitude)}, source="fitted")',
        *(_parameter(term, role) for term in law.terms for role in term.values),
        "",
        *_law_lines(law, link),
        "",
        *(_noise(link) if link.is_noise else _acting(law, link)),
        *_usable(law),
    ]
    return "\n".join(lines) + "\n"


def _surroundings(law: Law) -> list[str]:
    """Return the import of what a law of the whole picture looks up."""
    needed = sorted(set(law.covariates) & set(OF_THE_PICTURE))
    return [f"from simulators.effects.surroundings import {', '.join(needed)}"] if needed else []


def _docstring(first: str, indent: str, further: str = "") -> list[str]:
    """Return the lines of a docstring; what is too long for one goes on in the next."""
    wrapped = textwrap.wrap(first, _WIDTH - len(indent) - 6)
    lines = [f'{indent}"""{wrapped[0]}', *(indent + line for line in wrapped[1:])]
    if not further and len(wrapped) == 1:
        return [lines[0] + '"""']
    lines += ["", *(indent + line for line in textwrap.wrap(further, _WIDTH - len(indent)))] if further else []
    return [*lines, f'{indent}"""']


def _names(key: str, names: Sequence[str]) -> list[str]:
    if len(names) == 1:
        return [f'    {key} = ("{names[0]}",)']
    return [f"    {key} = (", *(f'        "{name}",' for name in names), "    )"]


def _trial(law: Law, amplitude: float, nearest: float = 0.0) -> list[str]:
    """Return the lines of a start; a spot's place is not nearer to 0 than a figure: fits step by trials."""
    places = {name for name in law.parameters if name in ("at_x", "at_y")}
    own = {n: nearest if n in places and abs(v) < nearest else v for n, v in law.parameters.items()}
    values = {law.amplitude: round_to(amplitude)} | {name: round_to(value) for name, value in own.items()}
    return ["        {", *(f'            "{name}": {value!r},' for name, value in values.items()), "        },"]


def _law_lines(law: Law, link: Link) -> list[str]:
    known = [COVARIATES[name] for name in law.covariates if COVARIATES[name].code != COVARIATES[name].tag]
    side = [f"        {SIDE}"] if any("/ side" in entry.code for entry in known) else []
    factors = ["first", "second"][: len(law.terms)]
    return [
        "    def law(self, signal: Any, context: ExposureContext) -> Any:",
        f'        """Return the amplitude times the formula, in {link.unit}."""',
        *side,
        *(f"        {entry.tag} = {entry.code}" for entry in known),
        *(f"        {name} = {_plain_code(term)}" for name, term in zip(factors, law.terms, strict=True)),
        f"        return {' * '.join([f'self.{law.amplitude}', *factors])}",
    ]


def _plain_code(term: Term) -> str:
    """Return a term's line without brackets about the whole of it."""
    code = term.code()
    return code[1:-1] if code.startswith("(") and _closes_last(code) else code


def _closes_last(code: str) -> bool:
    """Tell whether the first bracket closes at the very end."""
    depth = 0
    for at, letter in enumerate(code):
        depth += {"(": 1, ")": -1}.get(letter, 0)
        if depth == 0:
            return at == len(code) - 1
    return False


def _uses_numpy(law: Law, *, per_frame: bool) -> bool:
    text = "".join([*_law_lines(law, LINKS[law.link]), LINKS[law.link].code])
    return per_frame or LINKS[law.link].is_noise or "np." in text


def class_name(law: Law) -> str:
    """Return the name of the class."""
    return "".join(part.capitalize() for part in law.name.split("_"))


def round_to(value: float, digits: int = 6) -> float:
    """Return a value in so many digits; what is nothing beside them is 0."""
    return float(f"{value:.{digits}g}") if abs(value) > 1e-12 else 0.0


def _said_law(law: Law) -> str:
    link = LINKS[law.link]
    plain = law.formula().replace("self.", "").replace("np.", "")
    return f"{link.said[0].upper()}{link.said[1:]}: {link.code.format(law=plain).replace('np.', '')}."


def _acting(law: Law, link: Link) -> list[str]:
    """Return the methods of a law of the light, the charge or the signal."""
    per_frame = any(name in PER_FRAME for name in law.covariates)
    counted = "frame" in law.covariates  # the law itself is of all frames of a series then
    own = "self.law(signal, context)"
    over = "over_frames(lambda frame: self.law(signal, frame), context)"
    return [
        "    def mean(self, signal: Any, context: ExposureContext) -> Any:",
        '        """Return the signal with the law."""',
        f"        law = {over if per_frame and not counted else own}",
        f"        return ({link.code.format(law='law')}).astype(signal.dtype)",
        *(_per_frame(link, law) if per_frame else ()),
        *(_drifts() if per_frame else ()),
    ]


def _noise(link: Link) -> list[str]:
    """Return the methods of a law that is the standard deviation of a noise."""
    return [
        "    def mean(self, signal: Any, context: ExposureContext) -> Any:",
        '        """Return the signal as it is."""',
        "        return signal",
        "",
        "    def slope(self, signal: Any, context: ExposureContext) -> float:",
        '        """Return 1."""',
        "        return 1.0",
        "",
        "    def variance(self, signal: Any, context: ExposureContext) -> Any:",
        '        """Return the variance that it adds, in DN²."""',
        "        law = self.law(signal, context)",
        f"        return np.square({link.code.format(law='law')})",
        "",
        "    def sample(self, signal: Any, context: ExposureContext, rng: np.random.Generator) -> Any:",
        '        """Return the signal with the noise on it."""',
        "        noise = np.sqrt(self.variance(signal, context)) * rng.standard_normal(signal.shape)",
        "        return (signal + noise).astype(signal.dtype)",
    ]


def _per_frame(link: Link, law: Law) -> list[str]:
    """Return the lines of the variance by which frames of a series differ; of three and more the first does not count.

    What goes with the time goes on among the others, evenly where they follow each other evenly; what goes with the
    rest before a frame is the same for all of them, and of laws by the frame's number some have it and others not.
    """
    goes_on = "timestamp_s" in law.covariates
    others = "np.maximum(frames - 1.0, 0.0) / (3.0 * frames)" if goes_on else "0.0"
    apart = [
        f"        share = np.where(frames == 2.0, 0.5, {others})",
        "        apart = self.law(signal, context.first_frame) - self.law(signal, context.later_frames)",
        f"        return share * np.square({link.change.format(law='apart')})",
    ]
    some = [
        "        few, many = self.law(signal, context), self.law(signal, context.later_frames)",
        "        counted, law = frames - (frames > 2.0), np.where(frames > 2.0, many, few)",
        f"        return law * (self.{law.amplitude} - law) * counted / np.maximum(counted - 1.0, 1.0)"
        f"{'' if link.adds else ' * np.square(signal)'}",
    ]
    return [
        "",
        "    def common_variance(self, signal: Any, context: ExposureContext) -> Any:",
        '        """Return how the frames of a series differ, as a variance; of three and more all but the first."""',
        "        if context.first_frame is None or context.later_frames is None:",
        "            return 0.0",
        '        frames = np.asarray(getattr(context, "frames", 1.0))',
        *(some if "frame" in law.covariates else apart),
    ]


def _drifts() -> list[str]:
    return [
        "",
        "    @property",
        "    def drifts(self) -> bool:",
        '        """Tell that the first frame of a series differs."""',
        "        return True",
    ]


def _usable(law: Law) -> list[str]:
    needs = {
        "f_number": "context.settings.f_number",
        "temperature_C": "context.settings.temperature_c",
        "since_frame_s": "context.since_frame_s",
    }
    known = dict.fromkeys((*law.covariates, *LINKS[law.link].goes_with))
    lacking = [f"{needs[name]} is not None" for name in known if name in needs]
    if not lacking:
        return []
    return [
        "",
        "    @classmethod",
        "    def usable(cls, context: ExposureContext) -> bool:",
        '        """Tell whether the data know what it goes with."""',
        f"        return {' and '.join(lacking)}",
    ]


def _parameter(term: Term, role: str) -> str:
    value = round_to(term.values[role])
    name, unit = term.parameter(role), term.unit(role)
    near = role == "at" and term.covariate in PLACES  # elsewhere others were tried; far off it steps nowhere at all
    low, high = (round_to(value - _NEAR), round_to(value + _NEAR)) if near else _bounds(role, value)
    return f'    {name}: float = parameter({value!r}, "{unit}", {low!r}, {high!r}, source="fitted")'


def _bounds(role: str, value: float) -> tuple[float, float]:
    if role in ("tau", "period", "width", "knee"):
        return round_to(value / 100.0), round_to(value * 100.0)
    if role == "power":
        return -6.0, 6.0
    if role == "steepness":
        return 0.1, 60.0
    if role in ("phase", "advance"):
        return -30.0, 30.0
    wide = _BESIDE * max(abs(value), 1.0)
    return round_to(value - wide), round_to(value + wide)


def _range(amplitude: float) -> str:
    wide = round_to(_WIDEST * max(abs(amplitude), 1e-12))
    return f"{-wide!r}, {wide!r}"


_NEEDED: Final[dict[str, ModuleType]] = {}


def effect_class(law: Law, amplitude: float) -> type[CatalogueEffect]:
    """Return the class that the file of a law defines; laws that differ in values alone may have one of their own."""
    return _class_of(effect_source(law, amplitude), class_name(law))


@cache
def _class_of(text: str, name: str) -> type[CatalogueEffect]:
    module = ModuleType(f"_law_{len(_NEEDED)}")
    _NEEDED[module.__name__] = module
    sys.modules[module.__name__] = module  # dataclasses look their module up
    exec(compile(text, f"<{module.__name__}>", "exec"), module.__dict__)
    found: type[CatalogueEffect] = getattr(module, name)
    return found


def effect_of(law: Law, amplitude: float) -> CatalogueEffect:
    """Return the effect of a law at its parameters."""
    return effect_class(law, amplitude)(
        **{law.amplitude: amplitude} | {n: round_to(v) for n, v in law.parameters.items()}
    )


def acted(law: Law, amplitude: float, signal: float, context: ExposureContext) -> float:
    """Return what a written test holds a law to at a pixel: the signal behind it, of a noise the variance it adds."""
    found = getattr(effect_of(law, amplitude), law.shown)(np.array([signal]), context)
    return float(np.ravel(found)[0])


def source_of_test(
    law: Law,
    amplitude: float,
    file_name: str,
    context: Mapping[str, Any],
    values: Sequence[tuple[float, float, float, float]],
) -> str:
    """Return the text of a test of an effect file: its values at some places, and nothing at amplitude 0.

    Args:
        law: The law at its parameters.
        amplitude: Its amplitude.
        file_name: Name of the effect file beside the test.
        context: Settings of the frame: those of SETTINGS, since_frame_s, and width and height of the sensor.
        values: Column, row, signal in front of it and what `acted` makes of it.
    """
    given = "\n".join(f"        {key}={context[key]!r}," for key in SETTINGS)
    found = {law.amplitude: round_to(amplitude)} | {name: round_to(value) for name, value in law.parameters.items()}
    parameters = "\n".join(f'    "{name}": {value!r},' for name, value in found.items())
    rows = "\n".join(f"    {tuple(round_to(float(v), 10) for v in row)!r}," for row in values)
    nothing = "0.0" if LINKS[law.link].is_noise else "before"
    return f'''"""The law `{law.name}` gives what it was proposed with."""

from pathlib import Path

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.registry import make_effect, register_file

register_file(Path(__file__).with_name("{file_name}"))
FOUND = {{
{parameters}
}}
# column, row, signal before, {law.shown} after
VALUES = [
{rows}
]


def context_at(column, row):
    """Return the circumstances of one pixel."""
    settings = FrameSettings(
{given}
    )
    geometry = FrameGeometry(np.array([column]), np.array([row]), {context["width"]}, {context["height"]})
    camera = CameraDescription(bit_depth=16)
    return ExposureContext(settings, geometry, camera, since_frame_s={context["since_frame_s"]!r})


@pytest.mark.parametrize(("column", "row", "before", "after"), VALUES)
def test_the_law_gives_what_was_found(column, row, before, after):
    """What the effect makes of the signal is what the proposal was made with."""
    found = make_effect("{law.name}", FOUND).{law.shown}(np.array([before]), context_at(column, row))
    assert np.ravel(found)[0] == pytest.approx(after, rel=1e-6)


@pytest.mark.parametrize(("column", "row", "before", "after"), VALUES)
def test_without_its_amplitude_it_does_nothing(column, row, before, after):
    """An amplitude of 0 leaves the signal as it is."""
    nothing = make_effect("{law.name}", FOUND | {{"{law.amplitude}": 0.0}})
    assert np.ravel(nothing.{law.shown}(np.array([before]), context_at(column, row)))[0] == {nothing}
'''

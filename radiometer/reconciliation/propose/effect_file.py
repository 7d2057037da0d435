"""Writes a law as an effect file after docs/how-to/add-an-effect.md, and a test of it, for the user who exports it."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final

from radiometer.reconciliation.propose.grammar import COVARIATES, OF_THE_PICTURE, SIDE, Term
from radiometer.reconciliation.propose.law import Declared, Law, declared, round_to, trials
from simulators.chain.law_stages import LINKS, Link

_STATISTICS: Final = {
    False: ('    block = "mean"', '    also = ("slope", "first")'),
    True: ('    block = "variance"', "    acts_by_square = True"),
}
SETTINGS: Final = ("exposure_s", "gain_db", "f_number", "temperature_c", "timestamp_s", "source_level")
_WIDTH: Final = 118


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
    per_frame, counted = law.is_per_frame, law.is_of_the_series
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
        f"class {law.class_name}(CatalogueEffect):",
        *_docstring(_law_in_words(law), "    ", f"Source: {source}."),
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
        *(line for values in trials(law, amplitude) for line in _trial(values)),
        "    )",
        *_names("fitted", law.fitted),
        '    settles = "another session that goes beyond the ranges of the first"',
        *(_parameter(one) for one in declared(law, amplitude)),
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
    """Return whether the first bracket closes at the last character."""
    depth = 0
    for at, letter in enumerate(code):
        depth += {"(": 1, ")": -1}.get(letter, 0)
        if depth == 0:
            return at == len(code) - 1
    return False


def _uses_numpy(law: Law, *, per_frame: bool) -> bool:
    text = "".join([*_law_lines(law, LINKS[law.link]), LINKS[law.link].code])
    return per_frame or LINKS[law.link].is_noise or "np." in text


def _law_in_words(law: Law) -> str:
    link = LINKS[law.link]
    plain = law.formula().replace("self.", "").replace("np.", "")
    return f"{link.action[0].upper()}{link.action[1:]}: {link.code.format(law=plain).replace('np.', '')}."


def _acting(law: Law, link: Link) -> list[str]:
    """Return the methods of a law of the light, the charge or the signal."""
    per_frame, counted = law.is_per_frame, law.is_of_the_series
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

    A law of time continues among the others, evenly where they follow each other evenly. A law of the rest before a
    frame is the same for all of them. Of laws by the frame's number some have it and others not.
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


def _trial(values: Mapping[str, float]) -> list[str]:
    return ["        {", *(f'            "{name}": {value!r},' for name, value in values.items()), "        },"]


def _parameter(one: Declared) -> str:
    return (
        f'    {one.name}: float = parameter({one.default!r}, "{one.unit}", {one.low!r}, {one.high!r}, source="fitted")'
    )


def _usable(law: Law) -> list[str]:
    if not law.needs:
        return []
    return [
        "",
        "    @classmethod",
        "    def usable(cls, context: ExposureContext) -> bool:",
        '        """Return whether the data state what it depends on."""',
        f"        return {' and '.join(f'context.{path} is not None' for path in law.needs)}",
    ]


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
        file_name: Name of the effect file in the folder of the test.
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

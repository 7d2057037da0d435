"""Holds a proposed law with its evidence, and writes its files: effect, test, and captures that would refute it."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from pprint import pformat
from typing import Any, Final

import numpy as np

from radiometer.data.storage import write_text_atomic, write_yaml_atomic
from radiometer.errors import OutputError
from radiometer.reconciliation.next_capture import FORMAT as PLAN_FORMAT
from radiometer.reconciliation.next_capture import FRAMES, CapturePool
from radiometer.reconciliation.propose.grammar import COVARIATES, FORMS
from radiometer.reconciliation.propose.law import Law, acted, context_at, round_to
from radiometer.reconciliation.result import FittedParameter
from radiometer.reconciliation.state import FitState
from simulators.chain.stages import LINKS

_WIDTH: Final = 116


def effect_source(
    law: Law,
    amplitude: float,
    *,
    sentence: str = "A law that was proposed.",
    source: str = "a law proposed by radiometer reconcile",
) -> str:
    """Return the text of an effect file: the law as data, of which its class is made.

    Args:
        amplitude: Its amplitude; trials start there and at its negative.
        sentence: What it does, for its docstring.
        source: Where its values come from.
    """
    link = LINKS[law.link]
    plain = link.code.format(law=law.formula()).replace("np.", "")
    words = [_in_docstring(textwrap.fill(text, _WIDTH)) for text in (sentence, f"Source: {source}.")]
    does = textwrap.fill(f"{link.action[0].upper()}{link.action[1:]}: {plain}.", _WIDTH - 8, subsequent_indent="    ")
    rounded = law.with_parameters({name: round_to(value) for name, value in law.parameters.items()})
    return f'''"""{words[0]}

{words[1]}
"""

from radiometer.reconciliation.propose.grammar import Term
from radiometer.reconciliation.propose.law import Law, effect_class

LAW = {pformat(rounded, width=_WIDTH - 6)}


class {law.class_name}(effect_class(LAW, {round_to(amplitude)!r})):
    """{does}"""
'''


def _in_docstring(text: str) -> str:
    """Return text that ends no docstring and is no escape in one: names of folders come from anybody."""
    shown = "".join(one if one.isprintable() or one == "\n" else "?" for one in text)
    return shown.replace("\\", r"\\").replace('"', r"\"")


def source_of_test(
    law: Law,
    amplitude: float,
    file_name: str,
    settings: Mapping[str, float],
    shape: tuple[int, int],
    values: Sequence[tuple[float, float, float, float]],
) -> str:
    """Return the text of a test of an effect file: its values at some places, and nothing at amplitude 0.

    Args:
        settings: Of the frame, by their names in `FrameSettings`.
        shape: Height and width of the sensor in pixels.
        values: Column, row, signal in front of it and what `acted` makes of it.
    """
    found = {law.amplitude: round_to(amplitude)} | {name: round_to(value) for name, value in law.parameters.items()}
    rows = [tuple(round_to(float(v), 10) for v in row) for row in values]
    nothing = "0.0" if LINKS[law.link].is_noise else "before"
    return f'''"""The law `{law.name}` gives what it was proposed with."""

from pathlib import Path

import numpy as np
import pytest

from radiometer.reconciliation.propose.law import context_at
from simulators.effects.registry import make_effect, register_file

register_file(Path(__file__).with_name("{file_name}"))
FOUND = {pformat(found)}
SETTINGS = {pformat(dict(settings))}
# column, row, signal before, {law.shown} after
VALUES = {pformat(rows)}


@pytest.mark.parametrize(("column", "row", "before", "after"), VALUES)
def test_the_law_gives_what_was_found(column, row, before, after):
    """What the effect makes of the signal is what the proposal was made with."""
    found = make_effect("{law.name}", FOUND).{law.shown}(np.array([before]), context_at(column, row, {shape}, SETTINGS))
    assert np.ravel(found)[0] == pytest.approx(after, rel=1e-6)


@pytest.mark.parametrize(("column", "row", "before", "after"), VALUES)
def test_without_its_amplitude_it_does_nothing(column, row, before, after):
    """An amplitude of 0 leaves the signal as it is."""
    nothing = make_effect("{law.name}", FOUND | {{"{law.amplitude}": 0.0}})
    assert np.ravel(nothing.{law.shown}(np.array([before]), context_at(column, row, {shape}, SETTINGS)))[0] == {nothing}
'''


_ENDS: Final = ("left", "middle", "right"), ("upper", "middle", "lower")


@dataclass(frozen=True, slots=True)
class Rival:
    """Another law that the data do not rule out: name, stage, covariates, and how many nats it is behind.

    Negative where it is ahead of one that acts at a plainer stage.
    """

    name: str
    stage: str
    covariates: tuple[str, ...]
    behind_nats: float


@dataclass(frozen=True, eq=False)
class Proposal:
    """A law for what no entry explains."""

    law: Law  # the law at its fitted parameters
    amplitude: float  # its amplitude
    parameters: Mapping[str, FittedParameter]  # all parameters with ± and unit
    nats: float  # improvement of the held-out log density against the starting camera
    before: FitState  # the starting camera as fitted
    after: FitState  # the same with the law
    rivals: tuple[Rival, ...] = ()  # laws within odds of 150, each further parameter and a second factor paid for

    @property
    def name(self) -> str:
        """Return the effect's name."""
        return self.law.name

    @property
    def stage(self) -> str:
        """Return where in the chain it acts."""
        return LINKS[self.law.link].stage

    @property
    def stages_alike(self) -> tuple[str, ...]:
        """Return further stages at which a rival acts."""
        return tuple(dict.fromkeys(rival.stage for rival in self.rivals if rival.stage != self.stage))

    @property
    def covariates(self) -> tuple[str, ...]:
        """Return the covariates on which it depends, those of its stage included."""
        return tuple(dict.fromkeys((*self.law.covariates, *LINKS[self.law.link].goes_with)))

    @property
    def closed(self) -> float:
        """Return the share of the excess of the held-out gap over 1 that it closes."""
        excess = self.before.gap - 1.0
        return float(np.clip((self.before.gap - self.after.gap) / excess, 0.0, 1.0)) if excess > 0 else 0.0

    def sentence(self) -> str:
        """Return in one sentence what it does and what kind of cause acts so."""
        link = LINKS[self.law.link]
        forms = [_in_words(term, self.before.design.shape) for term in self.law.terms]
        return f"{', '.join([link.action, *filter(None, [' and '.join(forms)])])}: like {link.like}"

    def source(self, origin: str) -> str:
        """Return the text of the effect file."""
        text = self.sentence()
        return effect_source(
            self.law,
            self.amplitude,
            sentence=f"{text[0].upper()}{text[1:]}.",
            source=f"proposed by radiometer reconcile from {origin}",
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping under `proposal` of the JSON form."""
        return {
            "name": self.name,
            "stage": self.stage,
            "stages_alike": list(self.stages_alike),
            "covariates": list(self.covariates),
            "formula": self.law.formula(),
            "parameters": {name: entry.to_mapping() for name, entry in self.parameters.items()},
            "sentence": self.sentence(),
            "gain_nats": self.nats,
            "gap_before": self.before.gap,
            "gap_after": self.after.gap,
            "excess_closed": self.closed,
            "rivals": [
                {"name": r.name, "stage": r.stage, "covariates": list(r.covariates), "behind_nats": r.behind_nats}
                for r in self.rivals
            ],
        }


def _in_words(term: Any, shape: tuple[int, int]) -> str:
    if term.form == "spot":
        height, width = shape
        side = max(shape)
        column = _ENDS[0][int(np.clip(3.0 * term.values["at_x"] * side / width, 0, 2))]
        row = _ENDS[1][int(np.clip(3.0 * term.values["at_y"] * side / height, 0, 2))]
        place = "the middle" if (row, column) == ("middle", "middle") else f"the {row} {column}"
        corner = " corner" if "middle" not in (row, column) else ""
        return f"falling off as a Gaussian from {place}{corner}"
    return FORMS[term.form].words.format(covariate=COVARIATES[term.covariate].words)


_CAPTURES: Final = 3
_SHOWS_CHI2: Final = 9.0


def _refuting_frames(proposal: Proposal) -> tuple[list[dict[str, Any]], list[str]]:
    """Return frames for `radiometer bracket --plan`, and for each what the law predicts there."""
    pool = CapturePool.of(proposal.after)
    with_law, without = pool.predicted(proposal.after), pool.predicted(proposal.before)
    worth = np.nan_to_num(pool.separation(with_law, without))
    worth = np.where(pool.is_new, worth, 0.5 * worth)
    is_noise = LINKS[proposal.law.link].is_noise
    apart = np.sqrt(with_law.variance) - np.sqrt(without.variance) if is_noise else with_law.mean - without.mean
    does = "scatters by" if is_noise else "differs by"
    frames, reasons = list[dict[str, Any]](), list[str]()
    for index in np.argsort(-worth)[:_CAPTURES].tolist():
        if worth[index] < _SHOWS_CHI2 and frames:
            break
        tile = int(np.argmax(np.abs(apart[index])))
        frame = pool.frame(index)
        shown = frame.model_dump(mode="json", exclude_none=True, exclude={"file", "black_level_dn"})
        frames.append(shown | {"repeat": FRAMES})
        reasons.append(
            f"{frame.exposure_s:.3g} s at {frame.gain_db:g} dB, source level {frame.source_level:g}, shutter "
            f"{frame.shutter}: with {proposal.name} patch {pool.design.tiles[tile].name} {does} "
            f"{apart[index, tile]:+.3g} DN relative to the camera without it; the law is refuted where that is not seen"
        )
    return frames, reasons


def write_files(proposal: Proposal, folder: Path, origin: str) -> tuple[Path, ...]:
    """Write effect file, test and the plan that would refute a law, and return their paths.

    Raises:
        OutputError: If a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder {folder}: {error.strerror or error}; name another") from error
    name = proposal.name
    effect, test, plan = folder / f"{name}.py", folder / f"test_{name}.py", folder / "plan.yaml"
    frames, reasons = _refuting_frames(proposal)
    write_text_atomic(effect, proposal.source(origin))
    write_text_atomic(test, _test(proposal, effect.name))
    write_yaml_atomic(plan, {"format": PLAN_FORMAT, "reasons": reasons, "frames": frames})
    return effect, test, plan


def _test(proposal: Proposal, file_name: str) -> str:
    design, amplitude = proposal.before.design, round_to(proposal.amplitude)
    warm, (height, width) = design.temperature_c, design.shape
    settings = {
        "exposure_s": float(np.max(design.exposure_s)),
        "gain_db": float(np.max(design.gain_db)),
        "f_number": float(np.min(design.f_number)),
        "temperature_c": float(np.nanmax(warm)) if np.isfinite(warm).any() else 25.0,
        "timestamp_s": float(np.median(design.timestamp_s)),
        "source_level": 1.0,
    }
    places = ((0.0, 0.0, 100.0), (0.5 * width, 0.3 * height, 1000.0), (width - 1.0, height - 1.0, 50.0))
    rows = [
        (x, y, signal, acted(proposal.law, amplitude, signal, context_at(x, y, design.shape, settings)))
        for x, y, signal in places
    ]
    return source_of_test(proposal.law, amplitude, file_name, settings, design.shape, rows)

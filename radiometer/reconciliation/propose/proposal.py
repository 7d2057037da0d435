"""Holds a proposed law with its evidence and the remarks about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.propose.effect_file import effect_source
from radiometer.reconciliation.propose.grammar import COVARIATES, FORMS
from radiometer.reconciliation.propose.law import Law
from radiometer.reconciliation.result import FittedParameter
from simulators.chain.law_stages import LINKS

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
            "formula": self.law.formula().replace("self.", "").replace("np.", ""),
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

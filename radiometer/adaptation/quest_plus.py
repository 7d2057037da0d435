"""QUEST+ as a search for one threshold: each blink at the most informative level, until the threshold is known well."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.protocol import QuestPlusMethod, Spot
from radiometer.errors import MissingLibrary

_SEEN: Final = {True: {"response": "seen"}, False: {"response": "unseen"}}


@dataclass
class QuestPlusSearch:
    """One threshold by QUEST+, on the package `questplus`.

    The psychometric function is a Weibull function of log10 luminance; its threshold is where the chance of an answer
    is 1 − 1/e (but for lapses and false alarms). The slope is a nuisance: it is marginalised out.

    Source: Watson 2017, QUEST+: a general multidimensional Bayesian adaptive psychometric method, J. Vision 17(3):10.
    """

    spot: Spot  # the spot's levels
    method: QuestPlusMethod  # its settings
    last: float | None = None  # threshold before, log10, on which the prior is centred; None for a flat prior
    threshold: float | None = None  # mean of the posterior, once its standard deviation is small enough
    exhausted: bool = False
    u_log10: float | None = None  # that standard deviation
    level: float = field(init=False)
    _levels: NDArray[np.float64] = field(init=False)
    _quest: Any = field(init=False)
    _answers: list[bool] = field(default_factory=list)

    def __post_init__(self) -> None:
        count = round((self.spot.highest_log10 - self.spot.lowest_log10) / self.method.step_log10) + 1
        self._levels = np.linspace(self.spot.lowest_log10, self.spot.highest_log10, count).round(6)
        self._quest = self._begun()
        self.level = float(self._quest.next_stim["intensity"])

    def answer(self, *, seen: bool) -> None:
        """Take the answer to the blink at `level` and go on."""
        self._answers.append(seen)
        self._quest.update(stim={"intensity": self.level}, outcome=_SEEN[seen])
        chances = self._quest.marginal_posterior["threshold"]
        mean = float(chances @ self._levels)
        u_log10 = float(np.sqrt(chances @ (self._levels - mean) ** 2))
        known = u_log10 <= self.method.stop_sd_log10 and len(self._answers) >= self.method.least_blinks
        # Answers of one kind only bound a threshold from one side; what the prior adds is no measurement.
        if known and len(set(self._answers)) == 2:
            self.threshold, self.u_log10 = mean, u_log10
        elif len(self._answers) >= self.method.most_blinks:
            self.exhausted = True
        else:
            self.level = float(self._quest.next_stim["intensity"])

    def _begun(self) -> Any:
        try:
            import questplus
        except ImportError as error:
            raise MissingLibrary(
                "method questplus needs the package of that name; install it with: pip install 'radiometer[eye]'"
            ) from error
        prior = None
        if self.last is not None:
            away = (self._levels - self.last) / self.method.prior_sd_log10
            prior = {"threshold": np.exp(-0.5 * away**2)}
        return questplus.QuestPlus(
            stim_domain={"intensity": self._levels},
            param_domain={
                "threshold": self._levels,
                "slope": np.array(self.method.slopes),
                "lower_asymptote": np.array([self.method.false_alarms]),
                "lapse_rate": np.array([self.method.lapses]),
            },
            outcome_domain={"response": ["seen", "unseen"]},
            prior=prior,
            func="weibull",
            stim_scale="log10",
        )

"""Where response curves recovered by different methods disagree, and by how many standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from radiometer.analysis.response.estimate import ResponseEstimate, inner_range


@dataclass(frozen=True, slots=True)
class Disagreement:
    """The difference of two curves over 5–95 % of the values that both support, a common offset taken out.

    Attributes:
        first: Method of the one curve.
        second: Method of the other.
        channel: Colour channel.
        rms_log: Root mean square difference of ln H.
        largest_sigma: Largest difference in units of both uncertainties together.
        at_dn: Digital number of that largest difference.
    """

    first: str
    second: str
    channel: str
    rms_log: float
    largest_sigma: float
    at_dn: int

    def to_mapping(self) -> dict[str, Any]:
        """Return the plain mapping for JSON."""
        return {
            "methods": [self.first, self.second],
            "channel": self.channel,
            "rms_log": self.rms_log,
            "largest_sigma": self.largest_sigma,
            "at_dn": self.at_dn,
        }


def compare_methods(estimates: Sequence[ResponseEstimate]) -> list[Disagreement]:
    """Return how every estimate differs from the first one of its channel."""
    found = []
    first: dict[str, ResponseEstimate] = {}
    for estimate in estimates:
        reference = first.setdefault(estimate.curve.channel, estimate)
        if reference is not estimate:
            found.append(_compare(reference, estimate))
    return found


def _compare(reference: ResponseEstimate, other: ResponseEstimate) -> Disagreement:
    a, b = reference.curve, other.curve
    whole = (0, a.log_exposure.size - 1)
    ranges = [a.valid_dn or whole, b.valid_dn or whole]
    inner = inner_range((max(r[0] for r in ranges), min(r[1] for r in ranges)))
    gap = b.log_exposure[inner] - a.log_exposure[inner]
    u = np.hypot(a.u_log_exposure[inner], b.u_log_exposure[inner])
    # Both are pinned at the middle value, where u vanishes: a fair comparison takes a common offset out.
    gap = gap - np.average(gap, weights=1.0 / (u**2 + float(np.median(u)) ** 2))
    sigma = np.abs(gap) / np.maximum(u, 0.5 * float(np.median(u)) + 1e-12)
    at = int(np.argmax(sigma))
    return Disagreement(
        reference.method,
        other.method,
        a.channel,
        float(np.sqrt(np.mean(gap**2))),
        float(sigma[at]),
        inner.start + at,
    )

"""The registry of response methods (a new method is one module and one line here), and how far methods disagree."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from radiometer.analysis.response import auto as response_auto
from radiometer.analysis.response import debevec1997 as response_debevec1997
from radiometer.analysis.response import linear_spline as response_linear_spline
from radiometer.analysis.response import mitsunaga1999 as response_mitsunaga1999
from radiometer.analysis.response import robertson1999 as response_robertson1999
from radiometer.analysis.response.estimate import ResponseEstimate, inner_range
from radiometer.data.frame import Bracket
from radiometer.errors import UsageError

ResponseMethod = Callable[[Sequence[Bracket]], ResponseEstimate]

METHODS: Final[dict[str, ResponseMethod]] = {
    "auto": response_auto.recover_response_auto,
    "debevec1997": response_debevec1997.recover_response_debevec1997,
    "mitsunaga1999": response_mitsunaga1999.recover_response_mitsunaga1999,
    "robertson1999": response_robertson1999.recover_response_robertson1999,
    "linear_spline": response_linear_spline.recover_response_linear_spline,
}
# Methods that find exposure ratios and may be given some of them.
RATIO_METHODS: Final = {"mitsunaga1999": response_mitsunaga1999.recover_response_mitsunaga1999}
DEFAULT_METHOD: Final = "auto"


def method_names(choice: str) -> list[str]:
    """Return the names of the methods behind a choice: one name, or "all" for every one.

    Raises:
        UsageError: If there is no such method.
    """
    if choice == "all":
        return list(METHODS)
    if choice not in METHODS:
        raise UsageError(f"there is no response method {choice!r}; choose one of {', '.join(METHODS)} or all")
    return [choice]


@dataclass(frozen=True, slots=True)
class Disagreement:
    """The difference of two curves over 5–95 % of the values that both support, a common offset taken out."""

    first: str  # method of the one curve
    second: str  # method of the other
    channel: str  # colour channel
    rms_log: float  # root mean square difference of ln H
    largest_sigma: float  # largest difference in units of both uncertainties together
    at_dn: int  # digital number of that largest difference

    def to_mapping(self) -> dict[str, Any]:
        """Return the plain mapping for JSON."""
        figures = asdict(self)
        return {"methods": [figures.pop("first"), figures.pop("second")], **figures}


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

"""The registry of response methods: a new method is one module and one line here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from radiometer.analysis.response import auto as response_auto
from radiometer.analysis.response import debevec1997 as response_debevec1997
from radiometer.analysis.response import linear_spline as response_linear_spline
from radiometer.analysis.response import mitsunaga1999 as response_mitsunaga1999
from radiometer.analysis.response import robertson1999 as response_robertson1999
from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.data.bracket import Bracket
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

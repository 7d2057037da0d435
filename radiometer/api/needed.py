"""Options that have no effect without another one: refused, so that no wish is dropped in silence."""

from __future__ import annotations

from typing import Any

from radiometer.errors import UsageError


def require_other(other: str, given: object, **dependents: Any) -> None:
    """Refuse options that have no effect without another one.

    Args:
        other: The option that they need, as it is typed.
        given: Whether it is there: None, False, 0 and "" count as absent.
        dependents: The options by the names of their arguments, with the values given.

    Raises:
        UsageError: If one of them is given and the other one is not.
    """
    if given:
        return
    for name, value in dependents.items():
        if value is not None and value is not False and value != 0:
            option = "--" + name.rstrip("_").replace("_", "-")
            raise UsageError(f"{option} has no effect without {other}: add {other}, or leave {option} out")

"""What the results of all functions have in common: one line, a table in a notebook, and the JSON of `--json`."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from typing import Any, Final

from radiometer.data.json_text import finite_or_null, json_text
from radiometer.progress import Progress as Progress

# Callbacks that functions take, besides `Progress`. An ask returns once somebody has done what it asks for. A notice is
# one line for the user.
Ask = Callable[[str], None]
Notice = Callable[[str], None]

_LONGEST_LIST: Final = 12  # entries of a list that a notebook shows; longer ones are counted


def unheard(line: str) -> None:
    """Drop a notice."""


class Result:
    """Base of what the functions return.

    `to_mapping` gives plain values, `to_json` the text that the command line prints with `--json`.
    """

    def to_mapping(self) -> dict[str, Any]:
        """Return the result as plain values."""
        raise NotImplementedError

    def to_json(self) -> str:
        """Return the documented JSON form in one line; what is not finite is null."""
        return json_text(self.to_mapping())

    def __repr__(self) -> str:
        """Return name and content in one line."""
        return f"<{type(self).__name__} {self}>"

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(repr(self))}</p>{_shown(finite_or_null(self.to_mapping()))}"


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        rows = "".join(f"<tr><th>{html.escape(str(key))}</th><td>{_shown(one)}</td></tr>" for key, one in value.items())
        return f"<table>{rows}</table>"
    if isinstance(value, list | tuple):
        if len(value) > _LONGEST_LIST:
            return f"{len(value)} entries"
        return "<br>".join(_shown(one) for one in value)
    return html.escape("–" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value))

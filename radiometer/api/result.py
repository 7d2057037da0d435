"""What the results of all functions have in common: one line, a table in a notebook, and the JSON of `--json`."""

from __future__ import annotations

import html
from abc import abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

from radiometer.api.files import PathLike
from radiometer.argument_types import with_checked_methods
from radiometer.data.drawing import own_axes, picture, write_figure
from radiometer.data.json_text import finite_or_null, json_text
from radiometer.errors import UsageError
from radiometer.progress import Progress as Progress

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Callbacks that functions take, besides `Progress`. An ask returns once somebody has done what it asks for. A notice is
# one line for the user.
Ask = Callable[[str], None]
Notice = Callable[[str], None]

_LONGEST_LIST: Final = 12  # entries of a list that a notebook shows; longer ones are counted


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


def unheard(line: str) -> None:
    """Drop a notice."""


class Result:
    """Base of what the functions return.

    `to_mapping` gives plain values, `to_json` the text that the command line prints with `--json`.
    """

    def __init_subclass__(cls, **named: Any) -> None:
        """Compare the arguments of every method with its annotations."""
        super().__init_subclass__(**named)
        with_checked_methods(cls)

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form, as plain values: all attributes by name, unless a result has another."""
        return self.plain(**vars(self))

    def plain(self, *names: str, **further: Any) -> dict[str, Any]:
        """Return attributes by name, and further entries, as plain values: what `to_mapping` is made of."""
        return {name: finite_or_null(one) for name, one in {**{n: getattr(self, n) for n in names}, **further}.items()}

    def to_json(self) -> str:
        """Return the documented JSON form in one line; what is not finite is null."""
        return json_text(self.to_mapping())

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self}>"

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(repr(self))}</p>{_shown(finite_or_null(self.to_mapping()))}"


class Drawn(Result):
    """Base of results that have a picture."""

    _inches: ClassVar[tuple[float, float] | None] = None  # size of the picture in a file; its usual one where None

    @abstractmethod
    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw it.

        Args:
            axes: Where to draw; a new figure by default.
        """

    def write_plot(self, path: PathLike) -> None:
        """Draw it into a PNG, PDF or SVG file. Raises UsageError for another ending, OutputError."""
        write_figure(Path(path), self.plot(own_axes()), self._inches)

    def _repr_html_(self) -> str:
        return picture(self.plot, repr(self))


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        rows = "".join(f"<tr><th>{html.escape(str(key))}</th><td>{_shown(one)}</td></tr>" for key, one in value.items())
        return f"<table>{rows}</table>"
    if isinstance(value, list | tuple):
        if len(value) > _LONGEST_LIST:
            return f"{len(value)} entries"
        return "<br>".join(_shown(one) for one in value)
    return html.escape("–" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value))

"""What the commands share in talking to people: tables, progress bars, notes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from radiometer.reporting.plain_text import printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress


def console(*, to_stderr: bool = False) -> Console:
    """Return a console; colour only on a terminal, and never under NO_COLOR."""
    from rich.console import Console
    from rich.text import Text

    class PlainConsole(Console):
        """A console whose texts cannot steer the terminal: remarks and serial numbers come from outside."""

        def render_str(self, text: str, **how: Any) -> Text:
            return super().render_str(printable(text), **how)

    return PlainConsole(stderr=to_stderr, highlight=False, soft_wrap=True)


def note(message: str) -> None:
    """Print a line on standard error, next to the result."""
    print(printable(message), file=sys.stderr)


@contextmanager
def progress_bar(*, shown: bool = True) -> Iterator[Progress]:
    """Show a progress bar on standard error while the block runs; nothing where that is no terminal."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console(to_stderr=True),
        transient=True,
        disable=not (shown and sys.stderr.isatty()),
    )
    with bar:
        yield bar


def significant(value: float, u: float) -> str:
    """Return a value with as many digits as its standard uncertainty allows: two digits of u."""
    import math

    if not (math.isfinite(value) and math.isfinite(u)) or u <= 0:
        return f"{value:.5g}"
    decimals = 1 - math.floor(math.log10(u))
    if value == 0:
        return f"{0.0:.{max(decimals, 0)}f}"
    magnitude = math.floor(math.log10(abs(value)))
    if -4 <= magnitude < 6 and 0 <= decimals <= 9:
        return f"{value:.{decimals}f}"
    return f"{value:.{max(0, magnitude + decimals)}e}"


@contextmanager
def progress(*, shown: bool = True) -> Iterator[Callable[[str, int, int | None], None]]:
    """Show a progress bar while the block runs; yield what takes the progress of a function of the library."""
    with progress_bar(shown=shown) as bar:
        task = bar.add_task("", total=None)
        yield lambda what, done, total: bar.update(task, description=what, completed=done, total=total)


def asker() -> Callable[[str], None] | None:
    """Return what asks at the terminal for something to be done by hand; None where there is no terminal."""
    if not sys.stdin.isatty():
        return None

    def ask(wish: str) -> None:
        import typer

        typer.confirm(f"{wish}. Done?", default=True, abort=True, err=True)

    return ask


def expanded(value: float, u: float, unit: str, k: float = 2.0) -> str:
    """Return "value ± U unit", to two digits of u."""
    return f"{significant(value, u)} ± {k * u:.2g} {unit}"

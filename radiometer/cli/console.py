"""What the commands share in talking to people: tables, progress bars, notes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from radiometer.reporting.plain_text import one_line, printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress


def console(*, to_stderr: bool = False) -> Console:
    """Return a console; colour only on a terminal, and never under NO_COLOR."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    class PlainConsole(Console):
        """A console whose texts cannot steer the terminal, and whose tables cut no number short.

        Remarks and serial numbers come from outside.
        """

        def print(self, *objects: Any, **how: Any) -> None:
            for one in objects:
                for column in one.columns if isinstance(one, Table) else ():
                    column.overflow, column.no_wrap = "fold", False
            super().print(*objects, **how)

        def render_str(self, text: str, **how: Any) -> Text:
            return super().render_str(printable(text), **how)

    return PlainConsole(stderr=to_stderr, highlight=False, soft_wrap=True)


def show_table(
    title: str, head: Sequence[str], rows: Iterable[Sequence[str]], words: Sequence[int] = (0,), *, bare: bool = False
) -> None:
    """Print a table, without lines where it is bare; columns of words stand to the left, those of figures right."""
    from rich.box import HEAVY_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None if bare else HEAVY_HEAD)
    for number, name in enumerate(head):
        table.add_column(name, justify="left" if number in words else "right")
    for row in rows:
        table.add_row(*row)
    console().print(table)


def show_lines(found: Any) -> None:
    """Print a result's lines."""
    for line in found.lines():
        console().print(line)


def show_remarks(assumptions: Iterable[str] = (), *, flags: Iterable[str] = (), warnings: Iterable[str] = ()) -> None:
    """Print what makes a result doubtful, then what was assumed, a line each."""
    out = console()
    for kind, texts in (("flag", flags), ("warning", warnings)):
        for text in texts:
            out.print(f"[yellow]{kind}[/yellow]: {one_line(text)}")
    for text in assumptions:
        out.print(f"assumed: {one_line(text)}")


def note(*lines: str) -> None:
    """Print lines on standard error, next to the result."""
    for line in lines:
        print(one_line(line), file=sys.stderr)


@contextmanager
def progress_bar(*, shown: bool = True) -> Iterator[Progress]:
    """Show a progress bar on standard error while the block runs; nothing where that is no terminal."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    bar = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console(to_stderr=True),
        transient=True,
        disable=not (shown and sys.stderr.isatty()),
    )
    with bar:
        yield bar


@contextmanager
def progress(*, shown: bool = True) -> Iterator[Callable[[str, int, int | None], None]]:
    """Show a progress bar while the block runs; yield what takes the progress of a function of the library."""
    with progress_bar(shown=shown) as bar:
        task = bar.add_task("", total=None)
        doing = [""]

        def show(what: str, done: int, total: int | None) -> None:
            what = one_line(what)  # it may be a name from outside
            if what != doing[0]:  # a new step: its time left is not that of the step before
                doing[0] = what
                bar.reset(task, description=what, completed=done, total=total)
            else:
                bar.update(task, completed=done, total=total)

        yield show


def asker() -> Callable[[str], None] | None:
    """Return what asks at the terminal for something to be done by hand; None where there is no terminal."""
    if not sys.stdin.isatty():
        return None

    def ask(wish: str) -> None:
        import typer

        typer.confirm(f"{one_line(wish)}. Done?", default=True, abort=True, err=True)

    return ask

"""Every command with its arguments and options, as the command line itself knows them: for completion and manuals."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import typer

from radiometer.cli.commands import COMMANDS, CommandEntry


@dataclass(frozen=True, slots=True)
class Word:
    """An argument or option.

    Attributes:
        names: ("--watch",), ("--from",), or ("OUT",) of an argument.
        takes: What stands for its value, such as "PATCH" of "--patch"; "" for a switch, or an argument.
        said: What it does.
        required: Whether it must be given.
    """

    names: tuple[str, ...]
    takes: str
    said: str
    required: bool


@dataclass(frozen=True, slots=True)
class CommandHelp:
    """One command as its own help tells it.

    Attributes:
        path: Words that lead to it, such as ("light", "set").
        summary: What it does, in one line.
        text: The whole help text; paragraphs apart by an empty line.
        arguments: What is given by position.
        options: What is given by name.
        below: Names of its own commands.
    """

    path: tuple[str, ...]
    summary: str
    text: str
    arguments: tuple[Word, ...] = ()
    options: tuple[Word, ...] = ()
    below: tuple[str, ...] = ()


def command_tree() -> Iterator[CommandHelp]:
    """Yield every command of the table, each followed by those below it."""
    yield from _of_table(COMMANDS, ())


def _of_table(table: Mapping[str, CommandEntry], path: tuple[str, ...]) -> Iterator[CommandHelp]:
    for name, entry in table.items():
        module, here = importlib.import_module(entry.module), (*path, name)
        if hasattr(module, "command"):
            app = typer.Typer(add_completion=False)
            app.command(name=name)(module.command)
            yield from _below(typer.main.get_command(app), here, entry.summary)
        elif isinstance(module.app, typer.Typer):
            yield from _below(typer.main.get_command(module.app), here, entry.summary)
        else:  # a table of its own, each line a module
            yield CommandHelp(here, entry.summary, entry.summary, below=tuple(module.DEVICES))
            yield from _of_table(module.DEVICES, here)


def _below(found: Any, path: tuple[str, ...], summary: str) -> Iterator[CommandHelp]:
    inner = getattr(found, "commands", {})
    arguments = tuple(_word(one) for one in found.params if one.param_type_name == "argument")
    options = tuple(_word(one) for one in found.params if one.param_type_name == "option")
    text = inspect.cleandoc(found.help or summary)
    yield CommandHelp(path, summary, text, arguments, options, tuple(inner))
    for name, single in inner.items():
        yield from _below(single, (*path, name), _first_line(single.help))


def _word(one: Any) -> Word:
    said = " ".join((one.help or "").split())
    if one.param_type_name == "argument":
        name = (one.metavar or one.name.rstrip("_")).upper().strip("[]")
        return Word((f"{name}…" if one.nargs == -1 else name,), "", said, bool(one.required))
    longest = max(one.opts, key=len).lstrip("-")
    takes = "" if one.is_flag or one.count else str(one.metavar or longest).upper()
    return Word((*one.opts, *one.secondary_opts), takes, said, bool(one.required))


def _first_line(text: str | None) -> str:
    return (text or "").strip().partition("\n")[0]

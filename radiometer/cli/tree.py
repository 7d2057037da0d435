"""The table of commands as one Typer group: for running, completion and manuals."""

from __future__ import annotations

import importlib
import inspect
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from radiometer.cli.commands import COMMANDS
from radiometer.cli.options import Commands


def application(name: str) -> Any:
    """Return one command of the table, ready to run; its module is imported now."""
    module = importlib.import_module(COMMANDS[name].module)
    if hasattr(module, "command"):
        app = Commands()
        app.command(name=name, context_settings={"help_option_names": ["-h", "--help"]})(module.command)
    else:
        app = module.app
    command = typer.main.get_command(app)
    command.name, command.short_help = name, COMMANDS[name].summary
    _require_finite(command)
    return command


def _require_finite(command: Any) -> None:
    """Let no option of a command, and of those below it, take nan or infinity: a limit lets nan pass."""
    for one in command.params:
        one.callback = one.callback or _finite
    for inner in getattr(command, "commands", {}).values():
        _require_finite(inner)


def _finite(context: Any, parameter: Any, value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is no finite number", ctx=context, param=parameter)
    return value


class Table(TyperGroup):
    """The whole table; a command is imported when it is asked for, not when it is listed."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by name and summary alone; None where there is none."""
        if cmd_name not in COMMANDS:
            return None
        return TyperCommand(cmd_name, short_help=COMMANDS[cmd_name].summary)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return (name, command, further words); the command is imported now."""
        name, _, words = super().resolve_command(ctx, args)
        return name, application(str(name)), words


def group() -> Any:
    """Return the group of all commands, for a shell's completion."""
    app = typer.Typer(cls=Table, rich_markup_mode=None)
    app.callback()(lambda: None)
    return typer.main.get_command(app)


@dataclass(frozen=True, slots=True)
class CommandHelp:
    """One command as its own help describes it."""

    path: tuple[str, ...]  # words that lead to it, such as ("light", "set")
    text: str  # the whole help text; paragraphs apart by an empty line
    arguments: tuple[tuple[str, str], ...]  # what is given by position: how it is written, and what it does
    options: tuple[tuple[str, str], ...]  # what is given by name, likewise
    below: tuple[str, ...]  # names of the commands below it


def command_tree() -> Iterator[CommandHelp]:
    """Yield every command of the table, each followed by those below it."""
    for name in COMMANDS:
        yield from _below(application(name), (name,), None)


def _below(command: Any, path: tuple[str, ...], parent: Any) -> Iterator[CommandHelp]:
    context = command.make_context(path[-1], [], parent=parent, resilient_parsing=True)
    records = [(one, *_record(one, context)) for one in command.params if one.name != "help"]
    arguments = tuple((name, help_text) for one, name, help_text in records if one.param_type_name == "argument")
    options = tuple((name, help_text) for one, name, help_text in records if one.param_type_name == "option")
    text = inspect.cleandoc(command.help or command.short_help or "")
    inner = getattr(command, "commands", {})
    yield CommandHelp(path, text, arguments, options, tuple(inner))
    for name, single in inner.items():
        yield from _below(single, (*path, name), context)


def _record(one: Any, context: Any) -> tuple[str, str]:
    """Return how an argument or option is written and what it does, as its help prints both."""
    if one.param_type_name == "argument":
        return " ".join(one.get_usage_pieces(context)), " ".join((one.help or "").split())
    name, help_text = one.get_help_record(context)
    return name, " ".join(help_text.split())

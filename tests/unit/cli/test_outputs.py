"""Every command that writes checks its outputs before its work: their folder, and that nothing is overwritten."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from radiometer.cli.commands import COMMANDS
from radiometer.cli.main import run

_WRITES = re.compile(r"\b(write|written(?! by)|draw|drawn|create|keep the frames)\b", re.IGNORECASE)
_JOURNALS = {("batch", "out"), ("adapt run", "out"), ("serve", "journal")}  # taken up where they end, never replaced


def _leaves(path: tuple[str, ...], found: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    inner = getattr(found, "commands", None)
    if not inner:
        yield path, found
    for name, single in (inner or {}).items():
        yield from _leaves((*path, name), single)


def _commands() -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, entry in COMMANDS.items():
        module = importlib.import_module(entry.module)
        if hasattr(module, "command"):
            app = typer.Typer()
            app.command(name=name)(module.command)
            yield (name,), typer.main.get_command(app)
        elif isinstance(module.app, typer.Typer):
            yield from _leaves((name,), typer.main.get_command(module.app))


_ALL = list(_commands())
_OUTPUTS = [
    pytest.param(path, command, name, id=f"{'-'.join(path)}-{name}")
    for path, command in _ALL
    for name in (
        *getattr(command.callback, "output_files", ()),
        *filter(None, [getattr(command.callback, "output_folder", None)]),
    )
]


def _words(path: tuple[str, ...], command: Any, name: str, target: Path) -> list[str]:
    """Return a call in which everything required is given, and one output."""
    words = list(path)
    for one in command.params:
        value = str(target) if one.name == name else "1" if one.required else None
        if value is not None:
            words += [value] if one.param_type_name == "argument" else [one.opts[0], value]
    return words


def test_every_option_that_names_an_output_is_checked() -> None:
    """By the words of its help: what writes, draws, creates or keeps is declared, or asks for --force itself."""
    unchecked = [
        f"{' '.join(path)} {one.name}"
        for path, command in _ALL
        for one in command.params
        if "Path" in str(one.type_descriptor.annotation) and _WRITES.search(one.help or "")
        if one.name not in getattr(command.callback, "output_files", ())
        if one.name != getattr(command.callback, "output_folder", None)
        if (" ".join(path), one.name) not in _JOURNALS
    ]
    assert unchecked == []


@pytest.mark.parametrize(("path", "command", "name"), _OUTPUTS)
def test_an_output_is_checked_before_the_work(
    path: tuple[str, ...], command: Any, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder that is missing and a file that is there: exit code 2, one line, and the file stays as it was."""
    assert run(_words(path, command, name, tmp_path / "absent" / "out.yaml")) == 2
    assert "absent does not exist" in capsys.readouterr().err
    there = tmp_path / "there.yaml"
    there.write_text("precious")
    assert run(_words(path, command, name, there)) == 2
    assert "there.yaml exists already" in capsys.readouterr().err
    assert there.read_text() == "precious"
    is_folder = getattr(command.callback, "output_folder", None) == name
    assert is_folder or any("--force" in one.opts for one in command.params)

"""Every command that writes checks its outputs before its work: their folder, and that nothing is overwritten."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from radiometer.bench.boxes import calibration_file
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


def test_every_option_that_names_an_output_is_checked():
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
def test_an_output_is_checked_before_the_work(path, command, name, tmp_path, capsys):
    """A folder that is missing and a file that is there: exit code 2, one line, and the file stays as it was."""
    is_folder = getattr(command.callback, "output_folder", None) == name  # made with those above it
    if not is_folder:
        assert run(_words(path, command, name, tmp_path / "absent" / "out.yaml")) == 2
        assert "absent does not exist" in capsys.readouterr().err
    there = tmp_path / "there.yaml"
    there.write_text("precious")
    assert run(_words(path, command, name, there)) == 2
    assert "there.yaml exists already" in capsys.readouterr().err
    assert there.read_text() == "precious"
    assert is_folder or any("--force" in one.opts for one in command.params)


@pytest.mark.parametrize(
    ("words", "precious"),
    [
        ("merge set -o set/frames/0.png", "set/frames/0.png"), ("response set -o set/capture.yaml", "set/capture.yaml"),
        ("merge photos -o photos/a.png", "photos/a.png"), ("adapt fit f.csv --csv f.csv", "f.csv"),
        ("adapt fit f.csv --report link.csv", "f.csv"),
    ],
)  # fmt: skip
def test_no_output_replaces_an_input(words, precious, tmp_path, monkeypatch, capsys):
    """Not with --force either, under whatever name: exit code 2 and the file as it was."""
    monkeypatch.chdir(tmp_path)
    for name in ("set/frames/0.png", "set/capture.yaml", "photos/a.png", "f.csv"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text("file: frames/0.png")
    Path("link.csv").symlink_to("f.csv")
    assert run([*words.split(), "--force"]) == 2
    assert "no input is replaced" in capsys.readouterr().err
    assert Path(precious).read_text() == "file: frames/0.png"


def test_no_command_replaces_a_file_unasked():
    """--force is off unless it is given, in every command that has it."""
    asked = {" ".join(path): one.default for path, command in _ALL for one in command.params if "--force" in one.opts}
    assert len(asked) > 20
    assert {name for name, default in asked.items() if default} == set()


_HOSTILE = ("..", "../../out", "/etc/x", "a/b", "-o", ".hidden", "x" * 300, "a\0b", "")


@pytest.mark.parametrize("serial", _HOSTILE)
def test_a_box_cannot_choose_where_its_calibration_is_written(serial, tmp_path, monkeypatch):
    """Whatever serial number it sends: one file in the folder for them."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert calibration_file(serial).resolve().parent == tmp_path / "radiometer" / "light_boxes"


def test_a_file_cannot_choose_where_its_frames_are_written(tmp_path):
    """Whatever camera name a FITS header states: every capture set is a separate folder in that of -o."""
    fits = pytest.importorskip("astropy.io.fits")
    source, out = tmp_path / "source", tmp_path / "a" / "out"
    source.mkdir()
    out.parent.mkdir()
    names = [name for name in _HOSTILE if len(name) < 60 and name.isprintable()]
    for number, name in enumerate(names):
        unit = fits.PrimaryHDU(np.full((6, 8), 100 + number, np.int16))
        unit.header["INSTRUME"], unit.header["EXPTIME"] = name, 1.0
        unit.writeto(source / f"{number}.fits")
    before = {path for path in tmp_path.rglob("*") if not path.is_relative_to(out)}
    assert run(["import", str(source), "-o", str(out)]) == 0
    assert {path for path in tmp_path.rglob("*") if not path.is_relative_to(out)} == before
    assert len([path for path in out.iterdir() if (path / "capture.yaml").is_file()]) == len(names)


def test_a_file_that_is_no_journal_is_never_emptied(tmp_path, monkeypatch, capsys):
    """`adapt run -o` takes up a journal, also one whose first line a crash tore; a text without a line end stays."""
    monkeypatch.chdir(tmp_path)
    words = ["adapt", "run", "quick", "--subject", "S01", "--simulate", "steady", "-o"]
    for content in ("precious", "precious\n", '{"a": 1}'):
        Path("notes.txt").write_text(content)
        assert run([*words, "notes.txt"]) != 0
        assert Path("notes.txt").read_text() == content
    assert "no journal of a measurement" in capsys.readouterr().err
    Path("torn.jsonl").write_text('{"sequence": 0, "ki')
    assert run([*words, "torn.jsonl"]) == 0

"""The command line's frame: lazy, quick to help, one-line errors, exit codes 0, 1 and 2."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

from radiometer.cli.commands import COMMANDS
from radiometer.cli.main import run
from radiometer.daemon.journal import Journal


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_listed_command_explains_itself(name, capsys):
    """Each line of the table leads to a module with a help text."""
    assert run([name, "--help"]) == 0
    assert "Usage" in capsys.readouterr().out


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_is_documented(name):
    """A command's module says what it does."""
    assert importlib.import_module(COMMANDS[name].module).__doc__


@pytest.mark.slow
def test_the_overview_imports_nothing_heavy():
    """Help must come at once: neither NumPy nor typer may be loaded for it."""
    script = (
        "import sys; from radiometer.cli.main import run; run(['--help']);"
        "heavy = {'numpy', 'scipy', 'cv2', 'typer', 'rich', 'pydantic', 'matplotlib'} & set(sys.modules);"
        "sys.exit(repr(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert "measure" in done.stdout


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["mesure"], 2, "did you mean 'measure'"),
        (["measure", "--patch", "1,2,3"], 2, "expected X,Y,W,H"),
        (["measure", "--nonsense"], 2, "No such option"),
        (["measure", "--bench", "absent.yaml"], 2, "cannot read absent.yaml"),
        ([], 2, "Commands:"),
    ],
)
def test_misuse_gets_one_clear_line_and_code_two(words, code, message, capsys):
    """No traceback reaches a user."""
    assert run(words) == code
    printed = capsys.readouterr().err
    assert message in printed
    assert "Traceback" not in printed


def test_version_is_reported(capsys):
    """`--version` prints name and number."""
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.startswith("radiometer ")


def test_texts_from_outside_do_not_steer_the_terminal(tmp_path, capsys):
    """A remark and a file name with escape characters: on standard output and in an error they are written out."""
    journal = Journal(tmp_path / "journal.sqlite")
    journal.open()
    journal.note("remark", "lamp\x1b]0;title\x07 [/bold] changed\nreading 1: 5 W")
    journal.close()
    assert run(["log", str(tmp_path / "journal.sqlite"), "--events"]) == 0
    assert run(["merge", "a\x1b[2Jb", "-o", str(tmp_path / "map.exr")]) != 0
    printed = capsys.readouterr()
    assert ("\x1b" in printed.out + printed.err, printed.out.count("\n")) == (False, 1)
    assert "\\x1b]0;title" in printed.out
    assert "a\\x1b[2Jb" in printed.err

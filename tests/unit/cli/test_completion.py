"""Completion: real bash completes commands, options of a command, and commands below it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from radiometer.cli.main import run

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def scripts(tmp_path: Path) -> Path:
    """Return a folder with a program `radiometer` that is this checkout."""
    program = tmp_path / "radiometer"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m radiometer "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    return tmp_path


def environment(scripts: Path, **more: str) -> dict[str, str]:
    """Return the environment of a shell that finds the program."""
    found = {**os.environ, **more, "PATH": f"{scripts}:{os.environ['PATH']}"}
    return found | {"PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        (("re",), {"response", "reconcile"}),
        (("measure", "--ph"), {"--photographs"}),
        (("merge", "--ph"), set()),
        (("light", "cal"), {"calibrate"}),
        (("light", "calibrate", "--see"), {"--seed"}),
    ],
)
def test_bash_completes_commands_and_options(line, offered, scripts, capsys):
    """The script that is printed makes bash offer what begins as typed, and no other command's option."""
    assert run(["completion", "bash"]) == 0
    words = " ".join(f'"{word}"' for word in ("radiometer", *line))
    asked = (
        f"COMP_WORDS=({words}); COMP_CWORD={len(line)}; _radiometer_completion radiometer; "
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "-c", capsys.readouterr().out + asked],
        capture_output=True, text=True, check=True, env=environment(scripts),
    )  # fmt: skip
    assert set(done.stdout.split()) == offered


@pytest.mark.slow
@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_zsh_and_fish_get_options_with_what_they_do(shell, scripts, capsys):
    """Their scripts ask the program; it answers with each option and its help."""
    assert run(["completion", shell]) == 0
    assert "_RADIOMETER_COMPLETE" in capsys.readouterr().out
    asked = {"_TYPER_COMPLETE_ARGS": "radiometer measure --ph", "_RADIOMETER_COMPLETE": f"complete_{shell}"}
    more = {"_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    done = subprocess.run(
        ["radiometer"], capture_output=True, text=True, check=True, env=environment(scripts, **asked, **more)
    )
    assert "--photographs" in done.stdout
    assert "Folder of photographs" in done.stdout


def test_another_shell_is_misuse(capsys):
    """The message names those that there are."""
    assert run(["completion", "tcsh"]) == 2
    assert "choose one of bash, zsh, fish" in capsys.readouterr().err

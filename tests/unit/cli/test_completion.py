"""Completion: real bash completes commands, options of a command, and commands below it."""

from __future__ import annotations

import subprocess

import pytest

from radiometer.cli.admin.completion import all_words, bash, fish, zsh
from radiometer.cli.commands import COMMANDS
from radiometer.cli.main import run


@pytest.fixture(scope="module")
def words():
    """Return the words of all commands."""
    return list(all_words())


def completed(script: str, *line: str) -> set[str]:
    """Return what bash offers for the last word of a line."""
    quoted = " ".join(f'"{word}"' for word in line)
    asked = f'COMP_WORDS=({quoted}); COMP_CWORD={len(line) - 1}; _radiometer; printf "%s\\n" "${{COMPREPLY[@]}}"'
    done = subprocess.run(["bash", "-c", script + asked], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.slow
def test_bash_completes_a_command(words):
    """`radiometer re` gives the two that begin so."""
    assert completed(bash(words), "radiometer", "re") == {"response", "reconcile"}


@pytest.mark.slow
def test_bash_completes_an_option_of_the_command(words):
    """`radiometer measure --ph` gives its option, not another command's."""
    assert completed(bash(words), "radiometer", "measure", "--ph") == {"--photographs"}
    assert completed(bash(words), "radiometer", "merge", "--ph") == set()


@pytest.mark.slow
def test_bash_completes_a_command_below_a_command(words):
    """`radiometer light c` gives `calibrate`; its options follow it."""
    script = bash(words)
    assert completed(script, "radiometer", "light", "cal") == {"calibrate"}
    assert "--seed" in completed(script, "radiometer", "light", "calibrate", "--s")


def test_every_command_stands_in_every_shell(words):
    """Each command and its options are offered by zsh and fish, too."""
    for name in COMMANDS:
        assert f"'{name}:" in zsh(words)
        assert f"-a {name} -d '" in fish(words)
    assert "-n '__fish_seen_subcommand_from measure' -l photographs -d 'Folder" in fish(words)
    assert "'--photographs:Folder" in zsh(words)


def test_another_shell_is_misuse(capsys):
    """The message names those that there are."""
    assert run(["completion", "tcsh"]) == 2
    assert "choose one of bash, zsh, fish" in capsys.readouterr().err

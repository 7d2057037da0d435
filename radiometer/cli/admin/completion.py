"""`radiometer completion`: the words of all commands and options, for bash, zsh or fish."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Final

import typer

from radiometer.cli.admin.command_tree import command_tree
from radiometer.cli.commands import COMMANDS
from radiometer.errors import UsageError

_HELP: Final = ("--help", "Show what it does and leave.")


@dataclass(frozen=True, slots=True)
class Words:
    """What may follow one command.

    Attributes:
        path: Words that lead to it, such as ("light", "set"); the first is a command.
        summary: What it does, in one line.
        options: Options with what they do.
        below: Names of its own commands.
    """

    path: tuple[str, ...]
    summary: str
    options: tuple[tuple[str, str], ...]
    below: tuple[str, ...]


def command(
    shell: Annotated[str, typer.Argument(help="bash, zsh or fish.")],
) -> None:
    """Print what makes a shell complete commands and options.

    bash: `radiometer completion bash > ~/.local/share/bash-completion/completions/radiometer`; zsh: `radiometer
    completion zsh > ~/.zfunc/_radiometer` with ~/.zfunc in fpath; fish: `radiometer completion fish >
    ~/.config/fish/completions/radiometer.fish`. File names are completed wherever no option fits.
    """
    if shell not in WRITERS:
        raise UsageError(f"there is no completion for {shell!r}; choose one of {', '.join(WRITERS)}")
    print(WRITERS[shell](list(all_words())), end="")


def all_words() -> Iterator[Words]:
    """Yield the words of every command and of the commands below it."""
    for one in command_tree():
        options = [(name, word.said) for word in one.options for name in word.names if name.startswith("--")]
        yield Words(one.path, one.summary, (*options, _HELP), one.below)


def bash(words: list[Words]) -> str:
    """Return a completion function for bash."""
    cases = "\n".join(
        f'    "{" ".join(one.path)}") words="{" ".join((*one.below, *(o for o, _ in one.options)))}" ;;'
        for one in words
    )
    groups = "|".join(one.path[0] for one in words if one.below)
    return f"""\
_radiometer() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" path="${{COMP_WORDS[1]}}" words=""
  case "$path" in {groups}) [ "$COMP_CWORD" -gt 2 ] && path="$path ${{COMP_WORDS[2]}}" ;; esac
  [ "$COMP_CWORD" -eq 1 ] && path=""
  case "$path" in
    "") words="{" ".join(COMMANDS)} --help --version --verbose" ;;
{cases}
  esac
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o bashdefault -o default -F _radiometer radiometer
"""


def zsh(words: list[Words]) -> str:
    """Return a completion function for zsh: commands and options with what they do, and file names."""
    top = "\n".join(f"    {_zsh_word(name, entry.summary)}" for name, entry in COMMANDS.items())
    cases = "\n".join(_zsh_case(one) for one in words)
    groups = "|".join(one.path[0] for one in words if one.below)
    return f"""\
#compdef radiometer
_radiometer() {{
  local path="$words[2]"
  local -a offered
  case "$path" in {groups}) (( CURRENT > 3 )) && path="$path $words[3]" ;; esac
  if (( CURRENT == 2 )); then
    offered=(
{top}
    )
    _describe command offered
    return
  fi
  case "$path" in
{cases}
  esac
  _describe -o option offered
  _files
}}
_radiometer "$@"
"""


def _zsh_case(one: Words) -> str:
    offered = " ".join((*(_zsh_word(name, "") for name in one.below), *(_zsh_word(*option) for option in one.options)))
    return f'    "{" ".join(one.path)}") offered=({offered}) ;;'


def _zsh_word(name: str, said: str) -> str:
    return "'" + f"{name}:{said}".rstrip(":").replace("'", "'\\''") + "'"


def fish(words: list[Words]) -> str:
    """Return completions for fish: commands and options with what they do."""
    lines = [
        f"complete -c radiometer -f -n __fish_use_subcommand -a {name} -d {_fish(entry.summary)}"
        for name, entry in COMMANDS.items()
    ]
    for one in words:
        there = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in one.path)
        lines += [f"complete -c radiometer -n '{there}' -a {name}" for name in one.below]
        lines += [
            f"complete -c radiometer -n '{there}' -l {option.removeprefix('--')} -d {_fish(said)}"
            for option, said in one.options
        ]
    return "\n".join(lines) + "\n"


def _fish(said: str) -> str:
    return "'" + said.replace("\\", "\\\\").replace("'", "\\'") + "'"


WRITERS: Final[dict[str, Callable[[list[Words]], str]]] = {"bash": bash, "zsh": zsh, "fish": fish}

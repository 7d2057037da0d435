"""`radiometer completion`: what makes bash, zsh or fish complete commands and options."""

from __future__ import annotations

from typing import Annotated, Final

import typer

from radiometer.cli.commands import COMPLETING
from radiometer.errors import UsageError

_SHELLS: Final = ("bash", "zsh", "fish")


def command(shell: Annotated[str, typer.Argument(help="bash, zsh or fish.")]) -> None:
    """Print what makes a shell complete commands and options.

    bash: `radiometer completion bash > ~/.local/share/bash-completion/completions/radiometer`; zsh: `radiometer
    completion zsh > ~/.zfunc/_radiometer` with ~/.zfunc in fpath; fish: `radiometer completion fish >
    ~/.config/fish/completions/radiometer.fish`. File names are completed wherever no option fits.
    """
    from typer.completion import shell_complete

    from radiometer.cli.tree import group

    if shell not in _SHELLS:
        raise UsageError(f"there is no completion for {shell!r}; choose one of {', '.join(_SHELLS)}")
    shell_complete(group(), {}, "radiometer", COMPLETING, f"source_{shell}")

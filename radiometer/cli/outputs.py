"""The options of a command that name files it writes: checked before its work starts, and `--force` to replace them."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

_Command = TypeVar("_Command", bound=Callable[..., Any])
_FORCE = inspect.Parameter(
    "force",
    inspect.Parameter.KEYWORD_ONLY,
    default=False,
    annotation=Annotated[bool, typer.Option("--force", help="Replace output files that exist.")],
)


def writes(*files: str, folder: str | None = None) -> Callable[[_Command], _Command]:
    """Return a decorator that checks the outputs of a command before it runs, and gives it `--force`.

    Args:
        files: Names of its parameters that name files to write; none where only a folder is filled.
        folder: Name of its parameter that names a folder to create, which is never replaced.
    """

    def decorate(command: _Command) -> _Command:
        signature = inspect.signature(command, eval_str=True)
        parameters = list(signature.parameters.values())
        asks_itself = "force" in signature.parameters  # it writes further files, whose names it finds out

        @functools.wraps(command)
        def checked(*args: Any, force: bool = False, **kwargs: Any) -> Any:
            from radiometer.api.files import check_new_folder, check_outputs, new_files_stay_new, refuse_inputs

            given = signature.bind(*args, **kwargs, **({"force": force} if asks_itself else {}))
            given.apply_defaults()
            outputs = [path for name in files for path in _paths(given.arguments[name])]
            with new_files_stay_new():
                check_outputs(*outputs, force=force)
                read = [path for name, value in given.arguments.items() if name not in files for path in _read(value)]
                refuse_inputs(outputs, read)
                if folder is not None and given.arguments[folder] is not None:
                    check_new_folder(Path(given.arguments[folder]))
                return command(*given.args, **given.kwargs)

        if files and not asks_itself:
            parameters.append(_FORCE)
        checked.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        checked.output_files, checked.output_folder = files, folder  # type: ignore[attr-defined]
        return checked  # type: ignore[return-value]

    return decorate


def _paths(value: Any) -> Iterable[Path]:
    if value is None or isinstance(value, str | Path):
        return () if value is None else (Path(value),)
    return (Path(one) for one in value)


def _read(value: Any) -> Iterable[Path]:
    """Return the files and folders that an argument names, alone or in a list."""
    several = value if isinstance(value, list | tuple) else (value,)
    return (one for one in several if isinstance(one, Path))

"""Commands made of a public function: its signature gives arguments and options, its docstring their help."""

from __future__ import annotations

import copy
import inspect
import os
import re
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

import typer

import radiometer as rm
from radiometer.cli.console import asker, note, progress
from radiometer.cli.options import JsonOption
from radiometer.cli.outputs import writes

_PAGE: Final = "open this address on the screen to be measured, then press Start:\n  {}"
_HANDED: Final = ("notice", "progress", "ask", "announce")  # parameters that the terminal serves
_ARGS: Final = re.compile(r"^ {4}(\w+): (.+(?:\n {8}.+)*)", re.MULTILINE)
_DRAWN: Final = {
    "plot": "Picture to draw: PNG, PDF or SVG.",
    "csv": "Table of the figures to write.",
    "report": "Report (HTML) to write: outcome, pictures, figures.",
}


def command_of(
    name: str,
    show: Callable[[Any], None],
    *,
    files: Sequence[str] = (),
    results: Sequence[str] = (),
    defaults: Mapping[str, Any] | None = None,
    converters: Mapping[str, Callable[[Sequence[str]], Any]] | None = None,
    **options: Any,
) -> Callable[..., None]:
    """Return the command of a public function, ready for typer.

    Options are in the order of its parameters, then the files that its result writes, then `--json`. A parameter
    without a default is an argument; help is that of the docstring unless an option states another.

    Args:
        name: Name of the function in `radiometer`.
        show: Prints its result for people.
        files: Parameters that name files which the function writes.
        results: Files that the result writes by `write_…`: "plot", "csv", "report".
        defaults: Defaults of the command where the function has others.
        converters: By parameter, what makes its value of the words of an option that may be repeated.
        options: By parameter, `typer.Option` or `typer.Argument` with what the command line has beyond the signature:
            another name, limits, a parser of words; or a whole annotation that commands share.
    """
    function = getattr(rm, name)
    taken = inspect.signature(function, eval_str=True).parameters
    text, helps = _documented(function)
    parameters = [
        inspect.Parameter(
            one.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=(defaults or {}).get(one.name, None if one.default == () else one.default),
            annotation=_annotation(one, options.get(one.name), helps[one.name]),
        )
        for one in taken.values()
        if one.name not in _HANDED
    ]
    further: dict[str, tuple[Any, Any]] = {
        **{one: (None, Annotated[Path | None, typer.Option(help=_DRAWN[one])]) for one in results},
        "json": (False, JsonOption),
    }
    parameters += [
        inspect.Parameter(one, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for one, (default, kind) in further.items()
    ]

    def command(*, json: bool = False, **given: Any) -> None:
        written = {one: given.pop(one) for one in results}
        with progress(shown="progress" in taken and not json) as shown:
            served = {"notice": note, "progress": shown, "announce": lambda url: note(_PAGE.format(url))}
            served |= {"ask": asker()} if "ask" in taken else {}
            stated = {one: value for one, value in given.items() if value is not None and value != []}
            stated |= {one: of(stated[one]) for one, of in (converters or {}).items() if one in stated}
            found = function(**stated, **{one: served[one] for one in _HANDED if one in taken})
        for one, file in written.items():
            if file is not None:
                getattr(found, f"write_{one}")(file)
        for file in (*(given[one] for one in files), *written.values()):
            if file is not None:
                note(f"wrote {file}")
        print(found.to_json()) if json else show(found)

    command.__doc__ = text
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    return writes(*files, *results)(command)


def _documented(function: Any) -> tuple[str, dict[str, str]]:
    """Return the text of a docstring before its sections, and what it says of each argument."""
    doc = inspect.getdoc(function) or ""
    said = _ARGS.findall(doc.partition("\nArgs:\n")[2].partition("\n\n")[0])
    return re.split(r"\n\n[A-Z]\w+:\n", doc)[0], {name: " ".join(text.split()) for name, text in said}


def _annotation(parameter: inspect.Parameter, stated: Any, said: str) -> Any:
    """Return the annotation that typer reads of a parameter, as the command line writes it."""
    if stated is not None and get_origin(stated) is Annotated:
        return stated
    flag = (f"--{parameter.name.replace('_', '-')}",) if parameter.annotation is bool else ()
    info = copy.copy(stated) if stated is not None else typer.Option(*flag)
    info.help = info.help or said
    kind = str if info.parser is not None else _kind(parameter.annotation)
    return Annotated[kind if parameter.default not in (None, ()) else kind | None, info]


def _kind(annotation: Any) -> Any:
    """Return the type of one word, or of a list of words, of what a parameter takes."""
    union = get_origin(annotation) in (Union, types.UnionType)
    kinds = [one for one in (get_args(annotation) if union else (annotation,)) if one is not type(None)]
    for kind in kinds:
        if get_origin(kind) is Literal or kind in (bool, int, float):
            return kind
        if get_origin(kind) is os.PathLike:
            return Path
    return list[str] if any(get_origin(kind) in (Sequence, Mapping, list) for kind in kinds) else str

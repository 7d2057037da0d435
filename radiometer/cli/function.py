"""Commands made of a public function: its signature gives arguments and options, its docstring their help."""

from __future__ import annotations

import ast
import copy
import importlib.util
import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, get_args, get_origin

import typer

import radiometer as rm
from radiometer import plausible
from radiometer.cli.console import asker, note, progress
from radiometer.cli.options import JsonOption
from radiometer.cli.outputs import writes

_PAGE: Final = "open this address on the screen to be measured, then press Start:\n  {}"
_HANDED: Final = ("notice", "progress", "ask", "announce")  # parameters that the terminal serves
_ARGS: Final = re.compile(r"^ {4}(\w+): (.+(?:\n {8}.+)*)", re.MULTILINE)
# What one word becomes, by the first that its annotation names; several words become a list.
_KINDS: Final = {
    "PathLike": Path,
    "bool": bool,
    "int": int,
    "float": float,
    "Sequence": list[str],
    "Mapping": list[str],
    **{name: of for name, of in vars(plausible).items() if get_origin(of) is Annotated},
}
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
    without a default is an argument; help is that of the docstring unless an option states another. The function is
    read as text: to import it takes a second, which every `--help` and completion would wait for.

    Args:
        name: Name of the function in `radiometer`.
        show: Prints its result for people.
        files: Parameters that name files which the function writes.
        results: Files that the result writes by `write_…`: "plot", "csv", "report".
        defaults: Defaults of the command where the function has others.
        converters: By parameter, what makes its value of the words of an option that may be repeated.
        options: By parameter, `typer.Option` or `typer.Argument` with what the command line has beyond the signature:
            another name, limits, a parser of words; or a whole annotation, with its own type.
    """
    text, helps, taken = _described(name)
    changed = {one: (taken[one][0], default) for one, default in (defaults or {}).items()}
    parameters = [
        inspect.Parameter(
            one,
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=_annotation(one, kind, default, options.get(one), helps[one]),
        )
        for one, (kind, default) in {**taken, **changed}.items()
        if one not in _HANDED
    ]
    further: dict[str, tuple[Any, Any]] = {
        **{one: (None, Annotated[Path | None, typer.Option(help=_DRAWN[one])]) for one in results},
        "json": (False, JsonOption),
    }
    parameters += [
        inspect.Parameter(one, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for one, (default, kind) in further.items()
    ]
    parameters.sort(key=lambda one: one.name == "force")  # last, as `writes` has it

    def command(*, json: bool = False, **given: Any) -> None:
        written = {one: given.pop(one) for one in results}
        with progress(shown="progress" in taken and not json) as shown:
            served: dict[str, Any] = {
                "notice": note,
                "progress": shown,
                "announce": lambda url: note(_PAGE.format(url)),
            }
            served |= {"ask": asker()} if "ask" in taken else {}
            stated = {one: value for one, value in given.items() if value is not None and value != []}
            stated |= {one: of(stated[one]) for one, of in (converters or {}).items() if one in stated}
            found = getattr(rm, name)(**stated, **{one: served[one] for one in _HANDED if one in taken})
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


def _described(name: str) -> tuple[str, dict[str, str], dict[str, tuple[str, Any]]]:
    """Return a function's text before the sections of its docstring, then by parameter: help, annotation and default.

    None replaces defaults that are no plain value, and empty ones.
    """
    home = importlib.util.find_spec(rm.home_of(name))
    source = Path(str(home and home.origin)).read_text(encoding="utf-8")
    function = next(one for one in ast.parse(source).body if isinstance(one, ast.FunctionDef) and one.name == name)
    doc = ast.get_docstring(function) or ""
    arguments = _ARGS.findall(doc.partition("\nArgs:\n")[2].partition("\n\n")[0])
    plain, named = function.args.args, function.args.kwonlyargs
    required = [inspect.Parameter.empty] * (len(plain) - len(function.args.defaults))
    values = [*required, *map(_value, function.args.defaults), *map(_value, function.args.kw_defaults)]
    taken = {
        one.arg: (ast.unparse(one.annotation) if one.annotation else "", value)
        for one, value in zip((*plain, *named), values, strict=True)
    }
    return re.split(r"\n\n[A-Z]\w+:\n", doc)[0], {one: " ".join(text.split()) for one, text in arguments}, taken


def _value(default: ast.expr | None) -> Any:
    if default is None:
        return inspect.Parameter.empty
    return default.value if isinstance(default, ast.Constant) else None


def _annotation(name: str, kind: str, default: Any, stated: Any, text: str) -> Any:
    """Return the annotation that typer reads of a parameter, as the command line writes it."""
    whole = get_origin(stated) is Annotated
    info = copy.copy(get_args(stated)[-1] if whole else stated or typer.Option())
    if kind == "bool" and not info.param_decls:  # without its opposite
        info.param_decls = (f"--{name.replace('_', '-')}",)
    info.help = info.help or text
    if whole:
        return Annotated[(*get_args(stated)[:-1], info)]
    names = re.findall(r"\w+", kind)
    word = str if info.parser else next((_KINDS[one] for one in names if one in _KINDS), str)
    return Annotated[word | None if default is None else word, info]

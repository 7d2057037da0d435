"""Commands made of a public function: its signature gives arguments and options, its docstring their help."""

from __future__ import annotations

import ast
import copy
import functools
import importlib.util
import inspect
import re
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, get_args, get_origin

import typer
from typer.models import OptionInfo

import radiometer as rm
from radiometer import plausible
from radiometer.cli.arguments import parse_exposure, parse_f_number, parse_measured_iso, parse_patch, parse_relative
from radiometer.cli.console import asker, note, progress
from radiometer.cli.options import JsonOption
from radiometer.cli.outputs import writes

_PAGE: Final = "open this address on the screen to be measured, then press Start:\n  {}"
_HANDED: Final = ("notice", "progress", "ask", "announce")  # parameters that the terminal serves
_ARGS: Final = re.compile(r"^ {4}(\w+): (.+(?:\n {8}.+)*)", re.MULTILINE)
_LIKE: Final = re.compile(r"`(\w+)`, which has the other arguments")
# What one word becomes, by the first that its annotation names.
_KINDS: Final = {
    "PathLike": Path,
    "bool": bool,
    "int": int,
    "float": float,
    **{name: of for name, of in vars(plausible).items() if get_origin(of) is Annotated},
}
# How words are written whose annotation names such a type.
_PARSERS: Final[dict[str, tuple[Callable[[str, str], Any], str]]] = {
    "PatchLike": (lambda text, _: parse_patch(text), "X,Y,W,H"),
    "Patch": (lambda text, _: parse_patch(text), "X,Y,W,H"),
    "RelativeUncertainty": (parse_relative, "0.01|1%"),
    "FNumber": (parse_f_number, "N"),
    "Exposure": (parse_exposure, "TIME"),
}
_NAMES: Final = {"out": ("--out", "-o"), "output": ("--output", "-o"), "mapped": ("--map",)}
_METAVARS: Final = {"align": "auto|on|off", "measured_iso": "STATED=REAL"}
_CONVERTERS: Final[dict[str, Callable[[Sequence[str]], Any]]] = {"measured_iso": parse_measured_iso}
_WRITERS: Final = {"out": "write", "output": "write"}
_OPEN: Final = Annotated[bool, typer.Option("--open", help="Open the page in this machine's browser.")]
_DRAWN: Final = {
    "plot": "Picture to draw: PNG, PDF or SVG.",
    "csv": "Table of the figures to write.",
    "report": "Report (HTML) to write: outcome, pictures, figures.",
}


def command_of(
    name: str,
    show: Callable[..., None] | None = None,
    *,
    files: Sequence[str] | None = None,
    folder: str | None = None,
    results: Sequence[str] = (),
    defaults: Mapping[str, Any] | None = None,
    converters: Mapping[str, Callable[[Sequence[str]], Any]] | None = None,
    serves: Callable[..., Mapping[str, Any]] = lambda json, **given: {},
    reports: str = "",
    shown: Mapping[str, Any] | None = None,
    json: bool = True,
    page: str = _PAGE,
    code: Callable[[Any], int] = lambda found: 0,
    **options: Any,
) -> Callable[..., int]:
    """Return the command of a public function, ready for typer.

    Options are in the order of its parameters, then the files that its result writes, then `--json`. A parameter by
    position without a default is an argument; help is that of the docstring unless an option states another. A switch
    that is on by default becomes `--no-…`; the unit behind a time's name is left out. Remarks of the result, in its
    `notes`, are printed first. The function is read as text: to import it takes a second, which every `--help` and
    completion would wait for.

    Args:
        name: Name of the function in `radiometer`.
        show: Prints its result for people; each one where it yields several. Without it nothing is printed.
        files: Parameters that name files which the function writes.
        folder: Parameter that names a folder which the function creates.
        results: Files that the result writes by `write` or `write_…`: "out", "plot", "csv", "report".
        defaults: Defaults of the command where the function has others.
        converters: By parameter, what makes its value of the words of an option that may be repeated.
        serves: Returns what the command hands over by parameter; called with whether JSON is printed, and the options.
        reports: Parameter that takes what to show as soon as it is known; the function's end shows nothing then.
        shown: Options that only `show` takes.
        json: Whether the result can be printed as JSON.
        page: How the address of a page is announced.
        code: Exit code by the result.
        options: By parameter, `typer.Option` or `typer.Argument` with what the command line has beyond the signature:
            another name, limits, a parser of words; or a whole annotation, with its own type.
    """
    text, helps, taken = _described(name)
    converters = {**_CONVERTERS, **(converters or {})}
    served = {"notice": note, "progress": None, "ask": None, "announce": None, reports: None, **serves(False)}
    taken |= {one: (taken[one][0], default, False) for one, default in (defaults or {}).items()}
    negated = [one for one, (_, default, _) in taken.items() if default is True and one not in options]
    kinds = {
        one: (False if one in negated else default, _annotation(one, kind, default, place, options.get(one), helps))
        for one, (kind, default, place) in taken.items()
        if one not in served
    }
    kinds |= {one: (None, _annotation(one, "PathLike", None, False, options.get(one), _DRAWN)) for one in results}
    kinds |= dict(shown or {})
    kinds |= {"open_browser": (False, _OPEN)} if "announce" in taken.keys() - serves(False).keys() else {}
    kinds |= {"json": (False, JsonOption)} if json and show else {}
    parameters = [
        inspect.Parameter(one, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for one, (default, kind) in kinds.items()
    ]
    parameters.sort(key=lambda one: one.name == "force")  # last, as `writes` has it

    def command(*, json: bool = False, open_browser: bool = False, **given: Any) -> int:
        written, displayed = {one: given.pop(one) for one in results}, {one: given.pop(one) for one in shown or ()}
        present = _print_json if json else functools.partial(show or _print_nothing, **displayed)
        with progress(shown="progress" in taken and not json) as bar:
            announce = functools.partial(_announce, page, open_browser)
            hand = {"notice": note, "progress": bar, "announce": announce, reports: present, **serves(json, **given)}
            hand |= {"ask": asker()} if "ask" in taken else {}
            stated = {one: value for one, value in given.items() if value is not None and value != []}
            stated |= {one: of(stated[one]) for one, of in converters.items() if one in stated}
            stated |= {one: not stated[one] for one in negated}
            found = getattr(rm, name)(**stated, **{one: hand[one] for one in served if one in taken})
            for one in found if (several := isinstance(found, Iterator)) else ():
                present(one)
        for line in getattr(found, "notes", ()):
            note(line)
        for one, file in written.items():
            if file is not None:
                getattr(found, _WRITERS.get(one, f"write_{one}"))(file)
        for named in (*(given[one] for one in files or ()), *written.values()):
            for file in named if isinstance(named, list) else filter(None, [named]):
                note(f"wrote {file}")
        if not (reports or several):
            present(found)
        return code(found)

    command.__doc__ = text
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    if files is None and not results and folder is None:
        return command
    return writes(*(files or ()), *results, folder=folder)(command)


def _print_json(found: Any) -> None:
    print(found.to_json(), flush=True)


def _print_nothing(found: Any) -> None:
    """Print nothing: what the function does is all that is asked for."""


def _announce(page: str, open_browser: bool, url: str) -> None:
    note(*page.format(url).split("\n"))
    if open_browser:
        webbrowser.open(url)


def _described(name: str) -> tuple[str, dict[str, str], dict[str, tuple[str, Any, bool]]]:
    """Return a function's text before the sections of its docstring, and the help of its parameters.

    The help of parameters that it leaves out is that of the function which it names for them. Then by parameter:
    annotation, default, and whether it is an argument. None replaces defaults that are no plain value, and empty ones.
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
        one.arg: (ast.unparse(one.annotation) if one.annotation else "", value, place < len(required))
        for place, (one, value) in enumerate(zip((*plain, *named), values, strict=True))
    }
    options = {f"`{one}`": _NAMES.get(one, _plain_names(one))[0] for one in taken if one not in _HANDED}

    def spoken(words: str) -> str:
        return re.sub(r"`\w+`", lambda it: options.get(it[0], it[0]), words)

    helps = {one: spoken(" ".join(words.split())) for one, words in arguments}
    for other in _LIKE.findall(doc):
        helps = _described(other)[1] | helps
    return spoken(re.split(r"\n\n[A-Z]\w+:\n", doc)[0]), helps, taken


def _plain_names(name: str) -> tuple[str, ...]:
    return (f"--{name.removesuffix('_s').replace('_', '-')}",)


def _value(default: ast.expr | None) -> Any:
    if default is None:
        return inspect.Parameter.empty
    return default.value if isinstance(default, ast.Constant) else None


def _annotation(name: str, kind: str, default: Any, is_argument: bool, stated: Any, helps: Mapping[str, str]) -> Any:
    """Return the annotation that typer reads of a parameter, as the command line writes it."""
    whole = get_origin(stated) is Annotated
    info = copy.copy(get_args(stated)[-1] if whole else stated or (typer.Argument if is_argument else typer.Option)())
    names = re.findall(r"\w+", kind)
    named = info.param_decls or isinstance(info.default, str)  # where typer keeps a name that stands alone
    if isinstance(info, OptionInfo) and not named:
        plain = _NAMES.get(name, _plain_names(name))
        info.param_decls = (f"--no{plain[0][1:]}",) if default is True else plain
    info.help = info.help or helps.get(name, "")
    if whole:
        return Annotated[(*get_args(stated)[:-1], info)]
    info.metavar = info.metavar or _METAVARS.get(name)
    if {"Sequence", "Mapping", "StatementMap"} & set(names) and not info.parser:
        several = list[Path] if {"Sequence", "PathLike"} <= set(names) else list[str]
        return Annotated[several | None if default is None else several, info]
    parse, metavar = next((_PARSERS[one] for one in names if one in _PARSERS), (None, ""))
    if parse is not None and not info.parser:
        option = max(info.param_decls or (str(info.default),), key=len)
        info.parser, info.metavar = lambda words: parse(words, option), info.metavar or metavar
    word = str if info.parser else next((_KINDS[one] for one in names if one in _KINDS), str)
    return Annotated[word | None if default is None else word, info]

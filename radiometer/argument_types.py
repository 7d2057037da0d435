"""Refuses arguments of the public interface that are not what the signature states, before any work begins.

A signature states a type and, by the types of `plausible`, the range of a number. A plain `float` is any finite number.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import numbers
import os
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

from radiometer.errors import UsageError
from radiometer.plausible import LARGEST, Range

_T = TypeVar("_T")
_LONGEST: Final = 60  # characters of a value in a message
_LONGEST_PATH: Final = 4096  # bytes: PATH_MAX of Linux
_LONGEST_NAME: Final = 255  # bytes: NAME_MAX
_KINDS: Final = {float: numbers.Real, int: numbers.Integral}  # numbers of NumPy are registered there
_FINITE: Final = Range()
_ALTERNATIVES: Final = (typing.Union, types.UnionType)

_WORDS: Final = {
    types.NoneType: "None",
    str: "text",
    float: "number",
    int: "whole number",
    bool: "True or False",
    os.PathLike: "path",
    Callable: "function",
}


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a public function that first compares its arguments with its annotations.

    It keeps name, signature and help. A default always fits. NaN and infinity are no numbers, and `True` neither.

    Args:
        function: Function whose annotations `typing.get_type_hints` resolves.

    Raises:
        UsageError: When it is called, if an argument does not fit; the message names it and what it takes.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        try:
            bound = signature.bind(*args, **named)
        except TypeError:  # too many, too few or unknown ones: Python's own error says it
            return function(*args, **named)
        given = bound.arguments
        given.update({name: _plain(value) for name, value in given.items()})
        for name, hint in _hints(function).items():
            if name not in given or (value := given[name]) is signature.parameters[name].default or _fits(value, hint):
                continue
            shown = repr(value)
            shown = shown if len(shown) <= _LONGEST else shown[: _LONGEST - 1] + "…"
            raise UsageError(
                f"{function.__qualname__}: {name} is {shown} ({type(value).__name__}); give {_words(hint)}"
            )
        return function(*bound.args, **bound.kwargs)

    return call


def _plain(value: Any) -> Any:
    """Return a single number of NumPy as Python's, which has no limits."""
    return value.item() if hasattr(value, "dtype") and getattr(value, "shape", None) == () else value


def with_checked_methods(kind: type[_T]) -> type[_T]:
    """Return a class whose own public methods compare their arguments as `checked` does."""
    for name, method in list(vars(kind).items()):
        takes_any = (
            isinstance(method, types.FunctionType)
            and method.__code__.co_argcount + method.__code__.co_kwonlyargcount > 1
        )
        if takes_any and not name.startswith("_") and not hasattr(method, "__wrapped__"):
            setattr(kind, name, checked(method))
    return kind


class _ByName(type):
    """Class that only type checkers import, such as one of Matplotlib: the names of a value's classes are compared."""

    def __instancecheck__(cls, value: object) -> bool:
        return any(base.__name__ == cls.__name__ for base in type(value).__mro__)


class _Scope(dict[str, Any]):
    """Names of a module, and classes by name for those that it lacks."""

    def __missing__(self, name: str) -> Any:
        if hasattr(builtins, name):
            raise KeyError(name)
        return _ByName(name, (), {})


@functools.cache
def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    return typing.get_type_hints(function, _Scope(function.__globals__), include_extras=True)


def range_of(hint: Any) -> Range | None:
    """Return the range that a type states of its number, also within `X | None`; None where it states none."""
    found = [one for one in getattr(hint, "__metadata__", ()) if isinstance(one, Range)]
    inner = typing.get_args(hint) if typing.get_origin(hint) in (typing.Annotated, *_ALTERNATIVES) else ()
    return next(iter(found or filter(None, map(range_of, inner))), None)


def _fits(value: object, hint: Any, limits: Range = _FINITE) -> bool:
    if typing.get_origin(hint) is typing.Annotated:
        return _fits(value, hint.__origin__, range_of(hint) or limits)
    kind, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind in _ALTERNATIVES:
        if isinstance(value, str | os.PathLike) and os.PathLike in [typing.get_origin(part) for part in parts]:
            return _may_be_path(value)
        return any(_fits(value, part) for part in parts)
    if kind is typing.Literal:
        return isinstance(value, str) and value in parts
    if kind is Callable:
        return callable(value)
    if kind in _KINDS:
        return isinstance(value, _KINDS[kind]) and not isinstance(value, bool) and limits.holds(typing.cast(Any, value))
    if kind is tuple or kind is Sequence:
        return _is_sequence(value) and _elements_fit(value, parts, fixed=kind is tuple and parts[-1] is not ...)
    if kind is Mapping:
        return isinstance(value, Mapping) and all(
            _fits(one, part) for item in value.items() for one, part in zip(item, parts, strict=True)
        )
    return isinstance(value, kind)


def _words(hint: Any, limits: Range = _FINITE) -> str:
    """Return what a type takes, as words of a message."""
    if typing.get_origin(hint) is typing.Annotated:
        return _words(hint.__origin__, range_of(hint) or limits)
    kind, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind in _ALTERNATIVES:
        return " or ".join(map(_words, parts))
    if kind is typing.Literal:
        return " or ".join(map(repr, parts))
    if kind is tuple and parts[-1] is not ...:
        return f"({', '.join(map(_words, parts))})"
    if kind is tuple or kind is Sequence:
        return f"a list of {_words(parts[0])}"
    if kind is Mapping:
        return f"a mapping of {_words(parts[0])} to {_words(parts[1])}"
    if kind in _KINDS:
        return limits.words("finite number" if kind is float and limits.high == LARGEST else _WORDS[kind])
    return _WORDS.get(kind, getattr(kind, "__name__", str(kind)))


def _may_be_path(value: str | os.PathLike[str]) -> bool:
    """Return whether the system takes a path: not one with a zero, or with a name that no folder can hold."""
    path = os.fsencode(value)
    return b"\0" not in path and len(path) < _LONGEST_PATH and max(map(len, path.split(b"/"))) <= _LONGEST_NAME


def _is_sequence(value: object) -> bool:
    """Return whether a value is a list, a tuple or an array; a text is one thing, not a list of characters."""
    return hasattr(value, "__array__") or (
        isinstance(value, Sequence) and not isinstance(value, str | bytes | os.PathLike)
    )


def _elements_fit(value: Any, parts: tuple[Any, ...], fixed: bool) -> bool:
    if not fixed:
        return all(_fits(one, parts[0]) for one in value)
    return len(value) == len(parts) and all(_fits(one, part) for one, part in zip(value, parts, strict=True))

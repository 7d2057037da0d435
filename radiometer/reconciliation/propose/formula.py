"""Evaluates the formulas of laws: a closed set of operators and functions over arrays, without running code."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Final

import numpy as np

Formula = Callable[[Mapping[str, Any]], Any]

_OPERATORS: Final[dict[type[ast.AST], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.BitOr: operator.or_,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.Is: operator.is_,
}
_OF_NUMPY: Final = ("asarray", "exp", "isclose", "log", "maximum", "mod", "sin", "square", "sum", "tanh")
_NUMPY: Final = {name: getattr(np, name) for name in _OF_NUMPY} | {"pi": np.pi, "inf": np.inf}


@cache
def formula(text: str) -> Formula:
    """Return the function of named values that a formula states.

    Args:
        text: An expression of names, numbers, attributes, the operators above and the functions of NumPy above.

    Raises:
        ValueError: If it holds anything else.
    """
    return _of(ast.parse(text, mode="eval").body)


def _of(node: ast.AST) -> Formula:
    match node:
        case ast.Constant(value=value):
            return lambda known: value
        case ast.Name(id=name):
            return lambda known: known[name]
        case ast.Attribute(value=ast.Name(id="np"), attr=name) if name in _NUMPY:
            figure = _NUMPY[name]
            return lambda known: figure
        case ast.Attribute(value=holder, attr=name) if not name.startswith("_"):
            held = _of(holder)
            return lambda known: getattr(held(known), name)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            value_of = _of(inner)
            return lambda known: -value_of(known)
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _OPERATORS:
            return _joined(_OPERATORS[type(sign)], left, right)
        case ast.Compare(left=left, ops=[sign], comparators=[right]) if type(sign) in _OPERATORS:
            return _joined(_OPERATORS[type(sign)], left, right)
        case ast.IfExp(test=test, body=body, orelse=other):
            asked, then, otherwise = _of(test), _of(body), _of(other)
            return lambda known: then(known) if asked(known) else otherwise(known)
        case ast.Call(func=function, args=arguments, keywords=keywords):
            return _called(function, arguments, keywords)
    raise ValueError(f"a formula cannot hold {ast.unparse(node)!r}")


def _joined(join: Callable[[Any, Any], Any], left: ast.AST, right: ast.AST) -> Formula:
    one, other = _of(left), _of(right)
    return lambda known: join(one(known), other(known))


def _called(function: ast.AST, arguments: list[ast.expr], keywords: list[ast.keyword]) -> Formula:
    what, given = _of(function), [_of(argument) for argument in arguments]
    named = {entry.arg: _of(entry.value) for entry in keywords if entry.arg}
    return lambda known: what(known)(*(one(known) for one in given), **{k: one(known) for k, one in named.items()})

"""Mistakes that a syntax tree has room for: one place, one change, as somebody in a hurry would make it."""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "ceil": "floor", "floor": "ceil", "argmin": "argmax"}
NAMES |= {
    "argmax": "argmin",
    "minimum": "maximum",
    "maximum": "minimum",
    "mean": "sum",
    "sum": "mean",
    "median": "mean",
}
BUILT_IN = {"min", "max", "any", "all"}
EITHER_WAY = {"max", "min", "hypot", "maximum", "minimum", "isclose", "array_equal", "isinstance"}
FACTORS = (0.5, 2.0, 10.0)
C_SIGNS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "+": "-", "-": "+", "*": "/", "/": "*"}
C_SIGNS |= {"&&": "||", "||": "&&", "+=": "-=", "-=": "+=", "<<": ">>", ">>": "<<", "&": "|", "|": "&"}
OF_TWO = ("+", "-", "*", "&")  # between two values where blanks stand on both sides; else a sign or a pointer
C_TOKEN = re.compile(
    r"//[^\n]*|/\*.*?\*/|^[ \t]*#(?!define)[^\n]*|\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*'"
    r"|(?P<number>\b\d[\w.]*)|(?P<sign><<=|>>=|->|\+\+|--|&&|\|\||[-+<>=!&|*/]=|<<|>>|[-+*/<>&|])",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Mistake:
    """One change of a text.

    Attributes:
        kind: What was done, for people.
        line: Where it stands, from 1.
        start: First character that is replaced.
        end: First character after it.
        new: What stands there instead.
    """

    kind: str
    line: int
    start: int
    end: int
    new: str

    def made_in(self, text: str) -> str:
        """Return the text with the mistake."""
        return text[: self.start] + self.new + text[self.end :]


def places(text: str) -> list[list[Mistake]]:
    """Return the places of a Python text that have room for a mistake, each with all that could be made there."""
    tree = ast.parse(text)
    lines = text.splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))

    def place(line: int, column_bytes: int) -> int:
        return starts[line - 1] + len(lines[line - 1].encode()[:column_bytes].decode())

    found = []
    for node in _nodes(tree):
        start = place(node.lineno, node.col_offset)
        end = place(node.end_lineno or node.lineno, node.end_col_offset or 0)
        if made := [Mistake(kind, node.lineno, start, end, new) for kind, new in _mistakes_at(node)]:
            found.append(made)
    return found


def _nodes(node: ast.AST) -> Iterator[ast.expr | ast.stmt]:
    """Yield what there is to mistake: no imports, types, decorators, docstrings, nor words of messages and logs."""
    parts: Iterable[ast.AST] = ast.iter_child_nodes(node)
    match node:
        case ast.JoinedStr() | ast.arg() | ast.Import() | ast.ImportFrom():
            return  # in a formatted string Python 3.11 does not know the places
        case ast.Expr(value=ast.Constant()):
            return
        case ast.AnnAssign(value=value):
            parts = [value] if value else []
        case ast.FunctionDef(args=arguments, body=body) | ast.AsyncFunctionDef(args=arguments, body=body):
            parts = [*arguments.defaults, *(one for one in arguments.kw_defaults if one), *body]
        case ast.ClassDef(body=body):
            parts = body
        case ast.Raise():
            yield node
            return
        case ast.Expr(value=ast.Call() as call) if _is_log(call):
            return
        case ast.expr() | ast.stmt():
            yield node
    for part in parts:
        yield from _nodes(part)


def _is_log(node: ast.Call) -> bool:
    return ast.unparse(node.func).split(".")[0].lower() in {"log", "_log", "logger", "echo", "print"}


def _mistakes_at(node: ast.expr | ast.stmt) -> list[tuple[str, str]]:
    """Return the mistakes that one node has room for, each with the text that stands in place of the node's."""
    match node:
        case ast.BinOp(left=left, op=operator, right=right):
            return _of_operation(left, operator, right)
        case ast.Compare(left=left, ops=[operator], comparators=[right]):
            others = COMPARISONS[type(operator)]
            return [("comparison", _printed(ast.Compare(left, [other()], [right]))) for other in others]
        case ast.Compare(left=left, ops=[first, second], comparators=[middle, right]):
            one, two = COMPARISONS[type(first)][0](), COMPARISONS[type(second)][0]()
            return [
                ("comparison", _printed(ast.Compare(left, [one, second], [middle, right]))),
                ("comparison", _printed(ast.Compare(left, [first, two], [middle, right]))),
            ]
        case ast.BoolOp(op=operator, values=values):
            other = ast.Or() if isinstance(operator, ast.And) else ast.And()
            fewer = [_printed(_joined(operator, values[:k] + values[k + 1 :])) for k in range(len(values))]
            return [
                ("and for or", _printed(ast.BoolOp(other, values))),
                *(("condition left out", text) for text in fewer),
            ]
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand) if not isinstance(operand, ast.Constant):
            return [("sign or not left out", _printed(operand))]
        case ast.IfExp(test=test, body=body, orelse=otherwise):
            return [("branches exchanged", _printed(ast.IfExp(test, otherwise, body)))]
        case ast.Constant(value=value):
            return _of_constant(value)
        case ast.Call():
            return _of_call(node)
        case ast.Raise():
            return [("raise left out", "pass")]
        case ast.Expr(value=ast.Call() | ast.Await()):
            return [("call left out", "pass")]
        case ast.AugAssign(target=target, op=operator, value=value):
            changed = OPERATORS[type(operator)]() if type(operator) in OPERATORS else operator
            plain = ast.unparse(ast.Assign([target], value, lineno=0))
            return [("operator", ast.unparse(ast.AugAssign(target, changed, value))), ("term left out", plain)]
        case ast.If(test=test, body=[ast.Return() | ast.Raise() | ast.Continue() | ast.Break()], orelse=[]):
            return [("condition left out", "pass")] if not isinstance(test, ast.NamedExpr) else []
        case ast.Break():
            return [("break for continue", "continue")]
        case ast.Continue():
            return [("continue for break", "break")]
        case _:
            return []


def _printed(node: ast.expr) -> str:
    return f"({ast.unparse(ast.fix_missing_locations(node))})"


def _joined(operator: ast.boolop, values: list[ast.expr]) -> ast.expr:
    return values[0] if len(values) == 1 else ast.BoolOp(operator, values)


def _of_operation(left: ast.expr, operator: ast.operator, right: ast.expr) -> list[tuple[str, str]]:
    if isinstance(left, ast.Constant) and isinstance(left.value, str):
        return []
    if isinstance(operator, ast.BitOr) and "None" in (ast.unparse(left), ast.unparse(right)):
        return []  # a type
    made = (
        [("operator", _printed(ast.BinOp(left, OPERATORS[type(operator)](), right)))]
        if type(operator) in OPERATORS
        else []
    )
    what = "term left out" if isinstance(operator, ast.Add | ast.Sub | ast.BitOr) else "factor left out"
    made.append((what, _printed(left)))
    if isinstance(operator, ast.Add | ast.Mult):
        made.append((what, _printed(right)))
    return made


def _of_constant(value: object) -> list[tuple[str, str]]:
    if isinstance(value, bool):
        return [("constant", str(not value))]
    if isinstance(value, int):
        return [("constant by one", str(value + 1)), *([("constant by one", f"({value - 1})")] if value > 0 else [])]
    if isinstance(value, float) and value:
        return [("constant by a factor", repr(value * factor)) for factor in FACTORS]
    return [("constant", "1.0")] if isinstance(value, float) else []


def _of_call(node: ast.Call) -> list[tuple[str, str]]:
    made = []
    called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    plain = [one for one in node.args if not isinstance(one, ast.Starred)]
    if isinstance(node.func, ast.Attribute) and called in NAMES:
        method = ast.Attribute(node.func.value, NAMES[called])
        made.append(("another function", _printed(ast.Call(method, node.args, node.keywords))))
    elif called in BUILT_IN:
        made.append(("another function", _printed(ast.Call(ast.Name(NAMES[called]), node.args, node.keywords))))
    if (
        len(node.args) == 2 == len(plain)
        and ast.unparse(plain[0]) != ast.unparse(plain[1])
        and called not in EITHER_WAY
    ):
        made.append(("arguments exchanged", _printed(ast.Call(node.func, plain[::-1], node.keywords))))
    if (
        len(node.args) == 1 == len(plain)
        and not node.keywords
        and called in {"abs", "sqrt", "exp", "log", "float", "round"}
    ):
        made.append(("call left out", _printed(plain[0])))
    for keyword in node.keywords:
        others = [one for one in node.keywords if one is not keyword]
        if keyword.arg == "axis" and isinstance(keyword.value, ast.Constant) and isinstance(keyword.value.value, int):
            turned = ast.keyword("axis", ast.Constant(1 if keyword.value.value == 0 else 0))
            made.append(("another axis", _printed(ast.Call(node.func, node.args, [*others, turned]))))
    return made


def places_in_c(text: str) -> list[list[Mistake]]:
    """Return the places of a C text that have room for a mistake: signs and numbers outside comments and texts."""
    found = []
    for token in C_TOKEN.finditer(text):
        line = text.count("\n", 0, token.start()) + 1
        if number := token["number"]:
            stem = number.rstrip("uUlLfF")
            wrong = [f"({number} + 1)", f"({number} / 2)"] if stem not in {"0", "0.0"} else [f"({number} + 1)"]
            made = [Mistake("constant", line, token.start(), token.end(), new) for new in wrong]
        elif token["sign"] in C_SIGNS and not (
            token["sign"] in OF_TWO and (text[token.start() - 1], text[token.end()]) != (" ", " ")
        ):
            made = [Mistake("sign", line, token.start(), token.end(), C_SIGNS[token["sign"]])]
        else:
            continue
        found.append(made)
    return found


def drawn(texts: dict[str, str], count: int, generator: random.Random) -> list[tuple[str, Mistake]]:
    """Draw places of some files at random, none twice, and one mistake at each; what does not parse is drawn anew.

    Args:
        texts: Source text of each file, by its name.
        count: How many are requested.
        generator: What draws.

    Returns:
        Files with a mistake each, in the order of the files and lines; fewer where there are no more places.
    """
    rooms = [
        (name, room)
        for name, text in sorted(texts.items())
        for room in (places_in_c if name.endswith((".c", ".h")) else places)(text)
    ]
    generator.shuffle(rooms)
    chosen: list[tuple[str, Mistake]] = []
    for name, room in rooms:
        if len(chosen) == count:
            break
        mistake = generator.choice(room)
        if _is_valid(name, mistake.made_in(texts[name])):
            chosen.append((name, mistake))
    return sorted(chosen, key=lambda one: (one[0], one[1].start))


def _is_valid(name: str, text: str) -> bool:
    if not name.endswith(".py"):
        return True
    try:
        compile(text, name, "exec")
    except (SyntaxError, ValueError):
        return False
    return True

"""The manner of the source: raised errors documented, tests explained, functions short, nothing of any one machine."""

import ast
import gc
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("radiometer", "drivers", "simulators")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("test_*.py"))
LONGEST_FUNCTION = 60  # lines of its body: what fits on one screen
LEAVES = (ast.expr_context, ast.operator, ast.unaryop, ast.cmpop, ast.boolop, ast.Name, ast.Constant, ast.alias)
# A command's docstring is its help text for people; what it raises becomes an exit code.
LIBRARY = [path for path in SOURCES if "cli" not in path.parts]


def parsed(path: Path) -> ast.Module:
    """Return a file's syntax tree; a collection meanwhile would run other tests' finalisers in the parser.

    CPython 3.11 counts its recursion then and gives up (SystemError: recursion depth mismatch).
    """
    gc.disable()
    try:
        return ast.parse(path.read_text(encoding="utf-8"))
    finally:
        gc.enable()


def name_of(path):
    """Return a path relative to the project, for test names."""
    return path.relative_to(ROOT).as_posix()


def public_functions(tree):
    """Yield public functions and methods of public classes."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_"):
            yield node
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from (
                child
                for child in node.body
                if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef) and not child.name.startswith("_")
            )


def test_every_public_method_is_explained():
    """By its own docstring, or by that of the same method of a base or a Protocol."""
    classes = [(path, node) for path in SOURCES for node in parsed(path).body if isinstance(node, ast.ClassDef)]
    bases, explained, plain = {}, {}, set()
    for _, node in classes:
        names = {ast.unparse(base).partition("[")[0].rpartition(".")[2] for base in node.bases}
        methods = [one for one in public_functions(ast.Module([node], [])) if ast.get_docstring(one)]
        bases[node.name] = names | bases.get(node.name, set())
        explained[node.name] = {one.name for one in methods} | explained.get(node.name, set())
        plain |= {one.name for one in methods if "Protocol" in names}

    def known(name):
        return explained.get(name, set()).union(*map(known, bases.get(name, ())))

    bare = [
        f"{name_of(path)}: {node.name}.{one.name}"
        for path, node in classes
        for one in public_functions(ast.Module([node], []))
        if not ast.get_docstring(one) and one.name not in plain | known(node.name)
    ]
    assert bare == []


def raised_names(function):
    """Return the names of the exceptions that a function raises itself."""
    names = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            callee = node.exc.func
            names.add(callee.id if isinstance(callee, ast.Name) else getattr(callee, "attr", ""))
    return {name for name in names if name and name[0].isupper() and name not in {"AssertionError", "StopIteration"}}


@pytest.mark.slow
def test_raised_errors_stand_in_the_docstring():
    """What a public function raises itself is named in its docstring."""
    assert faulty(LIBRARY, unsaid) == {}


def faulty(paths, rule):
    """Return what a rule finds, by file: thousands of tests of a file each took longer than the rules."""
    return {name_of(path): found for path in paths if (found := rule(path))}


def unsaid(path):
    """Return the errors that a file's public functions raise and do not name."""
    return [
        f"{function.name}: {name}"
        for function in public_functions(parsed(path))
        for name in raised_names(function)
        if name not in (ast.get_docstring(function) or name)  # without one its base's names it
    ]


@cache
def faults_of_tests(path: Path) -> tuple[list[str], list[str]]:
    """Return a file's tests without a docstring and those that cannot fail; its tree, once parsed, is not kept."""
    functions = functions_of(parsed(path))
    return silent(functions), toothless(functions)


def functions_of(tree):
    """Return each function of a file with the assertions and calls in it, also of functions within, in one walk."""
    functions = {}
    waiting = [(tree, ())]
    while waiting:
        node, within = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            functions[node] = []
            within = (*within, node)
        elif isinstance(node, ast.Assert | ast.Call):
            for function in within:
                functions[function].append(node)
        waiting += [(child, within) for child in children_of(node)]
    return functions


def children_of(node):
    """Return the nodes right within a node, names and operators left out: they are half of a tree and hold nothing."""
    children = []
    for field in node._fields:
        held = getattr(node, field, None)
        if isinstance(held, ast.AST):
            children.append(held)
        elif isinstance(held, list):
            children += held
    return [child for child in children if not isinstance(child, LEAVES) and isinstance(child, ast.AST)]


def silent(functions):
    """Return the names of a file's tests that say nothing."""
    return [node.name for node in functions if node.name.startswith("test_") and not ast.get_docstring(node)]


def lines_of_functions(path):
    """Yield the name of each function of a file and the lines of its body, without docstring and parameters."""
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            yield f"{path.stem}.{node.name}", node.end_lineno - body[0].lineno + 1 if body else 0


def test_functions_stay_short():
    """A function does one thing; a command's long list of parameters is no part of its body."""
    assert {n: lines for path in SOURCES for n, lines in lines_of_functions(path) if lines > LONGEST_FUNCTION} == {}


@pytest.mark.slow
def test_every_test_says_which_behaviour_it_shows():
    """The docstring of a test is the sentence that it proves."""
    assert faulty(TESTS, lambda path: faults_of_tests(path)[0]) == {}


JUDGES = ("assert_", "refuse_", "reject_", "require_", "fail")


def judges(node):
    """Tell whether a node can fail a test: an assertion, an expected error, or a call that refuses what is wrong.

    That something is not None says next to nothing: any wrong value is not None either.
    """
    if isinstance(node, ast.Assert):
        return not (is_not_none(node.test) or isinstance(node.test, ast.Constant))
    if isinstance(node, ast.Call):
        name = getattr(node.func, "id", None) or getattr(node.func, "attr", "")
        return name in {"raises", "warns", "eventually", "run_state_machine_as_test"} or name.startswith(JUDGES)
    return False


def is_not_none(test):
    """Tell whether a condition only says that something is not None."""
    if isinstance(test, ast.BoolOp):
        return all(map(is_not_none, test.values))
    return (
        isinstance(test, ast.Compare)
        and isinstance(test.ops[0], ast.IsNot)
        and isinstance(test.comparators[0], ast.Constant)
        and test.comparators[0].value is None
    )


def helpers_that_judge(functions):
    """Return the names of a file's own functions and fixtures that can fail a test, also through each other."""
    found = {one.name for one, nodes in functions.items() if any(map(judges, nodes))}
    while True:
        more = {one.name for one, nodes in functions.items() if any(calls(node, found) for node in nodes)}
        if more <= found:
            return found
        found |= more


def calls(node, names):
    """Tell whether a node calls one of the names."""
    return isinstance(node, ast.Call) and (getattr(node.func, "id", None) or getattr(node.func, "attr", "")) in names


def toothless(functions):
    """Return the names of a file's tests that cannot fail, but by an error of their own."""
    judging = helpers_that_judge(functions)
    return [node.name for node in functions if node.name.startswith("test_") and node.name not in judging]


def test_every_test_can_fail():
    """Each test asserts something more than that a value is there."""
    assert faulty(TESTS, lambda path: faults_of_tests(path)[1]) == {}


@pytest.mark.parametrize(
    ("body", "refused"),
    [
        ("run()", True),
        ("assert True", True),
        ("assert found is not None", True),
        ("assert found is not None and other is not None", True),
        ("shown(found)", True),  # a helper of the file that only says that it is not None
        ("assert found is not None; assert found.x == 1", False),
        ("assert found is not None and found.x == 1", False),
        ("with pytest.raises(ValueError): run()", False),
        ("agree(found)", False),
        ("await eventually(lambda: found)", False),
    ],
)
def test_the_judge_of_tests_bites(body, refused):
    """No assertion, or only that something is not None, is refused; helpers are looked into."""
    helpers = "def shown(x):\n    assert x is not None\ndef agree(x):\n    assert x == 2\n"
    tree = ast.parse(f"{helpers}async def test_it():\n    {body}\n")
    assert toothless(functions_of(tree)) == (["test_it"] if refused else [])


def test_nothing_names_a_package_registry():
    """Pins and configuration work with whatever registry is configured."""
    names = ("pyproject.toml", "constraints.txt", "Makefile", ".ci/run")
    files = [ROOT / name for name in names if (ROOT / name).exists()]
    host = re.compile(r"https?://[a-z0-9.-]*(pypi|python|debian|npm)[a-z0-9.-]*\.(org|com)|index-url")
    assert [file.name for file in files if host.search(file.read_text(encoding="utf-8"))] == []


# These hold what other instruments' logs and files are reconciled with, each with its few effects.
SUBJECTS = {"log_fit", "photographs", "tables"}
RECONCILE = [
    path for path in SOURCES if name_of(path).startswith("radiometer/reconciliation/") and path.stem not in SUBJECTS
]
COMMON = {
    "__init__", "base", "catalogue", "context", "free_law", "registry", "rounding", "surroundings", "tile_moments",
}  # fmt: skip
EFFECT_FILES = {path.stem for path in (ROOT / "simulators" / "effects").glob("*.py")} - COMMON
# Settings and figures of the camera's description that have the name of a link of the ideal chain.
SETTINGS = {"source_level", "quantum_efficiency", "shutter", "lens"}


def effects_named(path):
    """Return the effects that a file says by name: as a string, or by an import of one."""
    found = []
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found += {node.value} & (EFFECT_FILES - SETTINGS)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("simulators.effects"):
            found += {part for part in node.module.split(".")[2:] if part in EFFECT_FILES}
    return found


@pytest.mark.slow
def test_reconcile_knows_no_effect_by_name():
    """What is peculiar to an effect stands in its own file: no name of one as a string, no import of one."""
    assert faulty(RECONCILE, effects_named) == {}


SEARCH = [path for path in RECONCILE if path.stem in {"comparison", "localise", "screening", "search", "verdict"}]


@pytest.mark.parametrize("path", SEARCH, ids=name_of)
def test_what_decides_about_a_name_stands_in_the_table_of_thresholds(path):
    """Nats, sigmas, chances and χ² that decide have a row with a reason in thresholds.py, and no other place."""
    decides = re.compile(r"^_?[A-Z_]*(NATS|SIGMAS|CHI2|CHANCE|SIGNIFICAN\w*|GAP)\b.*= *[\d.]+", re.MULTILINE)
    assert decides.findall(path.read_text(encoding="utf-8")) == []

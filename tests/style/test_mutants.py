"""Mistakes drawn at random are plausible ones, and the tests chosen against them are those that can notice them."""

import ast

import pytest

from tests.mutants import harness
from tests.mutants.areas import AREAS
from tests.mutants.blind import PACKAGES, draw, sources_of
from tests.mutants.mistakes import places, places_in_c


def lines_made(text: str, kind: str) -> set[str]:
    """Return the texts that mistakes of a kind make of a text, as Python reads them."""
    return {ast.unparse(ast.parse(one.made_in(text))) for room in places(text) for one in room if one.kind == kind}


@pytest.mark.parametrize(
    ("text", "kind", "made"),
    [
        ("x = a + b * c", "operator", {"x = a - b * c", "x = a + b / c"}),
        ("x = (a + b) * c", "factor left out", {"x = a + b", "x = c"}),
        ("x = a / (b + c)", "term left out", {"x = a / b", "x = a / c"}),
        ("x = a <= b", "comparison", {"x = a < b", "x = a >= b"}),
        ("x = 0 < a < b", "comparison", {"x = 0 <= a < b", "x = 0 < a <= b"}),
        ("x = a and not b", "condition left out", {"x = not b", "x = a"}),
        ("x = a and not b", "sign or not left out", {"x = a and b"}),
        ("def f(a=3): return a", "constant by one", {"def f(a=4):\n    return a", "def f(a=2):\n    return a"}),
        ("x = 'µσ' if a else 2.0", "constant by a factor", {f"x = 'µσ' if a else {k}" for k in (1.0, 4.0, 20.0)}),
        ("x: float | None = f(a, b)", "arguments exchanged", {"x: float | None = f(b, a)"}),
        ("x = a.sum(axis=0)", "another axis", {"x = a.sum(axis=1)"}),
        ("if a:\n    raise E('b' + str(1))", "condition left out", {"pass"}),
        ("if a:\n    raise E('b' + str(1))", "constant by one", set()),  # words for people
        ("def f():\n    'Add 1 + 2.'\n    log.info(1 + 2)", "operator", set()),
        ("x = max(a, key=f)", "another function", {"x = min(a, key=f)"}),
    ],
)
def test_a_place_has_room_for_these_mistakes(text, kind, made):
    """Each is one change of one node; what stands around keeps its meaning, whatever binds more tightly."""
    assert lines_made(text, kind) == made


def test_a_place_in_firmware_has_room_for_these():
    """Signs and numbers are; comments, texts, pointers, signs of one value and what is included are not."""
    text = "#include <a.h>\n#define N (2 * 3u) // 1 < 2\nvoid f(int *p) { if (*p < N && -1 == g(\"1 + 1\")) h('<'); }"
    made = {one.made_in(text).splitlines()[one.line - 1] for room in places_in_c(text) for one in room}
    held, tail = "void f(int *p) { if (*p < N && -1 == g(\"1 + 1\")) h('<'); }", " // 1 < 2"
    assert made == {
        f"#define N ((2 + 1) * 3u){tail}",
        f"#define N ((2 / 2) * 3u){tail}",
        f"#define N (2 / 3u){tail}",
        f"#define N (2 * (3u + 1)){tail}",
        f"#define N (2 * (3u / 2)){tail}",
        held.replace("*p < N", "*p <= N"),
        held.replace("&&", "||"),
        held.replace("-1", "-(1 + 1)"),
        held.replace("-1", "-(1 / 2)"),
        held.replace("==", "!="),
    }


@pytest.mark.slow
def test_a_seed_draws_the_same_of_an_area_whatever_else_is_drawn():
    """No place is drawn twice, every file is a source of its area, and another seed draws others."""
    alone, neighbour = draw(1, ["flux"], 30), draw(1, ["http", "flux"], 30)
    assert [one for one in neighbour if one.area == "flux"] == alone
    assert len({(one.file, one.mistake.start, one.mistake.end) for one in alone}) == len(alone) == 30
    assert {one.file for one in alone} <= set(sources_of(AREAS["flux"]))
    assert draw(2, ["flux"], 30) != alone
    with pytest.raises(KeyError, match="no area fluxes; areas are merge"):
        draw(1, ["fluxes"], 1)


def test_every_pattern_of_an_area_finds_sources_and_every_source_has_an_area():
    """No area's sources have moved away from it, and mistakes are drawn of the whole product."""
    assert [(area, one) for area, patterns in AREAS.items() for one in patterns if not sources_of([one])] == []
    product = sources_of([f"{package}/**/*.py" for package in PACKAGES])
    assert product.keys() - {name for patterns in AREAS.values() for name in sources_of(patterns)} == set()


def test_every_mistake_has_a_time_of_its_own(tmp_path, monkeypatch):
    """Two of one size in one file would run as the first, whose bytecode is kept; the corrected file keeps the time."""
    file, seen = tmp_path / "a.py", []
    file.write_text("x = 1\n", encoding="utf-8")
    sound = file.stat()

    def code_of(*_):
        seen.append((file.read_text(encoding="utf-8"), file.stat().st_mtime))
        return 0

    monkeypatch.setattr(harness, "code_of", code_of)
    assert [harness.fate_of_text(f"x = {k}\n", "a.py", (), tmp_path) for k in (2, 3)] == ["survived"] * 2
    assert [text for text, _ in seen] == ["x = 2\n", "x = 3\n"]
    assert len({sound.st_mtime, *(time for _, time in seen)}) == 3
    assert (file.read_text(encoding="utf-8"), file.stat().st_mtime) == ("x = 1\n", sound.st_mtime)

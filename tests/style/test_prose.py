"""Text is plain: short sentences, and none of the words that readers of the field stumble over."""

import ast
import re
import statistics
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TREES = ("radiometer", "drivers", "simulators")
# Within one sentence a reader holds about 16 words; above 35 even a patient one begins again (style page).
LONGEST, MEDIAN = 35, 16
# Each with the field's word for it.
STUMBLING = {
    r"told|tells?(?! the difference)": "reported, found, identified; determines, shows",
    r"said": "reported, printed, stated",
    r"nobody": "unknown, not given",
    r"beside": "next to, with, in addition to",
    r"of (?:its|their|his) own": "its, separate",
    r"lies?": "is, is located",
    r"mend(?:s|ed)?": "correct, repair",
    r"spared": "skipped, optional",
    r"taken for": "treated as, mistaken for",
    r"hangs? on": "depends on",
    r"goe?s? with": "varies with, scales with",
    r"stands? (?:beside|for|in)": "is, replaces, represents",
    r"nought|no more than": "at most",
    r"foretells?": "predicts",
    r"held (?:against|to)": "compared with",
    r"wanted": "required, requested",
    r"the very": "the same, exactly",
    r"what (?:is|was) left": "the residual, the rest",
    r"rules? the uncertainty": "dominates the uncertainty",
}
# Sentences that need one of the words, each with the reason. None does at present.
NEEDED: dict[str, str] = {}
_WORDS = re.compile(rf"\b(?:{'|'.join(STUMBLING)})\b")
# Templates of programs and statements of SQL are no messages.
_CODE = re.compile(r"^(?:import|from) \w|\b(?:INSERT INTO|CREATE TABLE|SELECT)\b", re.MULTILINE)
_ENDS = re.compile(r"(?<=[.!?:;])\s+(?=[A-Z(\"'])")


def paragraphs_of_markdown(text: str) -> Iterator[str]:
    """Yield paragraphs and points without code, tables and links' targets."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]*`", "CODE", text))
    rows = [row for row in text.split("\n") if not row.lstrip().startswith(("|", "<", "---"))]
    yield from re.split(r"\n\s*\n|\n(?=\s*[*\-+#]|\s*\d+\.)", "\n".join(rows))


def paragraphs_of_docstrings(tree: ast.AST) -> Iterator[str]:
    """Yield paragraphs and entries of every docstring; examples and formulas that are set in are code."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node) or ""
            yield from (part for part in re.split(r"\n\s*\n|\n\s{4,}(?=\w+:)", text) if ">>>" not in part)


def _literal(node: ast.AST) -> str | None:
    """Return the text of a literal, a formatted one with N for each value; None for anything else."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "N" for part in node.values)
    return None


def messages(tree: ast.AST) -> Iterator[str]:
    """Yield every text of three words and more that a program may print: errors, help, reports, log events."""
    docstrings = {
        node.body[0].value
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and ast.get_docstring(node) is not None
        and isinstance(node.body[0], ast.Expr)
    }
    pending = [tree]
    while pending:
        node = pending.pop()
        text = None if node in docstrings else _literal(node)
        if text is None:
            pending += ast.iter_child_nodes(node)
        elif len(text.split()) >= 3 and not _CODE.search(text):
            yield text


def sentences(paragraphs: Iterator[str]) -> Iterator[str]:
    """Yield the sentences of three words and more."""
    for paragraph in paragraphs:
        plain = re.sub(r"\s+", " ", paragraph).strip(" #*-+")
        yield from (one for one in _ENDS.split(plain) if len(one.split()) >= 3)


@cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def _python() -> Iterator[Path]:
    for name in TREES:
        yield from sorted((ROOT / name).rglob("*.py"))


def _of(kind: str) -> Iterator[tuple[Path, str]]:
    if kind in ("README.md", "CHANGELOG.md", "docs"):
        pages = sorted((ROOT / kind).rglob("*.md")) if kind == "docs" else [ROOT / kind]
        found = ((page, paragraphs_of_markdown(page.read_text(encoding="utf-8"))) for page in pages)
    else:
        parts = paragraphs_of_docstrings if kind == "docstrings" else messages
        found = ((file, parts(_tree(file))) for file in _python())
    for file, paragraphs in found:
        yield from ((file, one) for one in sentences(paragraphs))


@pytest.mark.parametrize("kind", ["README.md", "CHANGELOG.md", "docs", "docstrings", "messages"])
def test_text_is_plain(kind: str) -> None:
    """The median sentence has at most 16 words, none more than 35, and no sentence holds a stumbling word."""
    found = list(_of(kind))
    wrong = [
        f"{file.relative_to(ROOT)}: {hit[0] if hit else f'{len(one.split())} words'}: {one[:160]}"
        for file, one in found
        if ((hit := _WORDS.search(one)) or len(one.split()) > LONGEST) and one not in NEEDED
    ]
    assert wrong == [], f"the words to use instead: {STUMBLING}"
    assert statistics.median(len(one.split()) for _, one in found) <= MEDIAN


def test_needed_words_are_used() -> None:
    """An exception whose sentence is gone goes, too."""
    there = {one for kind in ("docs", "docstrings", "messages") for _, one in _of(kind)} if NEEDED else set()
    assert set(NEEDED) <= there


def test_a_stumbling_word_and_a_long_sentence_are_seen() -> None:
    """The check sees what it is for, in text, docstrings and messages in pieces."""
    assert _WORDS.search("The label stands for 1/60 s.")
    assert list(sentences(iter(["One two three. Four five six."]))) == ["One two three.", "Four five six."]
    assert list(messages(ast.parse('raise ValueError(f"the file {name} " "cannot be read")'))) == [
        "the file N cannot be read"
    ]

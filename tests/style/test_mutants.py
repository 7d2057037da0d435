"""The lists of plausible mistakes follow the code."""

from __future__ import annotations

import pytest

from tests.mutants.harness import ROOT, is_current, read_mutants

MUTANTS = list(read_mutants([]))


@pytest.mark.parametrize("mutant", MUTANTS, ids=[f"{m.area}-{n}" for n, m in enumerate(MUTANTS)])
def test_a_listed_mistake_can_still_be_made(mutant):
    """The sound text stands once in its file, the wrong one differs, and the tests that must notice it exist."""
    assert is_current(mutant), f"{mutant.file} no longer holds {mutant.old!r} exactly once: bring the list up to date"
    assert mutant.old != mutant.new
    assert [name for name in mutant.tests if not (ROOT / name.partition("::")[0]).exists()] == []

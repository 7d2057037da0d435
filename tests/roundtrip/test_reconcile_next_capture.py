"""What a plain bracket cannot settle, the captures that are asked for do, each taken anew by the generator."""

import pytest

from benchmarks.reconcile_next_capture import asked, captures_needed

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["veiling_glare", "display_black_leak", "gain_step_error"])
def test_two_captures_more_settle_a_plain_bracket(name: str) -> None:
    """Stray light needs another surround and the source off; a gain error a gain, and a second setting at it."""
    number, text = captures_needed(name, 40_000, asked, most=2)
    assert number is not None, text
    assert number > 0, "a bracket alone cannot tell"

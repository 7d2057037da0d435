"""Hostile input: the daemon neither crashes nor hangs nor grows."""

import string

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import daemon_fuzz
from radiometer.daemon.scpi.commands import command_table
from radiometer.daemon.scpi.language import ScpiError, split_message

TABLE = command_table()
_MESSY = st.text(st.sampled_from(string.printable + "\x00\xff#"), max_size=60)
_EXAMPLES = st.sampled_from([command.example for command in TABLE.commands])


@pytest.mark.long
def test_three_thousand_hostile_messages() -> None:
    """Half SCPI, half HTTP; the benchmark sends 600,000."""
    result = daemon_fuzz.run(3000, seed=3)
    assert (result.crashes, result.unanswered, result.unexpected) == (0, 0, 0)
    assert result.memory_mb[-1] - result.memory_mb[0] < 40


@settings(max_examples=400, deadline=None)
@given(
    st.one_of(
        _MESSY, st.tuples(_EXAMPLES, _MESSY, st.integers(0, 40)).map(lambda t: t[0][: t[2]] + t[1] + t[0][t[2] :])
    )
)
def test_the_lexer_takes_any_text(message: str) -> None:
    """Whatever comes in, units come out or an error of the standard; headers found are in the table."""
    units, error = split_message(message)
    assert error is None or isinstance(error, ScpiError)
    for unit in units:
        number = 0
        try:
            assert TABLE.find(unit.header, "")[0] in TABLE.commands
        except ScpiError as failure:
            number = failure.number
        assert number in (0, -113)

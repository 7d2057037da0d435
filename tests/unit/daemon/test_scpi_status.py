"""Status registers against the standards: which bit is which, what is latched, and what reaches the status byte.

Golden numbers: IEEE 488.2-1992, 11.2.1 (status byte) and 11.5.1 (standard event status register); SCPI-99, volume 1,
figure 9-1, and volume 2, 21.8 (which error sets which event).
"""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.daemon.scpi.errors import MESSAGES, ScpiError
from radiometer.daemon.scpi.lexer import split_message
from radiometer.daemon.scpi.status import Register, Status

WORDS = st.integers(0, 0x7FFF)
OPERATION_COMPLETE, QUERY, DEVICE, EXECUTION, COMMAND, POWER_ON = 1, 4, 8, 16, 32, 128


@pytest.mark.parametrize(
    ("first", "last", "bit"),
    [(-199, -100, COMMAND), (-299, -200, EXECUTION), (-399, -300, DEVICE), (-499, -400, QUERY)],
)
def test_each_hundred_of_errors_sets_its_event(first, last, bit, monkeypatch):
    """Both ends of a class belong to it, whatever numbers are in use; no error and our own numbers set none."""
    for number in (first, last, first + 37):
        monkeypatch.setitem(MESSAGES, number, "any")
        status = Status()
        assert status.take_event_status() == POWER_ON
        status.push(ScpiError(number))
        assert status.event_status == bit
        assert ScpiError(number).is_command_error == (bit == COMMAND)
    for number in (0, -99, -500, 7):
        monkeypatch.setitem(MESSAGES, number, "any")
        assert ScpiError(number).event_bit == 0
        assert not ScpiError(number).is_command_error


def test_an_entry_is_one_line_of_ascii_of_255_characters_at_most():
    """Quotes are doubled, what is no ASCII is a question mark, signs of times and degrees are spelled or left out."""
    assert ScpiError(-222, 'a "b" 2 × 3 °C\n€').entry == '-222,"Data out of range;a ""b"" 2 x 3 C??"'
    assert ScpiError(0).entry == '0,"No error"'
    assert len(ScpiError(-222, "x" * 400).entry) == len('-222,""') + 255


@given(st.lists(st.tuples(st.sampled_from(["update", "take", "enable"]), WORDS), max_size=30))
@settings(max_examples=60, deadline=None, database=None, derandomize=True)
def test_an_event_is_a_condition_that_rose_since_it_was_read(steps):
    """Bit by bit, against a set: reading clears events alone, a falling condition clears nothing."""
    register, condition, event, enable = Register(), set[int](), set[int](), set[int]()
    for what, word in steps:
        bits = {bit for bit in range(15) if word >> bit & 1}
        if what == "update":
            event |= bits - condition
            condition = bits
            register.update(word)
        elif what == "take":
            assert register.take_event() == sum(1 << bit for bit in event)
            event = set()
        else:
            enable, register.enable = bits, word
        assert register.condition == sum(1 << bit for bit in condition)
        assert register.event == sum(1 << bit for bit in event)
        assert register.summary is bool(event & enable)


@pytest.mark.parametrize("service_enable", [0, 4, 8, 16, 32, 64, 128, 255])
def test_the_status_byte_sums_up(service_enable):
    """Bits 2 to 5 and 7 say what is queued, questionable, available, an event, operating; bit 6 any that is enabled."""
    for queued, questionable, available, event, operation in itertools.product((False, True), repeat=5):
        status = Status()
        status.take_event_status()
        status.service_enable, status.event_enable = service_enable, COMMAND | OPERATION_COMPLETE
        for register, there in ((status.questionable, questionable), (status.operation, operation)):
            register.enable = 2
            register.update(2 if there else 1)
        if queued:
            status.push(ScpiError(-222))  # an execution error: an event that is not enabled
        if event:
            status.complete()
        byte = 4 * queued + 8 * questionable + 16 * available + 32 * event + 128 * operation
        master = 64 * bool(byte & service_enable & ~64)
        assert status.status_byte(message_available=available) == byte + master
        assert status.status_byte() == (byte - 16 * available) + 64 * bool(
            (byte - 16 * available) & service_enable & ~64
        )


def test_clearing_spares_what_is_enabled_and_presetting_what_has_happened():
    """*CLS empties queue and events, not enables (IEEE 488.2, 10.3); STATus:PRESet the enables of SCPI's part alone."""
    status = Status()
    status.event_enable, status.service_enable = 60, 36
    for register in (status.operation, status.questionable):
        register.enable = 5
        register.update(3)
    status.push(ScpiError(-113))
    status.preset()
    assert (status.operation.enable, status.questionable.enable) == (0, 0)
    assert (status.event_enable, status.service_enable) == (60, 36)
    assert (status.operation.event, status.questionable.event, status.error_count) == (3, 3, 1)
    status.operation.enable = 5
    status.clear()
    assert (status.operation.event, status.questionable.event, status.event_status, status.error_count) == (0, 0, 0, 0)
    assert (status.operation.condition, status.operation.enable, status.event_enable) == (3, 5, 60)


@pytest.mark.parametrize("message", ["SENS:EXP #\u00b2ab", "SENS:EXP #1\u00b2ab", "SENS:EXP #\u00b912"])
def test_only_digits_of_ascii_count_a_block(message):
    """A raised two of Latin-1 is a digit to Python, and no number: the block is refused (-161), nothing breaks."""
    units, error = split_message(message)
    assert units == ()
    assert error is not None
    assert error.number == -161

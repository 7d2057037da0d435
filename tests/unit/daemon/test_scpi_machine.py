"""Random sequences of SCPI messages: the daemon lives through all of them."""

import logging

import pytest
import structlog
from hypothesis.stateful import run_state_machine_as_test

from testing.scpi_machine import ScpiMachine, machine_settings


@pytest.fixture(autouse=True)
def _quiet():
    """Keep a thousand warnings about lost devices out of the report."""
    before = structlog.get_config()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    yield
    structlog.configure(**before)


@pytest.mark.slow
def test_no_sequence_of_messages_ends_the_daemon():
    """All commands, right and wrong, of three sessions, while camera and light box fail and come back."""
    run_state_machine_as_test(ScpiMachine, settings=machine_settings(25))

"""What programs say on standard error of an error that they survive."""

from __future__ import annotations

import logging

import pytest
import structlog

from radiometer.cli.logging_setup import configure_logging


def _failed(message: str) -> None:
    secret_table = list(range(50_000))  # what a traceback with its variables would print
    try:
        raise ZeroDivisionError(message, len(secret_table))
    except ZeroDivisionError:
        structlog.get_logger("test").exception("advice failed", what="the limits")


@pytest.mark.parametrize("verbosity", [0, 1])
def test_an_error_is_one_line(verbosity, capsys):
    """What failed, which error, what it says and where: one line, no traceback."""
    configure_logging(verbosity)
    _failed("by nothing")
    (line,) = capsys.readouterr().err.splitlines()
    for part in ("advice failed", "the limits", "ZeroDivisionError", "by nothing", "test_logging_setup.py:"):
        assert part in line


def test_who_asks_for_everything_gets_the_traceback_without_its_variables(capsys):
    """At DEBUG the traceback is plain: the lines of code, not what the variables hold."""
    configure_logging(2)
    _failed("by nothing")
    printed = capsys.readouterr().err
    assert "Traceback" in printed
    assert "49999" not in printed


def test_an_event_without_an_error_says_nothing_of_one(capsys):
    """A plain warning stays as it is."""
    configure_logging()
    structlog.get_logger("test").warning("camera warms up", kelvin=3.5)
    (line,) = capsys.readouterr().err.splitlines()
    assert "kelvin" in line
    assert "error=" not in line


def test_what_a_library_says_of_a_damaged_file_is_for_who_asks_for_everything(capsys):
    """Ours is the one line; what tifffile logs next to it comes at DEBUG alone."""
    for verbosity, lines in ((0, []), (1, []), (2, ["invalid value offset"]), (0, [])):
        configure_logging(verbosity)
        logging.getLogger("tifffile").error("invalid value offset")
        assert capsys.readouterr().err.splitlines() == lines

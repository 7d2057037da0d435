"""Sends structlog's events to standard error, warnings and worse unless asked for more."""

from __future__ import annotations

import logging
import sys

import structlog


class StandardErrorLogger:
    """Writes finished lines to whatever standard error is at that moment."""

    def msg(self, message: str) -> None:
        """Write one line; where standard error is closed the line is lost, not the program."""
        try:
            print(message, file=sys.stderr, flush=True)
        except ValueError:
            return

    debug = info = warning = error = critical = exception = fatal = msg


def configure_logging(verbosity: int = 0) -> None:
    """Show events from WARNING (0), INFO (1) or DEBUG (2 and above) on standard error."""
    level = {0: logging.WARNING, 1: logging.INFO}.get(verbosity, logging.DEBUG)
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=lambda *_: StandardErrorLogger(),
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty()),
        ],
        cache_logger_on_first_use=False,
    )

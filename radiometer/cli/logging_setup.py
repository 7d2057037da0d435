"""Sends structlog's events to standard error, warnings and worse unless asked for more."""

from __future__ import annotations

import logging
import sys
import traceback
from pathlib import Path
from types import TracebackType
from typing import Final

import structlog
from structlog.typing import EventDict, WrappedLogger

# Libraries that write separate lines about a damaged file; one line of ours reports what is wrong with it.
_TALKATIVE: Final = ("tifffile",)
_UNHEARD: Final = logging.NullHandler()


class StandardErrorLogger:
    """Writes finished lines to whatever standard error is at that moment."""

    def msg(self, message: str) -> None:
        """Write one line; where standard error is closed, full or has no reader the line is lost, not the program."""
        try:
            print(message, file=sys.stderr, flush=True)
        except (ValueError, OSError):
            return

    debug = info = warning = error = critical = exception = fatal = msg


def printable_texts(logger: WrappedLogger, method: str, event: EventDict) -> EventDict:
    """Replace the control characters of texts from outside, which could steer a terminal that shows the log."""
    from radiometer.reporting.plain_text import printable

    return {name: printable(value) if isinstance(value, str) else value for name, value in event.items()}


def error_in_one_line(logger: WrappedLogger, method: str, event: EventDict) -> EventDict:
    """Replace an event's exception by what it is, what it says and where it was raised."""
    given = event.pop("exc_info", None)
    kind, error, trace = _raised(given)
    if kind is None:
        return event
    where = traceback.extract_tb(trace)[-1:] if trace else []
    at = "".join(f" ({Path(last.filename).name}:{last.lineno})" for last in where)
    event["error"] = f"{kind.__name__}: {error}{at}"
    return event


def _raised(given: object) -> tuple[type[BaseException] | None, BaseException | None, TracebackType | None]:
    if isinstance(given, BaseException):
        return type(given), given, given.__traceback__
    if isinstance(given, tuple):
        return given
    return sys.exc_info() if given else (None, None, None)


def configure_logging(verbosity: int = 0) -> None:
    """Show events from WARNING (0), INFO (1) or DEBUG (2 and above) on standard error.

    The last comes with tracebacks, and with what libraries say of files.
    """
    level = {0: logging.WARNING, 1: logging.INFO}.get(verbosity, logging.DEBUG)
    for name in _TALKATIVE:
        library = logging.getLogger(name)
        (library.removeHandler if level == logging.DEBUG else library.addHandler)(_UNHEARD)
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=lambda *_: StandardErrorLogger(),
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            *([] if level == logging.DEBUG else [error_in_one_line]),
            printable_texts,
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
            ),
        ],
        cache_logger_on_first_use=False,
    )

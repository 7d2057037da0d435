"""The log of the HTTP servers: their faults, and no line for what a client does."""

from __future__ import annotations

import logging
from typing import Final

from aiohttp.http_exceptions import HttpProcessingError


class _OwnFaults(logging.Filter):
    """Drops what a client caused that sends nonsense or hangs up: it has its 400, and could fill the log."""

    def filter(self, record: logging.LogRecord) -> bool:
        error = record.exc_info[1] if record.exc_info else None
        return not isinstance(error, HttpProcessingError | ConnectionError)


_OWN_FAULTS: Final = _OwnFaults()


def logger_of_server(name: str) -> logging.Logger:
    """Return the logger for a server of aiohttp."""
    logger = logging.getLogger(name)
    logger.addFilter(_OWN_FAULTS)
    return logger

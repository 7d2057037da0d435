"""`radiometer serve`: the daemon."""

from __future__ import annotations

import functools
from typing import Any

import typer

from radiometer.cli.console import note
from radiometer.cli.function import command_of

_serve = command_of("serve", serves=lambda json, **_: {"announce": note}, bench=typer.Option(), camera=typer.Option())


@functools.wraps(_serve)
def command(**given: Any) -> int:
    """Serve, and log from INFO on: a daemon's log is read when something went wrong, so it is never silent."""
    import structlog

    from radiometer.cli.logging_setup import configure_logging

    if not structlog.is_configured():
        configure_logging(1)
    return _serve(**given)

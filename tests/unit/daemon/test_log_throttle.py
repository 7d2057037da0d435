"""A flood of log lines that say the same is ten lines a minute and a count; what is stated once is always written."""

from __future__ import annotations

import logging

import pytest
import structlog

from radiometer.daemon.serving import LogThrottle


@pytest.mark.parametrize("library", [False, True])
def test_a_flood_is_ten_lines_a_minute_and_a_count(library: bool) -> None:
    """61 000 equal lines in a minute become 20 and a count; each different line is written."""
    now = [0.0]
    throttle = LogThrottle(clock=lambda: now[0])
    lines: list[str] = []

    def say(text: str) -> None:
        if library:
            record = logging.LogRecord("asyncio", logging.WARNING, "", 0, text, None, None)
            lines.extend([record.getMessage()] if throttle.filter(record) else [])
        else:
            try:
                lines.append(str(throttle(None, "warning", {"event": text})))
            except structlog.DropEvent:
                return

    for second in range(61):
        now[0] = float(second)
        for _ in range(1000):
            say("client refused")
        say(f"alarm {second}")
    assert sum("client refused" in line for line in lines) == 20
    assert sum("59990" in line for line in lines) == 1
    assert sum("alarm" in line for line in lines) == 61


def test_an_installed_throttle_bounds_what_is_written(capsys: pytest.CaptureFixture[str]) -> None:
    """Of a hundred equal events ten lines reach standard error; what differs does too."""
    before = structlog.get_config()["processors"]
    try:
        LogThrottle().install()
        for _ in range(100):
            structlog.get_logger().warning("refused")
        structlog.get_logger().warning("another")
        assert len(capsys.readouterr().err.splitlines()) == 11
    finally:
        structlog.configure(processors=before)

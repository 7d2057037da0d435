"""What a client hears: every command asked and set over a fixed conversation, within its limits and beyond them."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

from radiometer.daemon.journal import Journal
from radiometer.daemon.scpi.command import Command
from radiometer.daemon.scpi.parameters import Boolean, Choice, Number, short_form
from radiometer.daemon.scpi.session import Session
from radiometer.daemon.scpi.table import command_table
from radiometer.daemon.station import Station
from tests.patience import within
from tests.unit.daemon.conftest import QUICK, FakeBox, FakeInstrument
from tests.unit.held.figures import moved

TABLE = command_table()
UNITS = ("MS", "US", "S", "DB", "NM", "PCT", "KG")
# Replies that hold a time, a version or a path.
PASSING = re.compile(r"\d{4}-\d\d-\d\d|\d+\.\d+\.\d+|/dev/|/tmp/|uptime", re.IGNORECASE)
LEFT_OUT = ("SYSTem:TIME", "SYSTem:DATE", "UPTime", "HELP", "MEMory", "LOG", "DIAGnostic")


def lines(command: Command, limits: Any) -> list[str]:
    """Return what is said of one command."""
    header = ":" + command.spellings()[0].replace("<n>", "1")
    said = []
    for place, parameter in enumerate(command.parameters):
        if place:
            break
        if isinstance(parameter, Number):
            bounds = parameter.limits(limits)
            middle = 0.5 * (bounds.low + bounds.high)
            words = [
                f"{bounds.high * (1 + 1e-3) + 1e-3:.12g}",
                f"{bounds.low - 1e-3:.12g}",
                f"{middle:.9g}",
                "MIN",
                "MAX",
                "DEF",
            ]
            words += [f"{bounds.default:.9g} {unit}" for unit in UNITS]
        elif isinstance(parameter, Choice):
            words = [form for word in parameter.words for form in (word, short_form(word).lower())]
        elif isinstance(parameter, Boolean):
            words = ["ON", "0", "OFF", "1", "MAYBE"]
        else:
            words = ["", "1", "'x'"]
        for word in words:
            said.append(f"{header} {word}".replace(":*", "*"))
            said.append(f"{header}?".replace(":*", "*"))
    if command.do and not command.parameters:
        said.append(header.replace(":*", "*"))
    if command.ask:
        said += [f"{header}? {word}".strip().replace(":*", "*") for word in ("", "MIN", "MAX", "DEF", "1,2,3")]
    said.append("SYST:ERR?")
    return said


async def answers(tmp_path: Path) -> dict[str, list[Any]]:
    """Return what every line is answered by, one station for each command."""
    told: dict[str, list[Any]] = {}
    for command in TABLE.commands:
        name = command.spellings()[0]
        if any(word in name for word in LEFT_OUT):
            continue
        station = Station(FakeInstrument(), Journal(tmp_path / f"{len(told)}.sqlite"), box=FakeBox(), times=QUICK)
        await station.start()
        while not station.instrument.is_open:
            await asyncio.sleep(0.001)
        session = Session(station, TABLE)
        heard: list[Any] = []
        for line in lines(command, station):
            outcome = session.execute(line)
            async with asyncio.timeout(within(20.0)):
                reply = await outcome if isinstance(outcome, Coroutine) else outcome
            heard.append([line, "passing" if reply and PASSING.search(reply) else reply])
            for _ in range(3):
                error = session.execute("SYST:ERR?")
                said = await error if isinstance(error, Coroutine) else error
                heard[-1].append(said)
                if str(said).startswith("0"):
                    break
        told[name] = heard
        await station.stop()
    return told


async def test_the_conversation_is_as_it_was(tmp_path):
    """Every reply and every error that a line leaves."""
    assert not moved("conversation", await answers(tmp_path))

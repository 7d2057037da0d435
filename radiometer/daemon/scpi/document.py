"""Writes the manual docs/reference/scpi.md from the command table."""

from __future__ import annotations

from itertools import groupby

from radiometer.daemon.scpi import status
from radiometer.daemon.scpi.commands import (
    CALIBRATION,
    COMMON,
    MEASURING,
    SENSE,
    SOURCE,
    STATUS,
    SYSTEM,
    TRACE,
    command_table,
)
from radiometer.daemon.scpi.language import MESSAGES, Command, CommandTable

_INTRODUCTION = """\
# SCPI

SCPI (Standard Commands for Programmable Instruments) is a language of text lines. `radiometer serve` understands it
on TCP port 5025 (raw socket) and, with `--scpi-socket`, on a Unix socket. This page is made from the command table by
`python -m radiometer.daemon.scpi.document`; a test runs every example. Terms are in the [glossary](../glossary.md).
"""

_RULES = (
    "One message per line, ended by a line feed (a carriage return before it is ignored). Replies end the same way.",
    "A command's name is its *header*, such as `SENSe:EXPosure`; the words between colons are its *nodes*. Each node "
    "has a short form, its capitals (`SENS:EXP`), and a long one. Small letters are the same. Nodes in brackets may be "
    "left out.",
    "A header with `?` is a *query*, which has a reply. Parameters follow a blank, separated by commas; those in "
    "brackets may be left out. After → is the form of the reply.",
    "A *session* is one connection. The *shared patch* is that of `SENSe:PATCh`.",
    "Several commands in one message are separated by `;`. The next one continues at "
    "the last node of the one before: `SENS:EXP 4 MS;GAIN 0` sets `SENS:GAIN`. A leading `:` begins a whole header."
    " Replies of one message are joined by `;`.",
    "Numbers may carry a unit: `SENS:EXP 4 MS` is `SENS:EXP 0.004`. `MIN`, `MAX` and `DEF` mean the limits and the "
    "default; `SENS:EXP? MAX` asks for one. A value out of range is refused (error −222), never clipped.",
    "A query that fails has no reply; `SYST:ERR?` reports why. After a command error (−100 to −199) the rest of the "
    "message is ignored.",
    "Each connection has its own status, error queue, patch and formats. All connections share the settings of the "
    "camera, continuous measurement and the light box.",
    "Every value can be read with its standard uncertainty (k=1): `MEAS:RAD?` replies `value,u`. The number 9.91E+37 "
    'means "not a number", 9.9E+37 means infinity.',
    "A *block* holds any bytes: `#`, the number of digits of its length, its length, and the bytes. `#15hello` is one.",
    "**SCPI has no authentication.** The daemon listens on the loopback address; on another one only with a list of "
    "those who may connect (`--scpi-allow`).",
    "A web page can make a browser speak HTTP or TLS to this port. Such a client is disconnected before anything "
    "that it "
    "sends is executed. To detect it, a message with `SOURce` waits until a connection is 0.1 s old.",
    "Limits: 256 connections, 4096 bytes per message, 1000 messages per second and client (more are delayed). "
    "Where all "
    "connections are in use, the longest idle one is closed after a minute to make room. `OUTP:ALL OFF` is taken even "
    "where none is idle.",
    "A client is dropped after 30 s if it does not take its replies or does not finish a message. It is also dropped "
    "after 4 h without a message; an entry of the error queue warns 24 min before.",
    "The replies of one message may have 4 MB in total, the largest of them not counted. All replies above 1 MB that "
    "clients have not taken yet may have 256 MB in total. Beyond either limit a query fails with error −225.",
)

_EXAMPLE = """\

```python
import pyvisa

instrument = pyvisa.ResourceManager("@py").open_resource(
    "TCPIP::127.0.0.1::5025::SOCKET", read_termination="\\n", write_termination="\\n"
)
"""
_EXAMPLE_QUERY = """\
instrument.timeout = 30_000  # ms: a measurement takes its exposures, up to some seconds
radiance, u = map(float, instrument.query("MEAS:RAD? 400,300,64,64").split(","))
```

`lxi scpi --raw --address 127.0.0.1 --port 5025 "MEAS:RAD?"` does the same from the shell.
"""


def manual(table: CommandTable | None = None) -> str:
    """Return the text of the manual."""
    commands = sorted((table or command_table()).commands, key=lambda command: _ORDER.index(command.group))
    parts = [_INTRODUCTION, "\n", *(f"* {rule}\n" for rule in _RULES), _EXAMPLE, _EXAMPLE_QUERY]
    for group, members in groupby(commands, key=lambda command: command.group):
        parts.append(f"\n## {group}\n")
        parts += [_entry(command) for command in members]
        if group == "Status":
            parts.append(_bits("Operation status", status.OPERATION_BITS))
            parts.append(_bits("Questionable status", status.QUESTIONABLE_BITS))
    parts.append("\n## Errors\n\n| number | text |\n|---|---|\n")
    parts += [f"| {number} | {text} |\n" for number, text in MESSAGES.items()]
    parts.append("\nA semicolon and what exactly is wrong may follow the text.\n")
    return "".join(parts)


_ORDER = (MEASURING, SENSE, CALIBRATION, SOURCE, TRACE, STATUS, SYSTEM, COMMON)


def _entry(command: Command) -> str:
    lines = [f"\n### `{command.pattern}`\n\n{command.summary}\n\n"]
    if command.do is not None:
        names = _signature(command.parameters, len(command.parameters) if command.required < 0 else command.required)
        lines.append(f"* Command: `{command.pattern}{names}`\n")
    if command.ask is not None:
        names = _signature(command.ask_parameters, command.ask_required)
        lines.append(f"* Query: `{command.pattern}?{names}` → `{command.reply}`\n")
    for parameter in dict.fromkeys((*command.parameters, *command.ask_parameters)):
        lines.append(f"* {parameter.name}: `{parameter.form}`\n")
    lines.append(f"* Example: `{command.example}`\n")
    return "".join(lines)


def _signature(parameters: tuple[object, ...], required: int) -> str:
    names = [f"<{getattr(parameter, 'name', '')}>" for parameter in parameters]
    text = ",".join(names[:required]) + "".join(
        f"[{',' if position else ''}{name}]" for position, name in enumerate(names[required:], start=required)
    )
    return f" {text}" if text else ""


def _bits(title: str, meanings: dict[int, str]) -> str:
    rows = "".join(f"| {bit} | {1 << bit} | {text} |\n" for bit, text in meanings.items())
    return f"\n### {title}\n\n| bit | weight | set while |\n|---|---|---|\n{rows}"


if __name__ == "__main__":
    import sys

    sys.stdout.write(manual())

"""The command table: everything that the server understands, and what the manual is made from."""

from __future__ import annotations

from radiometer.daemon.scpi import common_commands, measure_commands, sense_commands, system_commands
from radiometer.daemon.scpi.language import CommandTable


def command_table() -> CommandTable:
    """Return the table of all commands."""
    return CommandTable(
        (*common_commands.COMMANDS, *measure_commands.COMMANDS, *sense_commands.COMMANDS, *system_commands.COMMANDS)
    )

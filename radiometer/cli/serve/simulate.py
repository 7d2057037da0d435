"""`radiometer simulate`: devices that do not exist, served as if they did.

A further device is one module with a function `command` and one line in the table; it is imported only when it runs.
"""

from __future__ import annotations

import difflib
import importlib
import sys
import textwrap
from typing import Any, Final

from radiometer.cli.commands import CommandEntry
from radiometer.errors import UsageError

DEVICES: Final[dict[str, CommandEntry]] = {
    "camera": CommandEntry(
        "radiometer.cli.serve.simulate_camera", "A Blackfly S over GigE Vision, for any GenICam program."
    ),
    "box": CommandEntry("radiometer.cli.serve.simulate_box", "The LED/button box on a serial port."),
}


def app(arguments: list[str], *, prog_name: str, standalone_mode: bool = False) -> Any:
    """Run the sub-command that the first word names.

    Args:
        arguments: Words after `radiometer simulate`.
        prog_name: What the help calls the program.
        standalone_mode: As Typer takes it.

    Raises:
        UsageError: If there is no such device.
    """
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_overview(prog_name), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    name, *words = arguments
    entry = DEVICES.get(name)
    if entry is None:
        close = difflib.get_close_matches(name, DEVICES, 1)
        hint = f"did you mean {close[0]!r}?" if close else f"there are: {', '.join(DEVICES)}"
        raise UsageError(f"there is no simulated device {name!r}; {hint}")
    import typer

    single = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    settings = {"help_option_names": ["-h", "--help"]}
    single.command(name=name, context_settings=settings)(importlib.import_module(entry.module).command)
    return single(words, prog_name=f"{prog_name} {name}", standalone_mode=standalone_mode)


def _overview(prog_name: str) -> str:
    width = max(map(len, DEVICES)) + 2
    lines = [
        textwrap.fill(entry.summary, 100, initial_indent=f"  {name:<{width}}", subsequent_indent=" " * (width + 2))
        for name, entry in DEVICES.items()
    ]
    return f"Usage: {prog_name} DEVICE [OPTIONS]\n\n  Serve a simulated device.\n\nDevices:\n" + "\n".join(lines)

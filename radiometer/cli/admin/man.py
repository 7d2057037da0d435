"""`radiometer man`: the manual page, made from the commands themselves."""

from __future__ import annotations

import re
from typing import Final

import radiometer
from radiometer.cli.tree import CommandHelp, command_tree

_OPENING: Final = (
    """\
.TH RADIOMETER 1 "" "radiometer {version}" "User Commands"
""",
    """\
.SH NAME
radiometer \\- turn a digital camera into an absolute radiance meter
""",
    """\
.SH SYNOPSIS
.B radiometer
.RB [ \\-v ]
.I COMMAND
.RI [ ARGUMENTS ]
""",
    """\
.SH DESCRIPTION
Brackets exposures, recovers the response of a camera, gives it an absolute scale, and reads radiance in
W sr\\-1 m\\-2 with an uncertainty off any patch of the picture.
Simulated devices can replace hardware: without a bench file the simulated bench is read.
""",
    """\
.SH OPTIONS
.TP
.BR \\-v ", " \\-\\-verbose
Log what happens to standard error; twice for more.
""",
    """\
.TP
.B \\-\\-version
Show the version and leave.
.TP
.BR \\-h ", " \\-\\-help
Show the commands and leave; after a command, what it does.
""",
    """\
.SH COMMANDS
""",
)

_CLOSING: Final = (
    """\
.SH EXIT STATUS
.TP
.B 0
Done.
.TP
.B 1
Failed; one line on standard error states what failed, where, and what to do.
.TP
.B 2
Misused.
""",
    """\
.SH ENVIRONMENT
.TP
.B NO_COLOR
Write no colours.
""",
    """\
.SH EXAMPLES
.TP
Read a patch of the simulated screen:
.EX
radiometer measure \\-\\-budget
.EE
""",
    """\
.TP
Take a bracket, recover the response, calibrate by a known source:
""",
    """\
.EX
radiometer bracket out/sphere \\-\\-camera 22500001
radiometer response out/sphere \\-o response.yaml
radiometer calibrate out/sphere \\-\\-response response.yaml \\-\\-patch 700,520,200,200 \\e
    \\-\\-radiance 1.0 \\-\\-u\\-rel 0.005 \\-o calibration.yaml
.EE
""",
)


def command() -> None:
    """Print the manual page.

    `radiometer man > ~/.local/share/man/man1/radiometer.1` puts it where `man radiometer` finds it.
    """
    print(manual_page(), end="")


def manual_page() -> str:
    """Return the manual page in the language of man(7)."""
    return (
        "".join(_OPENING).format(version=radiometer.__version__)
        + "".join(map(_section, command_tree()))
        + "".join(_CLOSING)
    )


def _section(one: CommandHelp) -> str:
    usage = [f".B radiometer {_text(' '.join(one.path))}"]
    if one.below:
        usage.append(".I COMMAND")
    if one.options:
        usage.append(".RI [ OPTIONS ]")
    usage += [f".RI {_text(name)}" for name, _ in one.arguments]
    paragraphs = "\n.PP\n".join(_text(paragraph) for paragraph in re.split(r"\n\s*\n", one.text))
    items = [
        f".TP\n.B {_text(name)}\n{_text(help_text) or 'See above.'}"
        for name, help_text in (*one.arguments, *one.options)
    ]
    return "\n".join([f".SS {_text(' '.join(one.path))}", *usage, ".PP", paragraphs, *items]) + "\n"


def _text(words: str) -> str:
    """Return words so that they mean nothing but themselves: no control line, minus signs as typed, one line."""
    plain = " ".join(words.split()).replace("\\", "\\e").replace("-", "\\-").replace("`", "")
    return f"\\&{plain}" if plain.startswith((".", "'")) else plain

"""Entry point of the command line: lazy commands, one-line errors, exit codes 0, 1 and 2."""

from __future__ import annotations

import codecs
import difflib
import errno
import importlib
import json
import os
import sys
import textwrap
from types import TracebackType
from typing import Any

import radiometer
from radiometer.cli.commands import COMMANDS, COMPLETING
from radiometer.errors import RadiometerError, UsageError

_TAKES_NOTHING = (errno.ENOSPC, errno.EDQUOT, errno.EBADF)  # a full disk; what the caller has closed
_INTRODUCTION = """\
Usage: radiometer [-v] COMMAND [ARGUMENTS]

  Turn a camera into an absolute radiance meter.
  `radiometer COMMAND --help` explains each command.

Options:
  -v, --verbose  Log what happens to standard error; twice for more.
  --version      Show the version and leave.
  -h, --help     Show this text and leave.

Commands:
"""


def main() -> None:
    """Run the command line and leave with exit code 0 (done), 1 (failed) or 2 (misused)."""
    if not {"-v", "-vv", "--verbose"} & set(sys.argv):
        sys.excepthook = _report_defect
    _stand_in_for_closed_streams()
    codecs.register_error("radiometer", _escaped)
    sys.stdout.reconfigure(errors="radiometer")  # type: ignore[union-attr]
    sys.exit(_flushed(run(sys.argv[1:])))


def _escaped(error: UnicodeError) -> tuple[str, int]:
    """Return what an encoding of the output has no signs for as JSON escapes it, so that JSON stays JSON."""
    assert isinstance(error, UnicodeEncodeError)
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


def _stand_in_for_closed_streams() -> None:
    """Open what a caller closed: no file may get the number of a standard stream, and no reading may get lost."""
    for name, how in (("stdin", os.O_RDONLY), ("stdout", os.O_RDONLY), ("stderr", os.O_WRONLY)):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, how)  # results cannot be written to what was opened to read: an error
            setattr(sys, name, os.fdopen(handle, "r" if name == "stdin" else "w", encoding="utf-8"))


def _flushed(code: int) -> int:
    """Return the exit code once standard output has taken everything: 1 where it did not."""
    try:
        sys.stdout.flush()
    except OSError as error:
        _drop_output()
        if code == 0 and not isinstance(error, BrokenPipeError):
            return _report(f"standard output: {error.strerror or error}", 1)
        return code or 1  # the reason was reported, or the reader has left
    return code


def _place_of(error: OSError) -> str:
    """Return the name of the file that an error is of, or "standard output": outputs name their file themselves."""
    if error.filename:
        return f"{error.filename}: "
    return "standard output: " if error.errno in _TAKES_NOTHING else ""


def _drop_output() -> None:
    """Let nothing that standard output did not take be tried again as Python leaves."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def run(arguments: list[str]) -> int:
    """Run the command line and return its exit code.

    Args:
        arguments: Words after the program's name.
    """
    try:
        return _dispatch(arguments)
    except RadiometerError as error:
        return _report(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _report("stopped by the user", 1)
    except BrokenPipeError:
        _drop_output()
        return 1
    except OSError as error:
        return _report(f"{_place_of(error)}{error.strerror or error}", 1)
    except MemoryError:
        return _report("not enough memory; try fewer or smaller frames", 1)


def overview() -> str:
    """Return the text of `radiometer --help`, made from the table of commands alone."""
    width = max(map(len, COMMANDS)) + 2
    lines = [
        textwrap.fill(entry.summary, 100, initial_indent=f"  {name:<{width}}", subsequent_indent=" " * (width + 2))
        for name, entry in COMMANDS.items()
    ]
    return _INTRODUCTION + "\n".join(lines)


def _dispatch(arguments: list[str]) -> int:
    if COMPLETING in os.environ:  # a shell asks for the words that may follow; typer answers and leaves
        from radiometer.cli.tree import group

        group().main(args=[], prog_name="radiometer")
    verbosity = 0
    for position, word in enumerate(arguments):
        if word in ("-h", "--help"):
            print(overview())
            return 0
        if word == "--version":
            print(f"radiometer {radiometer.__version__}")
            return 0
        if word in ("-v", "-vv", "--verbose"):
            verbosity += word.count("v") if word != "--verbose" else 1
            continue
        from radiometer.cli.logging_setup import configure_logging

        configure_logging(verbosity)
        return _run_command(word, arguments[position + 1 :])
    print(overview(), file=sys.stderr)
    return 2


def _run_command(name: str, arguments: list[str]) -> int:
    if name not in COMMANDS:
        close = difflib.get_close_matches(name, COMMANDS, 1)
        hint = f"did you mean {close[0]!r}?" if close else "`radiometer --help` lists them"
        raise UsageError(f"there is no command {name!r}; {hint}")
    import typer

    from radiometer.cli.tree import application

    whole_words = getattr(importlib.import_module(COMMANDS[name].module), "whole_words", list)
    click_error: Any = typer.BadParameter.__mro__[2]  # typer carries its own copy of click
    try:
        result = application(name).main(whole_words(arguments), prog_name=f"radiometer {name}", standalone_mode=False)
    except typer.Exit as leaving:
        return int(leaving.exit_code)
    except typer.Abort:
        return _report("stopped by the user", 1)
    except click_error as misuse:
        misuse.show()
        return int(misuse.exit_code)
    return result if isinstance(result, int) else 0


def _report_defect(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Say in one line what the program did not foresee; Python then leaves with exit code 1."""
    print(f"error: a defect of radiometer itself: {kind.__name__}: {error}", file=sys.stderr)
    print("please report it with what `radiometer -v …` prints for the same words", file=sys.stderr)


def _report(message: str, code: int) -> int:
    from radiometer.reporting.plain_text import one_line

    colour = sys.stderr.isatty() and "NO_COLOR" not in os.environ
    print("\x1b[1;31merror:\x1b[0m" if colour else "error:", one_line(message), file=sys.stderr)
    return code

"""The command line itself: arguments, keys, completion, logging, exit codes."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import logging
import os
import pty
import re
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import structlog

from radiometer.cli.arguments import (
    parse_bounds,
    parse_exposure,
    parse_f_number,
    parse_known_ratios,
    parse_measured_iso,
    parse_patch,
    parse_relative,
    parse_seconds,
)
from radiometer.cli.commands import COMMANDS
from radiometer.cli.light.adapt import listening
from radiometer.cli.logging_setup import configure_logging
from radiometer.cli.main import run
from radiometer.cli.tree import application
from radiometer.daemon.journal import Journal
from radiometer.errors import UsageError
from testing.patience import within


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_listed_command_explains_itself(name, capsys):
    """Each line of the table leads to a module with a help text."""
    assert run([name, "--help"]) == 0
    assert "Usage" in capsys.readouterr().out


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_is_documented(name):
    """A command's module says what it does."""
    assert importlib.import_module(COMMANDS[name].module).__doc__


@pytest.mark.slow
def test_the_overview_imports_nothing_heavy():
    """Help must come at once: neither NumPy nor typer may be loaded for it."""
    script = (
        "import sys; from radiometer.cli.main import run; run(['--help']);"
        "heavy = {'numpy', 'scipy', 'cv2', 'typer', 'rich', 'pydantic', 'matplotlib'} & set(sys.modules);"
        "sys.exit(repr(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert "measure" in done.stdout


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["mesure"], 2, "did you mean 'measure'"),
        (["measure", "--patch", "1,2,3"], 2, "expected X,Y,W,H"),
        (["measure", "--nonsense"], 2, "No such option"),
        (["measure", "--bench", "absent.yaml"], 2, "cannot read absent.yaml"),
        ([], 2, "Commands:"),
    ],
)
def test_misuse_gets_one_clear_line_and_code_two(words, code, message, capsys):
    """No traceback reaches a user."""
    assert run(words) == code
    printed = capsys.readouterr().err
    assert message in printed
    assert "Traceback" not in printed


@pytest.mark.parametrize("words", ["--help", "measure"])
@pytest.mark.parametrize(
    ("streams", "code"), [("2>&-", 0), (">/dev/full", 1), (">&-", 1), (">/dev/full 2>&-", 1), ("<&- >&- 2>&-", 1)]
)
def test_a_standard_stream_that_takes_nothing(words, streams, code):
    """A result that no one gets is a failure that its last line names; remarks that no one gets are none."""
    call = f"{sys.executable} -m radiometer {words} {streams}"
    ended = subprocess.run(["sh", "-c", call], capture_output=True, text=True, check=False)
    assert ended.returncode == code
    assert bool(ended.stdout) == (code == 0)
    if "2>&-" not in streams:
        assert ended.stderr.splitlines()[-1].startswith("error: standard output: ")
        assert ended.stderr.count("error:") == 1


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
@pytest.mark.parametrize("words", [[], ["--json"]], ids=["text", "JSON"])
def test_a_result_is_printed_whatever_the_encoding(encoding, words, tmp_path):
    """Signs that the encoding of the output does not have are escaped, as JSON does it: no reading is lost."""
    for number in (1, 2):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((40, 40), 20_000 * number, np.uint16))
    (tmp_path / "exposures.txt").write_text("1.png 1\n2.png 2\n")
    call = [sys.executable, "-m", "radiometer", "measure", "--photographs", str(tmp_path), "--linear"]
    call += ["--uncalibrated", "--patch", "9,9,9,9", *words]
    printed = []
    for one in (encoding, "utf-8"):
        ended = subprocess.run(call, capture_output=True, check=False, env={**os.environ, "PYTHONIOENCODING": one})
        assert (ended.returncode, b"defect" in ended.stderr) == (0, False)
        printed.append(ended.stdout.decode(one))
    escaped, whole = printed
    if words:
        assert json.loads(escaped).keys() == json.loads(whole).keys()
    else:
        assert "±" in whole
        assert len(re.sub(r"\\u[0-9a-f]{4}", "?", escaped)) == len(whole)


def test_version_is_reported(capsys):
    """`--version` prints name and number."""
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.startswith("radiometer ")


def test_texts_from_outside_do_not_steer_the_terminal(tmp_path, capsys):
    """A remark and a file name with escape characters: on standard output and in an error they are written out."""
    journal = Journal(tmp_path / "journal.sqlite")
    journal.open()
    journal.note("remark", "lamp\x1b]0;title\x07 [/bold] changed\nreading 1: 5 W")
    journal.close()
    assert run(["log", str(tmp_path / "journal.sqlite"), "--events"]) == 0
    assert run(["merge", "a\x1b[2Jb", "-o", str(tmp_path / "map.exr")]) != 0
    printed = capsys.readouterr()
    assert ("\x1b" in printed.out + printed.err, printed.out.count("\n")) == (False, 1)
    assert "\\x1b]0;title" in printed.out
    assert "a\\x1b[2Jb" in printed.err


@pytest.mark.parametrize("name", ["a\nerror: b", "a\x1b[2Jb", "a\rb", "a\u2028b", "a\u202eb", "[bold]a"])
def test_names_of_files_stay_in_one_line(name, tmp_path, monkeypatch):
    """Folders with line feeds and escape characters before `batch` and `quality`, on a terminal with a progress bar."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).mkdir()
    (tmp_path / name / "00001.png").write_bytes(b"x")
    for words in (
        ["batch", "."],
        ["batch", name],
        ["quality", "report", name],
        ["quality", "take", name, "range", name],
    ):
        terminal = _Terminal()
        monkeypatch.setattr("sys.stderr", terminal)
        assert run(words) != 0 or words == ["batch", "."]
        printed = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]|\r", "", terminal.getvalue())  # the bar's own
        assert not re.search("[\x00-\x09\x0b-\x1f\u2028\u202e]", printed)
        assert "\nerror: b" not in printed
        assert "\x1b[2J" not in terminal.getvalue()


class _Terminal(io.StringIO):
    """Standard error as a terminal."""

    def isatty(self) -> bool:
        return True


def _given_options(command: Any, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield each option of a command and of those below it, after the words of its command."""
    for option in command.params:
        if option.param_type_name == "option" and option.name != "help":
            yield path, option
    for name, inner in getattr(command, "commands", {}).items():
        yield from _given_options(inner, *path, name)


@pytest.mark.parametrize("name", COMMANDS)
def test_an_option_of_one_value_is_not_given_twice(name, tmp_path, monkeypatch, capsys):
    """The last value would win without a word; `--no-x` after `--x` likewise. Whatever the values, nothing happens."""
    monkeypatch.chdir(tmp_path)
    for path, option in _given_options(application(name), name):
        value = [] if option.is_flag else ["1"]
        words = [*path, option.opts[0], *value, (option.secondary_opts or option.opts)[0], *value]
        if option.multiple or (option.is_flag and not option.secondary_opts):
            continue
        assert run(words) == 2, words
        assert capsys.readouterr().err == f"error: {max(option.opts, key=len)} is given twice; give it once\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("text", "value"), [("0.05", 0.05), ("5%", 0.05), ("5 %", 0.05), ("0", 0.0), (None, None)])
def test_a_relative_quantity_is_a_fraction_or_per_cent(text, value):
    """Both forms give the same number."""
    assert parse_relative(text, "--u-rel") == pytest.approx(value)


@pytest.mark.parametrize(("text", "seconds"), [("1/125", 0.008), ("8ms", 0.008), ("125s", 125.0), ("30", 30.0)])
def test_an_exposure_time_with_its_unit_or_a_plausible_number(text, seconds):
    """Times that mean one thing alone are taken."""
    assert parse_exposure(text, "--from") == pytest.approx(seconds)
    assert parse_seconds("600", "--for") == 600.0  # a light may well be on for ten minutes


@pytest.mark.parametrize(("text", "number"), [("4", 4.0), ("f/2.8", 2.8), ("F/16", 16.0)])
def test_an_f_number_as_it_is_written(text, number):
    """The number alone, or with f/ before it."""
    assert parse_f_number(text, "--f-number") == number


@pytest.mark.parametrize(
    ("parse", "taken", "refused"),
    [
        (parse_f_number, ["0.5", "90", "f/1000"], ["0.49", "90.1", "f/1000.1", "0", "f/"]),
        (parse_relative, ["0", "0.999", "99.9%"], ["-1e-9", "1", "100%", "nan", "inf%"]),
        (parse_exposure, ["30", "30.1s", "1e-9"], ["30.1", "0", "-1ms", "8 kg"]),
        (parse_bounds, ["1e-9,2e-9"], ["0,1", "1,1", "2,1", "1,inf", "1"]),
        (parse_patch, ["0,0,1,1"], ["-1,0,1,1", "0,-1,1,1", "0,0,0,1", "0,0,1,0", "0,0,1"]),
        (parse_measured_iso, [["200=1e-9", "0=1"]], [["200=0"], ["-1=5"], ["1=inf"], ["inf=1"], ["2=1", "2=3"]]),
        (parse_known_ratios, [["0=1.001", "1=2"]], [["0=1"], ["0.5=2"], ["-1=2"], ["1=2", "1=3"], ["a=2"]]),
    ],
)
def test_each_bound_is_taken_and_one_step_beyond_is_misuse(parse, taken, refused):
    """What a lens, a share, a time, a range, a patch, a speed and a ratio can be."""
    option = () if parse in (parse_patch, parse_measured_iso, parse_known_ratios) else ("--option",)
    for text in taken:
        assert parse(text, *option) is not None
    for text in refused:
        with pytest.raises(UsageError):
            parse(text, *option)


@pytest.mark.parametrize(
    ("words", "way_out"),
    [
        ("measure --u-rel 5", "is 500 %; write 5%, or a fraction below 1"),
        ("measure --u-rel 120%", "must be below 100 %"),
        ("measure --u-rel -0.01", "must be 0 or more"),
        ("bracket out --from 1/1000 --to 125", "is 125 s meant, or 1/125 s? Write 125s or 1/125"),
        ("calibrate -o c --iso 100 --exposure 125", "is 125 s meant, or 1/125 s? Write 125s or 1/125"),
        ("calibrate -o c --exposure 16 --f-number 125", "is f/125 meant, or the exposure time? Write f/125"),
        ("calibrate -o c --exposure 16 --f-number 1/125", "is it the exposure time?"),
        ("measure --f-number 0.008", "f-numbers go from 0.5 to 1000; is it the exposure time?"),
        ("new-bench b.yaml --camera sim --focal-length 16 --f-number 1/125", "expected an f-number such as 4 or f/4"),
    ],
)
def test_what_is_implausible_is_misuse(words, way_out, capsys, tmp_path, monkeypatch):
    """Nothing is measured; the message names the option and says what to write."""
    monkeypatch.chdir(tmp_path)
    assert run(words.split()) == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert words.split()[-2] in printed
    assert way_out in printed
    assert not list(tmp_path.iterdir())


def _options(command: Any, *path: str) -> Iterator[tuple[str, ...]]:
    """Yield each option of a command and of those below it, after the words of its command."""
    yield from ((*path, option.opts[0]) for option in command.params)
    for name, inner in getattr(command, "commands", {}).items():
        yield from _options(inner, *path, name)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_relative_quantity_of_five_is_misuse(name, capsys, tmp_path, monkeypatch):
    """5 may be 500 % or 5 %: whatever the command, the message says what to write."""
    monkeypatch.chdir(tmp_path)
    for words in _options(application(name), name):
        if words[-1].endswith("-u-rel"):
            assert run([*words, "5"]) == 2, words
            assert f"{words[-1]} 5: is 500 %; write 5%" in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Return the other end of a terminal that is standard input."""
    outer, inner = pty.openpty()
    with os.fdopen(inner, "r") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield outer
    os.close(outer)


def test_keys_call_their_actions_without_enter(keyboard: int) -> None:
    """Other keys do nothing; echo and line mode are back after the block."""
    heard, paused, stopped = [], threading.Event(), threading.Event()
    before = termios.tcgetattr(sys.stdin.fileno())
    actions = {"p": lambda: (heard.append("p"), paused.set()), "q": lambda: (heard.append("q"), stopped.set())}
    with listening(actions):  # type: ignore[arg-type]
        os.write(keyboard, b"xp")
        assert paused.wait(within(60.0))
        os.write(keyboard, b"q")
        assert stopped.wait(within(60.0))
    assert heard == ["p", "q"]
    assert termios.tcgetattr(sys.stdin.fileno()) == before


def test_nothing_is_read_where_input_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pipe belongs to whoever wrote into it."""
    monkeypatch.setattr(sys, "stdin", io.StringIO("ppp"))
    with listening({"p": pytest.fail}):  # type: ignore[dict-item]
        pass
    assert sys.stdin.read() == "ppp"


ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def scripts(tmp_path: Path) -> Path:
    """Return a folder with a program `radiometer` that is this checkout."""
    program = tmp_path / "radiometer"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m radiometer "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    return tmp_path


def environment(scripts: Path, **more: str) -> dict[str, str]:
    """Return the environment of a shell that finds the program."""
    found = {**os.environ, **more, "PATH": f"{scripts}:{os.environ['PATH']}"}
    return found | {"PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        (("re",), {"response", "reconcile"}),
        (("measure", "--ph"), {"--photographs"}),
        (("merge", "--ph"), set()),
        (("light", "cal"), {"calibrate"}),
        (("light", "calibrate", "--see"), {"--seed"}),
    ],
)
def test_bash_completes_commands_and_options(line, offered, scripts, capsys):
    """The script that is printed makes bash offer what begins as typed, and no other command's option."""
    assert run(["completion", "bash"]) == 0
    words = " ".join(f'"{word}"' for word in ("radiometer", *line))
    asked = (
        f"COMP_WORDS=({words}); COMP_CWORD={len(line)}; _radiometer_completion radiometer; "
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "-c", capsys.readouterr().out + asked],
        capture_output=True, text=True, check=True, env=environment(scripts),
    )  # fmt: skip
    assert set(done.stdout.split()) == offered


@pytest.mark.slow
@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_zsh_and_fish_get_options_with_what_they_do(shell, scripts, capsys):
    """Their scripts ask the program; it answers with each option and its help."""
    assert run(["completion", shell]) == 0
    assert "_RADIOMETER_COMPLETE" in capsys.readouterr().out
    asked = {"_TYPER_COMPLETE_ARGS": "radiometer measure --ph", "_RADIOMETER_COMPLETE": f"complete_{shell}"}
    more = {"_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    done = subprocess.run(
        ["radiometer"], capture_output=True, text=True, check=True, env=environment(scripts, **asked, **more)
    )
    assert "--photographs" in done.stdout
    assert "Folder of photographs" in done.stdout


def test_another_shell_is_misuse(capsys):
    """The message names those that there are."""
    assert run(["completion", "tcsh"]) == 2
    assert "choose one of bash, zsh, fish" in capsys.readouterr().err


def _failed(message: str) -> None:
    secret_table = list(range(50_000))  # what a traceback with its variables would print
    try:
        raise ZeroDivisionError(message, len(secret_table))
    except ZeroDivisionError:
        structlog.get_logger("test").exception("advice failed", what="the limits")


@pytest.mark.parametrize("verbosity", [0, 1])
def test_an_error_is_one_line(verbosity, capsys):
    """What failed, which error, what it says and where: one line, no traceback."""
    configure_logging(verbosity)
    _failed("by nothing")
    (line,) = capsys.readouterr().err.splitlines()
    for part in ("advice failed", "the limits", "ZeroDivisionError", "by nothing", "test_main.py:"):
        assert part in line


def test_who_asks_for_everything_gets_the_traceback_without_its_variables(capsys):
    """At DEBUG the traceback is plain: the lines of code, not what the variables hold."""
    configure_logging(2)
    _failed("by nothing")
    printed = capsys.readouterr().err
    assert "Traceback" in printed
    assert "49999" not in printed


def _numbers(command: Any, *path: str) -> Iterator[tuple[str, ...]]:
    """Yield each option of a command and of those below it that takes a number, after the words of its command."""
    for option in command.params:
        if option.param_type_name == "option" and option.type_descriptor.annotation is float:
            yield (*path, option.opts[0])
    for name, inner in getattr(command, "commands", {}).items():
        yield from _numbers(inner, *path, name)


@pytest.mark.parametrize("name", COMMANDS)
def test_no_option_takes_what_is_no_number(name, tmp_path, monkeypatch):
    """A limit lets nan pass, and without one infinity passes, too; each is refused before anything happens."""
    monkeypatch.chdir(tmp_path)
    for words in _numbers(application(name), name):
        assert [run([*words, value]) for value in ("nan", "inf")] == [2, 2], words
    assert not list(tmp_path.iterdir())


def test_a_log_that_cannot_be_written_ends_no_program(monkeypatch):
    """A full disk, or a pipe whose reader has ended: the daemon goes on, and its alarms are on every interface."""
    reader, writer = os.pipe()
    os.close(reader)
    for target in (os.open("/dev/full", os.O_WRONLY), writer):
        with open(target, "w", buffering=1, closefd=False) as full:
            monkeypatch.setattr("sys.stderr", full)
            configure_logging()
            assert structlog.get_logger("test").warning("patch main is beyond its limit") is None
            monkeypatch.undo()
            with contextlib.suppress(OSError):
                full.close()
        os.close(target)


def test_an_event_without_an_error_says_nothing_of_one(capsys):
    """A plain warning stays as it is."""
    configure_logging()
    structlog.get_logger("test").warning("camera warms up", kelvin=3.5)
    (line,) = capsys.readouterr().err.splitlines()
    assert "kelvin" in line
    assert "error=" not in line


def test_what_a_library_says_of_a_damaged_file_is_for_who_asks_for_everything(capsys):
    """Ours is the one line; what tifffile logs next to it comes at DEBUG alone."""
    for verbosity, lines in ((0, []), (1, []), (2, ["invalid value offset"]), (0, [])):
        configure_logging(verbosity)
        logging.getLogger("tifffile").error("invalid value offset")
        assert capsys.readouterr().err.splitlines() == lines

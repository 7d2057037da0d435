"""The command line itself: arguments, keys, completion, outputs, logging, exit codes."""

import contextlib
import importlib
import inspect
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
from pathlib import Path

import cv2
import numpy as np
import pytest
import structlog

import radiometer as rm
from radiometer.bench.boxes import calibration_file
from radiometer.bench.served import served_camera
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
from radiometer.cli.tree import application, command_tree
from radiometer.daemon.journal import Journal
from radiometer.errors import ConfigurationError, UsageError
from testing.patience import within


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_listed_command_explains_itself(name, capsys):
    """Each line of the table leads to a module that says what it does, with a help text."""
    assert importlib.import_module(COMMANDS[name].module).__doc__
    assert run([name, "--help"]) == 0
    assert "Usage" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "heavy", "shown"),
    [
        (["--help"], {"numpy", "scipy", "cv2", "typer", "rich", "pydantic", "matplotlib"}, "measure"),
        (["flicker", "--help"], {"scipy", "radiometer.api.flicker"}, "--duration"),
    ],
)
def test_help_imports_nothing_heavy(words, heavy, shown):
    """Help and completion answer at once: a library of arrays, and a command's function, are imported when called."""
    script = (
        f"import sys; from radiometer.cli.main import run; run({words}); sys.exit(repr({heavy} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "set()"
    assert shown in done.stdout


MISUSE = [
    ("", 2, "Commands:"),
    ("mesure", 2, "did you mean 'measure'"),
    ("completion tcsh", 2, "choose one of bash, zsh, fish"),
    ("measure --patch 1,2,3", 2, "expected X,Y,W,H"),
    ("measure --patch 1600,0,40,40", 2, "1616 × 1240"),
    ("measure --nonsense", 2, "No such option"),
    ("measure --bench absent.yaml", 2, "cannot read absent.yaml"),
    ("measure --u-rel 120%", 2, "--u-rel 120%: must be below 100 %"),
    ("measure --u-rel -0.01", 2, "--u-rel '-0.01': must be 0 or more"),
    ("measure --f-number 0.008", 2, "f-numbers go from 0.5 to 1000; is it the exposure time?"),
    ("merge p -o a.exr --align maybe", 2, "auto, on, off"),
    ("measure --measured-iso 200=136", 2, "--photographs"),
    ("measure --photographs . --camera sim", 2, "--photographs"),
    ("measure --photographs .", 2, "--photographs"),
    ("bracket out --from 1us --to 1ms", 1, "allowed is 1.1e-05 to 30 s"),
    ("bracket out --from 1/1000 --to 125", 2, "is 125 s meant, or 1/125 s? Write 125s or 1/125"),
    ("calibrate -o c --iso 100 --exposure 125", 2, "is 125 s meant, or 1/125 s? Write 125s or 1/125"),
    ("calibrate -o c --exposure 16 --f-number 125", 2, "is f/125 meant, or the exposure time? Write f/125"),
    ("calibrate -o c --exposure 16 --f-number 1/125", 2, "is it the exposure time?"),
    ("characterise", 2, "name a capture set (or descriptor file), or a camera with --camera"),
    ("characterise nowhere", 1, "nowhere does not exist"),
    ("characterise nowhere --camera sim", 2, "one of both"),
    ("flicker", 2, "--camera"),
    ("flicker lamp.csv --camera sim", 2, "no file"),
    ("flicker --camera sim --duration 0", 2, "above 0"),
    ("flicker --camera sim --dark 0.1", 2, "no file"),
    ("new-bench b.yaml", 2, "needs a camera"),
    ("new-bench b.yaml --camera 1 --focal-length 16", 2, "needs its f-number"),
    ("new-bench b.yaml --camera 1 --focal-length -3", 2, "give finite number above 0"),
    ("new-bench b.yaml --camera sim --focal-length 16 --f-number 1/125", 2, "expected an f-number such as 4 or f/4"),
    ("quality take s nonsense far", 2, "is no procedure"),
    ("quality take s focus middle", 2, "is no step of focus"),
    ("quality take s size ../x", 2, "no step"),
    *(
        (f"quality take s range {name}", 2, "no step")
        for name in ("12,5dB", "+12dB", "1e1dB", "nandB", "12dBm", "x1dB")
    ),
    *((f"quality take s polarisation {name}", 2, "no step") for name in ("nan", "1e999")),
    ("screen calibrate -o x.yaml --display plasma", 2, "plasma"),
    ("screen calibrate -o x.yaml --display oled --levels few", 2, "few"),
    ("screen calibrate -o x.yaml --display oled --export xlsx", 2, "xlsx"),
    ("screen calibrate -o x.yaml --display oled --channels gray", 2, "gray"),
    ("screen calibrate -o x.yaml", 2, "--camera"),
    *(
        (f"screen report --display {words} -o x.html", 2, message)
        for words, message in (
            ("plasma", "--area X,Y,W,H"), ("lcd --methods smell", "smell"),
            ("lcd --methods viewing_angle", "viewing_angle"),
            ("lcd --geometry sideways", "sideways"), ("lcd --points 12", "--points"), ("lcd --checkers 4", "4"),
            ("lcd --checkers 3x3", "3x3"), ("lcd --angles left", "left"), ("lcd --angles=-90,90", "90"),
            ("lcd --levels few", "few"),
            ("oled --area 0,0,30,20 --warm-up 0 --methods white", "move the camera closer"),
        )
    ),
    ("screen report --camera 22500001 -o x.html", 2, "--area X,Y,W,H"),
    ("measure --linear", 2, "--linear"),
    ("measure --linear --photographs . --calibration none.yaml", 2, "--linear"),
    ("merge . --linear --response c.csv -o a.exr", 2, "leave --response out"),
    ("light set spot --level 9 --box sim --eye both", 2, "--eye"),
    ("adapt run nothing --subject A --simulate steady", 2, "nothing"),
    ("adapt run classic --subject A --simulate asleep", 2, "asleep"),
    ("adapt run classic --subject A --simulate steady --box LB000001", 2, "--box"),
    ("light set spot --box sim", 2, "either --radiance or --level"),
    ("light set spot --level 5 --radiance 1 --box sim", 2, "either --radiance or --level"),
    ("light set green --level 5 --box sim", 2, "it has bleach, spot"),
    ("light pulse spot --level 5 --duration soon --box sim", 2, "--duration 'soon'"),
    ("light calibrate --channel green --box sim", 2, "it has bleach, spot"),
    ("light status --box NONE0001", 1, "--box sim"),
    ("log none.sqlite", 1, "radiometer serve"),
    ("simulate", 2, "camera"),
    ("simulate camrea", 2, "'camera'"),
    ("simulate camera --scene no/none.yaml", 2, "none.yaml"),
    *(
        (f"adapt run quick --subject S --simulate steady {own}", 2, f"{own.split()[0]} has no effect without {other}")
        for own, other in (
            ("--display lcd", "--screen"), ("--port 8000", "--screen"), ("--room 1", "--box sim"),
            ("--preset box.yaml", "--box"), ("--calibration light.yaml", "--box"), ("--fixation 0.1", "--box"),
        )
    ),
    ("adapt run quick --subject S7 --box sim", 2, "the simulated box needs a simulated subject: --simulate steady"),
    ("response p -o curve.txt", 2, "ending must be one of"),
    ("response p --plot curve.gif", 2, "ending must be one of"),
    ("response p --method guess", 2, "there is no response method 'guess'"),
    *((f"serve --mqtt {text}", 2, "HOST") for text in (":1883", "host:0", "host:99999", "host:abc")),
    ("serve --mqtt localhost --mqtt-prefix lab/#", 2, "prefix"),
    ("serve --scpi-address 0.0.0.0", 2, "--scpi-allow"),
    ("serve --http-address 0.0.0.0 --no-scpi", 2, "--token-file"),
    ("serve --scpi-allow nonsense", 2, "no network"),
    ("serve --bench absent.yaml", 2, "absent.yaml"),
    ("serve --every -1", 2, "--every"),
    ("serve --scpi-port 99999", 2, "--scpi-port"),
]  # fmt: skip


@pytest.fixture
def state(tmp_path_factory):
    """Return a folder for what programs keep of themselves."""
    return tmp_path_factory.mktemp("state")


@pytest.mark.parametrize(("words", "code", "message"), MISUSE)
def test_misuse_gets_one_clear_line_and_its_exit_code(words, code, message, capsys, tmp_path, monkeypatch, state):
    """No traceback reaches a user; the line names what is wrong and the way out, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    for name in ("XDG_DATA_HOME", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, str(state))
    assert run(words.split()) == code
    printed = capsys.readouterr().err
    assert message in " ".join(printed.split())
    assert "Traceback" not in printed
    assert words in ("", "simulate") or "rror: " in printed.splitlines()[-1]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "streams", "code"),
    [
        *(
            (words, streams, code)
            for words in ("--help", "alpha-opic 80 --unit lx --spectrum cie_d65")
            for streams, code in ((">/dev/full", 1), (">&-", 1), (">/dev/full 2>&-", 1), ("<&- >&- 2>&-", 1))
        ),
        ("measure", "2>&-", 0),
    ],
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


@pytest.mark.parametrize(("words", "encodings"), [([], ("ascii", "latin-1")), (["--json"], ("ascii",))])
def test_a_result_is_printed_whatever_the_encoding(words, encodings):
    """Signs that the encoding of the output does not have are escaped, as JSON does it: no reading is lost."""
    call = [sys.executable, "-m", "radiometer", "alpha-opic", "80", "--u", "0.8", "--spectrum", "white_led", *words]
    printed = []
    for one in ("utf-8", *encodings):
        ended = subprocess.run(call, capture_output=True, check=False, env={**os.environ, "PYTHONIOENCODING": one})
        assert (ended.returncode, b"defect" in ended.stderr) == (0, False)
        printed.append(ended.stdout.decode(one))
    whole, *others = printed
    for escaped in others:
        if words:
            assert json.loads(escaped).keys() == json.loads(whole).keys()
        else:
            assert "±" in whole
            assert len(re.sub(r"\\u[0-9a-f]{4}", "?", escaped)) == len(whole)


def test_version_and_what_cannot_be_replaced_unasked(capsys):
    """Name and number; --force is off in every command that has it."""
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.startswith("radiometer ")
    asked = {" ".join(path): one.default for path, command in _ALL for one in command.params if "--force" in one.opts}
    assert len(asked) > 20
    assert {name for name, default in asked.items() if default} == set()


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

    def isatty(self):
        return True


def _options(command, *path):
    """Yield each option of a command and of those below it, after the words of its command."""
    for option in command.params:
        if option.param_type_name == "option" and option.name != "help":
            yield path, option
    for name, inner in getattr(command, "commands", {}).items():
        yield from _options(inner, *path, name)


def _senseless(option):
    """Yield values that an option cannot take, each with what the message holds besides the option."""
    long, limits = max(option.opts, key=len), option.type_descriptor.parameter_info
    if option.type_descriptor.annotation is float or (limits.min, limits.max) != (None, None):
        yield from (("nan", ""), ("inf", ""))
    if limits.min is not None:
        yield f"{limits.min - 1}", ""
    if limits.max is not None:
        yield f"{limits.max * 2}", ""
    if long.endswith("-u-rel"):  # 500 % or 5 %?
        yield "5", f"{long} 5: is 500 %; write 5%"


@pytest.mark.parametrize("name", COMMANDS)
def test_an_option_takes_one_sensible_value(name, tmp_path, monkeypatch, capsys):
    """No number outside its range, no NaN, no infinity, no share that may be per cent, and none twice.

    The last of two would win without a word; `--no-x` after `--x` likewise. Whatever the values, nothing happens.
    """
    monkeypatch.chdir(tmp_path)
    for path, option in _options(application(name), name):
        long = max(option.opts, key=len)
        for value, message in _senseless(option):
            assert run([*path, f"{long}={value}"]) == 2, (path, long, value)
            printed = " ".join(capsys.readouterr().err.split())
            assert long in printed
            assert message in printed
        if not option.multiple and (not option.is_flag or option.secondary_opts):
            value = [] if option.is_flag else ["1"]
            words = [*path, option.opts[0], *value, (option.secondary_opts or option.opts)[0], *value]
            assert run(words) == 2, words
            assert capsys.readouterr().err == f"error: {long} is given twice; give it once\n"
    assert not list(tmp_path.iterdir())


def test_the_options_of_a_command_have_the_ranges_of_its_function():
    """Those of the bleach and of a photograph's reference, as examples of each way in which commands are made."""
    for words, name, low, high in (
        (("adapt", "bleach"), "--pupil", 1.0, 9.0),
        (("alpha-opic",), "--wavelength-u", 0.0, 50.0),
        (("calibrate",), "--luminance-meter-k", 5.0, 30.0),
    ):
        (option,) = (
            one for path, one in _options(application(words[0]), words[0]) if path == words and name in one.opts
        )
        limits = option.type_descriptor.parameter_info
        assert (limits.min, limits.max) == (low, high)


def _documented_with_an_option_twice():
    """Return the words of each documented command that states an option more than once."""
    pages = "".join(page.read_text(encoding="utf-8") for page in (Path(__file__).parents[3] / "docs").rglob("*.md"))
    lines = re.findall(r"(?:^\$ |`)radiometer ([^`\n#]*)", pages, re.MULTILINE)
    return [one.split() for one in lines if re.search(r"(--[a-z-]+) .*\1 ", one)]


@pytest.mark.parametrize("words", _documented_with_an_option_twice(), ids=lambda words: words[0])
def test_a_documented_option_may_be_given_as_often_as_the_page_gives_it(words, tmp_path, monkeypatch, capsys):
    """Regions, filters and maps are named one by one; without their files each command fails for the file alone."""
    monkeypatch.chdir(tmp_path)
    assert run(words) != 0
    assert "is given twice" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [
        *((parse_relative, text, 0.05) for text in ("0.05", "5%", "5 %")), (parse_relative, "0", 0.0),
        (parse_exposure, "1/125", 0.008), (parse_exposure, "8ms", 0.008),
        (parse_exposure, "125s", 125.0), (parse_exposure, "30", 30.0),
        (parse_seconds, "600", 600.0),  # a light may well be on for ten minutes
        (parse_f_number, "4", 4.0), (parse_f_number, "f/2.8", 2.8), (parse_f_number, "F/16", 16.0),
    ],
)  # fmt: skip
def test_a_quantity_is_taken_as_it_is_written(parse, text, value):
    """A fraction or per cent, a time with its unit or a plausible number, an f-number with f/ before it or without."""
    assert parse(text, "--option") == pytest.approx(value)


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


@pytest.fixture
def keyboard(monkeypatch):
    """Return the other end of a terminal that is standard input."""
    outer, inner = pty.openpty()
    with os.fdopen(inner, "r") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield outer
    os.close(outer)


def test_keys_call_their_actions_without_enter(keyboard):
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


def test_nothing_is_read_where_input_is_no_terminal(monkeypatch):
    """A pipe belongs to whoever wrote into it."""
    monkeypatch.setattr(sys, "stdin", io.StringIO("ppp"))
    with listening({"p": pytest.fail}):  # type: ignore[dict-item]
        pass
    assert sys.stdin.read() == "ppp"


ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def scripts(tmp_path):
    """Return a folder with a program `radiometer` that is this checkout."""
    program = tmp_path / "radiometer"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m radiometer "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    return tmp_path


def environment(scripts, **more):
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


def _failed(message):
    secret_table = list(range(50_000))  # what a traceback with its variables would print
    try:
        raise ZeroDivisionError(message, len(secret_table))
    except ZeroDivisionError:
        structlog.get_logger("test").exception("advice failed", what="the limits")


def test_errors_and_events_are_one_line_and_everything_on_demand(capsys):
    """No traceback but at DEBUG, and there without the variables; libraries are heard there alone."""
    for verbosity in (0, 1):
        configure_logging(verbosity)
        _failed("by nothing")
        (line,) = capsys.readouterr().err.splitlines()
        for part in ("advice failed", "the limits", "ZeroDivisionError", "by nothing", "test_main.py:"):
            assert part in line
    configure_logging(2)
    _failed("by nothing")
    printed = capsys.readouterr().err
    assert "Traceback" in printed
    assert "49999" not in printed
    configure_logging()
    structlog.get_logger("test").warning("camera warms up", kelvin=3.5)
    (line,) = capsys.readouterr().err.splitlines()
    assert "kelvin" in line
    assert "error=" not in line
    for verbosity, lines in ((0, []), (1, []), (2, ["invalid value offset"]), (0, [])):
        configure_logging(verbosity)
        logging.getLogger("tifffile").error("invalid value offset")
        assert capsys.readouterr().err.splitlines() == lines


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


# Commands that are made of a public function say what the function says.


MADE = {
    ("alpha-opic",): "alpha_opic",
    ("analyse",): "analyse",
    ("certificate",): "certificate",
    ("colour", "calibrate"): "colour_calibrate",
    ("colour", "measure"): "colour_measure",
    ("flicker",): "flicker",
    ("screen", "report"): "screen_report",
}
_SERVED = {"ask", "announce", "notice", "progress"}  # by the terminal


@pytest.mark.parametrize("path", MADE, ids=" ".join)
def test_a_command_has_the_parameters_of_its_function_and_its_words(path):
    """One entry per parameter, defaults and text alike; besides those only files of the result, --json and --force."""
    function = getattr(rm, MADE[path])
    found = next(one for one in command_tree() if one.path == path)
    document = " ".join((inspect.getdoc(function) or "").split())
    assert document.startswith(" ".join(found.text.split()))
    parameters = {name: one for name, one in inspect.signature(function).parameters.items() if name not in _SERVED}
    entries = [*found.arguments, *found.options]
    own = [name for name, _ in entries if name.split()[0] in ("--plot", "--csv", "--json", "--open")]
    own += ["--force"] * ("force" not in parameters and any(name.startswith("--force") for name, _ in entries))
    own += ["--report"] * ("report" not in parameters and any(name.startswith("--report") for name, _ in entries))
    assert len(entries) == len(parameters) + len(own)
    numbers = [one.default for one in parameters.values() if isinstance(one.default, int | float)]
    shown = " ".join(text for _, text in entries)
    assert all(f"[default: {number}" in shown for number in numbers if not isinstance(number, bool))


# Every command that writes checks its outputs before its work: their folder, and that nothing is overwritten.


_WRITES = re.compile(r"\b(write|written(?! by)|draw|drawn|create|keep the frames)\b", re.IGNORECASE)
_JOURNALS = {("batch", "output"), ("adapt run", "out"), ("serve", "journal")}  # taken up where they end, never replaced


def _leaves(path, found):
    inner = getattr(found, "commands", None)
    if not inner:
        yield path, found
    for name, single in (inner or {}).items():
        yield from _leaves((*path, name), single)


_ALL = [leaf for name in COMMANDS for leaf in _leaves((name,), application(name))]
_OUTPUTS = [
    pytest.param(path, command, name, id=f"{'-'.join(path)}-{name}")
    for path, command in _ALL
    for name in (
        *getattr(command.callback, "output_files", ()),
        *filter(None, [getattr(command.callback, "output_folder", None)]),
    )
]


def _words(path, command, name, target):
    """Return a call in which everything required is given, and one output."""
    words = list(path)
    for one in command.params:
        value = str(target) if one.name == name else "1" if one.required else None
        if value is not None:
            words += [value] if one.param_type_name == "argument" else [one.opts[0], value]
    return words


def test_every_option_that_names_an_output_is_checked():
    """By the words of its help: what writes, draws, creates or keeps is declared, or asks for --force itself."""
    unchecked = [
        f"{' '.join(path)} {one.name}"
        for path, command in _ALL
        for one in command.params
        if "Path" in str(one.type_descriptor.annotation) and _WRITES.search(one.help or "")
        if one.name not in getattr(command.callback, "output_files", ())
        if one.name != getattr(command.callback, "output_folder", None)
        if (" ".join(path), one.name) not in _JOURNALS
    ]
    assert unchecked == []


@pytest.mark.parametrize(("path", "command", "name"), _OUTPUTS)
def test_an_output_is_checked_before_the_work(path, command, name, tmp_path, capsys):
    """A folder that is missing and a file that is there: exit code 2, one line, and the file stays as it was."""
    is_folder = getattr(command.callback, "output_folder", None) == name  # made with those above it
    if not is_folder:
        assert run(_words(path, command, name, tmp_path / "absent" / "out.yaml")) == 2
        assert "absent does not exist" in capsys.readouterr().err
    there = tmp_path / "there.yaml"
    there.write_text("precious")
    assert run(_words(path, command, name, there)) == 2
    assert "there.yaml exists already" in capsys.readouterr().err
    assert there.read_text() == "precious"
    assert is_folder or any("--force" in one.opts for one in command.params)


@pytest.mark.parametrize(
    ("words", "precious"),
    [
        ("merge set -o set/frames/0.png", "set/frames/0.png"), ("response set -o set/capture.yaml", "set/capture.yaml"),
        ("merge photos -o photos/a.png", "photos/a.png"), ("adapt fit f.csv --csv f.csv", "f.csv"),
        ("adapt fit f.csv --report link.csv", "f.csv"),
    ],
)  # fmt: skip
def test_no_output_replaces_an_input(words, precious, tmp_path, monkeypatch, capsys):
    """Not with --force either, under whatever name: exit code 2 and the file as it was."""
    monkeypatch.chdir(tmp_path)
    for name in ("set/frames/0.png", "set/capture.yaml", "photos/a.png", "f.csv"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text("file: frames/0.png")
    Path("link.csv").symlink_to("f.csv")
    assert run([*words.split(), "--force"]) == 2
    assert "no input is replaced" in capsys.readouterr().err
    assert Path(precious).read_text() == "file: frames/0.png"


_HOSTILE = ("..", "../../out", "/etc/x", "a/b", "-o", ".hidden", "x" * 300, "a\0b", "")


@pytest.mark.parametrize("serial", _HOSTILE)
def test_a_box_cannot_choose_where_its_calibration_is_written(serial, tmp_path, monkeypatch):
    """Whatever serial number it sends: one file in the folder for them."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert calibration_file(serial).resolve().parent == tmp_path / "radiometer" / "light_boxes"


def test_a_file_cannot_choose_where_its_frames_are_written(tmp_path):
    """Whatever camera name a FITS header states: every capture set is a separate folder in that of -o."""
    fits = pytest.importorskip("astropy.io.fits")
    source, out = tmp_path / "source", tmp_path / "a" / "out"
    source.mkdir()
    out.parent.mkdir()
    names = [name for name in _HOSTILE if len(name) < 60 and name.isprintable()]
    for number, name in enumerate(names):
        unit = fits.PrimaryHDU(np.full((6, 8), 100 + number, np.int16))
        unit.header["INSTRUME"], unit.header["EXPTIME"] = name, 1.0
        unit.writeto(source / f"{number}.fits")
    before = {path for path in tmp_path.rglob("*") if not path.is_relative_to(out)}
    assert run(["import", str(source), "-o", str(out)]) == 0
    assert {path for path in tmp_path.rglob("*") if not path.is_relative_to(out)} == before
    assert len([path for path in out.iterdir() if (path / "capture.yaml").is_file()]) == len(names)


def test_a_file_that_is_no_journal_is_never_emptied(tmp_path, monkeypatch, capsys):
    """`adapt run -o` takes up a journal, also one whose first line a crash tore; a text without a line end stays."""
    monkeypatch.chdir(tmp_path)
    words = ["adapt", "run", "quick", "--subject", "S01", "--simulate", "steady", "-o"]
    for content in ("precious", "precious\n", '{"a": 1}'):
        Path("notes.txt").write_text(content)
        assert run([*words, "notes.txt"]) != 0
        assert Path("notes.txt").read_text() == content
    assert "no journal of a measurement" in capsys.readouterr().err
    Path("torn.jsonl").write_text('{"sequence": 0, "ki')
    assert run([*words, "torn.jsonl"]) == 0


@pytest.mark.parametrize(
    ("what", "text", "message"),
    [
        ("scene", "kind: moonlight\n", r"served\.yaml.*moonlight"),
        ("bench", "format: radiometer-bench/1\ncamera: {kind: genicam, id: '1'}\n"
         "lens: {focal_length_mm: 16, f_number: 4}\n", "only a simulated one can be served"),
    ],
)  # fmt: skip
def test_what_cannot_be_served_is_refused(tmp_path, what, text, message):
    """A scene of an unknown kind, and a bench with a real camera."""
    (tmp_path / "served.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=message):
        served_camera(**{what: tmp_path / "served.yaml" if what == "bench" else str(tmp_path / "served.yaml")})


def test_a_scene_is_a_kind_or_a_picture(tmp_path):
    """What needs nothing reported is named by its kind; the awkward camera has a hexadecimal number of its own."""
    cv2.imwrite(str(tmp_path / "scene.png"), np.full((20, 30), 128, np.uint8))
    for scene in ("uniform", "screen", "led", str(tmp_path / "scene.png")):
        assert served_camera(scene=scene, serial="5").label == "simulated camera FLIR BFS-U3-19S4M 5"
    assert served_camera(awkward=True).label == "simulated camera FLIR Blackfly S BFS-PGE-19S4M 0138C343"
    assert served_camera(awkward=True, serial="0138C344").label.endswith("0138C344")

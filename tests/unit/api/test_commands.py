"""Every command of the command line and its function give the same result on the same input, bit for bit."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

import radiometer as rm
from radiometer.cli.main import run
from radiometer.cli.tree import command_tree

# What differs between two runs of one thing: when and where it was written, and how long it took.
_OF_THE_RUN = {"time", "created", "capture", "path", "file", "table", "csv", "seconds", "port", "finished", "page"}


@dataclass(frozen=True)
class Case:
    """A command with its words, and the call of the library that does the same.

    Words and call write into different folders: `{out}` in the words is "cli", in the call it is "api".
    """

    words: str
    call: Callable[[Path], Any]
    of_file: str = ""  # a file to compare where the command prints no JSON
    apart: frozenset[str] = frozenset()  # what differs of this case besides


CASES = (
    Case("measure --bench bench.yaml --u-rel 1% --json", lambda out: rm.measure(bench="bench.yaml", u_rel=0.01)),
    Case(
        "measure --bench bench.yaml --uncalibrated --patch 8,8,32,32 --monte-carlo --json",
        lambda out: rm.measure(None, (8, 8, 32, 32), bench="bench.yaml", uncalibrated=True, monte_carlo=True),
    ),
    Case(
        "measure --bench bench.yaml --report {out}/page.html --json",
        lambda out: rm.measure(bench="bench.yaml", report=out / "page.html"),
    ),
    Case(
        "bracket {out}/set --bench chart.yaml --from 1/1000 --to 8ms --darks 1 --json",
        lambda out: rm.bracket(out / "set", bench="chart.yaml", shortest_s=0.001, longest_s=0.008, darks=1),
    ),
    Case("bracket {out}/met --bench chart.yaml --json", lambda out: rm.bracket(out / "met", bench="chart.yaml")),
    Case("characterise out/chart --patch 0,0,48,32 --json", lambda out: rm.characterise("out/chart", (0, 0, 48, 32))),
    Case("quality plan --json", lambda out: rm.quality_plan()),
    Case(
        "quality take {out}/session range 12dB --bench bench.yaml",
        lambda out: rm.quality_take(out / "session", "range", ["12dB"], bench="bench.yaml"),
        "session/range/12dB/capture.yaml",
    ),
    Case("quality report lines --source-u-rel 0.2% --json", lambda out: rm.quality_report("lines", source_u_rel=0.002)),
    Case(
        "import statistics.csv -o {out}/imported --json",
        lambda out: rm.import_capture("statistics.csv", out / "imported"),
    ),
    Case(
        "certificate calibration.yaml -o {out}/dcc.xml --laboratory laboratory.yaml --identifier 7 --json",
        lambda out: rm.certificate("calibration.yaml", out / "dcc.xml", laboratory="laboratory.yaml", identifier="7"),
    ),
    Case(
        "analyse map.tiff --region a:3,3,8,8 --region b:4,4,6,6 --contrast b,a --line 3,3,10,9 --json",
        lambda out: rm.analyse(
            "map.tiff", regions={"a": (3, 3, 8, 8), "b": (4, 4, 6, 6)}, contrast=("b", "a"), line=(3, 3, 10, 9)
        ),
    ),
    Case("flicker lamp.csv --dark 0 --json", lambda out: rm.flicker("lamp.csv", dark=0.0)),
    Case(
        "alpha-opic 80 --u 0.8 --spectrum white_led --wavelength-u 0.5 --json",
        lambda out: rm.alpha_opic(80.0, u=0.8, spectrum="white_led", wavelength_u_nm=0.5),
    ),
    Case(
        "colour calibrate colours --chart colours.csv --u-rel 1% -o {out}/colour.yaml --json",
        lambda out: rm.colour_calibrate("colours", "colours.csv", u_rel=0.01, out=out / "colour.yaml"),
    ),
    Case(
        "colour measure colours --calibration colour.yaml --patch 2,2,8,6 --kind leds --json",
        lambda out: rm.colour_measure("colours", calibration="colour.yaml", patch=(2, 2, 8, 6), kind="leds"),
    ),
    Case("log-fit sky.csv --no-control --json", lambda out: rm.log_fit("sky.csv", control=False)),
    Case("log journal.sqlite --json", lambda out: rm.log("journal.sqlite")),
    Case(
        "light set spot --level 20000 --for 500ms --box sim --json",
        lambda out: rm.light_set("spot", level=20000, hold_s=0.5, box="sim"),
    ),
    Case(
        "light pulse spot --duration 0.2 --level 9000 --low --box sim --json",
        lambda out: rm.light_pulse("spot", 0.2, level=9000, low=True, box="sim"),
    ),
    Case(
        "light blink spot --on 100ms --off 0.1 --count 2 --level 20000 --box sim --json",
        lambda out: rm.light_blink("spot", 0.1, 0.1, 2, level=20000, box="sim"),
    ),
    Case("light off --box sim --json", lambda out: rm.light_off(box="sim")),
    Case("light account --json", lambda out: rm.light_account()),
    Case("light status --box sim --json", lambda out: rm.light_status(box="sim")),
    Case("light watch-buttons --for 300ms --box sim --json", lambda out: list(rm.light_watch_buttons(0.3, box="sim"))),
    Case(
        "light calibrate --channel fixation --box sim --points-per-decade 1 --seed 3 -o {out}/box.yaml --json",
        lambda out: rm.light_calibrate(["fixation"], box="sim", points_per_decade=1, seed=3, out=out / "box.yaml"),
    ),
    Case(
        "screen calibrate --display lcd --quick --channels grey,red -o {out}/lcd.yaml --json",
        lambda out: rm.screen_calibrate(out / "lcd.yaml", "lcd", quick=True, channels=("grey", "red")),
    ),
    Case("screen level lcd.yaml 20 --json", lambda out: rm.screen_level("lcd.yaml", 20.0)),
    Case(
        "screen verify lcd.yaml --display lcd --levels 0,128,255 --json",
        lambda out: rm.screen_verify("lcd.yaml", "lcd", levels="0,128,255"),
    ),
    Case("screen export lcd.yaml csv -o {out}", lambda out: rm.screen_export("lcd.yaml", ["csv"], out), "lcd.csv"),
    Case(
        "screen import luminances.csv -o {out}/elsewhere.yaml --meter-u-rel 3% --json",
        lambda out: rm.screen_import("luminances.csv", out / "elsewhere.yaml", meter_u_rel=0.03),
    ),
    Case(
        "screen report --display oled --methods white,uniformity --warm-up 0 --json",
        lambda out: rm.screen_report(display="oled", methods=["white", "uniformity"], warm_up_s=0.0),
    ),
    Case("light law engine.csv --twin engine.csv --json", lambda out: rm.light_law("engine.csv", "engine.csv")),
    Case(
        "adapt run quick --subject S1 -o {out}/run.jsonl --simulate wanders --seed 4 --json",
        lambda out: rm.adapt_run("quick", "S1", out / "run.jsonl", simulate="wanders", seed=4),
    ),
    Case("adapt instructions rapid --json", lambda out: rm.adapt_instructions("rapid")),
    Case(
        "adapt visits thresholds.csv thresholds.csv --report {out}/visits.html --json",
        lambda out: rm.adapt_visits(["thresholds.csv", "thresholds.csv"], report=out / "visits.html"),
    ),
    Case("adapt protocols --json", lambda out: rm.adapt_protocols()),
    Case("adapt bleach 1000 120 --age 60 --json", lambda out: rm.adapt_bleach(1000.0, 120.0, age=60.0)),
    Case(
        "adapt fit thresholds.csv --bootstrap 20 --seed 3 --json",
        lambda out: rm.adapt_fit("thresholds.csv", bootstrap=20, seed=3),
    ),
    Case(
        "adapt retest thresholds.csv thresholds.csv --json",
        lambda out: rm.adapt_retest(["thresholds.csv", "thresholds.csv"]),
    ),
    Case(
        "batch out --do measure -o {out}/results.csv --patch 8,8,16,16 --json",
        lambda out: rm.batch("out", "measure", out / "results.csv", patch=(8, 8, 16, 16)),
    ),
    Case("trend history.csv --json", lambda out: rm.trend("history.csv")),
    Case("passport out --json", lambda out: rm.passport("out")),
    Case("devices --bench bench.yaml --json", lambda out: rm.list_devices("bench.yaml")),
    Case("doctor --json", lambda out: rm.doctor()),
    Case(
        "new-bench {out}/new.yaml --camera sim --focal-length 16 --f-number f/4 --patch 1,2,3,4",
        lambda out: rm.new_bench(out / "new.yaml", "sim", focal_length_mm=16, f_number=4, patch=(1, 2, 3, 4)),
        "new.yaml",
    ),
)

# Commands that are no function of the library.
EXCUSED = {
    "serve": "runs until it is stopped; the system tests of the daemon compare what it serves",
    "view": "shows pictures until it is stopped; `test_live_view.py` looks at them",
    "simulate": "a group",
    "simulate camera": "runs until it is stopped; the contract suite measures through it",
    "simulate box": "runs until it is stopped; the contract suite measures through it",
    "colour": "a group",
    "light": "a group",
    "screen": "a group",
    "adapt": "a group",
    "quality": "a group",
    "completion": "about the command line itself",
    "man": "about the command line itself",
}
# `test_photograph_commands_equal.py` compares these, on photographs and capture sets.
ELSEWHERE = ("merge", "response", "calibrate", "flux", "reconcile", "measure --photographs")


@pytest.fixture(scope="module")
def bench(desk: Path) -> Path:
    """Return the desk with a screen calibration and a quality session on it as well."""
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(desk)
        rm.screen_calibrate("lcd.yaml", "lcd", quick=True)
        rm.quality_take("lines", "linearity", bench="bench.yaml")
        rm.colour_calibrate("colours", "colours.csv", out="colour.yaml")
    return desk


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.words[:60])
def test_a_command_and_its_function_give_the_same_numbers(case, bench, tmp_path, monkeypatch, capsys):
    """Not one bit of any number differs; the result shows itself in one line, and as HTML in a notebook."""
    monkeypatch.chdir(bench)
    assert_the_same_numbers(case, tmp_path, capsys)


def assert_the_same_numbers(case: Case, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Assert that the words of a case and its call give one result, each writing into a part of a folder."""
    for face in ("cli", "api"):
        (folder / face).mkdir()
    capsys.readouterr()
    run(case.words.replace("{out}", str(folder / "cli")).split())
    printed = capsys.readouterr().out
    found = case.call(folder / "api")
    if case.of_file:
        texts = [(folder / face / case.of_file).read_text(encoding="utf-8") for face in ("cli", "api")]
        mine, theirs = (_alike(yaml.safe_load(text)) if case.of_file.endswith("yaml") else text for text in texts)
        assert mine == theirs
        return
    results = found if isinstance(found, list) else [found]
    for one in results:
        assert repr(one).startswith(f"<{type(one).__name__} ")
        assert "\n" not in repr(one)
        assert one._repr_html_().startswith("<")
    expected = [json.loads(line) for one in results for line in one.to_json().splitlines()]
    # A run prints its events as well, and its outcome last.
    lines = [json.loads(line) for line in printed.splitlines()][-len(expected) or len(printed) :]
    assert _alike(lines, case.apart) == _alike(expected, case.apart)


def _alike(value: Any, apart: frozenset[str] = frozenset()) -> Any:
    """Return a result without what belongs to the run alone."""
    if isinstance(value, dict):
        return {key: _alike(one, apart) for key, one in value.items() if key not in _OF_THE_RUN | apart}
    if not isinstance(value, list):
        return value
    # Cameras on the wire come and go: other programs of this computer serve some.
    on_wire = [one for one in value if isinstance(one, dict) and "127.0.0.1" in str(one.get("interface"))]
    return [_alike(one, apart) for one in value if one not in on_wire]


def test_every_command_has_a_case_or_a_reason():
    """A new command of the table needs a case here; a command is not excused and tested at once."""
    known = {" ".join(one.path) for one in command_tree()}
    tested = {
        max((name for name in known if re.match(rf"{re.escape(name)}(\s|$)", case.words)), key=len) for case in CASES
    }
    assert known <= tested | set(EXCUSED) | set(ELSEWHERE)
    assert not tested & (set(EXCUSED) | set(ELSEWHERE))

"""`radiometer adapt bleach`, `protocols`, `retest` and what `fit` reports of the subject."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from radiometer.adaptation.protocol import SHIPPED
from radiometer.cli.main import run


def test_bleach_calculator_gives_trolands_and_fractions(capsys: pytest.CaptureFixture[str]) -> None:
    """300 cd/m² for 120 s through 4 mm: 3770 td; rods by Rushton's kinetics at twice the trolands."""
    assert run(["adapt", "bleach", "300", "120", "--pupil", "4", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["retinal_td"] == pytest.approx(3769.9, rel=1e-4)
    assert found["rods_bleached"] == pytest.approx(0.0749, abs=0.0005)
    assert 0 < found["cones_bleached"] < 0.2


def test_protocols_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    """All of them, each with what it is for."""
    assert run(["adapt", "protocols"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(SHIPPED)


@pytest.mark.parametrize(
    "words",
    [
        ["nothing", "--subject", "A", "--simulate", "steady"],
        ["classic", "--subject", "A", "--simulate", "asleep"],
        ["classic", "--subject", "A", "--simulate", "steady", "--box", "LB000001"],
    ],
)
def test_misuse_is_exit_code_two(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Unknown protocol, unknown subject, and a simulated subject before a real box."""
    assert run(["adapt", "run", *words]) == 2
    assert capsys.readouterr().err.startswith("error:")


def _table(path: Path, break_min: float, seed: int, head: str = "") -> str:
    """Write thresholds of two branches with a break."""
    times = np.arange(0.3, 20, 0.2)
    cones = -1.5 + 2.5 * np.exp(-times / 1.5)
    levels = np.where(times > break_min, -1.5 - 0.25 * (times - break_min), cones)
    levels = levels + np.random.default_rng(seed).normal(0, 0.05, times.size)
    rows = "".join(f"{t:.3f},{v:.4f}\n" for t, v in zip(times, levels, strict=True))
    path.write_text(f"{head}time_min,log10_threshold\n{rows}")
    return str(path)


@pytest.mark.slow
def test_retest_gives_limits_of_agreement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three subjects whose break is 1, 1.5 and 2 min later: mean 1.5, limits 1.5 ± 0.98, to what the fits leave."""
    files = [_table(tmp_path / f"{n}{k}.csv", 8.0 + k * (1 + 0.5 * n), 2 * n + k) for n in range(3) for k in (0, 1)]
    assert run(["adapt", "retest", *files, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["break_min"]["agreement"]
    assert found["mean"]["value"] == pytest.approx(1.5, abs=0.3)
    assert found["upper"]["value"] - found["mean"]["value"] == pytest.approx(1.96 * found["sd"], rel=1e-4)
    assert found["upper"]["low"] < found["upper"]["value"] < found["upper"]["high"]
    assert run(["adapt", "retest", *files[:3]]) == 2
    assert "two for each subject" in capsys.readouterr().err
    others = [_table(tmp_path / f"{one}.csv", 8.0, 1, f"# subject: {one}\n# eye: right\n") for one in ("S1", "S2")]
    assert run(["adapt", "retest", *others]) == 2
    assert "of subject S1 and S2" in capsys.readouterr().err


@pytest.mark.slow
def test_fit_reports_false_alarms_lapses_and_looks_away(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the counts in the table's head, in terminal, JSON and page."""
    head = "# false_alarms: 2/100\n# lapses: 1/20\n# seen_at_blind_spot: 6/30\n"
    file, page = _table(tmp_path / "a.csv", 8.0, 1, head), tmp_path / "a.html"
    assert run(["adapt", "fit", file, "--bootstrap", "0", "--report", str(page)]) == 0
    assert "Fixation lost                    19.3 %" in capsys.readouterr().out
    assert run(["adapt", "fit", file, "--bootstrap", "0", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)["reliability"]
    assert printed["fixation_losses"]["share"] == pytest.approx((0.2 - 0.02) / (0.98 * 0.95))
    assert (printed["lapses"]["hits"], printed["lapses"]["of"]) == (1, 20)
    assert "<h2>The subject</h2>" in page.read_text(encoding="utf-8")


THRESHOLDS = [(0, -1), (1, -1.5), (2, -2), (4, -2.2), (8, -2.6), (12, -3.5), (20, -4.5), (30, -4.8)]


@pytest.mark.parametrize(
    ("words", "row", "code", "shown"),
    [
        (["adapt", "fit"], (20_000, -4.9), 1, "time: 20000 min is outside 0 to 1440 min"),
        (["adapt", "fit"], (-5, -1), 1, "time: -5 min is outside"),
        (["adapt", "fit"], (40, -22), 1, "log10 threshold after 40 min: -22 is outside"),
        (["log", "--after", "99999999999999999999"], None, 2, "after: 1e+20 is outside"),
        (["log", "--budget", "99999999999999999999"], None, 1, "reading 99999999999999999999"),
    ],
)
def test_numbers_beyond_all_are_refused_in_one_line(words, row, code, shown, tmp_path, capsys):
    """A mistake of unit or power of ten is named with the range, and nothing is calculated with it."""
    if row is not None:
        rows = sorted([*THRESHOLDS, row])
        (tmp_path / "t.csv").write_text("time_min,log10_threshold\n" + "".join(f"{t},{v}\n" for t, v in rows))
        words = [*words, str(tmp_path / "t.csv")]
    assert run(words) == code
    printed = capsys.readouterr()
    assert shown in printed.err
    assert len(printed.err.strip().splitlines()) == 1
    assert printed.out == ""

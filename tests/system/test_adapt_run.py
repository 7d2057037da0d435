"""`radiometer adapt run` as a program: killed and taken up, and its verdicts."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import radiometer as rm
from radiometer.cli.main import run
from testing.patience import within

VISIT = ["--visit", "2026-03-02T14:30Z"]  # of both runs that are compared: a visit's date is in its journal
PROGRAM = [sys.executable, "-m", "radiometer", "adapt", "run", "quick", *VISIT, "--subject", "S1", "--seed", "5"]


def _run(*words, cwd):
    return subprocess.run([*PROGRAM, *words], cwd=cwd, capture_output=True, text=True, timeout=within(120), check=False)


@pytest.fixture
def environment(project_root, monkeypatch):
    """Let the program be found from any folder."""
    monkeypatch.setenv("PYTHONPATH", str(project_root))


@pytest.mark.long
@pytest.mark.usefixtures("environment")
@pytest.mark.parametrize("devices", [[], ["--box", "sim"]])
def test_killed_run_taken_up_has_the_same_events(tmp_path, devices):
    """SIGKILL after a trial, then the same command: the journal is that of an undisturbed run, byte for byte."""
    assert _run("--simulate", "steady", *devices, "-o", "whole.jsonl", cwd=tmp_path).returncode == 0
    journal = tmp_path / "broken.jsonl"
    words = [*PROGRAM, "--simulate", "steady", *devices, "--slow", "60", "-o", str(journal)]
    victim = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + within(100)
    while (not journal.exists() or b'"kind": "trial"' not in journal.read_bytes()) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(victim.pid, signal.SIGKILL)
    victim.wait(within(10.0))
    before = journal.read_bytes()
    assert _run("--simulate", "steady", *devices, "-o", "broken.jsonl", cwd=tmp_path).returncode == 0
    whole = (tmp_path / "whole.jsonl").read_bytes()
    assert before.count(b'"kind": "trial"') == 1
    assert journal.read_bytes() == whole


@pytest.mark.parametrize(("behaviour", "verdict"), [("never", "no_response"), ("always", "unreliable")])
def test_subject_who_cannot_be_fitted_is_exit_code_one(tmp_path, monkeypatch, capsys, behaviour, verdict):
    """The last JSON line gives the verdict."""
    monkeypatch.chdir(tmp_path)
    assert run([*PROGRAM[3:], "--simulate", behaviour, "--json"]) == 1
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (result["verdict"], result["csv"]) == (verdict, None)
    assert not list(tmp_path.glob("*.csv"))  # nothing that could be fitted by mistake


def test_second_visit_is_measured_and_an_unfinished_one_is_taken_up(tmp_path, monkeypatch):
    """Two runs of a subject are two journals by eye and moment; naming that of a finished run is misuse."""
    monkeypatch.chdir(tmp_path)
    about = {"simulate": "steady", "eye": "left", "age": 31.0, "pupil": 6.0}
    first = rm.adapt_run("quick", "S7", visit="2026-03-02T14:30Z", **about)
    second = rm.adapt_run("quick", "S7", visit="2026-03-09T14:30Z", **about)
    assert [str(one.journal) for one in (first, second)] == [
        "S7-quick-left-2026-03-02T143000Z.jsonl",
        "S7-quick-left-2026-03-09T143000Z.jsonl",
    ]
    start = json.loads(second.journal.read_text().splitlines()[0])
    assert [start[name] for name in ("subject", "eye", "age_years", "pupil_mm", "visit")] == [
        "S7", "left", 31.0, 6.0, "2026-03-09T14:30:00Z",
    ]  # fmt: skip
    head = Path(str(second.table)).read_text()
    assert all(line in head for line in ("# subject: S7", "# eye: left", "# age_years: 31.0", "# pupil_mm: 6.0"))
    before = first.journal.read_bytes()
    with pytest.raises(rm.UsageError, match="finished run of 2026-03-02T14:30:00Z: `adapt fit"):
        rm.adapt_run("quick", "S7", first.journal, simulate="steady")
    assert first.journal.read_bytes() == before
    from_table, from_journal = (rm.adapt_fit(file, bootstrap=0) for file in (first.table, first.journal))
    assert from_journal.fit.estimates["plateau"].value == pytest.approx(
        from_table.fit.estimates["plateau"].value, abs=0.01
    )
    whole = second.journal.read_bytes()
    second.journal.write_bytes(whole[: len(whole) // 2])  # as a crash leaves it
    third = rm.adapt_run("quick", "S7", visit="2026-03-16T14:30Z", **about)
    assert third.journal == second.journal
    assert third.journal.read_bytes() == whole


def test_practice_run_bleaches_nothing_and_is_no_visit_of_the_test(tmp_path, monkeypatch):
    """Three minutes of the task; its journal has another protocol's name, and nothing of it is fitted."""
    monkeypatch.chdir(tmp_path)
    done = rm.adapt_run("quick", "S7", simulate="steady", practice=True, visit="2026-03-02T14:30Z")
    kinds = [json.loads(line)["kind"] for line in done.journal.read_text().splitlines()]
    assert done.journal.name == "S7-quick-practice-right-2026-03-02T143000Z.jsonl"
    assert "bleach" not in kinds
    assert done.practised
    assert done.table is None
    assert done.outcome.catches > 0


def test_visits_are_laid_over_each_other_with_their_dates(tmp_path, monkeypatch):
    """The page names subject, eye and date of each visit; what each found stands side by side."""
    monkeypatch.chdir(tmp_path)
    for day, seed in (("02", 1), ("09", 2)):
        rm.adapt_run("classic", "S7", simulate="steady", seed=seed, visit=f"2026-03-{day}T14:30Z", age=31.0)
    tables = sorted(tmp_path.glob("*.csv"))
    found = rm.adapt_visits(tables, report="visits.html")
    *visits, covers = found.lines()
    assert [line.split(":")[0] for line in visits] == ["S7 right 2026-03-02 14", "S7 right 2026-03-09 14"]
    assert all(re.search(r"Final threshold \S+ (± \S+|\+\S+ -\S+) ", line) for line in visits)
    assert "95 %" in covers
    page = Path("visits.html").read_text()
    assert all(text in page for text in ("2026-03-02", "2026-03-09", "Rod–cone break", "31.0", rm.__version__))

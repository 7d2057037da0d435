"""`radiometer adapt run` as a program: killed and taken up, and its verdicts."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from testing.patience import within

PROGRAM = [sys.executable, "-m", "radiometer", "adapt", "run", "quick", "--subject", "S1", "--seed", "5"]


def _run(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*PROGRAM, *words], cwd=cwd, capture_output=True, text=True, timeout=within(120), check=False)


@pytest.fixture
def environment(project_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the program be found from any folder."""
    monkeypatch.setenv("PYTHONPATH", str(project_root))


@pytest.mark.long
@pytest.mark.usefixtures("environment")
@pytest.mark.parametrize("devices", [[], ["--box", "sim"]])
def test_killed_run_taken_up_has_the_same_events(tmp_path: Path, devices: list[str]) -> None:
    """SIGKILL after a trial, then the same command: the journal equals that of an undisturbed run, byte for byte.

    With the subject alone the run goes on from the journal; before the simulated box it is lived through again.
    """
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


@pytest.mark.usefixtures("environment")
@pytest.mark.parametrize(("behaviour", "verdict"), [("never", "no_response"), ("always", "unreliable")])
def test_subject_who_cannot_be_fitted_is_exit_code_one_with_a_verdict(
    tmp_path: Path, behaviour: str, verdict: str
) -> None:
    """The last JSON line says why."""
    done = _run("--simulate", behaviour, "--json", cwd=tmp_path)
    assert done.returncode == 1
    said = json.loads(done.stdout.splitlines()[-1])
    assert (said["verdict"], said["csv"]) == (verdict, None)
    assert not list(tmp_path.glob("*.csv"))  # nothing that could be fitted by mistake


@pytest.mark.usefixtures("environment")
def test_other_subjects_journal_is_misuse(tmp_path: Path) -> None:
    """Exit code 2, and the error is one line."""
    assert _run("--simulate", "steady", "-o", "j", cwd=tmp_path).returncode == 0
    wrong = subprocess.run(
        [*PROGRAM[:-4], "--subject", "S2", "--seed", "5", "--simulate", "steady", "-o", "j"],
        cwd=tmp_path, capture_output=True, text=True, timeout=within(120), check=False,
    )  # fmt: skip
    assert wrong.returncode == 2
    assert [line for line in wrong.stderr.splitlines() if line.startswith("error:")] == wrong.stderr.splitlines()[1:]

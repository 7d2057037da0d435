"""Tests in several processes are reported as those of one, whatever becomes of them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from testing.patience import within
from testing.side_by_side import HeavyFirst

pytestmark = pytest.mark.slow  # starts processes

CONFTEST = "from tests.conftest import pytest_addoption, pytest_runtestloop\n"
FINE = """
import pytest
@pytest.mark.parametrize("k", range(4))
def test_fine(k, tmp_path): (tmp_path / "a").write_text("")
"""
FAULTY = """
import pytest
def test_faulty():
    print("printed before")
    assert 1 == 2
def test_skipped():
    pytest.skip("for a reason")
"""
LATE = """
import os, time
def test_late(): time.sleep(0.2)
"""
DEADLY = """
import os, signal
def test_deadly():
    if os.environ["FIRST"] != str(os.getpid()):
        os.kill(os.getpid(), signal.SIGKILL)
"""


def ran(folder: Path, files: dict[str, str], *words: str) -> tuple[int, str]:
    """Return how pytest ends in a folder with these files of tests, in three processes, and what it says."""
    for name, text in {"conftest.py": CONFTEST, **files}.items():
        (folder / name).write_text(text)
    root = Path(__file__).resolve().parents[2]
    first = "import os, sys, pytest; os.environ['FIRST'] = str(os.getpid()); sys.exit(pytest.main(sys.argv[1:]))"
    command = [
        sys.executable,
        "-c",
        first,
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:randomly",
        "--processes=3",
        *words,
    ]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run(
        [*command, str(folder)], cwd=folder, env=environment, capture_output=True, text=True, timeout=within(60.0)
    )
    return done.returncode, done.stdout + done.stderr


def test_every_test_is_run_once_and_reported(tmp_path: Path) -> None:
    """Passed, failed with what it printed, and skipped ones of all processes are counted; one failure is code 1."""
    files = {f"test_{name}.py": text for name, text in zip("abcdef", [FINE, LATE, FAULTY] * 2, strict=True)}
    code, message = ran(tmp_path, files)
    assert code == 1
    assert re.search(r"2 failed, 10 passed, 2 skipped", message), message
    assert message.count("printed before") == 4  # as it stands in the source, and as it was printed
    assert sorted(re.findall(r"FAILED (test_\w+)\.py", message)) == ["test_c", "test_f"]
    assert ran(tmp_path, dict.fromkeys(("test_c.py", "test_f.py"), FINE))[0] == 0


SKIPPING = """
import pytest
@pytest.fixture(params=range(2))
def absent(request): pytest.skip("it is not here")
def test_asks(absent): pass
@pytest.mark.skip(reason="by a mark")
def test_marked(): pass
@pytest.mark.xfail(reason="known")
def test_known(): assert 1 == 2
def test_properties(record_property): record_property("k", 3)
"""


def test_reasons_of_the_second_process_are_reported_as_those_of_the_first(tmp_path: Path) -> None:
    """Skips are folded by place and reason, and what was known to fail is listed, whichever process ran the test."""
    files = {f"test_{k}.py": SKIPPING + LATE for k in range(6)}
    code, text = ran(tmp_path, files, "-ra")
    assert code == 0, text
    assert "Traceback" not in text
    reported = [int(count) for count in re.findall(r"SKIPPED \[(\d+)\] \S+: (?:it is not here|by a mark)", text)]
    assert sorted(reported) == [1] * 6 + [2] * 6, text
    assert len(re.findall(r"XFAIL test_\d\.py::test_known - known", text)) == 6
    assert re.search(r"12 passed, 18 skipped, 6 xfailed", text), text


def test_a_process_that_dies_is_a_failure(tmp_path: Path) -> None:
    """Where the other processes are killed no success is reported, though every test that was reported of passed."""
    code, text = ran(tmp_path, {f"test_{k}.py": DEADLY + LATE for k in range(6)})
    assert code == 1
    assert "another process of tests ended with -9" in text
    assert "failed" not in text.splitlines()[-1]


def test_heavy_groups_are_taken_first() -> None:
    """What waits in real time, then folders of long tests, then the others as they came."""
    names = [
        "tests/unit/data/a.py",
        "tests/unit/cli/b.py",
        "tests/unit/reconciliation/propose/c.py",
        "real time",
        "tests/d.py",
    ]
    waiting = HeavyFirst((name, {}) for name in names)
    taken = [waiting.popitem(last=False)[0] for _ in names]
    assert taken == [names[3], names[2], names[1], names[0], names[4]]
    assert not waiting

"""Tests in several processes are reported as those of one, whatever becomes of them."""

import os
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

from testing.patience import within

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
    command = [sys.executable, "-c", first, "-q", "--processes=3", *words]
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


def test_a_process_that_dies_is_a_failure(tmp_path: Path) -> None:
    """Where the other processes are killed no success is reported, though every test that was reported of passed."""
    code, text = ran(tmp_path, {f"test_{k}.py": DEADLY + LATE for k in range(6)})
    assert code == 1
    assert "another process of tests ended with -9" in text
    assert "failed" not in text.splitlines()[-1]


def test_tests_of_a_file_stay_in_one_worker_and_both_work(project_root: Path) -> None:
    """What a file's tests share is made once; what waits for real time never runs next to its like."""
    files = ["tests/unit/test_numbers.py", "tests/unit/test_units.py", "tests/unit/data/test_reading.py"]
    words = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-v", "-n", "2", *files]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    done = subprocess.run(
        words, cwd=project_root, env=environment, capture_output=True, text=True, timeout=within(60), check=False
    )
    workers = defaultdict(set)
    for worker, file in re.findall(r"^\[(gw\d)\].* PASSED (\S+?)::", done.stdout, re.MULTILINE):
        workers[file].add(worker)
    assert sorted(workers) == sorted(files), done.stdout + done.stderr
    assert {len(seen) for seen in workers.values()} == {1}
    assert set.union(*workers.values()) == {"gw0", "gw1"}

"""The suite in two workers: who runs next to whom."""

import os
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

from testing.patience import within


def test_tests_of_a_file_stay_in_one_worker_and_both_work(project_root: Path) -> None:
    """What a file's tests share is made once; what waits for real time never runs next to its like."""
    files = ["tests/unit/test_numbers.py", "tests/unit/test_units.py", "tests/unit/reporting/test_page.py"]
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

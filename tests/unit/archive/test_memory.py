"""Memory that a worker keeps."""

import resource
import subprocess
import sys

import pytest

_FAULTS = """
import resource, sys
import numpy as np
from radiometer.archive.run import keep_freed_memory
if sys.argv[1] == "keep" and not keep_freed_memory():
    sys.exit(3)
def work():
    for _ in range(40):
        np.ones((640, 640)) * 2.0
work()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
work()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.slow
def test_freed_arrays_are_used_again_without_new_pages(project_root):
    """In a process set as a Dask worker is, arrays of 3 MB cost page faults each time; kept, they cost next to none."""
    faults = {}
    for kind in ("give", "keep"):
        done = subprocess.run(
            [sys.executable, "-c", _FAULTS, kind],
            cwd=project_root, capture_output=True, text=True, check=False, env={"MALLOC_TRIM_THRESHOLD_": "65536"},
        )  # fmt: skip
        if done.returncode == 3:
            pytest.skip("this C library has no mallopt")
        faults[kind] = int(done.stdout)
    assert faults["give"] > 40 * 640 * 640 * 8 / resource.getpagesize()
    assert faults["keep"] < faults["give"] / 20

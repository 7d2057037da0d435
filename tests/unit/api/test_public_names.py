"""What `import radiometer` offers: a dozen names, loaded when they are used, and nothing else."""

from __future__ import annotations

import subprocess
import sys

import pytest

import radiometer as rm


def in_a_new_process(code: str) -> str:
    """Return what a fresh interpreter prints."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_all_names_can_be_had_and_are_listed():
    """Every name of `__all__` is there, documented, and shown by dir()."""
    for name in rm.__all__:
        assert getattr(rm, name).__doc__
    assert set(rm.__all__) <= set(dir(rm))


def test_what_is_not_listed_is_private():
    """A name that is not public is refused with the nearest that is."""
    with pytest.raises(AttributeError, match=r"no attribute 'Bracket'; did you mean 'bracket'\?"):
        _ = rm.Bracket


@pytest.mark.parametrize(("error", "code"), [(rm.UsageError, 2), (rm.CalibrationError, 1), (rm.DeviceError, 1)])
def test_every_error_can_be_caught_by_its_public_root(error, code):
    """A program catches RadiometerError and finds the exit code of the command line."""
    with pytest.raises(rm.RadiometerError) as caught:
        raise error("no")
    assert caught.value.exit_code == code


@pytest.mark.slow
def test_importing_loads_neither_numpy_nor_any_room():
    """`import radiometer` alone costs nothing."""
    code = "import sys, radiometer; print([m for m in sys.modules if m.startswith(('numpy', 'radiometer.'))])"
    assert in_a_new_process(code) == "[]"

"""The event loop's thread, and it alone, goes before ordinary programs where the system allows it."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from radiometer.daemon.promptness import be_prompt
from testing.patience import within


@pytest.fixture(autouse=True)
def _leave_the_interpreter_as_it_was() -> Iterator[None]:
    interval_s = sys.getswitchinterval()
    yield
    sys.setswitchinterval(interval_s)
    gc.unfreeze()


def test_the_lowest_real_time_priority_is_asked_for_and_passed_on_to_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Round robin at priority 1 for the calling thread; what it starts is ordinary again."""
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, param: asked.append((pid, policy, param.sched_priority))
    )
    assert be_prompt()
    assert asked == [(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, 1)]
    assert sys.getswitchinterval() == pytest.approx(0.0005)


def test_a_system_that_does_not_allow_it_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """An ordinary user without the limit raised goes on at ordinary priority."""

    def refuse(pid: int, policy: int, param: os.sched_param) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert not be_prompt()


@pytest.mark.slow
def test_the_daemon_starts_without_what_it_does_not_need() -> None:
    """scipy.stats takes longer to load than all the daemon's own modules; nothing of the daemon asks for it."""
    words = "import radiometer.daemon.service, radiometer.daemon.bench_instrument, radiometer.daemon.bench_light"
    code = f"import sys; {words}; print(sorted({{'scipy.stats', 'pandas', 'matplotlib', 'numba'}} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=within(60))
    assert done.stdout == "[]\n"

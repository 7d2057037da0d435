"""Fixtures shared by the whole suite."""

import contextlib
import gc
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from shutil import disk_usage
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from radiometer.cli.logging_setup import configure_logging
from testing import side_by_side
from testing.patience import queue

PROJECT_ROOT = Path(__file__).resolve().parents[1]
# Files of tests go to the memory where there is enough of it: journals wait for the disk at every entry.
MEMORY, ENOUGH = Path("/dev/shm"), 4 << 30
if "PYTEST_DEBUG_TEMPROOT" not in os.environ and os.access(MEMORY, os.W_OK) and disk_usage(MEMORY).free > ENOUGH:
    os.environ["PYTEST_DEBUG_TEMPROOT"] = str(MEMORY)
# Results that cannot be written where they belong are saved in the user's state folder: not in the developer's.
os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="radiometer-state-", dir=os.environ.get("PYTEST_DEBUG_TEMPROOT"))
# Neither an example's time nor that of making one says anything of the code. Half of the usual hundred examples find
# what a draw of mistakes holds, in half the time. They are the same in every run, so that a change breaks the test that
# it breaks; `--hypothesis-profile=search` draws others.
patient = settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
settings.register_profile("patient", patient)
settings.register_profile("search", patient, derandomize=False, max_examples=500)
settings.load_profile("patient")
# A shell's background job ignores Ctrl-C, and so would every program that a test starts and ends by it.
with contextlib.suppress(ValueError):  # a worker's thread that is not its main one
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _quiet_log():
    """Send events to the standard error of the moment: pytest replaces it for every test."""
    configure_logging()


@pytest.fixture(scope="session", autouse=True)
def _own_state(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep what programs remember, such as the account of retinal exposure, out of the user's own folder."""
    os.environ["RADIOMETER_STATE"] = str(tmp_path_factory.mktemp("state"))


@pytest.fixture(scope="session")
def project_root() -> Path:
    """Return the root of the checkout."""
    return PROJECT_ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real measurements, or skip where it is absent."""
    printed = [parent / "shared" / "data" for parent in (PROJECT_ROOT.parent, PROJECT_ROOT.parent.parent)]
    folder = next((one for one in printed if one.is_dir()), None)
    if folder is None:
        pytest.skip("the real measurements (../shared/data) are not on this machine")
    return folder


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[object]:
    """Give each test as many times its limit as there is work waiting for a core: the limit is for what hangs."""
    if (waiting := queue()) > 1.0:
        marker = item.get_closest_marker("timeout")
        limit_s = float(marker.args[0] if marker else item.config.getini("timeout"))
        item.add_marker(pytest.mark.timeout(waiting * limit_s), append=False)
    return (yield)


@pytest.fixture
def laws_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave a search's names as they are found: fits of laws that no entry holds take up to three quarters of its time.

    One test at least of each file holds its names to these laws as well.
    """
    from radiometer.reconciliation import engine

    monkeypatch.setattr(engine, "held_to_laws", lambda found, *further: found)


@pytest.fixture(scope="session")
def responses_known() -> dict[object, object]:
    """Return the responses that were recovered so far, by the frames that they were recovered from."""
    return {}


@pytest.fixture
def recovered_once(monkeypatch: pytest.MonkeyPatch, responses_known: dict[object, object]) -> None:
    """Recover the response of the same photographs once: it takes a second and is the same again."""
    import radiometer.api.response  # noqa: F401  it keeps the function by name, and has the real one
    from radiometer.analysis.response import auto

    recover = auto.recover_colours_auto

    def once(brackets: list[Any]) -> object:
        frames = [frame for one in brackets for frame in (*one.light, *one.dark)]
        key = tuple((frame.dn.tobytes(), frame.dn.shape, repr(frame.settings)) for frame in frames)
        if key not in responses_known:
            responses_known[key] = recover(brackets)
        return responses_known[key]

    monkeypatch.setattr(auto, "recover_colours_auto", once)


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave figures as they are drawn, without a picture of them: for those who read the text alone."""
    from matplotlib.figure import Figure

    monkeypatch.setattr(Figure, "savefig", lambda figure, stream, **_: stream.write(b"<svg/>"))


# What waits for real devices, ports or processes in real time is not run in parallel.
REAL_TIME = ("tests/contract", "tests/protocol")
# What takes long to make and serves all files of a folder: the compiled firmware.
TOGETHER = ("tests/unit/firmware",)
# Folders whose tests need no process, no browser and no real time: the fast tier, less what is marked slow.
FAST = ("tests/unit", "tests/style")
# Whole round trips through simulated sessions: in addition to what is marked so (soaks, studies of coverage,
# documents followed word by word) the slow tier.
LONG = ("tests/roundtrip",)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Leave what lives to the end, modules and thousands of tests, out of every later collection of garbage.

    None is collected while they are found, for next to nothing of what is made then is ever dropped.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish() -> None:
    """Look once for what was dropped with an error; pytest looks ten times more, then at what was made since."""
    gc.collect()
    gc.freeze()


def together(test: str) -> str:
    """Return the name of those tests that stay in one worker with this one: its file, or the folder that shares."""
    file = test.partition("::")[0]
    if file.startswith(REAL_TIME):
        return side_by_side.REAL_TIME
    return next((folder for folder in TOGETHER if file.startswith(folder)), file)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Take the number of processes that share one collection."""
    parser.addoption(
        "--processes", type=int, choices=range(1, 9), default=1, help="run tests in so many processes, forked"
    )


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> object:
    """Run the tests in several processes where that is asked for, those that share fixtures in one of them."""
    options = session.config.option
    if options.processes == 1 or options.collectonly or session.testsfailed:
        return None
    return side_by_side.run(session, together, options.processes)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep what shares fixtures, or real time, in one worker.

    Marks of a group do nothing with pytest 9.2: xdist 3.8 writes them into a name that is read no more.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Together(LoadScopeScheduling):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.workqueue = side_by_side.HeavyFirst()

        def _split_scope(self, nodeid: str) -> str:
            return together(nodeid)

    return Together(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Part the tests into tiers by their folders."""
    for item in items:
        file = item.path.relative_to(PROJECT_ROOT).as_posix()
        if file.startswith(LONG):
            item.add_marker(pytest.mark.long)
        if not file.startswith(FAST) or item.get_closest_marker("long"):
            item.add_marker(pytest.mark.slow)

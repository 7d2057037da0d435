"""A library's calls in a thread of their own: what they return, what they raise, and when they are left behind."""

from __future__ import annotations

import gc
import threading
import weakref
from collections.abc import Iterator

import pytest

from drivers.cameras.call_thread import CallThread
from drivers.cameras.feature_access import FeatureAccess
from radiometer.errors import DeviceLost
from testing.patience import within


class Stuck:
    """A call that does not return before it is let go."""

    def __init__(self) -> None:
        self.let_go, self.began = threading.Event(), threading.Event()

    def __call__(self) -> str:
        """Wait."""
        self.began.set()
        self.let_go.wait(within(60.0))
        return "late"


@pytest.fixture
def stuck() -> Iterator[Stuck]:
    """Return a call that hangs; it is let go at the end."""
    call = Stuck()
    yield call
    call.let_go.set()


def gone() -> bool:
    """Say that the camera is gone."""
    return True


def fail(text: str) -> None:
    """Raise."""
    raise ValueError(text)


def test_result_and_error_come_back() -> None:
    """What the call returns is returned, what it raises is raised, and the thread goes on."""
    thread = CallThread("camera W1", gone)
    assert thread.run(divmod, 17, 5) == (3, 2)
    with pytest.raises(ValueError, match="refused"):
        thread.run(fail, "refused")
    assert thread.run(len, "abc") == 3
    thread.close()


def test_calls_run_in_one_other_thread() -> None:
    """Every call runs in the same thread, which is not the caller's."""
    thread = CallThread("camera W1", gone)
    names = {thread.run(threading.get_ident) for _ in range(3)}
    assert len(names) == 1
    assert names != {threading.get_ident()}
    thread.close()


def test_call_to_a_camera_that_is_gone_is_left_behind(stuck: Stuck) -> None:
    """The caller gets DeviceLost while the library still waits, and no later call waits behind it."""
    thread = CallThread("camera W1", gone, patience_s=0.01)
    with pytest.raises(DeviceLost, match="camera W1 stopped answering"):
        thread.run(stuck)
    assert stuck.began.is_set()
    assert not stuck.let_go.is_set()
    asked: list[int] = []
    with pytest.raises(DeviceLost):
        thread.run(asked.append, 1)
    assert asked == []


def test_slow_call_to_a_camera_that_is_there_is_waited_for(stuck: Stuck) -> None:
    """As long as the camera answers for itself, the call may take its time."""
    questions: list[int] = []

    def is_gone() -> bool:
        questions.append(1)
        if len(questions) == 3:
            stuck.let_go.set()
        return False

    thread = CallThread("camera W1", is_gone, patience_s=0.01)
    assert thread.run(stuck) == "late"
    assert len(questions) >= 3
    thread.close()


def test_nothing_is_called_after_the_end() -> None:
    """A closed thread refuses instead of waiting for ever."""
    thread = CallThread("camera W1", gone)
    thread.close()
    with pytest.raises(DeviceLost):
        thread.run(len, "abc")


def test_failed_call_keeps_nothing_alive() -> None:
    """Once its error is handled, what a call was made with is freed without the garbage collector."""

    class Held:
        def refuse(self) -> None:
            raise ValueError

    thread, held = CallThread("camera W1", gone), Held()
    watch = weakref.ref(held)
    gc.disable()
    try:
        with pytest.raises(ValueError):  # noqa: PT011  (raised three lines above)
            thread.run(held.refuse)
        thread.run(len, "")  # the thread is done with the call before
        del held
        assert watch() is None
    finally:
        gc.enable()
        thread.close()


def test_camera_left_behind_is_known_as_lost(stuck: Stuck) -> None:
    """The features of a camera whose call was left behind note that it is gone, so that it is not asked again."""
    features = FeatureAccess(None, "camera W1", OSError, CallThread("camera W1", gone, patience_s=0.01))
    with pytest.raises(DeviceLost):
        features.call(stuck)
    assert features.lost.is_set()


def test_a_call_that_outlasts_its_deadline_is_left_behind(stuck: Stuck) -> None:
    """A USB camera that is there and hangs is given up after its deadline, however often it says that it is there."""
    questions = []
    thread = CallThread("camera W1", lambda: bool(questions.append(1)), patience_s=0.01, deadline_s=0.05)
    with pytest.raises(DeviceLost, match="camera W1 stopped answering"):
        thread.run(stuck)
    assert len(questions) == 4  # the fifth pause is the deadline
    with pytest.raises(DeviceLost):
        thread.run(len, "abc")


def test_without_a_deadline_a_call_may_take_as_long_as_the_camera_is_there(stuck: Stuck) -> None:
    """A network camera that answers past the library is waited for."""
    questions = []

    def still_there() -> bool:
        questions.append(1)
        if len(questions) == 8:
            stuck.let_go.set()
        return False

    assert CallThread("camera W1", still_there, patience_s=0.01).run(stuck) == "late"

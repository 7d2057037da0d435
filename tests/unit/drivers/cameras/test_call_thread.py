"""Calls of a library in a thread, and their release in the background."""

import gc
import sys
import threading
import weakref
from collections.abc import Iterator

import pytest

from drivers.cameras.aravis_camera import load_library, open_camera
from drivers.cameras.call_thread import CallThread, drop_in_background
from drivers.cameras.feature_access import FeatureAccess
from drivers.cameras.frame_stream import FrameStream, Tally
from radiometer.errors import DeviceError, DeviceLost, MissingLibrary
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
    """From one thread, not the caller's, which goes on after an error; a closed one refuses, and waits for nothing."""
    thread = CallThread("camera W1", gone)
    assert thread.run(divmod, 17, 5) == (3, 2)
    with pytest.raises(ValueError, match="refused"):
        thread.run(fail, "refused")
    (own,) = {thread.run(threading.get_ident) for _ in range(3)}
    assert own != threading.get_ident()
    thread.close()
    with pytest.raises(DeviceLost):
        thread.run(len, "abc")


def test_call_to_a_camera_that_is_gone_is_left_behind(stuck: Stuck) -> None:
    """The caller gets DeviceLost while the library still waits; none waits behind it, and its features know of it."""
    thread = CallThread("camera W1", gone, patience_s=0.01)
    with pytest.raises(DeviceLost, match="camera W1 stopped answering"):
        thread.run(stuck)
    assert stuck.began.is_set()
    assert not stuck.let_go.is_set()
    asked: list[int] = []
    with pytest.raises(DeviceLost):
        thread.run(asked.append, 1)
    assert asked == []
    features = FeatureAccess(None, "camera W1", OSError, CallThread("camera W1", gone, patience_s=0.01))
    with pytest.raises(DeviceLost):
        features.call(stuck)
    assert features.lost.is_set()


def test_slow_call_to_a_camera_that_is_there_is_waited_for(stuck: Stuck) -> None:
    """As long as the camera answers for itself, a call without a deadline may take its time."""
    questions: list[int] = []

    def is_gone() -> bool:
        questions.append(1)
        if len(questions) == 8:
            stuck.let_go.set()
        return False

    thread = CallThread("camera W1", is_gone, patience_s=0.01)
    assert thread.run(stuck) == "late"
    assert len(questions) >= 8
    thread.close()


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


def test_a_call_that_outlasts_its_deadline_is_left_behind(stuck: Stuck) -> None:
    """A USB camera that is there and hangs is given up after its deadline, however often it says that it is there."""
    questions = []
    thread = CallThread("camera W1", lambda: bool(questions.append(1)), patience_s=0.01, deadline_s=0.05)
    with pytest.raises(DeviceLost, match="camera W1 stopped answering"):
        thread.run(stuck)
    assert len(questions) == 4  # the fifth pause is the deadline
    with pytest.raises(DeviceLost):
        thread.run(len, "abc")


class _SlowToEnd:
    """Its end waits for permission, as that of a stream whose camera is gone waits for an answer."""

    def __init__(self) -> None:
        self.may_end, self.ended_in = threading.Event(), list[str]()

    def __del__(self) -> None:
        self.may_end.wait(within(20.0))
        self.ended_in.append(threading.current_thread().name)


def test_the_last_reference_is_dropped_in_a_thread_of_its_own():
    """No one waits for the end, not even who holds the object a while longer."""
    slow = _SlowToEnd()
    may_end, ended_in = slow.may_end, slow.ended_in
    drop_in_background(slow)
    del slow
    assert ended_in == []
    may_end.set()
    for thread in threading.enumerate():
        if thread.name == "camera release":
            thread.join(within(20.0))
    assert ended_in == ["camera release"]


def test_an_error_of_the_library_keeps_no_frame_alive(library_error):
    """Once the error is handled, what the failing call held is freed without the garbage collector."""

    class Held:
        ended = False

        def fail(self) -> None:
            raise library_error("[Gain] access denied")

        def __del__(self) -> None:
            type(self).ended = True

    def failing() -> None:
        held = Held()
        FeatureAccess(held, "camera W1", library_error).call(held.fail)

    gc.disable()
    try:
        with pytest.raises(DeviceError):
            failing()
        assert Held.ended
    finally:
        gc.enable()


def test_a_closed_camera_is_given_back_to_the_library_at_once():
    """Its object ends with close(): later it would write to a camera that somebody else controls by then."""
    try:
        load_library()
    except MissingLibrary as error:
        pytest.skip(str(error))
    camera, ended = open_camera("Fake_1"), list[bool]()
    gc.disable()
    try:
        camera.open()
        camera.capture(1)
        camera.session.camera.weak_ref(lambda: ended.append(True))
        camera.close()
        assert ended == [True]
    finally:
        gc.enable()


def test_an_acquisition_leaves_nothing_behind():
    """A daemon starts one per reading, for months: it keeps no memory of Python's."""
    try:
        aravis = load_library().aravis
    except MissingLibrary as error:
        pytest.skip(str(error))
    with open_camera("Fake_1") as camera:

        def kept_by(acquisitions: int) -> int:
            gc.collect()
            before = sys.getallocatedblocks()
            for _ in range(acquisitions):
                stream = FrameStream(aravis, camera.session.camera, camera.session.features, "fake", Tally())
                stream.start()
                stream.stop()
            gc.collect()
            return sys.getallocatedblocks() - before

        gc.freeze()  # what was there before is not looked through again each time
        # The first ones fill caches; what each one keeps, every forty keep.
        assert any(kept_by(40) < 20 for _ in range(10))

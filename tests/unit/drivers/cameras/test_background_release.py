"""Letting go of a camera: at once where it answers, without waiting where it is gone."""

from __future__ import annotations

import gc
import sys
import threading

import pytest

from drivers.cameras.aravis_camera import load_library, open_camera
from drivers.cameras.background_release import drop_in_background
from drivers.cameras.feature_access import FeatureAccess
from drivers.cameras.frame_stream import FrameStream, Tally
from radiometer.errors import DeviceError, MissingLibrary
from testing.patience import within


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

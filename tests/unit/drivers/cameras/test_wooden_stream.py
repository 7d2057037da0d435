"""Frames of a stream: fresh, stale, late or lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import pytest

from drivers.cameras import aravis_camera
from drivers.cameras.aravis_camera import FreshFrames
from drivers.cameras.camera_quirks import quirks_for
from drivers.cameras.feature_access import FeatureAccess
from drivers.cameras.frame_stream import (
    BUFFER_COUNT,
    MAX_ATTEMPTS,
    FrameStream,
    LossyLink,
    RawFrame,
    Tally,
    missed_between,
)
from radiometer.data import LensDescription
from radiometer.devices import CameraSettings
from radiometer.errors import DeviceError, DeviceLost, DeviceTimeout

WHOLE, BROKEN = "success", "missing-packets"


class WoodenBuffer:
    def __init__(self, frame_id: int, status: str = WHOLE, exposure_us: float | None = None) -> None:
        self.exposure_us = exposure_us
        self.answers = {
            "get_frame_id": frame_id,
            "get_timestamp": frame_id * 10**9,
            "get_status": WOODEN_STATUS[status],
            "get_image_data": bytes(4),
            "get_image_pixel_format": 0x01080001,
            "get_image_width": 2,
            "get_image_height": 2,
            "has_chunks": exposure_us is not None,
        }

    def __getattr__(self, name: str):
        return lambda: self.answers[name]


WOODEN_STATUS = {name: SimpleNamespace(value_nick=name) for name in (WHOLE, BROKEN)}

ARAVIS = SimpleNamespace(
    Buffer=SimpleNamespace(new_allocate=lambda size: f"buffer of {size}"),
    BufferStatus=SimpleNamespace(SUCCESS=WOODEN_STATUS[WHOLE]),
)


class WoodenStream:
    props = SimpleNamespace()

    def __init__(self, buffers: list[WoodenBuffer]) -> None:
        self.infos = {"n_underruns": 2, "n_resent_packets": 5, "n_missing_packets": 7}
        self.buffers, self.pushed, self.asked = list(buffers), [], 0

    def push_buffer(self, buffer: object) -> None:
        self.pushed.append(buffer)

    def timeout_pop_buffer(self, _timeout_us: int) -> WoodenBuffer | None:
        self.asked += 1
        return self.buffers.pop(0) if self.buffers else None

    def get_n_infos(self) -> int:
        return len(self.infos)

    def get_info_name(self, index: int) -> str:
        return list(self.infos)[index]

    def get_info_uint64_by_name(self, name: str) -> int:
        return self.infos[name]


class WoodenCamera:
    def __init__(self, buffers: list[WoodenBuffer]) -> None:
        self.stream, self.calls = WoodenStream(buffers), []

    def get_payload(self) -> int:
        return 4

    def is_gv_device(self) -> bool:
        return False

    def create_stream(self, _callback: None) -> WoodenStream:
        return self.stream

    def start_acquisition(self) -> None:
        self.calls.append("start")

    def stop_acquisition(self) -> None:
        self.calls.append("stop")

    def create_chunk_parser(self) -> SimpleNamespace:
        return SimpleNamespace(get_float_value=lambda buffer, name: {"ChunkExposureTime": buffer.exposure_us}[name])


@pytest.fixture
def started(library_error):
    """Return a function that starts a stream over given buffers."""

    def make(*buffers: WoodenBuffer, chunks: tuple[str, ...] = ()):
        camera, tally = WoodenCamera(list(buffers)), Tally()
        features = FeatureAccess(camera, "camera W1", library_error)
        stream = FrameStream(ARAVIS, camera, features, "camera W1", tally, chunks)
        stream.start()
        return camera, tally, stream

    return make


def test_incomplete_frames_are_retried_and_counted(started):
    """Damaged buffers go back to the stream, the first whole one is returned; each attempt is triggered anew."""
    camera, tally, stream = started(WoodenBuffer(1, BROKEN), WoodenBuffer(2, BROKEN), WoodenBuffer(3))
    assert stream.next_frame(1.0).frame_id == 3
    assert (tally.incomplete, tally.retried, tally.frames) == (2, 2, 1)
    assert len(camera.stream.pushed) == BUFFER_COUNT + 3
    _, _, stream = started(WoodenBuffer(1, BROKEN), WoodenBuffer(2))
    triggers = []
    stream.next_frame(1.0, lambda: triggers.append("trigger"))
    assert len(triggers) == 2


def test_running_numbers_go_on_rising_over_the_cameras_wrap(started):
    """GigE Vision 1.x starts again at 1 after 65535; numbers of an acquisition do not, late frames included."""
    ids = (65533, 65535, 1, 65534, 2, 4)
    _, tally, stream = started(*(WoodenBuffer(n) for n in ids))
    assert [stream.next_frame(1.0).frame_id for _ in ids] == [65533, 65535, 65536, 65534, 65537, 65539]
    assert tally.extra["missed_frames"] == 1


def test_a_link_that_delivers_nothing_whole_is_given_up(started):
    """After the stated attempts the error says what to look at; an empty stream is None at the deadline."""
    _, _, stream = started(*(WoodenBuffer(n, BROKEN) for n in range(1, MAX_ATTEMPTS + 5)))
    with pytest.raises(DeviceTimeout, match=rf"frames in a row came incomplete \({BROKEN} {MAX_ATTEMPTS} times\)"):
        stream.next_frame(1.0)
    _, tally, stream = started()
    assert stream.next_frame(0.05) is None
    assert tally.timeouts == 1


def test_a_stream_that_ignores_all_that_comes_is_not_waited_for(started):
    """A stray packet makes the library take the camera's frames for late ones: that ends the wait at once."""
    camera, tally, stream = started()
    wooden = camera.stream
    wooden.infos = {"n_completed_buffers": 0, "n_failures": 0, "n_ignored_packets": 2}  # strays before the filter

    def pop(_timeout_us: int) -> None:
        wooden.asked += 1
        wooden.infos["n_ignored_packets"] += 3 * (wooden.asked > 4)  # the first frame comes, and is ignored

    wooden.timeout_pop_buffer = pop
    assert stream.next_frame(60.0) is None
    assert (wooden.asked, tally.timeouts) == (5, 1)


@pytest.mark.parametrize(("limit_bytes", "kind"), [(3, "packet socket"), (4, "ordinary socket")])
def test_an_ordinary_socket_is_preferred_where_it_holds_a_frame(library_error, monkeypatch, limit_bytes, kind):
    """The library's packet socket, which strangers' packets mislead, is kept for frames too large for another."""
    camera, chosen = WoodenCamera([]), []
    camera.is_gv_device, camera.gv_set_stream_options = lambda: True, chosen.append
    monkeypatch.setattr("drivers.cameras.frame_stream.socket_buffer_limit", lambda: limit_bytes)
    aravis = SimpleNamespace(
        **vars(ARAVIS),
        GvStreamOption=SimpleNamespace(NONE="packet socket", PACKET_SOCKET_DISABLED="ordinary socket"),
        GvStreamSocketBuffer=SimpleNamespace(FIXED="fixed"),
    )
    camera.stream.props, room = SimpleNamespace(socket_buffer="auto"), {}
    camera.stream.set_property = room.__setitem__
    FrameStream(aravis, camera, FeatureAccess(camera, "camera W1", library_error), "camera W1", Tally()).start()
    assert chosen == [kind]
    assert room == {"socket-buffer": "fixed", "socket-buffer-size": 212_992}


def test_chunk_values_come_with_the_frame(started):
    """Where the camera sends chunks, their values stand in the frame."""
    _, _, stream = started(WoodenBuffer(1, exposure_us=5000.0), chunks=("ExposureTime",))
    assert stream.next_frame(1.0).chunks == {"ExposureTime": 5000.0}


def test_stopping_takes_over_the_librarys_counts(started):
    """Underruns, resent and missing packets are added up at the stop; a camera that is gone is not asked to stop."""
    camera, tally, stream = started(WoodenBuffer(1))
    stream.stop(camera_is_there=False)
    assert (tally.underruns, tally.resent_packets, tally.missing_packets) == (2, 5, 7)
    assert camera.calls == ["start"]


def wooden_session(discard: int, answers: bool = True):
    quirks = quirks_for("Nobody", "Unknown").model_copy(update={"discard_after_change": discard})

    def require_answer() -> None:
        if not answers:
            raise DeviceLost("camera W1 stopped answering")

    return SimpleNamespace(
        quirks=quirks,
        settings=CameraSettings(exposure_s=0.005, pixel_format="Mono8"),
        capabilities=SimpleNamespace(exposure_step_s=0.0),
        black_level_scale=2.55,
        slow_down=lambda: False,
        label="camera W1",
        temperature_c=lambda: None,
        answers=lambda: answers,
        require_answer=require_answer,
        camera=None,
        features=None,
        chunk_names=(),
        is_lost=None,
    )


def frame(frame_id: int, exposure_us: float | None = None, **others: float) -> RawFrame:
    chunks = others if exposure_us is None else {"ExposureTime": exposure_us, **others}
    return RawFrame(bytes(4), 0x01080001, 2, 2, frame_id, float(frame_id), chunks)


class Scripted:
    """An acquisition that hands over frames or raises errors, then nothing; it keeps its starts and its deadlines."""

    def __init__(self, script: Sequence[RawFrame | Exception]) -> None:
        self.script, self.deadlines, self.starts = list(script), list[float](), 0

    def __call__(self, *_arguments: object) -> Scripted:
        return self

    def start(self) -> None:
        self.starts += 1

    def stop(self, *, camera_is_there: bool) -> None: ...

    def next_frame(self, deadline_s: float, _trigger: object) -> RawFrame | None:
        self.deadlines.append(deadline_s)
        found = self.script.pop(0) if self.script else None
        if isinstance(found, Exception):
            raise found
        return found


@pytest.fixture
def fresh(monkeypatch):
    """Return a function that makes FreshFrames over given raw frames, shown before or not, and its tally."""

    def make(frames: list[RawFrame], discard: int, *, shown: bool = False):
        tally = Tally()
        monkeypatch.setattr(aravis_camera, "FrameStream", Scripted([frame(0, NEW)] * shown * (discard + 1) + frames))
        made = FreshFrames(SimpleNamespace(), wooden_session(discard), LensDescription(), tally, 0.1)
        if shown:
            assert made.next().frame_id == 0
            tally.extra["stale_discarded"] = 0
        return made, tally

    return make


def test_frames_after_a_change_are_discarded_by_count(fresh):
    """Without chunks by the quirk file's number and no more; chunks that never agree are reported, not waited for."""
    frames, tally = fresh([frame(n) for n in range(1, 6)], discard=2)
    assert [frames.next().frame_id, frames.next().frame_id] == [3, 4]
    assert tally.extra["stale_discarded"] == 2
    frames, _ = fresh([frame(n, 9000.0) for n in range(1, 40)], discard=1)
    with pytest.raises(DeviceTimeout, match="exposed under other settings"):
        frames.next()


OLD, NEW = 9000.0, 5000.0  # µs; the wooden session is set to the second

BEFORE = CameraSettings(exposure_s=0.009, pixel_format="Mono8")


BLACK_BEFORE = CameraSettings(exposure_s=0.005, black_level_dn=5.1, pixel_format="Mono8")  # 2.0 per cent


def of_black(*levels: float) -> list[RawFrame]:
    """Return frames of the new exposure whose chunks state these black levels in per cent."""
    return [frame(n, NEW, BlackLevel=level) for n, level in enumerate(levels, start=1)]


@pytest.mark.parametrize(
    ("frames", "before", "taken"),
    [
        pytest.param([frame(1, OLD), frame(2, OLD), frame(3, NEW)], [BEFORE], 3, id="two of the old exposure"),
        pytest.param([frame(1, NEW)], [BEFORE], 1, id="an exposure of 30 s is not waited for thrice"),
        pytest.param([frame(n, NEW) for n in range(1, 5)], [BLACK_BEFORE], 3, id="no chunk states it: by number"),
        pytest.param(of_black(0.0, 0.0), [BLACK_BEFORE], 1, id="its own chunk confirms it"),
        pytest.param(of_black(*[7.0] * 6), [BLACK_BEFORE], 3, id="another chunk never makes it endless"),
        pytest.param(of_black(2.0, 2.0, 2.0, 0.0), [BLACK_BEFORE], 4, id="a late frame states the level before"),
        pytest.param(of_black(*[2.0] * 6), [BLACK_BEFORE], 5, id="as many again at most"),
        pytest.param([frame(n, NEW) for n in range(1, 5)], [BLACK_BEFORE, BEFORE], 3, id="a change not yet shown"),
    ],
)
def test_frames_of_the_settings_before_are_thrown_away(fresh, frames, before, taken):
    """Two are known of; chunks that state what was changed say whether there are fewer, or more, of them."""
    made, tally = fresh(frames, discard=2, shown=True)
    for settings in before:
        made.settings_changed(settings)
    assert made.next().frame_id == taken
    assert tally.extra["stale_discarded"] == taken - 1


def test_a_frame_still_in_the_format_before_is_thrown_away(fresh):
    """No chunk reports a format, but the frame itself does: two of Mono10p pass by, a third would be an error."""
    stale = [replace(frame(n, NEW), format_code=0x010A0046) for n in (1, 2, 3)]
    frames, tally = fresh([*stale[:2], frame(3, NEW)], discard=2, shown=True)
    frames.settings_changed(replace(BEFORE, exposure_s=0.005, pixel_format="Mono10p"))
    assert frames.next().frame_id == 3
    assert tally.extra["stale_discarded"] == 2
    frames, _ = fresh([*stale, frame(4, NEW)], discard=2)
    with pytest.raises(DeviceError, match="sent Mono10p where Mono8 was set"):
        frames.next()


def test_a_frame_of_the_settings_before_is_waited_for_as_long_as_they_say(monkeypatch):
    """After 30 s a short exposure's deadline is that of the frame still in the sensor, until the first fresh one."""
    acquisition = Scripted([frame(n, NEW) for n in (1, 2, 3)])
    monkeypatch.setattr(aravis_camera, "FrameStream", acquisition)
    frames = FreshFrames(SimpleNamespace(), wooden_session(0), LensDescription(), Tally(), 0.1)
    frames.next()
    frames.settings_changed(CameraSettings(exposure_s=30.0, pixel_format="Mono8"))
    frames.next()
    frames.next()
    assert acquisition.deadlines == pytest.approx([0.11, 60.1, 0.11])


@pytest.mark.parametrize(
    ("possible", "starts"), [(5, 4), (2, 4), (1, 3)], ids=["slow enough in time", "at the last start", "never"]
)
def test_a_camera_that_sends_too_fast_is_slowed_down(monkeypatch, possible, starts):
    """Each time that no frame comes whole it is slowed down and started anew, at its slowest once more."""
    lossy = Scripted([*[LossyLink("camera W1: 40 frames in a row came incomplete")] * 3, frame(1, NEW)])
    monkeypatch.setattr(aravis_camera, "FrameStream", lossy)
    session, tally = wooden_session(0), Tally()
    frames = FreshFrames(SimpleNamespace(), session, LensDescription(), tally, 0.05)
    left = iter([True] * possible)
    session.slow_down = lambda: next(left, False)
    if possible == 1:
        with pytest.raises(LossyLink):
            frames.next()
    else:
        assert frames.next().frame_id == 1
    assert lossy.starts == starts
    assert tally.snapshot().extra["restarts"] == (possible < 3)


@pytest.mark.parametrize(
    ("answers", "error", "message", "restarts"),
    [
        (True, DeviceTimeout, r"no frame within 0\.1 s, 3 times over, though it answers", 3),
        (False, DeviceLost, "stopped answering", 0),
    ],
)
def test_an_acquisition_without_frames_is_restarted_where_the_camera_answers(
    monkeypatch, answers, error, message, restarts
):
    """Twice, then it is a timeout with the deadline; a camera that does not answer is lost at once."""
    monkeypatch.setattr(aravis_camera, "FrameStream", Scripted([]))
    tally = Tally()
    frames = FreshFrames(SimpleNamespace(), wooden_session(0, answers), LensDescription(), tally, 0.05)
    with pytest.raises(error, match=message):
        frames.next()
    assert tally.extra["restarts"] == restarts


@pytest.mark.parametrize(
    ("ids", "missed"),
    [*((ids, 0) for ids in ((None, 65401), (7, 8), (65535, 1))), *((ids, 2) for ids in ((7, 10), (65534, 2))),
     ((70_000, 70_003), 2), *((ids, -1) for ids in ((10, 9), (1, 65535), (70_003, 70_001)))],
)  # fmt: skip
def test_gaps_in_running_numbers_are_counted(ids, missed):
    """Frames that never arrived are counted, over the 16-bit wrap too; a late one is taken back."""
    assert missed_between(*ids) == missed

"""The stream's bookkeeping without a library: buffers of wood, handed over in a set order."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from drivers import fresh_frames
from drivers.camera_quirks import quirks_for
from drivers.feature_access import FeatureAccess
from drivers.frame_stream import BUFFER_COUNT, MAX_ATTEMPTS, FrameStream, RawFrame, Tally
from drivers.fresh_frames import FreshFrames
from radiometer.data import LensDescription
from radiometer.devices import CameraSettings
from radiometer.errors import DeviceLost, DeviceTimeout

WHOLE, BROKEN = "success", "missing-packets"


class WoodenBuffer:
    def __init__(self, frame_id: int, status: str = WHOLE, exposure_us: float | None = None) -> None:
        self.frame_id, self.status, self.exposure_us = frame_id, status, exposure_us

    def get_frame_id(self) -> int:
        return self.frame_id

    def get_status(self) -> SimpleNamespace:
        return WOODEN_STATUS[self.status]

    def get_image_data(self) -> bytes:
        return bytes(4)

    def get_image_pixel_format(self) -> int:
        return 0x01080001

    def get_image_width(self) -> int:
        return 2

    get_image_height = get_image_width

    def get_timestamp(self) -> int:
        return self.frame_id * 10**9

    def has_chunks(self) -> bool:
        return self.exposure_us is not None


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

    def create_stream(self, _callback: None, _data: None) -> WoodenStream:
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
    """Damaged buffers are handed back to the stream; the first whole one is returned."""
    camera, tally, stream = started(WoodenBuffer(1, BROKEN), WoodenBuffer(2, BROKEN), WoodenBuffer(3))
    assert stream.next_frame(1.0).frame_id == 3
    assert (tally.incomplete, tally.retried, tally.frames) == (2, 2, 1)
    assert len(camera.stream.pushed) == BUFFER_COUNT + 3


def test_frames_that_never_came_are_counted(started):
    """A gap in the running numbers is counted as missed, a late frame is taken back."""
    _, tally, stream = started(WoodenBuffer(5), WoodenBuffer(8), WoodenBuffer(7), WoodenBuffer(9))
    for _ in range(4):
        stream.next_frame(1.0)
    assert tally.extra["missed_frames"] == 1


def test_a_link_that_delivers_nothing_whole_is_given_up(started):
    """After the stated number of attempts the error says what to look at."""
    _, _, stream = started(*(WoodenBuffer(n, BROKEN) for n in range(1, MAX_ATTEMPTS + 5)))
    with pytest.raises(DeviceTimeout, match=f"{MAX_ATTEMPTS} frames in a row came incomplete"):
        stream.next_frame(1.0)


def test_nothing_within_the_deadline_is_none(started):
    """An empty stream returns None once the deadline is over, and counts it."""
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
    monkeypatch.setattr("drivers.frame_stream.socket_buffer_limit", lambda: limit_bytes)
    aravis = SimpleNamespace(
        **vars(ARAVIS), GvStreamOption=SimpleNamespace(NONE="packet socket", PACKET_SOCKET_DISABLED="ordinary socket")
    )
    FrameStream(aravis, camera, FeatureAccess(camera, "camera W1", library_error), "camera W1", Tally()).start()
    assert chosen == [kind]


def test_each_attempt_is_triggered_anew(started):
    """In triggered mode a damaged frame asks for another trigger."""
    _, _, stream = started(WoodenBuffer(1, BROKEN), WoodenBuffer(2))
    triggers = []
    stream.next_frame(1.0, lambda: triggers.append("trigger"))
    assert len(triggers) == 2


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
        label="camera W1",
        temperature_c=lambda: None,
        answers=lambda: answers,
        require_answer=require_answer,
    )


def frame(frame_id: int, exposure_us: float | None = None) -> RawFrame:
    chunks = {} if exposure_us is None else {"ExposureTime": exposure_us}
    return RawFrame(bytes(4), 0x01080001, 2, 2, frame_id, float(frame_id), chunks)


@pytest.fixture
def fresh(monkeypatch):
    """Return a function that makes FreshFrames over given raw frames, and its tally."""

    def make(frames: list[RawFrame], discard: int):
        tally, queue = Tally(), iter(frames)
        made = FreshFrames(SimpleNamespace(), wooden_session(discard), LensDescription(), tally, 0.1)
        monkeypatch.setattr(made, "_raw_frame", lambda: next(queue))
        return made, tally

    return make


def test_frames_after_a_change_are_discarded_by_count(fresh):
    """Without chunks as many frames are thrown away as the quirk file says, and no more."""
    frames, tally = fresh([frame(n) for n in range(1, 6)], discard=2)
    assert [frames.next().frame_id, frames.next().frame_id] == [3, 4]
    frames.settings_changed()
    assert tally.extra["stale_discarded"] == 2


def test_a_lagging_chunk_costs_one_more_frame(fresh):
    """After a chunk of the old exposure the first frame of the new one is thrown away too (aravis issue 312)."""
    old, new = 9000.0, 5000.0
    frames, _ = fresh([frame(1, old), frame(2, old), frame(3, new), frame(4, new)], discard=0)
    assert frames.next().frame_id == 4


def test_a_camera_that_keeps_its_old_exposure_is_an_error(fresh):
    """If the chunks never agree with the settings, that is told instead of waiting for ever."""
    frames, _ = fresh([frame(n, 9000.0) for n in range(1, 40)], discard=1)
    with pytest.raises(DeviceTimeout, match="exposed under other settings"):
        frames.next()


def silent(answers: bool) -> tuple[FreshFrames, Tally]:
    tally = Tally()
    return FreshFrames(SimpleNamespace(), wooden_session(0, answers), LensDescription(), tally, 0.05), tally


class NothingComes:
    def __init__(self, *_arguments: object) -> None: ...

    def start(self) -> None: ...

    def stop(self, *, camera_is_there: bool) -> None: ...

    def next_frame(self, _deadline_s: float, _trigger: object) -> None: ...


def test_an_acquisition_without_frames_is_restarted_then_given_up(monkeypatch):
    """A camera that answers but sends nothing is started again twice, then it is a timeout with the deadline."""
    monkeypatch.setattr(fresh_frames, "FrameStream", NothingComes)
    frames, tally = silent(answers=True)
    frames._session.camera = frames._session.features = frames._session.chunk_names = frames._session.is_lost = None
    with pytest.raises(DeviceTimeout, match=r"no frame within 0\.1 s, 3 times over, though it answers"):
        frames.next()
    assert tally.extra["restarts"] == 3


def test_a_camera_without_an_answer_is_lost_at_once(monkeypatch):
    """A camera that sends nothing and does not answer is lost; it is not started again."""
    monkeypatch.setattr(fresh_frames, "FrameStream", NothingComes)
    frames, tally = silent(answers=False)
    frames._session.camera = frames._session.features = frames._session.chunk_names = frames._session.is_lost = None
    with pytest.raises(DeviceLost):
        frames.next()
    assert tally.extra["restarts"] == 0

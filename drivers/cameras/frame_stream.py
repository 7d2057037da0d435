"""One acquisition, from its start to its stop: complete frames only, each wait with a deadline, mishaps counted."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import structlog

from drivers.cameras.call_thread import drop_in_background
from drivers.cameras.feature_access import FeatureAccess, Refusal
from drivers.cameras.host_checks import socket_buffer_limit
from radiometer.devices import AcquisitionCounts, CameraSettings
from radiometer.errors import DeviceError, DeviceTimeout

_LOG = structlog.get_logger(__name__)

BUFFER_COUNT: Final = 8  # a pause of Python of several frame times loses no frame; at 20 MB a frame it holds 160 MB
# With 10 ‰ of the packets lost and no resend, half of the frames of 70 packets are whole: 40 in a row fail 1e-12.
MAX_ATTEMPTS: Final = 40
# What a kernel gives unasked. The library's own choice is the frame's size: with headers, 3 kB do not hold 3 packets.
_LEAST_SOCKET_BYTES: Final = 212_992
_POLL_S: Final = 0.2  # how often a wait looks whether the camera is still there
_LEGACY_FRAME_IDS: Final = 65535  # GigE Vision 1.x counts frames 1 to 65535 and starts again


class LossyLink(DeviceTimeout):
    """Frame after frame comes incomplete: the link carries less than the camera sends."""


@dataclass(slots=True)
class Tally:
    """Running counts of what went wrong and was put right."""

    frames: int = 0
    retried: int = 0
    incomplete: int = 0
    timeouts: int = 0
    underruns: int = 0
    resent_packets: int = 0
    missing_packets: int = 0
    extra: dict[str, int] = field(default_factory=lambda: {"missed_frames": 0, "stale_discarded": 0, "restarts": 0})

    def snapshot(self) -> AcquisitionCounts:
        """Return the counts as they stand."""
        return AcquisitionCounts(**asdict(self))


@dataclass(frozen=True, slots=True)
class RawFrame:
    """A complete frame as it came over the wire."""

    payload: bytes  # bytes of the picture
    format_code: int  # PFNC value of the pixel format
    width: int  # picture width in pixels
    height: int  # picture height in pixels
    frame_id: int  # running number of the acquisition; goes on rising where the camera's own starts again
    timestamp_s: float  # time of the camera's clock in s; the computer's where the camera has none
    chunks: dict[str, float]  # chunk values by name


class FrameStream:
    """Buffers and bookkeeping of one acquisition.

    Args:
        aravis: The library's module.
        camera: An open `Aravis.Camera`.
        chunk_names: Float chunk values to read from every frame.
        is_lost: Returns whether the library has noticed that the camera is gone.
    """

    def __init__(
        self,
        aravis: Any,
        camera: Any,
        features: FeatureAccess,
        name: str,
        tally: Tally,
        chunk_names: tuple[str, ...] = (),
        is_lost: Callable[[], bool] = lambda: False,
    ) -> None:
        self._aravis, self._camera, self._features = aravis, camera, features
        self._name, self._tally, self._is_lost = name, tally, is_lost
        self._chunk_names = chunk_names
        self._chunk_parser: Any = camera.create_chunk_parser() if chunk_names else None
        self._stream: Any = None
        self._last_id: int | None = None
        self._turns = 0  # how often the camera's own numbers have started again

    def start(self) -> None:
        """Open a stream channel, hand it buffers and start the acquisition. Raises DeviceError."""
        call = self._features.call
        payload = call(self._camera.get_payload)
        if self._camera.is_gv_device():
            self._camera.gv_set_stream_options(self._socket_kind(payload))
        # Without the user data of the callback that there is not: PyGObject keeps 48 bytes of each None given for them.
        self._stream = call(self._camera.create_stream, None)
        if self._stream is None:
            raise DeviceError(f"{self._name}: no stream channel could be opened; another program may hold it")
        if hasattr(self._stream.props, "socket_buffer"):  # GigE Vision: room for a whole frame in the kernel
            self._stream.set_property("socket-buffer", self._aravis.GvStreamSocketBuffer.FIXED)
            self._stream.set_property("socket-buffer-size", max(payload, _LEAST_SOCKET_BYTES))
        for _ in range(BUFFER_COUNT):
            self._stream.push_buffer(self._aravis.Buffer.new_allocate(payload))
        self._last_id, self._turns = None, 0
        call(self._camera.start_acquisition)

    def stop(self, *, camera_is_there: bool = True) -> None:
        """Stop the acquisition and give the stream channel back. Raises DeviceError if the camera refuses."""
        if self._stream is None:
            return
        try:
            if camera_is_there:
                self._features.call(self._camera.stop_acquisition)
        finally:
            self._add_statistics()
            held, self._stream = [self._stream], None
            if self._is_lost():
                drop_in_background(*held)
            else:
                self._features.call(held.clear)  # its end says goodbye to the camera

    def next_frame(self, deadline_s: float, trigger: Callable[[], None] | None = None) -> RawFrame | None:
        """Return the next complete frame; None if nothing came within the deadline or the camera is gone.

        Args:
            deadline_s: Longest wait for one frame in s.
            trigger: Called before each attempt; None in free running.

        Raises:
            LossyLink: If MAX_ATTEMPTS frames in a row came incomplete.
        """
        how = Counter[str]()
        for _ in range(MAX_ATTEMPTS):
            if trigger is not None:
                trigger()
            buffer = self._pop(deadline_s)
            if buffer is None:
                self._tally.timeouts += 1
                return None
            frame = self._accept(buffer)
            how[buffer.get_status().value_nick] += 1
            self._stream.push_buffer(buffer)
            if frame is not None:
                self._tally.frames += 1
                return frame
            self._tally.retried += 1
        raise LossyLink(
            f"{self._name}: {MAX_ATTEMPTS} frames in a row came incomplete "
            f"({', '.join(f'{name} {count} times' for name, count in how.items())}); the link loses packets "
            "(`radiometer doctor` checks packet size and socket buffers)"
        )

    def _pop(self, deadline_s: float) -> Any:
        end, ignored = time.monotonic() + deadline_s, None
        while (left := end - time.monotonic()) > 0 and not self._is_lost():
            buffer = self._stream.timeout_pop_buffer(int(min(left, _POLL_S) * 1e6) + 1)
            if buffer is not None:
                return buffer
            before, ignored = ignored, self._ignored_packets()
            if before is not None and ignored > before:
                _LOG.info("stream misled by a packet that is not the camera's", camera=self._name)
                break
        return None

    def _socket_kind(self, payload_bytes: int) -> Any:
        """Return the library's option: packet sockets only where an ordinary socket cannot hold a frame.

        Packets of other programs may come before the library's packet socket has its filter. They count as a frame of
        the camera with a wild number, and up to 100 good frames after it as late ones.
        """
        options = self._aravis.GvStreamOption
        return options.PACKET_SOCKET_DISABLED if payload_bytes <= socket_buffer_limit() else options.NONE

    def _ignored_packets(self) -> int:
        """Return how many packets a stream without a frame so far has ignored; they grow where it is misled."""
        counts = self._counts()
        has_frames = counts.get("n_completed_buffers", 0) + counts.get("n_failures", 0)
        return 0 if has_frames else counts.get("n_ignored_packets", 0)

    def _accept(self, buffer: Any) -> RawFrame | None:
        frame_id = int(buffer.get_frame_id())
        running_id = self._count_missed(frame_id)
        if buffer.get_status() != self._aravis.BufferStatus.SUCCESS:
            self._tally.incomplete += 1
            _LOG.debug("incomplete frame", camera=self._name, frame_id=frame_id, status=buffer.get_status().value_nick)
            return None
        return RawFrame(
            payload=bytes(buffer.get_image_data() or b""),
            format_code=int(buffer.get_image_pixel_format()),
            width=int(buffer.get_image_width()),
            height=int(buffer.get_image_height()),
            frame_id=running_id,
            timestamp_s=(buffer.get_timestamp() or buffer.get_system_timestamp()) / 1e9,
            chunks=self._chunks(buffer),
        )

    def _count_missed(self, frame_id: int) -> int:
        """Count the frames missed before this one, and return its number in this acquisition."""
        last_id, missed = self._last_id, missed_between(self._last_id, frame_id)
        self._tally.extra["missed_frames"] += missed
        if missed >= 0:
            self._turns += last_id is not None and frame_id < last_id
            self._last_id = frame_id
            return frame_id + self._turns * _LEGACY_FRAME_IDS
        before_the_turn = last_id is not None and frame_id > last_id  # late, from before the numbers started again
        return frame_id + (self._turns - before_the_turn) * _LEGACY_FRAME_IDS

    def _chunks(self, buffer: Any) -> dict[str, float]:
        if self._chunk_parser is None or not buffer.has_chunks():
            return {}
        read = self._chunk_parser.get_float_value
        return {name: float(self._features.call_here(read, buffer, f"Chunk{name}")) for name in self._chunk_names}

    def _add_statistics(self) -> None:
        counts = self._counts()
        self._tally.underruns += counts.get("n_underruns", 0)
        self._tally.resent_packets += counts.get("n_resent_packets", 0)
        self._tally.missing_packets += counts.get("n_missing_packets", 0)

    def _counts(self) -> dict[str, int]:
        names = [self._stream.get_info_name(i) for i in range(self._stream.get_n_infos())]
        return {name: int(self._stream.get_info_uint64_by_name(name)) for name in names if name.startswith("n_")}


def missed_between(last_id: int | None, frame_id: int) -> int:
    """Return how many frames the camera sent between two that arrived, by their running numbers.

    Args:
        last_id: Highest number so far; None before the first frame.
        frame_id: Number of this frame; 16-bit numbers run from 1 to 65535 and start again at 1.

    Returns:
        The count; −1 for a frame that was counted as missed and arrives late.
    """
    if last_id is None or frame_id == last_id:
        return 0
    ahead = frame_id - last_id
    if max(last_id, frame_id) <= _LEGACY_FRAME_IDS:
        half = _LEGACY_FRAME_IDS // 2
        ahead = (ahead + half) % _LEGACY_FRAME_IDS - half
    return ahead - 1 if ahead > 0 else -1


CHUNKS: Final = ("ExposureTime", "Gain", "BlackLevel")
_SAME_EXPOSURE_REL: Final = 1e-3  # the chunk is rounded as the register is; neighbouring settings differ by more
# A chunk counts whole µs (FLIR's descriptions: ChunkExposureTimeUS = RAW*1), and a whole µs more or less is another
# setting: only what is less than a step away may be the same.
_CHUNK_STEP_S: Final = 1e-6
_WITHIN_STEP: Final = 0.999  # a difference of a whole step counts as one, rounding of floats included
_SAME_GAIN_DB: Final = 0.01  # cameras step by 0.1 dB or finer steps of which rounding leaves hundredths
_SAME_BLACK_REL: Final = 2e-4  # of full scale
_SAME_BLACK_DN: Final = 0.5  # read back in whole DN


def switch_on_chunks(camera: Any, features: FeatureAccess, notes: list[str]) -> tuple[str, ...]:
    """Switch chunks for exposure time, gain and black level on, and return the names of those that are.

    A chunk that cannot be switched on is noted and done without: Blackflies lock the switches of some, and refuse the
    selector while a user set is being loaded.

    Args:
        camera: An `Aravis.Camera`.
        notes: What was met on the way is added here.
    """
    if not features.has("ChunkModeActive") or not features.has("ChunkSelector"):
        return ()
    try:
        features.write("ChunkModeActive", True)
        offered = features.call(camera.dup_available_enumerations_as_strings, "ChunkSelector")
    except Refusal as error:
        notes.append(f"no chunks ({error}): frames after a change of settings are thrown away by number")
        return ()
    return tuple(name for name in CHUNKS if name in offered and _switched_on(features, name, notes))


def _switched_on(features: FeatureAccess, name: str, notes: list[str]) -> bool:
    try:
        features.write("ChunkSelector", name)
        if features.read("ChunkEnable", bool) or features.write("ChunkEnable", True):
            return True
        reason = "it took the write and stayed off"
    except Refusal as error:
        reason = str(error)
    notes.append(f"no chunk {name} ({reason}): a change of it is waited for by number of frames")
    return False


def holds_other_settings(raw: RawFrame, settings: CameraSettings, exposure_step_s: float = 0.0) -> bool:
    """Tell whether a frame's chunks say that it was exposed under other settings than those in force.

    Args:
        settings: In force, as read back.
        exposure_step_s: The camera's own step of the exposure time in s; 0 where unknown.
    """
    exposure_us, gain_db = raw.chunks.get("ExposureTime"), raw.chunks.get("Gain")
    least_s = _WITHIN_STEP * max(exposure_step_s, _CHUNK_STEP_S)
    tolerance_s = max(_SAME_EXPOSURE_REL * settings.exposure_s, least_s)
    if exposure_us is not None and abs(exposure_us * 1e-6 - settings.exposure_s) > tolerance_s:
        return True
    return gain_db is not None and abs(gain_db - settings.gain_db) > _SAME_GAIN_DB


def stated_by_chunks(
    raw: RawFrame, changed: frozenset[str], settings: CameraSettings, black_level_scale: float, full_scale_dn: int
) -> bool:
    """Tell whether a frame's chunks confirm every setting that was changed.

    Args:
        raw: A frame whose exposure and gain are those in force, as far as its chunks say.
        changed: Names of the chunks of the settings that were changed.
        settings: In force, as read back.
        black_level_scale: DN of a unit of the camera's black level.
    """
    if not changed <= raw.chunks.keys():
        return False
    if "BlackLevel" not in changed:
        return True
    # Only ever a confirmation: a camera that counts this chunk in a unit of its own must not seem stale for ever.
    return determines_black(raw, settings.black_level_dn, black_level_scale, full_scale_dn)


def determines_black(raw: RawFrame, black_level_dn: float, black_level_scale: float, full_scale_dn: int) -> bool:
    """Tell whether a frame's chunk says that it was exposed under a black level.

    Args:
        black_level_dn: The black level in DN.
        black_level_scale: DN of a unit of the camera's black level.
    """
    chunk = raw.chunks.get("BlackLevel")
    tolerance_dn = max(_SAME_BLACK_DN, _SAME_BLACK_REL * full_scale_dn)
    return chunk is not None and abs(chunk * black_level_scale - black_level_dn) <= tolerance_dn


def exposure_of(raw: RawFrame, settings: CameraSettings) -> float:
    """Return the exposure time in s that a frame was taken with: its chunk's, else the one read back.

    A chunk in whole µs says less than a register that is finer: at 11.4 µs it would be 4 % off.
    """
    exposure_us = raw.chunks.get("ExposureTime")
    if exposure_us is None:
        return settings.exposure_s
    is_rounded = exposure_us == int(exposure_us) and abs(exposure_us * 1e-6 - settings.exposure_s) < _CHUNK_STEP_S
    return settings.exposure_s if is_rounded else exposure_us * 1e-6


def changed_chunks(before: CameraSettings, after: CameraSettings) -> frozenset[str]:
    """Return the chunks that identify a change of settings; what needs a stopped acquisition needs none."""
    pairs = (
        ("ExposureTime", before.exposure_s, after.exposure_s),
        ("Gain", before.gain_db, after.gain_db),
        ("BlackLevel", before.black_level_dn, after.black_level_dn),
    )
    return frozenset(name for name, old, new in pairs if old != new)

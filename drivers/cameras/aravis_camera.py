"""A GigE Vision or USB3 Vision camera through Aravis; the only module that imports `gi`.

camera = open_camera("22500001")          # serial number, device id or address
with camera:
    camera.configure(CameraSettings(exposure_s=0.01))
    frames = camera.capture(4)
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from functools import lru_cache
from types import ModuleType
from typing import Final, NamedTuple

import structlog

from drivers.cameras.call_thread import give_up_in_background
from drivers.cameras.camera_opening import CameraSession, find_camera, listed_cameras, open_session
from drivers.cameras.camera_quirks import CameraQuirks, load_preset
from drivers.cameras.frame_stream import (
    CHUNKS,
    FrameStream,
    LossyLink,
    RawFrame,
    Tally,
    changed_chunks,
    determines_black,
    exposure_of,
    holds_other_settings,
    stated_by_chunks,
)
from drivers.cameras.pixel_unpacking import pixel_format_of_code, unpack_pixels
from drivers.cameras.plain_camera import NamedCamera, let_go
from drivers.cameras.settings_access import bit_depth_of
from radiometer.data import CameraDescription, Frame, FrameSettings, LensDescription
from radiometer.devices import AcquisitionCounts, CameraCapabilities, CameraIdentity, CameraSettings
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceTimeout, MissingLibrary

MAX_RESTARTS: Final = 2  # of the acquisition, where nothing comes but the camera still answers
MAX_STALE: Final = 10  # frames under other settings that chunks may announce before something is wrong


def assemble(
    raw: RawFrame,
    settings: CameraSettings,
    quirks: CameraQuirks,
    bit_depth: int,
    lens: LensDescription,
    temperature_c: float | None,
) -> Frame:
    """Return the frame.

    Args:
        settings: Settings in force, as read back.
        quirks: How the camera's Mono16 is laid out.
        temperature_c: Sensor temperature in °C; None where unknown.

    Raises:
        DeviceError: If the picture's format is not the one set, or its payload is too short.
    """
    pixel_format = pixel_format_of_code(raw.format_code)
    if pixel_format is None or pixel_format.name != settings.pixel_format:
        sent = pixel_format.name if pixel_format else f"0x{raw.format_code:08X}"
        raise DeviceError(f"the camera sent {sent} where {settings.pixel_format} was set; configure it again")
    left_aligned = quirks.mono16_left_aligned_bits if pixel_format.name == "Mono16" else 0
    dn = unpack_pixels(
        raw.payload,
        pixel_format.name,
        raw.width,
        raw.height,
        left_aligned_bits=left_aligned,
        big_endian=quirks.mono16_big_endian,
    )
    return Frame(
        dn=dn,
        bit_depth=bit_depth,
        settings=FrameSettings(
            exposure_s=exposure_of(raw, settings),
            gain_db=raw.chunks.get("Gain", settings.gain_db),
            f_number=lens.f_number,
            black_level_dn=settings.black_level_dn,
            temperature_c=temperature_c,
            timestamp_s=raw.timestamp_s,
        ),
        frame_id=raw.frame_id,
        extra={f"chunk_{name}": value for name, value in raw.chunks.items()},
    )


class FreshFrames:
    """The acquisition of one open camera.

    Args:
        aravis: The library's module.
        session: The open camera.
        frame_deadline_s: Longest wait for a frame beyond twice its exposure time, in s.
    """

    def __init__(
        self, aravis: ModuleType, session: CameraSession, lens: LensDescription, tally: Tally, frame_deadline_s: float
    ) -> None:
        self._aravis, self._session, self._lens, self._tally = aravis, session, lens, tally
        self._frame_deadline_s = frame_deadline_s
        self._stream: FrameStream | None = None
        self._stale = session.quirks.discard_after_change
        self._changed = frozenset(CHUNKS)
        self._longest_s = session.settings.exposure_s
        self._former_black_dn: float | None = None
        self._late = 0  # frames beyond the known number that may still show the black level before

    def next(self) -> Frame:
        """Return the next frame exposed under the settings in force. Raises DeviceTimeout or DeviceLost.

        Where chunks state the settings that a frame was exposed under, the first one under those in force is taken.
        Else as many are thrown away as the quirk file states. A chunk that lags by a frame (aravis issue 312) costs
        one more. A late frame of the acquisition before makes them more than the known number. Up to as many again
        are thrown away where their chunk states the former black level.
        """
        session = self._session
        for _ in range(MAX_STALE + session.quirks.discard_after_change + 1):
            raw = self._raw_frame()
            if holds_other_settings(raw, session.settings, session.capabilities.exposure_step_s):
                self._stale = max(self._stale - 1, 0)
            elif self._stale and not self._is_confirmed(raw):
                self._stale -= 1
            elif self._late and self._shows_former_black(raw):
                self._late -= 1
            else:
                self._stale, self._late, self._longest_s = 0, 0, session.settings.exposure_s
                pixel_bits = bit_depth_of(session.settings.pixel_format, session.quirks)
                return assemble(raw, session.settings, session.quirks, pixel_bits, self._lens, session.temperature_c())
            self._tally.extra["stale_discarded"] += 1
            self._tally.frames -= 1  # whole, but not delivered
        raise DeviceTimeout(f"{session.label}: keeps sending frames exposed under other settings; close and reopen it")

    def stop(self) -> None:
        """Stop the acquisition if one runs. Raises DeviceError if the camera refuses."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.stop(camera_is_there=self._session.answers())

    def settings_changed(self, before: CameraSettings) -> None:
        """Remember that the camera's next frames may have been exposed under other settings.

        Args:
            before: What was in force until now. A change that no frame has shown yet is still waited for.
        """
        changed = changed_chunks(before, self._session.settings)
        self._changed = changed | self._changed if self._stale else changed
        if "BlackLevel" in changed:
            self._former_black_dn, self._late = before.black_level_dn, self._session.quirks.discard_after_change
        self._stale = self._session.quirks.discard_after_change
        self._longest_s = max(self._longest_s, before.exposure_s)

    def _shows_former_black(self, raw: RawFrame) -> bool:
        """Tell whether a frame's chunk says the black level before the change, and not the one in force."""
        session, former_dn = self._session, self._former_black_dn
        full_scale_dn = (1 << bit_depth_of(session.settings.pixel_format, session.quirks)) - 1
        scale = session.black_level_scale
        now = determines_black(raw, session.settings.black_level_dn, scale, full_scale_dn)
        return not now and former_dn is not None and determines_black(raw, former_dn, scale, full_scale_dn)

    def _is_confirmed(self, raw: RawFrame) -> bool:
        """Tell whether a frame's format and chunks confirm all that was changed; never where there are no chunks."""
        session = self._session
        sent = pixel_format_of_code(raw.format_code)
        if sent is None or sent.name != session.settings.pixel_format:
            return False
        full_scale_dn = (1 << bit_depth_of(session.settings.pixel_format, session.quirks)) - 1
        return bool(raw.chunks) and stated_by_chunks(
            raw, self._changed, session.settings, session.black_level_scale, full_scale_dn
        )

    def _raw_frame(self) -> RawFrame:
        session = self._session
        # A frame still exposed under the settings before takes as long as those say.
        deadline_s = 2 * max(session.settings.exposure_s, self._longest_s) + self._frame_deadline_s
        for _ in range(MAX_RESTARTS + 1):
            raw = self._next_whole(deadline_s)
            if raw is not None:
                return raw
            session.require_answer()
            self.stop()
            self._tally.extra["restarts"] += 1
        raise DeviceTimeout(
            f"{session.label}: no frame within {deadline_s:.1f} s, {MAX_RESTARTS + 1} times over, though it answers; "
            "see `radiometer doctor`"
        )

    def _next_whole(self, deadline_s: float) -> RawFrame | None:
        """Return the next whole frame; the camera is slowed down as far as it goes where none comes whole.

        Before that is an error the stream is opened once more: its state may be what is wrong, not the link.
        """
        renewed = False
        while True:
            try:
                return self._running().next_frame(deadline_s, self._trigger())
            except LossyLink:
                self.stop()
                if not self._session.slow_down():
                    if renewed:
                        raise
                    renewed = True
                    self._tally.extra["restarts"] += 1

    def _running(self) -> FrameStream:
        if self._stream is None:
            session = self._session
            stream = FrameStream(
                self._aravis,
                session.camera,
                session.features,
                session.label,
                self._tally,
                session.chunk_names,
                session.is_lost,
            )
            stream.start()
            self._stream = stream
        return self._stream

    def _trigger(self) -> Callable[[], None] | None:
        if not self._session.settings.software_trigger:
            return None
        return lambda: self._session.features.execute("TriggerSoftware")


_LOG = structlog.get_logger(__name__)


class _Library(NamedTuple):
    aravis: ModuleType
    glib: ModuleType
    version: str


@lru_cache(maxsize=1)
def load_library() -> _Library:
    """Return Aravis and GLib. Raises MissingLibrary if PyGObject or Aravis is not installed; names the packages."""
    try:
        import gi
    except ImportError as error:
        raise MissingLibrary(
            "GenICam cameras need PyGObject: apt install libgirepository1.0-dev libcairo2-dev, then "
            "pip install 'radiometer[genicam]' (or apt install python3-gi for the system's Python)"
        ) from error
    for version in ("0.10", "0.8"):
        try:
            gi.require_version("Aravis", version)
        except ValueError:
            continue
        from gi.repository import Aravis, GLib

        return _Library(Aravis, GLib, version)
    raise MissingLibrary("GenICam cameras need Aravis: apt install gir1.2-aravis-0.8 aravis-tools")


def discover() -> list[CameraIdentity]:
    """Return the cameras that answer on all networks and USB ports; takes about 1 s. Raises MissingLibrary."""
    return listed_cameras(load_library().aravis)


def open_camera(
    name: str | None = None, preset: str | CameraDescription | None = None, lens: LensDescription | None = None
) -> AravisCamera:
    """Return a camera by id, serial number or address, ready for `open()`.

    Args:
        name: Device id, serial number or IP address; None for the only camera connected.
        preset: Name or path of a datasheet preset, or the description itself; None for that of the camera's model.

    Raises:
        DeviceNotFound: If nothing of that name answers, or several cameras do where none was named.
        MissingLibrary: If Aravis is not installed.
    """
    description = load_preset(preset) if isinstance(preset, str) else preset
    return AravisCamera(find_camera(load_library().aravis, name, discover), preset=description, lens=lens)


class AravisCamera(NamedCamera):
    """A GenICam camera as a `Camera`.

    Args:
        identity: Who it is; `device_id` is what Aravis opens it by. Completed when it is opened.
        preset: What its datasheet says; None to look its model up among the presets.
        frame_deadline_s: Longest wait for a frame beyond twice its exposure time, in s.
    """

    def __init__(
        self,
        identity: CameraIdentity,
        preset: CameraDescription | None = None,
        lens: LensDescription | None = None,
        frame_deadline_s: float = 2.0,
    ) -> None:
        self._identity, self._preset = identity, preset
        self._lens = lens or LensDescription()
        self._frame_deadline_s = frame_deadline_s
        self._session: CameraSession | None = None
        self._frames: FreshFrames | None = None
        self._tally = Tally()

    @property
    def identity(self) -> CameraIdentity:
        """Return who the camera is; vendor and model may be empty until it is opened by address."""
        return self._identity

    @property
    def capabilities(self) -> CameraCapabilities:
        return self._open_session.capabilities

    @property
    def settings(self) -> CameraSettings:
        return self._open_session.settings

    @property
    def description(self) -> CameraDescription:
        """Return what its preset says, in the digital numbers of the pixel format in force."""
        return self._session.description if self._session else self._preset or CameraDescription(bit_depth=12)

    @property
    def lens(self) -> LensDescription:
        return self._lens

    @property
    def counts(self) -> AcquisitionCounts:
        return self._tally.snapshot()

    @property
    def session(self) -> CameraSession:
        """Return the open session: features and what was found of the falsifying ones. Raises DeviceError."""
        return self._open_session

    def open(self) -> None:
        """Take control, reset its streaming state and switch off what falsifies radiometry.

        Raises:
            DeviceNotFound: If nothing answers to its name.
            DeviceInUse: If another program, or this one, holds it.
            MissingLibrary: If Aravis is not installed.
        """
        if self._session is not None:
            raise DeviceInUse(f"{self._label} is open already; close it first")
        library = load_library()
        self._session = self._hold(
            lambda: open_session(library.aravis, library.glib.Error, self._identity, self._preset)
        )
        self._identity, self._tally = self._session.identity, Tally()
        for finding in self._session.hygiene:
            if finding.state == "still_on":
                _LOG.warning("falsifying feature", camera=self._label, finding=str(finding))

    def close(self) -> None:
        session, frames = self._session, self._frames
        self._session = self._frames = None
        if session is None:
            return
        try:
            if frames is not None:
                frames.stop()
            session.release()
        except DeviceError as error:  # it is being given up: a refusal must not hide the error before it
            _LOG.info("camera did not say goodbye", camera=self._label, reason=str(error))
        finally:
            let_go(session.opened_by)
            session.features.close()
            if session.is_lost():
                give_up_in_background(session.camera, load_library().glib.Error)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        session, frames = self._open_session, self._open_frames
        session.require_answer()
        session.access.check(settings)
        frames.stop()
        before = session.settings
        session.access.write(settings)
        session.reread()
        frames.settings_changed(before)
        return session.settings

    def capture(self, count: int = 1) -> list[Frame]:
        frames, triggered = self._open_frames, self.settings.software_trigger
        try:
            return [frames.next() for _ in range(count)]
        finally:
            if not triggered:  # a free-running stream would hold frames exposed before the next call
                frames.stop()

    def stream(self) -> Generator[Frame, None, None]:
        frames = self._open_frames
        try:
            while self._frames is frames:
                yield frames.next()
        finally:
            frames.stop()

    def set_shutter(self, *, closed: bool) -> None:
        """Refuse: machine cameras have no mechanical shutter. Raises DeviceError."""
        raise DeviceError(f"{self._label}: has no shutter; cover the lens by hand for dark frames")

    @property
    def _open_session(self) -> CameraSession:
        if self._session is None:
            raise DeviceError(f"{self._label} is not open; call open() first")
        if self._session.is_lost():
            raise DeviceLost(f"{self._label} stopped answering; check its cable and power, then open it again")
        return self._session

    @property
    def _open_frames(self) -> FreshFrames:
        session = self._open_session
        if self._frames is None:
            aravis = load_library().aravis
            self._frames = FreshFrames(aravis, session, self._lens, self._tally, self._frame_deadline_s)
        return self._frames

"""A GigE Vision or USB3 Vision camera through Aravis; the only module that imports `gi`.

camera = open_camera("22500001")          # serial number, device id or address
with camera:
    camera.configure(CameraSettings(exposure_s=0.01))
    frames = camera.capture(4)
"""

from __future__ import annotations

from collections.abc import Generator
from functools import lru_cache
from types import ModuleType
from typing import NamedTuple

import structlog

from drivers.cameras.call_thread import give_up_in_background
from drivers.cameras.camera_opening import CameraSession, find_camera, listed_cameras, open_session
from drivers.cameras.camera_quirks import load_preset
from drivers.cameras.frame_stream import Tally
from drivers.cameras.fresh_frames import FreshFrames
from drivers.cameras.plain_camera import NamedCamera, let_go
from radiometer.data import CameraDescription, Frame, LensDescription
from radiometer.devices import AcquisitionCounts, CameraCapabilities, CameraIdentity, CameraSettings
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, MissingLibrary

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

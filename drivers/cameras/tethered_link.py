"""A photographic camera on a cable: raw files by libgphoto2, their green pixels as frames, times as the dial means."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from drivers.cameras.call_thread import CallThread
from drivers.cameras.plain_camera import FrameLink, Grab
from radiometer.data.frame import CameraFile
from radiometer.data.raw_files import RAW_SUFFIXES
from radiometer.devices import CameraCapabilities, CameraIdentity, CameraSettings, Finding, Health
from radiometer.errors import (
    CaptureError,
    DeviceError,
    DeviceInUse,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    required_library,
)
from radiometer.importing.photograph_pixels import Photograph, read_photograph
from radiometer.units import exact_exposure_s, exact_f_number, is_dial_time

# Names of the makers' settings in libgphoto2; the first that a camera has is taken.
_SHUTTERS: Final = ("shutterspeed", "shutterspeed2")
_APERTURES: Final = ("aperture", "f-number")
_QUALITIES: Final = ("imageformat", "imagequality")
_RAW_WORDS: Final = ("raw", "nef", "arw", "cr2", "cr3", "orf", "raf", "rw2", "pef", "dng")
_JPEG_WORDS: Final = ("jpeg", "jpg", "fine", "basic", "norm")
_JPEG_MAGIC: Final = b"\xff\xd8\xff"
# What makes a frame other than the settings say, its harmless value, and what it does.
_FALSIFIERS: Final = (
    ("autoexposuremode", ("manual", "m"), "the camera chooses the exposure itself"),
    ("expprogram", ("manual", "m"), "the camera chooses the exposure itself"),
    ("autoiso", ("off",), "the ISO speed drifts between frames"),
    ("isoauto", ("off",), "the ISO speed drifts between frames"),
    ("longexpnr", ("off",), "a dark frame of the camera's own is taken off"),
    ("flashmode", ("off", "flash off"), "the flash lights the scene"),
)
_LOOK_S: Final = 0.5  # how often a call that takes long is looked at
_SETTING_DEADLINE_S: Final = 15.0  # a camera that writes a raw file to its card answers late by seconds
# gphoto2-result.h and gphoto2-port-result.h.
_NOT_FOUND: Final = frozenset({-105, -52, -5, -4})  # MODEL_NOT_FOUND, IO_USB_FIND, UNKNOWN_PORT, LIBRARY
_IN_USE: Final = frozenset({-53, -60, -110})  # IO_USB_CLAIM, IO_LOCK, CAMERA_BUSY
_GONE: Final = frozenset({-7, -10, -34, -35})  # IO, TIMEOUT, IO_READ, IO_WRITE


def load_library() -> Any:
    """Return the binding. Raises MissingLibrary where it is not installed."""
    return required_library("gphoto2", "photographic cameras need gphoto2: pip install 'radiometer[gphoto2]'")


def listed_cameras() -> list[CameraIdentity]:
    """Return the photographic cameras on this computer's ports. Raises MissingLibrary."""
    found = load_library().Camera.autodetect()
    pairs = [(found.get_name(index), found.get_value(index)) for index in range(len(found))]
    return [CameraIdentity("", model, "", f"gphoto2:{port}", f"libgphoto2 {port}") for model, port in pairs]


def open_device(port: str) -> GphotoDevice:
    """Open the camera at a port; the only one where none is named.

    Raises:
        DeviceNotFound: If no camera answers there.
        DeviceInUse: If another program holds it.
        MissingLibrary: If libgphoto2's binding is not installed.
    """
    library = load_library()
    name = f"camera gphoto2:{port}"
    camera = library.Camera()
    try:
        if port:
            ports = library.PortInfoList()
            ports.load()
            camera.set_port_info(ports[ports.lookup_path(port)])
        camera.init()
    except library.GPhoto2Error as error:
        raise _translated(error, name) from error
    return GphotoDevice(library, camera, name)


class GphotoDevice:
    """An open photographic camera."""

    def __init__(self, library: Any, camera: Any, name: str) -> None:
        self._library, self._camera, self._name = library, camera, name
        self._due = 0.0
        self._names: frozenset[str] | None = None
        self._thread = CallThread(name, lambda: time.monotonic() > self._due, _LOOK_S)

    def names(self) -> frozenset[str]:
        """Return the names of its settings."""
        # The whole tree: the library's flat list names what a maker's cameras may have, not what this one has.
        if self._names is None:
            self._names = frozenset(_leaves(self._call(self._camera.get_config)))
        return self._names

    def read(self, name: str) -> str:
        """Return a setting. Raises DeviceLost."""
        return str(self._call(self._camera.get_single_config, name).get_value())

    def choices(self, name: str) -> list[str]:
        """Return what a setting can be set to; empty where it is not chosen from a list."""
        widget = self._call(self._camera.get_single_config, name)
        if widget.get_type() not in (self._library.GP_WIDGET_RADIO, self._library.GP_WIDGET_MENU):
            return []
        return [str(entry) for entry in widget.get_choices()]

    def write(self, name: str, value: str) -> str:
        """Set it and return it as read back. Raises DeviceError, DeviceLost."""
        widget = self._call(self._camera.get_single_config, name)
        widget.set_value(value)
        self._call(self._camera.set_single_config, name, widget)
        return self.read(name)

    def capture(self, deadline_s: float) -> tuple[str, bytes]:
        """Release the shutter and return name and bytes of the file. Raises DeviceTimeout, DeviceLost."""
        kind, part = self._library.GP_CAPTURE_IMAGE, self._library.GP_FILE_TYPE_NORMAL
        path = self._call(self._camera.capture, kind, deadline_s=deadline_s)
        file = self._call(self._camera.file_get, path.folder, path.name, part, deadline_s=deadline_s)
        return str(path.name), bytes(memoryview(file.get_data_and_size()))

    def close(self) -> None:
        """Give the camera back; one that is gone needs no goodbye."""
        try:
            self._call(self._camera.exit)
        except DeviceError:
            return
        finally:
            self._thread.close()

    def _call(self, method: Any, *arguments: Any, deadline_s: float = _SETTING_DEADLINE_S) -> Any:
        self._due = time.monotonic() + deadline_s
        try:
            return self._thread.run(method, *arguments)
        except self._library.GPhoto2Error as error:
            raise _translated(error, self._name) from error
        except DeviceLost as error:
            raise DeviceTimeout(f"{self._name}: no answer within {deadline_s:g} s; switch it off and on") from error


def _leaves(widget: Any) -> Iterator[str]:
    """Yield the names of the settings below a part of the tree."""
    parts = list(widget.get_children())
    if not parts:
        yield str(widget.get_name())
    for part in parts:
        yield from _leaves(part)


def _translated(error: Any, name: str) -> DeviceError:
    """Return the project's error for one of the library's."""
    code, text = int(error.code), str(error.string)
    if code in _NOT_FOUND:
        return DeviceNotFound(f"{name} does not answer ({text}); is it on, and its cable in? See `radiometer devices`")
    if code in _IN_USE:
        return DeviceInUse(f"{name} is in use by another program ({text}); file managers take cameras: eject it there")
    if code in _GONE:
        return DeviceLost(f"{name} stopped answering ({text}); check its cable and battery, then open it again")
    return DeviceError(f"{name}: the camera refused ({text})")


@dataclass(frozen=True, slots=True)
class _Dial:
    """A setting that is chosen from a list, and the numbers that its entries mean."""

    name: str
    entries: dict[str, float]

    def nearest(self, value: float) -> str:
        """Return the entry whose number is nearest by ratio."""
        return min(self.entries, key=lambda entry: abs(math.log(self.entries[entry] / value)))


class TetheredLink(FrameLink[GphotoDevice]):
    """One tethered photographic camera, which writes raw files."""

    def __init__(self, identity: CameraIdentity, open_device: Callable[[str], GphotoDevice] = open_device) -> None:
        super().__init__(identity, open_device)
        self._shutter, self._iso = _Dial("", {}), _Dial("", {})
        self._findings: list[Finding] = []
        self._settings = CameraSettings(0.01)

    def _begin(self, device: GphotoDevice) -> CameraSettings:
        names = device.names()
        self._identity = _completed(self._identity, device, names)
        self._shutter = _dial(device, names, _SHUTTERS, seconds_of)
        if not self._shutter.entries:
            raise DeviceError(f"{self._identity.device_id}: its exposure time cannot be set; turn its dial to M")
        self._iso = _dial(device, names, ("iso",), _number_of)
        self._findings = [*_raw_files(device, names), *_falsifiers(device, names)]
        self._set(0.01, 0.0)
        self._limits = self._limits_of(self._photograph(0.01)[0])
        return self.apply(CameraSettings(0.01, pixel_format=self._limits.pixel_formats[0]))

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set exposure time and ISO speed to the nearest that the dials have, and return what they say then."""
        exposure_s, gain_db = self._set(settings.exposure_s, settings.gain_db)
        black_dn = self.capabilities.black_level_dn[0]
        self._settings = CameraSettings(exposure_s, gain_db, black_dn, settings.pixel_format)
        return self._settings

    def start(self) -> None:
        """Do nothing: every frame is a release of the shutter."""

    def stop(self) -> None:
        """Do nothing."""

    def grab(self) -> Grab:
        """Release the shutter and return the green pixels of the raw file."""
        settings = self._settings
        photograph, file = self._photograph(settings.exposure_s)
        return Grab(
            dn=photograph.plane("green"),
            bit_depth=photograph.bit_depth,
            exposure_s=settings.exposure_s,
            gain_db=settings.gain_db,
            black_level_dn=photograph.black_level_dn("green") or 0.0,
            timestamp_s=time.monotonic(),
            f_number=self._f_number(),
            white_level_dn=photograph.white_level_dn,
            file=file,
        )

    def findings(self) -> list[Finding]:
        """Return what still falsifies, and that the exposure times are those its dial means."""
        message = "exposure times are the exact stops behind the dial's numbers; the shutter's own error is not known"
        return [*self._findings, Finding("shutter", Health.NOTE, message, "`radiometer reconcile` finds it")]

    def _set(self, exposure_s: float, gain_db: float) -> tuple[float, float]:
        entry = self._open.write(self._shutter.name, self._shutter.nearest(exposure_s))
        found_s = seconds_of(entry)
        if found_s is None:
            raise DeviceError(f"{self._identity.device_id}: its exposure time is {entry!r}; turn its dial to M")
        if not self._iso.entries:
            return found_s, 0.0
        lowest = min(self._iso.entries.values())
        iso = _number_of(self._open.write("iso", self._iso.nearest(lowest * 10 ** (gain_db / 20))))
        return found_s, round(20 * math.log10((iso or lowest) / lowest), 6)

    def _photograph(self, exposure_s: float) -> tuple[Photograph, CameraFile]:
        name, content = self._open.capture(2 * exposure_s + 30.0)
        if content.startswith(_JPEG_MAGIC):
            raise DeviceError(
                f"{self._identity.device_id}: sends JPEG ({name}), which is no measurement; set its quality to raw"
            )
        suffix = Path(name).suffix.lower()
        kept = CameraFile(suffix if suffix in RAW_SUFFIXES else ".dng", content)
        with tempfile.TemporaryDirectory(prefix="radiometer-") as folder:
            file = Path(folder) / f"frame{kept.suffix}"
            file.write_bytes(content)
            try:
                return read_photograph(file), kept
            except CaptureError as error:
                reason = str(error).removeprefix(f"{file}: ")
                raise DeviceError(f"{self._identity.device_id}: its file {name} cannot be used: {reason}") from error

    def _limits_of(self, photograph: Photograph) -> CameraCapabilities:
        times, speeds = self._shutter.entries.values(), self._iso.entries.values() or (1.0,)
        black_dn = photograph.black_level_dn("green") or 0.0
        height, width = photograph.plane("green").shape
        return CameraCapabilities(
            exposure_s=(min(times), max(times)),
            gain_db=(0.0, round(20 * math.log10(max(speeds) / min(speeds)), 6)),
            black_level_dn=(black_dn, black_dn),
            pixel_formats=(f"Mono{photograph.bit_depth}",),
            width=int(width),
            height=int(height),
        )

    def _f_number(self) -> float | None:
        name = next((name for name in _APERTURES if name in self._open.names()), None)
        stated = _number_of(self._open.read(name).lower().removeprefix("f/").removeprefix("f")) if name else None
        return exact_f_number(stated) if stated else None


def seconds_of(text: str) -> float | None:
    """Return the time in s that a shutter's entry means ("1/125", "0.4", "2.5s"); None for bulb and automatic.

    A dial value is turned into the exact stop behind it, as for photographs.
    """
    words = text.strip().lower().removesuffix("s").strip()
    try:
        above, _, below = words.partition("/")
        seconds = float(above) / float(below or 1)
    except (ValueError, ZeroDivisionError):
        return None
    if not (math.isfinite(seconds) and seconds > 0):
        return None
    return exact_exposure_s(seconds) if is_dial_time(seconds) else seconds


def _completed(identity: CameraIdentity, device: GphotoDevice, names: frozenset[str]) -> CameraIdentity:
    controls = {
        key: device.read(name)
        for key, name in (("vendor", "manufacturer"), ("serial", "serialnumber"), ("firmware", "deviceversion"))
        if name in names
    }
    return replace(identity, **controls)


def _number_of(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) and number > 0 else None


def _dial(
    device: GphotoDevice, names: frozenset[str], candidates: Iterable[str], meaning: Callable[[str], float | None]
) -> _Dial:
    for name in candidates:
        if name in names:
            found = {entry: meaning(entry) for entry in device.choices(name)}
            return _Dial(name, {entry: value for entry, value in found.items() if value is not None})
    return _Dial("", {})


def _raw_files(device: GphotoDevice, names: frozenset[str]) -> list[Finding]:
    """Have the camera write raw files only, where it lets that be chosen."""
    for name in _QUALITIES:
        entries = device.choices(name) if name in names else []
        raw = [entry for entry in entries if any(word in entry.lower() for word in _RAW_WORDS)]
        alone = [entry for entry in raw if not any(word in entry.lower() for word in _JPEG_WORDS)]
        if alone:
            device.write(name, alone[0])
            return []
    return [Finding("raw files", Health.NOTE, "the camera does not let raw files be chosen; choose them at the camera")]


def _falsifiers(device: GphotoDevice, names: frozenset[str]) -> list[Finding]:
    found = []
    for name, harmless, effect in _FALSIFIERS:
        if name not in names or device.read(name).lower() in harmless:
            continue
        harmless_entry = next((entry for entry in device.choices(name) if entry.lower() in harmless), None)
        try:
            now = device.write(name, harmless_entry) if harmless_entry else device.read(name)
        except DeviceLost:
            raise
        except DeviceError:
            now = device.read(name)
        if now.lower() not in harmless:
            found.append(Finding(f"setting {name}", Health.FAULT, f"is {now}: {effect}", "switch it off at the camera"))
    return found

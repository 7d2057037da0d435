"""A photographic camera on a cable: raw files by libgphoto2, their green pixels as frames, times as the dial means."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol

from drivers.cameras.plain_camera import Grab, LibraryLink
from radiometer.data.frame import CameraFile
from radiometer.data.raw_files import RAW_SUFFIXES
from radiometer.devices import CameraCapabilities, CameraIdentity, CameraSettings, Finding, Health
from radiometer.errors import CaptureError, DeviceError, DeviceLost
from radiometer.importing.photograph_pixels import Photograph, read_photograph
from radiometer.importing.photograph_times import is_dial_time
from radiometer.units import exact_exposure_s, exact_f_number

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


class TetheredDevice(Protocol):
    """An open photographic camera, as far as it is used here: settings by name, and files."""

    def names(self) -> frozenset[str]:
        """Return the names of its settings."""

    def read(self, name: str) -> str:
        """Return a setting. Raises DeviceLost."""

    def choices(self, name: str) -> list[str]:
        """Return what a setting can be set to; empty where it is not chosen from a list."""

    def write(self, name: str, value: str) -> str:
        """Set it and return it as read back. Raises DeviceError, DeviceLost."""

    def capture(self, deadline_s: float) -> tuple[str, bytes]:
        """Release the shutter and return name and bytes of the file. Raises DeviceTimeout, DeviceLost."""

    def close(self) -> None:
        """Give the camera back."""


class TetheredLibrary(Protocol):
    """What opens photographic cameras."""

    def open(self, port: str) -> TetheredDevice:
        """Open the camera at a port. Raises DeviceNotFound, DeviceInUse, MissingLibrary."""


@dataclass(frozen=True, slots=True)
class _Dial:
    """A setting that is chosen from a list, and the numbers that its entries mean."""

    name: str
    entries: dict[str, float]

    def nearest(self, value: float) -> str:
        """Return the entry whose number is nearest by ratio."""
        return min(self.entries, key=lambda entry: abs(math.log(self.entries[entry] / value)))


class TetheredLink(LibraryLink[TetheredDevice]):
    """One tethered photographic camera.

    Args:
        identity: Who it is; `device_id` is "gphoto2:" and its port.
    """

    def __init__(self, library: TetheredLibrary, identity: CameraIdentity) -> None:
        super().__init__(identity)
        self._library = library
        self._shutter, self._iso = _Dial("", {}), _Dial("", {})
        self._findings: list[Finding] = []
        self._settings = CameraSettings(0.01)

    def open(self) -> CameraSettings:
        """Take the camera, have it write raw files, and learn size, bits and black level. Raises DeviceError."""
        device = self._device = self._library.open(self._identity.device_id.removeprefix("gphoto2:"))
        try:
            names = device.names()
            self._identity = _completed(self._identity, device, names)
            self._shutter = _dial(device, names, _SHUTTERS, seconds_of)
            if not self._shutter.entries:
                raise DeviceError(f"{self._identity.device_id}: its exposure time cannot be set; turn its dial to M")
            self._iso = _dial(device, names, ("iso",), _number_of)
            self._findings = [*_raw_files(device, names), *_falsifiers(device, names)]
            self._set(0.01, 0.0)
            self._limits = self._limits_of(self._photograph(0.01)[0])
        except BaseException:
            self.close()
            raise
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


def _completed(identity: CameraIdentity, device: TetheredDevice, names: frozenset[str]) -> CameraIdentity:
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
    device: TetheredDevice, names: frozenset[str], candidates: Iterable[str], meaning: Callable[[str], float | None]
) -> _Dial:
    for name in candidates:
        if name in names:
            found = {entry: meaning(entry) for entry in device.choices(name)}
            return _Dial(name, {entry: value for entry, value in found.items() if value is not None})
    return _Dial("", {})


def _raw_files(device: TetheredDevice, names: frozenset[str]) -> list[Finding]:
    """Have the camera write raw files only, where it lets that be chosen."""
    for name in _QUALITIES:
        entries = device.choices(name) if name in names else []
        raw = [entry for entry in entries if any(word in entry.lower() for word in _RAW_WORDS)]
        alone = [entry for entry in raw if not any(word in entry.lower() for word in _JPEG_WORDS)]
        if alone:
            device.write(name, alone[0])
            return []
    return [Finding("raw files", Health.NOTE, "the camera does not let raw files be chosen; choose them at the camera")]


def _falsifiers(device: TetheredDevice, names: frozenset[str]) -> list[Finding]:
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

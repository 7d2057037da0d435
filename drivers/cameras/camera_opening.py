"""Opening a GenICam camera: control, a clean streaming state, and nothing on that falsifies radiometry.

Each question goes to an IPv4 address `attempts` times and waits `timeout_s` for each answer.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any, Final

import structlog

from drivers.cameras.call_thread import CallThread, give_up_in_background
from drivers.cameras.camera_quirks import CameraQuirks, quirks_for
from drivers.cameras.feature_access import (
    FeatureAccess,
    HygieneFinding,
    LinkThroughput,
    Refusal,
    choose_throughput,
    switch_off_falsifiers,
    translated,
)
from drivers.cameras.frame_stream import switch_on_chunks
from drivers.cameras.host_checks import usb_link
from drivers.cameras.pixel_unpacking import MONO_FORMATS, RAW_FORMATS
from drivers.cameras.settings_access import SettingsAccess, bit_depth_of
from radiometer.data import CameraDescription
from radiometer.data.capture_header import same_serial, serial_shown
from radiometer.devices import CameraCapabilities, CameraIdentity, CameraSettings
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceNotFound

GVCP_PORT: Final = 3956  # GigE Vision 2.0: UDP port of the control channel
# GigE Vision 2.0, discovery command: key 0x42, flag "acknowledge", command 0x0002, no payload, request id 1.
_DISCOVERY_COMMAND: Final = struct.pack(">BBHHH", 0x42, 0x01, 0x0002, 0, 1)
_DISCOVERY_ACK: Final = 0x0003  # GigE Vision 2.0, DISCOVERY_ACK
_HEADER: Final = struct.Struct(">HHHH")
_READ_MEMORY_ACK: Final = 0x0085  # GigE Vision 2.0, READMEM_ACK
# READMEM, not READREG: some devices (Aravis's own server) take a register read of the privilege for a heartbeat, and
# asking again and again would keep a controller that died in control for ever.
_CONTROL_PRIVILEGE: Final = 0x0A00
_NAMES: Final = ((0x48, 32), (0x68, 32), (0xD8, 16))  # manufacturer, model, serial number in the acknowledgement
_ASK_CONTROL: Final = struct.pack(">BBHHHIHH", 0x42, 0x01, 0x0084, 8, 2, _CONTROL_PRIVILEGE, 0, 4)


def answers(address: str, attempts: int = 3, timeout_s: float = 0.4, port: int = GVCP_PORT) -> bool:
    """Tell whether a camera at an address acknowledges a discovery command."""
    return _answer(_DISCOVERY_COMMAND, _DISCOVERY_ACK, address, attempts, timeout_s, port) is not None


def is_controlled(address: str, attempts: int = 2, timeout_s: float = 0.4, port: int = GVCP_PORT) -> bool:
    """Tell whether some program controls the camera at an address; False where nothing answers.

    Source: GigE Vision 2.0, control channel privilege register, bits 30 (exclusive) and 31 (control).
    """
    packet = _answer(_ASK_CONTROL, _READ_MEMORY_ACK, address, attempts, timeout_s, port)
    if packet is None or len(packet) < _HEADER.size + 8:
        return False
    (register_address, privilege) = struct.unpack_from(">II", packet, _HEADER.size)
    return bool(register_address == _CONTROL_PRIVILEGE and privilege & 0x3)


def name_at(address: str, attempts: int = 2, timeout_s: float = 0.4, port: int = GVCP_PORT) -> tuple[str, str, str]:
    """Return vendor, model and serial number of the camera at an address; empty where nothing answers."""
    packet = _answer(_DISCOVERY_COMMAND, _DISCOVERY_ACK, address, attempts, timeout_s, port) or b""
    registers = packet[_HEADER.size :]
    vendor, model, serial = (
        registers[at : at + size].split(b"\0")[0].decode("ascii", "replace") for at, size in _NAMES
    )
    return vendor, model, serial


def _answer(command: bytes, request_id: int, address: str, attempts: int, timeout_s: float, port: int) -> bytes | None:
    """Return the acknowledgement of a command; None where none comes."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.settimeout(timeout_s)
        for _ in range(attempts):
            try:
                line.sendto(command, (address, port))
                packet = line.recv(1024)
            except OSError:  # timed out, refused or unreachable: ask again, then take it for gone
                continue
            if len(packet) >= _HEADER.size and _HEADER.unpack_from(packet)[1] == request_id:
                return packet
    return None


_LOG = structlog.get_logger(__name__)

LOOPBACK_PACKET_BYTES: Final = 60_000  # loopback carries 65,536 at once; fewer packets, fewer losses
_TEMPERATURE_AGE_S: Final = 1.0  # a sensor's temperature does not change faster than is worth a register read
_PREFERRED_FORMATS: Final = ("Mono12", "Mono12p", "Mono12Packed", "Mono16", "Mono10", "Mono10p", "Mono8")
# The converter at its full depth (some models start at 10 bits for speed); exposure by its time, not by a line.
_PREPARED_FEATURES: Final = (
    ("AdcBitDepth", "Bit12"),
    ("AcquisitionFrameRateEnable", False),  # a set frame rate would cut the longest exposure
    ("ExposureMode", "Timed"),
    ("GainSelector", "All"),
    ("BlackLevelSelector", "All"),
    ("DeviceTemperatureSelector", "Sensor"),
)
_USB_DEADLINE_S: Final = 5.0  # libusb's own patience with a transfer is endless; an access takes ms
FAKE_ID: Final = "Fake_1"  # Aravis's camera inside the library


def listed_cameras(aravis: ModuleType) -> list[CameraIdentity]:
    """Return the cameras that answer on all network interfaces and USB ports; takes about 1 s."""
    aravis.disable_interface("Fake")
    aravis.update_device_list()
    return [_listed(aravis, index) for index in range(aravis.get_n_devices())]


def find_camera(aravis: ModuleType, name: str | None, discover: Callable[[], list[CameraIdentity]]) -> CameraIdentity:
    """Return who is meant by a name.

    Args:
        aravis: The library's module.
        name: Device id, serial number or IP address; None for the only camera connected.
        discover: Lists the cameras; not called for an address or the fake camera.

    Raises:
        DeviceNotFound: If nothing of that name answers, or several cameras do where none was named.
    """
    if name == FAKE_ID:
        aravis.enable_interface("Fake")
        return CameraIdentity("Aravis", "Fake", "1", FAKE_ID, "Fake")
    if name is not None and _is_address(name):
        return CameraIdentity("", "", "", name, f"GigEVision {name}")
    cameras = discover()
    matching = [camera for camera in cameras if name is None or name in (camera.device_id, camera.serial)]
    if not matching and name is not None:
        matching = [camera for camera in cameras if same_serial(camera.serial, name)]
    if len(matching) == 1:
        return matching[0]
    there = ", ".join(f"{camera.device_id} (serial {serial_shown(camera.serial)})" for camera in cameras) or "none"
    if matching:
        raise DeviceNotFound(f"several cameras answer; name one of them: {there}")
    description = f"camera {name}" if name else "camera"
    raise DeviceNotFound(f"no {description} answers; those that do: {there}; check cable, power and address")


def _listed(aravis: ModuleType, index: int) -> CameraIdentity:
    return CameraIdentity(
        vendor=aravis.get_device_vendor(index) or "",
        model=aravis.get_device_model(index) or "",
        serial=aravis.get_device_serial_nbr(index) or "",
        device_id=aravis.get_device_id(index),
        interface=f"{aravis.get_device_protocol(index)} {aravis.get_device_address(index) or ''}".strip(),
    )


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return "." in name  # a bare number would be a serial


@dataclass(slots=True)
class CameraSession:
    """A camera under our control, with what was read from it."""

    camera: Any  # the `Aravis.Camera`
    features: FeatureAccess  # its features
    access: SettingsAccess  # its settings
    quirks: CameraQuirks  # how its family differs from the standard
    identity: CameraIdentity  # who it is
    opened_by: str  # the id it was opened by
    preset: CameraDescription | None  # what its datasheet says; None where there is none
    hygiene: tuple[HygieneFinding, ...]  # what was found of the falsifying features
    chunk_names: tuple[str, ...]  # chunk values it sends with every frame
    notes: tuple[str, ...]  # what it refused or was changed in while it was opened, for people
    throughput: LinkThroughput | None  # how fast it may send; None where that cannot be set
    settings: CameraSettings  # in force, as read back
    capabilities: CameraCapabilities  # its limits in the pixel format in force
    _temperature: tuple[float, float | None] = field(default=(float("-inf"), None))

    @property
    def label(self) -> str:
        """Return how messages call the camera."""
        return self.access.name

    @property
    def description(self) -> CameraDescription:
        """Return the preset in the digital numbers of the pixel format in force."""
        bits = bit_depth_of(self.settings.pixel_format, self.quirks)
        own = {key: getattr(self.identity, key) for key in ("vendor", "model", "serial")}
        base = self.preset or CameraDescription(bit_depth=bits)
        gain = base.conversion_gain_e_per_dn
        scaled = {
            "bit_depth": bits,
            "conversion_gain_e_per_dn": None if gain is None else gain * 2.0 ** (base.bit_depth - bits),
            "black_level_dn": self.settings.black_level_dn,
            "mosaic": RAW_FORMATS[self.settings.pixel_format].mosaic,
            "binning": str(self.settings.binning),
        }
        return base.model_copy(update={**own, **scaled})

    def reread(self) -> None:
        """Read settings and limits from the camera anew. Raises DeviceError."""
        self.settings = self.access.read()
        self.capabilities = self.access.capabilities(self.settings.pixel_format)

    def temperature_c(self) -> float | None:
        """Return the sensor temperature in °C, at most a second old; None where it reports none."""
        if not self.capabilities.has_temperature:
            return None
        read_at, temperature_c = self._temperature
        if time.monotonic() - read_at > _TEMPERATURE_AGE_S:
            temperature_c = float(self.features.read("DeviceTemperature", float))
            self._temperature = (time.monotonic(), temperature_c)
        return temperature_c

    @property
    def black_level_scale(self) -> float:
        """Return the DN in a unit of the camera's black level, in the pixel format in force."""
        return self.access.black_level_scale(self.settings.pixel_format)

    def slow_down(self) -> bool:
        """Have it send more slowly, and return whether it does; the acquisition must be stopped."""
        return self.throughput is not None and self.throughput.slow_down()

    def is_lost(self) -> bool:
        """Tell whether the camera is known to be gone."""
        return self.features.lost.is_set()

    def require_answer(self) -> None:
        """Ask the camera whether it is there. Raises DeviceLost if it does not answer."""
        if not self.answers():
            raise DeviceLost(f"{self.label} stopped answering; check its cable and power, then open it again")

    def answers(self) -> bool:
        """Tell whether the camera is there, asking it unless it is known to be gone."""
        if not self.is_lost() and not self._pinged():
            self.features.lost.set()
        return not self.is_lost()

    def _pinged(self) -> bool:
        if self.camera.is_gv_device():  # a register read would wait behind the library's heartbeat for 10 s
            return answers(gige_address(self.camera))
        try:
            self.features.read("Width", int)
        except DeviceLost:
            return False
        return True

    def release(self) -> None:
        """Give up control; the camera may be gone already. Raises DeviceError if it refuses."""
        if self.camera.is_gv_device() and not self.is_lost():
            self.features.call(self.camera.get_device().leave_control)


def open_session(
    aravis: Any, library_error: type[Exception], identity: CameraIdentity, preset: CameraDescription | None
) -> CameraSession:
    """Open a camera, reset it and switch off what falsifies radiometry.

    Raises:
        DeviceNotFound: If nothing answers to its name.
        DeviceInUse: If another program holds it.
        DeviceError: If it has no usable pixel format or refuses a write.
    """
    if (address := _gige_address_of(identity)) and is_controlled(address):
        # Asked past the library, which takes 5 s to say so.
        vendor, model, serial = name_at(address)
        known = replace(identity, vendor=vendor, model=model, serial=serial) if serial else identity
        raise DeviceInUse(f"{_named(known)} is in use by another program; close that program and try again")
    camera = _opened(aravis, library_error, identity)
    known = _completed(camera, identity, library_error)
    name = f"camera {known.vendor} {known.model} {known.serial}"
    if camera.is_gv_device() and not camera.get_device().is_controller():
        raise DeviceInUse(f"{name} is in use by another program; close that program and try again")
    features = FeatureAccess(camera, name, library_error, _call_thread(camera, known, name))
    try:
        return _controlled_session(aravis, features, camera, known, identity.device_id, preset)
    except BaseException:
        if features.lost.is_set():
            give_up_in_background(camera, library_error)
        elif camera.is_gv_device():
            with suppress(DeviceError):
                features.call(camera.get_device().leave_control)
        features.close()
        raise


def _controlled_session(
    aravis: Any,
    features: FeatureAccess,
    camera: Any,
    known: CameraIdentity,
    opened_by: str,
    preset: CameraDescription | None,
) -> CameraSession:
    name = f"camera {known.vendor} {known.model} {known.serial}"
    lost = features.lost  # not the session itself: the library would keep it alive
    camera.get_device().connect("control-lost", lambda *_: lost.set())
    info = str(features.read_if_there("DeviceManufacturerInfo", str) or "")
    quirks = quirks_for(known.vendor, known.model, info)
    access = SettingsAccess(camera, features, quirks, name)
    notes: list[str] = []
    hygiene = _prepare(aravis, camera, features, quirks, notes)
    _choose_pixel_format(camera, features, access)
    throughput = choose_throughput(camera, features, name, notes)
    chunk_names = switch_on_chunks(camera, features, notes)
    settings = access.read()
    for noted in notes:
        _LOG.info("camera opened all the same", camera=name, note=noted)
    return CameraSession(
        camera=camera,
        features=features,
        access=access,
        quirks=quirks,
        identity=known,
        opened_by=opened_by,
        preset=preset or quirks.preset_of(known.model),
        hygiene=hygiene,
        chunk_names=chunk_names,
        notes=tuple(notes),
        throughput=throughput,
        settings=settings,
        capabilities=access.capabilities(settings.pixel_format),
    )


def _call_thread(camera: Any, identity: CameraIdentity, name: str) -> CallThread | None:
    """Return the thread for a camera whose calls may never return; None for the one inside the library."""
    if camera.is_gv_device():
        address = gige_address(camera)
        return CallThread(name, lambda: not answers(address))
    if not camera.is_uv_device():
        return None
    seen = usb_link(identity.serial) is not None  # in some containers the kernel's list is hidden
    return CallThread(name, lambda: seen and usb_link(identity.serial) is None, deadline_s=_USB_DEADLINE_S)


def gige_address(camera: Any) -> str:
    """Return the IPv4 address of an open GigE Vision camera."""
    return str(camera.get_device().get_device_address().get_address().to_string())


def _gige_address_of(identity: CameraIdentity) -> str:
    """Return the IPv4 address that a camera is known by before it is opened; "" for any other link."""
    for text in (identity.device_id, identity.interface.rpartition(" ")[2]):
        with suppress(ValueError):
            return str(ipaddress.IPv4Address(text))
    return ""


def _named(identity: CameraIdentity) -> str:
    """Return how messages call a camera that is not open."""
    known = (identity.vendor, identity.model, serial_shown(identity.serial))
    return "camera " + (" ".join(part for part in known if part) or identity.device_id)


def _opened(aravis: Any, library_error: type[Exception], identity: CameraIdentity) -> Any:
    """Return the library's camera; a USB camera that hangs is given up."""
    if _gige_address_of(identity) or identity.device_id == FAKE_ID:
        return _new_camera(aravis, library_error, identity)
    thread = CallThread(_named(identity), lambda: False, deadline_s=2 * _USB_DEADLINE_S)
    try:
        return thread.run(_new_camera, aravis, library_error, identity)
    finally:
        thread.close()


def _new_camera(aravis: Any, library_error: type[Exception], identity: CameraIdentity) -> Any:
    try:
        camera = aravis.Camera.new(identity.device_id)
    except library_error as error:
        raise _not_opened(error, identity) from error
    if camera is None:
        raise DeviceNotFound(f"camera {identity.device_id} does not answer; `radiometer devices` lists those that do")
    return camera


def _not_opened(error: Exception, identity: CameraIdentity) -> DeviceError:
    translated_error = translated(error, f"camera {identity.device_id}")
    if isinstance(translated_error, DeviceInUse):
        return translated_error
    return DeviceNotFound(
        f"camera {identity.device_id} does not answer ({getattr(error, 'message', error)}); "
        "check cable, power and address, `radiometer devices` lists those that do"
    )


def _completed(camera: Any, identity: CameraIdentity, library_error: type[Exception]) -> CameraIdentity:
    features = FeatureAccess(camera, f"camera {identity.device_id}", library_error)
    firmware = features.read_if_there("DeviceFirmwareVersion", str) or features.read_if_there("DeviceVersion", str)
    return replace(
        identity,
        vendor=features.call(camera.get_vendor_name) or identity.vendor,
        model=features.call(camera.get_model_name) or identity.model,
        serial=features.call(camera.get_device_serial_number) or identity.serial,
        firmware=str(firmware or ""),
    )


def _prepare(
    aravis: Any, camera: Any, features: FeatureAccess, quirks: CameraQuirks, notes: list[str]
) -> tuple[HygieneFinding, ...]:
    features.call(camera.stop_acquisition)  # a program that died may have left it streaming
    if quirks.load_default_user_set and features.has("UserSetLoad"):
        _load_default_user_set(features, notes)
    findings = switch_off_falsifiers(features)
    for feature, value in _PREPARED_FEATURES:
        _set_if_offered(features, feature, value, notes)
    features.call(camera.set_acquisition_mode, aravis.AcquisitionMode.CONTINUOUS)
    if camera.is_gv_device():
        _choose_packet_size(camera, features)
    return findings


def _load_default_user_set(features: FeatureAccess, notes: list[str]) -> None:
    try:
        features.write("UserSetSelector", "Default")
        features.execute("UserSetLoad")
    except Refusal as error:
        notes.append(f"the factory's user set was not loaded ({error})")


def _set_if_offered(features: FeatureAccess, feature: str, value: str | bool, notes: list[str]) -> None:
    """Set a feature; one that is locked, or has no such entry, is noted and left as it is."""
    if not features.has(feature) or features.read(feature, type(value)) == value:
        return
    reason = "it took the write and kept its value"
    try:
        if features.write(feature, value) == value:
            return
    except Refusal as error:
        reason = str(error)
    notes.append(f"{feature} stays at {features.read(feature, type(value))}, not {value} ({reason})")


def _choose_packet_size(camera: Any, features: FeatureAccess) -> None:
    if gige_address(camera).startswith("127."):
        features.call(camera.gv_set_packet_size, LOOPBACK_PACKET_BYTES)
    else:
        features.call(camera.gv_auto_packet_size)


def _choose_pixel_format(camera: Any, features: FeatureAccess, access: SettingsAccess) -> None:
    if features.call(camera.get_pixel_format_as_string) in MONO_FORMATS:
        return
    offered = features.call(camera.dup_available_pixel_formats_as_strings)
    usable = [name for name in _PREFERRED_FORMATS if name in offered] or [one for one in RAW_FORMATS if one in offered]
    if not usable:
        raise DeviceError(f"{access.name}: offers no raw pixel format (only {', '.join(offered)})")
    features.call(camera.set_pixel_format_from_string, usable[0])

"""Whether this computer is fit for a machine-vision camera: library, USB permissions, network and socket buffers."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from radiometer.data.capture_header import same_serial, serial_shown
from radiometer.devices import Finding, Health
from radiometer.errors import MissingLibrary

FRAME_BYTES: Final = 1616 * 1240 * 2  # a full Mono12 frame of the target camera
REQUIRED_BUFFER_BYTES: Final = 33_554_432  # several frames; what camera makers' guides set
JUMBO_MTU: Final = 9000  # bytes; what GigE cameras are made for: fewer packets, fewer interrupts
USBFS_MB: Final = 1000  # FLIR's guide for USB3 cameras on Linux
FLIR_USB_VENDOR: Final = "1e10"
USB3_MBIT_S: Final = 5000  # SuperSpeed, USB 3.2 Gen 1
_ETHERNET: Final = "1"  # ARPHRD_ETHER, if_arp.h
_USB3_VISION: Final = ("ef", "05")  # class and subclass of a control interface, USB3 Vision 1.0
_UDEV_RULE: Final = 'SUBSYSTEM=="usb", ATTRS{idVendor}=="1e10", MODE="0660", GROUP="plugdev", TAG+="uaccess"'


def check_host(load: Callable[[], object], root: Path = Path("/")) -> list[Finding]:
    """Return what was found of this computer.

    Args:
        load: Loads the camera library; raises MissingLibrary where it is absent.
        root: Folder that holds /sys, /proc, /etc and /dev.
    """
    return [
        check_library(load),
        check_usb_permissions(root),
        check_usb_memory(root),
        *check_usb_links(root),
        *check_network(root),
        check_socket_buffers(root),
    ]


def check_library(load: Callable[[], object]) -> Finding:
    """Return whether Aravis and PyGObject are there."""
    try:
        library = load()
    except MissingLibrary as error:
        return Finding("library", Health.FAULT, "the camera library cannot be loaded", str(error))
    return Finding("library", Health.OK, f"Aravis {getattr(library, 'version', '')}".strip())


def check_usb_permissions(root: Path) -> Finding:
    """Return whether a USB3 Vision camera of FLIR could be opened by this user."""
    folders = (root / "etc/udev/rules.d", root / "lib/udev/rules.d", root / "usr/lib/udev/rules.d")
    rules = (path for folder in folders if folder.is_dir() for path in sorted(folder.glob("*.rules")))
    known = [path.name for path in rules if FLIR_USB_VENDOR in _text(path).lower()]
    if known:
        return Finding("udev rules", Health.OK, f"USB cameras of FLIR may be opened ({known[0]})")
    cure = f"write the line {_UDEV_RULE} to /etc/udev/rules.d/40-flir.rules, then `udevadm control --reload` and replug"
    if os.geteuid() == 0:
        return Finding(
            "udev rules", Health.NOTE, "no rule for FLIR's USB cameras; root may open them all the same", cure
        )
    return Finding("udev rules", Health.WARNING, "no rule lets users open FLIR's USB cameras", cure)


def check_usb_memory(root: Path) -> Finding:
    """Return whether the kernel gives USB transfers enough memory."""
    file = root / "sys/module/usbcore/parameters/usbfs_memory_mb"
    if not file.is_file():
        return Finding("USB memory", Health.NOTE, "no USB subsystem here; only network cameras can be used")
    limit_mb = int(_text(file) or 0)
    if limit_mb == 0 or limit_mb >= USBFS_MB:  # 0 is "no limit"
        return Finding("USB memory", Health.OK, f"usbfs may hold {limit_mb or 'any number of'} MB")
    cure = f"echo {USBFS_MB} > {file} (at boot: kernel parameter usbcore.usbfs_memory_mb={USBFS_MB})"
    return Finding(
        "USB memory", Health.WARNING, f"usbfs may hold {limit_mb} MB only: frames of USB3 cameras get lost", cure
    )


@dataclass(frozen=True, slots=True)
class UsbLink:
    """How a USB3 Vision camera is connected to this computer: its names, and the speed in Mbit/s that was agreed on."""

    product: str
    serial: str
    mbit_s: float


def usb_links(root: Path = Path("/")) -> list[UsbLink]:
    """Return the USB3 Vision cameras that the kernel sees, whether or not they may be opened."""
    folder = root / "sys/bus/usb/devices"
    devices = sorted(path for path in folder.iterdir() if ":" not in path.name) if folder.is_dir() else []
    return [
        UsbLink(_text(path / "product"), _text(path / "serial"), _number(_text(path / "speed")))
        for path in devices
        if _text(path / "idVendor").lower() == FLIR_USB_VENDOR or _has_vision_interface(folder, path.name)
    ]


def usb_link(serial: str, root: Path = Path("/")) -> UsbLink | None:
    """Return how the camera of a serial number is connected to this computer; None where the kernel sees no such
    one."""
    return next((link for link in usb_links(root) if same_serial(link.serial, serial)), None)


def check_usb_links(root: Path) -> list[Finding]:
    """Return one finding for each USB3 Vision camera: whether it is connected to a port that is fast enough."""
    return [_link_finding(link) for link in usb_links(root)]


def _link_finding(link: UsbLink) -> Finding:
    check = f"USB link {serial_shown(link.serial)}".strip()
    message = f"{link.product or 'USB3 Vision camera'} at {link.mbit_s:g} Mbit/s"
    if link.mbit_s >= USB3_MBIT_S:
        return Finding(check, Health.OK, message)
    cure = "plug it into a USB 3 port (blue, or marked SS) with a USB 3 cable, without a hub in between"
    return Finding(check, Health.WARNING, f"{message}: a USB 2 link, on which it drops frames or sends none", cure)


def _has_vision_interface(folder: Path, device: str) -> bool:
    interfaces = folder.glob(f"{device}:*")
    return any((_text(i / "bInterfaceClass"), _text(i / "bInterfaceSubClass")) == _USB3_VISION for i in interfaces)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


def check_network(root: Path) -> list[Finding]:
    """Return one finding for each Ethernet interface that is up: whether jumbo frames pass."""
    folder = root / "sys/class/net"
    names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    up = [
        name
        for name in names
        if _text(folder / name / "type") == _ETHERNET and _text(folder / name / "operstate") == "up"
    ]
    return [_interface_finding(name, int(_text(folder / name / "mtu") or 0)) for name in up]


def check_socket_buffers(root: Path) -> Finding:
    """Return whether the kernel can hold a full frame that arrives in one burst."""
    limit = socket_buffer_limit(root)
    shown = f"sockets may buffer {limit / 1e6:.1f} MB; a full 12-bit frame has {FRAME_BYTES / 1e6:.1f} MB"
    cure = f"sysctl -w net.core.rmem_max={REQUIRED_BUFFER_BYTES} (keep it in /etc/sysctl.d/90-camera.conf)"
    if limit >= FRAME_BYTES:
        return Finding("socket buffers", Health.OK, shown)
    return Finding("socket buffers", Health.WARNING, f"{shown}: packets of GigE cameras get lost", cure)


def socket_buffer_limit(root: Path = Path("/")) -> int:
    """Return how many bytes a program may have the kernel hold for a socket; 0 where that is not known."""
    return int(_text(root / "proc/sys/net/core/rmem_max") or 0)


def _interface_finding(name: str, mtu: int) -> Finding:
    check = f"network {name}"
    if mtu >= JUMBO_MTU:
        return Finding(check, Health.OK, f"packets of {mtu} bytes pass (jumbo frames)")
    cure = (
        f"ip link set dev {name} mtu {JUMBO_MTU}, if the camera is connected to it and every switch between allows it"
    )
    return Finding(check, Health.NOTE, f"packets of {mtu} bytes at most: more packets per frame, more load", cure)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""

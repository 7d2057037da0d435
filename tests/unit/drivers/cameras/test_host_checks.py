"""Checks of the host and of the network before a camera is opened."""

import socket
import struct
import threading
from types import SimpleNamespace

import pytest

from drivers.cameras import host_checks
from drivers.cameras.camera_opening import answers, is_controlled, name_at
from radiometer.devices import Health
from radiometer.errors import MissingLibrary


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a file below a root of one's own, and that root."""

    def make(path, text):
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
        return tmp_path

    return make


def test_a_missing_library_is_a_fault_with_its_packages():
    """Without the library nothing can be measured; the cure names the packages. One that loads has its version."""

    def absent():
        raise MissingLibrary("apt install gir1.2-aravis-0.8")

    finding = host_checks.check_library(absent)
    assert finding.health is Health.FAULT
    assert "gir1.2-aravis-0.8" in finding.cure
    assert host_checks.check_library(lambda: SimpleNamespace(version="0.8")).message == "Aravis 0.8"


@pytest.mark.parametrize(("user", "health"), [(1000, Health.WARNING), (0, Health.NOTE)])
def test_without_a_udev_rule_the_rule_is_given(tmp_path, monkeypatch, user, health):
    """A user is warned, root is informed, and the cure is the rule itself."""
    monkeypatch.setattr(host_checks.os, "geteuid", lambda: user)
    finding = host_checks.check_usb_permissions(tmp_path)
    assert finding.health is health
    assert 'ATTRS{idVendor}=="1e10"' in finding.cure


@pytest.mark.parametrize(
    ("check", "path", "text", "health"),
    [
        *((host_checks.check_usb_memory, "sys/module/usbcore/parameters/usbfs_memory_mb", f"{mb}\n", health)
          for mb, health in ((16, Health.WARNING), (1000, Health.OK), (0, Health.OK))),
        (host_checks.check_socket_buffers, "proc/sys/net/core/rmem_max", "212992\n", Health.WARNING),
        (host_checks.check_socket_buffers, "proc/sys/net/core/rmem_max", "33554432\n", Health.OK),
        (host_checks.check_usb_permissions, "etc/udev/rules.d/40-flir.rules",
         'SUBSYSTEM=="usb", ATTRS{idVendor}=="1E10", MODE="0666"\n', Health.OK),
    ],
)  # fmt: skip
def test_memory_buffers_and_rules_are_judged(write, check, path, text, health):
    """16 MB are too few for USB3, 0 is no limit; the default buffer holds no frame: the cure is the very command."""
    finding = check(write(path, text))
    assert finding.health is health
    assert "rmem" not in path or finding.cure == "" or "sysctl -w net.core.rmem_max=33554432" in finding.cure


@pytest.mark.parametrize(("mtu", "health"), [("1500", Health.NOTE), ("9000", Health.OK)])
def test_interfaces_that_are_up_are_judged_by_their_mtu(write, mtu, health):
    """Jumbo frames are recommended on interfaces that are up; the others are left out."""
    for name, state in (("eth0", "up"), ("eth1", "down")):
        write(f"sys/class/net/{name}/type", "1\n")
        write(f"sys/class/net/{name}/operstate", state)
        root = write(f"sys/class/net/{name}/mtu", mtu)
    (finding,) = host_checks.check_network(root)
    assert finding.check == "network eth0"
    assert finding.health is health


@pytest.fixture
def usb_camera(write):
    """Return a function that plugs a USB camera into a port of a given speed, and the root it lies below."""

    def plug(speed, vendor="1e10", kind=("ff", "ff")):
        device = "sys/bus/usb/devices/2-1"
        for name, text in (("idVendor", vendor), ("product", "Blackfly S BFS-U3-19S4M"), ("speed", speed)):
            write(f"{device}/{name}", f"{text}\n")
        write(f"{device}:1.0/bInterfaceClass", kind[0])
        write(f"{device}:1.0/bInterfaceSubClass", kind[1])
        return write(f"{device}/serial", "0138C343\n")

    return plug


@pytest.mark.parametrize(("speed", "health"), [("480", Health.WARNING), ("5000", Health.OK), ("10000", Health.OK)])
def test_a_usb3_camera_on_a_usb2_port_is_found(usb_camera, speed, health):
    """480 Mbit/s is a USB 2 link: it is warned of with the camera's number in both notations, and the cure."""
    (finding,) = host_checks.check_usb_links(usb_camera(speed))
    assert finding.health is health
    assert finding.check == "USB link 0138C343 (20497219)"
    assert f"{speed} Mbit/s" in finding.message
    assert ("USB 3 port" in finding.cure) is (health is Health.WARNING)


@pytest.mark.parametrize(("kind", "count"), [(("ef", "05"), 1), (("08", "06"), 0)], ids=["USB3 Vision", "a disk"])
def test_cameras_of_other_makers_are_known_by_their_interface(usb_camera, kind, count):
    """Any USB3 Vision interface is a camera; other USB devices are none of our business."""
    assert len(host_checks.check_usb_links(usb_camera("480", vendor="2bdf", kind=kind))) == count


@pytest.mark.parametrize(("serial", "there"), [("20497219", True), ("0138C343", True), ("0138C344", False)])
def test_the_kernel_is_asked_whether_a_camera_is_plugged_in(usb_camera, serial, there):
    """A camera is looked up by its serial number in either notation."""
    root = usb_camera("5000")
    assert (host_checks.usb_link(serial, root) is not None) is there
    assert host_checks.check_usb_links(root / "elsewhere") == []  # a computer without USB


REGISTERS = bytearray(248)

REGISTERS[0x48:0x4C], REGISTERS[0x68:0x6B], REGISTERS[0xD8:0xE0] = b"FLIR", b"BFS", b"0138C343"


@pytest.fixture
def responder():
    """Return the port of a socket that answers the second discovery command, and what it received."""
    received: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        line.settimeout(5)

        def serve():
            for _ in range(2):
                packet, sender = line.recvfrom(64)
                received.append(packet)
            line.sendto(struct.pack(">HHHH", 0, 0x0003, 248, 1) + bytes(REGISTERS), sender)

        thread = threading.Thread(target=serve)
        thread.start()
        yield line.getsockname()[1], received
        thread.join()


def test_a_camera_that_answers_late_is_there(responder):
    """The question is the discovery command of GigE Vision, and it is asked again when no answer comes."""
    port, received = responder
    assert answers("127.0.0.1", attempts=3, timeout_s=0.3, port=port)
    assert received[0] == bytes.fromhex("4201000200000001")


def test_a_camera_reports_its_name_without_being_opened(responder):
    """Vendor, model and serial number stand in the acknowledgement at their bootstrap registers' places."""
    port, _ = responder
    assert name_at("127.0.0.1", attempts=3, timeout_s=0.3, port=port) == ("FLIR", "BFS", "0138C343")


@pytest.mark.parametrize(
    ("privilege", "address", "controlled"),
    [(0x0, 0x0A00, False), (0x2, 0x0A00, True), (0x1, 0x0A00, True), (0x4, 0x0A00, False), (0x2, 0x0A04, False)],
    ids=["free", "control", "exclusive", "switch-over only", "another register"],
)
def test_a_camera_is_asked_who_controls_it(privilege, address, controlled):
    """The privilege register is read as memory, so that asking is no heartbeat; control and exclusive access count."""
    received = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        line.settimeout(5)

        def serve():
            packet, sender = line.recvfrom(64)
            received.append(packet)
            line.sendto(struct.pack(">HHHHII", 0, 0x0085, 8, 2, address, privilege), sender)

        thread = threading.Thread(target=serve)
        thread.start()
        assert is_controlled("127.0.0.1", attempts=1, timeout_s=2.0, port=line.getsockname()[1]) is controlled
        thread.join()
    assert received == [bytes.fromhex("420100840008000200000a0000000004")]


def test_where_nothing_listens_nothing_is_there_or_controlled():
    """A closed port is no camera, nor one that another program holds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        port = line.getsockname()[1]
    assert not answers("127.0.0.1", attempts=2, timeout_s=0.1, port=port)
    assert not is_controlled("127.0.0.1", attempts=1, timeout_s=0.1, port=port)

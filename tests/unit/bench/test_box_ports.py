"""Only ports that look like a light box are asked, once, with one line."""

from __future__ import annotations

import os
import pty
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.light_box.serial_line import SerialPort
from radiometer.bench import boxes
from radiometer.bench.boxes import candidate_ports, find_boxes, open_light_box, simulated_port_folder
from radiometer.bench.served_box import served_box
from radiometer.errors import DeviceNotFound


@dataclass
class Stranger:
    """A serial device that is no light box: it says nothing and notes what it is sent."""

    port: str
    master: int

    def received(self) -> bytes:
        os.set_blocking(self.master, False)
        try:
            return os.read(self.master, 65536)
        except BlockingIOError:
            return b""


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stranger]:
    """Return such a device; no other port exists, and no one waits for a boot loader."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv(boxes.PORT_VARIABLE, raising=False)
    monkeypatch.setattr("drivers.light_box.box.BOOT_S", 0.01)
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield Stranger(os.ttyname(slave), master)
    os.close(master)
    os.close(slave)


def _plug(monkeypatch: pytest.MonkeyPatch, *ports: SerialPort) -> None:
    monkeypatch.setattr(boxes, "list_serial_ports", lambda: list(ports))


def test_a_foreign_port_never_gets_a_byte(stranger: Stranger, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither by looking for all boxes nor, over and over, for one serial number; the message names the port."""
    _plug(monkeypatch, SerialPort(stranger.port, 0x0403, 0x6001, "FTDI FT232R"), SerialPort("/dev/ttyS0"))
    for _ in range(3):
        assert find_boxes() == ([], [])
        with pytest.raises(DeviceNotFound, match=f"not asked.*{stranger.port}"), open_light_box("BOX00001"):
            pass
    assert stranger.received() == b""


@pytest.mark.parametrize(
    "port",
    [
        SerialPort("/dev/a", 0x2341, 0x0043, "Arduino Uno", "8543"),
        SerialPort("/dev/a", 0x2A03, 0x0043),
        SerialPort("/dev/a", 0x1A86, 0x7523, "radiometer light box", "1"),
        SerialPort("/dev/a"),
    ],
)
def test_no_name_that_usb_gives_makes_a_box(
    stranger: Stranger, monkeypatch: pytest.MonkeyPatch, port: SerialPort
) -> None:
    """Whatever a device calls itself: any Arduino is reset by being asked, and any text can be written into a chip."""
    _plug(monkeypatch, port._replace(device=stranger.port))
    assert find_boxes() == ([], [])
    assert stranger.received() == b""


def test_a_box_is_found_by_itself_once_its_port_was_named(
    stranger: Stranger, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """By its USB serial number, whatever its port is next time; one without a serial number is never known."""
    with served_box("TEST0001", tmp_path / "port").server as served:
        for usb_serial, found in (("8543", 1), ("", 0)):
            uno = SerialPort(served.port, 0x2341, 0x0043, "Arduino Uno", usb_serial)
            _plug(monkeypatch, uno)
            assert candidate_ports() == []
            with open_light_box(served.port) as opened:
                serial = opened.box.identity.serial
            assert candidate_ports() == [served.port] * found
            assert [box.serial for box in find_boxes()[0]] == [serial] * found
    _plug(monkeypatch, SerialPort(stranger.port, 0x2341, 0x0043, "Arduino Uno", "8543"))
    for _ in range(2):
        assert find_boxes() == ([], [])
    assert stranger.received().count(b"\n") == 1  # another program is on it now: asked once, then left alone


def test_the_link_of_a_killed_box_is_no_port(stranger: Stranger, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its terminal has another owner since: nothing is written to it. Two links to one box are one port."""
    _plug(monkeypatch)
    folder = simulated_port_folder()
    folder.mkdir(mode=0o700)
    link = folder / "TWIN0001"
    link.symlink_to(stranger.port)
    assert candidate_ports() == [str(link)]
    (folder / "TWIN0002").symlink_to(stranger.port)
    assert len(candidate_ports()) == 1
    time.sleep(0.2)
    Path(stranger.port).chmod(0o600)  # as a terminal that is made after the link has a later time
    assert candidate_ports() == []


def test_a_port_that_is_named_is_asked(stranger: Stranger, monkeypatch: pytest.MonkeyPatch) -> None:
    """On request any port is asked, as often as its answer takes."""
    _plug(monkeypatch)
    monkeypatch.setattr("drivers.light_box.box.START_UP_S", 0.3)
    with pytest.raises(DeviceNotFound, match="answers as a light box"), open_light_box(stranger.port):
        pass
    assert stranger.received().count(b"\n") > 1
    monkeypatch.setenv(boxes.PORT_VARIABLE, stranger.port)
    assert candidate_ports() == [stranger.port]

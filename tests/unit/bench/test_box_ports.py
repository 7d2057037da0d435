"""Only ports that look like a light box are asked, once, with one line."""

from __future__ import annotations

import os
import pty
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.light_box.serial_line import SerialPort
from radiometer.bench import boxes
from radiometer.bench.boxes import candidate_ports, find_boxes, open_light_box
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
    """Return such a device; no other port exists, and nobody waits for a boot loader."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.delenv(boxes.PORT_VARIABLE, raising=False)
    monkeypatch.setattr("drivers.light_box.box.BOOT_S", 0.01)
    boxes._SILENT.clear()
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


def test_an_arduino_that_is_no_box_is_asked_once(stranger: Stranger, monkeypatch: pytest.MonkeyPatch) -> None:
    """One line, a greeting; then it is left alone until it is plugged in anew."""
    _plug(monkeypatch, SerialPort(stranger.port, 0x2341, 0x0043, "Arduino Uno"))
    for _ in range(3):
        assert find_boxes() == ([], [])
    sent = stranger.received()
    assert (sent.count(b"\n"), b"HI " in sent) == (1, True)
    monkeypatch.setattr(boxes, "_when_plugged", lambda port: 1.0)
    assert find_boxes() == ([], [])
    assert stranger.received().count(b"\n") == 1


@pytest.mark.parametrize(
    ("port", "like"),
    [
        (SerialPort("/dev/a", 0x2341, 0x0043), True),
        (SerialPort("/dev/a", 0x2A03, 0x0043), True),
        (SerialPort("/dev/a", 0x1A86, 0x7523, "radiometer light box"), True),
        (SerialPort("/dev/a", 0x1A86, 0x7523, "USB Serial"), False),
        (SerialPort("/dev/a"), False),
    ],
)
def test_ports_are_known_by_usb(
    stranger: Stranger, monkeypatch: pytest.MonkeyPatch, port: SerialPort, like: bool
) -> None:
    """Vendor ids of Arduino, or a name that says so; a common converter chip says nothing."""
    _plug(monkeypatch, port)
    assert candidate_ports() == (["/dev/a"] if like else [])


def test_a_port_that_is_named_is_asked(stranger: Stranger, monkeypatch: pytest.MonkeyPatch) -> None:
    """On request any port is asked, as often as its answer takes."""
    _plug(monkeypatch)
    monkeypatch.setattr("drivers.light_box.box.START_UP_S", 0.3)
    with pytest.raises(DeviceNotFound, match="answers as a light box"), open_light_box(stranger.port):
        pass
    assert stranger.received().count(b"\n") > 1
    monkeypatch.setenv(boxes.PORT_VARIABLE, stranger.port)
    assert candidate_ports() == [stranger.port]

"""Lines over a serial port, on a pseudo-terminal."""

import os
import threading
import time
import tty
from collections.abc import Iterator

import pytest

from drivers.light_box.serial_line import SerialLine
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceNotFound


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """Return the master side of a pseudo-terminal and the slave's name."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    for handle in (master, slave):
        try:
            os.close(handle)
        except OSError:
            continue


def test_lines_come_one_by_one_with_growing_times(terminal):
    """Two lines in one burst are two lines."""
    master, name = terminal
    line = SerialLine(name)
    line.open()
    os.write(master, b"one\ntwo\nthr")
    first, second = line.read_line(1.0), line.read_line(1.0)
    assert first is not None
    assert second is not None
    assert (first.text, second.text) == (b"one", b"two")
    assert first.time_s <= second.time_s
    assert line.read_line(0.01) is None
    os.write(master, b"ee\n")
    third = line.read_line(1.0)
    assert third is not None
    assert third.text == b"three"
    line.close()


def test_timeout_is_kept(terminal):
    """Nothing within the deadline is None, and not before the time asked for."""
    line = SerialLine(terminal[1])
    line.open()
    start_s = time.monotonic()
    assert line.read_line(0.2) is None
    assert time.monotonic() - start_s > 0.19
    line.close()


def test_endless_garbage_without_line_ends_does_not_grow(terminal):
    """What comes without a line end is cut; the next line is read all the same."""
    master, name = terminal
    line = SerialLine(name)
    line.open()
    writer = threading.Thread(target=lambda: [os.write(master, b"\xff" * 500) for _ in range(20)] and None)
    writer.start()
    assert line.read_line(0.3) is None
    writer.join()
    os.write(master, b"\n=ok\n")
    found = [line.read_line(1.0), line.read_line(1.0)]
    assert found[1] is not None
    assert found[1].text == b"=ok"
    line.close()


@pytest.mark.parametrize(
    ("name", "message"), [("none", "there is no port"), (".", "cannot be opened as a serial port")]
)
def test_what_is_no_serial_port_is_named(tmp_path, name, message):
    """A port that is not there, and what is none."""
    with pytest.raises(DeviceNotFound, match=message):
        SerialLine(str(tmp_path / name)).open()


def test_second_opener_is_refused(terminal):
    """The port is exclusive."""
    line = SerialLine(terminal[1])
    line.open()
    with pytest.raises(DeviceInUse):
        SerialLine(terminal[1]).open()
    line.close()


def test_vanished_port_is_lost():
    """A terminal that goes away while it is read is a lost device."""
    master, slave = os.openpty()
    tty.setraw(slave)
    line = SerialLine(os.ttyname(slave))
    line.open()
    os.close(slave)
    os.close(master)
    with pytest.raises(DeviceLost, match="plug the box in"):
        line.read_line(0.5)
    line.close()


def test_closed_line_says_so(tmp_path):
    """Reading before opening is a plain error."""
    with pytest.raises(DeviceError, match="not open"):
        SerialLine("nowhere").read_line(0.1)

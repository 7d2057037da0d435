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


@pytest.fixture
def line(terminal):
    """Return a line over it, open."""
    made = SerialLine(terminal[1])
    made.open()
    yield made
    made.close()


def test_lines_come_one_by_one_with_growing_times(terminal, line):
    """Two lines in one burst are two lines; nothing within the deadline is None, and not before it is over."""
    os.write(terminal[0], b"one\ntwo\nthr")
    first, second = line.read_line(1.0), line.read_line(1.0)
    assert (first.text, second.text) == (b"one", b"two")
    assert first.time_s <= second.time_s
    start_s = time.monotonic()
    assert line.read_line(0.2) is None
    assert time.monotonic() - start_s > 0.19
    os.write(terminal[0], b"ee\n")
    assert line.read_line(1.0).text == b"three"


def test_endless_garbage_without_line_ends_does_not_grow(terminal, line):
    """What comes without a line end is cut; the next line is read all the same."""
    writer = threading.Thread(target=lambda: [os.write(terminal[0], b"\xff" * 500) for _ in range(20)] and None)
    writer.start()
    assert line.read_line(0.3) is None
    writer.join()
    os.write(terminal[0], b"\n=ok\n")
    assert [line.read_line(1.0), line.read_line(1.0)][1].text == b"=ok"


@pytest.mark.parametrize(
    ("name", "message"), [("none", "there is no port"), (".", "cannot be opened as a serial port")]
)
def test_what_is_no_serial_port_is_named(tmp_path, name, message):
    """A port that is not there, and what is none."""
    with pytest.raises(DeviceNotFound, match=message):
        SerialLine(str(tmp_path / name)).open()


def test_second_opener_is_refused(line):
    """The port is exclusive."""
    with pytest.raises(DeviceInUse):
        SerialLine(line.name).open()


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

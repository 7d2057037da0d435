from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator

import pytest

from drivers.cameras.gige_ping import answers, is_controlled, name_at

REGISTERS = bytearray(248)
REGISTERS[0x48:0x4C], REGISTERS[0x68:0x6B], REGISTERS[0xD8:0xE0] = b"FLIR", b"BFS", b"0138C343"


@pytest.fixture
def responder() -> Iterator[tuple[int, list[bytes]]]:
    """Return the port of a socket that answers the second discovery command, and what it received."""
    received: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        line.settimeout(5)

        def serve() -> None:
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


def test_where_nothing_listens_nothing_is_there():
    """A closed port is no camera."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        port = line.getsockname()[1]
    assert not answers("127.0.0.1", attempts=2, timeout_s=0.1, port=port)


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

        def serve() -> None:
            packet, sender = line.recvfrom(64)
            received.append(packet)
            line.sendto(struct.pack(">HHHHII", 0, 0x0085, 8, 2, address, privilege), sender)

        thread = threading.Thread(target=serve)
        thread.start()
        assert is_controlled("127.0.0.1", attempts=1, timeout_s=2.0, port=line.getsockname()[1]) is controlled
        thread.join()
    assert received == [bytes.fromhex("420100840008000200000a0000000004")]


def test_where_nothing_answers_nothing_is_controlled():
    """A silent address is not taken for a camera that another program holds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        port = line.getsockname()[1]
    assert not is_controlled("127.0.0.1", attempts=1, timeout_s=0.1, port=port)

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator

import pytest

from drivers.gige_ping import answers


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
            line.sendto(struct.pack(">HHHH", 0, 0x0003, 248, 1) + bytes(248), sender)

        thread = threading.Thread(target=serve)
        thread.start()
        yield line.getsockname()[1], received
        thread.join()


def test_a_camera_that_answers_late_is_there(responder):
    """The question is the discovery command of GigE Vision, and it is asked again when no answer comes."""
    port, received = responder
    assert answers("127.0.0.1", attempts=3, timeout_s=0.3, port=port)
    assert received[0] == bytes.fromhex("4201000200000001")


def test_where_nothing_listens_nothing_is_there():
    """A closed port is no camera."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        port = line.getsockname()[1]
    assert not answers("127.0.0.1", attempts=2, timeout_s=0.1, port=port)

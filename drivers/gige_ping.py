"""Asks a GigE Vision camera whether it is there, without taking control of it."""

from __future__ import annotations

import socket
import struct
from typing import Final

GVCP_PORT: Final = 3956
# GigE Vision 2.0, discovery command: key 0x42, flag "acknowledge", command 0x0002, no payload, request id 1.
_DISCOVERY_COMMAND: Final = struct.pack(">BBHHH", 0x42, 0x01, 0x0002, 0, 1)
_DISCOVERY_ACK: Final = 0x0003
_HEADER: Final = struct.Struct(">HHHH")


def answers(address: str, attempts: int = 3, timeout_s: float = 0.4, port: int = GVCP_PORT) -> bool:
    """Tell whether a camera at an address acknowledges a discovery command.

    Args:
        address: IPv4 address.
        attempts: Commands sent before giving up.
        timeout_s: Longest wait for each answer in s.
        port: UDP port of its control channel.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.settimeout(timeout_s)
        for _ in range(attempts):
            try:
                line.sendto(_DISCOVERY_COMMAND, (address, port))
                if _is_acknowledgement(line.recv(1024)):
                    return True
            except OSError:  # timed out, refused or unreachable: ask again, then take it for gone
                continue
    return False


def _is_acknowledgement(packet: bytes) -> bool:
    return len(packet) >= _HEADER.size and _HEADER.unpack_from(packet)[1] == _DISCOVERY_ACK

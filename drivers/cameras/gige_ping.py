"""Asks a GigE Vision camera whether it is there, without taking control of it.

Each question goes to an IPv4 address `attempts` times and waits `timeout_s` for each answer.
"""

from __future__ import annotations

import socket
import struct
from typing import Final

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

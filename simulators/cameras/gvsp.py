"""Sends pictures over GigE Vision's stream protocol, with or without chunks: what Aravis's own server cannot send.

Source: GigE Vision 2.0, GVSP: image leader, payload and trailer packets; bit 14 of the payload type announces chunks.
"""

from __future__ import annotations

import socket
import struct
from dataclasses import dataclass
from typing import Final

_LEADER, _TRAILER, _PAYLOAD = 1, 2, 3  # GVSP packet formats
_IMAGE: Final = 0x0001  # GVSP payload type
_WITH_CHUNKS: Final = 0x4000  # bit of the payload type: chunks follow
_PROTOCOL_BYTES: Final = 20 + 8 + 8  # IP, UDP and GVSP headers: what a packet size counts in addition to the picture
_LAST_FRAME_ID: Final = 65535  # 16 bits; 0 is reserved
IMAGE_CHUNK: Final = 0x05040001  # identifier of the chunk that holds the picture


@dataclass(frozen=True, slots=True)
class WirePicture:
    """A picture as it is sent."""

    format_code: int  # PFNC value
    width: int  # width in pixels
    height: int  # height in pixels
    x: int  # left edge of the region
    y: int  # top edge of the region
    image: bytes  # bytes of the pixels
    # Raw values by chunk identifier, sent behind the pixels as signed 32-bit numbers; None for no chunks
    chunks: dict[int, int] | None
    timestamp_ns: int  # time of the camera's clock in ns


def payload_of(picture: WirePicture) -> bytes:
    """Return the bytes of pixels and chunks; each chunk's identifier and size stand behind it."""
    if picture.chunks is None:
        return picture.image
    parts = [picture.image, struct.pack(">II", IMAGE_CHUNK, len(picture.image))]
    parts += [struct.pack("<i", raw) + struct.pack(">II", number, 4) for number, raw in picture.chunks.items()]
    return b"".join(parts)


class GvspSender:
    """The stream channel of a simulated camera.

    Args:
        first_frame_id: Number of the first frame, 1 to 65535; numbers start again at 1 behind the last.
    """

    def __init__(self, address: str, first_frame_id: int = 1) -> None:
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._line.bind((address, 0))
        self._frame_id = first_frame_id

    def send(self, picture: WirePicture, to: tuple[str, int], packet_bytes: int, *, lose_last: bool = False) -> None:
        """Send one picture.

        Args:
            lose_last: Keep the last packet of pixels back, as a switch does whose memory is full.
        """
        kind = _IMAGE | (_WITH_CHUNKS if picture.chunks is not None else 0)
        payload, room = payload_of(picture), max(packet_bytes - _PROTOCOL_BYTES, 1)
        blocks = [payload[at : at + room] for at in range(0, len(payload), room)]
        leader = struct.pack(
            ">HHQIIIIIHH", 0, kind, picture.timestamp_ns, picture.format_code, picture.width, picture.height,
            picture.x, picture.y, 0, 0,
        )  # fmt: skip
        self._send_packet(_LEADER, 0, leader, to)
        for number, block in enumerate(blocks[:-1] if lose_last else blocks, 1):
            self._send_packet(_PAYLOAD, number, block, to)
        self._send_packet(_TRAILER, len(blocks) + 1, struct.pack(">HHI", 0, kind, picture.height), to)
        self._frame_id = self._frame_id % _LAST_FRAME_ID + 1

    def close(self) -> None:
        """Close the channel."""
        self._line.close()

    def _send_packet(self, content: int, number: int, body: bytes, to: tuple[str, int]) -> None:
        head = struct.pack(">HHI", 0, self._frame_id, content << 24 | number)
        self._line.sendto(head + body, to)

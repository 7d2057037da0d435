"""As much of an MQTT broker as one publisher needs, in this process: it can be deaf, late, and speak for others."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from fnmatch import fnmatch


class Broker:
    """As much of MQTT 3.1.1 as one publisher needs, on a loopback socket; deaf, it acknowledges nothing."""

    def __init__(self):
        self.retained = {}
        self.published = []
        self.deaf = False
        self._writers = []
        self._unanswered = []

    def hear(self):
        """Acknowledge what was published while deaf, and all from now on."""
        self.deaf = False
        for answer in self._unanswered:
            answer()
        self._unanswered.clear()

    def announce(self, topic, payload):
        """Publish a last will, or what comes late, to everybody: not as retained, for they listen already."""
        self.retained[topic] = payload
        for writer in self._writers:
            _send(writer, topic, payload, retained=False)

    async def serve(self, reader, writer):
        self._writers.append(writer)
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                kind, length, shift = (await reader.readexactly(1))[0], 0, 0
                while True:
                    digit = (await reader.readexactly(1))[0]
                    length, shift = length | (digit & 127) << shift, shift + 7
                    if digit < 128:
                        break
                self._take(kind, await reader.readexactly(length), writer)
        writer.close()

    def _take(self, kind, body, writer):
        if kind >> 4 == 1:
            writer.write(b"\x20\x02\x00\x00")
        elif kind >> 4 == 8:
            writer.write(b"\x90\x03" + body[:2] + b"\x01")
            asked = body[4 : 4 + int.from_bytes(body[2:4], "big")].decode()
            for topic, payload in self.retained.items():
                if not fnmatch(topic, asked.replace("+", "*")):
                    continue
                _send(writer, topic, payload)
        elif kind >> 4 == 3:
            end = 2 + int.from_bytes(body[:2], "big")
            topic, identity, payload = body[2:end].decode(), body[end : end + 2], body[end + 2 :]
            self.published.append((topic, payload))
            self.retained[topic] = payload
            if not payload:
                del self.retained[topic]
            answer = lambda: writer.write(b"\x40\x02" + identity)  # noqa: E731
            self._unanswered.append(answer) if self.deaf else answer()
        elif kind >> 4 == 12:
            writer.write(b"\xd0\x00")


def _send(writer, topic, payload, *, retained=True):
    name = topic.encode()
    content = len(name).to_bytes(2, "big") + name + payload
    writer.write((b"\x31" if retained else b"\x30") + _varint(len(content)) + content)


def _varint(number):
    return bytes([number]) if number < 128 else bytes([number & 127 | 128]) + _varint(number >> 7)

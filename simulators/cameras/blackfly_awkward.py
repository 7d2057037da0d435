"""A simulated Blackfly S as awkward as the real one, behind the real GigE Vision protocol.

It offers no plain Mono12. Its serial number is hexadecimal. Two frames after a change of exposure, gain or black level
are still exposed under the settings before, and their chunks say so; exposure times are whole µs; Mono16 holds 12
bits at the top. Running numbers are at their 16-bit end. Its frame rate is on and locked. It draws a test pattern as
it arrives. Whoever lets it send faster than its link carries gets no frame whole.

Sources: FLIR's descriptions of BFS-PGE-19S4 and BFS-U3-161S7; AravisProject/aravis issues 312, 492, 1045. GigE Vision
2.0, GVSP: image leader, payload and trailer packets; bit 14 of the payload type announces chunks.
"""

from __future__ import annotations

import socket
import struct
import time
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from radiometer.data.frame import DigitalNumbers
from radiometer.devices import CameraCapabilities
from radiometer.errors import RadiometerError
from simulators.cameras import blackfly_features as registers
from simulators.cameras.aravis_fake_device import FakeGigeDevice
from simulators.cameras.blackfly_features import WIRE_FORMATS, Feature, blackfly_features, pack_pixels
from simulators.cameras.blackfly_gige import (
    BlackflyGige,
    PictureRequest,
    PictureSource,
    SentPicture,
    is_acquiring,
    processed,
    read_request,
)

SERIAL: Final = "0138C343"  # as USB reports 20497219
MODEL: Final = "Blackfly S BFS-PGE-19S4M"
PIPELINE_FRAMES: Final = 2  # one exposed, one read out, when a setting changes
_ADC_BITS: Final = 12  # Sony IMX sensors of the series convert to 12
_MADE_UNDER: Final = ("exposure_s", "gain_db", "black_level_dn")
_LOOK_S: Final = 0.002  # short against the shortest frame
FORMATS: Final = ("Mono8", "Mono16", "Mono10p", "Mono12Packed", "Mono12p")  # no plain Mono10, Mono12
_FAMILY_FORMATS: Final = {"BayerRG8": 0x01080009, "RGB8Packed": 0x02180014}  # described, but not of this model
EXPOSURE_WHOLE_US, TEST_PATTERN, TEST_PATTERN_SELECTOR = 0x5000, 0x5008, 0x5018
CHUNK_MODE, CHUNK_SELECTOR, CHUNK_ENABLE = 0x5020, 0x5024, 0x5040
LINK_SPEED, THROUGHPUT_LIMIT = 0x5030, 0x5034
USER_SET_SELECTOR, USER_SET_LOAD, ADC_BITS = 0x5100, 0x5104, 0x5108
# GigE Vision's bootstrap registers of the first stream channel.
STREAM_PORT, STREAM_PACKET, STREAM_ADDRESS = 0x0D00, 0x0D04, 0x0D18

CHUNK_ENTRIES: Final = {"Image": 0, "CRC": 1, "FrameID": 2, "ExposureTime": 7, "Gain": 8, "BlackLevel": 9}
CHUNK_IDS: Final = {"ExposureTime": 0x05040008, "Gain": 0x05200009, "BlackLevel": 0x0504000B}
GAIN_DB_PER_RAW: Final = 6.020599913 / 2**14
BLACK_PERCENT_PER_RAW: Final = 100 / 2**24
_CHUNK_FORMULAS: Final = {
    "ExposureTime": ("RAW*1", "us"),
    "Gain": ("RAW*6.020599913/(2**14)", "dB"),
    "BlackLevel": ("RAW/(2**24)*100", "%"),
}
GIGABIT_BYTES_S: Final = 125_000_000  # 1 Gbit/s in bytes
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


def awkward_features(limits: CameraCapabilities, native_bit_depth: int, temperature_c: float) -> list[Feature]:
    """Return the features of the awkward camera; arguments as of `blackfly_features`."""
    plain = blackfly_features(replace(limits, pixel_formats=FORMATS), native_bit_depth, temperature_c)
    return [*(_made_awkward(feature) for feature in plain), *_further(), *_chunks()]


def _made_awkward(feature: Feature) -> Feature:
    if feature.name == "ExposureTime":  # a register of whole µs
        low, high = round(float(feature.minimum or 0)), round(float(feature.maximum or 0))
        return replace(feature, address=EXPOSURE_WHOLE_US, whole=True, minimum=low, maximum=high, initial=10_000)
    if feature.name == "AcquisitionFrameRateEnable":  # on, and refused by whoever wants it off
        return replace(feature, initial=1, access="RO")
    if feature.name == "AcquisitionFrameRate":
        return replace(feature, initial=131.0)
    if feature.name == "PixelFormat":
        codes = {name: WIRE_FORMATS[name].code for name in FORMATS} | _FAMILY_FORMATS
        return replace(feature, entries=codes, absent=frozenset(_FAMILY_FORMATS))
    if feature.name == "PayloadSize":
        chunks = {f"C{number}": f"{name}ChunkOn" for number, name in enumerate(CHUNK_IDS)}
        size = f"{feature.formula} + A * (8 + 12 * ({' + '.join(chunks)}))"
        return replace(feature, formula=size, variables={**feature.variables, "A": "ChunkModeActiveWord", **chunks})
    return feature


def _further() -> list[Feature]:
    sets, bits = {"Default": 0, "UserSet0": 31, "UserSet1": 30}, {"Bit10": 1, "Bit12": 2}
    patterns = {"Off": 0, "Increment": 1, "SensorTestPattern": 3}
    return [
        Feature("UserSetSelector", "UserSetControl", "enumeration", USER_SET_SELECTOR, entries=sets, initial=0),
        Feature("UserSetLoad", "UserSetControl", "command", USER_SET_LOAD),
        Feature("AdcBitDepth", "ImageFormatControl", "enumeration", ADC_BITS, entries=bits, initial=1),
        Feature("TestPatternGeneratorSelector", "ImageFormatControl", "enumeration", TEST_PATTERN_SELECTOR,
                entries={"Sensor": 0, "PipelineStart": 1}, initial=0),
        Feature("TestPattern", "ImageFormatControl", "enumeration", TEST_PATTERN, entries=patterns,
                selected_by="TestPatternGeneratorSelectorRegister"),
        Feature("PipelinePattern", "", "integer", TEST_PATTERN + 4, initial=1),
        Feature("DeviceLinkSpeed", "DeviceControl", "integer", LINK_SPEED, access="RO", initial=GIGABIT_BYTES_S),
        Feature("DeviceLinkThroughputLimit", "DeviceControl", "integer", THROUGHPUT_LIMIT, minimum=1_000_000,
                maximum=GIGABIT_BYTES_S, initial=GIGABIT_BYTES_S),
    ]  # fmt: skip


def _chunks() -> list[Feature]:
    category = "ChunkDataControl"
    words = [
        Feature(f"{name}ChunkOn", "", "integer", CHUNK_ENABLE + 4 * CHUNK_ENTRIES[name], initial=0)
        for name in CHUNK_IDS
    ]
    locks = {"SEL": "ChunkSelectorRegister"}
    return [
        Feature("ChunkModeActive", category, "boolean", CHUNK_MODE, initial=0),
        Feature("ChunkModeActiveWord", "", "integer", CHUNK_MODE),
        Feature("ChunkSelector", category, "enumeration", CHUNK_SELECTOR, entries=CHUNK_ENTRIES, initial=0),
        Feature("ChunkEnableLocked", "", "formula", 0, formula="SEL < 2 ? 1 : 0", variables=locks),
        Feature("ChunkEnable", category, "boolean", CHUNK_ENABLE, selected_by="ChunkSelectorRegister",
                locked_by="ChunkEnableLocked"),
        *words,
        *(
            Feature(f"Chunk{name}", category, "chunk", 0, unit=unit, formula=formula, chunk_id=f"{CHUNK_IDS[name]:08X}")
            for name, (formula, unit) in _CHUNK_FORMULAS.items()
        ),
    ]  # fmt: skip


class AwkwardBlackfly(BlackflyGige):
    """Serves the awkward camera until it is closed.

    Args:
        limits: What the camera can do; pixel formats are its own.
        first_frame_id: Number of the first frame; the numbers start again at 1 behind 65535.
        link_bytes_s: What its link carries; above that every frame loses a packet.
        **options: As of `BlackflyGige`.
    """

    def __init__(
        self,
        source: PictureSource,
        limits: CameraCapabilities,
        *,
        serial: str = SERIAL,
        first_frame_id: int = 65534,
        link_bytes_s: int = 118_000_000,
        **options: Any,
    ) -> None:
        super().__init__(source, limits, **{"model": MODEL, **options}, serial=serial)
        self._info = ""  # nothing distinguishes it from a real one
        self._link_bytes_s, self._first_frame_id = link_bytes_s, first_frame_id
        self._pipeline: deque[PictureRequest] = deque()
        self._sender: GvspSender | None = None
        self.exposed_s: list[float] = []
        self.frames_cut = 0  # from which its link lost a packet

    def open(self) -> None:
        self._sender = GvspSender(self._address, self._first_frame_id)
        self._pipeline.clear()
        super().open()
        if self._device is not None:  # what it was left with when it was switched on
            self._pipeline.extend([_read_request(self._device)[0]] * PIPELINE_FRAMES)

    def close(self) -> None:
        super().close()
        sender, self._sender = self._sender, None
        if sender is not None:
            sender.close()

    def _features(self) -> list[Feature]:
        return awkward_features(self._limits, self._native_bits, self._temperature_c)

    def _expose(self, device: FakeGigeDevice) -> None:
        """Make a picture under the settings of two frames ago, wait for its exposure, and send it."""
        begin_s = time.monotonic()
        picture = self._picture(device)
        while not self._closing.is_set() and is_acquiring(device):
            left_s = self._period_s(device, picture.made_under) - (time.monotonic() - begin_s)
            if left_s <= 0:
                self._send(device, picture)
                return
            self._closing.wait(min(left_s, 10 * _LOOK_S))
        self._pipeline.appendleft(picture.made_under)  # it was never read out
        self._pipeline.pop()

    def _picture(self, device: FakeGigeDevice) -> SentPicture:
        asked = _read_request(device)
        self._pipeline.append(asked[0])
        held = self._pipeline.popleft()
        request = replace(asked[0], **{name: getattr(held, name) for name in _MADE_UNDER})
        format_name = asked[1]
        try:
            dn = _drawn(device, processed(device, self.source(request), request), request)
        except RadiometerError as error:
            self.failure = error
            dn = np.zeros((request.height, request.width), np.uint16)
        shifted = dn.astype(np.uint16) << np.uint16(16 - _ADC_BITS) if format_name == "Mono16" else dn
        return SentPicture(asked, pack_pixels(shifted, format_name), float(dn.mean()), request)

    def _send(self, device: FakeGigeDevice, picture: SentPicture) -> None:
        sender, made_under, wire = self._sender, picture.made_under, WIRE_FORMATS[picture.asked[1]]
        to = (socket.inet_ntoa(struct.pack(">I", device.read_word(STREAM_ADDRESS))),
              device.read_word(STREAM_PORT) & 0xFFFF)  # fmt: skip
        if sender is None or to[1] == 0:
            return
        place = (made_under.width, made_under.height, made_under.x, made_under.y)
        chunks = _chunk_values(device, made_under)
        sent = WirePicture(wire.code, *place, picture.payload, chunks, time.monotonic_ns())
        too_fast = device.read_word(THROUGHPUT_LIMIT) > self._link_bytes_s
        self.frames_sent += 1  # before it arrives: whoever gets it may look at once
        self.frames_cut += too_fast
        self.exposed_s.append(made_under.exposure_s)
        sender.send(sent, to, device.read_word(STREAM_PACKET) & 0xFFFF, lose_last=too_fast)


def _read_request(device: FakeGigeDevice) -> tuple[PictureRequest, str]:
    request, format_name = read_request(device)
    bits = min(request.bit_depth, _ADC_BITS)
    black_dn = device.read_float(registers.BLACK_LEVEL_PERCENT) / 100 * ((1 << bits) - 1)
    exposure_s = device.read_word(EXPOSURE_WHOLE_US) * 1e-6
    return replace(request, bit_depth=bits, black_level_dn=black_dn, exposure_s=exposure_s), format_name


def _drawn(device: FakeGigeDevice, dn: DigitalNumbers, request: PictureRequest) -> DigitalNumbers:
    """Return a ramp in the place of the picture while either test pattern is on."""
    if not (device.read_word(TEST_PATTERN) or device.read_word(TEST_PATTERN + 4)):
        return dn
    return (np.arange(dn.size).reshape(dn.shape) % (1 << request.bit_depth)).astype(np.uint16)


def _chunk_values(device: FakeGigeDevice, made_under: PictureRequest) -> dict[int, int] | None:
    if not device.read_word(CHUNK_MODE):
        return None
    percent = 100 * made_under.black_level_dn / ((1 << made_under.bit_depth) - 1)
    raw = {
        "ExposureTime": round(made_under.exposure_s * 1e6),
        "Gain": round(made_under.gain_db / GAIN_DB_PER_RAW),
        "BlackLevel": round(percent / BLACK_PERCENT_PER_RAW),
    }
    is_on = {name: device.read_word(CHUNK_ENABLE + 4 * CHUNK_ENTRIES[name]) for name in raw}
    return {CHUNK_IDS[name]: value for name, value in raw.items() if is_on[name]}

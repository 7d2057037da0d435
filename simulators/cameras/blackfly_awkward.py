"""A simulated Blackfly S as awkward as the real one, behind the real GigE Vision protocol.

It offers no plain Mono12. Its serial number is hexadecimal. Two frames after a change of exposure, gain or black level
are still exposed under the settings before, and their chunks say so; exposure times are whole µs; Mono16 holds 12
bits at the top. Running numbers are at their 16-bit end. Its frame rate is on and locked. It draws a test pattern as
it arrives. Whoever lets it send faster than its link carries gets no frame whole.
"""

from __future__ import annotations

import socket
import struct
import time
from collections import deque
from dataclasses import replace
from typing import Any, Final

import numpy as np

from radiometer.data.frame import DigitalNumbers
from radiometer.devices import CameraCapabilities
from radiometer.errors import RadiometerError
from simulators.cameras import awkward_features as awkward
from simulators.cameras import blackfly_features as registers
from simulators.cameras.aravis_fake_device import FakeGigeDevice
from simulators.cameras.awkward_features import awkward_features
from simulators.cameras.blackfly_gige import BlackflyGige, SentPicture
from simulators.cameras.blackfly_pictures import PictureRequest, PictureSource
from simulators.cameras.blackfly_registers import is_acquiring, processed, read_request
from simulators.cameras.genicam_document import Feature
from simulators.cameras.gvsp import GvspSender, WirePicture
from simulators.cameras.pixel_packing import WIRE_FORMATS, pack_pixels

SERIAL: Final = "0138C343"  # as USB reports 20497219
MODEL: Final = "Blackfly S BFS-PGE-19S4M"
PIPELINE_FRAMES: Final = 2  # one exposed, one read out, when a setting changes
_ADC_BITS: Final = 12  # Sony IMX sensors of the series convert to 12
_MADE_UNDER: Final = ("exposure_s", "gain_db", "black_level_dn")
_LOOK_S: Final = 0.002  # short against the shortest frame


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
        """Serve the camera. Raises DeviceInUse if the address is taken, MissingLibrary without Aravis."""
        self._sender = GvspSender(self._address, self._first_frame_id)
        self._pipeline.clear()
        super().open()
        if self._device is not None:  # what it was left with when it was switched on
            self._pipeline.extend([_read_request(self._device)[0]] * PIPELINE_FRAMES)

    def close(self) -> None:
        """Leave the network; closing twice does nothing."""
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
            dn = _drawn(device, processed(device, self._source(request), request), request)
        except RadiometerError as error:
            self.failure = error
            dn = np.zeros((request.height, request.width), np.uint16)
        shifted = dn.astype(np.uint16) << np.uint16(16 - _ADC_BITS) if format_name == "Mono16" else dn
        return SentPicture(asked, pack_pixels(shifted, format_name), float(dn.mean()), request)

    def _send(self, device: FakeGigeDevice, picture: SentPicture) -> None:
        sender, made_under, wire = self._sender, picture.made_under, WIRE_FORMATS[picture.asked[1]]
        to = (socket.inet_ntoa(struct.pack(">I", device.read_word(awkward.STREAM_ADDRESS))),
              device.read_word(awkward.STREAM_PORT) & 0xFFFF)  # fmt: skip
        if sender is None or to[1] == 0:
            return
        sent = WirePicture(
            wire.code,
            made_under.width,
            made_under.height,
            made_under.x,
            made_under.y,
            picture.payload,
            _chunk_values(device, made_under),
            time.monotonic_ns(),
        )
        too_fast = device.read_word(awkward.THROUGHPUT_LIMIT) > self._link_bytes_s
        self.frames_sent += 1  # before it arrives: whoever gets it may look at once
        self.frames_cut += too_fast
        self.exposed_s.append(made_under.exposure_s)
        sender.send(sent, to, device.read_word(awkward.STREAM_PACKET) & 0xFFFF, lose_last=too_fast)


def _read_request(device: FakeGigeDevice) -> tuple[PictureRequest, str]:
    request, format_name = read_request(device)
    bits = min(request.bit_depth, _ADC_BITS)
    black_dn = device.read_float(registers.BLACK_LEVEL_PERCENT) / 100 * ((1 << bits) - 1)
    exposure_s = device.read_word(awkward.EXPOSURE_WHOLE_US) * 1e-6
    return replace(request, bit_depth=bits, black_level_dn=black_dn, exposure_s=exposure_s), format_name


def _drawn(device: FakeGigeDevice, dn: DigitalNumbers, request: PictureRequest) -> DigitalNumbers:
    """Return a ramp in the place of the picture while either test pattern is on."""
    if not (device.read_word(awkward.TEST_PATTERN) or device.read_word(awkward.TEST_PATTERN + 4)):
        return dn
    return (np.arange(dn.size).reshape(dn.shape) % (1 << request.bit_depth)).astype(np.uint16)


def _chunk_values(device: FakeGigeDevice, made_under: PictureRequest) -> dict[int, int] | None:
    if not device.read_word(awkward.CHUNK_MODE):
        return None
    percent = 100 * made_under.black_level_dn / ((1 << made_under.bit_depth) - 1)
    raw = {
        "ExposureTime": round(made_under.exposure_s * 1e6),
        "Gain": round(made_under.gain_db / awkward.GAIN_DB_PER_RAW),
        "BlackLevel": round(percent / awkward.BLACK_PERCENT_PER_RAW),
    }
    is_on = {name: device.read_word(awkward.CHUNK_ENABLE + 4 * awkward.CHUNK_ENTRIES[name]) for name in raw}
    return {awkward.CHUNK_IDS[name]: value for name, value in raw.items() if is_on[name]}

"""A simulated Blackfly S behind the real GigE Vision protocol, its pictures made by the forward model.

    with BlackflyGige(ForwardModelSource(sensor), limits, serial="22500001") as served:
        ...                                      # any GenICam program now finds it at 127.0.0.1

As shipped, a Blackfly has automatic exposure, gamma and sharpening switched on, and so has this one: whoever measures
with it must switch them off. Methods set its faults, or its SimulatorControl features over the wire.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import structlog

from radiometer.devices import CameraCapabilities
from radiometer.devices.opening import Opened
from radiometer.errors import RadiometerError
from simulators.cameras import blackfly_features as registers
from simulators.cameras.aravis_fake_device import FakeGigeDevice
from simulators.cameras.blackfly_pictures import PictureRequest, PictureSource
from simulators.cameras.blackfly_registers import is_acquiring, processed, read_request, steer_exposure
from simulators.cameras.genicam_document import Feature, genicam_xml
from simulators.cameras.pixel_packing import WIRE_FORMATS, pack_pixels

_LOG = structlog.get_logger(__name__)

READOUT_S: Final = 1 / 131  # 131 frames per second at full size: BFS-U3-19S4M specification page
_TRIGGER_LOOKS_HZ: Final = 400.0  # the device waits in whole ms and spins for the rest
_LOOK_S: Final = 0.002  # short against the shortest frame
INFO_TEXT: Final = "simulated by radiometer"  # DeviceManufacturerInfo, by which the quirk file knows it


@dataclass(frozen=True, slots=True)
class SentPicture:
    """A picture ready to be sent: the registers at the time, its bytes, and the settings that it was made under."""

    asked: tuple[PictureRequest, str]
    payload: bytes
    mean_dn: float
    made_under: PictureRequest


class BlackflyGige(Opened):
    """Serves a simulated camera until it is closed.

    Args:
        limits: What the camera can do; the black level in DN of the native bit depth.
        serial: Serial number, at most 15 letters.
        native_bit_depth: Bits of the sensor's digital numbers.
        real_time: Frames come as their exposure allows; else as fast as they can be made.
        sleep: Waits so many seconds.
    """

    def __init__(
        self,
        source: PictureSource,
        limits: CameraCapabilities,
        *,
        vendor: str = "FLIR",
        model: str = "BFS-U3-19S4M",
        serial: str = "22500001",
        address: str = "127.0.0.1",
        native_bit_depth: int = 12,
        temperature_c: float = 40.0,
        real_time: bool = False,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.source, self._limits, self._native_bits = source, limits, native_bit_depth
        self._vendor, self._model, self._serial, self._address = vendor, model, serial, address
        self._temperature_c, self._real_time, self._sleep = temperature_c, real_time, sleep
        self._info = INFO_TEXT
        self._device: FakeGigeDevice | None = None
        self._worker: threading.Thread | None = None
        self._closing, self._sent = threading.Event(), threading.Event()
        self._ready: SentPicture | None = None
        self._last: SentPicture | None = None
        self.frames_sent = 0
        self.failure: RadiometerError | None = None

    @property
    def is_served(self) -> bool:
        """Return whether it is on the network; false after it was asked to disconnect."""
        return self._device is not None and self._device.is_served

    @property
    def label(self) -> str:
        """Return how messages call it."""
        return f"simulated camera {self._vendor} {self._model} {self._serial}"

    def open(self) -> None:
        features = self._features()
        with tempfile.TemporaryDirectory(prefix="radiometer-") as folder:
            description = Path(folder) / "blackfly.xml"
            description.write_bytes(genicam_xml(features, self._vendor, self._model))
            device = FakeGigeDevice(self._address, self._serial, description)
        self._power_on(device, features)
        device.on_frame(self._payload)
        self._device = device
        self._closing.clear()
        self._ready = self._last = None
        self._worker = threading.Thread(target=self._run, name="blackfly", daemon=True)
        self._worker.start()

    def close(self) -> None:
        self._closing.set()
        if self._worker is not None:
            self._worker.join()
            self._worker = None
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def lose_packets(self, per_mille: int) -> None:
        """Drop so many packets of a thousand."""
        self._write_word(registers.LOSS_PER_MILLE, per_mille)

    def stall(self, *, stalled: bool) -> None:
        """Answer requests but send no pictures, or send them again."""
        self._write_word(registers.STALL, int(stalled))

    def cap(self, *, on: bool) -> None:
        """Put the cap on the lens, or take it off: the camera has no shutter."""
        self._write_word(registers.SHUTTER_CLOSED, int(on))

    def answer_slowly(self, delay_s: float) -> None:
        """Hold every frame back so long; requests that arrive meanwhile wait too."""
        if self._device is not None:
            self._device.write_float(registers.ANSWER_DELAY_MS, delay_s * 1e3)

    def disconnect(self) -> None:
        """Fall silent, as if the cable were pulled."""
        self._write_word(registers.DISCONNECT, 1)
        while self.is_served:
            self._sleep(_LOOK_S)

    def _features(self) -> list[Feature]:
        return registers.blackfly_features(self._limits, self._native_bits, self._temperature_c)

    def _power_on(self, device: FakeGigeDevice, features: list[Feature]) -> None:
        for feature in features:
            if isinstance(feature.initial, float) and not feature.whole:
                device.write_float(feature.address, feature.initial)
            elif isinstance(feature.initial, int | float):
                device.write_word(feature.address, int(feature.initial))
        for address, text, length in (
            (registers.VENDOR, self._vendor, 32),
            (registers.MODEL, self._model, 32),
            (registers.INFO, self._info, 48),
        ):
            device.write_text(address, text, length)
        device.write_word(registers.INNER_TRIGGER_MODE, 1)
        device.write_word(registers.INNER_TRIGGER_SOURCE, registers.SOFTWARE_SOURCE)
        device.set_trigger_rate_hz(_TRIGGER_LOOKS_HZ)

    def _write_word(self, address: int, value: int) -> None:
        if self._device is not None and self._device.is_served:
            self._device.write_word(address, value)
            self._apply_loss(self._device)

    def _run(self) -> None:
        """Make pictures, one ahead, and do what the SimulatorControl features ask for."""
        while not self._closing.is_set():
            device = self._device
            if device is None or not device.is_served:
                return
            self._apply_loss(device)
            if device.read_word(registers.DISCONNECT):
                _LOG.info("simulated camera disconnects", serial=self._serial)
                device.close()
                return
            if self._sent.is_set():
                self._after_sending(device)
            elif self._ready is not None:
                self._await_sending(device)
            elif self._is_requested(device):
                self._expose(device)
            else:
                self._closing.wait(_LOOK_S)

    def _apply_loss(self, device: FakeGigeDevice) -> None:
        stalled = device.read_word(registers.STALL)
        device.lose_packets(1.0 if stalled else device.read_word(registers.LOSS_PER_MILLE) / 1000)

    def _is_requested(self, device: FakeGigeDevice) -> bool:
        if not is_acquiring(device):
            return False
        if not device.read_word(registers.TRIGGER_MODE):
            return True
        if not device.read_word(registers.TRIGGER_SOFTWARE):
            return False
        device.write_word(registers.TRIGGER_SOFTWARE, 0)
        return device.read_word(registers.TRIGGER_SOURCE) == registers.SOFTWARE_SOURCE

    def _expose(self, device: FakeGigeDevice) -> None:
        """Make a picture and have it sent, unless the settings change or the acquisition stops meanwhile."""
        begin_s = time.monotonic()
        picture = self._picture(device)
        while not self._closing.is_set() and is_acquiring(device) and read_request(device) == picture.asked:
            left_s = self._period_s(device, picture.asked[0]) - (time.monotonic() - begin_s)
            if left_s <= 0:
                self._ready = picture
                device.write_word(registers.INNER_TRIGGER, 1)
                return
            self._closing.wait(min(left_s, 10 * _LOOK_S))
        if device.read_word(registers.TRIGGER_MODE) and is_acquiring(device):
            device.write_word(registers.TRIGGER_SOFTWARE, 1)  # the trigger still waits for its picture

    def _await_sending(self, device: FakeGigeDevice) -> None:
        if not self._sent.wait(_LOOK_S) and not is_acquiring(device):
            device.write_word(registers.INNER_TRIGGER, 0)
            self._ready = None

    def _after_sending(self, device: FakeGigeDevice) -> None:
        self._sent.clear()
        if self._last is not None and device.read_word(registers.EXPOSURE_AUTO) != registers.AUTO["Off"]:
            steer_exposure(device, self._last.asked[0], self._last.mean_dn, self._limits.exposure_s)

    def _period_s(self, device: FakeGigeDevice, request: PictureRequest) -> float:
        period_s = max(request.exposure_s, READOUT_S) if self._real_time else 0.0
        if device.read_word(registers.FRAME_RATE_ENABLE):
            period_s = max(period_s, 1 / device.read_float(registers.FRAME_RATE_HZ))
        return period_s

    def _picture(self, device: FakeGigeDevice) -> SentPicture:
        """Return the next picture; a blank one where the model fails (see `failure`)."""
        asked = read_request(device)
        request, format_name = asked
        size = request.width * request.height * WIRE_FORMATS[format_name].bits_per_pixel // 8
        try:
            dn = processed(device, self.source(request), request)
            return SentPicture(asked, pack_pixels(dn, format_name)[:size], float(dn.mean()), request)
        except RadiometerError as error:
            self.failure = error
            _LOG.error("no picture", serial=self._serial, reason=str(error))
            return SentPicture(asked, bytes(size), 0.0, request)

    def _payload(self) -> bytes:
        """Return the bytes of the picture that is being sent; runs in the device's own thread."""
        device, picture = self._device, self._ready
        if device is None:
            return b""
        if picture is None or picture.asked != read_request(device):  # changed at the last moment
            picture = self._picture(device)
        self._sleep(device.read_float(registers.ANSWER_DELAY_MS) / 1e3)
        self.frames_sent += 1
        self._last, self._ready = picture, None
        self._sent.set()
        return picture.payload

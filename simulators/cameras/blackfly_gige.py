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
from typing import Any, Final

import numpy as np
import structlog
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from radiometer.data import FrameSettings
from radiometer.data.frame import DigitalNumbers
from radiometer.devices import CameraCapabilities
from radiometer.devices.opening import Opened
from radiometer.errors import RadiometerError
from simulators.cameras import blackfly_features as registers
from simulators.cameras.aravis_fake_device import FakeGigeDevice
from simulators.cameras.blackfly_features import WIRE_FORMATS, Feature, genicam_xml, pack_pixels
from simulators.chain.camera_model import VirtualSensor


@dataclass(frozen=True, slots=True)
class PictureRequest:
    """The registers that a picture is made under."""

    exposure_s: float  # exposure time in s
    gain_db: float  # analogue gain in dB
    black_level_dn: float  # black level in DN of the given bit depth
    bit_depth: int  # bits of a digital number
    temperature_c: float  # sensor temperature in °C
    source_level: float  # relative drive of the source
    is_shutter_closed: bool  # cap on the lens
    binning: int  # pixels averaged in each direction
    x: int  # left edge of the region in pixels after binning
    y: int  # top edge of the region
    width: int  # width of the region
    height: int  # height of the region


PictureSource = Callable[[PictureRequest], DigitalNumbers]


class ForwardModelSource:
    """Exposes the virtual sensor anew for every picture."""

    def __init__(self, sensor: VirtualSensor) -> None:
        self._sensor, self._pattern = sensor, sensor.scene.patterns[0]
        self._last: FrameSettings | None = None
        self._since_change = 0

    def show(self, pattern: str) -> None:
        """Show another pattern of the scene, as a person at the bench does."""
        self._pattern = pattern

    def __call__(self, request: PictureRequest) -> DigitalNumbers:
        """Return the picture of a request, shape (height, width).

        Raises:
            MeasurementError: If an effect of the model fails; the message names it.
        """
        settings = FrameSettings(
            exposure_s=request.exposure_s,
            gain_db=request.gain_db,
            f_number=self._sensor.model.lens.f_number,
            black_level_dn=request.black_level_dn,
            temperature_c=request.temperature_c,
            source_level=request.source_level,
            pattern=self._pattern,
            shutter="closed" if request.is_shutter_closed else "open",
        )
        self._since_change = self._since_change + 1 if settings == self._last else 0
        self._last = settings
        dn = self._sensor.expose(
            settings, output_bit_depth=request.bit_depth, binning=request.binning, frame_index=self._since_change
        )
        return dn[request.y : request.y + request.height, request.x : request.x + request.width]


class PooledSource:
    """Draws a few frames under each setting and serves them in turn: for measuring the link, not the light.

    Args:
        size: Frames drawn under each setting, at least 1.
    """

    def __init__(self, source: PictureSource, size: int) -> None:
        self._source, self._size = source, size
        self._request: PictureRequest | None = None
        self._pool: list[DigitalNumbers] = []
        self._served = 0

    def __call__(self, request: PictureRequest) -> DigitalNumbers:
        """Return the next frame of the pool for a request."""
        if request != self._request:
            self._request, self._pool, self._served = request, [], 0
        if len(self._pool) < self._size:
            self._pool.append(self._source(request))
        frame = self._pool[self._served % self._size]
        self._served += 1
        return frame


_NAMES: Final = {wire.code: name for name, wire in WIRE_FORMATS.items()}
AUTO_TARGET: Final = 0.5  # of full scale, the mean that automatic exposure steers to
_AUTO_STEP: Final = 2.0  # largest change from frame to frame


def gamma_corrected(dn: DigitalNumbers, gamma: float, full_scale_dn: int) -> DigitalNumbers:
    """Return digital numbers after a gamma curve: full scale × (DN / full scale)^gamma, rounded."""
    curve = full_scale_dn * (np.arange(full_scale_dn + 1) / full_scale_dn) ** gamma
    return _like(dn, curve[dn])


def sharpened(dn: DigitalNumbers, full_scale_dn: int) -> DigitalNumbers:
    """Return digital numbers with half of their difference from the mean of 3 × 3 neighbours added."""
    exact: NDArray[np.float32] = dn.astype(np.float32)
    crisp = exact + 0.5 * (exact - uniform_filter(exact, 3))
    return _like(dn, np.clip(crisp, 0, full_scale_dn))


def steered(setting: float, mean_dn: float, full_scale_dn: int, low: float, high: float) -> float:
    """Return the exposure time or amplitude gain that automatic exposure takes for the next frame.

    Args:
        setting: What the last frame was taken with, in any unit proportional to the signal.
        mean_dn: Mean of the last frame in DN.
    """
    factor = AUTO_TARGET * full_scale_dn / max(mean_dn, 1.0)
    return min(max(setting * min(max(factor, 1 / _AUTO_STEP), _AUTO_STEP), low), high)


def _like(dn: DigitalNumbers, exact: NDArray[np.floating[Any]]) -> DigitalNumbers:
    rounded: DigitalNumbers = np.rint(exact).astype(dn.dtype)
    return rounded


def is_acquiring(device: FakeGigeDevice) -> bool:
    """Tell whether a program controls the camera and has started its acquisition."""
    return bool(device.read_word(registers.ACQUISITION) and device.read_word(registers.CONTROL_PRIVILEGE))


def read_request(device: FakeGigeDevice) -> tuple[PictureRequest, str]:
    """Return what a picture is to be made under, and the name of its pixel format."""
    format_name = _NAMES.get(device.read_word(registers.PIXEL_FORMAT), "Mono8")
    bits = WIRE_FORMATS[format_name].bit_depth
    request = PictureRequest(
        exposure_s=device.read_float(registers.EXPOSURE_US) * 1e-6,
        gain_db=device.read_float(registers.GAIN_DB),
        black_level_dn=device.read_float(registers.BLACK_LEVEL_PERCENT) / 100 * ((1 << bits) - 1),
        bit_depth=bits,
        temperature_c=device.read_float(registers.TEMPERATURE_C),
        source_level=device.read_float(registers.SOURCE_LEVEL),
        is_shutter_closed=bool(device.read_word(registers.SHUTTER_CLOSED)),
        binning=max(1, device.read_word(registers.BINNING)),
        x=device.read_word(registers.OFFSET_X),
        y=device.read_word(registers.OFFSET_Y),
        width=device.read_word(registers.WIDTH),
        height=device.read_word(registers.HEIGHT),
    )
    return request, format_name


def processed(device: FakeGigeDevice, dn: DigitalNumbers, request: PictureRequest) -> DigitalNumbers:
    """Return a picture after gamma and sharpening, where they are on."""
    full_scale_dn = (1 << request.bit_depth) - 1
    if device.read_word(registers.GAMMA_ENABLE):
        dn = gamma_corrected(dn, device.read_float(registers.GAMMA), full_scale_dn)
    if device.read_word(registers.SHARPENING_ENABLE):
        dn = sharpened(dn, full_scale_dn)
    return dn


def steer_exposure(
    device: FakeGigeDevice, request: PictureRequest, mean_dn: float, limits_s: tuple[float, float]
) -> None:
    """Set the exposure time that automatic exposure takes after a picture.

    Args:
        request: What the picture was made under.
        mean_dn: Its mean in DN.
        limits_s: Shortest and longest exposure time in s.
    """
    next_s = steered(request.exposure_s, mean_dn, (1 << request.bit_depth) - 1, *limits_s)
    device.write_float(registers.EXPOSURE_US, next_s * 1e6)


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

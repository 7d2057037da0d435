"""The bench as the daemon's devices: its camera, watched for late answers, and its light box; opened and reopened."""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.analysis.photometry.photometry import spectrum
from radiometer.analysis.signal.situation import situation_of
from radiometer.bench.assembly import calibration_path, stated_source
from radiometer.bench.boxes import open_light_box
from radiometer.bench.cameras import open_camera
from radiometer.bench.config import read_bench
from radiometer.bench.instrument import Instrument, central_patch
from radiometer.bench.reopening import name_of_camera, refuse_another
from radiometer.daemon.instrument import DeviceReport, Measurement, MeasurementSettings
from radiometer.data import Bracket, Calibration, Flag, Frame, Patch, ResponseCurve
from radiometer.data.setup import Setup
from radiometer.devices import Camera, CameraCapabilities, CameraIdentity, CameraSettings
from radiometer.devices.light_box import FULL_LEVEL, ChannelState, CurrentRange, DriveLevel, LightBox
from radiometer.devices.opening import Opened
from radiometer.errors import DeviceError

_UNKNOWN = CameraIdentity("", "camera not seen yet", "", "")
_FIXED_REPEATS = 2  # one repeat, so that flicker between two equal frames can be noticed
GRACE_S: Final = 1.4  # beyond twice the exposure: what a healthy camera needs to read out, send, or answer
# A camera rounds exposure times to its lines, 10 to 30 µs each, and to its clock: what differs more was not asked for.
_ROUNDED_S: Final = 50e-6
_ROUNDED_REL: Final = 0.02  # coarse line times at short exposures
_EVERY_NTH_ROW: Final = 8  # noise in an eighth of the pixels never repeats either, and is looked at eight times faster
_PICTURED: Final = 0.5  # below this share of pixels that are neither lowest nor highest, noise may not show


class WatchedCamera(Opened):
    """Passes every call on, notes by when it should have returned, and what is odd about its frames.

    Args:
        clock: Steady time in s.
    """

    def __init__(self, camera: Camera, clock: Callable[[], float] = time.monotonic) -> None:
        self._camera, self._clock = camera, clock
        self.late_at: float | None = None
        self._asked_s: float | None = None
        self._last: tuple[int, tuple[int, ...]] | None = None
        self._doubts: set[Flag] = set()

    def take_doubts(self) -> tuple[Flag, ...]:
        """Return why the frames since the last call may not be believed, and forget it."""
        doubts, self._doubts = tuple(sorted(self._doubts)), set()
        return doubts

    identity: Any = property(attrgetter("_camera.identity"))
    capabilities: Any = property(attrgetter("_camera.capabilities"))
    settings: Any = property(attrgetter("_camera.settings"))
    description: Any = property(attrgetter("_camera.description"))
    lens: Any = property(attrgetter("_camera.lens"))
    counts: Any = property(attrgetter("_camera.counts"))

    def open(self) -> None:
        self._camera.open()

    def close(self) -> None:
        self._camera.close()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        with self._expected_within(GRACE_S):
            applied = self._camera.configure(settings)
        self._asked_s = settings.exposure_s
        return applied

    def capture(self, count: int = 1) -> list[Frame]:
        with self._expected_within(GRACE_S + 2 * count * self._camera.settings.exposure_s):
            frames = self._camera.capture(count)
        for frame in frames:
            self._look_at(frame)
        return frames

    def stream(self) -> Generator[Frame, None, None]:
        for frame in self._camera.stream():
            self._look_at(frame)
            yield frame

    def set_shutter(self, *, closed: bool) -> None:
        self._camera.set_shutter(closed=closed)

    def _look_at(self, frame: Frame) -> None:
        stated_s = frame.settings.exposure_s
        if not (math.isfinite(stated_s) and stated_s > 0):
            raise DeviceError(
                f"the camera states an exposure time of {stated_s:g} s for a frame; reset it, or update its driver"
            )
        if self._asked_s is not None:
            rounded_s = max(_ROUNDED_S, _ROUNDED_REL * self._asked_s, 2 * self._camera.capabilities.exposure_step_s)
            if abs(stated_s - self._asked_s) > rounded_s:
                self._doubts.add(Flag.EXPOSURE_UNCONFIRMED)
        rows = np.asarray(frame.dn[::_EVERY_NTH_ROW], dtype=np.uint16)
        this = (zlib.crc32(rows.tobytes()), rows.shape)
        if this == self._last and float(np.mean((rows > rows.min()) & (rows < frame.full_scale_dn))) > _PICTURED:
            self._doubts.add(Flag.REPEATED_FRAME)
        self._last = this

    @contextmanager
    def _expected_within(self, seconds: float) -> Iterator[None]:
        self.late_at = self._clock() + seconds
        try:
            yield
        finally:
            self.late_at = None


class BenchInstrument:
    """The camera and calibration of a bench file.

    Args:
        bench: Bench file; the simulated bench where None.
        camera_name: "sim", or a GenICam id, serial number or address; the bench's own camera where None.
        calibration: Calibration file; the bench's own where None.

    Raises:
        ConfigurationError: If the bench file is wrong.
        CalibrationError: If the calibration cannot be used.
    """

    def __init__(
        self,
        bench: Path | None = None,
        camera_name: str | None = None,
        calibration: Path | None = None,
        *,
        uncalibrated: bool = False,
    ) -> None:
        self.config, self._where = read_bench(bench, camera_name)
        self._name = camera_name
        self._path = None if uncalibrated else calibration or calibration_path(self.config, bench)
        self._spectrum = self.config.spectrum
        self._calibration = self._read_calibration()
        self._camera: WatchedCamera | None = None
        self._limits: CameraCapabilities | None = None
        self.identity = _UNKNOWN  # empty before it was first seen
        self._temperature_c: float | None = None

    @property
    def limits(self) -> CameraCapabilities:
        """Return the camera's limits as of the last opening. Raises DeviceError before the first."""
        if self._limits is None:
            raise DeviceError("the camera has not been open yet, so its limits are not known")
        return self._limits

    @property
    def late_at(self) -> float | None:
        camera = self._camera
        return camera.late_at if camera else None

    def open(self) -> None:
        """Open the camera, and refuse another one than was open before. Raises DeviceError; close it then, too."""
        self.close()
        camera = self._camera = WatchedCamera(open_camera(self.config, self._where, self._name))
        if self.identity != _UNKNOWN:
            refuse_another(name_of_camera(camera.identity), name_of_camera(self.identity))
        self.identity, self._limits = camera.identity, camera.capabilities

    def close(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()

    def check(self) -> DeviceReport:
        camera = self._opened()
        _ = camera.settings
        counts = camera.counts
        named = {name: getattr(counts, name) for name in counts.__slots__ if name != "extra"}
        return DeviceReport(self._temperature_c, {**named, **counts.extra})

    def measure(self, settings: MeasurementSettings) -> Measurement:
        """Take a bracket, or frames of a fixed exposure, and return the reading of the patch."""
        camera = self._opened()
        camera.take_doubts()
        instrument = self._instrument(camera, settings)
        if camera.settings.gain_db != settings.gain_db:
            camera.configure(replace(camera.settings, gain_db=settings.gain_db))
        bracket = instrument.take_bracket() if settings.auto_exposure else self._fixed(camera, settings.exposure_s)
        temperatures = [f.settings.temperature_c for f in bracket.light if f.settings.temperature_c is not None]
        self._temperature_c = temperatures[-1] if temperatures else self._temperature_c
        reading = instrument.read(bracket)
        reading = replace(reading, flags=tuple(sorted({*reading.flags, *camera.take_doubts()})))
        return Measurement(reading, _distinct(bracket), self.check())

    def self_test(self) -> list[str]:
        """Take one of the shortest frames and look whether it is plausible. Raises DeviceError."""
        camera = self._opened()
        before = camera.settings
        camera.configure(replace(before, exposure_s=camera.capabilities.exposure_s[0]))
        frame = camera.capture(1)[0]
        camera.configure(before)
        faults = []
        if frame.dn.min() == frame.dn.max():
            faults.append(f"every pixel reads {frame.dn.min()} DN at the shortest exposure: no noise, no signal")
        black = before.black_level_dn
        if black and float(frame.dn.min()) > 2 * black:
            faults.append(f"the darkest pixel reads {frame.dn.min()} DN where the black level is {black:g} DN")
        return faults

    def reload_calibration(self) -> str:
        fresh = self._read_calibration()
        if fresh is not None and self._camera is not None:
            situation_of(Setup(self._camera.description, self._camera.lens, fresh))  # refused here, not at each reading
        self._calibration = fresh
        return f"{self._path.name}, made {fresh.created}" if self._path and fresh else "no calibration in use"

    @property
    def response(self) -> ResponseCurve | None:
        return self._calibration.response if self._calibration else None

    @property
    def calibration_summary(self) -> Mapping[str, Any]:
        if self._calibration is None or self._path is None:
            return {}
        assumptions = list(self._calibration.provenance.assumptions)
        return {"source": self._path.name, "created": self._calibration.created, "assumptions": assumptions}

    def default_patch(self) -> Patch | None:
        """Return the patch that the bench file names; None for the middle of the frame."""
        return self.config.patch.patch if self.config.patch else None

    def _opened(self) -> WatchedCamera:
        if self._camera is None:
            raise DeviceError("the camera is not open")
        return self._camera

    def _read_calibration(self) -> Calibration | None:
        if self._path is None:
            return None
        calibration = Calibration.read(self._path)
        return replace(calibration, spectrum=self._spectrum) if self._spectrum else calibration

    def _instrument(self, camera: Camera, settings: MeasurementSettings) -> Instrument:
        calibration = self._calibration
        if calibration is not None and settings.wavelength_nm is not None:
            line = f"line:{settings.wavelength_nm:g}"
            spectrum(line)  # refuses a wavelength that has no meaning before any frame is taken
            calibration = replace(calibration, spectrum=line)
        patch = settings.patch or central_patch(camera)
        return Instrument(
            camera,
            patch,
            calibration=calibration,
            time_limit_s=self.config.time_limit_s,
            source=stated_source(self.config),
            spectrum_stated=settings.wavelength_nm is not None or bool(self._spectrum or self.config.spectrum),
        )

    def _fixed(self, camera: Camera, exposure_s: float) -> Bracket:
        camera.configure(replace(camera.settings, exposure_s=exposure_s))
        frames: list[Frame] = camera.capture(_FIXED_REPEATS)
        return Bracket.from_frames(frames, origin=camera.identity.device_id)


def _distinct(bracket: Bracket) -> tuple[Frame, ...]:
    """Return one frame per exposure: what a picture needs."""
    return tuple({frame.settings.effective_exposure_s: frame for frame in bracket.light}.values())


class BenchLight:
    """The light box that `open_box` gives.

    Levels go from 0 to 1 of the high-current range; what a channel's own limit or the retinal-exposure account does
    not allow is refused by the box's driver.

    Args:
        open_box: Returns a block in which the box is open; called again after each loss.
    """

    def __init__(self, open_box: Callable[[], AbstractContextManager[LightBox]], name: str = "light box") -> None:
        self._open_box, self.name = open_box, name
        self._box: LightBox | None = None
        self._held = ExitStack()
        self._serial = ""
        self.channels: tuple[str, ...] = ()  # empty before the box was first open
        self._limits: dict[str, float] = {}

    @property
    def level_limits(self) -> dict[str, float]:
        """Return the highest level of each channel that the box would have accepted when it was last asked."""
        return dict(self._limits)

    @property
    def switched_off(self) -> int:
        """Return how often another program has asked for darkness since the box was opened."""
        return int(getattr(self._box, "switched_off", 0))

    @property
    def late_at(self) -> float | None:
        """Return None: every exchange with the box has a short deadline."""
        return None

    def open(self) -> None:
        """Open the box, all channels dark, and refuse another one than was open before. Raises DeviceError."""
        self.close()
        with ExitStack() as opening:
            box = opening.enter_context(self._open_box())
            serial = self._serial or box.identity.serial
            refuse_another(f"light box {box.identity.serial}", f"light box {serial}")
            self._serial = serial
            self.channels = tuple(box.channels)
            self._held = opening.pop_all()
        self._box = box

    def close(self) -> None:
        self._box = None
        with suppress(DeviceError):  # lost, or not dark: its dead-man timer ends the light
            self._held.close()

    def check(self) -> DeviceReport:
        box = self._opened()
        status, levels = box.status(), {name: _level(box.read_channel(name)) for name in self.channels}
        self._look_at_limits(box)
        counts = {"damaged_lines": status.damaged_lines, "lost_bytes": status.lost_bytes, "darkened": status.darkened}
        return DeviceReport(status.temperature_celsius, counts, levels)

    def set_level(self, channel: str, level: float) -> float:
        box = self._opened()
        if level == 0.0:
            box.off(channel)
            return 0.0
        state = box.set_level(channel, DriveLevel(max(1, round(level * FULL_LEVEL)), CurrentRange.HIGH))
        self._look_at_limits(box)  # this light counts towards what the other channels may give
        return _level(state)

    def _look_at_limits(self, box: LightBox) -> None:
        self._limits = {name: _highest(box, name) for name in self.channels}

    def _opened(self) -> LightBox:
        if self._box is None:
            raise DeviceError(f"the {self.name} is not open")
        return self._box


def _highest(box: LightBox, channel: str) -> float:
    """Return the highest steady level that a box accepts now; its own limit where it keeps no account."""
    highest = getattr(box, "highest_level", None)
    level = highest(channel) if highest else box.channels[channel].level_limit[CurrentRange.HIGH]
    return int(level) / FULL_LEVEL


def _level(state: ChannelState) -> float:
    """Return the level on the high range that a channel is driven at; one on the low range counts as what it is."""
    return state.drive.level / FULL_LEVEL


def bench_light(name: str, calibration: Path | None = None, preset: Path | None = None) -> BenchLight:
    """Return the light box of a name as the daemon's light source, not yet open.

    Args:
        name: "sim", a serial number or a port.
        calibration: Calibration file; the one kept for its serial number where None.
        preset: Light-box preset; the reference box's where None.
    """

    @contextmanager
    def open_box() -> Iterator[LightBox]:
        with open_light_box(name, calibration=calibration, preset=preset) as opened:
            yield opened.box

    return BenchLight(open_box)

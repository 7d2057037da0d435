"""A camera that does not exist, behaving as one that does; with a mosaic of colour filters where it has one.

    preset = CameraPreset.shipped("BFS-U3-19S4M")
    model = CameraModel.ideal(preset.camera, LensDescription(focal_length_mm=16, f_number=4.0))
    scene = scene_from_mapping({"kind": "step_chart", "steps": {"count": 20, "lowest": 1e-4, "highest": 10.0}})
    with SimulatedCamera(model, scene, seed=1) as camera:
        camera.configure(CameraSettings(exposure_s=0.01, black_level_dn=64))
        frame = camera.capture()[0]

Time is simulated: nothing sleeps, and frames carry the time of their start on `camera.clock`.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Generator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import (
    CameraDescription,
    Frame,
    FrameSettings,
    LensDescription,
    PatchDescription,
    SourceDescription,
)
from radiometer.data.mosaic import COLOURS
from radiometer.devices import (
    AcquisitionCounts,
    CameraCapabilities,
    CameraIdentity,
    CameraPreset,
    CameraSettings,
    refuse_out_of_range,
    refuse_roi_outside,
)
from radiometer.devices.opening import Opened
from radiometer.errors import ConfigurationError, DeviceError, DeviceInUse, SettingOutOfRange
from simulators.chain.camera_model import CameraModel, VirtualSensor
from simulators.clock import SimulatedClock
from simulators.scenes.base import LitScene, PulsedLight, Scene, SceneImage

# Peak and full width at half maximum of each colour's quantum efficiency in nm, what leaks elsewhere, and the infrared
# filter's edge. Assumed: between the data sheets of colour sensors (Sony IMX249, IMX273), and of no one camera.
_BELLS_NM: Final = {"red": (600.0, 78.0), "green": (532.0, 88.0), "blue": (465.0, 70.0)}
_LEAK: Final = 0.03
_CUT_NM, _CUT_WIDTH_NM = 665.0, 6.0
_REFERENCE_NM: Final = 550.0  # at which the camera's own quantum efficiency holds


@dataclass(frozen=True, slots=True)
class ColourFilters:
    """Filters over the pixels.

    Attributes:
        mosaic: Colours of 2 × 2 pixels row by row.
    """

    mosaic: str = "RGGB"

    def responsivity(self, colour: str, wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signal per watt under a filter over that of the bare sensor at 550 nm."""
        peak_nm, width_nm = _BELLS_NM[colour]
        bell = np.exp(-4.0 * math.log(2.0) * ((wavelength_nm - peak_nm) / width_nm) ** 2)
        cut = 1.0 / (1.0 + np.exp((wavelength_nm - _CUT_NM) / _CUT_WIDTH_NM))
        return np.asarray(wavelength_nm / _REFERENCE_NM * cut * (_LEAK + (1.0 - _LEAK) * bell))


@dataclass(frozen=True, slots=True)
class FilteredScene:
    """A scene behind the filters of a mosaic: the radiance at 550 nm that gives each pixel's signal."""

    scene: LitScene
    filters: ColourFilters

    @property
    def source(self) -> SourceDescription:
        return self.scene.source.model_copy(update={"wavelength_nm": _REFERENCE_NM})

    @property
    def patterns(self) -> tuple[str, ...]:
        return self.scene.patterns

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        return self.scene.patches(width, height)

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        planes = {
            colour: self.scene.seen_through(partial(self.filters.responsivity, colour), width, height, pattern)
            for colour in COLOURS
        }
        seen = np.empty((height, width), np.float32)
        for place, letter in enumerate(self.filters.mosaic):
            colour = next(one for one in COLOURS if one[0].upper() == letter)
            row, column = divmod(place, 2)
            seen[row::2, column::2] = planes[colour].radiance[row::2, column::2]
        return SceneImage(seen, peak_radiance=float(seen.max()))


_BITS: Final = {"Mono8": 8, "Mono10": 10, "Mono10p": 10, "Mono12": 12, "Mono12p": 12, "Mono16": 16} | {
    "BayerRG8": 8,
    "BayerRG12": 12,
}
_LARGEST_BINNING: Final = 4  # as machine cameras offer
_READOUT_S: Final = 1 / 131  # 131 frames per second at full size: BFS-U3-19S4M specification page


class SimulatedCamera(Opened):
    """A Camera made of a camera model that looks at a scene.

    Args:
        scene: What it looks at; may be changed with `set_scene`.
        seed: Makes the noise; the same seed gives the same frames in the same order.
        serial: Serial number; the fixed patterns of the effects follow from it.
        device_id: Id that it is opened by.
        filters: Its colour filters; None for a monochrome sensor.
        limits: What it can do; by default the BFS-U3-19S4M of the shipped preset, with a shutter.
        modulation: How the light changes in time; steady by default.
    """

    def __init__(
        self,
        model: CameraModel,
        scene: Scene,
        *,
        seed: int = 0,
        serial: str = "22500001",
        device_id: str = "sim",
        limits: CameraCapabilities | None = None,
        filters: ColourFilters | None = None,
        clock: SimulatedClock | None = None,
        temperature_c: float = 40.0,
        modulation: PulsedLight | None = None,
    ) -> None:
        self._filters = filters
        self.model, self.clock = model, clock or SimulatedClock()
        self._limits = limits or default_limits()
        self._identity = CameraIdentity(
            model.camera.vendor or "radiometer", model.camera.model or "simulated", serial, device_id, "simulated"
        )
        device_seed = zlib.crc32(serial.encode())
        self._sensor = VirtualSensor(
            model, self._filtered(scene), self._limits.width, self._limits.height, seed=seed, device_seed=device_seed
        )
        self._temperature_c, self._modulation = temperature_c, modulation
        self._source_level, self._pattern = 1.0, scene.patterns[0]
        self._f_number = model.lens.f_number
        self._open = self._closed_shutter = False
        self._settings = self._first_settings()
        self._since_change = self._counted = 0

    @property
    def identity(self) -> CameraIdentity:
        return self._identity

    @property
    def capabilities(self) -> CameraCapabilities:
        self._require_open()
        return self._limits

    @property
    def settings(self) -> CameraSettings:
        self._require_open()
        return self._settings

    @property
    def description(self) -> CameraDescription:
        """Return what its preset says of it, with DN counted as the pixel format in force counts them."""
        camera = self.model.camera
        scale = 2.0 ** (_BITS[self._settings.pixel_format] - camera.bit_depth)
        known_gain, known_black = camera.conversion_gain_e_per_dn, camera.black_level_dn
        return camera.model_copy(
            update={
                "serial": self._identity.serial,
                "bit_depth": _BITS[self._settings.pixel_format],
                "conversion_gain_e_per_dn": None if known_gain is None else known_gain / scale,
                "black_level_dn": None if known_black is None else known_black * scale,
                "mosaic": self._filters.mosaic if self._filters else None,
                "binning": str(self._settings.binning),
            }
        )

    @property
    def lens(self) -> LensDescription:
        return self.model.lens.model_copy(update={"f_number": self._f_number})

    @property
    def counts(self) -> AcquisitionCounts:
        """Return the number of frames since it was opened; nothing ever goes wrong."""
        return AcquisitionCounts(frames=self._counted)

    @property
    def scene(self) -> Scene:
        """Return what it looks at."""
        return self._sensor.scene

    @property
    def sensor(self) -> VirtualSensor:
        """Return the sensor behind it, for other ways of serving its frames."""
        return self._sensor

    def open(self) -> None:
        """Open the camera with default settings. Raises DeviceInUse if it is open already."""
        if self._open:
            raise DeviceInUse(f"{self._name}: is open already; close it first")
        self._open, self._settings = True, self._first_settings()
        self._since_change = self._counted = 0

    def close(self) -> None:
        self._open = False

    def configure(self, settings: CameraSettings) -> CameraSettings:
        self._require_open()
        self._refuse(settings)
        step = self._limits.exposure_step_s
        exposure_s = round(settings.exposure_s / step) * step if step else settings.exposure_s
        self._settings = replace(settings, exposure_s=exposure_s)
        self._since_change = 0
        return self._settings

    def capture(self, count: int = 1) -> list[Frame]:
        """Return `count` frames; the clock moves on by exposure and readout.

        Raises:
            DeviceError: If the camera is not open.
            MeasurementError: If an effect of the model fails; the message names it.
        """
        self._require_open()
        return [self._expose() for _ in range(count)]

    def stream(self) -> Generator[Frame, None, None]:
        self._require_open()
        while self._open:
            yield self._expose()

    def set_shutter(self, *, closed: bool) -> None:
        self._require_open()
        if not self._limits.has_shutter:
            raise DeviceError(f"{self._name}: has no shutter; cover the lens for dark frames")
        self._closed_shutter = closed

    def set_scene(self, scene: Scene) -> None:
        """Point the camera at another scene, showing its first pattern."""
        self._sensor.scene, self._pattern = self._filtered(scene), scene.patterns[0]

    def _filtered(self, scene: Scene) -> Scene:
        if self._filters is None:
            return scene
        if not isinstance(scene, LitScene):
            raise ConfigurationError(f"{self._name}: the wavelengths of its scene are unknown, so filters cannot act")
        return FilteredScene(scene, self._filters)

    def set_source(self, level: float | None = None, pattern: str | None = None) -> None:
        """Set what the bench's source does: its relative level and the pattern shown.

        Raises:
            SettingOutOfRange: If the level is not between 0 and 1.
            ConfigurationError: If the scene has no such pattern.
        """
        if level is not None and not 0.0 <= level <= 1.0:
            raise SettingOutOfRange(self._name, "source level", level, 0.0, 1.0, "(relative)")
        if pattern is not None and pattern not in self.scene.patterns:
            raise ConfigurationError(
                f"{self._name}: the scene has no pattern {pattern!r}; it shows {', '.join(self.scene.patterns)}"
            )
        self._source_level = self._source_level if level is None else level
        self._pattern = pattern or self._pattern

    def set_f_number(self, f_number: float) -> None:
        """Turn the aperture ring. Raises SettingOutOfRange outside 0.5 to 64."""
        if not 0.5 <= f_number <= 64:
            raise SettingOutOfRange(self._name, "f-number", f_number, 0.5, 64.0, "")
        self._f_number = f_number

    @property
    def _name(self) -> str:
        return f"camera {self._identity.device_id}"

    def _first_settings(self) -> CameraSettings:
        shortest, longest = self._limits.exposure_s
        native = f"{'Mono' if self._filters is None else 'BayerRG'}{self.model.camera.bit_depth}"
        formats = self._limits.pixel_formats
        return CameraSettings(
            exposure_s=min(max(0.01, shortest), longest),
            gain_db=max(0.0, self._limits.gain_db[0]),
            black_level_dn=self.model.camera.black_level_dn or 0.0,
            pixel_format=native if native in formats else formats[0],
        )

    def _require_open(self) -> None:
        if not self._open:
            raise DeviceError(f"{self._name}: is not open; call open() or use it in a with statement")

    def _refuse(self, settings: CameraSettings) -> None:
        if settings.pixel_format not in self._limits.pixel_formats or settings.pixel_format not in _BITS:
            raise DeviceError(
                f"{self._name}: has no pixel format {settings.pixel_format!r}; it has "
                + ", ".join(name for name in self._limits.pixel_formats if name in _BITS)
            )
        scale = 2.0 ** (_BITS[settings.pixel_format] - self.model.camera.bit_depth)
        low, high = self._limits.black_level_dn
        limits = replace(self._limits, black_level_dn=(low * scale, high * scale))
        refuse_out_of_range(self._name, settings, limits)
        if settings.binning not in range(1, _LARGEST_BINNING + 1):
            raise SettingOutOfRange(self._name, "binning", settings.binning, 1, _LARGEST_BINNING, "px")
        if settings.roi is not None:
            width, height = self._limits.width // settings.binning, self._limits.height // settings.binning
            refuse_roi_outside(self._name, settings.roi, width, height)

    def _expose(self) -> Frame:
        settings = FrameSettings(
            exposure_s=self._settings.exposure_s,
            gain_db=self._settings.gain_db,
            f_number=self._f_number,
            black_level_dn=self._settings.black_level_dn,
            temperature_c=self._temperature_c,
            timestamp_s=self.clock.now_s(),
            source_level=self._source_level,
            pattern=self._pattern,
            shutter="closed" if self._closed_shutter else "open",
        )
        bits, roi = _BITS[self._settings.pixel_format], self._settings.roi
        light = 1.0 if self._modulation is None else self._modulation.mean(self.clock.now_s(), settings.exposure_s)
        dn = self._sensor.expose(
            replace(settings, source_level=light * self._source_level),
            output_bit_depth=bits,
            binning=self._settings.binning,
            frame_index=self._since_change,
        )
        if roi is not None:
            dn = dn[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width].copy()
        # Rows are read one after the other: fewer of them come faster.
        share = 1.0 if roi is None else roi.height / self._limits.height
        self.clock.advance(max(settings.exposure_s, share * _READOUT_S))
        self._since_change += 1
        self._counted += 1
        return Frame(dn, bits, settings, frame_id=self._counted - 1)


def default_limits() -> CameraCapabilities:
    """Return the limits of the BFS-U3-19S4M with a shutter. Raises ConfigurationError if its preset is damaged."""
    preset = CameraPreset.shipped("BFS-U3-19S4M")
    return preset.require_limits("BFS-U3-19S4M").capabilities(has_shutter=True)

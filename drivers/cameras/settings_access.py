"""A GenICam camera's settings in the units of this project: s, dB and DN; checked before and read back after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from drivers.cameras.camera_quirks import CameraQuirks
from drivers.cameras.feature_access import FeatureAccess, Refusal
from drivers.cameras.pixel_unpacking import RAW_FORMATS
from radiometer.devices import CameraCapabilities, CameraSettings, Roi, refuse_out_of_range, refuse_roi_outside
from radiometer.errors import DeviceError, SettingOutOfRange

_TRIGGER_STEPS: Final = (("TriggerSelector", "FrameStart"), ("TriggerSource", "Software"), ("TriggerMode", "On"))


def bit_depth_of(format_name: str, quirks: CameraQuirks) -> int:
    """Return the bits of a digital number in a pixel format, once it is right-aligned."""
    if format_name == "Mono16" and quirks.mono16_left_aligned_bits:
        return quirks.mono16_left_aligned_bits
    return RAW_FORMATS[format_name].bit_depth


@dataclass(frozen=True, slots=True)
class SettingsAccess:
    """Settings of one open camera."""

    camera: Any  # an `Aravis.Camera`
    features: FeatureAccess  # its features
    quirks: CameraQuirks  # how its family differs from the standard
    name: str  # how messages call it

    def capabilities(self, format_name: str) -> CameraCapabilities:
        """Return the limits in s, dB and DN; the black level's are those of the given pixel format."""
        call, camera = self.features.call, self.camera
        shortest_us, longest_us = call(camera.get_exposure_time_bounds)
        offered = call(camera.dup_available_pixel_formats_as_strings)
        width, height = self._sensor_size()
        return CameraCapabilities(
            exposure_s=(shortest_us * 1e-6, longest_us * 1e-6),
            gain_db=self._bounds("is_gain_available", "get_gain_bounds", self.quirks.gain_db_per_unit),
            black_level_dn=self._bounds(
                "is_black_level_available", "get_black_level_bounds", self.black_level_scale(format_name)
            ),
            pixel_formats=tuple(name for name in RAW_FORMATS if name in offered),
            width=width,
            height=height,
            has_temperature=self.features.has("DeviceTemperature"),
            exposure_step_s=self._exposure_step_s(),
        )

    def check(self, settings: CameraSettings) -> None:
        """Raise SettingOutOfRange or DeviceError for what the camera cannot do; nothing is written."""
        limits = self.capabilities(self._usable(settings.pixel_format))
        if settings.pixel_format not in limits.pixel_formats:
            raise DeviceError(
                f"{self.name}: pixel format {settings.pixel_format} is not offered; "
                f"choose one of {', '.join(limits.pixel_formats)}"
            )
        refuse_out_of_range(self.name, settings, limits)
        low, high = self._binning_bounds()
        if not low <= settings.binning <= high:
            raise SettingOutOfRange(self.name, "binning", settings.binning, low, high, "pixels")
        if settings.software_trigger and not self.camera.is_software_trigger_supported():
            raise DeviceError(f"{self.name}: has no software trigger; leave software_trigger off")
        if settings.roi is not None:
            self._check_roi(settings.roi, limits.width // settings.binning, limits.height // settings.binning)

    def write(self, settings: CameraSettings) -> None:
        """Write settings that `check` has let pass; the acquisition must be stopped."""
        call, camera = self.features.call, self.camera
        self._write_trigger(on=False)
        if self._binning_bounds()[1] > 1:
            call(camera.set_binning, settings.binning, settings.binning)
        call(camera.set_pixel_format_from_string, settings.pixel_format)
        width, height = self._sensor_size()
        roi = settings.roi or Roi(0, 0, width // settings.binning, height // settings.binning)
        call(camera.set_region, roi.x, roi.y, roi.width, roi.height)
        if camera.is_gain_available():
            call(camera.set_gain, settings.gain_db / self.quirks.gain_db_per_unit)
        if camera.is_black_level_available():
            scale = self.black_level_scale(settings.pixel_format)
            call(camera.set_black_level, settings.black_level_dn / scale)
        call(camera.set_exposure_time, settings.exposure_s * 1e6)
        if settings.software_trigger:
            self._write_trigger(on=True)

    def read(self) -> CameraSettings:
        """Return the settings as the camera reports them."""
        call, camera = self.features.call, self.camera
        format_name = str(call(camera.get_pixel_format_as_string))
        scale = self.black_level_scale(self._usable(format_name))
        region, binning = call(camera.get_region), self._binning()
        width, height = self._sensor_size()
        whole = (region.x, region.y, region.width, region.height) == (0, 0, width // binning, height // binning)
        return CameraSettings(
            exposure_s=_without_dust(call(camera.get_exposure_time) * 1e-6),
            gain_db=_without_dust(self._read_if("gain") * self.quirks.gain_db_per_unit),
            black_level_dn=_without_dust(self._read_if("black_level") * scale),
            pixel_format=format_name,
            roi=None if whole else Roi(region.x, region.y, region.width, region.height),
            binning=binning,
            software_trigger=self.features.read_if_there("TriggerMode", str) == "On",
        )

    def _read_if(self, setting: str) -> float:
        if not getattr(self.camera, f"is_{setting}_available")():
            return 0.0
        return float(self.features.call(getattr(self.camera, f"get_{setting}")))

    def _usable(self, format_name: str) -> str:
        return format_name if format_name in RAW_FORMATS else "Mono8"

    def _bounds(self, available: str, bounds: str, scale: float) -> tuple[float, float]:
        if not getattr(self.camera, available)():
            return (0.0, 0.0)
        low, high = self.features.call(getattr(self.camera, bounds))
        return (float(low * scale), float(high * scale))

    def black_level_scale(self, format_name: str) -> float:
        """Return the DN of a pixel format in a unit of the camera's black level feature."""
        if self.quirks.black_level_dn_per_unit is not None:
            return self.quirks.black_level_dn_per_unit
        if self.features.unit("BlackLevel") == "%":  # of full scale, as FLIR counts it
            return ((1 << bit_depth_of(format_name, self.quirks)) - 1) / 100.0
        return 1.0

    def _exposure_step_s(self) -> float:
        if not self.features.has("ExposureTime"):
            return 0.0
        try:
            step_us = float(self.features.call(self.camera.get_float_increment, "ExposureTime"))
        except Refusal:  # its description states no step
            return 0.0
        return step_us * 1e-6 if 1e-6 < step_us < 1e6 else 0.0  # the library reports extremes where there is none

    def _sensor_size(self) -> tuple[int, int]:
        if self.features.has("WidthMax") and self._binning() == 1:
            return int(self.features.read("WidthMax", int)), int(self.features.read("HeightMax", int))
        size = self.features.call(self.camera.get_sensor_size)
        return int(size.width), int(size.height)

    def _binning(self) -> int:
        if not self.camera.is_binning_available():
            return 1
        binning = self.features.call(self.camera.get_binning)
        if binning.dx != binning.dy:
            raise DeviceError(
                f"{self.name}: bins {binning.dx} × {binning.dy} pixels; set BinningHorizontal and BinningVertical alike"
            )
        return max(1, int(binning.dx))

    def _binning_bounds(self) -> tuple[int, int]:
        if not self.camera.is_binning_available():
            return (1, 1)
        low, high = self.features.call(self.camera.get_x_binning_bounds)
        return int(low), int(high)

    def _check_roi(self, roi: Roi, width: int, height: int) -> None:
        refuse_roi_outside(self.name, roi, width, height)
        for name, value, increment in (
            ("OffsetX", roi.x, "get_x_offset_increment"),
            ("OffsetY", roi.y, "get_y_offset_increment"),
            ("Width", roi.width, "get_width_increment"),
            ("Height", roi.height, "get_height_increment"),
        ):
            step = max(1, int(self.features.call(getattr(self.camera, increment))))
            if value % step:
                raise DeviceError(
                    f"{self.name}: {name} {value} pixels must be a multiple of {step}; choose another region"
                )

    def _write_trigger(self, *, on: bool) -> None:
        # One by one, in this order, each read back: some cameras drop them when written otherwise (aravis issue 1045).
        for feature, value in (("TriggerMode", "Off"), *(_TRIGGER_STEPS if on else ())):
            if not self.features.has(feature):
                continue
            if self.features.write(feature, value) != value:
                raise DeviceError(
                    f"{self.name}: {feature} did not take the value {value}; switch the camera off and on"
                )


def _without_dust(value: float) -> float:
    """Return a value without the last digits that a change of unit leaves (0.005000000000000001 s)."""
    return float(f"{value:.12g}")

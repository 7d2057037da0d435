"""Camera files (`configs/cameras/*.yaml`): what a camera is believed to be, its limits, the source of each figure."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import Field, model_validator

from radiometer.data import CameraDescription, SpectralResponse
from radiometer.data.storage import read_yaml, shipped_config
from radiometer.data.validation import ConfigSection, Side, refuse_large_frame, validate
from radiometer.devices.camera import CameraCapabilities
from radiometer.errors import CalibrationError, ConfigurationError

FORMAT: Final = "radiometer-camera/1"
_CAMERA_KEYS: Final = frozenset(CameraDescription.model_fields)


class CameraLimits(ConfigSection):
    """Limits of a camera model in a camera file; ranges are [lowest, highest]."""

    width: Side
    height: Side
    exposure_s: tuple[float, float]
    gain_db: tuple[float, float] = (0.0, 0.0)
    black_level_dn: tuple[float, float] = (0.0, 0.0)
    pixel_formats: tuple[str, ...] = Field(("Mono12",), min_length=1)
    has_temperature: bool = False
    has_shutter: bool = False
    exposure_step_s: float = Field(0.0, ge=0)
    frame_rate_hz: float | None = Field(None, gt=0)

    @model_validator(mode="after")
    def _ordered(self) -> CameraLimits:
        for name in ("exposure_s", "gain_db", "black_level_dn"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"limits.{name}: the lowest value {low:g} is above the highest {high:g}")
        if self.exposure_s[0] <= 0:
            raise ValueError("limits.exposure_s: the shortest exposure must be above 0 s")
        refuse_large_frame(self.width, self.height)
        return self

    def capabilities(self, *, has_shutter: bool | None = None) -> CameraCapabilities:
        """Return the limits in the form that devices use.

        Args:
            has_shutter: Overrides the file's word (a simulated camera always has one).
        """
        shared = self.model_dump(exclude={"frame_rate_hz", "has_shutter"})
        return CameraCapabilities(**shared, has_shutter=self.has_shutter if has_shutter is None else has_shutter)


class CameraPreset(ConfigSection):
    """A camera file: description, limits (absent in a characterisation of a capture set) and sources.

    `uncertainties` are what calibrations of such a camera state of readings, by the names of a calibration file.
    """

    format: str = Field(pattern=f"^{FORMAT}$")
    camera: CameraDescription
    limits: CameraLimits | None = None
    sources: dict[str, str] = Field(default_factory=dict)
    uncertainties: dict[str, float] = Field(default_factory=dict)
    spectral_response: SpectralResponse | None = None
    emva1288: dict[str, Any] = Field(default_factory=dict)  # figures of a characterisation
    taps: list[Any] = Field(default_factory=list)  # the same of each tap
    crosstalk: list[Any] = Field(default_factory=list)  # between taps
    provenance: dict[str, Any] = Field(default_factory=dict)

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str) -> CameraPreset:
        """Return the preset that a mapping describes.

        Raises:
            ConfigurationError: If a key is missing or unknown, or a value is not allowed; the message names it.
        """
        preset = validate(cls, mapping, where, ConfigurationError)
        for key in preset.camera.model_extra or {}:
            raise ConfigurationError(
                f"{where}: unknown key 'camera.{key}'; allowed here: {', '.join(sorted(_CAMERA_KEYS))}"
            )
        return preset

    @classmethod
    def read(cls, path: Path) -> CameraPreset:
        """Return the preset in a YAML file. Raises InputError or ConfigurationError saying what is wrong where."""
        return cls.from_mapping(read_yaml(path), str(path))

    @classmethod
    def shipped(cls, model: str) -> CameraPreset:
        """Return the preset that comes with the product for a camera model, such as "BFS-U3-19S4M".

        Raises:
            ConfigurationError: If there is none; the message lists those that there are.
        """
        return cls.read(shipped_config(f"cameras/{model}.yaml"))

    def applied_to(self, camera: CameraDescription, where: str) -> CameraDescription:
        """Return a camera's description with this file's figures of gain, noise, darkness and saturation in it.

        Args:
            camera: The camera as a capture or device describes it.

        Raises:
            CalibrationError: If the file is of another camera, bit depth or colour.
        """
        for name in ("model", "serial", "bit_depth", "mosaic", "channel"):
            mine, theirs = getattr(self.camera, name), getattr(camera, name)
            if mine is not None and mine != theirs and (theirs is not None or name == "mosaic"):
                what = "colour" if name == "channel" else "camera"
                raise CalibrationError(
                    f"{where} is of another {what}: its {name} is {mine}, in use is {theirs}; "
                    f"use this {what}'s own file, or make one with `radiometer characterise`"
                )
        kept = {"vendor", "model", "serial", "bit_depth", "mosaic", "channel"}
        kept |= {"quantum_efficiency"} if camera.channel != self.camera.channel else set()
        kept |= {"pixel_spacing_um"} if camera.pixel_spacing_um is not None else set()  # of pixels as they are read
        stated = self.camera.model_dump(exclude_none=True, exclude=kept)
        return camera.model_copy(update={name: getattr(self.camera, name) for name in stated})

    def figure_u_rel(self, symbol: str) -> float | None:
        """Return the relative standard uncertainty of a characterised figure by its EMVA 1288 symbol, such as "R".

        Returns:
            None where the file is a datasheet's, or the figure was not measured.
        """
        figures = self.emva1288.get("figures", {})
        found = figures.get(symbol)
        return None if not found or not found.get("value") else abs(found["u"] / found["value"])

    def require_limits(self, where: str) -> CameraLimits:
        """Return the limits. Raises ConfigurationError if the file has none."""
        if self.limits is None:
            raise ConfigurationError(f"{where}: key 'limits' is missing; a camera to be simulated needs it")
        return self.limits

"""Contents of a bench file: camera, lens, scene, calibration, and the place of the patch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from radiometer.data import LensDescription, Patch, PatchDescription, SourceDescription
from radiometer.data.storage import read_yaml, shipped_config
from radiometer.data.validation import ConfigSection, Side, refuse_large_frame, validate, within
from radiometer.errors import ConfigurationError, InputError

DEFAULT_BENCH = "bench-simulated.yaml"
SIMULATED = "sim"


class FlickerConfig(ConfigSection):
    """How a simulated light changes in time: a sine, or a square wave of a duty."""

    frequency_Hz: float = Field(gt=0, le=1e6, description="Frequency in Hz.")  # noqa: N815 (the file's key)
    modulation: float = Field(1.0, ge=0, le=1, description="Modulation of the sine; 1 is down to darkness.")
    duty: float = Field(0.0, ge=0, lt=1, description="Lit share of a square wave; 0 for a sine.")


class SimulatedCameraConfig(ConfigSection):
    """A simulated camera: datasheet preset, serial number, random seed, temperature and settings at power-on."""

    kind: Literal["simulated"] = Field(description="A simulated camera.")
    preset: str = Field(description="Shipped preset by model, such as `BFS-U3-19S4M`, or a camera file.")
    serial: str = Field("22500001", description="Serial number that it states.")
    seed: int = Field(1, ge=0, description="Makes its noise and fixed pattern.")
    temperature_C: float = Field(  # noqa: N815 (the file's key)
        40.0, ge=-40, le=120, description="Temperature of the sensor in °C."
    )
    black_level_dn: float = Field(64.0, ge=0, description="Black level at power-on in DN.")
    gain_db: float = Field(0.0, ge=0, description="Gain at power-on in dB.")
    pixel_format: str = Field("Mono12", description="GenICam pixel format.")
    width: Side | None = Field(None, description="Width in pixels; the preset's by default.")
    height: Side | None = Field(None, description="Height in pixels; the preset's by default.")
    model: str | None = Field(None, description="Camera model with hidden effects, such as `reconcile -o` writes.")
    flicker: FlickerConfig | None = Field(None, description="How the light changes in time; steady by default.")

    @model_validator(mode="after")
    def _has_pixels_of_a_sensor(self) -> Self:
        if self.width is not None and self.height is not None:
            refuse_large_frame(self.width, self.height)
        return self


def _as_text(value: object) -> object:
    """Return a serial number that YAML read as a whole number as it was written, as far as this can be recovered."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class GenicamCameraConfig(ConfigSection):
    """A real camera: GenICam by id, serial number or address, any other kind by its path, number or port.

    `preset` is given where the model's own is not to be used.
    """

    kind: Literal["genicam", "v4l2", "picamera", "gphoto2"] = Field(
        description="What drives it: `genicam` for GigE Vision and USB3 Vision."
    )
    id: Annotated[str | None, BeforeValidator(_as_text)] = Field(
        None, description="Serial number, address or path that `radiometer devices` lists; the only camera by default."
    )
    preset: str | None = Field(None, description="Camera file, where the model's own preset is not to be used.")
    black_level_dn: float = Field(64.0, ge=0, description="Black level to set in DN.")
    gain_db: float = Field(0.0, ge=0, description="Gain to set in dB.")
    pixel_format: str = Field("Mono12", description="GenICam pixel format, such as `Mono12p` or `BayerRG12`.")


CameraConfig = Annotated[SimulatedCameraConfig | GenicamCameraConfig, Field(discriminator="kind")]


class LensConfig(LensDescription):
    """The lens in front of the camera: as capture sets record it, with its focal length and f-number."""

    model_config = ConfigDict(extra="forbid")
    focal_length_mm: float = Field(gt=0, description="Focal length in mm.")
    f_number: Annotated[float, within("f_number")] = Field(description="f-number that it is set to.")

    @property
    def description(self) -> LensDescription:
        """Return the lens as capture sets record it; what the bench does not state is left out."""
        return LensDescription.model_validate(self.model_dump(exclude_unset=True))


class PatchConfig(ConfigSection):
    """A region of the frame in pixels."""

    x: int = Field(ge=0, description="Left edge.")
    y: int = Field(ge=0, description="Upper edge.")
    width: Side = Field(description="Width.")
    height: Side = Field(description="Height.")

    @property
    def patch(self) -> Patch:
        """Return the region as a Patch."""
        return Patch(self.x, self.y, self.width, self.height)


class BenchConfig(ConfigSection):
    """The whole of a bench file."""

    format: Literal["radiometer-bench/1"] = Field("radiometer-bench/1", description="Name and version of the form.")
    name: str = Field("bench", description="What the bench is called.")
    camera: CameraConfig = Field(description="The camera.")
    lens: LensConfig | None = Field(description="The lens; `null` is one of which nothing is known.")
    scene: dict[str, Any] | None = Field(None, description="What a simulated camera looks at: `kind` and its keys.")
    source: SourceDescription = Field(SourceDescription(), description="The light source.")
    calibration: str | None = Field(None, description="Calibration file, from the folder of the bench file.")
    spectrum: str | None = Field(None, description="Spectrum of the light: a name such as `white_led`, or a CSV.")
    patch: PatchConfig | None = Field(None, description="The region that is measured; the middle by default.")
    patches: tuple[PatchDescription, ...] = Field(
        (), description="Regions of even light and their radiances as far as known, for `reconcile` and `quality`."
    )
    time_limit_s: float = Field(60.0, gt=0, description="Longest time of one reading in s.")

    @property
    def lens_description(self) -> LensDescription:
        """Return the lens as capture sets record it; all unknown where the bench does not know it."""
        return self.lens.description if self.lens else LensDescription()


def read_bench(path: Path | None = None, camera: str | None = None) -> tuple[BenchConfig, Path]:
    """Return a validated bench file and its path; the simulated bench where neither file nor camera is named.

    Args:
        camera: Name of a camera. A real one without a bench file stands on no bench: its lens, what it looks at and
            its calibration are unknown, and stay so.

    Raises:
        ConfigurationError: If the file is missing or holds something not allowed.
    """
    if path is None and camera is not None and camera != SIMULATED:
        return BenchConfig(name="no bench", camera=GenicamCameraConfig(kind="genicam", id=camera), lens=None), Path()
    file = path or shipped_config(DEFAULT_BENCH)
    try:
        mapping = read_yaml(file)
    except InputError as error:
        raise ConfigurationError(str(error)) from error
    return validate(BenchConfig, mapping, str(file), ConfigurationError), file

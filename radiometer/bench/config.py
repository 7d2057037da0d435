"""Contents of a bench file: camera, lens, scene, calibration, and the place of the patch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field

from radiometer.data import LensDescription, Patch, PatchDescription, SourceDescription
from radiometer.data.config_files import shipped_config
from radiometer.data.storage import read_yaml
from radiometer.data.validation import ConfigSection, validate
from radiometer.errors import ConfigurationError, InputError

DEFAULT_BENCH = "bench-simulated.yaml"
SIMULATED = "sim"


class FlickerConfig(ConfigSection):
    """How a simulated light changes in time: a sine, or a square wave of a duty."""

    frequency_Hz: float = Field(gt=0, le=1e6)  # noqa: N815 (the file's key)
    modulation: float = Field(1.0, ge=0, le=1)
    duty: float = Field(0.0, ge=0, lt=1)


class SimulatedCameraConfig(ConfigSection):
    """A simulated camera: datasheet preset, serial number, random seed, temperature and settings at power-on."""

    kind: Literal["simulated"]
    preset: str
    serial: str = "22500001"
    seed: int = Field(1, ge=0)
    temperature_C: float = Field(40.0, ge=-40, le=120)  # noqa: N815 (the file's key)
    black_level_dn: float = Field(64.0, ge=0)
    gain_db: float = Field(0.0, ge=0)
    pixel_format: str = "Mono12"
    width: int | None = Field(None, gt=0)
    height: int | None = Field(None, gt=0)
    model: str | None = None
    flicker: FlickerConfig | None = None


def _as_text(value: object) -> object:
    """Return a serial number that YAML read as a whole number as it was written, as far as this can be recovered."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class GenicamCameraConfig(ConfigSection):
    """A real camera: GenICam by id, serial number or address, any other kind by its path, number or port.

    `preset` is given where the model's own is not to be used.
    """

    kind: Literal["genicam", "v4l2", "picamera", "gphoto2"]
    id: Annotated[str | None, BeforeValidator(_as_text)] = None
    preset: str | None = None
    black_level_dn: float = Field(64.0, ge=0)
    gain_db: float = Field(0.0, ge=0)
    pixel_format: str = "Mono12"


CameraConfig = Annotated[SimulatedCameraConfig | GenicamCameraConfig, Field(discriminator="kind")]


class LensConfig(LensDescription):
    """The lens in front of the camera: as capture sets record it, with its focal length and f-number."""

    model_config = ConfigDict(extra="forbid")
    focal_length_mm: float = Field(gt=0)
    f_number: float = Field(gt=0)

    @property
    def description(self) -> LensDescription:
        """Return the lens as capture sets record it; what the bench does not state is left out."""
        return LensDescription.model_validate(self.model_dump(exclude_unset=True))


class PatchConfig(ConfigSection):
    """A region of the frame in pixels."""

    x: int = Field(ge=0)
    y: int = Field(ge=0)
    width: int = Field(gt=0)
    height: int = Field(gt=0)

    @property
    def patch(self) -> Patch:
        """Return the region as a Patch."""
        return Patch(self.x, self.y, self.width, self.height)


class BenchConfig(ConfigSection):
    """The whole of a bench file.

    `patches` are regions of even light and their radiances, as far as known, for `radiometer reconcile`; `patch` is
    the one that is measured. `lens: null` is a lens of which nothing is known.
    """

    format: Literal["radiometer-bench/1"] = "radiometer-bench/1"
    name: str = "bench"
    camera: CameraConfig
    lens: LensConfig | None
    scene: dict[str, Any] | None = None
    source: SourceDescription = SourceDescription()
    calibration: str | None = None
    spectrum: str | None = None
    patch: PatchConfig | None = None
    patches: tuple[PatchDescription, ...] = ()
    time_limit_s: float = Field(60.0, gt=0)

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

"""A calibration: everything that turns digital numbers of one camera into radiance, in one file."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import AwareDatetime, Field

from radiometer.data.calibration_sections import (
    BlackLevel,
    FlatField,
    FoundEffects,
    Scale,
    SpectralResponse,
    StatedUncertainties,
)
from radiometer.data.capture_header import CameraDescription, LensDescription
from radiometer.data.provenance import Provenance, utc_now
from radiometer.data.response_curve import ResponseCurve
from radiometer.data.sensor_noise import SensorNoise
from radiometer.data.storage import read_yaml, write_yaml_atomic
from radiometer.data.validation import FileSection, validate
from radiometer.errors import CalibrationError

FORMAT = "radiometer-calibration/1"
DEFAULT_VALIDITY_DAYS = 365.0


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The calibration of one camera with one lens.

    Attributes:
        camera: The camera it belongs to.
        lens: The lens it was made with.
        scale: Exposure in J·m⁻² per unit of the linear signal.
        response: Response curve; None for a sensor that is taken as linear above its black level.
        noise: Noise model that samples are weighted by.
        black_level: Black level and its uncertainty.
        flat_field: Sensitivity over the picture; None where none was made.
        spectrum: Name of the spectrum that the source is taken to have, or path of a CSV.
        spectral_response: Spectral responsivity of the camera; None where unknown.
        uncertainties: What else the user states.
        found: What `radiometer reconcile` found of the camera and readings are corrected for.
        defects: Positions (x, y) of defective pixels.
        created: ISO 8601 time in UTC.
        validity_days: Days after which a reading carries the flag `stale_calibration`.
        provenance: Method, inputs, assumptions.
    """

    camera: CameraDescription
    lens: LensDescription
    scale: Scale
    response: ResponseCurve | None
    noise: SensorNoise
    black_level: BlackLevel = field(default_factory=BlackLevel)
    flat_field: FlatField | None = None
    spectrum: str = "equal_energy"
    spectral_response: SpectralResponse | None = None
    uncertainties: StatedUncertainties = field(default_factory=StatedUncertainties)
    found: FoundEffects = field(default_factory=FoundEffects)
    defects: tuple[tuple[int, int], ...] = ()
    created: str = field(default_factory=utc_now)
    validity_days: float = DEFAULT_VALIDITY_DAYS
    provenance: Provenance = field(default_factory=lambda: Provenance("unknown"))

    def __post_init__(self) -> None:
        if self.response is not None and self.response.bit_depth != self.camera.bit_depth:
            raise CalibrationError(
                f"the response curve has {self.response.bit_depth} bits, the camera {self.camera.bit_depth}; "
                "recover the curve from frames of this camera's pixel format"
            )

    @property
    def absolute(self) -> bool:
        """Return whether readings come out in W·sr⁻¹·m⁻²."""
        return self.scale.method != "relative"

    def is_stale(self, now: dt.datetime) -> bool:
        """Return whether the calibration is older at `now` (with time zone) than its validity."""
        return (now - dt.datetime.fromisoformat(self.created)).total_seconds() > self.validity_days * 86400.0

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping that is written to the file."""
        return {
            "format": FORMAT,
            "created": self.created,
            "validity_days": self.validity_days,
            "camera": self.camera.model_dump(mode="json", exclude_none=True),
            "lens": self.lens.model_dump(mode="json", exclude_none=True),
            "scale": self.scale.model_dump(mode="json", exclude_none=True),
            "black_level": self.black_level.model_dump(mode="json"),
            "noise": {**asdict(self.noise), "assumed": list(self.noise.assumed)},
            "flat_field": self.flat_field.model_dump(mode="json") if self.flat_field else None,
            "spectrum": self.spectrum,
            "spectral_response": self.spectral_response.model_dump(mode="json") if self.spectral_response else None,
            "uncertainties": self.uncertainties.model_dump(mode="json"),
            "found": self.found.model_dump(mode="json"),
            "defects": [list(position) for position in self.defects],
            "provenance": self.provenance.to_mapping(),
            "response": _compact(self.response.to_mapping()) if self.response else None,
        }

    def write(self, path: Path) -> None:
        """Write the calibration as one YAML file, whole or not at all.

        Raises:
            OutputError: If the file cannot be written.
        """
        write_yaml_atomic(path, self.to_mapping())

    @classmethod
    def read(cls, path: Path) -> Calibration:
        """Return the calibration in a file.

        Raises:
            InputError: If the file cannot be read, or is not YAML.
            CalibrationError: If it is no calibration; the message names the key, the value and what is allowed.
        """
        return cls.from_mapping(read_yaml(path), str(path))

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str) -> Calibration:
        """Return the calibration that a file's mapping describes.

        Args:
            mapping: Keys and values of the file.
            where: File name for messages.

        Raises:
            CalibrationError: If a key is missing, wrong, or the parts do not fit together.
        """
        if mapping.get("format") != FORMAT:
            raise CalibrationError(f"{where}: format is {mapping.get('format')!r}; expected {FORMAT!r}")
        stored = validate(_CalibrationFile, mapping, where, CalibrationError)
        response = stored.response
        return cls(
            camera=stored.camera,
            lens=stored.lens,
            scale=stored.scale,
            response=None if response is None else ResponseCurve.from_mapping(_expanded(response, where), where),
            noise=stored.noise.model(),
            black_level=stored.black_level,
            flat_field=stored.flat_field,
            spectrum=stored.spectrum,
            spectral_response=stored.spectral_response,
            uncertainties=stored.uncertainties,
            found=stored.found,
            defects=stored.defects,
            created=stored.created.isoformat(),
            validity_days=stored.validity_days,
            provenance=Provenance.from_mapping(stored.provenance, where),
        )


class _NoiseSection(FileSection):
    conversion_gain_e_per_dn: float = Field(gt=0)
    read_noise_e: float = Field(ge=0)
    post_curve_dn2: float = Field(0.0, ge=0)
    dark_current_e_per_s: float = Field(0.0, ge=0)
    dark_reference_c: float = 25.0
    dark_doubling_k: float = Field(7.0, gt=0)
    full_well_e: float = Field(10_000.0, gt=0)
    assumed: tuple[str, ...] = ()

    def model(self) -> SensorNoise:
        return SensorNoise(**self.model_dump(include=set(type(self).model_fields)))


class _CalibrationFile(FileSection):
    created: AwareDatetime
    validity_days: float = Field(DEFAULT_VALIDITY_DAYS, gt=0)
    camera: CameraDescription
    lens: LensDescription = LensDescription()
    scale: Scale
    black_level: BlackLevel = BlackLevel()
    noise: _NoiseSection
    flat_field: FlatField | None = None
    spectrum: str = "equal_energy"
    spectral_response: SpectralResponse | None = None
    uncertainties: StatedUncertainties = StatedUncertainties()
    found: FoundEffects = FoundEffects()
    defects: tuple[tuple[int, int], ...] = ()
    provenance: dict[str, Any] = Field(default_factory=dict)
    response: dict[str, Any] | None = None


def _compact(response: dict[str, Any]) -> dict[str, Any]:
    """Write each table as one text of numbers: a 12-bit curve then loads in milliseconds, as text a person can read."""
    tables = ("log_exposure", "u_log_exposure")
    return {key: " ".join(f"{v:.9g}" for v in value) if key in tables else value for key, value in response.items()}


def _expanded(response: Mapping[str, Any], where: str) -> dict[str, Any]:
    expanded = dict(response)
    for key in ("log_exposure", "u_log_exposure"):
        text = expanded.get(key)
        if isinstance(text, str):
            try:
                expanded[key] = np.array(text.split(), dtype=np.float64)
            except ValueError as error:
                raise CalibrationError(f"{where}: response.{key}: {error}") from error
    return expanded

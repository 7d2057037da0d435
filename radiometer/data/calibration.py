"""A calibration: all that turns digital numbers of one camera into radiance, in one file with what a user states."""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AwareDatetime, Field, model_validator

from radiometer.data.capture_header import CameraDescription, LensDescription
from radiometer.data.json_text import json_text
from radiometer.data.provenance import Provenance, is_out_of_date, utc_now
from radiometer.data.response_curve import ResponseCurve
from radiometer.data.sensor_noise import SensorNoise
from radiometer.data.storage import read_yaml, write_yaml_atomic
from radiometer.data.validation import ConfigSection, Side, validate, within
from radiometer.errors import CalibrationError

ScaleMethod = Literal["known_radiance", "light_meter_k", "datasheet", "relative"]
FORMAT = "radiometer-calibration/1"
DEFAULT_VALIDITY_DAYS = 365.0  # a year, the usual interval of instruments


class ScaleConditions(ConfigSection):
    """What a scale was got under: what a reading shares with it drops out of the reading's uncertainty."""

    # Mean of 1/t over the exposures in s⁻¹, by their part in the value; 0 for long ones
    inverse_exposure_per_s: float = Field(0.0, ge=0)
    gain_db: Annotated[float, within("gain")] = 0.0  # analogue gain in dB
    temperature_c: Annotated[float | None, within("temperature")] = None  # sensor temperature in °C; None where unknown
    level: float = Field(0.5, ge=0)  # signal as a part of full scale
    # Sensitivity at the patch relative to the optical axis, as it was reckoned with
    sensitivity: float = Field(1.0, gt=0)
    field: float = Field(0.0, ge=0)  # distance of the patch from the axis over that of a corner
    surround: float = Field(1.0, ge=0)  # mean radiance of the whole picture over that of the patch
    polarised: bool | None = None  # whether the source was polarised; None where unknown
    tap: str | None = None  # name of the tap that read the patch; None where the camera has one, or several read it
    channel: str | None = None  # colour that it was read in, such as "green"; None where there is none


class Scale(ConfigSection):
    """What turns the linear signal into exposure on the sensor: H = value · f(M)."""

    # J·m⁻² per unit of the linear signal: per exp(g) with a response curve, else per DN above black at 0 dB
    value: Annotated[float, within("scale")]
    u_rel: float = Field(ge=0)  # relative standard uncertainty
    method: ScaleMethod  # how it was got
    degrees_of_freedom: float | None = Field(None, gt=0)  # of the uncertainty; None for infinitely many
    # f-number it was got at; None where unknown (the lens is then part of the value)
    f_number: Annotated[float | None, within("f_number")] = None
    reference: str = ""  # what it was compared with, in words
    spectrum: str | None = None  # spectrum of what it was compared with; None where it is the calibration's
    # What of the reference was known: its radiance, or its luminance by way of its spectrum
    quantity: Literal["radiance", "luminance"] = "radiance"
    # Relative standard uncertainties that `u_rel` is made up from, by name
    budget: dict[str, float] = Field(default_factory=dict)
    # ISO speed as really measured, or as stated where that is all, at which the gain of photographs is 0 dB
    iso: Annotated[float | None, within("iso")] = None
    iso_stated: Annotated[float | None, within("iso")] = None  # that speed as the camera states it; None where unknown
    conditions: ScaleConditions = ScaleConditions()  # what it was got under
    unit: Literal["J m-2 per unit of signal"] = "J m-2 per unit of signal"  # of the value


class BlackLevel(ConfigSection):
    """Digital number without light, and its standard uncertainty in DN."""

    dn: float = 0.0  # black level in DN
    # Standard uncertainty in DN, of drift above all. Default: ±1 DN taken as a rectangle.
    u_dn: float = Field(0.58, ge=0)
    # Relative standard uncertainty of a dark signal that is modelled rather than measured. Default: a data sheet's dark
    # current is typical, single sensors have up to three times as much.
    dark_u_rel: float = Field(1.2, ge=0)


class SpectralResponse(ConfigSection):
    """The camera's spectral responsivity per watt, relative; 0 outside the wavelengths."""

    wavelength_nm: tuple[float, ...] = Field(min_length=2)  # ascending wavelengths in nm
    # Responsivity at each, 0 or more, not all 0
    relative: tuple[Annotated[float, Field(ge=0)], ...] = Field(min_length=2)
    u_rel: float = Field(0.02, ge=0)  # relative standard uncertainty of a correction made with it
    source: str = ""  # where it is from, in words

    @model_validator(mode="after")
    def _fits(self) -> Self:
        rising = all(a < b for a, b in pairwise(self.wavelength_nm))
        if len(self.wavelength_nm) != len(self.relative) or not rising or not any(self.relative):
            raise ValueError("needs one value per wavelength, wavelengths rising, and values not all 0")
        return self


class FlatField(ConfigSection):
    """Relative sensitivity over the picture: cos⁴α · (1 + k₂ρ² + k₄ρ⁴ + k₆ρ⁶), 1 at the principal point."""

    principal_point_px: tuple[float, float]  # (x, y) of the optical axis in pixels of the frame
    focal_length_px: float | None = Field(None, gt=0)  # focal length in pixels; None leaves cos⁴α out
    radius_px: float = Field(gt=0)  # radius at which ρ is 1
    coefficients: tuple[float, float, float] = (0.0, 0.0, 0.0)  # k₂, k₄, k₆
    u_rel: float = Field(0.0, ge=0)  # relative standard uncertainty of the correction at a pixel
    shape: tuple[Side, Side]  # (height, width) of the frames it was made from; it fits no other size
    f_number: Annotated[float | None, within("f_number")] = None  # f-number it was made at; vignetting changes with it

    def at(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the relative sensitivity at pixel positions, same shape as the broadcast of x and y."""
        r2 = (x_px - self.principal_point_px[0]) ** 2 + (y_px - self.principal_point_px[1]) ** 2
        rho2 = r2 / self.radius_px**2
        k2, k4, k6 = self.coefficients
        falloff = 1.0 + rho2 * (k2 + rho2 * (k4 + rho2 * k6))
        if self.focal_length_px is not None:
            falloff = falloff / (1.0 + r2 / self.focal_length_px**2) ** 2
        return np.asarray(falloff, dtype=np.float64)


class FoundEffects(ConfigSection):
    """What `radiometer reconcile` found of a camera and readings are corrected for; 0 where nothing was found."""

    exposure_offset_s: float = 0.0  # real exposure times beyond the stated ones in s
    exposure_further_s: float = 0.0  # as much more above the gain `exposure_above_db`
    exposure_above_db: Annotated[float, within("gain")] = 0.0  # that gain in dB
    black_offset_dn: float = 0.0  # real black level beyond the stated one in DN
    # What the gain amplifies of it, b·(m + c·m²) with m = gain over that of `black_from_db` − 1
    black_slope_dn: float = 0.0
    black_from_db: Annotated[float, within("gain")] = 0.0  # gain in dB from which on
    black_bend: float = 0.0  # c
    gain_error_rel: float = 0.0  # relative error of gains in dB: a stated G is really G·(1 + error)
    gains_db: Annotated[tuple[float, ...], within("gain")] = ()  # gains in dB at which a table holds a further error
    # Relative error of the gain factor at each; straight between them
    gain_errors_rel: tuple[Annotated[float, Field(gt=-1)], ...] = ()
    temperature_slope_per_k: float = 0.0  # relative change of the responsivity per K, from 25 °C
    temperature_bend_per_k2: float = 0.0  # the same per K²
    well_a2: float = Field(0.0, gt=-0.5, lt=0.5)  # S electrons are seen as S·(1 − a₂·z − a₃·z²), z = S over `well_e`
    well_a3: float = Field(0.0, gt=-0.5, lt=0.5)  # a₃
    well_e: float = Field(1.0, gt=0)  # electrons at z = 1
    glare: float = Field(0.0, gt=-0.5, lt=0.5)  # part of the picture's mean that the lens spreads over it
    names: tuple[str, ...] = ()  # effects that these represent

    @model_validator(mode="after")
    def _fits(self) -> Self:
        rising = all(a < b for a, b in pairwise(self.gains_db))
        if len(self.gains_db) != len(self.gain_errors_rel) or not rising:
            raise ValueError("gains_db and gain_errors_rel need one error per gain, gains rising")
        return self


class StatedUncertainties(ConfigSection):
    """Standard uncertainties that the user states or the program assumes, each with its default and its origin."""

    # Of exposure times, relative. Default: crystal oscillators with all their tolerances, 100 ppm.
    exposure_u_rel: float = Field(1e-4, ge=0)
    # Of exposure times in s, the same at every time. Default: ±5 µs taken as a rectangle, the order of the row time and
    # pulse delay that sensors leave undocumented; a fitted offset takes its place.
    exposure_u_s: float = Field(2.9e-6, ge=0)
    # Of the effective f-number, counted where it differs from the one of the scale. Default: 2 %, the tolerance of
    # marked stops (ISO 517).
    f_number_u_rel: float = Field(0.02, ge=0)
    # Of a radiance whose iris was turned and set to the same stop again. Default: 1 %, the play of a manual iris.
    iris_reset_u_rel: float = Field(0.01, ge=0)
    reseated_u_rel: float = Field(0.005, ge=0)  # of a radiance whose lens was taken off and on again. Default: 0.5 %
    # Of a radiance whose lens was focused anew. Default: 0.5 %, some 0.25 % of image distance.
    refocused_u_rel: float = Field(0.005, ge=0)
    magnification_u_rel: float = Field(0.1, ge=0)  # of the change of a stated magnification. Default: 10 %
    # Departure from a straight line where no response curve is given. Default: 0.1 %.
    linearity_u_rel: float = Field(1e-3, ge=0)
    # The same between levels a full scale apart. Default: 0.3 %, usual linearity errors of EMVA 1288 data sheets.
    bend_u_rel: float = Field(3e-3, ge=0)
    # Of a gain other than at calibration. Default: 1 %, usual of analogue stages.
    gain_step_u_rel: float = Field(0.01, ge=0)
    # Of the responsivity per K from the calibration's temperature. Default: 0.1 %/K, silicon in the red; less at short
    # wavelengths.
    temperature_u_rel_per_k: float = Field(1e-3, ge=0)
    # Of the responsivity per year since calibration. Default: 1 %, usual of luminance meters.
    drift_u_rel_per_year: float = Field(0.01, ge=0)
    # Of the part of the surround's light that the lens spreads over the picture. Default: veiling glare of 0 to 1.3 %,
    # as of sound lenses (ISO 9358), as the root of its mean square.
    glare_u: float = Field(7.5e-3, ge=0)
    # Of a polarised source where the calibration's was not, or the other way round. Default: 0.3 %, on the axis of a
    # lens without a beam splitter.
    polarisation_u_rel: float = Field(3e-3, ge=0)
    # Spread of responsivity from pixel to pixel, where too few pixels show it. Default: 1 %, the usual upper end of
    # EMVA 1288 data sheets.
    prnu_u_rel: float = Field(0.01, ge=0)
    # Of the natural fall-off cos⁴, as a part of it, where it was not measured. Default: 0.6, which reaches (k = 2) from
    # no fall-off at all to twice the natural one.
    falloff_u_rel: float = Field(0.6, ge=0)
    cos4_u_rel: float = Field(0.05, ge=0)  # the same where the lens description says that cos⁴ holds. Default: 0.05
    spectral_u_rel: float = Field(0.0, ge=0)  # from the difference between the assumed spectrum and that of the source
    # Of the luminous efficacy of the assumed spectrum, between luminance and radiance. Default: 0 for a stated
    # spectrum; `radiometer calibrate` puts 43 % where none is stated.
    efficacy_u_rel: float = Field(0.0, ge=0)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The calibration of one camera with one lens."""

    camera: CameraDescription  # the camera it belongs to
    lens: LensDescription  # the lens it was made with
    scale: Scale  # exposure in J·m⁻² per unit of the linear signal
    response: ResponseCurve | None  # response curve; None for a sensor that is taken as linear above its black level
    noise: SensorNoise  # noise model that samples are weighted by
    black_level: BlackLevel = field(default_factory=BlackLevel)  # black level and its uncertainty
    flat_field: FlatField | None = None  # sensitivity over the picture; None where none was made
    spectrum: str = "equal_energy"  # name of the spectrum that the source is taken to have, or path of a CSV
    spectral_response: SpectralResponse | None = None  # spectral responsivity of the camera; None where unknown
    uncertainties: StatedUncertainties = field(default_factory=StatedUncertainties)  # what else the user states
    # What `radiometer reconcile` found of the camera and readings are corrected for
    found: FoundEffects = field(default_factory=FoundEffects)
    defects: tuple[tuple[int, int], ...] = ()  # positions (x, y) of defective pixels
    created: str = field(default_factory=utc_now)  # ISO 8601 time in UTC
    validity_days: float = DEFAULT_VALIDITY_DAYS  # days after which a reading carries the flag `stale_calibration`
    provenance: Provenance = field(default_factory=lambda: Provenance("unknown"))  # method, inputs, assumptions

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
        """Return whether the calibration is older at `now` (with time zone) than its validity, or from the future."""
        return is_out_of_date(self.created, self.validity_days, now)

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

    def content_hash(self) -> str:
        """Return a hash of all that it states: equal means the same readings."""
        return hashlib.sha256(json_text(self.to_mapping(), sort_keys=True).encode()).hexdigest()[:16]

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


class _NoiseSection(ConfigSection):
    conversion_gain_e_per_dn: Annotated[float, within("conversion_gain")]
    read_noise_e: Annotated[float, within("read_noise")]
    post_curve_dn2: float = Field(0.0, ge=0)
    dark_current_e_per_s: float = Field(0.0, ge=0)
    dark_reference_c: Annotated[float, within("temperature")] = 25.0
    dark_doubling_k: Annotated[float, within("doubling")] = 7.0
    full_well_e: float = Field(10_000.0, gt=0)
    assumed: tuple[str, ...] = ()

    def model(self) -> SensorNoise:
        return SensorNoise(**self.model_dump(include=set(type(self).model_fields)))


class _CalibrationFile(ConfigSection):
    format: str
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

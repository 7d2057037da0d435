"""The colour calibration of a camera: matrices, their errors by kind of light, and the raw readings behind them."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AwareDatetime, BeforeValidator, Field, PlainSerializer, model_validator
from scipy.spatial import ConvexHull

from radiometer.analysis.colour.matrix import Fit, Training, of_rows
from radiometer.data import Calibration, CameraDescription, LensDescription, Provenance, Scale, ScaleConditions
from radiometer.data.sensor_noise import SensorNoise
from radiometer.data.storage import read_yaml, write_yaml_atomic
from radiometer.data.validation import FileArray, FileSection, validate
from radiometer.errors import CalibrationError, UsageError
from radiometer.typing import Array

FORMAT: Final = "radiometer-colour/1"
ALL: Final = "all"  # name of the matrix that serves every kind of light
_SURELY: Final = 2.0  # standard uncertainties beyond the hull of the training set


_Training = Annotated[
    Training | None, BeforeValidator(of_rows), PlainSerializer(lambda found: [] if found is None else found.rows())
]


class ColourCalibration(FileSection):
    """What turns the channels of one camera into X, Y, Z."""

    created: AwareDatetime = Field(default_factory=lambda: dt.datetime.now(dt.UTC))
    channels: tuple[str, ...] = Field(min_length=2)  # names in the order of the matrices' columns
    unit: Literal["cd m-2", "relative"]  # of X, Y, Z; relative where no light of known luminance took part
    u_rel: float = Field(ge=0)  # relative standard uncertainty that all known X, Y, Z share
    camera: CameraDescription
    lens: LensDescription = LensDescription()  # with its f-number
    conditions: ScaleConditions = ScaleConditions()  # gain and temperature of the frames of known lights
    iso: float | None = None  # lowest ISO speed of their photographs
    # Matrix by kind of light, or a single one named `ALL`
    matrices: dict[str, Fit] = Field(min_length=1)
    trained: tuple[str, ...] = Field(min_length=1)  # kinds of light that the matrices were fitted to
    errors: dict[str, FileArray] = Field(min_length=1)  # covariance of the error over (X + Y + Z)² by kind of light
    # Covariance of D by type of display, 9 × 9, whose error is D·(X, Y, Z); it takes the place of `errors`
    display_errors: dict[str, FileArray] = Field(default_factory=dict)
    training: _Training = None  # raw readings of known lights, which gave the matrices or their scale
    provenance: Provenance = Field(default_factory=lambda: Provenance("unknown"))

    @property
    def reference(self) -> Calibration:
        """Return camera, lens and conditions as a calibration of radiance has them, for comparison with a reading."""
        absolute, when = self.unit != "relative", self.created.isoformat()
        return reference(self.camera, self.lens, self.conditions, self.iso, when, absolute=absolute)

    @model_validator(mode="after")
    def _are_of_the_channels(self) -> Self:
        n = len(self.channels)
        shapes: list[tuple[Array, tuple[int, ...]]] = [(fit.matrix, (3, n)) for fit in self.matrices.values()]
        shapes += [(fit.hull, (max(3, len(fit.hull)), 2)) for fit in self.matrices.values()]
        if self.training is not None:
            lights = len(self.training.names)
            shapes += [(one, (lights, n)) for one in (self.training.signal, self.training.u_signal)]
            shapes += [(self.training.xyz, (lights, 3)), (self.training.u_rel[self.training.u_rel >= 0.0], (lights,))]
        variances = [(fit.spread, n) for fit in self.matrices.values()]
        variances += [(one, 3) for one in (*(fit.error for fit in self.matrices.values()), *self.errors.values())]
        variances += [(one, 9) for one in self.display_errors.values()]
        if any(one.shape != shape for one, shape in shapes) or not all(_is_covariance(*one) for one in variances):
            raise ValueError(
                f"a matrix, error or reading has not {n} channels, or a variance is below 0; calibrate again"
            )
        return self

    def fit(self, kind: str | None) -> Fit:
        """Return the matrix for a kind of light.

        Raises UsageError if there is one for each kind and none is stated, or the kind is not known.
        """
        if kind is not None and kind not in self.errors:
            raise UsageError(f"--kind {kind}: the calibration knows {', '.join(self.errors)}")
        found = self.matrices.get(ALL) or self.matrices.get(kind or "")
        if found is None:
            raise UsageError(f"the calibration holds a matrix for each of {', '.join(self.matrices)}: state --kind")
        return found

    def error(self, kind: str | None, xyz: Array) -> Array:
        """Return the covariance of the matrix' error for light of a kind, shape (…, 3, 3).

        Light of unstated kind has the mean over the kinds, each as likely. X, Y, Z have the shape (…, 3).
        """
        square, found = np.sum(xyz, axis=-1)[..., None, None] ** 2, []
        for name in self.errors if kind is None else (kind,):
            if name in self.display_errors:
                linear = self.display_errors[name].reshape(3, 3, 3, 3)
                found.append(np.einsum("iajb,...a,...b->...ij", linear, xyz, xyz))
            else:
                found.append(square * self.errors[name])
        return np.asarray(np.mean(found, axis=0))

    def convert(self, signal: Array, covariance: Array, kind: str | None) -> tuple[Array, Array]:
        """Return X, Y, Z, shape (…, 3), and their covariance, shape (…, 3, 3).

        The covariance holds that of the readings, the error of the matrix for this kind of light, which grows with the
        distance from the training set, and the scale of the known X, Y, Z. Raises UsageError as `fit`.

        Args:
            signal: Channel readings, shape (…, channels).
            covariance: Their covariance, shape (…, channels, channels).
            kind: Kind of light; None where it is not known.
        """
        fit = self.fit(kind)
        xyz = signal @ fit.matrix.T
        # The coefficients' error: it grows with the distance from the training set.
        distance = np.sum(xyz, axis=-1) ** 2 * np.nan_to_num(fit.leverage(signal))
        own = fit.matrix @ covariance @ fit.matrix.T + distance[..., None, None] * fit.error
        scale = self.u_rel**2 * xyz[..., :, None] * xyz[..., None, :]
        return xyz, own + self.error(kind, xyz) + scale

    def is_outside(self, xy: Array, covariance: Array, kind: str | None) -> NDArray[np.bool_]:
        """Return whether chromaticities are outside the hull of the training set by more than two uncertainties."""
        sides = ConvexHull(self.fit(kind).hull).equations
        normal, offset = sides[:, :2], sides[:, 2]
        beyond = xy @ normal.T + offset
        u = np.sqrt(np.einsum("si,...ij,sj->...s", normal, covariance, normal))
        return np.asarray(np.any(beyond > _SURELY * u, axis=-1))

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping that is written to the file."""
        return {"format": FORMAT, **self.model_dump(mode="json", exclude_none=True)}

    def write(self, path: Path) -> None:
        """Write it as one YAML file, whole or not at all. Raises OutputError."""
        write_yaml_atomic(path, self.to_mapping())

    @classmethod
    def read(cls, path: Path) -> ColourCalibration:
        """Return the calibration in a file.

        Raises InputError if the file cannot be read, or is not YAML. Raises CalibrationError if it is no colour
        calibration; the message names the key, the value and what is allowed.
        """
        mapping = read_yaml(path)
        if mapping.get("format") != FORMAT:
            raise CalibrationError(f"{path}: format is {mapping.get('format')!r}; expected {FORMAT!r}")
        return validate(cls, mapping, str(path), CalibrationError)


def reference(
    camera: CameraDescription,
    lens: LensDescription,
    conditions: ScaleConditions,
    iso: float | None,
    created: str,
    *,
    absolute: bool = True,
) -> Calibration:
    """Return how frames were taken as a calibration of radiance states it, its scale 1."""
    scale = Scale(
        value=1.0, u_rel=0.0, method="known_radiance" if absolute else "relative", f_number=lens.f_number, iso=iso,
        conditions=conditions,
    )  # fmt: skip
    return Calibration(camera, lens, scale, None, SensorNoise.of(camera), created=created)


def _is_covariance(found: Array, size: int) -> bool:
    """Return whether an array has the shape of a covariance, and no variance below 0."""
    return found.shape == (size, size) and bool(
        np.linalg.eigvalsh((found + found.T) / 2.0).min() >= -1e-9 * np.abs(found).max()
    )

"""The colour calibration of a camera: matrices, their errors by kind of light, and the raw readings behind them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AwareDatetime, Field
from scipy.spatial import ConvexHull

from radiometer.analysis.colour.matrix import Fit, Training
from radiometer.data import CameraDescription, LensDescription, Provenance
from radiometer.data.provenance import utc_now
from radiometer.data.storage import read_yaml, write_yaml_atomic
from radiometer.data.validation import FileSection, validate
from radiometer.errors import CalibrationError, UsageError
from radiometer.typing import Array

FORMAT: Final = "radiometer-colour/1"
ALL: Final = "all"  # name of the matrix that serves every kind of light
_SURELY: Final = 2.0  # standard uncertainties beyond the hull of the training set


@dataclass(frozen=True, slots=True, eq=False)
class ColourCalibration:
    """What turns the channels of one camera into X, Y, Z."""

    channels: tuple[str, ...]  # names in the order of the matrices' columns
    camera: CameraDescription
    lens: LensDescription  # with its f-number
    unit: str  # of X, Y, Z: cd·m⁻², or relative where no light of known luminance took part
    fits: Mapping[str, Fit]  # matrix by kind of light, or a single one named `ALL`
    errors: Mapping[str, Array]  # covariance of the error over (X + Y + Z)² by kind of light
    trained: tuple[str, ...]  # kinds of light that the matrices were fitted to
    training: Training | None  # raw readings of known lights, which gave the matrices or their scale
    u_rel: float = 0.0  # relative standard uncertainty that all known X, Y, Z share
    created: str = field(default_factory=utc_now)  # ISO 8601 time in UTC
    provenance: Provenance = field(default_factory=lambda: Provenance("unknown"))
    # Covariance of D by type of display, whose error is D·(X, Y, Z), shape (3, 3, 3, 3); it takes the place of `errors`
    display_errors: Mapping[str, Array] = field(default_factory=dict)

    def fit(self, kind: str | None) -> Fit:
        """Return the matrix for a kind of light.

        Raises:
            UsageError: If there is one for each kind and none is stated, or the kind is not known.
        """
        if kind is not None and kind not in self.errors:
            raise UsageError(f"--kind {kind}: the calibration knows {', '.join(self.errors)}")
        found = self.fits.get(ALL) or self.fits.get(kind or "")
        if found is None:
            raise UsageError(f"the calibration holds a matrix for each of {', '.join(self.fits)}: state --kind")
        return found

    def error(self, kind: str | None, xyz: Array) -> Array:
        """Return the covariance of the matrix' error for light of a kind, shape (…, 3, 3).

        Light of unstated kind has the mean over the kinds, each as likely.

        Args:
            kind: Kind of light.
            xyz: Its X, Y, Z, shape (…, 3).
        """
        square, found = np.sum(xyz, axis=-1)[..., None, None] ** 2, []
        for name in self.errors if kind is None else (kind,):
            linear = self.display_errors.get(name)
            found.append(
                square * self.errors[name] if linear is None else np.einsum("iajb,...a,...b->...ij", linear, xyz, xyz)
            )
        return np.asarray(np.mean(found, axis=0))

    def convert(self, signal: Array, covariance: Array, kind: str | None) -> tuple[Array, Array]:
        """Return X, Y, Z, shape (…, 3), and their covariance, shape (…, 3, 3).

        The covariance holds that of the readings, the error of the matrix for this kind of light, which grows with the
        distance from the training set, and the scale of the known X, Y, Z.

        Args:
            signal: Channel readings, shape (…, channels).
            covariance: Their covariance, shape (…, channels, channels).
            kind: Kind of light; None where it is not known.

        Raises:
            UsageError: As `fit`.
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
        return {
            "format": FORMAT,
            "created": self.created,
            "channels": list(self.channels),
            "unit": self.unit,
            "u_rel": self.u_rel,
            "camera": self.camera.model_dump(mode="json", exclude_none=True),
            "lens": self.lens.model_dump(mode="json", exclude_none=True),
            "matrices": {
                kind: {name: getattr(one, name).tolist() for name in ("matrix", "spread", "error", "hull")}
                for kind, one in self.fits.items()
            },
            "trained": list(self.trained),
            "errors": {kind: one.tolist() for kind, one in self.errors.items()},
            "display_errors": {kind: one.reshape(9, 9).tolist() for kind, one in self.display_errors.items()},
            "training": [] if self.training is None else self.training.rows(),
            "provenance": self.provenance.to_mapping(),
        }

    def write(self, path: Path) -> None:
        """Write it as one YAML file, whole or not at all. Raises OutputError."""
        write_yaml_atomic(path, self.to_mapping())

    @classmethod
    def read(cls, path: Path) -> ColourCalibration:
        """Return the calibration in a file.

        Raises:
            InputError: If the file cannot be read, or is not YAML.
            CalibrationError: If it is no colour calibration; the message names the key, the value and what is allowed.
        """
        mapping = read_yaml(path)
        if mapping.get("format") != FORMAT:
            raise CalibrationError(f"{path}: format is {mapping.get('format')!r}; expected {FORMAT!r}")
        stored = validate(_File, mapping, str(path), CalibrationError)
        channels = len(stored.channels)
        try:
            return cls(
                stored.channels,
                stored.camera,
                stored.lens,
                stored.unit,
                {kind: one.fit(channels) for kind, one in stored.matrices.items()},
                {kind: _covariance(one, 3) for kind, one in stored.errors.items()},
                stored.trained,
                _training(stored.training, channels),
                stored.u_rel,
                stored.created.isoformat(),
                Provenance.from_mapping(stored.provenance, str(path)),
                {kind: _covariance(one, 9).reshape(3, 3, 3, 3) for kind, one in stored.display_errors.items()},
            )
        except ValueError as error:
            raise CalibrationError(
                f"{path}: a matrix, error or reading has not {channels} channels, or a variance is below 0; "
                "calibrate again"
            ) from error


class _Matrix(FileSection):
    matrix: list[list[float]]
    spread: list[list[float]]
    error: list[list[float]]
    hull: list[list[float]] = Field(min_length=3)

    def fit(self, channels: int) -> Fit:
        return Fit(
            _shaped(self.matrix, 3, channels),
            _covariance(self.spread, channels),
            _covariance(self.error, 3),
            _shaped(self.hull, len(self.hull), 2),
        )


class _Light(FileSection):
    name: str
    kind: str
    signal: list[float]
    u_signal: list[float]
    xyz: list[float]
    u_rel: float = Field(ge=0)


class _File(FileSection):
    created: AwareDatetime
    channels: tuple[str, ...] = Field(min_length=2)
    unit: Literal["cd m-2", "relative"]
    u_rel: float = Field(ge=0)
    camera: CameraDescription
    lens: LensDescription = LensDescription()
    matrices: dict[str, _Matrix] = Field(min_length=1)
    errors: dict[str, list[list[float]]] = Field(min_length=1)
    display_errors: dict[str, list[list[float]]] = Field(default_factory=dict)
    trained: tuple[str, ...] = Field(min_length=1)
    training: list[_Light] = Field(default_factory=list)
    provenance: dict[str, Any] = Field(default_factory=dict)


def _training(lights: list[_Light], channels: int) -> Training | None:
    if not lights:
        return None
    return Training(
        tuple(one.name for one in lights),
        tuple(one.kind for one in lights),
        _shaped([one.signal for one in lights], len(lights), channels),
        _shaped([one.u_signal for one in lights], len(lights), channels),
        _shaped([one.xyz for one in lights], len(lights), 3),
        np.array([one.u_rel for one in lights]),
    )


def _covariance(values: Any, size: int) -> Array:
    """Return a covariance. Raises ValueError where it has another shape, or a variance below 0."""
    found = _shaped(values, size, size)
    if not np.linalg.eigvalsh((found + found.T) / 2.0).min() >= -1e-9 * np.abs(found).max():
        raise ValueError("a variance is below 0")
    return found


def _shaped(values: Any, rows: int, columns: int) -> Array:
    """Return values as an array of a shape. Raises ValueError where they have another."""
    return np.array(values, dtype=np.float64).reshape(rows, columns)

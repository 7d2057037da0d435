"""The colour calibration of a camera: matrices to X, Y, Z, their errors by kind of light, and their making.

A camera whose responsivities are no mixture of the colour matching functions has no exact matrix (Luther 1927). Its
error depends on the spectrum, so it is found from lights that the matrix was not fitted to, and is part of u.
"""

from __future__ import annotations

import datetime as dt
import itertools
import math
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AwareDatetime, BeforeValidator, Field, PlainSerializer, model_validator
from scipy.spatial import ConvexHull

from radiometer.analysis.photometry.displays import GRID_NM, display_primaries, on_grid, tristimulus_of
from radiometer.analysis.photometry.photometry import DISPLAY_TYPES, FLUORESCENT, KINDS, spectrum
from radiometer.analysis.photometry.responses import colour_cameras
from radiometer.analysis.reading.budget import coverage_factor
from radiometer.data import Calibration, CameraDescription, LensDescription, Provenance, Scale, ScaleConditions
from radiometer.data.mosaic import COLOURS
from radiometer.data.reading import LUMINANCE_UNIT, RELATIVE_UNIT
from radiometer.data.sensor_noise import SensorNoise
from radiometer.data.storage import read_yaml, write_yaml_atomic
from radiometer.data.validation import ConfigSection, FileArray, validate
from radiometer.errors import CalibrationError, UsageError
from radiometer.statistics.least_squares import solve
from radiometer.typing import Array

SURFACES: Final = "surfaces"
# Lights that surfaces are seen under: lamps of each kind, and daylight.
_LIGHTS: Final = (
    "cie_d65", "cie_a", "led_b1", "led_b5", "led_rgb1", "led_v1", "cie_fl2", "cie_fl7", "cie_fl11", "cie_fl12",
)  # fmt: skip
_EDGES_NM: Final = (480.0, 520.0, 560.0, 600.0, 640.0)  # where pigments begin or cease to reflect
_EDGE_WIDTHS_NM: Final = (8.0, 25.0)  # of the logistic: from sharp (cadmium red) to soft (skin, foliage)
_BUMPS_NM: Final = (450.0, 500.0, 550.0, 600.0)
_BUMP_NM: Final = 45.0  # standard deviation of a blue, green or purple pigment's band
_DARK, _BRIGHT = 0.05, 0.75  # reflectances of coloured surfaces
_DRIVES: Final = (0.0, 0.3, 1.0)  # of a display's primaries in mixtures
FORMAT: Final = "radiometer-colour/1"
ALL: Final = "all"  # name of the matrix that serves every kind of light
_SURELY: Final = 2.0  # standard uncertainties beyond the hull of the training set
_ROW: Final = ("name", "kind", "signal", "u_signal", "xyz", "u_rel")  # keys of a light in a file
_LEAST_SPAN: Final = 1e-3  # of the singular values: below, the channels of all lights are one mixture of each other
_ALONE: Final = 1.0 - 1e-6  # leverage of a light that alone determines a coefficient
_ROUNDS: Final = 20  # of weights and error in turn; they settle within five
_LEAST_ERROR: Final = 1e-4  # relative; no camera is linear to better
_COVERED: Final = 0.9545  # of the lights by k = 2, as of a normal distribution


@dataclass(frozen=True, slots=True, eq=False)
class Training:
    """Lights of known X, Y, Z and the raw readings of them."""

    names: tuple[str, ...]  # name of each light
    kinds: tuple[str, ...]  # its kind, such as "oled"
    signal: FileArray  # channel readings, shape (lights, channels)
    u_signal: FileArray  # their standard uncertainties, independent of each other
    xyz: FileArray  # X, Y, Z in cd·m⁻², shape (lights, 3)
    u_rel: FileArray  # relative standard uncertainty of X, Y, Z of each light, independent of the others

    def rows(self) -> list[dict[str, Any]]:
        """Return a mapping of plain values for each light."""
        values = (one.tolist() for one in (self.signal, self.u_signal, self.xyz, self.u_rel))
        return [dict(zip(_ROW, row, strict=True)) for row in zip(self.names, self.kinds, *values, strict=True)]

    def of_kind(self, kind: str | None) -> Training:
        """Return the lights of a kind; all for None."""
        at = [n for n, one in enumerate(self.kinds) if kind in (None, one)]
        names, kinds = (tuple(given[n] for n in at) for given in (self.names, self.kinds))
        return Training(names, kinds, self.signal[at], self.u_signal[at], self.xyz[at], self.u_rel[at])


def of_rows(rows: Any) -> Any:
    """Return the fields of `Training` from the rows of a file; None for none. Raises ValueError for other rows."""
    try:
        columns = [[row[name] for row in rows] for name in _ROW] if isinstance(rows, list) else None
    except (KeyError, TypeError) as error:
        raise ValueError(f"a light has no {error}; calibrate again") from error
    return rows if columns is None else dict(zip(Training.__slots__, columns, strict=True)) if rows else None


_Training = Annotated[
    Training | None, BeforeValidator(of_rows), PlainSerializer(lambda found: [] if found is None else found.rows())
]


class Fit(ConfigSection):
    """A matrix and what is known of its error.

    Errors are covariances of X, Y, Z over the square of X + Y + Z, shape (3, 3).
    """

    matrix: FileArray  # X, Y, Z per unit of each channel, shape (3, channels)
    # Inverse of the normal matrix, shape (channels, channels): aᵀ·spread·a is the leverage of a light
    spread: FileArray
    error: FileArray  # error for a light that was left out
    hull: FileArray  # corners (x, y) of the hull of the lights that it was fitted to, shape (corners, 2)

    def leverage(self, signal: Array) -> Array:
        """Return the leverage of lights, shape (…): about channels/lights within the training set, more outside."""
        total = np.sum(signal @ self.matrix.T, axis=-1, keepdims=True)
        share = signal / np.where(total > 0.0, total, np.nan)
        return np.asarray(np.einsum("...i,ij,...j", share, self.spread, share))


class ColourCalibration(ConfigSection):
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
        return reference(self, self.created.isoformat(), absolute=self.unit != "relative")

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
        return validate(cls, {k: v for k, v in mapping.items() if k != "format"}, str(path), CalibrationError)


def reference(of: ColourCamera | ColourCalibration, created: str, *, absolute: bool = True) -> Calibration:
    """Return how frames were taken as a calibration of radiance states it, its scale 1."""
    scale = Scale(
        value=1.0, u_rel=0.0, method="known_radiance" if absolute else "relative", f_number=of.lens.f_number,
        iso=of.iso, conditions=of.conditions,
    )  # fmt: skip
    return Calibration(of.camera, of.lens, scale, None, SensorNoise.of(of.camera), created=created)


def _is_covariance(found: Array, size: int) -> bool:
    """Return whether an array has the shape of a covariance, and no variance below 0."""
    return found.shape == (size, size) and bool(
        np.linalg.eigvalsh((found + found.T) / 2.0).min() >= -1e-9 * np.abs(found).max()
    )


def fit_matrix(training: Training, white: str | None = None) -> Fit:
    """Return the matrix of least squares, each light weighted by 1/u².

    u² of a light is the noise of its readings, the uncertainty of its X, Y, Z, and the error of the matrix, which is
    found from the residuals. The error is that of the residual of each light without that light, r/(1 − h).
    It is widened so that k = 2 covers 95.45 %, by Student's t and by the residuals that are far off. The matrix gives
    X, Y, Z of the light named `white` exactly, so that greys keep its colour; those of its like gain, the others lose
    little. Raises CalibrationError if the lights do not determine the matrix and its error.

    Source: Finlayson & Drew 1997, Proc. 5th Color Imaging Conf., 258 (white-preserving least squares).
    """
    count, channels = training.signal.shape
    total = training.xyz.sum(axis=1, keepdims=True)
    if count <= channels:
        raise CalibrationError(f"{count} lights do not determine a matrix of {channels} channels and its error: "
                               f"give {channels + 1} lights or more")  # fmt: skip
    if np.any(total <= 0.0):
        raise CalibrationError(f"light {training.names[int(np.argmin(total))]!r}: X + Y + Z must be above 0")
    share, target = training.signal / total, training.xyz / total
    if np.linalg.cond(share / np.linalg.norm(share, axis=0)) >= 1.0 / _LEAST_SPAN:
        raise CalibrationError(
            f"the {count} lights do not determine the matrix: their channels have a fixed ratio; "
            "add lights of other colours"
        )
    known = training.u_rel**2 * np.mean(target**2, axis=1)
    noise, error_2 = known, 1e-4
    exact = [n for n, name in enumerate(training.names) if name == white]  # none where no white is named
    along = np.linalg.pinv(share[exact])  # along · white is 1, shape (channels, len(exact))
    free, fixed = np.linalg.svd(share[exact])[2][len(exact) :].T, target[exact].T @ along.T  # white has none of free
    for _ in range(_ROUNDS):
        weight = 1.0 / (error_2 + noise)
        weight /= weight.mean()
        spread = free @ np.linalg.inv(free.T @ share.T @ (weight[:, None] * share) @ free) @ free.T
        matrix = fixed + (spread @ share.T @ (weight[:, None] * (target - share @ fixed.T))).T
        leverage = weight * np.einsum("ni,ij,nj->n", share, spread, share)
        if np.any(leverage > _ALONE):
            alone = training.names[int(np.argmax(leverage))]
            raise CalibrationError(f"without light {alone!r} the others do not determine the matrix; add one like it")
        left_out = (target - share @ matrix.T) / (1.0 - leverage)[:, None]
        noise = known + np.mean((training.u_signal / total) ** 2 @ (matrix**2).T, axis=1)
        found = np.average(np.mean(left_out**2, axis=1) - noise, weights=weight)
        error_2 = max(float(found), _LEAST_ERROR**2)
    error = _covering(np.delete(left_out * np.sqrt(weight)[:, None], exact, axis=0), count - channels)
    # The coefficients hold the lights' own u, though these agree better by chance.
    noise *= 3.0 / np.trace(error)  # as `spread` counts it
    # What is wrong with the white is wrong with all that is like it.
    spread = spread * max(1.0, float(np.mean(noise))) + noise[exact] * along @ along.T
    return Fit(matrix=matrix, spread=spread, error=error, hull=target[ConvexHull(target[:, :2]).vertices, :2])


def _covering(off: Array, freedom: int) -> Array:
    """Return the covariance of errors, shape (3, 3), of which k = 2 covers 95.45 % of them.

    It is the mean of e·eᵀ and of what no camera is better than. It is wider where a few lights are far off, such as
    those of a lamp with lines, and where few degrees of freedom are left (Student's t).
    """
    mean = off.T @ off / len(off)
    far = np.quantile(np.abs(off) / np.sqrt(np.maximum(np.diag(mean), 1e-30)), _COVERED)
    few = coverage_factor(freedom) / 2.0
    return np.asarray(max(few, float(far) / 2.0) ** 2 * mean + _LEAST_ERROR**2 * np.eye(3))


def _normal(xyz: Array) -> Array:
    return np.asarray(xyz / xyz.sum(axis=1, keepdims=True))


def _signal(powers: Array, responsivities: Array) -> Array:
    """Return the signals of lights over their X + Y + Z, shape (lights, channels)."""
    return np.asarray(powers @ responsivities.T / tristimulus_of(powers).sum(axis=1, keepdims=True))


def errors_of_other_lights(
    matrix: Array, training: Training, powers: Array | None, responsivities: Array | None
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the error of a matrix by kind of plausible light, and as a function of X, Y, Z for types of display.

    The first are covariances over (X + Y + Z)². The light of a display is a mixture of its primaries, so its error is
    linear in X, Y, Z: e = D·(X, Y, Z). The second are covariances of D over the displays of a type, shape (9, 9).

    Args:
        matrix: Shape (3, channels).
        powers: Their powers over the grid of plausible lights. None takes the plausible lights that are nearest in
            chromaticity and readings, of the kinds of the training where these are plausible ones.
        responsivities: The camera's, up to a common factor. None takes plausible colour cameras, each with a matrix
            fitted to the same lights.
    """
    lights, stated = plausible_lights(), powers is not None
    if powers is None:
        pool = np.vstack([lights[kind] for kind in lights if kind in training.kinds] or list(lights.values()))
        read, there = _normal(training.xyz)[:, :2], _normal(tristimulus_of(pool))[:, :2]
        if responsivities is not None:  # the camera distinguishes lamps that look alike
            read = np.hstack([read, _normal(training.signal)])
            there = np.hstack([there, _normal(_signal(pool, responsivities))])
        powers = pool[np.argmin(np.sum((read[:, None] - there) ** 2, axis=-1), axis=1)]
    u_scale = 0.0
    if responsivities is not None:
        computed, known = _signal(powers, responsivities), training.signal / training.xyz.sum(axis=1, keepdims=True)
        if not stated:  # the readings are of other spectra: the scale is that by which the matrix is right for these
            computed, known = computed @ matrix.T, _normal(tristimulus_of(powers))
        scale = float(np.sum(computed * known) / np.sum(computed**2))
        each = np.sum(computed * known, axis=1) / np.sum(computed**2, axis=1)
        u_scale = float(np.std(each, ddof=1)) / scale / math.sqrt(len(each))
        pairs = [(matrix, scale * responsivities)]
    else:
        target = _normal(tristimulus_of(powers))
        pairs = [(solve(_signal(powers, camera), target).T, camera) for camera in colour_cameras(GRID_NM)]
    found = {}
    for kind, one in lights.items():
        shares = _normal(tristimulus_of(one))
        off = np.vstack([_signal(one, camera) @ fitted.T - shares for fitted, camera in pairs])
        found[kind] = _covering(off, len(one)) + u_scale**2 * shares.T @ shares / len(shares)
    return found, {kind: _of_displays(kind, pairs, u_scale) for kind in DISPLAY_TYPES}


def _of_displays(kind: str, pairs: list[tuple[Array, Array]], u_scale: float) -> Array:
    """Return the covariance of D, shape (9, 9), over displays of a type and pairs of a matrix and a camera."""
    displays = display_primaries(kind)
    off = [
        np.eye(3) - tristimulus_of(primaries).T @ np.linalg.pinv(fitted @ camera @ primaries.T)
        for fitted, camera in pairs
        for primaries in displays
    ]
    few = coverage_factor(len(displays)) / 2.0
    mean = few**2 * np.mean([np.outer(one, one) for one in off], axis=0)
    alike = u_scale**2 * np.outer(np.eye(3), np.eye(3))
    return np.asarray(mean + alike + _LEAST_ERROR**2 * np.kron(np.eye(3), np.ones((3, 3))))


@dataclass(frozen=True, slots=True, eq=False)
class ColourCamera:
    """What is known of a camera before its colour calibration."""

    channels: tuple[str, ...]  # names of its channels
    camera: CameraDescription = field(default_factory=lambda: CameraDescription(bit_depth=16))  # its description
    lens: LensDescription = field(default_factory=LensDescription)  # its lens
    conditions: ScaleConditions = field(default_factory=ScaleConditions)  # gain and temperature of its frames
    iso: float | None = None  # lowest ISO speed of its photographs
    # Per watt over the grid of plausible lights, up to a common factor; None where unknown
    responsivities: Array | None = None
    inputs: tuple[str, ...] = ()  # files with their content hashes, for the record


def train_on_lights(
    known: ColourCamera, training: Training, *, powers: Array | None, per_kind: bool, u_rel: float,
    white: str | None = None,
) -> ColourCalibration:  # fmt: skip
    """Return the calibration fitted to readings of known lights.

    The error for a kind of light is that of lights left out of the training, and that of plausible lights of the kind;
    the larger counts. Spectra (`powers`) are over the grid of plausible lights; all known X, Y, Z share `u_rel`. The
    matrix gives the X, Y, Z of `white` exactly. Raises CalibrationError if the lights do not determine a matrix, or
    none is called as the white.
    """
    if white is not None and white not in training.names:
        raise CalibrationError(f"--white {white}: no light has that name; there are {', '.join(training.names)}")
    kinds = tuple(dict.fromkeys(training.kinds))
    fits, errors, of_displays = dict[str, Fit](), dict[str, Array](), dict[str, Array]()
    for name in kinds if per_kind else (ALL,):
        part = None if name == ALL else name
        try:
            fits[name] = fit_matrix(training.of_kind(part), white)
        except CalibrationError as error:
            raise CalibrationError(f"kind {name}: {error}" if part else str(error)) from error
        trained = [name] if part else list(kinds)
        others, linear = dict[str, Array](), dict[str, Array]()
        if known.responsivities is not None or known.channels == COLOURS:
            chosen = [part in (None, one) for one in training.kinds]
            others, linear = errors_of_other_lights(
                fits[name].matrix, training.of_kind(part), None if powers is None else powers[chosen],
                known.responsivities,
            )  # fmt: skip
        own = {kind: max(fits[name].error, others.get(kind, fits[name].error), key=np.trace) for kind in trained}
        errors |= own if part else {**others, **own}
        left_out = np.kron(fits[name].error, np.ones((3, 3)))
        for kind, one in linear.items():
            if part in (None, kind):
                of_displays[kind] = one + left_out if kind in trained else one
    assumed = []
    if known.responsivities is None and not per_kind:
        assumed.append(
            f"error for lights other than {', '.join(kinds)}: that of plausible colour cameras"
            if known.channels == COLOURS
            else f"error for lights other than {', '.join(kinds)}: unknown, in no uncertainty; give --responsivities"
        )
    origin = Provenance("least squares weighted by 1/u²", known.inputs, tuple(assumed), {"per_kind": per_kind})
    return ColourCalibration(
        channels=known.channels, camera=known.camera, lens=known.lens, conditions=known.conditions, iso=known.iso,
        unit=LUMINANCE_UNIT, matrices=fits, errors=errors, trained=kinds,
        training=training, u_rel=u_rel, provenance=origin, display_errors=of_displays,
    )  # fmt: skip


def train_on_responsivities(
    known: ColourCamera, scale: Training | None, *, per_kind: bool, u_rel: float
) -> ColourCalibration:
    """Return the calibration fitted to plausible lights, through the camera's responsivities.

    Raises CalibrationError if the responsivities determine no matrix, or a known light has no reading.
    """
    responsivities, plausible = known.responsivities, plausible_lights()
    if responsivities is None:
        raise CalibrationError("a matrix from plausible lights needs the camera's responsivities")
    kinds, powers = tuple(kind for kind, one in plausible.items() for _ in one), np.vstack(list(plausible.values()))
    signal, none = _signal(powers, responsivities), np.zeros(len(powers))
    lights = Training(kinds, kinds, signal, np.zeros(signal.shape), _normal(tristimulus_of(powers)), none)
    fits, of_displays = dict[str, Fit](), dict[str, Array]()
    if per_kind:
        for kind in plausible:
            try:
                fits[kind] = fit_matrix(lights.of_kind(kind))
            except CalibrationError:
                continue  # its lights are shades of one colour, or too few
        errors = {kind: fit.error for kind, fit in fits.items()}
    else:
        fits[ALL] = fit_matrix(lights)
        errors, of_displays = errors_of_other_lights(fits[ALL].matrix, lights, powers, responsivities)
    unit, assumed, u_scale = RELATIVE_UNIT, ["X, Y, Z are relative: no light of known luminance took part"], 0.0
    if scale is not None:
        factor, u_scale = _scale(scale, fits)
        fits = {
            kind: fit.model_copy(update={"matrix": factor * fit.matrix, "spread": factor**2 * fit.spread})
            for kind, fit in fits.items()
        }
        unit, assumed = LUMINANCE_UNIT, ["the scale is that of the known lights"]
    origin = Provenance("plausible lights through responsivities", known.inputs, tuple(assumed), {"per_kind": per_kind})
    u_all = math.hypot(u_rel, u_scale)
    trained = tuple(fits) if per_kind else tuple(plausible)
    return ColourCalibration(
        channels=known.channels, camera=known.camera, lens=known.lens, conditions=known.conditions, iso=known.iso,
        unit=unit, matrices=fits, errors=errors, trained=trained,
        training=scale, u_rel=u_all, provenance=origin, display_errors=of_displays,
    )  # fmt: skip


def _scale(known: Training, fits: dict[str, Fit]) -> tuple[float, float]:
    """Return the factor that gives known lights their luminance, and its relative standard uncertainty.

    Each light counts by its own uncertainty; the scatter counts where it is larger, and of a single light its error.
    """
    ratios, variances = [], []
    for n, kind in enumerate(known.kinds):
        fit = fits.get(kind) or fits.get(ALL)
        if fit is None:
            raise CalibrationError(f"light {known.names[n]!r}: there is no matrix for its kind {kind!r}")
        given = float(fit.matrix[1] @ known.signal[n])
        if not given > 0.0:
            raise CalibrationError(f"light {known.names[n]!r}: its reading gives no luminance above 0")
        noise = float(np.sum((fit.matrix[1] * known.u_signal[n]) ** 2)) / given**2
        own = fit.error[1, 1] * (known.xyz[n].sum() / known.xyz[n, 1]) ** 2
        ratios.append(float(known.xyz[n, 1]) / given)
        variances.append(noise + known.u_rel[n] ** 2 + own)
    weight = 1.0 / np.array(variances)
    factor = float(np.average(ratios, weights=weight))
    scatter = float(np.average((np.array(ratios) / factor - 1.0) ** 2, weights=weight)) / max(1, len(ratios) - 1)
    return factor, math.sqrt(max(1.0 / float(weight.sum()), scatter if len(ratios) > 1 else 0.0))


@cache
def plausible_lights() -> dict[str, Array]:
    """Return powers over `GRID_NM` by kind of light, shape (lights, wavelengths) each.

    The kinds are lamps, daylight, single LEDs, types of display (primaries and mixtures), and surfaces under lamps.
    """
    lamps = {name.lower().replace(" ", "_"): names for name, names in KINDS.items() if "screen" not in name}
    found = {kind: np.stack([on_grid(spectrum(name)) for name in names]) for kind, names in lamps.items()}
    planck = {"incandescent_lamps": range(2000, 3501, 250), "daylight": range(5000, 10001, 1000)}
    for kind, temperatures in planck.items():
        found[kind] = np.vstack([found[kind], *(on_grid(spectrum(f"planck:{one}")) for one in temperatures)])
    found["fluorescent_lamps"] = np.stack([on_grid(spectrum(name)) for name in FLUORESCENT])
    found["white_leds"] = np.vstack([found["white_leds"], _mixed_white()])
    found["coloured_leds"] = np.stack(
        [on_grid(spectrum(f"band:{peak},{width}")) for peak in range(430, 661, 10) for width in (18, 32)]
    )
    for kind in DISPLAY_TYPES:
        usual, *others = display_primaries(kind)
        found[kind] = np.vstack([_mixtures(usual, _DRIVES), *(_mixtures(one, (0.0, 1.0)) for one in others)])
    lights = np.stack([on_grid(spectrum(name)) for name in _LIGHTS])
    found[SURFACES] = (lights[:, None, :] * _reflectances()).reshape(-1, GRID_NM.size)
    return found


def _mixed_white() -> Array:
    """Return lamps of a blue, a green and a red LED that have the colour of a Planckian radiator."""
    found = []
    for peaks in itertools.product((450, 465), (525, 545), (610, 630)):
        leds = np.stack([on_grid(spectrum(f"band:{peak},25")) for peak in peaks])
        for temperature in (3000, 5000):
            white = tristimulus_of(on_grid(spectrum(f"planck:{temperature}"))[None])[0]
            found.append(np.linalg.solve(tristimulus_of(leds).T, white) @ leds)
    return np.stack(found)


def _mixtures(primaries: Array, steps: tuple[float, ...]) -> Array:
    """Return the primaries of a display in all mixtures of some drives but black; alike in power at full drive."""
    alike = primaries / primaries.sum(axis=1, keepdims=True)
    drives = [drive for drive in itertools.product(steps, repeat=len(primaries)) if any(drive)]
    return np.asarray(np.array(drives) @ alike)


def _reflectances() -> Array:
    """Return smooth reflectances: pigments that begin or cease to reflect, bands, gaps, and grey."""
    edges = [
        1.0 / (1.0 + np.exp(way * (GRID_NM - edge) / width))
        for edge in _EDGES_NM
        for width in _EDGE_WIDTHS_NM
        for way in (-1.0, 1.0)
    ]
    bumps = [np.exp(-0.5 * ((GRID_NM - centre) / _BUMP_NM) ** 2) for centre in _BUMPS_NM]
    shapes = np.stack([*edges, *bumps, *(1.0 - one for one in bumps), np.full(GRID_NM.size, 0.5)])
    return _DARK + (_BRIGHT - _DARK) * shapes

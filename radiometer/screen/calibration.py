"""The calibration of a screen: level to radiance and luminance with uncertainty, and back; models of its curve."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression, least_squares

from radiometer.data import Provenance, Quantity
from radiometer.data.json_text import finite_or_null
from radiometer.data.provenance import utc_now
from radiometer.data.storage import read_yaml, write_yaml_atomic
from radiometer.data.validation import ConfigSection, refuse_unknown, validate
from radiometer.errors import CalibrationError, SettingOutOfRange
from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array

Curve = Callable[[Array, Array], Array]
_EXPONENTS: Final = (0.01, 100.0)  # of γ, the last parameter of every model: light rises with the drive


@dataclass(frozen=True, slots=True)
class TransferModel:
    """A named curve L(v; parameters) of the drive v = 0..1."""

    name: str  # name in files
    source: str  # where the equation comes from
    parameters: tuple[str, ...]  # names of its parameters
    curve: Curve  # function (parameters, v) giving values in the unit of the measured ones
    start: Callable[[Array, Array], list[float]]  # function (v, values) giving parameters to start from


@dataclass(frozen=True, slots=True)
class TransferFit:
    """A fitted model and its errors."""

    model: str  # name of the model
    parameters: dict[str, float]  # fitted value of each parameter; α, L0 and peak in the unit of the values
    rms_rel: float  # root mean square of the relative error over all measured levels above the black
    max_rel: float  # largest relative error over those levels
    max_of_peak: float  # largest error in units of the highest value
    # Standard uncertainty of γ: by the noise of the values, or by how far they miss the formula where that is more
    u_gamma: float

    def figures(self) -> dict[str, Any]:
        """Return all but the name of the model by name."""
        return {name: value for name, value in asdict(self).items() if name != "model"}

    def predict(self, level: ArrayLike) -> Array:
        """Return the model's values at levels 0..1."""
        model = MODELS[self.model]
        return model.curve(np.array(list(self.parameters.values())), np.asarray(level, dtype=np.float64))


def _gamma(p: Array, v: Array) -> Array:
    return np.asarray(p[0] * v ** p[1])


def _gamma_offset(p: Array, v: Array) -> Array:
    return np.asarray(p[0] + p[1] * v ** p[2])


def _pelli_zhang(p: Array, v: Array) -> Array:
    return np.asarray(p[0] + np.maximum(p[1] + p[2] * v, 0.0) ** p[3])


MODELS: Final[dict[str, TransferModel]] = {
    "gamma": TransferModel("gamma", "L = peak·v^γ", ("peak", "gamma"), _gamma, lambda v, y: [float(y.max()), 2.2]),
    "gamma_offset": TransferModel(
        "gamma_offset",
        "L = L0 + range·v^γ (PsychoPy's easy form)",
        ("L0", "range", "gamma"),
        _gamma_offset,
        lambda v, y: [float(y.min()), float(np.ptp(y)), 2.2],
    ),
    "pelli_zhang1991": TransferModel(
        "pelli_zhang1991",
        "L = α + (β + κ·v)^γ, Pelli and Zhang 1991, Vision Research 31, 1337",
        ("alpha", "beta", "kappa", "gamma"),
        _pelli_zhang,
        lambda v, y: [float(y.min()), 0.0, float(np.ptp(y)) ** (1 / 2.2), 2.2],
    ),
}


def fit_transfer(name: str, level: ArrayLike, value: ArrayLike, u: ArrayLike) -> TransferFit:
    """Fit one of the models to measured values.

    Args:
        name: Key of `MODELS`.
        level: Drive 0..1, shape (n,), n at least as many as the model has parameters.
        value: Radiance or luminance, 0 or more, shape (n,).
        u: Standard uncertainty of each value; a floor of 0.2 % of the value is added, since no display follows a
            formula better.

    Raises:
        ValueError: If there are too few levels or the fit does not converge.
    """
    model = MODELS[name]
    v, y, sigma = (np.asarray(a, dtype=np.float64) for a in (level, value, u))
    if v.size < len(model.parameters):
        raise ValueError(f"{name} needs at least {len(model.parameters)} levels, not {v.size}")
    scale = np.hypot(sigma, 0.002 * y) + 1e-6 * y.max()
    start = np.array(model.start(v, y))

    def residuals(p: Array) -> Array:
        return np.asarray((model.curve(p, v) - y) / scale)

    low, high = np.array([(-np.inf, np.inf)] * (start.size - 1) + [_EXPONENTS]).T
    found = least_squares(residuals, start, bounds=(low, high), x_scale=np.maximum(np.abs(start), 0.01), max_nfev=2000)
    if not found.success:
        raise ValueError(f"{name}: the fit did not converge ({found.message})")
    missed = 2.0 * found.cost / max(v.size - start.size, 1)  # χ² per degree of freedom (Birge 1932)
    jacobian = np.asarray(found.jac, dtype=np.float64)
    try:
        u_gamma = math.sqrt(max(missed, 1.0) * abs(float(np.linalg.inv(jacobian.T @ jacobian)[-1, -1])))
    except np.linalg.LinAlgError:
        u_gamma = math.inf
    return _judged(model, found.x, v, y, u_gamma)


def _judged(model: TransferModel, parameters: Array, v: Array, y: Array, u_gamma: float) -> TransferFit:
    error = model.curve(parameters, v) - y
    lit = (v > 0) & (y > 0)
    relative = error[lit] / y[lit]
    return TransferFit(
        model.name,
        dict(zip(model.parameters, (float(p) for p in parameters), strict=True)),
        rms_rel=float(np.sqrt(np.mean(relative**2))),
        max_rel=float(np.abs(relative).max()),
        max_of_peak=float(np.abs(error).max() / y.max()),
        u_gamma=u_gamma,
    )


FORMAT = "radiometer-screen/1"
RADIANCE, LUMINANCE, SCOTOPIC = "W sr-1 m-2", "cd m-2", "scotopic cd m-2"

# Displays follow a power law of about this exponent, so its root is nearly a straight line of the level.
_MOST_FALL: Final = 0.1  # share of a screen's range by which its light may fall; noise of meters is far below
_STRAIGHTENING: Final = 1 / 2.2
# What a channel drives of red, green and blue.
AXES: Final = {"grey": (1, 1, 1), "red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1)}
# Attributes of a channel that have another name in the file.
_IN_FILE: Final = {
    "radiance": "radiance_W_per_sr_m2",
    "photopic_lm_per_w": "photopic_lm_per_W",
    "scotopic_lm_per_w": "scotopic_lm_per_W",
}


def rising(values: ArrayLike, u: ArrayLike) -> Array:
    """Return the nearest sequence that never falls, weighted by 1/u².

    Args:
        values: Values in order of level, shape (n,), any unit.
        u: Their standard uncertainties, same unit; 0 counts as very small.

    Source: pool-adjacent-violators (Ayer et al. 1955), scipy.optimize.isotonic_regression.
    """
    sigma = np.asarray(u, dtype=np.float64)
    largest = float(sigma.max(initial=0.0))
    shares = np.maximum(sigma / largest, 1e-3) if largest > 0.0 else np.ones_like(sigma)
    fitted = isotonic_regression(np.asarray(values, dtype=np.float64), weights=shares**-2.0)
    return np.asarray(fitted.x, dtype=np.float64)


class LevelTable:
    """Values over levels, interpolated by a monotone cubic in the straightened value above the black.

    Args:
        levels: Ascending levels 0 to 1, shape (n,), n at least 2.
        values: Values that never fall, 0 or more.

    Source: Fritsch and Carlson 1980 (monotone piecewise cubic interpolation), on (value − black)^(1/2.2).
    """

    def __init__(self, levels: ArrayLike, values: ArrayLike) -> None:
        self.levels = np.asarray(levels, dtype=np.float64)
        self.values = np.asarray(values, dtype=np.float64)
        self._black = float(self.values[0])
        self._curve = PchipInterpolator(self.levels, np.maximum(self.values - self._black, 0.0) ** _STRAIGHTENING)

    def at(self, level: ArrayLike) -> Array:
        """Return the value at levels between the lowest and the highest of the table."""
        inside = np.clip(np.asarray(level, dtype=np.float64), self.levels[0], self.levels[-1])
        straight = np.asarray(self._curve(inside), dtype=np.float64)
        return np.asarray(self._black + np.maximum(straight, 0.0) ** (1 / _STRAIGHTENING), dtype=np.float64)

    def level_of(self, value: float) -> float:
        """Return the lowest level that reaches a value between the table's lowest and highest."""
        low, high = float(self.levels[0]), float(self.levels[-1])
        for _ in range(60):  # 2^-60 of the range: below the resolution of a double
            middle = 0.5 * (low + high)
            low, high = (low, middle) if float(self.at(middle)) >= value else (middle, high)
        return high


class _ChannelForm(ConfigSection):
    """A channel as the file holds it."""

    levels: tuple[Annotated[int, Field(ge=0)], ...]
    radiance_W_per_sr_m2: tuple[float, ...]  # noqa: N815 (the file's key)
    u_independent: tuple[Annotated[float, Field(ge=0)], ...]
    u_common_rel: float = Field(ge=0)
    photopic_lm_per_W: float = Field(gt=0)  # noqa: N815
    scotopic_lm_per_W: float = Field(gt=0)  # noqa: N815
    spectrum: str
    detection_limit: float = Field(0.0, ge=0)
    bits: int = Field(8, ge=1, le=16)
    u_spectrum_rel: dict[str, Annotated[float, Field(ge=0)]] = Field(default_factory=dict)
    fits: dict[str, Any] = Field(default_factory=dict)  # of its curve, for people and other programs


@dataclass(frozen=True)
class ChannelCurve:
    """Radiance over the level of one channel ("grey", "red", "green" or "blue")."""

    name: str  # the channel
    levels: tuple[int, ...]  # measured levels as integers 0 to 2^bits − 1, ascending, shape (n,)
    radiance: tuple[float, ...]  # radiance in W·sr⁻¹·m⁻² at each, drift taken out
    u_independent: tuple[float, ...]  # standard uncertainty in W·sr⁻¹·m⁻² of each level by itself
    u_common_rel: float  # relative standard uncertainty shared by all levels
    photopic_lm_per_w: float  # luminous efficacy of the channel's light
    scotopic_lm_per_w: float  # scotopic luminous efficacy of the channel's light
    spectrum: str  # name of the spectrum that the efficacies assume
    detection_limit: float = 0.0  # radiance in W·sr⁻¹·m⁻² below which a level could not be distinguished from no light
    bits: int = 8  # bits per level
    # By unit: relative standard uncertainty, shared by all levels, for the assumed spectrum; the unit that was measured
    # has none
    u_spectrum_rel: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        counts = {len(self.levels), len(self.radiance), len(self.u_independent)}
        if len(counts) != 1 or len(self.levels) < 3:
            raise CalibrationError(f"channel {self.name}: needs three levels or more, each with radiance and u")
        if any(b <= a for a, b in zip(self.levels, self.levels[1:], strict=False)):
            raise CalibrationError(f"channel {self.name}: levels must ascend")
        if self.levels[-1] > self.top_level:
            raise CalibrationError(f"channel {self.name}: level {self.levels[-1]} is above those of {self.bits} bits")

    @property
    def top_level(self) -> int:
        """Return the highest level, 2^bits − 1."""
        return int(2**self.bits - 1)

    @cached_property
    def table(self) -> LevelTable:
        """Return the radiance over the level 0..1, never falling."""
        return LevelTable(np.array(self.levels) / self.top_level, rising(self.radiance, self.u_independent))

    @cached_property
    def _missed(self) -> Array:
        """Return the standard deviation of what interpolation misses within each gap between levels, shape (n − 1,).

        The largest by which any of the four nearest levels is missed when it is left out. Panels step from level to
        level, so that a smaller gap misses no less. Where a curve has a kink, one level shows it, not all. Steps that
        recur every few levels may miss all four by chance (every fifth step of a DELL 2001FP is a third too small).
        So it is at least the typical error at the sixteen nearest levels, as a share of the rise.
        """
        values = self.table.values
        errors = np.abs(_left_out_errors(np.array(self.levels) / self.top_level, values))
        padded = np.concatenate([errors[:1], errors, errors[-1:]])
        nearest = np.max([padded[:-3], padded[1:-2], padded[2:-1], padded[3:]], axis=0)
        shares = errors / np.maximum(np.gradient(values), 1e-12 * max(float(values[-1]), 1e-300))
        around = [shares[max(0, gap - 7) : gap + 9] for gap in range(values.size - 1)]
        typical = np.array([robust_sigma(near, 0.0) for near in around])
        return np.asarray(np.maximum(nearest, typical * np.diff(values)))

    def radiance_at(self, level: float) -> Quantity:
        """Return the radiance at a level (integer or between), with the total standard uncertainty.

        Raises:
            SettingOutOfRange: If the level is outside what was measured.
        """
        return self.at(level)

    def at(self, level: float, unit: str = RADIANCE) -> Quantity:
        """Return radiance, luminance or scotopic luminance at a level, with the total standard uncertainty.

        Raises:
            SettingOutOfRange: If the level is outside what was measured.
            CalibrationError: If the unit is none of the three.
        """
        factor = self.efficacy(unit)
        low, high = self.levels[0], self.levels[-1]
        if not low <= level <= high:
            raise SettingOutOfRange(f"screen channel {self.name}", "level", level, low, high, "")
        value = float(self.table.at(level / self.top_level))
        u = math.hypot(self.u_shape_at(level), value * self.u_shared_rel(unit))
        return Quantity(value * factor, u * factor, unit)

    def u_shared_rel(self, unit: str) -> float:
        """Return the relative standard uncertainty that all levels share in a unit: scale, lens, assumed spectrum."""
        return math.hypot(self.u_common_rel, self.u_spectrum_rel.get(unit, 0.0))

    def u_shape_at(self, level: float) -> float:
        """Return the standard uncertainty in W·sr⁻¹·m⁻² at a level without what all levels share."""
        independent = float(np.interp(level, self.levels, self.u_independent))
        gap = min(max(bisect_right(self.levels, level) - 1, 0), len(self.levels) - 2)
        into = (level - self.levels[gap]) / (self.levels[gap + 1] - self.levels[gap])
        # Nothing is missed at a measured level; next to it the steps of the panel are, in the middle the curve as well.
        between = float(self._missed[gap]) * (0.6 + 1.6 * into * (1.0 - into)) if 0.0 < into < 1.0 else 0.0
        if gap == 0 and 0.0 < into < 1.0:
            between = max(between, self._unknown_above_black(level, into))
        lost = self.detection_limit / 2 if self.radiance_is_lost(level) else 0.0
        return max(math.hypot(independent, between), lost)

    def _unknown_above_black(self, level: float, into: float) -> float:
        """Return the standard uncertainty of the curve between black and the next level in W·sr⁻¹·m⁻².

        No level there can be left out. Between the power law and the straight line all values count alike.
        """
        black, next_one = (float(value) for value in self.table.values[:2])
        line = black + (next_one - black) * into
        return abs(line - float(self.table.at(level / self.top_level))) / math.sqrt(3.0)

    def radiance_is_lost(self, level: float) -> bool:
        """Return whether the radiance at a level is below what could be detected."""
        return float(self.table.at(level / self.top_level)) < self.detection_limit

    def efficacy(self, unit: str) -> float:
        """Return what a radiance is multiplied by to give a quantity in a unit.

        Raises:
            CalibrationError: If the unit is none of the three.
        """
        known = {RADIANCE: 1.0, LUMINANCE: self.photopic_lm_per_w, SCOTOPIC: self.scotopic_lm_per_w}
        if unit not in known:
            raise CalibrationError(f"unit {unit!r}: a screen is known in {', '.join(known)}")
        return known[unit]

    def level_for(self, target: float, unit: str = RADIANCE) -> int:
        """Return the whole level whose value is nearest to a target.

        Raises:
            SettingOutOfRange: If the screen cannot show it.
            CalibrationError: If the unit is unknown.
        """
        factor = self.efficacy(unit)
        low, high = (float(v) * factor for v in (self.table.values[0], self.table.values[-1]))
        rounding = 1e-9 * high
        if not low - rounding <= target <= high + rounding:
            raise SettingOutOfRange(f"screen channel {self.name}", "target", target, low, high, unit)
        exact = self.table.level_of(target / factor) * self.top_level
        near = {max(self.levels[0], math.floor(exact)), min(self.levels[-1], math.ceil(exact))}
        return min(near, key=lambda n: abs(float(self.table.at(n / self.top_level)) * factor - target))

    def fits(self) -> dict[str, TransferFit]:
        """Return every model of `MODELS` that these levels suffice for, fitted.

        Raises:
            CalibrationError: If the light does not rise with the level as that of a display does.
        """
        levels, values = np.array(self.levels) / self.top_level, np.array(self.radiance)
        fall = float(np.max(np.maximum.accumulate(values) - values))
        if fall > _MOST_FALL * float(np.ptp(values)):
            raise CalibrationError(
                f"the light does not rise with the level as that of a display does: it falls by "
                f"{100.0 * fall / float(np.ptp(values)):.0f} % of its range; correct the levels, or measure again"
            )
        usable = [name for name, model in MODELS.items() if len(self.levels) >= len(model.parameters)]
        try:
            return {name: fit_transfer(name, levels, self.radiance, self.u_independent) for name in usable}
        except ValueError as error:
            raise CalibrationError(f"the light over the level is not that of a display: {error}") from error

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping that is written to the file."""
        mapping = {key: finite_or_null(getattr(self, name)) for name, key in self._keys().items()}
        return mapping | {"fits": {name: finite_or_null(fit.figures()) for name, fit in self.fits().items()}}

    @classmethod
    def from_mapping(cls, name: str, mapping: Mapping[str, Any], where: str) -> ChannelCurve:
        """Return the channel that a mapping describes. Raises CalibrationError."""
        if not isinstance(mapping, Mapping):
            raise CalibrationError(f"{where}: channel {name}: {str(mapping)[:40]!r} holds no keys and values")
        form = dict(validate(_ChannelForm, mapping, f"{where}: channel {name}", CalibrationError))
        return cls(name, **{attribute: form[key] for attribute, key in cls._keys().items()})

    @classmethod
    def _keys(cls) -> dict[str, str]:
        """Return the key in the file of every attribute; a channel's name is the key of its section."""
        return {one.name: _IN_FILE.get(one.name, one.name) for one in fields(cls) if one.name != "name"}


@dataclass(frozen=True)
class ScreenCalibration:
    """A calibrated screen."""

    name: str  # what the screen is called
    channels: dict[str, ChannelCurve]  # curves by channel name; "grey" always
    instrument: str = ""  # serial number of the camera
    created: str = field(default_factory=utc_now)  # ISO 8601 time in UTC
    # Findings in addition to the curves: drift, flicker, uniformity, additivity
    checks: dict[str, Any] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=lambda: Provenance("unknown"))  # method, inputs and assumptions
    pixel_mm: float | None = None  # distance of two pixels in mm, where somebody has measured it
    # CIE 1931 chromaticity (x, y) of a channel's brightest level, where a colorimeter has measured it
    chromaticities: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # "camera", "lens" and "calibration" that measured it, in words; empty where another program did
    measured_with: Mapping[str, str] = field(default_factory=dict)

    def channel(self, name: str = "grey") -> ChannelCurve:
        """Return a channel. Raises CalibrationError where it was not measured."""
        if name not in self.channels:
            raise CalibrationError(
                f"screen {self.name}: channel {name!r} was not measured; known: {', '.join(self.channels)}"
            )
        return self.channels[name]

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping that is written to the file."""
        return {
            "format": FORMAT,
            "name": self.name,
            "created": self.created,
            "instrument": self.instrument,
            "pixel_mm": self.pixel_mm,
            "chromaticities": {name: list(xy) for name, xy in self.chromaticities.items()},
            "measured_with": dict(self.measured_with),
            "checks": self.checks,
            "provenance": self.provenance.to_mapping(),
            "channels": {name: curve.to_mapping() for name, curve in self.channels.items()},
        }

    def write(self, path: Path) -> None:
        """Write the calibration as YAML, whole or not at all. Raises OutputError."""
        write_yaml_atomic(path, self.to_mapping())

    @classmethod
    def read(cls, path: Path) -> ScreenCalibration:
        """Return the calibration in a file. Raises InputError, CalibrationError."""
        mapping = read_yaml(path)
        if mapping.get("format") != FORMAT:
            raise CalibrationError(f"{path}: format is {mapping.get('format')!r}; expected {FORMAT!r}")
        refuse_unknown(mapping, ("format", *(one.name for one in fields(cls))), str(path), CalibrationError)
        channels, checks = mapping.get("channels"), mapping.get("checks") or {}
        if not isinstance(channels, dict) or "grey" not in channels:
            raise CalibrationError(f"{path}: holds no channel 'grey'; calibrate the screen again")
        if not isinstance(checks, dict):
            raise CalibrationError(
                f"{path}: checks are {str(checks)[:40]!r}, not a mapping; calibrate the screen again"
            )
        return cls(
            str(mapping.get("name", path.stem)),
            {n: ChannelCurve.from_mapping(n, m, str(path)) for n, m in channels.items()},
            str(mapping.get("instrument", "")),
            str(mapping.get("created", "")),
            dict(checks),
            Provenance.from_mapping(mapping.get("provenance"), str(path)),
            _length(mapping.get("pixel_mm"), path),
            _chromaticities(mapping.get("chromaticities") or {}, path),
            {str(name): str(text) for name, text in dict(mapping.get("measured_with") or {}).items()},
        )


def _chromaticities(stated: object, path: Path) -> dict[str, tuple[float, float]]:
    """Return chromaticities by channel. Raises CalibrationError where one is none."""
    if not isinstance(stated, dict):
        raise CalibrationError(f"{path}: chromaticities are {str(stated)[:40]!r}, not a mapping of channels to [x, y]")
    found = {}
    for name, xy in stated.items():
        try:
            x, y = (float(one) for one in xy)
        except (TypeError, ValueError):
            x = y = math.nan
        if not (x >= 0.0 and y > 0.0 and x + y <= 1.0):
            raise CalibrationError(f"{path}: chromaticity of {name} is {str(xy)[:40]}; expected [x, y] with x + y ≤ 1")
        found[str(name)] = (x, y)
    return found


def _length(value: object, path: Path) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float) or not value > 0:
        raise CalibrationError(f"{path}: pixel_mm is {value!r}; expected a length in mm above 0")
    return float(value)


def _left_out_errors(levels: Array, values: Array) -> Array:
    """Return how far the curve through the others misses each level; the ends take their neighbour's figure.

    With a level left out the gap is twice as wide. For a smooth curve this is more than is missed in the real gaps.
    For a panel that steps from level to level it is as much.
    """
    errors = np.zeros_like(values)
    for i in range(1, len(levels) - 1):
        keep = np.arange(len(levels)) != i
        errors[i] = float(LevelTable(levels[keep], values[keep]).at(levels[i])) - values[i]
    errors[0], errors[-1] = errors[1], errors[-2]
    return errors

"""Indices that compare readings of one source: linearity, temperature, modulation, polarisation, range, focus, f1′."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.photometry.photometry import luminous_efficiency, spectrum
from radiometer.analysis.quality.signals import Deviation, StepSignal, deviation
from radiometer.data.calibration import SpectralResponse
from radiometer.errors import MeasurementError

# f6 is stated for this change of temperature.
_PER_K: Final = 10.0
_LEAST_CHANGE_K: Final = 2.0
_TEMPERATURE_U_K: Final = 0.3  # of a difference read from one sensor's thermometer: half its usual step of 1 K
_LEAST_SHARE: Final = 0.02  # signals below this part of the largest are the dark level's business
_FEWEST_ANGLES: Final = 3
_STEP_NM: Final = 1.0  # the step of the tables of V(λ)
_DRAWS: Final = 2000  # the u of an index is then known to 1.6 %
# Errors of a digitised curve go together over about this width.
_CORRELATED_NM: Final = 50.0


@dataclass(frozen=True, slots=True)
class Figure:
    """What was found for one index."""

    value: float  # the index; a ratio, or pixels where the unit says so
    u: float  # its standard uncertainty
    degrees_of_freedom: float = math.inf  # effective ones
    unit: str = "1"  # "1" or "px"
    details: tuple[Deviation, ...] = ()  # what it was found from
    remarks: tuple[str, ...] = ()  # what must be known of it


def worst_deviation(signals: Sequence[StepSignal], reference: StepSignal, source_u_rel: float) -> Figure:
    """Return the largest |Y/Y_reference − 1| over all other steps.

    Args:
        signals: Readings, the reference among them or not.

    Raises:
        MeasurementError: If there is no other step, or the reference reads no light.
    """
    found = tuple(deviation(one, reference, source_u_rel) for one in signals if one.name != reference.name)
    if not found:
        raise MeasurementError(f"only step {reference.name!r} was captured; it needs another to be compared with")
    worst = max(found, key=lambda one: abs(one.value))
    return Figure(abs(worst.value), worst.u, worst.degrees_of_freedom, details=found)


def linearity(signals: Mapping[float, StepSignal], exposure_u_rel: float, source_u_rel: float) -> Figure:
    """Return f3 from readings of a steady source at several exposure times.

    A reading is a rate, signal over exposure time, so that Y/X is the reading itself.

    Args:
        signals: Readings made from the frames of one exposure time each, by that time in s.
        exposure_u_rel: Relative standard uncertainty of the ratio of two exposure times.

    Raises:
        MeasurementError: If fewer than three exposure times are left.
    """
    longest = max(signals)
    signal = {t: t * one.value for t, one in signals.items()}
    kept = {t: one for t, one in signals.items() if signal[t] >= _LEAST_SHARE * signal[longest]}
    if len(kept) < 3:
        raise MeasurementError(
            f"{len(kept)} usable exposure times; linearity needs three or more between "
            f"{100 * _LEAST_SHARE:g} % and all of the range"
        )
    found = []
    for t, one in sorted(kept.items()):
        if t == longest:
            continue
        plain = deviation(one, kept[longest], source_u_rel, f"{1e3 * t:.4g} ms")
        u = math.hypot(plain.u, exposure_u_rel)
        found.append(Deviation(plain.label, plain.value, u, plain.degrees_of_freedom))
    worst = max(found, key=lambda one: abs(one.value))
    return Figure(abs(worst.value), worst.u, worst.degrees_of_freedom, details=tuple(found))


def temperature(signals: Sequence[StepSignal], source_u_rel: float) -> Figure:
    """Return f6: the relative change of the reading for 10 K, from the two steps farthest apart in temperature.

    Raises:
        MeasurementError: If temperatures are not stated or are nearer than 2 K.
    """
    known = sorted((one for one in signals if one.temperature_c is not None), key=lambda one: one.temperature_c or 0.0)
    if len(known) < 2:
        raise MeasurementError("the frames of two steps must state their temperature; this camera has no thermometer")
    cool, warm = known[0], known[-1]
    change = (warm.temperature_c or 0.0) - (cool.temperature_c or 0.0)
    if change < _LEAST_CHANGE_K:
        raise MeasurementError(
            f"the steps are {change:.2g} K apart; they need {_LEAST_CHANGE_K:g} K at least, 10 K are good"
        )
    plain = deviation(warm, cool, source_u_rel, f"{change:.3g} K")
    per_10 = plain.scaled(_PER_K / change)
    u = math.hypot(per_10.u, per_10.value * _TEMPERATURE_U_K / change)
    per_kelvin = Deviation("per K", per_10.value / _PER_K, u / _PER_K, per_10.degrees_of_freedom)
    return Figure(abs(per_10.value), u, per_10.degrees_of_freedom, details=(plain, per_kelvin))


def polarisation(signals: Mapping[float, StepSignal], source_u_rel: float) -> Figure:
    """Return f8 from readings at several angles in degrees: the amplitude of Y₀·(1 + a·cos 2φ + b·sin 2φ).

    The plain amplitude of noise is no polarisation: its expected square, u_a² + u_b², is taken off.

    Raises:
        MeasurementError: If there are fewer than three angles that differ by other than 180°.
    """
    angles = np.radians(sorted(signals))
    distinct = {round(angle % 180.0, 3) for angle in signals}
    if len(distinct) < _FEWEST_ANGLES:
        raise MeasurementError(f"{len(distinct)} different angles; polarisation needs three or more, such as 0, 45, 90")
    ordered = [signals[angle] for angle in sorted(signals)]
    values = np.array([one.value for one in ordered])
    u = np.array([deviation(one, ordered[0], source_u_rel).u / math.sqrt(2.0) for one in ordered]) * values[0]
    u[0] = u[1:].mean()
    design = np.stack([np.ones_like(angles), np.cos(2.0 * angles), np.sin(2.0 * angles)], axis=1)
    weighted = design / u[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    mean, a, b = (float(one) for one in covariance @ weighted.T @ (values / u))
    squared = a**2 + b**2
    noise = float(covariance[1, 1] + covariance[2, 2])
    amplitude = math.sqrt(squared) / mean
    direction = np.array([a, b]) / math.sqrt(squared) if squared > 0.0 else np.array([1.0, 0.0])
    spread = math.sqrt(float(direction @ covariance[1:, 1:] @ direction)) / mean
    value = math.sqrt(max(squared - noise, 0.0)) / mean
    axis = math.degrees(0.5 * math.atan2(b, a)) % 180.0
    details = tuple(
        Deviation(f"{angle:g}°", float(y) / mean - 1.0, float(u_y) / mean)
        for angle, y, u_y in zip(sorted(signals), values, u, strict=True)
    )
    # An amplitude that noise alone gives has no axis.
    remark = f"largest at {axis:.0f}°; amplitude before noise {100.0 * amplitude:.2g} %"
    return Figure(value, spread, details=details, remarks=(remark,) if value > 0.0 else ())


def glare_index(white: StepSignal, black: StepSignal, source_u_rel: float) -> Figure:
    """Return the veiling glare index: what a black patch reads over what white reads at its place.

    Source: ISO 9358, the black patch method.
    """
    plain = deviation(black, white, source_u_rel, "black over white − 1")
    return Figure(
        plain.value + 1.0,
        plain.u,
        plain.degrees_of_freedom,
        details=(plain,),
        remarks=("the black patch is assumed to give no light",),
    )


def size_of_source(signals: Mapping[float, StepSignal], source_u_rel: float) -> Figure:
    """Return the largest deviation of a source of some diameter from the largest one of the same radiance."""
    largest = signals[max(signals)]
    return worst_deviation([signals[size] for size in sorted(signals)], largest, source_u_rel)


def v_lambda_mismatch(response: SpectralResponse) -> Figure:
    """Return f1′ of a spectral response, with what its own uncertainty makes of it.

    Args:
        response: Relative responsivity per watt; it counts as 0 outside its wavelengths, and all of it counts.

    Source: ISO/CIE 19476; CIE S 023: s* = s·∫S_A·V dλ / ∫S_A·s dλ with CIE illuminant A, f1′ = ∫|s* − V| dλ / ∫V dλ.
    """
    wavelength_nm, v = luminous_efficiency()
    low = min(float(wavelength_nm[0]), response.wavelength_nm[0])
    high = max(float(wavelength_nm[-1]), response.wavelength_nm[-1])
    grid = np.arange(low, high + _STEP_NM, _STEP_NM)
    observer = np.interp(grid, wavelength_nm, v, left=0.0, right=0.0)
    own = np.interp(grid, response.wavelength_nm, response.relative, left=0.0, right=0.0)
    value = float(_mismatch(own[np.newaxis], observer, grid)[0])
    drawn = _mismatch(own * _errors(grid, response.u_rel), observer, grid)
    return Figure(value, float(np.std(drawn)), remarks=(f"responsivity known to {100 * response.u_rel:.2g} %",))


def _mismatch(
    own: NDArray[np.float64], observer: NDArray[np.float64], grid: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return f1′ of each row of responsivities on an even grid."""
    light = spectrum("cie_a")
    power = np.interp(grid, light.wavelength_nm, light.power, left=0.0, right=0.0)
    matched = own * ((power @ observer) / (own @ power))[:, np.newaxis]
    return np.asarray(np.abs(matched - observer).sum(axis=1) / observer.sum())


def _errors(grid: NDArray[np.float64], u_rel: float) -> NDArray[np.float64]:
    """Return factors 1 + error that go together over some 50 nm, shape (draws, wavelengths)."""
    rng = np.random.default_rng(0)
    knots = np.arange(grid[0], grid[-1] + _CORRELATED_NM, _CORRELATED_NM)
    errors = rng.normal(0.0, u_rel, (_DRAWS, knots.size))
    return 1.0 + np.stack([np.interp(grid, knots, row) for row in errors])

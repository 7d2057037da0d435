"""The dynamic-range procedure: the exponent of a response, and its ends, from regions brought to one reference value.

A response recovered without known exposure ratios is right up to an exponent (f^γ for every γ). In the reference
photograph, of exposure time t, one region comes out near black (M = 1) and one near white (M = 254). Each is
photographed again at such a time t' that it lands on the reference value. Its irradiance is then H_ref/t', and its
exposure in the reference photograph H(M) = H_ref·t/t'.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.curves import u_with_extrapolation
from radiometer.data.provenance import Provenance
from radiometer.data.response_curve import ResponseCurve
from radiometer.errors import InputError, MeasurementError

# A digital number represents an interval of width 1: a rectangle.
_ROUNDING_U_DN: Final = 1.0 / math.sqrt(12.0)
_LEAST_DISTANCE: Final = 0.2


@dataclass(frozen=True, slots=True)
class RangePoint:
    """A region brought to the reference value."""

    dn: float  # its digital number in the reference photograph; may be a mean over the region
    exposure_s: float  # time t' in s of the photograph that shows it at the reference value
    # Digital number that it came out at there; None where that is the reference value itself
    landed_dn: float | None = None

    def landed(self, reference_dn: float) -> float:
        """Return the digital number that it came out at."""
        return reference_dn if self.landed_dn is None else self.landed_dn


@dataclass(frozen=True, slots=True)
class DynamicRange:
    """What the regions say of a curve."""

    exponent: float  # γ by which ln H of the curve is to be multiplied
    u_exponent: float  # its standard uncertainty
    points: tuple[RangePoint, ...]  # the regions
    reference_dn: float  # reference value M_ref
    reference_s: float  # exposure time of the reference photograph in s
    log_steps: tuple[float, ...]  # ln(t/t') of every region: ln H(M) − ln H_ref
    u_log_steps: tuple[float, ...]  # standard uncertainty of ln H(M) − ln H_ref, from reading both digital numbers
    reduced_chi2: float | None  # scatter of the regions' own exponents about γ; None for a single one

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON and provenance."""
        return {
            "exponent": self.exponent,
            "u_exponent": self.u_exponent,
            "reduced_chi2": self.reduced_chi2,
            "reference_dn": self.reference_dn,
            "reference_exposure_s": self.reference_s,
            "points": [
                {"dn": one.dn, "exposure_s": one.exposure_s, "log_exposure_from_reference": step, "u": u}
                for one, step, u in zip(self.points, self.log_steps, self.u_log_steps, strict=True)
            ],
        }


def dynamic_range(
    curve: ResponseCurve, points: Sequence[RangePoint], reference_s: float, reference_dn: float
) -> DynamicRange:
    """Return the exponent of a relative curve that regions brought to the reference value call for.

    Every region gives γ = ln(t/t') / [g(M) − g(M_landed)]; the mean is weighted by the uncertainty of the curve
    at both numbers and of reading them.

    Args:
        points: The regions, at least one; best one near black and one near white.
        reference_s: Exposure time t of the reference photograph in s, above 0.
        reference_dn: Reference value M_ref.

    Raises:
        InputError: If a number is outside the curve or a time is not above 0.
        MeasurementError: If a region is not clearly darker or brighter than the reference value, its time runs the
            wrong way, or the curve says nothing there.

    Source: physics of the source thesis, its absolute curve after Mitsunaga and Nayar; the exponent after T. Mitsunaga,
    S. K. Nayar, CVPR 1999, section 3.2.
    """
    if not points:
        raise InputError("the dynamic range needs at least one region brought to the reference value")
    for value in (reference_s, *(one.exposure_s for one in points)):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"exposure time {value:g} s: must be above 0")
    found = [_one_exponent(curve, one, reference_s, reference_dn) for one in points]
    exponents = np.array([value for value, _ in found])
    weight = 1.0 / np.array([u for _, u in found]) ** 2
    exponent = float(weight @ exponents / weight.sum())
    chi2 = float(weight @ (exponents - exponent) ** 2)
    freedom = len(points) - 1
    g, g_ref = curve.log_exposure, _at(curve.log_exposure, reference_dn)  # a region lands near the reference value
    landings = [exponent * (_at(g, one.landed(reference_dn)) - g_ref) for one in points]
    steps = tuple(math.log(reference_s / one.exposure_s) + more for one, more in zip(points, landings, strict=True))
    return DynamicRange(
        exponent,
        # Regions that disagree beyond their uncertainty widen that of the mean (Birge ratio).
        float(weight.sum() ** -0.5) * math.sqrt(max(1.0, chi2 / freedom if freedom else 1.0)),
        tuple(points),
        reference_dn,
        reference_s,
        steps,
        tuple(exponent * _reading_u(curve, one, reference_dn) for one in points),
        chi2 / freedom if freedom else None,
    )


def with_dynamic_range(curve: ResponseCurve, found: DynamicRange) -> ResponseCurve:
    """Return the relative curve with its exponent put right and its ends at the exposures of the regions.

    Inside the range that data support, ln H = γ·g. Outside it, towards a region, the curve runs to that region's
    measured exposure on a line over ln M, and what the region moved it by counts as uncertain on the way.
    """
    middle = curve.mid_dn
    g = found.exponent * curve.log_exposure
    u = np.hypot(found.exponent * u_with_extrapolation(curve), curve.log_exposure * found.u_exponent)
    g_ref = _at(g, found.reference_dn)
    for one, step, u_step in zip(found.points, found.log_steps, found.u_log_steps, strict=True):
        g, u = _run_to(g, u, curve.valid_dn, one.dn, g_ref + step, u_step)
    old = curve.provenance
    text = f"exponent {found.exponent:.4f} ± {found.u_exponent:.4f} by the dynamic range of {len(found.points)} regions"
    parameters = {**old.parameters, "dynamic_range": found.to_mapping()}
    provenance = Provenance(old.method, old.inputs, (*old.assumptions, text), parameters)
    return replace(curve, log_exposure=g - g[middle], u_log_exposure=u, provenance=provenance)


def _one_exponent(
    curve: ResponseCurve, one: RangePoint, reference_s: float, reference_dn: float
) -> tuple[float, float]:
    """Return the exponent that one region calls for, and its standard uncertainty."""
    landed = one.landed(reference_dn)
    for dn in (one.dn, landed):
        if not 0.0 < dn < curve.log_exposure.size - 1:
            raise InputError(f"pixel value {dn:g}: allowed is above 0 and below {curve.log_exposure.size - 1}")
    distance = _at(curve.log_exposure, one.dn) - _at(curve.log_exposure, landed)
    step = math.log(reference_s / one.exposure_s)
    if not (math.isfinite(distance) and abs(distance) >= _LEAST_DISTANCE):
        raise MeasurementError(
            f"the region at {one.dn:g} DN is too near to the {landed:g} DN that it was brought to, or the curve says "
            "nothing there; choose regions near black and near white"
        )
    if step * distance <= 0.0:
        direction = "longer" if distance < 0 else "shorter"
        raise MeasurementError(
            f"the region at {one.dn:g} DN needs a {direction} time than the reference photograph's {reference_s:g} s "
            f"to land on {landed:g} DN; stated is {one.exposure_s:g} s"
        )
    known = u_with_extrapolation(curve)
    of_curve = math.hypot(_at(known, one.dn), _at(known, landed))
    u_distance = math.hypot(of_curve, _reading_u(curve, one, reference_dn))
    exponent = step / distance
    return exponent, exponent * u_distance / abs(distance)


def _reading_u(curve: ResponseCurve, one: RangePoint, reference_dn: float) -> float:
    """Return the uncertainty in g of reading both digital numbers as whole ones."""
    return _ROUNDING_U_DN * math.hypot(*(_slope(curve.log_exposure, dn) for dn in (one.dn, one.landed(reference_dn))))


def _run_to(
    g: NDArray[np.float64],
    u: NDArray[np.float64],
    valid_dn: tuple[int, int] | None,
    dn: float,
    target: float,
    u_requested: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return curve and uncertainty that run from the edge of the supported range to a measured point outside it."""
    if valid_dn is None or valid_dn[0] <= dn <= valid_dn[1]:
        return g, u
    edge = valid_dn[0] if dn < valid_dn[0] else valid_dn[1]
    numbers = np.arange(g.size, dtype=np.float64)
    moved = target - _at(g, dn)
    below = dn < edge
    if (target - g[edge]) * (-1.0 if below else 1.0) < 0.0:
        return g, u  # within the noise of its reading the point is on the wrong side of the edge
    place = (np.log(np.maximum(numbers, 0.5)) - math.log(edge)) / (math.log(dn) - math.log(edge))
    part = np.clip(place, 0.0, 1.0)
    outside = numbers < edge if below else numbers > edge
    line = g[edge] + part * (target - g[edge])
    beyond = numbers < dn if below else numbers > dn
    line = np.where(beyond, g + moved, line)
    between = np.hypot((1.0 - part) * u[edge], part * u_requested) + 2.0 * part * (1.0 - part) * abs(moved)
    spread = np.where(beyond, np.hypot(u_requested, np.abs(g + moved - target)), between)
    return np.where(outside, line, g), np.where(outside, spread, u)


def _at(values: NDArray[np.float64], dn: float) -> float:
    return float(np.interp(dn, np.arange(values.size), values))


def _slope(g: NDArray[np.float64], dn: float) -> float:
    lowest = float(np.flatnonzero(np.isfinite(g))[0])  # many curves have no value at black
    low, high = max(dn - 0.5, lowest), dn + 0.5
    return (_at(g, high) - _at(g, low)) / (high - low)

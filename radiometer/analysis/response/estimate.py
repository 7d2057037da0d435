"""Result of a response method: the curve and what must be known to trust it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.samples import ResponseSamples
from radiometer.data.response_curve import ResponseCurve
from radiometer.errors import MeasurementError

# Less than this is no curve but a point, and one that is not known to a factor of e says nothing.
_FEWEST_STOPS = 0.1
_LARGEST_U_LOG = 1.0
# Readings use the range from about 10 to 90 % of full scale, which is 3.2 stops: a curve of less does not cover them.
_NARROW_STOPS = 3.0


@dataclass(frozen=True, slots=True)
class Stability:
    """How far curves from disjoint thirds of the pixels differ."""

    rms_log: float  # root mean square difference of ln H over 5–95 % of the valid digital numbers
    largest_log: float  # largest difference there
    reduced_chi2: float  # mean squared difference in units of the stated uncertainties; about 1 where these are honest


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far the curves from separate parts of the data differ."""

    # Root mean square distance, in ln H over 5–95 % of the valid digital numbers, of the curves without one quadrant of
    # the picture from their mean. It is scaled to what a quarter of the picture alone would show.
    quadrants_rms_log: float
    frames_rms_log: float  # the same for the curves without one frame (or some)


@dataclass(frozen=True, slots=True, eq=False)
class ResponseEstimate:
    """A recovered response with its diagnostics."""

    curve: ResponseCurve  # the curve, gauge g(M_mid) = 0
    method: str  # name in the registry
    pixel_count: int  # pixels that were used
    group_count: int  # sets of equally bright pixels that they were gathered into
    sample_count: int  # unclipped values (pixels × frames) behind the curve
    residual_rms_log: float  # root mean square of ln H residuals, weighted as the method weights them
    smoothing: float  # the λ (or order) that was chosen; its meaning is the method's own
    stability: Stability | None  # agreement of disjoint thirds of the pixels; None where there were too few
    exposure_ratios: NDArray[np.float64]  # exposure of every frame relative to the one before, as recovered
    u_exposure_ratios: NDArray[np.float64]  # standard uncertainty of these ratios; 0 where they were taken as given
    gauge: str = "g(M_mid) = 0; exposure ratios as given"  # what the data could not fix and how it was fixed
    notes: tuple[str, ...] = ()  # things a user must know, in plain sentences
    details: dict[str, Any] = field(default_factory=dict)  # further figures of the method
    # Agreement of parts of the picture and of the frames; None where there were too few
    agreement: Agreement | None = None

    @classmethod
    def of(cls, samples: ResponseSamples, curve: ResponseCurve, method: str, **more: Any) -> ResponseEstimate:
        """Return what a method recovered from samples, with their exposure ratios as given unless it says otherwise."""
        times = samples.frame_log_time
        counted: dict[str, Any] = {
            "pixel_count": samples.pixel_count,
            "group_count": samples.group_count,
            "sample_count": int(samples.pixels.sum()),
            "exposure_ratios": np.exp(np.diff(times)),
            "u_exposure_ratios": np.zeros(times.size - 1),
        }
        return cls(curve=curve, method=method, **(counted | more))

    def to_mapping(self) -> dict[str, Any]:
        """Return the diagnostics (not the curve's values) as plain values for JSON."""
        return {
            "method": self.method,
            "channel": self.curve.channel,
            "bit_depth": self.curve.bit_depth,
            "valid_dn": list(self.curve.valid_dn) if self.curve.valid_dn else None,
            "pixels": self.pixel_count,
            "groups": self.group_count,
            "samples": self.sample_count,
            "residual_rms_log": self.residual_rms_log,
            "smoothing": self.smoothing,
            "median_u_log_exposure": median_uncertainty(self.curve),
            "stability": None if self.stability is None else asdict(self.stability),
            "agreement": None if self.agreement is None else asdict(self.agreement),
            "exposure_ratios": [float(r) for r in self.exposure_ratios],
            "u_exposure_ratios": [float(u) for u in self.u_exposure_ratios],
            "gauge": self.gauge,
            "notes": list(self.notes),
            "details": self.details,
        }


def spread_rms(curves: Sequence[NDArray[np.float64]]) -> float:
    """Return the rms distance of curves from their mean, each left out of one part: scaled to that of the parts.

    Args:
        curves: ln H by digital number, each from all data but one part; at least two.
    """
    values = np.array(curves)
    values = values - values.mean(axis=1, keepdims=True)
    return float((len(values) - 1) * np.sqrt(np.mean((values - values.mean(axis=0)) ** 2)))


def inner_range(valid_dn: tuple[int, int]) -> slice:
    """Return the digital numbers between 5 and 95 % of a valid range."""
    low, high = valid_dn
    return slice(int(np.ceil(low + 0.05 * (high - low))), int(np.floor(low + 0.95 * (high - low))) + 1)


def median_uncertainty(curve: ResponseCurve) -> float:
    """Return the median standard uncertainty of ln H over 5–95 % of the valid digital numbers."""
    valid = curve.valid_dn or (0, curve.log_exposure.size - 1)
    return float(np.median(curve.u_log_exposure[inner_range(valid)]))


def compare_thirds(curves: list[ResponseCurve], whole: ResponseCurve) -> Stability | None:
    """Return how far curves from disjoint pixels differ where they and the curve of all pixels are valid.

    Args:
        curves: Curves from disjoint pixels, at least two.
    """
    ranges = [curve.valid_dn for curve in (*curves, whole) if curve.valid_dn]
    if len(ranges) < 3:
        return None
    low, high = max(r[0] for r in ranges), min(r[1] for r in ranges)
    if high - low < 4:
        return None
    inner = inner_range((low, high))
    values = np.array([c.log_exposure[inner] for c in curves])
    u = np.array([c.u_log_exposure[inner] for c in curves])
    pairs = [(a, b) for a in range(len(curves)) for b in range(a + 1, len(curves))]
    gaps = np.array([values[a] - values[b] for a, b in pairs])
    # Both curves are pinned to 0 at the gauge point, where difference and uncertainty vanish together.
    expected = np.array([u[a] ** 2 + u[b] ** 2 for a, b in pairs])
    free = expected > 1e-6 * float(expected.max(initial=0.0))
    chi2 = float(np.mean(gaps[free] ** 2 / expected[free])) if np.any(free) else float("nan")
    return Stability(float(np.sqrt(np.mean(gaps**2))), float(np.abs(gaps).max()), chi2)


def telling(estimate: ResponseEstimate, where: str) -> ResponseEstimate:
    """Refuse a curve without information: no range, or not known to a factor of e. A narrow range becomes a note.

    Args:
        where: Where the frames came from; "" where it is unknown.

    Raises:
        MeasurementError: If it says nothing.
    """
    curve = estimate.curve
    low, high = curve.valid_dn or (0, curve.log_exposure.size - 1)
    stops = float(curve.log_exposure[high] - curve.log_exposure[low]) / float(np.log(2.0))
    u = median_uncertainty(curve)
    if stops >= _FEWEST_STOPS and not u > _LARGEST_U_LOG:
        return estimate if stops >= _NARROW_STOPS else replace(estimate, notes=(*estimate.notes, _narrow(stops)))
    raise MeasurementError(
        f"{where or 'the frames'}: no response follows from these frames: between {low} and {high} DN "
        f"they give {stops:.3g} stops of exposure, ln H known to {u:.2g} (k = 1). Check that the pictures differ as "
        "their exposure times state, or take more of them, a stop apart, of a scene with bright and dark parts"
    )


def _narrow(stops: float) -> str:
    return (
        f"the data cover {stops:.1f} stops only: readings outside them are extrapolated, and their uncertainty grows. "
        "Bracket a scene with dark and bright parts, or more exposures (`bracket --from --to --stops`)"
    )

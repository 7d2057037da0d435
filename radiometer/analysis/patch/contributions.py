"""The contributions to the uncertainty of a patch reading."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.patch.estimate import PatchEstimate, curve_u_rel
from radiometer.analysis.patch.frames import PatchFrame
from radiometer.analysis.signal.dark import DarkLevel
from radiometer.analysis.signal.model import SignalModel
from radiometer.analysis.signal.situation import (
    f_number_u_rel,
    magnification_u_rel,
    spectral_u_rel,
    transmittance_u_rel,
)
from radiometer.analysis.uncertainty.budget import Term
from radiometer.data import Calibration, LensDescription, StatedUncertainties

_FEWEST_PIXELS_FOR_SCATTER = 16


@dataclass(frozen=True, slots=True, eq=False)
class PatchSituation:
    """Everything a budget is made up from.

    Attributes:
        estimate: Estimate over the used frames.
        frames: Used frames.
        dark: Dark level of each.
        exposures: Exposure time of each in s, times the lens factor in sr.
        good: Pixels used.
        model: Signal model.
        stated: Stated uncertainties.
        scale: Radiance per unit of the estimate.
        calibration: None where uncalibrated.
        lens: Lens in use.
    """

    estimate: PatchEstimate
    frames: tuple[PatchFrame, ...]
    dark: tuple[DarkLevel, ...]
    exposures: NDArray[np.float64]
    good: NDArray[np.bool_]
    model: SignalModel
    stated: StatedUncertainties
    scale: float
    calibration: Calibration | None
    lens: LensDescription

    @property
    def value(self) -> float:
        """Return the radiance, or the relative value."""
        return self.scale * self.estimate.rate


def budget_terms(situation: PatchSituation) -> list[Term]:
    """Return all contributions to a reading's uncertainty, in its unit."""
    return [
        *_observed(situation),
        _response(situation),
        *_dark(situation),
        *_stated(situation),
        *_clipped(situation),
    ]


def local_scatter(pixels: NDArray[np.float64], good: NDArray[np.bool_]) -> tuple[float, int]:
    """Return the standard deviation between neighbouring pixels over √2, and how many pairs it comes from.

    Differences of neighbours leave out slow changes over the patch, which are the scene's and no uncertainty.
    """
    pairs = [
        (pixels[:, 1:] - pixels[:, :-1])[good[:, 1:] & good[:, :-1]],
        (pixels[1:] - pixels[:-1])[good[1:] & good[:-1]],
    ]
    differences = np.concatenate(pairs)
    return (float(np.sqrt(np.mean(differences**2) / 2.0)), differences.size) if differences.size else (0.0, 0)


def _observed(situation: PatchSituation) -> list[Term]:
    """Return repeatability, fixed pattern and source fluctuation."""
    estimate, count = situation.estimate, int(situation.good.sum())
    scatter, _ = local_scatter(estimate.pixel_rates, situation.good)
    enough = count >= _FEWEST_PIXELS_FOR_SCATTER
    pattern = math.sqrt(max(0.0, scatter**2 - estimate.u_pixel**2) / count) if enough else 0.0
    frames = len(situation.frames)
    return [
        Term(
            "repeatability", situation.scale * estimate.u_noise, "A", note=f"noise of {count} pixels in {frames} frames"
        ),
        Term(
            "pixel pattern",
            situation.scale * pattern,
            "A",
            max(count - 1, 1),
            note="scatter between pixels beyond the noise model",
        ),
        Term(
            "source fluctuation",
            situation.scale * estimate.u_fluctuation,
            "A",
            max(estimate.degrees_of_freedom, 1),
            note="difference between frames beyond their noise",
        ),
    ]


def _response(situation: PatchSituation) -> Term:
    estimate = situation.estimate
    each = [
        abs(c) * curve_u_rel(situation.model, frame, x) * abs(x)
        for c, frame, x in zip(estimate.coefficients, situation.frames, estimate.expected, strict=True)
    ]
    note = "stated linearity" if situation.model.linear else "uncertainty of the response curve"
    return Term("response curve", situation.scale * float(sum(each)), correlated=True, note=note)


def _dark(situation: PatchSituation) -> list[Term]:
    c = situation.estimate.coefficients
    own = float(np.sqrt(np.sum((c * [d.u_independent for d in situation.dark]) ** 2)))
    common = float(abs(c @ [d.u_common for d in situation.dark]))
    source = ", ".join(sorted({d.source for d in situation.dark}))
    return [Term("dark and black level", situation.scale * math.hypot(own, common), note=source)]


def _stated(situation: PatchSituation) -> list[Term]:
    value, stated, calibration = abs(situation.value), situation.stated, situation.calibration
    terms = [Term("exposure time", value * stated.exposure_u_rel, note="stated")]
    if calibration is None:
        return terms
    scale = calibration.scale
    return [
        *terms,
        Term(
            "scale",
            value * scale.u_rel,
            "B",
            scale.degrees_of_freedom or math.inf,
            correlated=True,
            note=f"{scale.method.replace('_', ' ')} {scale.reference}".strip(),
        ),
        _f_number(situation, value),
        _transmittance(situation, value),
        _magnification(situation, value),
        Term(
            "flat field",
            value * (calibration.flat_field.u_rel if calibration.flat_field else 0.0),
            correlated=True,
            note="of the correction" if calibration.flat_field else "no flat field in the calibration",
        ),
        Term(
            "spectral assumption",
            value * spectral_u_rel(calibration, stated),
            correlated=True,
            note=calibration.spectrum,
        ),
    ]


def _f_number(situation: PatchSituation, value: float) -> Term:
    numbers = {frame.settings.f_number or situation.lens.f_number for frame in situation.frames}
    u_rel, note = f_number_u_rel(situation.calibration, situation.stated, numbers)
    return Term("f-number", value * u_rel, correlated=True, note=note)


def _transmittance(situation: PatchSituation, value: float) -> Term:
    u_rel, note = transmittance_u_rel(situation.calibration, situation.lens)
    return Term("lens transmittance", value * u_rel, correlated=True, note=note)


def _magnification(situation: PatchSituation, value: float) -> Term:
    u_rel, note = magnification_u_rel(situation.calibration, situation.lens)
    return Term("focus", value * u_rel, correlated=True, note=note)


def _clipped(situation: PatchSituation) -> list[Term]:
    if situation.frames[0].unclipped:
        return []
    return [Term("clipping", abs(situation.value), note="clips in the shortest exposure: the value is a lower bound")]

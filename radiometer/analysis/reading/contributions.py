"""The contributions to the uncertainty of a patch reading."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.photometry.unstated_light import KINDS
from radiometer.analysis.reading.estimate import PatchEstimate, curve_u_rel
from radiometer.analysis.reading.frames import PatchFrame
from radiometer.analysis.reading.outside import Falloff, Surround, outside_terms, stray_light
from radiometer.analysis.signal.dark import DarkLevel
from radiometer.analysis.signal.model import SignalModel
from radiometer.analysis.signal.situation import (
    Situation,
    f_number_u_rel,
    magnification_u_rel,
    spectral_u_rel,
    transmittance_u_rel,
)
from radiometer.analysis.uncertainty.budget import Term
from radiometer.data import Calibration, Flag, LensDescription, ScaleConditions, StatedUncertainties

_FEWEST_PIXELS_FOR_SCATTER = 16
# Origins of a dark level that is not assumed.
_MEASURED = ("dark frames", "masked pixels")
# Readings of signals as near as this share the error of the response curve.
_SAME_LEVEL = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What the frames show of a patch.

    Attributes:
        estimate: Estimate over the used frames.
        frames: Used frames.
        dark: Dark level of each.
        exposures: Exposure time of each in s, times the lens factor in sr.
        good: Pixels used.
        light_frames: Number of light frames seen.
        unsteady: Whether a frame clips that was exposed no longer than one that does not: the light changes.
    """

    estimate: PatchEstimate
    frames: tuple[PatchFrame, ...]
    dark: tuple[DarkLevel, ...]
    exposures: NDArray[np.float64]
    good: NDArray[np.bool_]
    light_frames: int
    unsteady: bool


@dataclass(frozen=True, slots=True, eq=False)
class PatchSituation:
    """Everything a budget is made up from.

    Attributes:
        settled: The setup, and what a measurement with it rests on.
        shown: What the frames show of the patch: estimate, usable frames, their dark levels.
        scale: Radiance per unit of the estimate.
        conditions: What the reading was made under, in the form that a scale keeps.
        surround: Light of the whole picture.
        falloff: What is known of the sensitivity over the picture.
        now: Time of the reading, with time zone.
        stray: Radiance that is taken off for known veiling glare.
    """

    settled: Situation
    shown: Shown
    scale: float
    conditions: ScaleConditions
    surround: Surround
    falloff: Falloff
    now: dt.datetime
    stray: float = 0.0

    @property
    def estimate(self) -> PatchEstimate:
        """Return the estimate over the used frames."""
        return self.shown.estimate

    @property
    def frames(self) -> tuple[PatchFrame, ...]:
        """Return the used frames."""
        return self.shown.frames

    @property
    def dark(self) -> tuple[DarkLevel, ...]:
        """Return the dark level of each used frame."""
        return self.shown.dark

    @property
    def exposures(self) -> NDArray[np.float64]:
        """Return the exposure time of each used frame in s, times the lens factor in sr."""
        return self.shown.exposures

    @property
    def good(self) -> NDArray[np.bool_]:
        """Return the pixels that are used."""
        return self.shown.good

    @property
    def model(self) -> SignalModel:
        """Return the signal model."""
        return self.settled.model

    @property
    def stated(self) -> StatedUncertainties:
        """Return the stated uncertainties."""
        return self.settled.stated

    @property
    def calibration(self) -> Calibration | None:
        """Return the calibration; None for relative values."""
        return self.settled.calibration

    @property
    def lens(self) -> LensDescription:
        """Return the lens in use."""
        return self.settled.lens

    @property
    def spectrum_stated(self) -> bool:
        """Return whether somebody states the light's spectrum."""
        return self.settled.setup.spectrum_stated

    @property
    def value(self) -> float:
        """Return the radiance, or the relative value."""
        return self.scale * self.estimate.rate - self.stray

    @property
    def shares_level(self) -> bool:
        """Return whether the signal is as high as at calibration, so that the response's error drops out."""
        if self.calibration is None or "conditions" not in self.calibration.scale.model_fields_set:
            return False
        return abs(self.conditions.level - self.calibration.scale.conditions.level) <= _SAME_LEVEL


def budget_terms(situation: PatchSituation) -> list[Term]:
    """Return all contributions to a reading's uncertainty, in its unit."""
    return [
        *_observed(situation),
        _response(situation),
        *_dark(situation),
        *_stated(situation),
        *_outside(situation),
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
    frames = len(situation.frames)
    return [
        Term(
            "repeatability", situation.scale * estimate.u_noise, "A", note=f"noise of {count} pixels in {frames} frames"
        ),
        _pattern(situation, count),
        Term(
            "source fluctuation",
            situation.scale * estimate.u_fluctuation,
            "A",
            max(estimate.degrees_of_freedom, 1),
            note="difference between frames beyond their noise",
        ),
    ]


def _pattern(situation: PatchSituation, count: int) -> Term:
    """Return what responsivity differs by from pixel to pixel: as the patch shows it, as stated where it is small."""
    estimate = situation.estimate
    scatter, _ = local_scatter(estimate.pixel_rates, situation.good)
    seen = math.sqrt(max(0.0, scatter**2 - estimate.u_pixel**2))
    if count >= _FEWEST_PIXELS_FOR_SCATTER:
        note = "scatter between pixels beyond the noise model"
        return Term("pixel pattern", situation.scale * seen / math.sqrt(count), "A", max(count - 1, 1), note=note)
    known = situation.stated.prnu_u_rel * abs(estimate.rate)
    note = f"{count} pixels are too few to show it: {100 * situation.stated.prnu_u_rel:g} % each as stated, or more"
    u = situation.scale * max(seen, known) / math.sqrt(count)
    return Term("pixel pattern", u, note=note, flag=Flag.SMALL_PATCH)


def _response(situation: PatchSituation) -> Term:
    estimate = situation.estimate
    each = [
        abs(c) * curve_u_rel(situation.model, frame, x) * abs(x)
        for c, frame, x in zip(estimate.coefficients, situation.frames, estimate.expected, strict=True)
    ]
    note = "stated linearity" if situation.model.linear else "uncertainty of the response curve"
    if situation.shares_level:
        return Term("response curve", 0.0, correlated=True, note="signal as high as at calibration, so it drops out")
    return Term("response curve", situation.scale * float(sum(each)), correlated=True, note=note)


def _dark(situation: PatchSituation) -> list[Term]:
    c = situation.estimate.coefficients
    own = float(np.sqrt(np.sum((c * [d.u_independent for d in situation.dark]) ** 2)))
    common = float(abs(c @ [d.u_common for d in situation.dark]))
    source = ", ".join(sorted({d.source for d in situation.dark}))
    u = situation.scale * math.hypot(own, common)
    return [Term("dark and black level", u, note=source, flag=None if source in _MEASURED else Flag.DARK_ASSUMED)]


def scale_u_rel(situation: PatchSituation) -> float:
    """Return the scale's relative standard uncertainty without what reading and calibration share.

    The same clock times both exposures, and the same part of the response curve serves signals of one height.
    """
    assert situation.calibration is not None
    scale = situation.calibration.scale
    shared = [scale.budget.get("exposure time", 0.0)]
    if situation.shares_level:
        shared.append(scale.budget.get("response curve", 0.0))
    return math.sqrt(max(0.0, scale.u_rel**2 - sum(u**2 for u in shared)))


def _stated(situation: PatchSituation) -> list[Term]:
    value, stated, calibration = abs(situation.value), situation.stated, situation.calibration
    if calibration is None:
        return [Term("exposure time", value * stated.exposure_u_rel, note="stated")]
    scale = calibration.scale
    shared = "exposure time" in scale.budget
    return [
        Term(
            "exposure time",
            0.0 if shared else value * stated.exposure_u_rel,
            note="by the clock that timed the calibration, so it drops out" if shared else "stated",
        ),
        Term(
            "scale",
            value * scale_u_rel(situation),
            "B",
            scale.degrees_of_freedom or math.inf,
            correlated=True,
            note=f"{scale.method.replace('_', ' ')} {scale.reference}".strip(),
        ),
        _f_number(situation, value),
        _transmittance(situation, value),
        _magnification(situation, value),
        _spectrum(situation, value),
    ]


def _spectrum(situation: PatchSituation, value: float) -> Term:
    assert situation.calibration is not None
    known, name = situation.spectrum_stated, situation.calibration.spectrum
    u_rel = spectral_u_rel(situation.calibration, situation.stated, spectrum_stated=known)
    by = "as stated" if situation.stated.spectral_u_rel > 0.0 else f"spread of {', '.join(KINDS)}"
    note = name if known else f"the light's spectrum is unknown: treated as {name}, {by}"
    return Term("spectral assumption", value * u_rel, correlated=True, note=note, flag=Flag.SPECTRUM_ASSUMED)


def _outside(situation: PatchSituation) -> list[Term]:
    """Return the contributions of what differs between the reading and its calibration."""
    calibration = situation.calibration
    if calibration is None:
        return []
    return [
        *outside_terms(
            situation.value,
            situation.conditions,
            calibration,
            situation.lens,
            situation.falloff,
            linear=situation.model.linear,
            now=situation.now,
        ),
        stray_light(situation.value, situation.scale * situation.surround.rate, calibration),
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

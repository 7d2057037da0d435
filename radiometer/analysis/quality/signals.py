"""Readings of one source under changed conditions, and their ratios, in which all that they share drops out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.reading.budget import (
    OBSERVED,
    PatchSituation,
    Term,
    budget_terms,
    combined_u,
    coverage_factor,
    effective_degrees_of_freedom,
)
from radiometer.analysis.reading.reading import patch_situation
from radiometer.analysis.signal.lens import lens_factor_sr
from radiometer.data import Calibration, CaptureSet, Frame, Patch
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError


@dataclass(frozen=True, slots=True)
class StepSignal:
    """The instrument's reading in one step, in radiance or in its unit."""

    name: str  # of the step
    value: float  # reading Y, unflagged ones only
    terms: tuple[Term, ...]  # contributions that are this step's own, in the unit of Y
    dark: float  # change of Y for one standard deviation of the dark level that all steps share
    # Change of Y for one standard deviation of what all real exposure times differ by from the stated ones
    timing: float
    temperature_c: float | None  # mean temperature of the frames; None where a frame does not state it
    frames: int  # number of light frames used
    apart_u_rel: float = 0.0  # relative standard uncertainty by settings that differ from those of the first step


@dataclass(frozen=True, slots=True)
class Deviation:
    """A relative deviation with its uncertainty."""

    label: str  # what deviates
    value: float  # Y/Y_reference − 1, or another figure of that kind
    u: float  # its standard uncertainty
    degrees_of_freedom: float = math.inf  # effective ones

    @property
    def coverage_factor(self) -> float:
        """Return k for 95.45 %."""
        return coverage_factor(self.degrees_of_freedom)

    @property
    def expanded(self) -> float:
        """Return the expanded uncertainty."""
        return self.coverage_factor * self.u

    def scaled(self, factor: float) -> Deviation:
        """Return the deviation and its uncertainty times a factor above 0."""
        return Deviation(self.label, factor * self.value, factor * self.u, self.degrees_of_freedom)


def step_signal(
    name: str, capture: CaptureSet, patch: Patch, calibration: Calibration | None, frames: Sequence[Frame] | None = None
) -> StepSignal:
    """Return what the instrument reads in the patch of a capture.

    Args:
        calibration: The instrument's calibration, whose corrections are part of it; None reads relative values.
        frames: Some of the capture's frames; None for all.

    Raises:
        MeasurementError: If the patch clips in every frame or is outside of them.
        RadiometerError: If the calibration does not fit.
    """
    header = capture.header
    situation = patch_situation(
        capture.frames() if frames is None else frames,
        patch,
        Setup(header.camera, header.lens, calibration, header.source),
    )
    if not situation.shown.frames[0].unclipped:
        raise MeasurementError(f"{capture.path}: the patch clips in every frame; capture shorter exposures")
    unit = _unit(situation)
    terms = (term for term in budget_terms(situation) if term.name in OBSERVED)
    own = tuple(Term(term.name, unit * term.u, term.kind, term.degrees_of_freedom) for term in terms)
    dark = situation.shown.estimate.coefficients @ [level.u_common for level in situation.shown.dark]
    alone = situation.shown.estimate.coefficients * [level.u_independent for level in situation.shown.dark]
    own += (Term("dark frames", unit * situation.scale * float(np.sqrt(np.sum(alone**2)))),)
    temperatures = [one.settings.temperature_c for one in situation.shown.frames]
    known = [value for value in temperatures if value is not None]
    return StepSignal(
        name,
        unit * situation.value,
        own,
        unit * situation.scale * float(dark),
        unit * situation.value * situation.stated.exposure_u_s * situation.conditions.inverse_exposure_per_s,
        float(np.mean(known)) if known and len(known) == len(temperatures) else None,
        len(situation.shown.frames),
    )


def _unit(situation: PatchSituation) -> float:
    """Return what makes relative readings of several captures comparable: they count from their first frame's lens."""
    if situation.calibration is not None and situation.calibration.absolute:
        return 1.0
    first = situation.shown.frames[0].settings
    return 1.0 / lens_factor_sr(situation.lens, first.f_number or situation.lens.f_number)


def deviation(one: StepSignal, reference: StepSignal, source_u_rel: float, label: str = "") -> Deviation:
    """Return Y/Y_reference − 1 with what the two readings do not share.

    Args:
        label: Of the deviation; the reading's name by default.

    Raises:
        MeasurementError: If the reference is not above 0.
    """
    if reference.value <= 0.0:
        raise MeasurementError(f"step {reference.name!r} reads no light; it is the reference of the others")
    ratio = one.value / reference.value
    dark, timing = (
        (here - ratio * there) / reference.value
        for here, there in ((one.dark, reference.dark), (one.timing, reference.timing))
    )
    parts = [
        *(Term(t.name, t.u / reference.value, t.kind, t.degrees_of_freedom) for t in one.terms),
        *(Term(t.name, abs(ratio) * t.u / reference.value, t.kind, t.degrees_of_freedom) for t in reference.terms),
        Term("shared dark level", abs(dark)),
        Term("exposure offset", abs(timing)),
        Term("settings", abs(ratio) * math.hypot(one.apart_u_rel, reference.apart_u_rel)),
        Term("source", abs(ratio) * math.sqrt(2.0) * source_u_rel),
    ]
    return Deviation(label or one.name, ratio - 1.0, combined_u(parts), effective_degrees_of_freedom(parts))

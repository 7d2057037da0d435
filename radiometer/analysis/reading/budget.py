"""The uncertainty budget of a reading: its contributions, their combination after the GUM, and the flags.

A cause that calibration and reading share to the same degree drops out: a contribution from outside the model is a
sensitivity times the *difference* between the two. `StatedUncertainties` holds the figures and their sources.
"""

from __future__ import annotations

import datetime as dt
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import special

from radiometer.analysis.calibration.shared import Handling, channel_of, settle
from radiometer.analysis.photometry.photometry import KINDS, Observer
from radiometer.analysis.photometry.responses import unknown_mismatch_u_rel, unstated_light_u_rel
from radiometer.analysis.reading.estimate import PatchEstimate
from radiometer.analysis.signal.lens import doubtful_loss, known_f_number, lens_factor_sr
from radiometer.analysis.signal.model import DarkLevel, PatchFrame, SignalModel
from radiometer.analysis.signal.situation import Situation, situation_of
from radiometer.analysis.signal.taps import ReadOut
from radiometer.data import (
    Calibration,
    Contribution,
    Flag,
    FrameSettings,
    LensDescription,
    Quantity,
    Reading,
    ScaleConditions,
    StatedUncertainties,
)
from radiometer.data.iso_speeds import IsoSpeeds
from radiometer.data.mosaic import COLOURS
from radiometer.data.reading import CLIPPING
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError
from radiometer.moments import moment_of
from radiometer.units import gain_factor

# Contributions by repeated observation alone, of type A wherever they stand.
OBSERVED: Final = frozenset({"repeatability", "source fluctuation"})
_DEPENDS_ON_LEVEL: Final = frozenset({"response curve"})
_SAME_LEVEL_REL: Final = 0.1  # nearer signals share the error of the response curve, which is smooth
# Sensors in a room; used where calibration or reading do not state their temperature.
UNKNOWN_TEMPERATURE_K = 3.0
# Fall-off at the corner of a picture whose focal length or pixel size is unknown: cos⁴ at 27°, an ordinary lens.
UNKNOWN_FALLOFF = 0.36
_DAYS_PER_YEAR = 365.25  # Julian year
_HANDLING = {"reseated": "reseated_u_rel", "refocused": "refocused_u_rel", "iris_reset": "iris_reset_u_rel"}
_FEWEST_PIXELS_FOR_SCATTER = 16  # a scatter is then known to a sixth
# Origins of a dark level that is not assumed.
_MEASURED = ("dark frames", "masked pixels")
_NOISE_FLOOR_SIGMA = 2.0  # 95 %: below, a reading need not differ from darkness
_NONUNIFORM_REL = 0.05  # a patch on an even surface varies by less, its fall-off included


# A contribution dominates from this part of the variance on, where it is more than a trifle.
_DOMINATES = 0.5
_TRIFLE_REL = 0.01
# From this on an undeclared natural fall-off is reported.
_FALLOFF_REPORTED_REL = 0.002
# Frames that show whether the light flickers: these many; more where each is short against a period of mains light.
FEWEST_FRAMES = 3
FEWEST_SHORT_FRAMES = 5
SHORT_FRAME_S = 0.01
# A surround of which more than this clips everywhere may be of any brightness.
_SURROUND_CLIPS = 0.002


# A filter or lens of which only the nominal transmittance is known: sold to some ±10 %, taken as a rectangle.
FILTER_U_REL: Final = 0.1 / math.sqrt(3.0)


@dataclass(frozen=True, slots=True)
class Term:
    """One contribution in the unit of the value."""

    name: str  # what the uncertainty comes from
    u: float  # standard uncertainty of the value due to it, in the value's unit, 0 or more
    kind: str = "B"  # "A" (from repeated observation) or "B" (from anything else)
    degrees_of_freedom: float = math.inf  # of the estimate; infinite where taken as exactly known
    correlated: bool = False  # true where two readings made with one calibration share it
    note: str = ""  # where the figure comes from
    # Raised where the contribution dominates a reading; None for one that needs no separate word
    flag: Flag | None = None

    def contribution(self, value: float) -> Contribution:
        """Return the line of the budget relative to a value (relative to its own u where the value is zero)."""
        reference = abs(value) or self.u or 1.0
        return Contribution(
            self.name, self.u / reference, self.kind, self.degrees_of_freedom, self.correlated, self.note
        )


def combined_u(terms: Iterable[Term]) -> float:
    """Return the combined standard uncertainty of independent contributions.

    Source: JCGM 100:2008, equation (10).
    """
    return math.sqrt(sum(term.u**2 for term in terms))


def effective_degrees_of_freedom(terms: Iterable[Term]) -> float:
    """Return the effective degrees of freedom of the combined uncertainty; infinite where all are.

    Source: JCGM 100:2008, equation (G.2b), Welch and Satterthwaite.
    """
    listed = list(terms)
    spread = sum(term.u**4 / term.degrees_of_freedom for term in listed)
    return math.inf if spread == 0.0 else combined_u(listed) ** 4 / spread


def coverage_factor(degrees_of_freedom: float, probability: float = 0.9545) -> float:
    """Return the factor k that makes an interval hold the value with a probability (0.9545 is k = 2 for normal).

    Args:
        degrees_of_freedom: Effective degrees of freedom, above 0; may be infinite.
        probability: Coverage probability, above 0 and below 1.

    Source: JCGM 100:2008, annex G.
    """
    return float(special.stdtrit(min(degrees_of_freedom, 1e9), 0.5 + probability / 2.0))


def shares(contributions: Iterable[Contribution]) -> list[tuple[Contribution, float]]:
    """Return contributions with their share of the variance (they sum to 1), the largest first."""
    listed = sorted(contributions, key=lambda one: -one.u_rel)
    total = sum(one.u_rel**2 for one in listed)
    return [(one, one.u_rel**2 / total if total else 0.0) for one in listed]


def covariance(first: Reading, second: Reading) -> float:
    """Return the covariance of two readings made with one calibration, in the square of their unit.

    What the calibration brings in (scale, flat field, …) shifts both alike; all else is independent. The response
    curve's error is shared only by readings of nearly the same radiance: elsewhere other parts of the curve serve.

    Args:
        second: Another reading made with the same calibration.

    Source: JCGM 100:2008, section F.1.2.3.
    """
    of_second = {one.name: one.u_rel for one in second.budget if one.correlated}
    a, b = first.radiance.value, second.radiance.value
    level_differs = abs(a - b) > _SAME_LEVEL_REL * max(abs(a), abs(b))
    shared = sum(
        one.u_rel * of_second.get(one.name, 0.0)
        for one in first.budget
        if one.correlated and not (level_differs and one.name in _DEPENDS_ON_LEVEL)
    )
    return shared * abs(a) * abs(b)


def propagated_u(readings: Sequence[Reading], gradient: Sequence[float] | NDArray[np.float64]) -> float:
    """Return the standard uncertainty of a function of readings made with one calibration.

    Args:
        gradient: Derivative of the function by each radiance, shape (readings,).

    Source: JCGM 100:2008, equation (13).
    """
    variance = sum((slope * one.radiance.u) ** 2 for slope, one in zip(gradient, readings, strict=True))
    for i, one in enumerate(readings):
        for j in range(i):
            variance += 2.0 * gradient[i] * gradient[j] * covariance(one, readings[j])
    return math.sqrt(max(float(variance), 0.0))


def ratio(first: Reading, second: Reading) -> Quantity:
    """Return first/second: what the calibration shares drops out of its uncertainty.

    Raises:
        MeasurementError: If the second reading is 0.
    """
    a, b = first.radiance.value, second.radiance.value
    if b == 0.0:
        raise MeasurementError("a ratio to a reading of 0 has no value")
    return Quantity(a / b, propagated_u((first, second), (1.0 / b, -a / b**2)), "1")


def difference(first: Reading, second: Reading) -> Quantity:
    """Return first − second, the shared part of the calibration taken into account."""
    value = first.radiance.value - second.radiance.value
    return Quantity(value, propagated_u((first, second), (1.0, -1.0)), first.radiance.unit)


def mean(readings: Sequence[Reading]) -> Quantity:
    """Return the mean of readings made with one calibration: what they share does not average out.

    Raises:
        MeasurementError: If there is none.
    """
    if not readings:
        raise MeasurementError("the mean of no readings has no value")
    values = [one.radiance.value for one in readings]
    variance = sum(one.radiance.u**2 for one in readings)
    variance += 2.0 * sum(covariance(a, b) for i, a in enumerate(readings) for b in readings[:i])
    return Quantity(sum(values) / len(values), math.sqrt(max(variance, 0.0)) / len(values), readings[0].radiance.unit)


@dataclass(frozen=True, slots=True)
class Surround:
    """The light of the whole picture."""

    rate: float  # its mean in the unit of the estimate
    clipped: float  # part of the picture that clips even in the frame that shows it best; the mean is too low then


@dataclass(frozen=True, slots=True)
class Falloff:
    """What is known of the sensitivity over the picture: "flat_field", "cos4" (declared), "assumed" or "unknown"."""

    known: str
    u_of_flat: float = 0.0
    as_calibrated: bool = True  # whether iris and focus are those of the calibration's scale


def conditions_of(
    shares: np.ndarray,
    settings: Sequence[FrameSettings],
    level: float,
    sensitivity: float,
    field: float,
    surround: float,
    polarised: bool | None,
) -> ScaleConditions:
    """Return the conditions of a reading in the form that a scale keeps.

    Args:
        shares: Part of every frame in the value, shape (frames,); they sum to 1.
        level: Signal as a part of full scale.
        sensitivity: At the patch, relative to the axis.
        field: Distance of the patch from the axis over that of a corner.
        surround: Mean of the picture over the patch.
        polarised: Whether the source is polarised.
    """
    weight = np.abs(shares) / max(float(np.abs(shares).sum()), 1e-300)
    known = [one.temperature_c for one in settings if one.temperature_c is not None]
    return ScaleConditions(
        inverse_exposure_per_s=float(weight @ [1.0 / one.exposure_s for one in settings]),
        gain_db=float(weight @ [one.gain_db for one in settings]),
        temperature_c=float(np.mean(known)) if len(known) == len(settings) else None,
        level=max(level, 0.0),
        sensitivity=sensitivity,
        field=field,
        surround=max(surround, 0.0),
        polarised=polarised,
    )


def outside_terms(
    value: float,
    here: ScaleConditions,
    calibration: Calibration,
    lens: LensDescription,
    falloff: Falloff,
    *,
    linear: bool,
    now: dt.datetime,
) -> list[Term]:
    """Return the contributions of what differs between a reading and its calibration, stray light excepted.

    Args:
        falloff: What is known of the sensitivity over the picture.
        linear: Whether the sensor is taken as linear.
        now: Time of the reading, with time zone.
    """
    stated, there, size = calibration.uncertainties, calibration.scale.conditions, abs(value)
    terms = [
        _exposure_offset(size, here, there, stated),
        _gain(size, here, there, stated),
        _temperature(size, here, there, stated),
        _drift(size, calibration, now),
        *_handling(size, lens, stated),
        _falloff(size, here, there, falloff, stated),
        _polarisation(size, here, there, stated),
    ]
    if linear:
        bend = stated.bend_u_rel * abs(here.level - there.level)
        note = f"{100 * here.level:.3g} % of full scale, {100 * there.level:.3g} % at calibration"
        terms.append(Term("linearity", size * bend, correlated=True, note=note, flag=Flag.LINEARITY))
    return terms


def frame_conditions(settings: Sequence[FrameSettings], polarised: bool | None = None) -> ScaleConditions:
    """Return the conditions of frames that count alike, as far as no place in the picture matters."""
    even = np.full(len(settings), 1.0 / max(len(settings), 1))
    return conditions_of(even, settings, 0.5, 1.0, 0.0, 1.0, polarised)


def frame_u_rel(
    setup: Setup, lens: LensDescription, numbers: set[float | None], settings: Sequence[FrameSettings]
) -> float:
    """Return the relative standard uncertainty that all pixels share through lens, gain, temperature, age and light.

    Args:
        setup: With what the frames were taken; without a calibration it is 0.
    """
    if (calibration := setup.calibration) is None:
        return 0.0
    here = frame_conditions(settings, setup.polarised)
    stated, there = calibration.uncertainties, calibration.scale.conditions
    terms = [
        _gain(1.0, here, there, stated),
        _temperature(1.0, here, there, stated),
        _drift(1.0, calibration, setup.taken or dt.datetime.now(dt.UTC)),
        *_handling(1.0, lens, stated),
        _polarisation(1.0, here, there, stated),
    ]
    parts = [
        f_number_u_rel(calibration, stated, numbers)[0],
        transmittance_u_rel(calibration, lens)[0],
        magnification_u_rel(calibration, lens)[0],
    ]
    return math.hypot(*(term.u for term in terms), *parts)


def carried(setup: Setup, settings: Sequence[FrameSettings]) -> tuple[float, float]:
    """Return the factor from relative values of frames to those as at calibration, and its standard uncertainty.

    It holds what differs of lens, f-number, focus and ISO speed. u is relative, and holds gain, temperature and age.

    Args:
        settings: Of the light frames, the first that of the merge.

    Raises:
        CalibrationError: If the calibration is of another camera or lens, or what counts is not stated.
    """
    calibration, lens = setup.calibration, situation_of(setup).lens
    assert calibration is not None
    numbers = [known_f_number(calibration, one, lens) for one in settings]
    scale = calibration.scale
    factor = lens_factor_sr(calibration.lens, scale.f_number) / lens_factor_sr(lens, numbers[0])
    iso = min((one.iso for one in settings if one.iso is not None), default=None)
    if settle("ISO speed", scale.iso, iso) is Handling.CORRECTED:
        speeds = IsoSpeeds(reference=scale.iso, reference_stated=scale.iso_stated)
        gains_db = [one.gain_db if one.iso is None else speeds.gain_db(one.iso, ()) for one in settings]
        factor /= gain_factor(min(gains_db))
        settings = [replace(one, gain_db=gain_db) for one, gain_db in zip(settings, gains_db, strict=True)]
    return factor, frame_u_rel(setup, lens, set(numbers), settings)


def stray_light(value: float, surround: float, calibration: Calibration) -> Term:
    """Return the contribution of light that the lens spreads from the surround, and from the patch itself.

    Args:
        surround: Mean radiance of the picture.
        calibration: The calibration, whose source had a surround too.

    Source: ISO 9358:1994, veiling glare index, here as a part of the mean of the picture.
    """
    there, g = calibration.scale.conditions.surround, calibration.uncertainties.glare_u
    ratio = surround / value if value > 0.0 else math.inf
    note = f"the picture's mean is {ratio:.3g} times the patch, {there:.3g} times at calibration"
    u = g * abs(surround - there * value)
    return Term("stray light", u, correlated=True, note=note, flag=Flag.STRAY_LIGHT)


def _exposure_offset(size: float, here: ScaleConditions, there: ScaleConditions, stated: StatedUncertainties) -> Term:
    difference = abs(here.inverse_exposure_per_s - there.inverse_exposure_per_s)
    note = f"± {1e6 * stated.exposure_u_s:.2g} µs (k = 1), shared with the calibration's exposures"
    u = size * stated.exposure_u_s * difference
    return Term("exposure offset", u, correlated=True, note=note, flag=Flag.SHORT_EXPOSURE)


def _gain(size: float, here: ScaleConditions, there: ScaleConditions, stated: StatedUncertainties) -> Term:
    near = abs(here.gain_db - there.gain_db) <= 1e-6  # of rounding alone
    differs = settle("gain", there.gain_db, here.gain_db, equal=near) is not Handling.KEPT
    note = f"{here.gain_db:g} dB, {there.gain_db:g} dB at calibration"
    u = size * stated.gain_step_u_rel * differs
    return Term("gain step", u, correlated=True, note=note if differs else "gain as at calibration", flag=Flag.GAIN)


def _temperature(size: float, here: ScaleConditions, there: ScaleConditions, stated: StatedUncertainties) -> Term:
    if here.temperature_c is None or there.temperature_c is None:
        kelvin, note = UNKNOWN_TEMPERATURE_K, "temperature not known here or at calibration"
    else:
        kelvin = abs(here.temperature_c - there.temperature_c)
        note = f"{kelvin:.3g} K from the calibration's temperature"
    u = size * stated.temperature_u_rel_per_k * kelvin
    return Term("temperature", u, correlated=True, note=note, flag=Flag.TEMPERATURE)


def _drift(size: float, calibration: Calibration, now: dt.datetime) -> Term:
    # It drifts before its date, too. Within a day it does not: no result depends on the moment of its evaluation.
    age = abs((now - moment_of(calibration.created)).total_seconds()) / 86400.0
    age = age if age >= 1.0 else 0.0
    u = size * calibration.uncertainties.drift_u_rel_per_year * age / _DAYS_PER_YEAR
    return Term("drift", u, correlated=True, note=f"{age:.3g} days from the calibration", flag=Flag.DRIFT)


def _handling(size: float, lens: LensDescription, stated: StatedUncertainties) -> list[Term]:
    done = dict.fromkeys(lens.since_calibration)
    return [
        Term(
            f"lens {name.replace('_', ' ')}",
            size * getattr(stated, _HANDLING[name]),
            correlated=True,
            note="as stated",
            flag=Flag.LENS_CHANGED,
        )
        for name in done
    ]


def _falloff(
    size: float, here: ScaleConditions, there: ScaleConditions, falloff: Falloff, stated: StatedUncertainties
) -> Term:
    if falloff.known == "flat_field":
        return Term("flat field", size * falloff.u_of_flat, correlated=True, note="of the correction")
    losses = 1.0 / here.sensitivity - 1.0, 1.0 / there.sensitivity - 1.0
    if falloff.known == "cos4":
        lost = float(doubtful_loss(*losses, same=True))
        return Term("fall-off", size * stated.cos4_u_rel * lost, correlated=True, note="cos⁴ as declared for the lens")
    note = "no flat field: natural fall-off cos⁴ assumed"
    if falloff.known != "assumed":
        losses = UNKNOWN_FALLOFF * here.field**2, UNKNOWN_FALLOFF * there.field**2
        note = "no flat field, and focal length or pixel size unknown: fall-off not corrected"
    lost = float(doubtful_loss(*losses, same=falloff.as_calibrated))
    note += "" if falloff.as_calibrated else "; another iris or focus than at calibration"
    return Term("fall-off", size * stated.falloff_u_rel * lost, correlated=True, note=note, flag=Flag.FALLOFF_ASSUMED)


def _polarisation(size: float, here: ScaleConditions, there: ScaleConditions, stated: StatedUncertainties) -> Term:
    differs = bool(here.polarised) != bool(there.polarised)
    note = "polarised here or at calibration, not both" if differs else "as at calibration"
    u = size * stated.polarisation_u_rel * differs
    return Term("polarisation", u, correlated=True, note=note, flag=Flag.POLARISATION)


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What the frames show of a patch."""

    estimate: PatchEstimate  # estimate over the used frames
    frames: tuple[PatchFrame, ...]  # used frames
    dark: tuple[DarkLevel, ...]  # dark level of each
    good: NDArray[np.bool_]  # pixels used
    light_frames: int  # number of light frames seen
    unsteady: bool  # whether a frame clips that was exposed no longer than one that does not: the light changes
    notes: tuple[str, ...] = ()  # what to say of copies among the frames


@dataclass(frozen=True, slots=True, eq=False)
class PatchSituation:
    """Everything a budget is made up from."""

    settled: Situation  # the setup, and what a measurement with it rests on
    shown: Shown  # what the frames show of the patch: estimate, usable frames, their dark levels
    scale: float  # radiance per unit of the estimate
    conditions: ScaleConditions  # what the reading was made under, in the form that a scale keeps
    surround: Surround  # light of the whole picture
    falloff: Falloff  # what is known of the sensitivity over the picture
    now: dt.datetime  # time of the reading, with time zone
    stray: float = 0.0  # radiance that is taken off for known veiling glare
    taps: ReadOut | None = None  # the camera's taps; None where it has one

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
    def value(self) -> float:
        """Return the radiance, or the relative value."""
        return self.scale * self.shown.estimate.rate - self.stray

    @property
    def notes_on_taps(self) -> tuple[str, ...]:
        """Return what was used of the taps, and what was not."""
        by_darks = all(one.source != "black level" for one in self.shown.dark)
        return () if self.taps is None else self.taps.notes(has_darks=by_darks)

    @property
    def shares_level(self) -> bool:
        """Return whether the signal is as high as at calibration, so that the response's error drops out."""
        if self.calibration is None or "conditions" not in self.calibration.scale.model_fields_set:
            return False
        return abs(self.conditions.level - self.calibration.scale.conditions.level) <= _SAME_LEVEL_REL


def budget_terms(situation: PatchSituation) -> list[Term]:
    """Return all contributions to a reading's uncertainty, in its unit."""
    return [
        *_observed(situation),
        _response(situation),
        *_dark(situation),
        *_stated(situation),
        *_outside(situation),
        *_taps(situation),
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
    estimate, count = situation.shown.estimate, int(situation.shown.good.sum())
    frames = len(situation.shown.frames)
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
    estimate = situation.shown.estimate
    scatter, _ = local_scatter(estimate.pixel_rates, situation.shown.good)
    seen = math.sqrt(max(0.0, scatter**2 - estimate.u_pixel**2))
    if count >= _FEWEST_PIXELS_FOR_SCATTER:
        note = "scatter between pixels beyond the noise model"
        return Term("pixel pattern", situation.scale * seen / math.sqrt(count), "A", max(count - 1, 1), note=note)
    known = situation.stated.prnu_u_rel * abs(estimate.rate)
    note = f"{count} pixels are too few to show it: {100 * situation.stated.prnu_u_rel:g} % each as stated, or more"
    u = situation.scale * max(seen, known) / math.sqrt(count)
    return Term("pixel pattern", u, note=note, flag=Flag.SMALL_PATCH)


def _response(situation: PatchSituation) -> Term:
    estimate = situation.shown.estimate
    each = [
        abs(c) * situation.model.curve_u_rel(x, frame.settings) * abs(x)
        for c, frame, x in zip(estimate.coefficients, situation.shown.frames, estimate.expected, strict=True)
    ]
    note = "stated linearity" if situation.model.linear else "uncertainty of the response curve"
    if situation.shares_level:
        return Term("response curve", 0.0, correlated=True, note="signal as high as at calibration, so it drops out")
    return Term("response curve", situation.scale * float(sum(each)), correlated=True, note=note)


def own_dark_u(estimate: PatchEstimate, level: DarkLevel, expected: float) -> float:
    """Return the standard uncertainty of a frame's dark level that frames of its exposure share, in its signal's unit.

    One dark frame scatters as the light frames do.

    Args:
        estimate: That of the patch.
        level: Dark level of the frame.
        expected: Its expected signal.
    """
    return math.hypot(level.u_independent, estimate.fluctuation_rel * expected if level.is_single else 0.0)


def _dark(situation: PatchSituation) -> list[Term]:
    estimate, of_exposures = situation.shown.estimate, defaultdict[tuple[float, float], float](float)
    c = estimate.coefficients
    shown = zip(c, situation.shown.frames, situation.shown.dark, estimate.expected, strict=True)
    for factor, frame, level, expected in shown:
        key = frame.settings.exposure_s, frame.settings.gain_db
        of_exposures[key] += float(factor) * own_dark_u(estimate, level, float(expected))
    own = math.hypot(*of_exposures.values())
    common = float(abs(c @ [d.u_common for d in situation.shown.dark]))
    source = ", ".join(sorted({d.source for d in situation.shown.dark}))
    u = situation.scale * math.hypot(own, common)
    return [Term("dark and black level", u, note=source, flag=None if source in _MEASURED else Flag.DARK_ASSUMED)]


def _unstated_dark_u(situation: PatchSituation) -> float:
    """Return the part of the dark level's u that a dark current makes which nothing states, in the reading's unit."""
    shown = situation.shown
    return situation.scale * abs(float(shown.estimate.coefficients @ [d.u_unstated for d in shown.dark]))


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
    known, name = situation.settled.setup.spectrum_stated, situation.calibration.spectrum
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


def _taps(situation: PatchSituation) -> list[Term]:
    """Return the contribution of the gain of the patch's tap against that of the tap at calibration."""
    taps, calibration, here = situation.taps, situation.calibration, situation.conditions.tap
    if taps is None or calibration is None or len(taps.taps) == 1:
        return []
    there = calibration.scale.conditions.tap
    every = taps.u_rel(there)
    u_rel = next((float(u) for tap, u in zip(taps.taps, every[1:], strict=True) if tap.name == here), every.max())
    note = f"read by tap {here or 'several'}, calibrated with tap {there or 'unknown'}"
    if taps.gain is None and u_rel > 0.0:
        note += ": their gains are not known, ±10 % is assumed"
    flag = Flag.OTHER_TAP if taps.gain is None else None
    return [Term("gain of taps", abs(situation.value) * u_rel, correlated=True, note=note, flag=flag)]


def _f_number(situation: PatchSituation, value: float) -> Term:
    numbers = {frame.settings.f_number or situation.lens.f_number for frame in situation.shown.frames}
    u_rel, note = f_number_u_rel(situation.calibration, situation.stated, numbers)
    return Term("f-number", value * u_rel, correlated=True, note=note)


def _transmittance(situation: PatchSituation, value: float) -> Term:
    u_rel, note = transmittance_u_rel(situation.calibration, situation.lens)
    return Term("lens transmittance", value * u_rel, correlated=True, note=note)


def _magnification(situation: PatchSituation, value: float) -> Term:
    u_rel, note = magnification_u_rel(situation.calibration, situation.lens)
    return Term("focus", value * u_rel, correlated=True, note=note)


def _clipped(situation: PatchSituation) -> list[Term]:
    if situation.shown.frames[0].unclipped:
        return []
    return [Term(CLIPPING, abs(situation.value), note="clips in the shortest exposure: the value is a lower bound")]


def reading_flags(situation: PatchSituation, terms: Sequence[Term]) -> tuple[Flag, ...]:
    """Return the flags of a reading, sorted by name."""
    calibration, estimate, now = situation.calibration, situation.shown.estimate, situation.now
    # A dark current that nothing states is no noise: it may be all of the signal, or nothing of it.
    floor, unstated = _floor(terms), _unstated_dark_u(situation)
    clips = not situation.shown.frames[0].unclipped  # then its light has no upper limit, however dark it seems
    is_dark = situation.value < _NOISE_FLOOR_SIGMA * math.sqrt(max(0.0, floor**2 - unstated**2))
    found = {
        Flag.SATURATED: clips,
        Flag.BELOW_NOISE: is_dark and not clips,
        Flag.DARK_ASSUMED: unstated > 0.0 and situation.value < _NOISE_FLOOR_SIGMA * floor,
        Flag.EXTRAPOLATED: _extrapolates(situation),
        Flag.NONUNIFORM: _is_nonuniform(situation),
        Flag.FLICKER: estimate.flickers or situation.shown.unsteady,
        Flag.UNCALIBRATED: calibration is None or not calibration.absolute,
        Flag.STALE_CALIBRATION: calibration is not None and calibration.is_stale(now),
    }
    if calibration is not None:
        found[Flag.FEW_FRAMES] = _too_few_frames(situation)
        found[Flag.STRAY_LIGHT] = situation.surround.clipped > _SURROUND_CLIPS
        # The calibration holds for one gain of the camera's own, and the frames do not state theirs.
        found[Flag.GAIN] = calibration.camera.mode is not None and situation.settled.setup.camera.mode is None
    raised = {flag for flag, here in found.items() if here} | _dominant(situation.value, terms)
    if situation.value < _NOISE_FLOOR_SIGMA * _floor(terms, "repeatability"):
        raised.discard(Flag.DARK_ASSUMED)  # dark frames would not help: it is below the noise as well
    return tuple(sorted(raised))


def _floor(terms: Sequence[Term], *named: str) -> float:
    """Return the standard uncertainty that is left without light: noise and dark level, in the reading's unit."""
    named = named or ("repeatability", "dark and black level")
    return combined_u(term for term in terms if term.name in named)


def _dominant(value: float, terms: Sequence[Term]) -> set[Flag]:
    """Return the flags of contributions that make up most of the variance, and of a fall-off that was assumed."""
    whole, size = combined_u(terms), abs(value)
    found = {
        term.flag
        for term in terms
        if term.flag is not None and term.u > _TRIFLE_REL * size and term.u**2 >= _DOMINATES * whole**2
    }
    assumed = (term for term in terms if term.flag is Flag.FALLOFF_ASSUMED and term.u > _FALLOFF_REPORTED_REL * size)
    return found | {Flag.FALLOFF_ASSUMED for _ in assumed}


def _too_few_frames(situation: PatchSituation) -> bool:
    """Return whether the frames are too few to show that the light is steady."""
    longest = max(frame.settings.exposure_s for frame in situation.shown.frames)
    return len(situation.shown.frames) < (FEWEST_FRAMES if longest >= SHORT_FRAME_S else FEWEST_SHORT_FRAMES)


def _extrapolates(situation: PatchSituation) -> bool:
    """Return whether the frames that carry most of the estimate are outside the response curve's data."""
    if situation.model.linear:
        return False
    low, high = situation.model.valid_dn
    share = situation.shown.estimate.coefficients * situation.shown.estimate.expected
    means = np.array([float(np.mean(frame.dn[situation.shown.good])) for frame in situation.shown.frames])
    outside = (means < low) | (means > high)
    return bool(np.abs(share[outside]).sum() > 0.5 * np.abs(share).sum())


def _is_nonuniform(situation: PatchSituation) -> bool:
    """Return whether radiance changes over the patch by more than noise and 5 %."""
    pixels, good = situation.shown.estimate.pixel_rates, situation.shown.good
    scatter, pairs = local_scatter(pixels, good)
    if pairs < 8:
        return False
    noise = max(scatter, situation.shown.estimate.u_pixel) ** 2
    slow = float(np.var(pixels[good])) - noise * (1.0 + 6.0 * np.sqrt(3.0 / good.sum()))
    structure = max(slow, scatter**2 - situation.shown.estimate.u_pixel**2 * (1.0 + 6.0 * np.sqrt(3.0 / good.sum())))
    return bool(structure > (_NONUNIFORM_REL * situation.shown.estimate.rate) ** 2)


def spectral_u_rel(calibration: Calibration, stated: StatedUncertainties, *, spectrum_stated: bool = True) -> float:
    """Return the relative standard uncertainty of the spectral assumption, that of a correction included.

    A radiance that came by way of a luminance carries that of the assumed spectrum's luminous efficacy as well. Where
    calibration and source differ in spectrum and the camera's response is unknown, the spread of plausible responses
    counts. It also bounds the uncertainty from a known response, because nearly alike spectra depend little on it.

    Args:
        stated: What is stated of the spectrum, and of its efficacy.
        spectrum_stated: Whether the spectrum of the light is stated. Where it is not, and no figure is stated, all
            kinds of light count.
    """
    of_scale = calibration.scale.spectrum or calibration.spectrum
    efficacy = stated.efficacy_u_rel if calibration.scale.quantity == "luminance" else 0.0
    of_light = stated.spectral_u_rel if spectrum_stated else unstated_u_rel(calibration, stated)
    if of_scale == calibration.spectrum or not calibration.absolute:
        return math.hypot(of_light, efficacy)
    unknown = unknown_mismatch_u_rel(calibration.spectrum, of_scale, _colours(calibration))
    response = calibration.spectral_response
    own = min(response.u_rel, unknown) if response else unknown
    return math.hypot(of_light, efficacy, own)


def unstated_u_rel(calibration: Calibration, stated: StatedUncertainties, observer: Observer | None = None) -> float:
    """Return the relative standard uncertainty of light of unknown spectrum: as stated, or of all kinds of light.

    Args:
        stated: A figure of `spectral_u_rel` above 0 replaces it.
        observer: For a luminance, the observer; None for a radiance.
    """
    if stated.spectral_u_rel > 0.0 or not calibration.absolute:
        return stated.spectral_u_rel
    known = calibration.spectral_response
    return unstated_light_u_rel(calibration.spectrum, known, observer, _colours(calibration))


def _colours(calibration: Calibration) -> tuple[str, ...]:
    """Return the colours that its pixels may be of: its own; of a mosaic any; none of a sensor without filters."""
    own = channel_of(calibration)
    return (own,) if own is not None else COLOURS if calibration.camera.mosaic is not None else ()


def f_number_u_rel(
    calibration: Calibration | None, stated: StatedUncertainties, numbers: set[float | None]
) -> tuple[float, str]:
    """Return the relative standard uncertainty that the f-number brings, and why."""
    reference = calibration.scale.f_number if calibration else None
    if reference is None or all(n is not None and settle("f-number", reference, n) is Handling.KEPT for n in numbers):
        return 0.0, "same as at calibration, so it drops out"
    return 2.0 * stated.f_number_u_rel, "differs from the one at calibration"


def transmittance_u_rel(calibration: Calibration | None, lens: LensDescription) -> tuple[float, str]:
    """Return the relative standard uncertainty that the lens's transmittance brings, and why."""
    if calibration is None:
        return 0.0, "no scale"
    if calibration.scale.method == "datasheet":
        return lens.transmittance_u_rel or 0.0, "datasheet"
    if lens.transmittance == calibration.lens.transmittance:
        return 0.0, "calibrated through the lens, so it drops out"
    parts = [_transmittance_u_rel(one) for one in (calibration.lens, lens)]
    note = f"{lens.transmittance:g} in use, {calibration.lens.transmittance:g} at calibration"
    return math.hypot(*parts), note


def _transmittance_u_rel(lens: LensDescription) -> float:
    stated = lens.transmittance_u_rel
    return FILTER_U_REL if stated is None else stated


def magnification_u_rel(calibration: Calibration | None, lens: LensDescription) -> tuple[float, str]:
    """Return the relative standard uncertainty that another focus than at calibration brings, and why."""
    if calibration is None:
        return 0.0, "no scale"
    here, there = (one.magnification / one.pupil_magnification for one in (lens, calibration.lens))
    if here == there:
        return 0.0, "focused as at calibration, so it drops out"
    u = calibration.uncertainties.magnification_u_rel * abs(here - there)
    return 2.0 * u / (1.0 + here), f"magnification {here:.3g} in use, {there:.3g} at calibration"


def common_u_rel(situation: Situation) -> float:
    """Return the relative standard uncertainty that all pixels of a radiance map share, whatever its frames."""
    stated, calibration = situation.stated, situation.calibration
    linearity = stated.linearity_u_rel if situation.model.linear else 0.0
    parts = [stated.exposure_u_rel, linearity]
    if calibration is not None:
        flat = calibration.flat_field.u_rel if calibration.flat_field else 0.0
        parts += [calibration.scale.u_rel, spectral_u_rel(calibration, stated), flat]
    return math.hypot(*parts)

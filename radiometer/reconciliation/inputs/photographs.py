"""Reconciles a stack of photographs through an unknown tone curve with its printed exposures.

The response is unknown. Only what breaks the agreement of all photographs with one curve can be found. Examples are
stops that were rounded when printed, a shutter that exposes longer by one time, and single labels that are not the
real exposure.

The criterion is the prediction of digital numbers. A quadrant of the picture is left out, and curve and exposures come
from the rest. Each photograph's values in the quadrant are then predicted from the other photographs. A cause that does
not predict them better is not named.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.labels import (
    exposure_label,
    frame_name,
    refuse_equal_throughout,
    refuse_falling_brightness,
)
from radiometer.analysis.response.left_out import dial_step_dn, follow_no_curve, prediction_error_dn
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import ResponseSamples, gather_samples
from radiometer.analysis.response.settle import FittedResponse, error_of_quadrants, settle
from radiometer.analysis.response.shutter_offset import Exposures, ShutterOffset, find_exposures
from radiometer.analysis.response.wrong_labels import (
    LEAST_GAIN,
    WrongLabel,
    freed_one_by_one,
    most_wrong_labels,
    smallest_label_error,
    thinned,
)
from radiometer.data import Bracket, Frame
from radiometer.data.storage import write_text_atomic, write_yaml_atomic
from radiometer.errors import CaptureError, InputError, MeasurementError
from radiometer.importing.exif import read_exif_header
from radiometer.one_thread import on_one_blas_thread
from radiometer.reconciliation.inputs.photograph_report import OFFSET, FrameFinding, report_html
from radiometer.reconciliation.result import FittedParameter, FoundEffect, Limit, ReconcileResult, Verdict
from radiometer.reporting.origin import Origin
from radiometer.typing import Array
from radiometer.units import exact_exposure_s

_GAP_UNIT: Final = "mean error in DN of predicting left-out quadrants over that of the final exposures"
_LABEL: Final = "exposure_label_error"
# So many of its u beyond what counts as wrong at all a label is named: in 83 of 84 trials with three real cameras.
_SURE: Final = 5.0
_ENOUGH_PIXELS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class PhotographsReconciled:
    """The result for a stack of photographs, with the exposures found."""

    result: ReconcileResult  # the verdict and what was found
    exposures_s: dict[str, float]  # exposure of each photograph in s, as it agrees with the others
    # Relative standard uncertainty of those that were not taken from their label; 0 for the others. That of the
    # shutter's offset is one error, which all share.
    u_rel: dict[str, float]
    findings: tuple[FrameFinding, ...]  # what the others say of each photograph
    sentence: str  # how well left-out parts are predicted, in a sentence
    origin: str  # where they came from

    def write_model(self, path: Path, *, provisional: bool = False) -> str:
        """Write the exposures that agree with each other, in the form that photograph folders take."""
        lines = [f"{name} {seconds!r}" for name, seconds in self.exposures_s.items()]
        if path.suffix.lower() in (".yaml", ".yml"):
            write_yaml_atomic(path, {"format": "radiometer-exposures/1", "exposures_s": self.exposures_s})
        else:
            write_text_atomic(path, "\n".join(lines) + "\n")
        return str(path)

    def write_report(self, path: Path) -> str:
        """Write the outcome, the plot of each photograph against the others, and the exposures as HTML."""
        title = Path(self.origin).name or "photographs"
        write_text_atomic(path, report_html(self.result, self.findings, self.sentence, title, self._origin()))
        return str(path)

    def _origin(self) -> Origin:
        """Return what EXIF of the first photograph states of date and camera."""
        stated = read_exif_header(Path(self.origin) / next(iter(self.exposures_s)))
        found = {name: str(stated[name].written) for name in ("DateTimeOriginal", "Make", "Model") if name in stated}
        camera = " ".join(found[name] for name in ("Make", "Model") if name in found)
        frames = str(len(self.exposures_s))
        date = found.get("DateTimeOriginal", "")
        return Origin(date, camera, further=(("photographs", frames), ("folder", self.origin)))

    def write_plan(self, path: Path) -> bool:
        """Write nothing: photographs are taken by hand; the result names the exposure to take again."""
        return False


@on_one_blas_thread
def reconcile_photographs(
    frames: Sequence[Frame], other_colours: Sequence[Sequence[Frame]] = (), origin: str = ""
) -> PhotographsReconciled:
    """Return whether printed exposures agree with the photographs, and which do not.

    Args:
        frames: Photographs of one scene, at least three with different exposures.
        other_colours: The same photographs in other colours, each with a separate tone curve. Their labels are the
            same, and all colours together show a wrong one.
        origin: Their folder.

    Raises:
        CaptureError: If there are too few, they hardly overlap, or all are equally bright.
    """
    begun = time.monotonic()
    light = [frame for frame in frames if not frame.settings.is_dark]
    if len({f.settings.exposure_s for f in light}) < 3:
        raise CaptureError("a stack of photographs needs at least three different exposures to be reconciled")
    bracket = Bracket.from_frames(light, origin).thinned(_ENOUGH_PIXELS)
    refuse_equal_throughout(bracket)
    try:
        samples = gather_samples(bracket)
        if not samples.quadrants:
            raise CaptureError(
                f"{bracket.origin or 'the photographs'}: nearly all structure is in one quadrant of the "
                "picture, so that none can be left out to judge by; take photographs that show something everywhere"
            )
        start = curve_debevec1997(samples).log_exposure
        others = [plane for one in other_colours for plane in _plane(one)]
        judged = _judge(Plane(samples, start), others, _exact_log_times(bracket))
    except (MeasurementError, InputError) as error:
        refuse_falling_brightness(bracket)
        raise CaptureError(
            f"the photographs hardly overlap: no part of the scene is well exposed in two of them ({error})"
        ) from error
    names = [frame_name(bracket, index) for index in range(len(bracket.light))]
    result = _result(judged, bracket, names)
    seconds = [f.settings.exposure_s for f in bracket.light]
    shift = judged.log_time - samples.frame_log_time
    u_rel = dict(zip(names, judged.u_rel, strict=True))
    return PhotographsReconciled(
        replace(result, seconds=time.monotonic() - begun),
        {name: float(s * math.exp(d)) for name, s, d in zip(names, seconds, shift, strict=True)},
        u_rel,
        _findings(judged, bracket, names),
        _error_sentence(judged, bracket, names),
        bracket.origin,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    """Outcome for a stack: rounded stops or not, wrong labels, and the errors before and after each."""

    samples: ResponseSamples
    fitted: FittedResponse
    log_time: Array
    rounded: bool
    exposures: Exposures
    errors: tuple[float, float, float]  # as printed, with the exact stops, with the labels found
    by_others: Sequence[
        tuple[float, float]
    ] = ()  # of each frame ln of real over stated exposure by the others, and its u
    can_tell: bool = True  # whether enough photographs show something to tell a wrong label

    @property
    def labels(self) -> tuple[WrongLabel, ...]:
        """Return the labels that are wrong, their ratios to the exact stop and the shutter's offset."""
        return self.exposures.wrong

    @property
    def offset(self) -> ShutterOffset | None:
        """Return the time by which the shutter exposes longer; None where none was taken."""
        return self.exposures.offset

    @property
    def u_rel(self) -> list[float]:
        """Return the relative standard uncertainty of every exposure that was not taken from its label; 0 else."""
        u = np.zeros(self.log_time.size)
        if self.offset is not None:
            u = self.offset.u_seconds / self.samples.exposures_s
        for one in self.labels:
            u[one.frame] = one.u_ratio / one.ratio
        return [float(value) for value in u]

    @property
    def expected(self) -> Array:
        """Return what label and shutter's offset make together over the label, shape (frames,)."""
        seconds = 0.0 if self.offset is None else self.offset.seconds
        return np.asarray(self.samples.exposures_s / (self.samples.exposures_s - seconds))

    @property
    def follow_no_curve(self) -> bool:
        """Return whether unseen parts are predicted so badly that no labels can be called consistent."""
        return follow_no_curve(self.errors[2], self.fitted.samples, self.fitted.log_exposure)


def _exact_log_times(bracket: Bracket) -> Array:
    stated = np.array([frame.settings.exposure_s for frame in bracket.light])
    exact = np.array([exact_exposure_s(seconds) for seconds in stated])
    return np.asarray(np.log(bracket.effective_exposures_s) + np.log(exact / stated))


def _plane(frames: Sequence[Frame]) -> list[Plane]:
    """Return the samples of another colour; none where it hardly overlaps, which that colour may."""
    bracket = Bracket.from_frames([frame for frame in frames if not frame.settings.is_dark]).thinned(_ENOUGH_PIXELS)
    try:
        samples = gather_samples(bracket)
        return [Plane(samples, curve_debevec1997(samples).log_exposure)]
    except MeasurementError:
        return []


def _judge(plane: Plane, others: Sequence[Plane], exact: Array) -> _Judged:
    samples, start = plane.samples, plane.start

    def planes_of(timed: ResponseSamples) -> list[Plane]:
        times = timed.frame_log_time
        return [Plane(timed, start), *(replace(one, samples=one.samples.timed(times)) for one in others)]

    printed, stops = thinned(samples), thinned(samples.timed(exact))
    before = error_of_quadrants(printed, settle(printed, start))
    chosen, rounded, now = samples, False, before
    if np.ptp(exact - samples.frame_log_time) > 1e-3:
        after = error_of_quadrants(stops, settle(stops, start))
        if after.sum() <= LEAST_GAIN * before.sum() and np.all(after <= before):
            chosen, rounded, now = samples.timed(exact), True, after
    found = find_exposures(planes_of(chosen))
    if found.wrong and rounded:
        # A wrong label may make the exact stops look better by chance: they must still do so with it.
        free = tuple(one.frame for one in found.wrong)
        as_printed, as_stops = (
            error_of_quadrants(timed, settle(timed, start, free)) for timed in map(found.timed, (printed, stops))
        )
        if as_stops.sum() > LEAST_GAIN * as_printed.sum():
            chosen, rounded, now = samples, False, before
            found = find_exposures(planes_of(chosen))
    labels, chosen = found.wrong, found.timed(chosen)
    thin = thinned(chosen)
    known = tuple(one.log_ratio for one in labels) if others else ()
    fitted = settle(thin, start, tuple(one.frame for one in labels), known=known)
    final = error_of_quadrants(thin, fitted)
    log_time = chosen.frame_log_time + fitted.fit.log_time_errors
    for one in labels:  # all colours tell a label better than the one that was fitted
        log_time[one.frame] = chosen.frame_log_time[one.frame] + one.log_ratio[0]
    return _Judged(
        thin,
        fitted,
        log_time,
        rounded,
        found,
        (float(before.mean()), float(now.mean()), float(final.mean())),
        freed_one_by_one(planes_of(chosen), tuple(one.frame for one in labels)),
        most_wrong_labels([plane, *others]) > 0,
    )


def _result(judged: _Judged, bracket: Bracket, names: Sequence[str]) -> ReconcileResult:
    before, stops, after = judged.errors
    effects = []
    if judged.rounded:
        share = {"share": FittedParameter(1.0, None, "1")}
        effects.append(
            FoundEffect("nominal_settings", share, "exposure_s", before / after, stops / after, block="left-out DN")
        )
    if (offset := judged.offset) is not None:
        effects.append(
            FoundEffect(
                OFFSET,
                {"offset_s": FittedParameter(offset.seconds, offset.u_seconds, "s")},
                "exposure_s",
                stops / after,
                1.0,
                gain_nats=0.5 * (offset.seconds / offset.u_seconds) ** 2,
                block="left-out DN",
            )
        )
    for label in judged.labels:
        stated = bracket.light[label.frame].settings.exposure_s
        ratio, u_ratio = _of_printed(label, judged, bracket)
        effects.append(
            FoundEffect(
                _LABEL,
                {
                    "label_s": FittedParameter(float(stated), None, "s"),
                    "ratio": FittedParameter(ratio, u_ratio, "1"),
                },
                "exposure_s",
                stops / after,
                1.0,
                _rivals(label, judged, names),
                {"description": f"take the exposure of {names[label.frame]} again, or read its EXIF record"},
                # Of a normal distribution as wide as the uncertainty: the label as printed against the ratio found.
                gain_nats=0.5 * (label.log_ratio[0] / label.log_ratio[1]) ** 2,
                block="left-out DN",
            )
        )
    return ReconcileResult(
        verdict=_verdict(judged, found=bool(effects)),
        effects=tuple(effects),
        gap_before=before / after,
        gap_after=1.0,
        limits={
            _LABEL: Limit(_limit(judged), "ratio", "1"),
            "gamma_enabled": Limit(None, "gamma", "1"),
            "response_nonlinearity": Limit(None, "a2", "1"),
        },
        captures=len(bracket.light),
        frames=len(bracket.light),
        assumptions=(
            "the tone curve is unknown but one and the same for all photographs",
            "a power of the tone curve and one of the exposures cannot be separated: the printed ratios fix it",
        ),
        gap_unit=_GAP_UNIT,
        extra={"remarks": [_sentence(judged, bracket, names)]},
    )


def _verdict(judged: _Judged, *, found: bool) -> Verdict:
    if judged.follow_no_curve:
        return Verdict.INCOMPLETE if found else Verdict.UNNAMED
    return Verdict.EFFECTS_FOUND if found else Verdict.AGREES


def _of_printed(label: WrongLabel, judged: _Judged, bracket: Bracket) -> tuple[float, float]:
    """Return real over printed exposure and its standard uncertainty: a label's own ratio is to the exact stop."""
    ratio = math.exp(judged.log_time[label.frame]) / float(bracket.effective_exposures_s[label.frame])
    return ratio, label.log_ratio[1] * ratio


def _rivals(label: WrongLabel, judged: _Judged, names: Sequence[str]) -> tuple[str, ...]:
    """Return which other labels predict left-out parts nearly as well, each alone in its place."""
    return tuple(
        f"{_LABEL} of {names[frame]} (ratio {ratio * judged.expected[frame]:.3f})" for frame, ratio in label.rivals
    )


def _limits(judged: _Judged) -> list[float]:
    """Return of each frame ln of real over stated exposure from which its label is named; infinite where none is."""
    return [
        smallest_label_error(float(seconds), judged.exposures.allowed_s) + _SURE * u if judged.can_tell else math.inf
        for seconds, (_, u) in zip(judged.samples.exposures_s, judged.by_others, strict=True)
    ]


def _limit(judged: _Judged) -> float | None:
    """Return the label error, as a ratio less 1, that is named in any frame that can show one; None where none can."""
    known = [limit for limit in _limits(judged) if math.isfinite(limit)]
    return math.expm1(max(known)) if known else None


def _error_sentence(judged: _Judged, bracket: Bracket, names: Sequence[str]) -> str:
    before, _, after = judged.errors
    if judged.follow_no_curve:
        return _no_curve(judged, bracket, names)
    if not judged.labels and not judged.rounded and judged.offset is None:
        return f"Left-out parts of the picture are predicted by the other photographs to {after:.2g} DN on average."
    return (
        f"Left-out parts of the picture are then predicted by the other photographs to {after:.2g} DN on average, "
        f"{before:.2g} DN as printed."
    )


def _no_curve(judged: _Judged, bracket: Bracket, names: Sequence[str]) -> str:
    """Return what to say of photographs that no tone curve joins."""
    few = "" if judged.can_tell else ", wrong exposures (so few photographs cannot show which)"
    step_dn = dial_step_dn(judged.fitted.samples, judged.fitted.log_exposure)
    return (
        f"These {len(bracket.light)} photographs follow no single tone curve with their exposures: left-out parts of "
        f"the picture are predicted to {judged.errors[2]:.2g} DN only{_worst(judged, names)}, where a third of a stop "
        f"is {step_dn:.2g} DN. Another scene or light in some of them, movement, processing that depends on the picture"
        f"{few}."
    )


def _worst(judged: _Judged, names: Sequence[str]) -> str:
    """Return which photograph is predicted worst, where it is so by far."""
    times = judged.log_time - judged.samples.frame_log_time
    errors = np.abs(prediction_error_dn(judged.samples, judged.fitted.log_exposure, times))
    size = [float(np.mean(errors[rows])) if rows.any() else 0.0 for rows in _known_rows(judged.samples, errors)]
    worst = int(np.argmax(size))
    return f", {names[worst]} by far worst" if size[worst] > 2.0 * float(np.median(size)) else ""


def _known_rows(samples: ResponseSamples, values: Array) -> list[NDArray[np.bool_]]:
    """Return for every frame which rows are its own and known."""
    return [(samples.frame == k) & np.isfinite(values) for k in range(samples.frame_log_time.size)]


def _sentence(judged: _Judged, bracket: Bracket, names: Sequence[str]) -> str:
    before, _, after = judged.errors
    if not judged.labels and not judged.rounded and judged.offset is None:
        if judged.follow_no_curve:
            return _no_curve(judged, bracket, names)
        few = "" if judged.can_tell else "; with so few, the tone curve may hide a wrong one"
        predicted = f"left-out parts of the picture are predicted to {after:.2g} DN on average"
        return f"All printed exposures agree: {predicted}{few}."
    parts = ["the printed times are rounded stops"] if judged.rounded else []
    if judged.offset is not None:
        parts.append(f"all exposures are {judged.offset.in_words()} than printed (the shutter's offset, k = 1)")
    for one in judged.labels:
        ratio, u_ratio = _of_printed(one, judged, bracket)
        rivals = "".join(f", or {names[frame]} {other * judged.expected[frame]:.3f}" for frame, other in one.rivals)
        tie = f"{rivals}: these cannot show which" if rivals else ""
        parts.append(
            f"{names[one.frame]}, labelled {exposure_label(bracket, one.frame)}, had "
            f"{ratio:.3f} ± {u_ratio:.3f} of that (k = 1){tie}"
        )
    return (
        f"{'; '.join(parts)}. Left-out parts of the picture are then predicted to {after:.2g} DN on average, "
        f"{before:.2g} DN as printed."
    ) + (f" {_no_curve(judged, bracket, names)}" if judged.follow_no_curve else "")


def _findings(judged: _Judged, bracket: Bracket, names: Sequence[str]) -> tuple[FrameFinding, ...]:
    """Return what the others say of each photograph."""
    rows, g = judged.fitted.samples, judged.fitted.log_exposure
    final = prediction_error_dn(rows, g, judged.fitted.fit.log_time_errors)
    printed = np.log(bracket.effective_exposures_s) - rows.frame_log_time
    before = prediction_error_dn(rows, g, printed)
    times = judged.log_time - np.log(bracket.effective_exposures_s)
    limits = _limits(judged)
    wrong = {one.frame: one for one in judged.labels}
    found = []
    for k, (name, frame) in enumerate(zip(names, bracket.light, strict=True)):
        stated, here = frame.settings.exposure_s, rows.frame == k
        log_ratio, u = judged.by_others[k]
        expected = float(judged.expected[k])
        ratio, u_ratio = expected * math.exp(log_ratio), expected * math.exp(log_ratio) * u
        if k in wrong:
            ratio, u_ratio = _of_printed(wrong[k], judged, bracket)
        taken = stated * math.exp(float(times[k]))
        found.append(
            FrameFinding(
                name,
                stated,
                taken,
                ratio,
                u_ratio,
                math.exp(limits[k]),
                k in wrong,
                rows.dn[here],
                final[here],
                before[here],
                expected,
            )
        )
    return tuple(found)

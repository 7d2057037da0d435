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
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.labels import frame_name, refuse_equal_throughout, refuse_falling_brightness
from radiometer.analysis.response.left_out import dial_step_dn, follow_no_curve, prediction_error_dn
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import ResponseSamples, gather_samples
from radiometer.analysis.response.settle import FittedResponse, error_of_quadrants, settle
from radiometer.analysis.response.shutter_offset import Exposures, find_exposures
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
from radiometer.numbers import with_u
from radiometer.one_thread import on_one_blas_thread
from radiometer.reconciliation.result import ByHand, FittedParameter, FoundEffect, Limit, ReconcileResult, Verdict
from radiometer.reporting.origin import Origin
from radiometer.reporting.page import folded, heading, listed, page, paragraph, section, table
from radiometer.reporting.pictures import (
    BEFORE,
    DIMMED,
    MODEL,
    RULE,
    dress,
    label,
    legend,
    legend_above,
    picture,
    shortened,
)
from radiometer.typing import Array
from radiometer.units import exact_exposures_s

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GAP_UNIT: Final = "mean error in DN of predicting left-out quadrants over that of the final exposures"
_LABEL: Final = "exposure_label_error"
# So many of its u beyond what counts as wrong at all a label is named: in 83 of 84 trials with three real cameras.
_SURE: Final = 5.0
_ENOUGH_PIXELS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class PhotographsReconciled(ByHand):
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
        stated = read_exif_header(Path(self.origin) / next(iter(self.exposures_s)))
        found = {name: str(stated[name].written) for name in ("DateTimeOriginal", "Make", "Model") if name in stated}
        camera = " ".join(found[name] for name in ("Make", "Model") if name in found)
        frames = str(len(self.exposures_s))
        date = found.get("DateTimeOriginal", "")
        return Origin(date, camera, further=(("photographs", frames), ("folder", self.origin)))


@on_one_blas_thread
def reconcile_photographs(
    frames: Sequence[Frame], other_colours: Sequence[Sequence[Frame]] = (), origin: str = ""
) -> PhotographsReconciled:
    """Return whether printed exposures agree with the photographs, and which do not.

    Args:
        frames: Photographs of one scene, at least three with different exposures.
        other_colours: The same photographs in other colours, each with a separate tone curve. Their labels are the
            same, and all colours together show a wrong one.

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
        stated = [frame.settings.exposure_s for frame in bracket.light]
        exact = np.log(bracket.effective_exposures_s) + np.log(np.divide(exact_exposures_s(stated), stated))
        judged = _judge(Plane(samples, start), others, exact)
    except (MeasurementError, InputError) as error:
        refuse_falling_brightness(bracket)
        raise CaptureError(
            f"the photographs hardly overlap: no part of the scene is well exposed in two of them ({error})"
        ) from error
    names = [frame_name(bracket, index) for index in range(len(bracket.light))]
    result = _result(judged, bracket, names)
    shift = judged.log_time - samples.frame_log_time
    findings, sentence = _findings(judged, bracket, names), _error_sentence(judged, bracket, names)
    remark = sentence if result.verdict is Verdict.UNNAMED else f"{outcome(result, findings)} {sentence}"
    return PhotographsReconciled(
        replace(result, seconds=time.monotonic() - begun, extra={"remarks": [remark]}),
        {name: float(s * math.exp(d)) for name, s, d in zip(names, stated, shift, strict=True)},
        dict(zip(names, judged.u_rel, strict=True)),
        findings,
        sentence,
        bracket.origin,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    samples: ResponseSamples
    fitted: FittedResponse
    log_time: Array
    rounded: bool
    exposures: Exposures
    errors: tuple[float, float, float]  # as printed, with the exact stops, with the labels found
    by_others: Sequence[
        tuple[float, float]
    ] = ()  # of each frame ln of real over stated exposure by the others, and its u
    can_show: bool = True  # whether enough photographs show enough to identify a wrong label

    @property
    def u_rel(self) -> list[float]:
        u = np.zeros(self.log_time.size)
        if self.exposures.offset is not None:
            u = self.exposures.offset.u_seconds / self.samples.exposures_s
        for one in self.exposures.wrong:
            u[one.frame] = one.u_ratio / one.ratio
        return [float(value) for value in u]

    @property
    def expected(self) -> Array:
        """Return what label and shutter's offset make together over the label, shape (frames,)."""
        seconds = 0.0 if self.exposures.offset is None else self.exposures.offset.seconds
        return np.asarray(self.samples.exposures_s / (self.samples.exposures_s - seconds))

    @property
    def follow_no_curve(self) -> bool:
        return follow_no_curve(self.errors[2], self.fitted.samples, self.fitted.log_exposure)


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
    known = [limit for limit in _limits(judged) if math.isfinite(limit)]  # of frames that can show one
    effects, found = list[FoundEffect](), partial(FoundEffect, where="exposure_s", block="left-out DN")
    if judged.rounded:
        share = {"share": FittedParameter(1.0, None, "1")}
        effects.append(found("nominal_settings", share, gap_before=before / after, gap_after=stops / after))
    if (offset := judged.exposures.offset) is not None:
        size = {"offset_s": FittedParameter(offset.seconds, offset.u_seconds, "s")}
        nats = 0.5 * (offset.seconds / offset.u_seconds) ** 2
        effects.append(found(OFFSET, size, gap_before=stops / after, gap_after=1.0, gain_nats=nats))
    for printed in judged.exposures.wrong:
        stated = FittedParameter(float(bracket.light[printed.frame].settings.exposure_s), None, "s")
        ratio = FittedParameter(*_of_printed(printed, judged, bracket), "1")
        again = {"description": f"take the exposure of {names[printed.frame]} again, or read its EXIF record"}
        # Of a normal distribution as wide as the uncertainty: the label as printed against the ratio found.
        nats = 0.5 * (printed.log_ratio[0] / printed.log_ratio[1]) ** 2
        effects.append(
            found(
                _LABEL, {"label_s": stated, "ratio": ratio}, gap_before=stops / after, gap_after=1.0, gain_nats=nats,
                alternatives=_rivals(printed, judged, names), next_capture=again,
            )
        )  # fmt: skip
    whole, none = (
        (Verdict.EFFECTS_FOUND, Verdict.AGREES) if not judged.follow_no_curve else (Verdict.INCOMPLETE, Verdict.UNNAMED)
    )
    return ReconcileResult(
        verdict=whole if effects else none,
        effects=tuple(effects),
        gap_before=before / after,
        gap_after=1.0,
        limits={
            _LABEL: Limit(math.expm1(max(known)) if known else None, "ratio", "1"),
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
    )


def _of_printed(label: WrongLabel, judged: _Judged, bracket: Bracket) -> tuple[float, float]:
    ratio = math.exp(judged.log_time[label.frame]) / float(bracket.effective_exposures_s[label.frame])
    return ratio, label.log_ratio[1] * ratio


def _rivals(label: WrongLabel, judged: _Judged, names: Sequence[str]) -> tuple[str, ...]:
    return tuple(
        f"{_LABEL} of {names[frame]} (ratio {ratio * judged.expected[frame]:.3f})" for frame, ratio in label.rivals
    )


def _limits(judged: _Judged) -> list[float]:
    return [
        smallest_label_error(float(seconds), judged.exposures.allowed_s) + _SURE * u if judged.can_show else math.inf
        for seconds, (_, u) in zip(judged.samples.exposures_s, judged.by_others, strict=True)
    ]


def _error_sentence(judged: _Judged, bracket: Bracket, names: Sequence[str]) -> str:
    before, _, after = judged.errors
    if judged.follow_no_curve:
        return _no_curve(judged, bracket, names)
    if not judged.exposures.wrong and not judged.rounded and judged.exposures.offset is None:
        few = "" if judged.can_show else "; with so few, the tone curve may hide a wrong one"
        return (
            f"Left-out parts of the picture are predicted by the other photographs to {after:.2g} DN on average{few}."
        )
    return (
        f"Left-out parts of the picture are then predicted by the other photographs to {after:.2g} DN on average, "
        f"{before:.2g} DN as printed."
    )


def _no_curve(judged: _Judged, bracket: Bracket, names: Sequence[str]) -> str:
    few = "" if judged.can_show else ", wrong exposures (so few photographs cannot show which)"
    step_dn = dial_step_dn(judged.fitted.samples, judged.fitted.log_exposure)
    return (
        f"These {len(bracket.light)} photographs follow no single tone curve with their exposures: left-out parts of "
        f"the picture are predicted to {judged.errors[2]:.2g} DN only{_worst(judged, names)}, where a third of a stop "
        f"is {step_dn:.2g} DN. Another scene or light in some of them, movement, processing that depends on the picture"
        f"{few}."
    )


def _worst(judged: _Judged, names: Sequence[str]) -> str:
    times = judged.log_time - judged.samples.frame_log_time
    errors = prediction_error_dn(judged.samples, judged.fitted.log_exposure, times)
    size = np.nan_to_num([_mean_size(errors[judged.samples.frame == k]) for k in range(times.size)])
    worst = int(np.argmax(size))
    return f", {names[worst]} by far worst" if size[worst] > 2.0 * float(np.median(size)) else ""


def _findings(judged: _Judged, bracket: Bracket, names: Sequence[str]) -> tuple[FrameFinding, ...]:
    rows, g = judged.fitted.samples, judged.fitted.log_exposure
    times = np.log(bracket.effective_exposures_s)
    final = prediction_error_dn(rows, g, judged.fitted.fit.log_time_errors)
    before = prediction_error_dn(rows, g, times - rows.frame_log_time)
    stated = np.array([frame.settings.exposure_s for frame in bracket.light])
    ratios = judged.expected * np.exp([log_ratio for log_ratio, _ in judged.by_others])
    u_ratios = ratios * [u for _, u in judged.by_others]
    wrong = [one.frame for one in judged.exposures.wrong]
    for one in judged.exposures.wrong:
        ratios[one.frame], u_ratios[one.frame] = _of_printed(one, judged, bracket)
    taken = stated * np.exp(judged.log_time - times)
    named_from = np.exp(_limits(judged))
    return tuple(
        FrameFinding(
            name=name,
            stated_s=float(stated[k]),
            taken_s=float(taken[k]),
            ratio=float(ratios[k]),
            u_ratio=float(u_ratios[k]),
            named_from=float(named_from[k]),
            wrong=k in wrong,
            error_dn=_mean_size(final[rows.frame == k]),
            error_as_printed_dn=_mean_size(before[rows.frame == k]),
            expected=float(judged.expected[k]),
            dn=rows.dn[rows.frame == k],
            errors_dn=(before[rows.frame == k], final[rows.frame == k]),
        )
        for k, name in enumerate(names)
    )


def _mean_size(errors: Array) -> float:
    known = errors[np.isfinite(errors)]
    return float(np.mean(np.abs(known))) if known.size else math.nan


# ---- report ---------------------------------------------------------------------------------------------------------
OFFSET: Final = "exposure_time_offset"
_LONGEST_NAME: Final = 18
_BINS: Final = 24  # of digital numbers in the picture of errors: smooth lines, no detail of a tone curve lost
_COVERAGE: Final = 2.0
# From this error in ln exposure on a ninth of a stop counts as wrong.
_TOLERATED: Final = 0.08


@dataclass(frozen=True, slots=True, eq=False)
class FrameFinding:
    """One photograph compared with the others."""

    name: str  # of its file
    stated_s: float  # exposure on its label in s
    taken_s: float  # exposure that it was taken to have in the end in s
    ratio: float  # exposure that the others say over that of the label
    # Its standard uncertainty, the curve that the others leave open included; infinite where too few pixels show the
    # frame
    u_ratio: float
    # Real exposure over that of label and offset, or its inverse, from which the label would be named; infinite where
    # none
    named_from: float
    wrong: bool  # whether the label was found wrong
    error_dn: float  # mean size of what is predicted from the others minus found; NaN where no other frame shows it
    error_as_printed_dn: float  # the same with all labels as printed
    expected: (
        float  # what the label and the shutter's offset make together, over the label; 1 where no offset was taken
    )
    dn: Array  # digital numbers of the photograph's samples, shape (samples,)
    errors_dn: tuple[Array, Array]  # predicted from the others minus found, as printed and in the end; NaN as above


def report_html(
    result: ReconcileResult, frames: Sequence[FrameFinding], sentence: str, title: str, origin: Origin
) -> str:
    """Return the report as HTML."""
    wrong = [one for one in frames if one.wrong]
    line = "the line of 1" if all(one.expected == 1.0 for one in frames) else "what label and shutter's offset make"
    return page(
        title,
        outcome(result, frames),
        [
            paragraph(sentence),
            picture(
                partial(_draw_ratios, frames=frames),
                "Exposure of each photograph found from the others, over its label, with U (k = 2): "
                + (f"those off {line} are named." if wrong else f"all are about {line}.")
                + " Within the grey band no label is called wrong: the common tone curve is not known better.",
                (10.0, 4.2),
                (4.0, 4.4),
            ),
            *[_label_section(one) for one in wrong],
            _what_to_do(wrong, result),
            section(
                "Each photograph against its prediction",
                picture(
                    partial(_draw_errors, frames=frames),
                    "Digital numbers of a left-out part of the picture, predicted by the other photographs, less "
                    "those measured: with the printed exposures, and with those found.",
                    (10.0, 4.2),
                    (4.0, 6.0),
                ),
            ),
            heading("Figures"),
            _frame_table(frames),
            folded("What these photographs would have detected", _limits_shown(result)),
            folded("What was assumed", listed([f"{text}." for text in result.assumptions])),
        ],
        kind="reconcile",
        origin=origin,
    )


def outcome(result: ReconcileResult, frames: Sequence[FrameFinding]) -> str:
    """Return the outcome in one sentence, with U (k = 2)."""
    wrong = [one for one in frames if one.wrong]
    parts = []
    if any(effect.name == "nominal_settings" for effect in result.effects):
        parts.append("the printed times are rounded stops")
    for effect in (one for one in result.effects if one.name == OFFSET):
        found = effect.parameters["offset_s"]
        size = with_u(1e6 * abs(found.value), _COVERAGE * 1e6 * (found.u or 0.0), "µs")
        longer = "longer" if found.value > 0 else "shorter"
        parts.append(f"all exposures are {size} (k = {_COVERAGE:g}) {longer} than printed (the shutter's offset)")
    parts += [
        f"{one.name} had {with_u(one.ratio, _COVERAGE * one.u_ratio)} of its printed exposure (k = {_COVERAGE:g})"
        for one in wrong
    ]
    if result.verdict is Verdict.UNNAMED:
        return f"The {len(frames)} photographs follow no single tone curve with their printed exposures."
    if result.verdict is Verdict.AGREES or not parts:
        return f"The printed exposures of all {len(frames)} photographs agree."
    sentence = f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else parts[0]
    rivals = [text for effect in result.effects for text in effect.alternatives]
    agree = (
        "the others agree"
        if wrong or all(effect.name != OFFSET for effect in result.effects)
        else "with that offset all agree"
    )
    others = f"or, as these photographs cannot decide, {' or '.join(rivals)} instead" if rivals else agree
    return f"{sentence[0].upper() if not wrong else sentence[0]}{sentence[1:]}; {others}."


def _label_section(one: FrameFinding) -> str:
    stops = math.log2(one.ratio)
    taken = with_u(one.taken_s, _COVERAGE * one.taken_s * one.u_ratio / one.ratio, "s")
    return section(
        f"Label of {one.name}",
        paragraph(
            f"Printed {_seconds(one.stated_s)}, exposed for {taken} (k = {_COVERAGE:g}), {abs(stops):.2f} stops "
            f"{'more' if stops > 0 else 'less'}. Left-out parts of this photograph are then predicted by the others to "
            f"{_dn(one.error_dn)} on average, {_dn(one.error_as_printed_dn)} as printed.",
            "what",
        ),
    )


def _what_to_do(wrong: Sequence[FrameFinding], result: ReconcileResult) -> str:
    if not wrong and all(effect.name != OFFSET for effect in result.effects):
        return ""
    names, them = ", ".join(one.name for one in wrong), "it" if len(wrong) == 1 else "them"
    look = f"Look at the EXIF record of {names}, or take {them} again; " if wrong else ""
    return paragraph(
        f"{look}-o exposures.txt writes the exposures that agree, which every command reads with the photographs.", "do"
    )


def _frame_table(frames: Sequence[FrameFinding]) -> str:
    rows = [
        (
            one.name,
            _seconds(one.stated_s),
            _seconds(one.taken_s),
            with_u(one.ratio, _COVERAGE * one.u_ratio),
            f"× or ÷ {one.named_from:.2f}" if math.isfinite(one.named_from) else "never",
            _dn(one.error_as_printed_dn),
            _dn(one.error_dn),
        )
        for one in frames
    ]
    by_others, named = "by the others ÷ printed (k = 2)", "a wrong label is named from"
    head = ("photograph", "printed", "taken as", by_others, named, "error as printed", "in the end")
    return table(head, rows)


def _limits_shown(result: ReconcileResult) -> str:
    rows = [
        (name, "cannot be detected" if limit.amplitude is None else f"× or ÷ {1.0 + limit.amplitude:.2f}")
        for name, limit in result.limits.items()
    ]
    return table(("effect", "named in any photograph from"), rows, words=(1,))


def _draw_ratios(figure: Figure, narrow: bool, frames: Sequence[FrameFinding]) -> None:
    axes = figure.add_subplot()
    place = np.arange(len(frames))
    for wrong, colour, text in ((False, MODEL, "agrees"), (True, BEFORE, "wrong label")):
        these = [k for k, one in enumerate(frames) if one.wrong == wrong and math.isfinite(one.ratio)]
        if these:
            u = [_COVERAGE * min(frames[k].u_ratio, frames[k].ratio) for k in these]
            axes.errorbar(
                place[these],
                [frames[k].ratio for k in these],
                yerr=u,
                fmt="o",
                ms=4,
                color=colour,
                capsize=2,
                label=text,
            )
    expected = np.array([one.expected for one in frames])
    ends = np.repeat(place, 2) + np.tile([-0.5, 0.5], len(frames))
    middle = np.repeat(expected, 2)
    axes.plot(ends, middle, color=RULE, lw=0.8)
    tolerated = math.exp(_TOLERATED)
    axes.fill_between(ends, middle / tolerated, middle * tolerated, color=DIMMED, alpha=0.15, lw=0)
    names = [label(shortened(one.name, _LONGEST_NAME)) for one in frames]
    if not narrow:
        names = [f"{name}\n{_seconds(one.stated_s)}" for name, one in zip(names, frames, strict=True)]
    turned = narrow or len(names) > 8
    axes.set_xticks(place, names, rotation=60 if turned else 0, ha="right" if turned else "center")
    axes.set_yscale("log")
    shown = np.array([one.ratio for one in frames if math.isfinite(one.ratio)])
    low, high = min(0.85, 0.95 * shown.min(initial=1.0)), max(1.18, 1.05 * shown.max(initial=1.0))
    axes.set_ylim(low, high)
    ticks = [
        t for t in (0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0) if low <= t <= high
    ]
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    dress(axes, "photograph", "exposure by the others ÷ printed")
    if any(one.wrong for one in frames):
        legend(axes)


def _draw_errors(figure: Figure, narrow: bool, frames: Sequence[FrameFinding]) -> None:
    panels = figure.subplots(*((2, 1) if narrow else (1, 2)), sharex=True, sharey=True)
    most = max(float(one.dn.max(initial=1.0)) for one in frames)
    for which, (axes, title) in enumerate(zip(panels, ("as printed", "with the exposures found"), strict=True)):
        for one in frames:
            known = np.isfinite(one.errors_dn[which])
            dn, error = one.dn[known], one.errors_dn[which][known]
            place = (dn * (_BINS / (most + 1.0))).astype(int)
            count = np.bincount(place)
            dn, error = (np.bincount(place, v)[count > 0] / count[count > 0] for v in (dn, error))
            text = label(shortened(one.name, _LONGEST_NAME)) if one.wrong else None
            axes.plot(dn, error, color=BEFORE if one.wrong else MODEL, lw=1.6 if one.wrong else 0.9, label=text)
        axes.axhline(0.0, color=RULE, lw=0.8)
        dress(axes, "digital number found (DN)", "predicted − found (DN)", title)
    if any(one.wrong for one in frames):
        legend_above(figure, panels[0], 1 if narrow else 4)


def _dn(size: float) -> str:
    return f"{size:.2g} DN" if math.isfinite(size) else "–"


def _seconds(seconds: float) -> str:
    return f"1/{1.0 / seconds:.4g}\u00a0s" if seconds < 0.3 else f"{seconds:.4g}\u00a0s"

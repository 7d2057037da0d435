"""The dark-adaptation test: run, fitted, compared between visits; its protocols, and what a field bleaches."""

from __future__ import annotations

import datetime as dt
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.adaptation.adaptation_fit import AdaptationFit, FitRequest, fit_adaptation, intercept_verdict
from radiometer.adaptation.outcome import NAMES, Outcome, Reliability, Verdict
from radiometer.adaptation.protocol import (
    SHIPPED,
    AdaptationProtocol,
    bleached_fraction,
    bleached_range,
    instructions,
    practice_of,
    pupil_diameter_mm,
    read_protocol,
    retinal_illuminance_td,
)
from radiometer.adaptation.report import CHOSEN_TO, LABELS, curve_csv, label_of, short, to_mapping, write_page
from radiometer.adaptation.request import Controls, RunRequest
from radiometer.adaptation.run_facts import intercept_of
from radiometer.adaptation.session import Session as Session
from radiometer.adaptation.session import Watcher as Watcher
from radiometer.adaptation.session import open_session, with_prompts
from radiometer.adaptation.threshold_files import number_of
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.adaptation.visits import (
    FEWEST_PAIRS,
    HALF_INTERVAL,
    OVERLAID,
    Compared,
    compare_visits,
    label_of_visit,
    moment_of_visit,
    visit_at,
    visit_in,
    visits_html,
)
from radiometer.api.files import PathLike
from radiometer.api.result import Notice, Result, require_other, unheard
from radiometer.data.capture_set import refuse_inputs
from radiometer.data.event_journal import Event
from radiometer.data.guards import safe_name
from radiometer.data.json_text import json_text
from radiometer.data.statements import StatementMap
from radiometer.data.storage import check_outputs, write_text_atomic
from radiometer.errors import MeasurementError, OutputRefused, UsageError
from radiometer.numbers import rounded, unit_text, with_u
from radiometer.plausible import (
    Age,
    AnyCount,
    Duration,
    FieldArea,
    Luminance,
    NotNegative,
    Port,
    Pupil,
    PupilAge,
    ScotopicRatio,
    Seed,
    Uncertainty,
)
from radiometer.progress import Progress, unseen

# Opens what watches a run for as long as it lasts, such as a live view of a terminal.
View = Callable[[Session], AbstractContextManager[Watcher]]

_VISIT_DRAWS: Final = 200  # bootstrap redraws of each visit: half a second, an interval good to 5 %


@dataclass(frozen=True, repr=False)
class AdaptationRun(Result):
    """A run of the test.

    Attributes:
        outcome: Verdict, thresholds and reliability.
        journal: Its journal.
        table: Table of thresholds; None where none was written.
        fit_options: Options of `adapt fit` that belong to the run's protocol.
    """

    outcome: Outcome
    journal: Path
    table: Path | None
    fit_options: str = ""

    @property
    def practised(self) -> bool:
        """Return whether it was a practice run that ran its whole time."""
        return self.outcome.verdict is Verdict.PRACTICE

    def to_mapping(self) -> dict[str, Any]:
        one = self.outcome
        counts = {"thresholds": len(one.times_min), "catches": one.catches, "false_presses": one.false_presses}
        known = {"verdict": str(one.verdict), "explanation": one.explanation, **counts}
        return self.plain(**known, reliability=one.reliability, csv=self.table)

    def lines(self) -> list[str]:
        """Return verdict, counts and reliability in words."""
        one = self.outcome
        wrote = "they stay in the journal (--csv writes them)" if self.table is None else f"wrote {self.table}"
        rates = [f"{NAMES[name]}: {rate}" for name, rate in one.reliability.rates.items()]
        unchecked = [] if "fixation_losses" in one.reliability.rates else ["fixation was not checked"]
        counts = f"{len(one.times_min)} thresholds, {one.false_presses} false presses; {wrote}"
        return [f"{one.verdict}: {one.explanation}", counts, *rates, *unchecked]

    def __str__(self) -> str:
        return f"{self.outcome.verdict}: {len(self.outcome.times_min)} thresholds in {self.journal}"


def adapt_run(
    protocol: str,
    subject: str,
    out: PathLike | None = None,
    *,
    csv: PathLike | None = None,
    box: str | None = None,
    calibration: PathLike | None = None,
    accept_stale: bool = False,
    camera: str | None = None,
    bench: PathLike | None = None,
    white: str = "white_led",
    fixation: NotNegative | None = None,
    simulate: str | None = None,
    room: NotNegative = 0.0,
    slow_s: Duration = 0.0,
    seed: Seed = 0,
    eye: str = "right",
    age: Age | None = None,
    pupil: Pupil | None = None,
    visit: str | None = None,
    practice: bool = False,
    preset: PathLike | None = None,
    screen: PathLike | None = None,
    display: str | None = None,
    port: Port = 0,
    page: bool = False,
    page_port: Port = 0,
    audio: bool = False,
    force: bool = False,
    watch: Watcher | None = None,
    view: View | None = None,
    bell: Callable[[], None] = lambda: None,
    notice: Notice = unheard,
    announce: Callable[[str], None] = lambda url: None,
) -> AdaptationRun:
    """Run a dark-adaptation test; an unfinished run of the same visit is taken up where it ends.

    Each visit has its own journal, with date and time in its name. A finished run is never taken up. Calibration age,
    safety and, with a camera or bench, the dark room are checked before the bleach. Every event is in the journal
    before the next one happens. At a terminal p pauses and goes on, q ends the test; a press of the button that is held
    for 2 s pauses too.

    Examples:
        >>> import radiometer as rm
        >>> rm.adapt_run("quick", "S1", "s1.jsonl", simulate="never")
        <AdaptationRun no_response: 0 thresholds in s1.jsonl>

    Args:
        protocol: Protocol file, or the name of a shipped one (`adapt protocols`).
        subject: Pseudonym of the subject.
        out: Journal; SUBJECT-PROTOCOL-EYE-DATETIME.jsonl in this folder by default.
        csv: Table of thresholds; next to the journal where they can be fitted.
        box: Light box: "sim", a serial number or a port.
        calibration: Light calibration; the box's own by default.
        accept_stale: Go on with a calibration older than the protocol allows.
        camera: Camera that checks the dark room.
        bench: Bench file of that camera.
        white: Spectrum of the bleaching light.
        fixation: Radiance of the red mark in W·sr⁻¹·m⁻²; the protocol's luminance by default.
        simulate: Simulated subject: "steady", "never", "always", "leaves", "wanders", "healthy" or "amd".
        room: Luminance of the simulated box's room in cd·m⁻².
        slow_s: Real time in s per simulated trial, to watch it.
        seed: Seed of catches and of the simulated subject.
        eye: Eye that looks, "right" or "left": the blind spot is on its temporal side.
        age: Age of the subject in years, for the head of journal and table.
        pupil: Diameter of the pupil in mm as measured, for the same, and to warn where it is below the protocol's.
        practice: Three minutes without a bleach, to learn the task; nothing of it is fitted.
        visit: Date and time of the visit, ISO 8601, UTC where no zone is stated; now by default.
        preset: Light-box preset: bounds and places of its channels.
        screen: Calibration of the screen that shows the spot.
        display: That screen: "browser" (the default), or a simulated one: "lcd", "pwm_lcd", "oled".
        port: Port of the subject's page; 0 for any free one.
        page: Serve the live curve as a page.
        page_port: Port of that page; 0 for any free one.
        audio: Sound prompts: on the page, else by the bell.
        force: Replace tables that exist; a journal is never replaced.
        watch: Called with every event.
        view: Opens what watches the run for as long as it lasts.
        bell: Sounds once.
        notice: Gets what the user must know, a line each.
        announce: Called with the address of the subject's page.

    Raises:
        UsageError: If arguments exclude or need each other, or the journal holds a finished or another run.
        OutputRefused: If the journal exists already and is none that can be taken up.
        CalibrationError: If a calibration is too old or of another device.
        MeasurementError: If the room is not dark.
        UnsafeStimulus: If the light is too much for the eye.
        DeviceError: If a device fails; the run can be taken up again.
    """
    safe_name(subject, "--subject")
    require_other("--screen", screen, display=display, port=port)
    require_other("--box sim", box == "sim", room=room)
    chosen = practice_of(read_protocol(protocol)) if practice else read_protocol(protocol)
    by_box = box or (simulate is None and chosen.spot.device == "light_box")
    require_other("--box", by_box, calibration=calibration, preset=preset, fixation=fixation)
    known, presets, screens, benches = (Path(one) if one else None for one in (calibration, preset, screen, bench))
    asked = RunRequest(
        chosen, subject, eye, seed, box, known, presets, white, fixation, accept_stale,
        measure_room=camera is not None or bench is not None, camera=camera, bench=benches, room_cd_m2=room,
        simulate=simulate, screen=screens, display=display or "browser", port=port, age_years=age, pupil_mm=pupil,
        practice=practice,
    )  # fmt: skip
    now = dt.datetime.now(dt.UTC)
    moment = now if visit is None else moment_of_visit(visit, now)
    found = visit_at(Path(out), asked, moment) if out else visit_in(Path(), asked, moment)
    request, journal, resumed = found.request, found.journal, found.resumed
    for remark in (*found.remarks, request.smaller_pupil()):
        if remark is not None:
            notice(remark)
    table_file = Path(csv) if csv else journal.with_suffix(".csv")
    if journal.exists() and not resumed:
        raise OutputRefused(
            f"{journal} exists already, of a finished or another run; leave --visit out, or name another with -o"
        )
    check_outputs(None if resumed else journal, table_file, force=force or resumed)
    refuse_inputs([table_file], [one for one in (known, presets, screens, benches) if one is not None])
    with (
        open_session(request, journal, Controls(linger_s=slow_s), announce=announce, notice=notice) as session,
        ExitStack() as held,
    ):
        watchers: list[Watcher] = [watch] if watch else []
        if page or page_port > 0:
            reported = held.enter_context(session.page(page_port, audio=audio, announce=lambda url: notice(_at(url))))
            watchers.append(reported)
        if view:
            watchers.append(held.enter_context(view(session)))
        notify = _all_of(watchers, slow_s)
        if audio:
            ring = (lambda: None) if page or page_port > 0 else bell
            notify = with_prompts(session.journal, notify, _sounded(notify, ring))
        outcome = session.run(notify)
        table = table_file if csv or outcome.can_be_fitted else None
        if table is not None:
            write_text_atomic(table, session.table(outcome))
    return AdaptationRun(outcome, journal, table, _fit_options(chosen))


def _at(url: str) -> str:
    return f"the running test, dim and red, is at {url}"


def _all_of(watchers: Sequence[Watcher], slow_s: float) -> Watcher:
    def notify(event: Event) -> None:
        for watcher in watchers:
            watcher(event)
        if slow_s and event["kind"] == "trial":
            time.sleep(slow_s)

    return notify


def _sounded(notify: Watcher, ring: Callable[[], None]) -> Watcher:
    def sound(event: Event) -> None:
        notify(event)
        ring()

    return sound


def _fit_options(protocol: AdaptationProtocol) -> str:
    """Return the option for a protocol that ends at a criterion which is no published rod intercept."""
    met = protocol.end.criterion_log10
    return "" if met is None or protocol.intercept is not None else f" --criterion {met:g}"


@dataclass(frozen=True, repr=False)
class AdaptationCurve(Result):
    """Cone and rod branches fitted to thresholds.

    Attributes:
        fit: Estimates with their intervals.
        series: The thresholds.
        name: Name of the table.
    """

    fit: AdaptationFit
    series: ThresholdSeries
    name: str

    def to_mapping(self) -> dict[str, Any]:
        return to_mapping(self.fit)

    def lines(self) -> list[str]:
        """Return each estimate with its interval, then the reliability of the run where it is known."""
        found = []
        for name, estimate in self.fit.estimates.items():
            interval = estimate.interval
            expanded = 2.0 * estimate.u
            known = interval is not None and interval.low < interval.high  # ends of an area are chosen, not estimated
            ends = [rounded(end, expanded)[0] for end in (interval.low, interval.high)] if interval and known else []
            shown = f"   {ends[0]} to {ends[1]} (95 %)" if ends else ""
            value = rounded(estimate.value, expanded or CHOSEN_TO)[0]
            found.append(f"{label_of(name, self.fit):<32} {value:>9} {unit_text(estimate.unit):<10}{shown}".rstrip())
        rates = Reliability.of_facts(self.series.facts).rates
        return [*found, *(f"{NAMES[name]:<32} {rate}" for name, rate in rates.items())]

    def verdicts(self) -> list[str]:
        """Return what the fit finds, and how it compares with the limit of the protocol's rod intercept."""
        met = intercept_verdict(self.fit)
        return [self.fit.verdict, *([] if met is None else [met])]

    def write_report(self, path: PathLike) -> None:
        """Write the report (HTML). Raises OutputError."""
        write_page(self.fit, Path(path), f"Dark adaptation: {self.name}")

    def write_csv(self, path: PathLike) -> None:
        """Write thresholds, fit and residuals as CSV. Raises OutputError."""
        write_text_atomic(Path(path), curve_csv(self.fit))

    def __str__(self) -> str:
        return f"{self.name}: {self.fit.verdict}"


def adapt_fit(
    data: PathLike,
    criterion: float | None = None,
    *,
    stimulus_u_log10: Uncertainty | None = None,
    bootstrap: AnyCount = 200,
    seed: Seed = 1,
    mapped: StatementMap | Sequence[str] = (),
    progress: Progress = unseen,
) -> AdaptationCurve:
    """Fit cone and rod branches to thresholds: plateau, rod–cone break, S2, rod intercept, final threshold.

    One branch, cones and S2 (5 parameters) or cones, S2 and S3 (7) are tried; the AICc decides among those that make
    sense.

    Examples:
        >>> import radiometer as rm
        >>> curve = rm.adapt_fit("thresholds.csv", bootstrap=0)
        >>> abs(curve.fit.estimates["break_min"].value - 9.0) < 1.5
        True

    Args:
        data: Table of times and thresholds, perhaps with their sigma.
        criterion: log10 threshold of which the time is found, besides the protocol's rod intercept.
        stimulus_u_log10: Standard uncertainty of the stimulus calibration in log10 units; the table's own by default.
        bootstrap: Bootstrap redraws; 0 for none.
        seed: Makes the redraws.
        mapped: Columns and units where the table does not state them, such as ["time=t:s", "threshold=thr:log10"].
        progress: Called after every redraw.

    Raises:
        InputError: If the table cannot be read.
        UnsettledError: If it states no unit of time or threshold, and `mapped` neither.
        MeasurementError: If the thresholds determine no branch.
    """
    series = ThresholdSeries.read(Path(data), StatementMap.of(mapped))
    if stimulus_u_log10 is None:
        stimulus_u_log10 = number_of(series.facts, "u_scale_log10") or 0.0
    request = FitRequest(criterion, stimulus_u_log10, bootstrap, intercept=intercept_of(series.facts))
    found = fit_adaptation(series, request, np.random.default_rng(seed), progress)
    return AdaptationCurve(found, series, Path(data).stem)


@dataclass(frozen=True, repr=False)
class Retest(Result):
    """How well repeated visits agree.

    Attributes:
        comparisons: One per quantity that both visits of a pair have.
    """

    comparisons: tuple[Compared, ...]

    def to_mapping(self) -> dict[str, Any]:
        return {one.name: one.to_mapping() for one in self.comparisons}

    def lines(self) -> Iterator[tuple[str, list[str]]]:
        """Yield for each quantity its heading and its lines."""
        for one in self.comparisons:
            text = [
                f"{with_u(a, 2 * u_a)} then {with_u(b, 2 * u_b)} (k = 2, by the fits alone)   difference {b - a:+.3f}"
                for (a, b), (u_a, u_b) in zip(one.visits, one.u, strict=True)
            ]
            text += [f"not in both visits of pair {', '.join(map(str, one.missing))}"] if one.missing else []
            text.append(f"standard uncertainty of a difference, without that of the light's scale: {one.u_fits:.2g}")
            limits = one.agreement
            if limits is None:
                text.append(f"limits of agreement need {FEWEST_PAIRS} pairs")
            else:
                bounds = ("mean difference", limits.mean), ("lower limit", limits.lower), ("upper limit", limits.upper)
                text += [f"{name:<16} {b.value:+.3f}   {b.low:+.3f} to {b.high:+.3f} (95 %)" for name, b in bounds]
            yield f"{LABELS[one.name]} ({unit_text(one.unit)}), pairs: {len(one.visits)}", text

    def __str__(self) -> str:
        return ", ".join(f"{LABELS[one.name]}, pairs: {len(one.visits)}" for one in self.comparisons)


def adapt_retest(visits: Sequence[PathLike], *, mapped: StatementMap | Sequence[str] = ()) -> Retest:
    """Find how well repeated visits agree: differences of break, S2, rod intercept and plateau.

    From three subjects on with limits of agreement (Bland and Altman), mean ± 1.96 standard deviations, and their 95 %
    intervals.

    Examples:
        >>> import radiometer as rm
        >>> found = rm.adapt_retest(["thresholds.csv", "thresholds.csv"])
        >>> {b - a for one in found.comparisons for a, b in one.visits} == {0.0}
        True

    Args:
        visits: Tables of thresholds: first and second visit of each subject, in turn.
        mapped: Columns and units, as for `adapt_fit`.

    Raises:
        UsageError: If their number is odd, or a pair is of two subjects, eyes or protocols.
        MeasurementError: If thresholds determine no branch.
    """
    if len(visits) % 2:
        raise UsageError(f"{len(visits)} tables: give two for each subject, first and second visit")
    known = StatementMap.of(mapped)
    curves = [_fitted(Path(one), known, 0, 0.0) for one in visits]  # a scale that both share cancels
    for first, second in zip(curves[::2], curves[1::2], strict=True):
        for name in ("subject", "eye", "protocol"):
            then, now = (one.series.facts.get(name) for one in (first, second))
            if then is not None and now is not None and then != now:
                raise UsageError(
                    f"{first.name} and {second.name} are of {name} {then} and {now}; give first and second visit "
                    "of each subject, in turn"
                )
    fits = [one.fit for one in curves]
    return Retest(tuple(compare_visits(list(zip(fits[::2], fits[1::2], strict=True)))))


def _fitted(file: Path, mapped: StatementMap, bootstrap: int, stimulus_u_log10: float | None) -> AdaptationCurve:
    try:
        return adapt_fit(file, stimulus_u_log10=stimulus_u_log10, bootstrap=bootstrap, seed=1, mapped=mapped)
    except MeasurementError as error:
        raise MeasurementError(f"{file}: {error}") from error


@dataclass(frozen=True, repr=False)
class Protocols(Result):
    """The shipped protocols.

    Attributes:
        protocols: In their order.
    """

    protocols: tuple[AdaptationProtocol, ...]

    def to_json(self) -> str:
        return json_text([one.model_dump() for one in self.protocols])

    def to_mapping(self) -> dict[str, Any]:
        """Return the protocols by name."""
        return {one.name: one.model_dump() for one in self.protocols}

    def __str__(self) -> str:
        return ", ".join(one.name for one in self.protocols)


def adapt_protocols() -> Protocols:
    """List the shipped protocols of the dark-adaptation test.

    Examples:
        >>> import radiometer as rm
        >>> "classic" in str(rm.adapt_protocols())
        True
    """
    return Protocols(tuple(read_protocol(name) for name in SHIPPED))


@dataclass(frozen=True, repr=False)
class Instructions(Result):
    """What is read aloud to the subject before a test."""

    protocol: str
    sentences: tuple[str, ...]

    def to_mapping(self) -> dict[str, Any]:
        return {"protocol": self.protocol, "instructions": list(self.sentences)}

    def lines(self) -> list[str]:
        """Return the instructions, a paragraph each."""
        return list(self.sentences)

    def __str__(self) -> str:
        return f"{self.protocol}: {self.sentences[0]}"


def adapt_instructions(protocol: str) -> Instructions:
    """Return the instructions to the subject of a protocol, to be read aloud before the test.

    Examples:
        >>> import radiometer as rm
        >>> rm.adapt_instructions("classic")
        <Instructions classic: This test finds how your eye gets used to the dark. ...>

    Args:
        protocol: Protocol file, or the name of a shipped one.

    Raises:
        ConfigurationError: If there is none, or it holds something not allowed.
    """
    chosen = read_protocol(protocol)
    return Instructions(chosen.name, tuple(instructions(chosen)))


@dataclass(frozen=True, repr=False)
class Visits(Result):
    """Fits of several visits, to be seen together."""

    curves: tuple[AdaptationCurve, ...]

    def to_mapping(self) -> dict[str, Any]:
        return {
            "visits": [
                {"name": label_of_visit(one.series, one.name), "facts": dict(one.series.facts), **one.to_mapping()}
                for one in self.curves
            ]
        }

    def lines(self) -> list[str]:
        """Return a line for each visit: who and when, break, S2 and final threshold; then what ± means."""
        visits = [
            f"{label_of_visit(one.series, one.name)}: "
            + ", ".join(
                f"{label_of(name, one.fit)} {short(one.fit, name)} {unit_text(one.fit.estimates[name].unit)}"
                for name in OVERLAID
                if name in one.fit.estimates
            )
            for one in self.curves
        ]
        return [*visits, HALF_INTERVAL]

    def write_report(self, path: PathLike) -> None:
        """Write the page with all curves in one picture (HTML). Raises OutputError."""
        write_text_atomic(Path(path), visits_html([(one.fit, one.name) for one in self.curves]))

    def __str__(self) -> str:
        return ", ".join(label_of_visit(one.series, one.name) for one in self.curves)


def adapt_visits(
    visits: Sequence[PathLike], *, report: PathLike | None = None, mapped: StatementMap | Sequence[str] = ()
) -> Visits:
    """Fit the thresholds of several visits and lay their curves over each other.

    Examples:
        >>> import radiometer as rm
        >>> len(rm.adapt_visits(["thresholds.csv", "thresholds.csv"]).curves)
        2

    Args:
        visits: Tables or journals, in the order of the visits.
        report: Page to write, with all curves in one picture.
        mapped: Columns and units, as for `adapt_fit`.

    Raises:
        UsageError: If there are fewer than two.
        InputError: If one cannot be read.
        MeasurementError: If thresholds determine no branch.
    """
    if len(visits) < 2:
        raise UsageError(f"{len(visits)} visit: name two at least")
    known = StatementMap.of(mapped)
    found = Visits(tuple(_fitted(Path(one), known, _VISIT_DRAWS, None) for one in visits))
    if report is not None:
        found.write_report(report)
    return found


@dataclass(frozen=True, repr=False)
class Bleach(Result):
    """How much of the visual pigment a field bleaches.

    Attributes:
        pupil_mm: Diameter of the pupil.
        retinal_td: Retinal illuminance in td.
        retinal_td_s: Retinal exposure in td·s.
        rods_bleached: Share of the rods' pigment.
        cones_bleached: Share of the cones' pigment.
        rods_bleached_range: Its range over published constants.
        cones_bleached_range: The same of the cones.
        scotopic_ratio: Scotopic over photopic luminance that the rods were counted with.
        natural_pupil: Whether the pupil is the natural one, not a stated one.
    """

    pupil_mm: float
    retinal_td: float
    retinal_td_s: float
    rods_bleached: float
    cones_bleached: float
    rods_bleached_range: tuple[float, float]
    cones_bleached_range: tuple[float, float]
    scotopic_ratio: float
    natural_pupil: bool

    def __str__(self) -> str:
        return (
            f"{self.retinal_td_s:.4g} td·s: rods {100 * self.rods_bleached:.1f} %, "
            f"cones {100 * self.cones_bleached:.1f} % bleached"
        )


def adapt_bleach(
    luminance: Luminance,
    duration: Duration,
    *,
    pupil: Pupil | None = None,
    field: FieldArea = 100.0,
    age: PupilAge = 28.58,
    scotopic_ratio: ScotopicRatio = 2.0,
) -> Bleach:
    """Find how much of the visual pigment a field bleaches.

    Examples:
        >>> import radiometer as rm
        >>> rm.adapt_bleach(1000.0, 120.0, pupil=7.0)
        <Bleach 4.618e+06 td·s: rods ... %, cones ... % bleached>

    Args:
        luminance: Luminance of the bleaching field in cd·m⁻².
        duration: Its duration in s.
        pupil: Diameter of the pupil in mm; the natural one by default.
        field: Area of the field in square degrees.
        age: Age in years, for the natural pupil.
        scotopic_ratio: Scotopic over photopic luminance of the light, for the rods.

    Raises:
        UsageError: If a number is outside its plausible range.
    """
    diameter_mm = pupil if pupil is not None else pupil_diameter_mm(luminance, field, age)
    trolands = retinal_illuminance_td(luminance, diameter_mm)
    return Bleach(
        diameter_mm,
        trolands,
        trolands * duration,
        bleached_fraction(trolands * scotopic_ratio, duration, "rods"),
        bleached_fraction(trolands, duration, "cones"),
        bleached_range(trolands * scotopic_ratio, duration, "rods"),
        bleached_range(trolands, duration, "cones"),
        scotopic_ratio,
        pupil is None,
    )

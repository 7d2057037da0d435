"""Visits of a subject: a journal each, how well two agree, and the page that lays their curves together."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.adaptation_fit import AdaptationFit
from radiometer.adaptation.report import label_of, origin_of, short
from radiometer.adaptation.request import RunRequest
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.data.event_journal import Event, read_events
from radiometer.data.provenance import FUTURE_DAYS
from radiometer.errors import InputError, UsageError
from radiometer.moments import moment_of
from radiometer.numbers import unit_text
from radiometer.reporting.page import page, paragraph, section, table
from radiometer.reporting.pictures import dress, label, legend, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COMPARED: Final = ("break_min", "s2_slope_per_min", "rod_intercept_min", "plateau")
NORMAL_95: Final = 1.959964  # standard deviations on either side of the mean that hold 95 % of a normal distribution
FEWEST_PAIRS: Final = 3  # fewer differences have no limits worth the name


@dataclass(frozen=True, slots=True)
class Bound:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Agreement:
    """Limits of agreement of one quantity."""

    mean: Bound  # mean of the differences, second less first visit
    sd: float  # their standard deviation
    lower: Bound  # lower limit of agreement: mean − 1.96·sd
    upper: Bound  # upper limit


@dataclass(frozen=True, slots=True)
class Compared:
    """One quantity over all pairs of visits."""

    name: str  # its name
    unit: str  # its unit
    visits: NDArray[np.float64]  # first and second value of the pairs in which both visits have it, shape (pairs, 2)
    u: NDArray[np.float64]  # standard uncertainties of these by their fits; NaN where unknown
    missing: tuple[int, ...]  # numbers, from 1, of the pairs in which a visit has it not
    agreement: Agreement | None  # limits of agreement; None for fewer than three pairs

    @property
    def u_fits(self) -> float:
        """Return the standard uncertainty of a difference as the fits alone have it, root mean square of the pairs."""
        return math.sqrt(float(np.mean(np.sum(self.u**2, axis=1))))

    def to_mapping(self) -> dict[str, Any]:
        """Return what is written to the JSON."""
        return {
            "unit": self.unit,
            "pairs": len(self.visits),
            "visits": [[float(value) for value in pair] for pair in self.visits],
            "u_of_the_visits": [[float(u) if math.isfinite(u) else None for u in pair] for pair in self.u],
            "u_difference_of_the_fits": self.u_fits if math.isfinite(self.u_fits) else None,
            "pairs_without_it": list(self.missing),
            "agreement": None if self.agreement is None else asdict(self.agreement),
        }


def limits_of_agreement(differences: NDArray[np.float64]) -> Agreement:
    """Return the limits of agreement of differences, each with its interval.

    Mean by Student's t; the limits are bounds of a normal distribution's quantiles μ ± 1.96 σ, whose estimate has a
    noncentral t distribution: exact for any number of pairs.

    Args:
        differences: Second less first visit, shape (pairs,), two at least.

    Raises:
        ValueError: If there are fewer than two.

    Source: Bland and Altman 1986 (Lancet 327, 307); intervals: Carkeet 2015 (Optom. Vis. Sci. 92, e71).
    """
    from scipy import stats

    count = differences.size
    if count < 2:
        raise ValueError("limits of agreement need two differences at least")
    mean, sd = float(differences.mean()), float(differences.std(ddof=1))
    tails, root = (0.025, 0.975), math.sqrt(count)  # 95 %
    reach = float(stats.t.ppf(tails[1], count - 1)) * sd / root
    near, far = (float(stats.nct.ppf(tail, count - 1, NORMAL_95 * root)) * sd / root for tail in tails)
    width = NORMAL_95 * sd
    return Agreement(
        Bound(mean, mean - reach, mean + reach),
        sd,
        Bound(mean - width, mean - far, mean - near),
        Bound(mean + width, mean + near, mean + far),
    )


def compare_visits(fits: Sequence[tuple[AdaptationFit, AdaptationFit]]) -> list[Compared]:
    """Return what two visits of each subject have in common, for every quantity that any pair has.

    Args:
        fits: Fits of first and second visit, one pair for each subject.
    """
    found = []
    for name in COMPARED:
        has = _has(fits, name)
        both = [(a.estimates[name], b.estimates[name]) for (a, b), known in zip(fits, has, strict=True) if known]
        if not both:
            continue
        visits = np.array([[a.value, b.value] for a, b in both])
        u = np.array([[a.u, b.u] for a, b in both])
        missing = tuple(number for number, known in enumerate(has, 1) if not known)
        enough = len(both) >= FEWEST_PAIRS
        agreement = limits_of_agreement(visits[:, 1] - visits[:, 0]) if enough else None
        found.append(Compared(name, both[0][0].unit, visits, u, missing, agreement))
    return found


def _has(fits: Sequence[tuple[AdaptationFit, AdaptationFit]], name: str) -> list[bool]:
    """Return which pairs have a quantity in both visits; a plateau without a break is not known to be the cones'."""
    return [all(name in fit.estimates and (fit.has_break or name != "plateau") for fit in pair) for pair in fits]


_STAMP: Final = "%Y-%m-%dT%H%M%SZ"


@dataclass(frozen=True, slots=True)
class Visit:
    """The journal of a visit."""

    journal: Path  # file of its journal
    request: RunRequest  # what is run, with the visit's date; where the run goes on, as its journal states the visit
    resumed: bool = False  # whether the journal holds a part of the run
    remarks: tuple[str, ...] = ()  # what the user must know of the subject's journals, a line each


def iso_utc(moment: dt.datetime) -> str:
    """Return a moment as ISO 8601 in UTC, to the second."""
    return moment.astimezone(dt.UTC).isoformat(timespec="seconds").replace("+00:00", "Z")


def moment_of_visit(text: str, now: dt.datetime) -> dt.datetime:
    """Return the moment that an option states in UTC.

    Raises:
        UsageError: If it is none, or is in the future.
    """
    try:
        moment = moment_of(text).astimezone(dt.UTC)
    except (ValueError, OverflowError) as error:
        raise UsageError(f"--visit {text}: not a date and time; write it as 2026-03-02T14:30Z") from error
    if moment > now + dt.timedelta(days=FUTURE_DAYS):
        raise UsageError(f"--visit {text} is in the future; correct the date, or the clock of this computer")
    return moment


def visit_at(journal: Path, request: RunRequest, now: dt.datetime) -> Visit:
    """Return the visit that a named journal belongs to.

    Raises:
        UsageError: If it holds a finished run, or one whose time is over.
        InputError: If it is no journal.
    """
    events = list(read_events(journal)) if journal.is_file() and journal.stat().st_size else []
    if not events:  # a crash may have torn its first line: nothing was measured, and it begins anew
        return replace(_new(journal, request, now), resumed=journal.is_file())
    over = _over(events, request, now)
    if over is not None:
        raise UsageError(
            f"{journal} holds {over} of {_begun(events[0])}: `adapt fit {journal}` analyses it; "
            "name another journal for another visit"
        )
    return _taken_up(journal, request, events[0])


def visit_in(folder: Path, request: RunRequest, now: dt.datetime) -> Visit:
    """Return the unfinished visit of the same subject, eye and protocol in a folder; else a new one at this moment.

    Args:
        folder: Where journals are.
        request: What is to be run.
        now: Date and time.
    """
    stem = f"{request.subject}-{request.protocol.name}-{request.eye}-"
    remarks: list[str] = []
    for journal in sorted(folder.glob("*.jsonl"), reverse=True):
        if not journal.name.startswith(stem):
            continue
        try:
            events = list(read_events(journal))
        except InputError as error:
            remarks.append(f"{error}; it is left as it is")
            continue
        if not events or not _same_run(events[0], request):
            continue
        over = _over(events, request, now)
        if over is None:
            return _taken_up(journal, request, events[0])
        if not _ended(events):
            remarks.append(f"{journal} holds {over} of {_begun(events[0])}: a new visit begins")
    return _new(folder / f"{stem}{now.astimezone(dt.UTC).strftime(_STAMP)}.jsonl", request, now, tuple(remarks))


def _new(journal: Path, request: RunRequest, now: dt.datetime, remarks: tuple[str, ...] = ()) -> Visit:
    return Visit(journal, replace(request, visit=iso_utc(now)), remarks=remarks)


def _taken_up(journal: Path, request: RunRequest, start: Event) -> Visit:
    """Return a visit that goes on: date, age and pupil are those that its journal states."""
    begun: dict[str, Any] = {name: start.get(name) for name in ("visit", "age_years", "pupil_mm")}
    remarks = [
        f"{option} {asked:g} is not used: {journal} was begun with {known if known is not None else 'none'}"
        for option, asked, known in (
            ("--age", request.age_years, begun["age_years"]),
            ("--pupil", request.pupil_mm, begun["pupil_mm"]),
        )
        if asked not in (None, known)
    ]
    return Visit(journal, replace(request, **begun), resumed=True, remarks=tuple(remarks))


def _same_run(start: Event, request: RunRequest) -> bool:
    """Return whether a journal's first event is of the request's subject, protocol, eye, seed and devices."""
    mine = {
        "subject": request.subject, "protocol": request.protocol.name, "eye": request.eye, "seed": request.seed,
        "simulated": request.simulated,
    }  # fmt: skip
    return all(start.get(name) == value for name, value in mine.items())


def _over(events: list[Event], request: RunRequest, now: dt.datetime) -> str | None:
    """Return what a journal holds that is not to be taken up again, in words; None where its run goes on."""
    if _ended(events):
        return "a finished run"
    unix_s, protocol = events[0].get("unix_s"), request.protocol
    if unix_s is None:  # simulated time stood still meanwhile
        return None
    longest_s = protocol.bleach.duration_s + 60.0 * (protocol.end.duration_min + protocol.watch.longest_pause_min)
    return "an unfinished run whose time is over" if now.timestamp() - float(unix_s) > longest_s else None


def _ended(events: list[Event]) -> bool:
    return any(event["kind"] == "end" for event in events)


def _begun(start: Event) -> str:
    """Return when a journal's run began; journals from before visits were dated state the Unix time at most."""
    unix_s = start.get("unix_s")
    known = start.get("visit") or (unix_s and iso_utc(dt.datetime.fromtimestamp(float(unix_s), dt.UTC)))
    return str(known or "an unknown date")


OVERLAID: Final = ("break_min", "s2_slope_per_min", "rod_intercept_min", "plateau", "final_threshold")
HALF_INTERVAL: Final = "± is half of the 95 % interval, + and - go to its ends."
# Colours that the colour-blind can distinguish, dark enough on white (after Okabe and Ito 2008).
_COLOURS: Final = ("#0072b2", "#b3461b", "#00725a", "#8a4a7d", "#333333", "#8a6d00")
_POINTS: Final = 300


def label_of_visit(series: ThresholdSeries, name: str) -> str:
    """Return subject, eye and date of a visit as its file states them; else the file's name."""
    facts = series.facts
    known = [facts[key] for key in ("subject", "eye") if key in facts]
    date = facts.get("visit", "")[:16].replace("T", " ")
    return " ".join([*known, date]).strip() or name


def visits_html(visits: Sequence[tuple[AdaptationFit, str]]) -> str:
    """Return the page of several visits.

    Args:
        visits: Fits and the names of their files, in the order of the visits.
    """
    names = [label_of_visit(fit.chosen.series, name) for fit, name in visits]

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for number, ((fit, _), name) in enumerate(zip(visits, names, strict=True)):
            series, colour = fit.chosen.series, _COLOURS[number % len(_COLOURS)]
            grid = np.linspace(float(series.time_min[0]), float(series.time_min[-1]), _POINTS)
            axes.plot(series.time_min, series.log_threshold, "o", ms=3, color=colour, alpha=0.5)
            axes.plot(grid, fit.chosen.threshold(grid), color=colour, lw=2, label=label(name))
        units = list(dict.fromkeys(fit.chosen.series.level_name for fit, _ in visits))
        dress(axes, "time in the dark (min)", f"log₁₀ threshold ({'; '.join(units)})")
        legend(axes, "upper right")

    first = visits[0][0]
    found = [one for one in OVERLAID if any(one in fit.estimates for fit, _ in visits)]
    rows = [
        (
            f"{label_of(one, first)} ({_unit(visits, one)})",
            *(short(fit, one) if one in fit.estimates else "–" for fit, _ in visits),
        )
        for one in found
    ]
    head = ("", *names)
    facts = [
        (name, *(fit.chosen.series.facts.get(key, "–") for key in ("protocol", "age_years", "pupil_mm", "program")))
        for (fit, _), name in zip(visits, names, strict=True)
    ]
    differ = len({fit.chosen.series.facts.get("protocol") for fit, _ in visits}) > 1
    return page(
        "Dark adaptation: visits",
        f"{len(visits)} visits, from {names[0]} to {names[-1]}.",
        [
            picture(draw, "Thresholds and fitted curves of all visits.", (10.0, 5.2), (4.0, 4.6)),
            paragraph("The visits were run by different protocols: their curves cannot be compared.", "flag")
            if differ
            else "",
            section("What each visit found", table(head, rows), paragraph(HALF_INTERVAL, "small")),
            section("How each was made", table(("visit", "protocol", "age in years", "pupil in mm", "program"), facts,
                                               words=(1, 4))),
        ],
        kind="Dark adaptation",
        origin=origin_of([fit.chosen.series.facts for fit, _ in visits]),
    )  # fmt: skip


def _unit(visits: Sequence[tuple[AdaptationFit, str]], name: str) -> str:
    return next((unit_text(fit.estimates[name].unit) for fit, _ in visits if name in fit.estimates), "–")

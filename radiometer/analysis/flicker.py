"""Temporal light modulation: waveforms, and depth, index, frequency, SVM and PstLM with their uncertainty.

Source: CIE TN 012:2021 and IEEE 1789-2015 (modulation depth, flicker index), IEC TR 63158:2018 (SVM), IEC TR
61547-1:2020 (PstLM).

Samples of many periods, sorted by phase, show the period more finely than one period of them does. Where a Fourier
series describes them within their noise, its extremes are those of the light between the samples as well. Steps need
more harmonics than samples support, so there the extremes are those of neighbouring phases.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import butter, resample_poly

from radiometer.analysis.reading.budget import coverage_factor
from radiometer.data import Quantity
from radiometer.data.statements import StatementMap
from radiometer.data.text_table import finite, read_table
from radiometer.errors import InputError, MeasurementError
from radiometer.statistics.scale import jackknife_u
from radiometer.typing import Array

FEWEST_SAMPLES: Final = 32
FEWEST_PERIODS: Final = 1.99  # two, whose frequency is known to a part of that
_LINE_WIDTHS: Final = 0.3  # by which the line of few periods may be off
_TIME_NAMES: Final = ("time", "t", "timestamp", "seconds", "x", "second")
_LIGHT_NAMES: Final = (
    "light", "value", "signal", "illuminance", "luminance", "radiance", "irradiance", "voltage", "volt", "v", "ch1",
    "channel_1", "y", "intensity", "amplitude",
)  # fmt: skip
_STEP_ROUNDING: Final = 0.02  # of a step: by so much a time may be off beyond what its decimals move it by
_MOST_HARMONICS: Final = 12  # that take part in finding the period; further ones hold little of a lamp's power
# A period is accepted where its harmonics hold so much of the modulation that noise or chance cannot.
_PERIODIC_SHARE: Final = 0.5
_ALIKE: Final = 0.5  # of the strongest line's power: only a pulse of some samples has harmonics so much alike
_LEAST_SHARE: Final = 1e-6  # of the variance that a longer period must explain: more than rounding
_FREQUENCY_TOLERANCE: Final = 1e-6  # of a line's width, at which the search for the frequency ends
_FALL_OFF_DEGREE: Final = 4  # cos⁴ over half a field of 35° leaves 1e-3 of a polynomial of degree 4
_NO_WORSE: Final = 1.5  # a sum of squares that noise and rounding make of one model and of another
_FEWEST_SEEN: Final = 1.5  # periods, before the fall-off is known
_MOST_SAMPLES: Final = 10_000  # to find the period of: some 200 periods, which give it to parts in 100,000
# SVM: exponent of the sum and band of its Fourier components (IEC TR 63158, clause 4; CIE TN 006:2016).
_SVM_EXPONENT: Final = 3.7
_SVM_BAND_HZ: Final = (80.0, 2000.0)
# PstLM: block b's band, the eye's weighting of relative illuminance, block c's scale and time constant (IEC TR 61547-1,
# annex A), and the percentiles of block d with their weights (IEC 61000-4-15, 5.7.2).
_PST_BAND_HZ: Final = (0.05, 35.0)
_PST_NUMERATOR: Final = (0.041661, 44.758, 2715.6, 29839.0, 0.0)
_PST_DENOMINATOR: Final = (1.0, 196.32, 11781.0, 534820.0, 3505380.0)
_PST_SCALE: Final = 1.101603155420234e6
_PST_SMOOTHING_S: Final = 0.3
_PST_PERCENTILES: Final = (
    (0.0314, (0.1,)),
    (0.0525, (0.7, 1.0, 1.5)),
    (0.0657, (2.2, 3.0, 4.0)),
    (0.28, (6.0, 8.0, 10.0, 13.0, 17.0)),
    (0.08, (30.0, 50.0, 80.0)),
)
_FEWEST_LINES: Final = 100  # of the periodogram, for a median that the lines of a period do not move
_NOISY_REL: Final = 0.05  # of PstLM: noise that adds more is reported
_PST_TRANSIENT_S: Final = 20.0  # that the filters need to settle; left out (IEC TR 61547-1)
_PST_RATE_HZ: Final = 2000.0  # the least that the filters are specified for
_MOST_BLOCKS: Final = 16  # of whole periods, of which the scatter is taken
_LEAST_MEAN: Final = 0.01  # of the mean of absolute values, which light is equal to but for noise
# Rounding to steps is alike in every period, so no scatter shows it: it is drawn, if values occur four times or more.
_OCCURRENCES: Final = 4
_FEWEST_CODES: Final = 4  # light of two or three levels need not be rounded
_DRAWS: Final = 6
_LATTICE: Final = 1e-4  # of a step, to which differences of rounded values are multiples of it
_NO_STEP: Final = 1e-4  # of the range: what finer steps move is nothing
_SAME_REL: Final = 1e-9  # of the range: values that are written alike
_MOST_POINTS: Final = 4096  # phases that are kept apart: a mean over one keeps 1 − 1e-7 of a sinusoid
_GRID: Final = 2880  # phases at which a series is evaluated
_ORDERS: Final = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
_TAIL: Final = 2  # harmonics above those of the light: they show that the series ends, and their u counts
_SIGNIFICANT: Final = 12.0  # of χ² with two degrees of freedom: 0.25 % by chance
_STRUCTURED_SIGMAS: Final = 3.0
_MOST_OF_NOISE: Final = 1.5  # the trimmed noise of 32 points scatters by 18 %
_SAMPLES_PER_FACTOR: Final = 4  # of a series: fewer leave too few residuals to judge it by
_NEGLIGIBLE: Final = 1e-4  # of the fundamental's amplitude
_WORST_CONDITION: Final = 100.0  # of the normal equations: beyond it phases do not separate harmonics
_SHORT_PERIODS: Final = 1e-3  # an exposure of so small a part of the period loses less than other doubts leave
_LEAST_KEPT: Final = 0.2  # of an amplitude that an exposure keeps; below, the correction would amplify noise
_STEP_RATIO: Final = 4.0  # of a rise between neighbouring phases over the lesser of its neighbours, and over the median
_EDGE_DRAWS: Final = 64  # of the places of steps: their scatter is then known to 9 %
_WINDOW: Final = 1 / 200  # of a period: mean over it before extremes of noisy phases are taken
_NOISELESS: Final = 1e-3  # of the range: noise below it needs no means
# Differences of neighbours: a tenth of them may be steps. The rest of a normal distribution has this variance.
_TRIMMED_SHARE, _TRIMMED_VARIANCE = 0.9, 0.623


@dataclass(frozen=True, slots=True, eq=False)
class Waveform:
    """Light at equal steps of time."""

    light: Array  # values in any unit proportional to light, with the value of darkness taken off, shape (samples,)
    rate_hz: float  # samples per s
    origin: str  # file or device that it is from
    u_dark: float = 0.0  # standard uncertainty of the value of darkness, in the unit of `light`
    averaged_s: float = 0.0  # time over which each sample averages, in s; 0 where that is short
    assumptions: tuple[str, ...] = ()  # what was assumed, a sentence each
    period: Period | None = None  # its repetition where that is known, its frequency per sample
    others: tuple[Waveform, ...] = ()  # what it may be as well, one standard uncertainty off in one direction each

    @property
    def duration_s(self) -> float:
        """Return samples over rate in s."""
        return self.light.size / self.rate_hz

    def at_rate(self, rate_hz: float) -> Waveform:
        """Return the same samples taken at another rate."""
        return replace(self, rate_hz=rate_hz, others=tuple(one.at_rate(rate_hz) for one in self.others))


def read_waveform(
    path: Path, dark: float | None = None, u_dark: float = 0.0, mapped: StatementMap | None = None,
    averaged_s: float = 0.0,
) -> tuple[Waveform, tuple[str, ...]]:  # fmt: skip
    """Return the waveform in a table of time and light, and what is reported about the reading.

    Arguments are as for `radiometer.flicker`. Without a heading column 1 is the time in s, column 2 the light. Raises
    InputError if the table cannot be read, or its times do not rise in equal steps, and UnsettledError if a heading
    gives the time without a unit.
    """
    form = "time, light (with a heading: time_s)"
    table = read_table(path, form)
    doubts = list[str]()
    if table.header:
        at_time = table.find_fact("timestamp", _TIME_NAMES, mapped)
        at_light = table.find_fact("number", _LIGHT_NAMES, mapped)
        others = [n for n in range(table.width) if n != at_time and not table.is_index(n)]
        at_light = others[0] if at_light is None and len(others) == 1 else at_light
        if at_time is None or at_light is None:
            raise InputError(
                f"{path}: needs a column of time and one of light; it has {', '.join(table.header)}: "
                "state them by --map timestamp=COLUMN:UNIT --map number=COLUMN"
            )
        doubts += table.not_used((at_time, at_light))
        unit = ""
    else:
        if table.width != 2:
            raise InputError(f"{path}: {table.width} columns without a heading; it needs {form}")
        at_time, at_light, unit = 0, 1, "s"
        doubts.append("the table has no heading: column 1 is the time in s, column 2 the light")
    time_s = np.array(finite(table.values(at_time, "timestamp", doubts, mapped, defined=unit), table, at_time))
    light = np.array(table.numbers(at_light))  # in any unit: every measure is a ratio
    rate_hz = _rate_hz(path, time_s, table.written_step(at_time))
    assumptions = () if dark is not None else ("the value 0 is darkness; --dark VALUE states another",)
    return Waveform(light - (dark or 0.0), rate_hz, str(path), u_dark, averaged_s, assumptions), tuple(doubts)


def _rate_hz(path: Path, time_s: Array, written: tuple[float, float]) -> float:
    """Return the rate of times that rise in equal steps; `written` are their step of decimals and span, in one unit."""
    if time_s.size < FEWEST_SAMPLES:
        raise InputError(f"{path}: {time_s.size} samples; a waveform needs {FEWEST_SAMPLES}")
    step_s = (time_s[-1] - time_s[0]) / (time_s.size - 1)
    if not step_s > 0.0 or np.any(np.diff(time_s) <= 0.0):
        raise InputError(f"{path}: the times do not rise from line to line")
    # Decimals of the table, and those of a double, may move a time; jitter of the clock is none of both.
    decimals, span = written
    rounding_s = decimals * (time_s[-1] - time_s[0]) / span + 4.0 * float(np.spacing(np.abs(time_s).max()))
    off_s = float(np.max(np.abs(time_s - time_s[0] - step_s * np.arange(time_s.size))))
    if off_s > _STEP_ROUNDING * step_s + rounding_s:
        at = int(np.argmax(np.abs(np.diff(time_s) - step_s)))
        raise InputError(
            f"{path}: the times do not rise in equal steps: {1e6 * (time_s[at + 1] - time_s[at]):.4g} us behind row "
            f"{at + 1}, {1e6 * step_s:.4g} us on average; export the waveform at a constant rate"
        )
    return float(1.0 / step_s)


def waveform_of_rows(
    pixels: Array, row_time_s: float, exposure_s: float, origin: str, black_dn: float, flat: Array | None = None,
    u_black_dn: float = 0.0,
) -> Waveform:  # fmt: skip
    """Return the waveform that the rows of a rolling-shutter frame sample one after the other.

    Arguments are as for `radiometer.flicker`; `pixels` are digital numbers, shape (rows, columns), `flat` likewise.
    Raises InputError if times or shapes do not fit.
    """
    if not (row_time_s > 0.0 and exposure_s > 0.0):
        raise InputError("row time and exposure must be above 0 s")
    rows = pixels.mean(axis=1) - black_dn
    if rows.size < FEWEST_SAMPLES:
        raise InputError(f"{origin}: {rows.size} rows; a waveform needs {FEWEST_SAMPLES}")
    shading = rows
    if flat is not None:
        if flat.shape != pixels.shape:
            raise InputError(f"{origin}: {pixels.shape} pixels, the flat has {flat.shape}")
        shading = flat.mean(axis=1) - black_dn
    if np.any(rows.mean() <= 0.0) or (flat is not None and np.any(shading <= 0.0)):
        raise InputError(f"{origin}: rows at or below the black level {black_dn:g} DN; state the right --black-level")
    u_dark = u_black_dn / float(np.mean(shading))
    plain = Waveform(rows, 1.0 / row_time_s, origin, u_dark, exposure_s)
    if flat is not None:
        return replace(plain, light=rows / shading)
    assumed = (
        "the fall-off over the rows is a polynomial, fitted together with the light; --flat FILE of steady light "
        "measures it"
    )
    plain = replace(plain, assumptions=(assumed,))
    found, *others = (replace(plain, light=one.light, period=one.period) for one in _without_fall_off(rows))
    return replace(found, others=tuple(others))


def _without_fall_off(rows: Array) -> tuple[Waveform, ...]:
    """Return the light of rows over their fall-off, and what it is one standard uncertainty off, in each direction.

    Light of few periods is no less like a polynomial than the fall-off is: so period, harmonics and fall-off are
    fitted together, and the covariance says what the rows leave open. Rows that show no period leave both open:
    the light over a parabola, and the rows themselves, are then returned. Rates are in samples.
    """
    at, index = np.linspace(-1.0, 1.0, rows.size), np.arange(rows.size)
    powers = at[:, None] ** np.arange(1, _FALL_OFF_DEGREE + 1)
    parabola = np.polyval(np.polyfit(at, rows, 2), at)
    plain = Waveform(rows / np.maximum(parabola, 1e-9 * rows.mean()), 1.0, "")
    # A parabola takes part of few periods with it, and a deep fall-off hides them: either may be the better start.
    seen = [find_period(one, _FEWEST_SEEN) for one in (plain, Waveform(rows, 1.0, ""))]
    unknown = plain, Waveform(rows / rows.mean(), 1.0, "")
    starts = {several * one.frequency_hz for one in seen if one is not None for several in (1, 2)}
    starts |= {several / rows.size for several in (1.5, 2.0, 3.0)}
    scale, fits = np.array([0.1 / rows.size, *[0.1] * _FALL_OFF_DEGREE]), list[Any]()
    for start in sorted(one for one in starts if one < 0.45):
        order = max(1, min(_MOST_HARMONICS, int(0.45 / start)))

        def left(parameters: Array, order: int = order) -> Array:
            columns = harmonics(parameters[0] * index, order) * (1.0 + powers @ parameters[1:])[:, None]
            return np.asarray(rows - columns @ np.linalg.lstsq(columns.T @ columns, columns.T @ rows, rcond=None)[0])

        fits.append(least_squares(left, [start, *np.zeros(_FALL_OFF_DEGREE)], x_scale=scale))
    # Half a frequency explains what the whole one does: the highest that does counts.
    least = min(one.cost for one in fits)
    found = max((one for one in fits if one.cost <= _NO_WORSE * least), key=lambda one: one.x[0])
    residual, noise = found.fun, 2.0 * float(found.cost)
    # Neighbours that are off together, as where a waveform has more harmonics, count as one.
    alike = np.correlate(residual, residual, "full")[rows.size - 1 :] / max(noise, 1e-300)
    together = max(2.0 * float(alike[: max(1, int(np.argmax(alike < 0.0)))].sum()) - 1.0, 1.0)
    freedom = max(rows.size / together - found.x.size - 2 * min(_MOST_HARMONICS, int(0.45 / found.x[0])) - 1, 1.0)
    covariance = np.linalg.pinv(found.jac.T @ found.jac, hermitian=True) * noise / freedom
    size, turned = np.linalg.eigh(covariance / np.outer(scale, scale))
    off = [np.sqrt(max(one, 0.0)) * scale * direction for one, direction in zip(size, turned.T, strict=True)]
    u = math.sqrt(max(float(covariance[0, 0]), 0.0))
    without = float(np.polyfit(at, rows, _FALL_OFF_DEGREE, full=True)[1].sum())  # squares that are left
    if rows.size * (found.x[0] + 2.0 * u) < 2.0 or noise > (1.0 - _PERIODIC_SHARE) * without:
        return unknown
    shadings = [(at_one[0], 1.0 + powers @ at_one[1:]) for at_one in (found.x, *(found.x + one for one in off))]
    lights = [
        Waveform(rows / one * (one.mean() / rows.mean()), 1.0, "", period=Period(cycles, u, 1.0))
        for cycles, one in shadings
        if np.all(one > 0.0)
    ]
    return tuple(lights) or unknown


@dataclass(frozen=True, slots=True)
class Period:
    """The repetition of a waveform."""

    frequency_hz: float  # its fundamental frequency
    u_hz: float  # standard uncertainty of it
    share: float  # part of the variance that the fundamental and its harmonics hold


def find_period(waveform: Waveform, fewest: float = FEWEST_PERIODS) -> Period | None:
    """Return the repetition of a waveform by least squares of harmonics; None where there is none.

    A record of fewer than the fewest periods shows no repetition.

    The frequency is the one whose fundamental and harmonics hold most of the variance. It is that of the strongest
    line unless another halves what is not explained: a half or a third of it, or the lowest line about as strong.
    The harmonics of a short pulse are all alike. The uncertainty is the bound for a sinusoid in white
    noise, u² = 6σ²·rate²/(π²·A²·n³) with the amplitude A (Rife and Boorstyn 1974).
    """
    if (known := waveform.period) is not None:
        return Period(known.frequency_hz * waveform.rate_hz, known.u_hz * waveform.rate_hz, known.share)
    variance = float(np.var(waveform.light))
    if not variance > 0.0:
        return None
    lines_hz = _strong_lines_hz(waveform)
    if not lines_hz:
        return None
    rate_hz, light = _excerpt(waveform, lines_hz[0])
    duration_s = light.size / rate_hz
    best_hz, share = 0.0, 0.0
    for near_hz in (lines_hz[0], lines_hz[0] / 2.0, lines_hz[0] / 3.0, *lines_hz[1:]):
        if near_hz * duration_s >= fewest - _LINE_WIDTHS:
            order = max(1, min(_MOST_HARMONICS, int(0.45 * rate_hz / near_hz)))
            found_hz, held = _refined(light, rate_hz, near_hz, order)
            if found_hz * duration_s < fewest:
                continue
            least = share if best_hz else -1.0
            if share >= _PERIODIC_SHARE:  # as many harmonics for both: those above half the rate show elsewhere
                least = max(share, _refined(light, rate_hz, best_hz, order)[1])
            if 1.0 - held < 0.5 * (1.0 - least) - _LEAST_SHARE:
                best_hz, share = found_hz, held
    if share < _PERIODIC_SHARE:
        return None
    noise_2 = max(1.0 - share, 1e-18)  # both over the variance
    bound_hz = math.sqrt(6.0 * noise_2 * rate_hz**2 / (math.pi**2 * 2.0 * share * light.size**3))
    u_hz = math.hypot(bound_hz, _FREQUENCY_TOLERANCE * rate_hz / light.size)
    return Period(best_hz, u_hz, share)


def _strong_lines_hz(waveform: Waveform) -> list[float]:
    """Return the strongest line, then the lowest of about its power where that is another; none below one period.

    Frequencies in Hz hold to about a tenth of a line's width.
    """
    frequency_hz, amplitude = spectrum(
        waveform.light, waveform.rate_hz, next_fast_len(4 * waveform.light.size, real=True)
    )
    power = amplitude**2
    power[frequency_hz * waveform.duration_s < 1.5] = 0.0  # the width of the window's own line
    if not power.any():
        return []
    strongest = int(np.argmax(power))
    lowest = int(np.argmax(power >= _ALIKE * power[strongest]))
    while lowest < strongest and power[lowest + 1] > power[lowest]:
        lowest += 1
    return [float(frequency_hz[at]) for at in dict.fromkeys((strongest, lowest))]


def spectrum(light: Array, rate_hz: float, padded: int | None = None) -> tuple[Array, Array]:
    """Return frequencies in Hz and amplitudes behind a Hann window, of light that zeros may pad to a length."""
    window = np.hanning(light.size)
    amplitude = 2.0 * np.abs(rfft((light - light.mean()) * window, padded)) / window.sum()
    return rfftfreq(padded or light.size, 1.0 / rate_hz), amplitude


def _excerpt(waveform: Waveform, line_hz: float) -> tuple[float, Array]:
    """Return rate in Hz and light of a part that suffices to find a line: means of samples, the first periods."""
    together = max(1, int(waveform.rate_hz / (4 * _MOST_HARMONICS * line_hz)))
    whole = waveform.light.size // together
    light = waveform.light[: whole * together].reshape(whole, together).mean(axis=1)[:_MOST_SAMPLES]
    return waveform.rate_hz / together, light - light.mean()


def harmonics(phase: Array, order: int) -> Array:
    """Return 1, the cosines and the sines up to an order over phases in periods, shape (phases, 1 + 2·order)."""
    angles = 2.0 * np.pi * np.outer(phase, np.arange(1, order + 1))
    return np.hstack([np.ones((phase.size, 1)), np.cos(angles), np.sin(angles)])


def _refined(light: Array, rate_hz: float, near_hz: float, order: int) -> tuple[float, float]:
    """Return the fundamental frequency in Hz near another, and the share of the variance that an order explains."""
    time_s = np.arange(light.size) / rate_hz

    def unexplained(frequency_hz: float) -> float:
        columns = harmonics(frequency_hz * time_s, order)
        products = columns.T @ columns
        fitted = columns @ np.linalg.lstsq(products, columns.T @ light, rcond=None)[0]
        return float(np.sum((light - fitted) ** 2) / np.sum(light**2))

    width_hz = rate_hz / light.size
    found = minimize_scalar(
        unexplained, bounds=(near_hz - 0.5 * width_hz, near_hz + 0.5 * width_hz), method="bounded",
        options={"xatol": _FREQUENCY_TOLERANCE * width_hz},
    )  # fmt: skip
    return float(found.x), max(0.0, 1.0 - float(found.fun))


def whole_periods(waveform: Waveform, period: Period | None) -> tuple[Waveform, int]:
    """Return the longest part of whole periods, and their number; the waveform and 0 where it has no period."""
    if period is None:
        return waveform, 0
    # A part of whole periods ends at a sample, up to half a step too early: cut again it stays as it is.
    highest_hz = period.frequency_hz + 2.0 * period.u_hz
    count = int(waveform.duration_s * highest_hz + 0.5 * period.frequency_hz / waveform.rate_hz + 1e-6)
    samples = round(count / period.frequency_hz * waveform.rate_hz)
    return (waveform, 0) if count < 1 else (replace(waveform, light=waveform.light[:samples], others=()), count)


@dataclass(frozen=True, slots=True)
class Flicker:
    """How light is modulated in time."""

    frequency: Quantity | None  # dominant frequency in Hz; None where nothing repeats beyond noise
    modulation_depth: Quantity  # (max − min)/(max + min), also called percent flicker
    flicker_index: Quantity  # area above the mean over the whole area of a period
    svm: Quantity | None  # stroboscopic visibility measure; None where the record cannot give it
    pst_lm: Quantity | None  # short-term flicker severity of light; None where the record cannot give it
    periods: int  # whole periods that took part; 0 where there is no period
    assumptions: tuple[str, ...]  # what was assumed, a sentence each
    warnings: tuple[str, ...]  # what makes a figure doubtful, a sentence each
    coverage_factor: float = 2.0  # k of the expanded uncertainty at 95.45 %


def measure_flicker(waveform: Waveform, u_clock_rel: float | None = None) -> Flicker:
    """Return the measures of a waveform with their standard uncertainty.

    The scatter between blocks of whole periods gives the statistical part, by leaving out one block at a time. It alone
    is wider by Student's t for few blocks: a k of all parts would widen what does not scatter as well. Where
    the light is rounded to steps, each value may be any light within half a step (rectangular, GUM 4.3.7). The
    value of darkness adds u_dark over the mean light, for it scales every modulation. The relative standard uncertainty
    of the rate, `u_clock_rel`, counts in the frequency; where nothing states it (None), that is named.

    Raises MeasurementError if the mean light is not above 0, as that of an AC-coupled record.
    """
    mean = _mean_light(waveform)
    period = find_period(waveform)
    part, periods = whole_periods(waveform, period)
    blocks = max(2, min(_MOST_BLOCKS, periods)) if periods > 1 else 0
    assumptions, warnings = list(waveform.assumptions), list[str]()
    shape, remark = _shape(waveform, period if periods else None)
    (assumptions if shape.blocks else warnings).append(remark.format(periods=periods))
    rounded, doubted = _rounded(part), [(one, find_period(one)) for one in waveform.others]

    def with_u(values: Array, own_u: Array, of: Callable[[Waveform, Period | None], Array]) -> list[Quantity]:
        drawn = [of(one, period) for one in rounded]
        doubts = [(of(one, again) - values) * _few(blocks) for one, again in doubted]
        spread = np.std(drawn, axis=0, ddof=1) if drawn else 0.0
        u = np.asarray(reduce(np.hypot, [own_u, spread, *doubts, np.abs(values) * waveform.u_dark / mean]))
        return [Quantity(float(value), float(one), "1") for value, one in zip(values, u, strict=True)]

    def of_blocks(of: Callable[[Waveform, Period | None], float]) -> Quantity:
        own_u = _u_of_blocks([of(one, period) for one in _without_a_block(part, periods, blocks)])
        return with_u(np.array([of(part, period)]), own_u, lambda one, again: np.array([of(one, again)]))[0]

    depth, index = with_u(shape.values, shape.u, lambda one, again: _shape(one, again if periods else None)[0].values)
    if np.unique(part.light).size == _FEWEST_CODES - 1:
        warnings.append("the light takes three values only: if they are rounded, no uncertainty covers that")
    if depth.value - 2.0 * depth.u > 1.0:
        warnings.append("the light falls below the value of darkness: state that value by --dark")
    svm = pst = None
    if waveform.rate_hz < 2.0 * _SVM_BAND_HZ[1]:
        warnings.append(
            f"modulation above {waveform.rate_hz / 2.0:.4g} Hz shows at a wrong frequency, a lower one, and SVM is not "
            f"determined: it needs {2.0 * _SVM_BAND_HZ[1]:g} samples per s, the record has {waveform.rate_hz:.4g}"
        )
    elif not periods and not waveform.others:
        warnings.append(
            f"SVM is not determined: no repetition was found; with its noise it is {stroboscopic_visibility(part):.2g}"
        )
    else:
        steps = period if periods and not shape.is_series else None
        svm = of_blocks(stroboscopic_visibility) if steps is None else _visibility_of_steps(part, steps, shape, with_u)
        if waveform.duration_s < 1.0:
            assumptions.append(f"SVM: the light goes on after {waveform.duration_s:.3g} s as it did before")
    if waveform.rate_hz < _PST_RATE_HZ:
        warnings.append(
            f"PstLM is not determined: it needs {_PST_RATE_HZ:g} samples per s, the record has {waveform.rate_hz:.4g}"
        )
    elif waveform.duration_s < 3 * _PST_TRANSIENT_S and not periods:
        warnings.append(f"PstLM is not determined: the record has {waveform.duration_s:.3g} s and no repetition")
    else:
        pst = of_blocks(short_term_severity)
        pst, doubts = _with_noise(pst, part, period)
        warnings += doubts
        if waveform.duration_s < 3 * _PST_TRANSIENT_S:
            assumptions.append(f"PstLM: the light goes on after {waveform.duration_s:.3g} s as it did before")
    warnings += _averaging_warnings(waveform, period, shape)
    frequency = None
    if period is not None:
        u_hz = math.hypot(max(period.u_hz, shape.u_hz), period.frequency_hz * (u_clock_rel or 0.0))
        frequency = Quantity(period.frequency_hz, u_hz, "Hz")
        if u_clock_rel is None:
            assumptions.append("frequency: an error of the record's clock is in no uncertainty; state it by --u-clock")
    return Flicker(frequency, depth, index, svm, pst, periods, tuple(assumptions), tuple(warnings))


def _u_of_blocks(left: list[Any]) -> Array:
    """Return the uncertainty of results without one block each that k = 2 expands, by Student's t for few blocks."""
    return jackknife_u(left) * _few(len(left))


def _few(blocks: int) -> float:
    """Return by what few blocks of periods widen an uncertainty that they leave open, for k = 2."""
    return coverage_factor(blocks - 1) / 2.0 if blocks > 1 else 1.0


def _mean_light(waveform: Waveform) -> float:
    mean = float(waveform.light.mean())
    if not mean > _LEAST_MEAN * float(np.abs(waveform.light).mean()):
        raise MeasurementError(
            f"{waveform.origin}: the mean light is {mean:.4g}, not above 0 by {100 * _LEAST_MEAN:g} % of its values; "
            "record it without AC coupling, or state the value of darkness by --dark"
        )
    return mean


def _with_noise(pst: Quantity, part: Waveform, period: Period | None) -> tuple[Quantity, list[str]]:
    """Return PstLM with the noise of the record in u, and a warning where that is much.

    The measure takes percentiles of squares, so noise adds to it; whether that is of the light, a record cannot show.
    """
    quietest = max(pst.value - noise_severity(part, period), 0.0)
    found = Quantity(pst.value, math.hypot(pst.u, (pst.value - quietest) / math.sqrt(3.0)), "1")
    if pst.value - quietest <= _NOISY_REL * pst.value:
        return found, []
    return found, [f"PstLM counts the noise of the record as light: without it, it may be {quietest:.2g}"]


def _shape(waveform: Waveform, period: Period | None) -> tuple[ShapeMeasures, str]:
    """Return the shape of the period, or of the whole record where a period does not describe it, with a remark."""
    if period is None:
        return measure_record(waveform), ("no repetition was found beyond noise: the measures are of the whole record")
    shape = measure_shape(waveform, period)
    line = other_line(waveform, period, shape)
    if line is None:
        return shape, (
            "modulation depth and flicker index are of the mean of {periods} periods: light that does not repeat with "
            "them is averaged out"
        )
    other_hz, amplitude = line[0], line[1] / float(waveform.light.mean())
    found = (
        f"light of {other_hz:.4g} Hz, {100 * amplitude:.2g} % of the mean, does not repeat with "
        f"{period.frequency_hz:.4g} Hz: "
    )
    record = measure_record(waveform)
    widened = np.hypot(shape.u, amplitude)
    if record.u[0] < widened[0]:
        return record, f"{found}modulation depth and flicker index are of the whole record"
    return replace(shape, u=widened), (
        f"{found}modulation depth and flicker index are of the mean of {{periods}} periods, and their u covers it"
    )


def svm_threshold(frequency_hz: Array) -> Array:
    """Return the modulation depth at which an average observer just sees the stroboscopic effect of a sinusoid.

    Source: CIE TN 006:2016, T = 1/(1 + exp(−0.00518·(f/Hz − 306.6))) + 20·exp(−f/10 Hz). The SVM meter of Aalto
    University has the same constants, and agrees with the verification waveforms of IEC TR 63158:2018 (Mantela et al.
    2023, Lighting Res. Technol., doi 10.1177/14771535231212404).
    """
    f = np.asarray(frequency_hz, dtype=np.float64)
    return np.asarray(1.0 / (1.0 + np.exp(-0.00518 * (f - 306.6))) + 20.0 * np.exp(-f / 10.0))


def stroboscopic_visibility(waveform: Waveform, period: Period | None = None) -> float:
    """Return the stroboscopic visibility measure, (Σ (C_m/T_m)^3.7)^(1/3.7) over the components from 80 Hz to 2 kHz.

    C_m is the amplitude of a Fourier component over the mean, T_m the threshold of a sinusoid of its frequency. An
    average over the exposure time of each sample is corrected where it keeps a fifth of the amplitude or more. The
    other components count as they were sampled: then the result is a lower bound.
    """
    part, periods = whole_periods(waveform, period)
    light = part.light
    amplitude = 2.0 * np.abs(rfft(light)) / light.size / light.mean()
    frequency_hz = rfftfreq(light.size, 1.0 / part.rate_hz)
    if period is not None and periods:  # whole periods end between two samples: a harmonic at 2 kHz is in or out
        frequency_hz *= period.frequency_hz * part.duration_s / periods
    return _visibility(frequency_hz, amplitude, part.averaged_s)


def _visibility(frequency_hz: Array, amplitude: Array, averaged_s: float) -> float:
    within = (frequency_hz >= _SVM_BAND_HZ[0]) & (frequency_hz <= _SVM_BAND_HZ[1])
    kept = np.abs(np.sinc(frequency_hz[within] * averaged_s))  # numpy's sinc holds the π
    seen = amplitude[within] / np.where(kept < _LEAST_KEPT, 1.0, kept)
    return float(np.sum((seen / svm_threshold(frequency_hz[within])) ** _SVM_EXPONENT) ** (1.0 / _SVM_EXPONENT))


def _visibility_of_steps(
    waveform: Waveform, period: Period, shape: ShapeMeasures, with_u: Callable[..., list[Quantity]]
) -> Quantity:
    """Return the stroboscopic visibility measure of a period in steps, each of them anywhere between two phases.

    Sampled at instants, harmonics of a step above half the rate show at those below. So light counts as straight lines
    between neighbouring phases but where it steps. Light that does not repeat with the period counts in u.
    """
    rng = np.random.default_rng(0)  # the same draws for the same record

    def of(one: Waveform, its: Period | None) -> Array:
        if its is None:
            return np.array([stroboscopic_visibility(one)])
        return _visibilities_of_fold(_folds(one, its)[0], one, its, None)

    whole, parts = _folds(waveform, period)
    drawn = _visibilities_of_fold(whole, waveform, period, rng)
    u_hz = period.frequency_hz / (math.sqrt(6.0) * waveform.light.size)
    near = [of(waveform, replace(period, frequency_hz=period.frequency_hz + off))[0] for off in (-u_hz, 0.0, u_hz)]
    own_u = _u_of_blocks([_visibilities_of_fold(one, waveform, period, None) for one in parts])
    has_other = other_line(waveform, period, shape) is not None
    other = stroboscopic_visibility(waveform, period) - near[1] if has_other else 0.0
    own_u = np.hypot(own_u, math.hypot(float(np.std(drawn, ddof=1)), max(near) - min(near), other))
    return with_u(np.array([np.mean(drawn)]), own_u, of)[0]


def _visibilities_of_fold(fold: _Fold, waveform: Waveform, period: Period, rng: np.random.Generator | None) -> Array:
    """Return the stroboscopic visibility measure of a period by draws of its steps within their gaps, or by the middle.

    The coefficient of the harmonic m is (Σ J·exp(−iωφ) + Σ s·∫exp(−iωφ)dφ)/(iω), ω = 2πm, over jumps J and slopes s.
    """
    phase, light = fold.phase, fold.light
    gaps, rise = np.diff(phase, append=phase[0] + 1.0), np.diff(light, append=light[0])
    size = np.abs(rise)
    nearby, usual = np.minimum(np.roll(size, 1), np.roll(size, -1)), np.sort(size)[(size.size - 1) // 2]
    jumps = size > _STEP_RATIO * np.maximum(nearby, usual)
    count = int(jumps.sum())
    place = np.full((1, count), 0.5) if rng is None else rng.uniform(size=(_EDGE_DRAWS, count))
    mean = float(np.sum(gaps * (light + rise / 2.0))) + (0.5 - place) @ (gaps * rise)[jumps]
    order = np.arange(1, int(_SVM_BAND_HZ[1] / period.frequency_hz) + 1)
    turn = -2j * np.pi * order[:, None]
    ends = np.exp(turn * np.append(phase, phase[0] + 1.0))
    straight = (ends[:, 1:] - ends[:, :-1]) @ np.where(jumps, 0.0, rise / gaps) / turn[:, 0]
    factors = straight[:, None] + np.exp(turn[:, None] * (phase[jumps] + place * gaps[jumps])) @ rise[jumps]
    amplitude = np.abs(factors) / (np.pi * order[:, None]) / mean
    frequency_hz = (order * period.frequency_hz).astype(np.float64)
    return np.array([_visibility(frequency_hz, one, waveform.averaged_s) for one in amplitude.T])


def short_term_severity(waveform: Waveform, period: Period | None = None) -> float:
    """Return PstLM, the short-term flicker severity of a light waveform.

    The relative light passes a band-pass of 0.05 to 35 Hz and the eye's weighting, is squared and smoothed over 0.3 s;
    percentiles of the result give the severity. The filters have their analogue responses: digital ones of 2 kHz are
    off by 4 % at 120 Hz. A record below a minute repeats by whole periods; of a longer one the first 20 s are left out.
    """
    return _severity(*_for_severity(waveform, period))


def _severity(light: Array, rate_hz: float, transient: int) -> float:
    s = 2j * np.pi * rfftfreq(light.size, 1.0 / rate_hz)
    corner = 2.0 * math.pi * _PST_BAND_HZ[0]
    numerator, denominator = butter(6, 2.0 * math.pi * _PST_BAND_HZ[1], "low", analog=True)
    gain = s / (s + corner) * np.polyval(numerator, s) / np.polyval(denominator, s)
    gain *= np.polyval(_PST_NUMERATOR, s) / np.polyval(_PST_DENOMINATOR, s)
    seen = irfft(rfft(light / light.mean() - 1.0) * gain, light.size)
    sensation = _PST_SCALE * irfft(rfft(seen**2) / (1.0 + _PST_SMOOTHING_S * s), light.size)[transient:]
    total = sum(
        weight * float(np.mean(np.percentile(sensation, 100.0 - np.array(exceeded))))
        for weight, exceeded in _PST_PERCENTILES
    )
    return math.sqrt(max(total, 0.0))


def noise_severity(waveform: Waveform, period: Period | None = None) -> float:
    """Return what white noise adds to PstLM, of the density that the record has between its lines above the band.

    As much is drawn and added once more. Noise alone, and its products with light that changes, grow as √2 then.
    """
    light, rate_hz, transient = _for_severity(waveform, period)
    frequency_hz, amplitude = spectrum(light / light.mean(), rate_hz)
    between = amplitude[(frequency_hz > _PST_BAND_HZ[1]) & (frequency_hz < rate_hz / 4.0)]
    if between.size < _FEWEST_LINES:
        return 0.0
    sigma, rng = light.mean() * _line_noise(between, light.size), np.random.default_rng(0)
    noisier = [_severity(light + rng.normal(0.0, sigma, light.size), rate_hz, transient) for _ in range(_DRAWS)]
    return max(0.0, float(np.mean(noisier)) - _severity(light, rate_hz, transient)) / (math.sqrt(2.0) - 1.0)


def _for_severity(waveform: Waveform, period: Period | None) -> tuple[Array, float, int]:
    """Return light, rate in Hz, at 2 to 4 kHz where it is long, and how many samples the filters settle in."""
    if waveform.duration_s < 3 * _PST_TRANSIENT_S:
        part = whole_periods(waveform, period)[0]
        return part.light, part.rate_hz, 0
    down = max(1, int(waveform.rate_hz / _PST_RATE_HZ))
    light = waveform.light if down == 1 else resample_poly(waveform.light, 1, down, padtype="mean")
    rate_hz = waveform.rate_hz / down
    return light, rate_hz, round(_PST_TRANSIENT_S * rate_hz)


def _without_a_block(part: Waveform, periods: int, blocks: int) -> list[Waveform]:
    """Return a part of whole periods without one block of them at a time."""
    edges = np.round(np.round(np.linspace(0, periods, blocks + 1)) * part.light.size / max(periods, 1)).astype(int)
    cut = (np.delete(part.light, np.s_[first:last]) for first, last in itertools.pairwise(edges))
    return [replace(part, light=one) for one in cut]


def _rounded(waveform: Waveform) -> list[Waveform]:
    """Return waveforms that round to a record of few values; none where the values hardly repeat."""
    light = waveform.light
    codes, which = np.unique(np.round((light - light.min()) / (np.ptp(light) * _SAME_REL or 1.0)), return_inverse=True)
    if codes.size < _FEWEST_CODES or codes.size * _OCCURRENCES > light.size:
        return []
    gaps = np.diff(codes)
    steps = gaps / gaps.min()
    step_rel = float(gaps.min()) * _SAME_REL
    if step_rel < _NO_STEP or np.abs(steps - np.round(steps)).max() > _LATTICE:
        return []
    step = step_rel * float(np.ptp(light))
    rng = np.random.default_rng(0)  # the same draws for the same record
    return [replace(waveform, light=light + rng.uniform(-0.5, 0.5, codes.size)[which] * step) for _ in range(_DRAWS)]


def _averaging_warnings(waveform: Waveform, period: Period | None, shape: ShapeMeasures) -> list[str]:
    """Return what averaging over the exposure of each sample hides."""
    if period is None or waveform.averaged_s <= 0.0:
        return []
    averaged_periods = period.frequency_hz * waveform.averaged_s
    kept = abs(float(np.sinc(averaged_periods)))
    if kept > 0.99 and (shape.is_series or averaged_periods < _SHORT_PERIODS):
        return []
    outcome = "modulation depth, flicker index and SVM are lower bounds"
    if kept >= _LEAST_KEPT and not shape.hidden:
        outcome = "modulation depth is a lower bound, flicker index and SVM are corrected for it"
        if shape.is_series:
            outcome = "modulation depth, flicker index and SVM are corrected for it, but faster light may be hidden"
    return [
        f"each sample averages over {1e3 * waveform.averaged_s:.3g} ms and keeps {100 * kept:.3g} % of the amplitude "
        f"at {period.frequency_hz:.4g} Hz: {outcome}; take a shorter exposure"
    ]


@dataclass(frozen=True, slots=True)
class ShapeMeasures:
    """What a period's shape gives."""

    values: Array  # modulation depth (max − min)/(max + min), flicker index (area above the mean over the whole)
    u: Array  # their standard uncertainties
    blocks: int  # blocks of periods whose scatter was taken; 0 where it was not
    is_series: bool  # whether a Fourier series describes the shape; the loss by exposure is then corrected
    phase: Array  # phases of the shape in periods, rising, shape (n,)
    light: Array  # light there, as it was sampled, shape (n,)
    hidden: bool = False  # whether the exposure hides one of the harmonics
    u_hz: float = 0.0  # standard uncertainty of the frequency where its shape leaves more open than its period says


def measure_shape(waveform: Waveform, period: Period) -> ShapeMeasures:
    """Return modulation depth and flicker index of a period, with their standard uncertainty.

    The uncertainty of a series is that of its least squares, or the scatter between blocks of periods where that is
    larger. Between neighbouring phases it also covers what noise adds to extremes, and an extreme between two samples.

    A step is anywhere between two samples, at the first and at the last of its periods. So the frequency of steps is
    known to 1/√6 of a sample in the record.
    """
    whole, parts = _folds(waveform, period)
    orders = _supported_orders(whole)
    averaged_periods = period.frequency_hz * waveform.averaged_s
    enough, order = orders or (0, 0)
    kept = np.sinc(averaged_periods * np.arange(order + 1))  # numpy's sinc holds the π
    hidden = bool(np.any(np.abs(kept[: enough + 1]) < _LEAST_KEPT))
    orders = None if hidden else orders  # without one of its harmonics the light would have another shape
    kept[np.abs(kept) < _LEAST_KEPT] = 1.0
    kept = np.concatenate([kept, kept[1:]])  # of mean, cosines and sines

    def of(fold: _Fold) -> tuple[Array, Array]:
        return _of_series(fold, *orders, kept) if orders else _of_phases(fold, averaged_periods)

    values, own_u = of(whole)
    if orders:
        phase, u_hz = np.arange(_GRID) / _GRID, 0.0
        light = harmonics(phase, orders[1]) @ _Series.of(whole, orders[1]).factors
    else:
        phase, light = whole.phase, whole.light
        u_hz = math.hypot(period.u_hz, period.frequency_hz / (math.sqrt(6.0) * waveform.light.size))
        # Which phases are next to a step, and how far apart, depends on the frequency: what leaves most open counts.
        near = (replace(period, frequency_hz=period.frequency_hz + one * u_hz) for one in (-1.0, 0.0, 1.0))
        found, found_u = np.array([of(_folds(waveform, one)[0]) for one in near]).swapaxes(0, 1)
        own_u = np.hypot(np.abs(found - values).max(axis=0), found_u.max(axis=0))
        again = _taken_once_more(phase, light, averaged_periods)
        values[1] += 2.0 * again
        own_u[1] = math.hypot(own_u[1], again / math.sqrt(3.0))
    u = np.maximum(own_u, _u_of_blocks([of(part)[0] for part in parts]))
    return ShapeMeasures(values, u, len(parts), bool(orders), phase, light, hidden, u_hz)


def _taken_once_more(phase: Array, light: Array, averaged_periods: float) -> float:
    """Return what averaging once more takes of the flicker index; the first time took one to three times as much.

    Edges between long levels lose three times as much at first where their middle is the mean light, bends once.
    """
    once = np.interp(np.arange(_GRID) / _GRID, phase, light, period=1.0)
    twice = uniform_filter1d(once, max(1, round(min(averaged_periods, 1.0) * _GRID)), mode="wrap")
    above = [np.maximum(one - once.mean(), 0.0).mean() for one in (once, twice)]
    return float((above[0] - above[1]) / once.mean())


def measure_record(waveform: Waveform) -> ShapeMeasures:
    """Return modulation depth and flicker index of a whole record that no period describes."""
    size = waveform.light.size
    fold = _Fold(np.arange(size) / size, waveform.light, np.ones(size))
    values, u = _of_neighbours(fold, _line_noise(spectrum(waveform.light, waveform.rate_hz)[1], size), 1, 3)
    return ShapeMeasures(values, u, 0, False, fold.phase, fold.light)


def _line_noise(amplitude: Array, samples: int) -> float:
    """Return the standard deviation of a sample of white noise, from the amplitudes of its `spectrum`.

    Behind a Hann window their mean square is 6σ²/n; the median of their squares is ln 2 of that (exponential).
    """
    return math.sqrt(float(np.median(amplitude**2)) / math.log(2.0) * samples / 6.0)


def other_line(waveform: Waveform, period: Period, shape: ShapeMeasures) -> tuple[float, float] | None:
    """Return frequency in Hz and amplitude of the strongest line below 2 kHz that no period explains; None in noise."""
    cycles = np.arange(waveform.light.size) * period.frequency_hz / waveform.rate_hz
    left = waveform.light - np.interp(cycles, shape.phase, shape.light, period=1.0)
    frequency_hz, amplitude = spectrum(left, waveform.rate_hz)
    looked_at = (frequency_hz * waveform.duration_s >= 1.5) & (frequency_hz <= _SVM_BAND_HZ[1])
    lines = frequency_hz / period.frequency_hz
    # A Hann window spreads a line over two bins on either side.
    looked_at &= np.abs(lines - np.round(lines)) * period.frequency_hz * waveform.duration_s > 2.5
    least = float(np.ptp(shape.light)) * _NOISELESS
    if not looked_at.any():
        return None
    power = amplitude[looked_at] ** 2
    strongest = int(np.argmax(power))
    # The power of noise has an exponential distribution: ln n + 10 means are reached once in 20,000 records.
    by_chance = float(np.median(power)) / math.log(2.0) * (math.log(power.size) + 10.0)
    if power[strongest] <= max(by_chance, least**2):
        return None
    return float(frequency_hz[looked_at][strongest]), math.sqrt(float(power[strongest]))


@dataclass(frozen=True, slots=True)
class _Fold:
    """Samples by phase: rising phases in periods, mean light and number of samples there."""

    phase: Array
    light: Array
    count: Array


def _folds(waveform: Waveform, period: Period) -> tuple[_Fold, list[_Fold]]:
    """Return all samples by phase, and those without one block of periods at a time."""
    cycles: Array = np.arange(waveform.light.size, dtype=np.float64) * (period.frequency_hz / waveform.rate_hz)
    periods = int(waveform.duration_s * period.frequency_hz + 1e-6)
    blocks = min(_MOST_BLOCKS, periods) if periods > 1 else 0
    block = np.minimum((cycles * blocks / max(periods, 1)).astype(np.intp), blocks - 1)
    parts = [_fold(cycles[block != n], waveform.light[block != n]) for n in range(blocks)]
    return _fold(cycles, waveform.light), parts


def _fold(cycles: Array, light: Array) -> _Fold:
    """Return samples by the phase of their place in periods; phases that are nearly the same are one."""
    phase = cycles % 1.0
    point = (phase * _MOST_POINTS).astype(np.intp) if phase.size > _MOST_POINTS else np.argsort(np.argsort(phase))
    count = np.bincount(point).astype(np.float64)
    seen = count > 0.0
    phase, light = (np.bincount(point, one)[seen] / count[seen] for one in (phase, light))
    return _Fold(phase, light, count[seen])


class _Series(NamedTuple):
    """A Fourier series: mean, cosines, sines; their covariance; what it leaves of every phase."""

    factors: Array
    covariance: Array
    residual: Array
    is_determined: bool  # whether its phases and samples suffice

    @classmethod
    def of(cls, fold: _Fold, order: int) -> _Series:
        """Return the series of an order by least squares."""
        columns = harmonics(fold.phase, order)
        weighted = columns * fold.count[:, None]
        products = columns.T @ weighted
        sizes, inverse = np.linalg.eigvalsh(products), np.asarray(np.linalg.pinv(products, hermitian=True), np.float64)
        factors = inverse @ (weighted.T @ fold.light)
        residual = fold.light - columns @ factors
        freedom = max(fold.phase.size - factors.size, 1)
        covariance = inverse * (float(fold.count @ residual**2) / freedom)
        suffice = sizes[0] * _WORST_CONDITION > sizes[-1] and factors.size * _SAMPLES_PER_FACTOR <= fold.count.sum()
        return cls(factors, covariance, residual, bool(suffice))


def _supported_orders(fold: _Fold) -> tuple[int, int] | None:
    """Return the order of the series that describes the light within its noise, and that which it is checked by.

    The second is about twice the first. Harmonics above the light's own must be insignificant, and the residuals must
    not follow the phase. None where no series fits.
    """
    noise = _noise(fold)
    for order in _ORDERS:
        # Light may have odd harmonics alone: the third shows whether it is a sinusoid.
        both = (max(2 * order, order + _TAIL), 2 * order)
        twice = next((n for n in both if _Series.of(fold, n).is_determined), None)
        if twice is None:
            return None
        series = _Series.of(fold, twice)
        amplitude = np.hypot(*series.factors[1:].reshape(2, -1))
        variance = np.diag(series.covariance)[1:].reshape(2, -1).mean(axis=0)
        least = _NEGLIGIBLE * float(amplitude.max())
        above = slice(order, order + _TAIL)
        ends = bool(np.all(amplitude[above] < np.maximum(least, np.sqrt(_SIGNIFICANT * variance[above]))))
        residual, negligible = series.residual * np.sqrt(fold.count), least * math.sqrt(fold.count.mean())
        # A series rings at steps: there the residuals are larger than the noise between neighbours.
        small = math.sqrt(float(np.mean(residual**2))) < _MOST_OF_NOISE * max(noise, negligible)
        if ends and small and _is_unstructured(residual, negligible):
            return order, twice
    return None


def _is_unstructured(residual: Array, negligible: float) -> bool:
    """Return whether neighbours differ as much as independent noise does (von Neumann 1941)."""
    squares = float(np.mean(residual**2))
    if squares <= negligible**2:
        return True
    ratio = float(np.mean((residual - np.roll(residual, 1)) ** 2)) / (2.0 * squares)
    return (1.0 - ratio) * math.sqrt(residual.size) < _STRUCTURED_SIGMAS


def _of_series(fold: _Fold, enough: int, order: int, kept: Array) -> tuple[Array, Array]:
    """Return modulation depth and flicker index of a series, and their standard uncertainties.

    A bend needs all harmonics: those above an order add to an extreme as 1/order. So what the orders from `enough` to
    twice that add is also what is still missing.
    """
    series = _Series.of(fold, order)
    factors, covariance = series.factors / kept, series.covariance / np.outer(kept, kept)
    columns = harmonics(np.arange(_GRID) / _GRID, order)
    light = columns @ factors
    top, bottom = int(np.argmax(light)), int(np.argmin(light))
    high, low, mean = float(light[top]), float(light[bottom]), float(factors[0])
    depth = (high - low) / (high + low)
    n = np.arange(factors.size)
    first = columns @ np.where(n - order * (n > order) <= enough, factors, 0.0)
    missing = abs(depth - np.ptp(first) / (first.max() + first.min()))
    towards_depth = 2.0 * (low * columns[top] - high * columns[bottom]) / (high + low) ** 2
    above = light > mean
    own = np.eye(factors.size)[0]
    index = float(np.mean(np.maximum(light - mean, 0.0))) / mean
    towards_index = ((columns - own) * above[:, None]).mean(axis=0) / mean - index / mean * own
    between = 1.0 - math.cos(math.pi * order / _GRID)  # of the amplitude, between two phases of the grid
    u = [math.sqrt(max(float(g @ covariance @ g), 0.0)) for g in (towards_depth, towards_index)]
    missing = math.hypot(missing, u[0] * math.sqrt(1.0 - enough / order))  # it is as noisy as its harmonics are
    # Residuals that do not look like noise but are negligible may all be at an extreme.
    left = 0.0 if _is_unstructured(series.residual, 0.0) else float(np.std(series.residual)) / mean
    return np.array([depth, index]), np.hypot(np.hypot(u, abs(depth) * between + left), [missing, 0.0])


def _of_phases(fold: _Fold, averaged_periods: float) -> tuple[Array, Array]:
    """Return modulation depth and flicker index of a period in steps, and their standard uncertainties."""
    sigma = _noise(fold)
    wide = max(1, round(fold.phase.size * _WINDOW)) if sigma > _NOISELESS * float(np.ptp(fold.light)) else 1
    # Phases of few periods may be bunched: a mean reaches from bunch to bunch. An exposure took its mean before.
    reach = 3.0 * float(np.diff(fold.phase, append=fold.phase[0] + 1.0).max()) + averaged_periods
    return _of_neighbours(fold, sigma, wide, 2 * (wide - 1) + round(reach * fold.phase.size))


def _of_neighbours(fold: _Fold, sigma: float, wide: int, wider: int) -> tuple[Array, Array]:
    """Return modulation depth and flicker index from means of neighbouring points, and their standard uncertainties.

    A sample has the standard deviation `sigma`, a mean `wide` points. Means flatten an extreme, and it may be between
    two samples: what `wider` means flatten it by counts.
    """
    depth, middle, slopes, added, sigma_mean = _depth(fold, sigma, wide)
    flattened = abs(depth - _depth(fold, sigma, min(wider, fold.phase.size))[0])
    gaps = np.diff(fold.phase, append=fold.phase[0] + 1.0)
    share = (gaps + np.roll(gaps, 1)) / 2.0
    mean = float(share @ fold.light)
    index = float(share @ np.maximum(fold.light - mean, 0.0)) / mean
    steps = np.diff(fold.light, append=fold.light[0]) * gaps  # a step may be anywhere between two samples
    near = float(share[np.abs(fold.light - mean) < 2.0 * sigma].sum())  # noise is rectified where light is the mean
    u_index = [
        float(np.linalg.norm(steps)) / math.sqrt(12.0), 0.4 * near * sigma,
        sigma / math.sqrt(float(fold.count.sum())),
    ]  # fmt: skip
    u_depth = [added / math.sqrt(12.0) / middle, sigma_mean * slopes, flattened]
    return np.array([depth, index]), np.array([math.hypot(*u_depth), math.hypot(*u_index) / mean])


def _depth(fold: _Fold, sigma: float, wide: int) -> tuple[float, float, float, float, float]:
    """Return the modulation depth of running means, the middle between the extremes, and the depth's slope over noise.

    Noise adds between nothing (sharp extremes) and √(2·ln n) standard deviations (flat ones): half is taken off. That
    most and the standard deviation of a mean come last. The means go around the period's end.
    """
    above, count = (uniform_filter1d(one, wide, mode="wrap") for one in (fold.light * fold.count, fold.count))
    light, sigma_mean = above / count, sigma / math.sqrt(wide * float(np.median(count)))
    added = sigma_mean * math.sqrt(2.0 * math.log(max(light.size / wide, 2.0)))
    high, low = float(light.max()) - added / 2.0, float(light.min()) + added / 2.0
    slopes = 2.0 * math.hypot(high, low) / (high + low) ** 2
    return (high - low) / (high + low), (high + low) / 2.0, slopes, added, sigma_mean


def _noise(fold: _Fold) -> float:
    """Return the standard deviation of a sample, from the differences of neighbouring phases; few of them are steps."""
    after = np.roll(fold.count, -1)
    differences = (np.roll(fold.light, -1) - fold.light) * np.sqrt(fold.count * after / (fold.count + after))
    squares = np.sort(differences**2)[: max(1, int(_TRIMMED_SHARE * differences.size))]
    return math.sqrt(float(squares.mean()) / _TRIMMED_VARIANCE)

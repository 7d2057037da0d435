"""A waveform of light over time: read from a table, or from the rows of a rolling-shutter frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.fft import next_fast_len, rfft, rfftfreq
from scipy.optimize import least_squares, minimize_scalar

from radiometer.data.statements import StatementMap
from radiometer.data.text_table import finite, read_table
from radiometer.errors import InputError
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

    def cut(self, samples: int) -> Waveform:
        """Return its first samples."""
        return replace(self, light=self.light[:samples], others=())

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
    plain = Waveform(rows / shading, 1.0 / row_time_s, origin, u_dark, exposure_s)
    if flat is not None:
        return plain
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
            columns = harmonic_columns(parameters[0] * index, order) * (1.0 + powers @ parameters[1:])[:, None]
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
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * noise / freedom
    size, turned = np.linalg.eigh(covariance / np.outer(scale, scale))
    off = [np.sqrt(max(one, 0.0)) * scale * direction for one, direction in zip(size, turned.T, strict=True)]
    u = math.sqrt(max(float(covariance[0, 0]), 0.0))
    smooth = np.polynomial.polynomial.polyfit(at, rows, _FALL_OFF_DEGREE)
    without = float(np.sum((rows - np.polynomial.polynomial.polyval(at, smooth)) ** 2))
    if rows.size * (found.x[0] + 2.0 * u) < 2.0 or noise > (1.0 - _PERIODIC_SHARE) * without:
        return unknown
    shadings = [(at_one[0], 1.0 + powers @ at_one[1:]) for at_one in (found.x, *(found.x + one for one in off))]
    return (
        tuple(
            Waveform(rows / one * (one.mean() / rows.mean()), 1.0, "", period=Period(cycles, u, 1.0))
            for cycles, one in shadings
            if np.all(one > 0.0)
        )
        or unknown
    )


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
            found_hz, held = _refined(light, rate_hz, near_hz)
            if found_hz * duration_s < fewest:
                continue
            if best_hz == 0.0 or 1.0 - held < 0.5 * (1.0 - share) - _LEAST_SHARE:
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


def line_noise(amplitude: Array, samples: int) -> float:
    """Return the standard deviation of a sample of white noise, from the amplitudes of its `spectrum`.

    Behind a Hann window their mean square is 6σ²/n; the median of their squares is ln 2 of that (exponential).
    """
    return math.sqrt(float(np.median(amplitude**2)) / math.log(2.0) * samples / 6.0)


def _excerpt(waveform: Waveform, line_hz: float) -> tuple[float, Array]:
    """Return rate in Hz and light of a part that suffices to find a line: means of samples, the first periods."""
    together = max(1, int(waveform.rate_hz / (4 * _MOST_HARMONICS * line_hz)))
    whole = waveform.light.size // together
    light = waveform.light[: whole * together].reshape(whole, together).mean(axis=1)[:_MOST_SAMPLES]
    return waveform.rate_hz / together, light - light.mean()


def harmonic_columns(phase: Array, order: int) -> Array:
    """Return 1, the cosines and the sines up to an order over phases in periods, shape (phases, 1 + 2·order)."""
    angles = 2.0 * np.pi * np.outer(phase, np.arange(1, order + 1))
    return np.hstack([np.ones((phase.size, 1)), np.cos(angles), np.sin(angles)])


def _refined(light: Array, rate_hz: float, near_hz: float) -> tuple[float, float]:
    """Return the fundamental frequency in Hz near another, and the share of the variance that it explains."""
    time_s = np.arange(light.size) / rate_hz
    order = max(1, min(_MOST_HARMONICS, int(0.45 * rate_hz / near_hz)))

    def unexplained(frequency_hz: float) -> float:
        columns = harmonic_columns(frequency_hz * time_s, order)
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
    return (waveform, 0) if count < 1 else (waveform.cut(min(samples, waveform.light.size)), count)

"""A waveform of light over time: read from a table, or from the rows of a rolling-shutter frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.fft import next_fast_len, rfft, rfftfreq
from scipy.optimize import minimize_scalar

from radiometer.data.statements import StatementMap
from radiometer.data.text_table import finite, read_table
from radiometer.errors import InputError
from radiometer.typing import Array

FEWEST_SAMPLES: Final = 32
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

    @property
    def duration_s(self) -> float:
        """Return samples over rate in s."""
        return self.light.size / self.rate_hz

    def cut(self, samples: int) -> Waveform:
        """Return its first samples."""
        return replace(self, light=self.light[:samples])


def read_waveform(
    path: Path,
    dark: float | None = None,
    u_dark: float = 0.0,
    mapped: StatementMap | None = None,
    averaged_s: float = 0.0,
) -> tuple[Waveform, tuple[str, ...]]:
    """Return the waveform in a table of time and light, and what is reported about the reading.

    Arguments are as for `radiometer.flicker`. Without a heading column 1 is the time in s, column 2 the light.

    Raises:
        InputError: If the table cannot be read, or its times do not rise in equal steps.
        UnsettledError: If a heading gives the time without a unit.
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
    """Return the rate of times that rise in equal steps.

    Args:
        path: The table, for messages.
        time_s: Times in s, shape (n,).
        written: Step of the decimals in which the times are written, and their span, in one unit.
    """
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
    pixels: Array,
    row_time_s: float,
    exposure_s: float,
    origin: str,
    black_dn: float,
    flat: Array | None = None,
    u_black_dn: float = 0.0,
) -> Waveform:
    """Return the waveform that the rows of a rolling-shutter frame sample one after the other.

    Arguments are as for `radiometer.flicker`; `pixels` are digital numbers, shape (rows, columns), `flat` likewise.

    Raises:
        InputError: If times or shapes do not fit.
    """
    if not (row_time_s > 0.0 and exposure_s > 0.0):
        raise InputError("row time and exposure must be above 0 s")
    rows = pixels.mean(axis=1) - black_dn
    if rows.size < FEWEST_SAMPLES:
        raise InputError(f"{origin}: {rows.size} rows; a waveform needs {FEWEST_SAMPLES}")
    assumptions = []
    if flat is not None:
        if flat.shape != pixels.shape:
            raise InputError(f"{origin}: {pixels.shape} pixels, the flat has {flat.shape}")
        shading = flat.mean(axis=1) - black_dn
    else:
        at = np.linspace(-1.0, 1.0, rows.size)
        shading = np.polyval(np.polyfit(at, rows, 2), at)
        assumptions.append("the fall-off over the rows is a parabola; --flat FILE of steady light measures it")
    if np.any(shading <= 0.0):
        raise InputError(f"{origin}: rows at or below the black level {black_dn:g} DN; state the right --black-level")
    light = rows / shading
    return Waveform(
        light, 1.0 / row_time_s, origin, u_black_dn / float(np.mean(shading)), exposure_s, tuple(assumptions)
    )


@dataclass(frozen=True, slots=True)
class Period:
    """The repetition of a waveform."""

    frequency_hz: float  # its fundamental frequency
    u_hz: float  # standard uncertainty of it
    share: float  # part of the variance that the fundamental and its harmonics hold


def find_period(waveform: Waveform) -> Period | None:
    """Return the repetition of a waveform by least squares of harmonics; None where there is none.

    The frequency is the one whose fundamental and harmonics hold most of the variance. It is that of the strongest
    line unless another halves what is not explained: a half or a third of it, or the lowest line about as strong.
    The harmonics of a short pulse are all alike. The uncertainty is the bound for a sinusoid in white
    noise, u² = 6σ²·rate²/(π²·A²·n³) with the amplitude A (Rife and Boorstyn 1974).
    """
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
        if near_hz * duration_s >= 2.0:  # fewer periods show no repetition
            found_hz, held = _refined(light, rate_hz, near_hz)
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
    light = (waveform.light - waveform.light.mean()) * np.hanning(waveform.light.size)
    padded = next_fast_len(4 * light.size, real=True)
    power = np.abs(rfft(light, padded)) ** 2
    frequency_hz = rfftfreq(padded, 1.0 / waveform.rate_hz)
    power[frequency_hz * waveform.duration_s < 1.5] = 0.0  # the width of the window's own line
    if not power.any():
        return []
    strongest = int(np.argmax(power))
    lowest = int(np.argmax(power >= _ALIKE * power[strongest]))
    while lowest < strongest and power[lowest + 1] > power[lowest]:
        lowest += 1
    return [float(frequency_hz[at]) for at in dict.fromkeys((strongest, lowest))]


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
    count = int(waveform.duration_s * period.frequency_hz + 0.5 * period.frequency_hz / waveform.rate_hz + 1e-6)
    samples = round(count / period.frequency_hz * waveform.rate_hz)
    return (waveform, 0) if count < 1 else (waveform.cut(min(samples, waveform.light.size)), count)

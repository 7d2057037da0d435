"""Measures of temporal light modulation with their uncertainty: depth, index, frequency, SVM and PstLM.

Source: CIE TN 012:2021 and IEEE 1789-2015 (modulation depth, flicker index), IEC TR 63158:2018 (SVM), IEC TR
61547-1:2020 (PstLM).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq
from scipy.signal import butter, resample_poly
from scipy.stats import t as student_t

from radiometer.analysis.flicker.shape import LEAST_KEPT, ShapeMeasures, measure_record, measure_shape, other_line
from radiometer.analysis.flicker.waveform import Period, Waveform, find_period, whole_periods
from radiometer.data import Quantity
from radiometer.errors import MeasurementError
from radiometer.statistics.scale import jackknife_u
from radiometer.typing import Array

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
# Rounding to steps is alike in every period, so no scatter shows it: it is drawn, if values occur four times or more.
_OCCURRENCES: Final = 4
_FEWEST_CODES: Final = 4  # light of two or three levels need not be rounded
_DRAWS: Final = 6
_LATTICE: Final = 1e-4  # of a step, to which differences of rounded values are multiples of it
_NO_STEP: Final = 1e-4  # of the range: what finer steps move is nothing
_SAME_REL: Final = 1e-9  # of the range: values that are written alike
_LEAST_MEAN: Final = 0.01  # of the mean of absolute values, to which light, never below 0, is equal but for noise
_COVERAGE: Final = 0.9545  # of the expanded uncertainty


@dataclass(frozen=True, slots=True)
class Flicker:
    """How light is modulated in time."""

    frequency: Quantity | None  # dominant frequency in Hz; None where nothing repeats beyond noise
    modulation_depth: Quantity  # (max − min)/(max + min), also called percent flicker
    flicker_index: Quantity  # area above the mean over the whole area of a period
    svm: Quantity | None  # stroboscopic visibility measure; None where the record cannot give it
    pst_lm: Quantity | None  # short-term flicker severity of light; None where the record cannot give it
    # k of the expanded uncertainty at 95.45 %: Student's t for the blocks whose scatter was taken
    coverage_factor: float
    periods: int  # whole periods that took part; 0 where there is no period
    assumptions: tuple[str, ...]  # what was assumed, a sentence each
    warnings: tuple[str, ...]  # what makes a figure doubtful, a sentence each


def measure_flicker(waveform: Waveform, u_clock_rel: float | None = None) -> Flicker:
    """Return the measures of a waveform with their standard uncertainty.

    Args:
        waveform: Light over time.
        u_clock_rel: Relative standard uncertainty of its rate; None where nothing states it, which is named.

    The scatter between blocks of whole periods gives the statistical part, by leaving out one block at a time. Where
    the light is rounded to steps, each value may be any light within half a step (rectangular, GUM 4.3.7). The
    value of darkness adds u_dark over the mean light, for it scales every modulation.

    Raises MeasurementError if the mean light is not above 0, as that of an AC-coupled record.
    """
    mean = float(waveform.light.mean())
    if not mean > _LEAST_MEAN * float(np.abs(waveform.light).mean()):
        raise MeasurementError(
            f"{waveform.origin}: the mean light is {mean:.4g}, not above 0 by {100 * _LEAST_MEAN:g} % of its values; "
            "record it without AC coupling, or state the value of darkness by --dark"
        )
    period = find_period(waveform)
    part, periods = whole_periods(waveform, period)
    blocks = max(2, min(_MOST_BLOCKS, periods)) if periods > 1 else 0
    assumptions, warnings = list(waveform.assumptions), list[str]()
    shape, remark = _shape(waveform, period if periods else None)
    (assumptions if shape.blocks else warnings).append(remark.format(periods=periods))
    u_dark_rel = waveform.u_dark / mean

    def with_dark(one: Quantity) -> Quantity:
        return Quantity(one.value, math.hypot(one.u, abs(one.value) * u_dark_rel), "1")

    def with_u(of: Callable[[Waveform, Period | None], float]) -> Quantity:
        value = of(part, period)
        doubts = [of(one, again) - value for one, again in doubted]
        u = math.hypot(_jackknife(of, part, period, blocks, periods), _spread([of(one, period) for one in rounded]))
        return with_dark(Quantity(value, math.hypot(u, *doubts), "1"))

    rounded = _rounded(part)
    warnings += _sampling_warnings(part)
    doubted = [(one, find_period(one)) for one in waveform.others]
    shapes = [_shape(one, period if periods else None)[0] for one in rounded]
    off = [_shape(one, again if periods else None)[0] for one, again in doubted]

    depth, index = (with_dark(_doubted(name, shape, shapes, off)) for name in ("modulation_depth", "flicker_index"))
    if depth.value - 2.0 * depth.u > 1.0:
        warnings.append("the light falls below the value of darkness: state that value by --dark")
    svm = pst = None
    if waveform.rate_hz < 2.0 * _SVM_BAND_HZ[1]:
        warnings.append(
            f"SVM is not determined: it needs {2.0 * _SVM_BAND_HZ[1]:g} samples per s, the record has "
            f"{waveform.rate_hz:.4g}"
        )
    elif not periods and not waveform.others:
        warnings.append(
            "SVM is not determined: no repetition was found, so that its uncertainty is unknown; the record gives "
            f"{stroboscopic_visibility(part):.2g}, noise included"
        )
    else:
        svm = with_u(stroboscopic_visibility)
        other = stroboscopic_visibility(part, period, power_law_threshold)
        assumptions.append(f"SVM: thresholds of CIE TN 006:2016; those of Perz et al. 2018 give {other:.3g}")
        if waveform.duration_s < 1.0:
            assumptions.append(f"SVM: the light goes on after {waveform.duration_s:.3g} s as it did before")
    if waveform.rate_hz < _PST_RATE_HZ:
        warnings.append(
            f"PstLM is not determined: it needs {_PST_RATE_HZ:g} samples per s, the record has {waveform.rate_hz:.4g}"
        )
    elif waveform.duration_s < 3 * _PST_TRANSIENT_S and not periods:
        warnings.append(f"PstLM is not determined: the record has {waveform.duration_s:.3g} s and no repetition")
    else:
        pst = with_u(short_term_severity)
        pst, doubts = _with_noise(pst, part, period)
        warnings += doubts
        if waveform.duration_s < 3 * _PST_TRANSIENT_S:
            assumptions.append(f"PstLM: the light goes on after {waveform.duration_s:.3g} s as it did before")
    warnings += _averaging_warnings(waveform, period, shape)
    frequency, unstated = _frequency(period, u_clock_rel)
    assumptions += unstated
    k = float(student_t.ppf(0.5 + _COVERAGE / 2.0, blocks - 1)) if blocks else 2.0
    return Flicker(frequency, depth, index, svm, pst, k, periods, tuple(assumptions), tuple(warnings))


def _frequency(period: Period | None, u_clock_rel: float | None) -> tuple[Quantity | None, list[str]]:
    """Return the frequency of a period, and what its uncertainty leaves out."""
    if period is None:
        return None, []
    u_hz = math.hypot(period.u_hz, period.frequency_hz * (u_clock_rel or 0.0))
    unstated = "frequency: an error of the record's clock is in no uncertainty; state it by --u-clock"
    return Quantity(period.frequency_hz, u_hz, "Hz"), [unstated] if u_clock_rel is None else []


def _doubted(name: str, shape: ShapeMeasures, drawn: Sequence[ShapeMeasures], off: Sequence[ShapeMeasures]) -> Quantity:
    """Return a measure of a shape, with what shapes that were drawn spread, and those one u off differ, in u."""
    one: Quantity = getattr(shape, name)
    doubts = [getattr(other, name).value - one.value for other in off]
    return Quantity(
        one.value, math.hypot(one.u, _spread([getattr(other, name).value for other in drawn]), *doubts), "1"
    )


def _with_noise(pst: Quantity, part: Waveform, period: Period | None) -> tuple[Quantity, list[str]]:
    """Return PstLM with the noise of the record in u, and a warning where that is much.

    The measure squares what it sees, so noise adds to it; whether that is of the light, a record cannot show.
    """
    quietest = math.sqrt(max(pst.value**2 - noise_severity(part, period) ** 2, 0.0))
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
    widened = [
        Quantity(one.value, math.hypot(one.u, amplitude), "1") for one in (shape.modulation_depth, shape.flicker_index)
    ]
    if record.modulation_depth.u < widened[0].u:
        return record, f"{found}modulation depth and flicker index are of the whole record"
    return replace(shape, modulation_depth=widened[0], flicker_index=widened[1]), (
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


def power_law_threshold(frequency_hz: Array) -> Array:
    """Return a later fit of that threshold: 1.4 % above at 100 Hz, 16 % below at 400 Hz, and above 1 from 750 Hz.

    Source: Perz et al. 2018, J. Opt. Soc. Am. A 35, 309: T = 2.865e-5·(f/Hz)^1.543 + 0.225.
    """
    return np.asarray(2.865e-5 * np.power(frequency_hz, 1.543) + 0.225)


def stroboscopic_visibility(
    waveform: Waveform, period: Period | None = None, threshold: Callable[[Array], Array] = svm_threshold
) -> float:
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
    within = (frequency_hz >= _SVM_BAND_HZ[0]) & (frequency_hz <= _SVM_BAND_HZ[1])
    kept = np.abs(np.sinc(frequency_hz[within] * part.averaged_s))  # numpy's sinc holds the π
    seen = amplitude[within] / np.where(kept < LEAST_KEPT, 1.0, kept)
    return float(np.sum((seen / threshold(frequency_hz[within])) ** _SVM_EXPONENT) ** (1.0 / _SVM_EXPONENT))


def short_term_severity(waveform: Waveform, period: Period | None = None) -> float:
    """Return PstLM, the short-term flicker severity of a light waveform.

    The relative light passes a band-pass of 0.05 to 35 Hz and the eye's weighting, is squared and smoothed over 0.3 s;
    percentiles of the result give the severity. The filters have their analogue responses: digital ones of 2 kHz are
    off by 4 % at 120 Hz. A record below a minute repeats by whole periods; of a longer one the first 20 s are left out.
    """
    light, rate_hz, transient = _for_severity(waveform, period)
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
    """Return the PstLM that white noise has at most (k = 2), of the density that the record has between its lines.

    Noise of that density is drawn and measured. The density is the median of the periodogram above the band of the
    measure (exponential distribution, mean = median/ln 2), with a Hann window against leakage of the lines.
    """
    light, rate_hz, _ = _for_severity(waveform, period)
    frequency_hz, window = rfftfreq(light.size, 1.0 / rate_hz), np.hanning(light.size)
    power = np.abs(rfft((light / light.mean() - 1.0) * window)) ** 2 / np.mean(window**2)
    between = power[(frequency_hz > _PST_BAND_HZ[1]) & (frequency_hz < rate_hz / 4.0)]
    if between.size < _FEWEST_LINES:
        return 0.0
    sigma, rng = math.sqrt(float(np.median(between)) / math.log(2.0) / light.size), np.random.default_rng(0)
    drawn = [
        short_term_severity(Waveform(1.0 + rng.normal(0.0, sigma, light.size), rate_hz, waveform.origin)) ** 2
        for _ in range(_MOST_BLOCKS)
    ]
    return math.sqrt(float(np.mean(drawn)) + 2.0 * float(np.std(drawn, ddof=1)))


def _for_severity(waveform: Waveform, period: Period | None) -> tuple[Array, float, int]:
    """Return light, rate in Hz, at 2 to 4 kHz where it is long, and how many samples the filters settle in."""
    if waveform.duration_s < 3 * _PST_TRANSIENT_S:
        part = whole_periods(waveform, period)[0]
        return part.light, part.rate_hz, 0
    down = max(1, int(waveform.rate_hz / _PST_RATE_HZ))
    light = waveform.light if down == 1 else resample_poly(waveform.light, 1, down, padtype="mean")
    rate_hz = waveform.rate_hz / down
    return light, rate_hz, round(_PST_TRANSIENT_S * rate_hz)


def _jackknife(
    of: Callable[[Waveform, Period | None], float], part: Waveform, period: Period | None, blocks: int, periods: int
) -> float:
    """Return the standard uncertainty of a measure by leaving out one block of whole periods at a time."""
    edges = np.round(np.linspace(0, periods, blocks + 1)) * part.light.size / periods
    values = []
    for first, last in zip(edges[:-1].round().astype(int), edges[1:].round().astype(int), strict=True):
        left = np.concatenate([part.light[:first], part.light[last:]])
        values.append(of(Waveform(left, part.rate_hz, part.origin, averaged_s=part.averaged_s), period))
    return float(jackknife_u(values).item())


def _sampling_warnings(waveform: Waveform) -> list[str]:
    """Return what slow samples or few values hide."""
    found = []
    if waveform.rate_hz < 2.0 * _SVM_BAND_HZ[1]:
        found.append(
            f"modulation above {waveform.rate_hz / 2.0:.4g} Hz shows at a wrong frequency, a lower one: the record has "
            f"{waveform.rate_hz:.4g} samples per s"
        )
    if np.unique(waveform.light).size == _FEWEST_CODES - 1:
        found.append("the light takes three values only: if they are rounded, no uncertainty covers that")
    return found


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


def _spread(values: list[float]) -> float:
    return float(np.std(values, ddof=1)) if values else 0.0


def _averaging_warnings(waveform: Waveform, period: Period | None, shape: ShapeMeasures) -> list[str]:
    """Return what averaging over the exposure of each sample hides."""
    if period is None or waveform.averaged_s <= 0.0:
        return []
    kept = abs(float(np.sinc(period.frequency_hz * waveform.averaged_s)))
    if kept > 0.99:
        return []
    averaged = (
        f"each sample averages over {1e3 * waveform.averaged_s:.3g} ms and keeps {100 * kept:.0f} % of the amplitude "
        f"at {period.frequency_hz:.4g} Hz: "
    )
    if shape.is_series and kept >= LEAST_KEPT:
        return [
            f"{averaged}modulation depth, flicker index and SVM are corrected for it; faster light may be "
            "hidden, so take a shorter exposure"
        ]
    bounded = "modulation depth and flicker index" if kept >= LEAST_KEPT else "modulation depth, flicker index and SVM"
    return [f"{averaged}{bounded} are lower bounds; take a shorter exposure"]

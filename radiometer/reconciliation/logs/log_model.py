"""Predicts a camera's value from a reference's light, and lists the terms that may be missing.

value = s·(1 + a·s/s̄) + b,  s = R·(L + L₀)·(t + δ)·10^(G/20)·c(colour, T, gain) + D·t·10^(G/20)·2^((T − 25 °C)/θ)

R is the responsivity; each term is off at zero. Terms bear the names of the catalogue of effects.

Terms that follow the signal (b, a) or the reference (L₀) need care, for both are known with errors. Automatic exposure
keeps the value constant: clouds, which the reference does not see, change the predicted signal and not the measured
one. At the longest exposure it is the other way round. Such a term is therefore fitted twice: with the signal as
predicted and with the signal as measured. The truth is between the two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.polynomial.legendre import legvander

from radiometer.importing.log_table import LogTable
from radiometer.typing import Array

SIGNAL: Final = "signal"
MEASURED_TOO: Final = (SIGNAL, "reference")
"""Columns that the reference predicts, with its errors. What acts along them is fitted along the measured ones too."""

_STEP: Final = 1e-5  # of a parameter's scale, for differences
_DARK_AT_C: Final = 25.0
DOUBLING_K: Final = 6.5
"""Warming in K that doubles a dark current, where its fit begins: 5 K to 9 K are usual for silicon."""

_LEAST_DOUBLING_K, _MOST_DOUBLING_K = 3.0, 20.0
_LARGEST_LOG: Final = 200.0  # limit of ln(signal) while a step is tried, far beyond any camera
_NEAR_DB: Final = 0.05  # gains that differ less are one
_MOST_GAINS: Final = 12
_LEAST_CORRELATION: Final = 0.5  # of a column as predicted and as measured: there scatter and variation are equal
_DEGREE: Final = 3  # of a trend without a name: a bend that changes its sign once


Act = Callable[[LogTable, "_Light", Array], None]


@dataclass(frozen=True, slots=True)
class LogTerm:
    """One term that may be missing."""

    name: str  # name of the effect
    where: str  # column along which it acts
    parameters: tuple[str, ...]  # names of its parameters
    units: tuple[str, ...]  # their units
    # Size of each that makes a difference of about 1 % somewhere; also the step of differences
    scales: tuple[float, ...]
    act: Act  # changes the parts of the predicted light by its parameters
    flexible: bool = False  # whether it is the flexible form of another one of the same name
    start: tuple[float, ...] = ()  # where their fit begins; zeros by default

    @property
    def begins(self) -> Array:
        """Return where the fit of its parameters begins."""
        return np.array(self.start or (0.0,) * self.size)

    @property
    def size(self) -> int:
        """Return the number of its parameters."""
        return len(self.parameters)


@dataclass(slots=True)
class _Light:
    """The parts of a predicted value that terms change, per reading."""

    radiance: Array  # L, in the reference's unit
    leak: float  # L₀, in the same unit
    exposure_s: Array
    log_factor: Array  # ln of what multiplies the light
    dark: Array  # D·t·G in DN over R·… (added to s, not multiplied by R)
    offset_dn: Array
    curvature: float = 0.0  # per DN


def amplitude(log: LogTable) -> float:
    """Return the typical value in DN, the scale of a nonlinearity."""
    return float(np.median(log.value))


def predicted_log(log: LogTable, terms: Sequence[LogTerm], parameters: Array, *, measured: bool = False) -> Array:
    """Return ln of the predicted values.

    Args:
        terms: The terms that are there.
        parameters: ln R, then theirs in order.
        measured: Take the signal that bends, offsets and leaks act on from the values as measured.

    Returns:
        (readings,) ln of the values; NaN where the parameters leave no light or no value to take a logarithm of.
    """
    size = log.size
    light = _Light(log.reference, 0.0, log.exposure_s.copy(), np.zeros(size), np.zeros(size), np.zeros(size))
    at = 1
    for term in terms:
        term.act(log, light, parameters[at : at + term.size])
        at += term.size
    gain = 10.0 ** (log.gain_db / 20.0)
    level = np.clip(parameters[0] + light.log_factor, -_LARGEST_LOG, _LARGEST_LOG)
    per_radiance = np.exp(level) * light.exposure_s * gain
    if measured:
        straight = log.value - light.offset_dn
        straight = straight / _positive(1.0 + light.curvature * straight)
        rest = _positive(straight - per_radiance * light.leak)
        signal = per_radiance * light.radiance + light.dark * gain
        return np.asarray(np.log(_positive(signal)) + np.log(log.value) - np.log(rest))
    signal = per_radiance * (light.radiance + light.leak) + light.dark * gain
    bent = _positive(signal) * (1.0 + light.curvature * signal) + light.offset_dn
    return np.asarray(np.log(_positive(bent)))


def _positive(values: Array) -> Array:
    """Return the values, NaN for those that are not positive: parameters that give them describe no camera."""
    return np.where(values > 0.0, values, np.nan)


def jacobian(log: LogTable, terms: Sequence[LogTerm], parameters: Array, *, measured: bool = False) -> Array:
    """Return ∂ ln(value)/∂(parameter) by central differences, (readings, 1 + parameters)."""
    scales = np.concatenate([[1.0], *([term.scales] for term in terms)], axis=None)
    columns = []
    for index, scale in enumerate(scales):
        step = np.zeros(scales.size)
        step[index] = _STEP * scale
        ahead, behind = (predicted_log(log, terms, parameters + sign * step, measured=measured) for sign in (1.0, -1.0))
        columns.append((ahead - behind) / (2.0 * _STEP * scale))
    return np.column_stack(columns)


def catalogue(log: LogTable) -> tuple[LogTerm, ...]:
    """Return the terms that these columns can show; one whose column is missing or does not vary is left out."""
    value, unit = amplitude(log), (log.units or {}).get("reference", "1")
    light, exposure = float(np.median(log.reference)), float(np.min(log.exposure_s))
    gain = float(np.median(10.0 ** (log.gain_db / 20.0)))
    found = [
        LogTerm("black_level_offset", SIGNAL, ("offset_dn",), ("DN",), (0.01 * value,), _black),
        LogTerm("ambient_light_leak", "reference", ("constant",), (unit,), (0.01 * light,), _ambient),
        LogTerm("response_nonlinearity", SIGNAL, ("a2",), ("1",), (0.01,), _curvature(value)),
    ]
    if _varies(np.log(log.exposure_s)):
        found.append(LogTerm("exposure_time_offset", "exposure", ("offset_s",), ("s",), (0.01 * exposure,), _exposure))
    if _varies(log.gain_db):
        found += _gain_terms(log)
    if log.temperature_c is not None and _varies(log.temperature_c):
        mean_c = float(np.mean(log.temperature_c))
        found.append(
            LogTerm(
                "quantum_efficiency_temperature", "temperature", ("per_K",), ("K-1",), (0.001,), _temperature(mean_c)
            )
        )
        dark = 0.01 * value / float(np.median(log.exposure_s)) / gain
        names, units = ("dark_at_25C_dn_per_s", "doubling_K"), ("DN s-1", "K")
        found.append(
            LogTerm("dark_current", "temperature", names, units, (dark, 0.02), _dark, False, (dark, DOUBLING_K))
        )
    if log.colour is not None and _varies(log.colour):
        per = (log.units or {}).get("colour", "1")
        spread = 0.01 / float(np.std(log.colour))
        unit_of = "1" if per == "1" else f"{per}-1"
        found.append(
            LogTerm(
                "spectral_mismatch",
                "colour",
                ("per_colour",),
                (unit_of,),
                (spread,),
                _colour(float(np.mean(log.colour))),
            )
        )
    return tuple(found)


def _varies(values: Array) -> bool:
    return float(np.ptp(values)) > 1e-6


def _gain_terms(log: LogTable) -> list[LogTerm]:
    levels = gain_levels(log)
    terms = [LogTerm("gain_step_error", "gain", ("per_dB",), ("dB-1",), (0.001,), _gain_law(levels[0]))]
    if 2 < len(levels) <= _MOST_GAINS:
        names = tuple(f"at_{level:.1f}dB" for level in levels[1:])
        ones = tuple("1" for _ in names)
        terms.append(
            LogTerm("gain_step_error", "gain", names, ones, (0.01,) * len(names), _gain_table(levels), flexible=True)
        )
    return terms


def gain_levels(log: LogTable) -> list[float]:
    """Return the gains in dB, the one of most readings first: the others are relative to it."""
    rounded = np.round(log.gain_db / _NEAR_DB) * _NEAR_DB
    levels, counts = np.unique(rounded, return_counts=True)
    most = float(levels[np.argmax(counts)])
    return [most, *(float(level) for level in levels if level != most)]


def _black(log: LogTable, light: _Light, own: Array) -> None:
    light.offset_dn = light.offset_dn + own[0]


def _ambient(log: LogTable, light: _Light, own: Array) -> None:
    light.leak += float(own[0])


def _curvature(typical_dn: float) -> Act:
    def act(log: LogTable, light: _Light, own: Array) -> None:
        light.curvature = light.curvature + float(own[0]) / typical_dn

    return act


def _exposure(log: LogTable, light: _Light, own: Array) -> None:
    light.exposure_s = light.exposure_s + own[0]


def _gain_law(most_db: float) -> Act:
    def act(log: LogTable, light: _Light, own: Array) -> None:
        light.log_factor = light.log_factor + own[0] * (log.gain_db - most_db)

    return act


def _gain_table(levels: Sequence[float]) -> Act:
    def act(log: LogTable, light: _Light, own: Array) -> None:
        for level, step in zip(levels[1:], own, strict=True):
            light.log_factor = light.log_factor + step * (np.abs(log.gain_db - level) <= _NEAR_DB)

    return act


def _temperature(mean_c: float) -> Act:
    def act(log: LogTable, light: _Light, own: Array) -> None:
        assert log.temperature_c is not None
        light.log_factor = light.log_factor + own[0] * (log.temperature_c - mean_c)

    return act


def _dark(log: LogTable, light: _Light, own: Array) -> None:
    assert log.temperature_c is not None
    doubling = min(max(float(own[1]), _LEAST_DOUBLING_K), _MOST_DOUBLING_K)
    warm = 2.0 ** ((log.temperature_c - _DARK_AT_C) / doubling)
    light.dark = light.dark + own[0] * log.exposure_s * warm


def _colour(mean: float) -> Act:
    def act(log: LogTable, light: _Light, own: Array) -> None:
        assert log.colour is not None
        light.log_factor = light.log_factor + own[0] * (log.colour - mean)

    return act


def axes(log: LogTable, *, measured: bool = False) -> Mapping[str, Array]:
    """Return each column on a scale from −1 to 1, for trends without a name.

    Args:
        measured: Take signal and reference from the values as measured, not from the reference.
    """
    per_reference = np.log(log.exposure_s) + log.gain_db * math.log(10.0) / 20.0
    reference = np.log(log.value) - per_reference if measured else np.log(log.reference)
    raw: dict[str, Array | None] = {
        SIGNAL: reference + per_reference,
        "reference": reference,
        "exposure": np.log(log.exposure_s),
        "gain": log.gain_db,
        "temperature": log.temperature_c,
        "colour": log.colour,
        "time": log.time_s,
    }
    found = {}
    for name, values in raw.items():
        if values is not None and _varies(values):
            low, high = float(values.min()), float(values.max())
            found[name] = np.asarray(2.0 * (values - low) / (high - low) - 1.0)
    return found


def is_lost_in_scatter(log: LogTable, name: str) -> bool:
    """Return whether a column varies by less than its readings scatter: nothing can be shown along it."""
    if name not in MEASURED_TOO:
        return False
    predicted, measured = (axes(log, measured=way).get(name) for way in (False, True))
    if predicted is None or measured is None:
        return True
    return float(np.corrcoef(predicted, measured)[0, 1]) < _LEAST_CORRELATION


def trend(log: LogTable, name: str, *, measured: bool = False) -> Array:
    """Return the columns of a free curve along a column, (readings, degree)."""
    return np.asarray(legvander(axes(log, measured=measured)[name], _DEGREE)[:, 1:])

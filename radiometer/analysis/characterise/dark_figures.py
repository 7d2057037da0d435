"""Figures from dark frames alone: the typical pixel's dark current, its doubling, and the gain from its shot noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from radiometer.analysis.characterise.dark_signal import by_temperature, doubling_temperature, pooled_frame_sd
from radiometer.analysis.characterise.dark_transfer import DarkTransfer, dark_transfer
from radiometer.analysis.characterise.group_statistics import GroupStatistics
from radiometer.analysis.characterise.line_fit import fit_line
from radiometer.analysis.characterise.subject import Subject
from radiometer.data import Quantity

_MOST_PIXELS: Final = 250_000
_MOST_FRAMES: Final = 64
_LEAST_SPAN_DN: Final = 2.0  # of the typical dark signal: less shows no shot noise
_FINEST_TEMPERATURE_K: Final = 0.05


def typical_rates(dark: Sequence[GroupStatistics]) -> list[tuple[float | None, float, Quantity]]:
    """Return (temperature in °C, its standard uncertainty in K, dark current in DN/s) of each plateau of temperature.

    The typical pixel's mean is used: a few hot pixels with another doubling hold much of the mean of all. The
    temperature is known to a step of its readings.

    Args:
        dark: Dark groups of one gain and region.
    """
    found = []
    for plateau in by_temperature(dark):
        times = np.array([d.settings.exposure_s for d in plateau])
        if np.unique(times).size < 2:
            continue
        means = np.array([d.mean_dn if d.typical_dn is None else d.typical_dn for d in plateau])
        common = pooled_frame_sd(plateau)
        u = np.array([max(d.u_mean_dn, common / math.sqrt(d.frames)) for d in plateau])
        line = fit_line(times, means, u)
        known = [d.settings.temperature_c for d in plateau if d.settings.temperature_c is not None]
        # Two exposures leave no degree of freedom to see scatter by.
        rate = Quantity(line.slope, line.u_slope, "DN/s")
        # The rate is that of the long exposures, and so is its temperature.
        centre = float(np.average(known, weights=times)) if len(known) == len(times) else None
        found.append((centre, _temperature_u(known), rate))
    return found


def typical_dark_current(
    dark: Sequence[GroupStatistics], temperature_c: float | None, K: Quantity | None
) -> dict[str, Quantity]:
    """Return the typical pixel's dark current nearest a temperature, in e-/s or (without K) DN/s, and its doubling.

    Args:
        dark: Dark groups of one gain and region.
        temperature_c: Temperature of the bright frames in °C; None for the warmest.
        K: Overall system gain in DN/e-.
    """
    rates = typical_rates(dark)
    if not rates:
        return {}
    wanted = math.inf if temperature_c is None else temperature_c
    rate = min(rates, key=lambda r: abs((r[0] if r[0] is not None else 0.0) - min(wanted, 1e3)))[2]
    figures = {"mu_I_dn": rate}
    if K is not None:
        u = math.hypot(rate.u, rate.value * K.u_rel) / K.value
        figures = {"mu_I_typical": Quantity(rate.value / K.value, u, "e-/s")}
    doubling = doubling_of(rates)
    return figures | ({"T_d": doubling} if doubling else {})


def _temperature_u(known: Sequence[float]) -> float:
    """Return the standard uncertainty of a plateau's temperature: the step of its readings, taken as rectangular."""
    steps = np.diff(np.unique(np.round(known, 3)))
    return max(float(steps.max()) if steps.size else 0.0, _FINEST_TEMPERATURE_K) / math.sqrt(12.0)


def doubling_of(rates: Sequence[tuple[float | None, float, Quantity]]) -> Quantity | None:
    """Return the doubling temperature in K of dark currents at two plateaus or more; None where they do not determine
    it."""
    known = [(t, u, q) for t, u, q in rates if t is not None]
    return doubling_temperature([(t, q) for t, _, q in known], [u for _, u, _ in known])


def gain_from_darks(
    subject: Subject, dark: Sequence[GroupStatistics]
) -> tuple[Quantity, tuple[DarkTransfer, ...]] | None:
    """Return K in DN/e- from the dark frames of every plateau of temperature, with the transfers; None where too weak.

    What bends them is the same sensor at every temperature, so that the mean of several is known no better than the
    best of them.

    Args:
        subject: The frames.
        dark: Statistics of their dark groups at one gain, in the region that is looked at.
    """
    transfers = []
    if subject.given:
        return None  # statistics without pictures
    for plateau in by_temperature(dark):
        typical = [d.mean_dn if d.typical_dn is None else d.typical_dn for d in plateau]
        if len(plateau) < 3 or max(typical) - min(typical) < _LEAST_SPAN_DN:
            continue
        found = dark_transfer(_frames(subject, plateau))
        if found is not None:
            transfers.append(found)
    if not transfers:
        return None
    values, u = np.array([(t.K.value, t.K.u) for t in transfers]).T
    weights = u**-2 / np.sum(u**-2)
    mean = float(weights @ values)
    scatter = math.sqrt(float(weights @ (values - mean) ** 2))
    return Quantity(mean, math.hypot(float(u.min()), scatter if len(transfers) > 1 else 0.0), "DN/e-"), tuple(transfers)


def _frames(subject: Subject, plateau: Sequence[GroupStatistics]) -> list[np.ndarray]:
    """Return the frames of a plateau in its region, every n-th pixel of large ones."""
    wanted = {(d.settings.exposure_s, d.settings.temperature_c, d.settings.gain_db) for d in plateau}
    region = subject.regions[plateau[0].region]
    frames = []
    for group in subject.groups:
        key = (group.settings.exposure_s, group.settings.temperature_c, group.settings.gain_db)
        if not group.settings.is_dark or key not in wanted:
            continue
        for dn in group.read(subject.camera.full_scale_dn):
            part = dn if region is None else dn[region.slices]
            step = max(1, math.ceil(math.sqrt(part.size / _MOST_PIXELS)))
            frames.append(part[::step, ::step].astype(np.float64))
            if len(frames) >= _MOST_FRAMES:
                return frames
    return frames

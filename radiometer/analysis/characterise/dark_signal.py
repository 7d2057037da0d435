"""Figures from dark frames: temperature, the typical pixel's dark current, its doubling, the gain from its noise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.characterise.group_statistics import SAME_TEMPERATURE_K, GroupStatistics, mean_temperature_c
from radiometer.analysis.characterise.line_fit import Line, fit_line
from radiometer.analysis.characterise.subject import Subject
from radiometer.analysis.signal.model import FLOOR_SHARE
from radiometer.analysis.signal.rounding import PLAIN_FROM, SHEPPARD, unrounded_variance
from radiometer.data import CameraDescription, Quantity
from radiometer.data.sensor_noise import SensorNoise, most_dark_e_per_s
from radiometer.statistics.scale import robust_sigma, typical_pixels
from radiometer.units import gain_factor

_FEWEST_FRAMES: Final = 5  # fewer tell no scatter about a line of two parameters
_HIGHEST_LEVERAGE: Final = 0.9  # a frame above it decides its own fit, and shows no residual
_CLIP_SIGMAS: Final = 6.0  # one false alarm in 5·10⁸ normal values
_LARGEST_U_REL: Final = 0.2  # above it the dark current is too weak to tell the gain
_MOST_PIXELS: Final = 250_000  # a variance is then known to 0.3 %; more cost time alone
_MOST_FRAMES: Final = 64  # bounds the memory: 64 frames of 250,000 pixels are 128 MB
_MOST_OF_STATED: Final = 3.0  # of a data sheet's typical dark current: single sensors have up to so much
_LEAST_SPAN_DN: Final = 2.0  # of the typical dark signal: less shows no shot noise
_OF_DARKS: Final = ("mu_y_dark", "sigma_", "mu_e_min", "mu_p_min", "DR", "mu_I", "T_d", "DSNU")
_FINEST_TEMPERATURE_K: Final = 0.05  # rounding to a tenth: the finest that cameras state


@dataclass(frozen=True, slots=True)
class DarkSignal:
    """The dark signal of one temperature."""

    mean_line: Line | None  # mean in DN over exposure in s; None where all darks have one exposure
    variance_line: Line | None  # temporal variance in DN² over exposure in s; None where all darks have one exposure
    mean_dn: Quantity  # mean at exposure 0 with standard uncertainty in DN
    # Temporal variance at exposure 0 in DN²; where rounding hides the noise, the most that it can be
    variance_dn2: Quantity
    temperature_c: float | None  # mean sensor temperature; None where unknown
    quantisation_limited: bool  # the variance is below 0.24 DN², where rounding hides the noise
    noise_dn2: Quantity  # the variance before rounding to whole codes in DN²


def dark_signal(dark: Sequence[GroupStatistics], step_dn: int = 1) -> DarkSignal:
    """Return the dark signal of groups of one gain, region and temperature.

    Groups of one frame determine its mean only; those that hot pixels bend do not count.

    Args:
        dark: The groups; at least one of them with two frames or more.

    Source: EMVA Standard 1288, release 4.0, sections 6.7 and 7.
    """
    dark, mean_line = unbent(dark), None
    mean, line = level_at_0_s(dark, step_dn)
    if len({d.settings.exposure_s for d in dark}) > 2:
        mean_line = line
    variance_line, variance = _variance([d for d in dark if d.has_noise])
    smallest = PLAIN_FROM * step_dn**2
    limited = variance.value < smallest and variance.u < smallest
    least = min(dark, key=lambda d: d.settings.exposure_s)
    noise = unrounded_variance(variance.value, variance.u, mean.value, least.ordinary_variance_dn2, step_dn)
    if variance.value < smallest and not limited:  # long exposures leave the noise at 0 s open
        variance = Quantity(smallest, math.hypot(variance.u, smallest - variance.value), "DN^2")
    if limited:  # all that is known is a bound; over [0, bound] the root mean square distance from it is bound/√3
        variance = Quantity(smallest, smallest / math.sqrt(3.0), "DN^2")
    if variance.value == smallest:
        noise = Quantity(smallest - SHEPPARD * step_dn**2, variance.u, "DN^2")
    return DarkSignal(mean_line, variance_line, mean, variance, mean_temperature_c(dark), limited, noise)


def level_at_0_s(dark: Sequence[GroupStatistics], step_dn: int = 1) -> tuple[Quantity, Line | None]:
    """Return the mean at exposure 0 in DN and the line over exposure; that of one exposure, and None, where it is one.

    Args:
        dark: Groups of one gain, region and temperature; frames may be one each.
    """
    if len({d.settings.exposure_s for d in dark}) > 1:
        line = _mean_line(dark, [d.mean_dn for d in dark], step_dn)
        return Quantity(line.intercept, line.u_intercept, "DN"), line
    return Quantity(dark[0].mean_dn, float(_u_of_means(dark, step_dn)[0]), "DN"), None


def with_open_current(
    found: DarkSignal, dark: Sequence[GroupStatistics], K: Quantity | None, camera: CameraDescription
) -> DarkSignal:
    """Return the dark signal of one exposure, which may hold dark current, with that in u; that of several as it is.

    Arguments are as of `open_current_u_dn`; `found` is the dark signal of these groups.
    """
    u_dn = open_current_u_dn(dark, K, camera)
    mean = replace(found.mean_dn, u=math.hypot(found.mean_dn.u, u_dn))
    of_noise = 0.0 if K is None else K.value * u_dn
    variance, noise = (replace(one, u=math.hypot(one.u, of_noise)) for one in (found.variance_dn2, found.noise_dn2))
    return replace(found, mean_dn=mean, variance_dn2=variance, noise_dn2=noise)


def open_current_u_dn(dark: Sequence[GroupStatistics], K: Quantity | None, camera: CameraDescription) -> float:
    """Return the standard uncertainty in DN that dark current leaves in the level of one exposure; 0 of several.

    Its electrons are at most those that the camera may have, and all of the variance (shot noise, σ²/K²).

    Args:
        dark: Groups of one gain, region and temperature.
        K: Overall system gain in DN/e-; None takes the stated one; without any all may be dark signal.
    """
    one = dark[0]
    if len({d.settings.exposure_s for d in dark}) > 1:
        return 0.0
    gain = 0.0 if camera.conversion_gain_e_per_dn is None else 1.0 / camera.conversion_gain_e_per_dn
    gain = K.value if K is not None else gain * gain_factor(one.settings.gain_db)
    noise, exposure_s, here_c = SensorNoise.of(camera), one.settings.exposure_s, one.settings.temperature_c
    most_e = most_dark_e_per_s(camera, here_c) * exposure_s
    if "dark_current_e_per_s" not in noise.assumed:
        most_e = min(most_e, _MOST_OF_STATED * noise.dark_e(exposure_s, here_c))
    most_dn = min(gain * most_e, one.variance_dn2 / gain if one.has_noise else math.inf) if gain else one.mean_dn
    return max(most_dn, 0.0) / math.sqrt(3.0)  # over [0, most] the root mean square distance from an end


def unbent(dark: Sequence[GroupStatistics]) -> list[GroupStatistics]:
    """Return the groups in which no more pixels are saturated than in any: hot ones that fill up bend mean and noise.

    Where none of them has frames enough for a noise, all count.
    """
    least = min(d.clipped_share for d in dark)
    used = [d for d in dark if d.clipped_share <= least]
    return used if any(d.has_noise for d in used) else list(dark)


def _u_of_means(dark: Sequence[GroupStatistics], step_dn: int) -> NDArray[np.float64]:
    common = pooled_frame_sd(dark)
    noise = [max(d.u_mean_dn, common / math.sqrt(d.frames)) for d in dark]
    return np.hypot(noise, [d.u_of_rounding_dn(step_dn) for d in dark])


def _mean_line(dark: Sequence[GroupStatistics], means_dn: Sequence[float], step_dn: int) -> Line:
    """Return the line of means over exposure.

    Rounding errs alike at like means, so that more of them average none of it: its errors add up with the signs that
    move the line most (JCGM 100:2008, 5.2.2, note 1).
    """
    times = np.array([d.settings.exposure_s for d in dark])
    u = _u_of_means(dark, step_dn)
    line = fit_line(times, means_dn, u)
    rounding = np.array([d.u_of_rounding_dn(step_dn) for d in dark])
    weights = u**-2 / np.sum(u**-2)
    from_centre = times - weights @ times
    of_slope = weights * from_centre / (weights @ from_centre**2)
    of_intercept = weights - (weights @ times) * of_slope
    return replace(
        line,
        u_slope=max(line.u_slope, float(np.abs(of_slope) @ rounding)),
        u_intercept=max(line.u_intercept, float(np.abs(of_intercept) @ rounding)),
    )


def is_cut_off(dark: Sequence[GroupStatistics]) -> bool:
    """Return whether the camera cuts the noise of dark frames off at 0, so that their moments are not those of it."""
    return any(d.floor_share > FLOOR_SHARE for d in dark)


def determined(
    figures: Mapping[str, Quantity], dark: Sequence[GroupStatistics], notes: list[str], step_dn: int, *, is_hidden: bool
) -> dict[str, Quantity]:
    """Return the figures that dark frames determine where noise is cut off at 0 or rounding hides it; a note says why.

    Args:
        is_hidden: Rounding hides the temporal noise of the dark frames.
    """
    if is_cut_off(dark):
        notes.append(
            f"more than {100 * FLOOR_SHARE:g} % of the dark pixels are at 0, where noise is cut off: raise the "
            "camera's black level. Black level, dark noise, dynamic range, dark current and DSNU are not determined"
        )
        return {name: q for name, q in figures.items() if not name.startswith(_OF_DARKS)}
    if not is_hidden:
        return dict(figures)
    notes.append(
        f"the dark noise is below {PLAIN_FROM * step_dn**2:g} DN², where rounding hides it: sigma_y_dark is the most "
        "that it can be. DSNU and a dark current of less than a code are not determined; raise the gain to measure them"
    )
    return {
        name: q
        for name, q in figures.items()
        if not name.startswith(("DSNU", "mu_I_var")) and not (name.startswith("mu_I") and q.value < 2 * q.u)
    }


def _variance(dark: Sequence[GroupStatistics]) -> tuple[Line | None, Quantity]:
    """Return the line of the variance over exposure where there are three, and the variance at exposure 0 in DN²."""
    times = np.array([d.settings.exposure_s for d in dark])
    variances, u = np.array([(d.variance_dn2, max(d.u_variance_dn2, 1e-9)) for d in dark]).T
    if (exposures := np.unique(times).size) > 1:
        line = fit_line(times, variances, u)
        return line if exposures > 2 else None, Quantity(line.intercept, line.u_intercept, "DN^2")
    first = int(np.argmin(times))
    return None, Quantity(float(variances[first]), float(u[first]), "DN^2")


def by_temperature(dark: Sequence[GroupStatistics]) -> list[list[GroupStatistics]]:
    """Return the dark groups by plateau of temperature (gaps above 1.5 K part them), the coldest first."""
    ordered = sorted(dark, key=lambda d: -273.0 if d.settings.temperature_c is None else d.settings.temperature_c)
    plateaus: list[list[GroupStatistics]] = []
    for group in ordered:
        here = group.settings.temperature_c
        before = plateaus[-1][-1].settings.temperature_c if plateaus else None
        if plateaus and (here is None or before is None or here - before <= SAME_TEMPERATURE_K):
            plateaus[-1].append(group)
        else:
            plateaus.append([group])
    return plateaus


def pooled_frame_sd(dark: Sequence[GroupStatistics]) -> float:
    """Return the standard deviation in DN by which frames of one setting differ in their mean; 0 where none repeats.

    Black levels wander from frame to frame by more than the noise of so many pixels leaves in a mean.
    """
    repeated = [d for d in dark if d.frames > 1]
    freedom = sum(d.frames - 1 for d in repeated)
    return math.sqrt(sum((d.frames - 1) * d.frame_variance_dn2 for d in repeated) / freedom) if freedom else 0.0


def doubling_temperature(rates: Sequence[tuple[float | None, float, Quantity]]) -> Quantity | None:
    """Return the temperature step in K that doubles the dark current, from ln D over T.

    Args:
        rates: (temperature in °C, its standard uncertainty in K, dark current) per plateau, as of `typical_rates`.

    Returns:
        None where fewer than two plateaus of known temperature have a dark current above twice its uncertainty, or it
        does not rise.

    Source: EMVA Standard 1288, release 4.0, equation (17).
    """
    usable = [(t, u, q) for t, u, q in rates if t is not None and q.value > 2 * q.u]
    if len(usable) < 2:
        return None
    temperatures = np.array([t for t, _, _ in usable])
    logs = [math.log(q.value) for _, _, q in usable]
    slope = 0.0
    for _ in range(2):
        u = [max(math.hypot(q.u_rel, slope * u_t), 1e-9) for _, u_t, q in usable]
        line = fit_line(temperatures - temperatures.mean(), logs, u)
        slope = line.slope
    if line.slope <= 0:
        return None
    return Quantity(math.log(2) / line.slope, math.log(2) / line.slope**2 * line.u_slope, "K")


@dataclass(frozen=True, slots=True)
class DarkTransfer:
    """K from dark frames, with the line and its points (mean and variance of each frame in DN and DN²)."""

    K: Quantity
    line: Line
    mean_dn: tuple[float, ...]
    variance_dn2: tuple[float, ...]


def dark_transfer(frames: Iterable[NDArray[np.float64]]) -> DarkTransfer | None:
    """Return K in DN/e- from dark frames of one temperature and several exposures, one frame at each being enough.

    Every pixel's signal is linear in the mean of all of them, d_ip = a_p + b_p·x_i, so that its fixed pattern falls out
    with a straight line per pixel. The squared residuals, averaged over pixels, are the frames' noise variances
    mixed by the line: E[r_i²] = Σ_j (I − H)_ij²·σ_j², which is solved for σ_j². Their slope over x is K, whatever the
    read noise is.

    Args:
        frames: Digital numbers of at least five frames of one region, each of the same shape.

    Returns:
        None where there are too few frames or the dark current is too weak (u of K above 20 %).

    Source: EMVA Standard 1288, release 4.0, section 7 (K from σ_y² = σ_0² + K·μ_d); the fixed pattern is removed by
    lines instead of by pairs.
    """
    flat = [np.ravel(frame) for frame in frames]
    if len(flat) < _FEWEST_FRAMES:
        return None
    values = np.stack(flat)
    values = values[:, typical_pixels(values.mean(axis=0))]
    x = values.mean(axis=1)
    design = np.column_stack([np.ones_like(x), x - x.mean()])
    if np.ptp(x) <= 0:
        return None
    hat = design @ np.linalg.inv(design.T @ design) @ design.T
    checkable = np.diag(hat) < _HIGHEST_LEVERAGE
    mixing = (np.eye(len(x)) - hat) ** 2
    residual = (np.eye(len(x)) - hat) @ values
    squares = np.array([_clipped_variance(row) for row in residual])
    variances, u = _unmixed(mixing, squares, values.shape[1])
    if checkable.sum() < _FEWEST_FRAMES or np.unique(x[checkable]).size < 3 or np.any(u[checkable] <= 0):
        return None
    line = fit_line(x[checkable], variances[checkable], u[checkable])
    # Scatter beyond chance widens the line's u; a bend is a misfit along the signal that repetition does not average.
    u_slope = math.hypot(line.u_slope, _halves_u(x[checkable], variances[checkable], u[checkable]))
    if line.slope <= 0 or u_slope > _LARGEST_U_REL * line.slope:
        return None
    return DarkTransfer(Quantity(line.slope, u_slope, "DN/e-"), line, tuple(x[checkable]), tuple(variances[checkable]))


def _halves_u(x: NDArray[np.float64], variance: NDArray[np.float64], u: NDArray[np.float64]) -> float:
    """Return what the difference of the slopes below and above the middle leaves uncertain; 0 where one has no slope.

    Source: JCGM 100:2008, 4.3.7: a gain between the two, a rectangular distribution.
    """
    middle = (float(x.min()) + float(x.max())) / 2
    slopes = []
    for part in (x <= middle, x > middle):
        if np.unique(x[part]).size < 3:
            return 0.0
        slopes.append(fit_line(x[part], variance[part], u[part]).slope)
    return abs(slopes[1] - slopes[0]) / math.sqrt(12.0)


def _clipped_variance(residual: NDArray[np.float64]) -> float:
    """Return the variance without what particles and telegraph noise throw beyond six standard deviations."""
    distance = np.abs(residual - np.median(residual))
    sigma = max(robust_sigma(residual), 1e-9)
    return float(np.var(residual[distance <= _CLIP_SIGMAS * sigma]))


def _unmixed(
    mixing: NDArray[np.float64], squares: NDArray[np.float64], pixels: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the frames' variances and their standard uncertainties."""
    inverse = np.linalg.pinv(mixing)
    variances = inverse @ squares
    u_squares = squares * math.sqrt(2.0 / max(pixels - 1, 1))
    return variances, np.sqrt((inverse**2) @ u_squares**2)


def typical_rates(dark: Sequence[GroupStatistics], step_dn: int = 1) -> list[tuple[float | None, float, Quantity]]:
    """Return (temperature in °C, its standard uncertainty in K, dark current in DN/s) of each plateau of temperature.

    The typical pixel's mean is used: a few hot pixels with another doubling hold much of the mean of all. The
    temperature is known to a step of its readings. Plateaus whose noise is cut off at 0 are left out.

    Args:
        dark: Dark groups of one gain and region.
    """
    found = []
    for plateau in by_temperature(dark):
        times = [d.settings.exposure_s for d in plateau]
        if len(set(times)) < 2 or is_cut_off(plateau):
            continue
        line = _mean_line(plateau, [d.mean_dn if d.typical_dn is None else d.typical_dn for d in plateau], step_dn)
        known = [d.settings.temperature_c for d in plateau if d.settings.temperature_c is not None]
        # Two exposures leave no degree of freedom to see scatter by.
        rate = Quantity(line.slope, line.u_slope, "DN/s")
        # The rate is that of the long exposures, and so is its temperature.
        centre = float(np.average(known, weights=times)) if len(known) == len(times) else None
        found.append((centre, _temperature_u(known), rate))
    return found


def typical_dark_current(
    dark: Sequence[GroupStatistics], temperature_c: float | None, K: Quantity | None, step_dn: int = 1
) -> dict[str, Quantity]:
    """Return the typical pixel's dark current nearest a temperature, in e-/s or (without K) DN/s, and its doubling.

    Args:
        dark: Dark groups of one gain and region.
        temperature_c: Temperature of the bright frames in °C; None for the warmest.
        K: Overall system gain in DN/e-.
    """
    rates = typical_rates(dark, step_dn)
    if not rates:
        return {}
    reference_c = math.inf if temperature_c is None else temperature_c
    rate = min(rates, key=lambda r: abs((r[0] if r[0] is not None else 0.0) - min(reference_c, 1e3)))[2]
    figures = {"mu_I_dn": rate}
    if K is not None:
        u = math.hypot(rate.u, rate.value * K.u_rel) / K.value
        figures = {"mu_I_typical": Quantity(rate.value / K.value, u, "e-/s")}
    doubling = doubling_temperature(rates)
    return figures | ({"T_d": doubling} if doubling else {})


def _temperature_u(known: Sequence[float]) -> float:
    """Return the standard uncertainty of a plateau's temperature: the step of its readings, taken as rectangular."""
    steps = np.diff(np.unique(np.round(known, 3)))
    return max(float(steps.max()) if steps.size else 0.0, _FINEST_TEMPERATURE_K) / math.sqrt(12.0)


def gain_from_darks(
    subject: Subject, dark: Sequence[GroupStatistics]
) -> tuple[Quantity, tuple[DarkTransfer, ...]] | None:
    """Return K in DN/e- from the dark frames of every plateau of temperature, with the transfers; None where too weak.

    What bends them is the same sensor at every temperature, so that the mean of several is known no better than the
    best of them.

    Args:
        dark: Statistics of their dark groups at one gain, in the region that is looked at.
    """
    transfers = []
    if subject.given:
        return None  # statistics without pictures
    for plateau in by_temperature(dark):
        typical = [d.mean_dn if d.typical_dn is None else d.typical_dn for d in plateau]
        if len(plateau) < 3 or is_cut_off(plateau) or max(typical) - min(typical) < _LEAST_SPAN_DN:
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
    settings_of_plateau = {(d.settings.exposure_s, d.settings.temperature_c, d.settings.gain_db) for d in plateau}
    region = subject.regions[plateau[0].region]
    frames = []
    for group in subject.groups:
        key = (group.settings.exposure_s, group.settings.temperature_c, group.settings.gain_db)
        if not group.settings.is_dark or key not in settings_of_plateau:
            continue
        for dn in group.read(subject.camera.full_scale_dn):
            part = dn if region is None else dn[region.slices]
            step = max(1, math.ceil(math.sqrt(part.size / _MOST_PIXELS)))
            frames.append(part[::step, ::step].astype(np.float64))
            if len(frames) >= _MOST_FRAMES:
                return frames
    return frames

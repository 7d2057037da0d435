"""Measuring a screen: patches shown and read in their order, drift taken out, black a limit where unseen."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometer.devices import Display, DisplayPatch
from radiometer.errors import MeasurementError, UsageError
from radiometer.numbers import rounded
from radiometer.screen.calibration import AXES, LUMINANCE, RADIANCE, SCOTOPIC, ChannelCurve


@dataclass(frozen=True, slots=True)
class ScreenReading:
    """One reading of a patch on the screen."""

    radiance: float  # radiance in W·sr⁻¹·m⁻²
    u_independent: float  # standard uncertainty in W·sr⁻¹·m⁻² of what differs from reading to reading (noise, dark)
    u_common_rel: float  # relative standard uncertainty of what all readings share (scale, lens)
    time_s: float  # when it was taken, in s on the meter's steady clock
    flags: tuple[str, ...] = ()  # what must be known of it, as in a Reading


class Meter(Protocol):
    """Reads the patch that it looks at."""

    def read(self) -> ScreenReading:
        """Return one reading. Raises DeviceError, MeasurementError."""


TOP: Final = 255  # highest level: the drivers and pages here set 8 bits
CHANNELS: Final = tuple(AXES)
QUICK_LEVELS: Final = (0, 32, 64, 96, 128, 192, 255)  # dense where a screen's curve bends, dark
REFERENCE_EVERY: Final = 10  # a drift over ten readings is a straight line

Purpose = Literal["level", "white", "black"]


@dataclass(frozen=True, slots=True)
class ScreenStep:
    """One patch to be shown and read."""

    channel: str  # one of `CHANNELS`
    level: int  # level 0 to `TOP`
    purpose: Purpose = "level"  # "level" for the curve, "white" and "black" for drift references

    def patch(self, size: float = 1.0) -> DisplayPatch:
        """Return what the display is asked to show, `size` of the screen's width and height."""
        drive = self.level / TOP
        red, green, blue = AXES[self.channel]
        return DisplayPatch((red * drive, green * drive, blue * drive), width_fraction=size, height_fraction=size)


# White and black: a plan begins with them and comes back to them for the drift.
REFERENCES: Final = (ScreenStep("grey", TOP, "white"), ScreenStep("grey", 0, "black"))


def parse_levels(text: str) -> tuple[int, ...]:
    """Return ascending levels behind "all", "quick", a count such as "33", or a list such as "0,16,255".

    Black and white are always among them. Raises UsageError if the text is none of these.
    """
    if text == "all":
        return tuple(range(TOP + 1))
    if text == "quick":
        return QUICK_LEVELS
    try:
        numbers = [int(part) for part in text.split(",")]
    except ValueError as error:
        raise UsageError(
            f"--levels {text!r}: expected all, quick, a count such as 33, or a list such as 0,16,255"
        ) from error
    if len(numbers) == 1 and 3 <= numbers[0] <= TOP + 1:
        return tuple(sorted({round(n) for n in np.linspace(0, TOP, numbers[0])}))
    if len(numbers) == 1 or min(numbers) < 0 or max(numbers) > TOP:
        raise UsageError(f"--levels {text!r}: a count is 3 to {TOP + 1}; levels are 0 to {TOP}")
    found = tuple(sorted({0, TOP, *numbers}))
    if len(found) < 3:
        raise UsageError(f"--levels {text!r}: black and white alone show no curve; name a level between 0 and {TOP}")
    return found


def make_plan(levels: tuple[int, ...], channels: tuple[str, ...], rng: np.random.Generator) -> list[ScreenStep]:
    """Return all levels of all channels in random order, white and black references before, after and between.

    Raises:
        UsageError: If a channel is unknown.
    """
    unknown = sorted(set(channels) - set(CHANNELS))
    if unknown:
        raise UsageError(f"channel {unknown[0]!r} is unknown; choose from {', '.join(CHANNELS)}")
    steps = [ScreenStep(channel, level) for channel in channels for level in levels]
    plan: list[ScreenStep] = []
    for number, position in enumerate(rng.permutation(len(steps))):
        if number % REFERENCE_EVERY == 0:
            plan += REFERENCES
        plan.append(steps[position])
    return [*plan, *REFERENCES]


LEAST_CONTRAST: Final = 1.5  # white over black; a screen in a lit room still has more


@dataclass(frozen=True)
class Drift:
    """Output of the display over time, relative to its mean."""

    times_s: NDArray[np.float64]  # times of the references in s
    factors: NDArray[np.float64]  # white relative to the mean white at these times
    u_rel: float  # relative standard uncertainty of a value between two references

    @classmethod
    def of(cls, whites: Sequence[ScreenReading]) -> Drift:
        """Return the drift that reference readings of white show.

        What is left of each reference about the straight line between its neighbours is the uncertainty of
        interpolating; the readings' own noise is in it.
        """
        times = np.array([w.time_s for w in whites])
        values = np.array([w.radiance for w in whites])
        factors = values / values.mean()
        return cls(times, factors, _leftover(times, factors, whites))

    def at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return the display's output relative to its mean at a time."""
        return np.asarray(np.interp(np.asarray(time_s, dtype=np.float64), self.times_s, self.factors), dtype=np.float64)

    @property
    def range_rel(self) -> float:
        """Return the highest less the lowest output, relative to the mean."""
        return float(np.ptp(self.factors))


def _leftover(times: NDArray[np.float64], factors: NDArray[np.float64], whites: Sequence[ScreenReading]) -> float:
    noise = float(np.mean([w.u_independent / w.radiance for w in whites])) if whites else 0.0
    if len(times) < 3:
        return max(noise, float(np.ptp(factors)) / 2)
    between = [np.interp(times[i], times[[i - 1, i + 1]], factors[[i - 1, i + 1]]) for i in range(1, len(times) - 1)]
    # A point less the mean of two like it scatters by √1.5 of one; a line between two of them by √0.5.
    scatter = float(np.sqrt(np.mean((factors[1:-1] - np.array(between)) ** 2) / 1.5))
    return float(np.hypot(scatter, noise) * np.sqrt(0.5))


@dataclass(frozen=True, slots=True)
class Light:
    """What is known of a channel's light: efficacies in lm·W⁻¹ and the spectrum that they assume."""

    photopic_lm_per_w: float
    scotopic_lm_per_w: float
    spectrum: str
    # Relative standard uncertainties for the assumed spectrum: of both efficacies, and of scotopic over photopic
    u_photopic_rel: float = 0.0
    u_scotopic_rel: float = 0.0
    u_ratio_rel: float = 0.0

    def in_words(self) -> str:
        """Return the assumed spectrum, and how uncertain its efficacies are."""
        if not self.u_photopic_rel:
            return f"spectrum {self.spectrum}"
        photopic, scotopic = (f"{100 * u:.2g} %" for u in (self.u_photopic_rel, self.u_scotopic_rel))
        return (
            f"spectrum {self.spectrum}; its lm/W are known to {photopic}, the scotopic ones to {scotopic} (k = 1), "
            "which u holds"
        )

    def u_rel_where_measured_in(self, unit: str) -> dict[str, float]:
        """Return by unit what the assumed spectrum adds to values that were measured in radiance or luminance."""
        photopic, scotopic, ratio = self.u_photopic_rel, self.u_scotopic_rel, self.u_ratio_rel
        by_radiance = {LUMINANCE: photopic, SCOTOPIC: scotopic}
        return by_radiance if unit == RADIANCE else {RADIANCE: photopic, SCOTOPIC: ratio}

    def curve(
        self,
        name: str,
        levels: Sequence[int],
        values: tuple[ArrayLike, ArrayLike],
        u_common_rel: float,
        unit: str,
        detection_limit: float = 0.0,
    ) -> ChannelCurve:
        """Return the curve of a channel that has this light.

        Args:
            values: Radiance or luminance of each level in `unit`, and the standard uncertainty of each by itself.
            u_common_rel: Relative standard uncertainty shared by all levels, without that of the spectrum.
            detection_limit: Radiance in W·sr⁻¹·m⁻² below which nothing was distinguished from no light.
        """
        per_radiance = 1.0 if unit == RADIANCE else self.photopic_lm_per_w
        radiance, own = (tuple((np.asarray(one, dtype=np.float64) / per_radiance).tolist()) for one in values)
        light = self.photopic_lm_per_w, self.scotopic_lm_per_w, self.spectrum, detection_limit
        u_spectrum_rel = self.u_rel_where_measured_in(unit)
        return ChannelCurve(name, tuple(levels), radiance, own, u_common_rel, *light, u_spectrum_rel=u_spectrum_rel)


@dataclass(frozen=True, slots=True)
class Measured:
    """A step with its readings."""

    step: ScreenStep
    readings: tuple[ScreenReading, ...]

    @property
    def mean(self) -> ScreenReading:
        """Return the mean of the readings."""
        return mean_of(self.readings)


def mean_of(readings: Sequence[ScreenReading]) -> ScreenReading:
    """Return the mean of readings; their scatter counts where it exceeds their own uncertainty."""
    values = np.array([r.radiance for r in readings])
    stated = math.sqrt(sum(r.u_independent**2 for r in readings)) / len(values)
    seen = float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else 0.0
    return ScreenReading(
        radiance=float(values.mean()),
        u_independent=max(stated, seen),
        u_common_rel=max(r.u_common_rel for r in readings),
        time_s=float(np.mean([r.time_s for r in readings])),
        flags=tuple(sorted({f for r in readings for f in r.flags})),
    )


Progress = Callable[[int, int, ScreenStep], None]


def measure_steps(
    display: Display,
    meter: Meter,
    plan: Sequence[ScreenStep],
    *,
    repeats: int = 1,
    patch_size: float = 1.0,
    progress: Progress | None = None,
    keep: Callable[[Measured], None] = lambda one: None,
) -> list[Measured]:
    """Show every step and read it.

    Args:
        display: An open display.
        plan: Steps in order.
        repeats: Readings of each.
        patch_size: Size of the patch as a fraction of the screen's.
        progress: Called after every step with (done, total, step).
        keep: Gets every step with its readings before the next one is shown.

    Raises:
        DeviceError: If display or camera fail.
        MeasurementError: If a reading is clipped, or white is hardly brighter than black.
    """
    done: list[Measured] = []
    for step in plan:
        display.show(step.patch(patch_size))
        readings = tuple(meter.read() for _ in range(repeats))
        if any("saturated" in r.flags for r in readings):
            raise MeasurementError(
                f"level {step.level} of {step.channel} clips even at the shortest exposure; close the aperture or "
                "put a grey filter before the lens"
            )
        done.append(Measured(step, readings))
        if len(done) == 2:
            _require_contrast(done)
        keep(done[-1])
        if progress:
            progress(len(done), len(plan), step)
    return done


def _require_contrast(references: Sequence[Measured]) -> None:
    """Refuse to go on where white and black, which a plan begins with, look alike: something else is looked at."""
    levels = {entry.step.purpose: entry.mean.radiance for entry in references}
    white, black = levels.get("white"), levels.get("black")
    if white is not None and black is not None and white < LEAST_CONTRAST * black:
        raise MeasurementError(
            f"white is {white:.3g} and black {black:.3g} W·sr⁻¹·m⁻²: the camera does not see the patches; check that "
            "it looks at them (--patch), and that the room is dark"
        )


def curves_of(
    measured: Sequence[Measured], lights: Mapping[str, Light], *, unsettled_rel: float = 0.0
) -> tuple[dict[str, ChannelCurve], Drift]:
    """Return the channels' curves with the display's drift taken out, and the drift.

    Args:
        lights: Light of every channel.
        unsettled_rel: Relative change of white while it was waited for; with the drift it bounds how far the
            display was from settled, and goes into what all levels share.

    Raises:
        MeasurementError: If there is no white reference or a channel has fewer than three levels.
    """
    whites = [m.mean for m in measured if m.step.purpose == "white"]
    if len(whites) < 2:
        raise MeasurementError("needs white references before and after the levels")
    drift = Drift.of(whites)
    levels: dict[str, dict[int, ScreenReading]] = defaultdict(dict)
    for entry in measured:
        if entry.step.purpose == "level":
            levels[entry.step.channel][entry.step.level] = entry.mean
    unsettled = math.hypot(unsettled_rel, drift.range_rel) / math.sqrt(3.0)  # a rectangle of that half-width
    limit = _detection_limit([m.mean for m in measured if m.step.level == 0])
    return {n: _curve(n, readings, lights[n], drift, (limit, unsettled)) for n, readings in levels.items()}, drift


def _detection_limit(blacks: Sequence[ScreenReading]) -> float:
    """Return three times the uncertainty of the mean black where black itself is not above it, else 0.

    Source: the detection limit at three standard deviations of the blank (IUPAC 1975).
    """
    if not blacks:
        return 0.0
    black = mean_of(blacks)
    limit = 3.0 * black.u_independent
    return limit if black.radiance < limit else 0.0


def _curve(
    name: str, readings: Mapping[int, ScreenReading], light: Light, drift: Drift, limits: tuple[float, float]
) -> ChannelCurve:
    if len(readings) < 3:
        raise MeasurementError(f"channel {name}: {len(readings)} levels are too few; take three or more")
    ordered = sorted(readings)
    factors = [float(drift.at(readings[n].time_s)) for n in ordered]
    values = [max(readings[n].radiance / f, 0.0) for n, f in zip(ordered, factors, strict=True)]
    u = [math.hypot(readings[n].u_independent, v * drift.u_rel) for n, v in zip(ordered, values, strict=True)]
    u_common_rel = math.hypot(max(readings[n].u_common_rel for n in ordered), limits[1])
    return light.curve(name, ordered, (values, u), u_common_rel, RADIANCE, limits[0])


STEADY_REL: Final = 0.002  # change over the window that counts as warmed up: the size of white's repeatability
_PAUSE_S: Final = 60.0  # between two readings: a backlight settles in some ten minutes
_WINDOW: Final = 5  # readings: a drift of 0.2 % is seen over five


@dataclass(frozen=True, slots=True)
class WarmUp:
    """What was seen while the display warmed up."""

    waited_s: float  # how long white was shown
    drift_rel: float  # relative change over the last readings
    steady: bool  # whether that was below the limit before the time was up
    readings: tuple[ScreenReading, ...] = ()  # of white meanwhile

    @property
    def drift_s(self) -> float:
        """Return the time in s that the change was seen over."""
        return self.readings[-1].time_s - self.readings[-_WINDOW:][0].time_s


def wait_until_steady(
    meter: Meter,
    sleep: Callable[[float], None],
    *,
    limit_s: float,
    progress: Callable[[float, float], None] | None = None,
) -> WarmUp:
    """Read white until five readings in a row agree within 0.2 % (or their noise), or the time is up.

    Args:
        sleep: Waits for a number of seconds.
        limit_s: Longest time to wait in s; 0 takes a single set of readings.
        progress: Called after every reading with the time so far and the limit, both in s.
    """
    readings = [meter.read()]
    while True:
        drift, noise = _drift_of(readings[-_WINDOW:])
        waited = readings[-1].time_s - readings[0].time_s
        if progress is not None:
            progress(waited, limit_s)
        steady = len(readings) >= _WINDOW and drift <= max(STEADY_REL, 3.0 * noise)
        if steady or waited >= limit_s:
            return WarmUp(waited, drift, steady, tuple(readings))
        sleep(_PAUSE_S)
        readings.append(meter.read())


def _drift_of(readings: Sequence[ScreenReading]) -> tuple[float, float]:
    values = np.array([r.radiance for r in readings])
    noise = float(np.mean([r.u_independent for r in readings])) / values.mean()
    return float(np.ptp(values) / values.mean()), float(noise)


@dataclass(frozen=True, slots=True)
class Flicker:
    """Whether the display's light changes within fractions of a second (PWM dimming, scanning)."""

    exposure_s: float  # exposure of the test frames in s
    scatter_rel: float  # relative scatter from frame to frame
    noise_rel: float  # what noise alone would give
    found: bool  # whether the scatter exceeds noise beyond doubt (five sigmas of its estimate)


def judge_flicker(values: Sequence[float], noise_rel: float, exposure_s: float) -> Flicker:
    """Return whether readings of many short exposures scatter more than noise.

    Args:
        values: Mean signal of each frame, at least 3.
        noise_rel: Relative standard uncertainty of each by noise.
        exposure_s: Their exposure in s.
    """
    signal = np.asarray(values, dtype=np.float64)
    scatter = float(signal.std(ddof=1) / signal.mean())
    limit = noise_rel * math.sqrt(1 + 5 * math.sqrt(2 / (signal.size - 1)))
    return Flicker(exposure_s, scatter, noise_rel, found=scatter > max(limit, 5e-4))


@dataclass(frozen=True, slots=True)
class Uniformity:
    """White over a grid of places relative to the middle."""

    grid: tuple[tuple[float, ...], ...]  # rows of values relative to the middle
    lowest: float  # the lowest of them
    highest: float  # the highest of them
    u_rel: float  # the largest standard uncertainty of one of them

    @classmethod
    def of(cls, values: Sequence[Sequence[float]], u_rel: float) -> Uniformity:
        """Return the figures of a grid of radiances with odd numbers of rows and columns.

        Args:
            values: The radiances, in any unit.
            u_rel: The largest standard uncertainty of their ratios to the middle.
        """
        table = np.asarray(values, dtype=np.float64)
        relative = table / table[table.shape[0] // 2, table.shape[1] // 2]
        rows = tuple(tuple(float(v) for v in row) for row in relative)
        return cls(rows, float(relative.min()), float(relative.max()), u_rel)


def additivity(whites: Mapping[str, float], blacks: float) -> float | None:
    """Return (red + green + blue − 2·black) / white − 1 of the highest levels; None unless all were measured."""
    if not set(CHANNELS) <= set(whites):
        return None
    return (whites["red"] + whites["green"] + whites["blue"] - 2.0 * blacks) / whites["grey"] - 1.0


def as_mapping(check: WarmUp | Flicker | Uniformity) -> dict[str, Any]:
    """Return a check as it is written to the file."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(check).items()}


def checks_in_words(checks: Mapping[str, Any]) -> dict[str, str]:
    """Return what the checks of a calibration found, by name, as every face states it.

    Args:
        checks: As its file holds them; those that were not made, or that the file states otherwise, are left out.
    """
    warm = _part(checks, "warm_up", "steady", "waited_s")
    flicker = _part(checks, "flicker", "found", "scatter_rel", "exposure_s")
    grid = _part(checks, "uniformity", "lowest", "highest")
    drift, u_drift, additive, repeats = (
        value if isinstance(value := checks.get(name), float | int) else None
        for name in ("drift_rel", "drift_u_rel", "additivity_rel", "repeats")
    )
    found = {}
    if warm:
        state = "steady" if warm["steady"] else "still drifting"
        found["warm-up"] = f"{state} after {warm['waited_s']:.0f} s"
    if drift is not None:
        found["drift"] = f"{100 * drift:.2g} % while measuring, taken out"
        found["drift"] += "" if u_drift is None else f"; {100 * u_drift:.2g} % (k = 1) remains"
    if flicker and flicker["found"]:
        found["flicker"] = (
            f"light changes by {100 * flicker['scatter_rel']:.2g} % between frames of "
            f"{1e3 * flicker['exposure_s']:.3g} ms (PWM dimming?): {repeats} readings are averaged"
        )
    if grid:
        u = grid.get("u_rel", math.nan)  # files of earlier versions do not state it
        (lowest, each), (highest, _) = (rounded(100 * grid[end], 200 * u) for end in ("lowest", "highest"))
        found["uniformity"] = f"{lowest} to {highest} % of the middle, each ± {each} % (k = 2)"
    if additive is not None:
        found["additivity"] = f"primaries add up to white within {100 * additive:.2g} %"
    return found


def _part(checks: Mapping[str, Any], name: str, *keys: str) -> Mapping[str, Any]:
    """Return a check that holds numbers under all keys, or nothing."""
    part = checks.get(name)
    known = isinstance(part, Mapping) and all(isinstance(part.get(key), float | int) for key in keys)
    return part if isinstance(part, Mapping) and known else {}

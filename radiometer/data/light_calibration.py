"""Level ↔ radiance of a light box's channels, as measured by the camera."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AwareDatetime, Field, TypeAdapter

from radiometer.data.provenance import Provenance, is_out_of_date, utc_now
from radiometer.data.storage import read_yaml, write_yaml_atomic
from radiometer.data.validation import ConfigSection, validate
from radiometer.errors import CalibrationError, SettingOutOfRange

FORMAT: Final = "radiometer-light-calibration/1"
LOW_RANGE, HIGH_RANGE = "low", "high"
COVERAGE: Final = 2.0  # k = 2: a limit of safety counts with the expanded uncertainty


class LightPoint(ConfigSection):
    """One measured level."""

    current_range: Literal["low", "high"]  # "low" or "high" current
    level: int = Field(gt=0, le=65535)  # raw level
    duty_step: int = Field(gt=0)  # duty step that the box rounds it to
    # Settled radiance
    radiance_W_per_sr_m2: float = Field(gt=0)  # noqa: N815 (the file's key)
    # Relative standard uncertainty of this point alone (noise, drift); what all points share is not in it
    u_rel: float = Field(ge=0)
    start_rel: float = Field(1.0, gt=0)  # radiance just after switching on, over the settled one


class ChannelCalibration(ConfigSection):
    """The measured levels of one channel."""

    duty_steps: int = Field(gt=1)  # duty steps of the channel
    # Relative standard uncertainty that all its radiances share: camera scale, spectral correction
    common_u_rel: float = Field(ge=0)
    drift_u_rel: float = Field(0.0, ge=0)  # what the radiance changed by between measurements of the reference level
    settle_s: float = Field(0.0, ge=0)  # time in s after which a level had settled
    points: tuple[LightPoint, ...] = Field(min_length=2)  # the levels

    @cached_property
    def ranges(self) -> dict[str, _Range]:
        """Return the interpolation of each current range that was measured at two levels or more.

        Raises:
            CalibrationError: If a higher level, or the high current, does not give more light.
        """
        found = dict[str, list[LightPoint]]()
        for point in self.points:
            found.setdefault(point.current_range, []).append(point)
        # Radiance over duty, which an LED under PWM nearly keeps: so ranges compare that share no duty.
        efficacy = {
            name: [one.radiance_W_per_sr_m2 / one.duty_step for one in points] for name, points in found.items()
        }
        if len(efficacy) > 1 and max(efficacy[LOW_RANGE]) >= min(efficacy[HIGH_RANGE]):
            raise CalibrationError(
                "a light calibration whose low current gives as much light as the high one at the same duty: look"
                " whether current_range is swapped, or measure again"
            )
        return {name: _Range.of(points, self.duty_steps) for name, points in found.items() if len(points) > 1}


class _File(ConfigSection):
    """The whole file."""

    format: Literal["radiometer-light-calibration/1"]
    box_serial: str
    created: AwareDatetime
    validity_days: float = Field(365.0, gt=0)
    channels: dict[str, ChannelCalibration]
    provenance: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LevelChoice:
    """A raw level for a requested radiance, with the radiance that it really gives."""

    level: int  # raw level
    current_range: str  # "low" or "high"
    radiance_w_sr_m2: float  # settled radiance
    u_w_sr_m2: float  # its standard uncertainty
    start_rel: float  # radiance just after switching on, over the settled one
    settle_s: float  # time in s after which it has settled


@dataclass(frozen=True, slots=True)
class LightCalibration:
    """The calibration of a light box."""

    box_serial: str  # serial number of the box
    channels: Mapping[str, ChannelCalibration]  # calibrated channels
    created: str = field(default_factory=utc_now)  # ISO 8601 time in UTC
    validity_days: float = 365.0  # days that it is valid for
    # Camera, calibration and assumptions behind it
    provenance: Provenance = field(default_factory=lambda: Provenance("unknown"))

    def choose(self, channel: str, radiance_w_sr_m2: float) -> LevelChoice:
        """Return the level whose radiance is nearest to a requested one.

        Args:
            channel: Name of the channel.
            radiance_w_sr_m2: Wanted radiance in W·sr⁻¹·m⁻².

        Raises:
            CalibrationError: If the channel was not calibrated.
            SettingOutOfRange: If the radiance is outside the measured range; nothing is extrapolated.
        """
        ranges = self._channel(channel).ranges
        if not math.isfinite(radiance_w_sr_m2) or not any(r.holds(radiance_w_sr_m2) for r in ranges.values()):
            low, high = self.limits(channel)
            raise SettingOutOfRange(
                f"light box {self.box_serial}", f"radiance of {channel}", radiance_w_sr_m2, low, high, "W sr-1 m-2"
            )
        choices = [
            self._at_step(channel, name, held.nearest_step(radiance_w_sr_m2))
            for name, held in ranges.items()
            if held.holds(radiance_w_sr_m2)
        ]
        return min(choices, key=lambda choice: abs(math.log(choice.radiance_w_sr_m2 / radiance_w_sr_m2)))

    def limits(self, channel: str) -> tuple[float, float]:
        """Return the lowest and highest radiance measured on a channel, in W·sr⁻¹·m⁻². Raises CalibrationError."""
        radiances = [point.radiance_W_per_sr_m2 for point in self._channel(channel).points]
        return min(radiances), max(radiances)

    def drive_for(self, channel: str, radiance_w_sr_m2: float) -> tuple[int, bool]:
        """Return level and whether at the high current, for the driver. Raises as `choose`."""
        choice = self.choose(channel, radiance_w_sr_m2)
        return choice.level, choice.current_range == HIGH_RANGE

    def highest_radiance(self, channel: str, level: int, high: bool) -> float | None:
        name = HIGH_RANGE if high else LOW_RANGE
        known = self.channels.get(channel)
        if known is None or name not in known.ranges:
            return None
        held = known.ranges[name]
        step = _step_of(level, known.duty_steps)
        if not held.steps[0] <= step <= held.steps[-1]:
            return None
        choice = self._at_step(channel, name, step)
        return (choice.radiance_w_sr_m2 + COVERAGE * choice.u_w_sr_m2) * max(choice.start_rel, 1.0)

    def is_stale(self, now: dt.datetime) -> bool:
        """Return whether it is older at `now` (with time zone) than its validity, or from the future."""
        return is_out_of_date(self.created, self.validity_days, now)

    def write(self, path: Path) -> None:
        """Write it as YAML, whole or not at all. Raises OutputError."""
        write_yaml_atomic(
            path,
            {
                "format": FORMAT,
                "box_serial": self.box_serial,
                "created": self.created,
                "validity_days": self.validity_days,
                "channels": {name: channel.model_dump(mode="json") for name, channel in self.channels.items()},
                "provenance": asdict(self.provenance),
            },
        )

    @classmethod
    def read(cls, path: Path) -> LightCalibration:
        """Return the calibration in a file. Raises InputError or CalibrationError."""
        file = validate(_File, read_yaml(path), str(path), CalibrationError)
        for name, channel in file.channels.items():
            try:
                _ = channel.ranges
            except CalibrationError as error:
                raise CalibrationError(f"{path}: channel {name}: {error}") from error
        provenance = Provenance.from_mapping(file.provenance, str(path))
        created = TypeAdapter(AwareDatetime).dump_python(file.created, mode="json")
        return cls(file.box_serial, file.channels, created, file.validity_days, provenance)

    def _channel(self, name: str) -> ChannelCalibration:
        if name not in self.channels or not self.channels[name].ranges:
            known = ", ".join(self.channels) or "none"
            raise CalibrationError(
                f"channel {name!r} of light box {self.box_serial} is not calibrated (calibrated: {known}); "
                f"run `radiometer light calibrate --channel {name}`"
            )
        return self.channels[name]

    def _at_step(self, channel: str, name: str, step: int) -> LevelChoice:
        calibrated = self._channel(channel)
        held = calibrated.ranges[name]
        radiance, u_own_rel, start_rel = held.at(step)
        u_rel = math.sqrt(u_own_rel**2 + calibrated.common_u_rel**2 + calibrated.drift_u_rel**2)
        level = _level_of(step, calibrated.duty_steps)
        return LevelChoice(level, name, radiance, u_rel * radiance, start_rel, calibrated.settle_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Range:
    """Radiance over duty in one current range: ln(radiance/duty) is interpolated over ln(duty) in straight lines.

    An LED under PWM is nearly proportional to its duty; the residual is smooth. The error of the straight lines is
    taken as a rectangle of half width h²/8·|f''|, f'' from the divided differences of neighbouring points.
    """

    steps: NDArray[np.int64]
    log_duty: NDArray[np.float64]
    log_efficacy: NDArray[np.float64]
    u_rel: NDArray[np.float64]
    start_rel: NDArray[np.float64]
    duty_steps: int

    @classmethod
    def of(cls, points: list[LightPoint], duty_steps: int) -> _Range:
        points = sorted(points, key=lambda point: point.duty_step)
        steps = np.array([point.duty_step for point in points])
        if np.any(np.diff(steps) == 0):
            raise CalibrationError(f"a light calibration holds duty step {steps[:-1][np.diff(steps) == 0][0]} twice")
        log_duty = np.log(steps / duty_steps)
        radiance = np.array([point.radiance_W_per_sr_m2 for point in points])
        if np.any(np.diff(radiance) <= 0):
            raise CalibrationError(
                "a light calibration must rise: a higher level never gives less light; measure again"
            )
        u_rel = np.array([point.u_rel for point in points])
        start_rel = np.array([point.start_rel for point in points])
        return cls(steps, log_duty, np.log(radiance) - log_duty, u_rel, start_rel, duty_steps)

    def holds(self, radiance: float) -> bool:
        """Return whether a radiance is between the lowest and the highest measured one."""
        low, high = (math.exp(self.log_efficacy[end] + self.log_duty[end]) for end in (0, -1))
        return low * (1 - 1e-9) <= radiance <= high * (1 + 1e-9)

    def nearest_step(self, radiance: float) -> int:
        """Return the duty step whose radiance is nearest on a logarithmic scale."""
        steps = np.arange(self.steps[0], self.steps[-1] + 1)
        log_duty = np.log(steps / self.duty_steps)
        log_radiance = log_duty + np.interp(log_duty, self.log_duty, self.log_efficacy)
        return int(steps[np.argmin(np.abs(log_radiance - math.log(radiance)))])

    def at(self, step: int) -> tuple[float, float, float]:
        """Return radiance, its own relative standard uncertainty, and the start over the settled radiance at a step."""
        x = math.log(step / self.duty_steps)
        right = int(np.clip(np.searchsorted(self.log_duty, x), 1, self.log_duty.size - 1))
        left = right - 1
        width = self.log_duty[right] - self.log_duty[left]
        share = (x - self.log_duty[left]) / width
        efficacy = (1 - share) * self.log_efficacy[left] + share * self.log_efficacy[right]
        u_ends = math.hypot((1 - share) * self.u_rel[left], share * self.u_rel[right])
        bend = self._curvature(left, right) * width**2 / 2 * share * (1 - share)
        start = float(np.interp(x, self.log_duty, self.start_rel))
        return math.exp(efficacy + x), math.hypot(u_ends, bend / math.sqrt(3)), start

    def _curvature(self, left: int, right: int) -> float:
        """Return the larger |f''| of the two triples of points around an interval."""
        slopes = np.diff(self.log_efficacy) / np.diff(self.log_duty)
        found = [0.0]
        for first in (left - 1, left):
            if first >= 0 and first + 2 < self.log_duty.size:
                span = self.log_duty[first + 2] - self.log_duty[first]
                found.append(2 * abs(slopes[first + 1] - slopes[first]) / span)
        # At an end only one triple is near; droop grows with the duty, so its curvature may double over an interval.
        at_end = left == 0 or right == self.log_duty.size - 1
        return float(max(found)) * (2.0 if at_end else 1.0)


def _step_of(level: int, duty_steps: int) -> int:
    return ((level + (level >> 15)) * duty_steps + 32768) >> 16


def _level_of(step: int, duty_steps: int) -> int:
    """Return a raw level that the box rounds to a duty step."""
    level = min(round(step * 65536 / duty_steps), 65535)
    return level if _step_of(level, duty_steps) == step else level - 1

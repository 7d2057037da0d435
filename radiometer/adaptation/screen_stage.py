"""A calibrated screen as a stage: its field bleaches, its spot blinks next to a red mark, a key or touch answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from radiometer.adaptation.protocol import AdaptationProtocol, SteadyBleach
from radiometer.adaptation.screen_levels import SpotLevels, field_code, mark_code
from radiometer.errors import ConfigurationError, UsageError
from radiometer.screen.calibration import ScreenCalibration
from radiometer.screen.stimulus import Blink, Code, Hold, ScreenPicture, Shape, StimulusScreen, Viewing, in_codes

# Reaction times by browser, keyboard or touch screen come out too long by tens of ms that differ from machine to
# machine: Pronk et al. 2020, Behavior Research Methods 52, 1371. A rectangle from 0 to 0.1 s represents it.
PRESS_LAG_S: Final = 0.1
_SAME_PRESS_S: Final = 0.2  # two beginnings of a press that are reported closer than this are one


@dataclass(slots=True)
class ScreenStage:
    """Runs a test on a screen."""

    screen: StimulusScreen  # an open screen before the subject
    calibration: ScreenCalibration  # its calibration
    protocol: AdaptationProtocol  # the protocol, within the screen's reach
    viewing: Viewing  # where the eye is
    clock: Callable[[], float]  # steady clock in s
    wall_clock: Callable[[], float] | None = None  # time of day as Unix time in s; None where time is simulated
    # "right" or "left": the spot stands temporal of the mark, and so does the light in the blind spot
    eye: str = "right"
    levels: SpotLevels = field(init=False)
    _zero_s: float = field(default=0.0, init=False)
    _bleach: ScreenPicture = field(init=False)
    _rest: ScreenPicture = field(init=False)
    _spot: Shape = field(init=False)
    _blind_spot: Shape | None = field(default=None, init=False)
    _held: tuple[float, float] = field(default=(0.0, 0.0), init=False)
    _reported_s: float = field(default=-math.inf, init=False)
    _last: Blink | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        spot, mark, side = self.protocol.spot, self.protocol.fixation, -1 if self.eye == "left" else 1
        half = side * spot.eccentricity_deg / 2
        bleach = self.protocol.bleach
        if not isinstance(bleach, SteadyBleach):
            raise UsageError(
                f"protocol {self.protocol.name}: a screen gives no flash of {bleach.retinal_td_s:g} td·s; take a "
                "protocol with a steady bleach"
            )
        self.levels = SpotLevels.of(self.calibration, spot.channel, spot.filter_density)
        red, _ = self._mark_code()
        shown = self.viewing.ellipse(-half, mark.size_deg, red)
        self._spot = self.viewing.ellipse(half, spot.size_deg, self.levels.rgb(-1))
        self.viewing.require_room((shown, self._spot), self.screen.size)
        self._bleach = ScreenPicture(field_code(self.calibration, bleach.luminance_cd_m2, self.protocol.name))
        self._rest = ScreenPicture(shapes=(shown,))
        self._blind_spot = self._in_blind_spot(side)
        self._zero_s = self.clock()

    def _in_blind_spot(self, side: int) -> Shape | None:
        """Return the light in the blind spot; None where the protocol wants none or the page has no room for it."""
        check, spot = self.protocol.fixation_check, self.protocol.spot
        if check is None:
            return None
        red, _ = mark_code(self.calibration, check.luminance_cd_m2 * 10.0**spot.filter_density)
        at_deg = side * (check.temporal_deg - spot.eccentricity_deg / 2)
        shape = self.viewing.ellipse(at_deg, check.size_deg, red, check.below_deg)
        try:
            self.viewing.require_room((shape,), self.screen.size)
        except ConfigurationError:
            return None
        return shape

    def _mark_code(self) -> tuple[Code, bool]:
        """Return the red that is the mark's luminance at the eye, behind the filter; and whether it is calibrated."""
        return mark_code(
            self.calibration, self.protocol.fixation.luminance_cd_m2 * 10.0**self.protocol.spot.filter_density
        )

    def now_s(self) -> float:
        """Return the time in s since the stage was set up, or as `resume_at` set it."""
        return self.clock() - self._zero_s

    def wall_s(self) -> float | None:
        """Return the time of day as Unix time in s; None where time is simulated."""
        return self.wall_clock() if self.wall_clock else None

    def resume_at(self, time_s: float) -> None:
        """Count on from a time, with the mark shown again. Raises DeviceError."""
        self._zero_s = self.clock() - time_s
        self.screen.show(self._rest)

    def facts(self) -> dict[str, Any]:
        """Return what the journal should hold of the screen."""
        low, high = self.levels.reach
        return {
            "screen": self.calibration.name,
            "calibrated": self.calibration.created,
            "distance_mm": self.viewing.distance_mm,
            "pixel_mm": self.viewing.pixel_mm,
            "filter_density": self.protocol.spot.filter_density,
            "reach_log10": [round(low, 4), round(high, 4)],
            "coarsest_step_log10": round(self.levels.coarsest_step(self.protocol.spot.lowest_log10), 4),
            "u_level_log10": [round(float(self.levels.u_log10[i]), 4) for i in (0, -1)],
            "u_scale_log10": round(self.levels.u_common_log10, 4),
            "mark_calibrated": self._mark_code()[1],
            "u_press_s": round(self.u_press_s, 4),
            "warnings": self.screen.warnings(),
            "eye": self.eye,
            **({} if self.checks_fixation else {"no_fixation_check": self._why_unchecked()}),
        }

    def _why_unchecked(self) -> str:
        has_check = self.protocol.fixation_check is not None
        return "the page has no room for the blind spot" if has_check else "the protocol has no fixation_check"

    def health(self) -> dict[str, str]:
        """Return how the screen is, for whoever watches."""
        wrong = self.screen.warnings()
        frames = "" if self._last is None else f"{1 / self._last.frame_s:.0f} frames/s"
        return {"screen": self.calibration.name, "page": "; ".join(wrong) or "as it should be", "shows": frames or "–"}

    @property
    def u_press_s(self) -> float:
        """Return the standard uncertainty of the time of a press: its lag, and the frame in which the light came."""
        frame_s = self._last.frame_s if self._last else 1 / 60
        return math.hypot(PRESS_LAG_S, frame_s) / math.sqrt(12.0)

    def bleach(self, protocol: AdaptationProtocol) -> None:
        """Light the whole screen for the protocol's time, then leave the mark. Raises DeviceError."""
        self.screen.show(self._bleach)
        self.screen.rest(protocol.bleach.duration_s)
        self.screen.show(self._rest)

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        """Blink the spot once and return the presses in s from its onset. Raises DeviceError."""
        lit = self._rest
        if log10_level is not None:
            rgb = self.levels.rgb(self.levels.nearest(log10_level))
            lit = ScreenPicture(shapes=(*self._rest.shapes, in_codes(self._spot, rgb)))
        return self._blink_once(lit)

    @property
    def checks_fixation(self) -> bool:
        """Return whether there is room for a light in the blind spot, and the protocol wants it."""
        return self._blind_spot is not None

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        """Show the light in the blind spot once and return the presses in s from its onset.

        Raises:
            UsageError: If there is none.
            DeviceError: If the screen fails.
        """
        if self._blind_spot is None:
            raise UsageError(self._why_unchecked())
        return self._blink_once(ScreenPicture(shapes=(*self._rest.shapes, self._blind_spot)))

    def _blink_once(self, lit: ScreenPicture) -> list[float]:
        spot = self.protocol.spot
        seen = self._last = self.screen.blink(lit, self._rest, spot.on_s, spot.cycle_s)
        self._note(seen.hold)
        return list(seen.presses_s)

    def wait(self, seconds: float) -> None:
        """Let time pass in the dark; presses then count for nothing. Raises DeviceError."""
        self.rest(seconds)

    def rest(self, seconds: float) -> int:
        """Let time of a pause pass and return how often the button was pressed. Raises DeviceError."""
        seen = self.screen.rest(seconds)
        self._note(seen.hold)
        return seen.presses

    def long_press(self, at_least_s: float) -> float | None:
        """Return when a press that lasts so long began, on the stage's clock; each once, None where none is."""
        begun_s, lasted_s = self._held
        if lasted_s < at_least_s:
            return None
        self._held, self._reported_s = (0.0, 0.0), begun_s
        return begun_s

    def _note(self, hold: Hold) -> None:
        """Remember the longest press; one that was reported already may still go on."""
        begun_s = self.now_s() - hold.began_ago_s
        if hold.lasted_s > self._held[1] and begun_s > self._reported_s + _SAME_PRESS_S:
            self._held = (begun_s, hold.lasted_s)

    def shown_log10(self, log10_level: float) -> float:
        """Return the level that the screen shows where one is asked for: it has whole levels only."""
        return float(self.levels.log10[self.levels.nearest(log10_level)])

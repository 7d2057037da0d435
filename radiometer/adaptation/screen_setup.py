"""A screen as the stage of the adaptation test: a page in a browser, or a simulated one before a simulated subject."""

from __future__ import annotations

import datetime as dt
import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.checks import Check, judge_age, room_by_camera
from radiometer.adaptation.protocol import AdaptationProtocol, SteadyBleach
from radiometer.adaptation.request import RunRequest
from radiometer.adaptation.run import Stage
from radiometer.bench.box_holder import darken_held
from radiometer.bench.screen import BROWSER, SIMULATED_DISPLAYS, START_TIMEOUT_S
from radiometer.devices import DisplayPatch
from radiometer.errors import ConfigurationError, UsageError
from radiometer.screen.calibration import AXES, LUMINANCE, SCOTOPIC, ChannelCurve, ScreenCalibration
from radiometer.screen.stimulus import Blink, Code, Hold, Rest, ScreenPicture, Shape, StimulusScreen, Viewing
from radiometer.typing import Array
from simulators.displays import DISPLAYS, SimulatedDisplay
from simulators.observers.observer import BEHAVIOURS, Observer, ObserverAtScreen, behaviour_of

_FRAME_S: Final = 1 / 60  # usual screens show 60 frames per second
_SIMULATED_SIZE: Final = (1920, 1080)  # Full HD
_SIMULATED_PIXEL_MM: Final = 0.27  # Full HD at 24 inches

# Reaction times by browser, keyboard or touch screen come out too long by tens of ms that differ from machine to
# machine: Pronk et al. 2020, Behavior Research Methods 52, 1371. A rectangle from 0 to 0.1 s represents it.
PRESS_LAG_S: Final = 0.1
_SAME_PRESS_S: Final = 0.2  # two beginnings of a press that are reported closer than this are one
# A spot whose light above black is less certain than this factor (k = 2) is not shown as a level.
_LEAST_KNOWN_REL: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class SpotLevels:
    """The levels of one channel as spots."""

    channel: str  # name of the channel
    codes: NDArray[np.int64]  # whole levels that can be distinguished from black, ascending, shape (n,)
    log10: Array  # log10 of the scotopic luminance in cd·m⁻² that each adds to the black, behind the filter, shape (n,)
    u_log10: Array  # its standard uncertainty without what all levels share, shape (n,)
    u_common_log10: float  # what all share: the scale

    @classmethod
    def of(cls, calibration: ScreenCalibration, channel: str, filter_density: float = 0.0) -> SpotLevels:
        """Return the spots of a channel of a calibrated screen.

        Args:
            calibration: The screen's calibration.
            filter_density: Optical density of a neutral filter before screen or eye.

        Raises:
            CalibrationError: If the channel was not measured.
            ConfigurationError: If the screen has other than 8 bits, or none of its levels can be distinguished from
                black.
        """
        curve = calibration.channel(channel)
        if curve.bits != 8:
            raise ConfigurationError(f"screen {calibration.name}: a page shows 8 bits per channel, not {curve.bits}")
        codes = np.arange(curve.levels[0] + 1, curve.levels[-1] + 1)
        added, u = _above_black(curve, codes)
        usable = (added > curve.detection_limit * curve.efficacy(SCOTOPIC)) & (2 * u < _LEAST_KNOWN_REL * added)
        first = int(np.argmax(usable)) if usable.any() else codes.size
        if first == codes.size:
            raise ConfigurationError(
                f"screen {calibration.name}: no level of {channel} can be distinguished from its black; calibrate "
                "it with more repeats"
            )
        # Above the first usable level all are used: an uncertain one between two good ones is bounded by them.
        value = np.maximum.accumulate(added[first:])
        relative = u[first:] / value / math.log(10)
        at_eye = np.log10(value) - filter_density
        return cls(channel, codes[first:], at_eye, relative, curve.u_shared_rel(SCOTOPIC) / math.log(10))

    @property
    def reach(self) -> tuple[float, float]:
        """Return the lowest and the highest level, log10 of scotopic cd·m⁻²."""
        return float(self.log10[0]), float(self.log10[-1])

    def coarsest_step(self, lowest_log10: float) -> float:
        """Return the greatest distance in log10 of two neighbouring levels that are not below a level."""
        return float(np.diff(self.log10[self.log10 >= lowest_log10 - 1e-9]).max(initial=0.0))

    def nearest(self, log10_level: float) -> int:
        """Return the position of the level nearest to one asked for."""
        return int(np.argmin(np.abs(self.log10 - log10_level)))

    def rgb(self, position: int) -> Code:
        """Return the codes of the level at a position."""
        code = int(self.codes[position])
        red, green, blue = AXES[self.channel]
        return (red * code, green * code, blue * code)


def _above_black(curve: ChannelCurve, codes: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return what levels add to the lowest one in scotopic cd·m⁻², and its own standard uncertainty."""
    black, factor = curve.levels[0], curve.efficacy(SCOTOPIC)
    added = np.array([curve.radiance_at(int(n)).value for n in codes]) - curve.radiance_at(black).value
    u = np.array([math.hypot(curve.u_shape_at(int(n)), curve.u_shape_at(black)) for n in codes])
    return factor * added, factor * u


def within_reach(protocol: AdaptationProtocol, levels: SpotLevels) -> AdaptationProtocol:
    """Return a protocol whose spot goes no further than a screen's levels.

    Raises:
        ConfigurationError: If the screen shows none of the protocol's levels, or not its criterion.
    """
    spot, (low, high) = protocol.spot, levels.reach
    lowest, highest = max(spot.lowest_log10, low), min(spot.highest_log10, high)
    if lowest >= highest:
        raise ConfigurationError(
            f"protocol {protocol.name}: the screen's {levels.channel} spot goes from {low:.2f} to {high:.2f} log₁₀ "
            f"scotopic cd·m⁻², the protocol's from {spot.lowest_log10:g} to {spot.highest_log10:g}"
        )
    criterion = protocol.end.criterion_log10
    if criterion is not None and criterion <= lowest:
        raise ConfigurationError(
            f"protocol {protocol.name}: its criterion {criterion:g} is below the darkest spot of the screen, "
            f"{low:.2f} log₁₀ scotopic cd·m⁻²"
        )
    narrowed = spot.model_copy(update={"lowest_log10": lowest, "highest_log10": highest})
    return protocol.model_copy(update={"spot": narrowed})


def field_code(calibration: ScreenCalibration, luminance_cd_m2: float, name: str) -> Code:
    """Return the grey that bleaches with a luminance.

    Raises:
        ConfigurationError: If the screen does not get so bright.
    """
    grey = calibration.channel("grey")
    brightest = grey.at(grey.levels[-1], LUMINANCE).value
    if luminance_cd_m2 > brightest:
        raise ConfigurationError(
            f"protocol {name}: the bleach of {luminance_cd_m2:g} cd·m⁻² is beyond screen {calibration.name}, which "
            f"reaches {brightest:.0f}: lower bleach.luminance_cd_m2 and lengthen bleach.duration_s"
        )
    code = grey.level_for(luminance_cd_m2, LUMINANCE)
    return (code, code, code)


def mark_code(calibration: ScreenCalibration, luminance_cd_m2: float) -> tuple[Code, bool]:
    """Return the red of the mark, and whether it is calibrated: a share of grey is assumed where red was not measured.

    Source of the share: luminance of the red primary in white, ITU-R BT.709: 0.2126.
    """
    measured = "red" in calibration.channels
    curve = calibration.channel("red" if measured else "grey")
    target = luminance_cd_m2 if measured else luminance_cd_m2 / 0.2126
    low, high = (curve.at(curve.levels[i], LUMINANCE).value for i in (0, -1))
    code = curve.level_for(min(target + low, high), LUMINANCE)
    return (max(code, 1), 0, 0), measured


@dataclass(slots=True)
class ScreenStage(Stage):
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
        red, _ = self._red(mark.luminance_cd_m2)
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
        red, _ = self._red(check.luminance_cd_m2)
        at_deg = side * (check.temporal_deg - spot.eccentricity_deg / 2)
        shape = self.viewing.ellipse(at_deg, check.size_deg, red, check.below_deg)
        try:
            self.viewing.require_room((shape,), self.screen.size)
        except ConfigurationError:
            return None
        return shape

    def _red(self, luminance_cd_m2: float) -> tuple[Code, bool]:
        """Return the red that has a luminance at the eye, behind the filter; and whether it is calibrated."""
        return mark_code(self.calibration, luminance_cd_m2 * 10.0**self.protocol.spot.filter_density)

    def now_s(self) -> float:
        return self.clock() - self._zero_s

    def wall_s(self) -> float | None:
        return self.wall_clock() if self.wall_clock else None

    def resume_at(self, time_s: float) -> None:
        self._zero_s = self.clock() - time_s
        self.screen.show(self._rest)

    def facts(self) -> dict[str, Any]:
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
            "mark_calibrated": self._red(self.protocol.fixation.luminance_cd_m2)[1],
            "u_press_s": round(self.u_press_s, 4),
            "warnings": self.screen.warnings(),
            "eye": self.eye,
            **({} if self.checks_fixation else {"no_fixation_check": self._why_unchecked()}),
        }

    def _why_unchecked(self) -> str:
        has_check = self.protocol.fixation_check is not None
        return "the page has no room for the blind spot" if has_check else "the protocol has no fixation_check"

    def health(self) -> dict[str, str]:
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
        lit = self._rest
        if log10_level is not None:
            rgb = self.levels.rgb(self.levels.nearest(log10_level))
            lit = ScreenPicture(shapes=(*self._rest.shapes, replace(self._spot, rgb=rgb)))
        return self._blink_once(lit)

    @property
    def checks_fixation(self) -> bool:
        """Return whether there is room for a light in the blind spot, and the protocol wants it."""
        return self._blind_spot is not None

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        if self._blind_spot is None:
            raise UsageError(self._why_unchecked())
        return self._blink_once(ScreenPicture(shapes=(*self._rest.shapes, self._blind_spot)))

    def _blink_once(self, lit: ScreenPicture) -> list[float]:
        spot = self.protocol.spot
        seen = self._last = self.screen.blink(lit, self._rest, spot.on_s, spot.cycle_s)
        self._note(seen.hold)
        return list(seen.presses_s)

    def rest(self, seconds: float) -> int:
        seen = self.screen.rest(seconds)
        self._note(seen.hold)
        return seen.presses

    def long_press(self, at_least_s: float) -> float | None:
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
        return float(self.levels.log10[self.levels.nearest(log10_level)])


@dataclass(slots=True)
class ObservedScreen:
    """A simulated screen with a simulated subject before it, in simulated time."""

    watcher: ObserverAtScreen  # the subject and the display
    viewing: Viewing  # where the subject's eye is
    seed: int = 0  # makes the subject's answers
    eye: str = "right"  # which of its eyes looks
    _shown: ScreenPicture = field(default_factory=ScreenPicture)

    @property
    def size(self) -> tuple[int, int]:
        return _SIMULATED_SIZE

    def show(self, picture: ScreenPicture) -> None:
        self._shown = picture
        self.watcher.display.show(DisplayPatch(_drive(picture.field)))

    def blink(self, lit: ScreenPicture, rest: ScreenPicture, on_s: float, cycle_s: float) -> Blink:
        """Let the subject see what `lit` has beyond `rest`."""
        spots = [shape for shape in lit.shapes if shape not in rest.shapes]
        rgb = _drive(spots[0].rgb) if spots else (0.0, 0.0, 0.0)
        # The answer follows from the time, so that a run that was taken up after a crash goes on as it would have.
        clock = self.watcher.display.clock
        self.watcher.observer.rng = np.random.default_rng([self.seed, round(1e3 * clock.now_s())])
        place = self._place(spots[0], rest.shapes[0]) if spots and rest.shapes else None
        reaction_s = self.watcher.answer(rgb, place)
        self._pass(cycle_s)
        return Blink(() if reaction_s is None else (reaction_s,), Hold(), on_s, _FRAME_S)

    def _place(self, shape: Shape, mark: Shape) -> tuple[float, float]:
        """Return where a shape is, in degrees temporal of and above the mark."""
        (right, above), (mark_right, mark_above) = map(self.viewing.direction_deg, (shape, mark))
        return (mark_right - right if self.eye == "left" else right - mark_right), above - mark_above

    def rest(self, seconds: float) -> Rest:
        """Let time pass; whoever looks at a bright field meanwhile is bleached."""
        self._pass(seconds)
        if max(self._shown.field) > 0:
            self.watcher.stare(_drive(self._shown.field), seconds)
        return Rest(0, Hold())

    def warnings(self) -> list[str]:
        """Return nothing: a simulated screen is as it should be."""
        return []

    def _pass(self, seconds: float) -> None:
        self.watcher.display.clock.advance(seconds)


class ObservedStage(ScreenStage):
    """A simulated screen as a stage: what a crash has undone is done again in no time."""

    def resume_at(self, time_s: float) -> None:
        """Bleach the subject as it was, and move the clock to a time. Raises DeviceError."""
        self.bleach(self.protocol)
        if isinstance(self.screen, ObservedScreen):
            self.screen.watcher.display.clock.advance(max(0.0, time_s - self.now_s()))


def _drive(code: Code) -> tuple[float, float, float]:
    return code[0] / 255, code[1] / 255, code[2] / 255


@contextmanager
def open_screen_stage(
    request: RunRequest, announce: Callable[[str], None] = lambda url: None
) -> Iterator[tuple[ScreenStage, list[Check]]]:
    """Open a calibrated screen as a stage for the block, with its checks.

    Args:
        announce: Called with the page's address.

    Raises:
        UsageError: If protocol, display and subject exclude each other, or no calibration is named.
        CalibrationError: If the calibration is too old or does not hold what the protocol needs.
        ConfigurationError: If the screen does not reach what the protocol asks for.
        DeviceError: If the page cannot be shown.
    """
    protocol, display, subject = request.protocol, request.display, request.simulate
    if request.screen is None:
        raise UsageError(f"protocol {protocol.name} needs a calibrated screen: --screen FILE of `screen calibrate`")
    known = ScreenCalibration.read(request.screen)
    now = dt.datetime.now(dt.UTC)
    age = judge_age(f"screen {known.name}", known.created, protocol, now, accept_stale=request.accept_stale)
    if age.refusal is not None:
        raise age.refusal
    checks: list[Check] = [lambda: age, *([lambda: room_by_camera(request)] if request.measure_room else [])]
    reached = within_reach(protocol, SpotLevels.of(known, protocol.spot.channel, protocol.spot.filter_density))
    if display == BROWSER:
        if subject is not None:
            raise UsageError("a simulated subject sees simulated displays only: --display lcd, pwm_lcd or oled")
        viewing = _viewing(protocol, known, None)
        with _browser(request.port, announce) as screen:
            screen.show(ScreenPicture())  # nothing but black while the room is looked at
            yield ScreenStage(screen, known, reached, viewing, time.monotonic, time.time, request.eye), checks
    elif display in SIMULATED_DISPLAYS:
        watcher = _watcher(display, subject, request.seed, protocol.spot.filter_density)
        with watcher.display:
            viewing = _viewing(protocol, known, _SIMULATED_PIXEL_MM)
            before, now_s = ObservedScreen(watcher, viewing, request.seed, request.eye), watcher.display.clock.now_s
            yield ObservedStage(before, known, reached, viewing, now_s, eye=request.eye), checks
    else:
        raise UsageError(f"display {display!r} is unknown; choose {BROWSER}, {', '.join(SIMULATED_DISPLAYS)}")


def _browser(port: int, announce: Callable[[str], None]) -> AbstractContextManager[StimulusScreen]:
    from radiometer.screen.browser_page import BrowserStimulus

    return BrowserStimulus(port, announce=announce, start_timeout_s=START_TIMEOUT_S, darken=darken_held)


def _watcher(display: str, subject: str | None, seed: int, filter_density: float) -> ObserverAtScreen:
    if subject is None:
        raise UsageError(f"a simulated display needs a simulated subject: --simulate {', '.join(BEHAVIOURS)}")
    chosen = behaviour_of(subject)
    observer = Observer(chosen.eye(np.random.default_rng(seed)), chosen.habits)
    simulated = SimulatedDisplay(DISPLAYS[display])
    return ObserverAtScreen(observer, simulated, 60.0 * chosen.leaves_after_min, filter_density)


def _viewing(protocol: AdaptationProtocol, calibration: ScreenCalibration, otherwise_mm: float | None) -> Viewing:
    pixel_mm = protocol.viewing.pixel_mm or calibration.pixel_mm or otherwise_mm
    if pixel_mm is None:
        raise ConfigurationError(
            "the distance of two pixels is not known: measure the picture's width, divide it by its pixels, and give "
            "it as viewing.pixel_mm in the protocol or as --pixel-mm to `screen calibrate`"
        )
    return Viewing(protocol.viewing.distance_mm, pixel_mm)

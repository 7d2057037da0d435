"""A screen as the stage of the adaptation test: a page in a browser, or a simulated one before a simulated subject."""

from __future__ import annotations

import datetime as dt
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from radiometer.adaptation.checks import Check, judge_age
from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.adaptation.request import RunRequest
from radiometer.adaptation.room import room_by_camera
from radiometer.adaptation.screen_levels import SpotLevels, within_reach
from radiometer.adaptation.screen_stage import ScreenStage
from radiometer.bench.box_holder import darken_held
from radiometer.bench.screen import BROWSER, SIMULATED_DISPLAYS, START_TIMEOUT_S
from radiometer.devices import DisplayPatch
from radiometer.errors import ConfigurationError, UsageError
from radiometer.screen.calibration import ScreenCalibration
from radiometer.screen.stimulus import Blink, Code, Hold, Rest, ScreenPicture, Shape, StimulusScreen, Viewing
from simulators.displays import DISPLAYS, SimulatedDisplay
from simulators.observers.behaviours import BEHAVIOURS, behaviour_of
from simulators.observers.observer import Observer, ObserverAtScreen

_FRAME_S: Final = 1 / 60  # usual screens show 60 frames per second
_SIMULATED_SIZE: Final = (1920, 1080)  # Full HD
_SIMULATED_PIXEL_MM: Final = 0.27  # Full HD at 24 inches


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
        """Return width and height of the screen in pixels."""
        return _SIMULATED_SIZE

    def show(self, picture: ScreenPicture) -> None:
        """Show a picture. Raises DeviceError, SettingOutOfRange."""
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
        return Blink(() if reaction_s is None else (reaction_s,), Hold(), on_s, _FRAME_S, _FRAME_S)

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
    from radiometer.screen.browser_stimulus import BrowserStimulus

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

"""Interface that a test needs of the devices in front of a subject."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from radiometer.adaptation.protocol import AdaptationProtocol


class Stage(Protocol):
    """The devices in front of the subject, on one clock."""

    @property
    def protocol(self) -> AdaptationProtocol:
        """Return what is done, as far as the devices reach."""

    def now_s(self) -> float:
        """Return the time in s since the stage was set up."""

    def wall_s(self) -> float | None:
        """Return the time of day as Unix time in s; None where time is simulated."""

    def bleach(self, protocol: AdaptationProtocol) -> None:
        """Give the bleach and return when it is over. Raises DeviceError, UnsafeStimulus."""

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        """Show one blink (None: none, a catch) and return the presses during it in s from its onset."""

    def wait(self, seconds: float) -> None:
        """Let time pass in the dark; presses then count for nothing."""

    def rest(self, seconds: float) -> int:
        """Let time of a pause pass and return how often the button was pressed."""

    def long_press(self, at_least_s: float) -> float | None:
        """Return when a press that lasts so long began, on the stage's clock; each once, None where none is."""

    def resume_at(self, time_s: float) -> None:
        """Count on from a time, after a crash."""


@runtime_checkable
class DescribedStage(Protocol):
    """A stage that can describe itself."""

    def facts(self) -> Mapping[str, Any]:
        """Return what the journal should hold of it."""

    def health(self) -> Mapping[str, str]:
        """Return how it is now, for whoever watches. Raises DeviceError."""


@runtime_checkable
class SteppedStage(Protocol):
    """A stage whose levels are whole steps, coarser than a threshold is known."""

    def shown_log10(self, log10_level: float) -> float:
        """Return the level that is shown where one is asked for."""


@runtime_checkable
class FixationStage(Protocol):
    """A stage that has a place for a light in the blind spot."""

    @property
    def checks_fixation(self) -> bool:
        """Return whether it can show one."""

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        """Show the light in the blind spot once and return the presses in s from its onset. Raises DeviceError."""

"""Keeps account of the retinal exposure that a session has planned and given."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from radiometer.devices.retinal_safety import (
    BLUE_WINDOW_S,
    DEFAULT_FRACTION,
    ChannelOptics,
    HazardFractions,
    hazard_fractions,
    refuse_unsafe,
)

MERGE_S: Final = 10.0  # what ended within this time is kept as one entry, with the later time


@dataclass(frozen=True, slots=True)
class _Shone:
    """Light of one channel: from when, for how many bright seconds (inf: until changed), at which radiance."""

    start_s: float
    bright_s: float
    radiance_w_sr_m2: float


@dataclass(slots=True)
class ExposureLedger:
    """Adds up the blue-light exposure of all channels over 10⁴ s; takes the hottest moment for the thermal limit.

    All channels count as falling on the same place of the retina, and a blinking or ramped channel as bright for the
    planned time at its highest radiance: both on the safe side.

    Attributes:
        optics: Optics of each channel.
        clock: Returns the time in s; monotonic.
        allowed_fraction: Largest fraction of either limit that may be used up.
    """

    optics: Mapping[str, ChannelOptics]
    clock: Callable[[], float]
    allowed_fraction: float = DEFAULT_FRACTION
    _current: dict[str, _Shone] = field(default_factory=dict)
    _past_blue: deque[tuple[float, float]] = field(default_factory=deque)

    def refuse_unsafe(self, channel: str, radiance_w_sr_m2: float, bright_s: float) -> None:
        """Raise UnsafeStimulus if a stimulus, with all that was given before, exceeds the allowed fraction.

        Args:
            channel: Which channel would shine; what it does now would end.
            radiance_w_sr_m2: Highest radiance while bright, in W·sr⁻¹·m⁻².
            bright_s: Planned bright time in s; `math.inf` where no end is planned.
        """
        now_s = self.clock()
        others = [n for n in self._current if n != channel]
        planned = hazard_fractions(self.optics[channel], radiance_w_sr_m2, bright_s)
        blue = planned.blue_light + self._given_blue(channel, now_s) + self._past_sum(now_s)
        thermal = planned.thermal
        for name in others:
            entry = self._current[name]
            still = hazard_fractions(self.optics[name], entry.radiance_w_sr_m2, entry.bright_s)
            blue += still.blue_light
            thermal += still.thermal
        refuse_unsafe(f"channel {channel}", HazardFractions(blue, thermal), self.allowed_fraction)

    def shine(self, channel: str, radiance_w_sr_m2: float, bright_s: float) -> None:
        """Note that a stimulus has started."""
        self.darken(channel)
        self._current[channel] = _Shone(self.clock(), bright_s, radiance_w_sr_m2)

    def darken(self, channel: str) -> None:
        """Note that a channel is dark; what it has given stays in the account for 10⁴ s."""
        now_s = self.clock()
        given = self._given_blue(channel, now_s)
        if self._current.pop(channel, None) is None or given <= 0:
            return
        if self._past_blue and now_s - self._past_blue[-1][0] < MERGE_S:
            given += self._past_blue.pop()[1]
        self._past_blue.append((now_s, given))

    def _given_blue(self, channel: str, now_s: float) -> float:
        entry = self._current.get(channel)
        if entry is None:
            return 0.0
        bright_s = min(entry.bright_s, max(now_s - entry.start_s, 0.0))
        return hazard_fractions(self.optics[channel], entry.radiance_w_sr_m2, bright_s).blue_light

    def _past_sum(self, now_s: float) -> float:
        while self._past_blue and now_s - self._past_blue[0][0] >= BLUE_WINDOW_S:
            self._past_blue.popleft()
        return math.fsum(blue for _, blue in self._past_blue)

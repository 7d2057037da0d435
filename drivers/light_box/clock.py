"""Estimates how the box's clock runs against the host's, from time-stamped exchanges."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from radiometer.devices.light_box import ClockEstimate
from radiometer.errors import MeasurementError

TICK_S: Final = 4e-6  # the box stamps in steps of 4 µs
# A ceramic resonator, as on the Arduino Uno, is within 0.5 % of its frequency (Murata CSTCE, data sheet).
RATE_PRIOR: Final = 0.005
MOST_RATE: Final = 0.01  # what the account of the exposure adds for the box's times
# Three spans in a row must show a rate: a program or simulated box that waited for the processor shows it in one.
SPANS: Final = 3
SPAN_S: Final = 0.7  # delays of 7 ms are as much as MOST_RATE in it
WINDOW: Final = 512  # samples; older ones say nothing of the rate of the box's clock now
DELAY_SLACK_S: Final = 0.0005  # samples whose free delay exceeds the least by more are left out


@dataclass(frozen=True, slots=True)
class ClockSample:
    """One exchange: sent and received on the host's clock, received and answered on the box's, in s."""

    sent_s: float  # host time before the request left
    box_received_s: float  # box time of the request's last byte
    box_answered_s: float  # box time at which the answer was made
    received_s: float  # host time of the answer's last byte
    request_wire_s: float = 0.0  # time that the request's bytes take on the wire
    answer_wire_s: float = 0.0  # time that the answer's bytes take

    @property
    def free_delay_s(self) -> float:
        """Return the part of the round trip that neither the box's work nor the wire explains, in s."""
        away_s = (self.received_s - self.sent_s) - (self.box_answered_s - self.box_received_s)
        free_s = away_s - self.request_wire_s - self.answer_wire_s
        return free_s if free_s >= 0 else away_s  # a line without wire time: USB or a pseudo-terminal

    @property
    def offset_s(self) -> float:
        """Return host time minus box time in s, taking the free delay as equal both ways."""
        away_s = (self.received_s - self.sent_s) - (self.box_answered_s - self.box_received_s)
        wire_s = self.request_wire_s if away_s >= self.request_wire_s + self.answer_wire_s else 0.0
        return self.sent_s + wire_s + self.free_delay_s / 2 - self.box_received_s


@dataclass(slots=True)
class BoxClock:
    """Host time of the box's stamps: a straight line through the exchanges with the least delay.

    The free delay may be on either way, so that an offset is known to ± half of the least delay (rectangular,
    standard uncertainty the half width by √3; GUM 4.3.7); scatter and rate add the rest.
    """

    samples: deque[ClockSample] = field(default_factory=lambda: deque(maxlen=WINDOW))

    def add(self, sample: ClockSample) -> None:
        """Take one more exchange into account."""
        self.samples.append(sample)

    def estimate(self) -> ClockEstimate:
        """Return offset and drift at the latest sample. Raises MeasurementError where there is no sample."""
        latest_s = self._latest().box_received_s
        offset_s, u_offset_s, rate, u_rate = self._fit(latest_s)
        return ClockEstimate(offset_s, -1e6 * rate, 1e6 * u_rate, u_offset_s, len(self.samples))

    def host_time_s(self, box_time_s: float) -> tuple[float, float]:
        """Return the host time of a box time and its standard uncertainty, in s.

        Raises:
            MeasurementError: If no exchange has succeeded yet.
        """
        offset_s, u_offset_s, _, _ = self._fit(box_time_s)
        return box_time_s + offset_s, u_offset_s

    def least_rate(self) -> float:
        """Return by how much the clocks' rates differ at least in each of the latest spans, wherever delays were.

        It is 0 where they run alike, or too little time has passed.
        """
        later, rates = self._latest(), list[float]()
        for sample in reversed(self.samples):
            if later.sent_s - sample.sent_s >= SPAN_S:
                moved_s = later.offset_s - sample.offset_s
                least_s = abs(moved_s) - (later.free_delay_s + sample.free_delay_s) / 2.0
                rates.append(math.copysign(max(least_s, 0.0), moved_s) / (later.box_received_s - sample.box_received_s))
                later = sample
                if len(rates) == SPANS:
                    return max(0.0, min(rates), -max(rates))
        return 0.0

    def most_rate(self) -> float:
        """Return by how much the clocks' rates differ at most, wherever delays were; inf before a second exchange."""
        samples = list(self.samples)
        return min((_most_rate(samples[0], later) for later in samples[1:]), default=math.inf)

    def _latest(self) -> ClockSample:
        if not self.samples:
            raise MeasurementError("the box's clock has not been compared with the host's yet; call synchronise()")
        return self.samples[-1]

    def _fit(self, box_time_s: float) -> tuple[float, float, float, float]:
        """Return offset at a box time, its uncertainty, rate of the offset (s per s), its uncertainty."""
        self._latest()
        least_s = min(sample.free_delay_s for sample in self.samples)
        good = [sample for sample in self.samples if sample.free_delay_s <= least_s + DELAY_SLACK_S]
        times_s = np.array([sample.box_received_s for sample in good])
        offsets_s = np.array([sample.offset_s for sample in good])
        mean_time_s, mean_offset_s = float(times_s.mean()), float(offsets_s.mean())
        # Each offset scatters by the slack left in its delay; TICK_S by its rounding.
        sigma_s = math.hypot((least_s + DELAY_SLACK_S) / 2 / math.sqrt(3), TICK_S)
        # A rate of 0 ± RATE_PRIOR joins the fit as one more observation.
        spread = float(((times_s - mean_time_s) ** 2).sum()) / sigma_s**2
        information = spread + 1 / RATE_PRIOR**2
        rate = float((times_s - mean_time_s) @ (offsets_s - mean_offset_s)) / sigma_s**2 / information
        u_rate = 1 / math.sqrt(information)
        away_s = box_time_s - mean_time_s
        u_asymmetry_s = least_s / 2 / math.sqrt(3)
        u_offset_s = math.sqrt(u_asymmetry_s**2 + sigma_s**2 / len(good) + (u_rate * away_s) ** 2 + TICK_S**2 / 12)
        return mean_offset_s + rate * away_s, u_offset_s, rate, u_rate


def _most_rate(first: ClockSample, later: ClockSample) -> float:
    passed_s = later.box_received_s - first.box_received_s
    moved_s = abs(later.offset_s - first.offset_s) + (later.free_delay_s + first.free_delay_s) / 2.0
    return moved_s / passed_s if passed_s > 0.0 else math.inf

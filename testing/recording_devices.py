"""A light box and a screen that note what they are asked, on clocks of their own, and press as it is laid down."""

from __future__ import annotations

from radiometer.devices.light_box import ButtonEvent, ChannelMode, ChannelState, DriveLevel
from radiometer.screen.stimulus import Blink, Hold, Rest


class RecordingBox:
    """A box that notes what it is asked and hands out presses that were laid down."""

    def __init__(self):
        self.asked = []
        self.presses = []
        self.held = []
        self.time = 100.0
        self.level = 1000

    def pulse(self, channel, level, duration_s):
        self.asked.append((channel, level.radiance_w_sr_m2, duration_s))

    def set_level(self, channel, level):
        self.asked.append((channel, level.radiance_w_sr_m2))

    def read_channel(self, channel):
        return ChannelState(channel, ChannelMode.PULSE, DriveLevel(self.level), 0, 1.0)

    def off(self, channel):
        self.asked.append((channel, "off"))

    def buttons(self, timeout_s):
        self.time += timeout_s
        for number, time_s in enumerate(self.presses):
            yield ButtonEvent(True, time_s, 1e-4, time_s, number)
            yield ButtonEvent(False, time_s + 0.1, 1e-4, time_s + 0.1, number + 1)
        for begun_s, ended_s in self.held:
            yield ButtonEvent(True, begun_s, 1e-4, begun_s, 0)
            if ended_s <= self.time:
                yield ButtonEvent(False, ended_s, 1e-4, ended_s, 1)


class RecordingScreen:
    """A screen that notes what it is asked, on a clock of its own, and presses as it is asked to."""

    def __init__(self):
        self.time, self.size = 50.0, (1920, 1080)
        self.shown = []
        self.blinks = []
        self.presses = ()
        self.hold = Hold()

    def show(self, picture):
        self.shown.append(picture)

    def blink(self, lit, rest, on_s, cycle_s):
        self.blinks.append((lit, rest, on_s, cycle_s))
        self.time += cycle_s
        return Blink(self.presses, self.hold, on_s, 1 / 60)

    def rest(self, seconds):
        self.time += seconds
        return Rest(len(self.presses), self.hold)

    def warnings(self):
        return ["the page is not full screen: press F11"]

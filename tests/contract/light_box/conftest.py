"""Benches for the light-box contract: the driver on the simulated twin, and on the real firmware in simavr."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from drivers.light_box.box import SerialLightBox
from drivers.light_box.link import BoxLink
from drivers.light_box.serial_line import SerialLine
from radiometer.devices.exposure_account import MemoryStore
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.retinal_safety import ChannelOptics
from radiometer.errors import MissingLibrary
from simulators.light_box.avr_box import AvrBox
from simulators.light_box.box import SimulatedLightBox
from simulators.light_box.lines import PtyServer, WiredLightBox
from testing.firmware_board import built_for_avr
from testing.patience import within

# Steps of simavr's time where the machine is busy, far shorter than the driver waits for an answer.
LAG_S = 0.005
OPTICS = {
    "bleach": ChannelOptics(None, 0.0, 60.0, 5.0),
    "spot": ChannelOptics(453.0, 22.0, 1.5, 3.0),
    "spot_red": ChannelOptics(640.0, 18.0, 1.5, 3.0),
    "fixation": ChannelOptics(640.0, 18.0, 0.3, 1.0),
    "spot_green": ChannelOptics(505.0, 30.0, 1.5, 3.0),
    "field": ChannelOptics(None, 0.0, 40.0, 40.0),
}


@dataclass
class Rig:
    """A box on a pseudo-terminal, its driver, and what can be done to it and seen of it from outside.

    `went_dark_s` is the box time at which the bleach's light ended.
    """

    server: PtyServer
    box: SerialLightBox
    duty: Callable[[str], float]
    high_current: Callable[[str], bool]
    press: Callable[[bool], None]
    box_time_s: Callable[[], float]
    went_dark_s: Callable[[], float]

    def wait_until(self, condition, timeout_s=5.0):
        """Poll until something holds; tell whether it ever did."""
        deadline_s = time.monotonic() + within(timeout_s)
        while time.monotonic() < deadline_s:
            if condition():
                return True
            time.sleep(0.005)
        return condition()


@pytest.fixture(scope="session")
def firmware(tmp_path_factory):
    """Return the HEX file of the firmware; skip where its compiler is absent."""
    missing = "avr-gcc is not installed (Debian: gcc-avr, avr-libc)"
    return built_for_avr(tmp_path_factory.mktemp("firmware")) or pytest.skip(missing)


def _driver(server, clock=time.monotonic):
    return SerialLightBox(
        BoxLink(SerialLine(server.port, clock=clock)),
        ExposureLedger(OPTICS, MemoryStore(clock, ("TWIN0001", "AVR00001"))),
    )


def _twin_rig(link):
    twin = SimulatedLightBox()
    server = PtyServer(WiredLightBox(twin), link=link)
    server.start()

    def press(pressed):
        with server.lock:
            twin.press(server.time_s(), pressed=pressed)

    def high_current(channel):
        state = next(state for state in twin.channels if state.limits.name == channel)
        return state.high and state.driven_level > 0

    dark_s = []
    twin.watch = lambda: dark_s.append(twin.box_ms / 1000) if twin.duty("bleach") == 0 else dark_s.clear()
    return Rig(server, _driver(server), twin.duty, high_current, press, lambda: twin.box_ms / 1000, lambda: dark_s[0])


def _firmware_rig(link, firmware):
    try:
        avr = AvrBox(firmware, lag_s=LAG_S)
    except MissingLibrary as missing:
        pytest.skip(str(missing))
    server = PtyServer(avr, link=link)
    server.start()

    def press(pressed):
        with server.lock:
            avr.press(pressed=pressed)

    def duty(channel):
        with server.lock:
            return avr.duty(channel)

    def went_dark_s():
        last_high = avr.pins["bleach"].last_high()
        return last_high / avr.avr.frequency_hz

    def box_time_s():
        return float(avr.avr.time_s)

    # The driver waits in the box's time: simavr is given less of it where the machine is busy.
    return Rig(server, _driver(server, box_time_s), duty, avr.is_high_current, press, box_time_s, went_dark_s)


@pytest.fixture(params=["twin", "firmware"])
def rig(request, tmp_path):
    """Return a running box with an opened driver."""
    link = tmp_path / "box"
    made = _twin_rig(link) if request.param == "twin" else _firmware_rig(link, request.getfixturevalue("firmware"))
    try:
        made.box.open()
        yield made
    finally:
        made.box.close()
        made.server.stop()

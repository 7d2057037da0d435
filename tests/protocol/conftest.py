"""Two boxes that speak the light-box protocol, in their own time: the twin, and the firmware in simavr."""

from zlib import crc32

import pytest

from radiometer.errors import MissingLibrary
from simulators.light_box.avr_box import AvrBox
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from testing.firmware_board import built_for_avr

SERIAL = "LB000007"


class Talker:
    """A box that is asked byte for byte; time passes only when the test lets it."""

    def __init__(self, avr):
        self.avr = avr
        self.twin = SimulatedLightBox(SimulatedBoxSettings(serial=SERIAL))
        self.run(0.1)
        self.boot = self.take()

    def run(self, duration_s):
        """Let box time pass."""
        if self.avr is not None:
            self.avr.run(duration_s)
        else:
            self.twin.advance(self.twin.time_s + duration_s)

    def take(self):
        """Return what the box has sent since the last call."""
        if self.avr is not None:
            return self.avr.take_sent()
        sent = b"".join(emitted.line for emitted in self.twin.emitted)
        self.twin.emitted.clear()
        return sent

    def tell(self, raw):
        """Send bytes as they are and return what comes back within 20 ms."""
        if self.avr is not None:
            self.avr.send(raw)
        else:
            self.twin.receive(raw, self.twin.time_s)
        self.run(0.02)
        return self.take()

    def ask(self, body):
        """Send a request with its checksum and return what comes back."""
        return self.tell(f"{body}*{crc32(body.encode()):08X}\n".encode())

    def duty(self, channel):
        """Return the duty at a channel's pin."""
        return self.avr.duty(channel) if self.avr is not None else self.twin.duty(channel)


NO_COMPILER = "avr-gcc is not installed (Debian: gcc-avr, avr-libc)"


@pytest.fixture(scope="session")
def light_box_hex(tmp_path_factory):
    """Return the firmware."""
    return built_for_avr(tmp_path_factory.mktemp("protocol_firmware")) or pytest.skip(NO_COMPILER)


@pytest.fixture(scope="session")
def small_bucket_hex(tmp_path_factory):
    """Return the firmware with energy budgets of a 400th and two flashes in a row: used up in seconds."""
    folder = tmp_path_factory.mktemp("small_buckets")
    return built_for_avr(folder, "BUCKET_DIVISOR=400", "FLASHES=2") or pytest.skip(NO_COMPILER)


@pytest.fixture(params=["twin", "firmware"])
def talker(request):
    """Return a freshly powered box."""
    if request.param == "twin":
        yield Talker(None)
        return
    try:
        yield Talker(AvrBox(request.getfixturevalue("light_box_hex"), serial=SERIAL))
    except MissingLibrary as missing:
        pytest.skip(str(missing))

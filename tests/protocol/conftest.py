"""Two boxes that speak the light-box protocol, in their own time: the twin, and the firmware in simavr."""

import shutil
import subprocess
from zlib import crc32

import pytest

from radiometer.errors import MissingLibrary
from simulators.light_box.avr_box import AvrBox
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from testing.patience import within

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


def built(project_root, build, *options):
    """Build the firmware; skip where the compiler is absent."""
    if shutil.which("avr-gcc") is None:
        pytest.skip("avr-gcc is not installed (Debian: gcc-avr, avr-libc)")
    source = project_root / "drivers" / "firmware" / "light_box"
    command = ["make", "-s", "-C", str(source), f"BUILD={build}", *options]
    subprocess.run(command, check=True, capture_output=True, timeout=within(120.0))
    return build / "light_box.hex"


@pytest.fixture(scope="session")
def light_box_hex(project_root, tmp_path_factory):
    """Return the firmware."""
    return built(project_root, tmp_path_factory.mktemp("protocol_firmware"))


@pytest.fixture(scope="session")
def small_bucket_hex(project_root, tmp_path_factory):
    """Return the firmware with energy budgets of a 400th and two flashes in a row: used up in seconds."""
    return built(project_root, tmp_path_factory.mktemp("small_buckets"), "BUCKET_DIVISOR=400", "FLASHES=2")


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

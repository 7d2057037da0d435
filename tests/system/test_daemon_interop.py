"""A running daemon read by Bluesky and by the photometer for PsychoPy."""

import bluesky.plans as bp
import pytest
from bluesky import RunEngine

from radiometer.adapters.bluesky import RadiometerDetector
from radiometer.adapters.psychopy import RadiometerPhotometer
from radiometer.adapters.readings import DaemonSource
from radiometer.data import Patch
from radiometer.errors import DeviceError
from testing.daemon_process import DaemonProcess

BRIGHT, DIM = 0.918, 0.1997  # radiance of the two patches of the small bench, W sr-1 m-2


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    """Return a daemon that measures when asked."""
    with DaemonProcess(tmp_path_factory.mktemp("daemon"), "--on-demand") as running:
        yield running


def test_plan_counts_on_the_daemon(daemon):
    """A count of two reads the daemon's patch, or the one asked for, with its uncertainty."""
    events = []
    keep = {"event": [lambda _, document: events.append(document["data"])]}
    engine = RunEngine({})
    engine(bp.count([RadiometerDetector(DaemonSource(daemon.url), "bright")]), keep)
    engine(bp.count([RadiometerDetector(DaemonSource(daemon.url, Patch(100, 30, 20, 20)), "dim")]), keep)
    assert abs(events[0]["bright-radiance"] - BRIGHT) < 4 * events[0]["bright-u_radiance"]
    assert abs(events[1]["dim-radiance"] - DIM) < 4 * events[1]["dim-u_radiance"]


def test_photometer_reads_the_daemons_luminance(daemon):
    """getLum is the luminance that the daemon states for the same patch."""
    with RadiometerPhotometer(daemon.url) as photometer:
        value = photometer.getLum()
        assert photometer.lastReading.luminance.unit == "cd m-2"
        assert value == photometer.lastReading.luminance.value > 100.0


def test_refusal_of_the_daemon_comes_through_in_its_words(daemon):
    """A patch off the picture is refused by the daemon; the error holds its message."""
    with pytest.raises(DeviceError, match=r"refuses: .*patch"):
        DaemonSource(daemon.url, Patch(5000, 0, 10, 10)).measure()

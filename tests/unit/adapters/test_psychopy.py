"""The photometer without PsychoPy: what PsychoPy asks of one (`make interop` asks it with the real package)."""

import pytest

from radiometer.adapters.psychopy import ADDRESS_VARIABLE, RadiometerPhotometer
from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w, spectrum
from radiometer.data import Flag, Patch, Quantity, Reading
from radiometer.errors import DeviceError, MeasurementError, MissingLibrary


class Told:
    """A source that gives the same reading again and again."""

    origin = "radiometer:stated"

    def __init__(self, luminance, *flags):
        self.luminance, self.flags = luminance, flags

    def measure(self):
        return Reading(Quantity(0.5, 0.01, "W sr-1 m-2"), Patch(0, 0, 4, 4), "stated", self.luminance, flags=self.flags)


def test_photometer_answers_as_psychopy_asks():
    """getLum returns cd/m² and leaves it in lastLum; the response is kept, with its uncertainty next to it."""
    photometer = RadiometerPhotometer(source=Told(Quantity(160.0, 3.0, "cd m-2")))
    assert photometer.getLum() == photometer.lastLum == 160.0
    assert photometer.getResponse().value == 160.0
    assert photometer.getResponse().device is photometer
    assert len(photometer.responses) == 3
    assert photometer.responses[0].t <= photometer.responses[2].t
    assert photometer.lastReading.luminance.u == 3.0
    assert photometer.OK
    assert photometer.type == "radiometer"
    assert "radiometer:stated" in photometer.getInfo()


@pytest.mark.slow
def test_photometer_of_a_camera_reads_what_the_bench_shows():
    """The bench's middle patch has 1.5·0.5^2.2 W/sr/m²; the lens is known to 1 %, of which three sigmas are allowed."""
    efficacy = luminous_efficacy_lm_per_w(spectrum("white_led"), "photopic")
    with RadiometerPhotometer("sim", spectrum="white_led") as photometer:
        assert photometer.getLum() == pytest.approx(1.5 * 0.5**2.2 * efficacy, rel=0.03)
        assert photometer.portString == "sim"


def test_the_device_managers_profile_makes_the_device(monkeypatch):
    """The profile names the address of the environment, and reports the device by it."""
    monkeypatch.setenv(ADDRESS_VARIABLE, "sim")
    (profile,) = RadiometerPhotometer.getAvailableDevices()
    assert profile["address"] == "sim"
    with RadiometerPhotometer(address=profile["address"]) as photometer:
        assert photometer.isSameDevice(profile)
        assert not photometer.isSameDevice({"address": "http://127.0.0.1:8080"})
        assert photometer.isSameDevice(photometer)


def test_daemon_that_is_not_there_is_named():
    """One line says who does not answer and what to do."""
    photometer = RadiometerPhotometer("http://127.0.0.1:9")
    with pytest.raises(DeviceError, match=r"127\.0\.0\.1:9 does not answer.*radiometer serve"):
        photometer.getLum()


def test_backend_without_psychopy_says_so():
    """Monitor Center's list entry is a plugin: without PsychoPy it names what is missing."""
    pytest.importorskip("radiometer.adapters.psychopy")
    with pytest.raises(MissingLibrary, match="PsychoPy"):
        __import__("radiometer.adapters.psychopy_backend")


def test_a_lower_bound_is_no_luminance_and_one_below_the_noise_warns():
    """Neither is a radiance of unknown spectrum, and it is not given out as 0; what is below the noise warns."""
    bound = Quantity(46.9, 46.9, "cd m-2")
    with pytest.raises(MeasurementError, match="lower bound"):
        RadiometerPhotometer(source=Told(bound, Flag.SATURATED)).getLum()
    with pytest.warns(UserWarning, match="below the noise"):
        assert RadiometerPhotometer(source=Told(bound, Flag.BELOW_NOISE)).getLum() == 46.9
    photometer = RadiometerPhotometer(source=Told(None))
    with pytest.raises(MeasurementError, match="spectrum='white_led'"):
        photometer.getLum()
    assert photometer.lastLum is None

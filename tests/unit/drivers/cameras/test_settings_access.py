"""Settings in s, dB and DN against a camera of wood that counts in µs, dB and per cent."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from drivers.cameras import aravis_camera
from drivers.cameras.aravis_camera import AravisCamera
from drivers.cameras.camera_quirks import quirks_for
from drivers.cameras.feature_access import FeatureAccess
from drivers.cameras.settings_access import SettingsAccess
from radiometer.devices import CameraIdentity, CameraSettings, Roi
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, SettingOutOfRange

WANTED = CameraSettings(0.005, gain_db=6.0, black_level_dn=81.9, pixel_format="Mono12p", roi=Roi(16, 8, 64, 48))


class WoodenAravis:
    """Remembers what it was set to, in its own units."""

    def __init__(self) -> None:
        self.set = {"exposure_time": 10_000.0, "gain": 0.0, "black_level": 0.0}
        self.format, self.region = "Mono8", (0, 0, 1616, 1240)

    def is_feature_available(self, _name: str) -> bool:
        return False

    def is_gain_available(self) -> bool:
        return True

    is_black_level_available = is_gain_available

    def is_binning_available(self) -> bool:
        return False

    def get_exposure_time_bounds(self) -> tuple[float, float]:
        return (11.0, 30e6)

    def get_gain_bounds(self) -> tuple[float, float]:
        return (0.0, 47.9943)

    def get_black_level_bounds(self) -> tuple[float, float]:
        return (0.0, 12.5)

    def dup_available_pixel_formats_as_strings(self) -> list[str]:
        return ["Mono8", "Mono12p", "Mono16", "BayerRG8"]

    def get_sensor_size(self) -> SimpleNamespace:
        return SimpleNamespace(width=1616, height=1240)

    def get_pixel_format_as_string(self) -> str:
        return self.format

    def set_pixel_format_from_string(self, name: str) -> None:
        self.format = name

    def set_region(self, *region: int) -> None:
        self.region = region

    def get_region(self) -> SimpleNamespace:
        return SimpleNamespace(**dict(zip(("x", "y", "width", "height"), self.region, strict=True)))

    def get_device(self) -> SimpleNamespace:
        return SimpleNamespace(get_feature=lambda _name: SimpleNamespace(get_unit=lambda: "%"))

    def __getattr__(self, name: str):
        kind, _, setting = name.partition("_")
        if kind == "set" and setting in self.set:
            return lambda value: self.set.__setitem__(setting, value)
        if kind == "get" and setting in self.set:
            return lambda: self.set[setting]
        if name.endswith("_increment"):
            return lambda: 4
        raise AttributeError(name)


@pytest.fixture
def access(library_error) -> SettingsAccess:
    """Return the settings of a wooden Blackfly."""
    camera = WoodenAravis()
    features = FeatureAccess(camera, "camera W1", library_error)
    return SettingsAccess(camera, features, quirks_for("FLIR", "BFS-U3-19S4M"), "camera W1")


def test_the_camera_is_sent_microseconds_and_per_cent(access):
    """5 ms are 5000 µs; 81.9 DN of 4095 are 2 %; 6 dB are 6 dB."""
    access.write(WANTED)
    assert access.camera.set == pytest.approx({"exposure_time": 5000.0, "gain": 6.0, "black_level": 2.0})
    assert access.camera.region == (16, 8, 64, 48)


def test_what_is_read_back_is_what_the_camera_says(access):
    """Its own rounding comes back in s, dB and DN: 4999.16 µs are not 5 ms."""
    access.write(WANTED)
    access.camera.set.update(exposure_time=4999.16, gain=5.9998, black_level=1.953125)
    found = access.read()
    assert found.exposure_s == pytest.approx(4.99916e-3, rel=1e-12)
    assert (found.gain_db, found.pixel_format, found.roi) == (5.9998, "Mono12p", Roi(16, 8, 64, 48))
    assert found.black_level_dn == pytest.approx(79.98046875)


@pytest.mark.parametrize(("name", "full_scale"), [("Mono8", 255), ("Mono12p", 4095), ("Mono16", 4095)])
def test_limits_come_in_seconds_and_in_the_formats_own_numbers(access, name, full_scale):
    """Mono16 of this family holds twelve bits, so that a per cent of black level is 40.95 DN in it too."""
    limits = access.capabilities(name)
    assert limits.exposure_s == pytest.approx((11e-6, 30.0))
    assert limits.black_level_dn == pytest.approx((0.0, 0.125 * full_scale))
    assert limits.pixel_formats == ("Mono8", "Mono12p", "Mono16", "BayerRG8")


@pytest.mark.parametrize("exposure_s", [10e-6, 31.0])
def test_nothing_is_written_where_a_value_is_out_of_range(access, exposure_s):
    """The refusal gives the limits in s, and the camera keeps what it had."""
    before = dict(access.camera.set)
    with pytest.raises(SettingOutOfRange, match=r"allowed is 1\.1e-05 to 30 s"):
        access.check(replace(WANTED, exposure_s=exposure_s))
    assert access.camera.set == before


@pytest.mark.parametrize("error", [DeviceInUse("held by another"), DeviceLost("gone"), DeviceError("refused")])
def test_an_opening_that_fails_says_why_and_can_be_tried_again(monkeypatch, error):
    """The reason reaches whoever opens, and the camera is not taken for open: a second try asks it again."""
    asked = []

    def fail(*_arguments: object) -> None:
        asked.append(1)
        raise error

    monkeypatch.setattr(aravis_camera, "open_session", fail)
    monkeypatch.setattr(
        aravis_camera, "load_library", lambda: SimpleNamespace(aravis=None, glib=SimpleNamespace(Error=RuntimeError))
    )
    camera = AravisCamera(CameraIdentity("FLIR", "BFS", "W1", "FLIR-W1"))
    for _ in range(2):
        with pytest.raises(type(error), match=str(error)):
            camera.open()
    assert len(asked) == 2

"""What every camera must do, real or simulated: above the device layer they cannot be distinguished."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from radiometer.devices import Camera, CameraSettings, Roi
from radiometer.errors import DeviceError, DeviceInUse, SettingOutOfRange


@pytest.fixture
def settings(subject, camera):
    """Return settings that any camera can take, over a small region."""
    formats = camera.capabilities.pixel_formats
    return CameraSettings(
        exposure_s=subject.exposure_s,
        black_level_dn=camera.capabilities.black_level_dn[0],
        pixel_format="Mono12" if "Mono12" in formats else subject.native,
        roi=subject.roi,
    )


def test_a_camera_fulfils_the_protocol(camera, subject):
    """The driver has every member, says who it is, and its bounds run from low to high, exposures in seconds."""
    assert isinstance(camera, Camera)
    assert camera.identity.vendor
    assert camera.identity.model
    assert camera.identity.serial
    limits = camera.capabilities
    assert 0 < limits.exposure_s[0] < 1e-3 < 1 < limits.exposure_s[1] <= 3600
    assert limits.gain_db[0] <= limits.gain_db[1]
    assert limits.black_level_dn[0] <= limits.black_level_dn[1]
    assert limits.width > 0
    assert limits.height > 0
    assert subject.native in limits.pixel_formats


def test_configure_returns_what_is_read_back(camera, settings):
    """What `configure` returns is what `settings` says afterwards, and it is what was asked for."""
    in_force = camera.configure(settings)
    assert in_force == camera.settings
    assert in_force.exposure_s == pytest.approx(settings.exposure_s, rel=1e-6)
    assert replace(in_force, exposure_s=settings.exposure_s) == settings


@pytest.mark.parametrize(
    ("setting", "wrong", "message"),
    [
        ("exposure_s", lambda low, _: low / 2, "exposure time .* s is out of range; allowed is {:g} to {:g} s"),
        ("exposure_s", lambda _, high: 2 * high, "exposure time .* s is out of range; allowed is {:g} to {:g} s"),
        ("gain_db", lambda _, high: high + 1, "gain .* dB is out of range; allowed is {:g} to {:g} dB"),
        ("black_level_dn", lambda *_: 60_000, "black level .* DN is out of range; allowed is .* DN"),
    ],
    ids=["too short", "too long", "gain", "black level"],
)
def test_a_setting_outside_the_limits_is_refused_with_limits_and_unit(camera, settings, setting, wrong, message):
    """The message gives value, limits and unit, and nothing was changed."""
    before, limits = camera.configure(settings), camera.capabilities
    low, high = getattr(limits, setting)
    asked = {"exposure_s": 0.5, "gain_db": limits.gain_db[1], setting: wrong(low, high)}
    with pytest.raises(SettingOutOfRange, match=message.format(low, high)):
        camera.configure(replace(settings, **asked))
    assert camera.settings == before


@pytest.mark.parametrize("roi", [Roi(-1, 0, 8, 8), Roi(0, 0, 100_000, 8), Roi(0, 0, 8, 0), Roi(8, 100_000, 8, 8)])
def test_a_region_off_the_sensor_is_refused_with_its_limits(camera, settings, roi):
    """A region that leaves the sensor is refused in pixels, and nothing was changed."""
    before = camera.configure(settings)
    with pytest.raises(SettingOutOfRange, match=r"(?i)roi .* (px|pixels) is out of range"):
        camera.configure(replace(settings, roi=roi, exposure_s=0.5))
    assert camera.settings == before


def test_an_unknown_pixel_format_is_refused_with_those_on_offer(camera, settings, subject):
    """The message names the formats that there are."""
    with pytest.raises(DeviceError, match=subject.native):
        camera.configure(replace(settings, pixel_format="YUV422_8"))


def test_frames_have_the_region_and_the_settings_read_back(camera, settings, subject):
    """Every frame carries size and settings in force; numbers and times rise, and complete frames are counted."""
    in_force = camera.configure(settings)
    frames = camera.capture(3)
    assert [f.shape for f in frames] == [(subject.roi.height, subject.roi.width)] * 3
    assert {f.settings.exposure_s for f in frames} == {in_force.exposure_s}
    assert {f.settings.gain_db for f in frames} == {in_force.gain_db}
    assert {f.settings.black_level_dn for f in frames} == {in_force.black_level_dn}
    assert all(a.frame_id < b.frame_id for a, b in itertools.pairwise(frames))
    assert all(a.settings.timestamp_s < b.settings.timestamp_s for a, b in itertools.pairwise(frames))
    camera.capture(1)
    assert camera.counts.frames == 4


def test_digital_numbers_are_right_aligned_in_every_format(camera, settings):
    """No digital number is above full scale, whatever the format on the wire."""
    for name in camera.capabilities.pixel_formats:
        camera.configure(replace(settings, pixel_format=name))
        frame = camera.capture(1)[0]
        assert frame.dn.dtype == (np.uint8 if frame.bit_depth <= 8 else np.uint16), name
        assert int(frame.dn.max()) <= frame.full_scale_dn, name
        assert frame.bit_depth == camera.description.bit_depth, name


def test_the_whole_sensor_is_the_region_where_none_is_named(room_for_frames, camera, settings):
    """Without a region the frame is as large as the capabilities say."""
    assert camera.configure(replace(settings, roi=None)).roi is None
    assert camera.capture(1)[0].shape == (camera.capabilities.height, camera.capabilities.width)


def test_a_stream_yields_until_it_is_closed(camera, settings):
    """Frames until it is closed, then a capture works; triggered ones come as asked for, without a gap."""
    camera.configure(settings)
    stream = camera.stream()
    frames = list(itertools.islice(stream, 4))
    stream.close()
    assert len({f.frame_id for f in frames}) == 4
    assert len(camera.capture(1)) == 1
    camera.configure(replace(settings, software_trigger=True))
    first, second = camera.capture(1)[0], camera.capture(1)[0]
    assert second.frame_id == first.frame_id + 1
    assert camera.configure(replace(settings, software_trigger=False)).software_trigger is False


def test_a_second_opener_is_refused_because_the_camera_is_in_use(camera, subject):
    """Whoever opens a camera that is open gets DeviceInUse, and the first keeps it."""
    with pytest.raises(DeviceInUse, match=r"in use|open already"):
        subject.second(camera).open()
    assert camera.capture(1)


def test_a_closed_camera_refuses_use(subject):
    """Without opening, settings and capture raise DeviceError; closing it twice does nothing."""
    made = subject.make()
    with pytest.raises(DeviceError, match="not open"):
        made.capture(1)
    made.close()
    made.close()


def test_a_camera_can_be_closed_and_opened_again(camera, settings):
    """After reopening it captures as before."""
    camera.close()
    camera.open()
    camera.configure(settings)
    assert len(camera.capture(1)) == 1


def test_a_shutter_closes_or_is_refused(camera, settings):
    """Where there is a shutter, dark frames say so; where there is none, closing it is an error."""
    camera.configure(settings)
    if not camera.capabilities.has_shutter:
        with pytest.raises(DeviceError, match="no shutter"):
            camera.set_shutter(closed=True)
        return
    camera.set_shutter(closed=True)
    assert camera.capture(1)[0].settings.is_dark
    camera.set_shutter(closed=False)
    assert not camera.capture(1)[0].settings.is_dark

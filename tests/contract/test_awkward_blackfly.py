"""A Blackfly as awkward as the real one, on the wire: what a plain simulated one never asked of the driver."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from drivers.cameras.aravis_camera import AravisCamera, open_camera
from drivers.cameras.camera_checks import check_features
from radiometer.data import LensDescription
from radiometer.devices import CameraIdentity, CameraSettings, Health

LOOPBACK = "127.0.0.1"
SETTINGS = CameraSettings(exposure_s=0.004, black_level_dn=64, pixel_format="Mono12p")
# Electrons of the even field in 4 ms, from E = πL/(4N²) with the preset's pitch, efficiency and gain.
PHOTON_J = 6.62607015e-34 * 299_792_458 / 550e-9
ELECTRONS = np.pi * 0.4 / (4 * 4.0**2) * 4.5e-6**2 * 0.004 / PHOTON_J * 0.62
SIGNAL_DN = ELECTRONS / 5.95
U_REL = 5 / np.sqrt(ELECTRONS * 160 * 120) + 0.02 / SIGNAL_DN  # five sigma of a mean, and the dark signal


def opened():
    return open_camera(LOOPBACK, lens=LensDescription(focal_length_mm=16, f_number=4.0))


def test_it_is_taken_for_a_real_blackfly(awkward):
    """The family's own quirk file and the preset of the GigE twin are found, and its number is hexadecimal."""
    with opened() as camera:
        assert camera.session.quirks.load_default_user_set
        assert camera.session.quirks.mono16_left_aligned_bits == 12
        assert camera.description.pixel_pitch_um == 4.5
        assert camera.identity.serial == "0138C343"


def test_it_offers_no_plain_mono12(awkward):
    """Formats of the family that this model does not have are not taken for its own; one it has is in force."""
    with opened() as camera:
        assert camera.capabilities.pixel_formats == ("Mono8", "Mono10p", "Mono12Packed", "Mono12p", "Mono16")
        assert camera.settings.pixel_format in camera.capabilities.pixel_formats


@pytest.mark.parametrize("name", ["Mono8", "Mono10p", "Mono12p", "Mono12Packed", "Mono16"])
def test_every_format_carries_the_light_of_the_scene(awkward, name):
    """Mono16 holds twelve bits at its top: right-aligned, it has the same digital numbers as Mono12p."""
    with opened() as camera:
        camera.configure(replace(SETTINGS, pixel_format=name, black_level_dn=0))
        frames = camera.capture(2)
    scale = 4095 / frames[0].full_scale_dn
    found = np.mean([frame.dn for frame in frames]) * scale
    assert frames[0].bit_depth == {"Mono8": 8, "Mono10p": 10}.get(name, 12)
    assert found == pytest.approx(SIGNAL_DN, rel=U_REL, abs=0.5 * scale if scale > 1 else 0)


def test_chunks_tell_the_two_frames_that_are_still_of_the_settings_before(awkward):
    """From 4 ms to 30 s, two frames of 4 ms are thrown away and the first of 30 s is taken: one exposure, not three."""
    with opened() as camera:
        camera.configure(replace(SETTINGS, software_trigger=True))
        camera.capture(3)
        before, discarded = len(awkward.exposed_s), camera.counts.extra["stale_discarded"]
        camera.configure(replace(SETTINGS, software_trigger=True, exposure_s=30.0))
        assert camera.capture(1)[0].settings.exposure_s == 30.0
        assert awkward.exposed_s[before:] == [0.004, 0.004, 30.0]
        assert camera.counts.extra["stale_discarded"] - discarded == 2


def test_no_frame_mixes_two_settings(awkward):
    """After a change of exposure, gain or black level alone, a frame has the brightness of its own settings."""
    changes = [
        {"exposure_s": 0.008},
        {"gain_db": 6.0205999},
        {"black_level_dn": 200.0},
        {"exposure_s": 0.002},
        {"gain_db": 0.0},
        {"black_level_dn": 20.0},
    ]
    required = SETTINGS
    with opened() as camera:
        for change in changes:
            required = replace(required, **change)
            camera.configure(required)
            frame = camera.capture(1)[0]
            gain = required.exposure_s / 0.004 * 10 ** (required.gain_db / 20)
            expected = required.black_level_dn + SIGNAL_DN * gain
            assert frame.dn.mean() == pytest.approx(expected, abs=3 * U_REL * SIGNAL_DN * gain), change


def test_the_shortest_exposure_is_not_taken_for_another_one(awkward):
    """At 11 µs a step of the exposure time is 9 %: the frame of the setting comes, in whole µs as it was read back."""
    with opened() as camera:
        assert camera.configure(replace(SETTINGS, exposure_s=11.4e-6)).exposure_s == pytest.approx(11e-6)
        assert camera.capture(1)[0].settings.exposure_s == pytest.approx(11e-6)
        camera.configure(replace(SETTINGS, exposure_s=12e-6))
        assert camera.capture(1)[0].settings.exposure_s == pytest.approx(12e-6)


def test_running_numbers_rise_over_their_sixteen_bits(serve_awkward):
    """Frames 65533 to 65535 are followed by 65536 and so on, in order and none counted as missed."""
    serve_awkward(first_frame_id=65530)
    with opened() as camera:
        camera.configure(SETTINGS)
        stream = camera.stream()
        ids = [frame.frame_id for frame in itertools.islice(stream, 12)]
        stream.close()
        assert all(b > a for a, b in itertools.pairwise(ids))
        assert ids[0] < 65536 < ids[-1]
        assert ids[-1] - ids[0] - 11 == camera.counts.extra["missed_frames"] + camera.counts.incomplete


def test_a_locked_frame_rate_is_a_note_of_the_doctor(awkward):
    """The camera refuses to have it off: it opens all the same, and `doctor` says so."""
    with opened() as camera:
        found = check_features(camera)
    (note,) = [f for f in found if "AcquisitionFrameRateEnable" in f.message]
    assert note.health is Health.NOTE
    assert "stays at True" in note.message


def test_its_test_pattern_is_switched_off(awkward):
    """It arrives with a pattern behind the second selector entry, which hides the light altogether."""
    with opened() as camera:
        states = [f.state for f in camera.session.hygiene if f.feature.name == "TestPattern"]
        assert states == ["off", "switched_off"]
        camera.configure(replace(SETTINGS, black_level_dn=0))
        assert camera.capture(1)[0].dn.std() < 0.1 * SIGNAL_DN


def test_nothing_is_dropped_on_a_link_that_carries_little_less_than_it_should(awkward):
    """As shipped it sends at the link's nominal speed, which loses a packet of every frame; opened, it does not.

    The link itself says what it lost: on a busy machine the library gives up frames that come whole, but too late for
    it (100 ms behind their first packet).
    """
    with opened() as camera:
        assert camera.session.throughput.limit_bytes_s == 112_500_000
        camera.configure(SETTINGS)
        camera.capture(10)
        assert awkward.frames_sent >= 10
        assert awkward.frames_cut == 0


def test_a_slow_link_slows_the_camera_down(serve_awkward):
    """Where no frame comes whole at the link's nominal speed, the camera is slowed down until they do."""
    served = serve_awkward(link_bytes_s=70_000_000)
    with AravisCamera(CameraIdentity("", "", "", LOOPBACK), frame_deadline_s=0.5) as camera:
        camera.configure(SETTINGS)
        assert camera.capture(2)
        limit = camera.session.throughput.limit_bytes_s
        assert 0.5 * 70_000_000 < limit <= 70_000_000
        whole = camera.counts.incomplete
        camera.capture(3)
        assert camera.counts.incomplete == whole
    assert 40 < served.frames_cut < served.frames_sent

"""What only a real camera can show; point it at a steady, even light first.

RADIOMETER_CAMERA=22500001 python -m pytest tests/hardware
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from radiometer.bench.doctor import check_camera
from radiometer.devices import CameraSettings, Health

pytestmark = pytest.mark.hardware


@pytest.fixture
def settings(camera) -> CameraSettings:
    """Return the settings in force, at the whole sensor and 10 ms."""
    return replace(camera.settings, exposure_s=0.01, gain_db=camera.capabilities.gain_db[0], roi=None)


def test_nothing_that_falsifies_is_left_on(camera):
    """Every falsifying feature that the camera has is off."""
    assert [str(f) for f in camera.session.hygiene if f.state == "still_on"] == []


def test_the_doctor_finds_no_fault(camera, settings):
    """Frame rate, temperature, dark level and linearity are sound."""
    camera.configure(settings)
    assert [f for f in check_camera(camera) if f.health in (Health.FAULT, Health.WARNING)] == []


def test_a_change_of_exposure_is_in_force_with_the_next_frame(camera, settings):
    """Over twenty changes between two exposures every frame has the brightness of its own, within 2 %."""
    means: dict[float, list[float]] = {0.004: [], 0.008: []}
    for exposure_s in itertools.islice(itertools.cycle(means), 20):
        camera.configure(replace(settings, exposure_s=exposure_s))
        means[exposure_s].append(float(np.mean(camera.capture(1)[0].dn)))
    for exposure_s, values in means.items():
        assert np.ptp(values) < 0.02 * np.mean(values), exposure_s


def test_a_hundred_frames_come_in_order(camera, settings):
    """A hundred frames in a row have rising numbers and times, and what is missing was counted."""
    camera.configure(replace(settings, exposure_s=0.001))
    missed = camera.counts.extra["missed_frames"]
    stream = camera.stream()
    frames = list(itertools.islice(stream, 100))
    stream.close()
    gaps = sum((b.frame_id - a.frame_id - 1) % 65535 for a, b in itertools.pairwise(frames))
    assert all(a.settings.timestamp_s < b.settings.timestamp_s for a, b in itertools.pairwise(frames))
    assert gaps <= camera.counts.extra["missed_frames"] - missed + camera.counts.incomplete


def test_all_formats_show_the_same_light(camera, settings):
    """Every pixel format gives the same fraction of full scale above black, within 2 %: none is shifted or swapped."""
    fractions = {}
    for name in camera.capabilities.pixel_formats:
        scale = 1.0 if name != "Mono8" else 1 / 16
        camera.configure(replace(settings, pixel_format=name, black_level_dn=settings.black_level_dn * scale))
        frame = camera.capture(2)[-1]
        fractions[name] = float(frame.dn.mean()) / frame.full_scale_dn
    assert max(fractions.values()) - min(fractions.values()) < 0.02 * max(fractions.values()), fractions

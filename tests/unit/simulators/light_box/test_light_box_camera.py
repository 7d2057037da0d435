"""What a camera sees of a simulated box: light adds up, its wavelength is a mean by radiance, time is shared."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from radiometer.data import CameraDescription, LensDescription
from radiometer.devices import CameraCapabilities, CameraSettings
from simulators.chain.camera_model import CameraModel
from simulators.clock import SimulatedClock
from simulators.light_box.camera import BoxView, HookedClock, LightBoxCamera


class Named(NamedTuple):
    name: str


class Settings(NamedTuple):
    channels: list[Named]


class Shining(NamedTuple):
    radiance_w_sr_m2: float
    peak_nm: float | None


class Twin:
    """A box whose channels shine as they are set, brighter by one part per second."""

    def __init__(self, **channels: tuple[float, float | None]) -> None:
        self.channels, self.time_s = channels, 0.0
        self.settings = Settings([Named(name) for name in channels])

    def emission(self, name: str, time_s: float) -> Shining:
        assert time_s >= self.time_s, "a box is not asked for what is past"
        radiance, peak_nm = self.channels[name]
        return Shining(radiance * (1.0 + time_s), peak_nm)


def seen(ambient: float = 0.0, time_s: float = 0.0, **channels: tuple[float, float | None]) -> tuple[float, float]:
    twin: Any = Twin(**channels)
    return BoxView(twin, ambient).look(time_s)


def test_a_box_is_seen_with_its_room_as_it_is_at_that_moment() -> None:
    """Radiances add, wavelengths are a mean by radiance; ten seconds later it is brighter."""
    assert seen(red=(3.0, 640.0)) == (3.0, 640.0)
    assert seen(red=(3.0, 640.0), blue=(1.0, 440.0)) == pytest.approx((4.0, 590.0))
    assert seen(white=(2.0, None)) == (2.0, 555.0)
    assert seen(1.0, red=(1.0, 655.0)) == pytest.approx((2.0, 605.0))
    assert seen(red=(0.0, 640.0)) == (0.0, 555.0)
    assert seen(time_s=10.0, red=(3.0, 640.0)) == pytest.approx((33.0, 640.0))
    twin: Any = Twin(red=(3.0, 640.0))
    twin.time_s = 4.0
    assert BoxView(twin).look(1.0) == pytest.approx((15.0, 640.0))


def test_a_hooked_clock_lets_the_time_pass_that_is_set() -> None:
    """What keeps the time is asked for it and waits as long as is stated, 0 too; backwards nothing goes."""
    now = [5.0]

    def wait(seconds: float) -> None:
        now[0] += seconds

    clock = HookedClock(lambda: now[0], wait)
    clock.advance(2.5)
    clock.advance(0.0)
    assert clock.now_s() == 7.5
    with pytest.raises(ValueError, match="0 or more"):
        clock.advance(-0.1)
    assert clock.now_s() == 7.5


def test_a_frame_shows_the_light_of_its_moment() -> None:
    """Twice the radiance lifts the mean above black twice as far; a dark box shows black."""
    description = CameraDescription(bit_depth=12, pixel_pitch_um=4.5, conversion_gain_e_per_dn=2.6, read_noise_e=1.0,
                                    full_well_e=10_500, black_level_dn=64, quantum_efficiency=0.6)  # fmt: skip
    lens = LensDescription(focal_length_mm=16, f_number=4.0)
    twin: Any = Twin(red=(0.05, 640.0))
    limits = CameraCapabilities((1e-5, 1.0), (0.0, 24.0), (0.0, 255.0), ("Mono12",), 32, 24)
    clock = SimulatedClock()
    means = []
    with LightBoxCamera(CameraModel.ideal(description, lens), BoxView(twin), limits=limits, clock=clock) as camera:
        camera.configure(CameraSettings(exposure_s=0.01, black_level_dn=64.0))
        for radiance in (0.0, 0.05, 0.1):
            twin.channels["red"] = (radiance / (1.0 + clock.now_s()), 640.0)
            (frame,) = camera.capture(1)
            means.append(float(np.mean(frame.dn)))
    black, once, twice = means
    assert black == pytest.approx(64.0, abs=1.0)
    assert once - black > 100.0
    assert (twice - black) / (once - black) == pytest.approx(2.0, rel=0.02)

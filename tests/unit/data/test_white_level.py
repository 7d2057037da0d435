"""The white level that frames show: where saturated pixels pile up, and what is no such pile."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from radiometer.data import CameraDescription, Frame, FrameSettings
from radiometer.data.pile_up import with_white_levels
from radiometer.data.white_level import WhiteLevel, white_level_notes

BITS, FULL, BLACK = 14, 16_383, 600
SHAPE = (96, 128)


@dataclass(frozen=True)
class Sensor:
    """A sensor that is full below the converter's end, with noise behind that and stray pixels above it."""

    white: float
    spread_dn: float = 0.0
    strays: int = 0
    dn_per_e: float = 0.3
    read_dn: float = 3.0

    def frame(self, light_dn, settings, rng):
        """Return a frame of a mean signal in DN above black, and where it is saturated."""
        dn = BLACK + rng.normal(light_dn, np.sqrt(self.dn_per_e * light_dn + self.read_dn**2))
        full = dn >= self.white
        end = self.white + rng.normal(0.0, self.spread_dn, light_dn.shape)
        dn = np.where(full, end, np.minimum(dn, end))
        places = np.flatnonzero(full)
        few = rng.choice(places, min(self.strays, places.size // 5), replace=False)
        dn.ravel()[few] = rng.uniform(self.white, max(self.white, FULL), few.size)
        return Frame(np.rint(dn).clip(0, FULL).astype(np.uint16), BITS, settings), full

    def bracket(self, light, times, rng, gain_db=0.0):
        """Return frames of growing exposure and their saturated pixels; `light` in DN per s at 0 dB."""
        factor = 10.0 ** (gain_db / 20.0)
        settings = [FrameSettings(float(t), gain_db, black_level_dn=float(BLACK)) for t in times]
        return [self.frame(light * s.exposure_s * factor, s, rng) for s in settings]


def ramp(rng):
    return np.linspace(0.02, 1.0, SHAPE[1]) * np.ones((SHAPE[0], 1))


def patches(rng):
    return np.kron(np.exp(rng.uniform(-4.0, 0.0, (6, 8))), np.ones((16, 16)))


def pixels(rng):
    return np.exp(rng.uniform(-5.0, 0.0, SHAPE))


def wall_and_shade(rng):
    """An evenly lit wall that fills two thirds of the picture."""
    light = np.full(SHAPE, 0.02) * np.linspace(0.3, 1.0, SHAPE[1])
    light[:, SHAPE[1] // 3 :] = 1.0
    return light


SCENES = (ramp, patches, pixels, wall_and_shade)


def level_of(frames):
    (level,) = {frame.settings.white_level for frame in with_white_levels(frames)}
    return level


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(("share", "spread_dn", "strays"), [(0.7, 0.0, 0), (0.85, 0.4, 200), (0.96, 3.0, 60)])
def test_saturated_pixels_are_marked_and_others_are_not(scene, share, spread_dn, strays):
    """At least 99 % of the pixels of a full sensor are marked, and none lower than 6 standard deviations of its end."""
    rng = np.random.default_rng(29)
    sensor = Sensor(round(share * FULL), spread_dn, strays)
    taken = sensor.bracket(3.0 * (sensor.white - BLACK) * scene(rng), (1 / 16, 1 / 4, 1.0), rng)
    level = level_of([frame for frame, _ in taken])
    full = np.concatenate([frame.dn[saturated] for frame, saturated in taken])
    assert level.basis == "measured"
    assert np.mean(full >= level.saturated_dn) >= 0.99
    assert level.saturated_dn >= sensor.white - 6.0 * spread_dn - 2.0
    assert level.measured_dn == pytest.approx(sensor.white, abs=1.0 + 0.5 * spread_dn)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("reached", [0.3, 0.97])
def test_light_below_saturation_is_no_pile_up(scene, reached):
    """A wall just below the end, a ramp, or patches: the bit depth counts, and what the frames reach is known."""
    rng = np.random.default_rng(31)
    sensor = Sensor(1.2 * FULL)  # the converter ends first
    taken = sensor.bracket(reached * (FULL - 600 - BLACK) * scene(rng), (1 / 16, 1 / 4, 1.0), rng)
    level = level_of([frame for frame, _ in taken])
    assert (level.basis, level.saturated_dn, level.measured_dn) == ("assumed", FULL, None)
    assert level.reached_dn == pytest.approx(BLACK + reached * (FULL - 600 - BLACK), rel=0.06)
    assert level.note is None


_BANDS = 1.0 + 0.1 * np.sin(np.linspace(0.0, 20.0, SHAPE[0]))[:, None] * np.ones(SHAPE)


@pytest.mark.parametrize(
    ("light", "exposures"),
    [
        # Short exposures of a wall show bands of ± 10 %, the long one averages them: it spreads less and is not full.
        (lambda rng: np.ones(SHAPE), ((1 / 64, 1 / 64 * _BANDS), (1.0, 1.0))),
        # Two frames are alike at all levels where a camera did not take the longer time.
        (patches, ((0.01, 0.25), (0.04, 1.0), (0.16, 1.0))),
    ],
)
def test_what_is_alike_for_another_reason_is_no_pile_up(light, exposures):
    """Bands of a flickering light, and an exposure that was not changed: nothing is called saturated."""
    rng = np.random.default_rng(41)
    scene = 9000.0 * light(rng)
    frames = [
        Sensor(FULL).frame(scene * real, FrameSettings(label, black_level_dn=float(BLACK)), rng)[0]
        for label, real in exposures
    ]
    assert level_of(frames).basis == "assumed"


@pytest.mark.parametrize(
    ("stated", "used", "words"),
    [(FULL, "measured", "as the frames show: .* the file states 16383 DN"), (11_000, "stated", "the lower of the two")],
)
def test_a_stated_level_that_the_frames_contradict_is_reported(stated, used, words):
    """The lower of both counts: above the pile is no light, above the statement proportion is not promised."""
    rng = np.random.default_rng(43)
    sensor = Sensor(13_000, 1.0)
    taken = sensor.bracket(3.0 * 12_400 * ramp(rng), (1 / 16, 1 / 4, 1.0), rng)
    settings = [replace(frame.settings, white_level=WhiteLevel.stated(stated)) for frame, _ in taken]
    level = level_of([replace(frame, settings=one) for (frame, _), one in zip(taken, settings, strict=True)])
    assert level.basis == used
    assert level.saturated_dn == pytest.approx(min(13_000, stated), abs=6)
    (note,) = white_level_notes([level, level])
    assert re.search(words, note)


@pytest.mark.parametrize("step_dn", [1, 4, 16])
def test_padded_codes_end_below_full_scale(step_dn):
    """Of 14 bits with 4 of padding the highest code is 16368: a single exposure that reaches it is saturated there."""
    rng = np.random.default_rng(43)
    ((frame, _),) = Sensor(FULL).bracket(40_000 * ramp(rng), (1.0,), rng)
    padded = replace(frame, dn=(frame.dn // step_dn * step_dn).astype(np.uint16))
    assert level_of([padded]).saturated_dn == FULL + 1 - step_dn


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_a_pile_on_two_padded_codes_is_saturated_from_the_lower_one(share):
    """Rounding puts a part of the pile one code of 16 DN lower."""
    rng = np.random.default_rng(45)
    taken = [one for one, _ in Sensor(9_600).bracket(40_000 * ramp(rng), (1 / 16, 1 / 4, 1.0), rng)]
    *shorter, top = (one.dn // 16 * 16 for one in taken)
    top = np.where((top == 9_600) & (rng.random(top.shape) < share), 9_584, top)
    padded = [replace(one, dn=dn.astype(np.uint16)) for one, dn in zip(taken, [*shorter, top], strict=True)]
    assert level_of(padded).saturated_dn == (9_584 if share else 9_600)


def test_each_gain_has_its_own_end():
    """One frame assumes the bit depth; a well of 9000 DN at 0 dB, the converter's end at 12 dB."""
    rng = np.random.default_rng(47)
    ((frame, _),) = Sensor(13_000).bracket(40_000 * ramp(rng), (1.0,), rng)
    level = level_of([frame])
    assert level.saturated_dn == FULL
    camera = CameraDescription(bit_depth=16, code_step_dn=16)  # twelve bits, padded: no pixel reaches 65535
    assert camera.saturated_dn == 65_520
    assert CameraDescription(bit_depth=16, white_level_dn=50_000).saturated_dn == 50_000
    assert "the bit depth gives: a single exposure cannot show" in level.note
    rng = np.random.default_rng(53)
    low = Sensor(BLACK + 9_000.0, 2.0).bracket(40_000 * ramp(rng), (1 / 16, 1 / 4, 1.0), rng)
    high = Sensor(FULL, 0.0, dn_per_e=1.2).bracket(40_000 * ramp(rng), (1 / 16, 1 / 4, 1.0), rng, gain_db=12.0)
    found = {f.settings.gain_db: f.settings.white_level for f in with_white_levels([f for f, _ in (*low, *high)])}
    assert found[0.0].saturated_dn == pytest.approx(BLACK + 9_000 - 8, abs=4)
    assert found[12.0].saturated_dn == FULL


@pytest.mark.parametrize(("share", "expected"), [(0.7, 9_600), (1.5, FULL)])
def test_a_gain_that_shows_no_pile_takes_that_of_another_unless_it_goes_higher(share, expected):
    """One exposure at 12 dB: it ends where the frames at 0 dB do, but for areas of light above."""
    rng = np.random.default_rng(67)
    low = Sensor(9_600).bracket(40_000 * ramp(rng), (1 / 16, 1 / 4, 1.0), rng)
    high = Sensor(FULL).bracket(share * 9_000 / 4.0 * ramp(rng), (1.0,), rng, gain_db=12.0)
    found = {f.settings.gain_db: f.settings.white_level for f in with_white_levels([f for f, _ in (*low, *high)])}
    assert found[0.0].saturated_dn == pytest.approx(9_600, abs=2)
    assert found[12.0].saturated_dn == pytest.approx(expected, abs=2)

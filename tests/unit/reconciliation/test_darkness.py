"""Dark frames of real cameras: a black level that wanders, coarse thermometers, particle hits, exposures of zero."""

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, Frame, FrameEntry, FrameSettings
from radiometer.data.thermometer import regulated, uncertainty_of_readings
from radiometer.reconciliation.descent import first_state
from radiometer.reconciliation.design import Design
from radiometer.reconciliation.reduce import reduce_frames
from radiometer.reconciliation.repeatability import Darkness, drift_of_black, wander_of_black
from radiometer.reconciliation.shared_errors import errors_of_darkness
from radiometer.reconciliation.state import reweighted, with_effects
from simulators.effects.dark_current_nonuniformity import DarkCurrentNonuniformity
from simulators.effects.prnu import Prnu

SIZE = (48, 72)
NOISE_DN, BLACK_DN, E_PER_DN = 4.0, 200.0, 2.0


def _dark(settings, rng, offset=lambda n: 0.0, size=SIZE):
    """Return darks of (exposure in s, temperature in °C) at one frame each, with an offset by the frame's number."""
    entries, frames = [], []
    for number, (exposure_s, warm) in enumerate(settings):
        own = FrameSettings(exposure_s, temperature_c=warm, timestamp_s=10.0 * number, shutter="closed")
        dn = BLACK_DN + offset(number) + rng.normal(0.0, NOISE_DN, size)
        entries.append(FrameEntry.of(f"{number}.tif", own))
        frames.append(Frame(np.round(dn).astype(np.uint16), 16, own))
    camera = CameraDescription(bit_depth=16, conversion_gain_e_per_dn=E_PER_DN)
    design = Design.of(CaptureHeader(camera=camera, frames=tuple(entries)), size)
    return design, *reduce_frames(design, frames.__getitem__)


def test_a_black_level_that_wanders_is_measured_up_to_a_share_of_the_noise():
    """0.6 DN as a whole; 0.3 of the noise is the most."""
    rng = np.random.default_rng(5)
    repeats = [(0.01, 20.0)] * 40
    steps = rng.normal(0.0, 0.6, 40)
    design, seen, _ = _dark(repeats, rng, lambda n: float(steps[n]))
    assert wander_of_black(design, seen) == pytest.approx(0.6, rel=0.4)
    for steady in (lambda n: 0.0, lambda n: 0.1 * n, lambda n: 3.0 if n == 0 else 0.0):
        design, seen, _ = _dark(repeats, rng, steady)
        assert wander_of_black(design, seen) == 0.0
    rng = np.random.default_rng(6)
    steps = rng.normal(0.0, 40.0, 30)
    design, seen, _ = _dark([(0.01, 20.0)] * 30, rng, lambda n: float(steps[n]))
    assert wander_of_black(design, seen) == pytest.approx(0.3 * NOISE_DN, rel=0.05)


@pytest.mark.slow
def test_a_black_level_that_moves_within_frames_is_measured():
    """Half waves of 0.8 DN over their number, new in each frame, show 0.8 DN; what moves as a whole, or never, none."""
    rng = np.random.default_rng(15)
    number = np.arange(1, 5)
    waves = np.cos(np.pi * number * (np.arange(SIZE[0])[:, None] + 0.5) / SIZE[0])
    repeats, size = [(0.01, 20.0)] * 40, rng.normal(0.0, 0.8, (40, 4)) / number
    design, seen, _ = _dark(repeats, rng, lambda n: (waves @ size[n])[:, None])
    assert drift_of_black(design, seen) == pytest.approx(0.8, rel=0.4)
    for steady in (lambda n: 0.0, lambda n: size[n, 0], lambda n: 3.0 * waves[:, :1]):
        design, seen, _ = _dark(repeats, rng, steady)
        assert drift_of_black(design, seen) == 0.0


@pytest.mark.slow
def test_the_weights_hold_a_black_level_that_walks_at_random():
    """Rows that each add a random step to the row before: means, tilts and first frames scatter as the weights say."""
    rng, frames, series = np.random.default_rng(16), 5, 24
    step = 2.4 / np.sqrt(SIZE[0])

    def walk(number):
        return np.cumsum(rng.normal(0.0, step, SIZE[0]))[:, None]

    design, seen, images = _dark([(0.01 * (1 + n // frames), 20.0) for n in range(frames * series)], rng, walk)
    state = first_state(design, seen, images)
    for name in ("first", "slope_y"):
        squares = np.square(state.data_residual[state.comparison.cuts[name]])
        plain = np.square(getattr(seen, name) / state.comparison.deviation[name]).mean()
        assert plain > 1.8  # without the walk the weights would be wrong
        assert 0.5 < squares.mean() < 1.0 + 3.0 * np.sqrt(2.0 / squares.size), name


def test_readings_in_steps_are_known_to_a_step_and_one_setting():
    """0.42 K/√12; −4.82 and −5.23 °C belong together, −10.2 °C does not."""
    turns = np.array([-4.82, -5.23, -4.82, -5.23, -5.23, -10.2, -10.2, -10.2])
    assert uncertainty_of_readings(turns) == pytest.approx(0.41 / np.sqrt(12.0))
    assert uncertainty_of_readings(25.0 + np.random.default_rng(1).normal(0, 0.15, 40)) == 0.0
    assert uncertainty_of_readings(np.repeat([25.0, 35.0, 45.0], 9)) == 0.0
    assert uncertainty_of_readings(np.full(5, np.nan)) == 0.0
    warm = [-4.82, -5.23, -10.2, -4.82, -10.2, -5.23]
    entries = tuple(
        FrameEntry.of(f"{n}.tif", FrameSettings(t, temperature_c=w, shutter="closed"))
        for n, (t, w) in enumerate(zip([60.0, 10.0] * 3, warm, strict=True))
    )
    design = Design.of(CaptureHeader(camera=CameraDescription(bit_depth=16), frames=entries), SIZE)
    assert [capture.frames for capture in design.captures] == [(0,), (1, 3, 5), (2, 4)] or sorted(
        capture.frames for capture in design.captures
    ) == [(0,), (1, 3, 5), (2,), (4,)]


def _read_at(*warm):
    entries = tuple(
        FrameEntry.of(f"{n}.tif", FrameSettings(60.0, temperature_c=w, timestamp_s=60.0 * n, shutter="closed"))
        for n, w in enumerate(warm)
    )
    return CaptureHeader(camera=CameraDescription(bit_depth=16), frames=entries)


def _temperatures(header):
    return [entry.temperature_C for entry in regulated(header).frames]


def test_readings_in_turn_are_one_temperature_known_to_a_step():
    """0.41 K/√12; a drift, and steps alone, stay as read."""
    turns = (-4.82, -5.23, -4.82, -5.23, -5.23, -10.2, -10.2, -10.2)
    mean = (2 * -4.82 + 3 * -5.23) / 5
    assert _temperatures(_read_at(*turns)) == pytest.approx([mean] * 5 + [-10.2] * 3)
    drift = (-4.82, -4.82, -4.82, -5.23, -5.23, -5.23)
    assert _temperatures(_read_at(*drift)) == pytest.approx(list(drift))
    wide = (-4.82, -5.23, -5.64, -4.82, -5.64, -5.23, -4.82, -5.23, -5.64)  # over three steps: it moves
    assert _temperatures(_read_at(*wide)) == pytest.approx(list(wide))
    design = Design.of(_read_at(-4.82, -5.23, -4.82, -5.23, -4.82, -5.23), SIZE)
    assert np.ptp(design.temperature_c) == 0.0
    assert design.reading_u_k == pytest.approx(0.41 / np.sqrt(12.0))


def test_darkness_moves_all_tiles_of_a_capture_together():
    """A wander of 2 DN gives means the covariance 4 DN², kelvins their warmth; few frames do not average it out."""
    rng = np.random.default_rng(7)
    design, _, _ = _dark([(0.01, 20.0)] * 4, rng)
    captures, tiles = len(design.captures), len(design.tiles)
    warmth = np.full((captures, tiles), 3.0)
    usable = {name: np.ones((captures, tiles), np.bool_) for name in ("mean", "first")}
    found = errors_of_darkness(design, usable, Darkness(2.0, 0.5, warmth))
    mean = sum(error.covariance("mean")[0] for error in found if "mean" in error.parts)
    assert mean == pytest.approx(np.full((tiles, tiles), 2.0**2 + (0.5 * 3.0) ** 2))
    first = sum(error.covariance("first")[0] for error in found if "first" in error.parts)
    assert first == pytest.approx(mean * (1.0 + 1.0 / 3.0))
    assert errors_of_darkness(design, usable, Darkness(0.0, 0.0, warmth)) == ()
    moving = errors_of_darkness(design, usable | {"slope_y": usable["mean"]}, Darkness(0.0, 0.0, warmth, drift_dn=0.8))
    assert {name for error in moving for name in error.parts} == {"mean", "first", "slope_y"}


def test_warmth_moves_tiles_and_variances_of_leaks_together():
    """Kelvins by 4 DN², leaks by 0.2 in ln of their variance per kelvin; 2·ln 2/7 of a pattern."""
    design, _, _ = _dark([(0.01, 20.0)] * 4, np.random.default_rng(7))
    shape = (len(design.captures), len(design.tiles))
    usable = {name: np.ones(shape, np.bool_) for name in ("mean", "first", "spatial")}
    swelling = {"spatial": np.full(shape, 0.2)}
    assert errors_of_darkness(design, usable, Darkness(0.0, 0.0, np.zeros(shape))) == ()
    found = errors_of_darkness(design, usable, Darkness(0.0, 0.5, np.zeros(shape), swelling))
    spatial = sum(error.covariance("spatial")[0] for error in found if "spatial" in error.parts)
    assert spatial == pytest.approx(np.full((shape[1], shape[1]), 0.1**2))
    assert errors_of_darkness(design, usable, Darkness(1.0, 0.0, np.zeros(shape), swelling))[-1].parts.keys() == {
        "first"
    }
    settings = [(10.0, warm) for warm in (20.0, 20.4, 20.0, 20.4, 20.0, 20.4)]
    design, seen, images = _dark(settings, np.random.default_rng(9))
    state = with_effects(first_state(design, seen, images), [DarkCurrentNonuniformity(10.0, 20.0, 7.0)])
    again = reweighted(state).comparison.whiteners["spatial"][0]
    shared = np.linalg.inv(again.T @ again)
    tile = np.sqrt(np.mean(shared[~np.eye(len(design.tiles), dtype=bool)]))
    share = float(np.median((state.prediction.fixed / state.prediction.spatial)[0]))
    assert tile == pytest.approx(share * 2.0 * np.log(2.0) / 7.0 * 0.4 / np.sqrt(12.0), rel=0.1)


def test_patterns_and_particles_move_what_they_may():
    """A track correlates no neighbours; without light no pattern of responsivity is asked for."""
    rng = np.random.default_rng(8)
    track = np.zeros((240, 360))
    track[20, 20:30] = 600.0
    _, seen, _ = _dark([(0.01, 20.0)] * 8, rng, lambda n: track if n == 4 else 0.0, track.shape)
    assert float(np.nanmax(np.abs(seen.neighbour_x))) < 0.1
    assert float(np.nanmax(np.abs(seen.neighbour_y))) < 0.1
    design, seen, images = _dark([(0.01, 20.0)] * 8, np.random.default_rng(10))
    state = reweighted(with_effects(first_state(design, seen, images), [Prnu(0.01)]))
    assert np.isfinite(state.cost)


def test_times_of_exposure_and_since_light_are_never_nothing():
    """Bias frames count as a thousandth of the shortest; darks by the last lit frame."""
    entries = tuple(
        FrameEntry.of(f"{n}.tif", FrameSettings(t, shutter="closed")) for n, t in enumerate((0.0, 10.0, 60.0))
    )
    header = CaptureHeader(camera=CameraDescription(bit_depth=16), frames=entries)
    assert sorted(Design.of(header, SIZE).exposure_s.tolist()) == pytest.approx([0.01, 10.0, 60.0])
    plain = header.model_copy(update={"frames": entries[1:]})
    assert Design.of(plain, SIZE).header is plain
    entries = tuple(
        FrameEntry.of(f"{n}.tif", FrameSettings(t, timestamp_s=at, shutter=shutter))
        for n, (t, at, shutter) in enumerate(
            ((1.0, 0.0, "closed"), (2.0, 20.0, "open"), (3.0, 30.0, "closed"), (4.0, 50.0, "closed"))
        )
    )
    design = Design.of(CaptureHeader(camera=CameraDescription(bit_depth=16), frames=entries), SIZE)
    assert design.since_light_s.tolist() == [np.inf, np.inf, 10.0, 30.0]

"""Where measured and simulated disagree, without any idea of why: places, steps in time and space, repeatability."""

from dataclasses import replace

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, FrameEntry, FrameSettings
from radiometer.reconciliation.design import Design
from radiometer.reconciliation.localise import axis_of, global_p_value, localise, places
from radiometer.reconciliation.repeatability import estimate_tau, repeats_of
from radiometer.reconciliation.thresholds import SIGNIFICANCE
from testing.reduced import start_of


def _design(times_s, warm_c):
    """Return captures of two frames each, two exposures in turn."""
    frames = tuple(
        FrameEntry(
            file=f"{i}.png",
            exposure_s=1e-3 * (1 + i // 2 % 2),
            timestamp_s=times_s[i // 2],
            temperature_C=warm_c[i // 2],
        )
        for i in range(2 * len(times_s))
    )
    return Design.of(CaptureHeader(camera=CameraDescription(bit_depth=12), frames=frames), (32, 48))


def test_settings_repeat_whatever_rounding_and_swings_do():
    """34.7 to 35.3 °C are one; τ stays at the 0.1 % of neighbours."""
    warm = [34.7, 34.9, 35.1, 35.3, 34.8, 35.2, 44.9, 45.1]
    ids = _design(list(np.arange(8) * 25.0), warm).setting_id
    assert ids.tolist() == [0, 1, 0, 1, 0, 1, 2, 3]
    rng = np.random.default_rng(5)
    captures = 120
    design = _design(np.cumsum(rng.uniform(20.0, 30.0, captures)).tolist(), [35.0] * captures)
    steady = 1e-3 * rng.standard_normal(captures)
    swing = 6e-3 * np.sin(2 * np.pi * design.timestamp_s / 800.0)
    noise = np.full(captures, 1e-10)
    still = estimate_tau(design, steady, noise)
    assert still == pytest.approx(1e-3, rel=4 / np.sqrt(2 * captures))
    # All captures together may raise it, but no further than the repeats allow: a factor of two at least stays open.
    assert still <= estimate_tau(design, steady + swing, noise) < 2.0 * still
    rng = np.random.default_rng(6)
    captures = 60
    design = _design((np.arange(captures) * 25.0).tolist(), [20.0 + 5.0 * (i // 4) for i in range(captures)])
    scale = 1e-3 * rng.standard_normal(captures)
    scale[17] += 0.26
    others = np.arange(captures) != 17
    found = estimate_tau(design, np.where(others, scale, 0.0), np.where(others, 1e-10, np.inf))
    assert found == pytest.approx(1e-3, rel=4 / np.sqrt(captures))
    assert estimate_tau(design, scale, np.full(captures, 1e-10)) < 3 * found


@pytest.mark.slow
def test_one_cause_is_one_place(make_capture):
    """A black level 0.5 DN too high differs along a dozen covariates; the list names it once, and no echo."""
    state = start_of(make_capture(seed=3, extra_dn=lambda setting: 0.5))
    tests = localise(state)
    listed = places(state, 4)
    assert len({axis_of(test.where, test.block) for test in listed}) == 4
    limit = np.log(SIGNIFICANCE / len(tests))
    assert sum(test.log_p < limit for test in tests) > 5
    assert [test.log_p < limit for test in listed] == [True, False, False, False]


@pytest.mark.slow
def test_places_of_halves_and_of_time_are_found(make_capture):
    """2 % along the width of the picture, 1 % three times in the session."""
    state = start_of(
        make_capture(seed=4, picture=lambda image, setting: image * (1 + 0.02 * (np.arange(image.shape[1]) >= 48)))
    )
    first = places(state, 1)[0]
    assert (first.block, first.where, axis_of(first.where, first.block)) == ("mean", "half_x", "image_x")
    clock = iter(range(10_000))

    def swing(image, setting):
        return image * (1 + 0.01 * np.sin(2 * np.pi * (next(clock) // 4) / 20.0))

    first = places(start_of(make_capture(seed=5, picture=swing)), 1)[0]
    assert (first.block, axis_of(first.where, first.block)) == ("mean", "timestamp_s")


@pytest.mark.slow
def test_global_p_lies_within_what_overlapping_tests_allow(declared):
    """Of tests that overlap the global p lies below Bonferroni's n·p, but not by more than their number of kinds."""
    tests = localise(declared)
    for chance in (1e-3, 1e-2):
        best = replace(tests[0], p_value=chance)
        found = global_p_value(declared, (best, *tests[1:]))
        assert 0.3 * len(tests) * chance < found <= min(1.25 * len(tests) * chance, 1.0)
    assert global_p_value(declared, (replace(tests[0], p_value=1e-9), *tests[1:])) == pytest.approx(len(tests) * 1e-9)


# What equal frames differ by: how far they scatter, which first frames and which frames stick out.


SIZE = (48, 72)
TILE_DN = 0.02  # scatter of a tile's mean by its pixels
SERIES, FRAMES = 6, 5


def _reported(apart_dn, *, light_dn=0.0, seed=1, tiles=None, first_dn=0.0):
    """Return what is reported of series of frames that lie so far from 1000 DN (dark) or from a light, each.

    Args:
        apart_dn: (series, frames) how far.
        light_dn: The light, 0 for a closed shutter.
        seed: Of the tiles' scatter.
        tiles: How many tiles count, all by default.
        first_dn: What the model has every first frame above the others by.
    """
    lit = light_dn > 0.0
    entries = tuple(
        FrameEntry.of(
            f"{n}.tif", FrameSettings(1.0 + n // FRAMES, timestamp_s=10.0 * n, shutter="open" if lit else "closed")
        )
        for n in range(apart_dn.size)
    )
    design = Design.of(CaptureHeader(camera=CameraDescription(bit_depth=16), frames=entries), SIZE)
    rng = np.random.default_rng(seed)
    means = 1000.0 + apart_dn.ravel()[:, None] + rng.normal(0.0, TILE_DN, (apart_dn.size, len(design.tiles)))
    shape = (len(design.captures), len(design.tiles))
    sensitivity = np.full(shape, light_dn)
    usable = np.broadcast_to(np.arange(shape[1]) < (shape[1] if tiles is None else tiles), shape)
    return repeats_of(design, lambda f: means[list(f)], usable, sensitivity, np.full(shape, first_dn), (0.1, 0.1))


def test_scatter_is_reported_in_dn_and_relative_to_light():
    """0.4 DN within 3 u of 24 degrees of freedom; 8 of 4000 DN are 0.2 %."""
    (dark,) = _reported(np.random.default_rng(2).normal(0.0, 0.4, (SERIES, FRAMES)))
    assert dark.scatter.u == pytest.approx(dark.scatter.value / np.sqrt(2 * SERIES * (FRAMES - 1)), rel=0.01)
    assert dark.scatter.value == pytest.approx(0.4, abs=3 * float(dark.scatter.u or 0))
    assert (dark.kind, dark.scatter.unit) == ("dark", "DN")
    (lit,) = _reported(np.random.default_rng(3).normal(0.0, 8.0, (SERIES, FRAMES)), light_dn=4000.0)
    assert lit.scatter.value == pytest.approx(0.002, abs=3 * float(lit.scatter.u or 0))
    assert "%" in lit.sentences()[0]


def test_first_frames_are_reported_with_the_scatter_of_their_tiles():
    """3 DN within three u, and so in JSON; of four tiles within five."""
    apart = np.zeros((SERIES, FRAMES))
    apart[2, 0] = 3.0
    (dark,) = _reported(apart)
    first, u = dark.series[2].apart[0], dark.series[2].u[0]
    assert first == pytest.approx(3.0, abs=4 * u)
    assert u == pytest.approx(1.2533 * TILE_DN * np.sqrt(FRAMES / (FRAMES - 1)) / np.sqrt(24), rel=0.5)
    assert dark.series[2].standing_out == (0,)
    assert sum(len(one.standing_out) for one in dark.series) == 1
    assert "first frame of a series" in dark.sentences()[1]
    (dark,) = _reported(np.random.default_rng(5).normal(0.0, 0.4, (SERIES, FRAMES)))
    mapping = dark.to_mapping()
    assert mapping["fitted_aside"] == 0.1
    assert [len(one["frames"]) for one in mapping["series"]] == [FRAMES] * SERIES
    assert mapping["said"][0].startswith(f"{SERIES * FRAMES} dark frames in {SERIES} series")
    apart = np.zeros((SERIES, FRAMES))
    apart[2, 0] = 3.0
    (dark,) = _reported(apart, tiles=4)
    u = np.array([u for one in dark.series for u in one.u])
    assert (u > 0).all()
    assert np.median(u) == pytest.approx(1.2533 * TILE_DN * np.sqrt(FRAMES / (FRAMES - 1)) / np.sqrt(4), rel=0.5)
    assert dark.series[2].apart[0] == pytest.approx(3.0, abs=0.1)


def test_frames_without_repeats_or_odd_ones_tell_nothing():
    """At most 0.1 % of 200 sets name one; pixels' own scatter is no wander."""
    rng, sets = np.random.default_rng(4), 200
    reported = [_reported(rng.normal(0.0, 0.4, (SERIES, FRAMES)), seed=n)[0] for n in range(sets)]
    named = sum(any(one.standing_out for one in dark.series) for dark in reported)
    assert named <= 0.001 * sets + 3 * np.sqrt(0.001 * sets)
    reported = [_reported(np.zeros((SERIES, FRAMES)), seed=n)[0] for n in range(40)]
    printed = [dark for dark in reported if dark.scatter.value > 2.0 * float(dark.scatter.u or 0.0)]
    assert len(printed) <= 4 + 3 * 2
    assert all(dark.scatter.value < TILE_DN for dark in reported)
    assert all(
        "series of one setting" not in text for dark in reported if dark not in printed for text in dark.sentences()
    )
    entries = tuple(FrameEntry.of(f"{n}.tif", FrameSettings(1.0 + n, shutter="closed")) for n in range(4))
    design = Design.of(CaptureHeader(camera=CameraDescription(bit_depth=16), frames=entries), SIZE)
    shape = (len(design.captures), len(design.tiles))
    usable, nothing = np.ones(shape, np.bool_), np.zeros(shape)
    assert repeats_of(design, lambda f: np.zeros((len(f), shape[1])), usable, nothing, nothing, (0.0, 0.0)) == ()


@pytest.mark.parametrize("tiles", [1, 3])
def test_frames_of_too_few_tiles_tell_nothing(tiles):
    """One tile has no scatter to say how well a frame's offset is known: nothing is stated, and never ± 0."""
    apart = np.random.default_rng(4).normal(0.0, 0.4, (SERIES, FRAMES))
    assert _reported(apart, tiles=tiles) == ()


@pytest.mark.parametrize("light_dn", [0.0, 400.0])
def test_what_the_model_says_of_first_frames_is_taken_off(light_dn):
    """First frames 3 DN above the others stick out of no series where an effect of 3 DN is named for it."""
    apart = np.zeros((SERIES, FRAMES))
    apart[:, 0] = 3.0
    (known,) = _reported(apart, light_dn=light_dn, first_dn=3.0)
    (unknown,) = _reported(apart, light_dn=light_dn)
    unit = 1.0 if light_dn == 0.0 else light_dn
    assert [one.apart[0] * unit for one in unknown.series] == pytest.approx([3.0] * SERIES, abs=0.05)
    assert [one.apart[0] * unit for one in known.series] == pytest.approx([0.0] * SERIES, abs=0.05)
    assert known.scatter.value * unit < 0.02

"""What equal frames differ by is reported: how far they scatter, which first frames and which frames stick out."""

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, FrameEntry, FrameSettings
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.repeatability import repeats_of

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


def test_the_scatter_of_dark_frames_is_reported_in_dn():
    """Frames of 0.4 DN scatter are reported 0.4 DN within three of the u that 24 degrees of freedom give."""
    (dark,) = _reported(np.random.default_rng(2).normal(0.0, 0.4, (SERIES, FRAMES)))
    assert dark.scatter.u == pytest.approx(dark.scatter.value / np.sqrt(2 * SERIES * (FRAMES - 1)), rel=0.01)
    assert dark.scatter.value == pytest.approx(0.4, abs=3 * float(dark.scatter.u or 0))
    assert (dark.kind, dark.scatter.unit) == ("dark", "DN")


def test_the_scatter_of_a_lamp_is_reported_relative_to_its_light():
    """Frames that differ by 8 DN of 4000 DN of light differ by 0.2 %."""
    (lit,) = _reported(np.random.default_rng(3).normal(0.0, 8.0, (SERIES, FRAMES)), light_dn=4000.0)
    assert lit.scatter.value == pytest.approx(0.002, abs=3 * float(lit.scatter.u or 0))
    assert "%" in lit.sentences()[0]


def test_a_first_frame_is_reported_with_the_scatter_of_its_tiles():
    """A first frame 3 DN above the others is reported so, within three u; u is the tiles' scatter over √24."""
    apart = np.zeros((SERIES, FRAMES))
    apart[2, 0] = 3.0
    (dark,) = _reported(apart)
    first, u = dark.series[2].apart[0], dark.series[2].u[0]
    assert first == pytest.approx(3.0, abs=4 * u)
    assert u == pytest.approx(1.2533 * TILE_DN * np.sqrt(FRAMES / (FRAMES - 1)) / np.sqrt(24), rel=0.5)
    assert dark.series[2].standing_out == (0,)
    assert sum(len(one.standing_out) for one in dark.series) == 1
    assert "first frame of a series" in dark.sentences()[1]


def test_equal_frames_seldom_stand_out():
    """Of 200 sets without an odd frame at most 0.1 % and three of its sigmas name one."""
    rng, sets = np.random.default_rng(4), 200
    reported = [_reported(rng.normal(0.0, 0.4, (SERIES, FRAMES)), seed=n)[0] for n in range(sets)]
    named = sum(any(one.standing_out for one in dark.series) for dark in reported)
    assert named <= 0.001 * sets + 3 * np.sqrt(0.001 * sets)


def test_what_tiles_scatter_by_is_no_wander():
    """Frames that differ by their pixels alone: no scatter beyond two u in nine of ten sets, and nothing stated."""
    reported = [_reported(np.zeros((SERIES, FRAMES)), seed=n)[0] for n in range(40)]
    printed = [dark for dark in reported if dark.scatter.value > 2.0 * float(dark.scatter.u or 0.0)]
    assert len(printed) <= 4 + 3 * 2
    assert all(dark.scatter.value < TILE_DN for dark in reported)
    assert all(
        "series of one setting" not in text for dark in reported if dark not in printed for text in dark.sentences()
    )


def test_single_frames_tell_nothing():
    """Without repeats nothing is stated."""
    entries = tuple(FrameEntry.of(f"{n}.tif", FrameSettings(1.0 + n, shutter="closed")) for n in range(4))
    design = Design.of(CaptureHeader(camera=CameraDescription(bit_depth=16), frames=entries), SIZE)
    shape = (len(design.captures), len(design.tiles))
    usable, nothing = np.ones(shape, np.bool_), np.zeros(shape)
    assert repeats_of(design, lambda f: np.zeros((len(f), shape[1])), usable, nothing, nothing, (0.0, 0.0)) == ()


def test_what_is_reported_stands_in_json():
    """Scatter, what was fitted aside, each frame of each series, and the words."""
    (dark,) = _reported(np.random.default_rng(5).normal(0.0, 0.4, (SERIES, FRAMES)))
    mapping = dark.to_mapping()
    assert mapping["fitted_aside"] == 0.1
    assert [len(one["frames"]) for one in mapping["series"]] == [FRAMES] * SERIES
    assert mapping["said"][0].startswith(f"{SERIES * FRAMES} dark frames in {SERIES} series")


@pytest.mark.parametrize("tiles", [1, 3])
def test_frames_of_too_few_tiles_tell_nothing(tiles):
    """One tile has no scatter to say how well a frame's offset is known: nothing is stated, and never ± 0."""
    apart = np.random.default_rng(4).normal(0.0, 0.4, (SERIES, FRAMES))
    assert _reported(apart, tiles=tiles) == ()


def test_four_tiles_tell_a_frame_with_a_u():
    """Of four tiles a frame 3 DN off is reported within five of its u, and the u is that of tiles of 0.02 DN."""
    apart = np.zeros((SERIES, FRAMES))
    apart[2, 0] = 3.0
    (dark,) = _reported(apart, tiles=4)
    u = np.array([u for one in dark.series for u in one.u])
    assert (u > 0).all()
    assert np.median(u) == pytest.approx(1.2533 * TILE_DN * np.sqrt(FRAMES / (FRAMES - 1)) / np.sqrt(4), rel=0.5)
    assert dark.series[2].apart[0] == pytest.approx(3.0, abs=0.1)


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

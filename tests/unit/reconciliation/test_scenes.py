"""Frames of different scenes are distinguished, and never taken for one scene that an effect changed."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from radiometer.data import CameraDescription, CaptureHeader, Frame, FrameEntry
from radiometer.errors import CaptureError
from radiometer.reconciliation.design import Design
from radiometer.reconciliation.reduce import with_even_tiles
from radiometer.reconciliation.repeatability import FineStructure, scenes_of
from testing.reconciled import reconcile

BLACK, E_PER_DN, READ_E, FULL = 100.0, 2.0, 4.0, 4095
HEIGHT, WIDTH = 96, 128


def scene(seed, contrast=0.4):
    """Return relative radiances whose logarithm varies at random over some eight pixels."""
    rough = gaussian_filter(np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH)), 4.0)
    return np.exp(contrast * rough / rough.std())


def taken(radiance, light_e, seed):
    rng = np.random.default_rng(seed)
    electrons = rng.poisson(light_e * radiance) + READ_E * rng.standard_normal(radiance.shape)
    return np.clip(np.rint(electrons / E_PER_DN + BLACK), 0, FULL).astype(np.uint16)


def shown(*pictures):
    seen = {n: FineStructure.of(dn, BLACK, FULL) for n, dn in enumerate(pictures)}
    return [scenes_of(seen)[n] for n in range(len(pictures))]


def test_scenes_are_recognised_by_their_details():
    """Numbered as they come; from noise, even fields and clipped frames none is seen."""
    one, other = scene(1), scene(2)
    lights = zip((one, one, other, one, other, scene(3)), (400.0, 3000.0, 1000.0, 800.0, 3000.0, 900.0), strict=True)
    assert shown(*(taken(radiance, e, n) for n, (radiance, e) in enumerate(lights))) == [0, 0, 1, 0, 1, 2]
    even = [taken(np.ones((HEIGHT, WIDTH)), 2000.0, n) for n in range(3)]
    assert shown(*even) == [0, 0, 0]
    assert shown(taken(scene(1, 0.02), 5000.0, 1), taken(scene(2, 0.02), 5000.0, 2)) == [0, 0]
    assert shown(taken(scene(8), 2000.0, 1), taken(scene(9), 4.0, 2), taken(scene(9), 60_000.0, 3)) == [0, 0, 0]


def test_cameras_and_borders_make_no_other_scene():
    """Fall-off, bands, columns and blur leave its details; a tile is the even part of its cell."""
    radiance, (y, x) = scene(4), np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j]
    changed = [
        radiance * (1.0 - 0.4 * (x * x + y * y)),
        radiance * (1.0 + 0.9 * np.sin(9.0 * y)),
        radiance * np.random.default_rng(5).uniform(0.5, 1.5, WIDTH),
        2.0 * np.power(radiance / 2.0, 0.45),
        gaussian_filter(radiance, 2.0),
    ]
    pictures = [taken(other, 2000.0, 6 + n) for n, other in enumerate((radiance, *changed))]
    assert shown(*pictures) == [0] * len(pictures)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    chart = np.where((x >= 63) | ((y % 24 > 5) & (x % 21 > 6)), 1.0, 0.0)
    entries = tuple(FrameEntry(file=f"{n}.png", exposure_s=0.002 * (1 + n), gain_db=0.0) for n in range(4))
    frames = [Frame(taken(chart, 1e3 * (1 + n), n), 12, entry.settings) for n, entry in enumerate(entries)]
    camera = CameraDescription(bit_depth=12, black_level_dn=BLACK)
    cells = Design.of(CaptureHeader(camera=camera, frames=entries), chart.shape)
    even = with_even_tiles(cells, frames.__getitem__)
    assert all(chart[tile.slices].all() for tile in even.tiles)
    pairs = list(zip(cells.tiles, even.tiles, strict=True))
    assert all((cell == tile) == (cell.x >= 63) for cell, tile in pairs)


def test_blocks_of_a_scene_scatter_as_their_pixels():
    """Over their root; of large frames as the pixels that are looked at."""
    seen = [FineStructure.of(taken(np.ones((HEIGHT, WIDTH)), 800.0, n), BLACK, FULL) for n in range(20)]
    assert seen[0].log_light.shape == (24, 32)
    scatter = np.var([one.log_light for one in seen], axis=0, ddof=1).mean()
    assert scatter == pytest.approx((800.0 + READ_E**2 + E_PER_DN**2 / 12.0) / 800.0**2 / 16.0, rel=0.05)
    assert np.mean([one.noise2.mean() for one in seen]) == pytest.approx(scatter * 15.0 / 16.0, rel=0.05)
    assert seen[0].log_light.mean() == pytest.approx(np.log(400.0), abs=1e-3)
    even = taken(np.ones((800, 1200)), 800.0, 3)
    seen = FineStructure.of(even, BLACK, FULL)
    assert seen.log_light.shape == (20, 30)  # blocks of 13 × 13 of every third pixel
    assert np.var(seen.log_light, ddof=1) == pytest.approx(817.0 / 800.0**2 / 13.0**2, rel=0.15)
    assert seen.noise2.mean() == pytest.approx(817.0 / 800.0**2 / 13.0**2, rel=0.05)


def reconciled(*shots):
    """Return what is stated of frames with exposures of 10 ms for 4000 electrons, two of each."""
    entries, frames = [], []
    for number, (radiance, exposure_s) in enumerate(shot for shot in shots for _ in range(2)):
        entries.append(FrameEntry(file=f"{number}.png", exposure_s=exposure_s, timestamp_s=0.5 * number, gain_db=0.0))
        frames.append(Frame(taken(radiance, 4e5 * exposure_s, 20 + number), 12, entries[-1].settings))
    stated = {"conversion_gain_e_per_dn": E_PER_DN, "read_noise_e": READ_E, "black_level_dn": BLACK}
    camera = CameraDescription(bit_depth=12, pixel_pitch_um=3.45, full_well_e=9000.0, **stated)
    return reconcile(CaptureHeader(camera=camera, frames=tuple(entries)), frames, with_limits=False)


@pytest.mark.slow
@pytest.mark.usefixtures("laws_left_out")
def test_each_scene_has_radiances_of_its_own():
    """Two scenes at two exposures each agree with the model; that the scene changes is reported."""
    one, other = scene(10), scene(11, contrast=0.1)
    found = reconciled((one, 1e-3), (one, 4e-3), (other, 1e-3), (other, 4e-3))
    assert found.verdict == "agrees"
    assert 0.8 < found.gap_after < 1.2
    assert any("the scene changes: 2 scenes are shown" in line for line in found.assumptions)
    assert not any("scene" in line for line in reconciled((one, 1e-3), (one, 4e-3)).assumptions if "shown" in line)


def test_one_frame_and_black_borders_say_nothing_of_a_scene():
    """It is refused by name; half-black tiles leave no gap in the codes."""
    radiance, entries, frames = scene(12), [], []
    for number, shows in enumerate((radiance, radiance, scene(13))):
        entries.append(FrameEntry(file=f"{number}.png", exposure_s=0.002 * (1 + number), gain_db=0.0))
        frames.append(Frame(taken(shows, 1000.0, number), 12, entries[-1].settings))
    header = CaptureHeader(camera=CameraDescription(bit_depth=12, black_level_dn=BLACK), frames=tuple(entries))
    with pytest.raises(CaptureError, match=r"show 2 scenes, and no other frame shows that of 2\.png: .* two frames"):
        reconcile(header, frames)
    chart = np.zeros((HEIGHT, WIDTH))
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    bright = (y % 24 > 5) & (x % 32 > 7)
    chart[bright] = np.random.default_rng(31).uniform(0.2, 1.5, (4, 4))[y[bright] // 24, x[bright] // 32]
    result = reconciled(*((chart, exposure_s) for exposure_s in np.geomspace(0.002, 0.01, 8)))
    assert result.effects == ()
    assert result.global_p[0] > 0.02

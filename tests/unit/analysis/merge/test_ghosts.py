"""What moved through a scene: taken from the frames that agree, marked, and the reading right."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.merge.bracket import merge
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    FlatField,
    Frame,
    FrameSettings,
    LensDescription,
    PixelMask,
    Scale,
    SensorNoise,
)
from radiometer.data.setup import Setup

E_PER_DN, READ_E, BLACK, SHAPE = 2.6, 2.4, 64.0, (60, 80)
CAMERA = CameraDescription(
    bit_depth=12,
    conversion_gain_e_per_dn=E_PER_DN,
    read_noise_e=READ_E,
    full_well_e=10_500.0,
    dark_current_e_per_s=0.0,
    black_level_dn=BLACK,
)
LENS = LensDescription(f_number=4.0)
TIMES = 0.01 * 2.0 ** np.arange(6)


def _calibration(flat=None):
    return Calibration(
        camera=CAMERA,
        lens=LENS,
        scale=Scale(value=1.0, u_rel=0.0, method="relative"),
        response=None,
        noise=SensorNoise.of(CAMERA),
        black_level=BlackLevel(dn=BLACK, u_dn=0.0, dark_u_rel=0.0),
        flat_field=flat,
    )


def _frame(rng, electrons_per_s, seconds):
    electrons = np.minimum(rng.poisson(electrons_per_s * seconds), 10_500) + rng.normal(0.0, READ_E, SHAPE)
    dn = np.clip(np.rint(electrons / E_PER_DN + BLACK), 0, 4095).astype(np.uint16)
    return Frame(dn, 12, FrameSettings(float(seconds), f_number=4.0, black_level_dn=BLACK))


def _scene(rng):
    return np.kron(np.exp(rng.normal(size=(6, 8))), np.ones((10, 10))) * 30_000.0


def _z(found, scene):
    """Return (value − truth)/u; the map is in DN per s."""
    return (found.radiance.astype(float) - scene / E_PER_DN) / found.u_radiance.astype(float)


@pytest.fixture(scope="module")
def passer_by():
    """Return scene, bracket and where something stood: another place in every frame, darker or brighter."""
    rng = np.random.default_rng(5)
    scene = _scene(rng)
    frames, stood = [], np.zeros(SHAPE, bool)
    for k, seconds in enumerate(TIMES):
        light = scene.copy()
        if 1 <= k <= 4:
            place = slice(20, 40), slice(15 * k - 10, 15 * k + 5)
            light[place] *= (0.2, 3.0)[k % 2]
            stood[place] = True
        frames.append(_frame(rng, light, seconds))
    return scene, Bracket.from_frames(frames), stood


def test_what_moved_is_left_out(passer_by):
    """Where something stood the map holds the scene behind it, with a true uncertainty, and the mask says so."""
    scene, bracket, stood = passer_by
    found = merge(bracket, Setup(CAMERA, LENS, _calibration()), without_ghosts=True)
    assert np.mean(found.mask[stood] & PixelMask.MOVED > 0) > 0.9
    assert np.mean(found.mask[~stood] & PixelMask.MOVED > 0) < 0.002
    z = _z(found, scene)
    assert np.sqrt(np.mean(z[found.mask & PixelMask.MOVED > 0] ** 2)) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(np.mean(z[stood] ** 2)) < 1.3
    inside = found.radiance[20:40, 10:60].astype(float).sum()
    assert inside == pytest.approx(scene[20:40, 10:60].sum() / E_PER_DN, rel=2e-3)


def test_without_leaving_out_frames_only_disagree(passer_by):
    """The plain merge says that frames disagree there, and is wrong by far more than its noise."""
    scene, bracket, stood = passer_by
    found = merge(bracket, Setup(CAMERA, LENS, _calibration()))
    assert not np.any(found.mask & PixelMask.MOVED)
    assert np.mean(found.mask[stood] & PixelMask.INCONSISTENT > 0) > 0.9
    assert np.sqrt(np.mean(_z(found, scene)[stood] ** 2)) > 10.0


def test_fewer_frames_cost_noise(passer_by):
    """The uncertainty of a pixel that lost a frame is that of the frames that are left."""
    scene, bracket, _ = passer_by
    found = merge(bracket, Setup(CAMERA, LENS, _calibration()), without_ghosts=True)
    place = (slice(22, 38), slice(37, 48))  # something stood here in the fourth frame
    rest = Bracket.from_frames([f for k, f in enumerate(bracket.light) if k != 3])
    alone = merge(rest, Setup(CAMERA, LENS, _calibration()))
    same = (found.mask[place] & PixelMask.MOVED > 0) & (np.abs(scene[place] / scene[22, 37] - 1.0) < 10.0)
    assert same.mean() > 0.95
    assert np.median(found.u_radiance[place][same] / alone.u_radiance[place][same]) == pytest.approx(1.0, abs=1e-3)
    assert np.median(np.abs(found.radiance[place][same] / alone.radiance[place][same] - 1.0)) < 1e-5


def test_two_frames_against_each_other_stay_doubtful():
    """Of two frames neither is believed: the pixel has one of both values and is still called inconsistent."""
    rng = np.random.default_rng(6)
    scene = np.full(SHAPE, 40_000.0)
    other = scene.copy()
    other[10:20, 10:20] *= 0.5
    bracket = Bracket.from_frames([_frame(rng, scene, 0.01), _frame(rng, other, 0.02)])
    found = merge(bracket, Setup(CAMERA, LENS, _calibration()), without_ghosts=True)
    inside = found.mask[11:19, 11:19]
    assert np.all(inside & PixelMask.INCONSISTENT)
    assert np.all(inside & PixelMask.MOVED)
    value = np.median(found.radiance[11:19, 11:19]) * E_PER_DN
    assert min(abs(value / 40_000.0 - 1.0), abs(value / 20_000.0 - 1.0)) < 0.03


def test_a_frame_that_clips_contradicts_what_is_dark():
    """A lamp that is on in the one frame that clips there does not make the two dark ones brighter."""
    rng = np.random.default_rng(7)
    scene = np.full(SHAPE, 50_000.0)
    lit = scene.copy()
    lit[10:20, 10:20] *= 100.0
    frames = [_frame(rng, scene, 0.01), _frame(rng, scene, 0.02), _frame(rng, lit, 0.04), _frame(rng, scene, 0.08)]
    found = merge(Bracket.from_frames(frames), Setup(CAMERA, LENS, _calibration()), without_ghosts=True)
    assert np.all(found.mask[11:19, 11:19] == PixelMask.MOVED)
    assert np.sqrt(np.mean(_z(found, scene)[11:19, 11:19] ** 2)) == pytest.approx(1.0, abs=0.25)


def test_what_a_frame_does_not_show_is_not_missed():
    """Where a frame shows nothing the others are merged, and no one says that something moved."""
    rng = np.random.default_rng(3)
    scene = _scene(rng)
    frames = [_frame(rng, scene, seconds) for seconds in TIMES]
    absent = [np.zeros(SHAPE, bool) for _ in TIMES]
    absent[2][:, :7] = absent[4][:12] = True
    absent[0][:, 70:] = True
    for k in (0, 2, 4):
        dn = frames[k].dn.copy()
        dn[absent[k]] = 4095
        frames[k] = Frame(dn, 12, frames[k].settings)
    flat = FlatField(
        shape=SHAPE, principal_point_px=(40.0, 30.0), radius_px=50.0, coefficients=(-0.3, 0.0, 0.0), u_rel=0.0
    )
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    falloff = 1.0 - 0.3 * ((x - 40.0) ** 2 + (y - 30.0) ** 2) / 50.0**2
    for known, truth in ((None, scene), (flat, scene / falloff)):
        found = merge(
            Bracket.from_frames(frames), Setup(CAMERA, LENS, _calibration(known)), absent=absent, without_ghosts=True
        )
        assert np.mean(found.mask == 0) > 0.995
        edge = _z(found, truth)[absent[0] | absent[2] | absent[4]]
        assert np.sqrt(np.mean(edge**2)) == pytest.approx(1.0, abs=0.1)

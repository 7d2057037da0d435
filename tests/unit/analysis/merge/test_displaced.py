"""Frames that lie apart by parts of a pixel make a map uncertain at gradients, not on even ground."""

import numpy as np
import pytest

from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.merge.displaced import relative_shift, with_shift
from radiometer.analysis.merge.finish import AtLevels
from radiometer.data import (
    BlackLevel,
    Bracket,
    CameraDescription,
    Frame,
    FrameSettings,
    LensDescription,
    PixelMask,
    SensorNoise,
)
from radiometer.data.setup import Setup
from testing.relative_scale import relative_calibration

CAMERA, LENS = CameraDescription(bit_depth=12), LensDescription()
NOISE = SensorNoise(conversion_gain_e_per_dn=4.0, read_noise_e=4.0, full_well_e=20_000.0)
SHAPE, PERIOD = (96, 128), 16.0


SETUP = Setup(CAMERA, LENS, relative_calibration(CAMERA, NOISE, black_level=BlackLevel(dn=0.0)))


def _bracket(rng, shifts):
    """Return frames of even ground (left) next to waves across the columns (right), each displaced along the row."""
    frames = []
    for time, shift in zip(2.0 ** np.arange(len(shifts)), shifts, strict=True):
        place = np.arange(SHAPE[1]) + shift
        waves = np.where(place > SHAPE[1] / 2, 0.8 * np.sin(2.0 * np.pi * place / PERIOD), 0.0)
        electrons = rng.poisson(np.broadcast_to(3000.0 * time / 8.0 * np.exp(waves), SHAPE))
        dn = (electrons + NOISE.read_noise_e * rng.standard_normal(SHAPE)) / NOISE.conversion_gain_e_per_dn
        frames.append(Frame(np.clip(np.round(dn), 0, 4095).astype(np.uint16), 12, FrameSettings(float(time))))
    return Bracket.from_frames(frames)


def _truth():
    place = np.arange(SHAPE[1])
    return np.where(place > SHAPE[1] / 2, 0.8 * np.sin(2.0 * np.pi * place / PERIOD), 0.0)


def test_u_grows_at_gradients_and_not_on_even_ground():
    """On even ground u is that of the noise to 2 %; on the waves δ·|∇ln L|·L·√Σp² joins it, √Σp² between 0.5 and 1."""
    bracket = _bracket(np.random.default_rng(1), np.zeros(4))
    plain = merge(bracket, SETUP)
    doubtful = merge(bracket, SETUP, displacement_px=0.5)
    assert np.array_equal(plain.radiance, doubtful.radiance)
    ratio = doubtful.u_radiance / plain.u_radiance
    assert np.median(ratio[:, 4:60]) == pytest.approx(1.0, abs=0.02)
    steep = 72 + 8 * np.arange(7)  # where sin crosses 0: |∇ln L| = 0.8·sin(2π/16)
    joined = np.sqrt(doubtful.u_radiance**2 - plain.u_radiance**2)[:, steep] / plain.radiance[:, steep]
    whole = 0.5 * 0.8 * np.sin(2.0 * np.pi / PERIOD)
    assert 0.5 * whole < np.median(joined) < whole


def test_u_says_by_how_much_displaced_frames_are_off():
    """Over many draws of displacements the error on the waves is what u says, to 20 %."""
    rng, squares = np.random.default_rng(2), []
    for _ in range(24):
        found = merge(_bracket(rng, 0.3 * rng.standard_normal(4)), SETUP, displacement_px=0.3)
        gap = found.radiance / np.exp(_truth()) / np.median(found.radiance[:, 4:60]) - 1.0
        z = gap / (found.u_radiance / found.radiance)
        squares.append(np.mean(np.clip(z[:, 72:124], -5.0, 5.0) ** 2))
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, rel=0.2)


def test_displaced_frames_do_not_contradict_each_other():
    """Frames displaced by a third of a pixel disagree far beyond their noise, and no pixel is taken for a ghost."""
    bracket = _bracket(np.random.default_rng(3), [0.3, -0.3, 0.3, -0.3])
    plain = merge(bracket, SETUP, without_ghosts=True)
    known = merge(bracket, SETUP, without_ghosts=True, displacement_px=0.3)
    doubt = PixelMask.MOVED | PixelMask.INCONSISTENT
    assert np.mean(plain.mask[:, 72:124] & doubt > 0) > 0.2
    assert np.mean(known.mask & doubt > 0) < 0.005


def test_what_displacement_explains_is_as_sure_as_its_neighbours():
    """A pixel whose frames disagree within noise and displacement has the u of those next to it in its column."""
    bracket = _bracket(np.random.default_rng(3), [0.3, -0.3, 0.3, -0.3])
    plain = merge(bracket, SETUP)
    known = merge(bracket, SETUP, displacement_px=0.3)
    excused = (plain.mask & ~known.mask & PixelMask.INCONSISTENT) > 0
    halves = [k for k in range(72, 124) if 20 <= excused[:, k].sum() <= SHAPE[0] - 15]
    ratios = [np.median(known.u_radiance[excused[:, k], k]) / np.median(known.u_radiance[~excused[:, k], k])
              for k in halves]  # fmt: skip
    assert len(ratios) > 10
    assert min(ratios) > 0.98
    assert max(ratios) < 1.1


def test_what_displacement_does_not_explain_stays_a_ghost():
    """A lamp that one frame alone shows is left out of it as before."""
    frames = list(_bracket(np.random.default_rng(4), np.zeros(4)).light)
    lit = frames[1].dn.copy()
    lit[40:50, 20:30] = 3000
    frames[1] = Frame(lit, 12, frames[1].settings)
    bracket = Bracket.from_frames(frames)
    found = merge(bracket, SETUP, without_ghosts=True, displacement_px=0.3)
    assert np.all(found.mask[42:48, 22:28] & PixelMask.MOVED)
    level = np.median(found.radiance[:, 4:16])
    assert found.radiance[42:48, 22:28] == pytest.approx(level, rel=0.15)


def test_noise_makes_no_shift():
    """Even ground of 1 % noise, displaced by half a pixel, changes by less than half of that noise."""
    rng = np.random.default_rng(5)
    value = (1.0 + 0.01 * rng.standard_normal((80, 80))).astype(np.float32)
    shift = relative_shift(value, np.full_like(value, 0.01), 0.5)
    assert np.sqrt(np.mean(shift**2)) < 0.005
    slope = np.exp(0.1 * np.arange(40.0, dtype=np.float32))[None, :].repeat(8, axis=0)
    assert relative_shift(slope, np.zeros_like(slope), 0.5)[4, 1:-1] == pytest.approx(0.05, rel=1e-4)


@pytest.mark.parametrize("pixels", [7, 2])
@pytest.mark.parametrize("of_each", [False, True])
def test_each_level_has_the_weights_of_its_own(of_each, pixels):
    """From the lowest rate on in sixteenths of an e-fold, and the first and last beyond: δ·|∇ln L|·L·√Σp² joins u."""
    factors = np.array([0.9, 0.8, 0.7, 0.6])
    steps = np.array([-3.0, 0.0, 0.4, 0.6, 2.0, 3.0, 9.0])
    expected = np.array([0.9, 0.9, 0.9, 0.8, 0.7, 0.6, 0.6])[:pixels]
    unit = np.linspace(1.0, 2.0, pixels) if of_each else np.array([2.0])
    value = (unit * np.exp(np.log(5.0) + steps[:pixels] / 16.0)).astype(np.float32)
    u, shift = 0.01 * value, np.full(pixels, 0.1, np.float32)
    with_shift(value, u, shift, unit.astype(np.float32), AtLevels(float(np.log(5.0)), factors[None], factors, factors))
    assert u / value == pytest.approx(np.hypot(0.01, 0.1 * expected), rel=1e-4)

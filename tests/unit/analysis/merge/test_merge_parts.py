"""Parts of a merge by hand: which frames agree, whose edge goes with it, displacement, where pictures lie."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from radiometer.analysis.merge import bracket
from radiometer.analysis.merge.displaced import MeanDisplacement, relative_shift
from radiometer.analysis.merge.tables import MergeTables


def tables(exposures, *, variance=25.0, kappa=0.0, slack=0.01, clips_at=4000.0, sigma_clip=5.0, bounds=(4000.0, 1.0)):
    """Return the tables of linear frames of the same noise."""
    frames = np.array([[t, variance, clips_at, sigma_clip, 0.0, variance] for t in exposures])
    return MergeTables(frames, kappa, np.array([*bounds, slack]), np.ones(len(exposures)), None, None, 1.0, np.zeros(2))


def test_weights_of_displaced_frames_are_those_of_their_information():
    """t²/v of 1 and 9: √(0.1² + 0.9²); where the longer clips the shorter has all; where nothing is known, one."""
    found = MeanDisplacement.of(tables([1.0, 3.0], clips_at=300.0, bounds=(300.0, 1.0)))
    rates = np.exp(found.lowest + np.arange(found.factors.size) / 16.0)
    both, one = rates < 100.0, (rates > 100.0) & (rates < 300.0)
    assert found.lowest == pytest.approx(0.0)
    assert found.factors[both] == pytest.approx(math.hypot(0.1, 0.9))
    assert found.factors[one] == pytest.approx(1.0)
    assert rates[-1] >= 300.0
    shot = MeanDisplacement.of(tables([1.0, 3.0], variance=1e-9, kappa=1.0))
    assert shot.factors[4] == pytest.approx(math.hypot(1.0, 3.0) / 4.0)  # of photons alone the weights go as t


def test_a_shift_at_the_border_is_that_of_one_step():
    """L = exp(0.1·x + 0.2·y): δ·√(0.01 + 0.04) everywhere, the rim included; a single row knows its own direction."""
    y, x = np.mgrid[:5, :7]
    ramp = np.exp(0.1 * x + 0.2 * y).astype(np.float32)
    nothing = np.zeros_like(ramp)
    assert relative_shift(ramp, nothing, 0.5) == pytest.approx(np.full((5, 7), 0.5 * math.sqrt(0.05)), rel=1e-4)
    assert relative_shift(ramp[:1], nothing[:1], 2.0) == pytest.approx(np.full((1, 7), 0.2), rel=1e-4)
    doubtful = np.full_like(ramp, 2.0 * ramp.max())
    assert not relative_shift(ramp, doubtful, 0.5).any()  # all count as their uncertainty
    assert not relative_shift(nothing, nothing, 0.5).any()


@pytest.mark.parametrize(("width", "rows"), [(100, 327), (1 << 15, 1), ((1 << 15) + 1, 1), (1, 1 << 15)])
def test_blocks_are_whole_rows_that_cover_a_part_once(width, rows):
    """As many rows as 32 768 pixels hold, one at least; the last block is what is left."""
    assert bracket.block_size(width) == rows * width
    start, stop = 3 * width, (3 + 2 * rows + 1) * width
    found = list(bracket.blocks(start, stop, width))
    assert [end - begin for begin, end in found] == [rows * width, rows * width, width]
    assert (found[0][0], found[-1][1]) == (start, stop)
    assert all(one[1] == two[0] for one, two in itertools.pairwise(found))


@pytest.mark.parametrize("shape", [(1, 7), (37, 5), (64, 3)])
@pytest.mark.parametrize("cores", [1, 3, None])
def test_all_cores_together_do_every_pixel_once(shape, cores, monkeypatch):
    """In whole rows, four parts for each core, fewer where there are fewer rows."""
    monkeypatch.setattr(bracket.os, "cpu_count", lambda: cores)
    done = []
    bracket.on_all_cores(shape, lambda start, stop: done.append((start, stop)))
    done.sort()
    pixels = [k for start, stop in done for k in range(start, stop)]
    assert pixels == list(range(shape[0] * shape[1]))
    assert all(start % shape[1] == stop % shape[1] == 0 for start, stop in done)
    assert len(done) <= 4 * (cores or 1)
    assert len(done) > 2 * (cores or 1) or len(done) == shape[0]

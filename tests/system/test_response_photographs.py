"""Real photographs: the memorial church on film."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from radiometer.bench.sources import open_source
from radiometer.cli.main import run
from radiometer.data import ResponseCurve

BLUE, GREEN, RED = 0, 1, 2


@pytest.fixture(scope="module")
def memorial(shared_data):
    """Return (folder, radiance map in the order blue, green, red, mask of pixels that no frame's border covers)."""
    folder = shared_data / "stacks" / "memorial_film"
    reference = cv2.imread(str(folder / "memorial.hdr"), cv2.IMREAD_UNCHANGED)
    border = np.zeros(reference.shape[:2], bool)
    for file in folder.glob("memorial00*.png"):
        image = cv2.imread(str(file))
        border |= (image[..., BLUE] == 255) & (image[..., GREEN] < 40) & (image[..., RED] < 40)
    return folder, reference, cv2.dilate(border.astype(np.uint8), np.ones((9, 9))) == 0


@pytest.mark.parametrize(("channel", "index"), [("red", RED), ("green", GREEN), ("blue", BLUE)])
def test_memorial_radiance_follows_the_published_map(memorial, tmp_path, channel, index):
    """Log radiance through the recovered curve correlates by 0.99 or more with Debevec's own radiance map."""
    folder, reference, inside = memorial
    target = tmp_path / "curve.csv"
    assert run(["response", str(folder), "-o", str(target), "--channel", channel]) == 0
    g = ResponseCurve.read(target).log_exposure
    total, weights = np.zeros(inside.shape), np.zeros(inside.shape)
    for frame in open_source(folder, channel).brackets[0].light:
        weight = np.interp(frame.dn, [20, 128, 250], [0.0, 1.0, 0.0])
        total += weight * (g[frame.dn] - np.log(frame.settings.exposure_s))
        weights += weight
    used = inside & (weights > 0) & (reference[..., index] > 0)
    log_radiance, log_reference = total[used] / weights[used], np.log(reference[..., index][used])
    assert np.corrcoef(log_radiance, log_reference)[0, 1] >= 0.99

"""The share of a step in the last line before a border, where nobody states what outline the patches have."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from radiometer.reconciliation.measure.design import Tile
from radiometer.reconciliation.measure.edges import edge_shares
from radiometer.reconciliation.measure.layout import patch_sides
from simulators.effects.pixel_mixing import blur_edge_share

_NOISE_DN = 2.0


def share_of(
    shape: str, blur_px: float | tuple[float, float] = 0.0, side_px: int = 18, ground: tuple[float, ...] = (200.0,) * 12
) -> tuple[float, float]:
    """Return share and u of twelve patches of 600 DN that lie inside discs (or plates) of 13 px radius."""
    y, x = np.mgrid[0:120, 0:160].astype(float)
    picture, tiles = np.zeros(y.shape), []
    for number, level in enumerate(ground):
        cy, cx = 20.0 + 40 * (number // 4), 20.0 + 40 * (number % 4)
        cell = (abs(y - cy) <= 20) & (abs(x - cx) <= 20)
        across = np.hypot(y - cy, x - cx) if shape == "disc" else np.maximum(abs(y - cy), abs(x - cx))
        picture[cell] = np.where(across < 13.45, 600.0, level)[cell]
        half = side_px // 2
        tiles.append(Tile(f"p{number}", int(cx) - half + 2, int(cy) - half + 2, 2 * half - 4, 2 * half - 4, 2, (None,)))
    picture = gaussian_filter(picture, blur_px) if blur_px else picture
    picture += _NOISE_DN * np.random.default_rng(5).standard_normal(picture.shape)
    sides = patch_sides(SimpleNamespace(tiles=tiles, shape=picture.shape))
    lines, uneven = sides.lines(sides.pixels(picture))
    mean = np.array([[picture[tile.slices].mean() for tile in tiles]])
    share, u = edge_shares(
        sides, lines[None], uneven[None], mean, mean * 0 + _NOISE_DN**2, mean * 0, np.zeros(1, dtype=np.intp)
    )
    return float(share[0]), float(u[0])


@pytest.mark.parametrize("shape", ["disc", "plate"])
def test_sharp_patches_show_no_blur_whatever_their_outline(shape: str) -> None:
    """The lines along a disc's sides blend by a fifth for its shape alone; the middle thirds are straight and tell."""
    share, u = share_of(shape)
    assert u < 0.01
    assert abs(share) < 3 * u


@pytest.mark.parametrize("shape", ["disc", "plate"])
def test_blur_is_read_from_discs_as_from_plates(shape: str) -> None:
    """A Gaussian of 0.6 px leaves 0.17 of a straight step in the last line before it."""
    share, u = share_of(shape, 0.6, side_px=20)
    assert u < 0.02
    assert share == pytest.approx(float(blur_edge_share(np.float64(0.6))), abs=0.03)


@pytest.mark.parametrize("shape", ["disc", "plate"])
@pytest.mark.parametrize("blur_px", [(0.0, 0.6), (0.6, 0.0)])
def test_what_blurs_along_rows_or_columns_alone_counts_by_half(shape: str, blur_px: tuple[float, float]) -> None:
    """Half of the sides have the share of a Gaussian of 0.6 px, the others none: the mean of both is told."""
    share, u = share_of(shape, blur_px, side_px=20)
    assert u < 0.02
    assert share == pytest.approx(0.5 * float(blur_edge_share(np.float64(0.6))), abs=0.02)


def test_discs_too_small_for_a_straight_part_tell_nothing() -> None:
    """Sides of 10 px have no third that could be judged apart, and as a whole they are cut by the outline."""
    assert np.isinf(share_of("disc", side_px=14)[1])


def test_borders_that_disagree_tell_nothing() -> None:
    """A blur is the same at all borders: shares of 0, 0.2, 0.4 and 0.6 at even borders are no blur's."""
    tiles = [Tile(f"p{i}", 10, 10 + 20 * i, 12, 12, 2, (None,)) for i in range(4)]
    sides = patch_sides(SimpleNamespace(tiles=tiles, shape=(100, 40)))
    lines = np.zeros((1, len(sides.parts) * 16, 7)) + 500.0
    lines[:, :, 4:] -= 100.0
    lines[:, :, 3] -= 100.0 * np.tile(np.repeat([0.0, 0.16, 0.3, 0.4], 4), len(sides.parts))
    flat = np.full((1, 4), 500.0)
    _, u = edge_shares(sides, lines, lines * 0, flat, flat * 0 + 1.0, flat * 0, np.zeros(1, dtype=np.intp))
    assert np.isinf(u[0])


def test_even_field_has_no_borders() -> None:
    """Among thousands of lines of an even field some lie four sigmas off: that is no border, and tells nothing."""
    rng = np.random.default_rng(8)
    tiles = [Tile(f"p{i}", 10, 10 + 20 * i, 12, 12, 2, (None,)) for i in range(100)]
    sides = patch_sides(SimpleNamespace(tiles=tiles, shape=(2100, 40)))
    pixels = 500.0 + rng.standard_normal((20, *sides.rows.shape))
    lines, uneven = (np.array(part) for part in zip(*(sides.lines(p) for p in pixels), strict=True))
    flat = np.full((20, 100), 500.0)
    _, u = edge_shares(sides, lines, uneven, flat, flat * 0 + 1.0, flat * 0, np.zeros(20, dtype=np.intp))
    assert np.isinf(u).all()

"""Plain statistics of a session's frames, to see that a hidden effect is really in the pixels."""

from __future__ import annotations

import numpy as np

from testing.generator.session import Session

Block = tuple[np.ndarray, np.ndarray]
TINY = 1e-9


def blocks_of(session: Session) -> dict[str, Block]:
    """Return per block the statistic of every capture (captures × numbers) and its standard uncertainty.

    Every capture of the session must have the same number of frames.
    """
    shape = next(session.frames()).shape
    stack = np.empty((len(session.header.frames), *shape), dtype=np.float32)
    for number, frame in enumerate(session.frames()):
        stack[number] = frame.dn
    stack = stack.reshape(captures_of(session), -1, *shape)
    tiles = np.stack([stack[:, :, ys, xs] for ys, xs in (p.patch.slices for p in session.header.patches)], axis=2)
    return _tiles(tiles) | _profiles(stack) | _whole(stack, tiles)


def captures_of(session: Session) -> int:
    """Return the number of captures: a new one starts after a pause of over ten seconds."""
    times = np.array([e.timestamp_s for e in session.header.frames])
    return 1 + int((np.diff(times) > 10).sum())


def _tiles(tiles: np.ndarray) -> dict[str, Block]:
    """Return the statistics of tiles (captures × frames × tiles × rows × columns)."""
    n, pixels = tiles.shape[1], tiles.shape[3] * tiles.shape[4]
    noise = tiles - tiles.mean(axis=(3, 4), keepdims=True)
    noise = noise - noise.mean(axis=1, keepdims=True)
    variance = (noise**2).sum(axis=(1, 3, 4)) / ((n - 1) * (pixels - 1)) + TINY
    still = tiles.mean(axis=1)
    uneven = still - still.mean(axis=2, keepdims=True) - still.mean(axis=3, keepdims=True)
    spatial = (uneven + still.mean(axis=(2, 3), keepdims=True)).var(axis=(2, 3))
    pairs = (noise[..., 1:] * noise[..., :-1]).mean(axis=(1, 3, 4)) / ((noise**2).mean(axis=(1, 3, 4)) + TINY)
    down = (noise[..., 1:, :] * noise[..., :-1, :]).mean(axis=(1, 3, 4)) / ((noise**2).mean(axis=(1, 3, 4)) + TINY)
    # 15 × 15 degrees of freedom are left of 16 × 16 once the profiles are out: hence 1.07 in the uncertainty.
    means = tiles.mean(axis=(3, 4))
    first = means[:, 0] - means[:, 1:].mean(axis=1)
    return {
        "mean": (means.mean(axis=1), np.sqrt(variance / (n * pixels))),
        "variance": (variance, variance * np.sqrt(2 / ((n - 1) * pixels))),
        "spatial": (
            spatial - variance / n,
            np.hypot(spatial, variance / n / np.sqrt(n - 1)) * np.sqrt(2 / pixels) * 1.07,
        ),
        "neighbour": (pairs, np.full(pairs.shape, 1 / np.sqrt((n - 1) * pixels))),
        "neighbour_down": (down, np.full(down.shape, 1 / np.sqrt((n - 1) * pixels))),
        "first": (first, np.sqrt(variance / pixels * (1 + 1 / (n - 1)))),
    }


def _profiles(stack: np.ndarray) -> dict[str, Block]:
    """Return row and column means, sharpened so that the scene's steps fall out, and the rows' unrest in time."""
    n, height, width = stack.shape[1:]
    still = stack.mean(axis=1)
    variance = stack.var(axis=1, ddof=1).mean(axis=(1, 2))[:, None] + TINY
    row, column = np.diff(still.mean(axis=2), 2), np.diff(still.mean(axis=1), 2)
    rows = stack.mean(axis=3) - stack.mean(axis=(2, 3))[:, :, None]
    unrest = ((rows - rows.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2)) / ((n - 1) * (height - 1))
    return {
        "row": (row, np.sqrt(6 * variance / (n * width)) * np.ones_like(row)),
        "column": (column, np.sqrt(6 * variance / (n * height)) * np.ones_like(column)),
        "flicker_row": (unrest[:, None], variance / width * np.sqrt(2 / ((n - 1) * height))),
    }


def _whole(stack: np.ndarray, tiles: np.ndarray) -> dict[str, Block]:
    """Return the frames' common unrest, the parity of the codes and the steps at the cells' borders."""
    n = stack.shape[1]
    means = tiles.mean(axis=(3, 4))
    sigma2 = tiles.var(axis=1, ddof=1).mean(axis=(2, 3)) / (tiles.shape[3] * tiles.shape[4]) + TINY
    relative = np.maximum(means.mean(axis=1) - 238, 1)
    weight = relative / sigma2
    moved = ((means - means.mean(axis=1, keepdims=True)) * weight[:, None]).sum(axis=2) / (weight * relative).sum(
        axis=1
    )[:, None]
    spread, sigma = moved.var(axis=1, ddof=1), 1 / (relative**2 / sigma2).sum(axis=1)
    parity = (stack % 2).mean(axis=(1, 2, 3))
    still = stack.mean(axis=1)
    across = np.abs(np.diff(still, axis=2))[:, :, 22::24].reshape(len(stack), -1)
    noise = np.sqrt(2 * (stack.var(axis=1, ddof=1).mean(axis=(1, 2)) + TINY) / n)
    return {
        "common": (spread[:, None], (sigma * np.sqrt(2 / (n - 1)))[:, None]),
        "codes": (parity[:, None], np.full((len(stack), 1), 0.5 / np.sqrt(stack[0].size))),
        "edge": (across, noise[:, None] * np.ones_like(across)),
    }

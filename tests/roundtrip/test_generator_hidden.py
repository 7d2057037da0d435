"""Every effect that the generator hides is in the pixels."""

import numpy as np
import pytest

from testing.generator.registry import ENTRIES, OUTSIDERS, VARIANTS
from testing.generator.session import make_session
from testing.generator.statistics import blocks_of

Blocks = dict[str, tuple[np.ndarray, np.ndarray]]

# Where an effect, another form of one, or one outside the catalogue, may show.
HIDDEN = {**ENTRIES, **OUTSIDERS, **VARIANTS}
LATE = {"event_offset", "lamp_step"}  # a short session ends before them
ANY = ("mean", "variance", "spatial", "first", "common", "edge", "column", "row", "flicker_row", "codes", "neighbour")


@pytest.fixture(scope="module")
def short_null_blocks() -> Blocks:
    """Return the statistics of a session of few captures in which nothing is hidden."""
    return blocks_of(make_session(camera_seed=11, session_seed=5, plan="short"))


def _largest_change(hidden: Blocks, null: Blocks) -> float:
    return max(_change(hidden, null, block) for block in ANY)


def _change(hidden: Blocks, null: Blocks, block: str) -> float:
    """Return by how many sigmas a block differs from that of the same session with nothing hidden.

    The largest of five tests: that the differences are larger than noise one by one, summed per capture, summed
    per tile (row, column), that all lean to one side, and that they grow with the signal. Clipped captures are left
    out; they have no noise to compare with.
    """
    clipped = null["mean"][0].max(axis=1) > 3600
    if block in ("mean", "variance") and np.abs(hidden["mean"][0][clipped] - null["mean"][0][clipped]).max() > 20:
        clipped[:] = False  # the effect is at the clip itself
    (a, ua), (b, ub) = hidden[block], null[block]
    z = np.clip(((a - b) / (np.hypot(ua, ub) + 1e-9))[~clipped], -100, 100)
    sums = (z.ravel(), z.mean(axis=1) * np.sqrt(z.shape[1]), z.mean(axis=0) * np.sqrt(z.shape[0]))
    squares = [(np.sum(s**2) - s.size) / np.sqrt(2 * s.size) for s in sums]
    signal = np.maximum(null["mean"][0][~clipped] - 240, 0)
    along = abs(np.sum(z * signal) / np.sqrt(np.sum(signal**2))) if z.shape == signal.shape else 0.0
    return float(max(*squares, abs(z.mean()) * np.sqrt(z.size), along))


@pytest.mark.parametrize("name", [n for n, h in HIDDEN.items() if h.visible and h.plan == "rich" and n not in LATE])
def test_what_is_hidden_shows(name: str, short_null_blocks: Blocks) -> None:
    """At twice its smallest realistic size each changes some statistic of a short session by more than five sigmas."""
    hidden = blocks_of(make_session(name, camera_seed=11, session_seed=5, scale=2.0, plan="short"))
    assert _largest_change(hidden, short_null_blocks) > 5

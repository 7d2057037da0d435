"""The generator: with nothing hidden it follows the sensor it declares, and whatever it hides is in the pixels."""

import itertools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiometer.data import CaptureSet
from testing.generator.other_data import write_emva_set, write_photographs
from testing.generator.registry import ENTRIES, OUTSIDERS, VARIANTS
from testing.generator.session import Session, make_session
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


def _gains(session: Session) -> np.ndarray:
    """Return the amplifier's factor of every capture."""
    settings = [e.settings for e in session.header.frames[::4]]
    return np.array([10 ** (s.gain_db / 20) for s in settings])


def test_seeds_give_their_frames_and_the_declared_gain() -> None:
    """A session is a function of its seeds alone; variance over mean is K within 4 predicted sigmas."""
    one, two, other = (make_session("prnu", camera_seed=2, session_seed=s, plan="bracket") for s in (7, 7, 8))
    first, again, different = (next(iter(s.frames())).dn for s in (one, two, other))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, different)
    session = make_session(camera_seed=11, session_seed=5)
    blocks, gain = blocks_of(session), _gains(session)
    highest = blocks["mean"][0].max(axis=1)
    keep = (highest > 400) & (highest < 3600)
    k = (gain / 2.6)[keep, None]
    signal_dn = blocks["mean"][0][keep] - 240
    expected = k * signal_dn + (k * 2.4) ** 2 + 1 / 12
    ratio = blocks["variance"][0][keep] / expected
    sigma = np.sqrt(2 / (3 * 256) / ratio.size)
    assert ratio.mean() == pytest.approx(1, abs=4 * sigma)


def test_written_set_reads_back_and_its_truth_lies_outside(tmp_path) -> None:
    """The folder holds the frames as developed; the truth is next to it and nowhere in it."""
    session = make_session("dark_current", camera_seed=4, plan="bracket", frames=2)
    session.write(tmp_path / "set")
    back = CaptureSet.read(tmp_path / "set")
    assert all(
        np.array_equal(a.dn, b.dn) and a.settings == b.settings
        for a, b in zip(back.frames(), session.frames(), strict=True)
    )
    assert (tmp_path / "set.truth.yaml").read_text().count("dark_current") == 2
    assert "dark_current:" not in (tmp_path / "set" / "capture.yaml").read_text()


# Other kinds of data have the forms that the world uses and the physics that they claim.


def _emva_steps(descriptor: Path) -> list[tuple[str, float, list[np.ndarray]]]:
    steps: list[tuple[str, float, list[np.ndarray]]] = []
    for line in descriptor.read_text().splitlines():
        kind, *rest = line.split()
        if kind in "bd":
            steps.append((kind, float(rest[-1]), []))
        elif kind == "i":
            steps[-1][2].append(cv2.imread(str(descriptor.parent / rest[0].replace("\\", "/")), cv2.IMREAD_UNCHANGED))
    return steps


def test_emva_set_gives_the_declared_gain_by_the_standards_own_method(tmp_path: Path) -> None:
    """The photon-transfer slope of the pairs (EMVA 1288 equations 18-20) is 1/2.6 DN per electron within 4 sigmas."""
    steps = _emva_steps(write_emva_set(tmp_path / "emva", camera_seed=1))
    bright = [(a.mean() + b.mean(), ((a.astype(float) - b) ** 2).mean() / 2) for k, _, (a, b) in steps if k == "b"]
    means, variances = np.array(bright).T
    use = (means / 2 > 500) & (means / 2 < 3500)
    slopes = variances[use] / (means[use] / 2 - 240 + 2.4**2 / 2.6)
    sigma = (1 / 2.6) * math.sqrt(2 / (96 * 144) / use.sum())
    assert slopes.mean() == pytest.approx(1 / 2.6, abs=4 * sigma)


def test_photographs_of_exact_stops_are_one_stop_apart_where_labels_are_not(tmp_path: Path) -> None:
    """Real exposures are exact powers of two; printed ones are not."""
    truth = write_photographs(tmp_path / "stack", seed=2)
    ratios = [b / a for a, b in itertools.pairwise(truth["real_s"])]
    assert ratios == pytest.approx([0.5] * 8) or ratios == pytest.approx([2.0] * 8)
    assert any(
        abs(b / a / r - 1) > 0.02 for (a, b), r in zip(itertools.pairwise(truth["printed_s"]), ratios, strict=True)
    )

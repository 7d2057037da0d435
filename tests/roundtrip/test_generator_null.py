"""The generator with nothing hidden follows the sensor it declares."""

import numpy as np
import pytest

from radiometer.data import CaptureSet
from testing.generator.session import Session, make_session
from testing.generator.statistics import blocks_of


def _unclipped(session: Session, level_dn: float = 3600) -> np.ndarray:
    means = blocks_of(session)["mean"][0]
    return means.max(axis=1) < level_dn


def _gains(session: Session) -> np.ndarray:
    """Return the amplifier's factor of every capture."""
    settings = [e.settings for e in session.header.frames[::4]]
    return np.array([10 ** (s.gain_db / 20) for s in settings])


def test_photon_transfer_slope_is_the_declared_conversion_gain(null_session: Session) -> None:
    """At every gain the variance grows with the mean by K of the data sheet, within 4 predicted sigmas."""
    blocks, gain = blocks_of(null_session), _gains(null_session)
    keep = _unclipped(null_session) & (blocks["mean"][0].max(axis=1) > 400)
    k = (gain / 2.6)[keep, None]
    signal_dn = blocks["mean"][0][keep] - 240
    expected = k * signal_dn + (k * 2.4) ** 2 + 1 / 12
    ratio = blocks["variance"][0][keep] / expected
    sigma = np.sqrt(2 / (3 * 256) / ratio.size)
    assert ratio.mean() == pytest.approx(1, abs=4 * sigma)


def test_same_seeds_give_the_same_frames_and_others_do_not() -> None:
    """A session is a function of its seeds alone."""
    one, two, other = (make_session("prnu", camera_seed=2, session_seed=s, plan="bracket") for s in (7, 7, 8))
    first, again, different = (next(iter(s.frames())).dn for s in (one, two, other))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, different)


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

"""The generator with nothing hidden follows the sensor it declares."""

import itertools

import numpy as np
import pytest

from radiometer.data import CaptureSet
from testing.generator.session import Session, make_session
from testing.generator.statistics import blocks_of


def _unclipped(session: Session, level_dn: float = 3600) -> np.ndarray:
    means = blocks_of(session)["mean"][0]
    return means.max(axis=1) < level_dn


def _firsts(session: Session) -> list:
    keys = [(f.timestamp_s, f) for f in session.header.frames]
    return [group[0] for group in (keys_[1:] and [keys_[1]] for keys_ in keys)]


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


def test_dark_variance_is_read_noise_dark_shot_noise_and_rounding(null_session: Session) -> None:
    """Cap-on frames scatter by read noise, dark current's shot noise and rounding, within 4 predicted sigmas."""
    blocks, gain = blocks_of(null_session), _gains(null_session)
    entries = null_session.header.frames[::4]
    dark = np.array([e.shutter == "closed" for e in entries])
    k = gain[dark] / 2.6
    leaked = np.array([e.exposure_s * 2 ** ((e.temperature_C - 25) / 7) for e in itertools.compress(entries, dark)])
    expected = k**2 * (2.4**2 + leaked) + 1 / 12
    ratio = blocks["variance"][0][dark] / expected[:, None]
    sigma = np.sqrt(2 / (3 * 256) / ratio.size)
    assert ratio.mean() == pytest.approx(1, abs=4 * sigma)


def test_repeated_reference_scatters_by_the_declared_jitter(null_session: Session) -> None:
    """The reference setting's signal scatters by the lamp's 0.1 %, within the 99.9 % interval of its estimate."""
    means = blocks_of(null_session)["mean"][0] - 240
    entries = null_session.header.frames[::4]
    here = np.array([e.exposure_s == 0.9e-3 and e.source_level == 0.8 for e in entries])
    total = means[here].sum(axis=1)
    n = int(here.sum())
    from scipy.stats import chi2

    scaled = (n - 1) * (total / total.mean()).var(ddof=1) / 0.001**2
    low, high = chi2.ppf([0.0005, 0.9995], n - 1)
    assert low < scaled < high


def test_signal_is_proportional_to_stated_radiance(null_session: Session) -> None:
    """Patch signals over stated radiances agree within the stated 0.5 %, and their scatter is that size."""
    blocks = blocks_of(null_session)
    number = next(
        i for i, e in enumerate(null_session.header.frames[::4]) if e.source_level == 0.8 and e.pattern == "chart"
    )
    stated = np.array([p.radiance("chart") for p in null_session.header.patches])
    ratio = (blocks["mean"][0][number] - 240) / stated
    ratio /= ratio.mean()
    bright = stated > 0.5
    assert np.all(np.abs(ratio[bright] - 1) < 5 * 0.005)
    assert 0.002 < ratio[bright].std() < 0.01


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

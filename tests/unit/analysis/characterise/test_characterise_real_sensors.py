"""What real sensors need of a characterisation, held against numbers drawn here by other formulas."""

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.characterise import characterise, read_subject
from radiometer.analysis.characterise.group_statistics import (
    GroupStatistics,
    NoiseLeft,
    split_spatial_variance,
    statistics_of_group,
)
from radiometer.analysis.characterise.photon_transfer import photon_transfer
from radiometer.analysis.characterise.result import as_printed
from radiometer.analysis.characterise.steps import contradicting_steps, make_steps
from radiometer.analysis.signal.rounding import unrounded_variance
from radiometer.data import FrameSettings, Quantity

K_DN_PER_E = 0.5
BLACK_DN = 1000.0
SIGNALS = np.linspace(200.0, 6000.0, 16)


def group(mean, variance, exposure_s=1.0, *, dark=False, photons=None, frames=2, pixels=90_000):
    """Return statistics without pictures."""
    settings = FrameSettings(exposure_s, shutter="closed" if dark else "open")
    return GroupStatistics(settings, frames, pixels, mean, variance, 0.0, 0.0, photons)


def ladder(gain=lambda signal: K_DN_PER_E, signals=SIGNALS):
    """Return bright steps whose variance is the signal times a gain that may change with the signal."""
    bright = [group(BLACK_DN + s, 40.0 + gain(s) * s, photons=2.0 * s) for s in signals]
    return make_steps(bright, [group(BLACK_DN, 40.0, dark=True)])


def rounded_steps(rng, K, noise_dn, black_dn, dsnu_dn, count):
    """Return steps of frames drawn here and rounded to whole codes of 8 bits."""
    shape = (120, 160)
    black = black_dn + dsnu_dn * rng.standard_normal(shape)

    def statistics(signal_dn):
        frames = [
            np.round(black + K * rng.poisson(signal_dn / K, shape) + noise_dn * rng.standard_normal(shape))
            for _ in range(2)
        ]
        settings = FrameSettings(1.0, shutter="open" if signal_dn else "closed")
        return statistics_of_group([f.astype(np.uint8) for f in frames], settings, (None,), 255, signal_dn)[0]

    return make_steps([statistics(s) for s in np.linspace(5.0, 190.0, count)], [statistics(0.0)])


@pytest.mark.parametrize(
    ("noise_dn", "black_dn", "dsnu_dn"), [(0.0, 8.1, 0.3), (0.15, 8.0, 0.0), (0.25, 8.4, 0.0), (0.35, 8.3, 0.2)]
)
def test_gain_where_rounding_hides_the_dark_noise(noise_dn, black_dn, dsnu_dn):
    """8-bit codes, 0.05 DN per electron: K within 2 U of the truth in each of 4 draws, and known to 4 %."""
    for seed in range(4):
        found = photon_transfer(rounded_steps(np.random.default_rng(seed), 0.05, noise_dn, black_dn, dsnu_dn, 9), 255.0)
        assert found.rounded
        assert abs(found.K.value - 0.05) < 4 * found.K.u
        assert found.K.u < 0.02 * 0.05


@pytest.mark.parametrize("step_dn", [1, 4])
@pytest.mark.parametrize("noise", [0.15, 0.3, 0.42, 0.8])
@pytest.mark.parametrize(("fraction", "spread"), [(0.0, 0.0), (0.3, 0.0), (0.2, 0.3), (0.5, 1.0)])
def test_the_variance_before_rounding(noise, fraction, spread, step_dn):
    """Normal noise, rounded to codes a step apart: the truth is within the stated range (2 u, or its rectangle)."""
    rng = np.random.default_rng(3)
    centre = 20.0 + fraction + spread * rng.standard_normal(20_000)
    codes = step_dn * np.round(centre + noise * rng.standard_normal((40, 20_000)))
    variance = float(codes.var(axis=0, ddof=1).mean())
    u = variance * math.sqrt(2.0 / (39 * 20_000))
    spatial = max(float(codes.mean(axis=0).var(ddof=1)) - variance / 40, 0.0)
    found = unrounded_variance(variance, u, float(codes.mean()), spatial, step_dn)
    assert found.value == pytest.approx((noise * step_dn) ** 2, abs=2.5 * found.u + 0.003 * step_dn**2)


@pytest.mark.parametrize(
    ("value", "u", "shown"),
    [(-650_000.0, 390_000.0, ("not determined", "< 6.4·10⁵, 95 %")),
     (3.0, 2.0, ("not determined", "< 6.3, 95 %")),
     (3.0, 1.0, ("3.0", "2.0"))],
)  # fmt: skip
def test_a_figure_with_a_u_above_its_size_is_printed_as_a_limit(value, u, shown):
    """A dark current of −650,000 ± 780,000 e⁻/s is none: what is known is that it is below."""
    assert as_printed("mu_I_mean", Quantity(value, u, "e-/s")) == shown


@pytest.mark.parametrize("count", [5, 9, 20])
def test_of_a_bent_transfer_k_is_the_standards_and_covers_both_ends(count):
    """Variance over mean falls from 0.027 to 0.020: K is the unweighted slope, and U reaches both ends."""
    signals = np.linspace(200.0, 6000.0, count)
    steps = ladder(lambda s: 0.027 - 0.007 * (s - 200.0) / 5800.0, signals)
    found = photon_transfer(steps, 10_000.0)
    light = (0.027 - 0.007 * (signals - 200.0) / 5800.0) * signals
    assert found.K.value == pytest.approx(signals @ light / (signals @ signals), rel=1e-9)
    assert found.bend_u > 0
    for end in found.local:
        assert abs(found.K.value - end) <= 2 * found.K.u
    assert found.local[0] > 0.0245
    assert found.local[1] < 0.023
    assert photon_transfer(ladder(), 10_000.0).bend_u == 0.0


def picture(row_sd, column_sd, pixel_sd, shape=(300, 400), seed=5):
    """Return a picture of independent rows, columns and pixels."""
    rng = np.random.default_rng(seed)
    rows, columns = rng.normal(0, row_sd, (shape[0], 1)), rng.normal(0, column_sd, (1, shape[1]))
    return 500.0 + rows + columns + rng.normal(0, pixel_sd, shape)


def test_the_standards_equations_give_the_same():
    """Solved as the standard has it (variances over MN, N and M) the parts agree to 1/M."""
    y = picture(1.5, 0.7, 2.5)
    M, N = y.shape
    av, cav, rav = y.var(), y.mean(axis=0).var(), y.mean(axis=1).var()
    pixel = M * N / (M * N - M - N) * (av - cav - rav)
    row = (M * N - M) / (M * N - M - N) * rav - N / (M * N - M - N) * (av - cav)
    column = (M * N - N) / (M * N - M - N) * cav - M / (M * N - M - N) * (av - rav)
    found = split_spatial_variance(y, NoiseLeft(0.0, 0.0, 0.0))
    assert (found.row_dn2, found.column_dn2, found.pixel_dn2) == pytest.approx((row, column, pixel), rel=0.01)


@pytest.mark.parametrize("is_of_rows", [True, False])
def test_variances_are_known_no_better_than_by_the_rows_that_share_noise(is_of_rows):
    """Over 200 pairs with row (column) noise of 3, pixel noise of 2.4, pattern of 3: the scatter is the stated u."""
    rng = np.random.default_rng(7)
    shared = (40, 1) if is_of_rows else (1, 50)
    groups = []
    for _ in range(200):
        black = 500.0 + 3.0 * rng.standard_normal((40, 50))
        pair = [np.rint(black + rng.normal(0, 3.0, shared) + rng.normal(0, 2.4, (40, 50))) for _ in range(2)]
        groups += statistics_of_group(pair, FrameSettings(1.0), (None,), 4095)
    part = "row_dn2" if is_of_rows else "column_dn2"
    for values, u, truth in [
        ([g.variance_dn2 for g in groups], [g.u_variance_dn2 for g in groups], 9.0 + 5.76 + 1 / 12),
        ([g.spatial_variance_dn2 for g in groups], [g.u_spatial_variance_dn2 for g in groups], 9.0),
        ([getattr(g.split, part) for g in groups], [getattr(g.split, f"u_{part}") for g in groups], 0.0),
    ]:
        assert np.mean(values) == pytest.approx(truth, abs=0.4)
        assert np.mean(u) == pytest.approx(np.std(values), rel=0.15)


def test_saturation_is_no_contradiction():
    """Signals that stop rising with the light are the sensor's own."""
    steps = ladder()
    full = [replace(s.bright, mean_dn=min(s.bright.mean_dn, BLACK_DN + 4000.0)) for s in steps]
    assert contradicting_steps(make_steps(full, [group(BLACK_DN, 40.0, dark=True)])) == []


def test_a_table_of_statistics_is_characterised(tmp_path):
    """Means and variances per setting give K, dark current and read noise; nothing is claimed of patterns."""
    lines = ["exposure_ms,mean_dn,variance_dn2,frames,pixels,shutter,photons"]
    for signal in np.linspace(100, 3000, 12):
        lines.append(f"10,{64 + signal},{9 + 0.25 * signal},2,90000,open,{8 * signal}")
    lines += [f"{t},{64 + 0.01 * t},{9 + 0.0025 * t},2,90000,closed,0" for t in (10, 100, 1000, 4000)]
    (tmp_path / "t.csv").write_text("\n".join(lines))
    figures = characterise(read_subject(tmp_path / "t.csv")).figures
    assert figures["K"].value == pytest.approx(0.25, rel=0.01)
    assert figures["mu_I_mean"].value == pytest.approx(10.0 / 0.25, rel=0.01)
    assert figures["mu_I_var"].value == pytest.approx(2.5 / 0.25**2, rel=0.01)
    assert figures["sigma_d"].value == pytest.approx(math.sqrt(9 - 1 / 12) / 0.25, rel=0.01)
    assert "DSNU_1288" not in figures


@pytest.mark.slow
def test_the_real_ccd_over_two_years(shared_data):
    """One camera's darks of 2017 and 2019: doubling 4.5 to 5 K; gain from flats and darks agree within 2 u."""
    folder = shared_data / "sensors"
    if not folder.is_dir():
        pytest.skip("the CCD frames are not on this machine")
    first = characterise(read_subject(folder / "sbig_stl1001_2017"))
    second = characterise(read_subject(folder / "sbig_stl1001_2019")).figures
    figures = first.figures
    assert figures["T_d"].value == pytest.approx(4.9, abs=0.2)
    assert second["T_d"].value == pytest.approx(4.6, abs=0.15)
    assert 1 / figures["K"].value == pytest.approx(1.94, abs=0.01)
    for dark in (figures["K_dark"], second["K_dark"]):
        assert abs(dark.value - figures["K"].value) < 2 * math.hypot(dark.u, figures["K"].u)
    assert any("conversion_gain_error" in note and "+6." in note for note in first.notes)


def test_the_real_clamped_table_has_a_gain(shared_data):
    """Eight of twelve bits by clamping: K from the unclipped settings, without darks."""
    path = shared_data / "sensors" / "astrotracker_ptc_clamp" / "exposure_sweep_pairs.csv"
    if not path.is_file():
        pytest.skip("the table is not on this machine")
    result = characterise(read_subject(path))
    assert result.figures["K"].value == pytest.approx(3.4, abs=2 * result.figures["K"].u)
    assert any("clip" in note for note in result.notes)

"""EMVA 1288 figures from statistics worked out by hand: each factor, each term of u, each limit of a range."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiometer.analysis.characterise import characterise, read_subject
from radiometer.analysis.characterise.dark_signal import (
    dark_signal,
    dark_transfer,
    doubling_temperature,
    gain_from_darks,
    pooled_frame_sd,
    typical_dark_current,
    typical_rates,
    with_open_current,
)
from radiometer.analysis.characterise.group_statistics import (
    GroupStatistics,
    NoiseLeft,
    SpatialSplit,
    split_spatial_variance,
    statistics_of_group,
)
from radiometer.analysis.characterise.linearity import linearity
from radiometer.analysis.characterise.nonuniformity import best_stack, dsnu, nonuniformity_by_part, prnu
from radiometer.analysis.characterise.partial import bent, disagreeing_gains, stated_gain_doubt
from radiometer.analysis.characterise.photon_transfer import photon_transfer, transfer_of_few
from radiometer.analysis.characterise.report import outcome
from radiometer.analysis.characterise.result import Characterisation, as_printed
from radiometer.analysis.characterise.sensitivity import find_saturation, propagated, responsivity, sensitivity_figures
from radiometer.analysis.characterise.steps import contradicting_darks, contradicting_steps, make_steps
from radiometer.analysis.characterise.subject import FrameGroup, PhotonFlux, Subject, photon_flux
from radiometer.analysis.signal.rounding import unrounded_variance
from radiometer.data import (
    CameraDescription,
    FrameSettings,
    LensDescription,
    PatchDescription,
    Provenance,
    Quantity,
    SourceDescription,
)
from radiometer.errors import MeasurementError
from radiometer.statistics.scale import typical_pixels

BLACK_DN = 100.0

SIGNALS = np.linspace(200.0, 6000.0, 16)


def group(
    mean, variance, exposure_s=1.0, *, dark=False, level=1.0, celsius=None, gain_db=0.0, frames=2, pixels=90_000, **more
):
    """Return the statistics of frames of one setting, without pictures."""
    shutter = "closed" if dark else "open"
    settings = FrameSettings(exposure_s, gain_db, temperature_c=celsius, source_level=level, shutter=shutter)
    figures = {"spatial_variance_dn2": 0.0, "clipped_share": 0.0} | more
    return GroupStatistics(settings, frames, pixels, mean, variance, **figures)


def steps_of(variances, signals=SIGNALS, dark_variance=40.0, photons=None, pixels=90_000):
    """Return steps of given signals and variances, whose light is twice the signal where no photons are given."""
    photons = 2.0 * np.asarray(signals) if photons is None else photons
    each = zip(np.broadcast_to(variances, len(signals)), signals, photons, strict=True)
    bright = [group(BLACK_DN + signal, v, photons=p, pixels=pixels) for v, signal, p in each]
    return make_steps(bright, [group(BLACK_DN, dark_variance, dark=True, pixels=pixels)])


def lit_groups(variances):
    """Return lit groups of given variances whose signals are as their exposures of up to 1 s."""
    return [group(BLACK_DN + s, v, s / 6000.0) for s, v in zip(SIGNALS, variances, strict=True)]


def test_the_stated_uncertainty_of_the_gain_is_its_scatter():
    """Over 400 draws of variances with the chance that so few pixels leave, K scatters by its mean u within 15 %."""
    rng, pixels = np.random.default_rng(4), 200
    values, stated = [], []
    for _ in range(400):
        chance = rng.chisquare(pixels - 1, SIGNALS.size + 1) / (pixels - 1)
        steps = steps_of((40.0 + 0.5 * SIGNALS) * chance[1:], SIGNALS, 40.0 * chance[0], pixels=pixels)
        found = photon_transfer(steps, 10_000.0)
        values.append(found.K.value)
        stated.append(found.line.u_slope / max(found.line.birge_ratio, 1.0))
    assert np.std(values) == pytest.approx(np.mean(stated), rel=0.15)


@pytest.mark.parametrize("step_dn", [1, 4, 8])
def test_noise_that_rounding_hides_is_a_bound_as_wide_as_itself(step_dn):
    """σ² below 0.24 steps² (EMVA 1288, 6.7) is at most that, not known to 1e-9; beyond it is what is measured."""
    for share in (0.0, 0.23):
        found = dark_signal([group(100.0, share * step_dn**2, dark=True)], step_dn)
        assert found.quantisation_limited
        assert found.variance_dn2.value == pytest.approx(0.24 * step_dn**2)
        assert found.variance_dn2.u == pytest.approx(0.24 * step_dn**2 / np.sqrt(3.0))
    loud = dark_signal([group(100.0, 0.25 * step_dn**2, dark=True)], step_dn)
    assert (loud.variance_dn2.value, loud.quantisation_limited) == (pytest.approx(0.25 * step_dn**2), False)
    figures = sensitivity_figures(
        Quantity(0.5, 0.0, "DN/e-"), found.variance_dn2, None, None, found.noise_dn2, is_bound=True
    )
    most = np.sqrt(0.24 - 1.0 / 12.0) * step_dn / 0.5
    assert figures["sigma_d"].value == pytest.approx(most / 2.0)
    assert figures["sigma_d"].u == pytest.approx(most / np.sqrt(12.0))
    assert figures["sigma_y_dark"].u > 0.25 * figures["sigma_y_dark"].value


@pytest.mark.parametrize("place", [0.0, 0.5])
@pytest.mark.parametrize("noise_dn", [0.41, 0.455, 0.5, 0.6, 1.0])
def test_noise_that_does_not_blur_the_codes_is_known_as_well_as_the_place_between_them(noise_dn, place):
    """On a code 0.455 DN read as 0.43 by 1/12 DN², between two 0.41 DN as 0.435: k = 2 covers the truth at 1 e⁻/DN."""
    rng = np.random.default_rng(7)
    frames = [np.rint(64.0 + place + rng.normal(0.0, noise_dn, (60, 80))).astype(np.uint16) for _ in range(28)]
    darks = statistics_of_group(frames, FrameSettings(1.0, shutter="closed"), (None,), 4095)
    found = dark_signal(darks)
    if found.quantisation_limited:
        assert noise_dn < math.sqrt(0.24)
        return
    figures = sensitivity_figures(Quantity(1.0, 0.0, "DN/e-"), found.variance_dn2, None, None, found.noise_dn2)
    assert abs(figures["sigma_d"].value - noise_dn) <= 2.0 * figures["sigma_d"].u
    assert figures["sigma_d"].u < 0.08 * noise_dn  # predicted variances hold to 5 %, and the grid is as fine


def test_darks_alone_tell_noise_and_doubt_no_statement():
    """Rounding that hides it has a note and a u of its size; noise cut off at zero is refused."""
    result = characterise(subject(), [group(100.0, 0.05, t, dark=True) for t in (1.0, 2.0)])
    assert result.figures["sigma_y_dark"].value == pytest.approx(np.sqrt(0.24))
    assert result.figures["sigma_y_dark"].u > 0.1
    assert any("below 0.24 DN²" in note for note in result.notes)
    found = characterise(subject(conversion_gain_e_per_dn=2.5), [group(BLACK_DN, 40.0, dark=True)])
    assert found.figures["sigma_y_dark"].value == pytest.approx(math.sqrt(40.0))
    assert not any("conversion_gain_error" in note for note in found.notes)
    with pytest.raises(MeasurementError, match="raise the camera's black level"):
        characterise(subject(), drawn_darks(0.0, 2.0))


def test_light_is_exposure_times_level_or_the_photons():
    """Photons go before both; R is known no better than they; a step of no signal has none."""
    dark = [group(BLACK_DN, 40.0, t, dark=True) for t in (1.0, 2.0)]
    bright = [group(500.0, 240.0, 2.0, level=0.25), group(500.0, 240.0, 1.0, level=1.0)]
    assert [s.light for s in make_steps(bright, dark)] == [0.5, 1.0]
    assert make_steps([group(500.0, 240.0, 2.0, level=0.25, photons=7e3)], dark)[0].light == 7e3
    steps = steps_of(40.0 + 0.5 * SIGNALS)
    found = responsivity(steps, find_saturation(steps), 0.03)
    assert found.value == pytest.approx(0.5, rel=1e-9)
    assert found.u_rel == pytest.approx(0.03, rel=1e-3)
    saturation = find_saturation(steps)
    nothing = replace(steps[0], bright=replace(steps[0].bright, mean_dn=BLACK_DN), light=2000.0)
    assert responsivity([nothing, *steps], saturation, 0.0).value == responsivity(steps, saturation, 0.0).value


def test_darkness_is_that_of_the_light_s_exposure():
    """On a line at another one, with its u; DSNU by the frames at 1 s; hot pixels that fill bend none."""
    dark = [group(BLACK_DN + 5.0 * t, 40.0, t, dark=True) for t in (1.0, 2.0, 3.0)]
    (step,) = make_steps([group(900.0, 240.0, 12.0)], dark)
    u_mean = math.sqrt(40.0 / (2 * 90_000))
    assert step.dark_mean_dn == pytest.approx(BLACK_DN + 60.0)
    assert step.u_dark_mean_dn == pytest.approx(u_mean * math.sqrt(1 / 3 + 10.0**2 / 2))
    dark = replace(group(BLACK_DN, 40.0, dark=True, split=NO_SPLIT), spatial_variance_dn2=9.0)
    long = replace(group(BLACK_DN, 40.0, 10.0, dark=True, split=NO_SPLIT), spatial_variance_dn2=49.0, frames=8)
    for darks in ((dark, long), (long, dark)):
        assert whole(*darks).figures["DSNU_1288"].value == pytest.approx(6.0, rel=1e-6)
    darks = [group(100.0 + t, 40.0 + 2.0 * t, t, dark=True) for t in (1.0, 2.0, 4.0)]
    found = dark_signal([*darks, group(104.0, 44.0, 8.0, dark=True, clipped_share=0.01)])
    assert (found.mean_dn.value, found.variance_dn2.value) == pytest.approx((100.0, 40.0))


def frames(count, offsets, noise, shape=(60, 70), seed=3):
    """Return frames of even light with offsets of their own and pixel noise."""
    rng = np.random.default_rng(seed)
    return [np.rint(1000.0 + offsets[n] + rng.normal(0.0, noise, shape)).astype(np.uint16) for n in range(count)]


def test_frames_that_jump_and_cosmic_rays_are_within_u():
    """σ_y² is 36 + 1/12 DN² whatever the frames' means do; a track is covered by U."""
    (steady,) = statistics_of_group(frames(8, [0.0] * 8, 6.0), FrameSettings(1.0), (None,), 4095)
    (unsteady,) = statistics_of_group(
        frames(8, [0, 30, -20, 10, 5, -40, 25, 0], 6.0), FrameSettings(1.0), (None,), 4095
    )
    for one in (steady, unsteady):
        assert one.variance_dn2 == pytest.approx(36.0 + 1 / 12, abs=4 * one.u_variance_dn2)
        assert one.spatial_variance_dn2 == pytest.approx(0.0, abs=4 * one.u_spatial_variance_dn2)
        assert one.u_spatial_variance_dn2 < 0.3
    assert steady.degrees_of_freedom == 7 * (60 * 70 - 1)
    assert steady.u_variance_dn2 == pytest.approx(steady.variance_dn2 * math.sqrt(2.0 / (7 * 4199)), rel=1e-3)
    rng = np.random.default_rng(7)
    hit = [np.rint(rng.normal(100.0, 2.0, (256, 256))).astype(np.uint16) for _ in range(5)]
    hit[3][100, 50:70] += 300
    (found,) = statistics_of_group(hit, FrameSettings(0.0, shutter="closed"), (None,), 4095)
    expected = 2.0**2 + 1.0 / 12.0
    assert found.variance_dn2 > 1.1 * expected
    assert abs(found.variance_dn2 - expected) <= 2.0 * found.u_variance_dn2


def test_noise_of_few_rows_is_parted_from_patterns():
    """6/0.6 of 9 DN² are left of 4 × 5 pixels; over 600 pictures rows come out as zero, pixels as one."""
    rng = np.random.default_rng(6)
    none = NoiseLeft(0.0, 0.0, 0.0)
    found = [split_spatial_variance(rng.standard_normal((4, 50)), none) for _ in range(600)]
    assert np.mean([f.row_dn2 for f in found]) == pytest.approx(0.0, abs=0.004)
    assert np.mean([f.column_dn2 for f in found]) == pytest.approx(0.0, abs=0.01)
    assert np.mean([f.pixel_dn2 for f in found]) == pytest.approx(1.0, abs=0.02)
    left = NoiseLeft.of(9.0, 2.0, 1.0, 2, (4, 5))
    assert (left.row_means_dn2, left.column_means_dn2) == (1.0, 0.5)
    assert left.rest_dn2 == pytest.approx(6.0 / ((1 - 1 / 4) * (1 - 1 / 5)) / 2)
    assert NoiseLeft.of(2.0, 2.0, 1.0, 2, (4, 5)).rest_dn2 == 0.0


def test_patterns_of_darkness_and_light():
    """DSNU √9/K = 6 e⁻; PRNU √(25 − 9)/400 = 1 %; rows, columns and pixels alike."""
    dark = group(BLACK_DN, 0.0, dark=True, spatial_variance_dn2=9.0)
    bright = group(BLACK_DN + 400.0, 0.0, spatial_variance_dn2=25.0)
    found = dsnu(dark, Quantity(0.5, 0.05, "DN/e-"))
    assert found.value == pytest.approx(6.0)
    assert found.u == pytest.approx(0.6, rel=1e-3)
    assert prnu(bright, [dark], 400.0).value == pytest.approx(1.0)
    # Of other exposures the pattern grows as time: 9 DN² at 0 s and 100 DN² at 10 s.
    longer = [group(BLACK_DN, 0.0, t, dark=True, spatial_variance_dn2=9.0 + t**2) for t in (10.0, 40.0)]
    short = group(BLACK_DN + 400.0, 0.0, 0.01, spatial_variance_dn2=25.0)
    assert prnu(short, longer, 400.0).value == pytest.approx(1.0, rel=0.01)
    alone = prnu(short, longer[:1], 400.0)
    assert abs(alone.value - 1.0) <= 2.0 * alone.u
    dark_split = SpatialSplit(9.0, 9.0, 9.0, 0.1, 0.1, 0.1)
    dark = group(BLACK_DN, 40.0, dark=True, split=dark_split)
    bright = group(BLACK_DN + 400.0, 240.0, split=SpatialSplit(25.0, 9.0, 109.0, 0.2, 0.2, 0.2))
    K = Quantity(0.5, 0.0, "DN/e-")
    found = nonuniformity_by_part(bright, [dark], K, 400.0)
    assert {name: one.value for name, one in found.items() if name.startswith("PRNU")} == pytest.approx(
        {"PRNU_row": 1.0, "PRNU_column": 0.0, "PRNU_pixel": 2.5}
    )
    assert [found[f"DSNU_{part}"].value for part in ("row", "column", "pixel")] == pytest.approx([6.0] * 3)
    assert found["PRNU_pixel"].u == pytest.approx(100.0 / 400.0 * math.hypot(0.2, 0.1) / (2.0 * 10.0), rel=0.01)
    assert found["DSNU_row"].u == pytest.approx(0.1 / (2.0 * 3.0) / 0.5, rel=1e-2)
    assert sorted(nonuniformity_by_part(bright, [dark], None, 400.0)) == ["PRNU_column", "PRNU_pixel", "PRNU_row"]
    assert sorted(nonuniformity_by_part(None, [dark], K)) == ["DSNU_column", "DSNU_pixel", "DSNU_row"]
    assert nonuniformity_by_part(bright, [], K) == {}
    assert best_stack([replace(bright, frames=n) for n in (2, 5, 3)], 1000.0, BLACK_DN).frames == 5


def test_figures_follow_from_gain_darkness_and_saturation():
    """By the standard's formulae; SNR_max is a root of a saturation that is hardly known."""
    exact = {"K": 0.5, "var": 4.0 + 1 / 12, "sat": 5000.0, "eta": 50.0}
    K, var, sat, eta = (Quantity(v, 1e-9, "") for v in exact.values())
    figures = {name: q.value for name, q in sensitivity_figures(K, var, sat, eta).items()}
    threshold = math.sqrt(4.0 + 1 / 12) / 0.5 + 0.5
    assert figures["sigma_d"] == pytest.approx(4.0)
    assert (figures["mu_e_min"], figures["mu_p_min"]) == pytest.approx((threshold, 2 * threshold))
    assert (figures["mu_e_sat"], figures["mu_p_sat"]) == pytest.approx((10_000.0, 20_000.0))
    assert (figures["SNR_max"], figures["SNR_max_dB"]) == pytest.approx((100.0, 40.0))
    assert figures["DR"] == pytest.approx(10_000.0 / threshold)
    assert figures["DR_dB"] == pytest.approx(20 * math.log10(10_000.0 / threshold))
    found = sensitivity_figures(
        Quantity(0.5, 0.0, "DN/e-"), Quantity(40.0, 1.0, "DN2"), Quantity(1e3, 1.7e3, "DN"), None
    )
    assert found["SNR_max"].value == pytest.approx(math.sqrt(2000.0))
    assert found["SNR_max"].u_rel == pytest.approx(0.85, rel=0.05)


def test_saturation_is_where_the_variance_is_largest():
    """Its signal, light and u; the line through it is that below 70 %; beyond is the plateau."""
    variances = np.where(np.arange(16) <= 11, 40.0 + 0.5 * SIGNALS, 5.0)
    steps = steps_of(variances)
    found = find_saturation(steps)
    assert (found.signal_dn, found.light) == pytest.approx((SIGNALS[11], 2.0 * SIGNALS[11]))
    spacing = float(SIGNALS[1] - SIGNALS[0])
    assert found.u_light_rel == pytest.approx(spacing / math.sqrt(3) / SIGNALS[11], rel=1e-6)
    assert found.linear_signal_dn == pytest.approx(SIGNALS[11])
    assert found.u_linear_signal_dn == pytest.approx(spacing / math.sqrt(3), rel=0.01)
    assert found.reached
    assert found.plateau_dn.value == pytest.approx(BLACK_DN + SIGNALS[15])
    rising = find_saturation(steps_of(40.0 + 0.5 * SIGNALS))
    assert not rising.reached
    assert rising.plateau_dn is None
    signals = np.where(SIGNALS > 0.7 * 6000.0, 0.9 * SIGNALS + 0.07 * 6000.0, SIGNALS)
    steps = steps_of(40.0 + signals, signals, photons=2.0 * SIGNALS)
    found = find_saturation(steps)
    assert found.signal_dn == pytest.approx(signals[-1])
    assert found.linear_signal_dn == pytest.approx(6000.0, rel=1e-6)
    assert responsivity(steps, found, 0.0).value == pytest.approx(0.5, rel=1e-6)
    # Of a chart, whose pixels differ by 180 % of the mean, the mean does not show where one is full.
    chart = find_saturation([changed(one, spatial_variance_dn2=(1.8 * one.signal_dn) ** 2) for one in steps])
    assert chart.u_linear_signal_dn == pytest.approx(1.8 * 6000.0, rel=0.01)
    with pytest.raises(MeasurementError, match="2 bright steps"):
        find_saturation(steps[:2])
    with pytest.raises(MeasurementError, match="does not rise"):
        find_saturation(steps_of(0.0, np.zeros(16), 0.0, photons=2.0 * SIGNALS))


def test_linearity_errors_are_relative_and_have_a_sign():
    """A step 5 % too low is negative; two lights and four steps are the fewest."""
    signals = SIGNALS[1:].copy()
    light = 2.0 * signals
    signals[0] *= 0.95
    steps = steps_of(100.0, signals, photons=light)
    found = linearity(steps, 6500.0)
    design = np.column_stack([light, np.ones_like(light)]) / signals[:, None]
    a, b = np.linalg.lstsq(design, np.ones_like(light), rcond=None)[0]
    expected = 100.0 * (signals - a * light - b) / (a * light + b)
    assert (found.LE_min.value, found.LE_max.value) == pytest.approx((expected.min(), expected.max()))
    assert found.LE_min.value == pytest.approx(expected[0])
    assert found.LE_min.value < -1.0
    own = 100.0 * np.array([step.u_signal_dn for step in steps]) / (a * light + b)  # in %, as the deviations are
    assert [u for _, _, u in found.deviations] == pytest.approx(own)
    assert found.LE_max.u == found.LE_min.u == pytest.approx(own.max() * math.sqrt(2.0 * math.log(light.size)))

    def scattering(share: float):
        lit = [replace(one.bright, frame_variance_dn2=(share * one.signal_dn) ** 2) for one in steps]
        return linearity([replace(one, bright=bright) for one, bright in zip(steps, lit, strict=True)], 6500.0)

    assert (found.unsteady_light, scattering(1e-6).unsteady_light) == (0.0, 0.0)
    assert scattering(0.02).unsteady_light == pytest.approx(2.0, rel=0.01)
    # Of two frames each: the scatter over √2, times what the largest of as many steps is expected to be
    expected_u = 2.0 / math.sqrt(2.0) * math.sqrt(2.0 * math.log(light.size))
    assert scattering(0.02).LE_max.u == pytest.approx(expected_u, rel=0.1)

    def found(*lights: float):
        return linearity(steps_of(100.0, 1000.0 * (1.0 + np.arange(len(lights))), photons=lights), 6000.0)

    assert found(2000.0, 2000.0, 2000.0, 2000.0) is None
    assert found(2000.0, 4000.0, 6000.0) is None
    assert found(2000.0, 2000.0, 4000.0, 4000.0) is not None


@pytest.mark.parametrize(("saturation_dn", "used"), [(4000.0, 5), (4001.0, 4), (3999.0, 4)])
def test_linearity_is_of_five_to_ninety_five_percent_of_saturation(saturation_dn, used):
    """Signals at the ends of that range belong to it; dimmer and brighter ones may lie where they like."""
    signals = np.array([150.0, 199.0, 200.0, 1000.0, 2000.0, 3000.0, 3800.0, 3801.0, 5000.0])
    light = np.array([5.0, 7e3, 400.0, 2000.0, 4000.0, 6000.0, 7600.0, 90.0, 9000.0])
    inner = light[(signals >= 0.05 * saturation_dn) & (signals <= 0.95 * saturation_dn)]
    found = linearity(steps_of(100.0, signals, photons=light), saturation_dn)
    assert sorted(x for x, _, _ in found.deviations) == inner.tolist()
    assert inner.size == used


def test_photons_of_a_surface():
    """Proportional to exposure and level, none in the dark; u of radiance, lens and lamp in squares; fewer off axis."""
    flux = PhotonFlux(1000.0, 0.0)
    assert flux.photons(FrameSettings(2.0, source_level=0.25)) == 500.0
    assert flux.photons(FrameSettings(2.0, shutter="closed")) == 0.0
    camera = CameraDescription(bit_depth=12, pixel_pitch_um=10.0)
    lens = LensDescription(
        focal_length_mm=1.0, f_number=4.0, vignetting="cos4", principal_point_px=(0.0, 0.0), transmittance_u_rel=0.02
    )
    source = SourceDescription(wavelength_nm=555.0, reproducibility_u_rel=0.01)

    def of(x, width=1):
        patch = PatchDescription(name="p", x=x, y=0, width=width, height=1, radiance_W_per_sr_m2=0.5, u_rel=0.03)
        return photon_flux(patch, "default", camera, lens, source, None, (101, 101))

    middle, corner = of(0), of(100)
    energy = 6.62607015e-34 * 299_792_458.0 / 555e-9
    assert middle.per_s == pytest.approx(0.5 * math.pi / (4 * 4.0**2) * 1e-10 / energy, rel=1e-3)
    assert corner.per_s / middle.per_s == pytest.approx(0.25, rel=0.02)  # 45°
    columns = [of(x).per_s for x in range(101)]
    assert of(0, 101).per_s == pytest.approx(np.mean(columns), rel=1e-9)  # a patch has the mean of its pixels
    assert middle.u_rel == pytest.approx(math.sqrt(0.03**2 + 0.02**2 + 0.01**2))


def dark_plateau(temperatures_c, rate=2.0):
    """Return dark groups at 1, 2, 4 … s whose thermometer read what is given."""
    return [group(BLACK_DN + rate * 2.0**n, 40.0, 2.0**n, dark=True, celsius=t) for n, t in enumerate(temperatures_c)]


@pytest.mark.parametrize(
    ("slope", "off_dn", "at", "count", "top_dn", "named"),
    [
        (50.0, 0.0, [3], 8, 3000.0, 0), (50.0, 120.0, [3], 8, 3000.0, 1), (50.0, -120.0, [3], 8, 3000.0, 1),
        (0.0, 120.0, [3], 8, 3000.0, 1),
        (20.0, 200.0, [4], 10, 3000.0, 1), (20.0, 200.0, [2, 7], 10, 3000.0, 2),
        (20.0, 200.0, [2, 5, 7], 10, 3000.0, 0),
        (0.0, 9.0, [3], 8, 0.0, 0), (0.0, 11.0, [3], 8, 0.0, 1), (0.0, 19.0, [3], 8, 2000.0, 0),
        (0.0, 21.0, [3], 8, 2000.0, 1), (0.0, 21.0, [3], 5, 2000.0, 0),
    ],
)  # fmt: skip
def test_a_dark_group_off_the_line_of_the_others_is_named(slope, off_dn, at, count, top_dn, named):
    """From a tenth, and a hundredth of the brightest light, on; with what the others say; up to a fifth of six or more.

    10 % of 100 DN are 10 DN, and 1 % of light of 2000 DN are 20.
    """
    times = np.arange(1.0, count + 1.0)
    means = BLACK_DN + slope * times
    means[at] += off_dn
    darks = [group(mean, 40.0, time, dark=True) for mean, time in zip(means, times, strict=True)]
    found = contradicting_darks(darks, top_dn)
    assert [one.settings.exposure_s for one, _ in found] == times[at][:named].tolist()
    for (_, text), time, mean in zip(found, times[at], means[at], strict=False):
        straight = BLACK_DN + slope * time
        assert f"{mean:.4g} DN where all others say {straight:.4g}" in text
        assert text.endswith(f"({round(100.0 * off_dn / straight):+d} %)")


CAMERA = CameraDescription(bit_depth=12)

NO_SPLIT = SpatialSplit(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def subject(**camera):
    """Return frames of which nothing is known but their statistics."""
    return Subject("made", CAMERA.model_copy(update=camera), LensDescription(), (), (None,), (None,))


def lit_levels(black_dn=BLACK_DN, dark_dn2=40.0, **more):
    """Return groups of a camera of 0.5 DN per electron at one exposure and twelve levels."""
    return [
        group(black_dn + 3000.0 * x, dark_dn2 + 1500.0 * x, level=float(x), split=NO_SPLIT, **more)
        for x in np.geomspace(0.02, 1.0, 12)
    ]


def whole(*darks):
    """Return the figures of such a camera with dark groups."""
    return characterise(subject(), [*lit_levels(), *darks])


def drawn_darks(black_dn, sigma_dn, rate_dn_per_s=0.4, step_dn=1, hot=0.0):
    """Return groups of two drawn dark frames at five exposures, in codes as a camera writes them."""
    rng, found = np.random.default_rng(7), []
    hot_dn = np.where(np.arange(3600).reshape(60, 60) % 50 < 50 * hot, 40.0 * step_dn, 0.0)
    for t in np.linspace(0.1, 1.0, 5):
        dn = [rng.normal(black_dn + rate_dn_per_s * t + hot_dn, sigma_dn, (60, 60)) for _ in range(2)]
        codes = np.clip(np.rint(np.array(dn) / step_dn) * step_dn, 0, 65535).astype(np.uint16)
        found += statistics_of_group(iter(codes), FrameSettings(float(t), shutter="closed"), (None,), 65535)
    return found


@pytest.mark.parametrize("step_dn", [1, 4])
@pytest.mark.parametrize("hot", [0.0, 0.02])
@pytest.mark.parametrize(
    ("black", "sigma", "is_hidden"), [(25.3, 0.02, True), (25.45, 0.05, True), (25.3, 0.3, True), (25.0, 0.8, False)]
)
def test_what_rounding_hides_of_darkness_is_in_u_or_not_stated(black, sigma, is_hidden, hot, step_dn):
    """Black levels and dark currents of less than a code: the truth within 2 u, or no figure; also in the file."""
    darks = drawn_darks(black * step_dn, sigma * step_dn, 0.4 * step_dn, step_dn, hot)
    for groups in (darks, [*lit_levels(darks[-1].mean_dn, darks[-1].variance_dn2), *darks]):
        result = characterise(subject(code_step_dn=step_dn), groups)
        found = result.figures
        assert abs(found["mu_y_dark"].value - (black + 40.0 * hot) * step_dn) < 2 * found["mu_y_dark"].u
        for name, gain in (("mu_I_mean", 0.5), ("mu_I_typical", 0.5), ("mu_I_dn", 1.0)):
            assert name not in found or abs(found[name].value * gain - 0.4 * step_dn) < 2 * found[name].u * gain
        hidden = [note for note in result.notes if "rounding hides it" in note]
        assert bool(hidden) == is_hidden
        assert is_hidden == ("mu_I_var" not in found and "DSNU_1288" not in found) or groups is darks
        assert ("dark_current_e_per_s" in result.to_mapping()["camera"]) == ("mu_I_mean" in found)


@pytest.mark.parametrize(("black", "is_cut"), [(0.0, True), (3.0, True), (10.0, False)])
def test_noise_that_the_camera_cuts_off_at_zero_makes_no_figure_of_darkness(black, is_cut):
    """With σ = 2 DN a black level of 3 DN loses 6 % of the pixels: the gain stays, the file keeps what it had."""
    darks = drawn_darks(black, 2.0)
    result = characterise(subject(black_level_dn=7.0), [*lit_levels(black, 4.0), *darks])
    dark = {"mu_y_dark", "sigma_d", "mu_e_min", "mu_I_mean", "mu_I_var", "mu_I_typical", "DSNU_1288"}
    assert dark & set(result.figures) == (set() if is_cut else dark)
    assert any("raise the camera's black level" in note for note in result.notes) == is_cut
    assert result.figures["K"].value == pytest.approx(0.5, rel=0.02)
    kept = result.to_mapping()["camera"]
    assert (kept["black_level_dn"] == 7.0, "read_noise_e" not in kept) == (is_cut, is_cut)
    assert typical_rates(darks) == [] if is_cut else len(typical_rates(darks)) == 1


@pytest.mark.parametrize(("stated", "off"), [(2.0, None), (2.5, "+25.0 %"), (None, None)])
def test_one_level_of_light_shows_a_wrong_statement_of_the_gain(stated, off):
    """0.5 DN/e⁻ are 2 e⁻/DN: 2.5 are a quarter too many."""
    groups = [group(BLACK_DN + 1000.0, 540.0), group(BLACK_DN, 40.0, dark=True)]
    notes = characterise(subject(conversion_gain_e_per_dn=stated), groups).notes
    reported = [note for note in notes if note.startswith("conversion_gain_error")]
    assert [off in note for note in reported] == ([True] if off else [])


@pytest.mark.parametrize(("full", "ends"), [(True, " of noise and holds 5000"), (False, "of noise (k = 2).")])
def test_the_outcome_names_the_capacity_where_it_is_known(full, ends):
    """And says nothing of it where the light never reached saturation."""
    result = whole(group(BLACK_DN, 40.0, dark=True))
    figures = {name: q for name, q in result.figures.items() if name != "mu_e_sat"}
    if full:
        figures["mu_e_sat"] = Quantity(5000.0, 20.0, "e-")
    assert ends in outcome(replace(result, figures=figures)).replace("\u202f", "").replace("\u00a0", " ")


@pytest.mark.parametrize("turned", [False, True])
def test_variances_of_few_lines_scatter_by_their_stated_uncertainty(turned):
    """Of 4 rows, or 4 columns, of their own offsets: over 1500 pictures the scatter of s² is the mean of its u, to 8 %.

    Three degrees of freedom of a normal distribution: σ(s²) = s²·√(2/3), which 1500 draws determine to 3 %.
    """
    rng = np.random.default_rng(31)
    quiet, part = NoiseLeft(0.0, 0.0, 0.0), "column_dn2" if turned else "row_dn2"
    pictures = [3.0 * rng.standard_normal((4, 1)) + 0.1 * rng.standard_normal((4, 40)) for _ in range(1500)]
    splits = [split_spatial_variance(one.T if turned else one, quiet) for one in pictures]
    values, reported = ([getattr(one, name) for one in splits] for name in (part, f"u_{part}"))
    assert np.mean(values) == pytest.approx(9.0, rel=0.08)
    assert np.mean(reported) == pytest.approx(np.std(values), rel=0.08)


@pytest.mark.parametrize(
    ("dark", "word"), [(0.4851, "agrees with"), (0.4849, "differs from"), (0.5151, "differs from")]
)
def test_two_gains_agree_within_three_times_what_both_leave_open(dark, word):
    """0.003 and 0.004 DN/e⁻ make 0.005: a distance of 0.015 is the last that agrees, to either side."""
    (text,) = disagreeing_gains(Quantity(0.5, 0.003, "DN/e-"), Quantity(dark, 0.004, "DN/e-"))
    assert f"{word} that from light" in text
    assert "(3.0 u)" in text


def test_darkness_begins_at_0_s_on_the_line_of_its_exposures():
    """Of 1 and 2 s, in any order, as of three, which show scatter as well; one may hold dark electrons up to σ²/K²."""
    one, two = group(101.0, 40.0, 1.0, dark=True), group(102.0, 42.0, 2.0, dark=True)
    for darks in ([one, two], [two, one]):
        found = dark_signal(darks)
        assert (found.mean_dn.value, found.variance_dn2.value) == pytest.approx((100.0, 38.0))
        assert found.mean_line is None
    alone = dark_signal([one])
    K = Quantity(0.5, 0.0, "DN/e-")
    open_to = with_open_current(alone, [one], K, CameraDescription(bit_depth=12))
    assert open_to.mean_dn.u == pytest.approx(80.0 / math.sqrt(3.0), rel=1e-3)
    stated = CameraDescription(bit_depth=12, dark_current_e_per_s=1.0)  # of a single sensor up to three times as much
    assert with_open_current(alone, [one], K, stated).mean_dn.u == pytest.approx(1.5 / math.sqrt(3.0), rel=1e-2)
    found = dark_signal([two, group(103.0, 44.0, 3.0, dark=True), one])
    assert (found.mean_dn.value, found.variance_dn2.value) == pytest.approx((100.0, 38.0))
    assert found.mean_line.slope == pytest.approx(1.0)


def test_steps_beyond_saturation_are_in_no_range():
    """A saturated signal falls by what the dark signal grows: what comes back below 95 % is left out."""
    signals = np.array([400.0, 800.0, 1600.0, 3200.0, 3600.0, 3500.0, 3000.0, 2000.0])
    steps = make_steps(
        [group(4000.0 if n > 4 else BLACK_DN + s, 100.0 + s if n < 5 else 1.0, n + 1.0, photons=p)
         for n, (s, p) in enumerate(zip(signals, (400, 800, 1600, 3200, 3600, 5e3, 7e3, 9e3), strict=True))],
        [group(BLACK_DN if n < 5 else 4000.0 - s, 40.0, n + 1.0, dark=True) for n, s in enumerate(signals)],
    )  # fmt: skip
    found = find_saturation(steps)
    assert [s.signal_dn for s in found.rising(steps)] == pytest.approx(signals[:5])
    assert linearity(found.rising(steps), 3600.0).LE_max.value == pytest.approx(0.0, abs=1e-9)
    assert responsivity(steps, found, 0.0).value == pytest.approx(1.0)


def test_groups_count_frames_and_pixels():
    """(L − 1)·(N − 1) degrees of freedom, means by √(L·N), shares at both ends of all frames."""
    few = GroupStatistics(FrameSettings(1.0), 3, 5, 100.0, 8.0, 2.0, 0.0)
    assert few.degrees_of_freedom == 8.0
    assert few.u_variance_dn2 == pytest.approx(8.0 * math.sqrt(2.0 / 8.0))
    assert few.u_mean_dn == pytest.approx(math.sqrt(8.0 / 15.0))
    one = GroupStatistics(FrameSettings(1.0), 1, 5, 100.0, 0.0, 2.0, 0.0)
    assert (one.has_noise, few.has_noise) == (False, True)
    assert one.degrees_of_freedom == 1.0
    assert one.u_mean_dn == pytest.approx(math.sqrt(2.0 / 5.0))
    still = GroupStatistics(FrameSettings(1.0), 2, 50, 100.0, 0.0, 2.0, 0.0)
    assert still.u_mean_dn == pytest.approx(math.sqrt(1.0 / 12.0 / 100.0))
    frames = np.full((3, 2, 4), 50, np.uint16)
    frames[0, 0, 0] = frames[1, 0, :2] = 0
    frames[1, 1, 3] = 255
    frames[2, 1, :3] = (255, 255, 256)
    (found,) = statistics_of_group(iter(frames), FrameSettings(1.0), (None,), 255)
    assert (found.floor_share, found.clipped_share, found.frames, found.pixels) == (3 / 24, 4 / 24, 3, 8)
    several = [
        group(BLACK_DN, 40.0, dark=True, frames=n, frame_variance_dn2=v) for n, v in ((3, 9.0), (2, 36.0), (1, 1e6))
    ]
    assert pooled_frame_sd(several) == pytest.approx(math.sqrt(18.0))
    assert pooled_frame_sd(several[2:]) == 0.0


@pytest.mark.parametrize(("eta", "believed"), [(0.0, 0.5), (0.1, 0.001), (99.5, 0.995), (100.0, 1.0), (100.4, 0.5)])
def test_no_camera_is_described_to_give_more_electrons_than_photons(eta, believed):
    """A quantum efficiency up to 100 % is taken over; of more, or of none, the believed one stays."""
    found = Characterisation(
        believed=CAMERA.model_copy(update={"quantum_efficiency": 0.5}), gain_db=0.0,
        figures={"eta": Quantity(eta, 1.0, "%")}, gains={}, transfer=None, steps=(), dark_points=(), linearity=None,
        notes=(), provenance=Provenance("test"),
    )  # fmt: skip
    assert found.description().quantum_efficiency == pytest.approx(believed)


@pytest.mark.parametrize(("clipped", "by"), [((0.0, 0.0, 0.0), "full well"), ((0.0, 0.0, 0.9), "converter")])
def test_pixels_at_full_scale_say_that_the_converter_saturates(clipped, by):
    """Any of the steps from the largest variance on: the first of them are hardly at full scale yet."""
    variances = np.where(np.arange(16) <= 13, 40.0 + 0.5 * SIGNALS, 5.0)
    steps = steps_of(variances)
    ends = [replace(s, bright=replace(s.bright, clipped_share=c)) for s, c in zip(steps[13:], clipped, strict=True)]
    assert find_saturation([*steps[:13], *ends]).limited_by == by


@pytest.mark.parametrize(
    ("off", "part", "count", "named"),
    [([4], 0.5, 16, 1), ([2, 7, 12], 0.5, 16, 3), ([2, 5, 8, 12], 0.5, 16, 0), ([8], 0.89, 16, 1), ([8], 0.91, 16, 0),
     ([3], 0.5, 6, 1), ([2], 0.5, 5, 0)],
)  # fmt: skip
def test_up_to_a_fifth_of_six_or_more_steps_are_exceptions_from_a_tenth_on(off, part, count, named):
    """Of 16 steps three that show half of what their light says are named; of four no one knows which are right."""
    light, shown = 2.0 * SIGNALS[:count], SIGNALS[:count].copy()
    shown[off] *= part
    found = contradicting_steps(steps_of(100.0, shown, photons=light))
    assert [step.signal_dn for step, _ in found] == pytest.approx(shown[off[:named]])
    saturated, far = (10.0, 20.0, 30.0, 10.0, 50.0, 60.0, 9e3), (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 9e3)
    assert contradicting_steps(steps_of(100.0, saturated, photons=2.0 * np.array(far))) == []


@pytest.mark.parametrize(("temperatures_c", "own"), [((20.0, 26.0), 1), ((24.0, 31.0), 0)])
def test_light_is_compared_with_darkness_at_its_own_temperature(temperatures_c, own):
    """Of two plateaus the one nearest to the lit frames' 25 °C counts, colder or warmer: its black is the camera's."""
    darks = [
        group(BLACK_DN + shift, 40.0, dark=True, celsius=celsius, split=NO_SPLIT)
        for shift, celsius in zip((0.0, 8.0), temperatures_c, strict=True)
    ]
    found = characterise(subject(), [*lit_levels(celsius=25.0), *darks]).figures["mu_y_dark"]
    assert found.value == pytest.approx(BLACK_DN + (0.0, 8.0)[own])


@pytest.mark.parametrize(("warmer_k", "u_rel"), [(0.0, 0.02), (1.4, 0.048), (-1.0, 0.036), (None, 0.31)])
def test_responsivity_less_darkness_of_another_warmth(warmer_k, u_rel):
    """A dark current of a fifth of the light doubles with 7 K; what temperatures leave open of it is in u, once."""
    here_c, factor = (None, 1.0) if warmer_k is None else (25.0 + warmer_k, 2.0 ** (warmer_k / 7.0))
    times = np.geomspace(0.5, 8.0, 6)
    bright = [group(BLACK_DN + (100.0 * factor + 500.0) * t, 40.0 + 240.0 * t, t, celsius=here_c, photons=1000.0 * t)
              for t in times]  # fmt: skip
    dark = [group(BLACK_DN + 100.0 * t, 40.0 + 40.0 * t, t, dark=True, celsius=25.0) for t in times]
    steps = make_steps(bright, dark)
    R = responsivity(steps, find_saturation(steps), 0.0)
    assert R.value == pytest.approx(0.5, rel=1e-3)
    assert R.u == pytest.approx(0.1 * factor * u_rel, rel=0.1)


def changed(step, **more):
    return replace(step, bright=replace(step.bright, **more))


@pytest.mark.parametrize(
    ("more", "counts"),
    [
        ({"clipped_share": 1e-4}, True), ({"clipped_share": 1.1e-4}, False), ({"floor_share": 0.01}, True),
        ({"floor_share": 0.011}, False), ({"mean_dn": BLACK_DN + 4200.0}, True), ({"mean_dn": BLACK_DN}, False),
        ({"mean_dn": BLACK_DN + 4201.0}, False),
    ],
)  # fmt: skip
def test_which_steps_a_photon_transfer_takes(more, counts):
    """Up to a ten-thousandth at full scale, a hundredth at 0, above darkness, and to 70 % of 6000 DN, each included."""
    steps = steps_of(40.0 + 0.5 * SIGNALS)
    steps[5] = changed(steps[5], **more)
    assert (steps[5] in photon_transfer(steps, 6000.0).used) is counts


@pytest.mark.parametrize(("dark", "rounded"), [(0.2399, True), (0.24, False)])
def test_rounding_hides_the_dark_below_a_quarter_and_the_light_below_a_half(dark, rounded):
    """Then half a DN² in the light is the least that counts, and belongs to it."""
    signals = np.linspace(20.0, 1010.0, 10)
    steps = steps_of(0.24 + 0.01 * signals, signals, dark)
    found = photon_transfer([changed(steps[0], variance_dn2=0.5), *steps[1:]], 5000.0)
    assert found.rounded is rounded
    less = photon_transfer([changed(steps[0], variance_dn2=0.4999), *steps[1:]], 5000.0)
    assert len(found.used) - len(less.used) == int(rounded)


def test_a_photon_transfer_takes_three_steps_and_shows_its_bend():
    """Two are refused; 0.5 DN in the lowest third, 0.4 in the highest."""
    steps = steps_of(40.0 + 0.5 * SIGNALS[:3], SIGNALS[:3])
    assert photon_transfer(steps, 1e5).K.value == pytest.approx(0.5)
    with pytest.raises(MeasurementError, match="only 2 of 2 bright steps"):
        photon_transfer(steps[:2], 1e5)
    with pytest.raises(MeasurementError, match="the variance does not rise"):
        photon_transfer(steps_of(np.full(16, 40.0)), 1e5)
    ratios = np.repeat([0.5, 0.45, 0.4], 2)
    steps = steps_of(40.0 + ratios * SIGNALS[:6], SIGNALS[:6])
    transfer = photon_transfer(steps, 1e5)
    assert "goes from 0.5 to 0.4 DN" in bent(replace(transfer, used=tuple(steps[::-1])))


def test_a_bent_photon_transfer_is_reported_with_and_without_darks():
    """K from 0.5 to 0.4 DN: the note stands in the result, and a straight one has none; u holds the range."""
    bright = lit_groups(40.0 + (0.52 - 0.1 * SIGNALS / 6000.0) * SIGNALS)
    even = lit_groups(40.0 + 0.5 * SIGNALS)
    darks = [group(BLACK_DN, 40.0, s / 6000.0, dark=True) for s in SIGNALS]
    for some, neighbour in ((bright, darks), (bright, []), (even, darks), (even, [])):
        found, straight = characterise(subject(), [*some, *neighbour]), some is even
        reported = [note for note in found.notes if note.startswith("the photon transfer bends")]
        assert len(reported) == (0 if straight else 1)
        assert (found.transfer.bend_u > 0.0) is not straight
        assert found.figures["K"].u >= found.transfer.bend_u
        assert [step.light for step in found.steps] == pytest.approx(SIGNALS / 6000.0)  # exposures, for want of photons


@pytest.mark.parametrize(("off", "reported"), [(1.0, 0), (30.0, 1)])
def test_scatter_beyond_noise_is_reported_with_and_without_darks(off, reported):
    """Variances that jump by many times what their pixels allow: light that is unsteady."""
    rng = np.random.default_rng(2)
    variances = 40.0 + 0.5 * SIGNALS
    variances = variances * (1.0 + off * math.sqrt(2.0 / 90_000) * rng.choice([-1.0, 1.0], SIGNALS.size))
    bright = lit_groups(variances)
    darks = [group(BLACK_DN, 40.0, s / 6000.0, dark=True) for s in SIGNALS]
    for groups in ([*bright, *darks], bright):
        notes = characterise(subject(), groups).notes
        assert sum("times more than noise alone" in note for note in notes) == reported


def test_a_gain_of_one_level_is_variance_over_mean():
    """(540 − 40)/1000; levels that differ widen it, clipped and dark ones do not count, and less than none is none."""
    one = steps_of([540.0], [1000.0])
    found = transfer_of_few(one)
    assert found.value == pytest.approx(0.5)
    assert found.u >= 0.02 * found.value
    two = steps_of([540.0, 440.0], [1000.0, 1000.0])
    both = transfer_of_few(two)
    assert both.value == pytest.approx(0.45, rel=0.01)
    assert both.u == pytest.approx(math.hypot(0.05, 0.02 * both.value), rel=0.01)
    assert transfer_of_few([*one, changed(two[1], clipped_share=1.1e-4)]).value == found.value
    assert transfer_of_few([*one, changed(two[1], clipped_share=1e-4)]).value == pytest.approx(both.value)
    assert transfer_of_few([*one, changed(two[1], mean_dn=BLACK_DN)]).value == found.value
    assert transfer_of_few([*one, changed(two[1], frames=1)]).value == found.value
    assert transfer_of_few(steps_of([30.0], [1000.0])) is None
    assert transfer_of_few([changed(one[0], mean_dn=BLACK_DN - 1.0)]) is None


@pytest.mark.parametrize(("share", "plateau"), [(0.05, True), (0.0501, False)])
def test_a_plateau_is_where_the_variance_has_fallen_to_a_twentieth(share, plateau):
    """Of the largest; then the mean there is that of saturated pixels."""
    variances = 40.0 + 0.5 * SIGNALS
    variances[-1] = share * variances[-2]
    found = find_saturation(steps_of(variances)).plateau_dn
    assert (found is not None) is plateau
    assert found is None or found.value == BLACK_DN + SIGNALS[-1]


@pytest.mark.parametrize(("share", "reached"), [(1e-4, False), (1.1e-4, True)])
def test_a_variance_that_still_rises_is_no_saturation_unless_pixels_clip(share, reached):
    """At the last step a ten-thousandth of clipped pixels is not yet full scale."""
    steps = steps_of(40.0 + 0.5 * SIGNALS)
    found = find_saturation([*steps[:-1], changed(steps[-1], clipped_share=share)])
    assert (found.reached, found.limited_by == "converter") == (reached, reached)


@pytest.mark.parametrize(("below_u", "gaps"), [(3.9, 2), (4.1, 1)])
def test_the_place_of_the_largest_variance_is_known_to_the_steps_next_to_what_it_may_be(below_u, gaps):
    """Four uncertainties apart, twice either's, two variances may be the largest alike; the step beyond then bounds."""
    variances = 40.0 + 0.5 * SIGNALS
    u_rel = math.sqrt(2.0 / 89_999.0)
    variances[-4:] = variances[-5] * np.array([1.5, 1.5 * (1.0 - below_u * u_rel), 1.0, 0.9])
    found = find_saturation(steps_of(variances))
    apart = SIGNALS[1] - SIGNALS[0]
    assert found.light == 2.0 * SIGNALS[-4]
    assert found.u_light_rel == pytest.approx(gaps * apart / math.sqrt(3.0) / SIGNALS[-4])


def test_uncertainties_propagate_as_of_a_straight_function():
    """2a − 3b: 4·u_a² + 9·u_b²; 2 DN/s at 0.5 ± 0.05 DN/e⁻ are 4 ± 0.4 e⁻/s."""
    a, b = Quantity(5.0, 0.3, "x"), Quantity(1.0, 0.4, "x")
    found = propagated(lambda p, q: 2.0 * p - 3.0 * q, "y", a, b)
    assert (found.value, found.u, found.unit) == (pytest.approx(7.0), pytest.approx(math.hypot(0.6, 1.2)), "y")
    assert propagated(lambda p, q: 2.0 * p, "y", a, b).u == pytest.approx(0.6)
    found = typical_dark_current(dark_plateau([20.0] * 4), 20.0, Quantity(0.5, 0.05, "DN/e-"))["mu_I_typical"]
    assert found.value == pytest.approx(4.0)
    assert found.u == pytest.approx(0.4, rel=1e-3)


@pytest.mark.parametrize("doubling_k", [5.0, 8.0])
def test_a_dark_current_that_doubles_shows_by_how_many_kelvin(doubling_k):
    """2^(T/T_d) at any level; u goes as that of ln D over the span, and falling or unseen currents tell nothing."""
    slow, fast = (Quantity(3.0 * 2.0 ** (t / doubling_k), 0.03 * 2.0 ** (t / doubling_k), "DN/s") for t in (10.0, 30.0))
    found = doubling_temperature([(10.0, 0.0, slow), (30.0, 0.0, fast)])
    assert (found.value, found.unit) == (pytest.approx(doubling_k), "K")
    u_slope = 0.01 * math.sqrt(2.0) / 20.0
    assert found.u / found.value == pytest.approx(u_slope / (math.log(2.0) / doubling_k))
    warm = doubling_temperature([(10.0, 0.5, slow), (30.0, 0.5, fast)])
    u_slope = math.hypot(u_slope, math.log(2.0) / doubling_k * 0.5 * math.sqrt(2.0) / 20.0)
    assert warm.u / warm.value == pytest.approx(u_slope / (math.log(2.0) / doubling_k))
    assert doubling_temperature([(10.0, 0.0, slow)]) is None
    assert doubling_temperature([(10.0, 0.0, fast), (30.0, 0.0, slow)]) is None
    for u_rel, text in ((0.501, False), (0.499, True)):
        faint = (20.0, 0.0, Quantity(1.0, u_rel, "DN/s"))
        assert (doubling_temperature([faint, (40.0, 0.0, Quantity(9.0, 0.1, "DN/s"))]) is not None) is text
    assert doubling_temperature([(None, 0.0, slow), (30.0, 0.0, fast)]) is None


def test_dark_currents_are_those_of_long_exposures_and_transfers_of_five():
    """2 DN/s at the mean reading by time; four frames give no K."""
    plateau = [
        group(BLACK_DN + 2.0 * t, 40.0, t, dark=True, celsius=c, typical_dn=BLACK_DN + 2.0 * t - 1.0)
        for t, c in ((1.0, 20.0), (3.0, 21.0))
    ]
    ((celsius, u_k, rate),) = typical_rates(plateau)
    assert (rate.value, celsius, u_k) == pytest.approx((2.0, 20.75, 1.0 / math.sqrt(12.0)))
    assert typical_rates(plateau[:1]) == []
    ((_, least_k, _),) = typical_rates([replace(d, settings=replace(d.settings, temperature_c=20.0)) for d in plateau])
    assert least_k == pytest.approx(0.05 / math.sqrt(12.0))
    ((unknown, _, _),) = typical_rates([plateau[0], replace(plateau[1], settings=FrameSettings(3.0, shutter="closed"))])
    assert unknown is None
    rng = np.random.default_rng(8)
    rates = rng.uniform(0.5, 1.5, 40_000)
    darks = [100.0 + 0.5 * rng.poisson(rates * t + 20.0) for t in (0.0, 100.0, 200.0, 300.0, 400.0)]
    found = dark_transfer(darks)
    assert found.K.value == pytest.approx(0.5, abs=4.0 * found.K.u)
    assert found.K.u < 0.05 * found.K.value
    assert dark_transfer(darks[:4]) is None
    assert dark_transfer([darks[0]] * 6) is None


@pytest.mark.parametrize(("span_dn", "count", "asked"), [(1.99, 3, False), (2.0, 3, True), (50.0, 2, False)])
def test_a_gain_from_darks_needs_two_dn_of_dark_signal_at_three_exposures(span_dn, count, asked):
    """Less shows no shot noise; then the frames are not even read."""
    seen = []

    def read(file):
        seen.append(file)
        return np.full((4, 4), 100, np.uint16)

    darks = [group(BLACK_DN + span_dn * k / (count - 1), 40.0, 1.0 + k, dark=True) for k in range(count)]
    groups = tuple(FrameGroup(one.settings, (Path("d"),), None, read) for one in darks)
    assert gain_from_darks(replace(subject(), groups=groups), darks) is None
    assert len(seen) == (count if asked else 0)


def test_plateaus_of_darks_that_disagree_widen_their_mean(monkeypatch):
    """0.5 and 0.6 ± 0.01 DN/e⁻: 0.55 with their scatter of 0.05 next to the better u; one alone keeps its own."""
    module = "radiometer.analysis.characterise.dark_signal"
    gains = []
    monkeypatch.setattr(f"{module}.dark_transfer", lambda _: type("T", (), {"K": gains.pop(0)})())
    plateaus = [
        [group(BLACK_DN + 5.0 * t, 40.0, t, dark=True, celsius=c) for t in (1.0, 2.0, 3.0)] for c in (20.0, 40.0)
    ]
    gains[:] = [Quantity(0.5, 0.01, "DN/e-"), Quantity(0.6, 0.01, "DN/e-")]
    both, transfers = gain_from_darks(subject(), [*plateaus[0], *plateaus[1]])
    assert (both.value, both.u, len(transfers)) == (pytest.approx(0.55), pytest.approx(math.hypot(0.01, 0.05)), 2)
    gains[:] = [Quantity(0.5, 0.01, "DN/e-")]
    assert gain_from_darks(subject(), plateaus[0])[0].u == pytest.approx(0.01)


def test_a_typical_pixel_is_no_hot_one():
    """Within four robust deviations of the median, two DN at least, a pixel counts, beyond it does not."""

    def typical_mean(average):
        return average[typical_pixels(average)].mean()

    even = np.full(99, 100.0)
    assert typical_mean(np.append(even, 102.0)) == pytest.approx(100.02)
    assert typical_mean(np.append(even, 102.1)) == 100.0
    spread = np.linspace(90.0, 110.0, 101)
    reach = 4.0 * 1.4826 * 5.0
    assert typical_mean(np.append(spread, 100.0 + 1.06 * reach)) == pytest.approx(100.0)
    assert typical_mean(np.append(spread, 100.0 + 0.98 * reach)) == pytest.approx(100.0 + 0.98 * reach / 102.0)


@pytest.mark.parametrize(
    ("stated", "gain_db", "reported"),
    [(2.0, 0.0, 0), (2.059, 0.0, 0), (2.061, 0.0, 1), (1.939, 0.0, 1), (2.0, 20.0, 1), (20.0, 20.0, 0)],
)
def test_a_stated_gain_is_doubted_from_three_times_what_is_known_on(stated, gain_db, reported):
    """K of 0.5 ± 0.005 DN/e⁻ is 2 ± 0.02 e⁻/DN; at 20 dB ten times as many at 0 dB."""
    notes = stated_gain_doubt(stated, Quantity(0.5, 0.005, "DN/e-"), gain_db)
    assert len(notes) == reported


def test_a_dark_group_that_contradicts_those_of_its_gain_is_left_out_and_named():
    """One of eight at 0 dB shows 200 DN too much; those at 20 dB, three times as dark, are no judges of it."""
    bright = lit_groups(40.0 + 0.5 * SIGNALS)
    darks = [group(BLACK_DN, 40.0, 1.0 + k, dark=True) for k in range(8)]
    darks[3] = replace(darks[3], mean_dn=BLACK_DN + 200.0)
    loud = [group(3.0 * BLACK_DN, 400.0, 1.0 + k, dark=True, gain_db=20.0) for k in range(8)]
    for neighbour in ([], loud):
        found = characterise(subject(), [*bright, *darks, *neighbour])
        (named,) = [note for note in found.notes if note.startswith("left out")]
        assert "dark group of 2 frames at 4 s" in named
        assert len(found.dark_points) == 7
        assert found.figures["mu_y_dark"].value == pytest.approx(BLACK_DN)


# What real sensors need of a characterisation, held against numbers drawn here by other formulas.


K_DN_PER_E = 0.5
SENSOR_BLACK_DN = 1000.0


def group_of_sensor(mean, variance, exposure_s=1.0, *, dark=False, photons=None, frames=2, pixels=90_000):
    """Return statistics without pictures."""
    settings = FrameSettings(exposure_s, shutter="closed" if dark else "open")
    return GroupStatistics(settings, frames, pixels, mean, variance, 0.0, 0.0, photons)


def ladder(gain=lambda signal: K_DN_PER_E, signals=SIGNALS):
    """Return bright steps whose variance is the signal times a gain that may change with the signal."""
    bright = [group_of_sensor(SENSOR_BLACK_DN + s, 40.0 + gain(s) * s, photons=2.0 * s) for s in signals]
    return make_steps(bright, [group_of_sensor(SENSOR_BLACK_DN, 40.0, dark=True)])


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
    full = [replace(s.bright, mean_dn=min(s.bright.mean_dn, SENSOR_BLACK_DN + 4000.0)) for s in steps]
    assert contradicting_steps(make_steps(full, [group_of_sensor(SENSOR_BLACK_DN, 40.0, dark=True)])) == []


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
    (tmp_path / "t.csv").write_text("exposure_ms,mean_dn,var,spatial_var,floor_share\n10,64,9,4,0.2\n")
    (stated,) = read_subject(tmp_path / "t.csv").given
    assert (stated.variance_dn2, stated.spatial_variance_dn2, stated.floor_share) == (9.0, 4.0, 0.2)


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

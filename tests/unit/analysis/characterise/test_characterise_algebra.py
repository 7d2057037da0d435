"""EMVA 1288 figures from statistics worked out by hand: each factor, each term of u, each limit of a range."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from radiometer.analysis.characterise import characterise, report
from radiometer.analysis.characterise.dark_signal import dark_signal, typical_dark_current
from radiometer.analysis.characterise.group_statistics import (
    GroupStatistics,
    NoiseLeft,
    SpatialSplit,
    split_spatial_variance,
    statistics_of_group,
)
from radiometer.analysis.characterise.linearity import linearity
from radiometer.analysis.characterise.nonuniformity import dsnu, prnu
from radiometer.analysis.characterise.partial import bent, disagreeing_gains
from radiometer.analysis.characterise.photon_transfer import photon_transfer
from radiometer.analysis.characterise.report import outcome
from radiometer.analysis.characterise.result import Characterisation
from radiometer.analysis.characterise.sensitivity import find_saturation, responsivity, sensitivity_figures, sigma_d
from radiometer.analysis.characterise.steps import contradicting_darks, contradicting_steps, make_steps
from radiometer.analysis.characterise.subject import PhotonFlux, Subject, photon_flux
from radiometer.data import (
    CameraDescription,
    FrameSettings,
    LensDescription,
    PatchDescription,
    Provenance,
    Quantity,
    SourceDescription,
)

BLACK_DN = 100.0
SIGNALS = np.linspace(200.0, 6000.0, 16)


def group(mean, variance, exposure_s=1.0, *, dark=False, level=1.0, photons=None, pixels=90_000, **more):
    """Return the statistics of a pair of frames, without pictures."""
    settings = FrameSettings(exposure_s, source_level=level, shutter="closed" if dark else "open")
    return GroupStatistics(settings, 2, pixels, mean, variance, 0.0, 0.0, photons, **more)


def steps_of(signals, variances, dark_variance=40.0, pixels=90_000):
    """Return steps of given signals and variances whose light is twice the signal, in photons."""
    bright = [group(BLACK_DN + s, v, photons=2.0 * s, pixels=pixels) for s, v in zip(signals, variances, strict=True)]
    return make_steps(bright, [group(BLACK_DN, dark_variance, dark=True, pixels=pixels)])


def test_the_photon_transfer_ends_at_seventy_percent_of_saturation():
    """Steps above, whose variance has begun to fall, change nothing."""
    variances = np.where(SIGNALS <= 4200.0, 40.0 + 0.5 * SIGNALS, 20.0 + 0.25 * SIGNALS)
    found = photon_transfer(steps_of(SIGNALS, variances), 6000.0)
    assert found.K.value == pytest.approx(0.5, rel=1e-9)
    assert max(s.signal_dn for s in found.used) == SIGNALS[SIGNALS <= 4200.0].max()


def test_the_stated_uncertainty_of_the_gain_is_its_scatter():
    """Over 400 draws of variances with the chance that so few pixels leave, K scatters by its mean u within 15 %."""
    rng, pixels = np.random.default_rng(4), 200
    values, stated = [], []
    for _ in range(400):
        chance = rng.chisquare(pixels - 1, SIGNALS.size + 1) / (pixels - 1)
        found = photon_transfer(
            steps_of(SIGNALS, (40.0 + 0.5 * SIGNALS) * chance[1:], 40.0 * chance[0], pixels), 10_000.0
        )
        values.append(found.K.value)
        stated.append(found.line.u_slope / max(found.line.birge_ratio, 1.0))
    assert np.std(values) == pytest.approx(np.mean(stated), rel=0.15)


@pytest.mark.parametrize("step_dn", [1, 8])
def test_noise_that_rounding_hides_is_a_bound_as_wide_as_itself(step_dn):
    """Frames that do not differ say that σ² is at most 0.24 steps² (EMVA 1288, 6.7), not that it is known to 1e-9."""
    found = dark_signal([group(100.0, 0.0, dark=True)], step_dn)
    assert found.quantisation_limited
    assert found.variance_dn2.value == pytest.approx(0.24 * step_dn**2)
    assert found.variance_dn2.u == pytest.approx(0.24 * step_dn**2 / np.sqrt(3.0))
    figures = sensitivity_figures(Quantity(0.5, 0.0, "DN/e-"), found.variance_dn2, None, None, step_dn, is_bound=True)
    most = np.sqrt(0.24 - 1.0 / 12.0) * step_dn / 0.5
    assert figures["sigma_d"].value == pytest.approx(most / 2.0)
    assert figures["sigma_d"].u == pytest.approx(most / np.sqrt(12.0))
    assert figures["sigma_y_dark"].u > 0.25 * figures["sigma_y_dark"].value


def test_darks_alone_say_that_rounding_hides_their_noise():
    """Also where there is no light: the figure stands with a u of its own size and a note."""
    result = characterise(subject(), [group(100.0, 0.05, t, dark=True) for t in (1.0, 2.0)])
    assert result.figures["sigma_y_dark"].value == pytest.approx(np.sqrt(0.24))
    assert result.figures["sigma_y_dark"].u > 0.1
    assert any("below 0.24 DN²" in note for note in result.notes)


def test_light_is_exposure_times_level_or_the_photons():
    """Half the level at twice the exposure is the same light; photons go before both."""
    dark = [group(BLACK_DN, 40.0, t, dark=True) for t in (1.0, 2.0)]
    bright = [group(500.0, 240.0, 2.0, level=0.25), group(500.0, 240.0, 1.0, level=1.0)]
    assert [s.light for s in make_steps(bright, dark)] == [0.5, 1.0]
    assert make_steps([group(500.0, 240.0, 2.0, level=0.25, photons=7e3)], dark)[0].light == 7e3


def test_darkness_at_another_exposure_is_as_uncertain_as_its_line():
    """From 1, 2 and 3 s to 12 s: u is that of the mean and of ten times the slope."""
    dark = [group(BLACK_DN + 5.0 * t, 40.0, t, dark=True) for t in (1.0, 2.0, 3.0)]
    (step,) = make_steps([group(900.0, 240.0, 12.0)], dark)
    u_mean = math.sqrt(40.0 / (2 * 90_000))
    assert step.dark_mean_dn == pytest.approx(BLACK_DN + 60.0)
    assert step.u_dark_mean_dn == pytest.approx(u_mean * math.sqrt(1 / 3 + 10.0**2 / 2))


def frames(count, offsets, noise, shape=(60, 70), seed=3):
    """Return frames of even light with offsets of their own and pixel noise."""
    rng = np.random.default_rng(seed)
    return [np.rint(1000.0 + offsets[n] + rng.normal(0.0, noise, shape)).astype(np.uint16) for n in range(count)]


def test_light_that_differs_from_frame_to_frame_is_no_noise():
    """σ_y² is 36 + 1/12 DN² whatever the frames' means do; and no pattern is left in the average of eight."""
    (steady,) = statistics_of_group(frames(8, [0.0] * 8, 6.0), FrameSettings(1.0), (None,), 4095)
    (unsteady,) = statistics_of_group(
        frames(8, [0, 30, -20, 10, 5, -40, 25, 0], 6.0), FrameSettings(1.0), (None,), 4095
    )
    for one in (steady, unsteady):
        assert one.variance_dn2 == pytest.approx(36.0 + 1 / 12, abs=4 * one.u_variance_dn2)
        assert one.spatial_variance_dn2 == pytest.approx(0.0, abs=4 * one.u_spatial_variance_dn2)
        assert one.u_spatial_variance_dn2 < 0.3
    assert steady.degrees_of_freedom == 7 * (60 * 70 - 1)
    assert steady.u_variance_dn2 == pytest.approx(steady.variance_dn2 * math.sqrt(2.0 / (7 * 4199)))


def test_what_pixels_leave_in_few_rows_is_no_row_pattern():
    """Pictures of 4 × 50 independent pixels: over 600 of them rows and columns come out as zero, pixels as one."""
    rng = np.random.default_rng(6)
    none = NoiseLeft(0.0, 0.0, 0.0)
    found = [split_spatial_variance(rng.standard_normal((4, 50)), none) for _ in range(600)]
    assert np.mean([f.row_dn2 for f in found]) == pytest.approx(0.0, abs=0.004)
    assert np.mean([f.column_dn2 for f in found]) == pytest.approx(0.0, abs=0.01)
    assert np.mean([f.pixel_dn2 for f in found]) == pytest.approx(1.0, abs=0.02)


def test_patterns_of_darkness_and_light():
    """DSNU √9/K = 6 e⁻; PRNU √(25 − 9)/400 = 1 %; both with the u of K and of their variances."""
    dark = replace(group(BLACK_DN, 0.0, dark=True), spatial_variance_dn2=9.0)
    bright = replace(group(BLACK_DN + 400.0, 0.0), spatial_variance_dn2=25.0)
    K = Quantity(0.5, 0.05, "DN/e-")
    found = dsnu(dark, K)
    assert found.value == pytest.approx(6.0)
    assert found.u == pytest.approx(0.6, rel=1e-3)
    assert prnu(bright, dark).value == pytest.approx(1.0)


def test_figures_that_follow_from_gain_darkness_and_saturation():
    """K 0.5, σ_y² 4 + 1/12, 5000 DN, η 50 %: threshold, capacity, SNR and dynamic range by the standard's formulae."""
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


def test_the_responsivity_is_known_no_better_than_the_photons():
    """Half a DN per photon; 3 % of the photons go into it."""
    steps = steps_of(SIGNALS, 40.0 + 0.5 * SIGNALS)
    found = responsivity(steps, find_saturation(steps), 0.03)
    assert found.value == pytest.approx(0.5, rel=1e-9)
    assert found.u_rel == pytest.approx(0.03, rel=1e-3)


def test_saturation_is_where_the_variance_is_largest():
    """The twelfth of 16 steps: its signal and light; u holds the rectangle to its neighbours; beyond is the plateau."""
    variances = np.where(np.arange(16) <= 11, 40.0 + 0.5 * SIGNALS, 5.0)
    steps = steps_of(SIGNALS, variances)
    found = find_saturation(steps)
    assert (found.signal_dn, found.light) == pytest.approx((SIGNALS[11], 2.0 * SIGNALS[11]))
    spacing = float(SIGNALS[1] - SIGNALS[0])
    assert found.u_light_rel == pytest.approx(spacing / math.sqrt(3) / SIGNALS[11], rel=1e-6)
    assert found.linear_signal_dn == pytest.approx(SIGNALS[11])
    assert found.u_linear_signal_dn == pytest.approx(spacing / math.sqrt(3), rel=0.01)
    assert found.reached
    assert found.plateau_dn is not None
    assert found.plateau_dn.value == pytest.approx(BLACK_DN + SIGNALS[15])
    rising = find_saturation(steps_of(SIGNALS, 40.0 + 0.5 * SIGNALS))
    assert not rising.reached
    assert rising.plateau_dn is None


def test_linearity_errors_are_relative_and_have_a_sign():
    """A dim step 5 % too low is the negative error; the line minimises the squares of the relative deviations."""
    signals = SIGNALS[1:].copy()
    light = 2.0 * signals
    signals[0] *= 0.95
    bright = [group(BLACK_DN + s, 100.0, photons=p) for s, p in zip(signals, light, strict=True)]
    steps = make_steps(bright, [group(BLACK_DN, 40.0, dark=True)])
    found = linearity(steps, 6500.0)
    design = np.column_stack([light, np.ones_like(light)]) / signals[:, None]
    a, b = np.linalg.lstsq(design, np.ones_like(light), rcond=None)[0]
    expected = 100.0 * (signals - a * light - b) / (a * light + b)
    assert found is not None
    assert (found.LE_min.value, found.LE_max.value) == pytest.approx((expected.min(), expected.max()))
    assert found.LE_min.value == pytest.approx(expected[0])
    assert found.LE_min.value < -1.0
    own = 100.0 * np.array([step.u_signal_dn for step in steps]) / (a * light + b)  # in %, as the deviations are
    assert [u for _, _, u in found.deviations] == pytest.approx(own)
    assert found.LE_max.u == found.LE_min.u == pytest.approx(own.max() * math.sqrt(2.0 * math.log(light.size)))


@pytest.mark.parametrize(("saturation_dn", "used"), [(4000.0, 5), (4001.0, 4), (3999.0, 4)])
def test_linearity_is_of_five_to_ninety_five_percent_of_saturation(saturation_dn, used):
    """Signals at the ends of that range belong to it; dimmer and brighter ones may lie where they like."""
    signals = np.array([150.0, 199.0, 200.0, 1000.0, 2000.0, 3000.0, 3800.0, 3801.0, 5000.0])
    light = np.array([5.0, 7e3, 400.0, 2000.0, 4000.0, 6000.0, 7600.0, 90.0, 9000.0])
    bright = [group(BLACK_DN + s, 100.0, photons=p) for s, p in zip(signals, light, strict=True)]
    inner = light[(signals >= 0.05 * saturation_dn) & (signals <= 0.95 * saturation_dn)]
    found = linearity(make_steps(bright, [group(BLACK_DN, 40.0, dark=True)]), saturation_dn)
    assert found is not None
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
        found = photon_flux(patch, "default", camera, lens, source, None, (101, 101))
        assert found is not None
        return found

    middle, corner = of(0), of(100)
    energy = 6.62607015e-34 * 299_792_458.0 / 555e-9
    assert middle.per_s == pytest.approx(0.5 * math.pi / (4 * 4.0**2) * 1e-10 / energy, rel=1e-3)
    assert corner.per_s / middle.per_s == pytest.approx(0.25, rel=0.02)  # 45°
    columns = [of(x).per_s for x in range(101)]
    assert of(0, 101).per_s == pytest.approx(np.mean(columns), rel=1e-9)  # a patch has the mean of its pixels
    assert middle.u_rel == pytest.approx(math.sqrt(0.03**2 + 0.02**2 + 0.01**2))


def dark_plateau(temperatures_c, rate=2.0):
    """Return dark groups at 1, 2, 4 … s whose thermometer read what is given."""
    return [
        replace(
            group(BLACK_DN + rate * 2.0**n, 40.0, 2.0**n, dark=True),
            settings=FrameSettings(2.0**n, temperature_c=t, shutter="closed"),
        )
        for n, t in enumerate(temperatures_c)
    ]


def test_the_dark_current_in_electrons_bears_the_doubt_of_the_gain():
    """2 DN/s at 0.5 DN/e⁻ are 4 e⁻/s, to 10 % where K is known to 10 %."""
    found = typical_dark_current(dark_plateau([20.0] * 4), 20.0, Quantity(0.5, 0.05, "DN/e-"))["mu_I_typical"]
    assert found.value == pytest.approx(4.0)
    assert found.u == pytest.approx(0.4, rel=1e-3)


@pytest.mark.parametrize(
    ("slope", "wrong_dn", "named"), [(50.0, 0.0, 0), (50.0, 120.0, 1), (50.0, -120.0, 1), (0.0, 120.0, 1)]
)
def test_a_dark_group_off_the_line_of_the_others_is_named(slope, wrong_dn, named):
    """On a dark current of 50 DN/s none is; one that is 120 DN off it is reported with what the others say there."""
    times = np.array([0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    means = BLACK_DN + slope * times
    means[3] += wrong_dn
    darks = [group(mean, 40.0, time, dark=True) for mean, time in zip(means, times, strict=True)]
    found = contradicting_darks(darks, 3000.0)
    assert [one.settings.exposure_s for one, _ in found] == [3.0] * named
    for _, text in found:
        straight = BLACK_DN + 3.0 * slope
        assert f"{means[3]:.4g} DN where all others say {straight:.4g}" in text
        assert text.endswith(f"({round(100.0 * wrong_dn / straight):+d} %)")


LEVELS = np.geomspace(0.02, 1.0, 12)
CAMERA = CameraDescription(bit_depth=12)
NO_SPLIT = SpatialSplit(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def subject(**camera):
    """Return frames of which nothing is known but their statistics."""
    return Subject("made", CAMERA.model_copy(update=camera), LensDescription(), (), (None,), (None,))


def whole(*darks):
    """Return the figures of a camera of 0.5 DN per electron at one exposure and twelve levels, with dark groups."""
    bright = [group(BLACK_DN + 3000.0 * x, 40.0 + 1500.0 * x, level=float(x), split=NO_SPLIT) for x in LEVELS]
    return characterise(subject(), [*bright, *darks])


def test_patterns_of_darkness_are_those_at_the_exposure_of_the_light():
    """√9/0.5 = 6 e⁻ at 1 s; more frames at 10 s, whose leaking pixels make 14 e⁻, do not speak for it."""
    dark = replace(group(BLACK_DN, 40.0, dark=True, split=NO_SPLIT), spatial_variance_dn2=9.0)
    long = replace(group(BLACK_DN, 40.0, 10.0, dark=True, split=NO_SPLIT), spatial_variance_dn2=49.0, frames=8)
    for darks in ((dark, long), (long, dark)):
        assert whole(*darks).figures["DSNU_1288"].value == pytest.approx(6.0, rel=1e-6)


@pytest.mark.parametrize(("stated", "off"), [(2.0, None), (2.5, "+25.0 %"), (None, None)])
def test_one_level_of_light_shows_a_wrong_statement_of_the_gain(stated, off):
    """0.5 DN/e⁻ are 2 e⁻/DN: 2.5 are a quarter too many."""
    groups = [group(BLACK_DN + 1000.0, 540.0), group(BLACK_DN, 40.0, dark=True)]
    notes = characterise(subject(conversion_gain_e_per_dn=stated), groups).notes
    reported = [note for note in notes if note.startswith("conversion_gain_error")]
    assert [off in note for note in reported] == ([True] if off else [])


def test_darks_that_tell_no_gain_doubt_no_statement():
    """One pair at one exposure gives the dark noise; what is stated of the gain stands."""
    found = characterise(subject(conversion_gain_e_per_dn=2.5), [group(BLACK_DN, 40.0, dark=True)])
    assert found.figures["sigma_y_dark"].value == pytest.approx(math.sqrt(40.0))
    assert not any("conversion_gain_error" in note for note in found.notes)


def test_a_bend_is_shown_by_variance_over_mean_at_both_ends():
    """0.5 DN in the lowest third, 0.4 in the highest, however the steps are sorted."""
    ratios = np.repeat([0.5, 0.45, 0.4], 2)
    steps = steps_of(SIGNALS[:6], 40.0 + ratios * SIGNALS[:6])
    transfer = photon_transfer(steps, 1e5)
    assert "goes from 0.5 to 0.4 DN" in bent(replace(transfer, used=tuple(steps[::-1])))


@pytest.mark.parametrize(("full", "ends"), [(True, " of noise and holds 5000"), (False, " of noise.")])
def test_the_outcome_names_the_capacity_where_it_is_known(full, ends):
    """And says nothing of it where the light never reached saturation."""
    result = whole(group(BLACK_DN, 40.0, dark=True))
    figures = {name: q for name, q in result.figures.items() if name != "mu_e_sat"}
    if full:
        figures["mu_e_sat"] = Quantity(5000.0, 20.0, "e-")
    assert ends in outcome(replace(result, figures=figures)).replace("\u202f", "").replace("\u00a0", " ")


def test_on_a_phone_the_panels_stand_one_below_the_other(monkeypatch):
    """Three of one width, the photon transfer half as high again as the others; on a desk they stand side by side."""
    drawn = {}

    def kept(draw, *_):
        for narrow in (True, False):
            figure = drawn[narrow] = Figure()
            draw(figure, narrow)
        return ""

    monkeypatch.setattr(report, "picture", kept)
    report.story(whole(group(BLACK_DN, 40.0, dark=True)))
    places = [axes.get_position() for axes in drawn[True].axes]
    assert len(places) == 3
    assert len({(round(p.x0, 6), round(p.x1, 6)) for p in places}) == 1
    assert places[0].height == pytest.approx(1.5 * places[1].height)
    assert len({round(axes.get_position().x0, 6) for axes in drawn[False].axes}) == 2


def test_variances_of_few_lines_scatter_by_their_stated_uncertainty():
    """Of 4 rows, or 4 columns, of their own offsets: over 1500 pictures the scatter of s² is the mean of its u, to 8 %.

    Three degrees of freedom of a normal distribution: σ(s²) = s²·√(2/3), which 1500 draws tell to 3 %.
    """
    rng = np.random.default_rng(31)
    quiet = NoiseLeft(0.0, 0.0, 0.0)
    splits = [
        split_spatial_variance(
            3.0 * rng.standard_normal((4, 1)) + 0.1 * rng.standard_normal((4, 40)), quiet
        ) for _ in range(1500)
    ]  # fmt: skip
    for turned in (False, True):
        if turned:
            splits = [
                split_spatial_variance(
                    3.0 * rng.standard_normal((1, 4)) + 0.1 * rng.standard_normal((40, 4)), quiet
                ) for _ in range(1500)
            ]  # fmt: skip
        values = [one.column_dn2 if turned else one.row_dn2 for one in splits]
        reported = [one.u_column_dn2 if turned else one.u_row_dn2 for one in splits]
        assert np.mean(values) == pytest.approx(9.0, rel=0.08)
        assert np.mean(reported) == pytest.approx(np.std(values), rel=0.08)


@pytest.mark.parametrize(
    ("dark", "word"), [(0.4901, "agrees with"), (0.4899, "differs from"), (0.5101, "differs from")]
)
def test_two_gains_agree_within_twice_what_both_leave_open(dark, word):
    """0.003 and 0.004 DN/e⁻ make 0.005: a distance of 0.01 is the last that agrees, to either side."""
    (text,) = disagreeing_gains(Quantity(0.5, 0.003, "DN/e-"), Quantity(dark, 0.004, "DN/e-"))
    assert f"{word} that from light" in text
    assert "(2.0 u)" in text


@pytest.mark.parametrize("step_dn", [1, 4])
def test_noise_below_a_code_is_a_bound_that_grows_with_the_square_of_the_spacing(step_dn):
    """EMVA 1288 takes 0.24 DN² for the least that rounding leaves; in codes 4 DN apart that is 3.84 DN²."""
    quiet, loud = (dark_signal([group(BLACK_DN, v * step_dn**2, dark=True)], step_dn) for v in (0.23, 0.25))
    assert (quiet.variance_dn2.value, quiet.quantisation_limited) == (pytest.approx(0.24 * step_dn**2), True)
    assert (loud.variance_dn2.value, loud.quantisation_limited) == (pytest.approx(0.25 * step_dn**2), False)


def test_darkness_begins_at_the_shortest_exposure_where_two_make_no_line():
    """Of 1 and 2 s the figures are those of 1 s, whatever the order; of three exposures those of the line at 0 s."""
    one, two = group(101.0, 40.0, 1.0, dark=True), group(102.0, 42.0, 2.0, dark=True)
    for darks in ([one, two], [two, one]):
        found = dark_signal(darks)
        assert (found.mean_dn.value, found.variance_dn2.value) == (101.0, 40.0)
        assert found.mean_line is None
    found = dark_signal([two, group(103.0, 44.0, 3.0, dark=True), one])
    assert (found.mean_dn.value, found.variance_dn2.value) == pytest.approx((100.0, 38.0))
    assert found.mean_line is not None
    assert found.mean_line.slope == pytest.approx(1.0)


def test_degrees_of_freedom_are_those_of_frames_and_pixels():
    """(L − 1)·(N − 1), one at least; a variance is known to √(2/ν) of itself, a mean to σ/√(L·N), rounding included."""
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


def test_a_line_through_one_light_shows_no_linearity():
    """Two lights and four steps between 5 and 95 % are the fewest."""
    dark = group(BLACK_DN, 40.0, dark=True)

    def found(*lights: float):
        bright = [group(BLACK_DN + 1000.0 * (1 + k), 100.0, photons=p) for k, p in enumerate(lights)]
        return linearity(make_steps(bright, [dark]), 6000.0)

    assert found(2000.0, 2000.0, 2000.0, 2000.0) is None
    assert found(2000.0, 4000.0, 6000.0) is None
    assert found(2000.0, 2000.0, 4000.0, 4000.0) is not None


def test_codes_that_follow_one_another_round_by_a_twelfth():
    """4 DN² and the rounding to whole codes are 2 DN, 4 e⁻ at 0.5 DN/e⁻; steps of four codes round by 16/12."""
    assert sigma_d(4.0 + 1.0 / 12.0, 0.5) == pytest.approx(4.0)
    assert sigma_d(4.0 + 16.0 / 12.0, 0.5, 4) == pytest.approx(4.0)


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
    steps = steps_of(SIGNALS, variances)
    ends = [replace(s, bright=replace(s.bright, clipped_share=c)) for s, c in zip(steps[13:], clipped, strict=True)]
    assert find_saturation([*steps[:13], *ends]).limited_by == by


@pytest.mark.parametrize(("off", "named"), [((4,), 1), ((2, 7, 12), 3), ((2, 5, 8, 12), 0)])
def test_up_to_a_fifth_of_the_steps_are_exceptions(off, named):
    """Of 16 steps three that show half of what their light says are named; of four no one knows which are right."""
    shown = SIGNALS.copy()
    shown[list(off)] *= 0.5
    bright = [group(BLACK_DN + s, 100.0, photons=2.0 * light) for s, light in zip(shown, SIGNALS, strict=True)]
    found = contradicting_steps(make_steps(bright, [group(BLACK_DN, 40.0, dark=True)]))
    assert [step.signal_dn for step, _ in found] == pytest.approx([shown[k] for k in off[:named]])


@pytest.mark.parametrize(("off", "named"), [((4,), 1), ((2, 7), 2), ((2, 5, 7), 0)])
def test_up_to_a_fifth_of_the_dark_groups_are_exceptions(off, named):
    """Of ten groups on a line over exposure two that are 200 DN off it are named; of three none is."""
    times = np.arange(1.0, 11.0)
    means = BLACK_DN + 20.0 * times
    means[list(off)] += 200.0
    darks = [group(mean, 40.0, time, dark=True) for mean, time in zip(means, times, strict=True)]
    assert [one.settings.exposure_s for one, _ in contradicting_darks(darks, 3000.0)] == [times[k] for k in off[:named]]


def test_the_noise_that_an_average_keeps_is_parted_into_rows_columns_and_the_rest():
    """9 DN² of a pixel, 2 of a row's mean and 1 of a column's, over 4 × 5 pixels and two frames: 6/0.6 are left."""
    left = NoiseLeft.of(9.0, 2.0, 1.0, 2, (4, 5))
    assert (left.row_means_dn2, left.column_means_dn2) == (1.0, 0.5)
    assert left.rest_dn2 == pytest.approx(6.0 / ((1 - 1 / 4) * (1 - 1 / 5)) / 2)
    assert NoiseLeft.of(2.0, 2.0, 1.0, 2, (4, 5)).rest_dn2 == 0.0


@pytest.mark.parametrize(("temperatures_c", "own"), [((20.0, 26.0), 1), ((24.0, 31.0), 0)])
def test_light_is_compared_with_darkness_at_its_own_temperature(temperatures_c, own):
    """Of two plateaus the one nearest to the lit frames' 25 °C counts, colder or warmer: its black is the camera's."""

    def warm(one, celsius):
        return replace(one, settings=replace(one.settings, temperature_c=celsius))

    darks = [
        warm(group(BLACK_DN + shift, 40.0, dark=True, split=NO_SPLIT), celsius)
        for shift, celsius in zip((0.0, 8.0), temperatures_c, strict=True)
    ]
    bright = [
        warm(group(BLACK_DN + 3000.0 * x, 40.0 + 1500.0 * x, level=float(x), split=NO_SPLIT), 25.0) for x in LEVELS
    ]
    found = characterise(subject(), [*bright, *darks]).figures["mu_y_dark"]
    assert found.value == pytest.approx(BLACK_DN + (0.0, 8.0)[own])

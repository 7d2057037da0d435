"""Laws of EMVA 1288 figures on either side of each bound: which steps count, what a bend says, how darkness doubles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from radiometer.analysis.characterise import characterise, report
from radiometer.analysis.characterise.dark_signal import (
    dark_transfer,
    doubling_of,
    doubling_temperature,
    gain_from_darks,
    pooled_frame_sd,
    typical_rates,
)
from radiometer.analysis.characterise.group_statistics import (
    GroupStatistics,
    SpatialSplit,
    statistics_of_group,
    typical_mean,
)
from radiometer.analysis.characterise.nonuniformity import best_stack, nonuniformity_by_part
from radiometer.analysis.characterise.partial import stated_gain_doubt
from radiometer.analysis.characterise.photon_transfer import photon_transfer, transfer_of_few
from radiometer.analysis.characterise.sensitivity import find_saturation, propagated, responsivity
from radiometer.analysis.characterise.steps import contradicting_darks, contradicting_steps, make_steps
from radiometer.analysis.characterise.subject import Subject
from radiometer.data import CameraDescription, FrameSettings, LensDescription, Quantity
from radiometer.errors import MeasurementError

BLACK_DN = 100.0
SIGNALS = np.linspace(200.0, 6000.0, 16)
SUBJECT = Subject("made", CameraDescription(bit_depth=12), LensDescription(), (), (None,), (None,))


def group(mean, variance, exposure_s=1.0, *, dark=False, photons=None, celsius=None, gain_db=0.0, frames=2, **more):
    """Return the statistics of frames of one setting, without pictures."""
    shutter = "closed" if dark else "open"
    settings = FrameSettings(exposure_s, gain_db, temperature_c=celsius, shutter=shutter)
    return GroupStatistics(
        settings, frames, 90_000, mean, variance, 0.0, **{"clipped_share": 0.0, **more}, photons=photons
    )


def steps_of(variances, signals=SIGNALS, dark_variance=40.0, **more):
    """Return steps whose light is twice their signal, in photons."""
    bright = [group(BLACK_DN + s, v, photons=2.0 * s, **more) for s, v in zip(signals, variances, strict=True)]
    return make_steps(bright, [group(BLACK_DN, dark_variance, dark=True)])


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


def test_three_steps_are_the_fewest_and_a_flat_variance_shows_no_light():
    """Two are refused with how many there are; a slope within three of its uncertainties is none."""
    steps = steps_of(40.0 + 0.5 * SIGNALS[:3], SIGNALS[:3])
    assert photon_transfer(steps, 1e5).K.value == pytest.approx(0.5)
    with pytest.raises(MeasurementError, match="only 2 of 2 bright steps"):
        photon_transfer(steps[:2], 1e5)
    with pytest.raises(MeasurementError, match="the variance does not rise"):
        photon_transfer(steps_of(np.full(16, 40.0)), 1e5)


def test_a_bent_photon_transfer_is_reported_with_and_without_darks():
    """K from 0.5 to 0.4 DN: the note stands in the result, and a straight one has none; u holds the range."""
    bright = [group(BLACK_DN + s, 40.0 + (0.52 - 0.1 * s / 6000.0) * s, s / 6000.0) for s in SIGNALS]
    even = [group(BLACK_DN + s, 40.0 + 0.5 * s, s / 6000.0) for s in SIGNALS]
    darks = [group(BLACK_DN, 40.0, s / 6000.0, dark=True) for s in SIGNALS]
    for some, neighbour in ((bright, darks), (bright, []), (even, darks), (even, [])):
        found, straight = characterise(SUBJECT, [*some, *neighbour]), some is even
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
    bright = [group(BLACK_DN + s, v, s / 6000.0) for s, v in zip(SIGNALS, variances, strict=True)]
    darks = [group(BLACK_DN, 40.0, s / 6000.0, dark=True) for s in SIGNALS]
    for groups in ([*bright, *darks], bright):
        notes = characterise(SUBJECT, groups).notes
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


def test_saturation_takes_its_line_from_below_seventy_percent():
    """Light beyond may be compressed as it likes; what would have come without is on the line through nothing."""
    signals = np.where(SIGNALS > 0.7 * 6000.0, 0.9 * SIGNALS + 0.07 * 6000.0, SIGNALS)
    bright = [group(BLACK_DN + s, 40.0 + s, photons=2.0 * x) for s, x in zip(signals, SIGNALS, strict=True)]
    steps = make_steps(bright, [group(BLACK_DN, 40.0, dark=True)])
    found = find_saturation(steps)
    assert found.signal_dn == pytest.approx(signals[-1])
    assert found.linear_signal_dn == pytest.approx(6000.0, rel=1e-6)
    assert responsivity(steps, found, 0.0).value == pytest.approx(0.5, rel=1e-6)
    with pytest.raises(MeasurementError, match="2 bright steps"):
        find_saturation(steps[:2])


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


def test_propagation_is_that_of_a_straight_function():
    """2a − 3b: 4·u_a² + 9·u_b²; a constant has none; a figure without doubt adds none."""
    a, b = Quantity(5.0, 0.3, "x"), Quantity(1.0, 0.4, "x")
    found = propagated(lambda p, q: 2.0 * p - 3.0 * q, "y", a, b)
    assert (found.value, found.u, found.unit) == (pytest.approx(7.0), pytest.approx(math.hypot(0.6, 1.2)), "y")
    assert propagated(lambda p, q: 2.0 * p, "y", a, b).u == pytest.approx(0.6)


@pytest.mark.parametrize("doubling_k", [5.0, 8.0])
def test_a_dark_current_that_doubles_shows_by_how_many_kelvin(doubling_k):
    """2^(T/T_d) at any level; u goes as that of ln D over the span, and falling or unseen currents tell nothing."""
    rates = [(t, Quantity(3.0 * 2.0 ** (t / doubling_k), 0.03 * 2.0 ** (t / doubling_k), "DN/s")) for t in (10.0, 30.0)]
    found = doubling_temperature(rates)
    assert (found.value, found.unit) == (pytest.approx(doubling_k), "K")
    u_slope = 0.01 * math.sqrt(2.0) / 20.0
    assert found.u / found.value == pytest.approx(u_slope / (math.log(2.0) / doubling_k))
    warm = doubling_temperature(rates, [0.5, 0.5])
    u_slope = math.hypot(u_slope, math.log(2.0) / doubling_k * 0.5 * math.sqrt(2.0) / 20.0)
    assert warm.u / warm.value == pytest.approx(u_slope / (math.log(2.0) / doubling_k))
    assert doubling_temperature(rates[:1]) is None
    assert doubling_temperature([(10.0, rates[1][1]), (30.0, rates[0][1])]) is None
    for u_rel, text in ((0.501, False), (0.499, True)):
        faint = (20.0, Quantity(1.0, u_rel, "DN/s"))
        assert (doubling_temperature([faint, (40.0, Quantity(9.0, 0.1, "DN/s"))]) is not None) is text
    assert doubling_of([(None, 0.0, rates[0][1]), (30.0, 0.0, rates[1][1])]) is None


def test_means_of_frames_scatter_by_their_pooled_deviation():
    """Two groups of 3 and 2 frames: (2·9 + 1·36)/3 = 18 DN²; one frame alone says nothing of it."""
    several = [
        group(BLACK_DN, 40.0, dark=True, frames=n, frame_variance_dn2=v) for n, v in ((3, 9.0), (2, 36.0), (1, 1e6))
    ]
    assert pooled_frame_sd(several) == pytest.approx(math.sqrt(18.0))
    assert pooled_frame_sd(several[2:]) == 0.0


def test_a_dark_current_is_that_of_the_long_exposures_and_of_their_temperature():
    """2 DN/s; the sensor warms by a kelvin: the mean of the readings by time; two exposures are the fewest."""
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


@pytest.mark.parametrize(("span_dn", "count", "asked"), [(1.99, 3, False), (2.0, 3, True), (50.0, 2, False)])
def test_a_gain_from_darks_needs_two_dn_of_dark_signal_at_three_exposures(span_dn, count, asked, monkeypatch):
    """Less shows no shot noise; then the frames are not even read."""
    seen = []
    module = "radiometer.analysis.characterise.dark_signal"
    monkeypatch.setattr(f"{module}._frames", lambda _, plateau: seen.append(len(plateau)) or [])
    darks = [group(BLACK_DN + span_dn * k / (count - 1), 40.0, 1.0 + k, dark=True) for k in range(count)]
    assert gain_from_darks(SUBJECT, darks) is None
    assert seen == ([count] if asked else [])


def test_plateaus_of_darks_that_disagree_widen_their_mean(monkeypatch):
    """0.5 and 0.6 ± 0.01 DN/e⁻: 0.55 with their scatter of 0.05 next to the better u; one alone keeps its own."""
    module = "radiometer.analysis.characterise.dark_signal"
    gains = []
    monkeypatch.setattr(f"{module}._frames", lambda *_: [])
    monkeypatch.setattr(f"{module}.dark_transfer", lambda _: type("T", (), {"K": gains.pop(0)})())
    plateaus = [
        [group(BLACK_DN + 5.0 * t, 40.0, t, dark=True, celsius=c) for t in (1.0, 2.0, 3.0)] for c in (20.0, 40.0)
    ]
    gains[:] = [Quantity(0.5, 0.01, "DN/e-"), Quantity(0.6, 0.01, "DN/e-")]
    both, transfers = gain_from_darks(SUBJECT, [*plateaus[0], *plateaus[1]])
    assert (both.value, both.u, len(transfers)) == (pytest.approx(0.55), pytest.approx(math.hypot(0.01, 0.05)), 2)
    gains[:] = [Quantity(0.5, 0.01, "DN/e-")]
    assert gain_from_darks(SUBJECT, plateaus[0])[0].u == pytest.approx(0.01)


def test_a_dark_transfer_needs_five_frames():
    """Shot noise of a dark current over five exposures gives K; four frames, or one exposure, give none."""
    rng = np.random.default_rng(8)
    rates = rng.uniform(0.5, 1.5, 40_000)
    darks = [100.0 + 0.5 * rng.poisson(rates * t + 20.0) for t in (0.0, 100.0, 200.0, 300.0, 400.0)]
    found = dark_transfer(darks)
    assert found.K.value == pytest.approx(0.5, abs=4.0 * found.K.u)
    assert found.K.u < 0.05 * found.K.value
    assert dark_transfer(darks[:4]) is None
    assert dark_transfer([darks[0]] * 6) is None


def test_patterns_of_each_kind_are_light_s_less_darkness_s():
    """Rows √(25 − 9)/400, columns √(9 − 9), pixels √(109 − 9)/400; in the dark √9/0.5 e⁻ each."""
    dark_split = SpatialSplit(9.0, 9.0, 9.0, 0.1, 0.1, 0.1)
    dark = group(BLACK_DN, 40.0, dark=True, split=dark_split)
    bright = group(BLACK_DN + 400.0, 240.0, split=SpatialSplit(25.0, 9.0, 109.0, 0.2, 0.2, 0.2))
    K = Quantity(0.5, 0.0, "DN/e-")
    found = nonuniformity_by_part(bright, dark, K)
    assert {name: one.value for name, one in found.items() if name.startswith("PRNU")} == pytest.approx(
        {"PRNU_row": 1.0, "PRNU_column": 0.0, "PRNU_pixel": 2.5}
    )
    assert [found[f"DSNU_{part}"].value for part in ("row", "column", "pixel")] == pytest.approx([6.0] * 3)
    assert found["PRNU_pixel"].u == pytest.approx(100.0 / 400.0 * math.hypot(0.2, 0.1) / (2.0 * 10.0), rel=0.01)
    assert found["DSNU_row"].u == pytest.approx(0.1 / (2.0 * 3.0) / 0.5, rel=1e-2)
    assert sorted(nonuniformity_by_part(bright, dark, None)) == ["PRNU_column", "PRNU_pixel", "PRNU_row"]
    assert sorted(nonuniformity_by_part(None, dark, K)) == ["DSNU_column", "DSNU_pixel", "DSNU_row"]
    assert nonuniformity_by_part(bright, None, K) == {}
    assert best_stack([replace(bright, frames=n) for n in (2, 5, 3)], 1000.0, BLACK_DN).frames == 5


def test_a_typical_pixel_is_no_hot_one():
    """Within four robust deviations of the median, two DN at least, a pixel counts, beyond it does not."""
    even = np.full(99, 100.0)
    assert typical_mean(np.append(even, 102.0)) == pytest.approx(100.02)
    assert typical_mean(np.append(even, 102.1)) == 100.0
    spread = np.linspace(90.0, 110.0, 101)
    reach = 4.0 * 1.4826 * 5.0
    assert typical_mean(np.append(spread, 100.0 + 1.06 * reach)) == pytest.approx(100.0)
    assert typical_mean(np.append(spread, 100.0 + 0.98 * reach)) == pytest.approx(100.0 + 0.98 * reach / 102.0)


@pytest.mark.parametrize(("part", "count", "named"), [(0.89, 16, 1), (0.91, 16, 0), (0.5, 6, 1), (0.5, 5, 0)])
def test_a_step_contradicts_its_neighbours_from_a_tenth_on(part, count, named):
    """A step at 89 % of what its light says is named, at 91 % not; of five steps no one can tell."""
    signals = SIGNALS[:count].copy()
    signals[count // 2] *= part
    bright = [group(BLACK_DN + s, 100.0, photons=2.0 * x) for s, x in zip(signals, SIGNALS, strict=False)]
    steps = make_steps(bright, [group(BLACK_DN, 40.0, dark=True)])
    assert len(contradicting_steps(steps)) == named
    shown, light = (10.0, 20.0, 30.0, 10.0, 50.0, 60.0, 9e3), (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 9e3)
    dim = [group(BLACK_DN + s, 100.0, photons=2.0 * x) for s, x in zip(shown, light, strict=True)]
    assert contradicting_steps(make_steps(dim, [group(BLACK_DN, 40.0, dark=True)])) == []


@pytest.mark.parametrize(
    ("top_dn", "off_dn", "named"), [(0.0, 9.0, 0), (0.0, 11.0, 1), (2000.0, 19.0, 0), (2000.0, 21.0, 1)]
)
def test_a_dark_group_is_off_from_a_tenth_and_a_hundredth_of_the_light_on(top_dn, off_dn, named):
    """10 % of 100 DN are 10 DN; 1 % of light of 2000 DN are 20: less is an offset, not a mistake."""
    means = np.full(8, BLACK_DN)
    means[3] += off_dn
    darks = [group(mean, 40.0, 1.0 + k, dark=True) for k, mean in enumerate(means)]
    assert len(contradicting_darks(darks, top_dn)) == named
    assert contradicting_darks(darks[:5], top_dn) == []


@pytest.mark.parametrize(
    ("stated", "gain_db", "reported"),
    [(2.0, 0.0, 0), (2.039, 0.0, 0), (2.041, 0.0, 1), (1.959, 0.0, 1), (2.0, 20.0, 1), (20.0, 20.0, 0)],
)
def test_a_stated_gain_is_doubted_beyond_twice_what_is_known(stated, gain_db, reported):
    """K of 0.5 ± 0.005 DN/e⁻ is 2 ± 0.02 e⁻/DN; at 20 dB ten times as many at 0 dB."""
    notes = stated_gain_doubt(stated, Quantity(0.5, 0.005, "DN/e-"), gain_db)
    assert len(notes) == reported


@pytest.mark.parametrize("straight", [True, False])
def test_a_desk_s_picture_has_a_panel_next_to_the_first_for_each_other(straight, monkeypatch):
    """Photon transfer over the whole height on the left; linearity, where reported, above the SNR on the right."""
    figure = Figure()
    monkeypatch.setattr(report, "picture", lambda draw, *_: draw(figure, False) or "")
    bright = [group(BLACK_DN + s, 40.0 + 0.5 * s, s / 6000.0) for s in SIGNALS]
    result = characterise(SUBJECT, [*bright, group(BLACK_DN, 40.0, dark=True)])
    result = replace(result, linearity=result.linearity if straight else None)
    report.story(result)
    left, *right = (axes.get_position() for axes in figure.axes)
    assert len(right) == (2 if straight else 1)
    assert all(one.x0 > left.x1 for one in right)
    assert (left.y0, left.y1) == pytest.approx((right[-1].y0, right[0].y1))
    assert left.width / right[0].width == pytest.approx(1.25)


def test_a_dark_group_that_contradicts_those_of_its_gain_is_left_out_and_named():
    """One of eight at 0 dB shows 200 DN too much; those at 20 dB, three times as dark, are no judges of it."""
    bright = [group(BLACK_DN + s, 40.0 + 0.5 * s, s / 6000.0) for s in SIGNALS]
    darks = [group(BLACK_DN, 40.0, 1.0 + k, dark=True) for k in range(8)]
    darks[3] = replace(darks[3], mean_dn=BLACK_DN + 200.0)
    loud = [group(3.0 * BLACK_DN, 400.0, 1.0 + k, dark=True, gain_db=20.0) for k in range(8)]
    for neighbour in ([], loud):
        found = characterise(SUBJECT, [*bright, *darks, *neighbour])
        (named,) = [note for note in found.notes if note.startswith("left out")]
        assert "dark group of 2 frames at 4 s" in named
        assert len(found.dark_points) == 7
        assert found.figures["mu_y_dark"].value == pytest.approx(BLACK_DN)


def test_a_step_without_any_signal_shows_no_responsivity():
    """Light that brings exactly nothing is not on the line of the others."""
    steps = steps_of(40.0 + 0.5 * SIGNALS)
    saturation = find_saturation(steps)
    nothing = replace(steps[0], bright=replace(steps[0].bright, mean_dn=BLACK_DN), light=2000.0)
    assert responsivity([nothing, *steps], saturation, 0.0).value == responsivity(steps, saturation, 0.0).value


def test_shares_at_both_ends_are_of_all_frames():
    """Of 3 frames of 8 pixels, 1, 2 and 0 at 0 and 0, 1 and 3 at full scale or above: 3/24 and 4/24."""
    frames = np.full((3, 2, 4), 50, np.uint16)
    frames[0, 0, 0] = frames[1, 0, :2] = 0
    frames[1, 1, 3] = 255
    frames[2, 1, :3] = (255, 255, 256)
    (found,) = statistics_of_group(iter(frames), FrameSettings(1.0), (None,), 255)
    assert (found.floor_share, found.clipped_share, found.frames, found.pixels) == (3 / 24, 4 / 24, 3, 8)


def test_variances_of_a_stack_scatter_by_their_stated_uncertainty():
    """150 stacks of four frames, noise of 3 DN and a pattern of 4 DN: both variances, to 25 % (sigma is 5.8 %)."""
    rng = np.random.default_rng(20261126)
    stacks = []
    for _ in range(150):
        pattern = 2000.0 + 4.0 * rng.standard_normal((24, 24))
        frames = [np.rint(pattern + 3.0 * rng.standard_normal((24, 24))).astype(np.uint16) for _ in range(4)]
        stacks += statistics_of_group(frames, FrameSettings(1e-3), (None,), 4095)
    temporal, spatial = (
        np.array([getattr(s, name) for s in stacks]) for name in ("variance_dn2", "spatial_variance_dn2")
    )
    assert temporal.std() == pytest.approx(np.mean([s.u_variance_dn2 for s in stacks]), rel=0.25)
    assert spatial.std() == pytest.approx(np.mean([s.u_spatial_variance_dn2 for s in stacks]), rel=0.25)
    assert temporal.mean() == pytest.approx(9.0 + 1 / 12, rel=0.02)
    assert spatial.mean() == pytest.approx(16.0, rel=0.02)

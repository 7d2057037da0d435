"""What must hold of any reading of a patch: scaling, order, clipping, and each line of its budget by known values.

Frames hold one number in every pixel, so that there is no noise and every figure can be worked out by hand.
"""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from radiometer.analysis.reading.reading import patch_situation, read_patch
from radiometer.analysis.signal.model import crop_frames, signal_model
from radiometer.analysis.signal.situation import situation_of
from radiometer.data import (
    BlackLevel,
    Bracket,
    CameraDescription,
    Flag,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    ResponseCurve,
    SensorNoise,
    StatedUncertainties,
)
from radiometer.data.setup import Setup

NOTHING_STATED = StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0))
KNOWN_BLACK = BlackLevel(dn=64.0, u_dn=0.0, dark_u_rel=0.0)
PATCH = Patch(2, 2, 10, 10)
GAIN_E, READ_E, BLACK = 2.6, 2.4, 64.0  # of the rig
relaxed = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
numbers = st.integers(300, 3500)
times = st.floats(1e-5, 1.0)


def flat(number, exposure_s=1e-3, size=14, **changes):
    """Return a frame with one number in every pixel."""
    setting = FrameSettings(exposure_s, 0.0, 4.0, BLACK, temperature_c=25.0)
    return Frame(np.full((size, size), number, np.uint16), 12, replace(setting, **changes))


def exact(rig, **changes):
    return rig.calibration(**{"uncertainties": NOTHING_STATED, "black_level": KNOWN_BLACK} | changes)


def read(rig, frames, calibration=None, lens=None, patch=PATCH, **options):
    setup = {name: options.pop(name) for name in ("source", "spectrum") if name in options}
    return read_patch(
        Bracket.from_frames(frames),
        patch,
        Setup(rig.description, lens or rig.lens, calibration or exact(rig), **setup),
        **options,
    )


def line(reading, name):
    return next(one.u_rel for one in reading.budget if one.name == name)


@relaxed
@given(number=numbers, exposure_s=times, f_number=st.floats(1.0, 22.0), gain_db=st.floats(0.0, 24.0))
def test_radiance_follows_number_time_stop_and_gain(rig, number, exposure_s, f_number, gain_db):
    """L = scale·(M − black)/(gain·t)·4N²/π, whatever the settings."""
    found = read(rig, [flat(number, exposure_s, f_number=f_number, gain_db=gain_db)])
    rate = (number - BLACK) / 10 ** (gain_db / 20) / exposure_s
    assert found.radiance.value == pytest.approx(rig.true_scale * rate * 4 * f_number**2 / math.pi, rel=1e-9)
    assert found.radiance.unit == "W sr-1 m-2"


@relaxed
@given(number=numbers, transmittance=st.floats(0.05, 1.0), magnification=st.floats(0.0, 1.0))
def test_radiance_follows_transmittance_and_magnification(rig, number, transmittance, magnification):
    """A filter before the lens and a near focus let less light in: L grows by 1/τ and (1 + m)²."""
    known = exact(rig)
    clear = replace(known, lens=rig.lens.model_copy(update={"transmittance": 1.0}))
    lens = LensDescription(focal_length_mm=16.0, f_number=4.0, transmittance=transmittance, magnification=magnification)
    ratio = read(rig, [flat(number)], clear, lens).radiance.value / read(rig, [flat(number)]).radiance.value
    assert ratio == pytest.approx((1 + magnification) ** 2 / transmittance, rel=1e-9)


@relaxed
@given(order=st.permutations(range(4)), number=numbers)
def test_the_order_of_frames_changes_nothing(rig, order, number):
    """Value, u, flags and budget."""
    frames = [flat(number - 40 * k, 1e-3 * (1 + k)) for k in range(4)]
    one, other = (read(rig, chosen, now=NOW) for chosen in (frames, [frames[k] for k in order]))
    assert other.radiance.value == pytest.approx(one.radiance.value, rel=1e-12)
    assert other.radiance.u == pytest.approx(one.radiance.u, rel=1e-9)
    assert other.flags == one.flags


NOW = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)


@relaxed
@given(number=numbers, times=st.integers(2, 1000))
def test_a_clipped_frame_adds_nothing(rig, number, times):
    """A longer exposure that clips leaves value and uncertainty as they were."""
    one = read(rig, [flat(number), flat(number)])
    more = read(rig, [flat(number), flat(number), flat(4095, 1e-3 * times)])
    assert more.radiance == one.radiance
    assert more.exposures_s == one.exposures_s


@relaxed
@given(count=st.integers(1, 12), side=st.integers(4, 10), number=numbers)
def test_noise_falls_by_the_root_of_frames_and_pixels(rig, count, side, number):
    """σ of one sample: √(light/K + (σ_d/K)² + 1/12) DN; over n frames of m pixels that over √(n·m)."""
    found = read(rig, [flat(number)] * count, patch=Patch(2, 2, side, side))
    x = number - BLACK
    sigma = math.sqrt(x / GAIN_E + (READ_E / GAIN_E) ** 2 + 1 / 12)
    assert line(found, "repeatability") == pytest.approx(sigma / x / math.sqrt(count) / side, rel=1e-9)
    assert line(found, "source fluctuation") == 0.0


@relaxed
@given(number=numbers, u_dn=st.floats(0.1, 10.0), count=st.integers(1, 5))
def test_the_black_level_s_uncertainty_does_not_average_out(rig, number, u_dn, count):
    """u DN of x DN, however many frames; with dark frames instead it is their own noise."""
    doubted = exact(rig, black_level=BlackLevel(dn=64.0, u_dn=u_dn, dark_u_rel=0.0))
    found = read(rig, [flat(number)] * count, doubted)
    assert line(found, "dark and black level") == pytest.approx(u_dn / (number - BLACK), rel=1e-9)
    dark = [flat(70, shutter="closed")] * 3
    found = read(rig, [*dark, *[flat(number)] * count], doubted)
    noise = math.sqrt((READ_E / GAIN_E) ** 2 + 1 / 12) / math.sqrt(3 * 14 * 14) / math.sqrt(count)
    own = [line(found, "dark and black level"), line(found, "repeatability")]
    assert own[0] == pytest.approx(noise / (number - 70), rel=0.6)
    assert own[0] < u_dn / (number - BLACK)
    assert found.radiance.value / read(rig, [flat(number)]).radiance.value == pytest.approx(
        (number - 70) / (number - BLACK), rel=1e-9
    )


@pytest.mark.parametrize("spread", [0.01, 0.03, 0.1])
def test_what_frames_differ_by_is_their_standard_deviation(rig, spread):
    """Bright frames of a source that fluctuates: s of the frames, and s/√n in the mean, and the flag."""
    level, count = 2000.0, 9
    factors = 1.0 + spread * np.sqrt(9 / 8) * np.array([1, -1, 1, -1, 1, -1, 1, -1, 0])
    frames = [flat(round(BLACK + level * factor)) for factor in factors]
    found = read(rig, frames)
    expected = float(np.std(factors, ddof=1))
    assert found.provenance.parameters["fluctuation_rel"] == pytest.approx(expected, rel=0.13)  # steps of the search
    assert line(found, "source fluctuation") == pytest.approx(expected / math.sqrt(count), rel=0.13)
    assert Flag.FLICKER in found.flags
    assert next(one for one in found.budget if one.name == "source fluctuation").degrees_of_freedom == count - 1
    assert found.radiance.value == pytest.approx(read(rig, [flat(2064)]).radiance.value, rel=1e-3)


@relaxed
@given(number=numbers, u_scale=st.floats(0.001, 0.1), u_exposure=st.floats(0.0, 0.01), spectral=st.floats(0.0, 0.1))
def test_the_lines_add_up_in_squares(rig, number, u_scale, u_exposure, spectral):
    """u² is the sum of the lines' squares, U is k·u, and the stated lines stand as stated."""
    stated = NOTHING_STATED.model_copy(update={"exposure_u_rel": u_exposure, "spectral_u_rel": spectral})
    known = exact(rig, u_rel=u_scale, uncertainties=stated)
    found = read(rig, [flat(number)] * 3, known)
    u_rel = found.radiance.u / found.radiance.value
    assert u_rel**2 == pytest.approx(sum(one.u_rel**2 for one in found.budget), rel=1e-9)
    assert line(found, "scale") == pytest.approx(u_scale)
    assert line(found, "exposure time") == pytest.approx(u_exposure)
    assert line(found, "spectral assumption") == pytest.approx(spectral)
    assert found.expanded_u_rel == pytest.approx(found.coverage_factor * u_rel)
    assert found.coverage_factor == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("f_number", [2.8, 4.0])
def test_another_stop_counts_twice(rig, f_number):
    """L ~ N²: 2 % of the f-number are 4 % of L where it is not the calibration's, and nothing where it is."""
    known = exact(rig, uncertainties=NOTHING_STATED.model_copy(update={"f_number_u_rel": 0.02}))
    found = read(rig, [flat(2000, f_number=f_number)] * 3, known)
    assert line(found, "f-number") == pytest.approx(0.04 if f_number != 4.0 else 0.0)


@pytest.mark.parametrize(("side", "u_rel"), [(2, 0.01 / 2), (3, 0.01 / 3), (4, 0.0)])
def test_few_pixels_cannot_show_their_pattern(rig, side, u_rel):
    """Below 16 pixels 1 % each as stated, over the root of the pixels; from 16 on what they show: nothing."""
    known = exact(rig, uncertainties=NOTHING_STATED.model_copy(update={"prnu_u_rel": 0.01}))
    found = read(rig, [flat(3000)] * 200, known, patch=Patch(2, 2, side, side))
    assert line(found, "pixel pattern") == pytest.approx(u_rel, rel=1e-9)
    assert (Flag.SMALL_PATCH in found.flags) is False or side < 4


def pattern(frame, amplitude):
    """Return a frame as a chessboard of ±amplitude DN."""
    board = np.indices(frame.shape).sum(0) % 2 * 2 - 1
    return replace(frame, dn=(frame.dn + amplitude * board).astype(np.uint16))


def test_a_pattern_counts_as_what_it_shows(rig):
    """±100 of 2000 DN: differences of neighbours over √2 are 141 DN; less the noise, over ten (√100 pixels)."""
    found = read(rig, [pattern(flat(2064), 100)])
    variance = 2000 / GAIN_E + (READ_E / GAIN_E) ** 2 + 1 / 12
    expected = math.sqrt(200**2 / 2 - variance) / 10 / 2000
    assert line(found, "pixel pattern") == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("slope_dn", "raised"), [(0, False), (25, False), (50, True)])
def test_a_slope_over_the_patch_is_reported_from_five_per_cent_on(rig, slope_dn, raised):
    """Ten columns that rise by 25 of 3000 DN each differ by 2.4 % (standard deviation), by 50 DN 4.8 % and 57 more."""
    frame = flat(3064)
    steps = (np.arange(14) - 6.5) * slope_dn * (1.2 if raised else 1.0)
    found = read(rig, [replace(frame, dn=(frame.dn + steps[None, :]).astype(np.uint16))] * 5)
    assert (Flag.NONUNIFORM in found.flags) is raised


@pytest.mark.parametrize(("amplitude", "raised"), [(100, False), (170, True)])
def test_a_pattern_in_the_patch_is_reported_as_well(rig, amplitude, raised):
    """A chessboard of ±100 of 3000 DN scatters by 4.7 %, of ±170 by 8 %."""
    found = read(rig, [pattern(flat(3064), amplitude)] * 5)
    assert (Flag.NONUNIFORM in found.flags) is raised


def usable(rig, dn, full_well_e=1e6, **changes):
    """Return what is stated of one frame: whether it may be used, and whether it clips."""
    calibration = exact(rig)
    known = replace(calibration, noise=replace(calibration.noise, full_well_e=full_well_e))
    model = situation_of(Setup(rig.description, rig.lens, known)).model
    (cropped,), _, _ = crop_frames([replace(flat(0, **changes), dn=np.asarray(dn, np.uint16))], PATCH, model)
    return cropped.usable, cropped.unclipped


def board(number, others=(), size=14):
    """Return numbers of a frame: one in all pixels, others in the first ones of the patch."""
    dn = np.full((size, size), number)
    for k, other in enumerate(others):
        dn[2 + k // 10, 2 + k % 10] = other
    return dn


def test_a_frame_is_used_four_sigma_below_clipping(rig):
    """Of the converter's end: 4095 less four times the noise there; one number more is too much."""
    edge = next(
        n for n in range(4095, 0, -1) if n + 4 * math.sqrt((n - 64) / GAIN_E + (READ_E / GAIN_E) ** 2 + 1 / 12) < 4095
    )
    assert usable(rig, board(edge)) == (True, True)
    assert usable(rig, board(edge + 1)) == (False, False)


@pytest.mark.parametrize("gain_db", [0.0, 6.0])
def test_a_full_well_clips_before_the_converter(rig, gain_db):
    """97 % of 5000 e⁻ are 1865 DN above black at 0 dB, twice that at 6 dB; four sigma below it is still used."""
    gain = 10 ** (gain_db / 20)
    end = 64 + 0.97 * 5000 / GAIN_E * gain
    sigma = gain * math.sqrt(0.97 * 5000 / GAIN_E / GAIN_E + (READ_E / GAIN_E) ** 2 + 1 / 12 / gain**2)
    assert usable(rig, board(int(end - 4.1 * sigma)), 5000.0, gain_db=gain_db) == (True, True)
    assert usable(rig, board(int(end - 3.5 * sigma)), 5000.0, gain_db=gain_db) == (False, False)


@pytest.mark.parametrize(("clipped", "used"), [(0, True), (1, True), (2, False), (50, False)])
def test_one_pixel_in_a_hundred_is_a_defect(rig, clipped, used):
    """More clipped pixels are the scene's; the clipped ones of a used frame take no part."""
    dn = board(1000, [4095] * clipped)
    assert usable(rig, dn)[0] is used
    if used:
        found = read(rig, [replace(flat(0), dn=dn.astype(np.uint16))])
        assert found.radiance.value == pytest.approx(read(rig, [flat(1000)]).radiance.value, rel=1e-12)


@pytest.mark.parametrize(("brightest", "unclipped"), [(254, True), (255, False)])
def test_beyond_a_curve_s_data_only_white_clips(brightest, unclipped):
    """Numbers from 201 on have no curve: a frame at 199 is not used, but clips only where a pixel is at full scale."""
    g = np.log(np.maximum(np.arange(256.0), 0.5))
    curve = ResponseCurve(g, np.full(256, 0.01), valid_dn=(2, 200))
    camera = CameraDescription(bit_depth=8, black_level_dn=0.0)
    noise = SensorNoise(conversion_gain_e_per_dn=100.0, read_noise_e=1.0, full_well_e=1e6)
    model = signal_model(camera, curve, noise, 0.0)
    dn = np.full((14, 14), 199, np.uint8)
    dn[5, 5] = brightest
    (cropped,), _, _ = crop_frames([Frame(dn, 8, FrameSettings(0.01))], PATCH, model)
    assert (cropped.usable, cropped.unclipped) == (False, unclipped)
    assert cropped.whole_clipped == pytest.approx(0.0 if unclipped else 1 / 196)


def test_the_bright_half_of_a_patch_must_not_clip(rig):
    """Half at 1000 and half at 4085 DN is not used, half at 3000 is."""
    assert usable(rig, board(1000, [4085] * 50)) == (False, False)
    assert usable(rig, board(1000, [3000] * 50)) == (True, True)


def test_what_clips_in_every_frame_is_a_lower_bound(rig):
    """The shortest frame's value, with as much uncertainty, and the flag."""
    found = read(rig, [flat(4095, 2e-3), flat(4095, 1e-3)])
    assert Flag.SATURATED in found.flags
    assert found.exposures_s == (1e-3,)
    assert line(found, "clipping") == pytest.approx(1.0)
    assert line(found, "clipping") <= found.radiance.u / found.radiance.value


def test_a_frame_that_clips_for_no_reason_means_that_the_light_changes(rig):
    """White at an exposure no longer than one that is not."""
    steady = [flat(1000), flat(4095, 0.5)]
    assert Flag.FLICKER not in read(rig, steady).flags
    assert Flag.FLICKER in read(rig, [flat(1000), flat(4095)]).flags


@pytest.mark.parametrize(
    ("exposure_s", "count", "few"), [(0.01, 2, True), (0.01, 3, False), (0.0099, 4, True), (0.0099, 5, False)]
)
def test_few_frames_cannot_show_flicker(rig, exposure_s, count, few):
    """Three of 10 ms or more, five of less."""
    assert (Flag.FEW_FRAMES in read(rig, [flat(1000, exposure_s)] * count).flags) is few


@pytest.mark.parametrize(("level", "below"), [(64, True), (65, True), (70, False), (1000, False)])
def test_two_sigma_are_the_noise_floor(rig, level, below):
    """One frame of 100 pixels: σ of the mean 0.1 DN, so that 1 DN shows — and is below where black is known to 1 DN."""
    doubted = exact(rig, black_level=BlackLevel(dn=64.0, u_dn=1.0, dark_u_rel=0.0))
    assert (Flag.BELOW_NOISE in read(rig, [flat(level)] * 3, doubted).flags) is below
    assert (Flag.BELOW_NOISE in read(rig, [flat(level)] * 3).flags) is (level == 64)


@pytest.mark.parametrize(("white", "reported"), [(0, False), (3, True)])
def test_a_surround_that_clips_may_be_of_any_brightness(rig, white, reported):
    """Beyond 0.2 % of the picture: three pixels of 196."""
    dn = flat(1000).dn.copy()
    dn[0, :white] = 4095
    assert (Flag.STRAY_LIGHT in read(rig, [replace(flat(1000), dn=dn)] * 5).flags) is reported
    deep = exact(rig)
    deep = replace(deep, noise=replace(deep.noise, full_well_e=1e6))  # white is then the converter's last number
    assert (Flag.STRAY_LIGHT in read(rig, [replace(flat(1000), dn=dn)] * 5, deep).flags) is reported


def test_a_pixel_that_clips_in_one_frame_takes_part_in_none(rig):
    """Three times as bright as the rest: seen in the short frame, clipped in the long one, left out of both."""
    short, long = flat(1064), flat(2064, 2e-3)
    dn = [short.dn.copy(), long.dn.copy()]
    dn[0][5, 5], dn[1][5, 5] = 3064, 4095
    found = read(rig, [replace(short, dn=dn[0]), replace(long, dn=dn[1])])
    assert found.radiance.value == pytest.approx(read(rig, [short, long]).radiance.value, rel=1e-9)
    assert found.exposures_s == (1e-3, 2e-3)


def test_another_focus_costs_what_the_change_is_known_to(rig):
    """Magnification 0.2 instead of 0.1, known to 10 % of the change: 2·0.01/1.2; focused as at calibration, nothing."""
    stated = NOTHING_STATED.model_copy(update={"magnification_u_rel": 0.1})
    known = replace(exact(rig, uncertainties=stated), lens=rig.lens.model_copy(update={"magnification": 0.1}))
    for magnification, u_rel in ((0.2, 2 * 0.01 / 1.2), (0.1, 0.0)):
        lens = LensDescription(focal_length_mm=16.0, f_number=4.0, magnification=magnification)
        assert line(read(rig, [flat(1000)] * 5, known, lens), "focus") == pytest.approx(u_rel)


def test_the_surround_is_the_mean_of_the_picture(rig):
    """Patch 1000 DN above black, one row of fourteen at 3000: the mean of all."""
    dn = flat(1064).dn.copy()
    dn[0, :] = 3064
    frames = Bracket.from_frames([replace(flat(1064), dn=dn)])
    found = patch_situation(frames, PATCH, Setup(rig.description, rig.lens, exact(rig)))
    assert found.conditions.surround == pytest.approx((13 * 1000 + 3000) / 14 / 1000, rel=1e-6)
    assert found.conditions.level == pytest.approx(1000 / (4095 - 64), rel=1e-6)
    assert found.conditions.inverse_exposure_per_s == pytest.approx(1000.0)


@pytest.mark.parametrize(("days", "stale"), [(364.0, False), (366.0, True)])
def test_a_calibration_is_stale_after_its_days(rig, days, stale):
    """365 days from its making."""
    known = replace(exact(rig), created="2026-01-01T00:00:00Z", validity_days=365.0)
    now = NOW + dt.timedelta(days=days)
    assert (Flag.STALE_CALIBRATION in read(rig, [flat(1000)] * 5, known, now=now).flags) is stale

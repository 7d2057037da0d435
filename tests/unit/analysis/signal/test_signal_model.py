"""Digital numbers to signal and its noise: EMVA 1288's equations with numbers, inverses, and the dark level."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.analysis.signal.lens import known_f_number, lens_factor_sr, relative_sensitivity
from radiometer.analysis.signal.model import dark_levels, signal_model
from radiometer.data import (
    BlackLevel,
    CameraDescription,
    Frame,
    FrameSettings,
    LensDescription,
    ResponseCurve,
    SensorNoise,
)

CAMERA = CameraDescription(bit_depth=12)
NOISE = SensorNoise(conversion_gain_e_per_dn=2.0, read_noise_e=6.0, dark_current_e_per_s=50.0, full_well_e=7000.0)
BLACK = 100.0
LINEAR = signal_model(CAMERA, None, NOISE, BLACK, 0.001)
quick = settings(max_examples=40, deadline=None)
gains = st.floats(0.0, 24.0)


def gamma_curve(gamma=2.2, valid=(120, 4000)):
    """Return exposure ~ (M − black)^γ, in the middle 1."""
    dn = np.maximum(np.arange(4096.0) - BLACK, 1e-3)
    return ResponseCurve(gamma * np.log(dn / (2048 - BLACK)), np.full(4096, 0.01), valid_dn=valid)


CURVED = signal_model(CAMERA, gamma_curve(), NOISE, BLACK)


@quick
@given(st.integers(0, 4095), gains, st.floats(50.0, 150.0))
def test_a_number_is_light_less_its_black_level_over_its_gain(number, gain_db, black):
    """x = (M − black)/G of a straight line; the frame's own black level counts."""
    setting = FrameSettings(1e-3, gain_db, black_level_dn=black)
    gain = 10 ** (gain_db / 20)
    assert LINEAR.table(setting)[number] == pytest.approx((number - black) / gain)
    assert LINEAR.table(FrameSettings(1e-3, gain_db))[number] == pytest.approx((number - BLACK) / gain)
    assert LINEAR.black_of(setting) == black


@quick
@given(st.floats(200.0, 3900.0), gains, st.floats(80.0, 120.0), st.sampled_from([LINEAR, CURVED]))
def test_number_and_signal_are_inverse(number, gain_db, black, model):
    """dn_of undoes table, through a curve as through a line, whatever gain and black level."""
    setting = FrameSettings(1e-3, gain_db, black_level_dn=black)
    signal = model.at_dn(model.table(setting), number)
    assert float(model.dn_of(signal, setting)) == pytest.approx(number, abs=0.02)


@quick
@given(st.floats(0.0, 3000.0), gains, st.floats(1e-4, 10.0), st.floats(0.0, 60.0))
def test_the_variance_of_a_sample_is_emva_1288_s(signal, gain_db, exposure_s, celsius):
    """σ² = (μ_e + σ_d² + μ_d)/K² + 1/(12·G²) DN² at 0 dB; the dark current doubles every 7 K from 25 °C."""
    setting = FrameSettings(exposure_s, gain_db, temperature_c=celsius)
    dark_e = 50.0 * 2 ** ((celsius - 25.0) / 7.0) * exposure_s
    expected = (2.0 * signal + 36.0 + dark_e) / 4.0 + 1 / 12 / 10 ** (gain_db / 10)
    assert float(LINEAR.variance(signal, setting)) == pytest.approx(expected, rel=1e-9)
    assert float(LINEAR.variance(-signal, setting)) == pytest.approx(float(LINEAR.variance(0.0, setting)))
    assert LINEAR.modelled_dark(setting) == pytest.approx(dark_e / 2.0)
    in_dn = NOISE.variance_dn2(signal * 10 ** (gain_db / 20), gain_db, dark_e)
    assert float(in_dn) == pytest.approx(expected * 10 ** (gain_db / 10), rel=1e-9)


@quick
@given(st.floats(500.0, 3500.0), gains)
def test_rounding_behind_a_curve_is_the_curve_s_slope(number, gain_db):
    """(dx/dM)²/12 at the number, over the gain squared; electrons per x so that the top holds K·(top − black)."""
    setting = FrameSettings(1e-9, gain_db)
    x = float(CURVED.at_dn(CURVED.table(setting), number))
    exposure = ((number - BLACK) / (2048 - BLACK)) ** 2.2
    gain = 10 ** (gain_db / 20)
    assert x == pytest.approx(exposure / gain, rel=1e-4)
    per_unit = 2.0 * (4000 - BLACK) / ((4000 - BLACK) / (2048 - BLACK)) ** 2.2
    assert CURVED.electrons_per_unit == pytest.approx(per_unit, rel=1e-9)
    slope = 2.2 * exposure / (number - BLACK) / gain
    expected = (x * per_unit + 36.0) / per_unit**2 + slope**2 / 12
    assert float(CURVED.variance(x, setting)) == pytest.approx(expected, rel=2e-3)


def test_without_data_the_model_stands_alone():
    """Below a curve's data a line to black; without dark frames what is stated."""
    low = CURVED.signal[120]
    assert CURVED.signal[110] == pytest.approx(low / 2)
    assert CURVED.signal[100] == pytest.approx(0.0)
    assert CURVED.signal[90] == pytest.approx(-low / 2)
    assert CURVED.u_rel[50] == CURVED.u_rel[120] == 0.01
    assert CURVED.valid_dn == (120, 4000)
    assert LINEAR.u_rel[5] == 0.001
    (level,) = dark_levels([LIGHT], [], LINEAR, DOUBT)
    assert (level.signal, level.source) == (pytest.approx(2.5), "black level")
    assert (level.u_independent, level.u_common) == (0.0, pytest.approx(math.hypot(0.5, 0.4 * 2.5)))
    camera = CAMERA.model_copy(update={"pixel_pitch_um": 4.5})
    unknown = signal_model(camera, None, SensorNoise(2.0, 6.0, assumed=("dark_current_e_per_s",)), BLACK)
    (most,) = dark_levels([LIGHT], [], unknown, DOUBT, darkest=(1000.0,))
    e_per_s = 1e-9 * 4.5e-4**2 / 1.602e-19  # 1 nA/cm²
    assert most.u_unstated == pytest.approx(e_per_s * 0.1 / 2.0 / 2.0, rel=1e-3)


@pytest.mark.parametrize("gain_db", [0.0, 6.0, 20.0])
def test_where_a_frame_clips(gain_db):
    """97 % of the full well above black, or the converter's end; behind a curve the last number with data and one."""
    setting = FrameSettings(1e-3, gain_db)
    assert LINEAR.saturation_dn(setting) == pytest.approx(min(4095.0, 100 + 0.97 * 3500 * 10 ** (gain_db / 20)))
    assert CURVED.saturation_dn(setting) == 4001.0
    assert CURVED.saturation_dn(setting, within_data=False) == 4095.0
    unknown = SensorNoise(2.0, 6.0, full_well_e=7000.0, assumed=("full_well_e",))
    assert signal_model(CAMERA, None, unknown, BLACK).saturation_dn(setting) == 4095.0


def dark_frame(number, exposure_s, gain_db=0.0, size=10):
    dn = number + np.tile([-1, 1], size * size // 2).reshape(size, size)  # the noise that rounding needs
    return Frame(dn.astype(np.uint16), 12, FrameSettings(exposure_s, gain_db, temperature_c=25.0, shutter="closed"))


LIGHT, DARK = (FrameSettings(0.1, temperature_c=25.0, shutter=one) for one in ("open", "closed"))
WARMTH = math.log(2.0) / 7.0 * 0.5 / math.sqrt(6.0)  # of dark signal, by two thermometers in steps of 0.5 K
DOUBT = BlackLevel(dn=BLACK, u_dn=0.5, dark_u_rel=0.4)
UNKNOWN_BLACK = BlackLevel(dn=0.0, u_dn=0.5, dark_u_rel=0.4)


def test_dark_frames_of_the_exposure_show_the_dark_signal():
    """Mean of the frames; noise of one sample over the root of all, scatter by Student's t of one; shared is warmth."""
    frames = [dark_frame(111, 0.1), dark_frame(111, 0.1005)]
    (level,) = dark_levels([LIGHT], frames, LINEAR, DOUBT)
    assert (level.signal, level.source) == (pytest.approx(11.0), "dark frames")
    assert level.u_common == pytest.approx(WARMTH * math.hypot(11.0, 0.5))
    shot = (11.0 - 2.0 * 0.5 - 2.5) / 2.0  # of what neither black level nor modelled dark signal explain, at 2 e⁻/DN
    assert level.u_independent == pytest.approx(math.sqrt((float(LINEAR.variance(0.0, LIGHT)) + shot) / 200))
    (scattered,) = dark_levels([LIGHT], [dark_frame(110, 0.1), dark_frame(112, 0.1005)], LINEAR, DOUBT)
    assert scattered.u_independent == pytest.approx(13.97 / 2.0, rel=0.05)
    for other in (dark_frame(110, 0.098), dark_frame(110, 0.102)):
        assert dark_levels([LIGHT], [other], LINEAR, DOUBT)[0].source == "dark frames of other exposures"
    assert dark_levels([LIGHT], [dark_frame(110, 0.1, 6.0)], LINEAR, DOUBT)[0].source == "black level"


@pytest.mark.parametrize("warmer_k", [-3.0, -1.0, 2.0, None])
def test_dark_frames_of_another_warmth_are_scaled_to_the_light_frame(warmer_k):
    """11 DN double with 7 K, or with 4.3 K within k = 2; so do 3 K where no temperature is stated."""
    frame = dark_frame(111, 0.1)
    here = replace(LIGHT, temperature_c=None if warmer_k is None else 25.0 + warmer_k)
    (level,) = dark_levels([here], [frame], LINEAR, DOUBT)
    assert level.signal == pytest.approx(11.0 * 2.0 ** ((warmer_k or 0.0) / 7.0))
    if warmer_k is None:
        assert 2.0 * level.u_common > 11.0 * (2.0 ** (3.0 / 4.3) - 1.0)
        assert level.source == "dark frames of unknown warmth"
    else:
        off = 11.0 * 2.0 ** (warmer_k / 4.3) - level.signal
        assert level.u_common == pytest.approx(math.hypot(off / 2.0, WARMTH * level.signal), rel=0.03)


@pytest.mark.parametrize(("stated", "most_dn"), [(50.0, 2.5), (None, 50.0)])
def test_what_dark_frames_show_beyond_any_dark_current_has_no_warmth(stated, most_dn):
    """Of 50 DN whose black level nothing states, 2.5 are dark current as stated, or all where nothing states it."""
    camera = LINEAR.camera.model_copy(update={"dark_current_e_per_s": stated})
    model = signal_model(camera, None, replace(NOISE, assumed=() if stated else ("dark_current_e_per_s",)), 0.0)
    (level,) = dark_levels([replace(LIGHT, temperature_c=None)], [dark_frame(50, 0.1)], model, BlackLevel())
    assert 0.0 < 2.0 * level.u_common <= most_dn
    twice = [dark_frame(50, 0.1), dark_frame(50, 0.4)]  # no dark current: nothing that warmth changes
    (level,) = dark_levels([replace(LIGHT, temperature_c=None)], twice, model, BlackLevel())
    assert level.u_common < 0.3


@pytest.mark.parametrize("step", [1, 16])
def test_what_rounding_hides_in_dark_frames_is_shared(step):
    """All pixels at one code: light and dark are each anywhere within a step, 1/√12 of it; bright light is not."""
    model = replace(LINEAR, camera=LINEAR.camera.model_copy(update={"code_step_dn": step}))
    still = Frame(np.full((10, 10), BLACK, np.uint16), 12, DARK)
    (level,) = dark_levels([LIGHT], [still], model, DOUBT)
    assert level.u_common == pytest.approx(step * math.sqrt(2.0 / 12.0), rel=0.01)
    (level,) = dark_levels([LIGHT], [still], model, DOUBT, darkest=(1000.0,))
    assert level.u_common == pytest.approx(step * math.sqrt(1.0 / 12.0), rel=0.01)


def test_noise_of_a_pixel_holds_the_rounding_of_padded_codes_once():
    """Steps of 16 DN have a variance of 256/12 DN²; noise that was measured behind a curve holds it already."""
    padded = LINEAR.camera.model_copy(update={"code_step_dn": 16})
    plain = float(LINEAR.variance(100.0, LIGHT))
    assert float(replace(LINEAR, camera=padded).variance(100.0, LIGHT)) == pytest.approx(plain + 255.0 / 12.0)
    measured = replace(LINEAR, noise=replace(LINEAR.noise, post_curve_dn2=50.0))
    expected = pytest.approx(float(measured.variance(100.0, LIGHT)))
    assert float(replace(measured, camera=padded).variance(100.0, LIGHT)) == expected


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.45, 0.5])
def test_what_two_codes_leave_open_is_how_far_their_mean_is_from_midway(share):
    """At most share − ½, by noise less: over √3; light whose noise spreads over the codes adds nothing."""
    two = Frame(np.where(np.arange(100) < 100 * share, 99, 98).reshape(10, 10).astype(np.uint16), 12, DARK)
    (level,) = dark_levels([LIGHT], [two], LINEAR, DOUBT, darkest=(1000.0,))
    assert level.u_common == pytest.approx((0.5 - share) / math.sqrt(3.0), abs=0.02)


def test_long_dark_frames_correct_the_black_level_and_widen_no_stated_one():
    """One at another exposure corrects it; a stated one keeps its u."""
    other = dark_frame(110, 0.2)  # modelled 5 DN: the offset is 5
    (level,) = dark_levels([LIGHT], [other], LINEAR, UNKNOWN_BLACK)
    assert level.signal == pytest.approx(2.5 + 5.0)
    noise = math.sqrt(float(LINEAR.variance(0.0, other.settings)) / 100)
    u = math.hypot(noise, 0.4 * 2.5, WARMTH * 5.0)
    assert (level.u_independent, level.u_common) == (0.0, pytest.approx(u))


@pytest.mark.parametrize("exposure_s", [0.1, 0.4])
def test_a_dark_frame_of_another_exposure_and_a_black_level_are_a_straight_line_over_time(exposure_s):
    """10 DN after 0.2 s, and 0 ± 0.5 at zero, are 20 after 0.4 s; u is extrapolated: −1 of black, 2 of the frame."""
    other, here = dark_frame(110, 0.2), replace(LIGHT, exposure_s=exposure_s)
    (level,) = dark_levels([here], [other], LINEAR, DOUBT)
    share = exposure_s / 0.2
    assert level.signal == pytest.approx(10.0 * share)
    noise = math.sqrt((float(LINEAR.variance(0.0, other.settings)) + (10.0 - 5.0) / 2.0) / 100)
    u = math.hypot(share * noise, (1.0 - share) * 0.5, WARMTH * 10.0 * share)
    assert level.u_common == pytest.approx(u, rel=0.02)


def test_a_long_dark_frame_does_not_widen_a_black_level_that_is_stated():
    """After 30 s 750 DN show the dark current: after 0.1 s it is 2.5 DN, and the black level's ± 0.5 DN remain."""
    stated = replace(LINEAR, camera=LINEAR.camera.model_copy(update={"black_level_dn": BLACK}))
    (level,) = dark_levels([LIGHT], [dark_frame(850, 30.0)], stated, DOUBT)
    assert (level.signal, level.u_common) == (pytest.approx(2.5), pytest.approx(0.5, rel=0.01))
    (unknown,) = dark_levels([LIGHT], [dark_frame(850, 30.0)], LINEAR, UNKNOWN_BLACK)
    assert unknown.u_common > 100.0


def test_dark_frames_of_two_other_exposures_show_black_level_and_dark_current():
    """10 DN after 0.2 s and 14 after 0.4 are 8 after 0.1, whatever the model: 3/2 of one less 1/2 of the other.

    They contradict a black level of 0 ± 0.5 DN, which then takes no part.
    """
    frames = [dark_frame(110, 0.2), dark_frame(114, 0.4)]
    (level,) = dark_levels([LIGHT], frames, LINEAR, DOUBT)
    nearer, farther = (math.sqrt(float(LINEAR.variance(0.0, one.settings)) / 100) for one in frames)
    assert level.signal == pytest.approx(8.0)
    assert level.u_common == pytest.approx(math.hypot(1.5 * nearer, 0.5 * farther, WARMTH * 2.0))


def test_warmer_dark_frames_are_scaled_to_the_light_frame():
    """14 K warmer are two doublings of 7 K: of 4 and 16 DN above a black of 2 a quarter is there in the light frame."""
    frames = [replace(dark_frame(dn, t), settings=replace(dark_frame(dn, t).settings, temperature_c=44.0))
              for dn, t in ((106, 0.1), (118, 0.4))]  # fmt: skip
    (level,) = dark_levels([replace(LIGHT, temperature_c=30.0)], frames, LINEAR, UNKNOWN_BLACK)
    assert level.signal == pytest.approx(2.0 + 4.0 / 4.0)


@quick
@given(st.floats(0.7, 32.0), st.floats(0.01, 1.0), st.floats(0.0, 2.0), st.floats(0.3, 3.0))
def test_irradiance_behind_a_lens(number, transmittance, magnification, pupils):
    """E/L = π·τ/(4·N²·(1 + m/p)²)."""
    lens = LensDescription(
        f_number=5.0, transmittance=transmittance, magnification=magnification, pupil_magnification=pupils
    )
    expected = math.pi * transmittance / (4 * number**2 * (1 + magnification / pupils) ** 2)
    assert lens_factor_sr(lens, number) == pytest.approx(expected)
    assert lens_factor_sr(lens, None) == pytest.approx(expected * number**2 / 25)
    assert lens_factor_sr(LensDescription(), None) == 1.0


@quick
@given(st.integers(0, 639), st.integers(0, 479))
def test_natural_fall_off_is_the_fourth_power_of_the_cosine(x, y):
    """tan α = pitch·distance/focal length, from the middle of the picture."""
    camera = CameraDescription(bit_depth=12, pixel_pitch_um=10.0)
    lens = LensDescription(focal_length_mm=8.0)
    away_mm = 0.010 * math.hypot(x - 319.5, y - 239.5)
    found = float(relative_sensitivity(camera, lens, None, (480, 640), x, y))
    assert found == pytest.approx(math.cos(math.atan(away_mm / 8.0)) ** 4, rel=1e-9)
    shifted = LensDescription(focal_length_mm=8.0, principal_point_px=(float(x), float(y)))
    assert float(relative_sensitivity(camera, shifted, None, (480, 640), x, y)) == 1.0


@pytest.mark.parametrize(("exposure_s", "gain_db"), [(0.01, 0.0), (10.0, 0.0), (10.0, 20.0)])
def test_masked_pixels_are_doubted_by_half_a_number_and_a_tenth_of_the_dark_signal(exposure_s, gain_db):
    """50 e⁻/s over 2 e⁻/DN: 25 DN/s; 0.29 DN (before the gain) and 10 % of it add in squares."""
    settings = FrameSettings(exposure_s, gain_db)
    (level,) = dark_levels([settings], [], LINEAR, BlackLevel(dn=BLACK, u_dn=1.0), masked_dn=[130.0])
    gain = 10.0 ** (gain_db / 20.0)
    assert level.signal == pytest.approx(30.0 / gain)
    assert level.u_common == pytest.approx(math.hypot(0.29 / gain, 0.1 * 25.0 * exposure_s))
    assert (level.u_independent, level.source) == (0.0, "masked pixels")


@pytest.mark.parametrize(
    ("of_frame", "of_lens", "found"), [(2.8, 8.0, 2.8), (None, 8.0, 8.0), (2.8, None, 2.8), (None, None, None)]
)
def test_the_f_number_of_a_frame_goes_before_that_of_the_lens(of_frame, of_lens, found):
    """The camera reports the one in force; the lens's is what the bench states."""
    settings = FrameSettings(0.01, f_number=of_frame)
    assert known_f_number(None, settings, LensDescription(f_number=of_lens)) == found

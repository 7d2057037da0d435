"""Flicker measures compared with waveforms whose values are known by hand, and with published formulas."""

import math

import numpy as np
import pytest
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st
from scipy.signal import bilinear_zpk, butter, find_peaks, freqs, resample, sosfilt, tf2zpk, zpk2sos

import radiometer as rm
from radiometer.analysis.flicker import (
    Waveform,
    measure_flicker,
    read_waveform,
    short_term_severity,
    svm_threshold,
    waveform_of_rows,
)
from radiometer.errors import InputError, MeasurementError, UnsettledError, UsageError

RATE_HZ = 20_000.0


def light_at(rate_hz: float, seconds: float) -> np.ndarray:
    """Return the times of samples in s."""
    return np.arange(round(rate_hz * seconds)) / rate_hz


@pytest.mark.parametrize(("frequency", "depth"), [(100.0, 0.3), (120.0, 0.9), (95.3, 0.05), (440.7, 0.5), (888.8, 0.2)])
def test_a_sinusoid_has_its_depth_its_index_over_pi_and_its_depth_over_the_threshold(frequency, depth):
    """A sinusoid has its depth its index over π and its depth over the threshold."""
    light = 40.0 * (1.0 + depth * np.sin(2.0 * np.pi * frequency * light_at(RATE_HZ, 1.0) + 1.0))
    found = measure_flicker(Waveform(light, RATE_HZ, "sine"))
    assert found.frequency.value == pytest.approx(frequency, rel=3e-5)
    assert found.modulation_depth.value == pytest.approx(depth, rel=0.02)
    assert found.flicker_index.value == pytest.approx(depth / math.pi, rel=0.01)
    threshold = 1.0 / (1.0 + math.exp(-0.00518 * (frequency - 306.6))) + 20.0 * math.exp(-frequency / 10.0)
    assert found.svm.value == pytest.approx(depth / threshold, rel=0.005)


def test_the_clock_and_noise_count_in_their_uncertainty() -> None:
    """In the frequency, or named; a severity holds what noise adds."""
    record = Waveform(1.0 + 0.3 * np.sin(2.0 * np.pi * 100.0 * light_at(RATE_HZ, 1.0)), RATE_HZ, "sine")
    unstated, known = measure_flicker(record), measure_flicker(record, 0.01)
    assert known.frequency.u == pytest.approx(1.0, rel=1e-3)
    assert unstated.frequency.u < 0.01
    assert [any("--u-clock" in line for line in one.assumptions) for one in (unstated, known)] == [True, False]
    assert known.modulation_depth == unstated.modulation_depth
    rng, t, inside = np.random.default_rng(46_004), light_at(2000.0, 1.0), 0
    for _ in range(4):
        light = 1.0 + 0.03 * np.sin(2.0 * np.pi * 20.0 * t)
        found = measure_flicker(Waveform(light + rng.normal(0.0, 0.003, t.size), 2000.0, "noisy"))
        true = short_term_severity(Waveform(light, 2000.0, "light"))
        inside += abs(found.pst_lm.value - true) <= found.coverage_factor * found.pst_lm.u
    assert inside == 4


@pytest.mark.parametrize("duty", [0.2, 0.5, 0.8])
def test_a_rectangle_has_depth_1_and_the_dark_share_of_its_period_as_index(duty):
    """A rectangle has depth 1 and the dark share of its period as index."""
    light = (light_at(100_000.0, 0.5) * 125.0 % 1.0 < duty).astype(float)
    found = measure_flicker(Waveform(light, 100_000.0, "pwm"))
    assert found.modulation_depth.value == pytest.approx(1.0, abs=0.01)
    assert found.flicker_index.value == pytest.approx(1.0 - duty, abs=0.01)
    harmonics = np.arange(1, 17)  # of 125 Hz up to 2 kHz
    amplitudes = 2.0 * np.abs(np.sinc(harmonics * duty))
    by_hand = np.sum((amplitudes / svm_threshold(125.0 * harmonics)) ** 3.7) ** (1.0 / 3.7)
    assert found.svm.value == pytest.approx(by_hand, rel=0.01)


@pytest.mark.parametrize(("frequency", "depth"), [(15.0, 0.01), (20.0, 0.02), (30.0, 0.05)])
def test_the_severity_of_a_sinusoid_is_the_gain_of_its_filters(frequency, depth):
    """The severity of a sinusoid is the gain of its filters."""
    # A sensation that hardly moves exceeds all percentiles alike: Pst = √(Σ weights · P).
    at = [2.0 * np.pi * frequency]
    eye = freqs([0.041661, 44.758, 2715.6, 29839.0, 0.0], [1.0, 196.32, 11781.0, 534820.0, 3505380.0], at)[1][0]
    low = freqs(*butter(6, 2.0 * np.pi * 35.0, "low", analog=True), at)[1][0]
    sensation = 1.101603155420234e6 * abs(eye * low) ** 2 * depth**2 / 2.0
    by_hand = math.sqrt((0.0314 + 0.0525 + 0.0657 + 0.28 + 0.08) * sensation)
    light = 1.0 + depth * np.sin(2.0 * np.pi * frequency * light_at(4000.0, 90.0))
    assert short_term_severity(Waveform(light, 4000.0, "sine")) == pytest.approx(by_hand, rel=0.01)


def test_measures_hold_their_standards_and_do_not_hang_on_the_level():
    """1 % each half second is just irritating; brighter light is no worse; noise alone is none."""
    # Rectangular changes at 1 Hz: the severity is 1 at 1.0 % peak (IEC TR 61547-1, the eye without the lamp).
    light = 1.0 + 0.01 * np.sign(np.sin(2.0 * np.pi * light_at(4000.0, 120.0) + 0.1))
    assert short_term_severity(Waveform(light, 4000.0, "steps")) == pytest.approx(1.0, abs=0.01)
    light = (light_at(3000.0, 1.0) * 101.3 % 1.0 < 0.3) + 0.5 + np.random.default_rng(1).normal(0.0, 0.01, 3000)
    one, brighter = (measure_flicker(Waveform(factor * light, 3000.0, "pwm")) for factor in (1.0, 4.0))
    for name in ("modulation_depth", "flicker_index", "frequency"):
        expected, found = getattr(one, name), getattr(brighter, name)
        assert (found.value, found.u) == pytest.approx((expected.value, expected.u)), name
    found = measure_flicker(Waveform(1.0 + np.random.default_rng(11).normal(0, 0.02, 9000), 1000.0, "noise"))
    assert found.modulation_depth.value <= 2.0 * found.modulation_depth.u < 0.1


def test_short_and_slow_records_say_what_they_lack():
    """A short record counts as repeated; slow samples warn of faster light."""
    light = 1.0 + 0.02 * np.sin(2.0 * np.pi * 20.0 * light_at(10_000.0, 0.43))
    short = measure_flicker(Waveform(light, 10_000.0, "short"))
    long = 1.0 + 0.02 * np.sin(2.0 * np.pi * 20.0 * light_at(10_000.0, 90.0))
    assert short.pst_lm.value == pytest.approx(short_term_severity(Waveform(long, 10_000.0, "long")), rel=0.005)
    assert [line for line in short.assumptions if line.startswith("PstLM")]
    time_s = np.arange(900) / 90.0
    found = measure_flicker(Waveform(1.0 + 0.3 * np.sin(2 * np.pi * 100 * time_s), 90.0, "slow"))
    assert found.frequency.value == pytest.approx(10.0, abs=0.01)
    assert any("above 45 Hz" in line for line in found.warnings)


@pytest.mark.parametrize(
    ("frequency", "duty"), [(100.0, 0.23), (400.0, 0.27), (500.0, 0.3), (800.0, 0.5), (1000.0, 0.5), (120.0, 0.1)]
)
def test_the_svm_of_pulses_holds_edges_between_two_samples(frequency: float, duty: float) -> None:
    """Mains and drivers divide the rate of 4 kHz: every period is sampled alike, and edges show at no finer step."""
    rng, order = np.random.default_rng(46_005), np.arange(1, int(2000.0 / frequency) + 1)
    light = ((light_at(4000.0, 2.0) * frequency + 0.0712) % 1.0 < duty) + rng.normal(0.0, 5e-4, 8000)
    amplitude = 2.0 * np.abs(np.sin(np.pi * order * duty)) / (np.pi * order) / duty
    true = np.sum((amplitude / svm_threshold(order * frequency)) ** 3.7) ** (1.0 / 3.7)
    found = measure_flicker(Waveform(light, 4000.0, "pulses")).svm
    assert abs(found.value - true) <= 2.0 * found.u < 0.5 * true


def test_the_uncertainty_holds_for_noisy_records():
    """The uncertainty holds for noisy records."""
    rng = np.random.default_rng(46_001)
    t = light_at(RATE_HZ, 0.1)
    inside = {"modulation_depth": 0, "flicker_index": 0, "svm": 0, "frequency": 0}
    for _ in range(20):
        depth, frequency = rng.uniform(0.1, 0.6), rng.uniform(95.0, 130.0)
        light = 1.0 + depth * np.sin(2.0 * np.pi * frequency * t + rng.uniform(0, 6)) + rng.normal(0, 0.02, t.size)
        found = measure_flicker(Waveform(light, RATE_HZ, "noisy"))
        truth = {
            "modulation_depth": depth,
            "flicker_index": depth / math.pi,
            "svm": depth / float(svm_threshold(np.array(frequency))),
            "frequency": frequency,
        }
        for name, value in truth.items():
            one = getattr(found, name)
            inside[name] += abs(one.value - value) <= 2.0 * one.u
    assert min(inside.values()) >= 18, inside  # of half the u a third would be outside


@pytest.mark.parametrize("rate_hz", [2000.0, 20_000.0])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_the_uncertainty_holds_for_a_cusp(rate_hz: float, noise: float) -> None:
    """A rectified sinusoid of eight periods: no finite series has the depth of its cusps, nor a sample between them."""
    rng, inside = np.random.default_rng(46_003), 0
    for _ in range(8):
        frequency, low, phase = rng.uniform(95.0, 125.0), rng.uniform(0.0, 0.5), rng.uniform()
        cycles = frequency * light_at(rate_hz, 8.0 / frequency) + phase
        light = low + (1.0 - low) * np.abs(np.sin(np.pi * cycles)) + rng.normal(0.0, noise, cycles.size)
        measures = measure_flicker(Waveform(light, rate_hz, "rectified"))
        found, k = measures.modulation_depth, measures.coverage_factor
        inside += abs(found.value - (1.0 - low) / (1.0 + low)) <= k * found.u < 0.5 * found.value
    assert inside >= 7


NO_SHRINKING = (Phase.explicit, Phase.reuse, Phase.generate)  # a failing draw is as telling as a smaller one


@settings(max_examples=25, deadline=None, phases=NO_SHRINKING)
@given(st.floats(5.0, 40.0), st.floats(6.0, 40.0), st.floats(0.02, 1.0), st.floats(0.0, 1.0))
def test_coarse_samples_of_a_sinusoid_show_its_extremes_and_its_area(samples, periods, depth, phase):
    """Between the samples as well: a sinusoid has one amplitude, whatever its phases."""
    size = max(32, int(samples * periods))
    light = 1.0 + depth * np.sin(2.0 * np.pi * (np.arange(size) / samples + phase))
    found = measure_flicker(Waveform(light, 10.0 * samples, "coarse"))
    for one, truth in ((found.modulation_depth, depth), (found.flicker_index, depth / math.pi)):
        assert abs(one.value - truth) <= 2.0 * one.u
        assert one.u < 0.001 * depth


@settings(max_examples=25, deadline=None, phases=NO_SHRINKING)
@given(st.floats(5.0, 100.0), st.floats(0.1, 0.9), st.floats(0.05, 1.0), st.floats(0.0, 1.0), st.booleans())
def test_coarse_samples_of_a_rectangle_do_not_ring(samples, duty, depth, phase, whole):
    """A Fourier series of a step overshoots by 9 %; the levels themselves are what was sampled."""
    samples = float(round(samples)) if whole else samples
    assume(1.2 / samples < duty < 1.0 - 1.2 / samples)  # a pulse between two samples is not seen
    edges = np.array([-phase, duty - phase]) * samples
    assume(np.all(np.abs(edges - np.round(edges)) > 1e-6))  # on a sample rounding decides where the edge is
    low = (1.0 - depth) / (1.0 + depth)
    at = (np.arange(int(40 * samples)) / samples + phase) % 1.0
    found = measure_flicker(Waveform(np.where(at < duty, 1.0, low), 10.0 * samples, "pwm"))
    mean = duty + (1.0 - duty) * low
    assert abs(found.modulation_depth.value - depth) <= 2.0 * found.modulation_depth.u + 1e-12
    # Each edge is anywhere between two samples: two rectangular distributions end √6 u away, and the period that was
    # found moves them by a little more.
    assert abs(found.flicker_index.value - duty * (1.0 - mean) / mean) <= 2.7 * found.flicker_index.u


@pytest.mark.parametrize("second_hz", [130.0, 137.3, 218.0])
def test_light_of_two_frequencies_has_the_extremes_of_the_record(second_hz):
    """The mean of the periods of one frequency would hide the other."""
    t = light_at(3000.0, 2.0)
    fine = light_at(300_000.0, 2.0)
    light, truth = (
        1.0 + 0.3 * np.sin(2.0 * np.pi * 100.0 * at) + 0.15 * np.sin(2.0 * np.pi * second_hz * at) for at in (t, fine)
    )
    found = measure_flicker(Waveform(light, 3000.0, "two"))
    depth = float((truth.max() - truth.min()) / (truth.max() + truth.min()))
    assert abs(found.modulation_depth.value - depth) <= 2.0 * found.modulation_depth.u < 0.05
    assert any(f"{second_hz:.3g}" in line for line in (*found.warnings, *found.assumptions))


def test_tables_and_rows_are_corrected_for_their_exposure(tmp_path):
    """Each sample by its own; a known frequency gives the row time."""
    t = light_at(1700.0, 1.0)
    light = 1.0 + 0.4 * np.sinc(0.2) * np.sin(2.0 * np.pi * 100.0 * t)
    np.savetxt(tmp_path / "lamp.csv", np.transpose([t, light]), "%.9f", ",", header="time_s,light", comments="")
    found = rm.flicker(tmp_path / "lamp.csv", exposure=2e-3).measures
    assert found.modulation_depth.value == pytest.approx(0.4, abs=2e-6)
    cv2 = pytest.importorskip("cv2")
    cv2.imwrite(str(tmp_path / "frame.tif"), rolling_frame(480.0, 20e-6, 200e-6).round().astype(np.uint16))
    found = rm.flicker(tmp_path / "frame.tif", known_frequency=480.0, exposure=200e-6, black_level=64.0)
    assert found.row_time.value == pytest.approx(20e-6, rel=2e-3)
    with pytest.raises(UsageError, match="--black-level"):
        rm.flicker(tmp_path / "frame.tif", row_time=20e-6, exposure=200e-6)


@pytest.mark.parametrize(("exposure_s", "hidden"), [(0.0049, True), (0.002, False)])
def test_a_harmonic_that_the_exposure_hides_leaves_lower_bounds(exposure_s, hidden):
    """100 and 200 Hz; 4.9 ms are nearly a period of the second, of which 2 % is left: nothing counts as corrected."""
    phase = 2.0 * np.pi * light_at(RATE_HZ, 1.0)
    parts = [depth * np.sinc(hz * exposure_s) * np.sin(hz * phase) for hz, depth in ((100.0, 0.3), (200.0, 0.2))]
    found = measure_flicker(Waveform(1.0 + sum(parts), RATE_HZ, "table", 0.0, exposure_s))
    truth = float(np.ptp(0.3 * np.sin(100.0 * phase) + 0.2 * np.sin(200.0 * phase))) / 2.0
    assert any("SVM are lower bounds" in line for line in found.warnings) is hidden
    assert (found.modulation_depth.value < 0.9 * truth) is hidden
    assert hidden or found.modulation_depth.value == pytest.approx(truth, rel=1e-3)


@pytest.mark.parametrize("exposure_s", [2e-4, 6e-4])
@pytest.mark.parametrize(
    "levels",
    [np.repeat([1.4, 0.6], 100), np.repeat([1.0, 0.2, 1.0, 0.2], [30, 30, 60, 80]), 0.3 + np.arange(200) / 200],
)
def test_edges_that_an_exposure_averages_are_corrected_in_the_flicker_index(levels, exposure_s):
    """Halves, two pulses and a sawtooth of 4 ms: edges lose area, which is given back; a sawtooth loses depth."""
    at, window = np.arange(6000) * 1.0137, 50_000.0 * exposure_s
    sums = np.concatenate([[0.0], np.cumsum(np.tile(levels, 32))])
    ends, starts = (np.interp(one, np.arange(sums.size), sums) for one in (at + window, at))
    light = (ends - starts) / window + np.random.default_rng(3).normal(0.0, 0.01, at.size)
    found = measure_flicker(Waveform(light, 50_000.0 / 1.0137, "rows", 0.0, exposure_s))
    mean = levels.mean()
    truth = np.ptp(levels) / (levels.max() + levels.min()), np.maximum(levels - mean, 0.0).mean() / mean
    for one, true in zip((found.modulation_depth, found.flicker_index), truth, strict=True):
        assert abs(one.value - true) <= found.coverage_factor * one.u < 0.4 * true
    assert any("modulation depth" in line and "lower bound" in line for line in found.warnings)


def test_darkness_scales_every_modulation_and_counts_in_u():
    """Darkness scales every modulation and counts in u."""
    light = 1.0 + 0.3 * np.sin(2.0 * np.pi * 100.0 * light_at(RATE_HZ, 0.5))
    bare = measure_flicker(Waveform(light, RATE_HZ, "lamp"))
    lifted = measure_flicker(Waveform(light + 0.5, RATE_HZ, "lamp", u_dark=0.03))
    assert lifted.modulation_depth.value == pytest.approx(bare.modulation_depth.value / 1.5, rel=1e-6)
    assert lifted.modulation_depth.u == pytest.approx(lifted.modulation_depth.value * 0.03 / 1.5, rel=0.01)
    for mean in (-1.0, 0.0, 1e-16, 1e-3):
        with pytest.raises(MeasurementError, match=r"AC coupling.*--dark"):
            measure_flicker(Waveform(light - 1.0 + mean, RATE_HZ, "lamp"))


def test_what_a_record_cannot_give_is_not_determined():
    """What a record cannot give is not determined."""
    slow = measure_flicker(Waveform(1.0 + 0.1 * np.sin(np.arange(1000.0)), 1000.0, "slow"))
    assert slow.svm is None
    assert slow.pst_lm is None
    noise = measure_flicker(Waveform(1.0 + np.random.default_rng(7).normal(0, 0.01, 9000), 9000.0, "noise"))
    assert noise.frequency is None
    assert noise.pst_lm is None
    assert noise.svm is None
    assert any("SVM is not determined: no repetition" in warning for warning in noise.warnings)
    assert noise.periods == 0


def rolling_frame(frequency: float, row_time_s: float, exposure_s: float, depth: float = 0.4) -> np.ndarray:
    """Return digital numbers of an even field under a sinusoid, with a fall-off and noise."""
    start_s = np.arange(900)[:, None] * row_time_s
    kept = np.sinc(frequency * exposure_s)
    light = 1.0 + depth * kept * np.sin(2.0 * np.pi * frequency * (start_s + exposure_s / 2.0))
    fall_off = 1.0 - 0.2 * np.linspace(-1.0, 1.0, 900)[:, None] ** 2
    return 64.0 + 2000.0 * fall_off * light + np.random.default_rng(3).normal(0.0, 10.0, (900, 200))


def test_the_rows_of_a_rolling_shutter_give_the_waveform_and_its_exposure_is_corrected_in_svm():
    """The rows of a rolling shutter give the waveform and its exposure is corrected in SVM."""
    frame = rolling_frame(480.0, 20e-6, 400e-6)
    flat = rolling_frame(480.0, 20e-6, 400e-6, depth=0.0)
    found = measure_flicker(waveform_of_rows(frame, 20e-6, 400e-6, "frame", 64.0, flat))
    assert abs(found.frequency.value - 480.0) < 3.0 * found.frequency.u + 0.5
    assert found.svm.value == pytest.approx(0.4 / float(svm_threshold(np.array(480.0))), rel=0.02)
    assert found.modulation_depth.value == pytest.approx(0.4, rel=0.01)
    assert any("corrected" in line for line in found.warnings)


@pytest.mark.parametrize(
    ("text", "error", "why"),
    [
        ("time,light\n" + "".join(f"{n},1\n" for n in range(40)), UnsettledError, "time"),
        ("time_s,a,b\n" + "".join(f"{n},1,2\n" for n in range(40)), InputError, "--map"),
        ("time_s,light\n" + "".join(f"{n**2},1\n" for n in range(40)), InputError, "equal steps"),
        ("time_s,light\n" + "".join(f"{-n},1\n" for n in range(40)), InputError, "rise"),
        ("time_us,light\n" + "".join(f"{50 * n + 20 * (-1) ** n},1\n" for n in range(400)), InputError, "equal steps"),
        (
            "time_s,light\n" + "".join(f"{5e-5 * n + 2e-5 * (n % 3):.6e},1\n" for n in range(400)),
            InputError,
            "equal steps",
        ),
        ("time_s,light\n0,1\n1,1\n", InputError, "samples"),
        ("time_s,light\n" + "0,1\n1,one\n" * 40, InputError, "no number"),
    ],
)
def test_a_table_that_holds_no_waveform_is_refused(tmp_path, text, error, why):
    """A table that holds no waveform is refused."""
    (tmp_path / "lamp.csv").write_text(text)
    with pytest.raises(error, match=why):
        read_waveform(tmp_path / "lamp.csv")


@pytest.mark.parametrize(("heading", "step"), [("t/ms", 0.05), ("time (us)", 50.0), ("Zeit_s", 5e-5)])
def test_the_unit_of_time_comes_from_the_heading(tmp_path, heading, step):
    """The unit of time comes from the heading."""
    rows = "".join(f"{n * step:.6g};{1.0 + 0.1 * math.sin(0.2 * n):.5f}\n" for n in range(400))
    (tmp_path / "lamp.csv").write_text(f"{heading};CH1 (V)\n{rows}")
    mapped = ("timestamp=Zeit_s:s",) if heading.startswith("Zeit") else ()
    found = rm.flicker(tmp_path / "lamp.csv", mapped=mapped)
    assert found.waveform.rate_hz == pytest.approx(20_000.0, rel=1e-4)


@pytest.mark.parametrize("form", ["{:.6f}", "{:.5e}", "{!r}"])
def test_decimals_of_a_table_move_its_times_and_are_no_jitter(tmp_path, form):
    """Steps of 62.5 us in whole us, in six digits and in all of a double: 16 kHz each time."""
    rows = "".join(f"{form.format(0.3 + 62.5e-6 * n)},{1.0 + 0.1 * math.sin(0.2 * n):.5f}\n" for n in range(400))
    (tmp_path / "lamp.csv").write_text(f"time_s,light\n{rows}")
    assert read_waveform(tmp_path / "lamp.csv")[0].rate_hz == pytest.approx(16_000.0, rel=1e-3)


LAMPS = ("CFL", "Feit_60W", "IKEA_Lunnom", "Hue_Color_Evening")


def windowed_svm(light: np.ndarray, rate_hz: float) -> float:
    """Return SVM from the peaks of a Hann-windowed spectrum, 1 Hz apart or more, as CIE TN 006 describes it."""
    window = np.hanning(light.size)
    amplitude = 2.0 * np.abs(np.fft.rfft(window * light / light.mean())) / window.sum()
    hz = np.fft.rfftfreq(light.size, 1.0 / rate_hz)
    band = (hz >= 80.0) & (hz <= 2000.0)
    peaks = find_peaks(amplitude[band], distance=max(1, round(light.size / rate_hz)))[0]
    seen = amplitude[band][peaks] / svm_threshold(hz[band][peaks])
    return float(np.sum(seen**3.7) ** (1.0 / 3.7))


def severity_in_time(once: np.ndarray, rate_hz: float) -> float:
    """Return PstLM of a repeated record by digital filters of 20 kHz, behind their transient."""
    seconds = once.size / rate_hz
    light = np.tile(resample(once, max(2, round(seconds * 20_000.0))), math.ceil(30.0 / seconds))
    fs = light.size / (seconds * math.ceil(30.0 / seconds))
    eye = tf2zpk([0.041661, 44.758, 2715.6, 29839.0, 0.0], [1.0, 196.32, 11781.0, 534820.0, 3505380.0])
    seen = light / light.mean() - 1.0
    for filtered in (butter(1, 0.05, "high", fs=fs, output="sos"), butter(6, 35.0, fs=fs, output="sos"),
                     zpk2sos(*bilinear_zpk(*eye, fs))):  # fmt: skip
        seen = sosfilt(filtered, seen)
    smooth = butter(1, 1.0 / (0.6 * np.pi), fs=fs, output="sos")
    felt = 1.101603155420234e6 * sosfilt(smooth, seen**2)[round(25.0 * fs) :]
    shares = ((0.0314, [0.1]), (0.0525, [0.7, 1, 1.5]), (0.0657, [2.2, 3, 4]), (0.28, [6, 8, 10, 13, 17]),
              (0.08, [30, 50, 80]))  # fmt: skip
    return math.sqrt(sum(weight * np.percentile(felt, 100.0 - np.array(at)).mean() for weight, at in shares))


@pytest.mark.parametrize("lamp", LAMPS)
def test_measured_lamps_agree_with_other_meters(shared_data, lamp):
    """SVM and PstLM are within 1 % of those by a window, and by filters in time, of the repeated whole periods."""
    found = rm.flicker(shared_data / "lamps" / f"{lamp}.csv")
    frequency, waveform = found.measures.frequency, found.waveform
    assert frequency.value == pytest.approx(1000.0 if "Hue" in lamp else 120.0, rel=0.006)
    periods = math.floor(waveform.duration_s * frequency.value)
    once = waveform.light[: round(periods / frequency.value * waveform.rate_hz)]
    repeated = np.tile(once, math.ceil(2.0 * waveform.rate_hz / once.size))
    assert found.measures.svm.value == pytest.approx(windowed_svm(repeated, waveform.rate_hz), rel=0.01)
    severity = severity_in_time(once, waveform.rate_hz)
    assert found.measures.pst_lm.value == pytest.approx(severity, rel=0.01, abs=1e-5)


@given(
    step=st.sampled_from([0.2, 0.1, 0.05, 0.02, 1 / 128]),
    depth=st.floats(0.25, 0.9),
    phase=st.floats(0.0, 6.28),
    offset=st.floats(0.0, 1.0),
)
@settings(max_examples=5, deadline=None, phases=NO_SHRINKING)
def test_light_that_is_rounded_to_steps_holds_the_rounding_in_u(step, depth, phase, offset):
    """A sinusoid of 100 Hz in few codes, alike in every period: depth, index 1/π of it and SVM are within 3 u."""
    assume(depth > 2.0 * step)  # five codes or more
    time_s = np.arange(4000) / 8000
    light = 1.0 + depth * np.sin(2 * np.pi * 100 * time_s + phase)
    found = measure_flicker(Waveform((np.round(light / step + offset) - offset) * step, 8000.0, "rounded"))
    svm = depth / float(svm_threshold(np.array(100.0)))
    for measured, true in ((found.modulation_depth, depth), (found.flicker_index, depth / np.pi), (found.svm, svm)):
        assert measured.value == pytest.approx(true, abs=3.0 * measured.u + 1e-4 * true)


@pytest.mark.parametrize("noise_rel", [0.0, 1e-3, 1e-2])
def test_severity_covers_noise_that_is_not_of_the_light(noise_rel):
    """A camera's noise is squared with the light: 100 Hz at 30 % has a PstLM of 0.023, and u reaches down to that."""
    time_s, rng = np.arange(5000) / 5000.0, np.random.default_rng(47_002)
    light = 1.0 + 0.3 * np.sin(2 * np.pi * 100.0 * time_s)
    truth = measure_flicker(Waveform(light, 5000.0, "clean")).pst_lm
    found = measure_flicker(Waveform(light + rng.normal(0.0, noise_rel, light.size), 5000.0, "noisy"))
    assert abs(found.pst_lm.value - truth.value) <= 2.0 * found.pst_lm.u + 1e-4
    assert found.pst_lm.u < 0.7 * found.pst_lm.value
    assert any("noise of the record" in one for one in found.warnings) == (noise_rel > 0.0)

"""Readings of a patch: lens, scaling, order, clipping, copies, and each line of the budget by known values."""

import datetime as dt
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import radiometer as rm
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.reading import patch_situation, read_patch
from radiometer.analysis.signal.model import crop_frames, signal_model
from radiometer.analysis.signal.situation import situation_of
from radiometer.data import (
    BlackLevel,
    Bracket,
    CameraDescription,
    Flag,
    FlatField,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    ResponseCurve,
    SensorNoise,
    SpectralResponse,
    StatedUncertainties,
)
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError, InputError, MeasurementError

# What a test of the noise alone leaves out: everything outside the model.
EXACT = StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0))

EXACT_BLACK = BlackLevel(dn=64.0, u_dn=0.0, dark_u_rel=0.0)


def uniform(radiance: float, size: int = 12) -> np.ndarray:
    return np.full((size, size), radiance)


def line(reading, name):
    return next(one for one in reading.budget if one.name == name)


def u_rel_of(reading, name):
    return line(reading, name).u_rel


def read(rig, frames, calibration, patch=None, **options):
    size = frames[0].shape[0]
    setup = {name: options.pop(name) for name in ("source", "spectrum") if name in options}
    return read_patch(
        Bracket.from_frames(frames),
        patch or Patch(1, 1, size - 2, size - 2),
        Setup(rig.description, rig.lens, calibration, **setup),
        **options,
    )


@pytest.mark.slow
def test_weights_do_not_bias_a_dim_patch(rig):
    """At 20 electrons per pixel the mean of many readings meets the truth within 4 sigma of that mean.

    Weights from the noisy samples would read some 5 % too low here.
    """
    exposures = (1e-3, 2e-3, 4e-3)
    truth = 20.0 / float(rig.electrons_per_s(1.0)) / 4e-3
    rng = np.random.default_rng(5)
    calibration = rig.calibration(uncertainties=EXACT, black_level=EXACT_BLACK)
    values = [
        read(rig, rig.frames(uniform(truth, 4), rng, exposures), calibration, Patch(0, 0, 4, 4)).radiance.value
        for _ in range(400)
    ]
    assert abs(np.mean(values) - truth) < 4.0 * np.std(values) / math.sqrt(400)
    assert np.std(values) / math.sqrt(400) < 0.005 * truth


def test_a_dark_patch_gives_a_value_its_uncertainty_and_the_flag(rig):
    """No light: a finite value within 4 u of zero, flagged, at any sign."""
    rng = np.random.default_rng(2)
    result = read(rig, rig.frames(uniform(0.0), rng, (1e-3, 1e-2)), rig.calibration())
    assert Flag.BELOW_NOISE in result.flags
    assert abs(result.radiance.value) < 4.0 * result.radiance.u
    assert math.isfinite(result.expanded_u_rel)


def test_without_a_calibration_values_are_relative_and_flagged(rig):
    """DN above black per second, and no unit of radiance."""
    truth = 0.5 * rig.radiance_of_full_scale(1e-3)
    result = read(rig, rig.frames(uniform(truth), np.random.default_rng(1), (1e-3,)), None)
    assert result.flags == (Flag.UNCALIBRATED,)
    assert result.radiance.unit == "relative"
    expected = 0.5 * (4095 - 64) / 1e-3
    assert abs(result.radiance.value - expected) < 4.0 * result.radiance.u


def test_a_steady_source_is_not_called_flickering(rig):
    """Under noise alone none of 50 brackets is flagged: the evidence asked for is five sigma."""
    truth = 0.5 * rig.radiance_of_full_scale(1e-3)
    for seed in range(50):
        frames = rig.frames(uniform(truth), np.random.default_rng(seed), (1e-3, 5e-4, 2.5e-4))
        assert Flag.FLICKER not in read(rig, frames, rig.calibration()).flags


def test_a_response_curve_replaces_the_straight_line(rig):
    """A camera that squares its signal is read right through its curve, and wrong without it."""
    dn = np.arange(4096.0)
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(
            np.log(np.sqrt(np.maximum(dn - 64, 0) * 4031)), np.zeros(4096), absolute=True, valid_dn=(65, 4094)
        )
    linear = rig.calibration(uncertainties=EXACT)
    bent = replace(linear, response=curve, black_level=BlackLevel(dn=64.0))
    truth = 0.6 * rig.radiance_of_full_scale(1e-3)
    frames = []
    for frame in rig.frames(uniform(truth), np.random.default_rng(1), (1e-3, 5e-4, 2.5e-4)):
        squared = np.rint(np.maximum(frame.dn - 64.0, 0) ** 2 / 4031 + 64).astype(np.uint16)
        frames.append(type(frame)(squared, 12, frame.settings))
    assert read(rig, frames, bent).radiance.value == pytest.approx(truth, rel=0.005)
    assert abs(read(rig, frames, linear).radiance.value / truth - 1) > 0.1


def curved(rig, valid_dn, u_log=0.001):
    """Return an exact calibration with a curve H = M − 64 that is known to u_log where it has data."""
    with np.errstate(divide="ignore"):
        g = np.log(np.maximum(np.arange(4096.0) - 64.0, 0.0))
    return exact(rig, response=ResponseCurve(g, np.full(4096, u_log), absolute=True, valid_dn=valid_dn))


def test_a_curve_does_not_brighten_a_dark_patch(rig):
    """Through a logarithmic curve a patch without light still averages to zero: below black it goes on as a line."""
    frames = rig.frames(uniform(0.0, 40), np.random.default_rng(1), (1e-3, 1e-2))
    result = read(rig, frames, curved(rig, (70, 4090)))
    assert abs(result.radiance.value) < 4.0 * result.radiance.u
    assert Flag.EXTRAPOLATED in result.flags


def test_beyond_the_curve_s_data_is_extrapolated_and_not_called_saturated(rig):
    """The only frame lies above the curve's highest supported number, yet below clipping."""
    known, truth = curved(rig, (70, 1000)), 0.5 * rig.radiance_of_full_scale(1e-3)
    frames = rig.frames(uniform(truth), np.random.default_rng(1), (1e-3,) * 5)
    result = read(rig, frames, known)
    assert result.flags == (Flag.EXTRAPOLATED,)
    assert result.radiance.value == pytest.approx(truth, rel=0.005)
    shorter = rig.frames(uniform(truth), np.random.default_rng(1), (2e-4, 1e-3))
    assert read(rig, shorter, known).exposures_s == (2e-4,)


def test_a_flat_field_is_divided_out(rig):
    """A corner patch at 80 % sensitivity is read as bright as it is."""
    flat = FlatField(
        principal_point_px=(0.0, 0.0), radius_px=10.0, coefficients=(-0.2, 0.0, 0.0), shape=(12, 12), u_rel=0.003
    )
    truth = 0.5 * rig.radiance_of_full_scale(1e-3)
    y, x = np.mgrid[:12, :12]
    scene = truth * (1 - 0.2 * (x**2 + y**2) / 100.0)
    result = read(
        rig, rig.frames(scene, np.random.default_rng(1), (1e-3,)), rig.calibration(flat_field=flat), Patch(6, 6, 2, 2)
    )
    assert abs(result.radiance.value - truth) < 4.0 * result.radiance.u
    assert u_rel_of(result, "flat field") == pytest.approx(0.003)


def test_what_a_reading_cannot_be_made_of_is_refused(rig):
    """A patch beyond the frame, with its size; no light; the calibration of a camera of another serial number."""
    rng = np.random.default_rng(1)
    frames, dark = [rig.frame(uniform(1.0), 1e-3, rng)], [rig.frame(uniform(0.0), 1e-3, rng, shutter="closed")]
    setup, other = Setup(rig.description, rig.lens), rig.description.model_copy(update={"serial": "2"})
    with pytest.raises(MeasurementError, match="12 × 12"):
        read_patch(frames, Patch(10, 10, 5, 5), setup)
    with pytest.raises(MeasurementError, match="shutter open"):
        read_patch(dark, Patch(0, 0, 2, 2), setup)
    with pytest.raises(CalibrationError, match="serial"):
        read_patch(frames, Patch(0, 0, 2, 2), Setup(other, rig.lens, rig.calibration()))


def silicon(**changes):
    """Return a response that rises with wavelength, as a photon counter's."""
    return SpectralResponse(wavelength_nm=(300.0, 1100.0), relative=(300.0, 1100.0), **changes)


def of_spectra(calibration, of_scale, of_source, response):
    scale = calibration.scale.model_copy(update={"spectrum": of_scale})
    return replace(calibration, scale=scale, spectrum=of_source, spectral_response=response)


def test_another_spectrum_is_corrected_by_the_camera_s_response(rig):
    """Calibrated at 500 nm and read at 600 nm, where the camera sees 1.2 times as much: the reading is 1/1.2."""
    frames = rig.frames(uniform(0.5 * rig.radiance_of_full_scale(1e-3)), np.random.default_rng(1), (1e-3,))
    plain = read(rig, frames, of_spectra(rig.calibration(), "line:600", "line:600", silicon()))
    moved = read(rig, frames, of_spectra(rig.calibration(), "line:500", "line:600", silicon(u_rel=0.03)))
    assert moved.radiance.value / plain.radiance.value == pytest.approx(1 / 1.2, rel=1e-9)
    assert u_rel_of(moved, "spectral assumption") == pytest.approx(0.03)
    assert any("mismatch factor" in text for text in moved.provenance.assumptions)


@pytest.mark.parametrize(("last_nm", "refused"), [(700.0, True), (780.0, False)])
def test_light_beyond_the_table_of_a_response_is_not_invisible(rig, last_nm, refused):
    """A flat camera needs no correction; of a lamp of 2856 K a third of the visible band's power is beyond 700 nm."""
    frames = rig.frames(uniform(0.5 * rig.radiance_of_full_scale(1e-3)), np.random.default_rng(1), (1e-3,))
    flat = SpectralResponse(wavelength_nm=(380.0, last_nm), relative=(1.0, 1.0))
    lamp = of_spectra(rig.calibration(), "cie_d65", "planck:2856", flat)
    if refused:
        with pytest.raises(InputError, match="extend the table"):
            read(rig, frames, lamp)
    else:
        plain = read(rig, frames, of_spectra(rig.calibration(), "cie_d65", "cie_d65", flat))
        assert read(rig, frames, lamp).radiance.value == pytest.approx(plain.radiance.value, rel=1e-6)


@pytest.mark.parametrize("nm", [840, 940, 1200])
def test_near_infrared_reads_as_radiance_without_a_luminance(rig, nm):
    """Radiance needs no V(λ): the same frames give the same W·sr⁻¹·m⁻² as under a green line, and no luminance."""
    frames = rig.frames(uniform(2.0), np.random.default_rng(8), (1e-3, 2e-3))
    green, infrared = (read(rig, frames, rig.calibration(), spectrum=name) for name in ("line:555", f"line:{nm}"))
    assert infrared.radiance == green.radiance
    assert infrared.luminance is None
    assert green.luminance is not None
    assert green.luminance.value == pytest.approx(683 * green.radiance.value, rel=1e-3)


@pytest.mark.parametrize(("curve_u", "flickers"), [(1e-4, True), (0.04, False)])
def test_what_the_curve_explains_is_no_flicker(rig, curve_u, flickers):
    """Frames at two levels that differ by 4 %: the source's doing only where the curve is known better."""
    calibration = curved(rig, (65, 4094), curve_u)
    truth, rng = 0.5 * rig.radiance_of_full_scale(1e-3), np.random.default_rng(1)
    frames = [rig.frame(uniform(truth * more), seconds, rng) for more, seconds in ((1.0, 1e-3), (1.04, 3e-4))]
    assert (Flag.FLICKER in read(rig, frames, calibration).flags) is flickers


PATCH = Patch(1, 1, 10, 10)


@pytest.fixture
def seen(rig):
    """Return frames of a radiance, and that radiance."""
    truth = 0.5 * rig.radiance_of_full_scale(1e-3)
    return Bracket.from_frames(rig.frames(np.full((12, 12), truth), np.random.default_rng(3), (1e-3,) * 3)), truth


def without_f_number(bracket):
    return Bracket.from_frames(Frame(f.dn, 12, replace(f.settings, f_number=None)) for f in bracket.light)


def lensed(rig, **lens):
    """Return a calibration made through a lens, and that lens."""
    made = LensDescription(focal_length_mm=16.0, f_number=4.0, **lens)
    return replace(rig.calibration(), lens=made)


def test_a_lens_that_states_its_f_number_speaks_for_frames_that_do_not(rig, seen):
    """At f/8 behind a calibration at f/4 the same frames mean four times the radiance."""
    frames, truth = without_f_number(seen[0]), seen[1]
    found = read_patch(frames, PATCH, Setup(rig.description, LensDescription(f_number=8.0), rig.calibration()))
    assert found.radiance.value == pytest.approx(4.0 * truth, rel=5e-3)


def test_relative_values_need_no_f_number(rig, seen):
    """Without a scale nothing rests on it."""
    found = read_patch(without_f_number(seen[0]), PATCH, Setup(rig.description, LensDescription()))
    assert found.radiance.unit == "relative"


@pytest.mark.parametrize(
    ("calibrated", "stated", "u_rel"),
    [(0.01, {"transmittance_u_rel": 0.02}, math.hypot(0.01, 0.02)), (0.0, {}, 0.1 / math.sqrt(3.0))],
)
def test_a_neutral_filter_in_front_counts_with_both_uncertainties(rig, seen, calibrated, stated, u_rel):
    """Transmittance 0.09 in use and 0.9 at calibration: ten times the radiance, u the root of 2 %² + 1 %².

    Filters are sold to ±10 %, a rectangle of 5.8 %: the calibration's own stated figure is not borrowed.
    """
    frames, calibration = seen[0], lensed(rig, transmittance=0.9, transmittance_u_rel=calibrated)
    lens = LensDescription(f_number=4.0, transmittance=0.09, **stated)
    plain = read_patch(frames, PATCH, Setup(rig.description, LensDescription(f_number=4.0), calibration))
    found = read_patch(frames, PATCH, Setup(rig.description, lens, calibration))
    assert found.radiance.value == pytest.approx(10.0 * plain.radiance.value, rel=1e-12)
    assert u_rel_of(plain, "lens transmittance") == 0.0
    assert u_rel_of(found, "lens transmittance") == pytest.approx(u_rel)


def test_a_transmittance_that_the_calibration_does_not_state_is_refused(rig, seen):
    """The ratio is not known."""
    with pytest.raises(CalibrationError, match=r"transmittance of 0\.09"):
        read_patch(
            seen[0], PATCH, Setup(rig.description, LensDescription(f_number=4.0, transmittance=0.09), rig.calibration())
        )


def test_a_map_counts_filter_and_focus_too(rig, seen):
    """The same factors in every pixel, and their uncertainty in what all pixels share."""
    calibration = lensed(rig, transmittance=0.9, transmittance_u_rel=0.0)
    plain = merge(seen[0], Setup(rig.description, LensDescription(f_number=4.0), calibration))
    lens = LensDescription(f_number=4.0, transmittance=0.45, transmittance_u_rel=0.03, magnification=0.1)
    found = merge(seen[0], Setup(rig.description, lens, calibration))
    assert found.radiance.mean() / plain.radiance.mean() == pytest.approx(2.0 * 1.21, rel=1e-5)
    extra = math.sqrt(found.u_rel_common**2 - plain.u_rel_common**2)
    assert extra == pytest.approx(math.hypot(0.03, 2 * 0.1 * 0.1 / 1.1))


# What must hold of any reading of a patch: scaling, order, clipping, and each line of its budget by known values.


MIDDLE = Patch(2, 2, 10, 10)
GAIN_E, READ_E, BLACK = 2.6, 2.4, 64.0  # of the rig
relaxed = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
numbers = st.integers(300, 3500)
times = st.floats(1e-5, 1.0)


def flat(number, exposure_s=1e-3, size=14, **changes):
    """Return a frame with one number in every pixel."""
    setting = FrameSettings(exposure_s, 0.0, 4.0, BLACK, temperature_c=25.0)
    return Frame(np.full((size, size), number, np.uint16), 12, replace(setting, **changes))


def exact(rig, **changes):
    response = changes.pop("response", None)
    return replace(rig.calibration(**{"uncertainties": EXACT, "black_level": EXACT_BLACK} | changes), response=response)


def read_exactly(rig, frames, calibration=None, lens=None, patch=MIDDLE, **options):
    setup = {name: options.pop(name) for name in ("source", "spectrum") if name in options}
    return read_patch(
        Bracket.from_frames(frames),
        patch,
        Setup(rig.description, lens or rig.lens, calibration or exact(rig), **setup),
        **options,
    )


@relaxed
@given(number=numbers, exposure_s=times, f_number=st.floats(1.0, 22.0), gain_db=st.floats(0.0, 24.0))
def test_radiance_follows_number_time_stop_and_gain(rig, number, exposure_s, f_number, gain_db):
    """L = scale·(M − black)/(gain·t)·4N²/π, whatever the settings."""
    found = read_exactly(rig, [flat(number, exposure_s, f_number=f_number, gain_db=gain_db)])
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
    ratio = (
        read_exactly(rig, [flat(number)], clear, lens).radiance.value / read_exactly(rig, [flat(number)]).radiance.value
    )
    assert ratio == pytest.approx((1 + magnification) ** 2 / transmittance, rel=1e-9)


@relaxed
@given(order=st.permutations(range(4)), number=numbers)
def test_the_order_of_frames_changes_nothing(rig, order, number):
    """Value, u, flags and budget."""
    frames = [flat(number - 40 * k, 1e-3 * (1 + k)) for k in range(4)]
    one, other = (read_exactly(rig, chosen, now=NOW) for chosen in (frames, [frames[k] for k in order]))
    assert other.radiance.value == pytest.approx(one.radiance.value, rel=1e-12)
    assert other.radiance.u == pytest.approx(one.radiance.u, rel=1e-9)
    assert other.flags == one.flags


NOW = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)


@relaxed
@given(number=numbers, times=st.integers(2, 1000))
def test_a_clipped_frame_adds_nothing(rig, number, times):
    """A longer exposure that clips leaves value and uncertainty as they were."""
    one = read_exactly(rig, [flat(number), flat(number)])
    more = read_exactly(rig, [flat(number), flat(number), flat(4095, 1e-3 * times)])
    assert more.radiance == one.radiance
    assert more.exposures_s == one.exposures_s


@relaxed
@given(count=st.integers(1, 12), side=st.integers(4, 10), number=numbers)
def test_noise_falls_by_the_root_of_frames_and_pixels(rig, count, side, number):
    """σ of one sample: √(light/K + (σ_d/K)² + 1/12) DN; over n frames of m pixels that over √(n·m)."""
    found = read_exactly(rig, [flat(number)] * count, patch=Patch(2, 2, side, side))
    x = number - BLACK
    sigma = math.sqrt(x / GAIN_E + (READ_E / GAIN_E) ** 2 + 1 / 12)
    assert u_rel_of(found, "repeatability") == pytest.approx(sigma / x / math.sqrt(count) / side, rel=1e-9)
    assert u_rel_of(found, "source fluctuation") == 0.0


@relaxed
@given(number=numbers, u_dn=st.floats(0.1, 10.0), count=st.integers(1, 5))
def test_the_black_level_s_uncertainty_does_not_average_out(rig, number, u_dn, count):
    """u DN of x DN, however many frames; with dark frames instead it is their own noise."""
    doubted = exact(rig, black_level=BlackLevel(dn=64.0, u_dn=u_dn, dark_u_rel=0.0))
    found = read_exactly(rig, [flat(number)] * count, doubted)
    assert u_rel_of(found, "dark and black level") == pytest.approx(u_dn / (number - BLACK), rel=1e-9)
    closed = flat(65, shutter="closed")
    noisy = closed.dn + np.array([[-1, 1]] * 7, np.int64).ravel()  # the noise that rounding needs
    dark = [replace(closed, dn=noisy.astype(np.uint16))] * 3
    found = read_exactly(rig, [*dark, *[flat(number)] * count], doubted)
    noise = math.sqrt((READ_E / GAIN_E) ** 2 + 1 / 12) / math.sqrt(3 * 14 * 14)  # which all lights share
    noise = math.hypot(noise, 0.02 * math.hypot(1.0, u_dn))  # dark current, by thermometers in steps of 0.5 K
    own = [u_rel_of(found, "dark and black level"), u_rel_of(found, "repeatability")]
    assert own[0] == pytest.approx(noise / (number - 65), rel=0.6)
    assert own[0] < u_dn / (number - BLACK)
    assert found.radiance.value / read_exactly(rig, [flat(number)]).radiance.value == pytest.approx(
        (number - 65) / (number - BLACK), rel=1e-9
    )


@relaxed
@given(number=numbers, u_scale=st.floats(0.001, 0.1), u_exposure=st.floats(0.0, 0.01), spectral=st.floats(0.0, 0.1))
def test_the_lines_add_up_in_squares(rig, number, u_scale, u_exposure, spectral):
    """u² is the sum of the lines' squares, U is k·u, and the stated lines stand as stated."""
    stated = EXACT.model_copy(update={"exposure_u_rel": u_exposure, "spectral_u_rel": spectral})
    known = exact(rig, u_rel=u_scale, uncertainties=stated)
    found = read_exactly(rig, [flat(number)] * 3, known)
    u_rel = found.radiance.u / found.radiance.value
    assert u_rel**2 == pytest.approx(sum(one.u_rel**2 for one in found.budget), rel=1e-9)
    assert u_rel_of(found, "scale") == pytest.approx(u_scale)
    assert u_rel_of(found, "exposure time") == pytest.approx(u_exposure)
    assert u_rel_of(found, "spectral assumption") == pytest.approx(spectral)
    assert found.expanded_u_rel == pytest.approx(found.coverage_factor * u_rel)
    assert found.coverage_factor == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("f_number", [2.8, 4.0])
def test_another_stop_counts_twice(rig, f_number):
    """L ~ N²: 2 % of the f-number are 4 % of L where it is not the calibration's, and nothing where it is."""
    known = exact(rig, uncertainties=EXACT.model_copy(update={"f_number_u_rel": 0.02}))
    found = read_exactly(rig, [flat(2000, f_number=f_number)] * 3, known)
    assert u_rel_of(found, "f-number") == pytest.approx(0.04 if f_number != 4.0 else 0.0)


@pytest.mark.parametrize(("side", "u_rel"), [(2, 0.01 / 2), (3, 0.01 / 3), (4, 0.0)])
def test_few_pixels_cannot_show_their_pattern(rig, side, u_rel):
    """Below 16 pixels 1 % each as stated, over the root of the pixels; from 16 on what they show: nothing."""
    known = exact(rig, uncertainties=EXACT.model_copy(update={"prnu_u_rel": 0.01}))
    found = read_exactly(rig, [flat(3000)] * 200, known, patch=Patch(2, 2, side, side))
    assert u_rel_of(found, "pixel pattern") == pytest.approx(u_rel, rel=1e-9)
    assert (Flag.SMALL_PATCH in found.flags) is False or side < 4


def pattern(frame, amplitude):
    """Return a frame as a chessboard of ±amplitude DN."""
    board = np.indices(frame.shape).sum(0) % 2 * 2 - 1
    return replace(frame, dn=(frame.dn + amplitude * board).astype(np.uint16))


def test_a_pattern_counts_as_what_it_shows(rig):
    """±100 of 2000 DN: differences of neighbours over √2 are 141 DN; less the noise, over ten (√100 pixels)."""
    found = read_exactly(rig, [pattern(flat(2064), 100)])
    variance = 2000 / GAIN_E + (READ_E / GAIN_E) ** 2 + 1 / 12
    expected = math.sqrt(200**2 / 2 - variance) / 10 / 2000
    assert u_rel_of(found, "pixel pattern") == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("slope_dn", "raised"), [(0, False), (25, False), (50, True)])
def test_a_slope_over_the_patch_is_reported_from_five_per_cent_on(rig, slope_dn, raised):
    """Ten columns that rise by 25 of 3000 DN each differ by 2.4 % (standard deviation), by 50 DN 4.8 % and 57 more."""
    frame = flat(3064)
    steps = (np.arange(14) - 6.5) * slope_dn * (1.2 if raised else 1.0)
    found = read_exactly(rig, [replace(frame, dn=(frame.dn + steps[None, :]).astype(np.uint16))] * 5)
    assert (Flag.NONUNIFORM in found.flags) is raised


@pytest.mark.parametrize(
    ("amplitude", "in_darks", "raised"), [(100, False, False), (170, False, True), (170, True, False)]
)
def test_a_pattern_in_the_patch_is_reported_unless_its_darks_have_it(rig, amplitude, in_darks, raised):
    """A chessboard of ±100 of 3000 DN scatters by 4.7 %, of ±170 by 8 %; in the darks as well it is no light's."""
    darks = [pattern(flat(264, shutter="closed"), amplitude)] * in_darks
    found = read_exactly(rig, [*darks, *[pattern(flat(3064 + 200 * in_darks), amplitude)] * 5])
    assert (Flag.NONUNIFORM in found.flags) is raised
    assert u_rel_of(found, "pixel pattern") == pytest.approx(
        0.0 if in_darks else amplitude * math.sqrt(0.02) / 3e3, abs=2e-4
    )


def usable(rig, dn, full_well_e=1e6, **changes):
    """Return what is stated of one frame: whether it may be used, and whether it clips."""
    calibration = exact(rig)
    known = replace(calibration, noise=replace(calibration.noise, full_well_e=full_well_e))
    model = situation_of(Setup(rig.description, rig.lens, known)).model
    (cropped,), _, _ = crop_frames([replace(flat(0, **changes), dn=np.asarray(dn, np.uint16))], MIDDLE, model)
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


def spotted(frame, *spots):
    """Return a frame with other numbers at some pixels (row, column)."""
    dn = frame.dn.copy()
    for row, column, number in spots:
        dn[row, column] = number
    return replace(frame, dn=dn)


def left_out(reading):
    return [one for one in reading.provenance.assumptions if "pixels are left out" in one]


@pytest.mark.parametrize("bright", [3064, 4095])
def test_bright_points_of_the_scene_count(rig, bright):
    """One pixel of a hundred at 1 ms: the mean where it does not clip, a lower bound where it always does."""
    found = read_exactly(rig, [spotted(flat(1064), (5, 5, bright))] * 5)
    rate = (99 * 1000 + bright - BLACK) / 100 * 1e3
    assert found.radiance.value == pytest.approx(rig.true_scale * rate * 4 * 4.0**2 / math.pi, rel=1e-9)
    assert (Flag.SATURATED in found.flags) is (bright == 4095)
    assert Flag.NONUNIFORM in found.flags
    assert not left_out(found)


def test_a_point_that_clips_in_the_longer_frame_counts_as_the_shorter_one_shows_it(rig):
    """Three times as bright as the rest: the mean of the short frame, and the long one is not used."""
    short, long = spotted(flat(1064), (5, 5, 3064)), spotted(flat(2064, 2e-3), (5, 5, 4095))
    found = read_exactly(rig, [short, long])
    assert found.radiance.value == pytest.approx(read_exactly(rig, [short]).radiance.value, rel=1e-12)
    assert found.exposures_s == (1e-3,)


@pytest.mark.parametrize("known", ["dark frames", "calibration", "other frames"])
def test_what_is_shown_to_be_defective_or_struck_is_left_out_and_counted(rig, known):
    """A white pixel that is hot in dark frames, known as a defect, or white in one frame of three: as without it."""
    hot = known == "dark frames"
    dark = flat(64, shutter="closed")
    clean, white = flat(1064), spotted(flat(1064), (5, 5, 4095))
    frames = [white, *[clean if known == "other frames" else white] * 2, spotted(dark, (5, 5, 4095)) if hot else dark]
    given = replace(exact(rig), defects=((5, 5),)) if known == "calibration" else exact(rig)
    found = read_exactly(rig, frames, given)
    assert found.radiance.value == pytest.approx(read_exactly(rig, [clean, dark]).radiance.value, rel=1e-12)
    assert left_out(found) == ["1 of 100 pixels are left out: defective, or struck in one frame alone"]
    assert Flag.SATURATED not in found.flags


def cut_frames(exposures_s, rate_dn, dark_count=2):
    """Return light and dark frames of a camera whose noise of 0.92 DN is cut off at its black level 0."""
    rng, found = np.random.default_rng(48_117), []
    for shutter, rate, count in (("open", rate_dn, 3), ("closed", 0.0, dark_count)):
        for exposure_s in exposures_s * count:
            dn = rng.normal(rate * exposure_s, np.sqrt(0.92**2 + rate * exposure_s / GAIN_E), (40, 40))
            setting = FrameSettings(exposure_s, 0.0, 4.0, 0.0, temperature_c=25.0, shutter=shutter)
            found.append(Frame(np.clip(np.round(dn), 0, 4095).astype(np.uint16), 12, setting))
    return found


@pytest.mark.parametrize("rate_dn", [400.0, 1000.0, 4000.0, 40_000.0])
@pytest.mark.parametrize("exposures_s", [(0.016,), (0.004, 0.008, 0.016)])
def test_dark_frames_that_are_cut_off_give_no_black_level(rig, rate_dn, exposures_s):
    """Their mean is 0.4 DN: the stated level 0 counts, within U of the truth, in a patch and in a map."""
    known = exact(rig, black_level=BlackLevel(dn=0.0, u_dn=0.0, dark_u_rel=0.0))
    setup = Setup(rig.description, rig.lens, known)
    frames, truth = cut_frames(exposures_s, rate_dn), rig.true_scale * rate_dn * 4 * 4.0**2 / math.pi
    found = read_patch(frames, WHERE, setup)
    assert abs(found.radiance.value - truth) < found.coverage_factor * found.radiance.u
    assert (Flag.DARK_ASSUMED in found.flags) is (rate_dn < 4000.0)
    mapped = merge(Bracket.from_frames(frames), setup)
    shared = mapped.parts_of_u(np.ones(mapped.shape, bool))[1]
    assert abs(float(mapped.radiance.mean()) - truth) < 2.0 * float(np.median(shared))


def test_dead_pixels_do_not_make_dark_frames_cut_off(rig):
    """Two of a hundred at 0, far below the others: black is that of the dark frames, 3 DN above the stated one."""
    dead = [(5, 5, 0), (8, 3, 0)]
    frames = [spotted(flat(1067), *dead), spotted(flat(67, shutter="closed"), *dead)]
    found = read_exactly(rig, frames)
    rate = 98 * 1000 / 100 * 1e3
    assert found.radiance.value == pytest.approx(rig.true_scale * rate * 4 * 4.0**2 / math.pi, rel=1e-9)


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
    (cropped,), _, _ = crop_frames([Frame(dn, 8, FrameSettings(0.01))], MIDDLE, model)
    assert (cropped.usable, cropped.unclipped) == (False, unclipped)
    assert cropped.whole_clipped == pytest.approx(0.0 if unclipped else 1 / 196)


def test_the_bright_half_of_a_patch_must_not_clip(rig):
    """Half at 1000 and half at 4085 DN is not used, half at 3000 is."""
    assert usable(rig, board(1000, [4085] * 50)) == (False, False)
    assert usable(rig, board(1000, [3000] * 50)) == (True, True)


def test_what_clips_in_every_frame_is_a_lower_bound(rig):
    """The shortest frame's value, with as much uncertainty, and the flag."""
    found = read_exactly(rig, [flat(4095, 2e-3), flat(4095, 1e-3)])
    assert Flag.SATURATED in found.flags
    assert found.exposures_s == (1e-3,)
    assert u_rel_of(found, "clipping") == pytest.approx(1.0)
    assert u_rel_of(found, "clipping") <= found.radiance.u / found.radiance.value


def test_dark_signal_that_fills_a_pixel_leaves_no_upper_limit(rig):
    """Light less darkness is nothing where both are full, and may be anything."""
    found = read_exactly(rig, [flat(4095, shutter="closed"), flat(4095)])
    assert Flag.SATURATED in found.flags
    assert found.upper_limit is None


def test_a_frame_that_clips_for_no_reason_means_that_the_light_changes(rig):
    """White at an exposure no longer than one that is not: half on, half off, and not saturated."""
    steady = [flat(1000), flat(4095, 0.5)]
    assert Flag.FLICKER not in read_exactly(rig, steady).flags
    assert read_exactly(rig, [*[flat(1000)] * 5, flat(4095)]).flags == (Flag.FLICKER,)


@pytest.mark.parametrize(
    ("exposure_s", "count", "few"), [(0.01, 2, True), (0.01, 3, False), (0.0099, 4, True), (0.0099, 5, False)]
)
def test_few_frames_cannot_show_flicker(rig, exposure_s, count, few):
    """Three of 10 ms or more, five of less."""
    assert (Flag.FEW_FRAMES in read_exactly(rig, [flat(1000, exposure_s)] * count).flags) is few


@pytest.mark.parametrize(("level", "below"), [(64, True), (65, True), (70, False), (1000, False)])
def test_two_sigma_are_the_noise_floor(rig, level, below):
    """One frame of 100 pixels: σ of the mean 0.1 DN, so that 1 DN shows — and is below where black is known to 1 DN."""
    doubted = exact(rig, black_level=BlackLevel(dn=64.0, u_dn=1.0, dark_u_rel=0.0))
    assert (Flag.BELOW_NOISE in read_exactly(rig, [flat(level)] * 3, doubted).flags) is below
    assert (Flag.BELOW_NOISE in read_exactly(rig, [flat(level)] * 3).flags) is (level == 64)


@pytest.mark.parametrize(("white", "reported"), [(0, False), (3, True)])
def test_a_surround_that_clips_may_be_of_any_brightness(rig, white, reported):
    """Beyond 0.2 % of the picture: three pixels of 196."""
    dn = flat(1000).dn.copy()
    dn[0, :white] = 4095
    assert (Flag.STRAY_LIGHT in read_exactly(rig, [replace(flat(1000), dn=dn)] * 5).flags) is reported
    deep = exact(rig)
    deep = replace(deep, noise=replace(deep.noise, full_well_e=1e6))  # white is then the converter's last number
    assert (Flag.STRAY_LIGHT in read_exactly(rig, [replace(flat(1000), dn=dn)] * 5, deep).flags) is reported


def test_another_focus_costs_what_the_change_is_known_to(rig):
    """Magnification 0.2 instead of 0.1, known to 10 % of the change: 2·0.01/1.2; focused as at calibration, nothing."""
    stated = EXACT.model_copy(update={"magnification_u_rel": 0.1})
    known = replace(exact(rig, uncertainties=stated), lens=rig.lens.model_copy(update={"magnification": 0.1}))
    for magnification, u_rel in ((0.2, 2 * 0.01 / 1.2), (0.1, 0.0)):
        lens = LensDescription(focal_length_mm=16.0, f_number=4.0, magnification=magnification)
        assert u_rel_of(read_exactly(rig, [flat(1000)] * 5, known, lens), "focus") == pytest.approx(u_rel)


def test_the_surround_is_the_mean_of_the_picture(rig):
    """Patch 1000 DN above black, one row of fourteen at 3000: the mean of all."""
    dn = flat(1064).dn.copy()
    dn[0, :] = 3064
    frames = Bracket.from_frames([replace(flat(1064), dn=dn)])
    found = patch_situation(frames, MIDDLE, Setup(rig.description, rig.lens, exact(rig)))
    assert found.conditions.surround == pytest.approx((13 * 1000 + 3000) / 14 / 1000, rel=1e-6)
    assert found.conditions.level == pytest.approx(1000 / (4095 - 64), rel=1e-6)
    assert found.conditions.inverse_exposure_per_s == pytest.approx(1000.0)


@pytest.mark.parametrize("mode", [None, "GAIN 120"])
def test_frames_that_do_not_state_the_gain_of_the_calibration_are_flagged(rig, mode):
    """The value is off by any factor where the gain is another one; nothing is flagged where neither states one."""
    known = exact(rig)
    known = replace(known, camera=known.camera.model_copy(update={"mode": mode}))
    assert (Flag.GAIN in read_exactly(rig, [flat(1000)] * 5, known).flags) is (mode is not None)


@pytest.mark.parametrize(("days", "stale"), [(364.0, False), (366.0, True)])
def test_a_calibration_is_stale_after_its_days(rig, days, stale):
    """365 days from its making."""
    known = replace(exact(rig), created="2026-01-01T00:00:00Z", validity_days=365.0)
    now = NOW + dt.timedelta(days=days)
    assert (Flag.STALE_CALIBRATION in read_exactly(rig, [flat(1000)] * 5, known, now=now).flags) is stale


# A frame that was copied counts once: in a patch, in a map, in memory or as it arrives, by whatever name.


CAMERA = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2.0, read_noise_e=4.0, black_level_dn=64.0)
WHERE = Patch(4, 4, 16, 16)


def exposure(seed: int, level_dn: float = 800.0, shutter: str = "open") -> Frame:
    """Return a frame with noise of its own."""
    dn = np.random.default_rng(seed).normal(64.0 + level_dn, np.sqrt(4.0 + level_dn / 2.0), (40, 40))
    settings = FrameSettings(0.01, black_level_dn=64.0, shutter=shutter)  # type: ignore[arg-type]
    return Frame(np.clip(np.round(dn), 0, 4095).astype(np.uint16), 12, settings)


def u_of(frames: list[Frame]) -> list[float]:
    """Return the standard uncertainties of one patch and of a pixel of maps."""
    bracket = Bracket.from_frames(frames)
    maps = merge(bracket, Setup(CAMERA)), merge(iter(frames), Setup(CAMERA))
    return [read_patch(frames, WHERE, Setup(CAMERA)).radiance.u, *(float(np.median(one.u_radiance)) for one in maps)]


@pytest.mark.parametrize("copies", [1, 2, 5])
def test_copies_of_light_and_dark_frames_change_nothing(copies: int) -> None:
    """Frames that differ in their noise lower u of a pixel; copies of them lower none."""
    dark, light = [exposure(n, 0.0, "closed") for n in range(2)], [exposure(10 + n) for n in range(2)]
    once = u_of([*dark, *light])
    assert u_of([*dark * (copies + 1), *light * (copies + 1)]) == pytest.approx(once, rel=1e-12)
    more = [exposure(20 + n) for n in range(2 * copies)]
    assert np.all(np.array(u_of([*dark, *light, *more]))[1:] < np.array(once)[1:])
    found = read_patch([*dark, *light, light[0]], WHERE, Setup(CAMERA))
    assert found.provenance is not None
    assert "1 frame is a copy of another to the last pixel: no exposure counts twice" in found.provenance.assumptions


def test_copied_files_of_a_folder_count_once(tmp_path: Path) -> None:
    """By other names and other times of writing."""
    header = fits.Header({"EXPTIME": 0.01, "INSTRUME": "A", "BITPIX": 16})
    for folder, seeds in (("three", (1, 2, 3)), ("copied", (1, 2, 3, 1, 2, 2))):
        (tmp_path / folder).mkdir()
        for n, seed in enumerate(seeds):
            fits.PrimaryHDU(exposure(seed).dn, header).writeto(tmp_path / folder / f"{n}.fits")
    three, copied = (rm.merge(tmp_path / folder).map for folder in ("three", "copied"))
    assert np.array_equal(three.u_radiance, copied.u_radiance)
    assert np.allclose(three.radiance, copied.radiance, rtol=1e-6)


# Dark and light frames that were swapped are refused by a reading of a patch as by a map.


def frames(light_dn: float, dark_dn: float, exposures_s: tuple[float, ...]) -> list[Frame]:
    """Return a dark and a light frame of each exposure, with these numbers above black at 10 ms."""
    rng, found = np.random.default_rng(48_020), list[Frame]()
    for shutter, level in (("closed", dark_dn), ("open", light_dn)):
        for exposure_s in exposures_s:
            dn = np.round(rng.normal(64.0 + level * exposure_s / 0.01, 3.0, (40, 40)))
            settings = FrameSettings(exposure_s, black_level_dn=64.0, shutter=shutter)  # type: ignore[arg-type]
            found.append(Frame(np.clip(dn, 0, 4095).astype(np.uint16), 12, settings))
    return found


@pytest.mark.parametrize("exposures_s", [(0.01,), (0.002, 0.01), (0.001, 0.002, 0.004, 0.008)])
@pytest.mark.parametrize("signal_dn", [40.0, 400.0, 3000.0])
def test_what_is_darker_than_its_darks_is_refused(exposures_s: tuple[float, ...], signal_dn: float) -> None:
    """Over exposures and levels; the same frames the right way round are read."""
    right, swapped = frames(signal_dn, 0.0, exposures_s), frames(0.0, signal_dn, exposures_s)
    for take in (
        lambda some: read_patch(some, Patch(4, 4, 16, 16), Setup(CAMERA)),
        lambda some: merge(some, Setup(CAMERA)),
    ):
        assert take(right) is not None
        with pytest.raises(MeasurementError, match="darker than the dark frames"):
            take(swapped)

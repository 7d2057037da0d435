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
from radiometer.analysis.calibration.calibrate import KnownSource, scale_by_source
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.budget import conditions_of, local_scatter
from radiometer.analysis.reading.monte_carlo import propagate_distributions
from radiometer.analysis.reading.reading import patch_situation, read_patch
from radiometer.analysis.signal.model import crop_frames, signal_model
from radiometer.analysis.signal.situation import situation_of, spectral_correction
from radiometer.data import (
    BlackLevel,
    Bracket,
    CameraDescription,
    Flag,
    FlatField,
    FoundEffects,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    ResponseCurve,
    ScaleConditions,
    SensorNoise,
    SourceDescription,
    SpectralResponse,
    StatedUncertainties,
)
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError, InputError, MeasurementError
from testing.relative_scale import relative_calibration

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


def test_a_dark_patch_averages_to_zero_with_its_flag(rig):
    """Finite within 4 u, at any sign, also through a logarithmic curve."""
    rng = np.random.default_rng(2)
    result = read(rig, rig.frames(uniform(0.0), rng, (1e-3, 1e-2)), rig.calibration())
    assert Flag.BELOW_NOISE in result.flags
    assert abs(result.radiance.value) < 4.0 * result.radiance.u
    assert math.isfinite(result.expanded_u_rel)
    frames = rig.frames(uniform(0.0, 40), np.random.default_rng(1), (1e-3, 1e-2))
    result = read(rig, frames, curved(rig, (70, 4090)))
    assert abs(result.radiance.value) < 4.0 * result.radiance.u
    assert Flag.EXTRAPOLATED in result.flags


def test_without_a_calibration_values_are_relative(rig, seen):
    """DN above black per second, flagged, no f-number needed; with one the lens may state it."""
    truth = 0.5 * rig.radiance_of_full_scale(1e-3)
    result = read(rig, rig.frames(uniform(truth), np.random.default_rng(1), (1e-3,)), None)
    assert result.flags == (Flag.UNCALIBRATED,)
    assert result.radiance.unit == "relative"
    expected = 0.5 * (4095 - 64) / 1e-3
    assert abs(result.radiance.value - expected) < 4.0 * result.radiance.u
    found = read_patch(without_f_number(seen[0]), PATCH, Setup(rig.description, LensDescription()))
    assert found.radiance.unit == "relative"
    frames, truth = without_f_number(seen[0]), seen[1]
    found = read_patch(frames, PATCH, Setup(rig.description, LensDescription(f_number=8.0), rig.calibration()))
    assert found.radiance.value == pytest.approx(4.0 * truth, rel=5e-3)


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
    known = of_spectra(rig.calibration(), "line:500", "line:600", silicon())
    relative = replace(known, scale=known.scale.model_copy(update={"method": "relative"}))
    assert (spectral_correction(relative), spectral_correction(known)[0]) == ((1.0, ()), pytest.approx(1 / 1.2))


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


def test_a_filter_must_be_known_and_counts_in_a_map(rig, seen):
    """One that the calibration does not state is refused; factor and u are common to all pixels."""
    with pytest.raises(CalibrationError, match=r"transmittance of 0\.09"):
        read_patch(
            seen[0], PATCH, Setup(rig.description, LensDescription(f_number=4.0, transmittance=0.09), rig.calibration())
        )
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
    """4095 less four times the noise; the bright half of a patch must not clip."""
    edge = next(
        n for n in range(4095, 0, -1) if n + 4 * math.sqrt((n - 64) / GAIN_E + (READ_E / GAIN_E) ** 2 + 1 / 12) < 4095
    )
    assert usable(rig, board(edge)) == (True, True)
    assert usable(rig, board(edge + 1)) == (False, False)
    assert usable(rig, board(1000, [4085] * 50)) == (False, False)
    assert usable(rig, board(1000, [3000] * 50)) == (True, True)


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


def test_odd_pixels_count_as_they_are_shown(rig):
    """A point that clips by the shorter frame; dead ones do not cut dark frames off."""
    short, long = spotted(flat(1064), (5, 5, 3064)), spotted(flat(2064, 2e-3), (5, 5, 4095))
    found = read_exactly(rig, [short, long])
    assert found.radiance.value == pytest.approx(read_exactly(rig, [short]).radiance.value, rel=1e-12)
    assert found.exposures_s == (1e-3,)
    dead = [(5, 5, 0), (8, 3, 0)]
    frames = [spotted(flat(1067), *dead), spotted(flat(67, shutter="closed"), *dead)]
    found = read_exactly(rig, frames)
    rate = 98 * 1000 / 100 * 1e3
    assert found.radiance.value == pytest.approx(rig.true_scale * rate * 4 * 4.0**2 / math.pi, rel=1e-9)


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


def test_what_clips_is_a_bound_or_means_that_the_light_changes(rig):
    """The shortest frame's value; darkness that fills leaves no limit; half white is flicker."""
    found = read_exactly(rig, [flat(4095, 2e-3), flat(4095, 1e-3)])
    assert Flag.SATURATED in found.flags
    assert found.exposures_s == (1e-3,)
    assert u_rel_of(found, "clipping") == pytest.approx(1.0)
    assert u_rel_of(found, "clipping") <= found.radiance.u / found.radiance.value
    found = read_exactly(rig, [flat(4095, shutter="closed"), flat(4095)])
    assert Flag.SATURATED in found.flags
    assert found.upper_limit is None
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


def test_focus_and_surround_are_those_of_the_picture(rig):
    """2·0.01/1.2 for a change of 0.1 known to 10 %; the mean of all pixels."""
    stated = EXACT.model_copy(update={"magnification_u_rel": 0.1})
    known = replace(exact(rig, uncertainties=stated), lens=rig.lens.model_copy(update={"magnification": 0.1}))
    for magnification, u_rel in ((0.2, 2 * 0.01 / 1.2), (0.1, 0.0)):
        lens = LensDescription(focal_length_mm=16.0, f_number=4.0, magnification=magnification)
        assert u_rel_of(read_exactly(rig, [flat(1000)] * 5, known, lens), "focus") == pytest.approx(u_rel)
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
    assert "1 frame is a copy of another to the last pixel: no exposure counts twice" in found.provenance.assumptions
    further = light[0].dn.copy()
    further[1:] += 1  # not by its first row alone
    other = replace(light[0], dn=further)
    found = read_patch([*dark, *light, other], WHERE, Setup(CAMERA))
    assert not any("copy" in text for text in found.provenance.assumptions)


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


# Readings in situations that a calibration does not share: wider by as much as is stated, flagged, and true.


NOTHING = StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0))
NOON = dt.datetime(2026, 1, 1, 12, tzinfo=dt.UTC)
STEADY = (1e-3,) * 5


def only(**figures):
    """Return stated uncertainties of which all but these are 0."""
    assert figures.keys() <= StatedUncertainties.model_fields.keys()  # another name would state nothing
    return NOTHING.model_copy(update=figures)


def calibrated(rig, conditions=None, **changes):
    """Return a calibration of exactly known scale that was got under conditions."""
    options = {"uncertainties": NOTHING, "black_level": EXACT_BLACK, "created": NOON.isoformat(), **changes}
    base = rig.calibration(**options)
    found = conditions or ScaleConditions(inverse_exposure_per_s=1e3, temperature_c=25.0)
    return replace(base, scale=base.scale.model_copy(update={"conditions": found}))


def read_under(rig, calibration, *, frames=None, lens=None, camera=None, patch=PATCH, level=0.5, **options):
    setup = {name: options.pop(name) for name in ("source", "spectrum") if name in options}
    if frames is None:
        scene = np.full((12, 12), level * rig.radiance_of_full_scale(1e-3))
        frames = rig.frames(scene, np.random.default_rng(3), STEADY)
    chosen = Bracket.from_frames(frames)
    given_now = {"now": NOON, **options}
    return read_patch(
        chosen, patch, Setup(camera or rig.description, lens or rig.lens, calibration, **setup), **given_now
    )


def u_rel_under(reading, name):
    return next(one.u_rel for one in reading.budget if one.name == name)


@pytest.mark.parametrize("years", [-2.0, 2.0])
def test_a_year_since_calibration_counts(rig, years):
    """1 % per year: 2 % two years after or before, nothing at once; flagged where nothing else is as large."""
    calibration = calibrated(rig, uncertainties=only(drift_u_rel_per_year=0.01), validity_days=3650.0)
    assert u_rel_under(read_under(rig, calibration), "drift") == 0.0
    other = read_under(rig, calibration, now=NOON + dt.timedelta(days=years * 365.25))
    assert u_rel_under(other, "drift") == pytest.approx(0.02)
    assert other.flags == ((Flag.DRIFT,) if years > 0.0 else (Flag.DRIFT, Flag.STALE_CALIBRATION))


def test_what_dominates_is_flagged(rig):
    """3 µs of 20 µs are 15 %; 15 K at 0.1 %/K are 1.5 %, unknown ones 3 K; 1 % of glare by its surround."""
    stated = only(temperature_u_rel_per_k=1e-3)
    warm = read_under(rig, calibrated(rig, ScaleConditions(temperature_c=10.0), uncertainties=stated))
    assert u_rel_under(warm, "temperature") == pytest.approx(0.015)
    assert warm.flags == (Flag.TEMPERATURE,)
    cold = read_under(rig, calibrated(rig, ScaleConditions(temperature_c=40.0), uncertainties=stated))
    assert u_rel_under(cold, "temperature") == pytest.approx(0.015)
    unknown = read_under(rig, calibrated(rig, ScaleConditions(), uncertainties=stated))
    assert u_rel_under(unknown, "temperature") == pytest.approx(3e-3)
    calibration = calibrated(rig, ScaleConditions(temperature_c=25.0), uncertainties=only(exposure_u_s=3e-6))
    scene = np.full((12, 12), 0.5 * rig.radiance_of_full_scale(20e-6))
    found = read_under(rig, calibration, frames=rig.frames(scene, np.random.default_rng(1), (20e-6,) * 5))
    assert u_rel_under(found, "exposure offset") == pytest.approx(0.15)
    assert Flag.SHORT_EXPOSURE in found.flags
    scene = np.full((40, 40), 0.9 * rig.radiance_of_full_scale(1e-3))
    scene[15:25, 15:25] /= 3.0
    frames = rig.frames(scene, np.random.default_rng(3), STEADY)
    found = read_under(rig, calibrated(rig, uncertainties=only(glare_u=0.01)), frames=frames, patch=Patch(16, 16, 8, 8))
    mean = float((scene / scene[20, 20]).mean())
    assert u_rel_under(found, "stray light") == pytest.approx(0.01 * (mean - 1.0), rel=0.01)
    assert Flag.STRAY_LIGHT in found.flags


@pytest.mark.parametrize("handled", ["reseated", "refocused", "iris_reset"])
def test_what_was_done_to_the_lens_counts(rig, handled):
    """Declared on the bench: each adds its stated figure, and the flag where it rules."""
    calibration = calibrated(rig, uncertainties=only(**{f"{handled}_u_rel": 0.02}))
    lens = rig.lens.model_copy(update={"since_calibration": (handled,)})
    found = read_under(rig, calibration, lens=lens)
    assert u_rel_under(found, f"lens {handled.replace('_', ' ')}") == pytest.approx(0.02)
    assert found.flags == (Flag.LENS_CHANGED,)
    assert read_under(rig, calibration).flags == ()


@pytest.mark.parametrize("dark_e_per_s", [0.0, 4e5])
def test_glare_that_was_found_is_taken_off(rig, dark_e_per_s):
    """A patch seen through 5 % of glare of surroundings three times as bright is read as it is, dark signal or not."""
    scene = np.full((40, 40), 0.6 * rig.radiance_of_full_scale(1e-3))
    scene[15:25, 15:25] /= 3.0
    seen = 0.95 * scene + 0.05 * scene.mean() + dark_e_per_s / float(rig.electrons_per_s(1.0))
    frames = rig.frames(seen, np.random.default_rng(3), STEADY)
    camera = rig.description.model_copy(update={"dark_current_e_per_s": dark_e_per_s})
    noise = SensorNoise.of(camera)
    base = calibrated(rig, ScaleConditions(inverse_exposure_per_s=1e3, temperature_c=25.0, surround=1.0))
    calibration = replace(base, camera=camera, noise=noise, found=FoundEffects(glare=0.05))
    found = read_under(rig, calibration, frames=frames, camera=camera, patch=Patch(16, 16, 8, 8))
    assert found.radiance.value == pytest.approx(scene[20, 20], rel=2e-3)


@pytest.mark.parametrize(
    ("kind", "here", "there", "u_rel"),
    [("screen", None, None, 0.004), ("screen", False, None, 0.0), ("sphere", True, False, 0.004),
     ("sphere", False, True, 0.004)],
)  # fmt: skip
def test_polarised_light_counts_where_the_calibration_s_was_not(rig, kind, here, there, u_rel):
    """Either way; a screen is polarised unless stated otherwise."""
    conditions = ScaleConditions(inverse_exposure_per_s=1e3, temperature_c=25.0, polarised=there)
    calibration = calibrated(rig, conditions, uncertainties=only(polarisation_u_rel=0.004))
    found = read_under(rig, calibration, source=SourceDescription(kind=kind, polarised=here))
    assert u_rel_under(found, "polarisation") == pytest.approx(u_rel)


def wide(rig):
    """Return a camera of pixels so large that the corner of 12 × 12 lies at tan α = 0.5 behind 16 mm."""
    spacing_um = 8.0 / math.hypot(5.5, 5.5) * 1e3
    return rig.description.model_copy(update={"pixel_pitch_um": spacing_um})


@pytest.mark.parametrize(("vignetting", "part"), [("none", 0.6), ("cos4", 0.05)])
def test_natural_falloff_is_corrected_with_its_doubt(rig, vignetting, part):
    """In the corner cos⁴α is 1/1.25² = 0.64: divided out, declared or not, and in doubt by a part of what is lost."""
    lens = LensDescription(focal_length_mm=16.0, f_number=4.0, vignetting=vignetting)
    calibration = calibrated(rig, uncertainties=only(falloff_u_rel=0.6, cos4_u_rel=0.05))
    calibration = replace(calibration, lens=lens)
    scene = np.full((12, 12), 0.5 * rig.radiance_of_full_scale(1e-3))
    found = read_under(rig, calibration, camera=wide(rig), lens=lens, patch=Patch(11, 11, 1, 1))
    corner = 1.0 / 1.25**2
    assert found.radiance.value == pytest.approx(scene[0, 0] / corner, rel=0.02)
    assert u_rel_under(found, "fall-off") == pytest.approx(part * (1.0 - corner) / corner, rel=1e-6)
    assert (Flag.FALLOFF_ASSUMED in found.flags) == (vignetting == "none")


@pytest.mark.parametrize(
    ("vignetting", "f_number", "losses"), [("none", 4.0, 0.0), ("none", 8.0, 2.0), ("cos4", 8.0, 0.0)]
)
def test_a_fall_off_at_another_iris_is_in_doubt_at_both_places(rig, vignetting, f_number, losses):
    """Calibrated at the corner where it is read: an undeclared lens may vignette otherwise at another f-number."""
    lens = LensDescription(focal_length_mm=16.0, f_number=4.0, vignetting=vignetting)
    calibration = calibrated(
        rig, ScaleConditions(sensitivity=0.64), uncertainties=only(falloff_u_rel=0.6, cos4_u_rel=0.05)
    )
    scale = calibration.scale.model_copy(update={"f_number": f_number})
    calibration = replace(calibration, lens=lens, scale=scale)
    found = read_under(rig, calibration, camera=wide(rig), lens=lens, patch=Patch(11, 11, 1, 1))
    assert u_rel_under(found, "fall-off") == pytest.approx(0.6 * math.sqrt(losses) * 0.36 / 0.64, abs=1e-9)
    assert (Flag.FALLOFF_ASSUMED in found.flags) == (losses > 0.0)


@pytest.mark.parametrize(("f_number", "magnification"), [(8.0, 0.0), (4.0, 0.5)])
def test_a_flat_field_of_another_stop_or_focus_is_in_doubt(rig, f_number, magnification):
    """Made at f/8 and used at f/4, or focused nearer: half of the fall-off that it holds joins its own uncertainty."""
    flat = FlatField(
        principal_point_px=(5.5, 5.5), radius_px=math.hypot(5.5, 5.5), coefficients=(-0.2, 0.0, 0.0), shape=(12, 12),
        u_rel=0.003, f_number=f_number,
    )  # fmt: skip
    corner = Patch(11, 11, 1, 1)
    lens = rig.lens.model_copy(update={"magnification": magnification})
    other = read_under(rig, calibrated(rig, flat_field=flat), patch=corner, lens=lens)
    same = read_under(rig, calibrated(rig, flat_field=flat.model_copy(update={"f_number": 4.0})), patch=corner)
    assert u_rel_under(other, "flat field") == pytest.approx(math.hypot(0.003, 0.5 * 0.2), rel=1e-6)
    assert u_rel_under(same, "flat field") == pytest.approx(0.003)
    frames = rig.frames(np.full((12, 12), 0.5 * rig.radiance_of_full_scale(1e-3)), np.random.default_rng(3), STEADY)
    mapped = merge(frames, Setup(rig.description, lens, calibrated(rig, flat_field=flat)))
    assert mapped.u_radiance[11, 11] / mapped.radiance[11, 11] == pytest.approx(0.5 * 0.2, rel=0.05)


def test_the_data_sheet_s_dark_current_may_be_three_times_as_much(rig):
    """120 % of the modelled dark signal where no dark frame was taken, with the flag where it rules."""
    camera = rig.description.model_copy(update={"dark_current_e_per_s": 2000.0})
    black = BlackLevel(dn=64.0, u_dn=0.0)
    calibration = replace(calibrated(rig, black_level=black), camera=camera, noise=SensorNoise.of(camera))
    scene = np.full((12, 12), 0.1 * rig.radiance_of_full_scale(0.1))
    found = read_under(rig, calibration, camera=camera, frames=rig.frames(scene, np.random.default_rng(1), (0.1,) * 3))
    dark_dn, light_dn = 200.0 / rig.gain_e_per_dn, 0.1 * (4095 - 64)
    assert u_rel_under(found, "dark and black level") == pytest.approx(1.2 * dark_dn / (light_dn - dark_dn), rel=0.01)
    assert Flag.DARK_ASSUMED in found.flags


@pytest.mark.parametrize(("light_e", "flag"), [(240.0, "dark_assumed"), (50.0, "dark_assumed"), (0.0, "below_noise")])
def test_an_unknown_dark_current_is_in_doubt(rig, light_e, flag):
    """A camera whose data sheet says nothing may have 1 nA/cm²: 62 e⁻/s in a pixel of 1 µm, k = 2: no noise."""
    camera = rig.description.model_copy(update={"dark_current_e_per_s": None, "pixel_pitch_um": 1.0})
    base = calibrated(rig, black_level=BlackLevel(dn=64.0, u_dn=0.0))
    scene = np.full((12, 12), light_e / (4031 * rig.gain_e_per_dn) * rig.radiance_of_full_scale(1.0))
    frames = rig.frames(scene, np.random.default_rng(1), (1.0,) * 3)
    found = read_under(rig, replace(base, camera=camera, noise=SensorNoise.of(camera)), frames=frames, camera=camera)
    if light_e > 62.0:
        assert u_rel_under(found, "dark and black level") == pytest.approx(31.2 / light_e, rel=0.06)
    assert {"dark_assumed", "below_noise"} & set(found.flags) == {flag}


def test_what_calibration_and_reading_share_drops_out(rig):
    """Read as it was calibrated, a source is known as well as the reference: clock, level, place and warmth cancel."""
    frames = rig.frames(np.full((12, 12), 0.5 * rig.radiance_of_full_scale(1e-3)), np.random.default_rng(3), STEADY)
    base = rig.calibration(created=NOON.isoformat(), black_level=BlackLevel(dn=64.0))
    source = KnownSource(0.5 * rig.radiance_of_full_scale(1e-3), 0.004)
    scale = scale_by_source(base, Bracket.from_frames(frames), PATCH, source)
    assert scale.budget["response curve"] == pytest.approx(1e-3)
    found = read_under(rig, replace(base, scale=scale))
    assert found.radiance.u_rel == pytest.approx(math.hypot(0.004, 0.0007, 0.0007), rel=0.01)


def test_masked_pixels_are_dark_frames_of_their_own_exposure(rig):
    """6 DN more than the stated black level are in the masked pixels too: a dim patch reads right, surely."""
    dim = np.full((12, 12), 0.02 * rig.radiance_of_full_scale(1e-3))
    plain = rig.frames(dim, np.random.default_rng(1), (1e-3,) * 5)
    dark = [replace(one, dn=one.dn + np.uint16(6)) for one in plain]
    masked = [replace(one, extra={"masked_rows_dn": 70.0}) for one in dark]
    calibration = replace(rig.calibration(), black_level=BlackLevel(dn=64.0, u_dn=5.0))
    where = (Patch(1, 1, 10, 10), Setup(rig.description, rig.lens, calibration))
    right, off = read_patch(masked, *where), read_patch(dark, *where)
    assert right.radiance.value == pytest.approx(float(dim[0, 0]), rel=5e-3)
    assert off.radiance.value / right.radiance.value == pytest.approx(1.0 + 6.0 / 81.0, rel=0.01)
    reported = next(u_rel_under for u_rel_under in right.budget if u_rel_under.name == "dark and black level")
    assert (reported.note, reported.u_rel) == ("masked pixels", pytest.approx(0.29 / 81.0, rel=0.02))
    assert "dark_assumed" in off.flags
    assert "dark_assumed" not in right.flags


def test_conditions_are_means_by_parts_and_scatter_leaves_bad_pixels_out():
    """1/t and gain by weights; four of 31 pairs touch one."""
    frames = [
        FrameSettings(t, g, temperature_c=c) for t, g, c in ((1e-3, 0.0, 20.0), (2e-3, 6.0, 20.0), (4e-3, 12.0, 26.0))
    ]
    made = {"sensitivity": 0.9, "field": 0.5, "polarised": None}
    found = conditions_of(np.array([0.5, -0.25, 0.25]), frames, -0.01, surround=-0.2, **made)
    assert found.inverse_exposure_per_s == pytest.approx(0.5 * 1000 + 0.25 * 500 + 0.25 * 250)
    assert found.gain_db == pytest.approx(0.25 * 6.0 + 0.25 * 12.0)
    assert found.temperature_c == pytest.approx(22.0)
    assert (found.level, found.surround, found.sensitivity, found.field) == (0.0, 0.0, 0.9, 0.5)
    unknown = [*frames[:2], FrameSettings(4e-3)]
    assert conditions_of(np.ones(3) / 3, unknown, 0.3, surround=0.2, **made).temperature_c is None
    pixels, good = np.full((4, 5), 100.0), np.ones((4, 5), bool)
    pixels[1, 2], good[1, 2] = 1000.0, False
    assert local_scatter(pixels, good) == (0.0, 27)
    sloped = 2.0 * np.indices((4, 5))[1]
    assert local_scatter(sloped, np.ones((4, 5), bool)) == (pytest.approx(math.sqrt(16 * 4.0 / 31 / 2.0)), 31)
    assert local_scatter(pixels, np.zeros((4, 5), bool)) == (0.0, 0)


@pytest.mark.parametrize(("doubt", "reported"), [(0.0015, False), (0.003, True), (0.216, True)])
def test_a_falloff_that_was_assumed_is_reported_from_two_thousandths_on(rig, doubt, reported):
    """0.3 % of doubt because no one measured the fall-off is flagged though it rules nothing; 0.15 % is not."""
    stated = only(falloff_u_rel=doubt / 0.36)
    found = read_under(rig, calibrated(rig, uncertainties=stated), patch=Patch(11, 11, 1, 1))
    assert u_rel_under(found, "fall-off") == pytest.approx(doubt)
    assert (Flag.FALLOFF_ASSUMED in found.flags) == reported


def test_frames_that_do_not_belong_together_are_refused(rig):
    """Of another size, of another depth than the camera's, of two levels of light; a patch without one good pixel."""
    scene = np.full((12, 12), 0.5 * rig.radiance_of_full_scale(1e-3))
    first, second, *_ = rig.frames(scene, np.random.default_rng(3), STEADY)
    small = replace(second, dn=second.dn[:-1])
    deep = replace(second, bit_depth=second.bit_depth + 2)
    brighter = replace(second, settings=replace(second.settings, source_level=0.5))
    dimmer = replace(first, settings=replace(first.settings, source_level=0.25))
    wrong = {
        r"differ in size \(12 × 11 and 12 × 12 pixels\)": [first, small],
        f"{second.bit_depth + 2} bits per pixel": [first, deep],
        "2 different source levels": [dimmer, brighter],
    }
    for text, frames in wrong.items():
        with pytest.raises(MeasurementError, match=text):
            read_patch(frames, PATCH, Setup(rig.description, rig.lens, calibrated(rig)), now=NOON)
    spots = tuple((x, y) for x in (3, 4) for y in (5, 6, 7))
    with pytest.raises(MeasurementError, match="every pixel of the patch 3,5,2,3 is defective"):
        read_under(rig, calibrated(rig, defects=spots), frames=[first, second], patch=Patch(3, 5, 2, 3))
    kept = read_under(rig, calibrated(rig, defects=spots[:-1]), frames=[first, second], patch=Patch(3, 5, 2, 3))
    assert kept.radiance.value == pytest.approx(scene[0, 0], rel=0.05)


FAR = {
    "exposure offset": ({"exposure_u_s": 3e-6}, "inverse_exposure_per_s", (400.0, 1600.0), 3e-6 * 600.0),
    "temperature": ({"temperature_u_rel_per_k": 1e-3}, "temperature_c", (5.0, 45.0), 0.02),
    "gain step": ({"gain_step_u_rel": 0.01}, "gain_db", (-6.0, 6.0), 0.01),
    "linearity": ({"bend_u_rel": 3e-3}, "level", (0.1, 0.9), 3e-3 * 0.4),
    "stray light": ({"glare_u": 0.01}, "surround", (0.4, 1.6), 0.006),
}


@pytest.mark.parametrize("name", FAR)
def test_a_calibration_as_far_below_as_above_costs_the_same(rig, name):
    """Half an open range either way: a term of u acts in both directions, and none takes u away."""
    stated, condition, apart, expected = FAR[name]
    base = {"inverse_exposure_per_s": 1e3, "temperature_c": 25.0, "level": 0.5, "surround": 1.0}
    found = [
        u_rel_under(
            read_under(
                rig, calibrated(rig, ScaleConditions(**base | {condition: there}), uncertainties=only(**stated))
            ),
            name,
        )
        for there in apart
    ]
    assert found == pytest.approx([expected, expected], rel=0.02)


@pytest.mark.parametrize(("patch", "expected"), [(Patch(11, 11, 1, 1), 0.0), (Patch(5, 5, 2, 2), 0.6 * 0.36 / 0.64)])
def test_a_falloff_counts_from_where_the_calibration_stood(rig, patch, expected):
    """Calibrated in the corner, at a cos⁴α of 0.64: nothing is in doubt there; in the middle all that was lost."""
    lens = LensDescription(focal_length_mm=16.0, f_number=4.0)
    there = ScaleConditions(temperature_c=25.0, sensitivity=0.64, field=1.0)
    calibration = replace(calibrated(rig, there, uncertainties=only(falloff_u_rel=0.6)), lens=lens)
    found = read_under(rig, calibration, camera=wide(rig), lens=lens, patch=patch)
    assert u_rel_under(found, "fall-off") == pytest.approx(expected, rel=0.02, abs=1e-9)


@pytest.mark.parametrize(("level", "left"), [(0.9, 0.12), (0.5, math.sqrt(0.13**2 - 0.05**2 - 0.04**2))])
def test_what_a_reading_shares_with_its_calibration_counts_once(rig, level, left):
    """13 % without the 5 % of the clock are 12 %; read at the calibration's level the curve's 4 % drop out as well."""
    base = calibrated(rig, ScaleConditions(inverse_exposure_per_s=1e3, temperature_c=25.0, level=level))
    budget = {"exposure time": 0.05, "response curve": 0.04}
    found = read_under(rig, replace(base, scale=base.scale.model_copy(update={"u_rel": 0.13, "budget": budget})))
    assert u_rel_under(found, "scale") == pytest.approx(left, rel=1e-6)


@pytest.mark.parametrize("steps", [(1, -1, 2, 0, -2, 0), (3, -3), (1, 1, -2)])
def test_a_source_that_fluctuates_is_known_by_its_sample_standard_deviation(rig, steps):
    """s/√n, s with n − 1: of frames that differ by per cents, with a noise of 0.05 %, to half a step of 12 %."""
    full, rng = rig.radiance_of_full_scale(1e-3), np.random.default_rng(7)
    frames = [rig.frame(np.full((12, 12), 0.5 * full * (1.0 + 0.02 * step)), 1e-3, rng) for step in steps]
    reading = read_under(rig, calibrated(rig), frames=frames)
    found = next(one for one in reading.budget if one.name == "source fluctuation")
    means = np.array([frame.dn[PATCH.slices].mean() - 64.0 for frame in frames])
    s_rel = means.std(ddof=1) / means.mean()
    assert found.u_rel == pytest.approx(s_rel / math.sqrt(len(steps)), rel=0.065)
    assert found.degrees_of_freedom == len(steps) - 1
    assert reading.provenance.parameters["fluctuation_rel"] == pytest.approx(s_rel, rel=0.065)
    assert Flag.FLICKER in reading.flags
    assert reading.radiance.value == pytest.approx(0.5 * full, rel=4e-3)  # four sigmas of two frames of 100 pixels


def test_four_equal_contributions_have_the_interval_of_the_guide_s_additive_model(rig):
    """JCGM 101, 9.2.2: four normal inputs of u = 1 give u = 2.00 and, at 95.45 %, ±4.00; here 1 ‰ each."""
    scene = np.full((120, 120), 0.5 * rig.radiance_of_full_scale(1e-3))
    frames = rig.frames(scene, np.random.default_rng(3), STEADY)
    stated = only(exposure_u_rel=1e-3, temperature_u_rel_per_k=1e-3, drift_u_rel_per_year=1e-3, gain_step_u_rel=1e-3)
    conditions = ScaleConditions(inverse_exposure_per_s=1e3, temperature_c=24.0, gain_db=6.0)
    calibration = calibrated(rig, conditions, uncertainties=stated, validity_days=3650.0)
    later = NOON + dt.timedelta(days=365.25)
    situation = patch_situation(
        frames, Patch(0, 0, 120, 120), Setup(rig.description, rig.lens, calibration, None), now=later
    )
    found = propagate_distributions(situation, np.random.default_rng(1), 200_000)
    assert found.u / found.mean == pytest.approx(2.0e-3, rel=0.01)
    low, high = found.low / found.mean - 1.0, found.high / found.mean - 1.0
    assert (low, high) == (pytest.approx(-4.0e-3, abs=1e-4), pytest.approx(4.0e-3, abs=1e-4))


@pytest.mark.parametrize(("radiance", "within"), [(0.0139, 0.05), (5e-4, 0.8)])
def test_a_dark_patch_of_photographs_is_read_from_frames_that_hold_it(radiance, within):
    """Noise that ends at number 0 reads as light in short exposures; those are below the curve's data and left out.

    Where all are below it, as at the lower level, the longest counts: the mean of all would be 30 times too high.
    """
    rng, dn = np.random.default_rng(47_001), np.arange(256.0)
    curve = ResponseCurve(2.2 * np.log(np.maximum(dn, 0.5) / 255), np.full(256, 1e-3), valid_dn=(10, 253))
    camera = CameraDescription(bit_depth=8)
    frames = []
    for exposure_s in 2.0 ** np.arange(-10, 1):
        light = np.clip(radiance * exposure_s + rng.normal(0.0, 1e-3, (24, 24)), 0.0, 1.0)
        numbers = np.rint(255 * light ** (1 / 2.2)).astype(np.uint8)
        frames.append(Frame(numbers, 8, FrameSettings(float(exposure_s), 0.0, 4.0)))
    noise = SensorNoise(conversion_gain_e_per_dn=300.0, read_noise_e=60.0)
    known = relative_calibration(camera, noise, response=curve, black_level=BlackLevel(dn=0.0))
    reading = read_patch(frames, Patch(2, 2, 20, 20), Setup(camera, calibration=known))
    found = reading.radiance
    assert abs(found.value / radiance - 1.0) < within
    assert (Flag.EXTRAPOLATED in reading.flags) is (radiance == 5e-4)
    assert abs(found.value - radiance) < 2 * found.u or Flag.EXTRAPOLATED in reading.flags

"""Readings of a patch, and the lens that they are read through."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.reading import read_patch
from radiometer.data import (
    BlackLevel,
    Bracket,
    Flag,
    FlatField,
    Frame,
    LensDescription,
    Patch,
    ResponseCurve,
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


def test_dark_frames_take_away_a_wrong_black_level(rig):
    """The believed black level is 3 DN off; dark frames of the same exposure put it right."""
    truth = 20.0 * rig.gain_e_per_dn / float(rig.electrons_per_s(1.0)) / 1e-3  # 20 DN of light
    rng = np.random.default_rng(6)
    wrong = rig.but(black_dn=67.0)
    light = [wrong.frame(uniform(truth), 1e-3, rng) for _ in range(4)]
    dark = [wrong.frame(uniform(0.0), 1e-3, rng, shutter="closed") for _ in range(4)]
    believed = [
        type(f)(f.dn, 12, type(f.settings)(1e-3, f_number=4.0, black_level_dn=64.0, shutter=f.settings.shutter))
        for f in (*light, *dark)
    ]
    without = read(rig, believed[:4], rig.calibration())
    corrected = read(rig, believed, rig.calibration())
    assert without.radiance.value > truth * 1.1
    assert abs(corrected.radiance.value - truth) < 4.0 * corrected.radiance.u


def test_dark_frames_of_other_exposures_correct_the_black_level(rig):
    """The believed black level is 3 DN off and no dark frame has the light frames' exposure."""
    truth = 20.0 * rig.gain_e_per_dn / float(rig.electrons_per_s(1.0)) / 1e-3
    rng = np.random.default_rng(6)
    wrong = rig.but(black_dn=67.0)
    made = [wrong.frame(uniform(truth), 1e-3, rng) for _ in range(4)]
    made += [wrong.frame(uniform(0.0), t, rng, shutter="closed") for t in (1e-4, 1e-2)]
    believed = [Frame(f.dn, 12, replace(f.settings, black_level_dn=64.0)) for f in made]
    result = read(rig, believed, rig.calibration())
    assert abs(result.radiance.value - truth) < 4.0 * result.radiance.u
    line = next(line for line in result.budget if line.name == "dark and black level")
    assert line.note == "dark frames of other exposures"


def test_a_response_curve_replaces_the_straight_line(rig):
    """A camera that squares its signal is read right through its curve, and wrong without it."""
    dn = np.arange(4096.0)
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(
            np.log(np.sqrt(np.maximum(dn - 64, 0) * 4031)), np.zeros(4096), absolute=True, valid_dn=(65, 4094)
        )
    linear = rig.calibration(uncertainties=EXACT)
    bent = type(linear)(
        linear.camera,
        linear.lens,
        linear.scale,
        curve,
        linear.noise,
        black_level=BlackLevel(dn=64.0),
        uncertainties=EXACT,
    )
    truth = 0.6 * rig.radiance_of_full_scale(1e-3)
    frames = []
    for frame in rig.frames(uniform(truth), np.random.default_rng(1), (1e-3, 5e-4, 2.5e-4)):
        squared = np.rint(np.maximum(frame.dn - 64.0, 0) ** 2 / 4031 + 64).astype(np.uint16)
        frames.append(type(frame)(squared, 12, frame.settings))
    assert read(rig, frames, bent).radiance.value == pytest.approx(truth, rel=0.005)
    assert abs(read(rig, frames, linear).radiance.value / truth - 1) > 0.1


def test_a_curve_does_not_brighten_a_dark_patch(rig):
    """Through a logarithmic curve a patch without light still averages to zero: below black it goes on as a line."""
    dn = np.arange(4096.0)
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(np.log(np.maximum(dn - 64, 0)), np.full(4096, 0.001), absolute=True, valid_dn=(70, 4090))
    linear = rig.calibration(uncertainties=EXACT)
    curved = type(linear)(
        linear.camera, linear.lens, linear.scale, curve, linear.noise, black_level=EXACT_BLACK, uncertainties=EXACT
    )
    frames = rig.frames(uniform(0.0, 40), np.random.default_rng(1), (1e-3, 1e-2))
    result = read(rig, frames, curved)
    assert abs(result.radiance.value) < 4.0 * result.radiance.u
    assert Flag.EXTRAPOLATED in result.flags


def test_beyond_the_curve_s_data_is_extrapolated_and_not_called_saturated(rig):
    """The only frame lies above the curve's highest supported number, yet below clipping."""
    dn = np.arange(4096.0)
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(np.log(np.maximum(dn - 64, 0)), np.full(4096, 0.001), absolute=True, valid_dn=(70, 1000))
    curved = replace(rig.calibration(black_level=EXACT_BLACK), response=curve)
    truth = 0.5 * rig.radiance_of_full_scale(1e-3)
    frames = rig.frames(uniform(truth), np.random.default_rng(1), (1e-3,) * 5)
    result = read(rig, frames, curved)
    assert result.flags == (Flag.EXTRAPOLATED,)
    assert result.radiance.value == pytest.approx(truth, rel=0.005)
    shorter = rig.frames(uniform(truth), np.random.default_rng(1), (2e-4, 1e-3))
    assert read(rig, shorter, curved).exposures_s == (2e-4,)


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
    assert next(line for line in result.budget if line.name == "flat field").u_rel == pytest.approx(0.003)


def test_a_patch_outside_the_frame_is_refused(rig):
    """The message gives the patch and the size of the frame."""
    frames = rig.frames(uniform(1.0), np.random.default_rng(1), (1e-3,))
    with pytest.raises(MeasurementError, match="12 × 12"):
        read(rig, frames, None, Patch(10, 10, 5, 5))


def test_dark_frames_alone_are_refused(rig):
    """There must be light."""
    dark = rig.frame(uniform(0.0), 1e-3, np.random.default_rng(1), shutter="closed")
    with pytest.raises(MeasurementError, match="shutter open"):
        read_patch([dark], Patch(0, 0, 2, 2), Setup(rig.description, rig.lens))


def test_the_calibration_of_another_camera_is_refused(rig):
    """The serial number decides."""
    frames = rig.frames(uniform(1.0), np.random.default_rng(1), (1e-3,))
    other = rig.description.model_copy(update={"serial": "2"})
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
    assert next(line.u_rel for line in moved.budget if line.name == "spectral assumption") == pytest.approx(0.03)
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


def test_without_a_known_response_the_difference_is_reported_and_not_guessed(rig):
    """The value stays, its interval widens by what plausible cameras differ by; the assumption is named."""
    frames = rig.frames(uniform(0.5 * rig.radiance_of_full_scale(1e-3)), np.random.default_rng(1), (1e-3,))
    plain = read(rig, frames, rig.calibration())
    moved = read(rig, frames, of_spectra(rig.calibration(), "line:500", "line:600", None))
    assert moved.radiance.value == plain.radiance.value
    assert moved.radiance.u > 5.0 * plain.radiance.u
    assert any("no spectral correction" in text for text in moved.provenance.assumptions)


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
    dn = np.arange(4096.0)
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(
            np.log(np.maximum(dn - 64.0, 0.0)), np.full(4096, curve_u), absolute=True, valid_dn=(65, 4094)
        )
    calibration = replace(rig.calibration(uncertainties=EXACT, black_level=EXACT_BLACK), response=curve)
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


def line(reading, name):
    return next(one for one in reading.budget if one.name == name)


def test_an_unknown_f_number_is_refused_and_asked_for(rig, seen):
    """Frames that do not state it are not read or merged as if they had the calibration's."""
    frames, setup = without_f_number(seen[0]), Setup(rig.description, LensDescription(), rig.calibration())
    for use in (lambda: read_patch(frames, PATCH, setup), lambda: merge(frames, setup)):
        with pytest.raises(CalibrationError, match="--f-number"):
            use()


def test_a_lens_that_states_its_f_number_speaks_for_frames_that_do_not(rig, seen):
    """At f/8 behind a calibration at f/4 the same frames mean four times the radiance."""
    frames, truth = without_f_number(seen[0]), seen[1]
    found = read_patch(frames, PATCH, Setup(rig.description, LensDescription(f_number=8.0), rig.calibration()))
    assert found.radiance.value == pytest.approx(4.0 * truth, rel=5e-3)


def test_a_scale_without_an_f_number_is_refused(rig, seen):
    """A calibration that does not say at which aperture it holds serves at none."""
    base = rig.calibration()
    unknown = replace(base, scale=base.scale.model_copy(update={"f_number": None}))
    with pytest.raises(CalibrationError, match=r"scale\.f_number"):
        read_patch(seen[0], PATCH, Setup(rig.description, rig.lens, unknown))


def test_relative_values_need_no_f_number(rig, seen):
    """Without a scale nothing rests on it."""
    found = read_patch(without_f_number(seen[0]), PATCH, Setup(rig.description, LensDescription()))
    assert found.radiance.unit == "relative"


def test_a_neutral_filter_in_front_counts_with_both_uncertainties(rig, seen):
    """Transmittance 0.09 in use and 0.9 at calibration: ten times the radiance, u the root of 2 %² + 1 %²."""
    frames, calibration = seen[0], lensed(rig, transmittance=0.9, transmittance_u_rel=0.01)
    lens = LensDescription(f_number=4.0, transmittance=0.09, transmittance_u_rel=0.02)
    plain = read_patch(frames, PATCH, Setup(rig.description, LensDescription(f_number=4.0), calibration))
    found = read_patch(frames, PATCH, Setup(rig.description, lens, calibration))
    assert found.radiance.value == pytest.approx(10.0 * plain.radiance.value, rel=1e-12)
    assert line(plain, "lens transmittance").u_rel == 0.0
    assert line(found, "lens transmittance").u_rel == pytest.approx(math.hypot(0.01, 0.02))


def test_a_filter_without_a_stated_uncertainty_has_the_trade_s(rig, seen):
    """Filters are sold to ±10 %: a rectangle, 5.8 %; the calibration's own stated figure is not borrowed."""
    calibration = lensed(rig, transmittance=0.9, transmittance_u_rel=0.0)
    found = read_patch(
        seen[0], PATCH, Setup(rig.description, LensDescription(f_number=4.0, transmittance=0.09), calibration)
    )
    assert line(found, "lens transmittance").u_rel == pytest.approx(0.1 / math.sqrt(3.0))


def test_a_transmittance_that_the_calibration_does_not_state_is_refused(rig, seen):
    """The ratio is not known."""
    with pytest.raises(CalibrationError, match=r"transmittance of 0\.09"):
        read_patch(
            seen[0], PATCH, Setup(rig.description, LensDescription(f_number=4.0, transmittance=0.09), rig.calibration())
        )


def test_a_nearer_focus_counts_with_its_uncertainty(rig, seen):
    """At magnification 0.1 the lens takes in 1/1.1² of the light: the radiance is 1.21 times what it would seem."""
    frames, calibration = seen[0], rig.calibration()
    far, near = (
        read_patch(frames, PATCH, Setup(rig.description, LensDescription(f_number=4.0, magnification=m), calibration))
        for m in (0.0, 0.1)
    )
    assert near.radiance.value / far.radiance.value == pytest.approx(1.21)
    assert line(far, "focus").u_rel == 0.0
    assert line(near, "focus").u_rel == pytest.approx(2 * 0.1 * 0.1 / 1.1)


def test_a_map_counts_filter_and_focus_too(rig, seen):
    """The same factors in every pixel, and their uncertainty in what all pixels share."""
    calibration = lensed(rig, transmittance=0.9, transmittance_u_rel=0.0)
    plain = merge(seen[0], Setup(rig.description, LensDescription(f_number=4.0), calibration))
    lens = LensDescription(f_number=4.0, transmittance=0.45, transmittance_u_rel=0.03, magnification=0.1)
    found = merge(seen[0], Setup(rig.description, lens, calibration))
    assert found.radiance.mean() / plain.radiance.mean() == pytest.approx(2.0 * 1.21, rel=1e-5)
    extra = math.sqrt(found.u_rel_common**2 - plain.u_rel_common**2)
    assert extra == pytest.approx(math.hypot(0.03, 2 * 0.1 * 0.1 / 1.1))

"""The absolute scale by figures worked out by hand: what divides, what multiplies, and how sure it is."""

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.calibration.calibrate import (
    KnownSource,
    MeterReading,
    MeterSettings,
    scale_by_meter,
    scale_by_source,
    scaled_calibration,
    scales_ratio,
    unscaled_calibration,
)
from radiometer.analysis.photometry.photometry import spectrum
from radiometer.analysis.photometry.responses import unknown_mismatch_u_rel
from radiometer.analysis.reading import budget
from radiometer.analysis.signal import situation
from radiometer.analysis.signal.lens import lens_in_use, relative_sensitivity
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    FlatField,
    LensDescription,
    Patch,
    Scale,
    SensorNoise,
    SpectralResponse,
    StatedUncertainties,
)
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError, InputError

PATCH = Patch(1, 1, 10, 10)
NOTHING = StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0))


def scale(value=2.0, u_rel=0.0, **more):
    return Scale(value=value, u_rel=u_rel, method="known_radiance", **more)


def test_two_scales_are_compared_by_their_ratio():
    """2.04 to 2 with 3 and 4 % is 1.02 with 5 % of it, whichever is the surer."""
    found = scales_ratio(scale(2.04, 0.03), scale(2.0, 0.04))
    assert (found.value, found.u, found.unit) == (pytest.approx(1.02), pytest.approx(0.05 * 1.02), "1")
    assert scales_ratio(scale(2.0, 0.04), scale(2.04, 0.03)).u_rel == pytest.approx(0.05)


@pytest.mark.parametrize(("source_u_rel", "times"), [(0.0, 1.0), (1.0, 4.0)])
def test_a_scale_knows_from_how_few_frames_it_is(rig, source_u_rel, times):
    """Four that scatter leave 3 degrees of freedom; a source as uncertain again makes four times as many (Welch)."""
    rng = np.random.default_rng(8)
    light = 0.5 * rig.radiance_of_full_scale(1e-3)
    frames = [rig.frame(np.full((12, 12), light * (1 + e)), 1e-3, rng) for e in (0.05, -0.05, 0.02, -0.02)]
    base = rig.calibration(uncertainties=NOTHING, black_level=BlackLevel(dn=64.0, u_dn=0.0, dark_u_rel=0.0))
    own = scale_by_source(base, Bracket.from_frames(frames), PATCH, KnownSource(light, 0.0))
    found = scale_by_source(base, Bracket.from_frames(frames), PATCH, KnownSource(light, source_u_rel * own.u_rel))
    assert found.degrees_of_freedom == pytest.approx(3.0 * times, rel=0.02)
    assert found.u_rel == pytest.approx(own.u_rel * math.sqrt(1.0 + source_u_rel**2))
    assert found.value == pytest.approx(1.0, rel=0.01)  # the base has it right already


RESPONSE = SpectralResponse(wavelength_nm=(300.0, 1000.0), relative=(300.0, 1000.0), u_rel=0.02, source="hand")


def spectral(of_scale, used, response=RESPONSE, **more):
    camera = CameraDescription(bit_depth=12)
    lens = LensDescription()
    made = scale(spectrum=of_scale, quantity=more.pop("quantity", "radiance"))
    return Calibration(
        camera, lens, made, None, SensorNoise.of(camera), spectrum=used, spectral_response=response, **more
    )


def test_what_a_spectral_correction_is_doubted_by():
    """The response's own 2 %; unknown as much as cameras differ there; next to what is stated, in squares."""
    stated = NOTHING.model_copy(update={"spectral_u_rel": 0.03, "efficacy_u_rel": 0.04})
    unknown = unknown_mismatch_u_rel("line:650", "line:450")
    assert unknown > 0.1
    shown = [
        budget.spectral_u_rel(spectral(*names, response, **more), stated)
        for names, response, more in (
            (("line:450", "line:450"), RESPONSE, {}),
            (("line:450", "line:650"), RESPONSE, {}),
            (("line:450", "line:650"), None, {}),
            (("line:450", "line:450"), RESPONSE, {"quantity": "luminance"}),
        )
    ]
    assert shown == pytest.approx([0.03, math.hypot(0.03, 0.02), math.hypot(0.03, unknown), 0.05])


@pytest.mark.parametrize(
    ("mosaic", "channel", "read_nm"),
    [
        ("RGGB", "green", 620.0),
        ("RGGB", "green", 470.0),
        (None, "red", 540.0),
        (None, "blue", 520.0),
        ("RGGB", None, 620.0),
        (None, "luminance", 460.0),
    ],
)
def test_pixels_under_a_filter_may_pass_far_less_of_another_light(mosaic, channel, read_nm):
    """Filters at 600, 540 and 455 nm: what a reading is wrong by is within 2 u, and not within 2 u of silicon."""
    bells = {"red": (600.0, 80.0), "green": (540.0, 90.0), "blue": (455.0, 70.0)}
    shares = {"luminance": {"red": 0.299, "green": 0.587, "blue": 0.114}}.get(channel, {channel or "green": 1.0})
    peak_nm = bells.get(channel, bells["green"])[0]
    passed = [
        sum(share * nm * 2.0 ** -((2.0 * (nm - bells[one][0]) / bells[one][1]) ** 2) for one, share in shares.items())
        for nm in (peak_nm, read_nm)
    ]
    known = spectral(f"line:{peak_nm:g}", f"line:{read_nm:g}", None)
    conditions = known.scale.conditions.model_copy(update={"channel": channel})
    known = replace(
        known,
        camera=known.camera.model_copy(update={"mosaic": mosaic}),
        scale=known.scale.model_copy(update={"conditions": conditions}),
    )
    off = passed[0] / passed[1] - 1.0
    assert off > 2.0 * unknown_mismatch_u_rel(f"line:{read_nm:g}", f"line:{peak_nm:g}")
    assert off < 2.0 * budget.spectral_u_rel(known, NOTHING)


def test_what_the_lens_in_use_brings_to_the_budget(rig):
    """Focus: 2·u·Δ(m/p)/(1 + m/p). Filter: that of use and of calibration in squares; a data sheet knows no lens."""
    base = rig.calibration(uncertainties=NOTHING.model_copy(update={"magnification_u_rel": 0.1}))
    near = base.lens.model_copy(update={"magnification": 0.5, "pupil_magnification": 2.0})
    assert budget.magnification_u_rel(base, near)[0] == pytest.approx(2.0 * 0.1 * 0.25 / 1.25)
    assert budget.magnification_u_rel(base, base.lens)[0] == 0.0
    filtered = base.lens.model_copy(update={"transmittance": 0.5, "transmittance_u_rel": 0.04})
    clear = replace(base, lens=base.lens.model_copy(update={"transmittance": 0.9, "transmittance_u_rel": 0.03}))
    vague = base.lens.model_copy(update={"transmittance": 0.5})
    assert budget.transmittance_u_rel(clear, vague)[0] == pytest.approx(math.hypot(0.03, 0.1 / math.sqrt(3.0)))
    sheet = replace(base, scale=base.scale.model_copy(update={"method": "datasheet"}))
    assert budget.transmittance_u_rel(sheet, filtered)[0] == pytest.approx(0.04)
    assert budget.transmittance_u_rel(sheet, vague)[0] == 0.0


def test_what_all_readings_of_a_map_share(rig):
    """Exposure clock, straightness, scale, spectrum and flat field, in squares."""
    stated = NOTHING.model_copy(update={"exposure_u_rel": 0.01, "linearity_u_rel": 0.02, "spectral_u_rel": 0.04})
    flat = FlatField(
        principal_point_px=(8.0, 8.0), radius_px=12.0, coefficients=(0.0, 0.0, 0.0), shape=(16, 16), u_rel=0.1
    )
    calibration = rig.calibration(u_rel=0.2, uncertainties=stated, flat_field=flat)
    settled = situation.situation_of(Setup(calibration.camera, calibration.lens, calibration))
    parts = (0.01, 0.02, 0.2, 0.04, 0.1)
    assert budget.common_u_rel(settled) == pytest.approx(math.sqrt(sum(u**2 for u in parts)))
    alone = replace(settled, setup=Setup(calibration.camera, calibration.lens))
    assert budget.common_u_rel(alone) == pytest.approx(math.hypot(0.01, 0.02))
    assert situation.flat_field_for(calibration, (16, 16)) is flat
    with pytest.raises(CalibrationError, match="16 × 16"):
        situation.flat_field_for(calibration, (12, 16))


def test_the_corner_is_dimmer_by_the_fourth_power():
    """Where the ray meets the sensor at 45°, a quarter is left; round the stated centre; without a lens nothing."""
    camera = CameraDescription(bit_depth=12, pixel_pitch_um=10.0)
    lens = LensDescription(focal_length_mm=1.0)
    shown = relative_sensitivity(camera, lens, None, (201, 201), [100, 200, 100], [100, 100, 0])
    assert shown == pytest.approx([1.0, 0.25, 0.25])
    near = lens.model_copy(update={"magnification": 1.0, "pupil_magnification": 0.5})  # at three times the distance
    assert relative_sensitivity(camera, near, None, (201, 201), [100, 200], [100, 100]) == pytest.approx([1.0, 0.81])
    moved = lens.model_copy(update={"principal_point_px": (0.0, 0.0)})
    assert relative_sensitivity(camera, moved, None, (201, 201), [0, 60], [0, 80]) == pytest.approx([1.0, 0.25])
    assert relative_sensitivity(camera, LensDescription(), None, (201, 201), [0], [0]).tolist() == [1.0]


def test_a_transmittance_must_be_comparable(rig):
    """Stated in use and not at calibration it is refused; handling and f-number are those of the lens in use."""
    base = rig.calibration()
    with pytest.raises(CalibrationError, match="the calibration states none"):
        lens_in_use(base, base.lens.model_copy(update={"transmittance": 0.5}))
    used = lens_in_use(base, LensDescription(f_number=8.0, since_calibration=("reseated",), magnification=0.2))
    assert (used.f_number, used.since_calibration, used.magnification) == (8.0, ("reseated",), 0.2)
    assert used.focal_length_mm == base.lens.focal_length_mm


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("400,1\n500,2\n", None),
        ("nm;power\n400;1\n500;2\n", None),
        ("# made here\n400,1\n5000,2\n", None),
        ("400,1\n450,1\n5001,2\n", "must be in nm"),
        ("99,1\n500,2\n", "must be in nm"),
        ("0.4,1\n0.5,2\n", "must be in nm"),
        ("500,1\n450,1\n470,2\n", "must rise"),
        ("400,1\n400,2\n", "must rise"),
        ("400,-1\n500,2\n", "0 or more"),
        ("400,0\n500,0\n", "not all 0"),
        ("400,1\n500,nan\n", "line 2: .*missing"),
        ("400,1\n", "at least two"),
        ("400\n500\n", "expected the columns"),
        ("400,one\n500,2\n", "line 1: .*no number"),
        ("", "empty"),
    ],
)
def test_a_spectrum_in_a_file_is_in_nanometres_and_rises(tmp_path, rows, message):
    """100 to 5000 nm, each above the one before, powers 0 or more and not all 0; else reported why."""
    path = tmp_path / "light.csv"
    path.write_text(rows, encoding="utf-8")
    if message is None:
        assert spectrum(str(path)).power.tolist() == [1.0, 2.0]
    else:
        with pytest.raises(InputError, match=message):
            spectrum(str(path))


@pytest.mark.parametrize(
    ("of_camera", "stated", "used"), [(64.0, None, 64.0), (64.0, 70.0, 70.0), (64.0, 0.0, 0.0), (None, None, 0.0)]
)
def test_a_black_level_that_is_stated_counts_before_the_camera_s(of_camera, stated, used):
    """Also one of 0; without either it is 0. The rest is as given, with a scale of 1 at the lens's f-number."""
    camera = CameraDescription(bit_depth=12, black_level_dn=of_camera)
    made = unscaled_calibration(camera, LensDescription(f_number=5.6), None, "cie_a", stated, validity_days=30.0)
    assert (made.black_level.dn, made.scale.value, made.scale.f_number) == (used, 1.0, 5.6)
    assert (made.spectrum, made.validity_days) == ("cie_a", 30.0)


@pytest.mark.parametrize(
    ("wavelength_nm", "relative"),
    [
        ((500.0, 500.0), (1.0, 1.0)),
        ((600.0, 500.0), (1.0, 1.0)),
        ((500.0, 600.0), (0.0, 0.0)),
        ((500.0, 600.0), (1.0,) * 3),
    ],
)
def test_a_spectral_response_rises_along_its_wavelengths(wavelength_nm, relative):
    """Two values of one wavelength are none that light could be weighed by; nor are zeros, or a value too many."""
    with pytest.raises(ValueError, match="wavelengths rising"):
        SpectralResponse(wavelength_nm=wavelength_nm, relative=relative)


@pytest.mark.parametrize(
    ("camera", "lens", "message"),
    [
        ({"read_noise_e": None}, {}, "typical values for read_noise_e"),
        ({}, {}, "response taken as linear above the black level"),
        ({}, {"transmittance": None}, "lens transmittance 1"),
    ],
)
def test_a_calibration_says_what_it_assumes(rig, camera, lens, message):
    """What no one measured and what the meter cannot know is among the assumptions; what is stated is not."""
    known = {"transmittance": 0.9}

    def assumed(camera_changes, lens_changes):
        base = unscaled_calibration(
            rig.description.model_copy(update=camera_changes),
            rig.lens.model_copy(update=known | lens_changes),
            None,
            "cie_a",
        )
        scale = scale_by_meter(base, MeterReading(12.5, MeterSettings(1 / 60, 5.6, 100.0), 2000.0))
        return scaled_calibration(base, scale, ("a",)).provenance.assumptions

    assert any(one.startswith(message) for one in assumed(camera, lens))
    if camera or lens:
        assert not any(one.startswith(message) for one in assumed({}, {}))


def test_what_the_sensor_leaves_unknown_is_assumed_in_the_same_words_by_calibration_and_reading(rig):
    """So a reading that lists both names each once; the sentence of the dark current is apart from typical values."""
    unknown = dict.fromkeys(("read_noise_e", "full_well_e", "dark_current_e_per_s"))
    base = unscaled_calibration(rig.description.model_copy(update=unknown), rig.lens, None, "cie_a")
    scale = scale_by_meter(base, MeterReading(12.5, MeterSettings(1 / 60, 5.6, 100.0), 2000.0))
    done = scaled_calibration(base, scale, ())
    both = (*done.provenance.assumptions, *situation.situation_of(Setup(done.camera, done.lens, done)).assumptions)
    once = list(dict.fromkeys(both))
    assert sum("read_noise_e" in one for one in once) == sum("dark current" in one for one in once) == 1

"""Readings in situations that a calibration does not share: wider by as much as is stated, flagged, and true."""

import datetime as dt
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.calibration.calibrate import KnownSource, scale_by_source
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.budget import conditions_of, frame_u_rel, local_scatter, stray_light
from radiometer.analysis.reading.monte_carlo import propagate_distributions
from radiometer.analysis.reading.reading import patch_situation, read_patch
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    Flag,
    FlatField,
    FoundEffects,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    Reading,
    ResponseCurve,
    Scale,
    ScaleConditions,
    SensorNoise,
    SourceDescription,
    StatedUncertainties,
)
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError

NOTHING = StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0))
EXACT_BLACK = BlackLevel(dn=64.0, u_dn=0.0, dark_u_rel=0.0)
PATCH = Patch(1, 1, 10, 10)
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


def read(rig, calibration, *, frames=None, lens=None, camera=None, patch=PATCH, level=0.5, **options):
    setup = {name: options.pop(name) for name in ("source", "spectrum") if name in options}
    if frames is None:
        scene = np.full((12, 12), level * rig.radiance_of_full_scale(1e-3))
        frames = rig.frames(scene, np.random.default_rng(3), STEADY)
    chosen = Bracket.from_frames(frames)
    given_now = {"now": NOON, **options}
    return read_patch(
        chosen, patch, Setup(camera or rig.description, lens or rig.lens, calibration, **setup), **given_now
    )


def line(reading, name):
    return next(one.u_rel for one in reading.budget if one.name == name)


def test_a_year_since_calibration_counts(rig):
    """1 % per year: 2 % after two years, nothing at once, and the flag where nothing else is as large."""
    calibration = calibrated(rig, uncertainties=only(drift_u_rel_per_year=0.01), validity_days=3650.0)
    later = NOON + dt.timedelta(days=2 * 365.25)
    assert line(read(rig, calibration), "drift") == 0.0
    old = read(rig, calibration, now=later)
    assert line(old, "drift") == pytest.approx(0.02)
    assert old.flags == (Flag.DRIFT,)


def test_kelvins_from_the_calibration_count(rig):
    """Frames at 25 °C under a calibration at 10 or 40 °C: 15 K at 0.1 %/K are 1.5 %; an unknown temperature is 3 K."""
    stated = only(temperature_u_rel_per_k=1e-3)
    warm = read(rig, calibrated(rig, ScaleConditions(temperature_c=10.0), uncertainties=stated))
    assert line(warm, "temperature") == pytest.approx(0.015)
    assert warm.flags == (Flag.TEMPERATURE,)
    cold = read(rig, calibrated(rig, ScaleConditions(temperature_c=40.0), uncertainties=stated))
    assert line(cold, "temperature") == pytest.approx(0.015)
    unknown = read(rig, calibrated(rig, ScaleConditions(), uncertainties=stated))
    assert line(unknown, "temperature") == pytest.approx(3e-3)


def test_a_very_short_exposure_is_flagged(rig):
    """At 20 µs the same 3 µs are 15 %: the reading is ruled by them and says so."""
    calibration = calibrated(rig, ScaleConditions(temperature_c=25.0), uncertainties=only(exposure_u_s=3e-6))
    scene = np.full((12, 12), 0.5 * rig.radiance_of_full_scale(20e-6))
    found = read(rig, calibration, frames=rig.frames(scene, np.random.default_rng(1), (20e-6,) * 5))
    assert line(found, "exposure offset") == pytest.approx(0.15)
    assert Flag.SHORT_EXPOSURE in found.flags


@pytest.mark.parametrize("handled", ["reseated", "refocused", "iris_reset"])
def test_what_was_done_to_the_lens_counts(rig, handled):
    """Declared on the bench: each adds its stated figure, and the flag where it rules."""
    calibration = calibrated(rig, uncertainties=only(**{f"{handled}_u_rel": 0.02}))
    lens = rig.lens.model_copy(update={"since_calibration": (handled,)})
    found = read(rig, calibration, lens=lens)
    assert line(found, f"lens {handled.replace('_', ' ')}") == pytest.approx(0.02)
    assert found.flags == (Flag.LENS_CHANGED,)
    assert read(rig, calibration).flags == ()


def test_a_bright_surround_counts_by_its_difference(rig):
    """Surround 3 times the patch, calibrated on an even field: 1 % of glare is worth 2 % and more of the reading."""
    scene = np.full((40, 40), 0.9 * rig.radiance_of_full_scale(1e-3))
    scene[15:25, 15:25] /= 3.0
    frames = rig.frames(scene, np.random.default_rng(3), STEADY)
    found = read(rig, calibrated(rig, uncertainties=only(glare_u=0.01)), frames=frames, patch=Patch(16, 16, 8, 8))
    mean = float((scene / scene[20, 20]).mean())
    assert line(found, "stray light") == pytest.approx(0.01 * (mean - 1.0), rel=0.01)
    assert Flag.STRAY_LIGHT in found.flags


def test_an_even_field_under_an_even_calibration_has_no_stray_light(rig):
    """What both share drops out: the noise of the mean is all that is left."""
    assert line(read(rig, calibrated(rig, uncertainties=only(glare_u=0.01))), "stray light") < 2e-5


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
    found = read(rig, calibration, frames=frames, camera=camera, patch=Patch(16, 16, 8, 8))
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
    found = read(rig, calibration, source=SourceDescription(kind=kind, polarised=here))
    assert line(found, "polarisation") == pytest.approx(u_rel)


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
    found = read(rig, calibration, camera=wide(rig), lens=lens, patch=Patch(11, 11, 1, 1))
    corner = 1.0 / 1.25**2
    assert found.radiance.value == pytest.approx(scene[0, 0] / corner, rel=0.02)
    assert line(found, "fall-off") == pytest.approx(part * (1.0 - corner) / corner, rel=1e-6)
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
    found = read(rig, calibration, camera=wide(rig), lens=lens, patch=Patch(11, 11, 1, 1))
    assert line(found, "fall-off") == pytest.approx(0.6 * math.sqrt(losses) * 0.36 / 0.64, abs=1e-9)
    assert (Flag.FALLOFF_ASSUMED in found.flags) == (losses > 0.0)


def test_a_corner_of_an_unknown_lens_is_in_doubt(rig):
    """Without focal length or pixel size nothing is corrected, and 36 % of fall-off at the corner is in doubt."""
    found = read(rig, calibrated(rig, uncertainties=only(falloff_u_rel=0.6)), patch=Patch(11, 11, 1, 1))
    assert line(found, "fall-off") == pytest.approx(0.6 * 0.36)
    assert Flag.FALLOFF_ASSUMED in found.flags


@pytest.mark.parametrize(("f_number", "magnification"), [(8.0, 0.0), (4.0, 0.5)])
def test_a_flat_field_of_another_stop_or_focus_is_in_doubt(rig, f_number, magnification):
    """Made at f/8 and used at f/4, or focused nearer: half of the fall-off that it holds joins its own uncertainty."""
    flat = FlatField(
        principal_point_px=(5.5, 5.5), radius_px=math.hypot(5.5, 5.5), coefficients=(-0.2, 0.0, 0.0), shape=(12, 12),
        u_rel=0.003, f_number=f_number,
    )  # fmt: skip
    corner = Patch(11, 11, 1, 1)
    lens = rig.lens.model_copy(update={"magnification": magnification})
    other = read(rig, calibrated(rig, flat_field=flat), patch=corner, lens=lens)
    same = read(rig, calibrated(rig, flat_field=flat.model_copy(update={"f_number": 4.0})), patch=corner)
    assert line(other, "flat field") == pytest.approx(math.hypot(0.003, 0.5 * 0.2), rel=1e-6)
    assert line(same, "flat field") == pytest.approx(0.003)
    frames = rig.frames(np.full((12, 12), 0.5 * rig.radiance_of_full_scale(1e-3)), np.random.default_rng(3), STEADY)
    mapped = merge(frames, Setup(rig.description, lens, calibrated(rig, flat_field=flat)))
    assert mapped.u_radiance[11, 11] / mapped.radiance[11, 11] == pytest.approx(0.5 * 0.2, rel=0.05)


@pytest.mark.parametrize(("part", "flag"), [(0.8, Flag.NONUNIFORM), (1.2, Flag.SATURATED)])
def test_two_halves_of_different_radiance_are_saturated_only_where_one_clips(rig, part, flag):
    """0.2 and 0.8 of full scale side by side are nonuniform and no more; of 0.3 and 1.2 half is not seen."""
    scene = np.full((12, 12), part * rig.radiance_of_full_scale(1e-3))
    scene[:, 6:] /= 4.0
    found = read(rig, calibrated(rig), frames=rig.frames(scene, np.random.default_rng(1), STEADY))
    assert flag in found.flags
    if part == 0.8:
        assert found.flags == (Flag.NONUNIFORM,)
        assert found.radiance.value == pytest.approx(0.5 * rig.radiance_of_full_scale(1e-3), rel=0.01)


def jittering(rig, count, sigma, seed=8):
    rng = np.random.default_rng(seed)
    truth = 0.5 * rig.radiance_of_full_scale(1e-3)
    return [rig.frame(np.full((12, 12), truth * (1 + rng.normal(0, sigma))), 1e-3, rng) for _ in range(count)]


@pytest.mark.parametrize(("count", "factor"), [(2, 13.97), (3, 4.53), (6, 2.65)])
def test_few_frames_that_disagree_widen_the_factor(rig, count, factor):
    """JCGM 100, table G.2 at 95.45 %: 1, 2 and 5 degrees of freedom, as all of the uncertainty is the source's."""
    found = read(rig, calibrated(rig), frames=jittering(rig, count, 0.05))
    assert found.degrees_of_freedom == pytest.approx(count - 1, rel=0.01)
    assert found.coverage_factor == pytest.approx(factor, abs=0.06)
    assert found.expanded_u_rel == pytest.approx(found.coverage_factor * found.radiance.u_rel)


def test_the_data_sheet_s_dark_current_may_be_three_times_as_much(rig):
    """120 % of the modelled dark signal where no dark frame was taken, with the flag where it rules."""
    camera = rig.description.model_copy(update={"dark_current_e_per_s": 2000.0})
    black = BlackLevel(dn=64.0, u_dn=0.0)
    calibration = replace(calibrated(rig, black_level=black), camera=camera, noise=SensorNoise.of(camera))
    scene = np.full((12, 12), 0.1 * rig.radiance_of_full_scale(0.1))
    found = read(rig, calibration, camera=camera, frames=rig.frames(scene, np.random.default_rng(1), (0.1,) * 3))
    dark_dn, light_dn = 200.0 / rig.gain_e_per_dn, 0.1 * (4095 - 64)
    assert line(found, "dark and black level") == pytest.approx(1.2 * dark_dn / (light_dn - dark_dn), rel=0.01)
    assert Flag.DARK_ASSUMED in found.flags


@pytest.mark.parametrize(("light_e", "flag"), [(240.0, "dark_assumed"), (50.0, "dark_assumed"), (0.0, "below_noise")])
def test_an_unknown_dark_current_is_in_doubt(rig, light_e, flag):
    """A camera whose data sheet says nothing may have 1 nA/cm²: 62 e⁻/s in a pixel of 1 µm, k = 2: no noise."""
    camera = rig.description.model_copy(update={"dark_current_e_per_s": None, "pixel_pitch_um": 1.0})
    base = calibrated(rig, black_level=BlackLevel(dn=64.0, u_dn=0.0))
    scene = np.full((12, 12), light_e / (4031 * rig.gain_e_per_dn) * rig.radiance_of_full_scale(1.0))
    frames = rig.frames(scene, np.random.default_rng(1), (1.0,) * 3)
    found = read(rig, replace(base, camera=camera, noise=SensorNoise.of(camera)), frames=frames, camera=camera)
    if light_e > 62.0:
        assert line(found, "dark and black level") == pytest.approx(31.2 / light_e, rel=0.06)
    assert {"dark_assumed", "below_noise"} & set(found.flags) == {flag}


def test_what_calibration_and_reading_share_drops_out(rig):
    """Read as it was calibrated, a source is known as well as the reference: clock, level, place and warmth cancel."""
    frames = rig.frames(np.full((12, 12), 0.5 * rig.radiance_of_full_scale(1e-3)), np.random.default_rng(3), STEADY)
    base = rig.calibration(created=NOON.isoformat(), black_level=BlackLevel(dn=64.0))
    source = KnownSource(0.5 * rig.radiance_of_full_scale(1e-3), 0.004)
    scale = scale_by_source(base, Bracket.from_frames(frames), PATCH, source)
    assert scale.budget["response curve"] == pytest.approx(1e-3)
    found = read(rig, replace(base, scale=scale))
    assert found.radiance.u_rel == pytest.approx(math.hypot(0.004, 0.0007, 0.0007), rel=0.01)


def test_luminance_carries_the_radiance_s_uncertainty(rig):
    """A scale known to 1 %: luminance and radiance are both known to 1 %."""
    base = calibrated(rig, spectrum="white_led")
    found = read(rig, replace(base, scale=base.scale.model_copy(update={"u_rel": 0.01, "spectrum": "white_led"})))
    assert found.radiance.u_rel == pytest.approx(0.01, rel=0.01)
    assert found.luminance.u_rel == pytest.approx(found.radiance.u_rel, rel=1e-9)


def test_the_dark_current_s_noise_is_in_the_repeatability(rig):
    """1000 dark electrons next to 100 of light: the noise of a pixel is that of 1100 electrons and reading."""
    camera = CameraDescription(**{**rig.description.model_dump(), "dark_current_e_per_s": 1000.0})
    calibration = replace(calibrated(rig), camera=camera, noise=SensorNoise.of(camera))
    expected = (100.0 + 1000.0) / rig.gain_e_per_dn + 64.0
    frame = rig.frames(np.zeros((12, 12)), np.random.default_rng(1), (1.0,))[0]
    flat = Frame(np.full((12, 12), round(expected), np.uint16), 12, frame.settings)
    found = read(rig, calibration, frames=[flat], camera=camera)
    light_e = (round(expected) - 64.0) * rig.gain_e_per_dn - 1000.0
    sigma_e = math.sqrt(light_e + 1000.0 + rig.read_e**2 + rig.gain_e_per_dn**2 / 12.0)
    assert line(found, "repeatability") == pytest.approx(sigma_e / light_e / 10.0, rel=1e-3)


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
    reported = next(line for line in right.budget if line.name == "dark and black level")
    assert (reported.note, reported.u_rel) == ("masked pixels", pytest.approx(0.29 / 81.0, rel=0.02))
    assert "dark_assumed" in off.flags
    assert "dark_assumed" not in right.flags


def test_the_conditions_of_a_reading_are_those_of_its_frames_by_their_parts():
    """Parts of 2, −1 and 1 quarters: 1/t and gain are their weighted means, whatever the sign; temperature is plain."""
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


def test_scatter_of_neighbours_leaves_out_whatever_touches_a_bad_pixel():
    """Of 4 × 5 equal pixels one is bad and in the middle: four of 31 pairs go; a slope of 2 a column counts, √2."""
    pixels, good = np.full((4, 5), 100.0), np.ones((4, 5), bool)
    pixels[1, 2], good[1, 2] = 1000.0, False
    assert local_scatter(pixels, good) == (0.0, 27)
    sloped = 2.0 * np.indices((4, 5))[1]
    assert local_scatter(sloped, np.ones((4, 5), bool)) == (pytest.approx(math.sqrt(16 * 4.0 / 31 / 2.0)), 31)
    assert local_scatter(pixels, np.zeros((4, 5), bool)) == (0.0, 0)


def test_stray_light_is_recognised_by_what_surrounds_the_patch():
    """A picture of 3 around a patch of 2: 1.5 times as bright, next to 0.5 times at calibration; g·|3 − 1|."""

    class Made:
        class scale:  # noqa: N801
            conditions = ScaleConditions(surround=0.5)

        uncertainties = only(glare_u=0.01)

    term = stray_light(2.0, 3.0, Made)
    assert term.u == pytest.approx(0.02)
    assert "1.5 times the patch, 0.5 times at calibration" in term.note
    assert "inf times" in stray_light(0.0, 3.0, Made).note


@pytest.mark.parametrize(("doubt", "reported"), [(0.0015, False), (0.003, True)])
def test_a_falloff_that_was_assumed_is_reported_from_two_thousandths_on(rig, doubt, reported):
    """0.3 % of doubt because no one measured the fall-off is flagged though it rules nothing; 0.15 % is not."""
    stated = only(falloff_u_rel=doubt / 0.36)
    found = read(rig, calibrated(rig, uncertainties=stated), patch=Patch(11, 11, 1, 1))
    assert line(found, "fall-off") == pytest.approx(doubt)
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
        read(rig, calibrated(rig, defects=spots), frames=[first, second], patch=Patch(3, 5, 2, 3))
    kept = read(rig, calibrated(rig, defects=spots[:-1]), frames=[first, second], patch=Patch(3, 5, 2, 3))
    assert kept.radiance.value == pytest.approx(scene[0, 0], rel=0.05)


def test_what_all_pixels_share_grows_with_the_calibration_s_age(rig):
    """1 %/year after 3 years is 3 %, with what else is shared in quadrature; before the calibration as much."""
    calibration = calibrated(rig, uncertainties=only(drift_u_rel_per_year=0.01))
    settings = [FrameSettings(1e-3, temperature_c=25.0)]

    def shared(years, frames=settings):
        taken = NOON + dt.timedelta(days=365.25 * years)
        setup = Setup(rig.description, rig.lens, calibration, taken=taken)
        return frame_u_rel(setup, rig.lens, {rig.lens.f_number}, frames)

    assert math.sqrt(shared(-2.0) ** 2 - shared(0.0) ** 2) == pytest.approx(0.02)
    assert math.sqrt(shared(3.0) ** 2 - shared(0.0) ** 2) == pytest.approx(0.03)
    assert shared(3.0, settings * 4) == pytest.approx(shared(3.0)), "the same of each frame: no average makes it less"


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
        line(
            read(rig, calibrated(rig, ScaleConditions(**base | {condition: there}), uncertainties=only(**stated))), name
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
    found = read(rig, calibration, camera=wide(rig), lens=lens, patch=patch)
    assert line(found, "fall-off") == pytest.approx(expected, rel=0.02, abs=1e-9)


@pytest.mark.parametrize(("level", "left"), [(0.9, 0.12), (0.5, math.sqrt(0.13**2 - 0.05**2 - 0.04**2))])
def test_what_a_reading_shares_with_its_calibration_counts_once(rig, level, left):
    """13 % without the 5 % of the clock are 12 %; read at the calibration's level the curve's 4 % drop out as well."""
    base = calibrated(rig, ScaleConditions(inverse_exposure_per_s=1e3, temperature_c=25.0, level=level))
    budget = {"exposure time": 0.05, "response curve": 0.04}
    found = read(rig, replace(base, scale=base.scale.model_copy(update={"u_rel": 0.13, "budget": budget})))
    assert line(found, "scale") == pytest.approx(left, rel=1e-6)


@pytest.mark.parametrize("steps", [(1, -1, 2, 0, -2, 0), (3, -3), (1, 1, -2)])
def test_a_source_that_fluctuates_is_known_by_its_sample_standard_deviation(rig, steps):
    """s/√n, s with n − 1: of frames that differ by per cents, with a noise of 0.05 %, to half a step of 12 %."""
    full, rng = rig.radiance_of_full_scale(1e-3), np.random.default_rng(7)
    frames = [rig.frame(np.full((12, 12), 0.5 * full * (1.0 + 0.02 * step)), 1e-3, rng) for step in steps]
    reading = read(rig, calibrated(rig), frames=frames)
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
    scale = Scale(value=1.0, u_rel=0.0, method="relative")
    known = Calibration(camera, LensDescription(), scale, curve, noise, BlackLevel(dn=0.0))
    reading = read_patch(frames, Patch(2, 2, 20, 20), Setup(camera, calibration=known))
    found = reading.radiance
    assert abs(found.value / radiance - 1.0) < within
    assert (Flag.EXTRAPOLATED in reading.flags) is (radiance == 5e-4)
    assert abs(found.value - radiance) < 2 * found.u or Flag.EXTRAPOLATED in reading.flags


# Readings of a chart of known radiances in many situations: the truth is within what is stated.


NOW = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
SIZE = (24, 30)  # rows, columns
E_PER_DN, READ_E, WELL_E, DARK_E_PER_S, BLACK_DN = 2.6, 3.1, 10_500.0, 4.0, 64.0
CAMERA = CameraDescription(
    bit_depth=12, model="generated", serial="7", pixel_pitch_um=4.5, conversion_gain_e_per_dn=E_PER_DN,
    read_noise_e=READ_E, full_well_e=WELL_E, dark_current_e_per_s=DARK_E_PER_S, dark_current_reference_C=25.0,
    dark_current_doubling_K=7.0, black_level_dn=BLACK_DN, quantum_efficiency=0.62,
)  # fmt: skip
LENS = LensDescription(focal_length_mm=160.0, f_number=4.0, transmittance=0.92, transmittance_u_rel=0.01)
PER_RADIANCE = 2.1e5  # electrons per second and W·sr⁻¹·m⁻² at f/4
CHART = np.array([[0.4, 2.0, 9.0], [30.0, 120.0, 400.0]])
MIDDLE, DARKEST, BRIGHTEST = Patch(11, 13, 8, 9), Patch(1, 1, 7, 9), Patch(21, 13, 8, 9)


def scene():
    """Return the chart's radiances in W·sr⁻¹·m⁻², SIZE."""
    rows, columns = np.indices(SIZE)
    return CHART[rows * 2 // SIZE[0], columns * 3 // SIZE[1]]


def frame(number, exposure_s, bits=12, light=1.0, **changes):
    """Return one frame; its noise is drawn by `number`."""
    settings = FrameSettings(
        exposure_s, **{"f_number": 4.0, "black_level_dn": BLACK_DN, "temperature_c": 31.0, **changes}
    )
    rng = np.random.default_rng([20261126, number])
    seconds = 0.0 if settings.is_dark else exposure_s * light * (4.0 / (settings.f_number or 4.0)) ** 2
    dark_e = DARK_E_PER_S * 2.0 ** (((settings.temperature_c or 31.0) - 25.0) / 7.0) * exposure_s
    electrons = np.minimum(rng.poisson(PER_RADIANCE * scene() * seconds + dark_e), WELL_E)
    dn = (electrons + rng.normal(0.0, READ_E, SIZE)) * 10 ** (settings.gain_db / 20) / E_PER_DN + BLACK_DN
    if bits == 8:
        dn = 255.0 * np.clip((dn - BLACK_DN) / (4095.0 - BLACK_DN), 0.0, 1.0) ** (1 / 2.2)
        settings = replace(settings, black_level_dn=None)
    stored = np.clip(np.rint(dn), 0, (1 << bits) - 1).astype(np.uint8 if bits == 8 else np.uint16)
    return Frame(stored, bits, settings)


def ladder(first=0, count=8, **changes):
    """Return exposures from 10 µs on, each four times the one before."""
    return [frame(first + k, 1e-5 * 4.0**k, **changes) for k in range(count)]


def calibration(**changes):
    """Return the calibration that is right: H = DN·e⁻/DN over electrons per J·m⁻² of this lens."""
    conditions = ScaleConditions(inverse_exposure_per_s=200.0, temperature_c=31.0, level=0.5, surround=1.0)
    exposure_per_dn = E_PER_DN / PER_RADIANCE * math.pi / 4.0 / 4.0**2 * 0.92
    scale = Scale(value=exposure_per_dn, u_rel=0.005, method="known_radiance", f_number=4.0, conditions=conditions)
    made = {
        "camera": CAMERA, "lens": LENS, "scale": scale, "response": None, "noise": SensorNoise.of(CAMERA),
        "black_level": BlackLevel(dn=BLACK_DN, u_dn=0.2, dark_u_rel=0.5), "created": "2026-02-21T12:00:00Z",
    }  # fmt: skip
    return Calibration(**{**made, **changes})


def gamma_calibration():
    """Return that of the eight-bit frames: x = (M/255)^2.2 of full scale."""
    with np.errstate(divide="ignore"):
        log_exposure = 2.2 * np.log(np.arange(256.0) / 255.0)
    curve = ResponseCurve(log_exposure, np.full(256, 0.004), valid_dn=(4, 250))
    camera = CAMERA.model_copy(update={"bit_depth": 8, "black_level_dn": None, "conversion_gain_e_per_dn": None})
    full = (4095.0 - BLACK_DN) * calibration().scale.value
    scale = calibration().scale.model_copy(update={"value": full})
    return calibration(
        camera=camera, response=curve, scale=scale, black_level=BlackLevel(), noise=SensorNoise.of(camera)
    )


def read_chart(frames, patch=MIDDLE, given=None, **options):
    given = given or calibration()
    lens = options.pop("lens", LENS)
    return read_patch(Bracket.from_frames(frames), patch, Setup(given.camera, lens, given), now=NOW, **options)


def lens(**changes):
    return LENS.model_copy(update=changes)


# What is read, and how many times the chart's radiance the numbers then mean.
SITUATIONS: dict[str, tuple[Callable[[], Reading], float, float]] = {
    "plain": (lambda: read_chart(ladder()), 120.0, 1.0),
    "the darkest field": (lambda: read_chart(ladder(), DARKEST), 0.4, 1.0),
    "the brightest field": (lambda: read_chart(ladder(), BRIGHTEST), 400.0, 1.0),
    "three by three pixels": (lambda: read_chart(ladder(), Patch(12, 14, 3, 3)), 120.0, 1.0),
    "one frame": (lambda: read_chart(ladder()[2:3]), 120.0, 1.0),
    "dark frames of each time": (
        lambda: read_chart([*ladder(), *ladder(50, shutter="closed")], DARKEST), 0.4, 1.0
    ),
    "dark frames of another time": (
        lambda: read_chart([*ladder(), *(frame(60 + k, 0.05, shutter="closed") for k in range(3))], DARKEST), 0.4, 1.0
    ),
    "18 dB": (lambda: read_chart(ladder(20, 6, gain_db=18.0), DARKEST), 0.4, 1.0),
    "two gains": (lambda: read_chart([*ladder(), *ladder(20, 6, gain_db=6.0)]), 120.0, 1.0),
    "f/8": (lambda: read_chart(ladder(30, 8, f_number=8.0)), 120.0, 1.0),
    "5 °C": (lambda: read_chart(ladder(temperature_c=5.0)), 120.0, 1.0),
    "no thermometer": (lambda: read_chart(ladder(temperature_c=None)), 120.0, 1.0),
    "a darker lens of the same make": (lambda: read_chart(ladder(), lens=lens(transmittance=0.8)), 120.0, 0.92 / 0.8),
    "a close-up": (lambda: read_chart(ladder(), lens=lens(magnification=0.5, pupil_magnification=2.0)), 120.0, 1.25**2),
    "three years later": (lambda: read_chart(ladder(), given=calibration(created="2023-03-01T12:00:00Z")), 120.0, 1.0),
    "defective pixels": (
        lambda: read_chart(ladder(), given=calibration(defects=((12, 14), (13, 15), (2, 2)))), 120.0, 1.0,
    ),
    "eight bits through a curve": (lambda: read_chart(ladder(bits=8), given=gamma_calibration()), 120.0, 1.0),
    "a flat field that falls to 0.9": (
        lambda: read_chart(ladder(), BRIGHTEST, calibration(flat_field=FlatField(
            principal_point_px=(24.5, 17.0), radius_px=10.0, coefficients=(0.0, 0.0, 0.0), shape=SIZE, f_number=4.0
        ))), 400.0, 1.0
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SITUATIONS)
def test_the_truth_lies_within_what_is_stated(name):
    """Within 3 u; the lines of the budget add up in squares to u; nothing is called saturated, dark or uneven.

    Stray light of the bright fields is most of the u of the darkest.
    """
    make, radiance, factor = SITUATIONS[name]
    found = make()
    assert abs(found.radiance.value - factor * radiance) < 3.0 * found.radiance.u
    assert math.hypot(*(line.u_rel for line in found.budget)) == pytest.approx(found.radiance.u_rel, rel=1e-6)
    assert not {Flag.SATURATED, Flag.BELOW_NOISE, Flag.NONUNIFORM, Flag.FLICKER} & set(found.flags)
    assert found.radiance.u_rel < (0.2 if radiance > 100.0 else 2.0)


@pytest.mark.parametrize(
    ("make", "flag"),
    [
        (lambda: read_chart(ladder()[6:], BRIGHTEST), Flag.SATURATED),
        (lambda: read_chart(ladder(), Patch(6, 8, 9, 8)), Flag.NONUNIFORM),
        (lambda: read_chart([frame(80 + k, 1e-3, shutter="open", light=0.0) for k in range(2)]), Flag.BELOW_NOISE),
        (lambda: read_chart([frame(70 + k, 1.6e-4, light=1.0 + 0.03 * (k % 3)) for k in range(6)]), Flag.FLICKER),
        (lambda: read_chart(ladder(), given=calibration(created="2020-01-01T00:00:00Z")), Flag.STALE_CALIBRATION),
    ],
)  # fmt: skip
def test_what_a_reading_cannot_stand_for_is_flagged(make, flag):
    """Clipped everywhere, over an edge, without light, flickering or too old."""
    assert flag in make().flags


def test_the_u_of_many_readings_is_what_they_scatter_by():
    """Without what all share, 60 readings of one patch scatter by their own u, to 30 % (√(1/120) is 9 %)."""
    values = [read_chart(ladder(1000 + 10 * k)) for k in range(60)]
    own = [
        math.hypot(*(line.u_rel for line in one.budget if not line.correlated)) * one.radiance.value for one in values
    ]
    scatter = float(np.std([one.radiance.value for one in values], ddof=1))
    assert scatter == pytest.approx(float(np.mean(own)), rel=0.3)

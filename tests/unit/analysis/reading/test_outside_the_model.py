"""Readings in situations that a calibration does not share: wider by as much as is stated, flagged, and true."""

import datetime as dt
import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.calibration.calibrate import KnownSource, scale_by_source
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.budget import conditions_of, local_scatter
from radiometer.analysis.reading.monte_carlo import propagate_distributions
from radiometer.analysis.reading.reading import patch_situation, read_patch
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
    StatedUncertainties,
)
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError
from testing.relative_scale import relative_calibration

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


@pytest.mark.parametrize("years", [-2.0, 2.0])
def test_a_year_since_calibration_counts(rig, years):
    """1 % per year: 2 % two years after or before, nothing at once; flagged where nothing else is as large."""
    calibration = calibrated(rig, uncertainties=only(drift_u_rel_per_year=0.01), validity_days=3650.0)
    assert line(read(rig, calibration), "drift") == 0.0
    other = read(rig, calibration, now=NOON + dt.timedelta(days=years * 365.25))
    assert line(other, "drift") == pytest.approx(0.02)
    assert other.flags == ((Flag.DRIFT,) if years > 0.0 else (Flag.DRIFT, Flag.STALE_CALIBRATION))


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


@pytest.mark.parametrize(("doubt", "reported"), [(0.0015, False), (0.003, True), (0.216, True)])
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
    known = relative_calibration(camera, noise, response=curve, black_level=BlackLevel(dn=0.0))
    reading = read_patch(frames, Patch(2, 2, 20, 20), Setup(camera, calibration=known))
    found = reading.radiance
    assert abs(found.value / radiance - 1.0) < within
    assert (Flag.EXTRAPOLATED in reading.flags) is (radiance == 5e-4)
    assert abs(found.value - radiance) < 2 * found.u or Flag.EXTRAPOLATED in reading.flags

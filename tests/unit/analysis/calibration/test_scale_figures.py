"""The absolute scale by figures worked out by hand: what divides, what multiplies, and how sure it is."""

import math
from dataclasses import replace
from pathlib import Path

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
from radiometer.analysis.calibration.shared import TABLE, Handling, State, require_flat_field
from radiometer.analysis.photometry.photometry import spectrum
from radiometer.analysis.photometry.responses import unknown_mismatch_u_rel
from radiometer.analysis.reading import budget
from radiometer.analysis.reading.reading import read_patch
from radiometer.analysis.signal import situation
from radiometer.analysis.signal.lens import lens_in_use, relative_sensitivity
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    FlatField,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    ResponseCurve,
    Scale,
    ScaleConditions,
    SensorNoise,
    SpectralResponse,
    StatedUncertainties,
)
from radiometer.data.setup import AS_CALIBRATED, Setup
from radiometer.errors import CalibrationError, InputError, RadiometerError
from radiometer.photographs.scene import Photographs, prepared

PATCH = Patch(1, 1, 10, 10)
NOTHING = StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0))


def scale(value=2.0, u_rel=0.0, **more):
    return Scale(value=value, u_rel=u_rel, method="known_radiance", **more)


def test_two_scales_are_compared_and_their_doubts_add_in_squares(rig):
    """1.02 with 5 % of it; clock, straightness, scale, spectrum and flat field."""
    found = scales_ratio(scale(2.04, 0.03), scale(2.0, 0.04))
    assert (found.value, found.u, found.unit) == (pytest.approx(1.02), pytest.approx(0.05 * 1.02), "1")
    assert scales_ratio(scale(2.0, 0.04), scale(2.04, 0.03)).u_rel == pytest.approx(0.05)
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
    """Focus by Δ(m/p), filters of use and calibration in squares; a transmittance must be comparable."""
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
    base = rig.calibration()
    with pytest.raises(CalibrationError, match="the calibration states none"):
        lens_in_use(base, base.lens.model_copy(update={"transmittance": 0.5}))
    used = lens_in_use(base, LensDescription(f_number=8.0, since_calibration=("reseated",), magnification=0.2))
    assert (used.f_number, used.since_calibration, used.magnification) == (8.0, ("reseated",), 0.2)
    assert used.focal_length_mm == base.lens.focal_length_mm


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


# What a calibration and a reading must share: every state of every quantity is handled as the table says.


CAMERA = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2.6, read_noise_e=2.4, full_well_e=10_500)
# Two values of every quantity that may differ; a reading of either is of the same light.
VALUES = {
    "model": ("A", "B"),
    "serial": ("1", "2"),
    "bit depth": (12, 10),
    "pixel pitch": (4.5, 9.0),
    "mosaic": ("RGGB", "BGGR"),
    "mode": ("GAIN 0", "GAIN 300"),
    "filter": ("V", "R"),
    "band": ("Red", "Green"),
    "binning": ("1", "2"),
    "white_balance": ("set to daylight", "set to shade"),
    "conversion gain": (2.6, 1.3),
    "focal length": (16.0, 25.0),
    "f-number": (4.0, 5.6),
    "ISO speed": (100.0, 200.0),
    "gain": (0.0, 6.0),
    "channel": ("green", "red"),
    "spectrum": ("equal_energy", "cie_a"),
    "temperature": (25.0, 40.0),
    "response support": (128.0, 2.0),
    "focus of a flat field": (0.0, 1.0),
    "place of a flat field": ((10.0, 20.0), (12.0, 20.0)),
}
STATES = [(name, state) for name, rules in TABLE.items() for state in rules]


def test_every_quantity_of_the_table_is_tried():
    """A new line of the table needs its two values here."""
    assert set(VALUES) == set(TABLE)


# What a camera's description states, by its name in the table.
MARKS = {name: name for name in ("model", "serial", "mosaic", *CameraDescription.SETTINGS)} | {
    "pixel pitch": "pixel_pitch_um",
    "conversion gain": "conversion_gain_e_per_dn",
}


def calibration(quantity: str, there: object) -> Calibration:
    """Return a calibration by which 2000 DN above black, at f/4, 1 ms, 0 dB, ISO 100, are 1 W·sr⁻¹·m⁻²."""
    stated = {quantity: there}
    camera = CAMERA.model_copy(update={MARKS[k]: stated[k] for k in MARKS if k in stated})
    conditions = ScaleConditions(
        inverse_exposure_per_s=1000.0,
        level=0.5,
        temperature_c=stated.get("temperature", 25.0),
        channel=stated.get("channel", "green"),
    )
    f_number = stated.get("f-number", 4.0)
    scale = Scale(
        value=math.pi / 64.0 * 1e-3 / 2000.0,
        u_rel=0.01,
        method="known_radiance",
        f_number=f_number,
        iso=stated.get("ISO speed", 100.0),
        spectrum="equal_energy",
        conditions=conditions,
    )
    wavelength = tuple(float(nm) for nm in range(380, 781, 10))
    silicon = SpectralResponse(wavelength_nm=wavelength, relative=wavelength)
    lens = LensDescription(focal_length_mm=stated.get("focal length"))
    black = BlackLevel(dn=64.0)
    noise = SensorNoise.of(CAMERA)
    return Calibration(camera, lens, scale, None, noise, black, spectral_response=silicon)


def reading(quantity: str, there: object, here: object) -> tuple[float, dict[str, float]]:
    """Return a reading of 1 W·sr⁻¹·m⁻², and the relative uncertainties of its budget."""
    stated = {quantity: here}
    known = calibration(quantity, there)
    camera = CAMERA.model_copy(update={MARKS[k]: stated[k] for k in MARKS if k in stated})
    depth = int(stated.get("bit depth", 12))
    camera = camera.model_copy(update={"bit_depth": depth})
    f_number, gain_db = stated.get("f-number", 4.0), stated.get("gain", 0.0)
    iso, spectrum = stated.get("ISO speed", 100.0), stated.get("spectrum", "equal_energy")
    level = 2000.0 * (4.0 / (f_number or 4.0)) ** 2 * 10 ** (gain_db / 20.0) * (iso or 100.0) / 100.0
    settings = FrameSettings(1e-3, gain_db, f_number, 64.0, stated.get("temperature", 25.0), iso=iso)
    rng = np.random.default_rng(5)
    top = (1 << depth) - 1
    frames = [
        Frame(
            np.clip(np.rint(rng.normal(64.0 + 0.5 * level, 3.0, (40, 40))), 0, top).astype(np.uint16),
            depth,
            replace(settings, exposure_s=5e-4),
            extra={"channel": stated.get("channel", "green")} if stated.get("channel", "green") else {},
        )
        for _ in range(5)
    ]
    taken = Photographs({"green": Bracket.from_frames(frames)}, Path("here"))
    if quantity in ("ISO speed", "channel"):
        taken = prepared(taken, calibration=known, align="off")
    if spectrum is not None:
        known = replace(known, spectrum=spectrum)
    lens = LensDescription(focal_length_mm=stated.get("focal length"))
    found = read_patch(
        taken.only,
        Patch(0, 0, 40, 40),
        Setup(camera, lens, known, spectrum=AS_CALIBRATED if spectrum is not None else None),
    )
    return found.radiance.value, {line.name: line.u_rel for line in found.budget}


def sides(quantity: str, state: State) -> tuple[object, object]:
    """Return what the calibration and what the reading state."""
    one, other = VALUES[quantity]
    return {
        State.EQUAL: (one, one),
        State.DIFFERENT: (one, other),
        State.READING_SILENT: (one, None),
        State.CALIBRATION_SILENT: (None, one),
        State.BOTH_SILENT: (None, None),
    }[state]


def of_response_support(here: float) -> float:
    """Return the scale of a meter reading at a pixel value, by a curve with data from 4 to 252 DN."""
    g = np.log(np.maximum(np.arange(256.0), 0.25) / 128.0)
    curve = ResponseCurve(g, np.full(256, 1e-3), valid_dn=(4, 252))
    camera = CameraDescription(bit_depth=8)
    base = replace(calibration("", None), camera=camera, response=curve, black_level=BlackLevel(dn=0.0))
    return scale_by_meter(base, MeterReading(12.5, MeterSettings(1 / 128, 8.0, 100.0), here)).value


def accepted(quantity: str, there: object, here: object) -> bool:
    """Return that a scale by a meter, or a flat field, was taken where the calibration differs from it."""
    if quantity == "response support":
        return of_response_support(here) > 0.0
    key = "magnification" if quantity.startswith("focus") else "principal_point_px"
    lenses = [LensDescription(**{key: value}) for value in (there, here)]
    require_flat_field(replace(calibration("", None), lens=lenses[0]), CAMERA, lenses[1])
    return True


@pytest.mark.parametrize(("quantity", "state"), STATES)
def test_every_state_is_handled_as_the_table_says(quantity, state):
    """Kept: right as it is. Corrected: right, with a doubt in the budget. Widened: with a doubt. Refused: an error."""
    rule, (there, here) = TABLE[quantity][state], sides(quantity, state)
    of_itself = quantity == "response support" or quantity.endswith("flat field")
    if rule.handling is Handling.REFUSED:
        with pytest.raises(RadiometerError) as refusal:
            accepted(quantity, there, here) if of_itself else reading(quantity, there, here)
        assert refusal.type is rule.error
        return
    if of_itself:
        assert accepted(quantity, there, here)
        return
    value, budget = reading(quantity, there, here)
    _, same = reading(quantity, *sides(quantity, State.EQUAL))
    if quantity != "spectrum" or state is State.EQUAL:
        assert value == pytest.approx(1.0, rel=2e-3)
    if rule.term:
        assert budget[rule.term] > same[rule.term] + 1e-4
    else:
        dark = "dark and black level"  # of a camera without an ISO speed an unstated dark current may be larger
        assert budget.pop(dark) >= same.pop(dark) * 0.95
        assert budget == pytest.approx(same, rel=0.05, abs=1e-4)

"""What reconcile found is in the calibration, and readings are corrected for it."""

import datetime as dt
import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.calibration.calibrate import (
    KnownSource,
    scale_by_source,
    scaled_calibration,
    unscaled_calibration,
)
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.reading import read_patch
from radiometer.api.calibration import with_found_effects
from radiometer.data import (
    Bracket,
    Calibration,
    CameraDescription,
    FoundEffects,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    ResponseCurve,
)
from radiometer.data.setup import Setup
from radiometer.errors import InputError
from simulators.chain.camera_model import CameraModel
from simulators.effects.registry import make_effect

CAMERA = CameraDescription(
    bit_depth=12, model="m", pixel_pitch_um=4.5, conversion_gain_e_per_dn=5.95, read_noise_e=5.4, full_well_e=24500,
    dark_current_e_per_s=0.0, black_level_dn=64.0, quantum_efficiency=0.62,
)  # fmt: skip
LENS = LensDescription(focal_length_mm=16.0, f_number=4.0)
BASE = unscaled_calibration(CAMERA, LENS, None, "white_led")
PATCH = Patch(16, 16, 8, 8)
DN_PER_S = 1e6  # of a radiance of 1


def model_file(tmp_path, name, parameters, u, found_by="radiometer reconcile"):
    notes = {"found_by": found_by, "u": u}
    model = CameraModel.ideal(CAMERA, LENS).with_effect(make_effect(name, parameters), notes)
    model.write(tmp_path / "reconciled.yaml")
    return tmp_path / "reconciled.yaml"


def frames(radiance, exposure_s=1e-3, *, gain_db=0.0, offset_s=0.0, black=0.0, warm=1.0, real_gain=None, t_c=25.0,
           gained_black=0.0, gained_s=0.0, bend=(0.0, 0.0)):  # fmt: skip
    """Return five noiseless frames of a scene, with what is not stated of them."""
    gain = 10.0 ** ((gain_db if real_gain is None else real_gain) / 20.0)
    electrons = radiance * DN_PER_S * (exposure_s + offset_s + gained_s) * warm * 5.95
    z = electrons / 24500.0
    dn = electrons * (1.0 - bend[0] * z - bend[1] * z**2) / 5.95 * gain + 64.0 + black + gained_black
    stated = FrameSettings(exposure_s, gain_db, 4.0, 64.0, t_c)
    return [Frame(np.rint(dn).astype(np.uint16), 12, stated)] * 5


def even(radiance=1.0):
    return np.full((40, 40), radiance)


def read(base, calibration_frames, reading_frames):
    scale = scale_by_source(base, Bracket.from_frames(calibration_frames), PATCH, KnownSource(1.0, 0.004))
    known = scaled_calibration(base, scale, ())
    now = dt.datetime.fromisoformat(known.created)
    return read_patch(reading_frames, PATCH, Setup(CAMERA, LENS, known), now=now), known


@pytest.mark.parametrize(
    ("effect", "parameters", "u", "section", "figure"),
    [
        ("exposure_time_offset", {"offset_s": 5e-6}, {"offset_s": 2e-7}, ("exposure_offset_s", 5e-6),
         ("exposure_u_s", 2e-7)),
        ("veiling_glare", {"share": 0.01}, {"share": 5e-4}, ("glare", 0.01), ("glare_u", 5e-4)),
        ("gain_step_error", {"error_rel": 0.01}, {"error_rel": 1e-3}, ("gain_error_rel", 0.01),
         ("gain_step_u_rel", 24 * math.log(10) / 20 * 1e-3)),
        ("quantum_efficiency_temperature", {"coefficient_per_K": 1e-3}, {"coefficient_per_K": 1e-4},
         ("temperature_slope_per_k", 1e-3), ("temperature_u_rel_per_k", 1e-4)),
    ],
)  # fmt: skip
def test_an_effect_and_its_uncertainty_reach_the_calibration(tmp_path, effect, parameters, u, section, figure):
    """The value into `found`, its u in place of the default; the file keeps both."""
    made = with_found_effects(BASE, model_file(tmp_path, effect, parameters, u), stated=())
    made.write(tmp_path / "cal.yaml")
    kept = Calibration.read(tmp_path / "cal.yaml")
    assert getattr(kept.found, section[0]) == section[1]
    assert kept.found.names == (effect,)
    assert getattr(kept.uncertainties, figure[0]) == pytest.approx(figure[1])


def test_what_was_found_carries_its_own_uncertainty(tmp_path):
    """A black level in place of ±1 DN, gains by the largest; what the user states stays."""
    path = model_file(tmp_path, "black_level_offset", {"offset_dn": 1.0}, {"offset_dn": 0.02})
    made = with_found_effects(BASE, path, stated=())
    assert (made.found.black_offset_dn, made.black_level.u_dn) == (1.0, 0.02)
    path = model_file(tmp_path, "veiling_glare", {"share": 0.01}, {"share": 5e-4})
    assert with_found_effects(BASE, path, stated=("glare_u",)).uncertainties.glare_u == BASE.uncertainties.glare_u
    table = {"gains_db": (0.0, 6.0, 12.0), "errors_rel": (0.0, 0.01, 0.02)}
    path = model_file(tmp_path, "gain_step_error", table, {"errors_rel[1]": 1e-3, "errors_rel[2]": 2e-3})
    made = with_found_effects(BASE, path, stated=())
    assert (made.found.gains_db, made.found.gain_errors_rel) == (table["gains_db"], table["errors_rel"])
    assert made.uncertainties.gain_step_u_rel == pytest.approx(2e-3)


@pytest.mark.parametrize(
    ("effect", "parameters", "u", "message"),
    [
        ("crosstalk", {}, {}, "crosstalk"),
        ("veiling_glare", {"share": 0.01, "bowl": 0.2}, {"share": 5e-4, "bowl": 0.01}, r"its 'bowl' \(0\.2\)"),
        ("veiling_glare", {"share": 0.01}, {}, r"notes\.u\.share"),
    ],
)
def test_what_readings_cannot_be_corrected_for_is_refused(tmp_path, effect, parameters, u, message):
    """Other effects, what differs over the picture, and what has no uncertainty; each by name."""
    path = model_file(tmp_path, effect, parameters, u)
    with pytest.raises(InputError, match=message):
        with_found_effects(BASE, path, stated=())


def test_a_bend_is_carried_with_its_well_and_not_next_to_a_curve(tmp_path):
    """z is electrons over the model's full well; both would straighten the same bend."""
    path = model_file(tmp_path, "response_nonlinearity", {"a2": 0.03, "a3": -0.01}, {"a2": 3e-3, "a3": 4e-3})
    made = with_found_effects(BASE, path, stated=())
    assert (made.found.well_a2, made.found.well_a3, made.found.well_e) == (0.03, -0.01, 24500.0)
    assert made.uncertainties.bend_u_rel == pytest.approx(5e-3 * 4095 * 5.95 / 24500.0)
    path = model_file(tmp_path, "response_nonlinearity", {"a2": 0.03}, {"a2": 3e-3})
    curve = ResponseCurve(np.log(np.maximum(np.arange(4096.0) - 64.0, 0.1)), np.full(4096, 1e-3))
    with pytest.raises(InputError, match="Give one of them"):
        with_found_effects(replace(BASE, response=curve), path, stated=())


@pytest.mark.parametrize("parameters", [{"strength": 0.1, "k4": 0.03}, {"strength": -0.02}])
def test_a_fall_off_becomes_a_flat_field(tmp_path, parameters):
    """At the middle, half-way and in the corner it is the law of the forward model; in the corner u as well."""
    path = model_file(tmp_path, "natural_vignetting", parameters, {"strength": 0.01, "k4": 0.02})
    flat = with_found_effects(BASE, path, stated=(), shape=(60, 80)).flat_field
    rho = np.array([0.0, 0.5, 1.0])
    s, k4 = parameters["strength"], parameters.get("k4", 0.0)
    expected = (1.0 + s * rho**2) ** -2.0 * (1.0 - k4 * rho**4)
    assert flat.at(39.5 + 40.0 * rho, 29.5 + 30.0 * rho) == pytest.approx(expected, abs=1e-4)
    assert flat.u_rel == pytest.approx(math.hypot(0.02 / (1.0 + s), 0.02 * bool(k4)))
    with pytest.raises(InputError, match="picture's size"):
        with_found_effects(BASE, path, stated=())


@pytest.mark.parametrize(
    ("found", "world"),
    [
        (FoundEffects(exposure_offset_s=5e-5), {"offset_s": 5e-5}),
        (FoundEffects(black_offset_dn=10.0), {"black": 10.0}),
        (FoundEffects(gain_error_rel=0.02), {"gain_db": 12.0, "real_gain": 12.24}),
        (FoundEffects(temperature_slope_per_k=2e-3), {"t_c": 45.0, "warm": 1.04}),
        (FoundEffects(temperature_slope_per_k=1e-3, temperature_bend_per_k2=1e-4), {"t_c": 45.0, "warm": 1.06}),
        (
            FoundEffects(gains_db=(0.0, 12.0), gain_errors_rel=(0.0, 0.03)),
            {"gain_db": 12.0, "real_gain": 12.0 + 20.0 * math.log10(1.03)},
        ),
        (
            FoundEffects(gains_db=(0.0, 12.0), gain_errors_rel=(0.0, 0.03)),
            {"gain_db": 6.0, "real_gain": 6.0 + 20.0 * math.log10(1.015)},
        ),
        (
            FoundEffects(black_slope_dn=4.0, black_from_db=6.0, black_bend=0.5),
            {"gain_db": 18.0, "gained_black": 4.0 * (10**0.6 - 1.0 + 0.5 * (10**0.6 - 1.0) ** 2)},
        ),
        (FoundEffects(exposure_further_s=2e-5, exposure_above_db=3.0), {"gain_db": 12.0, "gained_s": 2e-5}),
        (FoundEffects(well_a2=0.04, well_a3=0.02, well_e=24500.0), {"bend": (0.04, 0.02)}),
    ],
)
def test_readings_are_corrected_for_what_was_found(found, world):
    """A radiance of 0.5 in a fifth of the calibration's exposure comes out within 0.3 %, and wrong by 1 % without."""
    fixed = {key: value for key, value in world.items() if key in ("offset_s", "black", "bend")}
    known, seen = frames(even(), 2e-3, **fixed), frames(even(0.5), 4e-4, **world)
    right, _ = read(replace(BASE, found=found), known, seen)
    wrong, _ = read(BASE, known, seen)
    assert right.radiance.value == pytest.approx(0.5, rel=3e-3)
    assert abs(wrong.radiance.value / 0.5 - 1.0) > 0.01


def test_known_glare_is_taken_off():
    """0.1 before a surround of 1: 2 % of glare would read it 12 % too bright; the calibration's own counts."""

    def glared(scene, g=0.02):
        return (1.0 - g) * scene + g * scene.mean()

    spot = even(0.3)
    spot[10:30, 10:30] = 1.0
    dim = even(1.0)
    dim[10:30, 10:30] = 0.1
    known, seen = frames(glared(spot)), frames(glared(dim), 2e-3)
    right, _ = read(replace(BASE, found=FoundEffects(glare=0.02)), known, seen)
    wrong, _ = read(BASE, known, seen)
    assert right.radiance.value == pytest.approx(0.1, rel=0.01)
    assert wrong.radiance.value > 0.11


@pytest.mark.parametrize(
    ("effects", "world", "warmer"),
    [
        (FoundEffects(exposure_offset_s=5e-5), {"offset_s": 5e-5}, {}),
        (FoundEffects(temperature_slope_per_k=2e-3), {}, {"t_c": 45.0, "warm": 1.04}),
    ],
)
def test_a_map_is_corrected_as_a_reading_is(effects, world, warmer):
    """With the offset unknown the map would be 12 % too bright; 20 K warmer at 0.2 %/K, 4 %."""
    _, known = read(replace(BASE, found=effects), frames(even(), 2e-3, **world), frames(even(0.5), 4e-4, **world))
    found = merge(frames(even(0.5), 4e-4, **world, **warmer), Setup(CAMERA, LENS, known))
    assert found.radiance.mean() == pytest.approx(0.5, rel=3e-3)


def test_a_map_says_that_it_keeps_a_bend():
    """At full scale z is 0.995: 4 % of it and 2 % of its square."""
    base = replace(BASE, found=FoundEffects(well_a2=0.04, well_a3=0.02, well_e=24500.0))
    _, known = read(base, frames(even(), 2e-3), frames(even(0.5), 4e-4))
    found = merge(frames(even(0.5), 4e-4), Setup(CAMERA, LENS, known))
    assert any("bends by 6 % at full scale" in text for text in found.not_in_u)

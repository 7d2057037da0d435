"""What reconcile found is in the calibration, and readings are corrected for it."""

from __future__ import annotations

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
from radiometer.analysis.patch.reading import read_patch
from radiometer.cli.calibrate_model import with_found_effects
from radiometer.data import Calibration, CameraDescription, FoundEffects, Frame, FrameSettings, LensDescription, Patch
from radiometer.errors import InputError
from simulators.camera_model import CameraModel
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


def frames(radiance, exposure_s=1e-3, *, gain_db=0.0, offset_s=0.0, black=0.0, warm=1.0, real_gain=None, t_c=25.0):
    """Return five noiseless frames of a scene, with what is not stated of them."""
    gain = 10.0 ** ((gain_db if real_gain is None else real_gain) / 20.0)
    dn = radiance * DN_PER_S * (exposure_s + offset_s) * warm * gain + 64.0 + black
    stated = FrameSettings(exposure_s, gain_db, 4.0, 64.0, t_c)
    return [Frame(np.rint(dn).astype(np.uint16), 12, stated)] * 5


def even(radiance=1.0):
    return np.full((40, 40), radiance)


def read(base, calibration_frames, reading_frames):
    scale = scale_by_source(base, calibration_frames, PATCH, KnownSource(1.0, 0.004))
    known = scaled_calibration(base, scale, ())
    now = dt.datetime.fromisoformat(known.created)
    return read_patch(reading_frames, PATCH, known, CAMERA, LENS, now=now), known


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


def test_a_black_level_offset_carries_its_own_uncertainty(tmp_path):
    """In place of ±1 DN."""
    path = model_file(tmp_path, "black_level_offset", {"offset_dn": 1.0}, {"offset_dn": 0.02})
    made = with_found_effects(BASE, path, stated=())
    assert (made.found.black_offset_dn, made.black_level.u_dn) == (1.0, 0.02)


def test_what_the_user_states_stays(tmp_path):
    """--stated comes before what reconcile says of the uncertainty."""
    path = model_file(tmp_path, "veiling_glare", {"share": 0.01}, {"share": 5e-4})
    assert with_found_effects(BASE, path, stated=("glare_u",)).uncertainties.glare_u == BASE.uncertainties.glare_u


def test_what_readings_cannot_be_corrected_for_is_refused(tmp_path):
    """By name, with what can be."""
    path = model_file(tmp_path, "crosstalk", {}, {})
    with pytest.raises(InputError, match="crosstalk"):
        with_found_effects(BASE, path, stated=())


def test_a_law_that_is_a_table_is_refused(tmp_path):
    """A gain error per step is more than one figure: the message says what to do instead of correcting by nothing."""
    table = {"gains_db": (0.0, 12.0), "errors_rel": (0.0, 0.02)}
    path = model_file(tmp_path, "gain_step_error", table, {"error_rel": 1e-3})
    with pytest.raises(InputError, match=r"gain_step_error: is a table \(gains_db, errors_rel\)"):
        with_found_effects(BASE, path, stated=())


def test_an_effect_without_its_uncertainty_is_refused(tmp_path):
    """A correction of unknown worth corrects nothing."""
    path = model_file(tmp_path, "veiling_glare", {"share": 0.01}, {})
    with pytest.raises(InputError, match=r"notes\.u\.share"):
        with_found_effects(BASE, path, stated=())


@pytest.mark.parametrize(
    ("found", "world"),
    [
        (FoundEffects(exposure_offset_s=5e-5), {"offset_s": 5e-5}),
        (FoundEffects(black_offset_dn=10.0), {"black": 10.0}),
        (FoundEffects(gain_error_rel=0.02), {"gain_db": 12.0, "real_gain": 12.24}),
        (FoundEffects(temperature_slope_per_k=2e-3), {"t_c": 45.0, "warm": 1.04}),
    ],
)
def test_readings_are_corrected_for_what_was_found(found, world):
    """A radiance of 0.5 in a fifth of the calibration's exposure comes out within 0.3 %, and wrong by 1 % without."""
    fixed = {key: value for key, value in world.items() if key in ("offset_s", "black")}
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


def test_a_map_is_corrected_for_exposure_and_black_too():
    """The same settings in every pixel; with the offset unknown the map would be 12 % too bright."""
    world = {"offset_s": 5e-5}
    base = replace(BASE, found=FoundEffects(exposure_offset_s=5e-5))
    _, known = read(base, frames(even(), 2e-3, **world), frames(even(0.5), 4e-4, **world))
    found = merge(frames(even(0.5), 4e-4, **world), CAMERA, LENS, known)
    assert found.radiance.mean() == pytest.approx(0.5, rel=3e-3)

"""What was found of a camera, taken off again: an effect planted by hand comes back as the light that was there."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.analysis.signal.model import (
    corrected_frames,
    corrected_settings,
    straightened,
    temperature_factor,
    without_glare,
)
from radiometer.data import Bracket, FoundEffects, Frame, FrameSettings

STATED = FrameSettings(0.01, 12.0, black_level_dn=64.0)


def corrected(settings=STATED, **found):
    return corrected_settings(settings, FoundEffects(**found), 50.0)


def test_found_errors_change_the_settings_of_frames():
    """Exposures, black levels with and without gain, and gains by size and table."""
    found = {"exposure_offset_s": 0.002, "exposure_further_s": 0.003, "exposure_above_db": 6.0}
    shown = [corrected(replace(STATED, gain_db=gain), **found).exposure_s for gain in (0.0, 6.0, 6.1)]
    assert shown == pytest.approx([0.012, 0.012, 0.015])
    assert corrected(exposure_offset_s=-1.0).exposure_s == 1e-9
    assert corrected(black_offset_dn=5.0).black_level_dn == pytest.approx(69.0)
    assert corrected(replace(STATED, black_level_dn=None), black_offset_dn=5.0).black_level_dn == pytest.approx(55.0)
    found = {"black_slope_dn": 10.0, "black_from_db": 6.0206, "black_bend": 0.1}
    shown = [corrected(replace(STATED, gain_db=gain), **found).black_level_dn for gain in (0.0, 6.0206, 18.0618)]
    assert shown == pytest.approx([64.0, 64.0, 103.0], abs=1e-3)
    assert corrected(gain_error_rel=0.05).gain_db == pytest.approx(12.6)
    table = {"gains_db": (0.0, 12.0), "gain_errors_rel": (0.0, 0.1)}
    assert corrected(**table).gain_db == pytest.approx(12.8279, abs=1e-4)
    assert corrected(replace(STATED, gain_db=6.0), **table).gain_db == pytest.approx(6.4238, abs=1e-4)


@given(st.floats(-0.1, 0.2), st.floats(-0.05, 0.05), st.lists(st.floats(0.0, 1000.0), min_size=1, max_size=5))
def test_a_bent_signal_comes_back_straight(a2, a3, light):
    """x electrons of 2 per unit seen as x·(1 − a₂z − a₃z²), z = x over 2000, are x again."""
    found = FoundEffects(well_a2=a2, well_a3=a3, well_e=2000.0)
    true = np.array(light)
    z = true / 1000.0
    seen = true * (1.0 - a2 * z - a3 * z**2)
    assert straightened(seen, found, 2.0) == pytest.approx(true, rel=1e-4, abs=1e-9)


def test_frames_are_corrected_for_what_was_found():
    """A warm sensor reads as a cool one; a bracket stays one."""
    slope, bent = FoundEffects(temperature_slope_per_k=0.001), FoundEffects(temperature_bend_per_k2=1e-4)
    assert temperature_factor(slope, 35.0, 15.0) == pytest.approx(0.99 / 1.01)
    assert temperature_factor(slope, 25.0, 35.0) == pytest.approx(1.01)
    assert temperature_factor(bent, 35.0, 25.0) == pytest.approx(1.0 / 1.01)
    assert [temperature_factor(slope, *pair) for pair in ((None, 25.0), (25.0, None))] == [1.0, 1.0]
    frames = [
        Frame(np.zeros((2, 2), np.uint16), 12, FrameSettings(t, shutter=s))
        for t, s in ((1.0, "open"), (2.0, "open"), (2.0, "closed"))
    ]
    bracket, found = Bracket.from_frames(frames, "here"), FoundEffects(exposure_offset_s=0.5)
    shown = corrected_frames(bracket, found, 64.0)
    assert [one.settings.exposure_s for one in (*shown.light, *shown.dark)] == [1.5, 2.5, 2.5]
    assert (shown.origin, shown.light[0].settings.black_level_dn) == ("here", 64.0)
    assert [one.settings.exposure_s for one in corrected_frames(iter(frames), found, 64.0)] == [1.5, 2.5, 2.5]
    assert corrected_frames(bracket, FoundEffects(), 64.0) is bracket


@given(st.floats(0.0, 0.2), st.floats(0.1, 10.0), st.floats(0.0, 10.0), st.floats(0.0, 2.0))
def test_glare_is_taken_off_patch_and_scale(glare, light, mean, at_calibration):
    """A patch seen as (1 − g)·L + g·M, by a scale got on a source of 1 seen likewise, is L."""
    seen = (1.0 - glare) * light + glare * mean
    source_seen = (1.0 - glare) / (1.0 - glare * at_calibration)  # m₀ = (1 − g)·1 + g·S₀·m₀
    scale = 1.0 / source_seen
    gain, of_surround = without_glare(glare, at_calibration)
    assert gain * seen * scale - of_surround * mean * scale == pytest.approx(light, rel=1e-9)

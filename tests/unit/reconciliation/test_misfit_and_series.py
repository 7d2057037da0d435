"""Uncertainties while structure is left, frames of one setting that differ, and wells that hold more than declared."""

from dataclasses import replace

import numpy as np
import pytest

from radiometer.reconciliation.fit.descent import effect_covariance, fitted_parameters, is_misfit, refit
from radiometer.reconciliation.fit.nuisances import dark_current_is_free
from radiometer.reconciliation.fit.state import reweighted, with_effects
from radiometer.reconciliation.measure.design import Design
from simulators.effects.black_level_drift import BlackLevelDrift
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from testing.reduced import start_of

LADDER = [{"t": float(t), "d": d} for d in (0.9, 0.3) for t in np.geomspace(1e-4, 5e-3, 8)]
DARKS = [{"t": t, "T": warm, "shutter": "closed"} for t in (0.01, 1.0) for warm in (25.0, 40.0)]


def _with_offset(captured):
    return refit(reweighted(refit(with_effects(start_of(captured), [ExposureTimeOffset(offset_s=1e-6)]))))


def test_uncertainties_stay_where_no_structure_is_left(make_capture):
    """A model that is right keeps the covariance of its fit."""
    state = _with_offset(make_capture(3, plan=LADDER))
    assert not is_misfit(state)
    first = state.layout.size + state.weights.size
    assert effect_covariance(state) == pytest.approx(state.fit.covariance[first:, first:])


def test_uncertainties_are_widened_by_structure_along_a_covariate(make_capture):
    """Where light goes in waves of 2 % with the exposure, an offset that is none lies within three of its u."""

    def wavy(image, setting):
        return image * (1.0 + 0.02 * np.sin(2.0 * np.log(setting["t"])))

    state = _with_offset(make_capture(3, plan=LADDER, picture=wavy))
    assert is_misfit(state)
    offset = fitted_parameters(state)["exposure_time_offset"]["offset_s"]
    first = state.layout.size + state.weights.size
    plain = float(np.sqrt(state.fit.covariance[first, first])) * state.parameters.scale[0]
    assert offset.u > 3.0 * plain
    assert abs(offset.value) < 3.0 * offset.u
    assert abs(offset.value) > 3.0 * plain


def test_an_effect_of_temperature_moves_the_first_frame_of_a_series(make_capture):
    """Of frames that warm up by 0.3 K after the first, that one is darker by 0.3 K times the drift."""
    captured = make_capture(1, plan=[{"t": 1e-3}, {"t": 3e-3}])
    entries = captured.header.frames
    warm_c = [30.0 + 0.3 * (number % 4 > 0) + 5.0 * (number // 4) for number in range(len(entries))]
    warming = tuple(replace_temperature(entry, read) for entry, read in zip(entries, warm_c, strict=True))
    state = start_of(replace(captured, header=captured.header.model_copy(update={"frames": warming})))
    drifting = state.model.with_effects([BlackLevelDrift(drift_dn_per_K=2.0)])
    assert drifting.predict(state.nuisance).first == pytest.approx(-0.6, abs=2e-4)  # and a little dark current


def test_declared_dark_current_moves_the_first_frame_of_a_series(make_capture):
    """Dark electrons of 1 s at 25 °C, 1 e-/s doubling in 7 K, differ by 2^(0.1) − 1 when it is 0.7 K warmer."""
    captured = make_capture(1, plan=[{"t": 1.0, "shutter": "closed"}, {"t": 1e-3}])
    entries = captured.header.frames
    warm_c = [25.0 + 0.7 * (number % 4 > 0) + 5.0 * (number // 4) for number in range(len(entries))]
    warming = tuple(replace_temperature(entry, read) for entry, read in zip(entries, warm_c, strict=True))
    state = start_of(replace(captured, header=captured.header.model_copy(update={"frames": warming})))
    dark = state.design.closed
    assert state.prediction.first[dark] == pytest.approx(-(2.0**0.1 - 1.0) / 2.6, rel=1e-6)
    assert DarkCurrent().drifts


def replace_temperature(entry, temperature_c):
    """Return a frame of the header at another temperature."""
    return entry.model_copy(update={"temperature_C": temperature_c})


def test_a_well_that_holds_more_than_declared_limits_nothing(make_capture):
    """Where bright tiles pass the declared full well and keep their noise, light and noise are predicted beyond it."""
    captured = make_capture(2, plan=LADDER)
    header = captured.header
    small = header.model_copy(update={"camera": header.camera.model_copy(update={"full_well_e": 3000.0})})
    state = start_of(replace(captured, header=small))
    assert state.model.passes_well
    bright = state.seen.mean > 64.0 + 4000.0 / 2.6
    assert float(np.min(state.prediction.variance[bright])) > 4000.0 / 2.6**2
    assert not start_of(captured).model.passes_well


def test_darks_at_several_temperatures_tell_the_dark_current_s_whole_law(make_capture):
    """Of a camera of which nothing is stated they leave no nuisance: the dark current is an effect to be named."""
    captured = make_capture(4, plan=DARKS, frames=2)
    bare = captured.header.camera.model_copy(
        update={"conversion_gain_e_per_dn": None, "read_noise_e": None, "dark_current_e_per_s": None}
    )
    header = captured.header.model_copy(update={"camera": bare})
    design = Design.of(header, captured.frames[0].shape)
    assert not dark_current_is_free(design)
    alike = tuple(replace_temperature(entry, 25.0) for entry in header.frames)
    assert dark_current_is_free(Design.of(header.model_copy(update={"frames": alike}), captured.frames[0].shape))

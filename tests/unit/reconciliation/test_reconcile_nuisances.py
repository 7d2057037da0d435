"""What is fitted and never named: errors of stated radiances, a wandering lamp, what no one declared."""

from dataclasses import replace

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, FrameEntry, PatchDescription
from radiometer.reconciliation.descent import effect_covariance, fitted_parameters, is_misfit, refit
from radiometer.reconciliation.design import Design
from radiometer.reconciliation.nuisances import NuisanceLayout, dark_current_is_free
from radiometer.reconciliation.reduce import reduce_frames
from radiometer.reconciliation.repeatability import steady_wander2
from radiometer.reconciliation.separability import limits
from radiometer.reconciliation.state import reweighted, with_effects
from simulators.effects.black_level_drift import BlackLevelDrift
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.gain_step_error import GainStepError
from testing.reduced import start_of

TRIED = np.concatenate([[0.0], np.geomspace(1e-9, 1e-3, 61)])
PIXEL_NOISE = 1e-8  # relative variance of a frame's mean from pixel noise alone


def _layout(values):
    """Return the layout of patches in a row, each with its radiance under `chart` and under `turned`."""
    patches = tuple(
        PatchDescription(
            name=f"p{k}",
            x=8 * k,
            y=0,
            width=8,
            height=8,
            radiance_W_per_sr_m2={"chart": chart, "turned": turned},
            u_rel=0.005,
        )
        for k, (chart, turned) in enumerate(values)
    )
    frames = tuple(FrameEntry(file=f"{n}.png", exposure_s=1e-3, pattern=p) for n, p in enumerate(("chart", "turned")))
    camera = CameraDescription(bit_depth=12)
    header = CaptureHeader(camera=camera, frames=frames, patterns=("chart", "turned"), patches=patches)
    return NuisanceLayout.of(Design.of(header, (8, 8 * len(values))))


def test_numbers_stated_twice_go_with_what_was_measured():
    """With the patch under a turned chart; two patches of one value show nothing."""
    chart, turned = _layout([(1.0, 3.0), (2.0, 2.0), (3.0, 1.0)]).shared
    assert chart[0] == turned[2]
    assert chart[2] == turned[0]
    assert len({*chart.tolist()}) == 3
    chart, turned = _layout([(1.0, 2.0), (1.0, 3.0), (2.0, 1.0)]).shared
    assert chart.tolist() != [chart[0]] * 3
    assert chart[0] == turned[0] or chart[2] == turned[0]
    assert chart[0] != chart[1]


def _deviances(wander, seed):
    """Return −2·ln of the likelihood of ratios with three degrees of freedom, (tried, captures)."""
    rng = np.random.default_rng(seed)
    ratio = (1.0 + np.square(wander) / PIXEL_NOISE) * rng.chisquare(3, wander.size) / 3
    expected = 1.0 + TRIED[:, None] / PIXEL_NOISE
    return np.asarray(3.0 * (ratio / expected + np.log(expected)))


def test_lamps_wander_no_more_than_stated():
    """0.1 % is found, 0.2 % is beyond it, and what long exposures even out is none."""
    exposure = np.geomspace(1e-4, 1e-1, 80)
    found = steady_wander2(TRIED, _deviances(np.full(80, 1e-3), 1), exposure, 1e-3)
    assert found == pytest.approx(1e-6, rel=4 * np.sqrt(2 / (3 * 80)))
    flicker = 1e-3 * np.minimum(1.0, 1e-3 / exposure)
    assert steady_wander2(TRIED, _deviances(flicker, 2), exposure, 1e-3) == 0.0
    assert steady_wander2(TRIED, _deviances(np.zeros(80), 3), exposure, 1e-3) == 0.0
    one_of_them = np.where(np.arange(80) == 40, 3e-3, 0.0)
    assert steady_wander2(TRIED, _deviances(one_of_them, 3), exposure, None) == 0.0
    weak, strong = _deviances(np.full(80, 2e-3), 4), _deviances(np.full(80, 5e-3), 4)
    assert steady_wander2(TRIED, weak, exposure, 1e-3) <= (1.3e-3) ** 2
    assert steady_wander2(TRIED, weak, exposure, None) == pytest.approx(4e-6, rel=4 * np.sqrt(2 / (3 * 80)))
    assert steady_wander2(TRIED, strong, exposure, None) <= 3e-3**2


def test_camera_of_stated_noise_has_no_dark_current_but_a_stated_one():
    """A camera of which nothing is stated may have any dark current; else an undeclared one is something to name."""

    def free(**stated):
        camera = CameraDescription(bit_depth=12, **stated)
        frames = (FrameEntry(file="0.tif", exposure_s=0.01),)
        return dark_current_is_free(Design.of(CaptureHeader(camera=camera, frames=frames), (96, 144)))

    assert free()
    assert not free(conversion_gain_e_per_dn=2.6, read_noise_e=2.4)
    assert not free(dark_current_e_per_s=1.0)


@pytest.mark.slow
def test_table_that_was_found_has_a_limit(make_capture):
    """The limit of an effect in the form of a table is that of its largest entry, near that of its law."""
    captured = make_capture(3)
    state = start_of(captured)
    entries = {"gain_step_error": GainStepError}
    law = limits(state, entries)["gain_step_error"].amplitude
    table = GainStepError(gains_db=(0.0, 6.0, 18.0), errors_rel=(0.0, 0.01, -0.02))
    named = replace(state, model=state.model.with_effects([table]))
    found = limits(named, entries)["gain_step_error"]
    assert 0.1 * law < found.amplitude < 10 * law


@pytest.mark.slow
def test_darks_stand_for_a_black_level_that_is_not_stated(make_capture):
    """Of well lit frames the light that wanders is reported as well from darks as from a stated black level."""
    captured = make_capture(4)
    header = captured.header
    untold = header.model_copy(
        update={
            "camera": header.camera.model_copy(update={"black_level_dn": None}),
            "frames": tuple(entry.model_copy(update={"black_level_dn": None}) for entry in header.frames),
        }
    )
    units = []
    for known in (header, untold):
        design = Design.of(known, captured.frames[0].shape)
        seen, _ = reduce_frames(design, captured.frames.__getitem__)
        units.append(seen.common_unit[~design.closed & (design.exposure_s * design.source_level > 1e-4)])
    np.testing.assert_allclose(units[1], units[0], rtol=0.02)


# Uncertainties while structure is left, frames of one setting that differ, and wells that hold more than declared.


LADDER = [{"t": float(t), "d": d} for d in (0.9, 0.3) for t in np.geomspace(1e-4, 5e-3, 8)]
DARKS = [{"t": t, "T": warm, "shutter": "closed"} for t in (0.01, 1.0) for warm in (25.0, 40.0)]


def _with_offset(captured):
    return refit(reweighted(refit(with_effects(start_of(captured), [ExposureTimeOffset(offset_s=1e-6)]))))


def test_structure_along_a_covariate_alone_widens_uncertainties(make_capture):
    """A right model keeps its covariance; under waves of 2 % an offset that is none lies within 3 u."""
    state = _with_offset(make_capture(3, plan=LADDER))
    assert not is_misfit(state)
    first = state.layout.size + state.weights.size
    assert effect_covariance(state) == pytest.approx(state.fit.covariance[first:, first:])

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


def test_temperature_moves_the_first_frame_of_a_series(make_capture):
    """By 0.3 K times the drift; declared dark electrons by 2^(0.1) − 1 at 0.7 K."""
    captured = make_capture(1, plan=[{"t": 1e-3}, {"t": 3e-3}])
    entries = captured.header.frames
    warm_c = [30.0 + 0.3 * (number % 4 > 0) + 5.0 * (number // 4) for number in range(len(entries))]
    warming = tuple(replace_temperature(entry, read) for entry, read in zip(entries, warm_c, strict=True))
    state = start_of(replace(captured, header=captured.header.model_copy(update={"frames": warming})))
    drifting = state.model.with_effects([BlackLevelDrift(drift_dn_per_K=2.0)])
    assert drifting.predict(state.nuisance).first == pytest.approx(-0.6, abs=2e-4)  # and a little dark current
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

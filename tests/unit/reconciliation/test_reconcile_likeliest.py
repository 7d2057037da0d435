"""Where the search for a flicker begins, and what charge that neighbours exchange does to the means of lines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import convolve

from radiometer.reconciliation.fit.descent import UnfitError, included
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import reduce_frames
from radiometer.reconciliation.search.screening import StartPool, of_seen_codes
from radiometer.reconciliation.shared_errors import mixing_of_bands, mixing_of_lines, renewed_patterns
from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.brighter_fatter import push_of
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext
from simulators.effects.missing_codes import MissingCodes
from simulators.effects.pwm_flicker import PwmFlicker
from testing.reduced import start_of


@pytest.mark.slow
def test_search_for_a_flicker_begins_near_it(make_capture: Callable[..., Any]) -> None:
    """A sine of 9 % at 480 Hz, up to three periods in an exposure, is met within a hundredth of its frequency."""
    rng = np.random.default_rng(11)

    def flickering(image: Any, setting: Any) -> Any:
        wave = 0.09 * np.sinc(480.0 * setting["t"]) * np.cos(2 * np.pi * rng.random())
        return image * (1.0 + wave)

    state = start_of(make_capture(5, picture=flickering))
    (first, *_) = StartPool().likeliest(state, PwmFlicker)
    assert isinstance(first, PwmFlicker)
    assert first.frequency_hz == pytest.approx(480.0, rel=0.02)
    if first.duty == 0:
        assert first.modulation == pytest.approx(0.09, rel=0.4)


@pytest.mark.slow
@pytest.mark.parametrize(("step", "possible"), [(2, {2.0}), (4, {2.0**power for power in range(1, 9)})])
def test_codes_that_occur_rule_out_a_coarser_step(
    make_capture: Callable[..., Any], step: int, possible: set[float]
) -> None:
    """Of all steps only those remain that leave no code empty which occurs, as far as periods up to 5 tell."""
    captured = make_capture(7)
    coarse = [replace(frame, dn=frame.dn - frame.dn % step) for frame in captured.frames]
    seen, _ = reduce_frames(Design.of(captured.header, coarse[0].shape), coarse.__getitem__)
    left = of_seen_codes(seen, MissingCodes.starts(start_of(captured).model.context))
    assert {effect.step_codes for effect in left if effect.kept_codes == 1.0} == possible


@pytest.mark.slow
def test_charge_that_neighbours_exchange_stays_in_the_means_of_lines(make_capture: Callable[..., Any]) -> None:
    """Means of lines of mixed noise scatter as predicted, over what the mixed pixels' own variance would give."""
    state = start_of(make_capture(6))
    height, width = state.design.tiles[0].height, state.design.tiles[0].width
    x, y = 0.02, 0.01
    kernel = np.array([[0, y, 0], [x, 1 - 2 * x - 2 * y, x], [0, y, 0]])
    noise = convolve(np.random.default_rng(2).standard_normal((height * 200, width * 200)), kernel, mode="wrap")
    variance = float(noise.var())
    own = kernel[1, 1]
    ones = np.ones_like(state.prediction.variance)
    mixed = replace(state.prediction, mixed_x=2 * x * own / variance * ones, mixed_y=2 * y * own / variance * ones)
    rows = noise.reshape(-1, width).mean(axis=1).var() * width / variance - 1.0
    predicted = mixing_of_lines(mixed, state.design, "row_temporal")
    assert rows == pytest.approx(float(predicted[0]), abs=4 * np.sqrt(2 * width / noise.size))
    # Slow bands keep more of it than fast ones; order k of n rows is k/(2n) periods per row.
    bands = mixing_of_bands(mixed, state.design)[0]
    of_rows = noise.reshape(noise.shape[0], -1, width).mean(axis=2)
    power = (np.abs(np.fft.rfft(of_rows, axis=0)) ** 2).mean(axis=1) * width / noise.shape[0] / variance
    for order in (1, bands.size):
        middle = order / state.design.shape[0] * (power.size - 1)
        near = slice(max(int(middle) - 40, 1), int(middle) + 40)
        uncertainty = 1.0 / np.sqrt(len(power[near]) * of_rows.shape[1])
        assert float(power[near].mean()) - 1.0 == pytest.approx(float(bands[order - 1]), abs=4 * uncertainty)


@pytest.mark.slow
def test_charge_that_is_pushed_far_stays_in_the_means_of_lines(make_capture: Callable[..., Any]) -> None:
    """Flats with covariances of many lags: rows, columns, bands of rows and tiles scatter as told, to 4 sigma."""
    state = start_of(make_capture(6))
    height, width = state.design.tiles[0].height, state.design.tiles[0].width
    push = push_of(8, 0.56, 0.45)
    kernel, middle = push.kernel, push.kernel.shape[0] // 2
    shape = (height * 200, width * 200)
    wide = np.zeros(shape)
    wide[: kernel.shape[0], : kernel.shape[1]] = kernel
    power = 1.0 + 0.2 / 8.0 * 2.0 * np.fft.rfft2(np.roll(wide, (-middle, -middle), (0, 1))).real
    white = np.fft.rfft2(np.random.default_rng(2).standard_normal(shape))
    noise = np.fft.irfft2(white * np.sqrt(power), s=shape)
    whole = np.fft.irfft2(power, s=shape)  # covariance by lag
    variance, x, y = (float(whole[at]) for at in ((0, 0), (0, 1), (1, 0)))
    sums = {
        "beyond_x": whole[0, 2:20].sum(),
        "beyond_y": whole[2:20, 0].sum(),
        "beyond_rows": whole[1:20].sum() - y,
    }
    ones = np.ones_like(state.prediction.variance)
    figures = {name: value / variance * ones for name, value in ({"mixed_x": x, "mixed_y": y} | sums).items()}
    mixed = replace(state.prediction, **figures)
    rows = noise.reshape(-1, width).mean(axis=1).var() * width / variance - 1.0
    columns = noise.reshape(-1, height, shape[1]).mean(axis=1).var() * height / variance - 1.0
    stated_rows = float(mixing_of_lines(mixed, state.design, "row_temporal")[0])
    share = state.prediction.variance[0] / state.design.frame_count[0] / state.prediction.spatial[0]
    stated_columns = float(mixing_of_lines(mixed, state.design, "columns")[0] / share.mean())
    assert rows == pytest.approx(stated_rows, abs=4 * np.sqrt(2 * width / noise.size))
    assert columns == pytest.approx(stated_columns, abs=4 * np.sqrt(2 * height / noise.size))
    bands = mixing_of_bands(mixed, state.design)[0]
    of_rows = noise.reshape(noise.shape[0], -1, width).mean(axis=2)
    seen = (np.abs(np.fft.rfft(of_rows, axis=0)) ** 2).mean(axis=1) * width / noise.shape[0] / variance
    at = round(0.5 / state.design.shape[0] * (seen.size - 1))  # the slowest band
    near = slice(max(at - 40, 1), at + 40)
    assert float(seen[near].mean()) - 1.0 == pytest.approx(
        float(bands[0]), abs=4 / np.sqrt(len(seen[near]) * of_rows.shape[1])
    )
    assert stated_rows > 2.0 * x / variance * 1.02  # the nearest alone tell less


@pytest.mark.slow
def test_captures_of_one_setting_tell_its_own_pattern_once(make_capture: Callable[..., Any]) -> None:
    """Means scatter by the pattern over the root of their pixels; m captures of one setting by √m of that each."""
    state = start_of(make_capture(8))
    assert renewed_patterns(state.design, state.seen, state.prediction) == {}
    pattern = replace(state.prediction, renewed_variance=4.0 * np.ones_like(state.prediction.mean))
    found = renewed_patterns(state.design, state.seen, pattern)
    number = np.array([np.sum(state.design.setting_id == one) for one in state.design.setting_id])
    np.testing.assert_allclose(found["mean"], 2.0 * np.sqrt(number[:, None] / state.seen.pixels))
    assert np.all(found["spatial"][number == 1] == 0.0)
    assert np.all(found["spatial"][number > 1] > 0.0)
    assert set(found) == {"mean", "slope_x", "slope_y", "spatial"}


@dataclass(frozen=True)
class _Impossible(Scaling):
    """Scales light by what is no number."""

    name = "impossible"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    trials = ({"size": 0.5},)
    fitted = ("size",)
    size: float = parameter(0.0, "1", -1.0, 1.0, source="a test")

    def factor(self, context: ExposureContext) -> Any:
        """Return the root of a negative number."""
        with np.errstate(invalid="ignore"):
            return np.sqrt(-abs(self.size) * np.ones_like(context.settings.exposure_s))


@pytest.mark.slow
def test_effect_that_cannot_be_is_refused_by_name(make_capture: Callable[..., Any]) -> None:
    """Where an effect leads to what no camera does, the search is told which it was, and goes on without it."""
    state = start_of(make_capture(6))
    with pytest.raises(UnfitError, match="impossible"):
        included(state, _Impossible(0.5))

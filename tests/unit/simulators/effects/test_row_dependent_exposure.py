"""An exposure that changes from row to row, held against a maker's radiometric model and by draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simulators.chain.camera_model import CameraModel
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.parasitic_light_sensitivity import ParasiticLightSensitivity
from simulators.effects.row_dependent_exposure import RowDependentExposure
from testing.effect_context import effect_context

ROWS = 96


def _at(exposure_s: float) -> ExposureContext:
    context = effect_context()
    geometry = FrameGeometry.of_image(40, ROWS)
    return replace(context, settings=replace(context.settings, exposure_s=exposure_s), geometry=geometry)


@pytest.mark.parametrize("exposure_s", [158e-6, 472.5e-6, 1.8e-3])
def test_rows_are_exposed_as_the_maker_s_model_says(exposure_s: float) -> None:
    """For L ∝ V/(t + a₂·y − a₃·t·y) the digital value of an even field goes as (t + a₂·y − a₃·t·y)/t in row y."""
    a2, a3 = 9.2e-8 * 10, 1.58e-5 * 10  # a RedEdge's, per row of a tenth of its rows
    y = np.arange(ROWS)
    reported = (exposure_s + a2 * y - a3 * exposure_s * y) / exposure_s
    effect = RowDependentExposure(added_s=a2 * (ROWS - 1), lost_share=a3 * (ROWS - 1))
    factor = np.asarray(effect.factor(_at(exposure_s)))
    np.testing.assert_allclose(np.ravel(factor), reported, rtol=1e-12)


def test_frames_have_rows_of_that_light() -> None:
    """The last tenth of the rows of 40 frames against the first tenth, within 5 sigma of the shot noise."""
    context, effect = _at(1e-3), RowDependentExposure(added_s=-2e-4, lost_share=0.05)
    model = CameraModel.ideal(context.camera, context.lens).with_effect(effect)
    scene = np.full((ROWS, 40), 0.5 * _half_full(context))
    ideal = model.without_effect(effect.name).moments(scene, context)
    black = context.settings.black_level_dn or 0.0
    dn = np.mean([model.sample(scene, context, (n,)).dn for n in range(40)], axis=0)
    first, last = dn[:10], dn[-10:]
    plain = float(np.mean(ideal.mean)) - black
    u = float(np.sqrt(np.mean(ideal.variance) / 40 / first.size)) / plain
    down = np.arange(ROWS) / (ROWS - 1)
    reported = 1.0 - 0.25 * down
    assert (first.mean() - black) / plain == pytest.approx(reported[:10].mean(), abs=5 * u)
    assert (last.mean() - black) / plain == pytest.approx(reported[-10:].mean(), abs=5 * u)


def _half_full(context: ExposureContext) -> float:
    model = CameraModel.ideal(context.camera, context.lens)
    lit = float(np.mean(model.moments(np.ones((ROWS, 40)), context).mean))
    dark = float(np.mean(model.moments(np.zeros((ROWS, 40)), context).mean))
    return 2000.0 / (lit - dark)


def test_no_row_is_exposed_for_less_than_nothing() -> None:
    """Where more time is taken away than there is, the row stays dark."""
    factor = np.asarray(RowDependentExposure(added_s=-2e-4).factor(_at(1e-4)))
    assert factor.min() == 0.0
    assert factor.max() == 1.0


def test_time_alone_is_what_leaking_light_does() -> None:
    """Without a share that goes with the exposure it is the leak's equation: no data can tell them apart."""
    context = _at(3e-4)
    row = np.asarray(RowDependentExposure(added_s=1e-5).factor(context))
    leak = np.asarray(ParasiticLightSensitivity(leak_s=1e-5).factor(context))
    np.testing.assert_allclose(row, leak, rtol=1e-7)


def test_a_leak_takes_no_light_away() -> None:
    """The leak's range begins at nothing; the exposure of rows may go either way."""
    leak = next(entry for entry in ParasiticLightSensitivity.parameters() if entry.name == "leak_s")
    added = next(entry for entry in RowDependentExposure.parameters() if entry.name == "added_s")
    assert leak.low == 0.0
    assert added.low < 0.0 < added.high

"""How long a full frame takes."""

from __future__ import annotations

import time

import numpy as np
import pytest

from radiometer.data import FrameSettings, LensDescription
from radiometer.devices import CameraPreset
from simulators.camera_model import CameraModel
from simulators.effects.context import FrameGeometry


@pytest.mark.slow
def test_full_frame_takes_less_than_three_tenths_of_a_second() -> None:
    """Best of five full 1616 × 1240 frames with cos⁴ and exact Poisson noise (processor time)."""
    model = CameraModel.ideal(
        CameraPreset.shipped("BFS-U3-19S4M").camera,
        LensDescription(focal_length_mm=16, f_number=4.0, vignetting="cos4"),
    )
    geometry = FrameGeometry.of_image(1616, 1240)
    context = model.context(FrameSettings(0.01, f_number=4.0), geometry)
    scene = np.linspace(0.0, 1.0, 1616 * 1240, dtype=np.float32).reshape(geometry.shape)
    durations = []
    for frame in range(5):
        started = time.process_time()
        model.sample(scene, context, (frame,))
        durations.append(time.process_time() - started)
    assert min(durations) < 0.3

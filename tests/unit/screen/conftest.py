"""A calibrated screen to work on."""

import numpy as np
import pytest

from radiometer.data import Provenance
from radiometer.screen import ChannelCurve, ScreenCalibration


@pytest.fixture
def grey() -> ChannelCurve:
    """Return a grey curve of 17 levels: L = 1e-4 + 0.7·v^2.2, each level good to 0.1 %."""
    levels = tuple(round(float(n)) for n in np.linspace(0, 255, 17))
    values = tuple(1e-4 + 0.7 * (n / 255) ** 2.2 for n in levels)
    return ChannelCurve("grey", levels, values, tuple(1e-3 * v for v in values), 0.01, 320.0, 700.0, "white_led")


@pytest.fixture
def screen(grey: ChannelCurve) -> ScreenCalibration:
    """Return a calibration that holds it."""
    return ScreenCalibration(
        "desk",
        {"grey": grey},
        "22500001",
        "2026-11-21T12:00:00.000000Z",
        provenance=Provenance("test", assumptions=("a",)),
    )

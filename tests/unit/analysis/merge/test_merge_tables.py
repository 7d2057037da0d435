"""What the tables of a merge say at any level is what the signal model says there."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.merge.frames import frame_terms
from radiometer.analysis.merge.tables import merge_tables
from radiometer.analysis.signal.situation import situation_of
from radiometer.data import (
    BlackLevel,
    Calibration,
    CameraDescription,
    FrameSettings,
    LensDescription,
    ResponseCurve,
    Scale,
    SensorNoise,
)
from radiometer.data.setup import Setup

CODES = np.arange(256)
TIMES = (1.0, 2.0, 4.0)
CAMERA, LENS = CameraDescription(bit_depth=8), LensDescription()
NOISE = SensorNoise(conversion_gain_e_per_dn=8000.0 / 255.0, read_noise_e=6.0, full_well_e=8000.0, post_curve_dn2=0.4)


@pytest.mark.parametrize("gain_db", [0.0, 6.0])
def test_every_code_has_its_own_doubt_and_variance(gain_db):
    """A curve M = 255·x^(1/2.2) whose u grows from 1 % at black to 5 %, and to 20 % at white: to 2 % of them."""
    with np.errstate(divide="ignore"):
        g = 2.2 * np.log(CODES / 255.0)
    u_log = np.linspace(0.01, 0.05, 256)
    u_log[-1] = 0.2
    curve = ResponseCurve(g, u_log, absolute=True, valid_dn=(1, 254))
    scale = Scale(value=1.0, u_rel=0.0, method="relative")
    calibration = Calibration(CAMERA, LENS, scale, curve, NOISE, BlackLevel(dn=0.0, u_dn=0.0))
    situation = situation_of(Setup(CAMERA, LENS, calibration))
    settings = [FrameSettings(seconds, gain_db) for seconds in TIMES]
    tables = merge_tables([frame_terms(s, situation, (), through_lens=False) for s in settings], situation.model)
    codes = np.array([8.0, 20.0, 90.0, 200.0, 253.0, 254.5, 255.0])
    gain = 10.0 ** (gain_db / 20.0)
    at_0_db = np.interp(codes, CODES, np.exp(g))  # between two codes the model is a straight line
    variance, u_rel = tables.variance(np.tile(at_0_db / gain, (len(TIMES), 1)))
    for k, one in enumerate(settings):
        assert u_rel[k] == pytest.approx(np.interp(codes, CODES, u_log), rel=0.02)
        assert variance[k] == pytest.approx(situation.model.variance(at_0_db / gain, one), rel=0.02)

"""Calibrations of a relative scale, exactly known: what a map or a reading rests on where its noise is tested."""

from __future__ import annotations

from typing import Any

from radiometer.data import BlackLevel, Calibration, CameraDescription, LensDescription, Scale, SensorNoise


def relative_calibration(camera: CameraDescription, noise: SensorNoise, **changes: Any) -> Calibration:
    """Return a calibration by which a signal of 1 DN per s is 1, with black at 0 DN; `changes` go before."""
    scale = Scale(value=1.0, u_rel=0.0, method="relative")
    known = {"lens": LensDescription(), "response": None, "black_level": BlackLevel(dn=0.0, u_dn=0.0)}
    return Calibration(camera=camera, scale=scale, noise=noise, **known | changes)

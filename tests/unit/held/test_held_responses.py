"""Response curves of small stacks by every method, their diagnostics, and what follows from a curve."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from radiometer.analysis.response.auto import recover_response_auto
from radiometer.analysis.response.compare import compare_methods
from radiometer.analysis.response.debevec1997 import recover_response_debevec1997
from radiometer.analysis.response.displacement import find_displacement
from radiometer.analysis.response.dynamic_range import RangePoint, dynamic_range, with_dynamic_range
from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.analysis.response.limits import find_limits
from radiometer.analysis.response.linear_spline import recover_response_linear_spline
from radiometer.analysis.response.mitsunaga1999 import recover_response_mitsunaga1999
from radiometer.analysis.response.pixel_noise import pixel_noise
from radiometer.analysis.response.robertson1999 import recover_response_robertson1999
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve
from tests.unit.held.figures import FITS, digest, moved

METHODS: dict[str, Callable[[Bracket], ResponseEstimate]] = {
    "auto": recover_response_auto,
    "debevec1997": recover_response_debevec1997,
    "mitsunaga1999": recover_response_mitsunaga1999,
    "robertson1999": recover_response_robertson1999,
    "linear_spline": recover_response_linear_spline,
}


@cache
def stack(bits: int, exponent: float, errors: tuple[float, ...], fog: int = 0) -> Bracket:
    """Return six frames of a scene over six e-folds behind a power, with exposures that are not quite as labelled."""
    rng = np.random.default_rng([bits, len(errors)])
    rows, columns = np.mgrid[:64, :80]
    log_radiance = -6.0 * columns / 80 + 0.4 * np.sin(7 * rows / 64) + 0.1 * rng.standard_normal((64, 80))
    frames = []
    for k, error in enumerate(errors):
        light = np.exp(log_radiance) * 2.0 ** (k - 1) * (1.0 + error)
        electrons = rng.poisson(np.minimum(light, 20.0) * 9000.0) + 3.0 * rng.standard_normal(light.shape)
        value = np.clip(electrons / 9000.0, 0.0, 1.0) ** exponent
        dn = np.clip(np.rint(fog + value * (2**bits - 1 - fog)), 0, 2**bits - 1)
        stored = dn.astype(np.uint8 if bits <= 8 else np.uint16)
        frames.append(Frame(stored, bits, FrameSettings(1e-3 * 2.0**k), extra={"file": f"{k}.png"}))
    return Bracket.from_frames(frames)


STEADY, WRONG = (0.0,) * 6, (0.0, 0.01, -0.02, 0.0, 0.015, 0.0)
STACKS: dict[str, Callable[[], Bracket]] = {
    "eight_bits": lambda: stack(8, 1 / 2.2, STEADY),
    "eight_bits_wrong_times": lambda: stack(8, 0.6, WRONG),
    "fog": lambda: stack(8, 0.5, STEADY, 14),
    "twelve_bits": lambda: stack(12, 0.8, STEADY[:5]),
}


@cache
def estimate(method: str, of: str) -> ResponseEstimate:
    return METHODS[method](STACKS[of]())


def of_curve(curve: ResponseCurve) -> dict[str, Any]:
    """Return the figures of a curve: whole by digests, and ten places."""
    places = np.linspace(0, curve.log_exposure.size - 1, 12).astype(int)
    return {
        "g": digest(curve.log_exposure),
        "u": digest(curve.u_log_exposure),
        "at": places.tolist(),
        "g there": curve.log_exposure[places].tolist(),
        "u there": curve.u_log_exposure[places].tolist(),
        "valid_dn": list(curve.valid_dn or ()),
        "absolute": curve.absolute,
    }


# Every method once on plain frames, and those that search longest on two stacks in which they have something to find.
TRIED = [*((name, "eight_bits") for name in METHODS)]
TRIED += [("debevec1997", "fog"), ("linear_spline", "twelve_bits")]
DEAR = pytest.param("auto", "eight_bits_wrong_times", marks=pytest.mark.slow)  # its lines are taken by others as well


@pytest.mark.parametrize(("method", "of"), [*TRIED, DEAR])
def test_a_response_is_as_it_was(method, of):
    """Curve, u and diagnostics."""
    found = estimate(method, of)
    told = found.to_mapping()
    told["notes"] = len(told["notes"])
    assert not moved(f"responses/{of}_{method}", {"curve": of_curve(found.curve), **told}, rel=10 * FITS)
    steps = len(STACKS[of]().light) - 1
    assert found.exposure_ratios.shape == found.u_exposure_ratios.shape == (steps,)


def test_what_follows_from_a_curve_is_as_it_was():
    """Limits of values, noise of single pixels, displacement, disagreement of methods, and the dynamic range."""
    bracket, curve = stack(8, 1 / 2.2, STEADY), estimate("debevec1997", "eight_bits").curve
    noise, shift = pixel_noise(bracket, curve), find_displacement(bracket, curve)
    points = [RangePoint(30.0, 8e-3, 127.0), RangePoint(220.0, 2e-3, 118.0), RangePoint(90.0, 5e-3)]
    spread = dynamic_range(curve, points, 4e-3, 128.0)
    limits = find_limits([stack(8, 0.5, STEADY, 14)])
    told = {
        "limits": {name: getattr(limits, name) for name in type(limits).__dataclass_fields__},
        "noise": {name: getattr(noise, name) for name in type(noise).__dataclass_fields__},
        "displacement": [shift.px, shift.u_px],
        "disagreement": [one.to_mapping() for one in compare_methods([estimate(m, "eight_bits") for m in METHODS])],
        "dynamic range": spread.to_mapping(),
        "curve of that range": of_curve(with_dynamic_range(curve, spread)),
    }
    assert not moved("responses/what_follows", told, rel=10 * FITS)

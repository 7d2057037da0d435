"""Stacks through known responses, made here from nothing that the analysis uses, and the samples of one."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from radiometer.analysis.response.samples import ResponseSamples, gather_samples
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve

Response = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def _sigmoid(exposure: NDArray[np.float64]) -> NDArray[np.float64]:
    power = exposure**0.9
    return power / (power + 0.18**0.9) * (1 + 0.18**0.9)


def _tone_curve(seed: int) -> Response:
    """A gamma with gentle bends of its own, as cameras apply it."""
    rng = np.random.default_rng(seed)
    gamma, bends = rng.uniform(1.6, 2.6), rng.normal(0.0, 0.02, 12)

    def response(exposure: NDArray[np.float64]) -> NDArray[np.float64]:
        plain = exposure ** (1 / gamma)
        return plain + sum(bend * np.sin(np.pi * k * plain) / k for k, bend in enumerate(bends, start=1))

    return response


def _film_curve(seed: int) -> Response:
    """A gamma drawn through points whose steps scatter by 5 %, as curves measured on film and cameras have them."""
    rng = np.random.default_rng(100 + seed)
    steps = rng.lognormal(0.0, 0.05, 24)
    value = np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
    return PchipInterpolator(np.linspace(0.0, 1.0, value.size) ** rng.uniform(1.6, 2.6), value)


# Exposure and value of a curve with kinks and near-plateaus, as some films and enhanced pictures have.
_KINKS = PchipInterpolator(
    [0.0, 0.04, 0.07, 0.09, 0.15, 0.21, 0.26, 0.35, 0.42, 0.60, 1.0],
    [0.0, 0.23, 0.33, 0.37, 0.52, 0.58, 0.60, 0.72, 0.74, 0.89, 1.0],
)


def _toe(exposure: NDArray[np.float64]) -> NDArray[np.float64]:
    """A film's: dark below, steep about a quarter of full exposure, flat above."""
    steep = (exposure / 0.27) ** 1.9
    return steep / (1.0 + steep) * (1.0 + 0.27**1.9)


RESPONSES: dict[str, Response] = {
    **{f"tone{seed}": _tone_curve(seed) for seed in range(8)},
    **{f"film{seed}": _film_curve(seed) for seed in range(10)},
    "gamma": lambda exposure: exposure ** (1 / 2.2),
    "linear": lambda exposure: exposure,
    "sigmoid": _sigmoid,
    "kinked": _KINKS,
    "toe": _toe,
}


@cache
def _stack(
    response: str,
    *,
    bit_depth: int = 12,
    frames: int = 9,
    shape: tuple[int, int] = (192, 256),
    seed: int = 1,
    time_errors: tuple[tuple[int, float], ...] = (),
) -> Bracket:
    """Return frames of a scene that runs smoothly over some 6 e-folds, with shot and read noise before the curve."""
    full_well_e, ratio = 10_500.0, 2.0
    rng = np.random.default_rng(seed)
    height, width = shape
    y, x = np.mgrid[:height, :width]
    log_radiance = -6.2 * x / width + 0.4 * np.sin(7 * y / height) + 0.2 * rng.standard_normal(shape)
    result = []
    for index in range(frames):
        relative = ratio ** (index - 1.5) * dict(time_errors).get(index, 1.0)
        electrons = rng.poisson(np.minimum(np.exp(log_radiance) * relative, 50.0) * full_well_e)
        exposure = np.clip((electrons + 2.5 * rng.standard_normal(shape)) / full_well_e, 0.0, 1.0)
        numbers = np.round(RESPONSES[response](exposure) * (2**bit_depth - 1))
        stored = numbers.astype(np.uint8 if bit_depth <= 8 else np.uint16)
        result.append(Frame(stored, bit_depth, FrameSettings(1e-3 * ratio**index), extra={"file": f"{index:04}.png"}))
    return Bracket.from_frames(result, origin="simulated")


@pytest.fixture(scope="session")
def make_stack() -> Callable[..., Bracket]:
    """Return the maker of simulated brackets, which makes each once."""
    return _stack


@pytest.fixture(scope="session")
def true_log_exposure() -> Callable[[str, int], NDArray[np.float64]]:
    """Return the function (response, bit depth) -> ln H at every digital number, gauge 0 in the middle."""

    @cache
    def values(response: str, bit_depth: int) -> NDArray[np.float64]:
        full_scale = 2**bit_depth - 1
        exposure = np.concatenate([[0.0], np.logspace(-8, 0, 400_001)])
        numbers = RESPONSES[response](exposure) * full_scale
        inverse = np.interp(np.arange(1, full_scale + 1), numbers, exposure)
        g = np.concatenate([[-np.inf], np.log(inverse)])
        return g - g[2 ** (bit_depth - 1)]

    return values


@pytest.fixture(scope="session")
def inner_error(
    true_log_exposure: Callable[[str, int], NDArray[np.float64]],
) -> Callable[[ResponseCurve, str], NDArray]:
    """Return the function (curve, response) -> error of ln H over 5–95 % of the digital numbers."""

    def errors(curve: ResponseCurve, response: str) -> NDArray[np.float64]:
        full_scale = 2**curve.bit_depth - 1
        inside = slice(int(np.ceil(0.05 * full_scale)), int(0.95 * full_scale) + 1)
        return (curve.log_exposure - true_log_exposure(response, curve.bit_depth))[inside]

    return errors


@pytest.fixture(scope="session")
def samples() -> ResponseSamples:
    """Return samples of a straight line over exposures of 0.5, 1, 2 and 4 s."""
    radiance = np.exp(np.random.default_rng(1).uniform(-4.0, 0.0, (64, 64)))
    times = (0.5, 1.0, 2.0, 4.0)
    frames = [Frame(np.clip(np.round(radiance * t * 250), 0, 255).astype(np.uint8), 8, FrameSettings(t)) for t in times]
    return gather_samples(Bracket.from_frames(frames))

"""Brackets through known response curves, made without anything that the analysis uses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiometer.data import Bracket, Frame, FrameSettings

Array = NDArray[np.float64]
DORF = Path(__file__).resolve().parents[2] / "shared" / "data" / "response_curves" / "dorf_curves.npz"
FULL_WELL_E, READ_NOISE_E = 10_500.0, 2.5


def response_curves() -> Iterator[tuple[str, Array, Array]]:
    """Yield (name, exposure, brightness), both 0 to 1: the DoRF curves where present, else parametric ones."""
    if DORF.exists():
        stored = np.load(DORF)
        for index, brightness in enumerate(stored["brightness"].astype(np.float64)):
            yield f"dorf{index:03}", stored["irradiance"].astype(np.float64), brightness
        return
    exposure = np.linspace(0, 1, 1024)
    for gamma in (1.0, 1.4, 1.8, 2.2, 2.6):
        yield f"gamma{gamma}", exposure, exposure ** (1 / gamma)
    for centre in (0.05, 0.1, 0.2, 0.4):
        yield f"sigmoid{centre}", exposure, exposure / (exposure + centre) * (1 + centre)


def make_stack(
    exposure: Array,
    brightness: Array,
    *,
    bit_depth: int,
    seed: int,
    stops: Sequence[float] = range(9),
    shape: tuple[int, int] = (192, 256),
) -> Bracket:
    """Return frames at given stops of a textured scene of some 9 stops, shot and read noise before the curve."""
    rng = np.random.default_rng(seed)
    height, width = shape
    y, x = np.mgrid[:height, :width]
    log_radiance = -6.2 * x / width + 0.4 * np.sin(7 * y / height) + 0.2 * rng.standard_normal(shape)
    full_scale = 2**bit_depth - 1
    stack = []
    for stop in stops:
        electrons = rng.poisson(np.minimum(np.exp(log_radiance) * 2.0 ** (stop - 1.5), 50.0) * FULL_WELL_E)
        light = (electrons + READ_NOISE_E * rng.standard_normal(shape)) / FULL_WELL_E
        numbers = np.round(np.interp(light, exposure, brightness) * full_scale)
        stored = numbers.astype(np.uint8 if bit_depth == 8 else np.uint16)
        stack.append(Frame(stored, bit_depth, FrameSettings(2.0 ** (stop - 9))))
    return Bracket.from_frames(stack)


def true_log_exposure(exposure: Array, brightness: Array, bit_depth: int) -> tuple[slice, Array]:
    """Return the digital numbers between 5 and 95 % of full scale and the true ln H at each."""
    full_scale = 2**bit_depth - 1
    inner = slice(int(np.ceil(0.05 * full_scale)), int(0.95 * full_scale) + 1)
    rising = np.concatenate([[True], np.diff(brightness) > 0])
    level = np.arange(full_scale + 1)[inner] / full_scale
    return inner, np.log(np.interp(level, brightness[rising], exposure[rising]))


def rms_error(log_exposure: Array, truth: Array) -> float:
    """Return the rms difference after the free offset of a relative curve is taken out (for every peer alike)."""
    difference = log_exposure - truth
    return float(np.std(difference)) if np.all(np.isfinite(difference)) else float("nan")

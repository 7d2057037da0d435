"""What an effect by itself draws, next to the moments that it predicts: every entry, every kind of form it may take."""

from __future__ import annotations

import numpy as np
import pytest

from simulators.effects.base import Moments
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext
from testing.effect_context import CATALOGUE, HEIGHT, WIDTH, effect_context, starts_of

FRAMES, SIGMAS = 16, 5.0
SIGNALS = (40.0, 900.0, 9000.0, 10_200.0)
# Few lines or phases, or few pixels, make all of it: their draws have tests of their own, over many frames.
APART = {"column_pattern", "row_pattern", "row_temporal_noise", "rolling_shutter_banding", "mains_ripple", "hot_pixels"}
SPREAD_OVER_CODES = {"missing_codes"}  # what lies between two codes is noise in its moments: an even signal has none


def forms(kind: type[CatalogueEffect], context: ExposureContext) -> list[CatalogueEffect]:
    """Return the first start of an entry and its last, what it loosens to, and what it covers."""
    starts = starts_of(kind, context)
    return [starts[0], starts[-1], *starts[0].loosened(context)[:3], *kind.covers(context)[:2]]


@pytest.mark.parametrize("name", sorted(CATALOGUE.keys() - APART))
def test_samples_have_the_moments_that_are_predicted(name: str) -> None:
    """Mean, noise from frame to frame and fixed pattern of 16 frames of an even signal, within 5 standard errors."""
    context, pixels = effect_context(), HEIGHT * WIDTH
    for effect in forms(CATALOGUE[name], context):
        for signal in SIGNALS:
            even = np.full((HEIGHT, WIDTH), signal)
            predicted = effect.moments(Moments(even, *(np.zeros_like(even) for _ in range(3))), context)
            frames = np.array(
                [effect.sample(even.copy(), context, np.random.default_rng([k, 7])) for k in range(FRAMES)], float
            )
            noise, pattern, common = (
                float(np.mean(one))
                for one in (predicted.variance, predicted.spatial_variance, predicted.common_variance)
            )
            u_mean = np.sqrt(noise / (FRAMES * pixels) + pattern / pixels + common / FRAMES)
            least = 1e-5 * float(np.mean(predicted.mean)) + 1e-9
            assert abs(frames.mean() - np.mean(predicted.mean)) < SIGMAS * u_mean + least, (effect, signal)
            if name in SPREAD_OVER_CODES:
                continue
            alike = frames.mean(axis=(1, 2)).var(ddof=1)
            own = (frames - frames.mean(axis=(1, 2), keepdims=True)).var(axis=0, ddof=1).mean()
            u_own = noise * np.sqrt(2.0 / (pixels * (FRAMES - 1)))
            assert abs(own - noise) < SIGMAS * u_own + 1e-6 * signal + 1e-3 * common, (effect, signal)
            shared = common + noise / pixels
            assert abs(alike - shared) < SIGMAS * shared * np.sqrt(2.0 / (FRAMES - 1)) + 1e-6 * signal, (effect, signal)
            still = (frames.mean(axis=0) - np.broadcast_to(predicted.mean, even.shape)).var(ddof=1) - own / FRAMES
            u_still = np.sqrt(2.0 / pixels) * (pattern + noise / FRAMES)
            assert abs(still - pattern) < SIGMAS * u_still + 1e-6 * signal + 1e-3 * common, (effect, signal)

"""Free laws, and samples of one effect."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.excess_read_noise import ExcessReadNoise
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.free_law import FreeLaw, axis_values, freed
from simulators.effects.gamma_enabled import GammaEnabled
from simulators.effects.image_lag import ImageLag
from simulators.effects.mechanical_vignetting import MechanicalVignetting
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.registry import EffectEntry, make_effect
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from simulators.effects.stray_light_kernel import StrayLightKernel
from simulators.effects.tile_moments import Moments, TileMoments
from testing.effect_context import CATALOGUE, HEIGHT, WIDTH, effect_context, starts_of


def _context(**settings: Any) -> ExposureContext:
    own = FrameSettings(**({"exposure_s": 0.01, "gain_db": 0.0, "black_level_dn": 100.0} | settings))
    camera = CameraDescription(bit_depth=12, full_well_e=10_000.0)
    return ExposureContext(own, FrameGeometry.of_image(8, 6), camera)


def _free(plain: Any, law: tuple[float, ...], **knots: tuple[float, ...]) -> FreeLaw:
    kind = freed(type(plain), tuple(knots))
    return kind(**plain.values(), law=law, **{f"at_{axis}": at for axis, at in knots.items()})


def test_a_law_of_ones_is_the_effects_own() -> None:
    """Mean and every variance are those of the plain effect; the name is its name."""
    plain = ResponseNonlinearity(0.02)
    free = _free(plain, (1.0, 1.0, 1.0), signal=(10.0, 1000.0, 10_000.0))
    before = TileMoments.exactly(np.array([[[50.0, 900.0, 4000.0, 9000.0]]]))
    before = replace(before, variance=before.mean + 4.0, first_excess=0.01 * before.mean)
    own, other = plain.moments(before, _context()), free.moments(before, _context())
    for name in ("mean", "variance", "first_excess"):
        assert getattr(other, name) == pytest.approx(getattr(own, name), rel=1e-5)
    assert free.name == "response_nonlinearity"


def test_the_factor_goes_through_its_knots() -> None:
    """Half of the lost exposure at 1 ms, twice at 10 ms; beyond the knots as at the last; between them between."""
    free = _free(ExposureTimeOffset(1e-4), (0.5, 2.0), exposure_s=(1e-3, 1e-2))
    lost = {}
    for exposure_s in (1e-4, 1e-3, 10**-2.5, 1e-2, 1.0):
        signal = np.full((2, 2), 1000.0)
        lost[exposure_s] = (free.mean(signal, _context(exposure_s=exposure_s))[0, 0] / 1000.0 - 1.0) * exposure_s
    assert list(lost.values()) == pytest.approx([0.5e-4, 0.5e-4, 1.25e-4, 2e-4, 2e-4], rel=1e-9)


def test_a_table_holds_two_covariates() -> None:
    """Along radius and stop each knot has its own factor; halfway between two stops it is their mean (in octaves)."""
    plain = MechanicalVignetting(0.2, 2.0)
    free = _free(plain, (1.0, 3.0, 1.0, 3.0), field_radius=(0.0, 1.0), f_number=(2.0, 8.0))
    signal = np.full((6, 8), 100.0)
    for stop, factor in ((2.0, 1.0), (4.0, 2.0), (8.0, 3.0)):
        context = _context(f_number=stop)
        change = plain.mean(signal, context) - signal
        assert free.mean(signal, context) - signal == pytest.approx(factor * change)


def test_noise_is_carried_by_the_laws_own_slope() -> None:
    """Where the law goes with the signal its derivative has the curve's part too: held against small steps."""
    free = _free(ResponseNonlinearity(0.1), (0.0, 1.0, 3.0), signal=(10.0, 1000.0, 10_000.0))
    signal = np.array([300.0, 2000.0, 7000.0])
    before = Moments(signal, np.ones(3), np.zeros(3), np.zeros(3))
    rise = (free.mean(signal + 0.5, _context()) - free.mean(signal - 0.5, _context())) / 1.0
    assert free.moments(before, _context()).variance == pytest.approx(rise**2, rel=1e-3)


def test_what_acts_by_its_square_scatters_by_the_root() -> None:
    """A factor of 4 on an added noise is four times its variance, in the moments and in pictures."""
    plain = ExcessReadNoise(3.0)
    free = _free(plain, (4.0, 4.0), gain_db=(0.0, 12.0))
    signal = np.full((200, 200), 500.0)
    drawn = free.sample(signal, _context(), np.random.default_rng(6))
    assert np.var(drawn) == pytest.approx(36.0, rel=0.02)
    assert np.max(free.moments(Moments.exactly(signal), _context()).variance) == pytest.approx(36.0)


def test_a_signal_counts_from_black() -> None:
    """Digital numbers along which a law is free begin at the black level, a thousandth of the range added."""
    values = axis_values(GammaEnabled(1.2), "signal", np.array([100.0, 1100.0]), _context())
    assert values == pytest.approx([4.095, 1004.095])


def test_model_files_hold_the_law() -> None:
    """What is written is read again: the same kind, law and knots."""
    free = _free(ExposureTimeOffset(1e-4), (0.5, 2.0), exposure_s=(1e-3, 1e-2))
    again = EffectEntry.from_mapping(EffectEntry(free).to_mapping(), "here").effect
    assert again == free
    assert make_effect("exposure_time_offset", {"offset_s": 1e-4}) == ExposureTimeOffset(1e-4)


@pytest.mark.parametrize(
    ("plain", "highest"),
    [
        (StrayLightKernel(0.25), 2.0),  # at most half of the light is scattered
        (StrayLightKernel(0.5), 1.0),  # as much as the entry allows already
        (ExposureTimeOffset(-1e-4), 100.0),  # the end of its range lies farther off than any law goes
        (GammaEnabled(2.0), 4.0),  # from 1, which does nothing, to 5
    ],
)
def test_no_law_goes_beyond_the_entrys_own_bounds(plain: CatalogueEffect, highest: float) -> None:
    """The factor ends where the plain effect's first parameter would."""
    free = _free(plain, (1.0, 1.0), signal=(10.0, 1000.0))
    assert free.reach("law", 4095.0) == (0.0, pytest.approx(highest))
    assert free.reach(plain.free()[0], 4095.0) == plain.reach(plain.free()[0], 4095.0)


@pytest.mark.parametrize(("unit", "well_e", "added"), [
    ("e-", 10_000.0, 10.0), ("e-", 50_000.0, 50.0), ("e-", None, 10.0), ("DN", None, 4.095), ("W m-2", None, 0.0),
])  # fmt: skip
def test_a_signal_counts_from_black_on_with_a_thousandth_of_its_range(unit: str, well_e: Any, added: float) -> None:
    """Of the full well, 10 000 e⁻ where not stated, or of full scale; black is taken off digital numbers only."""
    context = replace(_context(), camera=CameraDescription(bit_depth=12, full_well_e=well_e))
    kinds = {"e-": ImageLag, "DN": BlackLevelOffset, "W m-2": NaturalVignetting}
    effect = kinds[unit]()
    assert effect.unit_in == unit
    black = 100.0 if unit == "DN" else 0.0
    found = axis_values(effect, "signal", np.array([0.0, black, black + 500.0]), context)
    assert found == pytest.approx(np.array([0.0, 0.0, 500.0]) + added)


FRAMES, SIGMAS = 16, 5.0

SIGNALS = (40.0, 900.0, 9000.0, 10_200.0)

# Few lines or phases, or few pixels, make all of it: their draws have tests of their own, over many frames.
APART = {"column_pattern", "row_pattern", "row_temporal_noise", "rolling_shutter_banding", "mains_ripple", "hot_pixels",
         "random_telegraph_noise"}  # fmt: skip

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

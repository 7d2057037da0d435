"""Budgets against the `GTC` package (Hall, MSL New Zealand): the measurement equation in uncertain numbers, to 1 %."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import replace

import GTC
import numpy as np
import pytest

from radiometer.analysis.reading import budget
from radiometer.analysis.reading.reading import read_patch
from radiometer.data import BlackLevel, LensDescription, Patch, ScaleConditions, StatedUncertainties
from radiometer.data.setup import Setup

NOTHING = StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0))
PATCH = Patch(1, 1, 10, 10)
NOON = dt.datetime(2026, 1, 1, 12, tzinfo=dt.UTC)


def only(**figures):
    return NOTHING.model_copy(update=figures)


def calibrated(rig, stated, conditions=None, **scale):
    """Return a calibration with stated uncertainties; u of the black level 0."""
    black = BlackLevel(dn=64.0, u_dn=0.0, dark_u_rel=0.0)
    base = rig.calibration(uncertainties=stated, black_level=black, created=NOON.isoformat())
    update = {"conditions": conditions or ScaleConditions(temperature_c=25.0), **scale}
    return replace(base, scale=base.scale.model_copy(update=update))


def frames_of(rig, level=0.5, exposures=(1e-3,) * 5, seed=3):
    scene = np.full((12, 12), level * rig.radiance_of_full_scale(1e-3))
    return rig.frames(scene, np.random.default_rng(seed), exposures)


def noise_of(rig, frames, calibration, lens=None):
    """Return the uncertain mean signal per s of frames of one exposure, in DN, from numbers of photons alone."""
    mean = float(np.mean([frame.dn[PATCH.slices].mean() for frame in frames])) - rig.black_dn
    electrons = mean * rig.gain_e_per_dn
    variance = electrons + rig.read_e**2 + rig.gain_e_per_dn**2 / 12.0
    sigma = math.sqrt(variance / (100.0 * len(frames))) / rig.gain_e_per_dn
    return GTC.ureal(mean, sigma) / frames[0].settings.exposure_s


def lens_sr(number=4.0, tau=1.0):
    return math.pi * tau / (4.0 * number * number)


def agrees(reading, expected):
    """Tell whether value, u and degrees of freedom are those of GTC to 1 %."""
    assert reading.radiance.value == pytest.approx(expected.x, rel=1e-3)
    assert reading.radiance.u == pytest.approx(expected.u, rel=0.01)
    if math.isfinite(expected.df):
        assert reading.degrees_of_freedom == pytest.approx(expected.df, rel=0.01)


def test_scale_of_few_degrees_of_freedom(rig):
    """A scale from five repeats, 2 %, and the noise of dim light: L = s·x/(t·π/4N²), degrees of freedom and k too."""
    calibration = calibrated(rig, NOTHING, u_rel=0.02, degrees_of_freedom=4.0)
    frames = frames_of(rig, level=0.0005, seed=1)  # frames and pixels that by chance scatter by no more than noise
    found = read_patch(frames, PATCH, Setup(rig.description, rig.lens, calibration), now=NOON)
    value = rig.true_scale
    expected = GTC.ureal(value, 0.02 * value, 4.0) * noise_of(rig, frames, calibration) / lens_sr()
    agrees(found, expected)
    assert found.coverage_factor == pytest.approx(GTC.reporting.k_factor(found.degrees_of_freedom, 95.45), rel=0.01)


def test_another_stop_and_a_filter(rig):
    """f/8 for f/4 to 2 %, τ = 0.09 to 3 % for 0.9 to 1 %, a scale to 0.5 %: powers and quotients."""
    lens = LensDescription(focal_length_mm=16.0, f_number=4.0, transmittance=0.9, transmittance_u_rel=0.01)
    calibration = replace(calibrated(rig, only(f_number_u_rel=0.02), u_rel=0.005), lens=lens)
    frames = [replace(f, settings=replace(f.settings, f_number=8.0)) for f in frames_of(rig)]
    used = LensDescription(f_number=8.0, transmittance=0.09, transmittance_u_rel=0.03)
    found = read_patch(frames, PATCH, Setup(rig.description, used, calibration), now=NOON)
    tau, reference = GTC.ureal(0.09, 0.09 * 0.03), GTC.ureal(0.9, 0.009)
    number = GTC.ureal(8.0, 0.16)
    value = rig.true_scale
    scale = GTC.ureal(value, 0.005 * value) * 0.9 / reference  # the scale was got through the clear lens
    expected = scale * noise_of(rig, frames, calibration) * 4.0 * number**2 / (math.pi * tau)
    agrees(found, expected * (reference.x / 0.9))


def test_an_exposure_offset_that_calibration_and_reading_share(rig):
    """The same unknown 3 µs in the calibration's 4 ms and the reading's 1 ms: L = L₀·(x/(t + δ))/(x₀/(t₀ + δ))."""
    stated = only(exposure_u_s=3e-6)
    calibration = calibrated(rig, stated, ScaleConditions(inverse_exposure_per_s=250.0, temperature_c=25.0))
    frames = frames_of(rig)
    found = read_patch(frames, PATCH, Setup(rig.description, rig.lens, calibration), now=NOON)
    offset = GTC.ureal(0.0, 3e-6)
    signal = noise_of(rig, frames, calibration) * 1e-3
    scale_of_true_time = rig.true_scale * (4e-3 + offset) / 4e-3
    agrees(found, scale_of_true_time * signal / ((1e-3 + offset) * lens_sr()))


def test_a_temperature_coefficient_that_both_share(rig):
    """Reading at 25 °C under a calibration at 13 °C, the coefficient 0 ± 0.1 %/K in both responsivities."""
    stated = only(temperature_u_rel_per_k=1e-3)
    calibration = calibrated(rig, stated, ScaleConditions(temperature_c=13.0), u_rel=0.004)
    frames = frames_of(rig)
    found = read_patch(frames, PATCH, Setup(rig.description, rig.lens, calibration), now=NOON)
    slope, value = GTC.ureal(0.0, 1e-3), rig.true_scale
    scale = GTC.ureal(value, 0.004 * value) * (1.0 + slope * 13.0)
    agrees(found, scale * noise_of(rig, frames, calibration) / (lens_sr() * (1.0 + slope * 25.0)))


def test_veiling_glare_that_both_share(rig):
    """A surround four times the patch, 2 times at calibration: L = m − g·(S − S₀·L) with the same g in both."""
    scene = np.full((48, 48), 0.8 * rig.radiance_of_full_scale(1e-3))
    scene[16:32, 16:32] /= 4.0
    frames = rig.frames(scene, np.random.default_rng(3), (1e-3,) * 5)
    calibration = calibrated(rig, only(glare_u=0.01), ScaleConditions(temperature_c=25.0, surround=2.0))
    found = read_patch(frames, Patch(19, 19, 10, 10), Setup(rig.description, rig.lens, calibration), now=NOON)
    glare, patch = GTC.ureal(0.0, 0.01), float(scene[24, 24])
    seen = found.radiance.value
    expected = seen - glare * (float(scene.mean()) / patch * seen - 2.0 * seen)
    noise = next(line.u_rel for line in found.budget if line.name == "repeatability") * seen
    assert found.radiance.u == pytest.approx(math.hypot(expected.u, noise), rel=0.01)


def test_a_ratio_of_readings_that_share_their_scale(rig):
    """Two radiances by one calibration known to 5 %: what is left of their ratio is the noise of both."""
    calibration = calibrated(rig, NOTHING, u_rel=0.05)
    several = [frames_of(rig, level, seed=seed) for level, seed in ((0.02, 1), (0.01, 9))]
    readings = [read_patch(f, PATCH, Setup(rig.description, rig.lens, calibration), now=NOON) for f in several]
    scale = GTC.ureal(rig.true_scale, 0.05 * rig.true_scale)
    first, second = (scale * noise_of(rig, f, calibration) / lens_sr() for f in several)
    found, expected = budget.ratio(*readings), first / second
    assert found.u == pytest.approx(expected.u, rel=0.01)

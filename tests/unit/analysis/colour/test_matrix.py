"""The matrix of a colour camera: exact where one exists, and an uncertainty that holds where none does."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.colour.calibration import ColourCalibration
from radiometer.analysis.colour.chromaticity import coordinates
from radiometer.analysis.colour.matrix import Training, fit_matrix
from radiometer.analysis.colour.plausible import (
    COLOURS,
    GRID_NM,
    on_grid,
    plausible_lights,
    tristimulus_of,
)
from radiometer.analysis.colour.train import ColourCamera, train_on_lights
from radiometer.analysis.photometry.photometry import spectrum
from radiometer.typing import Array
from simulators.cameras.colour_filters import ColourFilters

NOISE_REL = 0.002
LIGHTS = ("cie_d65", "cie_a", "white_led", "led_b5", "cie_fl11")
CAMERA = np.stack([ColourFilters().responsivity(colour, GRID_NM) for colour in COLOURS])
GAIN = 0.02  # DN per s and unit of power: any


def read(powers: Array, kinds: list[str], rng: np.random.Generator, camera: Array = CAMERA) -> Training:
    """Return lights as a camera reads them, with noise, and their true X, Y, Z."""
    exact = GAIN * powers @ camera.T
    u_signal = NOISE_REL * exact
    signal = exact + u_signal * rng.standard_normal(exact.shape)
    names = tuple(f"light {n}" for n in range(len(powers)))
    return Training(names, tuple(kinds), signal, u_signal, tristimulus_of(powers), np.full(len(powers), 1e-3))


def deviations(known: ColourCalibration, lights: Training, kind: str | None) -> tuple[Array, Array, Array]:
    """Return (measured − true)/u of X, Y, Z, and the relative errors of CCT and the errors of Duv."""
    covariance = np.eye(3) * lights.u_signal[:, None, :] ** 2
    xyz, u_xyz = known.convert(lights.signal, covariance, kind)
    found, true = coordinates(xyz, u_xyz), coordinates(lights.xyz, np.zeros((3, 3)))
    off = (xyz - lights.xyz) / np.sqrt(np.diagonal(u_xyz, axis1=1, axis2=2))
    return off, found.cct_k / true.cct_k - 1.0, found.duv - true.duv


@pytest.fixture(scope="module")
def reflectances() -> Array:
    """Return the 24 patches of a real chart."""
    peer = pytest.importorskip("colour")
    chart = peer.SDS_COLOURCHECKERS["BabelColor Average"]
    return np.stack([np.interp(GRID_NM, one.wavelengths, one.values) for one in chart.values()])


def test_a_camera_that_is_a_mixture_of_the_matching_functions_has_its_matrix() -> None:
    """By Luther the matrix is the inverse of the mixture, for lights of any kind."""
    rng = np.random.default_rng(46_021)
    mixture = np.array([[0.9, 0.2, 0.1], [0.2, 1.1, 0.0], [0.0, 0.1, 0.8]])
    powers = np.vstack([plausible_lights()["surfaces"][::9], plausible_lights()["coloured_leds"][::5]])
    xyz = tristimulus_of(powers)
    signal = xyz @ mixture.T
    none = np.zeros(len(powers))
    found = fit_matrix(Training(("",) * len(powers), ("",) * len(powers), signal, 0.0 * signal, xyz, none))
    assert found.matrix == pytest.approx(np.linalg.inv(mixture), abs=1e-9)
    assert np.sqrt(np.diag(found.error)).max() < 2e-4
    light = rng.uniform(0.1, 1.0, 3)
    assert found.matrix @ (mixture @ light) == pytest.approx(light)


def test_24_patches_under_five_lights_are_within_one_and_a_half_u(reflectances: Array) -> None:
    """Trained on all of them; each light is read anew with other noise. CCT of the greys within 1 %, Duv 0.001."""
    rng = np.random.default_rng(46_022)
    powers = np.vstack([reflectances * on_grid(spectrum(name)) for name in LIGHTS])
    kinds = ["surfaces"] * len(powers)
    known = train_on_lights(
        ColourCamera(COLOURS, responsivities=CAMERA), read(powers, kinds, rng), powers=None, per_kind=False, u_rel=0.0
    )
    off, _, _ = deviations(known, read(powers, kinds, rng), "surfaces")
    assert np.mean(np.abs(off) < 1.5) >= 0.95


@pytest.mark.parametrize("light", LIGHTS)
def test_temperature_and_duv_of_a_well_trained_matrix(reflectances: Array, light: str) -> None:
    """A chart under the lamp that is measured: greys within 1 % and 0.001 in Duv."""
    rng = np.random.default_rng(46_023)
    powers = reflectances * on_grid(spectrum(light))
    known = train_on_lights(
        ColourCamera(COLOURS), read(powers, ["surfaces"] * 24, rng), powers=None, per_kind=False, u_rel=0.0
    )
    _, cct, duv = deviations(known, read(powers[18:23], ["surfaces"] * 5, rng), "surfaces")
    assert np.abs(np.mean(cct)) < 0.01
    assert np.abs(np.mean(duv)) < 0.001

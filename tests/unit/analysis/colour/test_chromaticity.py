"""Chromaticity, colour temperature and Duv compared with the standard, a peer, and drawn lights."""

from pathlib import Path

import numpy as np
import pytest

from radiometer.analysis.colour.chart import read_chart
from radiometer.analysis.colour.chromaticity import coordinates, matching_functions, tristimulus
from radiometer.analysis.photometry.photometry import Spectrum, luminous_efficiency, spectrum

EXACT = np.zeros((3, 3))


def test_the_matching_functions_are_those_of_the_standard() -> None:
    """ȳ is V(λ), sums of CIE 015:2018; uncertainties are those of drawn lights."""
    wavelength_nm, functions = matching_functions()
    assert functions[1] == pytest.approx(np.interp(wavelength_nm, *luminous_efficiency()), abs=1e-9)
    assert functions.sum(axis=1) == pytest.approx([106.865469, 106.856917, 106.892251], abs=2e-6)
    rng = np.random.default_rng(46_011)
    lights = np.stack([tristimulus(spectrum(name)) for name in ("cie_d65", "led_b1", "cie_fl2")])
    root = rng.standard_normal((3, 3)) * 0.003
    covariance = lights[:, :, None] * (root @ root.T) * lights[:, None, :]
    found = coordinates(lights, covariance)
    for n, light in enumerate(lights):
        drawn = coordinates(rng.multivariate_normal(light, covariance[n], 20_000), EXACT)
        assert found.xy_covariance[n] == pytest.approx(np.cov(drawn.xy.T), rel=0.05)
        assert found.uv_covariance[n] == pytest.approx(np.cov(drawn.uv_prime.T), rel=0.05)
        assert found.u_cct_k[n] == pytest.approx(np.std(drawn.cct_k), rel=0.03)
        assert found.u_duv[n] == pytest.approx(np.std(drawn.duv), rel=0.03)


@pytest.mark.parametrize(
    ("name", "x", "y"),
    [("equal_energy", 0.33331, 0.33329), ("cie_a", 0.44758, 0.40745), ("cie_d65", 0.31272, 0.32903),
     ("cie_fl11", 0.38052, 0.37713)],
)  # fmt: skip
def test_illuminants_have_the_chromaticity_of_the_standard(name: str, x: float, y: float) -> None:
    """Chromaticities of CIE 015:2018, tables 11 and T8.1, to the step and end of the tables of spectra."""
    found = coordinates(tristimulus(spectrum(name)), EXACT)
    assert found.xy == pytest.approx([x, y], abs=1.5e-4)


@pytest.mark.parametrize("temperature", [2000.0, 3200.0, 6500.0, 20_000.0])
def test_a_planckian_radiator_has_its_temperature_and_no_distance(temperature: float) -> None:
    """Planck's law with c₂ = 0.014388 m·K, at 1 nm over the whole table of the observer."""
    nm = np.arange(360.0, 831.0)
    light = Spectrum("planck", nm, nm**-5 / np.expm1(0.01438777 / (nm * 1e-9 * temperature)))
    found = coordinates(tristimulus(light), EXACT)
    assert found.cct_k == pytest.approx(temperature, rel=1e-4)
    assert abs(found.duv) < 2e-6


@pytest.mark.parametrize("light", ["led_b1", "led_b3", "led_b5", "led_rgb1", "cie_fl2", "cie_fl11", "cie_d65"])
def test_temperature_and_duv_are_those_of_a_peer(light: str) -> None:
    """The peer interpolates in a table by Ohno's method of 2013."""
    peer = pytest.importorskip("colour")
    xyz = tristimulus(spectrum("white_led" if light == "led_b3" else light))
    found = coordinates(xyz, EXACT)
    cct_k, duv = peer.temperature.uv_to_CCT_Ohno2013(found.uv_prime * [1.0, 2.0 / 3.0])
    assert found.cct_k == pytest.approx(cct_k, rel=3e-4)
    assert found.duv == pytest.approx(duv, abs=3e-6)
    assert found.xy == pytest.approx(peer.XYZ_to_xy(xyz), abs=1e-12)
    assert found.uv_prime == pytest.approx(peer.xy_to_Luv_uv(found.xy), abs=1e-12)


@pytest.mark.parametrize(
    "names", [("display:oled:green",), ("line:450",), ("band:520,30",), ("line:450", "display:oled:red")]
)
def test_a_saturated_colour_has_no_temperature(names: tuple[str, ...]) -> None:
    """|Duv| above 0.05, as of a purple, is beyond what CIE 015 defines; the chromaticity stays."""
    found = coordinates(sum(tristimulus(spectrum(name)) for name in names), EXACT)
    assert np.isnan(found.cct_k)
    assert np.isnan(found.duv)
    assert np.all(np.isfinite(found.xy))


def test_a_chart_states_u_of_its_lights_or_none(tmp_path: Path) -> None:
    """As a relative figure of each light; without the column they are exact, and without places they have none."""
    chart = tmp_path / "chart.csv"
    chart.write_text("name,kind,X,Y,Z,u_rel\nred,leds,3,2,1,0.02\nblue,leds,1,2,9,0.05\n")
    assert [(one.u_rel, one.patch, one.capture) for one in read_chart(chart)] == [
        (0.02, None, None),
        (0.05, None, None),
    ]
    chart.write_text("name,kind,X,Y,Z\nred,leds,3,2,1\n")
    assert [one.u_rel for one in read_chart(chart)] == [0.0]

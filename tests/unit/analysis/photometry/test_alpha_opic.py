"""α-opic quantities compared with the figures of CIE S 026 and with calculations by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import radiometer as rm
from radiometer.analysis.photometry.alpha_opic import RECEPTORS, alpha_opic_quantities
from radiometer.analysis.photometry.photometry import Spectrum, spectrum, table
from radiometer.data import Quantity
from radiometer.errors import InputError, UsageError

# α-opic efficacies of luminous radiation of daylight D65 in mW/lm. Source: CIE S 026:2018, table 3.
DAYLIGHT = {
    "s_cone_opic": 0.8173,
    "m_cone_opic": 1.4558,
    "l_cone_opic": 1.6289,
    "rhodopic": 1.4497,
    "melanopic": 1.3262,
}


@pytest.mark.parametrize("receptor", RECEPTORS)
def test_daylight_is_its_own_equivalent_and_has_the_efficacy_of_the_standard(receptor: str) -> None:
    """Daylight is its own equivalent and has the efficacy of the standard."""
    one = rm.alpha_opic(250.0, "lx", spectrum="cie_d65")[receptor]
    assert one.efficacy_mw_lm.value == pytest.approx(DAYLIGHT[receptor], abs=5e-5)
    assert one.quantity.value == pytest.approx(0.25 * DAYLIGHT[receptor], rel=1e-4)
    assert (one.equivalent_daylight.value, one.daylight_ratio.value) == (pytest.approx(250.0), pytest.approx(1.0))
    assert (one.quantity.unit, one.equivalent_daylight.unit) == ("W m-2", "lx")


# α-opic efficacies in mW/lm, in the order of RECEPTORS. Source: luxpy 1.12.5, spd_to_aopicELR, of the same tables.
@pytest.mark.parametrize(
    ("name", "efficacies"),
    [
        ("cie_a", (0.25419, 1.1742, 1.6567, 0.83077, 0.65751)),
        ("white_led", (0.50479, 1.2871, 1.6253, 1.0127, 0.83892)),
        ("led_v1", (0.26825, 1.1615, 1.6690, 0.82747, 0.65797)),
        ("cie_fl11", (0.48328, 1.2664, 1.6143, 0.93929, 0.74745)),
        ("equal_energy", (0.75640, 1.3968, 1.6389, 1.3301, 1.2013)),
    ],
)
def test_the_efficacies_of_common_lights_are_those_of_a_peer(name: str, efficacies: tuple[float, ...]) -> None:
    """The efficacies of common lights are those of a peer."""
    found = rm.alpha_opic(1.0, spectrum=name)
    assert [one.efficacy_mw_lm.value for one in found.quantities] == pytest.approx(efficacies, rel=3e-4)


def test_a_line_excites_by_its_action_spectrum() -> None:
    """A line excites by its action spectrum."""
    wavelength, columns = table("alpha_opic.csv")
    at_490 = columns["melanopic"][wavelength == 490.0][0]
    found = rm.alpha_opic(3.0, "W/m2", spectrum="line:490")["melanopic"]
    assert found.quantity.value == pytest.approx(3.0 * at_490)
    assert at_490 == pytest.approx(1.0, abs=1e-3)  # its peak is at 490 nm


def test_radiance_and_luminance_of_one_light_give_the_same() -> None:
    """Radiance and luminance of one light give the same."""
    from radiometer.analysis.photometry.photometry import luminance_cd_m2

    watts, candela = (
        rm.alpha_opic(0.3, "W/sr/m2", u=0.003, spectrum="white_led"),
        rm.alpha_opic(luminance_cd_m2(0.3, spectrum("white_led")), "cd/m2", spectrum="white_led"),
    )
    for receptor in RECEPTORS:
        assert watts[receptor].quantity.value == pytest.approx(candela[receptor].quantity.value, rel=1e-9)
        assert watts[receptor].quantity.u / watts[receptor].quantity.value == pytest.approx(0.01)


@pytest.mark.parametrize("unit", ["cd m-2", "W sr-1 m-2"])
def test_the_uncertainty_of_the_spectrum_is_that_of_drawn_spectra(unit: str) -> None:
    """The uncertainty of the spectrum is that of drawn spectra."""
    light, rng = spectrum("white_led"), np.random.default_rng(46_002)
    stated = alpha_opic_quantities(Quantity(100.0, 0.0, unit), light, 0.05, 0.8)
    drawn = []
    for _ in range(300):
        power = light.power * (1.0 + 0.05 * rng.standard_normal(light.power.size))
        moved = Spectrum("drawn", light.wavelength_nm + 0.8 * rng.standard_normal(), np.maximum(power, 0.0))
        drawn.append([one.quantity.value for one in alpha_opic_quantities(Quantity(100.0, 0.0, unit), moved)])
    for one, spread in zip(stated, np.std(drawn, axis=0), strict=True):
        assert one.quantity.u == pytest.approx(spread, rel=0.2)


def test_a_level_of_a_screen_and_a_reading_are_sources(tmp_path: Path) -> None:
    """A level of a screen and a reading are sources."""
    screen = rm.screen_calibrate(display="lcd", quick=True).calibration
    luminance = screen.channel("grey").at(200, "cd m-2")
    of_level = rm.alpha_opic(screen=screen, level=200)
    assert of_level.source == luminance
    (tmp_path / "reading.json").write_text(json.dumps({"radiance": None, "luminance": luminance.to_mapping()}))
    of_file = rm.alpha_opic(reading=tmp_path / "reading.json", spectrum=screen.channel("grey").spectrum)
    assert of_file["rhodopic"] == of_level["rhodopic"]


def test_a_source_of_known_size_and_distance_gives_the_illuminance_at_the_eye() -> None:
    """Small: L·A/d². A disc of 45° half angle: half of πL. A wide wall: πL. A rectangle: the sum of its parts."""
    small = rm.alpha_opic(100.0, u=1.0, spectrum="cie_d65", size_m=(0.02, 0.01), distance_m=2.0, u_distance_m=0.02)
    assert small.source.value == pytest.approx(100.0 * 2e-4 / 4.0, rel=1e-4)
    assert small.source.u / small.source.value == pytest.approx(np.hypot(0.01, 2 * 0.02 / 2.0), rel=1e-3)
    assert (small.source.unit, small["melanopic"].equivalent_daylight.unit) == ("lx", "lx")
    disc = rm.alpha_opic(1.0, "W/sr/m2", spectrum="cie_a", size_m=[2.0], distance_m=1.0)
    assert (disc.source.value, disc.source.unit) == (pytest.approx(np.pi / 2), "W m-2")
    assert rm.alpha_opic(1.0, spectrum="cie_a", size_m=(1e5, 1e5), distance_m=1.0).source.value == pytest.approx(np.pi)
    x, y = np.meshgrid(*((np.arange(500) + 0.5) / 500 * side - side / 2 for side in (0.52, 0.32)))
    summed = np.sum(0.6**2 / (x**2 + y**2 + 0.6**2) ** 2) * 0.52 * 0.32 / 500**2  # cos⁴θ/d² of each part
    found = rm.alpha_opic(1.0, spectrum="cie_a", size_m=(0.52, 0.32), distance_m=0.6)
    assert found.source.value == pytest.approx(summed, rel=1e-5)


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({}, UsageError),
        ({"value": 1.0}, UsageError),
        ({"value": 1.0, "reading": "x.json", "spectrum": "cie_a"}, UsageError),
        ({"value": 1.0, "level": 3, "spectrum": "cie_a"}, UsageError),
        ({"value": 1.0, "unit": "fc", "spectrum": "cie_a"}, UsageError),
        ({"value": 1.0, "wavelength_u_nm": 1.0}, UsageError),
        ({"value": 1.0, "spectrum": "cie_a", "wavelength_u_nm": 500.0}, UsageError),
        ({"value": 1.0, "spectrum": "cie_a", "size_m": (1.0,), "distance_m": 1e-300}, UsageError),
        ({"value": 1.0, "spectrum": "line:1064"}, InputError),
        ({"value": -1.0, "spectrum": "cie_a"}, UsageError),
        ({"value": float("nan"), "spectrum": "cie_a"}, UsageError),
        ({"reading": "missing.json", "spectrum": "cie_a"}, InputError),
        ({"value": 1.0, "spectrum": "cie_a", "size_m": (0.1,)}, UsageError),
        ({"value": 1.0, "spectrum": "cie_a", "size_m": (0.1, 0.0), "distance_m": 1.0}, UsageError),
        ({"value": 1.0, "unit": "lx", "spectrum": "cie_a", "size_m": (0.1,), "distance_m": 1.0}, UsageError),
    ],
)
def test_what_gives_no_quantity_is_refused(given: dict[str, object], error: type[Exception]) -> None:
    """What gives no quantity is refused."""
    with pytest.raises(error):
        rm.alpha_opic(**given)  # type: ignore[arg-type]


def test_a_reading_counts_for_the_spectrum_that_it_was_made_for(tmp_path: Path) -> None:
    """Its luminance is that of such light; its flags go on, and a relative reading has no such quantities."""
    stated = {
        "radiance": {"value": 1.5, "u": 0.01, "unit": "W sr-1 m-2"},
        "luminance": {"value": 475.0, "u": 5.0, "unit": "cd m-2"},
        "flags": ["saturated"], "assumptions": ["spectrum white_led"],
    }  # fmt: skip
    file = tmp_path / "r.json"
    file.write_text(json.dumps(stated))
    with pytest.raises(UsageError, match="measure again with --spectrum line:465"):
        rm.alpha_opic(reading=file, spectrum="line:465")
    found = rm.alpha_opic(reading=file, spectrum="white_led")
    assert "the reading is flagged saturated" in found.assumptions
    for change in ({"flags": ["uncalibrated"]}, {"radiance": {"value": 1.5, "u": 0.01, "unit": "relative"}}):
        file.write_text(json.dumps({**stated, **change}))
        with pytest.raises(UsageError, match="relative"):
            rm.alpha_opic(reading=file, spectrum="white_led")

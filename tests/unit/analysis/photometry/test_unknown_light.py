"""What the table of a light, or of a receptor, does not state is in the uncertainty, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import radiometer as rm
from radiometer.analysis.photometry.alpha_opic import alpha_opic_quantities
from radiometer.analysis.photometry.photometry import Spectrum, luminous_efficacy, spectrum_from_csv
from radiometer.data import Quantity
from radiometer.errors import InputError
from radiometer.typing import Array

FINE_NM = np.arange(200.0, 1100.1, 0.25)


def bands(rng: np.random.Generator) -> Array:
    """Return the power of some coloured lights over the fine grid."""
    power = np.zeros_like(FINE_NM)
    for peak, width in zip(rng.uniform(450.0, 650.0, 3), rng.uniform(15.0, 80.0, 3), strict=True):
        power += rng.uniform(0.1, 1.0) * 0.5 ** (4.0 * ((FINE_NM - peak) / width) ** 2)
    return np.where(power < 1e-9, 0.0, power)


def figures(light: Spectrum) -> list[Quantity]:
    """Return the luminous efficacy and the α-opic quantities of a luminance."""
    made = alpha_opic_quantities(Quantity(100.0, 0.0, "cd m-2"), light)
    return [luminous_efficacy(light), *(one.quantity for one in made)]


def as_csv(path: Path, nm: Array, power: Array) -> Spectrum:
    """Return the light as a file of it is read."""
    np.savetxt(path, np.column_stack([nm, power]), "%.9g", ",", header="wavelength_nm,power", comments="")
    return spectrum_from_csv(path)


@pytest.mark.parametrize("step_nm", [1, 5, 10, 20, 40, 100, 200])
def test_a_light_in_coarse_steps_is_right_within_u_or_refused(tmp_path: Path, step_nm: float) -> None:
    """Over random lights and first wavelengths; steps of 5 nm and less are never refused, of 100 nm always."""
    rng, taken, right, several = np.random.default_rng(48_001), 0, 0, 40
    for n in range(several):
        power, first = bands(rng), 300.0 - rng.uniform(0.0, step_nm)
        true = figures(Spectrum("true", FINE_NM, power))
        nm = np.arange(first, 900.0, step_nm)
        try:
            found = figures(as_csv(tmp_path / f"{n}.csv", nm, np.interp(nm, FINE_NM, power)))
        except InputError:
            continue
        taken += 1
        tolerance = 1e-6 * max(one.value for one in true[1:])
        right += all(abs(a.value - b.value) <= 2.0 * a.u + tolerance for a, b in zip(found, true, strict=True))
    assert right >= 0.9 * taken
    assert taken == several or step_nm > 5
    assert taken == 0 or step_nm < 100


@pytest.mark.parametrize("part", [1e-4, 1e-3, 0.01, 0.03, 0.1, 0.3, 0.9])
@pytest.mark.parametrize("peak_nm", [450.0, 550.0, 620.0])
def test_a_light_that_is_cut_off_is_right_within_u_or_refused(tmp_path: Path, part: float, peak_nm: float) -> None:
    """Where the table ends at some part of the peak: whatever was cut off is covered."""
    power = np.round(0.5 ** (4.0 * ((FINE_NM - peak_nm) / 60.0) ** 2), 9)
    true = figures(Spectrum("true", FINE_NM, power))
    kept = (peak_nm > FINE_NM) | (power > part)
    try:
        found = figures(as_csv(tmp_path / "cut.csv", FINE_NM[kept], power[kept]))
    except InputError:
        assert part >= 0.01
        return
    assert part < 0.9
    for one, other in zip(found[1:], true[1:], strict=True):  # an efficacy is of the band that a table states
        assert abs(one.value - other.value) <= 2.0 * one.u + 1e-6 * other.value


@pytest.mark.parametrize("name", ["band:370,10", "band:375,12", "band:380,10", "band:790,10", "band:800,30"])
def test_light_beyond_the_tables_is_not_none(name: str) -> None:
    """Each receptor may answer to light that its table does not reach as it does at the end: u holds that."""
    for one in rm.alpha_opic(100.0, spectrum=name).quantities:
        assert one.quantity.u > 0.1 * one.quantity.value
    inside = rm.alpha_opic(100.0, spectrum="band:550,20").quantities
    assert [one.quantity.u for one in inside] == pytest.approx([0.0] * 5, abs=1e-9)


def test_a_reading_of_too_little_known_light_has_no_luminance(tmp_path: Path) -> None:
    """A light that is stated to 495 nm alone has a radiance; a map or a value of it has no luminance either."""
    nm = np.arange(380.0, 496.0, 5.0)
    light = as_csv(tmp_path / "part.csv", nm, 0.5 ** (4.0 * ((nm - 480.0) / 30.0) ** 2))
    with pytest.raises(InputError, match="leaves its luminance unknown"):
        luminous_efficacy(light)
    with pytest.raises(InputError, match="leaves its luminance unknown"):
        rm.alpha_opic(1.0, "W/m2", spectrum=str(tmp_path / "part.csv"))

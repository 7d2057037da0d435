"""The real CCD of the EMVA 1288 reference measurements next to the `emva1288` package's figures on the same files."""

from __future__ import annotations

from pathlib import Path

import pytest

from radiometer.analysis.characterise import Characterisation, EmvaDescriptor, characterise, read_subject
from testing.golden.emva import REF001, REF001_LOOSE


@pytest.fixture(scope="module")
def folder(shared_data: Path) -> Path:
    return shared_data / "emva" / "ref001_ccd_12bit"


@pytest.fixture(scope="module")
def ccd(folder: Path) -> Characterisation:
    return characterise(read_subject(folder))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(REF001))
def test_figure_agrees_with_the_package(ccd: Characterisation, name: str) -> None:
    """K within 1 %, the rest within 2 %: the fit here is weighted by the noise, the package's is not."""
    allowed = 0.01 if name == "K" else 0.02
    assert ccd.figures[name].value == pytest.approx(REF001[name], rel=allowed)


@pytest.mark.parametrize(("name", "value"), list(REF001_LOOSE.items()))
def test_figure_of_few_frames_agrees_within_its_uncertainty(ccd: Characterisation, name: str, value: float) -> None:
    """What four frames or short exposures hardly determine differs by less than one standard uncertainty."""
    assert abs(ccd.figures[name].value - value) < ccd.figures[name].u


def test_scatter_beyond_noise_is_reported(ccd: Characterisation) -> None:
    """The real photon transfer is not quite straight; the note says so and K's uncertainty holds it."""
    assert any("scatters" in note for note in ccd.notes)
    assert ccd.figures["K"].u_rel > 0.002


def test_descriptor_with_backslashes_is_read(folder: Path) -> None:
    """All images of the descriptor are found, bright and dark."""
    descriptor = EmvaDescriptor.read(folder / "EMVA1288_Data.txt")
    assert (descriptor.bit_depth, descriptor.width, descriptor.height) == (12, 640, 480)
    assert {group.settings.shutter for group in descriptor.groups} == {"open", "closed"}
    assert len([file for group in descriptor.groups for file in group.files]) == 108

"""Protocols: the shipped ones are valid, wrong ones are refused with key and reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from radiometer.adaptation.protocol import SHIPPED, read_protocol
from radiometer.errors import ConfigurationError


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_protocols_are_valid(name: str) -> None:
    """Each is read by its name and carries it."""
    assert read_protocol(name).name == name


def test_classic_is_the_test_of_the_literature() -> None:
    """9,000 cd/m² for 180 s through 7 mm, 505 nm, 2° at 5°, up to 40 min; the blue one 453 nm at 8°."""
    classic = read_protocol("classic")
    assert (classic.bleach.luminance_cd_m2, classic.bleach.duration_s) == (9000, 180)
    assert (classic.spot.peak_nm, classic.spot.size_deg, classic.spot.eccentricity_deg) == (505, 2, 5)
    blue = read_protocol("classic-blue")
    assert (blue.spot.peak_nm, blue.spot.eccentricity_deg, blue.bleach) == (453, 8, classic.bleach)
    assert classic.end.duration_min == 40


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("duration_s: 180", "duration_s: -1", "duration_s"),
        ("kind: limits", "kind: guess", "method"),
        ("end: {", "ende: {", "unknown key 'ende'"),
        ("duration_min: 40", "duration_min: 40, criterion_log10: -9", "outside the spot's levels"),
    ],
)
def test_wrong_protocols_are_refused(tmp_path: Path, project_root: Path, old: str, new: str, message: str) -> None:
    """The error names what is wrong."""
    text = (project_root / "configs" / "protocols" / "classic.yaml").read_text()
    assert old in text
    file = tmp_path / "p.yaml"
    file.write_text(text.replace(old, new))
    with pytest.raises(ConfigurationError, match=message):
        read_protocol(file)


def test_unknown_protocol_lists_the_shipped_ones() -> None:
    """The way out is in the message."""
    with pytest.raises(ConfigurationError, match="classic, classic-blue, rapid, quick"):
        read_protocol("nothing.yaml")

"""What is written into files: every key of a calibration with little in it and with everything, and read back."""

from __future__ import annotations

from typing import Any

import pytest

from radiometer.data import (
    BlackLevel,
    Calibration,
    CameraDescription,
    LensDescription,
    ResponseCurve,
    Scale,
    SensorNoise,
)
from tests.unit.held import world
from tests.unit.held.figures import moved

CREATED = "2025-11-21T12:00:00+00:00"


def bare() -> Calibration:
    """Return what a calibration must have."""
    return Calibration(
        camera=CameraDescription(bit_depth=8),
        lens=LensDescription(),
        scale=Scale(value=1.0, u_rel=0.0, method="relative"),
        response=None,
        noise=SensorNoise(1.0, 0.0, 255.0),
        black_level=BlackLevel(),
        created=CREATED,
    )


def whole() -> Calibration:
    """Return a calibration in which nothing is left out."""
    return world.calibration(
        created=CREATED,
        camera=world.CAMERA.model_copy(update={"bit_depth": 8}),
        response=world.gamma_curve(),
        flat_field=world.flat_field(),
        spectrum="cie_a",
        spectral_response=world.bell(550.0, 60.0),
        uncertainties=world.doubts(glare_u=0.01, drift_u_rel_per_year=0.02),
        found=world.found(),
        defects=((3, 4), (7, 29)),
        validity_days=90.0,
    )


FILES = {"bare": bare, "usual": lambda: world.calibration(created=CREATED), "whole": whole}


@pytest.mark.parametrize("name", FILES)
def test_a_calibration_is_written_as_it_was(name, tmp_path):
    """Every key with its value, none where nothing is known; read back it is written the same."""
    made = FILES[name]()
    told: dict[str, Any] = made.to_mapping()
    assert Calibration.from_mapping(told, "a").to_mapping() == told
    made.write(tmp_path / "a.yaml")
    assert Calibration.read(tmp_path / "a.yaml").to_mapping() == told
    for part in (told, told["response"] or {}):
        part.pop("provenance", None)
    assert not moved(f"files/calibration_{name}", told)


@pytest.mark.parametrize("ending", [".csv", ".yaml"])
def test_a_response_is_written_as_it_was(ending, tmp_path):
    """The first lines of the file, and the same curve when it is read back."""
    path = tmp_path / f"a{ending}"
    world.gamma_curve().write(path)
    heads = {".csv": 1, ".yaml": 11}  # what follows is numbers
    passing = ("  created", "  software", "# created", "# software")
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith(passing)]
    assert not moved(f"files/response_{ending[1:]}", {"lines": len(lines), "head": lines[: heads[ending]]})
    found = ResponseCurve.read(path)
    assert found.valid_dn == (world.gamma_curve().valid_dn if ending == ".yaml" else found.valid_dn)
    assert found.log_exposure[1:255] == pytest.approx(world.gamma_curve().log_exposure[1:255], rel=1e-6)

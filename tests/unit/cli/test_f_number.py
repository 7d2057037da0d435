"""Photographs without EXIF: the f-number is asked for, at calibration and at reading."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from radiometer.cli.main import run
from radiometer.data import ResponseCurve

PATCH = "2,2,20,20"


@pytest.fixture
def folder(tmp_path):
    """Return a folder of photographs of an even surface whose times stand in a list, a curve next to it."""
    dn = np.arange(256.0)
    ResponseCurve(np.log(np.maximum(dn, 0.25) / 128), np.full(256, 1e-4), valid_dn=(1, 254)).write(tmp_path / "c.yaml")
    (tmp_path / "photos").mkdir()
    rng = np.random.default_rng(1)
    for index in range(3):
        numbers = np.round(128 + rng.normal(0, 0.6, (24, 24))).astype(np.uint8)
        numbers[:, 22:] = 1  # a dark edge: no dark signal is above it
        Image.fromarray(numbers).save(tmp_path / "photos" / f"{index}.png")
    (tmp_path / "photos" / "exposures.txt").write_text("".join(f"{i}.png 0.125\n" for i in range(3)))
    return tmp_path / "photos"


def calibrate(folder, *more: str) -> int:
    command = ["calibrate", str(folder), "--response", str(folder.parent / "c.yaml"), "--patch", PATCH]
    given = ["--radiance", "0.5", "--u-rel", "0.005", "--spectrum", "white_led", "-o", str(folder.parent / "cal.yaml")]
    return run([*command, *given, *more])


def measure(folder, *more: str) -> int:
    calibration = str(folder.parent / "cal.yaml")
    return run(
        ["measure", "--photographs", str(folder), "--calibration", calibration, "--patch", PATCH, "--json", *more]
    )


def test_a_scale_asks_for_the_f_number(folder, capsys):
    """It is refused with the way out, and nothing is written."""
    assert calibrate(folder) == 2
    assert "--f-number" in capsys.readouterr().err
    assert not (folder.parent / "cal.yaml").exists()


def test_a_reading_asks_for_the_f_number_and_uses_it(folder, capsys):
    """Calibrated at f/16 the same pictures at f/5.6 mean an eighth of the radiance; unstated they are refused."""
    assert calibrate(folder, "--f-number", "16") == 0
    assert measure(folder) == 1
    assert "--f-number" in capsys.readouterr().err
    assert measure(folder, "--f-number", "5.6") == 0
    assert json.loads(capsys.readouterr().out)["radiance"]["value"] == pytest.approx(0.5 / 8.0, rel=2e-3)


def test_photographs_have_a_drawn_interval_too(folder, capsys):
    """At f/8 under an f/16 calibration (4 % of radiance) both intervals agree."""
    assert calibrate(folder, "--f-number", "16") == 0
    capsys.readouterr()
    assert measure(folder, "--f-number", "8", "--monte-carlo") == 0
    printed = json.loads(capsys.readouterr().out)
    drawn, u = printed["monte_carlo"], printed["radiance"]["u"]
    assert drawn["u"] == pytest.approx(u, rel=0.02)
    assert drawn["high"] - drawn["low"] == pytest.approx(2.0 * printed["coverage_factor"] * u, rel=0.05)

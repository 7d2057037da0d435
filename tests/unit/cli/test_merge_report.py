"""What `merge` says of a picture: figures of every channel, each under its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiometer import Radiance
from radiometer.cli.analyse.merge_report import show_map_report
from radiometer.data import PixelMask, Provenance, RadianceMap


def _map(level, u_rel, flagged=0, displacement=None):
    """Return a map of 20 × 10 equal pixels, so many of them saturated."""
    radiance, mask = np.full((10, 20), level, np.float32), np.zeros((10, 20), np.uint8)
    mask.flat[:flagged] = PixelMask.SATURATED
    reported = (
        {} if displacement is None else dict(zip(("displacement_px", "displacement_u_px"), displacement, strict=True))
    )
    return RadianceMap(
        radiance, radiance * u_rel, mask, "relative", 0.003, (1.0,), Provenance("m", parameters=reported)
    )


def _printed(report, capsys):
    show_map_report(report)
    return capsys.readouterr().out


def test_every_colour_has_its_own_figures(capsys):
    """Blue is ten times as noisy as green and has saturated pixels: both stand there, not those of green alone."""
    maps = {
        "red": _map(2.0, 0.02, displacement=(0.0, 0.1)),
        "green": _map(3.0, 0.01, displacement=(0.25, 0.05)),
        "blue": _map(5.0, 0.1, 50, displacement=(0.0, 0.1)),
    }
    report = Radiance(maps, (Path("map.exr"),)).to_mapping()
    assert (report["values"]["median"], report["pixels"]["good"]) == (3.0, 200)
    found = {name: one["median_u_rel"] for name, one in report["by_channel"].items()}
    assert found == pytest.approx({"red": 0.02, "green": 0.01, "blue": 0.1})
    text = _printed(report, capsys)
    for line in (
        "values     blue: 5 to 5, median 5",
        "noise      green: 1 % per pixel (median, k = 1), 0.3 % common to all",
        "noise      blue: 10 % per pixel",
        "good         red 200, green 200, blue 150 pixels (100, 100, 75 %)",
        "saturated    red 0, green 0, blue 50 pixels (0, 0, 25 %)",
        "frames     green: displaced by 0.250 ± 0.050 pixels",
    ):
        assert line in text


def test_one_channel_needs_no_name(capsys):
    """Grey photographs have one line each; what no pixel is flagged with is not listed."""
    mapping = _printed(Radiance({"mono": _map(2.0, 0.02, 20)}).to_mapping(), capsys)
    assert "values     2 to 2, median 2\nnoise      2 % per pixel" in mapping
    assert "good         180 pixels (90 %)\nsaturated    20 pixels (10 %)\n" in mapping
    assert "mono" not in mapping
    assert "inconsistent" not in mapping


def test_what_colours_share_is_reported_once(capsys):
    """Three channels of the same figures have one line of noise."""
    same = {name: _map(2.0, 0.02) for name in ("red", "green", "blue")}
    assert _printed(Radiance(same).to_mapping(), capsys).count("noise") == 1

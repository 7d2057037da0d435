"""A bench with a simulated colour camera and twelve lights of known spectra, and the tables that describe them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from radiometer.analysis.colour.chromaticity import tristimulus
from radiometer.analysis.photometry.photometry import Spectrum
from radiometer.cli.main import run
from radiometer.typing import Array
from simulators.scenes.kinds import ColourLight

GRID_NM = np.arange(380.0, 781.0)
LIGHTS = {
    one.name: one
    for one in (
        *(ColourLight(name=f"led{peak}", bands=((float(peak), 30.0, 0.3),)) for peak in range(430, 650, 20)),
        ColourLight(name="white", bands=((450.0, 22.0, 0.1), (560.0, 120.0, 0.4))),
    )
}
_COLUMNS, _CELL_X, _CELL_Y = 4, 12, 10  # in pixels of a plane; patches begin 2 pixels inside


def place(name: str) -> tuple[int, int, int, int]:
    """Return x, y, width and height of a light in pixels of a plane."""
    n = list(LIGHTS).index(name)
    return _CELL_X * (n % _COLUMNS) + 2, _CELL_Y * (n // _COLUMNS) + 2, 8, 6


def true_xyz(name: str) -> Array:
    """Return X, Y, Z of a light in cd·m⁻², from its spectrum."""
    return tristimulus(Spectrum(name, GRID_NM, LIGHTS[name].spectral_radiance(GRID_NM)))


def write_colour_bench(bench: Path) -> None:
    """Write a bench file with the lights in front of the camera; their places count in pixels of the sensor."""
    names = ("name", "x", "y", "width", "height")
    content: dict[str, Any] = {
        "format": "radiometer-bench/1",
        "camera": {
            "kind": "simulated", "preset": "BFS-U3-19S4C", "pixel_format": "BayerRG12", "width": 96, "height": 60,
        },
        "lens": {"focal_length_mm": 16, "f_number": 4},
        "scene": {
            "kind": "colour_chart",
            "columns": _COLUMNS,
            "lights": [{"name": name, "bands": [list(one) for one in light.bands]} for name, light in LIGHTS.items()],
        },
        "patches": [dict(zip(names, (name, *(2 * one for one in place(name))), strict=True)) for name in LIGHTS],
    }  # fmt: skip
    bench.write_text(yaml.safe_dump(content), encoding="utf-8")


def write_colour_chart(chart: Path) -> None:
    """Write the table of the lights with their X, Y, Z and their places in a plane."""
    rows = [
        ",".join([name, "leds", *(f"{one:.6g}" for one in true_xyz(name)), *map(str, place(name))]) for name in LIGHTS
    ]
    chart.write_text("\n".join(["name,kind,X,Y,Z,left,top,width,height", *rows]) + "\n", encoding="utf-8")


def capture_colours(bench: Path, capture: Path) -> None:
    """Capture the lights."""
    ladder = ["--from", "500us", "--to", "64ms", "--stops", "1", "--darks", "1"]
    assert run(["bracket", str(capture), "--bench", str(bench), *ladder]) == 0

"""A desk with what the examples name: benches, captures, photographs, tables, a journal."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from radiometer.cli.main import run
from radiometer.daemon.journal import Journal
from radiometer.data import Patch, Quantity, Reading
from radiometer.data.reading import Contribution
from testing.colour_bench import capture_colours, write_colour_bench, write_colour_chart
from testing.photograph_folder import write_photographs
from testing.scripted_adaptation import SubjectCurve
from testing.sky_log import Camera, sky_log, write

BENCH = """\
format: radiometer-bench/1
camera: {kind: simulated, preset: BFS-U3-19S4M, serial: "22500001", seed: 5, width: 96, height: 64, black_level_dn: 64}
lens: {focal_length_mm: 16, f_number: 4, transmittance: 0.95, transmittance_u_rel: 0.01}
SCENE
patch: {x: 40, y: 24, width: 16, height: 16}
calibration: calibration.yaml
"""
UNIFORM = "scene: {kind: uniform, radiance_W_per_sr_m2: 0.3}"
CHART = "scene: {kind: step_chart, steps: {count: 24, lowest: 0.02, highest: 1.2}, scramble_seed: 5}"
METER = (
    "screen,luminance,f_number,time,iso\nscreen,250,5.6,1/60,100\nscreen,500,5.6,1/125,100\nscreen,1000,5.6,1/250,100\n"
)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    """Return a folder with what the examples name: a bench, its calibration, a chart, photographs, a meter's table."""
    folder = tmp_path_factory.mktemp("desk")
    shutil.copy(project_root / "configs" / "calibrations" / "simulated.yaml", folder / "calibration.yaml")
    (folder / "bench.yaml").write_text(BENCH.replace("SCENE", UNIFORM), encoding="utf-8")
    (folder / "chart.yaml").write_text(BENCH.replace("SCENE", CHART), encoding="utf-8")
    (folder / "meter.csv").write_text(METER, encoding="utf-8")
    ladder = ["--from", "200us", "--to", "51.2ms", "--stops", "1", "--darks", "1"]
    assert run(["bracket", str(folder / "out" / "chart"), "--bench", str(folder / "chart.yaml"), *ladder]) == 0
    write_colour_bench(folder / "colours.yaml")
    write_colour_chart(folder / "colours.csv")
    capture_colours(folder / "colours.yaml", folder / "colours")
    ramp = np.geomspace(100, 4000, 96)[None, :, None] * np.ones((64, 1, 3)) * np.array([0.8, 1.0, 0.6])
    times = (0.02, 0.04, 0.08)
    write_photographs(folder / "photographs", [np.clip(ramp * s, 0, 255).astype(np.uint8) for s in times], times)
    words = ["--calibration", str(folder / "calibration.yaml"), "-o", str(folder / "map.tiff")]
    assert run(["merge", str(folder / "out" / "chart"), *words]) == 0
    _write_tables(folder)
    with Journal(folder / "journal.sqlite") as journal:
        journal.append([_reading(0.30, Patch(40, 24, 16, 16)), _reading(0.31, Patch(40, 24, 16, 16))])
        journal.append([_reading(0.9, Patch(0, 0, 8, 8))])
    return folder


def _reading(radiance: float, patch: Patch) -> Reading:
    budget = (Contribution("scale", 0.003), Contribution("repeatability", 0.004))
    return Reading(Quantity(radiance, 0.005 * radiance, "W sr-1 m-2"), patch, "22500001", budget=budget)


def _write_tables(folder: Path) -> None:
    """Write a year of readings that drift, statistics, a sky log, luminances of a screen, and thresholds."""
    rng = np.random.default_rng(1)
    days = np.arange(0, 180, 2)
    lamp = 0.8 * (1 - 0.01 * days / 30.4 + 0.002 * rng.standard_normal(days.size))
    rows = [
        f"{1.7e9 + 86400.0 * day},radiance,lamp,{value:.6f},0.004,W sr-1 m-2,ok"
        for day, value in zip(days, lamp, strict=True)
    ]
    (folder / "history.csv").write_text(
        "\n".join(["captured,quantity,patch,value,u,unit,status", *rows]) + "\n", encoding="utf-8"
    )
    (folder / "statistics.csv").write_text(
        "exposure_ms,mean_dn,variance_dn2\n0,10,2\n1,110,52\n2,210,102\n3,310,152\n", encoding="utf-8"
    )
    write(sky_log(3, Camera(black_dn=20.0), nights=5, readings=30), folder / "sky.csv")
    levels = range(0, 256, 51)
    luminances = [f"{level},{0.1 + 119.9 * (level / 255) ** 2.2:.4f}" for level in levels]
    (folder / "luminances.csv").write_text("\n".join(["level,cd/m2", *luminances]) + "\n", encoding="utf-8")
    engine = [
        f"{name},{drive},{drive * (1 - bend * drive / 255):.5f}"
        for name, bend in (("blue", 0.1), ("red", 0.0))
        for drive in range(15, 256, 15)
    ]
    (folder / "engine.csv").write_text("\n".join(["channel,drive,light", *engine]) + "\n", encoding="utf-8")
    party = "{name: A, email: a@example.org, city: Bonn, country: DE}"
    (folder / "laboratory.yaml").write_text(
        f"format: radiometer-laboratory/1\nlaboratory: {party}\ncustomer: {party}\nresponsible: {{name: R. Smith}}\n"
        'item: {name: camera, manufacturer: Maker, serial: "22500001"}\n',
        encoding="utf-8",
    )
    seconds = np.arange(5000) / 20_000.0
    light = 1.0 + 0.3 * np.sin(2.0 * np.pi * 100.0 * seconds)
    np.savetxt(folder / "lamp.csv", np.transpose([seconds, light]), "%.6f", ",", header="time_s,light", comments="")
    times = np.arange(0.5, 30, 0.5)
    found = [f"{t},{SubjectCurve().threshold(t) + rng.normal(0, 0.05):.4f}" for t in times]
    (folder / "thresholds.csv").write_text("\n".join(["minutes,log10_threshold", *found]) + "\n", encoding="utf-8")

"""Colour of patches and pictures, measured with the simulated colour camera and compared with its true spectra."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
import yaml

import radiometer as rm
from radiometer.analysis.colour.chromaticity import coordinates
from radiometer.analysis.exports.maps import read_tiff
from radiometer.cli.main import run
from radiometer.data import CaptureSet, CaptureSetWriter
from radiometer.data.mosaic import COLOURS
from radiometer.errors import CalibrationError, InputError, RadiometerError, UsageError
from simulators.cameras.simulated_camera import ColourFilters
from testing.colour_bench import (
    GRID_NM,
    LIGHTS,
    capture_colours,
    place,
    true_xyz,
    write_colour_bench,
    write_colour_chart,
)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a capture of twelve lights, their spectra, their X, Y, Z, and a calibration."""
    folder = tmp_path_factory.mktemp("colour")
    write_colour_bench(folder / "bench.yaml")
    write_colour_chart(folder / "chart.csv")
    capture_colours(folder / "bench.yaml", folder / "set")
    powers = [one.spectral_radiance(GRID_NM) for one in LIGHTS.values()]
    heading = ",".join(["wavelength_nm", *LIGHTS])
    np.savetxt(folder / "spectra.csv", np.transpose([GRID_NM, *powers]), "%.9f", ",", header=heading, comments="")
    rm.colour_calibrate(folder / "set", folder / "chart.csv", out=folder / "colour.yaml")
    return folder


@pytest.mark.parametrize("name", LIGHTS)
def test_each_light_is_read_within_its_uncertainty(bench: Path, name: str) -> None:
    """X, Y, Z and chromaticity of a light agree with its spectrum within U (k = 2.5 for 12 · 5 figures)."""
    found = rm.colour_measure(bench / "set", calibration=bench / "colour.yaml", patch=place(name), kind="leds")
    true = true_xyz(name)
    xy = coordinates(true, np.zeros((3, 3))).xy
    for quantity, value in zip("XYZxy", [*true, *xy], strict=True):
        one = found[quantity]
        assert abs(one.value - value) < 2.5 * one.u
    assert found["Y"].unit == "cd m-2"
    assert "other_light" not in found.flags


def test_spectra_and_tristimulus_values_give_one_calibration(bench: Path) -> None:
    """The X, Y, Z are those of the spectra; a patch over several filters has no one radiance."""
    of_spectra = rm.colour_calibrate(bench / "set", spectra=bench / "spectra.csv", kind="leds").calibration
    of_chart = rm.colour_calibrate(bench / "set", bench / "chart.csv").calibration
    assert of_spectra.matrices["all"].matrix == pytest.approx(of_chart.matrices["all"].matrix, rel=1e-4)
    assert of_spectra.unit == "cd m-2"
    with pytest.raises(UsageError, match="mosaic of colours"):
        rm.measure(bench=bench / "bench.yaml", patch=(0, 0, 8, 8), uncalibrated=True)
    assert rm.read(bench / "set").bracket.shape == (30, 48)
    assert set(rm.merge(bench / "set").maps) == {"red", "green", "blue"}


def test_every_pixel_has_the_colour_of_its_patch(bench: Path, tmp_path: Path) -> None:
    """The mean over a patch of the picture is the reading of the patch; a dark pixel has no chromaticity."""
    args = {"calibration": bench / "colour.yaml", "patch": place("white"), "kind": "leds"}
    found = rm.colour_measure(bench / "set", maps=tmp_path / "map.tiff", **args)
    maps = read_tiff(tmp_path / "map.tiff").maps
    assert list(maps) == ["X", "Y", "Z", "x", "y", "u_prime", "v_prime", "cct", "duv"]
    for name, one in maps.items():
        part = one.radiance[rm.Patch(*place("white")).slices]
        assert float(np.mean(part)) == pytest.approx(found[name].value, rel=0.01, abs=1e-3)
        assert one.unit == found[name].unit
    assert tifffile.imread(tmp_path / "map.tiff").shape[-1] == 9
    assert np.isnan(maps["x"].radiance[0, 0])


def test_the_command_prints_what_the_function_returns(bench: Path, tmp_path: Path, capsys) -> None:
    """JSON, page and picture; the page holds its picture and loads nothing."""
    words = ["colour", "measure", str(bench / "set"), "--calibration", str(bench / "colour.yaml"), "--kind", "leds",
             "--patch", ",".join(map(str, place("white"))), "--json"]  # fmt: skip
    assert run([*words, "--report", str(tmp_path / "page.html"), "--plot", str(tmp_path / "xy.png")]) == 0
    printed = json.loads(capsys.readouterr().out)
    found = rm.colour_measure(bench / "set", calibration=bench / "colour.yaml", patch=place("white"), kind="leds")
    assert printed == json.loads(found.to_json())
    assert "data:image/png" in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert (tmp_path / "xy.png").stat().st_size > 1000


def test_filters_before_a_monochrome_camera_are_channels(bench: Path, tmp_path: Path) -> None:
    """Captures behind three filters, here the planes of the mosaic, give the matrix of the mosaic.

    Filters that are exchanged are refused. A grey filter before one of them, known to ±10 %, is in u.
    """
    whole, filters = CaptureSet.read(bench / "set"), {}
    camera = whole.header.camera.model_copy(update={"mosaic": None})
    lens = whole.header.lens.model_copy(update={"transmittance": 0.9})
    for colour in COLOURS:
        behind = camera.model_copy(update={"filter": f"{colour} glass"})
        with CaptureSetWriter(tmp_path / colour, behind, lens) as writer:
            for frame in replace(whole, colour=colour).frames():
                writer.add(frame)
        filters[colour] = tmp_path / colour
    found = rm.colour_calibrate(chart=bench / "chart.csv", filters=filters).calibration
    expected = rm.colour_calibrate(bench / "set", bench / "chart.csv").calibration
    assert found.matrices["all"].matrix == pytest.approx(expected.matrices["all"].matrix, rel=1e-6)
    words = [word for name, folder in filters.items() for word in ("--filter", f"{name}={folder}")]
    asked = ["--chart", str(bench / "chart.csv"), "--out", str(tmp_path / "colour.yaml")]
    assert run(["colour", "calibrate", *words, *asked]) == 0
    assert (
        yaml.safe_load((tmp_path / "colour.yaml").read_text())["matrices"] == found.model_dump(mode="json")["matrices"]
    )
    asked = {"calibration": found, "patch": place("white"), "kind": "leds"}
    with pytest.raises(CalibrationError, match="filter red glass, green glass, blue glass, the frames were taken with"):
        rm.colour_measure(filters={**filters, "red": filters["green"], "green": filters["red"]}, **asked)
    plain = rm.colour_measure(filters=filters, **asked)
    header = filters["green"] / "capture.yaml"
    stated = yaml.safe_load(header.read_text())
    stated["lens"]["transmittance"] = 0.09
    header.write_text(yaml.safe_dump(stated))
    grey = rm.colour_measure(filters=filters, **asked)
    for channel, u_rel in (("red", 0.0), ("green", 0.1 / math.sqrt(3.0)), ("blue", 0.0)):
        added = [one.signals[channel].u / one.signals[channel].value for one in (grey, plain)]
        assert math.sqrt(added[0] ** 2 - added[1] ** 2) == pytest.approx(math.sqrt(2.0) * u_rel, abs=1e-6)


def test_photographs_need_to_be_proportional_to_light(bench: Path, tmp_path: Path) -> None:
    """Linear photographs of the lights give each light's colour; developed ones of unknown response are refused."""
    responses = [ColourFilters().responsivity(colour, GRID_NM) for colour in COLOURS]
    picture = np.zeros((30, 48, 3))
    for name, light in LIGHTS.items():
        picture[rm.Patch(*place(name)).slices] = np.sum(light.spectral_radiance(GRID_NM) * responses, axis=1)
    noise = np.random.default_rng(46_031)
    for n, seconds in enumerate((0.02, 0.04, 0.08)):
        values = 4e6 * seconds * picture / picture.max() / 8.0
        drawn = np.clip(noise.normal(values, np.sqrt(values + 1.0)), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(tmp_path / f"{n}.png"), drawn[..., ::-1])
    (tmp_path / "exposures.txt").write_text("0.png 0.02\n1.png 0.04\n2.png 0.08\n", encoding="utf-8")
    with pytest.raises(UsageError, match="--linear"):
        rm.colour_calibrate(tmp_path, bench / "chart.csv")
    known = rm.colour_calibrate(tmp_path, bench / "chart.csv", linear=True, f_number=4.0).calibration
    args = {"patch": place("white"), "kind": "leds", "linear": True}
    with pytest.raises(CalibrationError, match="--f-number"):
        rm.colour_measure(tmp_path, calibration=known, **args)
    found = rm.colour_measure(tmp_path, calibration=known, f_number=4.0, **args)
    for quantity, value in zip("XYZ", true_xyz("white"), strict=True):
        assert abs(found[quantity].value - value) < 2.5 * found[quantity].u


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"patch": (40, 20, 8, 20)}, InputError, "leaves the map"),
        ({"patch": (0, 0, 2, 1)}, RadiometerError, "no light"),
        ({"kind": "moonlight"}, UsageError, "the calibration knows"),
        ({"source": None}, UsageError, "--filter NAME=FOLDER"),
        ({"maps": "map.png"}, UsageError, r"\.exr"),
        ({"calibration": "chart.csv"}, InputError, "expected keys and values"),
    ],
)
def test_what_gives_no_reading_is_refused(bench: Path, monkeypatch, given, error, said) -> None:
    """Each refusal names what is wrong."""
    monkeypatch.chdir(bench)
    usual = {"source": "set", "calibration": "colour.yaml", "patch": place("white"), "kind": "leds"}
    with pytest.raises(error, match=said):
        rm.colour_measure(**{**usual, **given})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        (lambda lines: lines[:4], CalibrationError, "4 lights or more"),
        (lambda lines: [lines[0].replace("left", "a"), *lines[1:]], InputError, "has no column left"),
        (lambda lines: [lines[0].replace("X,Y,Z", "X,Y,a"), *lines[1:]], InputError, "has no column z"),
        (lambda lines: [*lines, lines[1]], InputError, "occurs twice"),
        (lambda lines: [lines[0].replace("X,Y,Z", "a,b,c"), *lines[1:]], InputError, "no columns X, Y, Z"),
    ],
)  # fmt: skip
def test_a_chart_that_determines_nothing_is_refused(bench: Path, tmp_path: Path, change, error, said) -> None:
    """Each refusal names what is wrong, and no file is written."""
    lines = (bench / "chart.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "chart.csv").write_text("\n".join(change(lines)) + "\n", encoding="utf-8")
    with pytest.raises(error, match=said):
        rm.colour_calibrate(bench / "set", tmp_path / "chart.csv", out=tmp_path / "colour.yaml")
    assert not (tmp_path / "colour.yaml").exists()


def test_a_colour_calibration_past_its_time_or_for_other_conditions(bench: Path) -> None:
    """A flag after a year; an f-number that it does not state, and a variance below 0, are refused."""
    text = (bench / "colour.yaml").read_text()
    stated = yaml.safe_load(text)
    args = {"patch": place("white"), "kind": "leds"}
    old = {**stated, "created": "1990-01-01T00:00:00+00:00"}
    (bench / "old.yaml").write_text(yaml.safe_dump(old))
    assert "stale_calibration" in rm.colour_measure(bench / "set", calibration=bench / "old.yaml", **args).flags
    silent = {**stated, "lens": {**stated["lens"], "f_number": None}}
    errors = {kind: [[-one for one in row] for row in error] for kind, error in stated["errors"].items()}
    negative = {**stated, "errors": errors}
    for wrong, why in ((silent, "f-number"), (negative, "below 0")):
        (bench / "wrong.yaml").write_text(yaml.safe_dump(wrong))
        with pytest.raises(CalibrationError, match=why):
            rm.colour_measure(bench / "set", calibration=bench / "wrong.yaml", **args)

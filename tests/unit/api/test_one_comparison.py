"""What differs between a capture and its calibration does the same to a radiance, a colour and a flux."""

import csv
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import radiometer as rm
from radiometer.data import (
    Calibration,
    CameraDescription,
    CaptureSet,
    CaptureSetWriter,
    Frame,
    FrameSettings,
    LensDescription,
    Scale,
    ScaleConditions,
    SensorNoise,
)
from radiometer.errors import CalibrationError, UsageError
from testing.colour_bench import capture_colours, place, write_colour_bench, write_colour_chart

Change = Callable[[dict[str, Any]], None]


def of_camera(**facts: Any) -> Change:
    return lambda header: header["camera"].update(facts)


def of_lens(**facts: Any) -> Change:
    return lambda header: header["lens"].update(facts)


def of_frames(**facts: Any) -> Change:
    return lambda header: [one.update(facts) for one in header["frames"]]  # type: ignore[func-returns-value]


def without_f_number(header: dict[str, Any]) -> None:
    header["lens"].pop("f_number", None)
    for one in header["frames"]:
        one.pop("f_number", None)


CHANGES: dict[str, Change] = {
    "nothing": lambda header: None,
    "another serial number": of_camera(serial="other"),
    "another model": of_camera(model="other"),
    "another pixel pitch": of_camera(pixel_pitch_um=9.0),
    "another mode": of_camera(mode="GAIN 300"),
    "a filter that the calibration does not state": of_camera(filter="V"),
    "a conversion gain of another mode": of_camera(conversion_gain_e_per_dn=0.5),
    "another focal length": of_lens(focal_length_mm=50.0),
    "a transmittance that the calibration does not state": of_lens(transmittance=0.5),
    "another focus": of_lens(magnification=1.0),
    "another pupil": of_lens(magnification=1.0, pupil_magnification=2.0),
    "another f-number": of_frames(f_number=8.0),
    "no f-number": without_f_number,
    "another gain": of_frames(gain_db=12.0),
    "another exposure": of_frames(exposure_s=0.02),
    "another temperature": of_frames(temperature_C=-20.0),
    "an iris that was set again": of_lens(since_calibration=["iris_reset"]),
}


class Bench:
    """Two capture sets with their calibrations, as they were and with another header."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.changed = folder, 0
        write_colour_bench(folder / "bench.yaml")
        write_colour_chart(folder / "chart.csv")
        capture_colours(folder / "bench.yaml", folder / "colours")
        self.colours = rm.colour_calibrate(folder / "colours", folder / "chart.csv").calibration
        self.write_diode(folder / "diode")

    @staticmethod
    def write_diode(folder: Path) -> None:
        """Write frames of a bright disc before a dark field."""
        camera = CameraDescription(bit_depth=12, model="A", serial="1", pixel_pitch_um=4.5, black_level_dn=100.0)
        rows, columns = np.mgrid[:60, :80]
        disc = (rows - 30) ** 2 + (columns - 40) ** 2 < 20**2
        with CaptureSetWriter(folder, camera, LensDescription(focal_length_mm=16.0, f_number=4.0)) as writer:
            for n in range(2):
                settings = FrameSettings(0.01, f_number=4.0, black_level_dn=100.0, temperature_c=40.0, timestamp_s=n)
                writer.add(Frame(np.where(disc, 2000, 100).astype(np.uint16), 12, settings))

    def with_header(self, name: str, change: Change) -> Path:
        """Return a copy of a set whose frames share one exposure, with a changed header."""
        self.changed += 1
        copy = self.folder / f"{name}{self.changed}"
        shutil.copytree(self.folder / name, copy)
        header = yaml.safe_load((copy / "capture.yaml").read_text())
        light = [one for one in header["frames"] if one["shutter"] == "open"]
        header["frames"] = [one for one in light if one["exposure_s"] == light[0]["exposure_s"]]
        change(header)
        (copy / "capture.yaml").write_text(yaml.safe_dump(header))
        return copy

    def scaled(self, name: str) -> Calibration:
        """Return a calibration under the conditions of the first frame of a set."""
        header = CaptureSet.read(self.folder / name).header
        conditions = ScaleConditions(temperature_c=header.frames[0].settings.temperature_c)
        scale = Scale(value=1e-6, u_rel=0.01, method="known_radiance", f_number=4.0, conditions=conditions)
        return Calibration(header.camera, header.lens, scale, None, SensorNoise.of(header.camera))

    def radiance(self, name: str, change: Change) -> tuple[float, float]:
        """Return the mean radiance of a place of a set, and the relative u that all pixels share."""
        known = self.scaled(name)
        channel = "green" if known.camera.mosaic else None
        where = place("white") if known.camera.mosaic else (35, 25, 10, 10)
        found = rm.merge(self.with_header(name, change), calibration=known, channel=channel).maps
        one = next(iter(found.values()))
        return float(one.radiance[rm.Patch(*where).slices].mean()), one.u_rel_common

    def colour(self, change: Change) -> tuple[float, float]:
        """Return the luminance of the white light, and its relative u."""
        found = rm.colour_measure(
            self.with_header("colours", change), calibration=self.colours, patch=place("white"), kind="leds"
        )["Y"]
        assert found is not None
        return found.value, found.u_rel

    def flux(self, change: Change) -> tuple[float, float]:
        """Return the flux that radiance and area of the disc give, and the relative u of the flux on the sensor."""
        known = self.scaled("diode")
        found = rm.flux(self.with_header("diode", change), calibration=known, half_angle=60.0, diameter=3.0).report
        return found.emitted["radiance_times_area"].value, found.on_sensor.u_rel


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Return the bench."""
    return Bench(tmp_path_factory.mktemp("comparison"))


def outcome(read: Callable[[Change], tuple[float, float]], change: Change) -> tuple[float, float] | None:
    """Return by what a change multiplies a value, and the relative variance that it adds; None where it is refused."""
    value, u_rel = read(CHANGES["nothing"])
    try:
        changed, wider = read(change)
    except CalibrationError:
        return None
    return changed / value, wider**2 - u_rel**2


@pytest.mark.parametrize("name", CHANGES)
def test_colour_and_flux_do_what_a_radiance_does(bench: Bench, name: str) -> None:
    """The same factor and no less added uncertainty, or a refusal, for each fact that a header states."""
    change = CHANGES[name]
    for radiance_of, read in (("colours", bench.colour), ("diode", bench.flux)):
        expected = outcome(lambda one, of=radiance_of: bench.radiance(of, one), change)  # type: ignore[misc]
        found = outcome(read, change)
        assert (found is None) == (expected is None), (radiance_of, expected, found)
        if found is not None and expected is not None:
            assert found[0] == pytest.approx(expected[0], rel=0.006), radiance_of
            assert found[1] > 0.95 * expected[1] - 3e-5, (
                radiance_of
            )  # a dark level is as uncertain as its gain makes it


def test_a_mosaic_of_another_order_is_refused(bench: Bench) -> None:
    """Red and blue would change places."""
    with pytest.raises(CalibrationError, match="mosaic"):
        bench.colour(of_camera(mosaic="BGGR"))


def test_a_calibration_of_one_colour_of_a_mosaic_reads_that_colour_alone(bench: Bench) -> None:
    """Red's scale reads red by itself, and refuses green; one that states no colour is doubted. A file states it."""
    capture, where, file = bench.with_header("colours", CHANGES["nothing"]), place("white"), bench.folder / "red.yaml"
    known = rm.calibrate(capture, patch=where, radiance=2.0, u_rel=0.01, channel="red", out=file).calibration
    maps = rm.merge(capture, calibration=file).maps
    assert list(maps) == ["red"]
    assert np.mean(maps["red"].radiance[rm.Patch(*where).slices]) == pytest.approx(2.0, rel=0.01)
    table = rm.batch(capture, output=bench.folder / "rows.csv", calibration=file, patch=where).table
    rows = csv.DictReader(table.read_text().splitlines())
    assert float(next(one["value"] for one in rows if one["quantity"] == "radiance")) == pytest.approx(2.0, rel=0.01)
    with pytest.raises(UsageError, match="calibration is of red"):
        rm.merge(capture, calibration=file, channel="green")
    with pytest.raises(UsageError, match="calibration is of red"):
        rm.flux(capture, calibration=file, channel="blue")
    with pytest.raises(UsageError, match="calibration is of red"):
        rm.measure_photographs(capture, where, calibration=file, channel="green")
    silent = replace(known, scale=known.scale.model_copy(update={"conditions": ScaleConditions()}))
    assert any(
        "red at calibration too" in one for one in rm.merge(capture, calibration=silent, channel="red").assumptions
    )

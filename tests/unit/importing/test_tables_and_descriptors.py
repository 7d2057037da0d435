"""Tables, descriptors, and what statements in them mean."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from astropy.io import fits

from radiometer.cli.main import run
from radiometer.data import CaptureSet
from radiometer.data.statements import Statement, StatementMap, value_of
from radiometer.errors import CaptureError, InputError, UnsettledError, UsageError
from radiometer.importing import ImportOptions, import_sources, imported_of, open_capture, statistics_of
from radiometer.importing.emva_listing import EmvaListing


def table(tmp_path, text, name="t.csv"):
    """Write a table."""
    path = tmp_path / name
    path.write_text(text)
    return path


def test_json_lines_with_nested_settings(tmp_path):
    """One object per line, settings one level down, darkness by word."""
    text = (
        '{"settings": {"exposure_s": 0.5, "gain_db": 6}, "mean": 100, "variance": 20, "frames": 8, "pixels": 400}\n'
        '{"settings": {"exposure_s": 0, "shutter": "closed"}, "mean": 10, "variance": 2, "frames": 8, "pixels": 400}\n'
    )
    light, dark = statistics_of(table(tmp_path, text, "t.jsonl")).statistics
    assert (light.gain_db, light.frames, light.pixels, light.shutter) == (6, 8, 400, "open")
    assert (dark.exposure_s, dark.shutter) == (0, "closed")


def test_pixels_from_shares(tmp_path):
    """Shares that are multiples of 1/80000 tell pairs of 40000 pixels, and the clipping code the bits."""
    text = "exposure_ms,mean_dn,variance_dn2,share_at_255\n3,27,140,0\n9,80,300,0.0000125\n30,245,121,0.7542\n"
    header = statistics_of(table(tmp_path, text))
    assert [row.pixels for row in header.statistics] == [40000] * 3
    assert header.camera.bit_depth == 8
    assert header.statistics[2].clipped_share == 0.7542


def test_what_a_table_does_not_hold_is_not_taken_of_it(tmp_path):
    """A variance over one frame is spatial; a row that lacks cells, and what works on pixels, are refused in words."""
    assert statistics_of(table(tmp_path, "exposure_s,mean,var,frames\n1,10,3,1\n")).statistics[0].variance_dn2 is None
    assert statistics_of(table(tmp_path, "luminance,f_number,time,iso\n1,2,3,4\n")) is None
    with pytest.raises(CaptureError, match="line 3"):
        statistics_of(table(tmp_path, "exposure_s,mean,variance\n1,10,3\n2,2"))
    with pytest.raises(CaptureError, match="characterise"):
        open_capture(table(tmp_path, "exposure_s,mean,variance\n1,10,3\n2,20,6\n"))


@pytest.fixture
def descriptor(tmp_path):
    """Return a function that writes a descriptor over images of given levels."""

    def write(lines):
        text = ["v 3.0", "n 12 8 6"]
        for number, (line, level) in enumerate(lines):
            cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((6, 8), level, np.uint16))
            text += [line, f"i {number}.png"]
        path = tmp_path / "EMVA1288_Data.txt"
        path.write_text("\n".join(text) + "\n")
        return path

    return write


def test_an_exposure_of_zero_is_a_dark_frame(descriptor):
    """d 0 is a bias pair; nanoseconds become seconds; a negative exposure is refused by its line."""
    path = descriptor([("d 0", 100), ("b 1000000 500", 900)])
    dark, light = open_capture(path).header.frames
    assert (dark.exposure_s, dark.shutter) == (0, "closed")
    assert (light.exposure_s, light.photons, light.source_level) == (1e-3, 500, 1.0)
    with pytest.raises(InputError, match="line 3"):
        EmvaListing.read(descriptor([("b -5 100", 10)]))


@pytest.mark.parametrize(
    ("lines", "levels", "doubt"),
    [
        # At one exposure the level goes as the photons.
        (["d 2000000", "b 2000000 250", "b 2000000 1000"], [1.0, 0.25, 1.0], "do not follow the exposure"),
        # 961 photons of 961.8 are no dimmer lamp.
        (["d 0", "b 320000 961", "b 14020000 42137"], [1.0, 1.0, 1.0], None),
        # The photons are the light; a stand-in exposure is stated as such.
        (["d 0", "b 0 250", "b 0 1000"], [1.0, 0.25, 1.0], "is assumed"),
    ],
)
def test_photons_count_where_light_does_not_follow_exposure(descriptor, lines, levels, doubt):
    """The level of the source is that of the photons, and the record says so."""
    capture = open_capture(descriptor(list(zip(lines, (100, 500, 1700), strict=True))))
    assert [e.source_level for e in capture.header.frames] == levels
    assert all(e.exposure_s > 0 for e in capture.header.frames[1:])
    assert doubt is None or any(doubt in line for line in imported_of(capture).doubts)


CONFIGS = sorted((Path(__file__).resolve().parents[3] / "configs" / "importing").glob("*.yaml"))

PICTURE = (np.arange(24 * 32).reshape(24, 32) + 1000).astype(np.uint16)


def test_a_map_names_keyword_and_unit_and_stays_in_the_set(write_fits, tmp_path, capsys):
    """`exposure=IMG-EXP:ms` reads 20 as 20 ms; the record holds the words, which read the same again."""
    path = write_fits("a.fits", PICTURE, IMG_EXP=20, GAIN=120, INSTRUME="CAM", IMAGETYP="light")
    assert run(["import", str(path), "-o", str(tmp_path / "none")]) == 1
    assert "IMG-EXP" in capsys.readouterr().err
    words = ["exposure=IMG-EXP:ms", "gain=GAIN:0.1dB"]
    assert run(["import", str(path), "-o", str(tmp_path / "out"), "--map", words[0], "--map", words[1]]) == 0
    written = CaptureSet.read(tmp_path / "out")
    assert (written.header.frames[0].exposure_s, written.header.frames[0].gain_db) == (0.02, 12.0)
    assert imported_of(written).mapped == tuple(words)
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(StatementMap.parse(imported_of(written).mapped).to_mapping()))
    assert run(["import", str(path), "-o", str(tmp_path / "again"), "--map", str(tmp_path / "map.yaml")]) == 0
    assert CaptureSet.read(tmp_path / "again").header.frames[0].exposure_s == 0.02


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["exposure=IMG_EXP:furlong"], "no unit of exposure"),
        (["exposition=EXPTIME:s"], "no fact"),
        (["exposure"], "FACT=PLACE:UNIT"),
    ],
)
def test_a_map_that_cannot_be_meant_is_misuse(words, message):
    """Facts and units are a closed list; the message has it."""
    with pytest.raises(UsageError, match=message):
        StatementMap.parse(words)


def test_a_number_is_true_of_all_frames_and_a_place_that_no_file_has_is_refused(write_fits):
    """`exposure=250:ms` gives all frames their exposure; a typing error is not replaced by the format's own keyword."""
    path = write_fits("a.fits", PICTURE, EXPTIME=1.0, IMAGETYP="light")
    found = import_sources([path], ImportOptions(mapped=StatementMap.parse(["exposure=250:ms"])))
    assert found[0].header.frames[0].exposure_s == 0.25
    with pytest.raises(UnsettledError, match="EXPTIMF"):
        import_sources([path], ImportOptions(mapped=StatementMap.parse(["exposure=EXPTIMF:ms"])))


@pytest.mark.parametrize("file", CONFIGS, ids=lambda path: path.stem)
def test_every_map_of_a_maker_is_read_and_names_its_source(file):
    """Facts and units are known, the exposure is among them, and the file says where its keywords come from."""
    assert "exposure" in StatementMap.parse([str(file)]).places
    assert "# Source: " in file.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("fact", "written", "unit", "expected"),
    [
        ("temperature", 999, "degC", None),
        ("temperature", -999, "degC", None),
        ("temperature", -1, "degC", -1.0),
        ("temperature", 268.15, "K", -5.0),
        ("temperature", 23.0, "F", -5.0),
        ("iso", 65_535, "ISO", None),
        ("iso", 102_400, "ISO", 102_400),
        ("exposure", -1, "s", None),
        ("exposure", "1/250", "s", 0.004),
        ("exposure", "20 ms", "", 0.02),
        ("exposure", "", "s", None),
        ("exposure", float("nan"), "s", None),
        ("gain", 4, "x", 12.0412),
        ("gain", 400, "iso", 12.0412),
        ("conversion_gain", 0.5, "DN/e-", 2.0),
        ("luminance", 10, "fL", 34.2626),
        *((fact, value, unit, value or None) for fact, unit in (("f_number", "1"), ("conversion_gain", "e-/DN"))
          for value in (0, 1.0)),
    ],
)  # fmt: skip
def test_numbers_become_values_in_base_units(fact, written, unit, expected):
    """By hand: K − 273.15, (F − 32)·5/9, 20·log10, 1 fL = 3.42626 cd/m²; a sentinel is unknown and doubted."""
    doubts: list[str] = []
    found = value_of(Statement(written, unit), fact, "KEY", doubts)
    assert found == (expected if expected is None else pytest.approx(expected, rel=1e-5))
    assert bool(doubts) == (expected is None and written not in ("",) and written == written)


def test_what_is_not_used_is_named(write_fits, tmp_path):
    """Further pictures and tables of a FITS file are in the report."""
    path = write_fits("a.fits", PICTURE, EXPTIME=1.0, IMAGETYP="light")
    with fits.open(path, mode="append") as units:
        units.append(fits.ImageHDU(PICTURE, name="ERR"))
        units.append(fits.BinTableHDU.from_columns([fits.Column("x", "E", array=[1.0])], name="EVENTS"))
    reported = " ".join(import_sources([path])[0].header.model_extra["imported"]["not_used"])
    assert "ERR" in reported
    assert "EVENTS" in reported


def test_pictures_that_each_state_an_exposure_are_all_frames(tmp_path):
    """A bracket in the extensions of one file: each has the exposure of its header."""
    units = [fits.PrimaryHDU()]
    for n, seconds in enumerate((0.1, 0.2, 0.4)):
        unit = fits.ImageHDU(PICTURE + np.uint16(n))
        unit.header["EXPTIME"] = seconds
        units.append(unit)
    fits.HDUList(units).writeto(tmp_path / "m.fits")
    found = import_sources([tmp_path / "m.fits"])[0].header.frames
    assert [entry.exposure_s for entry in found] == [0.1, 0.2, 0.4]

"""`--map` states where facts are, one by one or as a file; units, sentinels and what a file leaves open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from radiometer.cli.main import run
from radiometer.data import CaptureSet
from radiometer.data.statements import Statement, StatementMap, value_of
from radiometer.errors import UnsettledError, UsageError
from radiometer.importing import ImportOptions, import_sources, imported_of

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


def test_a_number_is_true_of_all_frames(write_fits):
    """`exposure=0.25:s` gives frames that state none their exposure."""
    path = write_fits("a.fits", PICTURE, IMAGETYP="light")
    found = import_sources([path], ImportOptions(mapped=StatementMap.parse(["exposure=250:ms"])))
    assert found[0].header.frames[0].exposure_s == 0.25


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


def test_a_place_that_no_file_has_is_refused(write_fits):
    """A typing error in --map is never replaced by the format's own keyword."""
    path = write_fits("a.fits", PICTURE, EXPTIME=1.0, IMAGETYP="light")
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
    ],
)
def test_numbers_become_values_in_base_units(fact, written, unit, expected):
    """By hand: K − 273.15, (F − 32)·5/9, 20·log10, 1 fL = 3.42626 cd/m²; a sentinel is unknown and doubted."""
    doubts: list[str] = []
    found = value_of(Statement(written, unit), fact, "KEY", doubts)
    assert found == (expected if expected is None else pytest.approx(expected, rel=1e-5))
    assert bool(doubts) == (expected is None and written not in ("",) and written == written)


def test_what_is_not_used_is_named(write_fits, tmp_path):
    """Further pictures and tables of a FITS file are in the report."""
    from astropy.io import fits

    path = write_fits("a.fits", PICTURE, EXPTIME=1.0, IMAGETYP="light")
    with fits.open(path, mode="append") as units:
        units.append(fits.ImageHDU(PICTURE, name="ERR"))
        units.append(fits.BinTableHDU.from_columns([fits.Column("x", "E", array=[1.0])], name="EVENTS"))
    reported = " ".join(import_sources([path])[0].header.model_extra["imported"]["not_used"])
    assert "ERR" in reported
    assert "EVENTS" in reported


def test_pictures_that_each_state_an_exposure_are_all_frames(tmp_path):
    """A bracket in the extensions of one file: each has the exposure of its header."""
    from astropy.io import fits

    units = [fits.PrimaryHDU()]
    for n, seconds in enumerate((0.1, 0.2, 0.4)):
        unit = fits.ImageHDU(PICTURE + np.uint16(n))
        unit.header["EXPTIME"] = seconds
        units.append(unit)
    fits.HDUList(units).writeto(tmp_path / "m.fits")
    found = import_sources([tmp_path / "m.fits"])[0].header.frames
    assert [entry.exposure_s for entry in found] == [0.1, 0.2, 0.4]

"""Public reports of misread files, one line each: the report, the input, the right value.

Values are those the input was made with. A refusal is right where the file leaves the value open.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile

import radiometer as rm
from radiometer.cli.main import run
from radiometer.data import CaptureSet, ResponseCurve
from radiometer.screen.calibration import LUMINANCE, ScreenCalibration
from tests.unit.reports import inputs


def imported(source: Path, out: Path, *words: str) -> CaptureSet:
    """Return what `radiometer import` writes of a source."""
    assert run(["import", str(source), "-o", str(out), *words]) == 0
    return CaptureSet.read(out)


@pytest.mark.parametrize(
    ("cards", "other", "differing"),
    [
        ({"GAIN": 0, "OFFSET": 10}, {"GAIN": 60, "OFFSET": 10}, "GAIN_60"),  # deepskystacker/DSS/issues/56
        ({"GAIN": 0, "OFFSET": 10}, {"GAIN": 0, "OFFSET": 50}, "OFFSET_50"),
        ({"READOUTM": "High Gain"}, {"READOUTM": "Low Noise"}, "Low_Noise"),  # indilib/indi-3rdparty/issues/1380
    ],
)
def test_settings_of_unknown_unit_are_never_pooled(cards, other, differing, tmp_path, capsys):
    """Frames of two gains or offsets are two sets; what needs one set refuses them by name."""
    folder = inputs.fits_frames(tmp_path / "in", lambda s: {"EXPTIME": s, **cards})
    inputs.fits_frames(folder, lambda s: {"EXPTIME": s, **other}, scale=2.0, black=500)
    assert run(["characterise", str(folder)]) == 1
    assert differing in capsys.readouterr().err
    assert run(["import", str(folder), "-o", str(tmp_path / "out")]) == 0
    levels = sorted(float(np.median(CaptureSet.read(one).read_frame(0).dn)) for one in (tmp_path / "out").iterdir())
    assert len(levels) == 2


def test_the_iso_speed_65535_means_more(tmp_path):
    """ln H of gamma 2.2 to 0.02 (darktable-org/rawspeed/issues/276); read as the speed, 65535 puts it off by 0.6."""
    folder = inputs.photographs(tmp_path / "p")
    assert run(["response", str(folder), "-o", str(tmp_path / "curve.csv")]) == 0
    curve = ResponseCurve.read(tmp_path / "curve.csv")
    dn = np.array([10, 30, 60, 200, 240])
    expected = 2.2 * np.log(dn / 128.0)
    found = curve.log_exposure[dn] - curve.log_exposure[128]
    assert found == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("photometric", [32803, 34892])
def test_raw_photographs_with_exif_in_the_first_directory(photometric, tmp_path):
    """1/100 and 1/25 s (RawTherapee/RawTherapee/issues/5391); one colour per pixel, or one sample without filters."""
    folder = inputs.raw_photographs(tmp_path / "p", photometric)
    assert run(["merge", str(folder), "-o", str(tmp_path / "o.tiff")]) == 0


def test_a_stack_among_photographs_is_not_read_by_its_first_page(tmp_path, capsys):
    """Its pages may have other exposures (haraldk/TwelveMonkeys/issues/412): the command that reads all is named."""
    for n in range(2):
        inputs.stack(tmp_path / "p", f"{n}.tif")
    assert run(["merge", str(tmp_path / "p"), "-o", str(tmp_path / "o.tiff")]) == 1
    assert "radiometer import" in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_tables_are_read_in_the_encodings_of_meters_and_spreadsheets(encoding, tmp_path):
    """The ² of cd/m² is one byte in Windows-1252, two in the others."""
    file = inputs.screen(tmp_path / "s.csv", "level;Lv (cd/m²)", lambda i, n, v: f"{n};{v:.3f}", comma=True)
    file.write_text(file.read_text(encoding="utf-8"), encoding=encoding)
    assert run(["screen", "import", str(file), "-o", str(tmp_path / "s.yaml")]) == 0
    curve = ScreenCalibration.read(tmp_path / "s.yaml").channel("grey")
    assert curve.at(255, LUMINANCE).value == pytest.approx(230.2, rel=1e-3)


def test_dark_frames_of_a_set_count_when_it_is_calibrated(tmp_path, capsys):
    """The frames that were calibrated at 1 W·sr⁻¹·m⁻² read 1.00 (DaveStrickland/AstroPhotography/issues/5)."""
    folder = inputs.fits_frames(tmp_path / "f", lambda s: {"EXPTIME": s}, level=44_000.0, dark=4_000.0)
    words = ["--patch", "10,10,20,20", "--f-number", "4"]
    calibration = str(tmp_path / "cal.yaml")
    scale = ["--radiance", "1", "--u-rel", "0.01", "--black-level", "100", "-o", calibration]
    assert run(["calibrate", str(folder), *words, *scale]) == 0
    capsys.readouterr()
    assert run(["measure", "--photographs", str(folder), "--calibration", calibration, *words]) == 0
    assert float(re.search(r"radiance +([\d.]+)", capsys.readouterr().out)[1]) == pytest.approx(1.0, abs=0.01)


BRACKETS = {
    "full scale": lambda p: inputs.ramp_bracket(p, 65_535),
    "panoptes/POCS/issues/899 14 bits": lambda p: inputs.ramp_bracket(
        p, 65_532, 4, INSTRUME="ZWO ASI294MM Pro", GAIN=0
    ),
    "EtalumaSupport/LumaViewPro/issues/730": lambda p: inputs.ramp_bracket(
        p, 65_520, 16, INSTRUME="ZWO ASI178MM", GAIN=0
    ),
    "legacysurvey/legacypipe/issues/627": lambda p: inputs.ramp_bracket(p, 50_000, SATURATE=50_000),
}


@pytest.mark.parametrize("make", BRACKETS.values(), ids=BRACKETS)
def test_frames_that_saturate_below_their_container_are_merged_right(make, tmp_path):
    """800 000 DN/s at the right end, within 1 % from the darkest column to the brightest."""
    imported(make(tmp_path / "in"), tmp_path / "set")
    assert run(["merge", str(tmp_path / "set"), "-o", str(tmp_path / "o.tiff")]) == 0
    found = tifffile.imread(tmp_path / "o.tiff", key=0).mean(axis=0)
    assert found[2:] == pytest.approx((8e5 * np.linspace(0.02, 1, 96))[2:], rel=0.01)


@pytest.mark.parametrize(("spread_dn", "strays"), [(0.0, 0), (0.0, 40), (1.0, 0)])
def test_a_raw_file_that_saturates_below_its_white_level(spread_dn, strays, tmp_path):
    """240 000 DN/s within 1 %, whatever is above the sensor's end (jcelaya/hdrmerge/issues/126)."""
    folder = inputs.raw_ramp(tmp_path / "p", spread_dn, strays)
    assert run(["merge", str(folder), "--channel", "green", "-o", str(tmp_path / "o.tiff")]) == 0
    found = tifffile.imread(tmp_path / "o.tiff", key=0).mean(axis=0)
    expected = (240_000 * np.linspace(0.02, 1, 192))[1::2][: found.size]
    assert found[4:] == pytest.approx(expected[4:], rel=0.01)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_log_whose_value_hardly_moves_names_no_effect(seed, tmp_path, capsys):
    """A value of 30 000 DN ± 0.5 % shows neither a black level nor a bend: none is found, and none is ± inf."""
    assert run(["log-fit", str(inputs.steady_log(tmp_path / "nights.csv", seed)), "--no-control"]) == 0
    shown = capsys.readouterr().out
    assert "The missing effect was found" not in shown
    assert "inf" not in shown
    assert "record some readings at a half and a quarter of the exposure" in shown.replace("\n", " ")


DARKS = {
    "of each exposure": (inputs.SECONDS, -10.0, True),
    "astropy/ccdproc/issues/360 two others": ((0.05, 3.0), -10.0, True),
    "LCOGT/banzai/pull/321 30 K warmer": (inputs.SECONDS, 20.0, True),
    "astropy/ccdproc/issues/75 one much longer": ((5.0,), -10.0, False),
}


@pytest.mark.parametrize(("seconds", "celsius", "works"), DARKS.values(), ids=DARKS)
def test_dark_frames_are_used_for_the_exposure_and_temperature_they_have(seconds, celsius, works, tmp_path, capsys):
    """10 000 DN/s at the right end, 3 % being four sigma of the dimmest column; one that shows neither is refused."""
    imported(inputs.light_and_dark(tmp_path / "in", seconds, celsius), tmp_path / "set")
    assert run(["merge", str(tmp_path / "set"), "-o", str(tmp_path / "o.tiff")]) == (0 if works else 1)
    if not works:
        assert "darker than the dark frames show" in capsys.readouterr().err
        return
    found = tifffile.imread(tmp_path / "o.tiff", key=0).mean(axis=0)
    assert found == pytest.approx(1e4 * np.linspace(0.1, 1.0, 64), rel=0.03)


@pytest.mark.parametrize("dark_rate", [0.0, 300.0, 8000.0])
def test_bias_frames_say_nothing_of_a_dark_current_that_no_file_states(dark_rate, tmp_path, capsys):
    """1000 DN/s of light: what u says covers it, however much of the picture is dark current."""
    rng = np.random.default_rng(9)
    lights = [("Light", t, (1000.0 + dark_rate) * t) for t in (0.5, 1.0, 2.0)]
    shots = (
        (kind, seconds, 500 + rng.normal(signal, np.sqrt(0.5 * signal + 9), (48, 64)))
        for kind, seconds, signal in (*lights, *[("Bias", 0.0, 0.0)] * 3)
    )
    imported(inputs.fits_series(tmp_path / "in", shots), tmp_path / "set")
    found = rm.merge(tmp_path / "set").map
    value, u = float(np.median(found.radiance)), float(np.median(found.u_radiance))
    assert abs(value - 1000.0) <= 2.0 * u + 10.0
    assert "no dark current" in " ".join(found.provenance.assumptions)
    assert (
        run(["measure", "--photographs", str(tmp_path / "set"), "--patch", "10,10,20,20", "--uncalibrated", "--json"])
        == 0
    )
    reading = json.loads(capsys.readouterr().out)
    assert "dark_assumed" in reading["flags"]


@pytest.mark.parametrize("top", [50_000, 30_001])
def test_a_sensor_is_characterised_up_to_where_its_pixels_pile_up(top, tmp_path):
    """K is 0.5 DN/e-, and pixels at the pile count as clipped, although 16 bits go further."""
    rng = np.random.default_rng(4)
    kinds = [("Light", 2e5)] * 2 + [("Dark", 0.0)] * 2
    shots = (
        (kind, s, np.minimum(500 + 0.5 * rng.poisson(rate * s, (64, 64)) + rng.normal(0, 3, (64, 64)), top))
        for s in np.linspace(0.05, 0.7, 14)
        for kind, rate in kinds
    )
    found = rm.characterise(inputs.fits_series(tmp_path / "in", shots))
    assert abs(found["K"].value - 0.5) <= 2.0 * found["K"].u
    assert found.characterisation.limited_by == "full well"
    assert max(step.bright.clipped_share for step in found.characterisation.steps) > 0.5
    assert any(f"white level {top} DN" in note for note in found.characterisation.notes)


def test_readings_of_a_level_that_differ_are_known_no_better_than_they_agree(tmp_path):
    """Each level read twice, 10 % apart: half the difference is the standard uncertainty of their mean."""
    file = inputs.screen(tmp_path / "s.csv", "level,Lv", lambda i, n, v: f"{n},{v:.4f}\n{n},{1.1 * v:.4f}")
    assert run(["screen", "import", str(file), "-o", str(tmp_path / "s.yaml")]) == 0
    curve = ScreenCalibration.read(tmp_path / "s.yaml").channel("grey")
    assert curve.u_independent[-1] / curve.radiance[-1] == pytest.approx(0.05 / 1.05, rel=0.05)

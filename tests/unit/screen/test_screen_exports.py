"""Exports have the forms that the other programs read."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from PIL import ImageCms

import radiometer as rm
from radiometer.errors import CalibrationError, UsageError
from radiometer.screen.calibration import LUMINANCE
from radiometer.screen.exports import EXPORTS, argyll_line, correction, to_csv, to_inverse_csv, write_export

# ITU-R BT.709 and D65, the chromaticities of sRGB.
SRGB = {"grey": (0.3127, 0.3290), "red": (0.64, 0.33), "green": (0.30, 0.60), "blue": (0.15, 0.06)}


@pytest.mark.slow
@pytest.mark.parametrize("kind", EXPORTS)
def test_every_export_is_written(kind, screen, tmp_path):
    """Each kind makes a file with content."""
    if kind == "icc":
        pytest.importorskip("imagecodecs")
    write_export(replace(screen, chromaticities=SRGB), kind, tmp_path / "x")
    assert (tmp_path / "x").stat().st_size > 100
    screen.write(tmp_path / "desk.yaml")
    with pytest.raises(UsageError, match="psychopy, ti3, csv"):
        rm.screen_export(tmp_path / "desk.yaml", ["xlsx"])


def test_psychopy_grid_reproduces_the_luminance_by_psychopys_own_formula(screen):
    """a + (b + k·x)^γ of the grid's grey row is the measured luminance within 1 % of it or 0.05 % of white."""
    text = EXPORTS["psychopy"][0](screen)
    entry = next(iter(json.loads(text).values()))
    grid = np.array(entry["gammaGrid"]["__ndarray__"])
    assert grid.shape == tuple(entry["gammaGrid"]["shape"]) == (4, 6)
    assert entry["linearizeMethod"] == 4
    low, high, gamma, a, b, k = grid[0]
    curve = screen.channel()
    truth = np.array([curve.at(n, LUMINANCE).value for n in curve.levels])
    shown = a + np.maximum(b + k * np.array(curve.levels) / 255, 0) ** gamma
    assert np.all(np.abs(shown - truth) < np.maximum(0.01 * truth, 5e-4 * high))
    assert low == pytest.approx(truth[0])


def _ti3(text: str) -> tuple[dict[str, str], list[list[float]]]:
    """Return keywords and rows as a reader of CGATS finds them."""
    lines = text.splitlines()
    start, end = lines.index("BEGIN_DATA"), lines.index("END_DATA")
    words = dict(
        line.split(maxsplit=1) for line in lines[1:start] if " " in line and not line.startswith(("#", "SAMPLE"))
    )
    return words, [[float(v) for v in line.split()] for line in lines[start + 1 : end]]


def test_ti3_is_read_like_a_file_of_dispreads(screen, shared_data):
    """Keywords and fields of a real file are there, with rows counted, white at Y = 100 and drive in percent."""
    real = next((shared_data / "displays").glob("*.ti3")).read_text(encoding="latin-1")
    ours, rows = _ti3(EXPORTS["ti3"][0](screen))
    theirs = real[: real.index("BEGIN_DATA\n")]
    for key in ("DEVICE_CLASS", "COLOR_REP", "NORMALIZED_TO_Y_100", "NUMBER_OF_FIELDS"):
        assert f"{key} {ours[key]}" in theirs
    assert int(ours["NUMBER_OF_SETS"]) == len(rows) == 17
    assert rows[-1][1:4] == [100.0, 100.0, 100.0]
    assert rows[-1][5] == pytest.approx(100)
    white = float(ours["LUMINANCE_XYZ_CDM2"].strip('"').split()[1])
    assert white == pytest.approx(screen.channel().at(255, LUMINANCE).value)


def test_csv_has_one_row_per_level_with_uncertainty(screen, tmp_path):
    """Luminance and its u stand in every row, and `screen import` reads them."""
    header, *rows = to_csv(screen).splitlines()
    last = dict(zip(header.split(","), rows[-1].split(","), strict=True))
    assert len(rows) == 17
    assert float(last["luminance_cd_m2"]) == pytest.approx(224.032)
    assert float(last["u_luminance_cd_m2"]) == pytest.approx(224.032 * 0.01005, rel=1e-2)
    (tmp_path / "own.csv").write_text(to_csv(screen), encoding="utf-8")
    again = rm.screen_import(tmp_path / "own.csv").calibration
    assert again.channel().at(255, LUMINANCE).value == pytest.approx(224.032)


@pytest.mark.slow
def test_inverse_table_rises_and_meets_its_targets(screen):
    """Levels never fall, and what they show is nearer to the target than half a step."""
    rows = [line.split(",") for line in to_inverse_csv(screen).splitlines()[1:]]
    levels = [int(r[2]) for r in rows]
    curve = screen.channel()
    assert levels == sorted(levels)
    assert (levels[0], levels[-1]) == (0, 255)
    for row in rows[1:-1]:
        n, target = int(row[2]), float(row[1])
        step = curve.at(min(n + 1, 255), LUMINANCE).value - curve.at(max(n - 1, 0), LUMINANCE).value
        assert abs(float(row[3]) - target) <= step / 2 * 1.05 + 1e-4


@pytest.mark.slow
def test_vcgt_has_apples_layout_and_straightens_the_screen(screen):
    """18 bytes of head, 3 × 256 rising 16-bit numbers; driven through them the screen follows gamma 2.2."""
    content = EXPORTS["vcgt"][0](screen)
    assert isinstance(content, bytes)
    assert struct.unpack(">4sIIHHH", content[:18]) == (b"vcgt", 0, 0, 3, 256, 2)
    table = np.frombuffer(content[18:], ">u2").reshape(3, 256)
    assert np.all(np.diff(table.astype(int), axis=1) >= 0)
    curve = screen.channel()
    shown = curve.table.at(table[0] / 65535)
    expected = shown[0] + (shown[-1] - shown[0]) * np.linspace(0, 1, 256) ** 2.2
    assert np.abs(shown - expected).max() < 1e-4 * expected[-1]
    assert correction(screen.channel(), 1.8)[128] > correction(screen.channel(), 2.2)[128]  # more drive in the middle


def test_argyll_line_is_spotreads_with_known_chromaticities_or_those_of_srgb(screen):
    """spotread's words, Y twice; X of D65 is 0.9505 Y, of illuminant A (0.44757, 0.40745) 1.0985 Y (CIE 15)."""
    line = argyll_line(screen, "grey", 100.0)
    assert line == " Result is XYZ: 95.045593 100.000000 108.905775, Yxy: 100.000000 0.312700 0.329000"
    known = replace(screen, chromaticities={"grey": (0.44757, 0.40745)})
    assert argyll_line(known, "grey", 100.0).startswith(" Result is XYZ: 109.84")
    assert ["sRGB" in str(EXPORTS["ti3"][0](one)) for one in (screen, known)] == [True, False]


def _icc_tags(content: bytes) -> dict[str, bytes]:
    """Return the tags of an ICC profile by signature (ICC.1:2022, 7.3)."""
    count = int.from_bytes(content[128:132], "big")
    rows = [struct.unpack(">4sII", content[132 + 12 * n : 144 + 12 * n]) for n in range(count)]
    return {signature.decode(): content[start : start + size] for signature, start, size in rows}


def test_icc_profile_states_white_primaries_and_tone_curves(screen, tmp_path):
    """A screen of sRGB's chromaticities has the colorants of the ICC's sRGB profile; its curve is the screen's 2.2."""
    pytest.importorskip("imagecodecs")
    notes: list[str] = []
    replace(screen, chromaticities=SRGB).write(tmp_path / "desk.yaml")
    (file,) = rm.screen_export(tmp_path / "desk.yaml", ["icc"], notice=notes.append)
    profile = ImageCms.getOpenProfile(str(file)).profile
    for colorant, expected in (
        (profile.red_colorant, (0.4361, 0.2225, 0.0139)),
        (profile.green_colorant, (0.3851, 0.7169, 0.0971)),
        (profile.blue_colorant, (0.1431, 0.0606, 0.7141)),
    ):
        assert colorant[0] == pytest.approx(expected, abs=3e-4)
    white = np.linalg.solve(profile.chromatic_adaptation[0], (0.9642, 1.0, 0.8249))  # D50 back to the screen's white
    assert white[:2] / white.sum() == pytest.approx(SRGB["grey"], abs=2e-4)
    for name in ("rTRC", "gTRC", "bTRC"):
        curve = _icc_tags(file.read_bytes())[name]
        assert struct.unpack(">4s4xI", curve[:12]) == (b"curv", 256)
        shares = np.frombuffer(curve[12 : 12 + 512], ">u2") / 65535
        assert shares[list(screen.channel().levels)] == pytest.approx(
            (np.array(screen.channel().levels) / 255) ** 2.2, abs=1e-5
        )
    assert any("(k = 2)" in line for line in notes)
    assert any("red, green, blue was not measured" in line for line in notes)


def test_icc_profile_names_the_primary_that_contradicts_its_chromaticity(screen, tmp_path):
    """By sRGB red has 21 % of white's luminance; a red as bright as 30 % of white is named, the others are not."""
    pytest.importorskip("imagecodecs")
    grey, notes = screen.channel(), list[str]()
    parts = {"red": 0.30, "green": 0.7152, "blue": 0.0722}
    primaries = {
        name: replace(grey, name=name, radiance=tuple(part * value for value in grey.radiance))
        for name, part in parts.items()
    }
    replace(screen, channels={"grey": grey, **primaries}, chromaticities=SRGB).write(tmp_path / "desk.yaml")
    rm.screen_export(tmp_path / "desk.yaml", ["icc"], notice=notes.append)
    doubted = [line for line in notes if "Check chromaticities" in line]
    assert len(doubted) == 1
    assert "red 21.3 %" in doubted[0]


@pytest.mark.parametrize(
    ("chromaticities", "why"),
    [
        ({name: SRGB[name] for name in ("grey", "red")}, "green, blue has none"),
        (SRGB | {"grey": (0.6, 0.3)}, "together has the chromaticity of grey"),
        (SRGB | {"blue": SRGB["red"]}, "together has the chromaticity of grey"),
    ],
)
def test_icc_profile_of_unknown_colours_is_refused(chromaticities, why, screen, tmp_path):
    """Nothing is assumed: a chromaticity that is unknown, or that makes no white, writes no file, and measures none."""
    replace(screen, name="lcd", chromaticities=chromaticities).write(tmp_path / "desk.yaml")
    with pytest.raises(CalibrationError, match=why):
        rm.screen_export(tmp_path / "desk.yaml", ["icc"])
    with pytest.raises(CalibrationError, match=why):
        rm.screen_calibrate(tmp_path / "desk.yaml", "lcd", levels="3", export=["icc"], force=True)
    assert not (tmp_path / "desk.icc").exists()


def test_a_calibration_that_is_replaced_leaves_its_chromaticities(screen, tmp_path):
    """A colorimeter measures a screen once; those of a screen of another name are not taken."""
    file, heard = tmp_path / "desk.yaml", list[str]()
    known = {"grey": (0.31, 0.33)}
    replace(screen, name="desk", chromaticities=known).write(file)
    again = rm.screen_calibrate(file, "lcd", name="desk", levels="3", force=True, notice=heard.append)
    assert again.calibration.chromaticities == known
    assert "chromaticities of grey are kept" in heard[0]
    assert rm.screen_calibrate(file, "lcd", name="other", levels="3", force=True).calibration.chromaticities == {}


@pytest.mark.usefixtures("unrendered")
def test_page_states_what_the_screen_was_measured_with(screen):
    """Date, camera and calibration stand in the head; what is not stated is named."""
    text = str(EXPORTS["page"][0](replace(screen, measured_with={"camera": "FLIR 22500001"})))
    for wanted in ("2026-11-21 12:00:00", "FLIR 22500001", "calibration</dt><dd>not stated"):
        assert wanted in text


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("odd", [{}, {"warm_up": "yes", "uniformity": {"lowest": None}, "drift_rel": "much"}])
def test_page_states_the_checks_that_the_terminal_prints(screen, odd, tmp_path):
    """A screen that still drifts, its uniformity and its flicker; a file that states a check otherwise has none."""
    checks = {
        "warm_up": {"waited_s": 1800.0, "drift_rel": 0.01, "steady": False},
        "flicker": {"found": True, "scatter_rel": 0.05, "exposure_s": 1e-3},
        "uniformity": {"grid": [], "lowest": 0.87, "highest": 1.02, "u_rel": 0.001},
        "repeats": 12, "drift_rel": 0.012, "drift_u_rel": 0.002, "additivity_rel": -0.004,
    }  # fmt: skip
    replace(screen, checks={**checks, **odd}).write(tmp_path / "desk.yaml")
    rm.screen_export(tmp_path / "desk.yaml", ["page"])
    text = (tmp_path / "desk.html").read_text(encoding="utf-8").replace("\u00a0", " ")
    stated = (
        "still drifting after 1800 s",
        "87.00 to 102.00 % of the middle, each ± 0.20 % (k = 2)",
        "1.2 % while measuring",
    )
    assert [one in text for one in stated] == [not odd] * 3
    assert "12 readings are averaged" in text

"""`radiometer characterise`, `flux`, `quality`, `screen` and `adapt`: files, JSON, exit codes."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

import radiometer as rm
from radiometer.cli.main import run
from radiometer.data import CameraDescription, FrameSettings, LensDescription
from radiometer.data.storage import write_yaml_atomic
from radiometer.devices import CameraPreset
from radiometer.screen import ScreenCalibration
from radiometer.screen.calibration import LUMINANCE
from simulators.chain.camera_model import CameraModel
from simulators.scenes import LedScene, UniformScene
from testing import quality_stations as stations
from testing.simulated_capture import simulate_capture


def described(**facts: float) -> CameraDescription:
    """Return a camera of 12 bits with a black level of 64 DN."""
    return CameraDescription(bit_depth=12, black_level_dn=64, **facts)  # type: ignore[arg-type]


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Return pairs of twelve exposures of an even field, and of as many dark frames."""
    camera = described(
        pixel_pitch_um=4.5, conversion_gain_e_per_dn=2.6, read_noise_e=3.0, full_well_e=10_500, quantum_efficiency=0.62
    )
    times = [float(t) for t in np.linspace(0.002, 0.05, 12)]
    plan = [FrameSettings(t, shutter=s) for s in ("open", "closed") for t in times]  # type: ignore[arg-type]
    model = CameraModel.ideal(camera, LensDescription(f_number=4.0))
    scene = UniformScene(radiance_W_per_sr_m2=0.14)
    simulate_capture(model, plan, scene, tmp_path / "set", frames_per_setting=2, width=64, height=48)
    return tmp_path / "set"


@pytest.mark.usefixtures("unrendered")
def test_json_and_camera_file_hold_the_same_figures(capture, tmp_path, capsys):
    """Standard output is one JSON object; the YAML file is a camera preset with the same conversion gain.

    The table shows symbols with k = 2 uncertainties; the datasheet is an HTML page.
    """
    assert run(["characterise", str(capture), "-o", str(tmp_path / "camera.yaml"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["format"] == "radiometer-camera/1"
    assert printed["emva1288"]["figures"]["K"]["unit"] == "DN/e-"
    preset = CameraPreset.read(tmp_path / "camera.yaml")
    assert preset.camera.conversion_gain_e_per_dn == printed["camera"]["conversion_gain_e_per_dn"]
    assert run(["characterise", str(capture), "--report", str(tmp_path / "sheet.html")]) == 0
    out = capsys.readouterr().out
    assert "overall" in out
    assert "U (k = 2)" in out
    assert (tmp_path / "sheet.html").read_text().startswith("<!doctype html>")


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "corner", "eta"), [("BFS-U3-19S4M", 0, 0.62), ("BFS-U3-19S4C", 1, 0.554)])
def test_camera_is_driven_and_its_limits_stand_in_the_file(preset, corner, eta, tmp_path):
    """The frames come from the bench's camera, those of a mosaic in whole cells; the file can be simulated again."""
    bench = {
        "camera": {"kind": "simulated", "preset": preset, "width": 64, "height": 48},
        "lens": {"focal_length_mm": 16, "f_number": 4},
        "scene": {"kind": "uniform", "radiance_W_per_sr_m2": 0.3},
        "source": {"kind": "sphere", "wavelength_nm": 550},
        "patch": {"x": corner, "y": corner, "width": 64 - corner, "height": 48 - corner},
    }
    write_yaml_atomic(tmp_path / "bench.yaml", bench)
    words = ["--bench", str(tmp_path / "bench.yaml"), "--radiance", "0.3", "--steps", "12"]
    assert run(["characterise", "--camera", "sim", *words, "-o", str(tmp_path / "camera.yaml"), "--json"]) == 0
    found = CameraPreset.read(tmp_path / "camera.yaml")
    assert found.require_limits("test").width == 64
    # 18 frames' pairs of 3072 pixels give K, and so the efficiency, to about 1 %; the filter passes 0.894.
    assert found.camera.quantum_efficiency == pytest.approx(eta, rel=0.05)
    CameraModel.ideal(found.camera, LensDescription(f_number=4.0))


@pytest.fixture
def flux_capture(tmp_path: Path) -> Path:
    """Return a bracket of a 5 mW diode of half angle 60° and 3 mm at 80 mm from a 20 mm lens."""
    electrons = {"conversion_gain_e_per_dn": 20.0, "read_noise_e": 10.0, "full_well_e": 90_000}
    camera = described(pixel_pitch_um=18.0, quantum_efficiency=0.6, **electrons)
    lens = LensDescription(focal_length_mm=20, f_number=4.0, transmittance=0.9, magnification=1 / 3)
    pupil_deg = math.degrees(math.atan(2.5 / 80))
    scene = LedScene(
        flux_mW=5.0, emitter_diameter_mm=3.0, half_angle_deg=60.0, pupil_half_angle_deg=pupil_deg, diameter_px=1 / 18e-3
    )
    plan = [FrameSettings(t) for t in (2e-5, 1e-4, 5e-4, 2e-3)]
    simulate_capture(CameraModel.ideal(camera, lens, 590.0), plan, scene, tmp_path / "set", width=96, height=96)
    return tmp_path / "set"


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--half-angle", "60", "--distance", "80", "--datasheet-mw", "5"], 0, ""),
        (["--distance", "80"], 2, "needs --half-angle"),
        (["--half-angle", "60", "--datasheet-mw", "0"], 2, "datasheet_mw is 0.0 (float); give finite number above 0"),
    ],
)
def test_table_shows_how_the_gap_closes(flux_capture, words, code, message, capsys):
    """Each step has its flux and the share that it closes; what is missing or impossible is one line."""
    assert run(["flux", str(flux_capture), *words]) == code
    out, error = capsys.readouterr()
    assert message in error
    assert code == 0 or error.count("\n") == 1
    assert all(text in out for text in ("light that missed the lens", "open: ")) == (code == 0)


def test_characterised_camera_gives_the_scale_and_its_uncertainty(flux_capture, tmp_path, capsys):
    """With a camera file the 3 % of an uncharacterised camera no longer count; with a calibration it is misuse."""
    file = {
        "format": "radiometer-camera/1",
        "camera": {"bit_depth": 12, "quantum_efficiency": 0.6, "conversion_gain_e_per_dn": 20.0},
        "emva1288": {"figures": {"R": {"value": 0.03, "u": 0.0003, "unit": "DN/photon"}}},
    }
    write_yaml_atomic(tmp_path / "camera.yaml", file)
    words = ["flux", str(flux_capture), "--json", "--camera-file", str(tmp_path / "camera.yaml")]
    assert run(words) == 0
    flux = json.loads(capsys.readouterr().out)["on_sensor"]
    assert flux["u"] / flux["value"] == pytest.approx(0.01, rel=0.05)
    assert run([*words, "--calibration", "x.yaml"]) == 2


# `radiometer quality` on the simulated bench: captures by step, the table, JSON and the datasheet.


BENCH = {
    "format": "radiometer-bench/1",
    "camera": {"kind": "simulated", "preset": "BFS-U3-19S4M", "width": 160, "height": 120},
    "lens": {"focal_length_mm": 16, "f_number": 4},
    "scene": {"kind": "uniform", "radiance_W_per_sr_m2": 0.2},
    "patch": {"x": 60, "y": 40, "width": 40, "height": 40},
}


@pytest.fixture
def bench(tmp_path):
    file = tmp_path / "bench.yaml"
    file.write_text(yaml.safe_dump(BENCH))
    return file


def test_steps_are_captured_one_by_one_and_reported(bench, tmp_path, capsys):
    """Two steps of one bench: a focus that changes nothing, in the table and in JSON, with its interval."""
    session = tmp_path / "session"
    for step in ("far", "near"):
        assert run(["quality", "take", str(session), "focus", step, "--bench", str(bench)]) == 0
    capsys.readouterr()
    assert run(["quality", "report", str(session), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    focus = next(one for one in printed["indices"] if one["index"] == "focus")
    assert focus["measured"]
    assert focus["value"] <= focus["expanded"]
    assert focus["expanded"] == pytest.approx(focus["coverage_factor"] * focus["u"])
    assert [one["index"] for one in printed["indices"] if one["measured"]] == ["focus"]


@pytest.mark.slow
def test_a_ladder_reaches_down_to_a_fortieth(bench, tmp_path, capsys):
    """Linearity captures exposures over a range of 40, several frames each, with darks of the same times."""
    assert run(["quality", "take", str(tmp_path / "s"), "linearity", "ladder", "--bench", str(bench)]) == 0
    header = yaml.safe_load((tmp_path / "s" / "linearity" / "ladder" / "capture.yaml").read_text())
    times = [one["exposure_s"] for one in header["frames"] if one["shutter"] == "open"]
    dark = {one["exposure_s"] for one in header["frames"] if one["shutter"] == "closed"}
    assert max(times) / min(times) == pytest.approx(40.0, rel=0.02)
    assert {times.count(t) for t in times} == {4}
    assert dark == set(times)


def test_a_step_named_by_a_gain_is_taken_at_it(bench, tmp_path, capsys):
    """12dB is captured at 12 dB; a capture at another gain than its name says is no index, and the way out is named."""
    session = tmp_path / "s"
    for step in ("0dB", "12dB"):
        assert run(["quality", "take", str(session), "range", step, "--bench", str(bench)]) == 0
    header = yaml.safe_load((session / "range" / "12dB" / "capture.yaml").read_text())
    assert {frame["gain_db"] for frame in header["frames"]} == {12.0}
    (session / "range" / "0dB").rename(session / "range" / "6dB")
    capsys.readouterr()
    assert run(["quality", "report", str(session), "--json"]) == 0
    (change,) = (one for one in json.loads(capsys.readouterr().out)["indices"] if one["index"] == "range")
    assert not change["measured"]
    assert "step '6dB' was captured at 0 dB; remove" in change["reason"]


def test_several_steps_need_a_hand_and_none_is_taken_twice(bench, tmp_path, capsys):
    """Without a terminal nothing is captured of two steps that differ by what stands before the camera.

    A capture that is there is left alone, and stated.
    """
    words = ["quality", "take", str(tmp_path / "s"), "focus"]
    assert run([*words, "--bench", str(bench)]) == 1
    assert "name one step at a time" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()
    words += ["far", "--bench", str(bench)]
    assert run(words) == 0
    written = (tmp_path / "s" / "focus" / "far" / "capture.yaml").stat().st_mtime_ns
    assert run(words) == 0
    assert "all steps are there" in capsys.readouterr().err
    assert (tmp_path / "s" / "focus" / "far" / "capture.yaml").stat().st_mtime_ns == written


def test_datasheet_opens_with_the_outcome_and_hides_no_gap(tmp_path, capsys):
    """One HTML file: the largest index in the first sentence, the not measured last, hostile names escaped."""
    stations.refocused(tmp_path / "s", 4)
    for step in ("far", "near"):
        header = tmp_path / "s" / "focus" / step / "capture.yaml"
        text = yaml.safe_load(header.read_text())
        text["camera"]["model"] = "<script>alert(1)</script>"
        header.write_text(yaml.safe_dump(text))
    sheet = tmp_path / "sheet.html"
    assert run(["quality", "report", str(tmp_path / "s"), "-o", str(sheet)]) == 0
    page = sheet.read_text(encoding="utf-8")
    assert "1 of 12 indices measured; the largest is focus distance (f12): 3.8" in page
    assert "<script>" not in page
    assert "http" not in page.replace("http-equiv", "")
    assert page.index("focus distance") < page.index("Not measured") < page.index("What was assumed")


# `radiometer screen`: files, JSON, exit codes.


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file that `screen calibrate --quick` makes of the simulated OLED."""
    file = tmp_path_factory.mktemp("screen") / "oled.yaml"
    assert run(["screen", "calibrate", "--display", "oled", "--quick", "-o", str(file), "--export", "csv,ti3"]) == 0
    return file


@pytest.mark.slow
def test_calibrate_writes_calibration_and_exports_that_are_read_back(calibration, tmp_path):
    """Seven levels; to six digits; the OLED agrees with itself, the LCD not."""
    assert ScreenCalibration.read(calibration).channel().levels == (0, 32, 64, 96, 128, 192, 255)
    assert calibration.with_suffix(".csv").exists()
    assert calibration.with_suffix(".ti3").exists()
    back = rm.screen_import(calibration.with_suffix(".csv"), tmp_path / "back.yaml")
    known = ScreenCalibration.read(calibration).channel()
    for level in known.levels[1:]:
        assert back.calibration.channel().at(level, LUMINANCE).value == pytest.approx(
            known.at(level, LUMINANCE).value, rel=1e-5
        )
    assert run(["screen", "verify", str(calibration), "--display", "oled", "--levels", "0,128,255"]) == 0
    assert run(["screen", "verify", str(calibration), "--display", "lcd", "--levels", "0,128,255"]) == 1


@pytest.mark.slow
def test_json_and_argyll_speak_for_programs(tmp_path, capsys):
    """--json is one object; --argyll prints a line of spotread's for every level."""
    options = ["--display", "oled", "--levels", "0,128,255", "-o", str(tmp_path / "o.yaml")]
    assert run(["screen", "calibrate", *options, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["format"] == "radiometer-screen/1"
    assert run(["screen", "calibrate", *options, "--argyll", "--force"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith(" Result is XYZ:")]
    assert len(lines) == 3


# `radiometer adapt bleach`, `protocols`, `retest` and what `fit` reports of the subject.


def test_bleach_calculator_gives_trolands_and_fractions(capsys: pytest.CaptureFixture[str]) -> None:
    """300 cd/m² for 120 s through 4 mm: 3770 td; rods by Rushton's kinetics at twice the trolands."""
    assert run(["adapt", "bleach", "300", "120", "--pupil", "4", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["retinal_td"] == pytest.approx(3769.9, rel=1e-4)
    assert found["rods_bleached"] == pytest.approx(0.0749, abs=0.0005)
    assert 0 < found["cones_bleached"] < 0.2


def _table(path: Path, break_min: float, seed: int, head: str = "") -> str:
    """Write thresholds of two branches with a break."""
    times = np.arange(0.3, 20, 0.4)
    cones = -1.5 + 2.5 * np.exp(-times / 1.5)
    levels = np.where(times > break_min, -1.5 - 0.25 * (times - break_min), cones)
    levels = levels + np.random.default_rng(seed).normal(0, 0.05, times.size)
    rows = "".join(f"{t:.3f},{v:.4f}\n" for t, v in zip(times, levels, strict=True))
    path.write_text(f"{head}time_min,log10_threshold\n{rows}")
    return str(path)


@pytest.mark.slow
def test_retest_gives_limits_of_agreement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three subjects whose break is 1, 1.5 and 2 min later: mean 1.5, limits 1.5 ± 0.98, to what the fits leave."""
    files = [_table(tmp_path / f"{n}{k}.csv", 8.0 + k * (1 + 0.5 * n), 2 * n + k) for n in range(3) for k in (0, 1)]
    assert run(["adapt", "retest", *files, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["break_min"]["agreement"]
    assert found["mean"]["value"] == pytest.approx(1.5, abs=0.3)
    assert found["upper"]["value"] - found["mean"]["value"] == pytest.approx(1.96 * found["sd"], rel=1e-4)
    assert found["upper"]["low"] < found["upper"]["value"] < found["upper"]["high"]
    assert run(["adapt", "retest", *files[:3]]) == 2
    assert "two for each subject" in capsys.readouterr().err
    others = [_table(tmp_path / f"{one}.csv", 8.0, 1, f"# subject: {one}\n# eye: right\n") for one in ("S1", "S2")]
    assert run(["adapt", "retest", *others]) == 2
    assert "of subject S1 and S2" in capsys.readouterr().err


@pytest.mark.slow
def test_fit_reports_false_alarms_lapses_and_looks_away(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the counts in the table's head, in terminal, JSON and page."""
    head = "# false_alarms: 2/100\n# lapses: 1/20\n# seen_at_blind_spot: 6/30\n"
    file, page = _table(tmp_path / "a.csv", 8.0, 1, head), tmp_path / "a.html"
    assert run(["adapt", "fit", file, "--bootstrap", "0", "--report", str(page)]) == 0
    assert "Fixation lost                    19.3 %" in capsys.readouterr().out
    assert run(["adapt", "fit", file, "--bootstrap", "0", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)["reliability"]
    assert printed["fixation_losses"]["share"] == pytest.approx((0.2 - 0.02) / (0.98 * 0.95))
    assert (printed["lapses"]["hits"], printed["lapses"]["of"]) == (1, 20)
    assert "<h2>The subject</h2>" in page.read_text(encoding="utf-8")


THRESHOLDS = [(0, -1), (1, -1.5), (2, -2), (4, -2.2), (8, -2.6), (12, -3.5), (20, -4.5), (30, -4.8)]


@pytest.mark.parametrize(
    ("words", "row", "code", "shown"),
    [
        (["adapt", "fit"], (20_000, -4.9), 1, "time: 20000 min is outside 0 to 1440 min"),
        (["adapt", "fit"], (-5, -1), 1, "time: -5 min is outside"),
        (["adapt", "fit"], (40, -22), 1, "log10 threshold after 40 min: -22 is outside"),
        (["log", "--after", "99999999999999999999"], None, 2, "after: 1e+20 is outside"),
        (["log", "--budget", "99999999999999999999"], None, 1, "reading 99999999999999999999"),
    ],
)
def test_numbers_beyond_all_are_refused_in_one_line(words, row, code, shown, tmp_path, capsys):
    """A mistake of unit or power of ten is named with the range, and nothing is calculated with it."""
    if row is not None:
        rows = sorted([*THRESHOLDS, row])
        (tmp_path / "t.csv").write_text("time_min,log10_threshold\n" + "".join(f"{t},{v}\n" for t, v in rows))
        words = [*words, str(tmp_path / "t.csv")]
    assert run(words) == code
    printed = capsys.readouterr()
    assert shown in printed.err
    assert len(printed.err.strip().splitlines()) == 1
    assert printed.out == ""

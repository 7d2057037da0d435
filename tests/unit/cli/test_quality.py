"""`radiometer quality` on the simulated bench: captures by step, the table, JSON and the datasheet."""

from __future__ import annotations

import json

import pytest
import yaml

from radiometer.cli.main import run as main
from testing import quality_stations as stations

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


def test_plan_lists_every_index(capsys):
    """Symbols, definitions and steps of all twelve."""
    assert main(["quality", "plan", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert {"f1′", "f3", "f6", "f7", "f8", "f11", "f12", "f21", "edge", "smear", "VGI"} < {
        one["symbol"] for one in listed
    }
    assert next(one for one in listed if one["name"] == "glare")["steps"][1]["name"] == "black"


def test_steps_are_captured_one_by_one_and_reported(bench, tmp_path, capsys):
    """Two steps of one bench: a focus that changes nothing, in the table and in JSON, with its interval."""
    session = tmp_path / "session"
    for step in ("far", "near"):
        assert main(["quality", "take", str(session), "focus", step, "--bench", str(bench)]) == 0
    capsys.readouterr()
    assert main(["quality", "report", str(session), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    focus = next(one for one in printed["indices"] if one["index"] == "focus")
    assert focus["measured"]
    assert focus["value"] <= focus["expanded"]
    assert focus["expanded"] == pytest.approx(focus["coverage_factor"] * focus["u"])
    assert [one["index"] for one in printed["indices"] if one["measured"]] == ["focus"]


@pytest.mark.slow
def test_a_ladder_reaches_down_to_a_fortieth(bench, tmp_path, capsys):
    """Linearity captures exposures over a range of 40, several frames each, with darks of the same times."""
    assert main(["quality", "take", str(tmp_path / "s"), "linearity", "ladder", "--bench", str(bench)]) == 0
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
        assert main(["quality", "take", str(session), "range", step, "--bench", str(bench)]) == 0
    header = yaml.safe_load((session / "range" / "12dB" / "capture.yaml").read_text())
    assert {frame["gain_db"] for frame in header["frames"]} == {12.0}
    (session / "range" / "0dB").rename(session / "range" / "6dB")
    capsys.readouterr()
    assert main(["quality", "report", str(session), "--json"]) == 0
    (change,) = (one for one in json.loads(capsys.readouterr().out)["indices"] if one["index"] == "range")
    assert not change["measured"]
    assert "step '6dB' was captured at 0 dB; remove" in change["reason"]


def test_several_steps_need_a_hand(bench, tmp_path, capsys):
    """Without a terminal nothing is captured of two steps that differ by what stands before the camera."""
    assert main(["quality", "take", str(tmp_path / "s"), "focus", "--bench", str(bench)]) == 1
    assert "name one step at a time" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nonsense", "far"], "is no procedure"),
        (["focus", "middle"], "is no step of focus"),
        (["size", "../x"], "no step"),
        *((["range", name], "no step") for name in ("12,5dB", "+12dB", "1e1dB", "nandB", "12dBm", "gain12dB")),
        *((["polarisation", name], "no step") for name in ("nan", "1e999", "45\n")),
    ],
)
def test_unknown_names_are_misuse(words, message, tmp_path, capsys):
    """Procedures and steps that there are not; a step's name never leaves the session's folder."""
    assert main(["quality", "take", str(tmp_path / "s"), *words]) == 2
    assert message in capsys.readouterr().err


def test_a_step_is_not_taken_twice(bench, tmp_path, capsys):
    """A capture that is there is left alone, and stated."""
    words = ["quality", "take", str(tmp_path / "s"), "focus", "far", "--bench", str(bench)]
    assert main(words) == 0
    written = (tmp_path / "s" / "focus" / "far" / "capture.yaml").stat().st_mtime_ns
    assert main(words) == 0
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
    assert main(["quality", "report", str(tmp_path / "s"), "-o", str(sheet)]) == 0
    page = sheet.read_text(encoding="utf-8")
    assert "1 of 12 indices measured; the largest is focus distance (f12): 3.8" in page
    assert "<script>" not in page
    assert "http" not in page.replace("http-equiv", "")
    assert page.index("focus distance") < page.index("Not measured") < page.index("What was assumed")


def test_nothing_to_report_says_the_way(tmp_path, capsys):
    """An empty session fails with what to do."""
    assert main(["quality", "report", str(tmp_path)]) == 1
    assert "radiometer quality take" in capsys.readouterr().err

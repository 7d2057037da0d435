"""From frames to a verdict, the model file and the documented JSON."""

import contextlib
import io
import json

import numpy as np
import pytest

from radiometer.cli.main import run
from radiometer.data import CaptureSetWriter
from radiometer.reconciliation import Verdict, engine
from simulators.chain.camera_model import CameraModel
from testing.reconciled import reconcile

pytestmark = pytest.mark.long  # each runs a whole search


def _write(captured, folder):
    header = captured.header
    with CaptureSetWriter(folder, header.camera, header.lens, header.source, header.patches, header.patterns) as writer:
        for frame in captured.frames:
            writer.add(frame)
    return folder


@pytest.fixture(scope="module")
def offset(make_capture):
    """Return the result for exposures that are 8 µs longer than stated."""
    captured = make_capture(seed=11, exposure=lambda t: t + 8e-6)
    return reconcile(captured.header, captured.frames)


def test_a_name_has_the_probability_of_all_models_that_hold_it(offset):
    """The one hidden effect is almost certain; the models are sets of names with weights; ± includes their choice."""
    answer = json.loads(offset.to_json())
    (effect,) = answer["effects"]
    assert (effect["name"], answer["verdict"]) == ("exposure_time_offset", "effects_found")
    found = effect["parameters"]["offset_s"]
    assert abs(found["value"] - 8e-6) < 3 * found["u"]
    assert answer["gap"]["before"] > 1.1
    assert answer["gap"]["after"] == pytest.approx(1.0, abs=0.05)
    holding = sum(model["weight"] for model in answer["models"] if effect["name"] in model["names"])
    assert effect["probability"] == pytest.approx(holding, abs=0.01)  # models below one in a thousand are not listed
    assert effect["probability"] > 0.95
    averaged = effect["averaged"]["offset_s"]
    assert abs(averaged["value"] - 8e-6) < 3 * averaged["u"]


@pytest.mark.parametrize("leak", [0.3, 3.0])
def test_a_leak_far_beyond_its_trials_is_named_for_what_it_is(make_capture, leak):
    """Dark patches are many times brighter than stated: stated radiances take it up, and a bent exponent comes near."""
    captured = make_capture(seed=14, picture=lambda image, s: image + leak)
    result = reconcile(captured.header, captured.frames, with_limits=False)
    (found,) = result.effects
    assert found.name == "display_black_leak"
    assert result.gap_before > 100  # at the radiances that are stated
    share = found.parameters["share"]
    assert abs(share.value - leak) < 3 * np.hypot(share.u, leak * 0.005)  # of white, which is known to 0.5 %


def test_constant_offset_without_its_entry_is_no_other_entry(make_capture):
    """A drift from a far temperature imitates an offset with a parameter more: its name is never a confident one."""
    captured = make_capture(seed=13, extra_dn=lambda s: -1.5)
    result = reconcile(captured.header, captured.frames, without=("black_level_offset",), with_limits=False)
    assert result.verdict in (Verdict.UNNAMED, Verdict.INCOMPLETE)
    assert any("digital_constant" in line for line in result.assumptions)


@pytest.mark.usefixtures("laws_left_out")
def test_uneven_leak_moves_whole_patches_and_nothing_else_is_named(make_capture):
    """Few pixels leak much: the patches that hold them differ in mean and spread, and that belongs to the one name."""
    drawn = np.random.default_rng(5).lognormal(0.0, 0.7, (64, 96))
    leak = 10.0 * drawn / drawn.std()
    captured = make_capture(seed=16, extra_e=lambda s: (leak - leak.min()) * s["t"] * 2 ** ((s["T"] - 35.0) / 7.0))
    result = reconcile(captured.header, captured.frames, with_limits=False)
    assert {effect.name for effect in result.effects} <= {"dark_current_nonuniformity", "dark_current"}
    assert result.verdict is Verdict.EFFECTS_FOUND


@pytest.fixture(scope="module")
def commanded(make_capture, tmp_path_factory):
    """Return the model and the report that the command writes for an offset of 1.5 DN, and what it prints."""
    folder = tmp_path_factory.mktemp("commanded")
    model, report = folder / "reconciled.yaml", folder / "report.html"
    captured = _write(make_capture(seed=14, extra_dn=lambda s: 1.5), folder / "set")
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert run(["reconcile", str(captured), "-o", str(model), "--report", str(report), "--json"]) == 0
    return model, report, printed.getvalue()


def test_command_writes_json_model_and_report(commanded):
    """The command prints one JSON object of the documented form; model and report can be opened."""
    model, report, text = commanded
    printed = json.loads(text)
    assert printed["verdict"] == "effects_found"
    (effect,) = printed["effects"]
    assert effect["name"] == "black_level_offset"
    assert set(effect["parameters"]["offset_dn"]) == {"value", "u", "unit"}
    assert {"where", "gap_before", "gap_after", "alternatives", "next_capture"} <= set(effect)
    assert printed["gap"]["unit"] == "reduced chi-square on held-out frames"
    assert (printed["model"], printed["report"]) == (str(model), str(report))
    loaded = CameraModel.read(model)
    assert loaded.effect("black_level_offset").values()["offset_dn"] == pytest.approx(1.5, abs=0.02)
    assert "data:image/svg+xml;base64," in report.read_text(encoding="utf-8")


# Limits and next captures are advice: whatever happens to them, the answer stands.


PLAN = [{"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 6) for _ in range(2)] + [{"t": 1e-2, "shutter": "closed"}]


@pytest.mark.long
def test_answer_stands_where_advice_fails(make_capture, monkeypatch):
    """An error in the limits and in the next capture is reported among the assumptions; the name is still found."""

    def broken(*given):
        raise IndexError("index 7 is out of bounds for axis 1 with size 7")

    captured = make_capture(seed=31, plan=PLAN, extra_dn=lambda s: 3.0)
    for name in ("limits", "propose", "propose_for_unnamed", "propose_for_blind"):
        monkeypatch.setattr(engine, name, broken)
    after = reconcile(captured.header, captured.frames)
    assert [effect.name for effect in after.effects] == ["black_level_offset"]
    assert (after.limits, after.next_capture) == ({}, None)
    assert any(text.startswith("the limits could not be computed (IndexError: index 7") for text in after.assumptions)

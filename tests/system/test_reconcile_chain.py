"""The whole chain as a user runs it: hidden effect, bracket, reconcile, the plan that it asks for, reconcile again."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from radiometer.cli.main import run
from radiometer.data import LensDescription
from radiometer.devices import CameraPreset
from simulators.chain.camera_model import CameraModel
from simulators.effects.registry import make_effect

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

HIDDEN_SHARE = 0.01
PEAK, PATCH_U_REL = 1.5, 0.005
LENS = {"focal_length_mm": 16, "f_number": 4, "transmittance": 0.95}
STRAY = {"veiling_glare", "display_black_leak", "ambient_light_leak"}


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Return a bench file: a simulated camera with a veil hidden in its model before a screen of known patches."""
    ideal = CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, LensDescription.model_validate(LENS))
    ideal.with_effect(make_effect("veiling_glare", {"share": HIDDEN_SHARE})).write(tmp_path / "hidden.yaml")
    rng = np.random.default_rng(5)
    drives = rng.permutation(0.02 * 1.17 ** np.arange(24)).round(4).tolist()
    places = [{"name": f"p{k:02d}", "x": 4 + 24 * (k % 6), "y": 4 + 24 * (k // 6)} for k in range(24)]
    places = [place | {"width": 16, "height": 16} for place in places]
    stated = [PEAK * drive * (1 + 0.6 * PATCH_U_REL * rng.standard_normal()) for drive in drives]
    camera = {"kind": "simulated", "preset": "BFS-U3-19S4M", "seed": 7, "temperature_C": 40, "model": "hidden.yaml"}
    mapping = {
        "format": "radiometer-bench/1",
        "camera": camera | {"black_level_dn": 64, "width": 144, "height": 96},
        "lens": LENS,
        "source": {"kind": "screen", "wavelength_nm": 550},
        "scene": {
            "kind": "screen",
            "peak_radiance_W_per_sr_m2": PEAK,
            "gamma": 1.0,
            "background": 0.2,
            "patches": [place | {"drive": drive} for place, drive in zip(places, drives, strict=True)],
        },
        "patches": [
            place | {"radiance_W_per_sr_m2": float(radiance), "u_rel": PATCH_U_REL}
            for place, radiance in zip(places, stated, strict=True)
        ],
    }
    file = tmp_path / "bench.yaml"
    file.write_text(yaml.safe_dump(mapping))
    return file


def test_plan_of_the_first_answer_settles_it(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Stray light has three names until its plan is taken; then one, the true share, and a model that simulates."""
    first, again, plan, model = (str(tmp_path / name) for name in ("first", "again", "plan.yaml", "reconciled.yaml"))
    ladder = ["--from", "200us", "--to", "12.8ms", "--stops", "1", "--repeat", "8", "--darks", "4"]
    assert run(["bracket", first, "--bench", str(bench), *ladder]) == 0
    capsys.readouterr()
    assert run(["reconcile", first, "--plan", plan]) == 0
    printed = capsys.readouterr().out
    assert "more than one name" in printed
    assert "conditional on this effect" in printed
    assert all(name in printed for name in STRAY)

    assert run(["bracket", again, "--bench", str(bench), "--plan", plan]) == 0
    capsys.readouterr()
    assert run(["reconcile", again, "-o", model, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    (effect,) = answer["effects"]
    assert (answer["verdict"], effect["name"], effect["alternatives"]) == ("effects_found", "veiling_glare", [])
    share = effect["parameters"]["share"]
    assert abs(share["value"] - HIDDEN_SHARE) < 4 * share["u"]

    settings = yaml.safe_load(bench.read_text())
    settings["camera"] |= {"model": "reconciled.yaml", "seed": 8}
    bench.write_text(yaml.safe_dump(settings))
    simulated = str(tmp_path / "simulated")
    assert run(["bracket", simulated, "--bench", str(bench), *ladder]) == 0
    capsys.readouterr()
    assert run(["reconcile", simulated, "--model", model, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "agrees"

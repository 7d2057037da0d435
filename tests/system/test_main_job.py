"""The README's first command as a user runs it: the shipped bench and calibration read the truth off every patch."""

import json

import pytest
import yaml

from radiometer.cli.main import run
from radiometer.data.storage import shipped_config

SCENE = yaml.safe_load(shipped_config("bench-simulated.yaml").read_text())["scene"]
LIT = [patch for patch in SCENE["patches"] if patch["drive"] > 0]


def middle_of(patch, size=120):
    """Return the words for the middle of a patch."""
    x, y = patch["x"] + (patch["width"] - size) // 2, patch["y"] + (patch["height"] - size) // 2
    return f"{x},{y},{size},{size}"


@pytest.mark.parametrize("patch", LIT, ids=lambda patch: patch["name"])
def test_every_patch_of_the_shipped_bench_reads_its_radiance(patch, capsys):
    """From white to nearly black, in the middle and towards the corners: true radiance within U (k = 2), no flag."""
    assert run(["measure", "--json", "--patch", middle_of(patch)]) == 0
    reading = json.loads(capsys.readouterr().out)
    true = SCENE["peak_radiance_W_per_sr_m2"] * patch["drive"] ** SCENE["gamma"]
    assert reading["flags"] == []
    assert reading["radiance"]["unit"] == "W sr-1 m-2"
    assert reading["radiance"]["value"] == pytest.approx(true, abs=2 * reading["radiance"]["u"])
    # The simulated reference source is exactly as stated, so noise alone is left.
    assert reading["radiance"]["value"] == pytest.approx(true, rel=0.002)

"""`radiometer light` and `radiometer simulate box` as a user runs them."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from radiometer.bench.boxes import open_light_box
from radiometer.cli.main import run
from testing.patience import within


@pytest.fixture
def surroundings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Keep data and ports of this test apart from the user's."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("RADIOMETER_STATE", str(tmp_path / "state"))
    return dict(os.environ)


@pytest.fixture
def served(surroundings: dict[str, str], project_root: Path) -> Iterator[str]:
    """Serve a simulated box in a process of its own and return its port."""
    words = [sys.executable, "-m", "radiometer", "simulate", "box", "--serial", "CLI00001", "--press-every", "1s"]
    process = subprocess.Popen(
        words, cwd=project_root, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    yield process.stdout.readline().decode().strip()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=within(20))
    assert process.returncode == 0, err.decode()
    assert out == b""


def test_box_is_found_by_its_serial_number_and_set_leaves_it_dark(served, capsys):
    """Discovery asks for identity, without naming its port; `set --for` reads the level back, then the box is dark."""
    assert run(["light", "status", "--box", "CLI00001", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["serial"] == "CLI00001"
    assert report["port"] == served
    assert set(report["channels"]) == {"bleach", "spot", "spot_red", "fixation", "spot_green", "field"}
    assert report["supply_v"] == pytest.approx(12.0)
    started_s = time.monotonic()
    assert run(["light", "set", "spot", "--level", "1234", "--low", "--for", "0.5", "--json"]) == 0
    assert time.monotonic() - started_s > 0.5
    report = json.loads(capsys.readouterr().out)
    assert (report["mode"], report["level"], report["current_range"]) == ("steady", 1234, "low")
    with open_light_box(served) as opened:
        assert opened.box.read_channel("spot").drive.level == 0


def test_button_is_watched(served, capsys):
    """Presses are printed one JSON object per line, with their uncertainty."""
    assert run(["light", "watch-buttons", "--box", served, "--count", "2", "--json"]) == 0
    entries = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    presses = [entry["time_s"] for entry in entries if entry["pressed"]]
    assert len(presses) == 2
    assert presses[1] - presses[0] == pytest.approx(1.0, abs=0.5)
    assert all(0 < entry["u_s"] < 0.05 for entry in entries)


def test_calibrate_then_set_by_radiance(surroundings, capsys, tmp_path):
    """After `light calibrate` a radiance can be set, and one out of range is refused with exit code 1."""
    assert run(["light", "set", "bleach", "--radiance", "0.1", "--box", "sim"]) == 1
    assert "light calibrate" in capsys.readouterr().err
    assert run(["light", "calibrate", "--box", "sim", "--channel", "bleach", "--seed", "2", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert Path(report["file"]) == tmp_path / "data" / "radiometer" / "light_boxes" / "SIM00001.yaml"
    assert run(["light", "set", "bleach", "--radiance", "0.1", "--box", "sim", "--json"]) == 0
    radiance = json.loads(capsys.readouterr().out)["radiance"]
    assert radiance["value"] == pytest.approx(0.1, rel=0.02)
    assert 0.009 < radiance["u"] < 0.012  # the correction for the spectrum: 10 %
    assert run(["light", "set", "bleach", "--radiance", "1000", "--box", "sim"]) == 1
    assert "allowed is" in capsys.readouterr().err


@pytest.mark.parametrize("allowed", ["0.101", "1", "true", "0", "-0.1", ".nan"])
def test_a_preset_cannot_allow_more_than_a_tenth(capsys, tmp_path, project_root, allowed):
    """Less than a tenth of the limit is the owner's choice, more is refused by the key; so is what is no number."""
    preset = tmp_path / "box.yaml"
    shipped = (project_root / "configs/light_boxes/reference.yaml").read_text(encoding="utf-8")
    preset.write_text(shipped.replace("allowed_fraction: 0.1 ", f"allowed_fraction: {allowed} "), encoding="utf-8")
    light = ["light", "pulse", "spot", "--level", "9", "--duration", "0.1", "--box", "sim", "--preset", str(preset)]
    assert run(light) == 2
    assert "allowed_fraction" in capsys.readouterr().err


def test_a_lost_account_stops_light_until_it_is_confirmed(served, capsys):
    """The message gives the command that confirms; with it the same light is given; darkness needs none."""
    account = Path(os.environ["RADIOMETER_STATE"]) / "exposure-account.json"
    account.write_bytes(account.read_bytes()[:-9])
    assert run(["light", "account"]) == 0
    shown = capsys.readouterr()
    assert ("was damaged" in shown.err, shown.out) == (True, "")
    light = ["light", "set", "spot", "--level", "100", "--for", "0.1", "--box", served]
    assert run(light) == 1
    error = capsys.readouterr().err
    assert "was damaged" in error
    assert run(["light", "off", "--box", served]) == 0
    way_out = error.partition("radiometer light account")[2].split()
    assert run(["light", "account", *way_out]) == 0
    assert run(light) == 0
    assert run(["light", "account", "--confirm-no-exposure"]) == 2


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_simulated_box_that_was_ended_leaves_no_port(surroundings, project_root, capsys, end):
    """Another one of the same serial number is found as the only one, and darkened."""
    words = [sys.executable, "-m", "radiometer", "simulate", "box", "--serial", "CLI00002"]
    boxes = []
    for _ in range(2):
        boxes.append(subprocess.Popen(words, cwd=project_root, env=surroundings, stdout=subprocess.PIPE))
        assert boxes[-1].stdout is not None
        boxes[-1].stdout.readline()
        if len(boxes) == 1:
            boxes[0].send_signal(end)
            boxes[0].communicate(timeout=within(20))
            assert run(["light", "status"]) == 1
    try:
        assert run(["light", "off"]) == 0
        assert "CLI00002: dark" in capsys.readouterr().out
    finally:
        boxes[1].kill()
        boxes[1].communicate()


@pytest.mark.parametrize("target", [None, "elsewhere.txt", "nowhere", "/proc/self/fd/0", "/proc/{own}/fd/0"])
def test_a_simulated_box_replaces_no_file_by_its_port(tmp_path, surroundings, capsys, target):
    """Only a link that a killed one left is replaced, not another one; the exit code is that of misuse."""
    file = tmp_path / "precious.txt"
    (tmp_path / "elsewhere.txt").write_text("precious")
    if target is None:
        file.write_text("precious")
    else:
        target = target.format(own=os.getpid())
        file.symlink_to(target)
    assert run(["simulate", "box", "--link", str(file)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (str(file.readlink()) if file.is_symlink() else file.read_text()) == (target or "precious")

"""The main job over GigE Vision: commands here, the simulated Blackfly in a process of its own."""

import json
import math
import shlex
import shutil
import subprocess
import sys
import time

import pytest

from drivers.cameras.camera_opening import answers
from radiometer.cli.main import run
from testing.patience import ENDS_WITH_US, within

LOOPBACK = "127.0.0.1"
BENCH = """\
format: radiometer-bench/1
camera: {kind: simulated, preset: BFS-U3-19S4M, serial: "22500078", width: 320, height: 240}
lens: {focal_length_mm: 16, f_number: 4, transmittance: 0.95, transmittance_u_rel: 0.01}
source: {kind: screen, wavelength_nm: 550}
scene:
  kind: step_chart
  steps: {count: 12, lowest: 0.001, highest: 2.0}
patch: {x: 100, y: 100, width: 40, height: 30}
"""


@pytest.fixture
def bench(tmp_path):
    """Return a small bench file."""
    file = tmp_path / "bench.yaml"
    file.write_text(BENCH, encoding="utf-8")
    return file


@pytest.fixture
def serve(aravis_installed, gige_port, bench, project_root):
    """Return a function that serves the bench's camera in a process of its own."""
    running = []

    def start(*options):
        command = [sys.executable, "-m", "radiometer", "simulate", "camera", "--fast", "--bench", str(bench), *options]
        process = subprocess.Popen([*ENDS_WITH_US, *command], cwd=project_root, stdout=subprocess.DEVNULL)
        running.append(process)
        end = time.monotonic() + within(30.0)
        while not answers(LOOPBACK, attempts=1, timeout_s=0.2):
            assert time.monotonic() < end, "the simulated camera did not come up"
        return process

    yield start
    for process in running:
        process.kill()
        process.wait()


def reading(bench, camera, capsys):
    assert run(["measure", "--bench", str(bench), "--camera", camera, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_wire_gives_the_same_radiance_as_the_simulator(serve, bench, capsys):
    """With other noise on the wire, two readings of one scene agree within three of their combined uncertainties."""
    serve("--seed", "7")
    near, far = reading(bench, "sim", capsys)["radiance"], reading(bench, LOOPBACK, capsys)["radiance"]
    assert far["unit"] == near["unit"]
    assert abs(far["value"] - near["value"]) < 3 * math.hypot(near["u"], far["u"])
    assert 0 < far["u"] < 0.05 * far["value"]


def test_a_bracket_over_the_wire_feeds_the_response(serve, bench, tmp_path, capsys):
    """`bracket` writes a capture set that `response` accepts, with the camera as it reported itself."""
    serve()
    capture, curve = tmp_path / "capture", tmp_path / "curve.csv"
    assert run(["bracket", str(capture), "--bench", str(bench), "--camera", LOOPBACK]) == 0
    assert "22500078" in (capture / "capture.yaml").read_text(encoding="utf-8")
    assert run(["response", str(capture), "-o", str(curve)]) == 0
    assert len(curve.read_text(encoding="utf-8").splitlines()) == 1 + 4096


def test_a_camera_killed_in_mid_bracket_leaves_nothing_behind(serve, bench, tmp_path, capsys):
    """The error names the camera, no capture set is left, and the next run works."""
    camera = serve("--drop-after", "6")
    capture = tmp_path / "out" / "capture"
    words = ["bracket", str(capture), "--bench", str(bench), "--camera", LOOPBACK]
    start = time.monotonic()
    assert run([*words, "--stops", "0.25", "--from", "1ms", "--to", "100ms"]) == 1
    assert time.monotonic() - start < within(40.0)
    assert "22500078 stopped answering" in capsys.readouterr().err
    assert not capture.exists()
    camera.wait(timeout=within(20))
    serve()
    assert run(words) == 0


def test_the_doctor_examines_the_camera_on_the_wire(serve, bench, capsys):
    """The doctor names what was on, measures rate, temperature, dark level and linearity, and finds it sound."""
    serve()
    assert run(["doctor", "--bench", str(bench), "--camera", LOOPBACK, "--json"]) == 0
    findings = {f["check"]: f for f in json.loads(capsys.readouterr().out)["findings"]}
    assert findings["feature GammaEnable"]["health"] == "note"
    for check in ("camera", "temperature", "dark level", "linearity"):
        assert findings[check]["health"] == "ok", findings[check]
    assert "frames/s at full size" in findings["frame rate"]["message"]  # how many depends on this computer's load


def test_every_camera_is_found_by_its_serial_number(serve, bench, project_root):
    """Discovery finds the camera by its serial number, in a network that has nothing but loopback."""
    script = (
        "import subprocess, sys, time\n"
        "subprocess.run(['ip', 'link', 'set', 'lo', 'up'], check=True)\n"
        f"words = [sys.executable, '-m', 'radiometer', 'simulate', 'camera', '--fast', '--bench', {str(bench)!r}]\n"
        "camera = subprocess.Popen(words, stdout=subprocess.PIPE)\n"
        "camera.stdout.readline()\n"
        "from drivers.cameras.aravis_camera import open_camera\n"
        "with open_camera('22500078') as found:\n"
        "    print(found.identity.device_id, found.identity.interface)\n"
        "camera.kill()\n"
    )
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip("no network of one's own without unshare and ip: apt install util-linux iproute2")
    isolated = ["unshare", "--net", "--map-root-user", sys.executable, "-c", script]
    done = subprocess.run(isolated, cwd=project_root, capture_output=True, text=True, timeout=within(60), check=False)
    if "unshare" in done.stderr:
        pytest.skip(f"no network of one's own on this computer: {done.stderr.strip()}")
    assert done.stdout.strip() == "FLIR-BFS-U3-19S4M-22500078 GigEVision 127.0.0.1", done.stderr


def readme_commands(project_root):
    """Return the words of the README's five commands."""
    section = (project_root / "README.md").read_text(encoding="utf-8").partition("## Five commands")[2]
    block = section.partition("```console\n")[2].partition("```")[0]
    return [shlex.split(line.removeprefix("$ radiometer "), comments=True) for line in block.splitlines()]


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("camera", ["sim", LOOPBACK])
def test_the_readmes_five_commands_run_on_a_bench(camera, serve, bench, project_root, tmp_path, monkeypatch, capsys):
    """With --bench, and the camera simulated here or on the wire: no option is missing, every file is written."""
    if camera == LOOPBACK:
        serve()
    monkeypatch.chdir(tmp_path)
    commands = readme_commands(project_root)
    assert [words[0] for words in commands] == ["measure", "bracket", "response", "merge", "reconcile"]
    for words in commands:
        own = ["--bench", str(bench), "--camera", camera] if words[0] in ("measure", "bracket") else []
        assert run([*words, *own]) == 0, capsys.readouterr().err
    assert all((tmp_path / name).is_file() for name in ("response.yaml", "map.png", "map.exr", "report.html"))

"""The daemon as a process: signals, crashes, load, and its journal afterwards."""

import json
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks import daemon_kill, daemon_load, daemon_soak
from radiometer.cli.main import run
from testing.daemon_process import ROOT, DaemonProcess, write_small_bench
from testing.patience import within


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly(tmp_path: Path, number: int) -> None:
    """Exit code 0, no traceback, nothing left unfinished in the journal."""
    with DaemonProcess(tmp_path, "--every", "0.02") as daemon:
        daemon.wait_for_reading()
        assert daemon.stop(number) == 0
    assert not [line for line in daemon.lines if "Traceback" in line or "error" in line.lower()]
    assert not daemon.journal.with_name("journal.sqlite-wal").exists()


def test_hangup_reloads_the_calibration(tmp_path: Path) -> None:
    """A changed file is taken; a broken one, or one that nests without end, is an alarm and the old one stays."""
    calibration = tmp_path / "calibration.yaml"
    text = (ROOT / "configs/calibrations/simulated.yaml").read_text(encoding="utf-8")
    calibration.write_text(text, encoding="utf-8")
    with DaemonProcess(tmp_path, "--every", "0.1", "--calibration", str(calibration)) as daemon:
        daemon.wait_for_reading()
        before = daemon.post("/measure", {})["radiance"]["value"]
        for broken, reason in (("format: nonsense\n", "format"), ("[" * 100_000, "nested more than")):
            calibration.write_text(broken, encoding="utf-8")
            daemon.process.send_signal(signal.SIGHUP)  # type: ignore[union-attr]
            _until(
                lambda reason=reason: (
                    [reason in alarm["message"] for alarm in daemon.get("/status")["alarms"]] == [True]
                )
            )
            assert daemon.post("/measure", {})["radiance"]["value"] == pytest.approx(before, rel=0.01)
        calibration.write_text(text, encoding="utf-8")
        daemon.process.send_signal(signal.SIGHUP)  # type: ignore[union-attr]
        _until(lambda: daemon.get("/status")["alarms"] == [])


@pytest.mark.long
def test_kills_leave_no_hole_and_lose_nothing_that_was_seen() -> None:
    """Four kills here; the benchmark does fifty."""
    result = daemon_kill.run(4, seed=7)
    assert (result.holes, result.duplicates, result.missing) == (0, 0, 0)
    assert result.seen > 0


@pytest.mark.long
def test_many_clients_are_served_while_it_measures() -> None:
    """200 clients at 20 queries/s for 2 s: every reply comes and is right. The benchmark takes a minute, and times."""
    result = daemon_load.run("small", 0.1, 200, 20.0, 2.0)
    assert result.replies.errors == 0
    assert result.replies.asked == 200 * 40
    assert result.loaded_per_s > 0


@pytest.mark.long
def test_a_short_soak_leaks_no_descriptor() -> None:
    """Clients come and go for 8 s; descriptors stay, and memory grows by less than a leak would show."""
    result = daemon_soak.run(8.0, warm_up_s=6.0, sample_s=0.25)
    assert result.errors == 0
    assert abs(result.descriptors_last - result.descriptors_first) <= 6  # connections that come and go
    assert result.end_mb - result.warm_mb < 15


def test_log_queries_exports_and_plots(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """While the daemon runs and after it ended."""

    def log(*arguments: str) -> str:
        capsys.readouterr()
        assert run(["log", str(daemon.journal), *arguments]) == 0
        return capsys.readouterr().out

    with DaemonProcess(tmp_path, "--every", "0.05") as daemon:
        daemon.wait_for_reading()
        time.sleep(1.0)
        lines = log("--json", "--limit", "5").splitlines()
    assert len(lines) == 5
    first = json.loads(lines[0])
    assert [json.loads(line)["sequence"] for line in lines] == list(range(first["sequence"], first["sequence"] + 5))
    assert log("--csv", "--limit", "2").startswith("sequence,time,instrument,radiance,u_radiance,")
    assert "standard deviation" in log("--since", "1h")
    assert "combined (k = 1)" in log("--budget", str(first["sequence"]))
    assert "camera is open" not in log("--events")
    log("--plot", str(tmp_path / "plot.png"))
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_systemd_is_notified(tmp_path: Path) -> None:
    """READY, the watchdog, and STOPPING arrive at the notification socket."""
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(str(path))
        channel.settimeout(within(30))
        bench = write_small_bench(tmp_path)
        command = [sys.executable, "-m", "radiometer", "serve", "--journal", str(tmp_path / "j"), "--scpi-port", "0",
                   "--http-port", "0", "--bench", str(bench)]  # fmt: skip
        environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "400000", "PATH": "/usr/bin:/bin"}
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.DEVNULL)
        messages = [channel.recv(1000).decode()]
        while "WATCHDOG=1" not in messages:
            messages.append(channel.recv(1000).decode())
        process.terminate()
        while not messages[-1].startswith("STOPPING=1"):
            messages.append(channel.recv(1000).decode())
        assert process.wait(within(20.0)) == 0
    assert messages[0].startswith("READY=1\n")


def _until(condition: object, deadline_s: float = 30.0) -> None:
    give_up = time.monotonic() + within(deadline_s)
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < give_up, "the condition did not come true"
        time.sleep(0.05)

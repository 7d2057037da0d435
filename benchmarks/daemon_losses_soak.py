"""Runs the daemon for an hour with clients while camera, light box, MQTT broker and disk go away every few minutes."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks import daemon_loss
from benchmarks._sections import write_section
from benchmarks._soak_losses import Broker, Fault, FullDisk, Losses, small_disk
from benchmarks.daemon_soak import sample, slope
from simulators.light_box.box import SimulatedLightBox
from simulators.light_box.lines import PtyServer, WiredLightBox
from testing import soak_clients as clients
from testing.daemon_process import ROOT, DaemonProcess, machine_note
from testing.soak_world import PATCHES, SERIAL, Verdict, Witness, fill_journal, judge, write_benches
from testing.wire import only_camera

SECONDS = float(os.environ.get("RADIOMETER_SOAK_S", "3600"))
EVERY_S = 150.0  # mean time between two losses of the same thing
_CALIBRATION = ROOT / "configs" / "calibrations" / "simulated.yaml"


@dataclass(frozen=True, slots=True)
class LossesSoakResult:
    """What the hour showed; memory in MB, slope in MB/h."""

    seconds: float
    warm_up_s: float
    losses: dict[str, int]
    witness: Witness
    verdict: Verdict
    memory_mb: list[float]
    slope_mb_per_h: float
    u_slope_mb_per_h: float
    descriptors: tuple[int, int]
    exit_code: int
    errors_logged: list[str]


def run(seconds: float, *, every_s: float = EVERY_S, warm_up_s: float, seed: int = 1) -> LossesSoakResult:
    """Run the daemon on the camera on the wire for a time, warm-up included, and judge all that was seen."""
    witness = Witness()
    with contextlib.ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory()))
        held.enter_context(only_camera())
        disk, own_disk = held.enter_context(small_disk(folder))
        before = fill_journal(disk / "journal.sqlite")
        twin, daemon, faults, broker = held.enter_context(_world(folder, disk, own_disk=own_disk))
        losses = [Losses(fault, every_s, seed + number) for number, fault in enumerate(faults)]
        listener = clients.MqttListener(broker.port, witness)
        users = _users(daemon, witness, twin)
        for thread in (*users, *losses):
            thread.start()
        logged = threading.Thread(target=_log_progress, args=(daemon, witness, faults), daemon=True)
        logged.start()
        begun = time.monotonic()
        sample(daemon, warm_up_s, 1.0)
        times_s, megabytes, descriptors = sample(daemon, seconds - (time.monotonic() - begun), 1.0)
        for loss in losses:
            loss.stop()
        _wait_until_well(daemon)
        for user in users:
            user.stop()
        listener.close()
        errors = [line for line in daemon.lines if "unexpected error" in line or "Traceback" in line]
        exit_code = daemon.stop(deadline_s=60.0)
        verdict = judge(daemon.journal, witness, after=before)
    rate, u_rate = slope(times_s, megabytes)
    tenth = max(1, len(megabytes) // 10)
    tenths = [sum(megabytes[i : i + tenth]) / tenth for i in range(0, 10 * tenth, tenth)]
    return LossesSoakResult(
        seconds, warm_up_s, {fault.name: fault.times for fault in faults}, witness, verdict, tenths, rate * 3600,
        u_rate * 3600, (descriptors[0], descriptors[-1]), exit_code, errors,
    )  # fmt: skip


@contextlib.contextmanager
def _world(
    folder: Path, disk: Path, *, own_disk: bool
) -> Iterator[tuple[SimulatedLightBox, DaemonProcess, list[Fault], Broker]]:
    """Serve camera, box and broker, and the daemon on all of them."""
    simulated, wire = write_benches(folder)
    camera = daemon_loss.WireCamera(folder, bench=simulated, serial=SERIAL)
    broker, twin = Broker(folder), SimulatedLightBox()
    box = PtyServer(WiredLightBox(twin), link=folder / "box")
    full = FullDisk(disk, own=own_disk)
    daemon = DaemonProcess(
        disk, "--every", "0.5", "--calibration", str(_CALIBRATION), "--box", str(folder / "box"),
        "--mqtt", f"127.0.0.1:{broker.port}", bench=wire,
    )  # fmt: skip
    try:
        camera.plug()
        broker.start()
        box.start()
        with daemon:
            daemon.wait_for_reading(60.0)
            daemon.post("/patches", {"name": "dim", "patch": PATCHES["dim"][0]})
            yield (
                twin,
                daemon,
                [
                    Fault("camera", camera.unplug, camera.plug, 25.0),
                    Fault("light box", box.unplug, box.plug, 15.0),
                    Fault("broker", broker.kill, broker.start, 25.0),
                    Fault("disk", full.take, full.give, 20.0),
                ],
                broker,
            )
            full.give()
    finally:
        camera.unplug()
        broker.kill()
        box.stop()


def _users(daemon: DaemonProcess, witness: Witness, twin: SimulatedLightBox) -> list[clients.Client]:
    works: list[tuple[str, Callable[[], None], float]] = [
        *((f"fetching {n}", clients.fetching(daemon, witness), 0.5) for n in range(8)),
        ("measuring dim", clients.measuring(daemon, witness, "dim"), 3.0),
        ("measuring mid", clients.measuring(daemon, witness, "mid"), 3.7),
        ("posting mid", clients.posting(daemon, witness, "mid"), 5.0),
        ("looking", clients.looking(daemon, witness), 5.0),
        ("listening", clients.listening(daemon, witness), 0.2),
        ("lighting", clients.lighting(daemon, witness, twin), 1.0),
    ]
    return [clients.Client(name, work, witness, pause_s) for name, work, pause_s in works]


def _wait_until_well(daemon: DaemonProcess) -> None:
    """Return once all is back and measuring goes on. Raises RuntimeError if it never does."""
    give_up = time.monotonic() + 120
    while time.monotonic() < give_up:
        with contextlib.suppress(OSError):
            status = daemon.get("/status")
            if not [alarm for alarm in status["alarms"] if not alarm["name"].startswith("light ")]:
                return
        time.sleep(0.5)
    raise RuntimeError(f"not well again: {status['alarms']}")


def _log_progress(daemon: DaemonProcess, witness: Witness, faults: list[Fault]) -> None:
    begun = time.monotonic()
    while daemon.process is not None and daemon.process.poll() is None:
        losses = ", ".join(f"{fault.name} {fault.times}" for fault in faults)
        with contextlib.suppress(OSError):
            print(
                f"{time.monotonic() - begun:6.0f} s: {daemon.resident_bytes() / 1e6:.1f} MB,"
                f" {daemon.descriptors()} descriptors, {len(witness.seen)} readings seen, {losses};"
                f" false {witness.counts['false']} {witness.false[:3]}",
                flush=True,
            )
        time.sleep(60.0)


def table(result: LossesSoakResult) -> str:
    """Return what was seen as Markdown."""
    verdict, witness = result.verdict, result.witness
    answered = sum(n for what, n in witness.counts.items() if what != "false" and "refused" not in what)
    refused = sum(n for what, n in witness.counts.items() if "refused" in what or "broken" in what)
    false = witness.counts["false"] + verdict.false_rows
    memory = ", ".join(f"{value:.1f}" for value in result.memory_mb)
    losses = ", ".join(f"{name} {times}" for name, times in result.losses.items())
    return (
        "| time | losses | readings in the journal | seen by clients | seen but missing | holes | not heard by the"
        " stream | answers compared with the scene | refused meanwhile | false values |\n"
        "|---|---|---|---|---|---|---|---|---|---|\n"
        f"| {result.seconds:.0f} s | {losses} | {verdict.readings} | {verdict.seen} | {verdict.missing} |"
        f" {verdict.holes} | {verdict.unheard} | {answered} | {refused} | {false} |\n\n"
        f"Memory: slope {result.slope_mb_per_h:+.2f} ± {result.u_slope_mb_per_h:.2f} MB/h (k=1) after"
        f" {result.warm_up_s:.0f} s; means of ten parts in MB: {memory}. File descriptors {result.descriptors[0]} →"
        f" {result.descriptors[1]}; unexpected errors logged: {len(result.errors_logged)}. Alarms:"
        f" {', '.join(f'{name} {count}' for name, count in sorted(verdict.alarms.items()))}.\n"
    )


def main() -> None:
    note = machine_note()
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    result = run(seconds, every_s=min(EVERY_S, seconds / 4), warm_up_s=min(600.0, seconds / 4))
    body = note + (
        "Camera, box, broker and disk fail at random moments for up to 25 s. Clients of three patches compare every"
        " answer with the radiance of their patch. The journal holds two days before.\n\n" + table(result)
    )
    print(body)
    print(result.witness.counts, result.witness.false, result.errors_logged, result.exit_code, sep="\n")
    write_section("daemon-losses-soak", "Daemon soak with losses", "make soak", body)


if __name__ == "__main__":
    main()

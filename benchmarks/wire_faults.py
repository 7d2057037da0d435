"""Packets lost on the wire, and a camera killed in mid-bracket: nothing damaged, nothing half-written."""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks._sections import write_section
from drivers.cameras.aravis_camera import open_camera
from radiometer.devices import CameraSettings, Roi
from testing.wire import LOOPBACK, ROOT, radiometer, served

LOSSY_FRAMES, LOSSY_PER_MILLE = 300, 10


def ramp_is_whole(dn: np.ndarray) -> bool:
    """Tell whether a frame of Aravis's fake is its diagonal ramp everywhere: neighbours differ by the same step."""
    step_x, step_y = dn[:, 1:].astype(int) - dn[:, :-1], dn[1:].astype(int) - dn[:-1]
    falls = min(int(step_x.min()), int(step_y.min()))
    fits = (step_x >= 0) & (step_x <= 2) | (step_x == falls)
    return bool(fits.all() and ((step_y >= 0) & (step_y <= 2) | (step_y == falls)).all())


def lossy(roi: Roi | None) -> str:
    command = ["arv-fake-gv-camera-0.8", "-i", LOOPBACK, "-s", "LOSSY", "-r", str(LOSSY_PER_MILLE)]
    with served(command), open_camera(LOOPBACK) as camera:
        camera.configure(CameraSettings(0.01, pixel_format="Mono8", roi=roi))
        start = time.perf_counter()
        frames = camera.capture(LOSSY_FRAMES)
        elapsed_s = time.perf_counter() - start
        counts = camera.counts
    whole = sum(ramp_is_whole(frame.dn) for frame in frames)
    height, width = frames[0].shape
    if whole != LOSSY_FRAMES:
        raise SystemExit(f"{LOSSY_FRAMES - whole} damaged frames were passed on")
    return (
        f"| {width} × {height} | {len(frames)} | {counts.incomplete} | {counts.missing_packets} | "
        f"{len(frames) - whole} | {1e3 * elapsed_s / len(frames):.0f} ms |"
    )


def killed(folder: Path) -> str:
    out = folder / "capture"
    ladder = ["--stops", "0.25", "--from", "1ms", "--to", "100ms"]
    with served(radiometer("simulate", "camera", "--fast", "--serial", "KILLED")) as camera:
        bracket = subprocess.Popen(
            radiometer("bracket", str(out), "--camera", LOOPBACK, *ladder), cwd=ROOT, stderr=subprocess.PIPE, text=True
        )
        time.sleep(4)
        running = bracket.poll() is None
        camera.kill()
        start = time.perf_counter()
        _, output = bracket.communicate(timeout=60)
        took_s = time.perf_counter() - start
    left = sorted(path.name for path in folder.iterdir())
    with served(radiometer("simulate", "camera", "--fast", "--serial", "KILLED")):
        again = subprocess.run(
            radiometer("bracket", str(out), "--camera", LOOPBACK), cwd=ROOT, capture_output=True, text=True, check=False
        )
    if not running or bracket.returncode != 1 or left or again.returncode:
        raise SystemExit(f"killed in mid-bracket: {running=} {bracket.returncode=} {left=} {again.stderr}")
    return (
        f"Killed 4 s into a bracket of 28 exposures: exit code {bracket.returncode} after {took_s:.1f} s with\n\n"
        f"    {output.strip().splitlines()[-1]}\n\n"
        f"and nothing left in the folder; the next `radiometer bracket` to the same place works."
    )


def main() -> None:
    rows = [lossy(Roi(0, 0, 512, 512)), lossy(None)]
    with tempfile.TemporaryDirectory() as folder:
        death = killed(Path(folder))
    body = (
        f"`arv-fake-gv-camera-0.8 -r {LOSSY_PER_MILLE}` loses {LOSSY_PER_MILLE} of a thousand packets and knows no "
        "resending: frames are retried until they come whole. Its ramp is checked pixel by pixel.\n\n"
        "| frame | asked for | came incomplete, retried | packets missing | damaged ones passed on | time per frame |\n"
        "|---|---|---|---|---|---|\n" + "\n".join(rows) + f"\n\n{death}"
    )
    print(body)
    write_section("wire_faults", "Lost packets and a camera that dies", "python -m benchmarks wire_faults", body)


if __name__ == "__main__":
    main()

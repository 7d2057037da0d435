"""1,000 consecutive full frames of the simulated Blackfly over GigE Vision, next to Aravis's own camera test."""

from __future__ import annotations

import itertools
import re
import subprocess
import time

import numpy as np

from benchmarks._sections import write_section
from drivers.cameras.aravis_camera import open_camera
from radiometer.devices import CameraSettings
from testing.wire import LOOPBACK, radiometer, served

FRAMES, POOL = 1000, 4
PEER_SECONDS = 10
FEATURES = "ExposureAuto=Off GammaEnable=false SharpeningEnable=false PixelFormat=Mono12 Width=1616 Height=1240"


def ours() -> dict[str, float]:
    with open_camera(LOOPBACK) as camera:
        camera.configure(CameraSettings(0.01, black_level_dn=64, pixel_format="Mono12"))
        stream = camera.stream()
        ids, arrived, shapes, means = [], [time.perf_counter()], set(), []
        for frame in itertools.islice(stream, FRAMES):
            arrived.append(time.perf_counter())
            ids.append(frame.frame_id)
            shapes.add((frame.shape, frame.bit_depth))
            if len(ids) % 50 == 0:
                means.append(float(frame.dn.mean()))
        stream.close()
        counts = camera.counts
    steps = np.diff(ids) % 65535
    intervals = np.diff(arrived)[1:]
    return {
        "frames": len(ids),
        "gaps": int(np.sum(steps - 1)),
        "counted": counts.extra["missed_frames"],
        "incomplete": counts.incomplete,
        "sizes": len(shapes),
        "spread": max(means) - min(means),
        "mean_ms": 1e3 * float(intervals.mean()),
        "p99_ms": 1e3 * float(np.percentile(intervals, 99)),
    }


def peer() -> float:
    """Return the time per frame in ms of arv-camera-test, its first second left out."""
    command = ["arv-camera-test-0.8", "-n", LOOPBACK, "-i", "60000", "-a", "--features", FEATURES]
    done = subprocess.run(
        [*command, "--duration", str(PEER_SECONDS)], capture_output=True, text=True, timeout=60, check=True
    )
    rates = [float(rate) for rate in re.findall(r"([\d.e+]+) frames/s", done.stdout)]
    return 1e3 / float(np.mean(rates[1:]))


def main() -> None:
    with served(radiometer("simulate", "camera", "--fast", "--frame-pool", str(POOL))):
        first, found = peer(), ours()
        theirs = 0.5 * (first + peer())
    if found["gaps"] != found["counted"] + found["incomplete"] or found["sizes"] != 1:
        raise SystemExit(f"frames were lost unnoticed: {found}")
    body = (
        f"The camera ({POOL} frames of the forward model, served repeatedly) runs in a separate process on loopback, "
        "as fast as both ends can; 1616 × 1240 Mono12, 4.0 MB a frame.\n\n"
        "| | time per frame | frames | gaps in the numbers | counted as missed | as incomplete |\n"
        "|---|---|---|---|---|---|\n"
        f"| radiometer, unpacked to a `Frame` | {found['mean_ms']:.2f} ms (99 %: {found['p99_ms']:.2f} ms) "
        f"| {found['frames']} | {found['gaps']} | {found['counted']} | {found['incomplete']} |\n"
        f"| `arv-camera-test-0.8`, buffers handed back unread | {theirs:.2f} ms | | | | |\n\n"
        "Every gap in the camera's running numbers is accounted for as missed or incomplete. The real camera sends a "
        f"frame every 7.6 ms at most. Means of every 50th frame are within {found['spread']:.2f} DN."
    )
    print(body)
    write_section("wire_frames", "1,000 full frames over GigE Vision", "python -m benchmarks wire_frames", body)


if __name__ == "__main__":
    main()

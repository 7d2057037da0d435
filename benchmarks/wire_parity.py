"""The same scene measured in process and over the wire, through the command line."""

from __future__ import annotations

import json
import math
import subprocess
import tempfile
from pathlib import Path

from benchmarks._sections import write_section
from testing.wire import LOOPBACK, ROOT, radiometer, served

PATCHES = {
    "white": "240,240,120,120",
    "light": "540,240,120,120",
    "middle": "840,240,120,120",
    "dim": "1140,240,120,120",
    "dark": "240,740,120,120",
    "darker": "540,740,120,120",
    "darkest": "840,740,120,120",
}


def reading(camera: str, patch: str) -> tuple[float, float]:
    command = radiometer("measure", "--camera", camera, "--patch", patch, "--json")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    radiance = json.loads(done.stdout)["radiance"]
    return radiance["value"], radiance["u"]


def response(folder: Path) -> str:
    capture, curve = folder / "capture", folder / "curve.csv"
    subprocess.run(radiometer("bracket", str(capture), "--camera", LOOPBACK), cwd=ROOT, capture_output=True, check=True)
    done = subprocess.run(
        radiometer("response", str(capture), "-o", str(curve)), cwd=ROOT, capture_output=True, text=True, check=True
    )
    rows = len(curve.read_text(encoding="utf-8").splitlines()) - 1
    return f"`radiometer response` takes it and writes {rows} values: " + "; ".join(
        " ".join(line.split()) for line in done.stdout.splitlines()[1:3]
    )


def main() -> None:
    rows, worst = [], 0.0
    with served(radiometer("simulate", "camera", "--fast", "--seed", "2")), tempfile.TemporaryDirectory() as folder:
        for name, patch in PATCHES.items():
            (near, u_near), (far, u_far) = reading("sim", patch), reading(LOOPBACK, patch)
            distance = abs(far - near) / math.hypot(u_near, u_far)
            worst = max(worst, distance)
            rows.append(
                f"| {name} | {near:.6f} ± {u_near:.6f} | {far:.6f} ± {u_far:.6f} | {distance:.2f} "
                f"| {far / near - 1:+.1e} |"
            )
        accepted = response(Path(folder))
    if worst > 2:
        raise SystemExit("the wire gives another radiance than the simulator:\n" + "\n".join(rows))
    body = (
        "`radiometer measure` on the simulated bench, other noise on the wire (seed 2); W·sr⁻¹·m⁻², k = 1. "
        "Both share the calibration, so the last column is the sharper test.\n\n"
        "| patch | in process | over the wire | distance / combined u | relative difference |\n"
        "|---|---|---|---|---|\n"
        + "\n".join(rows)
        + f"\n\n`radiometer bracket` over the wire writes a capture set. {accepted}"
    )
    print(body)
    write_section("wire_parity", "The same radiance over the wire", "python -m benchmarks wire_parity", body)


if __name__ == "__main__":
    main()

"""How long `radiometer reconcile` takes: many small frames, and frames of two million pixels.

    python -m benchmarks.reconcile_speed [--small 12] [--large 3]

The command runs as a user starts it, in a process of its own, on sessions of the independent generator on disk; two
threads at most are at work. Processor time is what counts on a machine that others use too.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._sections import write_section
from testing.generator.rig import Rig
from testing.generator.session import Session, make_session

HIDDEN = (
    (), ("exposure_time_offset",), ("veiling_glare",), ("dark_current",), ("gain_step_error",), ("prnu",),
    ("source_warmup_drift",), ("brighter_fatter",), ("fnumber_tstop_error",), ("led_thermal_droop",),
    ("response_nonlinearity",), ("psf_blur",),
)  # fmt: skip
LARGE = Rig(rows=1240, columns=1616, spacing_um=4.5)
FIRST_SEED = 7000


def time_session(session: Session, folder: Path) -> dict[str, Any]:
    """Return wall and processor time in s, peak memory in MB and verdict of the command on a session."""
    session.write(folder)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    begun = time.perf_counter()
    command = [sys.executable, "-m", "radiometer", "reconcile", str(folder), "--json"]
    with tempfile.TemporaryFile() as out, subprocess.Popen(command, stdout=out, env=environment) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall = time.perf_counter() - begun
        out.seek(0)
        answer = json.loads(out.read()) if process.returncode == 0 else {"verdict": "failed", "effects": []}
    return {
        "wall": wall,
        "cpu": usage.ru_utime + usage.ru_stime,
        "memory": usage.ru_maxrss / 1024,
        "frames": len(session.header.frames),
        "answer": " + ".join([answer["verdict"], *(effect["name"] for effect in answer["effects"])]),
    }


def timed(count: int, plan: str, rig: Rig) -> list[dict[str, Any]]:
    """Return the figures of so many sessions, each hiding something else."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for number, names in enumerate(HIDDEN[:count]):
            session = make_session(*names, camera_seed=FIRST_SEED + number, plan=plan, rig=rig)
            place = Path(folder) / f"{number:02d}"
            found.append({"hidden": " + ".join(names) or "nothing"} | time_session(session, place))
            print(found[-1], flush=True)
            shutil.rmtree(place)
    return found


def page(title: str, rows: list[dict[str, Any]]) -> str:
    """Return a table of the runs with their medians in Markdown."""
    lines = [f"**{title}**", "", "| hidden | wall | processor | peak memory | answer |", "|---|---|---|---|---|"]
    lines += [
        f"| {r['hidden']} | {r['wall']:.1f} s | {r['cpu']:.1f} s | {r['memory']:.0f} MB | {r['answer']} |" for r in rows
    ]
    wall, cpu = (np.median([r[k] for r in rows]) for k in ("wall", "cpu"))
    worst = max(r["cpu"] for r in rows)
    return "\n".join([*lines, "", f"Median {wall:.1f} s, of processor time {cpu:.1f} s; longest {worst:.1f} s."])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--small", type=int, default=len(HIDDEN), help="sessions of small frames")
    parser.add_argument("--large", type=int, default=3, help="sessions of 2-Mpixel frames")
    options = parser.parse_args()
    load = os.getloadavg()[0]
    small, large = timed(options.small, "rich", Rig()), timed(options.large, "short", LARGE)
    body = "\n\n".join(
        [
            f"The command with `--json`, start-up and reading included; load average {load:.0f} at first.",
            page(
                f"{small[0]['frames'] // 4} settings × 4 frames of 144 × 96 pixels (required: median under 10 s)", small
            ),
            page(f"{large[0]['frames']} frames of 1616 × 1240 pixels (required: under 60 s)", large),
        ]
    )
    print(body)
    command = f"python -m benchmarks.reconcile_speed --small {options.small} --large {options.large}"
    write_section("reconcile_speed", "Reconcile: time", command, body)


if __name__ == "__main__":
    main()

"""Archives: cost against size, a cluster against one process, a worker killed, a planted drift found.

`python -m benchmarks archive_scaling`
"""

from __future__ import annotations

import datetime as dt
import multiprocessing
import os
import resource
import signal
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._sections import write_section
from radiometer.archive.jobs import JobSettings
from radiometer.archive.run import run_batch
from radiometer.archive.sessions import find_captures
from radiometer.archive.trend import read_histories
from radiometer.data import (
    CameraDescription,
    CaptureSetWriter,
    Frame,
    FrameSettings,
    LensDescription,
    PatchDescription,
)

CAMERA = CameraDescription(
    bit_depth=12, conversion_gain_e_per_dn=2.6, read_noise_e=2.4, full_well_e=10500, black_level_dn=64
)
SIZE = 640
SPAWN = multiprocessing.get_context("spawn")  # a fork would copy the threads' locks of the libraries
MEASURE = JobSettings("measure")


def write_archive(root: Path, count: int, per_month: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    patch = PatchDescription(name="white", x=8, y=8, width=SIZE - 16, height=SIZE - 16)
    start = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)
    for day in range(count):
        level = (1.0 + per_month * day / 30.436875) * (1 + 0.002 * rng.standard_normal())
        extra: dict[str, object] = {"created": (start + dt.timedelta(days=day)).isoformat()}
        folder = root / f"day-{day:04d}"
        with CaptureSetWriter(folder, CAMERA, LensDescription(f_number=4.0), patches=(patch,), extra=extra) as writer:
            for exposure_s in (0.005, 0.01, 0.02):
                mean_e = 200_000 * level * exposure_s
                electrons = rng.normal(mean_e, np.sqrt(mean_e + 2.4**2), (SIZE, SIZE))
                dn = np.clip(np.rint(electrons / 2.6 + 64), 0, 4095).astype(np.uint16)
                writer.add(Frame(dn, 12, FrameSettings(exposure_s, f_number=4.0, black_level_dn=64.0)))


def timed(root: Path, table: Path, **more: object) -> float:
    begun = time.perf_counter()
    summary = run_batch(find_captures(str(root))[0], MEASURE, table, **more)
    assert not summary.failures, summary.failures[:1]
    return time.perf_counter() - begun


def cost_against_size(folder: Path) -> str:
    rows = ["| captures | time (s) | per capture (ms) | peak memory (MB) |", "|---:|---:|---:|---:|"]
    for count in (50, 100, 200, 400):
        root = folder / f"size-{count}"
        write_archive(root, count, 0.0, seed=count)
        seconds = timed(root, folder / f"{count}.parquet")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rows.append(f"| {count} | {seconds:.2f} | {1000 * seconds / count:.1f} | {peak:.0f} |")
    return "\n".join(rows)


def side_by_side(root: Path, folder: Path) -> float:
    """Return the time of two processes without a cluster, each with half of the archive, at the same time."""
    start = SPAWN.Barrier(2)
    answers = SPAWN.SimpleQueue()
    halves = [SPAWN.Process(target=_half, args=(root, half, folder, start, answers)) for half in (0, 1)]
    for process in halves:
        process.start()
    for process in halves:
        process.join()
    return max(answers.get() for _ in halves)


def _half(root: Path, half: int, folder: Path, start: Any, answers: Any) -> None:
    captures = find_captures(str(root))[0][half::2]
    run_batch(captures[:5], MEASURE, folder / f"warm-{half}.parquet")
    start.wait()
    begun = time.perf_counter()
    run_batch(captures, MEASURE, folder / f"half-{half}.parquet")
    answers.put(time.perf_counter() - begun)


def on_a_cluster(folder: Path) -> str:
    import pandas as pd
    from distributed import Client, LocalCluster

    root = folder / "cluster"
    write_archive(root, 500, 0.002, seed=7)
    alone = timed(root, folder / "one.parquet")
    options = {"threads_per_worker": 1, "dashboard_address": None, "host": "127.0.0.1"}
    with LocalCluster(n_workers=2, **options) as cluster, Client(cluster) as client:
        client.wait_for_workers(2)
        timed(folder / "size-50", folder / "warm.parquet", scheduler=cluster.scheduler_address)
        together = timed(root, folder / "two.parquet", scheduler=cluster.scheduler_address)
    shares = side_by_side(root, folder)
    one, two = pd.read_parquet(folder / "one.parquet"), pd.read_parquet(folder / "two.parquet")
    with LocalCluster(n_workers=2, **options) as cluster:
        killed = kill_in_the_middle(root, folder / "killed.parquet", cluster)
    lost = len(one) - len(killed)
    doubled = int(killed.duplicated(["capture", "patch", "quantity"]).sum())
    return (
        f"Capture sets of 3 frames of {SIZE} × {SIZE} pixels, evaluated as an archive. Two workers of a cluster do "
        f"{250 / together:.1f} sets per second, two separate processes {250 / shares:.1f}, and one process alone "
        f"{500 / alone:.1f}.\n\nTables equal bit for bit: {one.equals(two)}. One worker killed in the middle: "
        f"{lost} rows lost, {doubled} doubled, equal: {one.equals(killed)}."
    )


def kill_in_the_middle(root: Path, table: Path, cluster: Any) -> Any:
    import pandas as pd

    victim = next(iter(cluster.workers.values())).process.pid
    middle = threading.Event()
    killer = threading.Thread(target=lambda: (middle.wait(600), os.kill(victim, signal.SIGKILL)))
    killer.start()
    timed(
        root,
        table,
        scheduler=cluster.scheduler_address,
        progress=lambda done, *_: middle.set() if done >= 250 else None,
    )
    killer.join()
    return pd.read_parquet(table)


def drift(folder: Path) -> str:
    found = read_histories(folder / "one.parquet", "radiance")[0]
    none = read_histories(folder / "400.parquet", "radiance")[0]
    planted = 0.2 / (1 + 0.002 * 500 / 30.436875 / 2)
    return (
        f"Planted drift: {planted:.4f} %/month of the middle level. Found: {100 * found.drift_per_month:.4f} ± "
        f"{200 * found.u_drift_per_month:.4f} %/month (k = 2), claimed: {found.drifts}. Without a drift: "
        f"{100 * none.drift_per_month:+.4f} ± {200 * none.u_drift_per_month:.4f} %/month, claimed: {none.drifts}."
    )


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        body = "\n\n".join([cost_against_size(folder), on_a_cluster(folder), drift(folder)])
    print(body)
    write_section("archive", "Archives", "python -m benchmarks archive_scaling", body)


if __name__ == "__main__":
    main()

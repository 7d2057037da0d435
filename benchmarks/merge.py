"""Merging: speed and OpenCV's MergeDebevec, memory while streaming, and the statistics of value and uncertainty."""

from __future__ import annotations

import os
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks._sections import write_section
from radiometer.analysis.merge.bracket import StreamingMerge, merge
from radiometer.analysis.signal.lens import lens_factor_sr
from radiometer.compiled import compiled, compiled_apart
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    Frame,
    FrameSettings,
    LensDescription,
    ResponseCurve,
    Scale,
    SensorNoise,
    StatedUncertainties,
)
from radiometer.data.setup import Setup

HEIGHT, WIDTH, FRAMES = 1240, 1616, 16
_TURNS, _LOOKED_UP_AT_ONCE = 25, 1024
GAIN_E_PER_DN, READ_E, BLACK_DN, FULL_WELL_E = 2.6, 2.4, 64.0, 10_500.0
CAMERA = CameraDescription(
    bit_depth=12,
    conversion_gain_e_per_dn=GAIN_E_PER_DN,
    read_noise_e=READ_E,
    full_well_e=FULL_WELL_E,
    dark_current_e_per_s=0.0,
    black_level_dn=BLACK_DN,
)
LENS = LensDescription(f_number=4.0)
EXPOSURES_S = 20e-6 * 2.0 ** np.arange(FRAMES)
CALIBRATION = Calibration(
    camera=CAMERA,
    lens=LENS,
    scale=Scale(value=1.0, u_rel=0.0, method="known_radiance", f_number=4.0),
    response=None,
    noise=SensorNoise.of(CAMERA),
    black_level=BlackLevel(dn=BLACK_DN, u_dn=0.0, dark_u_rel=0.0),
    uncertainties=StatedUncertainties(exposure_u_rel=0.0, linearity_u_rel=0.0),
)
with np.errstate(divide="ignore"):
    SQUARE = ResponseCurve(2.0 * np.log(np.arange(256) / 255.0), np.full(256, 0.003), absolute=True, valid_dn=(1, 254))
CURVED = replace(
    CALIBRATION, camera=CameraDescription(bit_depth=8), response=SQUARE, black_level=BlackLevel(dn=0.0, u_dn=0.0)
)
BRIGHTEST_E_PER_S = 0.8 * (4095 - BLACK_DN) * GAIN_E_PER_DN / EXPOSURES_S[0]


def frames_of(electrons_per_s: NDArray[np.float64], rng: np.random.Generator) -> list[Frame]:
    frames = []
    for exposure_s in EXPOSURES_S:
        electrons = np.minimum(rng.poisson(electrons_per_s * exposure_s), FULL_WELL_E)
        dn = (electrons + rng.normal(0.0, READ_E, electrons.shape)) / GAIN_E_PER_DN + BLACK_DN
        stored = np.clip(np.rint(dn), 0, 4095).astype(np.uint16)
        frames.append(Frame(stored, 12, FrameSettings(float(exposure_s), f_number=4.0, black_level_dn=BLACK_DN)))
    return frames


def square_root(dn: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Return what a camera of 8 bits stores whose numbers scale with the root of the light."""
    light = np.clip((dn - BLACK_DN) / (4095.0 - BLACK_DN), 0.0, 1.0)
    return np.rint(255.0 * np.sqrt(light)).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class Spent:
    """Times of one work in s: median and least by the clock, median of the processor time of all threads."""

    wall_s: float
    least_wall_s: float
    cpu_s: float


def alternately(works: Sequence[Callable[[], object]], repeats: int = _TURNS) -> list[Spent]:
    """Return the times of each, run in turns so that load falls on all alike."""
    spent: list[list[tuple[float, float]]] = [[] for _ in works]
    for turn in range(repeats + 1):
        for work, times in zip(works, spent, strict=True):
            begun, begun_cpu = time.perf_counter(), time.process_time()
            work()
            if turn:  # the first turn fills caches
                times.append((time.perf_counter() - begun, time.process_time() - begun_cpu))
    return [
        Spent(
            float(np.median([w for w, _ in times])), min(w for w, _ in times), float(np.median([c for _, c in times]))
        )
        for times in spent
    ]


def speed_and_memory() -> list[str]:
    rng = np.random.default_rng(1)
    smooth = cv2.GaussianBlur(rng.normal(size=(HEIGHT, WIDTH)), (0, 0), 9)
    frames = frames_of(BRIGHTEST_E_PER_S * 10 ** (-4.5 * (smooth - smooth.min()) / np.ptp(smooth)), rng)
    bracket = Bracket.from_frames(frames)
    eight = [(frame.dn >> 4).astype(np.uint8) for frame in frames]
    behind_a_curve = Bracket.from_frames(
        [Frame(square_root(frame.dn), 8, FrameSettings(frame.settings.exposure_s, f_number=4.0)) for frame in frames]
    )
    response = np.maximum(np.arange(256, dtype=np.float32) - 4, 0.05).reshape(256, 1, 1)
    peer = cv2.createMergeDebevec()
    begun = time.perf_counter()
    merge(bracket, Setup(CAMERA, LENS, CALIBRATION))
    first = time.perf_counter() - begun
    least = indispensable(bracket)
    theirs, ours, streaming, curved, reading, summing, copying, *rest = alternately(
        [
            lambda: peer.process(eight, EXPOSURES_S.astype(np.float32), response),
            lambda: merge(bracket, Setup(CAMERA, LENS, CALIBRATION)),
            lambda: merge(iter(frames), Setup(CAMERA, LENS, CALIBRATION)),
            lambda: merge(behind_a_curve, Setup(CURVED.camera, CURVED.lens, CURVED)),
            lambda: [int(frame.dn.max()) for frame in frames],
            lambda: [int(frame.dn.sum()) for frame in frames],
            lambda: [frame.dn.copy() for frame in frames],
            *least.values(),
        ]
    )
    named = {
        "OpenCV `MergeDebevec`, 8 bit, value only": theirs,
        "`merge` of a bracket, 12 bit, value + uncertainty + mask": ours,
        "`merge` of a stream, the same": streaming,
        "`merge` of a bracket, 8 bit, behind a curve": curved,
        "reading the frames once from memory: their largest numbers": reading,
        "reading the frames once from memory: their sums": summing,
        "copying the frames once": copying,
        **dict(zip(least, rest, strict=True)),
    }
    rows = [
        f"| {name} | {1e3 * one.wall_s:.0f} ms | {1e3 * one.least_wall_s:.0f} ms | {theirs.wall_s / one.wall_s:.1f} × "
        f"| {1e3 * one.cpu_s:.1f} ms | {theirs.cpu_s / one.cpu_s:.1f} × |"
        for name, one in named.items()
    ]
    compiled_read, looked_up, _, touched = rest
    floor = compiled_read.cpu_s + looked_up.cpu_s + touched.cpu_s
    against = {
        "as looking for their largest numbers": reading,
        "as summing them in compiled code": compiled_read,
        "as summing them by numpy": summing,
        "as copying them": copying,
    }
    return [
        f"{FRAMES} frames of {WIDTH} × {HEIGHT}, {_TURNS} runs, taken in turns: median time, least time, median of the "
        "processor time of all threads. Speed-up and saving are the ratios of OpenCV's median time and processor time "
        "to those of the row.",
        "",
        "| | time | least | speed-up | processor time | saving |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        "By processor time (in brackets: least time of two threads over that of one) merging a bracket takes "
        + ", ".join(
            f"{ours.cpu_s / one.cpu_s:.1f} times ({ours.least_wall_s / one.least_wall_s:.1f}) as long {name}"
            for name, one in against.items()
        )
        + f". Reading, looking up and the first touch of the result, without arithmetic, take {1e3 * floor:.1f} ms "
        f"of {1e3 * ours.cpu_s:.1f}. Load average at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores.",
        f"The first call of a process takes {first:.2f} s: it loads the compiled loops, or compiles them.",
        f"Streaming needs {peak_planes():.2f} frames of float32 beyond the result.",
    ]


@compiled
def read_once(numbers: Any) -> int:  # pragma: no cover (compiled)
    """Return the sum of 16-bit numbers: the plainest loop over a frame."""
    total = np.uint64(0)
    for i in range(numbers.size):
        total += numbers[i]
    return int(total)


@compiled_apart
def look_up(slots: Any, records: Any, found: Any) -> None:  # pragma: no cover (compiled)
    """Write the sum of the 14 numbers that the last step looks up of each pixel's set of frames, and nothing else."""
    for i in range(slots.size):
        k = slots[i]
        found[i] = (
            (records[k, 0] + records[k, 1] + records[k, 2] + records[k, 3] + records[k, 4])
            + (records[k, 5] + records[k, 6] + records[k, 7] + records[k, 8] + records[k, 9])
            + (records[k, 10] + records[k, 11] + records[k, 12] + records[k, 13])
        )


@compiled
def look_up_all(slots: Any, records: Any, found: Any) -> None:  # pragma: no cover (compiled)
    """Look up run by run, as the merge does: what is found stays in a core's nearest cache."""
    for start in range(0, slots.size, found.size):
        size = min(found.size, slots.size - start)
        look_up(slots[start : start + size], records, found[:size])


def indispensable(bracket: Bracket) -> dict[str, Callable[[], object]]:
    """Return what no merge of these sums goes without, each alone: reading, looking up, touching the result."""
    numbers = [frame.dn.ravel() for frame in bracket.light]
    used = sum((one < 4095).astype(np.uint64) << np.uint64(k) for k, one in enumerate(numbers))
    slots = np.unique(used, return_inverse=True)[1].astype(np.uint64)
    records, found = np.random.default_rng(3).random((256, 24)), np.empty(_LOOKED_UP_AT_ONCE)
    single = records.astype(np.float32), found.astype(np.float32)
    return {
        "reading the frames once from memory: a compiled sum": lambda: [read_once(one) for one in numbers],
        "looking up 14 numbers of each pixel's set of frames, double precision": lambda: look_up_all(
            slots, records, found
        ),
        "the same, single precision": lambda: look_up_all(slots, *single),
        "first touch of the result (9 bytes per pixel)": lambda: [
            np.empty(slots.size, kind).fill(0) for kind in (np.float32, np.float32, np.uint8)
        ],
    }


def peak_planes() -> float:
    numbers = np.full((HEIGHT, WIDTH), 500, np.uint16)
    tracemalloc.start()
    merging = StreamingMerge(Setup(CAMERA, LENS, CALIBRATION))
    for exposure_s in EXPOSURES_S:
        settings = FrameSettings(float(exposure_s), f_number=4.0, black_level_dn=BLACK_DN)
        merging.add(Frame(numbers.copy(), 12, settings))
    found = merging.result()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    result = found.radiance.nbytes + found.u_radiance.nbytes + found.mask.nbytes
    return (peak - result) / (4 * HEIGHT * WIDTH)


def bound(electrons_per_s: NDArray[np.float64]) -> NDArray[np.float64]:
    electrons = electrons_per_s[:, None] * EXPOSURES_S
    variance = electrons + READ_E**2 + GAIN_E_PER_DN**2 / 12.0
    used = electrons < min(0.97 * FULL_WELL_E, (4094.5 - BLACK_DN) * GAIN_E_PER_DN)
    return 1.0 / np.sum(np.where(used, EXPOSURES_S**2 / variance, 0.0), axis=1)


def statistics() -> list[str]:
    rows_of_pixels, columns = 300, 3000
    truth = np.geomspace(BRIGHTEST_E_PER_S, BRIGHTEST_E_PER_S * 1e-6, columns)
    found = merge(
        Bracket.from_frames(frames_of(np.tile(truth, (rows_of_pixels, 1)), np.random.default_rng(2))),
        Setup(CAMERA, LENS, CALIBRATION),
    )
    # The scale is per sr of the lens at its f-number.
    electrons = GAIN_E_PER_DN * lens_factor_sr(LENS, LENS.f_number)
    value = found.radiance.astype(float) * electrons
    u = found.u_radiance.astype(float) * electrons
    ratio = value.var(axis=0, ddof=1) / bound(truth)
    inside = np.abs(value - truth) < 2.0 * u
    bias = (value.mean(axis=0) - truth) / np.sqrt(bound(truth))
    table = ["", "| radiance / brightest | variance / bound | k = 2 covers | bias / sigma |", "|---|---|---|---|"]
    for part in np.split(np.arange(columns), 12):
        low, high = truth[part[-1]] / truth[0], truth[part[0]] / truth[0]
        table.append(
            f"| {low:.1e} to {high:.1e} | {ratio[part].mean():.3f} | {100 * inside[:, part].mean():.1f} % "
            f"| {bias[part].mean():+.3f} |"
        )
    return [
        "Variance of the merged value over the Cramér–Rao bound, and the coverage of the uncertainty map. "
        f"{rows_of_pixels * columns} pixels over six decades; {np.count_nonzero(found.mask & 16)} are inconsistent.",
        *table,
    ]


def main() -> None:
    body = "\n".join([*speed_and_memory(), "", *statistics()])
    print(body)
    write_section("merge", "Merging", "python -m benchmarks merge", body)


if __name__ == "__main__":
    main()

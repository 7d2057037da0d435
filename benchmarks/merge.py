"""Merging: speed beside OpenCV's MergeDebevec, memory while streaming, and the statistics of value and uncertainty."""

from __future__ import annotations

import os
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks._sections import write_section
from radiometer.analysis.merge.bracket import StreamingMerge, merge
from radiometer.analysis.signal.lens import lens_factor_sr
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

HEIGHT, WIDTH, FRAMES = 1240, 1616, 16
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
    """Return what a camera of 8 bits stores whose numbers go with the root of the light."""
    light = np.clip((dn - BLACK_DN) / (4095.0 - BLACK_DN), 0.0, 1.0)
    return np.rint(255.0 * np.sqrt(light)).astype(np.uint8)


def alternately(works: Sequence[Callable[[], object]], repeats: int = 9) -> list[tuple[float, float]]:
    """Return the median time and processor time in s of each, run in turns so that load falls on all alike."""
    spent: list[list[tuple[float, float]]] = [[] for _ in works]
    for turn in range(repeats + 1):
        for work, times in zip(works, spent, strict=True):
            begun, begun_cpu = time.perf_counter(), time.process_time()
            work()
            if turn:  # the first turn fills caches
                times.append((time.perf_counter() - begun, time.process_time() - begun_cpu))
    return [(float(np.median([w for w, _ in times])), float(np.median([c for _, c in times]))) for times in spent]


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
    merge(bracket, CAMERA, LENS, CALIBRATION)
    first = time.perf_counter() - begun
    theirs, ours, streaming, curved, reading, summing, copying = alternately(
        [
            lambda: peer.process(eight, EXPOSURES_S.astype(np.float32), response),
            lambda: merge(bracket, CAMERA, LENS, CALIBRATION),
            lambda: merge(iter(frames), CAMERA, LENS, CALIBRATION),
            lambda: merge(behind_a_curve, CURVED.camera, CURVED.lens, CURVED),
            lambda: [int(frame.dn.max()) for frame in frames],
            lambda: [int(frame.dn.sum()) for frame in frames],
            lambda: [frame.dn.copy() for frame in frames],
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
    }
    rows = [
        f"| {name} | {1e3 * wall:.0f} ms | {theirs[0] / wall:.1f} × | {1e3 * cpu:.0f} ms | {theirs[1] / cpu:.1f} × |"
        for name, (wall, cpu) in named.items()
    ]
    return [
        f"{FRAMES} frames of {WIDTH} × {HEIGHT}, median of 9 runs, taken in turns.",
        "",
        "| | time | faster | processor time | less |",
        "|---|---|---|---|---|",
        *rows,
        "",
        f"Merging takes {ours[0] / summing[0]:.1f} times as long as summing the frames once from memory (a stream "
        f"{streaming[0] / summing[0]:.1f} times; by processor time {ours[1] / summing[1]:.1f} and "
        f"{streaming[1] / summing[1]:.1f}), {ours[0] / reading[0]:.1f} times as long as looking for their largest "
        f"numbers ({ours[1] / reading[1]:.1f}), {ours[0] / copying[0]:.1f} times as long as copying them "
        f"({ours[1] / copying[1]:.1f}). Load average at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores.",
        f"The first call of a process takes {first:.2f} s (loading the compiled loops, or compiling them where they "
        "are not yet on disk).",
        f"Peak memory while streaming, beyond the result: {peak_planes():.2f} frames of float32, the frame in hand "
        "included.",
    ]


def peak_planes() -> float:
    numbers = np.full((HEIGHT, WIDTH), 500, np.uint16)
    tracemalloc.start()
    merging = StreamingMerge(CAMERA, LENS, CALIBRATION)
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
        CAMERA,
        LENS,
        CALIBRATION,
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
        "Variance of the merged value over the Cramér–Rao bound of the noise model, and what the uncertainty map "
        f"covers; {rows_of_pixels * columns} pixels over six decades, {np.count_nonzero(found.mask & 16)} of them "
        "called inconsistent.",
        *table,
    ]


def main() -> None:
    body = "\n".join([*speed_and_memory(), "", *statistics()])
    print(body)
    write_section("merge", "Merging", "python -m benchmarks merge", body)


if __name__ == "__main__":
    main()

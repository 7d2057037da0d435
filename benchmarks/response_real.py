"""Responses of real cameras and what others found: a peer's .rsp curve, and raw values of the same shots.

    python -m benchmarks response_real

Needs the real measurements in ../shared/data; says so and leaves where they are absent.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks._response_stacks import Array
from benchmarks._sections import write_section
from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.analysis.response.methods import METHODS
from radiometer.bench.sources import open_source
from radiometer.data import Bracket, Frame, FrameSettings

STACKS = Path(__file__).resolve().parents[2] / "shared" / "data" / "stacks"
CHANNELS = ("red", "green", "blue")
INNER = slice(13, 243)  # 5 to 95 % of 8 bits


def canon() -> str:
    folder = STACKS / "canon5d2_fisheye_calibrated" / "example"
    lines = (folder / "response_function_files" / "Response_function.rsp").read_text().splitlines()
    rows, times = [], []
    for channel, line in zip(CHANNELS, filter(str.strip, lines), strict=True):
        peer = np.log(np.polyval([float(word) for word in line.split()[1:]], np.arange(256) / 255.0)[INNER])
        brackets = open_source(folder / "JPEG", channel).brackets
        estimate = METHODS["auto"](brackets)
        times.append(100 * np.array(estimate.details["log_time_errors"]))
        g, u = estimate.curve.log_exposure[INNER], estimate.curve.u_log_exposure[INNER]
        gap = g - peer - np.mean(g - peer)
        rows.append(
            f"| {channel} | {100 * gap.std():.1f} % | {100 * np.abs(gap).max():.1f} % | {100 * np.median(u):.2f} % "
            f"| {residual(brackets[0], estimate, g_all(peer)):.3f} | {residual(brackets[0], estimate, None):.3f} |"
        )
    spread = np.ptp(np.array(times), axis=0)
    shortest = ", ".join(f"{value:.1f}" for value in np.array(times)[:, 0])
    return (
        "Canon EOS 5D Mark II, 18 JPEG files, next to the `.rsp` curve (hdrgen, order 4) of its owners.\n\n"
        "| channel | rms difference | largest | own u (median) | spread of ln E, peer curve | own curve |\n"
        "|---|---|---|---|---|---|\n" + "\n".join(rows) + "\n\n"
        "The last two columns are the rms scatter of ln E between the frames of one pixel (values 13 to 242). The peer "
        "has the stated exact stops, the own curve the fitted times.\n\n"
        f"The three colours, fitted apart, find the same errors of the stated exact stops to {np.median(spread):.1f} % "
        f"(median spread): 1/8192 s is longer by {shortest} % in red, green and blue."
    )


def g_all(inner: Array) -> Array:
    whole = np.full(256, np.nan)
    whole[INNER] = inner
    return whole


def residual(bracket: Bracket, estimate: ResponseEstimate, curve: Array | None) -> float:
    """Return the rms scatter of ln E between frames over a sample of the pixels."""
    times = np.log(bracket.effective_exposures_s)
    if curve is None:
        times = times + np.array(estimate.details["log_time_errors"])
        curve = g_all(estimate.curve.log_exposure[INNER])
    pixels = np.array([frame.dn[::37, ::37].ravel() for frame in bracket.light])
    log_radiance = curve[pixels] - times[:, None]
    enough = np.isfinite(log_radiance).sum(axis=0) >= 2
    chosen = log_radiance[:, enough]
    return float(np.sqrt(np.nanmean((chosen - np.nanmean(chosen, axis=0)) ** 2)))


def middlebury() -> str:
    rows = []
    for folder in sorted(path for path in (STACKS / "middlebury_jpg_raw_pairs").iterdir() if path.is_dir()):
        rows += [f"| {folder.name} | {row} |" for row in raw_prediction(folder)]
    return (
        "JPEG against raw of the same shots (Middlebury pairs), with curves from the JPEG files alone. Cameras mix "
        "colours before the tone curve, so a 3 × 3 mixture is fitted per illumination.\n\n"
        "| camera | raw channel | median error | rms | sRGB curve: median | no mixture: median |\n"
        "|---|---|---|---|---|---|\n" + "\n".join(rows)
    )


def raw_prediction(folder: Path) -> list[str]:
    shots = {(light, e): read_pair(folder, light, e) for light in (1, 2) for e in (1, 2, 3, 4)}
    curves = []
    for index in range(3):
        brackets = [
            Bracket.from_frames(
                [
                    Frame(np.ascontiguousarray(shots[light, e][0][..., index]), 8, FrameSettings(0.01 * 2.0**e))
                    for e in (1, 2, 3, 4)
                ],
                origin=folder.name,
            )
            for light in (1, 2)
        ]
        curves.append(np.exp(METHODS["auto"](brackets).curve.log_exposure))
    scaled = np.arange(256) / 255.0
    srgb = np.where(scaled <= 0.04045, scaled / 12.92, ((scaled + 0.055) / 1.055) ** 2.4)
    own = [mixture_errors(shots, curves, mix=True, raw_index=k) for k in range(3)]
    standard = [mixture_errors(shots, [srgb] * 3, mix=True, raw_index=k) for k in range(3)]
    alone = [mixture_errors(shots, curves, mix=False, raw_index=k) for k in range(3)]
    return [
        f"{CHANNELS[2 - k]} | {100 * np.median(np.abs(own[k])):.1f} % | {100 * np.sqrt(np.mean(own[k] ** 2)):.1f} % "
        f"| {100 * np.median(np.abs(standard[k])):.1f} % | {100 * np.median(np.abs(alone[k])):.1f} %"
        for k in (2, 1, 0)
    ]


def read_pair(folder: Path, light: int, e: int) -> tuple[Array, Array]:
    return tuple(cv2.imread(str(folder / f"wb1i{light}e{e}-{kind}.png")) for kind in ("jpg", "raw"))  # type: ignore[return-value]


def mixture_errors(
    shots: dict[tuple[int, int], tuple[Array, Array]], curves: list[Array], *, mix: bool, raw_index: int
) -> Array:
    """Return the relative errors of the predicted raw values of one channel."""
    errors = []
    for light in (1, 2):
        linear, raw = [], []
        for e in (1, 2, 3, 4):
            jpeg, values = shots[light, e]
            good = ((jpeg > 12) & (jpeg < 243)).all(axis=2) & ((values >= 16) & (values <= 240)).all(axis=2)
            linear.append(np.column_stack([curves[k][jpeg[..., k][good]] for k in range(3)]))
            raw.append(values[..., raw_index][good].astype(float))
        x, y = np.vstack(linear), np.concatenate(raw)
        x = x if mix else x[:, [raw_index]]
        factors = np.linalg.lstsq(x / y[:, None], np.ones(y.size), rcond=None)[0]
        errors.append(x @ factors / y - 1.0)
    return np.concatenate(errors)


def main() -> None:
    if not STACKS.is_dir():
        print("the real measurements (../shared/data/stacks) are not on this machine")
        return
    parts = [middlebury(), canon()]
    print("\n\n".join(parts))
    write_section(
        "response_real",
        "Responses of real cameras",
        "OMP_NUM_THREADS=1 python -m benchmarks response_real",
        "\n\n".join(reversed(parts)),
    )


if __name__ == "__main__":
    main()

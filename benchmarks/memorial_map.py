"""The map of the memorial church that came with its photographs, against ours, and what that file says of itself.

    python -m benchmarks memorial_map

Where longer frames decide a pixel's value, the file shows the exposure behind a digital number of a shorter frame;
where the longest frame alone decides, it shows what curve the file was made with. Both must be the same.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from benchmarks._photograph_sets import stacks_folder
from benchmarks._sections import write_section
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.response.curves import black_of_curve
from radiometer.bench.sources import open_source
from radiometer.data import Bracket, CameraDescription, Frame, LensDescription, RadianceMap, ResponseCurve
from radiometer.data.setup import Setup
from radiometer.photographs.response import recovered_curves, relative_calibration, with_found_times

Array = NDArray[np.float64]
# Digital numbers of film's toe that are looked at, and the one that they are found from.
_TOE_DN, _MIDDLE_DN = (40, 50), 128
# Frames of 1/4 to 2 s: frames up to 32 s decide the values of what they show dark.
_DECIDED_BY_OTHERS = slice(8, 12)
_CLEAR_OF_TOE_DN = 80
# Half width of a bin of digital numbers.
_HALF_BIN = 1
_FEWEST_PIXELS = 100
# Numbers that are predicted: 5 to 95 % of 8 bits.
_LEAST_DN, _MOST_DN = 13, 242


def maps(folder: Path) -> dict[str, tuple[Bracket, ResponseCurve, RadianceMap]]:
    """Return bracket, response and map by colour, nothing aligned: as the file's own frames lay."""
    brackets = open_source(folder, "each").brackets
    with tempfile.TemporaryDirectory() as neighbour:
        curves, _ = recovered_curves(brackets, Path(neighbour) / "map.exr", lambda _: None)
    camera, lens, found = CameraDescription(bit_depth=8), LensDescription(), {}
    for raw in brackets:
        channel = str(raw.light[0].extra["channel"])
        bracket = with_found_times(raw, curves[channel])
        known, displacement = relative_calibration(bracket, curves[channel], camera, lens)
        px = displacement.px if displacement else 0.0
        one = merge(bracket, Setup(camera, lens, known), without_ghosts=True, displacement_px=px)
        found[channel] = (bracket, curves[channel], one)
    return found


def of_file(bracket: Bracket, values: Array, frames: slice, dn: int) -> float:
    """Return ln of the exposure that the file gives a digital number in some frames: median of their pixels, or NaN."""
    logs = [
        np.log(values[shown] * frame.settings.exposure_s)
        for frame in bracket.light[frames]
        for shown in [(np.abs(frame.dn.astype(int) - dn) <= _HALF_BIN) & (values > 0)]
    ]
    every = np.concatenate(logs)
    return float(np.median(every)) if every.size >= _FEWEST_PIXELS else float("nan")


def predicted_dn(values: Array, frames: list[Frame], good: NDArray[np.bool_]) -> Array:
    """Return the mean size in DN of what a map leaves of the frames, by frame: NaN where none of its pixels count.

    A frame's numbers are predicted from value times exposure time through the rising curve that suits map and frames
    best (isotonic regression): what is judged is the map alone, not a program's curve.

    Args:
        values: The map.
        frames: The frames, whose times count as they are.
        good: Pixels of the map that count; of a frame those from `_LEAST_DN` to `_MOST_DN`.
    """
    dn = np.concatenate([frame.dn[good] for frame in frames]).astype(np.float64)
    exposure = np.concatenate([np.log(values[good] * frame.settings.exposure_s) for frame in frames])
    number = np.repeat(np.arange(len(frames)), np.count_nonzero(good))
    order = np.argsort(exposure)
    found = np.empty(dn.size)
    found[order] = isotonic_regression(dn[order]).x
    counts = (dn >= _LEAST_DN) & (dn <= _MOST_DN)
    return np.array(
        [
            np.mean(np.abs(found - dn)[of]) if np.count_nonzero(of) >= _FEWEST_PIXELS else np.nan
            for of in (counts & (number == k) for k in range(len(frames)))
        ]
    )


def of_unseen(bracket: Bracket, curve: ResponseCurve) -> tuple[RadianceMap, RadianceMap]:
    """Return the maps of the odd and of the even frames."""
    camera, lens, found = CameraDescription(bit_depth=8), LensDescription(), []
    for first in (0, 1):
        half = Bracket.from_frames(bracket.light[first::2], origin=bracket.origin)
        known, displacement = relative_calibration(half, curve, camera, lens)
        px = displacement.px if displacement else 0.0
        found.append(merge(half, Setup(camera, lens, known), without_ghosts=True, displacement_px=px))
    return found[0], found[1]


def prediction_row(channel: str, values: Array, bracket: Bracket, curve: ResponseCurve, ours: RadianceMap) -> str:
    """Return how well the file, our map, and our maps of half the frames predict frames; the halves the other half."""
    odd, even = of_unseen(bracket, curve)
    frames = list(bracket.light)
    good = (ours.mask == 0) & (odd.mask == 0) & (even.mask == 0) & (values > 0)
    toe = good & (bracket.light[-1].dn < _CLEAR_OF_TOE_DN)
    of_file, of_ours = (predicted_dn(one, frames, good) for one in (values, ours.radiance.astype(np.float64)))
    file_half, unseen = [], []
    for first, half in ((1, odd), (0, even)):
        others = frames[first::2]
        unseen.append(predicted_dn(half.radiance.astype(np.float64), others, good))
        file_half.append(predicted_dn(values, others, good))
    shown = [f"{np.nanmean(one):.2f}" for one in (of_file, of_ours, np.concatenate(file_half), np.concatenate(unseen))]
    longest = frames[-2:]
    if np.count_nonzero(toe) >= _FEWEST_PIXELS:
        at_toe = [predicted_dn(one, longest, toe) for one in (values, ours.radiance.astype(np.float64))]
        shown += [f"{np.nanmean(one):.2f}" for one in at_toe]
    else:
        shown += ["–", "–"]
    return f"| {channel} | {100 * np.mean(good):.0f} % | {' | '.join(shown)} |"


def rims(bracket: Bracket) -> NDArray[np.bool_]:
    """Return what a frame of the scans is filled with blue in, red as black: "invalid", says the README of the set.

    Args:
        bracket: Red.
    """
    found = np.zeros(bracket.shape, bool)
    for frame in bracket.light:
        _, label = cv2.connectedComponents((frame.dn == 0).astype(np.uint8))
        edges = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
        found |= np.isin(label, edges[edges > 0])
    return np.asarray(cv2.dilate(found.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def by_hat(bracket: Bracket, curve: ResponseCurve) -> Array:
    """Return ln of the map that our curve gives with Debevec and Malik's weights in place of ours; NaN where none."""
    total, weights = np.zeros(bracket.shape), np.zeros(bracket.shape)
    full_scale, black = bracket.light[0].full_scale_dn, black_of_curve(curve)
    for frame in bracket.light:
        dn = frame.dn.astype(np.float64)
        hat = np.maximum(np.minimum(dn - black, full_scale - dn), 0.0)
        total += hat * (curve.log_exposure[frame.dn] - np.log(frame.settings.exposure_s))
        weights += hat
    return np.where(weights > 0.0, total / np.maximum(weights, 1e-9), np.nan)


def _in_words(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "–"


def row(
    channel: str, values: Array, bracket: Bracket, curve: ResponseCurve, ours: RadianceMap, rim: NDArray[np.bool_]
) -> str:
    good = (ours.mask == 0) & (values > 0)
    gap = np.log(ours.radiance[good] / values[good])
    gap -= np.median(gap)
    clear = bracket.light[-1].dn[good] >= _CLEAR_OF_TOE_DN
    hat = by_hat(bracket, curve)[good] - np.log(values[good])
    hat, picture = hat[clear & np.isfinite(hat)], ~rim[good]
    inner = gap[clear] - np.median(gap[clear])
    most = np.sort(np.abs(inner))[: int(0.99 * inner.size)]
    middle = of_file(bracket, values, slice(8, None), _MIDDLE_DN)
    toe = [
        f"{_in_words(of_file(bracket, values, _DECIDED_BY_OTHERS, dn) - middle)}, "
        f"{_in_words(of_file(bracket, values, slice(-1, None), dn) - middle)}, "
        f"{curve.log_exposure[dn] - curve.log_exposure[_MIDDLE_DN]:.2f}"
        for dn in _TOE_DN
    ]
    figures = (np.std(gap), np.std(gap[picture]), np.mean(clear), np.std(inner), np.sqrt(np.mean(most**2)), np.std(hat))
    return (
        f"| {channel} | {figures[0]:.3f} | {figures[1]:.3f} | {100 * figures[2]:.0f} % | {figures[3]:.3f} "
        f"| {figures[4]:.3f} | {figures[5]:.3f} "
        f"| {' | '.join(toe)} |"
    )


def main() -> None:
    folder = stacks_folder()
    if folder is None:
        print("the real stacks (shared/data/stacks) are not on this machine")
        return
    place = folder / "memorial_film"
    file = cv2.imread(str(place / "memorial.hdr"), cv2.IMREAD_UNCHANGED)
    rows, predictions = [], []
    found = maps(place)
    rim = rims(found["red"][0])
    for channel, (bracket, curve, ours) in found.items():
        values = file[..., ("blue", "green", "red").index(channel)].astype(np.float64)
        rows.append(row(channel, values, bracket, curve, ours, rim))
        predictions.append(prediction_row(channel, values, bracket, curve, ours))
    toes = " | ".join(f"ln H at {dn} DN: shorter frames, longest, ours" for dn in _TOE_DN)
    body = (
        "Root mean square of ln (ours / memorial.hdr) over pixels without a flag, one factor free, nothing aligned. "
        "Rims are the borders without picture that the scans have. The share is of pixels where the frame of 32 s "
        f"shows {_CLEAR_OF_TOE_DN} DN or more. The next columns are for these pixels, for the 99 % of them that differ "
        "least, and with Debevec and Malik's weights (hat) in our map. The last columns have ln H of dark values less "
        f"that of {_MIDDLE_DN} DN, by shorter frames, by the longest frame itself, and by our curve.\n\n"
        f"| colour | rms ln | without rims | share | rms there | best 99 % | with hat weights | {toes} |\n"
        "|---|---|---|---|---|---|---|---|---|\n"
        + "\n".join(rows)
        + "\n\nMean error in DN with which a map predicts the photographs' numbers from "
        f"{_LEAST_DN} to {_MOST_DN}, through the rising curve that suits it best. By halves is the mean "
        "over odd and even frames; frames not seen are predicted by a map of the other half. The toe is the two "
        "longest frames "
        f"where 32 s shows less than {_CLEAR_OF_TOE_DN} DN.\n\n"
        "| colour | pixels | memorial.hdr | ours | memorial.hdr, by halves | ours, frames not seen "
        "| toe: memorial.hdr | ours |\n|---|---|---|---|---|---|---|---|\n" + "\n".join(predictions)
    )
    print(body)
    write_section(
        "memorial_map", "The memorial church's own map", "OMP_NUM_THREADS=1 python -m benchmarks memorial_map", body
    )


if __name__ == "__main__":
    main()

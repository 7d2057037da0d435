"""Maps of real photographs: the odd frames of a bracket against its even ones, each through the whole default chain."""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks._photograph_sets import stacks_folder
from benchmarks._sections import write_section
from radiometer.analysis.merge.bracket import merge
from radiometer.bench.sources import open_source
from radiometer.cli.main import run
from radiometer.data import Bracket, CameraDescription, LensDescription, RadianceMap
from radiometer.data.setup import Setup
from radiometer.photographs.response import recovered_curves, relative_calibration, with_found_times
from radiometer.photographs.scene import in_one_place

SETS = (
    ("memorial (film, 16 frames)", "memorial_film"),
    ("fisheye (5D Mark II, 18 frames)", "canon5d2_fisheye_calibrated/example/JPEG"),
)
_ENOUGH_PIXELS = 1_000_000
Array = NDArray[np.float64]


def half(bracket: Bracket, parity: int) -> Bracket:
    return replace(bracket, light=bracket.light[parity::2])


def halves(path: Path) -> tuple[dict[str, tuple[RadianceMap, RadianceMap]], str]:
    """Return the maps of odd and even frames by colour, each with a response of its own, and how the frames lay."""
    placed = in_one_place(open_source(path, "each", most_pixels=_ENOUGH_PIXELS).brackets, "auto")
    camera, lens, found = CameraDescription(bit_depth=8), LensDescription(), []
    for parity in (0, 1):
        with tempfile.TemporaryDirectory() as folder:
            common = [half(one, parity) for one in placed.common]
            curves, _ = recovered_curves(common, Path(folder) / "map.exr", lambda _: None)
        maps = {}
        for whole in placed.brackets:
            channel = str(whole.light[0].extra["channel"])
            bracket = with_found_times(half(whole, parity), curves[channel])
            known, displacement = relative_calibration(bracket, curves[channel], camera, lens)
            maps[channel] = merge(
                bracket,
                Setup(camera, lens, known),
                absent=placed.absent[parity::2],
                without_ghosts=True,
                displacement_px=displacement.px if displacement else 0.0,
            )
        found.append(maps)
    return {channel: (found[0][channel], found[1][channel]) for channel in found[0]}, str(placed.sentence)


def compared(one: RadianceMap, other: RadianceMap) -> tuple[Array, Array, Array]:
    """Return ln of the values, their differences and u of these, where neither map has a flag; one factor is free."""
    good = (one.mask == 0) & (other.mask == 0)
    logs = [np.log(m.radiance[good].astype(float)) for m in (one, other)]
    u = np.hypot(*(m.u_radiance[good].astype(float) / m.radiance[good] for m in (one, other)))
    gap = logs[0] - logs[1]
    return logs[0], gap - np.average(gap, weights=1.0 / u**2), u


def row(name: str, pair: tuple[RadianceMap, RadianceMap]) -> str:
    level, gap, u = compared(*pair)
    z = gap / u
    brightest = level >= np.quantile(level, 7 / 8)
    figures = [np.sqrt(np.mean(gap**2)), np.sqrt(np.mean(u**2))]
    return (
        f"| {name} | {100 * gap.size / pair[0].mask.size:.0f} % | {100 * figures[0]:.1f} % | {100 * figures[1]:.1f} % "
        f"| {figures[0] / figures[1]:.2f} | {np.sqrt(np.mean(z**2)):.2f} | {np.sqrt(np.mean(z[brightest] ** 2)):.2f} |"
    )


def main() -> None:
    folder = stacks_folder()
    if folder is None:
        print("the real stacks (shared/data/stacks) are not on this machine")
        return
    rows, lay = [], []
    for name, place in SETS:
        pairs, sentence = halves(folder / place)
        rows += [row(f"{name}, {channel}", pair) for channel, pair in pairs.items()]
        lay.append(f"{name}: {sentence}.")
    parts = [
        "Odd against even frames, each half with its response, labels and noise; aligned once, one factor free. Differ "
        "is the rms difference of the maps, stated its rms u, and z the ratio. By pixel, z is the rms of difference "
        "over u, at last of the brightest eighth alone. Both "
        "halves share what the ladder of stops leaves open, so z well below 1 does not show that u is too large.",
        "| set, colour | pixels | differ (rms) | stated | z | z by pixel | brightest |\n|---|---|---|---|---|---|---|\n"
        + "\n".join(rows),
        " ".join(lay),
    ]
    with tempfile.TemporaryDirectory() as target:
        begun, cpu = time.perf_counter(), time.process_time()
        run(["merge", str(folder / SETS[0][1]), "-o", f"{target}/map.exr", "-o", f"{target}/map.hdr"])
        parts.append(
            f"`radiometer merge memorial_film -o map.exr -o map.hdr`, response of three colours included: "
            f"{time.perf_counter() - begun:.1f} s, {time.process_time() - cpu:.1f} s of processor time."
        )
    body = "\n\n".join(parts)
    print(body)
    write_section(
        "merge_photographs",
        "Merging of real photographs",
        "OMP_NUM_THREADS=1 python -m benchmarks merge_photographs",
        body,
    )


if __name__ == "__main__":
    main()

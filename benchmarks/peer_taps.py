"""Gain, black level and dark noise of every tap by `radiometer characterise` and by other programs, on the same files.

    python -m benchmarks peer_taps --python OTHER/bin/python --python THIRD/bin/python --cameras 10 --first-seed 1303001

Each interpreter has astropy and one or more of emva1288, msfc-ccd and sigima (DataLab), of which this project needs no
part; programs that none of them has are left out, and without any the benchmark says so and stops. The files are FITS
with a unit per tap and its overscan, pairs of flats and of dark frames of a camera of two by two taps.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

import radiometer as rm
from benchmarks._sections import write_section
from testing.tap_camera import Taps

JUDGE: Final = Path(__file__).parent / "_peers" / "judge_taps.py"
TOOLS: Final = ("emva1288", "msfc-ccd", "sigima")
_SHAPE: Final = (128, 192)
_OURS: Final = {"K": "K", "black": "mu_y_dark", "noise": "sigma_y_dark"}
_UNITS: Final = {"K": "DN/e⁻", "black": "DN", "noise": "DN"}


def write_files(folder: Path, taps: Taps, seed: int) -> None:
    """Write pairs of flats and of dark frames."""
    rng = np.random.default_rng([seed, 2])
    for kind, exposure_s, copy, whole in taps.frames(rng, _SHAPE):
        taps.write_units(folder / f"{kind}{exposure_s}_{copy}.fits", rng, whole, exposure_s, kind)


def theirs(python: Sequence[str], tool: str, folder: Path) -> dict[str, dict[str, float]] | None:
    """Return what a tool finds, by the first interpreter that has it; None where none has."""
    for interpreter in python:
        done = subprocess.run([interpreter, str(JUDGE), tool, str(folder)], capture_output=True, text=True)
        if done.returncode == 0:
            return dict(json.loads(done.stdout))
        if "ModuleNotFoundError" not in done.stderr:
            raise RuntimeError(f"{tool} failed: {done.stderr.strip().splitlines()[-1]}")
    return None


def ours(folder: Path) -> dict[str, dict[str, tuple[float, float]]]:
    """Return value and standard uncertainty of the figures of every tap."""
    found = rm.characterise(folder)
    return {
        one.tap.name: {name: (one.characterisation.figures[symbol].value, one.characterisation.figures[symbol].u)
                       for name, symbol in _OURS.items()}
        for one in found.taps
        if one.characterisation is not None
    }  # fmt: skip


def truth_of(taps: Taps) -> list[dict[str, float]]:
    """Return the true figures of every tap; the noise has the rounding of the converter."""
    noise = np.sqrt((taps.gain * taps.noise) ** 2 + 1 / 12)
    rows = zip(taps.gain.flat, taps.black.flat, noise.flat, strict=True)
    return [{"K": float(k), "black": float(b), "noise": float(n)} for k, b, n in rows]


def page(results: Mapping[str, Sequence[Mapping[str, tuple[float, float, float]]]]) -> str:
    """Return how far each tool's figures are from the truth and from ours, in Markdown.

    Args:
        results: By tool, of every tap and figure: its value, the truth, and ours with its u.
    """
    lines = ["| program | figure | taps | mean error | rms error | rms difference to ours | in our u, rms |",
             "|---" * 7 + "|"]  # fmt: skip
    for tool, rows in results.items():
        for name, unit in _UNITS.items():
            own = np.array([row[name] for row in rows if name in row])
            if not own.size:
                lines.append(f"| {tool} | {name} | | not its part | | | |")
                continue
            value, true, mine, u = own.T
            scale, shown = (100 / true, "%") if name == "K" else (1.0, unit)
            error, apart = scale * (value - true), scale * (value - mine)
            rms = [float(np.sqrt(np.mean(np.square(part)))) for part in (error, apart, (value - mine) / u)]
            same = "" if tool == "radiometer" else f"{rms[1]:.3g} {shown}"
            last = "" if tool == "radiometer" else f"{rms[2]:.2f}"
            errors = f"{error.mean():+.2g} {shown} | {rms[0]:.2g} {shown}"
            lines.append(f"| {tool} | {name} | {len(own)} | {errors} | {same} | {last} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks peer_taps", description=__doc__)
    parser.add_argument("--python", action="append", default=[], help="interpreter that has one of the programs")
    parser.add_argument("--cameras", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks/sensors.md")
    options = parser.parse_args()
    results: dict[str, list[dict[str, Any]]] = {}
    for seed in range(options.first_seed, options.first_seed + options.cameras):
        taps = Taps.drawn(np.random.default_rng([seed, 1]), 2, 2)
        with tempfile.TemporaryDirectory() as kept:
            folder = Path(kept)
            write_files(folder, taps, seed)
            answers = {tool: found for tool in TOOLS if (found := theirs(options.python, tool, folder)) is not None}
            if not answers:
                print("skipped: no interpreter with emva1288, msfc-ccd or sigima (--python); see _peers/judge_taps.py")
                return
            mine = ours(folder)
        answers = {"radiometer": {tap: {n: v for n, (v, _) in own.items()} for tap, own in mine.items()}} | answers
        for tool, found in answers.items():
            for (tap, own), true in zip(mine.items(), truth_of(taps), strict=True):
                row = {n: (found[tap][n], true[n], *own[n]) for n in _OURS if n in found[tap]}
                results.setdefault(tool, []).append(row)
        print(f"{seed}: {', '.join(answers)}", flush=True)
    body = page(results)
    print(body)
    if options.write:
        asked = f"python -m benchmarks peer_taps --cameras {options.cameras} --first-seed {options.first_seed}"
        write_section("taps_of_peers", "Taps by other programs", asked, body)


if __name__ == "__main__":
    main()

"""Gain, black level and dark noise of real sensors by `radiometer characterise` and by the package emva1288.

    python -m benchmarks peer_sets --python OTHER/bin/python

OTHER is an environment with emva1288, of which this project needs no part; without it the benchmark says so and stops.
The package gets, at every exposure with two lit frames, these and two dark frames: of the same exposure, else biases.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

import radiometer as rm
from benchmarks._real_sets import data_folder
from benchmarks._sections import write_section
from radiometer.analysis.characterise import Subject, read_subject
from radiometer.analysis.characterise.subject import FrameGroup

JUDGE: Final = Path(__file__).parent / "_peers" / "judge_sets.py"
SETS: Final = {
    "CCD of 12 bits, `ref001`": "emva/ref001_ccd_12bit",
    "CCD STL-1001E, 2017": "sensors/sbig_stl1001_2017",
    "CCD STL-1001E, 2019": "sensors/sbig_stl1001_2019",
    "star-tracker CMOS": "sensors/astrotracker_ptc_clamp/exposure_sweep_pairs.csv",
    "RedEdge and Sequoia": "sensors/micasense_raw",
    "LSST's e2v and ITL CCDs": "sensors/lsst_brighter_fatter",
}
_FIGURES: Final = {"K": ("K", "DN/e⁻"), "black": ("mu_y_dark", "DN"), "noise": ("sigma_y_dark", "DN")}


def pairs_of(subject: Subject, folder: Path) -> Path | None:
    """Write the pairs that the package needs, and return the file that names them; None where there are none."""
    full = subject.camera.full_scale_dn

    def saved(group: FrameGroup, name: str) -> list[str]:
        files = []
        for n, frame in zip(range(2), group.read(full), strict=False):
            np.save(folder / f"{name}_{n}.npy", np.asarray(frame))
            files.append(str(folder / f"{name}_{n}.npy"))
        return files

    darks = [one for one in subject.groups if one.settings.is_dark and len(one.files) > 1]
    temporal = {}
    for number, lit in enumerate(one for one in subject.groups if not one.settings.is_dark and len(one.files) > 1):
        exposure_s, warm = lit.settings.exposure_s, lit.settings.temperature_c
        near = [d for d in darks if warm is None or abs((d.settings.temperature_c or warm) - warm) < 1.5]
        same = [d for d in near if d.settings.exposure_s in (exposure_s, 0.0)]
        if same:
            dark = max(same, key=lambda one: one.settings.exposure_s)
            photons = lit.photons or 1000.0 * exposure_s  # they only scale the quantum efficiency
            temporal[1000.0 * exposure_s] = {
                0.0: saved(dark, f"dark{number}"), photons: saved(lit, f"lit{number}")
            }  # fmt: skip
    if not temporal:
        return None
    listing = folder / "frames.json"
    listing.write_text(json.dumps(temporal), encoding="utf-8")
    return listing


def judged(python: str, path: Path) -> dict[str, float] | str:
    """Return what the package finds of a set; a text says why it finds nothing."""
    try:
        subject = read_subject(path)
    except rm.RadiometerError:
        return "no pairs of frames of one camera"
    if subject.given:
        return "a table: the package needs frames"
    with tempfile.TemporaryDirectory() as kept:
        listing = pairs_of(subject, Path(kept))
        if listing is None:
            return "no two lit frames of one exposure with dark frames"
        done = subprocess.run([python, str(JUDGE), str(listing)], capture_output=True, text=True)
    if done.returncode:
        return done.stderr.strip().splitlines()[-1][:80]
    return dict(json.loads(done.stdout.strip().splitlines()[-1]))


def rows_of(name: str, path: Path, python: str) -> list[str]:
    """Return the lines of the table for one set."""
    theirs = judged(python, path)
    try:
        ours = rm.characterise(path)
    except rm.RadiometerError:
        return [f"| {name} | | not characterised | {theirs} | | |"]
    rows = []
    for figure, (symbol, unit) in _FIGURES.items():
        found = ours.characterisation.figures.get(symbol)
        mine = "not determined" if found is None else f"{found.value:.5g} ± {2 * found.u:.2g} {unit}"
        if isinstance(theirs, str) or found is None:
            rows.append(f"| {name} | {figure} | {mine} | {theirs if isinstance(theirs, str) else theirs[figure]} | | |")
            continue
        apart = found.value - theirs[figure]
        relative = f"{100 * apart / theirs[figure]:+.2f} %"
        rows.append(
            f"| {name} | {figure} | {mine} | {theirs[figure]:.5g} {unit} | {relative} | {apart / (2 * found.u):+.2f} |"
        )
    return rows


def page(data: Path, python: str, names: Sequence[str]) -> str:
    """Return both programs' figures of every set, in Markdown."""
    lines = ["| set | figure | here (k = 2) | emva1288 | difference | in U |", "|---|---|---|---|---|---|"]
    for name in names:
        lines += rows_of(name, data / SETS[name], python)
        print(lines[-1], flush=True)
    return "\n".join(lines) + (
        "\n\nThe package weighs all exposures alike, and subtracts dark frames of the same exposure, or here biases."
        " This program weighs by noise, and all dark frames take part in its line. The package gets the first two"
        " biases of the STL-1001E. Their black level is the lowest of five, which wander by 0.5 DN (one sigma)."
        " A later one holds tracks of cosmic rays, which raise the noise of all five; its U contains them."
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks peer_sets", description=__doc__)
    parser.add_argument("--python", default="", help="interpreter that has emva1288")
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks/sensors.md")
    options = parser.parse_args()
    data = data_folder()
    if data is None or not options.python:
        print("skipped: it needs ../shared/data and an interpreter with emva1288 (--python)")
        return
    body = page(data, options.python, list(SETS))
    print(body)
    if options.write:
        asked = "python -m benchmarks peer_sets"
        write_section("real-sensors-by-emva1288", "Real sensors by the package emva1288", asked, body)


if __name__ == "__main__":
    main()

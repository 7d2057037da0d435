"""What other people's programs find of the taps of a camera: emva1288, msfc-ccd, DataLab (sigima).

    python judge_taps.py TOOL FOLDER

Run by an interpreter that has astropy and the tool, which this project does not need. FOLDER holds pairs of flats and
dark frames as FITS files with a unit per tap: `flat0.1_0.fits`, `dark0.1_1.fits`, exposure and copy in the name. Prints
one JSON object: of every tap its gain in DN/e-, its black level and its dark noise in DN, as far as the tool has them.
"""

from __future__ import annotations

import contextlib
import json
import logging
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits

Figures = dict[str, dict[str, float]]


def files_of(folder: Path, kind: str) -> dict[float, list[Path]]:
    """Return the files of flats or of dark frames by exposure in s."""
    found: dict[float, list[Path]] = {}
    for path in sorted(folder.glob(f"{kind}*_*.fits")):
        found.setdefault(float(path.name[len(kind) : path.name.index("_")]), []).append(path)
    return found


def names_of(folder: Path) -> list[str]:
    """Return the names of the taps."""
    with fits.open(next(iter(folder.glob("*.fits")))) as units:
        return [unit.name for unit in units[1:]]


def read(path: Path, tap: str, section: str = "DATASEC") -> np.ndarray:
    """Return a section of a tap's unit."""
    with fits.open(path) as units:
        left, right, lower, upper = (int(n) for n in re.findall(r"\d+", units[tap].header[section]))
        return np.array(units[tap].data[lower - 1 : upper, left - 1 : right])


def emva1288(folder: Path) -> Figures:
    """Return the reference implementation's figures; each pair counts as its stack of frames for the patterns."""
    from emva1288.process.data import Data1288
    from emva1288.process.loader import LoadImageData
    from emva1288.process.results import Results1288

    found = {}
    for tap in names_of(folder):
        flats, darks = files_of(folder, "flat"), files_of(folder, "dark")
        # Photons per pixel only scale the quantum efficiency, which is not asked for.
        temporal = {t: {0.0: list(map(str, darks[t])), 1000.0 * t: list(map(str, flats[t]))} for t in flats}
        middle = sorted(flats)[len(flats) // 2]
        images = {"temporal": temporal, "spatial": {middle: temporal[middle]}}
        loaded = LoadImageData(images, loglevel=logging.WARNING, fload=lambda path, tap=tap: read(Path(path), tap))
        data = Data1288(loaded.data, loglevel=logging.WARNING).data
        results = Results1288(data, loglevel=logging.WARNING)
        black = float(np.mean(data["temporal"]["u_ydark"]))
        found[tap] = {"K": float(results.K), "black": black, "noise": float(results.sigma_y_dark)}
    return found


def msfc_ccd(folder: Path) -> Figures:
    """Return black levels of the overscan by `TapData.bias`, and noise of the difference of two unbiased dark frames.

    The gain is an input of that program. Its sensors have two by two taps.
    """
    import astropy.units as u
    import msfc_ccd as peer
    import named_arrays as na

    def opened(path: Path) -> Any:
        with fits.open(path) as units:
            a, b, c, d = (np.asarray(unit.data, dtype=float) for unit in units[1:])
        whole = np.vstack([np.hstack([a, b[:, ::-1]]), np.hstack([c, d[:, ::-1]])[::-1]])
        shape = dict(zip(("detector_y", "detector_x"), whole.shape, strict=True))
        index = na.indices(shape)
        header = peer.ImageHeader(
            pixel=na.Cartesian2dVectorArray(index["detector_x"], index["detector_y"]),
            time_start=na.ScalarArray(0),
            timedelta=1 * u.s,
            timedelta_requested=1 * u.s,
        )
        sensor = peer.TeledyneCCD230(num_blank=0, num_overscan=len(read(path, "A", "BIASSEC")[0]))
        values = na.ScalarArray(whole << u.DN, axes=("detector_y", "detector_x"))
        return peer.SensorData(inputs=header, outputs=values, camera=peer.Camera(sensor=sensor)).taps

    darks = [opened(path) for paths in files_of(folder, "dark").values() for path in paths]
    black = [one.bias().outputs for one in darks]
    axes = ("detector_x", "detector_y")
    active = {"detector_x": slice(None, -darks[0].camera.sensor.num_overscan)}
    noise = [(one.unbiased.outputs[active] - other.unbiased.outputs[active]).std(axis=axes) / np.sqrt(2)
             for one, other in zip(darks[::2], darks[1::2], strict=True)]  # fmt: skip
    found = {}
    for name, (x, y) in zip("ABCD", ((0, 0), (1, 0), (0, 1), (1, 1)), strict=True):
        at = {"tap_x": x, "tap_y": y}
        level = float(np.mean([part[at].ndarray.to_value(u.DN) for part in black]))
        spread = float(np.sqrt(np.mean([part[at].ndarray.to_value(u.DN) ** 2 for part in noise])))
        found[name] = {"black": level, "noise": spread}
    return found


def sigima(folder: Path) -> Figures:
    """Return figures of means and sigmas by DataLab's `stats` of frames and of their differences.

    DataLab has no photon transfer: the gain is the slope, through the origin, of its variances over its means.
    """
    from sigima.objects import create_image
    from sigima.proc.image import difference, stats

    def by_stats(image: Any) -> tuple[float, float]:
        table = stats(image)
        values = dict(table.items()) if hasattr(table, "items") else table.value
        if not isinstance(values, dict):
            values = dict(zip(table.labels, np.ravel(table.array)[1:], strict=True))
        mean = next(float(v) for k, v in values.items() if str(k).startswith(("<z> ", "mean")) or k == "<z>")
        sigma = next(float(v) for k, v in values.items() if str(k).startswith(("σ(z)", "std")))
        return mean, sigma

    def moments(paths: list[Path], tap: str) -> tuple[float, float]:
        one, other = (create_image(path.name, read(path, tap).astype(float)) for path in paths)
        mean = np.mean([by_stats(one)[0], by_stats(other)[0]])
        return float(mean), by_stats(difference(one, other))[1] ** 2 / 2

    found = {}
    for tap in names_of(folder):
        flats, darks = files_of(folder, "flat"), files_of(folder, "dark")
        bright = np.array([moments(flats[t], tap) for t in sorted(flats)])
        dark = np.array([moments(darks[t], tap) for t in sorted(flats)])
        mean, variance = (bright - dark).T
        black, noise = dark.mean(axis=0)
        gain = float(np.sum(mean * variance) / np.sum(mean**2))
        found[tap] = {"K": gain, "black": float(black), "noise": float(np.sqrt(noise))}
    return found


TOOLS: dict[str, Callable[[Path], Figures]] = {"emva1288": emva1288, "msfc-ccd": msfc_ccd, "sigima": sigima}

if __name__ == "__main__":
    with contextlib.redirect_stdout(sys.stderr):
        answer = TOOLS[sys.argv[1]](Path(sys.argv[2]))
    print(json.dumps(answer))

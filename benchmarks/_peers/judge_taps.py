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
    """Return gain and noise by its photon transfer and read-out noise, and the black level by its bias.

    Its sensors have two by two taps, and columns without light in front of the lit ones: the overscan is put there. It
    needs columns behind them too, which get the last lit one.
    """
    import astropy.units as u
    import msfc_ccd as peer
    import named_arrays as na

    def whole(path: Path) -> np.ndarray:
        a, b, c, d = (
            np.hstack([read(path, tap, "BIASSEC"), read(path, tap)]).astype(float) for tap in names_of(folder)
        )
        return np.vstack([np.hstack([a, b[:, ::-1]]), np.hstack([c, d[:, ::-1]])[::-1]])

    def opened(kind: str) -> Any:
        stack = np.array([[whole(path) for path in paths] for paths in files_of(folder, kind).values()])
        axes = ("level", "copy", "detector_y", "detector_x")
        index = na.indices(dict(zip(axes[2:], stack.shape[2:], strict=True)))
        times = na.ScalarArray(np.zeros(stack.shape[:2]), axes=axes[:2])
        header = peer.ImageHeader(
            pixel=na.Cartesian2dVectorArray(index["detector_x"], index["detector_y"]),
            time_start=times,
            timedelta=times * u.s,
            timedelta_requested=times * u.s,
        )
        blank = read(next(folder.glob("*.fits")), "A", "BIASSEC").shape[1]
        sensor = peer.TeledyneCCD230(num_blank=blank, num_overscan=1, num_masked=0)
        values = na.ScalarArray(stack << u.DN, axes=axes)
        return peer.SensorData(inputs=header, outputs=values, camera=peer.Camera(sensor=sensor)).taps

    darks = opened("dark")
    gain = peer.gain.photon_transfer(opened("flat"), "copy").outputs
    noise, black = peer.noise.readout(darks, "copy").outputs, darks.bias().outputs
    found = {}
    for name, (x, y) in zip("ABCD", ((0, 0), (1, 0), (0, 1), (1, 1)), strict=True):
        at = {"tap_x": x, "tap_y": y}
        found[name] = {
            "K": float(1.0 / gain[at].ndarray.to_value(u.electron / u.DN)),
            "black": float(np.mean(black[at].ndarray.to_value(u.DN))),
            "noise": float(np.sqrt(np.mean(np.square(noise[at].ndarray.to_value(u.DN))))),
        }
    return found


def sigima(folder: Path) -> Figures:
    """Return figures of means and sigmas by DataLab's `stats` of frames and of their differences.

    DataLab has no photon transfer: the gain is the slope, through the origin, of its variances over its means.
    """
    from sigima.objects import create_image
    from sigima.proc.image import difference, stats

    def by_stats(image: Any) -> tuple[float, float]:
        table = stats(image)
        values = dict(zip(table.headers, table.data[0], strict=True))
        return float(values["mean"]), float(values["std"])

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

"""Response recovery by other programs: OpenCV, colour-hdri, pfstools. What is not installed is left out."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from benchmarks._response_stacks import Array
from radiometer.data import Bracket
from radiometer.errors import RadiometerError

Peer = Callable[[Bracket], Array]


def opencv(make: Callable[[], object]) -> Peer:
    def recover(bracket: Bracket) -> Array:
        images = [np.repeat(frame.dn[..., None], 3, axis=2) for frame in bracket.light]
        times = bracket.effective_exposures_s.astype(np.float32)
        curve = make().process(images, times)  # type: ignore[attr-defined]
        with np.errstate(divide="ignore"):
            return np.log(np.asarray(curve, dtype=np.float64)[:, 0, 1])

    return recover


def opencv_debevec(samples: int) -> Peer:
    """Return OpenCV's CalibrateDebevec with so many pixels, which it takes from a regular grid."""
    return opencv(lambda: cv2.createCalibrateDebevec(samples))


def colour_hdri_debevec() -> Peer | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from colour_hdri import camera_response_functions_Debevec1997
            from colour_hdri.utilities import Image, ImageStack, Metadata
    except ImportError:
        return None

    def recover(bracket: Bracket) -> Array:
        stack = ImageStack()
        for frame in bracket.light:
            stack.append(Image(None, frame.dn[..., None] / 255.0, Metadata(1.0, frame.settings.exposure_s, 100.0)))
        curve = camera_response_functions_Debevec1997(stack, normalise=False)
        with np.errstate(divide="ignore"):
            return np.log(np.asarray(curve, dtype=np.float64)[:, 0])

    return recover


def pfstools_robertson() -> Peer | None:
    if not (shutil.which("pfshdrcalibrate") and shutil.which("pfsinhdrgen")):
        return None

    def recover(bracket: Bracket) -> Array:
        with tempfile.TemporaryDirectory() as name:
            folder, lines = Path(name), []
            for number, frame in enumerate(bracket.light):
                cv2.imwrite(str(folder / f"{number}.ppm"), np.repeat(frame.dn[..., None], 3, axis=2))
                lines.append(f"{number}.ppm {1.0 / frame.settings.exposure_s} 1 100\n")
            (folder / "stack.hdrgen").write_text("".join(lines))
            pipe = "pfsinhdrgen stack.hdrgen | pfshdrcalibrate -c robertson -b 8 -s curve.m > merged.pfs"
            subprocess.run(pipe, shell=True, cwd=folder, check=True, capture_output=True)
            rows = [line.split() for line in (folder / "curve.m").read_text().splitlines() if line[:1] != "#"]
        green = np.array([row for row in rows if row][256:512], dtype=np.float64)
        return np.log(10.0) * green[:, 0]

    return recover


def failures_of(name: str) -> type[Exception]:
    """Return what counts as a failure of a program: of ours what it says itself, for a crash must end the benchmark."""
    return RadiometerError if name.startswith("radiometer") else Exception


def peers() -> Iterator[tuple[str, Peer]]:
    yield "OpenCV CalibrateDebevec, 70 samples", opencv_debevec(70)
    yield "OpenCV CalibrateDebevec, 500 samples", opencv_debevec(500)
    yield "OpenCV CalibrateRobertson", opencv(cv2.createCalibrateRobertson)
    other = colour_hdri_debevec()
    if other is not None:
        yield "colour-hdri Debevec 1997", other
    program = pfstools_robertson()
    if program is not None:
        yield "pfstools pfshdrcalibrate (Robertson)", program

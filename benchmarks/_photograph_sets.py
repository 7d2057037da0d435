"""The real stacks: their frames by channel, and what raw values of the same shots say of the response."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from radiometer.bench.sources import open_source
from radiometer.data import Bracket, Frame, FrameSettings

Array = NDArray[np.float64]
CHANNELS = ("red", "green", "blue")
# Values compared: 5 to 95 % of 8 bits.
LOWEST_DN, HIGHEST_DN = 13, 242
# ColorChecker, lowest row: six neutral patches.
_NEUTRAL_X, _NEUTRAL_Y, _HALF_PX = (0.09, 0.25, 0.42, 0.58, 0.75, 0.92), 0.88, 13
_LEAST_RAW, _MOST_RAW = 16.0, 240.0


def stacks_folder() -> Path | None:
    """Return the folder of real stacks next to the checkout or a folder above it; None where there is none."""
    for parent in Path(__file__).resolve().parents[1:]:
        if (parent / "shared" / "data" / "stacks").is_dir():
            return parent / "shared" / "data" / "stacks"
    return None


@dataclass(frozen=True, slots=True, eq=False)
class RealStack:
    """One bracket of one channel of a real camera.

    Attributes:
        camera: Name of the set.
        name: Which of its stacks.
        scene: What its other colours share with it.
        bracket: The frames.
        truth_dn: Digital numbers of which raw values tell the exposure; empty where none do.
        truth_log: ln of that exposure, free offset.
        u_truth: Standard uncertainty of it: what a smooth curve through raw and JPEG values of the patches leaves, or
            what cutting 12 bits down to 8 does.
        mosaic: Whether the colours lie in one frame, pixel by pixel.
    """

    camera: str
    name: str
    scene: str
    bracket: Bracket
    truth_dn: Array
    truth_log: Array
    u_truth: float = 0.0
    mosaic: bool = False

    @property
    def has_truth(self) -> bool:
        """Tell whether raw values say what the response is."""
        return self.truth_dn.size > 0


def real_stacks(folder: Path, cameras: tuple[str, ...]) -> Iterator[RealStack]:
    """Yield every stack of the cameras named (all where none is)."""
    for camera in cameras or CAMERAS:
        yield from _LOADERS[camera](folder, camera)


def _middlebury(folder: Path, camera: str) -> Iterator[RealStack]:
    for light in (1, 2):
        shots = [_pair(folder / "middlebury_jpg_raw_pairs" / camera, light, e) for e in (1, 2, 3, 4)]
        for index, channel in enumerate(CHANNELS):
            frames = [
                Frame(np.ascontiguousarray(jpeg[..., index]), 8, FrameSettings(0.01 * 2.0**e), extra={"file": f"e{e}"})
                for e, (jpeg, _) in enumerate(shots, start=1)
            ]
            dn, log = _neutral_truth([(jpeg[..., index], raw[..., index]) for jpeg, raw in shots])
            bracket = Bracket.from_frames(frames, origin=camera)
            yield RealStack(camera, f"i{light} {channel}", f"i{light}", bracket, dn, log, _scatter(dn, log))


def _scatter(dn: Array, log: Array) -> float:
    """Return the rms of ln H that a curve of the fourth order in ln M leaves: the patches' own, no program's."""
    x = np.log(dn)
    left = log - np.polyval(np.polyfit(x, log, 4), x)
    return float(np.sqrt(np.sum(left**2) / max(dn.size - 5, 1)))


def _pair(folder: Path, light: int, e: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    read = [cv2.imread(str(folder / f"wb1i{light}e{e}-{kind}.png")) for kind in ("jpg", "raw")]
    return tuple(np.asarray(one, dtype=np.uint8)[..., ::-1] for one in read)  # type: ignore[return-value]


def _neutral_truth(pairs: list[tuple[NDArray[np.uint8], NDArray[np.uint8]]]) -> tuple[Array, Array]:
    """Return mean JPEG value and ln of the mean raw value of the neutral patches in every exposure."""
    found = []
    for jpeg, raw in pairs:
        height, width = jpeg.shape
        for x in _NEUTRAL_X:
            row, column = int(_NEUTRAL_Y * height), int(x * width)
            cut = slice(row - _HALF_PX, row + _HALF_PX), slice(column - _HALF_PX, column + _HALF_PX)
            dn, value = float(jpeg[cut].mean()), float(raw[cut].mean())
            if LOWEST_DN <= dn <= HIGHEST_DN and _LEAST_RAW <= value <= _MOST_RAW:
                found.append((dn, np.log(value)))
    table = np.array(sorted(found))
    return table[:, 0], table[:, 1]


def _flea3(folder: Path, camera: str) -> Iterator[RealStack]:
    for scene in ("disks", "color_checker"):
        files: dict[str, list[tuple[float, Path]]] = {}
        for path in sorted((folder / "flea3_raw12_bayer_filters" / "images_filtered_light" / scene).glob("*.tif")):
            match = re.search(r"_(\d+nm)_(\d+)ms_", path.name)
            if match:
                files.setdefault(match[1], []).append((int(match[2]) / 1000.0, path))
        dn = np.arange(LOWEST_DN, HIGHEST_DN + 1, dtype=np.float64)
        for band, several in sorted(files.items()):
            frames = [
                Frame(np.asarray(tifffile.imread(path)), 8, FrameSettings(seconds), extra={"file": path.name})
                for seconds, path in several
            ]
            u_truth = float(np.sqrt(np.mean((0.5 / dn) ** 2)))
            name, bracket = f"{scene} {band}", Bracket.from_frames(frames, origin=band)
            yield RealStack(camera, name, name, bracket, dn, np.log(dn), u_truth, mosaic=True)


def _photographs(folder: Path, camera: str) -> Iterator[RealStack]:
    place = {
        "memorial": folder / "memorial_film",
        "frobisher": folder / "canon5d2_frobisher",
        "fisheye": folder / "canon5d2_fisheye_calibrated" / "example" / "JPEG",
    }[camera]
    nothing = np.empty(0)
    for bracket in open_source(place, "each").brackets:
        yield RealStack(camera, str(bracket.light[0].extra["channel"]), "", _thinned(bracket), nothing, nothing)


def _thinned(bracket: Bracket, most: int = 150_000) -> Bracket:
    """Return every n-th pixel of large photographs: the same for every program compared."""
    step = int(np.ceil(np.sqrt(bracket.shape[0] * bracket.shape[1] / most)))
    if step == 1:
        return bracket
    frames = [
        Frame(np.ascontiguousarray(f.dn[::step, ::step]), f.bit_depth, f.settings, extra=f.extra) for f in bracket.light
    ]
    return Bracket.from_frames(frames, origin=bracket.origin)


_LOADERS: Final[dict[str, Callable[[Path, str], Iterator[RealStack]]]] = {
    "NikonD70": _middlebury,
    "CanonPowerShotG9": _middlebury,
    "flea3": _flea3,
    "memorial": _photographs,
    "frobisher": _photographs,
    "fisheye": _photographs,
}
CAMERAS: Final = tuple(_LOADERS)

"""Photographs as files in a folder, the list of their exposure times next to them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image


def eight_bits(dn: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return digital numbers as a camera stores them in 8 bits."""
    return np.clip(np.rint(dn), 0, 255).astype(np.uint8)


def write_jpeg(path: Path, dn: NDArray[np.float64], time_s: float, iso: int = 100, f_number: float = 8.0) -> None:
    """Write digital numbers as a JPEG with EXIF; the folder is made."""
    path.parent.mkdir(exist_ok=True)
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({33434: time_s, 33437: f_number, 34855: iso})
    Image.fromarray(eight_bits(dn)).save(path, exif=exif, quality=100)


def write_photographs(
    folder: Path, pictures: Iterable[NDArray[Any] | bytes], times_s: Sequence[float], ending: str = ".png"
) -> Path:
    """Write pictures, or whole files, as p0, p1 … with `exposures.txt`; return the folder."""
    folder.mkdir(exist_ok=True)
    names = [f"p{k}{ending}" for k in range(len(times_s))]
    for name, picture in zip(names, pictures, strict=True):
        if isinstance(picture, bytes):
            (folder / name).write_bytes(picture)
        else:
            cv2.imwrite(str(folder / name), picture)
    (folder / "exposures.txt").write_text("".join(f"{name} {s}\n" for name, s in zip(names, times_s, strict=True)))
    return folder

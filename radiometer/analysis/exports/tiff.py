"""32-bit TIFF: one page of values, one of their standard uncertainty, one of mask bits."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

import radiometer
from radiometer.analysis.exports.maps import MapPicture
from radiometer.data.json_text import json_text
from radiometer.data.storage import write_bytes_atomic


def write_tiff(path: Path, picture: MapPicture) -> None:
    """Write a picture as TIFF of three pages: values and standard uncertainty as float32, mask bits as uint8.

    Each page's description is JSON with the quantity and the unit.

    Args:
        path: File to write.
        picture: One or three maps.

    Raises:
        OutputError: If the file cannot be written.
    """
    names = ("red", "green", "blue") if picture.is_colour else tuple(picture.maps)
    found = [picture.maps[name] for name in names]
    pages: dict[str, NDArray[Any]] = {
        "value": np.stack([one.radiance for one in found], axis=-1),
        "standard uncertainty": np.stack([one.u_radiance for one in found], axis=-1),
        "mask": np.stack([one.mask for one in found], axis=-1),
    }
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream) as tiff:
        for quantity, values in pages.items():
            unit = "PixelMask bits" if quantity == "mask" else picture.unit
            facts = {"quantity": quantity, "unit": unit, "u_rel_common": picture.first.u_rel_common}
            tiff.write(
                values if picture.is_colour else values[..., 0],
                photometric="rgb" if picture.is_colour else "minisblack",
                description=json_text(facts, ascii_only=True),
                software=f"radiometer {radiometer.__version__}",
                metadata=None,
            )
    write_bytes_atomic(path, stream.getvalue())

"""OpenEXR: values, standard uncertainty and mask in one file of 32-bit channels."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import radiometer
from radiometer.analysis.exports.maps import MapPicture
from radiometer.data.storage import write_bytes_atomic
from radiometer.errors import MissingLibrary, OutputError


def write_exr(path: Path, picture: MapPicture) -> None:
    """Write a picture as OpenEXR.

    Channels are Y (or R, G, B) for the values, Y.u (R.u, …) for their standard uncertainty, both 32-bit floating
    point, and Y.mask (R.mask, …) for the PixelMask bits. The header names the unit, what all pixels share
    (`u_rel_common`), and what is in no uncertainty (`not_in_u`).

    Args:
        path: File to write.
        picture: One or three maps.

    Raises:
        MissingLibrary: If the OpenEXR package is not installed.
        OutputError: If the file cannot be written.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise MissingLibrary("writing .exr needs the package OpenEXR (pip install OpenEXR); or use .tiff") from error
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "unit": picture.unit,
        "u_rel_common": float(picture.first.u_rel_common),
        "not_in_u": "; ".join(picture.first.not_in_u),
        "software": f"radiometer {radiometer.__version__}",
    }
    file = OpenEXR.File(header, _channels(picture))
    with tempfile.TemporaryDirectory() as scratch:  # the library writes to a name only
        temporary = Path(scratch) / "map.exr"
        try:
            file.write(str(temporary))
        except (OSError, RuntimeError) as error:
            raise OutputError(f"cannot write {path}: {error}") from error
        write_bytes_atomic(path, temporary.read_bytes())


def _channels(picture: MapPicture) -> dict[str, Any]:
    names = {"red": "R", "green": "G", "blue": "B"} if picture.is_colour else {next(iter(picture.maps)): "Y"}
    channels: dict[str, Any] = {}
    for name, letter in names.items():
        found = picture.maps[name]
        channels[letter] = np.ascontiguousarray(found.radiance)
        channels[f"{letter}.u"] = np.ascontiguousarray(found.u_radiance)
        channels[f"{letter}.mask"] = found.mask.astype(np.uint32)
    return channels

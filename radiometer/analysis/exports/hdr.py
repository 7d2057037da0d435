"""Radiance's own picture form, .hdr: 8 bits of mantissa per channel and a shared exponent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import radiometer
from radiometer.analysis.exports.maps import MapPicture
from radiometer.data.storage import write_bytes_atomic


def write_hdr(path: Path, picture: MapPicture) -> None:
    """Write a picture as .hdr; values in its unit, EXPOSURE 1, negative values as 0.

    The form keeps no uncertainty and resolves 0.4 %; it holds no path and no user name.

    Args:
        path: File to write.
        picture: One or three maps.

    Raises:
        OutputError: If the file cannot be written.

    Source: Ward 1991, "Real pixels", Graphics Gems II; Radiance, picture format.
    """
    grey = picture.first.radiance
    planes = [picture.maps[name].radiance for name in ("red", "green", "blue")] if picture.is_colour else [grey] * 3
    height, width = grey.shape
    header = (
        "#?RADIANCE\n"
        f"SOFTWARE=radiometer {radiometer.__version__}\n"
        f"UNIT={picture.unit}\n"
        "EXPOSURE=1\n"
        "FORMAT=32-bit_rle_rgbe\n\n"
        f"-Y {height} +X {width}\n"
    )
    write_bytes_atomic(path, header.encode("ascii") + rgbe(np.stack(planes, axis=-1)).tobytes())


def rgbe(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return RGBE quadruples of non-negative values, rounded to the nearest.

    Args:
        values: Shape (height, width, 3); negative or not finite values count as 0.

    Returns:
        Shape (height, width, 4), uint8: mantissas of red, green and blue, and the exponent + 128.
    """
    clean = np.where(np.isfinite(values), np.maximum(values, 0.0), 0.0).astype(np.float64)
    largest = clean.max(axis=-1)
    _, exponent = np.frexp(largest)
    # A mantissa that rounds up to 256 moves to the next exponent.
    exponent = exponent + (np.rint(largest / np.exp2(exponent - 8.0)) >= 256.0)
    mantissa = np.rint(clean / np.exp2(exponent - 8.0)[..., None])
    shown = (largest > 1e-38) & (exponent > -128)
    out = np.zeros((*values.shape[:2], 4), np.uint8)
    out[..., :3] = np.where(shown[..., None], np.minimum(mantissa, 255.0), 0.0)
    out[..., 3] = np.where(shown, np.clip(exponent + 128, 0, 255), 0)
    return out

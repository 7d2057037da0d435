"""A picture as a scene."""

from __future__ import annotations

from pathlib import Path
from tokenize import TokenError
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from radiometer.data import PatchDescription
from radiometer.data.decoding import decoded
from radiometer.data.guards import refuse_large_picture, refuse_size
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import CaptureError, ConfigurationError, required_library
from simulators.scenes.base import SceneImage
from simulators.scenes.layout import LitScene, refuse_unknown_pattern


class ImageScene(LitScene):
    """An image file whose values are radiance: L = L_peak·v^γ, v the value over full scale (over 1 for float images).

    Any image that OpenCV reads (PNG, TIFF, JPEG, Radiance HDR), an OpenEXR `.exr` or a NumPy `.npy`; colours become
    luma. It is scaled to the sensor by area averaging.
    """

    kind: Literal["image"] = "image"
    file: Path
    peak_radiance_W_per_sr_m2: float = Field(1.0, gt=0)  # noqa: N815 (the file's key)
    gamma: float = Field(1.0, gt=0, le=5)

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the picture's radiance. Raises ConfigurationError if the file is no usable image."""
        refuse_unknown_pattern(pattern, self.patterns)
        relative = cv2.resize(_read_relative(self.file), (width, height), interpolation=cv2.INTER_AREA)
        if not np.all(np.isfinite(relative)) or float(relative.min()) < 0:
            raise ConfigurationError(f"scene: {self.file}: holds values that are negative or not finite")
        peak = np.float32(self.peak_radiance_W_per_sr_m2)
        radiance = (peak * relative ** np.float32(self.gamma)).astype(np.float32)
        return SceneImage(radiance, peak_radiance=float(radiance.max()))

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        """Return none: a picture has no patches."""
        return ()


@bounded_reader(error=ConfigurationError)
def _read_relative(path: Path) -> NDArray[np.float32]:
    """Return one channel, 1 at full scale of an integer image."""
    try:
        image: Any = _READERS.get(path.suffix.lower(), _decode)(path)
    except (OSError, ValueError, cv2.error, CaptureError) as error:
        raise ConfigurationError(f"scene: cannot read {path}: {error}") from error
    if image is None or image.ndim not in (2, 3) or not image.size or image.dtype.kind not in "uif":
        raise ConfigurationError(f"scene: {path} is not an image that can be read")
    scale = float(np.iinfo(image.dtype).max) if np.issubdtype(image.dtype, np.integer) else 1.0
    relative = np.asarray(image, np.float32) / np.float32(scale)
    if relative.ndim == 3 and relative.shape[2] < 3:
        return relative[..., 0]
    if relative.ndim == 3:
        relative = cv2.cvtColor(np.ascontiguousarray(relative[..., :3]), cv2.COLOR_BGR2GRAY)
    return relative


def _decode(path: Path) -> NDArray[np.generic] | None:
    content = np.fromfile(path, np.uint8)
    refuse_large_picture(path, content.tobytes())
    picture: NDArray[np.generic] | None = decoded(content)
    return picture


@bounded_reader(error=ConfigurationError, apart="OpenEXR")
def _exr(path: Path) -> NDArray[np.generic]:
    """Return blue, green and red, or the one channel, of an OpenEXR picture."""
    with path.open("rb") as stream:
        refuse_large_picture(path, stream.read(2**16))
    OpenEXR = required_library("OpenEXR", "reading .exr needs the package OpenEXR (pip install OpenEXR); or give .hdr")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError, KeyError, MemoryError) as error:
        raise ValueError(f"damaged, or a form of OpenEXR that is not read ({error})") from error
    if {"R", "G", "B"} <= channels.keys():
        return np.stack([channels[name] for name in "BGR"], axis=-1)
    if len(channels) != 1 and "Y" not in channels:
        raise ValueError(f"it holds the channels {', '.join(sorted(channels))[:80]}; R, G, B or Y are read")
    return channels["Y"] if "Y" in channels else next(iter(channels.values()))


def _table(path: Path) -> NDArray[np.generic]:
    """Return a NumPy array no larger than what a picture may be; a header that states more is not followed."""
    try:
        stated = np.load(path, mmap_mode="r", allow_pickle=False)  # maps the file; reads no value
    except (
        EOFError,
        SyntaxError,
        TokenError,
        TypeError,
        LookupError,
        OverflowError,
        MemoryError,
        RecursionError,
    ) as error:
        raise ValueError(f"its header is damaged ({error})") from error
    if not isinstance(stated, np.ndarray):
        raise ValueError("it holds several arrays")
    refuse_size(path, stated.shape, stated.dtype.itemsize)
    return np.array(stated)


_READERS: Final = {".npy": _table, ".exr": _exr}

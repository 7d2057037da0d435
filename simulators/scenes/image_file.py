"""A picture as a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from radiometer.data import PatchDescription, SourceDescription
from radiometer.data.validation import ConfigSection
from radiometer.errors import ConfigurationError
from simulators.scenes.base import SceneImage
from simulators.scenes.layout import refuse_unknown_pattern


class ImageScene(ConfigSection):
    """An image file whose values are radiance: L = L_peak·v^γ, v the value over full scale (over 1 for float images).

    Any image that OpenCV reads (PNG, TIFF, JPEG, Radiance HDR) or a NumPy `.npy`; colours become luma. It is scaled
    to the sensor by area averaging.
    """

    kind: Literal["image"] = "image"
    file: Path
    peak_radiance_W_per_sr_m2: float = Field(1.0, gt=0)  # noqa: N815 (the file's key)
    gamma: float = Field(1.0, gt=0, le=5)
    wavelength_nm: float = Field(550.0, gt=0)

    @property
    def source(self) -> SourceDescription:
        """Return a scene."""
        return SourceDescription(kind="scene", wavelength_nm=self.wavelength_nm)

    @property
    def patterns(self) -> tuple[str, ...]:
        """Return the one pattern."""
        return ("default",)

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
        """Return none: a picture has no patches of its own."""
        return ()


def _read_relative(path: Path) -> NDArray[np.float32]:
    """Return one channel, 1 at full scale of an integer image."""
    try:
        image = np.load(path, allow_pickle=False) if path.suffix == ".npy" else _decode(path)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"scene: cannot read {path}: {error}") from error
    if image is None or image.ndim not in (2, 3):
        raise ConfigurationError(f"scene: {path} is not an image that can be read")
    scale = float(np.iinfo(image.dtype).max) if np.issubdtype(image.dtype, np.integer) else 1.0
    relative = np.asarray(image, np.float32) / np.float32(scale)
    if relative.ndim == 3:
        relative = cv2.cvtColor(np.ascontiguousarray(relative[..., :3]), cv2.COLOR_BGR2GRAY)
    return relative


def _decode(path: Path) -> NDArray[np.generic] | None:
    return cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)

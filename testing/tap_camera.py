"""A camera of several output amplifiers: each tap with a gain, black level and read noise, under even light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

EXPOSURES_S: Final = (0.1, 0.2, 0.4, 0.8, 1.2, 1.6, 2.0)
E_PER_S: Final = 9000.0
OVERSCAN_PX: Final = 8  # columns of overscan of each tap's unit in a FITS file


@dataclass(frozen=True)
class Taps:
    """The truth of taps, each an array of (rows, columns) of taps."""

    gain: np.ndarray  # DN/e⁻
    black: np.ndarray  # DN
    noise: np.ndarray  # e⁻

    @classmethod
    def drawn(cls, rng: np.random.Generator, rows: int, columns: int) -> Taps:
        """Draw taps that differ by some percent of gain, some DN of black level and some tenths of read noise."""
        shape = (rows, columns)
        return cls(0.5 * rng.uniform(0.9, 1.1, shape), rng.uniform(180, 220, shape), rng.uniform(6.0, 9.0, shape))

    def rectangles(self, shape: tuple[int, int]) -> list[tuple[int, int, int, int]]:
        """Return x, y, width and height of every tap on frames of a shape."""
        rows, columns = self.gain.shape
        height, width = shape[0] // rows, shape[1] // columns
        return [(x * width, y * height, width, height) for y in range(rows) for x in range(columns)]

    def frame(self, rng: np.random.Generator, exposure_s: float, shape: tuple[int, int], *, dark: bool) -> np.ndarray:
        """Return one frame of even light, or a dark one, in DN."""
        light = np.zeros(shape) if dark else np.full(shape, E_PER_S * exposure_s)
        electrons = rng.poisson(light) + rng.normal(0.0, spread(self.noise, shape))
        return np.rint(spread(self.black, shape) + spread(self.gain, shape) * electrons).astype(np.uint16)

    def frames(
        self, rng: np.random.Generator, shape: tuple[int, int], copies: int = 2
    ) -> Iterator[tuple[str, float, int, np.ndarray]]:
        """Yield kind (flat or dark), exposure in s, copy and picture of the frames of a characterisation."""
        for exposure_s in EXPOSURES_S:
            for kind in ("flat", "dark"):
                for copy in range(copies):
                    yield kind, exposure_s, copy, self.frame(rng, exposure_s, shape, dark=kind == "dark")

    def write_units(
        self, path: Path, rng: np.random.Generator, whole: np.ndarray, exposure_s: float, kind: str
    ) -> None:
        """Write the taps of a picture as units of a FITS file, each with eight columns of overscan behind its data.

        Taps of odd columns are read from their right end, as their `DETSEC` states.
        """
        from astropy.io import fits

        units = [fits.PrimaryHDU()]
        units[0].header.update({"EXPTIME": exposure_s, "IMAGETYP": kind})
        for number, (x, y, width, height) in enumerate(self.rectangles(whole.shape)):
            row, column = divmod(number, self.gain.shape[1])
            part, x1, x2 = whole[y : y + height, x : x + width], x + 1, x + width
            if column % 2:
                part, x1, x2 = part[:, ::-1], x2, x1
            electrons = rng.normal(0.0, self.noise[row, column], (height, OVERSCAN_PX))
            overscan = np.rint(self.black[row, column] + self.gain[row, column] * electrons).astype(np.uint16)
            unit = fits.ImageHDU(np.hstack([part, overscan]), name=chr(ord("A") + number))
            unit.header.update(
                {
                    "DETSEC": f"[{x1}:{x2},{y + 1}:{y + height}]",
                    "DATASEC": f"[1:{width},1:{height}]",
                    "BIASSEC": f"[{width + 1}:{width + OVERSCAN_PX},1:{height}]",
                }
            )
            units.append(unit)
        fits.HDUList(units).writeto(path)


def spread(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return values of taps at every pixel of a frame."""
    return np.kron(values, np.ones((shape[0] // values.shape[0], shape[1] // values.shape[1])))

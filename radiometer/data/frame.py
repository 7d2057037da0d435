"""A frame: raw digital numbers with the settings that made them; and a bracket: frames of one scene."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Literal, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from radiometer.data.white_level import WhiteLevel
from radiometer.errors import InputError
from radiometer.units import gain_factor

DigitalNumbers = NDArray[np.uint8] | NDArray[np.uint16]
Shutter = Literal["open", "closed"]
_LOOKED_AT: Final = 65_536  # pixels of whole rows: noise in so many never repeats
_PICTURED: Final = 0.5  # below this share of pixels that are neither lowest nor highest, noise may not show
MASKED_PIXELS: Final = "masked_rows_dn"  # key in a frame's `extra`, and in the entries of capture sets


@dataclass(frozen=True, slots=True)
class FrameSettings:
    """The settings a frame was really taken with, as read back from the device (never as asked for)."""

    exposure_s: float  # exposure time in s, above 0
    gain_db: float = 0.0  # analogue gain in dB
    f_number: float | None = None  # f-number of the lens; None where unknown
    black_level_dn: float | None = None  # black level (offset) in DN; None where unknown
    temperature_c: float | None = None  # sensor temperature in °C; None where unknown
    timestamp_s: float | None = None  # time of the frame in s on any one steady clock; None where unknown
    source_level: float = 1.0  # relative drive of the source, 0 (off) to 1
    pattern: str = "default"  # name of the displayed pattern
    shutter: Shutter = "open"  # "closed" for a dark frame
    iso: float | None = None  # ISO speed of a photograph; None for a machine camera
    # From which digital number pixels are saturated; None where only the bit depth is known
    white_level: WhiteLevel | None = field(default=None, compare=False)  # found from frames, not set

    @property
    def is_dark(self) -> bool:
        """Return whether the frame was taken with the shutter closed."""
        return self.shutter == "closed"

    @property
    def effective_exposure_s(self) -> float:
        """Return exposure time × gain factor in s: what the digital numbers above black are proportional to."""
        return self.exposure_s * gain_factor(self.gain_db)


@dataclass(frozen=True, slots=True)
class CameraFile:
    """The file that a camera itself wrote for a frame, as it came."""

    suffix: str  # how its name ends, such as ".cr2"
    content: bytes = field(repr=False)  # its bytes


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One exposure: raw digital numbers, right-aligned, with the settings read back."""

    dn: DigitalNumbers  # digital numbers, shape (height, width), uint8 or uint16, 0 to 2**bit_depth − 1; made read-only
    bit_depth: int  # bits per pixel, 1 to 16
    settings: FrameSettings  # what the frame was taken with
    frame_id: int | None = None  # running number given by the device; None where there is none
    # Further facts from the device (chunk data, counts of resent packets)
    extra: dict[str, float | int | str] = field(default_factory=dict)
    # The camera's own raw file that the numbers were read from; None where there is none
    file: CameraFile | None = None
    # Black level of each pixel above that of the settings, in DN, shape (height, width): of sensors with several taps
    black_offset_dn: NDArray[np.float32] | None = None
    black_u_dn: float = 0.0  # standard uncertainty of a row's part of it in DN

    @property
    def masked_dn(self) -> float | None:
        """Return what the sensor's masked pixels read in this frame, in DN; None where it is not stated."""
        masked = self.extra.get(MASKED_PIXELS)
        return float(masked) if isinstance(masked, int | float) else None

    def __post_init__(self) -> None:
        if self.dn.ndim != 2 or self.dn.dtype not in (np.uint8, np.uint16):
            raise InputError(
                f"a frame needs a two-dimensional uint8 or uint16 array, not {self.dn.dtype} {self.dn.shape}"
            )
        if not 1 <= self.bit_depth <= 8 * self.dn.dtype.itemsize:
            raise InputError(f"bit depth {self.bit_depth} does not fit {self.dn.dtype} pixels")
        view = self.dn.view()
        view.flags.writeable = False
        object.__setattr__(self, "dn", view)

    @property
    def full_scale_dn(self) -> int:
        """Return the highest digital number, 2**bit_depth − 1."""
        return (1 << self.bit_depth) - 1

    @property
    def saturated_dn(self) -> int:
        """Return the digital number from which pixels are saturated: the white level, else full scale."""
        known = self.settings.white_level
        return self.full_scale_dn if known is None else min(known.saturated_dn, self.full_scale_dn)

    @property
    def shape(self) -> tuple[int, int]:
        """Return (height, width) in pixels."""
        return (int(self.dn.shape[0]), int(self.dn.shape[1]))


class Copies:
    """Finds frames that are copies of earlier ones: noise differs from one exposure to the next.

    Attributes:
        count: Copies so far.
    """

    def __init__(self) -> None:
        self.count = 0
        self._seen = set[object]()

    def again(self, frame: Frame) -> bool:
        """Return whether a frame is a copy of one before, of the same exposure and gain."""
        rows = np.asarray(frame.dn[:: max(1, frame.dn.size // _LOOKED_AT)], np.uint16)
        key = zlib.crc32(rows.tobytes()), frame.shape, frame.settings.effective_exposure_s, frame.settings.shutter
        if key not in self._seen:
            self._seen.add(key)
            return False
        copied = float(np.mean((rows > rows.min()) & (rows < frame.full_scale_dn))) > _PICTURED
        self.count += copied
        return copied

    def left_out(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Yield the frames that are no copies."""
        return (frame for frame in frames if not self.again(frame))

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what to say of them, a sentence; nothing where there are none."""
        if not self.count:
            return ()
        copies = "1 frame is a copy" if self.count == 1 else f"{self.count} frames are copies"
        return (f"{copies} of another to the last pixel: no exposure counts twice",)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Bracket:
    """Frames of one scene, all of one size and bit depth, from the shortest effective exposure to the longest.

    A bracket is not iterable: `light` and `dark` say which frames are meant.
    """

    light: tuple[Frame, ...]  # frames with the shutter open, at least one
    dark: tuple[Frame, ...] = ()  # frames with the shutter closed, possibly none
    origin: str = ""  # where the frames came from, for messages and provenance

    @classmethod
    def from_frames(cls, frames: Iterable[Frame], origin: str = "") -> Self:
        """Return a bracket of the given frames, dark frames set apart and the rest sorted by exposure.

        Raises:
            InputError: If there is no light frame, or sizes or bit depths differ.
        """
        everything = list(frames)
        light = sorted((f for f in everything if not f.settings.is_dark), key=lambda f: f.settings.effective_exposure_s)
        dark = tuple(f for f in everything if f.settings.is_dark)
        return cls(tuple(light), dark, origin)

    def __post_init__(self) -> None:
        where = self.origin or "bracket"
        if not self.light:
            raise InputError(f"{where}: holds no frame with the shutter open")
        first = self.light[0]
        for frame in self.every_frame:
            if frame.shape != first.shape:
                raise InputError(
                    f"{where}: frames differ in size ({frame.shape[1]} × {frame.shape[0]} and "
                    f"{first.shape[1]} × {first.shape[0]} pixels); all frames of a bracket need one size"
                )
            if frame.bit_depth != first.bit_depth:
                raise InputError(
                    f"{where}: frames differ in bit depth ({frame.bit_depth} and {first.bit_depth}); "
                    "take the whole bracket in one pixel format"
                )

    def thinned(self, most_pixels: int) -> Bracket:
        """Return every n-th pixel of every n-th row where there are more than so many, n odd; itself where not."""
        pixels = self.shape[0] * self.shape[1]
        if pixels <= most_pixels:
            return self
        step = math.ceil(math.sqrt(pixels / most_pixels))
        step += (step + 1) % 2

        def lattice(frame: Frame) -> Frame:
            dn: DigitalNumbers = np.ascontiguousarray(frame.dn[step // 2 :: step, step // 2 :: step])  # type: ignore[assignment]
            return replace(frame, dn=dn)

        return replace(
            self,
            light=tuple(lattice(frame) for frame in self.light),
            dark=tuple(lattice(frame) for frame in self.dark),
        )

    if not TYPE_CHECKING:  # a type checker must find a loop over a bracket, not believe that it ends in an error

        def __iter__(self) -> NoReturn:
            """Raise TypeError: whoever loops over a bracket would lose its dark frames without notice."""
            raise TypeError("a Bracket is not iterable: loop over bracket.light, bracket.dark or bracket.every_frame")

    @property
    def every_frame(self) -> tuple[Frame, ...]:
        """Return dark and light frames, the dark ones first."""
        return (*self.dark, *self.light)

    def with_light(self, light: Iterable[Frame]) -> Bracket:
        """Return the bracket with other light frames, sorted by exposure, and its own dark frames."""
        return self.from_frames((*self.dark, *light), origin=self.origin)

    def __repr__(self) -> str:
        """Return number, size, bits and exposure times of the frames in one line, no pixels."""
        times = [frame.settings.exposure_s for frame in self.light]
        height, width = self.shape
        dark = f" + {len(self.dark)} dark" if self.dark else ""
        return (
            f"<Bracket {self.origin}: {len(self.light)}{dark} frames of {width} × {height} pixels, "
            f"{self.bit_depth} bits, {min(times):.4g} to {max(times):.4g} s>"
        )

    @property
    def bit_depth(self) -> int:
        """Return the bits per pixel."""
        return self.light[0].bit_depth

    @property
    def shape(self) -> tuple[int, int]:
        """Return (height, width) in pixels."""
        return self.light[0].shape

    @property
    def effective_exposures_s(self) -> NDArray[np.float64]:
        """Return exposure time × gain factor of every light frame in s, ascending."""
        return np.array([f.settings.effective_exposure_s for f in self.light])

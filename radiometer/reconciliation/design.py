"""Orders frames into captures (frames of one setting), cuts the picture into tiles, and holds what captures show."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import CaptureHeader, FrameSettings, Patch, TapDescription
from radiometer.data.thermometer import readings_c, regulated, uncertainty_of_readings
from radiometer.errors import CaptureError
from radiometer.typing import Array

# Patterns of these names show the first pattern's patches in another surround.
BRIGHT_SURROUND: Final = "bright_surround"
DARK_SURROUND: Final = "dark_surround"
GRID_COLUMNS: Final = 6
GRID_ROWS: Final = 4
SMALLEST_TILE_PX: Final = 6
SURFACE_TERMS: Final = 6  # of a tile's pixels that its quadratic surface takes out
SURFACE_LINES: Final = 3  # of its rows or columns
_NARROWEST_PX: Final = 3  # what a quadratic surface needs
_MARGIN_FRACTION: Final = 0.125  # keeps a tile's interior more than four blur sigmas from the patch's edge
_TEMPERATURE_STEP_K: Final = 0.75  # a larger change starts a new capture
_STAND_IN_SHARE: Final = 1e-3  # of the shortest exposure
_SERIES_PIECE: Final = 4  # frames of a long series that stand together
_SERIES_PIECES: Final = 64  # that all long series of a set are cut into, at most
_FEWEST_PIECES: Final = 4  # of one series: fewer tell nothing of the time
_SAME_TEMPERATURE_K: Final = 2.0  # width of a step of temperature within which a setting repeats


@dataclass(frozen=True, slots=True)
class Tile:
    """A rectangle of pixels that is treated as one sample of the scene, with what is known of its radiance.

    One amplifier reads all of it. A patch that several read is several tiles of one radiance.
    """

    name: str  # name of the patch, or of the grid cell
    patch: int  # number of the patch, or of the grid cell
    x: int  # left edge of the interior in pixels
    y: int  # top edge of the interior
    width: int  # width of the interior
    height: int  # height of the interior
    margin: int  # pixels between the interior and the patch's edge; 0 for a grid cell and for a part of a patch
    radiance: tuple[float | None, ...]  # known radiance in W·sr⁻¹·m⁻² by pattern; None where unknown
    u_rel: float | None = None  # relative standard uncertainty of the known radiance

    @property
    def slices(self) -> tuple[slice, slice]:
        """Return the (row, column) slices of the interior."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)


@dataclass(frozen=True, slots=True)
class Capture:
    """Frames taken one after the other under one setting."""

    frames: tuple[int, ...]  # their positions in the header, in order
    settings: FrameSettings  # the common setting; time and temperature are means


@dataclass(frozen=True, eq=False)
class Design:
    """Plan of a capture set: settings per capture and the tiles, without any pixel."""

    # What `capture.yaml` says, with a stand-in for exposures of 0 s and one temperature for readings in turn
    header: CaptureHeader
    shape: tuple[int, int]  # (height, width) of the frames in pixels
    captures: tuple[Capture, ...]  # captures in the order taken
    tiles: tuple[Tile, ...]  # tiles of the picture
    uniform: bool  # whether the tiles are known patches (uniform by design) rather than cells of an unknown scene
    # Standard uncertainty of a temperature reading in K; 0 where readings do not come in steps
    reading_u_k: float = 0.0
    jumps: tuple[int, ...] = ()  # positions of frames at which a long series of equal ones jumps; captures begin there

    @classmethod
    def of(cls, header: CaptureHeader, shape: tuple[int, int], jumps: Collection[int] = ()) -> Design:
        """Return the design of a capture set whose frames have the given (height, width).

        Args:
            jumps: Positions of frames at which a long series of equal ones is cut.

        Raises:
            CaptureError: If a patch or a tap is outside the frames, or a patch is too small to be judged.
        """
        reading_u_k = uncertainty_of_readings(readings_c(header))
        header = regulated(_without_zeros(header))
        tiles = _patch_tiles(header, shape) or _grid_tiles(header, shape)
        return cls(header, shape, group_captures(header, jumps), tiles, bool(header.patches), reading_u_k, tuple(jumps))

    @cached_property
    def patterns(self) -> tuple[str, ...]:
        """Return the names of the patterns that were shown, also those that only frames mention."""
        return _patterns(self.header)

    @cached_property
    def same_patches(self) -> tuple[int, ...]:
        """Return the patterns that show the first one's patches, itself among them; none where no other does."""
        others = tuple(p for p, name in enumerate(self.patterns) if p and name in (BRIGHT_SURROUND, DARK_SURROUND))
        return (0, *others) if others else ()

    @property
    def has_known_radiance(self) -> bool:
        """Return whether the radiance of any tile is stated."""
        return any(radiance for tile in self.tiles for radiance in tile.radiance)

    @cached_property
    def patch_of_tile(self) -> NDArray[np.intp]:
        """Return the number of the patch that each tile is a part of, rising from 0."""
        return np.array([tile.patch for tile in self.tiles], dtype=np.intp)

    @cached_property
    def tile_height(self) -> Array:
        """Return the height of each tile in pixels."""
        return np.array([tile.height for tile in self.tiles], dtype=np.float64)

    @cached_property
    def tile_width(self) -> Array:
        """Return the width of each tile in pixels."""
        return np.array([tile.width for tile in self.tiles], dtype=np.float64)

    @cached_property
    def rough_rows(self) -> Array:
        """Return what each tile's variance about its quadratic surface keeps of a pattern of rows."""
        return rough_share(self.tile_height, self.tile_width)

    @cached_property
    def rough_columns(self) -> Array:
        """Return the same of a pattern of columns."""
        return rough_share(self.tile_width, self.tile_height)

    @cached_property
    def rows_of_tiles(self) -> Array:
        """Return the share of each row of the frame in each tile, (tiles, rows)."""
        found = np.zeros((len(self.tiles), self.shape[0]))
        for number, tile in enumerate(self.tiles):
            found[number, tile.y : tile.y + tile.height] = 1.0 / tile.height
        return found

    @cached_property
    def tilts_of_rows(self) -> Array:
        """Return what each row of the frame adds to the tiles' rises from centre to bottom edge, (tiles, rows)."""
        tilts = np.zeros((len(self.tiles), self.shape[0]))
        for number, tile in enumerate(self.tiles):
            u = (2.0 * np.arange(tile.height) + 1.0) / tile.height - 1.0
            tilts[number, tile.y : tile.y + tile.height] = u / max(float(u @ u), 1e-12)
        return tilts

    def _column(self, name: str, missing: float = np.nan) -> Array:
        values = [getattr(capture.settings, name) for capture in self.captures]
        return np.array([missing if v is None else float(v) for v in values])

    @cached_property
    def exposure_s(self) -> Array:
        """Return the exposure time of each capture in s."""
        return self._column("exposure_s")

    @cached_property
    def gain_db(self) -> Array:
        """Return the gain of each capture in dB."""
        return self._column("gain_db")

    @cached_property
    def f_number(self) -> Array:
        """Return the f-number of each capture; the lens's where a frame states none, 1 where neither does."""
        return self._column("f_number", self.header.lens.f_number or 1.0)

    @cached_property
    def temperature_c(self) -> Array:
        """Return the sensor temperature of each capture in °C; NaN where unknown."""
        return self._column("temperature_c")

    @cached_property
    def timestamp_s(self) -> Array:
        """Return the time of each capture in s from the first; the running number where none is stated."""
        stamps = self._column("timestamp_s")
        if np.isnan(stamps).any():
            return np.arange(len(self.captures), dtype=np.float64)
        return np.asarray(stamps - stamps.min())

    def _of_frames(self, name: str) -> Array:
        return np.array([getattr(entry.settings, name) for entry in self.header.frames], dtype=np.float64)

    def _in_parts(self, of_frames: Array) -> tuple[Array, Array, Array]:
        """Return the mean of a figure of frames over all of each capture, its first one, and the others, if any."""
        all_ = [capture.frames for capture in self.captures]
        parts = (all_, [frames[:1] for frames in all_], [frames[1:] or frames for frames in all_])
        found = (np.array([float(np.mean(of_frames[list(frames)])) for frames in part]) for part in parts)
        return tuple(found)  # type: ignore[return-value]

    @cached_property
    def first_and_later(self) -> tuple[tuple[Array, Array, Array], ...]:
        """Return time in s, temperature in °C and time since light in s of the first frame of each capture.

        With it the mean of the same over the other frames; that of the first where there is no other.
        """
        times = self._in_parts(self._times_s) if self.has_timestamps else (self.timestamp_s,) * 3
        warm, since = self._in_parts(self._of_frames("temperature_c")), self._in_parts(self._since_light)
        return tuple(zip(times[1:], warm[1:], since[1:], strict=True))

    @cached_property
    def since_light_s(self) -> Array:
        """Return the mean time in s from the last frame with light to those of each capture; infinite without one."""
        return self._in_parts(self._since_light)[0]

    @cached_property
    def _since_light(self) -> Array:
        stamps, last = self._of_frames("timestamp_s"), -np.inf
        found = np.full(stamps.size, np.inf)
        for index in np.argsort(stamps, kind="stable").tolist() if np.isfinite(stamps).all() else ():
            found[index] = stamps[index] - last
            settings = self.header.frames[index].settings
            if not settings.is_dark and settings.source_level > 0:
                last = stamps[index]
        return found

    @cached_property
    def since_frame_s(self) -> tuple[Array, Array]:
        """Return the time in s from the frame before to the first frame of each capture, and to the others on average.

        Infinite for the first frame of all and where no times are known.
        """
        stamps = self._of_frames("timestamp_s")
        since, order = np.full(stamps.size, np.inf), np.argsort(stamps, kind="stable")
        if np.isfinite(stamps).all():
            since[order[1:]] = np.diff(stamps[order])
        return self._in_parts(since)[1:]

    def goes_on(self, number: int) -> bool:
        """Return whether a capture's frames follow, without a break, those of the capture before, of one setting."""
        before, own = self.captures[max(number - 1, 0)].frames, self.captures[number].frames
        return bool(before[-1] + 1 == own[0] and self.setting_id[number - 1] == self.setting_id[number])

    @cached_property
    def frame_numbers(self) -> tuple[Array, Array, Array]:
        """Return the numbers in the header of each capture's frames, of its first one and of the others."""
        return self._one_by_one(np.arange(len(self.header.frames), dtype=np.float64))

    @cached_property
    def frame_times_s(self) -> tuple[Array, Array, Array] | tuple[None, None, None]:
        """Return the same of the times in s, as captures have them; None where these are not known."""
        return self._one_by_one(self._times_s) if self.has_timestamps else (None, None, None)

    @property
    def _times_s(self) -> Array:
        return self._of_frames("timestamp_s") - float(np.min(self._column("timestamp_s")))

    def _one_by_one(self, of_frames: Array) -> tuple[Array, Array, Array]:
        """Return a figure of each capture's frames, of its first one and of the others."""
        all_ = np.full((len(self.captures), int(self.frame_count.max())), np.nan)
        for row, capture in zip(all_, self.captures, strict=True):
            row[: len(capture.frames)] = of_frames[list(capture.frames)]
        first, later = all_.copy(), all_.copy()
        first[:, 1:] = np.nan
        later[self.frame_count > 1, 0] = np.nan
        return all_, first, later

    @cached_property
    def has_timestamps(self) -> bool:
        """Return whether every capture states its time."""
        return not bool(np.isnan(self._column("timestamp_s")).any())

    @cached_property
    def jump_times_s(self) -> tuple[float, ...]:
        """Return the times in s, as captures have them, of those that begin with a jump."""
        return tuple(
            float(time)
            for time, capture in zip(self.timestamp_s, self.captures, strict=True)
            if capture.frames[0] in self.jumps
        )

    @cached_property
    def source_level(self) -> Array:
        """Return the relative drive of the source of each capture; 0 where the shutter is closed."""
        return np.where(self.closed, 0.0, self._column("source_level"))

    @cached_property
    def closed(self) -> NDArray[np.bool_]:
        """Return for each capture whether the shutter was closed."""
        return np.array([capture.settings.is_dark for capture in self.captures])

    @cached_property
    def frame_count(self) -> Array:
        """Return the number of frames of each capture."""
        return np.array([len(capture.frames) for capture in self.captures], dtype=np.float64)

    @cached_property
    def pattern_index(self) -> NDArray[np.intp]:
        """Return the position of each capture's pattern in `patterns`."""
        position = {name: i for i, name in enumerate(self.patterns)}
        return np.array([position[capture.settings.pattern] for capture in self.captures], dtype=np.intp)

    @cached_property
    def black_level_dn(self) -> Array:
        """Return the stated black level of each capture in DN; NaN where none is stated."""
        default = self.header.camera.black_level_dn
        return self._column("black_level_dn", np.nan if default is None else default)

    @cached_property
    def setting_id(self) -> NDArray[np.intp]:
        """Return a number for each capture that repeats of one setting share, temperatures alike within some kelvin."""
        steps = _steps_of_temperature(self.temperature_c).tolist()
        plain = [_setting_key(capture.settings) for capture in self.captures]
        keys = list(zip(plain, steps, strict=True))
        order = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        return np.array([order[key] for key in keys], dtype=np.intp)

    @property
    def held_out_id(self) -> NDArray[np.intp]:
        """Return a number for each capture that those left out together share: a setting's, if there are several.

        In a session of one setting nothing else would be left to predict it: each capture is left out alone.
        """
        return self.setting_id if self.setting_id.any() else np.arange(len(self.captures), dtype=np.intp)


def _without_zeros(header: CaptureHeader) -> CaptureHeader:
    """Return the header with a stand-in for bias frames' exposure of 0 s, far below every other.

    Exposures are compared by their logarithm; what a dark current makes of the stand-in is below what any of them
    shows.
    """
    if all(entry.exposure_s > 0 for entry in header.frames):
        return header
    shortest = min((entry.exposure_s for entry in header.frames if entry.exposure_s > 0), default=1.0)
    stand_in_s = _STAND_IN_SHARE * shortest
    frames = tuple(e if e.exposure_s > 0 else e.model_copy(update={"exposure_s": stand_in_s}) for e in header.frames)
    return header.model_copy(update={"frames": frames})


def _steps_of_temperature(temperature_c: Array) -> Array:
    """Return the number of the temperature step of each value; a separate number where it is unknown.

    The steps are placed so that most values are in the middle of one: two readings of one plateau are never apart.
    """
    turns = np.exp(2j * np.pi * temperature_c / _SAME_TEMPERATURE_K)
    middle = float(np.angle(np.mean(turns))) / (2.0 * np.pi) if np.isfinite(turns).all() else 0.0
    return np.asarray(np.nan_to_num(np.round(temperature_c / _SAME_TEMPERATURE_K - middle), nan=-1e6))


def rough_share(length: Array, across: Array) -> Array:
    """Return what a tile's variance about its quadratic surface keeps of a pattern of lines.

    The surface takes three of the tile's lines, but six of all its pixels.
    """
    kept = np.maximum(length - SURFACE_LINES, 1.0) * across
    return np.asarray(kept / np.maximum(length * across - SURFACE_TERMS, kept))


def group_captures(header: CaptureHeader, jumps: Collection[int] = ()) -> tuple[Capture, ...]:
    """Return the frames of a header as captures.

    A capture is a run of frames of one setting. A run that is a whole multiple of the usual length is several
    captures in a row. Where no two neighbouring frames share a setting, the repeats are gathered from the whole
    series. A long series of one setting whose times are known is cut into pieces, so that it shows what changes with
    time.

    Args:
        jumps: Positions of frames at which a long series is cut.
    """
    runs = _runs(header)
    lengths = Counter(map(len, runs))
    usual = max(lengths, key=lambda n: (lengths[n], -n))
    if usual == 1 and len({_key(header, run[0]) for run in runs}) < len(runs):
        return _gathered(header)
    pieces: list[list[int]] = []
    for run in runs:
        whole = usual > 1 and len(run) > usual and len(run) % usual == 0
        step = usual if whole else len(run)
        for first in range(0, len(run), step):
            pieces += _of_series(header, run[first : first + step], _SERIES_PIECES // len(runs), jumps)
    return tuple(_capture(header, piece) for piece in pieces)


def _of_series(header: CaptureHeader, run: list[int], most: int, jumps: Collection[int]) -> list[list[int]]:
    """Return a series of equal frames in up to so many pieces of like length; whole if it is short or has no times."""
    count = min(len(run) // _SERIES_PIECE, most)
    if count < _FEWEST_PIECES or any(header.frames[index].timestamp_s is None for index in run):
        return [run]
    ends = [0, *(place for place, frame in enumerate(run) if place and frame in jumps), len(run)]
    parts = [run[low:high] for low, high in itertools.pairwise(ends)]
    return [
        piece.tolist() for part in parts for piece in np.array_split(part, max(round(count * len(part) / len(run)), 1))
    ]


def _runs(header: CaptureHeader) -> list[list[int]]:
    runs: list[list[int]] = []
    for index in range(len(header.frames)):
        if runs and _same_capture(header, runs[-1][0], index):
            runs[-1].append(index)
        else:
            runs.append([index])
    return runs


def _gathered(header: CaptureHeader) -> tuple[Capture, ...]:
    groups: dict[Any, list[int]] = {}
    warm = [entry.temperature_C for entry in header.frames]
    steps = _steps_of_temperature(np.array([np.nan if t is None else t for t in warm], dtype=np.float64)).tolist()
    for index, step in enumerate(steps):
        groups.setdefault((step, _key(header, index)), []).append(index)
    return tuple(_capture(header, group) for group in groups.values())


def _same_capture(header: CaptureHeader, first: int, other: int) -> bool:
    if _key(header, first) != _key(header, other):
        return False
    cold, warm = header.frames[first].temperature_C, header.frames[other].temperature_C
    return cold is None or warm is None or abs(cold - warm) < _TEMPERATURE_STEP_K


def _key(header: CaptureHeader, index: int) -> Any:
    return _setting_key(header.frames[index].settings)


def _setting_key(settings: FrameSettings) -> Any:
    level = 0.0 if settings.is_dark else settings.source_level
    return (
        settings.exposure_s,
        settings.gain_db,
        settings.f_number,
        settings.black_level_dn,
        level,
        "" if settings.is_dark else settings.pattern,
        settings.shutter,
    )


def _capture(header: CaptureHeader, frames: Sequence[int]) -> Capture:
    settings = [header.frames[i].settings for i in frames]
    stamps = [s.timestamp_s for s in settings if s.timestamp_s is not None]
    warm = [s.temperature_c for s in settings if s.temperature_c is not None]
    common = replace(
        settings[0],
        timestamp_s=float(np.mean(stamps)) if len(stamps) == len(settings) else None,
        temperature_c=float(np.mean(warm)) if len(warm) == len(settings) else None,
    )
    return Capture(tuple(frames), common)


def _patterns(header: CaptureHeader) -> tuple[str, ...]:
    shown = dict.fromkeys(frame.pattern for frame in header.frames)
    return tuple(dict.fromkeys((*(name for name in header.patterns if name in shown), *shown)))


def _patch_tiles(header: CaptureHeader, shape: tuple[int, int]) -> tuple[Tile, ...]:
    tiles = list[Tile]()
    for number, patch in enumerate(header.patches):
        if not patch.patch.fits(shape):
            raise CaptureError(
                f"patch {patch.name!r} ({patch.x}, {patch.y}, {patch.width} × {patch.height}) is outside the "
                f"{shape[1]} × {shape[0]} frames; correct it in capture.yaml"
            )
        smaller = min(patch.width, patch.height)
        margin = max(1, round(_MARGIN_FRACTION * smaller)) if smaller >= SMALLEST_TILE_PX + 2 else 0
        if smaller - 2 * margin < _NARROWEST_PX:
            raise CaptureError(f"patch {patch.name!r} is only {smaller} pixels wide; reconcile needs at least 3")
        known = tuple(patch.radiance(name) for name in _patterns(header))
        inner = (patch.x + margin, patch.y + margin, patch.width - 2 * margin, patch.height - 2 * margin)
        tiles += _parts(Tile(patch.name, number, *inner, margin, known, patch.u_rel), header.camera.taps or ())
    return tuple(tiles)


def _parts(tile: Tile, taps: Sequence[TapDescription]) -> list[Tile]:
    """Return the parts of a tile that different amplifiers read, without those that are too narrow."""
    found = []
    for tap in taps:
        x, y = max(tile.x, tap.x), max(tile.y, tap.y)
        width = min(tile.x + tile.width, tap.x + tap.width) - x
        height = min(tile.y + tile.height, tap.y + tap.height) - y
        if (width, height) == (tile.width, tile.height):
            return [tile]
        if min(width, height) >= _NARROWEST_PX:
            found.append(replace(tile, x=x, y=y, width=width, height=height, margin=0))
    return found or [tile]


def _grid_tiles(header: CaptureHeader, shape: tuple[int, int]) -> tuple[Tile, ...]:
    patterns = len(_patterns(header))
    areas = [(f"tap {tap.name} ", tap.patch) for tap in header.camera.taps or ()]
    for name, area in areas:
        if not area.fits(shape):
            raise CaptureError(
                f"{name}({area.x}, {area.y}, {area.width} × {area.height}) is outside the "
                f"{shape[1]} × {shape[0]} frames; correct camera.taps in capture.yaml"
            )
    tiles = list[Tile]()
    for name, area in areas or [("", Patch(0, 0, shape[1], shape[0]))]:
        rows = _cells(GRID_ROWS, area.height, shape[0])
        columns = _cells(GRID_COLUMNS, area.width, shape[1])
        height, width = area.height // rows, area.width // columns
        if min(height, width) < _NARROWEST_PX:
            raise CaptureError(
                f"{name or 'frames '}of {area.width} × {area.height} pixels are too small to be judged; use larger ones"
            )
        for row, column in itertools.product(range(rows), range(columns)):
            place = (area.x + column * width, area.y + row * height, width, height)
            tiles.append(Tile(f"{name}r{row}c{column}", len(tiles), *place, 0, (None,) * patterns))
    return tuple(tiles)


def _cells(whole: int, length: int, frame: int) -> int:
    return max(1, min(round(whole * length / frame), length // SMALLEST_TILE_PX))


SHORTEST_PART_PX: Final = 4  # of a line, below which it is unknown whether it is even
LINES: Final = 7  # from one line inside a patch's stated border to five lines outside it


@dataclass(frozen=True, slots=True, eq=False)
class TileGroup:
    """All tiles of one size."""

    index: NDArray[np.intp]  # their positions in the design
    tiles: tuple[Tile, ...]  # the tiles
    height: int  # height of each in pixels
    width: int  # width of each in pixels
    trend: Array  # orthonormal basis of the smooth shapes 1, u, v, u², uv, v² in a tile, shape (height × width, 6)
    # Length of u and v over the tile; a coefficient divided by it is the rise from centre to edge
    slope_norm: tuple[float, float]
    rows: NDArray[np.intp]  # sensor row of each tile row, shape (tiles, height)
    columns: NDArray[np.intp]  # sensor column of each tile column, shape (tiles, width)

    def cut(self, image: NDArray[np.generic]) -> Array:
        """Return the tiles' pixels, shape (tiles, height, width), as float64."""
        return np.stack([image[tile.slices] for tile in self.tiles]).astype(np.float64)


def tile_groups(design: Design) -> tuple[TileGroup, ...]:
    """Return the tiles of a design, gathered by size."""
    sizes = dict.fromkeys((tile.height, tile.width) for tile in design.tiles)
    return tuple(_group(design.tiles, height, width) for height, width in sizes)


def slope_lengths(design: Design) -> tuple[Array, Array]:
    """Return the length of the tilts over each tile: a coefficient divided by it is the rise from centre to edge.

    The squares of the centres of n equal cells of −1 … 1 sum to (n² − 1)/(3n).
    """
    width, height = design.tile_width, design.tile_height
    across, down = ((n**2 - 1.0) / (3.0 * n) for n in (width, height))
    return np.sqrt(height * across), np.sqrt(width * down)


def _group(tiles: Sequence[Tile], height: int, width: int) -> TileGroup:
    index = [i for i, tile in enumerate(tiles) if (tile.height, tile.width) == (height, width)]
    chosen = tuple(tiles[i] for i in index)
    u, v = (math.sqrt(across) * float(np.linalg.norm(_centred(n))) for n, across in ((width, height), (height, width)))
    return TileGroup(
        np.array(index, dtype=np.intp),
        chosen,
        height,
        width,
        surface(height, width),
        (u, v),
        np.array([np.arange(tile.y, tile.y + height) for tile in chosen]),
        np.array([np.arange(tile.x, tile.x + width) for tile in chosen]),
    )


def surface(height: int, width: int) -> Array:
    """Return an orthonormal basis of the smooth shapes 1, u, v, u², uv, v² over pixels, (height × width, 6)."""
    v, u = np.meshgrid(_centred(height), _centred(width), indexing="ij")
    shapes = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(height * width, SURFACE_TERMS)
    trend, _ = np.linalg.qr(shapes)
    return np.asarray(trend * np.sign(np.sum(trend * shapes, axis=0)))


def _centred(count: int) -> Array:
    return (2.0 * np.arange(count) + 1.0) / count - 1.0


@dataclass(frozen=True, slots=True, eq=False)
class PatchSides:
    """The sides of all patches as lines of pixels, from just inside the patch outwards."""

    tile: NDArray[np.intp]  # tile of each side
    rows: NDArray[np.intp]  # sensor row of every pixel, shape (sides, lines, pixels)
    columns: NDArray[np.intp]  # sensor column of every pixel, same shape

    def pixels(self, image: NDArray[np.generic]) -> Array:
        """Return the pixels of every line, (sides, lines, pixels), as float64."""
        return image[self.rows, self.columns].astype(np.float64)

    @property
    def parts(self) -> tuple[slice, ...]:
        """Return the parts of a side that are judged apart: the whole, and its thirds where these are long enough."""
        length = self.rows.shape[2]
        ends = [round(length * i / 3) for i in range(4)] if length >= 3 * SHORTEST_PART_PX else []
        return (slice(0, length), *(slice(a, b) for a, b in itertools.pairwise(ends)))

    @property
    def along_rows(self) -> NDArray[np.bool_]:
        """Return for each side whether its lines run along rows, so that what crosses it goes down the columns."""
        return np.asarray(self.rows[:, 0, 0] == self.rows[:, 0, -1])

    def lines(self, pixels: Array) -> tuple[Array, Array]:
        """Return the mean of every line and the variance along it, for all parts of all sides.

        Args:
            pixels: (sides, lines, pixels) mean of each pixel over the frames of a capture, in DN.

        Returns:
            Means in DN and variances in DN², (parts × sides, lines), the whole sides first.
        """
        cut = [pixels[:, :, part] for part in self.parts]
        return np.concatenate([p.mean(axis=2) for p in cut]), np.concatenate([_unevenness(p) for p in cut])


def _unevenness(pixels: Array) -> Array:
    if pixels.shape[-1] < SHORTEST_PART_PX:
        return np.zeros(pixels.shape[:-1])
    return np.asarray(pixels.var(axis=-1, ddof=1))


def patch_sides(design: Design) -> PatchSides:
    """Return the sides of all patches; none for cells of an unknown scene.

    Lines that would leave the frame repeat its border.
    """
    found = [side for number, tile in enumerate(design.tiles) if tile.margin for side in _sides(number, tile)]
    if not found:
        nothing = np.zeros((0, LINES, 1), dtype=np.intp)
        return PatchSides(np.zeros(0, dtype=np.intp), nothing, nothing)
    length = min(rows.shape[1] for _, rows, _ in found)
    height, width = design.shape
    return PatchSides(
        np.array([tile for tile, _, _ in found], dtype=np.intp),
        np.clip(np.stack([rows[:, :length] for _, rows, _ in found]), 0, height - 1),
        np.clip(np.stack([columns[:, :length] for _, _, columns in found]), 0, width - 1),
    )


def _sides(number: int, tile: Tile) -> list[tuple[int, NDArray[np.intp], NDArray[np.intp]]]:
    outwards = np.arange(-1, LINES - 1)[:, None]
    along_y = np.arange(tile.y, tile.y + tile.height)[None, :]
    along_x = np.arange(tile.x, tile.x + tile.width)[None, :]
    left, right = tile.x - tile.margin, tile.x + tile.width + tile.margin
    top, bottom = tile.y - tile.margin, tile.y + tile.height + tile.margin
    pairs = [
        np.broadcast_arrays(along_y, left - 1 - outwards),
        np.broadcast_arrays(along_y, right + outwards),
        np.broadcast_arrays(top - 1 - outwards, along_x),
        np.broadcast_arrays(bottom + outwards, along_x),
    ]
    return [(number, rows, columns) for rows, columns in pairs]


# ---- what captures show ---------------------------------------------------------------------------------------------
COMB_PERIODS: Final = (2, 3, 4, 5)  # a coarser step shows at one of its divisors


@dataclass(frozen=True, slots=True, eq=False)
class CaptureStatistics:
    """Measured statistics, per capture and tile: arrays (captures, tiles) in DN, or (captures,) where noted."""

    mean: Array  # mean of all frames
    variance: Array  # temporal variance of a pixel, each frame's tile mean removed
    variance_dof: Array  # degrees of freedom of `variance`
    spatial: Array  # variance of the time mean from pixel to pixel about a quadratic surface
    spatial_dof: Array  # degrees of freedom of `spatial`
    slope_x: Array  # rise of the time mean from the tile's centre to its right edge
    slope_y: Array  # rise from the centre to the bottom edge
    neighbour_x: Array  # correlation of the temporal fluctuation of horizontal neighbours
    neighbour_y: Array  # the same of vertical neighbours
    first: Array  # first frame minus the mean of the others
    pixels: Array  # pixels of the tile that count (defects taken out)
    peak: Array  # time mean of the brightest of them
    low: Array  # share of samples at 0 DN
    high: Array  # share of samples at full scale
    common: Array  # (captures,) variance of the frame-common relative fluctuation over what pixel noise alone gives
    common_unit: Array  # (captures,) relative variance that pixel noise alone gives it
    black: Array  # (captures,) variance in DN² of an offset that all tiles of a frame share, steady change taken out
    black_unit: Array  # (captures,) what pixel noise alone gives it
    black_dof: Array  # (captures,) its degrees of freedom; 0 where the frames are too few
    drift: Array  # (captures,) the same of half a wave down the frame, as a random walk of the black level has it
    drift_unit: Array  # (captures,) what pixel noise alone gives it
    drift_dof: Array  # (captures,) its degrees of freedom
    row_temporal: Array  # (captures,) variance of row means from frame to frame over what pixel noise alone gives
    row_temporal_weight: Array  # (captures,) its sensitivity: mean over rows of Σ 1/variance, in DN⁻²
    row_temporal_dof: Array  # (captures,) its degrees of freedom
    row_temporal_light: Array  # (captures,) what rows whose light differs by 100 % would add to it
    # (captures, orders) variance of a spatial frequency of the rows' light over what pixel noise alone gives
    bands: Array
    bands_basis: Array  # (captures, 1 + orders, bins) functions of the rows, see `lines`
    bands_of_rows: Array  # (captures, orders) what 1 DN² of row noise adds
    columns: Array  # (captures,) variance of fixed column means over what the fixed pixel pattern alone gives
    columns_weight: Array  # (captures,) its sensitivity in DN⁻²
    columns_dof: Array  # (captures,) its degrees of freedom
    rows: Array  # (captures,) the same of rows
    rows_weight: Array  # (captures,) in DN⁻²
    rows_dof: Array  # (captures,) degrees of freedom
    edge: Array  # (captures,) share of a step at a patch's edge that is in the last line inside it
    edge_u: Array  # (captures,) its standard uncertainty; infinite where no edge is seen
    outliers: Array  # (captures,) pixels that stand out of their tile by more than 6 robust sigmas
    unsteady: Array  # (captures,) pixels that scatter far more than their tile without their highest frame, too
    comb: Array  # (captures, periods) amplitude of a regular comb in the histogram, real part of its Fourier term
    comb_count: Array  # (captures,) samples in that histogram

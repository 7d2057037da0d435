"""Descriptor files of the EMVA 1288 working group: lists of images with exposure and photons."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Final

from radiometer.data.guards import is_file
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.storage import read_text
from radiometer.errors import InputError
from radiometer.units import read_number, unit_of

DESCRIPTOR_NAME: Final = "EMVA1288_Data.txt"


@dataclass(frozen=True, slots=True)
class EmvaEntry:
    """The images of one setting."""

    exposure_s: float  # exposure in s; 0 where the file states 0 (a bias frame, or light that does not follow it)
    photons: float  # mean photons per pixel; 0 for dark images
    files: tuple[Path, ...]  # the images


@dataclass(frozen=True, slots=True)
class EmvaListing:
    """What a descriptor file says: bits per pixel, width and height in pixels, and the images by setting."""

    path: Path
    bit_depth: int
    width: int
    height: int
    entries: tuple[EmvaEntry, ...]

    @classmethod
    @bounded_reader(error=InputError)
    def read(cls, path: Path) -> EmvaListing:
        """Return a descriptor file.

        Lines are `v standard`, `n bits width height`, `b exposure_ns photons`, `d exposure_ns` and `i image`, the
        image relative to the file, with either kind of slash; `#` starts a comment.

        Raises:
            InputError: If a line is not understood, there is no image, or one is missing; the message gives the line.
        """
        lines = read_text(path).splitlines()
        parser = _Parser(path)
        for number, line in enumerate(lines, 1):
            words = line.split()
            if words and not words[0].startswith("#"):
                parser.take(words[0], line.strip()[len(words[0]) :].strip(), number)
        return parser.finish()


def find_descriptor(path: Path) -> Path | None:
    """Return the descriptor that a path names, itself or in its folder; None where there is none."""
    if path.is_file():
        return path if path.suffix.lower() == ".txt" and looks_like_descriptor(path) else None
    inside = path / DESCRIPTOR_NAME
    return inside if inside.is_file() else None


def looks_like_descriptor(path: Path) -> bool:
    """Return whether a text file begins with the lines of a descriptor: v, n, b or d with numbers."""
    try:
        with path.open(encoding="utf-8", errors="strict") as stream:
            head = [line.split() for line, _ in zip(stream, range(200), strict=False)]
    except (OSError, UnicodeDecodeError):
        return False
    rows = [words for words in head if words and not words[0].startswith("#")]
    return bool(rows) and all(words[0] in ("v", "n", "b", "d", "i") and len(words) > 1 for words in rows[:4])


class _Parser:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._format: tuple[int, int, int] | None = None
        self._entries: list[tuple[float, float, list[Path]]] = []

    def take(self, command: str, rest: str, number: int) -> None:
        where = f"{self._path}, line {number}"
        try:
            self._dispatch(command, rest, where)
        except (ValueError, IndexError) as error:
            raise InputError(f"{where}: {command} {rest}: is not understood ({error})") from error

    def finish(self) -> EmvaListing:
        if self._format is None:
            raise InputError(f"{self._path}: holds no line 'n bits width height'")
        entries = tuple(EmvaEntry(s, photons, tuple(files)) for s, photons, files in self._entries if files)
        if not entries:
            raise InputError(f"{self._path}: lists no image")
        return EmvaListing(self._path, *self._format, entries)

    def _dispatch(self, command: str, rest: str, where: str) -> None:
        words = rest.split()
        if command == "n":
            self._format = (int(words[0]), int(words[1]), int(words[2]))
        elif command == "b":
            photons, unit = read_number(words[1])
            if unit or len(words) > 2:
                raise ValueError("expected the exposure in ns and the photons per pixel")
            self._begin(_exposure_s(words[0]), photons)
        elif command == "d":
            if len(words) > 1:
                raise ValueError("expected the exposure in ns alone")
            self._begin(_exposure_s(words[0]), 0.0)
        elif command == "i":
            self._add_image(rest, where)
        elif command != "v":
            raise ValueError("a line begins with v, n, b, d or i")

    def _begin(self, exposure_s: float, photons: float) -> None:
        if not 0 <= exposure_s < float("inf"):
            raise ValueError("the exposure must be 0 ns or above")
        if not 0 <= photons < float("inf"):
            raise ValueError("the photons must be 0 or above")
        self._entries.append((exposure_s, photons, []))

    def _add_image(self, name: str, where: str) -> None:
        if not self._entries:
            raise ValueError("an image comes before the first b or d line")
        file = self._path.parent.joinpath(*PureWindowsPath(name).parts)
        if not is_file(file):
            raise InputError(f"{where}: image {file} does not exist")
        self._entries[-1][2].append(file)


def _exposure_s(word: str) -> float:
    """Return an exposure in s from one in ns, as the format has it, or in the unit that the word ends with."""
    value, spelling = read_number(word)
    unit = unit_of(spelling or "ns", "exposure")
    if unit is None:
        raise ValueError(f"{spelling!r} is no unit of time")
    return unit.to_base(value)

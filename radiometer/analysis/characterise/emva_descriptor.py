"""Descriptor files of the EMVA 1288 working group: lists of images with exposure and photons."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from radiometer.analysis.characterise.frame_groups import FrameGroup
from radiometer.data import FrameSettings
from radiometer.errors import InputError

DESCRIPTOR_NAME = "EMVA1288_Data.txt"


@dataclass(frozen=True, slots=True)
class EmvaDescriptor:
    """What a descriptor file says.

    Attributes:
        path: The file.
        bit_depth: Bits per pixel.
        width: Pixels per row.
        height: Rows.
        groups: Images of each setting; photons 0 for dark ones.
    """

    path: Path
    bit_depth: int
    width: int
    height: int
    groups: tuple[FrameGroup, ...]

    @classmethod
    def read(cls, path: Path) -> EmvaDescriptor:
        """Return a descriptor file.

        Lines are `v standard`, `n bits width height`, `b exposure_ns photons`, `d exposure_ns` and `i image`, the
        image relative to the file, with either kind of slash; `#` starts a comment.

        Raises:
            InputError: If a line is not understood, there is no image, or one is missing; the message gives the line.
        """
        try:
            lines = path.read_text(encoding="utf-8", errors="strict").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot read {path}: {error}") from error
        parser = _Parser(path)
        for number, line in enumerate(lines, 1):
            words = line.split()
            if words and not words[0].startswith("#"):
                parser.take(words[0], line.strip()[len(words[0]) :].strip(), number)
        return parser.finish()


class _Parser:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._format: tuple[int, int, int] | None = None
        self._groups: list[tuple[FrameSettings, float | None, list[Path]]] = []

    def take(self, command: str, rest: str, number: int) -> None:
        where = f"{self._path}, line {number}"
        try:
            self._dispatch(command, rest, where)
        except (ValueError, IndexError) as error:
            raise InputError(f"{where}: {command} {rest}: is not understood ({error})") from error

    def finish(self) -> EmvaDescriptor:
        if self._format is None:
            raise InputError(f"{self._path}: holds no line 'n bits width height'")
        groups = tuple(FrameGroup(s, tuple(files), photons) for s, photons, files in self._groups if files)
        if not groups:
            raise InputError(f"{self._path}: lists no image")
        return EmvaDescriptor(self._path, *self._format, groups)

    def _dispatch(self, command: str, rest: str, where: str) -> None:
        numbers = rest.replace(",", ".").split()
        if command == "n":
            self._format = (int(numbers[0]), int(numbers[1]), int(numbers[2]))
        elif command == "b":
            self._begin(float(numbers[0]), float(numbers[1]))
        elif command == "d":
            self._begin(float(numbers[0]), 0.0)
        elif command == "i":
            self._add_image(rest, where)
        elif command != "v":
            raise ValueError("a line begins with v, n, b, d or i")

    def _begin(self, exposure_ns: float, photons: float) -> None:
        if exposure_ns <= 0:
            raise ValueError("the exposure must be above 0 ns")
        shutter = "closed" if photons == 0 else "open"
        settings = FrameSettings(exposure_s=exposure_ns * 1e-9, shutter=shutter)  # type: ignore[arg-type]
        self._groups.append((settings, photons, []))

    def _add_image(self, name: str, where: str) -> None:
        if not self._groups:
            raise ValueError("an image comes before the first b or d line")
        file = self._path.parent.joinpath(*PureWindowsPath(name).parts)
        if not file.is_file():
            raise InputError(f"{where}: image {file} does not exist")
        self._groups[-1][2].append(file)

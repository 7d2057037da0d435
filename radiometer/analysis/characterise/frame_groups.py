"""Frames taken at one setting, found in a capture set."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radiometer.data import CaptureSet, FrameSettings
from radiometer.data.capture_set import read_digital_numbers
from radiometer.data.frame import DigitalNumbers
from radiometer.errors import CaptureError

_SAME_TEMPERATURE_K = 1.5


@dataclass(frozen=True, slots=True)
class FrameGroup:
    """Frames of one setting, still on disk.

    Attributes:
        settings: The setting; temperature and time are those of the first frame.
        files: Their files.
        photons: Mean photons per pixel where a descriptor states them; None elsewhere.
        reader: Returns the digital numbers of a file.
    """

    settings: FrameSettings
    files: tuple[Path, ...]
    photons: float | None = None
    reader: Callable[[Path], DigitalNumbers] = read_digital_numbers

    def read(self, full_scale_dn: int) -> Iterator[DigitalNumbers]:
        """Yield the frames' digital numbers.

        Raises:
            CaptureError: If a file is unreadable, of another size than the first, or above full scale.
        """
        shape: tuple[int, ...] | None = None
        for file in self.files:
            dn = self.reader(file)
            if shape not in (None, dn.shape):
                raise CaptureError(f"{file}: differs in size from the other frames of its setting")
            if int(dn.max(initial=0)) > full_scale_dn:
                raise CaptureError(f"{file}: holds the value {int(dn.max())}, above full scale {full_scale_dn}")
            shape = dn.shape
            yield dn


def groups_of_capture(capture: CaptureSet) -> list[FrameGroup]:
    """Return the frames of a capture set by setting, in the order the settings first appear.

    Temperatures within 1.5 K count as one; level and pattern of dark frames do not matter.
    """
    found: dict[tuple[object, ...], list[int]] = {}
    settings = [entry.settings for entry in capture.header.frames]
    plateaus = _temperature_plateaus([one.temperature_c for one in settings])
    for index, one in enumerate(settings):
        photons = capture.header.frames[index].photons
        light = () if one.is_dark else (one.source_level, one.pattern, one.f_number, photons)
        key = (one.exposure_s, one.gain_db, one.black_level_dn, one.shutter, plateaus[index], *light)
        found.setdefault(key, []).append(index)
    return [_group(capture, settings, members) for members in found.values()]


def _group(capture: CaptureSet, settings: list[FrameSettings], members: list[int]) -> FrameGroup:
    temperatures = [t for i in members if (t := settings[i].temperature_c) is not None]
    mean = float(np.mean(temperatures)) if temperatures else None
    entries = [capture.header.frames[i] for i in members]
    first = replace(settings[members[0]], temperature_c=mean)
    if capture.store is None:
        return FrameGroup(first, tuple(capture.path / entry.file for entry in entries), entries[0].photons)
    names = {Path(entry.file): entry.file for entry in entries}
    return FrameGroup(first, tuple(names), entries[0].photons, lambda file: capture.read_numbers(names[file]))


def _temperature_plateaus(temperatures: list[float | None]) -> list[int]:
    """Return the number of the plateau that each temperature belongs to (gaps above 1.5 K part them)."""
    known = np.unique([t for t in temperatures if t is not None])
    edges = known[1:][np.diff(known) > _SAME_TEMPERATURE_K]
    return [-1 if t is None else int(np.searchsorted(edges, t, side="right")) for t in temperatures]

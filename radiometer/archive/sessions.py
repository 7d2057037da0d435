"""Sessions of cameras in an archive: capture sets and folders of other laboratories' files, each characterised."""

from __future__ import annotations

import datetime as dt
import glob
import os
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.analysis.characterise import Characterisation, characterise, subject_of_capture
from radiometer.analysis.characterise.dark_signal import by_temperature, level_at_0_s, typical_rates, unbent
from radiometer.analysis.characterise.group_statistics import GroupStatistics
from radiometer.analysis.characterise.subject import groups_of_capture
from radiometer.data import CameraDescription, CaptureSet, FrameSettings, Quantity
from radiometer.data.capture_set import HEADER_NAME
from radiometer.data.raw_files import RAW_SUFFIXES
from radiometer.errors import InputError, MeasurementError, RadiometerError, UnsettledError
from radiometer.importing import import_sources
from radiometer.importing.emva_listing import DESCRIPTOR_NAME
from radiometer.importing.photograph_pixels import IMAGE_SUFFIXES
from radiometer.importing.sources import FITS_SUFFIXES, TIFF_SUFFIXES, as_capture
from radiometer.moments import moment_of

_CLIPS: Final = 0.002  # part of the pixels at full scale from which a mean says nothing of the light
_FRAME_SUFFIXES: Final = (*FITS_SUFFIXES, *TIFF_SUFFIXES)
_PICTURE_SUFFIXES: Final = (*_FRAME_SUFFIXES, *IMAGE_SUFFIXES, *RAW_SUFFIXES)


def find_captures(archive: str) -> tuple[list[Path], list[Path]]:
    """Return the finished capture sets of an archive and the folders of other frames or photographs, both sorted.

    The unfinished capture set is named, where its folder `frames` is all that there is of it.

    Args:
        archive: A folder, searched at any depth, or a glob such as "2026-*/bench-1".

    Raises:
        InputError: If there is no capture set.
    """
    matches = [archive] if Path(archive).is_dir() else glob.glob(archive, recursive=True)  # noqa: PTH207 (any root)
    roots = [Path(found) for found in matches if Path(found).is_dir()]
    finished = sorted({file.parent for root in roots for file in _files_below(root) if file.name == HEADER_NAME})
    foreign = {folder for root in roots for folder in _foreign_folders(root, finished, _PICTURE_SUFFIXES)}
    if not finished:
        raise InputError(
            f"{archive}: holds no capture set (no folder with {HEADER_NAME}); name their folder, or a glob"
        )
    return finished, sorted({folder.parent if folder.name == "frames" else folder for folder in foreign})


@dataclass(frozen=True, slots=True)
class LightSeries:
    """Frames of one bright setting: their signal above black in DN, in the order they were taken."""

    exposure_s: float
    gain_db: float
    source_level: float
    pattern: str
    files: tuple[str, ...]
    signal_dn: tuple[float, ...]

    @property
    def setting(self) -> tuple[float, float, float, str]:
        """Return what must be equal for two series to be compared."""
        return (self.exposure_s, self.gain_db, self.source_level, self.pattern)


@dataclass(frozen=True, slots=True)
class Session:
    """One session of one camera."""

    name: str  # folder, with the camera's name where it holds several
    camera: tuple[str, ...]  # maker, model, serial number and band; what is unknown is left out
    taken: dt.datetime | None  # time of its first frame; None where unknown
    stated_e_per_dn: float | None  # conversion gain that its headers state; None where unknown
    figures: dict[str, Quantity]  # EMVA 1288 figures that it gives
    # (temperature in °C, u in K, dark current in DN/s) of each plateau
    dark_rates: tuple[tuple[float, float, Quantity], ...]
    series: tuple[LightSeries, ...]  # bright frames
    notes: tuple[str, ...]  # what a user must know


def find_sessions(archive: Path) -> list[CaptureSet]:
    """Return the sessions of an archive, one per folder and camera, at any depth.

    Raises:
        InputError: If there is none.
        UnsettledError: If frames state a number without a known unit.
    """
    if not archive.is_dir():
        raise InputError(f"{archive} is no folder; name one that holds capture sets or folders of frames")
    own = sorted({file.parent for file in _files_below(archive) if file.name == HEADER_NAME})
    found = [CaptureSet.read(folder) for folder in own]
    for folder in _foreign_folders(archive, own):
        try:
            several = import_sources(_direct_files(folder))
        except UnsettledError:
            raise  # it holds frames, but what they state must be settled first
        except InputError:
            continue  # none of its files is a frame
        for one in several:
            name = folder if len(several) == 1 else folder / one.title
            found.append(as_capture(one, name))
    if not found:
        raise InputError(f"{archive}: holds no capture set, and no folder of FITS or raw TIFF frames")
    return found


def read_session(capture: CaptureSet, report: Callable[[str], None] = lambda line: None) -> Session:
    """Return what one session shows of its camera; a note replaces what cannot be determined.

    Raises:
        CaptureError: If a frame is unreadable.
    """
    report(capture.path.name)
    camera = capture.header.camera
    subject = subject_of_capture(capture)
    statistics = subject.statistics()
    result: Characterisation | None = None
    notes: tuple[str, ...] = ()
    try:
        result = characterise(subject, statistics)
        notes = result.notes
    except MeasurementError as error:
        notes = (str(error),)
    main = max(statistics, key=lambda s: s.pixels).region
    dark = [s for s in statistics if s.settings.is_dark and s.region == main]
    found = typical_rates(dark, subject.camera.code_step_dn or 1)
    rates = tuple((t, u, rate) for t, u, rate in found if t is not None)
    return Session(
        str(capture.path),
        _identity(capture),
        _taken(capture),
        camera.conversion_gain_e_per_dn,
        dict(result.figures) if result else {},
        rates,
        tuple(_series(capture, dark)),
        notes,
    )


def read_sessions(archive: Path, report: Callable[[str], None] = lambda line: None) -> list[Session]:
    """Return all sessions of an archive by time, those that cannot be read with the reason as their note.

    Raises:
        InputError: If there is none.
    """
    sessions = []
    for capture in find_sessions(archive):
        try:
            sessions.append(read_session(capture, report))
        except RadiometerError as error:
            failed = Session(str(capture.path), _identity(capture), _taken(capture), None, {}, (), (), (str(error),))
            sessions.append(failed)
    early = dt.datetime.min.replace(tzinfo=dt.UTC)
    return sorted(sessions, key=lambda s: (s.taken or early, s.name))


def _foreign_folders(archive: Path, own: Sequence[Path], suffixes: Collection[str] = _FRAME_SUFFIXES) -> list[Path]:
    folders = {
        file.parent
        for file in _files_below(archive)
        if file.is_file() and (_is_frame(file, suffixes) or file.name == DESCRIPTOR_NAME)
    }
    return sorted(f for f in folders if not any(f.is_relative_to(one) for one in own))


def _files_below(root: Path) -> Iterator[Path]:
    """Yield what is no folder at any depth, behind symbolic links too; each folder once."""
    seen = set()
    for folder, folders, names in os.walk(root, followlinks=True):
        real = os.path.realpath(folder)
        if real in seen:
            folders.clear()
            continue
        seen.add(real)
        folders.sort()
        yield from (Path(folder) / name for name in names)


def _is_frame(file: Path, suffixes: Collection[str] = _FRAME_SUFFIXES) -> bool:
    return Path(file.name.lower().removesuffix(".gz")).suffix in suffixes


def _direct_files(folder: Path) -> list[Path]:
    if (folder / DESCRIPTOR_NAME).is_file():
        return [folder]
    return sorted(file for file in folder.iterdir() if file.is_file() and _is_frame(file))


def _identity(capture: CaptureSet) -> tuple[str, ...]:
    camera = capture.header.camera
    further = camera.model_extra or {}
    facts: list[Any] = [camera.vendor, camera.model, camera.serial or further.get("unit"), camera.band]
    known = tuple(str(fact) for fact in facts if fact)
    return known or (f"unnamed camera of {camera.bit_depth} bits",)


def _taken(capture: CaptureSet) -> dt.datetime | None:
    created = capture.header.created
    try:
        return moment_of(str(created))
    except ValueError:
        return None


def _dark_dn(dark: Sequence[GroupStatistics], light: FrameSettings, camera: CameraDescription) -> float:
    """Return the dark signal of a bright setting in DN: on the line of the dark frames of its gain and temperature."""
    own = [d for d in dark if d.settings.gain_db == light.gain_db]
    if not own:
        return min((d.mean_dn for d in dark), default=camera.black_level_dn or 0.0)

    def apart_k(plateau: Sequence[GroupStatistics]) -> float:
        here_c = plateau[0].settings.temperature_c
        return 0.0 if here_c is None or light.temperature_c is None else abs(here_c - light.temperature_c)

    level, line = level_at_0_s(unbent(min(by_temperature(own), key=apart_k)), camera.code_step_dn or 1)
    return level.value if line is None else line.intercept + line.slope * light.exposure_s


def _series(capture: CaptureSet, dark: Sequence[GroupStatistics]) -> list[LightSeries]:
    found = []
    for group in groups_of_capture(capture):
        one = group.settings
        if one.is_dark or one.source_level <= 0:
            continue
        frames = list(group.read(capture.header.camera.full_scale_dn))
        if any(np.mean(dn >= capture.header.camera.saturated_dn) > _CLIPS for dn in frames):
            continue
        black_dn = _dark_dn(dark, one, capture.header.camera)
        means = [float(np.mean(dn)) - black_dn for dn in frames]
        files = tuple(file.name for file in group.files)
        found.append(LightSeries(one.exposure_s, one.gain_db, one.source_level, one.pattern, files, tuple(means)))
    return found

"""Our captures as EMVA 1288 descriptor files, for other programs to judge."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from radiometer.analysis.characterise.result import PLAUSIBLE_ETA_PERCENT, Characterisation
from radiometer.analysis.characterise.subject import FrameGroup, PhotonFlux, Subject
from radiometer.data import Patch
from radiometer.data.capture_set import read_digital_numbers
from radiometer.data.storage import write_bytes_atomic, write_text_atomic
from radiometer.errors import InputError, OutputError


def export_descriptor(subject: Subject, result: Characterisation, path: Path) -> list[str]:
    """Write a descriptor file for the frames of a subject, and return what the user must know.

    Exposures are in ns, light in photons per pixel. Every setting is written as a pair (its first two frames), and
    the bright and dark setting with most frames at one exposure once more as the stack for the spatial figures. The
    form knows neither regions nor colours: where only part of the pixels was looked at, that part is written to
    separate images, into a folder next to the file.

    Args:
        subject: The frames, whose photons must be known.

    Raises:
        InputError: If the photons are unknown, or the quantum efficiency that follows is not plausible.
        CaptureError: If a frame is unreadable.
        OutputError: If a file cannot be written.

    Source: descriptor format of the EMVA 1288 working group's datasets.
    """
    _refuse_unlikely(subject, result)
    groups = [g for g in subject.groups if g.settings.gain_db == result.gain_db]
    dark = {g.settings.exposure_s: g for g in groups if g.settings.is_dark}
    bright = [g for g in groups if not g.settings.is_dark and g.settings.exposure_s in dark]
    if not bright:
        raise InputError(f"{subject.origin}: no bright frames share an exposure with dark ones; the form needs both")
    stack = _stack(bright, dark)
    pairs = sorted(bright, key=lambda g: (g.settings.exposure_s, _photons(subject, g)))
    pairs += [dark[exposure] for exposure in sorted({g.settings.exposure_s for g in bright})]
    images = _Images(subject, path)
    entries = [(group, 2) for group in pairs] + [(group, len(group.files)) for group in stack]
    lines = [line for group, count in entries for line in _entry(subject, group, images, count)]
    head = ["v 4.0", f"n {subject.camera.bit_depth} {images.width} {images.height}"]
    write_text_atomic(path, "\n".join([*head, *lines]) + "\n")
    if stack:
        return []
    return ["no exposure has three or more bright and dark frames: the spatial figures cannot be worked out from it"]


class _Images:
    """Names the images of a descriptor; writes the part that was looked at where that is not the whole frame."""

    def __init__(self, subject: Subject, path: Path) -> None:
        self._path = path
        self._written: dict[Path, Path] = {}
        height, width = subject.groups[0].reader(subject.groups[0].files[0]).shape
        self.region = largest_region(subject)[0] or Patch(0, 0, width, height)
        self.height, self.width = self.region.height, self.region.width
        self._whole = (height, width) == (self.height, self.width)

    def name(self, group: FrameGroup, file: Path) -> str:
        """Return the image's name relative to the descriptor, with backslashes; writes it where it is a part."""
        if self._whole and group.reader is read_digital_numbers:
            return os.path.relpath(file, self._path.parent).replace("/", "\\")
        folder = images_folder(self._path)
        make_folder(folder)
        if file not in self._written:
            self._written[file] = target = folder / f"{len(self._written):04d}.png"
            part = np.ascontiguousarray(group.reader(file)[self.region.slices])
            write_bytes_atomic(target, cv2.imencode(".png", part)[1].tobytes())
        return f"{folder.name}\\{self._written[file].name}"


def images_folder(descriptor: Path) -> Path:
    """Return the folder of the images that belong to a descriptor alone."""
    return descriptor.parent / f"{descriptor.stem}_images"


def make_folder(folder: Path) -> None:
    """Create a folder where there is none. Raises OutputError if that cannot be done."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot create {folder}: {error.strerror or error}") from error


def largest_region(subject: Subject) -> tuple[Patch | None, PhotonFlux | None]:
    """Return the largest region of a subject and its photon flux."""
    sizes = [region.width * region.height if region else 0 for region in subject.regions]
    main = sizes.index(max(sizes))
    return subject.regions[main], subject.fluxes[main]


def _refuse_unlikely(subject: Subject, result: Characterisation) -> None:
    eta = result.figures.get("eta")
    if eta is None:
        raise InputError(
            f"{subject.origin}: photons per pixel are unknown; give the radiance of the patch (--radiance), and "
            "wavelength, f-number and pixel pitch in the capture"
        )
    low, high = PLAUSIBLE_ETA_PERCENT
    if not low <= eta.value <= high:
        raise InputError(
            f"{subject.origin}: a quantum efficiency of {eta.value:.3g} % would follow, outside "
            f"{low:g} to {high:g} %; check the radiance, the f-number, the lens "
            "transmittance, the wavelength and the pixel pitch: E = π·τ·L/(4·N²), photons = E·t·A·λ/(h·c)"
        )


def _photons(subject: Subject, group: FrameGroup) -> float:
    flux = largest_region(subject)[1]
    if group.photons is not None:
        return group.photons
    return flux.photons(group.settings) if flux else 0.0


def _entry(subject: Subject, group: FrameGroup, images: _Images, count: int) -> list[str]:
    exposure_ns = f"{group.settings.exposure_s * 1e9:.3f}"
    head = f"d {exposure_ns}" if group.settings.is_dark else f"b {exposure_ns} {_photons(subject, group):.6f}"
    return [head, *(f"i {images.name(group, file)}" for file in group.files[:count])]


def _stack(bright: Sequence[FrameGroup], dark: dict[float, FrameGroup]) -> tuple[FrameGroup, ...]:
    """Return the bright and the dark group of the exposure with most frames; none where pairs are all there is."""
    best = max(bright, key=lambda g: min(len(g.files), len(dark[g.settings.exposure_s].files)))
    pair = (best, dark[best.settings.exposure_s])
    return pair if min(len(g.files) for g in pair) > 2 else ()

"""Turns an EMVA 1288 descriptor (bright and dark pairs with their photons) into a capture set."""

from __future__ import annotations

from pathlib import Path

from radiometer.analysis.characterise.emva_descriptor import DESCRIPTOR_NAME, EmvaDescriptor
from radiometer.data import CameraDescription, CaptureHeader, Frame, FrameEntry, FrameSettings, SourceDescription
from radiometer.data.capture_set import read_digital_numbers
from radiometer.reconcile.measure.reduce import FrameReader


def find_descriptor(path: Path) -> Path | None:
    """Return the descriptor that a path names, itself or in its folder; None where there is none."""
    if path.is_file() and path.suffix.lower() == ".txt":
        return path
    inside = path / DESCRIPTOR_NAME
    return inside if inside.is_file() else None


def read_emva_set(path: Path) -> tuple[CaptureHeader, FrameReader, tuple[int, int]]:
    """Return header, frame reader and (height, width) of a descriptor's images.

    Nothing is known of the camera but its bit depth: gain, read noise, dark current and black level are fitted. The
    photons tell the source level, in units of the brightest flux.

    Args:
        path: The descriptor file.

    Raises:
        InputError: If a line is not understood or an image is missing.
    """
    descriptor = EmvaDescriptor.read(path)
    fluxes = [(g.photons or 0.0) / g.settings.exposure_s for g in descriptor.groups]
    brightest = max([flux for flux in fluxes if flux > 0], default=1.0)
    entries: list[FrameEntry] = []
    for group, flux in zip(descriptor.groups, fluxes, strict=True):
        dark = group.settings.is_dark or flux <= 0
        settings = FrameSettings(
            group.settings.exposure_s,
            source_level=1.0 if dark else flux / brightest,
            shutter="closed" if dark else "open",
        )
        entries += [FrameEntry.of(str(file), settings) for file in group.files]
    header = CaptureHeader(
        camera=CameraDescription(bit_depth=descriptor.bit_depth),
        source=SourceDescription(kind="sphere"),
        frames=tuple(entries),
    )

    def read(index: int) -> Frame:
        entry = header.frames[index]
        return Frame(read_digital_numbers(Path(entry.file)), max(descriptor.bit_depth, 8), entry.settings, index)

    return header, read, (descriptor.height, descriptor.width)

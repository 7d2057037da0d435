"""Descriptor files of the EMVA 1288 working group as groups of frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from radiometer.analysis.characterise.frame_groups import FrameGroup
from radiometer.data import FrameSettings
from radiometer.importing.emva_listing import DESCRIPTOR_NAME, EmvaListing


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
        """Return a descriptor file; exposures may be 0, and the photons need not follow them.

        Raises:
            InputError: If a line is not understood, there is no image, or one is missing; the message gives the line.
        """
        listing = EmvaListing.read(path)
        groups = tuple(
            FrameGroup(
                FrameSettings(exposure_s=entry.exposure_s, shutter="closed" if entry.photons == 0 else "open"),
                entry.files,
                entry.photons,
            )
            for entry in listing.entries
        )
        return cls(path, listing.bit_depth, listing.width, listing.height, groups)


__all__ = ["DESCRIPTOR_NAME", "EmvaDescriptor"]

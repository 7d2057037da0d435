"""Radiance maps written in the forms that the field reads: .hdr, .exr, .tiff, and a false-colour .png."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w
from radiometer.analysis.photometry.spectra import Spectrum
from radiometer.data import RadianceMap
from radiometer.data.reading import LUMINANCE_UNIT, RADIANCE_UNIT
from radiometer.errors import UsageError


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """One grey or three colour maps of one scene in one unit.

    Attributes:
        maps: By channel: one of any name, or "red", "green" and "blue".
        bounds: Lowest and highest value of the false colours; None takes those of the picture.
    """

    maps: Mapping[str, RadianceMap]
    bounds: tuple[float, float] | None = None

    @property
    def is_colour(self) -> bool:
        """Return whether there are three channels."""
        return len(self.maps) == 3

    @property
    def first(self) -> RadianceMap:
        """Return the only map, or the green one."""
        return self.maps["green"] if self.is_colour else next(iter(self.maps.values()))

    @property
    def unit(self) -> str:
        """Return the unit of the values."""
        return self.first.unit


Writer = Callable[[Path, MapPicture], None]


def in_luminance(found: RadianceMap, spectrum: Spectrum) -> RadianceMap:
    """Return a map in cd·m⁻² under a spectrum.

    Raises:
        UsageError: If the map is relative.
        InputError: If the spectrum holds no visible light.
    """
    if found.unit != RADIANCE_UNIT:
        raise UsageError("a relative map has no luminance; merge with a calibration")
    efficacy = luminous_efficacy_lm_per_w(spectrum)
    return replace(
        found, radiance=found.radiance * efficacy, u_radiance=found.u_radiance * efficacy, unit=LUMINANCE_UNIT
    )


def writer_for(path: Path) -> Writer:
    """Return what writes the form that a file's ending names.

    Raises:
        UsageError: If there is no such form; the message lists those there are.
    """
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise UsageError(f"{path}: cannot write {path.suffix or 'a file without an ending'}; use {', '.join(WRITERS)}")
    return writer


def _hdr(path: Path, picture: MapPicture) -> None:
    from radiometer.analysis.exports.hdr import write_hdr

    write_hdr(path, picture)


def _exr(path: Path, picture: MapPicture) -> None:
    from radiometer.analysis.exports.exr import write_exr

    write_exr(path, picture)


def _tiff(path: Path, picture: MapPicture) -> None:
    from radiometer.analysis.exports.tiff import write_tiff

    write_tiff(path, picture)


def _png(path: Path, picture: MapPicture) -> None:
    from radiometer.analysis.exports.false_colour import write_false_colour

    write_false_colour(path, picture)


WRITERS: Final[dict[str, Writer]] = {".exr": _exr, ".hdr": _hdr, ".tiff": _tiff, ".tif": _tiff, ".png": _png}

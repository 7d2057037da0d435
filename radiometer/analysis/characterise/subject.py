"""The frames of a characterisation by setting, what is known of the camera, and the light in photons."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.analysis.characterise.group_statistics import SAME_TEMPERATURE_K, GroupStatistics, statistics_of_group
from radiometer.analysis.signal.lens import falloff_known, lens_factor_sr, relative_sensitivity
from radiometer.data import (
    CameraDescription,
    CaptureHeader,
    CaptureSet,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    PatchDescription,
    Provenance,
    SourceDescription,
)
from radiometer.data.capture_set import read_digital_numbers
from radiometer.data.code_step import code_step_of
from radiometer.data.frame import DigitalNumbers
from radiometer.data.mosaic import of_sensor
from radiometer.data.pile_up import white_levels_of
from radiometer.data.white_level import WhiteLevel, white_level_notes
from radiometer.errors import CaptureError, MeasurementError, UsageError
from radiometer.importing import imported_of, is_foreign, open_capture, statistics_of
from radiometer.importing.emva_listing import EmvaListing, find_descriptor
from radiometer.importing.found import record_in
from radiometer.units import photon_energy_j

_FRAMES_OF_CODES: Final = 5  # evenly over the settings
_PIXELS_OF_CODES: Final = 1 << 16  # of a frame: they show which codes occur
_MEASURED_REL: Final = 1e-4  # by which measured exposures of one setting differ; steps of a ladder do by per cents


@dataclass(frozen=True, slots=True)
class FrameGroup:
    """Frames of one setting, still on disk."""

    settings: FrameSettings  # the setting; temperature and time are those of the first frame
    files: tuple[Path, ...]  # their files
    photons: float | None = None  # mean photons per pixel where a descriptor states them; None elsewhere
    # Returns the digital numbers of a file, where they are not all of it
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
    exposures = _nominal_exposures([one.exposure_s for one in settings])
    for index, one in enumerate(settings):
        photons = capture.header.frames[index].photons
        light = () if one.is_dark else (one.source_level, one.pattern, one.f_number, photons)
        key = (exposures[index], one.gain_db, one.black_level_dn, one.shutter, plateaus[index], *light)
        found.setdefault(key, []).append(index)
    return [_group(capture, settings, members) for members in found.values()]


def _group(capture: CaptureSet, settings: list[FrameSettings], members: list[int]) -> FrameGroup:
    temperatures = [t for i in members if (t := settings[i].temperature_c) is not None]
    mean = float(np.mean(temperatures)) if temperatures else None
    entries = [capture.header.frames[i] for i in members]
    first = replace(settings[members[0]], temperature_c=mean)
    folder = capture.path if capture.store is None else Path()
    names = {folder / entry.file: entry.file for entry in entries}
    are_whole = capture.store is None and capture.header.camera.mosaic is None
    read = read_digital_numbers if are_whole else lambda file: capture.read_numbers(names[file])
    return FrameGroup(first, tuple(folder / entry.file for entry in entries), entries[0].photons, read)


def _nominal_exposures(exposures_s: list[float]) -> list[float]:
    """Return exposures with one value for those that are measured ones of a setting: alike to 1 part in 10 000."""
    known = np.unique(exposures_s)
    begins = np.concatenate([[True], known[1:] > known[:-1] * (1.0 + _MEASURED_REL)])
    nominal = known[np.flatnonzero(begins)[np.cumsum(begins) - 1]]
    return [float(nominal[place]) for place in np.searchsorted(known, exposures_s)]


def _temperature_plateaus(temperatures: list[float | None]) -> list[int]:
    """Return the number of the plateau that each temperature belongs to (gaps above 1.5 K part them)."""
    known = np.unique([t for t in temperatures if t is not None])
    edges = known[1:][np.diff(known) > SAME_TEMPERATURE_K]
    return [-1 if t is None else int(np.searchsorted(edges, t, side="right")) for t in temperatures]


@dataclass(frozen=True, slots=True)
class PhotonFlux:
    """Photons per pixel and second of exposure at source level 1."""

    per_s: float  # photons per pixel per second
    u_rel: float  # relative standard uncertainty (radiance and transmittance)

    def photons(self, settings: FrameSettings) -> float:
        """Return the mean photons per pixel of a frame; none with the shutter closed."""
        return 0.0 if settings.is_dark else self.per_s * settings.exposure_s * settings.source_level


def photon_flux(
    patch: PatchDescription,
    pattern: str,
    camera: CameraDescription,
    lens: LensDescription,
    source: SourceDescription,
    f_number: float | None,
    shape: tuple[int, int],
) -> PhotonFlux | None:
    """Return the photon flux on the pixels of a patch of known radiance: μ̇_p = L·(E/L)·A·λ/(h·c).

    Args:
        camera: Gives the pixel pitch.
        lens: Gives transmittance, magnification and fall-off.
        source: Gives the wavelength.
        shape: (height, width) of the frames.

    Returns:
        None where radiance, f-number, pixel pitch or wavelength is unknown.

    Source: EMVA Standard 1288, release 4.0, equations (3) and (4).
    """
    known = patch.radiance_W_per_sr_m2
    radiance = known.get(pattern) if isinstance(known, dict) else known
    number = f_number if f_number is not None else lens.f_number
    if radiance is None or number is None or camera.pixel_pitch_um is None or source.wavelength_nm is None:
        return None
    irradiance = radiance * lens_factor_sr(lens, number) * _mean_sensitivity(patch.patch, camera, lens, shape)
    area_m2 = (camera.pixel_pitch_um * 1e-6) ** 2
    u_rel = math.hypot(patch.u_rel or 0.0, lens.transmittance_u_rel or 0.0, source.reproducibility_u_rel or 0.0)
    return PhotonFlux(irradiance * area_m2 / photon_energy_j(source.wavelength_nm), u_rel)


def _mean_sensitivity(patch: Patch, camera: CameraDescription, lens: LensDescription, shape: tuple[int, int]) -> float:
    x = np.arange(patch.x, patch.x + patch.width)[np.newaxis, :]
    y = np.arange(patch.y, patch.y + patch.height)[:, np.newaxis]
    if falloff_known(camera, lens) != "cos4":
        return 1.0
    return float(np.mean(relative_sensitivity(camera, lens, None, shape, x, y)))


@dataclass(frozen=True, slots=True)
class Subject:
    """Frames to characterise a camera by."""

    origin: str  # folder or file, for messages and provenance
    camera: CameraDescription  # what is believed of the camera
    lens: LensDescription  # the lens
    groups: tuple[FrameGroup, ...]  # frames of each setting
    regions: tuple[Patch | None, ...]  # where to look; (None,) for the whole frame
    fluxes: tuple[PhotonFlux | None, ...]  # photon flux of each region; None where unknown
    notes: tuple[str, ...] = ()  # what the user must know of how they were chosen
    given: tuple[GroupStatistics, ...] = ()  # statistics that are known without pictures; they replace all groups
    masked_dn: tuple[float, ...] = ()  # what masked rows read in DN, frame by frame, where files state it
    created: str = ""  # when the frames were taken, ISO 8601 in UTC; "" where it is not stated
    # From which digital number pixels are saturated, by gain in dB, as the frames show it
    white_levels: Mapping[float, WhiteLevel] = field(default_factory=dict)

    def provenance(self, method: str, notes: Sequence[str]) -> Provenance:
        """Return what made figures of these frames, with their date and lens."""
        stops = [group.settings.f_number for group in self.groups]
        facts = {"taken": self.created, "lens": self.lens.in_words(stops)}
        return Provenance(method, (self.origin,), tuple(notes), {name: text for name, text in facts.items() if text})

    @property
    def photons_u_rel(self) -> float:
        """Return the relative standard uncertainty of the photon numbers (the largest of the regions)."""
        return max((flux.u_rel for flux in self.fluxes if flux is not None), default=0.0)

    def statistics(self) -> list[GroupStatistics]:
        """Return the statistics of every group in every region.

        Raises:
            MeasurementError: If a region is outside the frames.
            CaptureError: If a frame is unreadable.
        """
        if self.given:
            return list(self.given)
        found: list[GroupStatistics] = []
        for group in self.groups:
            frames = group.read(self.camera.full_scale_dn)
            white = self.white_levels.get(group.settings.gain_db)
            saturated_dn = self.camera.saturated_dn if white is None else white.saturated_dn
            for one in statistics_of_group(frames, group.settings, self.regions, saturated_dn, group.photons):
                found.append(self._with_photons(one))
        return found

    def _with_photons(self, one: GroupStatistics) -> GroupStatistics:
        flux = self.fluxes[one.region]
        if one.photons is not None or flux is None:
            return one
        return replace(one, photons=flux.photons(one.settings))


def read_subject(path: Path, region: Patch | None = None, channel: str = "green") -> Subject:
    """Return what a capture set, an EMVA 1288 descriptor, files of a laboratory or a table of statistics holds.

    Args:
        path: A capture set, a descriptor file or a folder with `EMVA1288_Data.txt`, FITS or raw TIFF files, a table.
        region: Where to look; the patches of the capture set, else the whole frame, where None.
        channel: Colour of a mosaic whose pixels are read.

    Raises:
        InputError: If it is neither, or unfinished or inconsistent.
        UsageError: If a mosaic has no such colour.
    """
    header = statistics_of(path) if path.exists() else None
    if header is not None:
        return _of_statistics(path, header)
    descriptor = find_descriptor(path) if path.is_file() or not (path / "capture.yaml").exists() else None
    if descriptor is not None:
        return _of_descriptor(descriptor, region)
    if path.is_file() and path.suffix.lower() == ".txt" and not is_foreign(path):
        return _of_descriptor(path, region)  # which says what line is not understood
    return subject_of_capture(open_capture(path).in_colour(channel), region)


def subject_of_capture(capture: CaptureSet, region: Patch | None = None) -> Subject:
    """Return the frames of a capture set, in its patches or in one region.

    Light must be proportional to exposure × source level: of several f-numbers or patterns the one with most frames
    is taken, and a note says so. Without dark frames those with the source off replace them.

    Raises:
        CaptureError: If a frame is unreadable.
    """
    header = capture.header
    groups = groups_of_capture(capture)
    light = [g for g in groups if not g.settings.is_dark]
    (f_number, pattern), notes = _most_frequent(light) if light else ((None, "default"), [])
    record = imported_of(capture)
    notes += [*(f"left out: {line}" for line in record.left_out), *record.doubts]
    kept = [g for g in groups if g.settings.is_dark or (g.settings.f_number, g.settings.pattern) == (f_number, pattern)]
    kept, more = _with_dark(kept)
    settings = [entry.settings for entry in header.frames]
    levels = white_levels_of(settings, capture.read_frame, header.camera.tap_parts)
    white = white_level_notes(level for level in levels.values() if level.disagrees)
    camera, padded = _with_code_step(of_sensor(header.camera), kept)
    patches = _chosen_patches(header.patches, region)
    shape = capture.read_frame(0).shape
    fluxes = [photon_flux(p, pattern, header.camera, header.lens, header.source, f_number, shape) for p in patches]
    if not patches and light:
        notes.append("the whole frame was used: no patch is named, so unevenness of the scene counts")
    return Subject(
        str(capture.path),
        camera,
        header.lens,
        tuple(kept),
        tuple(p.patch for p in patches) or (None,),
        tuple(fluxes) or (None,),
        (*capture.mosaic_notes, *notes, *more, *white, *padded),
        masked_dn=tuple(
            float(entry.model_extra["masked_rows_dn"])
            for entry in header.frames
            if entry.model_extra and "masked_rows_dn" in entry.model_extra
        ),
        white_levels=levels,
        created=header.created or "",
    )


def _most_frequent(light: list[FrameGroup]) -> tuple[tuple[float | None, str], list[str]]:
    counts = Counter[tuple[float | None, str]]()
    for group in light:
        counts[group.settings.f_number, group.settings.pattern] += len(group.files)
    chosen = counts.most_common(1)[0][0]
    left_out = sum(counts.values()) - counts[chosen]
    if not left_out:
        return chosen, []
    stop = "unknown" if chosen[0] is None else f"{chosen[0]:g}"
    return chosen, [f"only frames at f-number {stop} and pattern {chosen[1]!r} were used; {left_out} others were not"]


def _with_dark(groups: list[FrameGroup]) -> tuple[list[FrameGroup], list[str]]:
    """Return the groups; where none is dark, those with the source off count as dark."""
    if any(g.settings.is_dark for g in groups) or all(g.settings.source_level > 0 for g in groups):
        return groups, []
    darkened = [
        replace(g, settings=replace(g.settings, shutter="closed")) if g.settings.source_level == 0 else g
        for g in groups
    ]
    return darkened, ["frames with the source off are treated as dark ones: light of the room counts as dark signal"]


def _chosen_patches(patches: tuple[PatchDescription, ...], region: Patch | None) -> tuple[PatchDescription, ...]:
    """Return all patches that the capture names, or the one region, with its radiance where it is in a patch."""
    if region is None:
        return patches
    around = next((p for p in patches if _inside(region, p.patch)), None)
    placed = {"name": "region", "x": region.x, "y": region.y, "width": region.width, "height": region.height}
    known = {"radiance_W_per_sr_m2": around.radiance_W_per_sr_m2, "u_rel": around.u_rel} if around else {}
    return (PatchDescription.model_validate(placed | known),)


def _inside(inner: Patch, outer: Patch) -> bool:
    return (
        outer.x <= inner.x
        and outer.y <= inner.y
        and inner.x + inner.width <= outer.x + outer.width
        and inner.y + inner.height <= outer.y + outer.height
    )


def _of_statistics(path: Path, header: CaptureHeader) -> Subject:
    record = record_in(header)
    given = tuple(
        GroupStatistics(
            one.settings,
            one.frames if one.variance_dn2 is not None else 1,
            one.pixels,
            one.mean_dn,
            one.variance_dn2 or 0.0,
            one.spatial_variance_dn2 or 0.0,
            one.clipped_share,
            one.photons,
            floor_share=one.floor_share,
        )
        for one in header.statistics
    )
    notes = ("statistics without pictures: no differences between pixels", *record.doubts, *record.missing)
    return Subject(str(path), header.camera, header.lens, (), (None,), (None,), notes, given)


def _of_descriptor(path: Path, region: Patch | None) -> Subject:
    """Return the frames of a descriptor; exposures may be 0, and the photons need not follow them."""
    listing = EmvaListing.read(path)
    if not 1 <= listing.bit_depth <= 16:
        raise MeasurementError(f"{path}: {listing.bit_depth} bits per pixel; 1 to 16 can be read")
    camera = CameraDescription(bit_depth=listing.bit_depth)
    groups = tuple(
        FrameGroup(FrameSettings(one.exposure_s, shutter="open" if one.photons else "closed"), one.files, one.photons)
        for one in listing.entries
    )
    levels = _white_levels(groups, camera)
    camera, padded = _with_code_step(camera, groups)
    notes = (*white_level_notes(level for level in levels.values() if level.disagrees), *padded)
    return Subject(str(path), camera, LensDescription(), groups, (region,), (None,), notes, white_levels=levels)


def _with_code_step(
    camera: CameraDescription, groups: Sequence[FrameGroup]
) -> tuple[CameraDescription, tuple[str, ...]]:
    """Return the camera with the distance between codes that its frames show, and a note where it states another."""
    shown = [one for one in groups if not one.settings.is_dark] or list(groups)
    if not shown:
        return camera, ()
    places = np.unique(np.linspace(0, len(shown) - 1, _FRAMES_OF_CODES).astype(int))
    first = (next(replace(shown[k], files=shown[k].files[:1]).read(camera.full_scale_dn)) for k in places)
    some, stated = (dn.ravel()[:: max(1, dn.size // _PIXELS_OF_CODES)] for dn in first), camera.code_step_dn
    step_dn = code_step_of(some, stated)
    if step_dn == (stated or 1):
        return camera, ()
    statement = "is not stated" if stated is None else f"states {stated}"
    note = f"the codes are {step_dn} DN apart, though camera.code_step_dn {statement}: rounding counts by that step"
    return camera.model_copy(update={"code_step_dn": step_dn}), (note,)


def _white_levels(groups: Sequence[FrameGroup], camera: CameraDescription) -> dict[float, WhiteLevel]:
    """Return the white levels that the first images of the groups show."""
    lit = [one for one in groups if not one.settings.is_dark and one.settings.exposure_s > 0 and one.photons]
    # Only groups of one photon flux may be compared over exposure; descriptors round both.
    settings = [
        replace(one.settings, source_level=float(f"{(one.photons or 0.0) / one.settings.exposure_s:.3g}"))
        for one in lit
    ]

    def read(number: int) -> Frame:
        return Frame(next(lit[number].read(camera.full_scale_dn)), camera.bit_depth, settings[number])

    return white_levels_of(settings, read)


def with_known_radiance(
    subject: Subject, header: CaptureHeader, shape: tuple[int, int], radiance: float, u_rel: float
) -> Subject:
    """Return the subject with the photon flux that a radiance stated by hand makes on its regions.

    Args:
        header: Camera, lens, light and f-number of the capture set.
        shape: (height, width) of its frames.
        radiance: Radiance of the regions in W·sr⁻¹·m⁻².

    Raises:
        UsageError: If pixel pitch, f-number or wavelength are not known.
    """
    height, width = shape
    fluxes = []
    for where in subject.regions:
        x, y, w, h = (where.x, where.y, where.width, where.height) if where else (0, 0, width, height)
        known = PatchDescription(name="region", x=x, y=y, width=w, height=h, radiance_W_per_sr_m2=radiance, u_rel=u_rel)
        f_number = header.frames[0].f_number
        fluxes.append(photon_flux(known, "default", header.camera, header.lens, header.source, f_number, shape))
    if None in fluxes:
        raise UsageError(
            f"--radiance gives no photons: {subject.origin} must state pixel_pitch_um, f_number and the source's "
            "wavelength_nm"
        )
    return replace(subject, fluxes=tuple(fluxes))

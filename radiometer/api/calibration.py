"""The absolute scale of a camera: by a source of known radiance, by a light meter, or by both."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from radiometer.analysis.calibration import calibrate as make
from radiometer.analysis.calibration.calibrate import (
    KnownSource,
    MeterReading,
    MeterSettings,
    metered_luminance_cd_m2,
    metered_u_rel,
)
from radiometer.analysis.calibration.flat_field import fit_flat_field
from radiometer.analysis.calibration.shared import require_channel, require_flat_field, require_response
from radiometer.analysis.characterise.taps import camera_with_taps
from radiometer.analysis.exports.certificate import read_certificate
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.photometry import photometry
from radiometer.analysis.photometry.photometry import spectrum as spectrum_of
from radiometer.analysis.photometry.photometry import spectrum_from_csv
from radiometer.analysis.response.dynamic_range import DynamicRange, RangePoint, dynamic_range, with_dynamic_range
from radiometer.analysis.signal.model import black_from_darks
from radiometer.analysis.signal.situation import contradicted
from radiometer.analysis.signal.taps import ReadOut, doubt_of_taps
from radiometer.api.files import PathLike, stack_of
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Progress, Result
from radiometer.bench.assembly import open_instrument
from radiometer.bench.sources import is_photographs, open_source
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    CaptureSet,
    FlatField,
    LensDescription,
    Patch,
    PatchDescription,
    ResponseCurve,
    Scale,
    SourceDescription,
    SpectralResponse,
    StatedUncertainties,
)
from radiometer.data.iso_speeds import IsoSpeeds
from radiometer.data.reading import RADIANCE_UNIT
from radiometer.data.setup import Setup
from radiometer.data.validation import validate
from radiometer.devices import CameraPreset
from radiometer.errors import CalibrationError, InputError, UsageError
from radiometer.importing import imported_of, open_capture
from radiometer.numbers import with_u
from radiometer.photographs.response import linear_doubt
from radiometer.photographs.scene import UNSTATED_SHUTTER_U_S, Photographs, has_unstated_shutter_offset, with_offset
from radiometer.photographs.stated import at_iso, reference_iso, stated_camera, with_f_number, with_gains, with_iso
from radiometer.plausible import (
    PLAUSIBLE,
    Exposure,
    FNumber,
    Iso,
    KnownRadiance,
    MeterConstant,
    Positive,
    RelativeUncertainty,
)
from radiometer.progress import counted
from radiometer.units import exact_exposure_s

if TYPE_CHECKING:
    from simulators.effects.base import Effect

# Luminous efficacies of radiation (380 to 780 nm) of usual sources, 2856 K to a phosphor-converted LED, are from 0.86
# to 1.8 times that of equal energy. The constant is the root mean square of that rectangle about 1.
UNKNOWN_EFFICACY_U_REL: Final = 0.43

# The gain in dB, and the warmth in K from 25 °C, at which the uncertainty of a law is stated.
_TYPICAL_GAIN_DB: Final = 24.0
_TYPICAL_WARMER_K: Final = 15.0
_BLACK: Final = "black level"  # its uncertainty has a place of its own in a calibration
_MOST_BLACK: Final = 1.0 / 8.0  # of full scale: 2048 of 16 383 DN is the highest of usual cameras
_DARKEST_PERCENT: Final = 1.0  # of pixels: fewer may be defects
_USUAL_WELL_E: Final = 10_000.0  # what the forward model takes where none is stated


@dataclass(frozen=True, eq=False, repr=False)
class Calibrated(Result):
    """A calibration and how its scale was found.

    Examples:
        >>> import radiometer as rm
        >>> found = rm.calibrate("out/chart", patch=(3, 3, 8, 8), radiance=0.2, u_rel=0.01)
        >>> found.scale.method, found.scale.u_rel > 0.01
        ('known_radiance', True)

    Attributes:
        calibration: The calibration, with the less uncertain scale.
        scales: All scales that were found: by the known source, then by the light meter.
        meter: The reference photograph; None without a light meter.
        ranged: What regions brought to the reference value say of the curve; None without any.
        file: File that it was written to; None where none was.
        notes: What a user should know, a sentence each.
    """

    calibration: Calibration
    scales: tuple[Scale, ...]
    meter: MeterReading | None = None
    ranged: DynamicRange | None = None
    file: Path | None = None
    notes: tuple[str, ...] = ()

    @property
    def scale(self) -> Scale:
        """Return the scale in use."""
        return self.calibration.scale

    def to_mapping(self) -> dict[str, Any]:
        calibration = self.calibration
        scale = calibration.scale.model_dump(mode="json", exclude_none=True)
        known = {"calibration": self.file, "scale": scale, "spectrum": calibration.spectrum}
        report = self.plain("notes", **known, assumptions=calibration.provenance.assumptions)
        if self.meter is not None:
            report["metered"] = _metered(self.meter, calibration)
        if self.ranged is not None:
            report["dynamic_range"] = self.ranged.to_mapping()
        if calibration.flat_field is not None:
            report["flat_field"] = calibration.flat_field.model_dump(mode="json")
        if len(self.scales) == 2:
            by_source, by_meter = self.scales
            report["meter_over_source"] = make.scales_ratio(by_meter, by_source).to_mapping()
        return report

    def __str__(self) -> str:
        scale = self.scale
        how = scale.method.replace("_", " ")
        return f"{with_u(scale.value, 2 * scale.u_rel * scale.value, 'J·m⁻² per unit of signal', k=2)}, {how}"


def _metered(meter: MeterReading, calibration: Calibration) -> dict[str, Any]:
    luminance = metered_luminance_cd_m2(meter.meter_k, meter.settings)
    radiance = photometry.radiance_w_sr_m2(luminance, spectrum_of(calibration.spectrum))
    thesis = photometry.radiance_thesis_w_sr_m2_um(luminance)
    u_rel = metered_u_rel(meter.k_u_rel)
    # A radiance from a luminance carries the efficacy of the light as well.
    of_radiance = math.hypot(u_rel, calibration.uncertainties.efficacy_u_rel)
    return {
        "luminance": {"value": luminance, "u": luminance * u_rel, "unit": "cd m-2"},
        "radiance": {"value": radiance, "u": radiance * of_radiance, "unit": "W sr-1 m-2"},
        "thesis_spectral_radiance": {"value": thesis, "unit": "W sr-1 m-2 um-1"},
    }


def calibrate(
    capture: PathLike | None = None,
    *,
    out: PathLike | None = None,
    response: ResponseCurve | PathLike | None = None,
    patch: PatchLike | str | None = None,
    radiance: KnownRadiance | PathLike | None = None,
    luminance: Positive | None = None,
    u_rel: RelativeUncertainty | None = None,
    luminance_meter_k: MeterConstant | None = None,
    k_u_rel: RelativeUncertainty | None = None,
    f_number: FNumber | None = None,
    exposure_s: Exposure | None = None,
    iso: Iso | None = None,
    measured_iso: Mapping[Iso, Iso] | None = None,
    channel: str = "luminance",
    pattern: str | None = None,
    align: str = "auto",
    reference_dn: Positive | None = None,
    dynamic_range: Sequence[tuple[Positive, ...]] = (),
    as_printed: bool = False,
    spectrum: str | None = None,
    black_level: float | None = None,
    validity_days: Positive = 365.0,
    spectral_response: PathLike | None = None,
    flat: PathLike | None = None,
    flat_u_rel: RelativeUncertainty = 0.0,
    camera: str | None = None,
    bench: PathLike | None = None,
    camera_file: PathLike | None = None,
    model: PathLike | None = None,
    taps: str | None = None,
    stated: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> Calibrated:
    """Give a response curve its absolute scale.

    Two scales are possible. One is a source of known radiance or luminance (a capture set, photographs, or `camera`).
    The other is the constant K of a light meter and the settings that it shows. With both, the less uncertain scale
    is used.

    Examples:
        >>> import radiometer as rm
        >>> rm.calibrate("out/chart", patch=(3, 3, 8, 8), radiance=0.2, u_rel=0.01)
        <Calibrated (... ± ...)·10... J·m⁻² per unit of signal (k = 2), known radiance>

    Args:
        capture: Capture set or folder of photographs of the known source.
        out: Calibration file to write.
        response: Response curve, or its file; linear above black without one.
        patch: The known source: (x, y, width, height), or a patch name of the capture set.
        radiance: Its radiance in W·sr⁻¹·m⁻², or a digital calibration certificate (XML) of it with its uncertainty.
        luminance: Its luminance in cd·m⁻², instead of the radiance.
        u_rel: Its relative standard uncertainty.
        luminance_meter_k: Constant K of the camera's light meter (ISO 2720) in cd·m⁻²·s.
        k_u_rel: Relative standard uncertainty of K beyond the meter's ±1/6 stop; by default what ISO 2720 leaves open.
        f_number: f-number of the reference photograph, or of frames that do not state theirs.
        exposure_s: Exposure time of the reference photograph in s.
        iso: Its ISO speed: as really measured, or stated (with `measured_iso`); of photographs that state none, theirs.
        measured_iso: Real ISO speed by stated one.
        channel: Of colour photographs and colour cameras: "luminance", "red", "green" or "blue"; of the mosaic of a
            capture set "luminance" is green.
        pattern: Displayed pattern of a capture set that holds several.
        align: Photographs from the hand: "auto" (where they moved), "on", or "off".
        reference_dn: Pixel value of the metered surface; half of full scale by default.
        dynamic_range: (M, time in s[, landed]) of regions, which correct the exponent: the region at pixel value M of
            the reference photograph lands on the reference value (or on `landed`) at that time.
        as_printed: Take settings at face value, not as stops.
        spectrum: Spectrum of the source, or a CSV; by default the line that the capture states, else equal energy to
            43 %.
        black_level: Black level in DN; the frames', or that of their dark frames, by default.
        validity_days: Days that the calibration is valid for.
        spectral_response: CSV of wavelength in nm and relative response per watt of the camera.
        flat: Capture set of an evenly bright source: the flat field.
        flat_u_rel: Relative standard uncertainty of that source's evenness.
        camera: Capture now with this camera: "sim", id, serial number or address.
        bench: Bench file for `camera`.
        camera_file: Camera file of `characterise`: gain, noise, saturation as measured.
        model: Model of `reconcile`: readings are corrected for its effects.
        taps: Of a capture set: output amplifiers, "2x2" for columns × rows of equal parts, or "find". By default those
            that the capture set or the camera file states. Readings take them from the calibration.
        stated: Uncertainties of readings that are known better, by name, such as glare_u.
        progress: Called as files are read.

    Raises:
        CalibrationError: If frames and calibration do not go together.
        CaptureError: If the frames are missing or inconsistent.
        MeasurementError: If the patch is clipped, below the noise or not uniform.
        UsageError: If arguments are missing or exclude each other.
    """
    curve = response if isinstance(response, ResponseCurve | None) else ResponseCurve.read(Path(response))
    reference_s = exposure_s if exposure_s is None or as_printed else exact_exposure_s(exposure_s)
    curve, ranged = _ranged(curve, dynamic_range, reference_s, reference_dn, as_printed=as_printed)
    measured = dict(measured_iso or {})
    real_iso = measured.get(iso, iso) if iso is not None else None
    speeds = IsoSpeeds(measured, real_iso, iso if iso in measured else None)
    if capture is None and camera is None:
        speeds.refuse_unstated("--measured-iso", set() if iso is None else {iso})
    if radiance is not None and not isinstance(radiance, int | float):
        radiance, u_rel = _certified(Path(radiance), u_rel)
    by_source = radiance is not None or luminance is not None
    needed = by_source or luminance_meter_k is None
    seen = _seen(capture, camera, bench, patch, channel, pattern, align, speeds, iso, taps, progress, needed=needed)
    if seen is not None and needed:
        seen = _with_f_number(seen, f_number, required=luminance_meter_k is None)
    settings = _meter_settings(luminance_meter_k, f_number, exposure_s, real_iso, as_printed=as_printed)
    of_light = contradicted(spectrum, seen.source.spectrum if seen is not None else None)
    spectrum = spectrum or (seen.source.spectrum if seen is not None else None)
    source = _known_source(seen, radiance, luminance, u_rel, spectrum or "equal_energy")
    if source is None and settings is None:
        raise UsageError("give --radiance or --luminance of a known source, or --luminance-meter-k with its settings")
    if seen is not None and seen.photographs is not None:
        seen = _timed(seen, curve, in_model=model is not None)
    preset = CameraPreset.read(Path(camera_file)) if camera_file is not None else None
    base, of_black = _base(seen, curve, settings, preset, spectrum or "equal_energy", black_level, validity_days)
    base = _with_statements(base, seen, preset, stated, model, spectral_response, spectrum_stated=spectrum is not None)
    if flat is not None:
        base = replace(base, flat_field=_flat_field(open_capture(Path(flat)).in_colour(channel), base, flat_u_rel))
    scales, meter = list[Scale](), None
    if source is not None and seen is not None and seen.patch is not None:
        found = make.scale_by_source(base, seen.bracket, seen.patch, source)
        scales.append(at_iso(found, *reference_iso(seen.bracket.light, speeds)))
    if settings is not None and luminance_meter_k is not None:
        dn = reference_dn if reference_dn is not None else base.camera.full_scale_dn // 2
        meter = MeterReading(luminance_meter_k, settings, dn, k_u_rel)
        scales.append(at_iso(make.scale_by_meter(base, meter), speeds.reference, speeds.reference_stated))
    chosen = min(scales, key=lambda scale: scale.u_rel)
    other = next((scale for scale in scales if scale is not chosen), None)
    files = (capture, None if isinstance(response, ResponseCurve) else response, camera_file, flat, model)
    inputs = tuple(Path(path).name for path in files if path)
    further = (
        *of_black,
        *require_response(curve, base.camera),
        *_of_taps(base, seen),
        *(seen.assumed if seen else ()),
        *_of_dials(settings, exposure_s, f_number),
        *of_light,
    )
    done = make.scaled_calibration(base, chosen, inputs, other, further)
    if out is not None:
        done.write(Path(out))
    return Calibrated(done, tuple(scales), meter, ranged, Path(out) if out else None, seen.notes if seen else ())


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """The known source as captured."""

    bracket: Bracket
    patch: Patch | None
    camera: CameraDescription
    lens: LensDescription
    known: PatchDescription | None = None
    source: SourceDescription = field(default_factory=SourceDescription)
    photographs: Photographs | None = None
    notes: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


def _ranged(
    curve: ResponseCurve | None,
    regions: Sequence[tuple[float, ...]],
    reference_s: float | None,
    reference_dn: float | None,
    *,
    as_printed: bool,
) -> tuple[ResponseCurve | None, DynamicRange | None]:
    """Return the curve as regions brought to the reference value correct it, and what they say."""
    if not regions:
        return curve, None
    if curve is None or reference_s is None:
        raise UsageError("--dynamic-range needs --response, and --exposure of the reference photograph")
    points = [
        RangePoint(dn, time_s if as_printed else exact_exposure_s(time_s), *landed) for dn, time_s, *landed in regions
    ]
    reference = (curve.log_exposure.size - 1) // 2 if reference_dn is None else reference_dn
    found = dynamic_range(curve, points, reference_s, reference)
    return with_dynamic_range(curve, found), found


def _seen(
    capture: PathLike | None,
    camera: str | None,
    bench: PathLike | None,
    patch: PatchLike | str | None,
    channel: str,
    pattern: str | None,
    align: str,
    speeds: IsoSpeeds,
    iso: float | None,
    taps: str | None,
    progress: Progress | None,
    *,
    needed: bool,
) -> _Seen | None:
    if capture is not None and camera is not None:
        raise UsageError("give a capture set or --camera, not both")
    if taps is not None and (capture is None or is_photographs(Path(capture))):
        raise UsageError("--taps belongs to capture sets; of a camera state them in its camera file (--camera-file)")
    if capture is not None and is_photographs(Path(capture)):
        where = _numbers(patch)
        if where is None and needed:
            raise UsageError("--patch is missing: say where in the photographs the known source is (X,Y,W,H)")
        if channel == "each":
            raise UsageError("--channel each: a calibration holds one channel; give luminance, red, green or blue")
        read = open_source(Path(capture), channel, report=counted(progress, "reading"))
        taken = stack_of(read, str(capture)).as_photographs()
        unstated = not any(frame.settings.iso for frame in taken.only.light)
        taken = taken.each(lambda one: with_gains(with_iso(one, iso if unstated else None), speeds)).placed(align)
        bracket = taken.without_absent()
        return _Seen(bracket, where, *stated_camera(bracket), photographs=taken)
    if capture is not None:
        opened = open_capture(Path(capture)).in_colour(channel)
        return _seen_in_capture(opened, patch, pattern, taps, needed=needed)
    if camera is not None or bench is not None:
        with open_instrument(Path(bench) if bench else None, camera, _numbers(patch), uncalibrated=True) as instrument:
            device = instrument.camera
            source = instrument.source or SourceDescription()
            return _Seen(instrument.take_bracket(), instrument.patch, device.description, device.lens, source=source)
    return None


def _numbers(patch: PatchLike | str | None) -> Patch | None:
    """Return a patch that is given by its numbers. Raises UsageError for a name: only capture sets name patches."""
    if isinstance(patch, str):
        raise UsageError(f"--patch {patch!r}: expected X,Y,W,H in whole pixels, such as 100,80,40,40")
    return as_patch(patch)


def _seen_in_capture(
    capture: CaptureSet, patch: PatchLike | str | None, pattern: str | None, taps: str | None, *, needed: bool
) -> _Seen:
    path = capture.path
    notes = tuple(f"{path.name}: {line}" for line in imported_of(capture).lines()) if capture.store is not None else ()
    header = capture.header
    named = {entry.name: entry for entry in header.patches}
    known = named.get(patch) if isinstance(patch, str) else None
    if patch is None:
        with_radiance = [entry for entry in header.patches if entry.radiance_W_per_sr_m2 is not None]
        if len(with_radiance) != 1 and needed:
            raise UsageError(
                f"--patch is missing: {path} has {len(with_radiance)} patches of known radiance; "
                "give X,Y,W,H or a patch's name"
            )
        known = with_radiance[0] if len(with_radiance) == 1 else None
    if known is None and isinstance(patch, str):
        there = ", ".join(named) or "none"
        raise UsageError(f"--patch {patch!r}: {path} has no patch of that name; there are: {there}")
    where = known.patch if known else _numbers(patch)
    camera = camera_with_taps(capture, taps)
    return _Seen(capture.lit_bracket(pattern), where, camera, header.lens, known, header.source, notes=notes)


def _timed(seen: _Seen, curve: ResponseCurve | None, *, in_model: bool) -> _Seen:
    """Return photographs with the shutter's offset of the response; a model holds an offset itself."""
    assert seen.photographs is not None
    taken = replace(seen.photographs, brackets=dict.fromkeys(seen.photographs.brackets, seen.bracket))
    taken = with_offset(taken, {} if in_model else dict.fromkeys(taken.brackets, curve))
    bracket = taken.only
    doubt = linear_doubt(bracket) if curve is None and not taken.are_raw and len(bracket.light) > 1 else None
    assumed = tuple(text for texts in taken.assumed.values() for text in texts)
    texts = (doubt,) if doubt else ()
    return replace(seen, bracket=bracket, photographs=taken, notes=(*taken.notes, *texts), assumed=(*assumed, *texts))


def _with_f_number(seen: _Seen, f_number: float | None, *, required: bool) -> _Seen:
    """Return the known source as captured with the f-number stated by hand where its frames do not state it."""
    unstated = seen.lens.f_number is None and any(frame.settings.f_number is None for frame in seen.bracket.light)
    if unstated and f_number is None:
        raise UsageError(
            "the f-number of the frames is not stated: give --f-number N (1 of a lens whose iris cannot change); "
            "without it the scale holds at this unknown f-number alone"
        )
    if not unstated and not required:
        return seen
    if f_number is not None and seen.lens.f_number is not None:
        raise UsageError(f"--f-number: the capture states f/{seen.lens.f_number:.4g} itself; leave it out")
    return replace(seen, bracket=with_f_number(seen.bracket, f_number))


def _meter_settings(
    meter_k: float | None, f_number: float | None, exposure_s: float | None, iso: float | None, *, as_printed: bool
) -> MeterSettings | None:
    if meter_k is None:
        return None
    if f_number is None or exposure_s is None or iso is None:
        raise UsageError("--luminance-meter-k needs --f-number, --exposure and --iso of the reference photograph")
    if f_number <= 0 or iso <= 0:
        raise UsageError("--f-number and --iso must be above 0")
    printed = MeterSettings(exposure_s, f_number, iso)
    return printed if as_printed else printed.exact()


def _of_dials(used: MeterSettings | None, exposure_s: float | None, f_number: float | None) -> tuple[str, ...]:
    """Return which exact stops are behind the settings of a meter, where they differ from what was given."""
    if used is None or (used.exposure_s, used.f_number) == (exposure_s, f_number):
        return ()
    return (
        f"settings are printed stops, in truth {1e3 * used.exposure_s:.5g} ms at f/{used.f_number:.4g}; --as-printed "
        "takes them at face value",
    )


def _certified(path: Path, u_rel: float | None) -> tuple[float, float]:
    """Return the radiance that a certificate states, and its relative standard uncertainty."""
    if u_rel is not None:
        raise UsageError(f"--u-rel: {path} states the uncertainty of the radiance; leave the option out")
    stated = read_certificate(path, RADIANCE_UNIT)
    return stated.value, stated.u_rel


def _known_source(
    seen: _Seen | None, radiance: float | None, luminance: float | None, u_rel: float | None, spectrum: str
) -> KnownSource | None:
    if radiance is not None and luminance is not None:
        raise UsageError("--radiance and --luminance exclude each other")
    stated = radiance if luminance is None else photometry.radiance_w_sr_m2(luminance, spectrum_of(spectrum))
    uncertainty = u_rel
    if stated is None and seen is not None and seen.known is not None:
        settings = seen.bracket.light[0].settings
        known = seen.known.radiance(settings.pattern)
        stated = None if known is None else known * settings.source_level
        uncertainty = u_rel if u_rel is not None else seen.known.u_rel
    if stated is None:
        return None
    if seen is None:
        raise UsageError("a known radiance needs frames of it: name a capture set, or --camera")
    if uncertainty is None:
        raise UsageError("--u-rel is missing: without the source's uncertainty the scale has none")
    PLAUSIBLE["u_rel"].check("u_rel", uncertainty, UsageError)
    return KnownSource(stated, uncertainty, "radiance" if luminance is None else "luminance")


def _base(
    seen: _Seen | None,
    curve: ResponseCurve | None,
    meter: MeterSettings | None,
    preset: CameraPreset | None,
    spectrum: str,
    black_dn: float | None,
    validity_days: float,
) -> tuple[Calibration, tuple[str, ...]]:
    """Return the calibration without its scale, and what was assumed of its black level."""
    if seen is not None:
        numbers = {frame.settings.f_number for frame in seen.bracket.light} - {None}
        update = {"f_number": numbers.pop()} if len(numbers) == 1 else {}
        camera, lens = seen.camera, seen.lens.model_copy(update=update)
    elif curve is None or meter is None:
        raise UsageError("--response is missing: without frames only the curve states how many bits the camera has")
    else:
        camera = curve.camera or CameraDescription(bit_depth=curve.bit_depth)
        lens = LensDescription(f_number=meter.f_number)
    if preset is not None:
        camera = preset.applied_to(camera, "the camera file")
    stated = black_dn
    if stated is None and seen is not None:
        levels = {frame.settings.black_level_dn for frame in seen.bracket.light} - {None}
        stated = levels.pop() if len(levels) == 1 else None
    base = make.unscaled_calibration(camera, lens, curve, spectrum, stated, validity_days)
    if seen is None:
        return base, ()
    # Other captures state what this one does: a measured gain is in the noise model.
    as_stated = {"conversion_gain_e_per_dn": seen.camera.conversion_gain_e_per_dn}
    base = replace(base, camera=camera.model_copy(update=as_stated))
    if stated is not None or camera.black_level_dn is not None:
        return base, ()
    taps = ReadOut.of(Setup(base.camera, base.lens, base), seen.bracket.shape)
    if taps is not None and taps.has_overscan:  # the note of the taps says so
        by_overscan_dn = taps.levelled(seen.bracket.light[0]).settings.black_level_dn
        return replace(base, black_level=base.black_level.model_copy(update={"dn": by_overscan_dn})), ()
    measured = black_from_darks(seen.bracket.dark, base)
    if measured is not None:
        return replace(base, black_level=measured), (f"black level by {len(seen.bracket.dark)} dark frames",)
    if curve is not None:
        return base, ()
    # Anywhere from 0 to the most that it may be: the root mean square distance from 0 is that over √3.
    darkest_dn = min(float(np.percentile(frame.dn, _DARKEST_PERCENT)) for frame in seen.bracket.light)
    most_dn = min(darkest_dn, _MOST_BLACK * camera.full_scale_dn)
    unknown = BlackLevel(dn=0.0, u_dn=max(most_dn / math.sqrt(3.0), base.black_level.u_dn))
    unstated = f"black level 0 DN, which nothing states: it may be up to {most_dn:.3g} DN, which u holds"
    return replace(base, black_level=unknown), (f"{unstated}; state it, or take dark frames",)


def _of_taps(base: Calibration, seen: _Seen | None) -> tuple[str, ...]:
    """Return what was used of the camera's taps, and what was not; a doubt where the frames show undescribed ones."""
    if seen is None or seen.photographs is not None:
        return ()
    light, dark = seen.bracket.light, seen.bracket.dark
    taps = ReadOut.of(Setup(base.camera, base.lens, base), seen.bracket.shape)
    if taps is not None:
        return taps.notes(has_darks=bool(dark))
    longest = next((one for one in reversed(light) if one.dn.max() < one.saturated_dn), light[0])
    return doubt_of_taps(longest.dn - np.float32(base.black_level.dn), dark)


def _with_statements(
    base: Calibration,
    seen: _Seen | None,
    preset: CameraPreset | None,
    stated: Mapping[str, float] | None,
    model: PathLike | None,
    spectral_response: PathLike | None,
    *,
    spectrum_stated: bool,
) -> Calibration:
    """Return the calibration with what is stated or found of the camera besides its response."""
    base = replace(base, uncertainties=_uncertainties(stated, preset))
    if seen is not None:
        require_channel(base, seen.bracket.light[0])
    if model is not None:
        shape = seen.bracket.shape if seen is not None else None
        base = with_found_effects(base, Path(model), base.uncertainties.model_fields_set, shape)
    elif "exposure_u_s" not in base.uncertainties.model_fields_set and _has_unstated_offset(seen, base.response):
        base = _with_u(base, exposure_u_s=UNSTATED_SHUTTER_U_S)
    if "efficacy_u_rel" not in base.uncertainties.model_fields_set:
        light, u_rel = spectrum_of(base.spectrum), UNKNOWN_EFFICACY_U_REL
        if spectrum_stated:
            u_rel = photometry.luminous_efficacy(light).u_rel if photometry.holds_visible_light(light) else 0.0
        base = _with_u(base, efficacy_u_rel=u_rel) if u_rel > 0.0 else base
    if preset is not None and preset.spectral_response is not None:
        base = replace(base, spectral_response=preset.spectral_response)
    if spectral_response is not None:
        base = replace(base, spectral_response=read_spectral_response(Path(spectral_response)))
    return base


def _has_unstated_offset(seen: _Seen | None, curve: ResponseCurve | None) -> bool:
    """Return whether the exposures are those of a shutter whose offset is unknown."""
    return seen is not None and seen.photographs is not None and has_unstated_shutter_offset(seen.photographs, curve)


def _with_u(base: Calibration, **figures: float) -> Calibration:
    return replace(base, uncertainties=base.uncertainties.model_copy(update=figures))


def _flat_field(capture: CaptureSet, base: Calibration, source_u_rel: float) -> FlatField:
    """Return the flat field in a capture set. Raises CalibrationError if it is of another camera, lens or focus."""
    try:
        require_flat_field(base, capture.header.camera, capture.header.lens)
    except CalibrationError as error:
        raise CalibrationError(f"flat field {capture.path}: {error}") from error
    # Without its cos⁴ the lens leaves all of the fall-off to the flat field.
    uncorrected = base.lens.model_copy(update={"vignetting": "none", "focal_length_mm": None})
    bracket = capture.lit_bracket()
    even = merge(bracket, Setup(base.camera, base.lens, replace(base, lens=uncorrected)))
    stops = {frame.settings.f_number or capture.header.lens.f_number for frame in bracket.light} - {None}
    lens = base.lens.model_copy(update={"f_number": stops.pop()}) if len(stops) == 1 else base.lens
    return fit_flat_field(even, base.camera, lens, source_u_rel=source_u_rel)


def read_spectral_response(path: Path) -> SpectralResponse:
    """Return the spectral response in a CSV of wavelength in nm and relative responsivity per watt."""
    found = spectrum_from_csv(path)
    return SpectralResponse(wavelength_nm=tuple(found.wavelength_nm), relative=tuple(found.power))


def _uncertainties(stated: Mapping[str, float] | None, preset: CameraPreset | None) -> StatedUncertainties:
    """Return the stated uncertainties: of the caller, else of the camera file, else the defaults."""
    figures = {**(preset.uncertainties if preset else {}), **(stated or {})}
    unknown = sorted(set(figures) - set(StatedUncertainties.model_fields))
    if unknown:
        there = ", ".join(StatedUncertainties.model_fields)
        raise UsageError(f"there is no uncertainty {unknown[0]!r}; there are: {there}")
    if any(not 0.0 <= u < float("inf") for u in figures.values()):
        raise UsageError("an uncertainty must be 0 or more, and finite")
    return validate(StatedUncertainties, figures, "stated uncertainties", UsageError)


@dataclass(frozen=True, slots=True)
class _Use:
    """Which figure a parameter becomes, and whose uncertainty it replaces (by how much per unit)."""

    corrects: str
    states: str = ""
    per_unit: float = 1.0


_LAW_OF_GAIN: Final = _TYPICAL_GAIN_DB * math.log(10.0) / 20.0
_USES: Final[Mapping[str, Mapping[str, _Use]]] = {
    "exposure_time_offset": {
        "offset_s": _Use("exposure_offset_s", "exposure_u_s"),
        "further_s": _Use("exposure_further_s", "exposure_u_s"),
        "above_db": _Use("exposure_above_db"),
    },
    "veiling_glare": {"share": _Use("glare", "glare_u")},
    "black_level_offset": {"offset_dn": _Use("black_offset_dn", _BLACK)},
    "black_level_gain_slope": {
        "slope_dn": _Use("black_slope_dn", _BLACK, 10.0 ** (_TYPICAL_GAIN_DB / 20.0) - 1.0),
        "from_db": _Use("black_from_db"),
        "bend": _Use("black_bend"),
    },
    "gain_step_error": {
        "error_rel": _Use("gain_error_rel", "gain_step_u_rel", _LAW_OF_GAIN),
        "gains_db": _Use("gains_db"),
        "errors_rel": _Use("gain_errors_rel", "gain_step_u_rel"),
    },
    "quantum_efficiency_temperature": {
        "coefficient_per_K": _Use("temperature_slope_per_k", "temperature_u_rel_per_k"),
        "bend_per_K2": _Use("temperature_bend_per_k2", "temperature_u_rel_per_k", _TYPICAL_WARMER_K),
    },
    "response_nonlinearity": {"a2": _Use("well_a2", "bend_u_rel"), "a3": _Use("well_a3", "bend_u_rel")},
}
# Parts of the ideal chain, and effects that shape noise only: nothing is to be corrected for them.
_HARMLESS: Final = frozenset({"prnu", "dsnu", "hot_pixels", "row_temporal_noise", "excess_read_noise"})


def with_found_effects(
    base: Calibration, path: Path, stated: Collection[str], shape: tuple[int, int] | None = None
) -> Calibration:
    """Return the calibration with the effects of a reconciled model that readings can be corrected for.

    Args:
        base: Calibration without a scale.
        path: Model file of `radiometer reconcile`.
        stated: Names of uncertainties that the user stated and that stay as they are.
        shape: (height, width) of the frames, for a fall-off; None where there are none.

    Raises:
        InputError: If the model holds an effect that readings cannot be corrected for, or one without its u.
    """
    from simulators.chain.camera_model import CameraModel

    found: dict[str, Any] = {}
    variances: dict[str, float] = {}
    names, flat = list[str](), base.flat_field
    model = CameraModel.read(path)
    for entry in model.entries:
        notes, effect = entry.notes, entry.effect
        if not entry.enabled or notes.get("found_by") != "radiometer reconcile" or effect.name in _HARMLESS:
            continue
        where = f"{path}: {effect.name}"
        if effect.name == "natural_vignetting":
            flat = _flat_field_of_effect(effect, notes, base.lens, shape, where)
        elif effect.name not in _USES:
            there = ", ".join((*_USES, "natural_vignetting"))
            raise InputError(
                f"{path}: readings cannot be corrected for {effect.name!r}, only for {there}; remove its cause, or "
                "switch it off in the model (enabled: false) and state its uncertainty with --stated"
            )
        else:
            _take(effect, notes, where, found, variances)
        names.append(effect.name)
    if "response_nonlinearity" in names:
        well = model.camera.full_well_e or _USUAL_WELL_E
        found["well_e"] = well
        variances["bend_u_rel"] *= _full_scale_share(base, well, path) ** 2
    figures = {name: math.sqrt(v) for name, v in variances.items() if name != _BLACK and name not in stated}
    black = base.black_level
    if _BLACK in variances:
        own = 0.0 if "black_level_offset" in names else black.u_dn
        black = black.model_copy(update={"u_dn": math.hypot(own, math.sqrt(variances[_BLACK]))})
    section = type(base.found)(**{**found, "names": tuple(names)})
    uncertainties = base.uncertainties.model_copy(update=figures)
    return replace(base, found=section, uncertainties=uncertainties, black_level=black, flat_field=flat)


def _take(
    effect: Effect, notes: Mapping[str, Any], where: str, found: dict[str, Any], variances: dict[str, float]
) -> None:
    """Put an effect's parameters among what was found, and the squares of what they are uncertain by."""
    uses, usual, own = _USES[effect.name], type(effect)().values(), effect.values()
    for name, value in own.items():
        if value == usual[name]:
            continue
        if name not in uses:
            raise InputError(
                f"{where}: readings cannot be corrected for its {name!r} ({value:g}): it is not the same everywhere in "
                "the picture; calibrate where you read, and switch it off in the model (enabled: false)"
            )
        use = uses[name]
        found[use.corrects] = value
        if use.states:
            u = use.per_unit * _u_of(notes, name, where)
            variances[use.states] = variances.get(use.states, 0.0) + u**2


def _u_of(notes: Mapping[str, Any], parameter: str, where: str) -> float:
    """Return the uncertainty of a parameter; the largest of a table's entries."""
    stated = notes.get("u", {})
    figures = [u for name, u in stated.items() if name == parameter or name.startswith(f"{parameter}[")]
    if not figures or not all(isinstance(u, int | float) and math.isfinite(u) and u >= 0 for u in figures):
        raise InputError(f"{where}: states no uncertainty of {parameter}; reconcile again, or add notes.u.{parameter}")
    return float(max(figures))


def _full_scale_share(base: Calibration, well_e: float, path: Path) -> float:
    """Return full scale over the well; refuse a nonlinearity together with a response curve, which includes it."""
    if base.response is not None:
        raise InputError(
            f"{path}: response_nonlinearity and --response both bend the response. Give one of them, or switch the "
            "effect off in the model (enabled: false)"
        )
    return base.camera.full_scale_dn * base.noise.conversion_gain_e_per_dn / well_e


def _flat_field_of_effect(
    effect: Effect, notes: Mapping[str, Any], lens: LensDescription, shape: tuple[int, int] | None, where: str
) -> FlatField:
    """Return the fall-off (1 + s·ρ²)⁻²·(1 − k₄·ρ⁴) as a flat field, with its uncertainty in the corners."""
    if shape is None:
        raise InputError(f"{where}: a fall-off needs frames of the known source, to know the picture's size")
    height, width = shape
    own, radius = effect.values(), 0.5 * math.hypot(width, height)
    s, k4 = own["strength"], own["k4"]
    x, y = lens.principal_point_px or ((width - 1) / 2.0, (height - 1) / 2.0)
    # Brighter towards the corners is no cosine: the first terms of the series stand for it.
    series = (-2.0 * s, 3.0 * s**2 - k4, -4.0 * s**3 + 2.0 * s * k4)
    law: dict[str, Any] = {"coefficients": (0.0, -k4, 0.0) if s > 0.0 else series}
    law["focal_length_px"] = radius / math.sqrt(s) if s > 0.0 else None
    of_k4 = _u_of(notes, "k4", where) if k4 else 0.0
    return FlatField(
        principal_point_px=(x + own["axis_x"] * radius, y + own["axis_y"] * radius),
        radius_px=radius,
        u_rel=math.hypot(2.0 * _u_of(notes, "strength", where) / (1.0 + s), of_k4),
        shape=shape,
        f_number=lens.f_number,
        **law,
    )

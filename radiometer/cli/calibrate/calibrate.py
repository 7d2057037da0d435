"""`radiometer calibrate`: the absolute scale of a camera, written as one calibration file."""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from radiometer.cli.arguments import ISO_HELP, parse_measured_iso, parse_patch, parse_seconds, with_f_number
from radiometer.cli.calibrate.dynamic_range import with_dynamic_range
from radiometer.cli.calibrate.from_model import with_found_effects
from radiometer.cli.calibrate.report import calibration_report, show_report
from radiometer.cli.outputs import writes
from radiometer.data.iso_speeds import IsoSpeeds
from radiometer.errors import UsageError
from radiometer.photographs.iso_record import at_iso, is_photographs, reference_iso

if TYPE_CHECKING:
    from radiometer.analysis.calibration.calibrate import KnownSource, MeterReading
    from radiometer.data import (
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
        SpectralResponse,
        StatedUncertainties,
    )
    from radiometer.devices import CameraPreset

# Luminous efficacies of radiation (380 to 780 nm) of usual sources, 2856 K to a phosphor-converted LED, lie from
# 0.86 to 1.8 times that of equal energy: the root of the mean square of that rectangle about 1.
UNKNOWN_EFFICACY_U_REL: Final = 0.43


@writes("out")
def command(
    capture: Annotated[Path | None, typer.Argument(help="Capture set or photographs of the known source.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Calibration file to write.")] = None,
    response: Annotated[Path | None, typer.Option(help="Response curve; linear above black without one.")] = None,
    patch: Annotated[
        str | None, typer.Option(help="The known source: X,Y,W,H, or a patch name of the capture.")
    ] = None,
    radiance: Annotated[float | None, typer.Option(help="Its radiance in W·sr⁻¹·m⁻².")] = None,
    luminance: Annotated[float | None, typer.Option(help="Its luminance in cd·m⁻², instead of the radiance.")] = None,
    u_rel: Annotated[float | None, typer.Option(min=0.0, help="Its relative standard uncertainty (k = 1).")] = None,
    meter_k: Annotated[
        float | None, typer.Option("--luminance-meter-k", help="Constant K of the camera's light meter (ISO 2720).")
    ] = None,
    k_u_rel: Annotated[
        float | None,
        typer.Option(min=0.0, help="Relative u of K beyond the meter's ±1/6 stop; 6.7 % (ISO 2720)."),
    ] = None,
    f_number: Annotated[
        float | None, typer.Option(help="f-number of the reference photograph, or of frames that do not state theirs.")
    ] = None,
    exposure: Annotated[str | None, typer.Option(help="Its exposure time, such as 1/125.")] = None,
    iso: Annotated[
        float | None, typer.Option(help="Its ISO speed: as really measured, or stated (--measured-iso).")
    ] = None,
    measured_iso: Annotated[list[str] | None, typer.Option(metavar="STATED=REAL", help=ISO_HELP)] = None,
    channel: Annotated[str, typer.Option(help="Of colour photographs: luminance, red, green or blue.")] = "luminance",
    reference_dn: Annotated[float | None, typer.Option(help="Pixel value it came out at; half of full scale.")] = None,
    dynamic_range: Annotated[
        list[str] | None,
        typer.Option(
            help="M,TIME[,LANDED]: the region at pixel value M of the reference photograph lands on the reference "
            "value (or on LANDED) at TIME; once per region. Puts the exponent of the curve right."
        ),
    ] = None,
    as_printed: Annotated[
        bool, typer.Option("--as-printed", help="Take settings at face value, not as stops.")
    ] = False,
    spectrum: Annotated[
        str | None, typer.Option(help="Spectrum of the source, or a CSV; equal energy to 43 % where not stated.")
    ] = None,
    black_level: Annotated[float | None, typer.Option(help="Black level in DN; the capture's by default.")] = None,
    validity_days: Annotated[float, typer.Option(min=0.001, help="Days the calibration is valid for.")] = 365.0,
    spectral_response: Annotated[
        Path | None, typer.Option(help="CSV of wavelength in nm and relative response per watt of the camera.")
    ] = None,
    flat: Annotated[Path | None, typer.Option(help="Capture set of an evenly bright source: the flat field.")] = None,
    flat_u_rel: Annotated[float, typer.Option(min=0.0, help="Relative u of that source's evenness (k = 1).")] = 0.0,
    camera: Annotated[str | None, typer.Option(help="Capture now with this camera: sim, id, serial, address.")] = None,
    bench: Annotated[Path | None, typer.Option(help="Bench file for --camera.")] = None,
    camera_file: Annotated[
        Path | None, typer.Option(help="Camera file of `radiometer characterise`: gain, noise, saturation as measured.")
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(help="Model of `radiometer reconcile`: readings are corrected for its effects."),
    ] = None,
    stated: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=U", help="Uncertainty of readings that you know better, such as glare_u=0.002."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Report as JSON on standard output.")] = False,
) -> None:
    """Give a response curve its absolute scale.

    By a source of known radiance or luminance (a capture set, or --camera), by the constant K of a light meter and
    the settings it asked for, or by both: then their ratio is printed and the less uncertain scale is used.
    """
    from radiometer.analysis.calibration import calibrate as make
    from radiometer.data import ResponseCurve
    from radiometer.devices import CameraPreset
    from radiometer.photographs.response import refuse_another_channel

    spectrum_unstated, spectrum = spectrum is None, spectrum or "equal_energy"
    if out is None:
        raise UsageError("-o FILE is missing: say where to write the calibration")
    curve = ResponseCurve.read(response) if response else None
    curve, ranged = with_dynamic_range(curve, dynamic_range, exposure, reference_dn, as_printed=as_printed)
    source_stated = radiance is not None or luminance is not None
    measured = parse_measured_iso(measured_iso)
    real_iso = measured.get(iso, iso) if iso is not None else None
    speeds = IsoSpeeds(measured, real_iso, iso if iso in measured else None)
    seen = _seen(capture, camera, bench, patch, channel, speeds, patch_needed=source_stated or meter_k is None)
    if seen is not None and (meter_k is None or source_stated):
        seen = _with_f_number(seen, f_number, needed=meter_k is None)
    meter_wanted = _meter_settings(meter_k, f_number, exposure, real_iso, as_printed=as_printed)
    source = _known_source(seen, radiance, luminance, u_rel, spectrum)
    if source is None and meter_wanted is None:
        raise UsageError("give --radiance or --luminance of a known source, or --luminance-meter-k with its settings")
    description, lens = _camera_and_lens(seen, curve.bit_depth if curve else None, meter_wanted)
    preset = None
    if camera_file is not None:
        preset = CameraPreset.read(camera_file)
        description = preset.applied_to(description, str(camera_file))
    if seen is not None and capture is not None and model is None and is_photographs(capture):
        seen = _with_offset(seen, capture, curve)
    black = _black_level(black_level, seen)
    base = make.unscaled_calibration(description, lens, curve, spectrum, black, validity_days)
    if seen is not None:
        refuse_another_channel(base, seen.bracket)
    base = replace(base, uncertainties=_uncertainties(stated, preset))
    if model is not None:
        shape = seen.bracket.frames[0].shape if seen is not None else None
        base = with_found_effects(base, model, base.uncertainties.model_fields_set, shape)
    if spectrum_unstated and "efficacy_u_rel" not in base.uncertainties.model_fields_set:
        unknown = base.uncertainties.model_copy(update={"efficacy_u_rel": UNKNOWN_EFFICACY_U_REL})
        base = replace(base, uncertainties=unknown)
    if preset is not None and preset.spectral_response is not None:
        base = replace(base, spectral_response=preset.spectral_response)
    if spectral_response is not None:
        base = replace(base, spectral_response=read_spectral_response(spectral_response))
    if flat is not None:
        base = replace(base, flat_field=_flat_field(flat, base, flat_u_rel))
    scales: list[Scale] = []
    meter: MeterReading | None = None
    if source is not None and seen is not None and seen.patch is not None:
        known = make.scale_by_source(base, seen.bracket, seen.patch, source)
        scales.append(at_iso(known, *reference_iso(seen.bracket, speeds)))
    if meter_wanted is not None and meter_k is not None:
        dn = reference_dn if reference_dn is not None else description.full_scale_dn // 2
        meter = make.MeterReading(meter_k, meter_wanted, dn, k_u_rel)
        scales.append(at_iso(make.scale_by_meter(base, meter), speeds.reference, speeds.reference_stated))
    chosen = min(scales, key=lambda scale: scale.u_rel)
    other = next((scale for scale in scales if scale is not chosen), None)
    inputs = tuple(str(path.name) for path in (capture, response, camera_file, flat, model) if path)
    calibration = make.scaled_calibration(base, chosen, inputs, other)
    calibration.write(out)
    report = calibration_report(calibration, scales, meter, out, ranged)
    print(json_module.dumps(report, ensure_ascii=False)) if json else show_report(report, calibration)


@dataclass(frozen=True, slots=True)
class _Seen:
    """The known source as captured."""

    bracket: Bracket
    patch: Patch | None
    camera: CameraDescription
    lens: LensDescription
    known: PatchDescription | None


def _seen(
    capture: Path | None,
    camera: str | None,
    bench: Path | None,
    patch: str | None,
    channel: str,
    speeds: IsoSpeeds,
    *,
    patch_needed: bool,
) -> _Seen | None:
    if capture is not None and camera is not None:
        raise UsageError("give a capture set or --camera, not both")
    if capture is not None and is_photographs(capture):
        return _seen_in_photographs(capture, patch, channel, speeds, needed=patch_needed)
    if capture is not None:
        return _seen_in_capture(capture, patch, needed=patch_needed)
    if camera is not None or bench is not None:
        return _seen_by_camera(camera, bench, patch)
    return None


def _with_offset(seen: _Seen, path: Path, curve: ResponseCurve | None) -> _Seen:
    """Return what photographs showed, their exposures with the shutter's offset of the response, which is said."""
    from radiometer.bench.sources import exposure_list
    from radiometer.cli.console import note
    from radiometer.photographs.response import with_offset_of_response

    bracket, text, _ = with_offset_of_response(seen.bracket, curve, exposure_list(path))
    if text:
        note(text)
    return replace(seen, bracket=bracket)


def _seen_in_photographs(path: Path, patch: str | None, channel: str, speeds: IsoSpeeds, *, needed: bool) -> _Seen:
    from radiometer.bench.sources import open_brackets
    from radiometer.data import CameraDescription, LensDescription

    if patch is None and needed:
        raise UsageError("--patch is missing: say where in the photographs the known source is (X,Y,W,H)")
    if channel == "each":
        raise UsageError("--channel each: a calibration holds one channel; give luminance, red, green or blue")
    bracket = open_brackets(path, channel, speeds=speeds)[0]
    where = parse_patch(patch) if patch else None
    return _Seen(bracket, where, CameraDescription(bit_depth=bracket.bit_depth), LensDescription(), None)


def _seen_in_capture(capture: Path, patch: str | None, *, needed: bool) -> _Seen:
    from radiometer.cli.direct import opened

    found = opened(capture)
    named = {entry.name: entry for entry in found.header.patches}
    known = named.get(patch or "")
    if patch is None:
        with_radiance = [entry for entry in found.header.patches if entry.radiance_W_per_sr_m2 is not None]
        if len(with_radiance) != 1 and needed:
            raise UsageError(
                f"--patch is missing: {capture} has {len(with_radiance)} patches of known radiance; "
                "give X,Y,W,H or a patch's name"
            )
        known = with_radiance[0] if len(with_radiance) == 1 else None
    if known is None and patch is not None and "," not in patch:
        there = ", ".join(named) or "none"
        raise UsageError(f"--patch {patch!r}: {capture} has no patch of that name; there are: {there}")
    where = known.patch if known else parse_patch(patch) if patch else None
    return _Seen(_at_full_level(found), where, found.header.camera, found.header.lens, known)


def _at_full_level(capture: CaptureSet) -> Bracket:
    """Return the dark frames and those of the source's highest level: what is known of a patch holds at level 1."""
    from radiometer.data import Bracket

    bracket = capture.bracket()
    level = max(frame.settings.source_level for frame in bracket)
    lit = [frame for frame in bracket if frame.settings.source_level == level]
    return Bracket.from_frames([*lit, *bracket.dark_frames], origin=bracket.origin)


def _seen_by_camera(camera: str | None, bench: Path | None, patch: str | None) -> _Seen:
    from radiometer.bench.assembly import open_instrument

    wanted = parse_patch(patch) if patch else None
    with open_instrument(bench, camera, wanted, uncalibrated=True) as instrument:
        device = instrument.camera
        return _Seen(instrument.take_bracket(), instrument.patch, device.description, device.lens, None)


def _known_source(
    seen: _Seen | None, radiance: float | None, luminance: float | None, u_rel: float | None, spectrum: str
) -> KnownSource | None:
    from radiometer.analysis.calibration.calibrate import KnownSource
    from radiometer.analysis.photometry.photometry import radiance_w_sr_m2
    from radiometer.analysis.photometry.spectra import spectrum as spectrum_of

    if radiance is not None and luminance is not None:
        raise UsageError("--radiance and --luminance exclude each other")
    stated = radiance if luminance is None else radiance_w_sr_m2(luminance, spectrum_of(spectrum))
    uncertainty = u_rel
    if stated is None and seen is not None and seen.known is not None:
        settings = seen.bracket.frames[0].settings
        known = seen.known.radiance(settings.pattern)
        stated = None if known is None else known * settings.source_level
        uncertainty = u_rel if u_rel is not None else seen.known.u_rel
    if stated is None:
        return None
    if seen is None:
        raise UsageError("a known radiance needs frames of it: name a capture set, or --camera")
    if uncertainty is None:
        raise UsageError("--u-rel is missing: a scale is worth no more than what is known of its source")
    return KnownSource(stated, uncertainty, "radiance" if luminance is None else "luminance")


def _meter_settings(
    meter_k: float | None, f_number: float | None, exposure: str | None, iso: float | None, *, as_printed: bool
) -> Any:
    from radiometer.analysis.calibration.absolute import MeterSettings

    if meter_k is None:
        return None
    if f_number is None or exposure is None or iso is None:
        raise UsageError("--luminance-meter-k needs --f-number, --exposure and --iso of the reference photograph")
    if f_number <= 0 or iso <= 0:
        raise UsageError("--f-number and --iso must be above 0")
    printed = MeterSettings(parse_seconds(exposure, "--exposure"), f_number, iso)
    return printed if as_printed else printed.exact()


def _with_f_number(seen: _Seen, f_number: float | None, *, needed: bool) -> _Seen:
    """Return the known source as captured with the f-number stated by hand where its frames do not state it."""
    unstated = seen.lens.f_number is None and any(frame.settings.f_number is None for frame in seen.bracket)
    if unstated and f_number is None:
        raise UsageError(
            "the f-number of the frames is not stated: give --f-number N (1 of a lens whose iris cannot change); "
            "without it the scale could be used at no other"
        )
    if not unstated and not needed:
        return seen
    if f_number is not None and seen.lens.f_number is not None:
        raise UsageError(f"--f-number: the capture states f/{seen.lens.f_number:.4g} itself; leave it out")
    return replace(seen, bracket=with_f_number(seen.bracket, f_number))


def _camera_and_lens(
    seen: _Seen | None, curve_bits: int | None, meter: Any
) -> tuple[CameraDescription, LensDescription]:
    from radiometer.data import CameraDescription, LensDescription

    if seen is not None:
        numbers = {frame.settings.f_number for frame in seen.bracket} - {None}
        update = {"f_number": numbers.pop()} if len(numbers) == 1 else {}
        return seen.camera, seen.lens.model_copy(update=update)
    if curve_bits is None:
        raise UsageError("--response is missing: without frames the curve says how many bits the camera has")
    return CameraDescription(bit_depth=curve_bits), LensDescription(f_number=meter.f_number)


def _flat_field(path: Path, base: Calibration, source_u_rel: float) -> FlatField:
    from radiometer.analysis.calibration.flat_field import fit_flat_field
    from radiometer.analysis.merge.bracket import merge
    from radiometer.cli.direct import opened

    even = merge(opened(path).bracket(), base.camera, base.lens, replace(base, lens=_uncorrected(base.lens)))
    return fit_flat_field(even, base.camera, base.lens, source_u_rel=source_u_rel)


def read_spectral_response(path: Path) -> SpectralResponse:
    """Return the spectral response in a CSV of wavelength in nm and relative responsivity per watt."""
    from radiometer.analysis.photometry.spectra import spectrum_from_csv
    from radiometer.data import SpectralResponse

    found = spectrum_from_csv(path)
    return SpectralResponse(wavelength_nm=tuple(found.wavelength_nm), relative=tuple(found.power))


def _uncorrected(lens: LensDescription) -> LensDescription:
    """Return the lens without its cos⁴: the flat field is to hold all of the falloff."""
    return lens.model_copy(update={"vignetting": "none", "focal_length_mm": None})


def _uncertainties(words: list[str] | None, preset: CameraPreset | None) -> StatedUncertainties:
    """Return the stated uncertainties: of the command line, else of the camera file, else the defaults."""
    from radiometer.data import StatedUncertainties

    figures = dict(preset.uncertainties) if preset else {}
    for word in words or ():
        name, _, text = word.partition("=")
        try:
            figures[name] = float(text)
        except ValueError as error:
            raise UsageError(f"--stated {word!r}: expected NAME=U, such as glare_u=0.002") from error
    unknown = sorted(set(figures) - set(StatedUncertainties.model_fields))
    if unknown:
        there = ", ".join(StatedUncertainties.model_fields)
        raise UsageError(f"there is no uncertainty {unknown[0]!r}; there are: {there}")
    if any(not 0.0 <= u < float("inf") for u in figures.values()):
        raise UsageError("an uncertainty must be 0 or more, and finite")
    return StatedUncertainties(**figures)


def _black_level(stated: float | None, seen: _Seen | None) -> float | None:
    if stated is not None or seen is None:
        return stated
    levels = {frame.settings.black_level_dn for frame in seen.bracket} - {None}
    return levels.pop() if len(levels) == 1 else None
